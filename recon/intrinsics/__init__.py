"""A camera's matrix and lens from views of a flat board."""

from __future__ import annotations

from recon.intrinsics.board import Board, Charuco, Chessboard, Corners, parse_board
from recon.intrinsics.checks import LIMITS, Check, check, coverage
from recon.intrinsics.picture import draw
from recon.intrinsics.solve import Calibration, FittedBoardView, calibrate
from recon.intrinsics.views import BoardView, BoardViews, collect, find_views

__all__ = [
    "LIMITS",
    "Board",
    "BoardView",
    "BoardViews",
    "Calibration",
    "Charuco",
    "Check",
    "Chessboard",
    "Corners",
    "FittedBoardView",
    "calibrate",
    "check",
    "collect",
    "coverage",
    "draw",
    "find_views",
    "parse_board",
]
