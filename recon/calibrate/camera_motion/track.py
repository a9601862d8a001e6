"""Track a turning camera: process frames one after the other, and return the camera's orientation in each.

Keyframes are remembered, and later frames are compared with them. This module also draws a panorama of everything the
camera has seen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.sparse import bsr_array, csc_array, diags_array
from scipy.sparse.linalg import SuperLU, splu
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Bools, Integers
from recon.calibrate.camera_motion import rotation as turning
from recon.calibrate.camera_motion.rotation import AgreedOrientation, GreyPicture, Orientation
from recon.geometry.camera import Camera
from recon.io.video import Image

LIMIT = 1 / 320
"""Largest error of a point that agrees with a rotation, as a fraction of the picture's longer side."""
MIN_CORNERS = 40
"""Smallest number of corners in the background of a keyframe."""
NEW_KEY_LIKENESS = 0.7
"""Likeness to the nearest keyframe below which a frame becomes a keyframe."""
MIN_LIKENESS = 0.25
"""Likeness from which a frame is compared with a keyframe."""
NEW_KEY_SUPPORT = 0.6
"""Fraction of the best support of a rotation since the last keyframe below which a frame becomes a keyframe."""
MIN_SUPPORT = 0.25
"""Fraction of the same support below which the frame is lost."""
BY_ZOOM = 5.0
"""Reduction of the likeness of two pictures per unit of difference in log zoom."""
KEYS_AT_ONCE = 3
"""Number of keyframes with which a frame is compared."""
KEYS_TO_LINK = 5
"""Number of keyframes with which a new keyframe is compared."""
MAX_PICTURES = 120
"""Maximum number of keyframes whose pictures stay in memory: those used last."""
LEARNING = 0.15
"""Fraction by which a frame changes how consistently a point has been background."""
SETTLED = 0.75
"""Agreement above which a point counts as background."""
LEAST_AGREEING = 0.6
"""Fraction of agreeing background points below which no single rotation explains the background."""
MAX_APART = 0.25
"""Fraction of frames whose background no single rotation explains, above which the camera has not only turned."""
MAX_PAIRS = 60
"""Number of pairs of pictures, those turned furthest, that determine the focal length."""
MIN_BACKGROUND = 0.4
"""Smallest agreement with the background of the points of such a pair."""
CLEAR_SIGMAS = 3.0
"""Number of standard deviations beyond which a focal length differs clearly from that of the camera file."""
MIN_STILL = 0.4
"""Smallest fraction of an old keyframe's background that stays in position."""
MAX_TORN = 1
"""Largest number of old keyframes with a smaller fraction."""
ADJUST_STEPS = 4
"""Number of Gauss-Newton steps in which all frames are adjusted together."""
PICTURE_FLOOR_PX = 0.1
"""Error that all points of a picture have in common, in pixels, and that their scatter does not show."""
MIN_PAIR_POINTS = 30
"""Smallest number of background points of a pair of pictures."""
MIN_PAIRS = 4
"""Smallest number of pairs of pictures that determine the focal length."""
WIDEST = 0.7
"""Largest absolute logarithm of a factor on the focal length that is tried."""
STEP = 1e-3
"""Change of the logarithm of the focal length for a numerical derivative."""
STEPS = 6
"""Number of steps to the focal length."""
ROUNDS = 4
"""Number of steps to the rotation between two pictures, for a given focal length."""
COARSE_ROUNDS = 2
"""The same where focal lengths are only tried."""
PAIR_FLOOR_PX = 0.15
"""Error that all points of a pair of pictures have in common, in pixels."""


@dataclass(eq=False)
class _Keyframe:
    """A frame, and N of its points, with which other frames are compared."""

    number: int
    """Index among the frames that have an orientation."""
    frame: GreyPicture | None
    """The picture; None if it was removed from memory."""
    points_px: Array
    """The points, shape (N, 2)."""
    orientation: Orientation
    background: Array
    """How consistently each point has been background, shape (N,), from 0 to 1."""
    known: tuple[Array, Image]
    """Points that can be recognised in any picture, as `describe_points` returns them."""
    rays: Array
    """Unit rays to the points in the camera frame, shape (N, 3)."""
    settled: Bools
    """Whether each point was ever clearly background, shape (N,)."""
    used: int
    """Number of the last frame that was compared with this keyframe."""

    @property
    def world_rays(self) -> Array:
        """Return the rays (N, 3) in the world frame."""
        return self.rays @ self.orientation.rotation


