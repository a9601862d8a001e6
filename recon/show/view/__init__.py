"""Write a motion as a rerun recording for playback, and open a recording in rerun's viewer.

The recording has the following entities. Entities without "(static)" have a row per frame, which is empty if the frame
has no pose. States and points that are often absent have rows only where they change, and ellipsoids have a new shape
at most 25 times a second.

- `world` is in metres, in the motion's frame of reference. It contains `world/skeleton` and its joints; `world/path`
  (static) and `world/trail` of the reference point; `world/ground` (static, or for several segments the ground of each
  segment from its first frame on); `world/camera`, the camera's frustum (static, unless the camera moves);
  `world/followed`, an invisible box that the view follows; `world/uncertainty`, one standard deviation of the joints'
  positions relative to their mean, red in flagged frames; and `world/stance`, the feet in stance.
- `picture` is in pixels of the distorted picture. It contains `picture/frame`, the picture's edge (static);
  `picture/detections`; `picture/outliers`; `picture/reprojections` with the skeleton's lines; `picture/links` between
  detections and reprojections, except links that their dots would hide; `picture/animal`, the middle of the reprojected
  skeleton, on which the close view is centred; and `picture/video`, the frames of a video, if given.
- If there are several cameras, each has its own `world/camera/<name>` and `picture/<name>/...`, and
  `world/camera_names` has their names.
- `angles/...` has the angles in degrees as `left`, `right` and `middle`, split if there are many. `speed` is the speed
  of the reference point in m/s. `residuals` are in px over all cameras, the median of a frame and the largest one
  without outliers.
- `uncertainty` is in m. States over time show which frames have each flag, and when each foot is in stance.
- If an analysis is given, `analysis/...` has its curves, and `world/forces` arrows under the feet, with the path
  `world/forces/centre_of_mass`.

The timelines are `frame`, the frame number of the keypoint file, and `time`, seconds since frame 0 of that file.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.archetypes import PlotBackground

from recon.animal.body import side_of
from recon.animal.naming import without_side
from recon.base.arrays import Array, Bools
from recon.base.errors import InputError, Problem
from recon.base.file_names import encodable
from recon.base.numbers import quantity
from recon.check.verdict import frame_rms_m
from recon.fit.motion import Motion, Picture
from recon.gait.clip import ClipAnalysis
from recon.gait.kinematics import speed_at_frames
from recon.gait.series import frame_jitter_m
from recon.gait.stances import interval_of
from recon.show.view import scene as scenes
from recon.show.view.scene import Log, Scene, TimePlot, limb_colours, recording

OVERVIEW_ASPECT = 3.0
"""Width of the overview of the world relative to its height."""
OVERVIEW_RAISED = 0.4
"""Height of the overview's eye above its target, as a fraction of the horizontal distance between them."""
VIEW_RAD = np.radians(55.0)
"""Vertical angle of view of rerun's viewer, in radians."""
LINE_OF_LEGEND = 0.1
"""Fraction of a plot's height that a line of the legend takes."""
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
"""Environment variables of which at least one is set if a Linux machine has a display."""


def write(
    motion: Motion,
    path: Path,
    analysis: ClipAnalysis | None = None,
    video: Path | None = None,
    first_frame: int = 0,
    camera: int = 0,
) -> None:
    """Write the recording of a motion, with the blueprint that lays out its views.

    The viewer plays the recording in a loop, slowly if the clip is short.

    Parameters
    ----------
    motion : Motion
        The fit.
    path : path
        File to write.
    analysis : ClipAnalysis, optional
        Analysis of the motion, whose plots get their own tabs.
    video : path, optional
        Video to show behind the picture of a camera.
    first_frame : int
        Frame number, in the clip, of the video's first frame.
    camera : int
        Index of the camera that recorded the video.
    """
    scenes.require_whole()
    scene, standing = Scene.from_motion(motion), (analysis or motion.derived(ClipAnalysis)).standing
    plots = [*angle_plots(motion), *other_plots(motion), *(() if analysis is None else analysis_plots(analysis))]
    rows = states(motion, standing)
    with recording(path, blueprint(motion, scene, plots, [*rows])) as stream:
        stream.send_recording_name(encodable(Path(motion.keypoints.source or motion.title).stem))
        log = Log(stream, motion.frames, motion.time_s)
        labels = zip(motion.limbs, limb_colours(motion), strict=True)
        log.fix("/", rr.AnnotationContext([(i, limb, colour) for i, (limb, colour) in enumerate(labels)]))
        scenes.write_world(motion, scene, log)
        scenes.write_pictures(motion, log)
        scenes.write_uncertainty(motion, log, standing)
        for plot in plots:
            log.plot(plot)
        for entity, (text, colour, holds) in rows.items():
            log.state(entity, text, colour, holds)
        if analysis is not None:
            write_forces(analysis, log)
        if video is not None:
            scenes.write_video(motion, log, video, first_frame, camera)


