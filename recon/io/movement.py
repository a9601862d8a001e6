"""movement's netCDF files of poses: `position (time, space, keypoint, individual)` and `confidence`.

Dimensions are called `keypoints` and `individuals` in files of movement before 0.17. `space` is x, y in pixels, or
x, y, z in a unit that only our own files state.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from recon.errors import InputError, Problem
from recon.io.common import (
    UNNAMED,
    choose,
    formats_extra,
    frames_of_times,
    hdf5_outline,
    name_problems,
    rate,
    starts_with,
)
from recon.io.pose import UNIT_NAMES, StoredPose
from recon.keypoints import Keypoints

PLURAL = {"keypoints": "keypoint", "individuals": "individual"}
POSITION = ("time", "individual", "keypoint", "space")
CONFIDENCE = ("time", "individual", "keypoint")


@dataclass(frozen=True, eq=False)
class _File:
    """values (T, N, K, 2 or 3); confidence (T, N, K)."""

    names: tuple[str, ...]
    animals: list[str]
    values: np.ndarray
    confidence: np.ndarray
    frames: np.ndarray
    fps: float | None
    unit: str | None
    up: str | None


def recognises(path: Path) -> bool:
    """Whether the file is movement's, 2D or 3D."""
    if starts_with(path, b"CDF"):
        return b"position" in path.read_bytes()[:4096]
    return {"position", "space"} <= hdf5_outline(path)


def recognises_pose(path: Path) -> bool:
    return recognises(path) and _load(path).values.shape[-1] == 3


def read(path: Path, individual: str | None = None) -> Keypoints:
    """The 2D keypoints of one animal. Raises InputError."""
    file = _load(path)
    if file.values.shape[-1] == 3:
        raise InputError(Problem(path, "space", "x, y, z: 3D positions", "2D keypoints in pixels (x, y)"))
    which = choose(path, file.animals, individual)
    named = file.animals[which] if len(file.animals) > 1 or file.animals[0] not in UNNAMED else None
    values, confidence = file.values[:, which], file.confidence[:, which]
    return Keypoints(file.names, values, confidence, file.frames, fps=file.fps, individual=named, source=str(path))


def read_pose(path: Path, individual: str | None = None) -> StoredPose:
    """The 3D positions of one animal. Raises InputError."""
    file = _load(path)
    which = choose(path, file.animals, individual)
    return StoredPose(file.names, file.values[:, which], file.frames, fps=file.fps, unit=file.unit, up=file.up)


def _load(path: Path) -> _File:
    with formats_extra(path):
        import xarray
    try:
        with xarray.open_dataset(path, decode_times=False) as opened:
            data = opened.load()
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, AttributeError) as error:
        found = f"data that cannot be read ({error})"
        raise InputError(Problem(path, "content", found, "an undamaged netCDF file")) from None
    data = data.rename({old: new for old, new in PLURAL.items() if old in data.dims})
    kind = data.attrs.get("ds_type", "poses")
    if kind != "poses":
        raise InputError(Problem(path, "ds_type", str(kind), "poses: keypoints, not boxes"))
    problems = [
        Problem(path, name, f"{values.dtype} with the dimensions {', '.join(map(str, values.dims))}", ", ".join(dims))
        for name, dims in (("position", POSITION), ("confidence", CONFIDENCE))
        if name in data
        for values in [data[name]]
        if sorted(map(str, values.dims)) != sorted(dims) or values.dtype.kind not in "fiu"
    ]
    if problems:
        raise InputError(problems)
    labels = {dim: [str(t) for t in data[dim].values.tolist()] if dim in data.coords else [] for dim in POSITION[1:]}
    sizes = {str(dim): size for dim, size in data["position"].sizes.items()}
    labels["individual"] = labels["individual"] or [f"individual_{i}" for i in range(sizes["individual"])]
    labels["space"] = labels["space"] or list("xyz"[: sizes["space"]])
    if labels["space"] not in (["x", "y"], ["x", "y", "z"]):
        problems.append(Problem(path, "space", ", ".join(labels["space"]), "x, y or x, y, z"))
    problems += name_problems(path, "keypoint", labels["keypoint"])
    problems += name_problems(path, "individual", labels["individual"])
    values = data["position"].transpose(*POSITION).values.astype(float)
    if not sizes["time"]:
        problems.append(Problem(path, "time", "no frames", "at least one"))
    if np.isinf(values).any():
        problems.append(Problem(path, "position", "infinite coordinates", "numbers, or NaN where missing"))
    if problems:
        raise InputError(problems)
    confidence = np.full(values.shape[:-1], np.nan)
    if "confidence" in data:
        confidence = data["confidence"].transpose(*CONFIDENCE).values.astype(float)
    fps = rate(data.attrs.get("fps"))
    time = data["time"].values if "time" in data.coords else np.arange(sizes["time"])
    # Without the attribute, whole numbers are frames.
    in_frames = data.attrs.get("time_unit", "frames" if time.dtype.kind in "iu" else "seconds") == "frames"
    if in_frames:
        frames, _ = frames_of_times(path, time.astype(float), 1.0)
    else:
        frames, fps = frames_of_times(path, time.astype(float), fps)
    return _File(
        names=tuple(labels["keypoint"]),
        animals=labels["individual"],
        values=values,
        confidence=confidence,
        frames=frames,
        fps=fps,
        unit=UNIT_NAMES.get(str(data.attrs.get("length_unit"))),
        up={"x": "x", "y": "y", "z": "z"}.get(str(data.attrs.get("up_axis"))),
    )
