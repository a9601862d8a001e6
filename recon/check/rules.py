"""Check the result of a fit by rules that do not need another fit.

A rule is a function that takes a motion and yields findings. `RULES` apply to both methods, `TRAJECTORY_RULES` only to
the trajectory method. Only `no_pose` applies to motions without any pose. Checks that fit the clip again are in
`recon.check.inputs`, and checks that compare cameras in `recon.check.agreement`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from recon.animal.body import ROUGH_SIZE_SIGMA, Body
from recon.animal.prior import mean_speed_m_s, prior_from_body
from recon.animal.skeleton_file import builtin_names, load_skeleton
from recon.base.arrays import Array
from recon.base.errors import InputError
from recon.check.codes import FLAGS, SWAPPED, finding, sort_findings
from recon.check.constants import MANY_FRAMES
from recon.check.inputs import FASTEST_M_S, GROSS_REASON, MOTION_CODES
from recon.clip import UNLIKELY, Source, longest_run
from recon.fit import constants
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.motion import Motion, trajectory_solution
from recon.fit.result import Finding, TrajectorySolution
from recon.fit.solution import ALTERNATIVE_M

Rule = Callable[[Motion], Iterator[Finding]]

MANY_OUTLIERS = 0.2
"""Fraction of the detections that are outliers, above which they are reported."""
EXPLAINED_SIGMAS = 1.9
"""Median distance of detections from the pose, in standard deviations, above which the fit does not explain them.

The median of normally distributed errors in two dimensions is 1.2.
"""
EXPLAINED_DETECTORS = 3.0
"""Median distance of detections from the pose, in units of a detector's usual error, beyond which they are unexplained.

This limit is needed because the noise that a fit estimates can hide a misfit, for example if the frames are in random
order.
"""
MAX_EXPLAINED_OUTLIERS = 0.1
"""Fraction of outliers above which a motion unlike the prior's is reported as wrong, not only as another gait.

A gait that the prior does not contain, such as a run with a prior fitted to walks, has hardly more outliers.
"""
MAX_AMBIGUOUS_FRACTION = 0.1
"""Fraction of frames with a second solution above which the second solution is reported."""
MIN_OUTLIER_FRACTION = 1 / 3
"""Minimum fraction of a keypoint's detections that must be outliers for the keypoint to be reported."""
KEYPOINT_LEAST = 10
"""Minimum number of a keypoint's detections that must be outliers for the keypoint to be reported."""
OUT_OF_STEP_SIGMAS = 3.0
"""Difference between two cameras' time offsets, in expected standard deviations, above which it is reported."""
MAX_CAMERA_LENGTHS = 100.0
"""Distance between cameras, in lengths of the animal, above which the calibration is probably in another unit."""
FEW_FRAMES = 12
"""Number of frames with a pose below which a finding says that the clip shows too little of the motion."""
SIZE_SIGMAS = 2.5
"""Deviation of the animal's size from the expected size, in standard deviations, above which it is reported."""
SIZE_SIGMAS_MOST = 4.0
"""Largest possible deviation of a grown animal's size from the expected size, in standard deviations."""
LOG_SIZE_MOST = math.log(2.0)
"""Largest possible deviation of the logarithm of a grown animal's size, for any standard deviation."""
UNITS_PER_M = {"m": 1.0, "inches": 39.37, "cm": 100.0, "mm": 1000.0}
NEARLY_UNIT = 1.35
"""Largest factor between the camera's apparent scale and a unit's number per metre at which the unit is suggested.

The apparent scale is the camera's height above the origin divided by its height above the feet. The latter is as
uncertain as the animal's size.
"""
UNEXPLAINED = ("fit_explains_little", "motion_unexplained")
"""Codes of findings on fits that do not explain the detections."""
FROM_MOTION = (*MOTION_CODES, "path_jolts")
"""Codes of findings whose cause is inferred from the fitted motion.

A motion that does not explain the detections is no evidence of a cause. For example, frames in the wrong order can look
like a treadmill.
"""
SUBJECT_SIGMAS = 3.0
"""Deviation of a subject's lengths from its species, in standard deviations of the size, above which it is reported."""


