"""A result drawn on its video, or some of its frames side by side, as one picture."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np

from recon.animal.body import Side
from recon.base.arrays import Array, Index
from recon.base.errors import InputError, Problem, all_of, refuse
from recon.base.files import require_free_file, staged_file, write_bytes
from recon.base.progress import Progress, silent
from recon.base.settings import Integer, Number, Option
from recon.check import FLAG_OF, usable
from recon.fit.motion import Motion
from recon.fit.result import Verdict
from recon.io.video import Image, VideoInfo, probe, read_frames, require_codec, video_writer
from recon.show.overlay import LEFT, MIDDLE, RIGHT, Colour, Overlay, canvas_size, draw_frame, draw_sheet
from recon.workflows.cameras import cameras_in
from recon.workflows.settings import ANYWAY, ResultSettings

SLOW_FPS = 30.0
"""Every frame is shown, and no more than this many in a second, unless a speed is given."""
SIDES: dict[Side | None, Colour] = {"left": LEFT, "right": RIGHT, None: MIDDLE}
COUNT, MOST = 12, 60
"""Of the stills of a sheet."""
MIN_WIDTH_PX = 640
"""Smaller videos are enlarged, by a whole number: the text would not be read."""


class OverlaySettings(ResultSettings):
    """What `recon overlay` is told."""

    out: Annotated[Path | None, Option("The new video, .mp4 (MPEG-4) or .avi (Motion JPEG), as in overlay.mp4.")] = None
    sheet: Annotated[Path | None, Option("Stills side by side, as in sheet.png; without --video plain.")] = None
    count: Annotated[Integer, Option("Of the stills.")] = COUNT
    anyway: Annotated[bool, ANYWAY] = False
    speed: Annotated[
        Number | None,
        Option(
            "Of the playback, 1 is real time. (default: so that 30 frames are shown in a second)",
            "a number above 0, as in 0.25",
        ),
    ] = None
    overwrite: Annotated[bool, Option("Replace the new files.")] = False

    def problems(self) -> Iterator[Problem]:
        if self.out is None and self.sheet is None:
            yield Problem("--out", "file", "nothing", "the new video, or --sheet with a picture")
        if self.out is not None and self.video is None:
            yield Problem("--video", "file", "nothing", "the video that the keypoints came from")


RATE_SAME = 0.01
"""Rates within this, relative, are the same, as 29.97 and 30."""


def run_overlay(settings: OverlaySettings, progress: Progress = silent) -> tuple[int, float, float, Verdict | None]:
    """`recon overlay`: every frame of a result's clip, drawn on the video that it came from. Gives how many there are,
    how many a second, the speed, 1 being real time, and the verdict on the clip.

    first_frame: the number that the video's first frame has in the result. camera: whose video it is, by name, which
    may be left out where the result has one, or the video's own name contains it. speed: of the playback. Raises
    InputError, with every problem, for inputs that do not belong together; then nothing is written.
    """
    video, out, speed = settings.video, settings.out, settings.speed
    if video is None or out is None:
        raise InputError(Problem("--out", "file", "nothing", "the new video, and --video beside it"))
    motion, number, (wide, high) = result_and_video(
        settings, lambda: _check_out(out, settings.overwrite, video), lambda: _check_speed(speed)
    )
    usable(motion, settings.folder, settings.anyway)
    if speed is None:
        speed = min(1.0, SLOW_FPS / motion.fps)
    zoom = -(-MIN_WIDTH_PX // wide)
    overlay = overlay_of(motion, speed, zoom, number)
    rows = {int(frame): t for t, frame in enumerate(motion.frames)}
    first, last = min(rows), max(rows)
    fps = motion.fps * speed
    written = 0
    with video_writer(out, canvas_size((zoom * wide, zoom * high)), fps) as write:
        for index, picture in read_frames(video, first - settings.first_frame, last + 1 - settings.first_frame):
            frame = index + settings.first_frame
            enlarged = np.asarray(cv2.resize(picture, None, fx=zoom, fy=zoom), dtype=np.uint8)
            write(draw_frame(overlay, rows.get(frame), frame, enlarged))
            written += 1
            progress("drawing", written / (last + 1 - first))
        if written < last + 1 - first:
            found = f"{first - settings.first_frame + written} frames that can be decoded"
            expected = f"{last + 1 - settings.first_frame} or more, for the result's frames {first} to {last}" + (
                f" (the video's first frame being {settings.first_frame})" if settings.first_frame else ""
            )
            raise InputError(Problem(video, "video", found, f"{expected}: the video of this clip, or --first-frame"))
    return written, fps, speed, motion.verdict


def run_sheet(settings: OverlaySettings) -> int:
    """`recon overlay --sheet`: `count` frames with a pose, evenly spaced, as one PNG; how many there are. video: what
    is behind them, plain without one, and then the first camera's unless another is named; the others: see
    `run_overlay`. Raises InputError, with every problem."""
    sheet = settings.sheet
    if sheet is None:
        raise InputError(Problem("--sheet", "file", "nothing", "a picture, as in sheet.png"))
    free = partial(require_free_file, sheet, settings.overwrite, "--sheet", settings.video, (".png",))
    motion, number, _ = result_and_video(settings, free, lambda: _check_count(settings.count))
    usable(motion, settings.folder, settings.anyway)
    overlay = overlay_of(motion, number=number)
    rows = rows_to_show(overlay, settings.count)
    if not len(rows):
        raise InputError(Problem(settings.folder, "frames", "none with a pose", "one at least"))
    pictures = None if settings.video is None else pictures_of(settings.video, motion, rows, settings.first_frame)
    with staged_file(sheet) as staged:
        write_bytes(staged, cv2.imencode(".png", draw_sheet(overlay, rows, pictures))[1].tobytes())
    return len(rows)


def rows_to_show(overlay: Overlay, count: int) -> Index:
    """Rows of up to `count` frames with a pose, evenly spaced."""
    posed = np.flatnonzero(np.isfinite(overlay.reprojected_px).any(axis=(1, 2)))
    return posed[np.unique(np.round(np.linspace(0, len(posed) - 1, count)).astype(int))] if len(posed) else posed


def pictures_of(video: Path, motion: Motion, rows: Index, first_frame: int) -> list[Image]:
    """The video's frames for these rows of a result. Raises InputError for one that is not in it."""
    wanted = [int(motion.frames[t]) - first_frame for t in rows]
    found = {at: picture for at, picture in read_frames(video, wanted[0], wanted[-1] + 1) if at in wanted}
    if len(found) < len(wanted):
        number = next(at for at in wanted if at not in found) + first_frame
        raise InputError(Problem(video, "video", f"no frame {number}", "the video of this clip, or --first-frame"))
    return [found[at] for at in wanted]


