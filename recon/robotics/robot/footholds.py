"""Feet that stand where they stand: paths made to rest on the ground in their stances, and to swing smoothly between.

A path gets a correction. In a stance it takes the foot to the stance's mean place, on the ground; over a swing it goes
from that of the stance before to that of the next by a cubic. At either end its rate is such that the foot lifts off
and lands without a jump of its speed; this wears off within the share `EASE` of the swing, as otherwise the foot would
trail far behind where it should be. Before the first and after the last stance of a clip the correction comes to rest.
"""

from __future__ import annotations

import numpy as np

from recon.base.arrays import Array, Bools
from recon.clip.keypoints import frame_ranges

EASE = 0.5


def planted(time_s: Array, path_m: Array, standing: Bools, advance_m: Array | None = None) -> Array:
    """A path (N, 3), ground at z = 0, standing (N,) -> the same with footholds, nowhere below the ground.

    advance_m (2,): for a stride that repeats, by how far its last sample is ahead of its first.
    """
    if advance_m is None:
        return _planted_path(time_s, path_m, standing)
    n, period = len(time_s) - 1, time_s[-1] - time_s[0]
    time = np.concatenate([time_s[:-1] - period, time_s[:-1], time_s + period])
    ahead = np.append(advance_m, 0.0)
    path = np.concatenate([path_m[:-1] - ahead, path_m[:-1], path_m + ahead])
    stands = np.concatenate([standing[:-1], standing[:-1], standing])
    out = _planted_path(time, path, stands)[n : 2 * n + 1]
    out[-1] = out[0] + ahead
    return out


def stances(standing: Bools) -> list[tuple[int, int]]:
    """First and last sample of each."""
    return [(first, end - 1) for first, end in frame_ranges(np.flatnonzero(standing))]


def _planted_path(time_s: Array, path_m: Array, standing: Bools) -> Array:
    found = stances(standing)
    if not found:
        return np.column_stack([path_m[:, :2], np.maximum(path_m[:, 2], 0.0)])
    rate = np.gradient(path_m, time_s, axis=0)
    correction = np.zeros_like(path_m)
    knots: list[tuple[int, Array, Array]] = []
    for first, last in found:
        place = np.append(path_m[first : last + 1, :2].mean(axis=0), 0.0)
        correction[first : last + 1] = place - path_m[first : last + 1]
        knots += [(k, correction[k].copy(), -rate[k]) for k in (first, last)]
    rest = np.zeros(3)
    knots = [(0, knots[0][1], rest), *knots, (len(path_m) - 1, knots[-1][1], rest)]
    for (a, value_a, rate_a), (b, value_b, rate_b) in zip(knots[::2], knots[1::2], strict=True):
        inside = np.arange(a, b + 1)
        inside = inside[~standing[inside]]
        if len(inside):
            since, until = (time_s[inside] - time_s[a])[:, None], (time_s[b] - time_s[inside])[:, None]
            share = since / (since + until)
            moved = value_a + share**2 * (3 - 2 * share) * (value_b - value_a)
            ease = EASE * (time_s[b] - time_s[a])
            correction[inside] = moved + _bump(since, ease) * rate_a - _bump(until, ease) * rate_b
    out = path_m + correction
    out[:, 2] = np.maximum(out[:, 2], 0.0)
    return out


def _bump(time: Array, until: float) -> Array:
    """Starts at 0 with rate 1, and is 0 with rate 0 from then on."""
    return time * np.maximum(1 - time / until, 0.0) ** 2
