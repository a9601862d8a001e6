"""Inverse kinematics on a fitted clip: its chain from the trunk to a foot is driven to a target, or along a stride."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from threadpoolctl import threadpool_limits

from recon.animal.chain import Chain
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.base.files import require_free_folder, sole_writer, staged_folder
from recon.check import usable, verdict_fields
from recon.fit.motion import Motion
from recon.gait.clip import ClipAnalysis, limb_chains, stride_given
from recon.gait.gait import AGREE, OVERSAMPLING, Gait, doubtful_text
from recon.gait.kinematics import MIN_POINTS
from recon.gait.phase import Closure, Portrait
from recon.io.common import write_rows
from recon.robotics.ik.animal import (
    body_chain,
    body_chain_angles,
    body_travel,
    chain_angles,
    projected_chain,
    spine_front_leg,
)
from recon.robotics.ik.chain import SerialChain
from recon.robotics.ik.costs import (
    Cost,
    harmonic_map,
    joint_differences,
    pose_distance,
    rotational_energy,
    weighted_sum,
)
from recon.robotics.ik.drive import Run, control_columns, drive_to, follow
from recon.robotics.ik.fit import PARAMETERS, PULL, Frames, ParameterFit, fit_weights, fits
from recon.robotics.ik.methods import (
    ExtendedJacobian,
    GradientProjection,
    JacobianTranspose,
    LeastNorm,
    Method,
    SelectivelyDamped,
    damped_least_squares,
)
from recon.robotics.ik.null_space import to_null_space_optimum
from recon.robotics.ik.stride import StridePath, farthest_reach, find_stride
from recon.robotics.settings import EXTENDED, STRIDE_MAX, IkSettings
from recon.show.report import to_json

Dim = Literal[2, 3]

SLOWER = 10
"""How many times slower than the animal a stride is followed: rate limits are what is expected of its joints, and would
hold back a method that moves others than the animal does. Closures do not depend on it."""
SUMMARY = "ik.json"


@dataclass(frozen=True, eq=False)
class _Limb:
    """A chain of the animal, and its joint angles in the clip."""

    foot: str
    chain: SerialChain
    q: Array
    """(T, n)"""
    fps: float
    first_s: float
    """Time of the clip's first frame."""
    base: Literal["UVW", "xyz"]
    """What the base frame's axes mean, U forwards, V down and W left, or x forwards, y left and z up."""
    misfit_m: float
    """Distance of the chain's end from the foot, median."""

    @property
    def names(self) -> tuple[str, ...]:
        """(n,): of the joints, in everything that is written."""
        return self.chain.names


COSTS: dict[str, Callable[[_Limb], Cost]] = {
    "differences": lambda limb: joint_differences(limb.chain),
    "energy": lambda limb: rotational_energy(limb.chain),
    "harmonic": lambda limb: harmonic_map(joints=max(limb.chain.groups, key=len)[-3:]),
    "pose": lambda limb: pose_distance(np.nanmean(limb.q, axis=0)),
}


