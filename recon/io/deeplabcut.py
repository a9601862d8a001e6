"""DeepLabCut's files: predictions and labels, of one animal or several, and 3D positions.

Both are a table with one row per frame and a header of several levels: `scorer`, `individuals` (several animals only),
`bodyparts`, `coords`. Prediction files number their rows by frame. Label files index them by image path, in one column
or three, and have no likelihood. Our own have the frame rate in the scorer, `recon_90fps`: there is no other place.

Here are the table and its CSV files; `recon.io.deeplabcut_h5` has its H5 files.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath
from typing import NamedTuple

import numpy as np

from recon.base.errors import InputError, Problem, refuse
from recon.clip.keypoints import Keypoints
from recon.io.common import FMPOSE3D, MAX_FRAME, PROBLEMS_SHOWN, choose, first_problems, frame_number, numbers, rate
from recon.io.pose import Pose3D, StoredPoints, points_of
from recon.io.table import text_rows, write_table

HEADERS = (
    ("scorer", "bodyparts", "coords"),
    ("scorer", "individuals", "bodyparts", "coords"),
    ("bodyparts", "coords"),
    ("individuals", "bodyparts", "coords"),
)
_CELLS_AT_ONCE = 1 << 14
"""As Python's own text and numbers."""
COORDS, COORDS_2D = ("x", "y", "z", "likelihood"), ("x", "y", "likelihood")
# DeepLabCut files the bodyparts that belong to no animal, such as the corners of the arena, under this individual.
UNIQUE_BODYPARTS = "single"
PADDING = -1.0
"""x, y and likelihood of an animal that DeepLabCut 3 did not see in a frame."""
PLACES = {"l", "r", "left", "right", "f", "h", "front", "back", "fore", "hind", "rear", "upper", "lower", "near", "far"}
MIN_PARTS = 3
"""What names of one animal's bodyparts may begin with, and of how many each animal has that names tell apart."""
SCORER = "recon"
"""The scorer of our own files; where the frame rate is known, it stands in it: recon_90fps."""


class Column(NamedTuple):
    """One column of a file; individual is empty in a file of one animal."""

    individual: str
    bodypart: str
    coord: str

    def __str__(self) -> str:
        return "/".join(part for part in self if part)


@dataclass(frozen=True, eq=False)
class PointTable:
    """All that a file of DeepLabCut's has: T frames of C columns."""

    columns: tuple[Column, ...]
    numbers: np.ndarray
    """(T, C) float, NaN = empty cell, no infinities."""
    frames: np.ndarray
    """(T,) int, strictly increasing."""
    notes: tuple[str, ...]
    fps: float | None = None
    """As the scorer of our own files has it."""
    scorer: str | None = ""
    """The scorer of the first column; None where there is no header row or level of that name."""


def recognises_csv(path: Path) -> bool:
    """Whether a text has DeepLabCut's header rows."""
    with path.open("rb") as file:
        head = file.read(64).removeprefix(b"\xef\xbb\xbf")
    return re.match(rb'\s*"?\s*(scorer|individuals|bodyparts)\s*"?\s*([,;\t\r\n]|$)', head) is not None


def read_csv(path: Path, individual: str | None = None) -> StoredPoints:
    """The points of one animal in a CSV file (see `points_in`). Raises InputError."""
    return points_in(_csv_table(path), path, individual)


def points_in(table: PointTable, path: Path, individual: str | None) -> StoredPoints:
    """The points of one animal as the file states them: likelihoods are NaN where it has none, and the unit of 3D
    positions is not in it.

    individual: which animal, where there are several. Raises InputError for a choice that is missing, a bodypart that
    appears twice or lacks a coordinate.
    """
    table, animal = _of_one_animal(table, path, individual)
    in_space = any(c.coord == "z" for c in table.columns)
    required = ("x", "y", "z") if in_space else ("x", "y")
    coords = required if in_space else COORDS_2D
    names = tuple(dict.fromkeys(c.bodypart for c in table.columns))
    values = np.full((len(table.frames), len(names), len(coords)), np.nan)
    columns = [(c.bodypart, c.coord) for c in table.columns]
    problems = [
        Problem(path, f"bodypart {name}", "more than one column of a kind", "one")
        for name in dict.fromkeys(column[0] for column in columns if columns.count(column) > 1)
    ]
    for k, name in enumerate(names):
        if lacking := [coord for coord in required if (name, coord) not in columns]:
            problems.append(Problem(path, f"bodypart {name}", f"no {', '.join(lacking)}", ", ".join(required)))
        for i, coord in enumerate(coords):
            if (name, coord) in columns:
                values[:, k, i] = table.numbers[:, columns.index((name, coord))]
    refuse(first_problems(problems, path))
    notes, likelihood = table.notes, None
    if not in_space:
        values[(values == PADDING).all(axis=2)] = np.nan, np.nan, 0.0
        values, likelihood = values[..., :2], values[..., 2]
        if table.scorer is None:
            notes += ("The header's first row, scorer, is missing; the others say what each column is.",)
    if FMPOSE3D in (table.scorer or ""):
        from recon.io.json_poses import true_names

        names, more = true_names(names, table.scorer or "", in_space)
        notes += more
    scorer = None if in_space else table.scorer
    return StoredPoints(names, values, table.frames, likelihood, table.fps, animal, scorer, notes=notes)


