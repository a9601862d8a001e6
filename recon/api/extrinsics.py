"""Find where cameras stand: lenses and clips of the animal in, a file with all poses out."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
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
from recon.fit.extrinsics import LEVEL_RAD, search_offsets, solve_extrinsics
from recon.geometry.camera import Camera
from recon.geometry.frames import level_from_camera, rigid
from recon.io.camera_files import write_cameras

DISAGREEMENT = 16.0
"""Squared deviations, of 6 unknowns, from which on a camera that stood still is unlikely (1 in 70)."""
UNTOLD_DEG = 10.0
"""A camera whose turn is known no better is not told by its clips: it may stand anywhere (benchmarks/cameras.py)."""
LEAST_MOVED = 0.5
"""The least way of an animal, in its lengths in the picture: on its feet it swings by less."""


def clips_of(
    inputs: Sequence[str | Path], given: Mapping[str, Any], cameras_by: str = AUTO
) -> tuple[list[FitSettings], list[str]]:
    """The clips that keypoint files, folders and manifests are, as in a batch, and notes; with the names of their
    cameras beside them, files are one clip. Raises InputError."""
    if given.get("camera_name") is not None:
        return [read_settings(None, {**given, "keypoints": inputs})], []
    clips, notes = find_clips(inputs, given, None, cameras_by, posed=False)
    return [clip.settings for clip in clips], notes


def run_extrinsics(
    clips: Sequence[FitSettings],
    out: Path,
    overwrite: bool = False,
    level_rad: float = 0.0,
    progress: Progress = silent,
) -> tuple[tuple[Camera, ...], dict[str, Any]]:
    """`recon calibrate extrinsics`: write `out`, which `recon.io.calibration.read_cameras` reads; the cameras, with
    poses in a world with z up, the ground at z = 0, or that of the camera file if those are refined, and what `--json`
    prints. There the sigmas of a camera are of its place beside the first (`Camera.corrected`), its height's is null
    where the ground was not found, or is the camera file's, and offsets are as given or found.

    level_rad: how far cameras are from level, or from the tilt that is said, 0: `LEVEL_RAD`. Poses in the
    camera file are read where the clips' settings say that they are refined; these know which way is up. Raises
    InputError, with every problem, for inputs that cannot be used.
    """
    posed, tilt_deg = bool(clips[0].refine_cameras), clips[0].tilt_deg
    inputs = [path for clip in clips for path in input_files(clip).values()]
    output = output_file(out, "calibrate extrinsics", overwrite, inputs)
    twice = "a value beside --set refine-cameras=true, whose file says it", "one of the two"
    both = {"--tilt-deg": tilt_deg, "--level-deg": level_rad or None} if posed else {}
    given, *_ = collect_problems(
        lambda: collect_problems(*(lambda clip=clip: _each_alone(clip) for clip in clips)),
        lambda: raise_problems(Problem(option, "up", *twice) for option, value in both.items() if value is not None),
        lambda: require_suffix(out, (".toml",)),
        lambda: output.require((out.name,)),
    )
    cameras = _all_cameras(given)
    if posed:
        if without := [camera.name for camera in cameras if not camera.has_extrinsics]:
            expected = "a camera file with the poses of all cameras"
            raise InputError(Problem("--set refine-cameras", "poses", f"none of {', '.join(without)}", expected))
        poses = camera_poses(cameras)
    else:  # each one's own level world
        tilt = {} if tilt_deg is None else {"tilt_rad": math.radians(tilt_deg)}
        cameras = [replace(camera, rotation=None, translation_m=None, **tilt) for camera in cameras]
        poses = [rigid(level_from_camera(camera.up).T, np.zeros(3)) for camera in cameras]
    in_step = [_in_step(*of) for of in zip(clips, given, strict=True)]
    if not posed:
        _require_motion(in_step)
    firsts = [one[0] for one in given]
    settings = [_setting(*of, cameras, poses) for of in zip(clips, firsts, in_step, strict=True)]
    rig = solve_extrinsics(settings, posed, level_rad or LEVEL_RAD, progress)
    expected = "clips in which the animal goes other ways through the view"
    raise_problems(
        Problem("KEYPOINTS", f"camera {camera.name}", f"a turn known to {turn_deg:.0f} degrees only", expected)
        for camera, turn_deg in zip(cameras, np.degrees(np.linalg.norm(rig.sigma[:, :3], axis=1)), strict=True)
        if turn_deg > UNTOLD_DEG
    )
    height_m = 0.0 if posed else -np.nan_to_num(rig.ground_m)
    found = tuple(
        replace(camera, rotation=T[:3, :3], translation_m=T[:3, 3] - height_m * T[:3, 2], world_z_up=True, tilt_rad=0.0)
        for camera, T in zip(cameras, rig.T_camera_world, strict=True)
    )
    with output.staged_file() as staged:
        write_cameras(found, staged)
    names, rows = [camera.name for camera in found], []
    each = zip(clips, in_step, given, rig.time_offset_frames, rig.disagreement, strict=True)
    for clip, sources, of, late_frames, apart in each:
        late_s = dict(zip(names, np.array(late_frames) / of[0].fps, strict=True))
        began_s = np.array([source.offset_s + late_s[source.camera.name] for source in sources])
        offsets = {"offset_s": (began_s - began_s[0]).tolist(), "found_offsets": bool(clip.find_offsets)}
        disagreement = dict(zip(names, apart.tolist(), strict=True))
        rows.append({"keypoints": [*map(str, clip.keypoints)], **offsets, "disagreement": disagreement})
    known = zip(found, rig.sigma, rig.height_sigma_m, strict=True)
    return found, {
        "cameras": [
            camera.to_dict()
            | {"turn_sigma_rad": sigma[:3].tolist(), "shift_sigma_m": sigma[3:].tolist()}
            | {"height_sigma_m": None if posed or math.isnan(high) else float(high)}
            for camera, sigma, high in known
        ],
        "clips": rows,
        "converged": rig.converged,
        "written": str(out),
    }


def _require_motion(clips: Sequence[Sequence[Source]]) -> None:
    """Raises InputError for an animal that stays where it is in all pictures of all clips: where cameras stand beside
    each other is told by where it goes."""
    moved = max(_lengths_moved(source.keypoints.xy_px) for sources in clips for source in sources)
    if moved < LEAST_MOVED:
        found = f"an animal that moves by {moved:.1f} of its length in the pictures"
        expected = "clips in which it moves by its own length or more: one that stays cannot tell where cameras stand"
        raise InputError(Problem("KEYPOINTS", "motion", found, expected))


def _lengths_moved(xy_px: Array) -> float:
    """How far the keypoints (T, K, 2) go through the picture, of the animal's extent in it; 0 where nothing tells."""

    known = np.isfinite(xy_px[..., 0])
    xy_px = xy_px[known.any(axis=1)][:, known.any(axis=0)]
    if not xy_px.size:
        return 0.0
    path, length = (np.diff(np.nanpercentile(xy_px, (5, 95), axis=axis), axis=0)[0] for axis in (0, 1))
    path_px, length_px = (float(np.median(np.linalg.norm(extent, axis=-1))) for extent in (path, length))
    return path_px / max(length_px, 1.0)


