"""Define the points of a file to audit, and derive the body parts from their names."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from recon.animal.body import Body
from recon.animal.naming import marker_names
from recon.animal.skeleton_file import load_skeleton
from recon.base.arrays import Array, Bools, Brief, Index, Integers

NAMES_KNOWN = 0.6
"""Smallest fraction of matching names with which a built-in skeleton is used.

The fraction is that of the file's points or of the skeleton's markers, whichever are fewer.
"""
LEAST_NAMES = 4
"""Smallest number of matching names with which a skeleton is used, because two or three match several animals."""
_FOOT = re.compile(r"(?i)paw|hoof|toe|foot(?!base)|feet|hand(?!le)|claw|ankle|wrist")
_STANDING = re.compile(rf"{_FOOT.pattern}|fetlock|pastern|digit|heel|hock|tarsus|carpus|knee")
_LOWEST = re.compile(r"(?i)paw|hoof|toe|foot|feet|hand|claw")
_TRUNK = re.compile(
    r"(?i)spine|back(?!.*(leg|paw|knee|hoof|foot|ankle))|withers|trunk|tail.?base|root.?of.?tail|hips|neck|croup|thorax|chest"
)
_WORD = re.compile(r"[A-Za-z]{3}")
DECIMALS = 6
"""Number of decimals above which the numbers of a file count as not rounded."""


@dataclass(frozen=True)
class Roles:
    """Parts of the animal among the K points, as indices."""

    skeleton: str | None = None
    """Built-in skeleton with the points' names."""
    feet: tuple[int, ...] = ()
    upper: tuple[int, ...] = ()
    """Points of the trunk, which are above the feet of a standing animal."""
    trunk: tuple[int, int] | None = None
    """Rear and front end of the trunk."""
    joints: Mapping[str, tuple[int, int, int]] = field(default_factory=dict)
    """Points above, at and below each joint of the skeleton's section `[anatomy]`, by the joint's name."""
    limbs: Mapping[str, tuple[int, ...]] = field(default_factory=dict)
    bones_m: Mapping[tuple[int, int], float] = field(default_factory=dict)
    """Distances between successive points of the limbs in the skeleton's expected pose, by pair."""


@dataclass(frozen=True, eq=False, repr=False)
class AuditedPoints(Brief):
    """K points of one animal in T frames, in pixels or metres (z up)."""

    names: tuple[str, ...]
    positions: Array
    """(T, K, 2) or (T, K, 3): positions in pixels, or in 3D in metres; NaN if missing."""
    frames: Integers
    fps: float | None = None
    resolution: float = 0.0
    """Smallest step between the file's numbers, in the unit of `positions`; 0 if the numbers have full precision."""
    roles: Roles = field(default_factory=Roles)

    @property
    def in_space(self) -> bool:
        """Return whether the points are 3D."""
        return self.positions.shape[2] == 3

    @cached_property
    def known(self) -> Bools:
        """Return a mask (T, K) of the frames in which each point is known."""
        return np.asarray(np.isfinite(self.positions).all(axis=2))

    @cached_property
    def extent(self) -> float:
        """Return the median size of the animal: the largest side of the box around its points; NaN without points."""
        counts = self.known.sum(axis=1)
        rows = counts >= max(3, 0.5 * counts.max(initial=0))
        if not rows.any():
            return np.nan
        sides = np.nanmax(self.positions[rows], axis=1) - np.nanmin(self.positions[rows], axis=1)
        return float(np.median(sides.max(axis=1)))

    @cached_property
    def follows(self) -> Bools:
        """Return a mask (T,) of frames that follow the frame before without a gap in numbers; False for the first."""
        steps = np.diff(self.frames)
        usual = np.median(steps) if len(steps) else 1
        return np.append(False, steps == usual)

    @cached_property
    def stands(self) -> Bools:
        """Return a mask of points (K,) that can stand still while the animal walks: lower limbs, and unnamed points."""
        return np.array([bool(_STANDING.search(name)) or not _WORD.search(name) for name in self.names])

    def named(self, indices: Sequence[int] | Index) -> tuple[str, ...]:
        """Return the names of the points with the given indices."""
        return tuple(self.names[int(i)] for i in indices)


@dataclass(frozen=True)
class Measure:
    """Result of one check; a larger value is more suspicious."""

    code: str
    value: float
    """Value to compare with the code's limit (`recon.check.audit.LIMITS`)."""
    rows: tuple[int, int] | None = None
    """First row that the result is about, and the row after the last one; None means all rows."""
    numbers: Mapping[str, Any] = field(default_factory=dict)
    """Numbers for the text of the finding."""


def resolution_of(values: Array) -> float:
    """Return the smallest step between numbers, in their unit; 0 if they have full precision."""
    sample = values[np.isfinite(values)]
    sample = sample[:: max(1, len(sample) // 4000)]
    for decimals in range(DECIMALS + 1):
        scaled = sample * 10.0**decimals
        if np.abs(scaled - np.round(scaled)).max(initial=0.0) < 1e-9 * max(1.0, np.abs(scaled).max(initial=0.0)):
            return 10.0**-decimals
    return 0.0


def roles_of(names: Sequence[str]) -> Roles:
    """Return the parts of the animal from the points' names, according to a built-in skeleton or one of its maps."""
    skeleton, by_marker = marker_names(names)
    body = None if skeleton is None else load_skeleton(skeleton)
    if body is None or len(by_marker) < max(LEAST_NAMES, NAMES_KNOWN * min(len(names), len(body.markers))):
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
