"""Write the animal in space and in the cameras' pictures to a recording for rerun.

The module also contains the colours and the scene's geometry that several views use, and functions that write lines,
plots and states. Rerun's own writer hangs if the disk is full. Therefore rerun writes into a pipe, and this module
copies the pipe into the file, without keeping a long recording in memory.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.components import FillMode

from recon.animal.body import Side
from recon.base.arrays import Array, Bools, Index, Integers, mean_along
from recon.base.files import write_bytes
from recon.clip import frame_ranges
from recon.fit.motion import Motion, Picture
from recon.fit.result import MotionSegment
from recon.geometry.frames import level_from_camera, quaternions

Colour = tuple[int, int, int]

# Okabe and Ito's palette, which colour-blind readers can distinguish.
LIMB_COLOURS: tuple[Colour, ...] = ((0, 158, 115), (86, 180, 233), (230, 159, 0), (0, 114, 178), (240, 228, 66))
"""Colours of the limbs of a chain: hind leg, spine, front leg, and two for further limbs."""
LEFT, RIGHT, MIDDLE = (86, 180, 233), (230, 159, 0), (0, 158, 115)
"""Colours of the left, right and middle limbs of a whole animal."""
SIDE_COLOURS: dict[Side | None, Colour] = {"left": LEFT, "right": RIGHT, None: MIDDLE}
DETECTION, OUTLIER, LINK = (255, 255, 255), (235, 60, 40), (204, 121, 167)
PATH, TRAIL, GRID, CAMERA, EDGE = (110, 110, 120), (240, 228, 66), (58, 64, 74), (190, 190, 200), (130, 130, 140)
LINE_COLOURS: tuple[Colour, ...] = (*LIMB_COLOURS, LINK, (213, 94, 0), (200, 200, 210))
BACKGROUND = (18, 21, 27)

CAMERAS, PICTURE = "world/camera", "picture"
"""Entities of a single camera in the world and of its picture, and the parents of the entities of several cameras."""
ANIMAL, EDGE_OF_PICTURE, VIDEO = "animal", "frame", "video"
"""Children of a picture, which are the animal's middle (centre of the close view), the picture's edge, and the video.
"""
_FRAMES_AT_ONCE = 4000
"""Number of frames that are written at once, for data that need much memory."""
GRID_SPACING_M = 1.0
CLOSE_VIEW_SIZE = 1.1
"""Size of the close view of a picture relative to the animal's extent."""
HIDDEN_LINK = 0.01
"""Length of a link, relative to the close view's width, below which the dots at its ends hide it."""
MAX_SHAPES_HZ = 25.0
"""Largest number of changes of an ellipsoid's shape per second of a clip, because more would be invisible."""
GRID_MARGIN_M, MAX_GRID_LINES = 1.5, 200


@dataclass(frozen=True)
class TimePlot:
    """Plot of L lines over T frames."""

    entity: str
    title: str
    names: Sequence[str]
    """Names of the L lines."""
    colours: Sequence[Colour]
    """Colours of the L lines."""
    values: Array
    """Values of the lines, shape (T, L)."""
    tab: str = ""
    """Name of the tab for this plot and all others with the same name; empty for the front row."""


