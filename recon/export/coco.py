"""COCO keypoints as JSON (see `recon.io.coco`): an image for each frame, an annotation where a point is known.

COCO has no likelihoods and no frame rate: they are in `keypoint_scores` of an annotation and `fps` of `info`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from recon.keypoints import Keypoints


def write(keypoints: Keypoints, path: Path) -> None:
    width, height = keypoints.image_size_px or (None, None)
    size = {} if width is None else {"width": width, "height": height}
    images, annotations = [], []
    present = keypoints.present
    for t, frame in enumerate(keypoints.frames.tolist(), start=1):
        images.append({"id": t, "file_name": f"frame_{frame:06d}.png", "frame_id": frame, **size})
        if present[t - 1].any():
            annotations.append(_annotation(keypoints, t - 1, present[t - 1]))
    content = {
        "info": {"description": "keypoints of one animal", "contributor": "recon"}
        | ({} if keypoints.fps is None else {"fps": keypoints.fps}),
        "images": images,
        "annotations": annotations,
        "categories": [{"id": 1, "name": "animal", "keypoints": list(keypoints.names), "skeleton": []}],
    }
    path.write_text(json.dumps(content, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


def _annotation(keypoints: Keypoints, t: int, known: np.ndarray) -> dict[str, Any]:
    """known: (K,) bool."""
    points = np.where(known[:, None], keypoints.xy_px[t], 0.0)
    triples = [[x, y, 2 * int(k)] for (x, y), k in zip(points.tolist(), known.tolist(), strict=True)]
    low, high = keypoints.xy_px[t][known].min(axis=0), keypoints.xy_px[t][known].max(axis=0)
    (width, height) = (high - low).tolist()
    annotation = {
        "id": t + 1,
        "image_id": t + 1,
        "category_id": 1,
        "track_id": 1,
        "keypoints": [value for triple in triples for value in triple],
        "num_keypoints": int(known.sum()),
        "keypoint_scores": [None if c != c else c for c in keypoints.confidence[t].tolist()],
        "bbox": [*low.tolist(), width, height],
        "area": width * height,
        "iscrowd": 0,
    }
    return annotation | ({} if keypoints.individual is None else {"individual": keypoints.individual})
