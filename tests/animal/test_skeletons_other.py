"""Test skeletons of animals other than the cheetah, built in and from users, and the command `recon skeleton`."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import refusal, says
from typer.testing import CliRunner

from recon import Body, Camera, FitSettings, InputError, Keypoints, Motion, fit_clip, load_skeleton
from recon.animal.body import other_side, side_of
from recon.animal.chain import builtin_chains
from recon.animal.naming import both_sides, builtin_maps, load_names, without_side
from recon.animal.prior import prior_from_body
from recon.animal.skeleton_file import builtin_names
from recon.api.skeleton_check import check_skeleton
from recon.base.outputs import RECORD
from recon.cli.app import app
from recon.cli.models import _SkeletonCheckSettings, skeleton_check
from recon.clip import still_view
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.trajectory import solve_trajectory
from recon.gait.evaluation import aligned, joint_errors, score
from recon.io.formats import read_keypoints

pytestmark = pytest.mark.usefixtures("no_playback")

CAT = (Path(__file__).parents[2] / "docs" / "my-cat.toml").read_text(encoding="utf-8")

DOG = (
    *("Hips", "Spine", "Spine1", "Neck", "Head", "HeadSite"),
    *(side + joint for side in ("Left", "Right") for joint in ("Shoulder", "Arm", "ForeArm", "Hand", "HandSite")),
    *(side + joint for side in ("Left", "Right") for joint in ("UpLeg", "Leg", "Foot", "FootSite")),
    *("Tail", "Tail1", "Tail1Site"),
)
HORSE = (
    *("Nose", "Eye", "Shoulder", "Midshoulder", "Elbow", "Girth", "Wither", "Hip", "Stifle", "Ischium"),
    *(side + joint for side in ("Near", "Off") for joint in ("knee", "frontfetlock", "frontfoot")),
    *(side + joint for side in ("Near", "Off") for joint in ("hindhock", "hindfetlock", "hindfoot")),
)
RIGID_M = {
    "dog-27": {
        ("Hips", "Spine"): 0.0,
        ("Spine1", "Neck"): 0.225,
        ("Spine", "Spine1"): 0.19,
        ("Neck", "Head"): 0.14,
        ("Head", "HeadSite"): 0.17,
        ("LeftShoulder", "RightShoulder"): 0.086,
        ("RightArm", "RightForeArm"): 0.152,
        ("LeftForeArm", "LeftHand"): 0.178,
        ("RightHand", "RightHandSite"): 0.072,
        ("LeftUpLeg", "RightUpLeg"): 0.096,
        ("LeftUpLeg", "Tail"): 0.085,
        ("RightUpLeg", "RightLeg"): 0.16,
        ("LeftLeg", "LeftFoot"): 0.18,
        ("RightFoot", "RightFootSite"): 0.108,
        ("Tail", "Tail1"): 0.12,
        ("Tail1", "Tail1Site"): 0.12,
    },
    "horse-22": {
        ("Wither", "Hip"): 0.93,
        ("Wither", "Girth"): 0.7376,
        ("Eye", "Nose"): 0.5,
        ("Shoulder", "Elbow"): 0.435,
        ("Nearknee", "Nearfrontfetlock"): 0.32,
        ("Offfrontfetlock", "Offfrontfoot"): 0.195,
        ("Nearhindhock", "Nearhindfetlock"): 0.44,
        ("Offhindfetlock", "Offhindfoot"): 0.19,
    },
}
"""Distances between markers that do not depend on the pose, m, measured in recordings."""


def body_of(name: str | Path) -> Body:
    return load_skeleton(name)


def expected_points(body: Body) -> dict[str, np.ndarray]:
    state = np.concatenate([np.zeros(4), body.mean_rad])
    return dict(zip(body.markers, body.tree.pose(state[None]).points_m[0], strict=True))


def in_file(folder: Path, text: str, name: str = "my-cat.toml") -> Path:
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def output(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == code, result.output
    return result.output


# Contents of the skeletons


@pytest.mark.parametrize(("name", "markers"), [("dog-27", DOG), ("horse-22", HORSE)])
def test_names_agree_with_the_recordings(name, markers):
    body = body_of(name)
    assert len(body.markers) == len(markers)
    assert {*body.markers} == {*markers}
    assert {m for along in body.limbs.values() for m in along} == {*markers}
    assert len(body.feet) == 4


@pytest.mark.parametrize("name", ["dog-27", "horse-22"])
def test_expected_pose(name):
    body = body_of(name)
    at = expected_points(body)
    rear, front = (at[m] for m in body.forward)
    nose = at["HeadSite" if name == "dog-27" else "Nose"]
    assert nose[0] > front[0] + 0.2 > rear[0] + 0.5
    assert all(at[foot][2] < min(rear[2], front[2]) - 0.25 for foot in body.feet)
    for marker, point in at.items():
        mirrored = at[other_side(marker)] * [1, -1, 1]
        np.testing.assert_allclose(point, mirrored, rtol=0, atol=1e-12)
        if side_of(marker) is not None:
            assert (point[1] > 0) == (side_of(marker) == "left")


@pytest.mark.parametrize("name", ["dog-27", "horse-22"])
def test_lengths_do_not_depend_on_the_pose(name):
    body, rng = body_of(name), np.random.default_rng(0)
    states = np.concatenate([np.zeros((20, 4)), rng.normal(body.mean_rad, body.sigma_rad, (20, body.n_state - 4))], 1)
    points = dict(zip(body.markers, body.tree.pose(states).points_m.swapaxes(0, 1), strict=True))
    for (a, b), length in RIGID_M[name].items():
        np.testing.assert_allclose(np.linalg.norm(points[a] - points[b], axis=1), length, rtol=0, atol=2e-3)


def test_the_horse_is_about_as_long_as_it_is_high():
    at = expected_points(body_of("horse-22"))
    withers = at["Wither"][2] - min(at["Nearfrontfoot"][2], at["Nearhindfoot"][2])
    assert withers == pytest.approx(1.6, abs=0.06)
    assert np.linalg.norm(at["Shoulder"] - at["Ischium"]) == pytest.approx(1.6, abs=0.05)


@pytest.mark.parametrize(
    ("name", "speed", "apart", "limit_mm"),
    [("dog-27", 1.0, 5.0, 25), ("horse-22", 1.5, 9.0, 60), ("quadruped", 1.5, 5.0, 60)],
)
def test_a_skeleton_is_recovered_from_its_own_clip(name, speed, apart, limit_mm):
    """Each skeleton is recovered from its own clip with slow waves of all angles, seen from the side without noise."""
    body, T, fps = body_of(name), 24, 30.0
    rng, time_s = np.random.default_rng(1), np.arange(T) / fps
    states = np.zeros((T, body.n_state))
    phase = rng.uniform(0, 2 * np.pi, body.n_state - 4)
    waves = np.sin(2 * np.pi * 1.2 * time_s[:, None] + phase)
    states[:, 4:] = body.mean_rad + 0.33 * body.sigma_rad * waves
    states[:, 0], states[:, 1] = speed * (time_s - time_s.mean()), apart
    camera = Camera.from_hfov(40.0, (1920, 1080))
    truth_m = body.tree.pose(states).points_m @ np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]).T
    px, valid = camera.project(truth_m)
    assert valid.all()
    fast = TrajectoryOptions(fast=True)
    solution = solve_trajectory([still_view(camera, px, np.ones(px.shape[:2]))], body, prior_from_body(body), fps, fast)
    assert solution.status == "converged"
    found = solution.joints_camera_m
    assert 1000 * score(joint_errors(aligned(found, truth_m), truth_m)).mean < limit_mm
    assert np.abs(np.angle(np.exp(1j * solution.states[:, 3]))).max() < 0.3


def test_the_quadruped_has_the_names_of_the_cheetah_and_of_every_map_of_its_kind():
    """The quadruped has the names of the cheetah and of every map of its kind, and a less certain size."""
    body, cheetah = body_of("quadruped"), body_of("cheetah-24")
    assert {*body.markers} - {*cheetah.markers} == {"withers", "l_ear", "r_ear"}
    assert {*cheetah.markers} < {*body.markers}
    assert body.feet_by_label() == cheetah.feet_by_label()
    for name in {*builtin_maps()} - {"coco-17", "mouse-15", "rat-23"}:
        assert {*load_names(name).names.values()} <= {*body.markers}
    assert body.size_sigma == 4 * cheetah.size_sigma
    assert body.keypoint_sigma_m > cheetah.keypoint_sigma_m
    at = expected_points(body)
    assert at["withers"][2] - at["l_front_paw"][2] == pytest.approx(0.65, abs=0.02)


# Names of sides


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("l_paw", "r_paw"),
        ("left_paw", "right_paw"),
        ("LeftHand", "RightHand"),
        ("Nearknee", "Offknee"),
        ("front_left_paw", "front_right_paw"),
        ("mouth_end_left", "mouth_end_right"),
        ("paw_left2", "paw_right2"),
        ("frontLeftPaw", "frontRightPaw"),
        ("leftHip", "rightHip"),
        ("EarLeft", "EarRight"),
        ("L_F_Paw", "R_F_Paw"),
        ("LEFT EYE", "RIGHT EYE"),
        ("paw-near", "paw-off"),
        ("eye.L", "eye.R"),
        ("hipL", "hipR"),
        ("leftear", "rightear"),
        ("LFpaw", "RFpaw"),
        ("LHip", "RHip"),
        ("earL_tip", "earR_tip"),
        ("front_l_paw_pitch", "front_r_paw_pitch"),
    ],
)
def test_sides(left, right):
    assert (other_side(left), other_side(right)) == (right, left)
    assert (side_of(left), side_of(right)) == ("left", "right")
    assert without_side(left) == without_side(right) not in (left, right)
    assert both_sides(left) == both_sides(right)


def test_names_without_their_side():
    names = ["l_paw", "front_left_paw", "mouth_end_left", "frontLeftPaw", "EarLeft", "left"]
    assert [without_side(name) for name in names] == ["paw", "front_paw", "mouth_end", "frontPaw", "Ear", "left"]
    assert both_sides("front_right_paw") == "front_left/right_paw"


@pytest.mark.parametrize(
    "name",
    [
        "nose",
        "lip",
        "rump",
        "leftover",
        "upright",
        "bright_eye",
        "L1",
        "r6",
        "tail1",
        "offspring",
        "Lip",
        "theta_3",
    ],
)
def test_the_middle(name):
    assert other_side(name) == without_side(name) == both_sides(name) == name
    assert side_of(name) is None


@pytest.mark.parametrize("skeleton", builtin_names())
def test_built_in_skeletons_state_sides_at_the_beginnings_of_names(skeleton):
    """The built-in skeletons state their sides at the beginnings of names, and reading gives the same sides."""
    body = load_skeleton(skeleton)
    names = {*body.markers, *body.state_names, *(s.name for s in body.tree.segments), *sum(body.keypoints, ())}
    pairs = (("l_", "r_"), ("Left", "Right"), ("Near", "Off"), ("left_", "right_"))
    pairs = (*pairs, ("L", "R")) if skeleton == "human-25" else pairs
    for name in names:
        expected = next(
            ((a, b + name.removeprefix(a)) for p in pairs for a, b in (p, p[::-1]) if name.startswith(a)), ("", name)
        )
        assert other_side(name) == expected[1]
        assert without_side(name) == name.removeprefix(expected[0])
        assert side_of(name) == {"": None, **dict.fromkeys([a for a, _ in pairs], "left")}.get(expected[0], "right")


def test_sides_in_the_middle_of_names(tmp_path):
    """Sides in the middle of names, such as front_left_paw, give feet, limbs, mirror images and angles."""
    middle = re.sub(r"\b(left|right|l|r)_(fore|front|hind)_", r"\2_\1_", CAT)
    assert "front_left_paw" in middle
    cat, before = load_skeleton(in_file(tmp_path, middle)), load_skeleton(in_file(tmp_path, CAT))
    assert cat.feet_by_label() == {
        "LF": "front_left_paw", "RF": "front_right_paw", "LH": "hind_left_paw", "RH": "hind_right_paw",
    }  # fmt: skip
    assert list(cat.limb_sides().values()) == list(before.limb_sides().values())
    assert {*cat.limb_sides().values()} == {"left", "right", None}
    for new, old in zip(cat.mirror, before.mirror, strict=True):
        np.testing.assert_array_equal(new, old)
    assert check_skeleton(in_file(tmp_path, middle))["remarks"] == check_skeleton(in_file(tmp_path, CAT))["remarks"]
    wrong = middle.replace('left_fore = "front_left_paw"', 'left_fore = "front_right_paw"')
    wrong = wrong.replace('right_fore = "front_right_paw"', 'right_fore = "front_left_paw"')
    with pytest.raises(InputError) as caught:
        load_skeleton(in_file(tmp_path, wrong))
    sides = [(problem.field, problem.found) for problem in caught.value.problems if "feet." in problem.field]
    assert sides == [("feet.left_fore", "'front_right_paw'"), ("feet.right_fore", "'front_left_paw'")]


def test_markers_of_other_names_are_mirrored_onto_their_segments(tmp_path):
    body = body_of(in_file(tmp_path, CAT))
    on = {marker.name: marker for marker in body.tree.markers}
    assert on["right_front_paw"].segment == "r_fore_foot"
    assert on["right_ear"].segment == "head"
    assert on["right_ear"].offset_m == (0.0, -0.03, 0.04)
    other = in_file(tmp_path, CAT.replace('"left_knee"\n', '"lknee"\n', 1))
    limbs = [(other, f"limbs.{side} hind leg", f"'{side}_knee'", "lknee") for side in ("left", "right")]
    with refusal((other, "markers[9].mirrored", "'lknee'", "front_left_paw"), *limbs):
        load_skeleton(other)


# A user's own file


def walking_cat(folder: Path) -> tuple[Path, np.ndarray, Body]:
    """Return detections of the cat of the documentation, its true joints (T, J, 3) in m, z up, and its body."""
    body = body_of(in_file(folder, CAT))
    T = 24
    states = np.zeros((T, body.n_state))
    waves = np.sin(np.linspace(0, 2 * np.pi, T)[:, None] + np.arange(body.n_state - 4))
    states[:, 4:] = body.mean_rad + 0.3 * body.sigma_rad * waves
    states[:, 0], states[:, 1] = np.linspace(-0.3, 0.3, T), 2.5
    points_m = body.tree.pose(states).points_m
    px, _ = Camera.from_hfov(40.0, (1920, 1080)).project(
        points_m @ np.array([[1.0, 0, 0], [0, 0, -1.0], [0, 1.0, 0]]).T
    )
    table = np.concatenate([px, np.ones((*px.shape[:2], 1))], axis=2).reshape(T, -1)
    columns = pd.MultiIndex.from_product(
        [["made"], body.markers, ["x", "y", "likelihood"]], names=["scorer", "bodyparts", "coords"]
    )
    pd.DataFrame(table, columns=columns).to_csv(folder / "cat.csv")
    return folder / "cat.csv", points_m, body


def test_a_file_can_replace_the_name_of_a_skeleton(tmp_path, monkeypatch):
    """A user's file can replace the name of a skeleton, with a subject file and with a prior fitted for the file."""
    keypoints, points_m, body = walking_cat(tmp_path)
    columns = pd.MultiIndex.from_product([body.markers, ["x", "y", "z"]], names=["bodyparts", "coords"])
    pd.DataFrame(points_m.reshape(len(points_m), -1), columns=columns).to_csv(tmp_path / "poses.csv")
    subject = 'skeleton = "my-cat"\ntitle = "the cat Minka"\nsize_sigma = 0.03\n[at_m]\ntail_tip = [-0.25, 0.0, 0.0]\n'
    in_file(tmp_path, subject, "minka.toml")
    monkeypatch.chdir(tmp_path)
    prior = ("prior", "fit", "poses.csv", "--skeleton", "my-cat.toml", "--fps", 24, "--out", "cat.npz")
    assert "24 frames" in output(*prior, "--components", 1)

    view = ("--hfov-deg", 40, "--image-size", "1920x1080", "--fps", 24, "--set", "fast=true", "--quiet")
    files = ("--skeleton", "my-cat.toml", "--subject", "minka.toml", "--prior", "cat.npz")
    output("fit", keypoints, *files, *view, "--out", "out")
    report = json.loads(Path("out/report.json").read_text())
    assert report["skeleton"]["name"] == "my-cat"
    assert "Minka" in report["size"]["lengths"]
    assert report["prior"]["name"] == "cat"

    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    output("fit", "--config", tmp_path / "out" / "config.toml", "--out", "again", "--quiet")
    one, other = (pd.read_csv(folder / "pose3d.csv", header=[0, 1]) for folder in (tmp_path / "out", Path("again")))
    pd.testing.assert_frame_equal(one, other)