@dataclass(frozen=True)
class Log:
    """Writer that adds the entities of a clip of T frames to a recording."""

    stream: rr.RecordingStream
    frames: Integers
    """Frame numbers, shape (T,)."""
    time_s: Array
    """Times of the frames in seconds, shape (T,)."""

    def send(
        self, entity: str, columns: rr.ComponentColumnList, rows: Index | Sequence[int] | slice = slice(None)
    ) -> None:
        """Write columns of an entity, which have a value for each of the clip's `rows`."""
        times = [
            rr.TimeColumn("frame", sequence=self.frames[rows]),
            rr.TimeColumn("time", duration=self.time_s[rows]),
        ]
        self.stream.send_columns(entity, times, columns)

    def fix(self, entity: str, archetype: rr.AsComponents) -> None:
        """Write an archetype that does not change over time."""
        self.stream.log(entity, archetype, static=True)

    def draw(self, entity: str, kind: Any, columns: rr.ComponentColumnList, **style: Any) -> None:
        """Write an archetype for every frame from columns, in a style that does not change over time."""
        self.send(entity, columns)
        self.fix(entity, kind.from_fields(**style))

    def points(self, entity: str, positions: Array, is_shown: Bools, **style: Any) -> None:
        """Write the points (T, N, 2 or 3) that the mask `is_shown` (T, N) selects."""
        kind, counts = rr.Points2D if positions.shape[-1] == 2 else rr.Points3D, is_shown.sum(axis=1)
        rows = np.flatnonzero((counts > 0) | changes(counts > 0))
        self.send(entity, kind.columns(positions=positions[is_shown]).partition(counts[rows]), rows)
        self.fix(entity, kind.from_fields(**style))

    def plot(self, plot: TimePlot) -> None:
        """Write a plot over time, in which a NaN interrupts a line."""
        is_known, count = np.isfinite(plot.values).any(axis=1), plot.values.shape[1]
        columns = rr.Scalars.columns(scalars=plot.values[is_known].ravel())
        style = {"names": plot.names, "colors": plot.colours, "widths": [1.8] * count}
        self.draw(plot.entity, rr.SeriesLines, columns.partition(np.where(is_known, count, 0)), **style)

    def state(self, entity: str, text: str, colour: Colour, holds: Bools) -> None:
        """Write when a state begins and ends, from a mask (T,) of the frames in which it holds.

        `text` is the name of the state while it holds. Its label is a blank, because the row already has a name.
        Without a label, the viewer would show the value.
        """
        rows = np.flatnonzero(changes(holds))
        columns = rr.StateChange.columns(state=[text] * int(holds[rows].sum()))
        self.send(entity, columns.partition(holds[rows].astype(int)), rows)
        self.fix(entity, rr.StateConfiguration(values=[text], labels=[" "], colors=[colour]))

    def follow(self, entity: str, middle_m: Array, half_m: float, rows: Bools | None = None) -> None:
        """Write an invisible box for the viewer to follow.

        `middle_m` (T, 3) is the middle of the box, and `half_m` half of its size, in metres. `rows` is a mask (T,) of
        the frames with a box, or None for all frames.
        """
        corners = np.stack((middle_m - half_m, middle_m + half_m), axis=1)
        is_shown = np.ones(corners.shape[:2], bool) if rows is None else np.repeat(rows[:, None], 2, axis=1)
        self.points(entity, corners, is_shown, colors=(0, 0, 0, 0), radii=0.0)


@dataclass(frozen=True)
class Scene:
    """Geometry of a clip that views and entities need, in the motion's frame of reference."""

    axes: Array
    """Two horizontal unit vectors and the upward unit vector, in rows, shape (3, 3)."""
    low_m: Array
    """Lower bounds of the animal over the clip in metres along `axes`, shape (3,)."""
    high_m: Array
    """Upper bounds of the animal over the clip in metres along `axes`, shape (3,)."""
    size_m: float
    """Median diagonal of the box around the animal in metres, over the frames."""
    camera_m: Array
    """Position of the first camera in metres, shape (3,); the mean over the frames if the camera moves."""

    @classmethod
    def from_motion(cls, motion: Motion) -> Scene:
        """Return the geometry that the views of a motion need."""
        camera = motion.camera
        axes, centre = level_from_camera(camera.up), np.zeros(3)
        if motion.frame_of_reference == "world":
            poses = motion.pictures[0].T_reference_camera.reshape(-1, 4, 4)
            centre = poses[:, :3, 3].mean(axis=0)
            axes = np.eye(3) if camera.world_z_up else axes @ poses[0, :3, :3].T
        joints = motion.joints_m[motion.solved] @ axes.T
        if not len(joints):
            return cls(axes, -np.ones(3), np.ones(3), 1.0, centre)
        size = float(np.median(np.linalg.norm(np.ptp(joints, axis=1), axis=1)))
        return cls(axes, *bounds(joints), size, centre)

    @property
    def centre_m(self) -> Array:
        """Return the middle of the box around the animal over the clip in metres, shape (3,)."""
        return (self.low_m + self.high_m) / 2 @ self.axes


