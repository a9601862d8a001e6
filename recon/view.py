"""Playback: a Motion as a rerun recording that opens ready to read, and the viewer on such a file.

Entities of the recording; those without "(static)" have a row a frame, which is empty where the frame has no pose:

- `world`: metres, in the motion's frame of reference. `world/skeleton` and its joints, `world/path` (static) and
  `world/trail` of the reference joint, `world/ground` (static), `world/camera` (static), its
  frustum, and `world/followed`, invisible.
- `picture`: pixels of the distorted picture. `picture/frame` (static), its edge; `picture/detections`,
  `picture/outliers`, `picture/reprojections` with the skeleton's lines in it, `picture/links` between the two.
- `closeup`: the same points, relative to the middle of the reprojected skeleton in each frame.
- `angles/theta` and `angles/phi`, the free links' in degrees; `speed` of the reference joint in m/s; `residuals`, mean
  and largest of the frame in px.

Timelines: `frame`, the frame number of the keypoint file, and `time`, seconds since its frame 0.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray
from rerun.blueprint.archetypes import PlotBackground
from rerun.encodings import AbsoluteTimeRange

from recon.analysis.path import frame_jitter_m, speed_at_frames
from recon.errors import InputError, Problem
from recon.initialise import level_axes
from recon.motion import Motion

Array = NDArray[np.float64]
Colour = tuple[int, int, int]

APPLICATION = "recon"

# Okabe and Ito's palette, which the colour-blind can tell apart.
LIMB_COLOURS: tuple[Colour, ...] = ((0, 158, 115), (86, 180, 233), (230, 159, 0), (0, 114, 178), (240, 228, 66))
"""Of the skeleton's limbs, in their order: hind leg, spine, front leg, and two to spare."""
DETECTION, OUTLIER, LINK = (255, 255, 255), (235, 60, 40), (204, 121, 167)
PATH, TRAIL, GRID, CAMERA, EDGE = (110, 110, 120), (240, 228, 66), (58, 64, 74), (190, 190, 200), (130, 130, 140)
BACKGROUND = (18, 21, 27)

GRID_SPACING_M = 1.0
GRID_MARGIN_M = 1.5
MAX_GRID_LINES = 200


def write(motion: Motion, path: Path, start_frame: int | None = None) -> None:
    """Write the recording `motion.rrd`, with the blueprint that lays out its views.

    The viewer plays it in a loop, slowly where it is short. start_frame: a frame number to hold instead, for pictures.
    """
    scene = _Scene.of(motion)
    stream = rr.RecordingStream(APPLICATION)
    stream.save(path, default_blueprint=_blueprint(motion, scene, start_frame))
    stream.send_recording_name(Path(motion.keypoints.source or motion.skeleton.title).stem)
    times = [
        rr.TimeColumn("frame", sequence=motion.frames),
        rr.TimeColumn("time", duration=motion.time_s),
    ]

    def send(entity: str, columns: rr.ComponentColumnList) -> None:
        stream.send_columns(entity, times, columns)

    def fix(entity: str, archetype: rr.AsComponents) -> None:
        stream.log(entity, archetype, static=True)

    fix("/", rr.AnnotationContext([(i, limb, LIMB_COLOURS[i % 5]) for i, limb in enumerate(motion.skeleton.limbs)]))
    _write_world(motion, scene, send, fix)
    _write_picture(motion, scene, send, fix)
    _write_series(motion, send, fix)
    stream.flush()
    stream.disconnect()


