"""Test bodies of other animals, such as a walking person and a mouse seen from above, with simulated cameras.

The tests include the keypoint names of their detectors, and the commands that use a fit.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import refusal, refused, run, says
from scipy.spatial.transform import Rotation

from recon import (
    Body,
    Camera,
    FitSettings,
    Keypoints,
    Motion,
    analyse,
    evaluate_files,
    load_skeleton,
    read_keypoints,
    write_cameras,
)
from recon.animal.naming import fitting_maps, load_names, new_names
from recon.animal.prior import prior_from_body
from recon.api.clip_inputs import prepare
from recon.api.clip_results import run_clip
from recon.api.model_settings import SkeletonDraftSettings
from recon.api.skeleton_check import check_skeleton
from recon.api.skeleton_draft import draft_from_points, draft_skeleton
from recon.cli.models import skeleton_from_keypoints
from recon.clip import View, camera_poses, still_view
from recon.fit import posterior, starts
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.posterior import with_reestimated_noise
from recon.fit.result import TrajectorySolution
from recon.fit.trajectory import solve_segments, solve_trajectory
from recon.gait.evaluation import LEVELS, aligned
from recon.geometry.frames import rigid
from recon.io.deeplabcut import write_csv
from recon.io.json_poses import LISTS
from recon.io.markers import write_trc
from recon.testing import rigs
from recon.testing.cameras import aim_camera, camera_ring
from recon.testing.coverage import coordinate_coverage
from recon.testing.detectors import HORSE_10, split_names
from recon.testing.rigs import write_rig_clip
from recon.testing.walkers import running_mouse, walking_person

pytestmark = pytest.mark.usefixtures("no_playback")
OBLIQUE_M = [[1.0, -5.5, 1.5], [4.5, -4.0, 1.7], [-4.5, 4.0, 1.8], [5.0, 4.0, 2.0]]
ABOVE_M = [[0.35, 0.1, 0.45], [-0.1, 0.4, 0.45], [-0.35, -0.1, 0.5], [0.1, -0.4, 0.4]]
COCO_17 = split_names(
    "nose,left_eye,right_eye,left_ear,right_ear,left_shoulder,right_shoulder,left_elbow,right_elbow,left_wrist",
    "right_wrist,left_hip,right_hip,left_knee,right_knee,left_ankle,right_ankle",
)
MOUSE_15 = split_names(
    "Nose,Ear_R,Ear_L,TTI,TailTip,Head,Trunk,Tail_0,Tail_1,Tail_2,Shoulder_left,Shoulder_right,Haunch_left",
    "Haunch_right,Neck",
)


def settings_of(files: dict[str, Path], skeleton: str, fps: float) -> FitSettings:
    keypoints = tuple(path for name, path in files.items() if name != "rig")
    return FitSettings(keypoints=keypoints, camera=(files["rig"],), skeleton=skeleton, fps=fps)


def fitted(folder: Path, settings: FitSettings, truth) -> tuple[Motion, dict[str, float]]:
    """Return the motion of a fit, its errors, mm, and the fractions of coordinates within the 90 % intervals."""
    run_clip(settings, folder / "out")
    write_trc(truth, folder / "truth.trc")
    found = evaluate_files(folder / "out", folder / "truth.trc")
    at = LEVELS.index(0.9)
    shares = {what: found.inside[what][at] for what in ("place", "pose")}
    return Motion.load(folder / "out"), {
        "pose_mm": 1e3 * found.mpjpe_m.mean,
        "place_mm": 1e3 * found.mpe_m.mean,
    } | shares


@pytest.mark.slow
@pytest.mark.parametrize("cameras", [2, 4])
def test_fits_a_walking_person(cameras, tmp_path):
    """The person is 1.79 m tall, and keypoints have a constant offset of 26 mm from the markers."""
    centres_m = np.array(OBLIQUE_M[:cameras])
    files, truth = write_rig_clip(tmp_path, "human-25", walking_person(90, 30.0), 30.0, centres_m, 1.05, 0.9, 2.0)
    settings = settings_of(files, "human-25", 30.0)
    motion, found = fitted(tmp_path, replace(settings, fast=cameras == 4), truth)
    assert max(found["pose_mm"], found["place_mm"]) < 22
    assert min(found["place"], found["pose"]) > 0.85
    assert motion.verdict.level != "do not use"
    assert motion.solution.size == pytest.approx(1.05, abs=0.015)
    gait = analyse(motion).gait
    assert gait is not None
    assert gait.name.name == "unknown"
    assert says(gait.name.criterion, "four feet", "LH, RH")
    assert len(gait.strides) >= 3
    for stride in gait.strides:
        assert stride.frequency_hz == pytest.approx(0.9, rel=0.05)
        assert stride.duty_factor == pytest.approx(0.62, abs=0.07)
    assert gait.speed_m_s == pytest.approx(1.0, abs=0.05)


@pytest.mark.slow
def test_fits_a_mouse_of_100_mm(tmp_path, undrawn):
    """The mouse is 100 mm long from nose to tail base, and keypoints have a constant offset of 3.5 mm."""
    states = running_mouse(60, 60.0)
    files, truth = write_rig_clip(tmp_path, "mouse-top", states, 60.0, np.array(ABOVE_M), 1.14, 0.02, 0.7)
    settings = settings_of(files, "mouse-top", 60.0)
    motion, found = fitted(tmp_path, settings, truth)
    assert max(found["pose_mm"], found["place_mm"]) < 2
    assert min(found["place"], found["pose"]) > 0.85
    assert motion.verdict.level == "use"
    assert motion.solution.size == pytest.approx(1.14, abs=1.65 * motion.solution.size_sigma)
    ended = run("analyse", tmp_path / "out", "--out", tmp_path / "analysed")
    assert (ended.code, ended.err) == (0, "")
    assert "no feet" in ended.out
    assert not json.loads((tmp_path / "analysed" / "analysis.json").read_text())["gait"]


@pytest.mark.slow
def test_intervals_widen_if_lengths_differ_from_the_skeleton():
    """Lengths differ by a fifth from the skeleton's, so keypoints are further from the markers than expected.

    One clip has a single draw of lengths and offsets, so correct intervals contain more of one clip and less of
    another.
    """
    shares = []
    for skeleton in ("mouse-top", "dog-27", "human-25"):
        body = load_skeleton(skeleton)
        views, true_m = rigs.random_clip(body, 0.2, 4, 0)
        solution = solve_trajectory(views, body, prior_from_body(body), rigs.FPS, TrajectoryOptions(fast=True))
        centred_m = aligned(solution.joints_m, true_m) - true_m
        position = coordinate_coverage(solution.joints_m - true_m, solution.covariance_m2, 0.9)
        shares.append([position, coordinate_coverage(centred_m, solution.relative_covariance_m2, 0.9)])
    assert np.min(shares) > 0.83  # 0.65 to 0.82 if the keypoint bias is ignored
    assert np.all(np.mean(shares, axis=0) < 0.97)  # 0.98 if an estimated bias counts twice


def seen_by_two(body: Body, true_m: np.ndarray, random: np.random.Generator) -> TrajectorySolution:
    views = []
    for camera in camera_ring(2, rigs.body_length_m(body), random):
        xy_px, valid = camera.project(camera.world_to_camera(true_m))
        views.append(still_view(camera, xy_px + random.normal(0, rigs.SIGMA_PX, xy_px.shape), valid.astype(float)))
    return solve_trajectory(views, body, prior_from_body(body), rigs.FPS, TrajectoryOptions(fast=True))


@pytest.mark.slow
@pytest.mark.parametrize(("skeleton", "frames", "size"), [("dog-27", 150, 1.1), ("mouse-top", 72, 1.2)])
def test_two_cameras_with_correct_poses_get_no_finding(skeleton, frames, size, monkeypatch):
    """Neither an animal that walks in a circle nor a small animal makes the second camera look misplaced or late."""
    monkeypatch.setattr("recon.fit.solution.TESTED_S", 2.0)
    body, random = load_skeleton(skeleton), np.random.default_rng(0)
    states, ahead = rigs.random_motion(body, random, frames), 2 * np.pi * np.arange(frames) / 360
    states[:, 3] = ahead + np.pi / 2
    states[:, :2] = 0.6 * rigs.body_length_m(body) * np.stack([np.cos(ahead), np.sin(ahead)], axis=1)
    found = seen_by_two(body, size * body.tree.pose(states).points_m, random)
    assert found.size == pytest.approx(size, abs=0.03)
    second = found.segments[0].second_camera
    assert second is not None
    assert max(second.misplaced, second.late) < 0


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.8, 1.1])
def test_ground_does_not_change_the_size_from_two_cameras(size):
    """The root is as high as in a dog of mean size, so the feet of a smaller or larger dog are not at z = 0."""
    body, random = load_skeleton("dog-27"), np.random.default_rng(1)
    found = seen_by_two(body, body.tree.pose(rigs.random_motion(body, random), size).points_m, random)
    assert found.size == pytest.approx(size, abs=0.02)
    second = found.segments[0].second_camera
    assert second is not None
    assert max(second.misplaced, second.late) < 0


@pytest.mark.parametrize("cameras", [2, 1])
def test_keypoint_bias_does_not_count_as_noise(cameras):
    """Detections have 2 px of noise and a constant offset of 15 mm, which is 4 px.

    The noise from two cameras is hardly larger than 2 px. The noise from one camera includes the offset, because one
    camera shows no common bias.
    """
    body = load_skeleton("human-25")
    views, _ = rigs.random_clip(body, 0.0, cameras, 0)
    setting = ClipProblem.from_views(views, body, prior_from_body(body), rigs.FPS, TrajectoryOptions(fast=True))
    (one,) = solve_segments(setting)
    counted = with_reestimated_noise(one.problem, one.estimate, setting.correlation_frames)
    seen, noise_px = views[0].present, float(np.median(one.noise_px[0]))
    given, now = (problem.terms[0].view.confidence[seen].mean() for problem in (one.problem, counted))
    assert noise_px > 1.8 * rigs.SIGMA_PX
    if cameras == 1:
        assert now == given
    else:
        assert 0.8 * rigs.SIGMA_PX < noise_px * np.sqrt(given / now) < 1.3 * rigs.SIGMA_PX


@pytest.mark.parametrize(("explained", "rounds"), [(0.0, 2), (1.0, 1)])
def test_the_noise_is_estimated_twice_only_if_the_bias_explains_much(explained, rounds, monkeypatch):
    """In this short clip the bias explains a quarter of the detections, and the first round is right within a tenth."""
    body = load_skeleton("human-25")
    views, _ = rigs.random_clip(body, 0.0, 2, 0)
    setting = ClipProblem.from_views(views, body, prior_from_body(body), rigs.FPS, TrajectoryOptions(fast=True))
    (one,) = solve_segments(setting)
    usual = with_reestimated_noise(one.problem, one.estimate, setting.correlation_frames).terms[0].view.confidence
    made, of_problem = [], posterior._shared_curvature
    monkeypatch.setattr(posterior, "_MAX_EXPLAINED", explained)
    monkeypatch.setattr(posterior, "_shared_curvature", lambda *at, **how: made.append(at) or of_problem(*at, **how))
    counted = with_reestimated_noise(one.problem, one.estimate, setting.correlation_frames)
    assert len(made) == rounds
    np.testing.assert_allclose(counted.terms[0].view.confidence, usual, rtol=0.1)


def test_several_cameras_skip_unlikely_headings(monkeypatch):
    """Headings that several cameras skip would lead to the same minimum, or to minima of higher cost."""
    body = load_skeleton("human-25")
    views, _ = rigs.random_clip(body, 0.0, 3, 0)
    setting = ClipProblem.from_views(views, body, prior_from_body(body), rigs.FPS, TrajectoryOptions())
    few = starts.approach(setting)
    monkeypatch.setattr(starts, "_MAX_EXTRA_MISFIT", np.inf)
    every = starts.approach(setting)
    assert len(few) < len(every)
    assert few[0].cost == pytest.approx(every[0].cost, rel=1e-2)


def test_hovering_drone_does_not_determine_the_size():
    """A drone that drifts by 0.5 m, 8 m above a person, does not determine the person's size."""
    body, random = load_skeleton("human-25"), np.random.default_rng(0)
    states, poses = walking_person(60, 30.0), np.tile(np.diag([1.0, -1.0, -1.0, 1.0]), (60, 1, 1))
    centres_m = np.array([0.3, 0.2, 8.0]) + 0.3 * np.arange(-30, 30)[:, None] / 30 * [1.0, 0.0, 0.0]
    poses[:, :3, 3] = -centres_m * [1.0, -1.0, -1.0]
    lens, markers_m = Camera.from_hfov(40.0, (1920, 1080)), body.tree.pose(states).points_m
    seen = View(lens, poses, np.zeros((60, len(body.markers), 2)), np.ones((60, len(body.markers))))
    xy_px, _ = seen.project(markers_m)
    seen = replace(seen, xy_px=xy_px + random.normal(size=xy_px.shape))
    found = solve_trajectory([seen], body, prior_from_body(body), 30.0, TrajectoryOptions(fast=True))
    assert abs(found.size - 1) < 0.5 * found.size_sigma < 0.05
    assert np.linalg.norm(found.joints_m - markers_m, axis=2).mean() < 0.5


