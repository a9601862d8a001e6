"""Read camera tracks, the poses of a moving camera, from CSV, COLMAP's text files, or OpenDroneMap.

- CSV: columns frame, qw, qx, qy, qz, tx, ty, tz; fx, fy, cx, cy for a camera that zooms; and sigma_deg for the standard
  deviation of a rotation, in any order. Other columns are ignored. Unit quaternion and translation take points from the
  world to the camera, X_camera = R X_world + t. The camera's position may be in x, y, z instead of tx, ty, tz: then the
  quaternion takes points from the camera to the world, X_world = R X_camera + (x, y, z).
- COLMAP: images.txt with cameras.txt in the same folder, or the folder itself. Frame numbers are the last digits of the
  images' names. (0, 0) is the corner of the first pixel in COLMAP and its centre in recon, so half a pixel is
  subtracted.
- OpenDroneMap, OpenSfM: reconstruction.json (`shots`), or shots.geojson with the cameras' positions in UTM. Frame
  numbers are the last digits of the pictures' names.

The world has to be in metres with z up, which no format guarantees.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import compress
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Bools, Integers
from recon.base.documents import parse_json, read_text, require_file
from recon.base.errors import InputError, Problem, raise_problems
from recon.clip import FramePoses
from recon.geometry.camera import Camera
from recon.geometry.frames import inverse, rigid
from recon.io.calibration import cameras_of
from recon.io.camera_files import read_colmap
from recon.io.common import MAX_FRAME, first_problems, frame_number, number_rows, numbers, text_rows

POSE, INTRINSICS = ("qw", "qx", "qy", "qz", "tx", "ty", "tz"), ("fx", "fy", "cx", "cy")
SIGMA = "sigma_deg"
Columns = dict[str, Array]
"""Columns (N,) of a table of N poses, keyed by their names: frame, `POSE`, and `INTRINSICS` or `SIGMA` if known."""
UNIT_TOLERANCE = 1e-2
"""Largest difference between a quaternion's length and 1, wide enough for quaternions written with three digits."""
MAX_METRES = 1e7
"""Largest accepted coordinate of a camera's position, in metres."""
MAX_PX = 1e6
"""Largest accepted focal length and coordinate of a principal point, in pixels."""
MAX_SIGMA_DEG = 10.0
"""Largest accepted standard deviation of an orientation, in degrees."""
MAX_ROTATION_RAD = 100.0
"""Largest accepted component of a rotation vector, in radians."""
LEANING_MAX_RAD = np.radians(60)
"""Largest angle, in radians, between a picture's upward direction and z at which the picture counts as upright.

A track is refused if its camera leans in most frames without looking down, since z then does not point up in the
track's world.
"""
LOOKING_DOWN_RAD = np.radians(45)
"""Smallest angle of the optical axis below the horizon, in radians, at which a camera counts as looking down.

A drone's camera looks down, and any edge of its picture may be the upper one.
"""
POSITION_COLUMNS = ("x", "y", "z")
"""Columns that replace tx, ty, tz if poses are given from the camera to the world."""
IMAGES, CAMERAS = "images.txt", "cameras.txt"
SHOTS = (".json", ".geojson")
EXPECTED = (
    f"a table (.csv) with the columns frame, {', '.join(POSE)}, a COLMAP model as text ({IMAGES}), or OpenDroneMap's "
    "reconstruction.json or shots.geojson"
)
MAX_SHOTS_BYTES = 1 << 28
"""Largest size, in bytes, of a reconstruction file, which also holds the model's points."""


@dataclass(frozen=True, eq=False, kw_only=True)
class CameraTrack(FramePoses):
    """Poses of one camera in N frames of its video, in a world frame with z up, in metres."""

    max_gap_s: ClassVar[float] = 0.1
    """Longest gap between two poses that is interpolated, in seconds."""

    source: Path
    frames: Integers
    """Increasing frame numbers, shape (N,)."""
    camera: Camera | None = None
    """Camera with its lens but without a pose; None if the track's file has no lens."""

    def at(self, frames: Integers, fps: float) -> tuple[FramePoses, Bools]:
        """Return the poses in T increasing frames, and a mask (T,) of the interpolated poses.

        Gaps of at most `max_gap_s` between poses are interpolated at constant velocity and constant rotation rate.
        Poses in longer gaps are NaN.
        """
        following = np.clip(np.searchsorted(self.frames, frames), 0, len(self.frames) - 1)
        previous = np.maximum(following - (self.frames[following] > frames), 0)
        gap = self.frames[following] - self.frames[previous]
        exact = self.frames[following] == frames
        inside = (self.frames[previous] < frames) & (frames < self.frames[following])
        filled = inside & (gap <= self.max_gap_s * fps + 1e-9)
        fraction = np.where(filled, (frames - self.frames[previous]) / np.maximum(gap, 1), 1.0)
        known = exact | filled
        poses = _between(self.T_camera_world[previous], self.T_camera_world[following], fraction)
        poses[~known] = np.nan
        intrinsics = None
        if self.intrinsics_px is not None:
            a, b = self.intrinsics_px[previous], self.intrinsics_px[following]
            intrinsics = np.where(known[:, None], a + fraction[:, None] * (b - a), np.nan)
        sigma = self.rotation_sigma_rad
        sigmas = None if sigma is None else np.maximum(sigma[previous], sigma[following])
        return FramePoses(poses, intrinsics, sigmas), filled


