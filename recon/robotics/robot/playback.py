"""Playback of a robot's motion, with the animal that it follows beside it, as a rerun recording.

Entities: `world/robot`, its legs and body, and `world/robot/feet`, those that stand; `world/animal`, scaled to the
robot's size, with a view of its own; `world/support`, the polygon of three or more feet that stand; `world/ground`,
`world/path`, `world/step` (static); `world/followed` and `world/animal/followed`, invisible; `angles/<leg>` in degrees;
`<leg>`, when it stands. Timelines: `frame`, the sample, and `time`, the robot's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from recon.animal.body import Side
from recon.base.arrays import Array, Bools
from recon.robotics.climb.recipe import Step
from recon.robotics.robot.quadruped import LEGS
from recon.robotics.robot.retarget import RobotMotion
from recon.show.recording import recording
from recon.show.view.layout import laid_out, state_rows, time_view
from recon.show.view.scene import (
    BACKGROUND,
    DETECTION,
    GRID,
    LEFT,
    LIMB_COLOURS,
    PATH,
    RIGHT,
    SIDE_COLOURS,
    TRAIL,
    Log,
    TimePlot,
    grid_lines,
    limb_strips,
    strips,
)

ROBOT = DETECTION
STEP = (58, 62, 72)
GRID_LINES = 60
"""Across the path, at most."""


@dataclass(frozen=True, eq=False)
class Companion:
    """The animal: points (N, J, 3) in the robot's world and of its size, and the limbs, by name, as their indices, with
    the side of each."""

    points_m: Array
    limbs: dict[str, tuple[int, ...]]
    limb_sides: dict[str, Side | None]
    title: str


def write_robot(
    motion: RobotMotion,
    path: Path,
    companion: Companion | None = None,
    step: Step | None = None,
    more: Sequence[TimePlot] = (),
    title: str = "",
) -> None:
    """The recording; step: one across the way, along which x is forwards; more: plots before those of the angles, which
    share one place then."""
    series = [_angles(motion, label) for label in LEGS]
    seen = _middle(motion, step)
    layout = _blueprint(motion, companion, series, seen, more, title)
    with recording(path, layout) as stream:
        stream.send_recording_name(f"{motion.robot.name} {path.stem}")
        log = Log(stream, np.arange(len(motion.time_s)), motion.time_s)
        _write_motion(motion, companion, [*more, *series], seen, log)
        _write_ground(motion, companion, log)
        if step is not None:
            _write_step(motion, step, log)


def _write_step(motion: RobotMotion, step: Step, log: Log) -> None:
    """A solid block, as wide as the ground and as far as the robot goes."""
    low, high = _extent(motion, None)
    corners = np.array([[step.edge_m, low[1], 0.0], [high[0], high[1], step.height_m]])
    box = rr.Boxes3D(mins=[corners[0]], sizes=[corners[1] - corners[0]], colors=STEP, fill_mode="solid")
    log.fix("world/step", box)
    edges = [[[step.edge_m, y, z] for y in corners[:, 1]] for z in corners[:, 2]]
    log.fix("world/step/edge", rr.LineStrips3D(edges, colors=PATH, radii=0.006 * motion.robot.stand_m))


def _write_motion(
    motion: RobotMotion, companion: Companion | None, series: Sequence[TimePlot], seen: tuple[Array, float], log: Log
) -> None:
    legs = np.stack([motion.points(label) for label in LEGS], axis=1)
    log.fix("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    size = motion.robot.stand_m

    hips = legs[:, :, 0]
    body = hips[:, [LEGS.index(label) for label in ("LF", "RF", "RH", "LH", "LF")]]
    colours = [LEFT if label[0] == "L" else RIGHT for label in LEGS]
    style = rr.LineStrips3D.from_fields(colors=[*colours, ROBOT], radii=0.025 * size)
    log.fix("world/robot", style)
    lines = [[*of_legs, of_body] for of_legs, of_body in zip(legs, body, strict=True)]
    log.send("world/robot", strips(rr.LineStrips3D, lines))
    log.points("world/robot/feet", motion.feet_m, motion.standing, colors=TRAIL, radii=0.06 * size)
    log.fix("world/support", rr.LineStrips3D.from_fields(colors=TRAIL, radii=0.008 * size))
    polygons = [_polygon(feet, stand) for feet, stand in zip(motion.feet_m, motion.standing, strict=True)]
    log.send("world/support", strips(rr.LineStrips3D, polygons))
    if companion is not None:
        colours_of_limbs = [SIDE_COLOURS[companion.limb_sides[limb]] for limb in companion.limbs]
        style = rr.LineStrips3D.from_fields(colors=colours_of_limbs, radii=0.02 * size)
        log.fix("world/animal", style)
        shown = np.ones(len(motion.time_s), bool)
        log.send("world/animal", limb_strips(rr.LineStrips3D, companion.points_m, companion.limbs, shown))
        log.follow("world/animal/followed", *_beside(seen, companion))
    log.follow("world/followed", *seen)
    for s in series:
        log.plot(s)
    for k, label in enumerate(LEGS):
        log.state(label, "stance", colours[k], motion.standing[:, k])


def _polygon(feet_m: Array, standing: Bools) -> list[Array]:
    around = [LEGS.index(label) for label in ("LF", "LH", "RH", "RF")]
    feet = [feet_m[k] for k in around if standing[k]]
    return [np.array([*feet, feet[0]])] if len(feet) > 2 else []


def _angles(motion: RobotMotion, label: str) -> TimePlot:
    names, values = motion.robot.legs[label].joints, np.degrees(motion.leg_angles(label))
    colours = [LIMB_COLOURS[k % len(LIMB_COLOURS)] for k in range(len(names))]
    return TimePlot(f"angles/{label}", f"{label}, degrees", names, colours, values)


def _middle(motion: RobotMotion, step: Step | None) -> tuple[Array, float]:
    """The middle of the robot (N, 3), near the ground, and half the size of what is to be seen."""
    base = motion.pose.translation * (1.0, 1.0, 0.1)
    size = 1.2 * motion.robot.stand_m
    if step is not None:
        base[:, 2] += step.height_m
        size += 0.7 * step.height_m
    return base, size


def _beside(seen: tuple[Array, float], companion: Companion) -> tuple[Array, float]:
    """The same of the animal, as it is in the middle of its points."""
    middle, half = seen
    low, high = companion.points_m.min(axis=1), companion.points_m.max(axis=1)
    return np.column_stack(((low + high)[:, :2] / 2, middle[:, 2])), half


def _extent(motion: RobotMotion, companion: Companion | None) -> tuple[Array, Array]:
    """Bounds (2,) of the ground: of all that moves, and a margin."""
    clouds = [motion.feet_m.reshape(-1, 3), motion.pose.translation]
    if companion is not None:
        clouds.append(companion.points_m.reshape(-1, 3))
    every, margin = np.concatenate(clouds)[:, :2], 1.5 * motion.robot.stand_m
    return every.min(axis=0) - margin, every.max(axis=0) + margin


def _write_ground(motion: RobotMotion, companion: Companion | None, log: Log) -> None:
    """The ground's grid and the base's path."""
    low, high = _extent(motion, companion)
    spacing = 0.1
    while np.max(high - low) / spacing > GRID_LINES:
        spacing *= 2
    flat = grid_lines(np.floor(low / spacing) * spacing, np.ceil(high / spacing) * spacing, spacing)
    lines = [np.column_stack([line, np.zeros(2)]) for line in flat]
    log.fix("world/ground", rr.LineStrips3D(lines, colors=GRID, radii=0.004 * motion.robot.stand_m))
    path = motion.pose.translation
    log.fix("world/path", rr.LineStrips3D([path], colors=PATH, radii=0.008 * motion.robot.stand_m))


def _blueprint(
    motion: RobotMotion,
    companion: Companion | None,
    series: Sequence[TimePlot],
    seen: tuple[Array, float],
    more: Sequence[TimePlot],
    title: str,
) -> rrb.Blueprint:
    title = title or motion.robot.title
    if motion.slower != 1:
        title += f"; {motion.slower:.3g} times slower than the animal"
    scene: rrb.View | rrb.Container = _scene(title, "world/followed", seen, ["world/animal"])
    if companion is not None:
        other = f"{companion.title}, at {motion.scale:.2f} of its size"
        of_robot = ["world/robot", "world/support", "world/path", "world/step"]
        beside = _scene(other, "world/animal/followed", _beside(seen, companion), of_robot)
        scene = rrb.Horizontal(scene, beside)
    angles = [time_view(s) for s in series]
    angles = [rrb.Tabs(*angles)] if more else angles
    stands = state_rows(LEGS, "Feet that stand")
    fps = min(len(motion.time_s) / float(motion.time_s[-1]), len(motion.time_s) / 4)
    content = rrb.Vertical(scene, rrb.Horizontal(*(time_view(s) for s in more), *angles, stands), row_shares=[3, 2])
    return laid_out(content, fps)


def _scene(name: str, followed: str, seen: tuple[Array, float], hidden: Sequence[str]) -> rrb.Spatial3DView:
    """From the right and ahead, going along."""
    middle, half = seen
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=middle[0] + half * np.array([0.5, -2.0, 0.9]),
        look_target=middle[0],
        eye_up=(0.0, 0.0, 1.0),
        tracking_entity=followed,
    )
    contents = ["$origin/**", *(f"- {entity}/**" for entity in hidden)]
    return rrb.Spatial3DView(
        origin="world", contents=contents, name=name, background=BACKGROUND, line_grid=False, eye_controls=eye
    )
