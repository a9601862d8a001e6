"""What is solved of cameras with the fit: by how many frames they are out of step, sought first where rays of the same
keypoint meet; and whether poses that were refined are taken."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, refuse
from recon.check.agreement import search_offsets
from recon.check.codes import finding
from recon.clip import Source, together, views_of
from recon.fit import TrajectorySolution, constants
from recon.fit.result import Finding

FIT_ROUNDS = 5
CLOSE_FRAMES = 0.05
"""Lags this small are left to the solver, which takes the motion for straight over them."""
WORSE, BETTER, LOST, FAR = 1.1, 1.02, 5.0, 4.0
"""Times a camera's median reprojection that is no change, as what one camera gains, another may lose a little, and that
is none at all; times that of the rig's middle camera, of one that is an outlier all the time; and times the expected
turn, of one that is not where the file says."""
MAX_SIGMA_FRAMES = 1.0
"""Offsets that are known less well, or do not settle so far, are refused."""

Solve = Callable[[tuple[Source, ...]], TrajectorySolution]


def solved_in_step(
    apart: Sequence[Source], later_frames: Sequence[float], solve: Solve, sigma_px: float, keypoint_sigma_m: float
) -> tuple[tuple[Source, ...], TrajectorySolution]:
    """Sources on their own frames put on those of one clip, with the offsets that were found, and their solution.

    later_frames: where the search begins. solve: with `find_offsets`. Raises InputError where the motion does not tell.
    """
    later, fps = np.array(later_frames), apart[0].keypoints.fps
    assert fps is not None
    begun = views_of(together(apart, later_frames))
    found = search_offsets(begun, fps, sigma_px, keypoint_sigma_m)
    names = [source.camera.name for source in apart]
    alone = [name for name, frames in zip(names, found, strict=True) if np.isnan(frames)]
    if alone:
        expected = "keypoints that it sees together with another camera, in 30 or more points"
        raise InputError(Problem("--set find-offsets", f"camera {name}", "too few", expected) for name in alone)
    later = later + found
    sources = together(apart, later.tolist())
    solution = solve(sources)
    for _ in range(1, FIT_ROUNDS):
        if np.abs(solution.time_offset_frames).max() < CLOSE_FRAMES:
            break
        later = later + solution.time_offset_frames
        sources = together(apart, later.tolist())
        solution = solve(sources)
    refuse(_problems(names, later, solution.time_offset_frames, solution.time_offset_sigma_frames))
    return sources, solution


def _problems(names: Sequence[str], later: Array, rests: Array, sigmas: Array) -> Iterator[Problem]:
    for name, frames, lag, sigma in zip(names, later, rests, sigmas, strict=True):
        if sigma > MAX_SIGMA_FRAMES or abs(lag) > MAX_SIGMA_FRAMES:
            found = f"{frames + lag:.1f} ± {max(sigma, abs(lag)):.1f} frames later, from a motion that hardly tells"
            expected = f"a clip that tells it to {MAX_SIGMA_FRAMES:g}, or --set offset-s as measured otherwise"
            yield Problem("--set find-offsets", f"camera {name}", found, expected)


def why_not_refined(refined: TrajectorySolution, held: TrajectorySolution) -> tuple[Finding, ...]:
    """Why cameras stay as calibrated; nothing where the refined ones are to be taken.

    A camera that leaves its pose becomes an outlier as a whole, which a robust cost rewards; and where none fits
    better, the refined poses are only less certain."""
    before, after = _medians_px(held), _medians_px(refined)
    names, turns_rad = [v.camera.name for v in held.views], np.linalg.norm(refined.extrinsic_correction[:, :3], axis=1)
    lost = (after > WORSE * before) | (after > LOST * np.median(after))
    worst, far = int(np.argmax(lost * after / before)), int(np.argmax(turns_rad))
    if lost[worst]:
        return (finding("cameras_not_refined", camera=names[worst], before_px=before[worst], after_px=after[worst]),)
    if turns_rad[far] > FAR * constants.CAMERA_ROTATION_RAD:
        return (finding("camera_left_its_pose", camera=names[far], turn_deg=float(np.degrees(turns_rad[far]))),)
    if not (before > BETTER * after).any():
        return (finding("cameras_as_calibrated"),)
    return ()


def _medians_px(solution: TrajectorySolution) -> np.ndarray:
    """(V,): median distance between detections and reprojected markers; infinite where none has a pose."""
    medians = []
    for view in solution.views:
        pixels, _ = view.project(view.at_its_time(solution.markers_m))
        off = np.linalg.norm(pixels - view.xy_px, axis=-1)[view.present]
        off = np.where(np.isfinite(off), off, np.inf)
        medians.append(float(np.median(off)) if off.size else 1.0)
    return np.maximum(medians, 1e-9)
