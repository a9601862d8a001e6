"""Test that plausible but wrong inputs are detected, and that correct inputs have no finding."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from example_run import (
    AHEAD,
    ASIDE,
    BODY,
    CAMERA,
    CAMERA_FROM_LEVEL,
    FPS,
    PRIOR,
    errors_m,
    plain,
    run,
    seen,
    solve,
    truth_m,
    two,
    view_of,
)
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation

from recon.api.clip_cameras import other_camera_in
from recon.base.errors import InputError
from recon.check.codes import finding, sentence
from recon.check.inputs import copies, movement
from recon.check.likelihood import baseline_of, lens_findings, with_calibration_at_either_end
from recon.check.rules import ground_elsewhere, pair_disagrees, subject_unlike_species
from recon.clip import Keypoints, Source, clean
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.motion import Motion
from recon.fit.result import Ground
from recon.fit.trajectory import solve_trajectory
from recon.gait.clip import over_belt
from recon.geometry.frames import rigid

NAMES = BODY.keypoint_names(None)


def source(xy_px: np.ndarray, name: str = "cam1") -> Source:
    keypoints = Keypoints(NAMES, xy_px, np.ones(xy_px.shape[:2]), np.arange(len(xy_px)), FPS)
    return Source(replace(CAMERA, name=name), *clean(keypoints, 0.0), NAMES)


def noisy(seed: int = 0) -> np.ndarray:
    return seen(run()) + np.random.default_rng(seed).normal(0, 1, seen(run()).shape)


def frozen(xy_px: np.ndarray) -> np.ndarray:
    return np.where(np.arange(len(xy_px))[:, None, None] < 20, xy_px, xy_px[20])


def interpolated(xy_px: np.ndarray) -> np.ndarray:
    t = np.arange(len(xy_px))
    columns = [np.interp(t, t[::4], column[::4]) for column in xy_px.reshape(len(t), -1).T]
    return np.round(np.stack(columns, axis=1).reshape(xy_px.shape), 3)


def splined(xy_px: np.ndarray) -> np.ndarray:
    t = np.arange(len(xy_px))
    columns = [CubicSpline(t[::8], column[::8])(t) for column in xy_px.reshape(len(t), -1).T]
    return np.round(np.stack(columns, axis=1).reshape(xy_px.shape), 4)


def copied(xy_px: np.ndarray) -> np.ndarray:
    return xy_px[:, [NAMES.index(f"l_{n[2:]}") if n.startswith("r_") else i for i, n in enumerate(NAMES)]]


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (frozen, "detections_frozen"),
        (lambda xy_px: np.repeat(xy_px, 2, axis=0), "detections_repeated"),
        (interpolated, "detections_interpolated"),
        (splined, "detections_curved"),
        (copied, "far_side_copied"),
        (lambda xy_px: np.delete(xy_px, np.arange(3, len(xy_px), 4), axis=0), "frames_dropped"),
    ],
)
def test_copied_points_are_reported(change, code):
    (found,) = copies([source(change(noisy()))])
    assert found.code == code
    if code == "detections_frozen":
        assert found.frames == (20, 40)
    if code == "detections_repeated":
        assert (found.numbers["times"], found.numbers["other_hz"]) == (2, FPS / 2)


def test_one_file_for_two_cameras_is_reported():
    (found,) = copies([source(noisy()), source(noisy(), "cam2")])
    assert found.code == "same_keypoints"
    assert found.names("cameras") == ("cam1", "cam2")
    assert not [*copies([source(noisy()), source(noisy(1), "cam2")])]
    assert not [*copies([source(seen(run()))])]
    assert not [*copies([source(interpolated(noisy())[:37])], resampled=True)]


def test_fast_keypoints_are_not_taken_for_missing_frames():
    """Frames in which only fast keypoints are detected are not taken for steps across missing frames."""
    T, J = noisy().shape[:2]
    px_a_frame = np.where(np.arange(J) < 2 * J // 3, 10.0, 25.0)
    xy_px = np.stack([px_a_frame * np.arange(2 * T)[:, None], np.full((2 * T, J), 500.0)], axis=-1)
    xy_px += np.random.default_rng(0).normal(0, 1, xy_px.shape)
    xy_px[::5, : 2 * J // 3] = np.nan
    assert not [*copies([source(xy_px)])]
    (found,) = copies([source(np.delete(xy_px, np.s_[3::4], axis=0))])
    assert found.code == "frames_dropped"


def test_swinging_legs_and_a_shaking_camera_are_not_missing_frames():
    """Swinging legs and a shaking camera are not taken for steps across missing frames."""
    T, J = 60, noisy().shape[1]
    noise, rng = np.random.default_rng(0).normal(0, 1, (T, J, 2)), np.random.default_rng(1)
    swings = np.cumsum(np.where(np.arange(T) % 12 < 3, 40.0, 10.0))[:, None, None] * [1.0, 0.0]
    shaken = 20.0 * np.arange(T)[:, None, None] * [1.0, 0.0] + rng.normal(0, 8, (T, 1, 2))
    assert not [*copies([source(swings + noise)])]
    assert not [*copies([source(shaken + noise)])]


def moved(states: np.ndarray) -> Motion:
    """Return a motion with the given states."""
    solution, body = plain(), plain().body
    joints_m = body.tree.pose(states, solution.size).points_m
    return Motion((source(noisy()),), None, "", replace(solution, states=states, joints_m=joints_m))


def test_a_running_animal_has_no_finding():
    assert not [*movement(moved(plain().states))]


@pytest.mark.parametrize("code", ["animal_still", "time_reversed", "treadmill", "camera_moves"])
def test_impossible_motions_are_reported(code):
    states = plain().states.copy()
    if code == "animal_still":
        states = np.repeat(states[:1], len(states), axis=0)
    elif code == "time_reversed":
        states = states[::-1].copy()
    else:
        fraction = {"treadmill": 0.0, "camera_moves": 0.4}[code]
        states[:, :2] = states[:1, :2] + fraction * (states[:, :2] - states[:1, :2])
    (found,) = movement(moved(states))
    assert found.code == code


@pytest.mark.parametrize(
    ("prior", "severity", "text"),
    [
        (
            "running-cheetah",
            "warning",
            "(0 m/s), but the prior was learned from moving animals: the errors of poses may be larger",
        ),
        ("none", "note", "(0 m/s): the clip has no strides to measure."),
    ],
)
def test_standing_still_is_a_warning_only_with_a_learned_prior(prior, severity, text):
    motion = moved(np.repeat(plain().states[:1], len(plain().states), axis=0))
    (found,) = movement(replace(motion, solution=replace(motion.solution, prior=prior)))
    assert found.severity == severity
    assert sentence(found).startswith(f"The animal stands still {text}")


def test_an_animal_that_steps_on_the_spot_is_not_on_a_treadmill():
    """An animal that steps on the spot is not on a treadmill, although its feet move backwards as fast as on a belt."""
    states = np.repeat(plain().states[:1], len(plain().states), axis=0)
    states[:, 6:] += np.random.default_rng(0).normal(0.0, 0.1, states[:, 6:].shape)
    assert "treadmill" not in [found.code for found in movement(moved(states))]


@pytest.mark.parametrize(
    ("size", "seconds", "codes"),
    [(1.0, 0.5, ["animal_still"]), (0.1, 0.5, []), (0.5, 0.5, ["animal_still"]), (0.5, 1.0, [])],
)
def test_an_animal_that_stands_still_stays_at_its_position(size, seconds, codes):
    """An animal that stands still is recognised by the extent of its path relative to its trunk.

    All joints move at 0.2 m/s. Whether the animal moves by less than half the length of its trunk depends on its size
    and on the duration of the clip.
    """
    motion = moved(np.repeat(plain().states[:1], len(plain().states), axis=0))
    ahead_m = 0.2 * np.linspace(0, seconds, len(motion.frames))[:, None, None] * np.array([1.0, 0.0, 0.0])
    joints_m, (one,) = size * motion.solution.joints_m + ahead_m, motion.sources
    one = replace(one, keypoints=replace(one.keypoints, fps=len(motion.frames) / seconds))
    found = movement(replace(motion, sources=(one,), solution=replace(motion.solution, joints_m=joints_m)))
    assert [one.code for one in found] == codes


@pytest.mark.parametrize(
    ("times", "ways"), [(1.0, []), pytest.param(1.5, ["in"], marks=pytest.mark.slow), (1 / 1.5, ["out"])]
)
def test_a_zooming_picture_is_reported(times, ways):
    centre = CAMERA.matrix[:2, 2]
    zoom = np.linspace(1.0, times, len(seen(run())))[:, None, None]
    solution = solve(centre + zoom * (seen(run()) - centre))
    setting = ClipProblem.from_views(solution.views, BODY, PRIOR, FPS, TrajectoryOptions())
    found = [*lens_findings(baseline_of(setting, 0, solution.states, solution.size), solution.noise_px[0])]
    assert [one.numbers["way"] for one in found] == ways
    assert all(0.0 < one.numbers["pose_effect_m"] < one.numbers["position_effect_m"] for one in found)
    assert all(one.numbers["zoom"] * np.log(times) > 0.1 for one in found)


def test_the_effect_of_a_zoom_includes_a_calibration_at_either_end():
    """The effect of a zoom includes the effect of a calibration at the start or the end of the clip.

    If the picture becomes a quarter larger, distances are wrong by an eighth.
    """
    numbers = {"zoom": -float(np.log(1.25)), "distance_m": 8.0, "pose_effect_m": 0.1, "position_effect_m": 0.2}
    item = finding("picture_zooms", way="out", **numbers)
    assert with_calibration_at_either_end(item).numbers == item.numbers | {"position_effect_m": pytest.approx(1.0)}
    larger = replace(item, numbers=item.numbers | {"position_effect_m": 3.0})
    assert with_calibration_at_either_end(larger).numbers["position_effect_m"] == 3.0
    other = finding("keypoints_undistorted", log_likelihood_ratio=40.0)
    assert with_calibration_at_either_end(other) == other


@pytest.mark.parametrize(("kept", "codes"), [(False, ["keypoints_undistorted"]), (True, [])])
def test_undistorted_keypoints_are_reported(kept, codes):
    bent = replace(CAMERA, model="radtan", distortion=np.array([-0.6, 0.3, 0.0, 0.0]))
    xy_px = bent.project(run())[0] if kept else seen(run(), 0.0)
    solution = solve(xy_px + np.random.default_rng(0).normal(0, 2, xy_px.shape), camera=bent)
    setting = ClipProblem.from_views(solution.views, BODY, PRIOR, FPS, TrajectoryOptions())
    found = lens_findings(baseline_of(setting, 0, solution.states, solution.size), solution.noise_px[0])
    assert [one.code for one in found] == codes


def test_an_implausible_path_is_reported():
    motion = moved(plain().states)
    costs = {**plain().cost_by_term, "heading": 2.0 * 90 * len(motion.frames) / FPS}
    (found,) = movement(replace(motion, solution=replace(motion.solution, cost_by_term=costs)))
    assert (found.code, found.numbers["of"], found.numbers["cost"]) == ("path_jolts", "heading", pytest.approx(2.0))


@pytest.mark.parametrize(("name", "other"), [("cam3", "cam1"), ("cam1", None), ("left", None), ("GoPro_2", None)])
def test_a_number_in_a_file_name_names_another_camera(name, other):
    assert other_camera_in("run2_cam1DLC_resnet50", name) == other


def ground(near_zero: bool | None, height_m: float, camera_m: tuple[float, float, float]) -> Motion:
    """Return a motion with its ground at a height, m, filmed by a camera at a position, m."""
    solution = plain()
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), (0, 0, 0)
    pose[:3, 3] = -pose[:3, :3] @ camera_m
    views = (replace(solution.views[0], T_camera_world=pose),)
    segment = replace(solution.segments[0], ground=Ground(height_m, np.zeros(2), 0.04, near_zero))
    return replace(moved(solution.states), solution=replace(solution, views=views, segments=(segment,)))


@pytest.mark.parametrize(
    ("near_zero", "height_m", "camera_m", "code"),
    [
        (True, 0.1, (0, -8, 0.6), None),
        (None, -0.6, (0, 0, 0), None),
        (False, 0.5, (0, -8, 1.1), "ground_elsewhere"),
        (False, 100.0, (0, -8, 100.5), "ground_elsewhere"),
        (False, 49.5, (0, -800, 50.0), "camera_unit"),
        (False, 49.5, (0, 0, 50.0), "camera_unit"),
        (False, 100.0, (0, -8, 101.0), "ground_elsewhere"),
        (False, 1.14, (0, -26, 1.64), "ground_elsewhere"),
    ],
)
def test_a_ground_that_is_not_at_zero_is_reported(near_zero, height_m, camera_m, code):
    found = [*ground_elsewhere(ground(near_zero, height_m, camera_m))]
    assert [one.code for one in found] == ([] if code is None else [code])


@pytest.mark.parametrize(
    ("unit", "camera_m", "code"),
    [("mm", 0.0015, "camera_unit"), ("cm", 0.015, "camera_unit"), ("mm", 0.0, "ground_elsewhere")],
)
def test_a_wrong_camera_unit_is_reported(unit, camera_m, code):
    """A camera file in metres with another stated unit is reported, except for a camera at the world's origin."""
    motion = ground(False, camera_m - 1.5, (0.0, 0.0, camera_m))
    (found,) = ground_elsewhere(replace(motion, settings={**motion.settings, "camera_unit": unit}))
    assert found.code == code
    assert code == "ground_elsewhere" or found.numbers["unit"] == "metres"


