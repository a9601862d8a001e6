"""One clip: a keypoint file and a camera in, its 3D motion out (`recon.workflows.clip_results` writes its folder)."""

from __future__ import annotations

import logging
import math
import re
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from recon.animal.body import Body, Side
from recon.animal.chain import facing_side, load_chain
from recon.animal.naming import load_names, problem_of_names, renamed
from recon.animal.prior import MotionPrior, load_prior
from recon.animal.skeleton_file import load_skeleton, with_detector_offsets
from recon.base.arrays import Array, mean_along
from recon.base.documents import require_file
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.progress import Progress, silent
from recon.check.codes import sentences
from recon.check.inputs import input_findings, with_flags, without_gross_outliers
from recon.check.swap_repair import downgrade_swap, swap_improves, without_swaps
from recon.check.verdict import add_verdict, verdict_lines
from recon.clip import (
    Keypoints,
    Source,
    View,
    align_cameras,
    clean,
    fill_from_nearest,
    leave_out,
    parse_frame_range,
    views_of,
)
from recon.fit.belt import belt_path_m, views_from_belt
from recon.fit.motion import Motion
from recon.fit.result import Finding, TrajectorySolution
from recon.fit.trajectory import solve_trajectory
from recon.geometry.camera import Camera
from recon.io.calibration import read_camera, read_cameras
from recon.io.formats import read_keypoints
from recon.workflows.settings import UNITS_M, FitSettings, Unit

if TYPE_CHECKING:
    from recon.io.camera_track import CameraTrack

LOGGER = logging.getLogger("recon")
RATES_HZ = (1.0, 10_000.0)
"""Frame rates that a clip can have. Slower, a whole stride lies between two frames, and nothing ties them; faster, what
an animal does from one frame to the next is lost in the rounding of its acceleration."""


FEW_OF_SKELETON, FEW_OF_FILE = 0.25, 0.5
"""A file with fewer of the skeleton's keypoints, to which fewer of its own belong, has other names for them."""
HEIGHT_SIGMA = 0.05
"""Relative, of a size that follows from the height at the withers: animals differ in their proportions."""
PADDED, INSIDE = 0.05, 0.9
"""Detectors pad the picture: so far outside keypoints are as good as in it; at least so many of a clip's have to be."""
_FAR_OUTSIDE = "too far outside the picture to have been found in it"

ClipCamera = tuple[Camera, "CameraTrack | None"]
"""The camera of a keypoint file, with a track its lens only: it has no pose; and the track of a camera that moves."""
Cameras = tuple[ClipCamera, ...]


