"""MMPose's predictions as JSON: `meta_info` with the keypoints' names, `instance_info` with the animals of each frame.

Its demo scripts write them (`--save-predictions`), and count a video's frames from 1. The animal of an instance is its
`track_id`, where there is one.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from recon.base.documents import read_json
from recon.base.errors import InputError, Problem
from recon.io import coco
from recon.io.common import starts_with_text
from recon.io.pose import StoredPoints


def recognises(path: Path) -> bool:
    return starts_with_text(path, b"{") and b'"instance_info"' in path.read_bytes()


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The keypoints of one animal. Raises InputError."""
    content = read_json(path, "a whole file of JSON")
    try:
        names = content["meta_info"]["keypoint_id2name"]
        names = [str(names[str(k)]) for k in range(len(names))]
        frames = {frame["frame_id"]: frame["instances"] for frame in content["instance_info"]}
        first = min(1, min(frames, default=1))
        images = [{"id": number, "frame_id": number - first} for number in frames]
        annotations = [_annotation(number, one) for number, instances in frames.items() for one in instances]
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        found = f"an entry without {error}" if isinstance(error, KeyError) else f"an entry of another form ({error})"
        expected = "meta_info and instance_info as MMPose writes them for a video"
        raise InputError(Problem(path, "content", found, expected)) from None
    categories = [{"id": 1, "keypoints": names}]
    return coco.of_content(path, {"images": images, "annotations": annotations, "categories": categories}, individual)


def _annotation(frame: int, instance: dict[str, Any]) -> dict[str, Any]:
    """As COCO has it: x, y, v of each point."""
    points = [value for x, y in instance["keypoints"] for value in (x, y, 2)]
    tracked = {"track_id": instance["track_id"]} if "track_id" in instance else {}
    scores = instance["keypoint_scores"]
    return {"image_id": frame, "category_id": 1, "keypoints": points, "keypoint_scores": scores, **tracked}
