"""Data types and functions shared by the readers of several formats.

The module defines points as stored in a file and 3D positions as the rest of the package uses them. Its functions
choose an animal, check names and frame numbers, and read text tables.
"""

from __future__ import annotations

import csv
import re
from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from recon.base.arrays import Brief
from recon.base.documents import damage_as_input_error
from recon.base.errors import InputError, Problem, raise_problems
from recon.base.numbers import counted


@dataclass(frozen=True, eq=False, repr=False)
class Pose3D(Brief):
    """3D positions of J joints in T frames.

    The constructor raises ValueError if the fields do not fit together.
    """

    names: tuple[str, ...]
    """Names of the J joints."""
    xyz_m: np.ndarray
    """Positions of the joints in metres with z up, shape (T, J, 3); NaN if missing."""
    frames: np.ndarray
    """Whole, strictly increasing frame numbers, shape (T,)."""
    source: str | None = None
    fps: float | None = None
    """Frames per second, if known."""
    edges: tuple[tuple[str, str], ...] = ()
    """Pairs of linked joints, if known."""
    notes: tuple[str, ...] = ()
    """Choices that the reader of a file made, or the verdict on a fit, in plain sentences."""
    sigma_m: np.ndarray | None = None
    """Standard deviations of the positions of a fit in metres, shape (T, J, 3); None for other positions."""
    flags: tuple[str, ...] | None = None
    """Reasons not to trust each of the T frames of a fit, as strings."""

    def __post_init__(self) -> None:
        if self.xyz_m.shape != (len(self.frames), len(self.names), 3):
            raise ValueError(f"{len(self.frames)} frames of {len(self.names)} joints, but positions {self.xyz_m.shape}")
        if len(set(self.names)) != len(self.names) or np.any(np.diff(self.frames) <= 0):
            raise ValueError("names must be unique and frames strictly increasing")
        if np.isinf(self.xyz_m).any():
            raise ValueError("a position is infinite")
        if self.fps is not None and not 0 < self.fps < float("inf"):
            raise ValueError(f"fps must be positive: {self.fps}")
        if not {name for edge in self.edges for name in edge} <= set(self.names):
            raise ValueError("an edge links a joint that does not exist")

    def of_joints(self, names: Sequence[str]) -> np.ndarray:
        """Return the positions (T, N, 3) of N joints, NaN for absent joints."""
        padded = np.pad(self.xyz_m, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan)
        return padded[:, [self.names.index(name) if name in self.names else -1 for name in names]]


@dataclass(frozen=True, eq=False)
class StoredPoints:
    """K points of one animal in T frames as stored in a file, in the file's unit and axes."""

    names: tuple[str, ...]
    values: np.ndarray
    """Positions in pixels, shape (T, K, 2), or in the file's unit and axes, shape (T, K, 3); NaN if missing."""
    frames: np.ndarray
    """Whole, strictly increasing frame numbers, shape (T,)."""
    likelihood: np.ndarray | None = None
    """Likelihoods of the points, shape (T, K), NaN if unknown; None if the file has no likelihoods."""
    fps: float | None = None
    individual: str | None = None
    scorer: str | None = None
    """Name of the network or person that labelled 2D points, if the file states it."""
    image_size_px: tuple[int, int] | None = None
    unit: str | None = None
    """Unit of 3D points, m, cm or mm; None if the file does not state it."""
    up: str | None = None
    """Upward axis of 3D points, y or z; None if the file does not state it."""
    edges: tuple[tuple[str, str], ...] = ()
    """Pairs of linked points, if known."""
    images: tuple[str, ...] = ()
    """Names of the T pictures that were labelled."""
    notes: tuple[str, ...] = ()
    """Choices that the reader of the file made, in plain sentences."""
    times_s: np.ndarray | None = None
    """Times of the frames in seconds, shape (T,), if the file has uneven times instead of frame numbers."""
    time_problems: tuple[Problem, ...] = ()
    """Problems that `recon.io.times` found in times that fit no frame rate, raised unless the user gives a rate."""

    @property
    def in_space(self) -> bool:
        """Return whether the points are 3D."""
        return self.values.shape[-1] == 3


# Names that programs give to the only animal of a file.
UNNAMED = ("individual_0", "id_0", "track_0")
SCORER = "recon"
"""Scorer of recon's own files, to which the frame rate is appended if known, as in recon_90fps."""
FMPOSE3D = "fmpose3d_"
"""String in the name of a scorer or network that identifies FMPose3D's poses."""
MISSING = ("", "nan", "na", "none", "null")
# A file of the wrong kind can have thousands of problems, so a message lists only the first ones.
PROBLEMS_SHOWN = 10
MAX_FRAME = 10**9
"""Largest absolute frame number (three months at 120 Hz), because larger numbers are time stamps or errors."""
POINTS_MAX = 20_000_000
"""Largest number of points in all frames of a file, since each point takes memory even if missing."""


