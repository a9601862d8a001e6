"""Test motions in the formats of training programs, with readers written from the definitions of the formats."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import refusal, refused, run
from scipy.spatial.transform import Rotation

from recon.api.clip_results import problem_of
from recon.fit.motion import Motion
from recon.fit.sampling import draws
from recon.robotics.physics import check, kept, simulated
from recon.robotics.quadruped import load_robot
from recon.robotics.retarget import Retargeting, reference_of, retarget
from recon.robotics.retarget_clip import FORMATS, RobotSamples, drawn, write_for_trainer
from recon.robotics.settings import RetargetSettings

LATERAL, THIGH, SHIN = 0.0838, 0.2, 0.2
"""Lateral offset, thigh and shin of the Unitree A1's legs, metres."""
HIPS = {"FL": (0.1805, 0.047), "FR": (0.1805, -0.047), "RL": (-0.1805, 0.047), "RR": (-0.1805, -0.047)}


@pytest.fixture(scope="module")
def animal(whole_results):
    return reference_of(Motion.load(whole_results))


@pytest.fixture(scope="module")
def solved(retargeted) -> Retargeting:
    return retargeted("a1")


def a1_bodies(name: str, q: np.ndarray) -> dict[str, tuple[np.ndarray, Rotation]]:
    """Return position (m) and rotation of each body of one leg in the trunk's frame, for joint angles (3,), rad.

    The poses are computed joint by joint, as the robot's URDF file defines them.
    """
    side = 1 if name[1] == "L" else -1
    hip, thigh = Rotation.from_euler("x", q[0]), Rotation.from_euler("y", q[1])
    at = np.array([*HIPS[name], 0.0])
    found = {f"{name}_hip": (at, hip)}
    at = at + hip.apply([0.0, side * LATERAL, 0.0])
    turned = hip * thigh
    found[f"{name}_thigh"] = (at, turned)
    at = at + turned.apply([0.0, 0.0, -THIGH])
    turned = turned * Rotation.from_euler("y", q[2])
    found[f"{name}_calf"] = (at, turned)
    found[f"{name}_foot"] = (at + turned.apply([0.0, 0.0, -SHIN]), turned)
    return found


@pytest.mark.parametrize("part", ["clip", "stride"])
def test_bodies_agree_with_the_robots_urdf_file(solved, part):
    found = RobotSamples(getattr(solved, part), 50)
    assert abs(found.rate_hz - 50) < 2
    for t in range(0, len(found.time_s), 7):
        at = dict(zip(found.robot.joints, found.angles_rad[t], strict=True))
        base = Rotation.from_matrix(found.turned[t, 0])
        for name in HIPS:
            q = np.array([at[f"{name}_{joint}_joint"] for joint in ("hip", "thigh", "calf")])
            for body, (position, turned) in a1_bodies(name, q).items():
                k = found.bodies.index(body)
                np.testing.assert_allclose(
                    found.position_m[t, k], found.position_m[t, 0] + base.apply(position), atol=1e-9
                )
                off = (base * turned).inv() * Rotation.from_matrix(found.turned[t, k])
                assert off.magnitude() < 1e-7


@pytest.fixture(scope="module")
def aibo(retargeted) -> Retargeting:
    return retargeted("aibo")


@pytest.mark.parametrize("robot", ["solved", pytest.param("aibo", marks=pytest.mark.slow)])
@pytest.mark.parametrize("part", ["clip", "stride"])
def test_velocities_are_the_derivatives_of_the_written_positions(robot, part, request):
    found = RobotSamples(getattr(request.getfixturevalue(robot), part), 1_000)
    twice = 2 * (found.time_s[1] - found.time_s[0])
    matrices = found.turned
    turns = Rotation.from_matrix((matrices[2:] @ matrices[:-2].swapaxes(-1, -2)).reshape(-1, 3, 3)).as_rotvec()
    spins = found.angular_velocity_rad_s
    for differences, rates in (
        ((found.angles_rad[2:] - found.angles_rad[:-2]) / twice, found.rates_rad_s),
        ((found.position_m[2:] - found.position_m[:-2]) / twice, found.velocity_m_s),
        (turns.reshape(spins[1:-1].shape) / twice, spins),
    ):
        np.testing.assert_allclose(differences, rates[1:-1], atol=1e-3 * np.abs(rates).max())


def test_standing_feet_are_still_and_strides_are_continuous(solved):
    found = RobotSamples(solved.stride, 200)
    feet = [*found.feet]
    speed = np.linalg.norm(found.velocity_m_s[:, feet], axis=2)
    within = found.feet_stand[1:-1] & found.feet_stand[:-2] & found.feet_stand[2:]
    assert np.median(speed[1:-1][within]) < 0.02 * speed.max()
    assert solved.stride.advance_m is not None
    on = np.append(solved.stride.advance_m, 0.0)
    np.testing.assert_allclose(found.position_m[-1], found.position_m[0] + on, atol=1e-9)
    np.testing.assert_allclose(found.angles_rad[-1], found.angles_rad[0], atol=1e-12)
    np.testing.assert_allclose(found.velocity_m_s[-1], found.velocity_m_s[0], atol=1e-9)
    steps = np.sum(found.quaternions[1:] * found.quaternions[:-1], axis=2)
    assert (steps > 0).all()


