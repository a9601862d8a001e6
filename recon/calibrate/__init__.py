"""Find cameras from pictures of a board or from a video, and plan where to put them."""

from typing import TYPE_CHECKING

from recon.base import lazily

if TYPE_CHECKING:
    from recon.calibrate.boards import parse_board
    from recon.calibrate.camera_motion import read_marks

__getattr__ = lazily(__name__, __file__)
