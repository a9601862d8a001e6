"""Labelled pictures: DeepLabCut's label files with the images of a project folder, or with the frames of one video; and
which of them a network is trained on, and which it is judged by; and `recon evaluate-2d`, which compares predictions
with them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PureWindowsPath
from typing import Annotated, Any

import cv2
import numpy as np
import pandas as pd
from rich.table import Table
from rich.text import Text

from recon.animal.body import other_side
from recon.animal.naming import load_names, map_to_write, new_names, renamed
from recon.base.arrays import Array, Bools, Integers, median
from recon.base.documents import read_head
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.settings import Integer, Number, Option, Positive, Settings
from recon.clip import Keypoints, mark_missing, parse_frame_range, select_frames
from recon.io.common import first_problems
from recon.io.deeplabcut_project import Project, find_project, label_files
from recon.io.formats import as_keypoints, read_keypoints, recognised
from recon.io.video import Image, probe, read_frames, read_picture
from recon.io.writing import frames_text
from recon.show.plain import picked
from recon.workflows.cli import Answer, table_of
from recon.workflows.settings import RENAME, FrameRange

SPLIT = "Which pictures"
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


class LabelSource(Settings):
    """Labelled pictures, and which of them to learn from."""

    data: Annotated[Path, Option(argument="DATA")]
    """DeepLabCut project (its folder or config.yaml), or a video (with --labels)."""
    labels: Path | None = None
    """Label file of the video, as in CollectedData_me.csv."""
    first_frame: Integer = 0
    """Number that the labels give to the video's first frame: 50 where 0050.png is frame 0."""
    individual: str | None = None
    """The animal, where the labels name several."""
    rename: Annotated[str | None, RENAME] = None
    validation: Annotated[str, Option(panel=SPLIT)] = "0.2"
    """Pictures to judge and calibrate by: a share, or frame numbers A:B (B excluded)."""
    test: Annotated[str, Option(panel=SPLIT)] = "0"
    """Pictures that are only judged at the end, in the same way."""


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
        picture = np.asarray(cv2.GaussianBlur(picture, (0, 0), 0.5 * (1 / scale - 1) ** 0.5 + 0.15 / scale), np.uint8)
    return np.asarray(cv2.warpAffine(picture, to, size, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def scaled_size(size_px: tuple[int, int], scale: float) -> tuple[int, int]:
    return max(1, round(size_px[0] * scale)), max(1, round(size_px[1] * scale))


def scale_points(xy_px: Array, scale: float) -> Array:
    """Scale pixel coordinates with whole numbers at the centres of pixels, from one size of picture to another."""
    return (xy_px + 0.5) * scale - 0.5


def read_labels(data: Path, labels: Path | None = None, **options: Any) -> Labels:
    """A project folder, or its config.yaml, or a video with its label file; options: the other fields of `LabelSource`.

    Raises InputError with every problem: labels without a picture, pictures that cannot be read, files that do not fit
    each other.
    """
    s = LabelSource(data=data, labels=labels, **options)
    if labels is None:
        project = find_project(data)
        if data.is_file() and project is None:
            raise InputError(Problem("--labels", "file", "none", f"the label file (CSV or H5) of the video {data}"))
        read = _read_project(data, project, s.individual)
    elif data.is_dir():
        raise InputError(Problem("--labels", "file", str(labels), f"none: the folder {data} has its own label files"))
    else:
        read = _read_video(data, labels, s.first_frame, s.individual)
    if s.rename is not None:
        keep, names, note = new_names(read.names, load_names(s.rename), read.source)
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
    read_head(path)
    found = recognised(path, "2D")
    if found is None or found.name != "deeplabcut":
        raise InputError(Problem(path, "format", "another kind of file", "labels in DeepLabCut's layout, CSV or H5"))
    stored = found.read(path, individual)
    keypoints, _ = mark_missing(as_keypoints(path, stored))
    return keypoints, stored.images or tuple(map(str, keypoints.frames))


def _read_video(video: Path, path: Path, first_frame: int, individual: str | None) -> Labels:
    (keypoints, images), info = collect_problems(lambda: read_label_file(path, individual), lambda: probe(video))
    if keypoints.frames[0] < first_frame:
        expected = f"{keypoints.frames[0]} or less: the labels begin with frame {keypoints.frames[0]}"
        raise InputError(Problem("--first-frame", "number", str(first_frame), expected))
    wanted, pictures, decoded = (keypoints.frames - first_frame).tolist(), {}, 0
    asked = {*wanted}
    for number, picture in read_frames(video, 0, max(wanted) + 1):
        decoded = number + 1
        if number in asked:
            pictures[number] = picture
    if missing := [image for image, number in zip(images, wanted, strict=True) if number not in pictures]:
        stated = "" if info.stated_frames in (None, decoded) else f" (the file states {info.stated_frames})"
        expected = (
            f"a picture for each of the {len(wanted)} labelled frames; none for {len(missing)} of them, {missing[0]} "
            "first. --first-frame says which number the labels give to the video's first frame"
        )
        raise InputError(Problem(video, "frames", f"{decoded} frames that can be decoded{stated}", expected))
    return _of_clip(video, keypoints, images, [pictures[number] for number in wanted], path)


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
    parts = [
        part for part in collect_problems(*(lambda f=f: _read_folder(f, individual) for f in files)) if part is not None
    ]
    if not parts:
        raise InputError(Problem(folder, "labels", "none in any label file", "at least one labelled point"))
    names, expected = parts[0].names, f"those of {parts[0].source}: {', '.join(parts[0].names)}"
    others = [p for p in parts if sorted(p.names) != sorted(names)]
    raise_problems(Problem(p.source, "bodyparts", ", ".join(p.names), expected) for p in others)
    joined = {name: sum((getattr(p, name) for p in parts), ()) for name in ("images", "clips", "pictures", "notes")}
    xy_px = np.concatenate([p.xy_px[:, [p.names.index(n) for n in names]] for p in parts])
    clip = np.repeat(np.arange(len(parts)), [len(p.images) for p in parts])
    return Labels(names, xy_px, np.concatenate([p.numbers for p in parts]), clip=clip, source=str(folder), **joined)


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
    raise_problems(first_problems(problems, path))
    return _of_clip(path.parent, keypoints, images, pictures, path)


def extents_px(xy_px: Array) -> Array:
    """(N,): diagonals of the boxes around the labelled points (N, K, 2); NaN with fewer than two."""
    known = known_points(xy_px)
    points = np.where(known[..., None], xy_px, np.nan)
    sides = np.fmax.reduce(points, axis=1) - np.fmin.reduce(points, axis=1)
    return np.where(known.sum(axis=1) > 1, np.linalg.norm(sides, axis=1), np.nan)


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
    chosen = collect_problems(lambda: _parse(validation, "--validation"), lambda: _parse(test, "--test"))
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
    found: dict[str, dict[str, list[str]]] = {part: {} for part in split}
    for part, which in split.items():
        for c in np.unique(labels.clip[which]):
            found[part][labels.clips[c]] = frames_text(labels.numbers[which][labels.clip[which] == c])
    return found


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


# -- recon evaluate-2d: predicted keypoints against labels -------------------------------------------------------------

BINS = 10
PCK_PX = (2.5, 5.0, 10.0)
PCK_RELATIVE = (0.05, 0.1, 0.2)
"""Distances as shares of the body length, the median diagonal of the box around an animal's labels."""


class Evaluate2DSettings(Settings):
    """What `recon evaluate-2d` compares, and how."""

    predicted: Annotated[Path, Option(argument="PREDICTED")]
    """Keypoints of any known format, as in run.csv."""
    labels: Annotated[Path, Option(argument="LABELS")]
    """Labels in DeepLabCut's layout, as in CollectedData_me.csv."""
    first_frame: Integer = 0
    """Number that the labels give to frame 0 of the predictions."""
    frames: FrameRange | None = None
    """Frame numbers of the labels to compare, A:B (B excluded)."""
    individual: str | None = None
    """The animal, where the files name several."""
    rename: Annotated[str | None, RENAME] = None
    likelihood_min: Annotated[Number, Option(expected="a number from 0 to 1")] = 0.5
    """Cut-off for the rows of likely points."""
    tolerance_px: Annotated[Positive, Option(expected="pixels above 0")] = 5.0
    """Within this a point is right, for the likelihoods' reliability."""


def evaluate_2d_command(settings: Evaluate2DSettings) -> Answer:
    """Compare 2D keypoints with labels: errors in pixels, shares of good points, reliability of the likelihoods.

    Example: recon evaluate-2d run.csv CollectedData_me.csv
    """
    result = evaluate_2d_files(**picked(settings, *settings.infos()))
    return Answer(result, [_table(result), *_notes(result)])


def evaluate_2d_files(predicted: Path, labels: Path, **options: Any) -> dict[str, Any]:
    """options: further fields of `Evaluate2DSettings`. Raises InputError for files that cannot be read or have nothing
    in common."""
    o = Evaluate2DSettings(predicted=predicted, labels=labels, **options)

    def read_predicted() -> Keypoints:
        keypoints = mark_missing(read_keypoints(predicted, o.individual))[0]
        return keypoints if o.rename is None else renamed(keypoints, load_names(o.rename))

    asked = parse_frame_range(o.frames) if o.frames else None
    guess, truth = collect_problems(
        read_predicted, lambda: select_frames(read_label_file(labels, o.individual)[0], asked)
    )
    common = [name for name in truth.names if name in guess.names]
    problems = []
    if not common:
        expected = f"some of: {', '.join(truth.names)}; --rename with a file of these lines, completed"
        lines = tuple(map_to_write(guess.names, truth.names))
        problems.append(Problem(predicted, "keypoints", ", ".join(guess.names), expected, lines))
    numbers = guess.frames + o.first_frame  # as the labels count
    rows_t = np.flatnonzero(np.isin(truth.frames, numbers))
    if not len(rows_t):
        first, last = truth.frames[[0, -1]]
        expected = f"some of the labels' frames {first} to {last} that are asked for; --first-frame"
        found = f"frames {numbers[0]} to {numbers[-1]}, in the labels' numbers"
        problems.append(Problem(predicted, "frames", found, expected))
    raise_problems(problems)
    rows_g = pd.Index(numbers).get_indexer(truth.frames[rows_t])
    g, t = [guess.names.index(n) for n in common], [truth.names.index(n) for n in common]
    found, sure, known = guess.xy_px[rows_g][:, g], guess.confidence[rows_g][:, g], truth.xy_px[rows_t]
    limits = picked(o, "likelihood_min", "tolerance_px")
    return evaluate_2d(tuple(common), found, sure, known[:, t], body_length_px(known), **limits)


def evaluate_2d(
    names: tuple[str, ...],
    xy_px: Array,
    likelihood: Array,
    label_px: Array,
    length_px: float,
    likelihood_min: float = 0.5,
    tolerance_px: float = 5.0,
) -> dict[str, Any]:
    """Scores of points (N, K, 2) with likelihoods (N, K), against labels (N, K, 2), each NaN where there is none: how
    many `frames`; scores (`_score`) of `all`, of those with a likelihood cut-off (`likely`), and with the two sides of
    the animal allowed to be the wrong way round (`swaps_forgiven`, None where no names differ in their side), by
    keypoint (`per_keypoint`, `likely_per_keypoint`); and the `reliability` of the likelihoods, None without any."""
    errors, partner = np.linalg.norm(xy_px - label_px, axis=2), sides(names)
    likely = np.where(likelihood >= likelihood_min, errors, np.nan)
    paired = any(p != k for k, p in enumerate(partner))
    known = np.isfinite(errors) & np.isfinite(likelihood)

    def score(values: Array, which: int | slice = slice(None)) -> dict[str, Any]:
        return _score(values[:, which], known_points(label_px)[:, which], length_px)

    sure, right = np.clip(likelihood[known], 0, 1), errors[known] <= tolerance_px
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
        "reliability": reliability(sure, right) if known.any() else None,
    }


def _forgiving_errors_px(xy_px: Array, label_px: Array, partner: tuple[int, ...]) -> Array:
    """Errors (N, K) with each pair of sides the right way round or the other, whichever is better for the pair."""
    own = np.linalg.norm(xy_px - label_px, axis=2)
    other = np.linalg.norm(xy_px[:, list(partner)] - label_px, axis=2)
    cost = np.stack([own, other])
    of_pair = np.nansum(np.stack([cost, cost[:, :, list(partner)]]), axis=0)
    return np.where(of_pair[1] < of_pair[0], other, own)


def _score(errors: Array, labelled: Bools, length_px: float) -> dict[str, Any]:
    """Scores of errors that are NaN where not labelled or not found: how many labelled `points`, the share of them
    `found` (and likely enough), RMSE and median over those, NaN without any, and by distance (`pck_px`) and by part of
    the body length (`pck_relative`) shares of all labelled points, those not found being wrong."""
    n = int(labelled.sum())
    found = errors[labelled & np.isfinite(errors)]

    def share(limit_px: float) -> float:
        return float((found <= limit_px).sum() / n) if n and np.isfinite(limit_px) else np.nan

    return {
        "points": n,
        "found": len(found) / n if n else np.nan,
        "rmse_px": float(np.sqrt(np.mean(found**2))) if len(found) else np.nan,
        "median_px": float(np.median(found)) if len(found) else np.nan,
        "pck_px": {str(limit): share(limit) for limit in PCK_PX},
        "pck_relative": {str(limit): share(limit * length_px) for limit in PCK_RELATIVE},
    }


def reliability(likelihood: Array, right: Bools, bins: int = BINS) -> dict[str, Any]:
    """How reliable likelihoods (N,) in 0 to 1 are, given whether their points are right (N,): how many `points` they
    are; their `expected_calibration_error`, the mean difference of likelihood and share of right points, NaN without
    any; and for the `bins` of equal width with points in them how many; low and high, between which their likelihoods
    lie; their mean; and the share of them that is right."""
    which, rows = np.minimum((likelihood * bins).astype(int), bins - 1), []
    for b in np.unique(which):
        here = which == b
        ends = {"low": float(b / bins), "high": float((b + 1) / bins), "points": int(here.sum())}
        rows.append(ends | {"likelihood": float(likelihood[here].mean()), "right": float(right[here].mean())})
    total = len(likelihood)
    error = sum(r["points"] * abs(r["likelihood"] - r["right"]) for r in rows) / total if total else float("nan")
    return {"points": total, "expected_calibration_error": float(error), "bins": rows}


def _table(result: dict[str, Any]) -> Table:
    pck = (*(f"{t:g}px" for t in PCK_PX), *(f"{t:.0%}" for t in PCK_RELATIVE))
    table = table_of("errors in px", numbers=("n", "found", "RMSE", "median", *pck), padding=(0, 1, 0, 0))

    def add_row(name: str, score: dict[str, Any], last: bool = False) -> None:
        cells = [str(score["points"]), f"{score['found']:.0%}", f"{score['rmse_px']:.2f}", f"{score['median_px']:.2f}"]
        cells += [f"{share:.0%}" for share in (*score["pck_px"].values(), *score["pck_relative"].values())]
        row = (cell.replace("nan%", "-").replace("nan", "-") for cell in cells)
        table.add_row(Text(name), *row, end_section=last)

    add_row("all", result["all"])
    add_row("likely", result["likely"], last=result["swaps_forgiven"] is None)
    if result["swaps_forgiven"] is not None:
        add_row("swaps forgiven", result["swaps_forgiven"], last=True)
    for name, score in result["per_keypoint"].items():
        add_row(name, score)
        add_row("  likely", result["likely_per_keypoint"][name])
    return table


def _notes(result: dict[str, Any]) -> Iterator[str]:
    yield "found   share of the labelled points that was predicted; likely: with a likelihood of at least"
    yield f"        {result['likelihood_min']:g}; swaps forgiven: a pair of left and right may be the wrong way round"
    yield "RMSE    and median over the points found"
    yield "px, %   share of all labelled points within this distance, or this share of the body length,"
    yield f"        {result['body_length_px']:.1f} px (median diagonal of the box around an animal's labels)"
    yield f"Compared: {result['frames']} frames."
    table = result["reliability"]
    if table is not None:
        yield f"Likelihood against the share of points within {result['tolerance_px']:g} px, {table['points']} points:"
        for b in table["bins"]:
            shares = f"likelihood {b['likelihood']:.2f}  right {b['right']:.2f}"
            yield f"  {b['low']:.1f} to {b['high']:.1f}  {b['points']:6d} points  {shares}"
        yield f"Expected calibration error: {table['expected_calibration_error']:.3f}"