@dataclass(frozen=True, eq=False)
class _IKRun:
    """What was moved, and how."""

    settings: IkSettings
    motion: Motion
    limb: _Limb
    stride: StridePath
    target_m: Array | None
    """(dim,)"""
    runs: Mapping[str, Mapping[str, Run]]
    """To the "target" and along the stride ("follow"), by method, empty where not asked for."""
    parameters: Mapping[str, ParameterFit]
    """Fitted to the clip, by method."""
    series: pd.DataFrame | None
    """Fitted to each frame of the stride by itself (`fit_parameter_series`); None where not asked for."""

    @property
    def begins_s(self) -> float:
        """When the stride begins in the clip."""
        return self.limb.first_s + self.stride.start_s

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The summary of the run, as ik.json holds it."""
        limb, stride, settings = self.limb, self.stride, self.settings
        followed = {}
        for name, run in self.runs["follow"].items():
            closed = run.closures()
            followed[name] = {
                "worst_error_m": float(run.distance_m.max()),
                "note": run.note,
                **run.measures(),
                **{f"least_closure_{kind}_percent": float(np.fmin.reduce(of)) for kind, of in closed.items()},
                **{
                    f"closure_{kind}_percent": dict(zip(limb.names, of.tolist(), strict=True))
                    for kind, of in closed.items()
                },
            }
        return {
            "schema": {"name": "recon.ik", "version": 1},
            "verdict": verdict_fields(self.motion),
            "foot": limb.foot,
            "dimensions": limb.chain.dim,
            "joints": list(limb.names),
            "base_frame": "U forwards, V down, W left" if limb.base == "UVW" else "x forwards, y left, z up",
            "misfit_m": limb.misfit_m,
            "stride": {
                "start_s": self.begins_s,
                "end_s": limb.first_s + stride.end_s,
                "how": stride.how,
                "notes": stride.notes,
                "gap_m": stride.gap_m,
                "gap_percent": stride.gap_percent,
            },
            "parameters": {
                "used": "fitted to the clip" if settings.fitted else "standard",
                "fitted": {
                    name: {
                        "value": f.parameter,
                        "rms_rad_s": f.rms_rad_s,
                        "explained": f.explained,
                        "best_alpha": f.alpha,
                        "note": f.note,
                    }
                    for name, f in self.parameters.items()
                },
                "alpha": settings.alpha,
            },
            "target_m": self.target_m,
            "to_target": {
                name: {"reached": run.reached, "reason": run.reason, "iterations": run.iterations, **run.measures()}
                for name, run in self.runs["target"].items()
            },
            "turns": settings.turns if followed else None,
            "along_stride": followed,
        }


# -- the animal's chain ----------------------------------------------------------------------------------------------


def limb_of(motion: Motion, foot: str | None = None, dim: Dim = 3, limited: bool = True) -> _Limb:
    """The chain to a foot, by its label (LF) or joint, by default the first fore foot. Raises InputError.

    Of the 8U chain that is the spine and the front leg. Of a whole animal, in space, all joints from the root to the
    foot, and in the plane the joints' projections onto the vertical plane of travel.
    """
    label = _foot_label(motion, foot)
    name = motion.foot_names[label]
    travel, first_s = body_travel(motion.states), float(motion.time_s[0])
    if isinstance(motion.chain, Chain):
        leg = spine_front_leg(motion.chain, motion.size * motion.chain.nominal_base_length_m, dim, limited)
        q = chain_angles(motion.chain, motion.states, dim=dim)
        return _Limb(name, leg, q, motion.fps, first_s, "UVW", 0.0)
    if dim == 3:
        marker = motion.joints[motion.names.index(name)]
        chain = body_chain(motion.body, marker, motion.size, limited)
        q = body_chain_angles(motion.body, marker, motion.states)
        return _Limb(name, chain, q, motion.fps, first_s, "xyz", 0.0)
    along = next(along for along in limb_chains(motion).values() if along[-1] == name)
    points = motion.upright.xyz_m[:, [motion.names.index(joint) for joint in along]]
    chain, q, misfit = projected_chain(points, travel)
    named = replace(chain, names=tuple(along[:-1]))
    return _Limb(name, named, q, motion.fps, first_s, "UVW", float(np.nanmedian(misfit)))


def _foot_label(motion: Motion, foot: str | None) -> str:
    """LH, RH, LF or RF."""
    chain = motion.body.one_sided
    there = [label for label in motion.foot_names if label.endswith("F")] if chain else list(motion.foot_names)
    if foot is None and there:
        return next((label for label in there if label.endswith("F")), there[0])
    found = next((label for label in there if foot in (label, motion.foot_names[label])), None)
    if found is None:
        expected = ", ".join(f"{label} ({motion.foot_names[label]})" for label in there) or "a skeleton with feet"
        raise InputError(Problem("--foot", "foot", repr(foot or "none"), expected))
    return found


# -- methods ---------------------------------------------------------------------------------------------------------


def methods_of(
    limb: _Limb,
    names: tuple[str, ...],
    parameters: Mapping[str, ParameterFit],
    fitted: bool = False,
    cost: Cost | None = None,
    alpha: float | Literal["step"] | None = None,
) -> dict[str, Method]:
    """The methods by name (`METHODS`, `EXTENDED`), with their standard parameters, or those fitted to the clip
    (`fit_parameters`). Weights have no standard, and are fitted in any case.

    cost: of `EXTENDED`, which needs one, and of gradient projection, by default the joint differences. alpha: a factor
    on all rates, or "step" for the one of each step with which the foot moves nearest to what is asked for.
    """
    standard: dict[str, Method] = {
        "least-norm": LeastNorm(),
        "transpose": JacobianTranspose(),
        "gradient-projection": GradientProjection(cost or joint_differences(limb.chain)),
        "weighted": parameters["weighted"].method,
        "damped": damped_least_squares(),
        "selectively-damped": SelectivelyDamped(),
    }
    chosen: dict[str, Method] = {}
    for name in names:
        if name == EXTENDED and cost is not None:
            chosen[name] = ExtendedJacobian(cost)
        elif name.startswith("extended-"):
            chosen[name] = ExtendedJacobian(COSTS[name.removeprefix("extended-")](limb))
        else:
            chosen[name] = parameters[name].method if fitted else standard[name]
    if alpha is None:
        return chosen
    return {name: replace(method, alpha=None if alpha == "step" else alpha) for name, method in chosen.items()}


def cost_of(limb: _Limb, text: str) -> Cost:
    """A cost of `COSTS`, or a sum of some with weights, as in "energy,differences=0.1". Raises InputError."""
    costs, weights, problems = [], [], []
    for part in text.split(","):
        name, _, weight = part.strip().partition("=")
        try:
            weights.append(float(weight or 1))
            costs.append(COSTS[name](limb))
        except (ValueError, KeyError):
            expected = f"{', '.join(COSTS)}, or a sum with weights, as in energy,differences=0.1"
            problems.append(Problem("--cost", "cost", repr(part), expected))
    if problems:
        raise InputError(problems)
    return costs[0] if len(costs) == 1 and weights == [1.0] else weighted_sum(tuple(costs), tuple(weights))


def fit_parameters(limb: _Limb, cost: Cost | None = None) -> dict[str, ParameterFit]:
    """By method, by least squares to the joint rates of the clip, from a spline through its angles. cost: of gradient
    projection; None: any constant vector. Raises InputError for fewer than four frames in a row."""
    frames = _rates_of(limb)
    return {name: fit(frames) for name, fit in fits(cost).items()}


def fit_parameter_series(limb: _Limb, stride: StridePath, cost: Cost | None = None) -> pd.DataFrame:
    """The same fitted to each frame of a stride by itself, a row each: time_s in the clip, and of every method its
    parameter (`PARAMETERS`; of the weights one for each joint), <method>_best_alpha and <method>_explained.

    cost: of gradient projection, by default the joint differences, of which k is fitted. Raises InputError as
    `fit_parameters`.
    """
    at_s = np.flatnonzero(np.isfinite(limb.q).all(axis=1)) / limb.fps
    first, last = np.searchsorted(at_s, [stride.start_s - 1e-6, stride.end_s + 1e-6]).tolist()
    frames = _rates_of(limb)
    every = fits(cost or joint_differences(limb.chain)) | {"weighted": lambda one: fit_weights(one, PULL)}
    columns: dict[str, Any] = {"time_s": limb.first_s + at_s[first:last]}
    for name, fit in every.items():
        found = [fit(frames[t : t + 1]) for t in range(first, last)]
        called = limb.names if name == "weighted" else PARAMETERS.get(name, ())
        values = np.array([one.parameter for one in found])
        columns |= {f"{name}_{part}": of_part for part, of_part in zip(called, values.T, strict=True)}
        columns[f"{name}_best_alpha"] = [one.alpha for one in found]
        columns[f"{name}_explained"] = [one.explained for one in found]
    return pd.DataFrame(columns)


def _rates_of(limb: _Limb) -> Frames:
    """The frames with a pose."""
    known = np.flatnonzero(np.isfinite(limb.q).all(axis=1))
    if len(known) < MIN_POINTS:
        raise InputError(Problem("results", "frames", f"{len(known)} with a pose", f"at least {MIN_POINTS}"))
    q, dq = limb.q[known], CubicSpline(known / limb.fps, limb.q[known])(known / limb.fps, 1)
    dx = np.stack([limb.chain.jacobian(x) @ rate for x, rate in zip(q, dq, strict=True)])
    return Frames.of(limb.chain, q, dx, dq)


# -- the jobs --------------------------------------------------------------------------------------------------------


def run_ik(settings: IkSettings) -> _IKRun:
    """`recon ik`: tables and figures into a folder. With parameters fitted to the clip, these are fitted to each frame
    of the stride, too. Raises InputError."""
    out, motion = settings.out_folder, usable(Motion.load(settings.folder), settings.folder, settings.anyway)
    with sole_writer(out):
        require_free_folder(out, (SUMMARY,), settings.overwrite)
        limb = limb_of(motion, settings.foot, 2 if settings.dim == 2 else 3, settings.limits)
        cost = None if settings.cost is None else cost_of(limb, settings.cost)
        target = STRIDE_MAX if settings.both else settings.target
        goal = _coordinates(target, limb.chain.dim) if target not in (None, STRIDE_MAX) else None
        with threadpool_limits(1, user_api="blas"):
            stride = stride_of(motion, limb, settings.stride)
            parameters = fit_parameters(limb, cost)
            series = fit_parameter_series(limb, stride, cost) if settings.fitted else None
            methods = methods_of(limb, settings.methods, parameters, settings.fitted, cost, settings.alpha)
            start, foremost = farthest_reach(limb.chain, stride.q)
            goal = foremost if target == STRIDE_MAX else goal
            drives = {} if goal is None else {n: drive_to(limb.chain, start, goal, m) for n, m in methods.items()}
            followed = methods if settings.both or settings.follow is not None else {}
            follows = {n: follow_stride(limb.chain, stride, m, settings.turns) for n, m in followed.items()}
        runs = {"target": drives, "follow": follows}
        solved = _IKRun(settings, motion, limb, stride, goal, runs, parameters, series)
        with staged_folder(out) as staging:
            _write(solved, staging)
        if settings.figures:  # after the tables, which are there whatever befalls them
            with staged_folder(out) as staging:
                write_figures(solved, staging)
    return solved


def _coordinates(target: str, dim: int) -> Array:
    parts = re.split(r"\s*,\s*", target.strip())
    try:
        values = np.array([float(part) for part in parts])
    except ValueError:
        values = np.empty(0)
    if len(values) != dim or not np.isfinite(values).all():
        expected = f"{STRIDE_MAX}, or {dim} coordinates in metres, as in {'0.8,0.3,0.1'[: 4 * dim - 1]}"
        raise InputError(Problem("--target", "target", repr(target), expected))
    return values


def stride_of(motion: Motion, limb: _Limb, stride_s: tuple[float, float] | None = None) -> StridePath:
    """The stride that is given; or the first of the foot that counts (`recon.gait.gait`); or, of a clip without any,
    where the foot comes back to nearest in the time that a stride takes. Raises InputError for a clip that shows too
    little."""
    if stride_s is not None:
        stride = stride_given(motion, stride_s)
        return _found_stride(motion, limb, "given", (stride.start_s, stride.end_s))
    gait = ClipAnalysis(motion).gait
    assert gait is not None  # the limb has a foot
    label = next(label for label, joint in motion.foot_names.items() if joint == limb.foot)
    doubts = [doubtful_text(doubt) for doubt in gait.doubtful if doubt.foot == label]
    # Of poses that jitter, touch-downs are told worse than the pose's return is.
    if not motion.jitters and (complete := next((s for s in gait.strides if s.foot == label), None)):
        return _found_stride(motion, limb, "gait", (complete.start_s, complete.end_s), doubts)
    return _found_stride(motion, limb, notes=doubts, lasts_s=stride_lasts_s(gait))


def stride_lasts_s(gait: Gait) -> tuple[float, float]:
    """How long a stride of a foot without a complete one lasts, at least and at most: about as long as the clip says.
    In one that is too short to hold what it says, and in which no foot lands twice, it takes the time from the first
    touchdown to the end at least, to half a frame."""
    time_s = gait.tracks.time_s
    if 0 < gait.stride_s < time_s[-1] - time_s[0]:
        return (1 - AGREE) * gait.stride_s, (1 + AGREE) * gait.stride_s
    landed = [s for s in gait.stances if s.begins]
    if len({s.foot for s in landed}) < len(landed):
        return 0.0, np.inf
    first_s = min((s.start_s for s in landed), default=time_s[-1])
    return float(time_s[-1] - first_s - OVERSAMPLING / 2 * (time_s[1] - time_s[0])), np.inf


def _found_stride(
    motion: Motion,
    limb: _Limb,
    how: str = "",
    span_s: tuple[float, float] | None = None,
    notes: Sequence[str] = (),
    lasts_s: tuple[float, float] = (0.0, np.inf),
) -> StridePath:
    start_s, end_s = (None, None) if span_s is None else (at_s - limb.first_s for at_s in span_s)
    try:
        stride = find_stride(limb.chain, limb.q, limb.fps, start_s, end_s, lasts_s)
    except ValueError as error:
        raise InputError(Problem(motion.file, "stride", str(error), "a clip that shows more of one")) from None
    return replace(stride, how=how or stride.how, notes=tuple(notes))


def follow_stride(chain: SerialChain, stride: StridePath, method: Method, turns: int = 1) -> Run:
    """Along the stride, `SLOWER` than the animal; times and rates are the animal's again. The extended Jacobian starts
    where its cost is stationary, with the foot in the same place."""
    q0 = stride.q[0]
    if isinstance(method, ExtendedJacobian):
        q0 = to_null_space_optimum(chain, q0, method.cost)[0]
    run = follow(chain, q0, stride.path_m, method, turns, SLOWER * stride.interval_s)
    return replace(run, dq=SLOWER * run.dq, interval_s=stride.interval_s)


# -- what is written -------------------------------------------------------------------------------------------------


def _write(solved: _IKRun, folder: Path) -> None:
    summary, names = solved.summary, solved.limb.names
    (folder / SUMMARY).write_text(to_json(summary), encoding="utf-8")
    for file, rows in (("target.csv", summary["to_target"]), ("follow.csv", summary["along_stride"])):
        if rows:
            cells = [[name, *(_cell(v) for v in row.values() if not isinstance(v, dict))] for name, row in rows.items()]
            columns = [name for name, v in next(iter(rows.values())).items() if not isinstance(v, dict)]
            write_rows(folder / file, [["method", *columns]], cells)
    if followed := summary["along_stride"]:
        kinds = [(name, kind) for name in followed for kind in ("angle", "plane")]
        rows = [[j, *(followed[name][f"closure_{kind}_percent"][j] for name, kind in kinds)] for j in names]
        write_rows(folder / "closures.csv", [["joint", *(f"{name}_{kind}" for name, kind in kinds)]], rows)
    if solved.series is not None:
        write_rows(folder / "parameters.csv", [[*solved.series.columns]], solved.series.to_numpy().tolist())
    axes = list(solved.limb.base)[: solved.limb.chain.dim]
    for job, runs in solved.runs.items():
        for name, run in runs.items():
            time_s = run.time_s + (0.0 if run.driven else solved.begins_s)
            columns = ["step", "time_s", *(f"{joint}_rad" for joint in names), *control_columns(names)]
            columns += [*(f"end_{axis}_m" for axis in axes), "distance_m"]
            values = np.column_stack((time_s, run.q, *run.control, run.end_m, run.distance_m)).tolist()
            write_rows(folder / f"{job}_{name}.csv", [columns], [[k, *row] for k, row in enumerate(values)])


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return " ".join(value) if isinstance(value, list) else "" if value is None else value


def write_figures(solved: _IKRun, folder: Path) -> None:
    """Paths in task and joint space, and phase portraits with closures by method, PNG and SVG."""
    from recon.robotics.ik import plots
    from recon.show.plots.phase import phase_portraits
    from recon.show.plots.style import save

    limb, aims = solved.limb, {"target": solved.target_m, "follow": solved.stride.path_m}
    for job, runs in solved.runs.items():
        if runs:
            save(plots.task_space(runs, limb.chain, aims[job], limb.base), folder, f"{job}_task_space")
            save(plots.joint_space(runs, limb.names), folder, f"{job}_joint_space")
    for name, run in solved.runs["follow"].items():
        of_joints = zip(limb.names, run.q.T, run.control[0].T, *run.closures().values(), strict=True)
        portraits, closed = {}, {}
        for joint, angle, rate, *closures in of_joints:
            portraits[joint] = Portrait(solved.begins_s + run.time_s, angle, rate)
            closed[joint] = Closure(*closures)
        save(phase_portraits(portraits, closed, name), folder, f"follow_phase_{name}")