def blueprint(motion: Motion, scene: Scene, plots: Sequence[TimePlot], rows: Sequence[str]) -> rrb.Blueprint:
    """Return the layout of the views in which the viewer shows a motion.

    `plots` without a tab are in the front row, and all angles share a group of tabs. `rows` are the entities of states.
    """
    several = "s" if len(motion.pictures) > 1 else ""
    skeleton = _world_view(_title(motion), _eye_on_animal(motion, scene))
    overview = _world_view(f"Overview with the camera{several}", _eye_on_all(motion, scene))
    front = [plot for plot in plots if not plot.tab]
    angles = [time_view(plot) for plot in front if plot.entity.startswith("angles/")]
    other_plots_shown = [time_view(plot) for plot in front if not plot.entity.startswith("angles/")]
    state_view = state_rows(rows, "Flagged frames, standing feet")
    column_shares = [4, *([3] * len(other_plots_shown)), 4]
    lower: rrb.Container = rrb.Horizontal(
        rrb.Tabs(*angles, active_tab=0), *other_plots_shown, state_view, column_shares=column_shares
    )
    if tabs := dict.fromkeys(plot.tab for plot in plots if plot.tab):
        tab_views = [rrb.Horizontal(*(time_view(plot) for plot in plots if plot.tab == tab), name=tab) for tab in tabs]
        lower = rrb.Tabs(rrb.Vertical(lower, name="Reconstruction"), *tab_views, active_tab=0)
    pictures = rrb.Vertical(_pictures(motion.pictures), overview, row_shares=[5, 4])
    content = rrb.Vertical(rrb.Horizontal(skeleton, pictures, column_shares=[11, 9]), lower, row_shares=[5, 3])
    return laid_out(content, min(motion.fps, max(5.0, len(motion.frames) / 5)))


def laid_out(content: rrb.Container, fps: float) -> rrb.Blueprint:
    """Return a blueprint that shows `content` alone and plays the recording in a loop."""
    hidden = rrb.BlueprintPanel(state="hidden"), rrb.SelectionPanel(state="hidden")
    time = rrb.TimePanel(state="collapsed", timeline="frame", fps=fps, play_state="playing", loop_mode="all")
    return rrb.Blueprint(content, *hidden, time, auto_layout=False, auto_views=False)


def _world_view(name: str, eye: rrb.EyeControls3D) -> rrb.Spatial3DView:
    """Return a 3D view that shows the trail of the animal's reference point up to the current frame."""
    start, end = rr.TimeRangeBoundary.infinite(), rr.TimeRangeBoundary.cursor_relative()
    upto_now = rrb.VisibleTimeRanges([rr.VisibleTimeRange(t, start=start, end=end) for t in ("frame", "time")])
    return rrb.Spatial3DView(
        origin="world",
        name=name,
        background=scenes.BACKGROUND,
        line_grid=False,
        eye_controls=eye,
        overrides={"world/trail": [upto_now]},  # pyright: ignore[reportArgumentType]
    )


