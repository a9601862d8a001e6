"""Write the tables of a fit (docs/report.md) and of `recon analyse` (docs/gait.md).

For each table of a fit, a function writes the table of a motion to a path. For each table of an analysis, a function
returns the table of a `ClipAnalysis`, which `table_content` rounds. `recon.base.files.staged_folder` writes a folder of
tables atomically.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from recon.check.to_correct import to_correct as worth_correcting
from recon.check.verdict import frame_rms_m
from recon.fit.motion import Motion
from recon.gait.clip import ClipAnalysis
from recon.gait.dynamics import G_M_S2, OVER_STRIDE, StanceForce
from recon.gait.flexion import PERCENT, extreme
from recon.gait.kinematics import AngleKinematics
from recon.gait.phase import FieldMeans, means_of_field
from recon.gait.stances import interval_of
from recon.io.writing import write_columns, write_rows, write_table

WORKBOOK, LONG, DICTIONARY = "analysis.xlsx", "analysis_long.csv", "analysis_dictionary.csv"
"""Names of the files that `recon.show.workbook` writes."""
QUALITY_COLUMNS = ("frame", "flags", "alternative_m", "detections", "mean_weight", "place_sigma_m", "relative_rms_m")
ANGLE, PIXEL, SHARE, LENGTH = 5, 2, 3, 7
"""Numbers of decimals of angles in rad, pixels, fractions, and an animal's lengths in metres in tables of a fit.

Further digits are meaningless and differ between processors.
"""
SIGMA_DIGITS = 3
"""Number of significant digits of standard deviations of joints and angles, which are known to a few per cent."""
MIN_METRE = 4
"""Minimum number of decimals of positions in metres."""
MAX_METRE = 7
"""Maximum number of decimals of positions in metres."""


def metre_decimals(motion: Motion) -> int:
    """Return how many decimals tables give positions in metres, such as 5 for a dog or a cheetah and 6 for a mouse.

    The last decimal is at most a thousandth of the typical distance between a keypoint and its joint.
    """
    return int(np.clip(np.ceil(-np.log10(motion.body.keypoint_sigma_m / 1000)), MIN_METRE, MAX_METRE))


def _rounded(values: np.ndarray, decimals: int) -> np.ndarray:
    """Return floats rounded, without negative zeros, and other types unchanged."""
    return np.round(values, decimals) + 0.0 if values.dtype.kind == "f" else values


def _rounded_sigma(sigma: np.ndarray, decimals: int) -> np.ndarray:
    """Return standard deviations with `SIGMA_DIGITS` significant digits, and at most `decimals` decimals."""
    with np.errstate(divide="ignore"):
        exponent = np.floor(np.log10(sigma))
    step = 10.0 ** np.clip(SIGMA_DIGITS - 1 - exponent, 0, decimals)
    return np.round(sigma * step) / step


def pose3d(motion: Motion, path: Path) -> None:
    """Write a table with one row per frame: x, y, z of each joint, m, in the motion's frame of reference."""
    _write_points(path, motion, ("x", "y", "z"), _rounded(motion.joints_m, metre_decimals(motion)))


def pose3d_sigma(motion: Motion, path: Path) -> None:
    """Write the standard deviations of each joint's position in metres along the axes of the frame of reference.

    The table also has the standard deviations of the position relative to the mean of all joints.
    """
    coords = ("x_sigma", "y_sigma", "z_sigma", "x_rel", "y_rel", "z_rel")
    sigmas_m = np.concatenate((motion.joint_sigma_m, motion.relative_sigma_m), axis=2)
    _write_points(path, motion, coords, _rounded_sigma(sigmas_m, metre_decimals(motion)))


def angles(motion: Motion, path: Path) -> None:
    """Write a table with one row per frame and one column per component of the fitted state, in rad or metres."""
    columns = [name if name.endswith("_m") else f"{name}_rad" for name in motion.state_names]
    is_angle = np.array([not name.endswith("_m") for name in motion.state_names])
    angles_rad, positions_m = _rounded(motion.states, ANGLE), _rounded(motion.states, metre_decimals(motion))
    write_table(path, [["frame", *columns]], motion.frames, np.where(is_angle, angles_rad, positions_m))


