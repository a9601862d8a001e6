"""Draw a panorama of everything that a turning camera has seen, in the level world.

Longitude increases to the right, latitude upwards.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np

from recon.base.arrays import Array
from recon.calibrate.camera_motion import rotation as turning
from recon.calibrate.camera_motion.rotation import Orientation
from recon.calibrate.camera_motion.track import TurningMotion
from recon.geometry.camera import Camera
from recon.io.video import Image

WIDTH_PX, HEIGHT_PX = 1920, 1080
"""Maximum width and height of the panorama, px."""
THUMBNAIL_PX = 400
COARSE_PX = 8
"""Distance between the pixels of the panorama whose position in a picture is computed. Positions in between are
interpolated.
"""
VIEW, PATH, ANIMAL = (0, 220, 255), (255, 200, 0), (80, 80, 255)


@dataclass(frozen=True)
class _Canvas:
    """Area of a panorama, with longitude to the right and latitude upwards."""

    west: float
    """Longitude of the upper left pixel, rad."""
    north: float
    """Latitude of the upper left pixel, rad."""
    step: float
    """Angle from one pixel to the next, rad."""
    size_px: tuple[int, int]
    """Width and height of the panorama, both even."""

    @classmethod
    def around(cls, camera: Camera, orientations: Sequence[Orientation]) -> _Canvas:
        """Return a canvas that covers all views of the camera.

        Longitudes are continuous, and exceed half a turn if the camera does.
        """
        middle = np.unwrap([_angles(orientation.rotation[2])[0] for orientation in orientations])
        angles = [_angles(_edge(camera, view), centre) for view, centre in zip(orientations, middle, strict=True)]
        west, south = np.nanmin(angles, axis=(0, 2))
        east, north = np.nanmax(angles, axis=(0, 2))
        step = max((east - west) / WIDTH_PX, (north - south) / HEIGHT_PX)
        size = (max(2, int((east - west) / step) // 2 * 2), max(2, int((north - south) / step) // 2 * 2))
        return cls(float(west), float(north), float(step), size)

    def place(self, rays: Array) -> Array:
        """Return the pixels (N, 2) of world rays (N, 3), shifted by whole turns to be near the canvas."""
        lon, lat = _angles(rays, self.west + self.step * self.size_px[0] / 2)
        return np.column_stack([(lon - self.west) / self.step, (self.north - lat) / self.step])

    def warp(self, camera: Camera, orientation: Orientation, picture: Image) -> tuple[Image, Array]:
        """Return a picture warped onto the canvas, and the depth (height, width) of each pixel inside the picture.

        The depth is 1 in the middle of the picture and 0 outside. The picture may be smaller than the camera's.
        """
        width, height = self.size_px
        x, y = np.meshgrid(*(np.arange(0, n + COARSE_PX, COARSE_PX, dtype=float) for n in self.size_px))
        lon, lat = self.west + self.step * x, self.north - self.step * y
        rays = np.stack([np.cos(lat) * np.sin(lon), np.cos(lat) * np.cos(lon), np.sin(lat)], axis=-1)
        pixels, _ = turning.expected_px(camera, rays.reshape(-1, 3), orientation)
        pixels = np.where(np.isfinite(pixels), pixels, -1e4).reshape(*x.shape, 2)
        fine = np.ascontiguousarray(np.clip(pixels, -1e4, 1e5), np.float32)
        matrix = np.array([[1 / COARSE_PX, 0, 0], [0, 1 / COARSE_PX, 0]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        source_px = cv2.warpAffine(fine, matrix, (width, height), flags=flags, borderMode=cv2.BORDER_REPLICATE)
        size = np.array(camera.image_size_px)
        depth = np.clip(1 - np.abs(2 * (source_px + 0.5) / size - 1), 0, None).min(axis=2)
        fraction = np.array(picture.shape[1::-1]) / size
        source_px = ((source_px + 0.5) * fraction - 0.5).astype(np.float32)
        warped = cv2.remap(
            picture, source_px[..., 0], source_px[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(warped, np.uint8), np.asarray(depth, float)


def thumbnail(picture: Image) -> Image:
    """Return a picture reduced to the size that the panorama needs."""
    scale = min(1.0, THUMBNAIL_PX / max(picture.shape))
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def panorama(camera: Camera, motion: TurningMotion, pictures: Sequence[Image], points: Mapping[int, Array]) -> Image:
    """Blend the keyframes' pictures, weighted by the distance from the picture's edge.

    The panorama also shows the edges of the first, the middle and the last view, and the paths of the camera and of the
    animal. `pictures` holds the `thumbnail` of each keyframe, and `points` the animal's pixels (K, 2), keyed by frame.
    """
    canvas = _Canvas.around(camera, motion.orientations)
    sum_of_pictures = np.zeros((canvas.size_px[1], canvas.size_px[0], 3), np.float32)
    weight = np.full(sum_of_pictures.shape[:2], 1e-6, np.float32)
    for key, picture in zip(motion.keys, pictures, strict=True):
        warped, depth = canvas.warp(camera, motion.orientations[key], picture)
        fraction = (depth**2).astype(np.float32)
        sum_of_pictures += fraction[..., None] * warped
        weight += fraction
    image = (sum_of_pictures / weight[..., None]).astype(np.uint8)
    for row in (0, len(motion.orientations) // 2, -1):
        _draw_path(canvas, image, _edge(camera, motion.orientations[row]), VIEW)
    _draw_path(canvas, image, np.stack([orientation.rotation[2] for orientation in motion.orientations]), PATH)
    unknown = np.full(2, np.nan)
    middles = [np.nanmean(points[i], axis=0) if i in points else unknown for i in motion.frames.tolist()]
    steps = zip(middles, motion.orientations, strict=True)
    animal_rays = [turning.rays_of(camera, px, view.zoom)[0] @ view.rotation for px, view in steps]
    _draw_path(canvas, image, np.stack(animal_rays), ANIMAL)
    return image


def _draw_path(canvas: _Canvas, picture: Image, rays: Array, colour: tuple[int, int, int]) -> None:
    """Draw world rays (N, 3) as a line, broken where rays are NaN, and where it wraps around the canvas."""
    for a, b in pairwise(canvas.place(rays)):
        if np.isfinite([a, b]).all() and abs(a[0] - b[0]) < canvas.size_px[0] / 2:
            (x0, y0), (x1, y1) = np.rint([a, b]).astype(int).tolist()
            cv2.line(picture, (x0, y0), (x1, y1), colour, 2, cv2.LINE_AA)


def _edge(camera: Camera, view: Orientation) -> Array:
    """Return world rays (N, 3) around the edge of a view's picture."""
    width, height = (n - 1 for n in camera.image_size_px)
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height), (0, 0)], dtype=float)
    outline = np.concatenate(np.linspace(corners[:-1], corners[1:], 17, axis=1))
    return turning.rays_of(camera, outline, view.zoom)[0] @ view.rotation


def _angles(rays: Array, middle_rad: float = 0.0) -> tuple[Array, Array]:
    """Return longitude and latitude of rays (..., 3), rad.

    The longitude is measured from the y axis towards the x axis, within half a turn of the middle.
    """
    x, y, z = np.moveaxis(rays, -1, 0)
    return middle_rad + (np.arctan2(x, y) - middle_rad + np.pi) % (2 * np.pi) - np.pi, np.arctan2(z, np.hypot(x, y))
