"""Test the speed, acceleration and distance of a path against motions that are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from recon.gait.clip import SPEED_KNOWN
from recon.gait.kinematics import JointKinematics, net_acceleration, point_kinematics, speed_at_frames
from recon.gait.series import MAX_GAP_S, ORDERS, Errors, frame_jitter_m, jitter_errors, lasting_errors
from recon.gait.spline import cubic_spline

FPS = 30.0
TIME_S = np.arange(40) / FPS
DIRECTION = np.array([2.0, -1.0, 2.0]) / 3.0


def straight(time_s: np.ndarray) -> np.ndarray:
    """Return positions on a straight path that starts at 5 m/s and accelerates at 4 m/s^2."""
    return (5.0 * time_s + 2.0 * time_s**2)[:, None] * DIRECTION + [1.0, 2.0, 3.0]


def circle(time_s: np.ndarray) -> np.ndarray:
    """Return positions on a circle of radius 2 m at 1.5 rad/s."""
    return 2.0 * np.stack([np.cos(1.5 * time_s), np.sin(1.5 * time_s), 0 * time_s], axis=1)


def smoothed(time_s: np.ndarray, points_m: np.ndarray) -> JointKinematics:
    return point_kinematics(time_s, points_m, jitter_errors(points_m), smooth=True, propagate=())


def test_accelerated_straight_motion_is_exact():
    path = point_kinematics(TIME_S, straight(TIME_S))
    end = TIME_S[-1]
    assert len(path.series.time_s) == 391
    np.testing.assert_allclose(path.series.time_s[::10], TIME_S, atol=1e-15)
    np.testing.assert_allclose(path.series.value, straight(path.series.time_s), atol=1e-12)
    np.testing.assert_allclose(path.series.rate, (5 + 4 * path.series.time_s)[:, None] * DIRECTION, atol=1e-10)
    np.testing.assert_allclose(path.acceleration_m_s2, 4.0, atol=1e-8)
    assert path.distance_m == pytest.approx(5 * end + 2 * end**2)
    assert path.peak_speed_m_s == pytest.approx(5 + 4 * end)
    assert path.mean_speed_m_s == pytest.approx(5 + 2 * end)


@pytest.mark.slow
def test_a_peak_due_to_jitter_is_uncertain():
    """In straight runs that jitter in depth, a peak with a stated error of at most a tenth is right to a tenth.

    Most correct peaks have such a stated error.
    """
    rng, true = np.random.default_rng(0), 5 + 4 * TIME_S[-1]
    known, unknown = [], []
    for depth_m in (0.0, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0) * 8:
        points = straight(TIME_S) + rng.normal(size=(40, 3)) * [0.01, depth_m, 0.01]
        path = point_kinematics(TIME_S, points, lasting_errors(points, FPS), smooth=True)
        is_known = path.peak_speed_sigma_m_s < SPEED_KNOWN * path.peak_speed_m_s
        (known if is_known else unknown).append(abs(path.peak_speed_m_s / true - 1))
    assert max(known) < 0.1
    assert len(known) >= 40
    assert max(unknown) > 0.5
    assert np.mean(unknown) > 4 * np.mean(known)


@pytest.mark.parametrize("shape", [(4,), (5, 1), (6, 3), (60, 2, 2)])
def test_the_spline_is_scipys_for_values_of_any_shape(shape):
    rng = np.random.default_rng(len(shape))
    t, values = np.cumsum(rng.uniform(0.01, 0.2, shape[0])), rng.normal(size=shape)
    found, expected = cubic_spline(t, values), CubicSpline(t, values)
    times = np.sort(np.append(t, rng.uniform(t[0] - 0.1, t[-1] + 0.1, 100)))
    for order, derivative in enumerate(found(times, ORDERS)):
        known = expected(times, order)
        # identical where processors round each product, as x86-64 does; others may fuse it with a sum
        np.testing.assert_allclose(derivative, known, rtol=1e-12, atol=1e-14 * np.abs(known).max())


@pytest.mark.parametrize(
    ("t", "values"), [([0, 1, 2], [0, 1, 2]), ([0, 1, 1, 2], [0] * 4), ([0, 1, 2, 3], [0, np.nan, 1, 2])]
)
def test_a_spline_needs_four_finite_values_at_increasing_times(t, values):
    with pytest.raises(ValueError, match="increasing"):
        cubic_spline(np.array(t, float), np.array(values, float))


@pytest.mark.parametrize("points", [4, 5, 6, 60])
def test_the_spline_of_a_path_is_scipys(points):
    """The spline of a path equals scipy's, also across gaps of the longest duration that is bridged."""
    rng = np.random.default_rng(points)
    time_s = np.cumsum(rng.choice([1 / 120, 1 / 60, 0.19], points))
    path = rng.normal(size=(points, 3))
    found = point_kinematics(time_s, path)
    expected = CubicSpline(time_s, path, bc_type="not-a-knot")
    for order, values in enumerate((found.series.value, found.series.rate)):
        known = expected(found.series.time_s, order)
        np.testing.assert_allclose(values, known, atol=1e-12 * np.abs(known).max())
    known = np.linalg.norm(expected(found.series.time_s, 2), axis=1)
    np.testing.assert_allclose(found.acceleration_m_s2, known, atol=1e-12 * known.max())


