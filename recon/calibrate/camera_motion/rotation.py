"""Track points between pictures, and estimate the camera's rotation between them.

A subject that the camera follows can cover much of the picture and have more texture than the background, and the
motions of its points agree with each other. However, these points are close together, whereas background points
surround them. Rotations are therefore ranked by the area that the agreeing points cover times their spread, not by
their number.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Bools, Integers
from recon.geometry.camera import Camera
from recon.io.video import Image

WORK_PX = 1280
"""Maximum side of the pictures in which points are tracked, px. Larger pictures are reduced by an integer factor."""
CELLS = (16, 9)
"""Number of cells along the longer and the shorter side. Points are taken from each cell, so that finely textured parts
of the picture do not dominate.
"""
POINTS_IN_CELL = 3
"""Maximum number of points that are taken from a cell."""
BLOCK_PX = 5
"""Side of the window over which a corner's strength is computed."""
LEVELS = 3
"""Number of times that the pictures are halved in size to follow points over long distances."""
MIN_CORNER = 4e-5
"""Minimum minor eigenvalue of a corner's structure tensor. Noise of two grey levels gives less than 3e-5."""
MAX_UNLIKE = 3.0
"""Difference of a point's surroundings between two pictures, relative to the median of all points, above which the
point is hidden.
"""
MIN_UNLIKE = 8.0
"""Difference of a point's surroundings between two pictures, grey levels, up to which no point counts as hidden."""
ORB_POINTS = 700
"""Number of points per picture for which descriptors are computed."""
MIN_SAME = 20
"""Minimum number of matching descriptors for two pictures to count as the same scene."""
MIN_ALIKE = 0.7
"""Minimum correlation of two reduced pictures for the pictures to count as similar."""
HULL_MARGIN = 0.15
"""Margin around the animal's points, as a fraction of their extent."""


