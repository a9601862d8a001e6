"""Which views there are, where they are, and from where they look."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.archetypes import PlotBackground
from rerun.encodings import AbsoluteTimeRange

from recon.fit.motion import MEASURED_SHARE, Motion, Picture
from recon.show.view.picture import CLOSE, middle_and_reach_px, picture_bounds
from recon.show.view.scene import BACKGROUND, BODY, CLOSEUP, GRID_SPACING_M, PICTURE, Scene, by_camera
from recon.show.view.series import TimePlot, angle_series, other_series, state_entities


def blueprint(
    motion: Motion, scene: Scene, start_frame: int | None, added: Sequence[rrb.Container] = ()
) -> rrb.Blueprint:
    """added: tabs beside the plots, of which the first is in front where a frame is held."""
    upto_now = rrb.VisibleTimeRanges(
        [
            rr.VisibleTimeRange(t, start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.cursor_relative())
            for t in ("frame", "time")
        ]
    )
    trail = {"world/trail": [upto_now]}
    sticks, body, seen = (
        rrb.Spatial3DView(
            origin="world",
            name=name,
            contents=["$origin/**", *(f"- {entity}" for entity in without)],
            background=BACKGROUND,
            line_grid=False,
            eye_controls=_eye_on_animal(motion, scene, turn_rad),
            overrides=trail,  # pyright: ignore[reportArgumentType]
        )
        for name, turn_rad, without in (
            (_title(motion), 0.0, [BODY, _SEEN]),
            ("Body", 0.0, ["world/skeleton/**", "world/uncertainty", "world/stance", _SEEN]),
            (
                f"What is seen: axes of the joints, blue: {MEASURED_SHARE:.0%} or more by the pixels",
                0.7,  # so that axes across the animal do not point at the eye
                ["world/skeleton/**", "world/uncertainty", "world/stance", BODY],
            ),
        )
    )
    overview = rrb.Spatial3DView(
        origin="world",
        name="Overview with the camera" + ("s" if len(motion.pictures) > 1 else ""),
        contents=["$origin/**", "- world/doubt", f"- {BODY}", f"- {_SEEN}"],
        background=BACKGROUND,
        line_grid=False,
        eye_controls=_eye_on_all(motion, scene),
        overrides=trail,  # pyright: ignore[reportArgumentType]
    )
    angles, others = angle_series(motion), other_series(motion)
    plots: list[rrb.View | rrb.Container] = [rrb.Tabs(*(plot(series) for series in angles), active_tab=0)]
    plots += [plot(series) for series in others]
    plots.append(state_rows(state_entities(motion), "Doubtful frames, feet that stand"))
    shares = [4, *([3] * len(others)), 4]
    below: rrb.Container = rrb.Horizontal(*plots, column_shares=shares)
    if added:
        front = 0 if start_frame is None else 1
        below = rrb.Tabs(rrb.Vertical(below, name=PRESENT), *added, active_tab=front)
    content = rrb.Vertical(
        rrb.Horizontal(
            rrb.Tabs(sticks, body, seen, active_tab=0),
            rrb.Vertical(_pictures(motion.pictures), overview, row_shares=[5, 4]),
            column_shares=[11, 9],
        ),
        below,
        row_shares=[5, 3],
    )
    fps = min(motion.fps, max(5.0, len(motion.frames) / 5))
    return laid_out(content, len(motion.frames), fps, start_frame)


def laid_out(content: rrb.Container, count: int, fps: float, start_frame: int | None) -> rrb.Blueprint:
    """The viewer shows this and nothing else. It plays `count` frames in a loop, or holds start_frame."""
    time = rrb.TimePanel(state="collapsed", timeline="frame", fps=fps, play_state="playing", loop_mode="all")
    return rrb.Blueprint(
        content,
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        time if start_frame is None else held_at(start_frame, count),
        auto_layout=False,
        auto_views=False,
    )


def _pictures(pictures: Sequence[Picture]) -> rrb.Tabs:
    """A close look and the whole picture; of several cameras all of them side by side."""
    closeups = [_closeup(*of_one) for of_one in zip(by_camera(CLOSEUP, pictures), pictures, strict=True)]
    wholes = [_whole(*of_one) for of_one in zip(by_camera(PICTURE, pictures), pictures, strict=True)]
    if len(pictures) == 1:
        closeups[0].name, wholes[0].name = f"Picture, {_MARKS}", "Whole picture"
        return rrb.Tabs(closeups[0], wholes[0], active_tab=0)
    grids = rrb.Grid(*closeups, name=f"Pictures, {_MARKS}"), rrb.Grid(*wholes, name="Whole pictures")
    return rrb.Tabs(*grids, active_tab=0)


PRESENT = "Reconstruction"
"""The tab of the fit's own plots, where there are others."""
_SEEN = "world/observability/**"
_MARKS = "close up: + detected, ● reprojected, red: outlier"


