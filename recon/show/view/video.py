"""The video's frames for a playback, in step with the 3D, in a file of their own.

They are `picture/video`, or `picture/<name>/video` of one of several cameras, a JPEG for each frame of the playback on
both of its timelines, and the view of the whole picture comes to the front. JPEG is what every viewer shows; of the
codecs of videos it decodes only AV1 by itself, and the others jump from key frame to key frame where there is no
ffmpeg. rerun has the corner of the top left pixel at (0, 0), where the points have its centre: the picture lies half a
pixel to the right and below.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import cv2
import numpy as np
import rerun as rr
from rerun.chunk import Chunk

from recon.base.errors import InputError, Problem, refuse
from recon.base.progress import Progress, silent
from recon.io.video import Image, probe, read_frames
from recon.show.recording import recording
from recon.show.view.scene import PICTURE, Log
from recon.show.view.stored import Part, Playback

VIDEO, EDGE = "video", "frame"
"""In a camera's picture."""
QUALITIES = (90, 75, 60, 45, 30)
"""Of the JPEGs: the best with which all of them stay below `MAX_BYTES`."""
MAX_BYTES = 400_000_000
SAMPLED = 5
"""Frames from which the size of all is estimated."""
BATCH = 8
"""Frames that are held in memory."""


def write_video(
    path: Path,
    playback_path: Path,
    video: Path,
    first_frame: int = 0,
    camera: str | None = None,
    progress: Progress = silent,
    max_bytes: int = MAX_BYTES,
) -> int:
    """Write the frames of a video that go with a playback (`recon.show.view.together`).

    first_frame: the number that the video's first frame has in the playback. camera: whose video it is, by name, where
    the playback has several. Returns the quality of the JPEGs, 0 to 100. Raises InputError where there is no such
    playback, camera or video, where they differ in size, where the video lacks frames of the playback, and where the
    pictures would take more than `max_bytes` even at the lowest quality.
    """
    playback, info = Playback.read(playback_path), probe(video)
    first, last = int(playback.frames.min()), int(playback.frames.max())
    sizes_px = _sizes_px(playback)
    origin = _origin(sizes_px, camera)
    problems, size = [], sizes_px[origin]
    if info.size_px != size:
        expected = f"{size[0]}x{size[1]}, the size that the camera is calibrated for"
        problems.append(Problem(video, "size", f"{info.size_px[0]}x{info.size_px[1]}", expected))
    if first_frame > first:
        expected = f"{first} or less: the playback begins with frame {first}"
        problems.append(Problem("--first-frame", "number", str(first_frame), expected))
    refuse(problems)
    quality = _quality(video, first - first_frame, last + 1 - first_frame, len(playback.frames), max_bytes)
    _write(playback, origin, video, first_frame, quality, path, progress)
    return quality


def picture_of(video: Part) -> str:
    """The picture that a video's frames belong to."""
    return next(iter(_in_pictures(video, VIDEO)))


def _write(
    playback: Playback, origin: str, video: Path, first_frame: int, quality: int, path: Path, progress: Progress
) -> None:
    with recording(path, playback.layout.in_front(origin), part_of=playback.id) as stream:
        at = dict(zip(playback.frames.tolist(), playback.time_s.tolist(), strict=True))
        first, last = min(at), max(at)
        batch: list[tuple[int, bytes]] = []
        read = 0

        def send() -> None:
            frames = np.array([frame for frame, _ in batch])
            columns = rr.EncodedImage.columns(blob=[jpeg for _, jpeg in batch], media_type=["image/jpeg"] * len(batch))
            Log(stream, frames, np.array([at[frame] for frame, _ in batch])).send(f"{origin}/{VIDEO}", columns)
            batch.clear()

        for index, image in read_frames(video, first - first_frame, last + 1 - first_frame):
            read += 1
            progress("adding the video", read / (last + 1 - first))
            if index + first_frame in at:
                batch.append((index + first_frame, _jpeg(image, quality)))
            if len(batch) == BATCH:
                send()
        if batch:
            send()
        if read < last + 1 - first:
            found = f"{first - first_frame + read} frames that can be decoded"
            expected = f"{last + 1 - first_frame} or more, for the playback's frames {first} to {last}"
            raise InputError(Problem(video, "video", found, f"{expected}: the video of this clip, or --first-frame"))


def _quality(video: Path, first: int, stop: int, count: int, max_bytes: int) -> int:
    """The best of `QUALITIES` with which `count` frames are small enough."""
    step = max(1, (stop - first) // SAMPLED)
    images = [image for _, image in read_frames(video, first, stop, step)]
    total = 0.0
    for quality in QUALITIES:
        total = count * float(np.mean([len(_jpeg(image, quality)) for image in images] or [0.0]))
        if total <= max_bytes:
            return quality
    found = f"{count} frames that take {total / 1e6:.0f} MB as JPEG"
    raise InputError(Problem(video, "video", found, f"at most {max_bytes / 1e6:.0f} MB: a shorter clip (--frames)"))


def _jpeg(image: Image, quality: int) -> bytes:
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def _in_pictures(part: Part, entity: str) -> dict[str, Chunk]:
    """By picture, what it has of an entity."""
    chunks = {chunk.entity_path.removeprefix("/"): chunk for chunk in part.data}
    return {
        path.removesuffix(f"/{entity}"): chunk
        for path, chunk in chunks.items()
        if path.split("/")[0] == PICTURE and path.endswith(f"/{entity}")
    }


def _sizes_px(playback: Playback) -> dict[str, tuple[int, int]]:
    """(width, height) of the playback's pictures."""
    sizes = {}
    for origin, chunk in _in_pictures(playback, EDGE).items():
        (half,) = chunk.to_record_batch().to_pylist()[0]["Boxes2D:half_sizes"]
        sizes[origin] = (round(2 * half[0]), round(2 * half[1]))
    if not sizes:
        raise ValueError("a playback without a picture")
    return sizes


def _origin(origins: Collection[str], camera: str | None) -> str:
    """The picture that is meant; of the only camera whatever its name."""
    if PICTURE in origins and camera is None:
        return PICTURE
    if camera is not None and (origin := f"{PICTURE}/{rr.escape_entity_path_part(camera)}") in origins:
        return origin
    names = ", ".join(origin.removeprefix(f"{PICTURE}/") for origin in origins)
    expected = "nothing: the playback has one camera" if PICTURE in origins else f"one of {names}, whose video it is"
    raise InputError(Problem("--camera-name", "camera", "nothing" if camera is None else camera, expected))