def open_viewer(path: Path) -> None:
    """Show a recording in rerun's viewer; returns when the viewer is closed.

    Raises InputError where there is no such file or the viewer cannot run.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(Problem(path, "file", "no such file", "a recording (.rrd) that `recon fit` has written"))
    command = [sys.executable, "-m", "rerun", "--bind", "127.0.0.1", str(path)]
    code = subprocess.run(command, check=False).returncode
    if code:
        found = f"a viewer that ended with exit code {code}"
        raise InputError(Problem(path, "viewer", found, "a display, or the recording opened on a machine with one"))


Send = Callable[[str, rr.ComponentColumnList], None]
Fix = Callable[[str, rr.AsComponents], None]


# ---- what is where ----


@dataclass(frozen=True)
class _Scene:
    """Geometry that views and entities share, in the motion's frame of reference.

    axes (3, 3): rows are two level unit vectors and the upward one. ground_m: height of the ground along the latter.
    low_m, high_m (3,): bounds of the animal over the clip along the axes. size_m: diagonal of the animal.
    camera_m (3,): centre of projection.
    """

    axes: Array
    ground_m: float
    low_m: Array
    high_m: Array
    size_m: float
    camera_m: Array

    @classmethod
    def of(cls, motion: Motion) -> _Scene:
        camera = motion.camera
        right, away = level_axes(camera.up)
        axes, centre = np.stack((right, away, camera.up)), np.zeros(3)
        if camera.has_extrinsics:
            centre = camera.centre_world
            axes = np.eye(3) if camera.world_z_up else camera.camera_to_world(axes) - centre
        joints = motion.joints_m[motion.solved] @ axes.T
        if not len(joints):
            return cls(axes, 0.0, -np.ones(3), np.ones(3), 1.0, centre)
        starts = {link.start for link in motion.skeleton.links}
        feet = [j for j, joint in enumerate(motion.skeleton.joints) if joint not in starts]
        # Single poses that went astray do not enlarge the scene.
        low, high = np.percentile(joints.reshape(-1, 3), (1, 99), axis=0)
        size = float(np.median(np.linalg.norm(np.ptp(joints, axis=1), axis=1)))
        return cls(axes, float(np.percentile(joints[:, feet, 2], 10)), low, high, size, centre)

    @property
    def centre_m(self) -> Array:
        """(3,): middle of the clip's motion."""
        return (self.low_m + self.high_m) / 2 @ self.axes


# ---- entities ----


