"""The tables of `recon analyse`, from a `ClipAnalysis`. Columns: docs/gait.md."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from recon.analysis.clip import ClipAnalysis
from recon.analysis.gait import Gait
from recon.analysis.kinematics import AngleKinematics
from recon.analysis.phase import field_means
from recon.export.table import write_rows

Rows = Iterable[Sequence[Any]]
Table = tuple[Sequence[str], Rows]
"""Columns, and rows."""


def joints(found: ClipAnalysis) -> Table:
    """Distance, mean and peak speed and peak acceleration of every joint."""
    columns = (
        "joint, distance_m, mean_speed_m_s, peak_speed_m_s, peak_speed_sigma_m_s, peak_speed_time_s, "
        "peak_acceleration_m_s2, peak_acceleration_sigma_m_s2"
    )
    rows = [
        (
            *(name, moved.distance_m, moved.mean_speed_m_s, moved.peak_speed_m_s),
            *(_at_peak(moved.speed_m_s, moved.speed_sigma_m_s), moved.peak_speed_time_s),
            *(moved.peak_acceleration_m_s2, _at_peak(moved.acceleration_m_s2, moved.acceleration_sigma_m_s2)),
        )
        for name, moved in found.joints.items()
    ]
    return columns.split(", "), rows


def reference(found: ClipAnalysis) -> Table:
    """The reference joint on the fine grid."""
    moved = found.joints[found.reference]
    series = moved.series
    columns = ["time_s", "frame", *(f"{axis}_m" for axis in "xyz"), *(f"v{axis}_m_s" for axis in "xyz")]
    columns += [*(f"a{axis}_m_s2" for axis in "xyz"), "speed_m_s", "speed_sigma_m_s", "acceleration_m_s2"]
    frame = series.time_s * found.results.fps
    values = np.column_stack(
        (
            *(series.time_s, frame, series.value, series.rate, series.acceleration),
            *(moved.speed_m_s, _or_nan(moved.speed_sigma_m_s, frame)),
            *(moved.acceleration_m_s2, _or_nan(moved.acceleration_sigma_m_s2, frame)),
        )
    )
    return [*columns, "acceleration_sigma_m_s2"], values.tolist()


def velocities(found: ClipAnalysis) -> Table:
    """Velocity and acceleration vectors of every joint at every frame, and the velocities' standard deviations."""
    columns, values = ["frame", "time_s"], [found.pose.frames.astype(float), found.results.time_s]
    for name, moved in found.joints.items():
        s = moved.series
        for column, of in (("v{}_m_s", s.rate), ("v{}_sigma_m_s", s.rate_sigma), ("a{}_m_s2", s.acceleration)):
            if of is not None:
                columns += [f"{name}_{column.format(axis)}" for axis in "xyz"]
                values.append(of[:: s.oversampling])
    return columns, _by_frame(np.column_stack(values))


def angles(found: ClipAnalysis) -> Table:
    """Range of motion and peak rates: the angles at the joints and the spine's flexion, then the skeleton's own."""
    columns = "angle, kind, least_rad, greatest_rad, range_of_motion_rad, peak_rate_rad_s, peak_acceleration_rad_s2"
    shares = found.results.data_shares
    kinds = (("joint", found.angles), ("skeleton", found.skeleton_angles))
    rows = [
        (
            *(name, kind, *angle.range_rad, angle.range_of_motion_rad),
            *(angle.peak_rate_rad_s, angle.peak_acceleration_rad_s2),
            shares[name] if kind == "skeleton" else np.nan,
        )
        for kind, some in kinds
        for name, angle in some.items()
    ]
    return [*columns.split(", "), "data_share"], rows


def angle_rates(found: ClipAnalysis) -> Table:
    """Every angle, its rate and acceleration at every frame, with standard deviations where there are any."""
    columns, values = ["frame", "time_s"], [found.pose.frames.astype(float), found.results.time_s]
    named: list[tuple[str, AngleKinematics]] = [
        *((f"{name}_angle" if name != "spine_flexion" else name, angle) for name, angle in found.angles.items()),
        *found.skeleton_angles.items(),
    ]
    for name, angle in named:
        s = angle.series
        for column, of in (
            ("rad", s.value),
            ("sigma_rad", s.value_sigma),
            ("rate_rad_s", s.rate),
            ("rate_sigma_rad_s", s.rate_sigma),
            ("acceleration_rad_s2", s.acceleration),
        ):
            if of is not None:
                columns.append(f"{name}_{column}")
                values.append(of[:: s.oversampling, 0])
    return columns, _by_frame(np.column_stack(values))


def stances(found: ClipAnalysis) -> Table:
    """Every stance by both methods; `pair` numbers those that both found."""
    columns = "method, foot, joint, start_s, end_s, start_frame, end_frame, duration_s, begins, ends, pair"
    pair = {id(stance): i for i, two in enumerate(found.match.pairs if found.match else (), start=1) for stance in two}
    rows = [
        (
            *(method, s.foot, found.results.feet[s.foot], s.start_s, s.end_s),
            *(file_frame(found, s.start_frame), file_frame(found, s.end_frame), s.duration_s),
            *(_yes(s.begins), _yes(s.ends), pair.get(id(s), "")),
        )
        for method, gait in found.gaits.items()
        for s in gait.stances
    ]
    return columns.split(", "), rows


