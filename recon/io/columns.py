"""Read and write plain tables, long (a row per frame and point) or wide (a row per frame).

Tables are CSV, Parquet, or in memory (pandas, movement). Columns are recognised by names in common use, regardless of
case, or by a map such as:

    frame=Frame, bodypart=Node, x=X, y=Y, likelihood=Score          (long: one row for each frame and point)
    frame=Frame, x={bodypart} X, y={bodypart} Y                     (wide: one row for each frame)

A suffix of a coordinate's column such as _px, _m or _mm is its unit.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.base.documents import MAX_UNPACKED, damage_as_input_error
from recon.base.errors import InputError, Problem, raise_problems
from recon.base.files import write_bytes
from recon.clip import Keypoints
from recon.io import common, writing
from recon.io.common import Pose3D, StoredPoints
from recon.io.deeplabcut import UNNAMED, points_of_table
from recon.io.formats import as_keypoints
from recon.io.times import seconds, since_first, with_times

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

Columns = Mapping[str, Any]
"""Columns of a table, keyed by name, as sequences of strings or arrays of numbers."""
ROLES: dict[str, tuple[str, ...]] = {
    "frame": (
        "frame",
        "frames",
        "frame_idx",
        "frame_index",
        "frame_id",
        "frame_number",
        "framenumber",
        "fnum",
        "frame number",
        "frame #",
        "frame#",
        "frame no",
        "frame nr",
    ),
    "time": ("time", "times", "seconds", "timestamp", "timestamps", "t"),
    "bodypart": ("bodypart", "body_part", "keypoint", "node", "joint", "marker", "landmark", "part", "point", "name"),
    "individual": (
        *("individual", "individuals", "animal", "animal_id", "track", "track_id", "trackid", "identity", "instance"),
        *("object_id", "subject"),
    ),
    "x": ("x",),
    "y": ("y",),
    "z": ("z",),
    "likelihood": ("likelihood", "confidence", "score", "conf", "prob", "p"),
    "fps": ("fps",),
}
"""Roles of columns, with the names by which they are recognised, in lower case."""
POINT_ROLES = ("x", "y", "z", "likelihood")
UNIT = r"(?:[ _]?[\[(]?(px|m|cm|mm)[\])]?)?"
TIME_UNIT = r"(?:[ _]?[\[(]?(s|sec|ms|us|µs|ns)[\])]?)?"
BODYPART_COLUMN = re.compile(
    rf"(.+?)(?:[ _.:/-]| ?[\[(])(?:([xyz]){UNIT}|({'|'.join(ROLES['likelihood'])}))[\])]?", re.IGNORECASE
)
"""Pattern of a column of one bodypart whose name ends with the coordinate, such as nose_x."""
BODYPART_LAST = re.compile(r"(?:([xyz])|(likelihood|confidence|score))[ _.:/-](.+)", re.IGNORECASE)
"""Pattern of a column of one bodypart whose name begins with the coordinate, such as x_nose."""
PART = "{bodypart}"
VALUES_MAX = 4 * common.POINTS_MAX
"""Largest number of cells of a table that is read."""
COLUMNS_MAX = 10_000
"""Largest number of columns of a table that is read."""
METADATA = b"recon"
"""Key of the metadata that recon writes into Parquet files, which are JSON with `fps` and `up`."""


_Meaning = tuple[str, str, str | None]
"""Bodypart of a column ("" if it applies to all), its role in `ROLES`, and its unit, if stated."""


@dataclass(frozen=True)
class _Layout:
    """Meaning of a table's columns."""

    columns: Mapping[tuple[str, str], str]
    """Name of the column for each bodypart ("" in a long table) and role."""
    unit: str | None
    """Unit of the coordinates; None if the columns state no unit, or several."""
    ignored: Sequence[str]
    """Names of the columns whose meaning is not known."""


