"""Report the path, the heading, the animal's size, and how much of the pose comes from the video."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from recon.animal.prior import NONE as NO_PRIOR
from recon.base.arrays import mean, median
from recon.base.numbers import decimals, length_text, percent, plus_minus
from recon.fit.motion import MEASURED_FRACTION, Motion, trajectory_solution
from recon.fit.result import SolvedShape, TrajectorySolution
from recon.gait.kinematics import point_kinematics
from recon.gait.series import frame_jitter_m, jitter_errors
from recon.gait.spline import MIN_POINTS
from recon.show.plain import file_name, picked
from recon.show.sections.section import Line, camera_name

SIZE_SOURCES = {"views": "the positions of the cameras", "ground": "the camera's height above the ground"}
"""Descriptions of the measurements that can determine the animal's size."""


def root_path_data(motion: Motion) -> dict[str, Any]:
    """Return the path of the reference point, as fitted and smoothed.

    The smoothed path, without jitter from frame to frame, exists if each frame was solved separately and the jitter can
    be measured.
    """
    jitter, root, time_s = frame_jitter_m(motion.root_m), motion.root_name, motion.time_s
    names = "distance_m", "peak_speed_m_s", "mean_speed_m_s", "peak_acceleration_m_s2"
    exact = point_kinematics(time_s, motion.root_m, propagate=())
    smoothed = None
    if motion.solution.jitters and np.isfinite(jitter).all():
        path = point_kinematics(time_s, motion.root_m, jitter_errors(motion.root_m), smooth=True, propagate=())
        smoothed = {"smoothing_m": jitter, **picked(path, *names)}
    return {
        "joint": root,
        "keypoint": motion.names[motion.joints.index(root)] if root in motion.joints else None,
        "jitter_m": jitter,
        "exact": {"smoothing_m": None, **picked(exact, *names)},
        "smoothed": smoothed,
    }


def speed_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield a line with the mean speed and the distance of the reference point."""
    path = data["exact"]
    if path["mean_speed_m_s"] is None:
        yield "speed", f"none from fewer than {MIN_POINTS} frames"
        return
    mean_m_s, over_m = path["mean_speed_m_s"], path["distance_m"]
    yield "speed", f"{mean_m_s:{decimals(mean_m_s)}} m/s on average, over {over_m:{decimals(over_m)}} m"


def heading_data(motion: Motion) -> dict[str, Any]:
    """Return the horizontal direction in which the animal faces, as seen by the first camera."""
    (rear, front), solution = motion.forward, trajectory_solution(motion)
    joints, R = solution.joints_m, solution.views[0].T_camera_world[..., :3, :3]
    level = joints[:, front] - joints[:, rear]
    level[:, 2] = 0.0
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    right = R[..., 0, :] * [1.0, 1.0, 0.0]
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    ahead = np.cross([0.0, 0.0, 1.0], right)
    return {
        "heading_to_picture_rad": median(np.arcsin(np.clip(np.sum(level * ahead, axis=-1), -1.0, 1.0))),
        "sideslip_rad": solution.sideslip_rad if solution.sideslip_sigma_rad else None,
        "sideslip_sigma_rad": solution.sideslip_sigma_rad or None,
    }


def heading_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield a line with the direction in which the animal faces."""
    observer = f", as {camera_name(motion)} sees it" if len(motion.pictures) > 1 else ""
    yield "heading", heading_text(data["heading_to_picture_rad"]) + observer


def heading_text(angle_rad: float | None) -> str:
    """Return a sentence that states the angle between the animal's heading and the image plane in degrees.

    The angle is positive if the animal moves away from the camera. None stands for an unknown angle.
    """
    if angle_rad is None:
        return "unknown"
    if (degrees := round(math.degrees(angle_rad))) == 0:
        return "in the picture's plane"
    return f"{abs(degrees)}° out of the picture's plane, {'away from' if degrees > 0 else 'towards'} the camera"


