"""Quantities over time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from recon.animal import side_of, without_side
from recon.base.arrays import Bools
from recon.fit.motion import Motion
from recon.gait.kinematics import speed_at_frames
from recon.gait.path import frame_jitter_m
from recon.show.view.scene import EDGE, LEFT, LIMB_COLOURS, LINK, OUTLIER, RIGHT, TRAIL, Array, Colour, Log, shade

MAX_LINES = 4
"""Of angles in one plot, as far as they can be told apart by what they belong to: their names stand above them."""
LINE_COLOURS: tuple[Colour, ...] = (*LIMB_COLOURS, LINK, (213, 94, 0), (200, 200, 210))


@dataclass(frozen=True)
class TimePlot:
    """One plot: values (T, lines), and a name and a colour for each line. shown: what sets its range, where that is not
    all of it."""

    entity: str
    title: str
    names: Sequence[str]
    colours: Sequence[Colour]
    values: Array
    shown: Array | None = None


def write_series(motion: Motion, log: Log) -> None:
    """A row with NaN is left empty, which breaks the lines there."""
    for s in (*angle_series(motion), *other_series(motion)):
        known = np.isfinite(s.values).all(axis=1)
        columns = rr.Scalars.columns(scalars=s.values[known].ravel())
        log.send(s.entity, columns.partition(np.where(known, s.values.shape[1], 0)))
        log.fix(s.entity, line_style(s))


def write_states(motion: Motion, log: Log, stands: Bools) -> None:
    """Which flags a frame has, a row for each, and which feet stand, (T, F) (`state_entities`)."""

    def state(entity: str, values: list[str], colours: dict[str, Colour]) -> None:
        log.send(entity, state_columns(values))
        log.fix(entity, state_style(colours))

    for row, flag in _flags(motion).items():
        state(state_entity(row), [flag if flag in flags else "" for flags in motion.flags], {flag: OUTLIER})
    colours = {"L": LEFT, "R": RIGHT}
    for foot, label, stood in zip(motion.feet, motion.foot_labels, stands.T, strict=True):
        stances = ["stance" if on_ground else "" for on_ground in stood]
        state(state_entity(motion.names[foot]), stances, {"stance": colours[label[0]]})


def state_entities(motion: Motion) -> list[str]:
    """What `write_states` writes."""
    return [state_entity(name) for name in (*_flags(motion), *(motion.names[foot] for foot in motion.feet))]


def _flags(motion: Motion) -> dict[str, str]:
    """Those that a frame has, by the names of their rows, without blanks, which the viewer writes with backslashes."""
    return {flag.replace(" ", "_"): flag for flags in motion.flags for flag in flags}


# -- how it is written ----------------------------------------------------------------------------------------------


def line_style(series: TimePlot) -> rr.SeriesLines:
    return rr.SeriesLines(names=series.names, colors=series.colours, widths=[1.8] * len(series.names))


def state_entity(name: str) -> str:
    """Of a row of states. It has no parent: the viewer writes the whole path beside it."""
    return rr.escape_entity_path_part(name)


def state_columns(texts: Sequence[str]) -> rr.ComponentColumnList:
    """Empty texts are gaps."""
    return rr.StateChange.columns(state=[t for t in texts if t]).partition([int(bool(t)) for t in texts])


def state_style(colours: Mapping[str, Colour]) -> rr.StateConfiguration:
    """A stance, and whatever is the only one of its row and so named by it, has a blank for its text, which would be
    cut; without any the viewer writes the value."""
    labels = [" " if value == "stance" or len(colours) == 1 else value for value in colours]
    return rr.StateConfiguration(values=list(colours), labels=labels, colors=list(colours.values()))


# -- what is shown ------------------------------------------------------------------------------------------------


def angle_series(motion: Motion) -> list[TimePlot]:
    """In degrees: a chain's by their kind, a whole animal's by their side, and the others; those that are too many for
    one plot by limb, by end of the animal, or by kind."""
    degrees = np.rad2deg(motion.angles_rad)
    limb_of, tints = _limb_tints(motion)
    rest, found = list(motion.angle_names), []
    for entity, title, kind in (
        ("angles/theta", "θ", "theta_"),
        ("angles/phi", "φ", "phi_"),
        ("angles/left", "Left", "left"),
        ("angles/right", "Right", "right"),
        ("angles/middle", "Middle", ""),
    ):
        names = [name for name in rest if name.startswith(kind) or side_of(name) == kind]
        rest = [name for name in rest if name not in names]
        of_chain = kind.endswith("_")
        words = {name: without_side(name).split("_") for name in names}
        if of_chain:
            keys = {name: limb_of[name.removeprefix(kind)] for name in names}
        else:
            keys = {name: words[name][0 if kind else -1] for name in names}
        for key, chosen in _parts(keys):
            if of_chain:
                labels = [f"{title}{name.removeprefix(kind)} {keys[name]}" for name in chosen]
                colours = [tints[name.removeprefix(kind)] for name in chosen]
            else:
                labels = [" ".join(words[name]) for name in chosen]
                colours = [LINE_COLOURS[i % len(LINE_COLOURS)] for i in range(len(chosen))]
            columns = [motion.angle_names.index(name) for name in chosen]
            part = f"{entity}/{key.replace(', ', '_').replace(' ', '_')}" if key else entity
            found.append(TimePlot(part, f"{title} {key}".strip() + " (°)", labels, colours, degrees[:, columns]))
    return found


def _parts(keys: Mapping[str, str]) -> Iterator[tuple[str, list[str]]]:
    """Names of one plot, by what they have in common: all of them, where a plot has room for them, or else those with
    the same key, and the next as well, as far as there is room."""
    if len(keys) <= MAX_LINES:
        yield from [("", [*keys])] if keys else []
        return
    parts: list[tuple[str, list[str]]] = []
    for key in dict.fromkeys(keys.values()):
        names = [name for name, own in keys.items() if own == key]
        if parts and len(parts[-1][1]) + len(names) <= MAX_LINES:
            parts[-1] = (f"{parts[-1][0]}, {key}", [*parts[-1][1], *names])
        else:
            parts.append((key, names))
    yield from parts


def other_series(motion: Motion) -> list[TimePlot]:
    residuals = TimePlot(
        "residuals",
        "Reprojection (px)",
        ["median of the joints", "worst but for outliers"],
        [LIMB_COLOURS[1], EDGE],
        np.stack(_residuals_px(motion), axis=1),
    )
    names = ["joint within the pose", "place in depth"]
    sigmas = np.stack((motion.relative_rms_m, motion.place_sigma_m), axis=1)
    return [_speed(motion), residuals, TimePlot("uncertainty", "One sigma (m)", names, [LIMB_COLOURS[1], LINK], sigmas)]


def _speed(motion: Motion) -> TimePlot:
    run_m_s = motion.solution.straight_run_m_s
    if run_m_s is None:
        speed = np.where(motion.solved, speed_at_frames(motion.time_s, motion.root_m), np.nan)
        low, high = (f"{end:.1f}" for end in (np.nanmin(speed), np.nanmax(speed))) if np.isfinite(speed).any() else "??"
        return TimePlot("speed", f"Speed, {low} to {high} m/s", ["speed"], [TRAIL], speed[:, None])
    straight = np.where(motion.solved, run_m_s, np.nan)
    exact, smooth = _speeds_m_s(motion)
    lines = ["cubic spline", "smoothed by its jitter", "straight run"]
    values = np.stack((exact, smooth, straight), axis=1)
    return TimePlot("speed", "Speed (m/s)", lines, [EDGE, TRAIL, LIMB_COLOURS[0]], values)


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
    told = np.isfinite(frame_jitter_m(motion.root_m)).all()
    smooth = speed_at_frames(motion.time_s, motion.root_m, smooth=True) if told else exact
    return np.where(motion.solved, exact, np.nan), np.where(motion.solved, smooth, np.nan)


def _residuals_px(motion: Motion) -> tuple[Array, Array]:
    """(T,), (T,): distances of detections from reprojections: the median of all, and the largest but for outliers (the
    pictures show those, and they would hide the rest); NaN in frames without any."""
    distance = np.concatenate([picture.distance_px for picture in motion.pictures], axis=1)
    explained = np.where(np.concatenate([picture.outliers for picture in motion.pictures], axis=1), np.nan, distance)
    known = np.isfinite(distance).any(axis=1)
    median = np.full(len(distance), np.nan)
    median[known] = np.nanmedian(distance[known], axis=1)
    return median, np.fmax.reduce(explained, axis=1)