def _closeup(entity: str, picture: Picture) -> rrb.Spatial2DView:
    wide, high = CLOSE * middle_and_reach_px(picture)[1]
    bounds = rrb.VisualBounds2D(x_range=(-wide, wide), y_range=(-high, high))
    return rrb.Spatial2DView(origin=entity, name=picture.name, background=BACKGROUND, visual_bounds=bounds)


def _whole(entity: str, picture: Picture) -> rrb.Spatial2DView:
    low, high = picture_bounds(picture)
    bounds = rrb.VisualBounds2D(x_range=(low[0], high[0]), y_range=(low[1], high[1]))
    return rrb.Spatial2DView(origin=entity, name=picture.name, background=BACKGROUND, visual_bounds=bounds)


def held_at(frame: int, count: int) -> rrb.TimePanel:
    """The time held at one of `count` frames."""
    # A blueprint has no place for the current time, but a loop over one frame, soon reached, stays there.
    return rrb.TimePanel(
        state="collapsed",
        timeline="frame",
        fps=100.0 * count,
        play_state="playing",
        loop_mode="selection",
        time_selection=AbsoluteTimeRange(frame, frame),  # pyright: ignore[reportArgumentType]
    )


def _title(motion: Motion) -> str:
    title = f"3D, {motion.frame_of_reference} frame, grid of {GRID_SPACING_M:g} m"
    if motion.side is None:
        title += "; left blue, right orange"
    return title + "; shells: one sigma"


_LINE_SHARE, _LEGEND_SHARE, _MOST_SHARE = 0.075, 0.05, 0.6
"""Of a plot's height in a window of 1080 px: what each line's name takes of it, all their frame, and at most."""


def plot(series: TimePlot) -> rrb.TimeSeriesView:
    """With room above the lines for their names; one line alone is named by the title."""
    values = series.values if series.shown is None else series.shown
    known = np.append(values[np.isfinite(values)], 0.0)  # all of them have zero in sight
    least, most = known.min(), known.max()
    margin = 0.06 * (most - least) + 1e-3
    several = len(series.names) > 1
    share = min(_LINE_SHARE * len(series.names) + _LEGEND_SHARE, _MOST_SHARE) if several else 0.0
    room = (most - least + 2 * margin) * share / (1 - share)
    return rrb.TimeSeriesView(
        origin=series.entity,
        name=series.title,
        axis_y=rrb.ScalarAxis(range=(least - margin, most + margin + room)),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=several),
        background=PlotBackground(color=BACKGROUND),
    )


def state_rows(entities: Sequence[str], name: str) -> rrb.StateTimelineView:
    return rrb.StateTimelineView(origin="/", contents=[f"/{entity}" for entity in entities], name=name)


def _eye_on_animal(motion: Motion, scene: Scene, turn_rad: float) -> rrb.EyeControls3D:
    """Going along with the animal, on the camera's side of it, turned about the vertical, and slightly raised."""
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
    side = side / max(float(np.linalg.norm(side)), 1e-9)
    direction = np.cos(turn_rad) * side + np.sin(turn_rad) * np.cross(up, side) + 0.3 * up
    target = poses[0].mean(axis=0)
    position = target + (1.05 * scene.size_m + 0.4) * direction
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=position,
        look_target=target,
        eye_up=up,
        tracking_entity="world/followed",
    )


_HALF_FIELD, _ASPECT = np.tan(np.radians(55 / 2)), 2.2
"""Of the viewer's eye: the tangent of half its vertical field of view; width to height of the overview."""


def _eye_on_all(motion: Motion, scene: Scene) -> rrb.EyeControls3D:
    """From above, and nearest to the animal among the directions, rather from behind the first camera, that have all
    cameras and the whole path in sight."""
    up = scene.axes[2]
    cameras = [picture.T_reference_camera.reshape(-1, 4, 4)[:, :3, 3].mean(axis=0) for picture in motion.pictures]
    corners = np.stack(np.meshgrid(*np.stack((scene.low_m, scene.high_m), axis=1), indexing="ij"), axis=-1)
    points = np.concatenate((cameras, corners.reshape(-1, 3) @ scene.axes))
    ahead = (scene.centre_m - scene.camera_m) @ scene.axes[:2].T
    nearest, position, target = np.inf, scene.camera_m, scene.centre_m
    for turned in np.arctan2(*ahead[::-1]) + np.radians(np.arange(-60, 61, 15)):
        look = np.array([np.cos(turned), np.sin(turned), -0.5]) @ scene.axes / np.hypot(1.0, 0.5)
        right = np.cross(look, up) / np.linalg.norm(np.cross(look, up))
        axes = np.stack((right, np.cross(right, look), look))
        seen = points @ axes.T
        middle = (seen.min(axis=0) + seen.max(axis=0)) / 2
        x, y, z = (seen - middle).T
        distance = 1.05 * np.max(np.maximum(np.abs(x) / _ASPECT, np.abs(y)) / _HALF_FIELD - z)
        at = middle @ axes
        away = float((scene.centre_m - at) @ look + distance)
        if away < nearest:
            nearest, target, position = away, at, at - distance * look
    return rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=position, look_target=target, eye_up=up)
