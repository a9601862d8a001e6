"""Test the retargeting of a reconstruction to a robot, from footholds to the written tables."""

import csv
import json
import os
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from command_line import refused, run, says
from rerun.chunk import RrdReader
from robot_urdf import a1_urdf

from recon import InputError
from recon.animal.skeleton_file import load_skeleton
from recon.base.outputs import RECORD
from recon.fit.motion import Motion
from recon.robotics.playback import write_robot
from recon.robotics.quadruped import LEGS, feet_in_world, load_robot
from recon.robotics.retarget import (
    closed_stride,
    on_robot,
    place,
    planted,
    posed,
    reference_of,
    retarget,
    stances,
    stride_window,
    within_reach,
)
from recon.robotics.retarget_clip import companion, repeated, report_of, run_retarget
from recon.robotics.settings import RetargetSettings
from recon.show.view.scene import LEFT, MIDDLE, RIGHT


def hops(n=400):
    """Return a foot's path that hops forwards in half sines, and slides while the foot should stand."""
    t = np.linspace(0, 2, n)
    path = np.column_stack([t + 0.1 * np.sin(np.pi * t), 0.1 * np.cos(t), 0.1 * np.sin(np.pi * t) - 0.01])
    return t, path, (np.abs(np.sin(np.pi * t)) < 0.2)


def test_feet_stand_still_and_leave_the_ground_smoothly():
    t, path, standing = hops(4000)
    foot = planted(t, path, standing)
    assert len(stances(standing)) == 3
    for first, last in stances(standing):
        np.testing.assert_allclose(foot[first : last + 1], np.tile(foot[first], (last - first + 1, 1)), atol=1e-15)
        assert foot[first, :2] == pytest.approx(path[first : last + 1, :2].mean(axis=0))
        assert foot[first, 2] == 0
    assert (foot[:, 2] >= 0).all()
    # The acceleration is continuous at the end of a stance, so its largest change shrinks with the time step.
    change = [np.abs(np.diff(planted(*hops(n))[:, :2], 3, axis=0)).max() * n**2 for n in (1000, 2000, 4000)]
    assert change[2] < 0.6 * change[1] < 0.4 * change[0]


def test_a_foot_without_stance_stays_above_the_ground():
    t, path, _ = hops()
    foot = planted(t, path, np.zeros(len(t), bool))
    np.testing.assert_array_equal(foot[:, :2], path[:, :2])
    assert (foot[:, 2] > 0).all()
    np.testing.assert_allclose(foot[:, 2], np.maximum(path[:, 2], 0), atol=0.0101)  # a tenth of its height


def test_a_stance_continues_over_the_seam_of_a_stride():
    t = np.linspace(0, 1, 201)
    path = np.column_stack([t - 0.1 * np.sin(2 * np.pi * t), 0 * t, 0.05 - 0.05 * np.cos(2 * np.pi * t)])
    standing = (t < 0.2) | (t > 0.9)
    foot = planted(t, path, standing, np.array([1.0, 0.0]))
    np.testing.assert_allclose(foot[-1], foot[0] + [1, 0, 0], atol=1e-15)
    # The stance before the seam continues after it, with the foot a stride further on.
    np.testing.assert_allclose(foot[standing & (t > 0.5)] - [1, 0, 0], np.tile(foot[0], (20, 1)), atol=1e-12)


@pytest.fixture(scope="module")
def whole(whole_results):
    return reference_of(Motion.load(whole_results))


def test_a_given_stride_is_used(whole_results):
    animal = reference_of(Motion.load(whole_results), (0.31, 0.62))
    window, time = stride_window(animal), animal.reference.time_s
    assert window.source == "given"
    start_s = 19 / 60  # the nearest frame
    ends = pytest.approx(start_s, abs=2e-3), pytest.approx(start_s + 0.31, abs=2e-3)
    assert (time[window.first], time[window.last]) == ends


