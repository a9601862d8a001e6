"""Compare files for training programs with MuJoCo, and test the checks of a motion by inverse dynamics."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from command_line import refusal, refused, run, says
from robot_urdf import a1_urdf

from recon.fit.motion import Motion
from recon.robotics.models import read_model
from recon.robotics.physics import FRICTION, RULES, carried, check, followed, kept, simulated
from recon.robotics.quadruped import LEGS, body_pose, load_robot
from recon.robotics.retarget import RobotMotion, posed, reference_of, retarget
from recon.robotics.retarget_clip import RobotSamples
from recon.testing.steady_gait import TROT, with_exact_states

NO_MASSES = ("aibo", "masses", "none")


@pytest.fixture(scope="module")
def a1(retargeted):
    return retargeted("a1")


@pytest.mark.parametrize("part", ["clip", "stride"])
def test_bodies_velocities_and_contacts_agree_with_mujoco(a1, part, tmp_path):
    # MuJoCo reads the A1's URDF file, while recon uses its dimensions.
    import mujoco  # slow to import

    path = tmp_path / "a1.urdf"
    path.write_text(a1_urdf())
    model = read_model(path, free=True)
    data, found = mujoco.MjData(model), RobotSamples(getattr(a1, part), 50)
    at = {name: model.joint(name) for name in found.robot.joints}
    placed = {name: name.replace("base", "trunk") for name in found.bodies}
    for k in range(len(found.time_s)):
        data.qpos[:7] = [*found.position_m[k, 0], *found.quaternions[k, 0, [3, 0, 1, 2]]]
        data.qvel[:6] = [*found.velocity_m_s[k, 0], *found.angular_velocity_rad_s[k, 0] @ found.turned[k, 0]]
        for j, joint in enumerate(at.values()):
            data.qpos[joint.qposadr[0]], data.qvel[joint.dofadr[0]] = found.angles_rad[k, j], found.rates_rad_s[k, j]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        for b, name in enumerate(found.bodies):
            body, velocity = data.body(placed[name]), np.zeros(6)
            np.testing.assert_allclose(body.xpos, found.position_m[k, b], atol=1e-6)
            np.testing.assert_allclose(body.xmat, found.turned[k, b].ravel(), atol=1e-6)
            mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body.id, velocity, 0)
            np.testing.assert_allclose(velocity[:3], found.angular_velocity_rad_s[k, b], atol=1e-5)
            np.testing.assert_allclose(velocity[3:], found.velocity_m_s[k, b], atol=1e-5)
        heights = np.array([data.body(f"{name}_foot").xpos[2] for name in ("FL", "FR", "RL", "RR")])
        assert (np.abs(heights[found.feet_stand[k]]) < 1e-4).all()


def still(time_s: np.ndarray, way_m: np.ndarray, stand: bool = True) -> RobotMotion:
    """Return a motion of the A1 on planted feet, with its body displaced by `way_m` (N, 3), metres."""
    robot = load_robot("a1")
    up = np.array([0, 0, robot.stand_m])
    feet = up + [leg.neutral_m for leg in robot.legs.values()]
    pose = body_pose(up + way_m, 0.0, 0.0, 0.0)
    n = len(time_s)
    return posed(robot, time_s, pose, np.tile(feet, (n, 1, 1)), np.full((n, 4), stand))


TIME = np.linspace(0, 0.4, 41)


def test_standing_feet_carry_the_weight():
    motion = still(TIME, np.zeros((41, 3)))
    model = simulated(motion.robot)
    assert model.body_subtreemass[1] == pytest.approx(6.0 + 4 * (0.595 + 0.888 + 0.151 + 0.06))
    _, margins = check(motion, model)
    assert {name: found["share"] for name, found in kept(margins).items()} == dict.fromkeys(RULES, 1.0)
    assert np.abs(margins["forces"]).max() < 0.01
    # Each foot carries a quarter of the weight; the knee is 0.14 m from the line of this force.
    leg = motion.robot.legs["LF"]
    knee = leg.chain.positions(motion.leg_angles("LF")[0])[2] - leg.neutral_m
    torque = model.body_subtreemass[1] * 9.81 / 4 * abs(knee[0])
    assert 1 - margins["torques"].mean() == pytest.approx(torque / 33.5, rel=0.25)
    # In the air, no foot carries the robot.
    _, margins = check(still(TIME, np.zeros((41, 3)), stand=False), model)
    assert kept(margins)["forces"]["share"] == 0
    assert margins["forces"].mean() == pytest.approx(-1, abs=0.1)
    # A free fall needs no force.
    fall = np.outer(-4.905 * (TIME[:21] - 0.1) ** 2, [0, 0, 1])
    motion = still(TIME[:21], fall, stand=False)
    frozen = replace(motion, angles_rad=np.tile(motion.angles_rad[:1], (21, 1)))
    np.testing.assert_allclose(check(frozen, model)[1]["forces"][2:-2], 0, atol=0.01)


def test_friction_limits_sideways_forces():
    model = simulated(load_robot("a1"))
    for fraction, enough in ((0.6, True), (1.6, False)):
        aside = np.outer(fraction * FRICTION * 9.81 * (TIME[:11] - 0.05) ** 2 / 2, [0, 1, 0])
        lacks = check(still(TIME[:11], aside), model)[1]["forces"][5]
        assert (lacks > -0.1) == enough, (fraction, lacks)


def test_colliding_legs_are_found():
    motion = still(TIME[:3], np.zeros((3, 3)))
    feet = motion.feet_m.copy()
    feet[:, LEGS.index("LF"), 0] = feet[:, LEGS.index("LH"), 0] = 0.0
    near = posed(motion.robot, motion.time_s, motion.pose, feet, motion.standing)
    assert kept(check(near, simulated(motion.robot))[1])["legs_apart"]["share"] == 0


@pytest.fixture(scope="module")
def trotting(whole_results) -> Motion:
    """Return the motion of a simulated animal that trots, with exact poses."""
    motion = Motion.load(whole_results)
    return with_exact_states(motion, TROT.states(motion.body, motion.frames / 60.0), 60.0)


@pytest.fixture(scope="module")
def trot(trotting) -> RobotMotion:
    return retarget(reference_of(trotting), load_robot("a1"), scale=0.3, slower=1.0).stride


@pytest.fixture(scope="module")
def carries(trot) -> tuple[RobotMotion, np.ndarray]:
    return carried(trot, simulated(trot.robot))


def test_a_small_shift_of_the_base_makes_a_trot_possible(trot, carries):
    motion, moved = carries
    model = simulated(trot.robot)
    before, after = (kept(check(one, model)[1]) for one in (trot, motion))
    assert before["forces"]["share"] < 0.6
    assert {name: rule["share"] for name, rule in after.items()} == dict.fromkeys(RULES, 1.0)
    # Footholds, times and the distance of a stride are unchanged. Only the base moves, by the returned shift.
    np.testing.assert_array_equal(motion.feet_m[motion.standing], trot.feet_m[trot.standing])
    np.testing.assert_allclose(motion.pose.translation - trot.pose.translation, moved[:, :3], atol=1e-12)
    turned = [one.pose.rotation.as_euler("ZYX") for one in (trot, motion)]
    np.testing.assert_allclose(turned[1] - turned[0], moved[:, 3:], atol=1e-12)
    assert np.linalg.norm(moved[:, :3], axis=1).max() < 0.02
    assert np.linalg.norm(moved[:, 3:], axis=1).max() < 0.15
    assert motion.slip_m.max() < 1.5e-4
    assert motion.closing_percent < 1e-6


@pytest.mark.parametrize(("robot", "scale"), [pytest.param("a1", 0.28, marks=pytest.mark.slow), ("go2", 0.31)])
def test_a_shift_of_the_base_makes_most_of_a_gallop_possible(whole_results, robot, scale):
    # Fewer than half of the frames of the sample's gallop have a foot on the ground.
    gallop = retarget(reference_of(Motion.load(whole_results)), load_robot(robot), scale).stride
    model = simulated(gallop.robot)
    assert kept(check(gallop, model)[1])["forces"]["share"] < 0.1
    motion, moved = carried(gallop, model)
    shares = {name: rule["share"] for name, rule in kept(check(motion, model)[1]).items()}
    assert shares.keys() == {*RULES}
    # A few of the 33 frames fail; which frames depends on differences of the fit below a millimetre.
    assert min(shares.values()) > 0.85
    assert np.linalg.norm(moved[:, :3], axis=1).max() < 0.1
    assert motion.slip_m.max() < 1.5e-4


def test_a_possible_motion_is_unchanged():
    motion, moved = carried(still(TIME, np.zeros((41, 3))), simulated(load_robot("a1")))
    assert np.abs(moved).max() < 2e-3
    assert kept(check(motion, simulated(motion.robot))[1])["forces"]["share"] == 1


def test_the_simulated_a1_follows_a_stride_of_the_trot(trot, carries):
    time_s, off_m = followed(carries[0])
    assert time_s[-1] == pytest.approx(0.45, abs=1e-3)
    assert off_m.max() < 0.02
    assert trot.advance_m is not None
    assert trot.advance_m[0] > 0.4
    # Without the shift of the base, the robot cannot follow the motion.
    assert followed(trot)[1].max() > 2 * off_m.max()


@pytest.mark.slow
def test_the_command_reports_its_changes(trotting, tmp_path):
    clip, out = tmp_path / "trot", tmp_path / "out"
    clip.mkdir()
    trotting.save(clip)
    ended = run("retarget", clip, "--robot", "go2", "--scale", "0.35", "--fit-limits", "--format", "amp", "--out", out)
    assert ended.code == 0, ended.err
    changed = "time 1.00 times", "stride 1.00 times", "height 1.00 times", "base moved by"
    assert says(ended.out, *changed)
    report = json.loads((out / "report.json").read_text())
    assert report["check"]["before"]["stride"]["forces"]["share"] < 0.6
    assert 0 < report["check"]["changed"]["base_moved_m"] < 0.15
    source = json.loads((out / "amp.json").read_text())["Source"]["check"]
    assert source["changed"] == pytest.approx(report["check"]["changed"])
    assert source["stride"]["forces"]["share"] == 1
    for part, prefix in (("clip", ""), ("stride", "stride_")):
        table = np.genfromtxt(out / f"{prefix}check.csv", delimiter=",", names=True)
        assert table.dtype.names == ("time_s", *RULES)
        assert (out / f"{prefix}check.png").is_file()
        for name in RULES:
            assert report["check"][part][name]["share"] == 1
            assert table[name].min() == pytest.approx(report["check"][part][name]["least"])
    refused(["retarget", clip, "--robot", "aibo", "--check", "--out", tmp_path / "no"], NO_MASSES)
    assert not (tmp_path / "no").exists()


def test_a_file_without_torque_limits_allows_any_torque(tmp_path):
    path = tmp_path / "a1.urdf"
    path.write_text(a1_urdf().replace(' effort="33.5"', ""))
    robot = load_robot(path)
    motion = still(TIME[:3], np.zeros((3, 3)))
    at = {name: k for k, name in enumerate(motion.robot.joints)}
    angles = motion.angles_rad[:, [at[name] for name in robot.joints]]
    margins = check(replace(motion, robot=robot, angles_rad=angles), simulated(robot))[1]
    np.testing.assert_array_equal(margins["torques"], 1.0)


def test_a_robot_without_masses_is_refused():
    with refusal(NO_MASSES):
        simulated(load_robot("aibo"))
