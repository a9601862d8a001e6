"""Build chains from the root of a skeleton to a foot, and compute their joint angles from a reconstruction.

Every chain starts at the root, in a level base frame. The base frame of planar chains and of the spine-front-leg chain
of the 8U skeleton has the axes U along the direction of travel, V down and W to the left. In a planar chain, x is U and
y is V. The chains of whole animals have x along the direction of travel, y left and z up, as in
`recon.geometry.kinematics`.

In the 8U skeleton, the first link of the spine lies along U and has no angles. In the chains built here, this link has
two angles, which follow from the rotation of the skeleton.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from recon.animal.body import Body
from recon.animal.chain import UVW_BODY, Chain, upright_rotation
from recon.base.arrays import Array
from recon.geometry.kinematics import PITCH, ROOT, YAW, Tree
from recon.ik.chain import FREE, MAX_RATE_RAD_S, SerialChain, planar_chain, summed_chain, values_by_joint

BASE_THETA_RAD = 0.9
"""Limit on the pitch of the first link, rad: three standard deviations of the pitch of a running animal's trunk."""
LIMIT_SIGMAS = 3.0
"""Distance of the limits on a whole animal's angles from the expected means, in standard deviations."""
_TRAVEL_M = 0.1
"""Minimum distance between the root's first and last positions that defines a direction of travel, metres."""
_UP = np.array([0.0, 0.0, 1.0])


def spine_front_leg(
    chain: Chain, base_length_m: float | None = None, dim: Literal[2, 3] = 3, limited: bool = True
) -> SerialChain:
    """Return the chain r5, r1, r2, r3, r4 of the 8U skeleton, from the root to the front foot, in a level base frame.

    The joints are named as in the thesis of C. van der Leek (2022), after the joint at the end of each link: theta_9
    for the first link, then theta_1 to theta_4, and the phis likewise. The skeleton itself has no theta_9 and phi_9.
    theta_9 is the pitch `J0_pitch` of the skeleton's root, and phi_9 is the root's yaw `J0_yaw` relative to the
    direction of travel.

    Parameters
    ----------
    chain
        The 8U skeleton.
    base_length_m
        The base length, metres; None for the nominal one.
    dim
        3 for thetas and phis, 2 for thetas alone.
    limited
        Whether the joints have limits: the expected ranges of the skeleton, and for the first link `BASE_THETA_RAD` and
        three standard deviations of the heading about the direction of travel. Rate limits always apply. The first link
        has the rate limits of the second.
    """
    links = _path(chain)
    base = chain.nominal_base_length_m if base_length_m is None else base_length_m
    lengths = [chain.links[i].length_ratio * base for i in links]
    free = _angle_index(chain, links)
    lower, upper, rate = [], [], []
    for ranges, base_limit in ((chain.theta, BASE_THETA_RAD), (chain.phi, 3 * chain.file.prior.travel_sigma_rad)):
        rates = [float(ranges.max_rate_rad_s[k]) for k in free if k is not None]
        for k in free:
            lower.append(-base_limit if k is None else ranges.mean_rad[k] - ranges.tolerance_rad[k])
            upper.append(base_limit if k is None else ranges.mean_rad[k] + ranges.tolerance_rad[k])
            rate.append(rates[0] if k is None else ranges.max_rate_rad_s[k])
    kind = planar_chain if dim == 2 else summed_chain
    n = len(links) * (dim - 1)
    numbers = [chain.links[i].end.lstrip("J") for i in links]
    names = tuple(f"{angle}_{number}" for angle in ("theta", "phi")[: dim - 1] for number in numbers)
    return replace(kind(lengths, (lower[:n], upper[:n]) if limited else FREE, rate[:n]), names=names)


