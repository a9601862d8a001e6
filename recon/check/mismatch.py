"""What is probably wrong where a reconstruction and its reference do not belong together.

A fit's errors differ from frame to frame. One motion of the whole clip that takes most of the error away says that the
two stand in different axes, units or names instead.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from recon.animal.body import other_side
from recon.base.arrays import Array, Bools

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


def mismatches(pose_m: Array, truth_m: Array, names: Sequence[str]) -> tuple[str, ...]:
    """Sentences about two sets of positions (T, J, 3) in metres, NaN for missing; none where nothing is suspicious."""
    joints = _common(pose_m, truth_m).sum(axis=1) >= 3
    pose_m, truth_m = pose_m[joints], truth_m[joints]
    common = _common(pose_m, truth_m)
    if not common.any():
        return ()
    pose, truth = _centred(pose_m, common), _centred(truth_m, common)
    size = float(np.sqrt(np.mean(np.sum(truth**2, axis=2), where=common)))
    error = _error(pose, truth, common)
    note, left = None, error
    for said, other in _explanations(pose_m, truth_m, common, names):
        if left > SMALL * size and other <= SHARE * left:
            note, left = said.format(f"brings MPJPE from {1000 * error:.1f} to {1000 * other:.1f} mm"), other
    if left > UNLIKE * size:  # whatever else takes some of it away
        left = min(left, _error(pose @ _turn(pose, truth), truth, common))
    if left > UNLIKE * size:
        return (
            f"Even turned as a whole, the poses are {1000 * left:.0f} mm from the reference's, {left / size:.0%} of "
            "the animal's size, as those of different clips are: probably it is of another clip or animal, its frames "
            "are numbered otherwise, or the fit has failed.",
        )
    if note is not None:
        return (note,)
    away = np.stack([np.mean(p, axis=0, where=c[:, None]) for p, c in zip(pose_m - truth_m, common, strict=True)])
    middle = np.median(away, axis=0)
    distance, rest = (float(np.linalg.norm(x, axis=1).mean()) for x in (away, away - middle))
    if distance > FAR * size and rest <= SHARE * distance:
        x, y, z = middle
        return (
            f"The two are about ({x:.2f}, {y:.2f}, {z:.2f}) m apart in all frames: they probably have different "
            "origins, or the animal's size, and with it its distance from the camera, is far off.",
        )
    return ()


def _explanations(pose_m: Array, truth_m: Array, common: Bools, names: Sequence[str]) -> Iterator[tuple[str, float]]:
    """What the matter could be, the simplest first, and the error that would then be left."""
    pose, truth = _centred(pose_m, common), _centred(truth_m, common)
    axes = (
        "the two are probably in different frames of reference. A fit's pose3d.csv is in the frame of its camera "
        "unless the camera file says where that stands, and every camera has its own."
    )
    turn = _turn(pose, truth)
    angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
    yield f"One turn of the whole clip, by {angle:.0f}°, {{}}: {axes}", _error(pose @ turn, truth, common)
    sides = [names.index(other_side(name)) if other_side(name) in names else j for j, name in enumerate(names)]
    if sides != [*range(len(names))]:
        both = _common(pose_m[:, sides], truth_m)
        exchanged, of_them = _centred(pose_m[:, sides], both), _centred(truth_m, both)
        named = "the sides of the two are probably named the other way round"
        yield f"Left exchanged with right {{}}: {named}.", _error(exchanged, of_them, both)
        turned = exchanged @ _turn(exchanged, of_them)
        yield (
            f"Left exchanged with right, and one turn of the whole clip, {{}}: {named}, and {axes}",
            _error(turned, of_them, both),
        )
    mirrored = pose * (1.0, -1.0, 1.0)
    yield (
        "A mirror image, turned, {}: one of the two probably has left-handed axes.",
        _error(mirrored @ _turn(mirrored, truth), truth, common),
    )
    for what, moved in (("One scale", pose), ("One scale and one turn of the whole clip", pose @ turn)):
        factor = float(np.sum(moved * truth) / max(np.sum(moved**2), 1e-300))
        if not 1 / SCALED < factor < SCALED:
            units = f"{what}, by {factor:.2g}, {{}}: the two are probably in different units"
            yield units + (f", and {axes}" if moved is not pose else "."), _error(factor * moved, truth, common)


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
    u, _, vt = np.linalg.svd(np.einsum("tja,tjb->ab", pose, truth))
    if np.linalg.det(u @ vt) < 0:
        u[:, 2] *= -1
    return u @ vt
