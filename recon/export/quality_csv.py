"""quality.csv: what is doubtful about each frame (see docs/report.md)."""

from __future__ import annotations

from pathlib import Path

from recon.export.table import write_rows
from recon.motion import Motion

COLUMNS = ("frame", "flags", "alternative_m", "detections", "mean_weight", "place_sigma_m", "relative_rms_m")


def write(motion: Motion, path: Path) -> None:
    """Flags, separated by semicolons, and the numbers behind them."""
    columns = (
        motion.frames,
        [";".join(flags) for flags in motion.flags],
        motion.alternative_m,
        motion.detections,
        motion.mean_weight,
        motion.place_sigma_m,
        motion.relative_rms_m,
    )
    write_rows(path, [COLUMNS], zip(*columns, strict=True))
