"""The report of the frame method."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from recon.base.arrays import Array, finite, mean, median
from recon.fit.motion import Motion
from recon.fit.results import MEASURED_SHARE
from recon.gait.kinematics import peak_doubt
from recon.geometry.frames import level_axes
from recon.show.report import common
from recon.show.report.plain import by_name, number, spread
from recon.thesis.frame import FrameOptions, FrameReport, FrameSolution, base_length


def sections(motion: Motion, settings: Mapping[str, Any]) -> dict[str, Any]:
    solution = motion.solution
    assert isinstance(solution, FrameSolution)
    published = {"unknowns": solution.chain.state_names, "objectives": solution.objectives}
    return {
        **common.head(motion),
        "skeleton": common.skeleton(motion) | published,
        "assumptions": _assumptions(motion, solution, settings),
        "summary": _summary(motion, solution),
        "solver": _solver(solution, settings),
        "size": {"factor": solution.size},
        "base_length_m": spread(solution.chain_states[:, solution.chain.base_index]),
        "data_share": _data_share(motion, solution),
        "angles": common.angles(motion),
        "joint_sigma_m": _joint_sigma(motion, solution),
        "cost_shares": _cost_shares(solution),
        "limits": _limits(motion, solution),
        "travel": _travel(motion, solution),
        "frames": _frames(motion, solution),
        **common.tail(motion),
    }


def is_unsolved(report: Mapping[str, Any]) -> bool:
    return report["summary"]["frames_converged"] == 0


# -- sections -----------------------------------------------------------------------------------------------------


def _assumptions(motion: Motion, solution: FrameSolution, settings: Mapping[str, Any]) -> dict[str, Any]:
    """What the data does not say, in numbers and in sentences."""
    nominal, sigma = base_length(solution.chain, common.given_options(FrameOptions, settings))
    share = median(_field_of_frames(solution, "data_share", solution.chain.n_state)[:, solution.chain.base_index])
    measured = bool(share >= MEASURED_SHARE)
    sentences = [
        f"The scale: the base length has a prior of {nominal:g} m with a standard deviation of {sigma:g} m. "
        + (
            f"The pixels give {share:.0%} of its precision."
            if measured
            else "It is not measured: distances, speeds and sizes scale with it."
        ),
        *common.sentences(motion, settings),
    ]
    if settings.get("angle_prior") == "none":
        sentences.append("Without the Gaussian priors the pixels leave the depth of the limbs undetermined.")
    return {
        "base_length": {"nominal_m": nominal, "sigma_m": sigma, "data_share": share, "measured": measured},
        **common.upright(motion),
        "sentences": sentences,
    }


def _solver(solution: FrameSolution, settings: Mapping[str, Any]) -> dict[str, Any]:
    options = common.given_options(FrameOptions, settings)
    nominal, sigma = base_length(solution.chain, options)
    keypoint_m = solution.chain.scales.keypoint_m
    return common.solver(options, keypoint_sigma_m=keypoint_m, base_length_m=nominal, base_sigma_m=sigma)


def _summary(motion: Motion, solution: FrameSolution) -> dict[str, Any]:
    solved = [r for r in solution.reports if r is not None]
    sigma = _joint_sigma_camera_m(solution)
    return {
        "frames": len(motion.frames),
        **{f"frames_{s}": solution.status.count(s) for s in ("converged", "not_converged", "no_data")},
        "frames_ran_away": sum("ran away" in flags for flags in motion.flags),
        "frames_stopped": sum("stopped early" in flags for flags in motion.flags),
        **common.counts(motion),
        "joint_sigma_across_m": median(np.sqrt((sigma[..., :2] ** 2).mean(axis=-1))),
        "joint_sigma_depth_m": median(sigma[..., 2]),
        "iterations_median": median(np.array([r.iterations for r in solved], dtype=float)),
        "function_evaluations_median": median(np.array([r.function_evaluations for r in solved], dtype=float)),
    }


def _data_share(motion: Motion, solution: FrameSolution) -> dict[str, Any]:
    states = _field_of_frames(solution, "data_share", solution.chain.n_state)
    joints = _field_of_frames(solution, "joint_data_share", len(motion.names))
    return {
        "states": by_name(solution.chain.state_names, [median(column) for column in states.T]),
        "joints": by_name(motion.names, [median(column) for column in joints.T]),
    }


def _joint_sigma_camera_m(solution: FrameSolution) -> Array:
    """(T, J, 3): standard deviations along the camera's x, y, z, given the frame before."""
    R = solution.views[0].rotation
    return np.sqrt(np.diagonal(R @ solution.covariance_m2 @ R.T, axis1=2, axis2=3))


def _joint_sigma(motion: Motion, solution: FrameSolution) -> dict[str, Any]:
    """Median over the frames, camera x, y, z."""
    sigma = _joint_sigma_camera_m(solution)
    return by_name(motion.names, [[median(sigma[:, j, axis]) for axis in range(3)] for j in range(len(motion.names))])


def _cost_shares(solution: FrameSolution) -> dict[str, Any]:
    """Median over the frames with a pose that have the term."""
    solved = [r.cost_shares for r in solution.reports if r is not None and r.in_view]
    return {
        name: median(np.array([shares[name] for shares in solved if name in shares])) for name in solution.objectives
    }


