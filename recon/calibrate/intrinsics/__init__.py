"""A camera's matrix and lens from views of a flat board."""

from __future__ import annotations

from recon.calibrate.intrinsics.board import Board, parse_board
from recon.calibrate.intrinsics.checks import LIMITS, check, coverage
from recon.calibrate.intrinsics.picture import draw
from recon.calibrate.intrinsics.solve import Calibration, calibrate
from recon.calibrate.intrinsics.views import BoardView, BoardViews, collect, find_views