def test_reference_of_a_whole_animal(whole):
    # The reference of a whole animal has trunk and feet of pose3d.csv, turned to the direction of travel.
    reference, results = whole.reference, whole.analysis.motion
    at = results.names.index
    rows = whole.rows[::10] // 10
    trunk = (results.upright.xyz_m[:, at("neck_base")] + results.upright.xyz_m[:, at("tail_base")])[rows] / 2
    way = np.linalg.norm((trunk - trunk[0])[:, :2], axis=1)
    np.testing.assert_allclose(np.linalg.norm(reference.base_m[::10, :2], axis=1), way, atol=1e-9)
    assert reference.base_m[-1, 0] == pytest.approx(way[-1])
    # A foot is the paw relative to the trunk in heading axes, up to a constant mean position.
    ahead = (trunk[-1] - trunk[0])[:2] / way[-1]
    left = np.array([-ahead[1], ahead[0]])
    yaw = reference.roll_pitch_yaw_rad[::10, 2]
    for k, label in enumerate(LEGS):
        paw = (results.upright.xyz_m[rows, at(results.foot_names[label])] - trunk)[:, :2]
        along, aside = paw @ ahead, paw @ left
        turned = np.column_stack([np.cos(yaw) * along + np.sin(yaw) * aside, np.cos(yaw) * aside - np.sin(yaw) * along])
        np.testing.assert_allclose(np.ptp(turned - reference.feet_m[::10, k, :2], axis=0), 0, atol=1e-9)


def test_stride_of_a_whole_animal_is_complete_and_closes(whole):
    window = stride_window(whole)
    assert window.source == "stride"
    stride = closed_stride(whole, window)
    for values in (stride.feet_m, stride.roll_pitch_yaw_rad, stride.base_m[:, 2], stride.standing):
        np.testing.assert_allclose(values[-1], values[0], atol=1e-12)
    assert stride.advance_m is not None
    np.testing.assert_allclose((stride.base_m[-1] - stride.base_m[0])[:2], stride.advance_m, atol=1e-12)
    assert stride.standing.any(axis=0).all()
    # No foot moves by more than the gap that is spread over the stride.
    own = whole.reference.feet_m[window.first : window.last + 1]
    gap = np.abs(own[-1] - own[0]).max()
    assert np.abs(stride.feet_m - own).max() < gap + 0.05


@pytest.mark.parametrize("robot", ["a1", pytest.param("aibo", marks=pytest.mark.slow)])
def test_the_motion_has_its_stated_properties(retargeted, robot):
    solved = retargeted(robot)
    assert not [note for note in report_of(solved)["notes"] if not note.startswith(("the clip", "fore and"))]
    for motion in (solved.clip, solved.stride):
        assert motion.slip_m.max() < 0.002
        assert min(motion.points(label)[..., 2].min() for label in LEGS) > -1e-9
        assert motion.margin_rad.min() >= 0
        assert motion.rate_share.max() <= 1 + 1e-9
        assert not motion.short.any()
        for k, label in enumerate(LEGS):
            leg = motion.robot.legs[label]
            foot = feet_in_world(motion.pose, np.zeros(3), leg.chain.end(motion.leg_angles(label))[:, None])[:, 0]
            np.testing.assert_allclose(foot, motion.feet_m[:, k], atol=1e-9)
    assert solved.stride.closing_percent < 1
    assert max(solved.clip.rate_share.max(), solved.stride.rate_share.max()) > 0.99 or (solved.clip.slower == 1)


def test_the_robot_follows_the_scaled_path_of_the_animal(whole):
    robot = load_robot("a1")
    pose, feet, standing = place(whole.reference, robot, 0.4)
    np.testing.assert_allclose(pose.translation[:, :2], 0.4 * whole.reference.base_m[:, :2])
    hips = pose.translation[:, 2] + robot.ground_m
    assert np.abs(hips).max() <= 0.15 * robot.stand_m
    assert (feet[standing][:, 2] == 0).all()


def test_given_factors_are_kept_and_broken_limits_reported(whole):
    solved = retarget(whole, load_robot("aibo"), scale=0.3, slower=1.0)
    assert (solved.clip.scale, solved.clip.slower) == (0.3, 1.0)
    notes = "; ".join(report_of(solved)["notes"])
    assert "out of reach" in notes
    assert says(notes, "rate limit")
    # Joint limits hold, because feet are moved towards the hips.
    assert solved.clip.margin_rad.min() >= 0
    assert solved.clip.short.any()


def test_a_foot_is_moved_into_reach_as_little_as_possible():
    leg = load_robot("a1").legs["LF"]
    far = leg.neutral_m + np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -0.2]])
    angles, short = within_reach(leg, far)
    assert short.tolist() == [False, True, True]
    feet = leg.chain.end(angles)
    assert feet[0] == pytest.approx(leg.neutral_m)
    # Straight down, the knee reaches its limit: 0.4 cos(0.9163 / 2).
    assert feet[2] == pytest.approx([*leg.neutral_m[:2], -0.4 * np.cos(0.9163 / 2)], abs=1e-6)
    assert feet[1, 0] > leg.neutral_m[0] + 0.2
    assert feet[1, 1:] == pytest.approx(leg.neutral_m[1:])