def _write_world(motion: Motion, scene: _Scene, send: Send, fix: Fix) -> None:
    camera, joints = motion.camera, motion.joints_m
    if motion.frame_of_reference == "camera":
        fix("world", rr.ViewCoordinates.RDF)
    elif camera.world_z_up:
        fix("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)

    limbs = _limb_indices(motion)
    fix("world/skeleton", rr.LineStrips3D.from_fields(class_ids=range(len(limbs)), radii=0.017, show_labels=False))
    strips = [
        [pose[limb] for limb in limbs] if solved else [] for pose, solved in zip(joints, motion.solved, strict=True)
    ]
    send("world/skeleton", _strips(rr.LineStrips3D, strips))
    fix(
        "world/skeleton/joints",
        rr.Points3D.from_fields(class_ids=_joint_limbs(motion), radii=0.028, labels=motion.names, show_labels=False),
    )
    counts = np.where(motion.solved, joints.shape[1], 0)
    send("world/skeleton/joints", rr.Points3D.columns(positions=joints[motion.solved].reshape(-1, 3)).partition(counts))

    # The viewer frames what it follows by its bounds: more than the animal, and without the flutter of its legs.
    fix("world/followed", rr.Points3D.from_fields(colors=(0, 0, 0, 0), radii=0.0))
    half = 0.85 * scene.size_m * np.ones(3)
    corners = np.stack((joints.mean(axis=1) - half, joints.mean(axis=1) + half), axis=1)
    counts = np.where(motion.solved, 2, 0)
    send("world/followed", rr.Points3D.columns(positions=corners[motion.solved].reshape(-1, 3)).partition(counts))

    root = motion.root_m
    fix("world/path", rr.LineStrips3D(_unbroken(root), colors=PATH, radii=rr.Radius.ui_points(1.5)))
    fix("world/trail", rr.LineStrips3D.from_fields(colors=TRAIL, radii=rr.Radius.ui_points(2.5)))
    # The view shows this entity's rows up to the current one: a step each.
    steps = [[root[i - 1 : i + 1]] if i and motion.solved[i - 1 : i + 1].all() else [] for i in range(len(root))]
    send("world/trail", _strips(rr.LineStrips3D, steps))

    fix("world/ground", rr.LineStrips3D(_grid(scene), colors=GRID, radii=rr.Radius.ui_points(0.75)))
    if camera.rotation is not None:
        fix("world/camera", rr.Transform3D(translation=scene.camera_m, mat3x3=camera.rotation.T))
    distance = float(np.linalg.norm(scene.centre_m - scene.camera_m))
    fix(
        "world/camera",
        rr.Pinhole(
            image_from_camera=camera.matrix,
            resolution=camera.image_size_px,
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=max(0.25, 0.15 * distance),
            color=CAMERA,
            line_width=-1.0,  # negative: on the screen, not in metres
        ),
    )


def _write_picture(motion: Motion, scene: _Scene, send: Send, fix: Fix) -> None:
    """The points twice: where they are in the picture, and around the middle of the animal, for a close look."""
    size = np.array(motion.camera.image_size_px, dtype=float)
    fix("picture/frame", rr.Boxes2D(array=[-0.5, -0.5, *size], array_format=rr.Box2DFormat.XYWH, colors=EDGE))
    low, high = _picture_bounds(motion)
    _write_points("picture", np.zeros((len(motion.frames), 2)), 0.007 * float(np.max(high - low)), motion, send, fix)
    middle, radius = _middle_and_radius_px(motion)
    _write_points("closeup", middle, 0.03 * radius, motion, send, fix)


def _write_points(root: str, origin_px: Array, arm: float, motion: Motion, send: Send, fix: Fix) -> None:
    """origin_px (T, 2): what is drawn at (0, 0); arm: of a detection's cross, px."""
    outliers = motion.outliers
    detected, reprojected = (xy - origin_px[:, None] for xy in (motion.detected_px, motion.reprojected_px))
    for entity, colour, chosen in (("detections", DETECTION, ~outliers), ("outliers", OUTLIER, outliers)):
        fix(f"{root}/{entity}", rr.LineStrips2D.from_fields(colors=colour, radii=rr.Radius.ui_points(1.0)))
        points = [xy[keep & np.isfinite(xy[:, 0])] for xy, keep in zip(detected, chosen, strict=True)]
        send(f"{root}/{entity}", _strips(rr.LineStrips2D, [_crosses(xy, arm) for xy in points]))

    limbs = _limb_indices(motion)
    lines = [[(c, part) for c, limb in enumerate(limbs) for part in _unbroken(pose[limb])] for pose in reprojected]
    classes = [c for frame in lines for c, _ in frame]
    columns = rr.LineStrips2D.columns(strips=[xy for frame in lines for _, xy in frame], class_ids=classes)
    send(f"{root}/reprojections", columns.partition([len(frame) for frame in lines]))
    fix(f"{root}/reprojections", rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(1.5), show_labels=False))
    seen = np.isfinite(reprojected[..., 0])
    classes = np.broadcast_to(_joint_limbs(motion), seen.shape)[seen]
    columns = rr.Points2D.columns(positions=reprojected[seen], class_ids=classes)
    send(f"{root}/reprojections/joints", columns.partition(seen.sum(axis=1)))
    fix(f"{root}/reprojections/joints", rr.Points2D.from_fields(radii=rr.Radius.ui_points(3.5), show_labels=False))

    both = np.isfinite(motion.distance_px)
    ends = np.stack((detected, reprojected), axis=2)
    columns = rr.LineStrips2D.columns(
        strips=list(ends[both]), colors=np.where(outliers[both][:, None], OUTLIER, LINK).astype(np.uint8)
    )
    send(f"{root}/links", columns.partition(both.sum(axis=1)))
    fix(f"{root}/links", rr.LineStrips2D.from_fields(radii=rr.Radius.ui_points(1.5)))


def _write_series(motion: Motion, send: Send, fix: Fix) -> None:
    def series(entity: str, values: Array, names: Sequence[str], colours: Sequence[Colour]) -> None:
        """values (T, lines): a row with NaN is left empty, which breaks the lines there."""
        known = np.isfinite(values).all(axis=1)
        columns = rr.Scalars.columns(scalars=values[known].ravel())
        send(entity, columns.partition(np.where(known, values.shape[1], 0)))
        fix(entity, rr.SeriesLines(names=names, colors=colours, widths=[1.8] * len(names)))

    theta, phi = np.split(np.rad2deg(motion.angles_rad), 2, axis=1)
    names, colours = _angle_lines(motion)
    series("angles/theta", theta, [f"θ{name}" for name in names], colours)
    series("angles/phi", phi, [f"φ{name}" for name in names], colours)
    lines = ["cubic spline", "smoothed by its jitter", "straight run"]
    series("speed", np.stack(_speeds_m_s(motion), axis=1), lines, [EDGE, TRAIL, LIMB_COLOURS[0]])
    lines = ["mean of the joints", "worst joint"]
    series("residuals", np.stack(_residuals_px(motion), axis=1), lines, [LIMB_COLOURS[1], OUTLIER])


