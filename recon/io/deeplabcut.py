"""Read and write DeepLabCut's tables: predictions and labels, of one or several animals, and 3D positions.

A table has one row per frame and a header of several levels: `scorer`, `individuals` (several animals only),
`bodyparts`, `coords`. Prediction files number their rows by frame. Label files index them by image path, in one column
or three, and have no likelihood. Recon's own files have the frame rate in the scorer, `recon_90fps`, because the format
has no field for it.

This module interprets tables and reads and writes CSV files, and `recon.io.hdf5_poses` reads and writes H5 files.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PureWindowsPath

import numpy as np

from recon.base.errors import InputError, Problem, raise_problems
from recon.base.numbers import counted
from recon.clip import Keypoints
from recon.io import common
from recon.io.common import SCORER, Pose3D, StoredPoints
from recon.io.pickles import MAX_PICKLE_BYTES, plain_parts_of_pickle

HEADERS = (
    ("scorer", "bodyparts", "coords"),
    ("scorer", "individuals", "bodyparts", "coords"),
    ("bodyparts", "coords"),
    ("individuals", "bodyparts", "coords"),
)
UNNAMED = "Unnamed: 0"
"""Name that pandas gives to the column of its row numbers when it reads a table that it wrote."""
COORDS, COORDS_2D = ("x", "y", "z", "likelihood"), ("x", "y", "likelihood")
# Individual to which DeepLabCut assigns bodyparts that belong to no animal, such as the corners of the arena.
UNIQUE_BODYPARTS = "single"
PADDING = -1.0
"""Value of x, y and likelihood in frames in which DeepLabCut 3 did not see the animal."""
TRIANGULATED = (
    "These positions were triangulated by DeepLabCut. They have the unit of its calibration board and, unless they "
    "were rotated, the axes of its first camera (y down, z ahead). They are read with z up: if they were not rotated, "
    "give --up -y."
)
MAX_CROP_PX = 100_000
_SIDE_WORDS = {"l", "r", "left", "right", "near", "far"}
POSITION_WORDS = _SIDE_WORDS | {"f", "h", "front", "back", "fore", "hind", "rear", "upper", "lower"}
"""Words for a position on the body, which are not names of animals when they are prefixes of bodyparts."""
MIN_PARTS = 3
"""Minimum number of bodyparts with the same prefix required to read the prefix as the name of an animal."""


def recognises_csv(path: Path) -> bool:
    """Return whether a text file has DeepLabCut's header rows."""
    with path.open("rb") as file:
        head = re.sub(rb'(?i)^"?sep=."?[,;\s]*[\r\n]+', b"", file.read(64).removeprefix(b"\xef\xbb\xbf"))
    return (
        re.match(rb'(Unnamed: 0)?[\s,;]*"?\s*(scorer|individuals|bodyparts)\s*"?\s*([,;|\t\r\n]|$)', head) is not None
    )


