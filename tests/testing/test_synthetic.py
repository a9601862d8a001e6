"""Test that simulated clips are plausible and exact, and that scripts reproduce the samples."""

from __future__ import annotations

import dataclasses
import itertools
import runpy
from pathlib import Path

import numpy as np
import pytest

from recon.animal.skeleton_file import load_skeleton, with_detector_offsets
from recon.clip import clean
from recon.fit.points import solve_points
from recon.io.calibration import read_camera, read_cameras
from recon.io.formats import read_keypoints
from recon.io.positions import read_pose3d
from recon.testing.gallop import KEYPOINT_NAMES, MARGIN_PX, SLOPE, add_noise, gallop
from recon.thesis.chain import load_chain

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "samples"
SKELETON = load_chain("cheetah-8u")
VARIANTS = [
    {},
    {"heading_rad": 0.35},
    {"heading_rad": -0.35, "seed": 3},
    {"heading_rad": 0.6},
    {"direction": "left", "heading_rad": 0.6, "seed": 7},
    {"direction": "left", "camera_model": "fisheye"},
    {"camera_model": "fisheye", "heading_rad": 0.35},
]


@pytest.fixture(scope="module", params=VARIANTS, ids=lambda v: "-".join(map(str, v.values())) or "default")
def clip(request):
    return gallop(**request.param)


def joint(clip, name):
    return clip.truth_m[:, clip.names.index(name)]


def in_camera(camera, points_m):
    """Return points (..., 3) in the camera frame, in metres."""
    assert camera.rotation is not None
    return points_m @ camera.rotation.T + camera.translation_m


def pose(camera):
    """Return the upper three rows (3, 4) of a camera's T_camera_world."""
    assert camera.rotation is not None
    assert camera.translation_m is not None
    return np.column_stack([camera.rotation, camera.translation_m])


def height_m(points):
    """Return heights in metres of points (..., 3) above the ground of a clip that runs to the right."""
    return (points[..., 2] - SLOPE * points[..., 0]) / np.hypot(1, SLOPE)


def test_size_and_names(clip):
    assert clip.truth_m.shape == (30, 15, 3)
    assert clip.names == clip.keypoints.names == KEYPOINT_NAMES
    assert clip.state.shape == (30, 21)
    assert clip.keypoints.present.all()
    assert (clip.keypoints.confidence == 1).all()


def test_state_reproduces_truth_and_pixels(clip):
    joints = SKELETON.pose(clip.state).joints_m
    near = np.stack([joint(clip, name) for name in SKELETON.body.keypoint_names(clip.side)], axis=1)
    np.testing.assert_allclose(joints, in_camera(clip.camera, near), rtol=0, atol=1e-9)
    xy_px, valid = clip.camera.project(in_camera(clip.camera, clip.truth_m))
    assert valid.all()
    np.testing.assert_allclose(clip.keypoints.xy_px, xy_px, rtol=0, atol=1e-9)


def test_links_keep_their_length(clip):
    names = dict(zip(SKELETON.joints, SKELETON.body.keypoint_names(clip.side), strict=True))
    for link in SKELETON.links:
        length = np.linalg.norm(joint(clip, names[link.end]) - joint(clip, names[link.start]), axis=1)
        np.testing.assert_allclose(length, 0.203 * link.length_ratio, rtol=1e-9)
    far = "l" if clip.side == "right" else "r"
    for leg, links in (("back", ("r7", "r8")), ("front", ("r3", "r4"))):
        for (a, b), name in zip(itertools.pairwise(("knee", "ankle", "paw")), links, strict=True):
            length = np.linalg.norm(joint(clip, f"{far}_{leg}_{a}") - joint(clip, f"{far}_{leg}_{b}"), axis=1)
            ratio = next(link.length_ratio for link in SKELETON.links if link.name == name)
            np.testing.assert_allclose(length, 0.203 * ratio, rtol=1e-9)


def test_near_side_is_nearer(clip):
    near, far = ("r", "l") if clip.side == "right" else ("l", "r")
    depth = {s: (joint(clip, f"{s}_back_knee") @ clip.camera.rotation[2]).mean() for s in "rl"}
    assert depth[near] < depth[far]
    ahead = clip.keypoints.xy_px[:, clip.names.index("neck_base"), 0] > clip.keypoints.xy_px[:, 2, 0]
    assert (ahead == (clip.side == "right")).all()


