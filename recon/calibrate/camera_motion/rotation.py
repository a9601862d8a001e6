"""Points of a picture that can be found again in another one, how the camera has turned between the two, and which way
is up, as said, marked in the pictures, or supposed.

A subject that is followed covers much of the picture, has more structure than the background, and agrees with itself.
It lies together, though, where the background lies all around: a turn is worth what its points cover times how widely
they are spread, not how many they are.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from recon.base import Array, Bools, InputError, Integers, Problem, raise_problems
from recon.base.documents import require_file
from recon.geometry import Camera, level_from_camera
from recon.io.common import first_problems, frame_number, number, text_rows
from recon.io.video import Image

WORK_PX = 1280
"""Longest side of the pictures that are worked on: larger ones are made smaller by a whole number."""
CELLS = (16, 9)
"""Across the longer and the shorter side: points are taken from each cell, so that a finely structured part of the
picture does not outnumber the rest of it."""
POINTS_IN_CELL = 3
BLOCK_PX, LEVELS = 5, 3
MIN_CORNER = 4e-5
"""Smaller eigenvalue of the structure: noise of two grey levels stays below 3e-5."""
MAX_UNLIKE, LEAST_UNLIKE = 3.0, 8.0
"""Grey levels by which a point's surroundings may differ, against the median of all: more where it is hidden now."""
ORB_POINTS, MIN_SAME = 700, 20
MIN_ALIKE = 0.7
HULL_MARGIN = 0.15


