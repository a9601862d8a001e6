"""Read and write videos, frame by frame.

Frames are counted from 0 in the order in which they are decoded, never by seeking. Seeking is inexact in many formats,
and a detector that went through the video counted its frames in the same way. The number of frames that a file states
is only an estimate.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from recon.base.arrays import Array
from recon.base.documents import utf8_path
from recon.base.errors import InputError, Problem
from recon.base.files import staged_file
from recon.geometry.camera import Camera

Image = npt.NDArray[np.uint8]
CODECS = {".mp4": "mp4v", ".avi": "MJPG", ".webm": "VP80"}
"""Codec of a new video for each suffix, of those that OpenCV's own wheels can encode.

MPEG-4 part 2 is shown by players but not by browsers. VP8 is played by every browser, but its encoder is slow. MJPG is
Motion JPEG. The wheels have no encoder for H.264.
"""

MAX_UNEVENNESS = 0.3
"""Largest deviation of the time between frames from a multiple of the usual time, as a fraction of the usual time."""
STAMP_S = 1e-3
"""Tolerance of time stamps in seconds, in addition to `MAX_UNEVENNESS`, because Matroska's are whole milliseconds."""
DRIFT = 0.05
"""Largest relative deviation from a video's usual frame rate, which phones lower in the dark."""
DRIFT_FRAMES = 30
"""Number of frames over which the frame rate is compared with the video's usual frame rate."""
MAX_GAPS = 5

MAX_BLACK = 24
"""Largest brightness in a black bar, 0 to 255, because compressed black is not quite 0."""
MIN_BRIGHTNESS = 80
"""Smallest mean brightness of the lines between two black bars, each line by its brightest pixel, 0 to 255."""
MIN_BAR_FRACTION = 0.02
"""Smallest width of a black bar, as a fraction of the picture's width, or of its height for bars at top and bottom."""
BAR_PX = 2
"""Largest difference in width between two equal black bars, and largest width of an edge that is no bar, in pixels."""

SUFFIXES = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv", ".mts")


@dataclass(frozen=True)
class VideoInfo:
    """Size, rate and number of frames as stated in a video file."""

    size_px: tuple[int, int]
    """Width and height of the picture."""
    fps: float | None
    """Frame rate; None if the file does not state it."""
    stated_frames: int | None
    """Number of frames; None if the file does not state it. The number that can be decoded may differ."""
    bars_px: tuple[int, int] = (0, 0)
    """Width of the black bars at left and right, and height of those at top and bottom, in the first frame."""


def probe(path: str | Path) -> VideoInfo:
    """Return the size, frame rate and number of frames of a video, after decoding its first frame.

    Raises
    ------
    InputError
        If the file is not a video.
    """
    with _opened(Path(path)) as capture:
        fps, count = capture.get(cv2.CAP_PROP_FPS), capture.get(cv2.CAP_PROP_FRAME_COUNT)
        decoded, image = capture.read()
    if not decoded:
        raise InputError(Problem(path, "video", "no frame that can be decoded", "a video"))
    known = np.isfinite(fps) and 0 < fps < 1e5
    picture = np.asarray(image, dtype=np.uint8)
    size_px, bars_px = (picture.shape[1], picture.shape[0]), (black_bars(picture, 1), black_bars(picture, 0))
    return VideoInfo(size_px, float(fps) if known else None, int(count) if count > 0 else None, bars_px)


def black_bars(picture: Image, axis: int) -> int:
    """Return the width of equal black bars at both ends of an axis of a picture (H, W, 3), or 0 without them."""
    brightness = picture.max(axis=(1 - axis, 2))
    lit = np.flatnonzero(brightness > MAX_BLACK)
    if not len(lit) or brightness[lit[0] : lit[-1] + 1].mean() < MIN_BRIGHTNESS:
        return 0
    ends = int(lit[0]), len(brightness) - 1 - int(lit[-1])
    is_even = abs(ends[0] - ends[1]) <= BAR_PX
    return min(ends) if is_even and min(ends) > max(MIN_BAR_FRACTION * len(brightness), BAR_PX) else 0


def size_problems(video: Path, info: VideoInfo, camera: Camera) -> Iterator[Problem]:
    """Yield a problem if the size of a video differs from the size for which the camera is calibrated."""
    video_size, camera_size = ("{}x{}".format(*size) for size in (info.size_px, camera.image_size_px))
    if video_size != camera_size:
        yield Problem(video, "size", video_size, f"{camera_size}, the size for which the camera is calibrated")


