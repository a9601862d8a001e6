"""Test whether the clocks of the cameras drift apart, as if a camera took 59 pictures per second instead of 60."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from recon.base.arrays import Array
from recon.check.codes import EFFECTS, finding
from recon.check.constants import EFFECT_OF_NOTE, LIMIT_OF_TRUNK
from recon.check.one_step import Detections, Step, Unknown, one_steps
from recon.fit.clip_problem import ClipProblem
from recon.fit.least_squares import frames_per_piece
from recon.fit.result import Finding, TrajectorySolution
from recon.fit.starts import APPROACH_HZ

DRIFT_SIGMAS = 3.5
"""Drift of a camera's clock, in standard deviations, from which the drift is reported.

In clips of half a second, the drift is at most 1.2 in correct pairs of cameras, and 0.0 to 1.3 (median 0.6) if one
camera takes one picture per second fewer (`python benchmarks/wrong_inputs.py --only limits`). Half or twice the limit
would change none of these results, because only longer clips show such a drift. The limit is almost three times the
largest drift in correct pairs.
"""
NO_DRIFT_SIGMAS = 0.5 * DRIFT_SIGMAS
"""Drift in the quick test of a long clip, in standard deviations, from which the test is repeated with all frames.

The quick test uses only some of the frames.
"""
RAY_SIGMAS = 3.0
"""Margin by which the drift from rays must be below half of the estimated drift to refute it, in standard deviations.

Wrong lengths of a rough skeleton look like a drift, but rays do not depend on the lengths. Errors of detections rarely
reach three standard deviations, so a real drift is rarely refuted (`tests/check/test_clocks.py` tests both).
"""


def drifts_of(clip: ClipProblem, solution: TrajectorySolution, every: int = 1) -> dict[int, Step]:
    """Return a dictionary of the drift of each camera's clock over the clip, in frames, with the camera's index as key.

    If `every` is above 1, only every n-th frame is used, which is several times faster but less exact (`one_steps`).
    """
    segment = solution.longest_segment
    if segment is None:
        return {}
    frames = len(range(segment.rows.start, segment.rows.stop, every))

    def by_drift(detections: Detections) -> Array:
        return detections.by_frame_px * ((detections.frames - 0.5 * (frames - 1)) / frames)[:, None, None]

    first = 1 if len(clip.views) == 2 else 0  # for two cameras, only the difference of their clocks is known
    clocks = {camera: Unknown(camera, by_drift) for camera in range(first, len(clip.views))}
    steps = one_steps(clip, solution, clocks, every)
    return {camera: Step(every * step.value, every * step.sigma) for camera, step in steps.items()}


def drift_findings(
    clip: ClipProblem, solution: TrajectorySolution, names: Sequence[str], fps: float
) -> Iterator[Finding]:
    """Yield a finding on the camera with the most significant clock drift, unless the rays contradict the drift.

    Parameters
    ----------
    clip
        The problem of the whole clip, with two or more views.
    solution
        Solution of the problem.
    names
        Names of the cameras.
    fps
        Stated frame rate of all cameras, frames per second.
    """
    segment = solution.longest_segment
    if segment is None:
        return
    frames = segment.rows.stop - segment.rows.start
    if frames > 2 * frames_per_piece(fps):  # a quick test with some of the frames comes first
        rough = drifts_of(clip, solution, every=max(1, round(fps / APPROACH_HZ)))
        if all(abs(step.value) < NO_DRIFT_SIGMAS * step.sigma for step in rough.values()):
            return
    steps = drifts_of(clip, solution)
    sigmas = {camera: step.value / step.sigma for camera, step in steps.items()}
    camera = max(sigmas, key=lambda number: abs(sigmas[number]), default=None)
    if camera is None or abs(sigmas[camera]) < DRIFT_SIGMAS:
        return
    if _is_refuted_by_rays(clip, solution, segment.rows, camera, steps[camera].value):
        return
    drift_frames, middle_m = steps[camera].value, solution.joints_m[segment.rows].mean(axis=1)
    step_m = float(np.linalg.norm(np.diff(middle_m, axis=0), axis=1).mean())
    # A camera that is in step at one end of the clip is off by half of the drift on average.
    effect_m = 0.5 * abs(drift_frames) * step_m
    rear, front = (solution.markers_m[segment.rows, clip.body.markers.index(name)] for name in clip.body.forward)
    trunk_m = float(np.linalg.norm(front - rear, axis=-1).mean())
    if effect_m < EFFECT_OF_NOTE * LIMIT_OF_TRUNK * trunk_m:
        return
    rate_hz = fps / (1.0 + drift_frames / frames)
    numbers = {"drift_frames": drift_frames, "rate_hz": rate_hz, "given_hz": fps, EFFECTS[1]: effect_m}
    yield finding("clock_drifts", camera=names[camera], **numbers)


def _is_refuted_by_rays(
    clip: ClipProblem, solution: TrajectorySolution, rows: slice, camera: int, drift_frames: float
) -> bool:
    """Return whether the rays in some frames show less than half of a drift, without using the animal's lengths."""
    from recon.check.sights import drift_by_rays  # fits of one camera do not import it

    by_rays, sigma = drift_by_rays([view.part(rows) for view in clip.views], solution.markers_m[rows], camera)
    return bool(by_rays * np.sign(drift_frames) + RAY_SIGMAS * sigma < 0.5 * abs(drift_frames))
