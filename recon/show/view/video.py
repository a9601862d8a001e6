"""The video's frames for a playback, in step with the 3D, in a file of their own.

They are `picture/video`, or `picture/<name>/video` of one of several cameras, a JPEG for each frame of the playback on
both of its timelines, and `closeup/video`, what lies around the animal. JPEG is what every viewer shows; of the codecs
of videos it decodes only AV1 by itself, and the others jump from key frame to key frame where there is no ffmpeg. rerun
has the corner of the top left pixel at (0, 0), where the points have its centre: the whole picture lies half a pixel to
the right and below.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rerun as rr

from recon.base.errors import InputError, Problem, refuse
from recon.base.progress import Progress, silent
from recon.io.video import Image, probe, read_frames
from recon.show.recording import recording
from recon.show.view.picture import CLOSE
from recon.show.view.scene import BACKGROUND, CLOSEUP, PICTURE, Log
from recon.show.view.stored import Playback

VIDEO, EDGE, JOINTS = "video", "frame", "reprojections/joints"
"""In a camera's picture."""
ASPECT = 2.4
"""Width to height of what is shown around the animal: of its place in the layout."""
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
    first = int(playback.frames.min())
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
    closeup = _Closeup.of(_in_pictures(playback, JOINTS)[origin])
    quality = _quality(video, first_frame, playback, closeup, max_bytes)
    _write(playback, origin, video, first_frame, closeup, quality, path, progress)
    return quality


@dataclass(frozen=True)
class _Closeup:
    """What a picture has around the animal. middle_px: by frame with a pose; size_px: width and height."""

    middle_px: dict[int, tuple[float, float]]
    size_px: tuple[int, int]

    @classmethod
    def of(cls, joints: Sequence[dict[str, Any]]) -> _Closeup:
        middle, reach = {}, np.ones(2)
        for row in joints:
            points = np.array(row.get("Points2D:positions") or [], dtype=float).reshape(-1, 2)
            if len(points):
                x, y = points.mean(axis=0).tolist()
                middle[row["frame"]] = x, y
                reach = np.maximum(reach, np.abs(points - (x, y)).max(axis=0))
        wide, high = 2 * CLOSE * reach
        return cls(middle, (math.ceil(max(wide, ASPECT * high)), math.ceil(max(high, wide / ASPECT))))

    def cut(self, image: Image, frame: int) -> Image | None:
        """The animal's middle in the middle; None without a pose."""
        if frame not in self.middle_px:
            return None
        off = (np.array(self.size_px) - 1) / 2 - self.middle_px[frame]
        move = np.hstack([np.eye(2), off[:, None]])
        return cv2.warpAffine(image, move, self.size_px, borderValue=BACKGROUND[::-1])


def _write(
    playback: Playback,
    origin: str,
    video: Path,
    first_frame: int,
    closeup: _Closeup,
    quality: int,
    path: Path,
    progress: Progress,
) -> None:
    close = CLOSEUP + origin.removeprefix(PICTURE)
    with recording(path, playback.layout.as_stored(), part_of=playback.id) as stream:
        at = dict(zip(playback.frames.tolist(), playback.time_s.tolist(), strict=True))
        first, last = min(at), max(at)
        batch: list[tuple[str, int, bytes]] = []
        read = 0
        Log(stream, playback.frames, playback.time_s).fix(
            f"{close}/{VIDEO}", rr.Transform3D(translation=[*(-np.array(closeup.size_px) / 2), 0.0])
        )

        def send() -> None:
            for entity in (origin, close):
                own = [(frame, jpeg) for of_it, frame, jpeg in batch if of_it == entity]
                if own:
                    frames = np.array([frame for frame, _ in own])
                    log = Log(stream, frames, np.array([at[frame] for frame, _ in own]))
                    jpegs = [jpeg for _, jpeg in own]
                    columns = rr.EncodedImage.columns(blob=jpegs, media_type=["image/jpeg"] * len(own))
                    log.send(f"{entity}/{VIDEO}", columns)
            batch.clear()

        for index, image in read_frames(video, first - first_frame, last + 1 - first_frame):
            read += 1
            progress("adding the video", read / (last + 1 - first))
            if index + first_frame in at:
                for entity, shown in ((origin, image), (close, closeup.cut(image, index + first_frame))):
                    if shown is not None:
                        batch.append((entity, index + first_frame, _jpeg(shown, quality)))
            if len(batch) >= BATCH:
                send()
        if batch:
            send()
        if read < last + 1 - first:
            found = f"{first - first_frame + read} frames that can be decoded"
            expected = f"{last + 1 - first_frame} or more, for the playback's frames {first} to {last}"
            raise InputError(Problem(video, "video", found, f"{expected}: the video of this clip, or --first-frame"))


def _quality(video: Path, first_frame: int, playback: Playback, closeup: _Closeup, max_bytes: int) -> int:
    """The best of `QUALITIES` with which all frames are small enough."""
    first, stop, count = (
        playback.frames.min() - first_frame,
        playback.frames.max() + 1 - first_frame,
        len(playback.frames),
    )
    images, read = [], 0
    for index, image in read_frames(video, int(first), int(stop), max(1, int(stop - first) // SAMPLED)):
        read += 1
        images += [shown for shown in (image, closeup.cut(image, index + first_frame)) if shown is not None]
    total = 0.0
    for quality in QUALITIES:
        total = count * sum(len(_jpeg(image, quality)) for image in images) / max(read, 1)
        if total <= max_bytes:
            return quality
    found = f"{count} frames that take {total / 1e6:.0f} MB as JPEG"
    raise InputError(Problem(video, "video", found, f"at most {max_bytes / 1e6:.0f} MB: a shorter clip (--frames)"))


def _jpeg(image: Image, quality: int) -> bytes:
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def _in_pictures(playback: Playback, entity: str) -> dict[str, list[dict[str, Any]]]:
    """By picture, the rows that it has of an entity."""
    rows: dict[str, list[dict[str, Any]]] = {}
    for chunk in playback.data:
        path = chunk.entity_path.removeprefix("/")
        if path.split("/")[0] == PICTURE and path.endswith(f"/{entity}"):
            rows.setdefault(path.removesuffix(f"/{entity}"), []).extend(chunk.to_record_batch().to_pylist())
    return rows


def _sizes_px(playback: Playback) -> dict[str, tuple[int, int]]:
    """(width, height) of the playback's pictures."""
    sizes = {}
    for origin, (row, *_) in _in_pictures(playback, EDGE).items():
        (half,) = row["Boxes2D:half_sizes"]
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
