"""Labelled pictures: DeepLabCut's label files with the images of a project folder, or with the frames of one video; and
which of them a network is trained on, and which it is judged by."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath

import cv2
import numpy as np

from recon.animal import load_names, new_names, other_side
from recon.base.arrays import Array, Bools, Integers, median
from recon.base.errors import InputError, Problem, all_of, refuse
from recon.clip import Keypoints, mark_missing, parse_frame_range
from recon.io.common import first_problems
from recon.io.deeplabcut_project import Project, find_project, label_files
from recon.io.formats import as_keypoints, file_head, recognised
from recon.io.video import Image, probe, read_frames, read_picture
from recon.io.writing import frames_text

OUTSIDE = 0.1
"""Share of the labels that may lie outside of their pictures."""


@dataclass(frozen=True, eq=False)
class Labels:
    """N labelled pictures of K keypoints."""

    names: tuple[str, ...]
    xy_px: Array
    """(N, K, 2), NaN where a point is not labelled."""
    numbers: Integers
    """(N,) int, the frame numbers that the labels' image names end in."""
    images: tuple[str, ...]
    """N names, as in labeled-data/run/img0050.png."""
    clip: Integers
    """(N,) int, which of `clips` a picture comes from."""
    clips: tuple[str, ...]
    """Folders of the project, or the video."""
    pictures: tuple[Image, ...]
    """N arrays (height, width, 3; blue, green, red), one size within a clip."""
    source: str
    """The file or the project that was read."""
    notes: tuple[str, ...] = ()
    """What had to be decided, in sentences."""

    @property
    def labelled(self) -> Bools:
        """Which of the K keypoints are labelled in each of the N pictures, shape (N, K)."""
        return known_points(self.xy_px)

    def scaled(self, scale: float) -> Labels:
        """Pictures and labels at another size; the centres of pixels lie at whole numbers."""
        pictures = tuple(resize(picture, scale) for picture in self.pictures)
        return replace(self, pictures=pictures, xy_px=scale_points(self.xy_px, scale))


def known_points(xy_px: Array) -> Bools:
    """Which points (..., 2) have both coordinates, (...)."""
    return np.asarray(np.isfinite(xy_px).all(axis=-1), dtype=np.bool_)


