"""Estimate the poses of cameras from lenses and clips of the animal, and write a file with all poses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from recon.api.batch_inputs import AUTO, find_clips
from recon.api.clip_inputs import ClipInputs, prepare
from recon.api.clip_results import input_files, read_settings
from recon.api.settings import FitSettings
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.outputs import output_file, require_suffix
from recon.base.progress import Progress, silent
from recon.clip import Source, View, align_cameras, camera_poses
from recon.fit.clip_problem import ClipProblem
from recon.fit.extrinsics import LEVEL_RAD, Rig, search_offsets, solve_extrinsics
from recon.geometry.camera import Camera
from recon.geometry.frames import level_from_camera, rigid
from recon.io.camera_files import write_cameras

MAX_CHI_SQUARED = 16.0
"""Squared deviation of a camera's 6 pose parameters, over their variances, above which the camera probably moved.

By chance, 1 camera in 70 exceeds this limit (chi-squared with 6 degrees of freedom).
"""
MAX_TURN_SIGMA_DEG = 10.0
"""Standard deviation of a camera's rotation, degrees, above which its pose counts as unknown; an assumption."""
MIN_MOVED = 0.5
"""Minimum path of the animal in a picture, in body lengths. An animal that stands and sways moves less."""


def clips_of(
    inputs: Sequence[str | Path], options: Mapping[str, Any], cameras_by: str = AUTO
) -> tuple[list[FitSettings], list[str]]:
    """Return the settings of the clips in keypoint files, folders and manifests, as in a batch, and notes.

    If `camera_name` is among the options, all files belong to one clip.

    Raises
    ------
    InputError
        If inputs cannot be used.
    """
    if options.get("camera_name") is not None:
        return [read_settings(None, {**options, "keypoints": inputs})], []
    clips, notes = find_clips(inputs, options, None, cameras_by, posed=False)
    return [clip.settings for clip in clips], notes


def run_extrinsics(
    clips: Sequence[FitSettings],
    out: Path,
    overwrite: bool = False,
    level_rad: float = 0.0,
    progress: Progress = silent,
) -> tuple[tuple[Camera, ...], dict[str, Any]]:
    """Estimate the poses of cameras from clips of the animal, and write `out`, a camera file.

    The world has z up and the ground at z = 0. If the clips' settings ask to refine the poses of the camera file, its
    world is kept.

    Parameters
    ----------
    clips
        Settings of each clip.
    out
        The camera file, which `recon.io.calibration.read_cameras` reads.
    overwrite
        Whether an existing file may be replaced.
    level_rad
        Standard deviation (rad) of the cameras' angles from level, or from the given tilt; 0 means `LEVEL_RAD`.
    progress
        Called with the name of the stage and the fraction of it that is done.

    Returns
    -------
    tuple
        The cameras, and the report that `--json` prints. The sigmas in the report describe the position of a camera
        relative to the first camera (`Camera.corrected`). The sigma of the height is None if the ground is unknown or
        comes from the camera file. Time offsets are as given or as estimated.

    Raises
    ------
    InputError
        If inputs cannot be used. The message lists every problem.
    """
    posed, tilt_deg = bool(clips[0].refine_cameras), clips[0].tilt_deg
    inputs = [path for clip in clips for path in input_files(clip).values()]
    output = output_file(out, "calibrate extrinsics", overwrite, inputs)
    conflict = "--set refine-cameras=true as well, which reads it from the file", "only one of the two"
    tilt_options = {"--tilt-deg": tilt_deg, "--level-deg": level_rad or None} if posed else {}
    prepared, *_ = collect_problems(
        lambda: collect_problems(*(lambda clip=clip: _prepared_by_camera(clip) for clip in clips)),
        lambda: raise_problems(
            Problem(option, "up", *conflict) for option, value in tilt_options.items() if value is not None
        ),
        lambda: require_suffix(out, (".toml",)),
        lambda: output.require((out.name,)),
    )
    cameras = _all_cameras(prepared)
    cameras, poses = _with_stated_poses(cameras) if posed else _in_own_worlds(cameras, tilt_deg)
    aligned = [_aligned_sources(*problem_inputs) for problem_inputs in zip(clips, prepared, strict=True)]
    if not posed:
        _require_motion(aligned)
    firsts = [inputs[0] for inputs in prepared]
    problems = [
        _clip_problem(*problem_inputs, cameras, poses) for problem_inputs in zip(clips, firsts, aligned, strict=True)
    ]
    rig = solve_extrinsics(problems, posed, level_rad or LEVEL_RAD, progress)
    _require_known_rotations(cameras, rig)
    posed_cameras = _in_world_of_rig(cameras, rig, 0.0 if posed else -np.nan_to_num(rig.ground_m))
    with output.staged_file() as staged:
        write_cameras(posed_cameras, staged)
    clip_rows = zip(clips, aligned, firsts, rig.time_offset_frames, rig.disagreement, strict=True)
    return posed_cameras, {
        "cameras": [
            _camera_row(camera, sigma, math.nan if posed else height_sigma_m)
            for camera, sigma, height_sigma_m in zip(posed_cameras, rig.sigma, rig.height_sigma_m, strict=True)
        ],
        "clips": [
            _clip_row(clip, sources, posed_cameras, np.array(late_frames) / first.fps, disagreement)
            for clip, sources, first, late_frames, disagreement in clip_rows
        ],
        "converged": rig.converged,
        "written": str(out),
    }


