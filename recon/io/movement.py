"""movement's netCDF files of poses: `position (time, space, keypoint, individual)` and `confidence`.

Dimensions are called `keypoints` and `individuals` in files of movement before 0.17. `space` is x, y in pixels, or
x, y, z in a unit that only our own files state (`length_unit`, `up_axis`). They have the names of movement 0.17, and
times in seconds since frame 0 where the frame rate is known, and otherwise in frames.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.errors import InputError, Problem, refuse
from recon.base.files import write_bytes
from recon.clip.keypoints import Keypoints
from recon.io.common import UNNAMED, choose, formats_extra, frames_of_times, name_problems, rate, starts_with
from recon.io.hdf5 import (
    DAMAGE,
    attribute,
    child,
    is_scale,
    is_text,
    names,
    numbers,
    opened,
    outline,
    scale_of,
    texts,
)
from recon.io.pose import UNIT_NAMES, Pose3D, StoredPoints, points_of

CLASSIC = b"CDF"
VARIABLES = ("position", "confidence", "time", "space", "keypoint", "individual", "keypoints", "individuals")
ATTRIBUTES = ("ds_type", "fps", "time_unit", "length_unit", "up_axis")
PACKING = {"scale_factor": 1.0, "add_offset": 0.0}
FACTS = ("_FillValue", "missing_value", *PACKING)
NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"
"""At the beginning of the attribute NAME of a dimension without labels."""
PLURAL = {"keypoints": "keypoint", "individuals": "individual"}
POSITION = ("time", "individual", "keypoint", "space")
CONFIDENCE = ("time", "individual", "keypoint")


@dataclass(frozen=True, eq=False)
class _Variable:
    """An array with the names of its axes."""

    dims: tuple[str, ...]
    values: np.ndarray

    def along(self, dims: tuple[str, ...]) -> np.ndarray:
        """With its axes in this order, as floats."""
        return self.values.transpose([self.dims.index(dim) for dim in dims]).astype(float)

    def joined(self) -> _Variable:
        """Texts that are stored letter by letter, along one axis more."""
        if self.values.dtype.kind == "O" and self.values.ndim == 2:
            return _Variable(self.dims[:1], np.array(["".join(row) for row in self.values.tolist()], object))
        if self.values.dtype.kind == "S" and self.values.ndim == 2:
            words = [b"".join(row).rstrip(b"\0").decode("utf-8") for row in self.values.tolist()]
            return _Variable(self.dims[:1], np.array(words, object))
        return self


def recognises(path: Path) -> bool:
    """Whether the file is movement's, 2D or 3D."""
    if starts_with(path, CLASSIC):
        return b"position" in path.read_bytes()[:4096]
    return {"position", "space"} <= outline(path)


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The points of one animal. Raises InputError."""
    stored, attributes = _read_classic(path) if starts_with(path, CLASSIC) else _read_hdf5(path)
    kind = attributes.get("ds_type") or "poses"
    if kind != "poses":
        raise InputError(Problem(path, "ds_type", str(kind), "poses: keypoints, not boxes"))
    problems = [] if "position" in stored else [Problem(path, "position", "none", ", ".join(POSITION))]
    for name, dims in (("position", POSITION), ("confidence", CONFIDENCE)):
        v = stored.get(name)
        fits = v is None or (sorted(v.dims) == sorted(dims) and v.values.ndim == len(dims))
        if v is not None and not (fits and v.values.dtype.kind in "fiu"):
            found = f"{v.values.dtype} with the dimensions {', '.join(v.dims)}"
            problems.append(Problem(path, name, found, ", ".join(dims)))
    refuse(problems)
    position, confidence = stored["position"], stored.get("confidence")
    sizes = dict(zip(position.dims, position.values.shape, strict=True))
    for name, v in stored.items():
        expected = tuple(sizes[dim] for dim in (v.dims if name == "confidence" else (name,)) if dim in sizes)
        if name in (*POSITION, "confidence") and v.values.shape != expected:
            problems.append(Problem(path, name, f"{v.values.shape} ({', '.join(v.dims)})", f"{expected}, as position"))
    if not sizes["time"]:
        problems.append(Problem(path, "time", "no frames", "at least one"))
    refuse(problems)
    labels = {dim: [str(t) for t in stored[dim].values.tolist()] if dim in stored else [] for dim in POSITION[1:]}
    labels["individual"] = labels["individual"] or [f"individual_{i}" for i in range(sizes["individual"])]
    labels["space"] = labels["space"] or list("xyz"[: sizes["space"]])
    if labels["space"] not in (["x", "y"], ["x", "y", "z"]):
        problems.append(Problem(path, "space", ", ".join(labels["space"])[:80], "x, y or x, y, z"))
    problems += name_problems(path, "keypoint", labels["keypoint"])
    problems += name_problems(path, "individual", labels["individual"])
    values = position.along(POSITION)
    frames, fps = None, None
    try:
        frames, fps = _frames(path, stored.get("time"), sizes["time"], attributes)
    except InputError as error:
        problems += error.problems
    if problems or frames is None:
        raise InputError(problems)
    animals = labels["individual"]
    which = choose(path, animals, individual, [bool(np.isfinite(values[:, n]).any()) for n in range(len(animals))])
    return StoredPoints(
        tuple(labels["keypoint"]),
        values[:, which],
        frames,
        None if confidence is None else confidence.along(CONFIDENCE)[:, which],
        fps=fps,
        individual=animals[which] if len(animals) > 1 or animals[0] not in UNNAMED else None,
        unit=UNIT_NAMES.get(str(attributes.get("length_unit"))),
        up={"x": "x", "y": "y", "z": "z"}.get(str(attributes.get("up_axis"))),
    )


def _frames(
    path: Path, time: _Variable | None, T: int, attributes: Mapping[str, Any]
) -> tuple[np.ndarray, float | None]:
    """Frame numbers and rate. Without the attribute `time_unit`, whole numbers are frames."""
    fps = rate(attributes.get("fps"))
    ticks = np.arange(T) if time is None else time.values
    if ticks.dtype.kind not in "fiu":
        raise InputError(Problem(path, "time", f"values of type {ticks.dtype}", "seconds, or frames"))
    unit = attributes.get("time_unit") or ("frames" if ticks.dtype.kind in "iu" else "seconds")
    if unit == "frames":
        return frames_of_times(path, ticks.astype(float), 1.0)[0], fps
    return frames_of_times(path, ticks.astype(float), fps)


def _read_hdf5(path: Path) -> tuple[dict[str, _Variable], dict[str, Any]]:
    """The variables that are needed, and the attributes of a netCDF 4 file."""
    import h5py

    found = {}
    with opened(path) as file:
        scales = {name: item for name in names(file) if is_scale(item := child(file, name))}
        for name in VARIABLES:
            dataset = child(file, name)
            about = "" if dataset is None else str(attribute(dataset, "NAME") or "")
            if not isinstance(dataset, h5py.Dataset) or about.startswith(NO_VARIABLE):
                continue
            dims = _axes(dataset, name, scales)
            values = np.array(texts(dataset), object).reshape(dataset.shape) if is_text(dataset) else numbers(dataset)
            facts = {key: attribute(dataset, key) for key in FACTS}
            found[_singular(name)] = _Variable(tuple(map(_singular, dims)), _decoded(values, facts)).joined()
        attributes = {name: _plain_value(attribute(file, name)) for name in ATTRIBUTES}
    return found, attributes


def _axes(dataset: Any, name: str, scales: Mapping[str, Any]) -> tuple[str, ...]:
    """The names of a variable's dimensions, each of which is a dataset of the file: by their numbers, or by what each
    says it belongs to. (HDF5's own functions for this crash with damaged files.)"""
    if name in scales:
        return (name, *(f"{name}_{axis}" for axis in range(1, dataset.ndim)))
    numbers_of = {attribute(scale, "_Netcdf4Dimid"): name for name, scale in scales.items()}
    listed = attribute(dataset, "_Netcdf4Coordinates")
    if listed is not None:
        return tuple(numbers_of.get(number, "?") for number in np.atleast_1d(listed).tolist())
    found = {axis: name for name, scale in scales.items() for axis in scale_of(scale, dataset)}
    return tuple(found.get(axis, "?") for axis in range(dataset.ndim))


def _read_classic(path: Path) -> tuple[dict[str, _Variable], dict[str, Any]]:
    """The same of a netCDF 3 file."""
    from scipy.io import netcdf_file

    try:
        # From memory, where a size that is wrong reads no more than there is.
        with netcdf_file(io.BytesIO(path.read_bytes()), mmap=False) as opened_file:
            file: Any = opened_file  # its attributes have no types
            found = {
                _singular(name): _Variable(
                    tuple(map(_singular, file.variables[name].dimensions)),
                    _decoded(np.array(file.variables[name].data), file.variables[name]._attributes),
                ).joined()
                for name in VARIABLES
                if name in file.variables
            }
            attributes = {name: _plain_value(file._attributes.get(name)) for name in ATTRIBUTES}
    except DAMAGE as error:
        found = f"data that cannot be read ({' '.join(str(error).split())[:200]})"
        raise InputError(Problem(path, "content", found, "an undamaged netCDF file")) from None
    return found, attributes


def _plain_value(value: Any) -> Any:
    """A text or a number; None for anything else."""
    if isinstance(value, bytes):
        return value.decode("utf-8")
    return value if isinstance(value, str | int | float | np.integer | np.floating) else None


def _singular(name: str) -> str:
    return PLURAL.get(name, name)


def _decoded(values: np.ndarray, facts: Mapping[str, Any]) -> np.ndarray:
    """Packed numbers as they are meant, NaN where they are missing."""
    if values.dtype.kind not in "fiu" or all(facts.get(name) is None for name in FACTS):
        return values
    missing = [float(facts[name]) for name in FACTS[:2] if facts.get(name) is not None]
    scale, offset = (float(facts[name]) if facts.get(name) is not None else n for name, n in PACKING.items())
    if values.dtype.kind in "iu" and scale == 1 and offset == 0 and not np.isin(values, missing).any():
        return values
    return np.where(np.isin(values, missing), np.nan, values.astype(float) * scale + offset)


def write(data: Keypoints | Pose3D, path: Path) -> None:
    """x, y in pixels, or x, y, z in metres with z up; of these the confidence, which the format asks for, is NaN."""
    with formats_extra("movement netCDF"):
        import h5netcdf  # noqa: F401  what xarray writes with
    write_bytes(path, bytes(dataset_of(data).to_netcdf(None, engine="h5netcdf")))


def dataset_of(data: Keypoints | Pose3D) -> Any:
    """The same as an `xarray.Dataset`. Raises InputError where xarray is not installed."""
    with formats_extra("movement netCDF"):
        import xarray
    points = points_of(data)
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
            "individual": [points.individual or UNNAMED[0]],
        },
        attrs=attributes,
    )
