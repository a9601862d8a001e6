"""Quantities over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from recon.analysis.path import frame_jitter_m, speed_at_frames
from recon.body import side_of, without_side
from recon.motion import FrameMotion, Motion, TrajectoryMotion
from recon.skeleton import Skeleton
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

_ANGLE_COLOURS: tuple[Colour, ...] = (*LIMB_COLOURS, LINK, (213, 94, 0), (200, 200, 210))


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


def write_states(motion: TrajectoryMotion, send: Send, fix: Fix) -> None:
    """Which flags a frame has, and which feet stand."""

    def state(entity: str, values: list[str], colours: dict[str, Colour]) -> None:
        send(entity, state_columns(values))
        fix(entity, state_style(colours))

    doubts = [", ".join(flags) for flags in motion.solution.flags]
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
    """In degrees."""
    degrees = np.rad2deg(motion.angles_rad)
    if isinstance(motion, FrameMotion | TrajectoryMotion) and motion.skeleton is not None:
        theta, phi = np.split(degrees, 2, axis=1)
        names, colours = _links(motion.skeleton)
        return [
            Series("angles/theta", "θ, sagittal angles (°)", [f"θ{name}" for name in names], colours, theta),
            Series("angles/phi", "φ, transverse angles (°)", [f"φ{name}" for name in names], colours, phi),
        ]
    found = []
    for entity, title, side in (
        ("angles/left", "Left legs (°)", "left"),
        ("angles/right", "Right legs (°)", "right"),
        ("angles/middle", "Middle (°)", None),
    ):
        chosen = [i for i, name in enumerate(motion.angle_names) if side_of(name) == side]
        if chosen:
            names = [without_side(motion.angle_names[i]).replace("_", " ") for i in chosen]
            colours = [_ANGLE_COLOURS[i % len(_ANGLE_COLOURS)] for i in range(len(names))]
            found.append(Series(entity, title, names, colours, degrees[:, chosen]))
    return found


def other_series(motion: Motion) -> list[Series]:
    residuals = Series(
        "residuals",
        "Reprojection (px)",
        ["mean of the joints", "worst joint"],
        [LIMB_COLOURS[1], OUTLIER],
        np.stack(_residuals_px(motion), axis=1),
    )
    if isinstance(motion, TrajectoryMotion):
        speed = np.where(motion.solved, speed_at_frames(motion.time_s, motion.root_m), np.nan)
        values = np.stack((motion.relative_rms_m, motion.place_sigma_m), axis=1)
        names = ["joint within the pose", "place in depth"]
        return [
            Series("speed", "Speed (m/s)", ["speed"], [TRAIL], speed[:, None]),
            residuals,
            Series("uncertainty", "One sigma (m)", names, [LIMB_COLOURS[1], LINK], values),
        ]
    assert isinstance(motion, FrameMotion)
    exact, smooth, straight = _speeds_m_s(motion)
    # Splines overshoot, at the ends above all.
    shown = smooth[smooth <= 1.5 * np.nanpercentile(exact, 90)] if np.isfinite(exact).any() else smooth
    lines = ["cubic spline", "smoothed by its jitter", "straight run"]
    colours = [EDGE, TRAIL, LIMB_COLOURS[0]]
    values = np.stack((exact, smooth, straight), axis=1)
    return [Series("speed", "Speed (m/s)", lines, colours, values, shown), residuals]


def _links(skeleton: Skeleton) -> tuple[list[str], list[Colour]]:
    """For each free link, in the order of the angles: the number of its end, with its limb; a tint of its limb's
    colour."""
    limbs = list(skeleton.limbs)
    free = [link for link in skeleton.links if link.free]
    names = [f"{link.end.lstrip('J')} {link.limb}" for link in free]
    colours = []
    for link in free:
        same = [other for other in free if other.limb == link.limb]
        colours.append(shade(LIMB_COLOURS[limbs.index(link.limb) % 5], same.index(link), len(same)))
    return names, colours


def _speeds_m_s(motion: FrameMotion) -> tuple[Array, Array, Array]:
    """Speed of the reference joint in solved frames, (T,) each: from the exact spline, from one smoothed by the
    jitter from frame to frame (the exact one where that cannot be told), and of the straight run through the clip."""
    exact = speed_at_frames(motion.time_s, motion.root_m)
    jitter = frame_jitter_m(motion.root_m)
    smooth = speed_at_frames(motion.time_s, motion.root_m, jitter) if np.isfinite(jitter).all() else exact
    straight = np.where(motion.solved, motion.solution.travel.speed_m_s, np.nan)
    return np.where(motion.solved, exact, np.nan), np.where(motion.solved, smooth, np.nan), straight


def _residuals_px(motion: Motion) -> tuple[Array, Array]:
    """(T,), (T,): mean and largest distance of detections from reprojections, NaN in frames without any."""
    distance = np.concatenate([picture.distance_px for picture in motion.pictures], axis=1)
    known = np.isfinite(distance).any(axis=1)
    mean, worst = np.full((2, len(distance)), np.nan)
    mean[known], worst[known] = np.nanmean(distance[known], axis=1), np.nanmax(distance[known], axis=1)
    return mean, worst