def read_csv(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the points of one animal in a CSV file (see `points_of_table`)."""
    rows = _without_blank_start(common.text_rows(path))
    header, index_columns = _read_header(path, rows)
    width = index_columns + len(next(iter(header.values())))
    header, whole_rows = _without_blank_columns(header, common.cut_blank(rows, width), index_columns)
    return points_of_rows(path, header, whole_rows, index_columns, individual)


def _without_blank_start(rows: Iterator[tuple[int, list[str]]]) -> Iterator[tuple[int, list[str]]]:
    """Yield rows without the blank cells and pandas' row numbers before the first cell of the header."""
    start: int | None = None
    for line, row in rows:
        if start is None:
            start = next((j for j, cell in enumerate(row) if cell.strip() not in ("", UNNAMED)), 0)
        is_empty = all(cell.strip() in ("", UNNAMED) or cell.strip().isdigit() for cell in row[:start])
        yield line, row[start:] if is_empty else row


def _without_blank_columns(
    header: dict[str, list[str]], rows: common.Rows, index_columns: int
) -> tuple[dict[str, list[str]], common.Rows]:
    """Return the header, and the rows, without columns that are blank in all rows of the header.

    A row with a value in such a column keeps its length, which is then reported as a problem.
    """
    names = [*zip(*header.values(), strict=True)]
    kept = [j for j, cells in enumerate(names) if any(map(str.strip, cells))]
    if len(kept) == len(names):
        return header, rows
    blank = [index_columns + j for j in range(len(names)) if j not in {*kept}]
    columns = [*range(index_columns), *(index_columns + j for j in kept)]

    def shorter() -> Iterator[tuple[int, list[str]]]:
        for line, row in rows:
            is_whole = len(row) == index_columns + len(names) and not any(row[j].strip() for j in blank)
            yield line, [row[j] for j in columns] if is_whole else row

    return {level: [cells[j] for j in kept] for level, cells in header.items()}, shorter()


def points_of_rows(
    path: Path, header: dict[str, list[str]], rows: common.Rows, index_columns: int, individual: str | None = None
) -> StoredPoints:
    """Return the points of one animal in the rows of DeepLabCut's table.

    `header` has the strings above the data's columns, keyed by level. Each row begins with `index_columns` cells that
    give the frame.

    Raises
    ------
    InputError
        If cells or columns are invalid.
    """
    labels = list(zip(*header.values(), strict=True))
    index, values, problems = common.number_rows(path, rows, ["/".join(label[-2:]) for label in labels], index_columns)
    return points_of_table(path, individual, [*header], labels, index, values, problems)


def _read_header(path: Path, rows: Iterator[tuple[int, list[str]]]) -> tuple[dict[str, list[str]], int]:
    """Return the strings of each header row without the index columns, and the number of index columns."""
    header: dict[str, list[str]] = {}
    first = ""
    for _, row in rows:
        first = row[0].strip()
        if first not in HEADERS[1] or first in header:
            break
        header[first] = row
        if first == "coords":
            break
    else:
        raise InputError(header_problem(path, f"the end of the file after {', '.join(header)}"))
    if tuple(header) not in HEADERS:
        detail = ", ".join(dict.fromkeys((*header, first[:40])))
        raise InputError(header_problem(path, f"rows that begin with '{detail}'"))
    width = common.width_of(header.values())
    header = {level: row if any(map(str.strip, row[width:])) else row[:width] for level, row in header.items()}
    if len({len(row) for row in header.values()}) != 1:
        lengths = ", ".join(f"{len(row)} in {name}" for name, row in header.items())
        raise InputError(
            Problem(
                path,
                "header rows",
                f"rows of different length (cells: {lengths})",
                "the same number of cells in every row",
            )
        )
    # Label files name the image in three columns, whose cells in the header are blank except for the first column.
    index_columns = 3 if [cell.strip() for cell in header["coords"][1:3]] == ["", ""] else 1
    columns = {level: row[index_columns:] for level, row in header.items()}
    raise_problems(_merged_cells(path, columns))
    return columns, index_columns


def _merged_cells(path: Path, header: dict[str, list[str]]) -> Iterator[Problem]:
    """Yield a problem for a level whose names appear only above the first of several columns."""
    for level, cells in header.items():
        names = [cell.strip() for cell in cells]
        if (
            names
            and names[0]
            and "" in names
            and any(header["coords"][j].strip() for j, n in enumerate(names) if not n)
        ):
            detail = f"empty cells after '{names[names.index('') - 1]}', as merged cells leave them"
            yield Problem(path, f"header row {level}", detail, "a name in every column: unmerge the cells")


def header_problem(path: Path, header: str) -> Problem:
    """Return the problem with a header that is not DeepLabCut's."""
    return Problem(path, "header", header, "; or ".join(", ".join(h) for h in HEADERS))


def _without_fps(scorer: str) -> tuple[str, float | None]:
    """Return the scorer, and the frame rate that recon's own files append to it."""
    match = re.fullmatch(rf"(?:(.*)_)?{SCORER}_([0-9.e+-]+)fps", scorer)
    fps = common.rate(match[2]) if match else None
    return (scorer, None) if match is None or fps is None else (match[1] or SCORER, fps)


Column = tuple[str, str, str]
"""Individual, bodypart and coordinate of a column."""


def points_of_table(
    path: Path,
    individual: str | None,
    levels: Sequence[str | None],
    labels: Sequence[tuple[str, ...]],
    rows: Sequence[Sequence[str]],
    values: np.ndarray,
    problems: Sequence[Problem] = (),
) -> StoredPoints:
    """Return the points of one animal in a table whose columns have several levels.

    Parameters
    ----------
    path : path
        The file, for messages.
    individual : str or None
        Name of the animal, needed if there are several.
    levels : sequence of str
        Names of the levels.
    labels : sequence of tuple of str
        Strings in the header of each of C columns, one for each level.
    rows : sequence of sequence of str
        Strings that name each of T rows: a frame number or the path of an image.
    values : array, shape (T, C)
        Numbers of the table, NaN in empty cells.
    problems : sequence of Problem
        Problems already found in the table.

    Raises
    ------
    InputError
        If `problems` are given, if columns or frame numbers are invalid, or if no animal can be chosen.
    """
    named = [dict(zip(levels, label, strict=True)) for label in labels]
    columns, blank_notes = _stripped(named)
    kept, extra_notes = _without_extra(columns)
    named, columns, values = [named[j] for j in kept], [columns[j] for j in kept], values[:, kept]
    frames, images, frame_problems = _frame_numbers(path, rows)
    raise_problems(common.first_problems([*_column_problems(path, columns), *problems, *frame_problems], path))
    columns = _with_animals_of_prefixes(columns)
    _require_one_scorer(path, [n.get("scorer", "").strip() for n in named], columns)
    columns, values, repeat_notes = _without_repeats(columns, values)
    animal, animal_columns, choice_notes = _choose_animal(path, columns, values, individual)
    notes = (*blank_notes, *extra_notes, *repeat_notes, *choice_notes)
    order = np.argsort(frames, kind="stable")
    if (np.diff(order) < 0).any():
        values = values[order]
        notes += ("The rows were not in the order of their frame numbers and have been sorted.",)
    names, points = _points(path, [(j, *columns[j][1:]) for j in animal_columns], values)
    scorer, fps = _without_fps(named[0]["scorer"]) if "scorer" in named[0] else (None, None)
    in_space = any(columns[j][2] == "z" for j in animal_columns)
    likelihood = None
    if not in_space:
        points[(points == PADDING).all(axis=2)] = np.nan, np.nan, 0.0
        points, likelihood = points[..., :2], points[..., 2]
        if scorer is None:
            notes += ("The header's first row, scorer, is missing; the remaining rows name every column.",)
        if not images:
            points, crop_notes = _uncropped(path, points, likelihood)
            notes += crop_notes
    if common.FMPOSE3D in (scorer or ""):
        from recon.io.json_poses import true_names

        names, renaming = true_names(names, scorer or "", in_space)
        notes += renaming
    stored = StoredPoints(
        names,
        points,
        frames[order],
        likelihood,
        fps=fps,
        scorer=None if in_space else scorer,
        images=tuple(images[i] for i in order) if images else (),
        notes=notes,
    )
    if in_space:
        stored = _with_axes(stored, scorer)
    stored = common.one_animal(path, animal or None, stored, [animal] if animal else [])
    return common.without_lost_markers(stored) if in_space else stored


def _stripped(named: Sequence[Mapping[str | None, str]]) -> tuple[list[Column], tuple[str, ...]]:
    """Strip spaces around the names of columns, and return a note on each name that had any.

    `named` has the strings in the header of each column, keyed by the level of the header.
    """
    columns, spaced = [], dict[str, None]()
    for texts in named:
        animal, bodypart = texts.get("individuals", ""), texts["bodyparts"]
        spaced |= dict.fromkeys(name for name in (animal, bodypart) if name != name.strip())
        columns.append((animal.strip(), bodypart.strip(), texts["coords"].strip()))
    return columns, tuple(f"'{name}' is read as '{name.strip()}'." for name in spaced)


def _without_extra(columns: Sequence[Column]) -> tuple[list[int], tuple[str, ...]]:
    """Return the indices of the columns to read, and a note on the others.

    Columns of further values of a point, such as the variances that an ensemble Kalman smoother writes, are left out if
    the point has a position and a likelihood, or a position in space.
    """
    coords: dict[tuple[str, str], set[str]] = {}
    for animal, bodypart, coord in columns:
        coords.setdefault((animal, bodypart), set()).add(coord)
    whole = {point for point, present in coords.items() if present >= {*COORDS_2D} or present >= {*"xyz"}}
    kept = [j for j, (animal, bodypart, c) in enumerate(columns) if c in COORDS or (animal, bodypart) not in whole]
    extra = dict.fromkeys(columns[j][2] for j in range(len(columns)) if j not in {*kept})
    return kept, (f"Columns left out: {', '.join(extra)}.",) if extra else ()


def _with_animals_of_prefixes(columns: list[Column]) -> list[Column]:
    """Split columns such as B_nose into animal and bodypart, if the table does not name its animals otherwise."""
    if any(animal for animal, _, _ in columns) or not _prefixes(bodypart for _, bodypart, _ in columns):
        return columns
    return [(bodypart.partition("_")[0], bodypart.partition("_")[2], coord) for _, bodypart, coord in columns]


def _with_axes(stored: StoredPoints, scorer: str | None) -> StoredPoints:
    """Return 3D points with the unit and the upward axis that their writer uses, as far as they are known."""
    if scorer == SCORER:
        return replace(stored, unit="m", up="z")
    if scorer is None or common.FMPOSE3D in scorer:
        return replace(stored, unit="m")
    return replace(stored, notes=(*stored.notes, TRIANGULATED))


def _require_one_scorer(path: Path, scorers: Sequence[str], columns: Sequence[Column]) -> None:
    """Raise InputError if several scorers have points of the same name."""
    distinct = list(dict.fromkeys(scorers))
    if len(distinct) > 1 and len({*columns}) < len(columns):
        detail = f"points of {len(distinct)} scorers: {', '.join(distinct)[:120]}"
        raise InputError(Problem(path, "scorer", detail, "points of one scorer: delete the columns of the others"))


def _without_repeats(columns: list[Column], values: np.ndarray) -> tuple[list[Column], np.ndarray, tuple[str, ...]]:
    """Return the columns without those that repeat an earlier column, their values, and a note."""
    repeats = _equal_repeats(columns, values)
    if not repeats:
        return columns, values, ()
    twice = ", ".join(dict.fromkeys(columns[j][1] for j in repeats))
    note = f"Columns of {twice} are in the table more than once, with the same numbers: the first are read."
    distinct = [j for j in range(len(columns)) if j not in repeats]
    return [columns[j] for j in distinct], values[:, distinct], (note,)


def _choose_animal(
    path: Path, columns: Sequence[Column], values: np.ndarray, individual: str | None
) -> tuple[str, list[int], tuple[str, ...]]:
    """Return the chosen animal, the indices of its columns, and a note on points that belong to no animal."""
    everyone = list(dict.fromkeys(animal for animal, _, _ in columns))
    animals = [name for name in everyone if name != UNIQUE_BODYPARTS] or everyone
    columns_by_animal = {name: [j for j, column in enumerate(columns) if column[0] == name] for name in everyone}
    # DeepLabCut writes 0 or `PADDING` for animals that it never detected.
    coordinates = (values[:, [j for j in columns_by_animal[name] if columns[j][2] != "likelihood"]] for name in animals)
    seen = (not np.isin(np.nan_to_num(cells), (0.0, PADDING)).all() for cells in coordinates)
    animal = animals[common.choose(path, animals, individual, seen)]
    if animal == UNIQUE_BODYPARTS or UNIQUE_BODYPARTS not in everyone:
        return animal, columns_by_animal[animal], ()
    left_out = dict.fromkeys(columns[j][1] for j in columns_by_animal[UNIQUE_BODYPARTS])
    note = f"Left out, because they belong to no animal: {', '.join(left_out)}."
    return animal, columns_by_animal[animal], (note,)


def _equal_repeats(columns: Sequence[tuple[str, str, str]], values: np.ndarray) -> set[int]:
    """Return the indices of columns that repeat the name and the numbers of an earlier column."""
    first: dict[tuple[str, str, str], int] = {}
    return {
        j
        for j, column in enumerate(columns)
        if first.setdefault(column, j) != j and np.array_equal(values[:, j], values[:, first[column]], equal_nan=True)
    }


def _uncropped(path: Path, points: np.ndarray, likelihood: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Return points (T, K, 2) in pixels of the whole picture, and a note if DeepLabCut analysed a crop of it.

    DeepLabCut's predictions are then in pixels of the crop. Its metadata file states the position of the crop.
    """
    meta = next((file for file in _metadata_files(path) if file.is_file()), None)
    if meta is None:
        return points, ()
    try:
        if meta.stat().st_size > MAX_PICKLE_BYTES:
            raise ValueError("a large pickle")
        metadata = plain_parts_of_pickle(meta.read_bytes())["data"]
        is_cropped = bool(metadata.get("cropping", False))
    except (ValueError, KeyError, TypeError, AttributeError, OSError):
        return points, (
            f"{meta.name} cannot be read: if DeepLabCut analysed a crop, the keypoints are in pixels of the crop.",
        )
    if not is_cropped:
        return points, ()
    try:
        left, right, top, bottom = edges = [float(edge) for edge in metadata["cropping_parameters"]]
        is_known = all(0 <= edge < MAX_CROP_PX for edge in edges)
    except (ValueError, KeyError, TypeError):
        left = right = top = bottom = math.nan
        is_known = False
    if not is_known:
        stated = str(metadata.get("cropping_parameters", "nothing"))[:60]
        expected = (
            "x1, x2, y1, y2 of the crop that DeepLabCut analysed; without this file, the keypoints are not shifted"
        )
        raise InputError(Problem(meta, "cropping_parameters", stated, expected))
    if (left, top) == (0.0, 0.0):
        return points, ()
    missing = (points == 0).all(axis=2) & ~(likelihood > 0)
    region = f"x {left:g} to {right:g}, y {top:g} to {bottom:g}"
    note = f"DeepLabCut analysed a crop of the picture ({region}, {meta.name}): its corner is added to the keypoints."
    return np.where(missing[..., None], points, points + np.array((left, top))), (note,)


def _metadata_files(path: Path) -> Iterator[Path]:
    """Yield the possible paths of DeepLabCut's metadata for a table of (filtered or tracked) predictions."""
    stem = path.stem
    yield path.with_name(f"{stem}_meta.pickle")
    for end in ("_filtered", "_el", "_bx", "_sk", "_ctd"):
        if stem.endswith(end):
            stem = stem.removesuffix(end)
            yield path.with_name(f"{stem}_meta.pickle")


def _column_problems(path: Path, columns: Sequence[tuple[str, str, str]]) -> Iterator[Problem]:
    if not columns:
        yield Problem(path, "header rows", "no columns", "at least one bodypart")
    distinct = dict.fromkeys(columns)
    columns_with = Counter(coord for _, _, coord in distinct)
    named = {*COORDS}
    for animal, bodypart, coord in distinct:
        location = f"column {'/'.join(filter(None, (animal, bodypart, coord)))}"
        if coord not in named:  # once for all columns, since a renamed coordinate is in all of them
            named.add(coord)
            count = columns_with[coord]
            detail = f"coordinate '{coord}'" + (f", as in {counted(count - 1, 'more column')}" if count > 1 else "")
            yield Problem(path, location, detail, ", ".join(COORDS))
        if not bodypart or not f"{animal}{bodypart}".isprintable():
            yield Problem(path, location, "a bodypart without a printable name", "printable characters")


def _points(
    path: Path, columns: Sequence[tuple[int, str, str]], values: np.ndarray
) -> tuple[tuple[str, ...], np.ndarray]:
    """Return the bodyparts in columns (index, bodypart, coordinate), and their coordinates (T, K, 3).

    Raises
    ------
    InputError
        If a bodypart lacks a coordinate or has one twice.
    """
    required = ("x", "y", "z") if any(coord == "z" for _, _, coord in columns) else ("x", "y")
    coords = required if "z" in required else COORDS_2D
    indices_of: dict[str, dict[str, list[int]]] = {}
    for j, bodypart, coord in columns:
        indices_of.setdefault(bodypart, {}).setdefault(coord, []).append(j)
    problems = []
    points = np.full((len(values), len(indices_of), 3), np.nan)
    for k, (bodypart, by_coord) in enumerate(indices_of.items()):
        if any(len(indices) > 1 for indices in by_coord.values()):
            repeated = ", ".join(coord for coord, indices in by_coord.items() if len(indices) > 1)
            detail = f"several columns {repeated} with different numbers"
            problems.append(Problem(path, f"bodypart {bodypart}", detail, "one column for each coordinate"))
        if lacking := [coord for coord in required if coord not in by_coord]:
            problems.append(
                Problem(
                    path,
                    f"bodypart {bodypart}",
                    f"no column {', '.join(lacking)}",
                    f"the columns {', '.join(required)}",
                )
            )
        for i, coord in enumerate(coords):
            if coord in by_coord:
                points[:, k, i] = values[:, by_coord[coord][0]]
    raise_problems(common.first_problems(problems, path))
    return tuple(indices_of), points


def _frame_numbers(path: Path, index: Sequence[Sequence[str]]) -> tuple[np.ndarray, list[str], list[Problem]]:
    """Return the frame numbers (T,) in the index cells, the names of labelled pictures, and problems."""
    texts = ["/".join(cell for cell in cells if cell).strip() for cells in index]
    labels = bool(texts) and re.search(r"[/\\]|\.[A-Za-z]\w*$", texts[0]) is not None
    frames, problems = [], []
    for row, text in enumerate(texts, 1):
        # PureWindowsPath splits at both kinds of slash.
        stem, pattern = (PureWindowsPath(text).stem, r".*?([0-9]+)") if labels else (text, r"(-?[0-9]+)(?:\.0*)?")
        match = re.fullmatch(pattern, stem, re.DOTALL)
        frame = common.frame_number(match[1], -common.MAX_FRAME) if match else None
        if frame is None:
            expected = "an image name that ends in the frame number" if labels else "a frame number (0, 1, 2, ...)"
            problems.append(Problem(path, f"row {row} below the header", f"'{text[:200]}'", expected))
        frames.append(frame or 0)
    folders = list(dict.fromkeys(PureWindowsPath(text).parent.as_posix() for text in texts)) if labels else []
    if len(folders) > 1:
        detail = f"{len(folders)} folders: {', '.join(folders[:3])}"
        problems.append(Problem(path, "images", detail, "the images of one video"))
    return np.array(frames, dtype=np.int64), texts if labels else [], problems


def _prefixes(bodyparts: Iterable[str]) -> tuple[str, ...]:
    """Return the prefixes of bodypart names that stand for animals, such as B and W in B_nose, B_tail, W_nose, W_tail.

    No prefix is returned if one of them names a position on an animal, or if the animals have different bodyparts.
    """
    of_prefix: dict[str, set[str]] = {}
    for name in bodyparts:
        animal, _, bodypart = name.partition("_")
        of_prefix.setdefault(animal, set()).add(bodypart)
    same_parts = len(of_prefix) > 1 and len({*map(frozenset, of_prefix.values())}) == 1
    least_count = min(map(len, of_prefix.values()), default=0) >= MIN_PARTS
    return (
        tuple(of_prefix)
        if same_parts and least_count and not POSITION_WORDS & {name.lower() for name in of_prefix}
        else ()
    )


def write_csv(data: Keypoints | Pose3D, path: Path) -> None:
    """Write DeepLabCut's CSV file of keypoints (x, y, likelihood), or of 3D points (x, y, z in metres with z up)."""
    from recon.io.writing import deeplabcut_layout, write_table

    header, frames, values = deeplabcut_layout(data)
    write_table(path, [[level, *cells] for level, cells in header.items()], frames, values, guard=False)
