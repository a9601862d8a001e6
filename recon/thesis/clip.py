"""One clip by the frame method: a keypoint file and a camera in, the motion of one side of the animal out."""

from __future__ import annotations

from dataclasses import fields

from recon.animal.body import Body
from recon.animal.skeleton_file import load_chain
from recon.base import Progress, silent
from recon.check import judged
from recon.clip import views_of
from recon.fit.motion import Motion
from recon.thesis.frame import FrameOptions, solve_frames
from recon.workflows.clip import prepare
from recon.workflows.settings import SETTINGS, FitSettings


def fit_clip(settings: FitSettings, progress: Progress = silent) -> Motion:
    """Reconstruct one side of the animal as a chain, one frame after the other.

    Raises InputError for files and settings that cannot be used, with the problems of all of them. Frames that cannot
    be solved are part of the result.
    """
    given, chain = prepare(settings), load_chain(settings.skeleton_name)
    (view,), T = views_of(given.sources), len(given.sources[0].keypoints.frames)
    solution = solve_frames(view, chain, given.fps, frame_options(settings), lambda done: progress("frames", done / T))
    plain = settings.plain()
    motion = Motion(given.sources, given.side, given.side_reason, solution, chain=chain, settings=plain)
    return judged(motion)


def load_body(settings: FitSettings) -> Body:
    """The animal of the settings' chain. Raises InputError for a skeleton that is no chain."""
    return load_chain(settings.skeleton_name).body


def frame_options(settings: FitSettings) -> FrameOptions:
    """The options of the frame method among the settings of a fit."""
    return FrameOptions(
        **{name: getattr(settings, name) for field in fields(FrameOptions) if (name := field.name) in SETTINGS}
    )
