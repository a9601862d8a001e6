"""What is said to people: the one error that their input can cause, and numbers as sentences have them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from recon.base.file_names import encodable


@dataclass(frozen=True)
class Problem:
    """One thing that is wrong with an input. As text it is one line, with codes for what cannot be printed."""

    file: str | Path
    """The file (or command-line option) it was found in."""
    field: str
    """The place inside it (column, key, row)."""
    found: str
    """In the user's words, with units where they matter."""
    expected: str
    """In the user's words, with units where they matter."""
    details: tuple[str, ...] = ()
    """Lines to follow it, such as a file to write."""

    @property
    def lines(self) -> tuple[str, ...]:
        """Return the problem as lines of a message."""
        return str(self), *map(printable, self.details)

    def __str__(self) -> str:
        option = "--" + self.field.replace("_", "-")
        says_it = str(self.file) in (option, option.removesuffix("-px"), f"--set {option[2:]}")
        place = self.file if says_it else f"{self.file}: {self.field}"
        return printable(f"{place}: found {self.found}, expected {self.expected}")


def printable(text: str) -> str:
    """Return a text with codes in place of what cannot be printed; bytes of file names as `encodable` writes them."""
    if text.isprintable():
        return text
    text = encodable(text)
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class InputError(ValueError):
    """An input cannot be used. Carries every problem that was found, not just the first."""

    def __init__(self, problems: Problem | Iterable[Problem]) -> None:
        self.problems: tuple[Problem, ...] = (problems,) if isinstance(problems, Problem) else tuple(problems)
        super().__init__("\n".join(line for p in self.problems for line in p.lines))


def raise_problems(problems: Iterable[Problem]) -> None:
    """Raise InputError with the problems, if there are any."""
    problems = tuple(problems)
    if problems:
        raise InputError(problems)


def problems_of(read: Callable[[], Any]) -> tuple[Problem, ...]:
    """Return what is wrong with an input, nothing if it can be read."""
    try:
        read()
    except InputError as error:
        return error.problems
    return ()


def collect_problems(*reads: Callable[[], Any]) -> list[Any]:
    """Every result, or one InputError with the problems of all; what several have in common is said once."""
    results, problems = [], []
    for read in reads:
        try:
            results.append(read())
        except InputError as error:
            problems.extend(error.problems)
    raise_problems(dict.fromkeys(problems))
    return results