def read_picture(path: Path, flags: int) -> Image | None:
    """Return a picture, rotated by its orientation tag; None if unreadable or too large for OpenCV.

    `flags` are passed to `cv2.imdecode`.
    """
    image = None
    if not path.is_file():  # reading a pipe would block
        return None
    try:
        data = np.fromfile(path, dtype=np.uint8)  # cv2.imread does not take every path on Windows
        image = cv2.imdecode(data, flags) if data.size else None
    except (OSError, cv2.error) as error:
        if isinstance(error, cv2.error) and error.code == cv2.Error.StsNoMem:
            raise
    return None if image is None else np.asarray(image, dtype=np.uint8)


def missing_frames(times_s: Array) -> dict[int, int] | None:
    """Return the number of frames missing before each frame, from gaps in time stamps (T,) that are otherwise even.

    The dictionary is empty if there are no time stamps. The result is None if the time stamps are too uneven
    to tell.
    """
    steps = np.diff(times_s)
    if not steps.any():
        return {}
    usual = steps[steps < 1.5 * np.median(steps)].mean()
    if not usual > 0:
        return None
    counts = np.rint(steps / usual).astype(int)
    if (counts < 1).any() or (np.abs(steps - counts * usual) > MAX_UNEVENNESS * usual + STAMP_S).any():
        return None
    window = max(1, min(DRIFT_FRAMES, len(times_s) // 2))
    due_s = usual * np.concatenate([[0], np.cumsum(counts)])
    due_s, spent_s = due_s[window:] - due_s[:-window], times_s[window:] - times_s[:-window]
    if (np.abs(spent_s - due_s) > DRIFT * due_s + 2 * STAMP_S).any():
        return None
    return {int(index) + 1: int(counts[index]) - 1 for index in np.flatnonzero(counts > 1)}


def missing_note(path: str | Path, times_s: Array, first_frame: int = 0, previous_frames: int | None = 0) -> str | None:
    """Return a note about missing or unevenly timed frames of a video, or None.

    Parameters
    ----------
    path : path
        Video file.
    times_s : (T,)
        Time stamps of the frames that can be decoded, from `first_frame`.
    first_frame : int
        Number of the first of these frames.
    previous_frames : int or None
        Number of frames decoded before them; None if frames after them were not read, so that the number of frames
        that the file states cannot be checked.
    """
    name, stated = Path(path).name, probe(path).stated_frames
    counted = "Frames are numbered in the order of decoding, as in DeepLabCut, so keypoints keep their frames"
    missing = missing_frames(times_s)
    if missing is None:
        short, long = np.percentile(1e3 * np.diff(times_s), [0, 100])
        return (
            f"the frames of {name} are uneven in time ({short:.0f} to {long:.0f} ms apart), but a fit assumes even "
            f"times, so speeds are wrong. {counted}. Convert the video to a constant frame rate, then detect keypoints"
        )
    if missing:
        gaps = [f"{count} before frame {frame + first_frame}" for frame, count in missing.items()]
        rest = ", ..." if len(gaps) > MAX_GAPS else ""
        gap_frame = next(iter(missing)) + first_frame
        return (
            f"the time stamps of {name} show missing frames ({', '.join(gaps[:MAX_GAPS])}{rest}), where speeds are "
            f"wrong. {counted}. Fit the parts between the gaps separately, the first with --frames :{gap_frame}"
        )
    if previous_frames is not None and stated is not None and (decoded := previous_frames + len(times_s)) < stated:
        return (
            f"{name} states {stated} frames, but {decoded} can be decoded. Either the video is cut short, or frames "
            f"are missing at unknown times, where speeds are wrong. {counted}. Copy the video again"
        )
    return None


def read_frames(
    path: str | Path, first: int = 0, stop: int | None = None, step: int = 1
) -> Iterator[tuple[int, Image]]:
    """Yield numbers and pictures (height, width, 3; blue, green, red) of every `step`th frame.

    Frames run from `first` up to but not including `stop`, or to the end of the video. Only one picture is in memory at
    a time.
    """
    for number, _, image in timed_frames(path, first, stop, step):
        yield number, image


def timed_frames(
    path: str | Path, first: int = 0, stop: int | None = None, step: int = 1
) -> Iterator[tuple[int, float, Image]]:
    """Yield the number, the time stamp in seconds and the picture of every `step`th frame, as `read_frames` does."""
    number = 0
    with _opened(Path(path)) as capture:
        while (stop is None or number < stop) and capture.grab():
            if number >= first and (number - first) % step == 0:
                stamp_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
                decoded, image = capture.retrieve()
                if not decoded:
                    return
                yield number, stamp_s, np.asarray(image, dtype=np.uint8)
            number += 1


@contextmanager
def video_writer(path: str | Path, size_px: tuple[int, int], fps: float) -> Iterator[Callable[[Image], None]]:
    """Yield a function that appends a picture (height, width, 3; blue, green, red) to a new video.

    `size_px` is (width, height), both even. The file appears, or replaces an earlier one, when the block ends without
    an exception. After an exception, nothing is left.

    Raises
    ------
    InputError
        If the suffix is not in `CODECS`, or if OpenCV lacks the encoder.
    OSError
        If the disk is full.
    """
    path = Path(path)
    codec = require_codec(path)
    with staged_file(path) as staged, _quiet():
        staged.touch()  # raises an OSError with the reason, which OpenCV would not give
        with _without_stderr() if codec == "VP80" else nullcontext():  # OpenCV warns that WebM has no tags
            writer: Any = cv2.VideoWriter(_local(staged), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), fps, size_px)
        written = 0
        try:
            if not writer.isOpened():
                detail = f"no encoder in this OpenCV for {codec} of {size_px[0]}x{size_px[1]} px"
                raise InputError(Problem(path, "video", detail, "one of the suffixes " + ", ".join(CODECS)))

            def write(image: Image) -> None:
                nonlocal written
                if image.shape != (size_px[1], size_px[0], 3):
                    raise ValueError(f"a picture of shape {image.shape} in a video of {size_px[0]}x{size_px[1]} px")
                writer.write(image)
                written += 1

            yield write
        finally:
            writer.release()
        # OpenCV does not report a full disk.
        if not _is_complete(staged) or probe(staged).stated_frames != written:
            raise OSError(errno.ENOSPC, "the video could not be written: is the disk full?", str(path))


@contextmanager
def _quiet() -> Iterator[None]:
    """Silence the messages of OpenCV and FFmpeg on standard error."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read when the first video of a process is opened
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


@contextmanager
def _without_stderr() -> Iterator[None]:
    """Drop what libraries print on standard error outside Python."""
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)


def _is_complete(path: Path) -> bool:
    """Return whether an AVI (RIFF), MP4 or WebM file is as long as its parts state."""
    end, position = path.stat().st_size, 0
    if path.suffix.lower() == ".webm":
        return end == _webm_length(path)
    with path.open("rb") as file:
        while position < end:
            file.seek(position)
            head = file.read(16).ljust(16, b"\0")
            if path.suffix.lower() == ".avi":
                length = 8 + int.from_bytes(head[4:8], "little")
            else:
                length = int.from_bytes(head[:4], "big")
                length = int.from_bytes(head[8:], "big") if length == 1 else length
            position += max(length, 8)
    return position == end


def _webm_length(path: Path) -> int:
    """Return the length in bytes that a WebM file states for its header and its segment together."""
    with path.open("rb") as file:
        head = file.read(80)
    position = 0
    # each part begins with an identifier of four bytes and its length, whose leading zeros give its number of bytes
    for _ in range(2):
        size_bytes = 9 - head[position + 4].bit_length() if len(head) > position + 12 else 1
        size = int.from_bytes(head[position + 4 : position + 4 + size_bytes], "big") & ((1 << 7 * size_bytes) - 1)
        position += 4 + size_bytes + size
    return position


def require_codec(path: Path) -> str:
    """Return the codec for a video of this name.

    Raises
    ------
    InputError
        If the suffix has no codec.
    """
    codec = CODECS.get(path.suffix.lower())
    if codec is None:
        raise InputError(Problem(path, "suffix", repr(path.suffix), "one of " + ", ".join(CODECS)))
    return codec


def _local(path: Path) -> str:
    """Return a file name that FFmpeg does not mistake for a protocol, as in run10:30.mp4 or a folder called http:.

    Raises
    ------
    InputError
        If the name is not UTF-8, for which OpenCV crashes.
    """
    return utf8_path(path)


@contextmanager
def _opened(path: Path) -> Iterator[cv2.VideoCapture]:
    if not path.is_file():
        raise InputError(Problem(path, "video", "a folder" if path.is_dir() else "no such file", "a video"))
    with _quiet():
        capture = cv2.VideoCapture(_local(path), cv2.CAP_FFMPEG)
    if not capture.isOpened():
        raise InputError(Problem(path, "video", "a file that cannot be decoded", "a video"))
    try:
        yield capture
    finally:
        capture.release()
