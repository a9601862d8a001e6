"""The animal in space."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import rerun as rr
from numpy.typing import NDArray
from rerun.components import FillMode

from recon.animal.capsules import capsule_ends, capsules
from recon.base.arrays import Bools
from recon.fit.motion import MEASURED_SHARE, Motion, Picture
from recon.geometry.frames import quaternions
from recon.geometry.kinematics import AXES, Marker
from recon.show.view.scene import (
    BODY,
    CAMERA,
    CAMERAS,
    DETECTION,
    EDGE,
    GRID,
    GRID_MARGIN_M,
    GRID_SPACING_M,
    MAX_GRID_LINES,
    OUTLIER,
    PATH,
    SIDE_COLOURS,
    TRAIL,
    Array,
    Floor,
    Log,
    Scene,
    by_camera,
    follow,
    grid_lines,
    joint_limbs,
    limb_colours,
    lines,
    strips,
    unbroken,
)

AXIS_SHARE = 0.06
"""Of the animal's size: half an axis."""
UNSEEN, FAINT_BLUE, BRIGHT_BLUE = (120, 112, 104), (30, 100, 190), (150, 220, 255)


def write_world(motion: Motion, scene: Scene, log: Log) -> None:
    joints = motion.joints_m
    if motion.frame_of_reference == "camera":
        log.fix("world", rr.ViewCoordinates.RDF)
    elif motion.camera.world_z_up:
        log.fix("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)

    limbs = [list(limb) for limb in motion.limbs.values()]
    log.fix("world/skeleton", rr.LineStrips3D.from_fields(class_ids=range(len(limbs)), radii=0.017, show_labels=False))
    drawn = [
        [pose[limb] for limb in limbs] if solved else [] for pose, solved in zip(joints, motion.solved, strict=True)
    ]
    log.send("world/skeleton", strips(rr.LineStrips3D, drawn))
    log.fix(
        "world/skeleton/joints",
        rr.Points3D.from_fields(class_ids=joint_limbs(motion), radii=0.028, labels=motion.names, show_labels=False),
    )
    counts = np.where(motion.solved, joints.shape[1], 0)
    columns = rr.Points3D.columns(positions=joints[motion.solved].reshape(-1, 3))
    log.send("world/skeleton/joints", columns.partition(counts))

    _write_body(motion, log)
    # More than the animal, and without the flutter of its legs.
    follow(log, "world/followed", joints.mean(axis=1), 0.65 * scene.size_m, motion.solved)

    root = motion.root_m
    log.fix("world/path", rr.LineStrips3D(unbroken(root), colors=PATH, radii=rr.Radius.ui_points(1.5)))
    log.fix("world/trail", rr.LineStrips3D.from_fields(colors=TRAIL, radii=rr.Radius.ui_points(2.5)))
    # The view shows this entity's rows up to the current one: a step each.
    steps = [[root[i - 1 : i + 1]] if i and motion.solved[i - 1 : i + 1].all() else [] for i in range(len(root))]
    log.send("world/trail", strips(rr.LineStrips3D, steps))

    _write_ground(scene, log)
    for entity, picture in zip(by_camera(CAMERAS, motion.pictures), motion.pictures, strict=True):
        _write_camera(entity, picture, motion.frame_of_reference == "world", scene, log)
    if len(motion.pictures) > 1:
        _write_camera_names(motion.pictures, log)


def _write_camera(entity: str, picture: Picture, placed: bool, scene: Scene, log: Log) -> None:
    """Its frustum. placed: not the origin."""
    camera, pose = picture.camera, picture.T_reference_camera
    if pose.ndim == 3:
        log.send(entity, rr.Transform3D.columns(translation=pose[:, :3, 3], mat3x3=pose[:, :3, :3]))
    elif placed:
        log.fix(entity, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    centre_m = np.nanmean(pose[..., :3, 3].reshape(-1, 3), axis=0)
    distance = float(np.linalg.norm(scene.centre_m - centre_m))
    log.fix(
        entity,
        rr.Pinhole(
            image_from_camera=camera.matrix,
            resolution=camera.image_size_px,
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=max(0.25, 0.15 * distance),
            color=CAMERA,
            line_width=-1.0,  # negative: on the screen, not in metres
        ),
    )


def _write_camera_names(pictures: Sequence[Picture], log: Log) -> None:
    names = [picture.name for picture in pictures]
    style = rr.Points3D.from_fields(colors=CAMERA, radii=rr.Radius.ui_points(2.0), labels=names, show_labels=True)
    places_m = [picture.T_reference_camera[..., :3, 3] for picture in pictures]
    if all(place.ndim == 1 for place in places_m):
        log.fix("world/camera_names", rr.Points3D(places_m))
    else:
        T = len(pictures[0].reprojected_px)
        by_frame = np.stack([np.broadcast_to(place, (T, 3)) for place in places_m], axis=1)
        columns = rr.Points3D.columns(positions=by_frame.reshape(-1, 3))
        log.send("world/camera_names", columns.partition([len(names)] * T))
    log.fix("world/camera_names", style)


def write_uncertainty(motion: Motion, scene: Scene, log: Log, stands: Bools) -> None:
    """How far the pose can be trusted: an ellipsoid around every joint, and a label in frames with a flag. And the feet
    that stand, (T, F)."""
    flags = motion.flags
    # The frame method has poses whose uncertainty is not known.
    solved = motion.solved & np.isfinite(motion.relative_rms_m)
    counts = np.where(solved, len(motion.joints), 0)
    variance, axes = np.linalg.eigh(motion.relative_covariance_m2[solved].reshape(-1, 3, 3))
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    of_limb = np.array(limb_colours(motion))[joint_limbs(motion)]
    doubtful = np.array([bool(f) for f in flags])[solved]
    colours = np.where(doubtful[:, None, None], OUTLIER, of_limb).reshape(-1, 3)
    columns = rr.Ellipsoids3D.columns(
        centers=motion.joints_m[solved].reshape(-1, 3),
        half_sizes=np.sqrt(np.maximum(variance, 1e-8)),
        quaternions=quaternions(axes),
        colors=np.column_stack((colours, np.full(len(colours), 70))).astype(np.uint8),
    )
    log.send("world/uncertainty", columns.partition(counts))
    log.fix(
        "world/uncertainty",
        rr.Ellipsoids3D.from_fields(
            fill_mode=FillMode.MajorWireframe, line_radii=rr.Radius.ui_points(0.8), show_labels=False
        ),
    )

    shown = [bool(f) and bool(s) for f, s in zip(flags, motion.solved, strict=True)]
    above = motion.joints_m.mean(axis=1) + 0.35 * scene.size_m * scene.axes[2]
    labels = [", ".join(f) for f, is_shown in zip(flags, shown, strict=True) if is_shown]
    columns = rr.Points3D.columns(positions=above[shown], labels=labels)
    log.send("world/doubt", columns.partition(np.array(shown, dtype=int)))
    log.fix("world/doubt", rr.Points3D.from_fields(colors=OUTLIER, radii=rr.Radius.ui_points(3.0), show_labels=True))

    feet = motion.joints_m[:, motion.feet]
    log.send("world/stance", rr.Points3D.columns(positions=feet[stands]).partition(stands.sum(axis=1)))
    log.fix("world/stance", rr.Points3D.from_fields(colors=DETECTION, radii=0.05))


def _write_body(motion: Motion, log: Log) -> None:
    """Capsules along the segments, in the colours of the limbs."""
    tree, solution = motion.body.tree, motion.solution
    shape = capsules(tree, motion.names)
    begins, ends = capsule_ends(tree, shape, motion.states[motion.solved], solution.size)
    lengths = np.array([np.linalg.norm(capsule.end_m) for capsule in shape])
    x, y, z = np.moveaxis(motion.in_reference(ends) - motion.in_reference(begins), -1, 0) / (lengths * solution.size)
    # They lie along z at first. Half a turn about x, where they point the other way.
    turns = np.stack([-y, x, np.zeros_like(z), 1 + z], axis=-1)
    turns[1 + z < 1e-9] = 1.0, 0.0, 0.0, 0.0
    turns /= np.linalg.norm(turns, axis=-1, keepdims=True)
    limb_of = {m.segment: limb for m, limb in zip(tree.markers, joint_limbs(motion).tolist(), strict=True)}
    colours = [
        SIDE_COLOURS[capsule.side] if motion.side is None else limb_colours(motion)[limb_of[name]]
        for capsule, name in ((capsule, tree.segments[capsule.segment].name) for capsule in shape)
    ]
    radii = [solution.size * capsule.radius_m for capsule in shape]
    style = rr.Capsules3D.from_fields(
        lengths=solution.size * lengths, radii=radii, colors=colours, fill_mode=FillMode.Solid, show_labels=False
    )
    log.fix(BODY, style)
    columns = rr.Capsules3D.columns(
        translations=motion.in_reference(begins).reshape(-1, 3), quaternions=turns.reshape(-1, 4)
    )
    log.send(BODY, columns.partition(np.where(motion.solved, len(shape), 0)))


def write_observability(motion: Motion, scene: Scene, log: Log) -> None:
    """At every joint the axes that it turns about, in the colour of the pixels' share in the angle; and the limbs."""
    solved, tree = motion.solved, motion.body.tree
    states = motion.states[solved]
    limbs = [list(limb) for limb in motion.limbs.values()]
    log.fix("world/observability/limbs", rr.LineStrips3D.from_fields(colors=EDGE, radii=0.005))
    drawn = [[pose[limb] for limb in limbs] if s else [] for pose, s in zip(motion.joints_m, solved, strict=True)]
    log.send("world/observability/limbs", strips(rr.LineStrips3D, drawn))

    turning = [i for i, segment in enumerate(tree.segments) for _ in AXES[segment.joint]]
    columns = ["xyz".index(axis) for axis in tree.axes]
    origins = replace(tree, markers=tuple(Marker(s.name, s.name) for s in tree.segments))
    centres = motion.in_reference(origins.pose(states, motion.solution.size).points_m)[:, turning]
    axes = tree.orientations(states)[:, turning, :, columns]  # the angles come first, as indices on both sides do
    along = AXIS_SHARE * scene.size_m * np.moveaxis(axes, 0, 1) @ motion.T_reference_world[:3, :3].T
    ends = np.stack((centres - along, centres + along), axis=2)
    colours = share_colours(motion.solution.angle_data_share[solved]).reshape(-1, 3)
    counts = np.where(solved, len(turning), 0)
    log.send("world/observability", lines(rr.LineStrips3D, ends.reshape(-1, 2, 3), counts, colors=colours))
    style = rr.LineStrips3D.from_fields(radii=0.013, labels=motion.angle_names, show_labels=False)
    log.fix("world/observability", style)


def share_colours(share: Array) -> NDArray[np.uint8]:
    """(..., 3): of shares (...) from 0 to 1: grey below `MEASURED_SHARE`, from there on blue, the lighter the more."""
    above = np.clip((share - MEASURED_SHARE) / (1 - MEASURED_SHARE), 0.0, 1.0)[..., None]
    blue = (1 - above) * np.array(FAINT_BLUE) + above * np.array(BRIGHT_BLUE)
    return np.where((share >= MEASURED_SHARE)[..., None], blue, UNSEEN).astype(np.uint8)


def _write_ground(scene: Scene, log: Log) -> None:
    """A clip with several segments shows each one's ground from the segment's first frame on."""
    radii = rr.Radius.ui_points(0.75)
    grids = [_grid(scene, floor) for floor in scene.floors]
    if len(grids) == 1:
        log.fix("world/ground", rr.LineStrips3D(grids[0], colors=GRID, radii=radii))
        return
    log.fix("world/ground", rr.LineStrips3D.from_fields(colors=GRID, radii=radii))
    log.send("world/ground", strips(rr.LineStrips3D, grids), [floor.start for floor in scene.floors])


def _grid(scene: Scene, floor: Floor) -> list[Array]:
    """Lines (2, 3) on the ground under the path over it, at whole metres of the level axes."""
    low = np.floor(floor.low_m - GRID_MARGIN_M)
    high = np.ceil(floor.high_m + GRID_MARGIN_M)
    spacing = GRID_SPACING_M
    while np.max(high - low) / spacing > MAX_GRID_LINES:
        spacing *= 10
    return [scene.on_ground(floor, line) for line in grid_lines(low, high, spacing)]
