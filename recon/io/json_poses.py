"""Keypoints as JSON: COCO's, and MMPose's and OpenPose's, which are put the same way; and FMPose3D's 3D poses.

- COCO: `images`, `annotations` with `keypoints` [x, y, v, ...], and `categories` with their names. v is 0 for a missing
  point. A score for each point is read from `keypoint_scores`, where there is one. The animal of an annotation is its
  `individual`, as our own files have it, or its `track_id`. Ours have the frame rate in `info`, and an annotation for
  each frame in which a point is known.
- MMPose: `meta_info` with the keypoints' names, `instance_info` with the animals of each frame. Its demo scripts write
  them (`--save-predictions`), and count a video's frames from 1.
- OpenPose: a file for each frame; any one of them stands for all of its folder that are called alike:
  run_000000000012_keypoints.json, or run_000012.json of RTMPose's tools, which write the same; the number is the
  frame's. Points have no names there: how many there are says which list it is. Persons are numbered from 1 as each
  frame has them, which nothing ties to the frame before: with several, the files have to be tracked first.
- FMPose3D: `run_DLC_fmpose3d_animals_3d.json` of DeepLabCut, with `model`, `bodyparts`, `poses_3d`. A pose is of one
  picture: relative to a point of the body, in the camera's axes and in the network's own unit. Frames are numbered from
  0, and those without an animal are empty. Beside it lies the same as a table, `..._3d.h5`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.documents import read_json
from recon.base.errors import InputError, Problem, refuse
from recon.clip.keypoints import Keypoints
from recon.io.common import (
    FMPOSE3D,
    MAX_FRAME,
    choose,
    damage_named,
    first_problems,
    name_problems,
    rate,
    starts_with_text,
)
from recon.io.pose import StoredPoints

FRAME_KEYS = ("frame_id", "frame_index", "frame_number")
_EXPECTED = "a whole file of JSON"
Table = dict[str, Any]


def _mentions(path: Path, *keys: bytes) -> bool:
    """Whether it is JSON with one of the keys; it need not be whole."""
    content = path.read_bytes() if starts_with_text(path, b"{") else b""
    return any(b'"%s"' % key in content for key in keys)


# -- COCO -------------------------------------------------------------------------------------------------------------


def recognises_coco(path: Path) -> bool:
    return _mentions(path, b"images") and _mentions(path, b"annotations", b"categories")


def read_coco(path: Path, individual: str | None = None) -> StoredPoints:
    """The keypoints of one animal. Raises InputError."""
    content = read_json(path, _EXPECTED)
    if not isinstance(content, dict):
        raise InputError(Problem(path, "content", "something else than a table", "COCO keypoints"))
    return _of_content(path, content, individual)


def _of_content(path: Path, content: Table, individual: str | None) -> StoredPoints:
    """The same of what such a file has, or another format's put the same way."""
    missing = [key for key in ("images", "annotations", "categories") if not isinstance(content.get(key), list)]
    refuse(Problem(path, key, "no list", "a list") for key in missing)
    with damage_named(path, "entries as COCO has them for keypoints", "images, annotations, categories"):
        return _keypoints(path, content, individual)