def changes(values: Bools) -> Bools:
    """Return a mask (T,) of the first row and of all rows whose value differs from the previous row's."""
    return np.append(True, values[1:] != values[:-1])[: len(values)]


def bounds(joints_m: Array) -> tuple[Array, Array]:
    """Return the lower and upper corner (3,) of the box around joints (N, J, 3), without stray poses."""
    low, high = np.percentile(joints_m.reshape(-1, 3), (1, 99), axis=0)
    return low, high


def by_camera(root: str, pictures: Sequence[Picture]) -> list[str]:
    """Return the entity of each camera: `root` for a single camera, otherwise children of `root`."""
    if len(pictures) == 1:
        return [root]
    return [f"{root}/{rr.escape_entity_path_part(picture.name)}" for picture in pictures]


def limb_colours(motion: Motion) -> list[Colour]:
    """Return the colour of each limb, which depends on its side for a whole animal, and otherwise on the limb."""
    if motion.side is not None:
        return [LIMB_COLOURS[i % len(LIMB_COLOURS)] for i in range(len(motion.limbs))]
    return [SIDE_COLOURS[side] for side in motion.limb_sides.values()]


def joint_limbs(motion: Motion) -> Integers:
    """Return the index of the limb with which each of J joints is drawn, shape (J,).

    A joint of the trunk is drawn with the trunk, any other joint with the limb that it ends or continues.
    """
    limbs = list(motion.limbs.values())
    trunk = max(range(len(limbs)), key=lambda i: len({*motion.forward} & {*limbs[i]}), default=0)
    chosen = []
    for j in range(len(motion.joints)):
        limbs_of_joint = [i for i, limb in enumerate(limbs) if j in limb]
        not_first = [i for i in limbs_of_joint if limbs[i][0] != j]
        chosen.append(trunk if trunk in limbs_of_joint or not limbs_of_joint else (not_first or limbs_of_joint)[0])
    return np.array(chosen)


def limb_strips(
    points: Array, limbs: Mapping[str, Sequence[int]], is_shown: Bools, with_classes: bool = False
) -> rr.ComponentColumnList:
    """Return lines along the limbs of joints (T, J, 2 or 3), interrupted where the mask `is_shown` (T, J) is False.

    If `with_classes` is true, rerun's class of each line is the index of its limb.
    """
    along = [joint for limb in limbs.values() for joint in limb]
    limb_along = np.repeat(np.arange(len(limbs)), [len(limb) for limb in limbs.values()])
    shown_along = is_shown[:, along]
    is_bone = shown_along[:, 1:] & shown_along[:, :-1] & (limb_along[1:] == limb_along[:-1])
    joins_previous = np.pad(is_bone, ((0, 0), (1, 0)))
    is_on_strip = joins_previous | np.pad(is_bone, ((0, 0), (0, 1)))
    begins = is_on_strip & ~joins_previous
    first_points = np.flatnonzero(begins[is_on_strip])
    counts = np.diff(first_points, append=int(is_on_strip.sum()))
    classes = {"class_ids": np.broadcast_to(limb_along, begins.shape)[begins]} if with_classes else {}
    return _strips(points[:, along][is_on_strip], counts, **classes).partition(begins.sum(axis=1))


def strips(frames: Sequence[Sequence[Array]]) -> rr.ComponentColumnList:
    """Return the columns of the line strips of each frame, each strip with the shape (points, 3)."""
    all_strips = [strip for frame_strips in frames for strip in frame_strips]
    points = np.concatenate([np.zeros((0, 3)), *all_strips])
    return _strips(points, [len(strip) for strip in all_strips]).partition(
        [len(frame_strips) for frame_strips in frames]
    )


def lines(ends: Array, counts: Integers, **columns: Any) -> rr.ComponentColumnList:
    """Return the columns of N straight lines with `ends` (N, 2, 2 or 3), of which `counts` (T,) are in each frame.

    `columns` are further columns with a value for each line.
    """
    return _strips(ends.reshape(-1, ends.shape[-1]), np.full(len(ends), 2), **columns).partition(counts)