@pytest.mark.parametrize(
    ("skeleton", "bundled", "names", "known"),
    [
        ("human-25", "coco-17", COCO_17, 17),
        ("human-25", "coco-17", LISTS[26], 25),
        ("mouse-top", "mouse-15", MOUSE_15, 13),
    ],
)
def test_maps_of_names_keep_the_sides(skeleton, bundled, names, known):
    """The map of names keeps left and right, and a fit finds the map of its keypoint file."""
    by, body = load_names(bundled), load_skeleton(skeleton)
    _, new, _ = new_names(names, by, "clip.csv")
    assert len({*new} & {*body.markers}) == known
    assert all(body.side_of(old) == body.side_of(its) for old, its in by.names.items() if its)
    assert fitting_maps(names, body.markers)[0] == bundled


@pytest.mark.parametrize("points", [17, 18, 25])
def test_lists_of_names_that_need_no_map(points):
    assert {*LISTS[points]} <= {*load_skeleton("human-25").markers}


def test_person_with_coco_names_is_recognised(tmp_path):
    """The skeleton is suggested for a person with COCO's names, and fitted although COCO has no toes."""
    states = walking_person(30, 30.0)
    files, _ = write_rig_clip(tmp_path, "human-25", states, 30.0, np.array(OBLIQUE_M[:2]), 1.0, 0.9, 2.0)
    settings = settings_of(files, "human-25", 30.0)
    of = {new: old for old, new in load_names("coco-17").names.items()}
    for path in settings.keypoints:
        file = read_keypoints(path)
        kept = [k for k, name in enumerate(file.names) if of.get(name) in COCO_17]
        names = tuple(of[file.names[k]] for k in kept)
        write_csv(replace(file, names=names, xy_px=file.xy_px[:, kept], confidence=file.confidence[:, kept]), path)
    other = ("bodyparts", "left_hip, right_hip", ["cheetah-24", "--skeleton human-25 --rename coco-17"])
    with refusal(*((path, *other) for path in settings.keypoints)):
        prepare(replace(settings, skeleton="cheetah-24"))
    run_clip(replace(settings, rename="coco-17", fast=True), tmp_path / "out")
    assert analyse(Motion.load(tmp_path / "out")).gait is not None