@dataclass(frozen=True, eq=False)
class TurningMotion:
    """Orientations of a camera in N of the F frames of a video."""

    frames: Integers
    """Frame numbers from 0, shape (N,)."""
    orientations: tuple[Orientation, ...]
    """Orientation in each of these frames."""
    inliers: Integers
    """Number of points that agree with each orientation, shape (N,)."""
    residual_px: Array
    """Root mean square error of these points, shape (N,)."""
    sigma_rad: Array
    """Standard deviation of each rotation about any axis, relative to the first frame, shape (N,).

    The effect of the focal length is included if its factor is clearly not 0.
    """
    sigma_zoom: Array
    """Relative standard deviation of each zoom, shape (N,)."""
    focal: tuple[float, float] | None
    """Log factor on the camera file's focal length, measured from the rotations, and its standard deviation."""
    lost: Integers
    """Numbers of the frames without enough background."""
    keys: Integers
    """Indices of the K keyframes among the N frames, shape (K,)."""
    turned_only: bool
    """Whether rotations explain the background."""
    cut: int | None
    """Number of the frame in which another take begins, or None."""


@dataclass(eq=False)
class Tracker:
    """Tracker of a turning camera, frame by frame.

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
    links: list[_FrameLink] = field(default_factory=list)
    """Links of `frames` to keyframes."""
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
    pairs: list[_TurnedPair] = field(default_factory=list)
    """Pairs of pictures that determine the focal length."""

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
        return LIMIT * max(self.camera.image_size_px)

    # -- one frame --

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
        """Return keyframes with a picture that look in a similar direction."""
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
        """Return the fraction of a frame's picture inside a keyframe's picture, reduced by a difference in zoom."""
        width, height = self.camera.image_size_px
        x, y = np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 9))
        rays, valid = turning.rays_of(self.camera, np.column_stack([x.ravel(), y.ravel()]), orientation.zoom)
        if not valid.any():
            return 0.0
        share_inside = turning.expected_px(self.camera, rays[valid] @ orientation.rotation, key.orientation)[1].mean()
        return float(share_inside) - BY_ZOOM * abs(np.log(orientation.zoom / key.orientation.zoom))

    def _relocalise(self, frame: GreyPicture, mask: Bools | None) -> Orientation | None:
        """Return the orientation from points recognised anywhere in the picture, after a jerk or lost frames."""
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

    # -- learning the background --

    def _learn(self, agreement: AgreedOrientation, seen: _FollowedPoints) -> bool:
        """Update which points are background, and return whether no single rotation explains them."""
        settled = still_agreeing = 0
        for k, key in enumerate(seen.keys):
            is_own = seen.key_index == k
            point_rows, agree = seen.point_index[is_own], agreement.agree[is_own]
            was_settled = key.settled[point_rows]
            settled = settled + int(was_settled.sum())
            still_agreeing = still_agreeing + int((was_settled & agree).sum())
            key.background[point_rows] += LEARNING * (np.where(agree, 1.0, 0.05) - key.background[point_rows])
            key.settled |= key.background > SETTLED
        return settled >= MIN_CORNERS and still_agreeing < LEAST_AGREEING * settled

    def _look_back(self, agreement: AgreedOrientation, seen: _FollowedPoints) -> None:
        """Record how much of an old keyframe's settled background is still in position.

        The keyframe is the oldest that looks in the same direction.
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
                    _TurnedPair(
                        key.number, key.points_px[seen.point_index[is_background]], seen.pixels[is_background], turn
                    )
                )
        if len(self.pairs) > 2 * MAX_PAIRS:
            self.pairs = _furthest_turned(self.pairs)

    def _link(
        self, index: int, key: _Keyframe, agreement: AgreedOrientation, seen: _FollowedPoints, is_own: Bools
    ) -> _FrameLink:
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
        """Make the frame a keyframe, with points trusted as much as the nearest tracked points."""
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

    # -- all frames --

    def finish(self) -> TurningMotion:
        """Adjust all frames together and return the camera's motion."""
        frames, lost = np.array(self.frames, dtype=np.int64), np.array(self.lost, dtype=np.int64)
        inliers, residual = np.array(self.supports, dtype=float).reshape(-1, 2).T
        keys = np.array([key.number for key in self.keys], dtype=np.int64)
        orientations: Sequence[Orientation] = self.orientations
        sigma, sigma_zoom = np.zeros((2, len(frames)))
        if self.links:
            floor_rad = PICTURE_FLOOR_PX / self.camera.matrix[0, 0]
            orientations, sigma, sigma_zoom = _adjust(orientations, self.links, self.solve_zoom, floor_rad)
        torn_count = sum(share < MIN_STILL for share in self.still_shares)
        turned_only = self.torn_frames <= MAX_APART * (len(frames) + len(lost)) and torn_count <= MAX_TORN
        pairs = _furthest_turned(self.pairs)
        focal = _focal_factor(self.camera, pairs, self._limit_px)
        if focal is not None and abs(focal[0]) > CLEAR_SIGMAS * focal[1]:
            turns = np.stack([orientation.rotation for orientation in orientations]) @ orientations[0].rotation.T
            sigma = np.hypot(sigma, abs(focal[0]) * Rotation.from_matrix(turns).magnitude())
        return TurningMotion(
            *(frames, tuple(orientations), inliers.astype(np.int64), residual, sigma, sigma_zoom, focal),
            *(lost, keys, turned_only, self.cut),
        )