def test_circle():
    path = point_kinematics(TIME_S, circle(TIME_S))
    np.testing.assert_allclose(path.speed_m_s, 3.0, rtol=1e-4)
    np.testing.assert_allclose(path.acceleration_m_s2[50:-50], 4.5, rtol=1e-3)
    np.testing.assert_allclose(path.acceleration_m_s2, 4.5, rtol=0.02)  # a spline is least accurate at its ends
    assert path.distance_m == pytest.approx(3.0 * TIME_S[-1], rel=1e-5)


def test_speed_at_frames_equals_the_speed_on_the_fine_grid():
    points = circle(TIME_S)
    np.testing.assert_array_equal(speed_at_frames(TIME_S, points), point_kinematics(TIME_S, points).speed_m_s[::10])


def test_short_gaps_are_bridged_and_nothing_is_extrapolated():
    points = straight(TIME_S)
    points[:3], points[-2:], points[10:14] = np.nan, np.nan, np.nan
    path = point_kinematics(TIME_S, points)
    known = np.isfinite(path.speed_m_s)
    assert not known[:30].any()
    assert not known[-20:].any()
    assert known[30:-20].all()
    np.testing.assert_allclose(path.series.value[known], straight(path.series.time_s[known]), atol=1e-12)


def test_long_gaps_are_not_bridged():
    points = straight(TIME_S)
    points[12:18] = np.nan  # a gap of 7 intervals, 0.233 s
    path = point_kinematics(TIME_S, points)
    assert np.isnan(path.speed_m_s[111:180]).all()
    assert np.isnan(path.acceleration_m_s2[111:180]).all()
    assert np.isfinite(path.speed_m_s[:111]).all()
    assert np.isfinite(path.speed_m_s[180:]).all()
    moved = np.linalg.norm(straight(TIME_S[[0, 11, 18, 39]])[1::2] - straight(TIME_S[[0, 11, 18, 39]])[::2], axis=1)
    assert path.distance_m == pytest.approx(moved.sum())
    assert path.mean_speed_m_s == pytest.approx(moved.sum() / (32 / FPS))


def test_a_gap_is_a_missing_frame_at_any_frame_rate():
    time_s = np.linspace(0, 14 * MAX_GAP_S, 8)
    assert np.isfinite(point_kinematics(time_s, straight(time_s)).speed_m_s).all()


def test_short_stretches_between_long_gaps_are_unknown():
    points = straight(TIME_S)
    points[20:30] = points[33:] = np.nan  # only frames 30, 31 and 32 remain
    assert np.isnan(speed_at_frames(TIME_S, points)[20:]).all()


@pytest.mark.parametrize("known", [0, 1, 3])
def test_too_few_points_give_nan(known):
    points = straight(TIME_S)
    points[known:] = np.nan
    path = point_kinematics(TIME_S, points)
    assert np.isnan(path.speed_m_s).all()
    assert np.isnan([path.distance_m, path.peak_speed_m_s, path.mean_speed_m_s]).all()