@pytest.mark.parametrize(
    ("names", "options"),
    [
        (LISTS[17], "--skeleton human-25, which has 17 of these 17"),
        (LISTS[25], "--skeleton human-25, which has 25 of these 25"),
        (LISTS[26], "--skeleton human-25 --rename coco-17, which has 25 of these 26"),
        (COCO_17, "--skeleton human-25 --rename coco-17, which has 17 of these 17"),
        (MOUSE_15, "--skeleton mouse-top --rename mouse-15, which has 13 of these 15"),
        (load_skeleton("mouse-top").markers, "--skeleton mouse-top, which has 27 of these 27"),
        (HORSE_10, "--skeleton horse-22, which has 22 of these 22"),
    ],
)
def test_points_of_another_skeleton_give_no_quadruped(names: Iterable[str], options):
    with refusal(("clip.csv", "bodyparts", f"names of another animal's skeleton: {next(iter(names))}", options)):
        draft_skeleton([*names], "mine", Path("clip.csv"))


@pytest.mark.parametrize(("skeleton", "alone"), [("mouse-top", 0), pytest.param("human-25", 2, marks=pytest.mark.slow)])
def test_draft_from_geometry_fits_the_clip(skeleton, alone, tmp_path):
    """No segment of a draft from geometry has points of two true segments."""
    true = load_skeleton(skeleton)
    views, true_m = rigs.random_clip(true, 0.0, 4, 0)
    names, files = tuple(f"point {j}" for j in range(len(true.markers))), []
    for view in views:
        files.append(tmp_path / f"{view.camera.name}.csv")
        write_csv(Keypoints(names, view.xy_px, view.confidence, np.arange(len(true_m)), fps=rigs.FPS), files[-1])
    out, rig = tmp_path / "mine.toml", tmp_path / "rig.toml"
    write_cameras([view.camera for view in views], rig)
    ended = run("skeleton", "from-keypoints", *files, "--camera", rig, "--fps", str(rigs.FPS), "--out", out)
    assert (ended.code, ended.err) == (0, "")
    assert says(ended.out, f"{len(names)} of {len(names)} keypoints")
    body = load_skeleton(out)
    of = {int(marker.name.split()[1]): marker.segment for marker in body.tree.markers}
    groups = [[j for j, m in enumerate(true.tree.markers) if m.segment == s.name] for s in true.tree.segments]
    apart = [len({of[j] for j in group}) - 1 for group in groups if len(group) > 3]
    assert len(apart) > 1
    assert sum(apart) <= alone
    order = [names.index(marker) for marker in body.markers]
    seen = [replace(v, xy_px=v.xy_px[:, order], confidence=v.confidence[:, order]) for v in views]
    found = solve_trajectory(seen, body, prior_from_body(body), rigs.FPS, TrajectoryOptions(fast=True))
    off_m = np.linalg.norm(found.joints_m - true_m[:, order], axis=2)  # includes the keypoint bias
    assert np.median(off_m) < 1.5 * true.keypoint_sigma_m
    with refusal(("KEYPOINTS", "files", "2 files without --camera", "--camera")):
        skeleton_from_keypoints(SkeletonDraftSettings(keypoints=tuple(files[:2]), out=tmp_path / "a.toml"))
    with refusal(("--camera", "poses", "cam1 with a pose", "two or more")):
        skeleton_from_keypoints(
            SkeletonDraftSettings(keypoints=(files[0],), camera=(rig,), fps=rigs.FPS, out=tmp_path / "a.toml")
        )
    given = ("--camera", rig, "--fps", str(rigs.FPS), "--out", tmp_path / "a.toml")
    stated = ("--up", "up", ["z", "states z up"], "no --up, or a file without")
    refused(["skeleton", "from-keypoints", *files, *given, "--up", "z"], stated)
    unknown = ("--up", "direction", "'w'", ["x, y or z", "first-camera"])
    refused(["skeleton", "from-keypoints", *files, *given, "--up", "w"], unknown)


