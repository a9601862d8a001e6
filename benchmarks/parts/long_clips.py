"""Measure processor time, peak memory and output sizes of `recon fit` on long clips.

python benchmarks/parts/long_clips.py [CASE ...] [--against CHECKOUT]

Each fit runs in its own process. A case is frames x cameras, such as 4000x6, or a number of frames of which 120 are
seen, in three segments, such as 216000/120; by default, a list of cases is measured. A simulated animal runs in circles
in front of static cameras. With --against, another checkout fits each case before this checkout does.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from markdown_table import print_header, print_row
from trajectory import FPS, SIMULATED_CAMERA, body_of, circling

import recon
from recon.clip import Keypoints
from recon.io.deeplabcut import write_csv

CASES = ("1000x1", "4000x1", "16000x1", "4000x6", "216000/120")
STRETCHES = 3


def write_inputs(folder: Path, case: str) -> tuple[list[str], int]:
    """Write the input files of a case, and return the arguments of `recon fit` and the number of seen frames."""
    frames, _, cameras = case.partition("x")
    frames, _, count = frames.partition("/")
    T = int(frames)
    seen = np.ones(T, dtype=bool)
    if count:
        per = int(count) // STRETCHES
        seen[:] = False
        for k in range(STRETCHES):
            seen[round(T * (k + 0.5) / STRETCHES) :][:per] = True
    views, _ = circling(int(seen.sum()), int(cameras or 1))
    placed, files = [], []
    for i, view in enumerate(views):
        xy_px = np.full((T, *view.xy_px.shape[1:]), np.nan)
        xy_px[seen] = view.xy_px
        pose = view.T_camera_world
        placed.append(replace(SIMULATED_CAMERA, name=f"cam{i}", rotation=pose[:3, :3], translation_m=pose[:3, 3]))
        confidence = np.isfinite(xy_px[..., 0]).astype(float)
        files.append(folder / f"run_cam{i}.csv")
        write_csv(Keypoints(body_of("phantom").markers, xy_px, confidence, np.arange(T), fps=FPS), files[-1])
    recon.write_cameras(placed, folder / "cameras.toml")
    return [*map(str, files), "--camera", str(folder / "cameras.toml"), "--fps", f"{FPS:g}"], int(seen.sum())


def fitted(checkout: Path, arguments: list[str], out: Path) -> tuple[float, float, dict[str, float]]:
    """Run a fit, and return its processor time in seconds, its peak memory in MB, and the sizes of its files in MB."""
    command = [sys.executable, "-m", "recon", "fit", *arguments, "--out", str(out), "--overwrite", "--quiet"]
    with subprocess.Popen(command, env={**os.environ, "PYTHONPATH": str(checkout)}, cwd=out.parent) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"{' '.join(command)}: exit code {process.returncode}")
    sizes = {file.name: file.stat().st_size / 1e6 for file in out.rglob("*") if file.is_file()}
    return usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024, sizes


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="*", default=CASES)
    parser.add_argument("--against", type=Path)
    options = parser.parse_args()
    here = Path(__file__).resolve().parents[2]
    header = ["case", "checkout", "processor s", "ms per seen frame", "peak memory MB"]
    print_header([*header, "written MB", "motion.npz MB", "motion.rrd MB", "tables MB"])
    for case in options.cases:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            arguments, seen = write_inputs(folder, case)
            for checkout in filter(None, (options.against, here)):
                taken_s, memory_mb, sizes = fitted(checkout, arguments, folder / "out")
                tables_mb = sum(size for name, size in sizes.items() if name.endswith(".csv"))
                parts_mb = (sum(sizes.values()), sizes["motion.npz"], sizes.get("motion.rrd", 0.0), tables_mb)
                numbers = (f"{taken_s:.1f}", f"{1000 * taken_s / seen:.1f}", f"{memory_mb:.0f}")
                print_row([case, checkout.name, *numbers, *(f"{size:.1f}" for size in parts_mb)])


if __name__ == "__main__":
    main()
