"""Test the built-in skeletons, their mirror images, skeleton and subject files, and chains as bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import compare, refusal, says

from recon import InputError
from recon.animal.body import Body, other_side
from recon.animal.chain import builtin_chains
from recon.animal.naming import load_names
from recon.animal.skeleton_file import builtin_names, builtin_subjects, load_skeleton
from recon.geometry.frames import euler_rotation, rigid
from recon.thesis.chain import UnknownsChain, load_chain

DOCS = (Path(__file__).parents[2] / "docs" / "skeletons.md").read_text(encoding="utf-8")
SUBJECT = DOCS.split("```toml")[1].split("```")[0]
EXAMPLE = (Path(__file__).parents[1] / "files" / "trunk-and-front-legs.toml").read_text()

MARKERS = (
    *("nose", "r_eye", "l_eye", "neck_base", "spine", "tail_base", "tail1", "tail2"),
    *("r_shoulder", "r_front_knee", "r_front_ankle", "r_front_paw"),
    *("l_shoulder", "l_front_knee", "l_front_ankle", "l_front_paw"),
    *("r_hip", "r_back_knee", "r_back_ankle", "r_back_paw", "l_hip", "l_back_knee", "l_back_ankle", "l_back_paw"),
)
LEGS_M = {
    None: ((0.25, 0.275, 0.14), (0.265, 0.31, 0.255)),
    "phantom": ((0.26, 0.27, 0.125), (0.26, 0.29, 0.265)),
    "jules": ((0.24, 0.28, 0.155), (0.27, 0.33, 0.245)),
}


@pytest.fixture(params=builtin_names())
def body(request: pytest.FixtureRequest) -> Body:
    return load_skeleton(request.param)


@pytest.fixture(params=builtin_chains())
def chain(request: pytest.FixtureRequest) -> UnknownsChain:
    return load_chain(request.param)


def example_body() -> Body:
    return load_skeleton("cheetah-24")


def random_states(body: Body, n: int) -> np.ndarray:
    """Return n random states: poses around the expected one, at any position and with any heading."""
    rng = np.random.default_rng(0)
    angles = rng.normal(body.mean_rad, body.sigma_rad, (n, body.n_state - 4))
    return np.concatenate([rng.uniform(-5, 5, (n, 3)), rng.uniform(-3, 3, (n, 1)), angles], axis=1)


def in_file(folder: Path, text: str, name: str = "body.toml") -> Path:
    file = folder / name
    file.write_text(text)
    return file


def problems(file: Path, subject: Path | None = None) -> dict[str, tuple[str, str]]:
    """Return the problems for which a file is refused: for each field, the found and the expected value."""
    with pytest.raises(InputError) as error:
        load_skeleton(file, subject)
    return {p.field: (p.found, p.expected) for p in error.value.problems}


def test_jacobian_against_central_differences(body: Body):
    states, sizes, h = random_states(body, 10), np.linspace(0.8, 1.2, 10), 1e-5
    exact = body.tree.pose_with_jacobian(states, sizes)
    steps = h * np.eye(body.n_state)
    columns = [
        (body.tree.pose(states + s, sizes).points_m - body.tree.pose(states - s, sizes).points_m) / (2 * h)
        for s in steps
    ]
    np.testing.assert_allclose(exact.jacobian, np.stack(columns, axis=-1), rtol=0, atol=1e-7)
    larger, smaller = (body.tree.pose(states, sizes * np.exp(s)).points_m for s in (h, -h))
    np.testing.assert_allclose(exact.d_size, (larger - smaller) / (2 * h), rtol=0, atol=1e-7)


def test_a_body_is_complete(body: Body):
    assert len(body.markers) == len(set(body.markers)) == len(body.tree.markers)
    assert len(body.state_names) == len(set(body.state_names)) == body.n_state
    assert body.mean_rad.shape == body.sigma_rad.shape == body.acceleration_rad_s2.shape == (body.n_state - 4,)
    assert (body.sigma_rad > 0).all()
    assert (body.acceleration_rad_s2 > 0).all()
    assert {*body.forward, *body.feet, *(m for limb in body.limbs.values() for m in limb)} <= {*body.markers}
    assert len(body.feet) >= 2 or body.name == "mouse-top"  # a camera above a mouse does not see its paws


def test_the_expected_pose_stands_on_its_feet_and_faces_forwards(body: Body):
    state = np.concatenate([np.zeros(4), body.mean_rad])[None]
    at = dict(zip(body.markers, body.tree.pose(state).points_m[0], strict=True))
    rear, front = (at[name] for name in body.forward)
    assert front[0] - rear[0] > {"human-25": 0.1, "mouse-top": 0.055, "rat": 0.13}.get(body.name, 0.35)
    above_feet_m = 0.04 if body.name == "rat" else 0.3
    assert all(at[foot][2] < min(rear[2], front[2]) - above_feet_m for foot in body.feet)


def test_mirror(body: Body):
    permutation, sign = body.mirror
    states = random_states(body, 20)
    mirrored = states[:, permutation] * sign
    np.testing.assert_array_equal(mirrored[:, permutation] * sign, states)
    swapped = [
        body.markers.index(other_side(m)) if other_side(m) in body.markers else i for i, m in enumerate(body.markers)
    ]
    expected = body.tree.pose(states).points_m[:, swapped] * [1, -1, 1]
    np.testing.assert_allclose(body.tree.pose(mirrored).points_m, expected, rtol=0, atol=1e-12)
    expectations = np.stack([body.mean_rad, body.sigma_rad, body.acceleration_rad_s2])
    signs = np.stack([sign[4:], np.abs(sign[4:]), np.abs(sign[4:])])
    np.testing.assert_array_equal(expectations[:, permutation[4:] - 4] * signs, expectations)


def test_a_body_is_recovered_from_its_own_points(body: Body):
    """Gauss-Newton iterations from a nearby pose recover the points and the size."""
    truth = random_states(body, 5)
    target = body.tree.pose(truth, 1.1).points_m
    state, size = truth + np.random.default_rng(1).normal(0, 0.05, truth.shape), np.ones(5)
    for _ in range(30):
        posed = body.tree.pose_with_jacobian(state, size)
        J = np.concatenate([posed.jacobian, posed.d_size[..., None]], axis=-1).reshape(5, -1, body.n_state + 1)
        step = np.linalg.pinv(J, rcond=1e-6) @ (target - posed.points_m).reshape(5, -1, 1)
        state, size = state + step[:, :-1, 0], size * np.exp(step[:, -1, 0])
    np.testing.assert_allclose(body.tree.pose(state, size).points_m, target, rtol=0, atol=1e-9)
    np.testing.assert_allclose(size, 1.1, rtol=1e-9)


def test_the_cheetah():
    body = example_body()
    assert {*body.markers} == {*MARKERS}
    assert body.n_state == 28
    assert body.state_names[:6] == ("x_m", "y_m", "z_m", "rear_trunk_yaw", "rear_trunk_pitch", "rear_trunk_roll")
    at = dict(zip(body.markers, body.tree.pose(np.zeros((1, 28))).points_m[0], strict=True))
    np.testing.assert_allclose(at["tail_base"], [-0.296, 0, 0], atol=1e-12)
    np.testing.assert_allclose(at["l_hip"], [-0.236, 0.06, -0.1], atol=1e-12)
    np.testing.assert_allclose(at["r_shoulder"], [0.384, -0.075, -0.15], atol=1e-12)
    np.testing.assert_allclose(at["tail2"], [-0.936, 0, 0], atol=1e-12)
    np.testing.assert_allclose(at["r_eye"], [0.774, -0.045, 0], atol=1e-12)


@pytest.mark.parametrize("subject", [None, *builtin_subjects()])
def test_measured_lengths(subject: str | None):
    body = load_skeleton("cheetah-24", subject)
    assert body.size_sigma == (0.1 if subject is None else 0.02)
    assert body.title.endswith("24 markers" if subject is None else str(subject).capitalize())
    at = dict(zip(body.markers, body.tree.pose(random_states(body, 5)).points_m.transpose(1, 0, 2), strict=True))
    for side in "lr":
        for leg, (_, lower, foot) in zip(("front", "back"), LEGS_M[subject], strict=True):
            knee, ankle, paw = (at[f"{side}_{leg}_{joint}"] for joint in ("knee", "ankle", "paw"))
            np.testing.assert_allclose(np.linalg.norm(ankle - knee, axis=1), lower, rtol=1e-12)
            np.testing.assert_allclose(np.linalg.norm(paw - ankle, axis=1), foot, rtol=1e-12)
    upper = {s.name: -s.offset_m[2] for s in body.tree.segments}
    assert (upper["l_fore_lower"], upper["r_hind_shin"]) == tuple(lengths[0] for lengths in LEGS_M[subject])


def test_the_documented_example_and_its_subject(tmp_path: Path):
    file, subject = in_file(tmp_path, EXAMPLE), in_file(tmp_path, SUBJECT, "subject.toml")
    body, measured = load_skeleton(file), load_skeleton(file, subject)
    assert body.markers == measured.markers
    assert body.markers[3:] == ("l_front_knee", "r_front_knee", "l_front_paw", "r_front_paw")
    assert (measured.title, measured.size_sigma) == ("trunk and front legs, lengths measured on one animal", 0.02)
    points = measured.tree.pose(np.zeros((1, body.n_state))).points_m[0]
    np.testing.assert_allclose(points[5:], [[0.44, 0.1, -0.67], [0.44, -0.1, -0.67]], atol=1e-12)


def test_keypoints_off_their_markers(tmp_path: Path):
    """A subject's offset applies to both sides, mirrored, and moves the detected points but not the returned joints."""
    offset = SUBJECT + "\n[keypoint_offset_m]\nl_front_paw = [0.01, 0.02, 0.03]\n"
    body = load_skeleton(in_file(tmp_path, EXAMPLE), in_file(tmp_path, offset, "subject.toml"))
    assert body.keypoint_offset_m == {"l_front_paw": (0.01, 0.02, 0.03), "r_front_paw": (0.01, -0.02, 0.03)}
    still = np.zeros((1, body.n_state))
    off = body.detected.pose(still).points_m[0] - body.tree.pose(still).points_m[0]
    np.testing.assert_allclose(off[5:], [[0.01, 0.02, 0.03], [0.01, -0.02, 0.03]], atol=1e-12)
    assert not off[:5].any()
    wrong = in_file(tmp_path, offset.replace("l_front_paw = [0.01", "l_wing = [0.01"), "s.toml")
    assert "keypoint_offset_m.l_wing" in problems(in_file(tmp_path, EXAMPLE), wrong)


