"""`recon demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from recon.base.settings import Option, Settings
from recon.workflows.cli.common import finish, progress_bar, say, terminal
from recon.workflows.demo import run_demo


class _DemoSettings(Settings):
    """What `recon demo` is told."""

    out: Annotated[Path, Option("Folder for the results.")] = Path("demo-output")
    overwrite: Annotated[bool, Option("Replace results in the folder.")] = False


def demo(settings: _DemoSettings, as_json: bool, quiet: bool) -> None:
    """Reconstruct the bundled sample, a noisy synthetic gallop, and compare it with its truth.

    Example: recon demo --out demo-output
    """
    console = terminal(quiet=quiet, stderr=as_json)
    with progress_bar(console, "fitting: ") as progress:
        report, evaluation, found, page = run_demo(settings.out, settings.overwrite, progress)
    finish(console, report, settings.out, as_json, mpjpe_mm=1000 * evaluation.mpjpe_m.mean)
    if not as_json:
        console.print(f"Error against the sample's truth: {1000 * evaluation.mpjpe_m.mean:.0f} mm (MPJPE)\n")
        for sentence in found:
            say(console, sentence)
        say(console, f"Open {page} in a browser.")