@pytest.mark.parametrize("n", [0, 1, 2])
def test_short_clips(n):
    path = point_kinematics(TIME_S[:n], straight(TIME_S[:n]))
    assert np.isnan(path.speed_m_s).all()
    assert len(speed_at_frames(TIME_S[:n], straight(TIME_S[:n]))) == n
    assert np.isnan(path.distance_m)


def test_smoothing_removes_the_noise_of_the_acceleration():
    noisy = straight(TIME_S) + np.random.default_rng(1).normal(0, 0.02, (40, 3))
    exact, smooth = point_kinematics(TIME_S, noisy), smoothed(TIME_S, noisy)
    assert np.abs(exact.acceleration_m_s2 - 4).max() > 50
    assert np.abs(smooth.acceleration_m_s2 - 4)[30:-30].max() < 4
    assert np.sqrt(np.mean((smooth.series.value[::10] - noisy) ** 2)) < 0.0205


def test_jitter_is_estimated_and_removed():
    time_s = np.arange(60) / FPS
    sigma = np.array([0.01, 0.3, 0.05])
    noisy = straight(time_s) + np.random.default_rng(2).normal(0, 1, (60, 3)) * sigma
    noisy[20], noisy[40, 1] = np.nan, 50.0
    jitter = frame_jitter_m(noisy)
    np.testing.assert_allclose(jitter, sigma, rtol=0.4)
    noisy[40] = np.nan
    exact, smooth = point_kinematics(time_s, noisy), smoothed(time_s, noisy)
    true = point_kinematics(time_s, straight(time_s))
    assert exact.distance_m > 1.3 * true.distance_m
    assert smooth.distance_m == pytest.approx(true.distance_m, rel=0.03)
    assert smooth.peak_speed_m_s == pytest.approx(true.peak_speed_m_s, rel=0.15)


def test_no_jitter():
    points = circle(TIME_S)
    assert frame_jitter_m(points).max() < 1e-4
    np.testing.assert_allclose(smoothed(TIME_S, points).speed_m_s, 3.0, rtol=1e-2)
    assert np.isnan(frame_jitter_m(points[:5])).all()


def test_times_must_increase():
    with pytest.raises(ValueError, match="strictly increasing"):
        point_kinematics(TIME_S[::-1], straight(TIME_S))


def test_lasting_errors_are_part_of_the_deviations_of_speeds():
    """The noise of each frame partly continues the noise of the previous frame."""
    rng, points = np.random.default_rng(3), np.zeros((120, 3))
    points[:, 0] = 12 * np.arange(120) / 90
    noise = rng.normal(0, 0.05, points.shape)
    for frame in range(1, len(noise)):
        noise[frame] += 0.8 * noise[frame - 1]
    time_s = np.arange(120) / 90
    found = point_kinematics(time_s, points + noise, lasting_errors(points + noise, 90), smooth=True).series
    independent = point_kinematics(time_s, points + noise, jitter_errors(points + noise), smooth=True).series
    # Smoothing depends on the independent errors only, so the curves are equal and their standard deviations differ.
    np.testing.assert_array_equal(found.rate, independent.rate)
    error = found.rate - [12, 0, 0]
    ratios = [float(np.sqrt(np.mean((error / of.rate_sigma) ** 2))) for of in (found, independent)]
    assert 0.4 < ratios[0] < 1.3
    assert ratios[1] > 1.5 * ratios[0]


def test_net_acceleration_and_its_deviation_equal_known_values():
    time_s, rng = np.arange(60) / 90, np.random.default_rng(0)
    along = 8 * time_s + 0.5 * 6 * time_s**2
    points = np.stack([-0.6 * along, 0.8 * along, 0.4 + 0.05 * np.sin(20 * time_s)], axis=1)
    assert net_acceleration(time_s, points)[0] == pytest.approx(6)
    errors = [Errors(np.full(points.shape, 0.03))]
    found = [net_acceleration(time_s, points + rng.normal(0, 0.03, points.shape), errors) for _ in range(300)]
    values, sigmas = np.array(found).T
    assert values.std() == pytest.approx(sigmas.mean(), rel=0.15)
    points[20:25] = np.nan
    assert net_acceleration(time_s, points)[0] == pytest.approx(6)
    assert np.isnan(net_acceleration(time_s[:3], points[:3])[0])