def angles_sigma(motion: Motion, path: Path) -> None:
    """Write each angle's standard deviation in rad, and the fraction of its precision that comes from the pixels."""
    columns = [f"{name}_{kind}" for kind in ("sigma_rad", "data_share") for name in motion.angle_names]
    solution = motion.solution
    values = (_rounded_sigma(solution.angle_sigma_rad, ANGLE), _rounded(solution.angle_data_share, SHARE))
    write_table(path, [["frame", *columns]], motion.frames, np.hstack(values))


def quality(motion: Motion, path: Path) -> None:
    """Write the flags of each frame, separated by semicolons, and the numbers on which the flags are based."""
    flags = [";".join(flags) for flags in motion.flags]
    values = {name: np.asarray(getattr(motion, name)) for name in QUALITY_COLUMNS[2:-1]}
    values[QUALITY_COLUMNS[-1]] = frame_rms_m(motion)
    decimals = {name: metre_decimals(motion) if name.endswith("_m") else SHARE for name in values}
    numbers = (_rounded(column, decimals[name]).tolist() for name, column in values.items())
    write_rows(path, [QUALITY_COLUMNS], zip(motion.frames.tolist(), flags, *numbers, strict=True))


def reprojection(motion: Motion, path: Path, camera: int = 0) -> None:
    """Write the joints projected into a camera's picture in DeepLabCut's format, in pixels with likelihood 1.

    For frames without a pose and joints that the camera cannot see, x and y are empty and the likelihood is 0.
    """
    xy_px = _rounded(motion.pictures[camera].reprojected_px, PIXEL)
    likelihood = np.isfinite(xy_px).all(axis=-1, keepdims=True)
    values = np.concatenate([np.where(likelihood, xy_px, np.nan), likelihood], axis=-1)
    _write_points(path, motion, ("x", "y", "likelihood"), values, scorer="recon")


TO_CORRECT_COLUMNS = (
    *("rank", "frame", "camera", "keypoint", "reason", "found_x_px", "found_y_px", "likelihood"),
    *("expected_x_px", "expected_y_px", "distance_px", "sigma_major_px", "sigma_minor_px", "sigma_angle_deg"),
    "pose_error_fall_mm",
)


def to_correct(motion: Motion, path: Path) -> None:
    """Write the detections that should be corrected by hand, the most useful corrections first.

    Frames are numbered as in the camera's keypoint file. The sigmas are the half axes of the one-sigma ellipse around
    the expected position.
    """
    rows = [
        (
            *(rank, point.frame, point.camera, point.keypoint, point.reason),
            *(round(value, 2) for value in (point.found_px or (np.nan, np.nan))),
            round(point.likelihood, 3),
            *(round(value, 2) for value in (*point.expected_px, point.distance_px, *point.ellipse_px)),
            float(f"{1000.0 * point.error_fall_m:.3g}"),
        )
        for rank, point in enumerate(worth_correcting(motion), start=1)
    ]
    write_rows(path, [TO_CORRECT_COLUMNS], rows)


SHAPE = "shape.csv"
"""File name of the table of lengths and keypoint offsets, if the fit estimated them."""
SHAPE_COLUMNS = "quantity", "name", "axis", "value_m", "sigma_m", "expected_m"


def shape(motion: Motion, path: Path) -> None:
    """Write the estimated lengths and keypoint offsets with standard deviations and expected values, in metres."""
    solved = getattr(motion.solution, "shape", None)
    if solved is None:
        return
    lengths = _rounded(np.stack([solved.lengths_m, solved.lengths_sigma_m, solved.expected_lengths_m], axis=1), LENGTH)
    rows = [("length", name, "", *values) for name, values in zip(solved.names, lengths, strict=True)]
    offsets = _rounded(np.stack([solved.offsets_m, solved.offsets_sigma_m, solved.expected_offsets_m], axis=2), LENGTH)
    for name, of_axes in zip(motion.joints, offsets, strict=True):
        rows += [("offset", name, axis, *values) for axis, values in zip("xyz", of_axes, strict=True)]
    write_rows(path, [SHAPE_COLUMNS], rows)


_EVERY_CLIP = pose3d, angles, quality, pose3d_sigma, angles_sigma, to_correct
CLIP_OUTPUTS: dict[str, Callable[[Motion, Path], None]] = {f"{table.__name__}.csv": table for table in _EVERY_CLIP}
"""Functions that write the tables of every clip, by file name."""

