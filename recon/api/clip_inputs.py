"""Read and check all inputs of a fit: keypoint files, cameras, the animal, and its expected motion."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from recon.animal.body import MAX_ANIMAL_M, ROUGH_SIZE_SIGMA, Body, Side
from recon.animal.naming import load_names, problem_of_names, renamed
from recon.animal.prior import MotionPrior, load_prior
from recon.animal.skeleton_file import load_skeleton, with_detector_offsets
from recon.api.clip_cameras import Cameras, ClipCamera, read_clip_cameras
from recon.api.inside_picture import require_inside
from recon.api.settings import UNITS_M, FitSettings, Unit
from recon.base.arrays import mean_along
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.numbers import rough_length
from recon.clip import (
    Keypoints,
    Source,
    View,
    align_cameras,
    clean,
    densest_window,
    fill_from_nearest,
    leave_out,
    parse_frame_range,
    views_of,
)
from recon.fit.result import Finding
from recon.io.corrections import read_corrections, with_corrections
from recon.io.formats import read_keypoints

RATES_HZ = (1.0, 10_000.0)
"""Frame rates that a clip can have, Hz.

At a lower rate a whole stride fits between two frames, and nothing connects them. At a higher rate, rounding hides the
animal's acceleration between frames.
"""
FEW_OF_SKELETON = 0.25
"""Fraction of the skeleton's keypoints in a file, at or above which the file is accepted for the skeleton."""
FEW_OF_FILE = 0.5
"""Fraction of a file's keypoints in the skeleton, at or above which the file is accepted for the skeleton.

A file is refused only if it is below `FEW_OF_SKELETON` too, because a file may have many further points, or only a few
points of a large skeleton.
"""
KNOWN_FOR_UNIT = 0.5
"""Minimum fraction of markers that two cameras have to see for a frame to count in the check of the unit."""
FRAMES_FOR_UNIT = 480
"""Maximum number of frames that are used to check the calibration's unit."""
LOG_SIZE_OF_UNIT = math.log(2.0)
"""Maximum |log(size / expected size)| of the triangulated animal for a plausible unit of the calibration."""
MIN_BETWEEN_UNITS = 50.0
"""Smallest ratio of two units that the animal's size can distinguish.

An animal may be a tenth as large as its skeleton, so centimetres and millimetres are not distinguished.
"""
HEIGHT_SIGMA = 0.05
"""Relative standard deviation of a size computed from the height at the withers, within a species.

The proportions of animals of one species differ.
"""
HEIGHT_SIGMA_OF_NO_SPECIES = 0.15
"""Relative standard deviation of a size computed from the height with a skeleton of no particular species.

Proportions differ more between species than within one. The value is a rough allowance.
"""
_FAR_OUTSIDE = "too far outside the picture to have been found in it"


SharedInputs = tuple[Body, MotionPrior, Cameras]
"""Inputs that are the same for all clips of one animal and the same cameras."""


@dataclass(frozen=True)
class ClipInputs:
    """All inputs of a fit: the animal, its expected motion, and the keypoints of each camera."""

    body: Body
    prior: MotionPrior
    sources_apart: tuple[Source, ...]
    """Each camera's keypoints on the camera's own frames."""
    later_frames: tuple[float, ...]
    """Number of frames by which each camera began later than the first."""
    fps: float
    side: Side | None
    """Side whose limbs are fitted; None for a whole animal."""
    side_reason: str
    findings: tuple[Finding, ...] = ()
    """Findings on the cameras, made before the fit."""

    @cached_property
    def sources(self) -> tuple[Source, ...]:
        """Return the keypoints of all cameras on the frames of the clip."""
        return align_cameras(self.sources_apart, self.later_frames)


