"""What the trajectory method gives back."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from recon.body import Body
from recon.clip import View

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Start:
    """One heading that the clip was started from: heading_rad about the world's z axis from the right of the first
    camera's picture, cost of its first, wide
    fit, and whether it was carried to the end."""

    heading_rad: float
    cost: float
    kept: bool


@dataclass(frozen=True)
class Ground:
    """A plane: z = height_m + slope (2,) . (x, y), and the standard deviation of its height under
    the animal."""

    height_m: float
    slope: Array
    sigma_m: float

    def about(self, origin_m: Array, size: float) -> Ground:
        """The same where the scene is scaled and its origin lies at (3,)."""
        height = origin_m[2] + size * self.height_m - self.slope @ origin_m[:2]
        return replace(self, height_m=float(height), sigma_m=size * self.sigma_m)


@dataclass(frozen=True)
class Spell:
    """A stretch of the clip that was solved by itself, as nothing was seen for long before and after: its rows of the
    clip, and the ground under its feet, None where none stood. Spells lie in the order of their rows, and apart."""

    rows: slice
    ground: Ground | None


@dataclass(frozen=True, eq=False)
class TrajectorySolution:
    """A body's motion over T frames, with J markers, D unknowns a frame and F feet, in the world frame (`recon.frames`)
    and metres. NaN in frames without a pose."""

    body: Body
    views: tuple[View, ...]
    """What it was fitted to."""
    states: Array
    """(T, D): the root's place is in the world; the body's lengths are those of `body` times `size`."""
    size: float
    size_sigma: float
    """Of the size: its posterior standard deviation."""
    size_from: tuple[str, ...]
    """What says the size: "prior", and where they do "views" and "ground"."""
    joints_m: Array
    """(T, J, 3)"""
    covariance_m2: Array
    """(T, J, 3, 3): of the joints, place and size included."""
    relative_covariance_m2: Array
    """(T, J, 3, 3): of the joints relative to the mean of all joints."""
    data_share: Array
    """(J,): the part of the posterior precision that comes from the pixels, 0 to 1."""
    noise_px: Array
    """(V, T, J): for each view, the standard deviation that a detection was given."""
    weight: Array
    """(V, T, J): how far it was trusted, 1 to 0, NaN where missing."""
    flags: tuple[tuple[str, ...], ...]
    """(T,): what is doubtful about a frame: "no data", "ran away", "data poor", "ambiguous depth" or "second
    solution"."""
    alternative_m: Array
    """(T,): mean distance of the joints in the second best solution, NaN where there is none."""
    alternative_cost: float
    """By how much its cost is higher (half squared sigmas)."""
    contact: Array
    """(T, F): 0 to 1."""
    spells: tuple[Spell, ...]
    """The stretches of the clip that have a pose, each with its own ground."""
    prior: str
    status: Literal["converged", "not_converged"]
    cost_by_term: dict[str, float]
    """Half the squared norm, robust."""
    iterations: int
    starts: tuple[Start, ...]
    stage_s: dict[str, float]
    """Seconds by stage."""

    @cached_property
    def joints_camera_m(self) -> Array:
        """(T, J, 3) in the first camera's frame."""
        return self.views[0].to_camera(self.joints_m)

    @cached_property
    def markers_m(self) -> Array:
        """(T, J, 3): where the detector sees the joints."""
        return self.joints_m + (
            self.body.detected.pose(self.states, self.size).points_m
            - self.body.tree.pose(self.states, self.size).points_m
        )