def test_stays_in_the_picture(clip):
    low, high = clip.keypoints.xy_px.min(axis=(0, 1)), clip.keypoints.xy_px.max(axis=(0, 1))
    assert (low >= MARGIN_PX).all()
    assert (high <= np.array(clip.keypoints.image_size_px) - 1 - MARGIN_PX).all()


def test_runs_13_m_at_a_cheetahs_speed(clip):
    root = joint(clip, "tail_base")
    assert np.linalg.norm(root[-1] - root[0]) == pytest.approx(13, abs=0.6)
    speed = np.linalg.norm(np.gradient(root, axis=0), axis=1) * 30
    assert 15 < speed.max() < 21
    assert speed[-5:].mean() > speed[:5].mean() + 4


def test_three_strides():
    clip = gallop(fps=300, n_frames=291)
    front, back = height_m(joint(clip, "r_front_paw")), height_m(joint(clip, "r_back_paw"))
    for foot, steps in ((front, 4), (back, 3)):
        grounded = foot < 0.03
        assert np.sum(np.diff(grounded.astype(int), prepend=0) == 1) == steps  # the front foot makes three strides


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("n_frames", [30, 90])
def test_angles_within_ranges_and_rates(seed, n_frames):
    state = gallop(n_frames=n_frames, seed=seed).state
    for part, ranges in ((SKELETON.theta_slice, SKELETON.theta), (SKELETON.phi_slice, SKELETON.phi)):
        angles = state[:, part]
        assert (np.abs(angles - ranges.mean_rad) < ranges.tolerance_rad).all()
        assert (2 * np.abs(np.sin(np.diff(angles, axis=0) / 2)) * 30 < ranges.max_rate_rad_s).all()
    assert (np.abs(state[:, SKELETON.theta_slice][:, 3]) < 0.35).all()
    spread = state[:, SKELETON.phi_slice].std(axis=0)
    assert ((spread > 0.02) & (spread < 0.16)).all()


def test_feet_on_the_ground():
    clip = gallop(fps=300, n_frames=291)
    for paw in (f"{side}_{leg}_paw" for side in "rl" for leg in ("front", "back")):
        foot = joint(clip, paw)
        height = height_m(foot)
        assert height.min() > -0.04
        assert 0.2 < height.max() < 0.6
        grounded = height < 0.01
        assert 0.1 < grounded.mean() < 0.35
        slip = np.abs(np.gradient(foot[:, 0])[grounded]) * 300
        assert np.median(slip) < 3  # the animal moves over the foot at 10 to 17 m/s


def test_same_motion_at_any_frame_rate():
    slow, fast = gallop(fps=30, n_frames=30), gallop(fps=90, n_frames=90)
    np.testing.assert_allclose(fast.truth_m[::3], slow.truth_m, rtol=0, atol=1e-12)


def test_longer_clip_levels_off_and_runs_out_of_the_picture():
    clip = gallop(n_frames=120)
    speed = np.linalg.norm(np.gradient(joint(clip, "tail_base"), axis=0), axis=1) * 30
    assert 19 < speed[-10:].mean() < 20.5
    assert not clip.keypoints.present[-1].any()
    assert (clip.keypoints.confidence[~clip.keypoints.present] == 0).all()


def test_heading_beyond_the_limit():
    with pytest.raises(ValueError, match="heading"):
        gallop(heading_rad=1.5)


def test_noise_has_the_stated_size():
    clip = gallop(n_frames=30, fps=30)
    many = dataclasses.replace(
        clip.keypoints,
        xy_px=np.tile(clip.keypoints.xy_px, (100, 1, 1)),
        confidence=np.tile(clip.keypoints.confidence, (100, 1)),
        frames=np.arange(3000),
    )
    noisy, outliers = add_noise(many, sigma_px=2, dropout=0.05, outlier=0.02, seed=1)
    assert 1 - noisy.present.mean() == pytest.approx(0.05)
    assert outliers.mean() == pytest.approx(0.02)
    assert (noisy.confidence[~noisy.present] == 0).all()
    error = noisy.xy_px - many.xy_px
    good = noisy.present & ~outliers
    np.testing.assert_allclose(error[good].std(axis=0), 2, rtol=0.03)
    far = np.linalg.norm(error[outliers], axis=1)
    assert 30 < far.min() < 60
    assert 280 < far.max() < 310
    assert ((noisy.confidence[good] >= 0.9) & (noisy.confidence[good] <= 1)).all()
    assert ((noisy.confidence[outliers] >= 0.6) & (noisy.confidence[outliers] < 1)).all()
    size = np.array(many.image_size_px)
    assert ((noisy.xy_px[outliers] >= 0) & (noisy.xy_px[outliers] <= size - 1)).all()


