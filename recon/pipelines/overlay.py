"""A result drawn on its video."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from recon.body import Side
from recon.camera import Camera, FloatArray
from recon.errors import InputError, Problem, all_of
from recon.files import require_free_file
from recon.frames import level_axes
from recon.io import read_keypoints
from recon.keypoints import Keypoints
from recon.overlay import LEFT, MIDDLE, RIGHT, Colour, Overlay, canvas_size, draw_frame
from recon.results import Results, read_results
from recon.video import VideoInfo, probe, read_frames, require_codec, video_writer

SLOW_FPS = 30.0
"""Every frame is shown, and no more than this many in a second, unless a speed is given."""
SIDES: dict[Side | None, Colour] = {"left": LEFT, "right": RIGHT, None: MIDDLE}

Progress = Callable[[str, float], None]

MIN_WIDTH_PX = 640
"""Smaller videos are enlarged, by a whole number: the text would not be read."""


@dataclass(frozen=True)
class OverlayRun:
    """frames: how many were written. fps: of the new video. speed: 1 is real time."""

    frames: int
    fps: float
    speed: float


def run_overlay(
    folder: Path,
    video: Path,
    out: Path,
    *,
    first_frame: int = 0,
    speed: float | None = None,
    overwrite: bool = False,
    progress: Progress = lambda stage, share: None,
) -> OverlayRun:
    """`recon overlay`: every frame of a result's clip, drawn on the video that it came from.

    first_frame: the number that the video's first frame has in the result. speed: of the playback. Raises InputError,
    with every problem, for inputs that do not belong together; then nothing is written.
    """
    result, info, _ = all_of(
        lambda: read_results(folder), lambda: probe(video), lambda: _check_out(out, overwrite, video)
    )
    if speed is None:
        speed = min(1.0, SLOW_FPS / result.fps)
    zoom = -(-MIN_WIDTH_PX // info.size_px[0])
    overlay, *_ = all_of(
        lambda: overlay_of(result, speed, zoom),
        lambda: _check_video(result, video, info, first_frame),
        lambda: _speed(speed),
    )
    rows = {int(frame): t for t, frame in enumerate(result.pose.frames)}
    first, last = min(rows), max(rows)
    fps = result.fps * speed
    written = 0
    with video_writer(out, canvas_size((zoom * info.size_px[0], zoom * info.size_px[1])), fps) as write:
        for index, picture in read_frames(video, first - first_frame, last + 1 - first_frame):
            frame = index + first_frame
            enlarged = np.asarray(cv2.resize(picture, None, fx=zoom, fy=zoom), dtype=np.uint8)
            write(draw_frame(overlay, rows.get(frame), frame, enlarged))
            written += 1
            progress("drawing", written / (last + 1 - first))
        if written < last + 1 - first:
            found = f"{first - first_frame + written} frames that can be decoded"
            expected = f"{last + 1 - first_frame} or more, for the result's frames {first} to {last}" + (
                f" (the video's first frame being {first_frame})" if first_frame else ""
            )
            raise InputError(Problem(video, "video", found, f"{expected}: the video of this clip, or --first-frame"))
    return OverlayRun(written, fps, speed)


def overlay_of(result: Results, speed: float = 1.0, zoom: int = 1) -> Overlay:
    """What there is to draw of a result, on pictures enlarged by zoom. Raises InputError where its files do not fit
    each other."""
    reprojected = _reprojection(result)
    # Reprojected less detected, joints x {x, y} x frames; null is None, which becomes NaN.
    errors = np.array(result.report["image_error_px"]["values"], dtype=float).transpose(2, 0, 1)
    at = {name: j for j, name in enumerate(result.pose.names)}
    row = {int(frame): t for t, frame in enumerate(result.pose.frames)}
    outliers = np.zeros(errors.shape[:2], dtype=bool)
    for outlier in result.report["outliers"]:
        outliers[row[outlier["frame"]], at[outlier["keypoint"]]] = True
    rear, front = (at[name] for name in result.forward)
    return Overlay(
        frames=result.pose.frames,
        fps=result.fps,
        limbs=list(result.limbs.values()),
        colours=[SIDES[result.limb_sides[limb]] for limb in result.limbs],
        detected_px=_enlarged(reprojected.xy_px - errors, zoom),
        reprojected_px=_enlarged(reprojected.xy_px, zoom),
        outliers=outliers,
        depth_m=result.pose.xyz_m @ viewing_direction(result.camera),
        upright_m=result.pose.xyz_m,
        trunk=(rear, front),
        flags=[frame["flags"] for frame in result.report["frames"]],
        speed=speed,
    )


def _enlarged(xy_px: FloatArray, zoom: int) -> FloatArray:
    """Pixels' centres are whole numbers, before and after."""
    return zoom * xy_px + 0.5 * (zoom - 1)


def viewing_direction(camera: Camera) -> FloatArray:
    """Unit vector (3,) along the camera's axis, in the upright frame (`recon.results`)."""
    if camera.knows_up and camera.rotation is not None:
        return camera.rotation[2]
    right, away = level_axes(camera.up)
    return np.array([right[2], away[2], camera.up[2]])


def _reprojection(result: Results) -> Keypoints:
    path = result.folder / "reprojection.csv"
    result.manifest.require(path.name)
    found = read_keypoints(path)
    result.manifest.require_same()
    if found.names != result.pose.names or not np.array_equal(found.frames, result.pose.frames):
        raise InputError(Problem(path, "content", "other joints or frames", "those of pose3d.csv, of the same fit"))
    return found


def _check_video(result: Results, video: Path, info: VideoInfo, first_frame: int) -> None:
    problems = []
    size = result.camera.image_size_px
    if info.size_px != size:
        expected = f"{size[0]}x{size[1]}, the size that the camera is calibrated for"
        problems.append(Problem(video, "size", f"{info.size_px[0]}x{info.size_px[1]}", expected))
    first = int(result.pose.frames.min())
    if first_frame > first:
        expected = f"{first} or less: the result begins with frame {first}"
        problems.append(Problem("--first-frame", "number", str(first_frame), expected))
    if problems:
        raise InputError(problems)


def _speed(speed: float) -> None:
    if not 0 < speed <= 10:
        raise InputError(Problem("--speed", "factor", f"{speed:g}", "more than 0 and at most 10; 1 is real time"))


def _check_out(out: Path, overwrite: bool, video: Path) -> None:
    require_codec(out)
    require_free_file(out, overwrite, source=video)
