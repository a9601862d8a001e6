"""Kill processes while they put results in place, and check that no mixture of two runs is taken for results.

    python tests/fuzz/kills.py [--count 200] [--seed 0]

One child after the other replaces the results of one fit by the results of another fit. Each child is killed before or
after one of its steps, or at a random time during the steps. The folder that it leaves must be refused, or be one of
the two results to the last byte, and the next child must be able to write. The script prints the number of each
outcome, and ends with 1 if there was a mixture.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from recon import FitSettings, InputError
from recon.api.clip_results import run_clip
from recon.base.outputs import RECORD, Output
from recon.fit.motion import Motion

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "samples"
STEPS = ("mkdir", "replace", "link", "unlink")
"""Functions of `os` that put results in place, before they clean up."""


def contents(folder: Path) -> dict[str, bytes]:
    """Return the content of each results file, without the hidden files that a killed process leaves."""
    return {p.name: p.read_bytes() for p in folder.iterdir() if p.is_file() and not p.name.startswith(".recon")}


def replaced(source: Path, out: Path, step: Callable[[], None]) -> None:
    """Write the results of `source` into `out`.

    `step` is called before and after every change of the folder, from the first visible change on.
    """
    with Output(out, "fit", overwrite=True, has_manifest=True).staged() as staging:
        for path in source.iterdir():
            if path.name not in ("manifest.json", RECORD):
                shutil.copyfile(path, staging / path.name)
        for name in STEPS:
            setattr(os, name, _with_steps(getattr(os, name), step))


def _with_steps(function: Callable[..., Any], step: Callable[[], None]) -> Callable[..., Any]:
    def stepping(*args: Any, **kwargs: Any) -> Any:
        step()
        result = function(*args, **kwargs)
        step()
        return result

    return stepping


def killed(source: Path, out: Path, after_steps: int | None, after_s: float) -> bool:
    """Replace results in a child that is killed after some steps or seconds, and return whether it was killed.

    With `after_steps` the child kills itself; otherwise this process kills it after `after_s` seconds.
    """
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        done = 0

        def step() -> None:
            nonlocal done
            os.write(writer, b"." * (done == 0))
            if done == after_steps:
                os.kill(os.getpid(), signal.SIGKILL)
            done += 1

        code = 1
        try:
            replaced(source, out, step)
            code = 0
        finally:
            os._exit(code)
    os.close(writer)
    os.read(reader, 1)
    os.close(reader)
    if after_steps is None:
        time.sleep(after_s)
        os.kill(child, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    assert code in (0, -signal.SIGKILL), f"exit code {code}"
    return code != 0


def found(out: Path, known: list[dict[str, bytes]]) -> str:
    """Return which results are in a folder: the old or the new ones, a mixture, or results that are refused."""
    try:
        Motion.load(out)
    except InputError:
        return "refused"
    there = contents(out)
    return ("the old ones", "the new ones")[known.index(there)] if there in known else "a MIXTURE"


def check(sources: list[Path], out: Path, count: int, rng: random.Random) -> Counter[str]:
    """Kill children that replace one of two results by the other, and count what the folders then hold."""
    known = [contents(source) for source in sources]
    steps, seconds = _all_steps(sources[1], out)
    counts: Counter[str] = Counter()
    while counts.total() < count:
        replaced_by_us(sources[0], out)
        assert found(out, known) == "the old ones"
        after_steps = rng.randrange(steps) if rng.random() < 0.5 else None
        if killed(sources[1], out, after_steps, rng.uniform(0, seconds)):
            what = found(out, known)
            counts[what] += 1
            if "MIXTURE" in what:
                print(f"{what}: after {after_steps} steps: {sorted(contents(out))}", flush=True)
    return counts


def replaced_by_us(source: Path, out: Path) -> None:
    """Replace the files that a killed child has left, in this process."""
    with Output(out, "fit", overwrite=True, has_manifest=True).staged() as staging:
        for path in source.iterdir():
            if path.name not in ("manifest.json", RECORD):
                shutil.copyfile(path, staging / path.name)
    assert not [path.name for path in out.iterdir() if path.name.startswith(".recon-")]


def _all_steps(source: Path, out: Path) -> tuple[int, float]:
    """Replace results without a kill, and return the number of steps and their duration, seconds."""
    replaced_by_us(source, out)
    kept = {name: getattr(os, name) for name in STEPS}
    times: list[float] = []
    try:
        replaced(source, out, lambda: times.append(time.perf_counter()))
    finally:
        for name, function in kept.items():
            setattr(os, name, function)
    return len(times), times[-1] - times[0]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        sources = [Path(name) / fit for fit in ("first", "second")]
        for source, method in zip(sources, ("trajectory", "frame"), strict=True):
            settings = FitSettings(
                keypoints=SAMPLES / "whole.csv", camera=SAMPLES / "camera.toml", fps=60, frames="0:8", method=method
            )
            run_clip(settings, source)
        counts = check(sources, Path(name) / "out", given.count, random.Random(given.seed))
    print(", ".join(f"{what} {count}" for what, count in counts.items()))
    sys.exit(any("MIXTURE" in what for what in counts))


if __name__ == "__main__":
    main()
