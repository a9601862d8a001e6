"""Measure time and memory of `recon analyse` and `recon report` for a short and a long clip.

python benchmarks/parts/analyse.py [FRAMES ...]

The script fits a simulated animal that runs in circles over each number of FRAMES (by default 40 and 4,000, which takes
minutes). It times each command as a whole process, `recon analyse` with and without figures.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from markdown_table import print_header, print_row
from trajectory import FPS, SIMULATED_CAMERA, body_of, circling

from recon.clip import Keypoints
from recon.io.deeplabcut import write_csv


def fit(frames: int, folder: Path) -> None:
    (view,), _ = circling(frames)
    seen = np.isfinite(view.xy_px[..., 0]).astype(float)
    keypoints = Keypoints(body_of("phantom").markers, view.xy_px, seen, np.arange(frames), fps=FPS)
    file = folder.with_suffix(".csv")
    write_csv(keypoints, file)
    size = "x".join(map(str, SIMULATED_CAMERA.image_size_px))
    camera = ("--hfov-deg", "60", "--image-size", size, "--tilt-deg", "0", "--fps", f"{FPS:g}")
    recon("fit", str(file), *camera, "--out", str(folder), "--quiet", "--overwrite")


def recon(*arguments: str) -> tuple[float, float, float]:
    """Run a command, and return its wall-clock and processor time, seconds, and its peak memory, MB."""
    began = time.perf_counter()
    with subprocess.Popen([sys.executable, "-m", "recon", *arguments], stdout=subprocess.DEVNULL) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f"recon {' '.join(arguments)}: exit code {process.returncode}")
    return time.perf_counter() - began, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def main() -> None:
    counts = [int(argument) for argument in sys.argv[1:]] or [40, 4000]
    print_header(["frames", "command", "s", "processor s", "ms per frame", "peak memory MB"])
    commands = {
        "analyse": ("analyse", "--overwrite"),
        "analyse --no-figures": ("analyse", "--no-figures", "--overwrite"),
        "report": ("report",),
    }
    for frames in counts:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary) / "circling"
            fit(frames, folder)
            for name, (command, *options) in commands.items():
                taken_s, used_s, memory_mb = recon(command, str(folder), *options)
                numbers = (f"{taken_s:.1f}", f"{used_s:.1f}", f"{1000 * used_s / frames:.2f}", f"{memory_mb:.0f}")
                print_row([str(frames), name, *numbers])


if __name__ == "__main__":
    main()