def _with_stated_poses(cameras: Sequence[Camera]) -> tuple[list[Camera], list[Array]]:
    """Return the cameras and their poses from the camera file, or raise InputError if a camera has no pose."""
    if unposed := [camera.name for camera in cameras if not camera.has_extrinsics]:
        expected = "a camera file with the poses of all cameras"
        raise InputError(Problem("--set refine-cameras", "poses", f"no poses of {', '.join(unposed)}", expected))
    return [*cameras], camera_poses(cameras)


def _in_own_worlds(cameras: Sequence[Camera], tilt_deg: float | None) -> tuple[list[Camera], list[Array]]:
    """Return the cameras without extrinsics, each at the origin of its own world, and their poses (4, 4).

    `tilt_deg` replaces the tilt of the cameras; None keeps it.
    """
    tilt = {} if tilt_deg is None else {"tilt_rad": math.radians(tilt_deg)}
    cameras = [replace(camera, rotation=None, translation_m=None, **tilt) for camera in cameras]
    return cameras, [rigid(level_from_camera(camera.up).T, np.zeros(3)) for camera in cameras]


def _require_known_rotations(cameras: Sequence[Camera], rig: Rig) -> None:
    """Raise an InputError if the clips do not determine every camera's rotation to within `MAX_TURN_SIGMA_DEG`.

    The message names the cameras.
    """
    turn_sigma_deg = np.degrees(np.linalg.norm(rig.sigma[:, :3], axis=1))
    expected = "clips in which the animal crosses the view in other directions"
    raise_problems(
        Problem("KEYPOINTS", f"camera {camera.name}", f"a rotation known only to {turn_deg:.0f} degrees", expected)
        for camera, turn_deg in zip(cameras, turn_sigma_deg, strict=True)
        if turn_deg > MAX_TURN_SIGMA_DEG
    )


def _in_world_of_rig(cameras: Sequence[Camera], rig: Rig, height_m: float) -> tuple[Camera, ...]:
    """Return the cameras with their estimated poses, in a world whose origin is `height_m` below the rig's origin."""
    return tuple(
        replace(camera, rotation=T[:3, :3], translation_m=T[:3, 3] - height_m * T[:3, 2], world_z_up=True, tilt_rad=0.0)
        for camera, T in zip(cameras, rig.T_camera_world, strict=True)
    )


def _camera_row(camera: Camera, sigma: Array, height_sigma_m: float) -> dict[str, Any]:
    """Return a camera's row of the report.

    `sigma` (6,) has the standard deviations of the camera's rotation (rad) and position (m). `height_sigma_m` is NaN if
    unknown.
    """
    return {
        **camera.to_dict(),
        "turn_sigma_rad": sigma[:3].tolist(),
        "shift_sigma_m": sigma[3:].tolist(),
        "height_sigma_m": None if math.isnan(height_sigma_m) else float(height_sigma_m),
    }


def _clip_row(
    clip: FitSettings, sources: Sequence[Source], cameras: Sequence[Camera], late_s: Array, disagreement: Array
) -> dict[str, Any]:
    """Return a clip's row of the report, with the time offset and the disagreement of each of its cameras.

    `late_s` has the delays of the clip's sources relative to the first, s. `disagreement` (C,) has one value for each
    of the C cameras.
    """
    names = [camera.name for camera in cameras]
    late_by_camera = dict(zip(names, late_s, strict=True))
    began_s = np.array([source.offset_s + late_by_camera[source.camera.name] for source in sources])
    return {
        "keypoints": [*map(str, clip.keypoints)],
        "offset_s": (began_s - began_s[0]).tolist(),
        "found_offsets": bool(clip.find_offsets),
        "disagreement": dict(zip(names, disagreement.tolist(), strict=True)),
    }


def _require_motion(clips: Sequence[Sequence[Source]]) -> None:
    """Raise InputError if the animal stays in the same position in all pictures of all clips.

    The poses of the cameras relative to each other follow from the path of the animal.
    """
    moved = max(_lengths_moved(source.keypoints.xy_px) for sources in clips for source in sources)
    if moved < MIN_MOVED:
        actual = f"an animal that moves by {moved:.1f} of its length in the pictures"
        expected = "clips in which the animal moves by its own length or more, from which camera positions follow"
        raise InputError(Problem("KEYPOINTS", "motion", actual, expected))