def result_and_video(settings: ResultSettings, *checks: Callable[[], None]) -> tuple[Motion, int, tuple[int, int]]:
    """A result, which of its cameras is meant, and the size of the pictures: the video's, if there is one, which has to
    be of that camera. checks: of what else was given. Raises InputError."""
    video = settings.video

    def opened() -> tuple[Motion, int]:
        motion, info = all_of(lambda: Motion.load(settings.folder), lambda: None if video is None else probe(video))
        number = camera_number(motion, settings.camera_name, video)
        if video is not None:
            _check_video(motion, number, video, info, settings.first_frame)
        return motion, number

    (motion, number), *_ = all_of(opened, *checks)
    return motion, number, motion.cameras[number].image_size_px


def camera_number(motion: Motion, camera: str | None, video: Path | None) -> int:
    """By name, or by the video's, which may contain it; without either the first. Raises InputError."""
    names = [one.name for one in motion.cameras]
    if camera is None and video is not None and len(names) > 1:
        named = [*cameras_in(video.stem, names)]
        camera = named[0] if len(named) == 1 else None
    if camera in names:
        return names.index(camera)
    if camera is None and (len(names) == 1 or video is None):
        return 0
    found = "nothing" if camera is None else camera
    raise InputError(Problem("--camera-name", "camera", found, f"one of {', '.join(names)}, whose video it is"))