def fit_clip(settings: FitSettings, progress: Progress = silent) -> Motion:
    """Reconstruct one clip over all frames at once, or one frame after the other (method "frame").

    Raises InputError for files and settings that cannot be used, with the problems of all of them. Frames that cannot
    be solved are part of the result.
    """
    if settings.method == "frame":
        from recon.thesis.clip import fit_clip as fit_frames

        return fit_frames(settings, progress)
    given = prepare(settings)
    body, prior, sources, options = given.body, given.prior, given.sources, settings.trajectory_options()

    def solved(sources: tuple[Source, ...]) -> TrajectorySolution:
        views = views_of(sources)
        solution = solve_trajectory(views, body, prior, given.fps, options, progress)
        if settings.belt_speed_m_s is None:
            return solution
        path_m = belt_path_m(solution, sources[0].keypoints.frames / given.fps, settings.belt_speed_m_s)
        return solve_trajectory(views_from_belt(views, path_m), body, prior, given.fps, options, progress)

    if options.find_offsets:
        noise = (options.sigma_px, options.keypoint_noise_m(body))
        from recon.check.agreement import solve_time_offsets

        sources, solution = solve_time_offsets(given.apart, given.later_frames, solved, *noise)
    else:
        solution = solved(sources)
    unrefined: tuple[Finding, ...] = ()
    if options.refine_cameras:
        tried, options = solution, replace(options, refine_cameras=False)
        held = solved(sources)
        from recon.check.agreement import why_not_refined

        unrefined = why_not_refined(tried, held)
        solution, options = (held, options) if unrefined else (tried, replace(options, refine_cameras=True))
    began = time.perf_counter()
    cleaned, outliers = without_gross_outliers(sources, solution)
    again = solved(cleaned) if outliers else solution
    if again.posed.any() or not solution.posed.any():
        sources, solution = cleaned, again
    else:  # a fit that gets nowhere without them was wrong about them
        outliers = ()
    chain = load_chain(settings.skeleton_name) if body.one_sided else None
    motion = Motion(sources, given.side, given.side_reason, solution, chain=chain, settings=settings.plain())
    found = input_findings(motion, prior, options, *_file_facts(given, settings))
    if any(one.code == "left_right_swap" for one in found):
        mended, marked = without_swaps(sources, found, body)
        again = solved(mended)
        if not swap_improves(again, solution):
            found = tuple(downgrade_swap(one) for one in found)
        elif settings.fix_swaps:
            sources, found, solution = mended, marked, again
    stage_s = solution.stage_s | {"input_findings": time.perf_counter() - began}
    motion = replace(motion, sources=sources, solution=replace(solution, stage_s=stage_s))
    agreement: tuple[Finding, ...] = ()
    if len(sources) > 1:
        from recon.check.agreement import agreement_findings, swaps_by_effect

        noise = (options.sigma_px, options.keypoint_noise_m(body))
        agreement, found = agreement_findings(motion, *noise), swaps_by_effect(found, motion, *noise)
    found = (*given.found, *unrefined, *outliers, *found, *agreement)
    if settings.seeks_cameras:
        placed = zip(sources, solution.extrinsic_correction, solution.focal, strict=True)
        sources = tuple(replace(s, camera=s.camera.corrected(by).with_focal_scale(longer)) for s, by, longer in placed)
    motion = add_verdict(replace(with_flags(motion, found), sources=sources, findings=found))
    _log(motion)
    return motion


def _log(motion: Motion) -> None:
    """What was decided about the files, what was found, and the verdict, for who listens to the logger "recon"."""
    name, level = Path(motion.keypoints.source or "clip").name, {"note": logging.INFO}
    said = [(logging.INFO, note) for source in motion.sources for note in source.cleaning.notes]
    said += [(level.get(one.severity, logging.WARNING), text) for one, text in sentences(motion)]
    for of, text in (*said, *((logging.INFO, line) for line in verdict_lines(motion.verdict))):
        LOGGER.log(of, "%s: %s", name, text)


def _file_facts(given: ClipInputs, settings: FitSettings) -> tuple[list[str | None], float | None, bool]:
    """What the files say of a clip besides its keypoints, as `recon.check.input_findings` takes it."""
    named = []
    for source, path in zip(given.sources, settings.keypoints, strict=True):
        cameras = () if source.moves else other_cameras(source.camera, settings)
        names = cameras_in(path.stem, [source.camera.name, *(camera.name for camera in cameras)])
        other = next(iter(names), None) or other_camera_in(path.stem, source.camera.name)
        named.append(None if source.camera.name in names else other)
    stated_hz = next((s.keypoints.stated_fps for s in given.sources if s.keypoints.stated_fps is not None), None)
    return named, stated_hz, not settings.fast or bool(settings.fix_swaps)


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
    found: tuple[Finding, ...] = ()
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
    from recon.workflows.rigs import turned_up_by_feet

    apart, found = turned_up_by_feet(given.sources, sources, seen, fps, settings.trajectory_options().sigma_px)
    return replace(given, apart=apart, found=found)


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
    """All keypoints of a file, which began so many frames late, at the clip's frame rate. Raises InputError without any
    of the body's, or where they lie outside the camera's picture; a few that are far outside are left out, and those of
    frames in which it is not known where the camera was."""
    _require_keypoints_of(body, file)
    camera, track = of
    first, stop = parse_frame_range(settings.frames) if settings.frames else (None, None)
    assert file.fps is not None
    shift, per_frame = math.floor(late), file.fps / fps  # the clip's frames are the first camera's

    def own(frame: int | None) -> int | None:
        return None if frame is None else math.ceil((frame - shift) * per_frame)

    keypoints, cleaning = clean(file, settings.likelihood_min, (own(first), own(stop)))
    _require_inside(camera, keypoints, settings)
    if file.fps != fps:
        if track is not None:
            expected = f"that of the first camera, {fps:g}: one that moves cannot have another"
            raise InputError(Problem(track.source, "fps", f"{file.fps:g}", expected))
        from recon.workflows.rigs import at_rate

        keypoints = at_rate(keypoints, fps)
        note = f"{camera.name} filmed at {file.fps:g} Hz: its points are taken between its frames, at {fps:g} Hz"
        cleaning = replace(cleaning, notes=(*cleaning.notes, note))
    poses = None
    if track is not None:
        from recon.workflows.rigs import with_poses

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


