"""Left-right swaps: in single frames, a stretch or a whole clip, of all keypoints or of one pair of legs.

A fit follows exchanged keypoints. Stretches are proposed cheaply: where an exchange begins or ends, the keypoints of
both sides jump at once, unless the legs cross there; and a fit to which each keypoint of a leg may be either side's
says which of them it looks like in each frame. The few likeliest stretches are undone, one by one, and their second of
the clip is solved anew. What makes it clearly likelier (`believed`), also than any other stretch that contradicts it,
is a swap. Between two that are about as likely, none is chosen."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from recon.animal import Body, opposites
from recon.base.arrays import Array, Bools, Index
from recon.check import likelihood
from recon.check.codes import finding
from recon.check.likelihood import Baseline, Refit
from recon.clip import Keypoints, Source, View
from recon.fit.result import Finding

JUMP = -3.0
"""Exchanges begin and end where that makes the tracks so much likelier, as a logarithm: legs that cross hardly jump."""
LIKELY, REFITTED, STRETCHES = 15.0, 3, 4
"""Stretches are undone that are so likely, so many at a time, and so many exchanges are found in a clip."""
LOOKS = -10.0
"""A whole clip is undone unless it looks so much likelier as it is. One that is likelier undone, and not as much as is
believed, or only looks `LIKELY` to be exchanged, is to be looked at, as nothing else shows a mirrored video: undone,
32 that are right are less likely by 6 at least, or not tried, and look so by 9 at most."""
LEAST_S = 0.25
"""The sides of a shorter clip, less than a stride, cannot be told as a whole; nor can they without a leg."""
OF_LEG = 3
"""How many of a leg's last markers tell its side: what is above hardly does."""
_STRAIGHT = 3
"""So many frames before and after an end, tracks are straight lines."""
_LEAST_OFF_PX = 3.0
STEADY = 1.0
"""Tracks that usually lie off a line by more than this part of how far the sides lie apart say nothing."""


@dataclass(frozen=True, eq=False)
class _Stretch:
    """Rows of a clip, first and stop, and the permutation (J,) of its markers there."""

    rows: slice
    places: Index

    @property
    def markers(self) -> tuple[int, ...]:
        return tuple(int(j) for j in np.flatnonzero(self.places != np.arange(len(self.places))))

    def mask(self, T: int) -> Bools:
        """(T, J): what is exchanged."""
        of = np.zeros((T, len(self.places)), dtype=bool)
        of[self.rows, self.markers] = True
        return of


def exchanged(view: View, stretch: _Stretch) -> View:
    """The view with the sides of a stretch exchanged."""
    return replace(view, **exchanged_rows(view, stretch.rows, stretch.places))


def exchanged_rows(seen: View | Keypoints, rows: slice, places: Index) -> dict[str, Array]:
    """What was seen, with its keypoints taken from other places (J,) in some rows."""
    values = {"xy_px": seen.xy_px.copy(), "confidence": seen.confidence.copy()}
    for of in values.values():
        of[rows] = of[rows][:, places]
    return values


def pairs_of(body: Body) -> dict[str, Index]:
    """By kind, the permutation (J,) of the markers that are exchanged: of all, and of the fore and the hind legs."""
    places, none = opposites(body.markers), np.arange(len(body.markers))
    kinds = {"all": places}
    for name, end in (("fore", "F"), ("hind", "H")):
        feet = {foot for foot, label in zip(body.feet, body.foot_labels, strict=True) if label.endswith(end)}
        legs = {marker for limb in body.limbs.values() if {*limb} & feet for marker in limb[-OF_LEG:]}
        kinds[name] = np.where([marker in legs for marker in body.markers], places, none)
    return {name: places for name, places in kinds.items() if (places != none).any()}


def swaps(given: Baseline, unlike: bool = False) -> list[_SwapTrial]:
    """The left-right swaps in one view of a clip, under a prior learned from motions; nothing follows one that is not
    clear. unlike: the prior does not know this motion, and a whole clip is not tried: nothing else tells it."""
    kinds, found = pairs_of(given.clip.body), list[_SwapTrial]()
    while len(found) < STRETCHES and "all" in kinds:
        trials = sorted((undone(given, one) for one in likely(given, kinds, unlike)), key=lambda one: -one.ratio)
        if not trials or not likelihood.believed(trials[0].ratio):
            T = len(given.states)
            for one in (one for one in trials if one.stretch.rows == slice(0, T) and not found):
                if one.ratio > 0 or _evidence(given, kinds)["all"].sum() > LIKELY:
                    found.append(replace(one, clear=False))
            break
        best, *others = trials
        then = with_undone(given, best)
        rival = next((one for one in others if contradicts(then, best, one)), None)
        clear = rival is None or likelihood.believed(best.ratio - rival.ratio, surely=True)
        found.append(replace(best, clear=clear))
        if not clear:
            break
        given = then
    return found


