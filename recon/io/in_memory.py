"""Keypoints from tables in memory, pandas' and movement's, by the readers of the files that hold the same."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.base.errors import InputError, Problem
from recon.clip import Keypoints
from recon.io.columns import ROLES, gathered
from recon.io.common import StoredPoints, damage_named
from recon.io.deeplabcut import Table, points_of_table
from recon.io.formats import as_keypoints
from recon.io.hdf5_poses import points_of_dataset

if TYPE_CHECKING:
    import pandas as pd

BODYPARTS = ("bodyparts", "keypoints", "bodypart", "keypoint")
INDIVIDUALS = ("individuals", "individual")


def from_dataframe(table: pd.DataFrame, fps: float | None, individual: str | None) -> Keypoints:
    """Keypoints from a pandas table; see `recon.Keypoints.from_dataframe`."""
    source = Path("DataFrame")
    with damage_named(source, "numbers, in DeepLabCut's levels or in columns frame, keypoint, x, y, confidence"):
        if table.columns.nlevels > 1:
            stored = _of_levels(source, table, individual)
        else:
            stored = gathered(source, {str(name): table[name].to_numpy() for name in table.columns}, individual, None)
    return _keypoints(source, stored, fps)


def _of_levels(source: Path, table: pd.DataFrame, individual: str | None) -> StoredPoints:
    """From DeepLabCut's levels, whose names may be missing: the last is then of the coordinates, the one before of the
    bodyparts."""
    levels = [str(name or "").lower() for name in table.columns.names]
    part = next((i for i, level in enumerate(levels) if level in BODYPARTS), len(levels) - 2)
    animal = next((i for i, level in enumerate(levels) if level in INDIVIDUALS), None)
    labels = [
        (
            "",
            "" if animal is None else str(column[animal]),
            str(column[part]),
            "likelihood" if str(column[-1]).lower() in ROLES["likelihood"] else str(column[-1]),
        )
        for column in table.columns
    ]
    frames = table.index.to_numpy() if table.index.to_numpy().dtype.kind in "iu" else np.arange(len(table))
    names = ("scorer", "individuals", "bodyparts", "coords")
    index = [(str(frame),) for frame in frames]
    return points_of_table(source, individual, Table(names, labels, index, table.to_numpy(dtype=float)))


def from_xarray(dataset: Any, fps: float | None, individual: str | None) -> Keypoints:
    """Keypoints from movement's dataset; see `recon.Keypoints.from_xarray`."""
    source = Path("Dataset")
    with damage_named(source, "movement's poses"):
        return _keypoints(source, points_of_dataset(source, dataset, fps, individual), fps)


def _keypoints(source: Path, stored: StoredPoints, fps: float | None) -> Keypoints:
    if stored.in_space:
        raise InputError(Problem(source, "space", "x, y, z", "x, y: pixels of one camera"))
    found = as_keypoints(source, stored)
    return replace(found, fps=found.fps if fps is None else fps, source=None)
