"""Find how a camera that turns about a fixed point was turned in each frame of its video, from the background."""

from __future__ import annotations

from recon.calibrate.camera_motion.rotation import LevelMark, Orientation, as_level, read_marks, tilted, up_by_marks
from recon.calibrate.camera_motion.track import Tracker, TurningMotion