def findings_of(motion: Motion) -> tuple[Finding, ...]:
    """Return all findings on a motion, including those of the rules, in the order in which summaries list them.

    Findings with codes of `FROM_MOTION` are left out if the fit does not explain the detections.
    """
    solution = motion.solution
    given_findings = [*motion.findings, *solution.findings()]
    rules: tuple[Rule, ...] = (no_pose,)
    if motion.solved.any():
        rules = (*RULES, *TRAJECTORY_RULES) if isinstance(solution, TrajectorySolution) else RULES
    findings = [*given_findings, *(item for rule in rules for item in rule(motion))]
    if any(item.code in UNEXPLAINED for item in findings):
        findings = [item for item in findings if item.code not in FROM_MOTION]
    return sort_findings(findings)


# Rules for both methods


def many_outliers(motion: Motion) -> Iterator[Finding]:
    """Yield a finding if many detections are outliers, including detections of frames that were left out as a whole."""
    used = sum(int(picture.present.sum()) for picture in motion.pictures)
    gross = sum(source.cleaning.left_out.count(GROSS_REASON) for source in motion.sources)
    count = _outliers(motion)[0] + gross
    fraction = count / max(used + gross, 1)
    if fraction > MANY_OUTLIERS:
        yield finding("many_outliers", count=count, share=fraction)


def detections_not_explained(motion: Motion) -> Iterator[Finding]:
    """Yield a finding if the median distance of the detections from the pose is large."""
    sigmas = _median_deviation(motion, [picture.sigma_px for picture in motion.pictures])
    detectors = _median_deviation(motion, _detector_noise_px(motion))
    if sigmas >= EXPLAINED_SIGMAS or detectors >= EXPLAINED_DETECTORS:
        yield finding("fit_explains_little", sigmas=max(sigmas, detectors))


def _median_deviation(motion: Motion, sigmas_px: Sequence[Array]) -> float:
    """Return the median distance of the detections from the pose, in standard deviations; 0 without detections.

    `sigmas_px` are the standard deviations of the detections of each camera, pixels, shape (T, J).
    """
    deviations = np.concatenate(
        [
            (picture.distance_px / sigma_px)[picture.present]
            for picture, sigma_px in zip(motion.pictures, sigmas_px, strict=True)
        ]
    )
    return float(np.median(deviations[np.isfinite(deviations)])) if np.isfinite(deviations).any() else 0.0


def _detector_noise_px(motion: Motion) -> list[Array]:
    """Return the usual errors of a detector for each camera, pixels, shape (T, J); infinite if unknown."""
    solution, T, J = motion.solution, len(motion.frames), len(motion.body.markers)
    noise_px = np.full((len(solution.views), T, J), np.inf)
    if isinstance(solution, TrajectorySolution):
        rows = np.flatnonzero(motion.solved)
        values = {name: motion.settings.get(name) for name in ("sigma_px", "keypoint_sigma_m")}
        options = TrajectoryOptions(**{name: value for name, value in values.items() if value is not None})
        prior = prior_from_body(motion.body)
        clip = ClipProblem.from_views(solution.views, motion.body, prior, motion.fps, options).part(rows)
        markers_m = (solution.markers_m[rows] - clip.origin_m) / solution.size
        noise_px[:, rows] = clip.noise_px(markers_m, np.ones((len(clip.views), J)), solution.size)
    return [*noise_px]


def keypoints_that_do_not_fit(motion: Motion) -> Iterator[Finding]:
    """Yield a finding on the keypoints of which many detections are outliers."""
    counted = [source.cleaning.keypoints for source in motion.sources]
    used = np.array([sum(by_name[name]["used"] for by_name in counted if name in by_name) for name in motion.names])
    outlier_counts = np.sum([picture.outliers.sum(axis=0) for picture in motion.pictures], axis=0)
    rows = np.flatnonzero(outlier_counts > np.maximum(MIN_OUTLIER_FRACTION * used, KEYPOINT_LEAST))
    if len(rows):
        names, fraction = tuple(motion.names[j] for j in rows), float(outlier_counts[rows].sum() / used[rows].sum())
        yield finding("keypoints_do_not_fit", keypoints=names, share=fraction, used=int(used[rows].sum()))


def camera_taken_level(motion: Motion) -> Iterator[Finding]:
    """Yield a finding if nothing determines the upward direction, so that the camera is assumed to be level."""
    if not motion.knows_up and motion.camera.tilt_rad == 0 and motion.settings.get("up") is None:
        option = "--set up" if motion.camera.has_extrinsics else "--tilt-deg"
        yield finding("camera_taken_level", camera=motion.camera.name, option=option)


