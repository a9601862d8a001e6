"""Fit one clip, which turns keypoints and a camera into 3D motion."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from recon.animal.body import ROUGH_SIZE_SIGMA, Body
from recon.api.clip_cameras import cameras_in, other_camera_in, other_cameras, possible_cameras
from recon.api.clip_inputs import ClipInputs, prepare
from recon.api.settings import FitSettings
from recon.base.progress import Progress, silent
from recon.check.codes import sentences
from recon.check.inputs import input_findings, with_flags, without_gross_outliers
from recon.check.swap_repair import downgrade_swap, swap_improves, without_swaps
from recon.check.verdict import add_verdict, verdict_lines
from recon.clip import Source, View, views_of
from recon.fit import constants
from recon.fit.belt import belt_path_m, relative_to_belt, views_from_belt
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.correction_gain import correction_gain_m2
from recon.fit.motion import Motion
from recon.fit.result import Finding, TrajectorySolution
from recon.fit.trajectory import solve_trajectory
from recon.geometry.camera import Camera

if TYPE_CHECKING:
    from recon.animal.chain import Chain

LOGGER = logging.getLogger("recon")
PAIR_REFINED = "pair_refined", "pair_adjusted"
"""Codes of findings on a fit whose second camera was refined although the settings did not ask for it."""
CHECKS_BEGIN = 0.9
"""Progress of a fit, 0 to 1, when the checks of the input begin. The fraction of the time depends on the clip."""


@dataclass(frozen=True)
class _Fit:
    """State of a fit after one of its stages."""

    sources: tuple[Source, ...]
    """Keypoints of each camera that this stage uses."""
    options: TrajectoryOptions
    """Options of the solver, which stages can change."""
    solution: TrajectorySolution
    findings: tuple[Finding, ...]


Solve = Callable[[tuple[Source, ...], TrajectoryOptions], TrajectorySolution]


def fit_clip(settings: FitSettings, progress: Progress = silent) -> Motion:
    """Reconstruct one clip, either over all frames at once or frame by frame (method "frame").

    Frames that cannot be solved stay in the result, without a pose.

    Raises
    ------
    InputError
        If files or settings cannot be used. The message lists all problems.
    """
    if settings.method == "frame":
        from recon.thesis.clip import fit_clip as fit_frames

        return fit_frames(settings, progress)
    inputs = prepare(settings)
    solve = partial(_solve, inputs, settings.belt_speed_m_s)
    chain = _chain_of(inputs.body, settings)
    as_motion = partial(_as_motion, inputs, settings, chain)

    options = settings.trajectory_options()
    if options.refine_cameras and len(inputs.sources) == 2:  # two refined cameras cannot separate lengths from the pose
        options = replace(options, lengths_known=True)
    solving = _part_of(progress, 0.0, CHECKS_BEGIN)
    fit = _solve_first(inputs, options, partial(solve, progress=solving))
    fit = _solve_again_with_fixed_cameras(fit, solve, settings.lengths_known)
    fit = _refine_pair(fit, inputs, settings)
    if fit.options.refine_cameras and not options.refine_cameras:
        solve = partial(_solve_near, inputs, fit.solution)
    began = time.perf_counter()
    checking = _part_of(progress, CHECKS_BEGIN, 1.0)
    checking("gross outliers", 0.0)
    fit = _solve_again_without_gross_outliers(fit, solve)
    checking("input files", 0.1)
    fit = _check_inputs(fit, as_motion(fit), inputs, settings)
    checking("left and right", 0.6)
    fit = _solve_again_without_swaps(fit, inputs, settings, solve)
    fit = _with_stage_time(fit, "input_findings", time.perf_counter() - began)
    checking("cameras", 0.8)
    fit = _check_agreement(fit, as_motion(fit), inputs)
    checking("verdict", 0.9)
    motion = _with_correction_gain(_judge(fit, as_motion(fit), settings), fit, inputs)
    checking("verdict", 1.0)
    _log(motion)
    return motion


def refit_clip(settings: FitSettings, motion: Motion) -> Motion:
    """Fit a clip again, starting from an earlier fit, after a few detections have changed.

    The search begins at the earlier motion, and the findings on the input files are taken from the earlier fit, so the
    result is only a preview of what `fit_clip` returns. If unknowns other than the motion have to be estimated again,
    `fit_clip` is called instead.

    Parameters
    ----------
    settings
        Settings of the fit, including the corrections.
    motion
        The earlier fit.

    Raises
    ------
    InputError
        As in `fit_clip`.
    """
    is_refined = any(item.code in PAIR_REFINED for item in motion.findings)
    has_other_unknowns = (
        settings.seeks_cameras or is_refined or settings.belt_speed_m_s is not None or settings.find_offsets
    )
    if has_other_unknowns or settings.method == "frame" or not isinstance(motion.solution, TrajectorySolution):
        return fit_clip(settings)
    inputs = prepare(settings)
    chain = _chain_of(inputs.body, settings)
    options = settings.trajectory_options()
    views = views_of(inputs.sources)
    if len(views[0].xy_px) != len(motion.frames) or len(views) != len(motion.sources):
        return fit_clip(settings)
    solution = solve_trajectory(views, inputs.body, inputs.prior, inputs.fps, options, start=motion.solution)
    fit = _Fit(inputs.sources, options, solution, motion.findings)
    return _judge(fit, _as_motion(inputs, settings, chain, fit), settings)


def _part_of(progress: Progress, begin: float, end: float) -> Progress:
    """Return a function that reports a part of the work, 0 to 1, as the fractions `begin` to `end` of all the work."""
    return lambda stage, share: progress(stage, begin + (end - begin) * share)


def _solve(
    inputs: ClipInputs,
    belt_speed_m_s: float | None,
    sources: tuple[Source, ...],
    options: TrajectoryOptions,
    progress: Progress = silent,
) -> TrajectorySolution:
    """Solve for the motion from the sources.

    On a belt the motion is solved twice, because only the second solve knows the belt's path. The second solve begins
    at the poses of the first, because a search from scratch for a body that passes moving cameras often ends at
    another pose.
    """
    views = views_of(sources)
    solution = solve_trajectory(views, inputs.body, inputs.prior, inputs.fps, options, progress)
    if belt_speed_m_s is None:
        return solution
    path_m = belt_path_m(solution, sources[0].keypoints.frames / inputs.fps, belt_speed_m_s)
    start, views = relative_to_belt(solution, path_m), views_from_belt(views, path_m)
    return solve_trajectory(views, inputs.body, inputs.prior, inputs.fps, options, start=start)


def _solve_near(
    inputs: ClipInputs, start: TrajectorySolution, sources: tuple[Source, ...], options: TrajectoryOptions
) -> TrajectorySolution:
    """Solve for the motion from the sources, beginning at a solution for nearly the same keypoints."""
    views = views_of(sources)
    return solve_trajectory(views, inputs.body, inputs.prior, inputs.fps, options, start=start)


def _solve_first(inputs: ClipInputs, options: TrajectoryOptions, solve: Solve) -> _Fit:
    """Solve for the motion, and for the cameras' time offsets if they are to be estimated."""
    if not options.find_offsets:
        return _Fit(inputs.sources, options, solve(inputs.sources, options), inputs.findings)
    from recon.check.time_offsets import solve_time_offsets

    noise = (options.sigma_px, options.keypoint_noise_m(inputs.body))
    solve_with = partial(_solve_with, solve, options)
    sources, solution = solve_time_offsets(inputs.sources_apart, inputs.later_frames, solve_with, *noise)
    return _Fit(sources, options, solution, inputs.findings)


