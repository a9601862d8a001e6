"""The command `recon convert`: write 2D keypoints, 3D positions, or bones in another file format."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

from recon.animal.naming import load_names, renamed
from recon.api.options import ANYWAY, INDIVIDUAL, RENAME
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.outputs import ReadResults, output_file
from recon.base.settings import Option, Positive, Settings, input_paths
from recon.cli.answers import Answer, table_of
from recon.clip import Keypoints, mark_missing
from recon.fit.motion import Motion
from recon.fit.motion_forms import REPORT
from recon.io.columns import parse_map
from recon.io.common import Pose3D
from recon.io.formats import CONVERTED, Format, as_keypoints, read_points
from recon.io.positions import in_metres
from recon.show.plain import by_name

ROBOT_FILE = "robot.npz"
"""Name of the file with a robot's motion, which `recon retarget` writes."""


class ConvertSettings(Settings):
    """Settings of `recon convert`."""

    source: Annotated[Path | None, Option(argument="IN")] = None
    """File or results folder, such as results/clip."""
    out: Annotated[Path | None, Option(argument="OUT")] = None
    """File to write, such as clip.trc."""
    to: str | None = None
    """Format, if the extension has several, such as long. (default: see --list)"""
    fps: Positive | None = None
    """Frames per second, such as 120, if IN does not state it. For a robot's motion: the frame rate of OUT. (default:
    50)
    """
    individual: Annotated[str | None, Option(INDIVIDUAL)] = None
    columns: str | None = None
    """Columns of a plain CSV, such as 'frame=Frame,bodypart=Node,x=X,y=Y,likelihood=Score', or, if the
    table has one row per frame, 'frame=Frame,x={bodypart} X,y={bodypart} Y'. (default: columns are recognised by their
    names)
    """
    unit: str | None = None
    """Unit of 3D positions, if the file does not state it: m, cm or mm."""
    up: str | None = None
    """Upward axis of 3D positions, if the file does not state it: y, z, or -y if y points down."""
    rename: Annotated[str | None, RENAME] = None
    body_mass_kg: Positive = 1.0
    """Mass of the animal in an OpenSim model, in kg. With 1, forces are per kilogram."""
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: bool = False
    """Replace the file."""
    show_list: Annotated[bool, Option(name="--list")] = False
    """List the formats."""


def convert(settings: ConvertSettings) -> Answer:
    """Convert 2D keypoints, 3D positions or results to another file format, chosen by the extension of OUT.

    Example: recon convert results/clip model.osim

    3D positions are written in metres, z up, except in formats with other conventions (see recon convert --list).
    """
    if settings.show_list:
        return _list_of_formats()
    from recon.check.verdict import verdict_fields

    source, out = settings.source, settings.out
    if source is None or out is None:
        actual = "nothing" if source is None else "one file"
        raise InputError(Problem("recon convert", "files", actual, "IN and OUT, as in recon convert clip.csv clip.nc"))
    made_from = ReadResults.read(source) if source.is_dir() else None
    output = output_file(out, "convert", settings.overwrite, input_paths(settings), made_from, "OUT")
    if (source / ROBOT_FILE).is_file():
        name = choose_format(out, settings.to, _robot_formats()).name
        from recon.robotics.retarget_clip import convert as convert_robot

        robot_note = convert_robot(source, out, name, settings.fps, output)
        return Answer({"out": out, "format": name}, [robot_note])
    (data, motion), target, _ = collect_problems(
        lambda: read_any(source, settings),
        lambda: choose_format(out, settings.to),
        lambda: output.require((out.name,)),
    )
    _require_content(source, data, motion, target)
    notes = data.notes
    written: Any = data
    if "bones" in target.writes and motion is not None:
        from recon.show.rig import rig_of

        companions = [out.with_suffix(extension) for extension in target.companions]
        output.require([path.name for path in companions])
        written = rig_of(motion, data.fps, settings.body_mass_kg)
        data, notes = written.pose, notes + written.notes
        notes += (f"Also written: {', '.join(map(str, companions))}.",) if companions else ()
    elif isinstance(data, Keypoints):
        written, missing_notes = _with_missing_points(data)
        data, notes = written, (*notes, *missing_notes)
    assert target.write is not None
    with output.staged_file() as staged:
        target.write(written, staged)
    content_text = (
        f"{len(data.names)} keypoints, 2D" if isinstance(data, Keypoints) else f"{len(data.names)} joints, 3D"
    )
    frames = f"frames {data.frames[0]} to {data.frames[-1]} ({len(data.frames)})"
    fps = "frame rate not known" if data.fps is None else f"{data.fps:g} frames per second"
    lines = [*notes, f"{out}: {target.title}, {content_text}, {frames}, {fps}"]
    verdict = {} if motion is None else {"verdict": verdict_fields(motion)}
    return Answer({"out": out, "format": target.name, "notes": notes} | verdict, lines)


def _list_of_formats() -> Answer:
    every = (*CONVERTED, *_robot_formats())
    rows = [(f.name, " ".join(f.suffixes), ", ".join(f.writes), f.fps, f.frames, f.axes) for f in every]
    names = ("--to", "extension", "holds", "frame rate", "frame numbers", "3D axes")
    first = "If several formats share an extension, the first is used unless --to names another."
    return Answer([by_name(names, row) for row in rows], [table_of(*names, rows=rows), first])


