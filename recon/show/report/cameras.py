"""What each camera of a clip has to do with the result."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.arrays import Array, finite, mean, median
from recon.clip import Source
from recon.fit import TrajectorySolution
from recon.fit.motion import Motion, Picture
from recon.show.report.plain import file_name, number


def section(motion: Motion) -> list[dict[str, Any]]:
    """An entry a camera, in the order of the keypoint files."""
    solution = motion.solution
    late = [view.lead_frames - s.lead_frames for view, s in zip(solution.views, motion.sources, strict=True)]
    if not isinstance(solution, TrajectorySolution):
        return [_entry(picture, lag, 0.0, None, None) for picture, lag in zip(motion.pictures, late, strict=True)]
    placings = map(_placing, solution.placing, solution.placing_sigma)
    focals = map(_focal, solution.focal, solution.focal_sigma)
    return [_entry(*of) for of in zip(motion.pictures, late, solution.lag_sigma_frames, placings, focals, strict=True)]


def _focal(logarithm: float, sigma: float) -> dict[str, float] | None:
    """By what factor focal lengths are longer than given, and its standard deviation; None where it was not sought."""
    return {"factor": math.exp(logarithm), "sigma": sigma} if sigma else None


def _placing(found: Array, sigma: Array) -> dict[str, Any] | None:
    """How far a camera was beside the pose that was given, and standard deviations; None where that was not sought."""
    if not sigma.any():
        return None
    return {"turn_rad": found[:3], "turn_sigma_rad": sigma[:3], "shift_m": found[3:], "shift_sigma_m": sigma[3:]}


def _entry(
    picture: Picture,
    lag_frames: float,
    lag_sigma_frames: float,
    placing: dict[str, Any] | None,
    focal: dict[str, float] | None,
) -> dict[str, Any]:
    source, errors = picture.source, finite(picture.distance_px)
    names = set(source.keypoints.names)
    used = int(picture.present.sum())
    rejected = sum(counted.rejected for counted in source.cleaning.keypoints if counted.name in names)
    return {
        "name": picture.name,
        "keypoints": file_name(source.keypoints.source),
        "camera": picture.camera.to_dict(),
        "offset_s": source.offset_s,
        "lag_frames": lag_frames,
        "lag_sigma_frames": lag_sigma_frames,
        "placing": placing,
        "focal": focal,
        "track": _track(source),
        "frames_seen": int(picture.present.any(axis=1).sum()),
        "points": {"used": used, "missing": max(picture.present.size - used - rejected, 0), "rejected": rejected},
        "reprojection_px": {"mean": mean(errors), "median": median(errors)},
        "outliers": int(picture.outliers.sum()),
        "mean_weight": mean(picture.weight),
        "noise_px": [mean(of_joint) for of_joint in picture.sigma_px.T],
        "distance_m": mean(picture.distance_m),
        "notes": source.cleaning.notes,
    }


def _track(source: Source) -> dict[str, Any] | None:
    """Where a camera was that moves: X_camera = R X_world + t."""
    if source.poses is None:
        return None
    poses = source.poses.T_camera_world
    return {
        "frames_without_pose": int((~source.poses.known).sum()),
        "rotation": poses[:, :3, :3],
        "translation_m": poses[:, :3, 3],
        "intrinsics_px": source.poses.intrinsics_px,
    }


def stacked(motion: Motion, field: str) -> Array:
    """(V, T, J, ...): a field of all cameras' pictures."""
    return np.stack([getattr(picture, field) for picture in motion.pictures])


def points(report: Mapping[str, Any]) -> dict[str, int]:
    """Of all cameras."""
    each = [camera["points"] for camera in report["cameras"]]
    return {count: sum(of_one[count] for of_one in each) for count in ("used", "missing", "rejected")}


def notes(report: Mapping[str, Any]) -> list[str]:
    """What had to be decided about the files when they were read; of several cameras, what is alike is said once."""
    return list(dict.fromkeys(note for camera in report["cameras"] for note in camera["notes"]))


def called(name: str, report: Mapping[str, Any]) -> str:
    """What a sentence of the summary calls a camera."""
    return name if len(report["cameras"]) > 1 else "the camera"


def files(report: Mapping[str, Any]) -> str:
    """The keypoint files' names."""
    paths = [camera["keypoints"] for camera in report["cameras"]]
    return ", ".join(Path(path).name if path else "keypoints" for path in paths)


def lines(report: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """For the summary, where there are several."""
    frames = report["summary"]["frames"]
    for camera in report["cameras"] if len(report["cameras"]) > 1 else ():
        errors, counts = camera["reprojection_px"], camera["points"]
        outliers = "1 outlier" if camera["outliers"] == 1 else f"{camera['outliers']} outliers"
        rejected = f", {counts['rejected']} rejected" if counts["rejected"] else ""
        yield (
            "camera",
            f"{camera['name']}: {camera['frames_seen']} of {frames} frames, {counts['used']} points used"
            f"{rejected}; {number(errors['mean'], '.1f')} px mean, "
            f"{number(errors['median'], '.1f')} px median, {outliers}; "
            f"{number(camera['distance_m'], '.1f')} m away{_found_text(camera, report)}",
        )


def _found_text(camera: Mapping[str, Any], report: Mapping[str, Any]) -> str:
    """What was sought of a camera besides the animal."""
    text, fps, sigma_frames = "", report["input"]["fps"], camera["lag_sigma_frames"]
    if report["solver"].get("find_offsets") and sigma_frames:
        later_s = camera["offset_s"] + camera["lag_frames"] / fps
        text += f"; began {later_s:.4f} ± {sigma_frames / fps:.4f} s later"
    if (placing := camera["placing"]) is not None:
        turn, turn_sigma = (math.degrees(np.linalg.norm(placing[name])) for name in ("turn_rad", "turn_sigma_rad"))
        shift, shift_sigma = (100 * float(np.linalg.norm(placing[name])) for name in ("shift_m", "shift_sigma_m"))
        text += f"; turned by {turn:.1f} ± {turn_sigma:.1f}° and moved by {shift:.0f} ± {shift_sigma:.0f} cm"
    if (focal := camera["focal"]) is not None:
        text += f"; focal length times {focal['factor']:.3f} ± {focal['sigma']:.3f}"
    return text
