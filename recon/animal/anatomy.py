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
"""Names allowed in `[anatomy]`, each with the joint's direction of flexion.

At 1, flexion turns the lower bone backwards, or the front of the trunk and the head downwards. At -1, flexion turns the
lower bone forwards.
"""
GIRDLE: Mapping[str, Literal["F", "H"] | None] = {
    **dict.fromkeys(("shoulder", "elbow", "carpus", "fetlock"), "F"),
    **dict.fromkeys(("hip", "stifle", "hock", "hind_fetlock"), "H"),
    **dict.fromkeys(("spine", "neck")),
}
"""Fore or hind limb of each joint; None for the trunk."""


def joints_of_both_sides(table: Mapping[str, tuple[str, str, str]]) -> dict[str, tuple[str, str, str]]:
    """Return the joints of `[anatomy]` by name and side, such as left_elbow, including those of the right side."""
    joints: dict[str, tuple[str, str, str]] = {}
    for joint, markers in table.items():
        side = next((side for marker in reversed(markers) if (side := side_of(marker)) is not None), None)
        joints[joint if side is None else f"{side}_{joint}"] = markers
        if side == "left":
            first, middle, last = (other_side(marker) if side_of(marker) == "left" else marker for marker in markers)
            joints[f"right_{joint}"] = (first, middle, last)
    return joints


def joint_and_side(name: str) -> tuple[str, Side | None]:
    """Return joint and side of a name such as left_elbow; the side is None on the midline and in a chain."""
    side, _, joint = name.partition("_")
    if side == "left" or side == "right":
        return joint, side
    return name, None


def anatomy_problems(table: Mapping[str, tuple[str, str, str]], source: str) -> Iterator[Problem]:
    """Yield the problems with `[anatomy]`: unknown joints, and joints whose markers are not all different."""
    for joint, markers in table.items():
        if joint not in FLEXES_CAUDALLY:
            yield Problem(source, f"anatomy.{joint}", "no joint with this name", f"one of {', '.join(FLEXES_CAUDALLY)}")
        if len({*markers}) < 3:
            expected = "three markers: one above the joint, the joint, one below it"
            yield Problem(source, f"anatomy.{joint}", ", ".join(markers), expected)