def overlay_of(motion: Motion, speed: float = 1.0, zoom: int = 1, number: int = 0) -> Overlay:
    """What there is to draw of a result in a camera's picture, by its number, enlarged by zoom."""
    picture, view = motion.pictures[number], motion.solution.views[number]
    ahead = np.broadcast_to(view.T_camera_world[..., 2, :3], (len(motion.frames), 3))
    return Overlay(
        frames=motion.frames,
        fps=motion.fps,
        limbs=list(motion.limbs.values()),
        colours=[SIDES[motion.limb_sides[limb]] for limb in motion.limbs],
        detected_px=_enlarged(picture.reprojected_px - picture.image_error_px, zoom),
        reprojected_px=_enlarged(picture.reprojected_px, zoom),
        outliers=picture.outliers,
        depth_m=np.einsum("tjk,tk->tj", motion.upright.xyz_m, ahead),
        upright_m=motion.upright.xyz_m,
        trunk=motion.forward,
        flags=[*_flags(motion, number)],
        speed=speed,
    )


def _flags(motion: Motion, number: int) -> Iterator[list[str]]:
    """By frame: what is doubtful about it in a camera's picture, without what is wrong with others' detections."""
    own = [
        (FLAG_OF[one.code], *(one.frames or (motion.frames[0], motion.frames[-1] + 1)))
        for one in motion.findings
        if one.code in FLAG_OF and one.camera in (None, motion.cameras[number].name)
    ]
    for frame, flags in zip(motion.frames.tolist(), motion.flags, strict=True):
        here = {flag for flag, first, stop in own if first <= frame < stop}
        yield [flag for flag in flags if flag in here or flag not in FLAG_OF.values()]


def _enlarged(xy_px: Array, zoom: int) -> Array:
    """Pixels' centres are whole numbers, before and after."""
    return zoom * xy_px + 0.5 * (zoom - 1)


def rate_note(video: Path, fps: float | None) -> str | None:
    """What to say where a video states another frame rate than the clip has; it may well have been filmed faster than
    it is played."""
    stated = probe(video).fps
    if fps is None or stated is None or abs(stated / fps - 1) < RATE_SAME:
        return None
    return (
        f"{video.name} says {stated:.4g} frames a second, the clip has {fps:.4g}: right if it was filmed so and is "
        "played back otherwise; if not, times and speeds are wrong by that factor"
    )


def _check_video(motion: Motion, number: int, video: Path, info: VideoInfo, first_frame: int) -> None:
    problems = []
    size = motion.cameras[number].image_size_px
    if info.size_px != size:
        expected = f"{size[0]}x{size[1]}, the size that the camera is calibrated for"
        problems.append(Problem(video, "size", f"{info.size_px[0]}x{info.size_px[1]}", expected))
    first = int(motion.frames.min())
    if first_frame > first:
        expected = f"{first} or less: the result begins with frame {first}"
        problems.append(Problem("--first-frame", "number", str(first_frame), expected))
    refuse(problems)


def _check_speed(speed: float | None) -> None:
    if speed is not None and not 0 < speed <= 10:
        raise InputError(Problem("--speed", "factor", f"{speed:g}", "more than 0 and at most 10; 1 is real time"))


def _check_out(out: Path, overwrite: bool, video: Path) -> None:
    require_codec(out)
    require_free_file(out, overwrite, source=video)


def _check_count(count: int) -> None:
    if not 1 <= count <= MOST:
        raise InputError(Problem("--count", "number", str(count), f"1 to {MOST} frames"))
