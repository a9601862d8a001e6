"""Read labelled pictures, split them for training, and compare predictions with labels (`recon evaluate-2d`).

Labels come from DeepLabCut label files, and pictures from the images of a project folder or the frames of a video. The
split decides on which pictures a network is trained, and on which it is evaluated.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath
from typing import Any

import cv2
import numpy as np
import pandas as pd

from recon.animal.body import other_side
from recon.animal.naming import load_names, map_to_write, new_names, renamed
from recon.base.arrays import Array, Bools, Integers, median
from recon.base.documents import read_head
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.clip import Keypoints, mark_missing, parse_frame_range, select_frames
from recon.io.common import first_problems
from recon.io.deeplabcut_project import Project, find_project, label_files
from recon.io.formats import as_keypoints, read_keypoints, recognised
from recon.io.video import Image, probe, read_frames, read_picture
from recon.io.writing import frames_text
from recon.keypoint_net.settings import Evaluate2DSettings, LabelSource
from recon.show.plain import picked

MAX_OUTSIDE_FRACTION = 0.1
"""Fraction of the labels outside their pictures above which the labels must belong to other pictures."""


@dataclass(frozen=True, eq=False)
class Labels:
    """N labelled pictures of K keypoints."""

    names: tuple[str, ...]
    xy_px: Array
    """Positions of the labels, pixels, NaN where a point is not labelled, shape (N, K, 2)."""
    numbers: Integers
    """Frame numbers, from the ends of the image names, shape (N,)."""
    images: tuple[str, ...]
    """Names of the N pictures, such as labeled-data/run/img0050.png."""
    clip: Integers
    """Index of each picture's clip in `clips`, shape (N,)."""
    clips: tuple[str, ...]
    """Names of the clips: folders of the project, or the video."""
    pictures: tuple[Image, ...]
    """N pictures (height, width, 3) with the channels blue, green, red, of the same size within a clip."""
    source: str
    """File or project that was read."""
    notes: tuple[str, ...] = ()
    """Sentences on decisions made while reading."""

    @property
    def labelled(self) -> Bools:
        """Return a mask (N, K) of the keypoints that are labelled in each of the N pictures."""
        return known_points(self.xy_px)

    def scaled(self, scale: float) -> Labels:
        """Return the labels with pictures and positions scaled by a factor, with centres of pixels at whole numbers."""
        pictures = tuple(resize(picture, scale) for picture in self.pictures)
        return replace(self, pictures=pictures, xy_px=scale_points(self.xy_px, scale))


def known_points(xy_px: Array) -> Bools:
    """Return a mask (...) of points (..., 2) with both coordinates known."""
    return np.asarray(np.isfinite(xy_px).all(axis=-1), dtype=np.bool_)


