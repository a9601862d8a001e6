"""Test draws of a motion, its figure, self-describing settings, and the documented residual of a user."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import refusal

import recon

PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "own-residual.md"


@pytest.fixture(scope="module")
def motion(whole_results: Path) -> recon.Motion:
    return recon.Motion.load(whole_results)


def test_draws_spread_as_the_motion_states(motion: recon.Motion):
    draws_m = motion.sample(40, seed=1)
    assert draws_m.shape == (40, *motion.joints_m.shape)
    np.testing.assert_array_equal(draws_m[:2], motion.sample(40, seed=1)[:2])
    ratio = draws_m.std(axis=0).mean() / motion.upright_sigma_m.mean()
    assert 0.7 < ratio < 1.3
    for n in (0, -1, 2.5, True):
        with refusal(("sample", "n", repr(n), "whole number above 0")):
            motion.sample(n)  # pyright: ignore[reportArgumentType]


def test_residual_of_the_docs_pulls_towards_the_measurement(motion: recon.Motion, tmp_path: Path, monkeypatch):
    (code,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    (tmp_path / "results" / "clip").mkdir(parents=True)
    motion.save(tmp_path / "results" / "clip")
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(code.replace("sample(400)", "sample(60)"), names)
    trunk_m, weight = names["trunk_m"], names["weight"]
    before, after = (abs(value - 0.70) for value in (trunk_m.mean(), weight @ trunk_m))
    assert after < before
    assert 1 <= names["effective"] <= 60
    assert (names["sigma_m"] >= 0).all()


def test_the_figure_has_an_axes_for_the_poses(motion: recon.Motion):
    figure = motion.plot()
    assert any(axes.lines or axes.collections for axes in figure.axes)


def test_settings_have_a_signature_with_kinds_and_units():
    parameters = inspect.signature(recon.FitSettings).parameters
    assert parameters["keypoints"].default is inspect.Parameter.empty
    assert parameters["fps"].annotation == "float, Hz"
    assert parameters["belt_speed_m_s"].annotation == "float, m/s"
    assert parameters["camera"].annotation == "path or list of paths"
    assert parameters["ground"].annotation == "'auto' | 'none'"
    assert parameters["ground"].default == "auto"
    assert parameters["playback"].annotation == "bool | 'auto'"