def starts_with(path: Path, signature: bytes) -> bool:
    """Return whether a file begins with `signature`."""
    with path.open("rb") as file:
        return file.read(len(signature)) == signature


def starts_with_text(path: Path, word: bytes) -> bool:
    """Return whether a file's text, after blanks and a byte order mark, begins with `word`."""
    with path.open("rb") as file:
        return file.read(256).removeprefix(b"\xef\xbb\xbf").lstrip().startswith(word)


UNTRACKED = "untracked"
"""Name of points without a name in a file of several animals, such as frames corrected by hand."""


class NoChoiceError(InputError):
    """Error for a file with points of several animals, none of which was chosen."""

    def __init__(self, path: Path, animals: Sequence[str], hint: str = "") -> None:
        detail = f"{len(animals)} animals and no --individual"
        super().__init__(Problem(path, "individual", detail, f"one of: {', '.join(animals)}{hint}"))
        self.animals = tuple(animals)


def choose(path: Path, animals: Sequence[str], individual: str | None, seen: Iterable[bool] | None = None) -> int:
    """Return the index of the chosen animal of a file.

    `animals` has the names of the file's animals. A file's only animal may have an empty name. `seen` states whether
    each animal has a point. Animals without points can be chosen only by name. Among several animals, an unnamed one is
    `UNTRACKED`.

    Raises
    ------
    InputError
        If no animal can be chosen.
    """
    if len(animals) > 1:
        animals = [name or UNTRACKED for name in animals]
    if len(animals) == 1 or seen is None:  # checking all points takes time and memory
        seen = [True] * len(animals)
    empty = [name for name, points in zip(animals, seen, strict=True) if not points]
    choice = [name for name in animals if name not in empty] or list(animals)
    if individual is None and len(choice) == 1:
        return animals.index(choice[0])
    if list(animals) == [""]:
        raise InputError(Problem(path, "individual", "a file without named animals", f"an animal '{individual}'"))
    if individual is None:
        raise NoChoiceError(path, choice)
    if individual not in animals:
        raise InputError(Problem(path, "individual", f"'{individual}'", "one of: " + ", ".join(choice)))
    return animals.index(individual)


def one_animal(
    path: Path,
    individual: str | None,
    stored: StoredPoints,
    animals: Sequence[str] = (),
    occupied: np.ndarray | None = None,
) -> StoredPoints:
    """Return the points of one animal, after checking that all parts of a file agree.

    Parameters
    ----------
    path : path
        The file, for messages.
    individual : str or None
        Name of the animal, needed if there are several.
    stored : StoredPoints
        Values (T, N, K, 2 or 3) and likelihoods (T, N, K) of N animals, or without N for a file of one animal.
    animals : sequence of str
        Names of the animals, if the file has them.
    occupied : (T, N), optional
        Whether each animal is in each frame.

    Raises
    ------
    InputError
        If parts of the file disagree, or if no animal can be chosen.
    """
    names, values, frames, likelihood = stored.names, stored.values, stored.frames, stored.likelihood
    if values.ndim == 3:
        values, likelihood = values[:, None], None if likelihood is None else likelihood[:, None]
    if not len(values):
        raise InputError(Problem(path, "points", "no frames", "at least one frame: a row below the header of a table"))
    if values.ndim != 4 or values.shape[3] not in (2, 3) or not values.size:
        entries = f"an array of shape {values.shape}"
        raise InputError(Problem(path, "points", entries, "frames x animals x points x 2 or 3, each at least one"))
    T, N, K, _ = values.shape
    blocks = (("likelihoods", likelihood, (T, N, K)), ("occupied frames", occupied, (T, N)))
    problems = [
        *_name_problems(path, "names of points", names, K),
        *_name_problems(path, "names of animals", animals, N),
    ]
    problems += [
        Problem(path, field, f"an array of shape {block.shape}", f"{shape}, the shape of the points")
        for field, block, shape in blocks
        if block is not None and block.shape != shape
    ]
    problems += _frame_problems(path, frames, T)
    raise_problems(problems)
    animal_names = list(animals) or ([""] if N == 1 else [f"track_{n}" for n in range(N)])
    present = np.ones((T, N), dtype=bool) if occupied is None else occupied > 0
    chosen = choose(
        path, animal_names, individual, (bool(np.isfinite(values[present[:, n], n]).any()) for n in range(N))
    )
    rows = slice(None) if present[:, chosen].all() else present[:, chosen]
    if not present[:, chosen].any():
        raise InputError(Problem(path, "frames", "no frame with the animal", "at least one frame with the animal"))
    named = bool(len(animals)) and (N > 1 or animal_names[0] not in UNNAMED)
    unnamed = f"The file does not name its points: in the file's order they are called point1 to point{K}."
    return replace(
        stored,
        names=names or tuple(f"point{k}" for k in range(1, K + 1)),
        values=values[rows, chosen].astype(float, copy=False),
        frames=frames[rows].astype(np.int64),
        times_s=None if stored.times_s is None else stored.times_s[rows],
        likelihood=None if likelihood is None else likelihood[rows, chosen].astype(float, copy=False),
        individual=animal_names[chosen] if named else None,
        notes=stored.notes if names else (*stored.notes, unnamed),
    )


