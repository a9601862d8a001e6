"""How a camera that turns about a fixed point was turned in each frame of its video, from the background."""

from __future__ import annotations

from recon.camera_motion.level import as_level
from recon.camera_motion.rotation import Turn
from recon.camera_motion.track import Tracker, TurningMotion

__all__ = ["Tracker", "Turn", "TurningMotion", "as_level"]
