"""An animal: a tree of segments (`recon.geometry.kinematics`), its markers, and what is expected of its pose.

The states are the tree's; x forwards, y left, z up. There is one model for a whole animal and for a chain
(`recon.animal.chain`), which is a tree with the limbs of one side and has two keypoints for a marker.

What is left and right, fore and hind, stands here and nowhere else: names of segments and markers say by a word which
side they belong to (`SIDES`), the skeleton's file says where each foot is (`PLACES`)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from pydantic import BeforeValidator

from recon.base import Array, Brief, Index, Problem
from recon.geometry.kinematics import Tree

MIN_JOINTS = 5
"""Fewer detected joints than this do not place an animal."""
MIN_REACH_PX = 50.0
"""All limbs end to end shorter than this in the picture: too far away to have been detected."""

Side = Literal["left", "right"]

SIDES = {"left": "right", "near": "off", "l": "r"}
"""Words for the left side, and for the right. A horse's near side is its left one, wherever it is seen from."""
_OPPOSITE = SIDES | {right: left for left, right in SIDES.items()}


def _side_pattern() -> re.Pattern[str]:
    """A word of a side in a name: between separators, as in front_left_paw or eye.L, or told apart by capitals, as in
    frontLeftPaw, hipR or Nearknee. A letter beside a number is none: l1 may be a vertebra."""
    words = [word for word in _OPPOSITE if len(word) > 1]
    lower, title, upper = ("|".join(map(case, words)) for case in (str.lower, str.title, str.upper))
    return re.compile(
        f"^(?:{title})"
        f"|(?<![A-Za-z])(?:{upper})(?![A-Za-z])"
        f"|(?<![A-Za-z])(?:{lower}|{title})(?![a-z])"
        f"|(?<=[a-z0-9])(?:{title})(?![a-z])"
        "|(?<![A-Za-z0-9])[lrLR](?![A-Za-z0-9])"
        "|(?<![A-Za-z0-9])[lrLR](?=[A-Z][a-z])"
        "|(?<=[a-z])[LR](?=[A-Z][a-z]|[^A-Za-z0-9]|$)"
    )


SIDE_WORD = _side_pattern()

PLACES = {"left_fore": "LF", "right_fore": "RF", "left_hind": "LH", "right_hind": "RH"}
"""Where a foot of a whole animal is, and its label."""
_LABELLED: dict[str, Side] = {"L": "left", "R": "right"}
CHAIN_PLACES = {"fore": "F", "hind": "H"}
"""The same of a chain, which stands for either side: the label gets that of the fit in front of it."""


def foot_table(places: Iterable[str], example: str) -> BeforeValidator:
    """One message for whatever else stands there, and for nothing."""

    def checked(value: Any) -> Any:
        if isinstance(value, dict) and {*value} <= {*places} and all(isinstance(foot, str) for foot in value.values()):
            return value
        raise ValueError(f"a table that says where each foot is, as {example}")

    return BeforeValidator(checked)


def foot_problems(feet: dict[str, str], source: str) -> Iterator[Problem]:
    for place, foot in feet.items():
        side = side_of(foot)
        if side is not None and place in PLACES and not place.startswith(side):
            yield Problem(source, f"feet.{place}", repr(foot), f"a {place.split('_')[0]} one: by its name it is {side}")
    if len({*feet.values()}) < len(feet):
        yield Problem(source, "feet", ", ".join(feet.values()), "every foot once")


def side_of(name: str) -> Side | None:
    """None: the middle. Of several sides the first counts."""
    word = SIDE_WORD.search(name)
    return None if word is None else "left" if word[0].lower() in SIDES else "right"


def other_side(name: str) -> str:
    """l_paw -> r_paw and back; names of the middle stay."""
    word = SIDE_WORD.search(name)
    return name if word is None else name[: word.start()] + opposite_word(word[0]) + name[word.end() :]


def opposites(names: Sequence[str]) -> Index:
    """(N,): the place of each name's other side among the names; of the middle, and of what has none, its own."""
    at = {name: i for i, name in enumerate(names)}
    return np.array([at.get(other_side(name), i) for name, i in at.items()], dtype=np.intp)


def opposite_word(word: str) -> str:
    """The word of the other side, in the same case."""
    other = _OPPOSITE[word.lower()]
    return other.upper() if word.isupper() else other.title() if word.istitle() else other


def common_side(sides: Iterable[Side | None]) -> Side | None:
    """The side that all these sides agree on: None where there are several, or all are in the middle."""
    found: set[Side] = {side for side in sides if side is not None}
    return found.pop() if len(found) == 1 else None


@dataclass(frozen=True)
class Skeleton:
    """What a skeleton's file describes in a form of its own, which a body is made from (`recon.animal.chain`)."""

    name: str
    title: str


