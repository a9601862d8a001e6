"""Report all problems with an input at once, in the user's words."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar, overload

from recon.base.file_names import encodable

NO_FILE, ANY_FILE = "no such file", "a file that can be read"
"""Texts for messages about a missing file: the value found, and the value expected."""


@dataclass(frozen=True)
class Problem:
    """Problem with an input.

    The message of a problem is one line, in which escape sequences replace characters that cannot be printed.
    """

    file: str | Path
    """File or command-line option with the problem."""
    field: str
    """Column, key, row or other part of the file with the problem."""
    found: str
    """Description of the value found, with its unit."""
    expected: str
    """Description of the value expected, with its unit."""
    details: tuple[str, ...] = ()
    """Further lines of the message, such as a file to write."""

    @property
    def lines(self) -> tuple[str, ...]:
        """Return the problem as the lines of a message."""
        return str(self), *map(printable, self.details)

    def __str__(self) -> str:
        option = "--" + self.field.replace("_", "-")
        says_it = str(self.file) in (option, option.removesuffix("-px"), f"--set {option[2:]}")
        if (self.field, self.found) == ("file", NO_FILE):
            expected = "" if self.expected == ANY_FILE else f", expected {self.expected}"
            return printable(f"{self.file}: {NO_FILE}{expected}")
        location = self.file if says_it else f"{self.file}: {self.field}"
        return printable(f"{location}: found {self.found}, expected {self.expected}")


def printable(text: str) -> str:
    """Return a string in which escape sequences replace the characters that cannot be printed.

    Bytes of file names that are not UTF-8 are escaped too, as in `encodable`.
    """
    if text.isprintable():
        return text
    text = encodable(text)
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class InputError(ValueError):
    """Error about an input that cannot be used, with all problems of the input."""

    def __init__(self, problems: Problem | Iterable[Problem]) -> None:
        self.problems: tuple[Problem, ...] = (problems,) if isinstance(problems, Problem) else tuple(problems)
        super().__init__("\n".join(line for p in self.merged for line in p.lines))

    @property
    def merged(self) -> tuple[Problem, ...]:
        """Return the problems, with problems that differ only in the file merged into one.

        The keypoint files of a clip's cameras often have the same problem, which the message would repeat.
        """
        files: dict[Problem, dict[str | Path, None]] = {}
        for problem in self.problems:
            files.setdefault(replace(problem, file=""), {})[problem.file] = None
        return tuple(
            replace(problem, file=", ".join(map(str, same)) if len(same) > 1 else next(iter(same)))
            for problem, same in files.items()
        )

    def __reduce__(self) -> tuple[type[InputError], tuple[tuple[Problem, ...]]]:
        """Return the class and its arguments, so that the error passes from a worker process to its parent."""
        return type(self), (self.problems,)


def raise_problems(problems: Iterable[Problem]) -> None:
    """Raise InputError with the problems, if there are any."""
    problems = tuple(problems)
    if problems:
        raise InputError(problems)


def problems_of(read: Callable[[], Any]) -> tuple[Problem, ...]:
    """Return the problems of the InputError that `read` raises; empty if it raises none."""
    try:
        read()
    except InputError as error:
        return error.problems
    return ()


_A = TypeVar("_A")
_B = TypeVar("_B")
_C = TypeVar("_C")
_D = TypeVar("_D")


@overload
def collect_problems(first: Callable[[], _A], second: Callable[[], _B], /) -> tuple[_A, _B]: ...


@overload
def collect_problems(
    first: Callable[[], _A], second: Callable[[], _B], third: Callable[[], _C], /
) -> tuple[_A, _B, _C]: ...


@overload
def collect_problems(
    first: Callable[[], _A],
    second: Callable[[], _B],
    third: Callable[[], _C],
    fourth: Callable[[], _D],
    /,
    *checks: Callable[[], object],
) -> tuple[_A, _B, _C, _D, *tuple[object, ...]]: ...


@overload
def collect_problems(first: Callable[[], _A], /, *reads: Callable[[], _B]) -> tuple[_A, *tuple[_B, ...]]: ...


def collect_problems(*reads: Callable[[], object]) -> tuple[object, ...]:
    """Call several functions and return their results, or raise one InputError with the problems of all of them.

    A problem that several functions report is included once.
    """
    results, problems = [], []
    for read in reads:
        try:
            results.append(read())
        except InputError as error:
            problems.extend(error.problems)
    raise_problems(dict.fromkeys(problems))
    return tuple(results)
