"""Inverse kinematics on a fitted clip: its chain from the trunk to a foot is driven to a target, or along a stride."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import degrees
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from pydantic import Field
from rich.table import Table
from scipy.interpolate import CubicSpline
from threadpoolctl import threadpool_limits

from recon.animal.chain import Chain
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, raise_problems
from recon.base.files import require_free_folder, sole_writer, staged_folder
from recon.base.settings import Integer, Number, Option, Settings
from recon.check import usable, verdict_fields
from recon.fit.motion import Motion
from recon.gait.clip import ClipAnalysis, limb_chains, stride_given
from recon.gait.gait import AGREE, OVERSAMPLING, Gait, doubtful_text
from recon.gait.kinematics import MIN_POINTS
from recon.gait.phase import Closure, Portrait
from recon.ik import chain as chains
from recon.ik import methods as ways
from recon.ik.chain import SerialChain
from recon.ik.methods import Run, control_columns, drive_to, follow, to_null_space_optimum
from recon.show.plain import by_name, picked, to_json
from recon.show.plots import style
from recon.show.plots.over_time import phase_portraits
from recon.workflows.cli import ANYWAY, STRIDE, Answer, StrideTimes, table_of, verdict_texts

Extended = Literal["extended-differences", "extended-energy", "extended-harmonic"]


MethodName = Literal[
    "least-norm", "transpose", "gradient-projection", "weighted", "damped", "selectively-damped", Extended, "extended"
]


EXTENDED = "extended"
"""The extended Jacobian with the cost that is asked for."""


METHODS: tuple[str, ...] = tuple(name for name in get_args(MethodName) if name != EXTENDED)


STRIDE_MAX = "stride-max"


class IkSettings(Settings):
    """What `recon ik` is told."""

    folder: Annotated[Path, Option(argument="DIR")]
    """Folder of results, as in results/clip."""
    method: Annotated[
        MethodName,
        Option(
            f"{', '.join(METHODS)}, or {EXTENDED} with --cost.",
            f"{', '.join(METHODS)}, or {EXTENDED} with --cost",
            metavar="METHOD",
        ),
    ] = "damped"
    target: str | None = None
    """Drive the foot there: stride-max, its foremost place in the stride, from its rearmost; or x,y,z in metres from
    the chain's base, as in 0.8,0.1,-0.5."""
    follow: Literal["stride"] | None = None
    """Follow a path with the foot: stride, one of its own, closed."""
    compare: bool = False
    """All methods in one table; both jobs unless one is asked for."""
    foot: Annotated[str | None, Option(metavar="FOOT")] = None
    """LF, RF, LH, RH, or the joint's name. (default: the first fore foot)"""
    stride: Annotated[StrideTimes | None, STRIDE] = None
    dim: Annotated[Integer, Field(ge=2, le=3)] = 3
    """2: in the vertical plane of travel; 3: in space."""
    turns: Annotated[Integer, Field(ge=1)] = 1
    """How often to follow the stride."""
    limits: bool = True
    """Limits of the joints."""
    fitted: bool = False
    """With the methods' parameters fitted to this clip; also fits them to each frame of the stride."""
    online: bool = False
    """Along the stride, parameters refitted at every frame to the animal's joint rates just before."""
    cost: str | None = None
    """Cost of the methods extended and gradient-projection: differences, energy, harmonic, pose (distance from the
    clip's mean pose), or a sum with weights, as in energy,differences=0.1."""
    alpha: Annotated[Literal["step"] | Number | None, Option(expected="step, or a number other than 0")] = None
    """Factor on the joints' rates of every method: a number, or step, at every step the one with which the foot moves
    nearest to what is asked for. (default: none)"""
    out: Path | None = None
    """Folder for tables and figures. (default: ik in DIR)"""
    figures: bool = True
    """PNG and SVG beside the tables."""
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: bool = False
    """Replace earlier ones."""

    @property
    def methods(self) -> tuple[str, ...]:
        """The names of the methods that are run."""
        own = () if self.cost is None else (EXTENDED,)
        return (*METHODS, *own) if self.compare else (self.method,)

    @property
    def parameters(self) -> str:
        """Which parameters the methods have, in words."""
        return "refitted at every frame" if self.online else "fitted to the clip" if self.fitted else "standard"

    @property
    def both(self) -> bool:
        """Whether no single job is asked for."""
        return self.target is None and self.follow is None

    @property
    def out_folder(self) -> Path:
        return self.folder / "ik" if self.out is None else self.out

    def problems(self) -> Iterator[Problem]:
        if self.both and not self.compare:
            yield Problem("options", "job", "none", "--target, --follow stride or --compare")
        if self.method == EXTENDED and self.cost is None:
            yield Problem("settings", "method", repr(EXTENDED), self.infos()["method"].expected())
        if self.alpha == 0:
            yield Problem("settings", "alpha", "0", self.infos()["alpha"].expected())


