"""Test that every figure is drawn in one style, and that its edges cut off no text.

`test_clip_analysis.py` tests the figures of an analysis.
"""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from figure_texts import cut_off

from recon.animal.skeleton_file import load_skeleton
from recon.api.compare import QUANTITIES, _figure
from recon.calibrate.camera_advice import AZIMUTHS_RAD, ELEVATIONS_RAD, Advice
from recon.gait.clip import ClipAnalysis
from recon.show.plots import style
from recon.show.plots.cameras import camera_advice
from recon.show.plots.configurations import angle_ranges, views
from recon.show.plots.flexion import joint_flexion
from recon.show.plots.over_time import footfall, speeds

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def whole(whole_analysis: ClipAnalysis) -> ClipAnalysis:
    return whole_analysis


def test_a_text_that_is_cut_off_is_found():
    with style.drawing(40.0) as figure:
        figure.subplots()
        figure.text(0.9, 0.5, "much too long for what is left of the figure")
    assert cut_off(figure) == ["much too long for what is left of the figure"]


def test_figures_of_several_clips_and_of_the_page_have_all_their_text(whole):
    moved = {name: whole.joints[name] for name in ("spine", "l_front_paw", "nose")}
    motion = whole.motion
    figures = {
        "speeds": speeds(moved, "three joints"),
        "narrow speeds": speeds(moved, width_mm=style.COLUMN_MM),
        "gaits": footfall({"by one camera": whole.gait, "by another camera": whole.gait}, motion.fps, "two gaits"),
        "flexion of some": joint_flexion(whole.flexion_curves[:4], "four joints"),
    }
    assert {name: texts for name, figure in figures.items() if (texts := cut_off(figure))} == {}


@pytest.mark.parametrize(
    "name",
    ["cheetah-24", *(pytest.param(name, marks=pytest.mark.slow) for name in ("dog-27", "human-25", "mouse-top"))],
)
def test_figures_of_skeletons_have_all_their_text(name):
    body = load_skeleton(name)
    assert cut_off(views(body, body.title)) == []
    assert cut_off(angle_ranges(body, 2.0, "two standard deviations")) == []


def test_the_advice_on_cameras_has_all_its_text():
    shape = len(ELEVATIONS_RAD), len(AZIMUTHS_RAD)
    fraction = np.linspace(0, 1, shape[0] * shape[1]).reshape(shape)
    advice = Advice("front_trunk_yaw", "rad", 6.9, 0.3 - 0.2 * fraction, fraction)
    beside = Advice("front_trunk_yaw", "rad", 6.9, 0.3 - 0.2 * fraction, fraction, (0.0, 0.5))
    assert cut_off(camera_advice([advice, beside])) == []


@pytest.mark.parametrize(
    "scale", [1234.5, *(pytest.param(scale, marks=pytest.mark.slow) for scale in (1e-3, 1.0, 12.0))]
)
def test_a_comparison_has_all_its_text(scale):
    groups = ["a", "a group with a long name", "c", "d"]
    rng = np.random.default_rng(0)
    rows = [
        {"group": group, **{name: scale * (1 + 0.01 * rng.random()) for name in QUANTITIES}} for group in groups * 2
    ]
    rows = [row | {f"{name}_sigma": 0.05 * scale for name in QUANTITIES} for row in rows]
    clips = pd.DataFrame(rows)
    assert cut_off(_figure(clips, clips.iloc[: len(groups)])) == []


def test_figures_are_drawn_and_saved_by_the_style_alone():
    """Only `recon.show.plots.style` draws and saves figures, so that all have ticks of the same size."""
    strangers = []
    for path in sorted((ROOT / "recon").rglob("*.py")):
        if path.name == "style.py" and path.parent.name == "plots":
            continue
        text = path.read_text(encoding="utf-8")
        if "savefig" not in text and "Figure(" not in text:
            continue
        for node in ast.walk(ast.parse(text)):
            called = node.func if isinstance(node, ast.Call) else None
            name = (
                called.attr if isinstance(called, ast.Attribute) else called.id if isinstance(called, ast.Name) else ""
            )
            if name in ("savefig", "Figure"):
                strangers.append(f"{path.relative_to(ROOT)}:{node.lineno}: {name}")
    assert strangers == []
