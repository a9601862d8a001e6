"""What an animal gives: its chains, from the root of a skeleton to a foot, their joint angles in a reconstruction, and
a stride as a task.

All sit in a level base frame at the root. The spine-front-leg chain of the 8U skeleton and planar chains have U along
the direction of travel, V down, W to the side, right-handed; the planar chains' x and y are U and V. The spine's first
link, which has no angles of its own in the skeleton (it lies on the skeleton's U), is free here: the angles follow from
the rotation of the skeleton. The chains of whole animals have x along the direction of travel, y left, z up, as
`recon.geometry.kinematics`.

A stride is the closed path of the end effector. Between the frames the end effector, relative to the base, follows a
cubic spline (angles can jump where two of them say the same, its place does not). A stride begins at a frame, where the
angles are known, and ends when it does: rounded to frames, one of nine is wrong by up to a ninth, and leaves a gap as
wide as the foot moves in a frame.

It begins at the frame next to where it is told to, the touchdown of a foot for instance, and lasts as long as it is
told to. Otherwise it is the return of the end effector that comes nearest to where it began. From each frame it goes
half the path's diameter away and comes back to within a quarter of it, moving less than a right angle off its first
direction; that first return ends where it is nearest. It counts where it spans most of the path's diameter, and of all
that do the one with the smallest gap at a frame is taken, or, of a clip without any, all frames. The gap that is left
is spread evenly over the path.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from recon.animal.body import Body
from recon.animal.chain import UVW_BODY, Chain, upright_rotation
from recon.base.arrays import Array, Index
from recon.gait.phase import diameter
from recon.geometry.kinematics import PITCH, ROOT, YAW, Tree
from recon.wings.robotics.ik.chain import FREE, SerialChain, planar_chain, summed_chain

BASE_THETA_RAD = 0.9
"""Limit of the first link's pitch: three standard deviations of a running animal's."""
LIMIT_SIGMAS = 3.0
"""Limits of a whole animal's angles, in standard deviations."""
_TRAVEL_M = 0.1
"""A shorter path of the root has no direction."""
_UP = np.array([0.0, 0.0, 1.0])

# -- the spine-front-leg chain ---------------------------------------------------------------------------------------


