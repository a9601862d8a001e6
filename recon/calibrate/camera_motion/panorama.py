"""What a turning camera has seen, all around: longitude to the right, latitude upward, in the level world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from recon.base.arrays import Array
from recon.calibrate.camera_motion.rotation import Orientation, expected_px, rays_of
from recon.calibrate.camera_motion.track import TurningMotion
from recon.geometry.camera import Camera
from recon.io.video import Image

WIDTH_PX, HEIGHT_PX = 1920, 1080
"""At most, as a whole."""
THUMBNAIL_PX = 400
COARSE_PX = 8
"""Pixels of the panorama whose place in a picture is reckoned; those between are interpolated."""
VIEW, PATH, ANIMAL = (0, 220, 255), (255, 200, 0), (80, 80, 255)


@dataclass(frozen=True)
class _Canvas:
    """Longitude and latitude (rad) of the upper left corner's pixel, rad a pixel, and (width, height), even."""

    west: float
    north: float
    step: float
    size_px: tuple[int, int]

    @classmethod
    def around(cls, camera: Camera, orientations: Sequence[Orientation]) -> _Canvas:
        """What all of the views together cover. The longitudes go on in the camera's direction past half a turn."""
        outline = _outline(camera)
        middle = np.unwrap([_angles(orientation.rotation[2])[0] for orientation in orientations])
        lon, lat = [], []
        for orientation, centre in zip(orientations, middle, strict=True):
            angles = _angles(rays_of(camera, outline, orientation.zoom)[0] @ orientation.rotation)
            lon.append(centre + (angles[0] - centre + np.pi) % (2 * np.pi) - np.pi)
            lat.append(angles[1])
        west, east, south, north = (f(part) for part in (lon, lat) for f in (np.nanmin, np.nanmax))
        step = max((east - west) / WIDTH_PX, (north - south) / HEIGHT_PX)
        size = (max(2, int((east - west) / step) // 2 * 2), max(2, int((north - south) / step) // 2 * 2))
        return cls(float(west), float(north), float(step), size)

    def place(self, rays: Array) -> Array:
        """Pixels (N, 2) of world rays (N, 3), as near to the canvas as they come."""
        lon, lat = _angles(rays)
        orientation = 2 * np.pi
        middle = self.west + self.step * self.size_px[0] / 2
        lon = middle + (lon - middle + np.pi) % orientation - np.pi
        return np.column_stack([(lon - self.west) / self.step, (self.north - lat) / self.step])

    def warped(self, camera: Camera, orientation: Orientation, picture: Image) -> tuple[Image, Array]:
        """A picture on the canvas, and how deep each pixel (height, width) lies within it: 1 in its middle, 0 outside.
        picture: of the camera's size or smaller."""
        width, height = self.size_px
        x, y = np.meshgrid(*(np.arange(0, n + COARSE_PX, COARSE_PX, dtype=float) for n in self.size_px))
        lon, lat = self.west + self.step * x, self.north - self.step * y
        rays = np.stack([np.cos(lat) * np.sin(lon), np.cos(lat) * np.cos(lon), np.sin(lat)], axis=-1)
        pixels, _ = expected_px(camera, rays.reshape(-1, 3), orientation)
        pixels = np.where(np.isfinite(pixels), pixels, -1e4).reshape(*x.shape, 2)
        fine = np.ascontiguousarray(np.clip(pixels, -1e4, 1e5), np.float32)
        matrix = np.array([[1 / COARSE_PX, 0, 0], [0, 1 / COARSE_PX, 0]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        at = cv2.warpAffine(fine, matrix, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        size = np.array(camera.image_size_px)
        depth = np.clip(1 - np.abs(2 * (at + 0.5) / size - 1), 0, None).min(axis=2)
        share = np.array(picture.shape[1::-1]) / size
        at = ((at + 0.5) * share - 0.5).astype(np.float32)
        warped = cv2.remap(picture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.asarray(warped, np.uint8), np.asarray(depth, float)


def thumbnail(picture: Image) -> Image:
    """As much of a picture as the panorama needs."""
    scale = min(1.0, THUMBNAIL_PX / max(picture.shape))
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def panorama(camera: Camera, motion: TurningMotion, pictures: Sequence[Image], points: Mapping[int, Array]) -> Image:
    """The keyframes' pictures laid over each other, the deeper within a picture, the more it counts; the edges of the
    first, the middle and the last view, and the camera's and the animal's path. pictures: `thumbnail` of each keyframe.
    points: the animal's pixels (K, 2) by frame."""
    canvas = _Canvas.around(camera, motion.orientations)
    total = np.zeros((canvas.size_px[1], canvas.size_px[0], 3), np.float32)
    weight = np.full(total.shape[:2], 1e-6, np.float32)
    for key, picture in zip(motion.keys, pictures, strict=True):
        warped, depth = canvas.warped(camera, motion.orientations[key], picture)
        share = (depth**2).astype(np.float32)
        total += share[..., None] * warped
        weight += share
    drawn = (total / weight[..., None]).astype(np.uint8)
    for row in (0, len(motion.orientations) // 2, -1):
        view = motion.orientations[row]
        _draw_path(canvas, drawn, rays_of(camera, _outline(camera), view.zoom)[0] @ view.rotation, VIEW)
    _draw_path(canvas, drawn, np.stack([orientation.rotation[2] for orientation in motion.orientations]), PATH)
    nowhere = np.full(2, np.nan)
    middles = [np.nanmean(points[i], axis=0) if i in points else nowhere for i in motion.frames.tolist()]
    ways = zip(middles, motion.orientations, strict=True)
    _draw_path(canvas, drawn, np.stack([rays_of(camera, px, one.zoom)[0] @ one.rotation for px, one in ways]), ANIMAL)
    return drawn


def _draw_path(canvas: _Canvas, picture: Image, rays: Array, colour: tuple[int, int, int]) -> None:
    """World rays (N, 3) as a line, broken where they are NaN or leave at one side for the other."""
    for a, b in pairwise(canvas.place(rays)):
        if np.isfinite([a, b]).all() and abs(a[0] - b[0]) < canvas.size_px[0] / 2:
            (x0, y0), (x1, y1) = np.rint([a, b]).astype(int).tolist()
            cv2.line(picture, (x0, y0), (x1, y1), colour, 2, cv2.LINE_AA)


def _outline(camera: Camera) -> Array:
    """Pixels (N, 2) once around the picture."""
    width, height = (n - 1 for n in camera.image_size_px)
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height), (0, 0)], dtype=float)
    share = np.linspace(0, 1, 17)[:, None]
    return np.concatenate([a + share * (b - a) for a, b in pairwise(corners)])


def _angles(rays: Array) -> tuple[Array, Array]:
    """Longitude, from the y axis to the x axis, and latitude of rays (..., 3)."""
    x, y, z = np.moveaxis(rays, -1, 0)
    return np.arctan2(x, y), np.arctan2(z, np.hypot(x, y))
