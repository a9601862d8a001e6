"""Report how many frames have a pose, and what the search could not decide."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from recon.base.arrays import finite, mean, median
from recon.base.numbers import counted, length_text, plus_minus
from recon.check.codes import FLAGS
from recon.check.verdict import frame_rms_m
from recon.fit.motion import Motion, trajectory_solution
from recon.show.sections.keypoints import counts
from recon.show.sections.section import Line, camera_name

CONVERGENCE = ("status", "iterations", "cost_by_term")
"""Attributes of a solution that describe how the search ended."""
HARDLY_KNOWN = 0.1
"""Relative standard deviation of the distance from the camera above which the summary states it."""


def summary_data(motion: Motion) -> dict[str, Any]:
    """Return the numbers of frames, flags, keypoints and detections, and the joints' uncertainty."""
    flags = dict.fromkeys((*FLAGS, *(flag for flags in motion.flags for flag in flags)))
    return {
        "frames": motion.clip_frames,
        "frames_left_out": motion.clip_frames - len(motion.frames),
        "frames_with_pose": int(motion.solved.sum()),
        "frames_flagged": sum(bool(flags) for flags in motion.flags),
        "flags": {flag: sum(flag in frame_flags for frame_flags in motion.flags) for flag in flags},
        **counts(motion),
        "mean_weight": mean(motion.solution.weight),
        "place_sigma_m": median(motion.place_sigma_m),
        "relative_rms_m": median(frame_rms_m(motion)),
    }


def summary_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield lines with the numbers of solved and flagged frames, and the camera's distance if it is hardly known."""
    reasons = [f"{count} {flag}" for flag, count in data["flags"].items() if count]
    several = "some for several reasons: " if sum(data["flags"].values()) > data["frames_flagged"] else ""
    flagged = f"{data['frames_flagged']} flagged ({several}{', '.join(reasons)})" if reasons else "none flagged"
    left_out = data["frames_left_out"]
    note = f"; {left_out} left out of all tables, because they are far from all detections" if left_out else ""
    yield "frames", f"{data['frames_with_pose']} of {data['frames']} with a pose, {flagged}{note}"
    sigma_m, distances = data["place_sigma_m"], [mean(picture.distance_m) for picture in motion.pictures]
    by_camera = [(away_m, camera_name(motion, v)) for v, away_m in enumerate(distances) if math.isfinite(away_m)]
    away_m, camera = min(by_camera, default=(math.inf, ""))
    if sigma_m is not None and sigma_m > HARDLY_KNOWN * away_m:
        is_size_known = trajectory_solution(motion).size_sigma <= HARDLY_KNOWN / 2
        reason = "the pictures hardly determine it" if is_size_known else "as uncertain as the animal's size"
        yield "distance", f"{plus_minus(away_m, sigma_m, 'm')} from {camera}: {reason}"


def alternative_data(motion: Motion) -> dict[str, Any] | None:
    """Return the distance of a second solution from the pose and its additional cost, or None if there is none."""
    apart_m = finite(motion.alternative_m)
    if not len(apart_m):
        return None
    return {
        "cost_difference": trajectory_solution(motion).alternative_cost,
        "frames": len(apart_m),
        "mean_m": apart_m.mean(),
        "max_m": apart_m.max(),
    }


def alternative_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield a line that states whether another pose fits the video equally well."""
    if data is None:
        text = "no other pose fits nearly as well"
    elif not any(finding.code == "second_solution" for finding in motion.findings):
        text = f"a second solution differs by {length_text(data['mean_m'])} only"
    else:
        frames = counted(data["frames"], "frame")
        text = f"another pose, {length_text(data['mean_m'])} away on average in {frames}, fits "
        text += (
            "equally well; the data cannot decide which is right" if data["cost_difference"] < 1 else "nearly as well"
        )
    yield "alternative", text


def convergence_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield a line if the search has not converged."""
    if data["status"] != "converged":
        yield "search", f"not converged after {data['iterations']} iterations, so the pose may be far off"