REPROJECTION = "reprojection.csv"
"""File name of a single camera's table of reprojections. For several cameras, `camera_files` gives the names."""


def write_tables(motion: Motion, folder: Path) -> None:
    """Write every table of a motion into an existing folder."""
    for name, write in CLIP_OUTPUTS.items():
        write(motion, folder / name)
    shape(motion, folder / SHAPE)
    for camera, file in enumerate(camera_files([picture.name for picture in motion.pictures])):
        reprojection(motion, folder / file, camera)


def camera_files(cameras: Sequence[str]) -> list[str]:
    """Return the file name of each camera's table of reprojections, such as reprojection_cam1.csv."""
    if len(cameras) == 1:
        return [REPROJECTION]
    files: list[str] = []
    for number, camera in enumerate(cameras, start=1):
        name = re.sub(r"[^\w.-]+", "-", camera) or str(number)
        # Two cameras' names may differ only in characters that file names cannot contain or some systems do not
        # distinguish.
        is_taken = any(f"reprojection_{name}.csv".lower() == file.lower() for file in files)
        files.append(f"reprojection_{name}-{number}.csv" if is_taken else f"reprojection_{name}.csv")
    return files


def reprojection_files(folder: Path) -> list[str]:
    """Return the names of the reprojection tables in a folder, sorted."""
    return sorted(path.name for path in folder.glob("reprojection_*.csv"))


def _write_points(path: Path, motion: Motion, coords: Sequence[str], values: np.ndarray, scorer: str = "") -> None:
    """Write values (T, J, C) in DeepLabCut's layout, with header rows `bodyparts`, `coords` and, if given, `scorer`."""
    header = [
        ["bodyparts", *(name for name in motion.names for _ in coords)],
        ["coords", *(coord for _ in motion.names for coord in coords)],
    ]
    if scorer:
        header.insert(0, ["scorer"] + [scorer] * (len(header[0]) - 1))
    write_table(path, header, motion.frames, values.reshape(len(motion.frames), -1))


UNITS = {
    "m_s2": "m/s²",
    "m2_s": "m²/s",
    "rad_s2": "rad/s²",
    "m_s": "m/s",
    "rad_s": "rad/s",
    "j_kg": "J/kg",
    "w_kg": "W/kg",
    "bw_s": "body weight × s",
    "n_s": "N s",
    "bw": "body weight",
    "deg": "°",
    "rad": "rad",
    "hz": "Hz",
    "m": "m",
    "s": "s",
    "n": "N",
    "percent": "%",
}
"""Unit for each suffix of a column's name."""
_DECIMALS = {
    "m/s": 4,
    "m/s²": 3,
    "m²/s": 5,
    "rad": ANGLE,
    "rad/s": 4,
    "rad/s²": 3,
    "°": 3,
    "s": 6,
    "Hz": 4,
    "J/kg": 4,
    "W/kg": 4,
    "body weight": 4,
    "body weight × s": 5,
    "N": 2,
    "N s": 3,
}
"""Number of decimals of each unit except metres in tables of an analysis.

For metres, `metre_decimals` returns the number. Rounding is much finer than the standard deviations of clips of several
cameras.
"""
WITHOUT_UNIT = 5
"""Number of decimals of fractions, phases, and quantities whose unit is not in the column's name."""

Rows = Iterable[Sequence[Any]]
Table = tuple[Sequence[str], Rows]
"""Names of a table's columns, and its rows."""
Columns = dict[str, np.ndarray]
"""Columns of a table that has one row for each frame or sample, keyed by the columns' names."""


def joints(analysis: ClipAnalysis) -> Table:
    """Return a table with distance, mean speed, peak speed and peak acceleration of every joint."""
    columns = "distance_m, mean_speed_m_s, peak_speed_m_s, peak_speed_sigma_m_s, peak_speed_time_s, "
    names = (columns + "peak_acceleration_m_s2, peak_acceleration_sigma_m_s2").split(", ")
    is_known = analysis.why_no_speed is None
    rows = [
        (joint, *(getattr(motion, name) if is_known else np.nan for name in names), _yes(is_known))
        for joint, motion in analysis.joints.items()
    ]
    return ["joint", *names, "known"], rows


