"""NWB files with the extension ndx-pose: one `PoseEstimationSeries` for each point, in one container for each animal.

They are read with h5py, by the types that the groups say they have, so that files of every version of the extension
are taken alike. Ours are given 1970-01-01 as the start of their session, which NWB asks for and nobody knows here.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any
from uuid import uuid4

import h5py
import numpy as np

from recon.base.errors import InputError, Problem, refuse
from recon.base.files import write_bytes
from recon.clip.keypoints import Keypoints
from recon.io.common import choose, formats_extra, frames_of_times, name_problems, rate, require_names, required_fps
from recon.io.hdf5 import attribute, child, groups, names, numbers, opened, outline, texts
from recon.io.pose import UNIT_NAMES, Pose3D, StoredPoints, index_edges, points_of

TITLE = "ndx-pose NWB"
NO_NAMES = r"[/:]"
IN_PICTURE = "(0, 0) is the upper left corner of the picture, x to the right, y down"
RATE_TEXT = "frame number = time in seconds x {fps!r} Hz"
"""In the comments of our own series, whose times may be irregular."""
UP_TEXT = "z up"
"""At the end of the frame of reference of our own 3D series."""


@dataclass(frozen=True, eq=False)
class _PoseSeries:
    """One point in T frames."""

    name: str
    values: np.ndarray
    """(T, 2 or 3)"""
    confidence: np.ndarray
    """(T,)"""
    times_s: np.ndarray
    """(T,)"""
    fps: float | None
    unit: str
    z_up: bool


def recognises(path: Path) -> bool:
    """Whether the file is NWB's, with poses or without."""
    return "nwb_version" in outline(path)


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The points of one animal, which a file of several calls by its container. Raises InputError."""
    found: dict[str, StoredPoints | InputError] = {}
    with opened(path) as file:
        for group in groups(file):
            inside = [child(group, name) for name in names(group)]
            points = [one for one in inside if one is not None and _type(one) == "PoseEstimationSeries"]
            name = str(group.name).rsplit("/", 1)[-1]
            if points:
                try:
                    found[name] = _points(path, name, group, inside, [_series(path, point) for point in points])
                except InputError as error:  # of another animal, perhaps
                    found[name] = error
    if not found:
        raise InputError(Problem(path, "PoseEstimationSeries", "none", "poses of the extension ndx-pose"))
    chosen = [*found.values()][choose(path, [*found], individual)]
    if isinstance(chosen, InputError):
        raise chosen
    named = len(found) > 1 or not str(chosen.individual).startswith("PoseEstimation")
    return chosen if named else replace(chosen, individual=None)


def _type(group: Any) -> Any:
    return attribute(group, "neurodata_type")


def _points(path: Path, name: str, group: Any, inside: list[Any], series: list[_PoseSeries]) -> StoredPoints:
    """What a container has. Raises InputError where its series do not fit together."""
    nodes, edges = _skeleton(group, inside)
    order = {node: i for i, node in enumerate(nodes)}
    first, *others = series = sorted(series, key=lambda s: order.get(s.name, len(order)))
    points = tuple(s.name for s in series)
    problems = name_problems(path, name, points)
    for s in others:
        where = f"{name}/{s.name}"
        if s.values.shape[1] != first.values.shape[1]:
            found = f"{s.values.shape[1]} coordinates, and {first.values.shape[1]} in {first.name}"
            problems.append(Problem(path, where, found, "2D points or 3D points, not both"))
        if s.times_s.shape != first.times_s.shape or not np.allclose(s.times_s, first.times_s, rtol=0, atol=1e-6):
            problems.append(Problem(path, where, f"other times than in {first.name}", "one time line"))
    if not len(first.times_s):
        problems.append(Problem(path, name, "no frames", "at least one"))
    refuse(problems)
    frames, fps = frames_of_times(path, first.times_s, first.fps)
    scorer = child(group, "scorer")
    return StoredPoints(
        points,
        np.stack([s.values for s in series], axis=1),
        frames,
        np.stack([s.confidence for s in series], axis=1),
        fps=fps,
        individual=name,
        scorer="" if scorer is None else "".join(texts(scorer)),
        unit=UNIT_NAMES.get(first.unit),
        up="z" if first.z_up else None,
        edges=tuple((nodes[a], nodes[b]) for a, b in edges) if {*nodes} == {*points} else (),
    )


def _skeleton(group: Any, inside: list[Any]) -> tuple[list[str], np.ndarray]:
    """Nodes and edges (E, 2) of a container's skeleton, or of the container itself, as the first version had it."""
    for holder in (group, *(one for one in inside if one is not None and _type(one) == "Skeleton")):
        if (stored := child(holder, "nodes")) is not None:
            nodes, linked = texts(stored), child(holder, "edges")
            edges = np.zeros((0, 2)) if linked is None else numbers(linked).reshape(-1, 2)
            return nodes, edges[((edges >= 0) & (edges < len(nodes))).all(axis=1)].astype(np.int64)
    return [], np.zeros((0, 2), np.int64)


