"""Compare the time of each command with a Python process that only imports what the command needs.

    python benchmarks/parts/startup.py [RUNS]

The two take turns, RUNS times (15 by default), after a first pair that is not timed. The ratio is taken within each
pair, so that other load on the machine slows both down.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import median

from markdown_table import print_header, print_row

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "samples"
SMALL, LARGE = "import typer, rich", "import numpy, scipy, pandas, rerun"
FIT = ("fit", f"{SAMPLES / 'whole.csv'}", "--camera", f"{SAMPLES / 'camera.toml'}", "--fps", "60")
FIT_40 = (*FIT, "--frames", "0:40", "--out", "out", "--overwrite", "--quiet")
COMMANDS = (
    ("recon --help", ("--help",), SMALL, ""),
    ("recon --version", ("--version",), SMALL, "6"),
    ("recon fit --help", ("fit", "--help"), SMALL, ""),
    ("recon view --help", ("view", "--help"), SMALL, ""),
    ("recon fit, 40 frames", FIT_40, LARGE, "2"),
)
"""Title, arguments, needed imports, and largest allowed ratio of times of each command."""


def seconds(command: Sequence[str], folder: str) -> tuple[float, float]:
    """Run a command, and return its wall-clock time and its processor time (NaN if unknown), seconds."""
    compiled = {"PYTHONPYCACHEPREFIX": f"{folder}/compiled"}  # compiled once, like an installed package
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | compiled
    began = time.perf_counter()
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.DEVNULL, env=environment) as process:
        if not hasattr(os, "wait4"):
            code, used = process.wait(), float("nan")
        else:
            _, status, usage = os.wait4(process.pid, 0)
            code, used = os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime
            process.returncode = code
    if code:
        raise SystemExit(f"{' '.join(command)}: exit code {code}")
    return time.perf_counter() - began, used


def compared(
    arguments: Sequence[str], imports: str, runs: int, folder: str
) -> tuple[float, float, float, float, float]:
    """Time `recon ARGUMENTS` and Python with the imports alternately, and return medians over the pairs.

    The medians are the wall-clock and processor seconds of `recon ARGUMENTS`, the wall-clock seconds of Python, and the
    ratios of the wall-clock times and of the processor times.
    """
    pair = [sys.executable, "-m", "recon", *arguments], [sys.executable, "-c", imports]
    taken = [[seconds(command, folder) for command in pair] for _ in range(runs + 1)][1:]
    (ours_s, ours_cpu_s), (theirs_s, _) = ([median(run[i][k] for run in taken) for k in (0, 1)] for i in (0, 1))
    ratio, cpu_ratio = (median(ours[k] / theirs[k] for ours, theirs in taken) for k in (0, 1))
    return ours_s, ours_cpu_s, theirs_s, ratio, cpu_ratio


def main() -> None:
    runs = int(sys.argv[1]) if sys.argv[1:] else 15
    print_header(["command", "s", "processor s", "compared with", "s", "ratio", "processor ratio", "at most"])
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments, imports, limit in COMMANDS:
            ours_s, ours_cpu_s, theirs_s, ratio, cpu_ratio = compared(arguments, imports, runs, folder)
            numbers = (f"{ours_s:.2f}", f"{ours_cpu_s:.2f}", f"`{imports}`", f"{theirs_s:.2f}")
            print_row([name, *numbers, f"{ratio:.2f}", f"{cpu_ratio:.2f}", limit])


if __name__ == "__main__":
    main()