def _in_step(clip: FitSettings, given: Sequence[ClipInputs]) -> tuple[Source, ...]:
    """The sources of a clip on its frames, by the offsets that are given, or found to whole frames beside those."""
    apart, fps = [one.sources[0] for one in given], given[0].fps
    later = np.array(clip.offset_s or np.zeros(len(given))) * fps
    sources = align_cameras(apart, (later - later[0]).tolist())
    if not clip.find_offsets:
        return sources
    cameras = [replace(source.camera, rotation=None, translation_m=None) for source in sources]
    frames = search_offsets(_setting(clip, given[0], sources, cameras, [np.eye(4)] * len(cameras)))
    lost = [camera.name for camera, lost in zip(cameras, np.isnan(frames), strict=True) if lost]
    if lost:
        found = f"no offset at which it sees the motion that {cameras[0].name} sees"
        expected = "clips that both see well, or --set offset-s in place of it"
        raise InputError(Problem("--set find-offsets", f"camera {name}", found, expected) for name in lost)
    return align_cameras(apart, (later - later[0] + frames).tolist())


def _setting(
    clip: FitSettings, first: ClipInputs, sources: Sequence[Source], cameras: Sequence[Camera], poses: Sequence[Array]
) -> ClipProblem:
    """A clip with a view of every camera; one that did not film it has seen nothing. first: as one of them prepared
    it."""
    by_name = {source.camera.name: source for source in sources}
    nothing = np.full_like(sources[0].keypoints.xy_px, np.nan)
    views = []
    for camera, pose in zip(cameras, poses, strict=True):
        view = View(camera, pose, nothing, np.zeros(nothing.shape[:2]))
        if source := by_name.get(camera.name):
            points = source.keypoints
            view = View(camera, pose, points.xy_px, points.confidence, offset_frames=source.offset_frames)
        views.append(view)
    knows_up = bool(clip.refine_cameras) and None  # where the ground is, the camera file says
    return ClipProblem.from_views(views, first.body, first.prior, first.fps, clip.trajectory_options(), knows_up)


def _each_alone(settings: FitSettings) -> list[ClipInputs]:
    """Each camera's keypoints, prepared as a clip of one camera."""
    names = settings.camera_name or (None,) * len(settings.keypoints)
    alone = replace(settings, offset_s=None, refine_cameras=None, find_offsets=None, tilt_deg=None)
    each = [
        replace(alone, keypoints=(path,), camera_name=None if name is None else (name,))
        for path, name in zip(settings.keypoints, names, strict=True)
    ]
    given = collect_problems(*(lambda one=one: prepare(one) for one in each))
    rates = {one.fps for one in given}
    if len(rates) > 1:
        expected = "one frame rate for all cameras, or --fps"
        raise InputError(Problem("KEYPOINTS", "fps", ", ".join(f"{rate:g}" for rate in sorted(rates)), expected))
    found = [one.sources[0].camera.name for one in given]
    if len(found) < 2 or len(set(found)) < len(found):
        where = ", ".join(path.name for path in settings.keypoints)
        raise InputError(Problem(where, "cameras", ", ".join(found), "two or more, each once"))
    return list(given)


def _all_cameras(given: Sequence[Sequence[ClipInputs]]) -> list[Camera]:
    """The cameras of all clips, each once, those of the first clip first."""
    cameras: dict[str, Camera] = {}
    for one in (prepared.sources[0].camera for clip in given for prepared in clip):
        if cameras.setdefault(one.name, one).to_dict() != one.to_dict():
            expected = "the same in all clips"
            raise InputError(Problem("KEYPOINTS", f"camera {one.name}", "two lenses or poses of that name", expected))
    return list(cameras.values())
