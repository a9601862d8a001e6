"""Read and write corrections.csv, which has detections corrected by hand.

A row has the frame of the keypoint file, the camera (empty if there is only one), the keypoint, its detected position
(`was_x_px`, `was_y_px`; empty: not detected), its corrected position (`now_x_px`, `now_y_px`; empty: hidden, or not to
be used), and optionally `why` and `when`. If several rows correct the same detection, the last one counts.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from recon.base.errors import InputError, Problem, raise_problems
from recon.base.numbers import counted
from recon.base.tables import unguarded
from recon.clip import Keypoints
from recon.io.common import MAX_FRAME, cut_blank, text_rows, width_of
from recon.io.writing import write_rows

CORRECTIONS = "corrections.csv"
"""Name of the file of corrections in a results folder."""
COLUMNS = ("frame", "camera", "keypoint", "was_x_px", "was_y_px", "now_x_px", "now_y_px", "why", "when")
REQUIRED = ("frame", "keypoint", "now_x_px", "now_y_px")
_EXPECTED = f"a table of corrections with the columns {', '.join(REQUIRED)}, and camera if there are several cameras"
_Point = tuple[float, float]
SAME_PX = 1.0
"""Largest distance, in pixels, between a detection in the keypoint file and its rounded position in a correction."""
HALF_PX = 0.5
"""Distance from the centre of a pixel at the edge, whose coordinate is 0, to the edge of the picture."""
MAX_SHOWN = 3
"""Largest number of positions outside the picture that a note lists."""
MANY_CORRECTIONS = 5
"""Minimum number of corrected detections required to check whether corrections belong to a keypoint file."""


@dataclass(frozen=True)
class Correction:
    """One detection that was corrected by hand."""

    frame: int
    """Frame number in the keypoint file."""
    camera: str
    """Name of the camera; empty if there is only one."""
    keypoint: str
    was_px: _Point | None
    """Position found by the detector; None if it found none."""
    now_px: _Point | None
    """Corrected position; None if the point is hidden or must not be used."""
    reason: str = ""
    date: str = ""
    """Date and time of the correction, ISO 8601."""


def read_corrections(path: Path) -> list[Correction]:
    """Return the corrections in a file, in the order of its rows.

    Raises
    ------
    InputError
        If lines cannot be read. The message lists all of them.
    """
    if not path.is_file():
        raise InputError(Problem(path, "file", "no such file", _EXPECTED))
    lines = [*text_rows(path)]
    header = [cell.strip() for cell in lines[0][1]] if lines else []
    lacking = [name for name in REQUIRED if name not in header]
    if lacking:
        raise InputError(Problem(path, "columns", ", ".join(header)[:100] or "nothing", _EXPECTED))
    corrections, problems = [], []
    width = width_of([header])
    for number, cells in cut_blank(lines[1:], width):
        if len(cells) != width:  # as in a line that is cut short
            problems.append(Problem(path, f"line {number}", f"{len(cells)} cells", f"{width} cells, as in the header"))
            continue
        row = {name: unguarded(cell.strip()) for name, cell in zip(header[:width], cells, strict=True)}
        try:
            corrections.append(_correction(row))
        except ValueError as error:
            problems.append(Problem(path, f"line {number}", str(error), _EXPECTED))
    raise_problems(problems)
    return corrections


def write_corrections(corrections: Iterable[Correction], path: Path) -> None:
    """Write corrections to a file that `read_corrections` reads."""
    rows = [
        (
            *(row.frame, row.camera, row.keypoint),
            *(row.was_px or ("", "")),
            *(row.now_px or ("", "")),
            *(row.reason, row.date),
        )
        for row in corrections
    ]
    write_rows(path, [COLUMNS], rows)


def _correction(row: dict[str, str]) -> Correction:
    """Return the correction in a row, or raise ValueError with the reason if the row is not valid."""
    text = re.sub(r"\.0+$", "", row.get("frame", ""))  # spreadsheets and pandas write 5.0
    if not text.lstrip("-").isdecimal() or abs(int(text[:12])) > MAX_FRAME:
        raise ValueError(f"frame {text[:40]!r}, which is not a whole number")
    if not row.get("keypoint"):
        raise ValueError("no keypoint")
    was_px, now_px = (_point(row, f"{name}_x_px", f"{name}_y_px") for name in ("was", "now"))
    camera, reason, date = (row.get(name, "") for name in ("camera", "why", "when"))
    return Correction(int(text), camera, row["keypoint"], was_px, now_px, reason, date)


def _point(row: dict[str, str], x_name: str, y_name: str) -> _Point | None:
    x, y = row.get(x_name, ""), row.get(y_name, "")
    if not x and not y:
        return None
    try:
        point = float(x), float(y)
    except ValueError:
        point = math.nan, math.nan
    if not all(map(math.isfinite, point)):
        raise ValueError(f"{x_name}, {y_name}: {x[:20]!r}, {y[:20]!r}, which are not two numbers")
    return point


def with_corrections(
    files: Sequence[Keypoints],
    cameras: Sequence[str],
    corrections: Sequence[Correction],
    source: Path,
    sizes_px: Sequence[tuple[int, int]] = (),
) -> list[Keypoints]:
    """Return the keypoints of V cameras after corrections by hand.

    A corrected detection has confidence 1. The keypoints' notes state the number of corrections.

    Parameters
    ----------
    files : sequence of Keypoints
        The keypoints of each camera, as read.
    cameras : sequence of str
        The names of the V cameras.
    corrections : sequence of Correction
        Corrections for any of the cameras.
    source : path
        The file of the corrections, for messages.
    sizes_px : sequence of (int, int), optional
        Width and height of the V cameras' pictures in pixels. The notes then name corrected positions that lie outside.

    Raises
    ------
    InputError
        If corrections name a camera, frame or keypoint that does not exist.
    """
    raise_problems(_problems(files, cameras, corrections, source))
    corrected = []
    for file, camera, size_px in zip(files, cameras, sizes_px or (None,) * len(files), strict=True):
        corrected_px = {(row.frame, row.keypoint): row.now_px for row in corrections if row.camera in ("", camera)}
        if not corrected_px:
            corrected.append(file)
            continue
        xy_px, confidence = file.xy_px.copy(), file.confidence.copy()
        row_of, column_of = {int(frame): i for i, frame in enumerate(file.frames)}, file.names.index
        for (frame, keypoint), now_px in corrected_px.items():
            cell = row_of[frame], column_of(keypoint)
            xy_px[cell] = np.nan if now_px is None else now_px
            confidence[cell] = 0.0 if now_px is None else 1.0
        verb = "was" if len(corrected_px) == 1 else "were"
        note = f"{counted(len(corrected_px), 'detection')} {verb} corrected by hand ({source.name})"
        outside = [] if size_px is None else [*_outside(corrected_px, size_px, source)]
        notes, count = (*file.notes, note, *outside), len(corrected_px)
        corrected.append(replace(file, xy_px=xy_px, confidence=confidence, notes=notes, corrected=count))
    return corrected


def _outside(
    corrected_px: Mapping[tuple[int, str], _Point | None], size_px: tuple[int, int], source: Path
) -> Iterable[str]:
    """Yield a note if corrected positions lie outside the picture.

    Such positions may be right, because detectors pad the picture, and a limb that leaves the picture can be placed by
    eye.
    """
    width, height = size_px
    outside = [
        f"frame {frame}, {keypoint} at ({now_px[0]:g}, {now_px[1]:g})"
        for (frame, keypoint), now_px in corrected_px.items()
        if now_px is not None
        and not (-HALF_PX <= now_px[0] <= width - HALF_PX and -HALF_PX <= now_px[1] <= height - HALF_PX)
    ]
    if outside:
        is_one = len(outside) == 1
        shown = f"{'; '.join(outside[:MAX_SHOWN])}{'; ...' if len(outside) > MAX_SHOWN else ''}"
        yield (
            f"{counted(len(outside), 'corrected position')} {'lies' if is_one else 'lie'} outside the picture of "
            f"{width}x{height} px ({shown}). If {'this is' if is_one else 'these are'} not intended, change "
            f"{source.name}; empty cells leave a detection out."
        )


def _problems(
    files: Sequence[Keypoints], cameras: Sequence[str], corrections: Sequence[Correction], source: Path
) -> Iterable[Problem]:
    """Yield problems with corrections that do not belong to the keypoint files."""
    unknown_cameras = {row.camera for row in corrections} - {"", *cameras}
    if unknown_cameras:
        yield Problem(source, "camera", ", ".join(sorted(unknown_cameras))[:100], f"one of {', '.join(cameras)}")
    if len(cameras) > 1 and any(not row.camera for row in corrections):
        yield Problem(source, "camera", "rows without a camera", f"one of {', '.join(cameras)} in every row")
    for file, camera in zip(files, cameras, strict=True):
        rows = [row for row in corrections if row.camera == camera or (not row.camera and len(cameras) == 1)]
        title = file.source or camera
        unknown = sorted({row.keypoint for row in rows} - {*file.names})
        if unknown:
            expected = f"keypoints of {title}, which are {', '.join(file.names)}"
            yield Problem(source, "keypoint", ", ".join(unknown)[:100], expected)
        absent = sorted({row.frame for row in rows} - {*file.frames.tolist()})
        if absent:
            expected = f"frames of {title}, which are {_range_of(file.frames)}"
            yield Problem(source, "frame", ", ".join(map(str, absent))[:100], expected)
        if not (unknown or absent) and _are_of_other_detections(file, rows):
            detail = f"no detection of {title} at any of the {len(rows)} positions"
            expected = "corrections of this file; rows without was_x_px and was_y_px are not compared with it"
            yield Problem(source, "was_x_px, was_y_px", detail, expected)


def _range_of(frames: np.ndarray) -> str:
    """Return the range of frame numbers as a string, such as "0 to 59"."""
    if not len(frames):
        return "none"
    first, last = int(frames.min()), int(frames.max())
    return f"{first} to {last}{'' if len(frames) == last - first + 1 else ', with gaps'}"


def _are_of_other_detections(file: Keypoints, rows: Sequence[Correction]) -> bool:
    """Return whether no detection in the file is at a position that a correction states as detected.

    Detections of all keypoints count, because a fit may exchange left and right.
    """
    stated = [(row.frame, row.was_px) for row in rows if row.was_px is not None]
    if len(stated) < MANY_CORRECTIONS:
        return False
    row_of = {int(frame): i for i, frame in enumerate(file.frames)}
    distance_px = [np.linalg.norm(file.xy_px[row_of[frame]] - was_px, axis=-1) for frame, was_px in stated]
    return not (np.array(distance_px) <= SAME_PX).any()
