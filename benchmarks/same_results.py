"""Compare the results of two checkouts of the project bit for bit.

    python benchmarks/same_results.py OLD NEW [--quick] [--only NAME ...] [--keep FOLDER]

OLD and NEW are folders of checkouts. Both run the same commands on the same files: `fit` and `frame` on the samples and
on the recordings in $RECON_SHARED_DATA (each camera, each pair of neighbouring cameras, all cameras of a run), and
`analyse`, `ik`, `retarget` and `compare` on fits of samples. The comparison covers the cells of all tables, the numbers
and codes of all reports and the arrays of motion.npz, without times, versions and paths. The exit code is 1 if any
result differs.

--quick runs the samples and three views only. --only runs the commands whose names contain one of the words. --keep
stores results by commit in a folder, and reuses them if the checkout has no uncommitted changes.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from question import recordings

FAILED = "failed.txt"
CLOCK_COLUMNS = ("solve_s", "solve_ms", "us_per_step")
"""Columns of tables with measured times."""
CLOCK_KEYS = ("timing_s", "recon_version", "schema", "settings", *CLOCK_COLUMNS)
"""Keys of reports that depend on the clock, the version or the folders."""
CODE_KEYS = ("level", "code", "status", "flags", "side", "method")
"""Keys of reports whose values, which are strings, are compared."""
PLAYBACKS = ("recon.show.view.write", "recon.show.view.playback.write")
FIGURES = ("recon.ik.clip.write_figures", "recon.robotics.ik.clip.write_figures")
"""Slow functions to skip in both checkouts, because their output is not compared."""

Command = tuple[str, list[str]]
"""Name of the command, which is also the folder of its results, and the arguments of `recon`."""


def sample_commands(samples: Path) -> Iterator[Command]:
    """Yield the name and the arguments of each command that runs on the samples."""

    def fit(name: str, keypoints: str, camera: str, *options: str) -> Command:
        return name, ["fit", str(samples / keypoints), "--camera", str(samples / camera), *options, "--out", name]

    chain = ("--fps", "30", "--skeleton", "cheetah-8u")
    yield fit("fit-whole", "whole.csv", "camera.toml", "--fps", "60")
    yield (
        "fit-level",
        [
            *("fit", str(samples / "whole.csv"), "--hfov-deg", "60", "--image-size", "1920x1080", "--tilt-deg", "3"),
            *("--fps", "60", "--out", "fit-level"),
        ],
    )
    views = [str(samples / f"whole_cam{camera}.csv") for camera in (1, 2)]
    yield "fit-two", ["fit", *views, "--camera", str(samples / "whole_scene.json"), "--fps", "60", "--out", "fit-two"]
    yield fit("fit-rendered", "rendered_points.csv", "rendered_camera.toml", "--fps", "120", "--frames", "0:40")
    yield fit("fit-noisy", "noisy.csv", "camera.toml", *chain)
    yield fit("fit-clean", "clean.csv", "camera.toml", *chain)
    yield fit("fit-heading", "clean_heading_34deg.csv", "camera_heading_34deg.toml", *chain)
    yield fit("fit-fisheye", "fisheye_left.csv", "camera_fisheye.toml", *chain)
    for name, keypoints, camera in (
        ("noisy", "noisy.csv", "camera.toml"),
        ("clean", "clean.csv", "camera.toml"),
        ("heading", "clean_heading_20deg.csv", "camera_heading_20deg.toml"),
        ("fisheye", "fisheye_left.csv", "camera_fisheye.toml"),
    ):
        label, arguments = fit(f"frame-{name}", keypoints, camera, "--fps", "30")
        yield label, ["frame", *arguments[1:]]
    yield "analyse-whole", ["analyse", "fit-whole", "--no-figures", "--out", "analyse-whole"]
    yield "analyse-noisy", ["analyse", "fit-noisy", "--no-figures", "--out", "analyse-noisy"]
    yield "compare", ["compare", "fit-whole", "fit-two", "--out", "compare", "--anyway"]
    yield "retarget", ["retarget", "fit-whole", "--robot", "a1", "--out", "retarget"]
    yield "ik", ["ik", "fit-whole", "--compare", "--out", "ik"]


def recorded_commands() -> Iterator[Command]:
    """Yield the commands that fit single cameras, neighbouring pairs and all cameras of each run, cheapest first."""
    runs = [
        (file.parent, json.loads(file.read_text())) for file in sorted(recordings("cheetah-runs").glob("*/meta.json"))
    ]

    def fit(run: Path, meta: dict[str, Any], cameras: list[int], command: str = "fit") -> Command:
        name = f"{command}-{run.name}-{'+'.join(map(str, cameras))}"
        files = [str(run / f"cam{camera}.csv") for camera in cameras]
        names = [argument for camera in cameras for argument in ("--camera-name", f"cam{camera}")]
        scene = ["--camera", str(run / "scene.json"), *names, "--fps", str(meta["fps"])]
        return name, [command, *files, *scene, "--out", name]

    for run, meta in runs:
        yield from (fit(run, meta, [camera]) for camera in meta["cameras"])
    for run, meta in runs:
        yield fit(run, meta, [meta["cameras"][0]], "frame")
        yield from (fit(run, meta, list(pair)) for pair in zip(meta["cameras"], meta["cameras"][1:], strict=False))
    yield from (fit(run, meta, meta["cameras"]) for run, meta in runs)


def needed(commands: list[Command], words: list[str]) -> list[Command]:
    """Keep the commands whose name contains one of the words, and the commands whose results they read."""
    chosen = {name for name, _ in commands if any(word in name for word in words)}
    read = {argument for name, arguments in commands if name in chosen for argument in arguments}
    return [command for command in commands if command[0] in chosen | read]


def run_commands(plan: Path) -> None:
    """Run a list of commands in this process; each command writes into its own folder below the working folder."""
    from importlib import import_module

    for target in (*PLAYBACKS, *FIGURES):
        module, _, name = target.rpartition(".")
        try:
            home = import_module(module)
        except ImportError:
            continue
        if hasattr(home, name):
            setattr(
                home, name, lambda *arguments, **_: [a.touch() for a in arguments if isinstance(a, Path) and a.suffix]
            )
    from recon.__main__ import main as recon_main

    for name, arguments in json.loads(plan.read_text()):
        sys.argv = ["recon", *arguments, "--quiet"]
        message = ""
        try:
            recon_main()
        except SystemExit as end:
            message = f"exit code {end.code}" if end.code else ""
        except Exception as error:
            message = f"{type(error).__name__}: {error}"
        if message:
            Path(name).mkdir(exist_ok=True)
            (Path(name) / FAILED).write_text(message)


@dataclass(frozen=True)
class Comparison:
    """Outcome of comparing one result file of both checkouts."""

    file: str
    values: int
    difference: str
    """First difference and number of differences; empty if there is none."""


def compare_files(old: Path, new: Path, name: str) -> Comparison:
    """Compare the values of one file in the result folders of both checkouts."""
    if not ((old / name).is_file() and (new / name).is_file()):
        return Comparison(name, 0, f"only in {'OLD' if (old / name).is_file() else 'NEW'}")
    was, now = values_of(old / name), values_of(new / name)
    different = [key for key in {**was, **now} if was.get(key) != now.get(key)]
    if not different:
        return Comparison(name, len(was), "")
    key = different[0]
    return Comparison(
        name, len(was), f"{key}: {was.get(key, 'missing')} -> {now.get(key, 'missing')}; {len(different)} in all"
    )


def values_of(path: Path) -> dict[str, str]:
    """Read the values of a result file, except those that depend on clock, version or folders, keyed by position."""
    if path.suffix == ".csv":
        rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
        header = rows[0] if rows else []
        return {
            f"row {number}, {column}": cell
            for number, row in enumerate(rows)
            for column, cell in zip(header, row, strict=False)
            if column not in CLOCK_COLUMNS
        }
    if path.suffix == ".json":
        return dict(numbers_of(json.loads(path.read_text(encoding="utf-8")), ""))
    if path.suffix == ".npz":
        with np.load(path) as arrays:
            return {
                name: f"{arrays[name].dtype}{arrays[name].shape} {hash_of(arrays[name])}"
                for name in arrays.files
                if arrays[name].dtype.kind == "f"
            }
    return {"text": path.read_text(encoding="utf-8")}


def hash_of(array: np.ndarray) -> str:
    """Return twelve digits of an array's SHA-256."""
    return hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()[:12]


