"""Plots that go with a playback, read back with rerun's own reader, alone and together with it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import Chunk, RrdReader

from recon.base.errors import InputError
from recon.fit.motion import Motion
from recon.show.view import write
from recon.show.view.added import AddedSeries, AddedStates, write_plots
from recon.show.view.together import put_together

BLUE, ORANGE = (86, 180, 233), (230, 159, 0)
TABS, HORIZONTAL = 1, 2

# The motions have frames 10 to 17 (trajectory) or 10 to 15 (frame method) at 30 fps; three samples a frame.
TIME_S = np.arange(30, 46) / 90.0
FEET_M = np.column_stack((np.sin(TIME_S), 2.0 + TIME_S**2))
FEET_M[4:6, 0] = np.nan
SPEED = AddedSeries(
    "speed", "Tail base (m/s)", ["tail base"], [BLUE], 10.0 * FEET_M[:, 1:], time_s=TIME_S, tab="Path and speed"
)
FEET = AddedSeries("feet/height", "Height (m)", ["LF", "RF"], [BLUE, ORANGE], FEET_M, time_s=TIME_S, tab="Gait")
STANDS = ["", "", "stance", "stance", "stance", "", "", "late", *[""] * 8]
STANCE = AddedStates(
    title="Stances",
    rows=[
        ("LF.ground", STANDS, {"stance": BLUE, "late": ORANGE}),
        ("RF/by body", [""] * 16, {"stance": ORANGE}),
    ],
    time_s=TIME_S,
    tab="Gait",
)


class Stored:
    """What a file holds. data, layout: by entity, its static and its timed rows; row ids are left out."""

    def __init__(self, path: Path) -> None:
        reader = RrdReader(path)
        (self.store,) = reader.recordings()
        (layout,) = reader.blueprints()
        assert layout.application_id == self.store.application_id
        self.data = _rows(reader.stream(store=self.store).to_chunks())
        self.layout = _rows(reader.stream(store=layout).to_chunks())

    def on(self, timeline: str, entity: str, component: str) -> dict[Any, Any]:
        rows = [row for row in self.data[entity] if row.get(timeline) is not None]
        assert all({"frame", "time"} & {*row} == {timeline} for row in rows)
        return {row[timeline]: row[component] for row in rows}

    def static(self, entity: str) -> dict[str, Any]:
        (row,) = [row for row in self.data[entity] if not {"frame", "time"} & {*row}]
        return row

    def field(self, path: str, component: str) -> list[Any]:
        (value,) = [row[component] for row in self.layout[f"/{path}"] if row.get(component) is not None]
        return value

    def contents(self, container: str) -> list[str]:
        return self.field(container, "ContainerBlueprint:contents")

    @property
    def root(self) -> str:
        (root,) = self.field("viewport", "ViewportBlueprint:root_container")
        return f"container/{UUID(bytes=bytes(root))}"

    def names(self) -> dict[str, str]:
        """Paths of views by their names."""
        component = "ViewBlueprint:display_name"
        found = {}
        for path in self.layout:
            for row in self.layout[path]:
                if component in row:
                    assert row[component][0] not in found
                    found[row[component][0]] = path.removeprefix("/")
        return found

    def without_ids(self) -> dict[str, list[dict[str, Any]]]:
        """The layout with its parts numbered as they are met from the root: ids and times differ from file to file."""
        order = [self.root]
        for path in order:
            if path.startswith("container"):
                order += self.contents(path)
        assert len(order) == len({*order})
        parts = {"/".join(path.split("/")[1:3]) for path in self.layout if path.startswith(("/container", "/view/"))}
        assert parts == {*order}  # nothing lies about that is not shown
        number = {path: f"part {i}" for i, path in enumerate(order)}
        plain = {}
        for path, rows in self.layout.items():
            head, rest = "/".join(path.split("/")[1:3]), "/".join(path.split("/")[3:])
            plain[f"{number.get(head, head)} {rest}"] = [
                {
                    k: [number.get(x, x) if isinstance(x, str) else x for x in v] if isinstance(v, list) else v
                    for k, v in row.items()
                    if k not in ("log_time", "ViewportBlueprint:root_container")
                }
                for row in rows
            ]
        return plain


def _rows(chunks: list[Chunk]) -> dict[str, list[dict[str, Any]]]:
    found: dict[str, list[dict[str, Any]]] = {}
    for chunk in chunks:
        for row in chunk.to_record_batch().to_pylist():
            row.pop("rerun.controls.RowId")
            found.setdefault(chunk.entity_path, []).append(row)
    return found


@pytest.fixture(scope="module")
def plain(world_trajectory: Motion, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("plain") / "motion.rrd"
    write(world_trajectory, path)
    return path


@pytest.fixture
def copy(plain: Path, tmp_path: Path) -> Path:
    path = tmp_path / "motion.rrd"
    path.write_bytes(plain.read_bytes())
    return path


@pytest.fixture(scope="module")
def both(plain: Path, world_trajectory: Motion, tmp_path_factory: pytest.TempPathFactory) -> tuple[Stored, Stored]:
    """Before and after."""
    folder = tmp_path_factory.mktemp("added")
    write_plots(folder / "plots.rrd", plain, world_trajectory, [SPEED, FEET], [STANCE])
    return Stored(plain), together(plain, folder / "plots.rrd")


def together(playback: Path, plots: Path) -> Stored:
    path = plots.with_name("together.rrd")
    assert put_together(path, playback, plots, None) == []
    return Stored(path)


# -- data -----------------------------------------------------------------------------------------------------------


def test_samples_between_frames_are_on_time_alone(both: tuple[Stored, Stored]) -> None:
    _, after = both
    by_time = after.on("time", "/analysis/speed", "Scalars:scalars")
    np.testing.assert_allclose([t.total_seconds() for t in by_time], TIME_S, atol=1e-8)
    np.testing.assert_array_equal(list(by_time.values()), SPEED.values)
    by_frame = after.on("frame", "/analysis/speed", "Scalars:scalars")
    assert by_frame == {frame: [10.0 * (2.0 + (frame / 30.0) ** 2)] for frame in range(10, 16)}


def test_a_gap_breaks_its_own_line_only(both: tuple[Stored, Stored]) -> None:
    _, after = both
    values = np.array(list(after.on("time", "/analysis/feet/height", "Scalars:scalars").values()))
    np.testing.assert_array_equal(values, FEET_M)
    assert np.isnan(values[4:6, 0]).all()
    assert np.isfinite(values[:, 1]).all()


def test_lines_have_their_names_and_colours(both: tuple[Stored, Stored]) -> None:
    static = both[1].static("/analysis/feet/height")
    assert static["SeriesLines:names"] == ["LF", "RF"]
    assert static["SeriesLines:colors"] == [int(f"{r:02x}{g:02x}{b:02x}ff", 16) for r, g, b in (BLUE, ORANGE)]


def test_states_are_rows_with_gaps(both: tuple[Stored, Stored]) -> None:
    _, after = both
    by_time = after.on("time", "/LF.ground", "StateChange:state")
    assert [value[0] if value else "" for value in by_time.values()] == STANDS
    by_frame = after.on("frame", "/LF.ground", "StateChange:state")
    assert {frame: value for frame, value in by_frame.items() if value} == {11: ["stance"]}
    assert sorted(by_frame) == list(range(10, 16))
    assert after.static("/LF.ground")["StateConfiguration:values"] == ["stance", "late"]
    assert after.static("/LF.ground")["StateConfiguration:labels"] == [" ", "late"]
    assert not any(after.on("time", r"/RF\/by\ body", "StateChange:state").values())


def test_the_rest_of_the_recording_is_as_it_was(both: tuple[Stored, Stored]) -> None:
    before, after = both
    assert before.store == after.store
    kept = {entity: rows for entity, rows in after.data.items() if entity in before.data}
    np.testing.assert_equal(kept, before.data)
    assert {entity for entity in after.data if entity not in kept} == {
        "/analysis/speed",
        "/analysis/feet/height",
        "/LF.ground",
        r"/RF\/by\ body",
    }


def test_frames_are_found_by_time_whatever_the_sampling(copy: Path, world_trajectory: Motion) -> None:
    """Times outside the clip lie on no frame, nor does one that is two microseconds off."""
    time_s = np.array([0.0, 10 / 30 - 2e-6, 11 / 30 + 1e-9, 0.4, 17 / 30, 18 / 30])
    values = np.arange(6.0)[:, None]
    plots = copy.with_name("plots.rrd")
    write_plots(
        plots, copy, world_trajectory, [AddedSeries("x", "x", ["x"], [BLUE], values, time_s=time_s, tab="x")], []
    )
    stored = Stored(plots)
    assert stored.on("frame", "/analysis/x", "Scalars:scalars") == {11: [2.0], 12: [3.0], 17: [4.0]}
    assert len(stored.on("time", "/analysis/x", "Scalars:scalars")) == 6


# -- layout ---------------------------------------------------------------------------------------------------------


def test_the_plots_become_the_first_of_the_tabs(both: tuple[Stored, Stored]) -> None:
    before, after = both
    *_, row = before.contents(before.root)
    *_, tabs = after.contents(after.root)
    assert after.field(after.root, "ContainerBlueprint:row_shares") == [5.0, 3.0]
    assert after.field(tabs, "ContainerBlueprint:container_kind") == [TABS]
    first, path, gait = after.contents(tabs)
    assert after.field(tabs, "ContainerBlueprint:active_tab") == [first]
    titles = [after.field(tab, "ContainerBlueprint:display_name") for tab in (first, path, gait)]
    assert titles == [["Reconstruction"], ["Path and speed"], ["Gait"]]
    (inside,) = after.contents(first)
    assert len(after.contents(inside)) == len(before.contents(row))
    views = after.names()
    assert after.contents(path) == [views["Tail base (m/s)"]]
    assert after.contents(gait) == [views["Height (m)"], views["Stances"]]
    assert after.field(gait, "ContainerBlueprint:container_kind") == [HORIZONTAL]


def test_the_views_of_the_playback_are_all_there(both: tuple[Stored, Stored]) -> None:
    before, after = both
    assert {*after.names()} - {*before.names()} == {"Tail base (m/s)", "Height (m)", "Stances"}
    for panel in ("/time_panel", "/blueprint_panel", "/selection_panel"):
        assert [{**row, "log_time": 0} for row in after.layout[panel]] == [
            {**row, "log_time": 0} for row in before.layout[panel]
        ]
    after.without_ids()


def test_plots_look_as_those_of_the_playback(both: tuple[Stored, Stored]) -> None:
    _, after = both
    view = after.names()["Height (m)"]
    assert after.field(view, "ViewBlueprint:class_identifier") == ["TimeSeries"]
    assert after.field(view, "ViewBlueprint:space_origin") == ["analysis/feet/height"]
    # From zero, which is always in sight, to the largest value, and 6 % on either side; above it the two lines' names.
    most = 2.0 + (45 / 90) ** 2
    ((low, high),) = after.field(f"{view}/ScalarAxis", "ScalarAxis:range")
    assert (low, high) == pytest.approx((-0.06 * most - 1e-3, low + (1.12 * most + 2e-3) / 0.8))
    alone = after.names()["Tail base (m/s)"]
    assert after.field(f"{alone}/PlotLegend", "PlotLegend:visible") == [False]
    ((low, high),) = after.field(f"{alone}/ScalarAxis", "ScalarAxis:range")
    assert high == pytest.approx(10.6 * most + 1e-3)
    old = after.names()["Reprojection (px)"]
    for part in ("PlotLegend", "PlotBackground"):
        new_rows, old_rows = ([{**row, "log_time": 0} for row in after.layout[f"/{v}/{part}"]] for v in (view, old))
        assert new_rows == old_rows
    states = after.names()["Stances"]
    assert after.field(states, "ViewBlueprint:class_identifier") == ["StateTimeline"]
    assert after.field(states, "ViewBlueprint:space_origin") == ["/"]
    assert after.field(f"{states}/ViewContents", "ViewContents:query") == ["/LF.ground", r"/RF\/by\ body"]


def test_the_playback_of_the_frame_method_takes_them_too(small_motion: Motion, tmp_path: Path) -> None:
    write(small_motion, tmp_path / "motion.rrd")
    write_plots(tmp_path / "plots.rrd", tmp_path / "motion.rrd", small_motion, [SPEED], [])
    after = together(tmp_path / "motion.rrd", tmp_path / "plots.rrd")
    assert sorted(after.on("frame", "/analysis/speed", "Scalars:scalars")) == list(range(10, 16))
    after.without_ids()


def test_a_picture_holds_a_frame_and_shows_the_first_tab(copy: Path, world_trajectory: Motion) -> None:
    write_plots(copy.with_name("plots.rrd"), copy, world_trajectory, [FEET], [], start_frame=12)
    stored = together(copy, copy.with_name("plots.rrd"))
    ((start, end),) = (r.values() for r in stored.field("time_panel", "TimePanelBlueprint:time_selection"))
    assert (start, end) == (12, 12)
    tabs = stored.contents(stored.root)[-1]
    assert stored.field(tabs, "ContainerBlueprint:active_tab") == stored.contents(tabs)[1:]


# -- files ----------------------------------------------------------------------------------------------------------


def test_the_file_holds_the_plots_and_the_layout_alone(copy: Path, world_trajectory: Motion) -> None:
    content = copy.read_bytes()
    plots = copy.with_name("plots.rrd")
    write_plots(plots, copy, world_trajectory, [SPEED, FEET], [STANCE])
    alone = Stored(plots)
    assert alone.store == Stored(copy).store
    assert {entity.split("/")[1] for entity in alone.data} == {"analysis", "LF.ground", "RF\\"}
    assert {"Tail base (m/s)", "Reprojection (px)"} <= {*alone.names()}
    assert copy.read_bytes() == content
    assert sorted(file.name for file in copy.parent.iterdir()) == ["motion.rrd", "plots.rrd"]


def test_plots_of_another_recording_are_left_out(copy: Path, world_trajectory: Motion, tmp_path: Path) -> None:
    """As those of a fit that has been made again."""
    plots, path = tmp_path / "plots.rrd", tmp_path / "together.rrd"
    write_plots(plots, copy, world_trajectory, [SPEED], [])
    before = Stored(copy)
    write(world_trajectory, copy)
    assert put_together(path, copy, plots, None) == [plots]
    assert Stored(path).data.keys() == before.data.keys()
    assert Stored(path).without_ids() == before.without_ids()


def test_a_playback_alone_stays_as_it_is(plain: Path, tmp_path: Path) -> None:
    assert put_together(tmp_path / "together.rrd", plain, None, None) == []
    np.testing.assert_equal(Stored(tmp_path / "together.rrd").data, Stored(plain).data)
    assert Stored(tmp_path / "together.rrd").without_ids() == Stored(plain).without_ids()


def _foreign(path: Path) -> None:
    stream = rr.RecordingStream("other")
    stream.save(path, default_blueprint=rrb.Blueprint(rrb.TimeSeriesView(origin="a")))
    stream.send_columns("a", [rr.TimeColumn("step", sequence=[1, 2])], rr.Scalars.columns(scalars=[1.0, 2.0]))
    stream.flush()
    stream.disconnect()


def _without_layout(path: Path) -> None:
    stream = rr.RecordingStream("recon")
    stream.save(path)
    times = [rr.TimeColumn("frame", sequence=[10, 11]), rr.TimeColumn("time", duration=[10 / 30, 11 / 30])]
    stream.send_columns("speed", times, rr.Scalars.columns(scalars=[1.0, 2.0]))
    stream.flush()
    stream.disconnect()


@pytest.mark.parametrize(
    ("spoil", "found"),
    [
        (Path.unlink, "no such file"),
        (lambda path: path.write_bytes(b""), "cannot read"),
        (lambda path: path.write_text("frame,x\n1,2\n"), "cannot read"),
        (lambda path: path.write_bytes(path.read_bytes()[:-40]), "lost its end"),
        (lambda path: path.write_bytes(path.read_bytes()[: path.stat().st_size // 2]), "lost its end"),
        (_foreign, "of another kind"),
        (_without_layout, "of another kind"),
    ],
    ids=["missing", "empty", "text", "no end", "half", "foreign", "no layout"],
)
def test_what_is_no_playback_is_refused_and_left(
    copy: Path, world_trajectory: Motion, spoil: Callable[[Path], Any], found: str
) -> None:
    spoil(copy)
    content = copy.read_bytes() if copy.exists() else None
    with pytest.raises(InputError, match=found) as caught:
        write_plots(copy.with_name("plots.rrd"), copy, world_trajectory, [SPEED], [STANCE])
    (problem,) = caught.value.problems
    assert problem.file == copy
    assert (copy.read_bytes() if copy.exists() else None) == content
    assert [file.name for file in copy.parent.iterdir()] == ([] if content is None else ["motion.rrd"])


def test_series_of_another_clip_are_refused(copy: Path, world_trajectory: Motion) -> None:
    later = AddedSeries("x", "Far away", ["x"], [BLUE], FEET_M[:, 1:], time_s=TIME_S + 100.0, tab="x")
    between = AddedSeries("y", "Between", ["y"], [BLUE], FEET_M[:, 1:], time_s=TIME_S + 1 / 300, tab="x")
    empty = AddedStates(title="Empty", rows=[("LF", [], {})], time_s=np.empty(0), tab="x")
    with pytest.raises(InputError) as caught:
        write_plots(copy.with_name("plots.rrd"), copy, world_trajectory, [SPEED, later, between], [STANCE, empty])
    assert [problem.found for problem in caught.value.problems] == [
        "none at the 16 times of 'Far away'",
        "none at the 16 times of 'Between'",
        "none at the 0 times of 'Empty'",
    ]


def test_two_plots_of_one_entity_are_a_mistake(copy: Path, world_trajectory: Motion) -> None:
    with pytest.raises(ValueError, match="entities must differ: analysis/speed, analysis/speed"):
        write_plots(copy.with_name("plots.rrd"), copy, world_trajectory, [SPEED, SPEED], [])
