"""Detect calibration boards and calibrate a camera from views of them.

Views come from pictures, or from the frames of a video that are sharp and differ from each other. A board's frame lies
in its surface: x to the right, y down, z away from the viewer, metres. The frame of a board seen head-on is parallel to
the camera frame. Corners are the points in which four squares meet.

Each corner is modelled as the board's point, moved by the view's pose (6 unknowns per view) and projected by the lens
and the camera matrix. OpenCV minimises the squared errors. The residuals are computed by `Camera.project`, the model
that the rest of the package uses, so that a difference between the two models would show as an error.

A picture whose error (root mean square over its corners) is more than `DROP_FACTOR` times the median picture's is left
out, and the remaining pictures are solved again, up to `ROUNDS` times. Errors of good pictures are within a factor of
two of the median for all lenses; a picture beyond a factor of three has moved, bent or wrongly detected corners. Least
squares are not robust: one such picture can change the focal length by more than the uncertainty from all the others.
Errors below `DROP_FLOOR_PX` are as small as those of a good detector, and never a reason to leave a picture out. The
report lists the pictures that were left out, with their errors.

**Is the result good enough?** Each quantity has two limits: beyond the first there is a warning, beyond the second the
calibration is refused. Three properties matter for a reconstruction. The first is the focal length: an error of 1 % is
1 % of every distance from the camera, which is small compared with the 3 to 10 % to which an animal's size is known.
The second is the principal point: 1 % of the width is about 0.6 degrees. The third is that the lens model is valid all
over the picture, since the animal may be anywhere in it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt
from cv2.typing import MatLike
from scipy.linalg import block_diag

from recon.base.arrays import Array, Bools, Index
from recon.base.errors import NO_FILE, InputError, Problem, raise_problems
from recon.base.progress import Progress, silent
from recon.geometry.camera import Camera
from recon.geometry.lens import LENS_MODELS
from recon.io.video import SUFFIXES as VIDEO_SUFFIXES
from recon.io.video import probe, read_frames, read_picture

Gray = npt.NDArray[np.uint8]
UNITS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
MIN_CORNERS = 8
"""Minimum number of corners. A pose has six unknowns and needs four corners; twice as many leave residuals that can
reveal a wrong pose.
"""

CHESSBOARD_FORM = "chessboard:9x6:25mm (inner corners, one fewer than squares in each direction; side of a square)"
_SIZE = r"(\d+)x(\d+):(\d+(?:\.\d*)?|\.\d+)(mm|cm|m)"
_CHESSBOARD = re.compile(f"chessboard:{_SIZE}")
_CHARUCO = re.compile(rf"charuco:{_SIZE}:(\d+(?:\.\d*)?|\.\d+)(mm|cm|m):(\w+)(:legacy)?")
CHARUCO_FORM = "charuco:5x7:40mm:30mm:DICT_4X4_50 (squares; side of a square; side of a marker; dictionary)"
IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff", ".bmp", ".webp")
MAX_VIEWS = 40
"""Maximum number of frames of a video. Standard deviations fall with the square root of the number, so more frames
mostly cost time.
"""
MAX_EXAMINED = 600
"""Maximum number of frames of a video in which the board is searched for."""
EXAMINED_HZ = 5.0
"""Frames per second of a video in which the board is searched for."""
SHARPNESS_KEPT = 0.7
"""Minimum sharpness of a frame relative to the 75th percentile of all frames."""
MIN_DIFFERENCE = 0.02
"""Minimum movement of the board's outline between two views, as a fraction of the picture's diagonal. With less
movement the views count as the same.
"""


Corners = tuple[Index, Array]
"""Corners of a board in a picture: rows (N,) of the board's `points_m`, and pixels (N, 2)."""


