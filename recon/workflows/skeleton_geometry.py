"""A skeleton from the geometry of its keypoints, where their names tell nothing: several cameras see which distances
stay the same. Keypoints that keep all their distances are a body, and bodies are joined where their points keep theirs
best. Expected is a pose that the animal had, out of which its segments swing as far as they did."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import squareform

from recon.animal import MIN_JOINTS
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem

FEWEST_FRAMES = 20
RIGID, TOO_MUCH, NOISE = 0.01, 0.02, 2.0
"""Shares of the animal's length: a distance that changes by less (one standard deviation) stays the same; and of noisy
keypoints, by so many times what those between steady neighbours do, but not by more than the second."""
KEYPOINT_SHARE, SIZE_SIGMA = 0.02, 0.05
"""For the skeleton: keypoint_sigma_m as a share of its length, and size_sigma of an animal that was measured."""
SWING_RAD, SWING_HZ = (0.2, 1.2), (0.5, 8.0)


@dataclass(frozen=True)
class _Part:
    """A segment: its number, the point where it begins, its parent, its points, and the line to these from others."""

    number: int
    origin: int
    parent: _Part | None
    points: tuple[int, ...] = ()
    line: tuple[int, ...] = ()

    def name(self, labels: Sequence[str]) -> str:
        return f"part_{self.number}_at_{labels[self.origin]}"


def drafted(names: Sequence[str], points_m: Array, fps: float, title: str, source: Path) -> tuple[list[str], str]:
    """The keypoints that were seen often enough, and the text of a skeleton of them. points_m (T, K, 3): in a world
    with z up, metres, NaN where missing. Raises InputError where too few are seen, or the animal hardly moves."""
    seen = np.isfinite(points_m[..., 0])
    kept = np.flatnonzero(seen.sum(axis=0) >= FEWEST_FRAMES)
    if len(kept) < MIN_JOINTS or (seen[:, kept].T.astype(int) @ seen[:, kept]).min() < FEWEST_FRAMES:
        found = f"{len(kept)} that two cameras see in {FEWEST_FRAMES} frames, not all of them together"
        raise InputError(Problem(source, "keypoints", found, f"{MIN_JOINTS} or more, each together with each other"))
    points, labels = points_m[:, kept], [names[k] for k in kept.tolist()]
    apart = np.stack([np.linalg.norm(points - point[:, None], axis=2) for point in points.swapaxes(0, 1)], axis=1)
    usual_m = np.nanmedian(apart, axis=0)
    changes_m, long_m = 1.4826 * np.nanmedian(np.abs(apart - usual_m), axis=0), float(usual_m.max())
    nearest_m = np.where(np.eye(len(kept), dtype=bool), np.inf, changes_m).min(axis=1)
    same_m = max(NOISE * float(np.median(nearest_m)), RIGID * long_m)  # nearly every point is on a body with another
    if same_m > TOO_MUCH * long_m:
        found = f"distances between neighbours change by {1000 * same_m / NOISE:.1f} mm in an animal of {long_m:.3g} m"
        expected = (
            f"by {TOO_MUCH / NOISE:.0%} or less of its length, to tell what bends from noise: more or nearer cameras"
        )
        raise InputError(Problem(source, "keypoints", found, expected))
    of = fcluster(linkage(squareform(changes_m, checks=False), "complete"), same_m, "distance")
    bodies = [np.flatnonzero(of == i).tolist() for i in np.unique(of)]
    root = min(range(len(bodies)), key=lambda i: (len(bodies[i]) < 3, usual_m[bodies[i]].min(axis=0).mean()))
    middle = points[:, bodies[root]].mean(axis=1)
    gone = np.gradient(middle[:, :2], axis=0)
    path_m = float(np.nansum(np.linalg.norm(gone, axis=1)))
    if len(bodies) == 1 or not path_m > long_m / 2:
        found = f"an animal of {long_m:.3g} m that goes {path_m:.3g} m, with {len(bodies)} bodies that turn"
        raise InputError(Problem(source, "motion", found, "half its length, to know its front, and two bodies or more"))
    parts = _tree(bodies, root, np.maximum(changes_m, same_m / 2) + same_m * usual_m / long_m, same_m)
    reach = np.nansum(np.sum((points - middle[:, None])[..., :2] * gone[:, None], axis=2), axis=0)
    trunk = bodies[root] if len(bodies[root]) > 1 else range(len(kept))
    rear, front = min(trunk, key=reach.__getitem__), max(trunk, key=reach.__getitem__)

    x, y, z = np.moveaxis(points - points[:, [parts[0].origin]], 2, 0)
    heading = np.arctan2(y[:, front] - y[:, rear], x[:, front] - x[:, rear])[:, None]
    c, s = np.cos(heading), np.sin(heading)
    turned = np.stack([c * x + s * y, c * y - s * x, z], axis=2)
    typical = np.nanmedian(turned, axis=0)
    off = np.linalg.norm(np.where(np.isfinite(turned), turned - typical, long_m), axis=2).mean(axis=1)
    pose = np.where(np.isfinite(turned[off.argmin()]), turned[off.argmin()], typical)
    along = pose - pose[:, None]  # from a point to another, of the length that it usually has
    along *= (usual_m / np.linalg.norm(along, axis=2).clip(1e-9))[..., None]
    comments = [
        f"A draft from the geometry of the keypoints of {toml_text(source.name)}: distances that change by less than",
        f"{1000 * same_m:.1f} mm stay the same. Look at it with recon skeleton check, and give its segments names.",
    ]
    ends = labels[rear], labels[front]
    text = head_text(comments, title, "the geometry", ends, round(KEYPOINT_SHARE * long_m, 5), SIZE_SIGMA)
    text += table_text("[feet]", {})
    for part in parts:
        text += table_text("[[segments]]", _segment(part, parts, labels, turned, along, fps))
    for part in parts:
        for point in part.points:
            of = {"name": labels[point], "segment": part.name(labels)}
            text += table_text("[[markers]]", of | {"at_m": _at(along[part.origin, point])})
    limbs = {f"part_{part.number}": [labels[i] for i in part.line] for part in parts if len(part.line) > 1}
    return labels, text + table_text("[limbs]", limbs)


def _tree(bodies: Sequence[list[int]], root: int, costs: Array, same_m: float) -> list[_Part]:
    """Parents first. costs (K, K): of a joint between two points. A point that keeps its distances to all of another
    body is the joint; where there is none, a link between two points."""

    def joint(a: list[int], b: list[int]) -> tuple[float, int, int]:
        of = costs[np.ix_(a, b)]
        u, v = int(of.max(axis=1).argmin()), int(of.max(axis=0).argmin())
        i, j = divmod(int(of.argmin()), len(b))
        held = float(of[u].max()), float(of[:, v].max()), float(of[i, j]) + 0.5 * same_m
        return min(zip(held, (a[u], b[v], a[i]), (a[u], b[v], b[j]), strict=True))

    n = len(bodies)
    held = [[joint(a, b)[0] * (i != k) for k, b in enumerate(bodies)] for i, a in enumerate(bodies)]
    joined = minimum_spanning_tree(np.array(held)).toarray()
    origin = bodies[root][int(costs[np.ix_(bodies[root], bodies[root])].sum(axis=1).argmin())]
    parts = [_Part(1, origin, None, tuple(bodies[root]), tuple(bodies[root]))]
    of_body, queue = {root: parts[0]}, [root]
    for i in queue:
        for k in (k for k in range(n) if joined[i, k] + joined[k, i] and k not in of_body):
            _, here, there = joint(bodies[i], bodies[k])
            if here != there:
                parts.append(_Part(len(parts) + 1, here, of_body[i]))
            parent = of_body[i] if here == there else parts[-1]
            line = (here, *(p for p in bodies[k] if p != here))
            of_body[k] = _Part(len(parts) + 1, there, parent, tuple(bodies[k]), line)
            parts.append(of_body[k])
            queue.append(k)
    return parts


def _segment(
    part: _Part, parts: Sequence[_Part], labels: Sequence[str], turned: Array, along: Array, fps: float
) -> dict[str, Any]:
    """The table of a segment, which swings as far and as often as the line to its farthest point did."""
    found: dict[str, Any] = {"name": part.name(labels), "joint": "ball" if part.parent else "free"}
    if part.parent:
        found |= {"parent": part.parent.name(labels), "at_m": _at(along[part.parent.origin, part.origin])}
    ends = [*part.points, *(child.origin for child in parts if child.parent is part)]
    far = max(ends, key=lambda p: np.linalg.norm(along[part.origin, p]))
    to_m, usual_m = turned[:, far] - turned[:, part.origin], along[part.origin, far]
    swings = (to_m[np.isfinite(to_m[:, 0])] - usual_m) / np.linalg.norm(usual_m).clip(1e-9)
    main = (swings - swings.mean(axis=0)) @ np.linalg.svd(swings - swings.mean(axis=0), full_matrices=False)[2][0]
    sigma = np.clip(np.sqrt(np.mean(np.sum(swings**2, axis=1))), *SWING_RAD)
    hz = np.clip(np.sum(np.diff(np.sign(main)) != 0) * fps / 2 / len(main), *SWING_HZ)
    quick = round(float(1.5 * sigma * (2 * np.pi * hz) ** 2))
    expected = {"mean_rad": 0.0, "sigma_rad": round(float(sigma), 2), "acceleration_rad_s2": quick}
    return found | dict.fromkeys(("yaw", "pitch", "roll")[0 if part.parent else 1 :], expected)


def _at(place_m: Array) -> list[float]:
    return [round(float(x), 5) for x in place_m]


# -- a skeleton file ----------------------------------------------------------------------------------------------


def head_text(
    comments: Iterable[str],
    title: str,
    of: str,
    forward: Sequence[str],
    keypoint_sigma_m: float,
    size_sigma: float,
) -> str:
    """What a skeleton file begins with."""
    values = {"name": title, "title": f"{title}, drafted from {of} of its keypoints", "forward": list(forward)}
    values |= {"keypoint_sigma_m": keypoint_sigma_m, "size_sigma": size_sigma}
    return table_text("\n".join(f"# {line}" for line in comments), values)


def table_text(header: str, values: Mapping[str, Any]) -> str:
    """A table of a TOML file, each value on a line, as people write it."""
    names = {name: name if re.fullmatch(r"[\w-]+", name, re.ASCII) else toml_text(name) for name in values}
    return "\n".join([header, *(f"{names[name]} = {toml_text(value)}" for name, value in values.items())]) + "\n\n"


def toml_text(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {toml_text(one)}" for name, one in value.items()) + " }"
    return json.dumps(value, ensure_ascii=False)
