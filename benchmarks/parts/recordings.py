"""Find recordings, which are not part of the project, and the settings with which their clips are fitted."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from recon import Camera, FitSettings, read_camera, read_pose3d
from recon.base.arrays import Array, Integers


def recordings(kind: str) -> Path:
    """Return the folder of a kind of recordings, such as cheetah-runs, in $RECON_SHARED_DATA or ../shared/data."""
    default = Path(__file__).resolve().parents[3] / "shared" / "data"
    return Path(os.environ.get("RECON_SHARED_DATA", default)) / kind


@cache
def meta_of(run: Path) -> dict[str, Any]:
    """Return the content of a run's meta.json: frame rate, numbers of the cameras, and subject."""
    return json.loads((run / "meta.json").read_text(encoding="utf-8"))


def camera_of(run: Path, name: str) -> Camera:
    """Read a camera of a run, whose cameras are in one file scene.json, or each in a file of its own."""
    scene = run / "scene.json"
    return read_camera(scene, name) if scene.is_file() else read_camera(run / f"{name}.toml")


def truth_at(run: Path, frames: Integers, names: Sequence[str]) -> Array:
    """Read the true positions (T, J, 3) of a run's joints in some frames, world, metres, NaN if unknown."""
    truth = read_pose3d(run / "truth.csv")
    row_of = {int(frame): row for row, frame in enumerate(truth.frames)}
    rows = [row_of.get(int(frame), -1) for frame in frames]
    joints_m = truth.xyz_m[:, [truth.names.index(name) for name in names]]
    return np.concatenate([joints_m, np.full_like(joints_m[:1], np.nan)])[rows]


def rat_poses() -> tuple[list[str], Array]:
    """Return the names of a recorded rat's points, and their positions (T, K, 3), metres."""
    table = pd.read_csv(recordings("rat-poses") / "rat23.csv", index_col="frame")
    names = [column.removesuffix("_x") for column in table.columns[::3]]
    return names, table.to_numpy().reshape(len(table), -1, 3) / 1000


def fit_settings(run: Path, cameras: Sequence[int], **options: Any) -> FitSettings:
    """Return the settings with which the clip of some cameras of a run is fitted, without further knowledge.

    `options` are further settings, which may replace the others.
    """
    names, scene = tuple(f"cam{camera}" for camera in cameras), run / "scene.json"
    in_scene = {"camera": (scene,), "camera_name": names}
    settings = {
        "keypoints": tuple(run / f"{name}.csv" for name in names),
        **(in_scene if scene.is_file() else {"camera": tuple(run / f"{name}.toml" for name in names)}),
        "fps": meta_of(run)["fps"],
    }
    return FitSettings(**settings | options)