def _between(a: Array, b: Array, share: Array) -> Array:
    """Interpolate between poses a and b (T, 4, 4) at fractions (T,), at constant rotation rate and velocity."""
    turn = b[:, :3, :3] @ a[:, :3, :3].swapaxes(1, 2)
    rotation = Rotation.from_rotvec(share[:, None] * Rotation.from_matrix(turn).as_rotvec()).as_matrix() @ a[:, :3, :3]
    start, end = inverse(a)[:, :3, 3], inverse(b)[:, :3, 3]
    centre = start + share[:, None] * (end - start)
    return rigid(rotation, -(rotation @ centre[..., None])[..., 0])


def track_files(path: Path) -> tuple[Path, ...]:
    """Return the files of a camera track, which are two for a COLMAP model with a lens."""
    images = path / IMAGES if path.is_dir() else path
    if images.suffix.lower() in (".csv", *SHOTS):
        return (images,)
    cameras = images.with_name(CAMERAS)
    return (images, cameras) if cameras.is_file() else (images,)


def track_label(path: Path) -> str:
    """Return a camera track's name, which is its file's name without suffix, or a COLMAP model's folder name."""
    if path.suffix.lower() in (".csv", *SHOTS):
        return path.stem
    return path.parent.name if path.name == IMAGES else path.name


def read_camera_track(path: Path) -> CameraTrack:
    """Return the camera track in a file of any known format.

    Raises
    ------
    InputError
        If the file is invalid, or if z does not point up in the track's world. The message lists every problem.
    """
    first, *further = track_files(path)
    if first.suffix.lower() == ".csv":
        track = _read_csv(path)
    elif first.suffix.lower() in SHOTS:
        track = _read_shots(path)
    elif first.suffix.lower() == ".txt":
        track = _read_colmap(first, further[0] if further else None)
    else:
        raise InputError(Problem(path, "format", f"suffix {path.suffix!r}", EXPECTED))
    # z components of the picture's upward direction and of the viewing direction
    upward, downward = -track.T_camera_world[:, 1:3, 2].T
    leans = (upward < np.cos(LEANING_MAX_RAD)) & (downward < np.sin(LOOKING_DOWN_RAD))
    if leans.mean() > 0.5:
        detail = f"pictures that are not upright in {leans.sum()} of {len(leans)} frames, if the world's z points up"
        expected = "a world with z up, and poses from the world to the camera: turn the model so that z points up"
        raise InputError(Problem(path, "poses", detail, expected))
    return track