def spine_front_leg(
    chain: Chain, base_length_m: float | None = None, dim: Literal[2, 3] = 3, limited: bool = True
) -> SerialChain:
    """The chain from the root to the front foot, r5, r1, r2, r3, r4 of the 8U skeleton, in its level base frame.

    Its joints are called as the chain's own angles, after the joint at the link's end: theta_9, theta_1 to theta_4, and
    so the phis. base_length_m: None for the nominal one. Limits are the skeleton's expected ranges, those of the first
    link `BASE_THETA_RAD` and three standard deviations of the heading about the direction of travel; it turns no faster
    than the next one. limited: False leaves them out, but for the rates'.
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
    """Joint angles (T, n) of `spine_front_leg` in its level base frame, for states (T, D) of the chain's body.

    travel: direction of travel, (3,) or (T, 3), of which the level part counts; None: as `body_travel`. All links keep
    their directions in space exactly (dim 3); of the two angle pairs for a direction, and of their turns, it is the one
    nearer to that of the chain without roll. dim 2: the thetas, the chain turned into the sagittal plane.
    """
    R = chain.body.tree.orientations(states)[:, 0] @ UVW_BODY.T
    heading = (body_travel(states) if travel is None else np.asarray(travel, float)) * (1.0, 1.0, 0.0)
    heading = np.broadcast_to(heading / np.linalg.norm(heading, axis=-1, keepdims=True), (len(states), 3))
    R_base_local = upright_rotation(heading, _UP).transpose(0, 2, 1) @ R

    free = _angle_index(chain, _path(chain))
    zero, angles = np.zeros(len(states)), states[:, chain.body_angles]
    theta, phi = (
        np.cumsum([zero if k is None else of_kind[:, k] for k in free], axis=0).T
        for of_kind in np.split(angles, 2, axis=1)
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
    """T, P (T, L) of unit vectors (T, L, 3), nearest to theta, phi (T, L)."""
    T = np.arcsin(np.clip(directions[..., 1], -1, 1))
    P = np.arctan2(directions[..., 2], directions[..., 0])
    pairs = [
        (theta + np.angle(np.exp(1j * (t - theta))), phi + np.angle(np.exp(1j * (p - phi))))
        for t, p in ((T, P), (np.pi - T, P + np.pi))
    ]
    # Phi counts as far as it turns the link.
    far = [(t - theta) ** 2 + (np.cos(t) * (p - phi)) ** 2 for t, p in pairs]
    first = far[0] <= far[1]
    return np.where(first, pairs[0][0], pairs[1][0]), np.where(first, pairs[0][1], pairs[1][1])


def _path(chain: Chain) -> list[int]:
    """Indices of the links from the root to the fore foot."""
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
    """Where links have their theta among the thetas, None for a link without."""
    free = [i for i, link in enumerate(chain.links) if link.free]
    return [free.index(i) if i in free else None for i in links]


# -- whole animals ---------------------------------------------------------------------------------------------------


def body_chain(body: Body, foot: str, size: float = 1.0, limited: bool = True) -> SerialChain:
    """The chain from the root segment's origin to a marker, its joints' names those of the state.

    The first joints are the root's yaw against the direction of travel, its pitch and its roll. Limits are the body's
    expectations, `LIMIT_SIGMAS` standard deviations each way, of the yaw half a turn. limited: False leaves them out,
    but for the rates'. Raises ValueError for a marker that the body lacks, or one behind joints whose angles add up.
    """
    marker = next((m for m in body.tree.markers if m.name == foot), None)
    if marker is None:
        raise ValueError(f"{body.name} has no marker {foot}, only {', '.join(body.markers)}")
    by_name = {segment.name: segment for segment in body.tree.segments}
    way = [by_name[marker.segment]]
    while way[0].parent is not None:
        way.insert(0, by_name[way[0].parent])
    if summed := [segment.name for segment in way if segment.joint == "summed"]:
        raise ValueError(f"{body.name}: the angles of {summed[0]} add up, which is `summed_chain`")
    tree = Tree(tuple(way), (marker,)).scaled(size)
    names = tree.state_names[3:]
    where = np.array([body.state_names.index(name) for name in names])
    mean, sigma = np.concatenate([[0.0], body.mean_rad]), np.concatenate([[np.inf], body.sigma_rad])
    low, high = ((mean + sign * LIMIT_SIGMAS * sigma)[where - YAW] for sign in (-1, 1))
    low[0], high[0] = -np.pi, np.pi
    groups = (tuple(i for i, about in enumerate(tree.axes) if about == axis) for axis in "zyx")
    limits = (low, high) if limited else FREE
    columns = 3 + np.arange(len(names))
    return SerialChain(tree, columns, names, tuple(group for group in groups if group), limits)


def body_chain_angles(body: Body, foot: str, states: Array, travel: Array | None = None) -> Array:
    """Joint angles (T, n) of `body_chain` for states (T, D) of the body, in a world with z up.

    travel: direction of travel, (3,) or (T, 3), of which the level part counts; None: from the first to the last place
    of the root, or the way the animal faces where that is short.
    """
    q = states[:, [body.state_names.index(name) for name in body_chain(body, foot).names]]
    ahead = body_travel(states) if travel is None else np.asarray(travel, float)
    yaw = q[:, 0] - np.arctan2(ahead[..., 1], ahead[..., 0])
    q[:, 0] = _unwrapped(np.angle(np.exp(1j * yaw)))
    return q


def body_travel(states: Array) -> Array:
    """Direction of travel (3,), level, of states (T, D) of a body: from the first to the last place of the root, or the
    way the animal faces where that is short."""
    known = states[np.isfinite(states).all(axis=1)]
    if not len(known):
        return np.full(3, np.nan)
    chord = known[-1, ROOT] - known[0, ROOT]
    if np.hypot(chord[0], chord[1]) < _TRAVEL_M:
        yaw, pitch = known[:, YAW], known[:, PITCH]
        chord = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), 0 * yaw]).mean(axis=1)
    return np.array([chord[0], chord[1], 0.0]) / np.hypot(chord[0], chord[1])


def projected_chain(points_m: Array, travel: ArrayLike) -> tuple[SerialChain, Array, Array]:
    """A planar chain through consecutive joints of any skeleton: the chain, q (T, K - 1), and its misfit (T,), metres.

    points_m (T, K, 3): joints, world z up, NaN where missing; travel (3,). Everything is projected into the vertical
    plane along the travel. Lengths are the medians of the projected ones, so that the chain's end does not lie quite
    where the last joint is seen: the misfit is that distance. Angles do not jump by whole turns. Without limits.
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
    """(T,) without jumps of whole turns between known frames."""
    out, known = angle.copy(), np.isfinite(angle)
    out[known] = np.unwrap(angle[known])
    return out


# -- a stride ---------------------------------------------------------------------------------------------------------

OVERSAMPLING = 10
"""Points of the path in a frame."""
MIN_FRAMES = 4
"""Fewer known frames do not make a spline."""
MAX_GAP_FRAMES = 4
"""Longest stretch without data that the spline bridges."""
AWAY, BACK, SPAN = 0.5, 0.25, 0.8
"""Shares of the path's diameter: how far a return leads away and how near back, and how much of it it spans."""


@dataclass(frozen=True, eq=False)
class StridePath:
    """A stride of F frames in a clip whose frame 0 is at 0 s, as a task; its end may lie between two."""

    start_s: float
    end_s: float
    how: str
    """How it was found: "given", "gait" where it is a complete one, "return" or "whole clip"."""
    q: Array
    """(F, n): the animal's joint angles, NaN where missing, of which the first is where to start from."""
    path_m: Array
    """(K, dim): the end effector's path, closed, its points `interval_s` apart."""
    interval_s: float
    gap_m: float
    """The gap that was closed."""
    gap_percent: float
    """The same, of the path's diameter."""
    notes: tuple[str, ...] = ()
    """Strides that do not count, and what else is to be known of it."""


