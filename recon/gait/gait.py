"""Find strides, duty factors, the footfall order and the name of the gait from the stances (`recon.gait.stances`).

An animal whose four feet all stand for half a stride or more is standing still, and this time is not part of a stride.
A missed stance joins two strides into one, and a stance that is cut in two splits a stride. A stride therefore counts
only if its duration is within `MAX_DURATION_DIFFERENCE` of the median duration of all feet's strides at that time or,
if there are none, of the strides before and after. The only stride of a clip is compared with the period of the motion,
if the period is known. The stride duration is the mean over the strides that count. If no stride counts, the stride
duration is the period of the feet's motion relative to the body, provided that the clip contains enough of a period.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np

from recon.base.arrays import Bools, Brief, mean, median
from recon.base.numbers import percent
from recon.gait.series import Errors
from recon.gait.spline import MIN_POINTS
from recon.gait.stances import FEET, OVERSAMPLING, Stance, Tracks, interval_of, pose_tracks, stances, why_no_ground
from recon.io.common import Pose3D

PERIOD_OF_CLIP = (0.5, 1 / 0.6)
"""Shortest and longest period that is searched for in a clip without a complete stride, as fractions of the clip."""
PERIOD_SIGMA = 0.08
"""Relative standard deviation of the period of the motion in a clip without a complete stride."""
MIN_PERIODIC_VARIANCE = 0.9
"""Minimum fraction of the variance of the feet's motion that a periodic motion must explain to define the period."""
MAX_DURATION_DIFFERENCE = 0.2
"""Largest relative difference between a stride's duration and the median duration of the strides at that time.

A stride with a missed stance is twice as long, whereas the ends of a correct stride are wrong by at most two of about
ten frames.
"""

MAX_TOGETHER_PHASE = 0.05
"""Largest phase difference, in strides, between a left and a right foot that land together, as in a bound."""
MIN_ALTERNATE_PHASE = 0.4
"""Smallest phase difference, in strides, between a left and a right foot in a symmetrical gait (0.5 is exact)."""
IN_PHASE = 0.125
"""Largest phase difference, in strides, between two feet that move together.

These are the diagonal feet in a trot, and the feet of one side in a pace. The value is from Hildebrand (1965).
"""
MIN_RESULTANT = 0.5
"""Minimum mean resultant length (1 if equal in all strides, 0 if random) for a phase between two feet to be used."""
DUTY_MAJORITY = 2 / 3
"""Minimum fraction of the strides with a duty factor above one half in a walk, or below one half in a run."""


NO_PERIOD = "no complete stride, and too little of a stride to determine its duration"
"""Reason why the duration of a stride is unknown."""
WHOLE_CLIP = "whole clip"


class StrideWords(NamedTuple):
    """Phrases with which messages and figures describe a stride."""

    ends: str
    """Events at which the stride begins and ends."""
    title: str = "one stride of {foot}"
    """Title of a figure of the stride."""
    caption: str = "the first complete stride of the foot with the most strides, which begins at 0 %"
    """Phrase for the stride in the caption of the side view."""


STRIDE_WORDS: Mapping[str, StrideWords] = {
    "given": StrideWords("as given", "the given stride", "the given stride, which begins at 0 %"),
    "gait": StrideWords("from one touch-down, or lift-off, of the foot to the next"),
    "touchdown": StrideWords("from touch-down to touch-down"),
    "lift-off": StrideWords("from lift-off to lift-off"),
    "end effector": StrideWords(
        "between two rearmost positions of the foot",
        caption="the first stride of the end effector, which begins at 0 %",
    ),
    "return": StrideWords(
        "the clip has no complete stride: from a position of the foot to its nearest return to this position",
        "no complete stride: nearest return of {foot}",
        "the time from a position of the end effector, at 0 %, to its nearest return to this position",
    ),
    WHOLE_CLIP: StrideWords(
        "the clip has no complete stride: the whole clip",
        "whole clip: no complete stride",
        "the clip, which has no complete stride, with the times of the poses",
    ),
}
"""Phrases that describe a stride, with the kinds of strides (`Stride.origin`) as keys.

`WHOLE_CLIP` is the key for a clip without a stride.
"""