def _require_inside(camera: Camera, keypoints: Keypoints, settings: FitSettings) -> None:
    """A picture smaller than the points' is another camera's, or the wrong size was given."""
    points = np.clip(keypoints.xy_px[keypoints.present], -1e9, 1e9)
    if _holds(camera.image_size_px, points):
        return
    (x0, y0), (x1, y1) = np.percentile(points, [1, 99], axis=0)
    width, height = camera.image_size_px
    found = f"{width}x{height}, but keypoints at x {x0:.0f} to {x1:.0f}, y {y0:.0f} to {y1:.0f} px"
    expected = "the camera and the size of the video that the keypoints were found in"
    where = settings.camera_text or "--image-size"
    raise InputError(Problem(where, "image size", found, expected + _perhaps(camera, points, settings)))


def _holds(size_px: tuple[int, int], points: Array) -> bool:
    """Whether nearly all points (n, 2) lie in a picture of that size, or as little outside as detectors put them."""
    over = np.max([-points, points - size_px], axis=0) / size_px
    return bool(np.mean(over.max(axis=1) <= PADDED) >= INSIDE)


def _perhaps(camera: Camera, points: Array, settings: FitSettings) -> str:
    """What would put points (n, 2) in the picture."""
    causes = ["x and y are exchanged"] if _holds(camera.image_size_px, points[:, ::-1]) else []
    others = (one for one in other_cameras(camera, settings) if _holds(one.image_size_px, points))
    causes += [f"they are of {other.name} of the file" for other in others]
    larger = (n for n in (2, 3, 4) if _holds((n * camera.image_size_px[0], n * camera.image_size_px[1]), points))
    causes = causes or [f"they were found in a video {n} times as large" for n in larger][:1]
    return f"; perhaps {', or '.join(causes)}" if causes else ""


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


# -- which camera a keypoint file is of, and where it was -------------------------------------------------------------


def read_clip_cameras(settings: FitSettings) -> Cameras:
    """The camera of each keypoint file. Raises InputError."""
    tracks: tuple[CameraTrack, ...] = ()
    if settings.camera_track:
        from recon.io.camera_track import read_camera_track

        tracks = tuple(collect_problems(*(lambda path=path: read_camera_track(path) for path in settings.camera_track)))
    choose = _cameras_of_one if len(settings.keypoints) == 1 else _cameras_of_several
    chosen = tuple((_as_it_stands(*one, settings.camera_unit), one[1]) for one in choose(settings, tracks))
    if tracks or settings.up is not None:
        from recon.workflows import rigs

        raise_problems(rigs.focal_problems(chosen))
        chosen = chosen if settings.up is None else rigs.turned_up(chosen, settings.up)
    if settings.tilt_deg is None:
        return chosen
    if any(camera.knows_up for camera, _ in chosen):
        found = f"{settings.tilt_deg:g} beside the pose in {settings.camera_text}, which says which way is up"
        raise InputError(Problem("--tilt-deg", "tilt_deg", found, "one of the two"))
    tilt_rad = math.radians(settings.tilt_deg)
    return tuple((replace(camera, tilt_rad=tilt_rad), track) for camera, track in chosen)


