"""Give the verdict on a clip: use, check or do not use, with its reason and the expected errors of pose and position.

The fit's posterior uncertainty is right on average, but does not distinguish good views from bad views. The expected
error of the pose is therefore a product of powers of quantities that distinguish them (`Evidence.factors`). The powers
are fitted by `benchmarks/uncertainty.py`. The expected error of the position follows from the posterior alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from recon.animal.prior import NONE
from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, printable
from recon.base.numbers import NORMAL_90, counted, rough_length
from recon.check.codes import EFFECTS, FAULTS, NOTE_IN_REASON, WITHOUT_FAULT, sentence
from recon.check.constants import LIMIT_OF_TRUNK
from recon.fit.constants import focal_sigma_of
from recon.fit.motion import Motion
from recon.fit.regions import radius
from recon.fit.result import ExpectedError, Finding, Level, TrajectorySolution, Verdict

POWERS = {"posterior": 0.66, "distance": 0.14, "end_on": 0.78, "unseen": 0.80, "rate": 0.32}
"""Powers of `Evidence.factors` in the expected error, fitted to recorded runs.

A later fit gave 0.67, 0.15, 0.75, 0.72 and 0.45 (`python benchmarks/uncertainty.py --only verdict`). The power of the
frame rate depends on the frame rates of the fitted clips. Its value here is from clips with half or a quarter of their
frames.
"""
RATE_HZ = 60.0
"""Frame rate below which poses are less certain than the posterior states, if the prior was learned from motions."""
SCALE = -1.30
"""Constant term in the logarithm of the pose's expected error relative to the trunk's length.

With one run left out, fits gave -1.19 to -1.38 (`python benchmarks/uncertainty.py --only verdict`).
"""
LOG_ERROR_SIGMA = 0.23
"""Standard deviation of the logarithm of the pose's error if the detections determine the whole pose.

With one run left out, fits gave 0.12 to 0.17 (`python benchmarks/uncertainty.py --only verdict`). The larger value also
holds for clips of 15 frames.
"""
SPREAD_UNSEEN = 0.45
"""Additional standard deviation of the logarithm of the pose's error if the detections determine nothing.

With one run left out, fits gave 0.44 to 0.58 (`python benchmarks/uncertainty.py --only verdict`). The value is large
because the error of a pose from the prior alone is the same in all frames, and does not average out.
"""
USUAL_FACTORS = {"posterior": -2.4, "distance": 1.9, "end_on": 0.05, "unseen": 0.0, "rate": 0.0}
"""Values of `Evidence.factors` in a typical view."""
REASON_TEXTS = {
    "posterior": "The detections leave the poses too uncertain.",
    "distance": "The animal is far away, which makes the poses uncertain.",
    "end_on": "The animal is seen from the front or the back, which hides its pose. A camera at its side would help.",
    "unseen": "Much of the animal is hardly ever detected, and its pose there is only the expected one.",
    "rate": "The frame rate is low, so the pose between the frames is hardly known.",
}
"""Reason for a verdict, with the factor that raises the expected error the most as the key."""
NO_FAULT, NO_SERIOUS_FAULT, SOME_UNCHECKED = "no_fault", "no_serious_fault", "not_all_checked"
"""Codes of the reason for the verdict "use" (`Verdict.reason_code`).

The first is for clips without notes, the second for clips with notes, and the third for clips in which some checks were
not made because the prior was not learned from motions.
"""
NOTHING_AGAINST = "No check of the clip found a fault."
"""Reason for the verdict "use" if there are no notes."""
_NOTHING_SPOILS = "No check{that_ran} found a fault that spoils the {what}"
_UNCHECKED = "frame rate, swaps, lens and zoom were not checked"
"""Clause that names the checks that need a prior learned from motions."""
NOT_ALL_CHECKED = f"No check that ran found a fault; {_UNCHECKED}."
"""Reason for the verdict "use" if there are no notes, and the prior was not learned from motions."""
_MEAN_OF_NORM = 0.92
"""Mean length of a vector with three normal components of equal variance, relative to its root mean square length."""
_MIN_M2 = 1e-8
"""Lower limit of a variance, m^2. Smaller values are rounding errors of a variance that is due to the size alone."""
_MEAN_OF_SIGMA = 0.8
"""Mean absolute deviation of a normally distributed quantity, in standard deviations."""


@dataclass(frozen=True)
class Evidence:
    """Quantities from which the expected errors of a clip are computed, as means over the frames with a pose."""

    trunk_m: float
    """Length of the trunk, m."""
    posterior_m: float
    """Mean error of the joints relative to their mean, m, expected from the posterior without the error of the size.

    The error of the size moves all joints together, and is usually smaller than stated.
    """
    misfit: float
    """Factor by which the variances of the prior are too small for the motion (misfit); 1 without a prior."""
    distance_m: float
    """Distance of the animal from the nearest camera, m."""
    end_on: float
    """Cosine of the angle between the trunk and the line of sight of the camera that sees the animal most sideways."""
    unseen: float
    """Fraction of the information on the joints that is not from the detections; 0 for the frame method."""
    position_sigma_m: float
    """Posterior standard deviation of the position, including the uncertainty of a single camera's focal length."""

    slowness: float = 1.0
    """Ratio of `RATE_HZ` to the frame rate, but at least 1; always 1 if the prior was not learned from motions."""

    @property
    def factors(self) -> dict[str, float]:
        """Return the terms of the expected error's logarithm, keyed by name and not yet multiplied by `POWERS`."""
        return {
            "posterior": math.log(self.posterior_m * math.sqrt(self.misfit) / self.trunk_m),
            "distance": math.log(self.distance_m / self.trunk_m),
            "end_on": self.end_on**8,
            "unseen": self.unseen**4,
            "rate": math.log(self.slowness),
        }