def numbers_of(value: Any, key: str) -> Iterator[tuple[str, str]]:
    """Yield each number and each compared string of a report, preceded by the keys that lead to it."""
    if isinstance(value, dict):
        for name, inner in value.items():
            if name not in CLOCK_KEYS:
                yield from numbers_of(inner, f"{key}.{name}" if key else name)
    elif isinstance(value, list):
        for number, inner in enumerate(value):
            yield from numbers_of(inner, f"{key}[{number}]")
    elif isinstance(value, int | float | None) or key.rpartition(".")[2] in CODE_KEYS:
        yield key, json.dumps(value)


def result_files(folder: Path) -> set[str]:
    """Return the paths of the files to compare in a command's results folder."""
    paths = [path for path in folder.rglob("*") if path.suffix in (".csv", ".json", ".npz") or path.name == FAILED]
    return {str(path.relative_to(folder)) for path in paths if path.name not in ("manifest.json", ".recon.json")}


def commit_of(checkout: Path) -> str:
    """Return the commit of a checkout, or an empty string if it has uncommitted changes."""
    git = ["git", "-C", str(checkout)]
    changed = subprocess.run(
        [*git, "status", "--porcelain", "recon"], capture_output=True, text=True, check=True
    ).stdout
    head = subprocess.run([*git, "rev-parse", "HEAD"], capture_output=True, text=True, check=True).stdout.strip()
    return "" if changed else head


