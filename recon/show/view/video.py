"""The video's frames for a playback, in step with the 3D, in a file of their own.

They are `picture/video`, or `picture/<name>/video` of one of several cameras, a JPEG for each frame of the playback on
both of its timelines, and `closeup/video`, what lies around the animal. JPEG is what every viewer shows; of the codecs
of videos it decodes only AV1 by itself, and the others jump from key frame to key frame where there is no ffmpeg. rerun
has the corner of the top left pixel at (0, 0), where the points have its centre: the whole picture lies half a pixel to
the right and below.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import rerun as rr

from recon.base.arrays import Index
from recon.base.errors import InputError, Problem, refuse
from recon.base.progress import Progress, silent
from recon.fit.motion import Motion
from recon.io.video import Image, probe, read_frames
from recon.show.recording import recording
from recon.show.view.picture import CLOSE, middle_and_reach_px
from recon.show.view.scene import BACKGROUND, CLOSEUP, PICTURE, Log, by_camera
from recon.show.view.stored import Part

VIDEO = "video"
"""In a camera's picture, and in its close look."""
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
    playback: Path,
    motion: Motion,
    video: Path,
    first_frame: int = 0,
    camera: str | None = None,
    progress: Progress = silent,
    max_bytes: int = MAX_BYTES,
) -> int:
    """Write the frames of a video that go with the playback of a motion (`recon.show.view.together`).

    first_frame: the number that the video's first frame has in the playback. camera: whose video it is, by name, where
    the playback has several. Returns the quality of the JPEGs, 0 to 100. Raises InputError where there is no such
    playback, camera or video, where they differ in size, where the video lacks frames of the playback, and where the
    pictures would take more than `max_bytes` even at the lowest quality.
    """
    part, info = Part.read(playback), probe(video)
    first, index = int(motion.frames[0]), _index(motion, camera)
    problems, size = [], motion.pictures[index].camera.image_size_px
    if info.size_px != size:
        expected = f"{size[0]}x{size[1]}, the size that the camera is calibrated for"
        problems.append(Problem(video, "size", f"{info.size_px[0]}x{info.size_px[1]}", expected))
    if first_frame > first:
        expected = f"{first} or less: the playback begins with frame {first}"
        problems.append(Problem("--first-frame", "number", str(first_frame), expected))
    refuse(problems)
    closeup = _Closeup.of(motion, index)
    quality = _quality(video, first_frame, motion.frames, closeup, max_bytes)
    entities = by_camera(PICTURE, motion.pictures)[index], by_camera(CLOSEUP, motion.pictures)[index]
    with recording(path, part.layout, part_of=part.id) as stream:
        _write(stream, motion, entities, video, first_frame, closeup, quality, progress)
    return quality


@dataclass(frozen=True)
class _Closeup:
    """What a picture has around the animal. middle_px: by frame with a pose; size_px: width and height."""

    middle_px: dict[int, tuple[float, float]]
    size_px: tuple[int, int]

    @classmethod
    def of(cls, motion: Motion, index: int) -> _Closeup:
        picture = motion.pictures[index]
        middles, reach = middle_and_reach_px(picture)
        posed = np.isfinite(picture.reprojected_px).any(axis=(1, 2))
        at = zip(motion.frames[posed].tolist(), middles[posed].tolist(), strict=True)
        middle = {frame: (x, y) for frame, (x, y) in at}
        wide, high = 2 * CLOSE * reach
        return cls(middle, (math.ceil(max(wide, ASPECT * high)), math.ceil(max(high, wide / ASPECT))))

    def cut(self, image: Image, frame: int) -> Image | None:
        """The animal's middle in the middle; None without a pose."""
        if frame not in self.middle_px:
            return None
        off = (np.array(self.size_px) - 1) / 2 - self.middle_px[frame]
        move = np.hstack([np.eye(2), off[:, None]])
        return np.asarray(cv2.warpAffine(image, move, self.size_px, borderValue=BACKGROUND[::-1]), dtype=np.uint8)


def _write(
    stream: rr.RecordingStream,
    motion: Motion,
    entities: tuple[str, str],
    video: Path,
    first_frame: int,
    closeup: _Closeup,
    quality: int,
    progress: Progress,
) -> None:
    """entities: of the whole picture, and of what lies around the animal."""
    whole, close = entities
    at = dict(zip(motion.frames.tolist(), motion.time_s.tolist(), strict=True))
    first, last = min(at), max(at)
    batch: list[tuple[str, int, bytes]] = []
    read = 0
    corner = rr.Transform3D(translation=[*(-np.array(closeup.size_px) / 2), 0.0])
    Log(stream, motion.frames, motion.time_s).fix(f"{close}/{VIDEO}", corner)

    def send() -> None:
        for entity in entities:
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
            for entity, shown in ((whole, image), (close, closeup.cut(image, index + first_frame))):
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


def _quality(video: Path, first_frame: int, frames: Index, closeup: _Closeup, max_bytes: int) -> int:
    """The best of `QUALITIES` with which all frames are small enough."""
    first, stop = int(frames.min()) - first_frame, int(frames.max()) + 1 - first_frame
    images, read = [], 0
    for index, image in read_frames(video, first, stop, max(1, (stop - first) // SAMPLED)):
        read += 1
        images += [shown for shown in (image, closeup.cut(image, index + first_frame)) if shown is not None]
    total = 0.0
    for quality in QUALITIES:
        total = len(frames) * sum(len(_jpeg(image, quality)) for image in images) / max(read, 1)
        if total <= max_bytes:
            return quality
    found = f"{len(frames)} frames that take {total / 1e6:.0f} MB as JPEG"
    raise InputError(Problem(video, "video", found, f"at most {max_bytes / 1e6:.0f} MB: a shorter clip (--frames)"))


def _jpeg(image: Image, quality: int) -> bytes:
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1].tobytes()


def _index(motion: Motion, camera: str | None) -> int:
    """Of the picture that is meant; the only one without a name."""
    names = [picture.name for picture in motion.pictures]
    if camera is None and len(names) == 1:
        return 0
    if camera in names and len(names) > 1:
        return names.index(camera)
    several = f"one of {', '.join(names)}, whose video it is"
    expected = several if len(names) > 1 else "nothing: the playback has one camera"
    raise InputError(Problem("--camera-name", "camera", "nothing" if camera is None else camera, expected))
