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

from recon.animal.body import other_side
from recon.base.arrays import Array, Bools
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
    joints = _common(pose_m, truth_m).sum(axis=1) >= 3
    pose_m, truth_m = pose_m[joints], truth_m[joints]
    common = _common(pose_m, truth_m)
    if not common.any():
        return ()
    pose, truth = _centred(pose_m, common), _centred(truth_m, common)
    size = float(np.sqrt(np.mean(np.sum(truth**2, axis=2), where=common)))
    error = _error(pose, truth, common)
    found, left = None, error
    for code, other, numbers in _explanations(pose_m, truth_m, common, names):
        if left > SMALL * size and other <= SHARE * left:
            found, left = finding(code, error_mm=1000 * error, left_mm=1000 * other, **numbers), other
    if left > UNLIKE * size:  # whatever else takes some of it away
        left = min(left, _error(pose @ _turn(pose, truth), truth, common))
    if left > UNLIKE * size:
        return (finding("reference_unlike", left_mm=1000 * left, share=left / size),)
    if found is not None:
        return (found,)
    away = np.stack([np.mean(p, axis=0, where=c[:, None]) for p, c in zip(pose_m - truth_m, common, strict=True)])
    middle = np.median(away, axis=0)
    distance, rest = (float(np.linalg.norm(x, axis=1).mean()) for x in (away, away - middle))
    if distance > FAR * size and rest <= SHARE * distance:
        x, y, z = middle.tolist()
        return (finding("reference_elsewhere", x_m=x, y_m=y, z_m=z),)
    return ()


def _explanations(
    pose_m: Array, truth_m: Array, common: Bools, names: Sequence[str]
) -> Iterator[tuple[str, float, dict[str, Any]]]:
    """What the matter could be, the simplest first, each with the rotation of the whole clip that fits best: its code,
    the error that would then be left, and its numbers."""
    pose, truth = _centred(pose_m, common), _centred(truth_m, common)
    sides = [names.index(other_side(name)) if other_side(name) in names else j for j, name in enumerate(names)]
    both = _common(pose_m[:, sides], truth_m)
    tries = [("reference_rotated", pose, truth, common)]
    if sides != [*range(len(names))]:
        tries.append(("reference_swapped", _centred(pose_m[:, sides], both), _centred(truth_m, both), both))
    tries.append(("reference_mirrored", pose * (1.0, -1.0, 1.0), truth, common))
    for code, of_pose, of_truth, known in tries:
        turn = _turn(of_pose, of_truth)
        yield code, _error(of_pose @ turn, of_truth, known), {"turn_rad": _angle(turn)}
    turned = pose @ (turn := _turn(pose, truth))
    factor = float(np.sum(turned * truth) / max(np.sum(turned**2), 1e-300))
    if not 1 / SCALED < factor < SCALED:
        yield "reference_scaled", _error(factor * turned, truth, common), {"factor": factor, "turn_rad": _angle(turn)}


def _angle(turn: Array) -> float:
    return float(Rotation.from_matrix(turn).magnitude())


def _common(pose_m: Array, truth_m: Array) -> Bools:
    """(T, J)"""
    return np.asarray(np.isfinite(pose_m + truth_m).all(axis=2))


def _centred(points_m: Array, common: Bools) -> Array:
    """Less the mean of the common joints in each frame; 0 for all others."""
    known = np.where(common[..., None], points_m, 0.0)
    middle = known.sum(axis=1) / np.maximum(common.sum(axis=1), 1)[:, None]
    return np.where(common[..., None], points_m - middle[:, None], 0.0)


def _error(pose: Array, truth: Array, common: Bools) -> float:
    """Mean over the frames of the mean over their joints."""
    off = np.linalg.norm(pose - truth, axis=2).sum(axis=1)
    count = common.sum(axis=1)
    return float(np.mean(off[count > 0] / count[count > 0])) if count.any() else np.inf


def _turn(pose: Array, truth: Array) -> Array:
    """(3, 3): pose @ this is nearest to the truth, by one rotation for all frames."""
    with warnings.catch_warnings(action="ignore"):  # of points on a line, which several rotations fit
        turn, _ = Rotation.align_vectors(truth.reshape(-1, 3), pose.reshape(-1, 3))
    return turn.as_matrix().T
