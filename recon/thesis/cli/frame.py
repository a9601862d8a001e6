"""`recon frame`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from recon.workflows.cli.common import finish, leave_pandas_out, progress_bar, terminal
from recon.workflows.cli.settings import OPTIONS, takes_settings
from recon.workflows.settings import SETTINGS

_OPTIONS = [name for name in OPTIONS if name != "method" and SETTINGS[name].method in (None, "frame")]


@takes_settings(_OPTIONS)
def frame(
    *,
    out: Annotated[Path, typer.Option(help="Folder for the results, as in results/clip1.")],
    given: dict[str, Any],
    config: Annotated[
        Path | None, typer.Option(help="config.toml of an earlier run; options given here overrule it.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace results in the folder.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the report's summary as JSON.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """The thesis' method, to compare with: one side of the animal as a chain, one frame after the other.

    Example: recon frame clip.csv --camera scene.json --camera-name cam2 --fps 90 --out results/clip

    Exit code 0: done. 1: no frame could be solved. 2: the input cannot be used.
    """
    from recon.workflows.clip import run_clip
    from recon.workflows.made_from import read_config
    from recon.workflows.settings import read_settings

    given = {**given, "method": "frame"}
    settings = read_settings(None, given) if config is None else read_config(config, given)
    leave_pandas_out()
    with progress_bar(terminal(quiet=quiet, stderr=as_json), "fitting: ") as progress:
        report = run_clip(settings, out, overwrite, progress)
    finish(terminal(quiet=quiet, stderr=as_json), report, out, as_json)
