"""Estimate the rotation of a camera: read its video, and write a camera track, a report and a panorama."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from recon.api.camera_settings import CameraMotionSettings
from recon.api.settings import FitSettings
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.files import write_bytes
from recon.base.numbers import counted, percent, quantity
from recon.base.outputs import Output, require_suffix
from recon.base.progress import Progress, silent
from recon.calibrate.camera_motion.level import LevelMark, as_level, read_marks, up_at_tilt, up_by_marks
from recon.calibrate.camera_motion.panorama import panorama, thumbnail
from recon.calibrate.camera_motion.track import CLEAR_SIGMAS, Tracker, TurningMotion
from recon.clip import Keypoints
from recon.geometry.camera import Camera
from recon.io.calibration import read_camera
from recon.io.camera_track import INTRINSICS, POSE, SIGMA
from recon.io.formats import read_keypoints
from recon.io.video import Image, missing_frames, missing_note, probe, size_problems, timed_frames
from recon.io.writing import write_table
from recon.show.plain import picked, to_json

MIN_LIKELIHOOD = 0.3
"""Likelihood above which a keypoint marks the animal, whose surroundings are not used as background."""
MAX_LOST = 0.5
"""Largest accepted fraction of frames whose background is too small to follow."""
MAX_FOCAL_OFF = 0.1
"""Largest accepted relative error of the focal length, which causes the same relative error of the rotations."""
NOTES = (
    "the camera is assumed to turn about its centre: it is at the world's origin in every frame",
    "a rolling shutter is not modelled: in a fast turn, the rows of a picture were exposed at different times",
    "standard deviations are for each axis, relative to the first frame, and assume the lens of the camera file",
)


def settings_for_clip(settings: FitSettings, video: Path, out: Path, **fields: Any) -> CameraMotionSettings:
    """Return the settings of `recon camera-motion` for a clip of one calibrated camera, with further fields."""
    assert settings.camera is not None
    clip_fields = {"camera": settings.camera[0], "keypoints": settings.keypoints[0]}
    fields |= clip_fields | {"camera_name": next(iter(settings.camera_name or ()), None)}
    return CameraMotionSettings(video=video, out=out, **picked(settings, "individual", "tilt_deg"), **fields)


def motion_files(track: Path) -> tuple[str, str, str]:
    """Return the names of the track, and of its report and panorama in the same folder."""
    return track.name, f"{track.stem}_report.json", f"{track.stem}_panorama.png"


def run_camera_motion(settings: CameraMotionSettings, output: Output, progress: Progress = silent) -> dict[str, Any]:
    """Estimate the rotation of a camera, write the files of `motion_files` to an output, and return the report.

    Raises
    ------
    InputError
        If inputs cannot be used, or if the background does not show how the camera turned.
    """
    files = motion_files(settings.out)
    info, lens, animal, marks, *_ = collect_problems(
        lambda: probe(settings.video),
        lambda: read_camera(settings.camera, settings.camera_name),
        lambda: None if settings.keypoints is None else read_keypoints(settings.keypoints, settings.individual),
        lambda: () if settings.level_marks is None else read_marks(settings.level_marks),
        lambda: require_suffix(settings.out, (".csv",)),
        lambda: output.require(files),
    )
    raise_problems(size_problems(settings.video, info, lens))
    points = {} if animal is None else _points(animal, settings.first_frame)
    stamps_s: list[float] = []
    pictures: list[Image] = []
    tracker = Tracker(lens, settings.zoom, points.get)
    for number, stamp_s, picture in timed_frames(settings.video):
        stamps_s.append(stamp_s)
        tracker.add(number, picture)
        if len(tracker.keys) > len(pictures):
            pictures.append(thumbnail(picture))
        if tracker.cut is not None:
            break
        progress("following the background", min(1.0, number / (info.stated_frames or number + 1)))
    times_s = np.array(stamps_s)
    motion = tracker.finish()
    _require_turning(settings, motion, lens)
    if animal is not None:
        _require_same_frames(settings, points, times_s)
    up, level = _up(settings, motion, lens, marks)
    motion = replace(motion, orientations=as_level(motion.orientations, up))
    report = _report(settings, motion, lens, level, times_s)
    drawn = panorama(lens, motion, pictures, points)
    with output.staged(adds=True) as folder:
        track_file, report_file, picture_file = (folder / name for name in files)
        _write_track(track_file, settings, motion, lens)
        report_file.write_text(to_json(report), encoding="utf-8")
        write_bytes(picture_file, cv2.imencode(".png", drawn)[1].tobytes())
    return report


def _focal_note(motion: TurningMotion, lens: Camera) -> str | None:
    """Return a note if the rotation of the background suggests a focal length other than the camera file's."""
    if motion.focal is None or abs(motion.focal[0]) <= CLEAR_SIGMAS * motion.focal[1]:
        return None
    px = _focal_px(motion.focal, lens)
    wide = 2 * np.degrees(np.arctan(lens.image_size_px[0] / 2 / px["found"]))
    measured, stated = quantity(px["found"], 0, "px"), quantity(px["file"], 0, "px")
    return (
        f"the background moves as if the focal length were {measured} (standard deviation {px['sigma']:.1f}; "
        f"{wide:.1f} degrees across the picture, without distortion), but the camera file has {stated}"
    )