def _pictures(pictures: Sequence[Picture]) -> rrb.Tabs:
    """Return tabs of close views and whole pictures, with the pictures of several cameras next to each other."""
    closeups, wholes = [], []
    for picture, entity in zip(pictures, scenes.by_camera(scenes.PICTURE, pictures), strict=True):
        reach, (low, high) = (
            scenes.CLOSE_VIEW_SIZE * scenes.middle_and_reach_px(picture)[1],
            scenes.picture_bounds(picture),
        )
        contents = [f"+ /{entity}/**", f"- /{entity}/{scenes.EDGE_OF_PICTURE}"]
        closeups.append(_picture_view(f"{entity}/{scenes.ANIMAL}", picture.name, -reach, reach, contents))
        wholes.append(_picture_view(entity, picture.name, low, high))
    if len(pictures) == 1:
        closeups[0].name, wholes[0].name = f"Picture, {_MARKS}", "Whole picture"
        return rrb.Tabs(closeups[0], wholes[0], active_tab=0)
    grids = rrb.Grid(*closeups, name=f"Pictures, {_MARKS}"), rrb.Grid(*wholes, name="Whole pictures")
    return rrb.Tabs(*grids, active_tab=0)


_MARKS = "close up: white detected, ● reprojected, magenta: distance between them, red: outlier"


def _picture_view(
    entity: str, name: str, low: Array, high: Array, contents: Sequence[str] = ("$origin/**",)
) -> rrb.Spatial2DView:
    bounds = rrb.VisualBounds2D(x_range=(low[0], high[0]), y_range=(low[1], high[1]))
    background = scenes.BACKGROUND
    return rrb.Spatial2DView(
        origin=entity, contents=[*contents], name=name, background=background, visual_bounds=bounds
    )


def _title(motion: Motion) -> str:
    title = f"3D, {motion.frame_of_reference} frame, grid of {scenes.GRID_SPACING_M:g} m"
    if motion.side is None:
        title += "; left blue, right orange"
    return title + "; white: standing foot; yellow: path so far; ellipsoids: one standard deviation"


def time_view(series: TimePlot) -> rrb.TimeSeriesView:
    """Return the view of a plot, in which the title names a single line, and a legend names several."""
    values = series.values[np.isfinite(series.values)]
    low, high = (values.min(), values.max()) if len(values) else (0.0, 0.0)
    legend_lines = len(series.names) if len(series.names) > 1 else 0
    fraction = min(legend_lines * LINE_OF_LEGEND, 0.5)
    headroom = (high - low) * fraction / (1 - fraction)
    return rrb.TimeSeriesView(
        origin=series.entity,
        name=series.title,
        axis_y=rrb.ScalarAxis(range=(low, high + headroom)) if headroom else None,
        plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=legend_lines > 0),
        background=PlotBackground(color=scenes.BACKGROUND),
    )


def state_rows(entities: Sequence[str], name: str) -> rrb.StateTimelineView:
    """Return a view that shows when states such as flags and stances hold."""
    return rrb.StateTimelineView(origin="/", contents=[f"/{entity}" for entity in entities], name=name)


_orbit = partial(rrb.EyeControls3D, kind=rrb.Eye3DKind.Orbital)


def _eye_on_animal(motion: Motion, scene: Scene) -> rrb.EyeControls3D:
    """Return a viewpoint for rerun's 3D view that follows the animal, on the camera's side and slightly raised."""
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
    return _orbit(position=position, look_target=target, eye_up=up, tracking_entity="world/followed")


def _eye_on_all(motion: Motion, scene: Scene) -> rrb.EyeControls3D:
    """Return a viewpoint for rerun's 3D view that shows the cameras and the animal's path."""
    cameras_m = [picture.T_reference_camera[..., :3, 3].reshape(-1, 3) for picture in motion.pictures]
    box_m = np.array([*product(*zip(scene.low_m, scene.high_m, strict=True))]) @ scene.axes
    points = np.concatenate([box_m, *cameras_m])
    position, target = fitting_eye(points[np.isfinite(points).all(axis=1)], scene.axes, 0.5 * scene.size_m)
    return _orbit(position=position, look_target=target, eye_up=scene.axes[2])


