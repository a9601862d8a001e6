"""Test the smooth path of the reference joint, its intervals, and the term that ties frames to the path."""

from __future__ import annotations

import numpy as np
import pytest

from recon import FitSettings, fit_clip
from recon.api.samples import samples_folder
from recon.fit.motion import Motion
from recon.gait.clip import ClipAnalysis, over_belt
from recon.gait.kinematics import path_kinematics
from recon.thesis.chain import load_chain, mean_pose
from recon.thesis.path import MIN_SIGMA_M, PathTie, _motion_model, path_of

CHAIN = load_chain("cheetah-8u")


def straight_states(depth_noise_m: float, T: int = 60, fps: float = 90.0) -> np.ndarray:
    """Return states (T, D) of a chain that runs along x at 10 m/s, 8 m away, with noise in depth."""
    states = np.tile(mean_pose(CHAIN), (T, 1))
    states[:, CHAIN.position_slice] = [0.0, 0.0, 8.0]
    states[:, CHAIN.position_slice.start] = 10.0 * np.arange(T) / fps
    states[:, CHAIN.position_slice.stop - 1] += np.random.default_rng(3).normal(0.0, depth_noise_m, T)
    return states


def covariances(sigma_depth_m: float, T: int = 60) -> np.ndarray:
    """Return covariances (T, D, D) of 1 cm across the view, more in depth, and 10 % in size and distance."""
    sigma = np.full(CHAIN.n_state, 0.1)
    sigma[CHAIN.euler_slice] = 1e-4
    sigma[CHAIN.position_slice] = 0.01, 0.01, sigma_depth_m
    sigma[CHAIN.base_index] = 1e-9
    return np.tile(np.diag(sigma**2), (T, 1, 1))


def test_jitter_in_depth_does_not_change_the_speed_of_a_straight_run():
    path = path_of(CHAIN, straight_states(0.5), covariances(0.5), 90.0)
    speed = np.linalg.norm(path.velocity_m_s, axis=1)
    sigma = np.sqrt(path.covariance[:, 5, 5])
    assert np.abs(path.velocity_m_s[:, 0] - 10.0).max() < 0.1
    assert np.abs(path.velocity_m_s[10:-10, 2]).max() < 3 * sigma[10:-10].min()
    assert speed.max() < 11.0
    assert np.diff(path.position_m[:, 2]).std() < 0.02
    exact = np.gradient(straight_states(0.5)[:, CHAIN.position_slice], 1 / 90, axis=0)
    assert np.linalg.norm(exact, axis=1).max() > 40.0


def test_size_and_distance_are_not_determined():
    """A larger and more distant animal has the same path at the expected size."""
    states, base = straight_states(0.0), CHAIN.base_index
    larger = states.copy()
    larger[:, CHAIN.position_slice] *= 1.2
    larger[:, base] *= 1.2
    paths = [path_of(CHAIN, s, covariances(0.3), 90.0).position_m for s in (states, larger)]
    np.testing.assert_allclose(*paths, atol=2e-3)
    tie = PathTie(paths[0], CHAIN.nominal_base_length_m, base, 0.01)
    poses = [CHAIN.pose_with_jacobian(state[5][None]) for state in (states, larger)]
    np.testing.assert_allclose(*(tie.evaluate(pose, None, 5, 0.1)[0] for pose in poses), atol=1e-9)


def test_a_single_frame_has_no_path():
    states = straight_states(0.0)
    states[1:] = np.nan
    assert path_of(CHAIN, states, covariances(0.3), 90.0) is None


def test_the_motion_model_is_a_bounded_acceleration():
    F, Q = _motion_model(0.01)
    assert np.diag(F)[:3] == pytest.approx(1.0)
    assert F[0, 3] == pytest.approx(0.01)
    assert np.diag(F)[6:] == pytest.approx(np.exp(-0.01 / 0.05))
    assert Q[6, 6] == pytest.approx(81.0 * (1 - np.exp(-0.4)))  # the stationary variance of the acceleration
    assert np.linalg.eigvalsh(Q).min() > -1e-12
    assert MIN_SIGMA_M > 0


@pytest.fixture(scope="module")
def fits(frame_results):
    """Return fits of the noisy sample with and without the path."""
    samples = samples_folder()
    given = {"keypoints": samples / "noisy.csv", "camera": samples / "camera.toml", "fps": 30.0, "method": "frame"}
    return {"smooth": Motion.load(frame_results), "free": fit_clip(FitSettings(**given, path="free"))}


def test_the_path_is_a_term_with_a_name_and_can_be_switched_off(fits):
    assert fits["smooth"].solution.objectives[-1] == "path tie"
    assert "path tie" not in fits["free"].solution.objectives
    shares = [r.cost_shares["path tie"] for r in fits["smooth"].solution.reports]
    assert 0 < np.mean(shares) < 0.05


def test_a_false_peak_is_not_stated(fits):
    """No speed is stated for frames solved separately, which jitter in depth.

    If frames are tied to the path, the interval of the speed contains the true speed.
    """
    assert "solved separately" in ClipAnalysis(fits["free"]).why_no_speed
    analysis = ClipAnalysis(fits["smooth"])
    path = analysis.reference_motion
    assert abs(path.peak_speed_m_s - 16.6) < 1.645 * path.peak_speed_sigma_m_s
    jitter = [np.abs(np.diff(m.root_m, 3, axis=0)).max() for m in fits.values()]
    assert jitter[0] < 0.5 * jitter[1]


def test_the_reference_joint_moves_along_the_path(fits):
    motion = fits["smooth"]
    analysis, path = ClipAnalysis(motion), motion.solution.reference_path
    series = analysis.reference_motion.series
    np.testing.assert_allclose(series.value[::10], path.position_m, atol=1e-9)
    np.testing.assert_allclose(series.rate[::10], path.velocity_m_s, atol=1e-9)
    np.testing.assert_allclose(analysis.tracked.xyz_m[:, motion.names.index(motion.reference)], path.position_m)
    limbs = [pose.xyz_m - pose.xyz_m[:, :1] for pose in (analysis.tracked, motion.upright)]
    np.testing.assert_allclose(*limbs, atol=1e-9)
    size_sigma = motion.solution.size_sigma / motion.solution.size
    assert (analysis.reference_motion.speed_sigma_m_s > size_sigma * analysis.reference_motion.speed_m_s).all()
    unsized = analysis.moved(motion.reference, with_size=False)
    assert (unsized.speed_sigma_m_s < analysis.reference_motion.speed_sigma_m_s).all()


def test_the_path_moves_with_a_treadmills_belt(fits):
    still, moving = fits["smooth"], over_belt(fits["smooth"], 2.0)
    on_belt, over_ground = moving.solution.reference_path, still.solution.reference_path
    assert on_belt is not None
    assert over_ground is not None
    added, travelled = on_belt.velocity_m_s - over_ground.velocity_m_s, on_belt.position_m - over_ground.position_m
    np.testing.assert_allclose(np.linalg.norm(added, axis=1), 2.0)
    np.testing.assert_allclose(np.linalg.norm(travelled, axis=1), 2.0 * still.time_s, atol=1e-9)


def test_a_gap_has_no_speed(fits):
    motion = fits["smooth"]
    is_known = np.ones(30, bool)
    is_known[:3] = is_known[10:18] = False
    moved = path_kinematics(motion.time_s, motion.solution.reference_path, is_known)
    unknown = np.isnan(moved.speed_m_s)
    assert unknown[:30].all()
    assert not unknown[30:91].any()
    assert unknown[91:180].all()
    assert not unknown[180:].any()
