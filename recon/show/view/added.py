"""Plots that go with a playback, in a file of their own.

Entities are `analysis/...`, of states the rows' names. Their views are tabs beside the row of plots that the playback
opens with. On `time` they have all their samples, on `frame` those that lie on a frame of the playback.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from recon.base.errors import Problem, refuse
from recon.fit.motion import Motion
from recon.show.recording import recording
from recon.show.view.layout import blueprint, plot, state_rows
from recon.show.view.scene import Array, Colour, Scene
from recon.show.view.series import TimePlot, line_style, state_columns, state_entity, state_style
from recon.show.view.stored import Part

ROOT = "analysis"
SAME_TIME_S = 1e-6
"""A time this close to a frame's is the frame's."""


@dataclass(frozen=True, kw_only=True)
class AddedSeries(TimePlot):
    """A plot of lines: values (N, lines) at time_s (N,), increasing, seconds since frame 0; NaN is a gap in its line.

    tab: the name of the tab that it stands in, side by side with others of that name.
    """

    time_s: Array
    tab: str


@dataclass(frozen=True, kw_only=True)
class AddedStates:
    """A plot of states over time, at time_s (N,). Rows are entities of their own, and the viewer shows and sorts
    their names, such as `l_front_paw.ground`."""

    title: str
    rows: Sequence[tuple[str, Sequence[str], Mapping[str, Colour]]]
    """Each with its name, a text for each of the samples, "" for none, and the texts' colours."""
    time_s: Array
    tab: str


@dataclass(frozen=True, kw_only=True)
class AddedArrows:
    """Arrows in the world: from origins_m (N, A, 3) by vectors_m (N, A, 3) at time_s (N,), in its frame of reference;
    one whose vector is NaN or 0 is not there. path_m (M, 3): a line that stays."""

    entity: str
    origins_m: Array
    vectors_m: Array
    path_m: Array
    time_s: Array
    colour: Colour

    @property
    def title(self) -> str:
        return self.entity


def write_plots(
    path: Path,
    playback: Path,
    motion: Motion,
    series: Sequence[AddedSeries],
    states: Sequence[AddedStates],
    start_frame: int | None = None,
    arrows: AddedArrows | None = None,
) -> None:
    """Write plots that go with the playback of a motion, and the layout of both (`recon.show.view.together`).

    start_frame: a frame number to hold, with the first of the new tabs in front, for pictures.

    Raises InputError where there is no such playback, or where samples lie on none of its frames; ValueError where two
    plots have the same entity.
    """
    series = [replace(s, entity=f"{ROOT}/{s.entity}") for s in series]
    plots = [*series, *states]
    entities = [*(s.entity for s in series), *(state_entity(name) for s in states for name, *_ in s.rows)]
    if len({*entities}) < len(entities):
        raise ValueError(f"entities must differ: {', '.join(entities)}")
    part_of = Part.read(playback).id
    found = [_on_frames(motion, p.time_s) for p in plots]
    refuse(
        Problem(
            playback, "frames", f"none at the {len(p.time_s)} times of {p.title!r}", "the playback of the same clip"
        )
        for p, (rows, _) in zip(plots, found, strict=True)
        if not len(rows)  # an empty chunk would make the viewer crash
    )

    with recording(path, _layout(motion, plots, start_frame), part_of=part_of) as stream:
        if arrows is not None:
            _write_arrows(stream, arrows, *_on_frames(motion, arrows.time_s))
        for p, (rows, frames) in zip(plots, found, strict=True):
            # Two chunks, each on one timeline: the samples between frames have no place on the other.
            for entity, values, columns, style in _lines(p) if isinstance(p, AddedSeries) else _states(p):
                stream.send_columns(entity, [rr.TimeColumn("frame", sequence=frames)], columns(values[rows]))
                stream.send_columns(entity, [rr.TimeColumn("time", duration=p.time_s)], columns(values))
                stream.log(entity, style, static=True)


def _write_arrows(stream: rr.RecordingStream, arrows: AddedArrows, rows: NDArray[Any], frames: NDArray[Any]) -> None:
    there = np.isfinite(arrows.vectors_m).all(axis=2) & (np.abs(arrows.vectors_m).max(axis=2) > 0)
    of_frames = rr.TimeColumn("frame", sequence=frames)
    for index, at in ((of_frames, rows), (rr.TimeColumn("time", duration=arrows.time_s), np.arange(len(there)))):
        seen = there[at]
        columns = rr.Arrows3D.columns(vectors=arrows.vectors_m[at][seen], origins=arrows.origins_m[at][seen])
        stream.send_columns(arrows.entity, [index], columns.partition(seen.sum(axis=1)))
    stream.log(arrows.entity, rr.Arrows3D.from_fields(colors=arrows.colour, radii=0.01), static=True)
    path = arrows.path_m[np.isfinite(arrows.path_m).all(axis=1)]
    stream.log(
        f"{arrows.entity}/centre_of_mass", rr.LineStrips3D([path], colors=arrows.colour, radii=0.006), static=True
    )


_Entity = tuple[str, NDArray[Any], Callable[[NDArray[Any]], rr.ComponentColumnList], rr.AsComponents]
"""Its path, what it has over time (N, ...), how to write that, and what is static."""


def _lines(series: AddedSeries) -> Iterator[_Entity]:
    lines = len(series.names)
    yield (
        series.entity,
        series.values,
        lambda values: rr.Scalars.columns(scalars=values.ravel()).partition([lines] * len(values)),
        line_style(series),
    )


def _states(states: AddedStates) -> Iterator[_Entity]:
    for name, row, colours in states.rows:
        texts = np.array(row, dtype=object)
        yield state_entity(name), texts, lambda values: state_columns(values.tolist()), state_style(colours)


def _on_frames(motion: Motion, time_s: Array) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
    """Which of the times (N,) are those of frames, and of which frames."""
    of_frames = motion.time_s
    nearest = np.searchsorted((of_frames[1:] + of_frames[:-1]) / 2, time_s)
    rows = np.flatnonzero(np.abs(of_frames[nearest] - time_s) < SAME_TIME_S)
    return rows, motion.frames[nearest[rows]]


def _layout(motion: Motion, plots: Sequence[AddedSeries | AddedStates], start_frame: int | None) -> rrb.Blueprint:
    tabs = {
        tab: rrb.Horizontal(
            *(
                plot(p) if isinstance(p, AddedSeries) else state_rows([state_entity(row[0]) for row in p.rows], p.title)
                for p in plots
                if p.tab == tab
            ),
            name=tab,
        )
        for tab in dict.fromkeys(p.tab for p in plots)
    }
    return blueprint(motion, Scene.of(motion), start_frame, list(tabs.values()))
