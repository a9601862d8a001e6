"""Detect left-right swaps in single frames, parts of a clip or a whole clip, of all keypoints or of one pair of legs.

A fit follows exchanged keypoints, so its residuals do not reveal a swap. Candidate stretches of frames are first found
by two cheap signs. First, the keypoints of both sides jump at the same time at the beginning and the end of a swap,
unless the legs cross there. Second, what two or more other cameras see shows which side is more likely in each frame.
Where there are no such cameras, a fit in which each keypoint of a leg may belong to either side shows it. Stretches are
left out if two or more other cameras confirm the sides as given. Swaps that the other cameras clearly show need none of
this and are undone before (`recon.check.swaps_between`).

The sides are then exchanged in each of the most likely stretches, and one second of the clip around the stretch is
solved again. A stretch is a swap if the clip becomes clearly more likely (`exceeds_margin`), also compared with
exchanging the sides in any contradicting stretch. If two contradicting stretches are about equally likely, neither is
chosen.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from recon.animal.body import Body, opposites
from recon.base.arrays import Array, Bools, Index
from recon.check import likelihood
from recon.check.codes import finding
from recon.check.likelihood import Baseline, Refit
from recon.clip import Keypoints, Source, View
from recon.fit.result import Finding

MIN_JUMP_GAIN = -3.0
"""Log-likelihood gain of a jump above which a swap may begin or end, negative because crossing legs hardly jump."""
MIN_TRIED_GAIN = 15.0
"""Log-likelihood gain, from jumps of the tracks and from appearance, above which a possible swap is tested by a fit."""
MAX_REFITS = 3
"""Maximum number of stretches that are tried by a fit in each round of the search."""
MAX_SWAPS = 4
"""Maximum number of swaps that are searched for in a clip."""
MIN_APPEARANCE_GAIN = -10.0
"""Log-likelihood gain from appearance above which a swap of the whole clip is tried by a fit.

The user is asked to look at the video in two cases, because nothing else shows a mirrored video. In one, the clip is
more likely with the sides exchanged, but the gain is too small to report a swap. In the other, only the gain from
appearance suggests a swap (`MIN_TRIED_GAIN`).
"""
MIN_DURATION_S = 0.25
"""Minimum duration of a clip in which a swap of the whole clip is tested, seconds.