def test_a_chain_may_extend_a_file_in_the_same_folder(tmp_path, monkeypatch):
    chain = Path(__file__).parents[2] / "recon" / "animal" / "skeletons" / "cheetah-8u.toml"
    in_file(tmp_path, chain.read_text(encoding="utf-8"), "base.toml")
    own = in_file(
        tmp_path, 'extends = "base.toml"\nname = "mine"\ntitle = "longer"\n[length_m]\nr5 = 0.5\n', "mine.toml"
    )
    monkeypatch.chdir("/")
    check = check_skeleton(own)
    assert (check["name"], check["kind"]) == ("mine", "chain")
    assert next(part["length_m"] for part in check["parts"] if part["name"] == "J1") == pytest.approx(0.5)


# recon skeleton


def test_list():
    printed = json.loads(output("skeleton", "list", "--json"))
    found = {row["name"]: row for row in printed}
    assert {*found} == {*builtin_names()}
    assert (found["dog-27"]["markers"], found["horse-22"]["markers"]) == (27, 22)
    assert {name for name, row in found.items() if row["kind"] == "chain"} == {*builtin_chains()}
    assert [row["name"] for row in printed] == list(builtin_names())
    assert "horse-22" in output("skeleton", "list")


@pytest.mark.parametrize("name", builtin_names())
def test_built_in_skeletons_have_no_remarks(name):
    check = check_skeleton(name)
    no_feet = ["feet: none. Contacts with the ground and gait need them."]
    assert check["remarks"] == (no_feet if name == "mouse-top" else [])
    assert check["prior"] == {"cheetah-24": "running-cheetah"}.get(name, "none")
    base_length = check["kind"] == "chain"  # for a chain, unknowns of the frame method
    assert check["unknowns"] - base_length == load_skeleton(name).n_state
    assert sum(len(part["angles"]) for part in check["parts"]) == load_skeleton(name).n_state - 4
    if check["kind"] == "chain":
        assert f"{len(check['markers'])} markers and 21 unknowns a frame" in output("skeleton", "check", name)


