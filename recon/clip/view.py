"""One camera's part of a clip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from recon.base.arrays import Array, Bools, Index
from recon.geometry.camera import Camera
from recon.geometry.frames import inverse, level_from_camera, rigid
from recon.geometry.rotations import euler_rotation


@dataclass(frozen=True, eq=False)
class View:
    """What one camera saw in the T frames of a clip, and from where. Metres, pixels of the distorted picture."""

    camera: Camera
    """Lens, intrinsics and the picture's size; a still camera's pose in the camera file is not read from here."""
    T_camera_world: Array
    """(T, 4, 4), or (4, 4) of a camera that stands still."""
    xy_px: Array
    """(T, J, 2): where the detector saw each keypoint, NaN where it did not."""
    confidence: Array
    """(T, J), 0 to 1."""
    intrinsics_px: Array | None = None
    """(T, 4): fx, fy, cx, cy of each frame, of a camera that zooms."""
    lead_frames: float = 0.0
    """Its pictures were taken that much later than the clip's frames: 0 up to 1 as given, with a lag that was found
    more or less."""
    turn_sigma_rad: Array | None = None
    """(T,): standard deviation of each pose's rotation about any axis, of a camera whose track says it."""

    @property
    def still(self) -> bool:
        return self.T_camera_world.ndim == 2

    @property
    def present(self) -> Bools:
        """(T, J)"""
        return np.isfinite(self.xy_px[..., 0])

    @property
    def rotation(self) -> Array:
        """R_camera_world (3, 3), or (T, 1, 3, 3) of a camera that moves: what it is multiplied with has joints, too."""
        return self.T_camera_world[:3, :3] if self.still else self.T_camera_world[:, None, :3, :3]

    @cached_property
    def centre_m(self) -> Array:
        """(T, 3): centre of projection, world frame."""
        return np.broadcast_to(inverse(self.T_camera_world)[..., :3, 3], (len(self.xy_px), 3))

    @property
    def focal_px(self) -> Array | float:
        """Geometric mean of fx and fy; (T,) of a camera that zooms."""
        if self.intrinsics_px is not None:
            return np.sqrt(self.intrinsics_px[:, 0] * self.intrinsics_px[:, 1])
        return float(np.sqrt(self.camera.matrix[0, 0] * self.camera.matrix[1, 1]))

    def turn_covariance_m2(self, points_m: Array) -> Array:
        """(T, J, 3, 3): the doubt of each pose's rotation, in points (T, J, 3) that are known by this camera alone."""
        off = points_m - self.centre_m[:, None]
        variance = np.zeros(len(off)) if self.turn_sigma_rad is None else self.turn_sigma_rad**2
        across = np.sum(off * off, axis=-1)[..., None, None] * np.eye(3) - off[..., :, None] * off[..., None, :]
        return variance[:, None, None, None] * across

    def part(self, frames: slice | Index) -> View:
        """Of these frames only."""
        return replace(
            self,
            T_camera_world=self.T_camera_world if self.still else self.T_camera_world[frames],
            xy_px=self.xy_px[frames],
            confidence=self.confidence[frames],
            intrinsics_px=None if self.intrinsics_px is None else self.intrinsics_px[frames],
            turn_sigma_rad=None if self.turn_sigma_rad is None else self.turn_sigma_rad[frames],
        )

    @property
    def turn_px(self) -> Array | float:
        """What the doubt of each pose's rotation moves in the picture's middle: (T,), or 0."""
        return 0.0 if self.turn_sigma_rad is None else self.focal_px * self.turn_sigma_rad

    @property
    def seen(self) -> Bools:
        """(T, J): keypoints that a detector can have found in the picture (`Camera.sees`)."""
        if self.intrinsics_px is None:
            return self.camera.sees(self.xy_px)
        near = self.camera.near(self.xy_px)
        return near & self.camera.rays(np.where(near[..., None], self._unzoomed_px, np.nan))[1]

    def corrected(self, correction: Array) -> View:
        """With an extrinsic correction (6,) of the camera: turned by angles about its axes
        (`recon.geometry.rotations`), then moved along them, X_camera = R(angles) X + metres."""
        if not correction.any():
            return self
        by = rigid(euler_rotation(correction[:3]), correction[3:])
        return replace(self, T_camera_world=by @ self.T_camera_world)

    def with_focal_scale(self, log_scale: float) -> View:
        """With a camera whose focal lengths are longer by a factor, given by its logarithm; not of one that zooms."""
        return replace(self, camera=self.camera.with_focal_scale(log_scale)) if log_scale else self

    def credible(self) -> View:
        """Without what no detector can have found in the picture (`Camera.sees`)."""
        return replace(self, xy_px=np.where(self.seen[..., None], self.xy_px, np.nan))

    def at_its_time(self, points_m: Array) -> Array:
        """Points (T, J, 3) of the clip's frames when this view's pictures were taken."""
        if not self.lead_frames or len(points_m) < 2:
            return points_m
        step = np.diff(points_m, axis=0)
        before, after = (np.concatenate(pair) for pair in ((step[:1], step), (step, step[-1:])))
        return points_m + self.lead_frames * np.where(np.isnan(after), before, after)  # goes on where a gap begins

    # -- projection; points are those of all T frames ---------------------------------------------------------------

    def to_camera(self, points_m: Array) -> Array:
        """Points (T, J, 3) of the world frame in the camera frame."""
        if self.still:
            return points_m @ self.T_camera_world[:3, :3].T + self.T_camera_world[:3, 3]
        R, t = self.T_camera_world[:, :3, :3], self.T_camera_world[:, :3, 3]
        return points_m @ R.swapaxes(1, 2) + t[:, None]

    def project(self, points_m: Array) -> tuple[Array, Bools]:
        """Pixels (T, J, 2) and validity (T, J), as `Camera.project`, of points (T, J, 3) of the world frame."""
        pixels, valid = self.camera.project(self.to_camera(points_m))
        return self._zoomed(pixels), valid

    def project_with_jacobian(self, points_m: Array) -> tuple[Array, Array, Bools]:
        """The same, with the pixels' exact derivatives (T, J, 2, 3) by the points, second."""
        pixels, by_point, valid = self.camera.project_with_jacobian(self.to_camera(points_m))
        if self.intrinsics_px is not None:
            by_point = self._zoom[:, None, :, :2] @ by_point
        return self._zoomed(pixels), by_point @ self.rotation, valid

    def rays(self) -> Array:
        """(T, J, 3): unit vectors in the world frame towards the keypoints, NaN where there is none."""
        rays, _ = self.camera.rays(self._unzoomed_px)
        return rays @ self.rotation if self.still else (rays[..., None, :] @ self.rotation)[..., 0, :]

    @cached_property
    def _zoom(self) -> Array:
        """(T, 2, 3): pixels of the camera's own matrix in the frame's pixels. The lens bends before either."""
        assert self.intrinsics_px is not None
        matrices = np.tile(np.eye(3), (len(self.intrinsics_px), 1, 1))
        matrices[:, 0, 0], matrices[:, 1, 1], matrices[:, 0, 2], matrices[:, 1, 2] = self.intrinsics_px.T
        matrices[:, 0, 1] = self.camera.matrix[0, 1] * matrices[:, 0, 0] / self.camera.matrix[0, 0]
        return (matrices @ np.linalg.inv(self.camera.matrix))[:, :2]

    @property
    def _unzoomed_px(self) -> Array:
        """(T, J, 2): the keypoints in pixels of the camera's own matrix."""
        if self.intrinsics_px is None:
            return self.xy_px
        linear, shift = self._zoom[:, None, :, :2], self._zoom[:, None, :, 2]
        return np.asarray(np.linalg.solve(linear, (self.xy_px - shift)[..., None]), dtype=float)[..., 0]

    def _zoomed(self, pixels: Array) -> Array:
        if self.intrinsics_px is None:
            return pixels
        return (self._zoom[:, None, :, :2] @ pixels[..., None])[..., 0] + self._zoom[:, None, :, 2]


def world_from_reference(first: Camera) -> Array:
    """T_world_reference (4, 4) of `recon.geometry.frames`, of a clip whose first camera stands still."""
    return np.eye(4) if first.knows_up else rigid(level_from_camera(first.up), np.zeros(3)) @ _pose(first)


def camera_poses(cameras: Sequence[Camera]) -> list[Array]:
    """T_camera_world (4, 4) of still cameras, in the world frame of `recon.geometry.frames`."""
    T_reference_world = inverse(world_from_reference(cameras[0]))
    return [_pose(camera) @ T_reference_world for camera in cameras]


def _pose(camera: Camera) -> Array:
    """T_camera_reference (4, 4)."""
    rotation = np.eye(3) if camera.rotation is None else camera.rotation
    return rigid(rotation, np.zeros(3) if camera.translation_m is None else camera.translation_m)


def still_view(camera: Camera, xy_px: Array, confidence: Array) -> View:
    """The only view of a clip, by a camera that stands still."""
    return View(camera, camera_poses([camera])[0], xy_px, confidence)
