"""Compare chains and quadrupeds from URDF files with MuJoCo's kinematics and with the closed form."""

import sys

import numpy as np
import pytest
from command_line import refusal
from robot_urdf import HEAD, JOINT, a1_urdf, moving

from recon import InputError
from recon.ik.costs import joint_differences
from recon.ik.drive import drive_to
from recon.ik.methods import (
    ExtendedJacobian,
    GradientProjection,
    JacobianTranspose,
    LeastNorm,
    SelectivelyDamped,
    damped_least_squares,
    weighted_least_norm,
)
from recon.robotics.models import model_chain, read_model
from recon.robotics.physics import described, simulated
from recon.robotics.quadruped import LEGS, load_robot

ARM = (
    (
        "turn",
        "continuous",
        "base",
        "a",
        "0 0 0.1",
        "0.3 -0.2 0.5",
        '<axis xyz="0 0 1"/><limit effort="1" velocity="3"/>',
    ),
    ("stay", "fixed", "a", "b", "0.1 0.05 0", "0 0.4 0", ""),
    ("slide", "prismatic", "b", "c", "0.2 0 0", "0.1 0.1 0.1", moving("0 0.6 0.8", -0.1, 0.3)),
    ("swing", "revolute", "c", "d", "0 0.1 0.1", "1.5 0 0", moving("0.6 0.8 0", -1.5, 1.5)),
    ("bend", "revolute", "d", "e", "0.3 0 0", "0 0 0", moving("0 0 1", -2, 2)),
    ("hold", "fixed", "e", "hand", "0.1 0.2 0.3", "0 0 1", ""),
)


@pytest.fixture
def arm(tmp_path):
    joints = "".join(
        JOINT.format(name=name, kind=kind, parent=parent, child=child, xyz=xyz, rpy=rpy, rest=rest)
        for name, kind, parent, child, xyz, rpy, rest in ARM
    )
    path = tmp_path / "arm.urdf"
    path.write_text(f'<?xml version="1.0"?>\n<robot name="arm"><link name="base"/>{joints}</robot>\n')
    return path


def write_a1(folder):
    path = folder / "a1.urdf"
    path.write_text(a1_urdf())
    return path


def chain_of(path, tip):
    return model_chain(read_model(path), path, tip)


def test_chain_agrees_with_mujocos_kinematics(arm):
    import mujoco

    found = chain_of(arm, "hand")
    assert found.names == ("turn", "slide", "swing", "bend")
    np.testing.assert_allclose(found.lower_rad, [-np.inf, -0.1, -1.5, -2])
    np.testing.assert_allclose(found.upper_rad, [np.inf, 0.3, 1.5, 2])
    np.testing.assert_allclose(found.max_rate_rad_s, [3, 21, 21, 21])
    model = read_model(arm)
    data = mujoco.MjData(model)
    for q in np.random.default_rng(0).uniform(-1, 1, (10, 4)):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        R, p = found.pose(q)
        np.testing.assert_allclose(R.ravel(), data.body("hand").xmat, atol=1e-9)
        np.testing.assert_allclose(p, data.body("hand").xpos, atol=1e-9)


MJCF = """<mujoco model="rig"><compiler angle="radian"/><worldbody><geom type="plane" size="1 1 1"/>
<body name="trunk" pos="1 2 3"><freejoint/><geom size="0.1"/>
<body name="crank" pos="0.1 0 0.2" euler="0.3 0.2 0.1"><joint name="a" axis="0 1 0" pos="0.05 0.02 0" range="-1 2"/>
<joint name="b" type="slide" axis="1 0 0"/><geom size="0.1"/>
<body pos="0 0 -0.3"><joint axis="0 0 1" pos="0 0.1 0"/><geom size="0.1"/><body name="tip" pos="0 0.1 -0.2"/></body>
</body></body></worldbody></mujoco>
"""


def test_chain_is_read_from_an_mjcf_file(tmp_path):
    # The file has joints away from the origins of bodies, two joints on one body, and joints without names.
    import mujoco

    path = tmp_path / "rig.xml"
    path.write_text(MJCF)
    found, model = chain_of(path, "tip"), read_model(path)
    assert found.names == ("a", "b", "joint 3")
    assert found.sliding.tolist() == [False, True, False]
    np.testing.assert_allclose(found.upper_rad, [2, np.inf, np.inf])
    data = mujoco.MjData(model)
    for q in np.random.default_rng(1).uniform(-1, 1, (5, 3)):
        data.qpos[:] = [0, 0, 0, 1, 0, 0, 0, *q]
        mujoco.mj_kinematics(model, data)
        R, p = found.pose(q)
        np.testing.assert_allclose(R.ravel(), data.body("tip").xmat, atol=1e-12)
        np.testing.assert_allclose(p, data.body("tip").xpos, atol=1e-12)


def test_a_joint_without_an_axis_is_refused(tmp_path):
    path = tmp_path / "rig.xml"
    path.write_text(MJCF.replace('<joint axis="0 0 1"', '<joint axis="-1e308 0 1"'))
    with refusal((path, "chain", ["tip", "an axis"])):
        chain_of(path, "tip")


