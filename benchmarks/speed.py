"""Measure the time and memory that the commands take.

    python benchmarks/speed.py [--only NAME ...] [--quick]

Results are kept in benchmarks/results/speed.json. `python benchmarks/tables.py` writes the tables of the docs.
"""

from __future__ import annotations

from question import Part, main

PARTS = {
    "clips": Part("trajectory.py", ["--only", "time"], data="cheetah-runs"),
    "kernels": Part("kernels.py", quick=["100x1"]),
    "scaling": Part("trajectory.py", ["--only", "scaling"]),
    "long": Part("long_clips.py", ["4000x1", "4000x6", "216000/120"], quick=["1000x1"]),
    "longest": Part("long_clips.py", ["100000x1"]),
    "batch": Part("batch.py", quick=["--clips", "10", "--broken", "1"]),
    "start": Part("startup.py", quick=["3"]),
    "short": Part("short.py", quick=["--runs", "2", "--clips", "5"]),
    "analyse": Part("analyse.py", ["40", "4000"], quick=["500"]),
    "pages": Part("pages.py", ["pages"], quick=["pages", "--clips", "10"]),
    "browser": Part("pages.py", ["browser"], quick=["browser", "--frames", "200", "--clips", "10"]),
    "costs": Part("pages.py", ["costs"], quick=["costs", "--runs", "1"]),
    "run": Part("pages.py", ["run"]),
    "refit": Part("refit.py", quick=["60"]),
}


if __name__ == "__main__":
    main(__doc__ or "", "speed", PARTS)
