"""The report of a fit, as plain JSON types. Every field is documented in docs/report.md."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from rich.text import Text

from recon.analysis.path import frame_jitter_m, path_kinematics
from recon.initialise import level_axes
from recon.keypoints import KeypointCounts
from recon.motion import OUTLIER_SIGMAS, Motion
from recon.skeleton import AngleRanges
from recon.solve import FrameOptions, FrameReport, base_length

Array = NDArray[np.float64]

SCHEMA_NAME = "recon.fit.report"
SCHEMA_VERSION = 1

MEASURED_SHARE = 0.5
"""A quantity with less of its precision from the pixels is not called measured."""
BEST_SHARE = 0.9
FEW_POINTS_SHARE = 0.75
"""Frames with a smaller part of the joints detected are flagged "few points"."""
WARN_FEW_POINTS, WARN_OUTLIERS, WARN_LIMITS = 0.2, 0.05, 0.25
"""Shares of the frames, the detections and the frames from which the report warns."""
DIGITS = 9
"""Significant digits of the numbers in the report."""


# -- building -----------------------------------------------------------------------------------------------------


def build_report(
    motion: Motion, settings: Mapping[str, Any], timing: Mapping[str, float] | None = None
) -> dict[str, Any]:
    """The report of one clip.

    settings: all that the fit was told, as plain types, the fields of `FrameOptions` among them (a missing one has its
    default). timing: seconds by name. NaN becomes None, floats have nine significant digits.
    """
    report = {
        "schema": {"name": SCHEMA_NAME, "version": SCHEMA_VERSION},
        "recon_version": metadata.version("recon"),
        "input": _input(motion),
        "settings": settings,
        "timing_s": timing,
        "skeleton": _skeleton(motion),
        "side": {"fitted": motion.side, "reason": motion.side_reason},
        "frame_of_reference": motion.frame_of_reference,
        "assumptions": _assumptions(motion, settings),
        "summary": _summary(motion),
        "warnings": [],
        "cleaning": {k: v for k, v in motion.cleaning.to_dict().items() if k != "keypoints"},
        "keypoints": _keypoints(motion),
        "unused_keypoints": motion.unused_keypoints,
        "missing_keypoints": motion.missing_keypoints,
        "outliers": _outliers(motion),
        "base_length_m": _spread(motion.states[:, motion.skeleton.base_index]),
        "data_share": _data_share(motion),
        "joint_sigma_m": _joint_sigma(motion),
        "cost_shares": _cost_shares(motion),
        "limits": _limits(motion),
        "travel": _travel(motion),
        "root_path": _root_path(motion),
        "frames": _frames(motion),
        "image_error_px": {"joints": motion.names, "values": motion.image_error_px.transpose(1, 2, 0)},
    }
    plain = to_plain(report)
    plain["warnings"] = _warnings(plain)
    return plain


def write_report(report: Mapping[str, Any], path: Path) -> None:
    """report.json: indented, with each list of numbers on one line."""
    text = json.dumps(report, indent=1, allow_nan=False, ensure_ascii=False)
    # A line break never stands inside a JSON string, so that this changes only the white space between values.
    text = re.sub(r"\[[^\[\]{}]*\]", lambda match: re.sub(r"\s*\n\s*", " ", match[0]), text)
    path.write_text(text + "\n", encoding="utf-8")


def to_plain(value: Any) -> Any:
    """Arrays, tuples, mappings and numbers as JSON types; NaN and infinities are None."""
    if isinstance(value, Mapping):
        return {str(key): to_plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return to_plain(value.tolist())
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if isinstance(value, float):
        return float(f"{value:.{DIGITS}g}") if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int | str):
        return value
    return str(value)


def _input(motion: Motion) -> dict[str, Any]:
    keypoints = motion.keypoints
    return {
        "keypoints": keypoints.source,
        "individual": keypoints.individual,
        "fps": motion.fps,
        "frames": motion.cleaning.frames,
        "camera": motion.camera.to_dict(),
    }


def _skeleton(motion: Motion) -> dict[str, Any]:
    s = motion.skeleton
    return {
        "name": s.name,
        "title": s.title,
        "joints": s.joints,
        "keypoints": motion.names,
        "state_names": s.state_names,
        "objectives": motion.solution.objectives,
    }


def _assumptions(motion: Motion, settings: Mapping[str, Any]) -> dict[str, Any]:
    """What the data does not say, in numbers and in sentences."""
    camera = motion.camera
    options = FrameOptions(base_length_m=settings.get("base_length_m"), base_sigma_m=settings.get("base_sigma_m"))
    nominal, sigma = base_length(motion.skeleton, options)
    share = _median(_stacked(motion, "data_share", motion.skeleton.n_state)[:, motion.skeleton.base_index])
    measured = bool(share >= MEASURED_SHARE)
    level = not (camera.has_extrinsics and camera.world_z_up)
    sentences = [
        f"The scale: the base length has a prior of {nominal:g} m with a standard deviation of {sigma:g} m. "
        + (
            f"The pixels give {share:.0%} of its precision."
            if measured
            else "It is not measured: distances, speeds and sizes scale with it."
        ),
        "The camera stands still: where it pans or moves, its movement is part of the path.",
        f"Only the limbs of the animal's {motion.side} side are fitted.",
    ]
    if level:
        sentences.append("The camera is taken to be level, because its file does not say which way is up.")
    if settings.get("hfov_deg") is not None:
        sentences.append(
            f"The camera has no calibration: its focal length follows from a horizontal field of view of "
            f"{settings['hfov_deg']:g} degrees, and its lens is taken to be free of distortion."
        )
    if settings.get("angle_prior") == "none":
        sentences.append("Without the Gaussian priors the pixels leave the depth of the limbs undetermined.")
    return {
        "base_length": {"nominal_m": nominal, "sigma_m": sigma, "data_share": share, "measured": measured},
        "camera_level": level,
        "camera_up": camera.up,
        "sentences": sentences,
    }


def _summary(motion: Motion) -> dict[str, Any]:
    errors = motion.distance_px[np.isfinite(motion.distance_px)]
    best = np.sort(errors)[: math.ceil(BEST_SHARE * len(errors))]
    by_joint = np.array([_mean(column) for column in motion.distance_px.T])
    worst = int(np.nanargmax(by_joint)) if len(errors) else None
    solved = [r for r in motion.reports if r is not None]
    sigma = _stacked(motion, "joint_sigma_m", len(motion.names), 3)
    return {
        "frames": len(motion.frames),
        **{f"frames_{s}": motion.status.count(s) for s in ("converged", "not_converged", "no_data")},
        "detections": int(motion.keypoints.present.sum()),
        "outliers": int(motion.outliers.sum()),
        "reprojection_px": {
            "mean": _mean(errors),
            "median": _median(errors),
            "mad": _median(np.abs(errors - _median(errors))),
            "mean_best_90_percent": _mean(best),
            "worst_joint": None if worst is None else motion.names[worst],
            "worst_joint_mean": np.nan if worst is None else by_joint[worst],
        },
        "joint_sigma_across_m": _median(np.sqrt((sigma[..., :2] ** 2).mean(axis=-1))),
        "joint_sigma_depth_m": _median(sigma[..., 2]),
        "iterations_median": _median(np.array([r.iterations for r in solved], dtype=float)),
        "function_evaluations_median": _median(np.array([r.function_evaluations for r in solved], dtype=float)),
    }


def _keypoints(motion: Motion) -> list[dict[str, Any]]:
    """The fitted keypoints in the order of the joints, then those of the file that are not used."""
    counted = {k.name: k for k in motion.cleaning.keypoints}
    counts = [f.name for f in fields(KeypointCounts) if f.name != "name"]
    rows = []
    for name in (*motion.names, *motion.unused_keypoints):
        fitted, known = name in motion.names, counted.get(name)
        column = motion.names.index(name) if fitted else None
        rows.append(
            {
                "name": name,
                "joint": None if column is None else motion.skeleton.joints[column],
                "in_file": known is not None,
                **{count: getattr(known, count, None) for count in counts},
                "outliers": None if column is None else int(motion.outliers[:, column].sum()),
                "mean_error_px": None if column is None else _mean(motion.distance_px[:, column]),
            }
        )
    return rows


def _outliers(motion: Motion) -> list[dict[str, Any]]:
    return [
        {"frame": motion.frames[t], "keypoint": motion.names[j], "error_px": motion.distance_px[t, j]}
        for t, j in np.argwhere(motion.outliers)
    ]


def _data_share(motion: Motion) -> dict[str, Any]:
    states = _stacked(motion, "data_share", motion.skeleton.n_state)
    joints = _stacked(motion, "joint_data_share", len(motion.names))
    return {
        "states": _by_name(motion.skeleton.state_names, [_median(column) for column in states.T]),
        "joints": _by_name(motion.names, [_median(column) for column in joints.T]),
    }


def _joint_sigma(motion: Motion) -> dict[str, Any]:
    """Median over the frames, camera x, y, z."""
    sigma = _stacked(motion, "joint_sigma_m", len(motion.names), 3)
    return _by_name(motion.names, [[_median(sigma[:, j, axis]) for axis in range(3)] for j in range(len(motion.names))])


def _cost_shares(motion: Motion) -> dict[str, Any]:
    """Median over the frames that have the term."""
    solved = [r.cost_shares for r in motion.reports if r is not None]
    return {
        name: _median(np.array([shares[name] for shares in solved if name in shares]))
        for name in motion.solution.objectives
    }


def _limits(motion: Motion) -> dict[str, Any]:
    beyond_range, beyond_rate = _beyond_range(motion), _beyond_rate(motion)
    intervals = int(np.isfinite(beyond_rate).any(axis=1).sum())
    return {
        "frames": int(motion.solved.sum()),
        "intervals": intervals,
        "ranges": _passed(motion, beyond_range, "largest_excess_rad"),
        "rates": _passed(motion, beyond_rate, "largest_excess_rad_s"),
    }


def _passed(motion: Motion, beyond: Array, largest: str) -> dict[str, Any]:
    counts = [
        {"passed": int((column > 0).sum()), largest: float(np.max(_finite(column), initial=0.0))} for column in beyond.T
    ]
    return _by_name(motion.skeleton.angle_names, counts)


def _beyond_range(motion: Motion) -> Array:
    """(T, A): how far angles lie beyond their expected ranges, rad; negative inside, NaN without a pose."""
    mean, tolerance = (_both(motion, name) for name in ("mean_rad", "tolerance_rad"))
    return np.abs(motion.angles_rad - mean) - tolerance


def _beyond_rate(motion: Motion) -> Array:
    """(T, A): chord rate since the solved frame before, above its limit, rad/s; NaN for the first and without pose."""
    rows = np.flatnonzero(motion.solved)
    change = np.diff(motion.angles_rad[rows], axis=0)
    dt_s = np.diff(motion.time_s[rows])[:, None]
    beyond = np.full(motion.angles_rad.shape, np.nan)
    beyond[rows[1:]] = 2 * np.abs(np.sin(change / 2)) / dt_s - _both(motion, "max_rate_rad_s")
    return beyond


def _both(motion: Motion, field: str) -> Array:
    ranges: Sequence[AngleRanges] = (motion.skeleton.theta, motion.skeleton.phi)
    return np.concatenate([getattr(r, field) for r in ranges])


def _travel(motion: Motion) -> dict[str, Any]:
    travel = motion.solution.travel
    _, away = level_axes(motion.camera.up)
    to_picture = np.arcsin(np.clip(travel.heading @ away, -1.0, 1.0))
    moving = travel.speed_m_s > 0
    return {
        "heading_to_picture_rad": _median(to_picture[moving] if moving.any() else to_picture),
        "median_speed_m_s": _median(travel.speed_m_s[moving]),
        "heading_camera": travel.heading,
        "speed_m_s": travel.speed_m_s,
    }


def _root_path(motion: Motion) -> dict[str, Any]:
    """Exactly as reconstructed, and without the jitter from frame to frame, if that can be told."""
    jitter = frame_jitter_m(motion.root_m)
    return {
        "joint": motion.skeleton.joints[0],
        "keypoint": motion.names[0],
        "time_s": motion.time_s,
        "position_m": motion.root_m,
        "jitter_m": jitter,
        "exact": _kinematics(motion, None),
        "smoothed": _kinematics(motion, jitter) if np.isfinite(jitter).all() else None,
    }


def _kinematics(motion: Motion, smoothing_m: Array | None) -> dict[str, Any]:
    path = path_kinematics(motion.time_s, motion.root_m, smoothing_m=smoothing_m)
    acceleration = _finite(path.acceleration_m_s2)
    at_frames = slice(None, None, path.oversampling)
    return {
        "smoothing_m": smoothing_m,
        "oversampling": path.oversampling,
        "distance_m": path.distance_m,
        "peak_speed_m_s": path.peak_speed_m_s,
        "mean_speed_m_s": path.mean_speed_m_s,
        "peak_acceleration_m_s2": float(acceleration.max()) if len(acceleration) else np.nan,
        "speed_m_s": path.speed_m_s[at_frames],
        "acceleration_m_s2": path.acceleration_m_s2[at_frames],
    }


def _frames(motion: Motion) -> list[dict[str, Any]]:
    names = [f.name for f in fields(FrameReport) if f.name != "status"]
    present = motion.keypoints.present.sum(axis=1)
    at_range, at_rate = (np.any(beyond > 0, axis=1) for beyond in (_beyond_range(motion), _beyond_rate(motion)))
    rows = []
    for t, report in enumerate(motion.reports):
        status = motion.status[t]
        flags = {
            "no data": status == "no_data",
            "few points": status != "no_data" and present[t] < FEW_POINTS_SHARE * len(motion.names),
            "outliers": motion.outliers[t].any(),
            "not converged": status == "not_converged",
            "at range limit": at_range[t],
            "at rate limit": at_rate[t],
        }
        rows.append(
            {
                "frame": motion.frames[t],
                "status": status,
                "flags": [flag for flag, is_set in flags.items() if is_set],
                "detections": present[t],
                "mean_reprojection_px": _mean(motion.distance_px[t]),
                **{name: getattr(report, name, None) for name in names},
            }
        )
    return rows


# -- summing up ---------------------------------------------------------------------------------------------------


def _warnings(report: Mapping[str, Any]) -> list[str]:
    """What a reader should know before using the numbers, most serious first."""
    return list(_warn(report))


def _warn(report: Mapping[str, Any]) -> Iterator[str]:
    summary, frames = report["summary"], report["frames"]
    total, solved = summary["frames"], summary["frames"] - summary["frames_no_data"]
    if summary["frames_not_converged"]:
        yield f"{_frame_count(summary['frames_not_converged'])} did not converge"
    if summary["frames_no_data"]:
        yield f"{_frame_count(summary['frames_no_data'])} of {total} without a pose: too few points detected"
    few = sum("few points" in frame["flags"] for frame in frames)
    if solved and few > WARN_FEW_POINTS * solved:
        yield f"few data: {_frame_count(few)} of {solved} with less than {FEW_POINTS_SHARE:.0%} of the joints detected"
    if report["missing_keypoints"]:
        yield f"not in the file: {', '.join(report['missing_keypoints'])}"
    if summary["outliers"] > WARN_OUTLIERS * max(summary["detections"], 1):
        share = summary["outliers"] / summary["detections"]
        yield f"many outliers: {summary['outliers']} detections ({share:.0%}) do not agree with the pose"
    at_limit = sum("at range limit" in frame["flags"] for frame in frames)
    if solved and at_limit > WARN_LIMITS * solved:
        yield f"angles beyond their expected ranges in {at_limit} of {solved} frames"
    if not report["assumptions"]["base_length"]["measured"]:
        yield "scale not measured: it comes from the expected base length"
    if report["assumptions"]["camera_level"]:
        yield "camera taken to be level: its file does not say which way is up"


def summary_lines(report: Mapping[str, Any]) -> list[tuple[str, str]]:
    """(label, value) of what one wants to see after a fit; the warnings come last."""
    given, summary, errors = report["input"], report["summary"], report["summary"]["reprojection_px"]
    base = report["assumptions"]["base_length"]
    smoothed = report["root_path"]["smoothed"]
    path = smoothed or report["root_path"]["exact"]
    fitted = [row for row in report["keypoints"] if row["joint"] is not None]
    used, missing, rejected = (sum(row[count] or 0 for row in fitted) for count in ("used", "missing", "rejected"))
    first, stop = given["frames"]
    file = Path(given["keypoints"]).name if given["keypoints"] else "keypoints"
    off = sorted(((row["outliers"], row["name"]) for row in fitted if row["outliers"]), reverse=True)
    most = ", ".join(f"{name} {count}" for count, name in off[:3]) + (", ..." if len(off) > 3 else "")
    heading = report["travel"]["heading_to_picture_rad"]
    lines = [
        ("clip", f"{file}, frames {first} to {stop - 1} at {given['fps']:g} fps"),
        ("side", f"{report['side']['fitted']}: {report['side']['reason']}"),
        (
            "frames",
            f"{summary['frames_converged']} of {summary['frames']} converged, "
            f"{summary['frames_not_converged']} did not, {summary['frames_no_data']} without data",
        ),
        ("points", f"{used} used, {missing} missing, {rejected} rejected as unlikely"),
        ("reprojection", _reprojection(errors)),
        (
            "outliers",
            f"{summary['outliers']} points further off than {OUTLIER_SIGMAS:g} sigma of the detector"
            + (f": {most}" if off else ""),
        ),
        ("speed", _speed(report["travel"]["median_speed_m_s"])),
        (
            "path",
            f"{_number(path['distance_m'], '.1f')} m, peak {_number(path['peak_speed_m_s'], '.1f')} m/s "
            f"({report['frame_of_reference']} frame, {'smoothed' if smoothed else 'not smoothed'}; "
            "the jitter in depth makes it too long and too fast)",
        ),
        ("heading", _heading(heading)),
        (
            "size",
            f"base length {_number(report['base_length_m']['mean'], '.3f')} m; expected {base['nominal_m']:.3f} ± "
            f"{base['sigma_m']:.3f} m; {_number(base['data_share'], '.0%').lstrip('-')} of its precision from pixels",
        ),
        (
            "uncertainty",
            f"{_number(summary['joint_sigma_across_m'], '.2f')} m across the picture, "
            f"{_number(summary['joint_sigma_depth_m'], '.2f')} m in depth, size and distance included (one sigma)",
        ),
        ("effort", _effort(report)),
    ]
    return lines + [("warning", text) for text in report["warnings"]]


def console_summary(report: Mapping[str, Any]) -> Table:
    """`summary_lines` for a terminal, to be printed with rich."""
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column()
    for label, value in summary_lines(report):
        warning = label == "warning"
        table.add_row(Text(label, style="bold yellow" if warning else "bold"), Text(value, "yellow" if warning else ""))
    return table


def _reprojection(errors: Mapping[str, Any]) -> str:
    if errors["worst_joint"] is None:
        return "none: no pose"
    return (
        f"{errors['mean']:.1f} px mean, {errors['median']:.1f} px median; "
        f"worst joint {errors['worst_joint']}, {errors['worst_joint_mean']:.1f} px (outliers included)"
    )


def _speed(speed_m_s: float | None) -> str:
    if speed_m_s is None:
        return "not told by a path this short or slow"
    return f"{speed_m_s:.1f} m/s, of a straight run through all frames"


def _heading(angle_rad: float | None) -> str:
    if angle_rad is None:
        return "unknown"
    degrees = round(math.degrees(angle_rad))
    if degrees == 0:
        return "in the picture's plane"
    return f"{abs(degrees)}° out of the picture's plane, {'away from' if degrees > 0 else 'towards'} the camera"


def _effort(report: Mapping[str, Any]) -> str:
    summary, timing = report["summary"], report["timing_s"] or {}
    text = f"{_number(summary['iterations_median'], '.0f')} iterations a frame (median)"
    if "solve_s" in timing:
        times = [frame["solve_s"] for frame in report["frames"] if frame.get("solve_s") is not None]
        median = f", {1000 * float(np.median(times)):.0f} ms a frame (median)" if times else ""
        text += f"{median}; {timing['solve_s']:.1f} s with reading"
    return text


def _frame_count(n: int) -> str:
    return "1 frame" if n == 1 else f"{n} frames"


def _number(value: float | None, spec: str) -> str:
    return "?" if value is None else format(value, spec)


# -- numbers ------------------------------------------------------------------------------------------------------


def _stacked(motion: Motion, field: str, *shape: int) -> Array:
    """(solved frames, *shape): one field of all frame reports."""
    values = [getattr(r, field) for r in motion.reports if r is not None]
    return np.array(values, dtype=float).reshape(-1, *shape)


def _by_name(names: Sequence[str], values: Sequence[Any]) -> dict[str, Any]:
    return dict(zip(names, values, strict=True))


def _spread(values: Array) -> dict[str, float]:
    finite = _finite(values)
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (np.nan, np.nan)
    return {"mean": _mean(values), "min": low, "max": high}


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]


def _mean(values: Array) -> float:
    finite = _finite(values)
    return float(finite.mean()) if len(finite) else np.nan


def _median(values: Array) -> float:
    finite = _finite(values)
    return float(np.median(finite)) if len(finite) else np.nan