@dataclass(frozen=True)
class Board:
    """A chessboard, or a ChArUco board, which has markers in the light squares."""

    columns: int
    """Number of inner corners across, or of squares for a board with markers."""
    rows: int
    square_m: float
    """Side of a square in metres."""
    marker_m: float | None = None
    """Side of a marker; None for a chessboard."""
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
        """Return OpenCV's object for a board with markers."""
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

        A chessboard is detected as a whole or not at all. A ChArUco board gives the corners between the markers that
        were read, or None if these are too few.
        """
        if self.marker_m is None:
            size = (self.columns, self.rows)
            is_found, xy = cv2.findChessboardCornersSB(image, size, flags=cv2.CALIB_CB_NORMALIZE_IMAGE)
            if not is_found:
                return None
            xy = np.asarray(xy, dtype=float).reshape(-1, 2)
            if xy[0].sum() > xy[-1].sum():
                xy = xy[::-1]  # a half turn maps the board onto itself, so the order of the corners is arbitrary
            return np.arange(len(xy)), _refined_corners(image, xy, 0.28)
        xy, ids, _, _ = cv2.aruco.CharucoDetector(self.charuco).detectBoard(image)
        if ids is None or len(ids) < MIN_CORNERS:
            return None
        # Limit the window to the nearest marker, whose corner would attract the corner that is refined.
        reach = 0.45 * (1 - self.marker_m / self.square_m)
        xy = _refined_corners(image, np.asarray(xy, dtype=float).reshape(-1, 2), reach)
        return np.ravel(ids).astype(np.intp), xy


def parse_board(text: str) -> Board:
    """Return the board described by a text such as `CHESSBOARD_FORM` or `CHARUCO_FORM` (which `:legacy` may follow).

    Raises InputError for any other text.
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
                Problem("--board", "dictionary", f"{marker_count} markers in {dictionary}", f"{needed} or more")
            )
    raise_problems(problems)
    return board


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _refined_corners(image: Gray, xy_px: Array, reach: float) -> Array:
    """Return corners (N, 2) moved to the intersection of the edges, within `reach` of the distance to the next corner.

    This halves the detectors' errors. The window must contain neither the board's edge nor another corner. On real
    chessboards the errors are smallest at a reach of 0.3; from 0.4 on, outer corners drift. A corner that would move by
    more than the window is left where it was.
    """
    distance = np.linalg.norm(xy_px[:, None] - xy_px, axis=2) + np.diag(np.full(len(xy_px), np.inf))
    # The window is the same for all corners; on a tilted board, the distant corners determine its size.
    half = int(np.clip(round(reach * np.percentile(distance.min(axis=1), 20)), 2, 15))
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-4)
    start = xy_px.astype(np.float32).reshape(-1, 1, 2)
    moved_px = np.asarray(cv2.cornerSubPix(image, start, (half, half), (-1, -1), criteria), dtype=float).reshape(-1, 2)
    return np.where(np.linalg.norm(moved_px - xy_px, axis=1, keepdims=True) <= half, moved_px, xy_px)


# -- views -------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class BoardView:
    """A picture in which the board was detected."""

    name: str
    """Name of the file, or number of the frame."""
    ids: Index
    """(N,): rows of the board's `points_m`."""
    xy_px: Array
    """(N, 2): corners in pixels."""


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
    """Return the picture files of paths, including those in folders, or a single video.

    Raises InputError with every path that does not exist, every folder without pictures, and every video among other
    files.
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

    Raises InputError, with every problem at once, if files cannot be read, if pictures differ in size, or if no picture
    shows the board.
    """
    is_video, sizes = _is_video(files[0]), dict[str, tuple[int, int]]()
    problems, names_without, views_found = list[Problem](), list[str](), list[BoardView]()
    sharpness, outlines = list[float](), list[Array]()
    for name, share, image in _frames(files[0]) if is_video else _images(files):
        progress("looking for the board", share)
        if image is None:
            problems.append(Problem(name, "file", "OpenCV cannot read this picture", ", ".join(IMAGE_SUFFIXES)))
            continue
        sizes[name] = (image.shape[1], image.shape[0])
        if len(set(sizes.values())) > 1 or problems:
            continue  # the input is refused already; the loop only goes on to list all problems
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
    """Yield each picture's name, the fraction of pictures before it, and the picture, rotated upright by its EXIF tag.

    A picture that cannot be read is None.
    """
    unique = len({file.name for file in files}) == len(files)
    for done, file in enumerate(files):
        image = read_picture(file, cv2.IMREAD_GRAYSCALE)
        name = file.name if unique and image is not None else str(file)
        yield name, done / len(files), image


def _frames(path: Path) -> Iterator[tuple[str, float, Gray]]:
    """Yield some frames of a video in the form of `_images`."""
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
    expected = "pictures of one size and orientation, those of the clips: a calibration is valid for one resolution"
    return Problem("pictures", "size", found_sizes, expected)


