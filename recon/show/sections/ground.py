"""Report the segments of a clip, the ground under each segment, and the stances."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from recon.base.numbers import length_text
from recon.fit.motion import Motion
from recon.fit.result import MotionSegment
from recon.gait.clip import ClipAnalysis
from recon.gait.spline import MIN_POINTS
from recon.show.sections.section import Line, camera_name

NOT_FOUND = "not found"


def segments_data(motion: Motion) -> list[dict[str, Any]]:
    """Return the segments of a clip that were solved separately, with the ground under each segment."""
    rows = []
    for segment in motion.solution.segments:
        ends = motion.frames[segment.rows.start], motion.frames[segment.rows.stop - 1] + 1
        rows.append({"frames": ends, "ground": _ground_data(motion, segment), "prior_weight": segment.prior_weight})
    return rows


def _ground_data(motion: Motion, segment: MotionSegment) -> dict[str, Any] | None:
    """Return the ground below the middle of the root's path in a segment of the clip."""
    ground, below = segment.ground, motion.below_m(segment)
    if ground is None or below is None:
        return None
    return {
        "height_m": below[2],
        "middle_m": below[:2],
        "slope": ground.slope,
        "sigma_m": ground.sigma_m,
        "camera_height_m": motion.solution.views[0].centre_m[:, 2].mean() - below[2],
        "frame": "world" if motion.knows_up else "level",
    }


def stances_data(motion: Motion) -> dict[str, Any]:
    """Return the ranges of frame numbers in which each foot is in stance, keyed by the foot."""
    gait = motion.derived(ClipAnalysis).gait if motion.solved.sum() >= MIN_POINTS else None
    ranges, last = {name: [] for name in motion.foot_names.values()}, len(motion.frames) - 1
    for stance in gait.stances if gait else ():
        first, stop = (min(round(row), last) for row in (stance.start_row, stance.end_row))
        ranges[motion.foot_names[stance.foot]].append((motion.frames[first], motion.frames[stop] + 1))
    return ranges


def ground_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield lines with the ground under each segment, and the number of stances of each foot."""
    grounds = []
    for segment in segments_data(motion):
        ground, (first, stop) = segment["ground"], segment["frames"]
        text = NOT_FOUND
        if ground is not None:
            height, side = ground["camera_height_m"], "below" if ground["camera_height_m"] > 0 else "above"
            text = f"{length_text(abs(height), ground['sigma_m'])} {side} {camera_name(motion)}"
        grounds.append((text, f" (frames {first} to {stop - 1})"))
    if all(text == NOT_FOUND for text, _ in grounds):
        yield "ground", "not looked for" if motion.settings.get("ground") == "none" else NOT_FOUND
        return
    heights = ", ".join(text + (frames if len(grounds) > 1 else "") for text, frames in grounds)
    yield "ground", f"{heights}; stances: {', '.join(f'{foot} {len(ranges)}' for foot, ranges in data.items())}"
