"""Describe a chain of rigid links joined by universal joints, as in the published 8U chain, and read its files.

The chain starts at a root joint in the local frame UVW (U forwards along the first spine link, V down, W to the side,
right-handed). Every link has two angles relative to its parent, theta in the sagittal UV plane and phi in the
transverse UW plane, and no twist. Along a path from the root, the angles add up to T (sum of theta) and P (sum of phi),
and a link of length r adds

    r (cos T cos P,  sin T,  cos T sin P)

to the position, so that the link keeps its length for any angles. `Chain.body` converts a chain to a tree of segments,
as for other animals. The published unknowns of a frame are in `recon.thesis.chain`.

Source: C. van der Leek, "Kinematic Modeling and Dynamic Aspects of an Accelerating Quadruped", MSc(Eng), University of
Cape Town, 2022, with the link direction corrected. The printed first component, sin T cos P, does not keep the length.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import BeforeValidator, Field

from recon.animal.anatomy import anatomy_problems
from recon.animal.body import CHAIN_FOOT_LABELS, MIN_JOINTS, Body, Side, Skeleton, foot_problems, foot_table
from recon.base import documents
from recon.base.arrays import Array, Index
from recon.base.documents import FileTable, Number, Sigma, unknown, validated
from recon.base.errors import InputError, Problem, raise_problems
from recon.base.numbers import counted, percent
from recon.geometry.kinematics import PITCH, ROLL, Joint, Marker, Segment, Tree

_SKELETONS = "animal/skeletons"
UVW_BODY = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Rotation (3, 3) from the body's axes (x forwards, y left, z up) to U (forwards), V (down), W (to the side)."""
_PITCH_RAD = 0.3
"""Standard deviation of the pitch of a running animal, rad."""
_ROOT_RAD_S2 = 40.0
"""Standard deviation of the pitch and roll acceleration of a running animal, rad/s^2."""


def _left_and_right(keypoint: object) -> object:
    """Return the names of the left and the right keypoint, given a table of both or a name for both sides."""
    if isinstance(keypoint, dict) and {*keypoint} == {"left", "right"}:
        return keypoint["left"], keypoint["right"]
    return (keypoint, keypoint) if isinstance(keypoint, str) else keypoint


_Sides = Annotated[tuple[str, str], BeforeValidator(_left_and_right)]


class _Range(FileTable):
    mean_rad: Number
    tolerance_rad: Sigma
    max_rate_rad_s: Sigma


class _Link(FileTable):
    """Rigid link of a chain."""

    name: str
    start: str = Field(alias="from")
    end: str = Field(alias="to")
    limb: str
    length_ratio: Sigma
    keypoint: _Sides
    theta: _Range | None = None
    phi: _Range | None = None

    @property
    def free(self) -> bool:
        """Return whether the link has angles, so that it need not be in line with its parent."""
        return self.theta is not None


class _BaseLength(FileTable):
    nominal_m: Sigma
    sigma_m: Sigma


class _Prior(FileTable):
    theta_sigma_rad: Sigma
    phi_sigma_rad: Sigma
    roll_sigma_rad: Sigma
    heading_sigma_rad_per_sqrt_s: Sigma
    travel_sigma_rad: Sigma


_ChainFeet = Annotated[dict[str, str], foot_table(CHAIN_FOOT_LABELS, '{ fore = "J4", hind = "J8" }, with its joints')]


class _ChainFile(FileTable):
    name: str
    title: str
    root: str
    root_keypoint: _Sides
    forward: tuple[str, str]
    feet: _ChainFeet = Field(default=None, validate_default=True)
    keypoint_sigma_m: Sigma
    base_length: _BaseLength
    softness_rad: Sigma
    prior: _Prior
    links: tuple[_Link, ...] = Field(min_length=1)
    anatomy: dict[str, tuple[str, str, str]] = Field(default_factory=dict)
    """Names of the chain's joints above, at and below each anatomical joint."""
    length_m: dict[str, Sigma] = Field(default_factory=dict)
    """Measured lengths of links, which replace the lengths computed from `ratio`."""


@dataclass(frozen=True)
class AngleRanges:
    """Expected ranges of theta or phi of the A free links, as arrays (A,) in the order of the state."""

    mean_rad: Array
    """Middle of the expected range, which is mean ± tolerance."""
    tolerance_rad: Array
    max_rate_rad_s: Array
    """Largest expected angular velocity, rad/s."""


