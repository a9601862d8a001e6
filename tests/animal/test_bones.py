"""Test that bones have anatomical names, and that their lengths do not depend on the pose."""

from __future__ import annotations

import json

import pytest
from command_line import run

from recon.animal.bones import bones_of
from recon.animal.skeleton_file import builtin_names, load_skeleton
from recon.fit.shape import MODEL_SIGMA


def test_bones_of_a_measured_cheetah_have_its_lengths():
    bones = {bone.title: bone for bone in bones_of(load_skeleton("cheetah-24", "jules"))}
    assert {title: bone.length_m for title, bone in bones.items()} == pytest.approx(
        {
            "rear trunk, tail base to spine": 0.296,
            "front trunk, spine to neck base": 0.444,
            "trunk, tail base to neck base": 0.74,
            "head and neck, neck base to nose": 0.4087,
            "upper arm, shoulder to elbow": 0.24,
            "forearm, elbow to carpus": 0.28,
            "forefoot, carpus to foot": 0.155,
            "thigh, hip to stifle": 0.27,
            "shank, stifle to hock": 0.33,
            "hind foot, hock to foot": 0.245,
        },
        abs=1e-4,
    )
    assert bones["trunk, tail base to neck base"].offsets == ("tail_1", "head")


@pytest.mark.parametrize("name", builtin_names())
def test_every_skeleton_has_bones(name: str):
    body = load_skeleton(name)
    names = {*(segment.name for segment in body.tree.segments), *body.markers}
    bones = bones_of(body)
    assert bones
    assert {offset for bone in bones for offset in bone.offsets} <= names
    assert len({bone.name for bone in bones}) == len(bones)


def test_a_skeleton_without_an_anatomy_has_no_bones():
    from dataclasses import replace

    assert bones_of(replace(load_skeleton("cheetah-24"), anatomy={})) == ()


def test_skeleton_check_lists_the_markers_of_joint_angles():
    joints = json.loads(run("skeleton", "check", "cheetah-24", "--json").out)["joint_angles"]
    assert {"joint": "hip", "markers": ["spine", "l_hip", "l_back_knee"]} in joints
    assert len(joints) == len({joint["joint"] for joint in joints}) == 8
    assert "l_front_ankle   l_front_paw" in run("skeleton", "check", "cheetah-24").out


def test_skeleton_check_prints_bones_with_their_joints():
    ended = run("skeleton", "check", "cheetah-24")
    assert "upper arm" in ended.out
    assert "shoulder to elbow" in ended.out
    bones = json.loads(run("skeleton", "check", "cheetah-24", "--json").out)["bones"]
    upper_arm = next(bone for bone in bones if bone["bone"] == "upper arm")
    assert upper_arm["length_m"] == pytest.approx(0.25)
    assert upper_arm["sigma_m"] == pytest.approx(0.25 * (0.1**2 + 0.05**2) ** 0.5)
    assert 0.02 < MODEL_SIGMA < 0.06
