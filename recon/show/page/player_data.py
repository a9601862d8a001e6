"""Prepare the data for a page's player: motion, pictures of cameras, curves, stances and findings.

`player/data.js` reads the data. Arrays over frames are stored as integers in base64, so that a page of 4,000 frames
stays small.
"""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping
from itertools import groupby
from typing import Any

import numpy as np

from recon.animal.body import side_of
from recon.animal.naming import both_sides
from recon.base.arrays import Array, Integers
from recon.check.codes import sentences
from recon.fit.motion import MEASURED_FRACTION, Motion, Picture
from recon.fit.regions import radius
from recon.gait.clip import ClipAnalysis
from recon.gait.stances import FOOT_ROWS, INTERVAL, interval_of
from recon.show.page.pictures import PictureStrip
from recon.show.page.quality import keypoint_notes

MAX_PACKED = 32_000
"""Largest absolute value of a number packed into 16 bits."""
NAN_CODE = -32_768
"""16-bit number that stands for NaN."""
MAX_PACKED_BYTE = 254
"""Largest number that is packed into a byte."""
NO_BYTE = 255
"""Byte that stands for NaN."""
CAMERA_BYTES = 1_800_000
"""Largest size of the cameras' detections in a page, in bytes before base64 encoding.

The camera that is shown first is always included.
"""
MAX_UNCERTAINTY_FRAMES = 600
"""Largest number of frames whose uncertainty is stored, evenly spaced because uncertainty changes slowly."""
POSTURE_BYTES = 400_000
"""Size of the model's angle curves in bytes above which a page with anatomical flexions leaves these curves out."""
HINGE_DEG = 0.5
"""Largest range in degrees of the difference between a flexion and an angle of the model that show the same."""
MISSING, FITS, OUTLIER = 0, 1, 2
"""States of a detection in the player's data."""


def player_data(
    motion: Motion, analysis: ClipAnalysis | None, number: int = 0, pictures: PictureStrip | None = None
) -> dict[str, Any]:
    """Return the data of a page's player in JSON types.

    Parameters
    ----------
    motion, analysis
        Motion, and its analysis; None if the motion has too few frames.
    number
        Index of the camera whose picture is shown first.
    pictures
        Pictures of that camera's video.
    """
    return {
        "frames": packed_integers(motion.frames),
        "fps": motion.fps,
        "keypoints": list(motion.names),
        "limbs": [
            {"name": name, "side": motion.limb_sides[name] or "middle", "joints": [int(j) for j in joints]}
            for name, joints in motion.limbs.items()
        ],
        "reference": motion.names.index(motion.reference),
        "trunk": list(motion.forward),
        "flags": [[first, stop, ", ".join(flags)] for first, stop, flags in flag_runs(motion)],
        "scene": _scene(motion),
        "chosen": number,
        "cameras": list(_cameras(motion, number)),
        "pictures": None if pictures is None else pictures.to_json(),
        "curves": [] if analysis is None else list(_curves(analysis)),
        "feet": sorted(motion.foot_labels, key=[*FOOT_ROWS, *motion.foot_labels].index),
        "stances": [] if analysis is None or analysis.gait is None else _stances(motion, analysis),
        "findings": [
            {
                "text": text,
                "severity": item.severity,
                "frames": None if item.frames is None else list(item.frames),
                "camera": item.camera,
                "keypoints": [name for name in item.names("keypoints") if name in motion.names],
            }
            for item, text in sentences(motion)
        ],
    }


def flag_runs(motion: Motion) -> Iterator[tuple[int, int, tuple[str, ...]]]:
    """Yield the start index, the stop index and the flags of each run of frames with the same flags."""
    for flags, rows_of_run in groupby(range(len(motion.flags)), lambda t: motion.flags[t]):
        if flags:
            rows = [*rows_of_run]
            yield rows[0], rows[-1] + 1, flags


def packed(values: Array, least_unit: float = 1e-9) -> dict[str, Any]:
    """Return an array as little-endian 16-bit integers in base64, with their unit and offset."""
    known = values[np.isfinite(values)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 0.0)
    offset, unit = (low + high) / 2, max((high - low) / 2 / MAX_PACKED, least_unit)
    units = np.where(np.isfinite(values), np.round((values - offset) / unit), NAN_CODE).astype("<i2")
    return {"type": "i2", "unit": unit, "offset": offset, "data": base64.b64encode(units.tobytes()).decode()}


def packed_shares(values: Array) -> dict[str, Any]:
    """Return an array of numbers from 0 to 1 as bytes in base64."""
    units = np.where(np.isfinite(values), np.round(np.clip(values, 0, 1) * MAX_PACKED_BYTE), NO_BYTE).astype("u1")
    data = base64.b64encode(units.tobytes()).decode()
    return {"type": "u1", "unit": 1 / MAX_PACKED_BYTE, "offset": 0.0, "data": data}


def packed_integers(values: Integers) -> dict[str, Any]:
    """Return an array of integers as 32-bit integers in base64."""
    data = base64.b64encode(np.asarray(values).astype("<i4").tobytes()).decode()
    return {"type": "i4", "unit": 1, "offset": 0, "data": data}


