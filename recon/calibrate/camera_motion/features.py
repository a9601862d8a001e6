"""Points of a picture that can be found again, and finding them in another one."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from recon.base.arrays import Array, Bools, Integers
from recon.geometry.camera import Camera
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


def hull_mask(frame: GreyPicture, points_px: Array, margin: float = 0.15) -> Bools:
    """A mask (height, width) of the small picture: what the hull of points (N, 2) covers, widened by a share of its
    size."""
    mask = np.zeros(frame.grey.shape, np.uint8)
    points = frame.work_px(points_px[np.isfinite(points_px).all(axis=1)])
    if len(points):
        hull = cv2.convexHull(points.astype(np.float32)).reshape(-1, 2)
        wide = max(4, round(margin * float(np.linalg.norm(np.ptp(points, axis=0)))))
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