@dataclass(frozen=True)
class Stride:
    """Stride of a foot, from one touch-down to the next.

    If the clip does not contain two touch-downs of the foot, the stride lasts from one lift-off to the next. A stride
    given by the user does not belong to a foot, and its length and duty factor are NaN. `STRIDE_WORDS` describes all
    kinds of strides.
    """

    foot: str
    start_s: float
    end_s: float
    length_m: float
    """Horizontal distance that the body travels during the stride."""
    duty_factor: float
    """Fraction of the stride for which the foot is in stance, from a stance that is completely in the clip."""
    duty_sigma: float
    """Standard deviation of the duty factor."""
    at: Literal["touchdown", "lift-off", "end effector", "return", "given"]
    """Event at the beginning and the end of the stride."""
    others_s: float = np.nan
    """Expected duration of a stride that was rejected; NaN for other strides.

    The expected duration is the median duration of all feet's strides at that time, or the period of the motion.
    """

    @property
    def origin(self) -> str:
        """Return the kind of stride: "gait" if it lasts from touch-down or lift-off to the next, otherwise `at`."""
        return "gait" if self.at in ("touchdown", "lift-off") else self.at

    @property
    def duration_s(self) -> float:
        """Return the duration of the stride, s."""
        return self.end_s - self.start_s

    @property
    def frequency_hz(self) -> float:
        """Return the number of strides per second."""
        return 1.0 / self.duration_s


@dataclass(frozen=True, repr=False)
class _GaitName(Brief):
    """Name of the gait in a clip, with the phases and duty factor that decided the name."""

    name: str
    """One of walk, trot, pace, bound, half-bound, rotary gallop, transverse gallop and unknown."""
    criterion: str
    """Sentence that states which criterion decided the name."""
    phase: Mapping[str, float]
    """Phase of each foot's touch-down after the touch-down of the left hind foot, in strides, [0, 1)."""
    duty_factor: float
    """Median duty factor over the strides, robust to a stance that is cut in two; NaN without strides."""
    duty_sigma: float
    """Standard deviation of the duty factor; NaN without strides.

    Touch-down and lift-off of a foot have the same errors in all strides, so only more feet reduce the value.
    """

    @property
    def duty_interval(self) -> tuple[float, float]:
        """Return the ends of the 90 % interval of the duty factor, between 0 and 1."""
        _, low, high = interval_of(self.duty_factor, self.duty_sigma)
        return max(low, 0.0), min(high, 1.0)


@dataclass(frozen=True, eq=False, repr=False)
class Gait(Brief):
    """Stances, strides and name of the gait in a clip.

    Stride lengths and frequencies are means over complete strides, and duty factors are medians. All are NaN without
    complete strides. In this case, `ClipAnalysis.quantities` computes them from the period of the motion.
    """

    tracks: Tracks
    stances: tuple[Stance, ...]
    strides: tuple[Stride, ...]
    order: tuple[str, ...]
    """Feet in the order of their touch-downs in the clip."""
    stride_length_m: float
    stride_frequency_hz: float
    stride_s: float
    """Duration of a stride, from complete strides or from the period of the motion, s; NaN if neither is known."""
    stride_sigma_s: float
    """Standard deviation of `stride_s`, s."""
    duty_factor: Mapping[str, float]
    speed_m_s: float
    name: _GaitName
    rejected_strides: tuple[Stride, ...] = ()
    """Strides that were left out of `strides` because their durations contradict the other feet's."""

    def stride_time(self, start_s: float, end_s: float) -> tuple[float, float]:
        """Return the mean duration of the strides around a time interval, s, and its standard deviation, s.

        If no complete stride is near, return the values of the whole clip.
        """
        near = [stride for stride in self.strides if stride.start_s < end_s and stride.end_s > start_s]
        return _mean_time(near, 1) if near else (self.stride_s, self.stride_sigma_s)


