"""List the detections that are worth correcting by hand, the most worthwhile first.

The first group of detections are far from their expected positions, or were left out of the fit. Either they or the
pose are wrong. Missing and uncertain detections form the second group. Both groups are sorted by how much the expected
error of the pose would decrease after a correction (`recon.fit.correction_gain`). In the first group, detections that
are almost certainly wrong (`GROSS_SIGMAS`) come before the others. In the second group, a correction also improves the
neighbouring frames, because errors persist for about `ERROR_TIME_S`. Each listed detection therefore lowers the
remaining gain of the same keypoint in the frames around it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from recon.base.arrays import Array, Bools
from recon.clip import UNLIKELY, Source
from recon.fit import constants
from recon.fit.motion import Motion, Picture

AGREES_SIGMAS = 2.0
"""Distance of a detection from its expected position, in standard deviations, up to which it needs no correction."""
GROSS_SIGMAS = 5.0
"""Distance of a detection from its expected position, in standard deviations, beyond which it is surely wrong."""
MAX_LISTED = 500
"""Default maximum number of detections in the list, which is more than anybody corrects by hand."""
Reason = Literal["far", "left out", "low likelihood", "missing", "uncertain"]
"""Reason for which a detection is worth correcting.

- far: it was used, but it is an outlier
- left out: it was left out for a reason other than its likelihood
- low likelihood: it was left out for its low likelihood
- missing: the keypoint was not detected
- uncertain: it is further than `AGREES_SIGMAS` from its expected position
"""


@dataclass(frozen=True)
class ToCorrect:
    """Detection, or missing detection, that is worth correcting by hand."""

    frame: int
    """Number of the frame in the keypoint file."""
    camera: str
    keypoint: str
    found_px: tuple[float, float] | None
    """Position that the detector found; None without a detection."""
    likelihood: float
    expected_px: tuple[float, float]
    """Position of the keypoint expected from the pose."""
    ellipse_px: tuple[float, float, float]
    """Ellipse of one standard deviation about the expected position.

    The values are the semi-major and semi-minor axis, px, and the angle of the major axis to the x axis, degrees.
    """
    distance_px: float
    """Distance from the detected to the expected position; NaN without a detection."""
    reason: Reason
    error_fall_m: float
    """Expected decrease of the pose's root mean square error after the correction; NaN if it cannot be computed."""


def to_correct(motion: Motion, limit: int = MAX_LISTED) -> list[ToCorrect]:
    """Return the detections that are worth correcting, the most worthwhile first.

    Parameters
    ----------
    motion
        A fitted motion of T frames and J joints, filmed by V cameras.
    limit
        Maximum number of detections that are returned.
    """
    found_px, likelihood, reason_code = (
        np.array(arrays) for arrays in zip(*map(_all_detections, motion.sources), strict=True)
    )
    pictures = motion.pictures
    gain_m2 = motion.correction_gain_m2
    if gain_m2 is None:
        gain_m2 = np.full(found_px.shape[:3], np.nan)
    expected_px = np.array([picture.reprojected_px for picture in pictures])
    distance_px = np.hypot(*np.moveaxis(found_px - expected_px, -1, 0))  # squares of very distant points overflow
    inside = np.array([_inside(picture) for picture in pictures])
    outliers = np.array([picture.outliers for picture in pictures])
    is_left_out = reason_code > _USED
    is_first = inside & (outliers | is_left_out & np.isfinite(distance_px))
    sigma_px = np.array([picture.sigma_px for picture in pictures])
    agrees = distance_px <= AGREES_SIGMAS * sigma_px
    is_next = inside & ~is_first & ~agrees & (np.nan_to_num(gain_m2) > 0)
    tau = max(constants.ERROR_TIME_S * motion.fps, 1.0)
    first = _by_gain(gain_m2, distance_px, distance_px > GROSS_SIGMAS * sigma_px, is_first, limit)
    cells = [*first, *_spread(gain_m2, is_next, tau, limit - len(first))]
    falls_m = _error_fall_m(motion, gain_m2)
    return [
        ToCorrect(
            frame=int(motion.frames[t]) - motion.sources[v].later_frames,
            camera=pictures[v].name,
            keypoint=motion.names[j],
            found_px=_pair(found_px[v, t, j]),
            likelihood=float(likelihood[v, t, j]),
            expected_px=(float(expected_px[v, t, j, 0]), float(expected_px[v, t, j, 1])),
            ellipse_px=ellipse_px,
            distance_px=float(distance_px[v, t, j]),
            reason=_reason(
                int(reason_code[v, t, j]),
                is_outlier=bool(outliers[v, t, j]),
                is_detected=bool(np.isfinite(found_px[v, t, j, 0])),
            ),
            error_fall_m=float(falls_m[v, t, j]),
        )
        for (v, t, j), ellipse_px in zip(cells, _ellipses(motion, cells), strict=True)
    ]


_USED, _UNLIKELY, _LEFT_OUT = 0, 1, 2
"""Codes that state whether a detection was used in the fit, left out for its likelihood, or left out otherwise."""


def _reason(code: int, is_outlier: bool, is_detected: bool) -> Reason:
    if code != _USED:
        return "low likelihood" if code == _UNLIKELY else "left out"
    if is_outlier:
        return "far"
    return "uncertain" if is_detected else "missing"


