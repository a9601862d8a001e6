"""Test whether the stated uncertainties and the verdict are right.

    python benchmarks/uncertainty.py [--only NAME ...] [--quick]

Results are kept in benchmarks/results/uncertainty.json. `python benchmarks/tables.py` writes the tables of the docs.
"""

from __future__ import annotations

from question import Part, main

PARTS = {
    "stated": Part("stated_errors.py", data="cheetah-runs"),
    "regions": Part("regions.py", data="cheetah-runs"),
    "verdict": Part("verdict.py", ["--jobs", "2"], data="cheetah-runs"),
    "simulated": Part("simulated_coverage.py", quick=["--clips", "4"]),
    "simulated-dogs": Part("simulated_coverage.py", ["--skeleton", "dog-27"]),
    "recorded-dogs": Part("simulated_coverage.py", ["--recorded", "dog"], data="dog-mocap"),
    "drafted": Part("drafted_coverage.py", quick=["--clips", "1", "--cameras", "2"], data="rat-poses"),
    "rat": Part("drafted_coverage.py", ["--only", "rat", "--skeleton", "rat"], data="rat-poses"),
    "recorded-cheetahs": Part("simulated_coverage.py", ["--recorded", "cheetah"], data="cheetah-runs"),
    "proportions": Part(
        "rigs.py", ["--seeds", "3"], quick=["--seeds", "1", "--animals", "mouse-top", "--cameras", "4"]
    ),
    "views": Part("trajectory.py", ["--only", "uncertainty"], data="cheetah-runs"),
}


if __name__ == "__main__":
    main(__doc__ or "", "uncertainty", PARTS)
