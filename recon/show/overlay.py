"""Draw a reconstruction on a frame of its video, and the pose from three directions below the picture.

On the picture, limbs have the colour of their side. They are light and thick if they are nearer to the camera than the
animal's middle, and dark and thin if they are farther away. Rings are detections within the expected error. Red crosses
are detections with larger errors, with a line to the reprojection. A strip below the picture shows the key to the
colours, and the pose from the side, from above and from ahead, at one scale and aligned with the animal's heading. An
animal that is small in the picture is also shown enlarged, in the corner that its path avoids most.
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

from recon.animal.body import Side
from recon.base.arrays import Array, Bools, Index, Integers, finite, mean_along
from recon.base.errors import InputError, Problem
from recon.base.numbers import quantity
from recon.io.video import Image, probe, timed_frames

Colour = tuple[int, int, int]
"""Blue, green and red of a colour, 0 to 255, in OpenCV's order."""

# Okabe and Ito's palette, which colour-blind readers can distinguish, as in the playback.
SIDE_COLOURS: dict[Side | None, Colour] = {"left": (233, 180, 86), "right": (0, 159, 230), None: (115, 158, 0)}
PAPER, INK, FAINT, SHADOW = (27, 21, 18), (235, 235, 235), (110, 104, 98), (0, 0, 0)
DETECTION, OUTLIER, FLAGGED = (255, 255, 255), (40, 60, 235), (60, 200, 255)
FONT = cv2.FONT_HERSHEY_SIMPLEX
SHIFT = 4
STRIP_HEIGHT = 0.3
"""Height of the strip with the three views, relative to the height of a 16:9 picture of the same width."""
COLUMNS = {"side": 0.38, "from above": 0.26, "from ahead": 0.18}
"""Fractions of the strip's width for the three views; the key to the colours takes the remaining width."""
TILE_PX = (480, 300)
"""Width and height of a still picture in pixels."""
TILE_UNIT = 0.55
"""Factor of line widths and mark sizes on a still picture, 1 for a picture 1920 px wide."""
BRIGHTNESS = 0.35
"""Fraction of the picture's brightness that remains behind text."""
_FILLED = 0.8
"""Fraction of a tile that the largest animal fills."""
CLOSE_UP = 0.36
"""Size of the close-up as a fraction of the picture's width and height."""
MIN_MAGNIFICATION = 1.6
"""Smallest magnification, relative to the picture, at which the close-up is shown."""
HEADING_S = 0.25
"""Time over which the trunk's direction is averaged, so that the views do not shake, in seconds."""