def test_check_lists_what_is_in_a_file(tmp_path):
    file = in_file(tmp_path, CAT)
    check = check_skeleton(file)
    assert (check["kind"], len(check["markers"]), check["unknowns"], check["prior"]) == ("whole animal", 19, 27, "none")
    shin = next(part for part in check["parts"] if part["name"] == "l_hind_shin")
    (angle,) = shin["angles"]
    assert (shin["parent"], shin["joint"], shin["length_m"]) == ("l_hind_thigh", "hinge", 0.11)
    # The file states a mean of 1.3 rad, a sigma of 0.5 rad (the range is ±2 sigma), and 250 rad/s^2.
    assert [angle[of] for of in ("mean_deg", "low_deg", "high_deg")] == pytest.approx([74.48, 17.19, 131.78], abs=0.01)
    assert angle["rate"] == "14324 °/s²"
    text = output("skeleton", "check", file)
    assert "r_hind_shin" in text
    assert "17 to 132" in text
    assert "No value is unusual." in text
    assert "keypoints within 4 mm" in output("skeleton", "check", "mouse-top")
    plain = json.loads(output("skeleton", "check", file, "--json"))
    assert [part["name"] for part in plain["parts"]] == [part["name"] for part in check["parts"]]
    assert plain["markers"][-1] == {"name": "right_hind_paw", "segment": "r_hind_foot", "at_m": [0.0, 0.0, -0.07]}