def choose(sharpness: Array, outlines: Array, count: int = MAX_VIEWS) -> list[int]:
    """Return the indices of frames that are sharp and as different as possible, in order.

    The first choice is the sharpest frame. Every further choice is the sharp frame that is farthest from all chosen
    ones (root mean square over the outline), until `count` are chosen or the farthest is a repetition.

    Parameters
    ----------
    sharpness : (N,)
        Sharpness of each frame.
    outlines : (N, 4, 2)
        Outer corners of the board in each frame, as fractions of the picture's diagonal.
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
    """Return the sharpness of a board in a picture (height, width): about 1 / the width of an edge (px).

    The sharpness around a corner (N, 2) is the square root of the smaller eigenvalue of the gradients' mean outer
    product, relative to the contrast. Motion in one direction blurs the edges across it and so reduces the smaller
    eigenvalue only.
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
    """Return the board's outer corners (4, 2) in the picture, extrapolated without distortion."""
    points = board.points_m[ids, :2]
    homography, _ = cv2.findHomography(points, xy_px)
    if homography is None:  # all corners are on one line
        return np.tile(xy_px.mean(axis=0), (4, 1))
    return cv2.perspectiveTransform(board.outline_m[None, :, :2], np.asarray(homography, dtype=float))[0]


# -- the camera --------------------------------------------------------------------------------------------------------

DROP_FACTOR = 3.0
DROP_FLOOR_PX = 0.3
ROUNDS = 3
COVERAGE_COLUMNS = 320
MIN_VIEWS = 3
"""Minimum number of views. Each view of a plane gives two equations for the four numbers of the matrix, so two are
enough; this is one more.
"""
FISHEYE_STARTS_DEG = (60.0, 100.0, 140.0, 180.0)
_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-10)


@dataclass(frozen=True)
class _FittedBoardView(BoardView):
    """A fitted picture with N corners."""

    rotation: Array
    """(3, 3): X_camera = rotation X_board + translation_m."""
    translation_m: Array
    """(3,): translation of the board."""
    residual_px: Array
    """(N, 2): projected minus detected corners."""
    used: bool
    """Whether the picture was used; False for an outlier."""

    @cached_property
    def rms_px(self) -> float:
        """Return the root mean square error of the corners."""
        return math.sqrt((self.residual_px**2).sum(axis=1).mean())

    @cached_property
    def max_px(self) -> float:
        """Return the largest error of a corner."""
        return float(np.linalg.norm(self.residual_px, axis=1).max())

    @property
    def tilt_rad(self) -> float:
        """Return the angle between the board and the picture's plane."""
        return math.acos(min(1.0, abs(float(self.rotation[2, 2]))))


@dataclass(frozen=True)
class Calibration:
    """A camera and the views used to calibrate it."""

    camera: Camera
    board: Board
    views: tuple[_FittedBoardView, ...]
    sigma: tuple[float, ...]
    """Standard deviation of each parameter (see `parameters`), from the residuals and the geometry of the views,
    without errors of the lens model.
    """

    @cached_property
    def used(self) -> tuple[_FittedBoardView, ...]:
        """Return the views that were used."""
        return tuple(view for view in self.views if view.used)

    @cached_property
    def rms_px(self) -> float:
        """Return the root mean square distance of projected and detected corners over the used pictures."""
        residual = np.concatenate([view.residual_px for view in self.used])
        return math.sqrt((residual**2).sum(axis=1).mean())

    @property
    def parameters(self) -> dict[str, float]:
        """Return fx, fy, cx, cy (px) and the lens's coefficients by name."""
        matrix = self.camera.matrix
        values = (matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *self.camera.distortion)
        names = ("fx", "fy", "cx", "cy", *self.camera.lens.coefficients)
        return {name: float(value) for name, value in zip(names, values, strict=False)}


def calibrate(views: BoardViews, model: str, name: str = "cam1") -> Calibration:
    """Return the camera that fits the views best.

    Parameters
    ----------
    views : BoardViews
        Pictures of the board.
    model : str
        Name of the lens model.
    name : str
        Name of the camera.

    Returns
    -------
    Calibration
        The camera, its uncertainty, and the views that were used.

    Raises
    ------
    InputError
        If there are too few views, or if they do not determine a camera.
    """
    if len(views.views) < MIN_VIEWS:
        found_views = f"the board in {len(views.views)} of {views.examined} pictures"
        raise InputError(Problem("pictures", "views", found_views, f"{MIN_VIEWS} or more; 12 to 40 are good"))
    left_out = dict[str, _FittedBoardView]()
    camera, fitted = _solve(views, model, name)
    for _ in range(ROUNDS):
        errors = np.array([view.rms_px for view in fitted])
        is_good = errors <= max(DROP_FACTOR * float(np.median(errors)), DROP_FLOOR_PX)
        if is_good.all() or is_good.sum() < MIN_VIEWS:
            break
        outliers = [view for view, keep in zip(fitted, is_good, strict=True) if not keep]
        left_out |= {view.name: replace(view, used=False) for view in outliers}
        used = tuple(view for view in fitted if view.name not in left_out)
        camera, fitted = _solve(replace(views, views=used), model, name)
    all_views = left_out | {view.name: view for view in fitted}
    sigma = _sigma(fitted, views.board.points_m, camera)
    return Calibration(camera, views.board, tuple(all_views[view.name] for view in views.views), tuple(sigma.tolist()))


