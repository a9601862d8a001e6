"""Test the built-in robots, and files of other robots."""

import numpy as np
import pytest
from command_line import refusal

from recon import InputError
from recon.robotics.quadruped import LEGS, builtin_robots, load_robot

AIBO = """
name = "mine"
title = "mine"
stand_m = 0.11
[leg]
first = "swing"
thigh_m = 0.0695
shin_m = 0.0715
[joints]
swing = { limits_rad = [-2, 2], max_rate_rad_s = 5 }
flap = { limits_rad = [-0.2, 1.5], max_rate_rad_s = 5 }
knee = { limits_rad = [0, 2], max_rate_rad_s = 5 }
""" + "".join(
    f'[legs.{label}]\nhip_m = [{x}, {y}, 0]\nswing = "{label}1"\nflap = "{label}2"\nknee = "{label}3"\n'
    for label, x, y in (("LF", 0.1, 0.1), ("RF", 0.1, -0.1), ("LH", -0.1, 0.1), ("RH", -0.1, -0.1))
)


@pytest.mark.parametrize("name", builtin_robots())
def test_legs_are_mirror_images(name):
    robot = load_robot(name)
    left = {
        label: robot.legs[label].chain.end(robot.legs[label].angles(robot.legs[label].neutral_m[None]))
        for label in LEGS
    }
    np.testing.assert_allclose(left["LF"] * (1, -1, 1), left["RF"], atol=1e-12)
    np.testing.assert_allclose(left["LH"] * (1, -1, 1), left["RH"], atol=1e-12)
    for label, leg in robot.legs.items():
        assert (leg.neutral_m[0] > 0, leg.neutral_m[1] > 0) == (label[1] == "F", label[0] == "L")
        assert leg.neutral_m[2] == pytest.approx(-robot.stand_m)
    assert len({*robot.joints}) == 12


@pytest.mark.parametrize("name", builtin_robots())
@pytest.mark.parametrize("label", LEGS)
def test_angles_and_feet_agree_in_the_robots_own_joints(name, label):
    leg = load_robot(name).legs[label]
    rng = np.random.default_rng(0)
    angles = rng.uniform(leg.chain.lower_rad, leg.chain.upper_rad, (500, 3))
    feet = leg.chain.end(angles)
    np.testing.assert_allclose(leg.chain.positions(angles)[:, -1], feet, atol=1e-12)
    solved = leg.angles(feet)
    inside = np.isfinite(solved).all(axis=1)
    assert inside.mean() > 0.3  # the other samples have a raised leg, or a knee bent backwards
    np.testing.assert_allclose(leg.chain.end(solved[inside]), feet[inside], atol=1e-9)
    assert (solved[inside] >= leg.chain.lower_rad).all()
    assert (solved[inside] <= leg.chain.upper_rad).all()


def test_signs_of_the_a1_agree_with_unitree():
    # A positive hip angle moves a foot left, and a positive thigh angle back; calf angles are negative.
    robot = load_robot("a1")
    for leg in robot.legs.values():
        (home,) = leg.angles(leg.neutral_m[None])
        assert home[2] < 0
        hip, thigh = (leg.chain.end((home + step)[None])[0] - leg.neutral_m for step in 0.1 * np.eye(3)[:2])
        assert hip[1] > 0.02
        assert thigh[0] < -0.02


def test_signs_of_the_aibo_agree_with_sony():
    # A positive rotator angle swings the leg forwards, a positive elevator angle outwards, and a positive knee angle
    # bends it.
    robot = load_robot("aibo")
    for label, leg in robot.legs.items():
        (home,) = leg.angles(leg.neutral_m[None])
        rotator, elevator = (leg.chain.end((home + step)[None])[0] - leg.neutral_m for step in 0.1 * np.eye(3)[:2])
        assert rotator[0] > 0.005
        assert elevator[1] * (1 if label[0] == "L" else -1) > 0.005
        assert home[2] > 0
        # The elbow is behind the fore foot, and the knee is in front of the hind foot.
        knee = leg.chain.positions(home[None])[0, 2]
        assert (knee[0] < leg.neutral_m[0]) == (label[1] == "F")


def test_folding_height_follows_from_the_knee_limit():
    robot = load_robot("a1")
    # The shortest leg has the knee at its limit: 0.4 cos(2.69653 / 2).
    np.testing.assert_allclose(robot.folding_m, robot.stand_m - 0.4 * np.cos(2.69653 / 2), atol=1e-3)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda text: text.replace("thigh_m = 0.0695", "thigh_m = -1"), "leg.thigh_m"),
        (lambda text: text.replace("[legs.RH]", "[legs.XX]"), "legs.RH"),
        (lambda text: text.replace("[0, 2]", "[2, 0]"), "joints.knee.limits_rad"),
        (lambda text: text.replace("stand_m = 0.11", "stand_m = 0.2"), "stand_m"),
        (lambda text: text.replace('"RH1"', '"LF1"'), "joints"),
        (lambda text: text.replace("[leg]", "[leg]\nlateral_m = 0.1"), "leg.lateral_m"),
        (lambda text: text.replace("[leg]", "[leg"), "content"),
    ],
)
def test_problems_with_files_are_reported(tmp_path, change, field):
    path = tmp_path / "mine.toml"
    path.write_text(AIBO)
    assert load_robot(path).joints[:3] == ("LF1", "LF2", "LF3")
    path.write_text(change(AIBO))
    with pytest.raises(InputError) as error:
        load_robot(path)
    assert field in [problem.field for problem in error.value.problems]


def test_unknown_robots_are_reported():
    with refusal(("--robot", "name or file", "'spot'", ["a1, aibo", ".urdf"])):
        load_robot("spot")
    with refusal(("spot.urdf", "file", "no such file")):
        load_robot("spot.urdf")