def _angle_lines(motion: Motion) -> tuple[list[str], list[Colour]]:
    """For each free link, in the order of the angles: the number of its end, with its limb; a tint of its limb's
    colour."""
    limbs = list(motion.skeleton.limbs)
    free = [link for link in motion.skeleton.links if link.free]
    names = [f"{link.end.lstrip('J')} {link.limb}" for link in free]
    colours = []
    for link in free:
        same = [other for other in free if other.limb == link.limb]
        colours.append(_shade(LIMB_COLOURS[limbs.index(link.limb) % 5], same.index(link), len(same)))
    return names, colours


def _speeds_m_s(motion: Motion) -> tuple[Array, Array, Array]:
    """Speed of the reference joint in solved frames, (T,) each: from the exact spline, from one smoothed by the
    jitter from frame to frame (the exact one where that cannot be told), and of the straight run through the clip."""
    exact = speed_at_frames(motion.time_s, motion.root_m)
    jitter = frame_jitter_m(motion.root_m)
    smooth = speed_at_frames(motion.time_s, motion.root_m, jitter) if np.isfinite(jitter).all() else exact
    straight = np.where(motion.solved, motion.solution.travel.speed_m_s, np.nan)
    return np.where(motion.solved, exact, np.nan), np.where(motion.solved, smooth, np.nan), straight


def _residuals_px(motion: Motion) -> tuple[Array, Array]:
    """(T,), (T,): mean and largest distance of detections from reprojections, NaN in frames without any."""
    distance = motion.distance_px
    known = np.isfinite(distance).any(axis=1)
    mean, worst = np.full((2, len(distance)), np.nan)
    mean[known], worst[known] = np.nanmean(distance[known], axis=1), np.nanmax(distance[known], axis=1)
    return mean, worst


# ---- layout ----


