"""Frames in, one after the other; how the camera was turned in each out, and a picture of what it has seen all around.
Keyframes are what is remembered."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, NamedTuple

import cv2
import numpy as np
from scipy.sparse import bsr_array, diags_array
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Bools, Integers
from recon.calibrate.camera_motion import rotation as turning
from recon.calibrate.camera_motion.rotation import AgreedOrientation, GreyPicture, Orientation
from recon.geometry.camera import Camera
from recon.io.video import Image

LIMIT = 1 / 320
"""A point that is further off than this share of the picture's longer side does not agree with a rotation that is
tried."""
MIN_CORNERS = 40
NEW_KEY_LIKENESS, MIN_LIKENESS = 0.7, 0.25
NEW_KEY_SUPPORT, MIN_SUPPORT = 0.6, 0.25
"""Shares of the most that a rotation has been worth since the last keyframe: below the first there is a new keyframe,
below the second the frame is lost."""
BY_ZOOM = 5.0
"""How much less alike two pictures are by the difference of their log zooms."""
KEYS_AT_ONCE, KEYS_TO_LINK = 3, 5
MAX_PICTURES = 120
"""Keyframes whose pictures are kept, the last ones used: what bounds the memory."""
LEARNING = 0.15
SETTLED, COME_APART, MAX_APART = 0.75, 0.6, 0.25
"""A point that has mostly agreed is background; where fewer than so many of these agree, the background has come apart,
and in more than so many frames it does so for a camera that has not only turned."""
MAX_PAIRS, MIN_BACKGROUND = 60, 0.4
"""The number of pairs of pictures that tell the focal length, those that are rotated furthest apart, and how far their
points have to have been background."""
CLEARLY = 3.0
"""Standard deviations from which on a focal length is another than the camera file's."""
MIN_STILL, MAX_TORN = 0.4, 1
"""The share of an old keyframe's background that has to be still in its place, but for so many times."""
ADJUST_STEPS = 4
PICTURE_FLOOR_PX = 0.1
"""How far all points of a picture may be off together, in pixels, which their scatter does not show."""
MIN_PAIR_POINTS, MIN_PAIRS = 30, 4
WIDEST = 0.7
"""The largest logarithm of a factor on the focal length that is tried."""
STEP, STEPS, ROUNDS, COARSE_ROUNDS = 1e-3, 6, 4, 2
PAIR_FLOOR_PX = 0.15
"""How far all points of a pair of pictures may be off together, in pixels."""


@dataclass(eq=False)
class _Keyframe:
    """A frame that others are compared with.

    number: its place among those that have a turn. frame: None where the picture has been forgotten. points_px, rays:
    (N, 2), (N, 3), camera frame. background: (N,) from 0 to 1, how far each point has been background. settled: (N,),
    whether one was. known: what `described` has found. used: the last frame that was compared with it.
    """

    number: int
    frame: GreyPicture | None
    points_px: Array
    orientation: Orientation
    background: Array
    known: tuple[Array, Image]
    rays: Array
    settled: Bools
    used: int

    @property
    def world_rays(self) -> Array:
        return self.rays @ self.orientation.rotation


@dataclass(frozen=True, eq=False)
class TurningMotion:
    """The rotations of a camera over F frames of a video, N of which have one. frames: (N,) numbers from 0. inliers,
    residual_px, sigma_rad, sigma_zoom: (N,). focal: what the turns say of the focal length, the log factor on the
    camera file's and its standard deviation; where it differs clearly, sigma_rad has what that does to the turns in it.
    lost: numbers of the frames without enough background. keys: (K,) places among the N frames.
    turned_only: whether the background has kept together. cut: the number of the frame where another take begins."""

    frames: Integers
    orientations: tuple[Orientation, ...]
    inliers: Integers
    residual_px: Array
    sigma_rad: Array
    sigma_zoom: Array
    focal: tuple[float, float] | None
    lost: Integers
    keys: Integers
    turned_only: bool
    cut: int | None