def _csv_table(path: Path) -> PointTable:
    """A file with DeepLabCut's header rows (see `HEADERS`), whatever its coordinates. Raises InputError."""
    rows = text_rows(path, ",")
    levels, index_columns = _read_header(path, rows)
    return table_of_rows(path, levels, rows, index_columns)


def table_of_rows(
    path: Path, header: dict[str, list[str]], rows: Iterable[tuple[int, list[str]]], index_columns: int
) -> PointTable:
    """header: the texts of the data's columns by level; rows: with their lines, each of so many cells that say the
    frame, and one for each column. Raises InputError."""
    labels = list(zip(*header.values(), strict=True))
    index: list[tuple[str, ...]] = []
    values: list[np.ndarray] = []
    cells: list[str] = []
    bad: list[tuple[int, int, str]] = []
    problems: list[Problem] = []
    width = index_columns + len(labels)
    for line, row in rows:
        if len(row) != width:
            problems.append(Problem(path, f"line {line}", f"{len(row)} cells", f"{width}, as in the header"))
            continue
        cells += row[index_columns:]
        index.append(tuple(row[:index_columns]))
        if len(cells) >= _CELLS_AT_ONCE:
            values.append(row_numbers(cells, len(labels), bad, sum(map(len, values))))
            cells = []
    values.append(row_numbers(cells, len(labels), bad, sum(map(len, values))))
    return table_of(path, tuple(header), labels, index, np.concatenate(values), bad, problems)


def _read_header(path: Path, rows: Iterator[tuple[int, list[str]]]) -> tuple[dict[str, list[str]], int]:
    """The texts of the data's columns by level, and the number of columns before them."""
    header: dict[str, list[str]] = {}
    first = ""
    for _, row in rows:
        first = row[0].strip()
        if first not in HEADERS[1] or first in header:
            break
        header[first] = row
        if first == "coords":
            break
    if tuple(header) not in HEADERS:
        for separator, name in ((";", "';'"), ("\t", "a tab")):
            if separator in first:
                raise InputError(Problem(path, "separator", name, "','"))
        found = ", ".join(dict.fromkeys((*header, first[:40])))
        raise InputError(header_problem(path, f"rows that begin with '{found}'"))
    if len({len(row) for row in header.values()}) != 1:
        lengths = ", ".join(f"{len(row)} in {name}" for name, row in header.items())
        raise InputError(Problem(path, "header rows", f"cells: {lengths}", "the same number of cells in each"))
    # Label files name the image in three columns, which have blank cells in all header rows but for the first cell.
    index_columns = 3 if [cell.strip() for cell in header["coords"][1:3]] == ["", ""] else 1
    return {level: row[index_columns:] for level, row in header.items()}, index_columns


def _without_fps(scorer: str) -> tuple[str, float | None]:
    """The scorer, and the frame rate that files of ours have behind it."""
    match = re.fullmatch(rf"(?:(.*)_)?{SCORER}_([0-9.e+-]+)fps", scorer)
    fps = rate(match[2]) if match else None
    return (scorer, None) if match is None or fps is None else (match[1] or SCORER, fps)


def _with_fps(scorer: str | None, fps: float | None) -> str:
    """The opposite: of points that another program found, its scorer stays."""
    ours = SCORER if fps is None else f"{SCORER}_{repr(fps).removesuffix('.0')}fps"
    if scorer in (None, SCORER):
        return ours
    return str(scorer) if fps is None else f"{scorer}_{ours}"


