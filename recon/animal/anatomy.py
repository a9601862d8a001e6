"""Name the joints of an animal, and state the markers and the direction of flexion of each joint."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

from recon.animal.body import Side, other_side, side_of
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


def anatomy_problems(table: Mapping[str, tuple[str, str, str]], source: str) -> Iterator[Problem]:
    """Yield a problem for each joint of a table `[anatomy]` that is unknown or whose markers are not all different."""
    for joint, markers in table.items():
        if joint not in FLEXES_CAUDALLY:
            yield Problem(source, f"anatomy.{joint}", "no joint with this name", f"one of {', '.join(FLEXES_CAUDALLY)}")
        if len({*markers}) < 3:
            expected = "three different markers: above, at and below the joint"
            yield Problem(source, f"anatomy.{joint}", ", ".join(markers), expected)
