"""The tables of a fit (docs/report.md), a function of a motion and a path for each; and those of `recon analyse`
(docs/gait.md), a function of a `ClipAnalysis` that gives the table.

They are written in place; `recon.base.files.staged_folder` makes a folder of them appear whole or not at all.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from recon.fit.motion import Motion
from recon.gait import FORCE_COLUMNS, G_M_S2, OVER_STRIDE, ClipAnalysis, field_means, over_stride
from recon.gait.kinematics import AngleKinematics
from recon.io.writing import write_columns, write_rows, write_table

QUALITY_COLUMNS = ("frame", "flags", "alternative_m", "detections", "mean_weight", "place_sigma_m", "relative_rms_m")


def pose3d(motion: Motion, path: Path) -> None:
    """x, y, z in metres of each joint, under its keypoint's name, in the motion's frame of reference."""
    _write_points(path, motion, ("x", "y", "z"), motion.joints_m)


def pose3d_sigma(motion: Motion, path: Path) -> None:
    """Standard deviations in metres along the axes of the frame of reference, for each joint: of its position, and of
    its position relative to the mean of all joints."""
    coords = ("x_sigma", "y_sigma", "z_sigma", "x_rel", "y_rel", "z_rel")
    _write_points(path, motion, coords, np.concatenate((motion.joint_sigma_m, motion.relative_sigma_m), axis=2))


def angles(motion: Motion, path: Path) -> None:
    """The whole state, in its order: angles in rad, the place in metres."""
    columns = [name if name.endswith("_m") else f"{name}_rad" for name in motion.state_names]
    write_table(path, [["frame", *columns]], motion.frames, motion.states)


def angles_sigma(motion: Motion, path: Path) -> None:
    """The standard deviation of every angle of angles.csv, then every angle's information fraction."""
    columns = [f"{name}_{what}" for what in ("sigma_rad", "data_share") for name in motion.angle_names]
    values = np.hstack((motion.solution.angle_sigma_rad, motion.solution.angle_data_share))
    write_table(path, [["frame", *columns]], motion.frames, values)


def quality(motion: Motion, path: Path) -> None:
    """What is doubtful about each frame: flags, separated by semicolons, and the numbers behind them."""
    flags = [";".join(flags) for flags in motion.flags]
    columns = (motion.frames, flags, *(getattr(motion, name) for name in QUALITY_COLUMNS[2:]))
    write_rows(path, [QUALITY_COLUMNS], zip(*columns, strict=True))


def reprojection(motion: Motion, path: Path, camera: int = 0) -> None:
    """The joints in the picture of one of the motion's cameras, as a file of DeepLabCut's: x, y in pixels and a
    likelihood of 1; without a pose, or where the camera cannot see it, empty and 0."""
    xy_px = motion.pictures[camera].reprojected_px
    likelihood = np.isfinite(xy_px).all(axis=-1, keepdims=True)
    values = np.concatenate([np.where(likelihood, xy_px, np.nan), likelihood], axis=-1)
    _write_points(path, motion, ("x", "y", "likelihood"), values, scorer="recon")


_EVERY_CLIP = pose3d, angles, quality, pose3d_sigma, angles_sigma
CLIP_OUTPUTS: dict[str, Callable[[Motion, Path], None]] = {f"{table.__name__}.csv": table for table in _EVERY_CLIP}
"""The tables that every clip gets, by file name."""

REPROJECTION = "reprojection.csv"
"""The table that every clip gets for each camera, which is named in it where there are several (`camera_files`)."""


def write_tables(motion: Motion, folder: Path) -> None:
    """Every table of a motion, into a folder that exists."""
    for name, write in CLIP_OUTPUTS.items():
        write(motion, folder / name)
    for camera, file in enumerate(camera_files([picture.name for picture in motion.pictures])):
        reprojection(motion, folder / file, camera)