def _keypoints(path: Path, content: Table, individual: str | None) -> StoredPoints:
    annotations: list[Table] = [one for one in content["annotations"] if "keypoints" in one]
    names = _names(path, content["categories"], content["annotations"])
    numbers, notes = _frame_numbers(path, content["images"])
    frames = np.array(sorted(numbers.values()), dtype=np.int64)
    row = {image: int(np.searchsorted(frames, number)) for image, number in numbers.items()}
    named = [one.get("individual", one.get("track_id")) for one in annotations]
    animals = list(dict.fromkeys("" if name is None else str(name) for name in named)) or [""]
    if "" in animals and len(animals) > 1:
        expected = "one for each animal in every annotation"
        raise InputError(Problem(path, "annotations", "some without track_id", expected))
    chosen = animals[choose(path, animals, individual)]
    xy, score = np.full((len(frames), len(names), 2), np.nan), np.zeros((len(frames), len(names)))
    problems: list[Problem] = []
    taken: set[int] = set()
    for annotation, name in zip(annotations, named, strict=True):
        if ("" if name is None else str(name)) != chosen:
            continue
        where, image = f"annotation {annotation.get('id', '?')}", annotation["image_id"]
        values = np.asarray(annotation["keypoints"], dtype=float)
        scores = np.array([np.nan if s is None else s for s in annotation.get("keypoint_scores", ())], dtype=float)
        if values.shape != (3 * len(names),) or len(scores) not in (0, len(names)):
            found = f"{values.size} numbers and {len(scores)} scores"
            problems.append(Problem(path, where, found, f"x, y, v for each of {len(names)} keypoints"))
        elif image not in row:
            problems.append(Problem(path, where, f"image {image}", "an image of the file"))
        elif row[image] in taken:
            expected = "one animal, or a track_id for each"
            problems.append(Problem(path, where, f"a second animal in image {image}", expected))
        else:
            taken.add(row[image])
            known = values[2::3] > 0
            xy[row[image]] = np.where(known[:, None], values.reshape(-1, 3)[:, :2], np.nan)
            score[row[image]] = scores if len(scores) else np.where(known, np.nan, 0.0)
    if not frames.size:
        problems.append(Problem(path, "images", "none", "at least one"))
    refuse(first_problems(problems, path))
    info = content.get("info")
    return StoredPoints(
        names,
        xy,
        frames,
        score,
        fps=rate(info.get("fps")) if isinstance(info, dict) else None,
        image_size_px=_size(content["images"]),
        # The number of the only track is no name.
        individual=chosen if len(animals) > 1 or any("individual" in one for one in annotations) else None,
        notes=notes,
    )


def _names(path: Path, categories: list[Table], annotations: list[Table]) -> tuple[str, ...]:
    """The keypoints of the one category that is used."""
    used = {a.get("category_id") for a in annotations}
    with_points = [c for c in categories if c.get("keypoints") and (c.get("id") in used or len(categories) == 1)]
    lists = {tuple(str(name) for name in c["keypoints"]) for c in with_points}
    if len(lists) != 1:
        raise InputError(Problem(path, "categories", f"{len(lists)} lists of keypoints in use", "one"))
    (names,) = lists
    refuse(name_problems(path, "categories, keypoints", names))
    return names


def _frame_numbers(path: Path, images: list[Table]) -> tuple[dict[Any, int], tuple[str, ...]]:
    """Image id to frame number: as stated, else from the ends of the file names, else the id."""
    ids = [image["id"] for image in images]
    key = next((k for k in FRAME_KEYS if images and all(isinstance(image.get(k), int) for image in images)), None)
    ends = [re.search(r"([0-9]{1,15})$", Path(str(image.get("file_name", ""))).stem) for image in images]
    if key is not None:
        numbers, notes = [image[key] for image in images], ()
    elif all(ends):
        numbers, notes = [int(end[1]) for end in ends if end], ("Frames are numbered as the images' file names.",)
    else:
        numbers, notes = ids, ("Frames are numbered by the images' ids.",)
    if len(set(numbers)) != len(numbers) or len(set(ids)) != len(ids) or not all(type(n) is int for n in numbers):
        raise InputError(Problem(path, "images", "frame numbers that are not unique", "one image for each frame"))
    if numbers and not -MAX_FRAME <= min(numbers) <= max(numbers) <= MAX_FRAME:
        found = f"frame numbers from {min(numbers):.15g} to {max(numbers):.15g}"
        raise InputError(Problem(path, "images", found, "0, 1, 2, ..."))
    return dict(zip(ids, numbers, strict=True)), notes


def _size(images: list[Table]) -> tuple[int, int] | None:
    """(width, height), where all images have the same."""
    sizes = {(image.get("width"), image.get("height")) for image in images}
    (width, height) = sizes.pop() if len(sizes) == 1 else (None, None)
    return (width, height) if isinstance(width, int) and isinstance(height, int) and width > 0 < height else None


