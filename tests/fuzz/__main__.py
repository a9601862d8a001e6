"""Damage files of every kind, and check that each is read, or refused with an `InputError`.

    python -m tests.fuzz [--cases 100000] [--seed 0] [--jobs 2] [--first 0]
    python -m tests.fuzz --case 1234 --seed 0     # repeat one case with its traceback, and keep its file

The package's own writers make files of every kind. These files are damaged (`mutations.py`), and read in children with
limits of time and memory (`pool.py`). `--real` also takes files from the recordings' folder (`RECON_SHARED_DATA`, see
CONTRIBUTING.md). The script prints the outcomes by cause, and ends with 1 if a file was neither read nor refused. It
needs Unix.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")  # a process with threads cannot be forked

from tests.fuzz.corpus import seeds  # noqa: E402
from tests.fuzz.pool import case, run, run_all  # noqa: E402

ROOT = Path(__file__).resolve().parents[2]


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--cases", type=int, default=100_000)
    parser.add_argument("--first", type=int, default=0, help="the number of the first case")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--case", type=int, help="run only this case, in this process")
    parser.add_argument("--real", action="store_true", help="also damage files of the recordings")
    given = parser.parse_args()
    real = Path(os.environ.get("RECON_SHARED_DATA", ROOT.parent / "shared" / "data")) if given.real else None
    with tempfile.TemporaryDirectory(prefix="recon-fuzz-") as folder:
        start = time.monotonic()
        good = seeds(Path(folder) / "good", real)
        if given.case is not None:
            kept = Path(tempfile.mkdtemp(prefix="recon-fuzz-case-"))
            chosen, content = case(given.case, given.seed, good)
            print(f"{str(kept / chosen.name)!a}: {len(content)} bytes", flush=True)
            print(run(chosen, content, kept) or "read")
            return 0
        made_s = time.monotonic() - start
        tally = run_all(given.first, given.first + given.cases, given.seed, good, Path(folder), given.jobs)
    print(
        f"{len(good)} kinds of files, made in {made_s:.1f} s; seed {given.seed}, in {time.monotonic() - start:.0f} s:"
    )
    print(f"{tally.done:>8}  cases\n{tally.read:>8}  read\n{tally.refused:>8}  refused in words")
    failed = sum(len(cases) for cases in tally.causes.values())
    print(f"{failed:>8}  neither")
    for cause, cases in sorted(tally.causes.items(), key=lambda item: -len(item[1])):
        print(f"{len(cases):>8}    {cause} (case {cases[0]})")
    return 1 if failed or tally.done != given.cases else 0


if __name__ == "__main__":
    sys.exit(main())
