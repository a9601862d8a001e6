"""Track a turning camera frame by frame, and return its orientation in each frame.

Some frames are stored as keyframes, with which later frames are compared.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Bools, Integers
from recon.calibrate.camera_motion import rotation as turning
from recon.calibrate.camera_motion.adjustment import (
    MAX_PAIRS,
    FrameLink,
    TurnedPair,
    adjust,
    focal_factor,
    furthest_turned,
)
from recon.calibrate.camera_motion.rotation import AgreedOrientation, GreyPicture, Orientation
from recon.geometry.camera import Camera
from recon.io.video import Image

MAX_ERROR = 1 / 320
"""Largest error of a point that agrees with a rotation, as a fraction of the picture's longer side."""
MIN_CORNERS = 40
"""Minimum number of corners in the background of a keyframe."""
NEW_KEY_LIKENESS = 0.7
"""Overlap with the nearest keyframe below which a frame becomes a keyframe."""
MIN_LIKENESS = 0.25
"""Minimum overlap of a frame with a keyframe for the two to be compared."""
NEW_KEY_SUPPORT = 0.6
"""`AgreedOrientation.spread`, relative to the largest since the last keyframe, below which a frame becomes a keyframe.
"""
MIN_SUPPORT = 0.25
"""`AgreedOrientation.spread`, relative to the largest since the last keyframe, below which a frame is lost."""
BY_ZOOM = 5.0
"""Reduction of the overlap of two pictures per unit of difference in log zoom."""
KEYS_AT_ONCE = 3
"""Number of keyframes with which a frame is compared."""
KEYS_TO_LINK = 5
"""Number of keyframes with which a new keyframe is compared."""
MAX_PICTURES = 120
"""Maximum number of keyframes whose pictures stay in memory, which are the most recently used keyframes."""
NEW_FRAME_WEIGHT = 0.15
"""Weight of a new frame in the running mean of a point's agreement with the background."""
MIN_AGREEMENT = 0.75
"""Agreement with the background, from 0 to 1, above which a point counts as background."""
MIN_AGREEING = 0.6
"""Fraction of background points that agree with a rotation, below which no single rotation explains the background."""
MAX_APART = 0.25
"""Fraction of frames whose background no single rotation explains, above which the camera has moved as well as turned.
"""
MIN_BACKGROUND = 0.4
"""Minimum agreement with the background, from 0 to 1, of the points that link two pictures."""
CLEAR_SIGMAS = 3.0
"""Deviation of the focal length from the camera file's, in standard deviations, above which it counts as different."""
MIN_STILL = 0.4
"""Minimum fraction of an old keyframe's background that is still in position if the camera only turned."""
MAX_TORN = 1
"""Maximum number of old keyframes whose background may be below `MIN_STILL` if the camera only turned."""
PICTURE_FLOOR_PX = 0.1
"""Standard deviation (px) of the error that all points of a picture have in common and their scatter does not show."""
MIN_PAIR_POINTS = 30
"""Minimum number of background points for a pair of pictures to be used in the estimate of the focal length."""


@dataclass(eq=False)
class _Keyframe:
    """Frame with which other frames are compared, with N of its points."""

    number: int
    """Index of the frame among the frames that have an orientation."""
    frame: GreyPicture | None
    """The picture; None if it was removed from memory."""
    points_px: Array
    """Positions of the points in the keyframe, shape (N, 2)."""
    orientation: Orientation
    background: Array
    """How consistently each point has been background, shape (N,), from 0 to 1."""
    known: tuple[Array, Image]
    """Points that can be recognised in any picture, with their descriptors, as `describe_points` returns them."""
    rays: Array
    """Unit rays to the points in the camera frame, shape (N, 3)."""
    settled: Bools
    """Mask of the points that were clearly background at any time, shape (N,)."""
    used: int
    """Number of the last frame that was compared with this keyframe."""

    @property
    def world_rays(self) -> Array:
        """Return unit rays (N, 3) to the keyframe's points in the world frame."""
        return self.rays @ self.orientation.rotation


