"""Describe an animal by its segments, its markers and the expected pose.

A body is a kinematic tree (`recon.geometry.kinematics`) with an expected pose and its standard deviations. In the frame
of a segment, x points forwards, y left and z up. The class `Body` describes both a whole animal and a chain
(`recon.animal.chain`). A chain has the limbs of one side only, and a left and a right keypoint for each marker.

Only this module decides what is left, right, fore and hind. The side of a segment or marker follows from a word in its
name (`SIDES`), and the position of a foot from the skeleton file (`FOOT_LABELS`).
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from pydantic import BeforeValidator

from recon.base.arrays import Array, Brief, Index
from recon.base.errors import Problem
from recon.geometry.kinematics import Marker, Tree

ROUGH_SIZE_SIGMA = 0.25
"""Relative standard deviation of the animal's size above which a skeleton belongs to no particular species.

The standard deviation of skeletons of a single species is at most 0.15.
"""
MAX_ANIMAL_M = 15.0
"""Length, in metres, that no legged animal exceeds."""
MIN_JOINTS = 5
"""Minimum number of detected joints required to determine an animal's pose."""
MIN_REACH_PX = 50.0
"""Length of the outstretched animal in the picture below which the animal is too small to be detected."""

Side = Literal["left", "right"]

SIDES = {"left": "right", "near": "off", "l": "r"}
"""Words for the left side in names, each with the word for the right side.

The near side of a horse is its left side, whatever the position of the camera.
"""
_OPPOSITE = SIDES | {right: left for left, right in SIDES.items()}


def _side_pattern() -> re.Pattern[str]:
    """Return a pattern that matches the word for a side in a name.

    The word stands between separators, as in front_left_paw or eye.L, or is set off by capitals, as in frontLeftPaw,
    hipR or Nearknee. A letter may be part of a leg's code: LF, FL, RH, HR, LB, BL. A letter next to a digit does not
    count, because l1 may be a vertebra.
    """
    words = [word for word in _OPPOSITE if len(word) > 1]
    lower, title, upper = ("|".join(map(case, words)) for case in (str.lower, str.title, str.upper))
    return re.compile(
        f"^(?:{title}|(?:left|right)(?=[a-z]{{3}})(?!over))"  # as in leftear, but not in leftover
        f"|(?<![A-Za-z])(?:{upper})(?![A-Za-z])"
        f"|(?<![A-Za-z])(?:{lower}|{title})(?![a-z])"
        f"|(?<=[a-z0-9])(?:{title})(?![a-z])"
        "|(?<![A-Za-z0-9])[lrLR](?![A-Za-z0-9])"
        "|(?<![A-Za-z0-9])[lrLR](?=[A-Z][a-z])"
        "|(?<=[a-z])[LR](?=[A-Z][a-z]|[^A-Za-z0-9]|$)"
        "|(?<![A-Za-z0-9])[LR](?=[FHB](?:[A-Z][a-z]|[^A-Za-z0-9]|$))"
        "|(?<![A-Za-z0-9])[lr](?=[fhb](?![A-Za-z0-9]))"
        "|(?<=(?<![A-Za-z0-9])[FHB])[LR](?=[A-Z][a-z]|[^A-Za-z0-9]|$)"
        "|(?<=(?<![A-Za-z0-9])[fhb])[lr](?![A-Za-z0-9])"
    )


SIDE_WORD = _side_pattern()

FOOT_LABELS = {"left_fore": "LF", "right_fore": "RF", "left_hind": "LH", "right_hind": "RH"}
"""Label of each foot of a whole animal, with the foot's position as the key."""
_LABELLED: dict[str, Side] = {"L": "left", "R": "right"}
CHAIN_FOOT_LABELS = {"fore": "F", "hind": "H"}
"""Label of each foot of a chain without the letter of the fitted side, with the foot's position as the key."""


def foot_table(allowed: Iterable[str], example: str) -> BeforeValidator:
    """Return a validator for the table of feet in a skeleton file, which raises the same message for every problem."""

    def checked(value: object) -> object:
        if isinstance(value, dict) and {*value} <= {*allowed} and all(isinstance(foot, str) for foot in value.values()):
            return value
        raise ValueError(f"a table with the position of each foot, such as {example}")

    return BeforeValidator(checked)


def foot_problems(feet: dict[str, str], source: str) -> Iterator[Problem]:
    """Yield a problem for each foot whose name contradicts its side, and a problem if a foot is listed twice."""
    for position, foot in feet.items():
        side = side_of(foot)
        if side is not None and position in FOOT_LABELS and not position.startswith(side):
            yield Problem(
                source, f"feet.{position}", repr(foot), f"a {position.split('_')[0]} foot: this name says {side}"
            )
    if len({*feet.values()}) < len(feet):
        yield Problem(source, "feet", ", ".join(feet.values()), "every foot once")


def side_of(name: str) -> Side | None:
    """Return the side that the first word for a side in a name states; None for a name without such a word."""
    word = SIDE_WORD.search(name)
    return None if word is None else "left" if word[0].lower() in SIDES else "right"


