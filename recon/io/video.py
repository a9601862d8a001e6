"""Videos: frames in, one after the other, and frames out.

Frames are counted from 0 in the order in which they are decoded, never by seeking: seeking is inexact in many formats,
and a detector that went through the video counted its frames in this way. The number of frames that a file states is
only an estimate.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from recon.base import Array, InputError, Problem
from recon.base.files import staged_file
from recon.geometry.camera import Camera

Image = npt.NDArray[np.uint8]
CODECS = {".mp4": "mp4v", ".avi": "MJPG"}
"""What OpenCV's own wheels can encode quickly: MPEG-4 part 2, which players show but browsers do not, and Motion JPEG.
They hold no encoder for H.264, and VP9 takes half a second for a picture of 1920x1080."""

UNEVEN, STAMP_S = 0.3, 1e-3
"""How far the time between frames may be from a multiple of the usual one, as a share of that, and beside it: time
stamps of Matroska are whole milliseconds."""
DRIFT, DRIFT_FRAMES = 0.05, 30
"""How far the rate over so many frames may be from the usual one: telephones film slower in the dark."""
MOST_PLACES = 5

SUFFIXES = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv", ".mts")


@dataclass(frozen=True)
class VideoInfo:
    """What a video's file says about it."""

    size_px: tuple[int, int]
    """The size of the picture: (width, height)."""
    fps: float | None
    """None where the file does not say."""
    stated_frames: int | None
    """What the file says, None where it says nothing; the frames that can be decoded may be fewer or more."""


def probe(path: str | Path) -> VideoInfo:
    """What a video says about itself; its first frame is decoded. Raises InputError for a file that is no video."""
    with _opened(Path(path)) as capture:
        fps, count = capture.get(cv2.CAP_PROP_FPS), capture.get(cv2.CAP_PROP_FRAME_COUNT)
        found, image = capture.read()
    if not found:
        raise InputError(Problem(path, "video", "no frame that can be decoded", "a video"))
    known = np.isfinite(fps) and 0 < fps < 1e5
    return VideoInfo((image.shape[1], image.shape[0]), float(fps) if known else None, int(count) if count > 0 else None)


def size_problems(video: Path, info: VideoInfo, camera: Camera) -> Iterator[Problem]:
    """Where a video has another size than the camera is calibrated for."""
    found, wanted = ("{}x{}".format(*size) for size in (info.size_px, camera.image_size_px))
    if found != wanted:
        yield Problem(video, "size", found, f"{wanted}, the size that the camera is calibrated for")


def read_picture(path: Path, how: int) -> Image | None:
    """A picture, turned upright as its camera says, None where it cannot be read or has more pixels than OpenCV takes.
    how: as OpenCV's flags say."""
    image = None
    if not path.is_file():  # a pipe would be waited for
        return None
    try:
        data = np.fromfile(path, dtype=np.uint8)  # cv2.imread does not take every path on Windows
        image = cv2.imdecode(data, how) if data.size else None
    except (OSError, cv2.error) as error:
        if isinstance(error, cv2.error) and error.code == cv2.Error.StsNoMem:
            raise
    return None if image is None else np.asarray(image, dtype=np.uint8)


