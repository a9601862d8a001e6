"""Test that hostile files run no code and take little memory, and that each gives a clear message."""

from __future__ import annotations

import errno
import json
import os
import pickle
import sys
import tracemalloc
import warnings
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from importlib import resources
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZIP_DEFLATED, ZIP_LZMA, ZipFile

import h5py
import numpy as np
import pandas as pd
import pytest
from command_line import refusal, says
from typer.testing import CliRunner

from recon import InputError
from recon.animal.naming import load_names
from recon.animal.prior import load_prior
from recon.animal.skeleton_file import load_skeleton
from recon.calibrate.camera_motion.level import read_marks
from recon.cli.app import app, main
from recon.clip import Keypoints
from recon.io.camera_track import read_camera_track
from recon.io.formats import read_keypoints
from recon.io.hdf5_poses import plain_pickle, write_deeplabcut, write_movement, write_nwb
from recon.io.positions import read_pose3d
from recon.keypoint_net.labels import read_label_file

CLIP = Keypoints(("nose", "tail"), np.arange(12.0).reshape(3, 2, 2), np.ones((3, 2)), np.arange(3), fps=50.0)


@dataclass(frozen=True)
class Touch:
    """Object that creates a file when it is unpickled."""

    path: str

    def __reduce__(self):
        return os.system, (f"touch '{self.path}'",)


def harm(marker: Path) -> np.bytes_:
    """Return a pickle that creates the file `marker` when it is read, as PyTables would store it in an attribute."""
    return np.bytes_(pickle.dumps(Touch(str(marker)), 0))


def attribute_of(where: str, name: str) -> Callable[[Path, Path], None]:
    """Return a function that writes DeepLabCut's table with a pickle in one attribute."""

    def make(path: Path, marker: Path) -> None:
        write_deeplabcut(CLIP, path)
        with h5py.File(path, "a") as file:
            file[where].attrs[name] = harm(marker)

    return make


def object_cells(path: Path, marker: Path) -> None:
    columns = pd.MultiIndex.from_product([["nose"], ["x", "y"]], names=["bodyparts", "coords"])
    cells = pd.DataFrame([[1.0, 2.0]], columns=columns).astype(object)
    cells.iloc[0, 0] = Touch(str(marker))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # pandas warns that it pickles
        cells.to_hdf(path, key="a", format="fixed")


def in_netcdf(path: Path, marker: Path) -> None:
    write_movement(CLIP, path)
    with h5py.File(path, "a") as file:
        for holder in (file, file["position"]):
            holder.attrs["CLASS"] = harm(marker)
            holder.attrs["fps"] = harm(marker)


def in_nwb(path: Path, marker: Path) -> None:
    write_nwb(CLIP, path)
    with h5py.File(path, "a") as file:
        for holder in (file, file["processing"]):
            holder.attrs["CLASS"] = harm(marker)
            holder.attrs["comments"] = harm(marker)


HOSTILE: dict[str, Callable[[Path, Path], None]] = {
    "root.h5": attribute_of("/", "FILTERS"),
    "group.h5": attribute_of("df_with_missing", "pandas_type"),
    "dataset.h5": attribute_of("df_with_missing/table", "CLASS"),
    "labels.h5": attribute_of("df_with_missing", "non_index_axes"),
    "cells.h5": object_cells,
    "attributes.nc": in_netcdf,
    "attributes.nwb": in_nwb,
}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_hdf5_runs_nothing(tmp_path, name):
    marker, path = tmp_path / "ran", tmp_path / name
    HOSTILE[name](path, marker)
    with suppress(InputError):
        read_keypoints(path)
    assert not marker.exists()


def test_the_hostile_files_are_hostile(tmp_path):
    """PyTables runs the code in the hostile files, so the test of recon's readers can fail."""
    ran = []
    for name in ("root.h5", "group.h5", "labels.h5", "cells.h5"):
        marker, path = tmp_path / f"ran-{name}", tmp_path / name
        HOSTILE[name](path, marker)
        tables = pytest.importorskip("tables")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with tables.open_file(str(path)) as file:
                for node in file.walk_nodes():
                    [node._v_attrs[attribute] for attribute in node._v_attrs._f_list("all")]
                    if isinstance(node, tables.VLArray):
                        node[:]
        ran.append(marker.exists())
    assert ran == [True] * 4


def test_hostile_hdf5_in_a_batch(tmp_path):
    marker, clips = tmp_path / "ran", tmp_path / "clips"
    clips.mkdir()
    for name, make in HOSTILE.items():
        make(clips / name, marker)
    result = CliRunner().invoke(
        app,
        ["batch", str(clips), "--hfov-deg", "60", "--image-size", "640x480", "--out", str(tmp_path / "o"), "--dry-run"],
    )
    assert result.exit_code in (0, 1, 2), result.output
    assert not marker.exists()


