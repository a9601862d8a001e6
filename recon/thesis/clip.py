"""One clip by the frame method: a keypoint file and a camera in, the motion of one side of the animal out;
and what is said of it in report.json, summary and page.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import numpy as np
from rich.console import Console

from recon.animal.body import Body
from recon.animal.chain import load_chain
from recon.base import Progress, silent
from recon.base.arrays import median
from recon.check import judged
from recon.clip import views_of
from recon.fit.motion import MEASURED_SHARE, Motion
from recon.gait.clip import ClipAnalysis
from recon.geometry.frames import level_axes
from recon.show import report as sections
from recon.show.plain import number, spread
from recon.show.report import Line, Section
from recon.thesis.frame import FrameOptions, base_length, frame_solution, solve_frames
from recon.workflows.cli import Answer, OptionsOf
from recon.workflows.clip import prepare
from recon.workflows.fit import FitRunSettings, fit
from recon.workflows.settings import SETTINGS, FitSettings

_OPTIONS = tuple(name for name, info in SETTINGS.items() if name != "method" and info.option.method in (None, "frame"))


def fit_clip(settings: FitSettings, progress: Progress = silent) -> Motion:
    """Reconstruct one side of the animal as a chain, one frame after the other.

    Raises InputError for files and settings that cannot be used, with the problems of all of them. Frames that cannot
    be solved are part of the result.
    """
    given, chain, plain = prepare(settings), load_chain(settings.skeleton_name), settings.plain()
    (view,), T = views_of(given.sources), len(given.sources[0].keypoints.frames)
    options = FrameOptions.of(plain)
    solution = solve_frames(view, chain, given.fps, options, lambda done: progress("frames", done / T))
    return judged(Motion(given.sources, given.side, given.side_reason, solution, chain=chain, settings=plain))


def load_body(settings: FitSettings) -> Body:
    """The animal of the settings' chain. Raises InputError for a skeleton that is no chain."""
    return load_chain(settings.skeleton_name).body


def frame(
    settings: FitRunSettings,
    given: Annotated[dict[str, Any], OptionsOf(FitSettings, _OPTIONS)],
    console: Console,
    progress: Progress,
) -> Answer:
    """The thesis' method, to compare with: one side of the animal as a chain, one frame after the other.

    Example: recon frame clip.csv --camera scene.json --camera-name cam2 --fps 90 --out results/clip

    Exit code 0: done. 1: no frame could be solved. 2: the input cannot be used.
    """
    return fit(settings, {**given, "method": "frame"}, console, progress)


# -- what it has to say in report.json, summary and page ---------------------------------------------------------------


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


_OWN = {
    "skeleton": Section("skeleton", skeleton),
    "assumptions": Section("assumptions", assumptions),
    "summary": Section("summary", summary, summary_lines),
    "root_path": Section("root_path", sections.root_path),
    "heading": Section("travel", travel, travel_lines),
    "size": Section("size", lambda motion: {"factor": motion.solution.size}),
    "prior": Section("base_length_m", lambda of: spread(frame_solution(of).unknown("base_length_m")), size_lines),
}
"""Sections in place of those of the trajectory method."""
_WITHOUT = ("detector", "segments", "stances", "alternative", "convergence")
SECTIONS = tuple(_OWN.get(one.name, one) for one in sections.SECTIONS if one.name not in _WITHOUT)
"""In the order of the summary."""