@dataclass(frozen=True, eq=False)
class Overlay:
    """Data for drawing T frames of J joints on a video."""

    frames: Integers
    """Frame numbers, shape (T,)."""
    fps: float
    limbs: Sequence[Sequence[int]]
    """Indices of the joints along each limb."""
    colours: Sequence[Colour]
    """Colour of each limb."""
    detected_px: Array
    """Detections in pixels, shape (T, J, 2), NaN if missing."""
    reprojected_px: Array
    """Joints projected into the picture in pixels, shape (T, J, 2), NaN if missing."""
    outliers: Bools
    """Mask of the detections farther from the pose than the expected error, shape (T, J)."""
    depth_m: Array
    """Depths of the joints along the camera's axis in metres from an arbitrary origin, shape (T, J)."""
    upright_m: Array
    """Positions of the joints in metres with z up, shape (T, J, 3)."""
    trunk: tuple[int, int]
    """Indices of the joints at the rear and the front end of the trunk."""
    flags: Sequence[Sequence[str]]
    """Flags of each frame."""
    speed: float = 1.0
    """Speed of the playback; 1 is real time."""

    @cached_property
    def nearness(self) -> Array:
        """Return the nearness (T, J) of the joints to the camera, from -1 (far) to 1 (near) over the clip."""
        relative = self.depth_m - mean_along(self.depth_m, axis=1)[:, None]
        known_m = np.abs(finite(relative))
        reach = float(np.percentile(known_m, 95)) if len(known_m) else 1.0
        return np.clip(-relative / max(reach, 1e-9), -1.0, 1.0)

    @cached_property
    def views(self) -> dict[str, Array]:
        """Return the joints' positions (T, J, 3) in each view, in metres to the right, upwards and towards the viewer.

        Heights are above the lowest joints.
        """
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
        """Return width and height of the box around the joints in pixels, shape (N, 2), in N frames with all joints.

        If no frame has all joints, the result is one infinite box.
        """
        complete_px = self.reprojected_px[np.isfinite(self.reprojected_px).all(axis=(1, 2))]
        return np.ptp(complete_px, axis=1) if len(complete_px) else np.full((1, 2), np.inf)

    @cached_property
    def extent_px(self) -> float:
        """Return the animal's length in the picture in pixels, which is the median diagonal of the box around it."""
        return float(np.median(np.linalg.norm(self._sides_px, axis=1)))

    @cached_property
    def joints_px(self) -> Array:
        """Return the pixel positions of all known joints in all frames, shape (N, 2)."""
        return self.reprojected_px[np.isfinite(self.reprojected_px).all(axis=2)]

    @cached_property
    def box_px(self) -> Array:
        """Return width and height in pixels, shape (2,), of the largest box around the animal, ignoring stray poses."""
        return np.maximum(np.percentile(self._sides_px, 98, axis=0), 1.0)

    @cached_property
    def _facing(self) -> float:
        """Return 1 if the animal faces right in the picture, -1 if it faces left."""
        rear, front = self.trunk
        forward_px = self.reprojected_px[:, front, 0] - self.reprojected_px[:, rear, 0]
        return -1.0 if np.isfinite(forward_px).any() and float(np.nanmedian(forward_px)) < 0 else 1.0

    @cached_property
    def bounds(self) -> dict[str, tuple[Array, Array]]:
        """Return the lowest and highest coordinates (2,) in each view, in metres, over the clip without stray poses."""
        points_of_view = {name: points[np.isfinite(points).all(axis=-1)][:, :2] for name, points in self.views.items()}
        unit_box = -np.ones(2), np.ones(2)
        return {
            name: (*np.percentile(xy, (1, 99), axis=0),) if len(xy) else unit_box for name, xy in points_of_view.items()
        }


def smoothed_headings(forward_m: Array, fps: float) -> Array:
    """Return horizontal unit vectors (T, 2) along `forward_m`, shape (T, 3), averaged over `HEADING_S`.

    A frame without a direction gets the direction of the last earlier frame that has one, or else of the first later
    frame. If no frame has a direction, all frames get the x axis.
    """
    import pandas as pd  # slow to import

    frames = 2 * round(0.5 * HEADING_S * fps) + 1
    level = pd.DataFrame(forward_m[:, :2]).rolling(frames, center=True, min_periods=1).mean()
    level = level.ffill().bfill().fillna({0: 1.0, 1: 0.0}).to_numpy()
    return level / np.linalg.norm(level, axis=1, keepdims=True)


def clip_frames(frames: Integers, video: Path, first_frame: int) -> Iterator[tuple[int, int | None, float, Image]]:
    """Yield the number, the index, the time stamp in seconds and the picture of each frame of a clip.

    The index is the position in `frames`, None for a frame that is not in the clip. The last item is the frame after
    the clip, if the video has one.

    Parameters
    ----------
    frames : ndarray
        Frame numbers of the clip, shape (T,).
    video : path
        Video file of the clip.
    first_frame : int
        Frame number, in the clip, of the video's first frame.

    Raises
    ------
    InputError
        If the video ends before the clip.
    """
    rows = {int(frame): t for t, frame in enumerate(frames)}
    # The video of a camera that started later lacks the first frames.
    first, last, frames_read = max(min(rows), first_frame), max(rows), 0
    for index, stamp_s, picture in timed_frames(video, first - first_frame, last + 2 - first_frame):
        frames_read += 1
        yield index + first_frame, rows.get(index + first_frame), stamp_s, picture
    if frames_read < last + 1 - first:
        decoded, stated = first - first_frame + frames_read, probe(video).stated_frames
        decoded_text = f"{decoded} frames that can be decoded"
        if stated is not None and stated > decoded:
            decoded_text += f" of the {stated} that the file states"
        expected = f"{last + 1 - first_frame} frames or more, for the frames {first} to {last}: the video of this clip"
        expected += f", or --first-frame {first} if the video was cut to begin there"
        raise InputError(Problem(video, "video", decoded_text, expected))