@pytest.mark.slow
def test_draft_from_a_calibration_in_millimetres(tmp_path):
    """A draft from such cameras asks for the unit, and for the upward direction or a level first camera."""
    true = load_skeleton("mouse-top")
    views, true_m = rigs.random_clip(true, 0.0, 4, 0)
    names, files = tuple(f"point {j}" for j in range(len(true.markers))), []
    for view in views:
        files.append(tmp_path / f"{view.camera.name}.csv")
        write_csv(Keypoints(names, view.xy_px, view.confidence, np.arange(len(true_m)), fps=rigs.FPS), files[-1])
    cameras = [
        replace(v.camera, translation_m=1000 * np.asarray(v.camera.translation_m), world_z_up=False) for v in views
    ]
    rig = tmp_path / "rig.toml"
    write_cameras(cameras, rig)

    def drafted_with(**options) -> str:
        out = tmp_path / "mine.toml"
        given = {"keypoints": tuple(files), "camera": (rig,), "fps": rigs.FPS, "out": out, "overwrite": True}
        skeleton_from_keypoints(SkeletonDraftSettings(**given, **options))
        return out.read_text()

    with refusal(("--up", "up", "do not say which way is up", ["-y", "first-camera"])):
        drafted_with(camera_unit="mm")
    with refusal(("--camera-unit", "camera_unit", ["the animal is", "m long"], ["cm (", "mm ("])):
        drafted_with(up="z")
    text = drafted_with(up="z", camera_unit="mm")
    assert drafted_with(up="z", camera_unit="mm", camera_name=tuple(v.camera.name for v in views)) == text
    assert 0.03 < check_skeleton(tmp_path / "mine.toml")["length_m"] < 0.3
    drafted_with(up="first-camera", camera_unit="mm")
    large = re.sub(r"at_m = \[(.*?)\]", lambda m: f"at_m = {[1e3 * float(x) for x in m[1].split(',')]}", text)
    (tmp_path / "large.toml").write_text(large)
    assert "Lengths are metres" in " ".join(check_skeleton(tmp_path / "large.toml")["remarks"])


