"""Compare stances, speeds, gaits and forces with measurements and exact values.

    python benchmarks/gait.py [--only NAME ...] [--quick]

Results are kept in benchmarks/results/gait.json. `python benchmarks/tables.py` writes the tables of the docs.
"""

from __future__ import annotations

from question import Part, main

PARTS = {
    "stances": Part("gait.py", data="cheetah-runs"),
    "herds": Part("herds.py"),
    "strides": Part("strides.py", ["--only", "plates"], data="plate-trials"),
    "asymmetry": Part(
        "strides.py", ["--only", "asymmetry"], quick=["--only", "asymmetry", "--quick"], data="dog-mocap"
    ),
    "speeds": Part("speeds.py", data="cheetah-runs"),
    "joined": Part("joined_cameras.py", data="cheetah-runs"),
    "flexion": Part("flexion.py", data="dog-mocap"),
    "flexion-two": Part("flexion.py", ["--cameras", "2"], data="dog-mocap"),
    "bones": Part("bone_lengths.py", data="cheetah-runs"),
    "rates": Part("trajectory.py", ["--only", "rates"], data="cheetah-runs"),
    "treadmill": Part("treadmill.py", data="dog-mocap"),
    "forces": Part("dynamics.py", data="dog-mocap"),
}


if __name__ == "__main__":
    main(__doc__ or "", "gait", PARTS)