def test_pickled_objects_are_named(tmp_path):
    HOSTILE["labels.h5"](tmp_path / "a.h5", tmp_path / "ran")
    with refusal((tmp_path / "a.h5", "content", ["non_index_axes", "GLOBAL posix system"])):
        read_keypoints(tmp_path / "a.h5")


@pytest.mark.parametrize("protocol", range(6))
def test_plain_pickles(protocol):
    value = {1: {"names": ["a", "ä"], "none": None, "numbers": [1, -5, 2**70, 3.5, True]}, "labels": [("a",) * 5, ()]}
    assert plain_pickle(pickle.dumps(value, protocol)) == value
    for other in (Touch("x"), {1}, 1j, np.float64(3), len, [Touch("x")]):
        with pytest.raises(ValueError, match="a pickled Python object"):
            plain_pickle(pickle.dumps(other, protocol))


@pytest.mark.parametrize("content", [b"", b".", b"(", b"l.", b"N", b"g1\n.", b"I1\n0.", b"(I1\nd.", b"Na."])
def test_damaged_pickles(content):
    with pytest.raises(ValueError):  # noqa: PT011 (in its own or in pickletools' words)
        plain_pickle(content)


def test_small_file_that_asks_for_terabytes(tmp_path):
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("tracks", (1, 2, 10**6, 300_000), "f8", chunks=(1, 2, 100, 100), compression="gzip")
        file["node_names"] = np.array([b"a"])
    assert path.stat().st_size < 10_000
    with refusal((path, "content", ["/tracks", "4.8e+12 bytes"])):
        read_keypoints(path)


def test_data_that_unpack_to_more_than_any_clip_has(tmp_path, monkeypatch):
    monkeypatch.setattr("recon.io.hdf5.FREE_BYTES", 1000)
    monkeypatch.setattr("recon.io.hdf5.MAX_UNPACKED", 1 << 22)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("tracks", data=np.zeros((1, 2, 1, 300_000)), chunks=(1, 2, 1, 10**5), compression="gzip")
        file["node_names"] = np.array([b"a"])
    with refusal((tmp_path / "a.h5", "content", ["/tracks", "4.8e+06 bytes"])):
        read_keypoints(tmp_path / "a.h5")


def test_a_deeply_nested_key_of_toml_is_refused(tmp_path):
    (tmp_path / "a.toml").write_text(".".join("a" * 100_000) + " = 1\n")
    with refusal((tmp_path / "a.toml", "content", "nested too deeply")):
        load_skeleton(tmp_path / "a.toml")


def archive_of(path: Path, header: bytes | None = None, size_mb: int = 0, method: int = ZIP_DEFLATED) -> Path:
    """Write an archive of positions with a broken header, or one that is very large when unpacked."""
    with ZipFile(path, "w", method, compresslevel=1) as archive, archive.open("xyz_m.npy", "w") as member:
        if header is None:
            of = {"descr": "<f8", "fortran_order": False, "shape": (size_mb << 17,)}
            np.lib.format.write_array_header_1_0(member, of)
        else:
            member.write(b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header)
        for _ in range(size_mb):
            member.write(bytes(1 << 20))
    return path


@pytest.mark.parametrize("read", [read_pose3d, lambda path: load_prior(path, load_skeleton("cheetah-24"))])
def test_archives_that_ask_for_the_memory_or_have_no_header(read, tmp_path, monkeypatch):
    monkeypatch.setattr("recon.base.documents.MAX_UNPACKED", 1 << 22)
    field = "content" if read is read_pose3d else "file"
    with refusal((tmp_path / "bomb.npz", field, "5 MB")):
        read(archive_of(tmp_path / "bomb.npz", size_mb=5))
    with refusal((tmp_path / "header.npz", field, "multi-line statement")):
        read(archive_of(tmp_path / "header.npz", b"{'descr': '<f8', 'shape': (3,\n"))
    archive_of(tmp_path / "other.npz", b"{}", method=ZIP_LZMA)
    with refusal((tmp_path / "other.npz", field, "compressed in a way that NumPy")):
        read(tmp_path / "other.npz")


def test_an_archive_that_states_another_size_is_unpacked_no_further(tmp_path):
    content = bytearray(archive_of(tmp_path / "a.npz", size_mb=100).read_bytes())
    at = content.rfind(b"PK\x01\x02") + 24
    content[at : at + 4] = (1000).to_bytes(4, "little")
    (tmp_path / "a.npz").write_bytes(content)
    tracemalloc.start()
    with refusal((tmp_path / "a.npz", "content", "CRC")):
        read_pose3d(tmp_path / "a.npz")
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < 10e6


