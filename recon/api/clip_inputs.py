"""Read and check all that a fit works on: keypoint files, cameras, the animal, and what is expected of its motion."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from recon.animal.body import Body, Side
from recon.animal.chain import facing_side
from recon.animal.naming import load_names, problem_of_names, renamed
from recon.animal.prior import MotionPrior, load_prior
from recon.animal.skeleton_file import load_skeleton, with_detector_offsets
from recon.api.settings import FitSettings
from recon.base.arrays import mean_along
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.clip import (
    Keypoints,
    Source,
    View,
    align_cameras,
    clean,
    fill_from_nearest,
    leave_out,
    parse_frame_range,
)
from recon.fit.result import Finding
from recon.io.corrections import read_corrections, with_corrections
from recon.io.formats import read_keypoints

if TYPE_CHECKING:
    pass


from recon.api.clip_cameras import Cameras, ClipCamera, read_clip_cameras
from recon.api.inside_picture import require_inside

RATES_HZ = (1.0, 10_000.0)
"""Frame rates that a clip can have. Slower, a whole stride lies between two frames, and nothing ties them; faster, what
an animal does from one frame to the next is lost in the rounding of its acceleration."""
FEW_OF_SKELETON, FEW_OF_FILE = 0.25, 0.5
"""A file with fewer of the skeleton's keypoints, to which fewer of its own belong, has other names for them."""
HEIGHT_SIGMA = 0.05
"""Relative, of a size that follows from the height at the withers: animals differ in their proportions."""
_FAR_OUTSIDE = "too far outside the picture to have been found in it"


Unknown = tuple[Body, MotionPrior, Cameras]
"""What clips of one animal before the same cameras share."""


@dataclass(frozen=True)
class ClipInputs:
    """All that a fit works on: the animal, what is expected of its motion, and for each camera its keypoints on its own
    frames, which began so many frames later than the first's. side: whose limbs, None for a whole animal."""

    body: Body
    prior: MotionPrior
    apart: tuple[Source, ...]
    later_frames: tuple[float, ...]
    fps: float
    side: Side | None
    side_reason: str
    findings: tuple[Finding, ...] = ()
    """Findings on the cameras, before the fit."""

    @cached_property
    def sources(self) -> tuple[Source, ...]:
        """On the frames of the clip."""
        return align_cameras(self.apart, self.later_frames)


def prepare(settings: FitSettings, read_shared: Callable[[FitSettings], Unknown] | None = None) -> ClipInputs:
    """Everything that comes before solving: the one list of checks, of a fit and of who asks whether it can be done.
    read_shared: `read_model_and_cameras`, or one that remembers. Raises InputError as `fit_clip`."""
    shared = read_shared or read_model_and_cameras
    files, (body, prior, cameras) = collect_problems(lambda: read_clips(settings), lambda: shared(settings))
    if settings.corrections is not None:
        corrections = read_corrections(settings.corrections)
        files = with_corrections(files, [camera.name for camera, _ in cameras], corrections, settings.corrections)
    later = settings.offset_s or (0.0,) * len(files)
    fps = files[0].fps
    assert fps is not None
    later_frames = tuple((s - later[0]) * fps for s in later)
    scorers = {file.source or f"camera {i}": file.scorer for i, file in enumerate(files, start=1)}
    seen, *cleaned = collect_problems(
        lambda: body if body.detector is not None else with_detector_offsets(body, None, scorers),
        *(partial(_cleaned, body, settings, fps, *of) for of in zip(files, cameras, later_frames, strict=True)),
    )
    side, reason = None, "both sides are fitted"
    if body.one_sided:
        side, reason = _side(body, cleaned[0].keypoints, settings)
    names = body.keypoint_names(side)
    sources = tuple(replace(source, keypoints=arrange(source.keypoints, names)) for source in cleaned)
    given = ClipInputs(seen, prior, sources, later_frames, fps, side, reason)
    cameras = [source.camera for source in sources]
    unsaid = all(camera.has_extrinsics and not camera.world_z_up and not camera.tilt_rad for camera in cameras)
    if len(cameras) == 1 or not unsaid or settings.up is not None:
        return given
    from recon.api.rigs import turned_up_by_feet

    apart, found = turned_up_by_feet(given.sources, sources, seen, fps, settings.trajectory_options().sigma_px)
    return replace(given, apart=apart, findings=found)


def read_model_and_cameras(settings: FitSettings) -> Unknown:
    """Raises InputError with the problems of both."""
    model, cameras = collect_problems(lambda: _model(settings), lambda: read_clip_cameras(settings))
    return *model, cameras


def arrange(keypoints: Keypoints, names: tuple[str, ...]) -> Keypoints:
    """The named keypoints in that order, all missing where the file does not have them."""
    T = len(keypoints.frames)
    xy, confidence = np.full((T, len(names), 2), np.nan), np.zeros((T, len(names)))
    for column, name in enumerate(names):
        if name in keypoints.names:
            xy[:, column] = keypoints.xy_px[:, keypoints.names.index(name)]
            confidence[:, column] = keypoints.confidence[:, keypoints.names.index(name)]
    return replace(keypoints, names=names, xy_px=xy, confidence=confidence)


