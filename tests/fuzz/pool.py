"""Run cases in children with limits of time and memory, and replace children that die."""

from __future__ import annotations

import os
import select
import shutil
import signal
import sys
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field, replace
from pathlib import Path
from random import Random

from tests.fuzz.corpus import Seed, outcome
from tests.fuzz.mutations import spoilt, spoilt_name

CASE_S = 20.0
"""Time after which a case counts as hanging, seconds, long enough for a busy machine."""
MEMORY_BYTES = 6 << 30
"""Maximum address space of a case, enough for the libraries and 4 GB more."""


@dataclass
class Tally:
    """Number of cases with each outcome."""

    done: int = 0
    read: int = 0
    refused: int = 0
    causes: dict[str, list[int]] = field(default_factory=dict)
    """Numbers that identify the failed cases, for each cause of a failure."""
    by_seed: Counter[str] = field(default_factory=Counter)

    def fail(self, cause: str, case: int) -> None:
        self.done += 1
        self.causes.setdefault(cause, []).append(case)


LINKS = ("to a file elsewhere", "over a folder", "to a folder", "dangling", "to itself", "folder")
"""Kinds of paths that are not plain files."""


def case(number: int, seed: int, good: list[Seed]) -> tuple[Seed, bytes]:
    """Choose the valid file of a case, maybe with an odd name or as a link, and damage its content."""
    random = Random(f"{seed} {number}")
    chosen = random.choices(good, [s.share for s in good])[0]
    name = spoilt_name(chosen.name, Random(f"{seed} {number} name"))
    of_link = Random(f"{seed} {number} link")
    link = of_link.choice(LINKS) if chosen.is_input and of_link.random() < 0.05 else None
    return replace(chosen, name=name, link=link), spoilt(chosen.content, chosen.suffix, random)


def run(chosen: Seed, content: bytes, folder: Path) -> str | None:
    """Read the damaged file of a case, and return its `outcome`; unexpected errors of the reader are raised."""
    path = _placed(chosen, content, folder)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return outcome(chosen, path)


def _placed(chosen: Seed, content: bytes, folder: Path) -> Path:
    """Write the damaged file of a case, and return the path to read."""
    path, elsewhere = folder / chosen.name, folder / "elsewhere"
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    path.unlink(missing_ok=True)
    elsewhere.mkdir(exist_ok=True)
    if chosen.link in ("dangling", "to itself", "to a folder"):
        path.symlink_to({"dangling": "nowhere", "to itself": path.name}.get(chosen.link, "elsewhere"))
    elif chosen.link == "folder":
        path.mkdir()
    elif chosen.link is not None:
        (elsewhere / "file").write_bytes(content)
        (folder / "over").unlink(missing_ok=True)
        (folder / "over").symlink_to("elsewhere")
        path.symlink_to(elsewhere / "file" if chosen.link == "to a file elsewhere" else Path("over", "file"))
    else:
        path.write_bytes(content)
    return path


def cause(error: BaseException) -> str:
    """Describe an error by its type and the innermost line of recon's code in its traceback."""
    ours = [f for f in traceback.extract_tb(error.__traceback__) if f"{os.sep}recon{os.sep}" in f.filename]
    where = f"{Path(ours[-1].filename).name}:{ours[-1].lineno} {ours[-1].name}" if ours else "outside"
    return f"{type(error).__name__} in {where}"


@dataclass
class _Child:
    """A child that runs the cases `first`, `first + step`, ... below `end`, and reports when each begins and ends."""

    first: int
    step: int
    end: int
    pid: int = 0
    pipe: int = -1
    left: bytes = b""
    current: int | None = None
    """Number of the last case that was started."""
    name: str = ""
    """Name of the last case that was started."""
    since: float = 0.0

    def start(self, seed: int, good: list[Seed], folder: Path) -> None:
        reading, writing = os.pipe()
        sys.stdout.flush()
        self.pid = os.fork()
        if not self.pid:
            os.close(reading)
            try:
                self._work(writing, seed, good, folder)
            finally:
                os._exit(70)
        os.close(writing)
        self.pipe, self.left, self.current, self.since = reading, b"", None, time.monotonic()

    def _work(self, writing: int, seed: int, good: list[Seed], folder: Path) -> None:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        mine = folder / f"{os.getpid()}"
        mine.mkdir(parents=True)
        os.chdir(mine)
        for number in range(self.first, self.end, self.step):
            chosen, content = case(number, seed, good)
            os.write(writing, f"{number} {chosen.name!a}\n".encode())
            try:
                answer = run(chosen, content, mine) or "read"
            except BaseException as error:
                answer = cause(error)
            os.write(writing, f"={answer}\n".encode())
        shutil.rmtree(mine, ignore_errors=True)
        os._exit(0)


def run_all(first: int, end: int, seed: int, good: list[Seed], folder: Path, jobs: int) -> Tally:
    """Run the cases from `first` to `end - 1` in children, and return the tally."""
    tally = Tally()
    children = [_Child(first + k, jobs, end) for k in range(min(jobs, end - first))]
    for child in children:
        child.start(seed, good, folder)
    while children:
        ready, _, _ = select.select([child.pipe for child in children], [], [], 1.0)
        for child in list(children):
            if child.pipe in ready:
                if _listen(child, tally):
                    continue
                status = os.waitpid(child.pid, 0)[1]
                dead = f"died ({status & 0x7F or status >> 8})" if status else None
            elif child.current is not None and time.monotonic() - child.since > CASE_S:
                os.kill(child.pid, signal.SIGKILL)
                os.waitpid(child.pid, 0)
                dead = "did not end"
            else:
                continue
            os.close(child.pipe)
            if dead is None or child.current is None:
                children.remove(child)
                if dead is not None:
                    tally.fail(dead, -1)
                continue
            tally.fail(f"{dead}: {child.name}", child.current)
            child.first = child.current + child.step
            child.start(seed, good, folder)
    return tally


def _listen(child: _Child, tally: Tally) -> bool:
    """Count the outcomes that a child has sent, and return whether the child still runs."""
    said = os.read(child.pipe, 1 << 16)
    *whole, child.left = (child.left + said).split(b"\n")
    for line in whole:
        if not line.startswith(b"="):
            number, _, child.name = line.decode().partition(" ")
            child.current, child.since = int(number), time.monotonic()
            continue
        answer = line[1:].decode()
        if answer == "read":
            tally.done, tally.read = tally.done + 1, tally.read + 1
        elif answer == "refused":
            tally.done, tally.refused = tally.done + 1, tally.refused + 1
        else:
            tally.fail(answer, child.current or 0)
    return bool(said)