def _strips(points: Array, counts: Sequence[int] | Integers, **columns: Any) -> rr.ComponentColumnList:
    """Return strips of `counts` points each from points (N, 2 or 3), in rerun's final layout.

    rerun's own conversion creates an object for each strip, which is slow for a long clip.
    """
    import pyarrow as pa  # installed with rerun

    archetype, batch = rr.LineStrips3D, rr.components.LineStrip3DBatch
    if points.shape[1] == 2:
        archetype, batch = rr.LineStrips2D, rr.components.LineStrip2DBatch
    kind = batch([]).as_arrow_array().type
    values = pa.array(np.ascontiguousarray(points, dtype=np.float32).ravel())
    ends = pa.array(np.concatenate([[0], np.cumsum(counts)]), pa.int32())
    point_array = pa.FixedSizeListArray.from_arrays(values, type=kind.value_type)
    return archetype.columns(strips=pa.ListArray.from_arrays(ends, point_array, type=kind), **columns)


def unbroken(points: Array) -> list[Array]:
    """Return the parts of a line (N, 2 or 3) without NaN that have at least two points."""
    ranges = frame_ranges(np.flatnonzero(np.isfinite(points[:, 0])))
    return [points[first:stop] for first, stop in ranges if stop > first + 1]


def grid_lines(low_m: Array, high_m: Array, spacing_m: float) -> list[Array]:
    """Return lines (2, 2) at multiples of the spacing that cross a rectangle, given by two corners (2,)."""
    result = []
    for axis in (0, 1):
        for coordinate in np.arange(low_m[axis], high_m[axis] + spacing_m / 2, spacing_m):
            line = np.empty((2, 2))
            line[:, axis] = coordinate
            line[:, 1 - axis] = low_m[1 - axis], high_m[1 - axis]
            result.append(line)
    return result


