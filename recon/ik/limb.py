"""Extract a limb from a fitted clip: its chain, joint angles and stride, and the method parameters that fit it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from recon.animal.chain import Chain
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, raise_problems
from recon.fit.motion import Motion
from recon.gait.clip import ClipAnalysis, limb_chains, stride_given
from recon.gait.gait import MAX_DURATION_DIFFERENCE, Gait, Stride, rejection_text
from recon.gait.kinematics import angle_kinematics
from recon.gait.phase import Portrait, phase_portrait
from recon.gait.series import jitter_errors
from recon.gait.spline import MIN_POINTS
from recon.ik.animal_chain import (
    body_chain,
    body_chain_angles,
    body_travel,
    chain_angles,
    projected_chain,
    spine_front_leg,
)
from recon.ik.chain import SerialChain
from recon.ik.costs import Cost, harmonic_map, joint_differences, pose_distance, rotational_energy, weighted_sum
from recon.ik.drive import Run, follow
from recon.ik.methods import STANDARD, ExtendedJacobian, GradientProjection, Method, best_scale
from recon.ik.null_space import to_null_space_optimum
from recon.ik.parameters import EQUAL_WEIGHT_PULL, PARAMETERS, Frames, ParameterFit, explained_by, fits, rates_of
from recon.ik.settings import EXTENDED
from recon.ik.stride import OVERSAMPLING, StridePath, find_stride

Dim = Literal[2, 3]
SLOWDOWN = 10
"""Factor by which a stride is followed more slowly than the animal ran it.

The rate limits of the animal's joints would restrict a method that uses the joints differently. The degrees of closure
do not depend on the factor.
"""
CONSTANT_VECTOR = "constant-vector"
"""Name of gradient projection along a constant vector g in the parameter tables."""
VECTORS = (CONSTANT_VECTOR, "gradient-projection")
"""Names of the methods whose fitted parameter can be a vector g, with a component for each joint."""
EXTENDED_COSTS = ("extended-differences", "extended-energy", "extended-harmonic")
REFIT_FRAMES = 3
"""Number of previous frames to which `--online` refits the parameters at each frame of the stride."""


@dataclass(frozen=True, eq=False)
class Limb:
    """A chain from the animal's root to a foot, with its joint angles in the clip."""

    foot: str
    chain: SerialChain
    q: Array
    """Joint angles, shape (T, n), rad."""
    fps: float
    first_s: float
    """Time of the clip's first frame, seconds."""
    base: Literal["UVW", "xyz"]
    """Meaning of the base frame's axes: U forwards, V down and W left, or x forwards, y left and z up."""
    base_at: str
    """Description of the animal's point at which the chain begins, which is the origin of the base frame."""
    misfit_m: float
    """Median distance of the chain's end from the foot, metres."""


COSTS: dict[str, Callable[[Limb], Cost]] = {
    "differences": lambda limb: joint_differences(limb.chain),
    "energy": lambda limb: rotational_energy(limb.chain),
    "harmonic": lambda limb: harmonic_map(joints=max(limb.chain.groups, key=len)[-3:]),
    "pose": lambda limb: pose_distance(np.nanmean(limb.q, axis=0)),
}


def limb_of(motion: Motion, foot: str | None = None, dim: Dim = 3, limited: bool = True) -> Limb:
    """Return the chain to a foot, given by its label (LF) or joint; by default the first fore foot.

    The chain of the 8U skeleton has the spine and the front leg. The chain of a whole animal has all joints from the
    root to the foot in space. In the plane, it has the joints' projections onto the vertical plane of the direction of
    travel.

    Raises
    ------
    InputError
        If the skeleton has no such foot.
    """
    label = _foot_label(motion, foot)
    name = motion.foot_names[label]
    base: Literal["UVW", "xyz"] = "UVW"
    misfit = np.zeros(1)
    if isinstance(motion.chain, Chain):
        chain = spine_front_leg(motion.chain, motion.size * motion.chain.nominal_base_length_m, dim, limited)
        q = chain_angles(motion.chain, motion.states, dim=dim)
        base_at = motion.chain.links[0].start
    elif dim == 3:
        marker, base = motion.joints[motion.names.index(name)], "xyz"
        chain = body_chain(motion.body, marker, motion.size, limited)
        q = body_chain_angles(motion.body, marker, motion.states)
        base_at = f"the beginning of {motion.body.tree.segments[0].name}"
    else:
        along = next(along for along in limb_chains(motion).values() if along[-1] == name)
        points = motion.upright.xyz_m[:, [motion.names.index(joint) for joint in along]]
        chain, q, misfit = projected_chain(points, body_travel(motion.states))
        chain = replace(chain, names=tuple(along[:-1]))
        base_at = along[0]
    return Limb(name, chain, q, motion.fps, float(motion.time_s[0]), base, base_at, float(np.nanmedian(misfit)))