def fitting_eye(points_m: Array, axes: Array, margin_m: float = 0.0) -> tuple[Array, Array]:
    """Return a viewpoint (3,) slightly above points (N, 3), near but showing all of them, and its target (3,).

    `axes` are `Scene.axes`, and `margin_m` is added to the distance from the target.
    """
    turns_rad = np.linspace(0.0, 2 * np.pi, 72, endpoint=False)
    right = np.stack([np.cos(turns_rad), np.sin(turns_rad)], axis=1) @ axes[:2]
    back = (np.cross(right, axes[2]) + OVERVIEW_RAISED * axes[2]) / np.hypot(1.0, OVERVIEW_RAISED)
    views = np.stack([right, np.cross(back, right), back], axis=1)
    seen_m = points_m @ views.transpose(0, 2, 1)
    middles_m = (seen_m.min(axis=1) + seen_m.max(axis=1)) / 2
    across, upright, depth = np.moveaxis(seen_m - middles_m[:, None], 2, 0)
    reach = np.maximum(np.abs(upright), np.abs(across) / OVERVIEW_ASPECT) / np.tan(VIEW_RAD / 2)
    distances_m = np.max(depth + reach, axis=1)
    nearest = int(np.argmin(distances_m))
    target_m = middles_m[nearest] @ views[nearest]
    return target_m + (1.1 * distances_m[nearest] + margin_m) * back[nearest], target_m


def open_viewer(path: Path) -> None:
    """Show a recording in rerun's viewer and wait until it is closed.

    Raises
    ------
    InputError
        If the viewer cannot run.
    """
    if sys.platform == "linux" and not any(os.environ.get(name) for name in DISPLAYS):
        expected = (
            "a display; without one, watch in a browser (--web), or make a page (recon report DIR) or a recording "
            "(--out FILE.rrd)"
        )
        raise InputError(Problem("recon view", "viewer", "no display", expected))
    command = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(path)]
    code = subprocess.run(command, check=False).returncode
    if code:
        ending = f"that rerun ended with exit code {code}"
        expected = "a display; without one, make a recording (--out FILE.rrd) for rerun on another machine"
        raise InputError(Problem("recon view", "viewer", ending, expected))


MAX_LINES = 4
"""Largest number of angles in a plot if the angles can be split by part of the animal."""


def states(motion: Motion, standing: Bools) -> dict[str, tuple[str, scenes.Colour, Bools]]:
    """Return label, colour and mask of frames (T,) of each flag and of each foot's stances, by entity.

    `standing` (T, F) states in which frames each foot is in stance. Names of entities have no parent, which the viewer
    would show, and no blanks, which the viewer would escape.
    """
    flag_names = dict.fromkeys(flag for frame_flags in motion.flags for flag in frame_flags)
    flags = {flag: np.array([flag in frame_flags for frame_flags in motion.flags]) for flag in flag_names}
    rows = {flag.replace(" ", "_"): (flag, scenes.OUTLIER, holds) for flag, holds in flags.items()}
    for foot, label, stands in zip(motion.feet, motion.foot_labels, standing.T, strict=True):
        rows[motion.names[foot]] = "stance", _foot_colour(label), stands
    return {rr.escape_entity_path_part(name): row for name, row in rows.items()}


def _plot(
    entity: str,
    title: str,
    lines: Mapping[str, Array],
    tab: str = "",
    colours: Sequence[scenes.Colour] = scenes.LINE_COLOURS,
) -> TimePlot:
    """Return a plot of named lines, each of shape (T,), coloured in the order of `colours`."""
    line_colours = [colours[i % len(colours)] for i in range(len(lines))]
    return TimePlot(entity, title, [*lines], line_colours, np.stack([*lines.values()], axis=1), tab)