def write_world(motion: Motion, scene: Scene, log: Log) -> None:
    """Log the skeleton, the path, the ground and the cameras of a motion to rerun's 3D view."""
    joints, solved = motion.joints_m, motion.solved
    if motion.frame_of_reference == "camera":
        log.fix("world", rr.ViewCoordinates.RDF)
    elif motion.camera.world_z_up:
        log.fix("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)

    is_solved = np.broadcast_to(solved[:, None], joints.shape[:2])
    style = {"class_ids": range(len(motion.limbs)), "radii": 0.017, "show_labels": False}
    log.draw("world/skeleton", rr.LineStrips3D, limb_strips(joints, motion.limbs, is_solved), **style)
    style = {"class_ids": joint_limbs(motion), "radii": 0.028, "labels": motion.names, "show_labels": False}
    log.points("world/skeleton/joints", joints, is_solved, **style)
    # The view follows the mean of the joints, which hardly moves with the legs, and shows some space around the animal.
    log.follow("world/followed", joints.mean(axis=1), 0.65 * scene.size_m, solved)

    root = motion.root_m
    log.fix("world/path", rr.LineStrips3D(unbroken(root), colors=PATH, radii=rr.Radius.ui_points(1.5)))
    # The view shows all rows of this entity up to the current frame, so each row is one step of the trail.
    step = solved[1:] & solved[:-1]
    ends = np.stack([root[:-1], root[1:]], axis=1)[step]
    style = {"colors": TRAIL, "radii": rr.Radius.ui_points(2.5)}
    log.draw("world/trail", rr.LineStrips3D, lines(ends, np.append(0, step)), **style)

    segments = [segment for segment in motion.solution.segments if solved[segment.rows].any()]
    grids = [_grid(motion, scene, segment) for segment in segments]
    style = {"colors": GRID, "radii": rr.Radius.ui_points(0.75)}
    log.fix("world/ground", rr.LineStrips3D.from_fields(**style))
    if len(grids) > 1:
        log.send("world/ground", strips(grids), [segment.rows.start for segment in segments])
    elif grids:
        log.fix("world/ground", rr.LineStrips3D(grids[0], **style))
    for entity, picture in zip(by_camera(CAMERAS, motion.pictures), motion.pictures, strict=True):
        _write_camera(entity, picture, scene, log)
    if len(motion.pictures) > 1:
        shape = len(motion.frames), 3
        centres_m = [np.broadcast_to(picture.T_reference_camera[..., :3, 3], shape) for picture in motion.pictures]
        centres_m, radius = np.stack(centres_m, axis=1), rr.Radius.ui_points(2.0)
        style = {"labels": [picture.name for picture in motion.pictures], "show_labels": True}
        log.points(
            "world/camera_names", centres_m, np.isfinite(centres_m[..., 0]), colors=CAMERA, radii=radius, **style
        )


def _write_camera(entity: str, picture: Picture, scene: Scene, log: Log) -> None:
    """Write the frustum of a camera in the world."""
    camera, pose = picture.camera, picture.T_reference_camera
    if pose.ndim == 3:
        log.send(entity, rr.Transform3D.columns(translation=pose[:, :3, 3], mat3x3=pose[:, :3, :3]))
    else:
        log.fix(entity, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    distance_m = float(np.linalg.norm(scene.centre_m - np.nanmean(pose[..., :3, 3].reshape(-1, 3), axis=0)))
    log.fix(
        entity,
        rr.Pinhole(
            image_from_camera=camera.matrix,
            resolution=camera.image_size_px,
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=max(0.25, 0.15 * distance_m),
            color=CAMERA,
            line_width=-1.0,  # a negative width is in units of the screen instead of metres
        ),
    )


def _grid(motion: Motion, scene: Scene, segment: MotionSegment) -> list[Array]:
    """Return lines (2, 3) on the ground under a segment's path, at multiples of the grid spacing.

    If the ground is unknown, the lines are horizontal, at the height of the lowest feet.
    """
    joints = motion.joints_m[segment.rows][motion.solved[segment.rows]] @ scene.axes.T
    up, below = scene.axes[2], motion.below_m(segment)
    point_m, normal = float(np.percentile(joints[:, motion.feet or slice(None), 2], 10)) * up, up
    if below is not None and segment.ground is not None:
        point_m, above = motion.in_reference(np.stack((below, below + np.append(-segment.ground.slope, 1.0))))
        normal = above - point_m
    low, high = bounds(joints)
    low, high, spacing = np.floor(low[:2] - GRID_MARGIN_M), np.ceil(high[:2] + GRID_MARGIN_M), GRID_SPACING_M
    while np.max(high - low) / spacing > MAX_GRID_LINES:
        spacing *= 10
    flat = np.array(grid_lines(low, high, spacing)) @ scene.axes[:2]
    rise = (point_m - flat) @ normal / (up @ normal)
    return [*(flat + rise[..., None] * up)]


def write_uncertainty(motion: Motion, log: Log, standing: Bools) -> None:
    """Write an ellipsoid around every joint, red in flagged frames, and mark the feet in stance (`standing`, (T, F)).

    Ellipsoids move in every frame, and have a new shape at most 25 times a second.
    """
    joints, has_flag = motion.joints_m, np.array([bool(flags) for flags in motion.flags])
    solved = motion.solved & np.isfinite(motion.relative_rms_m)  # the frame method has poses without uncertainty
    of_limb = np.array(limb_colours(motion))[joint_limbs(motion)]
    counts = np.where(solved, joints.shape[1], 0)
    colours = np.where(has_flag[solved][:, None, None], OUTLIER, of_limb).reshape(-1, 3)
    columns = rr.Ellipsoids3D.columns(
        centers=joints[solved].reshape(-1, 3),
        colors=np.column_stack((colours, np.full(len(colours), 70))).astype(np.uint8),
    )
    log.send("world/uncertainty", columns.partition(counts))
    every = max(1, math.ceil(motion.fps / MAX_SHAPES_HZ - 1e-9))
    has_shape = changes(solved) | (solved & (np.arange(len(joints)) % every == 0))
    for first in range(0, len(joints), _FRAMES_AT_ONCE):
        rows = first + np.flatnonzero(has_shape[first : first + _FRAMES_AT_ONCE])
        covariance = motion.relative_covariance_m2(slice(first, first + _FRAMES_AT_ONCE))[rows - first][solved[rows]]
        variance, axes = np.linalg.eigh(covariance.reshape(-1, 3, 3))
        axes[np.linalg.det(axes) < 0, :, 0] *= -1
        columns = rr.Ellipsoids3D.columns(half_sizes=np.sqrt(np.maximum(variance, 1e-8)), quaternions=quaternions(axes))
        log.send("world/uncertainty", columns.partition(counts[rows]), rows)
    style = {"fill_mode": FillMode.MajorWireframe, "line_radii": rr.Radius.ui_points(0.8), "show_labels": False}
    log.fix("world/uncertainty", rr.Ellipsoids3D.from_fields(**style))

    log.points("world/stance", joints[:, motion.feet], standing, colors=DETECTION, radii=0.05)


def write_pictures(motion: Motion, log: Log) -> None:
    """Write detections and reprojections in each picture, and the animal's middle, which centres the close view."""
    for picture, root in zip(motion.pictures, by_camera(PICTURE, motion.pictures), strict=True):
        size = np.array(picture.camera.image_size_px, dtype=float)
        edge = rr.Boxes2D(array=[-0.5, -0.5, *size], array_format=rr.Box2DFormat.XYWH, colors=EDGE)
        log.fix(f"{root}/{EDGE_OF_PICTURE}", edge)
        _write_points(root, motion, picture, log)
        has_pose = np.asarray(np.isfinite(picture.reprojected_px).any(axis=(1, 2)))
        if has_pose.any():  # in a frame without a pose, the view does not move
            nearest = np.maximum.accumulate(np.where(has_pose, np.arange(len(has_pose)), np.argmax(has_pose)))
            middles_px = middle_and_reach_px(picture)[0][nearest]
            log.send(f"{root}/{ANIMAL}", rr.Transform3D.columns(translation=np.pad(middles_px, ((0, 0), (0, 1)))))


def _write_points(root: str, motion: Motion, picture: Picture, log: Log) -> None:
    """Write the detections and reprojections of a picture, and the links between them, as children of `root`."""
    outliers, detected, reprojected = picture.outliers, picture.detected_px, picture.reprojected_px
    for entity, colour, selection in (("detections", DETECTION, ~outliers), ("outliers", OUTLIER, outliers)):
        is_shown = selection & np.isfinite(detected[..., 0])
        log.points(f"{root}/{entity}", detected, is_shown, colors=colour, radii=rr.Radius.ui_points(2.0))

    fixed_style = {"show_labels": False}
    is_seen = np.isfinite(reprojected[..., 0])
    columns = limb_strips(reprojected, motion.limbs, is_seen, with_classes=True)
    log.draw(f"{root}/reprojections", rr.LineStrips2D, columns, radii=rr.Radius.ui_points(1.5), **fixed_style)
    classes = np.broadcast_to(joint_limbs(motion), is_seen.shape)[is_seen]
    columns = rr.Points2D.columns(positions=reprojected[is_seen], class_ids=classes).partition(is_seen.sum(axis=1))
    log.draw(f"{root}/reprojections/joints", rr.Points2D, columns, radii=rr.Radius.ui_points(3.5), **fixed_style)

    hidden_px = HIDDEN_LINK * 2 * CLOSE_VIEW_SIZE * middle_and_reach_px(picture)[1].max()
    is_linked = outliers | (picture.distance_px >= hidden_px)
    ends = np.stack((detected, reprojected), axis=2)
    colours = np.where(outliers[is_linked][:, None], OUTLIER, LINK).astype(np.uint8)
    columns = lines(ends[is_linked], is_linked.sum(axis=1), colors=colours)
    log.draw(f"{root}/links", rr.LineStrips2D, columns, radii=rr.Radius.ui_points(1.5))


def middle_and_reach_px(picture: Picture) -> tuple[Array, Array]:
    """Return the middle (T, 2) and the extent (2,) of the reprojected skeleton in pixels, 0 without a pose."""
    is_seen = np.isfinite(picture.reprojected_px[..., 0])
    middle = np.nan_to_num(mean_along(picture.reprojected_px, axis=1))
    return middle, np.abs(picture.reprojected_px - middle[:, None])[is_seen].max(axis=0, initial=1.0)


def picture_bounds(picture: Picture) -> tuple[Array, Array]:
    """Return two corners, each (2,), of the part of the picture through which the animal passes, with a margin."""
    size = np.array(picture.camera.image_size_px, dtype=float)
    explained = np.where(picture.outliers[..., None], np.nan, picture.detected_px)
    points = np.concatenate((explained.reshape(-1, 2), picture.reprojected_px.reshape(-1, 2)))
    points = points[np.isfinite(points).all(axis=1)]
    points = points[picture.camera.in_image(points)]
    if not len(points):
        return np.full(2, -0.5), size - 0.5
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.08 * float(np.max(high - low)) + 10.0
    return low - margin, high + margin


JPEG_QUALITY = 85


def write_video(motion: Motion, log: Log, video: Path, first_frame: int = 0, number: int = 0) -> None:
    """Write the frames of a video as `picture/video`, which the close view also shows.

    If there are several cameras, the entity is `picture/<name>/video`. `first_frame` is the frame number, in the clip,
    of the video's first frame, and `number` is the index of the camera, whose pictures have the same size.

    Each frame is a JPEG, which every viewer shows. Without ffmpeg, viewers decode only AV1 videos, and jump from key
    frame to key frame in others. In rerun, (0, 0) is the corner of the top left pixel, but for keypoints it is the
    centre of this pixel. Therefore the picture is shifted by half a pixel to the right and down.

    Raises
    ------
    InputError
        If the video lacks frames.
    """
    import cv2  # slow to import, and most playbacks are without a video

    from recon.show.overlay import clip_frames

    entity = f"{by_camera(PICTURE, motion.pictures)[number]}/{VIDEO}"
    for _, t, _, image in clip_frames(motion.frames, video, first_frame):
        if t is not None:
            content = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
            log.send(entity, rr.EncodedImage.columns(blob=[content], media_type=["image/jpeg"]), [t])


_AT_ONCE = 1 << 20
"""Number of bytes of a recording that are copied at once."""


def require_whole() -> None:
    """Make rerun raise its warnings, because without enough memory it would leave out parts of a playback."""
    rr.set_strict_mode(True)


@contextmanager
def recording(path: Path, layout: rrb.Blueprint) -> Iterator[rr.RecordingStream]:
    """Yield a rerun recording, to which the block logs, and write it to a file.

    No file is left if the block raises an error.

    Raises
    ------
    OSError
        If the file cannot be written. The message has the path.
    """
    stream = rr.RecordingStream("recon")
    try:
        if not hasattr(os, "mkfifo"):  # Windows has no named pipes
            memory = stream.memory_recording()
            stream.send_blueprint(layout, make_active=True, make_default=True)
            yield stream
            write_bytes(path, memory.drain_as_bytes())
            return
        with TemporaryDirectory() as folder, ThreadPoolExecutor(1) as pool:
            pipe = Path(folder) / "pipe"
            os.mkfifo(pipe)
            source = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
            os.set_blocking(source, True)
            stream.save(pipe)
            written = pool.submit(_copy, source, path)
            try:
                stream.send_blueprint(layout, make_active=True, make_default=True)
                yield stream
            except BaseException:
                stream.disconnect()  # this ends the pipe, and with it the copy
                written.exception()
                path.unlink(missing_ok=True)
                raise
            stream.disconnect()
            written.result()
    finally:
        stream.disconnect()


def _copy(source: int, path: Path) -> None:
    """Copy a pipe into a file.

    If the file cannot be written, the pipe is still read to its end, because its writer would otherwise wait forever.
    """
    with open(source, "rb") as pipe:
        try:
            with path.open("wb") as file:
                while content := pipe.read(_AT_ONCE):
                    file.write(content)
        except OSError as error:
            while pipe.read(_AT_ONCE):
                pass
            error.filename = str(path)
            raise
