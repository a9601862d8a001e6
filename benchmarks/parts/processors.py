"""Test whether a fit writes the same tables on machines with other processors.

    python benchmarks/parts/processors.py

The sample `whole.csv` is fitted with two corrections by hand, with one and two threads, and with the matrix kernels
(OpenBLAS) of other processors, each in a separate process. The tables must be identical byte for byte. The digest is
the beginning of the SHA-256 of all tables, by which two machines with the same version of recon can be compared. The
table also has the largest difference of a joint's position in motion.npz. Kernels that this machine cannot run are
skipped.
"""

from __future__ import annotations

import hashlib
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from markdown_table import print_table

from recon import Motion

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "data" / "samples"
CORRECTIONS = "frame,keypoint,now_x_px,now_y_px\n5,r_front_knee,600.0,500.0\n6,r_front_knee,,\n"
CASES = {
    "one thread": {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    "two threads": {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2"},
    "Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "Sandybridge": {"OPENBLAS_CORETYPE": "Sandybridge"},
    "Nehalem": {"OPENBLAS_CORETYPE": "Nehalem"},
}


def fitted(folder: Path, environment: dict[str, str]) -> Path | None:
    """Fit the sample in a process with some environment variables, and return its folder, or None if the fit failed."""
    files = str(SAMPLES / "whole.csv"), "--camera", str(SAMPLES / "camera.toml"), "--fps", "60"
    corrections = folder.parent / "corrections.csv"
    corrections.write_text(CORRECTIONS, encoding="utf-8")
    options = "--corrections", str(corrections), "--out", str(folder), "--quiet"
    command = [sys.executable, "-m", "recon", "fit", *files, *options]
    ended = subprocess.run(command, env={**os.environ, **environment, "PYTHONPATH": str(ROOT)}, check=False)
    return folder if ended.returncode == 0 else None


def row(name: str, folder: Path | None, first: Path) -> list[str]:
    """Compare the tables of a fit with the tables of the first fit byte for byte, and return a table row."""
    if folder is None:
        return [name, "no fit", "", ""]
    tables = sorted(first.glob("*.csv"))
    digest = hashlib.sha256(b"".join((folder / table.name).read_bytes() for table in tables)).hexdigest()[:12]
    same = sum(table.read_bytes() == (folder / table.name).read_bytes() for table in tables)
    joints_m = [Motion.load(path).joints_m for path in (first, folder)]
    return [name, f"{same} of {len(tables)}", digest, f"{float(np.nanmax(np.abs(joints_m[0] - joints_m[1]))):.1g}"]


def main() -> None:
    with tempfile.TemporaryDirectory() as temporary:
        folders = {
            name: fitted(Path(temporary) / f"fit{number}", environment)
            for number, (name, environment) in enumerate(CASES.items())
        }
        first = next(folder for folder in folders.values() if folder is not None)
        rows = [row(name, folder, first) for name, folder in folders.items()]
        print_table(["fit with", "tables equal to the first", "digest", "difference of joints, m"], rows)


if __name__ == "__main__":
    main()
