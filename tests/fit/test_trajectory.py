"""Test the trajectory method on a simulated animal with a gait like the prior's, seen by one camera."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from example_run import BODY, CAMERA, CAMERA_FROM_LEVEL, FPS, PRIOR, errors_m, plain, run, seen, solve

from recon import FitSettings, evaluate, fit_clip
from recon.animal.body import other_side
from recon.animal.chain import load_chain
from recon.animal.prior import prior_from_body
from recon.clip import still_view
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.result import TrajectorySolution
from recon.fit.starts import approach
from recon.fit.trajectory import solve_trajectory
from recon.io.common import Pose3D
from recon.io.positions import read_pose3d
from recon.testing.gallop import gallop


def test_finds_the_motion():
    """The errors are at most 30 mm for the pose and 4 % of the distance for the path, with 2 px of noise at 9 m."""
    solution, truth = plain(), run()
    assert solution.status == "converged"
    assert errors_m(solution, truth).mean() < 0.03
    assert np.linalg.norm(solution.joints_camera_m - truth, axis=-1).mean() < 0.35
    assert not any(solution.flags)
    assert solution.size == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("heading_rad", [-1.1, 2.6])
def test_finds_other_headings(heading_rad):
    truth = run(heading_rad=heading_rad)
    assert errors_m(solve(seen(truth)), truth).mean() < 0.045


def test_result_is_reproducible():
    again = solve(seen(run()))
    np.testing.assert_array_equal(again.states, plain().states)
    np.testing.assert_array_equal(again.covariance_m2, plain().covariance_m2)


def test_result_is_consistent():
    """The states give the joints, and covariances are positive definite."""
    solution = plain()
    posed = solution.body.tree.pose(solution.states, solution.size).points_m
    np.testing.assert_allclose(posed, solution.joints_m, atol=1e-9)
    for covariance in (solution.covariance_m2, solution.relative_covariance_m2):
        assert np.linalg.eigvalsh(covariance).min() > 0
    total, parts = np.trace(solution.covariance_m2, axis1=2, axis2=3), solution.relative_covariance_m2
    assert (total > np.trace(parts, axis1=2, axis2=3)).mean() > 0.99
    fraction = solution.data_share
    assert ((fraction >= 0) & (fraction <= 1)).all()
    assert fraction[BODY.markers.index("r_front_paw")] > 0.5
    assert solution.starts > 1


def test_depth_is_less_certain_than_the_picture():
    variance = np.diagonal(plain().covariance_m2, axis1=2, axis2=3).mean(axis=(0, 1))
    right, away, up = variance
    assert away > 4 * right
    assert away > 4 * up


def test_a_side_view_shows_pitch_and_hardly_roll():
    """Information fraction and standard deviation show that the pixels determine pitch and hardly determine roll."""
    solution = plain()
    fraction = dict(zip(BODY.state_names[3:], np.median(solution.angle_data_share, axis=0), strict=True))
    assert min(fraction[f"{side}_{part}_pitch"] for side in "lr" for part in ("fore_upper", "hind_thigh")) > 0.6
    assert max(fraction["head_roll"], fraction["tail_2_yaw"]) < 0.3
    assert ((solution.angle_data_share >= 0) & (solution.angle_data_share <= 1)).all()


def test_bridges_a_gap_with_growing_uncertainty():
    """The gap lasts ten frames, and the other frames are as good as without it."""
    truth = run()
    xy_px = seen(truth)
    xy_px[15:25] = np.nan
    solution = solve(xy_px)
    hole = np.arange(15, 25)
    assert all("no data" in solution.flags[t] for t in hole)
    assert not any(solution.flags[:15] + solution.flags[25:])
    spread = np.sqrt(np.trace(solution.relative_covariance_m2, axis1=2, axis2=3)).mean(axis=1)
    assert spread[20] > 1.5 * spread[[5, 35]].max()
    assert spread[20] > spread[15] > spread[12]
    outside = np.setdiff1d(np.arange(len(truth)), hole)
    assert errors_m(solution, truth)[outside].mean() < 1.5 * errors_m(plain(), truth)[outside].mean()


SWAPPED = [BODY.markers.index(other_side(marker)) for marker in BODY.markers]


def test_survives_outliers():
    """The error stays below 30 mm if almost a third of the detections is up to 300 px off along both axes."""
    truth, rng = run(), np.random.default_rng(5)
    xy_px = seen(truth)
    wrong = rng.uniform(size=xy_px.shape[:2]) < 0.3
    xy_px[wrong] += rng.uniform(-300, 300, (wrong.sum(), 2))
    solution = solve(xy_px)
    assert errors_m(solution, truth).mean() < 0.03
    assert np.nanmean(solution.weight[0, wrong]) < 0.3 * np.nanmean(solution.weight[0, ~wrong])


def test_an_animal_seen_end_on_is_ambiguous():
    """An animal that runs straight away from the camera has an ambiguous depth in all frames."""
    solution = solve(seen(run(heading_rad=np.pi / 2, speed_m_s=4.0)))
    assert all("ambiguous depth" in flags for flags in solution.flags)


def test_survives_swapped_sides():
    """Left and right are swapped in ten frames, which get less weight; the other frames are good."""
    truth = run()
    xy_px = seen(truth)
    xy_px[12:22] = xy_px[12:22][:, SWAPPED]
    solution = solve(xy_px)
    outside = np.r_[0:10, 24:40]
    assert errors_m(solution, truth)[outside].mean() < 0.03
    assert np.nanmean(solution.weight[0, 12:22]) < np.nanmean(solution.weight[0, outside])


def test_survives_missing_legs():
    """The hind legs are missing in the first half, which is more uncertain; the second half is as good as before."""
    truth, base = run(), errors_m(plain(), run())
    xy_px = seen(truth)
    hind = [j for j, marker in enumerate(BODY.markers) if "back" in marker]
    xy_px[:20, hind] = np.nan
    solution = solve(xy_px)
    spread = np.sqrt(np.trace(solution.relative_covariance_m2, axis1=2, axis2=3))[:, hind].mean(axis=1)
    assert spread[5] > 1.5 * spread[35]
    assert all("data poor" in flags for flags in solution.flags[:20])
    assert not any("data poor" in flags for flags in solution.flags[20:])
    assert errors_m(solution, truth)[22:].mean() < 1.5 * base[22:].mean() + 0.003


def test_long_gaps_split_the_clip():
    """Two parts of a clip that are more than two seconds apart have their own ground each."""
    truth = run(30)
    xy_px = np.full((30 + 240 + 30, len(BODY.markers), 2), np.nan)
    lower = truth + np.array([0.0, 0.6, 0.0])
    xy_px[:30], xy_px[-30:] = seen(truth), seen(lower, seed=1)
    solution = solve(xy_px)
    paws = [BODY.markers.index(foot) for foot in BODY.feet]
    for segment in solution.segments:
        assert np.isfinite(solution.states[segment.rows]).all()
        assert segment.ground is not None
        down = solution.joints_camera_m[segment.rows][:, paws, 1]
        assert -segment.ground.height_m == pytest.approx(np.percentile(down, 90), abs=0.15)
    first, second = (segment.ground.height_m for segment in solution.segments if segment.ground is not None)
    assert first - second == pytest.approx(0.6, abs=0.1)
    assert np.isnan(solution.states[100:200]).all()
    assert all("no data" in flags for flags in solution.flags[60:230])
    for part in (slice(0, 30), slice(270, 300)):
        assert (
            errors_m(
                dataclasses.replace(
                    solution, joints_m=solution.joints_m[part], views=tuple(v.part(part) for v in solution.views)
                ),
                truth,
            ).mean()
            < 0.045
        )


@pytest.mark.parametrize("T", [1, 2, 3])
def test_very_short_clips(T):
    solution = solve(seen(run(T)))
    assert np.isfinite(solution.joints_camera_m).all()
    assert errors_m(solution, run(T)).mean() < 0.2


def test_a_clip_without_animal():
    solution = solve(np.full((5, len(BODY.markers), 2), np.nan))
    assert solution.status == "not_converged"
    assert np.isnan(solution.states).all()
    assert all(flags == ("no data",) for flags in solution.flags)


def test_windows_are_joined():
    """A clip of three seconds has starts in three windows, and is solved as a whole without a jump of the path."""
    truth = run(270, heading_rad=0.1, speed_m_s=1.5)
    solution = solve(seen(truth))
    assert solution.status == "converged"
    assert errors_m(solution, truth).mean() < 0.045
    steps = np.linalg.norm(np.diff(solution.joints_camera_m.mean(axis=1), axis=0), axis=1)
    assert steps.max() < 0.1


def test_fast_is_near_the_full_solution():
    quick = solve(seen(run()), fast=True)
    assert errors_m(quick, run()).mean() < errors_m(plain(), run()).mean() + 0.004
    view = still_view(CAMERA, seen(run()), np.ones((len(run()), len(BODY.markers))))
    for fast, count in ((True, 1), (False, 2)):
        tried = approach(ClipProblem.from_views([view], BODY, PRIOR, FPS, TrajectoryOptions(fast=fast)))
        assert sum(len(start.states) == len(run()) for start in tried) == count


def test_without_a_learned_prior():
    """The skeleton's expected angles replace the learned prior, with larger errors."""
    solution = solve(seen(run()), prior=prior_from_body(BODY))
    assert solution.prior == "none"
    assert errors_m(solution, run()).mean() < 0.1