@dataclass(frozen=True, eq=False)
class _SwapTrial:
    """A stretch that was exchanged, the solution of its part of the clip then, and how much likelier that is, as a
    logarithm. clear: no other stretch is about as likely in its place."""

    stretch: _Stretch
    refit: Refit
    ratio: float
    clear: bool = True


def contradicts(then: Baseline, best: _SwapTrial, other: _SwapTrial) -> bool:
    """Whether another stretch that makes the clip likelier may be exchanged in place of the best: one beside it, or one
    that no longer does so once the best is undone; none that is nearly the same."""
    (a, of_best), (b, of_other) = ((one.stretch.rows, one.stretch.mask(len(then.states))) for one in (best, other))
    both = of_best & of_other
    if not (of_other & ~of_best).any() or 2 * both.sum() >= (of_best | of_other).sum() or other.ratio <= 0:
        return False
    beside = a.start <= b.stop and b.start <= a.stop and {*best.stretch.markers} & {*other.stretch.markers}
    return bool(beside) or not likelihood.believed(undone(then, other.stretch).ratio)


def undone(given: Baseline, stretch: _Stretch) -> _SwapTrial:
    """With its part of the clip solved anew."""
    part = _part(given.view, stretch.rows, given.clip.fps)
    refit = likelihood.refitted(given.other(exchanged(given.view, stretch)).part(part))
    return _SwapTrial(stretch, refit, refit.likelier(given.refit(part)))


def with_undone(given: Baseline, trial: _SwapTrial) -> Baseline:
    """With a stretch exchanged, and the motion that was found then."""
    states = given.states.copy()
    states[_part(given.view, trial.stretch.rows, given.clip.fps)] = trial.refit.states
    return Baseline(given.other(exchanged(given.view, trial.stretch)), states)


def likely(given: Baseline, kinds: dict[str, Index], unlike: bool) -> list[_Stretch]:
    """The stretches that tracks and looks say most of."""
    if not np.isfinite(given.states).any():
        return []
    T, evidence = len(given.states), _evidence(given, kinds)
    suspects = [
        one for name, places in kinds.items() for one in _suspects(jumps(given.view, places), evidence[name], name)
    ]
    whole = float(evidence["all"].sum())
    suspects = sorted(suspects, reverse=True)[:REFITTED]
    told = T / given.clip.fps > LEAST_S and evidence["all"].any() and not unlike
    if told and whole > LOOKS:
        suspects.append((whole, "all", (0, T)))
    chosen = [(name, rows) for _, name, ends in suspects for rows in _parts(*ends, T)]
    return [_Stretch(slice(*ends), kinds[name]) for name, ends in dict.fromkeys(chosen)]


def _parts(first: int, stop: int, T: int) -> list[tuple[int, int]]:
    """A stretch, and what is left of the clip before or after it: which of them is exchanged only the motion tells."""
    rest = [] if stop - first == T else [(stop, T)] if first == 0 else [(0, first)] if stop == T else []
    return [(first, stop), *rest]