def _foot_label(motion: Motion, foot: str | None) -> str:
    """Return the label of a foot (LF, RF, LH or RH), given by its label or joint; by default the first fore foot."""
    fore = [label for label in motion.foot_names if label.endswith("F")]
    labels = fore if motion.body.one_sided else list(motion.foot_names)
    if foot is None and labels:
        return fore[0] if fore else labels[0]
    chosen = next((label for label in labels if foot in (label, motion.foot_names[label])), None)
    if chosen is None:
        expected = ", ".join(f"{label} ({motion.foot_names[label]})" for label in labels) or "a skeleton with feet"
        raise InputError(Problem("--foot", "foot", repr(foot or "none"), expected))
    return chosen


def methods_of(
    limb: Limb,
    names: tuple[str, ...],
    parameters: Mapping[str, ParameterFit],
    fitted: bool = False,
    cost: Cost | None = None,
    alpha: float | Literal["step"] | None = None,
) -> dict[str, Method]:
    """Build the requested methods of inverse kinematics, with standard or fitted parameters.

    Weights have no standard values, and are always fitted.

    Parameters
    ----------
    limb
        The limb that is moved.
    names
        Names of the requested methods, from `METHODS` and `EXTENDED`.
    parameters
        Fitted parameters of each method, from `fit_parameters`.
    fitted
        Whether to use the fitted parameters instead of the standard ones.
    cost
        Cost of `EXTENDED`, which needs one, and of gradient projection, whose default is the joint differences.
    alpha
        Factor on all rates, or "step" for the factor with which the foot's motion is closest to the requested one.
    """
    costs = {name: COSTS[name.removeprefix("extended-")](limb) for name in names if name.startswith("extended-")}
    costs |= {} if cost is None else {EXTENDED: cost}
    standard = STANDARD | {name: ExtendedJacobian(stationary) for name, stationary in costs.items()}
    standard["gradient-projection"] = GradientProjection(cost or joint_differences(limb.chain))
    best = {name: fit.method for name, fit in parameters.items()}
    every = standard | best if fitted else best | standard
    chosen = {name: every[name] for name in names}
    if alpha is None:
        return chosen
    return {name: replace(method, alpha=None if alpha == "step" else alpha) for name, method in chosen.items()}


def cost_of(limb: Limb, text: str) -> Cost:
    """Build a cost from a string that names one of `COSTS`, or a weighted sum such as "energy,differences=0.1".

    Raises
    ------
    InputError
        If a part of the text does not name a cost, or its weight is not a number.
    """
    costs, weights, problems = [], [], []
    for part in text.split(","):
        name, _, weight = part.strip().partition("=")
        try:
            weights.append(float(weight or 1))
            costs.append(COSTS[name](limb))
        except (ValueError, KeyError):
            expected = f"{', '.join(COSTS)}, or a sum with weights, such as energy,differences=0.1"
            problems.append(Problem("--cost", "cost", repr(part), expected))
    raise_problems(problems)
    return weighted_sum(costs, weights)


def fit_parameters(limb: Limb, cost: Cost | None = None) -> dict[str, ParameterFit]:
    """Fit the parameters of each method by least squares to the joint rates of the clip.

    The rates are the derivatives of a spline through the angles. `cost` is the cost of gradient projection; None stands
    for any constant vector.

    Raises
    ------
    InputError
        If the clip has fewer than four consecutive frames.
    """
    frames, _ = _rates_of(limb)
    return {name: fit(frames) for name, fit in fits(() if cost is None else (cost,)).items()}


def vector_names(joints: Sequence[str]) -> list[str]:
    """Return the column names, such as "g1_theta_9", of the vector g of gradient projection, one for each joint."""
    return [f"g{k}_{joint}" for k, joint in enumerate(joints, 1)]


