"""Inverse kinematics on a fitted clip: its chain from the trunk to a foot is driven to a target, or along a stride."""

from __future__ import annotations

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
from recon.show.plain import by_name, picked, to_json
from recon.wings.robotics.ik import animal
from recon.wings.robotics.ik import methods as ways
from recon.wings.robotics.ik.chain import SerialChain
from recon.wings.robotics.ik.drive import Run, control_columns, drive_to, follow, to_null_space_optimum
from recon.wings.robotics.settings import EXTENDED, STRIDE_MAX, IkSettings

Dim = Literal[2, 3]

SLOWER = 10
"""How many times slower than the animal a stride is followed: rate limits are what is expected of its joints, and would
hold back a method that moves others than the animal does. Closures do not depend on it."""
LAST = 3
"""Frames before each that parameters are refitted to on the way."""
SUMMARY = "ik.json"


@dataclass(frozen=True, eq=False)
class Limb:
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


COSTS: dict[str, Callable[[Limb], ways.Cost]] = {
    "differences": lambda limb: ways.joint_differences(limb.chain),
    "energy": lambda limb: ways.rotational_energy(limb.chain),
    "harmonic": lambda limb: ways.harmonic_map(joints=max(limb.chain.groups, key=len)[-3:]),
    "pose": lambda limb: ways.pose_distance(np.nanmean(limb.q, axis=0)),
}


@dataclass(frozen=True, eq=False)
class _IKRun:
    """What was moved, and how."""

    settings: IkSettings
    motion: Motion
    limb: Limb
    stride: animal.StridePath
    target_m: Array | None
    """(dim,)"""
    runs: Mapping[str, Mapping[str, Run]]
    """To the "target" and along the stride ("follow"), by method, empty where not asked for."""
    parameters: Mapping[str, ways.ParameterFit]
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
        stride_s = {"start_s": self.begins_s, "end_s": limb.first_s + stride.end_s}
        fitted = {
            name: {"value": f.parameter, **picked(f, "rms_rad_s", "explained"), "best_alpha": f.alpha, "note": f.note}
            for name, f in self.parameters.items()
        }
        return {
            "schema": {"name": "recon.ik", "version": 1},
            "verdict": verdict_fields(self.motion),
            "foot": limb.foot,
            "dimensions": limb.chain.dim,
            "joints": list(limb.names),
            "base_frame": "U forwards, V down, W left" if limb.base == "UVW" else "x forwards, y left, z up",
            "misfit_m": limb.misfit_m,
            "stride": stride_s | picked(stride, "how", "notes", "gap_m", "gap_percent"),
            "parameters": {"used": settings.parameters, "fitted": fitted, "alpha": settings.alpha},
            "target_m": self.target_m,
            "to_target": {name: run.measures() for name, run in self.runs["target"].items()},
            "turns": settings.turns if self.runs["follow"] else None,
            "along_stride": {name: self._along_stride(run) for name, run in self.runs["follow"].items()},
        }

    def _along_stride(self, run: Run) -> dict[str, Any]:
        closed, own = run.closures(), self.stride.q
        off_rad = run.q[::OVERSAMPLING][: len(own)] - own
        return {
            **run.measures(),
            **{f"least_closure_{kind}_percent": float(np.fmin.reduce(of)) for kind, of in closed.items()},
            "joints_off_rad": float(np.sqrt(np.nanmean(off_rad**2))),
            **{f"closure_{kind}_percent": by_name(self.limb.names, of.tolist()) for kind, of in closed.items()},
        }


# -- the animal's chain ----------------------------------------------------------------------------------------------


