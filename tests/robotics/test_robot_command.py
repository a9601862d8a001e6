"""Test that `recon robot` prints a robot's kinematics and reports wrong input."""

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import refused, run
from robot_urdf import a1_urdf

from recon.robotics.dh import all_solutions
from recon.robotics.quadruped import load_robot

PUMA = """convention = "modified"
joints = [
    {},
    { alpha_rad = -1.5707963267948966, limits = [-1, 1] },
    { a_m = 0.4318, d_m = 0.15005 },
    { a_m = -0.0203, alpha_rad = -1.5707963267948966, d_m = 0.4318 },
    { alpha_rad = 1.5707963267948966 },
    { alpha_rad = -1.5707963267948966 },
]
"""


def answer(*args):
    ended = run("robot", *args, "--json")
    assert ended.code == 0, ended.err
    return json.loads(ended.out)


@pytest.fixture
def puma(tmp_path: Path) -> Path:
    path = tmp_path / "puma.toml"
    path.write_text(PUMA)
    return path


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    path = tmp_path / "a1.urdf"
    path.write_text(a1_urdf())
    return path


@pytest.mark.parametrize("name", ["a1", pytest.param("aibo", marks=pytest.mark.slow)])
def test_solutions_of_a_leg_include_the_closed_form(name):
    # The closed form, with the robot's own signs, is one of the four solutions of the search.
    rng = np.random.default_rng(3)
    legs = load_robot(name).legs
    for leg in (legs["LF"], legs["RH"]):
        q = rng.uniform(leg.chain.lower_rad, leg.chain.upper_rad)
        foot = leg.chain.end(q[None])[0]
        np.testing.assert_allclose(leg.chain.end(q), foot, atol=1e-14)
        found, isolated = all_solutions(leg.chain, foot)
        assert isolated
        assert found.shape == (4, 3)
        np.testing.assert_allclose(leg.chain.end(found), np.tile(foot, (4, 1)), atol=1e-7)
        for one in (q, leg.closed_angles(foot[None])[0]):
            assert np.abs(np.angle(np.exp(1j * (found - one)))).max(axis=1).min() < 1e-6


def test_pitch_lowers_the_front_hips_on_planted_feet():
    found = answer("pose", "aibo", "--pitch", 10, "--move", "0,0,-0.01")
    robot = load_robot("aibo")
    s, c = np.sin(np.radians(10)), np.cos(np.radians(10))
    for label, leg in found["legs"].items():
        stands = robot.legs[label].neutral_m - [0, 0, -0.01]
        expected = [c * stands[0] - s * stands[2], stands[1], s * stands[0] + c * stands[2]]
        assert leg["foot_m"] == pytest.approx(expected)
        assert robot.legs[label].chain.end(np.array([leg["angles_rad"]]))[0] == pytest.approx(expected)
        assert leg["why"] == ""
        assert leg["margin_rad"] > 0


def test_pose_beyond_limits_or_reach_is_reported():
    low = answer("pose", "aibo", "--move", "0,0,-0.09")["legs"]["LF"]
    assert (low["angles_rad"], low["why"]) == (None, "out of reach, or outside a joint's limits")
    ended = run("robot", "pose", "aibo", "--move", "0,0,0.2")
    assert "RH: out of reach" in ended.out


def test_leg_forward_and_inverse():
    there = answer("dh", "aibo", "--tip", "LH", "--angles", "-20,15,60")["forward"]
    leg = load_robot("aibo").legs["LH"]
    q = np.radians([-20, 15, 60])
    assert there["place_m"] == pytest.approx(leg.chain.end(q[None])[0])
    back = answer("dh", "aibo", "--tip", "LH", "--place", ",".join(map(str, there["place_m"])))
    solutions = back["inverse"]["solutions"]
    assert len(solutions) == 4
    allowed = [s["q"] for s in solutions if s["within_limits"]]
    assert any(np.allclose(s, q, atol=1e-6) for s in allowed)
    assert back["dh"]["rows"][2]["a_m"] == pytest.approx(0.0695)
    assert "knee" in run("robot", "dh", "aibo", "--tip", "LH").out


@pytest.mark.slow
def test_a_urdf_leg_has_the_solutions_of_the_closed_form(urdf):
    position = ("0.2", "0.14", "-0.25")
    ours = [answer("dh", robot, "--tip", "LF", "--place", ",".join(position))["inverse"] for robot in (urdf, "a1")]
    one, other = (np.array(sorted(s["q"] for s in found["solutions"])) for found in ours)
    np.testing.assert_allclose(one, other, atol=1e-6)
    # The thigh's limits, and so its angle, exceed half a turn.
    assert sum(s["within_limits"] for s in ours[0]["solutions"]) == 1


@pytest.mark.slow
def test_table_of_a_toml_file(puma):
    found = answer("dh", puma, "--angles", "10,20,30,40,50,60")
    assert found["dh"]["convention"] == "modified"
    expected = {"a_m": -0.0203, "alpha_rad": -np.pi / 2, "d_m": 0.4318, "theta_rad": 0.0}
    assert found["dh"]["rows"][3] == pytest.approx(expected)
    end = found["forward"]
    turned = ",".join(map(str, np.degrees(end["roll_pitch_yaw_rad"])))
    found = answer("dh", puma, "--place", ",".join(map(str, end["place_m"])), "--turned", turned)["inverse"]
    assert len(found["solutions"]) == 8
    assert any(np.allclose(np.degrees(s["q"]), [10, 20, 30, 40, 50, 60], atol=1e-4) for s in found["solutions"])
    assert 0 < sum(s["within_limits"] for s in found["solutions"]) < 8
    assert "infinitely many" in run("robot", "dh", puma, "--place", "0.4,0.1,0.3").out


def test_table_of_a_urdf_file(urdf):
    assert [abs(row["a_m"]) for row in answer("dh", urdf, "--tip", "FL_foot")["dh"]["rows"]] == [0, 0, 0.2]
    refused(["robot", "dh", urdf], ("--tip", "link", "no link", "FL_foot, FR_foot"))


@pytest.mark.parametrize(
    ("args", "expected"),
    [
        (("pose", "aibo", "--pitch", "x"), ("--pitch", "pitch", "'x'", "degrees")),
        (("pose", "aibo", "--move", "1,2"), ("--move", "move", "'1,2'", "3 numbers")),
        (("pose", "spot"), ("--robot", "name or file", "'spot'", "a1, aibo")),
        (("dh", "aibo"), ("--tip", "leg", "no leg", "LF, RF, LH, RH")),
        (("dh", "aibo", "--tip", "LF", "--angles", "1,2"), ("--angles", "joints", "2 numbers", 3)),
        (("dh", "none.toml"), ("none.toml", "file", "no such file")),
    ],
)
def test_wrong_input_is_reported(args, expected):
    refused(["robot", *args], expected)


def test_every_problem_with_a_table_is_reported(tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text('convention = "craig"\njoints = [{ a = 1 }, { limits = [2, 1] }]\n')
    wrong = (("convention", "'craig'"), ("joints[0].a", "unknown"), ("joints[1].limits", "[2, 1]"))
    refused(["robot", "dh", path], *((path, *one) for one in wrong))
    path.write_text('convention = "standard"\njoints = [{ limits = [2, 1] }]\n')
    assert "joints[0].limits" in run("robot", "dh", path).err