def resize(picture: Image, scale: float) -> Image:
    """The picture in the size that `scaled_size` says; pixel (x, y) moves to `scale_points`."""
    if scale == 1.0:
        return picture
    size = scaled_size((picture.shape[1], picture.shape[0]), scale)
    to = np.array([[scale, 0.0, (scale - 1) / 2], [0.0, scale, (scale - 1) / 2]])
    if scale < 0.8:  # each pixel averages those that it covers
        blurred = cv2.GaussianBlur(picture, (0, 0), 0.5 * (1 / scale - 1) ** 0.5 + 0.15 / scale)
        return np.asarray(cv2.warpAffine(blurred, to, size, borderMode=cv2.BORDER_REPLICATE), np.uint8)
    return np.asarray(cv2.warpAffine(picture, to, size, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def scaled_size(size_px: tuple[int, int], scale: float) -> tuple[int, int]:
    return max(1, round(size_px[0] * scale)), max(1, round(size_px[1] * scale))


def scale_points(xy_px: Array, scale: float) -> Array:
    """Scale pixel coordinates with whole numbers at the centres of pixels, from one size of picture to another."""
    return (xy_px + 0.5) * scale - 0.5


def read_labels(
    data: Path,
    labels: Path | None = None,
    first_frame: int = 0,
    individual: str | None = None,
    rename: str | None = None,
) -> Labels:
    """A project folder, or its config.yaml, or a video with its label file.

    first_frame: the number that the label file gives to the video's first frame. rename: a map of the keypoints' names.
    Raises InputError with every problem: labels without a picture, pictures that cannot be read, files that do not fit
    each other.
    """
    if labels is None:
        project = find_project(data)
        if data.is_file() and project is None:
            raise InputError(Problem("--labels", "file", "none", f"the label file (CSV or H5) of the video {data}"))
        read = _read_project(data, project, individual)
    elif data.is_dir():
        raise InputError(Problem("--labels", "file", str(labels), f"none: the folder {data} has its own label files"))
    else:
        read = _read_video(data, labels, first_frame, individual)
    if rename is not None:
        keep, names, note = new_names(read.names, load_names(rename), read.source)
        read = replace(read, names=names, xy_px=read.xy_px[:, keep], notes=(*read.notes, note))
    sizes = np.array([picture.shape[1::-1] for picture in read.pictures], float)[:, None]
    outside = read.labelled & ((read.xy_px < -0.5) | (read.xy_px > sizes - 0.5)).any(axis=2)
    if outside.sum() > OUTSIDE * read.labelled.sum():  # too many to be the labels of these pictures
        i, k = np.argwhere(outside)[0]
        found = f"{outside.sum()} of {read.labelled.sum()} points outside, {read.names[k]} in {read.images[i]} first"
        raise InputError(Problem(read.source, "labels", found, "labels that lie in their pictures"))
    return read


def read_label_file(path: Path, individual: str | None = None) -> tuple[Keypoints, tuple[str, ...]]:
    """Points as labelled, NaN where there is none, and the name of each row's image (its number, where it has none).

    Raises InputError for a file that is no table of DeepLabCut's, or that has no label in it.
    """
    keypoints, images = _read_rows(path, individual)
    if not keypoints.present.any():
        raise InputError(Problem(path, "labels", "none: every cell is empty", "at least one labelled point"))
    return keypoints, images


def _read_rows(path: Path, individual: str | None) -> tuple[Keypoints, tuple[str, ...]]:
    file_head(path)
    found = recognised(path, "2D")
    if found is None or found.name != "deeplabcut":
        raise InputError(Problem(path, "format", "another kind of file", "labels in DeepLabCut's layout, CSV or H5"))
    stored = found.read(path, individual)
    keypoints, _ = mark_missing(as_keypoints(path, stored))
    return keypoints, stored.images or tuple(map(str, keypoints.frames))


def _read_video(video: Path, path: Path, first_frame: int, individual: str | None) -> Labels:
    (keypoints, images), info = all_of(lambda: read_label_file(path, individual), lambda: probe(video))
    problems = []
    if keypoints.frames[0] < first_frame:
        expected = f"{keypoints.frames[0]} or less: the labels begin with frame {keypoints.frames[0]}"
        problems.append(Problem("--first-frame", "number", str(first_frame), expected))
    wanted = {int(n) - first_frame: i for i, n in enumerate(keypoints.frames)}
    pictures: list[Image | None] = [None] * len(wanted)
    decoded = 0
    if not problems:
        for number, picture in read_frames(video, 0, max(wanted) + 1):
            decoded = number + 1
            if number in wanted:
                pictures[wanted[number]] = picture
    found = [p for p in pictures if p is not None]
    if not problems and len(found) < len(pictures):
        stated = "" if info.stated_frames in (None, decoded) else f" (the file states {info.stated_frames})"
        missing = [images[i] for i, p in enumerate(pictures) if p is None]
        expected = (
            f"a picture for each of the {len(pictures)} labelled frames; none for {len(missing)} of them, "
            f"{missing[0]} first. --first-frame says which number the labels give to the video's first frame"
        )
        problems.append(Problem(video, "frames", f"{decoded} frames that can be decoded{stated}", expected))
    refuse(problems)
    return _of_clip(video, keypoints, images, found, path)


def _of_clip(clip: Path, keypoints: Keypoints, images: tuple[str, ...], pictures: list[Image], source: Path) -> Labels:
    zeros, points = np.zeros(len(images), np.int64), (keypoints.names, keypoints.xy_px, keypoints.frames)
    return Labels(*points, images, zeros, (str(clip),), tuple(pictures), str(source), keypoints.notes)


def _read_project(folder: Path, project: Project | None, individual: str | None) -> Labels:
    if project is None and not folder.is_dir():
        raise InputError(Problem(folder, "data", "nothing there", "a video, or a DeepLabCut project folder"))
    folder, scorer = (folder, "") if project is None else (project.folder, project.scorer)
    files = label_files(folder, scorer)
    if not files:
        expected = "labeled-data/*/CollectedData_*.csv or .h5, as in a DeepLabCut project whose frames are labelled"
        raise InputError(Problem(folder, "label files", "none", expected))
    parts = [part for part in all_of(*(lambda f=f: _read_folder(f, individual) for f in files)) if part is not None]
    if not parts:
        raise InputError(Problem(folder, "labels", "none in any label file", "at least one labelled point"))
    names = parts[0].names
    refuse(
        Problem(p.source, "bodyparts", ", ".join(p.names), f"those of {parts[0].source}: {', '.join(names)}")
        for p in parts
        if sorted(p.names) != sorted(names)
    )
    return Labels(
        names,
        np.concatenate([p.xy_px[:, [p.names.index(n) for n in names]] for p in parts]),
        np.concatenate([p.numbers for p in parts]),
        tuple(image for p in parts for image in p.images),
        np.concatenate([np.full(len(p.images), i) for i, p in enumerate(parts)]),
        tuple(p.clips[0] for p in parts),
        tuple(picture for p in parts for picture in p.pictures),
        str(folder),
        tuple(note for p in parts for note in p.notes),
    )


def _read_folder(path: Path, individual: str | None) -> Labels | None:
    """The pictures beside a label file; None where nothing is labelled in it, as in folders that wait for it."""
    keypoints, images = _read_rows(path, individual)
    if not keypoints.present.any():
        return None
    problems, pictures = [], []
    for image in images:
        file = path.parent / PureWindowsPath(image).name
        picture = read_picture(file, cv2.IMREAD_COLOR)
        if picture is None:
            found = "a picture that cannot be read" if file.is_file() else "no such picture"
            problems.append(Problem(file, "picture", found, f"the picture that {path.name} labels"))
        else:
            pictures.append(picture)
    sizes = sorted({p.shape[1::-1] for p in pictures})
    if len(sizes) > 1:
        shown = ", ".join(f"{w}x{h}" for w, h in sizes)
        problems.append(Problem(path.parent, "pictures", f"several sizes: {shown} px", "one size, that of the video"))
    refuse(first_problems(problems, path))
    return _of_clip(path.parent, keypoints, images, pictures, path)


def extents_px(xy_px: Array) -> Array:
    """(N,): diagonals of the boxes around the labelled points (N, K, 2); NaN with fewer than two."""
    known = known_points(xy_px)
    low = np.where(known[..., None], xy_px, np.inf).min(axis=1)
    high = np.where(known[..., None], xy_px, -np.inf).max(axis=1)
    several = known.sum(axis=1, keepdims=True) > 1
    return np.linalg.norm(np.where(several, high - low, np.nan), axis=1)


def body_length_px(xy_px: Array) -> float:
    """The length of the animal in the pictures: the median diagonal of the box around its points, over the pictures
    that show most of it (NaN where nothing has two points)."""
    known = known_points(xy_px).sum(axis=1)
    return median(extents_px(xy_px)[known >= max(2, 0.7 * known.max(initial=0))])


def sides(names: Sequence[str]) -> tuple[int, ...]:
    """For each keypoint, the one that it becomes in a mirror: names that differ in their side as `recon.animal` knows
    it, or in a leg's letters (fl/fr, lf/rf). A keypoint without a partner is its own."""
    by_name = {name: k for k, name in enumerate(names)}
    return tuple(next((by_name[m] for m in _mirrored(name) if m in by_name), k) for k, name in enumerate(names))


_LEG = re.compile(r"(?:(?<![A-Za-z])|(?<=[a-z])(?=[A-Z]))[fhbrlFHBRL]{2}(?![A-Za-z])")
_OTHER = str.maketrans("lrLR", "rlRL")


def _mirrored(name: str) -> Iterator[str]:
    """Names that the mirror picture of a keypoint may have; rl is a rear left leg, or a right one."""
    if (other := other_side(name)) != name:
        yield other
    for leg in _LEG.finditer(name):
        for at in (leg.start(), leg.end() - 1):
            if name[at] in "lrLR":
                yield name[:at] + name[at].translate(_OTHER) + name[at + 1 :]


# -- which pictures are learned from ---------------------------------------------------------------------------------

PARTS = ("train", "validation", "test")
"""What is learned from; what judges the network meanwhile and calibrates it; what is looked at once, at the end."""
BLOCKS = 10
"""A share of the pictures is held out in this many runs of neighbours in time, or in fewer, longer ones: neighbours
look alike, and what was seen in training would judge itself."""


_Choice = float | tuple[int | None, int | None]
"""A share of the pictures, or a half-open range of their numbers."""


def split_labels(labels: Labels, validation: str, test: str, seed: int) -> dict[str, Integers]:
    """For each of `PARTS` its indices into the labelled pictures, increasing. validation, test: a share as in "0.2", or
    frame numbers as in "110:150". Raises InputError where nothing would be left to train on."""
    chosen = all_of(lambda: _parse(validation, "--validation"), lambda: _parse(test, "--test"))
    rest = np.arange(len(labels.images))
    of_test = _choose(labels, rest, chosen[1], seed, "--test")
    rest = np.setdiff1d(rest, of_test)
    of_validation = _choose(labels, rest, chosen[0], seed + 1, "--validation")
    train = np.setdiff1d(rest, of_validation)
    if not labels.labelled[train].any():
        found = f"no labelled picture of {len(labels.images)} left to train on"
        raise InputError(Problem("--validation, --test", "split", found, "smaller parts"))
    return dict(zip(PARTS, (train, of_validation, of_test), strict=True))


def frames_by_part(labels: Labels, split: dict[str, Integers]) -> dict[str, dict[str, list[str]]]:
    """Frame numbers by part and clip."""
    return {
        part: {
            labels.clips[c]: frames_text(labels.numbers[which][labels.clip[which] == c])
            for c in np.unique(labels.clip[which])
        }
        for part, which in split.items()
    }


def _parse(text: str, option: str) -> _Choice:
    if ":" in text:
        try:
            return parse_frame_range(text)
        except InputError as error:
            raise InputError(Problem(option, p.field, p.found, p.expected) for p in error.problems) from None
    try:
        share = float(text)
    except ValueError:
        share = -1.0
    if not 0 <= share < 1:
        raise InputError(Problem(option, "part", f"'{text}'", "a share from 0 to 1, or frame numbers A:B (B excluded)"))
    return share


def _choose(labels: Labels, rest: Integers, choice: _Choice, seed: int, option: str) -> Integers:
    if isinstance(choice, tuple):
        low, high = choice
        numbers = labels.numbers[rest]
        chosen = rest[(numbers >= (low or 0)) & (numbers < (np.inf if high is None else high))]
        if not len(chosen):
            shown = f"{'' if low is None else low}:{'' if high is None else high}"
            has = f"{numbers.min()} to {numbers.max()}" if len(numbers) else "none"
            raise InputError(Problem(option, "frames", f"none in the range {shown}", f"numbers of the labels ({has})"))
        return chosen
    if choice == 0 or len(rest) < 2:
        return rest[:0]
    blocks = np.array_split(rest, min(len(rest), max(BLOCKS, round(2 / choice))))
    count = min(len(blocks) - 1, max(1, round(choice * len(blocks))))
    picked = np.random.default_rng(seed).permutation(len(blocks))[:count]
    return np.sort(np.concatenate([blocks[i] for i in picked]))