_Solution = tuple[MatLike, MatLike, Sequence[MatLike], Sequence[MatLike]]
"""Camera matrix, distortion, and rotation vectors and translations of the views."""


def _solve(views: BoardViews, model: str, name: str) -> tuple[Camera, list[_FittedBoardView]]:
    points, size, lens = views.board.points_m, views.image_size_px, LENS_MODELS[model]
    try:
        solve = _solve_fisheye if lens.opencv == "fisheye" else _solve_standard
        matrix, distortion, rotations, translations = solve(views.views, points, size, lens.calibrated)
        camera = Camera(name, np.asarray(matrix, dtype=float), np.asarray(distortion, dtype=float), model, size)
    except (cv2.error, ValueError) as error:
        expected = "views with different tilts, over the whole picture"
        raise InputError(Problem("pictures", f"{model} model", "no solution", expected)) from error
    fitted = []
    for view, rotation_vector, translation_vector in zip(views.views, rotations, translations, strict=True):
        rotation = np.asarray(cv2.Rodrigues(rotation_vector)[0], dtype=float)
        translation = np.asarray(translation_vector, dtype=float).ravel()
        projected, valid = camera.project(points[view.ids] @ rotation.T + translation)
        # If the lens model folds, there is no projection, and the error is set to a very large finite value.
        residual = np.where(valid[:, None], projected - view.xy_px, math.hypot(*size))
        fitted.append(_FittedBoardView(view.name, view.ids, view.xy_px, rotation, translation, residual, used=True))
    return camera, fitted


def _solve_standard(views: Sequence[BoardView], points: Array, size: tuple[int, int], coefficients: int) -> _Solution:
    """Solve for OpenCV's first five coefficients, or for none."""
    fixed = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    objects = [points[view.ids].astype(np.float32) for view in views]
    images = [view.xy_px.astype(np.float32).reshape(-1, 1, 2) for view in views]
    _, matrix, distortion, rotations, translations = cv2.calibrateCamera(
        objects, images, size, np.eye(3), np.zeros(5), flags=0 if coefficients else fixed, criteria=_CRITERIA
    )
    return matrix, np.ravel(distortion)[:coefficients], rotations, translations


def _solve_fisheye(views: Sequence[BoardView], points: Array, size: tuple[int, int], coefficients: int) -> _Solution:
    """Solve from several fields of view, because OpenCV's result stays near its initial value."""
    objects = [points[view.ids].reshape(1, -1, 3) for view in views]
    images = [view.xy_px.reshape(1, -1, 2) for view in views]
    names = ("CALIB_USE_INTRINSIC_GUESS", "CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW")
    # OpenCV 4 has separate flags for fisheye lenses; OpenCV 5 has the same flags for all lenses.
    flags = sum(getattr(cv2.fisheye if hasattr(cv2.fisheye, "CALIB_FIX_SKEW") else cv2, name) for name in names)
    solutions: list[Any] = []
    for field_deg in FISHEYE_STARTS_DEG:
        focal = size[0] / math.radians(field_deg)
        guess = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
        inputs = (objects, images, size, guess, np.zeros(coefficients))
        with suppress(cv2.error):  # some starts lead to no solution
            solutions.append(cv2.fisheye.calibrate(*inputs, flags=flags, criteria=_CRITERIA))
    finite_solutions = [solution for solution in solutions if math.isfinite(solution[0])]
    if not finite_solutions:
        raise ValueError("no finite solution")
    _, matrix, distortion, rotations, translations = min(finite_solutions, key=lambda solution: solution[0])
    return matrix, np.ravel(distortion), rotations, translations