def test_check_of_a_chain():
    text = output("skeleton", "check", "cheetah-8u")
    # J2 begins where the link r1 ends: 0.203 m x 1.547
    (row,) = (line.split() for line in text.splitlines() if line.split()[:3] == ["J2", "J1", "0.314"])
    body = load_skeleton("cheetah-8u")
    i = body.state_names.index("phi_2") - 4
    ends = np.degrees(body.mean_rad[i] + np.array([-2, 2]) * body.sigma_rad[i])
    assert row[3:6] == [f"{ends[0]:.0f}", "to", f"{ends[1]:.0f}"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('["tail_base", "withers"]', '["withers", "tail_base"]', ["forward:", "tail_base is not ahead"]),
        ('left_fore = "left_front_paw"', 'left_fore = "left_ear"', ["feet: not below", "left_ear."]),
        (
            '"left_front_paw"\nright_fore = "right_front_paw"\nleft_hind = "left_hind_paw"',
            '"left_hind_paw"\nright_fore = "right_front_paw"\nleft_hind = "left_front_paw"',
            ["feet:", "left_hind_paw lies behind", "fore foot"],
        ),
        (
            'left_fore = "left_front_paw"\nright_fore = "right_front_paw"',
            'left_fore = "left_ear"\nright_fore = "right_ear"',
            ["feet: left_ear and right_ear are on one segment, head,", "animal walks"],
        ),
        ("at_m = [0.0, 0.03, 0.04]", "at_m = [0.0, -0.03, 0.04]", ["to the left): left_ear, right_ear."]),
        (CAT[CAT.index("left_fore") : CAT.index("# The root:")], "", ["feet: none."]),
        (
            'name = "left_knee"\nsegment = "l_hind_shin"\nmirrored = true',
            'name = "left_knee"\nsegment = "l_hind_shin"\n[[markers]]\nname = "right_knee"\nsegment = "l_hind_shin"',
            ["to the left): right_knee."],
        ),
        (
            'name = "left_ear"\nsegment = "head"\nmirrored = true\nat_m = [0.0, 0.03, 0.04]',
            'name = "left_ear"\nsegment = "head"\nat_m = [0.0, 0.03, 0.04]\n'
            '[[markers]]\nname = "right_ear"\nsegment = "head"\nat_m = [0.0, -0.02, 0.04]',
            ["mirror images", "left_ear."],
        ),
    ],
)
def test_remarks(tmp_path, old, new, words):
    assert old in CAT
    file = in_file(tmp_path, CAT.replace(old, new, 1))
    assert any(says(found, *words) for found in check_skeleton(file)["remarks"])
    assert "note: " in output("skeleton", "check", file)


