"""What the trajectory method gives back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from recon.body import Body

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Start:
    """One heading that the clip was started from: heading_rad about the level frame's z axis, cost of its first, wide
    fit, and whether it was carried to the end."""

    heading_rad: float
    cost: float
    kept: bool


@dataclass(frozen=True)
class Ground:
    """A plane in the level frame: z = height_m + slope (2,) . (x, y), and the standard deviation of its height under
    the animal."""

    height_m: float
    slope: Array
    sigma_m: float

    def scaled(self, size: float) -> Ground:
        """The same under a scene that is scaled about the origin."""
        return replace(self, height_m=size * self.height_m, sigma_m=size * self.sigma_m)


@dataclass(frozen=True)
class Spell:
    """A stretch of the clip that was solved by itself, as nothing was seen for long before and after: its rows of the
    clip, and the ground under its feet, None where none stood. Spells lie in the order of their rows, and apart."""

    rows: slice
    ground: Ground | None


@dataclass(frozen=True, eq=False)
class TrajectorySolution:
    """A body's motion over T frames, J markers, D unknowns a frame, F feet.

    states (T, D), in the level frame: origin in the camera's centre, x to the picture's right, y away, z up.
    camera_from_level (3, 3). size, size_sigma: the factor on the body's lengths and its posterior standard deviation.
    joints_camera_m (T, J, 3). covariance_m2 (T, J, 3, 3): of the joints in the camera frame, place and size included;
    relative_covariance_m2: of the joints relative to the mean of all joints. data_share (J,): the part of the posterior
    precision that comes from the pixels, 0 to 1. noise_px (T, J): the standard deviation that a detection was given;
    weight (T, J): how far it was trusted, 1 to 0, NaN where missing. flags (T,): what is doubtful about a frame:
    "no data", "ran away", "data poor", "ambiguous depth", "second solution". alternative_m (T,): mean distance
    of the joints in the second best solution, NaN where there is none; alternative_cost: by how much its cost is
    higher (half squared sigmas). contact (T, F): 0 to 1. spells: the stretches of the clip
    that have a pose, each with its own ground. cost_by_term: half the squared norm, robust. stage_s: seconds by stage.
    """

    body: Body
    states: Array
    camera_from_level: Array
    size: float
    size_sigma: float
    joints_camera_m: Array
    covariance_m2: Array
    relative_covariance_m2: Array
    data_share: Array
    noise_px: Array
    weight: Array
    flags: tuple[tuple[str, ...], ...]
    alternative_m: Array
    alternative_cost: float
    contact: Array
    spells: tuple[Spell, ...]
    prior: str
    status: Literal["converged", "not_converged"]
    cost_by_term: dict[str, float]
    iterations: int
    starts: tuple[Start, ...]
    stage_s: dict[str, float]
