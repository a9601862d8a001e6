"""How a camera that turns about a fixed point was turned in each frame of its video, from the background."""

from __future__ import annotations

from recon.calibrate.camera_motion.rotation import Orientation, as_level, tilted
from recon.calibrate.camera_motion.track import Tracker, TurningMotion