def evidence_of(motion: Motion) -> Evidence:
    """Return the quantities from which the expected errors of a motion with at least one pose are computed."""
    solution = motion.solution
    frames = _frame_evidence(motion)
    is_trajectory = isinstance(solution, TrajectorySolution)
    has_learned_prior = is_trajectory and solution.prior != NONE
    # The covariances of a trajectory already include the uncertainty of the focal length.
    focal_sigma = 0.0 if is_trajectory else focal_sigma_of(motion.settings, len(motion.sources)) or 0.0
    distance_m = float(frames.distances_m.mean(axis=1).min())
    return Evidence(
        trunk_m=float(frames.trunk_m.mean()),
        posterior_m=float(frames.posterior_m.mean()),
        misfit=max(
            (segment.prior_misfit for segment in solution.segments if segment.prior_misfit is not None), default=1.0
        ),
        distance_m=distance_m,
        end_on=float(frames.end_on.mean(axis=1).min()),
        unseen=frames.unseen,
        position_sigma_m=math.hypot(float(frames.position_sigma_m.mean()), focal_sigma * distance_m),
        slowness=max(RATE_HZ / motion.fps, 1.0) if has_learned_prior else 1.0,
    )


@dataclass(frozen=True, eq=False)
class _FrameEvidence:
    """Quantities of `Evidence` for each of the n frames with a pose and each of the V cameras."""

    trunk_m: Array
    """Length of the trunk, m, shape (n,)."""
    posterior_m: Array
    """Value of `Evidence.posterior_m` in each frame, shape (n,)."""
    position_sigma_m: Array
    """Value of `Evidence.position_sigma_m` in each frame, shape (n,)."""
    distances_m: Array
    """Distance of the animal from each camera, m, shape (V, n)."""
    end_on: Array
    """Cosine of the angle between the trunk and each camera's line of sight, shape (V, n)."""
    unseen: float


def _frame_evidence(motion: Motion) -> _FrameEvidence:
    solution, posed = motion.solution, motion.solved
    joints_m, relative = solution.joints_m[posed], solution.relative_covariance_m2[posed]
    middle_m = joints_m.mean(axis=1)
    variance, unseen = np.trace(relative, axis1=2, axis2=3), np.zeros(joints_m.shape[1])
    if isinstance(solution, TrajectorySolution):
        unseen = 1.0 - np.nan_to_num(solution.data_share, nan=1.0)
        from_middle_m = np.linalg.norm(joints_m - middle_m[:, None], axis=-1)
        variance = variance - (from_middle_m * solution.size_sigma / solution.size) ** 2
    variance = np.maximum(variance, _MIN_M2)
    middle_variance = np.trace((solution.covariance_m2[posed] - relative).mean(axis=1), axis1=1, axis2=2)
    rear, front = motion.forward
    trunk_m = joints_m[:, front] - joints_m[:, rear]
    sights_m = [middle_m - np.broadcast_to(view.centre_m, (len(posed), 3))[posed] for view in solution.views]
    return _FrameEvidence(
        trunk_m=np.linalg.norm(trunk_m, axis=-1),
        posterior_m=solution.posterior_factor * _MEAN_OF_NORM * np.sqrt(variance).mean(axis=1),
        position_sigma_m=np.sqrt(np.maximum(middle_variance, 0.0)),
        distances_m=np.array([np.linalg.norm(sight_m, axis=-1) for sight_m in sights_m]),
        end_on=np.array([np.abs(_cosine(trunk_m, sight_m)) for sight_m in sights_m]),
        unseen=float(np.average(unseen, weights=variance.mean(axis=0))),
    )


