"""A reconstruction drawn on a frame of its video, with the pose from three sides beneath: plain arrays and OpenCV.

On the picture: limbs in the colour of their side, light and thick where they are nearer to the camera than the animal's
middle, dark and thin where they are farther away; rings where the detector saw a keypoint, red crosses with a line to
the reprojection where the pose does not explain it. Beneath, so that nothing of the picture is hidden: the pose from
its side, from above and from ahead, at one scale, turned with the animal, and the key to the colours. An animal that is
small in the picture is shown enlarged in a corner that it hardly comes to.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pandas as pd

from recon.animal.body import Side
from recon.base import Array, Bools, Index, InputError, Integers, Problem, finite, mean_along
from recon.io.video import Image, probe, timed_frames

Colour = tuple[int, int, int]
"""A colour: blue, green, red."""

# Okabe and Ito's palette, which the colour-blind can tell apart; as in the playback.
SIDE_COLOURS: dict[Side | None, Colour] = {"left": (233, 180, 86), "right": (0, 159, 230), None: (115, 158, 0)}
PAPER, INK, FAINT, SHADOW = (27, 21, 18), (235, 235, 235), (110, 104, 98), (0, 0, 0)
DETECTION, OUTLIER, DOUBT = (255, 255, 255), (40, 60, 235), (60, 200, 255)
FONT = cv2.FONT_HERSHEY_SIMPLEX
SHIFT = 4
STRIP_SHARE = 0.3
"""Height of the strip with the three views, relative to 9/16 of the width."""
COLUMNS = {"side": 0.38, "from above": 0.26, "from ahead": 0.18}
"""Shares of the width; what remains is the key's."""
TILE_PX, TILE_UNIT = (480, 300), 0.55
"""The size of a still in pixels, and the scale of what is drawn on it."""
DARKENED = 0.35
"""What a text's ground keeps of the picture."""
_FILLED = 0.8
"""The share of a tile that the largest animal fills."""
CLOSE_UP, WORTH = 0.36, 1.6
"""The close-up's share of the picture's sides, and what it has to enlarge by to be shown."""
HEADING_S = 0.25
"""The views turn with the trunk's direction, averaged over this time, so that they do not shake."""


@dataclass(frozen=True, eq=False)
class Overlay:
    """What is drawn on a video: T frames of J joints."""

    frames: Integers
    """The numbers of the T frames, shape (T,)."""
    fps: float
    limbs: Sequence[Sequence[int]]
    """Joints along each, as indices."""
    colours: Sequence[Colour]
    """One colour for each limb."""
    detected_px: Array
    """(T, J, 2), NaN where there is none."""
    reprojected_px: Array
    """(T, J, 2), NaN where there is none."""
    outliers: Bools
    """(T, J): detections that the pose does not explain."""
    depth_m: Array
    """(T, J): how far joints are from the camera, from any origin."""
    upright_m: Array
    """(T, J, 3): z up."""
    trunk: tuple[int, int]
    """Two joints, from rear to front."""
    flags: Sequence[Sequence[str]]
    """(T): what is doubtful about each frame."""
    speed: float = 1.0
    """The speed of the playback, 1 is real time."""

    @cached_property
    def nearness(self) -> Array:
        """(T, J): 1 near, -1 far, 0 at the middle of the animal; the same scale over the clip."""
        relative = self.depth_m - mean_along(self.depth_m, axis=1)[:, None]
        known = np.abs(finite(relative))
        reach = float(np.percentile(known, 95)) if len(known) else 1.0
        return np.clip(-relative / max(reach, 1e-9), -1.0, 1.0)

    @cached_property
    def views(self) -> dict[str, Array]:
        """By name, (T, J, 3): metres to the right, upwards and towards the viewer; heights from the lowest joints."""
        rear, front = self.trunk
        along = smoothed_headings(self.upright_m[:, front] - self.upright_m[:, rear], self.fps)
        left = np.stack((-along[:, 1], along[:, 0]), axis=1)
        flat = self.upright_m[..., :2] - 0.5 * (self.upright_m[:, [rear], :2] + self.upright_m[:, [front], :2])
        height = self.upright_m[..., 2]
        if np.isfinite(height).any():
            height = height - np.nanpercentile(height, 2)
        forwards, leftwards = np.einsum("tjk,tk->tj", flat, along), np.einsum("tjk,tk->tj", flat, left)
        facing = self._facing
        return {
            "side": np.stack((facing * forwards, height, -facing * leftwards), axis=-1),
            "from above": np.stack((facing * forwards, facing * leftwards, height), axis=-1),
            "from ahead": np.stack((leftwards, height, forwards), axis=-1),
        }

    @cached_property
    def _sides_px(self) -> Array:
        """(N, 2): sides of the box about the joints, of each frame with all of them; infinite where there is none."""
        known = self.reprojected_px[np.isfinite(self.reprojected_px).all(axis=(1, 2))]
        return np.ptp(known, axis=1) if len(known) else np.full((1, 2), np.inf)

    @cached_property
    def extent_px(self) -> float:
        """Length of the animal in the picture: the diagonal of its joints' box, in the median of the frames."""
        return float(np.median(np.linalg.norm(self._sides_px, axis=1)))

    @cached_property
    def joints_px(self) -> Array:
        """(N, 2): all of the clip."""
        return self.reprojected_px[np.isfinite(self.reprojected_px).all(axis=2)]

    @cached_property
    def box_px(self) -> Array:
        """(2,): sides of the largest box about the joints of a frame, but for poses that went astray."""
        return np.maximum(np.percentile(self._sides_px, 98, axis=0), 1.0)

    @cached_property
    def _facing(self) -> float:
        """1 where the animal faces right in the picture, -1 where it faces left."""
        rear, front = self.trunk
        ahead = self.reprojected_px[:, front, 0] - self.reprojected_px[:, rear, 0]
        return -1.0 if np.isfinite(ahead).any() and float(np.nanmedian(ahead)) < 0 else 1.0

    @cached_property
    def bounds(self) -> dict[str, tuple[Array, Array]]:
        """By view: lowest and highest (2,), metres, over the clip but for poses that went astray."""
        known = {name: points[np.isfinite(points).all(axis=-1)][:, :2] for name, points in self.views.items()}
        unknown = -np.ones(2), np.ones(2)
        return {name: (*np.percentile(xy, (1, 99), axis=0),) if len(xy) else unknown for name, xy in known.items()}


