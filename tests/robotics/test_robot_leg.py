"""Compare the closed form of a leg with its chain of joints, and the inverse with the forward kinematics."""

from dataclasses import replace

import numpy as np
import pytest

from recon.robotics.leg import Leg

AIBO = Leg("swing", thigh_m=0.0695, shin_m=0.0715, knee_offset_m=0.009, foot_offset_m=-0.009)
FLAP = Leg("flap", thigh_m=0.213, shin_m=0.213, lateral_m=0.08)
GEOMETRIES = pytest.mark.parametrize("geometry", [AIBO, FLAP], ids=["swing first", "flap first"])
MIRRORS = pytest.mark.parametrize("mirror", [(1, 1, 1), (-1, 1, 1), (1, -1, 1), (-1, -1, 1)])


def random_angles(n, geometry, seed=0):
    rng = np.random.default_rng(seed)
    s0 = geometry.stretched_rad
    return np.column_stack([rng.uniform(-1.9, 1.9, n), rng.uniform(-1.5, 1.5, n), rng.uniform(s0, s0 + 3.0, n)])


@GEOMETRIES
@MIRRORS
def test_forward_of_inverse_is_the_identity(geometry, mirror):
    leg = replace(geometry, mirror=mirror)
    feet = leg.forward(random_angles(10_000, geometry))
    solution = leg.inverse(feet)
    np.testing.assert_allclose(leg.forward(solution), feet, rtol=0, atol=1e-9)
    assert (solution[:, 2] >= geometry.stretched_rad).all()


@GEOMETRIES
def test_inverse_of_forward_is_the_identity_with_the_leg_down(geometry):
    angles = random_angles(1000, geometry)
    angles[:, 0] /= 2
    angles[:, 2] = np.minimum(angles[:, 2], 1.5)
    # The flap angle is within 90 degrees of straight down, as seen from the swing joint.
    down = geometry.forward(angles * [1, 0, 1])[:, 2] < 0
    assert down.mean() > 0.9
    np.testing.assert_allclose(geometry.inverse(geometry.forward(angles))[down], angles[down], atol=1e-6)


def test_published_formulas_at_right_angles():
    # Knee at 90 degrees: P = l2 + uo, Q = l1 - lo.
    assert AIBO.forward(np.array([0.0, 0.0, np.pi / 2])) == pytest.approx([0, 0.0805, -0.0785])
    # Flapped by 90 degrees the leg points outwards.
    assert AIBO.forward(np.array([0.0, np.pi / 2, np.pi / 2])) == pytest.approx([0.0785, 0.0805, 0])
    # Swung forward by 90 degrees, the leg points forward.
    assert AIBO.forward(np.array([np.pi / 2, 0.0, np.pi / 2])) == pytest.approx([0, 0.0785, 0.0805])


def test_the_stretched_and_the_folded_leg_are_reached():
    for s in (AIBO.stretched_rad, AIBO.stretched_rad + np.pi):
        foot = AIBO.forward(np.array([0.3, 0.2, s]))
        solution = AIBO.inverse(foot)
        assert AIBO.forward(solution) == pytest.approx(foot, abs=1e-12)


@pytest.mark.parametrize(
    ("geometry", "foot"),
    [
        (AIBO, (0.0, 0.0, -0.15)),  # too far
        (AIBO, (0.0, 0.001, 0.0)),  # too near
        (AIBO, (0.13, 0.001, 0.0)),  # too close to the hip's axis
        (AIBO, (np.nan, 0.0, -0.1)),
        (FLAP, (0.08, 0.0, -0.5)),
        (replace(FLAP, thigh_m=0.2, shin_m=0.1), (0.08, 0.0, -0.05)),
        (FLAP, (0.05, 0.2, 0.0)),
    ],
)
def test_a_foot_out_of_reach_gives_nan(geometry, foot):
    assert np.isnan(geometry.inverse(foot)).all()


def test_leading_dimensions_are_kept():
    angles = random_angles(24, AIBO).reshape(2, 3, 4, 3)
    assert AIBO.inverse(AIBO.forward(angles)).shape == (2, 3, 4, 3)