@dataclass(frozen=True)
class GreyPicture:
    """Grey picture in which points are tracked, reduced from the original by an integer factor."""

    grey: Image
    scale: int
    """Factor by which the original picture was reduced."""

    @classmethod
    def from_colour(cls, picture: Image) -> GreyPicture:
        """Return the grey picture of a colour picture."""
        grey = cv2.cvtColor(picture, cv2.COLOR_BGR2GRAY)
        scale = -(-max(grey.shape) // WORK_PX)
        if scale > 1:
            size = (grey.shape[1] // scale, grey.shape[0] // scale)
            grey = cv2.resize(grey[: size[1] * scale, : size[0] * scale], size, interpolation=cv2.INTER_AREA)
        return cls(np.asarray(grey, dtype=np.uint8), scale)

    @property
    def window_px(self) -> int:
        """Return the side of the window around a point that is compared between pictures, px.

        Small pictures have smaller windows, since a window should show a single object.
        """
        return int(np.clip(max(self.grey.shape) // 40, 11, 21)) | 1

    def full_px(self, work_px: Array) -> Array:
        """Return pixels (N, 2) of the original picture from pixels of the working picture."""
        return (work_px + 0.5) * self.scale - 0.5

    def work_px(self, full_px: Array) -> Array:
        """Return pixels (N, 2) of the working picture from pixels of the original picture."""
        return (full_px + 0.5) / self.scale - 0.5


def strongest_corners(frame: GreyPicture, masked: Bools | None = None) -> Array:
    """Return the strongest corners of every cell outside the mask, as pixels (N, 2) of the original picture.

    `masked` has the shape (height, width) of the working picture. None masks nothing.
    """
    grey = cv2.GaussianBlur(frame.grey, (0, 0), 1.0)
    strength = cv2.cornerMinEigenVal(grey, BLOCK_PX)
    peak = (strength == cv2.dilate(strength, np.ones((9, 9), np.uint8))) & (strength > MIN_CORNER)
    edge = frame.window_px // 2
    is_inside = np.zeros_like(peak)
    is_inside[edge:-edge, edge:-edge] = True
    peak &= is_inside if masked is None else is_inside & ~masked
    y, x = np.nonzero(peak)
    height, width = grey.shape
    across, down = CELLS if width >= height else CELLS[::-1]
    cell = (y * down // height) * across + x * across // width
    # Corners are sorted by cell and, within a cell, by decreasing strength. The rank of a corner is its position in the
    # cell.
    order = np.lexsort((-strength[y, x], cell))
    cell = cell[order]
    rank = np.arange(len(cell)) - np.searchsorted(cell, cell)
    chosen = order[rank < POINTS_IN_CELL]
    return frame.full_px(np.column_stack([x[chosen], y[chosen]]).astype(float))


def follow_points(earlier: GreyPicture, later: GreyPicture, points_px: Array, guess_px: Array) -> tuple[Array, Bools]:
    """Return the positions of points (N, 2) in another picture, px, and a mask of the points that were found.

    The search starts at `guess_px`, the expected positions (N, 2).
    """
    if not len(points_px):
        return np.zeros((0, 2)), np.zeros(0, bool)
    found_px, status, unlike = cv2.calcOpticalFlowPyrLK(
        earlier.grey,
        later.grey,
        earlier.work_px(points_px).astype(np.float32),
        later.work_px(guess_px).astype(np.float32),
        winSize=(earlier.window_px, earlier.window_px),
        maxLevel=LEVELS,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
    )
    height, width = later.grey.shape
    is_inside = ((found_px > 2) & (found_px < (width - 3, height - 3))).all(axis=1)
    is_good = (status[:, 0] > 0) & is_inside
    if is_good.any():
        is_good &= unlike[:, 0] < max(MIN_UNLIKE, MAX_UNLIKE * float(np.median(unlike[is_good])))
    return later.full_px(found_px.astype(float)), is_good


def describe_points(frame: GreyPicture) -> tuple[Array, Image]:
    """Return pixels (N, 2) and descriptors (N, 32) of points that can be recognised in any other picture."""
    side = frame.window_px * 3 // 2
    finder = cv2.ORB.create(ORB_POINTS, edgeThreshold=side, patchSize=side)
    points, descriptors = finder.detectAndCompute(frame.grey, None)
    if descriptors is None:
        return np.zeros((0, 2)), np.zeros((0, 32), np.uint8)
    work = np.array([point.pt for point in points])
    return frame.full_px(work), np.asarray(descriptors, dtype=np.uint8)


def is_same_scene(a: tuple[Array, Image], b: tuple[Array, Image]) -> bool:
    """Return whether a homography maps the points (pixels, descriptors) of one picture to the points of another."""
    pairs = match_descriptors(a[1], b[1])
    if len(pairs) < MIN_SAME:
        return False
    positions = [picture[0][pairs[:, i]].astype(np.float32) for i, picture in enumerate((a, b))]
    limit = 0.01 * float(np.ptp(positions[0], axis=0).max())
    _, is_same = cv2.findHomography(positions[0], positions[1], cv2.RANSAC, max(limit, 2.0))
    return is_same is not None and int(is_same.sum()) >= MIN_SAME


def is_similar(a: GreyPicture, b: GreyPicture) -> bool:
    """Return whether the brightness of two pictures is distributed similarly, as in adjacent frames of a take."""
    small = [cv2.resize(picture.grey, (16, 16), interpolation=cv2.INTER_AREA).ravel() for picture in (a, b)]
    return bool(np.asarray(np.corrcoef(small))[0, 1] > MIN_ALIKE)


def match_descriptors(a: Image, b: Image) -> Integers:
    """Return the index pairs (N, 2) of descriptors that are each other's nearest neighbours."""
    if not len(a) or not len(b):
        return np.zeros((0, 2), np.int64)
    matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(a, b)
    return np.array([(m.queryIdx, m.trainIdx) for m in matches], dtype=np.int64).reshape(-1, 2)


def hull_mask(frame: GreyPicture, points_px: Array) -> Bools:
    """Return a mask (height, width) of the working picture with the hull of points (N, 2) and a margin."""
    mask = np.zeros(frame.grey.shape, np.uint8)
    points = frame.work_px(points_px[np.isfinite(points_px).all(axis=1)])
    if len(points):
        hull = cv2.convexHull(points.astype(np.float32)).reshape(-1, 2)
        margin_px = max(4, round(HULL_MARGIN * float(np.linalg.norm(np.ptp(points, axis=0)))))
        polygon = [hull.round().astype(np.int32)]
        cv2.fillPoly(mask, polygon, 1)
        cv2.polylines(mask, polygon, True, 1, 2 * margin_px)
    return mask.astype(bool)


def focus_px(camera: Camera) -> Array:
    """Return the point (2,) of the picture that zooming does not move."""
    return camera.matrix[:2, 2]


def rays_of(camera: Camera, pixels: Array, zoom: float = 1.0) -> tuple[Array, Bools]:
    """Return unit rays (N, 3) through pixels (N, 2), and a mask of valid rays.

    `zoom` is the focal length relative to the camera file's.
    """
    return camera.rays(focus_px(camera) + (pixels - focus_px(camera)) / zoom)


def pixels_of(camera: Camera, rays: Array, zoom: float = 1.0) -> tuple[Array, Bools]:
    """Return the pixels (N, 2) of rays (N, 3), and a mask of valid pixels, as the inverse of `rays_of`."""
    pixels, valid = camera.project(rays)
    return focus_px(camera) + zoom * (pixels - focus_px(camera)), valid


GRID = (12, 12)
TRIALS = 300
"""Number of trial rotations."""
CANDIDATES = 10
"""Number of the best trial rotations that are refined."""
MIN_APART = 0.12
"""Minimum distance between the two points that define a trial rotation, as a fraction of the picture's diagonal."""
MIN_POINTS = 15
"""Minimum number of points that have to agree with a rotation."""
MIN_SPREAD = 0.2
"""Smallest spread of the agreeing points over the picture, as `cover_and_spread` returns it."""
FINAL_LIMIT = 0.5
"""Maximum factor applied to the error limit in the final steps, where the limit follows the scatter of the points."""
MIN_LIMIT = 0.2
"""Minimum factor applied to the error limit in the final steps."""
ROUNDS = 6
"""Number of steps of robust least squares."""


@dataclass(frozen=True, eq=False)
class Orientation:
    """Orientation and zoom of a camera."""

    rotation: Array
    """Rotation from the world to the camera, shape (3, 3)."""
    zoom: float = 1.0
    """Focal length relative to the focal length in the camera file."""


@dataclass(frozen=True, eq=False)
class AgreedOrientation:
    """Orientation of a camera, and how well N points agree with the orientation."""

    orientation: Orientation
    weights: Array
    """Weights of the points, shape (N,), 0 for points that do not agree."""
    residual_px: Array
    """Observed minus expected pixels, shape (N, 2)."""
    jacobian: Array
    """Derivatives of the expected pixels with respect to a small rotation (rad) in the camera frame and log zoom, (N,
    2, 4).
    """
    sigma_px: float
    """Standard deviation of the residuals of the points that agree, px along each axis."""
    spread: float
    """Covered fraction of the picture times the points' spread, both as `cover_and_spread` returns them."""

    @property
    def agree(self) -> Bools:
        """Return a mask of the points that agree, shape (N,)."""
        return self.weights > 0


def cover_and_spread(pixels: Array, size_px: tuple[int, int], weights: Array) -> tuple[Array, Array]:
    """Return the fractions (H,) of the picture's area covered by H sets of points, and the spreads (H,) of the points.

    `pixels` (N, 2) are the points, `weights` (H, N), 0 to 1, their weights in each set. The spread is 1 for points all
    over the picture.
    """
    across, down = GRID
    x, y = (np.clip(pixels[:, i] / size_px[i] * GRID[i], 0, GRID[i] - 1).astype(int) for i in (0, 1))
    in_cell = np.zeros((len(pixels), across * down))
    in_cell[np.arange(len(pixels)), y * across + x] = 1.0
    covered = np.minimum(weights @ in_cell, 1.0)
    cx, cy = np.tile(np.arange(across) / across, down), np.repeat(np.arange(down) / down, across)
    moments = covered @ np.column_stack([np.ones_like(cx), cx, cy, cx * cx, cy * cy, cx * cy])
    total = np.maximum(moments[:, 0], 1e-9)
    mx, my, xx, yy, xy = (moments[:, i] / total for i in range(1, 6))
    determinant = (xx - mx * mx) * (yy - my * my) - (xy - mx * my) ** 2
    return total / (across * down), 12 * np.sqrt(np.maximum(determinant, 0))


def find_orientation(
    camera: Camera, rays: Array, seen_px: Array, background: Array, zoom: float, solve_zoom: bool, limit_px: float
) -> AgreedOrientation | None:
    """Find the orientation, with nearly the given zoom, that maps world rays (N, 3) to pixels (N, 2).

    The result is None if too few points agree, or if the points cover too little of the picture. `background` (N,),
    from 0 to 1, states how consistently each point has been part of the background so far. `limit_px` is the largest
    error of a point that agrees.
    """
    if len(rays) < MIN_POINTS:
        return None
    seen_rays, _ = rays_of(camera, seen_px, zoom)
    turns = _trial_rotations(rays, seen_rays, seen_px, camera.image_size_px)
    if not len(turns):
        return None
    misalignment = 1 - np.einsum("hij,nj,ni->hn", turns, rays, seen_rays, optimize=True)
    angle = limit_px / (camera.matrix[0, 0] * zoom)
    weights = background**2 * (misalignment < 0.5 * angle**2)
    coverage, area = cover_and_spread(seen_px, camera.image_size_px, weights)
    best: AgreedOrientation | None = None
    examined: list[Array] = []
    for h in np.argsort(-coverage * area)[:CANDIDATES]:
        if any(np.trace(turns[h] @ earlier.T) > 1 + 2 * np.cos(2 * angle) for earlier in examined):
            continue
        examined.append(turns[h])
        result = refine(camera, rays, seen_px, Orientation(turns[h], zoom), solve_zoom, limit_px)
        if result is None:
            continue
        c, a = cover_and_spread(seen_px, camera.image_size_px, (background**2 * result.agree)[None])
        result = replace(result, spread=float(c[0] * a[0]))
        if a[0] >= MIN_SPREAD and (best is None or result.spread > best.spread):
            best = result
    return best


def _trial_rotations(rays: Array, seen: Array, pixels: Array, size_px: tuple[int, int]) -> Array:
    """Return trial rotations (H, 3, 3) from pairs of points that are far enough apart in the picture."""
    rng = np.random.default_rng(0)
    i, j = rng.integers(0, len(rays), (2, 2 * TRIALS))
    is_apart = np.linalg.norm(pixels[i] - pixels[j], axis=1) > MIN_APART * np.hypot(*size_px)
    i, j = i[is_apart][:TRIALS], j[is_apart][:TRIALS]
    return _axes(seen[i], seen[j]) @ _axes(rays[i], rays[j]).swapaxes(1, 2)


def _axes(a: Array, b: Array) -> Array:
    """Return right-handed axes (H, 3, 3), as columns, for pairs of rays, each (H, 3)."""
    columns = [a + b, a - b, np.cross(b, a)]
    return np.stack([c / np.linalg.norm(c, axis=1, keepdims=True) for c in columns], axis=2)


def refine(
    camera: Camera, rays: Array, seen_px: Array, orientation: Orientation, solve_zoom: bool, limit_px: float
) -> AgreedOrientation | None:
    """Refine an orientation that is close to the solution, by robust least squares in pixels.

    The weights are Tukey weights with a limit that follows the scatter.
    """
    free_columns = slice(0, 4 if solve_zoom else 3)
    limit, rounds = limit_px, ROUNDS
    while True:
        residual, jacobian = _linearise(camera, rays, seen_px, orientation)
        size = np.linalg.norm(residual, axis=1)
        weights = tukey(size, limit)
        if (weights > 0).sum() < MIN_POINTS:
            return None
        if not rounds:
            sigma = float(np.sqrt((weights * size**2).sum() / (2 * weights.sum())))
            return AgreedOrientation(orientation, weights, residual, jacobian, max(sigma, 1e-3), 0.0)
        step, rounds = np.zeros(4), rounds - 1
        step[free_columns] = np.linalg.solve(*normal_equations(jacobian[:, :, free_columns], weights, residual))
        orientation = Orientation(
            Rotation.from_rotvec(step[:3]).as_matrix() @ orientation.rotation, orientation.zoom * float(np.exp(step[3]))
        )
        median = float(np.median(size[weights > 0]))
        limit = limit_px * float(np.clip(4 * median / limit_px, MIN_LIMIT, FINAL_LIMIT))


def tukey(size: Array, limit: float) -> Array:
    """Return Tukey weights for residuals of given magnitudes, 0 from the limit on."""
    return np.maximum(1 - (size / limit) ** 2, 0) ** 2


def normal_equations(jacobian: Array, weights: Array, residual_px: Array) -> tuple[Array, Array]:
    """Return the normal matrix (P, P) and the right-hand side (P,) of a weighted least-squares step.

    For N points, the Jacobian has the shape (N, 2, P), the weights (N,), and the residuals (N, 2).
    """
    flat = jacobian.reshape(-1, jacobian.shape[-1])
    weighted = (jacobian * weights[:, None, None]).reshape(flat.shape)
    return weighted.T @ flat, weighted.T @ residual_px.ravel()


def _linearise(camera: Camera, rays: Array, seen_px: Array, orientation: Orientation) -> tuple[Array, Array]:
    camera_rays = rays @ orientation.rotation.T
    pixels, by_point, _ = camera.project_with_jacobian(camera_rays)
    from_focus = orientation.zoom * (pixels - focus_px(camera))
    x, y, z = camera_rays.T
    zero = np.zeros_like(x)
    # Derivative of exp(w) p with respect to w, from w x p.
    by_turn = np.stack([zero, z, -y, -z, zero, x, y, -x, zero], axis=1).reshape(-1, 3, 3)
    jacobian = np.concatenate([orientation.zoom * by_point @ by_turn, from_focus[:, :, None]], axis=2)
    is_known = np.isfinite(from_focus[:, :1])
    return np.where(is_known, seen_px - focus_px(camera) - from_focus, 1e9), np.where(
        is_known[:, :, None], jacobian, 0.0
    )


def expected_px(camera: Camera, rays: Array, orientation: Orientation) -> tuple[Array, Bools]:
    """Return the pixels (N, 2) of world rays (N, 3), and a mask of the pixels inside the picture."""
    pixels, valid = pixels_of(camera, rays @ orientation.rotation.T, orientation.zoom)
    return pixels, valid & camera.in_image(np.where(valid[:, None], pixels, -1e9))