def _columns(path: Path, raw: Sequence[Column]) -> tuple[tuple[Column, ...], tuple[str, ...]]:
    """Columns with stray blanks removed from their names, and a note for each name that had some."""
    columns = tuple(Column(*(part.strip() for part in column)) for column in raw)
    problems = [] if columns else [Problem(path, "header rows", "no columns", "at least one bodypart")]
    for j, column in enumerate(columns):
        if column.coord not in COORDS:
            found = f"coordinate '{column.coord}'"
            problems.append(Problem(path, f"column {column or j + 1}", found, ", ".join(COORDS)))
        if not column.bodypart:
            problems.append(Problem(path, f"column {j + 1} of the data", "no bodypart", "a name"))
        if not str(column).isprintable():
            found = "a name that cannot be printed"
            problems.append(Problem(path, f"column {column}", found, "letters, digits and signs"))
    refuse(first_problems(list(dict.fromkeys(problems)), path))
    names = dict.fromkeys(name for column in raw for name in column[:2])
    return columns, tuple(f"'{name}' is read as '{name.strip()}'." for name in names if name != name.strip())


def table_of(
    path: Path,
    levels: tuple[str | None, ...],
    labels: Sequence[tuple[str, ...]],
    index: Sequence[tuple[str, ...]],
    values: np.ndarray,
    bad: Sequence[tuple[int, int, str]],
    problems: list[Problem],
) -> PointTable:
    """The table, once every label, cell and frame number of it is in order.

    labels: of its C columns, one text for each level; index: of its T rows; values (T, C); bad: (row, column, text) of
    the cells that are no numbers; problems: others that are known already.
    """
    named = [dict(zip(levels, label, strict=True)) for label in labels]
    columns, notes = _columns(path, [Column(n.get("individuals", ""), n["bodyparts"], n["coords"]) for n in named])
    if not index and not problems:
        raise InputError(Problem(path, "rows", "no frames", "at least one row below the header"))
    frames, frame_problems = _frame_numbers(path, index)
    problems = problems + frame_problems
    infinite = [(int(i), int(j), str(values[i, j])) for i, j in np.argwhere(np.isinf(values))]
    problems += [
        Problem(path, f"frame {frames[i]}, column {columns[j]}", f"'{cell}'", "a number or an empty cell")
        for i, j, cell in sorted([*bad, *infinite])
    ]
    if not problems:
        distinct, count = np.unique(np.array(frames), return_counts=True)
        problems = [Problem(path, f"frame {frame}", "more than one row", "one") for frame in distinct[count > 1]]
    refuse(first_problems(problems, path))
    in_order = np.array(frames, dtype=np.int64)
    if np.any(np.diff(in_order) < 0):
        notes += ("The rows were not in the order of their frame numbers and have been sorted.",)
        order = np.argsort(in_order)
        in_order, values = in_order[order], values[order]
    scorer = named[0].get("scorer")
    scorer, fps = (None, None) if scorer is None else _without_fps(scorer)
    return PointTable(columns, values, in_order, notes, fps, scorer)


def _frame_numbers(path: Path, index: Sequence[tuple[str, ...]]) -> tuple[list[int | str], list[Problem]]:
    """Frame numbers from the index cells; a cell without one stays as it is and becomes a problem."""
    first = "/".join(index[0]) if index else ""
    images = re.search(r"[/\\]|\.[A-Za-z]\w*$", first)
    frames: list[int | str] = []
    problems: list[Problem] = []
    folders: dict[str, None] = {}
    for cells in index:
        text = "/".join(cells).strip()
        if images:
            # A Windows path splits at both kinds of slash.
            image = PureWindowsPath(text)
            folders[image.parent.as_posix()] = None
            match = re.search(r"([0-9]+)$", image.stem)
        else:
            match = re.fullmatch(r"(-?[0-9]+)(\.0*)?", text)
        frame = frame_number(match[1], -MAX_FRAME) if match else None
        if frame is None:
            expected = "an image name that ends in the frame number" if images else "a frame number (0, 1, 2, ...)"
            problems.append(Problem(path, f"row {len(frames) + 1} below the header", f"'{text}'", expected))
        frames.append(text if frame is None else frame)
    if len(folders) > 1:
        shown = ", ".join(list(folders)[:PROBLEMS_SHOWN]) + (", ..." if len(folders) > PROBLEMS_SHOWN else "")
        problems.append(Problem(path, "images", f"{len(folders)} folders: {shown}", "the images of one video"))
    return frames, problems


