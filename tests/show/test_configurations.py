"""Test positions, scales and colours in figures of configurations in the animal's own frame."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgb

from recon.animal.body import Side
from recon.animal.skeleton_file import load_skeleton
from recon.geometry.kinematics import YAW
from recon.show import plots
from recon.show.plots.configurations import composites
from recon.show.plots.style import SIDE_COLOURS
from recon.thesis.chain import load_chain

LIMBS = {"trunk": (0, 1), "near leg": (0, 2), "off leg": (0, 3)}
SIDES: dict[str, Side | None] = {"trunk": None, "near leg": "left", "off leg": "right"}
TIMES = np.linspace(1.0, 2.0, 31)


def swinging() -> np.ndarray:
    """Return points (31, 4, 3) in metres in UVW of a trunk and two legs, of which the left leg swings."""
    points = np.zeros((31, 4, 3))
    points[:, 1, 0] = 0.6
    angle = np.linspace(-0.5, 0.5, 31)
    points[:, 2] = np.stack([np.sin(angle), np.cos(angle), np.full(31, 0.2)], axis=1)
    points[:, 3] = [0.1, 0.9, -0.2]
    return points


def drawn_in(axes) -> list:
    """Return the line collections in a panel, one for each limb."""
    return [found for found in axes.collections if isinstance(found, LineCollection)]


def test_in_body_removes_position_and_heading_and_keeps_lengths():
    body, rng = load_skeleton("cheetah-24"), np.random.default_rng(0)
    states = np.zeros((5, body.n_state))
    states[:, 4:] = body.mean_rad + 0.2 * rng.standard_normal((5, len(body.mean_rad)))
    moved = states.copy()
    moved[:, :6] += rng.standard_normal((5, 6))
    moved[2] = np.nan
    points = plots.in_body(body, moved, 1.5, "spine")
    assert np.isnan(points[2]).all()
    known = [0, 1, 3, 4]
    np.testing.assert_allclose(points[known], plots.in_body(body, states, 1.5, "spine")[known], atol=1e-12)
    np.testing.assert_array_equal(points[known, body.markers.index("spine")], 0)
    there = body.tree.pose(moved[known], 1.5).points_m
    np.testing.assert_allclose(
        np.linalg.norm(points[known, 0] - points[known, -1], axis=1), np.linalg.norm(there[:, 0] - there[:, -1], axis=1)
    )
    left = plots.in_body(body, states, 1.0, "spine")[:, body.markers.index("l_hip")]
    assert (left[:, 2] > 0).all()  # W is to the left
    assert (left[:, 1] > 0).all()  # V is down
    assert (left[:, 0] < 0).all()  # U is forwards


def test_in_body_returns_the_published_local_joints_of_a_chain():
    chain = load_chain("cheetah-8u")
    rng = np.random.default_rng(1)
    state = np.zeros((4, chain.n_state))
    state[:, : 2 * chain.n_angles] = 0.4 * rng.standard_normal((4, 2 * chain.n_angles))
    state[:, chain.base_index] = 1.2 * chain.nominal_base_length_m
    body_state, size = chain.to_body(state, np.eye(4))
    body_state[:, YAW] += 0.7
    points = plots.in_body(chain.body, body_state, size, chain.joints[0])
    np.testing.assert_allclose(points, chain.local_joints(state), atol=1e-12)


def test_three_views_at_one_scale():
    points = swinging()
    side, front, top = plots.body_fixed(points, LIMBS, TIMES, SIDES).axes
    for axes, (i, j) in ((side, (0, 1)), (front, (2, 1)), (top, (0, 2))):
        drawn = [path for lines in drawn_in(axes) for path in lines.get_segments()]
        assert len(drawn) == 10 * len(LIMBS)
        np.testing.assert_allclose(drawn[10], points[0, [0, 2]][:, [i, j]])
        np.testing.assert_allclose(drawn[19], points[-1, [0, 2]][:, [i, j]])
        assert axes.get_aspect() == 1.0
    mm_per_m = [axes.get_window_extent().width / np.ptp(axes.get_xlim()) for axes in (side, front, top)]
    np.testing.assert_allclose(mm_per_m, mm_per_m[0])
    low, high = side.get_ylim()
    assert low > high  # V points down


def test_left_and_right_have_their_colours_full_at_the_end_and_pale_at_the_beginning():
    side = plots.body_fixed(swinging(), LIMBS, TIMES, SIDES).axes[0]
    colours = np.array([[to_rgb(colour) for colour in lines.get_colors()] for lines in drawn_in(side)])
    for of_limb, name in zip(colours, LIMBS, strict=True):
        np.testing.assert_allclose(of_limb[-1], to_rgb(SIDE_COLOURS[SIDES[name]]))
        assert (np.diff(of_limb.sum(axis=1)) < 0).all()


def test_the_animal_is_drawn_large():
    """The animal is at least ten centimetres long on a page in the side view."""
    side = plots.body_fixed(swinging(), LIMBS, TIMES, SIDES).axes[0]
    assert side.get_window_extent().width / side.figure.dpi * 25.4 > 100


def test_without_a_pose_nothing_is_drawn():
    figure = plots.body_fixed(np.full((5, 4, 3), np.nan), LIMBS, TIMES[:5], SIDES)
    texts = [text.get_text() for artist in (figure, *figure.axes) for text in artist.texts]
    assert "no data" in texts


@pytest.mark.parametrize(
    "drift_m",
    [
        (9, 0, 20),
        (9, 30, 0),
        *(pytest.param(drift, marks=pytest.mark.slow) for drift in ((0, 0, 0), (0.1, 0, 8), (90, 0, 3))),
    ],
)
def test_no_pose_is_cut_wherever_the_animal_goes(small_trajectory, drift_m):
    """Poses are not cut even if the animal climbs or runs off to the side, as in unusable clips."""
    joints_m = small_trajectory.upright.xyz_m + np.linspace(0, 1, 8)[:, None, None] * np.array(drift_m)
    figure = composites(joints_m, small_trajectory.limbs, small_trajectory.time_s)
    figure.draw_without_rendering()
    for axes in figure.axes[:3]:
        drawn = np.concatenate([line.get_xydata() for line in axes.lines])
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        assert left <= drawn[:, 0].min()
        assert drawn[:, 0].max() <= right
        assert low <= drawn[:, 1].min()
        assert drawn[:, 1].max() <= high
    heights = [axes.get_position().height for axes in figure.axes[:3]]
    assert heights[2] <= max(1.1 * heights[0], 30 / 90)  # the side view is the largest
