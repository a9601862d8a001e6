"""Represent the points of an audited file, and derive the parts of the animal from the points' names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from recon.animal.body import Body, opposites, side_of
from recon.animal.naming import marker_names
from recon.animal.skeleton_file import load_skeleton
from recon.base.arrays import Array, Bools, Brief, Index, Integers

NAMES_KNOWN = 0.6
"""Minimum fraction of the names in a file that must match a built-in skeleton for the skeleton to be used.

If the skeleton has fewer markers than the file has points, the fraction of the skeleton's markers is used instead.
"""
MIN_NAMES = 4
"""Minimum number of matching names for a built-in skeleton to be used, because two or three match several animals."""
_FOOT = re.compile(r"(?i)paw|hoof|toe|foot(?!base)|feet|hand(?!le)|claw|ankle|wrist")
_STANDING = re.compile(rf"{_FOOT.pattern}|fetlock|pastern|digit|heel|hock|tarsus|carpus|knee")
_LOWEST = re.compile(r"(?i)paw|hoof|toe|foot|feet|hand|claw")
_TRUNK = re.compile(
    r"(?i)spine|back(?!.*(leg|paw|knee|hoof|foot|ankle))|withers|trunk|tail.?base|root.?of.?tail|hips|neck|croup|thorax|chest"
)
_WORD = re.compile(r"[A-Za-z]{3}")
DECIMALS = 6
"""Largest number of decimals at which the numbers in a file count as rounded."""


@dataclass(frozen=True)
class Roles:
    """Parts of the animal, as indices of the K points."""

    skeleton: str | None = None
    """Name of the built-in skeleton that has the points' names; None if there is none."""
    feet: tuple[int, ...] = ()
    upper: tuple[int, ...] = ()
    """Points of the trunk, which are above the feet when the animal stands."""
    trunk: tuple[int, int] | None = None
    """Points at the rear and the front end of the trunk; None if unknown."""
    joints: Mapping[str, tuple[int, int, int]] = field(default_factory=dict)
    """Points above, at and below each joint in the table `[anatomy]` of the skeleton file."""
    limbs: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    bones_m: Mapping[tuple[int, int], float] = field(default_factory=dict)
    """Distance (m) between each pair of successive points of a limb in the skeleton's expected pose."""


@dataclass(frozen=True, eq=False, repr=False)
class AuditedPoints(Brief):
    """K points of one animal in T frames, in pixels or metres (z up)."""

    names: tuple[str, ...]
    positions: Array
    """Positions in pixels, shape (T, K, 2), or in metres, shape (T, K, 3); NaN where missing."""
    frames: Integers
    fps: float | None = None
    resolution: float = 0.0
    """Rounding step of the numbers in the file, in the unit of `positions`; 0 if the numbers are not rounded."""
    roles: Roles = field(default_factory=Roles)

    @property
    def in_space(self) -> bool:
        """Return whether the points are positions in 3D rather than pixels."""
        return self.positions.shape[2] == 3

    @cached_property
    def known(self) -> Bools:
        """Return a mask of the frames in which each point is known, shape (T, K)."""
        return np.asarray(np.isfinite(self.positions).all(axis=2))

    @cached_property
    def extent(self) -> float:
        """Return the size of the animal, the largest side of the box around its points, as a median over the frames.

        The size is in the unit of `positions`, and NaN without points.
        """
        counts = self.known.sum(axis=1)
        rows = counts >= max(3, 0.5 * counts.max(initial=0))
        if not rows.any():
            return np.nan
        sides = np.nanmax(self.positions[rows], axis=1) - np.nanmin(self.positions[rows], axis=1)
        return float(np.median(sides.max(axis=1)))

    @cached_property
    def follows(self) -> Bools:
        """Return a mask (T,) of the frames that follow the previous one without a gap in the frame numbers.

        The mask is false for the first frame.
        """
        steps = np.diff(self.frames)
        usual = np.median(steps) if len(steps) else 1
        return np.append(False, steps == usual)

    @cached_property
    def stands(self) -> Bools:
        """Return a mask (K,) of the points that can stand still while the animal walks.

        These are the points of the lower limbs, and points whose names belong to no known part of the animal.
        """
        return np.array([bool(_STANDING.search(name)) or not _WORD.search(name) for name in self.names])

    @cached_property
    def pairs(self) -> tuple[Index, Index]:
        """Return the indices of the left points that have a right counterpart, and of their counterparts."""
        partners = opposites(self.names)
        left = [k for k, name in enumerate(self.names) if partners[k] != k and side_of(name) == "left"]
        return np.array(left, dtype=np.intp), partners[left]

    def named(self, indices: Sequence[int] | Index) -> tuple[str, ...]:
        """Return the names of the points with the given indices."""
        return tuple(self.names[int(i)] for i in indices)