def resize(picture: Image, scale: float) -> Image:
    """Return a picture scaled by a factor to `scaled_size`, so that its points move as in `scale_points`."""
    if scale == 1.0:
        return picture
    size = scaled_size((picture.shape[1], picture.shape[0]), scale)
    transform = np.array([[scale, 0.0, (scale - 1) / 2], [0.0, scale, (scale - 1) / 2]])
    if scale < 0.8:  # blur first, because each new pixel covers several old pixels
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.5 * (1 / scale - 1) ** 0.5 + 0.15 / scale), np.uint8)
    return np.asarray(cv2.warpAffine(picture, transform, size, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def scaled_size(size_px: tuple[int, int], scale: float) -> tuple[int, int]:
    """Return a size (width, height) in pixels multiplied by a scale, at least one pixel."""
    return max(1, round(size_px[0] * scale)), max(1, round(size_px[1] * scale))


def scale_points(xy_px: Array, scale: float) -> Array:
    """Scale pixel coordinates (..., 2) with the picture, with the centres of pixels at whole numbers."""
    return (xy_px + 0.5) * scale - 0.5


def read_labels(data: Path, labels: Path | None = None, **options: Any) -> Labels:
    """Read the labelled pictures of a project folder, of its config.yaml, or of a video with its label file.

    Parameters
    ----------
    data : Path
        The project or the video.
    labels : Path, optional
        Label file of the video.
    **options
        The other fields of `LabelSource`.

    Returns
    -------
    Labels
        N labelled pictures of K keypoints.

    Raises
    ------
    InputError
        If labels have no picture, if pictures cannot be read, or if files do not belong together. The error lists every
        problem.
    """
    s = LabelSource(data=data, labels=labels, **options)
    if labels is None:
        project = find_project(data)
        if data.is_file() and project is None:
            raise InputError(Problem("--labels", "file", "none", f"the label file (CSV or H5) of the video {data}"))
        read = _read_project(data, project, s.individual)
    elif data.is_dir():
        raise InputError(
            Problem("--labels", "file", str(labels), f"no --labels: the folder {data} has its own label files")
        )
    else:
        read = _read_video(data, labels, s.first_frame, s.individual)
    if s.rename is not None:
        keep, names, note = new_names(read.names, load_names(s.rename), read.source)
        read = replace(read, names=names, xy_px=read.xy_px[:, keep], notes=(*read.notes, note))
    sizes = np.array([picture.shape[1::-1] for picture in read.pictures], float)[:, None]
    outside = read.labelled & ((read.xy_px < -0.5) | (read.xy_px > sizes - 0.5)).any(axis=2)
    # So many points outside cannot be labelling errors: the labels belong to other pictures.
    if outside.sum() > MAX_OUTSIDE_FRACTION * read.labelled.sum():
        i, k = np.argwhere(outside)[0]
        first = f"the first is {read.names[k]} in {read.images[i]}"
        detail = f"{outside.sum()} of {read.labelled.sum()} points outside their pictures ({first})"
        raise InputError(Problem(read.source, "labels", detail, "labels inside their pictures"))
    return read


def read_label_file(path: Path, individual: str | None = None) -> tuple[Keypoints, tuple[str, ...]]:
    """Read a label file of DeepLabCut, and return its points, NaN for missing labels, and the name of each row's image.

    A row without an image is named after its number.

    Raises
    ------
    InputError
        If the file is not a DeepLabCut table, or if it has no labels.
    """
    keypoints, images = _read_rows(path, individual)
    if not keypoints.present.any():
        raise InputError(Problem(path, "labels", "only empty cells", "at least one labelled point"))
    return keypoints, images


def _read_rows(path: Path, individual: str | None) -> tuple[Keypoints, tuple[str, ...]]:
    read_head(path)
    file_format = recognised(path, "2D")
    if file_format is None or file_format.name != "deeplabcut":
        raise InputError(Problem(path, "format", "another kind of file", "labels in DeepLabCut's layout, CSV or H5"))
    stored = file_format.read(path, individual)
    keypoints, _ = mark_missing(as_keypoints(path, stored))
    return keypoints, stored.images or tuple(map(str, keypoints.frames))


def _read_video(video: Path, path: Path, first_frame: int, individual: str | None) -> Labels:
    (keypoints, images), info = collect_problems(lambda: read_label_file(path, individual), lambda: probe(video))
    if keypoints.frames[0] < first_frame:
        expected = f"at most {keypoints.frames[0]}, the first frame of the labels"
        raise InputError(Problem("--first-frame", "number", str(first_frame), expected))
    numbers, pictures, decoded = (keypoints.frames - first_frame).tolist(), {}, 0
    labelled_numbers = {*numbers}
    for number, picture in read_frames(video, 0, max(numbers) + 1):
        decoded = number + 1
        if number in labelled_numbers:
            pictures[number] = picture
    if missing := [image for image, number in zip(images, numbers, strict=True) if number not in pictures]:
        stated = "" if info.stated_frames in (None, decoded) else f" (the file states {info.stated_frames})"
        expected = (
            f"a picture for each of the {len(numbers)} labelled frames; {len(missing)} have none, the first is "
            f"{missing[0]}. --first-frame is the number that the labels use for the video's first frame"
        )
        raise InputError(Problem(video, "frames", f"{decoded} decodable frames{stated}", expected))
    return _labels_of_clip(video, keypoints, images, [pictures[number] for number in numbers], path)


def _labels_of_clip(
    clip: Path, keypoints: Keypoints, images: tuple[str, ...], pictures: list[Image], source: Path
) -> Labels:
    zeros, points = np.zeros(len(images), np.int64), (keypoints.names, keypoints.xy_px, keypoints.frames)
    return Labels(*points, images, zeros, (str(clip),), tuple(pictures), str(source), keypoints.notes)


def _read_project(folder: Path, project: Project | None, individual: str | None) -> Labels:
    if project is None and not folder.is_dir():
        raise InputError(Problem(folder, "data", "nothing there", "a video, or a DeepLabCut project folder"))
    folder, scorer = (folder, "") if project is None else (project.folder, project.scorer)
    files = label_files(folder, scorer)
    if not files:
        expected = "labeled-data/*/CollectedData_*.csv or .h5, as in a DeepLabCut project with labelled frames"
        raise InputError(Problem(folder, "label files", "none", expected))
    parts = [
        part for part in collect_problems(*(lambda f=f: _read_folder(f, individual) for f in files)) if part is not None
    ]
    if not parts:
        raise InputError(Problem(folder, "labels", "none in any label file", "at least one labelled point"))
    names, expected = parts[0].names, f"the bodyparts of {parts[0].source}: {', '.join(parts[0].names)}"
    unlike = [p for p in parts if sorted(p.names) != sorted(names)]
    raise_problems(Problem(p.source, "bodyparts", ", ".join(p.names), expected) for p in unlike)
    joined = {name: sum((getattr(p, name) for p in parts), ()) for name in ("images", "clips", "pictures", "notes")}
    xy_px = np.concatenate([p.xy_px[:, [p.names.index(n) for n in names]] for p in parts])
    clip = np.repeat(np.arange(len(parts)), [len(p.images) for p in parts])
    return Labels(names, xy_px, np.concatenate([p.numbers for p in parts]), clip=clip, source=str(folder), **joined)


def _read_folder(path: Path, individual: str | None) -> Labels | None:
    """Return the pictures next to a label file, or None if nothing is labelled yet."""
    keypoints, images = _read_rows(path, individual)
    if not keypoints.present.any():
        return None
    problems, pictures = [], []
    for image in images:
        file = path.parent / PureWindowsPath(image).name
        picture = read_picture(file, cv2.IMREAD_COLOR)
        if picture is None:
            description = "a picture that cannot be read" if file.is_file() else "no such picture"
            problems.append(Problem(file, "picture", description, f"the picture labelled in {path.name}"))
        else:
            pictures.append(picture)
    sizes = sorted({p.shape[1::-1] for p in pictures})
    if len(sizes) > 1:
        shapes = ", ".join(f"{w}x{h}" for w, h in sizes)
        problems.append(Problem(path.parent, "pictures", f"several sizes: {shapes} px", "one size, that of the video"))
    raise_problems(first_problems(problems, path))
    return _labels_of_clip(path.parent, keypoints, images, pictures, path)


def extents_px(xy_px: Array) -> Array:
    """Return the diagonal of the box around each picture's labels (N, K, 2) in px; NaN with fewer than two labels."""
    is_known = known_points(xy_px)
    points = np.where(is_known[..., None], xy_px, np.nan)
    extent_px = np.fmax.reduce(points, axis=1) - np.fmin.reduce(points, axis=1)
    return np.where(is_known.sum(axis=1) > 1, np.linalg.norm(extent_px, axis=1), np.nan)


def body_length_px(xy_px: Array) -> float:
    """Return the length of the animal in pictures with points (N, K, 2), px.

    The length is the median diagonal of the box around the points, over the pictures that show most of the animal. The
    length is NaN if no picture has two points.
    """
    counts = known_points(xy_px).sum(axis=1)
    return median(extents_px(xy_px)[counts >= max(2, 0.7 * counts.max(initial=0))])


def sides(names: Sequence[str]) -> tuple[int, ...]:
    """Return the index of each keypoint's counterpart on the other side.

    Counterparts differ in the side that their names state, either in words that `recon.animal` knows or in the letters
    of a leg (fl/fr, lf/rf). A keypoint without a counterpart has its own index.
    """
    by_name = {name: k for k, name in enumerate(names)}
    return tuple(next((by_name[m] for m in _mirrored(name) if m in by_name), k) for k, name in enumerate(names))


_LEG = re.compile(r"(?:(?<![A-Za-z])|(?<=[a-z])(?=[A-Z]))[fhbrlFHBRL]{2}(?![A-Za-z])")
"""Two letters that name a leg, such as fl in fl_paw or HR in pawHR."""
_OTHER = str.maketrans("lrLR", "rlRL")


def _mirrored(name: str) -> Iterator[str]:
    """Yield possible names of a keypoint's counterpart on the other side (either letter of "rl" can be the side)."""
    if (opposite := other_side(name)) != name:
        yield opposite
    for leg in _LEG.finditer(name):
        for index in (leg.start(), leg.end() - 1):
            if name[index] in "lrLR":
                yield name[:index] + name[index].translate(_OTHER) + name[index + 1 :]


PARTS = ("train", "validation", "test")
"""Parts of a split: pictures to train on, to evaluate and calibrate on during training, and to test on at the end."""
MIN_BLOCKS = 10
"""Minimum number of blocks of consecutive pictures into which the labels are divided. Whole blocks are held out.

Successive pictures look similar, so a single held-out picture would be almost the same as a training picture.
"""


_Choice = float | tuple[int | None, int | None]
"""Choice of pictures: a fraction of them, or a half-open range of frame numbers."""


def split_labels(labels: Labels, validation: str, test: str, seed: int) -> dict[str, Integers]:
    """Split the labelled pictures, and return ascending indices for each of `PARTS`.

    Parameters
    ----------
    labels : Labels
        The labelled pictures.
    validation, test : str
        A fraction such as "0.2", or frame numbers such as "110:150".
    seed : int
        Seed of the random choice.

    Raises
    ------
    InputError
        If a part is not valid, or if no labelled picture is left to train on.
    """
    chosen = collect_problems(lambda: _parse(validation, "--validation"), lambda: _parse(test, "--test"))
    remaining = np.arange(len(labels.images))
    test_pictures = _choose(labels, remaining, chosen[1], seed, "--test")
    remaining = np.setdiff1d(remaining, test_pictures)
    validation_pictures = _choose(labels, remaining, chosen[0], seed + 1, "--validation")
    train = np.setdiff1d(remaining, validation_pictures)
    if not labels.labelled[train].any():
        description = f"no picture left to train on, of {len(labels.images)} pictures with labels"
        raise InputError(Problem("--validation, --test", "split", description, "smaller fractions"))
    return dict(zip(PARTS, (train, validation_pictures, test_pictures), strict=True))


def frames_by_part(labels: Labels, split: dict[str, Integers]) -> dict[str, dict[str, list[str]]]:
    """Return the frame numbers of the pictures as text, for each part of the split and each clip."""
    numbers: dict[str, dict[str, list[str]]] = {part: {} for part in split}
    for part, indices in split.items():
        for c in np.unique(labels.clip[indices]):
            numbers[part][labels.clips[c]] = frames_text(labels.numbers[indices][labels.clip[indices] == c])
    return numbers


def _parse(text: str, option: str) -> _Choice:
    if ":" in text:
        try:
            return parse_frame_range(text)
        except InputError as error:
            raise InputError(Problem(option, p.field, p.found, p.expected) for p in error.problems) from None
    try:
        fraction = float(text)
    except ValueError:
        fraction = -1.0
    if not 0 <= fraction < 1:
        raise InputError(
            Problem(option, "part", f"'{text}'", "a fraction from 0 to 1, or frame numbers A:B (B excluded)")
        )
    return fraction


def _choose(labels: Labels, remaining: Integers, choice: _Choice, seed: int, option: str) -> Integers:
    if isinstance(choice, tuple):
        low, high = choice
        numbers = labels.numbers[remaining]
        chosen = remaining[(numbers >= (low or 0)) & (numbers < (np.inf if high is None else high))]
        if not len(chosen):
            limits = f"{'' if low is None else low}:{'' if high is None else high}"
            ends = f"{numbers.min()} to {numbers.max()}" if len(numbers) else "none"
            raise InputError(
                Problem(option, "frames", f"no label in the range {limits}", f"frame numbers of the labels ({ends})")
            )
        return chosen
    if choice == 0 or len(remaining) < 2:
        return remaining[:0]
    blocks = np.array_split(remaining, min(len(remaining), max(MIN_BLOCKS, round(2 / choice))))
    count = min(len(blocks) - 1, max(1, round(choice * len(blocks))))
    drawn = np.random.default_rng(seed).permutation(len(blocks))[:count]
    return np.sort(np.concatenate([blocks[i] for i in drawn]))


BINS = 10
"""Number of likelihood bins in which the fraction of correct points is computed."""
PCK_PX = (2.5, 5.0, 10.0)
"""Distances from the labels up to which points are correct in the PCK, the percentage of correct keypoints."""
PCK_RELATIVE = (0.05, 0.1, 0.2)
"""Distances for the PCK as fractions of the body length, the median diagonal of the box around an animal's labels."""


def evaluate_2d_files(predicted: Path, labels: Path, **options: Any) -> dict[str, Any]:
    """Compare a file of predictions with a label file, and return the scores of `evaluate_2d`.

    `options` are the other fields of `Evaluate2DSettings`.

    Raises
    ------
    InputError
        If a file cannot be read, or if the files have no frames or keypoints in common.
    """
    o = Evaluate2DSettings(predicted=predicted, labels=labels, **options)

    def read_predicted() -> Keypoints:
        keypoints = mark_missing(read_keypoints(predicted, o.individual))[0]
        return keypoints if o.rename is None else renamed(keypoints, load_names(o.rename))

    frame_range = parse_frame_range(o.frames) if o.frames else None
    guess, truth = collect_problems(
        read_predicted, lambda: select_frames(read_label_file(labels, o.individual)[0], frame_range)
    )
    common = [name for name in truth.names if name in guess.names]
    problems = []
    if not common:
        expected = f"some of: {', '.join(truth.names)}; or --rename with a file of these lines, completed"
        lines = tuple(map_to_write(guess.names, truth.names))
        problems.append(Problem(predicted, "keypoints", ", ".join(guess.names), expected, lines))
    numbers = guess.frames + o.first_frame  # numbered like the labels
    rows_t = np.flatnonzero(np.isin(truth.frames, numbers))
    if not len(rows_t):
        first, last = truth.frames[[0, -1]]
        expected = f"some of the labels' frames {first} to {last}, or another --first-frame"
        numbers_text = f"frames {numbers[0]} to {numbers[-1]} in the labels' numbering"
        problems.append(Problem(predicted, "frames", numbers_text, expected))
    raise_problems(problems)
    rows_g = pd.Index(numbers).get_indexer(pd.Index(truth.frames[rows_t]))
    g, t = [guess.names.index(n) for n in common], [truth.names.index(n) for n in common]
    predicted_px, likelihood, label_px = guess.xy_px[rows_g][:, g], guess.confidence[rows_g][:, g], truth.xy_px[rows_t]
    limits = picked(o, "likelihood_min", "tolerance_px")
    return evaluate_2d(tuple(common), predicted_px, likelihood, label_px[:, t], body_length_px(label_px), **limits)


def evaluate_2d(
    names: tuple[str, ...],
    xy_px: Array,
    likelihood: Array,
    label_px: Array,
    length_px: float,
    likelihood_min: float = 0.5,
    tolerance_px: float = 5.0,
) -> dict[str, Any]:
    """Compute the errors and the likelihoods' reliability of predicted points, compared with labels.

    Parameters
    ----------
    names : tuple of str
        Names of the K keypoints.
    xy_px : ndarray
        Predicted points, shape (N, K, 2), NaN where missing.
    likelihood : ndarray
        Likelihoods of the points, shape (N, K).
    label_px : ndarray
        Labels, shape (N, K, 2), NaN where missing.
    length_px : float
        Length of the animal, px.
    likelihood_min, tolerance_px : float
        Smallest likelihood of a likely point, and largest distance (px) of a correct point from its label.

    Returns
    -------
    dict
        `frames` is the number of frames. `all`, `likely` and `swaps_forgiven` are scores (see `_score`) of all points,
        of the likely points, and of all points with left-right swaps allowed (None if no names differ by side).
        `per_keypoint` and `likely_per_keypoint` have the scores of each keypoint. `reliability` compares the
        likelihoods with the fractions of correct points (None without likelihoods).
    """
    errors, partner = np.linalg.norm(xy_px - label_px, axis=2), sides(names)
    likely = np.where(likelihood >= likelihood_min, errors, np.nan)
    paired = any(p != k for k, p in enumerate(partner))
    is_known = np.isfinite(errors) & np.isfinite(likelihood)

    def score(values: Array, columns: int | slice = slice(None)) -> dict[str, Any]:
        return _score(values[:, columns], known_points(label_px)[:, columns], length_px)

    sure, right = np.clip(likelihood[is_known], 0, 1), errors[is_known] <= tolerance_px
    return {
        "frames": len(label_px),
        "body_length_px": length_px,
        "likelihood_min": likelihood_min,
        "tolerance_px": tolerance_px,
        "all": score(errors),
        "likely": score(likely),
        "swaps_forgiven": score(_forgiving_errors_px(xy_px, label_px, partner)) if paired else None,
        "per_keypoint": {name: score(errors, k) for k, name in enumerate(names)},
        "likely_per_keypoint": {name: score(likely, k) for k, name in enumerate(names)},
        "reliability": reliability(sure, right) if is_known.any() else None,
    }


def _forgiving_errors_px(xy_px: Array, label_px: Array, partner: tuple[int, ...]) -> Array:
    """Return errors in px, shape (N, K), with each left-right pair swapped if this reduces the error."""
    direct = np.linalg.norm(xy_px - label_px, axis=2)
    swapped = np.linalg.norm(xy_px[:, list(partner)] - label_px, axis=2)
    cost = np.stack([direct, swapped])
    pair_costs = np.nansum(np.stack([cost, cost[:, :, list(partner)]]), axis=0)
    return np.where(pair_costs[1] < pair_costs[0], swapped, direct)


def _score(errors: Array, labelled: Bools, length_px: float) -> dict[str, Any]:
    """Summarise the errors (..., K) of predicted points in px, which are NaN if a point is not labelled or not found.

    The summary has the number of labelled `points`; the fraction of these that was `found` (predicted, and likely
    enough); the RMSE and the median error of the found points, px, NaN without any; and the fractions of all labelled
    points with errors up to `PCK_PX` (`pck_px`) and `PCK_RELATIVE` (`pck_relative`). A point that was not found counts
    as wrong.
    """
    n = int(labelled.sum())
    found_errors = errors[labelled & np.isfinite(errors)]

    def share(limit_px: float) -> float:
        return float((found_errors <= limit_px).sum() / n) if n and np.isfinite(limit_px) else np.nan

    return {
        "points": n,
        "found": len(found_errors) / n if n else np.nan,
        "rmse_px": float(np.sqrt(np.mean(found_errors**2))) if len(found_errors) else np.nan,
        "median_px": float(np.median(found_errors)) if len(found_errors) else np.nan,
        "pck_px": {str(limit): share(limit) for limit in PCK_PX},
        "pck_relative": {str(limit): share(limit * length_px) for limit in PCK_RELATIVE},
    }


def reliability(likelihood: Array, right: Bools, bins: int = BINS) -> dict[str, Any]:
    """Compare likelihoods with the fractions of points that are correct.

    Parameters
    ----------
    likelihood : ndarray
        Likelihoods of the points, 0 to 1, shape (N,).
    right : ndarray
        Whether each point is correct, shape (N,).
    bins : int
        Number of bins of equal width.

    Returns
    -------
    dict
        `points` is the number of points. `expected_calibration_error` is the mean absolute difference between
        likelihood and fraction of correct points, NaN without points. `bins` has, for each bin with points, its ends,
        the number of points, their mean likelihood and the fraction of correct points.
    """
    bin_of_point, rows = np.minimum((likelihood * bins).astype(int), bins - 1), []
    for b in np.unique(bin_of_point):
        in_bin = bin_of_point == b
        ends = {"low": float(b / bins), "high": float((b + 1) / bins), "points": int(in_bin.sum())}
        rows.append(ends | {"likelihood": float(likelihood[in_bin].mean()), "right": float(right[in_bin].mean())})
    total = len(likelihood)
    error = sum(r["points"] * abs(r["likelihood"] - r["right"]) for r in rows) / total if total else float("nan")
    return {"points": total, "expected_calibration_error": float(error), "bins": rows}
