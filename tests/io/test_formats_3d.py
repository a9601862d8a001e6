"""Test the reading of 3D points in TRC, C3D, BVH, npz and Parquet files of other programs."""

from __future__ import annotations

import struct
import warnings

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from command_line import refusal, says
from format_files import NAN, refuses, save

from recon.io.positions import read_pose3d


def test_real_trc(shared_data):
    """A real TRC file has commas instead of tabs, millimetres, and fewer frames than its header states."""
    path = shared_data / "importer-files" / "c3d-trc" / "markers.trc"
    pose = read_pose3d(path, up="z")
    table = pd.read_csv(path, skiprows=6, header=None)
    assert pose.names[:2] == ("ASISl", "ASISr")
    assert (len(pose.names), pose.fps, pose.frames[0], len(pose.frames)) == (51, 100, 1, 93)
    np.testing.assert_allclose(pose.xyz_m.reshape(93, -1), table.to_numpy()[:, 2:155] / 1000)
    assert [says(note, "652 frames", 93) for note in pose.notes] == [True]
    assert says(read_pose3d(path).notes[1], "way is up")
    # with y up, which is wrong for this file, its y becomes z
    np.testing.assert_array_equal(read_pose3d(path).xyz_m[..., 2], pose.xyz_m[..., 1])


def c3d_bytes(processor: int, integers: bool) -> bytes:
    """Return a C3D file of frames 5 and 6 with two points and one analog channel.

    `processor` is 84 for Intel or 86 for MIPS. The second point is missing in the first frame.
    """
    order = ">" if processor == 86 else "<"

    def floats(*values: float) -> bytes:
        return struct.pack(f"{order}{len(values)}f", *values)

    def words(*values: int) -> bytes:
        return struct.pack(f"{order}{len(values)}h", *values)

    def record(name: str, group: int, rest: bytes) -> bytes:
        return struct.pack("bb", len(name), group) + name.encode() + words(2 + len(rest)) + rest

    scale = 0.5 if integers else -1.0
    records = record("POINT", -1, b"\0") + record("RATE", 1, b"\4\0" + floats(50.0) + b"\0")
    records += record("LABELS", 1, b"\xff\2\4\2" + b"noseear " + b"\0") + record("UNITS", 1, b"\xff\1\2mm\0")
    records += record("SCALE", 1, b"\4\0" + floats(scale) + b"\0") + record("Y_SCREEN", 1, b"\xff\1\2+Y\0")
    section = (bytes([1, 0x50, 1, processor]) + records).ljust(512, b"\0")
    header = bytes([2, 0x50]) + words(2, 1, 5, 6, 0) + floats(scale) + words(3, 1) + floats(50.0)
    rows = [(2, 4, 6, 0, 0, 0, 0, -1, 9), (8, 10, 12, 0, 14, 16, 18, 0, 9)]
    data = b"".join(words(*row) if integers else floats(*row) for row in rows)
    return header.ljust(512, b"\0") + section + data


@pytest.mark.parametrize("integers", [False, True])
@pytest.mark.parametrize("processor", [84, 86])
def test_c3d_of_other_processors(tmp_path, processor, integers):
    path = tmp_path / "a.c3d"
    path.write_bytes(c3d_bytes(processor, integers))
    pose = read_pose3d(path)
    assert (pose.names, pose.fps, pose.frames.tolist()) == (("nose", "ear"), 50.0, [4, 5])
    scale = 0.5 if integers else 1.0
    # y up: x forwards, y up, z right becomes x, -z, y
    expected = np.array([[[2, -6, 4], [NAN, NAN, NAN]], [[8, -12, 10], [14, -18, 16]]]) * scale / 1000
    np.testing.assert_allclose(pose.xyz_m, expected, rtol=1e-6)
    whole = c3d_bytes(processor, integers)
    path.write_bytes(whole[:-1])
    with refusal((path, "content", f"{len(whole) - 1} of the {len(whole)} bytes")):
        read_pose3d(path)


