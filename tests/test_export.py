"""Written tables read back exactly, in the layouts that others expect."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from recon.export import CLIP_OUTPUTS, angles_csv, pose3d_csv, reprojection_csv
from recon.io import read_keypoints
from recon.io.pose3d import read_pose3d


def test_pose3d_round_trip(small_motion, tmp_path):
    path = tmp_path / "pose3d.csv"
    pose3d_csv.write(small_motion, path)
    pose = read_pose3d(path)
    assert pose.names == small_motion.names
    np.testing.assert_array_equal(pose.xyz_m, small_motion.joints_m)
    np.testing.assert_array_equal(pose.frames, small_motion.frames)
    assert np.isnan(pose.xyz_m[3]).all()
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[0].startswith("bodyparts,tail_base,tail_base,tail_base,r_back_knee")
    assert lines[1].startswith("coords,x,y,z,x")
    assert lines[5] == "13" + 27 * ","
    assert len(lines) == 8


def test_angles_round_trip(small_motion, tmp_path):
    path = tmp_path / "angles.csv"
    angles_csv.write(small_motion, path)
    table = pd.read_csv(path, index_col="frame")
    assert list(table.columns[:2]) == ["theta_6_rad", "theta_7_rad"]
    assert list(table.columns[-8:]) == [
        *("phi_4_rad", "x0_m", "y0_m", "z0_m", "xi_rad", "psi_rad", "zeta_rad", "base_length_m")
    ]
    np.testing.assert_allclose(table.to_numpy(), small_motion.states, rtol=1e-15)
    np.testing.assert_array_equal(table.index, small_motion.frames)


def test_reprojection_is_a_deeplabcut_file(small_motion, tmp_path):
    path = tmp_path / "reprojection.csv"
    reprojection_csv.write(small_motion, path)
    keypoints = read_keypoints(path)
    assert keypoints.names == small_motion.names
    np.testing.assert_array_equal(keypoints.xy_px, small_motion.reprojected_px)
    np.testing.assert_array_equal(keypoints.frames, small_motion.frames)
    np.testing.assert_array_equal(keypoints.confidence, np.tile(small_motion.solved[:, None], (1, 9)).astype(float))

    table = pd.read_csv(path, header=[0, 1, 2], index_col=0)
    assert table.columns.names == ["scorer", "bodyparts", "coords"]
    np.testing.assert_allclose(table["recon", "spine", "x"], small_motion.reprojected_px[:, 4, 0], rtol=1e-15)
    np.testing.assert_array_equal(table["recon", "spine", "likelihood"], [1, 1, 1, 0, 1, 1])


@pytest.mark.parametrize("name", CLIP_OUTPUTS)
def test_every_writer_writes(name, small_motion, tmp_path):
    CLIP_OUTPUTS[name](small_motion, tmp_path / name)
    text = (tmp_path / name).read_bytes()
    assert b"\r" not in text
    assert b"nan" not in text
