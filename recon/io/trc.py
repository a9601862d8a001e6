"""TRC files of marker positions: text, separated by tabs or commas, the unit in the header, y up by custom."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from recon.base.documents import read_text
from recon.base.errors import refuse
from recon.io import common, units, writing
from recon.io.common import Pose3D, StoredPoints

UP_TEXT = "y up: x forwards, y up, z right"
"""At the end of the first line of our own files."""
HEADER_LINES = 5
TITLE = "TRC"


def recognises(path: Path) -> bool:
    return common.starts_with_text(path, b"PathFileType")


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """Raises InputError for a header or cells that cannot be used."""
    lines = read_text(path, "a TRC file").splitlines()
    separator = "\t" if "\t" in lines[0] else ","
    cells = [[cell.strip() for cell in line.split(separator)] for line in lines]
    header = dict(zip(cells[1], cells[2], strict=False))
    names = [name for name in cells[3][2:] if name]
    columns = ["Frame#", "Time", *(f"{name} {axis}" for name in names for axis in "XYZ")]
    rows = (
        (line, row if any(row[len(columns) :]) else row[: len(columns)])
        for line, row in enumerate(cells[HEADER_LINES:], start=HEADER_LINES + 1)
        if any(row)
    )
    _, values, problems = common.number_rows(path, rows, columns)
    refuse(common.first_problems(problems, path))
    notes = ()
    if header.get("NumFrames") != str(len(values)):
        notes = (f"The header announces {header.get('NumFrames', 'no number of')} frames, the file has {len(values)}.",)
    unit = header.get("Units") or None
    more: dict[str, Any] = {"unit": units.UNIT_NAMES.get(str(unit), unit), "up": "y" if UP_TEXT in cells[0] else None}
    xyz = values[:, 2:].reshape(len(values), len(names), 3)
    fps = common.rate(header.get("DataRate"))
    return common.points_of_arrays(path, individual, xyz, values[:, 0], names, fps=fps, notes=notes, **more)


# -- writing ---------------------------------------------------------------------------------------------------------


def write(pose: Pose3D, path: Path) -> None:
    """Metres, y up (x forwards, y up, z right), as OpenSim takes it; gaps are empty cells.

    Raises InputError without a frame rate, or for names with tabs or line breaks.
    """
    fps = writing.required_fps(pose.fps, TITLE)
    writing.require_names(pose.names, r"[\t\r\n]|^\s|\s$", TITLE)
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
    values = writing.y_up_from_z_up(pose.xyz_m).reshape(len(pose.frames), -1)
    for frame, row in zip(pose.frames.tolist(), values.tolist(), strict=True):
        lines.append([frame, repr(frame / fps), *("" if v != v else repr(v) for v in row)])
    text = "".join("\t".join(map(str, line)) + "\n" for line in lines)
    path.write_text(text, encoding="utf-8", newline="")