def other_cameras(camera: Camera, settings: FitSettings) -> tuple[Camera, ...]:
    """The cameras of the camera file that the clip is not said to be of, none where there is no such file."""
    if settings.camera is None:
        return ()
    cameras = read_cameras(settings.camera, settings.image_size_px)
    return tuple(other for other in cameras if other.name != camera.name)


def _as_it_stands(camera: Camera, track: CameraTrack | None, unit: Unit) -> Camera:
    """Where the camera file says in that unit where it is; with a track, only that says it."""
    if track is not None:
        return replace(camera, rotation=None, translation_m=None, tilt_rad=0.0)
    if camera.translation_m is None or unit == "m":
        return camera
    return replace(camera, translation_m=UNITS_M[unit] * camera.translation_m)


def _cameras_of_one(settings: FitSettings, tracks: Sequence[CameraTrack]) -> Cameras:
    """A clip with one keypoint file, whose camera any track is."""
    track = tracks[0] if tracks else None
    given = "a camera file" if settings.camera is not None else "--hfov-deg" if settings.hfov_deg is not None else None
    if track is not None and track.camera is not None:
        if given is not None:
            found = f"{given} beside {track.source}, which has the lens"
            raise InputError(Problem("--camera-track", "camera", found, "one of the two"))
        return ((_own_lens(track.camera, settings, 0), track),)
    if settings.camera is not None:
        return ((_cameras_in_file(settings, ())[0], track),)
    if settings.hfov_deg is not None and settings.image_size_px is not None:
        return ((Camera.from_hfov(settings.hfov_deg, settings.image_size_px), track),)
    found = "nothing" if track is None else f"nothing, and {track.source.name} comes without a lens"
    raise InputError(Problem("settings", "camera", found, "a camera file, or hfov_deg with image_size_px"))


def _own_lens(camera: Camera, settings: FitSettings, place: int) -> Camera:
    """The lens of a track, named as given. Raises InputError for another size of the picture than is given."""
    size, given = camera.image_size_px, settings.image_size_px
    if given is not None and size != given:
        expected = f"{given[0]}x{given[1]}, as was given"
        raise InputError(Problem("--camera-track", "image size", f"{size[0]}x{size[1]}", expected))
    return camera if settings.camera_name is None else replace(camera, name=settings.camera_name[place])


def _cameras_of_several(settings: FitSettings, tracks: Sequence[CameraTrack]) -> Cameras:
    """A track is that of the camera whose name its own contains."""
    from recon.workflows.rigs import problems_of_several

    cameras = _cameras_in_file(settings, tracks)
    names = [camera.name for camera in cameras]
    from recon.io.camera_track import track_label

    owners = {track.source: list(cameras_in(track_label(track.source), dict.fromkeys(names))) for track in tracks}
    raise_problems(problems_of_several(settings.camera_text or "--camera", cameras, owners))
    chosen = []
    for i, camera in enumerate(cameras):
        track = next((one for one in tracks if camera.name in owners[one.source]), None)
        own = None if track is None else track.camera
        chosen.append((camera if own is None else _own_lens(replace(own, name=camera.name), settings, i), track))
    return tuple(chosen)


def _camera_by_name(settings: FitSettings, place: int, name: str, tracks: Sequence[CameraTrack]) -> Camera:
    """The camera of a track with a lens, or from the camera file."""
    for track in tracks:
        from recon.io.camera_track import track_label

        if track.camera is not None and name in cameras_in(track_label(track.source), settings.camera_name or ()):
            return _own_lens(track.camera, settings, place)
    if settings.camera is None:
        raise InputError(Problem("--camera", "camera", f"no lens of {name}", "a camera file with it"))
    return read_camera(settings.camera, name, settings.image_size_px)


