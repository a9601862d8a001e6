"""From one file format to another: 2D keypoints among themselves, 3D positions among themselves, results to bones."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from recon.animal.naming import load_names, renamed
from recon.base.errors import InputError, Problem, all_of
from recon.base.files import require_free_file, staged_file
from recon.base.settings import Option, Positive, Settings
from recon.check import usable, verdict_lines
from recon.clip.keypoints import Keypoints, mark_missing
from recon.fit.motion import Motion
from recon.io import Format, Pose3D, as_keypoints, choose_format, in_metres, read_points
from recon.io.columns import parse_map
from recon.show.export.rig import rig_of
from recon.workflows.settings import ANYWAY, RENAME


class ConvertSettings(Settings):
    """What `recon convert` is told."""

    source: Annotated[Path | None, Option("File, or folder of results, as in results/clip.", argument="IN")] = None
    out: Annotated[Path | None, Option("File to write, as in clip.trc.", argument="OUT")] = None
    to: Annotated[
        str | None, Option("Format, where the extension has several, as in long or sleap. (default: see --list)")
    ] = None
    fps: Annotated[
        Positive | None,
        Option(
            "Frame rate in Hz, as in 120, if the file does not say it or is wrong.",
            "a number of frames per second above 0, as in 120",
        ),
    ] = None
    individual: Annotated[str | None, Option("Which animal of a multi-animal file, as in animal1.")] = None
    columns: Annotated[
        str | None,
        Option(
            "Columns of a plain CSV, as in 'frame=Frame,bodypart=Node,x=X,y=Y,likelihood=Score', or for one row per "
            "frame 'frame=Frame,x={bodypart} X,y={bodypart} Y'. (default: by their names)"
        ),
    ] = None
    unit: Annotated[str | None, Option("Unit of 3D positions, if the file does not say it: m, cm or mm.")] = None
    up: Annotated[str | None, Option("Axis of 3D positions that points up, if the file does not say it: y or z.")] = (
        None
    )
    rename: Annotated[str | None, RENAME] = None
    body_mass_kg: Annotated[
        Positive, Option("Mass of the animal in an OpenSim model; 1: forces per kilogram.", "kilograms above 0")
    ] = 1.0
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: Annotated[bool, Option("Replace the file.")] = False
    show_list: Annotated[bool, Option("Print the formats.", name="--list")] = False


Conversion = tuple[Keypoints | Pose3D, Format, tuple[str, ...]]
"""What was read, the format that it was written in, and notes."""


def convert(settings: ConvertSettings) -> Conversion:
    """Read a file, or a folder of results (its 3D positions), and write it as `out`, whole or not at all.

    to: the name of a format where the extension of `out` leaves a choice. A missing point is written as the format has
    it, whichever way the source had it. Raises InputError for what cannot be read or written.
    """
    source, out = settings.source, settings.out
    if source is None or out is None:
        found = "nothing" if source is None else "one file"
        raise InputError(Problem("recon convert", "files", found, "IN and OUT, as in recon convert clip.csv clip.nc"))
    data, target, _ = all_of(
        lambda: read_any(source, settings),
        lambda: choose_format(out, settings.to),
        lambda: require_free_file(out, settings.overwrite, "OUT"),
    )
    notes = data.notes
    if "bones" in target.writes:
        return _as_bones(settings, source, data, target, out)
    if isinstance(data, Keypoints):
        if "2D" not in target.writes:
            expected = f"3D positions for {target.title}: fit the clip first (recon fit)"
            raise InputError(Problem(source, "content", "2D keypoints", expected))
        data, missing = mark_missing(data)
        if zeros := missing["missing_zero_zero"].sum():
            notes += (f"{zeros} points that were stored as (0, 0) are missing ones.",)
        if constants := missing["missing_constant"].sum():
            notes += (f"{constants} points that were stored as one constant are missing ones.",)
    elif "3D" not in target.writes:
        raise InputError(Problem(source, "content", "3D positions", f"2D keypoints for {target.title}"))
    _write(target, data, out)
    return data, target, notes


def _as_bones(
    settings: ConvertSettings, source: Path, data: Keypoints | Pose3D, target: Format, out: Path
) -> Conversion:
    """data: what was read of the source."""
    if not source.is_dir():
        found = "2D keypoints" if isinstance(data, Keypoints) else "3D positions"
        expected = f"a folder of results of recon fit: {target.title} has bones, which turn"
        raise InputError(Problem(source, "content", found, expected))
    beside = [out.with_suffix(extension) for extension in target.beside]
    all_of(*(partial(require_free_file, path, settings.overwrite, "OUT") for path in beside))
    rig = rig_of(Motion.load(source), data.fps, settings.body_mass_kg)
    _write(target, rig, out)
    notes = data.notes + rig.notes
    if beside:
        notes += (f"Beside it: {', '.join(map(str, beside))}.",)
    return rig.pose, target, notes


def _write(target: Format, data: Any, out: Path) -> None:
    assert target.write is not None
    with staged_file(out) as staged:
        target.write(data, staged)


def read_any(source: Path, settings: ConvertSettings) -> Keypoints | Pose3D:
    """2D keypoints or 3D positions, whichever the source holds. Raises InputError."""
    if source.is_dir():
        data = _of_results(source, settings.anyway)
    else:
        by = None if settings.columns is None else parse_map(settings.columns)
        found, stored = read_points(source, settings.individual, by=by)
        if stored.in_space:
            data = in_metres(source, found, stored, settings.unit, settings.up)
        else:
            data = as_keypoints(source, stored)
    if settings.rename is not None:
        if not isinstance(data, Keypoints):
            raise InputError(Problem("--rename", "names", f"3D positions in {source}", "2D keypoints"))
        data = renamed(data, load_names(settings.rename))
    if settings.fps is None or settings.fps == data.fps:
        return data
    notes = data.notes
    if data.fps is not None:
        notes += (f"{data.fps:g} frames per second in the source, {settings.fps:g} as given.",)
    return replace(data, fps=settings.fps, notes=notes)


def _of_results(folder: Path, anyway: bool) -> Pose3D:
    """The joints of a fit, upright, with their frame rate and limbs."""
    motion = usable(Motion.load(folder), folder, anyway)
    notes = verdict_lines(motion.verdict)
    if not motion.knows_up:
        notes += ("Positions are in the level frame, z up: the camera file does not say where the camera is.",)
    return replace(motion.upright, notes=notes)