def _require_turning(s: CameraMotionSettings, motion: TurningMotion, lens: Camera) -> None:
    """Raise InputError if the video has a cut or too little background, or if the camera did more than rotate."""
    if motion.cut is not None:
        actual = f"a cut, or a jump of the whole view, at frame {motion.cut + s.first_frame}"
        raise InputError(Problem(s.video, "video", actual, "one take: cut the video there"))
    note = _focal_note(motion, lens)
    if not motion.turned_only:
        grows, zoom = ("", "") if s.zoom else (", or it grows", " (--zoom if its focal length changes)")
        actual = f"a background that no turn explains: its parts move relative to each other{grows}"
        actual += f"; {note}" if note else ""
        expected = f"a calibrated camera that turns about a fixed point{zoom}; for a camera that is carried or driven, "
        expected += "make a track with COLMAP, and give the track to --camera-track"
        raise InputError(Problem(s.video, "motion", actual, expected))
    if motion.focal is not None and abs(motion.focal[0]) > MAX_FOCAL_OFF and note:
        expected = "the lens with which the video was filmed, calibrated at the same zoom and focus"
        raise InputError(Problem(s.camera, "focal length", note, expected))
    number = len(motion.frames) + len(motion.lost)
    if not len(motion.frames) or len(motion.lost) > MAX_LOST * number:
        actual = f"too little background to follow in {len(motion.lost)} of {number} frames, because it is blurred, "
        actual += "hidden or without structure"
        expected = f"at most {percent(MAX_LOST)} such frames: leave the worst part of the video out"
        raise InputError(Problem(s.video, "background", actual, expected))


def _require_same_frames(s: CameraMotionSettings, points: dict[int, Array], times_s: Array) -> None:
    """Raise InputError if keypoints have frames that the video does not have."""
    outside = [number for number in points if not 0 <= number < len(times_s)]
    if outside:
        actual = f"{len(outside)} of {len(points)} frames outside {s.video}, which has {len(times_s)} frames"
        if note := missing_note(s.video, times_s, s.first_frame):
            actual += f"; {note}"
        raise InputError(
            Problem(s.keypoints or "--keypoints", "frames", actual, "the video's frames, or --first-frame")
        )


def _points(keypoints: Keypoints, first_frame: int) -> dict[int, Array]:
    """Return the keypoints (K, 2) of each frame that has any, px, keyed by the video's frame number.

    Unlikely keypoints are NaN.
    """
    pixels = np.where((keypoints.confidence < MIN_LIKELIHOOD)[..., None], np.nan, keypoints.xy_px)
    shown = np.asarray(np.isfinite(pixels).all(axis=2)).any(axis=1)
    return dict(zip((keypoints.frames[shown] - first_frame).tolist(), pixels[shown], strict=True))