@dataclass(eq=False)
class Tracker:
    """masked: pixels (K, 2) of the animal in a frame, by its number, or None. What has been found so far: frames with
    their turns, supports (points that agree, their root mean square in px) and links; frames that were lost; in how
    many the background came apart, and how much of old keyframes' backgrounds was still in its place. support: the most
    that a turn has been worth since the last keyframe. last: the last frame that was placed."""

    camera: Camera
    solve_zoom: bool = False
    masked: Callable[[int], Array | None] = lambda number: None
    keys: list[_Keyframe] = field(default_factory=list)
    frames: list[int] = field(default_factory=list)
    orientations: list[Orientation] = field(default_factory=list)
    supports: list[tuple[int, float]] = field(default_factory=list)
    links: list[_FrameLink] = field(default_factory=list)
    lost: list[int] = field(default_factory=list)
    apart: int = 0
    support: float = 0.0
    last: GreyPicture | None = None
    still: list[float] = field(default_factory=list)
    cut: int | None = None
    pairs: list[_TurnedPair] = field(default_factory=list)

    def add(self, number: int, picture: Image) -> bool:
        """Whether the frame could be placed; afterwards `cut` says whether it is another take."""
        frame = GreyPicture.of(picture)
        points = self.masked(number)
        mask = None if points is None else turning.hull_mask(frame, points)
        if not self.keys:
            return self._begin(number, frame, mask)
        found = self._placed(number, frame, mask, self._predicted(number), KEYS_AT_ONCE)
        if found is None and (again := self._found_again(frame, mask)) is not None:
            found = self._placed(number, frame, mask, again, KEYS_AT_ONCE)
        if found is None:
            self.lost.append(number)
            if len(turning.corners(frame, mask)) >= max(MIN_CORNERS, 0.5 * len(self.keys[-1].points_px)):
                same = turning.same_scene(self.keys[-1].known, turning.described(frame))
                self.apart += same
                if not same and self.frames[-1] == number - 1 and not (self.last and turning.similar(self.last, frame)):
                    self.cut = number
            return False
        agreement, seen = found
        apart = self._learn(agreement, seen)
        self.apart += apart
        self.support = max(self.support, agreement.spread)
        new = max(self._likeness(key, agreement.orientation) for key in seen.keys) < NEW_KEY_LIKENESS
        new |= agreement.spread < NEW_KEY_SUPPORT * self.support and not apart
        if new:
            agreement, seen = self._placed(number, frame, mask, agreement.orientation, KEYS_TO_LINK) or found
            self._look_back(agreement, seen)
        self._keep(number, agreement, seen)
        self.last = frame
        if new:
            self._new_key(frame, mask, agreement, seen)
        return True

    @property
    def _limit_px(self) -> float:
        return LIMIT * max(self.camera.image_size_px)

    # -- one frame --

    def _begin(self, number: int, frame: GreyPicture, mask: Bools | None) -> bool:
        points = turning.corners(frame, mask)
        if len(points) < MIN_CORNERS:
            self.lost.append(number)
            return False
        self.frames.append(number)
        self.orientations.append(Orientation(np.eye(3)))
        self.supports.append((len(points), 0.0))
        self._remember(frame, points, np.full(len(points), 0.5))
        return True

    def _predicted(self, number: int) -> Orientation:
        """Turned on as before."""
        if len(self.orientations) < 2 or self.frames[-2:] != [number - 2, number - 1]:
            return self.orientations[-1]
        a, b = self.orientations[-2:]
        return Orientation(b.rotation @ a.rotation.T @ b.rotation, b.zoom * b.zoom / a.zoom)

    def _placed(
        self, number: int, frame: GreyPicture, mask: Bools | None, guess: Orientation, count: int
    ) -> tuple[AgreedOrientation, _Seen] | None:
        keys = self._nearest(guess, count)
        seen = _Seen.of(self.camera, keys, frame, guess, mask)
        for key in keys:
            key.used = number
        points = seen.rays, seen.pixels, seen.background
        agreement = turning.agreed_turn(self.camera, *points, guess.zoom, self.solve_zoom, self._limit_px)
        enough = agreement is not None and agreement.spread > MIN_SUPPORT * self.support
        return (agreement, seen) if agreement is not None and enough else None

    def _nearest(self, orientation: Orientation, count: int) -> list[_Keyframe]:
        """Keyframes with a picture that look the same way."""
        pictures = [key for key in self.keys if key.frame is not None]
        near = sorted(pictures, key=lambda key: -float(orientation.rotation[2] @ key.orientation.rotation[2]))
        best = sorted(((self._likeness(key, orientation), key) for key in near[: 2 * count]), key=lambda pair: -pair[0])
        alike = [key for likeness, key in best if likeness >= MIN_LIKENESS]
        kept = alike[:count]
        if count == KEYS_TO_LINK and alike[count:]:
            kept.append(min(alike[count:], key=lambda key: key.number))
        return kept or [key for _, key in best[:1]]

    def _likeness(self, key: _Keyframe, orientation: Orientation) -> float:
        """Share of a frame's picture that is in the keyframe's, less where it is larger or smaller there."""
        width, height = self.camera.image_size_px
        x, y = np.meshgrid(np.linspace(0, width - 1, 9), np.linspace(0, height - 1, 9))
        rays, valid = turning.rays_of(self.camera, np.column_stack([x.ravel(), y.ravel()]), orientation.zoom)
        if not valid.any():
            return 0.0
        inside = turning.expected_px(self.camera, rays[valid] @ orientation.rotation, key.orientation)[1].mean()
        return float(inside) - BY_ZOOM * abs(np.log(orientation.zoom / key.orientation.zoom))

    def _found_again(self, frame: GreyPicture, mask: Bools | None) -> Orientation | None:
        """By points that are known wherever they have gone: after a jerk, or a stretch without background."""
        pixels, descriptors = turning.described(frame)
        recent = sorted((key for key in self.keys if key.frame is not None), key=lambda key: -key.used)[:20]
        rays, places = [], []
        for key in recent:
            pairs = turning.matched(key.known[1], descriptors)
            there, valid = turning.rays_of(self.camera, key.known[0][pairs[:, 0]], key.orientation.zoom)
            rays.append(there[valid] @ key.orientation.rotation)
            places.append(pixels[pairs[valid, 1]])
        if not rays:
            return None
        zoom, seen = self.orientations[-1].zoom, np.concatenate(places)
        valid = turning.rays_of(self.camera, seen, zoom)[1]
        points = np.concatenate(rays)[valid], seen[valid], np.ones(valid.sum())
        found = turning.agreed_turn(self.camera, *points, zoom, self.solve_zoom, 2 * self._limit_px)
        return None if found is None else found.orientation

    # -- what is learnt --

    def _learn(self, agreement: AgreedOrientation, seen: _Seen) -> bool:
        """Which points are background; whether what was background has come apart."""
        settled = kept = 0
        for k, key in enumerate(seen.keys):
            own = seen.of_key == k
            at, agree = seen.place[own], agreement.agree[own]
            was = key.settled[at]
            settled, kept = settled + int(was.sum()), kept + int((was & agree).sum())
            key.background[at] += LEARNING * (np.where(agree, 1.0, 0.05) - key.background[at])
            key.settled |= key.background > SETTLED
        return settled >= MIN_CORNERS and kept < COME_APART * settled

    def _look_back(self, agreement: AgreedOrientation, seen: _Seen) -> None:
        """How much of the settled background of the oldest keyframe that looks the same way is still in its place."""
        k = min(range(len(seen.keys)), key=lambda k: seen.keys[k].number)
        key = seen.keys[k]
        inside = turning.expected_px(self.camera, key.world_rays, agreement.orientation)[1] & key.settled
        if inside.sum() >= MIN_CORNERS:
            at = seen.place[(seen.of_key == k) & agreement.agree]
            self.still.append(float(inside[at].sum() / inside.sum()))

    def _keep(self, number: int, agreement: AgreedOrientation, seen: _Seen) -> None:
        self.frames.append(number)
        self.orientations.append(agreement.orientation)
        agree = agreement.agree
        error = np.linalg.norm(agreement.residual_px[agree], axis=1)
        self.supports.append((int(agree.sum()), float(np.sqrt((error**2).mean()))))
        place = len(self.frames) - 1
        for k, key in enumerate(seen.keys):
            own = (seen.of_key == k) & agree
            if own.sum() >= 8:
                self.links.append(self._link(place, key, agreement, seen, own))
            back = (seen.of_key == k) & (seen.background > MIN_BACKGROUND)
            if not self.solve_zoom and back.sum() >= MIN_PAIR_POINTS:
                between = agreement.orientation.rotation @ key.orientation.rotation.T
                self.pairs.append(_TurnedPair(key.number, key.points_px[seen.place[back]], seen.pixels[back], between))
        if len(self.pairs) > 2 * MAX_PAIRS:
            self.pairs = _furthest_turned(self.pairs)

    def _link(self, place: int, key: _Keyframe, agreement: AgreedOrientation, seen: _Seen, own: Bools) -> _FrameLink:
        orientation, J = agreement.orientation, agreement.jacobian[own]
        by_key = np.zeros((len(J), 2, 1))
        if self.solve_zoom:
            step = 1e-4
            points = key.points_px[seen.place[own]]
            ends = [turning.rays_of(self.camera, points, key.orientation.zoom * np.exp(d))[0] for d in (-step, step)]
            between = orientation.rotation @ key.orientation.rotation.T
            a, b = (turning.pixels_of(self.camera, rays @ between.T, orientation.zoom)[0] for rays in ends)
            by_key = np.nan_to_num((b - a) / (2 * step))[:, :, None]
        J = np.concatenate([J, by_key], axis=2)
        weights = agreement.weights[own] / agreement.sigma_px**2
        normal, gradient = turning.normal_equations(J, weights, agreement.residual_px[own])
        zooms = np.log([orientation.zoom, key.orientation.zoom])
        return place, key.number, orientation.rotation @ key.orientation.rotation.T, zooms, normal, gradient

    def _new_key(self, frame: GreyPicture, mask: Bools | None, agreement: AgreedOrientation, seen: _Seen) -> None:
        """Its points are as trusted as the nearest that were followed into it."""
        points = turning.corners(frame, mask)
        background = np.full(len(points), 0.5)
        if len(points) >= MIN_CORNERS:
            apart = np.linalg.norm(points[:, None] - seen.pixels, axis=2)
            nearest = apart.argmin(axis=1)
            close = apart[np.arange(len(points)), nearest] < 0.04 * max(self.camera.image_size_px)
            background[close] = np.clip(np.where(agreement.agree[nearest], 0.6, 0.2), 0, 1)[close]
            self._remember(frame, points, background)

    def _remember(self, frame: GreyPicture, points: Array, background: Array) -> None:
        self.support = 0.0
        orientation = self.orientations[-1]
        rays, valid = turning.rays_of(self.camera, points, orientation.zoom)
        known, settled = turning.described(frame), np.zeros(int(valid.sum()), bool)
        seen = points[valid], orientation, background[valid], known, rays[valid], settled
        self.keys.append(_Keyframe(len(self.frames) - 1, frame, *seen, self.frames[-1]))
        with_picture = [key for key in self.keys if key.frame is not None]
        if len(with_picture) > MAX_PICTURES:
            min(with_picture, key=lambda key: key.used).frame = None

    # -- all of them --

    def finish(self) -> TurningMotion:
        """All frames adjusted together: the motion of the camera."""
        frames, lost = np.array(self.frames, dtype=np.int64), np.array(self.lost, dtype=np.int64)
        inliers, residual = np.array(self.supports, dtype=float).reshape(-1, 2).T
        keys = np.array([key.number for key in self.keys], dtype=np.int64)
        orientations: Sequence[Orientation] = self.orientations
        sigma, sigma_zoom = np.zeros((2, len(frames)))
        if self.links:
            floor_rad = PICTURE_FLOOR_PX / self.camera.matrix[0, 0]
            orientations, sigma, sigma_zoom = _adjust(orientations, self.links, self.solve_zoom, floor_rad)
        torn = sum(share < MIN_STILL for share in self.still)
        turned_only = self.apart <= MAX_APART * (len(frames) + len(lost)) and torn <= MAX_TORN
        pairs = _furthest_turned(self.pairs)
        focal = _focal_factor(self.camera, pairs, self._limit_px)
        if focal is not None and abs(focal[0]) > CLEARLY * focal[1]:
            turns = np.stack([one.rotation for one in orientations]) @ orientations[0].rotation.T
            sigma = np.hypot(sigma, abs(focal[0]) * Rotation.from_matrix(turns).magnitude())
        return TurningMotion(
            *(frames, tuple(orientations), inliers.astype(np.int64), residual, sigma, sigma_zoom, focal),
            *(lost, keys, turned_only, self.cut),
        )


