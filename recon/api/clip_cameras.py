"""Choose the camera of each keypoint file, and say where it was."""

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
"""The camera of a keypoint file, with a track its lens only: it has no pose; and the track of a camera that moves."""
Cameras = tuple[ClipCamera, ...]


def read_clip_cameras(settings: FitSettings) -> Cameras:
    """The camera of each keypoint file. Raises InputError."""
    tracks: tuple[CameraTrack, ...] = ()
    if settings.camera_track:
        from recon.io.camera_track import read_camera_track

        tracks = tuple(collect_problems(*(lambda path=path: read_camera_track(path) for path in settings.camera_track)))
    choose = _cameras_of_one if len(settings.keypoints) == 1 else _cameras_of_several
    chosen = tuple((_as_it_stands(*one, settings.camera_unit), one[1]) for one in choose(settings, tracks))
    if tracks or settings.up is not None:
        from recon.api import rigs

        raise_problems(rigs.focal_problems(chosen))
        chosen = chosen if settings.up is None else rigs.turned_up(chosen, settings.up)
    if settings.tilt_deg is None:
        return chosen
    if any(camera.knows_up for camera, _ in chosen):
        found = f"{settings.tilt_deg:g} beside the pose in {settings.camera_text}, which says which way is up"
        raise InputError(Problem("--tilt-deg", "tilt_deg", found, "one of the two"))
    tilt_rad = math.radians(settings.tilt_deg)
    return tuple((replace(camera, tilt_rad=tilt_rad), track) for camera, track in chosen)


def other_cameras(camera: Camera, settings: FitSettings) -> tuple[Camera, ...]:
    """The cameras of the camera file that the clip is not said to be of, none where there is no such file."""
    if settings.camera is None:
        return ()
    cameras = read_cameras(settings.camera, settings.image_size_px)
    return tuple(other for other in cameras if other.name != camera.name)


def _as_it_stands(camera: Camera, track: CameraTrack | None, unit: Unit) -> Camera:
    """Where the camera file says in that unit where it is; with a track, only that says it."""
    if track is not None:
        return replace(camera, rotation=None, translation_m=None, tilt_rad=0.0)
    if camera.translation_m is None or unit == "m":
        return camera
    return replace(camera, translation_m=UNITS_M[unit] * camera.translation_m)


def _cameras_of_one(settings: FitSettings, tracks: Sequence[CameraTrack]) -> Cameras:
    """A clip with one keypoint file, whose camera any track is."""
    track = tracks[0] if tracks else None
    given = "a camera file" if settings.camera is not None else "--hfov-deg" if settings.hfov_deg is not None else None
    if track is not None and track.camera is not None:
        if given is not None:
            found = f"{given} beside {track.source}, which has the lens"
            raise InputError(Problem("--camera-track", "camera", found, "one of the two"))
        return ((_own_lens(track.camera, settings, 0), track),)
    if settings.camera is not None:
        return ((_cameras_in_file(settings, ())[0], track),)
    if settings.hfov_deg is not None and settings.image_size_px is not None:
        return ((Camera.from_hfov(settings.hfov_deg, settings.image_size_px), track),)
    found = "nothing" if track is None else f"nothing, and {track.source.name} comes without a lens"
    raise InputError(Problem("settings", "camera", found, "a camera file, or hfov_deg with image_size_px"))


def _own_lens(camera: Camera, settings: FitSettings, place: int) -> Camera:
    """The lens of a track, named as given. Raises InputError for another size of the picture than is given."""
    size, given = camera.image_size_px, settings.image_size_px
    if given is not None and size != given:
        expected = f"{given[0]}x{given[1]}, as was given"
        raise InputError(Problem("--camera-track", "image size", f"{size[0]}x{size[1]}", expected))
    return camera if settings.camera_name is None else replace(camera, name=settings.camera_name[place])


def _cameras_of_several(settings: FitSettings, tracks: Sequence[CameraTrack]) -> Cameras:
    """A track is that of the camera whose name its own contains."""
    from recon.api.rigs import problems_of_several

    cameras = _cameras_in_file(settings, tracks)
    names = [camera.name for camera in cameras]
    from recon.io.camera_track import track_label

    owners = {track.source: list(cameras_in(track_label(track.source), dict.fromkeys(names))) for track in tracks}
    raise_problems(problems_of_several(settings.camera_text or "--camera", cameras, owners))
    chosen = []
    for i, camera in enumerate(cameras):
        track = next((one for one in tracks if camera.name in owners[one.source]), None)
        own = None if track is None else track.camera
        chosen.append((camera if own is None else _own_lens(replace(own, name=camera.name), settings, i), track))
    return tuple(chosen)