def test_each_format_holds_the_values_of_the_motion(solved, tmp_path):
    motion = solved.clip
    found = RobotSamples(motion, 50)
    K = len(found.time_s)
    for name, (file, _) in FORMATS.items():
        write_for_trainer(motion, name, 50, tmp_path / file, {"robot": "a1"})
        assert (tmp_path / file).is_file()
    amp = json.loads((tmp_path / "amp.json").read_text(encoding="utf-8"))
    frames = np.array(amp["Frames"])
    assert frames.shape == (K, 61)
    assert amp["LoopMode"] == "Clamp"
    assert amp["FrameDuration"] == pytest.approx(found.time_s[1])
    assert amp["JointNames"][:3] == ["FR_hip_joint", "FR_thigh_joint", "FR_calf_joint"]
    assert np.array(amp["Contacts"]).shape == (K, 4)
    base = Rotation.from_quat(frames[:, 3:7])
    for t in range(0, K, 9):  # toe positions, in the base's axes, follow from the joint angles
        for i, name in enumerate(("FR", "FL", "RR", "RL")):
            toe = a1_bodies(name, frames[t, 7 + 3 * i : 10 + 3 * i])[f"{name}_foot"][0]
            np.testing.assert_allclose(frames[t, 19 + 3 * i : 22 + 3 * i], toe, atol=1e-9)
    # Velocities are in the base's axes. In the world they are the derivatives of the positions, of base and toes.
    fine = RobotSamples(motion, 1_000)
    np.testing.assert_allclose(base.apply(frames[:, 31:34]), found.velocity_m_s[:, 0], atol=1e-9)
    np.testing.assert_allclose(base.apply(frames[:, 34:37]), found.angular_velocity_rad_s[:, 0], atol=1e-9)
    write_for_trainer(motion, "amp", 1_000, tmp_path / "fine_amp.json", {})
    fine_frames = np.array(json.loads((tmp_path / "fine_amp.json").read_text(encoding="utf-8"))["Frames"])
    toes = (fine_frames[2:, 19:31] - fine_frames[:-2, 19:31]) / (2 * fine.time_s[1])
    np.testing.assert_allclose(toes, fine_frames[1:-1, 49:61], atol=1e-3 * np.abs(toes).max())

    with np.load(tmp_path / "isaaclab.npz") as isaac, np.load(tmp_path / "mjlab.npz") as mjlab:
        assert [*isaac["dof_names"]] == [*found.robot.joints] == [*mjlab["joint_names"]]
        assert isaac["body_rotations"].shape == (K, len(found.bodies), 4)
        table = np.loadtxt(tmp_path / "mjlab.csv", delimiter=",")
        np.testing.assert_array_equal(table[:, :3], isaac["body_positions"][:, 0])
        np.testing.assert_array_equal(table[:, 3:7], isaac["body_rotations"][:, 0][:, [1, 2, 3, 0]])
        np.testing.assert_array_equal(table[:, 7:], isaac["dof_positions"])
        for one, other in (
            ("dof_positions", "joint_pos"),
            ("dof_velocities", "joint_vel"),
            ("body_positions", "body_pos_w"),
            ("body_rotations", "body_quat_w"),
            ("body_linear_velocities", "body_lin_vel_w"),
            ("body_angular_velocities", "body_ang_vel_w"),
        ):
            np.testing.assert_array_equal(isaac[one], mjlab[other])
        assert isaac["contacts"].dtype == bool
        assert json.loads(str(mjlab["source"])) == {"robot": "a1"}
    beside = json.loads((tmp_path / "mjlab.json").read_text(encoding="utf-8"))
    assert beside["joint_names"] == [*found.robot.joints]


