"""movement's netCDF of poses (see `recon.io.movement`), with the dimension names of movement 0.17.

Time is in seconds since frame 0 where the frame rate is known, and otherwise in frames. 3D files state unit and axes
in the attributes `length_unit` and `up_axis`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from recon.files import write_bytes
from recon.io.common import UNNAMED, formats_extra
from recon.io.pose import Pose3D
from recon.keypoints import Keypoints

TITLE = "movement netCDF"


def write_keypoints(keypoints: Keypoints, path: Path) -> None:
    named = keypoints.individual or UNNAMED[0]
    _write(path, keypoints.names, keypoints.xy_px, keypoints.confidence, keypoints.frames, keypoints.fps, named, {})


def write_pose(pose: Pose3D, path: Path) -> None:
    """x, y, z in metres, z up; the confidence, which the format asks for, is NaN."""
    unknown = np.full(pose.xyz_m.shape[:2], np.nan)
    axes = {"length_unit": "m", "up_axis": "z"}
    _write(path, pose.names, pose.xyz_m, unknown, pose.frames, pose.fps, UNNAMED[0], axes)


def _write(
    path: Path,
    names: tuple[str, ...],
    values: np.ndarray,
    confidence: np.ndarray,
    frames: np.ndarray,
    fps: float | None,
    individual: str,
    more: dict[str, Any],
) -> None:
    """values (T, K, 2 or 3), confidence (T, K)."""
    with formats_extra(TITLE):
        import h5netcdf  # noqa: F401  what xarray writes with
        import xarray
    attributes = {"source_software": "recon", "ds_type": "poses", "source_file": "", **more}
    attributes |= {"time_unit": "frames"} if fps is None else {"time_unit": "seconds", "fps": fps}
    data = xarray.Dataset(
        data_vars={
            "position": (("time", "space", "keypoint", "individual"), values.transpose(0, 2, 1)[..., None]),
            "confidence": (("time", "keypoint", "individual"), confidence[..., None]),
        },
        coords={
            "time": frames if fps is None else frames / fps,
            "space": list("xyz"[: values.shape[-1]]),
            "keypoint": list(names),
            "individual": [individual],
        },
        attrs=attributes,
    )
    write_bytes(path, bytes(data.to_netcdf(None, engine="h5netcdf")))
