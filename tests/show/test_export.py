"""Test that written tables are read back to their last decimal, in standard layouts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from exact_tables import read_csv

from recon.fit.motion import Motion
from recon.fit.result import SolvedShape
from recon.io.formats import read_keypoints
from recon.io.positions import read_pose3d
from recon.show import tables
from recon.show.report import build_report
from recon.show.tables import write_tables


def within(decimals: int) -> dict[str, float]:
    """Return the tolerances with which numbers rounded to `decimals` are compared."""
    return {"rtol": 0, "atol": 0.51 * 10.0**-decimals}


METRES = within(5)
"""Tolerances of positions in metres, which have five decimals in these tests."""


def test_last_digits_that_differ_between_processors_are_not_written(small_motion, tmp_path):
    """Numbers are rounded so that processors agree, zeros have no sign, and numbers are short."""
    states = np.array(small_motion.states)
    states[0, :3] = -1e-13, 0.1 + 1e-14, -2.5
    for name, shift in (("one.csv", 0.0), ("other.csv", 3e-14)):
        motion = replace(small_motion, solution=replace(small_motion.solution, states=states + shift))
        tables.angles(motion, tmp_path / name)
    text = (tmp_path / "one.csv").read_text(encoding="utf-8")
    assert text.splitlines()[1].startswith("10,0.0,0.1,-2.5,")
    assert (tmp_path / "other.csv").read_text(encoding="utf-8") == text


@pytest.mark.parametrize(("sigma_m", "decimals"), [(0.2, 4), (0.05, 5), (0.004, 6), (1e-5, 7)])
def test_positions_of_smaller_animals_have_more_decimals(small_trajectory, tmp_path, sigma_m, decimals):
    body = replace(small_trajectory.body, keypoint_sigma_m=sigma_m)
    motion = replace(small_trajectory, solution=replace(small_trajectory.solution, body=body))
    tables.pose3d(motion, tmp_path / "pose3d.csv")
    values = read_pose3d(tmp_path / "pose3d.csv").xyz_m
    np.testing.assert_array_equal(values, np.round(motion.joints_m, decimals) + 0.0)


def test_pose3d_round_trip(small_motion, tmp_path):
    path = tmp_path / "pose3d.csv"
    tables.pose3d(small_motion, path)
    pose = read_pose3d(path)
    assert pose.names == small_motion.names
    np.testing.assert_allclose(pose.xyz_m, small_motion.joints_m, **METRES)
    np.testing.assert_array_equal(pose.frames, small_motion.frames)
    assert np.isnan(pose.xyz_m[3]).all()
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("bodyparts,tail_base,tail_base,tail_base,r_back_knee")
    assert lines[1].startswith("coords,x,y,z,x")
    assert lines[5] == "13" + 27 * ","
    assert len(lines) == 8


def test_angles_round_trip(small_motion, tmp_path):
    path = tmp_path / "angles.csv"
    tables.angles(small_motion, path)
    table = read_csv(path, index_col="frame")
    assert list(table.columns[:8]) == [
        *("x_m", "y_m", "z_m", "J0_yaw_rad", "J0_pitch_rad", "J0_roll_rad", "phi_6_rad", "theta_6_rad")
    ]
    np.testing.assert_allclose(table.to_numpy(), small_motion.states, **within(tables.ANGLE))
    np.testing.assert_array_equal(table.index, small_motion.frames)


def test_reprojection_is_a_deeplabcut_file(small_motion, tmp_path):
    path = tmp_path / "reprojection.csv"
    tables.reprojection(small_motion, path)
    keypoints = read_keypoints(path)
    assert keypoints.names == small_motion.names
    np.testing.assert_allclose(keypoints.xy_px, small_motion.pictures[0].reprojected_px, **within(tables.PIXEL))
    np.testing.assert_array_equal(keypoints.frames, small_motion.frames)
    np.testing.assert_array_equal(keypoints.confidence, np.tile(small_motion.solved[:, None], (1, 9)).astype(float))

    table = read_csv(path, header=[0, 1, 2], index_col=0)
    assert table.columns.names == ["scorer", "bodyparts", "coords"]
    np.testing.assert_allclose(
        table["recon", "spine", "x"], small_motion.pictures[0].reprojected_px[:, 4, 0], **within(tables.PIXEL)
    )
    np.testing.assert_array_equal(table["recon", "spine", "likelihood"], [1, 1, 1, 0, 1, 1])


def test_angles_of_a_whole_animal(world_trajectory, tmp_path):
    tables.angles(world_trajectory, tmp_path / "angles.csv")
    table = read_csv(tmp_path / "angles.csv", index_col="frame")
    assert list(table.columns[:5]) == ["x_m", "y_m", "z_m", "rear_trunk_yaw_rad", "rear_trunk_pitch_rad"]
    assert table.columns[-1] == "r_hind_foot_pitch_rad"
    np.testing.assert_allclose(table.to_numpy(), world_trajectory.states, **within(tables.ANGLE))


def test_pose3d_sigma_has_the_layout_of_pose3d(world_trajectory, tmp_path):
    tables.pose3d_sigma(world_trajectory, tmp_path / "pose3d_sigma.csv")
    table = read_csv(tmp_path / "pose3d_sigma.csv", header=[0, 1], index_col=0)
    assert table.columns.names == ["bodyparts", "coords"]
    assert list(table.columns.get_level_values(0).unique()) == list(world_trajectory.names)
    coords = ["x_sigma", "y_sigma", "z_sigma", "x_rel", "y_rel", "z_rel"]
    assert list(table["nose"].columns) == coords
    values = np.concatenate((world_trajectory.joint_sigma_m, world_trajectory.relative_sigma_m), axis=2)
    np.testing.assert_allclose(table.to_numpy().reshape(8, 24, 6), values, rtol=0.006)
    np.testing.assert_array_equal(table.index, world_trajectory.frames)


def test_standard_deviations_have_three_significant_digits(world_trajectory, tmp_path):
    sigma_m = np.array([1.78724, 0.0466051, 12.3456, 1234.5, 0.000123456, 0.0, np.nan, 0.1])
    covariance_m2 = np.zeros((8, 24, 3, 3))
    covariance_m2[:, 0, 0, 0] = sigma_m**2
    motion = replace(world_trajectory, solution=replace(world_trajectory.solution, covariance_m2=covariance_m2))
    tables.pose3d_sigma(motion, tmp_path / "pose3d_sigma.csv")
    column = [line.split(",")[1] for line in (tmp_path / "pose3d_sigma.csv").read_text().splitlines()[2:]]
    assert column == ["1.79", "0.0466", "12.3", "1234.0", "0.00012", "0.0", "", "0.1"]


def test_angles_sigma_has_the_columns_of_the_angles(world_trajectory, tmp_path):
    solution, (T, A) = world_trajectory.solution, world_trajectory.angles_rad.shape
    fraction = np.linspace(0, 1, T * A).reshape(T, A)
    motion = replace(world_trajectory, solution=replace(solution, angle_data_share=fraction))
    tables.angles_sigma(motion, tmp_path / "angles_sigma.csv")
    table = read_csv(tmp_path / "angles_sigma.csv", index_col="frame")
    np.testing.assert_allclose(table["rear_trunk_pitch_data_share"], fraction[:, 1], **within(tables.SHARE))
    np.testing.assert_array_equal(table["r_hind_foot_pitch_sigma_rad"], 0.1)
    assert table.shape == (T, 2 * A)


def test_quality_has_the_flags_of_each_frame(small_trajectory, tmp_path):
    tables.quality(small_trajectory, tmp_path / "quality.csv")
    table = read_csv(tmp_path / "quality.csv", index_col="frame")
    assert table["flags"].fillna("").tolist() == ["", "", "", "no data", "", "data poor;ambiguous depth", "", ""]
    assert table["detections"].tolist() == [23, 23, 23, 0, 23, 23, 23, 23]
    np.testing.assert_allclose(table["alternative_m"], small_trajectory.solution.alternative_m, **METRES)
    np.testing.assert_allclose(table["mean_weight"], small_trajectory.mean_weight, **within(tables.SHARE))
    np.testing.assert_allclose(table["place_sigma_m"], small_trajectory.place_sigma_m, **METRES)
    np.testing.assert_allclose(table["relative_rms_m"], small_trajectory.relative_rms_m, **METRES)


def test_quality_of_the_frame_method_has_the_same_columns(small_motion, tmp_path):
    tables.quality(small_motion, tmp_path / "quality.csv")
    table = read_csv(tmp_path / "quality.csv", index_col="frame")
    assert tuple(table.columns) == tables.QUALITY_COLUMNS[1:]
    assert table["flags"].fillna("").tolist() == ["", "", "", "no data", "outliers", "few points"]
    assert table["detections"].tolist() == [9, 8, 9, 0, 9, 6]
    assert table["alternative_m"].isna().all()
    for name in ("mean_weight", "place_sigma_m", "relative_rms_m"):
        decimals = within(tables.SHARE) if name == "mean_weight" else METRES
        np.testing.assert_allclose(table[name], getattr(small_motion, name), **decimals)
        assert table[name].isna().tolist() == [False, False, False, True, False, False]
    assert table["mean_weight"].iloc[4] < 0.9 < table["mean_weight"].iloc[0]
    assert table["relative_rms_m"].max() < table["place_sigma_m"].min()


@pytest.mark.parametrize("motion", ["small_motion", "small_trajectory"])
def test_every_table_is_written(motion, tmp_path, request):
    write_tables(request.getfixturevalue(motion), tmp_path)
    outputs = [*tables.CLIP_OUTPUTS, tables.REPROJECTION]
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(outputs)
    for path in tmp_path.iterdir():
        text = path.read_bytes()
        assert text.count(b"\n") >= (2 if path.name == "to_correct.csv" else 7)
        assert b"\r" not in text
        assert b"nan" not in text


def test_lengths_and_offsets_that_were_estimated_have_a_table(small_trajectory, tmp_path):
    J, lengths_m = len(small_trajectory.joints), np.array([0.5, 0.25])
    offsets_m = 0.01 * np.arange(3.0 * J).reshape(J, 3)
    names, expected_m = ("neck", "l_thigh"), np.array([0.45, 0.3])
    shape = SolvedShape(names, lengths_m, 0.1 * lengths_m, expected_m, offsets_m, 0.1 + offsets_m, 0 * offsets_m)
    motion = replace(small_trajectory, solution=replace(small_trajectory.solution, shape=shape))
    tables.write_tables(motion, tmp_path)
    table = read_csv(tmp_path / "shape.csv")
    assert table["quantity"].tolist() == ["length"] * 2 + ["offset"] * 3 * J
    assert table.iloc[1][["name", "value_m", "sigma_m", "expected_m"]].tolist() == ["l_thigh", 0.25, 0.025, 0.3]
    assert table["name"].tolist()[2:5] == [small_trajectory.joints[0]] * 3
    np.testing.assert_allclose(table["value_m"][2:], offsets_m.ravel())
    section = build_report(motion)["size"]["shape"]
    assert (section["lengths"], section["length_sigma"]) == (2, pytest.approx(0.1))
    motion.save(tmp_path / "motion")
    np.testing.assert_array_equal(Motion.load(tmp_path / "motion").solution.shape.offsets_m, offsets_m)


def test_every_camera_has_its_table(two_cameras, tmp_path):
    write_tables(two_cameras, tmp_path)
    names = {path.name for path in tmp_path.glob("reprojection*")}
    assert names == {"reprojection_cam1.csv", "reprojection_cam2.csv"} == {*tables.reprojection_files(tmp_path)}
    for picture in two_cameras.pictures:
        table = read_keypoints(tmp_path / f"reprojection_{picture.name}.csv")
        np.testing.assert_allclose(table.xy_px, picture.reprojected_px, **within(tables.PIXEL))
    quality = read_csv(tmp_path / "quality.csv")
    assert quality["detections"].tolist() == two_cameras.detections.tolist()
    np.testing.assert_allclose(quality["mean_weight"], two_cameras.mean_weight, **within(tables.SHARE))


def test_files_of_cameras_with_any_names():
    assert tables.camera_files(["x/y"]) == ["reprojection.csv"]
    assert tables.camera_files(["x/y", "x y", "", "Cam", "cam"]) == [
        "reprojection_x-y.csv",
        "reprojection_x-y-2.csv",
        "reprojection_3.csv",
        "reprojection_Cam.csv",
        "reprojection_cam-5.csv",
    ]