def size_data(motion: Motion) -> dict[str, Any]:
    """Return the factor between the animal's lengths and the skeleton's, with its prior."""
    solution, subject = trajectory_solution(motion), motion.body.subject
    return {
        "factor": solution.size,
        "sigma": solution.size_sigma,
        "prior_sigma": solution.size_prior_sigma,
        "data_share": _size_share(solution),
        "from": solution.size_from,
        "subject": file_name(subject),
        "lengths": motion.title,
        "measured": bool(given_size(motion) or size_sources(solution)),
        "shape": _shape_data(solution.shape),
    }


def _shape_data(shape: SolvedShape | None) -> dict[str, Any] | None:
    """Return the number of estimated lengths, their median relative uncertainty, and the median keypoint offset."""
    if shape is None:
        return None
    return {
        "lengths": len(shape.names),
        "length_sigma": median(shape.lengths_sigma_m / shape.lengths_m),
        "keypoint_offset_m": median(np.linalg.norm(shape.offsets_m, axis=1)),
        "keypoint_offset_sigma_m": median(shape.offsets_sigma_m),
    }


def size_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield a line with the animal's size and its source."""
    sources, size_source = size_sources(trajectory_solution(motion)), given_size(motion)
    animal = data["lengths"].split(",")[0]
    if sources:
        factor = f"{plus_minus(data['factor'], data['sigma'])} times the skeleton ({size_source or animal})"
        yield "size", f"{factor}, by {' and '.join(sources)}"
    elif size_source:
        yield "size", f"as given ({size_source}), ±{percent(data['sigma'])}"
    else:
        spread = percent(data["prior_sigma"])
        yield "size", f"not measured: all metres and m/s assume average size ({animal}, ±{spread})"
    if (shape := data["shape"]) is not None:
        lengths = f"estimated with the pose, ±{percent(shape['length_sigma'])} (median of {shape['lengths']})"
        yield (
            "lengths",
            f"{lengths}; keypoints lie {length_text(shape['keypoint_offset_m'])} from the joints: shape.csv",
        )


def given_size(motion: Motion) -> str:
    """Return the option or file that states the animal's size, or an empty string for an animal of average size."""
    for name, option in (("height_m", "height at the withers, --height-m "), ("size", "--set size=")):
        if (value := motion.settings.get(name)) is not None:
            return f"{option}{value:g}"
    return file_name(motion.body.subject) or ""


def size_sources(solution: TrajectorySolution) -> list[str]:
    """Return the measurements that determine the animal's size better than the prior does."""
    is_measured = _size_share(solution) >= MEASURED_FRACTION
    return [SIZE_SOURCES[source] for source in solution.size_from if source in SIZE_SOURCES and is_measured]


def _size_share(solution: TrajectorySolution) -> float:
    return max(0.0, 1.0 - (solution.size_sigma / solution.size_prior_sigma) ** 2)


def prior_data(motion: Motion) -> dict[str, Any]:
    """Return the prior, with its misfit and weight in the segment that it fits worst."""
    solution = trajectory_solution(motion)
    misfits = [segment.prior_misfit for segment in solution.segments if segment.prior_misfit is not None]
    return {
        "name": file_name(solution.prior),
        "mean_data_share": mean(solution.data_share),
        "prior_misfit": max(misfits, default=None),
        "weight": min((segment.prior_weight for segment in solution.segments), default=1.0),
    }


def prior_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield lines with the fractions of the pose's precision due to video and prior, and on a missing learned prior."""
    name, fraction = data["name"], data["mean_data_share"]
    if name == NO_PRIOR:
        name = "the skeleton's own expectations"
        yield (
            "note",
            "Left-right swaps, lens, zoom and frame rate were not checked, because this needs a learned prior.",
        )
    if fraction is not None:
        yield "prior", f"{percent(fraction)} of the pose rests on the video, {percent(1 - fraction)} on {name}"
