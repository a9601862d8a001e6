"""What is solved of cameras with the fit: by how many frames they are out of step, sought first where rays of the same
keypoint meet; and whether poses that were refined are taken, which is only where no camera's pictures fit worse."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, refuse
from recon.check.agreement import search_offsets
from recon.check.codes import finding
from recon.clip import Source, together, views_of
from recon.fit import TrajectorySolution
from recon.fit.result import Finding

FIT_ROUNDS = 5
CLOSE_FRAMES = 0.05
"""Lags this small are left to the solver, which takes the motion for straight over them."""
WORSE = 1.1
"""Times a camera's median reprojection that is no change: what one camera gains, another may lose a little."""
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


def _problems(names: Sequence[str], later: Array, lags: Array, sigmas: Array) -> Iterator[Problem]:
    for name, frames, lag, sigma in zip(names, later, lags, sigmas, strict=True):
        if sigma > MAX_SIGMA_FRAMES or abs(lag) > MAX_SIGMA_FRAMES:
            found = f"{frames + lag:.1f} ± {max(sigma, abs(lag)):.1f} frames later, from a motion that hardly tells"
            expected = f"a clip that tells it to {MAX_SIGMA_FRAMES:g}, or --set offset-s as measured otherwise"
            yield Problem("--set find-offsets", f"camera {name}", found, expected)


def cameras_made_worse(refined: TrajectorySolution, held: TrajectorySolution) -> tuple[Finding, ...]:
    """A finding on the camera whose median reprojection got worst by refining all; none where that is no worse than
    `WORSE`.

    A camera that leaves its place becomes an outlier as a whole, which a robust cost rewards."""
    before, after = _medians_px(held), _medians_px(refined)
    worst = int(np.argmax(after / before))
    if not after[worst] > WORSE * before[worst]:
        return ()
    name = held.views[worst].camera.name
    return (finding("cameras_not_refined", camera=name, before_px=before[worst], after_px=after[worst]),)


def _medians_px(solution: TrajectorySolution) -> np.ndarray:
    """(V,): median distance between detections and reprojected markers; infinite where none has a pose."""
    medians = []
    for view in solution.views:
        pixels, _ = view.project(view.at_its_time(solution.markers_m))
        off = np.linalg.norm(pixels - view.xy_px, axis=-1)[view.present]
        off = np.where(np.isfinite(off), off, np.inf)
        medians.append(float(np.median(off)) if off.size else 1.0)
    return np.maximum(medians, 1e-9)