@dataclass(frozen=True)
class GreyPicture:
    """A grey picture, made smaller by `scale`."""

    grey: Image
    scale: int

    @classmethod
    def of(cls, picture: Image) -> GreyPicture:
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        scale = -(-max(grey.shape) // WORK_PX)
        if scale > 1:
            size = (grey.shape[1] // scale, grey.shape[0] // scale)
            grey = cv2.resize(grey[: size[1] * scale, : size[0] * scale], size, interpolation=cv2.INTER_AREA)
        return cls(np.asarray(grey, dtype=np.uint8), scale)

    @property
    def window_px(self) -> int:
        """Side of what is compared around a point: less in small pictures, for it should lie on one thing."""
        return int(np.clip(max(self.grey.shape) // 40, 11, 21)) | 1

    def full_px(self, work_px: Array) -> Array:
        """Pixels (N, 2) of the original."""
        return (work_px + 0.5) * self.scale - 0.5

    def work_px(self, full_px: Array) -> Array:
        return (full_px + 0.5) / self.scale - 0.5


def corners(frame: GreyPicture, masked: Bools | None = None) -> Array:
    """Pixels (N, 2) of the original: the strongest corners of every cell, without what is masked of the small one."""
    grey = cv2.GaussianBlur(frame.grey, (0, 0), 1.0)
    strength = cv2.cornerMinEigenVal(grey, BLOCK_PX)
    peak = (strength == cv2.dilate(strength, np.ones((9, 9), np.uint8))) & (strength > MIN_CORNER)
    edge = frame.window_px // 2
    inside = np.zeros_like(peak)
    inside[edge:-edge, edge:-edge] = True
    peak &= inside if masked is None else inside & ~masked
    y, x = np.nonzero(peak)
    height, width = grey.shape
    across, down = CELLS if width >= height else CELLS[::-1]
    cell = (y * down // height) * across + x * across // width
    order = np.lexsort((-strength[y, x], cell))
    cell = cell[order]
    rank = np.arange(len(cell)) - np.searchsorted(cell, cell)
    kept = order[rank < POINTS_IN_CELL]
    return frame.full_px(np.column_stack([x[kept], y[kept]]).astype(float))


def followed(before: GreyPicture, after: GreyPicture, points_px: Array, guess_px: Array) -> tuple[Array, Bools]:
    """Where points (N, 2) of one picture are in another, and which were found; guess_px (N, 2): about where."""
    if not len(points_px):
        return np.zeros((0, 2)), np.zeros(0, bool)
    found, status, unlike = cv2.calcOpticalFlowPyrLK(
        before.grey,
        after.grey,
        before.work_px(points_px).astype(np.float32),
        after.work_px(guess_px).astype(np.float32),
        winSize=(before.window_px, before.window_px),
        maxLevel=LEVELS,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    height, width = after.grey.shape
    inside = ((found > 2) & (found < (width - 3, height - 3))).all(axis=1)
    good = (status[:, 0] > 0) & inside
    if good.any():
        good &= unlike[:, 0] < max(LEAST_UNLIKE, MAX_UNLIKE * float(np.median(unlike[good])))
    return after.full_px(found.astype(float)), good


def described(frame: GreyPicture) -> tuple[Array, Image]:
    """Pixels (N, 2) and descriptors (N, 32) of points that are found again wherever they have gone."""
    side = frame.window_px * 3 // 2
    finder = cv2.ORB.create(ORB_POINTS, edgeThreshold=side, patchSize=side)
    points, descriptors = finder.detectAndCompute(frame.grey, None)
    if descriptors is None:
        return np.zeros((0, 2)), np.zeros((0, 32), np.uint8)
    work = np.array([point.pt for point in points])
    return frame.full_px(work), np.asarray(descriptors, dtype=np.uint8)


def same_scene(a: tuple[Array, Image], b: tuple[Array, Image]) -> bool:
    """Whether points of two pictures (pixels, descriptors) can be laid over each other, if not by a turn."""
    pairs = matched(a[1], b[1])
    if len(pairs) < MIN_SAME:
        return False
    places = [one[0][pairs[:, i]].astype(np.float32) for i, one in enumerate((a, b))]
    limit = 0.01 * float(np.ptp(places[0], axis=0).max())
    _, same = cv2.findHomography(places[0], places[1], cv2.RANSAC, max(limit, 2.0))
    return same is not None and int(same.sum()) >= MIN_SAME


def similar(a: GreyPicture, b: GreyPicture) -> bool:
    """Whether light and dark lie about alike in two pictures, as they do in neighbours of one take."""
    small = [cv2.resize(one.grey, (16, 16), interpolation=cv2.INTER_AREA).ravel() for one in (a, b)]
    return bool(np.asarray(np.corrcoef(small))[0, 1] > MIN_ALIKE)


def matched(a: Image, b: Image) -> Integers:
    """Pairs (N, 2) of descriptors that are each other's nearest."""
    if not len(a) or not len(b):
        return np.zeros((0, 2), np.int64)
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(a, b)
    return np.array([(m.queryIdx, m.trainIdx) for m in matches], dtype=np.int64).reshape(-1, 2)


def hull_mask(frame: GreyPicture, points_px: Array) -> Bools:
    """A mask (height, width) of the small picture: what the hull of points (N, 2) covers, widened by a share of its
    size."""
    mask = np.zeros(frame.grey.shape, np.uint8)
    points = frame.work_px(points_px[np.isfinite(points_px).all(axis=1)])
    if len(points):
        hull = cv2.convexHull(points.astype(np.float32)).reshape(-1, 2)
        wide = max(4, round(HULL_MARGIN * float(np.linalg.norm(np.ptp(points, axis=0)))))
        polygon = [hull.round().astype(np.int32)]
        cv2.fillPoly(mask, polygon, 1)
        cv2.polylines(mask, polygon, True, 1, 2 * wide)
    return mask.astype(bool)


def focus_px(camera: Camera) -> Array:
    """(2,): the point that zooming leaves where it is."""
    return camera.matrix[:2, 2]


def rays_of(camera: Camera, pixels: Array, zoom: float = 1.0) -> tuple[Array, Bools]:
    """Unit rays (N, 3) of pixels (N, 2), and validity. zoom: focal length in the camera file's."""
    return camera.rays(focus_px(camera) + (pixels - focus_px(camera)) / zoom)


def pixels_of(camera: Camera, rays: Array, zoom: float = 1.0) -> tuple[Array, Bools]:
    """The pixels (N, 2) of rays: the inverse of `rays_of`."""
    pixels, valid = camera.project(rays)
    return focus_px(camera) + zoom * (pixels - focus_px(camera)), valid


# -- a turn ------------------------------------------------------------------------------------------------------------

GRID = (12, 12)
TRIALS, CANDIDATES = 300, 10
MIN_APART = 0.12
"""How far apart the two points are at least that a rotation is tried from, as a share of the picture's diagonal."""
MIN_POINTS, MIN_SPREAD = 15, 0.2
FINAL_LIMIT, LEAST_LIMIT = 0.5, 0.2
"""The limits that rotations are tried with: what a point may be off at most, however widely the others scatter, and
what it may always be."""
ROUNDS = 6


@dataclass(frozen=True, eq=False)
class Orientation:
    """rotation (3, 3): world to camera. zoom: focal length in the camera file's."""

    rotation: Array
    zoom: float = 1.0


@dataclass(frozen=True, eq=False)
class AgreedOrientation:
    """A turn and what supports it. weights: (N,), 0 of points that do not agree. residual_px: (N, 2), seen less
    expected. jacobian: (N, 2, 4) of the expected pixels, by a small turn (rad) in the camera frame and by log zoom.
    spread: what it is worth."""

    orientation: Orientation
    weights: Array
    residual_px: Array
    jacobian: Array
    sigma_px: float
    spread: float

    @property
    def agree(self) -> Bools:
        return self.weights > 0


def spread(pixels: Array, size_px: tuple[int, int], weights: Array) -> tuple[Array, Array]:
    """What H sets of points (H, N weights from 0 to 1) cover of the picture (0 to 1), and how widely: the area of the
    cells' spread, 1 for an evenly covered picture."""
    across, down = GRID
    x, y = (np.clip(pixels[:, i] / size_px[i] * GRID[i], 0, GRID[i] - 1).astype(int) for i in (0, 1))
    inside = np.zeros((len(pixels), across * down))
    inside[np.arange(len(pixels)), y * across + x] = 1.0
    taken = np.minimum(weights @ inside, 1.0)
    cx, cy = np.tile(np.arange(across) / across, down), np.repeat(np.arange(down) / down, across)
    moments = taken @ np.column_stack([np.ones_like(cx), cx, cy, cx * cx, cy * cy, cx * cy])
    total = np.maximum(moments[:, 0], 1e-9)
    mx, my, xx, yy, xy = (moments[:, i] / total for i in range(1, 6))
    determinant = (xx - mx * mx) * (yy - my * my) - (xy - mx * my) ** 2
    return total / (across * down), 12 * np.sqrt(np.maximum(determinant, 0))


def agreed_turn(
    camera: Camera, rays: Array, seen_px: Array, background: Array, zoom: float, solve_zoom: bool, limit_px: float
) -> AgreedOrientation | None:
    """The turn that takes world rays (N, 3) to the pixels (N, 2) where they are seen, all of which have a ray, at about
    that zoom.

    background: (N,) from 0 to 1, how far each has been background so far. limit_px: what a point may be off at most.
    None where too few points agree or they cover too little.
    """
    if len(rays) < MIN_POINTS:
        return None
    seen_rays, _ = rays_of(camera, seen_px, zoom)
    tried = _tried(rays, seen_rays, seen_px, camera.image_size_px)
    if not len(tried):
        return None
    off = 1 - np.einsum("hij,nj,ni->hn", tried, rays, seen_rays, optimize=True)
    angle = limit_px / (camera.matrix[0, 0] * zoom)
    weights = background**2 * (off < 0.5 * angle**2)
    coverage, area = spread(seen_px, camera.image_size_px, weights)
    best: AgreedOrientation | None = None
    looked_at: list[Array] = []
    for h in np.argsort(-coverage * area)[:CANDIDATES]:
        if any(np.trace(tried[h] @ other.T) > 1 + 2 * np.cos(2 * angle) for other in looked_at):
            continue
        looked_at.append(tried[h])
        found = refined(camera, rays, seen_px, Orientation(tried[h], zoom), solve_zoom, limit_px)
        if found is None:
            continue
        c, a = spread(seen_px, camera.image_size_px, (background**2 * found.agree)[None])
        found = replace(found, spread=float(c[0] * a[0]))
        if a[0] >= MIN_SPREAD and (best is None or found.spread > best.spread):
            best = found
    return best


def _tried(rays: Array, seen: Array, pixels: Array, size_px: tuple[int, int]) -> Array:
    """(H, 3, 3): turns from pairs of points that lie apart."""
    rng = np.random.default_rng(0)
    i, j = rng.integers(0, len(rays), (2, 2 * TRIALS))
    apart = np.linalg.norm(pixels[i] - pixels[j], axis=1) > MIN_APART * np.hypot(*size_px)
    i, j = i[apart][:TRIALS], j[apart][:TRIALS]
    return _axes(seen[i], seen[j]) @ _axes(rays[i], rays[j]).swapaxes(1, 2)


def _axes(a: Array, b: Array) -> Array:
    """(H, 3, 3): right-handed axes, as columns, of pairs of rays."""
    columns = [a + b, a - b, np.cross(b, a)]
    return np.stack([c / np.linalg.norm(c, axis=1, keepdims=True) for c in columns], axis=2)


def refined(
    camera: Camera, rays: Array, seen_px: Array, orientation: Orientation, solve_zoom: bool, limit_px: float
) -> AgreedOrientation | None:
    """Robust least squares in pixels, from a turn nearby (Tukey's weights, with a limit that follows the scatter)."""
    free = slice(0, 4 if solve_zoom else 3)
    limit, rounds = limit_px, ROUNDS
    while True:
        residual, jacobian = _linearised(camera, rays, seen_px, orientation)
        size = np.linalg.norm(residual, axis=1)
        weights = tukey(size, limit)
        if (weights > 0).sum() < MIN_POINTS:
            return None
        if not rounds:
            sigma = float(np.sqrt((weights * size**2).sum() / (2 * weights.sum())))
            return AgreedOrientation(orientation, weights, residual, jacobian, max(sigma, 1e-3), 0.0)
        step, rounds = np.zeros(4), rounds - 1
        step[free] = np.linalg.solve(*normal_equations(jacobian[:, :, free], weights, residual))
        orientation = Orientation(
            Rotation.from_rotvec(step[:3]).as_matrix() @ orientation.rotation, orientation.zoom * float(np.exp(step[3]))
        )
        median = float(np.median(size[weights > 0]))
        limit = limit_px * float(np.clip(4 * median / limit_px, LEAST_LIMIT, FINAL_LIMIT))


def tukey(size: Array, limit: float) -> Array:
    """Tukey's weights of residuals of such a size, 0 from the limit on."""
    return np.maximum(1 - (size / limit) ** 2, 0) ** 2


def normal_equations(jacobian: Array, weights: Array, residual_px: Array) -> tuple[Array, Array]:
    """Matrix (P, P) and right-hand side (P,) of N points: (N, 2, P), (N,), (N, 2)."""
    flat = jacobian.reshape(-1, jacobian.shape[-1])
    weighted = (jacobian * weights[:, None, None]).reshape(flat.shape)
    return weighted.T @ flat, weighted.T @ residual_px.ravel()


def _linearised(camera: Camera, rays: Array, seen_px: Array, orientation: Orientation) -> tuple[Array, Array]:
    there = rays @ orientation.rotation.T
    pixels, by_point, _ = camera.project_with_jacobian(there)
    from_focus = orientation.zoom * (pixels - focus_px(camera))
    x, y, z = there.T
    zero = np.zeros_like(x)
    by_turn = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)  # of exp(w) p, that is w x p
    jacobian = np.concatenate([orientation.zoom * by_point @ by_turn, from_focus[:, :, None]], axis=2)
    known = np.isfinite(from_focus[:, :1])
    return np.where(known, seen_px - focus_px(camera) - from_focus, 1e9), np.where(known[:, :, None], jacobian, 0.0)


def expected_px(camera: Camera, rays: Array, orientation: Orientation) -> tuple[Array, Bools]:
    """Pixels (N, 2) of world rays (N, 3), and whether they are in the picture."""
    pixels, valid = pixels_of(camera, rays @ orientation.rotation.T, orientation.zoom)
    return pixels, valid & camera.in_image(np.where(valid[:, None], pixels, -1e9))


# -- which way is up --------------------------------------------------------------------------------------------------

COLUMNS = ("kind", "frame", "x1", "y1", "x2", "y2")
EXPECTED = f"a table (.csv) with the columns {', '.join(COLUMNS)}: horizon or vertical, and two points of it, px"
MARKED_PX = 2.0
"""How exactly a point is marked."""
MAX_SIGMA_RAD = math.radians(3.0)
"""Marks that say less of the upward direction do not say it: a single vertical, or parallel ones."""


LevelMark = tuple[str, int, tuple[tuple[float, float], tuple[float, float]]]
"""horizon or vertical, a frame, and two points (px) of the horizon, or of something upright, in its picture."""


def as_level(orientations: Sequence[Orientation], up: Array | None) -> tuple[Orientation, ...]:
    """The turns from a world with z up, y away from the camera.

    up: (3,) in the first frame's camera. None: the mean frame looks level.
    """
    reference = orientations[0].rotation
    if up is None:
        reference = Rotation.from_matrix([one.rotation for one in orientations]).mean().as_matrix()
        up = tilted(0.0)
    level = level_from_camera(up) @ reference  # of the old world
    return tuple(replace(orientation, rotation=orientation.rotation @ level.T) for orientation in orientations)


def tilted(tilt_rad: float) -> Array:
    """Up (3,) in a camera that looks down so far, its picture level to the sides."""
    return np.array([0.0, -math.cos(tilt_rad), -math.sin(tilt_rad)])


def up_by_marks(
    source: Path, marks: Sequence[LevelMark], camera: Camera, orientations: Mapping[int, Orientation]
) -> tuple[Array, float]:
    """Up (3,) in the first frame's camera, and its standard deviation in rad. turns: by frame.

    The horizon's rays lie level, and something upright lies in the plane through its ends' rays: up is at right angles
    to all of the first and to the normals of the second. Raises InputError for a frame without a turn, a point
    outside the lens's range, and for marks that do not tell.
    """
    first = orientations[min(orientations)].rotation
    rows, problems = [], []
    for kind, frame, ends_px in marks:
        orientation = orientations.get(frame)
        rays, valid = rays_of(camera, np.array(ends_px), orientation.zoom if orientation else 1.0)
        if orientation is None:
            problems.append(Problem(source, "frame", str(frame), "one of the video in which the turn was found"))
        elif not valid.all():
            problems.append(Problem(source, f"frame {frame}", str(ends_px), "points of the picture"))
        else:
            level = rays if kind == "horizon" else np.cross(*rays)[None]
            rows.append(level @ orientation.rotation @ first.T)
    raise_problems(dict.fromkeys(problems))
    # A ray is as exact as a mark over the focal length; a plane's normal as two marks over the length between them,
    # which is that of the cross product.
    A = np.concatenate(rows) * camera.matrix[0, 0] / MARKED_PX
    _, size, directions = np.linalg.svd(A, full_matrices=True)
    sigma = math.sqrt(np.sum(size[:2] ** -2.0)) if len(size) > 1 and size[1] > 0 else math.inf
    if sigma > MAX_SIGMA_RAD:
        found = "marks that leave the upward direction open"
        raise InputError(Problem(source, "marks", found, "two points of the horizon, or verticals far from each other"))
    up = directions[2]
    return (up if up[1] < 0 else -up), sigma


def read_marks(path: Path) -> tuple[LevelMark, ...]:
    """From a CSV table of `COLUMNS`. Raises InputError with every problem."""
    require_file(path, EXPECTED)
    (_, header), *rows = [*text_rows(path, ",")] or [(1, [])]
    if tuple(cell.strip() for cell in header) != COLUMNS:
        raise InputError(Problem(path, "header", repr(",".join(header))[:80], EXPECTED))
    marks, problems = list[LevelMark](), list[Problem]()
    for line, cells in rows:
        try:
            marks.append(_mark(*(cell.strip() for cell in cells)))
        except (TypeError, ValueError):  # too few, or other than numbers
            problems.append(Problem(path, f"line {line}", repr(",".join(cells))[:80], EXPECTED))
    raise_problems(first_problems(problems, path) if rows else [Problem(path, "lines", "none", EXPECTED)])
    return tuple(marks)


def _mark(kind: str, frame: str, *ends: str) -> LevelMark:
    at, (x1, y1, x2, y2) = frame_number(frame), map(number, ends)
    known = kind in ("horizon", "vertical") and np.isfinite([x1, y1, x2, y2]).all()
    if at is None or not known or (x1, y1) == (x2, y2):
        raise ValueError
    return kind, at, ((x1, y1), (x2, y2))
