"""Name the joints of an animal, and state the markers and the direction of flexion of each joint."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches
from typing import Literal

import numpy as np

from recon.animal.body import SIDE_WORD, Side, other_side, side_of
from recon.base.arrays import Array
from recon.base.errors import Problem

FLEXES_CAUDALLY: Mapping[str, int] = {
    "shoulder": 1,
    "elbow": -1,
    "carpus": 1,
    "fetlock": 1,
    "hip": -1,
    "stifle": 1,
    "hock": -1,
    "hind_fetlock": 1,
    "spine": 1,
    "neck": 1,
}
"""Names of joints allowed in the table `[anatomy]` of a skeleton file, each with the joint's direction of flexion.

If the direction is 1, flexion turns the lower bone backwards, or the front of the trunk and the head downwards. If the
direction is -1, flexion turns the lower bone forwards.
"""
GIRDLE: Mapping[str, Literal["F", "H"] | None] = {
    **dict.fromkeys(("shoulder", "elbow", "carpus", "fetlock"), "F"),
    **dict.fromkeys(("hip", "stifle", "hock", "hind_fetlock"), "H"),
    **dict.fromkeys(("spine", "neck")),
}
"""Limb of each anatomical joint, F for fore and H for hind; None for joints of the trunk."""
COMMON_NAMES: Mapping[str, str] = {"ankle": "hock", "knee": "stifle", "tarsus": "hock", "wrist": "carpus"}
"""Other names of joints, each with the name in `FLEXES_CAUDALLY`.

They are only suggested, because a name may mean two joints: the knee of a horse's fore limb is the carpus.
"""


def sagittal_angle(proximal: Array, distal: Array, left: Array) -> Array:
    """Return the angle from the proximal to the distal link in the sagittal plane, shape (T,), rad.

    The links and the unit vector to the left, about which the angle is positive, have the shape (T, 3).
    """
    sine = np.sum(np.cross(proximal, distal) * left, axis=1)
    across = np.sum(proximal * left, axis=1) * np.sum(distal * left, axis=1)
    return np.arctan2(sine, np.sum(proximal * distal, axis=1) - across)


def joints_of_both_sides(table: Mapping[str, tuple[str, str, str]]) -> dict[str, tuple[str, str, str]]:
    """Return the joints of a table `[anatomy]`, which lists only left and midline joints, with right joints added.

    The names in the result include the side, such as left_elbow. The values are the joints' three markers.
    """
    joints: dict[str, tuple[str, str, str]] = {}
    for joint, markers in table.items():
        side = next((side for marker in reversed(markers) if (side := side_of(marker)) is not None), None)
        joints[joint if side is None else f"{side}_{joint}"] = markers
        if side == "left":
            first, middle, last = (other_side(marker) if side_of(marker) == "left" else marker for marker in markers)
            joints[f"right_{joint}"] = (first, middle, last)
    return joints


def joint_and_side(name: str) -> tuple[str, Side | None]:
    """Split a name such as left_elbow into joint and side, which is None for a name without a side."""
    side, _, joint = name.partition("_")
    if side == "left" or side == "right":
        return joint, side
    return name, None


def joints_named(name: str, joints: Sequence[str]) -> tuple[str, ...]:
    """Return those of an animal's anatomical joints that a name denotes, empty for an unknown name.

    A name without a side denotes the joints of both sides. Any case, spaces instead of underscores, and "flexion" at
    the end are accepted, as in "left elbow flexion".
    """
    plain = "_".join(_words(name)).removesuffix("_flexion")
    return tuple(joint for joint in joints if plain in (joint, joint_and_side(joint)[0]))


def suggested_joint(name: str, anatomy: Mapping[str, tuple[str, str, str]]) -> str | None:
    """Return the anatomical joint that an unknown name probably means, or None.

    The joint has the marker `name` at its middle, has `name` as a common name (`COMMON_NAMES`), or has a similar name.
    """
    side, words = side_of(name), _words(SIDE_WORD.sub("", name))
    names = [*dict.fromkeys(joint_and_side(joint)[0] for joint in anatomy)]
    at_marker = (
        joint_and_side(joint)[0]
        for joint, (_, middle, _) in anatomy.items()
        if words == _words(SIDE_WORD.sub("", middle))
    )
    joint = next(at_marker, None)
    for word in words:
        joint = joint or COMMON_NAMES.get(word) or next(iter(get_close_matches(word, names, 1, 0.75)), None)
    if joint not in names:
        return None
    return f"{side}_{joint}" if f"{side}_{joint}" in anatomy else joint


def _words(name: str) -> list[str]:
    return re.findall(r"[^\s_-]+", name.lower())


def anatomy_problems(table: Mapping[str, tuple[str, str, str]], source: str) -> Iterator[Problem]:
    """Yield a problem for each joint of a table `[anatomy]` that is unknown or whose markers are not all different."""
    for joint, markers in table.items():
        if joint not in FLEXES_CAUDALLY:
            yield Problem(source, f"anatomy.{joint}", "no joint with this name", f"one of {', '.join(FLEXES_CAUDALLY)}")
        if len({*markers}) < 3:
            expected = "three different markers: above, at and below the joint"
            yield Problem(source, f"anatomy.{joint}", ", ".join(markers), expected)