def packed_states(values: Array) -> dict[str, Any]:
    """Return an array of small integers as bytes in base64."""
    return {"type": "u1", "unit": 1, "offset": 0, "data": base64.b64encode(values.astype("u1").tobytes()).decode()}


def _scene(motion: Motion) -> dict[str, Any]:
    """Return joints, uncertainty, ground and cameras in the frame of `Motion.upright` (z up), m."""
    joints_m = motion.upright.xyz_m
    posed_m = joints_m[motion.solved]
    every = -(-len(joints_m) // MAX_UNCERTAINTY_FRAMES)
    lengths_m = np.nanmax(np.ptp(posed_m, axis=1), axis=1) if len(posed_m) else np.ones(1)
    return {
        "joints_m": packed(joints_m, 1e-5),
        "spread_m": packed(_spreads(motion.solution.relative_covariance_m2[every // 2 :: every]), 1e-6),
        "spread_every": every,
        "radius_90": radius(INTERVAL, 2),
        "length_m": float(np.nanmedian(lengths_m)),
        "ground": list(_grounds(motion)),
        "cameras": [_camera_pose(motion, v) for v in range(len(motion.cameras))],
    }


def _spreads(covariance_m2: Array) -> Array:
    """Return the lower Cholesky factors (xx, yx, yy, zx, zy, zz) of covariances (T, J, 3, 3), shape (T, J, 6)."""
    known = np.isfinite(covariance_m2.sum(axis=(2, 3), keepdims=True))
    regular = np.where(known, covariance_m2, 0.0) + 1e-12 * np.eye(3)
    values, vectors = np.linalg.eigh(regular)  # rounding can make a variance slightly negative
    regular = (vectors * np.maximum(values, 1e-12)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    factors = np.linalg.cholesky(regular)[..., [0, 1, 1, 2, 2, 2], [0, 0, 1, 0, 1, 2]]
    return np.where(known[..., 0], factors, np.nan)


def _grounds(motion: Motion) -> Iterator[dict[str, Any]]:
    """Yield each segment's ground plane, or a level plane through the lowest joints if the ground is unknown."""
    for segment in motion.segments:
        first, stop, _ = segment.rows.indices(len(motion.frames))
        lowest_m = motion.upright.xyz_m[first:stop, :, 2]
        if segment.ground is not None:
            slope, height_m = np.asarray(segment.ground.slope).tolist(), float(segment.ground.height_m)
        elif np.isfinite(lowest_m).any():
            slope, height_m = [0.0, 0.0], float(np.nanpercentile(lowest_m, 2))
        else:
            continue
        yield {"rows": [first, stop], "height_m": height_m, "slope": slope, "known": segment.ground is not None}


def _camera_pose(motion: Motion, number: int) -> dict[str, Any]:
    """Return the position and rotation of a camera, for each frame if the camera moves."""
    view, camera = motion.solution.views[number], motion.cameras[number]
    T_camera_world = np.asarray(view.T_camera_world)
    R, t = T_camera_world[..., :3, :3], T_camera_world[..., :3, 3]
    centre_m = -np.einsum("...ij,...i->...j", R, t)
    poses = np.concatenate([R.reshape(*R.shape[:-2], 9), centre_m], axis=-1)
    width, height = camera.image_size_px
    matrix = np.asarray(camera.matrix)
    return {
        "name": camera.name,
        "moves": poses.ndim == 2,
        "poses": [_number(x) for x in poses] if poses.ndim == 1 else packed(poses),
        "half_angles": [width / 2 / float(matrix[0, 0]), height / 2 / float(matrix[1, 1])],
    }


def _number(value: float) -> float | None:
    return round(float(value), 6) if np.isfinite(value) else None


def _cameras(motion: Motion, number: int) -> Iterator[dict[str, Any]]:
    """Yield an entry for each camera, without its detections if they would make the page too large."""
    frames, joints = motion.keypoints.present.shape
    size, per_camera = 0, 11 * frames * joints
    order = [number, *(v for v in range(len(motion.cameras)) if v != number)]
    whole = []
    for v in order:
        size += per_camera
        if v == number or size <= CAMERA_BYTES:
            whole.append(v)
    for v, picture in enumerate(motion.pictures):
        head = {"name": picture.name, "size_px": [int(x) for x in picture.camera.image_size_px]}
        notes = {"notes": keypoint_notes(motion, picture)}
        yield head | (_detections(picture) | notes if v in whole else {"detected_px": None})


def _detections(picture: Picture) -> dict[str, Any]:
    far_px = 2.0 * max(picture.camera.image_size_px)  # points farther away are not drawn
    near_px = [np.where(np.abs(xy) < far_px, xy, np.nan) for xy in (picture.detected_px, picture.reprojected_px)]
    # The reprojection includes the detector's offset, because the reprojection is compared with the detection.
    states = np.where(picture.present, FITS, MISSING)
    states[picture.outliers] = OUTLIER
    return {
        "detected_px": packed(near_px[0], 0.01),
        "reprojected_px": packed(near_px[1], 0.01),
        "state": packed_states(states),
        "likelihood": packed_shares(np.where(picture.present, picture.source.keypoints.confidence, np.nan)),
        "weight": packed_shares(picture.weight),
    }


def _curves(analysis: ClipAnalysis) -> Iterator[dict[str, Any]]:
    """Yield panels of curves over time, each with a title, a unit, a group, and a curve for each side."""
    motion = analysis.motion
    if analysis.why_no_speed is None:
        series = analysis.reference_motion.series
        values = (analysis.reference_motion.speed_m_s, analysis.reference_motion.speed_sigma_m_s)
        speed, sigma = (_at(motion.time_s, series.time_s, x) for x in values)
        yield _panel(f"speed of {motion.reference}", "m/s", "speed", {None: (speed, sigma, True)}, least=0.0)
    by_joint: dict[str, dict[Any, tuple[Array, Array, bool]]] = {}
    for flexion in analysis.flexions:
        curves = by_joint.setdefault(flexion.joint, {})
        curves[flexion.side] = np.degrees(flexion.angle_rad), np.degrees(flexion.sigma_rad), True
    panels = posture_panels(motion)
    for joint, curves in by_joint.items():
        if (title := _hinge_angle(curves, panels)) is not None:
            hinge = panels.pop(title)
            curves = {side: (angle, sigma, hinge[side][2]) for side, (angle, sigma, _) in curves.items()}
        yield _panel(f"{joint.replace('_', ' ')} flexion", "°", "flexion", curves)
    if not by_joint or 4 * motion.posture_rad.size <= POSTURE_BYTES:
        for title, panel in panels.items():
            yield _panel(title, "°", "angle", panel)


def posture_panels(motion: Motion) -> dict[str, dict[Any, tuple[Array, Array, bool]]]:
    """Return panels of the model's angles, keyed by their titles, each with a curve for each side.

    A curve consists of values and standard deviations in degrees, shape (T,), and whether the pixels determine the
    angle.
    """
    shares, panels = motion.data_shares, dict[str, dict[Any, tuple[Array, Array, bool]]]()
    for name, angle, sigma in zip(motion.posture_names, motion.posture_rad.T, motion.posture_sigma_rad.T, strict=True):
        title = both_sides(name).replace("_rad", "").replace("_", " ")
        values = np.degrees(angle), np.degrees(sigma), not shares[name] < MEASURED_FRACTION
        panels.setdefault(title, {})[side_of(name)] = values
    return panels


def _hinge_angle(
    flexions: Mapping[Any, tuple[Array, Array, bool]],
    panels: Mapping[str, Mapping[Any, tuple[Array, Array, bool]]],
) -> str | None:
    """Return the title of the model's angle that has the same curves as a joint's flexion, up to sign and offset.

    Such a joint is a hinge of the model, and a second panel of its angle would show nothing new. Return None if no
    angle has these curves.
    """
    for title, panel in panels.items():
        if panel.keys() == flexions.keys() and all(_differ_by_offset(flexions[s][0], panel[s][0]) for s in panel):
            return title
    return None


def _differ_by_offset(first: Array, second: Array) -> bool:
    """Return whether two curves (T,) in degrees, or one and the negative of the other, differ by a constant."""
    known = np.isfinite(first) & np.isfinite(second)
    return bool(known.any()) and any(np.ptp((first + sign * second)[known]) < HINGE_DEG for sign in (-1, 1))


def _panel(
    title: str,
    unit: str,
    group: str,
    curves: Mapping[Any, tuple[Array, Array, bool]],
    least: float | None = None,
) -> dict[str, Any]:
    """Return one panel of curves, where `measured` is False for an angle that comes mostly from the prior.

    `least` is the lower limit of the panel's vertical axis, if it has one.
    """
    return {
        "title": title,
        "unit": unit,
        "group": group,
        "least": least,
        "curves": [
            {
                "side": side or "middle",
                "values": packed(values),
                "band": packed(interval_of(np.zeros_like(sigma), sigma)[2]) if np.isfinite(sigma).any() else None,
                "measured": bool(measured),
            }
            for side, (values, sigma, measured) in curves.items()
        ],
    }


def _at(time_s: Array, sample_s: Array, values: Array) -> Array:
    """Return a curve (N,) at the sample nearest to the time of each frame, shape (T,); NaN if no sample is near."""
    if not len(sample_s):
        return np.full(len(time_s), np.nan)
    step_s = float(np.median(np.diff(sample_s))) if len(sample_s) > 1 else np.inf
    nearest = np.clip(np.searchsorted(sample_s, time_s - step_s / 2), 0, len(sample_s) - 1)
    near = np.abs(sample_s[nearest] - time_s) <= step_s
    return np.where(near, values[nearest], np.nan)


def _stances(motion: Motion, analysis: ClipAnalysis) -> list[dict[str, Any]]:
    """Return the start and end of each foot's stances as fractional rows, and whether the clip cuts them."""
    assert analysis.gait is not None
    return [
        {"foot": stance.foot, "rows": [round(stance.start_row, 3), round(stance.end_row, 3)]}
        | {"begins": stance.begins, "ends": stance.ends}
        for stance in analysis.gait.stances
    ]
