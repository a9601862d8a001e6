"""What the frame method has to say in report.json, summary and page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from recon.base.arrays import median
from recon.check import verdict_fields
from recon.fit.motion import MEASURED_SHARE, Motion
from recon.gait.clip import ClipAnalysis
from recon.geometry.frames import level_axes
from recon.show import sections
from recon.show.plain import number, spread
from recon.show.sections import Line, Section
from recon.wings.thesis.frame import FrameOptions, base_length, frame_solution


def skeleton(motion: Motion) -> dict[str, Any]:
    solution = frame_solution(motion)
    return sections.skeleton(motion) | {"unknowns": solution.chain.state_names, "objectives": solution.objectives}


def assumptions(motion: Motion) -> dict[str, Any]:
    """What the data does not say, in numbers and in sentences."""
    base = _base_length(motion)
    scale = "It is not measured: distances, speeds and sizes scale with it."
    if base["measured"]:
        scale = f"The pixels give {base['data_share']:.0%} of its precision."
    sentences = [
        f"The scale: the base length has a prior of {base['nominal_m']:g} m with a standard deviation of "
        f"{base['sigma_m']:g} m. {scale}",
        *sections.sentences(motion),
    ]
    if motion.settings.get("angle_prior") == "none":
        sentences.append("Without the Gaussian priors the pixels leave the depth of the limbs undetermined.")
    return {"base_length": base, **sections.upright(motion), "sentences": sentences}


def _base_length(motion: Motion) -> dict[str, Any]:
    solution = frame_solution(motion)
    nominal, sigma = base_length(solution.chain, FrameOptions.of(motion.settings))
    share = median([r.data_share[solution.chain.base_index] for r in solution.reports if r is not None])
    return {"nominal_m": nominal, "sigma_m": sigma, "data_share": share, "measured": bool(share >= MEASURED_SHARE)}


def summary(motion: Motion) -> dict[str, Any]:
    solution = frame_solution(motion)
    R = solution.views[0].rotation
    variance = np.diagonal(R @ solution.covariance_m2 @ R.T, axis1=2, axis2=3)  # along the camera's x, y, z
    return {
        "frames": len(motion.frames),
        "frames_with_pose": int(motion.solved.sum()),
        "frames_flagged": sum(bool(flags) for flags in motion.flags),
        **{f"frames_{s}": solution.status.count(s) for s in ("converged", "not_converged", "no_data")},
        "frames_diverged": sum("diverged" in flags for flags in motion.flags),
        **sections.counts(motion),
        "joint_sigma_across_m": median(np.sqrt(variance[..., :2].mean(axis=-1))),
        "joint_sigma_depth_m": median(np.sqrt(variance[..., 2])),
        "iterations_median": median(solution.reported("iterations")),
        "function_evaluations_median": median(solution.reported("function_evaluations")),
    }


def summary_lines(motion: Motion, data: Any) -> Iterator[Line]:
    yield (
        "frames",
        f"{data['frames_converged']} of {data['frames']} converged, {data['frames_not_converged']} did not, "
        f"{data['frames_no_data']} without data",
    )
    across, depth = (number(data[f"joint_sigma_{way}_m"], ".2f") for way in ("across", "depth"))
    size = "size and distance included (one sigma)"
    yield "uncertainty", f"{across} m across the picture, {depth} m in depth, {size}"
    text, timing = f"{number(data['iterations_median'], '.0f')} iterations a frame (median)", motion.timing_s
    if "solve_s" in timing:
        times = median(frame_solution(motion).reported("solve_s"))
        each = f", {1000 * times:.0f} ms a frame (median)" if np.isfinite(times) else ""
        text += f"{each}; {timing['solve_s']:.1f} s with reading"
    yield "effort", text


def travel(motion: Motion) -> dict[str, Any]:
    found = frame_solution(motion).travel
    _, away = level_axes(motion.camera.up)
    to_picture = np.arcsin(np.clip(found.heading @ away, -1.0, 1.0))
    moving = found.speed_m_s > 0
    return {
        "heading_to_picture_rad": median(to_picture[moving] if moving.any() else to_picture),
        "median_speed_m_s": median(found.speed_m_s[moving]),
    }


def travel_lines(motion: Motion, data: Any) -> Iterator[Line]:
    speed = data["median_speed_m_s"]
    known = f"{number(speed, '.1f')} m/s, of a straight run through all frames"
    yield "speed", "not told by a path this short or slow" if speed is None else known
    root, frame = sections.root_path(motion), f"{motion.frame_of_reference} frame"
    if (doubt := ClipAnalysis(motion).why_no_speed) is not None:
        above = "; take the speed above" if speed is not None else ""
        yield "path", f"too uncertain in depth for its speed ({frame}): {doubt}{above}"
    else:
        path, how = root["smoothed"] or root["exact"], "smoothed" if root["smoothed"] else "not smoothed"
        far, peak = (number(path[name], ".1f") for name in ("distance_m", "peak_speed_m_s"))
        yield "path", f"{far} m, peak {peak} m/s ({frame}, {how})"
    yield "heading", sections.heading_text(data["heading_to_picture_rad"])


def size_lines(motion: Motion, data: Any) -> Iterator[Line]:
    base = _base_length(motion)
    share = number(base["data_share"], ".0%").lstrip("-")
    expected = f"expected {base['nominal_m']:.3f} ± {base['sigma_m']:.3f} m"
    yield "size", f"base length {number(data['mean'], '.3f')} m; {expected}; {share} of its precision from pixels"


SECTIONS: tuple[Section, ...] = (
    Section("verdict", verdict_fields, sections.verdict_lines),
    Section("input", sections.clip, sections.clip_lines),
    Section("side", sections.side, sections.side_lines),
    Section("frame_of_reference", lambda motion: motion.frame_of_reference),
    Section("skeleton", skeleton),
    Section("assumptions", assumptions),
    Section("summary", summary, summary_lines),
    Section("unused_keypoints", lambda motion: motion.unused_keypoints),
    Section("missing_keypoints", lambda motion: motion.missing_keypoints),
    Section("keypoints", sections.keypoints, sections.keypoint_lines),
    Section("cameras", sections.cameras, sections.camera_lines),
    Section("cleaning", sections.cleaning, sections.note_lines),
    Section("root_path", sections.root_path),
    Section("travel", travel, travel_lines),
    Section("size", lambda motion: {"factor": motion.solution.size}),
    Section("base_length_m", lambda motion: spread(frame_solution(motion).unknown("base_length_m")), size_lines),
)
"""In the order of the summary."""