def reference(analysis: ClipAnalysis) -> Columns:
    """Return position, velocity and acceleration of the reference joint, with ten samples per frame."""
    motion = analysis.joints[analysis.reference]
    series = motion.series
    columns = {"time_s": series.time_s, "frame": series.time_s * analysis.motion.fps} | _axes("{}_m", series.value)
    columns |= _axes("v{}_m_s", series.rate) | _axes("a{}_m_s2", series.acceleration)
    columns |= {"speed_m_s": motion.speed_m_s, "speed_sigma_m_s": motion.speed_sigma_m_s}
    columns["acceleration_m_s2"] = motion.acceleration_m_s2
    return columns | {"acceleration_sigma_m_s2": motion.acceleration_sigma_m_s2}


def velocities(analysis: ClipAnalysis) -> Columns:
    """Return velocities with standard deviations, and accelerations, of every joint at every frame."""
    columns = {"frame": analysis.pose.frames, "time_s": analysis.motion.time_s}
    for name, motion in analysis.joints.items():
        series = motion.series
        for column, values in (
            ("v{}_m_s", series.rate),
            ("v{}_sigma_m_s", series.rate_sigma),
            ("a{}_m_s2", series.acceleration),
        ):
            columns |= _axes(f"{name}_{column}", values[:: series.oversampling])
    return columns


def joint_angles(analysis: ClipAnalysis) -> Table:
    """Return the ranges and the peak rates of joint angles, of the spine's flexion and of the skeleton's angles."""
    names, shares = ("range_of_motion_rad", "peak_rate_rad_s", "peak_acceleration_rad_s2"), analysis.motion.data_shares
    rows = [
        (name, kind, *angle.range_rad, *(getattr(angle, field) for field in names), shares.get(name, np.nan))
        for kind, angles_of_kind in (("joint", analysis.angles), ("skeleton", analysis.skeleton_angles))
        for name, angle in angles_of_kind.items()
    ]
    return ["angle", "kind", "least_rad", "greatest_rad", *names, "data_share"], rows


def joint_flexion(analysis: ClipAnalysis) -> Columns:
    """Return the flexion of the anatomical joints in degrees at every frame, with standard deviations."""
    columns = {"frame": analysis.motion.frames, "time_s": analysis.motion.time_s}
    for flexion in analysis.flexions:
        columns[f"{flexion.name}_deg"] = np.degrees(flexion.angle_rad)
        columns[f"{flexion.name}_sigma_deg"] = np.degrees(flexion.sigma_rad)
    return columns


STRIDE_FLEXION_COLUMNS = (
    *("joint", "side", "foot", "percent", "flexion_deg", "posterior_low_deg", "posterior_high_deg"),
    *("between_strides_low_deg", "between_strides_high_deg", "strides", "duty_factor"),
)


def joint_flexion_stride(analysis: ClipAnalysis) -> Columns:
    """Return the mean flexion of each joint in degrees at each percent of the stride, with 90 % bands.

    The bands show the uncertainty of the fit and the variation between strides.
    """
    parts: list[Columns] = []
    for curve in analysis.flexion_curves:
        texts = {"joint": curve.joint, "side": curve.side or "middle", "foot": curve.foot}
        part = {name: np.full(len(PERCENT), text) for name, text in texts.items()} | {"percent": PERCENT}
        part["flexion_deg"] = np.degrees(curve.mean_rad)
        reach = curve.between_reach_rad
        bands = {
            "posterior": interval_of(curve.mean_rad, curve.posterior_sigma_rad)[1:],
            "between_strides": (curve.mean_rad - reach, curve.mean_rad + reach),
        }
        for name, (low, high) in bands.items():
            part |= {f"{name}_low_deg": np.degrees(low), f"{name}_high_deg": np.degrees(high)}
        numbers = {"strides": curve.strides, "duty_factor": curve.duty_factor}
        parts.append(part | {name: np.full(len(PERCENT), number) for name, number in numbers.items()})
    return _stacked(parts, STRIDE_FLEXION_COLUMNS)


