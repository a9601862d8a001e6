"""SLEAP's analysis H5 of one track (see `recon.io.sleap`): the frame axis starts at frame 0 of the video.

Frames that the input lacks are not occupied. The frame rate, for which there is no place, is in `provenance`.
"""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path

import numpy as np

from recon.export.checks import require_span
from recon.files import write_bytes
from recon.io.common import formats_extra
from recon.io.sleap import ORDERS
from recon.keypoints import Keypoints

TITLE = "SLEAP analysis H5"


def write(keypoints: Keypoints, path: Path) -> None:
    with formats_extra(TITLE):
        import h5py
    T, K = int(keypoints.frames[-1]) + 1, len(keypoints.names)
    require_span(T, K, TITLE)
    tracks, scores = np.full((1, 2, K, T), np.nan), np.full((1, K, T), np.nan)
    tracks[0, :, :, keypoints.frames] = keypoints.xy_px.transpose(0, 2, 1)
    scores[0, :, keypoints.frames] = keypoints.confidence
    occupied = np.zeros((T, 1), np.uint8)
    occupied[keypoints.frames] = 1
    instance_scores = np.where(occupied.T == 1, 1.0, np.nan)
    named = [] if keypoints.individual is None else [keypoints.individual.encode()]
    provenance = {"written_by": "recon"} | ({} if keypoints.fps is None else {"fps": keypoints.fps})
    made = BytesIO()
    with h5py.File(made, "w") as file:
        for name, array in (("tracks", tracks), ("point_scores", scores), ("track_occupancy", occupied)):
            file.create_dataset(name, data=array, compression="gzip").attrs["dims"] = json.dumps(ORDERS[name])
        for name in ("instance_scores", "tracking_scores"):
            dataset = file.create_dataset(name, data=instance_scores, compression="gzip")
            dataset.attrs["dims"] = json.dumps(("track", "frame"))
        file["node_names"] = np.array([name.encode() for name in keypoints.names])
        file["track_names"] = np.array(named)
        file["edge_names"], file["edge_inds"] = np.zeros((0, 2)), np.zeros((0, 2), np.int32)
        file["labels_path"], file["video_path"], file["video_ind"] = "", "", np.int32(0)
        file["provenance"] = json.dumps(provenance)
        file.attrs["preset"], file.attrs["format"] = "matlab", "analysis"
    write_bytes(path, made.getvalue())