def missing_as_constant(motion: Motion) -> Iterator[Finding]:
    """Yield a finding on each camera in whose file missing points are stored as a constant position."""
    for source in motion.sources:
        if source.cleaning.constant_px is not None:
            x, y = source.cleaning.constant_px
            count = source.cleaning.total("missing_constant")
            yield finding("missing_as_constant", camera=source.camera.name, x_px=x, y_px=y, count=count)


def likelihoods_low(motion: Motion) -> Iterator[Finding]:
    """Yield a finding on each camera more than a third of whose points have low likelihoods."""
    for source in motion.sources:
        unlikely, total = _unlikely(source), source.cleaning.total("used") + source.cleaning.total("rejected")
        if unlikely > MANY_FRAMES * total:
            limit = source.cleaning.likelihood_min
            yield finding("likelihoods_low", camera=source.camera.name, share=unlikely / total, limit=limit)


def many_left_out(motion: Motion) -> Iterator[Finding]:
    """Yield a finding if more than a third of the detections are outliers or were left out."""
    if [*likelihoods_low(motion), *many_outliers(motion)]:
        return
    used, rejected = (sum(source.cleaning.total(name) for source in motion.sources) for name in ("used", "rejected"))
    unlikely, outliers = sum(map(_unlikely, motion.sources)), _outliers(motion)[0]
    fraction = (rejected + outliers) / max(used + rejected, 1)
    if fraction > MANY_FRAMES:
        counts = {"of low likelihood": unlikely, "outliers": outliers, "far outside": rejected - unlikely}
        reasons = ", ".join(f"{count} {reason}" for reason, count in counts.items() if count)
        yield finding("many_left_out", share=fraction, reasons=reasons)


def _unlikely(source: Source) -> int:
    """Return the number of detections that were left out because of a low likelihood."""
    cleaning = source.cleaning
    other_reasons = (reason for reason in cleaning.left_out.reasons if reason != UNLIKELY)
    return cleaning.total("rejected") - sum(map(cleaning.left_out.count, other_reasons))


def no_pose(motion: Motion) -> Iterator[Finding]:
    """Yield a finding that states why no frame has a pose."""
    centres = np.array([view.centre_m[0] for view in motion.solution.views if view.is_still])
    distance_m = max((float(np.linalg.norm(a - b)) for a in centres for b in centres), default=0.0)
    times = distance_m / _span(motion.body)
    diverged = any("diverged" in flags for flags in motion.flags)
    if diverged and times > MAX_CAMERA_LENGTHS:
        yield finding(
            "no_pose_unit", apart_m=distance_m, times=times, in_cm_m=distance_m / 100, in_mm_m=distance_m / 1000
        )
        return
    yield finding("no_pose_diverged" if diverged else "no_pose")


def subject_unlike_species(motion: Motion) -> Iterator[Finding]:
    """Yield a finding if a subject's lengths differ from the skeleton's by more than animals of a species differ."""
    species = _species(motion)
    if motion.body.subject is None or species is None:
        return
    times = _span(motion.body) / _span(species)
    if abs(times - 1) > SUBJECT_SIGMAS * species.size_sigma:
        yield finding("subject_unlike_species", times=times, expected_sigma=species.size_sigma)


def _span(body: Body) -> float:
    """Return the root mean square distance (m) of the markers from their mean with all angles at 0."""
    points = body.tree.pose(np.zeros((1, body.n_state))).points_m[0]
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))


def too_fast(motion: Motion) -> Iterator[Finding]:
    """Yield a finding if the animal moves faster than any animal runs."""
    speed = mean_speed_m_s(motion.states, motion.fps)
    if speed > FASTEST_M_S:
        yield finding("too_fast", speed_m_s=speed)


def few_frames(motion: Motion) -> Iterator[Finding]:
    """Yield a finding if few frames have a pose."""
    solved = int(motion.solved.sum())
    if solved < FEW_FRAMES:
        yield finding("few_frames", count=solved)


def frames_flagged(motion: Motion) -> Iterator[Finding]:
    """Yield a finding if more than a third of the frames have a flag."""
    counted = {*FLAGS} - {SWAPPED}  # a swap that matters has a finding of its own
    flags = [{*flags} & counted for flags, is_solved in zip(motion.flags, motion.solved, strict=True) if is_solved]
    count = sum(map(bool, flags))
    if count > MANY_FRAMES * len(flags):
        commonest = max(FLAGS, key=lambda name: sum(name in frame_flags for frame_flags in flags))
        yield finding("frames_flagged", count=count, frames_total=len(flags), flag=commonest, meaning=FLAGS[commonest])


