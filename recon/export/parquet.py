"""Parquet table of 3D positions, one row for each frame and joint: frame, joint, x_m, y_m, z_m (metres, z up).

The frame rate is in the metadata, as JSON under the key `recon`.
"""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path

import numpy as np

from recon.files import write_bytes
from recon.io.common import formats_extra
from recon.io.parquet import METADATA
from recon.io.pose import Pose3D


def write(pose: Pose3D, path: Path) -> None:
    with formats_extra("Parquet"):
        import pyarrow as pa
        import pyarrow.parquet as pq
    T, J = pose.xyz_m.shape[:2]
    table = pa.table(
        {
            "frame": pa.array(np.repeat(pose.frames, J), pa.int64()),
            "joint": pa.array(list(pose.names) * T, pa.string()),
            **{f"{axis}_m": pa.array(pose.xyz_m[..., i].ravel(), pa.float64()) for i, axis in enumerate("xyz")},
        }
    )
    about = {"fps": pose.fps, "unit": "m", "up": "z"}
    made = BytesIO()
    pq.write_table(table.replace_schema_metadata({METADATA: json.dumps(about)}), made)
    write_bytes(path, made.getvalue())