class _Seen(NamedTuple):
    """Points of some keyframes in one frame. of_key, place: (N,), whose they are and which of its. rays: (N, 3), world.
    pixels: (N, 2). background: (N,)."""

    keys: list[_Keyframe]
    of_key: Integers
    place: Integers
    rays: Array
    pixels: Array
    background: Array

    @classmethod
    def of(
        cls, camera: Camera, keys: list[_Keyframe], frame: GreyPicture, guess: Orientation, mask: Bools | None
    ) -> _Seen:
        none = np.zeros(0, np.int64)
        parts: list[tuple[Any, ...]] = [(none, none, np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0))]
        for k, key in enumerate(keys):
            assert key.frame is not None
            world = key.world_rays
            expected, inside = turning.expected_px(camera, world, guess)
            at = np.flatnonzero(inside)
            found, good = turning.followed(key.frame, frame, key.points_px[at], expected[at])
            good &= turning.rays_of(camera, found, guess.zoom)[1]
            if mask is not None:
                x, y = np.rint(frame.work_px(found)).astype(int).T
                height, width = mask.shape
                good &= ~mask[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)]
            at = at[good].astype(np.int64)
            parts.append((np.full(len(at), k, dtype=np.int64), at, world[at], found[good], key.background[at]))
        joined: Any = map(np.concatenate, zip(*parts, strict=True))
        return cls(keys, *joined)