def _cameras_in_file(settings: FitSettings, tracks: Sequence[CameraTrack]) -> tuple[Camera, ...]:
    """By name as given, in a track with a lens or in the camera file; else the only one there, or the one whose name
    the keypoint file's name contains."""
    if settings.camera_name is not None:
        named = enumerate(settings.camera_name)
        return tuple(
            collect_problems(*(lambda i=i, name=name: _camera_by_name(settings, i, name, tracks) for i, name in named))
        )
    path, cameras = settings.camera_text, read_cameras(settings.camera or (), settings.image_size_px)
    if len(cameras) == 1 == len(settings.keypoints):
        return cameras
    if len(cameras) < len(settings.keypoints):
        found = f"{len(cameras)} of the {len(settings.keypoints)} cameras"
        expected = "one for each keypoint file: a file that has all of them, or --camera once for each"
        raise InputError(Problem(path, "camera", found, expected))
    names = [camera.name for camera in cameras]
    chosen = {file: cameras_in(file.stem, names) for file in settings.keypoints}
    unclear = [file for file, of in chosen.items() if len(of) != 1]
    there = [file for file in unclear if file.exists()]
    found = f"{len(cameras)} cameras and no choice"
    found += f" for {', '.join(file.name for file in there)}" if len(chosen) > 1 else ""
    problem = Problem(path, "camera", found, f"one of {', '.join(names)} by --camera-name, or in the file's name")
    missing = (partial(require_file, file) for file in unclear if file not in there)
    collect_problems(*missing, lambda: raise_problems([problem] * bool(there)))
    return tuple(camera for of in chosen.values() for camera in cameras if camera.name in of)


def cameras_in(stem: str, names: Iterable[str]) -> dict[str, re.Match[str]]:
    """Which cameras' names a file's name has, and where: cam1 is in run_cam1DLC, not in run_cam10; A is in run-A, not
    in run-Alex; cam1 is in run_cam01, unless there is a cam01. If a file's name has camA or cam-1, the cameras A and 1
    are looked for nowhere else in it."""
    # cam1 is also cam_01 and Camera1, what Pose2Sim calls int_cam01_img, and DANNCE hires_cam1_params
    called = {
        name: re.fullmatch(r"(?:int_|hires_)?([A-Za-z]+)[-_ ]?0*([0-9]+)(?:_img|_params)?", name) for name in names
    }
    spelt = {
        name: re.escape(name) if of is None else re.sub("(?i)^cam(era)?$", "cam(?:era)?", of[1]) + f"[-_ ]?0*{of[2]}"
        for name, of in called.items()
    }
    for before in ("cam(?:era)?[-_ ]?", ""):
        ends = {name: "(?![0-9])" if name[-1:].isdigit() else "(?![0-9])(?=DLC|[^a-z]|$)" for name in spelt}
        patterns = {name: rf"(?<![0-9A-Za-z]){before}{spelt[name]}{ends[name]}" for name in spelt}
        matches = {name: re.search(pattern, stem, re.IGNORECASE) for name, pattern in patterns.items()}
        found = {name: match for name, match in matches.items() if match is not None}
        as_written = {match.span(): name for name, match in found.items() if match[0].endswith(name)}
        if found:
            return {name: match for name, match in found.items() if as_written.get(match.span(), name) == name}
    return {}


def other_camera_in(stem: str, name: str) -> str | None:
    """The camera that a file's name says, if it is called as this one but for its number: cam1 in run_cam1DLC, where
    the camera is cam3. None where it says none, or this one."""
    called = re.fullmatch(r"([A-Za-z]{3,})([-_ ]?)([0-9]+)", name)
    if called is None:
        return None
    word, between, number = called.groups()
    found = re.findall(rf"(?<![0-9A-Za-z]){word}[-_ ]?([0-9]+)", stem, re.IGNORECASE)
    return None if not found or int(number) in map(int, found) else f"{word}{between}{found[0]}"