class _FollowedPoints(NamedTuple):
    """N points of some keyframes, followed into one frame."""

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
        """Follow the keyframes' points into a frame."""
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


# -- adjust all frames and keyframes together, so that a camera that returns shows no drift ----------------------------


_FrameLink = tuple[int, int, Array, Array, Array, Array]
"""Link from a keyframe to a frame: index of the frame, index of the keyframe, rotation (3, 3), log zooms (2,), H (5, 5)
and g (5,).

The cost is e'He - 2 g'e. e holds the deviations from the link: of the rotation from keyframe to frame (rad), and of the
two log zooms.
"""


def _adjust(
    orientations: Sequence[Orientation], links: Sequence[_FrameLink], solve_zoom: bool, floor_rad: float
) -> tuple[tuple[Orientation, ...], Array, Array]:
    """Return the adjusted orientations of N frames, and the standard deviations of rotations and zooms.

    The first frame is fixed, and every other frame has at least one of the `links`. Standard deviations of rotations
    (N,) are in rad per axis relative to the first frame, those of zooms (N,) are relative. `floor_rad` is the angle of
    `PICTURE_FLOOR_PX`.
    """
    n, p = len(orientations), 4 if solve_zoom else 3
    rotation = np.stack([orientation.rotation for orientation in orientations])
    log_zoom = np.log([orientation.zoom for orientation in orientations])
    frame, key, measured, zooms, normal, gradient = map(np.stack, zip(*links, strict=True))
    rows, ends = np.arange(len(links) + 1), np.stack([frame, key], axis=1)
    weights, information, factor = bsr_array((normal, rows[:-1], rows)), None, None
    for _ in range(ADJUST_STEPS):
        turns = rotation[frame] @ rotation[key].swapaxes(1, 2)
        e = np.zeros((len(links), 5))
        e[:, :3] = Rotation.from_matrix(turns @ measured.swapaxes(1, 2)).as_rotvec()
        e[:, 3:] = log_zoom[ends] - zooms
        J = np.zeros((len(links), 2, 5, p))
        J[:, 0, :3, :3], J[:, 1, :3, :3] = np.eye(3), -turns
        if solve_zoom:
            J[:, 0, 3, 3] = J[:, 1, 4, 3] = 1.0
        slopes = bsr_array((J.reshape(-1, 5, p), ends.ravel(), 2 * rows), shape=(e.size, n * p))
        information = (slopes.T @ weights @ slopes).tocsc()
        fixed = np.where(np.arange(n * p) < p, 1e6 * information.max(), 0.0)
        factor = splu((information + diags_array(fixed)).tocsc())
        step = factor.solve(slopes.T @ (gradient.ravel() - weights @ e.ravel())).reshape(n, p)
        rotation = Rotation.from_rotvec(step[:, :3]).as_matrix() @ rotation
        if solve_zoom:
            log_zoom = log_zoom + step[:, 3]
    assert information is not None
    assert factor is not None
    sigma = np.sqrt(np.maximum(_variances(information, factor, frame, key, n), 0))
    adjusted = tuple(Orientation(r, float(z)) for r, z in zip(rotation, np.exp(log_zoom), strict=True))
    sigma_zoom = sigma[:, 3] if solve_zoom else np.zeros(n)
    return adjusted, np.hypot(np.sqrt((sigma[:, :3] ** 2).mean(axis=1)), floor_rad), sigma_zoom