def test_mirrored_segments_expect_the_mirror_image(tmp_path: Path):
    angles = '"ball"\nmirrored = true\nat_m = [0.0, 0.1, 0.0]\n' + "\n".join(
        f"{a} = {{ mean_rad = 0.2, sigma_rad = 0.1, acceleration_rad_s2 = 1.0 }}" for a in ("yaw", "pitch", "roll")
    )
    leg = f'[[segments]]\nname = "l_ear"\nparent = "front_trunk"\njoint = {angles}\n\n[[markers]]'
    body = load_skeleton(in_file(tmp_path, EXAMPLE.replace("[[markers]]", leg, 1)))
    means = dict(zip(body.state_names[4:], body.mean_rad, strict=True))
    assert [means[f"l_ear_{a}"] for a in ("yaw", "pitch", "roll")] == [0.2, 0.2, 0.2]
    assert [means[f"r_ear_{a}"] for a in ("yaw", "pitch", "roll")] == [-0.2, 0.2, -0.2]


@pytest.mark.parametrize(
    ("old", "new", "field", "expected"),
    [
        ('parent = "front_trunk"', 'parent = "trunk"', "segments[2].parent", "earlier segment"),
        ('parent = "front_trunk"', 'parent = "l_lower_leg"', "segments[2].parent", "earlier segment"),
        ('parent = "rear_trunk"\n', "", "segments[1].parent", "earlier segment"),
        ('name = "spine"', 'name = "rear_trunk"', "markers[0].name", "no earlier"),
        ('name = "l_upper_leg"', 'name = "rear_trunk"', "segments[2].name", "no earlier"),
        ('name = "front_trunk"', 'name = "r_upper_leg"', "segments[2].name", "no earlier"),
        ('segment = "rear_trunk"', 'segment = "trunk"', "markers[0].segment", "of a segment"),
        ('joint = "free"', 'joint = "ball"', "segments[0].joint", "joint = free"),
        ('joint = "hinge"', 'joint = "free"', "segments[2].joint", "only the root"),
        ('joint = "free"', 'joint = "free"\nparent = "x"', "segments[0].parent", "no parent"),
        ('joint = "free"', 'joint = "free"\nat_m = [1, 0, 0]', "segments[0].at_m", "no parent, at_m"),
        ('joint = "free"', 'joint = "free"\nmirrored = true', "segments[0].mirrored", "at_m or mirrored"),
        (
            'joint = "universal"',
            'joint = "ball"',
            "segments[1].roll",
            ["yaw and pitch and roll", "ball"],
        ),
        ('joint = "universal"', 'joint = "hinge"', "segments[1].yaw", ["pitch", "hinge"]),
        ('joint = "universal"', 'joint = "fixed"', "segments[1].pitch", ["no angle", "fixed"]),
        ('joint = "universal"', 'joint = "summed"', "segments[1].joint", "'free', 'ball', 'universal', 'hinge'"),
        ("roll = {", "yaw = {", "segments[0].yaw", ["pitch and roll", "free"]),
        ('["tail_base", "neck_base"]', '["tail", "neck_base"]', "forward", "one of l_front_knee"),
        ('["tail_base", "neck_base"]', '["spine", "spine"]', "forward", "two markers"),
        ('left_fore = "l_', 'left_fore = "x_', "feet", "one of l_front_knee"),
        ("[feet]", "[foot]", "feet", "left_fore = "),
        ("left_fore =", "front_left =", "feet", "left_fore = "),
        ("left_fore =", "right_hind =", "feet.right_hind", ["a right foot", "left"]),
        ('"r_front_paw"\n', '"l_front_paw"\n', "feet", "every foot once"),
        ('trunk = ["tail_base"', 'trunk = ["tail"', "limbs.trunk", "one of l_front_knee"),
        ('name = "spine"', 'name = "spine"\nmirrored = true', "markers[0].mirrored", "left side"),
        ("sigma_rad = 0.25", "sigma_rad = 0.0", "segments[0].pitch.sigma_rad", "greater than"),
        ("at_m = [-0.3, 0.0, 0.0]", "at_m = [-0.3, nan, 0.0]", "markers[1].at_m[1]", "a finite number"),
        ("[limbs]", "[limb]", "limbs", "a table"),
        ("size_sigma = 0.1", 'extends = "cheetah-24"', "extends", "name, title, forward, feet"),
    ],
)
def test_bad_files(tmp_path: Path, old: str, new: str, field: str, expected: str | list[str]):
    assert old in EXAMPLE
    file = in_file(tmp_path, EXAMPLE.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        load_skeleton(file)
    found = [problem for problem in error.value.problems if problem.field == field]
    assert len(error.value.problems) == len({*error.value.problems})
    compare(found[-1:], [(file, field, "", expected)])


def test_every_problem_is_named(tmp_path: Path):
    text = EXAMPLE.replace('parent = "front_trunk"', 'parent = "trunk"').replace('left_fore = "l_', 'left_fore = "x_')
    subject = SUBJECT.replace("l_lower_leg", "r_lower_leg").replace("l_front_paw", "rear_trunk")
    found = problems(in_file(tmp_path, text), in_file(tmp_path, subject, "subject.toml"))
    assert {*found} == {"segments[2].parent", "feet", "at_m.r_lower_leg", "at_m.rear_trunk"}
    assert says(found["at_m.rear_trunk"][1], "segment", "marker", "trunk-and-front-legs: front_trunk")
    found = problems(
        in_file(tmp_path, EXAMPLE.replace('title = "trunk and both front legs"', "name_ = 3")),
        in_file(tmp_path, SUBJECT.replace("0.02", "-1"), "subject.toml"),
    )
    assert {*found} == {"title", "name_", "size_sigma"}


def test_too_few_markers_are_refused(tmp_path: Path):
    kept = EXAMPLE.split("[[markers]]")
    found = problems(in_file(tmp_path, "[[markers]]".join(kept[:4]) + "\n[limbs]\n"))
    assert found["markers"][0] == "3 markers"
    assert says(found["markers"][1], "at least 5")


def test_subjects_belong_to_one_body(tmp_path: Path):
    other = in_file(tmp_path, SUBJECT.replace("front-legs", "legs"), "s.toml")
    with refusal((other, "skeleton", "'trunk-and-legs'", "'trunk-and-front-legs'")):
        load_skeleton(in_file(tmp_path, EXAMPLE), other)
    with refusal(("--subject", "name or file", "'phantom'", "skeleton cheetah-8u")):
        load_skeleton("cheetah-8u", subject="phantom")
    with refusal(("--subject", "name or file", "'unicorn'", "jules, phantom")):
        load_skeleton("cheetah-24", subject="unicorn")
    with refusal(("body.toml", "content", "Invalid value", "TOML")):
        load_skeleton("cheetah-24", subject=in_file(tmp_path, "at_m = "))


def test_a_body_is_not_a_chain(tmp_path: Path):
    with refusal(("--skeleton", "name or file", "'cheetah-24'", ["frame method", "cheetah-8u, cheetah-8u-jules"])):
        load_chain("cheetah-24")
    with refusal(("body.toml", "extends", "skeleton cheetah-24", "subject file")):
        load_skeleton(in_file(tmp_path, 'extends = "cheetah-24"'))
    assert "cheetah-24" in builtin_names()
    assert "cheetah-24" not in builtin_chains()


def test_a_chain_is_posed_as_its_body_is(chain: UnknownsChain):
    """A chain and its body have the same pose, for a camera that stands still or moves."""
    body = chain.body
    assert body.markers == chain.joints
    rng = np.random.default_rng(3)
    states = rng.uniform(-1.5, 1.5, (20, chain.n_state))
    states[:, chain.position_slice] *= 5.0
    states[:, chain.base_index] = chain.nominal_base_length_m * rng.uniform(0.8, 1.2, 20)
    in_camera = chain.pose(states).joints_m
    for several in ((), (20,)):
        T_world_camera = rigid(euler_rotation(rng.uniform(-1.5, 1.5, (*several, 3))), rng.normal(size=(*several, 3)))
        found, sizes = chain.to_body(states, T_world_camera)
        R, position = T_world_camera[..., :3, :3], T_world_camera[..., None, :3, 3]
        expected = in_camera @ R.swapaxes(-1, -2) + position
        np.testing.assert_allclose(body.tree.pose(found, sizes).points_m, expected, atol=1e-12)


def test_a_chain_keeps_its_expected_angles_as_a_body():
    chain = load_chain("cheetah-8u")
    body = chain.body
    expected = {
        name: values
        for name, *values in zip(
            body.state_names[4:], body.mean_rad, body.sigma_rad, body.acceleration_rad_s2, strict=True
        )
    }
    assert expected["J0_pitch"] == [0.0, 0.3, 40.0]
    assert expected["J0_roll"] == [0.0, 0.12, 40.0]
    # a swing through the range at the fastest rate: rate^2 / tolerance / sqrt(2)
    assert expected["theta_7"] == [1.7, 0.8, pytest.approx(30**2 / 1.1 / np.sqrt(2))]
    assert expected["theta_1"] == [0.05, 0.8, pytest.approx(8**2 / 0.45 / np.sqrt(2))]
    assert expected["phi_4"] == [0.0, 0.15, pytest.approx(10**2 / 0.5 / np.sqrt(2))]
    assert body.feet == ("J8", "J4")
    assert body.size_sigma == pytest.approx(0.02 / 0.203)
    names = [body.state_names[i] for i in chain.body_angles]
    assert (names[0], names[7]) == ("theta_6", "phi_6")


def test_the_rat_has_the_23_points_of_its_map():
    body, names = load_skeleton("rat"), load_names("rat-23").names
    assert len(names) == 23
    assert {*names.values()} <= {*body.markers}
    assert names["SpineL"] == "lower_back"
    assert names["HandR"] == "r_front_paw"
    points_m = body.tree.pose(np.concatenate([np.zeros(4), body.mean_rad])[None]).points_m[0]
    at = dict(zip(body.markers, points_m, strict=True))
    assert np.linalg.norm(at["l_hip"] - at["l_back_knee"]) == pytest.approx(0.036)
    assert np.linalg.norm(at["nose"] - at["tail_base"]) == pytest.approx(0.2, abs=0.02)