def _limits(motion: Motion, solution: FrameSolution) -> dict[str, Any]:
    beyond_rate = solution.beyond_rate_rad_s
    return {
        "frames": int(motion.solved.sum()),
        "intervals": int(np.isfinite(beyond_rate).any(axis=1).sum()),
        "ranges": _limit_counts(solution, solution.beyond_range_rad, "largest_excess_rad"),
        "rates": _limit_counts(solution, beyond_rate, "largest_excess_rad_s"),
    }


def _limit_counts(solution: FrameSolution, beyond: Array, largest: str) -> dict[str, Any]:
    counts = [
        {"passed": int((column > 0).sum()), largest: float(np.max(finite(column), initial=0.0))} for column in beyond.T
    ]
    return by_name(solution.chain.angle_names, counts)


def _travel(motion: Motion, solution: FrameSolution) -> dict[str, Any]:
    travel = solution.travel
    _, away = level_axes(motion.camera.up)
    to_picture = np.arcsin(np.clip(travel.heading @ away, -1.0, 1.0))
    moving = travel.speed_m_s > 0
    return {
        "heading_to_picture_rad": median(to_picture[moving] if moving.any() else to_picture),
        "median_speed_m_s": median(travel.speed_m_s[moving]),
        "heading_camera": travel.heading,
        "speed_m_s": travel.speed_m_s,
    }


def _frames(motion: Motion, solution: FrameSolution) -> list[dict[str, Any]]:
    names = [f.name for f in fields(FrameReport) if f.name != "status"]
    distance_px, sigma = motion.pictures[0].distance_px, _joint_sigma_camera_m(solution)
    return [
        {
            "frame": motion.frames[t],
            "status": solution.status[t],
            "flags": motion.flags[t],
            "detections": motion.detections[t],
            "mean_reprojection_px": mean(distance_px[t]),
            "unknowns": solution.chain_states[t] if motion.solved[t] else None,
            "joint_sigma_m": None if report is None else sigma[t],
            "place_sigma_m": None if report is None else motion.place_sigma_m[t],
            "relative_rms_m": None if report is None else motion.relative_rms_m[t],
            **{name: getattr(report, name, None) for name in names},
        }
        for t, report in enumerate(solution.reports)
    ]


def _field_of_frames(solution: FrameSolution, field: str, *shape: int) -> Array:
    """(solved frames, *shape): one field of all frame reports."""
    values = [getattr(r, field) for r in solution.reports if r is not None]
    return np.array(values, dtype=float).reshape(-1, *shape)


# -- summing up ---------------------------------------------------------------------------------------------------


def lines(report: Mapping[str, Any]) -> common.Lines:
    """For the summary."""
    summary = report["summary"]
    base = report["assumptions"]["base_length"]
    return [
        common.clip_line(report),
        ("side", f"{report['side']['fitted']}: {report['side']['reason']}"),
        (
            "frames",
            f"{summary['frames_converged']} of {summary['frames']} converged, "
            f"{summary['frames_not_converged']} did not, {summary['frames_no_data']} without data",
        ),
        *common.point_lines(report),
        ("speed", _speed_text(report["travel"]["median_speed_m_s"])),
        ("path", _path_text(report)),
        ("heading", common.heading_text(report["travel"]["heading_to_picture_rad"])),
        (
            "size",
            f"base length {number(report['base_length_m']['mean'], '.3f')} m; expected {base['nominal_m']:.3f} ± "
            f"{base['sigma_m']:.3f} m; {number(base['data_share'], '.0%').lstrip('-')} of its precision from pixels",
        ),
        (
            "uncertainty",
            f"{number(summary['joint_sigma_across_m'], '.2f')} m across the picture, "
            f"{number(summary['joint_sigma_depth_m'], '.2f')} m in depth, size and distance included (one sigma)",
        ),
        ("effort", _effort_text(report)),
    ]


def _speed_text(speed_m_s: float | None) -> str:
    if speed_m_s is None:
        return "not told by a path this short or slow"
    return f"{speed_m_s:.1f} m/s, of a straight run through all frames"


def _path_text(report: Mapping[str, Any]) -> str:
    root, frame = report["root_path"], f"{report['frame_of_reference']} frame"
    path = root["smoothed"] or root["exact"]
    time_s, points_m = (np.array(root[name], dtype=float) for name in ("time_s", "position_m"))
    doubt = peak_doubt(time_s, points_m.reshape(-1, 3), smooth=root["smoothed"] is not None)
    if doubt is not None:
        other = "" if report["travel"]["median_speed_m_s"] is None else "; take the speed above"
        return f"too uncertain in depth for its speed ({frame}): {doubt}{other}"
    how = "smoothed" if root["smoothed"] else "not smoothed"
    return f"{number(path['distance_m'], '.1f')} m, peak {number(path['peak_speed_m_s'], '.1f')} m/s ({frame}, {how})"


def _effort_text(report: Mapping[str, Any]) -> str:
    summary, timing = report["summary"], report["timing_s"] or {}
    text = f"{number(summary['iterations_median'], '.0f')} iterations a frame (median)"
    if "solve_s" in timing:
        times = [frame["solve_s"] for frame in report["frames"] if frame.get("solve_s") is not None]
        median = f", {1000 * float(np.median(times)):.0f} ms a frame (median)" if times else ""
        text += f"{median}; {timing['solve_s']:.1f} s with reading"
    return text
