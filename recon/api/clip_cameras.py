"""Choose the camera for each keypoint file, with its pose or track."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from recon.api.settings import UNITS_M, FitSettings, Unit
from recon.base.documents import require_file
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.geometry.camera import Camera
from recon.io.calibration import read_camera, read_cameras

if TYPE_CHECKING:
    from recon.io.camera_track import CameraTrack


ClipCamera = tuple[Camera, "CameraTrack | None"]
"""Camera of a keypoint file, and its track if the camera moves. A camera with a track has no pose of its own."""
Cameras = tuple[ClipCamera, ...]


def read_clip_cameras(settings: FitSettings, up_option: str = "--set up") -> Cameras:
    """Return the camera of each keypoint file, and its track if it moves.

    `up_option` is the command's option for `settings.up`, which errors name.

    Raises
    ------
    InputError
        If files or settings cannot be used.
    """
    tracks: tuple[CameraTrack, ...] = ()
    if settings.camera_track:
        from recon.io.camera_track import read_camera_track

        tracks = tuple(collect_problems(*(lambda path=path: read_camera_track(path) for path in settings.camera_track)))
    choose = _cameras_of_one if len(settings.keypoints) == 1 else _cameras_of_several
    chosen = tuple(
        (_with_pose_in_metres(*camera_and_track, settings.camera_unit), camera_and_track[1])
        for camera_and_track in choose(settings, tracks)
    )
    if tracks or settings.up is not None:
        from recon.api import rigs

        raise_problems(rigs.focal_problems(chosen))
        chosen = chosen if settings.up is None else rigs.cameras_with_z_up(chosen, settings.up, up_option)
    if settings.tilt_deg is None:
        return chosen
    if any(camera.knows_up for camera, _ in chosen):
        actual = f"{settings.tilt_deg:g} together with the pose in {settings.camera_text}, which states which way is up"
        raise InputError(Problem("--tilt-deg", "tilt_deg", actual, "only one of the two"))
    tilt_rad = math.radians(settings.tilt_deg)
    return tuple((replace(camera, tilt_rad=tilt_rad), track) for camera, track in chosen)


def other_cameras(camera: Camera, settings: FitSettings) -> tuple[Camera, ...]:
    """Return the cameras of the camera file except the clip's own, or none without a camera file."""
    if settings.camera is None:
        return ()
    cameras = read_cameras(settings.camera, settings.image_size_px)
    return tuple(candidate for candidate in cameras if candidate.name != camera.name)


def possible_cameras(camera: Camera, settings: FitSettings) -> tuple[Camera, ...]:
    """Return the other cameras of the camera file that may have filmed a clip, with poses in metres.

    These cameras have a pose in a world with z up, and a picture of the size of the clip's own camera. There are none
    if `up` turns the world.
    """
    if settings.up is not None or not camera.knows_up:
        return ()
    size_px = camera.image_size_px
    return tuple(
        _with_pose_in_metres(candidate, None, settings.camera_unit)
        for candidate in other_cameras(camera, settings)
        if candidate.knows_up and candidate.image_size_px == size_px
    )


def _with_pose_in_metres(camera: Camera, track: CameraTrack | None, unit: Unit) -> Camera:
    """Return a camera with its pose in metres, or without a pose if it has a track."""
    if track is not None:
        return replace(camera, rotation=None, translation_m=None, tilt_rad=0.0)
    if camera.translation_m is None or unit == "m":
        return camera
    return replace(camera, translation_m=UNITS_M[unit] * camera.translation_m)


def _cameras_of_one(settings: FitSettings, tracks: Sequence[CameraTrack]) -> Cameras:
    """Return the camera of a clip with one keypoint file, and its track, if one is given."""
    track = tracks[0] if tracks else None
    camera_option = (
        "a camera file" if settings.camera is not None else "--hfov-deg" if settings.hfov_deg is not None else None
    )
    if track is not None and track.camera is not None:
        if camera_option is not None:
            actual = f"{camera_option} together with {track.source}, which has the lens"
            raise InputError(Problem("--camera-track", "camera", actual, "only one of the two"))
        return ((_lens_of_track(track.camera, settings, 0), track),)
    if settings.camera is not None:
        return ((_cameras_in_file(settings, ())[0], track),)
    if settings.hfov_deg is not None and settings.image_size_px is not None:
        model = settings.lens or "pinhole"
        return ((Camera.from_hfov(settings.hfov_deg, settings.image_size_px, model=model), track),)
    actual = "nothing" if track is None else f"no lens, and {track.source.name} has none either"
    raise InputError(Problem("settings", "camera", actual, "a camera file, or hfov_deg with image_size_px"))


def _lens_of_track(camera: Camera, settings: FitSettings, index: int) -> Camera:
    """Return the lens stored in a track, under the given name.

    Raises
    ------
    InputError
        If the given picture size differs from the track's.
    """
    size, given_size = camera.image_size_px, settings.image_size_px
    if given_size is not None and size != given_size:
        expected = f"{given_size[0]}x{given_size[1]}, as given"
        raise InputError(Problem("--camera-track", "image size", f"{size[0]}x{size[1]}", expected))
    return camera if settings.camera_name is None else replace(camera, name=settings.camera_name[index])