def _variances(information: csc_array, factor: SuperLU, frame: Integers, key: Integers, n: int) -> Array:
    """Return the variances (n, P) of the unknowns of n frames.

    A keyframe's variance comes from the inverse of the information (n P, n P), whose factor is given. Other frames have
    their own variance plus the mean of their keyframes'. `frame` and `key` are the two ends of each link.
    """
    p = information.shape[0] // n
    variance = np.full((n, p), np.nan)
    for k in np.unique(key).tolist():
        variance[k] = np.diag(factor.solve(np.eye(n * p, p, -k * p))[k * p : (k + 1) * p])
    for t in np.flatnonzero(np.isnan(variance[:, 0])).tolist():
        own_rows = slice(t * p, (t + 1) * p)
        own_variance = np.diag(np.linalg.inv(information[own_rows, own_rows].toarray()))
        variance[t] = variance[key[frame == t]].mean(axis=0) + own_variance
    return variance


# -- the focal length: points keep their angles under rotations across the picture only for the right focal length -----


class _TurnedPair(NamedTuple):
    """Points followed from one picture to another, and the rotation between the pictures."""

    key: int
    """Number of the earlier picture's keyframe."""
    a_px: Array
    """The points in the earlier picture, shape (N, 2)."""
    b_px: Array
    """The points in the later picture, shape (N, 2)."""
    turn: Array
    """Rotation from the earlier to the later camera frame, shape (3, 3)."""


def _furthest_turned(pairs: Sequence[_TurnedPair]) -> list[_TurnedPair]:
    """Return the pairs of frames between which the camera turned furthest."""
    return sorted(pairs, key=lambda pair: -float(Rotation.from_matrix(pair.turn).magnitude()))[:MAX_PAIRS]