def find_stride(
    chain: SerialChain,
    q: Array,
    fps: float,
    span_s: tuple[float, float] | None = None,
    lasts_s: tuple[float, float] = (0.0, np.inf),
) -> StridePath:
    """The stride of a chain's joint angles q (T, n) at the frames, NaN where missing; see the module.

    span_s: from when to when, where that is known; lasts_s: how long a return may take, as far as that is known. Only
    the longest stretch of frames without a gap of more than `MAX_GAP_FRAMES` counts. Raises ValueError for times that
    it does not hold, or too few frames.
    """
    known = np.flatnonzero(np.isfinite(q).all(axis=1))
    known = max(np.split(known, np.flatnonzero(np.diff(known) > MAX_GAP_FRAMES + 1) + 1), key=np.size)
    if len(known) < MIN_FRAMES:
        raise ValueError(f"a stride needs {MIN_FRAMES} known frames in a row or more, got {len(known)}")
    ends = chain.end(q[known])
    curve = CubicSpline(known, ends)
    how = "given"
    if span_s is not None:
        (start_s, end_s), half = span_s, 0.5 / fps
        first, last = known[0] / fps, known[-1] / fps
        if not first - half <= start_s < end_s <= last + half:
            raise ValueError(
                f"a stride within {first:.3f} to {last:.3f} s expected, got {start_s:.3f} to {end_s:.3f} s"
            )
        frames = (end_s - start_s) * fps
        # Not so late that it would end after the last frame.
        begins = known[(known + frames <= known[-1] + 1e-6) | (known == known[0])]
        start = int(begins[np.argmin(np.abs(begins - start_s * fps))])
        end = min(start + frames, float(known[-1]))
    else:
        found = _return(known, ends, lasts_s[0] * fps, lasts_s[1] * fps)
        how = "return" if found else "whole clip"
        i, j = found or (0, len(known) - 1)
        start, end = int(known[i]), float(known[j])
        if found:
            near = np.linspace(max(end - 1, start), min(end + 1, known[-1]), 20 * OVERSAMPLING + 1)
            end = float(near[np.argmin(np.linalg.norm(curve(near) - ends[i], axis=1))])
    if end <= start + 1 - 1e-6:
        raise ValueError("a stride needs two frames or more")
    points = round((end - start) * OVERSAMPLING) + 1
    path = curve(np.linspace(start, end, points))
    gap, extent = path[-1] - path[0], diameter(path)
    closed = path - np.linspace(0.0, 1.0, points)[:, None] * gap
    closed[-1] = closed[0]
    size = float(np.linalg.norm(gap))
    return StridePath(
        start_s=start / fps,
        end_s=end / fps,
        how=how,
        q=q[start : int(end + 1e-6) + 1],
        path_m=closed,
        interval_s=(end - start) / fps / (points - 1),
        gap_m=size,
        gap_percent=100 * size / extent if extent > 0 else 0.0,
    )


def farthest_reach(chain: SerialChain, q: Array) -> tuple[Array, Array]:
    """From joint angles (K, n), a stride's for instance, NaN where missing: q0 (n,) where the end effector is rearmost,
    and the target (dim,) where it is foremost. Forwards is the base frame's first axis. Raises ValueError."""
    known = q[np.isfinite(q).all(axis=1)]
    if not len(known):
        raise ValueError("no frame without a missing value")
    ends = chain.end(known)
    return known[np.argmin(ends[:, 0])], ends[np.argmax(ends[:, 0])]


def _return(frames: Index, ends: Array, least: float, most: float) -> tuple[int, int] | None:
    """Rows of the return (see the module) of a path (F, dim), of least to most frames, with the smallest gap; None
    without any."""
    velocity = np.gradient(ends, frames, axis=0)
    extent = diameter(ends)
    best, smallest = None, np.inf
    for i in range(len(ends)):
        distance = np.linalg.norm(ends[i:] - ends[i], axis=1)
        left = np.flatnonzero(distance >= AWAY * extent)
        if not len(left):
            continue
        back = np.flatnonzero((distance < BACK * extent) & (velocity[i:] @ velocity[i] > 0))
        lag = frames[i + back] - frames[i]
        back = back[(back > left[0]) & (lag >= least) & (lag <= most)]
        if not len(back):
            continue
        # Up to where it leaves again.
        once = back[: np.argmax(np.append(np.diff(back), 2) > 1) + 1]
        j = int(once[np.argmin(distance[once])])
        if distance[j] < smallest and diameter(ends[i : i + j + 1]) >= SPAN * extent:
            best, smallest = (i, i + j), float(distance[j])
    return best
