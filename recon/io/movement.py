"""movement's netCDF 4 files of poses: `position (time, space, keypoint, individual)` and `confidence`.

Dimensions are called `keypoints` and `individuals` in files of movement before 0.17. `space` is x, y in pixels, or
x, y, z in a unit that only our own files state (`length_unit`, `up_axis`). They have the names of movement 0.17, and
times in seconds since frame 0 where the frame rate is known, and otherwise in frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from recon.base.errors import InputError, Problem, refuse
from recon.base.files import write_bytes
from recon.clip import Keypoints
from recon.io import common, units, writing
from recon.io.common import Pose3D, StoredPoints
from recon.io.hdf5 import attribute, child, is_scale, is_text, names, numbers, opened, outline, scale_of, texts

CLASSIC = b"CDF"
VARIABLES = ("position", "confidence", "time", "space", "keypoint", "individual", "keypoints", "individuals")
ATTRIBUTES = ("ds_type", "fps", "time_unit", "length_unit", "up_axis")
PACKING = ("scale_factor", "add_offset", "missing_value")
"""Attributes of variables that netCDF packs in another unit, which nobody does with poses."""
NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"
"""At the beginning of the attribute NAME of a dimension without labels."""
POSITION = ("time", "individual", "keypoint", "space")


@dataclass(frozen=True, eq=False)
class _Variable:
    """An array with the names of its axes."""

    dims: tuple[str, ...]
    values: np.ndarray


def recognises(path: Path) -> bool:
    """Whether the file is movement's, 2D or 3D."""
    if common.starts_with(path, CLASSIC):
        expected = "netCDF 4: in Python, xarray.load_dataset(old).to_netcdf(new, engine='h5netcdf')"
        raise InputError(Problem(path, "format", "netCDF 3", expected))
    return {"position", "space"} <= outline(path)


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The points of one animal. Raises InputError."""
    return _points(path, *_stored(path), individual)


def points_of_dataset(source: Path, dataset: Any, fps: float | None, individual: str | None) -> StoredPoints:
    """The same from an `xarray.Dataset`. fps: what it is to be taken for. Raises InputError."""
    stored = {
        name.removesuffix("s"): _Variable(
            tuple(str(dim).removesuffix("s") for dim in dataset[name].dims), dataset[name].to_numpy().copy()
        )
        for name in VARIABLES
        if name in dataset.variables
    }
    attributes = {name: dataset.attrs.get(name) for name in ATTRIBUTES}
    return _points(source, stored, attributes if fps is None else attributes | {"fps": fps}, individual)


def _points(
    path: Path, stored: Mapping[str, _Variable], attributes: Mapping[str, Any], individual: str | None
) -> StoredPoints:
    values, confidence = (_ordered(path, stored, *of) for of in (("position", POSITION), ("confidence", POSITION[:-1])))
    kind, space = attributes["ds_type"] or "poses", _labels(stored, "space") or list("xyz"[: values.shape[-1]])
    problems = []
    if kind != "poses":
        problems.append(Problem(path, "ds_type", str(kind), "poses: keypoints, not boxes"))
    if space != list("xyz"[: values.shape[-1]]):
        problems.append(Problem(path, "space", ", ".join(space)[:80], "x, y or x, y, z"))
    refuse(problems)
    time = stored["time"].values if "time" in stored else np.arange(len(values))
    frames, fps = _frames(path, time, attributes)
    return common.points_of_arrays(
        path,
        individual,
        values,
        frames,
        _labels(stored, "keypoint"),
        _labels(stored, "individual"),
        confidence if "confidence" in stored else None,
        fps=fps,
        unit=units.UNIT_NAMES.get(str(attributes["length_unit"])),
        up=up if (up := str(attributes["up_axis"])) in ("x", "y", "z") else None,
    )


def _ordered(path: Path, stored: Mapping[str, _Variable], name: str, dims: tuple[str, ...]) -> np.ndarray:
    """A variable with its axes in this order; without any element where there is none. Raises InputError for others."""
    variable = stored.get(name, _Variable(dims, np.zeros([0] * len(dims))))
    if sorted(variable.dims) != sorted(dims):
        found = f"{variable.values.dtype} with the dimensions {', '.join(variable.dims)}"
        raise InputError(Problem(path, name, found, ", ".join(dims)))
    return variable.values.transpose([variable.dims.index(dim) for dim in dims])


def _labels(stored: Mapping[str, _Variable], dim: str) -> list[str]:
    """The coordinates of a dimension; empty where it has none."""
    return [str(text) for text in stored[dim].values.tolist()] if dim in stored else []


def _frames(path: Path, ticks: np.ndarray, attributes: Mapping[str, Any]) -> tuple[np.ndarray, float | None]:
    """Frame numbers and rate. Without the attribute `time_unit`, whole numbers are frames."""
    fps = common.rate(attributes["fps"])
    unit = attributes["time_unit"] or ("frames" if ticks.dtype.kind in "iu" else "seconds")
    if unit == "frames":
        return units.frames_of_times(path, ticks.astype(float), 1.0)[0], fps
    return units.frames_of_times(path, ticks.astype(float), fps)


def _stored(path: Path) -> tuple[dict[str, _Variable], dict[str, Any]]:
    """The variables that are needed, by their names of today, and the attributes that are plain values or None."""
    found = {}
    with opened(path) as file:
        scales = {name: item for name in names(file) if is_scale(item := child(file, name))}
        for name in VARIABLES:
            dataset = child(file, name)
            about = "" if dataset is None else str(attribute(dataset, "NAME") or "")
            if not isinstance(dataset, h5py.Dataset) or about.startswith(NO_VARIABLE):
                continue
            if any(attribute(dataset, packing) is not None for packing in PACKING):
                raise ValueError(f"{name} has packed numbers ({', '.join(PACKING)})")
            values = np.array(texts(dataset), object).reshape(dataset.shape) if is_text(dataset) else numbers(dataset)
            found[name.removesuffix("s")] = _Variable(_axes(dataset, name, scales), values)
        attributes = {name: attribute(file, name) for name in ATTRIBUTES}
    plain = str | int | float | np.integer | np.floating
    return found, {name: value if isinstance(value, plain) else None for name, value in attributes.items()}


def _axes(dataset: Any, name: str, scales: Mapping[str, Any]) -> tuple[str, ...]:
    """The names of a variable's dimensions, each of which is a dataset of the file: by their numbers, or by what each
    says it belongs to. (HDF5's own functions for this crash with damaged files.)"""
    if name in scales:
        return (name.removesuffix("s"), *(f"{name}_{axis}" for axis in range(1, dataset.ndim)))
    listed = attribute(dataset, "_Netcdf4Coordinates")
    if listed is not None:
        found = {attribute(scale, "_Netcdf4Dimid"): other for other, scale in scales.items()}
        numbered = np.atleast_1d(listed).tolist()
    else:
        found = {axis: other for other, scale in scales.items() for axis in scale_of(scale, dataset)}
        numbered = range(dataset.ndim)
    return tuple(found.get(number, "?").removesuffix("s") for number in numbered)


# -- writing ----------------------------------------------------------------------------------------------------------


def write(data: Keypoints | Pose3D, path: Path) -> None:
    """x, y in pixels, or x, y, z in metres with z up; of these the confidence, which the format asks for, is NaN."""
    with common.formats_extra("movement netCDF"):
        import h5netcdf  # noqa: F401  what xarray writes with
    write_bytes(path, bytes(dataset_of(data).to_netcdf(None, engine="h5netcdf")))


def dataset_of(data: Keypoints | Pose3D) -> Any:
    """The same as an `xarray.Dataset`. Raises InputError where xarray is not installed."""
    with common.formats_extra("movement netCDF"):
        import xarray
    points = writing.points_of(data)
    unknown = np.full(points.values.shape[:2], np.nan)
    confidence = unknown if points.likelihood is None else points.likelihood
    attributes: dict[str, Any] = {"source_software": "recon", "ds_type": "poses", "source_file": ""}
    attributes |= {"length_unit": points.unit, "up_axis": points.up} if points.in_space else {}
    attributes |= {"time_unit": "frames"} if points.fps is None else {"time_unit": "seconds", "fps": points.fps}
    return xarray.Dataset(
        data_vars={
            "position": (("time", "space", "keypoint", "individual"), points.values.transpose(0, 2, 1)[..., None]),
            "confidence": (("time", "keypoint", "individual"), confidence[..., None]),
        },
        coords={
            "time": points.frames if points.fps is None else points.frames / points.fps,
            "space": list("xyz"[: points.values.shape[-1]]),
            "keypoint": list(points.names),
            "individual": [points.individual or common.UNNAMED[0]],
        },
        attrs=attributes,
    )
