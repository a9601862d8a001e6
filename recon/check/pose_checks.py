"""Check 3D poses: bone lengths, unit, upward axis, gravity in flight, feet on the ground, ranges of joint angles.

Points are in metres with z up, as the file states or as is usual for its format. Bones are derived from the points, as
the tree of pairs whose distances vary least.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from scipy.sparse.csgraph import minimum_spanning_tree

from recon.animal.anatomy import FLEXES_CAUDALLY, joint_and_side, sagittal_angle
from recon.animal.body import opposites
from recon.base.arrays import Array, running_median
from recon.check.audited import AuditedPoints, Measure
from recon.check.inputs import MIN_COUNT, SLIDE_LEGS_S, SLIDE_RATIO, STANDING_QUANTILE
from recon.check.track_checks import feet_to_trunk, mean_of_known
from recon.clip import frame_ranges, run_around

MIN_LENGTH_CHANGE = 0.1
"""Smallest change of a bone's length that counts as a fault, as a fraction of the length."""
LENGTH_SPREADS = 5.0
"""Smallest change of a bone's length that counts as a fault, in units of the length's usual deviation."""
MIN_LENGTH_DRIFT = 0.08
"""Smallest change of all lengths together that counts as a fault, as a fraction of the lengths."""
DRIFT_FRAMES = 5
"""Number of frames of the running median that smooths the common change of all lengths."""
DISTANCE_WEIGHT = 0.02
"""Weight of the distance of two points, relative to its variation, in the search for bones.

With this value, close points are connected, but not feet that stand side by side.
"""
MIN_KNOWN_FRACTION = 0.3
"""Minimum fraction of the frames in which both points of a pair must be known for the pair to count as a bone."""
EXTENT_M = (0.04, 5.0)
"""Range of possible lengths of an animal, from a mouse to more than a horse."""
GRAVITY_M_S2 = 9.81
IN_AIR = 0.1
"""Height of a foot above its lowest position, relative to the leg length, above which the foot is in the air."""
FLIGHT_FRAMES = 5
"""Minimum number of frames in a flight whose acceleration is measured."""
GRAVITY_SIGMAS = 2.0
"""Largest deviation of a flight's acceleration, in standard deviations, that is consistent with gravity."""
GRAVITY_RATIO = 1.5
"""Factor by which a flight's acceleration may differ from gravity without a finding, beyond its uncertainty."""
OWN_MOTION = 0.02
"""Assumed standard deviation of the trunk's motion relative to the centre of mass in a flight, in leg lengths."""
RANGE_DEG: Mapping[str, tuple[float, float]] = {
    "elbow": (-20.0, 165.0),
    "stifle": (-20.0, 170.0),
    "hock": (-20.0, 165.0),
    "carpus": (-110.0, 175.0),
}
"""Range of flexion of joints that bend to one side only, degrees, in mammals from mice to horses; 0 is straight."""
BEYOND_DEG = 15.0
"""Smallest angle beyond a joint's range of flexion that counts as a fault, degrees."""
BEYOND_FRAMES = 2
"""Minimum number of frames beyond the range of flexion for a fault, because a single frame may be an outlier."""