def limb_of(motion: Motion, foot: str | None = None, dim: Dim = 3, limited: bool = True) -> Limb:
    """The chain to a foot, by its label (LF) or joint, by default the first fore foot. Raises InputError.

    Of the 8U chain that is the spine and the front leg. Of a whole animal, in space, all joints from the root to the
    foot, and in the plane the joints' projections onto the vertical plane of travel.
    """
    label = _foot_label(motion, foot)
    name = motion.foot_names[label]
    travel, first_s = animal.body_travel(motion.states), float(motion.time_s[0])
    if isinstance(motion.chain, Chain):
        leg = animal.spine_front_leg(motion.chain, motion.size * motion.chain.nominal_base_length_m, dim, limited)
        q = animal.chain_angles(motion.chain, motion.states, dim=dim)
        return Limb(name, leg, q, motion.fps, first_s, "UVW", 0.0)
    if dim == 3:
        marker = motion.joints[motion.names.index(name)]
        chain = animal.body_chain(motion.body, marker, motion.size, limited)
        q = animal.body_chain_angles(motion.body, marker, motion.states)
        return Limb(name, chain, q, motion.fps, first_s, "xyz", 0.0)
    along = next(along for along in limb_chains(motion).values() if along[-1] == name)
    points = motion.upright.xyz_m[:, [motion.names.index(joint) for joint in along]]
    chain, q, misfit = animal.projected_chain(points, travel)
    named = replace(chain, names=tuple(along[:-1]))
    return Limb(name, named, q, motion.fps, first_s, "UVW", float(np.nanmedian(misfit)))


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
    limb: Limb,
    names: tuple[str, ...],
    parameters: Mapping[str, ways.ParameterFit],
    fitted: bool = False,
    cost: ways.Cost | None = None,
    alpha: float | Literal["step"] | None = None,
) -> dict[str, ways.Method]:
    """The methods by name (`METHODS`, `EXTENDED`), with their standard parameters, or those fitted to the clip
    (`fit_parameters`). Weights have no standard, and are fitted in any case.

    cost: of `EXTENDED`, which needs one, and of gradient projection, by default the joint differences. alpha: a factor
    on all rates, or "step" for the one of each step with which the foot moves nearest to what is asked for.
    """

    def method(name: str) -> ways.Method:
        if name == EXTENDED and cost is not None:
            return ways.ExtendedJacobian(cost)
        if name.startswith("extended-"):
            return ways.ExtendedJacobian(COSTS[name.removeprefix("extended-")](limb))
        if name == "gradient-projection" and not fitted:
            return ways.GradientProjection(cost or ways.joint_differences(limb.chain))
        return parameters[name].method if fitted or name == "weighted" else ways.STANDARD[name]

    chosen = {name: method(name) for name in names}
    if alpha is None:
        return chosen
    return {name: replace(one, alpha=None if alpha == "step" else alpha) for name, one in chosen.items()}


def cost_of(limb: Limb, text: str) -> ways.Cost:
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
    return ways.weighted_sum(costs, weights)


def fit_parameters(limb: Limb, cost: ways.Cost | None = None) -> dict[str, ways.ParameterFit]:
    """By method, by least squares to the joint rates of the clip, from a spline through its angles. cost: of gradient
    projection; None: any constant vector. Raises InputError for fewer than four frames in a row."""
    frames, _ = _rates_of(limb)
    return {name: fit(frames) for name, fit in ways.fits(() if cost is None else (cost,)).items()}


def fit_parameter_series(
    limb: Limb, stride: animal.StridePath, cost: ways.Cost | None = None, last: int = 0
) -> tuple[pd.DataFrame, dict[str, list[ways.Method]]]:
    """The same fitted to each frame of a stride by itself, or to the `last` ones before it: the methods, and a row for
    each frame: time_s in the clip, and of every method its parameter (`PARAMETERS`; one for each joint where there are
    as many), <method>_best_alpha, and <method>_explained, of the frame's own rates.

    cost: of gradient projection; by default, where a frame stands by itself, the joint differences, of which k is
    fitted. Raises InputError as `fit_parameters`.
    """
    frames, at_s = _rates_of(limb)
    first, stop = np.searchsorted(at_s, [stride.start_s - 1e-6, stride.end_s + 1e-6]).tolist()
    costs = (cost or ways.joint_differences(limb.chain),) if cost is not None or not last else ()
    columns, methods = {"time_s": limb.first_s + at_s[first:stop]}, {}
    for name, fit in ways.fits(costs, ways.PULL).items():
        rows = [slice(max(t - last, 0), max(t, 1)) if last else slice(t, t + 1) for t in range(first, stop)]
        found = [fit(frames[window]) for window in rows]
        methods[name] = [one.method for one in found]
        values = np.array([one.parameter for one in found])
        called = limb.names if values.shape[1] == limb.chain.n else ways.PARAMETERS.get(name, ())
        columns |= {f"{name}_{part}": of_part for part, of_part in zip(called, values.T, strict=True)}
        columns[f"{name}_best_alpha"] = np.array([one.alpha for one in found])
        own = zip(methods[name], (frames[t : t + 1] for t in range(first, stop)), strict=True)
        columns[f"{name}_explained"] = np.array([ways.explained_by(ways.rates_of(one, of), of.dq) for one, of in own])
    return pd.DataFrame(columns), methods