WIDE_GAP_PERCENT = 25


CLOSES_PERCENT = 90
"""Above what the joints' paths of a stride close to of methods that no limit stops."""


def ik(settings: IkSettings) -> Answer:
    """Inverse kinematics of the chain from the trunk to a foot: to a target, or along a stride.

    Example: recon ik results/clip --compare
    """
    done = run_ik(settings)
    lines = _ik_lines(done.summary, settings.out_folder)
    return Answer(done.summary, [*verdict_texts(done.motion.verdict), *lines])


def _ik_lines(summary: dict[str, Any], out: Path) -> Iterator[str | Table]:
    stride, driven, along = (summary[name] for name in ("stride", "to_target", "along_stride"))
    how = {
        "given": "as given",
        "gait": "from touchdown to touchdown",
        "return": "the clip has no complete one: the nearest return of the foot to the same place",
        "whole clip": "the clip has no complete one: the whole clip",
    }[stride["how"]]
    yield f"{summary['foot']}: {len(summary['joints'])} joints, {summary['dimensions']}D ({summary['base_frame']})"
    if summary["misfit_m"]:
        yield f"the chain's end lies {1000 * summary['misfit_m']:.0f} mm from the foot's projection (median)"
    gap = f"gap {1000 * stride['gap_m']:.0f} mm ({stride['gap_percent']:.1f} % of its extent), closed"
    yield f"stride: {stride['start_s']:.3f} to {stride['end_s']:.3f} s, {how}; {gap}"
    yield from (f"note: {note}" for note in stride["notes"])
    if stride["gap_percent"] > WIDE_GAP_PERCENT:
        yield "note: so wide a gap is not of one stride: a touchdown was missed, or the clip is too short"

    def table(rows: dict[str, Any], title: str, columns: dict[str, Callable[[Any], str]]) -> Table:
        every = ([name, *(cell(row) for cell in columns.values())] for name, row in rows.items())
        return table_of("method", numbers=columns, title=title, rows=every)

    def limits(row: dict[str, Any]) -> str:
        first, *others = row["limits_hit"] or ["-"]
        return first + (f" +{len(others)}" if others else "")

    def each(row: dict[str, Any]) -> str:
        return "-" if row["us_per_step"] is None else f"{row['us_per_step']:.0f}"

    if driven:
        columns = {
            "reached": lambda row: "yes" if row["reached"] else "no",
            "steps": lambda row: str(row["iterations"]),
            "µs each": each,
            "path m": lambda row: f"{row['length_m']:.2f}",
            "limits": limits,
        }
        yield table(driven, f"to ({', '.join(f'{x:.3f}' for x in summary['target_m'])}) m", columns)
        yield from (f"{name}: {row['reason']}" for name, row in driven.items() if not row["reached"])
    if along:
        least = [f"least_closure_{kind}_percent" for kind in ("angle", "plane")]
        columns = {
            "worst mm": lambda row: f"{1000 * row['worst_error_m']:.1f}",
            "µs each": each,
            "off °": lambda row: f"{degrees(row['joints_off_rad']):.0f}",
            "limits": limits,
            "closure %": lambda row: "/".join(f"{row[kind]:.1f}" for kind in least),
        }
        yield table(along, f"along the stride, turns: {summary['turns']}", columns)
        yield from (f"{name}: {row['note']}" for name, row in along.items() if row["note"])
        for name, row in along.items():
            if row["limits_hit"] and row[least[0]] < CLOSES_PERCENT:
                also = f"; then {', '.join(row['limits_hit'][1:])}" if row["limits_hit"][1:] else ""
                yield f"{name} does not close, stopped by {row['first_limit']}{also}"
        if any(row["limits_hit"] for row in along.values()):
            yield "What a method does without the limits of the joints: --no-limits."
        yield "closure: the least of any joint, of its angle/of angle and rate; off: the joints from the animal's"
    if driven or along:
        yield "limits: the first joint that one stopped, and how many more"
    parameters = summary["parameters"]
    explained = ", ".join(f"{name} {fit['explained']:.0%}" for name, fit in parameters["fitted"].items())
    yield f"parameters: {parameters['used']}. Fitted to the clip, they explain of its joint rates: {explained}"
    yield f"Tables and figures are in {out}."


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
    stride: chains.StridePath
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
            "joints": list(limb.chain.names),
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
            **{f"closure_{kind}_percent": by_name(self.limb.chain.names, of.tolist()) for kind, of in closed.items()},
        }


