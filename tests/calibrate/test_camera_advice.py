"""Test camera advice: the posterior of a known motion for each camera position."""

from __future__ import annotations

import json

import numpy as np
import pandas as pd
import pytest
from command_line import refused, run, says

from recon.animal.anatomy import joints_named, suggested_joint
from recon.animal.prior import prior_from_body
from recon.animal.skeleton_file import load_skeleton
from recon.api.camera_advice import direction_text
from recon.calibrate.camera_advice import ELEVATIONS_RAD, advise, camera_at, length_m, mean_stride, precision_of
from recon.fit.clip_problem import TrajectoryOptions
from recon.gait.flexion import MODEL_RAD
from recon.geometry.camera import Camera

BODY = load_skeleton("cheetah-8u")
WHOLE = load_skeleton("cheetah-24")
PRIOR = prior_from_body(BODY)
STATES = mean_stride(BODY, PRIOR)
LENS = Camera.from_hfov(60.0, (1920, 1080))
SIDE, ABOVE = (np.pi / 2, 0.0), (np.pi / 2, np.radians(85))


def seen_from(position, body=BODY, distance_m=4.0, **what):
    middle = body.tree.pose(STATES).points_m.mean(axis=(0, 1))
    return precision_of(body, PRIOR, STATES, [camera_at(LENS, middle, *position, distance_m)], **what)


def test_the_camera_looks_at_the_middle_and_stands_upright():
    target = np.array([1.0, 2.0, 0.5])
    for azimuth in (0.3, 2.0, 4.5):
        camera = camera_at(LENS, target, azimuth, np.radians(30), 5.0)
        pixels, _ = camera.project(camera.world_to_camera(target + np.array([[0.0, 0, 0], [0, 0, 0.1]])))
        np.testing.assert_allclose(pixels[0], [959.5, 539.5], atol=1e-9)
        assert pixels[1, 0] == pytest.approx(959.5)
        assert pixels[1, 1] < 539.5  # a higher point is higher in the picture
        centre = -camera.rotation.T @ camera.translation_m
        expected = 5 * np.array([np.cos(azimuth) * np.cos(np.pi / 6), np.sin(azimuth) * np.cos(np.pi / 6), 0.5])
        np.testing.assert_allclose(centre - target, expected, atol=1e-12)


def test_theta_is_visible_from_the_side_and_phi_from_above():
    sagittal, transverse = {"target": "theta_1"}, {"target": "phi_1"}
    theta, phi = ([seen_from(position, **what) for position in (SIDE, ABOVE)] for what in (sagittal, transverse))
    assert theta[0][1] > 0.7
    assert phi[0][1] < 0.02
    assert phi[1][1] > 5 * phi[0][1]
    assert theta[0][0] < theta[1][0]
    assert phi[1][0] < phi[0][0]


def test_without_noise_all_information_comes_from_the_pixels(monkeypatch):
    """If keypoints lie on their joints with a noise of 0.01 px, hardly anything comes from the prior, even for phi."""
    exact = TrajectoryOptions(sigma_px=0.01, keypoint_sigma_m=0.0)
    for least, what in ((0.99, {"target": "theta_6"}), (0.9, {"target": "phi_6"}), (0.99, {"target": "J8"})):
        usual = seen_from((1.2, 0.5), **what)
        with monkeypatch.context() as without_noise:
            without_noise.setattr("recon.calibrate.camera_advice.TrajectoryOptions", lambda **settings: exact)
            sigma, fraction = seen_from((1.2, 0.5), **what)
        assert fraction > least > usual[1]
        assert sigma < usual[0] / 2


def test_precision_grows_nearer_and_is_zero_outside_the_picture():
    near, far = (seen_from(SIDE, target="J4", distance_m=distance)[0] for distance in (4.0, 40.0))
    assert near < 0.9 * far
    assert seen_from(SIDE, distance_m=0.01) == (np.inf, 0.0)


def test_the_mean_stride_is_straight_and_swings_as_in_the_prior():
    speed = np.diff(STATES[:, 0]) * 60
    np.testing.assert_allclose(speed, 5 * length_m(BODY))
    np.testing.assert_allclose(STATES[:20, 4:].mean(axis=0), PRIOR.mean, atol=1e-9)  # the mean over one period
    top = np.sqrt(np.linalg.eigvalsh(PRIOR.covariance)[-1])
    assert np.abs(STATES[:, 4:] - PRIOR.mean).max() == pytest.approx(top, rel=0.01)


def test_best_position_has_the_least_sigma_and_a_second_camera_lowers_it(monkeypatch):
    few = np.radians([0.0, 90.0, 180.0])
    monkeypatch.setattr("recon.calibrate.camera_advice.AZIMUTHS_RAD", few)
    monkeypatch.setattr("recon.calibrate.camera_advice.ELEVATIONS_RAD", ELEVATIONS_RAD[:2])
    (one,) = advise(BODY, PRIOR, "theta_1")
    assert one.position == (few[1], ELEVATIONS_RAD[0])
    assert one.sigma[one.best] == one.sigma.min()
    assert one.share[one.best] == one.share.max()
    monkeypatch.setattr("recon.calibrate.camera_advice.ELEVATIONS_RAD", ELEVATIONS_RAD[:1])
    both = advise(BODY, PRIOR, "theta_1", cameras=2)
    assert [advice.first_position for advice in both] == [None, one.position]
    assert both[1].sigma.max() < one.sigma.min()
    assert one.distance_m == pytest.approx(4 * length_m(BODY))