def test_legs_keep_their_distance(whole, retargeted):
    robot, motion = load_robot("a1"), retargeted("a1")
    for part in (motion.clip, motion.stride):
        # The distance of the feet is at least the distance of the legs.
        feet = np.linalg.norm(part.feet_m[:, :2] - part.feet_m[:, 2:], axis=-1).min()
        assert 0.15 * robot.stand_m <= part.apart_m <= feet + 0.002
    # The legs would meet without moving outwards.
    assert motion.spread_m > 0
    pose, feet, _ = place(whole.reference, robot, motion.clip.scale)
    assert np.linalg.norm(feet[:, :2] - feet[:, 2:], axis=-1).min() < 0.03
    # The hind feet are further out by the spread, and the fore feet are unchanged.
    _, wider, _ = place(whole.reference, robot, motion.clip.scale, 0.05)
    turn = pose.rotation.as_matrix()[:, :2, 1]
    left = turn / np.linalg.norm(turn, axis=1)[:, None]
    out = np.einsum("tlj,tj->tl", (wider - feet)[..., :2], left)
    np.testing.assert_allclose(out[:, :2], 0, atol=0.003)
    np.testing.assert_allclose(out[:, 2:], np.tile([0.05, -0.05], (len(out), 1)), atol=0.003)


def test_legs_that_meet_are_reported(whole):
    # At this scale, fore and hind legs cannot pass each other.
    solved = retarget(whole, load_robot("aibo"), scale=0.25)
    assert min(solved.clip.apart_m, solved.stride.apart_m) < 0.15 * 0.11
    assert any("of each other" in note for note in report_of(solved)["notes"])


def test_distance_between_legs(whole):
    still = replace(
        whole.reference,
        feet_m=0 * whole.reference.feet_m,
        base_m=0 * whole.reference.base_m,
        roll_pitch_yaw_rad=0 * whole.reference.roll_pitch_yaw_rad,
    )
    # Hips 0.361 m apart, and thighs side by side that lean by acos(0.7); points along them are 25 mm apart.
    found = on_robot(still, still, load_robot("a1"), scale=0.4)[0].apart_m
    assert 0.361 * 0.7 <= found < 0.361 * 0.7 + 0.013


def test_a_repeated_stride_is_continuous(retargeted):
    stride = retargeted("a1").stride
    three = repeated(stride, 3)
    n = len(stride.time_s) - 1
    assert len(three.time_s) == 3 * n + 1
    np.testing.assert_allclose(np.diff(three.time_s), stride.time_s[1], rtol=1e-9)
    np.testing.assert_allclose(three.angles_rad[n : 2 * n], stride.angles_rad[:-1], atol=1e-12)
    assert three.slip_m.max() < 0.002
    assert three.rate_share.max() <= stride.rate_share.max() * 1.05


def test_the_animal_in_the_playback_has_the_colours_of_its_sides(retargeted, tmp_path):
    # The near side of a horse has the colour of the left side.
    solved = retargeted("a1")
    horse = load_skeleton("horse-22")
    at = {marker: j for j, marker in enumerate(horse.markers)}
    limbs = {limb: tuple(at[marker] for marker in along) for limb, along in horse.limbs.items()}
    points = np.zeros((len(solved.clip.time_s), len(at), 3))
    beside = SimpleNamespace(limbs=limbs, limb_sides=horse.limb_sides(), title=horse.title)
    write_robot(solved.clip, tmp_path / "motion.rrd", (points, beside))
    reader = RrdReader(tmp_path / "motion.rrd")
    (store,) = reader.recordings()
    (colours,) = (
        row["LineStrips3D:colors"]
        for chunk in reader.stream(store=store)
        if chunk.entity_path == "/world/animal" and chunk.is_static
        for row in chunk.to_record_batch().to_pylist()
        if row.get("LineStrips3D:colors")
    )
    drawn = {limb: (c >> 24, c >> 16 & 255, c >> 8 & 255) for limb, c in zip(limbs, colours, strict=True)}
    assert {drawn["near fore leg"], drawn["near hind leg"]} == {LEFT}
    assert {drawn["off fore leg"], drawn["off hind leg"]} == {RIGHT}
    assert {drawn["trunk"], drawn["head"]} == {MIDDLE}
    (layout,) = reader.blueprints()
    shown = [row for chunk in reader.stream(store=layout) for row in chunk.to_record_batch().to_pylist()]
    contents = {str(v["ViewContents:query"]) for v in shown if "- world/" in str(v.get("ViewContents:query"))}
    # The animal and the robot are side by side, each in its own view.
    assert len(contents) == 2
    assert {"- world/animal/**" in c for c in contents} == {"- world/robot/**" in c for c in contents} == {True, False}
    assert companion(solved)[1].limb_sides["left front leg"] == "left"


