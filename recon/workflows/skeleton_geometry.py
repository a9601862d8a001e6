"""A skeleton from the geometry of its keypoints, where their names tell nothing: several cameras see which distances
stay the same. Keypoints that keep all their distances are a body, and bodies are joined where their points keep theirs
best. Expected is a pose that the animal had, out of which its segments swing as far as they did."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import squareform

from recon.animal import MIN_JOINTS
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem

FEWEST_FRAMES = 20
RIGID, TOO_MUCH, NOISE = 0.01, 0.02, 2.0
"""Of the animal's length: a distance that changes by less (one standard deviation) stays the same; and of noisy
keypoints, by so many times what those between steady neighbours do, but not by more than the second."""
KEYPOINT_SHARE, SIZE_SIGMA = 0.02, 0.05
"""Of the skeleton: keypoint_sigma_m as a share of its length, and size_sigma of an animal that was measured."""
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
        return toml_text(f"part_{self.number}_at_{labels[self.origin]}")


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
    lines = [
        f"# A draft from the geometry of the keypoints of {toml_text(source.name)}: distances that change by less than",
        f"# {1000 * same_m:.1f} mm stay the same. Look at it with recon skeleton check, and give its segments names.",
        f"name = {toml_text(title)}",
        f"title = {toml_text(f'{title}, drafted from the geometry of its keypoints')}",
        f"forward = [{toml_text(labels[rear])}, {toml_text(labels[front])}]",
        f"keypoint_sigma_m = {KEYPOINT_SHARE * long_m:.5f}",
        f"size_sigma = {SIZE_SIGMA}",
        "\n[feet]",
        *_segments(parts, labels, turned, along, fps),
        *_markers(parts, labels, along),
        "\n[limbs]",
        *(f"part_{p.number} = [{', '.join(toml_text(labels[i]) for i in p.line)}]" for p in parts if len(p.line) > 1),
    ]
    return labels, "\n".join(lines) + "\n"


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


def _segments(parts: Sequence[_Part], labels: Sequence[str], turned: Array, along: Array, fps: float) -> Iterator[str]:
    for part in parts:
        yield f'\n[[segments]]\nname = {part.name(labels)}\njoint = "{"ball" if part.parent else "free"}"'
        if part.parent:
            yield f"parent = {part.parent.name(labels)}\nat_m = {_at(along[part.parent.origin, part.origin])}"
        ends = [*part.points, *(child.origin for child in parts if child.parent is part)]
        far = max(ends, key=lambda p: np.linalg.norm(along[part.origin, p]))
        to_m = turned[:, far] - turned[:, part.origin]
        unit = to_m[np.isfinite(to_m[:, 0])] / np.linalg.norm(along[part.origin, far]).clip(1e-9)
        swings = unit - along[part.origin, far] / np.linalg.norm(along[part.origin, far]).clip(1e-9)
        main = (swings - swings.mean(axis=0)) @ np.linalg.svd(swings - swings.mean(axis=0), full_matrices=False)[2][0]
        sigma = np.clip(np.sqrt(np.mean(np.sum(swings**2, axis=1))), *SWING_RAD)
        hz = np.clip(np.sum(np.diff(np.sign(main)) != 0) * fps / 2 / len(main), *SWING_HZ)
        for angle in ("yaw", "pitch", "roll")[0 if part.parent else 1 :]:
            quick = 1.5 * sigma * (2 * np.pi * hz) ** 2
            yield f"{angle} = {{ mean_rad = 0.0, sigma_rad = {sigma:.2f}, acceleration_rad_s2 = {quick:.0f} }}"


def _markers(parts: Sequence[_Part], labels: Sequence[str], along: Array) -> Iterator[str]:
    for part in parts:
        for point in part.points:
            yield f"\n[[markers]]\nname = {toml_text(labels[point])}\nsegment = {part.name(labels)}"
            yield f"at_m = {_at(along[part.origin, point])}"


def _at(place_m: Array) -> list[float]:
    return [round(float(x), 5) for x in place_m]


def toml_text(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)
