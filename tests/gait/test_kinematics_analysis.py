"""Test velocities, accelerations and joint angles against motions known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from recon import InputError
from recon.gait.kinematics import (
    angle_between,
    angle_kinematics,
    angle_sigma,
    frame_times,
    joint_angle,
    joint_kinematics,
    point_kinematics,
    sagittal_flexion,
    spine_flexion,
)
from recon.gait.series import ORDERS, Errors, _curve, _discrepancy_lam, series_kinematics
from recon.io.common import Pose3D
from recon.testing.gallop import gallop

FPS = 60.0
TIME_S = np.arange(60) / FPS


def circle(time_s: np.ndarray) -> np.ndarray:
    """Return positions on a circle of radius 2 m at 1.5 rad/s, with a speed of 3 m/s and 4.5 m/s^2 of acceleration."""
    return 2.0 * np.stack([np.cos(1.5 * time_s), np.sin(1.5 * time_s), 0 * time_s], axis=1)


def parabola(time_s: np.ndarray) -> np.ndarray:
    """Return the positions of a point thrown at (4, 0, 3) m/s that falls with 9.81 m/s^2."""
    return np.stack([4 * time_s, 0 * time_s, 3 * time_s - 0.5 * 9.81 * time_s**2], axis=1)


def test_circle():
    moved = point_kinematics(TIME_S, circle(TIME_S))
    np.testing.assert_allclose(moved.speed_m_s, 3.0, rtol=1e-4)
    np.testing.assert_allclose(moved.acceleration_m_s2[30:-30], 4.5, rtol=1e-3)
    np.testing.assert_allclose(moved.acceleration_m_s2, 4.5, rtol=5e-3)
    assert moved.distance_m == pytest.approx(3 * TIME_S[-1], rel=1e-5)
    assert moved.mean_speed_m_s == pytest.approx(3.0, rel=1e-5)
    assert np.isnan(moved.speed_sigma_m_s).all()


def test_parabola_is_exact():
    moved = point_kinematics(TIME_S, parabola(TIME_S))
    assert len(moved.series.time_s) == 591
    np.testing.assert_allclose(moved.series.value, parabola(moved.series.time_s), atol=1e-12)
    np.testing.assert_allclose(moved.series.acceleration, np.tile([0, 0, -9.81], (591, 1)), atol=1e-7)
    end = TIME_S[-1]
    assert moved.peak_speed_m_s == pytest.approx(np.hypot(4, 3 - 9.81 * end))
    assert moved.peak_speed_time_s == pytest.approx(end)
    assert moved.peak_acceleration_m_s2 == pytest.approx(9.81)


def test_gaps_split_and_nothing_is_extrapolated():
    points = parabola(TIME_S)
    points[:2], points[10:12], points[20:40], points[-3:, 1] = np.nan, np.nan, np.nan, np.nan
    moved = point_kinematics(TIME_S, points)
    known = np.isfinite(moved.speed_m_s)
    np.testing.assert_array_equal(np.flatnonzero(known), np.r_[20:191, 400:561])
    np.testing.assert_allclose(moved.series.value[known], parabola(moved.series.time_s[known]), atol=1e-12)
    known = np.isfinite(point_kinematics(TIME_S, points, max_gap_s=0.04).speed_m_s)
    np.testing.assert_array_equal(np.flatnonzero(known), np.r_[20:91, 120:191, 400:561])


@pytest.mark.parametrize("known", [0, 1, 3])
def test_too_few_points_give_nan(known):
    points = parabola(TIME_S)
    points[known:] = np.nan
    moved = point_kinematics(TIME_S, points, [Errors(np.full((60, 3), 0.01))])
    assert np.isnan(moved.speed_m_s).all()
    assert np.isnan([moved.distance_m, moved.mean_speed_m_s, moved.peak_speed_m_s, moved.peak_speed_time_s]).all()


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("correlation_s", [0.0, 0.03])
def test_deviations_agree_with_many_draws(smooth, correlation_s):
    rng = np.random.default_rng(0)
    time_s = np.arange(20) / FPS
    sigma = np.linspace(0.005, 0.015, 20)
    lag = np.abs(time_s[:, None] - time_s)
    covariance = np.outer(sigma, sigma) * (np.exp(-0.5 * (lag / correlation_s) ** 2) if correlation_s else np.eye(20))
    noise = rng.multivariate_normal(np.zeros(20), covariance, 400).T
    sigma = sigma[:, None]
    # All draws have the same lam, since the propagated noise is that for a given lam.
    given = series_kinematics(
        time_s, np.sin(20 * time_s)[:, None] + noise[:, :1], [Errors(sigma, correlation_s)], smooth=smooth
    )
    if smooth:
        weight = 1 / sigma[:, 0]
        lam = _discrepancy_lam(time_s, np.sin(20 * time_s) + noise[:, 0], weight)
        drawn = _curve(time_s, noise, weight, lam)(given.time_s, ORDERS)
    else:
        many = series_kinematics(time_s, noise)
        drawn = np.stack([many.value, many.rate, many.acceleration])
    for found, sample in zip((given.value_sigma, given.rate_sigma, given.acceleration_sigma), drawn, strict=True):
        assert found is not None
        expected = sample.std(axis=1)
        big = expected > 0.05 * expected.max()  # the acceleration is zero at a natural end
        np.testing.assert_allclose(found[big, 0], expected[big], rtol=0.2)


def test_deviations_of_a_long_clip_equal_its_whole_spline():
    """Standard deviations of a long clip, computed in pieces, equal the standard deviations of the whole spline.

    Several errors add up, and one of them lasts throughout the clip.
    """
    rng = np.random.default_rng(1)
    time_s = np.arange(450) / FPS
    errors = [Errors(rng.uniform(0.01, 0.02, (450, 1))), Errors(rng.uniform(0.1, 0.2, (450, 1)), 0.1)]
    errors += [Errors(np.cos(9 * time_s)[:, None], np.inf)]
    moved = series_kinematics(time_s, np.sin(time_s)[:, None], errors, oversampling=2)
    operator = _curve(time_s, np.eye(450), np.ones(450), 0.0)(moved.time_s, ORDERS)
    smooth = np.exp(-0.5 * ((time_s[:, None] - time_s) / 0.1) ** 2)
    covariance = np.diag(errors[0].sigma[:, 0] ** 2) + errors[1].sigma * smooth * errors[1].sigma[:, 0]
    covariance += errors[2].sigma * errors[2].sigma[:, 0]
    expected = np.sqrt(np.einsum("omi,ij,omj->om", operator, covariance, operator, optimize=True))
    for found, whole in zip((moved.value_sigma, moved.rate_sigma, moved.acceleration_sigma), expected, strict=True):
        assert found is not None
        np.testing.assert_allclose(found[:, 0], whole, rtol=1e-6)


@pytest.mark.parametrize("smooth", [False, True])
def test_deviations_of_some_orders_equal_a_computation_of_all(smooth):
    errors = [Errors(np.full((60, 3), 0.01)), Errors(np.full((60, 3), 0.02), 0.1)]
    every, rates = (
        series_kinematics(TIME_S, circle(TIME_S), errors, smooth=smooth, propagate=orders) for orders in (ORDERS, (1,))
    )
    np.testing.assert_array_equal(rates.rate_sigma, every.rate_sigma)
    np.testing.assert_array_equal(rates.acceleration, every.acceleration)
    assert np.isnan([rates.value_sigma, rates.acceleration_sigma]).all()
    assert np.isfinite([every.value_sigma, every.acceleration_sigma]).all()


def test_deviations_of_an_exact_spline_in_numbers():
    """Standard deviations of an exact spline are 1.2 s fps and 6 s fps^2 at frames, and larger at the ends."""
    moved = series_kinematics(TIME_S, circle(TIME_S), [Errors(np.full((60, 3), 0.01))])
    rate, acceleration = moved.rate_sigma[::10, 0], moved.acceleration_sigma[::10, 0]
    assert rate[30] == pytest.approx(1.2 * 0.01 * FPS, rel=0.03)
    assert acceleration[30] == pytest.approx(6 * 0.01 * FPS**2, rel=0.01)
    np.testing.assert_allclose(rate[:2] / rate[30], [3.84, 1.34], atol=0.01)
    assert acceleration[0] / acceleration[30] == pytest.approx(1.54, abs=0.01)
    for spread in (rate, acceleration):
        np.testing.assert_allclose(spread[2:-2] / spread[30], 1.0, atol=0.14)


def test_smoothing_removes_the_stated_noise():
    sigma = np.full((60, 3), 0.01)
    noisy = circle(TIME_S) + np.random.default_rng(1).normal(0, 0.01, (60, 3))
    exact, smooth = (point_kinematics(TIME_S, noisy, [Errors(sigma)], smooth=s) for s in (False, True))
    chi2 = np.mean(((smooth.series.value[::10] - noisy) / sigma)[:, :2] ** 2, axis=0)
    np.testing.assert_allclose(chi2, 1.0, atol=0.01)
    assert np.sqrt(np.mean((exact.speed_m_s - 3) ** 2)) > 0.5
    assert np.sqrt(np.mean((smooth.speed_m_s - 3)[20:-20] ** 2)) < 0.15
    assert np.median(smooth.speed_sigma_m_s) < 0.2 * np.median(exact.speed_sigma_m_s)


def test_smoothing_a_straight_line_gives_a_straight_line():
    moved = series_kinematics(TIME_S, 3.0 * TIME_S[:, None], [Errors(np.full((60, 1), 0.01))], smooth=True)
    np.testing.assert_allclose(moved.rate, 3.0, atol=1e-6)


def test_a_cosine_angle():
    """An angle of 0.8 + 0.5 cos(6 t) rad has its range and its rate, with both ends of its swing reached."""
    time_s = np.arange(120) / 60
    angle = angle_kinematics(time_s, 0.8 + 0.5 * np.cos(6 * time_s))
    np.testing.assert_allclose(angle.series.rate[20:-20, 0], -3.0 * np.sin(6 * angle.series.time_s[20:-20]), atol=1e-3)
    assert angle.range_rad == pytest.approx((0.3, 1.3), abs=1e-4)
    assert angle.range_of_motion_rad == pytest.approx(1.0, abs=1e-4)
    assert angle.peak_rate_rad_s == pytest.approx(3.0, rel=1e-3)
    assert angle.peak_acceleration_rad_s2 == pytest.approx(18.0, rel=0.01)


def test_a_joint_that_passes_through_straight_has_no_peak_there():
    """A link turns at 5 rad/s from one side to the other, and its angle between 0 and pi reverses at pi."""
    turn = np.linspace(-1.0, 1.0, 25)
    tip = np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    pose = Pose3D(("a", "b", "c"), np.stack([0 * tip - [1, 0, 0], 0 * tip, tip], axis=1), np.arange(25))
    errors = [Errors(np.full((25, 3, 3), 0.03), 0.1)]
    exact, found = (joint_angle(pose, ("a", "b", "c"), 60, of) for of in ((), errors))
    assert exact.peak_acceleration_rad_s2 > 1000
    assert found.peak_rate_rad_s == pytest.approx(5.0, rel=0.1)
    assert found.peak_acceleration_rad_s2 < 100


def test_an_angle_beyond_a_full_turn_does_not_jump():
    turn = 5.0 * TIME_S
    angle = angle_kinematics(TIME_S, np.arctan2(np.sin(turn), np.cos(turn)))
    np.testing.assert_allclose(angle.series.rate, 5.0, atol=1e-8)


def leg(bend_rad: np.ndarray) -> Pose3D:
    """Return a pose of hip, knee and foot with the given knee angle, rad, and links of 1 m in a tilted plane."""
    hip, knee = np.zeros((len(bend_rad), 3)), np.tile([0.0, 0.6, -0.8], (len(bend_rad), 1))
    across = np.array([1.0, 0.0, 0.0])
    foot = knee + np.cos(bend_rad)[:, None] * (hip - knee) + np.sin(bend_rad)[:, None] * across
    return Pose3D(("hip", "knee", "foot"), np.stack([hip, knee, foot], axis=1), np.arange(len(bend_rad)))


def test_joint_angle_and_its_deviation():
    bend = 1.8 + 0.5 * np.sin(4 * TIME_S)
    sigma = np.full((60, 3, 3), 0.01)
    angle = joint_angle(leg(bend), ("hip", "knee", "foot"), FPS, [Errors(sigma)])
    np.testing.assert_allclose(angle.series.value[::10, 0], bend, atol=1e-9)
    # Errors of the ends rotate one link by sigma / 1 m each; an error of the knee rotates both links.
    expected = 0.01 * np.sqrt(2 + 2 - 2 * np.cos(bend))
    np.testing.assert_allclose(angle.series.value_sigma[::10, 0], expected, rtol=1e-6)


def test_angles_of_coinciding_points_are_unknown():
    point = np.zeros((2, 3))
    assert np.isnan(angle_between(point, point, point + 1)).all()
    straight, upright = (np.array([[0.0 * axis, axis, 2 * axis]]) for axis in np.eye(3)[[0, 2]])
    assert angle_between(*straight.transpose(1, 0, 2))[0] == np.pi
    assert np.isnan(sagittal_flexion(*upright.transpose(1, 0, 2))).all()
    # The signed angle is smooth at a straight back.
    assert angle_sigma(sagittal_flexion, straight, np.full((1, 3, 3), 0.01))[0] == pytest.approx(0.01 * np.sqrt(6))


@pytest.mark.parametrize("heading", [0.0, 2.5])
def test_spine_flexion_is_positive_when_arched_up(heading):
    rise = 0.3 * np.sin(5 * TIME_S)
    ahead = np.array([np.cos(heading), np.sin(heading), 0.0])
    spine = 0.5 * ahead + np.stack([0 * rise, 0 * rise, 0.5 * rise], axis=1)
    pose = Pose3D(
        ("neck_base", "spine", "tail_base"),
        np.stack([np.tile(ahead, (60, 1)), spine, np.zeros((60, 3))], axis=1),
        np.arange(60),
    )
    angle = spine_flexion(pose, FPS, [Errors(np.full((60, 3, 3), 0.01))])
    np.testing.assert_allclose(angle.series.value[::10, 0], 2 * np.arctan(rise), atol=1e-12)


def test_peak_speed_of_the_simulated_gallop():
    """The peak speed of every joint of the simulated gallop at 90 fps agrees with the formula at 3600 fps."""
    fine = gallop(fps=3600.0, n_frames=3600)
    coarse = gallop(fps=90.0, n_frames=90)
    true = np.linalg.norm(fine.truth_m[2:] - fine.truth_m[:-2], axis=2) * 1800
    pose = Pose3D(coarse.names, coarse.truth_m, np.arange(90))
    inside = slice(80, 89 * 40 - 80)  # two frames from the ends
    for j, name in enumerate(coarse.names):
        moved = joint_kinematics(pose, name, 90.0)
        assert np.nanmax(moved.speed_m_s[20:-20]) == pytest.approx(true[inside, j].max(), rel=0.01), name


def test_left_out_frames_are_bridged():
    frames = np.r_[3:20, 22:60]
    pose = Pose3D(("paw",), parabola(frames / FPS)[:, None], frames)
    moved = joint_kinematics(pose, "paw", FPS)
    assert moved.series.time_s[0] == pytest.approx(3 / FPS)
    np.testing.assert_allclose(moved.series.value, parabola(moved.series.time_s), atol=1e-12)


def test_bad_input():
    pose = leg(np.ones(5))
    with pytest.raises(InputError) as error:
        joint_angle(pose, ("hip", "elbow", "nose"), FPS)
    assert len(error.value.problems) == 2
    with pytest.raises(ValueError, match="positive frame rate"):
        frame_times(np.arange(3), 0.0)
    with pytest.raises(ValueError, match="strictly increasing"):
        point_kinematics(TIME_S[::-1], circle(TIME_S))
