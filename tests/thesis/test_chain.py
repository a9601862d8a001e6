"""Test link lengths, Jacobians and files of chains."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import refusal

from recon import InputError
from recon.animal.chain import builtin_chains
from recon.thesis.chain import UnknownsChain, load_chain

LINKS = ("r5", "r1", "r2", "r3", "r4", "r6", "r7", "r8")
MEASURED_M = {
    "cheetah-8u-phantom": (0.296, 0.444, 0.284, 0.27, 0.125, 0.277, 0.29, 0.265),
    "cheetah-8u-jules": (0.296, 0.444, 0.266, 0.28, 0.155, 0.286, 0.33, 0.245),
}


@pytest.fixture(params=builtin_chains())
def skeleton(request: pytest.FixtureRequest) -> UnknownsChain:
    return load_chain(request.param)


def random_states(skeleton: UnknownsChain, n: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    states = rng.uniform(-3, 3, (n, skeleton.n_state))
    states[:, skeleton.base_index] = rng.uniform(0.1, 0.3, n)
    return states


def test_links_keep_their_lengths_for_any_angles(skeleton: UnknownsChain):
    states = random_states(skeleton, 200)
    joints = skeleton.local_joints(states)
    at = {name: joints[:, i] for i, name in enumerate(skeleton.joints)}
    for link in skeleton.links:
        length = np.linalg.norm(at[link.end] - at[link.start], axis=1)
        np.testing.assert_allclose(length, link.length_ratio * states[:, -1], rtol=0, atol=1e-12)


def test_jacobian_against_central_differences(skeleton: UnknownsChain):
    states, h = random_states(skeleton, 10), 1e-5
    exact = skeleton.pose_with_jacobian(states)
    steps = h * np.eye(skeleton.n_state)
    columns = [(skeleton.pose(states + s).joints_m - skeleton.pose(states - s).joints_m) / (2 * h) for s in steps]
    numeric = np.stack(columns, axis=-1)
    error = np.linalg.norm((exact.joints_jacobian - numeric).reshape(10, -1), axis=1)
    assert np.all(error <= 1e-6 * np.linalg.norm(numeric.reshape(10, -1), axis=1))
    np.testing.assert_allclose(exact.joints_m, skeleton.pose(states).joints_m, atol=1e-12)


def test_the_8u_chain_has_the_published_unknowns():
    skeleton = load_chain("cheetah-8u")
    assert skeleton.state_names == (
        *(f"theta_{i}" for i in (6, 7, 8, 1, 2, 3, 4)),
        *(f"phi_{i}" for i in (6, 7, 8, 1, 2, 3, 4)),
        *("x0_m", "y0_m", "z0_m", "xi", "psi", "zeta", "base_length_m"),
    )
    assert skeleton.body.keypoint_names("left")[:5] == (
        *("tail_base", "l_back_knee", "l_back_ankle", "l_back_paw"),
        "spine",
    )
    assert skeleton.body.keypoint_names("right")[-1] == "r_front_paw"


def test_a_pose_by_hand():
    """The spine lies along U, and the first link of the front leg is turned down by theta, then sideways by phi."""
    skeleton = load_chain("cheetah-8u")
    state = np.zeros((1, 21))
    state[0, 20] = 0.2
    state[0, skeleton.state_names.index("theta_2")] = np.pi / 2
    joints = dict(zip(skeleton.joints, skeleton.local_joints(state)[0], strict=True))
    np.testing.assert_allclose(joints["J1"], [0.2 * (2.045 + 1.545), 0, 0], atol=1e-15)
    np.testing.assert_allclose(joints["J4"] - joints["J1"], [0, 0.2 * (1.273 + 1.364 + 1), 0], atol=1e-15)
    state[0, skeleton.state_names.index("theta_2")] = 0
    state[0, skeleton.state_names.index("phi_2")] = np.pi / 2
    joints = dict(zip(skeleton.joints, skeleton.local_joints(state)[0], strict=True))
    np.testing.assert_allclose(joints["J2"] - joints["J1"], [0, 0, 0.2 * 1.273], atol=1e-15)


@pytest.mark.parametrize("name", MEASURED_M)
def test_measured_lengths(name: str):
    skeleton = load_chain(name)
    lengths = {link.name: link.length_ratio * skeleton.nominal_base_length_m for link in skeleton.links}
    assert lengths == pytest.approx(dict(zip(LINKS, MEASURED_M[name], strict=True)), abs=1e-12)


def test_every_problem_of_a_file_is_named(tmp_path):
    text = (
        'extends = "cheetah-8u"\nname = "x"\nforward = ["J0", "J99"]\nkeypoint_sigma_m = -1\ncolour = "red"\n'
        "[base_length]\nnominal_m = 0.1\nsigma_m = 'a'\n"
    )
    file = tmp_path / "x.toml"
    file.write_text(text)
    with pytest.raises(InputError) as error:
        load_chain(file)
    assert {p.field for p in error.value.problems} == {"keypoint_sigma_m", "base_length.sigma_m", "colour"}


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ('extends = "cheetah-8u"\nforward = ["J0", "J99"]', "forward"),
        ('extends = "cheetah-8u"\n[length_m]\nr99 = 1.0', "length_m.r99"),
        ('extends = "cheetah-8u"\nlength_m = 3', "length_m"),
        ('extends = "cheetah-8u"\nbase_length = 3\n[length_m]\nr1 = 1.0', "base_length"),
        (
            'extends = "cheetah-8u"\n[base_length]\nnominal_m = 0\nsigma_m = 1\n[length_m]\nr1 = 1.0',
            "base_length.nominal_m",
        ),
        ("extends = 3", "extends"),
        ('extends = "cheetah-8u-jules"', "extends"),
        ("name = ", "content"),
        ('extends = "cheetah-8u"\nkeypoint_sigma_m = inf', "keypoint_sigma_m"),
        ('extends = "cheetah-8u"\nsoftness_rad = 0', "softness_rad"),
        ('extends = "cheetah-8u"\nsoftness_rad = 1e-320', "softness_rad"),
    ],
)
def test_bad_files(tmp_path, text: str, field: str):
    file = tmp_path / "x.toml"
    file.write_text(text)
    with pytest.raises(InputError) as error:
        load_chain(file)
    assert [p.field for p in error.value.problems] == [field]


def test_an_unknown_name_lists_the_known_names():
    with refusal(("--skeleton", "name or file", "'unicorn'", "cheetah-8u, cheetah-8u-jules")):
        load_chain("unicorn")


def test_the_documented_example_is_a_chain(tmp_path):
    text = (Path(__file__).parents[2] / "docs" / "skeletons.md").read_text()
    _, extends = (block.split("```")[0] for block in text.split("```toml")[1:])  # test_body.py tests the first block
    (tmp_path / "chain.toml").write_text(extends)
    assert len(load_chain(tmp_path / "chain.toml").joints) >= 5


def test_a_chain_that_cannot_be_placed_is_refused(tmp_path):
    example = (Path(__file__).parents[1] / "files" / "trunk-and-leg.toml").read_text()
    short = tmp_path / "short.toml"
    short.write_text("[[links]]".join(example.split("[[links]]")[:4]))
    with refusal((short, "links", 3, "at least 4"), (short, "feet", "'paw'")):
        load_chain(short)
    free = tmp_path / "free.toml"
    angle = "{ mean_rad = 0.0, tolerance_rad = 1.0, max_rate_rad_s = 9.0 }"
    with_angles = f'keypoint = "spine"\ntheta = {angle}\nphi = {angle}'
    free.write_text(example.replace('keypoint = "spine"', with_angles))
    with refusal((free, "links", "without angles", "forward axis")):
        load_chain(free)