def test_real_c3d(shared_data):
    import ezc3d

    path = shared_data / "importer-files" / "c3d-trc" / "markers_analogs.c3d"
    pose = read_pose3d(path)
    raw = ezc3d.c3d(str(path))
    assert pose.names == tuple(raw["parameters"]["POINT"]["LABELS"]["value"])
    assert (pose.fps, pose.frames[0], len(pose.frames)) == (100, 0, 580)
    np.testing.assert_allclose(pose.xyz_m, raw["data"]["points"][:3].transpose(2, 1, 0) / 1000)
    missing = raw["data"]["meta_points"]["residuals"][0].T < 0
    assert missing.sum() == 305
    np.testing.assert_array_equal(np.isnan(pose.xyz_m[..., 0]), missing)


BVH = """\
HIERARCHY
ROOT hips
{
  OFFSET 0.0 1.0 0.0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT knee
  {
    OFFSET 0.0 -2.0 0.0
    CHANNELS 3 Zrotation Xrotation Yrotation
    End Site
    {
      OFFSET 1.0 0.0 0.0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 0 0 0 0 0 0 0 0
1 2 3 90 0 0 0 90 0
"""


def test_bvh_by_hand(tmp_path):
    """Positions of a BVH file agree with positions computed by hand.

    At rest the knee is 2 below the hips, and its end is 1 from the knee along x. In the second frame the hips, at (1,
    2, 3), turn by 90 degrees about z, so that -y becomes x, and the knee is at (3, 2, 3). A turn of the knee about its
    own x axis does not move its end, which lies on that axis.
    """
    pose = read_pose3d(save(tmp_path / "a.bvh", BVH), unit="m", up="z")
    assert pose.names == ("hips", "knee", "knee_end")
    expected = [[[0, 0, 0], [0, -2, 0], [1, -2, 0]], [[1, 2, 3], [3, 2, 3], [3, 3, 3]]]
    np.testing.assert_allclose(pose.xyz_m, expected, atol=1e-12)
    assert pose.fps == pytest.approx(30, rel=1e-5)
    assert pose.edges == (("hips", "knee"), ("knee", "knee_end"))
    refuses(tmp_path / "a.bvh", ("unit", "no unit", "m, cm, mm (--unit)"), read=read_pose3d)
    centimetres = read_pose3d(tmp_path / "a.bvh", unit="cm")
    np.testing.assert_allclose(centimetres.xyz_m[1, 1], [0.03, -0.03, 0.02])
    assert says(centimetres.notes[0], "with y up")


def test_bvh_against_another_reader(tmp_path):
    rows = np.random.default_rng(0).uniform(-180, 180, (20, 9))
    head = BVH[: BVH.index("Frames:")].replace(
        "Zrotation Xrotation Yrotation\n    End", "Yrotation Zrotation Xrotation\n    End"
    )
    numbers = "\n".join(" ".join(map(str, row)) for row in rows)
    path = save(tmp_path / "a.bvh", f"{head}Frames: 20\nFrame Time: 0.01\n{numbers}\n")
    pose = read_pose3d(path, unit="m", up="z")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its dependencies raise warnings
        bvhio = pytest.importorskip("bvhio")
        root = bvhio.readAsHierarchy(str(path))
    for t in range(20):
        root.loadPose(t)
        for j, (joint, _, _) in enumerate(root.layout()):
            assert joint.Name == pose.names[j]
            np.testing.assert_allclose(pose.xyz_m[t, j], tuple(joint.PositionWorld), atol=1e-4)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (("Frames: 2", "Frames: 3"), ("MOTION", "2 rows, but Frames: 3")),
        (("1 2 3 90 0 0 0 90 0", "1 2 3 90"), ("line 20", "4 cells", 9)),
        (("Frame Time: 0.0333333", "Frame Time: 0"), ("Frame Time", 0, "above 0")),
        (("1 2 3 90 0 0 0 90 0", "1 2 3 90 0 0 0 90 x"), ("line 20, knee Yrotation", "'x'", "number")),
        (("CHANNELS 3 Zrotation", "CHANNELS 3 Zscale"), ("content", ["Zscale", "hierarchy"])),
        (("OFFSET 1.0 0.0 0.0", "OFFSET 1.0"), ("content", ["'OFFSET 1.0'", "hierarchy"])),
        (("MOTION", ""), ("content", ["'Frames: 2'", "hierarchy"])),
        (("JOINT knee", "JOINT hips"), ("names of points", "'hips'", "unique")),
        (("Frames: 2", "Frames: 0_2"), ("MOTION", "2 rows, but Frames: 0")),
    ],
)
def test_bvh_problems(tmp_path, change, expected):
    assert change[0] in BVH
    refuses(save(tmp_path / "a.bvh", BVH.replace(*change)), expected, read=read_pose3d)