def test_noise_is_deterministic():
    keypoints = gallop().keypoints
    (a, outliers_a), (b, outliers_b), (c, _) = (add_noise(keypoints, seed=s) for s in (5, 5, 6))
    np.testing.assert_array_equal(a.xy_px, b.xy_px)
    np.testing.assert_array_equal(outliers_a, outliers_b)
    assert not np.array_equal(a.xy_px, c.xy_px, equal_nan=True)


def test_no_noise_changes_nothing_but_likelihoods():
    keypoints = gallop().keypoints
    same, outliers = add_noise(keypoints, sigma_px=0, dropout=0, outlier=0)
    np.testing.assert_array_equal(same.xy_px, keypoints.xy_px)
    assert not outliers.any()


def test_samples_are_those_that_the_script_makes(tmp_path):
    runpy.run_path(str(SAMPLES / "make_samples.py"))["make"](tmp_path)
    made = {path.name for path in tmp_path.iterdir()}
    data = {path.name for path in SAMPLES.iterdir() if path.is_file() and path.suffix not in (".md", ".py")}
    read = {"detector.toml"}
    # data/samples/make_rendered.py writes the other files.
    assert made == {name for name in data - read if not name.startswith("rendered")}
    for name in sorted(made):
        if name.endswith(".csv"):
            assert (tmp_path / name).read_bytes() == (SAMPLES / name).read_bytes(), name
        else:
            # Compare unrounded numbers, since the last digit of a sine differs between machines.
            both = zip(read_cameras(tmp_path / name), read_cameras(SAMPLES / name), strict=True)
            for ours, committed in both:
                np.testing.assert_allclose(pose(ours), pose(committed), rtol=0, atol=1e-12)
                np.testing.assert_allclose(ours.matrix, committed.matrix, rtol=1e-12)
                np.testing.assert_array_equal(ours.distortion, committed.distortion)
                assert (ours.model, ours.image_size_px) == (committed.model, committed.image_size_px)


def test_samples_are_small():
    assert sum(path.stat().st_size for path in SAMPLES.iterdir() if path.is_file()) < 1_000_000


@pytest.mark.parametrize(
    ("name", "camera"),
    [
        ("clean", "camera"),
        ("noisy", "camera"),
        ("clean_heading_20deg", "camera_heading_20deg"),
        ("clean_heading_34deg", "camera_heading_34deg"),
        ("fisheye_left", "camera_fisheye"),
        ("whole", "camera"),
    ],
)
def test_samples_read_back(name, camera):
    keypoints, _ = clean(read_keypoints(SAMPLES / f"{name}.csv"), likelihood_min=0.5)
    truth, cam = read_pose3d(SAMPLES / f"{name}_truth.csv"), read_camera(SAMPLES / f"{camera}.toml")
    assert truth.names == keypoints.names
    seen_m = truth.xyz_m
    if name == "whole":  # the detector's keypoints are offset from the markers
        body = with_detector_offsets(load_skeleton("cheetah-24"), "acinoset")
        order = [truth.names.index(marker) for marker in body.markers]
        states, _, size = solve_points(body, truth.xyz_m[:, order], None)
        seen_m = np.empty_like(truth.xyz_m)
        seen_m[:, order] = body.detected.pose(states, size).points_m
    xy_px, _ = cam.project(in_camera(cam, seen_m))
    error = np.linalg.norm(xy_px - keypoints.xy_px, axis=2)
    if name.startswith("clean"):
        assert np.max(error) < 1e-3
    else:
        assert np.nanmedian(error) == pytest.approx(2 * 1.18, rel=0.15)
        assert 0.02 < np.isnan(error).mean() < 0.08
