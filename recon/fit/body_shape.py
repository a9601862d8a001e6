"""Define the unknown shape of a body: lengths of its segments, and offsets of its keypoints.

`Shape` serves the fit of a subject, in which the right side mirrors the left. `FreeShape` serves the fit of a clip of
several cameras, in which lengths and offsets are unknowns that all frames share (`recon.fit.least_squares`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from recon.animal.body import Body, other_side, side_of
from recon.base.arrays import Array
from recon.fit.terms import COMMON_KEYPOINT_BIAS, LENGTHS

LENGTH_SIGMA = 0.05
"""Relative standard deviation of a segment's length about the skeleton's length, scaled to the animal's size."""
OFFSET_SIGMA_M = 0.01
"""Standard deviation of a keypoint's offset from its marker along each axis, m.

Real offsets are larger, but the body's lengths are fitted as well and absorb a part of them.
"""


@dataclass(frozen=True, eq=False)
class Shape:
    """Unknown shape of a body: the lengths of its segments and the offsets of its keypoints.

    The K unknowns are the logarithms of factors on the lengths, followed by the coordinates of the offsets, m.
    """

    body: Body
    lengths: tuple[str, ...] = ()
    """Names of the segments and markers whose distance from the origin of their parent segment is unknown.

    Lengths on the right equal those on the left.
    """
    offsets: tuple[str, ...] = ()
    """Names of the markers with unknown keypoint offsets along x, y and z.

    Offsets on the right mirror those on the left.
    """
    offset_sigma_m: float = OFFSET_SIGMA_M

    @classmethod
    def of_body(cls, body: Body, lengths: bool = True, offsets: bool = False) -> Shape:
        """Return the shape of a body with all its lengths, the offsets of all its keypoints, or both as unknowns."""
        items = (*body.tree.segments[1:], *body.tree.markers) if lengths else ()
        named = (item.name for item in items if any(item.offset_m) and not follows(item.name, body))
        return cls(body, tuple(named), tuple(m for m in body.markers if offsets and not follows(m, body)))

    def __len__(self) -> int:
        """Return K, the number of unknowns of the body's shape."""
        return len(self.lengths) + 3 * len(self.offsets)

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of the K lengths and offset coordinates that are unknown."""
        return (*self.lengths, *(f"{name}_{axis}" for name in self.offsets for axis in "xyz"))

    def expected_precision(self, size_sigma: float) -> Array:
        """Return the prior precision (K, K) of the unknowns.

        All lengths vary together with the animal's size, and each length also varies slightly on its own.
        """
        n = len(self.lengths)
        covariance = np.diag(np.repeat([LENGTH_SIGMA**2, self.offset_sigma_m**2], [n, len(self) - n]))
        covariance[:n, :n] += size_sigma**2
        return np.linalg.inv(covariance)

    def applied(self, body: Body, values: Array) -> Body:
        """Return a body whose lengths and keypoint offsets are changed by values (K,) of the unknowns."""
        factors = dict(zip(self.lengths, np.exp(values[: len(self.lengths)]), strict=True))
        shifts = dict(zip(self.offsets, values[len(self.lengths) :].reshape(-1, 3), strict=True))

        tree = body.tree.lengthened(lambda name: factors.get(self.leader(name), 1.0))
        offsets = dict(body.keypoint_offset_m)
        for name in self.body.markers:
            if (leader := self.leader(name)) in shifts:
                x, y, z = (float(v) for v in shifts[leader] * self._mirror(name))
                given_offset = offsets.get(name, (0.0, 0.0, 0.0))
                offsets[name] = (given_offset[0] + x, given_offset[1] + y, given_offset[2] + z)
        return replace(body, tree=tree, keypoint_offset_m=offsets)

    def jacobian(self, body: Body, states: Array, rotations: Array | None = None) -> Array:
        """Return the derivatives (N, J, 3, K) of a body's detected markers with respect to the shape, at nominal size.

        `rotations` (N, S, 3, 3) are the rotations of the segments, if they have been computed already.
        """
        tree, n, markers, offsets = body.tree, len(self.lengths), self._markers_of_lengths, self._markers_of_offsets
        R = tree.orientations(states) if rotations is None else rotations
        items = {item.name: item for item in (*tree.segments, *tree.markers)}
        by_shape = np.zeros((len(states), len(tree.markers), 3, len(self)))
        for (name, segment, column), moved in markers.items():
            by_length = R[:, segment] @ np.array(items[name].offset_m)
            for j in moved:
                by_shape[:, j, :, column] += by_length
        for j, segment, column, mirror in offsets:
            by_shape[:, j, :, n + column : n + column + 3] = R[:, segment] * mirror
        return by_shape

    @cached_property
    def _markers_of_lengths(self) -> dict[tuple[str, int, int], list[int]]:
        """Return the indices of the markers that each unknown length moves.

        Each key holds the name of that segment or marker, the index of the segment that carries it, and the column of
        its length.
        """
        tree, columns = self.body.tree, {name: i for i, name in enumerate(self.lengths)}
        indices = {segment.name: i for i, segment in enumerate(tree.segments)}
        markers: dict[tuple[str, int, int], list[int]] = {}
        for j, marker in enumerate(tree.markers):
            name, carrier = marker.name, marker.segment
            while carrier is not None:
                if (leader := self.leader(name)) in columns:
                    markers.setdefault((name, indices[carrier], columns[leader]), []).append(j)
                name, carrier = carrier, tree.segments[indices[carrier]].parent
        return markers

    @cached_property
    def _markers_of_offsets(self) -> list[tuple[int, int, int, Array]]:
        """Return index, segment, first column and signs of the axes for each marker with an unknown offset."""
        tree, indices = self.body.tree, {segment.name: i for i, segment in enumerate(self.body.tree.segments)}
        return [
            (j, indices[marker.segment], 3 * self.offsets.index(self.leader(marker.name)), self._mirror(marker.name))
            for j, marker in enumerate(tree.markers)
            if self.leader(marker.name) in self.offsets
        ]

    def leader(self, name: str) -> str:
        """Return the name of the left counterpart for a segment or marker on the right, or the name unchanged."""
        return other_side(name) if name in self._followers else name

    @cached_property
    def _followers(self) -> frozenset[str]:
        """Return the names of segments and markers that share the unknowns of their left counterparts."""
        items = (*self.body.tree.segments, *self.body.tree.markers)
        return frozenset(item.name for item in items if follows(item.name, self.body))

    def _mirror(self, name: str) -> Array:
        return np.array([1.0, -1.0, 1.0]) if name in self._followers else np.ones(3)


def follows(name: str, body: Body) -> bool:
    """Return whether a segment or marker is on the right side and has a counterpart on the left."""
    names = {*body.markers, *(segment.name for segment in body.tree.segments)}
    return side_of(name) == "right" and other_side(name) in names


@dataclass(frozen=True, eq=False)
class FreeShape:
    """Lengths and keypoint offsets of a body as unknowns that all frames share.

    The shared unknowns `LENGTHS` (L,) are logarithms of factors on the lengths of segments and markers, the same on
    both sides. `COMMON_KEYPOINT_BIAS` (3J,) are the keypoints' offsets from their markers in the frames of the markers'
    segments, metres.
    """

    body: Body
    """Body whose lengths and keypoint offsets the shape changes."""
    lengths: Shape
    _shaped: dict[bytes, Body] = field(default_factory=dict, repr=False)
    """Cache of the body that was built last, by the values of its shape."""

    @classmethod
    def of_body(cls, body: Body) -> FreeShape:
        """Return the shape of a body with all its lengths and offsets as unknowns."""
        return cls(body, Shape.of_body(body))

    def applied(self, shared: Mapping[str, Array]) -> Body:
        """Return the body with the lengths and offsets given among the shared unknowns."""
        lengths = np.asarray(shared.get(LENGTHS, np.zeros(len(self.lengths))))
        offsets_m = np.asarray(shared.get(COMMON_KEYPOINT_BIAS, np.zeros(3 * len(self.body.markers)))).reshape(-1, 3)
        key = lengths.tobytes() + offsets_m.tobytes()
        if key not in self._shaped:
            body, previous = self._with(lengths, offsets_m), next(iter(self._shaped.values()), self.body)
            if body is not self.body:
                body.detected.use_plan_of(previous.detected)
            self._shaped.clear()
            self._shaped[key] = body
        return self._shaped[key]

    def _with(self, lengths: Array, offsets_m: Array) -> Body:
        if not lengths.any() and not offsets_m.any():
            return self.body
        body = self.lengths.applied(self.body, lengths)
        known_m = [body.keypoint_offset_m.get(marker, (0.0, 0.0, 0.0)) for marker in body.markers]
        total_m = (np.array(known_m) + offsets_m).tolist()
        offsets = {marker: (x, y, z) for marker, (x, y, z) in zip(body.markers, total_m, strict=True)}
        return replace(body, keypoint_offset_m=offsets)

    def derivatives(self, shared: Mapping[str, Array], states: Array) -> tuple[Array, Array]:
        """Return the derivatives of the detected markers with respect to the shape, at given states (N, D).

        Returns
        -------
        by_length : (N, J, 3, L)
            Derivatives with respect to the lengths.
        by_offset : (N, J, 3, 3)
            Derivatives with respect to each marker's own offset, which are the rotation of its segment.
        """
        body = self.applied(shared)
        rotations = body.detected.orientations(states)  # equal to the rotations of `body.tree`
        names = [segment.name for segment in body.tree.segments]
        by_offset = rotations[:, [names.index(marker.segment) for marker in body.tree.markers]]
        return self.lengths.jacobian(body, states, rotations), by_offset
