"""Approximate an animal by capsules along the segments of its tree, for pictures and moments of inertia."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from recon.animal.body import Side, common_side, side_of
from recon.base.arrays import Array
from recon.geometry.kinematics import Tree

_SLENDER = 0.12
"""Minimum radius of a segment's capsules, relative to the length of the segment's longest capsule."""


@dataclass(frozen=True)
class Capsule:
    """Cylinder with round ends from a segment's origin to the point `end_m`, (x, y, z) in the segment's frame."""

    segment: int
    """Index of the segment that the capsule represents."""
    end_m: tuple[float, float, float]
    radius_m: float
    side: Side | None


def capsules(tree: Tree, names: Sequence[str]) -> tuple[Capsule, ...]:
    """Return the capsules that represent the segments of a tree.

    The capsules lie in the x-z plane of a segment and extend from its origin to the origins of its child segments and
    to its markers. Their radius is the largest distance of these points from that plane. A segment of the trunk between
    two others is at least as thick as the thinner of the two. The side of a capsule follows from the name of the
    segment and from `names`, the keypoints' names of the J markers.
    """
    segments = tree.segments
    ends, radii, sides = [], [], []
    for segment in segments:
        fixed = [(m.offset_m, name) for m, name in zip(tree.markers, names, strict=True) if m.segment == segment.name]
        points = [s.offset_m for s in segments if s.parent == segment.name] + [offset_m for offset_m, _ in fixed]
        ends.append(list(dict.fromkeys((x, 0.0, z) for x, _, z in points if (x, z) != (0.0, 0.0))))
        reach = max((float(np.hypot(x, z)) for x, _, z in ends[-1]), default=0.0)
        radii.append(max([_SLENDER * reach, *(abs(y) for _, y, _ in points)]))
        sides.append(common_side(side_of(name) for name in (segment.name, *(name for _, name in fixed))))
    index_of = {segment.name: i for i, segment in enumerate(segments)}
    shape = []
    for i, segment in enumerate(segments):
        radius = radii[i]
        if sides[i] is None and segment.parent is not None:
            beyond = [radii[j] for j, s in enumerate(segments) if s.parent == segment.name and sides[j] is None]
            radius = max(radius, min(radii[index_of[segment.parent]], max(beyond, default=0.0)))
        shape += [Capsule(i, end, radius, sides[i]) for end in ends[i]]
    return tuple(shape)


def middles_m(tree: Tree, shape: Sequence[Capsule]) -> Array:
    """Return the middle of each segment's capsules in the segment's frame, metres, shape (S, 3).

    Return the origin for a segment without capsules.
    """
    ends = [[c.end_m for c in shape if c.segment == i] or [(0.0, 0.0, 0.0)] for i in range(len(tree.segments))]
    return np.array([np.mean(segment_ends, axis=0) / 2 for segment_ends in ends])


def inertias_m2(tree: Tree, shape: Sequence[Capsule]) -> Array:
    """Return each segment's inertia tensor about the middle of its capsules, per kilogram, m^2, shape (S, 3, 3).

    Capsules are treated as solid cylinders of uniform density, without the round ends.
    """
    inertia, volume = np.zeros((len(tree.segments), 3, 3)), np.zeros(len(tree.segments))
    middles = middles_m(tree, shape)
    for capsule in shape:
        end, square = np.array(capsule.end_m), capsule.radius_m**2
        length = float(np.linalg.norm(end))
        axial, offset = np.outer(end, end) / length**2, end / 2 - middles[capsule.segment]
        about_centre = square / 2 * axial + (square / 4 + length**2 / 12) * (np.eye(3) - axial)
        inertia[capsule.segment] += (
            length * square * (about_centre + offset @ offset * np.eye(3) - np.outer(offset, offset))
        )
        volume[capsule.segment] += length * square
    return inertia / np.maximum(volume, 1e-12)[:, None, None]