def canvas_size(size_px: tuple[int, int]) -> tuple[int, int]:
    """Return the width and height in pixels of the result of `draw_frame`, both even as codecs require."""
    width, height = size_px
    strip = round(STRIP_HEIGHT * width * 9 / 16)
    return width + width % 2, height + strip + (height + strip) % 2


def draw_frame(overlay: Overlay, t: int | None, frame: int, picture: Image) -> Image:
    """Return the picture (height, width, 3) of a frame with all marks and the strip below.

    `t` is the index of the frame in `overlay`, None for a frame without a reconstruction.
    """
    height, width = picture.shape[:2]
    canvas_w, canvas_h = canvas_size((width, height))
    canvas = np.full((canvas_h, canvas_w, 3), PAPER, np.uint8)
    canvas[:height, :width] = picture
    unit = max(width, height) / 1920  # sizes are for a width of 1920 px
    if t is not None:
        image = canvas[:height, :width]
        # marks are smaller for a small animal, which they would hide
        marks = min(unit, max(0.4 * unit, overlay.extent_px / 700))
        _draw_pose(image, overlay, t, marks)
        _draw_close_up(image, overlay, t, picture, unit)
    _draw_caption(canvas, overlay, t, frame, (width, height), unit)
    _draw_strip(canvas, overlay, t, height, width)
    return canvas


def draw_tiles(overlay: Overlay, rows: Sequence[int] | Index, pictures: Sequence[Image] | None = None) -> list[Image]:
    """Return pictures of the frames with the indices `rows`, cropped around the animal at one scale.

    `pictures` are the video's pictures of these frames. If it is None, the background is plain.
    """
    boxes = np.array([(np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)) for xy in overlay.reprojected_px[list(rows)]])
    largest = np.max(boxes[:, 1] - boxes[:, 0], axis=0)
    scale = float(np.min(_FILLED * np.array(TILE_PX) / np.maximum(largest, 1.0)))
    corners = boxes.mean(axis=1) - 0.5 * np.array(TILE_PX) / scale
    tiles = []
    for i, (t, corner) in enumerate(zip(rows, corners, strict=True)):
        cut, background = _Cut(corner, scale), np.full((TILE_PX[1], TILE_PX[0], 3), PAPER, np.uint8)
        tile = background if pictures is None else cut.crop(pictures[i], TILE_PX)
        _draw_pose(tile, overlay, int(t), TILE_UNIT, cut)
        _draw_caption(tile, overlay, int(t), int(overlay.frames[t]), TILE_PX, TILE_UNIT)
        tiles.append(tile)
    return tiles


@dataclass(frozen=True, eq=False)
class _Cut:
    """Part of the picture, given by its corner (2,) in pixels and its enlargement."""

    corner_px: Array
    scale: float

    def place(self, points_px: Array) -> Array:
        """Convert points (N, 2) from pixels of the whole picture to pixels of the cut-out part."""
        return self.scale * (points_px - self.corner_px)

    def crop(self, picture: Image, size_px: tuple[int, int]) -> Image:
        """Return this part of a picture (height, width, 3), enlarged to a size in pixels."""
        (x, y), scale = self.corner_px, self.scale
        to_cut = np.array([[scale, 0.0, -scale * x], [0.0, scale, -scale * y]])
        return np.asarray(cv2.warpAffine(picture, to_cut, size_px, flags=cv2.INTER_LINEAR, borderValue=PAPER), np.uint8)


WHOLE = _Cut(np.zeros(2), 1.0)


def _draw_close_up(image: Image, overlay: Overlay, t: int, picture: Image, unit: float) -> None:
    """Draw the close-up into the corner with the fewest of the clip's joints, except the caption's corner.

    There is no close-up if it would not enlarge the animal enough.

    `t` is the index of the frame, and `unit` the factor of line widths, 1 for a picture 1920 px wide.
    """
    height, width = picture.shape[:2]
    size = np.array([round(CLOSE_UP * width), round(CLOSE_UP * height)])
    xy = overlay.reprojected_px[t]
    scale = float(np.min(_FILLED * size / overlay.box_px))
    if scale < MIN_MAGNIFICATION or not np.isfinite(xy).any():
        return
    corners = np.array([[width, height], [0, height], [width, 0]]) - size * [[1, 1], [0, 1], [1, 0]]
    joint_counts = [
        ((overlay.joints_px >= corner) & (overlay.joints_px <= corner + size)).all(axis=1).sum() for corner in corners
    ]
    left, top = corners[int(np.argmin(joint_counts))].tolist()
    tile_width, tile_height = size.tolist()
    cut = _Cut(0.5 * (np.nanmin(xy, axis=0) + np.nanmax(xy, axis=0)) - 0.5 * size / scale, scale)
    tile = image[top : top + tile_height, left : left + tile_width]
    tile[:] = cut.crop(picture, (tile_width, tile_height))
    _draw_pose(tile, overlay, t, 0.8 * unit, cut)
    cv2.rectangle(tile, (0, 0), (tile_width - 1, tile_height - 1), INK, max(1, round(2 * unit)))
    draw_text(tile, f"{scale:.1f} times larger", (round(14 * unit), tile_height - round(16 * unit)), 0.7 * unit, INK)


