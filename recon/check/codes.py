"""Every code of a finding: how serious it is, and its words. The only place where a finding becomes a sentence.

docs/findings.md says of each code what it means, what it does to the result, and what to do.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from recon.fit.finding import Finding, Severity
from recon.fit.motion import Motion

NAMED = 5
"""Up to so many names are listed in a sentence."""
SWAPPED, OUTLIERS = "left-right swap", "gross outliers"
"""Flags of frames in which one camera's detections are wrong."""
FLAG_OF: Mapping[str, str] = {
    "left_right_swap": SWAPPED,
    "gross_outliers": OUTLIERS,
}
"""Flags of frames, by the code of the finding that is about them."""
FLAGS: Mapping[str, str] = {
    "no data": "nothing was detected: the pose, if there is one, comes from the frames around",
    "ran away": "the best pose was out of the camera's sight, and the frame has none",
    "data poor": "few joints were seen and trusted",
    "ambiguous depth": "another pose, with near and far exchanged, explains it nearly as well",
    "second solution": "another pose explains it nearly as well",
    SWAPPED: "the detections look as if left and right were swapped",
    OUTLIERS: "the detections are not those of an animal",
}
"""What a flag of a frame means, in the order of a summary."""
_AXES = "A fit's pose3d.csv is in the frame of its camera unless the camera file says where that stands"
_AGAINST = "({error_px:.0f} px, {level:.1f} sigma)"