@dataclass(frozen=True, eq=False)
class TurningMotion:
    """Orientations of a camera in the N frames of a video in which they are known."""

    frames: Integers
    """Numbers of the frames, counted from 0, shape (N,)."""
    orientations: tuple[Orientation, ...]
    """Orientation in each of `frames`."""
    inliers: Integers
    """Number of points that agree with each orientation, shape (N,)."""
    residual_px: Array
    """Root mean square error of the points that agree, shape (N,)."""
    sigma_rad: Array
    """Standard deviation of each rotation about any axis, relative to the first frame, shape (N,).

    The effect of the focal length is included if `focal` clearly differs from 0.
    """
    sigma_zoom: Array
    """Relative standard deviation of each zoom, shape (N,)."""
    focal: tuple[float, float] | None
    """Log ratio of the focal length measured from the rotations to the camera file's, and its standard deviation."""
    lost: Integers
    """Numbers of the frames without enough background."""
    keys: Integers
    """Indices of the K keyframes among the N frames, shape (K,)."""
    turned_only: bool
    """Whether rotations alone explain the motion of the background."""
    cut: int | None
    """Number of the frame in which another take begins, or None."""


@dataclass(eq=False)
class Tracker:
    """Tracker that finds the orientation of a turning camera frame by frame.

    The fields after `masked` are the state of the tracker.
    """

    camera: Camera
    solve_zoom: bool = False
    """Whether the camera may zoom."""
    masked: Callable[[int], Array | None] = lambda number: None
    """Function from a frame's number to the animal's pixels (K, 2), or None."""
    keys: list[_Keyframe] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    """Numbers of the frames that were aligned."""
    orientations: list[Orientation] = field(default_factory=list)
    """Orientation in each of `frames`."""
    supports: list[tuple[int, float]] = field(default_factory=list)
    """Number of agreeing points in each of `frames`, and their root mean square error in px."""
    links: list[FrameLink] = field(default_factory=list)
    """Measured rotations and zooms between `frames` and keyframes."""
    lost: list[int] = field(default_factory=list)
    """Numbers of the frames that could not be aligned."""
    torn_frames: int = 0
    """Number of frames whose background no single rotation explains."""
    support: float = 0.0
    """Largest `AgreedOrientation.spread` since the last keyframe."""
    last: GreyPicture | None = None
    """The last frame that was aligned."""
    still_shares: list[float] = field(default_factory=list)
    """Fractions of old keyframes' backgrounds that stayed in position."""
    cut: int | None = None
    """Number of the frame in which another take begins, or None."""
    pairs: list[TurnedPair] = field(default_factory=list)
    """Candidate pairs of pictures from which the focal length is estimated."""

    def add(self, number: int, picture: Image) -> bool:
        """Add a frame and return whether it could be aligned.

        If the frame begins another take, `cut` is its number afterwards.
        """
        frame = GreyPicture.from_colour(picture)
        points = self.masked(number)
        mask = None if points is None else turning.hull_mask(frame, points)
        if not self.keys:
            return self._begin(number, frame, mask)
        alignment = self._align(number, frame, mask, self._continued_turn(number), KEYS_AT_ONCE)
        if alignment is None and (recovered := self._relocalise(frame, mask)) is not None:
            alignment = self._align(number, frame, mask, recovered, KEYS_AT_ONCE)
        if alignment is None:
            self.lost.append(number)
            if len(turning.strongest_corners(frame, mask)) >= max(MIN_CORNERS, 0.5 * len(self.keys[-1].points_px)):
                is_same_scene = turning.is_same_scene(self.keys[-1].known, turning.describe_points(frame))
                self.torn_frames += is_same_scene
                if (
                    not is_same_scene
                    and self.frames[-1] == number - 1
                    and not (self.last and turning.is_similar(self.last, frame))
                ):
                    self.cut = number
            return False
        agreement, seen = alignment
        came_apart = self._learn(agreement, seen)
        self.torn_frames += came_apart
        self.support = max(self.support, agreement.spread)
        is_new_key = max(self._likeness(key, agreement.orientation) for key in seen.keys) < NEW_KEY_LIKENESS
        is_new_key |= agreement.spread < NEW_KEY_SUPPORT * self.support and not came_apart
        if is_new_key:
            agreement, seen = self._align(number, frame, mask, agreement.orientation, KEYS_TO_LINK) or alignment
            self._look_back(agreement, seen)
        self._keep(number, agreement, seen)
        self.last = frame
        if is_new_key:
            self._new_key(frame, mask, agreement, seen)
        return True

    @property
    def _limit_px(self) -> float:
        return MAX_ERROR * max(self.camera.image_size_px)

    def _begin(self, number: int, frame: GreyPicture, mask: Bools | None) -> bool:
        points = turning.strongest_corners(frame, mask)
        if len(points) < MIN_CORNERS:
            self.lost.append(number)
            return False
        self.frames.append(number)
        self.orientations.append(Orientation(np.eye(3)))
        self.supports.append((len(points), 0.0))
        self._remember(frame, points, np.full(len(points), 0.5))
        return True

    def _continued_turn(self, number: int) -> Orientation:
        """Return the orientation that the camera has if it continues to turn as before."""
        if len(self.orientations) < 2 or self.frames[-2:] != [number - 2, number - 1]:
            return self.orientations[-1]
        a, b = self.orientations[-2:]
        return Orientation(b.rotation @ a.rotation.T @ b.rotation, b.zoom * b.zoom / a.zoom)

    def _align(
        self, number: int, frame: GreyPicture, mask: Bools | None, guess: Orientation, count: int
    ) -> tuple[AgreedOrientation, _FollowedPoints] | None:
        keys = self._nearest(guess, count)
        points_seen = _FollowedPoints.follow(self.camera, keys, frame, guess, mask)
        for key in keys:
            key.used = number
        points = points_seen.rays, points_seen.pixels, points_seen.background
        agreement = turning.find_orientation(self.camera, *points, guess.zoom, self.solve_zoom, self._limit_px)
        enough = agreement is not None and agreement.spread > MIN_SUPPORT * self.support
        return (agreement, points_seen) if agreement is not None and enough else None

    def _nearest(self, orientation: Orientation, count: int) -> list[_Keyframe]:
        """Return the keyframes in memory that overlap most with a view, at most `count` of them."""
        pictures = [key for key in self.keys if key.frame is not None]
        by_direction = sorted(pictures, key=lambda key: -float(orientation.rotation[2] @ key.orientation.rotation[2]))
        by_likeness = sorted(
            ((self._likeness(key, orientation), key) for key in by_direction[: 2 * count]), key=lambda pair: -pair[0]
        )
        similar = [key for likeness, key in by_likeness if likeness >= MIN_LIKENESS]
        chosen = similar[:count]
        if count == KEYS_TO_LINK and similar[count:]:
            chosen.append(min(similar[count:], key=lambda key: key.number))
        return chosen or [key for _, key in by_likeness[:1]]

    def _likeness(self, key: _Keyframe, orientation: Orientation) -> float:
        """Return the overlap of a view with a keyframe.

        The overlap is the fraction of the view inside the keyframe's picture, reduced for a difference in zoom.
        """
        width, height = self.camera.image_size_px
        x, y = np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 9))
        rays, valid = turning.rays_of(self.camera, np.column_stack([x.ravel(), y.ravel()]), orientation.zoom)
        if not valid.any():
            return 0.0
        share_inside = turning.expected_px(self.camera, rays[valid] @ orientation.rotation, key.orientation)[1].mean()
        return float(share_inside) - BY_ZOOM * abs(np.log(orientation.zoom / key.orientation.zoom))

    def _relocalise(self, frame: GreyPicture, mask: Bools | None) -> Orientation | None:
        """Find the orientation after a jerk or lost frames, from points recognised anywhere in the picture."""
        pixels, descriptors = turning.describe_points(frame)
        recent = sorted((key for key in self.keys if key.frame is not None), key=lambda key: -key.used)[:20]
        rays, pixel_sets = [], []
        for key in recent:
            pairs = turning.match_descriptors(key.known[1], descriptors)
            key_rays, valid = turning.rays_of(self.camera, key.known[0][pairs[:, 0]], key.orientation.zoom)
            rays.append(key_rays[valid] @ key.orientation.rotation)
            pixel_sets.append(pixels[pairs[valid, 1]])
        if not rays:
            return None
        zoom, seen_px = self.orientations[-1].zoom, np.concatenate(pixel_sets)
        valid = turning.rays_of(self.camera, seen_px, zoom)[1]
        points = np.concatenate(rays)[valid], seen_px[valid], np.ones(valid.sum())
        agreement = turning.find_orientation(self.camera, *points, zoom, self.solve_zoom, 2 * self._limit_px)
        return None if agreement is None else agreement.orientation

    def _learn(self, agreement: AgreedOrientation, seen: _FollowedPoints) -> bool:
        """Update which points are background, and return whether too few of them agree with the orientation."""
        settled = still_agreeing = 0
        for k, key in enumerate(seen.keys):
            is_own = seen.key_index == k
            point_rows, agree = seen.point_index[is_own], agreement.agree[is_own]
            was_settled = key.settled[point_rows]
            settled = settled + int(was_settled.sum())
            still_agreeing = still_agreeing + int((was_settled & agree).sum())
            key.background[point_rows] += NEW_FRAME_WEIGHT * (np.where(agree, 1.0, 0.05) - key.background[point_rows])
            key.settled |= key.background > MIN_AGREEMENT
        return settled >= MIN_CORNERS and still_agreeing < MIN_AGREEING * settled

    def _look_back(self, agreement: AgreedOrientation, seen: _FollowedPoints) -> None:
        """Record how much of an old keyframe's settled background is still in position.

        The keyframe is the oldest one in the same direction.
        """
        k = min(range(len(seen.keys)), key=lambda k: seen.keys[k].number)
        key = seen.keys[k]
        is_inside = turning.expected_px(self.camera, key.world_rays, agreement.orientation)[1] & key.settled
        if is_inside.sum() >= MIN_CORNERS:
            point_rows = seen.point_index[(seen.key_index == k) & agreement.agree]
            self.still_shares.append(float(is_inside[point_rows].sum() / is_inside.sum()))

    def _keep(self, number: int, agreement: AgreedOrientation, seen: _FollowedPoints) -> None:
        self.frames.append(number)
        self.orientations.append(agreement.orientation)
        agree = agreement.agree
        error = np.linalg.norm(agreement.residual_px[agree], axis=1)
        self.supports.append((int(agree.sum()), float(np.sqrt((error**2).mean()))))
        index = len(self.frames) - 1
        for k, key in enumerate(seen.keys):
            is_own = (seen.key_index == k) & agree
            if is_own.sum() >= 8:
                self.links.append(self._link(index, key, agreement, seen, is_own))
            is_background = (seen.key_index == k) & (seen.background > MIN_BACKGROUND)
            if not self.solve_zoom and is_background.sum() >= MIN_PAIR_POINTS:
                turn = agreement.orientation.rotation @ key.orientation.rotation.T
                self.pairs.append(
                    TurnedPair(
                        key.number, key.points_px[seen.point_index[is_background]], seen.pixels[is_background], turn
                    )
                )
        if len(self.pairs) > 2 * MAX_PAIRS:
            self.pairs = furthest_turned(self.pairs)

    def _link(
        self, index: int, key: _Keyframe, agreement: AgreedOrientation, seen: _FollowedPoints, is_own: Bools
    ) -> FrameLink:
        orientation, J = agreement.orientation, agreement.jacobian[is_own]
        by_key = np.zeros((len(J), 2, 1))
        if self.solve_zoom:
            step = 1e-4
            points = key.points_px[seen.point_index[is_own]]
            ends = [
                turning.rays_of(self.camera, points, key.orientation.zoom * np.exp(change))[0]
                for change in (-step, step)
            ]
            turn = orientation.rotation @ key.orientation.rotation.T
            a, b = (turning.pixels_of(self.camera, rays @ turn.T, orientation.zoom)[0] for rays in ends)
            by_key = np.nan_to_num((b - a) / (2 * step))[:, :, None]
        J = np.concatenate([J, by_key], axis=2)
        weights = agreement.weights[is_own] / agreement.sigma_px**2
        normal, gradient = turning.normal_equations(J, weights, agreement.residual_px[is_own])
        zooms = np.log([orientation.zoom, key.orientation.zoom])
        return index, key.number, orientation.rotation @ key.orientation.rotation.T, zooms, normal, gradient

    def _new_key(
        self, frame: GreyPicture, mask: Bools | None, agreement: AgreedOrientation, seen: _FollowedPoints
    ) -> None:
        """Make the frame a keyframe, with background values taken from the nearest tracked points."""
        points = turning.strongest_corners(frame, mask)
        background = np.full(len(points), 0.5)
        if len(points) >= MIN_CORNERS:
            distance_px = np.linalg.norm(points[:, None] - seen.pixels, axis=2)
            nearest = distance_px.argmin(axis=1)
            is_close = distance_px[np.arange(len(points)), nearest] < 0.04 * max(self.camera.image_size_px)
            background[is_close] = np.clip(np.where(agreement.agree[nearest], 0.6, 0.2), 0, 1)[is_close]
            self._remember(frame, points, background)

    def _remember(self, frame: GreyPicture, points: Array, background: Array) -> None:
        self.support = 0.0
        orientation = self.orientations[-1]
        rays, valid = turning.rays_of(self.camera, points, orientation.zoom)
        description, settled = turning.describe_points(frame), np.zeros(int(valid.sum()), bool)
        content = points[valid], orientation, background[valid], description, rays[valid], settled
        self.keys.append(_Keyframe(len(self.frames) - 1, frame, *content, self.frames[-1]))
        with_picture = [key for key in self.keys if key.frame is not None]
        if len(with_picture) > MAX_PICTURES:
            min(with_picture, key=lambda key: key.used).frame = None

    def finish(self) -> TurningMotion:
        """Adjust all frames together and return the camera's motion."""
        frames, lost = np.array(self.frames, dtype=np.int64), np.array(self.lost, dtype=np.int64)
        inliers, residual = np.array(self.supports, dtype=float).reshape(-1, 2).T
        keys = np.array([key.number for key in self.keys], dtype=np.int64)
        orientations: Sequence[Orientation] = self.orientations
        sigma, sigma_zoom = np.zeros((2, len(frames)))
        if self.links:
            floor_rad = PICTURE_FLOOR_PX / self.camera.matrix[0, 0]
            orientations, sigma, sigma_zoom = adjust(orientations, self.links, self.solve_zoom, floor_rad)
        torn_count = sum(fraction < MIN_STILL for fraction in self.still_shares)
        turned_only = self.torn_frames <= MAX_APART * (len(frames) + len(lost)) and torn_count <= MAX_TORN
        pairs = furthest_turned(self.pairs)
        focal = focal_factor(self.camera, pairs, self._limit_px)
        if focal is not None and abs(focal[0]) > CLEAR_SIGMAS * focal[1]:
            turns = np.stack([orientation.rotation for orientation in orientations]) @ orientations[0].rotation.T
            sigma = np.hypot(sigma, abs(focal[0]) * Rotation.from_matrix(turns).magnitude())
        return TurningMotion(
            *(frames, tuple(orientations), inliers.astype(np.int64), residual, sigma, sigma_zoom, focal),
            *(lost, keys, turned_only, self.cut),
        )


