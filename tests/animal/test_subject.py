"""Test the measurement of an animal in clips of several cameras: derivatives, estimates and the subject file."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from example_run import AHEAD, ASIDE, BODY, FPS, PRIOR, settings, truth_m, view_of

from recon import Body, SubjectFitSettings, load_skeleton, run_subject_fit
from recon.fit import constants
from recon.fit.body_shape import Shape
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.points import solve_points
from recon.fit.shape import ShapeFit, fit_shape
from recon.io.common import Pose3D
from recon.io.deeplabcut import write_csv
from tests.command_line import refusal, run

pytestmark = pytest.mark.usefixtures("no_playback")

KNOWN = {"l_fore_lower": 0.08, "l_hind_foot": -0.06}
"""Logarithms of the factors on the lengths of the filmed animal."""


def body() -> Body:
    return load_skeleton("cheetah-24", "phantom")


def test_derivatives_are_exact():
    shape = Shape.of_body(body(), lengths=True, offsets=True)
    rng = np.random.default_rng(0)
    values, states = 0.05 * rng.normal(size=len(shape)), rng.normal(size=(3, body().n_state))
    exact = shape.jacobian(shape.applied(body(), values), states)
    for k in range(0, len(shape), 3):
        h = 1e-6 * np.eye(len(shape))[k]
        after, before = (shape.applied(body(), values + s * h).detected.pose(states).points_m for s in (1, -1))
        np.testing.assert_allclose(exact[..., k], (after - before) / 2e-6, atol=1e-8, err_msg=shape.names[k])


def test_left_and_right_share_their_unknowns():
    shape = Shape.of_body(body(), lengths=True, offsets=True)
    assert not any(name.startswith("r_") for name in (*shape.lengths, *shape.offsets))
    values = np.zeros(len(shape))
    values[shape.names.index("l_hip_y")] = 0.01
    values[shape.names.index("l_fore_lower")] = 0.1
    changed = shape.applied(body(), values)
    assert changed.keypoint_offset_m["l_hip"] == (0.0, 0.01, 0.0)
    assert changed.keypoint_offset_m["r_hip"] == (0.0, -0.01, 0.0)
    for side in "lr":
        old, new = (next(s for s in b.tree.segments if s.name == f"{side}_fore_lower") for b in (body(), changed))
        np.testing.assert_allclose(new.offset_m, np.exp(0.1) * np.array(old.offset_m))


def fitted(shape: Shape, true: np.ndarray, posed: bool = False) -> ShapeFit:
    """Return the shape fitted to the views of two cameras of an animal with the shape values `true`.

    If `posed` is true, the poses of the animal are known.
    """
    points = _run_of(shape.applied(body(), true))
    views = [view_of(points, AHEAD, 1.0), view_of(points, ASIDE, 1.0, seed=1)]
    options = TrajectoryOptions(fast=True, keypoint_sigma_m=0.005, sigma_px=1.0)
    setting = ClipProblem.from_views(views, shape.body, PRIOR, FPS, options)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(constants, "ERROR_TIME_S", 0.0)
        return fit_shape(shape, [replace(setting, known_states=solve_points(BODY, truth_m())[0] if posed else None)])


def true_values(shape: Shape) -> np.ndarray:
    return np.array([KNOWN.get(name, 0.0) for name in shape.names])


def test_lengths_are_found():
    """The lengths of two segments are found to half a per cent, although the size is hardly known."""
    shape = Shape.of_body(replace(body(), size_sigma=0.1))
    fit = fitted(shape, true_values(shape))
    assert fit.converged
    np.testing.assert_allclose(fit.values, true_values(shape), atol=0.01)
    assert (np.abs(fit.values - true_values(shape)) < 4 * fit.sigma).all()


def test_offsets_are_found():
    """Offsets of the keypoints from the paws (1.5 cm up) and the knees (outwards) are found."""
    shape = Shape.of_body(body(), lengths=False, offsets=True)
    true = np.zeros(len(shape))
    moved = [shape.names.index("l_front_paw_z"), shape.names.index("l_back_knee_y")]
    true[moved] = 0.015
    fit = fitted(shape, true)
    np.testing.assert_allclose(fit.values[moved], 0.015, atol=0.006)
    assert (np.abs(fit.values - true) < 3 * fit.sigma).all()


@pytest.mark.slow
def test_with_known_poses_an_offset_is_not_taken_for_another_pose():
    """If poses are known, an offset of a whole fore leg by 4 cm is not taken for another pose."""
    shape = replace(Shape.of_body(body(), lengths=False, offsets=True), offset_sigma_m=0.02)
    true = np.zeros(len(shape))
    moved = [shape.names.index(f"l_{name}_x") for name in ("shoulder", "front_knee", "front_ankle", "front_paw")]
    true[moved] = 0.04
    known, free = (np.abs(fitted(shape, true, posed).values - true) for posed in (True, False))
    assert known.max() < 0.006
    assert free.max() > 0.015


def test_lengths_and_offsets_together_are_less_certain():
    shape = Shape.of_body(replace(body(), size_sigma=0.1), lengths=True, offsets=True)
    fit = fitted(shape, true_values(shape))
    assert (np.abs(fit.values - true_values(shape)) < 3 * fit.sigma).all()
    assert fit.sigma[shape.names.index("l_fore_lower")] > 0.015


def _run_of(animal: Body) -> np.ndarray:
    """Return the keypoints of another body in the poses of the simulated run, metres, shape (T, J, 3)."""
    states, *_ = solve_points(BODY, truth_m())
    return animal.detected.pose(states).points_m


def test_command(runs, tmp_path):
    """The command makes a subject file that `recon fit` accepts from the config of a fit."""
    config, out = tmp_path / "config.toml", tmp_path / "cat.toml"
    config.write_text(settings(runs, 1, 2, subject=None).to_toml())
    ended = run("subject", "fit", config, "--out", out, "--offsets", "--json")
    assert ended.code == 0, ended.err
    said = json.loads(ended.out)
    assert (said["clips"], said["frames"]) == (1, 40)
    assert {row["unit"] for row in said["values"]} == {"m", "mm"}
    bones = {bone["bone"]: bone for bone in said["bones"]}
    (low, high), length_m = bones["trunk"]["interval_m"], bones["trunk"]["length_m"]
    assert low < length_m < high
    assert (length_m - low) / bones["trunk"]["sigma_m"] == pytest.approx(1.645, rel=0.1)
    assert 0.3 < bones["trunk"]["data_share"] < 1
    found = load_skeleton("cheetah-24", out)
    # The filmed animal is from `phantom`, and smaller than the skeleton.
    assert said["size"] == pytest.approx(_mean_factor(body()), abs=0.03)
    assert found.size_sigma == pytest.approx(said["size_sigma"], abs=1e-4)
    assert run("subject", "fit", config, "--out", tmp_path / "lengths.toml").code == 0
    # The offsets belong to the detector.
    assert load_skeleton("cheetah-24", tmp_path / "lengths.toml").keypoint_offset_m == {}
    table = run("subject", "fit", config, "--out", out, "--overwrite", "--no-lengths", "--offsets")
    assert "offset from the marker" in table.out
    assert "length of" not in table.out
    assert "upper arm" not in table.out
    poses = tmp_path / "poses.csv"
    xyz_m = truth_m()
    write_csv(Pose3D(BODY.markers, xyz_m, np.arange(len(xyz_m))), poses)
    offsets = ("--no-lengths", "--offsets", "--poses", poses, "--json")
    said = json.loads(run("subject", "fit", config, "--out", tmp_path / "network.toml", *offsets).out)
    assert max(abs(row["value"]) for row in said["values"]) < 12  # mm: the keypoints lie on the markers


def test_few_frames_are_accepted_without_a_message(runs, tmp_path):
    config = tmp_path / "config.toml"
    config.write_text(settings(runs, 1, 2, subject=None, frames="10:16").to_toml())
    ended = run("subject", "fit", config, "--out", tmp_path / "cat.toml", "--json")
    assert (ended.code, ended.err) == (0, "")
    assert json.loads(ended.out)["frames"] == 6


def _mean_factor(animal: Body) -> float:
    generic = load_skeleton("cheetah-24")
    shape = Shape.of_body(generic)
    both = [{i.name: i.offset_m for i in (*b.tree.segments, *b.tree.markers)} for b in (animal, generic)]
    lengths = np.array([[np.linalg.norm(of[name]) for name in shape.lengths] for of in both])
    return float(np.exp(np.log(lengths[0] / lengths[1]).mean()))


def test_problems_with_clips_and_options_are_listed(runs, tmp_path):
    config, one = tmp_path / "config.toml", tmp_path / "one.toml"
    config.write_text(settings(runs, 1, 2).to_toml())
    one.write_text(settings(runs, 1).to_toml())
    other, detector = tmp_path / "other.csv", {"lengths": False, "offsets": True}
    write_csv(Pose3D(("nose",), np.zeros((40, 1, 3)), np.arange(40)), other)
    for paths, options, expected in (
        ([one], {}, (one, "cameras", ["one static camera", "cam1"], "several cameras")),
        ([config], {"out": tmp_path / "x.txt"}, ("--out", "file", tmp_path / "x.txt", "ends in .toml")),
        ([config], {"out": config}, (config, "file", "an input of this run", "another --out")),
        ([config], {"lengths": False}, ("--no-lengths", "unknowns", "nothing", "--offsets")),
        ([tmp_path / "none"], {}, (tmp_path / "none", "file", "no such file")),
        ([config], {"poses": [other]}, ("--poses", "unknowns", "lengths to fit, or no offsets")),
        ([config], detector | {"poses": [other, other]}, ("--poses", "files", "2 files for 1 clip")),
        ([config], detector | {"poses": [other]}, (other, "poses", ["40 of the", "1 of the"], "8 or more")),
    ):
        with refusal(expected):
            run_subject_fit(SubjectFitSettings(clips=paths, **{"out": tmp_path / "cat.toml", **options}))
    assert not (tmp_path / "cat.toml").exists()