def angle_plots(motion: Motion) -> Iterator[TimePlot]:
    """Yield a plot of the angles of each side in degrees, split by part of the animal or kind if there are too many."""
    keys: dict[str, dict[str, str]] = {kind: {} for kind in ("left", "right", "middle")}
    for name in motion.angle_names:
        words, side = without_side(name).split("_"), side_of(name)
        keys[side or "middle"][name] = words[-1] if side is None and words[0] not in ("theta", "phi") else words[0]
    for kind, keys_of_kind in keys.items():
        for key, names in _parts(keys_of_kind):
            entity = f"angles/{kind}" + f"/{key.replace(', ', '_')}" * bool(key)
            degrees = np.degrees(motion.angles_rad[:, [motion.angle_names.index(name) for name in names]])
            lines = {
                without_side(name).replace("_", " "): column for name, column in zip(names, degrees.T, strict=True)
            }
            yield _plot(entity, f"{kind} {key}".strip().capitalize() + " (°)", lines)


def _parts(keys: Mapping[str, str]) -> Iterator[tuple[str, list[str]]]:
    """Yield the names of each plot's lines, grouped by key if there are too many for one plot.

    Successive groups share a plot if they fit.
    """
    if len(keys) <= MAX_LINES:
        yield from [("", [*keys])] if keys else []
        return
    parts: list[tuple[str, list[str]]] = []
    for key in dict.fromkeys(keys.values()):
        names = [name for name, value in keys.items() if value == key]
        if parts and len(parts[-1][1]) + len(names) <= MAX_LINES:
            parts[-1] = (f"{parts[-1][0]}, {key}", [*parts[-1][1], *names])
        else:
            parts.append((key, names))
    yield from parts


def other_plots(motion: Motion) -> Iterator[TimePlot]:
    """Yield plots of the animal's speed, the reprojection errors, and the joints' uncertainty.

    The plot of the largest reprojection error excludes outliers, which would hide the other errors.
    """
    speed = np.where(motion.solved, speed_at_frames(motion.time_s, motion.root_m), np.nan)
    run_m_s, lines, title = motion.solution.constant_velocity_m_s, {"speed": speed}, "Speed (m/s)"
    if run_m_s is not None:
        path_known = np.isfinite(frame_jitter_m(motion.root_m)).all()
        smooth = speed_at_frames(motion.time_s, motion.root_m, smooth=True) if path_known else speed
        lines = {"smoothed by its jitter": smooth, "straight run": run_m_s, "cubic spline": speed}
        lines = {name: np.where(motion.solved, values, np.nan) for name, values in lines.items()}
    elif np.isfinite(speed).any():
        title = f"Speed, {np.nanmin(speed):.1f} to {quantity(np.nanmax(speed), 1, 'm/s')}"
    yield _plot("speed", title, lines, colours=(scenes.TRAIL, scenes.LIMB_COLOURS[0], scenes.EDGE))

    distance = np.concatenate([picture.distance_px for picture in motion.pictures], axis=1)
    outliers = np.concatenate([picture.outliers for picture in motion.pictures], axis=1)
    is_known, median_px = np.isfinite(distance).any(axis=1), np.full(len(distance), np.nan)
    median_px[is_known] = np.nanmedian(distance[is_known], axis=1)
    worst = np.fmax.reduce(np.where(outliers, np.nan, distance), axis=1)
    lines = {"median of the joints": median_px, "largest without outliers": worst}
    yield _plot("residuals", "Reprojection (px)", lines, colours=(scenes.LIMB_COLOURS[1], scenes.EDGE))

    lines = {"joint within the pose": frame_rms_m(motion), "position in depth": motion.place_sigma_m}
    yield _plot("uncertainty", "Standard deviation (m)", lines, colours=(scenes.LIMB_COLOURS[1], scenes.LINK))