class _FollowedPoints(NamedTuple):
    """N points of several keyframes, followed into one frame."""

    keys: list[_Keyframe]
    key_index: Integers
    """Index of each point's keyframe in `keys`, shape (N,)."""
    point_index: Integers
    """Index of each point in its keyframe, shape (N,)."""
    rays: Array
    """Unit rays to the points in the world frame, shape (N, 3)."""
    pixels: Array
    """Positions in the frame, shape (N, 2)."""
    background: Array
    """How consistently each point has been background, shape (N,), from 0 to 1."""

    @classmethod
    def follow(
        cls, camera: Camera, keys: list[_Keyframe], frame: GreyPicture, guess: Orientation, mask: Bools | None
    ) -> _FollowedPoints:
        """Find the keyframes' points in another frame, starting at the expected orientation `guess`."""
        no_rows = np.zeros(0, np.int64)
        parts: list[tuple[Any, ...]] = [(no_rows, no_rows, np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0))]
        for k, key in enumerate(keys):
            assert key.frame is not None
            world = key.world_rays
            expected, is_inside = turning.expected_px(camera, world, guess)
            rows = np.flatnonzero(is_inside)
            found_px, is_good = turning.follow_points(key.frame, frame, key.points_px[rows], expected[rows])
            is_good &= turning.rays_of(camera, found_px, guess.zoom)[1]
            if mask is not None:
                x, y = np.rint(frame.work_px(found_px)).astype(int).T
                height, width = mask.shape
                is_good &= ~mask[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
            rows = rows[is_good].astype(np.int64)
            parts.append(
                (np.full(len(rows), k, dtype=np.int64), rows, world[rows], found_px[is_good], key.background[rows])
            )
        joined: Any = map(np.concatenate, zip(*parts, strict=True))
        return cls(keys, *joined)