def test_lengths_that_differ_from_the_species_are_reported():
    motion = moved(plain().states)
    assert not [*subject_unlike_species(motion)]
    tree = BODY.tree
    segments = tuple(replace(one, offset_m=tuple(1.5 * x for x in one.offset_m)) for one in tree.segments)
    markers = tuple(replace(one, offset_m=tuple(1.5 * x for x in one.offset_m)) for one in tree.markers)
    body = replace(BODY, tree=replace(tree, segments=segments, markers=markers))
    (found,) = subject_unlike_species(replace(motion, solution=replace(motion.solution, body=body)))
    assert found.numbers["times"] == pytest.approx(1.5, abs=0.1)


@pytest.mark.parametrize("height_m", [0.0, pytest.param(0.6, marks=pytest.mark.slow), 100.0])
def test_a_fit_does_not_depend_on_the_height_of_the_ground(height_m):
    """A fit does not depend on the height of the ground, which is found 0.85 m below the camera."""
    camera = replace(CAMERA, rotation=CAMERA_FROM_LEVEL, translation_m=-CAMERA_FROM_LEVEL @ [0.0, 0.0, height_m + 0.85])
    solution = solve(seen(run()), camera=camera)
    assert errors_m(solution, run()).mean() < 0.03
    (segment,) = solution.segments
    assert segment.ground is not None
    assert segment.ground.near_zero is (height_m == 0)
    assert segment.ground.height_m == pytest.approx(height_m, abs=0.2)


