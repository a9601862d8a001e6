"""One clip by the frame method: a keypoint file and a camera in, the motion of one side of the animal out."""

from __future__ import annotations

from typing import Annotated, Any

from rich.console import Console

from recon.animal.body import Body
from recon.animal.chain import load_chain
from recon.base import Progress, silent
from recon.check import judged
from recon.clip import views_of
from recon.fit.motion import Motion
from recon.wings.thesis.frame import FrameOptions, solve_frames
from recon.workflows.cli import Answer, OptionsOf
from recon.workflows.clip import prepare
from recon.workflows.fit import FitRunSettings, fit
from recon.workflows.settings import SETTINGS, FitSettings

_OPTIONS = tuple(name for name, info in SETTINGS.items() if name != "method" and info.option.method in (None, "frame"))


def fit_clip(settings: FitSettings, progress: Progress = silent) -> Motion:
    """Reconstruct one side of the animal as a chain, one frame after the other.

    Raises InputError for files and settings that cannot be used, with the problems of all of them. Frames that cannot
    be solved are part of the result.
    """
    given, chain, plain = prepare(settings), load_chain(settings.skeleton_name), settings.plain()
    (view,), T = views_of(given.sources), len(given.sources[0].keypoints.frames)
    options = FrameOptions.of(plain)
    solution = solve_frames(view, chain, given.fps, options, lambda done: progress("frames", done / T))
    return judged(Motion(given.sources, given.side, given.side_reason, solution, chain=chain, settings=plain))


def load_body(settings: FitSettings) -> Body:
    """The animal of the settings' chain. Raises InputError for a skeleton that is no chain."""
    return load_chain(settings.skeleton_name).body


def frame(
    settings: FitRunSettings,
    given: Annotated[dict[str, Any], OptionsOf(FitSettings, _OPTIONS)],
    console: Console,
    progress: Progress,
) -> Answer:
    """The thesis' method, to compare with: one side of the animal as a chain, one frame after the other.

    Example: recon frame clip.csv --camera scene.json --camera-name cam2 --fps 90 --out results/clip

    Exit code 0: done. 1: no frame could be solved. 2: the input cannot be used.
    """
    return fit(settings, {**given, "method": "frame"}, console, progress)
