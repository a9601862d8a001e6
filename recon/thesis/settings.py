"""Settings of `recon solver`, which the command line reads without the libraries of the work."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from recon.base.settings import Integer, Option, Settings


class SolverSettings(Settings):
    """Settings of `recon solver`."""

    folder: Annotated[Path, Option(argument="DIR")]
    """Results folder of recon frame, such as results/clip."""
    out: Path | None = None
    """Folder for tables and figures. (default: solver in DIR)"""
    frame: Integer | None = None
    """Frame whose search is shown. (default: the frame with the most evaluations)"""
    figures: bool = True
    """Write figures (PNG and SVG) next to the tables."""
    overwrite: bool = False
    """Replace earlier tables."""

    @property
    def out_folder(self) -> Path:
        """Return the folder for tables and figures, by default `solver` in the results folder."""
        return self.folder / "solver" if self.out is None else self.out
