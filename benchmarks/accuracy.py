"""Measure the errors of poses and positions fitted from one camera.

    python benchmarks/accuracy.py [--only NAME ...] [--quick]

Results are kept in benchmarks/results/accuracy.json. `python benchmarks/tables.py` writes the tables of the docs.
"""

from __future__ import annotations

from question import Part, main

PARTS = {
    "views": Part("trajectory.py", ["--only", "accuracy"], data="cheetah-runs"),
    "ablation": Part("trajectory.py", ["--only", "ablation"], data="cheetah-runs"),
    "robustness": Part("trajectory.py", ["--only", "robustness"], data="cheetah-runs"),
    "one-camera": Part("one_camera.py", data="cheetah-runs"),
    "size": Part("trajectory.py", ["--only", "size"], data="cheetah-runs"),
    "focal": Part("focal.py", ["--only", "factors"], data="cheetah-runs"),
    "wide-lens": Part("focal.py", ["--only", "lens"], data="cheetah-runs"),
    "prior": Part("mismatch.py", data="cheetah-runs"),
    "dogs": Part("dog.py", ["--only", "accuracy"], data="dog-mocap"),
    "detectors": Part("detector_choice.py", data="cheetah-runs"),
    "detector-files": Part("detector_files.py", quick=[]),
    "bones": Part("bones.py", quick=[]),
    "starts": Part("starts.py", data="cheetah-runs"),
    "processors": Part("processors.py", quick=[]),
}


if __name__ == "__main__":
    main(__doc__ or "", "accuracy", PARTS)
