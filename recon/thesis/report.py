"""Write the frame method's sections of report.json, the summary and the page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from recon.base.arrays import median
from recon.base.numbers import percent
from recon.fit.motion import MEASURED_FRACTION, Motion
from recon.gait.clip import ClipAnalysis
from recon.gait.stances import interval_text
from recon.geometry.frames import level_axes
from recon.show.plain import number, spread
from recon.show.report import SECTIONS as TRAJECTORY_SECTIONS
from recon.show.sections.inputs import assumption_sentences, skeleton_data, upright_data
from recon.show.sections.keypoints import counts
from recon.show.sections.motion import heading_text, root_path_data
from recon.show.sections.section import Line, Section
from recon.thesis.objectives import FrameOptions, base_length
from recon.thesis.solution import frame_solution


def skeleton(motion: Motion) -> dict[str, Any]:
    """Return report.json's section on the skeleton, the unknowns and the objectives."""
    solution = frame_solution(motion)
    return skeleton_data(motion) | {"unknowns": solution.chain.state_names, "objectives": solution.objectives}


def assumptions(motion: Motion) -> dict[str, Any]:
    """Return the assumptions of the frame method as numbers and as sentences."""
    base = _base_length(motion)
    scale = "The clip does not measure this length: distances, speeds and sizes are proportional to it."
    if base["measured"]:
        scale = f"The pixels contribute {percent(base['data_share'])} of the precision of this length."
    sentences = [
        f"The scale comes from a prior on the base length: {base['nominal_m']:g} ± {base['sigma_m']:g} m. {scale}",
        *assumption_sentences(motion),
    ]
    if motion.settings.get("angle_prior") == "none":
        sentences.append("The Gaussian priors are off: the pixels alone do not determine the depth of the limbs.")
    return {"base_length": base, **upright_data(motion), "sentences": sentences}


def _base_length(motion: Motion) -> dict[str, Any]:
    solution = frame_solution(motion)
    nominal, sigma = base_length(solution.chain, FrameOptions.from_settings(motion.settings))
    fraction = median([r.data_share[solution.chain.base_index] for r in solution.reports if r is not None])
    return {
        "nominal_m": nominal,
        "sigma_m": sigma,
        "data_share": fraction,
        "measured": bool(fraction >= MEASURED_FRACTION),
    }


def summary(motion: Motion) -> dict[str, Any]:
    """Return the number of frames with each status, the uncertainty of the joints, and the solver's effort."""
    solution = frame_solution(motion)
    R = solution.views[0].rotation
    variance = np.diagonal(R @ solution.covariance_m2 @ R.T, axis1=2, axis2=3)  # along the camera's x, y, z
    return {
        "frames": len(motion.frames),
        "frames_with_pose": int(motion.solved.sum()),
        "frames_flagged": sum(bool(flags) for flags in motion.flags),
        **{f"frames_{s}": solution.status.count(s) for s in ("converged", "not_converged", "no_data")},
        "frames_diverged": sum("diverged" in flags for flags in motion.flags),
        **counts(motion),
        "joint_sigma_across_m": median(np.sqrt(variance[..., :2].mean(axis=-1))),
        "joint_sigma_depth_m": median(np.sqrt(variance[..., 2])),
        "iterations_median": median(solution.reported("iterations")),
        "function_evaluations_median": median(solution.reported("function_evaluations")),
    }


def summary_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield the lines on solved frames, uncertainty, iterations and time for the summary that a fit prints."""
    yield (
        "frames",
        f"{data['frames_converged']} of {data['frames']} converged, {data['frames_not_converged']} did not, "
        f"{data['frames_no_data']} without data",
    )
    across, depth = (number(data[f"joint_sigma_{direction}_m"], ".2f") for direction in ("across", "depth"))
    size = "including size and distance (one standard deviation)"
    yield "uncertainty", f"±{across} m across the view, ±{depth} m in depth, {size}"
    text, timing = f"{number(data['iterations_median'], '.0f')} iterations per frame (median)", motion.timing_s
    if "solve_s" in timing:
        times = median(frame_solution(motion).reported("solve_s"))
        per_frame = f", {1000 * times:.0f} ms per frame (median)" if np.isfinite(times) else ""
        text += f"{per_frame}; {timing['solve_s']:.1f} s in total"
    yield "effort", text


def travel(motion: Motion) -> dict[str, Any]:
    """Return the heading and speed of the straight run from which the search started."""
    run = frame_solution(motion).travel
    _, into_picture = level_axes(motion.camera.up)
    to_picture = np.arcsin(np.clip(run.heading @ into_picture, -1.0, 1.0))
    moving = run.speed_m_s > 0
    return {
        "heading_to_picture_rad": median(to_picture[moving] if moving.any() else to_picture),
        "median_speed_m_s": median(run.speed_m_s[moving]),
    }


def travel_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield the lines on speed, path and heading for the summary that a fit prints."""
    run_m_s = data["median_speed_m_s"]
    if (reason := motion.derived(ClipAnalysis).why_no_speed) is None:
        path = motion.derived(ClipAnalysis).reference_motion
        peak = interval_text(path.peak_speed_m_s, path.peak_speed_sigma_m_s, "m/s", least=0.0)
        yield "speed", f"at most {peak}, over a path of {number(path.distance_m, '.1f')} m"
    elif run_m_s is None:
        yield "speed", f"unknown from this camera: {reason}"
    else:
        run = f"about {number(run_m_s, '.0f')} m/s if the animal ran straight"
        yield "speed", f"{run}; not known more closely: {reason}"
    yield "heading", heading_text(data["heading_to_picture_rad"])


def size_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield the line on the base length, which scales all links, for the summary that a fit prints."""
    base = _base_length(motion)
    fraction = number(100 * base["data_share"], ".0f").lstrip("-")
    expected = f"expected {base['nominal_m']:.3f} ± {base['sigma_m']:.3f} m"
    yield "size", f"base length {number(data['mean'], '.3f')} m; {expected}; {fraction} % of its precision from pixels"


_OWN = {
    "skeleton": Section("skeleton", skeleton),
    "assumptions": Section("assumptions", assumptions),
    "summary": Section("summary", summary, summary_lines),
    "root_path": Section("root_path", root_path_data),
    "heading": Section("travel", travel, travel_lines),
    "size": Section("size", lambda motion: {"factor": motion.solution.size}),
    "prior": Section(
        "base_length_m", lambda motion: spread(frame_solution(motion).unknown("base_length_m")), size_lines
    ),
}
"""Sections that replace sections of the same name in the trajectory method's report."""
_WITHOUT = ("detector", "segments", "stances", "alternative", "convergence")
SECTIONS = tuple(_OWN.get(section.name, section) for section in TRAJECTORY_SECTIONS if section.name not in _WITHOUT)
"""Sections of the frame method's report, in the order of the summary."""
