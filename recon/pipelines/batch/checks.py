"""What is wrong with a batch's inputs, as far as it can be told without fitting."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from recon.body import Body
from recon.calibration import read_camera
from recon.errors import InputError, Problem, all_of
from recon.pipelines.batch.inputs import Clip
from recon.pipelines.clip import read_clip
from recon.prior import load_prior
from recon.settings import FitSettings
from recon.skeleton_file import load_chain, load_skeleton

Problems = tuple[Problem, ...]


def input_problems(clips: Sequence[Clip]) -> list[Problems]:
    """Of each clip: everything that reading its files brings to light."""
    models = _model_problems(clips)
    return [
        _problems_of(lambda s=clip.settings: read_clip(s)) + model for clip, model in zip(clips, models, strict=True)
    ]


def check_shared(clips: Sequence[Clip]) -> None:
    """Raises InputError for problems with cameras, skeletons, subjects and priors that every clip has."""
    common = set.intersection(*map(set, _model_problems(clips))) if clips else set()
    if common:
        raise InputError(sorted(common, key=str))


def _model_problems(clips: Iterable[Clip]) -> list[Problems]:
    """Of each clip, but for its keypoints; what clips share is read once."""
    known: dict[FitSettings, Problems] = {}
    each = []
    for clip in clips:
        shared = replace(clip.settings, keypoints=Path(), individual=None, frames=None)
        if shared not in known:
            known[shared] = _problems_of(lambda s=shared: _read_model(s), lambda s=shared: _read_camera(s))
        each.append(known[shared])
    return each


def _read_model(settings: FitSettings) -> None:
    if settings.method == "frame":
        load_chain(settings.skeleton_name)
        return
    skeleton = load_skeleton(settings.skeleton_name, settings.subject)
    if settings.prior is not None:
        load_prior(settings.prior, skeleton if isinstance(skeleton, Body) else skeleton.body)


def _read_camera(settings: FitSettings) -> None:
    if settings.camera is not None:
        read_camera(settings.camera, settings.camera_name, settings.image_size_px)


def _problems_of(*reads: Callable[[], Any]) -> Problems:
    try:
        all_of(*reads)
    except InputError as error:
        return error.problems
    return ()