@pytest.mark.parametrize(
    ("turn_deg", "shift_m", "late"),
    [
        (6.0, 0.0, 0),
        (0.0, 0.5, 0),
        (0.0, 0.0, 3),
        *(pytest.param(*case, marks=pytest.mark.slow) for case in ((-6.0, 0.0, 0), (0.0, -1.0, 0))),
    ],
)
def test_two_cameras_are_named_if_one_is_turned_moved_or_late(turn_deg, shift_m, late):
    """A finding names two cameras if one of them was turned, moved or late.

    The camera is turned or moved in the plane of both cameras and the animal, in which rays still meet.
    """
    turn = Rotation.from_euler("y", turn_deg, degrees=True).as_matrix()
    views = [view_of(truth_m(), AHEAD), view_of(truth_m(), ASIDE, seed=1)]
    views[1] = replace(views[1], T_camera_world=rigid(turn, np.array([shift_m, 0.0, 0.0])) @ ASIDE)
    views = [view.part(slice(late * i, len(view.xy_px) + late * (i - 1))) for i, view in enumerate(views)]
    right, wrong = two(), solve_trajectory(views, BODY, PRIOR, FPS, TrajectoryOptions(fast=True))
    one = moved(plain().states)
    for solution, said in ((one.solution, False), (right, False), (wrong, True)):
        motion = replace(one, solution=replace(one.solution, segments=solution.segments))
        assert [finding.code for finding in pair_disagrees(motion)] == ["pair_disagrees"] * (said and not late)
    second = wrong.segments[0].second_camera
    assert second is not None
    assert (second.late > max(second.misplaced, 0.0)) == bool(late)
    assert not late or second.late_frames == pytest.approx(late, abs=1.0)