def _solve_with(solve: Solve, options: TrajectoryOptions, sources: tuple[Source, ...]) -> TrajectorySolution:
    return solve(sources, options)


def _solve_again_with_fixed_cameras(fit: _Fit, solve: Solve, lengths_known: bool) -> _Fit:
    """Undo the refinement of cameras if the poses of the camera file explain the keypoints equally well.

    While two cameras are refined, the animal's lengths are fixed. If the poses of the file are used instead, the
    lengths are fixed only if `lengths_known` is true.
    """
    if not fit.options.refine_cameras:
        return fit
    from recon.check.refined_poses import why_not_refined

    options = replace(fit.options, refine_cameras=False)
    fixed = solve(fit.sources, options)
    unrefined = why_not_refined(fit.solution, fixed)
    if not unrefined:
        return fit
    if options.lengths_known != lengths_known:
        options = replace(options, lengths_known=lengths_known)
        fixed = solve(fit.sources, options)
    return replace(fit, options=options, solution=fixed, findings=(*fit.findings, *unrefined))


def _refine_pair(fit: _Fit, inputs: ClipInputs, settings: FitSettings) -> _Fit:
    """Refine the poses of two cameras, unless they are known or the refined poses are not better.

    Refined poses are not better if they do not fit better, or if the rays of both cameras meet worse. The animal's
    lengths have to be known roughly, because only lengths can contradict the poses of a pair whose rays meet. The
    search begins at the solution with the poses as calibrated.
    """
    is_fixed = settings.cameras_known or settings.camera_track is not None or settings.belt_speed_m_s is not None
    if is_fixed or fit.options.refine_cameras or len(fit.sources) != 2 or inputs.body.size_sigma > ROUGH_SIZE_SIGMA:
        return fit
    if settings.refine_cameras or not fit.solution.posed.any():  # refined poses were refused, or there is no pose
        return fit
    from recon.check.refined_poses import pair_is_turned, pair_refined, rays_meet_worse, why_not_refined

    options = replace(fit.options, refine_cameras=True, refine_first=True, lengths_known=True)
    refined = _solve_near(inputs, fit.solution, fit.sources, options)
    if not refined.posed.any() or rays_meet_worse(refined, fit.solution):
        return fit
    is_misplaced = any(test.is_misplaced for test in fit.solution.second_cameras) or pair_is_turned(refined)
    # estimated lengths fit more closely than known lengths, and can hide that a camera is turned
    may_fit_worse = is_misplaced and fit.solution.shape is not None
    if why_not_refined(refined, fit.solution, constants.CALIBRATED_RAD, may_fit_worse=may_fit_worse):
        return fit
    solution = refined if is_misplaced else _with_pair_tests(refined, fit.solution)
    findings = (*fit.findings, pair_refined(refined, is_misplaced))
    return replace(fit, options=options, solution=solution, findings=findings)


