"""angles.csv: the whole state of every frame, in its order, the unit in each column's name (see docs/report.md)."""

from __future__ import annotations

from pathlib import Path

from recon.export.table import write_table
from recon.motion import Motion


def write(motion: Motion, path: Path) -> None:
    """Angles in rad, the place in metres."""
    columns = [name if name.endswith("_m") else f"{name}_rad" for name in motion.state_names]
    write_table(path, [["frame", *columns]], motion.frames, motion.states)