def write_coco(keypoints: Keypoints, path: Path) -> None:
    size = (
        {} if keypoints.image_size_px is None else dict(zip(("width", "height"), keypoints.image_size_px, strict=True))
    )
    named = {} if keypoints.individual is None else {"individual": keypoints.individual}
    images, annotations = [], []
    for t, frame in enumerate(keypoints.frames.tolist()):
        images.append({"id": t + 1, "file_name": f"frame_{frame:06d}.png", "frame_id": frame, **size})
        known = keypoints.present[t]
        if known.any():
            points = np.column_stack([np.where(known[:, None], keypoints.xy_px[t], 0.0), 2 * known])
            low, high = keypoints.xy_px[t][known].min(axis=0), keypoints.xy_px[t][known].max(axis=0)
            width, height = (high - low).tolist()
            annotations.append(
                {
                    "id": t + 1,
                    "image_id": t + 1,
                    "category_id": 1,
                    "track_id": 1,
                    "keypoints": points.ravel().tolist(),
                    "num_keypoints": int(known.sum()),
                    "keypoint_scores": [None if c != c else c for c in keypoints.confidence[t].tolist()],
                    "bbox": [*low.tolist(), width, height],
                    "area": width * height,
                    "iscrowd": 0,
                    **named,
                }
            )
    rate_hz = {} if keypoints.fps is None else {"fps": keypoints.fps}
    content = {
        "info": {"description": "keypoints of one animal", "contributor": "recon", **rate_hz},
        "images": images,
        "annotations": annotations,
        "categories": [{"id": 1, "name": "animal", "keypoints": list(keypoints.names), "skeleton": []}],
    }
    path.write_text(json.dumps(content, ensure_ascii=False, allow_nan=False) + "\n", encoding="utf-8")


# -- MMPose -----------------------------------------------------------------------------------------------------------


def recognises_mmpose(path: Path) -> bool:
    return _mentions(path, b"instance_info")


def read_mmpose(path: Path, individual: str | None = None) -> StoredPoints:
    """The keypoints of one animal. Raises InputError."""
    content = read_json(path, _EXPECTED)
    with damage_named(path, "meta_info and instance_info as MMPose writes them for a video"):
        names = content["meta_info"]["keypoint_id2name"]
        names = [str(names[str(k)]) for k in range(len(names))]
        frames = {frame["frame_id"]: frame["instances"] for frame in content["instance_info"]}
        first = min(1, min(frames, default=1))
        annotations = [
            {
                "image_id": number,
                "keypoints": [value for x, y in one["keypoints"] for value in (x, y, 2)],
                "keypoint_scores": one["keypoint_scores"],
                **({"track_id": one["track_id"]} if "track_id" in one else {}),
            }
            for number, instances in frames.items()
            for one in instances
        ]
        images = [{"id": number, "frame_id": number - first} for number in frames]
    categories = [{"keypoints": names}]
    return _of_content(path, {"images": images, "annotations": annotations, "categories": categories}, individual)


# -- OpenPose ---------------------------------------------------------------------------------------------------------

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
_FILE_NAME = re.compile(r"(.*?)(\d+)((?:_keypoints)?\.json)", re.IGNORECASE | re.DOTALL)


def recognises_openpose(path: Path) -> bool:
    return _mentions(path, b"people")