def table(path):
    with path.open() as file:
        header, *rows = csv.reader(file)
    return header, np.array(rows, float)


def test_the_command_writes_consistent_tables(whole_results, frame_results, tmp_path):
    out = tmp_path / "robot"
    ended = run("retarget", whole_results, "--robot", "a1", "--out", out)
    assert says(ended.out, "ends meet", "0.1 %")
    assert ended.code == 0, ended.err
    assert "Unitree A1" in ended.out
    assert {f.name for f in out.iterdir() if f.name != RECORD} == {
        *(f"{prefix}{name}.csv" for prefix in ("", "stride_") for name in ("joints", "base", "feet")),
        "report.json",
        "motion.rrd",
        "stride.rrd",
        "manifest.json",
        "robot.npz",
    }
    robot = load_robot("a1")
    report = json.loads((out / "report.json").read_text())
    assert list(report["robot"]["joints"]) == list(robot.joints)
    assert (report["robot"]["source"], report["animal"]["results"]) == ("a1", os.path.relpath(whole_results, out))
    for prefix in ("", "stride_"):
        header, joints = table(out / f"{prefix}joints.csv")
        n = len(robot.joints)
        assert header[: 1 + n] == ["time_s", *robot.joints]
        assert header[1 + n] == f"{robot.joints[0]}_rate_rad_s"
        assert header[-1] == f"{robot.joints[-1]}_acceleration_rad_s2"
        angles, rates, accelerations = np.split(joints[:, 1:], 3, axis=1)
        interval_s = np.diff(joints[:, 0])[:, None]
        # An angle changes by the mean of two rates times the step, and a rate by the mean of two accelerations.
        for value, change in ((angles, rates), (rates, accelerations)):
            moved = (change[1:] + change[:-1]) / 2 * interval_s
            np.testing.assert_allclose(moved[2:-2], np.diff(value, axis=0)[2:-2], atol=0.15 * np.ptp(value))
        if prefix:
            np.testing.assert_allclose(rates[0], rates[-1], atol=1e-9)
            assert np.abs(accelerations[0] - accelerations[-1]).max() < 0.02 * np.abs(accelerations).max()
        _, base = table(out / f"{prefix}base.csv")
        names, feet = table(out / f"{prefix}feet.csv")
        # Compute the feet from the tables of the joints and the base, as a controller would.
        from scipy.spatial.transform import Rotation

        R = Rotation.from_quat(base[:, 4:])
        for k, label in enumerate(LEGS):
            foot = R.apply(robot.legs[label].chain.end(joints[:, 1 + 3 * k : 4 + 3 * k])) + base[:, 1:4]
            column = names.index(f"{label}_x_m")
            np.testing.assert_allclose(foot, feet[:, column : column + 3], atol=1e-9)
            stands = feet[:, names.index(f"{label}_stands")] == 1
            assert np.abs(foot[stands, 2]).max() < 1e-9
    there = ("--out", "folder", out, "--overwrite")
    refused(["retarget", whole_results, "--robot", "a1", "--out", out], there)
    args = ["retarget", frame_results, "--robot", "a1", "--out", tmp_path / "chain", "--anyway"]
    refused(args, ("noisy.csv", "feet", "RF, RH", "whole animal"))