@pytest.mark.parametrize("slower", [1, 4, 10])
def test_a_treadmill_is_reported_at_any_speed(slower):
    """A treadmill is reported at any speed, even in slow motion, because the body stays while the feet slide."""
    states = plain().states.copy()
    states[:, :2] -= np.linspace(0, 1, len(states))[:, None] * (states[-1, :2] - states[0, :2])
    motion = moved(states)
    (one,) = motion.sources
    slow = replace(one, keypoints=replace(one.keypoints, fps=FPS / slower))
    (found,) = movement(replace(motion, sources=(slow,)))
    assert found.code == "treadmill"
    run_m_s = np.linalg.norm(plain().states[-1, :2] - plain().states[0, :2]) / (len(states) - 1) * FPS / slower
    assert 0.5 * run_m_s < found.numbers["slide_m_s"] < run_m_s  # the simulated feet have hardly any stance


@pytest.mark.parametrize("slower", [1, 10])
def test_feet_stand_still_relative_to_the_belt(slower):
    states = plain().states.copy()
    states[:, :2] -= np.linspace(0, 1, len(states))[:, None] * (states[-1, :2] - states[0, :2])
    (one,) = moved(states).sources
    slow = replace(one, keypoints=replace(one.keypoints, fps=FPS / slower))
    motion = replace(moved(states), sources=(slow,))
    time_s = motion.time_s
    run_m_s = float(np.linalg.norm(plain().states[-1, :2] - plain().states[0, :2])) / (time_s[-1] - time_s[0])
    on_belt = over_belt(motion, run_m_s)
    assert not [*movement(on_belt)]
    assert on_belt.solution.joints_m == pytest.approx(plain().joints_m, abs=0.2)
    assert on_belt.pictures[0].reprojected_px == pytest.approx(motion.pictures[0].reprojected_px, abs=1e-6)
    with pytest.raises(InputError, match="the fit already used 2 m/s"):
        over_belt(replace(motion, settings={"belt_speed_m_s": 2.0}), 3.0)
