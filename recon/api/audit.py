"""Read a file of keypoints or poses for `recon audit`, and audit it."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from recon.base.arrays import Array, Integers
from recon.base.errors import InputError, Problem
from recon.base.numbers import counted
from recon.check.audit import MIN_FRAMES, audit
from recon.check.audited import AuditedPoints, resolution_of, roles_of
from recon.check.codes import finding, sentence, sort_findings
from recon.check.pose_checks import EXTENT_M
from recon.clip import mark_missing
from recon.fit.motion import Motion
from recon.fit.motion_forms import MOTION
from recon.fit.result import Finding
from recon.io.common import StoredPoints
from recon.io.formats import Format, as_keypoints, read_points, recognised
from recon.io.positions import PER_METRE, in_metres

LIKELIHOOD_MIN = 0.5
"""Likelihood below which an audit leaves out a detection, as a fit does."""


@dataclass(frozen=True)
class Audit:
    """Findings on one file of points."""

    source: Path
    content: str
    """Description of what the file holds."""
    points: AuditedPoints
    findings: tuple[Finding, ...]
    notes: tuple[str, ...] = ()
    """Assumptions made while reading the file, and a note if the file has too few frames to audit."""

    def table(self) -> pd.DataFrame:
        """Return one row per finding: code, severity, points, frames, measure, limit, and sentence."""
        rows = [
            {
                "code": item.code,
                "severity": item.severity,
                "points": " ".join(item.names("points")),
                "first_frame": item.frames[0] if item.frames else None,
                "last_frame": item.frames[1] - 1 if item.frames else None,
                "measure": item.numbers.get("measure"),
                "limit": item.numbers.get("limit"),
                "text": sentence(item),
            }
            for item in self.findings
        ]
        columns = ["code", "severity", "points", "first_frame", "last_frame", "measure", "limit", "text"]
        table = pd.DataFrame(rows, columns=columns)
        return table.astype({"first_frame": "Int64", "last_frame": "Int64"})


def audit_file(
    source: str | Path,
    fps: float | None = None,
    unit: str | None = None,
    up: str | None = None,
    individual: str | None = None,
    columns: Mapping[str, str] | None = None,
    likelihood_min: float = LIKELIHOOD_MIN,
) -> Audit:
    """Audit a file of 2D keypoints or 3D poses, or a folder of results.

    Parameters
    ----------
    source : path
        File in any format that recon reads, from any program.
    fps : float, optional
        Frames per second, if the file does not state a rate, or to check the stated one.
    unit, up : str, optional
        Unit (m, cm, mm) and upward axis (y, z) of 3D positions.
    individual : str, optional
        Name of the animal in a file with several animals.
    columns : mapping, optional
        Names of the columns of a plain table (see `recon.io.columns.parse_map`).
    likelihood_min : float
        Detections below this likelihood are left out.

    Returns
    -------
    Audit
        The findings, each with its frames and one thing to do. A file with too few frames has no findings, and a note
        says so.

    Raises
    ------
    InputError
        If the file or folder cannot be read.
    """
    path = Path(source)
    if path.is_dir() and (path / MOTION).is_file():
        motion = Motion.load(path)
        pose = motion.upright
        points = audited_points(pose.names, pose.xyz_m, pose.frames, fps or motion.fps)
        return Audit(path, "results of recon fit", points, audit(points))
    if path.is_dir():
        raise InputError(_folder_problem(path))
    reader, stored = read_points(path, individual, by=columns, fps=None)
    return audit_points(path, reader, stored, fps, unit, up, likelihood_min)


def _has_points(path: Path) -> bool:
    try:
        return path.is_file() and recognised(path) is not None
    except InputError:  # a damaged file
        return False


def _folder_problem(folder: Path) -> Problem:
    """Return the problem of a folder without results, with the name of a file or results folder in it to audit."""
    inside = sorted(path.parent for path in folder.glob(f"*/{MOTION}"))
    if inside:
        content = f"a folder of {counted(len(inside), 'result')}"
    else:
        inside = sorted(path for path in folder.iterdir() if _has_points(path))
        content = f"a folder with {counted(len(inside), 'file')} of points"
    if not inside:
        return Problem(folder, "file", "a folder without files of points", "a file of 2D keypoints or 3D poses")
    return Problem(folder, "file", content, f"one of them, as in: recon audit {shlex.quote(str(inside[0]))}")


def audit_points(
    path: Path,
    reader: Format,
    stored: StoredPoints,
    fps: float | None,
    unit: str | None,
    up: str | None,
    likelihood_min: float,
) -> Audit:
    """Audit points that were read from a file, with the parameters of `audit_file`."""
    findings = []
    rate = fps or stored.fps
    if fps is not None and stored.fps is not None and abs(fps / stored.fps - 1) > 0.01:
        findings.append(finding("frame_rate_stated", given_hz=fps, other_hz=stored.fps))
    resolution = resolution_of(stored.values)
    if stored.in_space:
        read_unit = unit or stored.unit or reader.unit or likely_unit(stored)
        pose = in_metres(path, reader, stored, None if read_unit == stored.unit else read_unit, up)
        per_metre = PER_METRE[read_unit]
        points = audited_points(pose.names, pose.xyz_m, pose.frames, rate, resolution / per_metre)
        if unit is None and stored.unit is None and reader.unit is None:
            findings.append(finding("unit_not_stated", unit=read_unit, extent_m=points.extent))
        if rate is None:
            findings.append(finding("frame_rate_not_stated"))
        content, notes = f"3D poses ({reader.title})", pose.notes
    else:
        keypoints, _ = mark_missing(as_keypoints(path, stored))
        is_unlikely = keypoints.confidence < likelihood_min
        xy_px = np.where(is_unlikely[..., None], np.nan, keypoints.xy_px)
        points = audited_points(keypoints.names, xy_px, keypoints.frames, rate, resolution)
        content, notes = f"2D keypoints ({reader.title})", keypoints.notes
    if len(points.frames) < MIN_FRAMES:
        notes = (*notes, f"{len(points.frames)} frames are too few for an audit.")
    return Audit(path, content, points, sort_findings([*findings, *audit(points)]), notes)


def audited_points(
    names: tuple[str, ...], values: Array, frames: Integers, fps: float | None, resolution: float = 0.0
) -> AuditedPoints:
    """Return points ready to audit, with the body parts that their names indicate."""
    return AuditedPoints(names, values, frames, fps, resolution, roles_of(names))


def likely_unit(stored: StoredPoints) -> str:
    """Return a unit in which the animal has a plausible size, or metres if there is none.

    If several units are plausible, metres take precedence, then millimetres.
    """
    extent = AuditedPoints(stored.names, stored.values, stored.frames).extent
    low_m, high_m = EXTENT_M
    fitting = [name for name in ("m", "mm", "cm") if low_m <= extent / PER_METRE[name] <= high_m]
    return fitting[0] if fitting else "m"