def joint_flexion_peaks(analysis: ClipAnalysis) -> Table:
    """Return the range, maximum and minimum of each joint's flexion over the stride, with 90 % intervals.

    The table also has the phase of each extreme in percent of the stride, with empty cells if it is unknown.
    """
    columns = ["joint", "side", "foot", "strides", "range_deg", "range_low_deg", "range_high_deg"]
    for name in ("greatest", "least"):
        columns += [f"{name}_deg", f"{name}_low_deg", f"{name}_high_deg"]
        columns += [f"{name}_percent", f"{name}_low_percent", f"{name}_high_percent"]
    rows = []
    for curve in analysis.flexion_curves:
        greatest, least = extreme(curve), extreme(curve, -1)
        range_sigma = np.hypot(greatest.sigma_rad, least.sigma_rad)
        angles_deg = np.degrees(interval_of(greatest.value_rad - least.value_rad, range_sigma)).tolist()
        cells = [max(0.0, angle) for angle in angles_deg]
        for item in (greatest, least):
            cells += np.degrees(interval_of(item.value_rad, item.sigma_rad)).tolist()
            cells += [item.percent, item.percent_low, item.percent_high]
        rows.append((curve.joint, curve.side or "middle", curve.foot, curve.strides, *cells))
    return columns, rows


def angle_rates(analysis: ClipAnalysis) -> Columns:
    """Return each angle, its rate and its angular acceleration at every frame, with standard deviations if known."""
    columns, has_sigma = {"frame": analysis.pose.frames, "time_s": analysis.motion.time_s}, not analysis.motion.jitters
    named: list[tuple[str, AngleKinematics, bool]] = [
        *(
            (f"{name}_angle" if name != "spine_flexion" else name, curve, has_sigma)
            for name, curve in analysis.angles.items()
        ),
        *((name, curve, True) for name, curve in analysis.skeleton_angles.items()),
    ]
    for name, angle, with_sigma in named:
        series, names = angle.series, ("rad", "sigma_rad", "rate_rad_s", "rate_sigma_rad_s", "acceleration_rad_s2")
        values = series.value, series.value_sigma, series.rate, series.rate_sigma, series.acceleration
        for column, samples in zip(names, values, strict=True):
            if with_sigma or "sigma" not in column:
                columns[f"{name}_{column}"] = samples[:: series.oversampling, 0]
    return columns


def stances(analysis: ClipAnalysis) -> Table:
    """Return a table with a row for each stance of each foot."""
    columns = "foot, joint, start_s, end_s, start_frame, end_frame, duration_s, begins, ends, start_low_s, start_high_s"
    rows_of = np.arange(len(analysis.pose.frames))
    rows = [
        (
            *(s.foot, analysis.motion.foot_names[s.foot], s.start_s, s.end_s),
            *(float(np.interp(row, rows_of, analysis.pose.frames)) for row in (s.start_row, s.end_row)),
            s.duration_s,
            *(_yes(s.begins), _yes(s.ends), *s.start_interval_s, *s.end_interval_s),
        )
        for s in (analysis.gait.stances if analysis.gait else ())
    ]
    return [*columns.split(", "), "end_low_s", "end_high_s"], rows


def strides(analysis: ClipAnalysis) -> Table:
    """Return a table with a row for each complete stride.

    For a skeleton with masses, the table also has the changes of energy, with 90 % intervals.
    """
    names = ["foot", "at", "start_s", "end_s", "duration_s", "length_m", "frequency_hz", "duty_factor"]
    rows = map(attrgetter(*names), analysis.gait.strides if analysis.gait else ())
    if analysis.dynamics is None:
        return names, rows
    head = [f"{name}{end}{unit}" for name, unit in OVER_STRIDE.items() for end in ("", "_low", "_high")]
    extra_columns = [np.ravel([*changes.values()]) for changes in analysis.over_strides]
    return [*names, *head], [(*row, *extra) for row, extra in zip(rows, extra_columns, strict=True)]