@pytest.mark.parametrize(
    ("path_m", "bends", "noise_m", "expected"),
    [
        (0.0, True, 0.0, ("motion", ["1.5 m", "0 mm", "2 rigid bodies"], ["half its length", "two rigid bodies"])),
        (2.0, False, 0.0, ("motion", ["1.5 m", "2.0 m", "1 rigid body"], ["half its length", "two rigid bodies"])),
        (2.0, True, 0.03, ("keypoints", ["32.6 mm", "1.5 m"], "1 % of its length or less")),
    ],
)
def test_motion_that_does_not_show_joints_gives_no_draft(path_m, bends, noise_m, expected):
    time = np.linspace(0, 1, 60)
    still = np.array([[0.2 * k, 0.01 * k**2, 0.5] for k in range(8)])
    points = still + np.stack([path_m * time, 0 * time, 0 * time], axis=1)[:, None]
    points[:, 5:, 2] += 0.3 * bends * np.sin(20 * time)[:, None]
    points += np.random.default_rng(0).normal(0, noise_m, points.shape)
    with refusal(("clip.csv", *expected)):
        draft_from_points([*"abcdefgh"], points, 60.0, "mine", Path("clip.csv"))


def test_outliers_of_nose_and_tail_do_not_make_a_draft_larger():
    time = np.linspace(0, 1, 60)
    still = np.array([[0.2 * k, 0.01 * k**2, 0.5] for k in range(8)])
    points = still + np.stack([2.0 * time, 0 * time, 0 * time], axis=1)[:, None]
    points[:, 5:, 2] += 0.3 * np.sin(20 * time)[:, None]
    wrong = points.copy()
    wrong[[10, 40], 0, 0] -= 3.0
    wrong[[20, 50], 7, 0] += 3.0
    drafts = [draft_from_points([*"abcdefgh"], found, 60.0, "mine", Path("clip.csv"))[1] for found in (points, wrong)]
    true, drafted = (tomllib.loads(text) for text in drafts)
    for name in ("keypoint_sigma_m", "marker_sigma_m"):
        assert drafted[name] == pytest.approx(true[name], rel=0.02)


