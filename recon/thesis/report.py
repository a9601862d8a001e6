"""What the frame method has to say in report.json, summary and page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, fields
from typing import Any

import numpy as np

from recon.base.arrays import Array, finite, median
from recon.check import verdict_fields
from recon.fit.motion import MEASURED_SHARE, Motion
from recon.gait.clip import ClipAnalysis
from recon.geometry.frames import level_axes
from recon.show.plain import by_name, number, spread
from recon.show.sections import given
from recon.show.sections.section import Line, Section
from recon.thesis.frame import FrameOptions, FrameSolution, base_length, frame_solution


def _options(motion: Motion) -> FrameOptions:
    names = [field.name for field in fields(FrameOptions) if motion.settings.get(field.name) is not None]
    return FrameOptions(**{name: motion.settings[name] for name in names})


def skeleton(motion: Motion) -> dict[str, Any]:
    solution = frame_solution(motion)
    return given.skeleton(motion) | {"unknowns": solution.chain.state_names, "objectives": solution.objectives}


def assumptions(motion: Motion) -> dict[str, Any]:
    """What the data does not say, in numbers and in sentences."""
    base = _base_length(motion)
    scale = "It is not measured: distances, speeds and sizes scale with it."
    if base["measured"]:
        scale = f"The pixels give {base['data_share']:.0%} of its precision."
    sentences = [
        f"The scale: the base length has a prior of {base['nominal_m']:g} m with a standard deviation of "
        f"{base['sigma_m']:g} m. {scale}",
        *given.sentences(motion),
    ]
    if motion.settings.get("angle_prior") == "none":
        sentences.append("Without the Gaussian priors the pixels leave the depth of the limbs undetermined.")
    return {"base_length": base, **given.upright(motion), "sentences": sentences}


def _base_length(motion: Motion) -> dict[str, Any]:
    solution = frame_solution(motion)
    nominal, sigma = base_length(solution.chain, _options(motion))
    shares = [r.data_share[solution.chain.base_index] for r in solution.reports if r is not None]
    share = median(np.array(shares, dtype=float))
    return {"nominal_m": nominal, "sigma_m": sigma, "data_share": share, "measured": bool(share >= MEASURED_SHARE)}


def solver(motion: Motion) -> dict[str, Any]:
    solution, options = frame_solution(motion), _options(motion)
    nominal, sigma = base_length(solution.chain, options)
    of_chain = {"keypoint_sigma_m": solution.chain.scales.keypoint_m, "base_length_m": nominal, "base_sigma_m": sigma}
    return {name: of_chain.get(name) if value is None else value for name, value in asdict(options).items()}


def summary(motion: Motion) -> dict[str, Any]:
    solution = frame_solution(motion)
    sigma = _joint_sigma_camera_m(solution)
    return {
        "frames": len(motion.frames),
        "frames_with_pose": int(motion.solved.sum()),
        "frames_flagged": sum(bool(flags) for flags in motion.flags),
        **{f"frames_{s}": solution.status.count(s) for s in ("converged", "not_converged", "no_data")},
        "frames_diverged": sum("diverged" in flags for flags in motion.flags),
        **given.counts(motion),
        "joint_sigma_across_m": median(np.sqrt((sigma[..., :2] ** 2).mean(axis=-1))),
        "joint_sigma_depth_m": median(sigma[..., 2]),
        "iterations_median": median(solution.reported("iterations")),
        "function_evaluations_median": median(solution.reported("function_evaluations")),
    }


def summary_lines(motion: Motion, data: Any) -> Iterator[Line]:
    yield (
        "frames",
        f"{data['frames_converged']} of {data['frames']} converged, {data['frames_not_converged']} did not, "
        f"{data['frames_no_data']} without data",
    )
    across, depth = data["joint_sigma_across_m"], data["joint_sigma_depth_m"]
    yield (
        "uncertainty",
        f"{number(across, '.2f')} m across the picture, {number(depth, '.2f')} m in depth, size and distance included "
        "(one sigma)",
    )


def _joint_sigma_camera_m(solution: FrameSolution) -> Array:
    """(T, J, 3): standard deviations along the camera's x, y, z, given the frame before."""
    R = solution.views[0].rotation
    return np.sqrt(np.diagonal(R @ solution.covariance_m2 @ R.T, axis1=2, axis2=3))


