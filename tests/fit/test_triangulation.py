"""Test triangulation without a skeleton: points, covariances, outliers and gaps of a simulated rig."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon.clip import View, still_view
from recon.fit.triangulation import OUTLIER_SIGMAS, predicted_by_others, smoothed, triangulate_views
from recon.geometry.camera import Camera
from recon.testing.cameras import aim_camera

SIGMA_PX, FPS, T = 1.5, 60.0, 60
DISTORTION = np.array([-0.25, 0.08, 0.001, -0.001, 0.0])


def rig(count: int) -> list[Camera]:
    """Return cameras with distorting lenses on a circle of 3 m around the origin."""
    cameras = []
    for i in range(count):
        bearing = 2 * np.pi * i / max(count, 3) + 0.1
        lens = replace(Camera.from_hfov(60.0, (1280, 1024), name=f"cam{i}"), model="radtan", distortion=DISTORTION)
        centre_m = np.array([3 * np.cos(bearing), 3 * np.sin(bearing), 0.6 + 0.4 * (i % 2)])
        cameras.append(aim_camera(lens, centre_m, np.array([0.0, 0.0, 0.3])))
    return cameras


def points() -> np.ndarray:
    """Return the paths (T, 6, 3), m, of six points that move smoothly within half a metre."""
    time_s, random = np.arange(T) / FPS, np.random.default_rng(1)
    phase, position = random.uniform(0, 6, (6, 3)), random.uniform(-0.4, 0.4, (6, 3)) + np.array([0, 0, 0.4])
    return position + 0.1 * np.sin(2 * np.pi * 1.5 * time_s[:, None, None] + phase)


def seen(cameras: list[Camera], points_m: np.ndarray, sigma_px: float = SIGMA_PX) -> list[View]:
    random, views = np.random.default_rng(2), []
    for camera in cameras:
        xy_px, valid = camera.project(camera.world_to_camera(points_m))
        assert valid.all()
        xy_px = xy_px + random.normal(0, sigma_px, xy_px.shape)
        views.append(still_view(camera, xy_px, np.ones(valid.shape)))
    return views


def moved(view: View, where: tuple[object, ...], xy_px: object) -> View:
    changed = view.xy_px.copy()
    changed[where] = xy_px
    return replace(view, xy_px=changed)


def test_exact_detections_of_distorting_lenses_give_the_points_exactly():
    result = triangulate_views(seen(rig(3), points(), 0.0))
    assert np.abs(result.points_m - points()).max() < 1e-6
    assert result.is_used.all()


@pytest.mark.parametrize("count", [2, 4, 6])
def test_noise_is_estimated_and_covariances_are_correct(count):
    result = triangulate_views(seen(rig(count), points()))
    error_m = result.points_m - points()
    known = np.isfinite(error_m[..., 0])
    assert known.mean() > 0.97
    assert result.sigma_px == pytest.approx(np.full(6, SIGMA_PX), rel=0.3)
    square = np.einsum("na,nab,nb->n", error_m[known], np.linalg.inv(result.covariance_m2[known]), error_m[known])
    assert 0.84 < np.mean(square < 6.25) < 0.97  # 6.25 is the 90 % quantile of chi square with three degrees of freedom
    assert np.median(np.linalg.norm(error_m[known], axis=-1)) < 0.008


def test_other_views_predict_the_keypoints_of_a_view():
    """The given points are 5 mm off, and the first view, which has a wrong point, does not contribute to its own."""
    views = seen(rig(4), points())
    views[0] = moved(views[0], (slice(None), 0), views[0].xy_px[:, 1])
    views[1] = moved(views[1], (5, 2), np.nan)
    views[2] = moved(views[2], (5, 2), np.nan)
    noise_px = [np.full((T, 6), SIGMA_PX)] * 4
    start_m = points() + np.random.default_rng(3).normal(0, 0.005 / np.sqrt(3), points().shape)
    (predicted_px, sigma_px), *_ = predicted_by_others(views, start_m, noise_px)
    assert np.argwhere(np.isnan(sigma_px)).tolist() == [[5, 2]]
    true_px, _ = views[0].project(points())
    errors = (predicted_px - true_px) / sigma_px[..., None]
    assert np.nanstd(errors) == pytest.approx(1.0, rel=0.15)
    triangulated_px, _ = views[0].project(triangulate_views(views[1:]).points_m)
    assert np.nanmax(np.abs(predicted_px - triangulated_px)) < 1.0


def test_outliers_of_single_cameras_are_left_out():
    views = seen(rig(5), points())
    views[0] = moved(views[0], (slice(10, 20), 2), [100.0, 100.0])
    views[3] = moved(views[3], (slice(15, 30), 4), [900.0, 200.0])
    result = triangulate_views(views)
    assert not result.is_used[0, 10:20, 2].any()
    assert not result.is_used[3, 15:30, 4].any()
    assert result.is_used.mean() > 0.95
    assert np.linalg.norm(result.points_m - points(), axis=-1).max() < 0.03
    assert np.nanmin(result.error_px[0, 10:20, 2]) > OUTLIER_SIGMAS * SIGMA_PX


def test_two_wrong_cameras_of_five_do_not_win():
    views = seen(rig(5), points())
    for camera, xy_px in ((1, [200.0, 300.0]), (4, [1000.0, 700.0])):
        views[camera] = moved(views[camera], (slice(0, 20), 0), xy_px)
    result = triangulate_views(views)
    assert np.linalg.norm(result.points_m - points(), axis=-1).max() < 0.03
    assert not result.is_used[[1, 4], :20, 0].any()


def test_points_seen_by_fewer_than_two_cameras_are_gaps():
    views = seen(rig(3), points())
    views[0], views[1] = (moved(view, (slice(5, 9), 1), np.nan) for view in views[:2])
    result = triangulate_views(views)
    known = np.isfinite(result.points_m[..., 0])
    assert not known[5:9, 1].any()
    assert np.isnan(result.covariance_m2[5:9, 1]).all()
    assert known.sum() == known.size - 4


def test_two_cameras_that_disagree_give_no_point():
    views = seen(rig(2), points())
    views[0] = moved(views[0], (slice(5, 9), 1), views[0].xy_px[5:9, 1] + [0.0, 150.0])
    known = np.isfinite(triangulate_views(views).points_m[..., 0])
    assert not known[5:9, 1].any()
    assert known.sum() >= known.size - 8


def test_cameras_in_one_place_give_no_point():
    (camera, other) = rig(2)
    near = aim_camera(other, camera.centre_world + np.array([0.0, 0.0, 0.005]), np.array([0.0, 0.0, 0.3]))
    result = triangulate_views(seen([camera, near], points()))
    assert np.isnan(result.points_m).all()


@pytest.mark.slow
def test_splines_halve_the_noise_and_fill_short_gaps_only():
    views = seen(rig(3), points(), 4.0)
    views = [moved(moved(view, (slice(20, 24), 0), np.nan), (slice(20, 45), 1), np.nan) for view in views]
    plain = triangulate_views(views)
    smooth = smoothed(plain, FPS)
    errors = [np.linalg.norm(result.points_m - points(), axis=-1) for result in (plain, smooth)]
    both = np.isfinite(errors[0])
    assert np.median(errors[1][both]) < 0.7 * np.median(errors[0][both])
    assert np.isfinite(errors[1][20:24, 0]).all()
    assert errors[1][20:24, 0].max() < 0.03
    assert np.isnan(errors[1][20:45, 1]).all()


def test_camera_late_by_a_fraction_of_a_frame():
    points_m = points()
    views = seen(rig(3), points_m, 0.0)
    later = 0.5 * (points_m[:-1] + points_m[1:])
    late = np.concatenate([later, points_m[-1:]])
    xy_px, _ = views[1].project(late)
    views[1] = replace(views[1], xy_px=xy_px, offset_frames=0.5)
    error_m = np.linalg.norm(triangulate_views(views).points_m - points_m, axis=-1)
    assert error_m[1:-1].max() < 0.002


def test_one_view_is_refused():
    with pytest.raises(ValueError, match="two or more"):
        triangulate_views(seen(rig(2), points())[:1])
