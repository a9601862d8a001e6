"""Measure the accuracy and the speed of the keypoint network.

    python benchmarks/net.py [--only NAME ...] [--quick]

Results are kept in benchmarks/results/net.json. `python benchmarks/tables.py` writes the tables of the docs.
"""

from __future__ import annotations

from question import Part, main

PARTS = {
    "circle": Part("net.py", ["circle"]),
    "labels": Part("net.py", ["labels", "--steps", "1000"]),
    "large": Part("net.py", ["large"]),
    "horse": Part("net.py", ["horse"], data="horse-side"),
    "speed": Part("net.py", ["speed"]),
}


if __name__ == "__main__":
    main(__doc__ or "", "net", PARTS)