def camera_files(cameras: Sequence[str]) -> list[str]:
    """`REPROJECTION` of each of these cameras: reprojection.csv, or reprojection_cam1.csv ..."""
    if len(cameras) == 1:
        return [REPROJECTION]
    files: list[str] = []
    for number, camera in enumerate(cameras, start=1):
        name = re.sub(r"[^\w.-]+", "-", camera) or str(number)
        # Names that differ in letters that a file's name cannot have, or that some systems take for the same.
        twice = any(f"reprojection_{name}.csv".lower() == file.lower() for file in files)
        files.append(f"reprojection_{name}-{number}.csv" if twice else f"reprojection_{name}.csv")
    return files


def of_any_camera(folder: Path) -> list[str]:
    """The files in a folder that are called like `REPROJECTION` of some camera."""
    return sorted(path.name for path in folder.glob("reprojection_*.csv"))


def _write_points(path: Path, motion: Motion, coords: Sequence[str], values: np.ndarray, scorer: str = "") -> None:
    """DeepLabCut's layout: header rows `bodyparts, coords`, before them `scorer` if there is one. values (T, J, C)."""
    header = [
        ["bodyparts", *(name for name in motion.names for _ in coords)],
        ["coords", *(coord for _ in motion.names for coord in coords)],
    ]
    if scorer:
        header.insert(0, ["scorer"] + [scorer] * (len(header[0]) - 1))
    write_table(path, header, motion.frames, values.reshape(len(motion.frames), -1))


# -- of an analysis ----------------------------------------------------------------------------------------------------

Rows = Iterable[Sequence[Any]]
Table = tuple[Sequence[str], Rows]
"""The columns and rows of a table."""
Columns = dict[str, np.ndarray]
"""The same of a long table, by column."""


def joints(found: ClipAnalysis) -> Table:
    """Distance, mean and peak speed and peak acceleration of every joint; empty where none is known."""
    columns = "distance_m, mean_speed_m_s, peak_speed_m_s, peak_speed_sigma_m_s, peak_speed_time_s, "
    names = (columns + "peak_acceleration_m_s2, peak_acceleration_sigma_m_s2").split(", ")
    known = found.why_no_speed is None
    rows = [
        (joint, *(getattr(moved, name) if known else np.nan for name in names), _yes(known))
        for joint, moved in found.joints.items()
    ]
    return ["joint", *names, "known"], rows


def reference(found: ClipAnalysis) -> Columns:
    """The reference joint on the fine grid."""
    moved = found.joints[found.reference]
    series = moved.series
    columns = {"time_s": series.time_s, "frame": series.time_s * found.motion.fps} | _axes("{}_m", series.value)
    columns |= _axes("v{}_m_s", series.rate) | _axes("a{}_m_s2", series.acceleration)
    columns |= {"speed_m_s": moved.speed_m_s, "speed_sigma_m_s": moved.speed_sigma_m_s}
    columns["acceleration_m_s2"] = moved.acceleration_m_s2
    return columns | {"acceleration_sigma_m_s2": moved.acceleration_sigma_m_s2}


def velocities(found: ClipAnalysis) -> Columns:
    """Velocity and acceleration vectors of every joint at every frame, and the velocities' standard deviations."""
    columns = {"frame": found.pose.frames, "time_s": found.motion.time_s}
    for name, moved in found.joints.items():
        s = moved.series
        for column, of in (("v{}_m_s", s.rate), ("v{}_sigma_m_s", s.rate_sigma), ("a{}_m_s2", s.acceleration)):
            columns |= _axes(f"{name}_{column}", of[:: s.oversampling])
    return columns


def joint_angles(found: ClipAnalysis) -> Table:
    """Range of motion and peak rates: the angles at the joints and the spine's flexion, then the skeleton's own."""
    names, shares = ("range_of_motion_rad", "peak_rate_rad_s", "peak_acceleration_rad_s2"), found.motion.data_shares
    rows = [
        (name, kind, *angle.range_rad, *(getattr(angle, one) for one in names), shares.get(name, np.nan))
        for kind, some in (("joint", found.angles), ("skeleton", found.skeleton_angles))
        for name, angle in some.items()
    ]
    return ["angle", "kind", "least_rad", "greatest_rad", *names, "data_share"], rows