def _sigma(views: Sequence[_FittedBoardView], points: Array, camera: Camera) -> Array:
    """Return the standard deviations of the camera's parameters, infinite if the pictures do not determine them.

    The unknowns are the parameters and the poses. The variance of the residuals is their sum of squares divided by the
    degrees of freedom.
    """
    by_camera, by_pose = zip(*(_jacobian(view, points, camera) for view in views), strict=True)
    jacobian = np.hstack([np.vstack(by_camera), block_diag(*by_pose)])
    residual, n = np.concatenate([view.residual_px for view in views]), 4 + camera.distortion.size
    # coefficients and pixels differ by many orders of magnitude
    scale = np.maximum(np.linalg.norm(jacobian, axis=0), 1e-150)
    try:
        inverse = np.linalg.inv((jacobian / scale).T @ (jacobian / scale))
    except np.linalg.LinAlgError:
        return np.full(n, np.inf)
    diagonal, variance = np.diag(inverse)[:n], np.sum(residual**2) / max(1, residual.size - len(scale))
    return np.where(diagonal > 0, np.sqrt(variance * np.abs(diagonal)) / scale[:n], np.inf)


def _jacobian(view: _FittedBoardView, points: Array, camera: Camera) -> tuple[Array, Array]:
    """Return the derivatives of a view's pixels by the camera (2N, 4 + coefficients) and by the pose (2N, 6)."""
    rotation = np.asarray(cv2.Rodrigues(view.rotation)[0], dtype=float)
    objects = points[view.ids].reshape(-1, 1, 3)
    pose, n = (rotation, view.translation_m), camera.distortion.size
    if camera.lens.opencv == "fisheye":
        _, jacobian = cv2.fisheye.projectPoints(objects, *pose, camera.matrix, camera.distortion)
        jacobian = np.asarray(jacobian, dtype=float)
        return jacobian[:, : 4 + n], jacobian[:, 8:14]
    five = np.pad(camera.distortion, (0, 5 - n))
    jacobian = np.asarray(cv2.projectPoints(objects, *pose, camera.matrix, five)[1], dtype=float)
    return jacobian[:, 6 : 10 + n], jacobian[:, :6]


# -- checks ------------------------------------------------------------------------------------------------------------

Verdict = Literal["ok", "warning", "refused"]


@dataclass(frozen=True)
class _CalibrationCheck:
    """A measured value and its limits."""

    name: str
    quantity: str
    unit: str
    warn: float
    """Limit beyond which there is a warning: a minimum if `at_least`, otherwise a maximum."""
    refuse: float
    """Limit beyond which the calibration is refused: a minimum if `at_least`, otherwise a maximum."""
    at_least: bool
    advice: str
    value: float

    @property
    def verdict(self) -> Verdict:
        """Return the verdict on the value."""
        if self._beyond(self.refuse):
            return "refused"
        return "warning" if self._beyond(self.warn) else "ok"

    def _beyond(self, bound: float) -> bool:
        """Return whether the value is beyond a bound: never for a NaN bound, always for a NaN value."""
        return not math.isnan(bound) and not (self.value >= bound if self.at_least else self.value <= bound)

    def __str__(self) -> str:
        """Return the measured value and, if it exceeds a limit, the limit, by how much, and advice."""
        bound = self.refuse if self.verdict == "refused" else self.warn
        unit = f" {self.unit}" if self.unit else ""
        if self.verdict == "ok":
            return f"{self.name}: {self.quantity} {self.value:.3g}{unit}"
        side = "at least" if self.at_least else "at most"
        return (
            f"{self.name}: {self.quantity} {self.value:.3g}{unit}, {side} {bound:g} needed "
            f"({abs(self.value - bound):.2g} {'short' if self.at_least else 'over'}): {self.advice}"
        )