def _lengths_moved(xy_px: Array) -> float:
    """Return the distance that keypoints (T, K, 2) move through the picture, in body lengths, or 0 if unknown."""
    known = np.isfinite(xy_px[..., 0])
    xy_px = xy_px[known.any(axis=1)][:, known.any(axis=0)]
    if not xy_px.size:
        return 0.0
    path, length = (np.diff(np.nanpercentile(xy_px, (5, 95), axis=axis), axis=0)[0] for axis in (0, 1))
    path_px, length_px = (float(np.median(np.linalg.norm(extent, axis=-1))) for extent in (path, length))
    return path_px / max(length_px, 1.0)


def _aligned_sources(clip: FitSettings, prepared: Sequence[ClipInputs]) -> tuple[Source, ...]:
    """Return the sources of a clip on its frames, with time offsets that are given or estimated to a whole frame."""
    sources_apart, fps = [inputs.sources[0] for inputs in prepared], prepared[0].fps
    later = np.array(clip.offset_s or np.zeros(len(prepared))) * fps
    sources = align_cameras(sources_apart, (later - later[0]).tolist())
    if not clip.find_offsets:
        return sources
    cameras = [replace(source.camera, rotation=None, translation_m=None) for source in sources]
    frames = search_offsets(_clip_problem(clip, prepared[0], sources, cameras, [np.eye(4)] * len(cameras)))
    unmatched = [camera.name for camera, unmatched in zip(cameras, np.isnan(frames), strict=True) if unmatched]
    if unmatched:
        actual = f"no time offset at which the camera sees the motion that {cameras[0].name} sees"
        expected = "clips that both cameras see well, or --set offset-s instead"
        raise InputError(Problem("--set find-offsets", f"camera {name}", actual, expected) for name in unmatched)
    return align_cameras(sources_apart, (later - later[0] + frames).tolist())


def _clip_problem(
    clip: FitSettings, first: ClipInputs, sources: Sequence[Source], cameras: Sequence[Camera], poses: Sequence[Array]
) -> ClipProblem:
    """Return a clip's least-squares problem with one view per camera, empty for cameras that did not film the clip.

    `first` holds the inputs of one of the clip's cameras.
    """
    by_name = {source.camera.name: source for source in sources}
    unseen_px = np.full_like(sources[0].keypoints.xy_px, np.nan)
    views = []
    for camera, pose in zip(cameras, poses, strict=True):
        view = View(camera, pose, unseen_px, np.zeros(unseen_px.shape[:2]))
        if source := by_name.get(camera.name):
            points = source.keypoints
            view = View(camera, pose, points.xy_px, points.confidence, offset_frames=source.offset_frames)
        views.append(view)
    # Refined poses keep the camera file's world. Otherwise nothing is known about the ground.
    ground_near_zero = None if clip.refine_cameras else False
    return ClipProblem.from_views(
        views, first.body, first.prior, first.fps, clip.trajectory_options(), ground_near_zero
    )


def _prepared_by_camera(settings: FitSettings) -> list[ClipInputs]:
    """Return each camera's keypoints, prepared like a clip of one camera."""
    names = settings.camera_name or (None,) * len(settings.keypoints)
    single = replace(settings, offset_s=None, refine_cameras=None, find_offsets=None, tilt_deg=None)
    settings_by_camera = [
        replace(single, keypoints=(path,), camera_name=None if name is None else (name,))
        for path, name in zip(settings.keypoints, names, strict=True)
    ]
    prepared = collect_problems(*(partial(prepare, camera_settings) for camera_settings in settings_by_camera))
    rates = {inputs.fps for inputs in prepared}
    if len(rates) > 1:
        expected = "one frame rate for all cameras, or --fps"
        raise InputError(Problem("KEYPOINTS", "fps", " and ".join(f"{rate:g} Hz" for rate in sorted(rates)), expected))
    camera_names = [inputs.sources[0].camera.name for inputs in prepared]
    if len(camera_names) < 2 or len(set(camera_names)) < len(camera_names):
        files = ", ".join(path.name for path in settings.keypoints)
        raise InputError(Problem(files, "cameras", ", ".join(camera_names), "two or more cameras, each once"))
    return list(prepared)


def _all_cameras(prepared: Sequence[Sequence[ClipInputs]]) -> list[Camera]:
    """Return the cameras of all clips without repeats, in the order of the clips."""
    cameras: dict[str, Camera] = {}
    for camera in (inputs.sources[0].camera for clip in prepared for inputs in clip):
        if cameras.setdefault(camera.name, camera).to_dict() != camera.to_dict():
            expected = "the same lens and pose of a camera in all clips"
            raise InputError(
                Problem("KEYPOINTS", f"camera {camera.name}", "different lenses or poses of that name", expected)
            )
    return list(cameras.values())
