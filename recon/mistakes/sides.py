"""Left and right exchanged: in single frames, a stretch or a whole clip, of all keypoints or of one pair of legs.

A fit follows exchanged keypoints, and its residuals say little. Where an exchange begins or ends, though, the keypoints
of both sides jump at once: their tracks in the picture say where that may be, and the likelihood of the clip with the
stretches between exchanged says whether it is, and which of them. A whole clip is tried in any case.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from recon.arrays import Array, Bools, Index
from recon.body import Body, other_side
from recon.clip import View
from recon.mistakes.likelihood import AT_ONCE_S, Given, best_seen, surprise
from recon.mistakes.mistake import CLEAR, Mistake

JUMP = 3.0
"""Tracks jump where that makes them so much likelier, as a logarithm."""
CLEAR_STRETCH = 21.5
"""A stretch is exchanged where that makes the tracks at its ends and the clip so many times as likely together, as a
logarithm: it could be any of thousands, and no animal's legs go quite as the prior has them. Set on real clips."""
JUMPS, TRIED, STRETCHES = 3, 4, 4
"""So many of the largest jumps of each kind are looked at a second, so many stretches between them tried, and so many
exchanges found in a clip."""
OF_LEG = 3
"""Of a leg, the last markers: what is above hardly tells its side."""
_TAILS = 3.0
"""Degrees of freedom of Student's distribution, which the tracks' bends have."""
_LEAST_BEND_PX = 3.0


@dataclass(frozen=True, eq=False)
class Stretch:
    """Rows of a clip, and the permutation (J,) of its markers there."""

    rows: slice
    places: Index

    @property
    def markers(self) -> tuple[int, ...]:
        return tuple(int(j) for j in np.flatnonzero(self.places != np.arange(len(self.places))))


def exchanged(view: View, stretch: Stretch) -> View:
    """The view with the sides of a stretch exchanged."""
    xy_px, confidence = view.xy_px.copy(), view.confidence.copy()
    xy_px[stretch.rows] = xy_px[stretch.rows][:, stretch.places]
    confidence[stretch.rows] = confidence[stretch.rows][:, stretch.places]
    return replace(view, xy_px=xy_px, confidence=confidence)


def opposites(body: Body) -> Index:
    """(J,): the marker's on the other side; of the middle its own."""
    at = {marker: j for j, marker in enumerate(body.markers)}
    return np.array([at.get(other_side(marker), j) for marker, j in at.items()], dtype=np.intp)


def pairs_of(body: Body) -> dict[str, Index]:
    """By kind, the permutation (J,) of the markers that are exchanged: of all, and of the fore and the hind legs."""
    places, none = opposites(body), np.arange(len(body.markers))
    kinds = {"all": places}
    for name, end in (("fore", "F"), ("hind", "H")):
        feet = {foot for foot, label in zip(body.feet, body.foot_labels, strict=True) if label.endswith(end)}
        legs = {marker for limb in body.limbs.values() if {*limb} & feet for marker in limb[-OF_LEG:]}
        kinds[name] = np.where([marker in legs for marker in body.markers], places, none)
    return {name: places for name, places in kinds.items() if (places != none).any()}


def exchanges(given: Given, number: int) -> list[Mistake]:
    """Of one view of a clip. number: the view's."""
    kinds, view = pairs_of(given.setting.body), given.view
    found: list[Mistake] = []
    while len(found) < STRETCHES and "all" in kinds:
        best = _best(given, kinds, whole=not found)
        if best is None:
            break
        stretch, ratio = best
        found.append(Mistake("sides", ratio, number, (stretch.rows.start, stretch.rows.stop), stretch.markers))
        view = exchanged(view, stretch)
        given = Given(given.other(view), given.states)
    return found


