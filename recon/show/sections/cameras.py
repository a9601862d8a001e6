"""Report what each camera contributes to the result."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from recon.base.arrays import finite, mean, median
from recon.base.numbers import counted, length_text, plus_minus
from recon.fit.motion import Motion
from recon.fit.result import TrajectorySolution
from recon.show.plain import file_name, number
from recon.show.sections.keypoints import point_counts
from recon.show.sections.section import Line


def cameras_data(motion: Motion) -> list[dict[str, Any]]:
    """Return the report's entry for each camera, in the order of the keypoint files."""
    return [_camera_data(motion, index) for index in range(len(motion.pictures))]


def _camera_data(motion: Motion, index: int) -> dict[str, Any]:
    picture = motion.pictures[index]
    source, errors, poses = picture.source, finite(picture.distance_px), picture.source.poses
    return {
        "name": picture.name,
        "keypoints": file_name(source.keypoints.source),
        "camera": picture.camera.to_dict(),
        "offset_s": source.offset_s,
        "time_offset_frames": motion.solution.views[index].offset_frames - source.offset_frames,
        **_estimated(motion, index),
        "track": None if poses is None else {"frames_without_pose": int((~poses.known).sum())},
        "frames_seen": int(picture.present.any(axis=1).sum()),
        "points": point_counts(picture),
        "reprojection_px": {"mean": mean(errors), "median": median(errors)},
        "outliers": int(picture.outliers.sum()),
        "mean_weight": mean(picture.weight),
        "distance_m": mean(picture.distance_m),
        "notes": source.cleaning.notes,
    }


def _estimated(motion: Motion, index: int) -> dict[str, Any]:
    """Return the uncertainty of a camera's time offset, and its estimated pose correction and focal length factor."""
    solution = motion.solution
    if not isinstance(solution, TrajectorySolution):
        return {"time_offset_sigma_frames": 0.0, "extrinsic_correction": None, "focal": None}
    value, sigma = solution.extrinsic_correction[index], solution.extrinsic_correction_sigma[index]
    correction = {
        "turn_rad": value[:3],
        "turn_sigma_rad": sigma[:3],
        "shift_m": value[3:],
        "shift_sigma_m": sigma[3:],
    }
    focal_sigma = solution.focal_sigma[index]
    return {
        "time_offset_sigma_frames": solution.time_offset_sigma_frames[index],
        "extrinsic_correction": correction if sigma.any() else None,
        "focal": {"factor": math.exp(solution.focal[index]), "sigma": focal_sigma} if focal_sigma else None,
    }


def camera_lines(motion: Motion, data: list[dict[str, Any]]) -> Iterator[Line]:
    """Yield a line for each camera, unless there is only one."""
    for camera in data if len(data) > 1 else ():
        errors, points = camera["reprojection_px"], camera["points"]
        rejected = f", {points['rejected']} left out before the fit" if points["rejected"] else ""
        outliers = counted(camera["outliers"], "outlier")
        yield (
            "camera",
            f"{camera['name']}: {camera['frames_seen']} of {motion.clip_frames} frames, {points['used']} points used"
            f"{rejected}; {number(errors['mean'], '.1f')} px mean, {number(errors['median'], '.1f')} px median, "
            f"{outliers}; {number(camera['distance_m'], '.1f')} m away{_estimated_text(motion, camera)}",
        )


def _estimated_text(motion: Motion, camera: dict[str, Any]) -> str:
    text, sigma_frames = "", camera["time_offset_sigma_frames"]
    if motion.settings.get("find_offsets") and sigma_frames:
        later_s = camera["offset_s"] + camera["time_offset_frames"] / motion.fps
        text += f"; began {plus_minus(later_s, sigma_frames / motion.fps, 's')} later"
    if (correction := camera["extrinsic_correction"]) is not None:
        turn, turn_sigma = (math.degrees(np.linalg.norm(correction[name])) for name in ("turn_rad", "turn_sigma_rad"))
        shift = length_text(*(float(np.linalg.norm(correction[name])) for name in ("shift_m", "shift_sigma_m")))
        text += f"; turned by {plus_minus(turn, turn_sigma, '°')} and moved by {shift}"
    if (focal := camera["focal"]) is not None:
        text += f"; focal length {plus_minus(focal['factor'], focal['sigma'])} times the given one"
    return text
