"""What readers of several formats share: points as a file has them, and 3D positions as the rest of the package takes
them; optional libraries, the choice of an animal, names, frames, and tables of text."""

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

from recon.base import Brief, InputError, Problem, raise_problems
from recon.base.documents import damage_named


@dataclass(frozen=True, eq=False, repr=False)
class Pose3D(Brief):
    """3D positions of J joints in T frames. Raises ValueError where its parts do not fit together."""

    names: tuple[str, ...]
    """The names of the J joints."""
    xyz_m: np.ndarray
    """(T, J, 3) float, metres, NaN = missing."""
    frames: np.ndarray
    """The numbers of the T frames, whole and strictly increasing."""
    source: str | None = None
    fps: float | None = None
    """Frames per second, where they are known."""
    edges: tuple[tuple[str, str], ...] = ()
    """Pairs of joints that are linked, where they are known."""
    notes: tuple[str, ...] = ()
    """What a reader had to decide, or the verdict on a fit, in plain sentences."""
    sigma_m: np.ndarray | None = None
    """(T, J, 3): standard deviations of a fit."""
    flags: tuple[str, ...] | None = None
    """(T,): what is doubtful about a fit's frames."""

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
            raise ValueError("an edge links a joint that is not there")

    def of_joints(self, names: Sequence[str]) -> np.ndarray:
        """(T, N, 3): of N joints, NaN where they are not among these."""
        padded = np.pad(self.xyz_m, ((0, 0), (0, 1), (0, 0)), constant_values=np.nan)
        return padded[:, [self.names.index(name) if name in self.names else -1 for name in names]]


@dataclass(frozen=True, eq=False)
class StoredPoints:
    """What a file says of one animal: K points in T frames, in the picture or in space, in its own unit and axes."""

    names: tuple[str, ...]
    values: np.ndarray
    """(T, K, 2) px, or (T, K, 3), NaN = missing."""
    frames: np.ndarray
    """The numbers of the T frames, whole and strictly increasing."""
    likelihood: np.ndarray | None = None
    """(T, K), NaN = unknown; None where the file has none."""
    fps: float | None = None
    individual: str | None = None
    scorer: str | None = None
    """For points in the picture: the network or the labeller that found them, where the file names it."""
    image_size_px: tuple[int, int] | None = None
    unit: str | None = None
    """For points in space: m, cm or mm; None where the file does not say."""
    up: str | None = None
    """For points in space: the axis that points up, y or z; None where the file does not say."""
    edges: tuple[tuple[str, str], ...] = ()
    """Pairs of points that are linked, where they are known."""
    images: tuple[str, ...] = ()
    """For labels: the names of the T pictures."""
    notes: tuple[str, ...] = ()
    """What a reader had to decide, in plain sentences."""

    @property
    def in_space(self) -> bool:
        return self.values.shape[-1] == 3


# -- reading -----------------------------------------------------------------------------------------------------------

# What tools call the only animal of a file when nobody named it.
UNNAMED = ("individual_0", "id_0", "track_0")
SCORER = "recon"
"""The scorer of our own files; where the frame rate is known, it stands in it: recon_90fps."""
FMPOSE3D = "fmpose3d_"
"""In the name of the network that files and scorers of FMPose3D's poses have."""
MISSING = ("", "nan", "na", "none", "null")
# Enough to see what is wrong with a file; a file of the wrong kind has thousands.
PROBLEMS_SHOWN = 10
MAX_FRAME = 10**9
"""Frame numbers on either side of 0 up to it, three months at 120 Hz; larger ones are time stamps or accidents."""
POINTS_MAX = 20_000_000
"""The most points in all frames of a file together, where each takes memory whether the file has it or not."""


def starts_with(path: Path, signature: bytes) -> bool:
    with path.open("rb") as file:
        return file.read(len(signature)) == signature


def starts_with_text(path: Path, word: bytes) -> bool:
    """Whether it is the first of the text, after blanks and a byte order mark."""
    with path.open("rb") as file:
        return file.read(256).removeprefix(b"\xef\xbb\xbf").lstrip().startswith(word)


class NoChoiceError(InputError):
    """A file has several animals with points, and none of them is chosen."""

    def __init__(self, path: Path, animals: Sequence[str]) -> None:
        found = f"{len(animals)} animals and no --individual"
        super().__init__(Problem(path, "individual", found, "one of: " + ", ".join(animals)))
        self.animals = tuple(animals)