@dataclass(frozen=True)
class Chain(Skeleton):
    """Chain of links with its keypoints and the expected ranges of its angles."""

    record_tag: ClassVar[str] = "chain"
    """Tag of the class in files of motions (`recon.fit.motion_forms.CLASSES`)."""

    file: _ChainFile
    """Content of the skeleton file."""
    nominal_base_length_m: float

    @cached_property
    def links(self) -> tuple[_Link, ...]:
        """Return the links of the skeleton file, with measured lengths where these are given."""
        nominal_m = self.file.base_length.nominal_m
        measured = {name: length_m / nominal_m for name, length_m in self.file.length_m.items()}
        return tuple(
            link.model_copy(update={"length_ratio": measured.get(link.name, link.length_ratio)})
            for link in self.file.links
        )

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Return the names of the joints, first the root, then the ends of the links in order."""
        return self.file.root, *(link.end for link in self.links)

    @cached_property
    def theta(self) -> AngleRanges:
        """Return the expected ranges of the free links' theta angles."""
        return _ranges(link.theta for link in self.links)

    @cached_property
    def phi(self) -> AngleRanges:
        """Return the expected ranges of the free links' phi angles."""
        return _ranges(link.phi for link in self.links)

    @cached_property
    def n_angles(self) -> int:
        """Return A, the number of links that have angles."""
        return sum(link.free for link in self.links)

    @cached_property
    def angle_names(self) -> tuple[str, ...]:
        """Return the names of the angles, such as theta_6 for the link that ends in J6."""
        ends = [link.end.lstrip("J") for link in self.links if link.free]
        return tuple(f"theta_{e}" for e in ends) + tuple(f"phi_{e}" for e in ends)

    @cached_property
    def unknown_names(self) -> tuple[str, ...]:
        """Return the published names of the 2 A + 7 unknowns of a frame, in order; 21 for the 8U chain."""
        angles = (name.replace("theta_", "th").replace("phi_", "ph") for name in self.angle_names)
        return (*angles, "x0", "y0", "z0", "xi", "psi", "zeta", "base_length")

    @cached_property
    def body(self) -> Body:
        """Return the chain as a tree of segments in metres, the root first.

        There is one segment for each link, named after the joint at its end. The x axes of the segments are along the
        links. The root has the axes x = U, y = W, z = -V, and its origin is the root joint. Every joint is a marker.
        Theta is pitch and phi is yaw, and both add up along the chain.
        """
        length = {link.end: link.length_ratio * self.nominal_base_length_m for link in self.links}
        segments = [Segment(self.joints[0], None, "free")]
        for link in self.links:
            joint: Joint = "summed" if link.free else "fixed"
            segments.append(Segment(link.end, link.start, joint, (length.get(link.start, 0.0), 0.0, 0.0)))
        markers = (Marker(self.joints[0], self.joints[0]), *(Marker(j, j, (length[j], 0.0, 0.0)) for j in length))
        tree = Tree(tuple(segments), markers)
        limbs: dict[str, tuple[str, ...]] = {}
        for link in self.links:
            limbs[link.limb] = (*limbs.get(link.limb, (link.start,)), link.end)

        ranges, prior = [self.theta, self.phi], self.file.prior
        expected = np.zeros((3, tree.n_state))
        expected[:, PITCH] = 0.0, _PITCH_RAD, _ROOT_RAD_S2
        expected[:, ROLL] = 0.0, prior.roll_sigma_rad, _ROOT_RAD_S2
        expected[0, self.body_angles] = np.concatenate([r.mean_rad for r in ranges])
        expected[1, self.body_angles] = np.repeat([prior.theta_sigma_rad, prior.phi_sigma_rad], self.n_angles)
        # A sinusoid that spans the expected range and just reaches the largest rate has the angular frequency w = rate
        # / tolerance. Its root mean square acceleration is 1 / sqrt(2) of its largest acceleration, w^2 tolerance.
        swing = [r.max_rate_rad_s**2 / r.tolerance_rad / np.sqrt(2) for r in ranges]
        expected[2, self.body_angles] = np.concatenate(swing)
        return Body(
            name=self.name,
            title=self.title,
            tree=tree,
            keypoints=(self.file.root_keypoint, *(link.keypoint for link in self.links)),
            limbs=limbs,
            anatomy=self.file.anatomy,
            forward=self.file.forward,
            feet=tuple(self.file.feet.values()),
            foot_labels=tuple(CHAIN_FOOT_LABELS[position] for position in self.file.feet),
            keypoint_sigma_m=self.file.keypoint_sigma_m,
            size_sigma=self.file.base_length.sigma_m / self.nominal_base_length_m,
            mean_rad=expected[0, 4:],
            sigma_rad=expected[1, 4:],
            acceleration_rad_s2=expected[2, 4:],
        )

    @cached_property
    def body_angles(self) -> Index:
        """Return the columns of the body's state that hold the angles of the A free links, shape (2 A,).

        The columns of theta, in the sagittal plane, come first, followed by those of phi, in the transverse plane.
        """
        # After the six unknowns of the root, every free link has its yaw and then its pitch.
        pitch = 7 + 2 * np.arange(self.n_angles)
        return np.concatenate([pitch, pitch - 1])


def upright_rotation(heading: Array, up: Array) -> Array:
    """Return the rotation from the local frame UVW of a level animal to the camera frame, shape (..., 3, 3).

    U points along `heading`, shape (..., 3) in the camera frame, and V points down.
    """
    down = np.broadcast_to(-up, heading.shape)
    return np.stack([heading, down, np.cross(heading, down)], axis=-1)


