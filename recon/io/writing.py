"""Functions shared by the writers of several formats.

The functions convert points to the unit and axes of a file, check names and frame numbers, and write text tables whose
numbers are read back exactly.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import TypeAdapter

from recon.base.errors import InputError, Problem, raise_problems
from recon.base.file_names import encodable
from recon.base.tables import guarded
from recon.clip import Keypoints, frame_ranges
from recon.io.common import MAX_FRAME, SCORER, Pose3D, StoredPoints, require_span

if TYPE_CHECKING:
    import pyarrow as pa


@contextmanager
def formats_extra(path: str | Path) -> Iterator[None]:
    """Raise InputError with the install command if a library of the extra `formats` is missing in the block."""
    try:
        yield
    except ModuleNotFoundError as error:
        from recon.base.package import install_command

        detail = f"a format that needs the package {(error.name or '').split('.')[0]}, which is not installed"
        raise InputError(Problem(path, "format", detail, install_command("formats"))) from None


def points_of(data: Keypoints | Pose3D) -> StoredPoints:
    """Return keypoints in pixels, or 3D positions in metres with z up, as `StoredPoints`."""
    if isinstance(data, Keypoints):
        return StoredPoints(
            data.names, data.xy_px, data.frames, data.confidence, data.fps, data.individual, scorer=data.scorer
        )
    return StoredPoints(data.names, data.xyz_m, data.frames, fps=data.fps, unit="m", up="z", edges=data.edges)


def y_up_from_z_up(xyz: np.ndarray) -> np.ndarray:
    """Return points (..., 3) with x forwards, y up, z right, from points with x forwards, y left, z up."""
    return np.stack([xyz[..., 0], xyz[..., 2], -xyz[..., 1]], axis=-1)


def index_edges(names: Sequence[str], edges: Sequence[tuple[str, str]]) -> np.ndarray:
    """Return the pairs of names as indices, (E, 2) int."""
    return np.array([[names.index(a), names.index(b)] for a, b in edges], dtype=np.int64).reshape(-1, 2)


def frames_text(frames: np.ndarray) -> list[str]:
    """Return increasing frame numbers as ranges with both ends, such as ["10-12", "15"] for 10, 11, 12, 15."""
    return [f"{a}" if b == a + 1 else f"{a}-{b - 1}" for a, b in frame_ranges(frames)]


def frames_of_text(ranges: Iterable[str]) -> np.ndarray | None:
    """Return the frame numbers in a string that `frames_text` made, or None for anything else."""
    frames: list[np.ndarray] = []
    last = -MAX_FRAME - 1
    for text in ranges:
        match = re.fullmatch(r"(-?[0-9]{1,10})(?:-(-?[0-9]{1,10}))?", text)
        first, end = (int(match[1]), int(match[2] or match[1])) if match else (0, -1)
        if not last < first <= end <= MAX_FRAME or end - first > 10**7:
            return None
        frames.append(np.arange(first, end + 1))
        last = end
    return np.concatenate(frames) if frames else None


def required_fps(fps: float | None, title: str) -> float:
    """Return the frame rate that a format requires.

    `title` is the name of the format, for the error.

    Raises
    ------
    InputError
        If the frame rate is not known.
    """
    if fps is None:
        detail = "no frame rate, neither given nor in the input"
        raise InputError(Problem("--fps", "fps", detail, f"frames per second, such as 90, which {title} requires"))
    return fps


def require_names(names: Sequence[str], forbidden: str, title: str, bytes_max: int = 65_535) -> None:
    """Raise InputError for names that match the pattern `forbidden` or are too long.

    `title` is the name of the format, for the error.
    """
    problems = []
    for name in names:
        if match := re.search(forbidden, name):
            problems.append(Problem(title, "name", f"'{name}', with {match.group()!r} in it", "a name without it"))
        if (size := len(name.encode())) > bytes_max:
            problems.append(Problem(title, "name", f"'{name}', {size} bytes in UTF-8", f"at most {bytes_max}"))
    raise_problems(problems[:10])


def without_gaps(frames: np.ndarray, values: np.ndarray, title: str) -> np.ndarray:
    """Return values (T, ...) with rows of NaN for absent frame numbers.

    `title` is the name of the format, for the error.

    Raises
    ------
    InputError
        If the gaps would make the file far too long.
    """
    span = int(frames[-1] - frames[0]) + 1
    require_span(span, values.shape[1], title)
    regular = np.full((span, *values.shape[1:]), np.nan)
    regular[frames - frames[0]] = values
    return regular


def write_table(
    path: Path, header: Iterable[Sequence[str]], frames: np.ndarray, values: np.ndarray, guard: bool = True
) -> None:
    """Write header rows, then one row per frame with its number and values (T, C); NaN is an empty cell.

    If `guard` is true, strings are escaped so that a spreadsheet does not run them as formulas.
    """
    write_rows(path, header, (), guard)
    size = np.abs(values)
    # JSON is made three times as fast as Python's strings, and differs from them only in very small and large numbers.
    differs = np.asarray((((size > 0) & (size < 1e-4)) | (size >= 1e16)).any(axis=1))
    as_json = TypeAdapter(Any).dump_json
    with path.open("a", encoding="utf-8", newline="") as file:
        for frame, row, as_python in zip(frames.tolist(), values, differs.tolist(), strict=True):
            cells = [frame, *row.tolist()]
            if as_python:
                text = repr(cells).replace(", ", ",").replace("nan", "")
            else:
                text = as_json(cells).decode().replace("null", "")
            file.write(text[1:-1] + "\n")


def write_rows(
    path: Path, header: Iterable[Sequence[str]], rows: Iterable[Sequence[object]], guard: bool = True
) -> None:
    """Write header rows, then rows of strings, whole numbers and floats; NaN is an empty cell.

    If `guard` is true, strings are escaped so that a spreadsheet does not run them as formulas. Otherwise they are
    written unchanged.
    """
    text = cache(guarded if guard else encodable)  # a column repeats a few strings in thousands of rows
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerows([text(name) for name in row] for row in header)

        def written(cell: object) -> object:
            return text(cell) if isinstance(cell, str) else _cell(cell)

        for row in rows:  # most cells are floats, which need no call
            writer.writerow([(cell if cell == cell else "") if type(cell) is float else written(cell) for cell in row])


def write_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write a long table from its columns (N,), which are floats, whole numbers or strings without commas.

    NaN is an empty cell. Writing by columns is much faster than row by row.
    """
    import pyarrow as pa  # installed with rerun
    from pyarrow import csv as arrow_csv

    table = pa.table({name: _arrow_array(_guarded_column(values)) for name, values in columns.items()})
    arrow_csv.write_csv(table, path, arrow_csv.WriteOptions(quoting_style="none"))


