"""Measure the processor time of short tasks: a fit of 40 frames and its parts, help texts, and a clip of a batch.

    python benchmarks/parts/short.py [--runs 5] [--clips 20]

Each command is timed as a whole process, and the fastest of RUNS runs counts, because other load only adds time. The
time of a fit's imports is measured in a process that only imports the modules of the fit without a playback. The time
of the playback is the additional time of the fit with a playback, including the import of rerun. The time of a clip of
a batch is the mean over CLIPS perturbed copies of a sample (60 frames), which one process fits one after the other,
after a first clip that is not timed. The process keeps freed memory and collects garbage rarely, as the processes of a
batch do.
"""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from arguments import parser_of
from batch import CAMERA, make_clips
from markdown_table import print_table
from startup import FIT_40, seconds

from recon.api.clip_results import run_clip
from recon.api.settings import FitSettings
from recon.base.memory import collect_rarely, keep_freed_memory

IMPORTS = """
from importlib import import_module
from recon.base.memory import collect_rarely

collect_rarely()
for name in {}:
    try:
        import_module(name)
    except ImportError:  # optional modules that a library looks for
        pass
"""
"""Python program that imports modules as the command line does."""
WITHOUT_PLAYBACK = (*FIT_40, "--set", "playback=false")


def used_s(command: list[str], folder: str, runs: int) -> float:
    """Run a command once untimed and then `runs` times, and return the shortest processor time, seconds."""
    return min([seconds(command, folder)[1] for _ in range(runs + 1)][1:])


def recon(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "recon", *arguments]


def modules_of(command: list[str], folder: str) -> list[str]:
    """Return the modules that a Python command imports, in the order in which their imports finish."""
    traced = [command[0], "-X", "importtime", *command[1:]]
    stderr = subprocess.run(traced, cwd=folder, capture_output=True, text=True, check=True).stderr
    names = re.findall(r"^import time:.*\| +(\S+)$", stderr, re.MULTILINE)
    return [name for name in names if name != "recon.__main__"]


def clip_s(clips: int) -> float:
    """Fit many clips in one process, and return the mean processor time per clip, seconds."""
    keep_freed_memory()
    collect_rarely()
    with tempfile.TemporaryDirectory() as temporary:
        folder, out = Path(temporary) / "clips", Path(temporary) / "out"
        out.mkdir()
        make_clips(folder, clips + 1, 0)
        files = sorted(folder.glob("*/*.csv"))
        began = 0.0
        for number, file in enumerate(files):
            if number == 1:
                began = time.process_time()
            run_clip(FitSettings(keypoints=(file,), camera=(CAMERA,), fps=60), out / file.stem)
        return (time.process_time() - began) / clips


def rows(options: argparse.Namespace, folder: str) -> list[list[str]]:
    imports = Path(folder) / "imports.py"
    imports.write_text(IMPORTS.format(modules_of(recon(*WITHOUT_PLAYBACK), folder)))
    commands = {
        "`recon fit`, 40 frames": recon(*FIT_40),
        "without the playback": recon(*WITHOUT_PLAYBACK),
        "imports": [sys.executable, str(imports)],
        "`recon fit --help`": recon("fit", "--help"),
        "`recon view --help`": recon("view", "--help"),
    }
    used = {name: used_s(command, folder, options.runs) for name, command in commands.items()}
    whole_s, plain_s, imports_s, *help_s = used.values()
    parts = {
        "`recon fit`, 40 frames": whole_s,
        "of which imports": imports_s,
        "of which the playback": whole_s - plain_s,
        "of which everything else": plain_s - imports_s,
        **dict(zip([*used][3:], help_s, strict=True)),
        "a clip of a batch, 60 frames": clip_s(options.clips),
    }
    return [[name, f"{part_s:.2f}"] for name, part_s in parts.items()]


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--clips", type=int, default=20)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        print_table(["work", "processor s"], rows(options, folder))


if __name__ == "__main__":
    main()