def gait(analysis: ClipAnalysis) -> Table:
    """Return a table of one row with the gait's name, its criterion, and means over complete strides.

    The row is missing if the skeleton has no feet. If there are no complete strides, the means follow from the period
    of the motion, as the column `source` states.
    """
    columns = "gait, criterion, speed_m_s, strides, source, stride_length_m, stride_frequency_hz, duty_factor, "
    columns += "duty_factor_low, duty_factor_high"
    feet, clip_gait, rows = analysis.motion.foot_names, analysis.gait, []
    if clip_gait is not None:
        quantities = analysis.quantities
        by_foot = [
            value
            for foot in feet
            for value in (quantities[f"duty_factor_{foot}"].value, clip_gait.name.phase.get(foot, np.nan))
        ]
        name, strides_count = clip_gait.name, len(clip_gait.strides)
        length, frequency, duty = (
            quantities[column] for column in ("stride_length_m", "stride_frequency_hz", "duty_factor")
        )
        first_cells = name.name, name.criterion, quantities["speed_m_s"].value, strides_count, length.source
        means = length.value, frequency.value, duty.value, *duty.interval
        rows.append((*first_cells, *means, *by_foot, " ".join(clip_gait.order)))
    columns += "".join(f", duty_factor_{foot}, phase_{foot}" for foot in feet) + ", footfalls"
    return columns.split(", "), rows


def gait_quantities(analysis: ClipAnalysis) -> Table:
    """Return a table with a row for each quantity of the gait: speed, strides, steps, limb phases and asymmetry.

    `sigma` is the standard deviation, and `low` and `high` are the ends of the 90 % interval. Both include the errors
    of the animal's size and of the focal length. `between_strides` is the standard deviation between strides.
    """
    rows = [
        (q.name, q.value, q.sigma, *q.interval, q.between_sigma, q.count, q.source, q.why_unknown)
        for q in analysis.quantities.values()
    ]
    return ["quantity", "estimate", "sigma", "low", "high", "between_strides", "n", "source", "why_unknown"], rows


VECTOR_COLUMNS = (
    *("limb", "link", "parent", "frame", "time_s", "x_m", "y_m", "z_m", "dx_m_s", "dy_m_s", "dz_m_s"),
    *("radius_m", "dr_m_s", "dtheta_rad_s", "speed_m_s", "dr_sigma_m_s", "dtheta_sigma_rad_s", "speed_sigma_m_s"),
)


def vector_field(analysis: ClipAnalysis) -> Columns:
    """Return the position and velocity of each link's tip in its parent's frame at every frame."""
    names, parts = VECTOR_COLUMNS[-7:], list[Columns]()
    for limb, field in ((limb, field) for limb, fields in analysis.fields.items() for field in fields):
        texts = {"limb": limb, "link": "-".join(field.link), "parent": "-".join(field.parent)}
        part = {name: np.full(len(analysis.pose.frames), text) for name, text in texts.items()}
        part |= {"frame": analysis.pose.frames, "time_s": analysis.motion.time_s}
        part |= _axes("{}_m", field.position_m) | _axes("d{}_m_s", field.velocity_m_s)
        parts.append(part | {name: getattr(field, name) + np.zeros(len(field.speed_m_s)) for name in names})
    return _stacked(parts, VECTOR_COLUMNS)


def vector_field_means(analysis: ClipAnalysis) -> Table:
    """Return the mean speeds and mean polar rates of each link's tip in its parent's frame."""
    rows = [(limb, *means) for limb, fields in analysis.fields.items() for means in map(means_of_field, fields)]
    return ["limb", *FieldMeans._fields], rows


def closures(analysis: ClipAnalysis) -> Table:
    """Return how nearly each angle of the skeleton returns to its value after one stride (degree of closure)."""
    kinds = "angle", "plane", "angle_sigma", "plane_sigma", "unscaled"
    shares, rows = analysis.motion.data_shares, []
    if (stride := analysis.stride) is not None:
        for name, closure in analysis.closures.items():
            rows.append(
                (
                    name,
                    stride.foot,
                    stride.start_s,
                    stride.end_s,
                    *(getattr(closure, kind) for kind in kinds),
                    shares[name],
                )
            )
    return ["angle", "foot", "start_s", "end_s", *(f"closure_{kind}_percent" for kind in kinds), "data_share"], rows


def centre_of_mass(analysis: ClipAnalysis) -> Columns:
    """Return the motion of the centre of mass, the angular momentum, and the energies, with ten samples per frame."""
    if (dynamics := analysis.dynamics) is None:
        return {}
    series = dynamics.centre.series
    columns = {"time_s": series.time_s} | _axes("{}_m", series.value)
    for name, points in (
        ("{}_sigma_m", series.value_sigma),
        ("v{}_m_s", series.rate),
        ("v{}_sigma_m_s", series.rate_sigma),
    ):
        columns |= _axes(name, points)
    columns |= _axes("angular_momentum_{}_m2_s", dynamics.angular_momentum)
    columns |= _axes("angular_momentum_{}_sigma_m2_s", dynamics.angular_momentum_sigma)
    columns |= {f"{name}_j_kg": values for name, values in dynamics.energy_j_kg.items()}
    columns |= {"energy_sigma_j_kg": dynamics.energy_sigma_j_kg["total"]}
    return columns | {
        f"{name}_sigma_j_kg": points for name, points in dynamics.energy_sigma_j_kg.items() if name != "total"
    }