@pytest.fixture(scope="module")
def written(whole_results, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("robot") / "go2"
    options = ("--robot", "go2", "--format", "isaaclab", "--rate", "80", "--samples", "3")
    ended = run("retarget", whole_results, *options, "--out", out)
    assert ended.code == 0, ended.err
    return out


def test_the_command_writes_clip_and_stride_with_the_verdict(whole_results, written, tmp_path):
    for name in ("isaaclab.npz", "stride_isaaclab.npz"):
        with np.load(written / name) as file:
            assert "FL_foot" in file["body_names"]
            assert json.loads(str(file["source"]))["verdict"]["level"] in ("use", "check")
    refused(
        ["retarget", whole_results, "--robot", "go2", "--format", "amp", "--rate", "0.5", "--out", tmp_path / "go2"],
        ("--rate", "frame rate", 0.5, ["2.9", "two frames"]),
    )


def test_a_robots_folder_is_converted_at_any_rate(whole_results, written, tmp_path):
    # The result equals the output of `recon retarget` at this rate.
    robot, out = written, tmp_path / "later.npz"
    assert run("convert", robot, out, "--to", "isaaclab", "--fps", "80").code == 0
    for at_once, later in (("isaaclab.npz", out), ("stride_isaaclab.npz", tmp_path / "stride_later.npz")):
        with np.load(robot / at_once) as expected, np.load(later) as found:
            assert {*found} == {*expected}
            assert str(found["source"]) == str(expected["source"])
            for name in ("fps", "dof_positions", "dof_velocities", "body_positions", "body_rotations", "contacts"):
                np.testing.assert_allclose(found[name], expected[name], atol=1e-12)
    assert run("convert", robot, tmp_path / "motion.json").code == 0  # the extension selects the format
    with np.load(out) as at_80:
        frames = json.loads((tmp_path / "motion.json").read_text(encoding="utf-8"))["Frames"]
        assert len(frames) - 1 == pytest.approx((len(at_80["dof_positions"]) - 1) * 50 / 80, abs=1)
    refused(["convert", robot, out, "--to", "trc"], ("--to", "format", "'trc'", ["amp", "mjlab-csv"]))
    refused(["convert", robot, tmp_path / "motion.bvh"], (tmp_path / "motion.bvh", "extension", "'.bvh'", ".json"))
    slow = tmp_path / "slow.json"  # frames suffice for the clip but not for the stride, so nothing is written
    refused(["convert", robot, slow, "--fps", "1.2"], ("--fps", "frame rate", "1.2", "two frames"))
    assert not slow.exists()
    later, expected = tmp_path / "x.json", ("--to", "format", "'amp'", "recon retarget")
    refused(["convert", whole_results, later, "--to", "amp"], expected)
    refused(  # no existing file is replaced
        ["convert", robot, tmp_path / "motion.csv"],
        ("OUT", "file", f"{tmp_path / 'motion.json'}, which exists already", "--overwrite"),
        ("OUT", "file", "stride_motion.json, which exists already", "--overwrite"),
    )
    assert not (tmp_path / "motion.csv").exists()


def test_a_format_without_room_for_the_robot_is_refused(solved, tmp_path):
    with refusal(("--rate", "frame rate", 0.1, ["2.6", "two frames"])):
        RobotSamples(solved.stride, 0.1)


@pytest.mark.slow
def test_drawn_motions_have_the_stated_scatter(whole_results):
    motion = Motion.load(whole_results)
    solution = motion.solution
    found = np.stack([one.joints_m for one in draws(problem_of(motion, whole_results), solution, 2000)])
    for points, stated in (
        (found, solution.covariance_m2),
        (found - found.mean(axis=2, keepdims=True), solution.relative_covariance_m2),
    ):
        ratio = points.std(axis=0) / np.sqrt(np.diagonal(stated, axis1=-2, axis2=-1))
        assert abs(np.median(ratio) - 1) < 0.03
        assert np.all(np.abs(np.quantile(ratio, [0.01, 0.99]) - 1) < 0.1)
    apart = (found - found.mean(axis=0)).reshape(len(found), len(motion.frames), -1)
    neighbours = (apart[:, 1:] * apart[:, :-1]).mean(axis=0) / (apart[:, 1:].std(axis=0) * apart[:, :-1].std(axis=0))
    assert np.median(neighbours) > 0.9


def test_the_command_draws_an_ensemble(written):
    report = json.loads((written / "report.json").read_text(encoding="utf-8"))
    assert report["samples"]["count"] == 3
    assert 0 < report["samples"]["base_sigma_m"]["x"] < 0.5
    with np.load(written / "samples.npz") as stacked:
        assert stacked["joint_positions"].shape == (3, len(stacked["time_s"]), 12)
        assert json.loads(str(stacked["source"]))["verdict"]["level"] in ("use", "check")
    for number in (1, 2, 3):
        with np.load(written / f"sample_{number:02d}_isaaclab.npz") as file:
            assert json.loads(str(file["source"]))["sample"] == number


@pytest.mark.slow
def test_bases_of_drawn_motions_are_moved_like_the_clips_base(animal, whole_results, tmp_path):
    settings = RetargetSettings(folder=whole_results, robot="a1", out=tmp_path)
    small = retarget(animal, load_robot("a1"), 0.2, 1.2)
    model = simulated(small.clip.robot)
    (plain,), (moved,) = drawn(small, settings, 1), drawn(small, settings, 1, model)
    before, after = (kept(check(one, model)[1])["forces"]["share"] for one in (plain, moved))
    assert before < 0.05
    assert after > 0.9
    assert (moved.scale, moved.slower) == (small.clip.scale, small.clip.slower)
    np.testing.assert_array_equal(moved.standing, small.clip.standing)