# Rules for the trajectory method only


def cameras_out_of_step(motion: Motion) -> Iterator[Finding]:
    """Yield a finding if the time offsets of two cameras differ by more than expected.

    The fit expects time offsets to be fractions of a frame, so it underestimates larger offsets. The variance of the
    estimates is the expected variance minus the posterior variance, so offsets that the pictures hardly determine come
    out small. Two cameras also count as out of step if a wrong clock is the likeliest explanation of their errors.
    """
    if len(motion.sources) < 2:
        return
    solution = trajectory_solution(motion)
    delays = [v.offset_frames - s.offset_frames for v, s in zip(solution.views, motion.sources, strict=True)]
    ends = [int(np.argmin(delays)), int(np.argmax(delays))]
    apart_frames = delays[ends[1]] - delays[ends[0]]
    expected, remaining = constants.TIME_OFFSET_FRAMES**2, solution.time_offset_sigma_frames[ends] ** 2
    # A delay that is common to all cameras cannot be seen.
    explained = np.sum(expected - remaining) * len(delays) / (len(delays) - 1)
    variance = explained if 0.0 < explained < 2.0 * expected else 2.0 * expected
    likely_late = [test for test in solution.second_cameras if test.late > max(test.misplaced, 0.0)]
    if likely_late or apart_frames > OUT_OF_STEP_SIGMAS * math.sqrt(variance):
        apart_frames = max([apart_frames, *(abs(test.late_frames) for test in likely_late)])
        names = tuple(motion.pictures[v].name for v in ends)
        item = finding("cameras_out_of_step", cameras=names, apart_frames=apart_frames)
        harmless = {f.camera for f in motion.findings if f.code == "camera_late" and f.severity == "note"}
        yield replace(item, severity="note") if harmless & {*names} else item


def motion_unlike_prior(motion: Motion) -> Iterator[Finding]:
    """Yield a finding on the segment with the largest prior misfit, unless another frame rate explains the misfit."""
    solution = trajectory_solution(motion)
    is_rate_explained = any(item.code in ("frame_rate", "frame_rate_stated") for item in motion.findings)
    if any(segment.unlike_prior for segment in solution.segments) and not is_rate_explained:
        misfit = max(segment.prior_misfit for segment in solution.segments if segment.prior_misfit is not None)
        weight = min(segment.prior_weight for segment in solution.segments)
        fraction = _outliers(motion)[1]
        if fraction > MAX_EXPLAINED_OUTLIERS:
            yield finding("motion_unexplained", prior=solution.prior, misfit=misfit, share=fraction)
            return
        numbers = {"prior": solution.prior, "misfit": misfit, "limit": constants.MISFIT_LEVEL, "weight": weight}
        yield finding("motion_unlike_prior", **numbers)


def ground_above_camera(motion: Motion) -> Iterator[Finding]:
    """Yield a finding on each segment of the clip in which the ground lies above the first camera."""
    for segment in motion.solution.segments:
        ground, below = segment.ground, motion.below_m(segment)
        if ground is None or below is None:
            continue
        height = float(below[2] - motion.solution.views[0].centre_m[:, 2].mean())
        if height > 0:
            frames = (int(motion.frames[segment.rows.start]), int(motion.frames[segment.rows.stop - 1]) + 1)
            camera = motion.pictures[0].name
            yield finding("ground_above_camera", frames, camera, height_m=height, sigma_m=ground.sigma_m)


def ground_elsewhere(motion: Motion) -> Iterator[Finding]:
    """Yield a finding on the first segment of the clip in which the feet do not stand near z = 0.

    If the camera is too high by a factor of about 100, 1000 or 39, the camera file is in centimetres, millimetres or
    inches. If a unit was given, and the camera is too low by that unit's factor, the file is in metres.
    """
    for segment in motion.solution.segments:
        ground, below = segment.ground, motion.below_m(segment)
        if ground is not None and below is not None and ground.near_zero is False:
            camera_m = motion.solution.views[0].centre_m[0]
            times = camera_m[2] / (camera_m[2] - below[2])
            distance_m = math.hypot(camera_m[0], camera_m[1])
            given_per_m = UNITS_PER_M[motion.settings.get("camera_unit") or "m"]
            for unit, per_m in UNITS_PER_M.items() if given_per_m == 1.0 else [("metres", 1 / given_per_m)]:
                # With a plausible distance in metres, the other unit would put the camera at the origin.
                in_metres = 1.0 < distance_m < min(50.0, 0.5 * per_m)
                if per_m != 1.0 and not in_metres and 1 / NEARLY_UNIT < times / per_m < NEARLY_UNIT:
                    yield finding("camera_unit", unit=unit, times=float(times))
                    return
            yield finding("ground_elsewhere", height_m=float(below[2]), sigma_m=ground.sigma_m)
            return