def missing_frames(times_s: Array) -> dict[int, int] | None:
    """How many frames are missing before a frame, by its number: where the time stamps (T,) of evenly spaced frames
    leave a gap. Empty where there are no time stamps either; None where they are uneven, and tell nothing."""
    steps = np.diff(times_s)
    if not steps.any():
        return {}
    usual = steps[steps < 1.5 * np.median(steps)].mean()
    if not usual > 0:
        return None
    counts = np.rint(steps / usual).astype(int)
    if (counts < 1).any() or (np.abs(steps - counts * usual) > UNEVEN * usual + STAMP_S).any():
        return None
    window = max(1, min(DRIFT_FRAMES, len(times_s) // 2))
    due_s = usual * np.concatenate([[0], np.cumsum(counts)])
    due_s, spent_s = due_s[window:] - due_s[:-window], times_s[window:] - times_s[:-window]
    if (np.abs(spent_s - due_s) > DRIFT * due_s + 2 * STAMP_S).any():
        return None
    return {int(at) + 1: int(counts[at]) - 1 for at in np.flatnonzero(counts > 1)}


def missing_note(path: str | Path, times_s: Array, first_frame: int = 0, before: int | None = 0) -> str | None:
    """What to say of a video whose frames are not all there, or are uneven in time. times_s: of those that can be
    decoded, from first_frame on, as it is numbered; before: how many come before them, None where more follow."""
    name, stated = Path(path).name, probe(path).stated_frames
    counted = "Frames are numbered as they are decoded, as DeepLabCut does, so that keypoints of this file are in step"
    missing = missing_frames(times_s)
    if missing is None:
        short, long = np.percentile(1e3 * np.diff(times_s), [0, 100])
        return (
            f"the frames of {name} are uneven in time ({short:.0f} to {long:.0f} ms apart), and a fit takes them "
            f"as even: speeds are wrong. {counted}; convert the video to a constant frame rate, then detect keypoints"
        )
    if missing:
        places = [f"{count} before frame {at + first_frame}" for at, count in missing.items()]
        more = ", ..." if len(places) > MOST_PLACES else ""
        at = next(iter(missing)) + first_frame
        return (
            f"by its time stamps {name} lacks frames ({', '.join(places[:MOST_PLACES])}{more}): speeds are wrong "
            f"there. {counted}; fit the parts between by themselves, the first with --frames :{at}"
        )
    if before is not None and stated is not None and (decoded := before + len(times_s)) < stated:
        return (
            f"{name} states {stated} frames, {decoded} can be decoded: it is cut short, or frames are missing "
            f"in it and speeds are wrong there; its time stamps do not say where. {counted}; copy the video again"
        )
    return None


def read_frames(
    path: str | Path, first: int = 0, stop: int | None = None, step: int = 1
) -> Iterator[tuple[int, Image]]:
    """Numbers and pictures (height, width, 3; blue, green, red) of every `step`th frame from `first` up to, but
    without, `stop`, as far as the video goes. One picture is held at a time."""
    for number, _, image in timed_frames(path, first, stop, step):
        yield number, image


def timed_frames(
    path: str | Path, first: int = 0, stop: int | None = None, step: int = 1
) -> Iterator[tuple[int, float, Image]]:
    """As `read_frames`, with each frame's time stamp in seconds between its number and its picture."""
    number = 0
    with _opened(Path(path)) as capture:
        while (stop is None or number < stop) and capture.grab():
            if number >= first and (number - first) % step == 0:
                stamp_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
                found, image = capture.retrieve()
                if not found:
                    return
                yield number, stamp_s, np.asarray(image, dtype=np.uint8)
            number += 1


@contextmanager
def video_writer(path: str | Path, size_px: tuple[int, int], fps: float) -> Iterator[Callable[[Image], None]]:
    """A function that appends a picture (height, width, 3; blue, green, red) to a new video.

    size_px: (width, height), even. The file appears, or replaces its predecessor, when the block ends without an
    exception; otherwise nothing is left. Raises InputError for a suffix that is not in `CODECS`, or where OpenCV lacks
    the encoder; OSError where the disk does not hold all of it.
    """
    path = Path(path)
    codec = require_codec(path)
    with staged_file(path) as staged, _quiet():
        staged.touch()  # an OSError with the reason, where OpenCV would only say no
        writer: Any = cv2.VideoWriter(_local(staged), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*codec), fps, size_px)
        written = 0
        try:
            if not writer.isOpened():
                found = f"an OpenCV without an encoder for {codec} of {size_px[0]}x{size_px[1]} px"
                raise InputError(Problem(path, "video", found, "one of the suffixes " + ", ".join(CODECS)))

            def write(image: Image) -> None:
                nonlocal written
                if image.shape != (size_px[1], size_px[0], 3):
                    raise ValueError(f"a picture of shape {image.shape} in a video of {size_px[0]}x{size_px[1]} px")
                writer.write(image)
                written += 1

            yield write
        finally:
            writer.release()
        # OpenCV says nothing of a full disk.
        if not _ends_as_it_says(staged) or probe(staged).stated_frames != written:
            raise OSError(errno.ENOSPC, "the video could not be written: is the disk full?", str(path))


@contextmanager
def _quiet() -> Iterator[None]:
    """What OpenCV and FFmpeg print on standard error about a full disk is said here, in one line."""
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # read when the first video of a process is opened
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)


def _ends_as_it_says(path: Path) -> bool:
    """Whether the parts of an AVI (RIFF) or MP4 file, of which each states its length, are all of it."""
    end, at = path.stat().st_size, 0
    with path.open("rb") as file:
        while at < end:
            file.seek(at)
            head = file.read(16).ljust(16, b"\0")
            if path.suffix.lower() == ".avi":
                length = 8 + int.from_bytes(head[4:8], "little")
            else:
                length = int.from_bytes(head[:4], "big")
                length = int.from_bytes(head[8:], "big") if length == 1 else length
            at += max(length, 8)
    return at == end


def require_codec(path: Path) -> str:
    """The codec for a video of this name. Raises InputError for a suffix without one."""
    codec = CODECS.get(path.suffix.lower())
    if codec is None:
        raise InputError(Problem(path, "suffix", repr(path.suffix), "one of " + ", ".join(CODECS)))
    return codec


def _local(path: Path) -> str:
    """A name that ffmpeg takes for a file: run10:30.mp4, or a folder called http:, would be a protocol."""
    return str(path.absolute())


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