def _all_detections(source: Source) -> tuple[Array, Array, Array]:
    """Return all detections, used or left out, as pixels (T, J, 2), likelihoods (T, J) and codes of use (T, J).

    The codes are `_USED`, `_UNLIKELY` and `_LEFT_OUT`.
    """
    keypoints = source.keypoints
    found_px, likelihood = keypoints.xy_px.copy(), np.where(keypoints.present, keypoints.confidence, np.nan)
    codes = np.zeros(keypoints.present.shape, dtype=int)
    left_out = source.cleaning.left_out
    column = np.array([keypoints.names.index(name) if name in keypoints.names else -1 for name in left_out.names])
    rows = np.searchsorted(keypoints.frames, left_out.frame + source.later_frames)
    is_here = (rows < len(keypoints.frames)) & (column[left_out.keypoint] >= 0) if len(rows) else np.zeros(0, bool)
    rows, columns = rows[is_here], column[left_out.keypoint[is_here]] if len(rows) else rows
    found_px[rows, columns] = left_out.xy_px[is_here]
    likelihood[rows, columns] = left_out.confidence[is_here]
    is_unlikely = np.array([reason == UNLIKELY for reason in left_out.reasons], dtype=bool)
    codes[rows, columns] = np.where(is_unlikely[left_out.reason[is_here]], _UNLIKELY, _LEFT_OUT) if len(rows) else 0
    return found_px, likelihood, codes


def _inside(picture: Picture) -> Bools:
    """Return a mask (T, J) of the keypoints expected inside the picture, because only these can be marked by hand."""
    width, height = picture.camera.image_size_px
    x, y = np.moveaxis(picture.reprojected_px, -1, 0)
    return (x >= 0) & (x < width) & (y >= 0) & (y < height)


def _by_gain(
    gain_m2: Array, distance_px: Array, is_gross: Bools, chosen: Bools, limit: int
) -> list[tuple[int, int, int]]:
    """Return the chosen detections as (view, frame, joint), gross errors first, then by decreasing gain.

    Detections with equal or unknown gains are sorted by distance. Distance alone would be a poor order, because the
    robust loss ignores very distant detections, so that their correction changes the pose little.

    At most `limit` detections are returned.
    """
    indices = np.flatnonzero(chosen)
    keys = -distance_px, -np.nan_to_num(gain_m2), ~is_gross
    order = np.lexsort([key.ravel()[indices] for key in keys])
    return [_cell(index, chosen.shape) for index in indices[order[:limit]].tolist()]


def _spread(gain_m2: Array, chosen: Bools, tau: float, limit: int) -> list[tuple[int, int, int]]:
    """Return the chosen detections as (view, frame, joint), each with the largest gain that is left at its turn.

    A listed detection lowers the gain of the same keypoint within about `tau` frames.

    At most `limit` detections are returned.
    """
    left_m2 = np.where(chosen, gain_m2, -np.inf)
    frames, cells = np.arange(gain_m2.shape[1]), []
    for _ in range(min(limit, int(chosen.sum()))):
        v, t, j = _cell(int(np.argmax(left_m2)), gain_m2.shape)
        cells.append((v, t, j))
        left_m2[v, :, j] *= 1.0 - np.exp(-(((frames - t) / tau) ** 2)) * (frames != t)
        left_m2[v, t, j] = -np.inf
    return cells


def _cell(index: int, shape: tuple[int, ...]) -> tuple[int, int, int]:
    v, t, j = np.unravel_index(index, shape)
    return int(v), int(t), int(j)


def _error_fall_m(motion: Motion, gain_m2: Array) -> Array:
    """Return how much each correction is expected to decrease the RMS error of the joints, m, shape of `gain_m2`.

    `gain_m2` is the decrease of the mean squared error if a detection is corrected, m^2. Errors are those of the
    positions of the joints relative to their mean.
    """
    variance_m2 = np.trace(motion.solution.relative_covariance_m2[motion.solved], axis1=-2, axis2=-1)
    error_m2 = float(variance_m2.mean()) if variance_m2.size else np.nan
    return np.sqrt(error_m2) - np.sqrt(np.maximum(error_m2 - gain_m2, 0.0))


def _ellipses(motion: Motion, cells: list[tuple[int, int, int]]) -> list[tuple[float, float, float]]:
    """Return the ellipses of one standard deviation about the expected keypoints (view, frame, joint) in `cells`.

    Each is a tuple of the semi-major axis, px, the semi-minor axis, px, and the angle of the major axis, degrees.
    """
    solution = motion.solution
    ellipses = np.empty((len(cells), 3))
    for v, view in enumerate(solution.views):
        chosen = np.array([i for i, cell in enumerate(cells) if cell[0] == v], dtype=int)
        rows, joints = (np.array([cells[i][axis] for i in chosen], dtype=int) for axis in (1, 2))
        if not len(chosen):
            continue
        _, by_point, _ = view.part(rows).project_with_jacobian(solution.markers_m[rows, joints][:, None])
        covariance_px2 = by_point[:, 0] @ solution.covariance_m2[rows, joints] @ by_point[:, 0].swapaxes(1, 2)
        variances, axes = np.linalg.eigh(covariance_px2)
        ellipses[chosen, :2] = np.sqrt(np.maximum(variances, 0.0))[:, ::-1]
        ellipses[chosen, 2] = np.degrees(np.arctan2(axes[:, 1, 1], axes[:, 0, 1])) % 180.0
    return [(major, minor, angle) for major, minor, angle in ellipses.tolist()]


def _pair(xy: Array) -> tuple[float, float] | None:
    return (float(xy[0]), float(xy[1])) if np.isfinite(xy).all() else None