def start(checkout: Path, commands: list[Command], out: Path, keep: Path | None) -> subprocess.Popen[bytes]:
    """Copy results kept earlier, and start a process that runs the other commands with a checkout's code."""
    out.mkdir(parents=True)
    commit = commit_of(checkout) if keep else ""
    if keep and commit:
        for name, _ in commands:
            if (keep / commit / name).is_dir():
                shutil.copytree(keep / commit / name, out / name)
    plan = out.with_suffix(".json")
    plan.write_text(json.dumps([command for command in commands if not (out / command[0]).exists()]))
    environment = {
        **os.environ,
        "PYTHONPATH": str(checkout),
        **dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"),
    }
    arguments = [sys.executable, "-W", "ignore", str(Path(__file__).resolve()), "--run", str(plan)]
    return subprocess.Popen(arguments, cwd=out, env=environment, stdout=subprocess.DEVNULL)


def keep_results(checkout: Path, out: Path, keep: Path) -> None:
    """Copy results to the folder where later runs look for the results of this commit."""
    commit = commit_of(checkout)
    for folder in out.iterdir():
        if commit and folder.is_dir() and not (keep / commit / folder.name).exists():
            shutil.copytree(folder, keep / commit / folder.name, ignore=shutil.ignore_patterns("*.rrd"))


def main() -> int:
    """Run both checkouts, print the table, and return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("old", type=Path, nargs="?")
    parser.add_argument("new", type=Path, nargs="?")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="+", default=[])
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--run", type=Path, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.run:
        run_commands(options.run)
        return 0
    if not (options.old and options.new):
        parser.error("expected two folders, OLD and NEW")
    checkouts = [options.old.resolve(), options.new.resolve()]
    commands = [*sample_commands(checkouts[0] / "data" / "samples")]
    recorded = [*recorded_commands()]
    if not recorded:
        print(f"no recordings in {recordings('cheetah-runs')}: only the samples are compared")
    commands += recorded[:3] if options.quick else recorded
    if options.only:
        commands = needed(commands, options.only)
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        outs = [Path(folder) / name for name in ("old", "new")]
        processes = [start(*pair, keep=options.keep) for pair in zip(checkouts, [commands] * 2, outs, strict=True)]
        exit_codes = [process.wait() for process in processes]
        if any(exit_codes):
            raise SystemExit("a checkout's process ended early: see the messages above")
        if options.keep:
            for checkout, out in zip(checkouts, outs, strict=True):
                keep_results(checkout, out, options.keep)
        is_same = True
        print("| command | files | values | first difference |\n| --- | --- | --- | --- |")
        for name, _ in commands:
            old, new = (out / name for out in outs)
            compared = [compare_files(old, new, file) for file in sorted(result_files(old) | result_files(new))]
            different = [c for c in compared if c.difference]
            words = "; ".join(f"{c.file}: {c.difference}" for c in different[:2]) if compared else "no results"
            is_same &= bool(compared) and not different
            print(f"| {name} | {len(compared)} | {sum(c.values for c in compared)} | {words or 'same'} |")
    print(f"\n{'All results are the same.' if is_same else 'Results differ.'} {time.perf_counter() - began:.0f} s")
    return 0 if is_same else 1


if __name__ == "__main__":
    sys.exit(main())