def prepare(settings: FitSettings, read_shared: Callable[[FitSettings], SharedInputs] | None = None) -> ClipInputs:
    """Read and check everything that a fit needs before it solves.

    Parameters
    ----------
    settings
        Settings of the fit.
    read_shared
        Function that reads the inputs that clips can share, such as a function with a cache in a batch. (default:
        `read_model_and_cameras`)

    Raises
    ------
    InputError
        If files or settings cannot be used. The message lists all problems.
    """
    shared = read_shared or read_model_and_cameras
    files, (body, prior, cameras) = collect_problems(lambda: read_clips(settings), lambda: shared(settings))
    if settings.corrections is not None:
        corrections = read_corrections(settings.corrections)
        names, sizes_px = zip(*((camera.name, camera.image_size_px) for camera, _ in cameras), strict=True)
        files = with_corrections(files, names, corrections, settings.corrections, sizes_px)
    later = settings.offset_s or (0.0,) * len(files)
    fps = files[0].fps
    assert fps is not None
    later_frames = tuple((s - later[0]) * fps for s in later)
    scorers = {file.source or f"camera {i}": file.scorer for i, file in enumerate(files, start=1)}
    body_with_offsets, *cleaned = collect_problems(
        lambda: body if body.detector is not None else with_detector_offsets(body, None, scorers),
        *(
            partial(_cleaned, body, settings, fps, *file_inputs)
            for file_inputs in zip(files, cameras, later_frames, strict=True)
        ),
    )
    side, reason = None, "both sides are fitted"
    if body.one_sided:
        side, reason = _chosen_side(body, cleaned[0].keypoints, settings)
    names = body.keypoint_names(side)
    sources = tuple(replace(source, keypoints=arrange(source.keypoints, names)) for source in cleaned)
    inputs = ClipInputs(body_with_offsets, prior, sources, later_frames, fps, side, reason)
    cameras = [source.camera for source in sources]
    _require_unit(inputs, settings)
    up_is_unknown = all(camera.has_extrinsics and not camera.world_z_up and not camera.tilt_rad for camera in cameras)
    if len(cameras) == 1 or not up_is_unknown or settings.up is not None:
        return inputs
    from recon.api.rigs import sources_with_z_up

    turned, findings = sources_with_z_up(
        inputs.sources, sources, body_with_offsets, fps, settings.trajectory_options().sigma_px
    )
    return replace(inputs, sources_apart=turned, findings=findings)


def _require_unit(inputs: ClipInputs, settings: FitSettings) -> None:
    """Raise InputError if the triangulated animal's size shows that the calibration's unit is not `camera_unit`.

    A fit cannot find the unit, because it keeps the animal's size and moves the animal to one of the cameras.
    """
    views = views_of(inputs.sources)
    if len(views) < 2 or not all(view.camera.has_extrinsics for view in views):
        return
    from recon.check.sights import triangulated_m  # fits of one camera do not import it

    shows_unit = np.mean(np.sum([view.present for view in views], axis=0) > 1, axis=1) >= KNOWN_FOR_UNIT
    rows = densest_window(shows_unit, FRAMES_FOR_UNIT)
    points_m = triangulated_m([view.part(rows) for view in views], settings.trajectory_options().sigma_px, 0.0)
    expected_m = inputs.body.tree.pose(np.zeros((1, inputs.body.n_state))).points_m[0]
    known = np.asarray(np.isfinite(points_m).all(axis=2))
    times = [
        _spread(row[seen]) / _spread(expected_m[seen])
        for row, seen in zip(points_m, known, strict=True)
        if seen.mean() >= KNOWN_FOR_UNIT
    ]
    if not any(times):
        return
    size, given_m = float(np.median([ratio for ratio in times if ratio > 0])), UNITS_M[settings.camera_unit]
    for unit, metres in UNITS_M.items():
        is_far = abs(math.log(metres / given_m)) > math.log(MIN_BETWEEN_UNITS)
        if is_far and abs(math.log(size * metres / given_m)) < LOG_SIZE_OF_UNIT:
            times_text = f"{size:.0f}" if size > 1 else f"{size:.1g}"
            actual = f"{settings.camera_unit}, in which the animal is {times_text} times as large as expected"
            raise InputError(
                Problem("--camera-unit", "camera_unit", actual, f"the calibration's unit, probably {unit}")
            )


def require_size_of_animal(points_m: np.ndarray, camera_unit: Unit) -> None:
    """Raise InputError if triangulated points show that the calibration's unit is not `camera_unit`.

    The check needs no skeleton.

    Parameters
    ----------
    points_m
        Positions (T, K, 3) of keypoints in the given unit of the calibration, converted to metres; NaN if missing.
    camera_unit
        Unit that was assumed.
    """
    known = np.isfinite(points_m[..., 0])
    size_m = length_of_animal_m(points_m[densest_window(known.mean(axis=1) >= KNOWN_FOR_UNIT, FRAMES_FOR_UNIT)])
    if size_m <= MAX_ANIMAL_M:
        return
    smaller = {unit: size_m * UNITS_M[unit] / UNITS_M[camera_unit] for unit in ("cm", "mm")}
    plausible = {unit: length_m for unit, length_m in smaller.items() if length_m <= MAX_ANIMAL_M}
    units = " or ".join(f"{unit} ({rough_length(length_m)})" for unit, length_m in (plausible or smaller).items())
    actual = f"{camera_unit}, in which the animal is {rough_length(size_m)} long"
    raise InputError(Problem("--camera-unit", "camera_unit", actual, f"the calibration's unit, probably {units}"))


