"""Units of lengths and times as files state them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recon.base.errors import InputError, Problem
from recon.io.common import MAX_FRAME

PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
UNIT_NAMES = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("cm", "centimetre", "centimetres", "centimeter", "centimeters"), "cm"),
    **dict.fromkeys(("mm", "millimetre", "millimetres", "millimeter", "millimeters"), "mm"),
}
IRREGULAR = 0.25
"""By how much of a frame a time may miss its frame."""


def frames_of_times(path: Path, times_s: np.ndarray, fps: float | None) -> tuple[np.ndarray, float | None]:
    """Frame numbers (T,) int, of the frame rate that is given or that regular times have, and that rate. Frame 0 is at
    0 s. A gap must be a whole number of frames. Without a rate, a single time is frame 0. Raises InputError for times
    that do not increase or that no frame rate fits."""
    if not len(times_s):
        return np.zeros(0, np.int64), fps
    steps_s = np.diff(times_s)
    if not np.isfinite(times_s).all() or (steps_s <= 0).any():
        raise InputError(Problem(path, "time", "times that do not increase", "one increasing time for each frame"))
    if fps is None and len(times_s) == 1:
        return np.zeros(1, np.int64), None
    step_s = 1 / fps if fps is not None else float(np.median(steps_s))
    steps = np.rint(steps_s / step_s)
    if max(steps.sum(), abs(float(times_s[0])) / step_s) > MAX_FRAME:
        raise InputError(Problem(path, "time", f"{times_s[0]:g} to {times_s[-1]:g} s", "the times of a clip"))
    since_start = np.concatenate([[0.0], np.cumsum(steps)]).astype(np.int64)
    off = np.abs(steps_s / step_s - np.diff(since_start))
    if (np.diff(since_start) < 1).any() or (off > IRREGULAR).any():
        found = f"times that are no multiples of {step_s:.6g} s apart"
        raise InputError(Problem(path, "time", found, "a frame rate; gaps are whole frames"))
    if fps is None:
        fps = float(f"{since_start[-1] / (times_s[-1] - times_s[0]):.9g}")
    return since_start + round(float(times_s[0]) * fps), fps