def _series(path: Path, group: Any) -> _PoseSeries:
    data, name = child(group, "data"), str(group.name).rsplit("/", 1)[-1]
    values = numbers(data)
    if values.ndim != 2 or values.shape[1] not in (2, 3) or values.dtype.kind not in "fiu":
        raise InputError(Problem(path, name, f"{values.dtype} {values.shape}", "numbers, (frames, 2) or (frames, 3)"))
    T = len(values)
    scale, shift = attribute(data, "conversion"), attribute(data, "offset")
    values = values.astype(float) * float(1 if scale is None else scale) + float(shift or 0)
    confidence = child(group, "confidence")
    sure = np.full(T, np.nan) if confidence is None else numbers(confidence).astype(float)
    comment = str(attribute(group, "comments") or "")
    ours = re.search(re.escape(RATE_TEXT).replace(r"\{fps!r\}", "([0-9.e+-]+)"), comment)
    fps = rate(ours[1]) if ours else None
    stamps, start = child(group, "timestamps"), child(group, "starting_time")
    if stamps is not None:
        times_s = numbers(stamps).astype(float)
    elif start is not None:
        fps = rate(attribute(start, "rate"))
        times_s = float(numbers(start)) + np.arange(T) / (fps or np.nan)
    else:
        raise InputError(Problem(path, name, "no times", "timestamps, or starting_time with a rate"))
    if sure.shape != (T,) or times_s.shape != (T,):
        found = f"{T} positions, {len(sure)} confidences and {len(times_s)} times"
        raise InputError(Problem(path, name, found, "as many of each"))
    reference = "".join(texts(frame)) if (frame := child(group, "reference_frame")) is not None else ""
    unit = str(attribute(data, "unit") or "")
    return _PoseSeries(name, values, sure, times_s, fps, unit, reference.endswith(UP_TEXT))


def write(data: Keypoints | Pose3D, path: Path) -> None:
    """x, y in pixels; or x, y, z in metres with z up, and joints that are linked as the skeleton's edges.

    Raises InputError without a frame rate, or for names that NWB cannot hold.
    """
    points = points_of(data)
    container = points.individual or "PoseEstimation"
    fps = float(required_fps(points.fps, TITLE))
    require_names((container, *points.names), NO_NAMES, TITLE)
    with formats_extra(TITLE):
        from ndx_pose import PoseEstimation, PoseEstimationSeries, Skeleton, Skeletons
        from pynwb import NWBHDF5IO, NWBFile
    frames, edges = points.frames, points.edges
    regular = int(frames[-1] - frames[0]) + 1 == len(frames)
    time = {"rate": fps, "starting_time": frames[0] / fps} if regular else {"timestamps": frames / fps}
    series = []
    for k, name in enumerate(points.names):
        more: dict[str, Any] = {}
        if points.likelihood is not None:
            more["confidence"] = points.likelihood[:, k]
            more["confidence_definition"] = "likelihood of the detection, 0 to 1"
        series.append(
            PoseEstimationSeries(
                name=name,
                data=points.values[:, k],
                unit="metres" if points.in_space else "pixels",
                reference_frame=f"x, y and z in metres, right-handed, {UP_TEXT}" if points.in_space else IN_PICTURE,
                comments=RATE_TEXT.format(fps=fps),
                **time,
                **more,
            )
        )
    few = len(points.names) < 256
    linked = {"edges": index_edges(points.names, edges).astype(np.uint8)} if edges and few else {}
    skeleton = Skeleton(name="skeleton", nodes=list(points.names), **linked)
    poses = PoseEstimation(
        name=container,
        pose_estimation_series=series,
        description="Points of one animal.",
        scorer=points.scorer or "recon",
        source_software="recon",
        skeleton=skeleton,
    )
    file: Any = NWBFile(
        session_description="Poses of an animal; the session's start is not known.",
        identifier=str(uuid4()),
        session_start_time=datetime(1970, 1, 1, tzinfo=UTC),
    )
    behavior = file.create_processing_module("behavior", "processed behavioral data")
    behavior.add([Skeletons(skeletons=[skeleton]), poses])
    writer: Any = NWBHDF5IO
    made = BytesIO()
    with h5py.File(made, "w") as stored, writer(file=stored, mode="w") as io:
        io.write(file)
    write_bytes(path, made.getvalue())