def length_of_animal_m(points_m: np.ndarray) -> float:
    """Return the largest median distance between two of K points (T, K, 3), in metres, or 0 without two points.

    The median is taken over the frames for each pair of points, so that outliers in a few frames do not change it. The
    largest distance of each frame would often be the distance to an outlier.
    """
    largest_m = 0.0
    with warnings.catch_warnings(action="ignore"):  # some pairs are never seen together
        for k in range(points_m.shape[1] - 1):
            medians_m = np.nanmedian(np.linalg.norm(points_m[:, k + 1 :] - points_m[:, [k]], axis=2), axis=0)
            largest_m = max(largest_m, float(np.nanmax(medians_m, initial=0.0)))
    return largest_m


def _spread(points_m: np.ndarray) -> float:
    """Return the median distance of points (J, 3) from their median, which a few outliers do not change."""
    return float(np.median(np.linalg.norm(points_m - np.median(points_m, axis=0), axis=1)))


def read_model_and_cameras(settings: FitSettings) -> SharedInputs:
    """Return the body, the motion prior and the cameras of a fit.

    Raises
    ------
    InputError
        If any of the three cannot be used. The message lists the problems of all.
    """
    model, cameras = collect_problems(lambda: read_model(settings), lambda: read_clip_cameras(settings))
    return *model, cameras


def arrange(keypoints: Keypoints, names: tuple[str, ...]) -> Keypoints:
    """Return the keypoints `names` in this order.

    A name that `keypoints` does not contain becomes a keypoint that is missing in all frames.
    """
    T = len(keypoints.frames)
    xy, confidence = np.full((T, len(names), 2), np.nan), np.zeros((T, len(names)))
    for column, name in enumerate(names):
        if name in keypoints.names:
            xy[:, column] = keypoints.xy_px[:, keypoints.names.index(name)]
            confidence[:, column] = keypoints.confidence[:, keypoints.names.index(name)]
    return replace(keypoints, names=names, xy_px=xy, confidence=confidence)


def read_clips(settings: FitSettings) -> list[Keypoints]:
    """Return the keypoints of all files, each with the given frame rate or the one stated in the file.

    Raises
    ------
    InputError
        If files cannot be used, or if frame rates are missing or differ. The message lists the problems of all files.
    """
    rates = settings.camera_fps or (settings.fps,) * len(settings.keypoints)
    files = collect_problems(
        *(
            partial(_read_clip, settings, *path_and_rate)
            for path_and_rate in zip(settings.keypoints, rates, strict=True)
        )
    )
    without_rate = [path.name for path, file in zip(settings.keypoints, files, strict=True) if file.fps is None]
    if without_rate:
        actual = f"nothing ({', '.join(without_rate)} {'does' if len(without_rate) == 1 else 'do'} not state it)"
        raise InputError(Problem("--fps", "fps", actual, "frames per second above 0, such as 120"))
    if len({file.fps for file in files}) > 1 and settings.camera_fps is None:
        actual = ", ".join(f"{path.name} {file.fps:g}" for path, file in zip(settings.keypoints, files, strict=True))
        expected = "one frame rate for all cameras of a clip, --fps, or --set camera-fps for each"
        raise InputError(Problem("KEYPOINTS", "fps", actual, expected))
    return list(files)


def _read_clip(settings: FitSettings, path: Path, given_fps: float | None) -> Keypoints:
    file = read_keypoints(path, settings.individual, given_fps)
    if settings.rename is not None:
        file = renamed(file, load_names(settings.rename))
    fps = file.fps if given_fps is None else given_fps
    if fps is not None and not RATES_HZ[0] <= fps <= RATES_HZ[1]:
        origin = path if given_fps is None else "--fps" if settings.camera_fps is None else "--set camera-fps"
        raise InputError(Problem(origin, "fps", f"{fps:g}", f"{RATES_HZ[0]:g} to {RATES_HZ[1]:g} frames per second"))
    return replace(file, fps=fps, stated_fps=file.fps if file.fps != fps else None)


def read_model(settings: FitSettings) -> tuple[Body, MotionPrior]:
    """Return the body and the prior, which do not depend on the keypoint files."""
    if settings.method == "frame":
        from recon.thesis.clip import load_body

        body = load_body(settings)
        return body, load_prior(None, body)
    body = with_detector_offsets(load_skeleton(settings.skeleton_name, settings.subject), settings.detector)
    body = body if settings.size is None else body.scaled(settings.size)
    body = body if settings.height_m is None else _scaled_to_height(body, settings.height_m)
    expected = f"nothing: {body.name} is a whole animal, and both sides are fitted"
    side_problems = [Problem("--set side", "side", repr(settings.side), expected)] if settings.side != "auto" else []
    prior, _ = collect_problems(
        lambda: load_prior(settings.prior, body), lambda: raise_problems(side_problems if not body.one_sided else ())
    )
    return body, prior


