"""Reading a result folder: against the fit's own tables, forward kinematics of its states, and the upright frame."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from recon.animal.skeleton_file import load_chain
from recon.base.errors import InputError
from recon.base.manifest import write_manifest
from recon.fit.results import read_results
from recon.geometry.camera import Camera
from recon.io.pose3d import read_pose3d


def copy(folder: Path, to: Path) -> Path:
    return Path(shutil.copytree(folder, to / "copy"))


def test_a_world_with_z_up_stays_as_it_is(whole_results):
    found = read_results(whole_results)
    pose = read_pose3d(whole_results / "pose3d.csv")
    np.testing.assert_array_equal(found.pose.xyz_m, pose.xyz_m)
    assert found.pose.names == pose.names
    assert found.fps == 60
    assert found.method == "trajectory"
    table = pd.read_csv(whole_results / "pose3d_sigma.csv", header=[0, 1], index_col=0)
    np.testing.assert_allclose(found.sigma_m[:, 3], table["neck_base"][["x_sigma", "y_sigma", "z_sigma"]])
    np.testing.assert_allclose(found.relative_sigma_m[:, 3], table["neck_base"][["x_rel", "y_rel", "z_rel"]])


def test_shares_and_deviations_belong_to_their_angles(whole_results):
    found = read_results(whole_results)
    table, report = pd.read_csv(whole_results / "angles_sigma.csv"), found.report["angles"]
    i = found.angle_names.index("head_yaw")
    np.testing.assert_array_equal(found.angle_sigma_rad[:, i], table["head_yaw_sigma_rad"])
    np.testing.assert_array_equal(found.angle_data_share[:, i], table["head_yaw_data_share"])
    assert [*report] == [*found.state_names[3:]]
    for name, share in found.data_shares.items():
        assert report[name]["data_share"] == pytest.approx(share, rel=1e-8)


@pytest.mark.parametrize("results", ["whole_results", "level_results"])
def test_states_and_size_give_the_joints(results, request):
    """Also where the fit's frame of reference is the camera's: the states are upright."""
    found = read_results(request.getfixturevalue(results))
    joints = found.body.tree.pose(found.states, found.size).points_m
    np.testing.assert_allclose(joints, found.pose.xyz_m, atol=1e-6)


def test_the_camera_frame_is_turned_upright(level_results):
    found = read_results(level_results)
    assert json.loads((level_results / "report.json").read_text())["frame_of_reference"] == "camera"
    in_camera = read_pose3d(level_results / "pose3d.csv").xyz_m
    up = np.array([0.0, -np.cos(np.radians(3)), -np.sin(np.radians(3))])
    np.testing.assert_allclose(found.pose.xyz_m[..., 2], in_camera @ up, atol=1e-9)
    np.testing.assert_allclose(found.pose.xyz_m[..., 0], in_camera[..., 0], atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(found.pose.xyz_m, axis=2), np.linalg.norm(in_camera, axis=2), rtol=1e-12)
    # The camera's y and z mix by the tilt; their variances with them.
    table = pd.read_csv(level_results / "pose3d_sigma.csv", header=[0, 1], index_col=0)["spine"]
    expected = table["y_sigma"] ** 2 * np.cos(np.radians(3)) ** 2 + table["z_sigma"] ** 2 * np.sin(np.radians(3)) ** 2
    j = found.pose.names.index("spine")
    np.testing.assert_allclose(found.sigma_m[:, j, 2], np.sqrt(expected), rtol=1e-9)


def test_a_chain_is_called_by_its_keypoints(frame_results):
    found = read_results(frame_results)
    assert found.body.one_sided
    assert found.method == "frame"
    assert np.isfinite(found.sigma_m).all()
    assert found.forward == ("tail_base", "neck_base")
    assert found.feet == {"RH": "r_back_paw", "RF": "r_front_paw"}
    assert found.keypoint_of["J0"] == "tail_base"
    names = [found.pose.names[j] for j in found.limbs["front leg"]]
    assert names == ["neck_base", "r_front_knee", "r_front_ankle", "r_front_paw"]
    camera = Camera.from_dict(found.report["input"]["camera"])
    chain = load_chain(found.skeleton_name)
    unknowns = np.array([frame["unknowns"] for frame in found.report["frames"]], dtype=float)
    np.testing.assert_allclose(camera.camera_to_world(chain.pose(unknowns).joints_m), found.pose.xyz_m, atol=1e-6)
    sizes = unknowns[:, chain.base_index] / chain.nominal_base_length_m
    assert found.size == pytest.approx(np.median(sizes))
    np.testing.assert_allclose(found.body.tree.pose(found.states, sizes).points_m, found.pose.xyz_m, atol=1e-6)
    assert found.angle_names[:4] == ("J0_pitch", "J0_roll", "phi_6", "theta_6")
    np.testing.assert_array_equal(found.angles_rad[:, 0], found.states[:, 4])


def test_feet_of_a_whole_animal(whole_results):
    assert read_results(whole_results).feet == {
        "LF": "l_front_paw",
        "RF": "r_front_paw",
        "LH": "l_back_paw",
        "RH": "r_back_paw",
    }


def test_feet_do_not_depend_on_what_the_clip_shows(whole_results):
    """A few frames in which a forefoot is behind the middle of the trunk: it stays the forefoot."""
    found = read_results(whole_results)
    paw, tail = (found.pose.names.index(name) for name in ("l_front_paw", "tail_base"))
    swung = found.pose.xyz_m.copy()
    swung[:, paw, :2] = swung[:, tail, :2]
    behind = replace(found, pose=replace(found.pose, xyz_m=swung))
    assert behind.feet == found.feet


def test_spells_and_their_grounds(whole_results, frame_results):
    """The ground is a plane in the upright frame; where there were two segments, each has its own."""
    found = read_results(whole_results)
    ((written,), (segment,)) = found.report["segments"], found.segments
    assert segment.rows == slice(0, 60)
    assert segment.ground is not None
    at = np.array(written["ground"]["middle_m"])
    assert segment.ground.height_m + segment.ground.slope @ at == pytest.approx(written["ground"]["height_m"])
    feet = found.pose.xyz_m[:, [found.pose.names.index(foot) for foot in found.feet.values()], 2]
    assert np.percentile(feet, 10) == pytest.approx(written["ground"]["height_m"], abs=0.1)
    lower = {**written["ground"], "height_m": written["ground"]["height_m"] - 0.5}
    two = [{"frames": [0, 20], "ground": None}, {"frames": [40, 60], "ground": lower}]
    first, second = replace(found, report=found.report | {"segments": two}).segments
    assert (first.rows, first.ground, second.rows) == (slice(0, 20), None, slice(40, 60))
    assert second.ground is not None
    assert second.ground.height_m == pytest.approx(segment.ground.height_m - 0.5)
    frame = read_results(frame_results)
    assert [(one.rows, one.ground) for one in frame.segments] == [(slice(0, len(frame.pose.frames)), None)]


def test_sides_of_limbs(whole_results, frame_results):
    whole, chain = read_results(whole_results).limb_sides, read_results(frame_results).limb_sides
    assert (whole["left hind leg"], whole["right front leg"], whole["trunk"]) == ("left", "right", None)
    assert chain == {"hind leg": "right", "spine": None, "front leg": "right"}


def problem(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_results(folder)
    return str(caught.value)


def test_what_is_no_result_folder(tmp_path, whole_results):
    assert "no such folder" in problem(tmp_path / "nothing")
    assert "no report.json" in problem(tmp_path)
    folder = copy(whole_results, tmp_path)
    assert problem(tmp_path).endswith(f"no report.json, expected that of one clip, as in {folder}")  # of a batch
    (tmp_path / "analysis.json").write_text('{"schema": {"name": "recon.analysis", "version": 1}}')
    assert "found what `recon analyse` wrote, expected that of one clip" in problem(tmp_path)
    robot = tmp_path / "robot"
    robot.mkdir()
    (robot / "report.json").write_text('{"schema": {"name": "recon.retarget", "version": 1}}')
    write_manifest(robot)
    assert "found what `recon retarget` wrote, expected the folder of results that `recon fit` wrote" in problem(robot)
    (folder / "angles.csv").unlink()
    (folder / "pose3d.csv").unlink()
    both = problem(folder)
    assert "angles.csv" in both
    assert "pose3d.csv" in both


def test_a_first_frame_without_a_pose(tmp_path, whole_results):
    """pandas would take its row of empty cells for a part of the header."""
    folder = copy(whole_results, tmp_path)
    for name, header in (("pose3d.csv", 2), ("pose3d_sigma.csv", 2), ("angles.csv", 1)):
        lines = (folder / name).read_text(encoding="utf-8").splitlines()
        lines[header] = "0" + "," * lines[header].count(",")
        (folder / name).write_text("\n".join(lines) + "\n", encoding="utf-8")
    write_manifest(folder)
    found = read_results(folder)
    for values in (found.pose.xyz_m, found.states, found.sigma_m):
        assert len(values) == 60
        assert np.isnan(values[0]).all()
        assert np.isfinite(values[1:]).all()


@pytest.mark.parametrize(
    ("name", "change", "said"),
    [
        ("report.json", lambda text: "{", "the report of `recon fit`"),
        ("report.json", lambda text: text.replace('"version": 4', '"version": 3'), "fit the clip again"),
        ("angles.csv", lambda text: "\n".join(text.splitlines()[:-1]) + "\n", "59 rows, but 60"),
        ("angles.csv", lambda text: text.replace("head_yaw", "neck_yaw"), "columns: found x_m"),
        ("angles.csv", lambda text: text.replace("0.", "0,", 1), "angles.csv: "),
        ("pose3d_sigma.csv", lambda text: "\n".join(text.splitlines()[:-1]) + "\n", "found 59, expected 60"),
        ("pose3d_sigma.csv", lambda text: text.replace("z_rel", "z_abs"), "pose3d_sigma.csv: columns"),
        ("angles_sigma.csv", lambda text: "\n".join(text.splitlines()[:-1]) + "\n", "59, expected 60"),
        ("angles_sigma.csv", lambda text: text.replace("head_yaw", "neck_yaw"), "angles_sigma.csv: columns"),
    ],
)
def test_files_that_do_not_fit_together(tmp_path, whole_results, name, change, said):
    folder = copy(whole_results, tmp_path)
    path = folder / name
    path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")
    assert f"{path}: content: found other than manifest.json says" in problem(folder)
    write_manifest(folder)
    assert said in problem(folder)


# -- of one run ------------------------------------------------------------------------------------------------------


def test_without_a_manifest_they_are_no_results(whole_results, tmp_path):
    """As after a run that was killed while it wrote."""
    folder = copy(whole_results, tmp_path)
    (folder / "manifest.json").unlink()
    said = problem(folder)
    assert said.startswith(f"{folder}: folder: found no manifest.json: of an interrupted run")
    assert "run the command again, with --overwrite" in said


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", '{"schema": {"name": "recon.base.manifest", "version": 1}}', "9" * 5000]
)
def test_a_manifest_of_another_kind(whole_results, tmp_path, content):
    folder = copy(whole_results, tmp_path)
    (folder / "manifest.json").write_text(content)
    assert problem(folder).startswith(f"{folder / 'manifest.json'}: content: found something else")


def test_a_table_that_was_removed_is_missed(whole_results, tmp_path):
    """Also one that other methods do not write: without it, nothing would be said of the uncertainty."""
    folder = copy(whole_results, tmp_path)
    (folder / "pose3d_sigma.csv").unlink()
    assert f"{folder / 'pose3d_sigma.csv'}: file: found no such file, which manifest.json names" in problem(folder)


def test_what_is_not_read_may_be_removed_and_files_added(whole_results, tmp_path):
    folder = copy(whole_results, tmp_path)
    (folder / "motion.rrd").unlink()
    (folder / "notes.txt").write_text("mine")
    assert read_results(folder).fps == 60


def test_a_table_that_no_manifest_names_is_not_read(frame_results, tmp_path):
    folder = copy(frame_results, tmp_path)
    sigmas = (folder / "pose3d_sigma.csv").read_bytes()
    (folder / "pose3d_sigma.csv").unlink()
    write_manifest(folder)
    (folder / "pose3d_sigma.csv").write_bytes(sigmas)
    assert "pose3d_sigma.csv" in problem(folder)


def test_results_that_are_replaced_while_they_are_read(whole_results, tmp_path, monkeypatch):
    folder = copy(whole_results, tmp_path)

    def replaced(path):
        (folder / "manifest.json").unlink()
        return read_pose3d(path)

    monkeypatch.setattr("recon.fit.results.read_pose3d", replaced)
    assert "no manifest.json" in problem(folder)


@pytest.mark.parametrize(
    ("field", "value", "said"),
    [
        ("method", "guess", "method: found 'guess'"),
        ("settings", [], "settings: found []"),
        ("input.fps", "x", "input.fps: found 'x'"),
        ("input.fps", float("inf"), "input.fps: found inf"),
        ("input.camera", {}, "input.camera: found 'name'"),
        ("input.camera.name", ["a"], "input.camera: found the name ['a']"),
        ("input.camera.matrix", "x", "input.camera: found could not convert"),
        ("side", None, "side: found None"),
        ("skeleton.joints", ["nose"], "skeleton.joints: found something else than pose3d.csv has"),
        ("skeleton.keypoints", ["nose"] * 24, "skeleton.keypoints: found something else"),
        ("skeleton.state_names", 3, "skeleton.state_names: found 3"),
        ("skeleton.feet", {"LF": "wing"}, "skeleton.feet: found something else"),
        ("size", None, "size: found nothing"),
        ("root_path.keypoint", "wing", "root_path.keypoint: found something else"),
        ("frames", [], "frames: found something else"),
        ("outliers", [{"frame": 999, "keypoint": "nose"}], "outliers: found something else"),
        ("image_error_px.values", [[1.0]], "image_error_px.values[0][0]: found 1.0"),
        ("image_error_px.others", [[]], "image_error_px.values: found something else"),
        ("cameras", [{"camera": {}}] * 2, "cameras[1].camera: found 'name'"),
        ("cameras.0.camera.name", "other", "outliers: found something else"),
        ("segments", [{"frames": [0]}], "segments[0].frames: found [0]"),
    ],
)
def test_altered_fields_of_a_report(tmp_path, whole_results, field, value, said):
    folder = copy(whole_results, tmp_path)
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    *parts, last = field.split(".")
    holder = report
    for part in parts:
        holder = holder[int(part) if part.isdigit() else part]
    holder[last] = value
    (folder / "report.json").write_text(json.dumps(report), encoding="utf-8")
    write_manifest(folder)
    assert said in problem(folder)


def test_missing_fields_of_a_report(tmp_path, whole_results):
    folder = copy(whole_results, tmp_path)
    report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    for field in ("settings", "input", "side", "skeleton", "root_path", "frames", "outliers", "image_error_px"):
        (folder / "report.json").write_text(json.dumps({k: v for k, v in report.items() if k != field}))
        write_manifest(folder)
        assert f"report.json: {field}: " in problem(folder)


def test_a_damaged_table_of_sigmas(tmp_path, whole_results):
    folder = copy(whole_results, tmp_path)
    lines = (folder / "pose3d_sigma.csv").read_text(encoding="utf-8").splitlines()
    cells = lines[2].split(",")
    for cell in ("1e308", "inf"):
        lines[2] = ",".join([cells[0], cell, *cells[2:]])
        (folder / "pose3d_sigma.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
        write_manifest(folder)
        assert "pose3d_sigma.csv: numbers: found" in problem(folder)
