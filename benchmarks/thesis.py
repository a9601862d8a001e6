"""Measure the accuracy and the speed of the frame method and of inverse kinematics.

    python benchmarks/thesis.py [--only NAME ...] [--quick]

Results are kept in benchmarks/results/thesis.json. `python benchmarks/tables.py` writes the tables of the docs.
"""

from __future__ import annotations

from question import Part, main

PARTS = {
    "views": Part("cheetah_runs.py", data="cheetah-runs"),
    "frame": Part("frame_method.py", quick=["--quick"], data="cheetah-runs"),
    "path-numbers": Part("path_numbers.py", data="cheetah-runs"),
    "path-ties": Part("path_ties.py", data="cheetah-runs"),
    "objectives": Part("frame_objectives.py", data="cheetah-runs"),
    "gallop": Part("sample_gallop.py", quick=[]),
    "ik-steps": Part("ik.py", ["--only", "steps"]),
    "ik-targets": Part("ik.py", ["--only", "targets"]),
    "ik-alphas": Part("ik.py", ["--only", "alphas"], quick=["--only", "alphas"]),
    "ik-circle": Part("ik.py", ["--only", "circle"], quick=["--only", "circle"]),
    "ik-costs": Part("ik.py", ["--only", "costs"]),
    "ik-strides": Part("ik.py", ["--only", "strides"], data="cheetah-runs"),
    "ik-fits": Part("ik.py", ["--only", "fits"], data="cheetah-runs"),
    "ik-held-out": Part("ik.py", ["--only", "held-out"], data="cheetah-runs"),
    "ik-online": Part("ik.py", ["--only", "online"], data="cheetah-runs"),
}


if __name__ == "__main__":
    main(__doc__ or "", "thesis", PARTS)
