"""Calibration boards: what they look like, where their corners are in a picture, and views of them from pictures or
from a video, of which the sharp and different frames are enough.

A board's frame lies in its surface: x to the right, y down, z away from the viewer, metres; a board that is seen
squarely is parallel to the camera frame. Corners are where four squares meet.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from recon.base import Progress, silent
from recon.base.arrays import Array, Index
from recon.base.errors import InputError, Problem, refuse
from recon.io.video import SUFFIXES as VIDEO_SUFFIXES
from recon.io.video import probe, read_frames

Gray = npt.NDArray[np.uint8]
UNITS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
MIN_CORNERS = 8
"""A pose has six unknowns and needs four corners; twice that leaves residuals which can show that it is wrong."""

CHESSBOARD_FORM = "chessboard:9x6:25mm (inner corners, one fewer than squares each way; side of a square)"
_SIZE = r"(\d+)x(\d+):(\d+(?:\.\d*)?|\.\d+)(mm|cm|m)"
_CHESSBOARD = re.compile(f"chessboard:{_SIZE}")
_CHARUCO = re.compile(rf"charuco:{_SIZE}:(\d+(?:\.\d*)?|\.\d+)(mm|cm|m):(\w+)(:legacy)?")
CHARUCO_FORM = "charuco:5x7:40mm:30mm:DICT_4X4_50 (squares; side of a square; side of a marker; dictionary)"
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp")
MAX_VIEWS = 40
"""How many pictures of a video are taken. Standard deviations fall with the square root of the number: more add time
and little else."""
MAX_EXAMINED = 600
"""Frames of a video in which the board is looked for."""
EXAMINED_HZ = 5.0
SHARPNESS_KEPT = 0.7
"""A frame that is less sharp than this share of the sharp ones (their 75th percentile) is left out."""
MIN_DIFFERENCE = 0.02
"""Two frames between which the board's outline moved by less, relative to the picture's diagonal, are the same view."""


Corners = tuple[Index, Array]
"""Corners of a board in one picture: rows (N,) of the board's `points_m`, and pixels (N, 2)."""