def smoothed_headings(forward_m: Array, fps: float) -> Array:
    """Level unit vectors (T, 2) along forward_m (T, 3), averaged over `HEADING_S`.

    Where there is none, that of the last frame that has one; x where there is none at all.
    """
    frames = 2 * round(0.5 * HEADING_S * fps) + 1
    level = pd.DataFrame(forward_m[:, :2]).rolling(frames, center=True, min_periods=1).mean()
    level = level.ffill().bfill().fillna({0: 1.0, 1: 0.0}).to_numpy()
    return level / np.linalg.norm(level, axis=1, keepdims=True)


def clip_frames(frames: Integers, video: Path, first_frame: int) -> Iterator[tuple[int, int | None, float, Image]]:
    """The pictures of a clip's frames in its video: each one's number, its row among the frames, None for one between
    them, its time stamp in seconds, and its picture; and the frame after them, if the video has one. first_frame: the
    number that the video's first frame has in the clip. Raises InputError where the video ends before the clip."""
    rows = {int(frame): t for t, frame in enumerate(frames)}
    first, last, read = max(min(rows), first_frame), max(rows), 0  # a camera that began later lacks the first ones
    for index, stamp_s, picture in timed_frames(video, first - first_frame, last + 2 - first_frame):
        read += 1
        yield index + first_frame, rows.get(index + first_frame), stamp_s, picture
    if read < last + 1 - first:
        decoded, stated = first - first_frame + read, probe(video).stated_frames
        found = f"{decoded} frames that can be decoded"
        if stated is not None and stated > decoded:
            found += f" of the {stated} that the file states"
        expected = f"{last + 1 - first_frame} or more, for the frames {first} to {last}: the video of this clip"
        expected += f", or --first-frame {first} if it was cut to begin there"
        raise InputError(Problem(video, "video", found, expected))


def canvas_size(size_px: tuple[int, int]) -> tuple[int, int]:
    """(width, height) of what `draw_frame` makes of a picture of this size: even, as codecs want."""
    width, height = size_px
    strip = round(STRIP_SHARE * width * 9 / 16)
    return width + width % 2, height + strip + (height + strip) % 2