def test_a_table_of_equal_rows_that_asks_for_the_memory(tmp_path, monkeypatch):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    columns = {name: np.zeros(10_000) for name in ("frame", "x_m", "y_m", "z_m")}
    parquet.write_table(arrow.table({"joint": ["a"] * 10_000, **columns}), tmp_path / "equal.parquet")
    monkeypatch.setattr("recon.io.columns.VALUES_MAX", 40_000)
    with refusal((tmp_path / "equal.parquet", "content", "10000 rows of 5 columns")):
        read_pose3d(tmp_path / "equal.parquet")
    row = {"frame": [0], "joint": ["a" * 10**7], "x_m": [0.0], "y_m": [0.0], "z_m": [0.0]}
    parquet.write_table(arrow.table(row), tmp_path / "text.parquet", compression="zstd")
    monkeypatch.setattr("recon.io.columns.MAX_UNPACKED", 10**7)
    with refusal((tmp_path / "text.parquet", "content", "1 rows of 5 columns, 9 MB")):
        read_pose3d(tmp_path / "text.parquet")


def test_a_text_in_every_row_takes_memory_once(tmp_path):
    arrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    rows = 20_000
    joints = arrow.DictionaryArray.from_arrays(arrow.array(np.zeros(rows, np.int32)), arrow.array(["x" * 20_000 + " "]))
    columns = {name: np.zeros(rows) for name in ("x_m", "y_m", "z_m")}
    parquet.write_table(
        arrow.table({"frame": np.arange(rows), "joint": joints, **columns}), tmp_path / "a.parquet", store_schema=False
    )
    assert (tmp_path / "a.parquet").stat().st_size < 500_000
    before = arrow.default_memory_pool().max_memory()
    assert read_pose3d(tmp_path / "a.parquet").names == ("x" * 20_000,)
    assert arrow.default_memory_pool().max_memory() - before < 50e6  # 400 MB if the text were stored in every row


def many_names(folder: Path) -> dict[str, Path]:
    """Write small files of 50 frames of 50 points each, which are nearly empty."""
    names = [f"p{i}" for i in range(50)]
    content = {
        "long.csv": "frame,bodypart,x,y\n" + "".join(f"{i},{name},1,2\n" for i, name in enumerate(names)),
        "coco.json": json.dumps(
            {
                "images": [{"id": i, "frame_id": i} for i in range(50)],
                "annotations": [],
                "categories": [{"id": 1, "keypoints": names}],
            }
        ),
        "mmpose.json": json.dumps(
            {
                "meta_info": {"keypoint_id2name": dict(enumerate(names))},
                "instance_info": [{"frame_id": i, "instances": []} for i in range(50)],
            }
        ),
        "fmpose3d.json": json.dumps({"model": "m", "bodyparts": names, "poses_3d": [[]] * 50}),
        "a.bvh": "HIERARCHY\nROOT r\n{\nOFFSET 0 0 0\nCHANNELS 1 Xrotation\n"
        + "".join(f"JOINT {name}\n{{\nOFFSET 1 0 0\n}}\n" for name in names)
        + "}\nMOTION\nFrames: 50\nFrame Time: 0.1\n"
        + "0\n" * 50,
    }
    for name, text in content.items():
        (folder / name).write_text(text)
    write_nwb(Keypoints(("nose",), np.zeros((50, 1, 2)), np.ones((50, 1)), np.arange(50), fps=50.0), folder / "a.nwb")
    with h5py.File(folder / "a.nwb", "a") as file:
        poses: Any = file["processing/behavior/PoseEstimation"]
        for name in names:
            poses[name] = poses["nose"]
    return {name: folder / name for name in (*content, "a.nwb")}


def test_frames_times_points_that_fill_the_memory(tmp_path, monkeypatch):
    """Files of less than 1 MB with 30,000 frames of 30,000 points would take 20 GB of memory."""
    files = many_names(tmp_path)
    monkeypatch.setattr("recon.io.common.POINTS_MAX", 1000)
    for name, path in files.items():
        with refusal((path, "frames", "50 frames", "at most")):
            (read_pose3d if name in ("fmpose3d.json", "a.bvh") else read_keypoints)(path)


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("Unable to allocate 12 GiB"),
        ImportError("libarrow.so: failed to map segment from shared object"),
        RuntimeError("can't start new thread"),
        OSError(errno.ENOMEM, "Cannot allocate memory"),
    ],
)
def test_out_of_memory_is_one_line(error, monkeypatch, capsys):
    def starved() -> None:
        raise error

    monkeypatch.setattr("recon.cli.app.app", starved)
    monkeypatch.setattr("os._exit", sys.exit)
    with pytest.raises(SystemExit) as stopped:
        main()
    assert stopped.value.code == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert says(line, "not enough memory", str(error), "--frames")