def fit_parameter_series(
    limb: Limb, stride: StridePath, cost: Cost | None = None, last: int = 0
) -> tuple[pd.DataFrame, dict[str, list[Method]]]:
    """Fit the parameters of each method to each frame of a stride, or to the `last` frames before each frame.

    `cost` is the cost of gradient projection. For single frames, its default is the joint differences, with k fitted.
    The table then also has the smallest constant g (`CONSTANT_VECTOR`). The extended Jacobian has no parameter besides
    the factor alpha.

    Returns
    -------
    tuple
        A table with a row for each frame, and the fitted methods: for each method name, a list with one method for each
        frame. The columns are time_s, the time in the clip, and for every method the parameter (`PARAMETERS`, or a
        column for each joint, with `vector_names` for g), <method>_best_alpha, and <method>_explained, the explained
        fraction of the frame's squared joint rates.

    Raises
    ------
    InputError
        If the clip has fewer than four frames with a pose.
    """
    frames, at_s = _rates_of(limb)
    first, stop = np.searchsorted(at_s, [stride.start_s - 1e-6, stride.end_s + 1e-6]).tolist()
    costs = (cost or joint_differences(limb.chain),) if cost is not None or not last else ()
    columns, methods = {"time_s": limb.first_s + at_s[first:stop]}, {}
    every = fits(costs, EQUAL_WEIGHT_PULL)
    if costs:
        every[CONSTANT_VECTOR] = fits()["gradient-projection"]
    for name, fit in every.items():
        rows = [slice(max(t - last, 0), max(t, 1)) if last else slice(t, t + 1) for t in range(first, stop)]
        fitted = [fit(frames[window]) for window in rows]
        methods[name] = [result.method for result in fitted]
        values = np.array([result.parameter for result in fitted])
        part_names: Sequence[str] = PARAMETERS.get(name, ())
        if values.shape[1] == limb.chain.n:
            part_names = vector_names(limb.chain.names) if name in VECTORS else limb.chain.names
        columns |= {f"{name}_{part}": column for part, column in zip(part_names, values.T, strict=True)}
        columns[f"{name}_best_alpha"] = np.array([result.alpha for result in fitted])
        by_frame = zip(methods[name], (frames[t : t + 1] for t in range(first, stop)), strict=True)
        columns[f"{name}_explained"] = np.array(
            [explained_by(rates_of(method, frame), frame.dq) for method, frame in by_frame]
        )
    for name in EXTENDED_COSTS:
        method = ExtendedJacobian(COSTS[name.removeprefix("extended-")](limb))
        rates = [rates_of(method, frames[t : t + 1]) for t in range(first, stop)]
        measured = [frames[t : t + 1].dq for t in range(first, stop)]
        pairs = list(zip(rates, measured, strict=True))
        columns[f"{name}_best_alpha"] = np.array([best_scale(*pair) for pair in pairs])
        columns[f"{name}_explained"] = np.array([explained_by(*pair) for pair in pairs])
    return pd.DataFrame(columns), methods


def animal_portraits(motion: Motion, limb: Limb, stride: StridePath) -> dict[str, Portrait]:
    """Return phase portraits of the animal's own joints over a stride, smoothed as in the analysis."""
    time_s = limb.first_s + np.arange(len(limb.q)) / limb.fps
    ends = limb.first_s + stride.start_s, limb.first_s + stride.end_s
    portraits = {}
    for name, angle in zip(limb.chain.names, limb.q.T, strict=True):
        errors = jitter_errors(angle) if motion.jitters else ()
        portraits[name] = phase_portrait(angle_kinematics(time_s, angle, errors, smooth=motion.jitters), *ends)
    return portraits


def _rates_of(limb: Limb) -> tuple[Frames, Array]:
    """Return the T frames with a pose, with their joint rates, and their times (T,), seconds since frame 0."""
    known = np.flatnonzero(np.isfinite(limb.q).all(axis=1))
    if len(known) < MIN_POINTS:
        raise InputError(
            Problem("results", "frames", f"{len(known)} frames with a pose", f"at least {MIN_POINTS} frames")
        )
    q, at_s = limb.q[known], known / limb.fps
    dq = CubicSpline(at_s, q)(at_s, 1)
    return Frames.without_gaps(limb.chain, q, (limb.chain.jacobian(q) @ dq[..., None])[..., 0], dq), at_s