def _camera_by_name(settings: FitSettings, place: int, name: str, tracks: Sequence[CameraTrack]) -> Camera:
    """The camera of a track with a lens, or from the camera file."""
    for track in tracks:
        from recon.io.camera_track import track_label

        if track.camera is not None and name in cameras_in(track_label(track.source), settings.camera_name or ()):
            return _own_lens(track.camera, settings, place)
    if settings.camera is None:
        raise InputError(Problem("--camera", "camera", f"no lens of {name}", "a camera file with it"))
    return read_camera(settings.camera, name, settings.image_size_px)


def _cameras_in_file(settings: FitSettings, tracks: Sequence[CameraTrack]) -> tuple[Camera, ...]:
    """By name as given, in a track with a lens or in the camera file; else the only one there, or the one whose name
    the keypoint file's name contains."""
    if settings.camera_name is not None:
        named = enumerate(settings.camera_name)
        return tuple(
            collect_problems(*(lambda i=i, name=name: _camera_by_name(settings, i, name, tracks) for i, name in named))
        )
    path, cameras = settings.camera_text, read_cameras(settings.camera or (), settings.image_size_px)
    if len(cameras) == 1 == len(settings.keypoints):
        return cameras
    if len(cameras) < len(settings.keypoints):
        found = f"{len(cameras)} of the {len(settings.keypoints)} cameras"
        expected = "one for each keypoint file: a file that has all of them, or --camera once for each"
        raise InputError(Problem(path, "camera", found, expected))
    names = [camera.name for camera in cameras]
    chosen = {file: cameras_in(file.stem, names) for file in settings.keypoints}
    unclear = [file for file, of in chosen.items() if len(of) != 1]
    there = [file for file in unclear if file.exists()]
    found = f"{len(cameras)} cameras and no choice"
    found += f" for {', '.join(file.name for file in there)}" if len(chosen) > 1 else ""
    problem = Problem(path, "camera", found, f"one of {', '.join(names)} by --camera-name, or in the file's name")
    missing = (partial(require_file, file) for file in unclear if file not in there)
    collect_problems(*missing, lambda: raise_problems([problem] * bool(there)))
    return tuple(camera for of in chosen.values() for camera in cameras if camera.name in of)


def cameras_in(stem: str, names: Iterable[str]) -> dict[str, re.Match[str]]:
    """Which cameras' names a file's name has, and where: cam1 is in run_cam1DLC, not in run_cam10; A is in run-A, not
    in run-Alex; cam1 is in run_cam01, unless there is a cam01. If a file's name has camA or cam-1, the cameras A and 1
    are looked for nowhere else in it."""
    # cam1 is also cam_01 and Camera1, what Pose2Sim calls int_cam01_img, and DANNCE hires_cam1_params
    called = {
        name: re.fullmatch(r"(?:int_|hires_)?([A-Za-z]+)[-_ ]?0*([0-9]+)(?:_img|_params)?", name) for name in names
    }
    spelt = {
        name: re.escape(name) if of is None else re.sub("(?i)^cam(era)?$", "cam(?:era)?", of[1]) + f"[-_ ]?0*{of[2]}"
        for name, of in called.items()
    }
    for before in ("cam(?:era)?[-_ ]?", ""):
        ends = {name: "(?![0-9])" if name[-1:].isdigit() else "(?![0-9])(?=DLC|[^a-z]|$)" for name in spelt}
        patterns = {name: rf"(?<![0-9A-Za-z]){before}{spelt[name]}{ends[name]}" for name in spelt}
        matches = {name: re.search(pattern, stem, re.IGNORECASE) for name, pattern in patterns.items()}
        found = {name: match for name, match in matches.items() if match is not None}
        as_written = {match.span(): name for name, match in found.items() if match[0].endswith(name)}
        if found:
            return {name: match for name, match in found.items() if as_written.get(match.span(), name) == name}
    return {}


def other_camera_in(stem: str, name: str) -> str | None:
    """The camera that a file's name says, if it is called as this one but for its number: cam1 in run_cam1DLC, where
    the camera is cam3. None where it says none, or this one."""
    called = re.fullmatch(r"([A-Za-z]{3,})([-_ ]?)([0-9]+)", name)
    if called is None:
        return None
    word, between, number = called.groups()
    found = re.findall(rf"(?<![0-9A-Za-z]){word}[-_ ]?([0-9]+)", stem, re.IGNORECASE)
    return None if not found or int(number) in map(int, found) else f"{word}{between}{found[0]}"
