"""Writing a `Motion` to files: one module per format, each with `write(motion, path)`.

Writers write in place; `recon.files.staged_folder` makes a folder of them appear whole or not at all.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from recon.export import angles_csv, pose3d_csv, reprojection_csv
from recon.motion import Motion

Writer = Callable[[Motion, Path], None]

CLIP_OUTPUTS: dict[str, Writer] = {
    "pose3d.csv": pose3d_csv.write,
    "angles.csv": angles_csv.write,
    "reprojection.csv": reprojection_csv.write,
}
"""The tables that every clip gets, by file name."""
