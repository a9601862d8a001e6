"""Detect calibration boards in pictures and videos.

Views come from pictures, or from frames of a video that are sharp and differ from each other. The coordinate frame of a
board lies in its surface, with x to the right, y down and z away from the viewer, metres. This frame is parallel to the
camera frame if the board is seen head-on. Corners are the points at which four squares meet.
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

from recon.base.arrays import Array, Index
from recon.base.errors import NO_FILE, InputError, Problem, raise_problems
from recon.base.progress import Progress, silent
from recon.io.video import SUFFIXES as VIDEO_SUFFIXES
from recon.io.video import probe, read_frames, read_picture

Gray = npt.NDArray[np.uint8]
UNITS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
MIN_CORNERS = 8
"""Minimum number of corners that must be detected in a picture.

A pose has six unknowns and needs four corners. With twice as many corners, the residuals can reveal a wrong pose.
"""

CHESSBOARD_FORM = "chessboard:9x6:25mm (inner corners, one fewer than squares in each direction; side of a square)"
_SIZE = r"(\d+)x(\d+):(\d+(?:\.\d*)?|\.\d+)(mm|cm|m)"
_CHESSBOARD = re.compile(f"chessboard:{_SIZE}")
_CHARUCO = re.compile(rf"charuco:{_SIZE}:(\d+(?:\.\d*)?|\.\d+)(mm|cm|m):(\w+)(:legacy)?")
CHARUCO_FORM = "charuco:5x7:40mm:30mm:DICT_4X4_50 (squares; side of a square; side of a marker; dictionary)"
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp")
MAX_VIEWS = 40
"""Maximum number of views taken from a video.

Standard deviations decrease only with the square root of the number, so more views mainly take more time.
"""
MAX_EXAMINED = 600
"""Maximum number of frames of a video in which the board is searched for."""
EXAMINED_HZ = 5.0
"""Frames per second of a video in which the board is searched for."""
SHARPNESS_KEPT = 0.7
"""Minimum sharpness of a frame relative to the 75th percentile of all frames."""
MIN_DIFFERENCE = 0.02
"""Minimum movement of the board's outline between two views, as a fraction of the picture's diagonal.

Views with less movement count as the same view.
"""


Corners = tuple[Index, Array]
"""Rows (N,) of the board's `points_m` that were detected, and their pixels (N, 2)."""