def _best(given: Given, kinds: dict[str, Index], whole: bool) -> tuple[Stretch, float] | None:
    """What makes the clip so much likelier if it is exchanged, and its ratio. whole: the whole clip is tried, too."""
    T, fps, found = len(given.view.xy_px), given.setting.fps, []
    for stretch, jump in _stretches(given.view, kinds, fps):
        part = _around(stretch.rows, T, fps)
        other = given.other(exchanged(given.view, stretch)).part(part)
        ratio = given.surprise(part) - surprise(other, given.straight(part))
        if ratio > CLEAR and ratio + jump > CLEAR_STRETCH:
            found.append((ratio + jump - CLEAR_STRETCH, stretch, ratio))
    if whole:
        stretch, part = Stretch(slice(0, T), kinds["all"]), best_seen(given.view, fps)
        ratio = given.surprise(part) - surprise(given.other(exchanged(given.view, stretch)).part(part))
        if ratio > CLEAR:
            found.append((ratio - CLEAR, stretch, ratio))
    if not found:
        return None
    _, stretch, ratio = max(found, key=lambda one: one[0])
    return stretch, ratio


def _around(rows: slice, T: int, fps: float) -> slice:
    """The second around a stretch, or around the beginning or the end of a longer one."""
    n = max(round(AT_ONCE_S * fps), 4)
    inner = [edge for edge in (rows.start, rows.stop) if 0 < edge < T]
    middle = sum(inner) // 2 if inner[-1] - inner[0] < n else inner[0]
    first = int(np.clip(middle - n // 2, 0, max(T - n, 0)))
    return slice(first, min(first + n, T))


def _stretches(view: View, kinds: dict[str, Index], fps: float) -> list[tuple[Stretch, float]]:
    """Those between jumps of the tracks, the clearest first, with what the tracks say of them."""
    T = len(view.xy_px)
    most = JUMPS * max(1, round(T / fps))
    found: list[tuple[Stretch, float]] = []
    for places in kinds.values():
        gain = jumps(view, places)
        at = sorted(_peaks(gain, most))
        edges = [0, *at, T]
        for i, first in enumerate(edges):
            for stop in edges[i + 1 :][:3]:
                if (first, stop) != (0, T):
                    clear = sum(float(gain[edge]) for edge in (first, stop) if 0 < edge < T)
                    found.append((Stretch(slice(first, stop), places), clear))
    return sorted(found, key=lambda one: -one[1])[: TRIED * max(1, round(T / fps))]


def jumps(view: View, places: Index) -> Array:
    """(T,): how much likelier the tracks are if the sides are exchanged from a frame on, as a logarithm.

    What lies between the points of a pair bends little from frame to frame, by as much as it does in the clip.
    """
    pairs = [(j, int(k)) for j, k in enumerate(places) if j < k]
    apart = view.xy_px[:, [j for j, _ in pairs]] - view.xy_px[:, [k for _, k in pairs]]
    gain = np.zeros(len(apart))
    if len(apart) < 4:
        return gain
    before, here, after = apart[:-2], apart[1:-1], apart[2:]
    bends = after - 2.0 * here + before
    lengths = np.linalg.norm(bends, axis=-1)
    known = np.isfinite(lengths)
    typical = np.array(
        [np.median(of[seen]) if seen.any() else np.inf for of, seen in zip(lengths.T, known.T, strict=True)]
    )
    sigma = np.maximum(typical / np.sqrt(2 * np.log(2)), _LEAST_BEND_PX)
    given = _log_density(bends, sigma)
    at_last = _log_density(-after - 2.0 * here + before, sigma) - given  # exchanged from the last of three frames on
    at_middle = _log_density(-after + 2.0 * here + before, sigma) - given
    gain[2:] += at_last.sum(axis=1)
    gain[1:-1] += at_middle.sum(axis=1)
    return gain


def _log_density(bends: Array, sigma: Array) -> Array:
    """(N, P), but for a constant; 0 where a point is missing."""
    q = np.sum(bends**2, axis=-1) / sigma**2
    return np.where(np.isfinite(q), -(_TAILS + 2) / 2 * np.log1p(np.nan_to_num(q) / _TAILS), 0.0)


def _peaks(gain: Array, most: int) -> list[int]:
    """The highest of the frames at which tracks jump."""
    inner: Bools = (gain[1:-1] > JUMP) & (gain[1:-1] >= gain[:-2]) & (gain[1:-1] > gain[2:])
    at = np.flatnonzero(inner) + 1
    if len(gain) > 1 and gain[-1] > JUMP and gain[-1] > gain[-2]:
        at = np.append(at, len(gain) - 1)
    return [int(t) for t in at[np.argsort(-gain[at])][:most]]