def angle_rates(found: ClipAnalysis) -> Columns:
    """Every angle, its rate and acceleration at every frame, with standard deviations where there are any."""
    columns, stated = {"frame": found.pose.frames, "time_s": found.motion.time_s}, not found.motion.jitters
    named: list[tuple[str, AngleKinematics, bool]] = [
        *((f"{name}_angle" if name != "spine_flexion" else name, of, stated) for name, of in found.angles.items()),
        *((name, of, True) for name, of in found.skeleton_angles.items()),
    ]
    for name, angle, with_sigma in named:
        s, names = angle.series, ("rad", "sigma_rad", "rate_rad_s", "rate_sigma_rad_s", "acceleration_rad_s2")
        values = s.value, s.value_sigma, s.rate, s.rate_sigma, s.acceleration
        for column, of in zip(names, values, strict=True):
            if with_sigma or "sigma" not in column:
                columns[f"{name}_{column}"] = of[:: s.oversampling, 0]
    return columns


def stances(found: ClipAnalysis) -> Table:
    """A table of every stance."""
    columns = "foot, joint, start_s, end_s, start_frame, end_frame, duration_s, begins, ends, start_low_s, start_high_s"
    rows_of = np.arange(len(found.pose.frames))
    rows = [
        (
            *(s.foot, found.motion.foot_names[s.foot], s.start_s, s.end_s),
            *(float(np.interp(at, rows_of, found.pose.frames)) for at in (s.start_frame, s.end_frame)),
            s.duration_s,
            *(_yes(s.begins), _yes(s.ends), *s.start_interval_s, *s.end_interval_s),
        )
        for s in (found.gait.stances if found.gait else ())
    ]
    return [*columns.split(", "), "end_low_s", "end_high_s"], rows


def strides(found: ClipAnalysis) -> Table:
    """A table of every complete stride; of a skeleton with masses what its energy changes, with intervals of 90 %."""
    names = ["foot", "at", "start_s", "end_s", "duration_s", "length_m", "frequency_hz", "duty_factor"]
    own, d = found.gait.strides if found.gait else (), found.dynamics
    rows = map(attrgetter(*names), own)
    if d is None:
        return names, rows
    head = [f"{name}{end}{unit}" for name, unit in OVER_STRIDE.items() for end in ("", "_low", "_high")]
    more = [np.ravel([*over_stride(d, stride.start_s, stride.end_s).values()]) for stride in own]
    return [*names, *head], [(*row, *of_row) for row, of_row in zip(rows, more, strict=True)]


def gait(found: ClipAnalysis) -> Table:
    """One row: the gait's name and criterion, and what complete strides have in the mean; none without feet."""
    columns = "gait, criterion, speed_m_s, strides, stride_length_m, stride_frequency_hz, duty_factor, "
    columns += "duty_factor_low, duty_factor_high"
    feet, of, rows = found.motion.foot_names, found.gait, []
    if of is not None:
        by_foot = [value for f in feet for value in (of.duty_factor.get(f, np.nan), of.name.phase.get(f, np.nan))]
        named = of.name.name, of.name.criterion, of.speed_m_s, len(of.strides), of.stride_length_m
        means = of.stride_frequency_hz, of.name.duty_factor, *of.name.duty_interval
        rows.append((*named, *means, *by_foot, " ".join(of.order)))
    columns += "".join(f", duty_factor_{foot}, phase_{foot}" for foot in feet) + ", footfalls"
    return columns.split(", "), rows


def vector_field(found: ClipAnalysis) -> Columns:
    """Every link at every frame: its tip in its parent's frame, and how it moves there."""
    names = ("radius_m", "dr_m_s", "dtheta_rad_s", "speed_m_s", "dr_sigma_m_s", "dtheta_sigma_rad_s", "speed_sigma_m_s")
    parts = []
    for limb, field in ((limb, field) for limb, fields in found.fields.items() for field in fields):
        texts = {"limb": limb, "link": "-".join(field.link), "parent": "-".join(field.parent)}
        part = {name: np.full(len(found.pose.frames), text) for name, text in texts.items()}
        part |= {"frame": found.pose.frames, "time_s": found.motion.time_s}
        part |= _axes("{}_m", field.position_m) | _axes("d{}_m_s", field.velocity_m_s)
        parts.append(part | {name: getattr(field, name) + np.zeros(len(field.speed_m_s)) for name in names})
    return {name: np.concatenate([part[name] for part in parts]) for name in (parts[0] if parts else ())}