def _checked_track(
    path: Path, locations: Sequence[str], columns: Columns, problems: Sequence[Problem], camera: Camera | None = None
) -> CameraTrack:
    """Return the camera track in the columns of a table, after checking every row.

    `locations` (N,) state where each row is in the file, for messages.

    Raises
    ------
    InputError
        If `problems` are given, or if a row is invalid.
    """
    raise_problems(first_problems(problems, path))
    if not len(locations):
        raise InputError(Problem(path, "rows", "no rows", "a pose for each frame"))
    frames, sigma = columns["frame"], columns.get(SIGMA, np.zeros(len(locations)))
    quaternion, translation = _joined(columns, POSE[:4]), _joined(columns, POSE[4:])
    zoom = _joined(columns, INTRINSICS) if INTRINSICS[0] in columns else np.ones((len(locations), 4))
    _, row_of, count = np.unique(frames, return_inverse=True, return_counts=True)
    with np.errstate(all="ignore"):
        lengths, lens_text = (
            np.linalg.norm(quaternion, axis=1),
            f"values of at most {MAX_PX:g} px, with fx and fy above 0",
        )
        checks = (
            (
                "frame",
                "no such number",
                f"a whole number up to {MAX_FRAME}",
                (np.abs(frames) <= MAX_FRAME) & (frames % 1 == 0),
            ),
            ("frame", "a frame with several poses", "one pose for each frame, of one camera", count[row_of] == 1),
            (
                "numbers",
                "missing or infinite numbers",
                "finite numbers",
                np.isfinite(np.hstack([quaternion, translation, zoom])).all(axis=1),
            ),
            (
                "qw, qx, qy, qz",
                "a length other than 1",
                f"unit quaternions (length 1 ± {UNIT_TOLERANCE:g})",
                ~(np.abs(lengths - 1) > UNIT_TOLERANCE),
            ),
            (
                "tx, ty, tz",
                "a translation that is too long",
                f"metres, at most {MAX_METRES:g} m",
                ~(np.abs(translation) > MAX_METRES).any(axis=1),
            ),
            (
                "fx, fy, cx, cy",
                "a value out of range",
                lens_text,
                ~((zoom[:, :2] <= 0).any(axis=1) | (np.abs(zoom) > MAX_PX).any(axis=1)),
            ),
            (SIGMA, "a value out of range", f"0 to {MAX_SIGMA_DEG:g} degrees", (sigma >= 0) & (sigma <= MAX_SIGMA_DEG)),
        )
    raise_problems(
        Problem(path, field, f"{fault} in {_some(rows)}", expected)
        for field, fault, expected, right in checks
        if (rows := [*compress(locations, np.logical_not(right))])
    )
    order = np.argsort(frames)
    poses = rigid(_rotations(quaternion[order]), translation[order])
    zooms = zoom[order] if INTRINSICS[0] in columns else None
    sigmas = np.radians(sigma[order]) if SIGMA in columns else None
    return CameraTrack(poses, zooms, sigmas, source=path, frames=frames[order].astype(np.int64), camera=camera)


def _joined(columns: Columns, names: Sequence[str]) -> Array:
    return np.column_stack([columns[name] for name in names])


def _rotations(quaternion: Array) -> Array:
    """Return rotations (N, 3, 3) of quaternions (N, 4), w first and nearly of length 1."""
    unit = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    return Rotation.from_quat(unit[:, [1, 2, 3, 0]]).as_matrix()


def _some(items: Sequence[object]) -> str:
    rest = f" and {len(items) - 3} more" if len(items) > 3 else ""
    return ", ".join(map(str, items[:3])) + rest


def _read_csv(path: Path) -> CameraTrack:
    require_file(path, EXPECTED)
    rows = text_rows(path)
    header = [cell.strip().lower() for cell in next(rows, (1, []))[1]]
    outward = {*POSITION_COLUMNS} <= {*header} and not {"tx", "ty", "tz"} & {*header}
    zooms = any(name in header for name in INTRINSICS)
    wanted = ["frame", *POSE[:4], *(POSITION_COLUMNS if outward else POSE[4:]), *(INTRINSICS if zooms else ())]
    wanted += [SIGMA] * (SIGMA in header)
    wrong = [f"{name} more than once" if name in header else f"no {name}" for name in wanted if header.count(name) != 1]
    raise_problems(Problem(path, "columns", detail, EXPECTED) for detail in wrong)
    indices = [header.index(name) for name in wanted]
    locations: list[str] = []

    def chosen() -> Iterator[tuple[int, list[str]]]:
        for line, row in rows:
            yield line, [row[column] for column in indices if column < len(row)]
            locations.append(f"line {line}")

    _, values, problems = number_rows(path, chosen(), wanted)  # row by row, because a long track has many rows
    columns = dict(zip(wanted, values.T, strict=True))
    if outward:
        quaternion, position = _joined(columns, POSE[:4]) * [1, -1, -1, -1], _joined(columns, POSITION_COLUMNS)
        largest = np.abs(quaternion).max(axis=1, initial=0)
        # other rows raise an error below
        usable = np.isfinite(values[:, 1:8]).all(axis=1) & (largest > 0.1) & (largest < 10)
        position[usable] = -(_rotations(quaternion[usable]) @ position[usable, :, None])[..., 0]
        columns |= dict(zip(POSE, np.hstack([quaternion, position]).T, strict=True))
    return _checked_track(path, locations, columns, problems)