def _with_pair_tests(solution: TrajectorySolution, earlier: TrajectorySolution) -> TrajectorySolution:
    """Return a solution with refined poses that keeps the earlier tests of the second camera."""
    tests = {(part.rows.start, part.rows.stop): part.second_camera for part in earlier.segments}
    segments = tuple(
        replace(part, second_camera=part.second_camera or tests.get((part.rows.start, part.rows.stop)))
        for part in solution.segments
    )
    return replace(solution, segments=segments)


def _solve_again_without_gross_outliers(fit: _Fit, solve: Solve) -> _Fit:
    """Leave out detections that are far from any pose, unless no frame could be solved without them."""
    cleaned, outliers = without_gross_outliers(fit.sources, fit.solution)
    solution = _with_pair_tests(solve(cleaned, fit.options), fit.solution) if outliers else fit.solution
    if not solution.posed.any() and fit.solution.posed.any():  # no frame has a pose without them, so they are kept
        return fit
    return replace(fit, sources=cleaned, solution=solution, findings=(*fit.findings, *outliers))


def _check_inputs(fit: _Fit, motion: Motion, inputs: ClipInputs, settings: FitSettings) -> _Fit:
    """Add the findings on the input files that the solution reveals."""
    findings = input_findings(motion, inputs.prior, fit.options, *_file_facts(inputs, settings))
    return replace(fit, findings=(*fit.findings, *findings))


def _solve_again_without_swaps(fit: _Fit, inputs: ClipInputs, settings: FitSettings, solve: Solve) -> _Fit:
    """Exchange left and right in detected swaps, if the settings allow it and the exchange improves the fit.

    A swap is downgraded to a possible swap if the exchange does not improve the fit.
    """
    if not any(finding.code == "left_right_swap" for finding in fit.findings):
        return fit
    mended, marked = without_swaps(fit.sources, fit.findings, inputs.body)
    solution = _with_pair_tests(solve(mended, fit.options), fit.solution)
    if not swap_improves(solution, fit.solution):
        return replace(fit, findings=tuple(downgrade_swap(finding) for finding in fit.findings))
    return replace(fit, sources=mended, solution=solution, findings=marked) if settings.fix_swaps else fit


def _with_stage_time(fit: _Fit, stage: str, seconds: float) -> _Fit:
    return replace(fit, solution=replace(fit.solution, stage_s=fit.solution.stage_s | {stage: seconds}))


