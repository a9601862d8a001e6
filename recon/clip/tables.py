"""Detections from tables in memory: DeepLabCut's frames, long ones, and movement's datasets."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from recon.base.errors import InputError, Problem, refuse

if TYPE_CHECKING:
    import pandas as pd

NAMES = ("keypoint", "bodypart", "bodyparts", "keypoints")
"""What the column of names, or the level of them, is called."""
CONFIDENCES = ("confidence", "likelihood")
INDIVIDUALS = ("individual", "individuals")


Found = dict[str, Any]
"""The fields of `recon.Keypoints` that a table has."""


def from_dataframe(table: pd.DataFrame, fps: float | None, individual: str | None) -> Found:
    """Keypoints from a pandas table; see `recon.Keypoints.from_dataframe`."""
    wide = _as_wide(table)
    animals = [*dict.fromkeys(animal for animal, _, _ in wide)]
    which = _chosen("DataFrame", animals, individual)
    columns = {(name, coordinate): values for (animal, name, coordinate), values in wide.items() if animal == which}
    names = tuple(dict.fromkeys(name for name, _ in columns))
    refuse(
        Problem("DataFrame", name, f"no column {axis}", "x and y of every keypoint")
        for name in names
        for axis in "xy"
        if (name, axis) not in columns
    )
    xy_px = np.stack([np.stack([columns[name, axis] for axis in "xy"], axis=-1) for name in names], axis=1)
    unknown = np.full(len(xy_px), np.nan)
    confidence = [next((columns[name, c] for c in CONFIDENCES if (name, c) in columns), unknown) for name in names]
    found = {"names": names, "xy_px": xy_px, "confidence": np.stack(confidence, axis=1), "frames": _frames(table)}
    return found | {"fps": fps, "individual": which or None}


def _as_wide(table: pd.DataFrame) -> dict[tuple[str, str, str], np.ndarray]:
    """Columns by animal, keypoint and coordinate."""
    import pandas as pd

    if isinstance(table.columns, pd.MultiIndex):
        levels = [str(name or "").lower() for name in table.columns.names]
        depth = len(levels)
        name = next((i for i, level in enumerate(levels) if level in NAMES), depth - 2)
        animal = next((i for i, level in enumerate(levels) if level in INDIVIDUALS), None)
        return {
            ("" if animal is None else str(column[animal]), str(column[name]), str(column[-1])): _floats(
                table[column].to_numpy()
            )
            for column in table.columns
        }
    given = {str(column).lower(): column for column in table.columns}
    name = next((given[n] for n in NAMES if n in given), None)
    if name is None or not {"frame", "x", "y"} <= given.keys():
        expected = "columns frame, keypoint, x, y and confidence; or DeepLabCut's levels scorer, bodyparts, coords"
        raise InputError(Problem("DataFrame", "columns", ", ".join(map(str, table.columns))[:120], expected))
    animal = next((given[n] for n in INDIVIDUALS if n in given), None)
    values = [given[n] for n in ("x", "y", *CONFIDENCES) if n in given]
    columns = [given["frame"], *([animal] if animal else []), name]
    if table.duplicated(columns).any():
        raise InputError(Problem("DataFrame", "rows", "two of one keypoint in one frame", "one each"))
    table = table.assign(**{str(column): _floats(table[column].to_numpy()) for column in values})
    wide = table.pivot_table(index=given["frame"], columns=columns[1:], values=values, dropna=False)
    return {
        (str(column[1]) if animal else "", str(column[-1]), str(column[0]).lower()): _floats(wide[column].to_numpy())
        for column in wide.columns
    }


def _frames(table: pd.DataFrame) -> np.ndarray:
    frame = next((column for column in table.columns if str(column).lower() == "frame"), None)
    index = table.index.to_numpy() if frame is None else np.unique(table[frame].to_numpy())
    return index.astype(int) if index.dtype.kind in "iu" else np.arange(len(index))


def from_xarray(dataset: Any, fps: float | None, individual: str | None) -> Found:
    """Keypoints from movement's dataset; see `recon.Keypoints.from_xarray`."""
    lacking = [name for name in ("position", "confidence") if name not in dataset.variables]
    refuse(Problem("Dataset", name, "none", "movement's poses") for name in lacking)
    position, confidence = dataset["position"], dataset["confidence"]
    which = {dim.rstrip("s"): dim for dim in position.dims}
    refuse(
        Problem("Dataset", "position", f"no dimension {dim}", "time, space, keypoints and individuals")
        for dim in ("time", "space", "keypoint", "individual")
        if dim not in which
    )
    animals = [str(animal) for animal in position[which["individual"]].to_numpy()]
    animal = animals.index(_chosen("Dataset", animals, individual))
    order = ("time", which["keypoint"], which["individual"])
    space = [str(axis) for axis in position["space"].to_numpy()]
    if space != ["x", "y"]:
        raise InputError(Problem("Dataset", "space", ", ".join(space), "x, y: pixels of one camera"))
    xy_px = _floats(position.transpose(*order, "space").to_numpy()[:, :, animal])
    likelihood = _floats(confidence.transpose(*order).to_numpy()[:, :, animal])
    fps = dataset.attrs.get("fps") if fps is None else fps
    times = position["time"].to_numpy()
    in_seconds = fps is not None and times.dtype.kind == "f" and dataset.attrs.get("time_unit") != "frames"
    frames = np.rint(times * fps if in_seconds else times).astype(int)
    names = tuple(str(name) for name in position[which["keypoint"]].to_numpy())
    found = {"names": names, "xy_px": xy_px, "confidence": likelihood, "frames": frames}
    return found | {"fps": fps, "individual": animals[animal] or None}


def _chosen(where: str, animals: list[str], individual: str | None) -> str:
    if individual is None and len(animals) == 1:
        return animals[0]
    if individual not in animals:
        found = f"{len(animals)} animals" if individual is None else f"'{individual}'"
        raise InputError(Problem(where, "individual", found, f"one of: {', '.join(animals)}"))
    return individual


def _floats(values: np.ndarray) -> np.ndarray:
    try:
        return values.astype(float)
    except (TypeError, ValueError):
        raise InputError(Problem("table", "values", f"of type {values.dtype}", "numbers")) from None
