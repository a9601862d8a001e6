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

from recon.fit.motion import Motion
from recon.io.video import Image
from recon.show.overlay import clip_frames
from recon.show.view.scene import BACKGROUND, CLOSE, CLOSEUP, PICTURE, Log, by_camera, middle_and_reach_px

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
    for _, t, _, image in clip_frames(motion.frames, video, first_frame):
        if t is None:
            continue
        log.send(whole, _jpeg(image), [t])
        if posed[t]:  # the animal's middle in the middle
            off = (size_px - 1) / 2 - middles[t]
            move = np.hstack([np.eye(2), off[:, None]])
            cut = cv2.warpAffine(image, move, size_px.tolist(), borderValue=BACKGROUND[::-1])
            log.send(close, _jpeg(np.asarray(cut, dtype=np.uint8)), [t])


def _jpeg(image: Image) -> rr.ComponentColumnList:
    content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    return rr.EncodedImage.columns(blob=[content], media_type=["image/jpeg"])