def vector_field_means(found: ClipAnalysis) -> Table:
    """Mean magnitudes over the frames."""
    columns = "limb, link, parent, speed_m_s, speed_3d_m_s, dr_m_s, dtheta_rad_s, speed_sigma_m_s, frames"
    rows = [(limb, *row) for limb, of in found.fields.items() for row in field_means(of).itertuples(index=False)]
    return columns.split(", "), rows


def closures(found: ClipAnalysis) -> Table:
    """Degrees of closure of the skeleton's angles over one stride."""
    kinds, shares, rows = ("angle", "plane", "angle_sigma", "plane_sigma"), found.motion.data_shares, []
    if (s := found.stride) is not None:
        for name, of in found.closures.items():
            rows.append((name, s.foot, s.start_s, s.end_s, *(getattr(of, kind) for kind in kinds), shares[name]))
    return ["angle", "foot", "start_s", "end_s", *(f"closure_{kind}_percent" for kind in kinds), "data_share"], rows


def centre_of_mass(found: ClipAnalysis) -> Columns:
    """The centre of mass on the fine grid, and energies per kilogram."""
    if (d := found.dynamics) is None:
        return {}
    s = d.centre.series
    columns = {"time_s": s.time_s} | _axes("{}_m", s.value)
    for name, of in (("{}_sigma_m", s.value_sigma), ("v{}_m_s", s.rate), ("v{}_sigma_m_s", s.rate_sigma)):
        columns |= _axes(name, of)
    columns |= _axes("angular_momentum_{}_m2_s", d.angular_momentum)
    columns |= _axes("angular_momentum_{}_sigma_m2_s", d.angular_momentum_sigma)
    columns |= {f"{name}_j_kg": values for name, values in d.energy_j_kg.items()}
    columns |= {"energy_sigma_j_kg": d.energy_sigma_j_kg["total"]}
    return columns | {f"{name}_sigma_j_kg": of for name, of in d.energy_sigma_j_kg.items() if name != "total"}


def forces(found: ClipAnalysis) -> Table:
    """Peak and impulse of the vertical force of every whole stance, body weights, with intervals of 90 %; the same in
    newtons where the animal's mass is known."""
    head = [*FORCE_COLUMNS]
    rows = [] if found.dynamics is None else [*found.dynamics.forces.itertuples(index=False, name=None)]
    if found.body_mass_kg is not None:
        weight_n = found.body_mass_kg * G_M_S2
        head += [name.replace("_bw", "_n") for name in head[3:]]
        rows = [(*row, *(weight_n * value for value in row[3:])) for row in rows]
    return head, rows


def force_over_time(found: ClipAnalysis) -> Columns:
    """The vertical force of every foot on the fine grid, body weights; empty within stances that the clip cuts."""
    if (d := found.dynamics) is None or found.gait is None:
        return {}
    columns = {"time_s": found.gait.tracks.time_s}
    for foot, force in d.force.items():
        columns |= dict(zip((f"{foot}_bw", f"{foot}_low_bw", f"{foot}_high_bw"), force.T, strict=True))
    return columns


_MOTION = joints, reference, velocities, joint_angles, angle_rates, vector_field, vector_field_means, closures
_GAIT = stances, strides, gait, centre_of_mass, forces, force_over_time
TABLES: dict[str, Callable[[ClipAnalysis], Table | Columns]] = {f"{of.__name__}.csv": of for of in (*_MOTION, *_GAIT)}
"""The tables by their files' names, which are those of their functions."""


def write_analysis(found: ClipAnalysis, folder: Path) -> None:
    """Every table, into a folder that exists."""
    for name, table in TABLES.items():
        made = table(found)
        if isinstance(made, dict):
            write_columns(folder / name, made)
        else:
            write_rows(folder / name, [made[0]], made[1])


def _axes(name: str, vectors: np.ndarray) -> Columns:
    """The columns of vectors (N, 3)."""
    return {name.format(axis): column for axis, column in zip("xyz", vectors.T, strict=True)}


def _yes(value: bool) -> str:
    return "yes" if value else "no"