def draw_frame(overlay: Overlay, t: int | None, frame: int, picture: Image) -> Image:
    """The picture (height, width, 3) of a frame with all that is known about it, and the strip beneath.

    t: the frame's row; None for a frame that the reconstruction does not have.
    """
    height, width = picture.shape[:2]
    canvas_w, canvas_h = canvas_size((width, height))
    canvas = np.full((canvas_h, canvas_w, 3), PAPER, np.uint8)
    canvas[:height, :width] = picture
    unit = max(width, height) / 1920  # sizes are those for 1920 px
    if t is not None:
        image = canvas[:height, :width]
        # Marks that do not hide a small animal.
        marks = min(unit, max(0.4 * unit, overlay.extent_px / 700))
        _draw_pose(image, overlay, t, marks)
        _draw_close_up(image, overlay, t, picture, unit)
    _draw_caption(canvas, overlay, t, frame, (width, height), unit)
    _draw_strip(canvas, overlay, t, height, width)
    return canvas


def draw_tiles(overlay: Overlay, rows: Sequence[int] | Index, pictures: Sequence[Image] | None = None) -> list[Image]:
    """These frames, each cut out about the animal, at one scale. pictures: of each of them, in the pixels of the
    overlay; without, on a plain ground."""
    boxes = np.array([(np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)) for xy in overlay.reprojected_px[list(rows)]])
    largest = np.max(boxes[:, 1] - boxes[:, 0], axis=0)
    scale = float(np.min(_FILLED * np.array(TILE_PX) / np.maximum(largest, 1.0)))
    corners = boxes.mean(axis=1) - 0.5 * np.array(TILE_PX) / scale
    tiles = []
    for i, (t, corner) in enumerate(zip(rows, corners, strict=True)):
        cut, ground = _Cut(corner, scale), np.full((TILE_PX[1], TILE_PX[0], 3), PAPER, np.uint8)
        tile = ground if pictures is None else cut.of(pictures[i], TILE_PX)
        _draw_pose(tile, overlay, int(t), TILE_UNIT, cut)
        _draw_caption(tile, overlay, int(t), int(overlay.frames[t]), TILE_PX, TILE_UNIT)
        tiles.append(tile)
    return tiles


@dataclass(frozen=True, eq=False)
class _Cut:
    """A part of the picture, from a corner (2,), px, enlarged by a scale."""

    corner_px: Array
    scale: float

    def place(self, points_px: Array) -> Array:
        return self.scale * (points_px - self.corner_px)

    def of(self, picture: Image, size_px: tuple[int, int]) -> Image:
        """The cut of a picture (height, width, 3)."""
        (x, y), scale = self.corner_px, self.scale
        to_cut = np.array([[scale, 0.0, -scale * x], [0.0, scale, -scale * y]])
        return np.asarray(cv2.warpAffine(picture, to_cut, size_px, flags=cv2.INTER_LINEAR, borderValue=PAPER), np.uint8)


WHOLE = _Cut(np.zeros(2), 1.0)


def _draw_close_up(image: Image, overlay: Overlay, t: int, picture: Image, unit: float) -> None:
    """Into the corner of the picture that holds the fewest of the clip's joints, but for the caption's, if it is worth
    it."""
    height, width = picture.shape[:2]
    size = np.array([round(CLOSE_UP * width), round(CLOSE_UP * height)])
    xy = overlay.reprojected_px[t]
    scale = float(np.min(_FILLED * size / overlay.box_px))
    if scale < WORTH or not np.isfinite(xy).any():
        return
    corners = np.array([[width, height], [0, height], [width, 0]]) - size * [[1, 1], [0, 1], [1, 0]]
    inside = [((overlay.joints_px >= at) & (overlay.joints_px <= at + size)).all(axis=1).sum() for at in corners]
    left, top = corners[int(np.argmin(inside))].tolist()
    wide, high = size.tolist()
    cut = _Cut(0.5 * (np.nanmin(xy, axis=0) + np.nanmax(xy, axis=0)) - 0.5 * size / scale, scale)
    tile = image[top : top + high, left : left + wide]
    tile[:] = cut.of(picture, (wide, high))
    _draw_pose(tile, overlay, t, 0.8 * unit, cut)
    cv2.rectangle(tile, (0, 0), (wide - 1, high - 1), INK, max(1, round(2 * unit)))
    draw_text(tile, f"{scale:.1f} times larger", (round(14 * unit), high - round(16 * unit)), 0.7 * unit, INK)


