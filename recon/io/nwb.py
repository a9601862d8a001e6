"""NWB files with the extension ndx-pose: one `PoseEstimationSeries` for each point, in one container for each animal.

They are read with h5py, by the types that the groups say they have, so that files of every version of the extension
are taken alike.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from recon.errors import InputError, Problem
from recon.io.common import choose, formats_extra, frames_of_times, hdf5_outline, name_problems, rate
from recon.io.pose import UNIT_NAMES, StoredPose
from recon.keypoints import Keypoints

RATE_TEXT = "frame number = time in seconds x {fps!r} Hz"
"""In the comments of our own series, whose times may be irregular."""
UP_TEXT = "z up"
"""At the end of the frame of reference of our own 3D series."""


@dataclass(frozen=True, eq=False)
class _Series:
    """One point: values (T, 2 or 3), confidence (T,), times_s (T,)."""

    name: str
    values: np.ndarray
    confidence: np.ndarray
    times_s: np.ndarray
    fps: float | None
    unit: str
    z_up: bool


@dataclass(frozen=True, eq=False)
class _Container:
    name: str
    series: list[_Series]
    nodes: list[str]
    edges: np.ndarray


def recognises(path: Path) -> bool:
    """Whether the file is NWB's, with poses or without."""
    return "nwb_version" in hdf5_outline(path)


def recognises_pose(path: Path) -> bool:
    """Whether all of its points are 3D."""
    return recognises(path) and all(s.values.shape[-1] == 3 for c in _load(path) for s in c.series)


def read(path: Path, individual: str | None = None) -> Keypoints:
    """The 2D keypoints of one animal, which a file of several calls by its container. Raises InputError."""
    containers = _load(path)
    container = containers[choose(path, [c.name for c in containers], individual)]
    series, frames, fps = _checked(path, container)
    if series[0].values.shape[-1] == 3:
        found = f"x, y, z in {container.name}: 3D positions"
        raise InputError(Problem(path, "data", found, "2D keypoints in pixels (x, y)"))
    named = len(containers) > 1 or not container.name.startswith("PoseEstimation")
    return Keypoints(
        tuple(s.name for s in series),
        np.stack([s.values for s in series], axis=1),
        np.stack([s.confidence for s in series], axis=1),
        frames,
        fps=fps,
        individual=container.name if named else None,
        source=str(path),
    )


def read_pose(path: Path, individual: str | None = None) -> StoredPose:
    """The 3D positions of one animal. Raises InputError."""
    containers = _load(path)
    container = containers[choose(path, [c.name for c in containers], individual)]
    series, frames, fps = _checked(path, container)
    names = tuple(s.name for s in series)
    edges = ()
    if set(container.nodes) == set(names):
        edges = tuple((container.nodes[a], container.nodes[b]) for a, b in container.edges)
    return StoredPose(
        names,
        np.stack([s.values for s in series], axis=1),
        frames,
        fps=fps,
        unit=UNIT_NAMES.get(series[0].unit),
        up="z" if series[0].z_up else None,
        edges=edges,
    )


def _load(path: Path) -> list[_Container]:
    """Every container of points. Raises InputError for a damaged file, or one without any."""
    with formats_extra(path):
        import h5py
    found: list[_Container] = []

    def visit(_: str, group: Any) -> None:
        if not isinstance(group, h5py.Group):
            return
        points = [g for g in group.values() if _type(g) == "PoseEstimationSeries"]
        if points:
            nodes, edges = _skeleton(group)
            series = [_series(path, point) for point in points]
            order = {node: i for i, node in enumerate(nodes)}
            series.sort(key=lambda s: order.get(s.name, len(order)))
            found.append(_Container(_last(group.name), series, nodes, edges))

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except InputError:
        raise
    except (OSError, KeyError, TypeError, ValueError, RuntimeError, AttributeError) as error:
        raise InputError(Problem(path, "content", f"data that cannot be read ({error})", "an undamaged file")) from None
    if not found:
        raise InputError(Problem(path, "PoseEstimationSeries", "none", "poses of the extension ndx-pose"))
    return found


def _last(name: str | None) -> str:
    return (name or "").rsplit("/", 1)[-1]


def _type(group: Any) -> str:
    return _text(group.attrs.get("neurodata_type", ""))


def _text(value: Any) -> str:
    return value.decode("utf-8") if isinstance(value, bytes) else str(value)


def _skeleton(group: Any) -> tuple[list[str], np.ndarray]:
    """Nodes and edges (E, 2) of a container's skeleton, or of the container itself, as the first version had it."""
    for holder in (group, *(g for g in group.values() if _type(g) == "Skeleton")):
        if "nodes" in holder:
            nodes = [_text(t) for t in holder["nodes"][()].tolist()]
            edges = holder["edges"][()] if "edges" in holder else np.zeros((0, 2))
            edges = np.asarray(edges, dtype=np.int64).reshape(-1, 2)
            return nodes, edges[(edges < len(nodes)).all(axis=1)]
    return [], np.zeros((0, 2), np.int64)


def _series(path: Path, group: Any) -> _Series:
    data, name = group["data"], _last(group.name)
    if data.ndim != 2 or data.shape[1] not in (2, 3) or data.dtype.kind not in "fiu":
        raise InputError(Problem(path, name, f"{data.dtype} {data.shape}", "numbers, (frames, 2) or (frames, 3)"))
    T = len(data)
    values = data[()].astype(float) * float(data.attrs.get("conversion", 1.0)) + float(data.attrs.get("offset", 0.0))
    confidence = group["confidence"][()].astype(float) if "confidence" in group else np.full(T, np.nan)
    comments = re.search(re.escape(RATE_TEXT).replace(r"\{fps!r\}", "([0-9.e+-]+)"), _text(group.attrs.get("comments")))
    fps = rate(comments[1]) if comments else None
    if "timestamps" in group:
        times_s = group["timestamps"][()].astype(float)
    else:
        fps = rate(group["starting_time"].attrs["rate"])
        times_s = float(group["starting_time"][()]) + np.arange(T) / (fps or np.nan)
    if len(confidence) != T or len(times_s) != T:
        found = f"{T} positions, {len(confidence)} confidences and {len(times_s)} times"
        raise InputError(Problem(path, name, found, "as many of each"))
    reference = _text(group["reference_frame"][()]) if "reference_frame" in group else ""
    unit = _text(data.attrs.get("unit", ""))
    return _Series(name, values, confidence, times_s, fps, unit, reference.endswith(UP_TEXT))


def _checked(path: Path, container: _Container) -> tuple[list[_Series], np.ndarray, float | None]:
    """The series of one animal with their frame numbers and rate. Raises InputError where they do not fit together."""
    series = container.series
    first = series[0]
    problems = name_problems(path, container.name, [s.name for s in series])
    for s in series:
        where = f"{container.name}/{s.name}"
        if s.values.shape[1] != first.values.shape[1]:
            found = f"{s.values.shape[1]} coordinates, and {first.values.shape[1]} in {first.name}"
            problems.append(Problem(path, where, found, "2D points or 3D points, not both"))
        if s.times_s.shape != first.times_s.shape or not np.allclose(s.times_s, first.times_s, rtol=0, atol=1e-6):
            problems.append(Problem(path, where, f"other times than in {first.name}", "one time line"))
        if np.isinf(s.values).any():
            problems.append(Problem(path, where, "infinite coordinates", "numbers, or NaN where missing"))
    if not len(first.times_s):
        problems.append(Problem(path, container.name, "no frames", "at least one"))
    if problems:
        raise InputError(problems)
    frames, fps = frames_of_times(path, first.times_s, first.fps)
    return series, frames, fps
