"""Input findings: copied coordinates, a camera that moves, left-right swaps, gross outliers, a picture turned over,
another camera's by its file's name, a wrong frame rate.

What was copied, and how no animal moves, is said first: it is certain, and leaves nothing else to be told. The rest is
recognised by how much likelier the clip is with it undone (`likelihood`), where that can be told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from threadpoolctl import threadpool_limits

from recon.animal.prior import NONE, MotionPrior, mean_speed_m_s
from recon.check.codes import FLAG_OF, finding
from recon.check.inputs.certain import copies, movement
from recon.check.inputs.likelihood import (
    Baseline,
    baseline_of,
    of_other_picture,
    of_unit_square,
    other_rate,
    zooms,
)
from recon.check.inputs.swaps import swap_finding, swaps
from recon.fit import TrajectoryOptions, TrajectorySolution
from recon.fit.clip_problem import ClipProblem
from recon.fit.motion import Motion
from recon.fit.result import Finding
from recon.geometry.kinematics import ROOT

FASTEST_M_S = 40.0
"""No animal runs as fast: cheetahs reach 29 m/s (N. Sharp, *Timed running speed of a cheetah*, J. Zool. 1997)."""

MOVES = ("animal_still", "time_reversed", "camera_moves")
"""What makes sides doubtful by itself."""


def input_findings(
    motion: Motion,
    prior: MotionPrior,
    options: TrajectoryOptions,
    named: Sequence[str | None],
    stated_hz: float | None = None,
    seek_swaps: bool = True,
) -> tuple[Finding, ...]:
    """The findings on the keypoints that a motion was fitted to. Each angle on its own, where no prior was learned,
    tells neither sides nor rates.

    named: by view, the other camera that its file's name says. stated_hz: the frame rate that a file states.
    seek_swaps: whether left-right swaps are looked for, which takes longest."""
    solution, body, fps = motion.solution, motion.body, motion.fps
    assert isinstance(solution, TrajectorySolution)
    clip = ClipProblem.of(solution.views, body, prior, fps, options)
    weighed = replace(clip, prior_weight=min((segment.prior_weight for segment in solution.segments), default=1.0))
    too_fast = mean_speed_m_s(solution.states, fps) > FASTEST_M_S  # nor does the prior know it
    unlike = too_fast or any(segment.unlike_prior for segment in solution.segments)
    found = [*copies(motion.sources, resampled=bool(motion.settings.get("camera_fps")))]
    certain = any(one.severity == "error" for one in found)
    moves = [] if certain else [*movement(motion)]
    stated = certain or any(one.code in MOVES for one in moves)
    learned = prior.name != NONE and bool(solution.posed.any())
    elsewhere = any(segment.ground and segment.ground.near_zero is False for segment in solution.segments)
    on_ground = replace(weighed, ground_near_zero=weighed.ground_near_zero and not elsewhere)
    pictures: list[Finding] = []
    with threadpool_limits(1, user_api="blas"):
        for number, source in enumerate(motion.sources):
            camera, as_given = source.camera.name, baseline_of(clip, number, solution.states, solution.size)
            if named[number] is not None:
                pictures.append(finding("other_camera_named", camera=camera, given=camera, other=named[number]))
            elif of_picture := of_unit_square(as_given) or of_other_picture(as_given):
                pictures.append(of_picture)
            elif learned and not stated:
                given = baseline_of(on_ground, number, solution.states, solution.size)
                swapped = [swap_finding(trial, source, body) for trial in (swaps(given, unlike) if seek_swaps else ())]
                found += swapped
                if len(motion.sources) == 1 and not (swapped or moves):
                    moves += zooms(given, solution.noise_px[number])
        found += pictures
        slides = [one.numbers.get("slide_m_s") for one in moves]
        glides = any(isinstance(one, float) and one > 0 for one in slides)  # as at a rate that is too high
        if glides or not (stated or pictures):
            found += _of_rate(clip, solution, stated_hz)
    if not pictures and not any(one.code.startswith("frame_rate") for one in found):
        found += moves
    return tuple(found)


def _of_rate(clip: ClipProblem, solution: TrajectorySolution, stated_hz: float | None) -> Sequence[Finding]:
    posed = np.isfinite(solution.states[:, 0])
    segments = [segment.rows for segment in solution.segments if posed[segment.rows].all()]
    if not segments:
        return ()
    longest = max(segments, key=lambda rows: rows.stop - rows.start)
    states = solution.states[longest].copy()
    states[:, ROOT] = (states[:, ROOT] - clip.origin_m) / solution.size
    found = other_rate(clip.part(longest), states, stated_hz)
    return () if found is None else (found,)


def flagged(motion: Motion, findings: Sequence[Finding]) -> Motion:
    """A motion with the flags of the frames that findings are about."""
    flags = [*motion.flags]
    for one in findings:
        name = FLAG_OF.get(one.code)
        if name is not None and one.frames is not None:
            for t in range(*np.searchsorted(motion.frames, one.frames)):
                flags[t] = flags[t] if name in flags[t] else (*flags[t], name)
    return replace(motion, solution=replace(motion.solution, flags=tuple(flags)))