def other_side(name: str) -> str:
    """Return the name on the other side, such as r_paw for l_paw, or the same name if it has no side."""
    word = SIDE_WORD.search(name)
    return name if word is None else name[: word.start()] + opposite_word(word[0]) + name[word.end() :]


def opposites(names: Sequence[str]) -> Index:
    """Return the index of each name's counterpart on the other side of the body, shape (N,).

    The counterpart of a name on the midline, or of a name that has none, is the name itself.
    """
    index_of = {name: i for i, name in enumerate(names)}
    return np.array([index_of.get(other_side(name), i) for name, i in index_of.items()], dtype=np.intp)


def opposite_word(word: str) -> str:
    """Return the word for the other side of the body, in the same case, such as Right for Left."""
    opposite = _OPPOSITE[word.lower()]
    return opposite.upper() if word.isupper() else opposite.title() if word.istitle() else opposite


def common_side(sides: Iterable[Side | None]) -> Side | None:
    """Return the side that all items have in common; None if the sides differ or all items are on the midline."""
    distinct: set[Side] = {side for side in sides if side is not None}
    return distinct.pop() if len(distinct) == 1 else None


@dataclass(frozen=True)
class Skeleton:
    """Base class of skeletons with a file format of their own, which can be converted to a body (`Chain`)."""

    name: str
    title: str