def read_clips(settings: FitSettings) -> list[Keypoints]:
    """The keypoint files, with the frame rate as given or their own. Raises InputError with the problems of all, also
    without a frame rate, or with two that nobody gave."""
    rates = settings.camera_fps or (settings.fps,) * len(settings.keypoints)
    files = collect_problems(
        *(partial(_read_clip, settings, *of) for of in zip(settings.keypoints, rates, strict=True))
    )
    silent = [path.name for path, file in zip(settings.keypoints, files, strict=True) if file.fps is None]
    if silent:
        found = f"nothing, and {', '.join(silent)} {'does' if len(silent) == 1 else 'do'} not say"
        raise InputError(Problem("--fps", "fps", found, "frames per second above 0, as in 120"))
    if len({file.fps for file in files}) > 1 and settings.camera_fps is None:
        found = ", ".join(f"{path.name} {file.fps:g}" for path, file in zip(settings.keypoints, files, strict=True))
        expected = "one frame rate for all cameras of a clip, --fps, or --set camera-fps for each"
        raise InputError(Problem("KEYPOINTS", "fps", found, expected))
    return list(files)


def _read_clip(settings: FitSettings, path: Path, given_fps: float | None) -> Keypoints:
    file = read_keypoints(path, settings.individual, given_fps)
    if settings.rename is not None:
        file = renamed(file, load_names(settings.rename))
    fps = file.fps if given_fps is None else given_fps
    if fps is not None and not RATES_HZ[0] <= fps <= RATES_HZ[1]:
        where = path if given_fps is None else "--fps" if settings.camera_fps is None else "--set camera-fps"
        raise InputError(Problem(where, "fps", f"{fps:g}", f"{RATES_HZ[0]:g} to {RATES_HZ[1]:g} frames per second"))
    return replace(file, fps=fps, stated_fps=file.fps if file.fps != fps else None)


def _model(settings: FitSettings) -> tuple[Body, MotionPrior]:
    if settings.method == "frame":
        from recon.thesis.clip import load_body

        body = load_body(settings)
        return body, load_prior(None, body)
    body = with_detector_offsets(load_skeleton(settings.skeleton_name, settings.subject), settings.detector)
    body = body if settings.size is None else body.scaled(settings.size)
    body = body if settings.height_m is None else _as_high(body, settings.height_m)
    sides = f"nothing: {body.name} is a whole animal, and both sides are fitted"
    wrong = [Problem("--set side", "side", repr(settings.side), sides)] if settings.side != "auto" else []
    prior, _ = collect_problems(
        lambda: load_prior(settings.prior, body), lambda: raise_problems(wrong if not body.one_sided else ())
    )
    return body, prior


def _as_high(body: Body, height_m: float) -> Body:
    """So large that the withers, or the front end of the trunk, are as high above the feet in the expected pose."""
    if not body.feet:
        raise InputError(Problem("--height-m", "height_m", f"{body.name}, which has no feet", "--set size"))
    heights_m = dict(zip(body.markers, body.expected_points_m()[:, 2], strict=True))
    top = next((name for name in body.markers if "wither" in name.lower()), body.forward[1])
    usual_m = heights_m[top] - min(heights_m[foot] for foot in body.feet)
    return replace(body.scaled(height_m / usual_m), size_sigma=HEIGHT_SIGMA)


def _cleaned(body: Body, settings: FitSettings, fps: float, file: Keypoints, of: ClipCamera, late: float) -> Source:
    """Return the source of a file, as `cleaned_source`; raise InputError also without any keypoints of the body."""
    _require_keypoints_of(body, file)
    return cleaned_source(settings, fps, file, of, late)


def cleaned_source(settings: FitSettings, fps: float, file: Keypoints, of: ClipCamera, late: float) -> Source:
    """Return all keypoints of a file, which began so many frames late, at the clip's frame rate.

    A few that are far outside the camera's picture are left out, and those of frames in which it is not known where the
    camera was. Raises InputError where most lie outside.
    """
    camera, track = of
    first, stop = parse_frame_range(settings.frames) if settings.frames else (None, None)
    assert file.fps is not None
    shift, per_frame = math.floor(late), file.fps / fps  # the clip's frames are the first camera's

    def own(frame: int | None) -> int | None:
        return None if frame is None else math.ceil((frame - shift) * per_frame)

    keypoints, cleaning = clean(file, settings.likelihood_min, (own(first), own(stop)))
    require_inside(camera, keypoints, settings)
    if file.fps != fps:
        if track is not None:
            expected = f"that of the first camera, {fps:g}: one that moves cannot have another"
            raise InputError(Problem(track.source, "fps", f"{file.fps:g}", expected))
        from recon.api.rigs import at_rate

        keypoints = at_rate(keypoints, fps)
        note = f"{camera.name} filmed at {file.fps:g} Hz: its points are taken between its frames, at {fps:g} Hz"
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
    """A few names in common, such as nose, are those of another detector."""
    wanted = tuple(dict.fromkeys(name for pair in body.keypoints for name in pair))
    known = [name for name in keypoints.names if name in wanted]
    if known and (len(known) >= FEW_OF_SKELETON * len(wanted) or len(known) >= FEW_OF_FILE * len(keypoints.names)):
        return
    raise InputError(problem_of_names(keypoints.names, wanted, body.name, keypoints.source or "keypoints"))


def _side(body: Body, keypoints: Keypoints, settings: FitSettings) -> tuple[Side, str]:
    """The side as given, or the one that faces the camera unless the file has far more points of the other."""
    ends = []
    for marker in body.forward:
        names = body.keypoints[body.markers.index(marker)]
        ends.append(mean_along(arrange(keypoints, tuple(dict.fromkeys(names))).xy_px, 1))
    facing, reason = facing_side(*ends)
    if settings.side != "auto":
        return settings.side, f"as given; {reason}"
    other: Side = "left" if facing == "right" else "right"
    of_facing, of_other = (int(arrange(keypoints, body.keypoint_names(s)).present.sum()) for s in (facing, other))
    if of_facing < of_other / 2:
        return other, f"{reason}, but that side has {of_facing} points and the other {of_other}"
    return facing, reason