def test_one_camera_cannot_determine_the_scale():
    """A body twice too large is placed twice as far away, and its size stays uncertain."""
    tree = BODY.tree
    segments = tuple(dataclasses.replace(s, offset_m=tuple(2 * x for x in s.offset_m)) for s in tree.segments)
    markers = tuple(dataclasses.replace(m, offset_m=tuple(2 * x for x in m.offset_m)) for m in tree.markers)
    large = dataclasses.replace(
        BODY, tree=dataclasses.replace(tree, segments=segments, markers=markers), size_sigma=0.1
    )
    solution = solve(seen(run()), body=large)
    assert solution.size_sigma == pytest.approx(0.1)
    distance = np.linalg.norm(solution.joints_camera_m.mean(axis=1), axis=1)
    assert np.median(distance / np.linalg.norm(run().mean(axis=1), axis=1)) == pytest.approx(2.0, rel=0.1)


def test_the_size_follows_from_the_ground():
    """A camera 3 m above the ground shows that the skeleton is 10 % too large."""
    clip = gallop(fps=FPS, n_frames=80, heading_rad=0.2)
    chain = load_chain("cheetah-8u")
    body = dataclasses.replace(chain.body, size_sigma=0.1)
    names = chain.body.keypoint_names(clip.side)
    xy_px = clip.keypoints.xy_px[:, [clip.keypoints.names.index(n) for n in names]]
    known = solve(xy_px, body=body, prior=prior_from_body(body), camera=clip.camera)
    assert [segment.ground is not None for segment in known.segments] == [True]
    assert known.size_sigma < 0.1
    unknown = solve(xy_px, body=body, prior=prior_from_body(body), camera=clip.camera, ground="none")
    assert [segment.ground for segment in unknown.segments] == [None]
    assert unknown.size_sigma == pytest.approx(0.1)


