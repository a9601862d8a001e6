"""Which views there are, where they are, and from where they look."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.archetypes import PlotBackground

from recon.base.arrays import Array
from recon.fit.motion import Motion, Picture
from recon.show.view import scene as drawn


def blueprint(
    motion: Motion, scene: drawn.Scene, plots: Sequence[drawn.TimePlot], rows: Sequence[str]
) -> rrb.Blueprint:
    """plots: those without a tab stand in the row that is in front, the angles among them in one place; rows: entities
    of states."""
    several = "s" if len(motion.pictures) > 1 else ""
    skeleton = _in_space(_title(motion), _eye_on_animal(motion, scene))
    # Where nothing says from where to look, the viewer has all of the scene in sight.
    overview = _in_space(f"Overview with the camera{several}", rrb.EyeControls3D(eye_up=scene.axes[2]))
    front = [plot for plot in plots if not plot.tab]
    angles = [time_view(plot) for plot in front if plot.entity.startswith("angles/")]
    others = [time_view(plot) for plot in front if not plot.entity.startswith("angles/")]
    marks = state_rows(rows, "Doubtful frames, feet that stand")
    shares = [4, *([3] * len(others)), 4]
    below: rrb.Container = rrb.Horizontal(rrb.Tabs(*angles, active_tab=0), *others, marks, column_shares=shares)
    if tabs := dict.fromkeys(plot.tab for plot in plots if plot.tab):
        added = [rrb.Horizontal(*(time_view(plot) for plot in plots if plot.tab == tab), name=tab) for tab in tabs]
        below = rrb.Tabs(rrb.Vertical(below, name="Reconstruction"), *added, active_tab=0)
    seen = rrb.Vertical(_pictures(motion.pictures), overview, row_shares=[5, 4])
    content = rrb.Vertical(rrb.Horizontal(skeleton, seen, column_shares=[11, 9]), below, row_shares=[5, 3])
    return laid_out(content, min(motion.fps, max(5.0, len(motion.frames) / 5)))


def laid_out(content: rrb.Container, fps: float) -> rrb.Blueprint:
    """The viewer shows this and nothing else, and plays it in a loop."""
    return rrb.Blueprint(
        content,
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline="frame", fps=fps, play_state="playing", loop_mode="all"),
        auto_layout=False,
        auto_views=False,
    )


def _in_space(name: str, eye: rrb.EyeControls3D) -> rrb.Spatial3DView:
    """The world, with the trail up to the current frame."""
    start, end = rr.TimeRangeBoundary.infinite(), rr.TimeRangeBoundary.cursor_relative()
    upto_now = rrb.VisibleTimeRanges([rr.VisibleTimeRange(t, start=start, end=end) for t in ("frame", "time")])
    return rrb.Spatial3DView(
        origin="world",
        name=name,
        background=drawn.BACKGROUND,
        line_grid=False,
        eye_controls=eye,
        overrides={"world/trail": [upto_now]},  # pyright: ignore[reportArgumentType]
    )


def _pictures(pictures: Sequence[Picture]) -> rrb.Tabs:
    """A close look and the whole picture; of several cameras all of them side by side."""
    closeups, wholes = [], []
    entities = drawn.by_camera(drawn.CLOSEUP, pictures), drawn.by_camera(drawn.PICTURE, pictures)
    for picture, close, whole in zip(pictures, *entities, strict=True):
        reach, (low, high) = drawn.CLOSE * drawn.middle_and_reach_px(picture)[1], drawn.picture_bounds(picture)
        closeups.append(_flat(close, picture.name, -reach, reach))
        wholes.append(_flat(whole, picture.name, low, high))
    if len(pictures) == 1:
        closeups[0].name, wholes[0].name = f"Picture, {_MARKS}", "Whole picture"
        return rrb.Tabs(closeups[0], wholes[0], active_tab=0)
    grids = rrb.Grid(*closeups, name=f"Pictures, {_MARKS}"), rrb.Grid(*wholes, name="Whole pictures")
    return rrb.Tabs(*grids, active_tab=0)


_MARKS = "close up: white detected, ● reprojected, red: outlier"


def _flat(entity: str, name: str, low: Array, high: Array) -> rrb.Spatial2DView:
    bounds = rrb.VisualBounds2D(x_range=(low[0], high[0]), y_range=(low[1], high[1]))
    return rrb.Spatial2DView(origin=entity, name=name, background=drawn.BACKGROUND, visual_bounds=bounds)


def _title(motion: Motion) -> str:
    title = f"3D, {motion.frame_of_reference} frame, grid of {drawn.GRID_SPACING_M:g} m"
    if motion.side is None:
        title += "; left blue, right orange"
    return title + "; shells: one sigma"


def time_view(series: drawn.TimePlot) -> rrb.TimeSeriesView:
    """One line alone is named by the title."""
    return rrb.TimeSeriesView(
        origin=series.entity,
        name=series.title,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=len(series.names) > 1),
        background=PlotBackground(color=drawn.BACKGROUND),
    )


def state_rows(entities: Sequence[str], name: str) -> rrb.StateTimelineView:
    return rrb.StateTimelineView(origin="/", contents=[f"/{entity}" for entity in entities], name=name)


def _eye_on_animal(motion: Motion, scene: drawn.Scene) -> rrb.EyeControls3D:
    """Going along with the animal, on the camera's side of it, and slightly raised."""
    up = scene.axes[2]
    poses, path = motion.joints_m[motion.solved], motion.root_m[motion.solved]
    if not len(poses):
        return rrb.EyeControls3D(eye_up=up)
    travel = path[-1] - path[0]
    travel -= up * (travel @ up)
    side = scene.camera_m - scene.centre_m
    side -= up * (side @ up)
    if np.linalg.norm(travel) > scene.size_m:
        across = np.cross(up, travel)
        side = across if across @ side >= 0 else -across
    direction = side / max(float(np.linalg.norm(side)), 1e-9) + 0.3 * up
    target = poses[0].mean(axis=0)
    position = target + (1.05 * scene.size_m + 0.4) * direction
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=position,
        look_target=target,
        eye_up=up,
        tracking_entity="world/followed",
    )