def test_a_file_can_state_sides_and_ends(tmp_path):
    """The file can state sides and ends: near is left and off is right.

    The stated foot counts if its name does not say which foot it is.
    """
    horse = load_skeleton("horse-22")
    assert horse.feet_by_label() == {
        "LF": "Nearfrontfoot",
        "RF": "Offfrontfoot",
        "LH": "Nearhindfoot",
        "RH": "Offhindfoot",
    }
    sides = horse.limb_sides()
    assert [sides[f"{side} {end} leg"] for side in ("near", "off") for end in ("fore", "hind")] == [
        "left",
        "left",
        "right",
        "right",
    ]
    assert {sides[limb] for limb in ("trunk", "head", "shoulder", "thigh")} == {None}
    paw = 'name = "left_front_paw"\nsegment = "l_fore_foot"\nmirrored = true'
    assert paw in CAT
    two = 'name = "FL"\nsegment = "l_fore_foot"\n\n[[markers]]\nname = "FR"\nsegment = "r_fore_foot"'
    text = CAT.replace(paw, two).replace('"left_front_paw"', '"FL"').replace('"right_front_paw"', '"FR"')
    cat = load_skeleton(in_file(tmp_path, text))
    assert [cat.side_of(m) for m in ("FL", "FR", "left_ear", "withers")] == ["left", "right", "left", None]
    assert cat.feet_by_label()["RF"] == "FR"
    leg = dict(cat.limbs, alone=("withers", "FR"))
    assert replace(cat, limbs=leg).limb_sides()["alone"] == "right"


