"""Read and write poses in HDF5 files: DeepLabCut, SLEAP, sleap-anipose, movement, and NWB with ndx-pose.

- DeepLabCut's H5: the table of `recon.io.deeplabcut`, as pandas stores it. pandas and PyTables would unpickle any
  object in a file, so this module reads pandas' fixed and table layouts without them. Cells are numbers or strings.
  Column labels, which are pickled in the table layout, are lists and tuples of strings. Anything else is refused.
- SLEAP's analysis: `tracks`, `point_scores`, `track_occupancy`, `node_names`, `track_names`. The attribute `dims` of
  each dataset has the order of its axes. Files without it have the order of SLEAP's first version. The frame axis
  counts from frame 0 of the video. Frames in which a track is not occupied are left out.
- sleap-anipose's points3d.h5: `tracks` (frame, track, node, xyz), and perhaps `frames`, with the first frame number and
  the one after the last. Files of other programs also have names, and the frame rate as `recording_frame_rate`.
- netCDF 4 of the `movement` package: `position (time, space, keypoint, individual)` and `confidence`. Dimensions are
  called `keypoints` and `individuals` in files of movement before 0.17. `space` is x, y in pixels, or x, y, z in a
  unit that only recon's own files state (`length_unit`, `up_axis`). Recon's files have the names of movement 0.17, and
  times in seconds since frame 0 if the frame rate is known, otherwise in frames.
- NWB: one `PoseEstimationSeries` for each point, in one container for each animal. Groups are identified by the types
  that they state, so that all versions of the extension can be read. Recon's files state 1970-01-01 as the start of
  their session, because NWB requires a start and the real one is unknown.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, cast
from uuid import uuid4

import h5py
import numpy as np

from recon.base.errors import InputError, Problem, raise_problems
from recon.base.files import write_bytes
from recon.clip import Keypoints
from recon.io import common, hdf5, writing
from recon.io.common import Pose3D, StoredPoints
from recon.io.deeplabcut import HEADERS, header_problem, points_of_table
from recon.io.hdf5 import attribute, child, member, names, numbers, opened, outline, raw_attribute, read_values, texts
from recon.io.pickles import plain_pickle
from recon.io.positions import UNIT_NAMES
from recon.io.times import frames_of_numbers, with_times

if TYPE_CHECKING:
    import xarray as xr


PANDAS_KEY = "df_with_missing"
ANY_PANDAS = "0.15.2"
"""Version of pandas that recon's H5 files state, so that pandas 2 and 3 read them in the same way."""

Label = tuple[str, ...]
_Table = tuple[Sequence[str | None], list[Label], list[Label], np.ndarray]
"""Names of the columns' levels, labels of columns and rows, and cells, as `points_of_table` takes them."""


def recognises_deeplabcut(path: Path) -> bool:
    """Return whether an HDF5 file has a pandas table.

    Raises
    ------
    InputError
        If an HDF5 file cannot be opened.
    """
    return hdf5.is_hdf5(path) and bool(_keys(path))


