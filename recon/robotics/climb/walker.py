"""The four-legged machine as the climb sees it: hips about the centre of mass, and legs with limits.

Body axes are those of the legs: x to the right, y forward, z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.robotics.climb.equilibrium import Torso
from recon.robotics.climb.fields import leg_vectors
from recon.robotics.robot.leg import Leg, SwingLeg
from recon.robotics.robot.quadruped import ClosedLeg, Quadruped

LEGS = ("left front", "left rear", "right front", "right rear")
"""Numbered from 1 in this order, as the published footfalls are."""
LABELS = ("LF", "LH", "RF", "RH")
"""Their names in a robot's description."""
AROUND = (0, 1, 3, 2)
"""The legs counterclockwise, seen from above."""
SHIN_POINTS = (0.25, 0.5, 0.75)
"""Of the way from foot to knee, where a shin must not touch the ground or the step."""


@dataclass(frozen=True, eq=False)
class Walker:
    """A robot as a climb sees it."""

    name: str
    hips_m: Array
    """(4, 3): in body axes, from the centre of mass."""
    legs: tuple[Leg, ...]
    """Four, in the order of `LEGS`."""
    max_rate_rad_s: Array
    """(4, 3): of swing, flap and knee."""

    @classmethod
    def of(cls, robot: Quadruped) -> Walker:
        """Its centre of mass is taken to be the origin of its body. Raises InputError for legs of another kind than
        swing, flap, knee in closed form."""
        legs = [robot.legs[label] for label in LABELS]
        kinds = (isinstance(leg, ClosedLeg) and isinstance(leg.leg.geometry, SwingLeg) for leg in legs)
        if not all(kinds):
            expected = "a robot whose legs are given by dimensions, their swing joint first (aibo is one)"
            raise InputError(Problem(robot.name, "legs", "other legs", expected))
        closed = [leg for leg in legs if isinstance(leg, ClosedLeg)]
        hips = np.array([[-leg.hip_m[1], leg.hip_m[0], leg.hip_m[2]] for leg in closed])
        return cls(robot.name, hips, tuple(leg.leg for leg in closed), np.array([leg.max_rate_rad_s for leg in closed]))

    @property
    def side(self) -> Array:
        """(4,): 1 on the right, -1 on the left."""
        return np.array([leg.mirror[0] for leg in self.legs])

    def posture(self, torso: Torso, feet_m: Array) -> Posture:
        """Of the legs, feet (..., 4, 3) in the world. Everything is finite: a foot out of reach has the angles of the
        reach's end."""
        r = leg_vectors(torso.position_m, torso.rotation, self.hips_m, feet_m)
        angles, slack, knees = np.empty_like(r), np.empty(r.shape[:-1]), np.empty_like(r)
        for k, leg in enumerate(self.legs):
            assert isinstance(leg.geometry, SwingLeg)
            angles[..., k, :], slack[..., k], knees[..., k, :] = _bent_leg(leg.geometry, r[..., k, :] * leg.mirror)
            knees[..., k, :] *= leg.mirror
        limits = np.stack([leg.margins(angles[..., k, :]) for k, leg in enumerate(self.legs)], axis=-2)
        back = np.swapaxes(torso.rotation, -1, -2)
        hips = torso.position_m[..., None, :] + self.hips_m @ back
        return Posture(angles, limits, slack, hips, hips + knees @ back)


def _bent_leg(leg: SwingLeg, foot_m: Array) -> tuple[Array, Array, Array]:
    """Angles (..., 3), slack (...) and knee (..., 3) of a leg in its own axes."""
    x, y, z = np.moveaxis(foot_m, -1, 0)
    distance, (least, most) = np.linalg.norm(foot_m, axis=-1), leg.distances_m
    inside = np.clip(distance, least * (1 + 1e-9), most * (1 - 1e-9))
    angles = leg.inverse(foot_m * (inside / distance)[..., None]).angles_rad
    middle, half = (most**2 + least**2) / 2, (most**2 - least**2) / 2
    knee = leg.stretched_rad + np.arccos(np.clip((inside**2 - middle) / half, -1, 1))
    # A bent leg does not come nearer to the axis of its swing joint than P.
    aside = np.hypot(y, z) - np.abs(leg.in_plane(knee)[0])
    lying = np.stack([np.arctan2(z, y), np.copysign(np.pi / 2, x), knee], axis=-1)
    angles = np.where(np.isnan(angles), lying, angles)
    a, b = angles[..., 0], angles[..., 1]
    ahead, below = leg.knee_offset_m, leg.thigh_m * np.cos(b)
    knees = np.stack(
        [
            leg.thigh_m * np.sin(b),
            below * np.sin(a) + ahead * np.cos(a),
            ahead * np.sin(a) - below * np.cos(a),
        ],
        axis=-1,
    )
    return angles, np.minimum(np.minimum(distance - least, most - distance), aside), knees


@dataclass(frozen=True, eq=False)
class Posture:
    """Legs on given feet under a given torso."""

    angles_rad: Array
    """(..., 4, 3): swing, flap, knee."""
    limits_rad: Array
    """(..., 4, 3): how far within the limits."""
    slack_m: Array
    """(..., 4): how far each foot is within its leg's reach, negative outside."""
    hips_m: Array
    """(..., 4, 3): in the world."""
    knees_m: Array
    """(..., 4, 3): in the world."""