def match_stances(first_set: Sequence[Stance], second_set: Sequence[Stance]) -> list[tuple[Stance, Stance]]:
    """Return the pairs of stances of the same foot, one from each set, that overlap each other more than any other."""

    def best_match(stance: Stance, candidates: Sequence[Stance]) -> Stance | None:
        overlaps = [(min(stance.end_s, o.end_s) - max(stance.start_s, o.start_s), -i) for i, o in enumerate(candidates)]
        same_foot = [pair for pair in overlaps if pair[0] > 0 and candidates[-pair[1]].foot == stance.foot]
        return candidates[-max(same_foot)[1]] if same_foot else None

    best_pairs = [(a, b) for a in first_set if (b := best_match(a, second_set)) is not None]
    return [(a, b) for a, b in best_pairs if best_match(b, first_set) is a]


def gait(tracks: Tracks) -> Gait:
    """Return the stances, strides and name of the gait of an animal with the given motion of its feet."""
    all_stances = stances(tracks)
    all_strides = strides(tracks, all_stances)
    counted, rejected = _counted(all_strides, pose_period_s(tracks) if len(all_strides) == 1 else np.nan)
    lengths, durations = [s.length_m for s in counted], [s.duration_s for s in counted]
    duration_s, sigma_s = _stride_time(tracks, counted)
    touch_downs = sorted((s for s in all_stances if s.begins), key=lambda s: s.start_s)
    why_unknown = why_no_ground(tracks)
    if why_unknown is None and not {*FEET} <= {*tracks.feet}:
        why_unknown = f"only gaits of four feet have names; the feet here are {', '.join(tracks.feet)}"
    return Gait(
        tracks=tracks,
        stances=all_stances,
        strides=counted,
        order=tuple(s.foot for s in touch_downs),
        stride_length_m=mean(lengths),
        stride_frequency_hz=1.0 / mean(durations) if durations else np.nan,
        stride_s=duration_s,
        stride_sigma_s=sigma_s,
        duty_factor={foot: median([s.duty_factor for s in counted if s.foot == foot]) for foot in tracks.feet},
        speed_m_s=mean(tracks.body_speed_m_s),
        name=name_gait(all_stances, counted, duration_s, why_unknown),
        rejected_strides=rejected,
    )


def pose_gait(pose: Pose3D, fps: float, errors: Sequence[Errors] = (), **options) -> Gait:
    """Return the stances, strides and name of the gait of a moving animal from the positions of its joints.

    `errors` are the independent errors of the positions, each (T, J, 3), metres. `options` are passed to `pose_tracks`.

    Raises
    ------
    InputError
        If the pose lacks joints. The error names all missing joints.
    ValueError
        If there are fewer than `MIN_POINTS` frames.
    """
    return gait(pose_tracks(pose, fps, errors, **options))


def strides(tracks: Tracks, all_stances: tuple[Stance, ...]) -> tuple[Stride, ...]:
    """Return the strides whose two touch-downs and stance are all in the clip.

    For a foot without two touch-downs, strides last from one lift-off to the next. Strides with a gap in the foot's
    track, or with all feet in stance for half of the time or longer, are left out.
    """
    result, all_stand = [], _all_stand(tracks, all_stances)
    for foot in tracks.feet:
        foot_stances = [s for s in all_stances if s.foot == foot]
        landings = [(a.start_s, b.start_s, a) for a, b in pairwise(foot_stances) if a.begins and a.ends and b.begins]
        liftings = [(a.end_s, b.end_s, b) for a, b in pairwise(foot_stances) if a.ends and b.begins and b.ends]
        event: Literal["touchdown", "lift-off"] = "touchdown" if landings else "lift-off"
        for start, end, stance in landings or liftings:
            a, b = np.searchsorted(tracks.time_s, [start, end])
            # A gap in the track of a foot or of the body may hide a stance.
            step = np.diff(tracks.body_m[a : b + 1, :2], axis=0)
            is_lost = not np.isfinite(step).all() or np.isnan(tracks.foot_m[a : b + 1, tracks.feet.index(foot)]).any()
            if not is_lost and all_stand[a : b + 1].mean() < 0.5:
                length = float(np.linalg.norm(step, axis=1).sum())
                sigma_s = float(np.hypot(stance.start_sigma_s, stance.end_sigma_s))
                duty, sigma = (seconds / (end - start) for seconds in (stance.duration_s, sigma_s))
                result.append(Stride(foot, start, end, length, duty, sigma, event))
    return tuple(sorted(result, key=lambda s: (s.start_s, s.foot)))


