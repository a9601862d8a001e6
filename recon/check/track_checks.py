"""Check tracks of points in 2D or 3D: copied, frozen and interpolated points, jumps, swapped sides, missing frames.

The checks use only the coordinates and the names of the points. Coordinates that are equal to the last digit were
copied. The vector from a right point to its left counterpart (side vector) turns slowly, and is suddenly reversed at a
swap of the sides.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import gamma

import numpy as np

from recon.animal.body import side_of
from recon.base.arrays import Array, Bools, Index
from recon.check.audited import AuditedPoints, Measure
from recon.check.inputs import MIN_COUNT, repeats_of, repetition
from recon.clip import frame_ranges, longest_run, run_around

ROUNDING_FRACTION = 1e-9
"""Difference of coordinates, relative to the animal's size, up to which it counts as a rounding error."""
IDENTICAL_FRAME_FRACTION = 0.05
"""Fraction of frames above which two points with identical coordinates are reported; at least `MIN_COUNT` frames."""
SAME_POINT_FRACTION = 0.9
"""Fraction of frames above which two identical points of the same side count as two names of one point.

For example, a file may give the hips and the lower spine the same position.
"""
MIN_ROUNDING_STEPS = 10.0
"""Minimum distance of two points, or movement of a point, in rounding steps, that shows a real difference."""
MIN_BEND = 5.0
"""Median bend of a track, relative to the rounding error, above which the track is tested for straight parts.

The bend of a track in a frame is the second difference of the positions.
"""
MIN_MOVEMENT = 0.0005
"""Minimum median movement of the other points, relative to the animal's size, while a point is frozen."""
MIN_FOOT_MOVEMENT = 1.0
"""Value that replaces `MIN_MOVEMENT` for feet in coarse coordinates (`COARSE_STEP`).

Feet stand still during a stance, and coarse coordinates do not show their small movements.
"""
COARSE_STEP = 1e-4
"""Rounding step, relative to the animal's size, above which coordinates are coarse.

In finer coordinates, the position of a standing foot changes as well.
"""
MIN_JUMP = 0.2
"""Smallest jump of a point that is reported, relative to the animal's size."""
JUMP_SPREADS = 10.0
"""Smallest jump of a point that is reported, relative to the point's median distance from its interpolated track."""
JUMP_FRAMES = 2
"""Number of frames within which a point that jumped has to come back."""
GAP_FRAMES = 3
"""Largest number of frames between two known side vectors that are compared across a gap."""
MAX_PAIR_GAIN = 6.0
"""Upper limit of the log-likelihood gain that a single pair of points contributes to a swap."""
SIDE_STEP = 0.02
"""Lower limit of the standard deviation of a side vector's change per frame, relative to the animal's size."""
MIN_PAIRS = 2
"""Minimum number of pairs of points that must show a swap at the same time."""
PX_OF_EXTENT = 1000.0
"""Size in pixels to which an animal in 3D is scaled, so that limits in pixels can be applied."""
STEP_PX = 2.0
"""Minimum length of a step between frames whose change of speed is measured, pixels."""
MIN_STEP_COSINE = 0.5
"""Minimum cosine of the angle between two successive steps that count as in the same direction."""
MIN_CHANGES = 8
"""Minimum number of changes of the speed required to test for missing frames."""
CHANGE_SIGMAS = np.array([0.03, 0.05, 0.08, 0.12, 0.18, 0.25, 0.35, 0.5])
"""Scales of the distribution of the changes of log(speed) per frame, over which the likelihood is averaged."""
STUDENT_T_DEGREES = 3
"""Degrees of freedom of Student's t distribution of the changes of log(speed)."""
OUTLIER_FRACTIONS = np.array([0.02, 0.1, 0.25])
"""Fractions of outliers among the changes of log(speed), over which the likelihood is averaged."""
OUTLIER_RANGE = 5.0
"""Width of the range of changes of log(speed) over which outliers are uniformly distributed."""
MISSING_FRACTIONS = np.array([0.1, 0.2, 0.3, 0.4])
"""Fractions of missing frames over which the likelihood is averaged."""
MAX_INTERVALS = 3
"""Maximum number of frame intervals that a step across missing frames spans."""
MAX_NORMALISED = 1.5
"""Largest coordinate at which keypoints count as fractions of the picture, which allows for points outside it."""