def parse_map(text: str) -> dict[str, str]:
    """Return the name of the column for each role in a string such as "frame=Frame, x=X".

    Raises
    ------
    InputError
        If the string is not a map of columns. The message lists every problem.
    """
    columns: dict[str, str] = {}
    problems = []
    for item in text.split(","):
        role, _, column = (piece.strip() for piece in item.partition("="))
        if not column or role not in ROLES or role in columns:
            expected = f"ROLE=COLUMN, with each role only once; the roles are {', '.join(ROLES)}"
            problems.append(Problem("--columns", "map", f"'{item.strip()}'", expected))
        columns[role] = column
    wide = {role for role, column in columns.items() if PART in column}
    lacking = ({"x", "y"} if wide else {"x", "y", "bodypart"}) - columns.keys()
    if lacking:
        expected = f"a column for each, or x and y with {PART} in them"
        problems.append(Problem("--columns", "map", f"no {', '.join(sorted(lacking))}", expected))
    if not {"frame", "time"} & columns.keys():
        problems.append(Problem("--columns", "map", "no frame", "a column with frame numbers, or time in seconds"))
    if wide and wide != set(POINT_ROLES) & columns.keys() | {"bodypart"} & columns.keys():
        detail = f"{PART} in {', '.join(sorted(wide))}"
        expected = f"a wide table with {PART} in x, y and likelihood, or a long one with bodypart=COLUMN"
        problems.append(Problem("--columns", "map", detail, expected))
    raise_problems(problems)
    return columns


def _layout(columns: Sequence[str], meaning: Callable[[str], _Meaning | None]) -> _Layout | None:
    """Return the layout of a table of points, or None if the columns do not describe points.

    Bodyparts without x or y are ignored.
    """
    meanings: dict[tuple[str, str], tuple[str, str | None]] = {}
    for column in columns:
        if described := meaning(column):
            meanings.setdefault(described[:2], (column, described[2]))
    is_long = {("", "bodypart"), ("", "x"), ("", "y")} <= meanings.keys()
    bodyparts = {
        bodypart
        for bodypart, _ in meanings
        if bodypart and {(bodypart, "x"), (bodypart, "y")} <= meanings.keys() and not is_long
    }
    if not (is_long or bodyparts) or not {("", "frame"), ("", "time")} & meanings.keys():
        return None
    shared = [*ROLES] if is_long else ["frame", "time", "individual", "fps"]
    chosen = {
        key: described
        for key, described in meanings.items()
        if key[0] in bodyparts or (not key[0] and key[1] in shared)
    }
    units = {unit for (_, role), (_, unit) in chosen.items() if role in "xyz"}
    used = {key: column for key, (column, _) in chosen.items()}
    used_columns = {*used.values()}
    ignored = [column for column in columns if column.strip() and column not in used_columns]
    return _Layout(used, units.pop() if len(units) == 1 else None, ignored)


def _by_name(column: str) -> _Meaning | None:
    """Return the meaning of a column whose name is in common use."""
    text = column.strip()
    for role, known in ROLES.items():
        unit = TIME_UNIT if role == "time" else UNIT if role in "xyz" else "()"
        if match := re.fullmatch(f"(?:{'|'.join(known)}){unit}", text.lower()):
            return "", role, match[1] or None
    if match := BODYPART_COLUMN.fullmatch(text):
        return match[1], (match[2] or "likelihood").lower(), match[3]
    match = BODYPART_LAST.fullmatch(text)
    return (match[3], (match[1] or "likelihood").lower(), None) if match else None


def _by_map(columns: Mapping[str, str]) -> Callable[[str], _Meaning | None]:
    """Return a function that gives the meaning of a column according to a map."""
    patterns = {
        role: re.compile(re.escape(column).replace(re.escape(PART), "(.+)"))
        for role, column in sorted(columns.items(), key=lambda item: PART in item[1])
    }

    def meaning(column: str) -> _Meaning | None:
        matches = ((match, role) for role, pattern in patterns.items() if (match := pattern.fullmatch(column)))
        match, role = next(matches, (None, ""))
        return ("".join(match.groups()), role, None) if match else None

    return meaning


def recognises_long(path: Path) -> bool:
    """Return whether a file is a text table, long or wide, 2D or 3D, whose columns are recognised by name."""
    with path.open("rb") as file:
        first = file.readline(1 << 20)
        if re.match(rb'(?i)(\xef\xbb\xbf)?"?sep=."?[,;\s]*$', first):
            first += file.readline(1 << 20)
    try:
        text = first.decode("utf-8-sig")
        separator, skipped = common.table_start(text)
        header = next(csv.reader(text.splitlines()[skipped : skipped + 1], delimiter=separator), [])
    except (UnicodeDecodeError, csv.Error):
        return False
    columns = [*dict.fromkeys(_with_named_index(header))]
    # a wide table without frames is recognised, too, and refused when it is read
    return any(_layout(names, _by_name) is not None for names in (columns, ["frame", *columns]))


