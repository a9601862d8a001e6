"""Locate the sample clips that come with the package."""

from __future__ import annotations

from pathlib import Path

from recon.base.errors import InputError, Problem


def samples_folder() -> Path:
    """Return the folder of the samples: in the installed package, or data/samples in a checkout."""
    package = Path(__file__).parents[1]
    for folder in (package / "samples", package.parent / "data" / "samples"):
        if (folder / "whole.csv").is_file():
            return folder
    raise InputError(Problem("recon", "samples", "no samples in the package", "a complete installation"))