def _draw_pose(image: Image, overlay: Overlay, t: int, unit: float, cut: _Cut = WHOLE) -> None:
    """The skeleton, and on it the detections."""
    xy, near = cut.place(overlay.reprojected_px[t]), overlay.nearness[t]
    segments = [
        (0.5 * (near[a] + near[b]), a, b, colour)
        for limb, colour in zip(overlay.limbs, overlay.colours, strict=True)
        for a, b in pairwise(limb)
        if np.isfinite(xy[[a, b]]).all()
    ]
    for nearness, a, b, colour in sorted(segments, key=lambda s: s[0]):
        thick = max(2, round((4.0 + 2.0 * nearness) * unit))
        draw_line(image, xy[a], xy[b], SHADOW, thick + 2)
        draw_line(image, xy[a], xy[b], shade(colour, nearness), thick)
    size, thick = 7 * unit, max(1, round(1.5 * unit))
    for at, to, outlier in zip(cut.place(overlay.detected_px[t]), xy, overlay.outliers[t], strict=True):
        if not np.isfinite(at).all():
            continue
        if outlier:
            if np.isfinite(to).all():
                draw_line(image, at, to, OUTLIER, thick)
            draw_line(image, at - size, at + size, OUTLIER, thick + 1)
            across = np.array([size, -size])
            draw_line(image, at - across, at + across, OUTLIER, thick + 1)
        else:
            draw_circle(image, at, size + 0.5 * thick + 0.5, SHADOW, 1)
            draw_circle(image, at, size, DETECTION, thick)


def shade(colour: Colour, nearness: float) -> Colour:
    """A colour mixed with white where it is near (1), with black where it is far (-1)."""
    target, amount = (255.0, 0.45 * nearness) if nearness > 0 else (0.0, -0.45 * nearness)
    blue, green, red = (round(c + (target - c) * amount) for c in colour)
    return blue, green, red


def _draw_caption(
    canvas: Image, overlay: Overlay, t: int | None, frame: int, size_px: tuple[int, int], unit: float
) -> None:
    """Frame number and time; what is doubtful, with a border around the picture."""
    slow = "" if overlay.speed == 1 else f"   {overlay.speed:.3g}x"
    x, y, scale = round(24 * unit), round(48 * unit), 1.1 * unit
    draw_text(canvas, f"frame {frame}   {frame / overlay.fps:.3f} s{slow}", (x, y), scale, INK)
    flags = list(overlay.flags[t]) if t is not None else ["not reconstructed"]
    if t is not None and not np.isfinite(overlay.reprojected_px[t]).any() and not flags:
        flags = ["no pose"]
    if flags:
        draw_text(canvas, ", ".join(flags), (x, y + round(46 * unit)), scale, DOUBT)
        edge = max(2, round(6 * unit))
        inside, (wide, high) = edge // 2, size_px
        cv2.rectangle(canvas, (inside, inside), (wide - 1 - inside, high - 1 - inside), DOUBT, edge)


def _draw_strip(canvas: Image, overlay: Overlay, t: int | None, top: int, width: int) -> None:
    """The three views beneath the picture, and the key."""
    height = round(STRIP_SHARE * width * 9 / 16)
    unit = width / 1920
    pad, foot = round(18 * unit), round(44 * unit)
    boxes, left = {}, 0.0
    for name, share in COLUMNS.items():
        boxes[name] = (round(left * width) + pad, top + pad, round(share * width) - 2 * pad, height - pad - foot)
        left += share
    scale = min(
        side / max(extent, 1e-6)
        for name, (_, _, w, h) in boxes.items()
        for side, extent in zip((w, h), np.subtract(*overlay.bounds[name][::-1]), strict=True)
    )
    for name, (x, y, w, h) in boxes.items():
        middle_m, middle = 0.5 * np.add(*overlay.bounds[name]), np.array([x + w / 2, y + h / 2])
        if name != "from above":
            ground = float(middle[1] + middle_m[1] * scale)
            draw_line(canvas, np.array([x, ground]), np.array([x + w, ground]), FAINT, max(1, round(unit)))
        if t is not None:
            points = overlay.views[name][t]
            places = middle + (points[:, :2] - middle_m) * scale * [1.0, -1.0]
            _draw_view(canvas, overlay, places, points[:, 2], max(1, round(3 * unit)))
        draw_text(canvas, name, (x, top + height - round(14 * unit)), 0.7 * unit, INK)
    _draw_scale(canvas, boxes["side"], scale, top + height - round(20 * unit), unit)
    _draw_key(canvas, overlay, (round(left * width) + pad, top + pad + round(16 * unit)), unit)