def _with_named_index(header: list[str]) -> list[str]:
    """Return a header in which an unnamed first column is called frame, as pandas writes its index in wide tables."""
    named = ["frame", *header[1:]]
    layouts = [_layout([*dict.fromkeys(names)], _by_name) for names in (header, named)]
    roles = {role for bodypart, role in layouts[1].columns if not bodypart} if layouts[1] else set()
    is_index = header[:1] in ([""], [UNNAMED]) and layouts[0] is None and roles <= {"frame", "fps"}
    return named if layouts[1] and is_index else header


def read_long(path: Path, individual: str | None = None, columns: Mapping[str, str] | None = None) -> StoredPoints:
    """Return the points of one animal in a text table.

    `columns` is the result of `parse_map` if the names of the columns are not recognised.
    """
    rows = common.text_rows(path)
    header = next(rows, (1, []))[1]
    header = header[: common.width_of([header])]
    header = header if columns else _with_named_index(header)
    table, problems = [], []
    for line, row in common.cut_blank(rows, len(header)):
        table.append(row)
        if len(row) != len(header):
            problems.append(Problem(path, f"line {line}", f"{len(row)} cells", f"{len(header)} cells, as in line 1"))
    raise_problems(common.first_problems(problems, path))
    cells = list(zip(*table, strict=True)) or [()] * len(header)
    by_name: dict[str, Sequence[str]] = {}
    repeated: dict[str, bool] = {}
    """Names of columns that appear twice in the table, and whether their cells are equal."""
    for name, column in zip(header, cells, strict=True):
        if name in by_name and name.strip():
            repeated[name] = repeated.get(name, True) and by_name[name] == column
        by_name.setdefault(name, column)
    meaning = _by_name if columns is None else _by_map(columns)
    twice = [name for name, same in repeated.items() if not same and meaning(name)]
    expected = "one column of this name, since the columns of this name differ"
    raise_problems(Problem(path, "header", f"column '{name}' more than once", expected) for name in twice)
    stored = points_of_columns(path, by_name, individual, columns)
    notes = tuple(f"Column '{name}' is in the table more than once: the first is read." for name in repeated)
    return replace(stored, notes=(*stored.notes, *notes))


def recognises_parquet(path: Path) -> bool:
    """Return whether a file is a Parquet file."""
    return common.starts_with(path, b"PAR1")