def _check_agreement(fit: _Fit, motion: Motion, inputs: ClipInputs) -> _Fit:
    """Add findings on cameras that contradict each other, and grade swaps by their effect on the fit."""
    if len(fit.sources) == 1:
        return fit
    from recon.check.agreement import agreement_findings, swaps_by_effect

    noise = (fit.options.sigma_px, fit.options.keypoint_noise_m(inputs.body))
    options = replace(fit.options, refine_cameras=False, focal_sigma=None)  # the views have the refined cameras

    def fitted(views: Sequence[View]) -> TrajectorySolution:
        return solve_trajectory(views, inputs.body, inputs.prior, inputs.fps, options)

    agreement = agreement_findings(motion, *noise, fitted)
    return replace(fit, findings=(*swaps_by_effect(fit.findings, motion, fitted), *agreement))


def _chain_of(body: Body, settings: FitSettings) -> Chain | None:
    """Return the chain that a body was made from, or None for a whole animal."""
    if not body.one_sided:
        return None
    from recon.animal.chain import load_chain  # imported here because few clips use a chain

    return load_chain(settings.skeleton_name)


def _as_motion(inputs: ClipInputs, settings: FitSettings, chain: Chain | None, fit: _Fit) -> Motion:
    """Return the motion after a stage, without flags, findings or verdict."""
    plain = settings.plain()
    return Motion(fit.sources, inputs.side, inputs.side_reason, fit.solution, chain=chain, settings=plain)


def _judge(fit: _Fit, motion: Motion, settings: FitSettings) -> Motion:
    """Return the motion with its flags, findings, refined cameras and verdict."""
    sources, solution = fit.sources, fit.solution
    if settings.seeks_cameras or fit.options.refine_cameras:
        corrections = zip(sources, solution.extrinsic_correction, solution.focal, strict=True)
        sources = tuple(
            replace(source, camera=source.camera.corrected(correction).with_focal_scale(scale))
            for source, correction, scale in corrections
        )
    return add_verdict(replace(with_flags(motion, fit.findings), sources=sources, findings=fit.findings))


def _with_correction_gain(motion: Motion, fit: _Fit, inputs: ClipInputs) -> Motion:
    """Return the motion with the expected decrease of its error if each detection were corrected by hand."""
    gain_m2 = correction_gain_m2(fit.solution, inputs.prior, inputs.fps, fit.options)
    return replace(motion, correction_gain_m2=gain_m2)


def _log(motion: Motion) -> None:
    """Log file notes, findings and the verdict to the logger "recon"."""
    name = Path(motion.keypoints.source or "clip").name
    messages = [(logging.INFO, note) for source in motion.sources for note in source.cleaning.notes]
    for finding, text in sentences(motion):
        messages.append((logging.INFO if finding.severity == "note" else logging.WARNING, text))
    messages += [(logging.INFO, line) for line in verdict_lines(motion.verdict)]
    for level, text in messages:
        LOGGER.log(level, "%s: %s", name, text)


def _file_facts(
    inputs: ClipInputs, settings: FitSettings
) -> tuple[list[str | None], float | None, bool, tuple[Camera, ...]]:
    """Return the facts about files and settings that `input_findings` needs.

    Returns
    -------
    named : list of str or None
        For each keypoint file, another camera that its name contains, or None.
    stated_hz : float or None
        Frame rate that a file states, Hz, if it differs from the given rate.
    seeks_swaps : bool
        Whether to look for left-right swaps.
    possible : tuple of Camera
        Other cameras of the camera file that may have filmed the only keypoint file. Empty if there are several
        keypoint files, or if the file's name contains a camera.
    """
    named: list[str | None] = []
    possible: tuple[Camera, ...] = ()
    for source, path in zip(inputs.sources, settings.keypoints, strict=True):
        if settings.hfov_deg is not None:  # the camera has no name that a file's name could contradict
            named.append(None)
            continue
        cameras = () if source.moves else other_cameras(source.camera, settings)
        names = cameras_in(path.stem, [source.camera.name, *(camera.name for camera in cameras)])
        named_camera = next(iter(names), None) or other_camera_in(path.stem, source.camera.name)
        named.append(None if source.camera.name in names else named_camera)
        if len(inputs.sources) == 1 and not source.moves and not names:
            possible = possible_cameras(source.camera, settings)
    stated_hz = next((s.keypoints.stated_fps for s in inputs.sources if s.keypoints.stated_fps is not None), None)
    return named, stated_hz, not settings.fast or bool(settings.fix_swaps), possible