CODES: Mapping[str, tuple[Severity, str]] = {
    # of the input
    "gross_outliers": (
        "warning",
        "The detections {where} are gross outliers as a whole, as of an animal that has left the picture. They are "
        "left out.",
    ),
    "keypoints_normalised": (
        "error",
        "The keypoints look like parts of the picture, from 0 to 1. Multiply x by its width and y by its height.",
    ),
    "keypoints_y_up": (
        "error",
        "The keypoints look as if y went up in the picture. Take the picture's height less y.",
    ),
    "picture_upside_down": (
        "error",
        "The picture looks upside down. Turn the keypoints, or the video, by 180 degrees.",
    ),
    "smaller_video": (
        "error",
        "The keypoints look as if found in a video {times:g} times smaller than the camera's picture. Multiply them by "
        "{times:g}, or give the calibration of that video.",
    ),
    "other_camera_named": (
        "error",
        "The keypoint file's name says {other}, but the camera is {given}. Choose the camera with --camera-name.",
    ),
    "other_camera": (
        "error",
        "The keypoints look like those of {other} of the camera file, not of {given}. Choose the camera with "
        "--camera-name.",
    ),
    "left_right_swap": (
        "warning",
        "Left and right look swapped {where}, of {part}. --fix-swaps swaps them back.",
    ),
    "left_right_swap_mended": (
        "warning",
        "Left and right were swapped {where}, of {part}, and have been swapped back (--fix-swaps).",
    ),
    "frame_rate_stated": (
        "error",
        "The keypoint file says {other_hz:g} frames per second, but --fps is {given_hz:g}.",
    ),
    "frame_rate": (
        "error",
        "The animal moves as if filmed at about {other_hz:g} frames per second, not {given_hz:g}. Check --fps.",
    ),
    # of the whole fit
    "no_pose": ("error", "No frame has a pose: too few points were detected in every frame."),
    "no_pose_diverged": ("error", "No frame has a pose: the best poses were too far off to be seen."),
    # of several cameras
    "cameras_apart_in_time": (
        "error",
        "No two cameras see a point at the same time. Check --offset-s, and whether all files are of one clip.",
    ),
    "cameras_exchanged": (
        "error",
        f"{{cameras}} look as if their files were exchanged, or one of them of another clip {_AGAINST}.",
    ),
    "cameras_disagree": (
        "error",
        f"{{cameras}} do not agree with each other {_AGAINST}. Which of them is off, or of another clip, cannot be "
        "told.",
    ),
    "camera_turned": (
        "error",
        f"{{camera}} looks turned by about {{turn_deg:.1f}} degrees against the other cameras {_AGAINST}. Check its "
        "pose in the camera file.",
    ),
    "camera_late": (
        "error",
        f"{{camera}} looks {{late_frames:+.1f}} frames late against the other cameras {_AGAINST}. Its --offset-s would "
        "be {offset_s:.3f}.",
    ),
    "camera_off": (
        "error",
        f"{{camera}} does not agree with the other cameras {_AGAINST}, for a reason unknown.",
    ),
    "cameras_out_of_step": (
        "warning",
        "{cameras} look out of step, by {apart_frames:.1f} frames or more, or one of them is turned, or of another "
        "clip. --find-offsets measures it.",
    ),
    # of the motion
    "motion_unlike_prior": (
        "warning",
        "The motion is unlike those that the prior {prior} knows (misfit {misfit:.1f}, where 1 is usual and {limit:g} "
        "the limit). The prior has {weight:.0%} of its weight, and the uncertainty is larger. Check the frame rate and "
        "left and right first; a prior can be fitted to many such clips (recon prior fit).",
    ),
    "ground_above_camera": (
        "warning",
        "The ground comes out {height_m:.2f} ± {sigma_m:.2f} m above {camera}, which cannot be unless the animal runs "
        "higher up a slope. Check which way the camera looks (--tilt-deg, the camera file), then the size.",
    ),
    "frames_not_converged": ("warning", "{count} of {frames_total} frames did not converge."),
    "not_converged": ("warning", "The search ended before it had converged."),
    "size_unexpected": (
        "warning",
        "The size, {size:.2f}, is far from what is expected, 1 ± {expected_sigma:.2g}. Check the camera, the frame "
        "rate, the skeleton and whether all files are of one clip.",
    ),
    "too_fast": (
        "warning",
        "The animal has {speed_m_s:.0f} m/s, and none runs as fast. Check the frame rate, then the camera and the "
        "size.",
    ),
    "second_solution": (
        "warning",
        "Another solution explains {count} of {frames_total} frames nearly as well, up to {apart_m:.2f} m away.",
    ),
    "frames_diverged": (
        "warning",
        "{count} of {frames_total} frames have no pose: the best one was too far off to be seen.",
    ),
    "frames_stopped_early": (
        "warning",
        "{count} of {frames_total} frames stopped early: no pose explains their points.",
    ),
    "frames_without_pose": ("warning", "{count} of {frames_total} frames have no pose: too little was detected."),
    "frames_bridged": (
        "warning",
        "{count} of {frames_total} frames have no detections: their pose comes from the frames around.",
    ),
    "few_frames": (
        "warning",
        "A clip of {count} frames tells little of how the animal moves and where it steps: poses and positions are "
        "much less certain than with 20 or more.",
    ),
    "few_data": ("warning", "{count} of {frames_total} frames have few joints that are seen and trusted."),
    "keypoints_missing": ("warning", "The file lacks {keypoints}."),
    "many_outliers": ("warning", "{count} detections ({share:.0%}) do not agree with the pose."),
    "keypoint_does_not_fit": (
        "warning",
        "{share:.0%} of {keypoint}'s {used} detections disagree with the pose. Is it labelled at the right point?",
    ),
    "keypoints_do_not_fit": (
        "warning",
        "A third or more of the detections of {count} keypoints disagree with the pose: {keypoints}.",
    ),
    "at_range_limits": ("warning", "{count} of {frames_total} frames have angles beyond their expected ranges."),
    "pose_mostly_expected": (
        "warning",
        "The poses come from what is expected for the most part: {share:.0%} of their precision is the pixels'.",
    ),
    "scale_not_measured": (
        "warning",
        "The scale is not measured: all metres and m/s assume an animal of the expected size.",
    ),
    "camera_taken_level": (
        "warning",
        "The camera is taken to be level, as its file does not say which way is up (--tilt-deg).",
    ),
    "track_gaps": (
        "warning",
        "The camera's track has no pose for {count} of {frames_total} frames, whose detections are left out.",
    ),
    # of a reconstruction and its reference
    "reference_unlike": (
        "error",
        "Even turned as a whole, the poses are {left_mm:.0f} mm from the reference's, {share:.0%} of the animal's "
        "size, as those of different clips are. Check the clip, the animal, the numbers of the frames and the fit.",
    ),
    "reference_rotated": (
        "error",
        "One rotation of the whole clip, by {turn_deg:.0f}°, brings MPJPE from {error_mm:.1f} to {left_mm:.1f} mm: the "
        f"two are probably in different frames of reference. {_AXES}.",
    ),
    "reference_swapped": (
        "error",
        "Left swapped with right brings MPJPE from {error_mm:.1f} to {left_mm:.1f} mm: the sides of the two are "
        "probably named the other way round.",
    ),
    "reference_swapped_rotated": (
        "error",
        "Left swapped with right and one rotation of the whole clip bring MPJPE from {error_mm:.1f} to {left_mm:.1f} "
        "mm: the sides are probably named the other way round, and the two in different frames of reference. "
        f"{_AXES}.",
    ),
    "reference_mirrored": (
        "error",
        "A mirror image, rotated, brings MPJPE from {error_mm:.1f} to {left_mm:.1f} mm: one of the two probably has "
        "left-handed axes.",
    ),
    "reference_scaled": (
        "error",
        "One scale, by {factor:.2g}, brings MPJPE from {error_mm:.1f} to {left_mm:.1f} mm: the two are probably in "
        "different units.",
    ),
    "reference_scaled_rotated": (
        "error",
        "One scale and one rotation of the whole clip, by {factor:.2g}, bring MPJPE from {error_mm:.1f} to "
        f"{{left_mm:.1f}} mm: the two are probably in different units and frames of reference. {_AXES}.",
    ),
    "reference_elsewhere": (
        "error",
        "The two are about ({x_m:.2f}, {y_m:.2f}, {z_m:.2f}) m apart in all frames: they probably have different "
        "origins, or the animal's size, and with it its distance from the camera, is far off.",
    ),
    # nothing is wrong
    "camera_agreement": (
        "note",
        "{camera} is {error_px:.1f} px, {level:.1f} sigma, off the points that the other cameras see; up to "
        "{max_level:.1f} sigma agree.",
    ),
}
"""By code, the most serious first within an input, its cameras and its motion: severity, and the sentence with the
finding's numbers. `{where}` are its frames in words, `{x_deg}` the number x_rad in degrees."""


