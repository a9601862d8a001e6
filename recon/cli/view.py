"""`recon view`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def view(folder: Annotated[Path, typer.Argument(help="Folder of results, as in results/clip.")]) -> None:
    """Open the playback of a reconstruction in the rerun viewer.

    Example: recon view results/clip
    """
    from recon.view import open_viewer

    open_viewer(folder / "motion.rrd")