def _arrow_array(values: np.ndarray) -> pa.Array:
    """Return a column (N,) as a pyarrow array, with NaN as null.

    The array is made from bytes, because `pa.array` imports pandas, which takes longer than writing a short clip's
    tables.
    """
    import pyarrow as pa

    if values.dtype.kind == "U":
        texts = [text.encode() for text in values.tolist()]
        ends = np.cumsum([0, *map(len, texts)], dtype=np.int32)
        return pa.StringArray.from_buffers(len(texts), pa.py_buffer(ends), pa.py_buffer(b"".join(texts)))
    is_known = np.packbits(values == values, bitorder="little")
    buffers = [pa.py_buffer(is_known), pa.py_buffer(values)]
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), buffers)


def _guarded_column(values: np.ndarray) -> np.ndarray:
    """Return a column (N,) with strings escaped so that a spreadsheet does not run them."""
    if values.dtype.kind != "U":
        return np.ascontiguousarray(values)
    texts, numbers = np.unique(values, return_inverse=True)
    return np.array([guarded(str(text)) for text in texts])[numbers]


def _cell(value: object) -> object:
    """Return a value that the writer turns into the shortest string that is read back exactly."""
    plain = value.item() if isinstance(value, np.generic) else value
    return "" if plain != plain else plain


def deeplabcut_layout(data: Keypoints | Pose3D) -> tuple[dict[str, list[str]], np.ndarray, np.ndarray]:
    """Return the header cells of each level, the frame numbers (T,) and the values (T, 3K) of DeepLabCut's table."""
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


def _with_fps(scorer: str | None, fps: float | None) -> str:
    """Return the scorer to write, which is another program's scorer, if any, with the frame rate appended."""
    ours = SCORER if fps is None else f"{SCORER}_{repr(fps).removesuffix('.0')}fps"
    if scorer in (None, SCORER):
        return ours
    return str(scorer) if fps is None else f"{scorer}_{ours}"
