"""Test on simulated cameras that a camera that disagrees with the others is reported, with the cause and its size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from example_run import ASIDE, BODY, FPS, KEYPOINT_M, POSES, late, run_views, truth_m, view_of

from recon import FitSettings, fit_clip, load_skeleton, read_cameras, write_cameras
from recon.check.agreement import MAX_FRAMES, agreement_findings, swaps_by_effect
from recon.check.codes import finding
from recon.check.refined_poses import rays_meet_worse, why_not_refined
from recon.clip import View
from recon.fit.result import Finding, TrajectorySolution
from recon.geometry.frames import euler_rotation, rigid
from recon.testing.cameras import level_pose
from recon.testing.rigs import random_motion, write_rig_clip


def agreement_of(views: list[View], offset_s: Sequence[float] = (0.0,) * 5, fitted=None) -> tuple[Finding, ...]:
    """Return the findings on the agreement of views, computed from a stand-in for a motion with only these views."""
    # A further lag of 0.3 frames that the fit did not find.
    late = replace(views[0], offset_frames=views[0].offset_frames + 0.3)
    leads = [view.offset_frames for view in views]
    sources = [SimpleNamespace(offset_frames=lead, offset_s=s) for lead, s in zip(leads, offset_s, strict=False)]
    frames = np.arange(100, 100 + len(views[0].xy_px))
    solution = SimpleNamespace(views=[late, *views[1:]], joints_m=truth_m())
    motion = SimpleNamespace(solution=solution, sources=sources, fps=FPS, frames=frames, trunk_m=0.7)
    return agreement_findings(motion, 2.0, KEYPOINT_M, fitted)  # type: ignore[arg-type]


def findings(found: Sequence[Finding]) -> list[tuple[str, tuple[int, ...]]]:
    """Return the code and the indices of the cameras of each finding that is not a note."""
    return [
        (one.code, tuple(int(name[3:]) - 1 for name in one.names("cameras") or (str(one.camera),)))
        for one in found
        if one.severity != "note"
    ]


def notes(found: Sequence[Finding]) -> list[SimpleNamespace]:
    """Return the numbers of the note on each camera."""
    return [SimpleNamespace(**one.numbers) for one in found if one.code == "camera_agreement"]


def turned(view: View, axis: int) -> View:
    """Return the view of a camera that was turned by five degrees about its x, y or z axis (0 to 2)."""
    rotation = euler_rotation(np.radians(5.0) * np.eye(3)[axis])
    return replace(view, T_camera_world=rigid(rotation, np.zeros(3)) @ view.T_camera_world)


def exchanged(views: list[View], a: int, b: int) -> list[View]:
    views = [*views]
    views[a], views[b] = replace(views[a], xy_px=views[b].xy_px), replace(views[b], xy_px=views[a].xy_px)
    return views


@pytest.mark.parametrize("n", [2, 3, 4])
def test_agreeing_cameras_have_no_finding(n):
    found = agreement_of(run_views(n))
    assert findings(found) == []
    assert notes(found)[0].max_level == 1.6
    for camera in notes(found):
        assert camera.points == truth_m()[..., 0].size
        assert camera.level == pytest.approx(0.95, abs=0.15)  # the expected noise includes the noise of the keypoints
    if n > 2:
        assert max(camera.turn_rad for camera in notes(found)) < np.radians(0.3)
        assert {camera.late_frames for camera in notes(found)} <= {-0.25, 0.0, 0.25}


@pytest.mark.parametrize(
    ("n", "which", "axis"),
    [(4, 2, 0), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((3, 0, 0), (3, 2, 1), (4, 0, 2)))],
)
def test_a_turned_camera_is_named_with_its_angle(n, which, axis):
    views = run_views(n)
    views[which] = turned(views[which], axis)
    found = agreement_of(views)
    assert findings(found) == [("camera_turned", (which,))]
    assert np.degrees(notes(found)[which].turn_rad) == pytest.approx(5.0, abs=0.5)
    assert notes(found)[which].level_turned < 1.2


@pytest.mark.parametrize(("shift_m", "severity"), [(0.01, "warning"), (0.2, "error")])
def test_the_effect_of_a_camera_is_that_on_the_fit(shift_m, severity):
    """The effect is the change of the fit without the camera, however much the camera moves triangulated points."""
    views, used, joints_m = run_views(3), [], truth_m()
    views[1] = turned(views[1], 1)
    stretched_m = joints_m + shift_m + 0.003 * (joints_m - joints_m.mean(axis=1, keepdims=True))

    def fitted(some: Sequence[View]) -> SimpleNamespace:
        used.append([view.camera.name for view in some])
        return SimpleNamespace(joints_m=stretched_m)

    item = next(one for one in agreement_of(views, fitted=fitted) if one.code == "camera_turned")
    assert used == [["cam1", "cam3"]]
    assert item.numbers["position_effect_m"] == pytest.approx(np.sqrt(3) * shift_m)
    assert 0.0 < item.numbers["pose_effect_m"] < 0.003
    assert item.severity == severity  # a camera that contradicts the others grossly is never a note
    item = next(one for one in agreement_of(views) if one.code == "camera_turned")
    assert (item.severity, "pose_effect_m" in item.numbers) == ("error", False)


def test_the_effect_of_a_camera_agrees_with_a_fit_of_correct_cameras(tmp_path):
    """The stated effect of a turned camera is about the change of the result if its pose is corrected."""
    body = load_skeleton("dog-27")
    states = random_motion(body, np.random.default_rng(0), frames=30)
    states[:, 2] += 0.1
    bearings = np.radians([0.0, 30.0, 200.0])
    centres_m = np.stack([3.0 * np.cos(bearings), 3.0 * np.sin(bearings), np.full(3, 1.0)], axis=1)
    files, _ = write_rig_clip(tmp_path, "dog-27", states, 60.0, centres_m, 1.0, 0.3, 2.0)
    cameras = read_cameras((files["rig"],))
    turn = euler_rotation(np.radians([0.0, 4.0, 0.0]))
    wrong = replace(cameras[2], rotation=turn @ cameras[2].rotation, translation_m=turn @ cameras[2].translation_m)
    write_cameras([*cameras[:2], wrong], tmp_path / "turned.toml")
    clip = {"keypoints": [files[f"cam{number}"] for number in (1, 2, 3)], "skeleton": "dog-27", "fps": 60, "fast": True}
    clean, motion = (fit_clip(FitSettings(**clip, camera=path)) for path in (files["rig"], tmp_path / "turned.toml"))
    item = next(one for one in motion.findings if one.code == "camera_turned")
    apart_m = motion.joints_m - clean.joints_m
    change_m = np.linalg.norm(apart_m.mean(axis=1), axis=1).mean()
    assert item.camera == "cam3"
    assert item.numbers["position_effect_m"] == pytest.approx(change_m, rel=0.5)


@pytest.mark.parametrize(
    ("n", "which", "frames"),
    [(3, 1, -10), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((4, 0, 10), (3, 2, 10)))],
)
def test_a_late_or_early_camera_is_named_with_its_lag(n, which, frames):
    views = run_views(n)
    views[which] = late(views[which], frames)
    found = agreement_of(views, offset_s=[0.0, 0.25, 0.5, 0.75])
    assert findings(found) == [("camera_late", (which,))]
    assert (found[0].camera, found[0].frames) == (f"cam{which + 1}", (100, 100 + len(truth_m())))
    assert found[0].numbers["offset_s"] == pytest.approx(0.25 * which + frames / FPS, abs=0.25 / FPS)
    assert notes(found)[which].late_frames == pytest.approx(frames, abs=0.25)
    assert notes(found)[which].level_late < 1.2 < 3 < notes(found)[which].level


def test_a_known_lag_is_taken_into_account():
    """A lag of half a frame is reported only if the view does not already state it."""
    views, points = run_views(3), truth_m()
    between = 0.5 * (points + np.concatenate([points[1:], 2 * points[-1:] - points[-2:-1]]))
    views[1] = replace(view_of(between, ASIDE, sigma_px=0.5, seed=1), camera=views[1].camera, offset_frames=0.5)
    assert notes(agreement_of(views))[1].late_frames == 0.0
    assert notes(agreement_of([views[0], replace(views[1], offset_frames=0.0), views[2]]))[1].late_frames == 0.5


@pytest.mark.parametrize(("n", "pair"), [(3, (0, 1)), pytest.param(4, (1, 2), marks=pytest.mark.slow)])
def test_two_exchanged_files_are_named(n, pair):
    found = agreement_of(exchanged(run_views(n), *pair))
    assert findings(found) == [("cameras_exchanged", pair)]
    assert min(notes(found)[v].level for v in pair) > 3


def test_a_camera_from_another_clip_is_named_without_a_cause():
    """No rotation and no time offset make the detections from another run fit."""
    views = run_views()
    points = truth_m()[::-1] * [1.0, 1.0, 1.6] + [0.0, 2.0, 0.4]
    views[3] = replace(view_of(points, POSES[3], seed=9), camera=views[3].camera)
    assert findings(agreement_of(views)) == [("camera_off", (3,))]


@pytest.mark.slow
def test_two_wrong_cameras_are_named():
    views = run_views()
    views[1], views[3] = turned(views[1], 1), late(views[3], 8)
    fifth = view_of(truth_m(), level_pose([1.0, -1.0, 1.5], 0.45 * np.pi), seed=5)
    views.append(replace(fifth, camera=replace(fifth.camera, name="cam5")))
    assert findings(agreement_of(views)) == [("camera_turned", (1,)), ("camera_late", (3,))]


def test_with_two_cameras_neither_is_named():
    views = run_views(2)
    views[1] = turned(views[1], 0)
    found = agreement_of(views)
    assert findings(found) == [("cameras_disagree", (0, 1))]
    assert np.isnan(notes(found)[0].turn_rad)
    assert findings(agreement_of(exchanged(run_views(2), 0, 1))) == [("cameras_exchanged", (0, 1))]


def test_cameras_without_common_frames_cannot_be_compared():
    views = run_views()[:2]
    views[0] = replace(views[0], xy_px=np.where(np.arange(len(truth_m()))[:, None, None] < 12, views[0].xy_px, np.nan))
    views[1] = replace(views[1], xy_px=np.where(np.arange(len(truth_m()))[:, None, None] < 12, np.nan, views[1].xy_px))
    found = agreement_of(views)
    assert [one.code for one in found if one.severity != "note"] == ["cameras_apart_in_time"]
    assert [camera.points for camera in notes(found)] == [0, 0]
    assert np.isnan(notes(found)[0].level)


def test_noisy_detections_are_not_reported_as_disagreement():
    views = [view_of(truth_m(), T, sigma_px=4.0, seed=i) for i, T in enumerate(POSES)]
    found = agreement_of(views)
    assert findings(found) == []
    assert 1.6 * 1.5 < notes(found)[0].max_level < 1.6 * 2.0
    assert max(camera.level for camera in notes(found)) > 1.6


@pytest.mark.slow
def test_a_long_clip_is_compared_where_most_is_detected():
    views = run_views(3)
    xy_px = [np.concatenate([np.full((600, *v.xy_px.shape[1:]), np.nan), v.xy_px]) for v in views]
    views = [replace(v, xy_px=xy, confidence=np.ones(xy.shape[:2])) for v, xy in zip(views, xy_px, strict=True)]
    T = len(xy_px[0])
    found = agreement_of(views)
    assert found[0].frames == (100 + T - MAX_FRAMES, 100 + T)
    assert notes(found)[0].points == truth_m()[..., 0].size


def test_one_camera_has_no_finding_on_agreement():
    assert agreement_of(run_views(1)) == ()


def test_refined_poses_that_fit_worse_are_used_only_if_allowed(two_cameras):
    """Refined poses that fit worse are used only if this is allowed and no camera becomes an outlier.

    It is allowed for a fit that also solved for the lengths.
    """

    def moved(shift_px: Sequence[float]) -> TrajectorySolution:
        solution = two_cameras.solution
        views = [replace(v, xy_px=v.xy_px + px) for v, px in zip(solution.views, shift_px, strict=True)]
        return replace(solution, views=tuple(views))

    def reasons(shift_px: Sequence[float], **options: bool) -> list[str]:
        return [one.code for one in why_not_refined(moved(shift_px), moved([5.0, 5.0]), -1.0, **options)]

    assert reasons([5.0, 5.0]) == []
    assert reasons([10.0, 10.0]) == ["cameras_not_refined"]
    assert reasons([10.0, 10.0], may_fit_worse=True) == []
    assert reasons([5.0, 100.0], may_fit_worse=True) == ["cameras_not_refined"]


@pytest.mark.parametrize("sigma_px", [0.5, 4.0])
def test_a_turned_camera_makes_rays_meet_worse_and_its_right_pose_better(sigma_px):
    views = [view_of(truth_m(), T, sigma_px=sigma_px, seed=i) for i, T in enumerate(POSES[:2])]
    right, wrong = (SimpleNamespace(views=pair) for pair in (views, [views[0], turned(views[1], 0)]))
    assert rays_meet_worse(wrong, right)  # type: ignore[arg-type]
    assert not rays_meet_worse(right, wrong)  # type: ignore[arg-type]
    assert not rays_meet_worse(right, right)  # type: ignore[arg-type]


@pytest.mark.parametrize(("shift_m", "severity"), [(0.01, "note"), (0.04, "warning")])
def test_the_effect_of_a_swap_is_that_on_a_fit_without_it(shift_m, severity):
    """Left and right are exchanged back in the swapped frames, and the frames around them are fitted again."""
    views, joints_m, fitted_views = run_views(3), truth_m(), []
    names, rows = ("l_front_paw", "r_front_paw"), slice(20, 25)
    columns = [BODY.markers.index(name) for name in names]
    swapped_px = views[1].xy_px.copy()
    swapped_px[rows, columns] = views[1].xy_px[rows, columns[::-1]]
    solution = SimpleNamespace(views=[views[0], replace(views[1], xy_px=swapped_px), views[2]], joints_m=joints_m)
    frames = np.arange(100, 100 + len(joints_m))
    motion = SimpleNamespace(solution=solution, frames=frames, body=BODY, trunk_m=0.7)

    def fitted(some: Sequence[View]) -> SimpleNamespace:
        fitted_views[:] = some
        return SimpleNamespace(joints_m=joints_m[10:35] + np.array([shift_m, 0.0, 0.0]))

    swap = finding("left_right_swap", (120, 125), "cam2", part="the fore legs", keypoints=names)
    other = finding("frame_rate", given_hz=30.0, other_hz=60.0)
    weighed = swaps_by_effect((other, swap), motion, fitted)  # type: ignore[arg-type]
    assert weighed[0] is other
    assert weighed[1].severity == severity
    assert weighed[1].numbers["position_effect_m"] == pytest.approx(shift_m)
    assert weighed[1].numbers["pose_effect_m"] == pytest.approx(0.0, abs=1e-12)
    for used, view in zip(fitted_views, views, strict=True):
        np.testing.assert_array_equal(used.xy_px, view.xy_px[10:35])
    solution.views = solution.views[:2]
    assert swaps_by_effect((swap,), motion, fitted) == (swap,)  # type: ignore[arg-type]