def _blueprint(motion: Motion, scene: _Scene, start_frame: int | None) -> rrb.Blueprint:
    upto_now = rrb.VisibleTimeRanges(
        [
            rr.VisibleTimeRange(t, start=rr.TimeRangeBoundary.infinite(), end=rr.TimeRangeBoundary.cursor_relative())
            for t in ("frame", "time")
        ]
    )
    trail = {"world/trail": [upto_now]}
    animal = rrb.Spatial3DView(
        origin="world",
        name=f"3D, {motion.frame_of_reference} frame, grid of {GRID_SPACING_M:g} m",
        background=BACKGROUND,
        line_grid=False,
        eye_controls=_eye_on_animal(motion, scene),
        overrides=trail,  # pyright: ignore[reportArgumentType]
    )
    overview = rrb.Spatial3DView(
        origin="world",
        name="Overview with the camera",
        background=BACKGROUND,
        line_grid=False,
        eye_controls=_eye_behind_camera(motion, scene),
        overrides=trail,  # pyright: ignore[reportArgumentType]
    )
    low, high = _picture_bounds(motion)
    picture = rrb.Spatial2DView(
        origin="picture",
        name="Whole picture",
        background=BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(low[0], high[0]), y_range=(low[1], high[1])),
    )
    reach = 0.85 * _middle_and_radius_px(motion)[1]
    closeup = rrb.Spatial2DView(
        origin="closeup",
        name="Picture, close up: + detected, ● reprojected, red: outlier",
        background=BACKGROUND,
        visual_bounds=rrb.VisualBounds2D(x_range=(-reach, reach), y_range=(-reach, reach)),
    )

    def plot(origin: str, name: str, values: Array) -> rrb.TimeSeriesView:
        """values: what it is to show, NaN where there is none."""
        known = np.append(values[np.isfinite(values)], 0.0)  # all of them have zero in sight
        least, most = known.min(), known.max()
        margin = 0.06 * (most - least) + 1e-3
        return rrb.TimeSeriesView(
            origin=origin,
            name=name,
            axis_y=rrb.ScalarAxis(range=(least - margin, most + margin)),
            plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop, visible=True),
            background=PlotBackground(color=BACKGROUND),
        )

    degrees = np.rad2deg(motion.angles_rad)
    theta, phi = np.split(degrees, 2, axis=1)
    exact, smooth, _ = _speeds_m_s(motion)
    # Splines overshoot, at the ends above all.
    speeds = smooth[smooth <= 1.5 * np.nanpercentile(exact, 90)] if np.isfinite(exact).any() else smooth
    plots = rrb.Horizontal(
        rrb.Tabs(
            plot("angles/theta", "θ, sagittal angles (°)", theta),
            plot("angles/phi", "φ, transverse angles (°)", phi),
            active_tab=0,
        ),
        plot("speed", "Speed of the reference joint (m/s)", speeds),
        plot("residuals", "Reprojection error (px)", np.stack(_residuals_px(motion))),
        column_shares=[4, 3, 3],
    )
    if start_frame is None:
        fps = min(motion.fps, max(5.0, len(motion.frames) / 5))
        time = rrb.TimePanel(state="collapsed", timeline="frame", fps=fps, play_state="playing", loop_mode="all")
    else:
        # A blueprint has no place for the current time, but a loop over one frame, soon reached, stays there.
        time = rrb.TimePanel(
            state="collapsed",
            timeline="frame",
            fps=100.0 * len(motion.frames),
            play_state="playing",
            loop_mode="selection",
            time_selection=AbsoluteTimeRange(start_frame, start_frame),  # pyright: ignore[reportArgumentType]
        )
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Horizontal(
                animal,
                rrb.Vertical(rrb.Tabs(closeup, picture, active_tab=0), overview, row_shares=[5, 4]),
                column_shares=[11, 9],
            ),
            plots,
            row_shares=[5, 3],
        ),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        time,
        auto_layout=False,
        auto_views=False,
    )


def _eye_on_animal(motion: Motion, scene: _Scene) -> rrb.EyeControls3D:
    """Going along with the animal, on the camera's side of it and slightly raised."""
    up = scene.axes[2]
    poses = motion.joints_m[motion.solved]
    if not len(poses):
        return rrb.EyeControls3D(eye_up=up)
    travel = poses[-1, 0] - poses[0, 0]
    travel -= up * (travel @ up)
    side = scene.camera_m - scene.centre_m
    side -= up * (side @ up)
    if np.linalg.norm(travel) > scene.size_m:
        across = np.cross(up, travel)
        side = across if across @ side >= 0 else -across
    direction = side / max(float(np.linalg.norm(side)), 1e-9) + 0.3 * up
    target = poses[0].mean(axis=0)
    position = target + (1.35 * scene.size_m + 0.4) * direction
    return rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=position,
        look_target=target,
        eye_up=up,
        tracking_entity="world/followed",
    )


def _eye_behind_camera(motion: Motion, scene: _Scene) -> rrb.EyeControls3D:
    """From behind and above the camera over its shoulder, so that left and right are as in the picture."""
    up = scene.axes[2]
    ahead = scene.centre_m - scene.camera_m
    distance = max(float(np.linalg.norm(ahead)), 1.0)
    ahead = ahead / distance
    position = scene.camera_m + distance * (0.28 * up - 0.3 * ahead + 0.2 * np.cross(ahead, up))
    target = scene.camera_m + 0.4 * distance * ahead
    return rrb.EyeControls3D(kind=rrb.Eye3DKind.Orbital, position=position, look_target=target, eye_up=up)


def _middle_and_radius_px(motion: Motion) -> tuple[Array, float]:
    """(T, 2): middle of the reprojected skeleton, 0 without one; and the largest distance of a joint from it."""
    middle = np.zeros((len(motion.frames), 2))
    seen = np.isfinite(motion.reprojected_px[..., 0])
    known = np.any(seen, axis=-1)
    middle[known] = np.nanmean(motion.reprojected_px[known], axis=1)
    distance = np.linalg.norm(motion.reprojected_px - middle[:, None], axis=2)[seen]
    return middle, float(distance.max(initial=1.0))


