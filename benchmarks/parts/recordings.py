"""Find the folders of recordings, which are not part of the project."""

from __future__ import annotations

import os
from pathlib import Path


def recordings(kind: str) -> Path:
    """Return the folder of a kind of recordings, such as cheetah-runs, in $RECON_SHARED_DATA or ../shared/data."""
    default = Path(__file__).resolve().parents[3] / "shared" / "data"
    return Path(os.environ.get("RECON_SHARED_DATA", default)) / kind