def _up(
    s: CameraMotionSettings, motion: TurningMotion, lens: Camera, marks: Sequence[LevelMark]
) -> tuple[Array | None, str]:
    """Return the upward direction (3,) in the first frame's camera, and its source as text.

    The direction is None if the mean frame counts as level.
    """
    if s.tilt_deg is not None:
        level = f"the first frame looks {s.tilt_deg:g} degrees down, as given, and its roll is taken as 0"
        return up_at_tilt(np.radians(s.tilt_deg)), level
    if s.level_marks is None:
        return None, "the mean of all frames is taken as level: its tilt and roll are 0"
    by_frame = dict(zip((motion.frames + s.first_frame).tolist(), motion.orientations, strict=True))
    up, sigma = up_by_marks(s.level_marks, marks, lens, by_frame)
    precision = f"known to {np.degrees(sigma):.1g} degrees if the marks are 2 px off"
    return up, f"from {counted(len(marks), 'mark')} in {s.level_marks}, {precision}"


def _write_track(path: Path, s: CameraMotionSettings, motion: TurningMotion, camera: Camera) -> None:
    turns = Rotation.from_matrix(np.stack([orientation.rotation for orientation in motion.orientations]))
    q = turns.as_quat(canonical=True, scalar_first=True)
    poses = np.round(np.concatenate([q, np.zeros((len(q), 3))], axis=1), 9)
    if s.zoom:
        camera_matrix = camera.matrix
        zooms = np.array([orientation.zoom for orientation in motion.orientations])[:, None]
        lens = [zooms * [camera_matrix[0, 0], camera_matrix[1, 1]], np.tile(camera_matrix[:2, 2], (len(q), 1))]
        poses = np.concatenate([poses, np.round(np.concatenate(lens, axis=1), 4)], axis=1)
    poses = np.concatenate([poses, np.round(np.degrees(motion.sigma_rad)[:, None], 5)], axis=1)
    write_table(path, [["frame", *POSE, *(INTRINSICS if s.zoom else ()), SIGMA]], motion.frames + s.first_frame, poses)


def _report(s: CameraMotionSettings, motion: TurningMotion, lens: Camera, level: str, times_s: Array) -> dict[str, Any]:
    axes = np.stack([orientation.rotation[2] for orientation in motion.orientations])
    pan = np.degrees(np.unwrap(np.arctan2(axes[:, 0], axes[:, 1])))
    tilt = np.degrees(-np.arcsin(np.clip(axes[:, 2], -1, 1)))
    down = np.stack([orientation.rotation[:, 2] for orientation in motion.orientations])
    roll = np.degrees(np.arctan2(down[:, 0], -down[:, 1]))
    rounded = {"pan_deg": pan, "tilt_deg": tilt, "roll_deg": roll, "sigma_deg": np.degrees(motion.sigma_rad)}
    if s.zoom:
        rounded |= {
            "zoom": np.array([orientation.zoom for orientation in motion.orientations]),
            "sigma_zoom": motion.sigma_zoom,
        }
    rounded["residual_px"] = motion.residual_px
    video_notes = filter(None, [missing_note(s.video, times_s, s.first_frame), _focal_note(motion, lens)])
    return {
        "video": s.video.name,
        "camera": {"file": s.camera.name, "name": lens.name},
        "level": level,
        "notes": [*NOTES, *(["the first frame has the camera file's focal length"] if s.zoom else []), *video_notes],
        "focal_px": None if motion.focal is None else _focal_px(motion.focal, lens),
        "frames": len(motion.frames) + len(motion.lost),
        "frames_missing": sum((missing_frames(times_s) or {}).values()),
        "frames_without_background": (motion.lost + s.first_frame).tolist(),
        "keyframes": (motion.frames[motion.keys] + s.first_frame).tolist(),
        "residual_px": float(np.median(motion.residual_px)),
        "inliers": float(np.median(motion.inliers)),
        "sigma_deg": float(np.degrees(np.median(motion.sigma_rad))),
        "by_frame": {
            "frame": (motion.frames + s.first_frame).tolist(),
            **{name: np.round(values, 5).tolist() for name, values in rounded.items()},
            "inliers": motion.inliers.tolist(),
        },
    }


def _focal_px(focal: tuple[float, float], lens: Camera) -> dict[str, float]:
    """Return focal lengths in pixels: "file", in the camera file, and "found", estimated from the background.

    "sigma" is the standard deviation of the estimate in pixels. `focal` holds the logarithm of the estimate divided by
    the value in the file, and the standard deviation of this logarithm.
    """
    file_px = float(lens.matrix[0, 0])
    background_px = file_px * float(np.exp(focal[0]))
    return {"file": file_px, "found": background_px, "sigma": background_px * focal[1]}