@dataclass(frozen=True)
class Board:
    """A board of squares, or a ChArUco board, which has markers in the light ones."""

    columns: int
    """The number of inner corners across; of squares, where there are markers."""
    rows: int
    square_m: float
    """The side of a square in metres."""
    marker_m: float | None = None
    """Side of a marker; None: a chessboard."""
    dictionary: str = ""
    """OpenCV's name of the markers' dictionary."""
    legacy: bool = False
    """The layout of OpenCV before 4.6, which differs for an even number of rows."""

    def __str__(self) -> str:
        size, side = f"{self.columns}x{self.rows}", f"squares of {1000 * self.square_m:g} mm"
        if self.marker_m is None:
            return f"chessboard of {size} inner corners, {side}"
        markers = f"markers of {1000 * self.marker_m:g} mm from {self.dictionary}" + self.legacy * ", legacy layout"
        return f"ChArUco board of {size} {side}, {markers}"

    @cached_property
    def charuco(self) -> cv2.aruco.CharucoBoard:
        """OpenCV's board, of one with markers."""
        assert self.marker_m is not None
        size = (self.columns, self.rows)
        board = cv2.aruco.CharucoBoard(size, self.square_m, self.marker_m, _dictionary(self.dictionary))
        board.setLegacyPattern(self.legacy)
        return board

    @cached_property
    def points_m(self) -> Array:
        """Corners (K, 3), board frame, metres: row by row, as OpenCV numbers them."""
        first = 0 if self.marker_m is None else 1
        y, x = np.mgrid[first : self.rows, first : self.columns]
        return self.square_m * np.stack((x.ravel(), y.ravel(), np.zeros(x.size)), axis=1)

    @cached_property
    def outline_m(self) -> Array:
        """Corners (4, 3) of the outermost squares."""
        x0 = y0 = -1 if self.marker_m is None else 0
        x1, y1 = self.columns, self.rows
        return self.square_m * np.array([(x0, y0, 0.0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)])

    def detect(self, image: Gray) -> Corners | None:
        """The corners in a picture (height, width), or None: a chessboard is found whole or not at all, of a ChArUco
        board the corners between markers that were read, where they are enough."""
        if self.marker_m is None:
            size = (self.columns, self.rows)
            found, xy = cv2.findChessboardCornersSB(image, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
            if not found:
                return None
            xy = np.asarray(xy, dtype=float).reshape(-1, 2)
            if xy[0].sum() > xy[-1].sum():
                xy = xy[::-1]  # half a turn maps the board onto itself, and which end comes first is arbitrary
            return np.arange(len(xy)), _refined_corners(image, xy, 0.28)
        xy, ids, _, _ = cv2.aruco.CharucoDetector(self.charuco).detectBoard(image)
        if ids is None or len(ids) < MIN_CORNERS:
            return None
        # As far as the nearest marker, which would pull the corner towards its own.
        reach = 0.45 * (1 - self.marker_m / self.square_m)
        xy = _refined_corners(image, np.asarray(xy, dtype=float).reshape(-1, 2), reach)
        return np.ravel(ids).astype(np.intp), xy


def parse_board(text: str) -> Board:
    """A board from its description, as in `CHESSBOARD_FORM` and `CHARUCO_FORM`; `:legacy` may follow the second.

    Raises InputError.
    """
    form = _CHESSBOARD.fullmatch(text.strip()) or _CHARUCO.fullmatch(text.strip())
    if form is None:
        raise InputError(Problem("--board", "board", repr(text), f"{CHESSBOARD_FORM}, or {CHARUCO_FORM}"))
    columns, rows, square, unit, *markers = form.groups()
    board = Board(int(columns), int(rows), float(square) * UNITS_M[unit])
    problems = []
    if min(board.columns, board.rows) < 3 or not board.square_m > 0:
        problems = [Problem("--board", "size", repr(text), "three or more columns and rows, of some size")]
    if markers:
        size, unit, dictionary, legacy = markers
        marker_m = float(size) * UNITS_M[unit]
        board = replace(board, marker_m=marker_m, dictionary=dictionary.upper(), legacy=bool(legacy))
        if not 0 < marker_m < board.square_m:
            problems.append(
                Problem("--board", "side of a marker", size + unit, f"less than {square}{unit} of a square")
            )
        known = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_") and name == name.upper())
        needed = board.columns * board.rows // 2
        if board.dictionary not in known:
            problems.append(Problem("--board", "dictionary", repr(dictionary), f"one of {', '.join(known)}"))
        elif (held := len(_dictionary(board.dictionary).bytesList)) < needed:
            problems.append(Problem("--board", "dictionary", f"{held} markers in {dictionary}", f"{needed} or more"))
    refuse(problems)
    return board


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _refined_corners(image: Gray, xy_px: Array, reach: float) -> Array:
    """Corners (N, 2) moved to where the gradients around them say, within `reach` of the distance to the next corner.

    That halves the error of what the detectors give. The window must see neither the board's edge nor a neighbour:
    real chessboards have the smallest errors with 0.3, and from 0.4 outer corners drift. One that would move by more
    than the window stays.
    """
    distance = np.linalg.norm(xy_px[:, None] - xy_px, axis=2) + np.diag(np.full(len(xy_px), np.inf))
    # The window is the same for all; in a tilted board the far corners decide.
    half = int(np.clip(round(reach * np.percentile(distance.min(axis=1), 20)), 2, 15))
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    start = xy_px.astype(np.float32).reshape(-1, 1, 2)
    moved = np.asarray(cv2.cornerSubPix(image, start, (half, half), (-1, -1), criteria), dtype=float).reshape(-1, 2)
    return np.where(np.linalg.norm(moved - xy_px, axis=1, keepdims=True) <= half, moved, xy_px)


# -- views ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class BoardView:
    """One picture in which the board was found. name: the file's, or the frame's number."""

    name: str
    ids: Index
    """(N,), rows of the board's `points_m`."""
    xy_px: Array
    """The corners in pixels, shape (N, 2)."""


@dataclass(frozen=True)
class BoardViews:
    """The pictures of a board in some files."""

    board: Board
    image_size_px: tuple[int, int]
    views: tuple[BoardView, ...]
    """The views of the board that the calibration is made from."""
    without_board: tuple[str, ...]
    """Names of the pictures in which it was not found."""
    found: int
    """In how many pictures the board was."""

    @property
    def examined(self) -> int:
        """How many pictures were looked at."""
        return self.found + len(self.without_board)


def collect(paths: Iterable[Path]) -> list[Path]:
    """Pictures, those in folders included; or one video, alone.

    Raises InputError for every path with nothing behind it, every folder without pictures, and a video among others.
    """
    files: list[Path] = []
    problems = []
    for path in paths:
        if path.is_dir():
            inside = sorted(file for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
            if not inside:
                expected = f"pictures ({', '.join(IMAGE_SUFFIXES)})"
                problems.append(Problem(path, "folder", "no pictures", expected))
            files += inside
        elif not path.exists():
            problems.append(Problem(path, "file", "nothing there", "a picture, a folder of pictures or a video"))
        else:
            files.append(path)
    videos = [file for file in files if _is_video(file)]
    if videos and len(files) > 1:
        expected = "one video alone, or pictures and folders of pictures"
        problems.append(Problem(videos[0], "inputs", f"a video among {len(files)} files", expected))
    refuse(problems)
    return list(dict.fromkeys(files))


def find_views(files: Sequence[Path], board: Board, progress: Progress = silent) -> BoardViews:
    """Find a board in pictures or in one video, as `collect` gives them.

    Raises InputError, with every problem at once, for files that cannot be read, pictures that differ in size, and
    where the board is in none of them.
    """
    is_video, sizes = _is_video(files[0]), dict[str, tuple[int, int]]()
    problems, without, found = list[Problem](), list[str](), list[BoardView]()
    sharpness, outlines = list[float](), list[Array]()
    for name, share, image in _frames(files[0]) if is_video else _images(files):
        progress("looking for the board", share)
        if image is None:
            problems.append(Problem(name, "file", "no picture that OpenCV can read", ", ".join(IMAGE_SUFFIXES)))
            continue
        sizes[name] = (image.shape[1], image.shape[0])
        if len(set(sizes.values())) > 1 or problems:
            continue  # it is an error already; what remains is to name all of it
        corners = board.detect(image)
        if corners is None:
            without.append(name)
            continue
        found.append(BoardView(name, *corners))
        if is_video:
            sharpness.append(corner_sharpness(image, corners[1]))
            outlines.append(_outline(board, *corners) / math.hypot(*sizes[name]))
    if len(set(sizes.values())) > 1:
        problems.append(_mixed_sizes(sizes))
    refuse(problems)
    if not found:
        expected = (
            f"a {board}, whole and with a white margin: is that the board? --board counts inner corners, one fewer "
            "than squares each way"
            if board.marker_m is None
            else f"a {board}: is that the board? It may have the layout of OpenCV before 4.6: try :legacy"
        )
        looked = f"none in {len(without)} {'frames' if is_video else 'pictures'}"
        raise InputError(Problem(files[0] if len(files) == 1 else "pictures", "board", looked, expected))
    views = [found[i] for i in choose(np.array(sharpness), np.array(outlines))] if is_video else found
    return BoardViews(board, next(iter(sizes.values())), tuple(views), tuple(without), len(found))


def _is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEO_SUFFIXES


def _images(files: Sequence[Path]) -> Iterator[tuple[str, float, Gray | None]]:
    """The name of each picture, how much of all came before it, and the picture turned upright as its camera says, None
    where it cannot be read."""
    unique = len({file.name for file in files}) == len(files)
    for done, file in enumerate(files):
        try:
            data = np.fromfile(file, dtype=np.uint8)  # cv2.imread does not take every path on Windows
        except OSError:
            data = np.zeros(0, dtype=np.uint8)
        image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if data.size else None
        name = file.name if unique and image is not None else str(file)
        yield name, done / len(files), None if image is None else np.asarray(image, dtype=np.uint8)


def _frames(path: Path) -> Iterator[tuple[str, float, Gray]]:
    """The same of some frames of a video."""
    info = probe(path)
    count = info.stated_frames or sum(1 for _ in read_frames(path, step=2**31))
    step = max(1, math.ceil(max((info.fps or 30.0) / EXAMINED_HZ, count / MAX_EXAMINED)))
    for number, image in read_frames(path, step=step):
        gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        yield f"frame {number}", min(1.0, number / count), gray


def _mixed_sizes(sizes: dict[str, tuple[int, int]]) -> Problem:
    named = {size: [name for name, other in sizes.items() if other == size] for size in sizes.values()}
    found = "; ".join(f"{width}x{height} ({', '.join(names[:3])})" for (width, height), names in named.items())
    expected = "one size, that of the clips, and all upright or all lying: a calibration holds for one resolution"
    return Problem("pictures", "size", found, expected)


def choose(sharpness: Array, outlines: Array, most: int = MAX_VIEWS) -> list[int]:
    """Frames that are sharp and as different as can be, in order.

    sharpness: (N,). outlines: (N, 4, 2), the board's corners relative to the picture's diagonal. The first is the
    sharpest; every next one is, of the sharp ones, the one that is farthest from all that were chosen (root mean square
    over the outline), until `most` are chosen or the farthest is a repetition.
    """
    sharp = np.flatnonzero(sharpness >= SHARPNESS_KEPT * np.percentile(sharpness, 75))
    first = int(np.argmax(sharpness))
    chosen = [first]
    distance = np.full(len(sharp), np.inf)
    while len(chosen) < most:
        step = outlines[sharp] - outlines[chosen[-1]]
        distance = np.minimum(distance, np.sqrt((step**2).sum(axis=2).mean(axis=1)))
        farthest = int(np.argmax(distance))
        if distance[farthest] < MIN_DIFFERENCE:
            break
        chosen.append(int(sharp[farthest]))
    return sorted(chosen)


def corner_sharpness(image: Gray, xy_px: Array) -> float:
    """How sharp a board is in a picture (height, width), from its corners (N, 2): about 1 / the width of an edge (px).

    Around each corner, the root of the smaller eigenvalue of the mean outer product of the gradients, relative to the
    contrast: motion in one direction blurs the edges across it, and leaves the larger eigenvalue as it is.
    """
    half = 5
    scores = []
    for x, y in np.rint(xy_px).astype(int):
        patch = image[max(0, y - half) : y + half + 1, max(0, x - half) : x + half + 1].astype(np.float32)
        low, high = np.percentile(patch, (5, 95)) if patch.size else (0.0, 0.0)
        if min(patch.shape) < 3 or high - low < 10:
            continue
        gy, gx = np.gradient(patch)
        tensor = np.array([[np.mean(gx * gx), np.mean(gx * gy)], [np.mean(gx * gy), np.mean(gy * gy)]])
        scores.append(math.sqrt(max(0.0, float(np.linalg.eigvalsh(tensor)[0]))) / float(high - low))
    return float(np.median(scores)) if scores else 0.0


def _outline(board: Board, ids: Index, xy_px: Array) -> Array:
    """The board's outermost corners (4, 2) in the picture, extrapolated as if there was no distortion."""
    points = board.points_m[ids, :2]
    homography, _ = cv2.findHomography(points, xy_px)
    if homography is None:  # all corners on one line
        return np.tile(xy_px.mean(axis=0), (4, 1))
    return cv2.perspectiveTransform(board.outline_m[None, :, :2], np.asarray(homography, dtype=float))[0]
