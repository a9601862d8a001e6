"""NWB with the extension ndx-pose: one `PoseEstimation` with a series for each point (see `recon.io.nwb`).

A session's start, which NWB asks for and nobody knows here, is given as 1970-01-01.
"""

from __future__ import annotations

from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np

from recon.export.checks import require_names, required_fps
from recon.files import write_bytes
from recon.io.common import formats_extra
from recon.io.nwb import RATE_TEXT, UP_TEXT
from recon.io.pose import Pose3D, index_edges
from recon.keypoints import Keypoints

TITLE = "ndx-pose NWB"
NO_NAMES = r"[/:]"


def write_keypoints(keypoints: Keypoints, path: Path) -> None:
    """x, y in pixels. Raises InputError without a frame rate, or for names that NWB cannot hold."""
    named = keypoints.individual or "PoseEstimation"
    reference = "(0, 0) is the upper left corner of the picture, x to the right, y down"
    confidence = keypoints.confidence
    _write(path, named, keypoints.names, keypoints.xy_px, confidence, keypoints.frames, keypoints.fps, (), reference)


def write_pose(pose: Pose3D, path: Path) -> None:
    """x, y, z in metres, z up; joints that are linked are the skeleton's edges. Raises InputError likewise."""
    reference = f"x, y and z in metres, right-handed, {UP_TEXT}"
    _write(path, "PoseEstimation", pose.names, pose.xyz_m, None, pose.frames, pose.fps, pose.edges, reference)


def _write(
    path: Path,
    container: str,
    names: tuple[str, ...],
    values: np.ndarray,
    confidence: np.ndarray | None,
    frames: np.ndarray,
    fps: float | None,
    edges: tuple[tuple[str, str], ...],
    reference: str,
) -> None:
    """values (T, K, 2 or 3), confidence (T, K)."""
    fps = float(required_fps(fps, TITLE))
    require_names((container, *names), NO_NAMES, TITLE)
    with formats_extra(TITLE):
        import h5py
        from ndx_pose import PoseEstimation, PoseEstimationSeries, Skeleton, Skeletons
        from pynwb import NWBHDF5IO, NWBFile
    regular = int(frames[-1] - frames[0]) + 1 == len(frames)
    time = {"rate": fps, "starting_time": frames[0] / fps} if regular else {"timestamps": frames / fps}
    series = []
    for k, name in enumerate(names):
        more: dict[str, Any] = {} if confidence is None else {"confidence": confidence[:, k]}
        more |= {"confidence_definition": "likelihood of the detection, 0 to 1"} if more else {}
        series.append(
            PoseEstimationSeries(
                name=name,
                data=values[:, k],
                unit="pixels" if values.shape[2] == 2 else "metres",
                reference_frame=reference,
                comments=RATE_TEXT.format(fps=fps),
                **time,
                **more,
            )
        )
    linked = {"edges": index_edges(names, edges).astype(np.uint8)} if edges and len(names) < 256 else {}
    skeleton = Skeleton(name="skeleton", nodes=list(names), **linked)
    poses = PoseEstimation(
        name=container,
        pose_estimation_series=series,
        description="Points of one animal.",
        scorer="recon",
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
