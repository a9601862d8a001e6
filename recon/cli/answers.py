"""Define the answer of a command, and print it."""

from __future__ import annotations

import json
import math
import shlex
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console, ConsoleOptions, RenderableType
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn
from rich.segment import Segment
from rich.table import Column, Table
from rich.text import Text

from recon.base.errors import printable
from recon.base.interrupts import EXIT_INTERRUPTED, MESSAGE, installed
from recon.base.progress import Progress as ProgressFunction
from recon.base.progress import silent

if TYPE_CHECKING:
    from recon.fit.result import Verdict  # numpy is slow to import


EXIT_UNSOLVED = 1
EXIT_BAD_INPUT = 2
MIN_FRACTION = 0.03
"""Fraction of the work that has to be done before the remaining time is shown."""
MIN_PASSED_S = 2.0
"""Seconds that have to pass before the remaining time is shown."""


@dataclass(frozen=True)
class Answer:
    """Answer of a command, for people and for other programs."""

    data: Any
    """Data that --json prints as JSON. A string is printed unchanged."""
    lines: Iterable[str | Text | Table] = ()
    """Lines that are printed unless --json is given."""
    errors: Sequence[str] = ()
    """Failures, which are always printed and make the exit code 1."""
    code: int = 0
    """Exit code if there are no errors."""
    files: Sequence[Path] = ()
    """Files that were written, for the stages of `recon run`."""
    notes: Sequence[str] = ()
    """Notes to read before using the result, printed after the lines. `recon run` prints each note once for all
    stages.
    """

    def show(self, console: Console, as_json: bool) -> None:
        """Print the answer, and end the command if the exit code is not 0."""
        if as_json:
            typer.echo(_shown_json(self.data if isinstance(self.data, str) else _json(self.data)), nl=False)
        for line in () if as_json else self.lines:
            say_table(console, line) if isinstance(line, Table) else say(console, line)
        for note in () if as_json else self.notes:
            say(console, f"note: {note}")
        for error in self.errors:
            terminal(stderr=True, soft_wrap=True).print(error_text(error))
        if self.errors or self.code:
            raise typer.Exit(EXIT_UNSOLVED if self.errors else self.code)


def _json(data: object) -> str:
    # numpy is slow to import, and recon doctor must report a numpy that cannot be imported
    from recon.show.plain import to_json

    return to_json(data)


def _shown_json(text: str) -> str:
    """Return JSON that standard output can encode, escaped if its encoding is ASCII."""
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:
        return "".join(c if c.isascii() else json.dumps(c)[1:-1] for c in text)
    return text


def terminal(**options: Any) -> Console:
    """Return a console that prints to the terminal.

    Brackets and colons in names are not treated as markup, and control characters are shown as escape sequences.
    """
    return _Terminal(markup=False, emoji=False, **options)


LONGEST_WORD = 24
"""Number of characters up to which a word in a table's column is not broken; longer words are often paths."""
_WIDEST = 1000
"""Width, in characters, in which every table fits without wrapping."""


class _Terminal(Console):
    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterator[Segment]:
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                text = "\n".join(map(printable, segment.text.split("\n")))
                yield Segment(text, segment.style)


def say(console: Console, text: str | Text, style: str = "") -> None:
    """Print one line without markup, wrapped between words on a terminal and unbroken in a file or a pipe."""
    line = Text(printable(text), style) if isinstance(text, str) else text
    console.print(line, soft_wrap=not console.is_terminal)


def say_table(console: Console, table: Table) -> None:
    """Print a table so that no column is cut.

    In a file or a pipe, the table is as wide as its words need. On a narrow terminal, its columns continue in further
    tables below, each of which begins with the names of the rows.
    """
    if not console.is_terminal:
        words = sum(3 + max(map(len, _words(column)), default=0) for column in table.columns) + 1
        if words > console.width:
            table.width = words  # rich limits the width of a print to that of the console
        console.print(table, crop=False)
        return
    width = console.options.update(width=_WIDEST)
    for part in _parts(table, lambda part: console.measure(part, options=width).minimum <= console.width):
        console.print(part)


def _words(column: Column) -> Iterator[str]:
    """Yield the strings of a table's column that must not be broken.

    These are whole cells if the column has numbers or does not wrap, and otherwise words.
    """
    for text in map(str, (column.header, *column.cells)):
        yield from [text] if column.no_wrap or column.justify == "right" else text.split()


def _parts(table: Table, fits: Callable[[Table], bool]) -> Iterator[Table]:
    """Yield tables with the first column and as many of the others as fit, in their order."""
    if fits(table):
        yield table
        return
    count, first = len(table.columns), 1
    while first < count:
        end = first + 1
        while end < count and fits(_with_columns(table, first, end + 1)):
            end += 1
        yield _with_columns(table, first, end)
        first = end


def _with_columns(table: Table, first: int, end: int) -> Table:
    """Return a table with the first column of another and its columns from `first` up to but not including `end`."""
    columns = [table.columns[0], *table.columns[first:end]]
    part = Table(
        *(column.copy() for column in columns),
        box=table.box,
        padding=table.padding,
        title=table.title if first == 1 else None,
        title_justify=table.title_justify,
    )
    for cells in zip(*(column.cells for column in columns), strict=True):
        part.add_row(*cells)
    return part


