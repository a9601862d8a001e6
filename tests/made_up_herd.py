"""Make the results of an experiment from copies of one result, with made-up numbers instead of an analysis."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from recon.api.compare import QUANTITIES
from recon.fit.motion import Motion

DESIGN = """\
clip,animal,run,camera,group
anna-1-left,anna,1,left,control
anna-1-right,anna,1,right,control
anna-2-left,anna,2,left,control
ben-1-left,ben,1,left,control
carl-1-left,carl,1,left,control
dora-1-left,dora,1,left,treated
emil-1-left,emil,1,left,treated
frida-1-left,frida,1,left,treated
"""
CLIPS = [line.split(",")[0] for line in DESIGN.splitlines()[1:]]
STRIDES = 4
SPEEDS = dict(zip(CLIPS, (4.0, 4.2, 4.4, 4.5, 3.7, 4.0, 4.6, 4.9), strict=True))
"""Speed of each clip, m/s."""


def make_herd(folder: Path, results: Path) -> None:
    """Copy the motion of one result into a folder for each clip of the herd."""
    for clip in CLIPS:
        (folder / clip).mkdir(parents=True)
        shutil.copy(results / "motion.npz", folder / clip)


def use_made_up_numbers(patch: pytest.MonkeyPatch) -> None:
    """Let `recon compare` use made-up numbers, in the order of the clips, instead of analysing them."""
    order: list[Motion] = []

    def analysed(motion: Motion) -> str:
        order.append(motion)
        return CLIPS[(len(order) - 1) % len(CLIPS)]

    patch.setattr("recon.api.compare.analyse", analysed)
    patch.setattr("recon.api.compare._is_one_run", lambda *motions_and_files: False)
    patch.setattr("recon.api.compare._stride_rows", stride_rows)
    patch.setattr("recon.api.compare._clip_row", clip_row)


def quantities_of(clip: str) -> dict[str, float]:
    speed = SPEEDS[clip]
    length = 1.0 + 0.3 * speed + (0.2 if clip.split("-")[0] in ("dora", "emil", "frida") else 0.0)
    length += 0.03 * np.sin(sum(map(ord, clip)))
    return {"speed_m_s": speed, "stride_length_m": length, "stride_frequency_hz": speed / length, "duty_factor": 0.3}


def stride_rows(clip: str) -> Iterator[dict]:
    for stride in range(STRIDES):
        deviation = 1 + 0.02 * np.sin(stride + len(clip))
        yield {"foot": "LH", "start_s": 0.3 * stride} | {n: v * deviation for n, v in quantities_of(clip).items()}


def clip_row(clip: str, strides: list[dict]) -> dict:
    row: dict[str, object] = {"strides": len(strides), "size_sigma": 0.05}
    for name, value in quantities_of(clip).items():
        own = 0.02 * value
        row |= {name: value, f"{name}_sigma": np.hypot(own, 0.05 * value if QUANTITIES[name][1] else 0.0)}
        row |= {f"{name}_own_sigma": own, f"{name}_measurement_sigma": 0.9 * own, f"{name}_source": "footfalls"}
    return row