def _all_stand(tracks: Tracks, all_stances: Sequence[Stance]) -> Bools:
    """Return a mask (N,) of the times at which all feet of an animal with at least four feet are in stance."""
    stands = np.zeros((len(tracks.time_s), len(tracks.feet)), dtype=bool)
    for stance in all_stances:
        first, stop = np.searchsorted(tracks.time_s, [stance.start_s, stance.end_s])
        stands[first:stop, tracks.feet.index(stance.foot)] = True
    return np.asarray(stands.all(axis=1) & (len(tracks.feet) >= 4))


def _counted(all_strides: tuple[Stride, ...], period_s: float) -> tuple[tuple[Stride, ...], tuple[Stride, ...]]:
    """Split strides, sorted by start time, into strides with a plausible duration and rejected strides.

    The only stride of a clip is compared with the period of the motion, `period_s`, unless the period is NaN.
    """
    counted, rejected = [], []
    start_s, end_s, duration_s = (
        np.array([getattr(s, field) for s in all_strides]) for field in ("start_s", "end_s", "duration_s")
    )
    for stride in all_strides:
        # A long clip has thousands of strides, so only nearby strides are examined.
        longest_s = duration_s.max()
        nearby = slice(*np.searchsorted(start_s, [stride.start_s - 2 * longest_s, stride.end_s + longest_s]))
        overlapping = (start_s[nearby] < stride.end_s) & (end_s[nearby] > stride.start_s)
        others_s = median(duration_s[nearby][overlapping] if overlapping.sum() > 1 else duration_s[nearby])
        others_s = others_s if np.isnan(period_s) else period_s
        if abs(others_s * stride.frequency_hz - 1) <= MAX_DURATION_DIFFERENCE:
            counted.append(stride)
        else:
            rejected.append(replace(stride, others_s=others_s))
    return tuple(counted), tuple(rejected)


def rejection_text(stride: Stride) -> str:
    """Return a sentence that states why a stride was rejected."""
    text = f"{stride.foot}'s stride from {stride.start_s:.3f} to {stride.end_s:.3f} s does not count"
    return f"{text}, because the motion around it repeats after {stride.others_s:.3f} s"


def _stride_time(tracks: Tracks, counted: Sequence[Stride]) -> tuple[float, float]:
    """Return the mean stride duration, s, and its standard deviation, s.

    Without strides, return the period of the motion and its standard deviation, or NaN if the period is unknown.
    """
    if counted:
        return _mean_time(counted, len(counted))
    period = pose_period_s(tracks)
    return period, period * PERIOD_SIGMA


def _mean_time(counted: Sequence[Stride], count: int) -> tuple[float, float]:
    """Return the mean duration of strides (s) and its standard deviation (s) for `count` independent durations."""
    durations_s = np.array([stride.duration_s for stride in counted])
    event_sigmas_s = np.array([stride.duty_sigma for stride in counted]) * durations_s
    return float(durations_s.mean()), float(np.hypot(durations_s.std() / count**0.5, np.median(event_sigmas_s)))


