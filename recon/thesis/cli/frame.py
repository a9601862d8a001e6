"""The command `recon frame`: its options, and what it prints."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from recon.base.settings import Option, Settings
from recon.workflows.cli.command import OptionsOf
from recon.workflows.cli.common import finish, progress_bar, terminal
from recon.workflows.settings import SETTINGS, FitSettings, read_settings

_OPTIONS = tuple(name for name, info in SETTINGS.items() if name != "method" and info.option.method in (None, "frame"))


class _FrameRunSettings(Settings):
    """The settings of `recon frame` beside those of the fit itself."""

    out: Annotated[Path, Option("Folder for the results, as in results/clip1.")]
    config: Annotated[Path | None, Option("config.toml of an earlier run; options given here overrule it.")] = None
    overwrite: Annotated[bool, Option("Replace results in the folder.")] = False


def frame(
    settings: _FrameRunSettings,
    given: Annotated[dict[str, Any], OptionsOf(FitSettings, _OPTIONS)],
    as_json: bool,
    quiet: bool,
) -> None:
    """The thesis' method, to compare with: one side of the animal as a chain, one frame after the other.

    Example: recon frame clip.csv --camera scene.json --camera-name cam2 --fps 90 --out results/clip

    Exit code 0: done. 1: no frame could be solved. 2: the input cannot be used.
    """
    from recon.workflows.clip_results import run_clip
    from recon.workflows.made_from import read_config

    given = {**given, "method": "frame"}
    fitted = read_settings(None, given) if settings.config is None else read_config(settings.config, given)
    with progress_bar(terminal(quiet=quiet, stderr=as_json), "fitting: ") as progress:
        report = run_clip(fitted, settings.out, settings.overwrite, progress)
    finish(terminal(quiet=quiet, stderr=as_json), report, settings.out, as_json)
