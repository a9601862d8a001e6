"""Test which wrong inputs the findings of a fit name.

    python benchmarks/wrong_inputs.py [--only NAME ...] [--quick]

Results are kept in benchmarks/results/wrong_inputs.json. `python benchmarks/tables.py` writes the tables of the docs.
"""

from __future__ import annotations

from question import Part, main

PARTS = {
    "inputs": Part("wrong_inputs.py", ["--views", "6", "--findings"], data="cheetah-runs"),
    "inputs-fifth": Part("wrong_inputs.py", ["--views", "5"], data="cheetah-runs"),
    "true-camera": Part("true_camera.py", ["--views", "6"], data="cheetah-runs"),
    "right": Part("wrong_inputs.py", ["--views", "3", "--cases", "right:"], data="cheetah-runs"),
    "lens": Part("wrong_inputs.py", ["--views", "5", "--cases", "focal,anamorphic,letterboxed"], data="cheetah-runs"),
    "standing": Part("standing.py", data="dog-mocap"),
    "zoom": Part("wrong_inputs.py", ["--cases", "zooms x"], data="cheetah-runs"),
    "which-camera": Part("which_camera.py", data="cheetah-runs"),
    "limits": Part("one_step_limits.py", ["--views", "6"], data="cheetah-runs"),
    "input-limits": Part("input_limits.py", data="cheetah-runs"),
    "audit": Part("audit.py", data="cheetah-runs"),
    "planted-faults": Part("planted_faults.py", quick=["--seeds", "1"]),
    "editor-trial": Part("editor_trial.py"),
    "ranking": Part("correction_order.py", quick=["--quick"], data="cheetah-runs"),
    "swaps": Part("left_right_swaps.py", data="cheetah-runs"),
    "swap-folds": Part("left_right_swaps.py", ["--folds"], data="cheetah-runs"),
    "swaps-several": Part("swaps_of_several.py", data="cheetah-runs"),
    "swaps-others": Part("left_right_swaps.py", ["--others"], data="dog-mocap"),
}


if __name__ == "__main__":
    main(__doc__ or "", "wrong_inputs", PARTS)