def read_openpose(path: Path, individual: str | None = None) -> StoredPoints:
    """The points of one person in the frames of all files that are called as this one but for the number. Raises
    InputError."""
    own = _FILE_NAME.fullmatch(path.name)
    if own is None:
        raise InputError(Problem(path, "file", "a name without a number", "a frame's, as run_000012_keypoints.json"))
    named = {path: own} | {
        other: found for other in path.parent.iterdir() if (found := _FILE_NAME.fullmatch(other.name))
    }
    files = {file: int(found[2]) for file, found in named.items() if (found[1], found[3]) == (own[1], own[3])}
    annotations: list[Table] = []
    counts = set()
    for file, number in sorted(files.items(), key=lambda item: item[1]):
        content = read_json(file, _EXPECTED)
        with damage_named(file, "x, y, confidence of each point", "people"):
            rows = [np.array(person[KEY], dtype=float) for person in content["people"]]
            people = [row.reshape(-1, 3) for row in rows if row.size]
        for k, points in enumerate(people, start=1):
            counts.add(len(points))
            known = np.isfinite(points).all(axis=1) & (points[:, 2] > 0)
            flat = np.where(known[:, None], points, 0.0)
            scores = flat[:, 2].tolist()
            place = {"id": f"of frame {number}", "image_id": number, "track_id": str(k)}
            annotations.append({**place, "keypoints": flat.ravel().tolist(), "keypoint_scores": scores})
    if len(counts) > 1 or not counts <= {*LISTS}:
        expected = f"one number of points throughout, of {', '.join(map(str, LISTS))}"
        raise InputError(Problem(path, KEY, " and ".join(map(str, sorted(counts))), expected))
    if all(annotation["track_id"] == "1" for annotation in annotations):
        annotations = [{key: value for key, value in one.items() if key != "track_id"} for one in annotations]
    images = [{"id": number, "frame_id": number} for number in sorted(files.values())]
    categories = [{"keypoints": LISTS[counts.pop()] if counts else LISTS[25]}]
    return _of_content(path, {"images": images, "annotations": annotations, "categories": categories}, individual)


# -- FMPose3D ---------------------------------------------------------------------------------------------------------

_BY_DEEPLABCUT = (
    "left_eye right_eye nose neck root_of_tail left_shoulder left_elbow left_front_paw right_shoulder right_elbow "
    "right_front_paw left_hip left_knee left_back_paw right_hip right_knee right_back_paw withers throat left_ear "
    "right_ear mouth chin left_hock right_hock tail_tip"
)
"""Names in the network's order, by DeepLabCut (3.0, 2026): another list's, so that the left front paw is "neck"."""
_ANIMAL3D = (
    "left_eye right_eye mouth_mid left_front_paw right_front_paw left_back_paw right_back_paw tail_base "
    "left_front_thigh right_front_thigh left_back_thigh right_back_thigh left_shoulder right_shoulder left_front_knee "
    "right_front_knee left_back_knee right_back_knee neck tail_end left_ear right_ear left_mouth right_mouth nose "
    "tail_mid"
)
"""Their own, Animal3D's: that of FMPose3D's conversion from SuperAnimal's points."""
LENGTHS = (
    "FMPose3D's lengths have no unit, and its axes are the camera's: compare them after scaling and turning (PA) only."
)


def true_names(names: Sequence[str], model: str, in_space: bool = True) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of FMPose3D's points, in any order, and notes, also where they were not those of the points. model: what
    found them, or a table's scorer, which has it."""
    notes = (LENGTHS,) if in_space else ()
    true: dict[str, str] = dict(zip(_BY_DEEPLABCUT.split(), _ANIMAL3D.split(), strict=True))
    if f"{FMPOSE3D}animals" not in model or {*names} != {*true}:
        return tuple(names), notes
    note = (
        "DeepLabCut gives FMPose3D's points the names of other points (the left front paw is 'neck'): they are read by "
        "their order, which is Animal3D's."
    )
    return tuple(true[name] for name in names), (note, *notes)


def recognises_fmpose3d(path: Path) -> bool:
    return _mentions(path, b"poses_3d")


def read_fmpose3d(path: Path, individual: str | None = None) -> StoredPoints:
    """The poses of the one animal. Raises InputError."""
    choose(path, [""], individual)
    content = read_json(path, _EXPECTED)
    with damage_named(path, "bodyparts, and poses_3d with x, y, z of each in every frame"):
        written, poses = tuple(map(str, content["bodyparts"])), list(content["poses_3d"])
        values = np.full((len(poses), len(written), 3), np.nan)
        for frame, pose in enumerate(poses):
            if pose:
                values[frame] = np.array(pose, dtype=float)
    problems = name_problems(path, "bodyparts", written)
    if not poses:
        problems.append(Problem(path, "poses_3d", "no frames", "at least one frame"))
    refuse(problems)
    names, notes = true_names(written, str(content.get("model")))
    return StoredPoints(names, values, np.arange(len(values)), notes=notes)