def _rates_of(limb: Limb) -> tuple[ways.Frames, Array]:
    """The frames with a pose, and their times (T,) from the first frame on."""
    known = np.flatnonzero(np.isfinite(limb.q).all(axis=1))
    if len(known) < MIN_POINTS:
        raise InputError(Problem("results", "frames", f"{len(known)} with a pose", f"at least {MIN_POINTS}"))
    q, at_s = limb.q[known], known / limb.fps
    dq = CubicSpline(at_s, q)(at_s, 1)
    return ways.Frames.of(limb.chain, q, (limb.chain.jacobian(q) @ dq[..., None])[..., 0], dq), at_s


# -- the jobs --------------------------------------------------------------------------------------------------------


def run_ik(settings: IkSettings) -> _IKRun:
    """`recon ik`: tables and figures into a folder. With parameters fitted to the clip, these are fitted to each frame
    of the stride, too. Raises InputError."""
    out, motion = settings.out_folder, usable(Motion.load(settings.folder), settings.folder, settings.anyway)
    with sole_writer(out):
        require_free_folder(out, (SUMMARY,), settings.overwrite)
        limb = limb_of(motion, settings.foot, 2 if settings.dim == 2 else 3, settings.limits)
        chain, cost = limb.chain, None if settings.cost is None else cost_of(limb, settings.cost)
        target = STRIDE_MAX if settings.both else settings.target
        goal = _coordinates(target, chain.dim) if target not in (None, STRIDE_MAX) else None
        with threadpool_limits(1, user_api="blas"):
            stride, parameters = stride_of(motion, limb, settings.stride), fit_parameters(limb, cost)
            fitted = settings.fitted or settings.online
            series, refitted = None, {}
            if fitted:
                series, refitted = fit_parameter_series(limb, stride, cost, LAST if settings.online else 0)
            methods = methods_of(limb, settings.methods, parameters, fitted, cost, settings.alpha)
            start, foremost = animal.farthest_reach(chain, stride.q)
            goal = foremost if target == STRIDE_MAX else goal
            drives = {} if goal is None else {n: drive_to(chain, start, goal, m) for n, m in methods.items()}
            followed = methods if settings.both or settings.follow is not None else {}
            each = {n: refitted.get(n, ()) if settings.online else () for n in followed}
            follows = {n: follow_stride(chain, stride, m, settings.turns, each[n]) for n, m in followed.items()}
        solved = _IKRun(settings, motion, limb, stride, goal, {"target": drives, "follow": follows}, parameters, series)
        with staged_folder(out) as staging:
            _write(solved, staging)
        if settings.figures:  # after the tables, which are there whatever befalls them
            with staged_folder(out) as staging:
                write_figures(solved, staging)
    return solved


def _coordinates(target: str, dim: int) -> Array:
    try:
        values = np.array(target.split(","), float)
    except ValueError:
        values = np.empty(0)
    if len(values) != dim or not np.isfinite(values).all():
        expected = f"{STRIDE_MAX}, or {dim} coordinates in metres, as in {'0.8,0.3,0.1'[: 4 * dim - 1]}"
        raise InputError(Problem("--target", "target", repr(target), expected))
    return values


def stride_of(motion: Motion, limb: Limb, stride_s: tuple[float, float] | None = None) -> animal.StridePath:
    """The stride that is given; or the first of the foot that counts (`recon.gait.gait`); or, of a clip without any,
    where the foot comes back to nearest in the time that a stride takes. Raises InputError for a clip that shows too
    little."""
    found, how, notes, lasts_s = None, "", [], (0.0, np.inf)
    if stride_s is not None:
        found, how = stride_given(motion, stride_s), "given"
    else:
        gait = ClipAnalysis(motion).gait
        assert gait is not None  # the limb has a foot
        label = next(label for label, joint in motion.foot_names.items() if joint == limb.foot)
        notes = [doubtful_text(doubt) for doubt in gait.doubtful if doubt.foot == label]
        if not motion.jitters:  # of poses that jitter, touch-downs are told worse than the pose's return is
            found = next((s for s in gait.strides if s.foot == label), None)
        if found is None:
            lasts_s = stride_lasts_s(gait)
        else:
            how = "gait"
    span_s = None if found is None else (found.start_s - limb.first_s, found.end_s - limb.first_s)
    try:
        stride = animal.find_stride(limb.chain, limb.q, limb.fps, span_s, lasts_s)
    except ValueError as error:
        raise InputError(Problem(motion.file, "stride", str(error), "a clip that shows more of one")) from None
    return replace(stride, how=how or stride.how, notes=tuple(notes))


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