TRC = """\
PathFileType\t4\t(X/Y/Z)\ta.trc
DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\tOrigDataRate\tOrigDataStartFrame\tOrigNumFrames
50\t50\t2\t2\tmm\t50\t1\t2
Frame#\tTime\ta\t\t\tb\t\t
\t\tX1\tY1\tZ1\tX2\tY2\tZ2
1\t0\t1\t2\t3\t\t\t
2\t0.02\t4\t5\t6\t7\t8\t9
"""


def test_trc(tmp_path):
    pose = read_pose3d(save(tmp_path / "a.trc", TRC))
    assert (pose.names, pose.frames.tolist(), pose.fps) == (("a", "b"), [1, 2], 50)
    expected = np.array([[[1, -3, 2], [NAN] * 3], [[4, -6, 5], [7, -9, 8]]]) / 1000
    np.testing.assert_allclose(pose.xyz_m, expected)
    with refusal((tmp_path / "a.trc", "unit", ["m as given", "mm in"])):
        read_pose3d(tmp_path / "a.trc", unit="m")


def test_trc_problems_come_together(tmp_path):
    text = TRC.replace("\tmm\t", "\tin\t").replace("50\t50\t2\t2", "x\t50\t2\t3").replace("\n1\t0\t1", "\nI\t0\tone")
    cells = ("line 6, Frame#", "'I'"), ("line 6, a X", "'one'")
    refuses(save(tmp_path / "a.trc", text), *cells, read=read_pose3d)
    text = TRC.replace("\tmm\t", "\tin\t").replace("50\t50\t2\t2", "x\t50\t2\t3")
    refuses(save(tmp_path / "a.trc", text), ("unit", "in", "m, cm, mm (--unit)"), read=read_pose3d)
    refuses(save(tmp_path / "a.trc", TRC[:-4]), ("line 7", "7 cells", 8), read=read_pose3d)


def test_npz_problems(tmp_path):
    np.savez(tmp_path / "a.npz", xyz_m=np.zeros((2, 1, 3)), names=np.array([1]), frames=np.arange(2), fps=1.0)
    refuses(tmp_path / "a.npz", ("content", "without 'edges'", "NPZ"), read=read_pose3d)
    np.savez(
        tmp_path / "b.npz",
        xyz_m=np.zeros((2, 1, 3)),
        names=np.array(["a"]),
        frames=np.array([3, 3]),
        fps=1.0,
        edges=np.zeros((1, 2), int),
    )
    refuses(tmp_path / "b.npz", ("frames", "3 after 3", "increasing"), read=read_pose3d)


def test_parquet_of_other_programs(tmp_path):
    table = pd.DataFrame({"frame": [1, 2], "nose_x_mm": [1.0, NAN], "nose_y_mm": [2.0, NAN], "nose_z_mm": [3.0, NAN]})
    table.to_parquet(tmp_path / "a.parquet")
    np.testing.assert_allclose(read_pose3d(tmp_path / "a.parquet").xyz_m[:, 0], [[0.001, 0.002, 0.003], [NAN] * 3])
    table.drop(columns="nose_z_mm").to_parquet(tmp_path / "b.parquet")
    long = pd.DataFrame({"frame": [0, 0, 1, 1], "joint": ["nose", "tail"] * 2, "x_m": range(4), "y_m": 1.0, "z_m": 2.0})
    for kind in ("category", "large_string[pyarrow]", "string_view[pyarrow]"):
        try:
            long.astype({"joint": kind}).to_parquet(tmp_path / "long.parquet")
        except pa.ArrowNotImplementedError:  # old versions cannot write string_view
            continue
        found = read_pose3d(tmp_path / "long.parquet")
        assert found.names == ("nose", "tail")
        np.testing.assert_array_equal(found.xyz_m[:, :, 0], [[0, 1], [2, 3]])
    refuses(tmp_path / "b.parquet", ("coords", "no z (Parquet)", "x, y, z"), read=read_pose3d)
