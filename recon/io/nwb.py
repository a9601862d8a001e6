"""NWB files with the extension ndx-pose: one `PoseEstimationSeries` for each point, in one container for each animal.

They are read with h5py, by the types that the groups say they have, so that files of every version of the extension
are taken alike. Ours are given 1970-01-01 as the start of their session, which NWB asks for and nobody knows here.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any, NamedTuple
from uuid import uuid4

import h5py
import numpy as np

from recon.base.errors import InputError, Problem, refuse
from recon.base.files import write_bytes
from recon.clip import Keypoints
from recon.io import common, units, writing
from recon.io.common import Pose3D, StoredPoints
from recon.io.hdf5 import attribute, child, groups, names, numbers, opened, outline, texts

TITLE = "ndx-pose NWB"
NO_NAMES = r"[/:]"
IN_PICTURE = "(0, 0) is the upper left corner of the picture, x to the right, y down"
RATE_TEXT = "frame number = time in seconds x {fps!r} Hz"
"""In the comments of our own series, whose times may be irregular."""
UP_TEXT = "z up"
"""At the end of the frame of reference of our own 3D series."""


class _Series(NamedTuple):
    """One point in T frames."""

    name: str
    values: np.ndarray
    """The points, shape (T, 2 or 3)."""
    confidence: np.ndarray
    """The confidences, shape (T,)."""
    times_s: np.ndarray
    """The times in seconds, shape (T,)."""
    fps: float | None
    unit: str
    z_up: bool


def recognises(path: Path) -> bool:
    """Whether the file is NWB's, with poses or without."""
    return "nwb_version" in outline(path)


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The points of one animal, which a file of several calls by its container. Raises InputError."""
    with opened(path) as file:
        containers = {}
        for group in groups(file):
            of_type: dict[str, list[Any]] = {}
            for one in (child(group, name) for name in names(group)):
                of_type.setdefault("" if one is None else str(attribute(one, "neurodata_type")), []).append(one)
            if "PoseEstimationSeries" in of_type:
                containers[_last(group)] = group, of_type
        if not containers:
            raise InputError(Problem(path, "PoseEstimationSeries", "none", "poses of the extension ndx-pose"))
        name = [*containers][common.choose(path, [*containers], individual)]
        group, of_type = containers[name]
        # The first version of the extension had the skeleton's nodes in the container itself.
        skeleton = next((one for one in (group, *of_type.get("Skeleton", ())) if child(one, "nodes") is not None), None)
        nodes = [] if skeleton is None else texts(child(skeleton, "nodes"))
        linked = None if skeleton is None else child(skeleton, "edges")
        edges = [] if linked is None else numbers(linked).reshape(-1, 2).tolist()
        scorer = child(group, "scorer")
        scorer = "" if scorer is None else "".join(texts(scorer))
        found = of_type["PoseEstimationSeries"]
        common.require_span(max(len(child(one, "data")) for one in found), len(found), path)
        series = [_series(path, one) for one in found]
    first, *others = series = sorted(series, key=lambda s: nodes.index(s.name) if s.name in nodes else len(nodes))
    refuse(
        Problem(path, f"{name}/{s.name}", f"{s.values.shape} positions", f"{first.values.shape}, as in {first.name}")
        for s in others
        if s.values.shape != first.values.shape
    )
    refuse(
        Problem(path, f"{name}/{s.name}", f"other times than in {first.name}", "one time line")
        for s in others
        if not np.allclose(s.times_s, first.times_s, rtol=0, atol=1e-6)
    )
    frames, fps = units.frames_of_times(path, first.times_s, first.fps)
    points = [s.name for s in series]
    return common.points_of_arrays(
        path,
        None,
        np.stack([s.values for s in series], axis=1),
        frames,
        points,
        [name] if len(containers) > 1 or not name.startswith("PoseEstimation") else [],
        np.stack([s.confidence for s in series], axis=1),
        fps=fps,
        scorer=scorer,
        unit=units.UNIT_NAMES.get(first.unit),
        up="z" if first.z_up else None,
        edges=tuple((nodes[a], nodes[b]) for a, b in edges) if {*nodes} == {*points} else (),
    )


def _last(group: Any) -> str:
    return str(group.name).rsplit("/", 1)[-1]


def _series(path: Path, group: Any) -> _Series:
    data, confidence, stamps, start, frame = (
        child(group, name) for name in ("data", "confidence", "timestamps", "starting_time", "reference_frame")
    )
    name, values = _last(group), numbers(data)
    scale, shift = attribute(data, "conversion"), attribute(data, "offset")
    values = values.astype(float) * float(1 if scale is None else scale) + float(shift or 0)
    T = len(values)
    sure = np.full(T, np.nan) if confidence is None else numbers(confidence)
    comment = str(attribute(group, "comments") or "")
    ours = re.search(re.escape(RATE_TEXT).replace(r"\{fps!r\}", "([0-9.e+-]+)"), comment)
    fps = common.rate(ours[1]) if ours else None
    if stamps is not None:
        times_s = numbers(stamps).astype(float)
    elif start is not None:
        fps = common.rate(attribute(start, "rate"))
        times_s = float(numbers(start)) + np.arange(T) / (fps or np.nan)
    else:
        raise InputError(Problem(path, name, "no times", "timestamps, or starting_time with a rate"))
    if sure.shape != (T,) or times_s.shape != (T,):
        found = f"{T} positions, {len(sure)} confidences and {len(times_s)} times"
        raise InputError(Problem(path, name, found, "as many of each"))
    z_up = frame is not None and "".join(texts(frame)).endswith(UP_TEXT)
    return _Series(name, values, sure, times_s, fps, str(attribute(data, "unit") or ""), z_up)


def write(data: Keypoints | Pose3D, path: Path) -> None:
    """x, y in pixels; or x, y, z in metres with z up, and joints that are linked as the skeleton's edges.

    Raises InputError without a frame rate, or for names that NWB cannot hold.
    """
    points = writing.points_of(data)
    container = points.individual or "PoseEstimation"
    fps = float(writing.required_fps(points.fps, TITLE))
    writing.require_names((container, *points.names), NO_NAMES, TITLE)
    with common.formats_extra(TITLE):
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
    linked = {"edges": writing.index_edges(points.names, edges).astype(np.uint8)} if edges and few else {}
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