def test_a_urdf_file_gives_the_motion_of_the_closed_form(whole, tmp_path):
    # The URDF robot has no closed form, so the methods of `recon.ik` solve its legs.
    path = tmp_path / "a1.urdf"
    shape = '<link name="trunk"><visual><geometry><box size="0.4 0.1 0.1"/></geometry></visual></link>'
    facet = np.zeros(1, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facet["corners"] = [[0, 0, 0], [0, 0, -0.2], [0.05, 0, -0.1]]
    mesh = bytes(80) + np.uint32(1).tobytes() + facet.tobytes()
    (tmp_path / "thigh.stl").write_bytes(mesh)
    thigh = '<link name="FL_thigh"><visual><geometry><mesh filename="thigh.stl"/></geometry></visual></link>'
    text = a1_urdf().replace('<link name="trunk"/>', shape).replace('<link name="FL_thigh"/>', thigh)
    assert (shape in text, thigh in text) == (True, True)
    path.write_text(text)
    stride = closed_stride(whole, stride_window(whole))
    closed, robot = on_robot(stride, stride, load_robot("a1"), scale=0.35), load_robot(path)
    found = posed(robot, stride.time_s - stride.time_s[0], *place(stride, robot, 0.35, closed[2]))
    found = replace(found, scale=0.35, advance_m=closed[1].advance_m)
    np.testing.assert_allclose(found.angles_rad, closed[1].angles_rad, atol=1e-3)
    assert found.slip_m.max() < 0.0005
    assert found.closing_percent < 0.1
    refused(["retarget", tmp_path, "--robot", path, "--out", tmp_path / "out"], (tmp_path, "folder", "no motion.npz"))
    # The playback shows the shapes of the robot's file at the positions that the joints and the base give.
    write_robot(found, tmp_path / "motion.rrd")
    reader = RrdReader(tmp_path / "motion.rrd")
    rows: dict[str, list] = {}
    for chunk in reader.stream(store=reader.recordings()[0]):
        rows.setdefault(str(chunk.entity_path), []).extend(chunk.to_record_batch().to_pylist())
    boxes = [
        row["Boxes3D:half_sizes"]
        for row in rows["/shapes/a1/visual_geometries/trunk/visual_0"]
        if "Boxes3D:half_sizes" in row
    ]
    np.testing.assert_allclose(boxes, [[[0.2, 0.05, 0.05]]], atol=1e-6)
    meshes = [row for row in rows["/shapes/a1/visual_geometries/FL_thigh/visual_0"] if "Asset3D:blob" in row]
    assert [(bytes(row["Asset3D:blob"][0]), row["Asset3D:media_type"]) for row in meshes] == [(mesh, ["model/stl"])]
    hip, base = rows["/world/robot/joints/FL_hip_joint"], rows["/world/robot/base"]
    assert (hip[0]["Transform3D:parent_frame"], base[0]["Transform3D:child_frame"]) == (["trunk"], ["base"])
    half = found.angles_rad[:, found.robot.joints.index("FL_hip_joint")] / 2
    np.testing.assert_allclose([row["Transform3D:quaternion"][0][0] for row in hip], np.sin(half), atol=1e-6)
    positions = [row["Transform3D:translation"][0] for row in base]
    np.testing.assert_allclose(positions, found.pose.translation, atol=1e-6)


def test_all_problems_are_reported_at_once(tmp_path):
    with pytest.raises(InputError) as error:
        RetargetSettings(folder=tmp_path / "none", robot="spot", out=tmp_path / "out", scale=-1, slower=0)
    assert {p.field for p in error.value.problems} == {"scale", "slower"}
    with pytest.raises(InputError) as error:
        run_retarget(RetargetSettings(folder=tmp_path / "none", robot="spot", out=tmp_path / "out"))
    found = [(str(p.file), p.field) for p in error.value.problems]
    assert ("--robot", "name or file") in found
    assert len(found) == 2
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_real_run_without_a_complete_stride_uses_the_nearest_return(shared_data, tmp_path):
    from recon import FitSettings
    from recon.api.clip_results import run_clip

    run_folder = shared_data / "cheetah-runs" / "2017_09_02-top-phantom-run1_2"
    meta = json.loads((run_folder / "meta.json").read_text())
    camera = f"cam{meta['monocular_camera']}"
    settings = FitSettings(
        keypoints=run_folder / f"{camera}.csv", camera=run_folder / "scene.json", camera_name=camera, fps=meta["fps"]
    )
    run_clip(settings, tmp_path / "fit", False, lambda *_: None)
    solved, report = run_retarget(RetargetSettings(folder=tmp_path / "fit", robot="a1", out=tmp_path / "robot"))
    assert report["stride"]["how"] == "return"
    assert "no complete stride" in report["notes"][0]
    for motion in (solved.clip, solved.stride):
        assert motion.slip_m.max() < 0.002
        assert motion.margin_rad.min() >= 0
        assert motion.rate_share.max() <= 1 + 1e-9
    assert solved.stride.closing_percent < 1