def chain_angles(chain: Chain, states: Array, travel: Array | None = None, dim: Literal[2, 3] = 3) -> Array:
    """Return the joint angles (T, n) of `spine_front_leg` in its level base frame.

    In three dimensions, all links keep their directions exactly. Two pairs of angles give the same direction, and the
    pair closer to the angles of the chain without roll is taken. In two dimensions, the angles are the thetas after the
    chain has been turned into the sagittal plane.

    Parameters
    ----------
    chain
        The 8U skeleton.
    states
        The states (T, D) of the skeleton's body.
    travel
        The direction of travel, (3,) or (T, 3), whose horizontal part is used; None for `body_travel`.
    dim
        3 for thetas and phis, 2 for thetas alone.
    """
    R = chain.body.tree.orientations(states)[:, 0] @ UVW_BODY.T
    heading = (body_travel(states) if travel is None else np.asarray(travel, float)) * (1.0, 1.0, 0.0)
    heading = np.broadcast_to(heading / np.linalg.norm(heading, axis=-1, keepdims=True), (len(states), 3))
    R_base_local = upright_rotation(heading, _UP).transpose(0, 2, 1) @ R

    free = _angle_index(chain, _path(chain))
    zero, angles = np.zeros(len(states)), states[:, chain.body_angles]
    theta, phi = (
        np.cumsum([zero if k is None else kind_angles[:, k] for k in free], axis=0).T
        for kind_angles in np.split(angles, 2, axis=1)
    )
    local = np.stack([np.cos(theta) * np.cos(phi), np.sin(theta), np.cos(theta) * np.sin(phi)], axis=-1)
    U = R_base_local[:, None, :, 0]
    T, P = _angles_near(
        local @ R_base_local.transpose(0, 2, 1),
        theta + np.arcsin(np.clip(U[..., 1], -1, 1)),
        phi + np.arctan2(U[..., 2], U[..., 0]),
    )
    joints = [np.diff(sums, axis=1, prepend=0.0) for sums in (T, P)]
    return joints[0] if dim == 2 else np.concatenate(joints, axis=1)


def _angles_near(directions: Array, theta: Array, phi: Array) -> tuple[Array, Array]:
    """Return the angles of unit vectors (T, L, 3) that are nearest to the given theta and phi (T, L), rad."""
    T = np.arcsin(np.clip(directions[..., 1], -1, 1))
    P = np.arctan2(directions[..., 2], directions[..., 0])
    pairs = [
        (theta + np.angle(np.exp(1j * (t - theta))), phi + np.angle(np.exp(1j * (p - phi))))
        for t, p in ((T, P), (np.pi - T, P + np.pi))
    ]
    # A change of phi turns the link by cos(theta) times the change, so weight it by cos(theta).
    distances = [(t - theta) ** 2 + (np.cos(t) * (p - phi)) ** 2 for t, p in pairs]
    first = distances[0] <= distances[1]
    return np.where(first, pairs[0][0], pairs[1][0]), np.where(first, pairs[0][1], pairs[1][1])


def _path(chain: Chain) -> list[int]:
    """Return the indices of the links from the root to the fore foot."""
    joint = chain.body.feet_by_label().get("F")
    if joint is None:
        raise ValueError(f"{chain.name} has no fore foot")
    into = {link.end: i for i, link in enumerate(chain.links)}
    links = []
    while joint in into:
        links.insert(0, into[joint])
        joint = chain.links[links[0]].start
    return links


def _angle_index(chain: Chain, links: list[int]) -> list[int | None]:
    """Return the index of each link's theta among all thetas, or None for a link without angles."""
    free = [i for i, link in enumerate(chain.links) if link.free]
    return [free.index(i) if i in free else None for i in links]