def test_the_precision_of_a_flexion_is_that_of_the_analysis():
    """The elbow of this chain is a hinge with the angle theta_3, and `MODEL_RAD` allows for the real elbow."""
    angle, fraction_of_angle = seen_from(SIDE, target="theta_3")
    sigma, fraction = seen_from(SIDE, target=("elbow",))
    assert sigma == pytest.approx(np.hypot(angle, MODEL_RAD), rel=1e-6)
    assert fraction == pytest.approx(fraction_of_angle, rel=1e-6)
    both = seen_from(SIDE, target=("elbow", "stifle"))[0]
    stifle = seen_from(SIDE, target=("stifle",))[0]
    assert min(sigma, stifle) < both < max(sigma, stifle)


@pytest.mark.parametrize(
    ("given", "joints"),
    [
        ("elbow", ("left_elbow", "right_elbow")),
        ("Left elbow flexion", ("left_elbow",)),
        ("right-hock", ("right_hock",)),
        ("spine_flexion", ("spine",)),
        ("knee", ()),
    ],
)
def test_joints_are_named_as_in_the_analysis(given, joints):
    assert joints_named(given, [*WHOLE.anatomy]) == joints


@pytest.mark.parametrize(
    ("given", "suggestion"),
    [
        ("left_knee", "left_stifle"),
        ("r_wrist", "right_carpus"),
        ("elbo", "elbow"),
        ("l_front_knee", "left_elbow"),  # the marker at the elbow
        ("front_knee", "elbow"),
        ("tail", None),
    ],
)
def test_a_joint_is_suggested_for_another_name(given, suggestion):
    assert suggested_joint(given, WHOLE.anatomy) == suggestion


def test_directions_are_put_into_words():
    assert direction_text(0.0, 0.1) == "ahead of the animal, level with its middle (0°)"
    assert direction_text(np.radians(270), 0.5) == "on the animal's right side, raised (270°)"
    assert direction_text(np.radians(120), np.radians(80)) == "behind the animal, to its left, almost above it (120°)"


@pytest.mark.parametrize("directions", [2, pytest.param(12, marks=pytest.mark.slow)])
def test_command(directions, tmp_path, monkeypatch):
    """The command advises among all directions, or compares the best direction with the direction ahead."""
    out = tmp_path / "advice"
    if directions == 2:
        for module in ("recon.api.camera_advice", "recon.calibrate.camera_advice", "recon.show.plots.cameras"):
            monkeypatch.setattr(f"{module}.AZIMUTHS_RAD", np.radians([0.0, 120.0]))
    done = run("camera-advice", "--skeleton", "cheetah-8u", "--angle", "theta_6", "--out", out)
    assert done.code == 0
    assert says(done.out, f"Put the camera {direction_text(np.radians(120), 0.5)}", "1.8 m above")
    assert says(done.out, "worst position", "ahead of the animal")
    table, report = pd.read_csv(out / "camera_advice.csv"), json.loads((out / "camera_advice.json").read_text())
    assert len(table) == 4 * directions
    (camera,) = report["cameras"]
    assert camera["sigma_rad"] == pytest.approx(table["sigma_rad"].min(), rel=1e-8)
    assert camera["data_share"] > 0.85
    assert (out / "camera_advice.png").stat().st_size > 5000
    there = ("--out", "folder", ["camera_advice.json", out], "--overwrite")
    refused(["camera-advice", "--skeleton", "cheetah-8u", "--out", out], there)


def test_every_problem_is_reported(tmp_path):
    given = ("camera-advice", "--skeleton", "cheetah-8u", "--out", tmp_path / "a")
    refused(
        [*given, "--cameras", "3", "--hfov-deg", "0", "--distance-m", "-1"],
        ("--cameras", "cameras", "'3'", "or equal to 2"),
        ("--hfov-deg", "hfov_deg", "'0'", "greater than 0"),
        ("--distance-m", "distance_m", "'-1'", "greater than 0"),
    )
    refused(
        [*given, "--angle", "theta_9"],
        ("--angle", "value", "'theta_9'", "one of elbow, carpus", "angle of the skeleton, one of J0_pitch"),
    )
    refused([*given, "--angle", "knee"], ("--angle", "value", "'knee'", "perhaps stifle"))
    refused([*given, "--angle", "J0_ptch"], ("--angle", "value", "'J0_ptch'", "perhaps J0_pitch"))
    refused([*given, "--joint", "elbow"], ("--joint", "value", "'elbow'", f"perhaps {BODY.anatomy['elbow'][1]}"))
    refused([*given, "--angle", "theta_6", "--joint", "J1"], ("--angle", "value", "--joint", "only one of the two"))
    assert not (tmp_path / "a").exists()
