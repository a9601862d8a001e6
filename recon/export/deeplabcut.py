"""DeepLabCut's layout, CSV and H5: header rows `scorer, individuals, bodyparts, coords`, one row for each frame.

The scorer is `recon`, or with the frame rate, `recon_90fps`: the format has no other place for it.
"""

from __future__ import annotations

import warnings
from contextlib import closing
from pathlib import Path

import numpy as np
import pandas as pd
import tables

from recon.export.table import write_table
from recon.io.deeplabcut import SCORER
from recon.io.pose import Pose3D
from recon.keypoints import Keypoints

KEY = "df_with_missing"
ANY_PANDAS = "0.15.2"
"""As the version of pandas that wrote a file: with it, pandas 2 and 3 read it alike."""


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
    levels = [np.array(cells, dtype=object) for cells in header.values()]
    columns = pd.MultiIndex.from_arrays(levels, names=list(header))
    with warnings.catch_warnings():
        # PyTables' remark that a name of ours is no Python name, and on the width of the header.
        warnings.simplefilter("ignore")
        pd.DataFrame(values, index=frames, columns=columns).to_hdf(path, key=KEY, format="table", mode="w")
        with closing(tables.open_file(str(path), "a")) as file:
            file.get_node(f"/{KEY}")._v_attrs.pandas_version = ANY_PANDAS