@pytest.mark.parametrize("read", [read_keypoints, read_label_file, read_marks, load_names, read_camera_track])
def test_a_cell_that_is_too_long(read, tmp_path):
    (tmp_path / "long.csv").write_text(f"scorer,a\n{'1' * 131_073},2\n")
    with pytest.raises(InputError):
        read(tmp_path / "long.csv")


def test_an_endless_heap_of_texts_is_refused(tmp_path):
    """A heap of texts in which the HDF5 library would search for the next object for ever is refused."""
    write_movement(CLIP, tmp_path / "a.nc")
    content = bytearray((tmp_path / "a.nc").read_bytes())
    heap = content.index(b"GCOL")
    content[heap + 24 : heap + 32] = (2**64 - 16).to_bytes(8, "little")  # the first object's size
    (tmp_path / "a.nc").write_bytes(content)
    with refusal((tmp_path / "a.nc", "content", "damaged heap")):
        read_keypoints(tmp_path / "a.nc")


def test_data_in_other_files_are_refused(tmp_path):
    """A file must not determine which other files are opened."""
    (tmp_path / "secret").write_bytes(np.arange(30.0).tobytes())
    path = tmp_path / "a.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("tracks", (1, 2, 1, 5), "f8", external=[(str(tmp_path / "secret"), 0, 80)])
        file["node_names"] = np.array([b"a"])
    with refusal((path, "content", ["/tracks", "another file"])):
        read_keypoints(path)
    with h5py.File(path, "w") as file:
        file["tracks"] = h5py.ExternalLink(str(tmp_path / "other.h5"), "/tracks")
        file["node_names"] = np.array([b"a"])
    with refusal((path, "content", "'tracks'", "SLEAP analysis H5")):
        read_keypoints(path)


def test_hostile_network_runs_nothing(tmp_path):
    torch = pytest.importorskip("torch")
    from recon.keypoint_net.network import load_model

    marker, path = tmp_path / "ran", tmp_path / "model.pt"
    torch.save({"format": Touch(str(marker))}, path)
    with refusal((path, "model", "torch cannot read", "recon train")):
        load_model(path, torch.device("cpu"))
    assert not marker.exists()
    torch.load(path, weights_only=False)  # the file is a valid network with a pickle
    assert marker.exists()


@pytest.mark.parametrize(
    ("change", "fields"),
    [
        ({"spec": None}, ["model"]),
        ({"spec": {}}, ["content"]),
        ({"weights": {}}, ["model"]),
        ({"weights": None}, ["model"]),
        ({"spec": {"names": 1}}, ["names", "scale", "body_length_px", "tolerance_px"]),
    ],
)
def test_altered_network(tmp_path, change, fields):
    torch = pytest.importorskip("torch")
    from recon.keypoint_net.network import FORMAT, load_model

    spec = {"names": ["a"], "scale": 0.5, "body_length_px": 9.0, "tolerance_px": 9.0}
    content = {"format": FORMAT, "spec": spec, "weights": {}} | change
    torch.save(content, tmp_path / "model.pt")
    with refusal(*((tmp_path / "model.pt", field) for field in fields)):
        load_model(tmp_path / "model.pt", torch.device("cpu"))


def test_a_skeleton_that_extends_a_name_too_long_for_a_file(tmp_path):
    (tmp_path / "a.toml").write_text(f'extends = "{"a" * 300}"\n')
    with pytest.raises(InputError, match="aaa"):
        load_skeleton(tmp_path / "a.toml")


def test_a_prior_with_signalling_nan_is_refused(tmp_path):
    """A signalling NaN of four bytes is refused, although NumPy only warns when it converts it."""
    content = resources.files("recon") / "animal" / "priors" / "running-cheetah.npz"
    with np.load(BytesIO(content.read_bytes())) as file:
        arrays = dict(file)
    name = next(name for name, array in arrays.items() if array.dtype.kind == "f" and array.size)
    arrays[name] = np.full(arrays[name].shape, 0x7FA00000, "<u4").view("<f4")
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(InputError):
        load_prior(tmp_path / "a.npz", load_skeleton("cheetah-24"))


def test_a_name_too_long_for_a_file(tmp_path):
    with refusal((tmp_path / f"{'a' * 300}.csv", "file", "cannot be read")):
        read_keypoints(tmp_path / f"{'a' * 300}.csv")
