"""Find recordings, which are not part of the project, and the settings with which their clips are fitted."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import pandas as pd

from recon import FitSettings
from recon.base.arrays import Array


def recordings(kind: str) -> Path:
    """Return the folder of a kind of recordings, such as cheetah-runs, in $RECON_SHARED_DATA or ../shared/data."""
    default = Path(__file__).resolve().parents[3] / "shared" / "data"
    return Path(os.environ.get("RECON_SHARED_DATA", default)) / kind


@cache
def meta_of(run: Path) -> dict[str, Any]:
    """Return the content of a run's meta.json: frame rate, numbers of the cameras, and subject."""
    return json.loads((run / "meta.json").read_text(encoding="utf-8"))


def rat_poses() -> tuple[list[str], Array]:
    """Return the names of a recorded rat's points, and their positions (T, K, 3), metres."""
    table = pd.read_csv(recordings("rat-poses") / "rat23.csv", index_col="frame")
    names = [column.removesuffix("_x") for column in table.columns[::3]]
    return names, table.to_numpy().reshape(len(table), -1, 3) / 1000


def fit_settings(run: Path, cameras: Sequence[int], **options: Any) -> FitSettings:
    """Return the settings with which the clip of some cameras of a run is fitted, without further knowledge.

    The cameras are in one file scene.json, or each in a file of its own. `options` are further settings.
    """
    names, scene = tuple(f"cam{camera}" for camera in cameras), run / "scene.json"
    in_scene = {"camera": (scene,), "camera_name": names}
    return FitSettings(
        keypoints=tuple(run / f"{name}.csv" for name in names),
        **(in_scene if scene.is_file() else {"camera": tuple(run / f"{name}.toml" for name in names)}),
        fps=meta_of(run)["fps"],
        **options,
    )