@cache  # cached because every built-in file is parsed
def builtin_chains() -> tuple[str, ...]:
    """Return the names of the built-in skeletons that are chains."""
    return tuple(name for name in documents.builtin_names(_SKELETONS, ".toml") if "segments" not in _read(name)[0])


def load_chain(name_or_path: str | Path) -> Chain:
    """Load a chain by the name of a built-in skeleton or from a skeleton file.

    Raises
    ------
    InputError
        If the file cannot be used, or describes a whole animal.
    """
    raw, source = _read(name_or_path, builtin_chains())
    if "segments" in raw:
        expected = f"a chain for the frame method: one of {', '.join(builtin_chains())}, or a file with [[links]]"
        raise InputError(Problem("--skeleton", "name or file", repr(str(name_or_path)), expected))
    return chain_of(raw, source)


def _read(name: str | Path, suggested: Iterable[str] | None = None) -> tuple[dict[str, Any], str]:
    return documents.named_table(name, _SKELETONS, "--skeleton", "skeleton", suggested)


def _extended(raw: dict[str, Any], source: str) -> dict[str, Any]:
    """Return the tables of a skeleton file, merged with the tables of the skeleton in its key `extends`."""
    if "extends" not in raw:
        return raw
    if not isinstance(name := raw["extends"], str):
        raise InputError(Problem(source, "extends", repr(name), "the name or the file of a skeleton"))
    parent, parent_source = _read(_file_or_builtin(name, source))
    if "segments" in parent or "extends" in parent:
        expected = "a chain that extends no other; a body's lengths belong in a subject file"
        raise InputError(Problem(source, "extends", parent_source, expected))
    return {**parent, **{key: value for key, value in raw.items() if key != "extends"}}


def _file_or_builtin(name: str, source: str) -> str:
    """Return the name of a built-in skeleton, or the path of a skeleton file, that the file `source` refers to.

    The skeleton file is in the folder of `source` or in the current folder.
    """
    file = Path(source).parent / name
    return str(file) if os.path.isfile(file) and name not in documents.builtin_names(_SKELETONS, ".toml") else name


def chain_of(raw: dict[str, Any], source: str) -> Chain:
    """Return the chain that the tables of a skeleton file describe.

    Raises
    ------
    InputError
        If the tables cannot be used. The error lists every problem.
    """
    file = validated(_ChainFile, _extended(raw, source), source)
    raise_problems(_chain_problems(file, source))
    return Chain(file.name, file.title, file, file.base_length.nominal_m)


def _chain_problems(file: _ChainFile, source: str) -> Iterator[Problem]:
    known = [file.root]
    for i, link in enumerate(file.links):
        if link.start not in known:
            yield Problem(source, f"links[{i}].from", repr(link.start), "the root or the `to` of an earlier link")
        if link.end in known:
            yield Problem(source, f"links[{i}].to", repr(link.end), "a joint that no earlier link ends in")
        if (link.theta is None) != (link.phi is None):
            yield Problem(source, f"links[{i}]", "only one of theta and phi", "both or neither")
        known.append(link.end)
    names = [link.name for link in file.links]
    yield from unknown(source, [(f"length_m.{name}", name) for name in file.length_m], sorted(names))
    if len(names) + 1 < MIN_JOINTS:
        yield Problem(
            source,
            "links",
            counted(len(names), "link"),
            f"at least {MIN_JOINTS - 1} links: fewer joints do not determine a pose",
        )
    if not any(link.theta is None and link.start == file.root for link in file.links):
        expected = f"one link from {file.root} without theta and phi: the body's forward axis is along it"
        yield Problem(source, "links", "no link from the root without angles", expected)
    ends = [*(("forward", joint) for joint in file.forward), *(("feet", joint) for joint in file.feet.values())]
    ends += [(f"anatomy.{name}", joint) for name, joints in file.anatomy.items() for joint in joints]
    yield from unknown(source, ends, sorted(known))
    yield from anatomy_problems(file.anatomy, source)
    yield from foot_problems(file.feet, source)


def _ranges(ranges: Iterable[_Range | None]) -> AngleRanges:
    rows = [(r.mean_rad, r.tolerance_rad, r.max_rate_rad_s) for r in ranges if r is not None]
    return AngleRanges(*np.array(rows, dtype=float).reshape(-1, 3).T)


def facing_side(rear_px: Array, front_px: Array) -> tuple[Side, str]:
    """Return the side of the animal that an upright camera sees, and the reason as text.

    An animal that faces the right edge of the picture shows its right side.

    Parameters
    ----------
    rear_px, front_px : ndarray
        Ends of the trunk, pixels, shape (T, 2); NaN if missing.
    """
    forward_px = (front_px - rear_px)[:, 0]
    forward_px = forward_px[np.isfinite(forward_px)]
    if len(forward_px) == 0:
        return "right", "no frame shows both ends of the trunk: the right side is assumed"
    side: Side = "right" if np.median(forward_px) > 0 else "left"
    agree = np.mean((forward_px > 0) == (side == "right"))
    return side, f"the animal faces the {side} of the picture in {percent(agree)} of {len(forward_px)} frames"
