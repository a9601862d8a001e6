"""The report of the frame method."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from recon.analysis.path import peak_doubt
from recon.frames import level_axes
from recon.motion import FEW_POINTS_SHARE, FrameMotion
from recon.report import common
from recon.report.plain import Array, by_name, finite, frame_count, mean, median, number, spread
from recon.solve import FrameOptions, FrameReport, base_length

WARN_FEW_POINTS, WARN_LIMITS = 0.2, 0.25
"""Shares of the frames from which the report warns."""


def sections(motion: FrameMotion, settings: Mapping[str, Any]) -> dict[str, Any]:
    return {
        **common.head(motion, settings),
        "skeleton": common.skeleton(motion.skeleton.name, motion) | {"objectives": motion.solution.objectives},
        "assumptions": _assumptions(motion, settings),
        "summary": _summary(motion),
        "solver": _solver(motion, settings),
        "base_length_m": spread(motion.states[:, motion.skeleton.base_index]),
        "data_share": _data_share(motion),
        "joint_sigma_m": _joint_sigma(motion),
        "cost_shares": _cost_shares(motion),
        "limits": _limits(motion),
        "travel": _travel(motion),
        "frames": _frames(motion),
        **common.tail(motion, jitters=True),
    }


def is_unsolved(report: Mapping[str, Any]) -> bool:
    return report["summary"]["frames_converged"] == 0


# -- sections -----------------------------------------------------------------------------------------------------


def _assumptions(motion: FrameMotion, settings: Mapping[str, Any]) -> dict[str, Any]:
    """What the data does not say, in numbers and in sentences."""
    nominal, sigma = base_length(motion.skeleton, common.given_options(FrameOptions, settings))
    share = median(_stacked(motion, "data_share", motion.skeleton.n_state)[:, motion.skeleton.base_index])
    measured = bool(share >= common.MEASURED_SHARE)
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


def _solver(motion: FrameMotion, settings: Mapping[str, Any]) -> dict[str, Any]:
    options, scales = common.given_options(FrameOptions, settings), motion.skeleton.scales
    nominal, sigma = base_length(motion.skeleton, options)
    return common.solver(options, keypoint_sigma_m=scales.keypoint_m, base_length_m=nominal, base_sigma_m=sigma)


def _summary(motion: FrameMotion) -> dict[str, Any]:
    solved = [r for r in motion.reports if r is not None]
    sigma = _stacked(motion, "joint_sigma_m", len(motion.names), 3)
    return {
        "frames": len(motion.frames),
        **{f"frames_{s}": motion.status.count(s) for s in ("converged", "not_converged", "no_data")},
        "frames_ran_away": sum("ran away" in flags for flags in motion.flags),
        "frames_stopped": sum("stopped early" in flags for flags in motion.flags),
        **common.counts(motion),
        "joint_sigma_across_m": median(np.sqrt((sigma[..., :2] ** 2).mean(axis=-1))),
        "joint_sigma_depth_m": median(sigma[..., 2]),
        "iterations_median": median(np.array([r.iterations for r in solved], dtype=float)),
        "function_evaluations_median": median(np.array([r.function_evaluations for r in solved], dtype=float)),
    }


def _data_share(motion: FrameMotion) -> dict[str, Any]:
    states = _stacked(motion, "data_share", motion.skeleton.n_state)
    joints = _stacked(motion, "joint_data_share", len(motion.names))
    return {
        "states": by_name(motion.skeleton.state_names, [median(column) for column in states.T]),
        "joints": by_name(motion.names, [median(column) for column in joints.T]),
    }


def _joint_sigma(motion: FrameMotion) -> dict[str, Any]:
    """Median over the frames, camera x, y, z."""
    sigma = _stacked(motion, "joint_sigma_m", len(motion.names), 3)
    return by_name(motion.names, [[median(sigma[:, j, axis]) for axis in range(3)] for j in range(len(motion.names))])


def _cost_shares(motion: FrameMotion) -> dict[str, Any]:
    """Median over the frames with a pose that have the term."""
    solved = [r.cost_shares for r in motion.reports if r is not None and r.in_view]
    return {
        name: median(np.array([shares[name] for shares in solved if name in shares]))
        for name in motion.solution.objectives
    }


def _limits(motion: FrameMotion) -> dict[str, Any]:
    beyond_range, beyond_rate = motion.beyond_range_rad, motion.beyond_rate_rad_s
    intervals = int(np.isfinite(beyond_rate).any(axis=1).sum())
    return {
        "frames": int(motion.solved.sum()),
        "intervals": intervals,
        "ranges": _passed(motion, beyond_range, "largest_excess_rad"),
        "rates": _passed(motion, beyond_rate, "largest_excess_rad_s"),
    }


def _passed(motion: FrameMotion, beyond: Array, largest: str) -> dict[str, Any]:
    counts = [
        {"passed": int((column > 0).sum()), largest: float(np.max(finite(column), initial=0.0))} for column in beyond.T
    ]
    return by_name(motion.skeleton.angle_names, counts)


def _travel(motion: FrameMotion) -> dict[str, Any]:
    travel = motion.solution.travel
    _, away = level_axes(motion.camera.up)
    to_picture = np.arcsin(np.clip(travel.heading @ away, -1.0, 1.0))
    moving = travel.speed_m_s > 0
    return {
        "heading_to_picture_rad": median(to_picture[moving] if moving.any() else to_picture),
        "median_speed_m_s": median(travel.speed_m_s[moving]),
        "heading_camera": travel.heading,
        "speed_m_s": travel.speed_m_s,
    }


def _frames(motion: FrameMotion) -> list[dict[str, Any]]:
    names = [f.name for f in fields(FrameReport) if f.name != "status"]
    rows = []
    for t, report in enumerate(motion.reports):
        rows.append(
            {
                "frame": motion.frames[t],
                "status": motion.status[t],
                "flags": motion.flags[t],
                "detections": motion.detections[t],
                "mean_reprojection_px": mean(motion.distance_px[t]),
                **{name: getattr(report, name, None) for name in names},
            }
        )
    return rows


def _stacked(motion: FrameMotion, field: str, *shape: int) -> Array:
    """(solved frames, *shape): one field of all frame reports."""
    values = [getattr(r, field) for r in motion.reports if r is not None]
    return np.array(values, dtype=float).reshape(-1, *shape)


# -- summing up ---------------------------------------------------------------------------------------------------


def warnings(report: Mapping[str, Any]) -> Iterator[str]:
    """What a reader should know before using the numbers, most serious first."""
    summary, frames = report["summary"], report["frames"]
    total, solved = summary["frames"], summary["frames"] - summary["frames_no_data"]
    if summary["frames_not_converged"]:
        yield f"{frame_count(summary['frames_not_converged'])} did not converge"
    if summary["frames_ran_away"]:
        yield f"{frame_count(summary['frames_ran_away'])} without a pose: it ran out of the camera's sight"
    if summary["frames_stopped"]:
        yield f"{frame_count(summary['frames_stopped'])} stopped early: no pose explains the points of this clip"
    if summary["frames_no_data"]:
        yield f"{frame_count(summary['frames_no_data'])} of {total} without a pose: too few points detected"
    few = sum("few points" in frame["flags"] for frame in frames)
    if solved and few > WARN_FEW_POINTS * solved:
        yield f"few data: {frame_count(few)} of {solved} with less than {FEW_POINTS_SHARE:.0%} of the joints detected"
    yield from common.keypoint_warnings(report)
    at_limit = sum("at range limit" in frame["flags"] for frame in frames)
    if solved and at_limit > WARN_LIMITS * solved:
        yield f"angles beyond their expected ranges in {at_limit} of {solved} frames"
    if not report["assumptions"]["base_length"]["measured"]:
        yield "scale not measured: it comes from the expected base length"
    yield from common.camera_warnings(report)


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
        ("speed", _speed(report["travel"]["median_speed_m_s"])),
        ("path", _path(report)),
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
        ("effort", _effort(report)),
    ]


def _speed(speed_m_s: float | None) -> str:
    if speed_m_s is None:
        return "not told by a path this short or slow"
    return f"{speed_m_s:.1f} m/s, of a straight run through all frames"


def _path(report: Mapping[str, Any]) -> str:
    root, frame = report["root_path"], f"{report['frame_of_reference']} frame"
    path = root["smoothed"] or root["exact"]
    time_s, points_m, jitter_m = (np.array(root[name], dtype=float) for name in ("time_s", "position_m", "jitter_m"))
    doubt = peak_doubt(time_s, points_m.reshape(-1, 3), jitter_m if root["smoothed"] else None)
    if doubt is not None:
        other = "" if report["travel"]["median_speed_m_s"] is None else "; take the speed above"
        return f"too uncertain in depth for its speed ({frame}): {doubt}{other}"
    how = "smoothed" if root["smoothed"] else "not smoothed"
    return f"{number(path['distance_m'], '.1f')} m, peak {number(path['peak_speed_m_s'], '.1f')} m/s ({frame}, {how})"


def _effort(report: Mapping[str, Any]) -> str:
    summary, timing = report["summary"], report["timing_s"] or {}
    text = f"{number(summary['iterations_median'], '.0f')} iterations a frame (median)"
    if "solve_s" in timing:
        times = [frame["solve_s"] for frame in report["frames"] if frame.get("solve_s") is not None]
        median = f", {1000 * float(np.median(times)):.0f} ms a frame (median)" if times else ""
        text += f"{median}; {timing['solve_s']:.1f} s with reading"
    return text