def verdict_texts(verdict: Verdict | None) -> Iterator[Text]:
    """Yield the lines of a verdict, which are printed first, or none if the motion has no verdict."""
    from recon.show.console import STYLES

    for line in verdict.lines if verdict else ():
        level = next((level for level in STYLES if line.startswith(f"{level}:")), "")
        yield Text.assemble("" if level else "expected: ", (level, STYLES.get(level, "")), line[len(level) :])


def table_of(
    *texts: str, numbers: Iterable[str] = (), rows: Iterable[Iterable[str | Text]] = (), **options: Any
) -> Table:
    """Return a table with columns of strings, the first of which names each row, followed by columns of numbers.

    `texts` and `numbers` are the headers of the columns, and `options` are passed to rich's `Table`. Words in the
    header, and in columns of numbers, are never cut.
    """
    first, *more_texts = texts
    rows = [[*row] for row in rows]
    columns = (
        Column(first, no_wrap=True),
        *(Column(name, overflow="fold") for name in more_texts),
        *(Column(name, justify="right") for name in numbers),
    )
    for i, column in enumerate(columns):
        cells = [str(row[i]) for row in rows]
        longest = math.inf if i >= len(texts) else LONGEST_WORD
        words = [word for text in cells for word in text.split() if len(word) <= longest]
        column.min_width = max(map(len, [*str(column.header).split(), *words]), default=None)
        if i >= len(texts) and all(len(text.split()) < 2 for text in (str(column.header), *cells)):
            column.no_wrap = True  # rich would make such a column narrower than its words before it wraps others
    table = Table(*columns, box=SIMPLE_HEAD, title_justify="left", **options)
    for row in rows:
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in row))
    return table


def error_text(message: str) -> Text:
    """Return the line that reports an error."""
    return Text.assemble(("error:", "bold red"), " ", printable(message))


def stop(message: str = MESSAGE) -> NoReturn:
    """End a command at Ctrl-C, with one line and exit code 130."""
    interrupts = installed()
    if interrupts is not None:
        interrupts.announced = True
    terminal(stderr=True, soft_wrap=True).print(Text(message, "bold"))
    raise typer.Exit(EXIT_INTERRUPTED)


def wait_for_ctrl_c() -> None:
    """Wait for Ctrl-C, which ends a command that serves a page and is not an error."""
    with suppress(KeyboardInterrupt):
        threading.Event().wait()
    interrupts = installed()
    if interrupts is not None:
        interrupts.announced = True


@contextmanager
def progress_bar(console: Console) -> Iterator[ProgressFunction]:
    """Yield a function that takes a stage and the fraction done (0 to 1), and draws a bar on a terminal."""
    if console.quiet or not console.is_terminal:  # some versions of rich end a disabled bar with an empty line
        yield silent
        return
    remaining = RemainingTime()
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.fields[left]}"),
    )
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("reading", total=1.0, left="")

        def show(stage: str, share: float) -> None:
            # a clip may be solved several times, and the bar must not go back
            share = max(share, bar.tasks[0].completed)
            bar.update(task, description=stage, completed=share, left=remaining.text(share))

        yield show


class RemainingTime:
    """Estimate of the remaining time, from the time since the start and the fraction of the work that is done.

    rich's own estimate uses the speed of the last few seconds, which misleads if the work is done in large steps.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._began_s = clock, clock()

    def text(self, share: float) -> str:
        """Return the remaining time, such as "2 min 10 s left", or "" if it is not yet known or the work is done.

        `share` is the fraction of the work that is done.
        """
        passed_s = self._clock() - self._began_s
        if share < MIN_FRACTION or passed_s < MIN_PASSED_S or share >= 1:
            return ""
        left_s = passed_s * (1 - share) / share
        step_s = 1 if left_s < 20 else 10 if left_s < 600 else 60
        return f"{duration_text(max(step_s, round(left_s / step_s) * step_s))} left"


def duration_text(seconds: float) -> str:
    """Return a duration, such as "8 s", "2 min 10 s", "1 h 5 min"."""
    whole = round(seconds)
    minutes, rest = divmod(whole, 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min" if minutes else f"{hours} h"
    return f"{whole} s" if not minutes else f"{minutes} min {rest} s" if rest else f"{minutes} min"


def answer_of_fit(report: dict[str, Any], out: Path, page: Path | None = None, **fields: Any) -> Answer:
    """Return the answer of a command that fitted a clip into a folder.

    `page` is the page of the result, if there is one, and `fields` are added to the JSON.
    """
    from recon.fit.motion_forms import REPORT
    from recon.show.console import console_summary
    from recon.show.page.own_page import PLAYBACK, VIDEO_PLAYBACK
    from recon.show.report import is_unsolved

    report_fields = {name: report[name] for name in ("method", "summary", "findings")}
    data = {"out": out, **report_fields, "seconds": report["timing_s"]["solve_s"], **fields}
    if is_unsolved(report):
        return Answer(data, [console_summary(report)], [f"no frame could be solved: see {out / REPORT}"])
    folder, contents = shlex.quote(str(out)), "pictures, figures and all numbers"
    lines = [f"Results are in {out}. Watch them with: recon view {folder}"]
    if not any((out / name).is_file() for name in (PLAYBACK, VIDEO_PLAYBACK)):
        kept = shlex.quote(str(out / VIDEO_PLAYBACK))
        lines.append(
            f"recon view makes the playback, which the fit did not write. To keep it: recon view {folder} --out {kept}"
        )
    lines.append(f"Open {page} in a browser: {contents}." if page else f"A page with {contents}: recon report {folder}")
    return Answer(data, [console_summary(report), *lines])
