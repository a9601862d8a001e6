"""Interrupt every longer command at random times, and check for one line on stderr and exit code 130.

    python tests/fuzz/ctrl_c.py [--count 50] [--seed 0] [--only WORD ...]

SIGINT goes to the command and its children, as from a terminal. Its time is drawn evenly from the duration of the
command, counted from the moment when `recon.__main__` is reached, because nothing can be done while Python itself
starts. A run that ended before the signal is not counted, and another run replaces it. The script prints the outcome
of each run, and ends with 1 if a run did not end as it should.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from importlib import util
from pathlib import Path
from typing import NamedTuple

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "samples"
CAMERA = ("--camera", SAMPLES / "camera.toml")
PATIENCE_S = 60.0
READY = "READY"
# The program runs the command line like the installed command, and reports when Ctrl-C is handled.
CODE = f"""
import os, signal
from recon.__main__ import main
from recon.base.interrupts import Interrupts
install = Interrupts.install
def install_and_tell(self):
    install(self)
    os.close(int(os.environ["{READY}"]))
Interrupts.install = install_and_tell
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell ignores SIGINT in background jobs
main()
"""


class Ended(NamedTuple):
    """How a run ended, with or without an interruption."""

    code: int
    err: str
    in_time: bool
    """Whether the signal came before the run ended."""
    seconds: float
    """Time from the signal to the end, or duration of a run without a signal, seconds."""


def interrupted(arguments: Sequence[object], after_s: float | None, folder: Path) -> Ended:
    """Run `recon ARGUMENTS` in `folder`, and interrupt it after `after_s` seconds, or never if `after_s` is None."""
    reader, writer = os.pipe()
    with subprocess.Popen(
        [sys.executable, "-c", CODE, *map(str, arguments)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        cwd=folder,
        env={**os.environ, READY: str(writer)},
        pass_fds=[writer],
        start_new_session=True,
    ) as process:
        os.close(writer)
        os.read(reader, 1)  # returns when the command is ready for Ctrl-C
        os.close(reader)
        began, in_time = time.monotonic(), False
        if after_s is not None:
            try:
                process.wait(after_s)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGINT)
                began, in_time = time.monotonic(), True
        try:
            _, err = process.communicate(timeout=PATIENCE_S if in_time else None)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            _, err = process.communicate()
        return Ended(process.returncode, err, in_time, time.monotonic() - began)


def fault(ended: Ended) -> str:
    """Return what is wrong with the end of a run, or "" if nothing is."""
    if ended.code != 130:
        return f"exit code {ended.code}"
    lines = ended.err.count("\n")
    return "" if lines == 1 and ended.err.endswith("\n") else f"{lines} lines"


def commands() -> dict[str, tuple[object, ...]]:
    """Return the arguments of each tested command, keyed by a name.

    The commands run in the folder that `prepare` fills. The folder `out` is new for each run.
    """
    whole, noisy = (SAMPLES / f"{name}.csv" for name in ("whole", "noisy"))
    film, labels = SAMPLES / "rendered.mp4", SAMPLES / "rendered_labels.csv"
    filmed = ("--camera", SAMPLES / "rendered_camera.toml", "--keypoints", SAMPLES / "rendered_points.csv")
    found: dict[str, tuple[object, ...]] = {
        "help": ("--help",),
        "run": ("run", film, *filmed, "--out", "out"),
        "fit": ("fit", whole, *CAMERA, "--fps", 60, "--out", "out"),
        "fit, frame by frame": ("fit", noisy, *CAMERA, "--fps", 30, "--set", "method=frame", "--out", "out"),
        "batch": ("batch", whole, noisy, *CAMERA, "--fps", 60, "--jobs", 2, "--out", "out"),
        "demo": ("demo", "--out", "out"),
        "analyse": ("analyse", "results", "--out", "out"),
        "ik": ("ik", "results", "--compare", "--out", "out"),
        "climb": ("climb", "--out", "out"),
        "retarget": ("retarget", "results", "--robot", "a1", "--out", "out"),
        "convert": ("convert", "results", "out.trc"),
        "evaluate": ("evaluate", "results/pose3d.csv", SAMPLES / "whole_truth.csv"),
        "prior": (
            "prior",
            "fit",
            SAMPLES / "whole_truth.csv",
            "--skeleton",
            "cheetah-24",
            "--fps",
            60,
            "--out",
            "p.npz",
        ),
        "skeleton": ("skeleton", "check", "dog-27", "--out", "out"),
        "doctor": ("doctor",),
        "report": ("report", "results"),
        "overlay": ("overlay", "film", "--video", film, "--out", "out.mp4"),
    }
    if util.find_spec("torch") is not None:
        found["predict"] = ("predict", film, "--model", "model", "--threads", 1, "--out", "out.csv")
        found["train"] = ("train", film, "--labels", labels, "--steps", 4, "--batch", 2, "--threads", 1, "--out", "out")
    return found


def prepare(folder: Path, names: Sequence[str]) -> None:
    """Make the inputs that the project lacks: results of two clips, and a barely trained network."""
    camera, points = SAMPLES / "rendered_camera.toml", SAMPLES / "rendered_points.csv"
    made: list[tuple[object, ...]] = [(*commands()["fit"][:-1], "results")]
    if "overlay" in names:
        made.append(
            ("fit", points, "--camera", camera, "--fps", 120, "--frames", "0:40", "--set", "fast=true", "--out", "film")
        )
    if "predict" in names:
        film, labels = SAMPLES / "rendered.mp4", SAMPLES / "rendered_labels.csv"
        made.append(("train", film, "--labels", labels, "--steps", 2, "--batch", 2, "--threads", 1, "--out", "model"))
    for arguments in made:
        ended = interrupted(arguments, None, folder)
        if ended.code != 0:
            sys.exit(f"recon {' '.join(map(str, arguments))}\n{ended.err}")


def clear(folder: Path) -> None:
    """Delete the complete or partial output of a command."""
    for path in folder.iterdir():
        if path.name not in ("results", "film", "model"):
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=50, help="runs that are stopped before they end")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="+", metavar="WORD", help="commands whose name has one of these")
    args = parser.parse_args()
    names = [name for name in commands() if not args.only or any(word in name for word in args.only)]
    rng = random.Random(args.seed)
    good, slowest_s = 0, 0.0
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        prepare(folder, names)
        takes_s = {}
        for name in names:
            ended = interrupted(commands()[name], None, folder)
            clear(folder)
            takes_s[name] = ended.seconds
            print(f"{name}: {ended.seconds:.1f} s, exit code {ended.code}", flush=True)
        stopped = 0
        while stopped < args.count:
            name = names[stopped % len(names)]
            after_s = rng.uniform(0, takes_s[name])
            ended = interrupted(commands()[name], after_s, folder)
            clear(folder)
            if not ended.in_time or (ended.code == 0 and not ended.err):
                continue
            stopped += 1
            wrong = fault(ended)
            good += not wrong
            slowest_s = max(slowest_s, ended.seconds)
            print(
                f"{stopped:3} {name} after {after_s:.2f} s: {wrong or 'good'}, {ended.seconds:.2f} s later", flush=True
            )
            if wrong:
                print(ended.err)
    print(f"{good} of {args.count}: one line, exit code 130; the slowest took {slowest_s:.1f} s")
    return 0 if good == args.count else 1


if __name__ == "__main__":
    sys.exit(main())