def test_chain_fits_the_noisy_sample():
    """The error of the 8U chain on the bundled sample is at most 40 mm."""
    samples = Path(__file__).resolve().parents[2] / "data" / "samples"
    settings = FitSettings(
        keypoints=samples / "noisy.csv", camera=samples / "camera.toml", fps=30, skeleton="cheetah-8u"
    )
    motion = fit_clip(settings)
    found = Pose3D(motion.names, motion.joints_m, motion.frames)
    assert evaluate(found, read_pose3d(samples / "noisy_truth.csv")).mpjpe_m.mean < 0.04


@pytest.mark.slow
def test_real_views(shared_data):
    """Two views of a known subject have the errors that the benchmark measures, with a margin."""
    for name, camera, below_m in (
        ("2017_08_29-top-phantom-run1_1", "cam5", 0.06),
        ("2017_08_29-top-jules-run1_1", "cam2", 0.06),
    ):
        folder = shared_data / "cheetah-runs" / name
        settings = FitSettings(
            keypoints=folder / f"{camera}.csv",
            camera=folder / "scene.json",
            camera_name=camera,
            fps=90,
            subject="jules" if "jules" in name else "phantom",
        )
        motion = fit_clip(settings)
        found = Pose3D(motion.names, motion.joints_m, motion.frames)
        assert evaluate(found, read_pose3d(folder / "truth.csv")).mpjpe_m.mean < below_m


def chain_points(T: int) -> np.ndarray:
    chain = load_chain("cheetah-8u").body
    states = np.zeros((T, chain.n_state))
    states[:, 4:], states[:, :3] = chain.mean_rad, [0.0, 9.0, -0.3]
    states[:, 0] += 0.1 * np.arange(T)
    return CAMERA.project(chain.tree.pose(states).points_m @ CAMERA_FROM_LEVEL.T)[0]


def solve_chain(xy_px: np.ndarray, camera=CAMERA, fps: float = FPS) -> TrajectorySolution:
    chain, confidence = load_chain("cheetah-8u").body, np.isfinite(xy_px[..., 0]).astype(float)
    options = TrajectoryOptions(fast=True)
    return solve_trajectory([still_view(camera, xy_px, confidence)], chain, prior_from_body(chain), fps, options)


def test_pose_too_far_away_to_be_seen_is_left_out():
    xy_px = chain_points(3)
    middle = xy_px.mean(axis=(0, 1))
    solution = solve_chain(middle + 1e-3 * (xy_px - middle))
    assert all("diverged" in flags for flags in solution.flags)
    assert np.isnan(solution.states).all()
    assert np.isnan(solution.joints_m).all()
    assert np.isnan(solution.covariance_m2).all()


def test_frame_next_to_a_single_other_frame_is_uncertain():
    """The frame without detections is far less certain, since one frame does not show how fast the animal is."""
    xy_px = chain_points(2)
    xy_px[1] = np.nan
    solution = solve_chain(xy_px)
    assert np.isfinite(solution.states).all()
    variance = np.trace(solution.covariance_m2[:, 0], axis1=1, axis2=2)
    assert 0 < variance[0] < 30 < 1000 * variance[0] < variance[1] < np.inf
    assert "no data" in solution.flags[1]


def test_frames_without_rays_count_as_without_detections():
    fisheye = dataclasses.replace(CAMERA, model="fisheye", distortion=np.array([-0.3, 0.0, 0.0, 0.0]))
    off, missing = chain_points(4), chain_points(4)
    off[2] += (0.0, 2500.0)
    missing[2] = np.nan
    np.testing.assert_array_equal(solve_chain(off, fisheye).states, solve_chain(missing, fisheye).states)


def test_frames_seconds_apart_are_solved():
    solution = solve_chain(chain_points(3), fps=0.2)
    assert np.isfinite(solution.states).all()
    assert np.abs(solution.joints_camera_m).max() < 20