def row_numbers(cells: Sequence[str], columns: int, bad: list[tuple[int, int, str]], first: int = 0) -> np.ndarray:
    """(T, C): the cells of rows of so many columns as floats; those that are none are added to `bad` as (row, column,
    text), the rows counted from `first` on."""
    values, wrong = numbers(cells)
    bad += [(first + j // columns, j % columns, cells[j]) for j in wrong if np.isnan(values[j])]
    return values.reshape(-1, max(columns, 1))


def _of_one_animal(table: PointTable, path: Path, individual: str | None) -> tuple[PointTable, str | None]:
    """The columns of the chosen animal, and its name where the file names animals. Raises InputError."""
    everyone = list(dict.fromkeys(c.individual for c in table.columns))
    if everyone == [""] and _prefixes(c.bodypart for c in table.columns):
        split = ((c.bodypart.partition("_"), c.coord) for c in table.columns)
        table = replace(table, columns=tuple(Column(animal, part, coord) for (animal, _, part), coord in split))
        everyone = list(dict.fromkeys(c.individual for c in table.columns))
    if everyone == [""]:
        choose(path, everyone, individual)
        return table, None
    animals = [name for name in everyone if name != UNIQUE_BODYPARTS] or everyone
    chosen = animals[choose(path, animals, individual, (_has_points(table, animal) for animal in animals))]
    notes = table.notes
    if chosen != UNIQUE_BODYPARTS and UNIQUE_BODYPARTS in everyone:
        left_out = dict.fromkeys(c.bodypart for c in table.columns if c.individual == UNIQUE_BODYPARTS)
        notes += (f"Left out, because they are no part of an animal: {', '.join(left_out)}.",)
    keep = [j for j, c in enumerate(table.columns) if c.individual == chosen]
    columns = tuple(table.columns[j] for j in keep)
    return replace(table, columns=columns, numbers=table.numbers[:, keep], notes=notes), chosen


def _prefixes(bodyparts: Iterable[str]) -> tuple[str, ...]:
    """The prefixes of animals that are told apart by the first part of every name, as B and W in B_nose, B_tail,
    W_nose, W_tail; none where that is a place on an animal, or where some parts are one's only."""
    parts: dict[str, set[str]] = {}
    for name in bodyparts:
        animal, _, part = name.partition("_")
        parts.setdefault(animal, set()).add(part)
    alike = len(parts) > 1 and len({*map(frozenset, parts.values())}) == 1
    many = min(map(len, parts.values()), default=0) >= MIN_PARTS
    return tuple(parts) if alike and many and not PLACES & {name.lower() for name in parts} else ()


def _has_points(table: PointTable, animal: str) -> bool:
    """Not NaN, 0 nor -1 everywhere, as DeepLabCut fills animals that it never saw."""
    columns = [j for j, c in enumerate(table.columns) if c.individual == animal and c.coord != "likelihood"]
    return not np.isin(np.nan_to_num(table.numbers[:, columns]), (0.0, PADDING)).all()


def header_problem(path: Path, found: str) -> Problem:
    return Problem(path, "header", found, "; or ".join(", ".join(h) for h in HEADERS))


# -- writing ---------------------------------------------------------------------------------------------------------


def write_csv(data: Keypoints | Pose3D, path: Path) -> None:
    """x, y and likelihood, or x, y, z in metres with z up."""
    header, frames, values = layout(data)
    write_table(path, [[level, *cells] for level, cells in header.items()], frames, values)


def layout(data: Keypoints | Pose3D) -> tuple[dict[str, list[str]], np.ndarray, np.ndarray]:
    """Header cells by level, frame numbers (T,) and values (T, 3K)."""
    points = points_of(data)
    coords, values = ("x", "y", "z"), points.values
    if points.likelihood is not None:
        coords, values = ("x", "y", "likelihood"), np.concatenate([values, points.likelihood[..., None]], axis=2)
    n = len(points.names) * len(coords)
    header = {"scorer": [_with_fps(points.scorer, points.fps)] * n}
    if points.individual is not None:
        header["individuals"] = [points.individual] * n
    header |= {"bodyparts": [name for name in points.names for _ in coords], "coords": [*coords] * len(points.names)}
    return header, points.frames, values.reshape(len(values), -1)