def finding(code: str, frames: tuple[int, int] | None = None, camera: str | None = None, **numbers: Any) -> Finding:
    """One of a known code, with its severity."""
    return Finding(code, CODES[code][0], frames, camera, numbers)


def ordered(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """In the order of `CODES`; those of one code stay as they come."""
    place = {code: i for i, code in enumerate(CODES)}
    return tuple(sorted(findings, key=lambda one: place[one.code]))


def sentence(one: Finding, named: bool = True) -> str:
    """A finding in words. named: cameras are called by their names, as where a clip has several."""
    words = CODES[one.code][1]
    given: dict[str, Any] = one.numbers
    values = {name: names_text(value) if isinstance(value, tuple) else value for name, value in given.items()}
    degrees = {f"{name[:-4]}_deg": math.degrees(value) for name, value in given.items() if name.endswith("_rad")}
    text = words.format(**values, **degrees, camera=one.camera if named else "the camera", where=_where(one.frames))
    return f"{one.camera}: {text}" if named and one.camera and "{camera}" not in words else text


def sentences(motion: Motion) -> Iterator[tuple[Finding, str]]:
    """Each of a motion's findings, with its words."""
    for one in motion.findings:
        yield one, sentence(one, named=len(motion.sources) > 1)


def names_text(names: Sequence[str]) -> str:
    """The first of them."""
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + more


def _where(frames: tuple[int, int] | None) -> str:
    if frames is None:
        return "in the whole clip"
    first, stop = frames
    return f"in frame {first}" if stop - first == 1 else f"in frames {first} to {stop - 1}"