@dataclass(frozen=True)
class Board:
    """Chessboard, or ChArUco board with markers in its light squares."""

    columns: int
    """Number of inner corners in a row, or of squares for a board with markers."""
    rows: int
    square_m: float
    """Side of a square in metres."""
    marker_m: float | None = None
    """Side of a marker in metres; None for a chessboard."""
    dictionary: str = ""
    """Name of the markers' dictionary in OpenCV."""
    legacy: bool = False
    """Whether the board has the layout of OpenCV before 4.6, which differs for an even number of rows."""

    def __str__(self) -> str:
        size, side = f"{self.columns}x{self.rows}", f"squares of {1000 * self.square_m:g} mm"
        if self.marker_m is None:
            return f"chessboard of {size} inner corners, {side}"
        markers = f"markers of {1000 * self.marker_m:g} mm from {self.dictionary}" + self.legacy * ", legacy layout"
        return f"ChArUco board of {size} {side}, {markers}"

    @cached_property
    def charuco(self) -> cv2.aruco.CharucoBoard:
        """Return OpenCV's description of a board with markers."""
        assert self.marker_m is not None
        size = (self.columns, self.rows)
        board = cv2.aruco.CharucoBoard(size, self.square_m, self.marker_m, _dictionary(self.dictionary))
        board.setLegacyPattern(self.legacy)
        return board

    @cached_property
    def points_m(self) -> Array:
        """Return the corners (K, 3) in the board frame, metres, row by row in OpenCV's order."""
        first = 0 if self.marker_m is None else 1
        y, x = np.mgrid[first : self.rows, first : self.columns]
        return self.square_m * np.stack((x.ravel(), y.ravel(), np.zeros(x.size)), axis=1)

    @cached_property
    def outline_m(self) -> Array:
        """Return the four outer corners (4, 3) of the board's squares, metres."""
        x0 = y0 = -1 if self.marker_m is None else 0
        x1, y1 = self.columns, self.rows
        return self.square_m * np.array([(x0, y0, 0.0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)])

    def detect(self, image: Gray) -> Corners | None:
        """Return the corners in a picture (height, width), or None.

        A chessboard is detected as a whole or not at all. For a ChArUco board, the result has the corners between the
        markers that were read, or is None if there are too few.
        """
        if self.marker_m is None:
            size = (self.columns, self.rows)
            is_found, xy = cv2.findChessboardCornersSB(image, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
            if not is_found:
                return None
            xy = np.asarray(xy, dtype=float).reshape(-1, 2)
            if xy[0].sum() > xy[-1].sum():
                xy = xy[::-1]  # rotated by 180 degrees the board looks the same, so this order is a convention
            return np.arange(len(xy)), _refined_corners(image, xy, 0.28)
        xy, ids, _, _ = cv2.aruco.CharucoDetector(self.charuco).detectBoard(image)
        if ids is None or len(ids) < MIN_CORNERS:
            return None
        # The window must end before the nearest marker, whose corner would attract the refined corner.
        reach = 0.45 * (1 - self.marker_m / self.square_m)
        xy = _refined_corners(image, np.asarray(xy, dtype=float).reshape(-1, 2), reach)
        return np.ravel(ids).astype(np.intp), xy


def parse_board(text: str) -> Board:
    """Return the board described by a string of the form `CHESSBOARD_FORM` or `CHARUCO_FORM`, also with `:legacy`.

    Raises
    ------
    InputError
        If the text has another form.
    """
    match = _CHESSBOARD.fullmatch(text.strip()) or _CHARUCO.fullmatch(text.strip())
    if match is None:
        raise InputError(Problem("--board", "board", repr(text), f"{CHESSBOARD_FORM}, or {CHARUCO_FORM}"))
    columns, rows, square, unit, *markers = match.groups()
    board = Board(int(columns), int(rows), float(square) * UNITS_M[unit])
    problems = []
    if min(board.columns, board.rows) < 3 or not board.square_m > 0:
        problems = [Problem("--board", "size", repr(text), "three or more columns and rows, and a size above 0")]
    if markers:
        size, unit, dictionary, legacy = markers
        marker_m = float(size) * UNITS_M[unit]
        board = replace(board, marker_m=marker_m, dictionary=dictionary.upper(), legacy=bool(legacy))
        if not 0 < marker_m < board.square_m:
            expected = f"less than the side of a square, {square}{unit}"
            problems.append(Problem("--board", "side of a marker", size + unit, expected))
        dictionaries = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_") and name == name.upper())
        needed = board.columns * board.rows // 2
        if board.dictionary not in dictionaries:
            problems.append(Problem("--board", "dictionary", repr(dictionary), f"one of {', '.join(dictionaries)}"))
        elif (marker_count := len(_dictionary(board.dictionary).bytesList)) < needed:
            problems.append(
                Problem(
                    "--board",
                    "dictionary",
                    f"{marker_count} markers in {dictionary}",
                    f"a dictionary of {needed} markers or more",
                )
            )
    raise_problems(problems)
    return board


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _refined_corners(image: Gray, xy_px: Array, reach: float) -> Array:
    """Return corners (N, 2) in px, refined to the nearest intersection of edges.

    The half-width of the window is `reach` times the distance between corners, because the window must contain neither
    the board's edge nor another corner. A corner that would leave the window is not moved.
    """
    distance = np.linalg.norm(xy_px[:, None] - xy_px, axis=2) + np.diag(np.full(len(xy_px), np.inf))
    # The window has the same size for all corners, determined by the far corners of a tilted board.
    half = int(np.clip(round(reach * np.percentile(distance.min(axis=1), 20)), 2, 15))
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    start = xy_px.astype(np.float32).reshape(-1, 1, 2)
    moved_px = np.asarray(cv2.cornerSubPix(image, start, (half, half), (-1, -1), criteria), dtype=float).reshape(-1, 2)
    return np.where(np.linalg.norm(moved_px - xy_px, axis=1, keepdims=True) <= half, moved_px, xy_px)


@dataclass(frozen=True)
class BoardView:
    """Picture in which the board was detected."""

    name: str
    """Name of the picture file, or number of the video's frame."""
    ids: Index
    """Rows of the board's `points_m` that were detected, shape (N,)."""
    xy_px: Array
    """Detected corners, shape (N, 2)."""


@dataclass(frozen=True)
class BoardViews:
    """Views of a board in picture files or a video, and the pictures that do not show it."""

    board: Board
    image_size_px: tuple[int, int]
    views: tuple[BoardView, ...]
    """Views of the board to calibrate from."""
    without_board: tuple[str, ...]
    """Names of the pictures without the board."""
    with_board: int
    """Number of pictures with the board."""

    @property
    def examined(self) -> int:
        """Return the number of pictures that were examined."""
        return self.with_board + len(self.without_board)


def collect(paths: Iterable[Path]) -> list[Path]:
    """Return the picture files among the paths and in folders among the paths, or a single video.

    Raises
    ------
    InputError
        If a path does not exist, a folder has no pictures, or a video is among other files. The error lists them all.
    """
    files: list[Path] = []
    problems = []
    for path in paths:
        if path.is_dir():
            pictures = sorted(file for file in path.iterdir() if file.suffix.lower() in IMAGE_SUFFIXES)
            if not pictures:
                expected = f"pictures ({', '.join(IMAGE_SUFFIXES)})"
                problems.append(Problem(path, "folder", "no pictures", expected))
            files += pictures
        elif not path.exists():
            problems.append(Problem(path, "file", NO_FILE, "a picture, a folder of pictures or a video"))
        else:
            files.append(path)
    videos = [file for file in files if _is_video(file)]
    if videos and len(files) > 1:
        expected = "a single video, or pictures and folders of pictures"
        problems.append(Problem(videos[0], "inputs", f"a video among {len(files)} files", expected))
    raise_problems(problems)
    return list(dict.fromkeys(files))


def find_views(files: Sequence[Path], board: Board, progress: Progress = silent) -> BoardViews:
    """Find a board in pictures or in one video, as returned by `collect`.

    Raises
    ------
    InputError
        If files cannot be read, pictures differ in size, or no picture shows the board. The error lists all faults.
    """
    is_video, sizes = _is_video(files[0]), dict[str, tuple[int, int]]()
    problems, names_without, views_found = list[Problem](), list[str](), list[BoardView]()
    sharpness, outlines = list[float](), list[Array]()
    for name, fraction, image in _frames(files[0]) if is_video else _images(files):
        progress("looking for the board", fraction)
        if image is None:
            problems.append(
                Problem(
                    name, "file", "a picture that OpenCV cannot read", f"a picture, such as {', '.join(IMAGE_SUFFIXES)}"
                )
            )
            continue
        sizes[name] = (image.shape[1], image.shape[0])
        if len(set(sizes.values())) > 1 or problems:
            continue  # the input is refused, and the loop continues only to list all problems
        corners = board.detect(image)
        if corners is None:
            names_without.append(name)
            continue
        views_found.append(BoardView(name, *corners))
        if is_video:
            sharpness.append(corner_sharpness(image, corners[1]))
            outlines.append(_outline(board, *corners) / math.hypot(*sizes[name]))
    if len(set(sizes.values())) > 1:
        problems.append(_mixed_sizes(sizes))
    raise_problems(problems)
    if not views_found:
        expected = f"a {board}: is this the right board? For the layout of OpenCV before 4.6, add :legacy"
        if board.marker_m is None:
            expected = f"a whole {board} with a white margin: is this the right board? --board counts inner corners, "
            expected += "one fewer than squares in each direction"
        examined_text = f"none in {len(names_without)} {'frames' if is_video else 'pictures'}"
        raise InputError(Problem(files[0] if len(files) == 1 else "pictures", "board", examined_text, expected))
    views = [views_found[i] for i in choose(np.array(sharpness), np.array(outlines))] if is_video else views_found
    return BoardViews(board, next(iter(sizes.values())), tuple(views), tuple(names_without), len(views_found))


def _is_video(path: Path) -> bool:
    return path.suffix.lower() in VIDEO_SUFFIXES


def _images(files: Sequence[Path]) -> Iterator[tuple[str, float, Gray | None]]:
    """Yield each picture's name, the fraction of pictures before it, and the picture, (height, width).

    Pictures are rotated upright by their EXIF tag. A picture that cannot be read is None.
    """
    unique = len({file.name for file in files}) == len(files)
    for done, file in enumerate(files):
        image = read_picture(file, cv2.IMREAD_GRAYSCALE)
        name = file.name if unique and image is not None else str(file)
        yield name, done / len(files), image


def _frames(path: Path) -> Iterator[tuple[str, float, Gray]]:
    """Yield evenly spaced frames of a video, each with the fields that `_images` yields for a picture."""
    info = probe(path)
    count = info.stated_frames or sum(1 for _ in read_frames(path, step=2**31))
    step = max(1, math.ceil(max((info.fps or 30.0) / EXAMINED_HZ, count / MAX_EXAMINED)))
    for number, image in read_frames(path, step=step):
        gray = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        yield f"frame {number}", min(1.0, number / count), gray


def _mixed_sizes(sizes: dict[str, tuple[int, int]]) -> Problem:
    names_of_size = {size: [name for name, own_size in sizes.items() if own_size == size] for size in sizes.values()}
    found_sizes = "; ".join(
        f"{width}x{height} ({', '.join(names[:3])})" for (width, height), names in names_of_size.items()
    )
    expected = "pictures of one size and orientation, as in the clips, since a calibration is for one resolution"
    return Problem("pictures", "size", found_sizes, expected)


def choose(sharpness: Array, outlines: Array, count: int = MAX_VIEWS) -> list[int]:
    """Return the indices of frames that are sharp and as different as possible, in ascending order.

    The first choice is the sharpest frame. Each further choice is the sharp frame that differs most from all chosen
    frames (root mean square over the outline), until `count` are chosen or the next differs by less than
    `MIN_DIFFERENCE`.

    Parameters
    ----------
    sharpness : ndarray
        Sharpness of each frame, shape (N,).
    outlines : ndarray
        Outer corners of the board in each frame, as fractions of the picture's diagonal, shape (N, 4, 2).
    count : int
        Maximum number of frames.
    """
    sharp_rows = np.flatnonzero(sharpness >= SHARPNESS_KEPT * np.percentile(sharpness, 75))
    first = int(np.argmax(sharpness))
    chosen = [first]
    distance = np.full(len(sharp_rows), np.inf)
    while len(chosen) < count:
        change = outlines[sharp_rows] - outlines[chosen[-1]]
        distance = np.minimum(distance, np.sqrt((change**2).sum(axis=2).mean(axis=1)))
        farthest = int(np.argmax(distance))
        if distance[farthest] < MIN_DIFFERENCE:
            break
        chosen.append(int(sharp_rows[farthest]))
    return sorted(chosen)


def corner_sharpness(image: Gray, xy_px: Array) -> float:
    """Return the sharpness of a board in a picture (height, width), 1/px, about the inverse width of an edge.

    The sharpness around each corner (N, 2) is the square root of the smaller eigenvalue of the gradients' mean outer
    product, relative to the contrast. Motion in one direction blurs only the edges across it, and thus reduces only the
    smaller eigenvalue.
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
    """Return the board's outer corners (4, 2) in the picture, px, extrapolated without distortion."""
    points = board.points_m[ids, :2]
    homography, _ = cv2.findHomography(points, xy_px)
    if homography is None:  # all corners are on one line
        return np.tile(xy_px.mean(axis=0), (4, 1))
    return cv2.perspectiveTransform(board.outline_m[None, :, :2], np.asarray(homography, dtype=float))[0]