def body_chain(body: Body, foot: str, size: float = 1.0, limited: bool = True) -> SerialChain:
    """Return the chain from the origin of the root segment to a marker, with joints named as in the body's state.

    The first joints are the root's yaw relative to the direction of travel, its pitch and its roll.

    Parameters
    ----------
    body
        A whole animal.
    foot
        The marker at the chain's end.
    size
        Factor by which all lengths are scaled.
    limited
        Whether the angles have limits: the expected mean ± `LIMIT_SIGMAS` standard deviations, and ± half a turn for
        the yaw. Rate limits always apply.

    Raises
    ------
    ValueError
        If the body does not have the marker, or if angles along the chain add up (see `summed_chain`).
    """
    marker = next((m for m in body.tree.markers if m.name == foot), None)
    if marker is None:
        raise ValueError(f"{body.name} has no marker {foot}, only {', '.join(body.markers)}")
    by_name = {segment.name: segment for segment in body.tree.segments}
    branch = [by_name[marker.segment]]
    while branch[0].parent is not None:
        branch.insert(0, by_name[branch[0].parent])
    if summed := [segment.name for segment in branch if segment.joint == "summed"]:
        raise ValueError(f"{body.name}: the angles of {summed[0]} add up along the chain; use `summed_chain`")
    tree = Tree(tuple(branch), (marker,)).scaled(size)
    names = tree.state_names[3:]
    columns_of_body = np.array([body.state_names.index(name) for name in names])
    mean, sigma = np.concatenate([[0.0], body.mean_rad]), np.concatenate([[np.inf], body.sigma_rad])
    low, high = ((mean + sign * LIMIT_SIGMAS * sigma)[columns_of_body - YAW] for sign in (-1, 1))
    low[0], high[0] = -np.pi, np.pi
    groups = (tuple(i for i, about in enumerate(tree.axes) if about == axis) for axis in "zyx")
    limits = values_by_joint(len(names), *((low, high) if limited else FREE), MAX_RATE_RAD_S)
    columns = 3 + np.arange(len(names))
    return SerialChain(tree, columns, names, tuple(group for group in groups if group), *limits)


def body_chain_angles(body: Body, foot: str, states: Array, travel: Array | None = None) -> Array:
    """Return the joint angles (T, n) of `body_chain` for states (T, D) of the body, in a world with z up.

    `travel` is the direction of travel, (3,) or (T, 3), whose horizontal part is used; None stands for `body_travel`.
    """
    q = states[:, [body.state_names.index(name) for name in body_chain(body, foot).names]]
    ahead = body_travel(states) if travel is None else np.asarray(travel, float)
    yaw = q[:, 0] - np.arctan2(ahead[..., 1], ahead[..., 0])
    q[:, 0] = _unwrapped(np.angle(np.exp(1j * yaw)))
    return q


def body_travel(states: Array) -> Array:
    """Return the horizontal direction of travel (3,), a unit vector, of a body's states (T, D).

    The direction points from the first to the last position of the root, or where the animal faces if the root hardly
    moves.
    """
    known = states[np.isfinite(states).all(axis=1)]
    if not len(known):
        return np.full(3, np.nan)
    chord = known[-1, ROOT] - known[0, ROOT]
    if np.hypot(chord[0], chord[1]) < _TRAVEL_M:
        yaw, pitch = known[:, YAW], known[:, PITCH]
        chord = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), 0 * yaw]).mean(axis=1)
    return np.array([chord[0], chord[1], 0.0]) / np.hypot(chord[0], chord[1])


def projected_chain(points_m: Array, travel: ArrayLike) -> tuple[SerialChain, Array, Array]:
    """Build a planar chain through consecutive joints, and return it with its angles (T, K - 1) and misfit (T,), m.

    All joints are projected onto the vertical plane along the direction of travel. Each link has the median of its
    projected lengths, so the end of the chain is not exactly at the last joint. The misfit is the distance between the
    end of the chain and the last joint. The angles, in rad, do not jump by whole turns. The chain has no limits.

    Parameters
    ----------
    points_m
        The joints (T, K, 3) in a world with z up, metres; NaN if missing.
    travel
        The direction of travel (3,).
    """
    ahead = np.asarray(travel, float) * (1.0, 1.0, 0.0)
    plane = np.array([ahead / np.linalg.norm(ahead), -_UP])
    points = (points_m - points_m[:, :1]) @ plane.T
    links = np.diff(points, axis=1)
    lengths = np.nanmedian(np.linalg.norm(links, axis=2), axis=0)
    directions = np.arctan2(links[..., 1], links[..., 0])
    turns = np.diff(directions, axis=1, prepend=0.0)
    q = np.apply_along_axis(_unwrapped, 0, np.angle(np.exp(1j * turns)))
    chain = planar_chain(lengths)
    return chain, q, np.linalg.norm(chain.end(q) - points[:, -1], axis=1)


def _unwrapped(angle: Array) -> Array:
    """Return angles in rad, shape (T,), shifted by whole turns so that they do not jump between known frames."""
    out, known = angle.copy(), np.isfinite(angle)
    out[known] = np.unwrap(angle[known])
    return out
