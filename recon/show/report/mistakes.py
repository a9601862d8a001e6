"""What may be wrong with the clip as it was given, in numbers and in words."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from recon.check.mistakes import Mistake
from recon.fit.motion import Motion

NAMED = 6
"""Up to so many keypoints are named in a sentence."""


def section(motion: Motion) -> list[dict[str, Any]]:
    return [_entry(motion, mistake) for mistake in motion.mistakes]


def warnings(report: Mapping[str, Any]) -> Iterator[str]:
    for mistake in report["mistakes"]:
        yield mistake["text"]


def _entry(motion: Motion, mistake: Mistake) -> dict[str, Any]:
    first, stop = mistake.rows or (0, len(motion.frames))
    camera = None if mistake.view is None else motion.pictures[mistake.view].name
    return {
        "kind": mistake.kind,
        "camera": camera,
        "frames": (motion.frames[first], motion.frames[stop - 1] + 1),
        "keypoints": [motion.names[j] for j in mistake.markers],
        "log_likelihood_ratio": mistake.ratio,
        "found": mistake.found,
        "mended": mistake.mended,
        "text": f"{camera}: {_text(motion, mistake)}"
        if camera and len(motion.pictures) > 1
        else _text(motion, mistake),
    }


def _text(motion: Motion, mistake: Mistake) -> str:
    found, where = mistake.found, _where(motion, mistake)
    told_by_file = mistake.ratio != mistake.ratio
    if mistake.kind == "sides":
        end = "exchanged back (--fix-swaps)" if mistake.mended else "--fix-swaps exchanges them back"
        verb = "were" if mistake.mended else "look"
        return f"left and right {verb} exchanged {where}, {_of_what(motion, mistake)}: {end}"
    if mistake.kind == "garbage":
        return f"the detections {where} are garbage, and left out"
    if mistake.kind == "normalised":
        return "the keypoints look like parts of the picture, from 0 to 1: multiply x by its width and y by its height"
    if mistake.kind == "y_up":
        return "the keypoints look as if y went up in the picture: take its height less y"
    if mistake.kind == "upside_down":
        return "the picture looks upside down: turn the keypoints, or the video, by 180 degrees"
    if mistake.kind == "smaller_video":
        return (
            f"the keypoints look as if found in a video {found:g} times smaller than the camera's picture: "
            f"multiply them by {found:g}, or give the calibration of that video"
        )
    if mistake.kind == "other_camera":
        camera = motion.pictures[mistake.view or 0].name
        if told_by_file:
            return f"the keypoint file's name says {found}, but the camera is {camera} (--camera-name)"
        return f"the keypoints look like those of {found} of the camera file, not of {camera} (--camera-name)"
    if told_by_file:
        return f"the keypoint file says {found:g} frames per second, but --fps is {motion.fps:g}"
    return f"the animal moves as if filmed at about {found:g} frames per second, not {motion.fps:g} (--fps)"


def _where(motion: Motion, mistake: Mistake) -> str:
    first, stop = mistake.rows or (0, len(motion.frames))
    if stop - first == len(motion.frames):
        return "in the whole clip"
    if stop - first == 1:
        return f"in frame {motion.frames[first]}"
    return f"in frames {motion.frames[first]} to {motion.frames[stop - 1]}"


def _of_what(motion: Motion, mistake: Mistake) -> str:
    names = [motion.names[j] for j in mistake.markers]
    return "of all keypoints" if len(names) > NAMED else ", ".join(names)