def read_deeplabcut(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the points of one animal in DeepLabCut's H5 file (see `recon.io.deeplabcut.points_of_table`).

    Raises
    ------
    InputError
        If the file is invalid, has several tables, or has pickled Python objects as cells or labels.
    """
    keys = _keys(path)
    if len(keys) != 1:
        raise InputError(Problem(path, "keys", f"the tables {', '.join(keys)}" if keys else "no table", "one table"))
    with opened(path) as file:
        group = child(file, keys[0])
        kind = attribute(group, "pandas_type")
        layouts: dict[Any, Callable[[Any], _Table]] = {"frame": _fixed_frame, "frame_table": _table_frame}
        if kind not in layouts:
            raise InputError(Problem(path, f"key {keys[0]}", f"pandas' '{kind}'", "a table"))
        levels, labels, rows, cells = layouts[kind](group)
    if not any(levels):
        levels = {2: HEADERS[2], 3: HEADERS[0], 4: HEADERS[1]}.get(len(levels), levels)
    if tuple(levels) not in HEADERS:
        raise InputError(header_problem(path, f"column levels {', '.join(map(str, levels))}"))
    return points_of_table(path, individual, levels, labels, rows, cells)


def _keys(path: Path) -> list[str]:
    """Return the names of the groups that pandas stored in an HDF5 file, or raise InputError if it cannot be opened."""
    with opened(path, names_only=True) as file:
        return [str(group.name) for group in hdf5.groups(file) if h5py.h5a.exists(group.id, b"pandas_type")]


def _fixed_frame(group: h5py.Group) -> _Table:
    """Return a table in pandas' fixed layout, which has its axes, and an array for the columns of each type."""
    levels, columns = _axis(group, "axis0")
    _, index = _axis(group, "axis1")
    # columns with the same label are rejected later
    column_of = {label: column for column, label in enumerate(columns)}
    cells = np.full((len(index), len(columns)), np.nan)
    for block in range(int(attribute(group, "nblocks"))):
        _, items = _axis(group, f"block{block}_items")
        dataset = member(group, f"block{block}_values")
        if not _is_empty(dataset):  # stored as (C, T), and transposed if an attribute says so
            values = numbers(dataset)
            cells[:, [column_of[label] for label in items]] = values if attribute(dataset, "transposed") else values.T
    return levels, columns, index, cells


def _axis(group: h5py.Group, name: str) -> tuple[list[str | None], list[Label]]:
    """Return the names of the levels of an axis of a pandas table, and the labels along it."""
    if attribute(group, f"{name}_variety") != "multi":
        dataset = member(group, name)
        return [_attribute_value(dataset, "name")], [(label,) for label in _labels(group, dataset)]
    levels, level_labels = [], []
    for i in range(int(attribute(group, f"{name}_nlevels"))):
        level = member(group, f"{name}_level{i}")
        level_names = np.array([*_labels(group, level), "nan"], object)  # code -1, a missing label, is the last entry
        codes = numbers(member(group, f"{name}_label{i}")).ravel()
        if codes.min(initial=0) < -1:
            raise ValueError(f"{name}_label{i} has codes without a label")
        level_labels.append(level_names[codes].tolist())
        levels.append(_attribute_value(level, "name"))
    return levels, list(zip(*level_labels, strict=True))


def _labels(group: h5py.Group, dataset: h5py.Dataset) -> list[str]:
    return [] if _is_empty(dataset) else _texts_of(group, read_values(dataset).ravel())


def _texts_of(group: h5py.Group, values: np.ndarray) -> list[str]:
    if values.dtype.kind != "S":
        return [str(value) for value in values.tolist()]
    encoding = "utf-8" if str(attribute(group, "encoding") or "UTF-8").upper() in ("UTF-8", "ASCII") else "latin-1"
    return [value.decode(encoding) for value in values.tolist()]


def _is_empty(dataset: h5py.Dataset) -> bool:
    """Return whether a dataset is empty, or raise ValueError for pickled cells.

    pandas stores an empty array as an array of one element, with the true shape as an attribute.
    """
    if attribute(dataset, "PSEUDOATOM") is not None:
        raise ValueError("cells with pickled Python objects, which could run any program")
    return 0 in (_attribute_value(dataset, "shape") or ())


def _table_frame(group: h5py.Group) -> _Table:
    """Return a table in pandas' table layout, which is an array of records with pickled labels of columns."""
    ((_, stored_columns),) = _attribute_value(group, "non_index_axes")
    columns = [_label(label) for label in stored_columns]
    dataset = member(group, "table")
    rows = read_values(dataset)
    cells = np.full((len(rows), len(columns)), np.nan)
    for name in _attribute_value(group, "values_cols"):
        indices = [columns.index(_label(label)) for label in _attribute_value(dataset, f"{name}_kind")]
        cells[:, indices] = rows[str(name)].reshape(len(rows), -1)
    level_names = ((_attribute_value(group, "info") or {}).get(1) or {}).get("names")
    levels = level_names if level_names and len(level_names) == len(columns[0]) else [None] * len(columns[0])
    return levels, columns, [(text,) for text in _texts_of(group, rows["index"])], cells


def _label(label: object) -> Label:
    return tuple(str(part) for part in (label if isinstance(label, tuple) else (label,)))


def _attribute_value(holder: h5py.Group | h5py.Dataset, name: str) -> Any:
    """Return the value of an attribute of a file that PyTables wrote.

    PyTables stores strings and numbers directly, and other values as a pickle, which ends in a dot.
    """
    value = raw_attribute(holder, name)
    if not isinstance(value, bytes):
        return value
    if len(value) < 2 or not value.endswith(b"."):
        return value.decode("utf-8")
    try:
        return plain_pickle(value)
    except ValueError as error:
        raise ValueError(f"{name} is {error}, which could run any program") from None


def write_deeplabcut(data: Keypoints | Pose3D, path: Path) -> None:
    """Write DeepLabCut's H5 file of keypoints (x, y, likelihood), or of 3D points (x, y, z in metres with z up)."""
    import pandas as pd

    with writing.formats_extra("DeepLabCut H5"):
        import tables  # noqa: F401  pandas writes with it
    header, frames, values = writing.deeplabcut_layout(data)
    columns = pd.MultiIndex.from_arrays([*header.values()], names=[*header])
    table = pd.DataFrame(values, pd.Index(frames), columns)
    in_memory: dict[str, Any] = {"driver": "H5FD_CORE", "driver_core_backing_store": 0}
    with cast(Any, pd.HDFStore(str(path), mode="w", **in_memory)) as store:
        store.put(PANDAS_KEY, table, format="table", index=False, track_times=False)
        store.get_storer(PANDAS_KEY).attrs.pandas_version = ANY_PANDAS
        content = store._handle.get_file_image()
    write_bytes(path, content)


SLEAP_AXES = {
    "tracks": ("track", "xy", "node", "frame"),
    "point_scores": ("track", "node", "frame"),
    "track_occupancy": ("frame", "track"),
}
"""Order of the axes of each of SLEAP's datasets in files without `dims`."""
WANTED = ("frame", "track", "node", "xy")


def recognises_sleap(path: Path) -> bool:
    """Return whether a file is a SLEAP analysis file."""
    return {"tracks", "node_names"} <= outline(path)


def read_sleap(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the keypoints of one track in a SLEAP analysis file.

    Scores are unknown if the file has none. If the file does not state occupancy, every track is in every frame.

    Raises
    ------
    InputError
        If the file is damaged, or if its arrays disagree.
    """
    with opened(path) as file:
        available = [name for name in SLEAP_AXES if child(file, name) is not None]
        arrays = {name: _sleap_array(path, child(file, name), name) for name in available}
        nodes, tracks = hdf5.texts_in(file, "node_names"), hdf5.texts_in(file, "track_names")
    xy = arrays["tracks"]
    score = arrays.get("point_scores", np.full(xy.shape[:3], np.nan))
    occupied = arrays.get("track_occupancy")
    stored = StoredPoints(tuple(nodes), xy, np.arange(len(xy)), score)
    return common.one_animal(path, individual, stored, tracks, occupied)


def _sleap_array(path: Path, dataset: h5py.Dataset, name: str) -> np.ndarray:
    """Return one array of a SLEAP file with its axes in the order of `WANTED`."""
    dims = attribute(dataset, "dims")
    order = SLEAP_AXES[name] if dims is None else tuple(str(axis) for axis in json.loads(dims))
    if dims is None and name == "tracks" and attribute(dataset.file, "transpose") in (False, 0):
        order = ("frame", "node", "xy", "track")
    wanted = [axis for axis in WANTED if axis in SLEAP_AXES[name]]
    values = numbers(dataset)
    if sorted(order) != sorted(wanted) or values.ndim != len(wanted):
        detail = f"{values.dtype} {values.shape} with the axes {', '.join(order)[:80]}"
        expected = (
            f"an array with the axes {', '.join(SLEAP_AXES[name])}, in this order or in that of its attribute dims"
        )
        raise InputError(Problem(path, name, detail, expected))
    return values.transpose([order.index(axis) for axis in wanted])


def recognises_points3d(path: Path) -> bool:
    """Return whether a file has sleap-anipose's 3D points."""
    available = outline(path)
    if "tracks" not in available or {"point_scores", "track_occupancy", "edge_inds", "instance_scores"} & available:
        return False
    with opened(path) as file:
        shape = getattr(child(file, "tracks"), "shape", ())
        return len(shape) == 4 and shape[-1] == 3


def read_points3d(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the 3D points of one track in a file of sleap-anipose."""
    with opened(path) as file:
        nodes, tracks = hdf5.texts_in(file, "node_names"), hdf5.texts_in(file, "track_names")
        values = numbers(child(file, "tracks"))
        first, fps = (
            None if (dataset := child(file, name)) is None else float(numbers(dataset).ravel()[0])
            for name in ("frames", "recording_frame_rate")
        )
    frames = (first or 0.0) + np.arange(len(values))
    stored = StoredPoints(tuple(nodes), values, frames, fps=common.rate(fps))
    return common.one_animal(path, individual, stored, tracks)


VARIABLES = ("position", "confidence", "time", "space", "keypoint", "individual", "keypoints", "individuals")
ATTRIBUTES = ("ds_type", "fps", "time_unit", "length_unit", "up_axis")
PACKING = ("scale_factor", "add_offset", "missing_value")
"""Attributes of variables that netCDF stores in packed form, which files of poses do not have."""
NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"
"""First words of the attribute NAME of a dimension without labels."""
POSITION = ("time", "individual", "keypoint", "space")
Variables = Mapping[str, tuple[tuple[str, ...], np.ndarray]]
"""Axes and values of each variable, by its name in movement 0.17."""


def recognises_movement(path: Path) -> bool:
    """Return whether a file is in the format of the `movement` package, 2D or 3D.

    Raises
    ------
    InputError
        If the file is netCDF 3, which h5py cannot read.
    """
    if common.starts_with(path, b"CDF"):
        expected = "netCDF 4: in Python, xarray.load_dataset(old).to_netcdf(new, engine='h5netcdf')"
        raise InputError(Problem(path, "format", "netCDF 3", expected))
    return {"position", "space"} <= outline(path)


def read_movement(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the points of one animal in a netCDF file of the `movement` package."""
    variables = {}
    with opened(path) as file:
        scales = {name: item for name in names(file) if hdf5.is_scale(item := child(file, name))}
        for name in VARIABLES:
            dataset = child(file, name)
            stored_name = "" if dataset is None else str(attribute(dataset, "NAME") or "")
            if not isinstance(dataset, h5py.Dataset) or stored_name.startswith(NO_VARIABLE):
                continue
            if any(attribute(dataset, packing) is not None for packing in PACKING):
                raise ValueError(f"{name} has packed numbers ({', '.join(PACKING)})")
            is_text = hdf5.is_text(dataset)
            values = np.array(texts(dataset), object).reshape(dataset.shape) if is_text else numbers(dataset)
            variables[name.removesuffix("s")] = _axes(dataset, name, scales), values
        attributes = {name: attribute(file, name) for name in ATTRIBUTES}
    plain = str | int | float | np.integer | np.floating
    attributes = {name: value if isinstance(value, plain) else None for name, value in attributes.items()}
    return _points_of_variables(path, variables, attributes, individual)


def points_of_dataset(source: Path, dataset: xr.Dataset, fps: float | None, individual: str | None) -> StoredPoints:
    """Return the points of one animal in a dataset of the `movement` package.

    `fps` replaces the dataset's frame rate if it is given.

    Raises
    ------
    InputError
        If the dataset is invalid.
    """
    stored = {}
    for name in (name for name in VARIABLES if name in dataset.variables):
        axes = tuple(str(dim).removesuffix("s") for dim in dataset[name].dims)
        stored[name.removesuffix("s")] = axes, dataset[name].to_numpy().copy()
    attributes = {name: dataset.attrs.get(name) for name in ATTRIBUTES}
    return _points_of_variables(source, stored, attributes if fps is None else attributes | {"fps": fps}, individual)


def _points_of_variables(
    path: Path, stored: Variables, attributes: Mapping[str, Any], individual: str | None
) -> StoredPoints:
    """Return the points of one animal in variables of the `movement` package.

    Raises
    ------
    InputError
        If the variables are not valid.
    """

    def ordered(name: str, dims: tuple[str, ...]) -> np.ndarray:
        """Return a variable with its axes in the order `dims`, or an empty array if it is absent."""
        axes, values = stored.get(name, (dims, np.zeros([0] * len(dims))))
        if sorted(axes) != sorted(dims):
            detail = f"{values.dtype} with the dimensions {', '.join(axes)}"
            raise InputError(Problem(path, name, detail, ", ".join(dims)))
        return values.transpose([axes.index(dim) for dim in dims])

    values, confidence = ordered("position", POSITION), ordered("confidence", POSITION[:-1])
    space, keypoints, individuals = (
        [str(text) for text in stored[dim][1].tolist()] if dim in stored else []
        for dim in ("space", "keypoint", "individual")
    )
    kind, coords = attributes["ds_type"] or "poses", list("xyz"[: values.shape[-1]])
    wrong = {
        "ds_type": (str(kind), "poses: keypoints, not boxes", kind == "poses"),
        "space": (", ".join(space)[:80], "x, y or x, y, z", (space or coords) == coords),
    }
    raise_problems(
        Problem(path, field, detail, expected) for field, (detail, expected, right) in wrong.items() if not right
    )
    ticks, fps = stored["time"][1] if "time" in stored else np.arange(len(values)), common.rate(attributes["fps"])
    # Without the attribute, whole numbers are treated as frames.
    in_frames = (attributes["time_unit"] or ("frames" if ticks.dtype.kind in "iu" else "seconds")) == "frames"
    frames = frames_of_numbers(path, ticks.astype(float)) if in_frames else np.arange(len(ticks))
    extra: dict[str, Any] = {"fps": fps}
    extra["unit"], up_axis = UNIT_NAMES.get(str(attributes["length_unit"])), str(attributes["up_axis"])
    extra |= {"up": up_axis if up_axis in ("x", "y", "z") else None}
    likelihood = confidence if "confidence" in stored else None
    points = StoredPoints(tuple(keypoints), values, frames, likelihood, **extra)
    points = points if in_frames else with_times(path, points, ticks.astype(float), fps)
    return common.one_animal(path, individual, points, individuals)


def _axes(dataset: h5py.Dataset, name: str, scales: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the names of a variable's dimensions, each of which is a dataset of the file.

    The dimensions are found by number, or by their references, because the functions of HDF5 that return them crash on
    damaged files.
    """
    if name in scales:
        return (name.removesuffix("s"), *(f"{name}_{axis}" for axis in range(1, dataset.ndim)))
    listed = attribute(dataset, "_Netcdf4Coordinates")
    if listed is not None:
        dimensions = {attribute(scale, "_Netcdf4Dimid"): scale_name for scale_name, scale in scales.items()}
        numbered = np.atleast_1d(listed).tolist()
    else:
        dimensions = {
            axis: scale_name for scale_name, scale in scales.items() for axis in hdf5.scale_of(scale, dataset)
        }
        numbered = range(dataset.ndim)
    return tuple(dimensions.get(number, "?").removesuffix("s") for number in numbered)


def write_movement(data: Keypoints | Pose3D, path: Path) -> None:
    """Write keypoints (x, y in px) or 3D points (x, y, z in m, with z up) to a netCDF file of the `movement` package.

    The format requires a confidence, which is NaN for 3D points.
    """
    with writing.formats_extra("movement netCDF"):
        import h5netcdf  # noqa: F401  xarray writes with it
    write_bytes(path, bytes(dataset_of(data).to_netcdf(None, engine="h5netcdf")))


def dataset_of(data: Keypoints | Pose3D) -> xr.Dataset:
    """Return keypoints or 3D positions as an `xarray.Dataset` of the `movement` package.

    Raises
    ------
    InputError
        If xarray is not installed.
    """
    with writing.formats_extra("movement netCDF"):
        import xarray
    points = writing.points_of(data)
    unknown = np.full(points.values.shape[:2], np.nan)
    confidence = unknown if points.likelihood is None else points.likelihood
    attributes: dict[str, Any] = {"source_software": "recon", "ds_type": "poses", "source_file": ""}
    attributes |= {"length_unit": points.unit, "up_axis": points.up} if points.in_space else {}
    attributes |= {"time_unit": "frames"} if points.fps is None else {"time_unit": "seconds", "fps": points.fps}
    variables = {
        "position": (("time", "space", "keypoint", "individual"), points.values.transpose(0, 2, 1)[..., None]),
        "confidence": (("time", "keypoint", "individual"), confidence[..., None]),
        "time": points.frames if points.fps is None else points.frames / points.fps,
        "space": list("xyz"[: points.values.shape[-1]]),
        "keypoint": list(points.names),
        "individual": [points.individual or common.UNNAMED[0]],
    }
    return xarray.Dataset(variables, attrs=attributes)


NWB = "ndx-pose NWB"
IN_PICTURE = "(0, 0) is the upper left corner of the picture, x to the right, y down"
RATE_TEXT = "frame number = time in seconds x {fps!r} Hz"
"""Comment that recon writes into NWB series, from which the rate of irregular times is read."""
UP_TEXT = "z up"
"""Last words of the description of the axes that recon writes into 3D NWB series."""


def recognises_nwb(path: Path) -> bool:
    """Return whether a file is NWB, with or without poses."""
    return "nwb_version" in outline(path)


def read_nwb(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the points of one animal in an NWB file.

    If there are several animals, each is named after its container.
    """
    with opened(path) as file:
        containers = {}
        for group in hdf5.groups(file):
            of_type: dict[str, list[Any]] = {}
            for item in (child(group, name) for name in names(group)):
                of_type.setdefault("" if item is None else str(attribute(item, "neurodata_type")), []).append(item)
            if "PoseEstimationSeries" in of_type:
                containers[_last(group)] = group, of_type
        if not containers:
            raise InputError(
                Problem(
                    path,
                    "PoseEstimationSeries",
                    "no series of poses",
                    "one or more series, as the extension ndx-pose writes them",
                )
            )
        name = [*containers][common.choose(path, [*containers], individual)]
        group, of_type = containers[name]
        # The first version of the extension had the skeleton's nodes in the container itself.
        skeleton = next(
            (item for item in (group, *of_type.get("Skeleton", ())) if child(item, "nodes") is not None), None
        )
        nodes = [] if skeleton is None else texts(child(skeleton, "nodes"))
        linked = None if skeleton is None else child(skeleton, "edges")
        edges = [] if linked is None else numbers(linked).reshape(-1, 2).tolist()
        scorer, series = "".join(hdf5.texts_in(group, "scorer")), of_type["PoseEstimationSeries"]
        common.require_span(max(len(child(item, "data")) for item in series), len(series), path)
        series.sort(key=lambda item: nodes.index(_last(item)) if _last(item) in nodes else len(nodes))
        points = [_last(item) for item in series]
        values, confidence, times_s, rates = zip(*(_series(path, item) for item in series), strict=True)
        unit = UNIT_NAMES.get(str(attribute(child(series[0], "data"), "unit") or ""))
        z_up = "".join(hdf5.texts_in(series[0], "reference_frame")).endswith(UP_TEXT)
    problems, first = [], points[0]
    for point, positions, point_times_s in zip(points, values, times_s, strict=True):
        if positions.shape != values[0].shape:
            expected = f"an array of shape {values[0].shape}, as in {first}"
            problems.append(Problem(path, f"{name}/{point}", f"an array of shape {positions.shape}", expected))
        elif not np.allclose(point_times_s, times_s[0], rtol=0, atol=1e-6):
            problems.append(
                Problem(
                    path, f"{name}/{point}", f"times that differ from those of {first}", "the same times for all points"
                )
            )
    raise_problems(problems)
    links = tuple((nodes[a], nodes[b]) for a, b in edges) if {*nodes} == {*points} else ()
    extra: dict[str, Any] = {"scorer": scorer, "unit": unit, "up": "z" if z_up else None, "edges": links}
    frames = np.arange(len(times_s[0]))
    stored = StoredPoints(tuple(points), np.stack(values, axis=1), frames, np.stack(confidence, axis=1), **extra)
    stored = with_times(path, stored, times_s[0], rates[0])
    animal_names = [name] if len(containers) > 1 or not name.startswith("PoseEstimation") else []
    return common.one_animal(path, None, stored, animal_names)


def _last(group: h5py.Group) -> str:
    return str(group.name).rsplit("/", 1)[-1]


class _Series(NamedTuple):
    """Positions of one point of an NWB file in T frames."""

    positions: np.ndarray
    """Positions in pixels, shape (T, 2), or in the file's unit, shape (T, 3)."""
    confidence: np.ndarray
    """Confidences, shape (T,), NaN if unknown."""
    times_s: np.ndarray
    """Times of the frames in seconds, shape (T,)."""
    fps: float | None


def _series(path: Path, group: h5py.Group) -> _Series:
    """Return the positions of one point of an NWB file in all frames, or raise InputError if its arrays disagree."""
    keys = ("data", "confidence", "timestamps", "starting_time")
    data, stored_confidence, stamps, start = (child(group, name) for name in keys)
    scale, shift = attribute(data, "conversion"), attribute(data, "offset")
    values = numbers(data).astype(float) * float(1 if scale is None else scale) + float(shift or 0)
    T = len(values)
    confidence = np.full(T, np.nan) if stored_confidence is None else numbers(stored_confidence)
    comment = str(attribute(group, "comments") or "")
    ours = re.search(re.escape(RATE_TEXT).replace(r"\{fps!r\}", "([0-9.e+-]+)"), comment)
    fps = common.rate(ours[1]) if ours else None
    if stamps is not None:
        times_s = numbers(stamps).astype(float)
    elif start is not None:
        fps = common.rate(attribute(start, "rate"))
        times_s = float(numbers(start)) + np.arange(T) / (fps or np.nan)
    else:
        raise InputError(Problem(path, _last(group), "no times", "timestamps, or starting_time with a rate"))
    if confidence.shape != (T,) or times_s.shape != (T,):
        detail = f"{T} positions, {len(confidence)} confidences and {len(times_s)} times"
        raise InputError(Problem(path, _last(group), detail, "the same number of each"))
    return _Series(values, confidence, times_s, fps)


def write_nwb(data: Keypoints | Pose3D, path: Path) -> None:
    """Write an NWB file of points, in pixels or in metres with z up, and of the skeleton's edges.

    Raises
    ------
    InputError
        If the frame rate is not known, or if NWB cannot hold a name.
    """
    points = writing.points_of(data)
    container = points.individual or "PoseEstimation"
    fps = float(writing.required_fps(points.fps, NWB))
    writing.require_names((container, *points.names), r"[/:]", NWB)
    with writing.formats_extra(NWB):
        from ndx_pose import PoseEstimation, PoseEstimationSeries, Skeleton, Skeletons
        from pynwb import NWBHDF5IO, NWBFile
    frames, edges = points.frames, points.edges
    regular = int(frames[-1] - frames[0]) + 1 == len(frames)
    shared: dict[str, Any] = {
        "unit": "metres" if points.in_space else "pixels",
        "reference_frame": f"x, y and z in metres, right-handed, {UP_TEXT}" if points.in_space else IN_PICTURE,
        "comments": RATE_TEXT.format(fps=fps),
    } | ({"rate": fps, "starting_time": frames[0] / fps} if regular else {"timestamps": frames / fps})
    series = []
    for k, name in enumerate(points.names):
        confidence = {} if points.likelihood is None else {"confidence": points.likelihood[:, k]}
        confidence |= {"confidence_definition": "likelihood of the detection, 0 to 1"} if confidence else {}
        series.append(PoseEstimationSeries(name=name, data=points.values[:, k], **shared, **confidence))
    edges_fit = len(points.names) < 256
    linked = {"edges": writing.index_edges(points.names, edges).astype(np.uint8)} if edges and edges_fit else {}
    skeleton = Skeleton(name="skeleton", nodes=list(points.names), **linked)
    description = {
        "description": "Points of one animal.",
        "scorer": points.scorer or "recon",
        "source_software": "recon",
    }
    poses = PoseEstimation(name=container, pose_estimation_series=series, skeleton=skeleton, **description)
    session, start = "Poses of an animal; the session's start is not known.", datetime(1970, 1, 1, tzinfo=UTC)
    file: Any = NWBFile(session_description=session, identifier=str(uuid4()), session_start_time=start)
    behavior = file.create_processing_module("behavior", "processed behavioral data")
    behavior.add([Skeletons(skeletons=[skeleton]), poses])
    writer: Any = NWBHDF5IO
    made = BytesIO()
    with h5py.File(made, "w") as stored, writer(file=stored, mode="w") as io:
        io.write(file)
    write_bytes(path, made.getvalue())
