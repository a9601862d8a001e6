"""What an animal looks like, roughly: capsules along the segments of its tree, for pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from recon.animal.body import Side, common_side, side_of
from recon.base.arrays import Array
from recon.geometry.kinematics import Tree

_SLENDER = 0.12
"""Radius of a segment, at least, relative to its longest capsule."""


@dataclass(frozen=True)
class Capsule:
    """A cylinder with round ends, from a segment's origin to a point (x, y, z) of its frame. Metres."""

    segment: int
    """The name of the tree's segment that the capsule is fixed on."""
    end_m: tuple[float, float, float]
    radius_m: float
    side: Side | None


def capsules(tree: Tree, names: Sequence[str]) -> tuple[Capsule, ...]:
    """The capsules of a tree whose J markers have these names, which say the sides with those of the segments.

    They lie in a segment's middle plane, from its origin to those of the next segments and to its markers. It is as
    thick as these are far apart; between two others of the trunk, at least as the thinner of them.
    """
    segments = tree.segments
    ends, radii, sides = [], [], []
    for segment in segments:
        on_it = [(m.offset_m, name) for m, name in zip(tree.markers, names, strict=True) if m.segment == segment.name]
        points = [s.offset_m for s in segments if s.parent == segment.name] + [offset_m for offset_m, _ in on_it]
        ends.append(list(dict.fromkeys((x, 0.0, z) for x, _, z in points if (x, z) != (0.0, 0.0))))
        reach = max((float(np.hypot(x, z)) for x, _, z in ends[-1]), default=0.0)
        radii.append(max([_SLENDER * reach, *(abs(y) for _, y, _ in points)]))
        sides.append(common_side(side_of(name) for name in (segment.name, *(name for _, name in on_it))))
    at = {segment.name: i for i, segment in enumerate(segments)}
    found = []
    for i, segment in enumerate(segments):
        radius = radii[i]
        if sides[i] is None and segment.parent is not None:
            beyond = [radii[j] for j, s in enumerate(segments) if s.parent == segment.name and sides[j] is None]
            radius = max(radius, min(radii[at[segment.parent]], max(beyond, default=0.0)))
        found += [Capsule(i, end, radius, sides[i]) for end in ends[i]]
    return tuple(found)


def middles_m(tree: Tree, shape: Sequence[Capsule]) -> Array:
    """(S, 3): of each segment's capsules, in its frame; its origin where it has none."""
    ends = [[c.end_m for c in shape if c.segment == i] or [(0.0, 0.0, 0.0)] for i in range(len(tree.segments))]
    return np.array([np.mean(of_one, axis=0) / 2 for of_one in ends])


def inertias_m2(tree: Tree, shape: Sequence[Capsule]) -> Array:
    """(S, 3, 3): moments of inertia about `middles_m`, per kilogram, of solid cylinders of one density, without their
    round ends."""
    found, volume = np.zeros((len(tree.segments), 3, 3)), np.zeros(len(tree.segments))
    middles = middles_m(tree, shape)
    for capsule in shape:
        end, square = np.array(capsule.end_m), capsule.radius_m**2
        length = float(np.linalg.norm(end))
        along, off = np.outer(end, end) / length**2, end / 2 - middles[capsule.segment]
        own = square / 2 * along + (square / 4 + length**2 / 12) * (np.eye(3) - along)
        found[capsule.segment] += length * square * (own + off @ off * np.eye(3) - np.outer(off, off))
        volume[capsule.segment] += length * square
    return found / np.maximum(volume, 1e-12)[:, None, None]