def _draw_view(canvas: Image, overlay: Overlay, places: Array, nearness: Array, thickness: int) -> None:
    """The limbs of a pose whose joints are at these places (J, 2), the nearest (J,) to the viewer last."""
    drawn = [
        (float(np.nanmean(nearness[list(limb)])), limb, colour)
        for limb, colour in zip(overlay.limbs, overlay.colours, strict=True)
        if np.isfinite(nearness[list(limb)]).any()
    ]
    for _, limb, colour in sorted(drawn, key=lambda d: d[0]):
        known = [pair for pair in pairwise(places[list(limb)]) if np.isfinite(pair).all()]
        for paint, width in ((PAPER, thickness + 2), (colour, thickness)):
            for start, end in known:
                draw_line(canvas, start, end, paint, width)


def _draw_scale(canvas: Image, box: tuple[int, int, int, int], scale: float, y: int, unit: float) -> None:
    """A bar of a round length, about a fifth of the view."""
    x, _, w, _ = box
    length = min((0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0), key=lambda m: abs(math.log(m * scale / (0.2 * w))))
    start, end = np.array([[x + 0.5 * w, y], [x + 0.5 * w + length * scale, y]])
    draw_line(canvas, start, end, INK, max(1, round(2 * unit)))
    end = (round(end[0] + 10 * unit), y + round(6 * unit))
    draw_text(canvas, f"{length:g} m", end, 0.6 * unit, INK)


def _draw_key(canvas: Image, overlay: Overlay, corner: tuple[int, int], unit: float) -> None:
    x, y = corner
    step, bar = round(34 * unit), 46 * unit
    sides = {side or "middle": colour for side, colour in SIDE_COLOURS.items() if colour in overlay.colours}
    labels = [*(f"{name}, near to far" for name in sides), "detected", "outlier"]
    for i, label in enumerate(labels):
        draw_text(canvas, label, (round(x + bar + 12 * unit), y + i * step + round(7 * unit)), 0.6 * unit, INK)
    for colour in sides.values():
        for part in range(8):
            start, end = np.array([[x + part / 8 * bar, y], [x + (part + 1) / 8 * bar, y]])
            draw_line(canvas, start, end, shade(colour, 1 - 2 * part / 7), max(1, round((6 - 4 * part / 7) * unit)))
        y += step
    centre = np.array([x + bar / 2, y])
    draw_circle(canvas, centre, 7 * unit, DETECTION, max(1, round(1.5 * unit)))
    centre[1] += step
    for arm in (np.array([7, 7]) * unit, np.array([7, -7]) * unit):
        draw_line(canvas, centre - arm, centre + arm, OUTLIER, max(1, round(2.5 * unit)))


# ---- strokes ----


def draw_line(image: Image, start: Array, end: Array, colour: Colour, thickness: int) -> None:
    ends = np.rint(np.clip([start, end], -30000, 30000) * 2**SHIFT).astype(int).tolist()
    cv2.line(image, tuple(ends[0]), tuple(ends[1]), colour, thickness, cv2.LINE_AA, SHIFT)


def draw_circle(image: Image, centre: Array, radius: float, colour: Colour, thickness: int) -> None:
    x, y = np.rint(np.clip(centre, -30000, 30000) * 2**SHIFT).astype(int).tolist()
    cv2.circle(image, (x, y), round(radius * 2**SHIFT), colour, thickness, cv2.LINE_AA, SHIFT)


def draw_text(image: Image, text: str, place: tuple[int, int], scale: float, colour: Colour) -> None:
    """On a darker ground, as pictures may be of any brightness."""
    scale = max(scale, 0.35)
    thick, pad = max(1, round(2 * scale)), round(8 * scale)
    (wide, high), below = cv2.getTextSize(text, FONT, scale, thick)
    left, top = max(place[0] - pad, 0), max(place[1] - high - pad // 2, 0)
    ground = image[top : place[1] + below + pad // 2, left : place[0] + wide + pad]
    ground[:] = PAPER + DARKENED * (ground - np.array(PAPER, dtype=float))
    cv2.putText(image, text, place, FONT, scale, colour, thick, cv2.LINE_AA)
