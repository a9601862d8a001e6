"""DeepLabCut's layout, CSV and H5: header rows `scorer, individuals, bodyparts, coords`, one row for each frame.

The scorer is `recon`, or with the frame rate, `recon_90fps`: the format has no other place for it.
"""

from __future__ import annotations

import io
import pickle
from pathlib import Path
from typing import Any

import numpy as np

from recon.export.table import write_table
from recon.io.deeplabcut import SCORER
from recon.io.pose import Pose3D
from recon.keypoints import Keypoints

KEY = "df_with_missing"
ANY_PANDAS = "0.15.2"
"""As the version of pandas that wrote a file: with it, pandas 2 and 3 read it alike."""
BLOCK = "values_block_0"
MAX_SMALL_ATTRIBUTE = 60_000
"""Bytes; larger ones need HDF5's format of version 1.8."""


def write_keypoints_csv(keypoints: Keypoints, path: Path) -> None:
    header, values = _keypoints(keypoints)
    write_table(path, [[level, *cells] for level, cells in header.items()], keypoints.frames, values)


def write_keypoints_h5(keypoints: Keypoints, path: Path) -> None:
    header, values = _keypoints(keypoints)
    _write_h5(path, header, keypoints.frames, values)


def write_pose_csv(pose: Pose3D, path: Path) -> None:
    """x, y, z in metres, z up."""
    header, values = _pose(pose)
    write_table(path, [[level, *cells] for level, cells in header.items()], pose.frames, values)


def write_pose_h5(pose: Pose3D, path: Path) -> None:
    """x, y, z in metres, z up."""
    header, values = _pose(pose)
    _write_h5(path, header, pose.frames, values)


def _keypoints(keypoints: Keypoints) -> tuple[dict[str, list[str]], np.ndarray]:
    """Header cells by level, and values (T, 3K)."""
    values = np.concatenate([keypoints.xy_px, keypoints.confidence[..., None]], axis=2)
    header = _header(keypoints.names, ("x", "y", "likelihood"), keypoints.fps, keypoints.individual)
    return header, values.reshape(len(keypoints.frames), -1)


def _pose(pose: Pose3D) -> tuple[dict[str, list[str]], np.ndarray]:
    return _header(pose.names, ("x", "y", "z"), pose.fps, None), pose.xyz_m.reshape(len(pose.frames), -1)


def _header(
    names: tuple[str, ...], coords: tuple[str, ...], fps: float | None, individual: str | None
) -> dict[str, list[str]]:
    n = len(names) * len(coords)
    header = {"scorer": [SCORER if fps is None else f"{SCORER}_{_shortest(fps)}fps"] * n}
    if individual is not None:
        header["individuals"] = [individual] * n
    return header | {"bodyparts": [name for name in names for _ in coords], "coords": list(coords) * len(names)}


def _shortest(fps: float) -> str:
    """Text that reads back exactly: 90, 29.97."""
    return repr(fps).removesuffix(".0")


def _write_h5(path: Path, header: dict[str, list[str]], frames: np.ndarray, values: np.ndarray) -> None:
    """As `pandas.DataFrame.to_hdf(key=KEY, format="table")` would, but without PyTables' index of the frames."""
    import h5py

    columns = list(zip(*header.values(), strict=True))
    rows = np.empty(len(frames), [("index", "<i8"), (BLOCK, "<f8", (len(columns),))])
    rows["index"], rows[BLOCK] = frames, values
    group_attributes = {
        "pandas_type": "frame_table",
        "pandas_version": ANY_PANDAS,
        "encoding": "UTF-8",
        "errors": "strict",
        "table_type": "appendable_frame",
        "index_cols": [(0, "index")],
        "values_cols": [BLOCK],
        "data_columns": [],
        "non_index_axes": [(1, columns)],
        "nan_rep": "nan",
        "levels": 1,
        "info": {1: {"names": list(header), "type": "MultiIndex"}, "index": {}},
    }
    table_attributes = {
        "CLASS": "TABLE",
        "VERSION": "2.7",
        "FIELD_0_NAME": "index",
        "FIELD_1_NAME": BLOCK,
        "FIELD_0_FILL": 0,
        "FIELD_1_FILL": 0.0,
        "NROWS": len(frames),
        "index_kind": "integer",
        f"{BLOCK}_dtype": "float64",
        f"{BLOCK}_kind": columns,
        f"{BLOCK}_meta": None,
    }
    large = len(pickle.dumps(columns, 0)) > MAX_SMALL_ATTRIBUTE
    content = io.BytesIO()
    with h5py.File(content, "w", libver=("v108", "latest") if large else ("earliest", "latest")) as file:
        _describe(file, {"CLASS": "GROUP", "VERSION": "1.0", "PYTABLES_FORMAT_VERSION": "2.1"})
        group = file.create_group(KEY)
        _describe(group, {"CLASS": "GROUP", "VERSION": "1.0", **group_attributes})
        _describe(group.create_dataset("table", data=rows, chunks=True, maxshape=(None,)), table_attributes)
    path.write_bytes(content.getvalue())


def _describe(holder: Any, attributes: dict[str, Any]) -> None:
    """Attributes as PyTables has them: texts and numbers as they are, everything else pickled."""
    import h5py

    holder.attrs["TITLE"] = h5py.Empty("S1")
    for name, value in attributes.items():
        if isinstance(value, str):
            text = value.encode()
            holder.attrs.create(name, np.array(text), dtype=h5py.string_dtype("utf-8", len(text)))
        elif isinstance(value, int | float):
            holder.attrs[name] = value
        else:
            holder.attrs[name] = np.bytes_(pickle.dumps(value, 0))
