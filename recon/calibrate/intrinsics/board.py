"""Calibration boards: what they look like, and where their corners are in a picture.

A board's frame lies in its surface: x to the right, y down, z away from the viewer, metres; a board that is seen
squarely is parallel to the camera frame. Corners are where four squares meet.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

from recon.base.arrays import Array, Index
from recon.base.errors import InputError, Problem, refuse

Gray = npt.NDArray[np.uint8]
UNITS_M = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
MIN_CORNERS = 8
"""A pose has six unknowns and needs four corners; twice that leaves residuals which can show that it is wrong."""

CHESSBOARD_FORM = "chessboard:9x6:25mm (inner corners, one fewer than squares each way; side of a square)"
CHARUCO_FORM = "charuco:5x7:40mm:30mm:DICT_4X4_50 (squares; side of a square; side of a marker; dictionary)"


Corners = tuple[Index, Array]
"""Corners of a board in one picture: rows (N,) of the board's `points_m`, and pixels (N, 2)."""


@dataclass(frozen=True)
class Board:
    """A board of squares, or a ChArUco board, which has markers in the light ones."""

    columns: int
    """The number of inner corners across; of squares, where there are markers."""
    rows: int
    square_m: float
    """Side of a square."""
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
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, self.dictionary))
        board = cv2.aruco.CharucoBoard((self.columns, self.rows), self.square_m, self.marker_m, dictionary)
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

    Raises InputError, naming every fault.
    """
    kind, *parts = text.strip().split(":")
    problems: list[Problem] = []

    def fault(field: str, found: str, expected: str) -> None:
        problems.append(Problem("--board", field, found, expected))

    counts = {"chessboard": (2,), "charuco": (4, 5)}
    if len(parts) not in counts.get(kind, ()):
        fault("board", repr(text), f"{CHESSBOARD_FORM}, or {CHARUCO_FORM}")
        raise InputError(problems)
    match = re.fullmatch(r"(\d+)x(\d+)", parts[0])
    columns, rows = (int(n) for n in match.groups()) if match else (0, 0)
    if min(columns, rows) < 3:
        what = "inner corners" if kind == "chessboard" else "squares"
        fault(what, repr(parts[0]), "columns x rows, three or more of each, as in 9x6")
    square = _length(parts[1], "side of a square", fault)
    if kind == "chessboard":
        refuse(problems)
        return Board(columns, rows, square)
    marker = _length(parts[2], "side of a marker", fault)
    if 0 < square <= marker:
        fault("side of a marker", parts[2], f"less than the side of a square, {parts[1]}")
    dictionary = parts[3].upper()
    known = sorted(name for name in dir(cv2.aruco) if name.startswith("DICT_") and name == name.upper())
    if dictionary not in known:
        fault("dictionary", repr(parts[3]), f"one of {', '.join(known)}")
    else:
        held = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).bytesList)
        if columns * rows // 2 > held:
            fault("dictionary", f"{held} markers in {dictionary}", f"{columns * rows // 2} for {parts[0]} squares")
    if len(parts) == 5 and parts[4] != "legacy":
        fault("layout", repr(parts[4]), "legacy (printed with OpenCV before 4.6), or nothing")
    refuse(problems)
    return Board(columns, rows, square, marker, dictionary, legacy=len(parts) == 5)


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


def _length(text: str, field: str, fault) -> float:
    """Metres; 0 after a fault."""
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*(mm|cm|m)", text.strip())
    length = float(match[1]) * UNITS_M[match[2]] if match else 0.0
    if not length > 0:
        fault(field, repr(text), "a length with its unit, as in 25mm, 2.5cm or 0.025m")
    return length