@dataclass(frozen=True, repr=False)
class Body(Brief):
    """Kinematic tree of an animal with J markers and D unknowns per frame, and the expected values of the angles."""

    name: str
    title: str
    tree: Tree
    keypoints: tuple[tuple[str, str], ...]
    """Names of each marker's keypoints for a fit of the left limbs and for a fit of the right limbs, J pairs."""
    limbs: dict[str, tuple[str, ...]]
    """Names of the markers along each limb, with the limbs' names as keys; used for drawing."""
    forward: tuple[str, str]
    """Rear and front marker of the trunk, which define the direction in which the animal faces."""
    feet: tuple[str, ...]
    """Names of the markers that touch the ground."""
    foot_labels: tuple[str, ...]
    """Position of each foot, a key of `FOOT_LABELS`, or of `CHAIN_FOOT_LABELS` for a chain."""
    keypoint_sigma_m: float
    """Standard deviation of a detected keypoint about its marker in a single frame."""
    size_sigma: float
    """Relative standard deviation of the animal's size, a factor near 1 that scales all lengths."""
    mean_rad: Array
    """Expected values of the root's pitch and roll and the joints' angles, which are state[:, 4:], shape (D - 4,)."""
    sigma_rad: Array
    """Standard deviations of the angles about `mean_rad`, shape (D - 4,)."""
    acceleration_rad_s2: Array
    """Standard deviations of the angular accelerations of the same angles as in `mean_rad`, shape (D - 4,)."""
    keypoint_offset_m: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """Offset of a detector's keypoint from its marker, with the markers' names as keys.

    An offset is (x, y, z) in the frame of the marker's segment.
    """
    keypoint_spread_m: dict[str, float] = field(default_factory=dict)
    """Standard deviation of a keypoint's offset between clips, along each axis, with the markers' names as keys."""
    marker_sigma_m: float = 0.0
    """Standard deviation, along each axis, of the difference between a marker and the same point of the real animal."""
    keypoint_noise_m: dict[str, float] = field(default_factory=dict)
    """Values that replace `keypoint_sigma_m` for single keypoints, with the markers' names as keys."""
    detector: str | None = None
    """Name of the detector to which the keypoints' offsets belong (`recon.animal.skeleton_file`); None without any."""
    mass: dict[str, tuple[float, float]] = field(default_factory=dict)
    """Fraction of the body's mass in each segment, with its standard deviation; empty if unknown."""
    mass_source: str | None = None
    """Publication or data from which the masses were taken; None if the masses are unknown."""
    anatomy: dict[str, tuple[str, str, str]] = field(default_factory=dict)
    """Markers above, at and below each anatomical joint, with names such as left_elbow as keys."""
    subject: str | None = None
    """Name of the animal whose measured lengths the body has; None for the lengths of the skeleton file."""

    def scaled(self, size: float) -> Body:
        """Return the body of an animal with the same proportions, `size` times as large."""

        def times(lengths_m: dict[str, float]) -> dict[str, float]:
            return {name: size * length_m for name, length_m in lengths_m.items()}

        return replace(
            self,
            title=f"{self.title}, {size:.3g} times as large",
            tree=self.tree.scaled(size),
            keypoint_sigma_m=size * self.keypoint_sigma_m,
            marker_sigma_m=size * self.marker_sigma_m,
            keypoint_offset_m={
                name: (size * x, size * y, size * z) for name, (x, y, z) in self.keypoint_offset_m.items()
            },
            keypoint_spread_m=times(self.keypoint_spread_m),
            keypoint_noise_m=times(self.keypoint_noise_m),
        )

    @cached_property
    def detected(self) -> Tree:
        """Return the kinematic tree with its markers moved to the detector's keypoints (`keypoint_offset_m`)."""
        if not self.keypoint_offset_m:
            return self.tree
        zero = (0.0, 0.0, 0.0)
        shifts = [self.keypoint_offset_m.get(m.name, zero) for m in self.tree.markers]
        markers = (
            replace(m, offset_m=(m.offset_m[0] + x, m.offset_m[1] + y, m.offset_m[2] + z))
            for m, (x, y, z) in zip(self.tree.markers, shifts, strict=True)
        )
        return replace(self.tree, markers=tuple(markers))

    @cached_property
    def joint_points(self) -> tuple[Tree, Index]:
        """Return a kinematic tree of the points that define the A anatomical joints, and their indices in it, (A, 5).

        The points of a joint are its three markers (`anatomy`), and two points on the left axis of the segment that
        carries the first marker. These are 1 m apart, so that their difference has the derivatives of the axis.
        """
        segment_of, sides = {marker.name: marker.segment for marker in self.tree.markers}, (0, 1)
        carriers = dict.fromkeys(segment_of[markers[0]] for markers in self.anatomy.values())
        on_axes = [
            Marker(f"{segment} {side}", segment, (0.0, side - 0.5, 0.0)) for segment in carriers for side in sides
        ]
        defining = {marker for markers in self.anatomy.values() for marker in markers}
        tree = replace(self.tree, markers=(*(m for m in self.tree.markers if m.name in defining), *on_axes))
        index_of = {marker.name: index for index, marker in enumerate(tree.markers)}
        points = [(*m, *(f"{segment_of[m[0]]} {side}" for side in sides)) for m in self.anatomy.values()]
        indices = [[index_of[point] for point in of_joint] for of_joint in points]
        return tree, np.array(indices, dtype=np.intp).reshape(-1, 5)

    @cached_property
    def markers(self) -> tuple[str, ...]:
        """Return the names of the J markers, in the order of all arrays of joints."""
        return tuple(m.name for m in self.tree.markers)

    @cached_property
    def one_sided(self) -> bool:
        """Return whether the body represents the limbs of one side only, as a body made from a chain does."""
        return any(left != right for left, right in self.keypoints)

    def keypoint_names(self, side: Side | None) -> tuple[str, ...]:
        """Return the names of the J markers' keypoints for a fit of the limbs of `side` (None for a whole animal)."""
        return tuple(right if side == "right" else left for left, right in self.keypoints)

    def feet_by_label(self, side: Side | None = None) -> dict[str, str]:
        """Return a dictionary of the feet's markers, with the labels LF, RF, LH and RH as keys.

        `side` is the side of the animal to which a one-sided model is fitted, None for a model of the whole animal.
        """
        start = "" if side is None else side[0].upper()
        labels = (label if label in FOOT_LABELS.values() else start + label for label in self.foot_labels)
        return dict(zip(labels, self.feet, strict=True))

    def side_of(self, marker: str) -> Side | None:
        """Return the side of a marker from its foot label or, if it is not a foot, from its name."""
        label = dict(zip(self.feet, self.foot_labels, strict=True)).get(marker, "")
        return _LABELLED[label[0]] if label in FOOT_LABELS.values() else side_of(marker)

    def limb_sides(self, side: Side | None = None) -> dict[str, Side | None]:
        """Return the side of each limb; None for a limb on the midline or with markers on both sides.

        `side` is the side of the animal to which a one-sided model is fitted, None for a model of the whole animal.
        """
        one_sided = {m for m, (left, right) in zip(self.markers, self.keypoints, strict=True) if left != right}
        return {
            limb: common_side(side if marker in one_sided else self.side_of(marker) for marker in markers)
            for limb, markers in self.limbs.items()
        }

    @cached_property
    def limb_rows(self) -> dict[str, tuple[int, ...]]:
        """Return the indices of the markers along each limb, with the limbs' names as keys; used for drawing."""
        index_of = {marker: j for j, marker in enumerate(self.markers)}
        return {limb: tuple(index_of[marker] for marker in markers) for limb, markers in self.limbs.items()}

    @property
    def n_state(self) -> int:
        """Return the number D of unknowns per frame."""
        return self.tree.n_state

    @property
    def state_names(self) -> tuple[str, ...]:
        """Return the names of the D unknowns of a frame, beginning with the root's position and heading."""
        return self.tree.state_names

    def expected_points_m(self, angle: int | None = None, off_rad: float = 0.0) -> Array:
        """Return the positions of the markers in the expected pose, metres, shape (J, 3), with the root at the origin.

        If `angle`, an index into state[4:], is given, this angle differs from its expected value by `off_rad`.
        """
        state = np.concatenate([np.zeros(4), self.mean_rad])
        if angle is not None:
            state[4 + angle] += off_rad
        return self.tree.pose(state[None]).points_m[0]

    @cached_property
    def mirror(self) -> tuple[Index, Array]:
        """Return the permutation and the signs, (D,) each, that exchange left and right in a state of the animal.

        state[..., permutation] * sign is the state after reflection in the x-z plane.
        """
        flips = np.array([False, True, False, *(axis != "y" for axis in self.tree.axes)])
        return opposites(self.state_names), np.where(flips, -1.0, 1.0)
