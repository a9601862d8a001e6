"""OpenPose's JSON, a file for each frame: any one of them stands for all of its folder that are called alike.

OpenPose calls them run_000000000012_keypoints.json, RTMPose's tools, which write the same, run_000012.json; the number
is the frame's. Points have no names there: how many there are says which list it is. Persons are numbered from 1 as
each frame has them, which nothing ties to the frame before: with several, the files have to be tracked first.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from recon.base.documents import read_json
from recon.base.errors import InputError, Problem
from recon.io import coco
from recon.io.common import starts_with_text
from recon.io.pose import StoredPoints

KEY = "pose_keypoints_2d"
_COCO = "Nose LEye REye LEar REar LShoulder RShoulder LElbow RElbow LWrist RWrist LHip RHip LKnee RKnee LAnkle RAnkle"
_TOES = "LBigToe RBigToe LSmallToe RSmallToe LHeel RHeel"
_BODY = "Nose Neck RShoulder RElbow RWrist LShoulder LElbow LWrist"
LISTS = {
    len(names): names
    for names in (
        _COCO.split(),
        f"{_BODY} RHip RKnee RAnkle LHip LKnee LAnkle REye LEye REar LEar".split(),
        f"{_BODY} MidHip RHip RKnee RAnkle LHip LKnee LAnkle REye LEye REar LEar LBigToe LSmallToe LHeel "
        "RBigToe RSmallToe RHeel".split(),
        f"{_COCO} Head Neck Hip {_TOES}".split(),
    )
}
"""By their number: COCO's 17, OpenPose's COCO with a neck (18), BODY_25, and Halpe's 26, each in its order."""
_NAME = re.compile(r"(.*?)(\d+)((?:_keypoints)?\.json)", re.IGNORECASE | re.DOTALL)


def recognises(path: Path) -> bool:
    return starts_with_text(path, b"{") and b'"people"' in path.read_bytes()[: 1 << 16]


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The points of one person in the frames of all files that are called as this one but for the number. Raises
    InputError."""
    found = _NAME.fullmatch(path.name)
    if found is None:
        raise InputError(Problem(path, "file", "a name without a number", "a frame's, as run_000012_keypoints.json"))
    files = {path: int(found[2])}
    for other in path.parent.iterdir():
        named = _NAME.fullmatch(other.name)
        if named and (named[1], named[3]) == (found[1], found[3]):
            files[other] = int(named[2])
    images, annotations, counts = [], [], set()
    several = False
    for file, number in sorted(files.items(), key=lambda item: item[1]):
        images.append({"id": number, "frame_id": number})
        people = _people(file)
        several |= len(people) > 1
        for k, points in enumerate(people):
            counts.add(len(points))
            known = np.isfinite(points).all(axis=1) & (points[:, 2] > 0)
            flat = np.where(known[:, None], points, 0.0)
            annotations.append(
                {
                    "id": f"of frame {number}",
                    "image_id": number,
                    "keypoints": flat.ravel().tolist(),
                    "keypoint_scores": flat[:, 2].tolist(),
                    "track_id": str(k + 1),
                }
            )
    if len(counts) > 1 or not counts <= {*LISTS}:
        expected = f"one number of points throughout, of {', '.join(map(str, LISTS))}"
        raise InputError(Problem(path, KEY, " and ".join(map(str, sorted(counts))), expected))
    if not several:
        for annotation in annotations:
            del annotation["track_id"]
    categories = [{"id": 1, "keypoints": LISTS[counts.pop()] if counts else LISTS[25]}]
    return coco.of_content(path, {"images": images, "annotations": annotations, "categories": categories}, individual)


def _people(file: Path) -> list[np.ndarray]:
    """(K, 3) of each: x, y, confidence."""
    content = read_json(file, "a whole file of JSON")
    try:
        rows = [np.array(person[KEY], dtype=float) for person in content["people"]]
        return [row.reshape(-1, 3) for row in rows if row.size]
    except (KeyError, TypeError, AttributeError, ValueError, IndexError):
        raise InputError(Problem(file, "people", f"entries without {KEY}", "x, y, confidence of each point")) from None