def test_legs_of_an_mjcf_file_end_in_their_feet(tmp_path):
    # In MJCF files, feet are shapes of the last link, not links of their own.
    closed, path = load_robot("a1"), tmp_path / "a1.xml"
    spec = described(closed)
    spec.compile()
    path.write_text(spec.to_xml())
    found = load_robot(path)
    assert {*found.joints} == {*closed.joints}
    for label, leg in found.legs.items():
        np.testing.assert_allclose(leg.neutral_m, closed.legs[label].neutral_m, atol=1e-6)
        angles = np.linspace(leg.chain.lower_rad, leg.chain.upper_rad, 5).clip(-1, 1)
        np.testing.assert_allclose(leg.chain.end(angles), closed.legs[label].chain.end(angles), atol=1e-6)
    assert simulated(found).nv == 18  # six degrees of freedom of the base and twelve joints


def test_every_method_reaches_a_target_of_a_urdf_arm(arm):
    chain = chain_of(arm, "hand")
    start, goal = np.array([0.0, 0.1, 0.2, 0.3]), np.array([0.2, 0.15, 0.5, -0.1])
    for method in (
        LeastNorm(),
        JacobianTranspose(),
        damped_least_squares(),
        SelectivelyDamped(),
        weighted_least_norm(np.array([1.0, 2.0, 1.0, 1.0])),
        GradientProjection(joint_differences(chain)),
        ExtendedJacobian(joint_differences(chain)),
    ):
        assert drive_to(chain, start, chain.end(goal), method).reason == "reached", method


def test_quadruped_of_a_urdf_file_agrees_with_the_closed_form(tmp_path):
    read, closed = load_robot(write_a1(tmp_path)), load_robot("a1")
    assert read.joints == closed.joints
    assert read.stand_m == pytest.approx(closed.stand_m)
    rng = np.random.default_rng(1)
    for label in LEGS:
        one, other = read.legs[label], closed.legs[label]
        np.testing.assert_allclose(one.neutral_m, other.neutral_m, atol=1e-12)
        np.testing.assert_allclose(
            [one.chain.lower_rad, one.chain.upper_rad], [other.chain.lower_rad, other.chain.upper_rad], atol=1e-4
        )
        angles = rng.uniform(other.chain.lower_rad, other.chain.upper_rad, (20, 3))
        np.testing.assert_allclose(one.chain.end(angles), other.chain.end(angles), atol=1e-12)
        np.testing.assert_allclose(one.chain.positions(angles), other.chain.positions(angles), atol=1e-12)
        feet = other.neutral_m + rng.uniform(-0.04, 0.04, (20, 3))
        np.testing.assert_allclose(one.angles(feet), other.angles(feet), atol=1e-3)
        np.testing.assert_allclose(one.chain.end(one.angles(feet)), feet, atol=1e-5)
        assert np.isnan(one.angles(other.neutral_m[None] - [0, 0, 0.5])).all()


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (lambda text: text.replace('<child link="RR_foot"/>', '<child link="nowhere"/>'), "content"),
        (lambda text: text.replace("</robot>", ""), "content"),
        (lambda text: HEAD + "</robot>", "legs"),
        (
            lambda text: text.replace('name="RR_calf_joint" type="revolute"', 'name="RR_calf_joint" type="floating"'),
            "content",
        ),
        (lambda text: text.replace("0 0 -0.2", "0 0 0"), "legs"),
        (lambda text: text.replace("-0.1805 0.047", "-0.1805 -0.2"), "hips"),
        (lambda text: text.replace('lower="-2.69653"', 'lower="2.69653"'), "joint FL_calf_joint"),
        pytest.param(
            lambda text: text.replace('"-2.69653" upper="-0.9163"', '"-0.1" upper="0.1"'),
            "stand_m",
            marks=pytest.mark.slow,
        ),
        (lambda text: text.replace('<axis xyz="0 1 0"/>', '<axis xyz="0 1e-320 0"/>'), "content"),
        (lambda text: text.replace('velocity="21.0"', 'velocity="-1"'), "joint FL_hip_joint"),
        (lambda text: text.replace('velocity="21.0"', 'velocity="fast"'), "limit"),
        (lambda text: text.replace('xyz="0 0 -0.2"', 'xyz="0 0 1e308"'), "links"),
        (lambda text: text.replace('rpy="0 0 0"', 'rpy="0 0 -inf"'), "chain"),
        (lambda text: text.replace('<parent link="trunk"/>', '<parent link="FL_foot"/>'), "content"),  # a loop of links
    ],
)
def test_unusable_files_are_refused(tmp_path, change, field):
    path = tmp_path / "bad.urdf"
    path.write_text(change(a1_urdf()))
    with pytest.raises(InputError) as error:
        load_robot(path)
    assert error.value.problems[0].field == field


def test_missing_links_are_reported(arm):
    with refusal((arm, "link", "'finger'", "base, a, b")):
        chain_of(arm, "finger")
    with refusal((arm, "chain", "from base to base")):
        chain_of(arm, "base")
    with refusal((arm.with_name("none.urdf"), "file", "no such file")):
        read_model(arm.with_name("none.urdf"))


def test_a_missing_mujoco_is_reported(arm, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with refusal((arm, "robot", "no package mujoco", "[robots]")):
        read_model(arm)