def analysis_plots(analysis: ClipAnalysis) -> Iterator[TimePlot]:
    """Yield plots of speed, acceleration and flexion, of the links' speeds, and of the feet's vertical forces.

    Speed and flexion have 90 % intervals. Left feet are blue, right feet orange, and fore feet paler.
    """
    reference_motion, times_s = analysis.joints[analysis.reference], analysis.motion.time_s
    every, name = reference_motion.series.oversampling, analysis.reference
    quantities: list[tuple[str, str, Array, Array]] = [
        ("speed", f"Speed of {name} (m/s)", reference_motion.speed_m_s, reference_motion.speed_sigma_m_s),
        (
            "acceleration",
            f"Acceleration of {name} (m/s²)",
            reference_motion.acceleration_m_s2,
            reference_motion.acceleration_sigma_m_s2,
        ),
    ]
    if "spine_flexion" in analysis.angles:
        flexion = analysis.angles["spine_flexion"].series
        bent, sigma = (np.degrees(column[:, 0]) for column in (flexion.value, flexion.value_sigma))
        quantities.append(("spine", "Flexion of the spine (°)", bent, sigma))
    for entity, title, values, sigma in quantities:
        lines = {entity: values[::every]}
        # The acceleration is drawn without an interval, because its standard deviation is many times its value.
        if np.isfinite(sigma).any() and entity != "acceleration":
            _, low, high = interval_of(values, sigma)
            lines |= {"90 %: from": low[::every], "90 %: to": high[::every]}
        yield _plot(f"analysis/{entity}", title, lines, "Kinematics", (scenes.TRAIL, scenes.LINK, scenes.LINK))
    if analysis.dynamics is not None and analysis.gait is not None:
        rows = np.searchsorted(analysis.gait.tracks.time_s, times_s - 1e-6)
        forces = {foot: force[rows, 0] for foot, force in analysis.dynamics.force.items()}
        colours = [_foot_colour(foot, paler=foot.endswith("F")) for foot in forces]
        yield _plot("analysis/forces", "Vertical force (body weights)", forces, "Forces", colours)
    paws = {*analysis.motion.foot_names.values()}
    for limb, fields in analysis.fields.items():
        speeds = {field.link[1].replace("_", " "): field.speed_m_s for field in fields}
        tab = "Legs, tips about parents" if fields[-1].link[1] in paws else "Trunk, tips about parents"
        yield _plot(f"analysis/links/{limb.replace(' ', '_')}", f"{limb} (m/s)", speeds, tab)


def _foot_colour(foot: str, paler: bool = False) -> scenes.Colour:
    """Return the colour of a foot's side, mixed with white if `paler`."""
    red, green, blue = scenes.RIGHT if foot.startswith("R") else scenes.LEFT
    return ((red + 255) // 2, (green + 255) // 2, (blue + 255) // 2) if paler else (red, green, blue)


def write_forces(analysis: ClipAnalysis, log: Log) -> None:
    """Write the feet's vertical forces as arrows, and the path of the centre of mass, to a recording.

    An arrow as long as the height of the centre of mass is a force of one body weight.
    """
    if (d := analysis.dynamics) is None or analysis.gait is None:
        return
    tracks, motion, centre_m = analysis.gait.tracks, analysis.motion, d.centre.series.value
    rows = np.searchsorted(tracks.time_s, motion.time_s - 1e-6)
    force = np.stack([d.force[foot][rows, 0] for foot in tracks.feet], axis=1)
    high_m = float(np.nanmedian(centre_m[:, 2] - d.ground_m))
    up = motion.in_reference(np.array([0.0, 0.0, high_m])) - motion.in_reference(np.zeros(3))
    has_force, origins_m = force > 0, motion.in_reference(tracks.foot_m[rows])
    arrow_colours = np.broadcast_to(
        np.array([_foot_colour(foot) for foot in tracks.feet], np.uint8), (*has_force.shape, 3)
    )[has_force]
    columns = rr.Arrows3D.columns(
        vectors=force[has_force][:, None] * up, origins=origins_m[has_force], colors=arrow_colours
    )
    log.draw("world/forces", rr.Arrows3D, columns.partition(has_force.sum(axis=1)), radii=0.01)
    path = motion.in_reference(centre_m[np.isfinite(centre_m).all(axis=1)])
    log.fix("world/forces/centre_of_mass", rr.LineStrips3D([path], colors=scenes.TRAIL, radii=0.006))