def measure_tracks(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the measures of all checks of tracks."""
    yield from _identical_points(points)
    yield from _frozen_frames(points)
    yield from _frozen_points(points)
    yield from _interpolated(points)
    yield from _jumps(points)
    yield from _missing_frames(points)
    yield from _swapped_sides(points)
    if not points.in_space:
        yield from _normalised(points)
        yield from _upside_down(points)


def _identical_points(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the number of frames in which two points are identical, relative to its limit, for the worst pair."""
    values, T = points.positions, len(points.frames)
    worst: tuple[float, int, int, Bools] | None = None
    for i in range(len(points.names)):
        later = np.arange(i + 1, len(points.names))
        identical = (values[:, i, None] == values[:, later]).all(axis=2)
        counts = identical.sum(axis=0)
        in_both = (points.known[:, i, None] & points.known[:, later]).sum(axis=0)
        for j in later[counts >= MIN_COUNT]:
            same = identical[:, j - i - 1]
            is_other_side = side_of(points.names[i]) != side_of(points.names[j])
            if counts[j - i - 1] >= SAME_POINT_FRACTION * in_both[j - i - 1] and not is_other_side:
                continue
            distances = np.linalg.norm(values[~same, i] - values[~same, j], axis=1)
            is_near = (
                bool(np.isfinite(distances).any()) and np.nanmedian(distances) < MIN_ROUNDING_STEPS * points.resolution
            )
            value = float(same.sum() / max(MIN_COUNT, IDENTICAL_FRAME_FRACTION * T))
            if not is_near and (worst is None or value > worst[0]):
                worst = value, i, int(j), same
    if worst is not None:
        value, i, j, same = worst
        numbers = {"points": points.named((i, j)), "count": int(same.sum())}
        yield Measure("points_identical", value, longest_run(same), numbers)


def _frozen_frames(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the longest run of repeated frames, and the number of repetitions if all frames are repeated."""
    repeats = repeats_of(points.positions)
    if not repeats.any():
        return
    of_all = repetition(repeats, points.fps)
    if of_all is not None:
        yield Measure("detections_repeated", of_all["times"] - 1.0, None, of_all)
    first, stop = longest_run(repeats)
    numbers = {"count": int(repeats.sum()), "frames_total": len(repeats)}
    yield Measure("detections_frozen", float(stop - first), (first - 1, stop), numbers)


def _frozen_points(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the length of the longest run in which a point keeps its coordinates while most other points move."""
    values = points.positions
    is_same = np.zeros(values.shape[:2], dtype=bool)
    is_same[1:] = (values[1:] == values[:-1]).all(axis=2)
    worst: tuple[int, int, int] = (0, 0, 0)
    point = -1
    for k in range(len(points.names)):
        for first, stop in frame_ranges(np.flatnonzero(is_same[:, k])):
            moved = np.linalg.norm(values[stop - 1] - values[first - 1], axis=1)
            moved_others = np.delete(moved, k)
            typical = float(np.nanmedian(moved_others)) if np.isfinite(moved_others).any() else 0.0
            # In coarse coordinates, the position of a foot does not change until the body has passed over it.
            fraction = (
                MIN_FOOT_MOVEMENT
                if points.stands[k] and points.resolution > COARSE_STEP * points.extent
                else MIN_MOVEMENT
            )
            least = max(MIN_ROUNDING_STEPS * points.resolution, fraction * points.extent)
            if typical > least and stop - first > worst[0]:
                worst, point = (stop - first, first - 1, stop), k
    if point >= 0:
        length, first, stop = worst
        numbers = {"points": points.named((point,)), "count": length + 1}
        yield Measure("point_frozen", float(length), (first, stop), numbers)


def _interpolated(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the length of the longest run in which a point moves on a straight line at a constant speed.

    Only points whose tracks usually bend are tested.
    """
    values = points.positions
    if len(values) < 3:
        return
    rounding = 2.01 * points.resolution * np.sqrt(values.shape[2]) + ROUNDING_FRACTION * points.extent
    bend = np.full(values.shape[:2], np.nan)
    bend[1:-1] = np.linalg.norm(values[2:] - 2 * values[1:-1] + values[:-2], axis=2)
    bend[1:-1][~(points.follows[1:-1] & points.follows[2:])] = np.nan
    travel = np.zeros(values.shape[:2])
    travel[1:-1] = np.linalg.norm(values[2:] - values[:-2], axis=2)
    worst: tuple[int, int, int, int] = (0, -1, 0, 0)
    total = 0
    for k in range(len(points.names)):
        is_straight = bend[:, k] <= rounding
        is_straight &= travel[:, k] > max(MIN_ROUNDING_STEPS * rounding, ROUNDING_FRACTION)
        bent = bend[np.isfinite(bend[:, k]) & (bend[:, k] > rounding), k]
        if not is_straight.any() or len(bent) < MIN_COUNT or rounding > 1 / MIN_BEND * np.median(bent):
            continue
        total += int(is_straight.sum())
        first, stop = longest_run(is_straight)
        if stop - first > worst[0]:
            worst = stop - first, k, first, stop
    length, k, first, stop = worst
    if k >= 0:
        numbers = {"points": points.named((k,)), "count": length, "count_total": total}
        yield Measure("points_interpolated", float(length), (first, stop), numbers)


def _jumps(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the largest jump of a point away from its track and back, relative to the limit of jumps."""
    gains = jumps_of(points)
    if not np.isfinite(gains).any():
        return
    row, k = np.unravel_index(int(np.nanargmax(gains)), gains.shape)
    is_jump = np.nan_to_num(gains) > 1
    first, stop = run_around(is_jump[:, k], int(row))
    numbers = {"points": points.named((int(k),)), "count": int(is_jump.sum()), "points_total": int(points.known.sum())}
    yield Measure("points_jump", float(gains[row, k]), (first, stop), numbers)


def jumps_of(points: AuditedPoints) -> Array:
    """Return the distance by which each point jumps away from its track before it comes back, relative to a limit.

    Parameters
    ----------
    points
        K points in T frames.

    Returns
    -------
    ndarray
        Ratios (T, K). The distance is measured from the line between the positions before and after a jump of a few
        frames, relative to the path of the animal. The limit is `MIN_JUMP` times the animal's size or, if larger,
        `JUMP_SPREADS` times the point's median distance. A ratio is NaN if the point is unknown, next to a gap, or does
        not come back.
    """
    jumps = np.full(points.known.shape, np.nan)
    relative = points.positions - _path(points.positions)[:, None]
    usual_step = float(np.median(np.diff(points.frames)))
    for k in range(len(points.names)):
        rows = np.flatnonzero(points.known[:, k])
        if len(rows) < MIN_COUNT:
            continue
        track, frames = relative[rows, k], points.frames[rows]
        limit = np.nan
        for length in range(1, JUMP_FRAMES + 1):
            if len(rows) < length + 2:
                break
            left, right = track[: -length - 1], track[length + 1 :]
            steps = np.arange(1, length + 1)[:, None, None] / (length + 1)
            inner = np.stack([track[n : n + len(left)] for n in range(1, length + 1)])
            distances = np.linalg.norm(inner - (left + steps * (right - left)), axis=2)
            is_close = (frames[length + 1 :] - frames[: -length - 1]) <= (length + GAP_FRAMES) * usual_step
            if length == 1:
                usual = np.median(distances[0, is_close]) if is_close.any() else np.inf
                limit = max(MIN_JUMP * points.extent, JUMP_SPREADS * float(usual), points.resolution)
            nearest = distances.min(axis=0)
            returns = is_close & (np.linalg.norm(right - left, axis=1) < nearest)
            for n in range(1, length + 1):
                inside = rows[n : n + len(left)][returns]
                jumps[inside, k] = np.fmax(jumps[inside, k], nearest[returns] / limit)
    return jumps


def _path(positions: Array) -> Array:
    """Return the path of the animal, shape (T, C), as the sum of the median steps of its K points (T, K, C)."""
    path = np.zeros((len(positions), positions.shape[2]))
    steps = np.diff(positions, axis=0)
    is_known = np.asarray(np.isfinite(steps).all(axis=2)).any(axis=1)
    path[1:][is_known] = np.nanmedian(steps[is_known], axis=1)
    return np.cumsum(path, axis=0)


def _missing_frames(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the log Bayes factor for missing frames, computed from the changes of the points' speed."""
    scale = PX_OF_EXTENT / points.extent if points.in_space else 1.0
    changes = _speed_changes(points.positions * scale, points.follows)
    if np.isfinite(changes).sum() >= MIN_CHANGES:
        gain, fraction = missing_gain(changes)
        yield Measure("frames_dropped", gain, None, {"share": fraction})


def _speed_changes(tracks: Array, follows: Bools) -> Array:
    """Return the change of log(speed) from each step to the next, the logarithm of the ratio of the steps' lengths.

    Parameters
    ----------
    tracks
        Positions of K points, pixels, shape (T, K, 2) or (T, K, 3).
    follows
        Mask (T,) of the frames that follow the frame before without a gap.

    Returns
    -------
    ndarray
        Median over the points of the changes of log(speed), shape (T - 2,); NaN where fewer than `MIN_COUNT` points
        move on in about the same direction.
    """
    steps = np.where(follows[1:, None, None], np.diff(tracks, axis=0), np.nan)
    lengths = np.maximum(np.linalg.norm(steps, axis=2), 1e-9)
    earlier, later = lengths[:-1], lengths[1:]
    cosine = np.sum(steps[1:] * steps[:-1], axis=2) / (earlier * later)
    is_moving = (np.maximum(earlier, later) > 2 * STEP_PX) & (np.minimum(earlier, later) > 0.5 * STEP_PX)
    changes = np.where(is_moving & (cosine > MIN_STEP_COSINE), np.log(later / earlier), np.nan)
    is_enough = np.isfinite(changes).sum(axis=1) >= MIN_COUNT
    medians = np.full(len(changes), np.nan)
    medians[is_enough] = np.nanmedian(changes[is_enough], axis=1)
    return medians


def missing_gain(changes: Array) -> tuple[float, float]:
    """Return the log Bayes factor for missing frames, and the expected fraction of steps across missing frames.

    Parameters
    ----------
    changes
        Changes of log(speed), the logarithm of each step's length relative to the step before, shape (N,); NaN if
        unknown.

    Notes
    -----
    If no frames are missing, changes have Student's t distribution with `STUDENT_T_DEGREES` degrees of freedom, except
    for outliers. If each frame is missing with the probability p, a step spans n = 1, 2 or 3 intervals with a
    probability proportional to p^(n - 1). A change then also contains the logarithm of the ratio of n to the n of the
    step before. The likelihood is the sum over all n, computed by the forward algorithm of a hidden Markov model (L.
    Rabiner, *A tutorial on hidden Markov models*, Proc. IEEE 77, 1989). Both likelihoods are averaged over the scale of
    the distribution, the fraction of outliers, and p, with all values equally likely.
    """
    known = changes[np.isfinite(changes)]
    sigma, outliers = np.meshgrid(CHANGE_SIGMAS, OUTLIER_FRACTIONS)
    of_none = _change_density(known[:, None, None], sigma, outliers)
    without = np.log(of_none).sum(axis=0)

    sigma, outliers, missing = (
        grid.ravel() for grid in np.meshgrid(CHANGE_SIGMAS, OUTLIER_FRACTIONS, MISSING_FRACTIONS)
    )
    intervals = np.arange(1, MAX_INTERVALS + 1)
    prior = missing[:, None] ** (intervals - 1)
    prior = prior / prior.sum(axis=1, keepdims=True)
    shift = np.log(intervals[:, None] / intervals)
    spread = sigma[:, None, None] * np.sqrt(0.5 * (intervals[:, None] + intervals))
    state, log_likelihood = prior, np.zeros(len(sigma))
    for change in changes:
        if np.isfinite(change):
            density = _change_density(change - shift, spread, outliers[:, None, None])
            state = prior * np.einsum("gij,gj->gi", density, state)
        else:
            state = prior * state.sum(axis=1, keepdims=True)
        total = state.sum(axis=1)
        log_likelihood += np.log(total)
        state = state / total[:, None]
    gain = np.logaddexp.reduce(log_likelihood) - np.log(log_likelihood.size)
    gain -= np.logaddexp.reduce(without, axis=None) - np.log(without.size)
    weights = np.exp(log_likelihood - log_likelihood.max())
    return float(gain), float(np.average(1 - prior[:, 0], weights=weights))


def _change_density(change: Array, sigma: Array, outliers: Array) -> Array:
    """Return the probability density of changes of log(speed), including outliers."""
    z_squared = (change / sigma) ** 2
    scale = gamma((STUDENT_T_DEGREES + 1) / 2) / (gamma(STUDENT_T_DEGREES / 2) * np.sqrt(STUDENT_T_DEGREES * np.pi))
    density = scale / sigma * (1 + z_squared / STUDENT_T_DEGREES) ** (-(STUDENT_T_DEGREES + 1) / 2)
    return np.asarray((1 - outliers) * density + outliers / OUTLIER_RANGE, dtype=float)


# Check for swapped sides


def _swapped_sides(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the log-likelihood gain of the most likely left-right swap, of all points or of one pair of limbs."""
    left, right = points.pairs
    if len(left) < MIN_PAIRS:
        return
    gains = _reversal_gains(points, points.positions[:, left] - points.positions[:, right])
    best: tuple[float, str, Index, int, Array] | None = None
    for part, pairs in _parts(points, left).items():
        total = gains[:, pairs].sum(axis=1)
        t = int(np.argmax(total))
        if best is None or total[t] > best[0]:
            best = float(total[t]), part, pairs, t, total
    assert best is not None
    value, part, pairs, t, total = best
    rivals = np.flatnonzero(total > 0.5 * value)
    rivals = rivals[rivals != t]
    if len(rivals):
        nearest = int(rivals[np.argmin(np.abs(rivals - t))])
        first, stop = sorted((t, nearest))
    else:
        first, stop = (0, t) if t < len(total) / 2 else (t, len(total))
    numbers = {"part": part, "points": points.named(left[pairs])}
    yield Measure("sides_swap", value, (first, stop), numbers)


def _reversal_gains(points: AuditedPoints, vectors: Array) -> Array:
    """Return the log-likelihood gain (T, P) if right-to-left vectors (T, P, C) reverse from one frame to the next."""
    gains = np.zeros(vectors.shape[:2])
    floor = SIDE_STEP * points.extent
    for p in range(vectors.shape[1]):
        known = np.flatnonzero(np.isfinite(vectors[:, p]).all(axis=1))
        if len(known) < MIN_COUNT:
            continue
        v = vectors[known, p]
        gap = np.diff(points.frames[known]) / max(1.0, float(np.median(np.diff(points.frames))))
        change = np.minimum(np.linalg.norm(v[1:] - v[:-1], axis=1), np.linalg.norm(v[1:] + v[:-1], axis=1)) / gap
        sigma = np.maximum(np.hypot(1.5 * np.median(change), floor), points.resolution) * gap
        gain = -2 * np.sum(v[1:] * v[:-1], axis=1) / sigma**2
        gain = np.clip(gain, -MAX_PAIR_GAIN, MAX_PAIR_GAIN) * (gap <= GAP_FRAMES)
        gains[known[1:], p] = gain
    return gains


def _parts(points: AuditedPoints, left: Index) -> dict[str, Index]:
    """Return the indices of all pairs of points, and of the pairs in each pair of limbs if the names show the limbs."""
    parts = {"all points": np.arange(len(left))}
    for limb, rows in points.roles.limbs.items():
        pairs = np.array([p for p, k in enumerate(left) if k in rows], dtype=int)
        if len(pairs) >= MIN_PAIRS and "left" in limb:
            parts[limb.replace("left ", "the ") + "s"] = pairs
    return parts


# Checks of 2D keypoints only


def _normalised(points: AuditedPoints) -> Iterator[Measure]:
    """Yield 1 if the coordinates look like fractions of the picture's width and height, otherwise 0."""
    numbers = points.positions[points.known]
    if len(numbers) and points.resolution < 1:
        is_small = (numbers >= -0.5).all() and (numbers < MAX_NORMALISED).all()
        yield Measure("keypoints_normalised", float(is_small))


def _upside_down(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the distance of the trunk below the feet in the picture, relative to the distance between the two."""
    up = feet_to_trunk(points)
    if up is None:
        return
    direction = np.median(up, axis=0)
    fraction = direction[1] / max(float(np.linalg.norm(direction)), 1e-9)
    if np.linalg.norm(direction) > 0.1 * points.extent:
        yield Measure("keypoints_y_up", float(fraction))


def feet_to_trunk(points: AuditedPoints) -> Array | None:
    """Return the vectors from the mean foot to the mean point of the trunk, (N, C), in the N frames with both.

    Return None if the points' names do not show both, or if fewer than `MIN_COUNT` frames have both.
    """
    feet, upper = list(points.roles.feet), list(points.roles.upper)
    if len(feet) < 2 or not upper:
        return None
    vectors = mean_of_known(points.positions[:, upper]) - mean_of_known(points.positions[:, feet])
    vectors = vectors[np.isfinite(vectors).all(axis=1)]
    return vectors if len(vectors) >= MIN_COUNT else None


def mean_of_known(values: Array) -> Array:
    """Return the mean of the known points (T, N, C) in each frame, shape (T, C); NaN if none of the N is known."""
    known = np.asarray(np.isfinite(values).all(axis=2))
    total = np.where(known[..., None], values, 0.0).sum(axis=1)
    count = known.sum(axis=1)[:, None]
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)
