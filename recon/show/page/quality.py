"""Make the table on the page of a clip that states how the fit used each keypoint's detections."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from recon.base.arrays import Array, median
from recon.base.numbers import counted, quantity
from recon.fit.motion import Motion, Picture
from recon.show.sections.keypoints import medians_px

STUCK_PX = 3.0
"""Radius in pixels within which the outliers of a keypoint lie if it is stuck at one point."""
STUCK_LEAST = 5
"""Minimum number of frames with an outlier at the same point required to call a keypoint stuck."""
COUNTS = {"missing": "missing", "left_out": "left out", "outliers": "outliers", "swapped": "swapped"}
"""Columns of the table that are left out if all their numbers are 0, with their headings."""
SWAPS = ("left_right_swap", "left_right_swap_possible", "left_right_swap_mended", "clip_swapped_back")
"""Codes of findings on left-right swaps."""
NEEDS_LOOK = 0.1
"""Fraction of outliers and swaps among a keypoint's detections above which its row is highlighted."""


def quality_tables(motion: Motion) -> list[dict[str, Any]]:
    """Return a table for each camera, with rows sorted by descending median distance from the pose."""
    tables = []
    for v, (picture, errors_px) in enumerate(zip(motion.pictures, medians_px(motion), strict=True)):
        rows = sorted(_rows(motion, picture, errors_px), key=_median_px, reverse=True)
        tables.append({"camera": picture.name, "number": v, "rows": rows})
    return tables


def worst_keypoint(tables: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the keypoint with the largest median distance from the pose, its camera, and a remark on its errors."""
    table = max(tables, key=lambda table: _median_px(table["rows"][0]))
    row = table["rows"][0]
    median_px, stuck = row["median_px"], row["stuck"]
    digits = 0 if median_px is not None and median_px >= 100 else 1
    texts = [] if median_px is None else [f"{quantity(median_px, digits, 'px')} from the pose (median)"]
    if stuck is not None:
        texts.append(f"stuck at pixel ({stuck['x']}, {stuck['y']}) in {counted(stuck['frames'], 'frame')}")
    texts += [counted(row["outliers"], "outlier")] if row["outliers"] else []
    texts += [f"swapped in {counted(row['swapped'], 'frame')}"] if row["swapped"] else []
    return {
        "keypoint": row["keypoint"],
        "camera": table["number"],
        "name": row["name"],
        "where": f" in {table['camera']}" if len(tables) > 1 else "",
        "text": ", ".join(texts) or "without a detection that was used",
    }


def _median_px(row: Mapping[str, Any]) -> float:
    return -1.0 if row["median_px"] is None else row["median_px"]


def _rows(motion: Motion, picture: Picture, errors_px: Array) -> Iterator[dict[str, Any]]:
    swapped = swapped_frames(motion, picture)
    for j, name in enumerate(motion.names):
        counts = picture.source.cleaning.keypoints.get(name)
        used, outliers = int(picture.present[:, j].sum()), int(picture.outliers[:, j].sum())
        rejected = 0 if counts is None else counts["rejected"]
        error_px, stuck = float(errors_px[j]), stuck_at(picture, j)
        fraction = (outliers + int(swapped[:, j].sum())) / max(1, len(motion.frames))
        yield {
            "keypoint": j,
            "name": name,
            "used": used,
            "missing": max(0, len(motion.frames) - used - rejected),
            "left_out": rejected,
            "outliers": outliers,
            "stuck": stuck,
            "swapped": int(swapped[:, j].sum()),
            "median_px": error_px if math.isfinite(error_px) else None,
            "look": fraction > NEEDS_LOOK or stuck is not None,
        }


LITTLE_WEIGHT = 0.1
"""Weight in the fit, 1 for a good detection, below which a detection counts as left out."""


def keypoint_notes(motion: Motion, picture: Picture) -> list[str]:
    """Return a remark on the wrong detections of each keypoint and their weight in the fit, or an empty string."""
    swapped = swapped_frames(motion, picture).sum(axis=0)
    notes = []
    for j in range(len(motion.names)):
        stuck, wrong = stuck_at(picture, j), picture.outliers[:, j]
        weight = median(picture.weight[wrong, j])
        fate = "left out" if weight < LITTLE_WEIGHT else "given little weight in the fit"
        texts = []
        if stuck is not None:
            texts.append(f"stuck at ({stuck['x']}, {stuck['y']}) in {stuck['frames']} frames: {fate}")
        elif wrong.any():
            texts.append(f"outlier in {counted(int(wrong.sum()), 'frame')}: {fate}")
        if swapped[j]:
            texts.append(f"left and right swapped in {counted(int(swapped[j]), 'frame')}")
        notes.append("; ".join(texts))
    return notes


def swapped_frames(motion: Motion, picture: Picture) -> Array:
    """Return a mask (T, J) of the keypoints that are swapped according to a finding."""
    swapped = np.zeros(picture.present.shape, dtype=bool)
    for item in motion.findings:
        if item.code in SWAPS and item.camera in (None, picture.name):
            first, stop = item.frames or (motion.frames[0], motion.frames[-1] + 1)
            rows = (motion.frames >= first) & (motion.frames < stop)
            for name in {*item.names("keypoints")} & {*motion.names}:
                swapped[rows, motion.names.index(name)] = True
    return swapped


def stuck_at(picture: Picture, joint: int) -> dict[str, Any] | None:
    """Return the pixel at which a keypoint is stuck and the number of frames, or None if it is not stuck."""
    points_px = picture.detected_px[picture.outliers[:, joint], joint]
    if len(points_px) < STUCK_LEAST:
        return None
    middle_px = np.median(points_px, axis=0)
    count = int((np.linalg.norm(points_px - middle_px, axis=1) <= STUCK_PX).sum())
    if count < STUCK_LEAST:
        return None
    return {"x": round(float(middle_px[0])), "y": round(float(middle_px[1])), "frames": count}
