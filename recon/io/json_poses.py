"""Read JSON files of keypoints (COCO, MMPose, OpenPose, AlphaPose) and of FMPose3D's 3D poses.

- COCO: `images`, `annotations` with `keypoints` [x, y, v, ...], and `categories` with their names. v is 0 for a missing
  point. Scores are read from `keypoint_scores` if present. The animal of an annotation is its `individual`, as in files
  of recon 0.2, or its `track_id`. Those files have the frame rate in `info`.
- MMPose: `meta_info` with the keypoints' names, `instance_info` with the animals of each frame. Its demo scripts write
  them (`--save-predictions`), and count a video's frames from 1.
- OpenPose: a file for each frame. Any of them stands for all files in its folder whose names differ only in the frame
  number: run_000000000012_keypoints.json, or run_000012.json from RTMPose's tools, which write the same format. Points
  have no names, so the number of points determines the list of names. Persons are numbered from 1 within each frame,
  independently of the previous frame, so files with several persons have to be tracked first.
- AlphaPose: a list with `image_id`, `keypoints` and perhaps the track `idx` of each detection, as in COCO's results.
  The points have no names, as in OpenPose's files.
- FMPose3D: `run_DLC_fmpose3d_animals_3d.json` of DeepLabCut, with `model`, `bodyparts`, `poses_3d`. Each pose is
  estimated from one picture, relative to a point of the body, in the network's own axes and unit. Frames are numbered
  from 0, and those without an animal are empty. The same folder has the same poses as a table, `..._3d.h5`. FMPose3D's
  own demo writes `.npz` files (`recon.io.npz`).
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from recon.base.documents import damage_as_input_error, read_json
from recon.base.errors import InputError, Problem, raise_problems
from recon.io import common
from recon.io.common import StoredPoints

_EXPECTED = "a complete JSON file"
Table = dict[str, Any]


class _Seen(NamedTuple):
    """Keypoints of one animal in one picture."""

    location: str
    """Location in the file, for messages."""
    frame: int
    animal: str
    """Name or number of the animal; empty if the file does not distinguish animals."""
    xy_px: np.ndarray
    """Positions of the keypoints in pixels, shape (K, 2); NaN if missing."""
    score: np.ndarray
    """Scores of the keypoints, shape (K,); 0 for a missing keypoint, NaN if the file states no score."""


def _mentions(path: Path, *keys: bytes) -> bool:
    """Return whether a file is JSON with one of the keys, even if the JSON is cut off."""
    content = path.read_bytes() if common.starts_with_text(path, b"{") else b""
    return any(b'"%s"' % key in content for key in keys)


def _points(
    path: Path,
    individual: str | None,
    names: Sequence[str],
    frames: Iterable[int],
    seen: Sequence[_Seen],
    named: bool = False,
    **extra: Any,
) -> StoredPoints:
    """Return the points of one animal in all frames from its detections in a JSON file of any format.

    `named` states whether the only animal of a file has a name.

    Raises
    ------
    InputError
        If detections do not match the names, or if an animal appears twice in a frame.
    """
    animals = list(dict.fromkeys(detection.animal for detection in seen)) or [""]
    chosen = animals[common.choose(path, animals, individual)]
    numbers = np.array(sorted(frames), dtype=np.int64)
    common.require_span(len(numbers), len(names), path)
    row = {int(number): t for t, number in enumerate(numbers)}
    xy, score = np.full((len(numbers), len(names), 2), np.nan), np.zeros((len(numbers), len(names)))
    problems: list[Problem] = []
    filled_frames: set[int] = set()
    for detection in (detection for detection in seen if detection.animal == chosen):
        if detection.xy_px.shape != xy.shape[1:] or detection.score.shape != score.shape[1:]:
            detail = f"{len(detection.xy_px)} points and {len(detection.score)} scores"
            problems.append(
                Problem(path, detection.location, detail, f"a point and a score for each of {len(names)} keypoints")
            )
        elif detection.frame in filled_frames:
            detail = f"a second animal in frame {detection.frame}"
            problems.append(Problem(path, detection.location, detail, "one animal, or a track_id for each animal"))
        else:
            filled_frames.add(detection.frame)
            xy[row[detection.frame]], score[row[detection.frame]] = detection.xy_px, detection.score
    raise_problems(common.first_problems(problems, path))
    animal_names = [chosen or common.UNTRACKED] if len(animals) > 1 or named else []
    return common.one_animal(path, None, StoredPoints(tuple(names), xy, numbers, score, **extra), animal_names)


def recognises_coco(path: Path) -> bool:
    """Return whether a file is COCO's JSON."""
    return _mentions(path, b"images") and _mentions(path, b"annotations", b"categories")