def _read_shots(path: Path) -> CameraTrack:
    """Return the poses of one video in an OpenDroneMap or OpenSfM file, without the lens.

    Raises
    ------
    InputError
        If the file is invalid.
    """
    document = parse_json(read_text(path, EXPECTED, MAX_SHOTS_BYTES), path)
    whole = document[0] if isinstance(document, list) and len(document) == 1 else document
    features = whole.get("features") if isinstance(whole, dict) else None
    shots = whole.get("shots") if isinstance(whole, dict) else None
    if isinstance(features, list):
        properties = [feature.get("properties") for feature in features if isinstance(feature, dict)]
        shots = {str(feature.get("filename")): feature for feature in properties if isinstance(feature, dict)}
    if not isinstance(shots, dict) or not shots:
        several = f"{len(document)} reconstructions" if isinstance(document, list) else "no shots"
        raise InputError(Problem(path, "shots", several, EXPECTED))
    rows: dict[str, list[float]] = {}
    problems: list[Problem] = []
    for name, shot in shots.items():
        frame, turn, translation = _frame_of_name(name), *np.full((2, 3), np.nan)
        with suppress(KeyError, TypeError, ValueError, OverflowError):
            turn, translation = (np.array(shot[key], dtype=float).reshape(3) for key in ("rotation", "translation"))
        if frame is None or not np.isfinite([turn, translation]).all() or np.abs(turn).max() > MAX_ROTATION_RAD:
            expected = "a rotation and a translation of 3 numbers each, and the frame's number last in the name"
            problems.append(Problem(path, f"shots.{name[:60]}", "no complete pose, or no frame number", expected))
            continue
        rotation = Rotation.from_rotvec(turn)
        if features is not None:  # the columns are positions, not translations
            translation = -rotation.apply(translation)
        x, y, z, w = rotation.as_quat().tolist()
        rows[f"shots.{name}"] = [frame, w, x, y, z, *translation]
    return _checked_track(path, [*rows], _columns(rows), problems)


def _read_colmap(images: Path, cameras: Path | None) -> CameraTrack:
    """Return the poses of COLMAP's images.txt, with the lens of cameras.txt if given.

    Every image has two lines, the second for its points.

    Raises
    ------
    InputError
        If a file is invalid.
    """
    lines = enumerate(read_text(images, EXPECTED).splitlines(), start=1)
    rows: dict[str, list[float]] = {}
    of_camera: list[str] = []
    problems: list[Problem] = []
    for number, line in lines:
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        cells = line.split(maxsplit=9)
        values, wrong = numbers(cells[1:8])
        frame = _frame_of_name(cells[9]) if len(cells) == 10 else None
        if len(values) < 7 or wrong or frame is None:
            expected = "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, with the frame's number last in the name"
            problems.append(Problem(images, f"line {number}", repr(line.strip()[:60]), expected))
        else:
            of_camera.append(cells[8])
            rows[f"line {number}"] = [frame, *values]
        number, points = next(lines, (0, ""))
        if len(points.split()) % 3:
            expected = "the points of the image above, X Y POINT3D_ID each, or an empty line"
            problems.append(Problem(images, f"line {number}", repr(points.strip()[:60]), expected))
    lenses = {} if cameras is None else _lenses(cameras, dict.fromkeys(of_camera))
    columns, camera = _columns(rows), None
    if lenses:
        intrinsics = np.array([lenses[key].matrix[[0, 1, 0, 1], [0, 1, 2, 2]] for key in of_camera])
        columns |= dict(zip(INTRINSICS, intrinsics.T, strict=True)) if np.ptp(intrinsics, axis=0).any() else {}
        camera = replace(lenses[of_camera[0]], name=track_label(images))
    return _checked_track(images, [*rows], columns, problems, camera)


def _columns(rows: Mapping[str, Sequence[float]]) -> Columns:
    return dict(zip(("frame", *POSE), np.array([*rows.values()], dtype=float).reshape(-1, 8).T, strict=True))


def _frame_of_name(name: str) -> int | None:
    """Return the last number in a file name, such as 12 for run/frame_0012.png."""
    digits = re.findall(r"[0-9]+", re.sub(r"\.[A-Za-z0-9]*$", "", re.split(r"[/\\]", name.strip())[-1]))
    return frame_number(digits[-1]) if digits else None


def _lenses(path: Path, wanted: dict[str, None]) -> dict[str, Camera]:
    """Return the cameras with the COLMAP numbers `wanted` in a cameras.txt, by number.

    The cameras may differ only in focal length and centre.
    """
    records = [record for record in read_colmap(path) if record.name in wanted]
    lenses = {camera.name: camera for camera in cameras_of(records, path)}
    missing = [key for key in wanted if key not in lenses]
    if missing:
        raise InputError(Problem(path, "cameras", f"no camera {_some(missing)}", f"every camera that {IMAGES} uses"))
    if len({(c.model, c.image_size_px, *c.distortion.tolist()) for c in lenses.values()}) > 1:
        expected = "one lens, whose focal length and centre alone may change from image to image"
        raise InputError(
            Problem(path, "cameras", f"{len(lenses)} cameras with different lenses or picture sizes", expected)
        )
    return lenses