def _draw_pose(image: Image, overlay: Overlay, t: int, unit: float, cut: _Cut = WHOLE) -> None:
    """Draw the skeleton of one frame, and the detections on top of the skeleton.

    `t` is the index of the frame, and `unit` the factor of line widths, 1 for a picture 1920 px wide.
    """
    xy, nearness_of_joint = cut.place(overlay.reprojected_px[t]), overlay.nearness[t]
    segments = [
        (0.5 * (nearness_of_joint[a] + nearness_of_joint[b]), a, b, colour)
        for limb, colour in zip(overlay.limbs, overlay.colours, strict=True)
        for a, b in pairwise(limb)
        if np.isfinite(xy[[a, b]]).all()
    ]
    for nearness, a, b, colour in sorted(segments, key=lambda s: s[0]):
        thick = max(2, round((4.0 + 2.0 * nearness) * unit))
        draw_line(image, xy[a], xy[b], SHADOW, thick + 2)
        draw_line(image, xy[a], xy[b], shade(colour, nearness), thick)
    size, thick = 7 * unit, max(1, round(1.5 * unit))
    for detected, reprojected, outlier in zip(cut.place(overlay.detected_px[t]), xy, overlay.outliers[t], strict=True):
        if not np.isfinite(detected).all():
            continue
        if outlier:
            if np.isfinite(reprojected).all():
                draw_line(image, detected, reprojected, OUTLIER, thick)
            draw_line(image, detected - size, detected + size, OUTLIER, thick + 1)
            across = np.array([size, -size])
            draw_line(image, detected - across, detected + across, OUTLIER, thick + 1)
        else:
            draw_circle(image, detected, size + 0.5 * thick + 0.5, SHADOW, 1)
            draw_circle(image, detected, size, DETECTION, thick)


def shade(colour: Colour, nearness: float) -> Colour:
    """Return a colour mixed with white for near (1) and with black for far (-1)."""
    target, amount = (255.0, 0.45 * nearness) if nearness > 0 else (0.0, -0.45 * nearness)
    blue, green, red = (round(c + (target - c) * amount) for c in colour)
    return blue, green, red


def _draw_caption(
    canvas: Image, overlay: Overlay, t: int | None, frame: int, size_px: tuple[int, int], unit: float
) -> None:
    """Draw the frame number and the time, and for a flagged frame its flags and a border around the picture.

    `t` is the index of the frame, and `unit` the factor of line widths, 1 for a picture 1920 px wide.
    """
    speed_text = "" if overlay.speed == 1 else f"   {overlay.speed:.3g}x"
    x, y, scale = round(24 * unit), round(48 * unit), 1.1 * unit
    draw_text(canvas, f"frame {frame}   {quantity(frame / overlay.fps, 3, 's')}{speed_text}", (x, y), scale, INK)
    flags = list(overlay.flags[t]) if t is not None else ["not reconstructed"]
    if t is not None and not np.isfinite(overlay.reprojected_px[t]).any() and not flags:
        flags = ["no pose"]
    if flags:
        draw_text(canvas, ", ".join(flags), (x, y + round(46 * unit)), scale, FLAGGED)
        edge = max(2, round(6 * unit))
        inset, (width, height) = edge // 2, size_px
        cv2.rectangle(canvas, (inset, inset), (width - 1 - inset, height - 1 - inset), FLAGGED, edge)


