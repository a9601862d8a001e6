"""What is probably wrong where a reconstruction and its reference do not belong together.

A fit's errors differ from frame to frame. One motion of the whole clip that takes most of the error away says that the
two stand in different axes, units or names instead.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from recon.animal import opposites
from recon.base.arrays import Array
from recon.check.codes import finding
from recon.fit.result import Finding

SHARE = 1 / 3
"""An error that falls to this part of itself has been explained."""
SMALL = 0.05
"""An error below this part of the animal's size needs no explanation. Size: root mean square of the joints' distances
from their mean."""
SCALED = 2.0
"""Nor does a size that is less than this many times too large or too small: one camera hardly sees it."""
UNLIKE = 0.3
"""An error above this part of the size is that of another clip: those of running cheetahs are 0.27 to 0.67 of it apart,
and the poorest of the fits in docs/benchmarks.md is 0.22 of it off."""
FAR = 4.0
"""The same of the distance between the two, in sizes."""


def mismatches(pose_m: Array, truth_m: Array, names: Sequence[str]) -> tuple[Finding, ...]:
    """Findings on two sets of positions (T, J, 3) in metres, NaN for missing, that do not belong together."""
    rows = np.isfinite(pose_m + truth_m).all(axis=2).sum(axis=1) >= 3
    pose_m, truth_m = pose_m[rows], truth_m[rows]
    if not rows.any():
        return ()
    pose, truth = _together(pose_m, truth_m)
    size = float(np.sqrt(np.nanmean(np.sum(truth**2, axis=2))))
    error = _error(pose, truth)
    found, left = None, error
    for code, other, numbers in _explanations(pose_m, truth_m, names):
        if left > SMALL * size and other <= SHARE * left:
            found, left = finding(code, error_mm=1000 * error, left_mm=1000 * other, **numbers), other
    if left > UNLIKE * size:  # whatever else takes some of it away
        left = min(left, _error(pose @ _turn(pose, truth), truth))
    if left > UNLIKE * size:
        return (finding("reference_unlike", left_mm=1000 * left, share=left / size),)
    if found is not None:
        return (found,)
    away = np.nanmean(pose_m - truth_m, axis=1)
    middle = np.median(away, axis=0)
    distance, rest = (float(np.linalg.norm(x, axis=1).mean()) for x in (away, away - middle))
    if distance > FAR * size and rest <= SHARE * distance:
        x, y, z = middle.tolist()
        return (finding("reference_elsewhere", x_m=x, y_m=y, z_m=z),)
    return ()


def _explanations(pose_m: Array, truth_m: Array, names: Sequence[str]) -> Iterator[tuple[str, float, dict[str, Any]]]:
    """What the matter could be, the simplest first, each with the rotation of the whole clip that fits best: its code,
    the error that would then be left, and its numbers."""
    pose, truth = _together(pose_m, truth_m)
    sides = opposites(names)
    tries = [("reference_rotated", pose, truth)]
    if (sides != np.arange(len(names))).any():
        tries.append(("reference_swapped", *_together(pose_m[:, sides], truth_m)))
    tries.append(("reference_mirrored", pose * (1.0, -1.0, 1.0), truth))
    for code, of_pose, of_truth in tries:
        turn = _turn(of_pose, of_truth)
        yield code, _error(of_pose @ turn, of_truth), {"turn_rad": _angle(turn)}
    turned = pose @ (turn := _turn(pose, truth))
    factor = float(np.nansum(turned * truth) / max(np.nansum(turned**2), 1e-300))
    if not 1 / SCALED < factor < SCALED:
        yield "reference_scaled", _error(factor * turned, truth), {"factor": factor, "turn_rad": _angle(turn)}


def _angle(turn: Array) -> float:
    return float(Rotation.from_matrix(turn).magnitude())


def _together(pose_m: Array, truth_m: Array) -> Array:
    """(2, T, J, 3): both about the mean of the joints that both have in a frame, NaN for all others; without frames in
    which they have none together."""
    known = np.asarray(np.isfinite(pose_m + truth_m).all(axis=2))
    both = np.where(known[..., None], np.stack([pose_m, truth_m]), np.nan)[:, known.any(axis=1)]
    return both - np.nanmean(both, axis=2, keepdims=True)


def _error(pose: Array, truth: Array) -> float:
    """Mean over the frames of the mean over their joints; infinite without frames."""
    return float(np.nanmean(np.linalg.norm(pose - truth, axis=2), axis=1).mean()) if len(pose) else np.inf


def _turn(pose: Array, truth: Array) -> Array:
    """(3, 3): pose @ this is nearest to the truth, by one rotation for all frames."""
    known = np.isfinite(pose[..., 0])
    if not known.any():
        return np.eye(3)
    with warnings.catch_warnings(action="ignore"):  # of points on a line, which several rotations fit
        turn, _ = Rotation.align_vectors(truth[known], pose[known])
    return turn.as_matrix().T