def test_every_fault_is_named(tmp_path):
    text = CAT.replace('parent = "loin"', 'parent = "lion"', 1).replace('left_fore = "left', 'left_fore = "lift')
    text = text.replace('tail = ["tail_base"', 'tail = ["tail"').replace('segment = "tail"', 'segment = "tale"', 1)
    with pytest.raises(InputError) as error:
        skeleton_check(_SkeletonCheckSettings(skeleton=str(in_file(tmp_path, text)), out=tmp_path / "out"))
    fields = [problem.field for problem in error.value.problems]
    assert fields == ["segments[1].parent", "markers[4].segment", "feet", "limbs.tail"]
    assert not (tmp_path / "out").exists()
    with refusal(("--skeleton", "name or file", "'unicorn'", "dog-27, horse-22, human-25, mouse-top, quadruped, rat")):
        check_skeleton("unicorn")


@pytest.mark.slow
@pytest.mark.usefixtures("small_pictures")
def test_pictures(tmp_path):
    file, out = in_file(tmp_path, CAT), tmp_path / "pictures"
    skeleton_check(_SkeletonCheckSettings(skeleton=str(file), out=out))
    names = ["angles.png", "angles.svg", "skeleton.png", "skeleton.svg"]
    assert sorted(path.name for path in out.iterdir()) == [RECORD, *names]
    picture = (out / "skeleton.svg").read_text(encoding="utf-8")
    assert "left/right_knee" in picture  # both are at the same point in the side view
    assert all(marker in picture for marker in body_of(file).markers)
    angles = (out / "angles.svg").read_text(encoding="utf-8")
    assert "l hind shin pitch" in angles
    assert "17° to 132°" in angles
    assert "r hind shin" not in angles
    with refusal(("--out", "folder", ["skeleton.png and 3 more", out], "--overwrite")):
        skeleton_check(_SkeletonCheckSettings(skeleton=str(file), out=out))
    skeleton_check(_SkeletonCheckSettings(skeleton="cheetah-8u", out=out, overwrite=True))
    assert "theta 1" in (out / "angles.svg").read_text(encoding="utf-8")