@dataclass(frozen=True)
class Measure:
    """Result of one check on the points of a file."""

    code: str
    value: float
    """Value that is compared with the check's limit (`recon.check.audit.LIMITS`). Larger values are more suspicious."""
    rows: tuple[int, int] | None = None
    """Index of the first frame that the result is about, and of the frame after the last; None means all frames."""
    numbers: Mapping[str, Any] = field(default_factory=dict)
    """Numbers and names that the finding's message states."""


def resolution_of(values: Array) -> float:
    """Return the rounding step of the numbers in a file, in their unit; 0 if they are not rounded."""
    sample = values[np.isfinite(values)]
    sample = sample[:: max(1, len(sample) // 4000)]
    for decimals in range(DECIMALS + 1):
        scaled = sample * 10.0**decimals
        if np.abs(scaled - np.round(scaled)).max(initial=0.0) < 1e-9 * max(1.0, np.abs(scaled).max(initial=0.0)):
            return 10.0**-decimals
    return 0.0


def roles_of(names: Sequence[str]) -> Roles:
    """Return the parts of the animal that the points' names denote, according to a built-in skeleton or name map."""
    skeleton, by_marker = marker_names(names)
    body = None if skeleton is None else load_skeleton(skeleton)
    if body is None or len(by_marker) < max(MIN_NAMES, NAMES_KNOWN * min(len(names), len(body.markers))):
        feet = [i for i, name in enumerate(names) if _LOWEST.search(name)]
        feet = feet or [i for i, name in enumerate(names) if _FOOT.search(name)]
        upper = (i for i, name in enumerate(names) if _TRUNK.search(name) and i not in feet)
        return Roles(feet=tuple(feet), upper=tuple(upper))
    roles = _roles_by(body, by_marker)
    are_own = all(names[i] == marker for marker, i in by_marker.items())
    return roles if are_own else replace(roles, bones_m={})  # names from a map may belong to any species


def _roles_by(body: Body, by_marker: Mapping[str, int]) -> Roles:
    rear, front = (by_marker.get(end) for end in body.forward)
    trunk = None if rear is None or front is None else (rear, front)
    joints: dict[str, tuple[int, int, int]] = {}
    for joint, (above, middle, below) in body.anatomy.items():
        if above in by_marker and middle in by_marker and below in by_marker:
            joints[joint] = (by_marker[above], by_marker[middle], by_marker[below])
    limbs = {
        name: tuple(by_marker[marker] for marker in markers if marker in by_marker)
        for name, markers in body.limbs.items()
    }
    at_m = dict(zip(body.markers, body.expected_points_m(), strict=True))
    bones_m = {
        (by_marker[a], by_marker[b]): float(np.linalg.norm(at_m[a] - at_m[b]))
        for markers in body.limbs.values()
        for a, b in pairwise(markers)
        if a in by_marker and b in by_marker
    }
    feet = tuple(by_marker[foot] for foot in body.feet if foot in by_marker)
    return Roles(body.name, feet, trunk or (), trunk, joints, limbs, bones_m)
