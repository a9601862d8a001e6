"""Compute the flexion of the anatomical joints of a body, and its derivatives with respect to the body's angles.

The skeleton's file lists the three markers that define each joint (`[anatomy]`). The flexion is the angle between the
line from the first marker to the joint and the line from the joint to the third marker, in the sagittal plane of the
segment that carries the first marker. A straight joint has a flexion of 0, and a hyperextended joint a negative one.
"""

from __future__ import annotations

import numpy as np

from recon.animal.anatomy import FLEXES_CAUDALLY, joint_and_side, sagittal_angle
from recon.animal.body import Body
from recon.base.arrays import Array
from recon.geometry.kinematics import YAW

_ROWS_AT_ONCE = 64
"""Number of frames whose derivatives are computed at once, to limit memory."""


def flexion_rad(body: Body, states: Array, size: float = 1.0) -> Array:
    """Return the flexion of the A anatomical joints (`body.anatomy`) in states (T, D), shape (A, T), rad.

    Angles are between -90 and 270 degrees, because no joint extends 90 degrees beyond straight, while a folded joint
    may bend by more than 180 degrees.
    """
    points_m = body.tree.pose(states, size).points_m
    orientations = body.tree.orientations(states)
    segment_names = [segment.name for segment in body.tree.segments]
    carriers = {marker.name: segment_names.index(marker.segment) for marker in body.tree.markers}
    angles = []
    for name, markers in body.anatomy.items():
        first, middle, last = (points_m[:, body.markers.index(marker)] for marker in markers)
        left = orientations[:, carriers[markers[0]], :, 1]
        angle = sagittal_angle(middle - first, last - middle, left) * FLEXES_CAUDALLY[joint_and_side(name)[0]]
        angles.append(np.mod(angle + np.pi / 2, 2 * np.pi) - np.pi / 2)
    return np.array(angles).reshape(-1, len(states))


def _gradients(proximal: Array, distal: Array, left: Array) -> tuple[Array, Array, Array]:
    """Return the derivatives of `sagittal_angle` with respect to its three arguments, each of shape (..., 3)."""
    sideways = np.sum(proximal * left, axis=-1, keepdims=True), np.sum(distal * left, axis=-1, keepdims=True)
    normal = np.cross(proximal, distal)
    sine = np.sum(normal * left, axis=-1, keepdims=True)
    cosine = np.sum(proximal * distal, axis=-1, keepdims=True) - sideways[0] * sideways[1]
    square = sine**2 + cosine**2
    sine, cosine = sine / square, cosine / square
    return (
        cosine * np.cross(distal, left) - sine * (distal - sideways[1] * left),
        cosine * np.cross(left, proximal) - sine * (proximal - sideways[0] * left),
        cosine * normal + sine * (sideways[1] * proximal + sideways[0] * distal),
    )


def flexion_by_angles(body: Body, states: Array, size: float = 1.0) -> Array:
    """Return the derivatives of the A flexions with respect to the fit's angles in states (T, D), shape (T, A, D - 3).

    A flexion follows from several angles if the first marker is not on the axis of its bone, or if the joint's markers
    are on more than two segments.
    """
    tree, rows = body.joint_points
    sign = np.array([FLEXES_CAUDALLY[joint_and_side(name)[0]] for name in body.anatomy])[:, None, None]
    derivatives = np.empty((len(states), len(rows), states.shape[1] - YAW))
    for start in range(0, len(states) if body.anatomy else 0, _ROWS_AT_ONCE):
        frames = slice(start, start + _ROWS_AT_ONCE)
        posed = tree.pose_with_jacobian(states[frames], size)
        first, middle, last, right, left = np.moveaxis(posed.points_m[:, rows], 2, 0)
        by_proximal, by_distal, by_left = _gradients(middle - first, last - middle, (left - right) / size)
        by_point = np.zeros((len(first), len(rows), len(tree.markers), 3))
        by_point[:, np.arange(len(rows))[:, None], rows] = sign * np.stack(
            [-by_proximal, by_proximal - by_distal, by_distal, -by_left / size, by_left / size], axis=2
        )
        jacobian = posed.jacobian.reshape(len(first), -1, states.shape[1])
        derivatives[frames] = (by_point.reshape(*by_point.shape[:2], -1) @ jacobian)[..., YAW:]
    return derivatives