def _scaled_to_height(body: Body, height_m: float) -> Body:
    """Scale a body so that its withers have the given height above the feet in the expected pose."""
    if not body.feet:
        raise InputError(
            Problem(
                "--height-m",
                "height_m",
                f"the skeleton {body.name}, which has no feet",
                "the size by --set size instead",
            )
        )
    heights_m = dict(zip(body.markers, body.expected_points_m()[:, 2], strict=True))
    withers = next((name for name in body.markers if "wither" in name.lower()), body.forward[1])
    usual_m = heights_m[withers] - min(heights_m[foot] for foot in body.feet)
    sigma = HEIGHT_SIGMA_OF_NO_SPECIES if body.size_sigma > ROUGH_SIZE_SIGMA else HEIGHT_SIGMA
    return replace(body.scaled(height_m / usual_m), size_sigma=sigma)


def _cleaned(
    body: Body, settings: FitSettings, fps: float, file: Keypoints, clip_camera: ClipCamera, later_frames: float
) -> Source:
    """Return the source of a file (`cleaned_source`), or raise InputError if it has too few keypoints of the body."""
    _, source = collect_problems(
        lambda: _require_keypoints_of(body, file),
        lambda: cleaned_source(settings, fps, file, clip_camera, later_frames),
    )
    return source


def cleaned_source(
    settings: FitSettings, fps: float, file: Keypoints, clip_camera: ClipCamera, later_frames: float
) -> Source:
    """Return all keypoints of a file at the clip's frame rate.

    `later_frames` is the delay of the file's frame 0 relative to the clip's, in frames of the clip. Keypoints far
    outside the picture and those in frames without a camera pose are left out.

    Raises
    ------
    InputError
        If most keypoints lie outside the picture.
    """
    camera, track = clip_camera
    first, stop = parse_frame_range(settings.frames) if settings.frames else (None, None)
    assert file.fps is not None
    shift, per_frame = math.floor(later_frames), file.fps / fps  # a clip's frames are the first camera's

    def file_frame(frame: int | None) -> int | None:
        return None if frame is None else math.ceil((frame - shift) * per_frame)

    keypoints, cleaning = clean(file, settings.likelihood_min, (file_frame(first), file_frame(stop)))
    require_inside(camera, keypoints, settings)
    if file.fps != fps:
        if track is not None:
            expected = f"the first camera's frame rate, {fps:g}, since the camera moves"
            raise InputError(Problem(track.source, "fps", f"{file.fps:g}", expected))
        from recon.api.rigs import at_rate

        keypoints = at_rate(keypoints, fps)
        note = f"{camera.name} filmed at {file.fps:g} Hz: its keypoints are interpolated in time to {fps:g} Hz"
        cleaning = replace(cleaning, notes=(*cleaning.notes, note))
    poses = None
    if track is not None:
        from recon.api.rigs import with_poses

        keypoints, cleaning, poses = with_poses(keypoints, cleaning, track, fps)
    lenses = None if poses is None else poses.map_arrays(fill_from_nearest).intrinsics_px
    view = View(camera, np.eye(4), keypoints.xy_px, keypoints.confidence, lenses)
    keypoints, cleaning = leave_out(keypoints, cleaning, keypoints.present & ~view.seen, _FAR_OUTSIDE)
    return Source(camera, keypoints, cleaning, file.names, 0.0, poses)


def _require_keypoints_of(body: Body, keypoints: Keypoints) -> None:
    """Raise InputError for a file with too few of the body's keypoints.

    A few keypoints that many animals share, such as nose, are not enough.
    """
    wanted = tuple(dict.fromkeys(name for pair in body.keypoints for name in pair))
    known = [name for name in keypoints.names if name in wanted]
    if known and (len(known) >= FEW_OF_SKELETON * len(wanted) or len(known) >= FEW_OF_FILE * len(keypoints.names)):
        return
    raise InputError(problem_of_names(keypoints.names, wanted, body.name, keypoints.source or "keypoints"))


def _chosen_side(body: Body, keypoints: Keypoints, settings: FitSettings) -> tuple[Side, str]:
    """Return the given side, or the side facing the camera unless the file has many more points of the other side."""
    from recon.animal.chain import facing_side  # imported here because few clips use a chain

    ends = []
    for marker in body.forward:
        names = body.keypoints[body.markers.index(marker)]
        ends.append(mean_along(arrange(keypoints, tuple(dict.fromkeys(names))).xy_px, 1))
    facing, reason = facing_side(*ends)
    if settings.side != "auto":
        return settings.side, f"as given; {reason}"
    opposite: Side = "left" if facing == "right" else "right"
    facing_count, far_count = (
        int(arrange(keypoints, body.keypoint_names(s)).present.sum()) for s in (facing, opposite)
    )
    if facing_count < far_count / 2:
        return opposite, f"{reason}, but that side has {facing_count} points and the other {far_count}"
    return facing, reason