def stride_of(motion: Motion, limb: Limb, stride_s: tuple[float, float] | None = None) -> StridePath:
    """Return the path of a limb over a given stride, or over a stride found in the clip.

    For a skeleton that is a chain of links, the stride of the analysis is used, and for a whole animal the foot's first
    valid stride. The stride is the same in two and three dimensions. In a clip without a valid stride
    (`recon.gait.gait`), the foot's closest return is used, or the whole clip. For a whole animal, the return must last
    about as long as a stride.

    Raises
    ------
    InputError
        If the clip shows too little of a stride.
    """
    notes: list[str] = []
    if stride_s is not None:
        stride, duration_range_s = stride_given(motion, stride_s), None
    elif isinstance(motion.chain, Chain):
        # The analysis and the chains in two and three dimensions share this stride, so their results are comparable.
        stride, duration_range_s = ClipAnalysis(motion).stride, None
    else:
        gait = ClipAnalysis(motion).gait
        assert gait is not None  # a limb has a foot, and feet have a gait
        label = next(label for label, joint in motion.foot_names.items() if joint == limb.foot)
        notes = [rejection_text(stride) for stride in gait.rejected_strides if stride.foot == label]
        stride = next((s for s in gait.strides if s.foot == label), None)
        duration_range_s = stride_duration_range_s(gait)
    path = _path_of(motion, limb, stride, duration_range_s)
    return replace(path, notes=tuple(notes))


def _path_of(
    motion: Motion, limb: Limb, stride: Stride | None, duration_range_s: tuple[float, float] | None
) -> StridePath:
    """Return the path that a limb's foot follows over a stride.

    If no stride is given, the foot's closest return in space with a duration in the given range is used, or the whole
    clip if the range is None. If the clip shows too little of a stride, InputError is raised.
    """
    try:
        if stride is not None:
            span_s = stride.start_s - limb.first_s, stride.end_s - limb.first_s
            return replace(find_stride(limb.chain, limb.q, limb.fps, span_s), origin=stride.origin)
        if duration_range_s is None:
            return find_stride(limb.chain, limb.q, limb.fps, duration_range_s=None)
        in_space = limb if limb.chain.dim == 3 else limb_of(motion, limb.foot, 3)
        path = find_stride(in_space.chain, in_space.q, limb.fps, duration_range_s=duration_range_s)
        if in_space is limb:
            return path
        return replace(find_stride(limb.chain, limb.q, limb.fps, (path.start_s, path.end_s)), origin=path.origin)
    except ValueError as error:
        raise InputError(Problem(motion.file, "stride", str(error), "a clip with a longer part of a stride")) from None


def stride_duration_range_s(gait: Gait) -> tuple[float, float]:
    """Return the shortest and longest possible duration of a stride if the clip has no complete one, in seconds.

    Both durations are close to the one that the gait suggests, if it is shorter than the clip. Otherwise, if no
    foot lands twice, the stride lasts at least from the first touch-down to the end of the clip, to within half a
    frame.
    """
    time_s = gait.tracks.time_s
    if 0 < gait.stride_s < time_s[-1] - time_s[0]:
        return (1 - MAX_DURATION_DIFFERENCE) * gait.stride_s, (1 + MAX_DURATION_DIFFERENCE) * gait.stride_s
    landed = [s for s in gait.stances if s.begins]
    if len({s.foot for s in landed}) < len(landed):
        return 0.0, np.inf
    first_s = min((s.start_s for s in landed), default=time_s[-1])
    return float(time_s[-1] - first_s - OVERSAMPLING / 2 * (time_s[1] - time_s[0])), np.inf


def follow_stride(
    chain: SerialChain, stride: StridePath, method: Method, turns: int = 1, by_frame: Sequence[Method] = ()
) -> Run:
    """Follow the stride `SLOWDOWN` times more slowly than the animal, and convert times and rates back to the animal's.

    The extended Jacobian starts at a stationary point of its cost, with the foot at the same position. `by_frame` has
    one method for every frame of the stride, and replaces `method` unless it is empty.
    """
    q0, steps = stride.q[0], len(stride.path_m) - 1
    if isinstance(method, ExtendedJacobian):
        q0 = to_null_space_optimum(chain, q0, method.cost)[0]

    def method_at(k: int) -> Method:
        return by_frame[min(k % steps // OVERSAMPLING, len(by_frame) - 1)]

    run = follow(chain, q0, stride.path_m, method_at if by_frame else method, turns, SLOWDOWN * stride.interval_s)
    return replace(run, dq=SLOWDOWN * run.dq, interval_s=stride.interval_s)