def strides(found: ClipAnalysis) -> Table:
    """Every complete stride by both methods."""
    columns = "method, foot, at, start_s, end_s, duration_s, length_m, frequency_hz, duty_factor"
    rows = [
        (method, s.foot, s.at, s.start_s, s.end_s, s.end_s - s.start_s, s.length_m, s.frequency_hz, s.duty_factor)
        for method, gait in found.gaits.items()
        for s in gait.strides
    ]
    return columns.split(", "), rows


def gait(found: ClipAnalysis) -> Table:
    """One row a method: the gait's name and criterion, and means over complete strides."""
    columns = "method, gait, criterion, speed_m_s, strides, stride_length_m, stride_frequency_hz, duty_factor"
    feet = list(found.results.feet)
    columns += "".join(f", duty_factor_{foot}, phase_{foot}" for foot in feet) + ", footfalls"
    return columns.split(", "), [_gait_row(method, one, feet) for method, one in found.gaits.items()]


def vector_field(found: ClipAnalysis) -> Table:
    """Every link at every frame: its tip in its parent's frame, and how it moves there."""
    columns = "limb, link, parent, frame, time_s, x_m, y_m, z_m, dx_m_s, dy_m_s, dz_m_s, radius_m, dr_m_s, dtheta_rad_s"
    deviations = ("dr_sigma_m_s", "dtheta_sigma_rad_s", "speed_sigma_m_s")
    rows = []
    for limb, fields in found.fields.items():
        for f in fields:
            sigma = [_or_nan(getattr(f, name), f.speed_m_s) for name in deviations]
            values = np.column_stack(
                (f.position_m, f.velocity_m_s, f.radius_m, f.dr_m_s, f.dtheta_rad_s, f.speed_m_s, *sigma)
            )
            times = zip(found.pose.frames.tolist(), found.results.time_s.tolist(), values.tolist(), strict=True)
            rows += [(limb, "-".join(f.link), "-".join(f.parent), n, t, *row) for n, t, row in times]
    return [*columns.split(", "), "speed_m_s", *deviations], rows


def vector_field_means(found: ClipAnalysis) -> Table:
    """Mean magnitudes over the frames."""
    columns = "limb, link, parent, speed_m_s, speed_3d_m_s, dr_m_s, dtheta_rad_s, speed_sigma_m_s, frames"
    rows = [
        (
            *(limb, "-".join(m.link), "-".join(m.parent), m.speed_m_s, m.speed_3d_m_s),
            *(m.dr_m_s, m.dtheta_rad_s, m.speed_sigma_m_s, m.frames),
        )
        for limb, fields in found.fields.items()
        for m in field_means(fields)
    ]
    return columns.split(", "), rows


def closures(found: ClipAnalysis) -> Table:
    """Degrees of closure of the skeleton's angles over one stride."""
    columns = (
        "angle, foot, start_s, end_s, closure_angle_percent, closure_plane_percent, closure_angle_sigma_percent, "
        "closure_plane_sigma_percent, data_share"
    )
    rows = []
    if (s := found.stride) is not None:
        shares = found.results.data_shares
        rows = [
            (name, s.foot, s.start_s, s.end_s, c.angle, c.plane, c.angle_sigma, c.plane_sigma, shares[name])
            for name, c in found.closures.items()
        ]
    return columns.split(", "), rows


TABLES: dict[str, Callable[[ClipAnalysis], Table]] = {
    "joints.csv": joints,
    "reference.csv": reference,
    "velocities.csv": velocities,
    "joint_angles.csv": angles,
    "angle_rates.csv": angle_rates,
    "stances.csv": stances,
    "strides.csv": strides,
    "gait.csv": gait,
    "vector_field.csv": vector_field,
    "vector_field_means.csv": vector_field_means,
    "closures.csv": closures,
}
"""By file name: columns and rows."""


def write(found: ClipAnalysis, folder: Path) -> None:
    """Every table, into a folder that exists."""
    for name, table in TABLES.items():
        columns, rows = table(found)
        write_rows(folder / name, [columns], rows)


def file_frame(found: ClipAnalysis, row: float) -> float:
    """The frame number of the keypoint file, with a fraction, of a row of the clip."""
    return float(np.interp(row, np.arange(len(found.pose.frames)), found.pose.frames))


def _gait_row(method: str, one: Gait, feet: list[str]) -> Sequence[Any]:
    name = one.name
    by_foot = [value for f in feet for value in (one.duty_factor.get(f, np.nan), name.phase.get(f, np.nan))]
    return (
        *(method, name.name, name.criterion, one.speed_m_s, len(one.strides), one.stride_length_m),
        *(one.stride_frequency_hz, name.duty_factor, *by_foot, " ".join(one.order)),
    )


def _by_frame(values: np.ndarray) -> Rows:
    return [(int(row[0]), *row[1:]) for row in values.tolist()]


def _at_peak(values: np.ndarray, sigma: np.ndarray | None) -> float:
    """The standard deviation where the values are largest; NaN without."""
    return np.nan if sigma is None or not np.isfinite(values).any() else float(sigma[np.nanargmax(values)])


def _or_nan(values: np.ndarray | None, like: np.ndarray) -> np.ndarray:
    return np.full(like.shape, np.nan) if values is None else values


def _yes(value: bool) -> str:
    return "yes" if value else "no"
