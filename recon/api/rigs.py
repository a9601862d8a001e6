"""Prepare clips of several cameras or a moving one: check the cameras, match their rates, and turn z upwards."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from recon.animal.body import Body
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, raise_problems
from recon.check.codes import finding
from recon.clip import CleaningReport, FramePoses, Keypoints, Source, camera_poses, leave_out, views_of
from recon.fit.result import Finding
from recon.geometry.camera import Camera
from recon.geometry.frames import level_from_camera, rigid
from recon.io.common import numbers

if TYPE_CHECKING:
    from recon.io.camera_track import CameraTrack

AXES, FIRST_CAMERA = ("x", "y", "z"), "first-camera"
MAX_ZOOM = 20
"""Maximum factor on the calibrated focal length that a zoom lens can have."""

_Cameras = tuple[tuple[Camera, "CameraTrack | None"], ...]
"""Camera of each keypoint file, with its track if it moves."""


def problems_of_several(file: str, cameras: Sequence[Camera], owners: Mapping[Path, list[str]]) -> Iterator[Problem]:
    """Yield problems with cameras that cannot be used together.

    `owners` gives for each track the cameras whose names the track's name contains.
    """
    names = [camera.name for camera in cameras]
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield Problem(
            file, "camera", f"{name} for two keypoint files", "a different camera for each file, by --camera-name"
        )
    for track, matches in owners.items():
        if len(matches) != 1:
            from recon.io.camera_track import track_label

            contained = " and ".join(matches) or "no camera's name"
            actual = f"{track_label(track)}, which contains {contained}"
            yield Problem(track, "name", actual, f"a file name that contains one of {', '.join(names)}")
    moving = [matches[0] for matches in owners.values() if len(matches) == 1]
    for name in sorted({name for name in moving if moving.count(name) > 1}):
        yield Problem("--camera-track", name, f"{moving.count(name)} tracks of this camera", "one track")
    for camera in (camera for camera in cameras if camera.name not in moving):
        if not camera.has_extrinsics:
            yield Problem(
                file, f"camera {camera.name}", "no pose", "a rotation and a translation, as the other cameras have"
            )
        elif owners and not camera.knows_up:
            expected = "a pose in the world of the camera track, with z up (world_z_up)"
            yield Problem(file, f"camera {camera.name}", "a pose that does not say which way is up", expected)
    fixed = [camera for camera in cameras if camera.has_extrinsics and camera.name not in moving]
    for first, second in combinations(fixed, 2):
        poses = camera_poses([first, second])
        if first.name != second.name and np.array_equal(poses[0], poses[1]):
            actual = "the same pose, as if an entry had been copied"
            yield Problem(file, f"cameras {first.name} and {second.name}", actual, "each camera's own pose")


def focal_problems(cameras: _Cameras) -> Iterator[Problem]:
    """Yield problems with zoom tracks whose focal length is far from the camera file's, for example in another unit."""
    for camera, track in cameras:
        if track is not None and track.intrinsics_px is not None:
            track_px, camera_px = float(np.median(track.intrinsics_px[:, 0])), float(camera.matrix[0, 0])
            if not camera_px / MAX_ZOOM <= track_px <= camera_px * MAX_ZOOM:
                expected = f"a focal length within a factor of {MAX_ZOOM} of the camera file's {camera_px:.4g} px"
                yield Problem(track.source, "fx", f"{track_px:.4g} px (median)", expected)


def with_poses(
    keypoints: Keypoints, cleaning: CleaningReport, track: CameraTrack, fps: float
) -> tuple[Keypoints, CleaningReport, FramePoses]:
    """Return keypoints and poses for the same frames.

    Detections are left out in frames for which the track has no pose.

    Raises
    ------
    InputError
        If the track has no pose for any frame.
    """
    poses, filled = track.at(keypoints.frames, fps)
    if not (keypoints.present & poses.known[:, None]).any():
        first, last = keypoints.frames[[0, -1]]
        actual = (
            f"frames {track.frames[0]} to {track.frames[-1]}, none of them in {keypoints.source or 'the keypoints'}"
        )
        raise InputError(Problem(track.source, "frame", actual, f"the numbers of the clip's frames, {first} to {last}"))
    if filled.any():
        between = f"between two of the track's frames that are {track.max_gap_s:g} s apart or less"
        note = f"{filled.sum()} frames have a camera pose that is interpolated {between}"
        cleaning = replace(cleaning, notes=(*cleaning.notes, note))
    unknown = keypoints.present & ~poses.known[:, None]
    return *leave_out(keypoints, cleaning, unknown, "in frames for which the camera's track has no pose"), poses


