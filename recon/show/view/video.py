"""The video's frames for a playback, in step with the 3D.

They are `picture/video`, or `picture/<name>/video` of one of several cameras, a JPEG for each frame of the playback on
both of its timelines, and `closeup/video`, what lies around the animal. JPEG is what every viewer shows; of the codecs
of videos it decodes only AV1 by itself, and the others jump from key frame to key frame where there is no ffmpeg. rerun
has the corner of the top left pixel at (0, 0), where the points have its centre: the whole picture lies half a pixel to
the right and below.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import rerun as rr

from recon.base.errors import InputError, Problem
from recon.fit.motion import Motion
from recon.io.video import Image, read_frames
from recon.show.view.scene import BACKGROUND, CLOSEUP, PICTURE, Log, by_camera
from recon.show.view.world import CLOSE, middle_and_reach_px

ASPECT = 2.4
"""Width to height of what is shown around the animal: of its place in the layout."""
JPEG_QUALITY = 85


def write_video(motion: Motion, log: Log, video: Path, first_frame: int = 0, number: int = 0) -> None:
    """The frames of a video that go with a motion. first_frame: the number that the video's first frame has in it;
    number: of the camera whose video it is, of the same size. Raises InputError where the video lacks frames."""
    middles, reach = middle_and_reach_px(motion.pictures[number])
    posed = np.asarray(np.isfinite(motion.pictures[number].reprojected_px).any(axis=(1, 2)))
    wide, high = 2 * CLOSE * reach
    size_px = np.ceil([max(wide, ASPECT * high), max(high, wide / ASPECT)]).astype(int)
    whole, close = (f"{by_camera(root, motion.pictures)[number]}/video" for root in (PICTURE, CLOSEUP))
    log.fix(close, rr.Transform3D(translation=[*(-size_px / 2), 0.0]))
    rows = {int(frame): t for t, frame in enumerate(motion.frames)}
    first, last, read = min(rows), max(rows), 0
    for index, image in read_frames(video, first - first_frame, last + 1 - first_frame):
        read += 1
        if (t := rows.get(index + first_frame)) is None:
            continue
        log.send(whole, _jpeg(image), [t])
        if posed[t]:  # the animal's middle in the middle
            off = (size_px - 1) / 2 - middles[t]
            move = np.hstack([np.eye(2), off[:, None]])
            cut = cv2.warpAffine(image, move, size_px.tolist(), borderValue=BACKGROUND[::-1])
            log.send(close, _jpeg(np.asarray(cut, dtype=np.uint8)), [t])
    if read < last + 1 - first:
        found = f"{first - first_frame + read} frames that can be decoded"
        expected = f"{last + 1 - first_frame} or more, for the playback's frames {first} to {last}"
        raise InputError(Problem(video, "video", found, f"{expected}: the video of this clip, or --first-frame"))


def _jpeg(image: Image) -> rr.ComponentColumnList:
    content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    return rr.EncodedImage.columns(blob=[content], media_type=["image/jpeg"])
