"""`recon doctor`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from itertools import groupby

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Column, Table
from rich.text import Text

from recon.workflows.cli.common import progress_bar, say, terminal
from recon.workflows.doctor import Check, run_doctor

EXIT_BROKEN = 1
_STYLES = {"ok": "green", "absent": "", "note": "yellow", "broken": "bold red"}


def doctor(as_json: bool) -> None:
    """Check the installation: versions, optional parts, the viewer, and a fit of the sample.

    Example: recon doctor

    Exit code 0: recon works here. 1: something that it cannot do without is broken.
    """
    with progress_bar(terminal(stderr=True), "checking: ") as progress:
        checks = run_doctor(progress)
    ok = all(check.status != "broken" for check in checks)
    if as_json:
        typer.echo(json.dumps({"ok": ok, "checks": [asdict(check) for check in checks]}, indent=1))
    else:
        _print(terminal(), checks)
    if not ok:
        raise typer.Exit(EXIT_BROKEN)


def _print(console: Console, checks: Sequence[Check]) -> None:
    columns = Column(no_wrap=True), Column(no_wrap=True), Column(overflow="fold")
    table = Table(*columns, box=SIMPLE_HEAD, show_header=False)
    for _, group in groupby(checks, key=lambda check: check.group):
        for check in group:
            text = Text(check.found)
            if check.hint and check.status != "ok":
                text.append(f"\n{check.hint}", "italic")
            table.add_row(Text(check.name), Text(check.status, _STYLES[check.status]), text)
        table.add_section()
    console.print(table)
    broken = [check.name for check in checks if check.status == "broken"]
    say(console, f"Broken: {', '.join(broken)}" if broken else "recon works here.")