def choose(path: Path, animals: Sequence[str], individual: str | None, seen: Iterable[bool] | None = None) -> int:
    """Which of a file's animals is meant; the only one may be unnamed, "". seen: whether each has a point anywhere;
    those without are no choice, but may be named. Raises InputError."""
    if len(animals) == 1 or seen is None:  # a look at all points takes time and memory
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
    """The points of one animal, once all that a reader found in a file fits together. stored: of N animals, with values
    (T, N, K, 2 or 3) and likelihoods (T, N, K), or without N of a file of one animal, and names where the file has
    them; animals: their names, where it has them; occupied (T, N): in which frames each animal is. Raises InputError
    with all that does not fit, and as `choose`."""
    names, values, frames, likelihood = stored.names, stored.values, stored.frames, stored.likelihood
    if values.ndim == 3:
        values, likelihood = values[:, None], None if likelihood is None else likelihood[:, None]
    if values.ndim != 4 or values.shape[3] not in (2, 3) or not values.size:
        found = f"an array of the shape {values.shape}" if len(values) else "no frames"
        raise InputError(Problem(path, "points", found, "frames x animals x points x 2 or 3, each at least one"))
    T, N, K, _ = values.shape
    problems = []
    for field, found, count in (("names of points", names, K), ("names of animals", animals, N)):
        faulty = [name for name, times in Counter(found).items() if not name or not name.isprintable() or times > 1]
        problems += [Problem(path, field, f"'{name}'", "names that are unique and can be printed") for name in faulty]
        if len(found) not in (0, count):
            problems.append(Problem(path, field, str(len(found)), f"{count}, as there are in the data"))
    for field, given, shape in (("likelihoods", likelihood, (T, N, K)), ("occupied frames", occupied, (T, N))):
        if given is not None and given.shape != shape:
            problems.append(Problem(path, field, f"an array of the shape {given.shape}", f"{shape}, as the points"))
    if len(frames) != T:
        problems.append(Problem(path, "frames", f"{len(frames)} numbers", f"{T}, one for each frame"))
    else:
        with np.errstate(invalid="ignore"):  # of what is infinite
            wrong = ~(np.abs(frames) <= MAX_FRAME) | (frames % 1 != 0) | (np.diff(frames, prepend=-np.inf) <= 0)
        if wrong.any():
            first = int(np.argmax(wrong))
            said = " after ".join(f"{frame:.15g}" for frame in frames[max(first - 1, 0) : first + 1][::-1])
            problems.append(
                Problem(path, "frames", said, f"increasing whole numbers up to {MAX_FRAME}, no time stamps")
            )
    raise_problems(problems)
    called = list(animals) or ([""] if N == 1 else [f"track_{n}" for n in range(N)])
    there = np.ones((T, N), dtype=bool) if occupied is None else occupied > 0
    which = choose(path, called, individual, (bool(np.isfinite(values[there[:, n], n]).any()) for n in range(N)))
    rows = slice(None) if there[:, which].all() else there[:, which]
    if not there[:, which].any():
        raise InputError(Problem(path, "frames", "none with the animal", "at least one"))
    named = bool(len(animals)) and (N > 1 or called[0] not in UNNAMED)
    unnamed = f"The file names no points: in its order they are called point1 to point{K}."
    return replace(
        stored,
        names=names or tuple(f"point{k}" for k in range(1, K + 1)),
        values=values[rows, which].astype(float, copy=False),
        frames=frames[rows].astype(np.int64),
        likelihood=None if likelihood is None else likelihood[rows, which].astype(float, copy=False),
        individual=called[which] if named else None,
        notes=stored.notes if names else (*stored.notes, unnamed),
    )


def first_problems(problems: Sequence[Problem], path: Path) -> list[Problem]:
    """The first problems, and how many more there are."""
    more = len(problems) - PROBLEMS_SHOWN
    if more <= 0:
        return list(problems)
    return [*problems[:PROBLEMS_SHOWN], Problem(path, "more", f"{more} problems like these", "none")]


def number(text: str) -> float:
    """A cell as a number, NaN for an empty one. Raises ValueError for what only Python takes for one, as 1_000."""
    if "_" in text or not text.isascii():
        raise ValueError(f"'{text}' is no number")
    return float(text or "nan")