def _name_problems(path: Path, field: str, names: Sequence[str], count: int) -> Iterator[Problem]:
    """Yield problems with names that are empty, repeated or not printable, and with a wrong number of names."""
    for name, times in Counter(names).items():
        if not name or not name.isprintable() or times > 1:
            yield Problem(path, field, f"'{name}'", "unique, printable names")
    if len(names) not in (0, count):
        yield Problem(path, field, counted(len(names), "name"), f"{counted(count, 'name')}, as in the data")


def _frame_problems(path: Path, frames: np.ndarray, count: int) -> Iterator[Problem]:
    """Yield a problem if frame numbers are not increasing whole numbers, or not one for each of `count` frames."""
    if len(frames) != count:
        yield Problem(
            path, "frames", counted(len(frames), "frame number"), f"{count} frame numbers, one for each frame"
        )
        return
    with np.errstate(invalid="ignore"):  # numbers may be infinite
        is_wrong = ~(np.abs(frames) <= MAX_FRAME) | (frames % 1 != 0) | (np.diff(frames, prepend=-np.inf) <= 0)
    if is_wrong.any():
        first = int(np.argmax(is_wrong))
        detail = " after ".join(f"{frame:.15g}" for frame in frames[max(first - 1, 0) : first + 1][::-1])
        yield Problem(path, "frames", detail, f"increasing whole numbers up to {MAX_FRAME}, not time stamps")


def frames_seen(stored: StoredPoints) -> np.ndarray:
    """Return the numbers of the frames in which at least one point is known."""
    known = np.asarray(np.isfinite(stored.values).all(axis=2))
    return stored.frames[np.asarray(known.any(axis=-1))]


def without_lost_markers(stored: StoredPoints) -> StoredPoints:
    """Return 3D points without placeholders of lost markers, whose three coordinates are equal.

    Many programs write 0 or another number three times for a lost marker. A number other than 0 has to occur at least
    twice. A point that is at (0, 0, 0) in all frames is an origin and is kept.
    """
    first = stored.values[..., 0]
    is_constant = (stored.values == first[..., None]).all(axis=2)
    coordinates, counts = np.unique(first[is_constant], return_counts=True)
    lost = is_constant & np.isin(first, coordinates[(coordinates == 0) | (counts > 1)])
    lost &= ~((first == 0) & is_constant).all(axis=0)
    if not lost.any():
        return stored
    counts_lost = zip(stored.names, lost.sum(axis=0).tolist(), strict=True)
    named = [f"{name} in {counted(count, 'frame')}" for name, count in counts_lost if count]
    shown = ", ".join(named[:3]) + (f" and {len(named) - 3} more" if len(named) > 3 else "")
    shown_constants = " and ".join("({0:.10g}, {0:.10g}, {0:.10g})".format(x + 0.0) for x in np.unique(first[lost])[:3])
    note = f"Points at exactly {shown_constants} are taken as missing: {shown}."
    values = np.where(lost[..., None], np.nan, stored.values)
    return replace(stored, values=values, notes=(*stored.notes, note))