The value is less than a stride. The clip must also show a leg.
"""
OF_LEG = 3
"""Number of markers, from the end of a leg on, that show its side. The upper markers hardly show it."""
_STRAIGHT = 3
"""Number of frames before and after an end of a swap in which the tracks are assumed to be straight."""
_LEAST_OFF_PX = 3.0
"""Lower bound of the usual deviation of tracks from a line, pixels."""
MAX_TRACK_DEVIATION = 1.0
"""Largest usual deviation of tracks from a line, relative to the distance between the sides, at which they are used."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """Stretch of frames with a possible left-right swap, and the permutation (J,) of the markers that undoes it."""

    rows: slice
    permutation: Index

    @property
    def markers(self) -> tuple[int, ...]:
        """Return the indices of the exchanged markers."""
        return tuple(int(j) for j in np.flatnonzero(self.permutation != np.arange(len(self.permutation))))

    def mask(self, T: int) -> Bools:
        """Return a mask of the exchanged markers in each frame, (T, J)."""
        is_exchanged = np.zeros((T, len(self.permutation)), dtype=bool)
        is_exchanged[self.rows, self.markers] = True
        return is_exchanged


def with_exchanged(view: View, stretch: Stretch) -> View:
    """Return the view with left and right keypoints swapped in a stretch of frames."""
    return replace(view, **exchanged_rows(view, stretch.rows, stretch.permutation))


def exchanged_rows(seen: View | Keypoints, rows: slice, permutation: Index) -> dict[str, Array]:
    """Return the fields of the detections, with the keypoints in some frames permuted by `permutation` (J,)."""
    values = {"xy_px": seen.xy_px.copy(), "confidence": seen.confidence.copy()}
    for array in values.values():
        array[rows] = array[rows][:, permutation]
    return values


def with_exchanged_names(seen: View | Keypoints, rows: slice, names: Sequence[str], body: Body) -> dict[str, Array]:
    """Return the fields of the detections, with some markers of a body and their counterparts swapped in some frames.

    `names` are the markers of both sides.
    """
    opposite, is_named = opposites(body.markers), np.isin(body.markers, names)
    return exchanged_rows(seen, rows, np.where(is_named, opposite, np.arange(len(opposite))))


def pairs_of(body: Body) -> dict[str, Index]:
    """Return the permutations (J,) that swap the left and right markers.

    The keys are "all" for all markers, and "fore" and "hind" for one pair of legs.
    """
    permutation, none = opposites(body.markers), np.arange(len(body.markers))
    kinds = {"all": permutation}
    for name, end in (("fore", "F"), ("hind", "H")):
        feet = {foot for foot, label in zip(body.feet, body.foot_labels, strict=True) if label.endswith(end)}
        legs = {marker for limb in body.limbs.values() if {*limb} & feet for marker in limb[-OF_LEG:]}
        kinds[name] = np.where([marker in legs for marker in body.markers], permutation, none)
    return {name: permutation for name, permutation in kinds.items() if (permutation != none).any()}


def swaps(baseline: Baseline, is_unlike: bool = False) -> list[_SwapTrial]:
    """Return the left-right swaps in the view of a baseline, whose prior was learned from motions.

    The search ends at the first swap that is not clear. If `is_unlike` is true, the motion is unlike the prior's
    motions. A swap of the whole clip is then not tried, because only the prior could show it.
    """
    kinds, found_swaps = pairs_of(baseline.clip.body), list[_SwapTrial]()
    while len(found_swaps) < MAX_SWAPS and "all" in kinds:
        trials = sorted(
            (try_undone(baseline, trial) for trial in propose_stretches(baseline, kinds, is_unlike)),
            key=lambda trial: -trial.ratio,
        )
        if not trials or not likelihood.exceeds_margin(trials[0].ratio):
            T = len(baseline.states)
            for trial in (trial for trial in trials if trial.stretch.rows == slice(0, T) and not found_swaps):
                if trial.ratio > 0 or _appearance_gain(baseline, kinds) > MIN_TRIED_GAIN:
                    found_swaps.append(replace(trial, clear=False))
            break
        best, *other_trials = trials
        undone_baseline = with_undone(baseline, best)
        rival = next((trial for trial in other_trials if contradicts(undone_baseline, best, trial)), None)
        clear = rival is None or likelihood.exceeds_margin(best.ratio - rival.ratio, surely=True)
        found_swaps.append(replace(best, clear=clear))
        if not clear:
            break
        baseline = undone_baseline
    return found_swaps


@dataclass(frozen=True, eq=False)
class Swap:
    """Likely left-right swap of a view: its stretch of frames, and the log-likelihood gain from undoing it."""

    stretch: Stretch
    ratio: float
    clear: bool = True
    """Whether no contradicting swap is about as likely."""


@dataclass(frozen=True, eq=False)
class _SwapTrial(Swap):
    """Left-right swap that was tested by a fit, with the solution after undoing it."""

    refit: Refit = field(kw_only=True)


def contradicts(undone_baseline: Baseline, best: _SwapTrial, rival: _SwapTrial) -> bool:
    """Return whether a left-right swap in other frames explains the detections instead of the most likely swap.

    The rival swap must increase the likelihood. It contradicts the best swap if it adjoins or overlaps this swap, or if
    it no longer clearly increases the likelihood once the best swap is undone. A rival with nearly the same frames and
    keypoints as the best swap does not contradict it.
    """
    (a, best_mask), (b, rival_mask) = (
        (trial.stretch.rows, trial.stretch.mask(len(undone_baseline.states))) for trial in (best, rival)
    )
    overlap = best_mask & rival_mask
    if not (rival_mask & ~best_mask).any() or 2 * overlap.sum() >= (best_mask | rival_mask).sum() or rival.ratio <= 0:
        return False
    is_adjacent = a.start <= b.stop and b.start <= a.stop and {*best.stretch.markers} & {*rival.stretch.markers}
    return bool(is_adjacent) or not likelihood.exceeds_margin(try_undone(undone_baseline, rival.stretch).ratio)


def try_undone(baseline: Baseline, stretch: Stretch) -> _SwapTrial:
    """Swap left and right in a stretch, and solve the second of the clip around the stretch again."""
    part = _part(baseline.view, stretch.rows, baseline.clip.fps)
    refit = likelihood.refit_view(baseline.with_view(with_exchanged(baseline.view, stretch)).part(part))
    return _SwapTrial(stretch, refit.gain_over(baseline.refit(part)), refit=refit)


def with_undone(baseline: Baseline, trial: _SwapTrial) -> Baseline:
    """Return the baseline after undoing a left-right swap, with the motion that was fitted to the result."""
    states = baseline.states.copy()
    states[_part(baseline.view, trial.stretch.rows, baseline.clip.fps)] = trial.refit.states
    clip = baseline.with_view(with_exchanged(baseline.view, trial.stretch))
    return Baseline(clip, states, baseline.is_only, baseline.predicted)


def propose_stretches(baseline: Baseline, kinds: dict[str, Index], is_unlike: bool) -> list[Stretch]:
    """Return the stretches for which the jumps of tracks and the appearance give the most evidence of a swap."""
    if not np.isfinite(baseline.states).any():
        return []
    T, evidence = len(baseline.states), _evidence(baseline, kinds)
    suspects = [
        suspect
        for name, permutation in kinds.items()
        for suspect in _suspects(jumps(baseline.view, permutation), evidence[name], name)
    ]
    whole = float(evidence["all"].sum())
    suspects = sorted(suspects, reverse=True)[:MAX_REFITS]
    can_tell_whole = T / baseline.clip.fps > MIN_DURATION_S and evidence["all"].any() and not is_unlike
    if can_tell_whole and whole > MIN_APPEARANCE_GAIN:
        suspects.append((whole, "all", (0, T)))
    chosen = [(name, rows) for _, name, ends in suspects for rows in _parts(*ends, T)]
    stretches = [Stretch(slice(*ends), kinds[name]) for name, ends in dict.fromkeys(chosen)]
    return [stretch for stretch in stretches if not is_refuted(baseline, stretch)]


def is_refuted(baseline: Baseline, stretch: Stretch) -> bool:
    """Return whether other cameras show that left and right are not swapped in a stretch of a view."""
    gains = np.nan_to_num(gains_elsewhere(baseline, stretch.permutation))
    return likelihood.exceeds_margin(-float(gains[stretch.rows][:, stretch.markers].sum()))


def gains_elsewhere(baseline: Baseline, permutation: Index) -> Array:
    """Return each keypoint's log-likelihood gain from a permutation (J,), given the other cameras, shape (T, J).

    The gain is NaN if the other cameras do not predict both the keypoint and its counterpart within the noise of a
    detection (`predicted_by_others`).
    """
    view, clip = baseline.view, baseline.clip
    if baseline.predicted is None:
        return np.full(view.present.shape, np.nan)
    predicted_px, predicted_sigma_px = baseline.predicted
    (noise_px,) = clip.noise_px(clip.markers(baseline.states), np.ones((1, len(permutation))))
    noise_px, other_px = likelihood.LOOSE_NOISE_FACTOR * noise_px, predicted_px[:, permutation]
    sigma_px = np.maximum(predicted_sigma_px, predicted_sigma_px[:, permutation])
    residuals = [(points - view.xy_px) / np.hypot(noise_px, sigma_px)[..., None] for points in (predicted_px, other_px)]
    given_cost, exchanged_cost = map(likelihood.log_tail, residuals)
    is_finite = np.isfinite(residuals).all(axis=(0, -1))
    return np.where(is_finite & (sigma_px < noise_px), given_cost - exchanged_cost, np.nan)


def _parts(first: int, stop: int, T: int) -> list[tuple[int, int]]:
    """Return the stretches that may be swapped if there is a swap in the frames from `first` up to `stop` of T.

    If the frames reach an end of the clip, the rest of the clip may be swapped instead.
    """
    remainders = [] if stop - first == T else [(stop, T)] if first == 0 else [(0, first)] if stop == T else []
    return [(first, stop), *remainders]


def _part(view: View, rows: slice, fps: float) -> slice:
    """Return the slice of the second around a stretch, or around an end of a longer stretch.

    For a stretch that is the whole clip, return the second with the most detections.
    """
    T, n = len(view.xy_px), max(round(likelihood.TESTED_S * fps), 4)
    inner = [edge for edge in (rows.start, rows.stop) if 0 < edge < T]
    if not inner:
        return likelihood.best_seen(view, fps)
    middle = sum(inner) // 2 if inner[-1] - inner[0] < n else inner[0]
    first = int(np.clip(middle - n // 2, 0, max(T - n, 0)))
    return slice(first, min(first + n, T))


def _suspects(jump: Array, evidence: Array, name: str) -> list[tuple[float, str, tuple[int, int]]]:
    """Return the ranges of frames in which left and right are most likely swapped, the most likely first.

    Ranges that largely overlap a more likely range are left out. Each range is a tuple of the log-likelihood gain, the
    kind of swap `name`, and a pair of the first frame and the frame after the last.
    """
    T = len(jump)
    ends = np.concatenate([[0], 1 + np.flatnonzero(jump[1:] > MIN_JUMP_GAIN), [T]])
    gain = np.concatenate([[0.0], jump[ends[1:-1]], [0.0]])
    sums = np.concatenate([[0.0], np.cumsum(evidence)])[ends]
    # The gain of a stretch from end a to end b, its evidence plus the jumps at both ends, is high[b] - low[a].
    low, high = sums - gain, sums + gain
    best_ahead, best_behind = np.full(len(ends), -np.inf), np.full(len(ends), np.inf)
    best_ahead[:-1], best_behind[1:] = np.maximum.accumulate(high[:0:-1])[::-1], np.minimum.accumulate(low[:-1])
    # Only ends that can bound a likely stretch are kept, because a long clip has too many pairs of ends.
    is_candidate = (best_ahead - low > MIN_TRIED_GAIN) | (high - best_behind > MIN_TRIED_GAIN)
    ends, low, high = ends[is_candidate], low[is_candidate], high[is_candidate]
    first, stop = ends[:, None], ends[None]
    score = np.where((stop > first) & (stop - first < T), high[None] - low[:, None], -np.inf)
    suspects: list[tuple[float, str, tuple[int, int]]] = []
    while len(suspects) < MAX_REFITS and score.max(initial=-np.inf) > MIN_TRIED_GAIN:
        a, b = np.unravel_index(np.argmax(score), score.shape)
        suspects.append((float(score[a, b]), name, (int(ends[a]), int(ends[b]))))
        overlap = np.minimum(stop, ends[b]) - np.maximum(first, ends[a])
        score[2 * overlap >= np.maximum(stop, ends[b]) - np.minimum(first, ends[a])] = -np.inf
    return suspects


def _evidence(baseline: Baseline, kinds: dict[str, Index]) -> dict[str, Array]:
    """Return each frame's log-likelihood gain from swapping left and right, (T,), keyed by the kind of swap.

    The gain of the kind "all" is computed from all legs. If the other cameras do not predict any leg in some frames in
    which the view sees legs, gains that are not known from these cameras are those of `_gains_of_fit`.
    """
    legs, in_legs, permutation = _of_legs(kinds)
    gains = gains_elsewhere(baseline, permutation)
    is_open = baseline.view.present[:, in_legs].any(axis=1) & np.isnan(gains[:, in_legs]).all(axis=1)
    if is_open.any():
        gains = np.where(np.isnan(gains), _gains_of_fit(baseline, permutation, in_legs), gains)
    gains = np.where(np.isfinite(baseline.states[:, :1]), np.nan_to_num(gains), 0.0)
    return {name: gains[:, markers].sum(axis=1) for name, markers in (legs | {"all": in_legs}).items()}


def _of_legs(kinds: dict[str, Index]) -> tuple[dict[str, Bools], Bools, Index]:
    """Return the masks (J,) of the legs of each kind but "all", the mask of all legs, and their permutation (J,)."""
    legs = {name: permutation != np.arange(len(permutation)) for name, permutation in kinds.items() if name != "all"}
    in_legs = np.any([np.zeros(len(kinds["all"]), dtype=bool), *legs.values()], axis=0)
    return legs, in_legs, np.where(in_legs, kinds["all"], np.arange(len(in_legs)))


def _appearance_gain(baseline: Baseline, kinds: dict[str, Index]) -> float:
    """Return the log-likelihood gain from swapping left and right in the whole clip, without the other cameras."""
    _, in_legs, permutation = _of_legs(kinds)
    gains = _gains_of_fit(baseline, permutation, in_legs)[:, in_legs]
    return float(gains[np.isfinite(baseline.states[:, 0])].sum())


def _gains_of_fit(baseline: Baseline, permutation: Index, in_legs: Bools) -> Array:
    """Return each keypoint's log-likelihood gain (T, J) from a permutation (J,) that exchanges the legs, a mask (J,).

    The gains are those of a fit in which each keypoint of a leg may be on either side.
    """
    seen = baseline.view.xy_px
    projected, sigma_px = likelihood.project_either_side(
        baseline, with_exchanged(baseline.view, Stretch(slice(None), permutation)), in_legs
    )
    given_cost, exchanged_cost = (
        likelihood.log_tail((points - seen) / sigma_px[..., None]) for points in (projected, projected[:, permutation])
    )
    return given_cost - exchanged_cost


def jumps(view: View, permutation: Index) -> Array:
    """Return the log-likelihood gain of the tracks if left and right are swapped from each frame on, shape (T,).

    The difference between the left and the right point of a pair is assumed to change linearly for a few frames. The
    gain is minus infinity if one of these frames has no detection, or if the tracks deviate from lines by about the
    distance between the sides.
    """
    n, pairs = 2 * _STRAIGHT, [(j, int(k)) for j, k in enumerate(permutation) if j < k]
    differences = view.xy_px[:, [j for j, _ in pairs]] - view.xy_px[:, [k for _, k in pairs]]
    gain = np.full(len(differences), -np.inf)
    if len(differences) < n:
        return gain
    line = np.vander(np.arange(n), 2)
    off_line = np.eye(n) - line @ np.linalg.pinv(line)
    flip = np.where(np.arange(n) < _STRAIGHT, -1.0, 1.0)
    windows = np.lib.stride_tricks.sliding_window_view(differences, n, axis=0)  # (N, P, 2, n)
    given_squares, exchanged_squares = (
        np.sum((windows @ by) * windows, axis=(2, 3)) for by in (off_line, flip[:, None] * off_line * flip)
    )
    is_known, freedom = np.isfinite(given_squares), 2 * (n - 2)
    with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore"):  # a pair may never be seen
        square_px = np.nanmedian(np.where(is_known, given_squares, np.nan), axis=0) / freedom
        side_square_px = np.nanmedian(np.sum(differences**2, axis=-1), axis=0)
    is_seen = np.lib.stride_tricks.sliding_window_view(view.present.any(axis=1), n).all(axis=1)
    is_steady = square_px < (MAX_TRACK_DEVIATION**2) * side_square_px
    scale = likelihood.STUDENT_T_DEGREES * np.maximum(np.nan_to_num(square_px), _LEAST_OFF_PX**2)
    gains = np.log1p(np.where(is_known, given_squares, 0.0) / scale) - np.log1p(
        np.where(is_known, exchanged_squares, 0.0) / scale
    )
    evidence = 0.5 * (likelihood.STUDENT_T_DEGREES + freedom) * gains.sum(axis=1)
    gain[_STRAIGHT : len(gain) - _STRAIGHT + 1] = np.where(is_seen & is_steady.any(), evidence, -np.inf)
    return gain


PARTS = {"all": "all keypoints", "fore": "the fore legs", "hind": "the hind legs"}
"""Words for the parts of the animal that are swapped, with the kinds of swaps as keys."""


def swap_finding(swap: Swap, source: Source, body: Body) -> Finding:
    """Return the finding on a swap, or on a possible swap, in the keypoints of a camera."""
    stretch, numbers = swap.stretch, source.keypoints.frames
    frames = int(numbers[stretch.rows.start]), int(numbers[stretch.rows.stop - 1]) + 1
    part = next(
        PARTS[name] for name, permutation in pairs_of(body).items() if np.array_equal(permutation, stretch.permutation)
    )
    names = tuple(source.keypoints.names[j] for j in stretch.markers)
    code = "left_right_swap" if swap.clear else "left_right_swap_possible"
    return finding(code, frames, source.camera.name, part=part, keypoints=names, log_likelihood_ratio=swap.ratio)
