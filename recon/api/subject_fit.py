"""Measure one animal from clips of several cameras: its lengths, and the offsets of its detector."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from recon.animal.bones import bones_of
from recon.animal.measured import detector_toml, subject_toml
from recon.animal.skeleton_file import NONE
from recon.api.clip_inputs import prepare
from recon.api.clip_results import read_config
from recon.api.model_settings import SubjectFitSettings
from recon.api.settings import FitSettings
from recon.base.arrays import Array, Integers
from recon.base.errors import InputError, Problem, collect_problems
from recon.base.outputs import output_file, require_suffix
from recon.base.settings import input_paths
from recon.clip import views_of
from recon.fit.body_shape import Shape
from recon.fit.clip_problem import ClipProblem
from recon.fit.motion_forms import CONFIG
from recon.fit.points import MIN_MARKERS, solve_points
from recon.fit.regions import radius
from recon.fit.shape import POSED_OFFSET_SIGMA_M, ShapeFit, fit_shape
from recon.gait.stances import INTERVAL
from recon.io.common import Pose3D
from recon.io.positions import read_pose3d

MIN_SIZE_SIGMA = 0.01
"""Smallest size_sigma of a measured animal, because keypoints are not placed on an animal more precisely than this."""


def _rows(fit: ShapeFit, size_sigma: float) -> Iterator[dict[str, Any]]:
    """Yield a row for each measured length, in metres, and each measured offset, in millimetres."""
    shape, values, sigma = fit.shape, fit.values, fit.sigma
    for name in shape.lengths:
        length_m, sigma_m, _ = fit.length_of((name,), size_sigma)
        yield {"name": name, "value": length_m, "sigma": sigma_m, "unit": "m"}
    first = len(shape.lengths)
    for name, value, s in zip(shape.names[first:], values[first:], sigma[first:], strict=True):
        yield {"name": name, "value": 1e3 * float(value), "sigma": 1e3 * float(s), "unit": "mm"}


def _bones(fit: ShapeFit, size_sigma: float) -> Iterator[dict[str, Any]]:
    """Yield a dictionary for each bone with its name, the points that it connects, its length and its interval.

    `data_share` is the fraction of the information that comes from the pixels.
    """
    for bone in bones_of(fit.shape.body):
        if not {*bone.offsets} <= {*fit.shape.lengths}:
            continue
        length_m, sigma_m, data_share = fit.length_of(bone.offsets, size_sigma)
        reach_m = radius(INTERVAL) * sigma_m
        yield {
            "bone": bone.name,
            "connects": list(bone.connects),
            "offsets": list(bone.offsets),
            "length_m": length_m,
            "sigma_m": sigma_m,
            "interval_m": [length_m - reach_m, length_m + reach_m],
            "data_share": data_share,
        }


def run_subject_fit(settings: SubjectFitSettings) -> dict[str, Any]:
    """Measure an animal and its detector in clips, and write a subject file, or a detector file without lengths.

    Returns
    -------
    dict
        Plain types: `values`, the measured lengths (m) and offsets (mm) with their standard deviations; `bones`, the
        same lengths by bone; `size`, the mean ratio of the lengths to those of the skeleton, and `size_sigma`; the
        numbers of `clips` and `frames`; and `converged`.

    Raises
    ------
    InputError
        If clips or options cannot be used. The message lists all problems.
    """
    output = output_file(settings.out, "subject fit", settings.overwrite, input_paths(settings))
    settings_by_clip, _, _, known_poses = collect_problems(
        lambda: collect_problems(*(partial(read_config, p / CONFIG if p.is_dir() else p, {}) for p in settings.clips)),
        lambda: require_suffix(settings.out, (".toml",)),
        lambda: output.require((settings.out.name,)),
        lambda: collect_problems(*(partial(read_pose3d, path) for path in settings.poses)),
    )
    _require_one_skeleton(settings_by_clip, settings.clips)
    if settings.lengths:  # lengths are measured relative to the skeleton, not to an earlier subject
        settings_by_clip = [replace(fit_settings, subject=None) for fit_settings in settings_by_clip]
    if settings.offsets:
        settings_by_clip = [replace(fit_settings, detector=NONE) for fit_settings in settings_by_clip]
    fit_inputs = zip(settings_by_clip, settings.clips, known_poses or (None,) * len(settings.clips), strict=True)
    problems = collect_problems(*(partial(clip_problem, *fit_input) for fit_input in fit_inputs))
    shape = Shape.of_body(problems[0].body, settings.lengths, settings.offsets)
    if known_poses:
        shape = replace(shape, offset_sigma_m=POSED_OFFSET_SIGMA_M)
    try:
        fit = fit_shape(shape, problems)
    except ValueError as error:
        raise InputError(Problem(settings.clips[0], "clips", str(error), "clips that `recon fit` can solve")) from None
    length_count = len(shape.lengths)
    size, sigma = 1.0, problems[0].size_sigma
    if length_count:
        size = float(np.exp(fit.values[:length_count].mean()))
        sigma = max(float(np.sqrt(fit.covariance[:length_count, :length_count].mean())), MIN_SIZE_SIGMA)
    frames = sum(int((problem.present().sum(axis=1) > 0).sum()) for problem in problems)
    prior_sigma = problems[0].size_sigma
    rows = list(_rows(fit, prior_sigma))
    body = replace(shape.applied(shape.body, fit.values), size_sigma=sigma)
    bones = [*_bones(fit, prior_sigma)] if length_count else []
    notes = ["{name}: {value:.4g} ± {sigma:.2g} {unit}".format(**row) for row in rows]
    count = f"measured in {len(settings.clips)} clip{'s' * (len(settings.clips) > 1)}"
    if settings.lengths:
        if not settings.offsets:  # offsets belong to the detector, not to the animal
            body = replace(body, keypoint_offset_m={})
        text = subject_toml(
            settings_by_clip[0].skeleton_name, body, settings.title or f"{shape.body.title}, {count}", notes
        )
    else:
        text = detector_toml(fit.seen(shape.body), settings.title or f"a detector, {count}", notes)
    output.write(settings.out.name, text)
    counts = {"clips": len(settings.clips), "frames": frames, "converged": fit.converged}
    return {**counts, "size": size, "size_sigma": sigma, "bones": bones, "values": rows}


def _require_one_skeleton(settings: Sequence[FitSettings], clips: Sequence[Path]) -> None:
    names = {clip_settings.skeleton_name for clip_settings in settings}
    if len(names) > 1:
        actual = ", ".join(
            f"{path}: {clip_settings.skeleton_name}" for path, clip_settings in zip(clips, settings, strict=True)
        )
        raise InputError(Problem("CLIPS", "skeleton", actual, "clips of the same skeleton"))


def clip_problem(settings: FitSettings, path: Path, pose: Pose3D | None) -> ClipProblem:
    """Return the least-squares problem of a clip, or raise InputError if the clip cannot show the animal's lengths."""
    if settings.method != "trajectory":
        raise InputError(Problem(path, "method", settings.method, "the trajectory method"))
    inputs = prepare(settings)
    if inputs.body.one_sided:
        expected = "a whole animal: a chain's lengths are in its own skeleton file"
        raise InputError(Problem(path, "skeleton", inputs.body.name, expected))
    views, options = views_of(inputs.sources), settings.trajectory_options()
    problem = ClipProblem.from_views(views, inputs.body, inputs.prior, inputs.fps, options)
    if not problem.shows_size:
        actual = f"one static camera, {inputs.sources[0].camera.name}"
        raise InputError(Problem(path, "cameras", actual, "several cameras, or a moving one, to measure lengths"))
    if pose is None:
        return problem
    return replace(problem, known_states=_known_states(problem, inputs.sources[0].keypoints.frames, pose))


def _known_states(problem: ClipProblem, frames: Integers, pose: Pose3D) -> Array:
    """Return the states (T, D) whose markers are nearest to a given pose, NaN in frames without one.

    Raises
    ------
    InputError
        If the pose shares no frame with the clip, or has too few of the markers.
    """
    markers = problem.body.markers
    _, clip_rows, pose_rows = np.intersect1d(frames, pose.frames, return_indices=True)
    points_m = np.full((len(frames), len(markers), 3), np.nan)
    points_m[clip_rows] = pose.of_joints(markers)[pose_rows]
    states, *_ = solve_points(problem.body, points_m)
    if not np.isfinite(states).all(axis=1).any():
        actual = f"{len(clip_rows)} of the clip's frames, {len({*markers} & {*pose.names})} of the skeleton's markers"
        expected = f"{MIN_MARKERS} or more of {', '.join(markers)} in frames of the clip, with its frame numbers"
        raise InputError(Problem(pose.source or "--poses", "poses", actual, expected))
    return states