# -- the animal's chain ----------------------------------------------------------------------------------------------


def limb_of(motion: Motion, foot: str | None = None, dim: Dim = 3, limited: bool = True) -> Limb:
    """The chain to a foot, by its label (LF) or joint, by default the first fore foot. Raises InputError.

    Of the 8U chain that is the spine and the front leg. Of a whole animal, in space, all joints from the root to the
    foot, and in the plane the joints' projections onto the vertical plane of travel.
    """
    label = _foot_label(motion, foot)
    name = motion.foot_names[label]
    base: Literal["UVW", "xyz"] = "UVW"
    misfit = np.zeros(1)
    if isinstance(motion.chain, Chain):
        chain = chains.spine_front_leg(motion.chain, motion.size * motion.chain.nominal_base_length_m, dim, limited)
        q = chains.chain_angles(motion.chain, motion.states, dim=dim)
    elif dim == 3:
        marker, base = motion.joints[motion.names.index(name)], "xyz"
        chain = chains.body_chain(motion.body, marker, motion.size, limited)
        q = chains.body_chain_angles(motion.body, marker, motion.states)
    else:
        along = next(along for along in limb_chains(motion).values() if along[-1] == name)
        points = motion.upright.xyz_m[:, [motion.names.index(joint) for joint in along]]
        chain, q, misfit = chains.projected_chain(points, chains.body_travel(motion.states))
        chain = replace(chain, names=tuple(along[:-1]))
    return Limb(name, chain, q, motion.fps, float(motion.time_s[0]), base, float(np.nanmedian(misfit)))


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

    costs = {name: COSTS[name.removeprefix("extended-")](limb) for name in names if name.startswith("extended-")}
    costs |= {} if cost is None else {EXTENDED: cost}
    standard = ways.STANDARD | {name: ways.ExtendedJacobian(of) for name, of in costs.items()}
    standard["gradient-projection"] = ways.GradientProjection(cost or ways.joint_differences(limb.chain))
    own = {name: of.method for name, of in parameters.items()}
    every = standard | own if fitted else own | standard
    chosen = {name: every[name] for name in names}
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
    raise_problems(problems)
    return ways.weighted_sum(costs, weights)


def fit_parameters(limb: Limb, cost: ways.Cost | None = None) -> dict[str, ways.ParameterFit]:
    """By method, by least squares to the joint rates of the clip, from a spline through its angles. cost: of gradient
    projection; None: any constant vector. Raises InputError for fewer than four frames in a row."""
    frames, _ = _rates_of(limb)
    return {name: fit(frames) for name, fit in ways.fits(() if cost is None else (cost,)).items()}