def pose_period_s(tracks: Tracks) -> float:
    """Return the stride duration of a clip without a complete stride, s; NaN if unknown.

    The duration is the period whose first two harmonics fit the feet's positions relative to the body best, with a weak
    prior on both harmonics.
    """
    values = (tracks.foot_m - tracks.body_m[:, None])[::OVERSAMPLING].reshape(-1, 3 * len(tracks.feet))
    is_known = np.isfinite(values).all(axis=1)
    time, values = tracks.time_s[::OVERSAMPLING][is_known], values[is_known]
    if len(time) < MIN_POINTS + 5:
        return np.nan
    periods = np.linspace(*PERIOD_OF_CLIP, 100) * (time[-1] - time[0])
    phase = 2 * np.pi / periods[:, None] * (time - time.mean())
    waves = np.stack([np.ones_like(phase), *(wave(n * phase) for n in (1, 2) for wave in (np.cos, np.sin))], axis=-1)
    moment = np.einsum("pta,tf->paf", waves, values)
    prior = 1e-3 * len(time) * np.diag([0, 1, 1, 4, 4])
    amplitudes = np.linalg.solve(np.einsum("pta,ptb->pab", waves, waves) + prior, moment)
    residuals = np.sum(values**2) - np.einsum("paf,paf->p", moment, amplitudes)
    best = int(residuals.argmin())
    explained = residuals[best] < (1 - MIN_PERIODIC_VARIANCE) * len(time) * values.var(axis=0).sum()
    return float(periods[best]) if explained and 0 < best < len(periods) - 1 else np.nan


def name_gait(
    all_stances: tuple[Stance, ...], counted: tuple[Stride, ...], stride_s: float, why_unknown: str | None = None
) -> _GaitName:
    """Return the name of the gait, derived from the phases of the four feet (`classify`).

    `stride_s` is the duration of a stride, s, NaN if unknown. `why_unknown` is the reason if the gait is already known
    to have no name.
    """
    duties = np.array([s.duty_factor for s in counted])
    feet = len({s.foot for s in counted})
    duty = median(duties), float(np.sqrt(mean([s.duty_sigma**2 for s in counted]) / feet)) if feet else np.nan
    if why_unknown is None and (lacking := [foot for foot in FEET if not any(s.foot == foot for s in all_stances)]):
        why_unknown = f"no stance of {', '.join(lacking)}"
    if why_unknown is None and np.isnan(stride_s):
        why_unknown = NO_PERIOD
    if why_unknown is not None:
        return _GaitName("unknown", why_unknown, dict.fromkeys(FEET, np.nan), *duty)
    period = float(np.median([s.duration_s for s in counted])) if counted else stride_s
    phase = {"LH": 0.0} | {foot: _lag(all_stances, "LH", foot, period) for foot in ("RH", "LF", "RF")}
    # If LH and the foot have no events near each other, their phase is computed from their phases relative to RH.
    for foot in ("LF", "RF"):
        if np.isnan(phase[foot]):
            phase[foot] = (phase["RH"] + _lag(all_stances, "RH", foot, period)) % 1.0
    name, criterion = classify(phase, duty[0])
    if not counted:
        criterion = f"no complete stride, but the motion has a period of {period:.2f} s: {criterion}"
        # A stance that the clip cuts lasts longer than the part in the clip. In a walk, the order of the feet is then
        # too uncertain.
        longest_s = [max(s.duration_s for s in all_stances if s.foot == foot) for foot in FEET]
        if name != "unknown" and median(longest_s) > 0.5 * period:
            name, criterion = "unknown", f"{criterion}; but the feet are in stance for more than half of the period"
    if (
        name in ("walk", "trot", "pace")
        and 1 - DUTY_MAJORITY < (fraction := float(np.mean(duties > 0.5))) < DUTY_MAJORITY
    ):
        criterion += f"; above 0.5 in {percent(fraction)} of strides: undecided between walk and run"
        name = "unknown"
    return _GaitName(name, criterion, phase, *duty)


def _lag(all_stances: tuple[Stance, ...], reference: str, foot: str, period_s: float) -> float:
    """Return the mean phase of a foot's touch-downs relative to the reference foot's, in strides, [0, 1).

    Each touch-down is compared with the nearest touch-down of the reference foot. If one of the feet has no touch-down
    in the clip, lift-offs are used instead. Return NaN if there are no lift-offs either, or if the mean resultant
    length of the phases is below `MIN_RESULTANT`.
    """
    for is_known, event in (("begins", "start_s"), ("ends", "end_s")):
        reference_s, foot_s = (
            np.array([getattr(s, event) for s in all_stances if s.foot == label and getattr(s, is_known)])
            for label in (reference, foot)
        )
        if len(reference_s) and len(foot_s):
            lags_s = foot_s - reference_s[np.argmin(np.abs(foot_s[:, None] - reference_s), axis=1)]
            # Only events within a stride, or else the nearest ones, are compared, because the phase may drift.
            nearby_s = lags_s[np.abs(lags_s) <= max(period_s, np.abs(lags_s).min())]
            resultant = np.mean(np.exp(2j * np.pi * nearby_s / period_s))
            return float(np.angle(resultant) / (2 * np.pi) % 1.0) if np.abs(resultant) >= MIN_RESULTANT else np.nan
    return np.nan