def read_coco(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the keypoints of one animal in COCO's JSON."""
    content = read_json(path, _EXPECTED)
    people = [annotation for annotation in content["annotations"] if "keypoints" in annotation]
    numbers, notes = _frame_numbers(path, content["images"])
    seen = []
    for annotation in people:
        points = np.asarray(annotation["keypoints"], dtype=float).reshape(-1, 3)
        known = points[:, 2] > 0
        xy = np.where(known[:, None], points[:, :2], np.nan)
        stated = [np.nan if score is None else score for score in annotation.get("keypoint_scores", ())]
        score = np.array(stated, dtype=float) if stated else np.where(known, np.nan, 0.0)
        animal = annotation.get("individual", annotation.get("track_id"))
        location = f"annotation {annotation.get('id', '?')}", numbers[annotation["image_id"]]
        seen.append(_Seen(*location, "" if animal is None else str(animal), xy, score))
    info, names = content.get("info"), _names(path, content["categories"], people)
    extra: dict[str, Any] = {"fps": common.rate(info.get("fps")) if isinstance(info, dict) else None, "notes": notes}
    extra["image_size_px"] = _size(content["images"])
    named = any("individual" in annotation for annotation in people)  # the number of a lone track is not a name
    return _points(path, individual, names, numbers.values(), seen, named, **extra)


def _names(path: Path, categories: list[Table], people: list[Table]) -> tuple[str, ...]:
    """Return the names of the keypoints in the only category that annotations use."""
    used = {a.get("category_id") for a in people}
    with_points = [c for c in categories if c.get("keypoints") and (c.get("id") in used or len(categories) == 1)]
    lists = {tuple(str(name) for name in c["keypoints"]) for c in with_points}
    if len(lists) != 1:
        raise InputError(
            Problem(path, "categories", f"{len(lists)} lists of keypoints in use", "one list for all annotations")
        )
    return lists.pop()


def _frame_numbers(path: Path, images: list[Table]) -> tuple[dict[Any, int], tuple[str, ...]]:
    """Return the frame number of each image id, and notes.

    The number is the stated one, otherwise the last digits of the file's name, otherwise the id.
    """
    ids = [image["id"] for image in images]
    stated = ("frame_id", "frame_index", "frame_number")
    key = next((k for k in stated if images and all(isinstance(image.get(k), int) for image in images)), None)
    ends = [re.search(r"([0-9]{1,15})$", Path(str(image.get("file_name", ""))).stem) for image in images]
    if key is not None:
        numbers, notes = [image[key] for image in images], ()
    elif all(ends):
        numbers, notes = [int(end[1]) for end in ends if end], ("Frames are numbered as the images' file names.",)
    else:
        numbers, notes = ids, ("Frames are numbered by the images' ids.",)
    if len(set(numbers)) != len(numbers) or len(set(ids)) != len(ids) or not all(type(n) is int for n in numbers):
        raise InputError(Problem(path, "images", "frame numbers that are not unique", "one image for each frame"))
    return dict(zip(ids, numbers, strict=True)), notes


def _size(images: list[Table]) -> tuple[int, int] | None:
    """Return the (width, height) in pixels that all images have, or None if they differ or state none."""
    sizes = {(image.get("width"), image.get("height")) for image in images}
    (width, height) = sizes.pop() if len(sizes) == 1 else (None, None)
    return (width, height) if isinstance(width, int) and isinstance(height, int) and width > 0 < height else None


def recognises_mmpose(path: Path) -> bool:
    """Return whether a file is MMPose's JSON."""
    return _mentions(path, b"instance_info")


def read_mmpose(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the keypoints of one animal in MMPose's JSON."""
    content = read_json(path, _EXPECTED)
    names = content["meta_info"]["keypoint_id2name"]
    instances = {frame["frame_id"]: frame["instances"] for frame in content["instance_info"]}
    first = min(1, min(instances, default=1))
    seen = []
    for number, instance in (
        (number, instance) for number, frame_instances in instances.items() for instance in frame_instances
    ):
        points, scores = (np.array(instance[key], dtype=float) for key in ("keypoints", "keypoint_scores"))
        seen.append(_Seen(f"frame {number}", number - first, str(instance.get("track_id", "")), points, scores))
    names = [str(names[str(k)]) for k in range(len(names))]
    return _points(path, individual, names, [number - first for number in instances], seen)


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
"""Names of the points in the order of the file, keyed by the number of points.

The lists are COCO's 17, OpenPose's COCO with a neck (18), BODY_25, and Halpe's 26.
"""
_FILE_NAME = re.compile(r"(.*?)(\d+)((?:_keypoints)?\.json)", re.IGNORECASE | re.DOTALL)


def recognises_openpose(path: Path) -> bool:
    """Return whether a file is OpenPose's JSON."""
    return _mentions(path, b"people")


def clip_of_frame(path: Path) -> Path | None:
    """Return a path that is the same for all one-frame files of a clip, or None for other formats.

    Pose2Sim has one folder per camera, such as cam1_json/cam1_000000.json.
    """
    name = _FILE_NAME.fullmatch(path.name)
    if name is None or not os.access(path, os.R_OK) or not recognises_openpose(path):
        return None
    clip_name = name[1].rstrip("_-. ")
    folder = path.parent.parent if path.parent.name == f"{clip_name}_json" else path.parent
    return folder / f"{clip_name}{name[3]}"


def read_openpose(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the points of one person in all files whose names differ from this file's only in the frame number."""
    own_name = _FILE_NAME.fullmatch(path.name)
    if own_name is None:
        raise InputError(
            Problem(path, "file", "a name without a number", "the frame's number, as in run_000012_keypoints.json")
        )
    named = {path: own_name} | {
        file: match for file in path.parent.iterdir() if (match := _FILE_NAME.fullmatch(file.name))
    }
    files = {file: int(match[2]) for file, match in named.items() if (match[1], match[3]) == (own_name[1], own_name[3])}
    seen: list[_Seen] = []
    for file, number in files.items():
        content = read_json(file, _EXPECTED)
        with damage_as_input_error(file, "x, y, confidence of each point", "people"):
            rows = [np.array(person[KEY], dtype=float) for person in content["people"]]
            people = [row.reshape(-1, 3) for row in rows if row.size]
        for k, points in enumerate(people, start=1):
            known = np.isfinite(points).all(axis=1) & (points[:, 2] > 0)
            xy, score = np.where(known[:, None], points[:, :2], np.nan), np.where(known, points[:, 2], 0.0)
            seen.append(_Seen(f"frame {number}", number, str(k), xy, score))
    counts = sorted({len(person.score) for person in seen})
    if len(counts) > 1 or not {*counts} <= {*LISTS}:
        expected = f"the same number of points in every file, one of {', '.join(map(str, LISTS))}"
        raise InputError(Problem(path, KEY, f"{' and '.join(map(str, counts))} points", expected))
    if all(person.animal == "1" for person in seen):
        seen = [person._replace(animal="") for person in seen]
    return _points(path, individual, LISTS[counts[0] if counts else 25], files.values(), seen)


def recognises_alphapose(path: Path) -> bool:
    """Return whether a file is a JSON list of detections with points, as in AlphaPose's and COCO's results."""
    if not common.starts_with_text(path, b"["):
        return False
    with path.open("rb") as file:
        head = file.read(1 << 16)
    return b'"image_id"' in head and b'"keypoints"' in head


def read_alphapose(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the points of one animal, by its track (`idx`) if the file has tracks."""
    content = read_json(path, _EXPECTED)
    seen = []
    for i, row in enumerate(content):
        name = str(row["image_id"])
        frame = common.frame_number("".join(re.findall(r"[0-9]+", Path(name).stem)[-1:]))
        if frame is None:
            raise InputError(
                Problem(path, f"[{i}].image_id", repr(name)[:60], "a name that ends in the frame's number")
            )
        points = np.array(row["keypoints"], dtype=float).reshape(-1, 3)
        known = np.isfinite(points).all(axis=1) & (points[:, 2] > 0)
        xy, score = np.where(known[:, None], points[:, :2], np.nan), np.where(known, points[:, 2], 0.0)
        track = row.get("idx")
        seen.append(_Seen(f"[{i}]", frame, "" if track is None else str(track), xy, score))
    counts = sorted({len(detection.score) for detection in seen})
    if len(counts) != 1:
        raise InputError(
            Problem(
                path, "keypoints", f"{' and '.join(map(str, counts)) or 'no'} points", "the same number in each frame"
            )
        )
    names = LISTS.get(counts[0]) or [f"point{k}" for k in range(1, counts[0] + 1)]
    if {detection.animal for detection in seen} == {"1"}:
        seen = [detection._replace(animal="") for detection in seen]
    return _points(path, individual, names, {detection.frame for detection in seen}, seen)


_BY_DEEPLABCUT = (
    "left_eye right_eye nose neck root_of_tail left_shoulder left_elbow left_front_paw right_shoulder right_elbow "
    "right_front_paw left_hip left_knee left_back_paw right_hip right_knee right_back_paw withers throat left_ear "
    "right_ear mouth chin left_hock right_hock tail_tip"
)
"""Names that DeepLabCut (3.0, 2026) assigns to the points in the network's order.

The names belong to another list, so the left front paw is called "neck".
"""
ANIMAL3D = (
    "left_eye right_eye mouth_mid left_front_paw right_front_paw left_back_paw right_back_paw tail_base "
    "left_front_thigh right_front_thigh left_back_thigh right_back_thigh left_shoulder right_shoulder left_front_knee "
    "right_front_knee left_back_knee right_back_knee neck tail_end left_ear right_ear left_mouth right_mouth nose "
    "tail_mid"
)
"""Correct names of FMPose3D's points, as in the data set Animal3D, in the network's order."""
LENGTHS = (
    "FMPose3D's lengths have no unit and its axes are arbitrary: compare poses only after scaling and rotation (PA)."
)


def true_names(names: Sequence[str], model: str, in_space: bool = True) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the correct names of FMPose3D's points, and notes.

    `names` are the points' names, in any order, as a file states them. `model` is the name of the network, or a table's
    scorer, which contains the name.
    """
    notes = (LENGTHS,) if in_space else ()
    true: dict[str, str] = dict(zip(_BY_DEEPLABCUT.split(), ANIMAL3D.split(), strict=True))
    if f"{common.FMPOSE3D}animals" not in model or {*names} != {*true}:
        return tuple(names), notes
    note = (
        "DeepLabCut gives FMPose3D's points wrong names (the left front paw is 'neck'): they are read in "
        "their order, which is that of Animal3D."
    )
    return tuple(true[name] for name in names), (note, *notes)


def recognises_fmpose3d(path: Path) -> bool:
    """Return whether a file is FMPose3D's JSON."""
    return _mentions(path, b"poses_3d")


def read_fmpose3d(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the poses of the only animal in FMPose3D's JSON."""
    content = read_json(path, _EXPECTED)
    written = tuple(map(str, content["bodyparts"]))
    missing = np.full((len(written), 3), np.nan)
    common.require_span(len(content["poses_3d"]), len(written), path)
    values = np.array([pose or missing for pose in content["poses_3d"]], dtype=float)
    names, notes = true_names(written, str(content.get("model")))
    return common.one_animal(path, individual, StoredPoints(names, values, np.arange(len(values)), notes=notes))
