"""From one file format to another: 2D keypoints among themselves, 3D positions among themselves, results to bones."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

from recon.animal.naming import load_names, renamed
from recon.base.errors import InputError, Problem, all_of
from recon.base.files import staged_file
from recon.clip.keypoints import Keypoints, mark_missing
from recon.fit.results import read_results
from recon.io import Format, Pose3D, as_keypoints, choose_format, in_metres, read_points
from recon.io.column_map import parse_map
from recon.io.common import rate
from recon.show.export.rig import rig_of


@dataclass(frozen=True)
class Options:
    """What the user says about a file."""

    fps: float | None = None
    """In place of the file's."""
    individual: str | None = None
    """Which animal."""
    columns: str | None = None
    """Of a plain CSV (see `recon.io.column_map`)."""
    unit: str | None = None
    """m, cm or mm: of 3D positions, where the file does not say."""
    up: str | None = None
    """y or z: of 3D positions, where the file does not say."""
    rename: str | None = None
    """A map of the names of 2D keypoints (see `recon.animal.naming`)."""


@dataclass(frozen=True, eq=False)
class Conversion:
    """What was read, and the format that it was written in."""

    data: Keypoints | Pose3D
    format: Format
    notes: tuple[str, ...]


def convert(
    source: str | Path, out: str | Path, to: str | None = None, options: Options | None = None, overwrite: bool = False
) -> Conversion:
    """Read a file, or a folder of results (its 3D positions), and write it as `out`, whole or not at all.

    to: the name of a format where the extension of `out` leaves a choice. A missing point is written as the format has
    it, whichever way the source had it. Raises InputError for what cannot be read or written.
    """
    source, out = Path(source), Path(out)
    data, target, _ = all_of(
        lambda: read_any(source, options or Options()),
        lambda: choose_format(out, to),
        lambda: _require_free(out, overwrite),
    )
    notes = data.notes
    if "bones" in target.writes:
        return _as_bones(source, data, target, out, overwrite)
    if isinstance(data, Keypoints):
        if "2D" not in target.writes:
            expected = f"3D positions for {target.title}: fit the clip first (recon fit)"
            raise InputError(Problem(source, "content", "2D keypoints", expected))
        data, missing = mark_missing(data)
        if zeros := missing["missing_zero_zero"].sum():
            notes += (f"{zeros} points that were stored as (0, 0) are missing ones.",)
    elif "3D" not in target.writes:
        raise InputError(Problem(source, "content", "3D positions", f"2D keypoints for {target.title}"))
    _write(target, data, out)
    return Conversion(data, target, notes)


def _as_bones(source: Path, data: Keypoints | Pose3D, target: Format, out: Path, overwrite: bool) -> Conversion:
    """data: what was read of the source."""
    if not source.is_dir():
        found = "2D keypoints" if isinstance(data, Keypoints) else "3D positions"
        expected = f"a folder of results of recon fit: {target.title} has bones, which turn"
        raise InputError(Problem(source, "content", found, expected))
    beside = [out.with_suffix(extension) for extension in target.beside]
    all_of(*(partial(_require_free, path, overwrite) for path in beside))
    rig = rig_of(read_results(source), data.fps)
    _write(target, rig, out)
    notes = data.notes + rig.notes
    if beside:
        notes += (f"Beside it: {', '.join(map(str, beside))}.",)
    return Conversion(rig.pose, target, notes)


def _write(target: Format, data: Any, out: Path) -> None:
    assert target.write is not None
    with staged_file(out) as staged:
        target.write(data, staged)


def read_any(source: Path, options: Options) -> Keypoints | Pose3D:
    """2D keypoints or 3D positions, whichever the source holds. Raises InputError."""
    if options.fps is not None and rate(options.fps) is None:
        raise InputError(Problem("--fps", "fps", f"{options.fps:g}", "frames per second above 0, as in 90"))
    if source.is_dir():
        data = _of_results(source)
    else:
        by = None if options.columns is None else parse_map(options.columns)
        found, stored = read_points(source, options.individual, by=by)
        if stored.in_space:
            data = in_metres(source, found, stored, options.unit, options.up)
        else:
            data = as_keypoints(source, stored)
    if options.rename is not None:
        if not isinstance(data, Keypoints):
            raise InputError(Problem("--rename", "names", f"3D positions in {source}", "2D keypoints"))
        data = renamed(data, load_names(options.rename))
    if options.fps is None or options.fps == data.fps:
        return data
    notes = data.notes
    if data.fps is not None:
        notes += (f"{data.fps:g} frames per second in the source, {options.fps:g} as given.",)
    return replace(data, fps=options.fps, notes=notes)


def _of_results(folder: Path) -> Pose3D:
    """The joints of a fit, upright, with their frame rate and limbs."""
    results = read_results(folder)
    names = results.pose.names
    edges = [(names[a], names[b]) for along in results.limbs.values() for a, b in pairwise(along)]
    notes = ()
    if not results.knows_up:
        notes = ("Positions are in the level frame, z up: the camera file does not say where the camera is.",)
    return replace(results.pose, fps=results.fps, edges=tuple(dict.fromkeys(edges)), notes=notes)


def _require_free(out: Path, overwrite: bool) -> None:
    if out.is_dir():
        raise InputError(Problem(out, "file", "a folder", "a file to write"))
    if out.exists() and not overwrite:
        raise InputError(Problem(out, "file", "one that is there already", "another name, or --overwrite"))
    above = next(path for path in out.absolute().parents if path.exists())
    if not above.is_dir():
        raise InputError(Problem(out, "folder", f"the file {above}", "a folder, which is made if need be"))