def _draw_strip(canvas: Image, overlay: Overlay, t: int | None, top: int, width: int) -> None:
    height = round(STRIP_HEIGHT * width * 9 / 16)
    unit = width / 1920
    pad, foot = round(18 * unit), round(44 * unit)
    boxes, left = {}, 0.0
    for name, fraction in COLUMNS.items():
        boxes[name] = (round(left * width) + pad, top + pad, round(fraction * width) - 2 * pad, height - pad - foot)
        left += fraction
    scale = min(
        side / max(extent, 1e-6)
        for name, (_, _, box_width, box_height) in boxes.items()
        for side, extent in zip((box_width, box_height), np.subtract(*overlay.bounds[name][::-1]), strict=True)
    )
    for name, (x, y, box_width, box_height) in boxes.items():
        middle_m, middle = 0.5 * np.add(*overlay.bounds[name]), np.array([x + box_width / 2, y + box_height / 2])
        if name != "from above":
            ground = float(middle[1] + middle_m[1] * scale)
            draw_line(canvas, np.array([x, ground]), np.array([x + box_width, ground]), FAINT, max(1, round(unit)))
        if t is not None:
            points = overlay.views[name][t]
            points_px = middle + (points[:, :2] - middle_m) * scale * [1.0, -1.0]
            _draw_view(canvas, overlay, points_px, points[:, 2], max(1, round(3 * unit)))
        draw_text(canvas, name, (x, top + height - round(14 * unit)), 0.7 * unit, INK)
    _draw_scale(canvas, boxes["side"], scale, top + height - round(20 * unit), unit)
    _draw_key(canvas, overlay, (round(left * width) + pad, top + pad + round(16 * unit)), unit)


def _draw_view(canvas: Image, overlay: Overlay, points_px: Array, nearness: Array, thickness: int) -> None:
    """Draw the limbs of a pose with joints (J, 2) on the canvas, the limbs nearest to the viewer last."""
    limbs = [
        (float(np.nanmean(nearness[list(limb)])), limb, colour)
        for limb, colour in zip(overlay.limbs, overlay.colours, strict=True)
        if np.isfinite(nearness[list(limb)]).any()
    ]
    for _, limb, colour in sorted(limbs, key=lambda d: d[0]):
        pieces = [pair for pair in pairwise(points_px[list(limb)]) if np.isfinite(pair).all()]
        for paint, width in ((PAPER, thickness + 2), (colour, thickness)):
            for start, end in pieces:
                draw_line(canvas, start, end, paint, width)


def _draw_scale(canvas: Image, box: tuple[int, int, int, int], scale: float, y: int, unit: float) -> None:
    """Draw a scale bar of a round length, about a fifth of the view.

    `box` has the left edge, upper edge, width and height of the view in pixels, `scale` is in pixels per metre, and
    `unit` is the factor of line widths, 1 for a picture 1920 px wide.
    """
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


def draw_line(image: Image, start: Array, end: Array, colour: Colour, thickness: int) -> None:
    """Draw an anti-aliased line between two points (2,) in pixels."""
    ends = np.rint(np.clip([start, end], -30000, 30000) * 2**SHIFT).astype(int).tolist()
    cv2.line(image, tuple(ends[0]), tuple(ends[1]), colour, thickness, cv2.LINE_AA, SHIFT)


def draw_circle(image: Image, centre: Array, radius: float, colour: Colour, thickness: int) -> None:
    """Draw an anti-aliased circle about a point (2,), in pixels."""
    x, y = np.rint(np.clip(centre, -30000, 30000) * 2**SHIFT).astype(int).tolist()
    cv2.circle(image, (x, y), round(radius * 2**SHIFT), colour, thickness, cv2.LINE_AA, SHIFT)


def draw_text(image: Image, text: str, position: tuple[int, int], scale: float, colour: Colour) -> None:
    """Draw text on a darkened background, so that it is legible on any picture."""
    scale = max(scale, 0.35)
    thickness, pad = max(1, round(2 * scale)), round(8 * scale)
    (text_width, text_height), below = cv2.getTextSize(text, FONT, scale, thickness)
    left, top = max(position[0] - pad, 0), max(position[1] - text_height - pad // 2, 0)
    background = image[top : position[1] + below + pad // 2, left : position[0] + text_width + pad]
    background[:] = PAPER + BRIGHTNESS * (background - np.array(PAPER, dtype=float))
    cv2.putText(image, text, position, FONT, scale, colour, thickness, cv2.LINE_AA)