def joined_tracks(path: Path, tracks: Sequence[StoredPoints], individual: str) -> StoredPoints:
    """Join the tracks of one animal in a file.

    Raises
    ------
    InputError
        If two tracks have points in the same frame.
    """
    first = tracks[0]
    seen = [frames_seen(track) for track in tracks]
    shared = [frame for i, a in enumerate(seen) for b in seen[:i] for frame in np.intersect1d(a, b).tolist()]
    if shared:
        detail = f"points of two animals in frame {min(shared)}" + f" and {counted(len(shared) - 1, 'more frame')}" * (
            len(shared) > 1
        )
        expected = "tracks of one animal, which never overlap in time"
        raise InputError(Problem(path, f"individual {individual}", detail, expected))
    frames = np.unique(np.concatenate([track.frames for track in tracks]))
    values = np.full((len(frames), *first.values.shape[1:]), np.nan)
    likelihood = None if first.likelihood is None else np.zeros(values.shape[:2])
    for track in tracks:
        known = np.isin(track.frames, frames_seen(track))
        rows = np.searchsorted(frames, track.frames[known])
        values[rows] = track.values[known]
        if likelihood is not None and track.likelihood is not None:
            likelihood[rows] = track.likelihood[known]
    notes = dict.fromkeys(note for track in tracks for note in track.notes)
    joined = f"Tracks joined as one animal: {individual}."
    return replace(
        first,
        values=values,
        frames=frames,
        likelihood=likelihood,
        individual=individual,
        images=(),
        notes=(*notes, joined),
        times_s=_joined_times(tracks, frames),
        time_problems=tuple(dict.fromkeys(problem for track in tracks for problem in track.time_problems)),
    )


def _joined_times(tracks: Sequence[StoredPoints], frames: np.ndarray) -> np.ndarray | None:
    """Return the times of the joined frames, if all tracks have times."""
    times_s = np.full(len(frames), np.nan)
    for track in tracks:
        if track.times_s is None:
            return None
        times_s[np.searchsorted(frames, track.frames)] = track.times_s
    return times_s


def first_problems(problems: Sequence[Problem], path: Path) -> list[Problem]:
    """Return the first `PROBLEMS_SHOWN` problems, and one that counts the remaining problems if there are more."""
    excess = len(problems) - PROBLEMS_SHOWN
    if excess <= 0:
        return list(problems)
    return [
        *problems[:PROBLEMS_SHOWN],
        Problem(path, "content", f"{counted(excess, 'more problem')} of these kinds", "a file without them"),
    ]


_JSON_NUMBERS = TypeAdapter(list[float])


def number(text: str) -> float:
    """Return the string in a table's cell as a number, NaN for an empty cell.

    Raises
    ------
    ValueError
        If the string is not a number, or has a form of number that only Python accepts, such as 1_000.
    """
    if "_" in text or not text.isascii():
        raise ValueError(f"'{text}' is not a number")
    return float(text or "nan")


def numbers(cells: Iterable[object]) -> tuple[np.ndarray, list[int]]:
    """Return cells (N,) as floats, NaN for `MISSING`, and the indices of cells that are infinite or not numbers."""
    cells = list(cells)
    with suppress(ValueError, TypeError):  # numbers in JSON are read three times as fast as by float
        if not "".join(cells):  # type: ignore[arg-type]  # nothing was detected, as in most frames of a long recording
            return np.full(len(cells), np.nan), []
        text = ",".join([cell or "NaN" for cell in cells])  # type: ignore[misc]
        values = np.array(_JSON_NUMBERS.validate_json(f"[{text}]".replace("nan", "NaN"), strict=True))
        if len(values) == len(cells):  # no cell has a comma
            return values, np.flatnonzero(np.isinf(values)).tolist()
    if all(isinstance(cell, float) for cell in cells):  # cells of Parquet files and of tables in memory
        values = np.array(cells, dtype=float)
    else:
        values = np.full(len(cells), np.inf)
        for i, cell in enumerate(cells):
            text = cell.strip() if isinstance(cell, str) else "" if cell is None else str(cell)
            with suppress(ValueError):
                values[i] = number("" if text.lower() in MISSING else text)
    wrong = np.isinf(values)
    return np.where(wrong, np.nan, values), np.flatnonzero(wrong).tolist()


def frame_number(text: str, least: int = 0) -> int | None:
    """Return a string of digits as a frame number.

    Return None for any other string, and for numbers that are below `least` or above `MAX_FRAME`.
    """
    frame = int(text) if re.fullmatch(r"-?[0-9]{1,15}", text) else None
    return frame if frame is not None and least <= frame <= MAX_FRAME else None


def rate(value: object) -> float | None:
    """Return a value from a file as a frame rate, or None if it is not a positive finite number."""
    with suppress(TypeError, ValueError):
        if 0 < (fps := float(value)) < float("inf"):  # type: ignore[arg-type]
            return fps
    return None


def require_span(frames: int, points: int, source: str | Path) -> None:
    """Raise InputError if frames times points would fill the memory.

    `source` is the name of a format or file.
    """
    if frames * points > POINTS_MAX:
        detail = f"numbers that span {frames} frames"
        expected = f"at most {POINTS_MAX // points} frames of {counted(points, 'point')}, since each point takes memory"
        raise InputError(Problem(source, "frames", detail, expected))


