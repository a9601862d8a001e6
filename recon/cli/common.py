"""What several commands print."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.text import Text

from recon.interrupts import EXIT_INTERRUPTED, MESSAGE, installed

EXIT_UNSOLVED = 1
EXIT_BAD_INPUT = 2


def error_text(message: str) -> Text:
    return Text.assemble(("error:", "bold red"), " ", message)


def stop(message: str = MESSAGE) -> NoReturn:
    """End a command at Ctrl-C: one line, and exit code 130."""
    interrupts = installed()
    if interrupts is not None:
        interrupts.said = True
    Console(stderr=True, soft_wrap=True).print(Text(message, "bold"))
    raise typer.Exit(EXIT_INTERRUPTED)


@contextmanager
def progress_bar(console: Console, doing: str = "fitting") -> Iterator[Any]:
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=console.quiet or not console.is_terminal) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda stage, share: bar.update(task, description=f"{doing}: {stage}", completed=share)


def finish(console: Console, report: dict[str, Any], out: Path, as_json: bool = False, **more: Any) -> None:
    """Print what there is to say of a fit; as_json: to the standard output, with `more` fields."""
    from recon.report import console_summary, is_unsolved

    if as_json:
        own = {name: report[name] for name in ("method", "summary", "warnings")}
        seconds = report["timing_s"]["solve_s"]
        typer.echo(json.dumps({"out": str(out), **own, "seconds": seconds, **more}, indent=1))
    else:
        console.print(console_summary(report))
    if is_unsolved(report):
        message = f"no frame could be solved: see {out / 'report.json'}"
        Console(stderr=True, soft_wrap=True).print(error_text(message))
        raise typer.Exit(EXIT_UNSOLVED)
    if not as_json:
        console.print(
            Text(f"Results are in {out}. Watch them with: recon view {shlex.quote(str(out))}"), soft_wrap=True
        )
