"""COCO keypoints as JSON: `images`, `annotations` with `keypoints` [x, y, v, ...], and `categories` with their names.

v is 0 for a missing point. A score for each point is read from `keypoint_scores`, where there is one. The animal of an
annotation is its `individual`, as our own files have it, or its `track_id`. They have the frame rate in `info`, and an
annotation for each frame in which a point is known.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.documents import read_json
from recon.base.errors import InputError, Problem, refuse
from recon.clip.keypoints import Keypoints
from recon.io.common import MAX_FRAME, choose, first_problems, name_problems, rate, starts_with_text
from recon.io.pose import StoredPoints

FRAME_KEYS = ("frame_id", "frame_index", "frame_number")


def recognises(path: Path) -> bool:
    """Whether it is JSON with COCO's keys; it need not be whole."""
    if not starts_with_text(path, b"{"):
        return False
    content = path.read_bytes()
    return b'"images"' in content and (b'"annotations"' in content or b'"categories"' in content)


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The keypoints of one animal. Raises InputError."""
    content = read_json(path, "a whole file of JSON")
    if not isinstance(content, dict):
        raise InputError(Problem(path, "content", "something else than a table", "COCO keypoints"))
    return of_content(path, content, individual)


def of_content(path: Path, content: dict[str, Any], individual: str | None) -> StoredPoints:
    """The same of what such a file has, or another format's put the same way."""
    missing = [key for key in ("images", "annotations", "categories") if not isinstance(content.get(key), list)]
    if missing:
        raise InputError([Problem(path, key, "no list", "a list") for key in missing])
    try:
        return _keypoints(path, content, individual)
    except InputError:
        raise
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        found = f"an entry without {error}" if isinstance(error, KeyError) else f"an entry of another form ({error})"
        expected = "entries as COCO has them for keypoints"
        raise InputError(Problem(path, "images, annotations, categories", found, expected)) from None


def _keypoints(path: Path, content: dict[str, Any], individual: str | None) -> StoredPoints:
    names = _names(path, content["categories"], content["annotations"])
    numbers, notes = _frame_numbers(path, content["images"])
    frames = np.array(sorted(numbers.values()), dtype=np.int64)
    row = {image: int(np.searchsorted(frames, number)) for image, number in numbers.items()}
    whose = [_animal(a) for a in content["annotations"]]
    animals = list(dict.fromkeys(w for w in whose if w is not None)) or [""]
    if "" in animals and len(animals) > 1:
        problem = Problem(path, "annotations", "some without track_id", "one for each animal in every annotation")
        raise InputError(problem)
    chosen = animals[choose(path, animals, individual)]
    xy, score = np.full((len(frames), len(names), 2), np.nan), np.zeros((len(frames), len(names)))
    problems: list[Problem] = []
    taken: set[int] = set()
    for annotation, animal in zip(content["annotations"], whose, strict=True):
        if animal != chosen:
            continue
        where = f"annotation {annotation.get('id', '?')}"
        values = np.asarray(annotation["keypoints"], dtype=float)
        scores = np.array([np.nan if s is None else s for s in annotation.get("keypoint_scores", ())], dtype=float)
        if values.shape != (3 * len(names),) or len(scores) not in (0, len(names)):
            found = f"{values.size} numbers and {len(scores)} scores"
            problems.append(Problem(path, where, found, f"x, y, v for each of {len(names)} keypoints"))
        elif annotation["image_id"] not in row:
            problems.append(Problem(path, where, f"image {annotation['image_id']}", "an image of the file"))
        elif row[annotation["image_id"]] in taken:
            found = f"a second animal in image {annotation['image_id']}"
            problems.append(Problem(path, where, found, "one animal, or a track_id for each"))
        else:
            t = row[annotation["image_id"]]
            taken.add(t)
            known = values[2::3] > 0
            xy[t] = np.where(known[:, None], values.reshape(-1, 3)[:, :2], np.nan)
            score[t] = scores if len(scores) else np.where(known, np.nan, 0.0)
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
        individual=chosen if len(animals) > 1 or any("individual" in a for a in content["annotations"]) else None,
        notes=notes,
    )


def _names(path: Path, categories: list[dict[str, Any]], annotations: list[dict[str, Any]]) -> tuple[str, ...]:
    """The keypoints of the one category that is used."""
    used = {a.get("category_id") for a in annotations}
    with_points = [c for c in categories if c.get("keypoints") and (c.get("id") in used or len(categories) == 1)]
    lists = {tuple(str(name) for name in c["keypoints"]) for c in with_points}
    if len(lists) != 1:
        raise InputError(Problem(path, "categories", f"{len(lists)} lists of keypoints in use", "one"))
    (names,) = lists
    refuse(name_problems(path, "categories, keypoints", names))
    return names


def _animal(annotation: dict[str, Any]) -> str | None:
    """None for an annotation without keypoints, "" for an unnamed animal."""
    if "keypoints" not in annotation:
        return None
    named = annotation.get("individual", annotation.get("track_id"))
    return "" if named is None else str(named)


def _frame_numbers(path: Path, images: list[dict[str, Any]]) -> tuple[dict[Any, int], tuple[str, ...]]:
    """Image id to frame number: as stated, else from the ends of the file names, else the id."""
    for key in FRAME_KEYS:
        if images and all(isinstance(image.get(key), int) for image in images):
            numbers, notes = [image[key] for image in images], ()
            break
    else:
        stems = [re.search(r"([0-9]{1,15})$", Path(str(image.get("file_name", ""))).stem) for image in images]
        if all(stems):
            numbers, notes = [int(m[1]) for m in stems if m], ("Frames are numbered as the images' file names.",)
        else:
            numbers, notes = [image["id"] for image in images], ("Frames are numbered by the images' ids.",)
    ids = [image["id"] for image in images]
    if len(set(numbers)) != len(numbers) or len(set(ids)) != len(ids) or not all(type(n) is int for n in numbers):
        raise InputError(Problem(path, "images", "frame numbers that are not unique", "one image for each frame"))
    if numbers and not -MAX_FRAME <= min(numbers) <= max(numbers) <= MAX_FRAME:
        found = f"frame numbers from {min(numbers):.15g} to {max(numbers):.15g}"
        raise InputError(Problem(path, "images", found, "0, 1, 2, ..."))
    return dict(zip(ids, numbers, strict=True)), notes


def _size(images: list[dict[str, Any]]) -> tuple[int, int] | None:
    """(width, height), where all images have the same."""
    sizes = {(image.get("width"), image.get("height")) for image in images}
    (width, height) = sizes.pop() if len(sizes) == 1 else (None, None)
    return (width, height) if isinstance(width, int) and isinstance(height, int) and width > 0 < height else None


# -- writing ---------------------------------------------------------------------------------------------------------


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
