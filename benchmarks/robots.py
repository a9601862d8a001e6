"""Measure how well robots follow a motion, and how well they climb.

    python benchmarks/robots.py [--only NAME ...] [--quick]

Results are kept in benchmarks/results/robots.json. `python benchmarks/tables.py` writes the tables of the docs.
"""

from __future__ import annotations

from question import Part, main

PARTS = {
    "retarget": Part("retarget.py", data="cheetah-runs"),
    "climb": Part("climb.py", quick=[]),
}


if __name__ == "__main__":
    main(__doc__ or "", "robots", PARTS)
