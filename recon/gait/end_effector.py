"""Find the boundaries of strides from the end effector, the foot of a chain, as published (see References).

The end effector moves relative to the body along the direction of travel, and up and down. At a boundary between two
strides, the foot is rearmost and begins to swing. Its horizontal position has a local minimum near an extremum of its
height. A minimum counts if it is in the rear `REAR_FRACTION` of the range of the horizontal position, and if the foot
has been ahead of `SWING_FRACTION` of this range since the last boundary. If the foot has not been as far ahead between
two minima, the rearmost of the two is the boundary. A stride lasts from one boundary to the next.

References
----------
C. van der Leek, MSc(Eng), University of Cape Town, 2022.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from recon.base.arrays import Array, Index
from recon.gait.series import series_kinematics

REAR_FRACTION = 0.25
"""Rear fraction of the foot's horizontal range in which a swing may begin."""
SWING_FRACTION = 0.5
"""Position in its horizontal range, from 0 at the rear to 1, that the foot has to reach between two boundaries."""
_SHORT_M = 0.1
"""Minimum displacement of the body that defines a direction of travel; its heading is used otherwise."""


@dataclass(frozen=True, eq=False)
class EndEffector:
    """Path of a chain's foot relative to the body at N times, ten per frame, and the B boundaries of its strides."""

    foot: str
    time_s: Array
    """Times of the samples, shape (N,)."""
    forward_m: Array
    """Position of the foot relative to the body along the direction of travel, shape (N,); NaN in gaps."""
    up_m: Array
    """Height of the foot relative to the body, shape (N,)."""
    forward_rate_m_s: Array
    """Derivative of `forward_m` with respect to time, shape (N,)."""
    boundaries_s: Array
    """Times of the boundaries between strides, shape (B,)."""
    height_extrema_s: Array
    """Time of the extremum of `up_m` nearest to each boundary, shape (B,); NaN without an extremum."""
    oversampling: int = 10
    """Number of samples per frame."""

    def stride_s(self, frames_s: Array) -> tuple[float, float] | None:
        """Return the start and end (s) of the first complete stride in the clip, or None without such a stride.

        The stride is shifted to start at a frame. `frames_s` are the times of the frames, shape (F,).
        """
        for begin, end in zip(self.boundaries_s[:-1], self.boundaries_s[1:], strict=True):
            start = float(frames_s[np.argmin(np.abs(frames_s - begin))])
            if start + (end - begin) <= frames_s[-1] + 1e-9:
                return start, start + float(end - begin)
        return None


def end_effector(foot: str, time_s: Array, foot_m: Array, body_m: Array, heading: Array) -> EndEffector:
    """Return the path of an end effector relative to the body, and the boundaries of its strides.

    Parameters
    ----------
    foot : str
        Label of the foot.
    time_s : ndarray
        Times of the frames, s, shape (T,).
    foot_m, body_m : ndarray
        Positions of the foot and of the body's reference joint, metres, z up, shape (T, 3), NaN where unknown.
    heading : ndarray
        Direction in which the animal faces, shape (3,), used if the body hardly moves.
    """
    known = body_m[np.isfinite(body_m).all(axis=1)]
    chord = (known[-1] - known[0])[:2] if len(known) else np.full(2, np.nan)
    ahead = chord if np.hypot(*chord) >= _SHORT_M else heading[:2]
    ahead = ahead / np.hypot(*ahead)
    relative = foot_m - body_m
    series = series_kinematics(time_s, np.column_stack([relative[:, :2] @ ahead, relative[:, 2]]))
    forward, up = series.value.T
    boundaries = _boundaries(forward, series.rate[:, 0])
    extrema = _sign_changes(series.rate[:, 1])
    nearest = [series.time_s[extrema[np.argmin(np.abs(extrema - i))]] if len(extrema) else np.nan for i in boundaries]
    return EndEffector(
        foot=foot,
        time_s=series.time_s,
        forward_m=forward,
        up_m=up,
        forward_rate_m_s=series.rate[:, 0],
        boundaries_s=series.time_s[boundaries],
        height_extrema_s=np.array(nearest, float),
        oversampling=series.oversampling,
    )


def _sign_changes(values: Array) -> Index:
    """Return the index of the first value after each change of sign."""
    with np.errstate(invalid="ignore"):
        return np.flatnonzero(values[:-1] * values[1:] < 0) + 1


def _boundaries(forward: Array, rate: Array) -> Index:
    """Return the indices of the minima of the horizontal position that are boundaries between strides."""
    if not np.isfinite(forward).any():
        return np.empty(0, int)
    low, high = float(np.nanmin(forward)), float(np.nanmax(forward))
    chosen: list[int] = []
    for i in _sign_changes(rate).tolist():
        if not (rate[i - 1] < 0 < rate[i] and forward[i] <= low + REAR_FRACTION * (high - low)):
            continue
        if not chosen or np.nanmax(forward[chosen[-1] : i]) >= low + SWING_FRACTION * (high - low):
            chosen.append(i)
        elif forward[i] < forward[chosen[-1]]:
            chosen[-1] = i
    return np.array(chosen, int)