def solution_unusual(motion: Motion) -> Iterator[Finding]:
    """Yield a finding if the fit did not converge, and a finding if the animal has an unexpected size."""
    solution = trajectory_solution(motion)
    if solution.status != "converged":
        yield finding("not_converged", part=_well_detected(motion))
    if abs(solution.size - 1) > SIZE_SIGMAS * solution.size_prior_sigma:
        limit = min(SIZE_SIGMAS_MOST * solution.size_prior_sigma, LOG_SIZE_MOST)
        code = "size_impossible" if abs(math.log(solution.size)) > limit else "size_unexpected"
        yield finding(code, size=solution.size, expected_sigma=solution.size_prior_sigma)


def _well_detected(motion: Motion) -> str:
    """Return the option for the longest part of a clip without the flags "no data" and "data poor".

    Return the option's name only if the part has less than half of the frames, or all frames.
    """
    is_good = np.array([not {*flags} & {"no data", "data poor"} for flags in motion.flags])
    first, stop = longest_run(is_good) if is_good.any() else (0, 0)
    if not len(is_good) / 2 <= stop - first < len(is_good):
        return "--frames"
    return f"--frames {motion.frames[first]}:{motion.frames[stop - 1] + 1}, the longest part with enough detections"


def pair_disagrees(motion: Motion) -> Iterator[Finding]:
    """Yield a finding if one of two cameras has probably been turned or moved, even if their rays still meet.

    In this case, the animal has different sizes in the two pictures, or an unexpected size.
    """
    largest_gain = max(
        (test.misplaced for test in trajectory_solution(motion).second_cameras if test.misplaced >= test.late),
        default=0.0,
    )
    if largest_gain > 0:
        names = tuple(picture.name for picture in motion.pictures)
        code = "pair_or_lengths" if _has_rough_lengths(motion) else "pair_disagrees"
        yield finding(code, cameras=names, log_likelihood_ratio=largest_gain)


def _has_rough_lengths(motion: Motion) -> bool:
    """Return whether the lengths come from a generic skeleton, such as `quadruped`, for no particular species."""
    species = _species(motion)
    return motion.body.subject is None and species is not None and species.size_sigma > ROUGH_SIZE_SIGMA


def _species(motion: Motion) -> Body | None:
    """Return the skeleton without a subject's lengths; None if it is neither built-in nor a file that still exists."""
    name = motion.settings.get("skeleton")
    if name is None and motion.body.name not in builtin_names():
        return None
    try:
        return load_skeleton(name or motion.body.name)
    except InputError:  # the skeleton's file no longer exists
        return None


def second_solution(motion: Motion) -> Iterator[Finding]:
    """Yield a finding if a second solution explains many frames nearly as well."""
    is_ambiguous = np.array(["ambiguous depth" in flags for flags in motion.flags])
    rows = is_ambiguous & (np.nan_to_num(motion.alternative_m) > ALTERNATIVE_M)
    if rows.sum() > MAX_AMBIGUOUS_FRACTION * len(rows):
        distance_m = float(motion.alternative_m[rows].max())
        yield finding("second_solution", count=int(rows.sum()), frames_total=len(rows), apart_m=distance_m)


TRAJECTORY_RULES: tuple[Rule, ...] = (
    cameras_out_of_step,
    motion_unlike_prior,
    ground_above_camera,
    ground_elsewhere,
    solution_unusual,
    pair_disagrees,
    second_solution,
)
RULES: tuple[Rule, ...] = (
    likelihoods_low,
    missing_as_constant,
    many_outliers,
    many_left_out,
    detections_not_explained,
    keypoints_that_do_not_fit,
    camera_taken_level,
    too_fast,
    few_frames,
    subject_unlike_species,
    frames_flagged,
)
"""Rules for both methods."""


def _outliers(motion: Motion) -> tuple[int, float]:
    """Return the number of detections that are outliers, and their fraction of the detections used in the fit."""
    count = sum(int(picture.outliers.sum()) for picture in motion.pictures)
    detections = sum(int(picture.present.sum()) for picture in motion.pictures)
    return count, count / max(detections, 1)
