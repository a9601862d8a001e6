"""Describe a skeleton: the content of its file, and remarks on unusual values."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from recon.animal.anatomy import joint_and_side
from recon.animal.body import MAX_ANIMAL_M, Body, other_side
from recon.animal.bones import bones_of
from recon.animal.chain import load_chain
from recon.animal.prior import load_prior
from recon.animal.skeleton_file import load_skeleton
from recon.base.numbers import rough_length
from recon.fit.body_shape import LENGTH_SIGMA
from recon.geometry.kinematics import ANGLE_OF_AXIS, AXES
from recon.show.plain import picked

REACH_SIGMAS = 2.0
"""Half-width of the expected range of an angle, in standard deviations."""


def check_skeleton(name_or_path: str | Path, subject: str | Path | None = None) -> dict[str, Any]:
    """Return a description of a skeleton's file.

    `length_m` and `height_m` belong to the expected pose. `unknowns` is the number of unknowns per frame (for a chain,
    in `recon frame` and with the base length). `prior` is the default prior of a fit, and `remarks` name values that
    are allowed but probably wrong.

    Raises
    ------
    InputError
        If the file does not describe a skeleton. The message names every problem.
    """
    body = load_skeleton(name_or_path, subject)
    length, _, height = np.ptp(body.expected_points_m(), axis=0).tolist()
    return {
        **picked(body, "name", "title", "size_sigma", "keypoint_sigma_m", "limbs"),
        "kind": "chain" if body.one_sided else "whole animal",
        "unknowns": body.n_state,
        "length_m": length,
        "height_m": height,
        "prior": load_prior(None, body).name,
        "feet": body.feet_by_label(),
        "remarks": [*_remarks(body)],
        "bones": [*_bones(body)],
        "joint_angles": [*_joint_angles(body)],
        "parts": [*_segments(body)],
        **_published(name_or_path, body),
        "markers": [{"name": m.name, "segment": m.segment, "at_m": m.offset_m} for m in body.tree.markers],
    }


def _published(name_or_path: str | Path, body: Body) -> dict[str, Any]:
    """Return the links of a chain with their ratios to the base length, and the unknowns of the frame method."""
    if not body.one_sided:
        return {}
    chain = load_chain(name_or_path)
    links = [
        {"name": link.name, "from": link.start, "to": link.end, "length_ratio": link.length_ratio}
        for link in chain.links
    ]
    names = chain.unknown_names
    return {
        "unknowns": len(names),
        "unknown_names": names,
        "base_length_m": chain.nominal_base_length_m,
        "links": links,
    }


def _bones(body: Body) -> Iterator[dict[str, Any]]:
    """Yield the bones with the points that they connect, lengths, and the standard deviations that a fit expects."""
    for bone in bones_of(body):
        sigma_m = bone.length_m * float(np.hypot(body.size_sigma, LENGTH_SIGMA))
        yield {"bone": bone.name, "connects": list(bone.connects), "length_m": bone.length_m, "sigma_m": sigma_m}


def _joint_angles(body: Body) -> Iterator[dict[str, Any]]:
    """Yield the joint angles of an analysis on the left side and in the middle, each with its three markers."""
    for name, markers in body.anatomy.items():
        joint, side = joint_and_side(name)
        if side != "right":
            yield {"joint": joint, "markers": list(markers)}


def _segments(body: Body) -> Iterator[dict[str, Any]]:
    """Yield each segment with the expected mean, range and acceleration of its angles."""
    expected = zip(*np.rad2deg([body.mean_rad, body.sigma_rad, body.acceleration_rad_s2]), strict=True)
    for segment in body.tree.segments:
        angles = []
        for axis in AXES[segment.joint][segment.parent is None :]:  # all angles except the heading of the root
            mean, sigma, acceleration = map(float, next(expected))
            reach = REACH_SIGMAS * sigma
            ranges = {"name": ANGLE_OF_AXIS[axis], "mean_deg": mean, "low_deg": mean - reach, "high_deg": mean + reach}
            angles.append(ranges | {"rate": f"{acceleration:.0f} °/s²"})
        yield {
            "name": segment.name,
            "parent": segment.parent or "",
            "joint": segment.joint,
            "length_m": float(np.linalg.norm(segment.offset_m)),
            "angles": angles,
            "points": [m.name for m in body.tree.markers if m.segment == segment.name],
        }


def _remarks(body: Body) -> Iterator[str]:
    point_m = dict(zip(body.markers, body.expected_points_m(), strict=True))
    rear, front = (point_m[marker] for marker in body.forward)
    if (length_m := float(np.ptp([*point_m.values()], axis=0).max())) > MAX_ANIMAL_M:
        yield f"lengths: the animal is {rough_length(length_m)} long. Lengths are metres, not mm or cm."
    if front[0] <= rear[0]:
        yield f"forward: in the expected pose {body.forward[1]} is not ahead (x) of {body.forward[0]}."
    yield from feet_remarks(body)
    sides = {marker: side for marker in body.markers if (side := body.side_of(marker)) is not None}
    if wrong_side := [m for m, side in sides.items() if (point_m[m][1] < 0 if side == "left" else point_m[m][1] > 0)]:
        yield f"markers: on the wrong side of the middle (y points to the left): {', '.join(wrong_side)}."
    pairs = [(m, other_side(m)) for m, side in sides.items() if side == "left" and other_side(m) in point_m]
    if uneven := [m for m, twin in pairs if not np.allclose(point_m[m], point_m[twin] * (1, -1, 1), atol=1e-6)]:
        yield f"markers: not the mirror images of those on the other side: {', '.join(uneven)}."


def feet_remarks(body: Body) -> Iterator[str]:
    """Yield remarks on missing feet of a skeleton, and on unusual positions of its feet in the expected pose."""
    point_m = dict(zip(body.markers, body.expected_points_m(), strict=True))
    rear, front = (point_m[marker] for marker in body.forward)
    if not body.feet:
        yield "feet: none. Contacts with the ground and gait need them."
    heights_m = {foot: point_m[foot][2] for foot in body.feet}
    if too_high := [foot for foot, height_m in heights_m.items() if height_m >= min(rear[2], front[2])]:
        yield f"feet: not below {' and '.join(body.forward)} in the expected pose: {', '.join(too_high)}."
    segment_of = {marker.name: marker.segment for marker in body.tree.markers}
    for segment in dict.fromkeys(segment_of[foot] for foot in body.feet):
        if len(feet := [foot for foot in body.feet if segment_of[foot] == segment]) > 1:
            yield (
                f"feet: {', '.join(feet[:-1])} and {feet[-1]} are on one segment, {segment}, and cannot move relative "
                "to each other. Draft the skeleton from a clip in which the animal walks."
            )
    for label, foot in body.feet_by_label().items():
        is_ahead = (point_m[foot] - (rear + front) / 2) @ (front - rear) > 0
        if is_ahead != (label[-1] == "F"):
            position, kind = ("ahead of", "hind") if is_ahead else ("behind", "fore")
            yield f"feet: in the expected pose {foot} lies {position} the middle of the trunk, but is a {kind} foot."