def cost_shares(motion: Motion) -> dict[str, Any]:
    """Median over the frames with a pose that have the term."""
    solution = frame_solution(motion)
    solved = [r.cost_shares for r in solution.reports if r is not None and r.in_view]
    return {
        name: median(np.array([shares[name] for shares in solved if name in shares])) for name in solution.objectives
    }


def limits(motion: Motion) -> dict[str, Any]:
    solution = frame_solution(motion)
    beyond_rate = solution.beyond_rate_rad_s

    def passed(beyond: Array, largest: str) -> dict[str, Any]:
        rows = [
            {"passed": int((column > 0).sum()), largest: float(np.max(finite(column), initial=0.0))}
            for column in beyond.T
        ]
        return by_name(solution.chain.angle_names, rows)

    return {
        "frames": int(motion.solved.sum()),
        "intervals": int(np.isfinite(beyond_rate).any(axis=1).sum()),
        "ranges": passed(solution.beyond_range_rad, "largest_excess_rad"),
        "rates": passed(beyond_rate, "largest_excess_rad_s"),
    }


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
    yield "path", _path_text(motion, speed is not None)
    yield "heading", given.heading_text(data["heading_to_picture_rad"])


def _path_text(motion: Motion, has_speed: bool) -> str:
    root, frame = given.root_path(motion), f"{motion.frame_of_reference} frame"
    path = root["smoothed"] or root["exact"]
    if (doubt := ClipAnalysis(motion).why_no_speed) is not None:
        return f"too uncertain in depth for its speed ({frame}): {doubt}{'; take the speed above' if has_speed else ''}"
    how = "smoothed" if root["smoothed"] else "not smoothed"
    far, peak = (number(path[name], ".1f") for name in ("distance_m", "peak_speed_m_s"))
    return f"{far} m, peak {peak} m/s ({frame}, {how})"


def base_length_m(motion: Motion) -> dict[str, float]:
    solution = frame_solution(motion)
    return spread(solution.chain_states[:, solution.chain.base_index])


def size_lines(motion: Motion, data: Any) -> Iterator[Line]:
    base = _base_length(motion)
    share = number(base["data_share"], ".0%").lstrip("-")
    yield (
        "size",
        f"base length {number(data['mean'], '.3f')} m; expected {base['nominal_m']:.3f} ± {base['sigma_m']:.3f} m; "
        f"{share} of its precision from pixels",
    )


def effort_lines(motion: Motion, data: Any) -> Iterator[Line]:
    """How much work the fit was, by the optimiser's own counts."""
    solution, timing = frame_solution(motion), motion.timing_s
    text = f"{number(median(solution.reported('iterations')), '.0f')} iterations a frame (median)"
    if "solve_s" in timing:
        times = median(solution.reported("solve_s"))
        each = f", {1000 * times:.0f} ms a frame (median)" if np.isfinite(times) else ""
        text += f"{each}; {timing['solve_s']:.1f} s with reading"
    yield "effort", text


SECTIONS: tuple[Section, ...] = (
    Section("verdict", verdict_fields, given.verdict_lines),
    Section("input", given.clip, given.clip_lines),
    Section("side", given.side, given.side_lines),
    Section("frame_of_reference", lambda motion: motion.frame_of_reference),
    Section("skeleton", skeleton),
    Section("assumptions", assumptions),
    Section("solver", solver),
    Section("summary", summary, summary_lines),
    Section("unused_keypoints", lambda motion: motion.unused_keypoints),
    Section("missing_keypoints", lambda motion: motion.missing_keypoints),
    Section("keypoints", given.keypoints, given.keypoint_lines),
    Section("cameras", given.cameras, given.camera_lines),
    Section("cleaning", given.cleaning, given.note_lines),
    Section("root_path", given.root_path),
    Section("travel", travel, travel_lines),
    Section("size", lambda motion: {"factor": motion.solution.size}),
    Section("base_length_m", base_length_m, size_lines),
    Section("angles", given.angles),
    Section("cost_shares", cost_shares),
    Section("limits", limits, effort_lines),
)
"""In the order of the summary."""
