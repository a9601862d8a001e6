"""The animal in the cameras' pictures."""

from __future__ import annotations

import numpy as np
import rerun as rr

from recon.fit.motion import Motion, Picture
from recon.show.view.scene import (
    CLOSEUP,
    DETECTION,
    EDGE,
    LINK,
    OUTLIER,
    PICTURE,
    Array,
    Log,
    by_camera,
    joint_limbs,
    lines,
    strips,
    unbroken,
)

CLOSE = 1.1
"""Of the animal's reach, what the close look shows."""


def write_pictures(motion: Motion, log: Log) -> None:
    """The points twice: where they are in the picture, and around the middle of the animal, for a close look."""
    wholes, closeups = by_camera(PICTURE, motion.pictures), by_camera(CLOSEUP, motion.pictures)
    for picture, whole, closeup in zip(motion.pictures, wholes, closeups, strict=True):
        size = np.array(picture.camera.image_size_px, dtype=float)
        log.fix(f"{whole}/frame", rr.Boxes2D(array=[-0.5, -0.5, *size], array_format=rr.Box2DFormat.XYWH, colors=EDGE))
        low, high = picture_bounds(picture)
        origin_px = np.zeros((len(motion.frames), 2))
        _write_points(whole, origin_px, 0.007 * float(np.max(high - low)), motion, picture, log)
        middle, reach = middle_and_reach_px(picture)
        _write_points(closeup, middle, 0.03 * float(reach.max()), motion, picture, log)


def _write_points(root: str, origin_px: Array, arm: float, motion: Motion, picture: Picture, log: Log) -> None:
    """origin_px (T, 2): what is drawn at (0, 0); arm: of a detection's cross, px."""
    outliers = picture.outliers
    detected, reprojected = (xy - origin_px[:, None] for xy in (picture.detected_px, picture.reprojected_px))
    for entity, colour, chosen in (("detections", DETECTION, ~outliers), ("outliers", OUTLIER, outliers)):
        log.fix(f"{root}/{entity}", rr.LineStrips2D.from_fields(colors=colour, radii=rr.Radius.ui_points(1.0)))
        shown = chosen & np.isfinite(detected[..., 0])
        log.send(f"{root}/{entity}", lines(rr.LineStrips2D, _crosses(detected[shown], arm), 2 * shown.sum(axis=1)))

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


def _crosses(points_px: Array, arm_px: float) -> Array:
    """(2N, 2, 2): the ends of upright crosses at points (N, 2)."""
    arms = np.array([[[-arm_px, 0.0], [arm_px, 0.0]], [[0.0, -arm_px], [0.0, arm_px]]])
    return (points_px[:, None, None] + arms).reshape(-1, 2, 2)