def _cameras_of_several(settings: FitSettings, tracks: Sequence[CameraTrack]) -> Cameras:
    """Return the cameras of a clip with several keypoint files.

    A track belongs to the camera whose name is in the track's file name.
    """
    from recon.api.rigs import problems_of_several

    cameras = _cameras_in_file(settings, tracks)
    names = [camera.name for camera in cameras]
    from recon.io.camera_track import track_label

    owners = {track.source: list(cameras_in(track_label(track.source), dict.fromkeys(names))) for track in tracks}
    raise_problems(problems_of_several(settings.camera_text or "--camera", cameras, owners))
    chosen = []
    for i, camera in enumerate(cameras):
        track = next((candidate for candidate in tracks if camera.name in owners[candidate.source]), None)
        lens = None if track is None else track.camera
        chosen.append((camera if lens is None else _lens_of_track(replace(lens, name=camera.name), settings, i), track))
    return tuple(chosen)


def _camera_by_name(settings: FitSettings, index: int, name: str, tracks: Sequence[CameraTrack]) -> Camera:
    """Return the camera with a given name, from a track with a lens or from the camera file."""
    for track in tracks:
        from recon.io.camera_track import track_label

        if track.camera is not None and name in cameras_in(track_label(track.source), settings.camera_name or ()):
            return _lens_of_track(track.camera, settings, index)
    if settings.camera is None:
        raise InputError(Problem("--camera", "camera", f"no lens of {name}", "a camera file with that lens"))
    return read_camera(settings.camera, name, settings.image_size_px)


def _cameras_in_file(settings: FitSettings, tracks: Sequence[CameraTrack]) -> tuple[Camera, ...]:
    """Return the cameras of the keypoint files.

    Names that were given are looked up in the tracks with a lens and in the camera file. Otherwise the camera is
    the only one in the camera file, or the one whose name the keypoint file's name contains.
    """
    if settings.camera_name is not None:
        named = enumerate(settings.camera_name)
        return tuple(
            collect_problems(*(lambda i=i, name=name: _camera_by_name(settings, i, name, tracks) for i, name in named))
        )
    path, cameras = settings.camera_text, read_cameras(settings.camera or (), settings.image_size_px)
    if len(cameras) == 1 == len(settings.keypoints):
        return cameras
    if len(cameras) < len(settings.keypoints):
        actual = f"{len(cameras)} of the {len(settings.keypoints)} cameras"
        expected = "a camera for each keypoint file: one camera file with all cameras, or --camera once for each"
        raise InputError(Problem(path, "camera", actual, expected))
    names = [camera.name for camera in cameras]
    chosen = {file: cameras_in(file.stem, names) for file in settings.keypoints}
    unclear = [file for file, matches in chosen.items() if len(matches) != 1]
    existing = [file for file in unclear if file.exists()]
    actual = f"{len(cameras)} cameras, none of them chosen"
    actual += f" for {', '.join(file.name for file in existing)}" if len(chosen) > 1 else ""
    by_option = "by --camera-name, or in the file's name"
    if len(chosen) > 1:
        by_option = "for each keypoint file: by --camera-name once for each, in their order, or in the files' names"
    problem = Problem(path, "camera", actual, f"one of {', '.join(names)} {by_option}")
    missing = (partial(require_file, file) for file in unclear if file not in existing)
    collect_problems(*missing, lambda: raise_problems([problem] * bool(existing)))
    return tuple(camera for matches in chosen.values() for camera in cameras if camera.name in matches)


def cameras_in(stem: str, names: Iterable[str]) -> dict[str, re.Match[str]]:
    """Return the camera names that a file name contains, with their matches.

    cam1 matches run_cam1DLC but not run_cam10. A matches run-A but not run-Alex. cam1 matches run_cam01 unless there is
    a camera cam01. If a file name contains camA or cam-1, the cameras A and 1 are matched only there.
    """
    # cam1 may be written cam_01 or Camera1; Pose2Sim writes int_cam01_img, DANNCE hires_cam1_params
    numbered = {
        name: re.fullmatch(r"(?:int_|hires_)?([A-Za-z]+)[-_ ]?0*([0-9]+)(?:_img|_params)?", name) for name in names
    }
    spellings = {
        name: re.escape(name)
        if parts is None
        else re.sub("(?i)^cam(era)?$", "cam(?:era)?", parts[1]) + f"[-_ ]?0*{parts[2]}"
        for name, parts in numbered.items()
    }
    for prefix in ("cam(?:era)?[-_ ]?", ""):
        ends = {name: "(?![0-9])" if name[-1:].isdigit() else "(?![0-9])(?=DLC|[^a-z]|$)" for name in spellings}
        patterns = {name: rf"(?<![0-9A-Za-z]){prefix}{spellings[name]}{ends[name]}" for name in spellings}
        matches = {name: re.search(pattern, stem, re.IGNORECASE) for name, pattern in patterns.items()}
        matched = {name: match for name, match in matches.items() if match is not None}
        as_written = {match.span(): name for name, match in matched.items() if match[0].endswith(name)}
        if matched:
            return {name: match for name, match in matched.items() if as_written.get(match.span(), name) == name}
    return {}


def other_camera_in(stem: str, name: str) -> str | None:
    """Return another camera in a file name that differs from a camera's name only in its number.

    For run_cam1DLC and the camera cam3 the result is cam1. The result is None if the name contains no such camera, or
    the camera itself.
    """
    parts = re.fullmatch(r"([A-Za-z]{3,})([-_ ]?)([0-9]+)", name)
    if parts is None:
        return None
    word, between, number = parts.groups()
    numbers = re.findall(rf"(?<![0-9A-Za-z]){word}[-_ ]?([0-9]+)", stem, re.IGNORECASE)
    return None if not numbers or int(number) in map(int, numbers) else f"{word}{between}{numbers[0]}"