# -- all frames and keyframes, adjusted to what each saw of the others: a return shows no drift ------------------------


_FrameLink = tuple[int, int, Array, Array, Array, Array]
"""A frame's points in a keyframe: both by their place among the frames; turn (3, 3), log zooms (2,), H (5, 5) and g
(5,). Their cost is e'He - 2 g'e; e: how much further the frame is turned (rad) from the keyframe than by that turn, and
how far the log zooms of frame and keyframe are from these."""


def _adjust(
    orientations: Sequence[Orientation], links: Sequence[_FrameLink], solve_zoom: bool, floor_rad: float
) -> tuple[tuple[Orientation, ...], Array, Array]:
    """The turns of the N frames, of which the first stays; their standard deviations (N,), rad per axis, against the
    first frame; and those of the zooms (N,), relative. links: of every other frame at least one. floor_rad: see
    PICTURE_FLOOR_PX."""
    n, p = len(orientations), 4 if solve_zoom else 3
    rotation = np.stack([one.rotation for one in orientations])
    log_zoom = np.log([one.zoom for one in orientations])
    frame, key, measured, at, normal, gradient = map(np.stack, zip(*links, strict=True))
    rows, ends = np.arange(len(links) + 1), np.stack([frame, key], axis=1)
    weights, information, factor = bsr_array((normal, rows[:-1], rows)), None, None
    for _ in range(ADJUST_STEPS):
        between = rotation[frame] @ rotation[key].swapaxes(1, 2)
        e = np.zeros((len(links), 5))
        e[:, :3] = Rotation.from_matrix(between @ measured.swapaxes(1, 2)).as_rotvec()
        e[:, 3:] = log_zoom[ends] - at
        J = np.zeros((len(links), 2, 5, p))
        J[:, 0, :3, :3], J[:, 1, :3, :3] = np.eye(3), -between
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
    # of keyframes from the inverse; of a frame that is none, its own and its keyframes' on average
    variance = np.full((n, p), np.nan)
    for k in np.unique(key).tolist():
        variance[k] = np.diag(factor.solve(np.eye(n * p, p, -k * p))[k * p : (k + 1) * p])
    for t in np.flatnonzero(np.isnan(variance[:, 0])).tolist():
        own = slice(t * p, (t + 1) * p)
        variance[t] = variance[key[frame == t]].mean(axis=0) + np.diag(np.linalg.inv(information[own, own].toarray()))
    sigma = np.sqrt(np.maximum(variance, 0))
    found = tuple(Orientation(r, float(z)) for r, z in zip(rotation, np.exp(log_zoom), strict=True))
    sigma_zoom = sigma[:, 3] if solve_zoom else np.zeros(n)
    return found, np.hypot(np.sqrt((sigma[:, :3] ** 2).mean(axis=1)), floor_rad), sigma_zoom


