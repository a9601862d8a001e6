"""How a camera has turned, from points whose directions are known: by how much of the picture agrees.

A subject that is followed covers much of the picture, has more structure than the background, and agrees with itself.
It lies together, though, where the background lies all around: a turn is worth what its points cover times how widely
they are spread, not how many they are.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Bools
from recon.calibrate.camera_motion.features import focus_px, pixels_of
from recon.geometry.camera import Camera

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
    camera: Camera,
    rays: Array,
    seen_px: Array,
    seen_rays: Array,
    background: Array,
    zoom: float,
    *,
    solve_zoom: bool,
    limit_px: float,
) -> AgreedOrientation | None:
    """The turn that takes world rays (N, 3) to where they are seen, pixels (N, 2) and rays (N, 3) at about that zoom.

    background: (N,) from 0 to 1, how far each has been background so far. None where too few points agree or they
    cover too little.
    """
    if len(rays) < MIN_POINTS:
        return None
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
        found = refined(camera, rays, seen_px, Orientation(tried[h], zoom), solve_zoom=solve_zoom, limit_px=limit_px)
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
    camera: Camera, rays: Array, seen_px: Array, orientation: Orientation, *, solve_zoom: bool, limit_px: float
) -> AgreedOrientation | None:
    """Robust least squares in pixels, from a turn nearby (Tukey's weights, with a limit that follows the scatter)."""
    free = slice(0, 4 if solve_zoom else 3)
    limit, rounds = limit_px, ROUNDS
    while True:
        residual, jacobian = _linearised(camera, rays, seen_px, orientation)
        size = np.linalg.norm(residual, axis=1)
        weights = np.maximum(1 - (size / limit) ** 2, 0) ** 2
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