def numbers(cells: Iterable[object]) -> tuple[np.ndarray, list[int]]:
    """Cells (N,) as floats, NaN for `MISSING`; and the places of those that are no numbers, or infinite."""
    cells = list(cells)
    with suppress(ValueError, TypeError):  # the usual case, and several times as fast
        joined = "".join(cells)  # type: ignore[arg-type]
        if not joined:  # nothing was seen, as in most of a long recording
            return np.full(len(cells), np.nan), []
        if "_" not in joined and joined.isascii():
            found = np.array([float(cell) if cell else np.nan for cell in cells])  # type: ignore[arg-type]
            return found, np.flatnonzero(np.isinf(found)).tolist()
    if all(isinstance(cell, float) for cell in cells):  # of Parquet files and tables in memory
        found = np.array(cells, dtype=float)
    else:
        found = np.full(len(cells), np.inf)
        for i, cell in enumerate(cells):
            text = cell.strip() if isinstance(cell, str) else "" if cell is None else str(cell)
            with suppress(ValueError):
                found[i] = number("" if text.lower() in MISSING else text)
    wrong = np.isinf(found)
    return np.where(wrong, np.nan, found), np.flatnonzero(wrong).tolist()


def frame_number(text: str, least: int = 0) -> int | None:
    """Digits, after a minus sign or none, as a number from `least` to `MAX_FRAME`; None for anything else."""
    number = int(text) if re.fullmatch(r"-?[0-9]{1,15}", text) else None
    return number if number is not None and least <= number <= MAX_FRAME else None


def rate(value: object) -> float | None:
    """A frame rate as a file has it; None for anything that is none."""
    with suppress(TypeError, ValueError):
        if 0 < (fps := float(value)) < float("inf"):  # type: ignore[arg-type]
            return fps
    return None


def require_span(frames: int, points: int, source: str | Path) -> None:
    """Raises InputError where frames times points would fill the memory; source: a format, or a file that is read."""
    if frames * points > POINTS_MAX:
        found = f"numbers that span {frames} frames"
        expected = f"at most {POINTS_MAX // points} of {points} points: each takes memory in every frame"
        raise InputError(Problem(source, "frames", found, expected))


# -- tables of text --------------------------------------------------------------------------------------------------

SEPARATORS = (",", ";", "\t")
Rows = Iterable[tuple[int, list[str]]]
"""Rows of a table, with the numbers of their lines."""


def text_rows(path: Path, separator: str | None = None) -> Iterator[tuple[int, list[str]]]:
    """The rows of a text table that are not blank, with their lines' numbers. separator: by default whichever of
    `SEPARATORS` the first line has most. Raises InputError for bytes that are not UTF-8, and for no table."""
    expected = "a table of text in UTF-8"
    with damage_named(path, expected, "text"), path.open(encoding="utf-8-sig", newline="") as file:
        first = file.readline()
        file.seek(0)
        rows, line = csv.reader(file, delimiter=separator or max(SEPARATORS, key=first.count)), 0
        try:
            for row in rows:
                line = rows.line_num
                if any(cell.strip() for cell in row):
                    yield line, row
        except csv.Error as error:
            raise InputError(Problem(path, f"line {line + 1}", str(error), expected)) from None


def number_rows(
    path: Path, rows: Rows, columns: Sequence[str], index: int = 0
) -> tuple[list[list[str]], np.ndarray, list[Problem]]:
    """Rows with the numbers of their lines: of each the first `index` cells, which are texts, and the others as numbers
    (T, C), one for each of `columns`, NaN for an empty cell; and what is wrong with them."""
    texts: list[list[str]] = []
    values = array("d")  # one buffer that grows: a long recording has millions of numbers
    problems: list[Problem] = []
    width = index + len(columns)
    for line, row in rows:
        if len(row) != width:
            problems.append(Problem(path, f"line {line}", f"{len(row)} cells", f"{width}, as in the header"))
            continue
        found, wrong = numbers(row[index:])
        for j in wrong:
            found_text, expected = f"'{row[index + j].strip()}'", "a number or an empty cell"
            problems.append(Problem(path, f"line {line}, {columns[j]}", found_text, expected))
        texts.append(row[:index])
        values.frombytes(found.tobytes())
    return texts, np.frombuffer(values).reshape(len(texts), len(columns)), problems