@pytest.mark.parametrize("names", ["nose b c d e f g tail", "Ear_L b c d e f g h", "a b c d e f g rump"])
def test_draft_of_a_standing_animal_finds_its_front(names):
    """The front, here at negative x, follows from the names of head and tail."""
    time = np.linspace(0, 1, 60)
    still = np.array([[0.2 * k, 0.01 * k**2, 0.5] for k in range(8)])
    points = np.tile(still, (60, 1, 1))
    points[:, 5:, 2] += 0.3 * np.sin(20 * time)[:, None]
    labels, text = draft_from_points(names.split(), points, 60.0, "mine", Path("clip.csv"))
    rear, front = tomllib.loads(text)["forward"]
    assert labels == names.split()
    assert still[labels.index(front), 0] < still[labels.index(rear), 0]


@pytest.mark.slow
def test_refined_cameras_of_a_small_rig_stay_near_their_poses():
    """The skeleton's lengths are wrong for the mouse, and the cameras are turned by a degree about each axis."""
    body, rng = load_skeleton("mouse-top"), np.random.default_rng(0)
    states = running_mouse(60, 60.0)
    stretched = [
        replace(m, offset_m=(1.3 * m.offset_m[0], 1.5 * m.offset_m[1], m.offset_m[2])) for m in body.tree.markers
    ]
    true_m = replace(body.tree, markers=tuple(stretched)).pose(states).points_m
    views, true_poses = [], []
    for number, centre_m in enumerate(np.array(ABOVE_M), start=1):
        camera = aim_camera(
            Camera.from_hfov(60.0, (1280, 1024), name=f"cam{number}"), centre_m, np.array([0.0, 0.0, 0.02])
        )
        xy_px, _ = camera.project(camera.world_to_camera(true_m))
        (T,) = camera_poses([camera])
        true_poses.append(T)
        if number > 1:
            T = rigid(Rotation.from_rotvec(np.radians(rng.normal(size=3))).as_matrix(), np.zeros(3)) @ T
        views.append(View(camera, T, xy_px + rng.normal(0, 0.7, xy_px.shape), np.full(xy_px.shape[:2], 0.9)))
    options, prior = TrajectoryOptions(fast=True), prior_from_body(body)

    def off(refine: bool) -> tuple[float, float]:
        """Return the largest rotation error of a camera, degrees, and the error of the markers, m."""
        found = solve_trajectory(views, body, prior, 60.0, replace(options, refine_cameras=refine))
        turns = [
            Rotation.from_matrix(view.T_camera_world[:3, :3] @ T[:3, :3].T).magnitude()
            for view, T in zip(found.views, true_poses, strict=True)
        ]
        return float(np.degrees(max(turns))), float(np.linalg.norm(found.markers_m - true_m, axis=2).mean())

    held, refined = off(False), off(True)
    assert refined[0] < 3  # 4.3 to 5.0 degrees if the camera positions' prior is 5 cm
    assert refined[1] < min(0.007, 1.1 * held[1])