@dataclass(frozen=True, repr=False)
class Body(Brief):
    """A tree with J markers and D unknowns per frame, and the expectations of them."""

    name: str
    title: str
    tree: Tree
    keypoints: tuple[tuple[str, str], ...]
    """(J,): of each marker the keypoint's name when limbs of the left, and of the right are fitted."""
    limbs: dict[str, tuple[str, ...]]
    """Marker names along each limb, for drawing."""
    forward: tuple[str, str]
    """Two markers, from rear to front."""
    feet: tuple[str, ...]
    """The markers that touch the ground."""
    foot_labels: tuple[str, ...]
    """Where the feet are, of `PLACES`, or of a chain `CHAIN_PLACES`."""
    keypoint_sigma_m: float
    """How far keypoints lie from the markers."""
    size_sigma: float
    """The standard deviation of the size, the factor on all lengths, around 1."""
    mean_rad: Array
    """(D - 4,): expected angles state[:, 4:], that is the root's pitch and roll and the joints' angles."""
    sigma_rad: Array
    """(D - 4,): one standard deviation of them."""
    acceleration_rad_s2: Array
    """(D - 4,): one standard deviation of their acceleration."""
    keypoint_offset_m: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """How far a detector's keypoint lies from a marker, (x, y, z) in the marker's segment, by marker."""
    keypoint_spread_m: dict[str, float] = field(default_factory=dict)
    """How far off that it lies in one clip, along each axis and all the time."""
    keypoint_noise_m: dict[str, float] = field(default_factory=dict)
    """How far off in a single frame, of markers of which it is known; of others it is keypoint_sigma_m."""
    detector: str | None = None
    """Whose keypoints are expected (`recon.animal.skeleton_file`)."""
    mass: dict[str, tuple[float, float]] = field(default_factory=dict)
    """By segment: its share of the body's mass, and one standard deviation; empty where it is not known."""
    mass_source: str | None = None
    """What the masses rest on."""
    subject: str | None = None
    """The measured animal whose lengths these are, as it was named; None: those of the skeleton."""

    def scaled(self, size: float) -> Body:
        """The body of an animal with the same proportions that is so many times as large."""

        def times(lengths_m: dict[str, float]) -> dict[str, float]:
            return {name: size * length_m for name, length_m in lengths_m.items()}

        return replace(
            self,
            title=f"{self.title}, {size:g} times as large",
            tree=self.tree.scaled(size),
            keypoint_sigma_m=size * self.keypoint_sigma_m,
            keypoint_offset_m={
                name: (size * x, size * y, size * z) for name, (x, y, z) in self.keypoint_offset_m.items()
            },
            keypoint_spread_m=times(self.keypoint_spread_m),
            keypoint_noise_m=times(self.keypoint_noise_m),
        )

    @cached_property
    def detected(self) -> Tree:
        """The tree with its markers where a detector sees them."""
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
    def markers(self) -> tuple[str, ...]:
        """The names of the J markers, in the order of all arrays of joints."""
        return tuple(m.name for m in self.tree.markers)

    @cached_property
    def one_sided(self) -> bool:
        """A chain, which stands for the limbs of either side; otherwise a whole animal."""
        return any(left != right for left, right in self.keypoints)

    def keypoint_names(self, side: Side | None) -> tuple[str, ...]:
        """(J,): of the markers, when the limbs of that side are fitted. None: of a whole animal."""
        return tuple(right if side == "right" else left for left, right in self.keypoints)

    def feet_by_label(self, side: Side | None = None) -> dict[str, str]:
        """Markers of the feet by LF, RF, LH, RH. side: the fitted one, of a chain."""
        start = "" if side is None else side[0].upper()
        labels = (label if label in PLACES.values() else start + label for label in self.foot_labels)
        return dict(zip(labels, self.feet, strict=True))

    def side_of(self, marker: str) -> Side | None:
        """By what is said of it as a foot, or else by its name."""
        label = dict(zip(self.feet, self.foot_labels, strict=True)).get(marker, "")
        return _LABELLED[label[0]] if label in PLACES.values() else side_of(marker)

    def limb_sides(self, side: Side | None = None) -> dict[str, Side | None]:
        """The side of each limb; None: the middle, or both. side: the fitted one, of a chain."""
        of_either = {m for m, (left, right) in zip(self.markers, self.keypoints, strict=True) if left != right}
        return {
            limb: common_side(side if marker in of_either else self.side_of(marker) for marker in along)
            for limb, along in self.limbs.items()
        }

    @cached_property
    def limb_rows(self) -> dict[str, tuple[int, ...]]:
        """Markers along each limb by their places, for drawing."""
        at = {marker: j for j, marker in enumerate(self.markers)}
        return {limb: tuple(at[marker] for marker in along) for limb, along in self.limbs.items()}

    @property
    def n_state(self) -> int:
        """D: how many unknowns a frame has."""
        return self.tree.n_state

    @property
    def state_names(self) -> tuple[str, ...]:
        """(D,): of the unknowns, the root's position and heading first."""
        return self.tree.state_names

    def expected_points_m(self, angle: int | None = None, off_rad: float = 0.0) -> Array:
        """(J, 3): the markers with all angles at their means, but for one of state[4:]; the root's origin is zero."""
        state = np.concatenate([np.zeros(4), self.mean_rad])
        if angle is not None:
            state[4 + angle] += off_rad
        return self.tree.pose(state[None]).points_m[0]

    @cached_property
    def mirror(self) -> tuple[Index, Array]:
        """Permutation and sign, (D,): state[..., permutation] * sign is the animal mirrored at the x-z plane."""
        flips = np.array([False, True, False, *(axis != "y" for axis in self.tree.axes)])
        return opposites(self.state_names), np.where(flips, -1.0, 1.0)
