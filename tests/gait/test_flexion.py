"""Test anatomical joint angles: signs, curves over the stride, bands, and the table `[anatomy]` in skeleton files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from recon.animal.anatomy import FLEXES_CAUDALLY
from recon.animal.flexion import flexion_by_angles, flexion_rad
from recon.animal.skeleton_file import builtin_names, load_skeleton
from recon.api.clip_results import problem_of
from recon.base.errors import InputError
from recon.fit.motion import Motion
from recon.fit.sampling import draws
from recon.gait.clip import ClipAnalysis
from recon.gait.flexion import MIN_STRIDES, MODEL_RAD, PERCENT, StrideCurve, extreme, joint_flexions
from recon.io.positions import read_pose3d
from recon.show.plots.flexion import joint_flexion as draw
from recon.show.tables import joint_flexion, joint_flexion_stride, vector_field
from recon.testing.steady_gait import GALLOP, TROT, with_exact_states

SAMPLES = Path(__file__).parents[2] / "data" / "samples"
BODY = load_skeleton("cheetah-24")


@pytest.fixture(scope="module")
def fitted(whole_results) -> Motion:
    return Motion.load(whole_results)


def states(**angles: float) -> np.ndarray:
    """Return a state of the cheetah in which all angles are 0 except the given ones."""
    row = np.zeros(len(BODY.state_names))
    for name, angle in angles.items():
        row[BODY.state_names.index(name)] = angle
    return row[None]


def of(name: str, row: np.ndarray) -> float:
    return float(np.degrees(flexion_rad(BODY, row)[[*BODY.anatomy].index(name), 0]))


@pytest.mark.parametrize("name", builtin_names())
def test_every_built_in_skeleton_has_an_anatomy(name):
    body = load_skeleton(name)
    assert body.anatomy
    assert all(marker in body.markers for markers in body.anatomy.values() for marker in markers)


@pytest.mark.parametrize(
    ("joint", "angle"),
    [
        ("left_elbow", "l_fore_lower_pitch"),
        ("right_carpus", "r_fore_foot_pitch"),
        ("left_stifle", "l_hind_shin_pitch"),
        ("right_hock", "r_hind_foot_pitch"),
        ("spine", "front_trunk_pitch"),
    ],
)
def test_a_straight_joint_has_0_degrees_and_flexes_to_its_side(joint, angle):
    """A straight joint has a flexion of 0 degrees and flexes to its anatomical side.

    A positive pitch turns a hanging segment backwards, and lowers the front of a segment that points forwards.
    """
    if joint in ("right_carpus", "right_hock"):  # the first marker of these joints is not on the axis of the bone
        assert of(joint, states()) == pytest.approx(0.0, abs=1e-6)
    sign = FLEXES_CAUDALLY[joint.split("_")[-1]]
    for degrees in (30.0, -20.0):
        change = of(joint, states(**{angle: np.radians(degrees)})) - of(joint, states())
        assert change == pytest.approx(sign * degrees, abs=1e-6)


def test_flexion_does_not_change_with_heading_roll_and_position():
    row = states(l_hind_shin_pitch=1.0, l_hind_thigh_pitch=-0.5)
    moved = row.copy()
    moved[:, :6] = 3.0, -2.0, 0.5, 1.2, 0.3, -0.4
    assert flexion_rad(BODY, moved) == pytest.approx(flexion_rad(BODY, row), abs=1e-9)


@pytest.mark.parametrize("name", ["cheetah-24", "horse-22"])
def test_the_derivatives_of_a_flexion_agree_with_central_differences(name):
    body, size, step = load_skeleton(name), 1.3, 1e-5
    rows = np.random.default_rng(0).normal(0.0, 0.4, (5, len(body.state_names)))
    derivatives = flexion_by_angles(body, rows, size)
    for k, shift in enumerate(step * np.eye(len(body.state_names))[3:]):
        change = flexion_rad(body, rows + shift, size) - flexion_rad(body, rows - shift, size)
        expected = (np.mod(change + np.pi, 2 * np.pi) - np.pi) / (2 * step)
        np.testing.assert_allclose(derivatives[:, :, k].T, expected, atol=1e-6)
    assert np.abs(derivatives).max() > 0.9


def test_the_uncertainty_of_a_flexion_is_the_spread_of_draws_from_the_posterior(fitted, whole_results):
    """The elbow follows from two angles, whose errors are correlated."""
    stated = np.median(fitted.solution.flexion_sigma_rad, axis=0)
    states = np.stack([draw.states for draw in draws(problem_of(fitted, whole_results), fitted.solution, 400)])
    flexions = np.unwrap(np.array([flexion_rad(BODY, rows) for rows in states]), axis=0)
    spread = np.median(flexions.std(axis=0), axis=1)
    np.testing.assert_allclose(stated, spread, rtol=0.15)
    unknown = replace(fitted, solution=replace(fitted.solution, flexion_sigma_rad=None))
    sigmas, independent = ({f.name: np.median(f.sigma_rad) for f in joint_flexions(m)} for m in (fitted, unknown))
    np.testing.assert_allclose([*sigmas.values()], np.hypot(stated, MODEL_RAD), rtol=0.05)
    assert independent["left_elbow"] < 0.9 * sigmas["left_elbow"]
    assert independent["left_hock"] == pytest.approx(sigmas["left_hock"], rel=1e-3)


@pytest.mark.parametrize("gait", [GALLOP, pytest.param(TROT, marks=pytest.mark.slow)])
def test_curves_over_the_stride_agree_with_the_gait(fitted, gait):
    fps = len(fitted.frames) / (3.5 * gait.stride_s)
    motion = with_exact_states(fitted, gait.states(BODY, fitted.frames / fps), fps)
    analysis = ClipAnalysis(motion)
    curves = {f"{curve.side}_{curve.joint}" if curve.side else curve.joint: curve for curve in analysis.flexion_curves}
    assert set(curves) == set(BODY.anatomy)
    for name, curve in curves.items():
        begin_s = gait.landings[curve.foot] * gait.stride_s
        truth = flexion_rad(BODY, gait.states(BODY, begin_s + PERCENT / 100 * gait.stride_s))
        off = np.degrees(curve.mean_rad - truth[[*BODY.anatomy].index(name)])
        assert np.sqrt(np.mean(off**2)) < 6.0, name
        assert curve.duty_factor == pytest.approx(gait.duty_factor, abs=0.05)
        assert np.degrees(np.nanmax(curve.between_sigma_rad)) < 6.0
        assert np.degrees(curve.posterior_sigma_rad).max() == pytest.approx(5.0, abs=0.1)
        greatest = extreme(curve)
        true = truth[[*BODY.anatomy].index(name)]
        assert abs(greatest.value_rad - true.max()) < 1.645 * greatest.sigma_rad
        if np.isfinite(greatest.percent_high):
            before, after = greatest.percent_low - 1, greatest.percent_high + 1
            assert any(before <= np.argmax(true) + turn <= after for turn in (-100, 0, 100))


@pytest.mark.parametrize("count", [3, 6])
def test_the_band_between_strides_contains_nine_of_ten_further_strides(count):
    strides = np.random.default_rng(0).normal(size=(count + 1, 20_000))
    mean, sigma = strides[:-1].mean(axis=0), strides[:-1].std(axis=0, ddof=1)
    curve = StrideCurve("elbow", "left", "LF", mean, 0 * mean, sigma, count, 0.3)
    inside = np.abs(strides[-1] - mean) < curve.between_reach_rad
    assert inside.mean() == pytest.approx(0.9, abs=0.01)
    assert np.isnan(replace(curve, strides=2).between_reach_rad).all()


def test_the_phase_of_a_peak_may_lie_around_touch_down():
    phase = 2 * np.pi * (PERCENT - 2) / 100
    sigma = np.full(101, 0.01)
    curve = StrideCurve("elbow", "left", "LF", np.cos(phase), sigma, np.full(101, np.nan), 1, 0.3)
    greatest, least = extreme(curve), extreme(curve, -1)
    assert (greatest.percent, least.percent) == (2, 52)
    reach = np.arccos(1 - 1.645 * np.sqrt(2) * 0.01) / (2 * np.pi) * 100
    assert (greatest.percent_low, greatest.percent_high) == (np.ceil(2 - reach), np.floor(2 + reach))
    assert greatest.percent_low < 0
    flat = extreme(replace(curve, mean_rad=0.01 * np.cos(phase)))
    assert np.isnan(flat.percent_low)


def test_bands_contain_the_truth_of_the_sample(fitted):
    truth = read_pose3d(SAMPLES / "whole_truth.csv")
    points_m = truth.xyz_m[:, [truth.names.index(name) for name in fitted.names]]
    inside = []
    for flexion, markers in zip(joint_flexions(fitted), BODY.anatomy.values(), strict=True):
        first, middle, last = (points_m[:, fitted.names.index(marker)] for marker in markers)
        up, down = middle - first, last - middle
        straight = np.sum(up * down, axis=1) / np.linalg.norm(up, axis=1) / np.linalg.norm(down, axis=1)
        # The true angle in space nearly equals the angle in the sagittal plane.
        off = np.arccos(np.cos(flexion.angle_rad)) - np.arccos(straight)
        inside.append(np.abs(off) < 1.645 * flexion.sigma_rad)
    assert 0.85 < np.mean(inside) <= 1.0


def test_tables_have_every_frame_and_every_percent(fitted):
    analysis = ClipAnalysis(fitted)
    by_frame = pd.DataFrame(joint_flexion(analysis))
    assert [*by_frame][:4] == ["frame", "time_s", "left_shoulder_deg", "left_shoulder_sigma_deg"]
    assert len(by_frame) == len(fitted.frames)
    by_percent = pd.DataFrame(joint_flexion_stride(analysis))
    assert (by_percent.groupby(["joint", "side"])["percent"].agg(["min", "max", "count"]) == [0, 100, 101]).all(
        axis=None
    )
    assert (by_percent["posterior_low_deg"] < by_percent["flexion_deg"]).all()
    several = by_percent["strides"] >= MIN_STRIDES
    assert 0 < several.mean() < 1
    assert (by_percent["between_strides_low_deg"].isna() == ~several).all()


def test_without_a_stride_a_table_has_its_columns(fitted):
    """A table without a stride still has its columns, so that programs find them."""
    empty = SimpleNamespace(flexion_curves=(), fields={})
    assert [*joint_flexion_stride(empty)] == [*joint_flexion_stride(ClipAnalysis(fitted))]
    assert [*vector_field(empty)] == [*vector_field(ClipAnalysis(fitted))]
    assert not len(pd.DataFrame(joint_flexion_stride(empty)))


def test_the_figure_names_joints_strides_and_bands(fitted):
    figure = draw(ClipAnalysis(fitted).flexion_curves)
    titles = [axes.get_title("left") for axes in figure.axes]
    assert titles[:8] == ["shoulder", "elbow", "carpus", "hip", "stifle", "hock", "spine", "neck"]
    legend = [text.get_text() for text in figure.legends[0].get_texts()]
    assert any(text.startswith("left, ") and text.endswith("strides") for text in legend)
    assert {"90 % of further strides", "90 % from the fit's uncertainty", "bars: stance"} <= {*legend}
    assert not draw(()).axes


def test_a_clip_without_strides_has_angles_and_no_curves(fitted):
    short = replace(ClipAnalysis(fitted).gait, strides=())
    from recon.gait.flexion import stride_curves

    assert stride_curves(joint_flexions(fitted), short, fitted.time_s) == ()
    assert stride_curves(joint_flexions(fitted), None, fitted.time_s) == ()


@pytest.mark.parametrize(
    ("line", "field", "expected"),
    [
        ('knee = ["l_hip", "l_back_knee", "l_back_ankle"]', "anatomy.knee", "one of shoulder, elbow"),
        ('hock = ["l_hip", "l_hip", "l_back_ankle"]', "anatomy.hock", "three different markers"),
        ('hock = ["l_hip", "l_back_ankle", "l_toe"]', "anatomy.hock", "l_toe"),
    ],
)
def test_an_anatomy_that_cannot_be_used_is_named(tmp_path, line, field, expected):
    text = (Path(load_skeleton.__globals__["__file__"]).parent / "skeletons" / "cheetah-24.toml").read_text("utf-8")
    path = tmp_path / "mine.toml"
    path.write_text(text.partition("[anatomy]")[0] + f"[anatomy]\n{line}\n", encoding="utf-8")
    with pytest.raises(InputError) as error:
        load_skeleton(path)
    assert field in str(error.value)
    assert expected in str(error.value)
