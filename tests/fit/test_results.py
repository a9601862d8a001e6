"""Test loaded results against the fit's tables, forward kinematics of the states, and the upright frame."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import refusal

from recon.base.files import write_manifest
from recon.fit.motion import Motion
from recon.io.positions import read_pose3d
from recon.show.report import build_report
from recon.thesis.chain import with_unknowns

TABLES_M = 6e-6
SIGMA = {"rtol": 0.0051, "atol": TABLES_M}
"""Tolerances of standard deviations in a cheetah's tables: a little more than half of the last decimal."""


def copy(folder: Path, to: Path) -> Path:
    return Path(shutil.copytree(folder, to / "copy"))


@pytest.mark.parametrize("results", ["whole_results", "level_results", "frame_results", "chain_results"])
def test_report_agrees_with_the_motion(results, request):
    folder = request.getfixturevalue(results)
    assert build_report(Motion.load(folder)) == json.loads((folder / "report.json").read_text(encoding="utf-8"))


def test_world_with_z_up_is_not_turned(whole_results):
    found = Motion.load(whole_results)
    pose = read_pose3d(whole_results / "pose3d.csv")
    np.testing.assert_allclose(found.upright.xyz_m, pose.xyz_m, atol=TABLES_M)
    assert found.upright.names == pose.names
    assert found.fps == 60
    assert found.method == "trajectory"
    table = pd.read_csv(whole_results / "pose3d_sigma.csv", header=[0, 1], index_col=0)
    columns = table["neck_base"]
    np.testing.assert_allclose(found.upright_sigma_m[:, 3], columns[["x_sigma", "y_sigma", "z_sigma"]], **SIGMA)
    np.testing.assert_allclose(found.upright_relative_sigma_m[:, 3], columns[["x_rel", "y_rel", "z_rel"]], **SIGMA)


def test_shares_and_deviations_belong_to_their_angles(whole_results):
    found = Motion.load(whole_results)
    table = pd.read_csv(whole_results / "angles_sigma.csv")
    i = found.posture_names.index("head_yaw")
    np.testing.assert_allclose(found.posture_sigma_rad[:, i], table["head_yaw_sigma_rad"], **SIGMA)
    np.testing.assert_allclose(found.posture_data_share[:, i], table["head_yaw_data_share"], atol=6e-4)
    for name, fraction in found.data_shares.items():
        assert np.nanmedian(table[f"{name}_data_share"]) == pytest.approx(fraction, abs=6e-4)


@pytest.mark.parametrize("results", ["whole_results", "level_results"])
def test_states_and_size_give_the_joints(results, request):
    """The frame of reference may be the camera's, while the states are in an upright world."""
    found = Motion.load(request.getfixturevalue(results))
    joints = found.body.tree.pose(found.states, found.size).points_m
    np.testing.assert_allclose(joints, found.upright.xyz_m, atol=1e-9)


def test_the_camera_frame_is_turned_upright(level_results):
    found = Motion.load(level_results)
    assert found.frame_of_reference == "camera"
    in_camera = read_pose3d(level_results / "pose3d.csv").xyz_m
    up = np.array([0.0, -np.cos(np.radians(3)), -np.sin(np.radians(3))])
    np.testing.assert_allclose(found.upright.xyz_m[..., 2], in_camera @ up, atol=2 * TABLES_M)
    np.testing.assert_allclose(found.upright.xyz_m[..., 0], in_camera[..., 0], atol=TABLES_M)
    # The tilt mixes the camera's y and z, and their covariances.
    R = found.T_reference_world[:3, :3]
    j = found.names.index("spine")
    turned = R @ found.solution.covariance_m2[:, j] @ R.T
    table = pd.read_csv(level_results / "pose3d_sigma.csv", header=[0, 1], index_col=0)["spine"]
    np.testing.assert_allclose(np.sqrt(turned[:, 1, 1]), table["y_sigma"], **SIGMA)