def frame_rms_m(motion: Motion) -> Array:
    """Return the expected RMS error in each frame of the joints' positions relative to their mean, (T,), m.

    The expected error of the verdict is distributed over the frames according to the posterior, the distance of the
    animal and its direction in each frame. Without an expected error, the distance follows from the posterior alone.
    """
    verdict, posed = motion.verdict, motion.solved
    if verdict is None or verdict.pose_m is None or not posed.any():
        return motion.relative_rms_m
    frames = _frame_evidence(motion)
    end_on, distance_m = frames.end_on.min(axis=0), frames.distances_m.min(axis=0)
    logarithm = POWERS["posterior"] * np.log(frames.posterior_m) + POWERS["distance"] * np.log(distance_m)
    relative = np.exp(logarithm + POWERS["end_on"] * end_on**8)
    rms_m = np.full(len(posed), np.nan)
    rms_m[posed] = verdict.pose_m.expected / _MEAN_OF_NORM * relative / relative.mean()
    return rms_m


def _cosine(a: Array, b: Array) -> Array:
    return np.sum(a * b, axis=-1) / (np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1))


def expected_pose_of_trunk(evidence: Evidence) -> ExpectedError:
    """Return the expected mean error of the joints relative to their mean, in units of the trunk's length."""
    middle = SCALE + sum(POWERS[name] * value for name, value in evidence.factors.items())
    reach = NORMAL_90 * math.hypot(LOG_ERROR_SIGMA, SPREAD_UNSEEN * evidence.unseen)
    return ExpectedError(math.exp(middle), math.exp(middle - reach), math.exp(middle + reach))


def expected_position(evidence: Evidence) -> ExpectedError:
    """Return the expected error of the animal's position, averaged over the frames, m.

    Most of the error is equal in all frames, so the average is about as large as the error in a single frame.
    """
    return ExpectedError(_MEAN_OF_SIGMA, radius(0.05), radius(0.95)).times(evidence.position_sigma_m)


def add_verdict(motion: Motion) -> Motion:
    """Return a motion with all its findings (`recon.check.rules.findings_of`) and its verdict."""
    from recon.check.rules import findings_of  # slow to import, and only a fit needs it

    motion = replace(motion, findings=findings_of(motion))
    return replace(motion, verdict=_verdict(motion))


def _verdict(motion: Motion) -> Verdict:
    if errors := [finding for finding in motion.findings if finding.severity == "error"]:
        # Expected errors do not apply to data that may belong to another animal, camera or time.
        return Verdict("do not use", _sentence_of(motion, errors[0]), reason_code=errors[0].code)
    if not motion.solved.any():
        return Verdict("do not use", "No frame has a pose.", reason_code="no_pose")
    evidence = evidence_of(motion)
    pose_effect, position_effect = (_largest_effect(motion.findings, name) for name in EFFECTS)
    pose = _widened(expected_pose_of_trunk(evidence), pose_effect, evidence.trunk_m)
    position = _widened(expected_position(evidence), position_effect)
    if not np.isfinite(pose.expected + position.expected):  # the frame method without its priors has no expected errors
        return Verdict("do not use", REASON_TEXTS["posterior"], reason_code="posterior")
    warnings = [finding for finding in motion.findings if finding.severity == "warning"]
    level = level_of(pose, error=False, warning=bool(warnings))
    # The reason is the factor that exceeds its value in a typical view the most.
    code = max(REASON_TEXTS, key=lambda name: POWERS[name] * (evidence.factors[name] - USUAL_FACTORS[name]))
    reason = REASON_TEXTS[code]
    if pose.high <= LIMIT_OF_TRUNK:
        reason, code = _nothing_against(motion, position)
    if level == "use" and (notes := [finding for finding in motion.findings if finding.code == NOTE_IN_REASON]):
        reason, code = f"Good except for this: {_sentence_of(motion, notes[0])}", notes[0].code
    warned = bool(warnings) and level != "do not use"
    if warned:
        reason, code = _sentence_of(motion, warnings[0]), warnings[0].code
    return Verdict(level, reason, pose.times(evidence.trunk_m), pose, position, warned, code)