def _part(view: View, rows: slice, fps: float) -> slice:
    """The second around a stretch, or around an end of a longer one; of a whole clip that in which most is seen."""
    T, n = len(view.xy_px), max(round(likelihood.AT_ONCE_S * fps), 4)
    inner = [edge for edge in (rows.start, rows.stop) if 0 < edge < T]
    if not inner:
        return likelihood.best_seen(view, fps)
    middle = sum(inner) // 2 if inner[-1] - inner[0] < n else inner[0]
    first = int(np.clip(middle - n // 2, 0, max(T - n, 0)))
    return slice(first, min(first + n, T))


def _suspects(jump: Array, evidence: Array, name: str) -> list[tuple[float, str, tuple[int, int]]]:
    """Stretches of a kind that hardly overlap, the likeliest first: how likely, the kind, first and stop."""
    T = len(jump)
    ends = np.concatenate([[0], 1 + np.flatnonzero(jump[1:] > JUMP), [T]])
    gain = np.concatenate([[0.0], jump[ends[1:-1]], [0.0]])
    sums = np.concatenate([[0.0], np.cumsum(evidence)])[ends]
    low, high = sums - gain, sums + gain
    ahead, behind = np.full(len(ends), -np.inf), np.full(len(ends), np.inf)
    ahead[:-1], behind[1:] = np.maximum.accumulate(high[:0:-1])[::-1], np.minimum.accumulate(low[:-1])
    some = (ahead - low > LIKELY) | (high - behind > LIKELY)  # of a long clip next to none
    ends, low, high = ends[some], low[some], high[some]
    first, stop = ends[:, None], ends[None]
    score = np.where((stop > first) & (stop - first < T), high[None] - low[:, None], -np.inf)
    found: list[tuple[float, str, tuple[int, int]]] = []
    while len(found) < REFITTED and score.max(initial=-np.inf) > LIKELY:
        a, b = np.unravel_index(np.argmax(score), score.shape)
        found.append((float(score[a, b]), name, (int(ends[a]), int(ends[b]))))
        both = np.minimum(stop, ends[b]) - np.maximum(first, ends[a])
        score[2 * both >= np.maximum(stop, ends[b]) - np.minimum(first, ends[a])] = -np.inf
    return found


def _evidence(given: Baseline, kinds: dict[str, Index]) -> dict[str, Array]:
    """By kind, (T,): how much likelier a frame's keypoints are exchanged, as a logarithm; "all" is all legs."""
    legs = {name: places != np.arange(len(places)) for name, places in kinds.items() if name != "all"}
    which = np.any([np.zeros(len(kinds["all"]), dtype=bool), *legs.values()], axis=0)
    places, seen = np.where(which, kinds["all"], np.arange(len(which))), given.view.xy_px
    projected, sigma_px = likelihood.either_side(given, exchanged(given.view, _Stretch(slice(None), places)), which)
    straight, other = (
        likelihood.log_tail((points - seen) / sigma_px[..., None]) for points in (projected, projected[:, places])
    )
    likelier = np.where(np.isfinite(given.states[:, :1]), straight - other, 0.0)
    return {name: likelier[:, of].sum(axis=1) for name, of in (legs | {"all": which}).items()}


def jumps(view: View, places: Index) -> Array:
    """(T,): how much likelier the tracks are if the sides are exchanged from a frame on, as a logarithm: what lies
    between the points of a pair goes along a straight line for a few frames. Minus infinity where nothing is seen
    meanwhile, or where all pairs jump about as far as their points lie apart."""
    n, pairs = 2 * _STRAIGHT, [(j, int(k)) for j, k in enumerate(places) if j < k]
    apart = view.xy_px[:, [j for j, _ in pairs]] - view.xy_px[:, [k for _, k in pairs]]
    gain = np.full(len(apart), -np.inf)
    if len(apart) < n:
        return gain
    line = np.vander(np.arange(n), 2)
    off = np.eye(n) - line @ np.linalg.pinv(line)
    flip = np.where(np.arange(n) < _STRAIGHT, -1.0, 1.0)
    around = np.lib.stride_tricks.sliding_window_view(apart, n, axis=0)  # (N, P, 2, n)
    given, other = (np.sum((around @ by) * around, axis=(2, 3)) for by in (off, flip[:, None] * off * flip))
    known, freedom = np.isfinite(given), 2 * (n - 2)
    with np.errstate(all="ignore"), warnings.catch_warnings(action="ignore"):  # of a pair that is never seen
        square_px = np.nanmedian(np.where(known, given, np.nan), axis=0) / freedom
        far_px = np.nanmedian(np.sum(apart**2, axis=-1), axis=0)
    seen = np.lib.stride_tricks.sliding_window_view(view.present.any(axis=1), n).all(axis=1)
    steady = square_px < (STEADY**2) * far_px
    scale = likelihood.TAILS * np.maximum(np.nan_to_num(square_px), _LEAST_OFF_PX**2)
    likelier = np.log1p(np.where(known, given, 0.0) / scale) - np.log1p(np.where(known, other, 0.0) / scale)
    evidence = 0.5 * (likelihood.TAILS + freedom) * likelier.sum(axis=1)
    gain[_STRAIGHT : len(gain) - _STRAIGHT + 1] = np.where(seen & steady.any(), evidence, -np.inf)
    return gain


PARTS = {"all": "all keypoints", "fore": "the fore legs", "hind": "the hind legs"}
"""What is swapped, in words."""


def swap_finding(trial: _SwapTrial, source: Source, body: Body) -> Finding:
    """What a swap in one camera's keypoints is said by."""
    stretch, numbers = trial.stretch, source.keypoints.frames
    frames = int(numbers[stretch.rows.start]), int(numbers[stretch.rows.stop - 1]) + 1
    part = next(PARTS[name] for name, places in pairs_of(body).items() if np.array_equal(places, stretch.places))
    names = tuple(source.keypoints.names[j] for j in stretch.markers)
    code = "left_right_swap" if trial.clear else "left_right_swap_possible"
    return finding(code, frames, source.camera.name, part=part, keypoints=names, log_likelihood_ratio=trial.ratio)