SEPARATORS = (",", ";", "\t", "|")
Rows = Iterable[tuple[int, list[str]]]
"""Line number and cells of each row of a table."""


_SEPARATOR_LINE = re.compile(r'\s*"?sep=(.)"?[\s,;]*', re.IGNORECASE)
"""Pattern of a table's first line that states the separator for Excel."""
_BELOW_ONE = re.compile(r"\s*-?0,[0-9]+\s*")
_DECIMAL_COMMA = re.compile(r"\s*[-+]?[0-9]*,[0-9]+(?:[eE][-+]?[0-9]+)?\s*")


def table_start(text: str) -> tuple[str, int]:
    """Return the separator of a table that begins with the given text, and the number of lines before its header."""
    first = text.partition("\n")[0].rstrip("\r")
    stated = _SEPARATOR_LINE.fullmatch(first)
    return (stated[1], 1) if stated else (max(SEPARATORS, key=first.count), 0)


def text_rows(path: Path, separator: str | None = None) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of a text table that are not blank, with their line numbers.

    By default the separator is the one that a first line such as `sep=;` states, otherwise the most frequent of
    `SEPARATORS` in the first line. If the separator is not a comma, or a number such as "0,93" is in quotes, commas in
    numbers are decimal commas, as Excel writes them in many languages.

    Raises
    ------
    InputError
        If the file is not UTF-8, or its text is not a table.
    """
    expected = "a table of text in UTF-8 (in Excel, save as CSV UTF-8)"
    with damage_as_input_error(path, expected, "text"), path.open(encoding="utf-8-sig", newline="") as file:
        header_separator, skipped = table_start(file.readline())
        if not skipped:
            file.seek(0)
        separator = separator or header_separator
        rows, line = csv.reader(file, delimiter=separator), 0
        has_decimal_commas = separator != ","
        try:
            for row in rows:
                line = rows.line_num + skipped
                if any(cell.strip() for cell in row):
                    # a quoted number below 1, such as "0,93", cannot have a thousands separator
                    if not has_decimal_commas and "," in "".join(row):
                        has_decimal_commas = any(map(_BELOW_ONE.fullmatch, row))
                    yield line, _with_decimal_points(row) if has_decimal_commas else row
        except csv.Error as error:
            raise InputError(Problem(path, f"line {line + 1}", str(error), expected)) from None


def _with_decimal_points(row: list[str]) -> list[str]:
    if not any("," in cell for cell in row):
        return row
    return [cell.replace(",", ".") if _DECIMAL_COMMA.fullmatch(cell) else cell for cell in row]


def width_of(header: Iterable[Sequence[str]]) -> int:
    """Return the number of columns of a table up to the last named column."""
    return max((j + 1 for row in header for j, cell in enumerate(row) if cell.strip()), default=0)


def cut_blank(rows: Rows, width: int) -> Iterator[tuple[int, list[str]]]:
    """Yield the rows of a table without the blank cells that spreadsheets leave after the last named column."""
    for line, row in rows:
        yield line, row if any(cell.strip() for cell in row[width:]) else row[:width]


def number_rows(
    path: Path, rows: Rows, columns: Sequence[str], index: int = 0
) -> tuple[list[list[str]], np.ndarray, list[Problem]]:
    """Return the cells of a table as strings and as numbers, and the problems of the table.

    Parameters
    ----------
    path : path
        The file, for messages.
    rows : iterable of (line number, cells)
        The rows below the header.
    columns : sequence of str
        Names of the columns of numbers.
    index : int
        Number of leading cells that are kept as strings.

    Returns
    -------
    texts : list of list of str
        The leading cells of each row.
    values : array, shape (T, C)
        The numbers; NaN for an empty cell.
    problems : list of Problem
        Rows of a wrong length, which are left out, and cells that are not numbers.
    """
    texts: list[list[str]] = []
    values = array("d")  # one growing buffer, because a long recording has millions of numbers
    problems: list[Problem] = []
    width = index + len(columns)
    for line, row in rows:
        if len(row) != width:
            problems.append(Problem(path, f"line {line}", f"{len(row)} cells", f"{width} cells, as in the header"))
            continue
        row_values, wrong = numbers(row[index:])
        for j in wrong:
            found_text, expected = f"'{row[index + j].strip()}'", "a number or an empty cell"
            problems.append(Problem(path, f"line {line}, {columns[j]}", found_text, expected))
        texts.append(row[:index])
        values.frombytes(row_values.tobytes())
    return texts, np.frombuffer(values).reshape(len(texts), len(columns)), problems
