"""TRC files of marker positions: text, separated by tabs or commas, the unit in the header, y up by custom."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recon.base.documents import read_text
from recon.base.errors import InputError, Problem, refuse
from recon.io.common import (
    MAX_FRAME,
    choose,
    first_problems,
    frame_number,
    name_problems,
    numbers,
    rate,
    require_names,
    required_fps,
    starts_with_text,
)
from recon.io.pose import UNIT_NAMES, Pose3D, StoredPoints, y_up_from_z_up

UP_TEXT = "y up: x forwards, y up, z right"
"""At the end of the first line of our own files."""
HEADER_LINES = 5
TITLE = "TRC"


def recognises(path: Path) -> bool:
    return starts_with_text(path, b"PathFileType")


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """Raises InputError for a header or cells that cannot be used, and for a choice of animals: TRC has one."""
    choose(path, [""], individual)
    lines = read_text(path, "a TRC file").splitlines()
    separator = "\t" if "\t" in lines[0] else ","
    cells = [[cell.strip() for cell in line.split(separator)] for line in lines]
    if len(cells) < HEADER_LINES:
        raise InputError(Problem(path, "header", f"{len(cells)} lines", f"{HEADER_LINES}"))
    header = dict(zip(cells[1], cells[2], strict=False))
    names = tuple(name for name in cells[3][2:] if name)
    fps = rate(header.get("DataRate"))
    unit = UNIT_NAMES.get(header.get("Units", ""))
    problems = name_problems(path, "line 4", names)
    if fps is None:
        problems.append(Problem(path, "line 3, DataRate", f"'{header.get('DataRate', '')}'", "frames per second"))
    if unit is None:
        problems.append(Problem(path, "line 3, Units", f"'{header.get('Units', '')}'", "m, cm or mm"))
    if header.get("NumMarkers") != str(len(names)):
        found = f"{len(names)} names, but NumMarkers {header.get('NumMarkers', 'is missing')}"
        problems.append(Problem(path, "line 4", found, "as many"))
    frames: list[int] = []
    rows: list[np.ndarray] = []
    width = 2 + 3 * len(names)
    for line, row in enumerate(cells[HEADER_LINES:], start=HEADER_LINES + 1):
        if not any(row):
            continue
        if len(row) < width or any(row[width:]):
            problems.append(Problem(path, f"line {line}", f"{len(row)} cells", f"{width}, as in the header"))
            continue
        frame = frame_number(row[0], -MAX_FRAME)
        if frame is None:
            problems.append(Problem(path, f"line {line}, Frame#", f"'{row[0]}'", "a frame number"))
        values, wrong = numbers(row[2:width])
        problems += [
            Problem(path, f"line {line}, column {i + 3}", f"'{row[i + 2]}'", "a number or an empty cell") for i in wrong
        ]
        frames.append(frame or 0)
        rows.append(values)
    if not rows and not problems:
        problems.append(Problem(path, "rows", "no frames", "at least one below the header"))
    if not problems and (np.diff(frames) <= 0).any():
        problems.append(Problem(path, "Frame#", "numbers that do not increase", "an increasing number in each row"))
    refuse(first_problems(problems, path))
    notes = ()
    if header.get("NumFrames") != str(len(rows)):
        notes = (f"The header announces {header.get('NumFrames', 'no number of')} frames, the file has {len(rows)}.",)
    return StoredPoints(
        names,
        np.reshape(rows, (len(rows), len(names), 3)),
        np.array(frames, dtype=np.int64),
        fps=fps,
        unit=unit,
        up="y" if UP_TEXT in cells[0] else None,
        notes=notes,
    )


# -- writing ---------------------------------------------------------------------------------------------------------


def write(pose: Pose3D, path: Path) -> None:
    """Metres, y up (x forwards, y up, z right), as OpenSim takes it; gaps are empty cells.

    Raises InputError without a frame rate, or for names with tabs or line breaks.
    """
    fps = required_fps(pose.fps, TITLE)
    require_names(pose.names, r"[\t\r\n]|^\s|\s$", TITLE)
    header = {
        "DataRate": repr(fps),
        "CameraRate": repr(fps),
        "NumFrames": len(pose.frames),
        "NumMarkers": len(pose.names),
        "Units": "m",
        "OrigDataRate": repr(fps),
        "OrigDataStartFrame": pose.frames[0],
        "OrigNumFrames": len(pose.frames),
    }
    lines = [
        ["PathFileType", "4", "(X/Y/Z)", path.name, UP_TEXT],
        list(header),
        list(header.values()),
        ["Frame#", "Time", *(cell for name in pose.names for cell in (name, "", ""))],
        ["", "", *(f"{axis}{j + 1}" for j in range(len(pose.names)) for axis in "XYZ")],
    ]
    values = y_up_from_z_up(pose.xyz_m).reshape(len(pose.frames), -1)
    for frame, row in zip(pose.frames.tolist(), values.tolist(), strict=True):
        lines.append([frame, repr(frame / fps), *("" if v != v else repr(v) for v in row)])
    text = "".join("\t".join(map(str, line)) + "\n" for line in lines)
    path.write_text(text, encoding="utf-8", newline="")