def _focal_factor(camera: Camera, pairs: Sequence[_TurnedPair], limit_px: float) -> tuple[float, float] | None:
    """Return the log factor of the focal length relative to the camera file's, and its standard deviation.

    The standard deviation combines that of the points and the scatter between earlier pictures. The result is None if
    too few pairs have points. `limit_px` is the largest error of a point.
    """
    if len(pairs) < MIN_PAIRS:
        return None
    every_few = pairs[:: max(1, len(pairs) // 12)]

    def cost(log_factor: float) -> float:
        sizes = [np.linalg.norm(_residuals_px(camera, pair, log_factor, COARSE_ROUNDS), axis=1) for pair in every_few]
        return sum(float(np.minimum(size / limit_px, 1.0).mean()) for size in sizes)

    log_factor = min(np.linspace(-WIDEST, WIDEST, 29).tolist(), key=cost)
    information, pull = np.ones((2, len(pairs)))
    for _ in range(STEPS):
        information, pull = np.transpose([_information(camera, pair, log_factor) for pair in pairs])
        step = pull.sum() / information.sum()
        log_factor = float(np.clip(log_factor + step, -2 * WIDEST, 2 * WIDEST))
        if abs(step) < 0.01 / np.sqrt(information.sum()):
            break
    keys, total = np.array([pair.key for pair in pairs]), float(information.sum())
    scatter = sum(pull[keys == key].sum() ** 2 for key in np.unique(keys)) / total**2
    return log_factor, float(np.sqrt(1 / total + scatter))


def _information(camera: Camera, pair: _TurnedPair, log_factor: float) -> tuple[float, float]:
    """Return a pair's information on the log factor, and the gradient."""
    residual_px, *ends = (_residuals_px(camera, pair, log_factor + change) for change in (0.0, STEP, -STEP))
    slope, weights, size = (ends[0] - ends[1]) / (2 * STEP), _weights(residual_px), np.linalg.norm(residual_px, axis=1)
    used = max(float(weights.sum()), 1.0)
    sigma2 = max(float(weights @ size**2) / (2 * used), 1e-4) + PAIR_FLOOR_PX**2 * used
    return float(weights @ (slope**2).sum(axis=1)) / sigma2, -float(
        weights @ (slope * residual_px).sum(axis=1)
    ) / sigma2


def _residuals_px(camera: Camera, pair: _TurnedPair, log_factor: float, rounds: int = ROUNDS) -> Array:
    """Return the residuals (N, 2) of a pair's points in its second picture after the best rotation."""
    zoom = float(np.exp(log_factor))
    (a, is_known), (b, is_seen) = (turning.rays_of(camera, points_px, zoom) for points_px in (pair.a_px, pair.b_px))
    is_known &= is_seen
    # the angle that shifts the picture as far at this focal length
    turn = Rotation.from_rotvec(Rotation.from_matrix(pair.turn).as_rotvec() / zoom)
    residual_px = np.full(pair.a_px.shape, 1e9)
    for number in range(rounds):
        if number:
            turn, _ = Rotation.align_vectors(b[is_known], a[is_known], weights=_weights(residual_px)[is_known])
        pixels, valid = turning.pixels_of(camera, turn.apply(np.where(is_known[:, None], a, b)), zoom)
        residual_px = np.where((is_known & valid)[:, None], pixels - pair.b_px, 1e9)
    return residual_px


def _weights(residual_px: Array) -> Array:
    """Return Tukey's weights (N,) for residuals (N, 2)."""
    size = np.linalg.norm(residual_px, axis=1)
    return turning.tukey(size, max(4 * float(np.median(size)), 1.0))


# -- the panorama: longitude to the right, latitude upward, in the level world -----------------------------------------

WIDTH_PX, HEIGHT_PX = 1920, 1080
"""Largest size of the panorama."""
THUMBNAIL_PX = 400
COARSE_PX = 8
"""Step between the pixels of the panorama whose position in a picture is computed; those in between are
interpolated.
"""
VIEW, PATH, ANIMAL = (0, 220, 255), (255, 200, 0), (80, 80, 255)


@dataclass(frozen=True)
class _Canvas:
    """Picture of a panorama: longitude to the right, latitude upwards."""

    west: float
    """Longitude of the upper left pixel, rad."""
    north: float
    """Latitude of the upper left pixel, rad."""
    step: float
    """Angle from one pixel to the next, rad."""
    size_px: tuple[int, int]
    """Width and height, both even."""

    @classmethod
    def around(cls, camera: Camera, orientations: Sequence[Orientation]) -> _Canvas:
        """Return a canvas that covers all views. Longitudes continue in the camera's direction beyond half a turn."""
        middle = np.unwrap([_angles(orientation.rotation[2])[0] for orientation in orientations])
        angles = [_angles(_edge(camera, view), centre) for view, centre in zip(orientations, middle, strict=True)]
        west, south = np.nanmin(angles, axis=(0, 2))
        east, north = np.nanmax(angles, axis=(0, 2))
        step = max((east - west) / WIDTH_PX, (north - south) / HEIGHT_PX)
        size = (max(2, int((east - west) / step) // 2 * 2), max(2, int((north - south) / step) // 2 * 2))
        return cls(float(west), float(north), float(step), size)

    def place(self, rays: Array) -> Array:
        """Return the pixels (N, 2) of world rays (N, 3), as close to the canvas as whole turns allow."""
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
        share = np.array(picture.shape[1::-1]) / size
        source_px = ((source_px + 0.5) * share - 0.5).astype(np.float32)
        warped = cv2.remap(
            picture, source_px[..., 0], source_px[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
        return np.asarray(warped, np.uint8), np.asarray(depth, float)


def thumbnail(picture: Image) -> Image:
    """Return a picture reduced to the size that the panorama needs."""
    scale = min(1.0, THUMBNAIL_PX / max(picture.shape))
    return np.asarray(cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def panorama(camera: Camera, motion: TurningMotion, pictures: Sequence[Image], points: Mapping[int, Array]) -> Image:
    """Draw the keyframes' pictures over each other, weighted by the distance from the picture's edge.

    The edges of the first, the middle and the last view are drawn, too, and the paths of the camera and of the animal.
    `pictures` has the `thumbnail` of each keyframe, `points` the animal's pixels (K, 2) by frame.
    """
    canvas = _Canvas.around(camera, motion.orientations)
    sum_of_pictures = np.zeros((canvas.size_px[1], canvas.size_px[0], 3), np.float32)
    weight = np.full(sum_of_pictures.shape[:2], 1e-6, np.float32)
    for key, picture in zip(motion.keys, pictures, strict=True):
        warped, depth = canvas.warp(camera, motion.orientations[key], picture)
        share = (depth**2).astype(np.float32)
        sum_of_pictures += share[..., None] * warped
        weight += share
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
    """Return longitude and latitude of rays (..., 3).

    The longitude is measured from the y axis towards the x axis, within half a turn of the middle.
    """
    x, y, z = np.moveaxis(rays, -1, 0)
    return middle_rad + (np.arctan2(x, y) - middle_rad + np.pi) % (2 * np.pi) - np.pi, np.arctan2(z, np.hypot(x, y))