# -- the focal length: points that a turn takes across the picture keep their angles at one length only ---------------


class _TurnedPair(NamedTuple):
    """Points (N, 2), (N, 2) of two pictures that were followed from one to the other, and the rotation (3, 3) that was
    found between them. key: of the earlier picture."""

    key: int
    a_px: Array
    b_px: Array
    turn: Array


def _furthest_turned(pairs: Sequence[_TurnedPair]) -> list[_TurnedPair]:
    """The pairs of frames between which the camera has turned furthest."""
    return sorted(pairs, key=lambda pair: -float(Rotation.from_matrix(pair.turn).magnitude()))[:MAX_PAIRS]


def _focal_factor(camera: Camera, pairs: Sequence[_TurnedPair], limit_px: float) -> tuple[float, float] | None:
    """By how much the focal length is longer than the camera file's, as a log factor, and its standard deviation.

    limit_px: what a point may be off. The deviation is that of the points and of what earlier pictures say one by one.
    None where too few pairs have points.
    """
    if len(pairs) < MIN_PAIRS:
        return None
    some = pairs[:: max(1, len(pairs) // 12)]

    def cost(log_factor: float) -> float:
        sizes = [np.linalg.norm(_left_px(camera, pair, log_factor, COARSE_ROUNDS), axis=1) for pair in some]
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
    """What a pair says of the log factor: information, and pull (gradient)."""
    left, *ends = (_left_px(camera, pair, log_factor + by) for by in (0.0, STEP, -STEP))
    slope, weights, size = (ends[0] - ends[1]) / (2 * STEP), _weights(left), np.linalg.norm(left, axis=1)
    used = max(float(weights.sum()), 1.0)
    sigma2 = max(float(weights @ size**2) / (2 * used), 1e-4) + PAIR_FLOOR_PX**2 * used
    return float(weights @ (slope**2).sum(axis=1)) / sigma2, -float(weights @ (slope * left).sum(axis=1)) / sigma2


def _left_px(camera: Camera, pair: _TurnedPair, log_factor: float, rounds: int = ROUNDS) -> Array:
    """(N, 2): how far the points of a pair are apart in its second picture, by the rotation that fits best then."""
    zoom = float(np.exp(log_factor))
    (a, known), (b, seen) = (turning.rays_of(camera, points_px, zoom) for points_px in (pair.a_px, pair.b_px))
    known &= seen
    turn = Rotation.from_rotvec(Rotation.from_matrix(pair.turn).as_rotvec() / zoom)  # as far in the picture
    left = np.full(pair.a_px.shape, 1e9)
    for number in range(rounds):
        if number:
            turn, _ = Rotation.align_vectors(b[known], a[known], weights=_weights(left)[known])
        pixels, valid = turning.pixels_of(camera, turn.apply(np.where(known[:, None], a, b)), zoom)
        left = np.where((known & valid)[:, None], pixels - pair.b_px, 1e9)
    return left


def _weights(left_px: Array) -> Array:
    """(N,): Tukey's, of residuals (N, 2)."""
    size = np.linalg.norm(left_px, axis=1)
    return turning.tukey(size, max(4 * float(np.median(size)), 1.0))


# -- the panorama: longitude to the right, latitude upward, in the level world ----------------------------------------

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
        middle = np.unwrap([_angles(orientation.rotation[2])[0] for orientation in orientations])
        angles = [_angles(_edge(camera, one), centre) for one, centre in zip(orientations, middle, strict=True)]
        west, south = np.nanmin(angles, axis=(0, 2))
        east, north = np.nanmax(angles, axis=(0, 2))
        step = max((east - west) / WIDTH_PX, (north - south) / HEIGHT_PX)
        size = (max(2, int((east - west) / step) // 2 * 2), max(2, int((north - south) / step) // 2 * 2))
        return cls(float(west), float(north), float(step), size)

    def place(self, rays: Array) -> Array:
        """Pixels (N, 2) of world rays (N, 3), as near to the canvas as they come."""
        lon, lat = _angles(rays, self.west + self.step * self.size_px[0] / 2)
        return np.column_stack([(lon - self.west) / self.step, (self.north - lat) / self.step])

    def warped(self, camera: Camera, orientation: Orientation, picture: Image) -> tuple[Image, Array]:
        """A picture on the canvas, and how deep each pixel (height, width) lies within it: 1 in its middle, 0 outside.
        picture: of the camera's size or smaller."""
        width, height = self.size_px
        x, y = np.meshgrid(*(np.arange(0, n + COARSE_PX, COARSE_PX, dtype=float) for n in self.size_px))
        lon, lat = self.west + self.step * x, self.north - self.step * y
        rays = np.stack([np.cos(lat) * np.sin(lon), np.cos(lat) * np.cos(lon), np.sin(lat)], axis=-1)
        pixels, _ = turning.expected_px(camera, rays.reshape(-1, 3), orientation)
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
        _draw_path(canvas, drawn, _edge(camera, motion.orientations[row]), VIEW)
    _draw_path(canvas, drawn, np.stack([orientation.rotation[2] for orientation in motion.orientations]), PATH)
    nowhere = np.full(2, np.nan)
    middles = [np.nanmean(points[i], axis=0) if i in points else nowhere for i in motion.frames.tolist()]
    ways = zip(middles, motion.orientations, strict=True)
    way = [turning.rays_of(camera, px, one.zoom)[0] @ one.rotation for px, one in ways]
    _draw_path(canvas, drawn, np.stack(way), ANIMAL)
    return drawn


def _draw_path(canvas: _Canvas, picture: Image, rays: Array, colour: tuple[int, int, int]) -> None:
    """World rays (N, 3) as a line, broken where they are NaN or leave at one side for the other."""
    for a, b in pairwise(canvas.place(rays)):
        if np.isfinite([a, b]).all() and abs(a[0] - b[0]) < canvas.size_px[0] / 2:
            (x0, y0), (x1, y1) = np.rint([a, b]).astype(int).tolist()
            cv2.line(picture, (x0, y0), (x1, y1), colour, 2, cv2.LINE_AA)


def _edge(camera: Camera, view: Orientation) -> Array:
    """World rays (N, 3) once around the picture of a view."""
    width, height = (n - 1 for n in camera.image_size_px)
    corners = np.array([(0, 0), (width, 0), (width, height), (0, height), (0, 0)], dtype=float)
    outline = np.concatenate(np.linspace(corners[:-1], corners[1:], 17, axis=1))
    return turning.rays_of(camera, outline, view.zoom)[0] @ view.rotation


def _angles(rays: Array, middle_rad: float = 0.0) -> tuple[Array, Array]:
    """Longitude, from the y axis to the x axis, within half a turn of the middle, and latitude of rays (..., 3)."""
    x, y, z = np.moveaxis(rays, -1, 0)
    return middle_rad + (np.arctan2(x, y) - middle_rad + np.pi) % (2 * np.pi) - np.pi, np.arctan2(z, np.hypot(x, y))