def at_rate(keypoints: Keypoints, fps: float) -> Keypoints:
    """Return keypoints resampled to the frame rate of the clip.

    The interpolation is linear, and frame 0 stays at the same time. The confidence of a slower camera is reduced in
    proportion to its frame rate.

    Raises
    ------
    InputError
        If there are too few frames to interpolate.
    """
    assert keypoints.fps is not None
    if keypoints.fps == fps:
        return keypoints
    times = keypoints.frames * fps / keypoints.fps
    frames = np.arange(int(np.ceil(times[0])), int(np.floor(times[-1])) + 1)
    if len(times) < 2 or not len(frames):
        expected = f"two or more frames that together last at least one frame at {fps:g} Hz"
        raise InputError(Problem(keypoints.source or "keypoints", "frames", str(len(times)), expected))
    next_rows = np.clip(np.searchsorted(times, frames), 1, len(times) - 1)
    share = ((frames - times[next_rows - 1]) / (times[next_rows] - times[next_rows - 1]))[:, None]

    def interpolated(values: Array, share: Array) -> Array:
        earlier, later = values[next_rows - 1], values[next_rows]
        mixed = (1 - share) * earlier + share * later
        return np.where(share == 0, earlier, np.where(share == 1, later, mixed))

    xy_px = interpolated(keypoints.xy_px, share[..., None])
    confidence = interpolated(keypoints.confidence, share) * min(1.0, keypoints.fps / fps)
    confidence = np.where(np.isnan(xy_px[..., 0]), 0.0, confidence)
    return replace(keypoints, xy_px=xy_px, confidence=confidence, frames=frames, fps=fps)


def cameras_with_z_up(cameras: _Cameras, up: str, option: str) -> _Cameras:
    """Return cameras turned into a world with z up, given the upward direction in their present world.

    `option` is the command's option for the upward direction, which errors name.
    """
    if up == FIRST_CAMERA:
        return cameras
    sign, axis = (-1.0, up[1:]) if up[:1] == "-" and up[1:] in AXES else (1.0, up)
    if axis in AXES:
        direction = sign * np.eye(3)[AXES.index(axis)]
    else:
        cells = [cell.strip() for cell in up.split(",")]
        values, wrong = numbers(cells)
        direction = values if len(cells) == 3 and not wrong and np.isfinite(values).all() else np.zeros(3)
    if not np.linalg.norm(direction) > 0:
        expected = f"x, y or z, -x, -y or -z, {FIRST_CAMERA}, or 0,-1,0"
        raise InputError(Problem(option, "direction", repr(up), expected))
    without_pose = ", ".join(camera.name for camera, _ in cameras if not camera.has_extrinsics)
    with_z_up = ", ".join(camera.name for camera, _ in cameras if camera.has_extrinsics and camera.world_z_up)
    problems = [
        *([("no pose", without_pose, "cameras with poses")] if without_pose else []),
        *(
            [("a file that states z up", with_z_up, f"no {option}, or a file without this statement")]
            if with_z_up
            else []
        ),
    ]
    raise_problems(
        Problem(option, "up", f"{up}, but {fault} for {names}", expected) for fault, names, expected in problems
    )
    return tuple((with_up(camera, direction / np.linalg.norm(direction)), track) for camera, track in cameras)


def sources_with_z_up(
    sources: Sequence[Source], sources_apart: Sequence[Source], body: Body, fps: float, sigma_px: float
) -> tuple[tuple[Source, ...], tuple[Finding, ...]]:
    """Turn cameras so that z is up and the ground is at z = 0, as estimated from feet in stance.

    `sources` are on the frames of the clip, `sources_apart` on each camera's own frames.

    Returns
    -------
    sources : tuple of Source
        `sources_apart` with turned cameras, or unchanged if the feet do not show the ground.
    findings : tuple of Finding
        A finding that names the upward direction, or none if the cameras were not turned.
    """
    views = [
        replace(view, T_camera_world=rigid(np.asarray(view.camera.rotation), np.asarray(view.camera.translation_m)))
        for view in views_of(sources)
    ]
    from recon.check.upward import up_from_feet

    upward = up_from_feet(views, body, fps, sigma_px)
    if upward is None:
        return tuple(sources_apart), ()
    turned = tuple(replace(s, camera=with_up(s.camera, upward.up, upward.ground_m)) for s in sources_apart)
    height_m = float(upward.up @ (views[0].centre_m[0] - upward.ground_m))
    up = ",".join(f"{x:.3f}" for x in upward.up)
    return turned, (finding("up_from_feet", up=up, height_m=height_m, sigma_rad=upward.sigma_rad),)


def with_up(camera: Camera, up: Array, origin_m: Array | float = 0.0) -> Camera:
    """Return a camera with its pose in a world with z up.

    `up` is the unit vector (3,) that points up in the present world. `origin_m` is the point (3,) of the present world
    that becomes the origin.
    """
    R_camera = np.asarray(camera.rotation)
    translation_m = np.asarray(camera.translation_m) + R_camera @ np.broadcast_to(origin_m, 3)
    return replace(camera, rotation=R_camera @ level_from_camera(up).T, translation_m=translation_m, world_z_up=True)