def fit_parameter_series(
    limb: Limb, stride: chains.StridePath, cost: ways.Cost | None = None, last: int = 0
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
        called = limb.chain.names if values.shape[1] == limb.chain.n else ways.PARAMETERS.get(name, ())
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
            start, foremost = chains.farthest_reach(chain, stride.q)
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


def stride_of(motion: Motion, limb: Limb, stride_s: tuple[float, float] | None = None) -> chains.StridePath:
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
        stride = chains.find_stride(limb.chain, limb.q, limb.fps, span_s, lasts_s)
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
    chain: SerialChain, stride: chains.StridePath, method: ways.Method, turns: int = 1, each: Sequence[ways.Method] = ()
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
    summary, names = solved.summary, solved.limb.chain.names
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
    limb, aims = solved.limb, {"target": solved.target_m, "follow": solved.stride.path_m}
    for job, runs in solved.runs.items():
        if runs:
            style.save(task_space(runs, limb.chain, aims[job], limb.base), folder, f"{job}_task_space")
            style.save(joint_space(runs, limb.chain.names), folder, f"{job}_joint_space")
    for name, run in solved.runs["follow"].items():
        of_joints = zip(run.q.T, run.control[0].T, strict=True)
        portraits = [Portrait(solved.begins_s + run.time_s, angle, rate) for angle, rate in of_joints]
        closed = [Closure(*one) for one in zip(*run.closures().values(), strict=True)]
        figure = phase_portraits(by_name(limb.chain.names, portraits), by_name(limb.chain.names, closed), name)
        style.save(figure, folder, f"follow_phase_{name}")


# -- figures of ways to a target or along a path, by method ------------------------------------------------------------

VIEWS = {
    "UVW": (("side", 0, 1, "forwards (m)", "down (m)"), ("top", 0, 2, "forwards (m)", "to the left (m)")),
    "xyz": (("side", 0, 2, "forwards (m)", "up (m)"), ("top", 0, 1, "forwards (m)", "to the left (m)")),
}
"""The views of the base frames of `recon.ik.chain`: name, coordinates, and what the axes are called."""
_ROOM = 0.06


def task_space(
    moves: Mapping[str, Run],
    chain: SerialChain,
    aim_m: Array | None = None,
    base: Literal["UVW", "xyz"] = "UVW",
) -> Figure:
    """The end effector's paths by method: in the plane, or in space from the side and from above, with the chain as it
    stood at first and, of every method, at last.

    aim_m: the target (dim,), a cross, or the way that was to be followed (K, dim). base: what the coordinates mean,
    forwards, down and left or forwards, left and up; two are U and V.
    """
    labels, first = [f"{name}{_outcome(move)}" for name, move in moves.items()], next(iter(moves.values()))
    aims = () if aim_m is None else ("path to follow",) if aim_m.ndim == 2 else ("target",)
    said, start, stood_there, aim = ("start", "chain at the start", *aims), [], [], []
    with style.drawing(92 + style.legend_shape([*labels, *said])[1]) as figure:
        views = VIEWS[base][: chain.dim - 1]
        panels = np.ravel(figure.subplots(1, len(views), squeeze=False))
        for axes, (view, i, j, across, upwards) in zip(panels, views, strict=True):
            stood = {"color": style.GREY, "lw": 2.2, "alpha": 0.5, "marker": "o", "ms": 2, "zorder": 1}
            stood_there = axes.plot(*chain.positions(first.q[0])[:, [i, j]].T, **stood)
            if aim_m is not None and aim_m.ndim == 2:
                aim = axes.plot(*aim_m[:, [i, j]].T, color=style.PALE, lw=3.5, zorder=1, gid="path")
            elif aim_m is not None:
                aim = axes.plot(*aim_m[[i, j]], "+", color="k", ms=10, mew=1.2, zorder=5, gid="target")
            for k, move in enumerate(moves.values()):
                drawn = style.look(k)
                last = chain.positions(move.q[-1])[:, [i, j]]
                axes.plot(*last.T, **drawn, marker="o", ms=2, lw=0.7, alpha=0.8, zorder=2)
                axes.plot(*move.end_m[:, [i, j]].T, **drawn, zorder=3, label=labels[k])
                axes.plot(*move.end_m[-1, [i, j]], "o", ms=3.5, color=drawn["color"], zorder=4)
            start = axes.plot(*first.end_m[0, [i, j]], "o", mfc="w", mec="k", ms=5, zorder=5)
            axes.set_xlabel(across)
            axes.set_ylabel(upwards)
            axes.set_aspect("equal", adjustable="datalim")
            axes.margins(_ROOM)
            if upwards.startswith("down"):
                axes.invert_yaxis()
            if chain.dim == 3:
                axes.set_title(view, loc="left", fontsize=style.SMALL, color=style.GREY)
        ways, _ = panels[0].get_legend_handles_labels()
        style.add_legend(figure, [*ways, *start, *stood_there, *aim], [*labels, *said])
    return figure


def joint_space(moves: Mapping[str, Run], names: Sequence[str]) -> Figure:
    """Each joint's angle (deg) by method, over the iterations to a target or the time along a path. names (n,)."""
    n, driven = len(names), any(move.driven for move in moves.values())
    least, aspect = (3, 0.62) if n <= 6 else (5, 0.9)
    rows, columns = style.grid_shape(n, style.WIDTH_MM, aspect, least)
    labels = [f"{name}{_outcome(move)}" for name, move in moves.items()]
    with style.drawing(rows * aspect * style.WIDTH_MM / columns + 14 + style.legend_shape(labels)[1]) as figure:
        panels = figure.subplots(rows, columns, sharex=True, squeeze=False).ravel()
        for joint, axes in enumerate(panels[:n]):
            for k, move in enumerate(moves.values()):
                along = np.arange(len(move.q)) if driven else move.time_s
                axes.plot(along, np.degrees(move.q[:, joint]), **style.look(k))
            axes.set_title(names[joint], fontsize=style.SMALL, pad=2)
            axes.locator_params(axis="y", nbins=4)
        for axes in panels[n:]:
            axes.set_axis_off()
        for axes in panels[max(0, n - columns) : n]:
            axes.set_xlabel("iteration" if driven else "time (s)")
            axes.tick_params(labelbottom=True)
        figure.supylabel("angle (deg)", fontsize=8)
        style.add_legend(figure, panels[0].get_lines(), labels)
    return figure


def _outcome(move: Run) -> str:
    """What did not go as it should, in a few words."""
    if not move.note:
        return ""
    what = move.note.split(":")[0].split(" (")[0]
    return f" (not reached, {what})" if move.driven else f" ({what})"
