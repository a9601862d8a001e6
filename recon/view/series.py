"""Quantities over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from recon.analysis.path import frame_jitter_m, speed_at_frames
from recon.body import side_of, without_side
from recon.motion import Motion
from recon.published import FrameSolution
from recon.view.scene import (
    EDGE,
    LEFT,
    LIMB_COLOURS,
    LINK,
    OUTLIER,
    RIGHT,
    TRAIL,
    Array,
    Colour,
    Fix,
    Send,
    shade,
)
from recon.view.world import STANCE

LINE_COLOURS: tuple[Colour, ...] = (*LIMB_COLOURS, LINK, (213, 94, 0), (200, 200, 210))


@dataclass(frozen=True)
class Series:
    """One plot: values (T, lines), and a name and a colour for each line. shown: what sets its range, where that is not
    all of it."""

    entity: str
    title: str
    names: Sequence[str]
    colours: Sequence[Colour]
    values: Array
    shown: Array | None = None


def write_series(motion: Motion, send: Send, fix: Fix) -> None:
    """A row with NaN is left empty, which breaks the lines there."""
    for s in (*angle_series(motion), *other_series(motion)):
        known = np.isfinite(s.values).all(axis=1)
        columns = rr.Scalars.columns(scalars=s.values[known].ravel())
        send(s.entity, columns.partition(np.where(known, s.values.shape[1], 0)))
        fix(s.entity, line_style(s))


def write_states(motion: Motion, send: Send, fix: Fix) -> None:
    """Which flags a frame has, and which feet stand."""

    def state(entity: str, values: list[str], colours: dict[str, Colour]) -> None:
        send(entity, state_columns(values))
        fix(entity, state_style(colours))

    doubts = [", ".join(flags) for flags in motion.flags]
    state("states/doubt", doubts, dict.fromkeys(dict.fromkeys(filter(None, doubts)), OUTLIER))
    colours = {"L": LEFT, "R": RIGHT}
    for foot, label, contact in zip(motion.feet, motion.foot_labels, motion.solution.contact.T, strict=True):
        stances = ["stance" if c > STANCE else "" for c in contact]
        state(f"states/{motion.names[foot]}", stances, {"stance": colours[label[0]]})


# -- how it is written ----------------------------------------------------------------------------------------------


def line_style(series: Series) -> rr.SeriesLines:
    return rr.SeriesLines(names=series.names, colors=series.colours, widths=[1.8] * len(series.names))


def state_columns(texts: Sequence[str]) -> rr.ComponentColumnList:
    """Empty texts are gaps."""
    return rr.StateChange.columns(state=[t for t in texts if t]).partition([int(bool(t)) for t in texts])


def state_style(colours: Mapping[str, Colour]) -> rr.StateConfiguration:
    return rr.StateConfiguration(values=list(colours), colors=list(colours.values()))


# -- what is shown ------------------------------------------------------------------------------------------------


def angle_series(motion: Motion) -> list[Series]:
    """In degrees: a chain's by their kind, a whole animal's by their side, and the others."""
    degrees = np.rad2deg(motion.angles_rad)
    limb_of, tints = _limb_tints(motion)
    rest, found = list(motion.angle_names), []
    for entity, title, kind in (
        ("angles/theta", "θ, sagittal angles (°)", "theta_"),
        ("angles/phi", "φ, transverse angles (°)", "phi_"),
        ("angles/left", "Left legs (°)", "left"),
        ("angles/right", "Right legs (°)", "right"),
        ("angles/middle", "Middle (°)", ""),
    ):
        names = [name for name in rest if name.startswith(kind) or side_of(name) == kind]
        if not names:
            continue
        rest = [name for name in rest if name not in names]
        if kind.endswith("_"):
            sign, ends = entity.removeprefix("angles/"), [name.removeprefix(kind) for name in names]
            labels = [f"{_SIGNS[sign]}{end} {limb_of[end]}" for end in ends]
            colours = [tints[end] for end in ends]
        else:
            labels = [without_side(name).replace("_", " ") for name in names]
            colours = [LINE_COLOURS[i % len(LINE_COLOURS)] for i in range(len(names))]
        columns = [motion.angle_names.index(name) for name in names]
        found.append(Series(entity, title, labels, colours, degrees[:, columns]))
    return found


_SIGNS = {"theta": "θ", "phi": "φ"}


def other_series(motion: Motion) -> list[Series]:
    residuals = Series(
        "residuals",
        "Reprojection (px)",
        ["mean of the joints", "worst joint"],
        [LIMB_COLOURS[1], OUTLIER],
        np.stack(_residuals_px(motion), axis=1),
    )
    names = ["joint within the pose", "place in depth"]
    sigmas = np.stack((motion.relative_rms_m, motion.place_sigma_m), axis=1)
    return [_speed(motion), residuals, Series("uncertainty", "One sigma (m)", names, [LIMB_COLOURS[1], LINK], sigmas)]


def _speed(motion: Motion) -> Series:
    if not isinstance(motion.solution, FrameSolution):
        speed = np.where(motion.solved, speed_at_frames(motion.time_s, motion.root_m), np.nan)
        return Series("speed", "Speed (m/s)", ["speed"], [TRAIL], speed[:, None])
    straight = np.where(motion.solved, motion.solution.travel.speed_m_s, np.nan)
    exact, smooth = _speeds_m_s(motion)
    # Splines overshoot, at the ends above all.
    shown = smooth[smooth <= 1.5 * np.nanpercentile(exact, 90)] if np.isfinite(exact).any() else smooth
    lines = ["cubic spline", "smoothed by its jitter", "straight run"]
    values = np.stack((exact, smooth, straight), axis=1)
    return Series("speed", "Speed (m/s)", lines, [EDGE, TRAIL, LIMB_COLOURS[0]], values, shown)


def _limb_tints(motion: Motion) -> tuple[dict[str, str], dict[str, Colour]]:
    """Of a chain, by the number of a link's end: its limb, and a tint of the limb's colour."""
    limb_of, tints = {}, {}
    for i, (limb, along) in enumerate(motion.body.limbs.items()):
        ends = [end.lstrip("J") for end in along[1:] if f"theta_{end.lstrip('J')}" in motion.angle_names]
        limb_of |= dict.fromkeys(ends, limb)
        tints |= {end: shade(LIMB_COLOURS[i % 5], number, len(ends)) for number, end in enumerate(ends)}
    return limb_of, tints


def _speeds_m_s(motion: Motion) -> tuple[Array, Array]:
    """Speed of the reference joint in solved frames, (T,) each: from the exact spline, and from one smoothed by the
    jitter from frame to frame (the exact one where that cannot be told)."""
    exact = speed_at_frames(motion.time_s, motion.root_m)
    jitter = frame_jitter_m(motion.root_m)
    smooth = speed_at_frames(motion.time_s, motion.root_m, jitter) if np.isfinite(jitter).all() else exact
    return np.where(motion.solved, exact, np.nan), np.where(motion.solved, smooth, np.nan)


def _residuals_px(motion: Motion) -> tuple[Array, Array]:
    """(T,), (T,): mean and largest distance of detections from reprojections, NaN in frames without any."""
    distance = np.concatenate([picture.distance_px for picture in motion.pictures], axis=1)
    known = np.isfinite(distance).any(axis=1)
    mean, worst = np.full((2, len(distance)), np.nan)
    mean[known], worst[known] = np.nanmean(distance[known], axis=1), np.nanmax(distance[known], axis=1)
    return mean, worst