def _require_content(source: Path, data: Keypoints | Pose3D, motion: Motion | None, target: Format) -> None:
    """Raise InputError if a format cannot hold what a file contains."""
    if "bones" in target.writes:
        fits = motion is not None
        expected = f"a folder of results of recon fit: {target.title} needs rotations of bones"
    elif isinstance(data, Keypoints):
        fits, expected = "2D" in target.writes, f"3D positions for {target.title}: fit the clip first (recon fit)"
    else:
        fits = "3D" in target.writes
        expected = f"2D keypoints for {target.title}: --to deeplabcut writes 3D positions (recon convert --list)"
    if not fits or target.write is None:
        content = "2D keypoints" if isinstance(data, Keypoints) else "3D positions"
        raise InputError(Problem(source, "content", content, expected))


def _with_missing_points(keypoints: Keypoints) -> tuple[Keypoints, list[str]]:
    """Return keypoints in which placeholders for missing points, such as (0, 0), are missing, and notes on them."""
    keypoints, missing = mark_missing(keypoints)
    stored = {"missing_zero_zero": "(0, 0)", "missing_constant": "one constant"}
    counts = {text: missing[name].sum() for name, text in stored.items()}
    return keypoints, [
        f"{count} points that were stored as {text} are treated as missing." for text, count in counts.items() if count
    ]


def read_any(source: Path, settings: ConvertSettings) -> tuple[Keypoints | Pose3D, Motion | None]:
    """Return the 2D keypoints or 3D positions that a source holds, and the motion if it is a results folder.

    Raises
    ------
    InputError
        If the source cannot be read.
    """
    motion = None
    if source.is_dir() and ((source / REPORT).is_file() or not any(source.glob("[!.]*.json"))):
        from recon.check.verdict import usable

        motion = usable(Motion.load(source), source, settings.anyway)
        data = _pose_of(motion)
        _require_none(settings, ("individual", "columns", "unit", "up"), source, "results of recon fit")
    else:
        by = None if settings.columns is None else parse_map(settings.columns)
        points, stored = read_points(source, settings.individual, by=by, fps=settings.fps)
        if stored.in_space:
            data = in_metres(source, points, stored, settings.unit, settings.up)
        else:
            data = as_keypoints(source, stored)
            _require_none(settings, ("unit", "up"), source, "2D keypoints")
    if settings.rename is not None:
        if not isinstance(data, Keypoints):
            raise InputError(Problem("--rename", "names", f"3D positions in {source}", "2D keypoints"))
        data = renamed(data, load_names(settings.rename))
    if settings.fps is None or settings.fps == data.fps:
        return data, motion
    notes = data.notes
    if data.fps is not None:
        notes += (f"{data.fps:g} frames per second in the source, {settings.fps:g} as given.",)
    return replace(data, fps=settings.fps, notes=notes), motion


def _require_none(settings: ConvertSettings, names: Sequence[str], source: Path, content: str) -> None:
    """Raise InputError if any of the options `names` is given, because they do not apply to the source's content."""
    options = [f"--{name}" for name in names if getattr(settings, name) is not None]
    content_text = f"{content} in {source}"
    raise_problems([Problem(option, "IN", content_text, f"no {option}, which they do not need") for option in options])


def _pose_of(motion: Motion) -> Pose3D:
    """Return the joints of a fit with z up, with the verdict as notes, uncertainties, and flags of frames."""
    from recon.check.verdict import verdict_lines

    notes = verdict_lines(motion.verdict)
    if not motion.knows_up:
        notes += ("Positions are in the level frame, z up, because the camera file does not have the camera's pose.",)
    flags = tuple(", ".join(frame_flags) for frame_flags in motion.flags)
    return replace(motion.upright, notes=notes, sigma_m=motion.upright_sigma_m, flags=flags)


def _robot_formats() -> tuple[Format, ...]:
    from recon.robotics.retarget_clip import FORMATS

    description = {"writes": ("robot",), "fps": "kept", "frames": "from 0", "axes": "m, z up"}
    return tuple(Format(name, name, (Path(file).suffix,), **description) for name, (file, _) in FORMATS.items())


def choose_format(out: Path, name: str | None, formats: Sequence[Format] = CONVERTED) -> Format:
    """Return the format to write, chosen by name if given, or by the file's extension.

    Raises
    ------
    InputError
        If the name or the extension is unknown.
    """
    names = tuple(dict.fromkeys(f.name for f in formats))
    if name is not None and name not in names:
        is_robot_format = name in [f.name for f in _robot_formats()]
        wanted = "a folder that `recon retarget` wrote as IN" if is_robot_format else f"one of: {', '.join(names)}"
        raise InputError(Problem("--to", "format", f"'{name}'", wanted))
    named = [f for f in formats if name in (None, f.name)]
    chosen = next((f for f in named if out.suffix.lower() in f.suffixes), None)
    if chosen is None:
        expected = ", ".join(dict.fromkeys(s for f in named for s in f.suffixes))
        raise InputError(Problem(out, "extension", f"'{out.suffix}'", f"one of: {expected}"))
    return chosen