def _picture_bounds(motion: Motion) -> tuple[Array, Array]:
    """Corners (2,), (2,) of the part of the picture that the animal passes through, with a margin."""
    size = np.array(motion.camera.image_size_px, dtype=float)
    explained = np.where(motion.outliers[..., None], np.nan, motion.detected_px)
    points = np.concatenate((explained.reshape(-1, 2), motion.reprojected_px.reshape(-1, 2)))
    points = points[np.isfinite(points).all(axis=1)]
    points = points[motion.camera.in_image(points)]
    if not len(points):
        return np.full(2, -0.5), size - 0.5
    low, high = points.min(axis=0), points.max(axis=0)
    margin = 0.08 * float(np.max(high - low)) + 10.0
    return low - margin, high + margin


# ---- helpers ----


def _limb_indices(motion: Motion) -> list[list[int]]:
    """Indices of the joints along each limb."""
    index = {joint: j for j, joint in enumerate(motion.skeleton.joints)}
    return [[index[joint] for joint in joints] for joints in motion.skeleton.limbs.values()]


def _joint_limbs(motion: Motion) -> NDArray[np.int64]:
    """(J,): the limb that each joint is drawn with, that of the link that ends in it; the root's is the spine's."""
    limbs = list(motion.skeleton.limbs)
    ends = {link.end: limbs.index(link.limb) for link in motion.skeleton.links}
    trunk = next(limbs.index(link.limb) for link in motion.skeleton.links if not link.free)
    return np.array([ends.get(joint, trunk) for joint in motion.skeleton.joints])


def _strips(
    archetype: type[rr.LineStrips2D | rr.LineStrips3D], frames: Sequence[Sequence[Array]]
) -> rr.ComponentColumnList:
    """Columns of line strips: any number a frame, each of shape (points, 2 or 3)."""
    columns = archetype.columns(strips=[strip for strips in frames for strip in strips])
    return columns.partition([len(strips) for strips in frames])


def _crosses(points_px: Array, arm_px: float) -> list[Array]:
    """Upright crosses at points (N, 2): two strips each."""
    arms = np.array([[[-arm_px, 0.0], [arm_px, 0.0]], [[0.0, -arm_px], [0.0, arm_px]]])
    return list((points_px[:, None, None] + arms).reshape(-1, 2, 2))


def _unbroken(points: Array) -> list[Array]:
    """The stretches of a line (N, 2 or 3) without NaN that have at least two points."""
    known = np.isfinite(points[:, 0])
    runs = np.split(np.arange(len(points)), np.flatnonzero(np.diff(known)) + 1)
    return [points[run] for run in runs if len(run) > 1 and known[run[0]]]


def _grid(scene: _Scene) -> list[Array]:
    """Lines (2, 3) on the ground under the whole path, at whole metres of the level axes."""
    low = np.floor(scene.low_m[:2] - GRID_MARGIN_M)
    high = np.ceil(scene.high_m[:2] + GRID_MARGIN_M)
    spacing = GRID_SPACING_M
    while np.max(high - low) / spacing > MAX_GRID_LINES:
        spacing *= 10
    lines = []
    for axis in (0, 1):
        for at in np.arange(low[axis], high[axis] + spacing / 2, spacing):
            line = np.full((2, 3), scene.ground_m)
            line[:, axis] = at
            line[:, 1 - axis] = low[1 - axis], high[1 - axis]
            lines.append(line @ scene.axes)
    return lines


def _shade(colour: Colour, number: int, count: int) -> Colour:
    """The number-th of count tints of a colour, from dark to light."""
    if count == 1:
        return colour
    share = number / (count - 1)
    target, amount = (0.0, 0.35 * (1 - 2 * share)) if share < 0.5 else (255.0, 0.55 * (2 * share - 1))
    red, green, blue = (round(c + (target - c) * amount) for c in colour)
    return red, green, blue