def follow_stride(
    chain: SerialChain, stride: animal.StridePath, method: ways.Method, turns: int = 1, each: Sequence[ways.Method] = ()
) -> Run:
    """Along the stride, `SLOWER` than the animal; times and rates are the animal's again. The extended Jacobian starts
    where its cost is stationary, with the foot in the same place. each: a method for every frame of the stride."""
    q0, steps = stride.q[0], len(stride.path_m) - 1
    if isinstance(method, ways.ExtendedJacobian):
        q0 = to_null_space_optimum(chain, q0, method.cost)[0]

    def of_step(k: int) -> ways.Method:
        return each[min(k % steps // OVERSAMPLING, len(each) - 1)]

    run = follow(chain, q0, stride.path_m, of_step if each else method, turns, SLOWER * stride.interval_s)
    return replace(run, dq=SLOWER * run.dq, interval_s=stride.interval_s)


# -- what is written -------------------------------------------------------------------------------------------------


def _write(solved: _IKRun, folder: Path) -> None:
    summary, names = solved.summary, solved.limb.names
    tables: dict[str, pd.DataFrame] = {}
    for file, rows in (("target.csv", summary["to_target"]), ("follow.csv", summary["along_stride"])):
        if rows:
            cells = [{k: _cell(v) for k, v in row.items() if not isinstance(v, dict)} for row in rows.values()]
            tables[file] = pd.DataFrame(cells, pd.Index(rows, name="method"))
    if follows := solved.runs["follow"]:
        closed = {f"{name}_{kind}": of for name, run in follows.items() for kind, of in run.closures().items()}
        tables["closures.csv"] = pd.DataFrame(closed, pd.Index(names, name="joint"))
    if solved.series is not None:
        tables["parameters.csv"] = solved.series.set_index("time_s")
    ends = [f"end_{axis}_m" for axis in solved.limb.base[: solved.limb.chain.dim]]
    columns = ["time_s", *(f"{joint}_rad" for joint in names), *control_columns(names), *ends, "distance_m"]
    for job, runs in solved.runs.items():
        for name, run in runs.items():
            time_s = run.time_s + (0.0 if run.driven else solved.begins_s)
            values = np.column_stack((time_s, run.q, *run.control, run.end_m, run.distance_m))
            steps = pd.RangeIndex(len(values), name="step")
            tables[f"{job}_{name}.csv"] = pd.DataFrame(values, steps, columns)
    for file, table in tables.items():
        table.to_csv(folder / file, lineterminator="\n")
    (folder / SUMMARY).write_text(to_json(summary), encoding="utf-8")


def _cell(value: Any) -> Any:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return " ".join(value) if isinstance(value, list) else value


def write_figures(solved: _IKRun, folder: Path) -> None:
    """Paths in task and joint space, and phase portraits with closures by method, PNG and SVG."""
    from recon.show.plots.phase import phase_portraits
    from recon.show.plots.style import save
    from recon.wings.robotics.ik import plots

    limb, aims = solved.limb, {"target": solved.target_m, "follow": solved.stride.path_m}
    for job, runs in solved.runs.items():
        if runs:
            save(plots.task_space(runs, limb.chain, aims[job], limb.base), folder, f"{job}_task_space")
            save(plots.joint_space(runs, limb.names), folder, f"{job}_joint_space")
    for name, run in solved.runs["follow"].items():
        of_joints = zip(run.q.T, run.control[0].T, strict=True)
        portraits = [Portrait(solved.begins_s + run.time_s, angle, rate) for angle, rate in of_joints]
        closed = [Closure(*one) for one in zip(*run.closures().values(), strict=True)]
        figure = phase_portraits(by_name(limb.names, portraits), by_name(limb.names, closed), name)
        save(figure, folder, f"follow_phase_{name}")