# Recordings


def test_the_horse_on_its_recording(shared_data):
    """The horse skeleton fits hand labels of a led horse in pictures of 288x162, by reprojection error and heading."""
    file = shared_data / "horse-side" / "CollectedData_Byron.csv"
    keypoints: Keypoints = read_keypoints(file)
    assert {*keypoints.names} == {*HORSE}
    motion = fit_clip(
        FitSettings(
            keypoints=file,
            hfov_deg=50,
            image_size_px=(288, 162),
            fps=24,
            skeleton="horse-22",
            frames="150:180",
            fast=True,
        )
    )
    assert isinstance(motion, Motion)
    solution = motion.solution
    assert solution.status == "converged"
    px, _ = motion.camera.project(solution.joints_camera_m)
    off = np.linalg.norm(px - motion.keypoints.xy_px, axis=-1)
    assert np.nanmedian(off) < 2.5
    # The animal moves to the right and towards the camera, since it grows in the picture.
    assert -0.7 < np.median(solution.states[:, 3]) < 0.0


def test_the_dog_on_its_recording(shared_data):
    """The dog skeleton fits a side view of one second of walking, in a recording whose y axis points up."""
    names = json.loads((shared_data / "dog-mocap" / "joints.json").read_text())["joints"]
    assert names == list(dict.fromkeys(names))
    assert {*names} == {*DOG}
    rows = np.loadtxt(shared_data / "dog-mocap" / "dog_walk03_joint_pos.txt", delimiter=",", usecols=range(81))
    points = rows.reshape(-1, 27, 3)[300:345][..., [2, 0, 1]]
    body = body_of("dog-27")
    points = points[:, [names.index(m) for m in body.markers]] - points[:, :1].mean(axis=0)
    truth_m = np.stack([points[..., 0], -points[..., 2], points[..., 1] + 6.0], axis=-1)
    camera = Camera.from_hfov(30.0, (1920, 1080))
    px, _ = camera.project(truth_m)
    px += np.random.default_rng(0).normal(0, 2, px.shape)
    fast = TrajectoryOptions(fast=True)
    view = still_view(camera, px, np.ones(px.shape[:2]))
    solution = solve_trajectory([view], body, prior_from_body(body), 60.0, fast)
    assert solution.status == "converged"
    assert 1000 * score(joint_errors(aligned(solution.joints_camera_m, truth_m), truth_m)).mean < 45
