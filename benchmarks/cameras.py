"""Measure the errors of fits with several cameras, moving cameras and cameras with wrong poses.

    python benchmarks/cameras.py [--only NAME ...] [--quick]

Results are kept in benchmarks/results/cameras.json. `python benchmarks/tables.py` writes the tables of the docs.
"""

from __future__ import annotations

from question import Part, main

PARTS = {
    "several": Part("cameras.py", data="cheetah-runs"),
    "left-out": Part(
        "left_out_camera.py",
        ["--quick", "--outs", "1", "--jobs", "2"],
        quick=["--only", "rat", "--quick", "--outs", "1", "--no-anipose"],
        data="cheetah-runs",
    ),
    "pairs": Part(
        "pairs.py",
        ["--jobs", "2", "--pairs", "3", "--cameras", "two", "all", "--every"],
        quick=["--pairs", "1", "--cameras", "two", "--degrees", "3"],
        data="cheetah-runs",
    ),
    "first-turned": Part(
        "pairs.py",
        ["--jobs", "2", "--pairs", "1", "--cameras", "two", "--degrees", "3", "--turned", "first"],
        data="cheetah-runs",
    ),
    "turned-share": Part(
        "pairs.py", ["--pairs", "3", "--cameras", "two", "--degrees", "3", "--turned-share", "0.1"], data="cheetah-runs"
    ),
    "moving": Part("moving.py", data="cheetah-runs"),
    "turning": Part("camera_motion.py", data="still-videos"),
    "panning-film": Part("panning_film.py"),
    "offsets": Part("out_of_step.py", data="cheetah-runs"),
    "refined": Part("refined_cameras.py", data="cheetah-runs"),
    "refined-simulated": Part(
        "rigs.py", ["--refine", "--seeds", "1"], quick=["--refine", "--seeds", "1", "--animals", "mouse-top"]
    ),
    "extrinsics": Part("extrinsics.py", data="cheetah-runs"),
    "upward": Part("upward.py", data="cheetah-runs"),
    "agreement": Part("agreement.py", ["--only", "named"], data="cheetah-runs"),
    "wrong-camera": Part("agreement.py", ["--only", "effects"], data="cheetah-runs"),
    "boards": Part("calibration.py", quick=[]),
}


if __name__ == "__main__":
    main(__doc__ or "", "cameras", PARTS)