LIMITS = (
    # three pictures determine the matrix, and two more the lens; with six, an error in one of them still shows
    ("images", "pictures used", "", 10, 6, True, "take more pictures"),
    # if one in four is an outlier, the median itself is uncertain
    ("dropped", "pictures left out as outliers", "%", 10, 25, False, "look for a board that bends or moves"),
    # corners are detected to 0.05-0.3 px; larger errors mean a wrong lens model or board; pictures wider than 1920 px
    # are scaled to that width
    ("rms", "reprojection error", "px of 1920", 0.5, 1.0, False,
     "check --board, --model, and that the board is flat"),
    # the lens is measured inside this area, and extrapolated by polynomials outside
    ("coverage", "share of the picture where the board was", "%", 60, 30, True,
     "move the board over the whole picture"),
    # the distortion is largest at the borders
    ("border", "widest strip along a border without a corner", "% of the side", 12, math.nan, False,
     "hold the board at the borders, partly outside if it is a ChArUco board"),
    # parallel boards add no information: a longer focal length and a longer distance look the same
    ("tilt", "largest angle between two boards", "degrees", 40, 20, True, "tilt the board by 30 to 45 degrees"),
    # if boards are tilted about one axis only, perspective determines only one of fx and fy
    ("tilt axes", "spread of the tilt in its least varied direction", "degrees", 6, 2, True,
     "tilt the board sideways as well as forwards"),
    # errors of the lens model are not included: expect three times as much
    ("focal length", "standard deviation of fx or fy", "%", 0.3, 1.0, False, "take more pictures, closer and tilted"),
    ("principal point", "standard deviation of cx or cy", "% of the width", 0.3, 1.0, False,
     "take more pictures, tilted and at the borders"),
    # the pixels of modern sensors are square to 0.1 %
    ("aspect", "difference between fx and fy", "%", 0.5, 5.0, False, "check that the video is not stretched"),
    # lenses are centred to about 2 %
    ("centre", "distance of the principal point from the middle", "% of the width", 5, 15, False,
     "check that the picture is not cropped"),
    # the fitted polynomial turns back there; a circular fisheye picture always has such corners
    ("folded", "part of the picture without a ray in the lens model", "%", 0.0, 5.0, False,
     "cover the borders, or use another --model"),
)  # fmt: skip
"""All fields of `_CalibrationCheck` except its value."""


def check(calibration: Calibration) -> tuple[_CalibrationCheck, ...]:
    """Return the checks of `LIMITS` for a calibration."""
    measured = _pictures_measured(calibration) | _lens_measured(calibration)
    return tuple(_CalibrationCheck(*limit, value=float(measured[limit[0]])) for limit in LIMITS)


def _pictures_measured(calibration: Calibration) -> dict[str, float]:
    """Return the values of `LIMITS` that describe the pictures: their number, errors, and where the board was."""
    used, (width, height) = calibration.used, calibration.camera.image_size_px
    corners = np.concatenate([view.xy_px for view in used])
    gaps = [*(corners.min(axis=0) / (width, height)), *(1 - (corners.max(axis=0) + 1) / (width, height))]
    # normals of the boards, all towards the camera; their first two coordinates are sines of the tilt
    normals = np.array([view.rotation[:, 2] * np.sign(view.rotation[2, 2] or 1.0) for view in used])
    angles = np.arccos(np.clip(normals @ normals.T, -1, 1))
    least_variance = np.linalg.eigvalsh(np.cov(normals[:, :2].T, bias=True))[0]
    return {
        "images": len(used),
        "dropped": 100 * (1 - len(used) / len(calibration.views)),
        "rms": calibration.rms_px / max(1.0, max(width, height) / 1920),
        "coverage": 100 * coverage(calibration).mean(),
        "border": 100 * max(0.0, *gaps),
        "tilt": math.degrees(angles.max()),
        "tilt axes": math.degrees(math.sqrt(max(0.0, least_variance))),
    }


def _lens_measured(calibration: Calibration) -> dict[str, float]:
    """Return the values of `LIMITS` that describe the lens: its parameters, and where it has no rays."""
    values, sigma = calibration.parameters, calibration.sigma
    width, height = calibration.camera.image_size_px
    y, x = np.mgrid[0 : height - 1 : 41j, 0 : width - 1 : 41j]
    has_ray = calibration.camera.rays(np.stack((x, y), axis=-1))[1]
    return {
        "focal length": 100 * max(sigma[0] / values["fx"], sigma[1] / values["fy"]),
        "principal point": 100 * max(sigma[2:4]) / width,
        "aspect": 100 * abs(values["fx"] / values["fy"] - 1),
        "centre": 100 * math.hypot(values["cx"] - (width - 1) / 2, values["cy"] - (height - 1) / 2) / width,
        "folded": 100 * (1 - has_ray.mean()),
    }


def coverage(calibration: Calibration) -> Bools:
    """Return which cells of the picture (rows, columns) are among the corners of some used picture."""
    width, height = calibration.camera.image_size_px
    scale = COVERAGE_COLUMNS / width
    mask = np.zeros((max(1, round(height * scale)), COVERAGE_COLUMNS), dtype=np.uint8)
    for view in calibration.used:
        hull = cv2.convexHull(((view.xy_px + 0.5) * scale - 0.5).astype(np.float32))
        cv2.fillConvexPoly(mask, np.rint(hull).astype(np.int32), 1)
    return mask.astype(bool)
