"""What a clip of several cameras needs, or of one that moves: cameras that go together, in a world with z up."""

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
MOST_ZOOM = 20
"""More than lenses zoom, from the setting in which they were calibrated."""

_Cameras = tuple[tuple[Camera, "CameraTrack | None"], ...]
"""The camera of each keypoint file, with its track where it moves."""


def problems_of_several(file: str, cameras: Sequence[Camera], owners: Mapping[Path, list[str]]) -> Iterator[Problem]:
    """What cameras that film together must have. owners: of each track the cameras whose names its own contains."""
    names = [camera.name for camera in cameras]
    for name in sorted({name for name in names if names.count(name) > 1}):
        yield Problem(file, "camera", f"{name} for two keypoint files", "a camera for each, by --camera-name")
    for track, of_track in owners.items():
        if len(of_track) != 1:
            from recon.io.camera_track import track_label

            found = f"{track_label(track)}, with the name of {' and of '.join(of_track) or 'no camera'}"
            yield Problem(track, "name", found, f"the name of one of {', '.join(names)} in it")
    moving = [of_track[0] for of_track in owners.values() if len(of_track) == 1]
    for name in sorted({name for name in moving if moving.count(name) > 1}):
        yield Problem("--camera-track", name, f"{moving.count(name)} tracks of it", "one")
    for camera in (camera for camera in cameras if camera.name not in moving):
        if not camera.has_extrinsics:
            yield Problem(file, f"camera {camera.name}", "no pose", "its rotation and translation beside the others'")
        elif owners and not camera.knows_up:
            expected = "one in the world of the camera track, z up (world_z_up)"
            yield Problem(file, f"camera {camera.name}", "a pose that does not say which way is up", expected)
    still = [camera for camera in cameras if camera.has_extrinsics and camera.name not in moving]
    for one, other in combinations(still, 2):
        poses = camera_poses([one, other])
        if one.name != other.name and np.array_equal(poses[0], poses[1]):
            found = "the same pose, as of an entry that was copied"
            yield Problem(file, f"cameras {one.name} and {other.name}", found, "each camera's own pose")


def focal_problems(cameras: _Cameras) -> Iterator[Problem]:
    """Tracks of cameras that zoom, whose focal length is nowhere near the camera file's, as in another unit."""
    for camera, track in cameras:
        if track is not None and track.intrinsics_px is not None:
            found, own = float(np.median(track.intrinsics_px[:, 0])), float(camera.matrix[0, 0])
            if not own / MOST_ZOOM <= found <= own * MOST_ZOOM:
                expected = f"about the {own:.4g} px of the camera file, or {MOST_ZOOM} times more or less"
                yield Problem(track.source, "fx", f"{found:.4g} px (median)", expected)


def with_poses(
    keypoints: Keypoints, cleaning: CleaningReport, track: CameraTrack, fps: float
) -> tuple[Keypoints, CleaningReport, FramePoses]:
    """The poses of a track in the keypoints' frames, and these without detections in frames for which it has none.
    Raises InputError where there are no others."""
    poses, filled = track.at(keypoints.frames, fps)
    if not (keypoints.present & poses.known[:, None]).any():
        first, last = keypoints.frames[[0, -1]]
        found = f"{track.frames[0]} to {track.frames[-1]}, none in common with {keypoints.source or 'the keypoints'}"
        raise InputError(Problem(track.source, "frame", found, f"the numbers of the clip's frames, {first} to {last}"))
    if filled.any():
        between = f"between two of its track that are {track.max_gap_s:g} s apart or less"
        note = f"{filled.sum()} frames have a camera pose {between}"
        cleaning = replace(cleaning, notes=(*cleaning.notes, note))
    unknown = keypoints.present & ~poses.known[:, None]
    return *leave_out(keypoints, cleaning, unknown, "in frames for which the camera's track has no pose"), poses


def at_rate(keypoints: Keypoints, fps: float) -> Keypoints:
    """Keypoints of a camera with another frame rate at that of the clip, frame 0 staying where it is, along straight
    lines; those of slower ones count less in proportion. Raises InputError for fewer frames than that needs."""
    assert keypoints.fps is not None
    if keypoints.fps == fps:
        return keypoints
    times = keypoints.frames * fps / keypoints.fps
    frames = np.arange(int(np.ceil(times[0])), int(np.floor(times[-1])) + 1)
    if len(times) < 2 or not len(frames):
        expected = f"two or more that last as long as one at {fps:g} Hz"
        raise InputError(Problem(keypoints.source or "keypoints", "frames", str(len(times)), expected))
    after = np.clip(np.searchsorted(times, frames), 1, len(times) - 1)
    share = ((frames - times[after - 1]) / (times[after] - times[after - 1]))[:, None]

    def between(values: Array, share: Array) -> Array:
        before, later = values[after - 1], values[after]
        mixed = (1 - share) * before + share * later
        return np.where(share == 0, before, np.where(share == 1, later, mixed))

    xy_px = between(keypoints.xy_px, share[..., None])
    confidence = between(keypoints.confidence, share) * min(1.0, keypoints.fps / fps)
    confidence = np.where(np.isnan(xy_px[..., 0]), 0.0, confidence)
    return replace(keypoints, xy_px=xy_px, confidence=confidence, frames=frames, fps=fps)


# -- which way is up -------------------------------------------------------------------------------------------------


def turned_up(cameras: _Cameras, up: str) -> _Cameras:
    """Cameras whose calibration does not say which way is up, in a world with z up. Raises InputError."""
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
        raise InputError(Problem("--set up", "direction", repr(up), expected))
    raise_problems(
        Problem("--set up", f"camera {camera.name}", why, "poses that do not say which way is up")
        for camera, _ in cameras
        for why in (["no pose"] if not camera.has_extrinsics else ["a pose that says it"] if camera.world_z_up else [])
    )
    return tuple((with_up(camera, direction / np.linalg.norm(direction)), track) for camera, track in cameras)


def turned_up_by_feet(
    sources: Sequence[Source], apart: Sequence[Source], body: Body, fps: float, sigma_px: float
) -> tuple[tuple[Source, ...], tuple[Finding, ...]]:
    """Sources on their own frames with z up and the ground at 0, and a note on it, where the feet in those that are on
    the clip's frames say which way is up."""
    views = [
        replace(view, T_camera_world=rigid(np.asarray(view.camera.rotation), np.asarray(view.camera.translation_m)))
        for view in views_of(sources)
    ]
    from recon.check.agreement import up_from_feet

    upward = up_from_feet(views, body, fps, sigma_px)
    if upward is None:
        return tuple(apart), ()
    turned = tuple(replace(s, camera=with_up(s.camera, upward.up, upward.ground_m)) for s in apart)
    height_m = float(upward.up @ (views[0].centre_m[0] - upward.ground_m))
    up = ",".join(f"{x:.3f}" for x in upward.up)
    return turned, (finding("up_from_feet", up=up, height_m=height_m, sigma_rad=upward.sigma_rad),)


def with_up(camera: Camera, up: Array, origin_m: Array | float = 0.0) -> Camera:
    """With its pose in a world with z up, of one where the unit vector (3,) points up, and about a point (3,) of it."""
    R_camera = np.asarray(camera.rotation)
    translation_m = np.asarray(camera.translation_m) + R_camera @ np.broadcast_to(origin_m, 3)
    return replace(camera, rotation=R_camera @ level_from_camera(up).T, translation_m=translation_m, world_z_up=True)