def classify(phase: Mapping[str, float], duty_factor: float) -> tuple[str, str]:
    """Return the name of a gait and the criterion that decided it.

    In symmetrical gaits both pairs are at least 0.4 apart. The gait is a walk if the duty factor is over 0.5. Otherwise
    it is a trot or a pace if the fore feet land within 0.125 of the diagonal or of the same-sided hind foot. In
    asymmetrical gaits both pairs are less than 0.4 apart. The gait is a bound if both pairs land within 0.05, and a
    half-bound if only the hind pair does. Otherwise it is a gallop, unless the duty factor is over 0.5. A gallop is
    transverse if the same side leads (lands second) in both pairs, otherwise rotary.

    Parameters
    ----------
    phase : mapping
        Phase of the touch-downs of LH, RH, LF and RF, in strides.
    duty_factor : float
        Fraction of a stride for which a foot is in stance.

    References
    ----------
    Hildebrand, M. (1965). Science 150:701. Hildebrand, M. (1977). BioScience 27:766.
    """
    if any(np.isnan(phase[foot]) for foot in FEET):
        lacking = ", ".join(foot for foot in FEET if np.isnan(phase[foot]))
        return "unknown", f"no steady phase of {lacking} over the strides"
    hind, fore = _signed(phase["RH"] - phase["LH"]), _signed(phase["RF"] - phase["LF"])
    measured = f"hind feet {abs(hind):.2f} of a stride apart, {_first(hind)}; fore feet {abs(fore):.2f}, {_first(fore)}"
    if min(abs(hind), abs(fore)) >= MIN_ALTERNATE_PHASE:
        sides = np.exp(2j * np.pi * np.array([phase["LF"] - phase["LH"], phase["RF"] - phase["RH"]]))
        lateral = float(np.angle(sides.mean()) / (2 * np.pi) % 1.0)
        measured += f"; fore {lateral:.2f} after the same-sided hind foot, duty factor {duty_factor:.2f}"
        if np.isnan(duty_factor):
            return "unknown", measured + ": undecided between walk and run"
        if duty_factor > 0.5:
            return "walk", measured
        if abs(_signed(lateral - 0.5)) <= IN_PHASE:
            return "trot", measured
        return (
            ("pace", measured)
            if abs(_signed(lateral)) <= IN_PHASE
            else ("unknown", measured + ": between trot and pace")
        )
    if max(abs(hind), abs(fore)) >= MIN_ALTERNATE_PHASE:
        return "unknown", measured + ": one pair alternates, the other does not"
    if abs(hind) < MAX_TOGETHER_PHASE:
        return ("bound" if abs(fore) < MAX_TOGETHER_PHASE else "half-bound"), measured
    if abs(fore) < MAX_TOGETHER_PHASE:
        return "unknown", measured + ": the fore pair lands together, the hind pair does not"
    leads = ["right" if lag > 0 else "left" for lag in (hind, fore)]
    measured += f"; leading: {leads[0]} hind, {leads[1]} fore"
    if duty_factor > 0.5:
        measured += f"; but the feet are in stance for {percent(duty_factor)} of the stride, longer than in a gallop"
        return "unknown", measured
    return f"{'transverse' if leads[0] == leads[1] else 'rotary'} gallop", measured


def _first(lag: float) -> str:
    """Return words that state which foot of a pair lands first, given the right foot's lag behind the left, strides."""
    return "left first" if lag > 0 else "right first"


def _signed(phase: float) -> float:
    """Return a phase, in strides, shifted by whole strides into [-0.5, 0.5)."""
    return (phase + 0.5) % 1.0 - 0.5