def forces(analysis: ClipAnalysis) -> Table:
    """Return peak and impulse of the vertical force in every complete stance, per body weight, with 90 % intervals.

    If the animal's mass is known, the table has the same columns again with newtons instead of body weights.
    """
    columns: list[str] = [*StanceForce._fields]
    rows: list[tuple[Any, ...]] = [] if analysis.dynamics is None else [*analysis.dynamics.stance_forces]
    if analysis.body_mass_kg is not None:
        weight_n = analysis.body_mass_kg * G_M_S2
        columns += [name.replace("_bw", "_n") for name in columns[3:]]
        rows = [(*row, *(weight_n * value for value in row[3:])) for row in rows]
    return columns, rows


def force_over_time(analysis: ClipAnalysis) -> Columns:
    """Return the vertical force of every foot in body weights, with ten samples per frame.

    Cells are empty during stances that the clip cuts.
    """
    if (dynamics := analysis.dynamics) is None or analysis.gait is None:
        return {}
    columns = {"time_s": analysis.gait.tracks.time_s}
    for foot, force in dynamics.force.items():
        columns |= dict(zip((f"{foot}_bw", f"{foot}_low_bw", f"{foot}_high_bw"), force.T, strict=True))
    return columns


_MOTION = joints, reference, velocities, vector_field, vector_field_means
_ANGLES = joint_angles, joint_flexion, joint_flexion_stride, joint_flexion_peaks, angle_rates, closures
_GAIT = stances, strides, gait, gait_quantities, centre_of_mass, forces, force_over_time
TABLES: dict[str, Callable[[ClipAnalysis], Table | Columns]] = {
    f"{table.__name__}.csv": table for table in (*_MOTION, *_ANGLES, *_GAIT)
}
"""Functions that return the tables of an analysis, by file name."""


def unit_of(column: str) -> str:
    """Return the unit at the end of a column's name, or an empty string for fractions, counts and strings."""
    return next((unit for end, unit in UNITS.items() if column.endswith(f"_{end}")), "")


def table_content(analysis: ClipAnalysis, name: str) -> Table | Columns:
    """Return a table by its file name, with numbers rounded to the decimals of each column's unit."""
    content, metres = TABLES[name](analysis), metre_decimals(analysis.motion)

    def decimals(column: str) -> int:
        unit = unit_of(column)
        return metres if unit == "m" else _DECIMALS.get(unit, WITHOUT_UNIT)

    if isinstance(content, dict):
        return {column: _rounded(np.asarray(values), decimals(column)) for column, values in content.items()}
    columns, rows = content
    digits = [decimals(column) for column in columns]
    return columns, [
        [round(cell, n) + 0.0 if isinstance(cell, float) else cell for cell, n in zip(row, digits, strict=True)]
        for row in rows
    ]


def write_analysis(analysis: ClipAnalysis, folder: Path) -> None:
    """Write every table of an analysis into an existing folder."""
    for name in TABLES:
        content = table_content(analysis, name)
        if isinstance(content, dict):
            write_columns(folder / name, content)
        else:
            write_rows(folder / name, [content[0]], content[1])


def _stacked(parts: Sequence[Columns], names: Sequence[str]) -> Columns:
    """Concatenate tables by rows. Without tables, return an empty table with the columns `names`."""
    return {name: np.concatenate([part[name] for part in parts]) if parts else np.empty(0) for name in names}


def _axes(name: str, vectors: np.ndarray) -> Columns:
    """Return the components of vectors (N, 3) as columns named `name` with x, y or z for {}, as in "v{}_m_s"."""
    return {name.format(axis): column for axis, column in zip("xyz", vectors.T, strict=True)}


def _yes(value: bool) -> str:
    return "yes" if value else "no"
