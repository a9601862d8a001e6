"""Name the bones of an animal and the joints that they connect, from the skeleton's `[anatomy]`.

A bone connects two joints of a limb or of the trunk. Its length is the length of offsets in the skeleton file, from a
parent to its segment or from a segment to its marker.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from recon.animal.anatomy import joint_and_side
from recon.animal.body import Body, Side

NAMES: dict[tuple[str, str], str] = {
    ("shoulder", "elbow"): "upper arm",
    ("elbow", "carpus"): "forearm",
    ("carpus", "fetlock"): "metacarpus",
    ("carpus", "foot"): "forefoot",
    ("fetlock", "foot"): "front digit",
    ("hip", "stifle"): "thigh",
    ("stifle", "hock"): "shank",
    ("hock", "hind fetlock"): "metatarsus",
    ("hock", "foot"): "hind foot",
    ("hind fetlock", "foot"): "hind digit",
    ("tail base", "spine"): "rear trunk",
    ("spine", "neck base"): "front trunk",
    ("neck base", "nose"): "head and neck",
}
"""Name of each bone, with the two joints that it connects as the key, from the trunk outwards."""
CHAINS = (("shoulder", "elbow", "carpus", "fetlock"), ("hip", "stifle", "hock", "hind_fetlock"))
"""Joints of the fore and the hind limb, from the trunk outwards."""


@dataclass(frozen=True)
class Bone:
    """A bone, or several bones that form a line, such as the trunk."""

    name: str
    """Anatomical name, such as upper arm."""
    connects: tuple[str, str]
    """Joints at both ends, such as shoulder and elbow."""
    offsets: tuple[str, ...]
    """Names of the segments or markers whose offsets add up to the bone."""
    length_m: float
    side: Side | None = None

    @property
    def title(self) -> str:
        """Return the bone's name with its joints, such as "upper arm, shoulder to elbow"."""
        return f"{self.name}, {self.connects[0]} to {self.connects[1]}"


def bones_of(body: Body) -> tuple[Bone, ...]:
    """Return the bones of the trunk and the left limbs, or of a one-sided body's limbs; empty without `[anatomy]`."""
    bones = [*_trunk(body), *_limbs(body)]
    return tuple(bone for bone in bones if bone.length_m > 0)


def _limbs(body: Body) -> Iterator[Bone]:
    by_joint = {}
    for name, markers in body.anatomy.items():
        joint, side = joint_and_side(name)
        if side != "right":
            by_joint[joint] = (markers, side)
    trunk = {body.tree.segments[0].name, *(_segment_of(body, end) for end in body.forward)}
    for chain in CHAINS:
        joints = [joint for joint in chain if joint in by_joint]
        for joint, following in zip(joints, [*joints[1:], "foot"], strict=False):
            (_, _, below), side = by_joint[joint]
            connects = (joint.replace("_", " "), following.replace("_", " "))
            if connects in NAMES and _segment_of(body, below) not in trunk:
                yield _bone(body, connects, below, side)


def _trunk(body: Body) -> Iterator[Bone]:
    """Yield the bones of the trunk (its rear and front part, and the whole trunk), and the neck or head."""
    if "spine" in body.anatomy:
        rear, _, front = body.anatomy["spine"]
        parts = _bone(body, ("tail base", "spine"), rear, None), _bone(body, ("spine", "neck base"), front, None)
        yield from parts
        if all(part.length_m > 0 for part in parts):
            offsets = (*parts[0].offsets, *parts[1].offsets)
            yield Bone("trunk", ("tail base", "neck base"), offsets, parts[0].length_m + parts[1].length_m)
    if "neck" in body.anatomy:
        _, base, tip = body.anatomy["neck"]
        begin, end = _segment_at_origin(body, base), _segment_of(body, tip)
        parents = {segment.name: segment.parent for segment in body.tree.segments}
        if begin == end:
            yield _bone(body, ("neck base", "nose"), tip, None)
        elif begin is not None and parents[end] == begin:
            lengths = {segment.name: float(np.linalg.norm(segment.offset_m)) for segment in body.tree.segments}
            yield Bone("neck", ("neck base", "head"), (end,), lengths[end])


def _bone(body: Body, connects: tuple[str, str], marker: str, side: Side | None) -> Bone:
    """Return the bone that ends at a marker, or at the origin of the marker's segment if the two coincide."""
    offsets = {item.name: np.array(item.offset_m) for item in (*body.tree.segments, *body.tree.markers)}
    name = marker
    if not offsets[marker].any():
        name = _segment_of(body, marker)
    length_m = float(np.linalg.norm(offsets[name]))
    return Bone(NAMES[connects], connects, (name,), length_m, side)


def _segment_of(body: Body, marker: str) -> str:
    return next(item.segment for item in body.tree.markers if item.name == marker)


def _segment_at_origin(body: Body, marker: str) -> str | None:
    item = next(item for item in body.tree.markers if item.name == marker)
    return None if any(item.offset_m) else item.segment