def _nothing_against(motion: Motion, position: ExpectedError) -> tuple[str, str]:
    """Return the reason for the verdict on a motion without errors and warnings.

    The reason states the number of notes and the checks that were not made. It names a note on the animal's position,
    because the verdict "use" is about the poses.
    """
    solution = motion.solution
    are_all_checked = not (isinstance(solution, TrajectorySolution) and solution.prior == NONE)
    notes = [item.code for item in motion.findings if item.severity == "note"]
    if {*notes} <= WITHOUT_FAULT:
        return (NOTHING_AGAINST, NO_FAULT) if are_all_checked else (NOT_ALL_CHECKED, SOME_UNCHECKED)
    count = f"{counted(len(notes), 'note')} {'is' if len(notes) == 1 else 'are'} in the report"
    that_ran, unchecked = ("", "") if are_all_checked else (" that ran", f", and {_UNCHECKED}")
    beginning = _NOTHING_SPOILS.format(that_ran=that_ran, what="poses" if position.widened_by else "result")
    if position.widened_by:
        beginning += f". Positions may be off by up to {rough_length(position.high)} if {position.widened_if}"
    code = position.widened_by or (NO_SERIOUS_FAULT if are_all_checked else SOME_UNCHECKED)
    return f"{beginning}; {count}{unchecked}.", code


def reason_in_list(reason: str | None, code: str | None) -> str:
    """Return a verdict's reason for a list of clips; "" if all checks ran and none found a serious fault.

    `code` is the reason's code (`Verdict.reason_code`). Without a code, as in tables of earlier versions, the list has
    the whole reason.
    """
    return "" if not reason or code in (NO_FAULT, NO_SERIOUS_FAULT) else reason


def _largest_effect(findings: Sequence[Finding], name: str) -> tuple[float, str]:
    """Return the largest effect of the findings, m, and the finding's code; 0 and "" without an effect.

    `name` is one of `EFFECTS`.
    """
    values = ((item.numbers.get(name), item.code) for item in findings)
    return max(((v, code) for v, code in values if isinstance(v, float) and math.isfinite(v)), default=(0.0, ""))


def _widened(error: ExpectedError, effect: tuple[float, str], unit_m: float = 1.0) -> ExpectedError:
    """Return an expected error with its interval widened by the effect of a finding, which may or may not be real.

    The result names the finding if its effect is larger than the upper end of the original interval. `unit_m` is the
    length to which the error is relative, m.
    """
    size, code = effect[0] / unit_m, effect[1]
    code = code if size > error.high else ""
    return replace(error, high=math.hypot(error.high, size), widened_by=code, widened_if=FAULTS.get(code, ""))


def level_of(pose_of_trunk: ExpectedError, error: bool, warning: bool) -> Level:
    """Return the level of the verdict: use, check or do not use.

    `pose_of_trunk` is the expected error of the pose, relative to the length of the trunk. `error` and `warning` state
    whether any finding is an error, and whether any finding is a warning.
    """
    if error or pose_of_trunk.expected > LIMIT_OF_TRUNK:
        return "do not use"
    return "check" if warning or pose_of_trunk.high > LIMIT_OF_TRUNK else "use"


class _UnusableClip(Problem):
    """Problem with a clip whose verdict is "do not use". The message names the option to use the clip anyway."""

    def __str__(self) -> str:
        return printable(f"{self.file}: the verdict is {self.found}. Use --anyway to go on")


def usable(motion: Motion, folder: Path | str, anyway: bool) -> Motion:
    """Return a motion unchanged, or raise InputError if its verdict is "do not use".

    Parameters
    ----------
    motion
        Motion loaded from a results folder.
    folder
        The results folder, which the error names.
    anyway
        Whether to return the motion even if its verdict is "do not use".

    Raises
    ------
    InputError
        If the motion's verdict is "do not use", unless `anyway` is true.
    """
    verdict = motion.verdict
    if verdict is not None and verdict.level == "do not use" and not anyway:
        verdict_text = f'"do not use" ({verdict.reason.rstrip(".")})'
        raise InputError(_UnusableClip(folder, "verdict", verdict_text, "a clip with a usable result, or --anyway"))
    return motion


def verdict_fields(motion: Motion) -> dict[str, Any] | None:
    """Return the fields of a motion's verdict as plain JSON types; None for a motion without a verdict."""
    return None if motion.verdict is None else asdict(motion.verdict)


def verdict_lines(verdict: Verdict | None) -> tuple[str, ...]:
    """Return the lines that state a verdict; empty for a motion without a verdict."""
    return () if verdict is None else verdict.lines


def _sentence_of(motion: Motion, item: Finding) -> str:
    return sentence(item, named=len(motion.sources) > 1)