def test_chain_has_the_names_of_its_keypoints(frame_results):
    found = Motion.load(frame_results)
    chain = with_unknowns(found.chain)
    assert chain is not None
    assert found.body.one_sided
    assert found.method == "frame"
    assert np.isfinite(found.upright_sigma_m).all()
    assert found.forward_names == ("tail_base", "neck_base")
    assert found.foot_names == {"RH": "r_back_paw", "RF": "r_front_paw"}
    assert found.joints[found.names.index("tail_base")] == "J0"
    names = [found.names[j] for j in found.limbs["front leg"]]
    assert names == ["neck_base", "r_front_knee", "r_front_ankle", "r_front_paw"]
    unknowns = found.solution.chain_states  # type: ignore[attr-defined]
    in_world = found.camera.camera_to_world(chain.pose(unknowns).joints_m)
    np.testing.assert_allclose(in_world, found.upright.xyz_m, atol=1e-9)
    sizes = unknowns[:, chain.base_index] / chain.nominal_base_length_m
    assert found.size == pytest.approx(np.median(sizes))
    np.testing.assert_allclose(found.body.tree.pose(found.states, sizes).points_m, found.upright.xyz_m, atol=1e-9)
    assert found.posture_names[:4] == ("J0_pitch", "J0_roll", "phi_6", "theta_6")
    np.testing.assert_array_equal(found.posture_rad[:, 0], found.states[:, 4])


def test_feet_of_a_whole_animal(whole_results):
    assert Motion.load(whole_results).foot_names == {
        "LF": "l_front_paw",
        "RF": "r_front_paw",
        "LH": "l_back_paw",
        "RH": "r_back_paw",
    }


def test_segments_have_their_grounds(whole_results, frame_results):
    """A ground is a plane in the upright frame; the frame method has a single segment."""
    found = Motion.load(whole_results)
    ((written,), (segment,)) = build_report(found)["segments"], found.segments
    assert segment.rows == slice(0, 60)
    assert segment.ground is not None
    at = np.array(written["ground"]["middle_m"])
    assert segment.ground.height_m + segment.ground.slope @ at == pytest.approx(written["ground"]["height_m"])
    feet = found.upright.xyz_m[:, [found.names.index(foot) for foot in found.foot_names.values()], 2]
    assert np.percentile(feet, 10) == pytest.approx(written["ground"]["height_m"], abs=0.1)
    frame = Motion.load(frame_results)
    assert [(one.rows, one.ground) for one in frame.segments] == [(slice(0, len(frame.frames)), None)]


def test_sides_of_limbs(whole_results, frame_results):
    whole, chain = Motion.load(whole_results).limb_sides, Motion.load(frame_results).limb_sides
    assert (whole["left hind leg"], whole["right front leg"], whole["trunk"]) == ("left", "right", None)
    assert chain == {"hind leg": "right", "spine": None, "front leg": "right"}


def refuses(folder: Path, *expected: object) -> None:
    with refusal(expected):
        Motion.load(folder)


def test_results_of_a_batch(tmp_path, whole_results):
    folder = copy(whole_results, tmp_path)
    refuses(tmp_path, tmp_path, "folder", "no motion.npz", ["one clip", folder])


@pytest.mark.parametrize("left", ["report.json", "config.toml", "angles.csv", "pose3d.csv", "quality.csv"])
def test_folder_without_a_manifest_is_refused(left, whole_results, tmp_path):
    """A run that was killed while writing leaves no manifest."""
    folder = copy(whole_results, tmp_path)
    for path in folder.iterdir():
        if path.name not in ("motion.npz", left):
            path.unlink()
    refuses(folder, folder, "folder", ["no manifest.json", "interrupted"], "--overwrite")


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", '{"schema": {"name": "recon.manifest", "version": 1}}', "9" * 5000]
)
def test_manifest_of_another_kind_is_refused(whole_results, tmp_path, content):
    folder = copy(whole_results, tmp_path)
    (folder / "manifest.json").write_text(content)
    refuses(folder, folder / "manifest.json", "content", "another kind of file", "--overwrite")


def test_motion_of_another_run_is_refused(whole_results, level_results, tmp_path):
    folder = copy(whole_results, tmp_path)
    shutil.copy(level_results / "motion.npz", folder)
    refuses(folder, folder / "motion.npz", "content", "manifest.json")


def test_motion_missing_in_the_manifest_is_refused(whole_results, tmp_path):
    folder = copy(whole_results, tmp_path)
    motion = (folder / "motion.npz").read_bytes()
    (folder / "motion.npz").unlink()
    write_manifest(folder)
    (folder / "motion.npz").write_bytes(motion)
    refuses(folder, folder / "motion.npz", "file", "manifest.json", "--overwrite")


def test_files_that_are_not_read_may_change(whole_results, tmp_path):
    folder = copy(whole_results, tmp_path)
    (folder / "motion.rrd").unlink()
    (folder / "report.json").unlink()
    (folder / "pose3d.csv").write_text("mine")
    (folder / "notes.txt").write_text("mine")
    assert Motion.load(folder).fps == 60