def read_parquet(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the 3D positions of a Parquet file."""
    with writing.formats_extra(path):
        import pyarrow as pa
        import pyarrow.parquet as pq
    size = pq.read_metadata(path)  # a column of equal values takes almost no space in the file
    unpacked = sum(size.row_group(group).total_byte_size for group in range(size.num_row_groups))
    if size.num_rows * size.num_columns > VALUES_MAX or size.num_columns > COLUMNS_MAX or unpacked > MAX_UNPACKED:
        limits = f"at most {VALUES_MAX} cells, {COLUMNS_MAX} columns and {MAX_UNPACKED >> 20} MB are read"
        raise ValueError(f"{size.num_rows} rows of {size.num_columns} columns, {unpacked >> 20} MB; {limits}")
    # Strings are read as indices into a list, so that repeated strings take memory only once.
    fields = pq.read_schema(path)
    kinds = pa.types.is_string, pa.types.is_large_string, pa.types.is_string_view, pa.types.is_dictionary
    texts = [field.name for field in fields if any(kind(field.type) for kind in kinds)]
    values = [field.name for field in fields if pa.types.is_integer(field.type) or pa.types.is_floating(field.type)]
    table = pq.read_table(path, columns=texts + values, read_dictionary=texts, use_threads=False)
    metadata = json.loads((table.schema.metadata or {}).get(METADATA, b"{}"))
    columns = {}
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_integer(column.type) or pa.types.is_floating(column.type):
            columns[name] = np.asarray(column.to_numpy(), dtype=float)
        elif pa.types.is_dictionary(column.type):
            dictionary_column = column.unify_dictionaries().combine_chunks()
            columns[name] = np.array([*dictionary_column.dictionary.to_pylist(), None], object)[
                dictionary_column.indices.fill_null(-1).to_numpy()
            ]
    pose = points_of_columns(path, columns, individual, None)
    return replace(
        pose, fps=pose.fps or common.rate(metadata.get("fps")), up="z" if metadata.get("up") == "z" else None
    )


def points_of_columns(
    path: Path, table: Columns, individual: str | None, column_map: Mapping[str, str] | None
) -> StoredPoints:
    """Return the points of one animal in a long or wide table that is in memory.

    `column_map` has the name of the column for each role. If it is None, columns are recognised by their names.

    Raises
    ------
    InputError
        If columns are unknown, cells are not numbers, a point appears twice in a frame, or coordinates are missing.
    """
    layout = _required_layout(path, table, column_map)
    columns = layout.columns
    role = {role: column for (bodypart, role), column in columns.items() if not bodypart}
    animal, rows = _rows_of_animal(path, table, role, individual)
    cells = _Cells(path, table, rows)
    rates = {*cells.numbers(role["fps"]).tolist()} if "fps" in role else {None}
    fps = common.rate(rates.pop()) if len(rates) == 1 else None
    ticks = _ticks_of(cells, role, column_map is None)
    distinct, row_of = np.unique(ticks, return_inverse=True)
    if not {"frame", "bodypart"} & role.keys() and (np.diff(ticks) >= 0).all():  # rounded times can repeat
        distinct, row_of = ticks, np.arange(len(ticks))
    if "bodypart" in role:
        index, point_of = _points_of_rows(cells, role["bodypart"])
        repeated = row_of * len(index) + point_of
    else:
        parts = dict.fromkeys(bodypart for bodypart, _ in columns if bodypart)
        index = {bodypart: k for k, bodypart in enumerate(parts)}
        point_of, repeated = row_of, row_of
    cells.require_unique(repeated)
    common.require_span(len(distinct), len(index), path)
    coords = ("x", "y", "z") if any(role == "z" for _, role in columns) else ("x", "y")
    values = np.full((len(distinct), len(index), len(coords) + 1), np.nan)
    for (bodypart, kind), column in columns.items():
        if kind in POINT_ROLES:
            point: Any = index[bodypart] if bodypart else point_of
            values[row_of, point, (*coords, "likelihood").index(kind)] = cells.numbers(column)
    if "z" in coords and "bodypart" not in role:
        flat = [bodypart for bodypart in index if (bodypart, "z") not in columns]
        cells.problems += [Problem(path, f"bodypart {bodypart}", "no z", ", ".join(coords)) for bodypart in flat]
    cells.raise_problems()
    left_out = layout.ignored if column_map is None else ()
    notes = (f"Columns left out: {', '.join(left_out)}.",) if left_out else ()
    unit = layout.unit if layout.unit != "px" else None
    frames = distinct if "frame" in role else np.arange(len(distinct))
    stored = StoredPoints(tuple(index), values[..., :-1], frames, values[..., -1], fps=fps, unit=unit, notes=notes)
    if "frame" not in role:
        stored = with_times(path, stored, distinct, fps)
    stored = common.one_animal(path, animal or None, stored, [animal] if animal else [])
    return common.without_lost_markers(stored) if stored.in_space else stored


def _required_layout(path: Path, table: Columns, column_map: Mapping[str, str] | None) -> _Layout:
    """Return the meaning of a table's columns, or raise InputError if columns are unknown or absent."""
    absent = [column for column in (column_map or {}).values() if PART not in column and column not in table]
    layout = _layout([*table], _by_name if column_map is None else _by_map(column_map))
    if layout is None or absent:
        expected = "the columns frame, bodypart, x, y, or frame, NAME_x, NAME_y, ...; or a map of columns (--columns)"
        detail = f"no '{absent[0]}' in {', '.join(table)[:120]}" if absent else ", ".join(table)[:120]
        if not absent and column_map is None and _layout(["frame", *table], _by_name):
            detail = f"no frame and no time in {detail}"
            expected = "a column frame, or a column time in seconds; or a map of columns (recon convert --columns)"
        raise InputError(Problem(path, "columns", detail, expected))
    return layout


def _rows_of_animal(
    path: Path, table: Columns, role: Mapping[str, str], individual: str | None
) -> tuple[str, np.ndarray]:
    """Return the chosen animal, "" if the table names none, and the numbers of its rows."""
    owners = [str(cell).strip() for cell in table[role["individual"]]] if "individual" in role else []
    animals = list(dict.fromkeys(owners)) or [""]
    animal = animals[common.choose(path, animals, individual)]
    if not owners:
        return animal, np.arange(len(table[next(iter(role.values()))]))
    return animal, np.flatnonzero([owner == animal for owner in owners])


class _Cells:
    """Cells in some rows of a table, with a list of the problems found in them."""

    def __init__(self, path: Path, table: Columns, rows: np.ndarray) -> None:
        self.path = path
        self.table = table
        self.rows = rows
        self.problems: list[Problem] = []

    def numbers(self, column: str) -> np.ndarray:
        """Return the cells of a column as floats, and record cells that are infinite or not numbers as problems."""
        cells, expected = self.table[column], "a number or an empty cell"
        values, wrong = common.numbers(cells[row] for row in self.rows)
        detail = [(f"line {row + 2}, {column}", f"'{str(cells[row]).strip()}'") for row in self.rows[wrong]]
        self.problems.extend(Problem(self.path, *fault, expected) for fault in detail)
        return values

    def require_unique(self, cell_of_row: np.ndarray) -> None:
        """Add a problem if two of the N rows have the same frame and point, which `cell_of_row` (N,) encodes."""
        first = np.unique(cell_of_row, return_index=True)[1]
        if len(first) < len(self.rows):
            line = self.rows[np.setdiff1d(np.arange(len(self.rows)), first)[0]] + 2
            actual = "a second row for the same frame and point"
            self.problems.append(Problem(self.path, f"line {line}", actual, "one row for each frame and point"))

    def raise_problems(self) -> None:
        """Raise InputError with the problems so far, if there are any."""
        raise_problems(common.first_problems(self.problems, self.path))


def _ticks_of(cells: _Cells, role: Mapping[str, str], is_by_name: bool) -> np.ndarray:
    """Return the frame number or the time in seconds of each row, or raise InputError for rows without one.

    `is_by_name` states whether the columns were recognised by their names, which can state the unit of a time.
    """
    clock = role.get("frame", role.get("time", ""))
    ticks = cells.numbers(clock) if "frame" in role else _times_of(cells, clock, is_by_name)
    for i in np.flatnonzero(np.isnan(ticks)):
        location = f"line {cells.rows[i] + 2}, {clock}"
        cells.problems.append(Problem(cells.path, location, "nothing", "a frame number, or a time in seconds"))
    cells.raise_problems()
    return ticks


def _times_of(cells: _Cells, clock: str, is_by_name: bool) -> np.ndarray:
    """Return the time of each row, in seconds, or raise InputError for times of an unknown form or unit.

    `clock` is the name of the column with the times.
    """
    stamps = seconds(cells.table[clock][row] for row in cells.rows)
    if stamps is not None:
        return stamps
    texts = (str(cells.table[clock][row]).strip() for row in cells.rows)
    unread = next((text for text in texts if re.match(r"\d+\D\d+\D\d", text) and ":" in text), None)
    if unread is not None:
        expected = "seconds, or time stamps such as 2024-05-01T12:00:00.5 or 12:00:00.5"
        raise InputError(Problem(cells.path, clock, f"'{unread}'", expected))
    unit = (_by_name(clock) or ("", "", None))[2] if is_by_name else None
    times_s = since_first(cells.numbers(clock), unit)
    step_s = float(np.median(np.diff(np.unique(times_s)))) if len({*times_s.tolist()}) > 1 else 0.0
    if step_s > 1.0 and unit is None:
        expected = "times in seconds, at most 1 s apart; if these are milliseconds, name the column time_ms"
        raise InputError(Problem(cells.path, clock, f"times {step_s:g} s apart", expected))
    return times_s


def _points_of_rows(cells: _Cells, column: str) -> tuple[dict[str, int], np.ndarray]:
    """Return the index of each point by its name, and the index of each row's point, (N,)."""
    labels = cells.table[column]
    stripped = {label: str(label).strip() for label in {*labels}}
    points = [stripped[labels[row]] for row in cells.rows.tolist()]
    index = {name: k for k, name in enumerate(dict.fromkeys(points))}
    return index, np.array([index[point] for point in points], dtype=int)


def write_long(keypoints: Keypoints, path: Path) -> None:
    """Write a row of frame, individual (if named), bodypart, x, y, likelihood, fps for each frame and keypoint."""
    start = {} if keypoints.individual is None else {"individual": keypoints.individual}
    end = {} if keypoints.fps is None else {"fps": keypoints.fps}
    values = np.concatenate([keypoints.xy_px, keypoints.confidence[..., None]], axis=2)
    rows = (
        [frame, *start.values(), name, *point, *end.values()]
        for frame, points in zip(keypoints.frames, values, strict=True)
        for name, point in zip(keypoints.names, points, strict=True)
    )
    writing.write_rows(path, [["frame", *start, "bodypart", "x", "y", "likelihood", *end]], rows, guard=False)


def write_parquet(pose: Pose3D, path: Path) -> None:
    """Write a row of frame, joint, x_m, y_m, z_m (in metres with z up) for each frame and joint.

    A fit's standard deviations and flags are further columns.
    """
    with writing.formats_extra("Parquet"):
        import pyarrow as pa
        import pyarrow.parquet as pq
    T, J = pose.xyz_m.shape[:2]
    columns = {"frame": pa.array(np.repeat(pose.frames, J), pa.int64())}
    columns["joint"] = pa.array(list(pose.names) * T, pa.string())
    columns |= {f"{axis}_m": pa.array(pose.xyz_m[..., i].ravel(), pa.float64()) for i, axis in enumerate("xyz")}
    if pose.sigma_m is not None and pose.flags is not None:
        columns |= {f"{axis}_sigma_m": pa.array(pose.sigma_m[..., i].ravel()) for i, axis in enumerate("xyz")}
        columns["flags"] = pa.array(np.repeat(pose.flags, J))
    metadata = {"fps": pose.fps, "unit": "m", "up": "z", "notes": pose.notes}
    buffer = BytesIO()
    pq.write_table(pa.table(columns).replace_schema_metadata({METADATA: json.dumps(metadata)}), buffer)
    write_bytes(path, buffer.getvalue())


BODYPARTS = ("bodyparts", "keypoints", "bodypart", "keypoint")
INDIVIDUALS = ("individuals", "individual")


def from_dataframe(table: pd.DataFrame, fps: float | None, individual: str | None) -> Keypoints:
    """Return keypoints from a pandas table, as described in `recon.Keypoints.from_dataframe`."""
    source = Path("DataFrame")
    with damage_as_input_error(
        source, "numbers, with DeepLabCut's levels or in columns frame, keypoint, x, y, confidence"
    ):
        if table.columns.nlevels > 1:
            stored = _points_of_levels(source, table, individual)
        else:
            stored = points_of_columns(
                source, {str(name): table[name].to_numpy() for name in table.columns}, individual, None
            )
    return _keypoints(source, stored, fps)


def _points_of_levels(source: Path, table: pd.DataFrame, individual: str | None) -> StoredPoints:
    """Return the points of a pandas table whose columns have DeepLabCut's levels, such as bodyparts and coords.

    If the levels have no names, the last level has the coordinates and the level before it the bodyparts.
    """
    levels = [str(name or "").lower() for name in table.columns.names]
    part_level = next((i for i, level in enumerate(levels) if level in BODYPARTS), len(levels) - 2)
    animal_level = next((i for i, level in enumerate(levels) if level in INDIVIDUALS), None)
    labels = []
    for column in table.columns:
        coord = "likelihood" if str(column[-1]).lower() in ROLES["likelihood"] else str(column[-1])
        labels.append(("", "" if animal_level is None else str(column[animal_level]), str(column[part_level]), coord))
    frames = table.index.to_numpy() if table.index.to_numpy().dtype.kind in "iu" else np.arange(len(table))
    names = ("scorer", "individuals", "bodyparts", "coords")
    index = [(str(frame),) for frame in frames]
    return points_of_table(source, individual, names, labels, index, table.to_numpy(dtype=float))


def from_xarray(dataset: xr.Dataset, fps: float | None, individual: str | None) -> Keypoints:
    """Return keypoints from a dataset of the `movement` package, as described in `recon.Keypoints.from_xarray`."""
    from recon.io.hdf5_poses import points_of_dataset

    source = Path("Dataset")
    with damage_as_input_error(source, "poses in movement's layout"):
        return _keypoints(source, points_of_dataset(source, dataset, fps, individual), fps)


def _keypoints(source: Path, stored: StoredPoints, fps: float | None) -> Keypoints:
    if stored.in_space:
        raise InputError(
            Problem(source, "space", "positions in x, y, z", "positions in x and y, in pixels of one camera")
        )
    keypoints = as_keypoints(source, stored)
    return replace(keypoints, fps=keypoints.fps if fps is None else fps, source=None)