def measure_poses(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the measures of all checks of 3D poses."""
    yield from _lengths(points)
    yield from _unit(points)
    yield from _up(points)
    yield from _exchanged_sides(points)
    yield from _gravity(points)
    yield from _slide(points)
    yield from _ranges(points)


# Checks of bone lengths and of the unit


def rigid_pairs(points: AuditedPoints) -> list[tuple[int, int]]:
    """Return the pairs of points that bones probably connect: the tree of points whose distances vary least."""
    values, K = points.positions, len(points.names)
    spread = np.zeros((K, K))
    for i in range(K - 1):
        lengths = np.linalg.norm(values[:, i, None] - values[:, i + 1 :], axis=2)
        counts = np.isfinite(lengths).sum(axis=0)
        lengths[:, counts == 0] = 0.0
        median = np.nanmedian(lengths, axis=0)
        deviation = np.nanmedian(np.abs(lengths - median), axis=0)
        is_bone = (counts >= max(MIN_COUNT, MIN_KNOWN_FRACTION * len(values))) & (median > 0.02 * points.extent)
        spread[i, i + 1 :] = np.where(is_bone, deviation + DISTANCE_WEIGHT * median, 0.0)
    partners = opposites(points.names)
    standing = np.flatnonzero((partners != np.arange(K)) & points.stands)
    spread[standing, partners[standing]] = 0.0  # a left and a right foot are never connected
    tree = minimum_spanning_tree(spread).tocoo()
    return [(int(i), int(j)) for i, j in zip(tree.row, tree.col, strict=True)]


def _lengths(points: AuditedPoints) -> Iterator[Measure]:
    """Yield a measure of the bone whose length changes most, and of the drift of all lengths together."""
    pairs = rigid_pairs(points)
    if len(pairs) < 2:
        return
    first, second = np.array(pairs).T
    lengths = np.linalg.norm(points.positions[:, first] - points.positions[:, second], axis=2)
    relative = lengths / np.nanmedian(lengths, axis=0)
    common = _running_median(np.nanmedian(relative, axis=1) if np.isfinite(relative).any() else relative[:, 0])
    known = np.isfinite(common)
    if known.sum() >= 2 * DRIFT_FRAMES:
        low, high = np.quantile(common[known], [0.02, 0.98])
        yield Measure("lengths_drift", float((high - low) / MIN_LENGTH_DRIFT), None, {"share": float(high / low - 1)})
    deviation = np.abs(relative / common[:, None] - 1)
    usual = 1.4826 * np.nanmedian(deviation, axis=0)
    score = np.nan_to_num(deviation / np.maximum(MIN_LENGTH_CHANGE, LENGTH_SPREADS * usual))
    # The second largest value is used because one frame may be an outlier.
    peaks = np.sort(score, axis=0)[-2] if len(score) > 1 else score[-1]
    e = int(np.argmax(peaks))
    at = int(np.argmax(score[:, e]))
    run = run_around(score[:, e] > 1, at)
    numbers = {"points": points.named(pairs[e]), "share": float(deviation[at, e]), "usual": float(usual[e])}
    yield Measure("lengths_change", float(peaks[e]), run, numbers)


def _running_median(values: Array) -> Array:
    known = np.isfinite(values)
    result = np.full(len(values), np.nan)
    if known.any():
        result[known] = running_median(values[known], DRIFT_FRAMES)
    return result


def _unit(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the absolute log10 of the animal's size, relative to the size of the skeleton or of any animal.

    If the skeleton is unknown, a constant is added for a size that no animal has (`EXTENT_M`).
    """
    ratios = [
        float(np.nanmedian(np.linalg.norm(points.positions[:, a] - points.positions[:, b], axis=1))) / expected_m
        for (a, b), expected_m in points.roles.bones_m.items()
        if expected_m > 0 and (points.known[:, a] & points.known[:, b]).any()
    ]
    if len(ratios) >= 3:
        times = float(np.median(ratios))
    else:
        low, high = EXTENT_M
        if not points.extent > 0:
            return
        times = points.extent / low if points.extent < low else max(points.extent / high, 1.0)
    value = abs(float(np.log10(max(times, 1e-12))))
    if len(ratios) < 3 and times != 1.0:
        value += 0.6  # larger or smaller than any animal
    yield Measure("unit_unlikely", value, None, {"extent_m": points.extent, "times": times, "unit": _unit_for(times)})


def _unit_for(times: float) -> str:
    """Return the name of the unit in which numbers are `times` as large as in metres."""
    candidates = {"mm": 1000.0, "cm": 100.0, "m, divided by 100": 0.01, "m, divided by 1000": 0.001}
    return min(candidates, key=lambda unit: abs(np.log10(max(times, 1e-12) / candidates[unit])))


# Checks of the upward direction and of the sides


def _upward(points: AuditedPoints) -> Array | None:
    """Return the mean direction from the feet to the trunk over all frames, as a unit vector (3,); None if unknown."""
    up = feet_to_trunk(points)
    if up is None:
        return None
    direction = np.mean(up / np.maximum(np.linalg.norm(up, axis=1, keepdims=True), 1e-12), axis=0)
    length = float(np.linalg.norm(direction))
    return direction / length if length > 0.3 else None


def _up(points: AuditedPoints) -> Iterator[Measure]:
    """Yield 1 minus the cosine of the angle between the z axis and the mean direction from the feet to the trunk."""
    up = _upward(points)
    if up is None:
        return
    axis = int(np.argmax(np.abs(up)))
    name = f"{'-' if up[axis] < 0 else ''}{'xyz'[axis]}"
    yield Measure(
        "up_unlikely", 1.0 - float(up[2]), None, {"axis": name, "tilt_rad": float(np.arccos(np.clip(up[2], -1, 1)))}
    )


def _exchanged_sides(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the fraction of left points that are on the animal's right, over all frames."""
    left_of = _left(points)
    if left_of is None:
        return
    left, right = points.pairs
    across = np.sum((points.positions[:, left] - points.positions[:, right]) * left_of[:, None], axis=2)
    signs = across[np.isfinite(across) & (np.abs(across) > 0.02 * points.extent)]
    if len(signs) >= MIN_COUNT:
        yield Measure("sides_exchanged", float(np.mean(signs < 0)), None, {"share": float(np.mean(signs < 0))})


def _left(points: AuditedPoints) -> Array | None:
    """Return unit vectors to the animal's left, shape (T, 3), or None if the trunk or the feet are unknown."""
    up = _upward(points)
    if up is None or points.roles.trunk is None:
        return None
    rear, front = points.roles.trunk
    left = np.cross(up, points.positions[:, front] - points.positions[:, rear])
    return left / np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-12)


# Checks of gravity and of feet on the ground


def leg_length_m(points: AuditedPoints) -> float:
    """Return the median height of the trunk above the lowest foot, m; NaN if unknown."""
    feet, upper = list(points.roles.feet), list(points.roles.upper)
    if len(feet) < 2 or not upper:
        return np.nan
    feet_z = np.where(points.known[:, feet], points.positions[:, feet, 2], np.inf).min(axis=1)
    height = mean_of_known(points.positions[:, upper])[:, 2] - feet_z
    height = height[np.isfinite(height)]
    return float(np.median(height)) if len(height) else np.nan


def _gravity(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the absolute logarithm (base `GRAVITY_RATIO`) of the acceleration in flights relative to gravity."""
    leg_m = leg_length_m(points)
    if points.fps is None or not leg_m > 0 or len(points.roles.feet) < 4:
        return
    z_m = points.positions[:, list(points.roles.feet), 2]
    if not np.isfinite(z_m).all(axis=1).sum() >= 2 * FLIGHT_FRAMES:
        return
    above_m = z_m - _ground_m(z_m)[:, None]
    above_m -= np.nanquantile(above_m, 0.05, axis=0)
    is_flying = np.isfinite(z_m).all(axis=1) & (above_m > IN_AIR * leg_m).all(axis=1)
    body_m = mean_of_known(points.positions[:, list(points.roles.upper)])[:, 2]
    accelerations, variances, rows = [], [], []
    for first, stop in frame_ranges(np.flatnonzero(is_flying)):
        heights = body_m[first:stop]
        if stop - first < FLIGHT_FRAMES or not np.isfinite(heights).all() or not points.follows[first + 1 : stop].all():
            continue
        time_s = np.arange(stop - first) / points.fps
        design = np.stack([np.ones_like(time_s), time_s, 0.5 * time_s**2], axis=1)
        solution, *_ = np.linalg.lstsq(design, heights, rcond=None)
        residual = heights - design @ solution
        noise = max(float(residual @ residual) / max(len(heights) - 3, 1), (0.003 * leg_m) ** 2)
        accelerations.append(float(solution[2]))
        own_m_s2 = 8 * OWN_MOTION * leg_m / float(time_s[-1]) ** 2
        variances.append(noise * float(np.linalg.inv(design.T @ design)[2, 2]) + own_m_s2**2)
        rows.append((first, stop))
    if not accelerations:
        return
    weights = 1 / np.array(variances)
    mean = float(np.sum(weights * accelerations) / weights.sum())
    sigma = float(np.sqrt(1 / weights.sum()))
    excess = -mean - GRAVITY_M_S2
    nearest_m_s2 = GRAVITY_M_S2 + np.copysign(max(abs(excess) - GRAVITY_SIGMAS * sigma, 0.0), excess)
    value = abs(float(np.log(max(nearest_m_s2, 1e-2) / GRAVITY_M_S2) / np.log(GRAVITY_RATIO)))
    numbers: dict[str, float | str] = {"acceleration_m_s2": -mean, "sigma_m_s2": sigma, "given_hz": points.fps}
    advice = "Check --fps and --unit."
    if -mean > GRAVITY_SIGMAS * sigma:  # otherwise the acceleration is too uncertain to suggest a frame rate
        numbers["other_hz"] = points.fps * float(np.sqrt(GRAVITY_M_S2 / -mean))
        advice = f"About {numbers['other_hz']:.0f} frames per second, not {points.fps:g}, would give 9.8 m/s²."
    numbers["advice"] = advice
    yield Measure("gravity_unlikely", value, max(rows, key=lambda run: run[1] - run[0]), numbers)


def _ground_m(z_m: Array) -> Array:
    """Return the height of the ground in each frame, shape (T,), given the heights of the feet, (T, F), metres.

    The height of the ground changes linearly over the frames, as on an even slope.
    """
    rows = np.arange(len(z_m), dtype=float)
    lowest_m = np.where(np.isfinite(z_m), z_m, np.inf).min(axis=1)
    is_used = np.isfinite(lowest_m)
    line = np.zeros(2)
    for _ in range(3):
        line = np.polyfit(rows[is_used], lowest_m[is_used], 1)
        lower = is_used & (lowest_m <= np.polyval(line, rows))
        if lower.sum() < MIN_COUNT:
            break
        is_used = lower
    return np.asarray(np.polyval(line, rows), dtype=float)


def _slide(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the velocity of feet in stance along the trunk, relative to its limit, as a measure of sliding feet."""
    leg_m, trunk, feet = leg_length_m(points), points.roles.trunk, list(points.roles.feet)
    if points.fps is None or trunk is None or not leg_m > 0 or len(points.frames) < 2 * FLIGHT_FRAMES:
        return
    rear, front = trunk
    along = (points.positions[:, front] - points.positions[:, rear])[:, :2]
    along = along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-9)
    times_s = points.frames / points.fps
    velocity = np.gradient(points.positions, times_s, axis=0)[..., :2]
    forward = np.einsum("tja,ta->tj", velocity, along)
    body_m_s = float(np.nanmedian(forward[:, [rear, front]]))
    feet_m_s = forward[:, feet]
    if not np.isfinite(feet_m_s).any():
        return
    slowest_m_s = float(np.nanquantile(feet_m_s, STANDING_QUANTILE))
    over_feet_m_s = body_m_s - slowest_m_s
    if over_feet_m_s <= SLIDE_LEGS_S * leg_m:
        return
    z_m = points.positions[:, feet, 2]
    is_low = z_m - np.nanquantile(z_m, 0.05, axis=0) < IN_AIR * leg_m
    standing = feet_m_s[is_low & np.isfinite(feet_m_s)]
    typical_m_s = float(np.quantile(standing, 0.25)) if len(standing) >= MIN_COUNT else slowest_m_s
    backwards = -slowest_m_s / (SLIDE_RATIO * over_feet_m_s)
    forwards = typical_m_s / (2 * SLIDE_RATIO * max(abs(body_m_s), SLIDE_LEGS_S * leg_m))
    slide_m_s = slowest_m_s if backwards >= forwards else typical_m_s
    numbers = {"slide_m_s": slide_m_s, "speed_m_s": body_m_s}
    yield Measure("feet_slide", float(max(backwards, forwards)), None, numbers)


# Check of joint angles


def _ranges(points: AuditedPoints) -> Iterator[Measure]:
    """Yield the largest angle by which a joint exceeds its range of flexion, relative to `BEYOND_DEG`."""
    left = _left(points)
    if left is None:
        return
    worst: Measure | None = None
    for name, (above, middle, below) in points.roles.joints.items():
        joint = joint_and_side(name)[0]
        if joint not in RANGE_DEG:
            continue
        proximal = points.positions[:, middle] - points.positions[:, above]
        distal = points.positions[:, below] - points.positions[:, middle]
        angle_deg = np.degrees(sagittal_angle(proximal, distal, left)) * FLEXES_CAUDALLY[joint]
        low, high = RANGE_DEG[joint]
        centre = 0.5 * (low + high)
        wrapped = np.mod(angle_deg - centre + 180, 360) - 180 + centre
        beyond = np.nan_to_num(np.maximum(low - wrapped, wrapped - high), nan=-np.inf)
        if len(beyond) < BEYOND_FRAMES:
            continue
        value = float(np.sort(beyond)[-BEYOND_FRAMES] / BEYOND_DEG)
        if worst is None or value > worst.value:
            t = int(np.argmax(beyond))
            run = run_around(beyond > 0, t)
            numbers = {"joint": name.replace("_", " "), "angle_rad": float(np.radians(wrapped[t]))}
            numbers |= {"low_rad": float(np.radians(low)), "high_rad": float(np.radians(high))}
            worst = Measure("joint_beyond_range", value, run, numbers)
    if worst is not None:
        yield worst
