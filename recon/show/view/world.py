"""The animal in space, and in the cameras' pictures."""

from __future__ import annotations

import numpy as np
import rerun as rr
from rerun.components import FillMode

from recon.base.arrays import Array, Bools
from recon.fit import MotionSegment
from recon.fit.motion import Motion, Picture
from recon.geometry.rotations import quaternions
from recon.show.view.scene import (
    CAMERA,
    CAMERAS,
    CLOSEUP,
    DETECTION,
    EDGE,
    GRID,
    GRID_SPACING_M,
    LINK,
    OUTLIER,
    PATH,
    PICTURE,
    TRAIL,
    Log,
    Scene,
    bounds,
    by_camera,
    grid_lines,
    joint_limbs,
    limb_colours,
    limb_strips,
    lines,
    strips,
    unbroken,
)

CLOSE = 1.1
"""The share of the animal's reach that the close look shows."""
GRID_MARGIN_M, MAX_GRID_LINES = 1.5, 200


def write_world(motion: Motion, scene: Scene, log: Log) -> None:
    """Skeleton, path, ground and cameras."""
    joints, solved = motion.joints_m, motion.solved
    if motion.frame_of_reference == "camera":
        log.fix("world", rr.ViewCoordinates.RDF)
    elif motion.camera.world_z_up:
        log.fix("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)

    classes = range(len(motion.limbs))
    log.fix("world/skeleton", rr.LineStrips3D.from_fields(class_ids=classes, radii=0.017, show_labels=False))
    log.send("world/skeleton", limb_strips(rr.LineStrips3D, joints, motion.limbs, solved))
    style = {"class_ids": joint_limbs(motion), "radii": 0.028, "labels": motion.names, "show_labels": False}
    log.points("world/skeleton/joints", joints, np.broadcast_to(solved[:, None], joints.shape[:2]), **style)
    # More than the animal, and without the flutter of its legs.
    log.follow("world/followed", joints.mean(axis=1), 0.65 * scene.size_m, solved)

    root = motion.root_m
    log.fix("world/path", rr.LineStrips3D(unbroken(root), colors=PATH, radii=rr.Radius.ui_points(1.5)))
    log.fix("world/trail", rr.LineStrips3D.from_fields(colors=TRAIL, radii=rr.Radius.ui_points(2.5)))
    # The view shows this entity's rows up to the current one: a step each.
    steps = [[root[i - 1 : i + 1]] if i and solved[i - 1 : i + 1].all() else [] for i in range(len(root))]
    log.send("world/trail", strips(rr.LineStrips3D, steps))

    segments = [segment for segment in motion.solution.segments if solved[segment.rows].any()]
    grids = [_grid(motion, scene, segment) for segment in segments]
    style = {"colors": GRID, "radii": rr.Radius.ui_points(0.75)}
    log.fix("world/ground", rr.LineStrips3D.from_fields(**style))
    if len(grids) > 1:
        log.send("world/ground", strips(rr.LineStrips3D, grids), [segment.rows.start for segment in segments])
    elif grids:
        log.fix("world/ground", rr.LineStrips3D(grids[0], **style))
    for entity, picture in zip(by_camera(CAMERAS, motion.pictures), motion.pictures, strict=True):
        _write_camera(entity, picture, scene, log)
    if len(motion.pictures) > 1:
        shape = len(motion.frames), 3
        places_m = [np.broadcast_to(picture.T_reference_camera[..., :3, 3], shape) for picture in motion.pictures]
        places_m, radius = np.stack(places_m, axis=1), rr.Radius.ui_points(2.0)
        style = {"labels": [picture.name for picture in motion.pictures], "show_labels": True}
        log.points("world/camera_names", places_m, np.isfinite(places_m[..., 0]), colors=CAMERA, radii=radius, **style)


def _write_camera(entity: str, picture: Picture, scene: Scene, log: Log) -> None:
    """Its frustum."""
    camera, pose = picture.camera, picture.T_reference_camera
    if pose.ndim == 3:
        log.send(entity, rr.Transform3D.columns(translation=pose[:, :3, 3], mat3x3=pose[:, :3, :3]))
    else:
        log.fix(entity, rr.Transform3D(translation=pose[:3, 3], mat3x3=pose[:3, :3]))
    away_m = float(np.linalg.norm(scene.centre_m - np.nanmean(pose[..., :3, 3].reshape(-1, 3), axis=0)))
    log.fix(
        entity,
        rr.Pinhole(
            image_from_camera=camera.matrix,
            resolution=camera.image_size_px,
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=max(0.25, 0.15 * away_m),
            color=CAMERA,
            line_width=-1.0,  # negative: on the screen, not in metres
        ),
    )


def _grid(motion: Motion, scene: Scene, segment: MotionSegment) -> list[Array]:
    """Lines (2, 3) on the ground under a segment's path, at whole metres of the level axes. Where no foot stood, the
    ground is level, and as low as the feet."""
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


def write_uncertainty(motion: Motion, log: Log, stands: Bools) -> None:
    """How far the pose can be trusted: an ellipsoid around every joint, red in frames with a flag. And the feet that
    stand, (T, F)."""
    joints, flagged = motion.joints_m, np.array([bool(flags) for flags in motion.flags])
    solved = motion.solved & np.isfinite(motion.relative_rms_m)  # the frame method has poses without uncertainty
    variance, axes = np.linalg.eigh(motion.relative_covariance_m2[solved].reshape(-1, 3, 3))
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    of_limb = np.array(limb_colours(motion))[joint_limbs(motion)]
    colours = np.where(flagged[solved][:, None, None], OUTLIER, of_limb).reshape(-1, 3)
    columns = rr.Ellipsoids3D.columns(
        centers=joints[solved].reshape(-1, 3),
        half_sizes=np.sqrt(np.maximum(variance, 1e-8)),
        quaternions=quaternions(axes),
        colors=np.column_stack((colours, np.full(len(colours), 70))).astype(np.uint8),
    )
    log.send("world/uncertainty", columns.partition(np.where(solved, joints.shape[1], 0)))
    style = {"fill_mode": FillMode.MajorWireframe, "line_radii": rr.Radius.ui_points(0.8), "show_labels": False}
    log.fix("world/uncertainty", rr.Ellipsoids3D.from_fields(**style))

    log.points("world/stance", joints[:, motion.feet], stands, colors=DETECTION, radii=0.05)


# -- the pictures -------------------------------------------------------------------------------------------------


def write_pictures(motion: Motion, log: Log) -> None:
    """The points twice: where they are in the picture, and around the middle of the animal, for a close look."""
    wholes, closeups = by_camera(PICTURE, motion.pictures), by_camera(CLOSEUP, motion.pictures)
    for picture, whole, closeup in zip(motion.pictures, wholes, closeups, strict=True):
        size = np.array(picture.camera.image_size_px, dtype=float)
        log.fix(f"{whole}/frame", rr.Boxes2D(array=[-0.5, -0.5, *size], array_format=rr.Box2DFormat.XYWH, colors=EDGE))
        _write_points(whole, np.zeros((len(motion.frames), 2)), motion, picture, log)
        _write_points(closeup, middle_and_reach_px(picture)[0], motion, picture, log)


def _write_points(root: str, origin_px: Array, motion: Motion, picture: Picture, log: Log) -> None:
    """origin_px (T, 2): what is drawn at (0, 0)."""
    outliers = picture.outliers
    detected, reprojected = (xy - origin_px[:, None] for xy in (picture.detected_px, picture.reprojected_px))
    for entity, colour, chosen in (("detections", DETECTION, ~outliers), ("outliers", OUTLIER, outliers)):
        shown = chosen & np.isfinite(detected[..., 0])
        log.send(f"{root}/{entity}", rr.Points2D.columns(positions=detected[shown]).partition(shown.sum(axis=1)))
        log.fix(f"{root}/{entity}", rr.Points2D.from_fields(colors=colour, radii=rr.Radius.ui_points(2.0)))

    limbs = [list(limb) for limb in motion.limbs.values()]
    parts = [[(c, part) for c, limb in enumerate(limbs) for part in unbroken(pose[limb])] for pose in reprojected]
    classes = [c for frame in parts for c, _ in frame]
    drawn = [[part for _, part in frame] for frame in parts]
    log.send(f"{root}/reprojections", strips(rr.LineStrips2D, drawn, class_ids=classes))
    log.fix(f"{root}/reprojections", rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(1.5), show_labels=False))
    seen = np.isfinite(reprojected[..., 0])
    classes = np.broadcast_to(joint_limbs(motion), seen.shape)[seen]
    columns = rr.Points2D.columns(positions=reprojected[seen], class_ids=classes)
    log.send(f"{root}/reprojections/joints", columns.partition(seen.sum(axis=1)))
    log.fix(f"{root}/reprojections/joints", rr.Points2D.from_fields(radii=rr.Radius.ui_points(3.5), show_labels=False))

    both = np.isfinite(picture.distance_px)
    ends = np.stack((detected, reprojected), axis=2)
    colours = np.where(outliers[both][:, None], OUTLIER, LINK).astype(np.uint8)
    log.send(f"{root}/links", lines(rr.LineStrips2D, ends[both], both.sum(axis=1), colors=colours))
    log.fix(f"{root}/links", rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(1.5)))


def middle_and_reach_px(picture: Picture) -> tuple[Array, Array]:
    """(T, 2): middle of the reprojected skeleton, 0 without one; (2,): how far its joints lie from there in x and y."""
    middle = np.zeros((len(picture.reprojected_px), 2))
    seen = np.isfinite(picture.reprojected_px[..., 0])
    known = np.any(seen, axis=-1)
    middle[known] = np.nanmean(picture.reprojected_px[known], axis=1)
    return middle, np.abs(picture.reprojected_px - middle[:, None])[seen].max(axis=0, initial=1.0)


def picture_bounds(picture: Picture) -> tuple[Array, Array]:
    """Corners (2,), (2,) of the part of the picture that the animal passes through, with a margin."""
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
