"""Which way is up, as said or supposed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recon.camera_motion.rotation import Turn
from recon.frames import level_from_camera


def as_level(turns: Sequence[Turn], tilt_rad: float | None) -> tuple[Turn, ...]:
    """The turns from a world with z up, y away from the camera.

    tilt_rad: how far the first frame looks down, its picture level to the sides. None: the mean frame looks level.
    """
    reference, tilt = turns[0].rotation, tilt_rad
    if tilt is None:
        from scipy.spatial.transform import Rotation  # slow to import

        reference, tilt = Rotation.from_matrix([turn.rotation for turn in turns]).mean().as_matrix(), 0.0
    level = level_from_camera(np.array([0.0, -math.cos(tilt), -math.sin(tilt)])) @ reference  # of the old world
    return tuple(replace(turn, rotation=turn.rotation @ level.T) for turn in turns)
