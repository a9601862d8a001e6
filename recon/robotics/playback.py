"""Write a robot's motion, next to the animal that the robot follows, as a rerun recording.

The entities are:

- `world/robot`: legs and body
- `world/robot/feet`: the feet in stance
- `world/animal`: the animal scaled to the robot's size, with a view of its own
- `world/support`: the polygon of three or more feet in stance
- `world/ground`, `world/path` and `world/step`: static objects
- `world/followed` and `world/animal/followed`: invisible points that the views follow
- `angles/<leg>`: joint angles in degrees
- `<leg>`: whether the leg is in stance

The timelines are `frame`, the index of the sample, and `time`, the robot's time.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from recon.base.arrays import Array, Bools
from recon.base.file_names import encodable
from recon.fit.motion import Motion
from recon.robotics.quadruped import LEGS
from recon.robotics.retarget import RobotMotion
from recon.show.view import laid_out, scene, state_rows, time_view

ROBOT = scene.DETECTION
STEP = (58, 62, 72)
GRID_LINES = 60
"""Maximum number of grid lines across the path."""


def write_robot(
    motion: RobotMotion,
    path: Path,
    companion: tuple[Array, Motion] | None = None,
    step: tuple[float, float] | None = None,
    plots: Sequence[scene.TimePlot] = (),
    title: str = "",
) -> None:
    """Write the recording of a robot's motion.

    Parameters
    ----------
    motion : RobotMotion
        Motion of N samples.
    path : Path
        File to write.
    companion : tuple, optional
        The animal next to the robot: its points (N, J, 3) in the robot's world, scaled to the robot's size, and its
        motion.
    step : tuple, optional
        A step across a path along x: the x of its edge, and its height, m.
    plots : sequence of TimePlot
        Plots to show before the plots of angles, which then share one panel.
    title : str
        Title of the recording; by default the robot's title.
    """
    scene.require_whole()
    series, size = [_angles(motion, label) for label in LEGS], motion.robot.stand_m
    # The views of robot and animal are centred near the ground, and show `half` metres on either side.
    middle, half = motion.pose.translation * (1.0, 1.0, 0.1), 1.2 * size
    clouds, animal_middle = [motion.feet_m.reshape(-1, 3), motion.pose.translation], middle
    if step is not None:
        middle[:, 2] += step[1]
        half += 0.7 * step[1]
    if companion is not None:
        points = companion[0]
        clouds.append(points.reshape(-1, 3))
        animal_middle = np.column_stack([(points.min(axis=1) + points.max(axis=1))[:, :2] / 2, middle[:, 2]])
    level = np.concatenate(clouds)[:, :2]
    low, high = level.min(axis=0) - 1.5 * size, level.max(axis=0) + 1.5 * size

    title = title or motion.robot.title
    if motion.slower != 1:
        title += f"; {motion.slower:.3g} times slower than the animal"
    shown: rrb.View | rrb.Container = _scene(title, "world/followed", middle[0], half, ["world/animal"])
    if companion is not None:
        animal_tree = f"{companion[1].title}, at {motion.scale:.2f} of its size"
        of_robot = ["shapes", "world/robot", "world/support", "world/path", "world/step"]
        shown = rrb.Horizontal(shown, _scene(animal_tree, "world/animal/followed", animal_middle[0], half, of_robot))
    angles = [time_view(s) for s in series]
    angles = [rrb.Tabs(*angles)] if plots else angles
    below = rrb.Horizontal(*(time_view(s) for s in plots), *angles, state_rows(LEGS, "Standing feet"))
    fps = min(len(motion.time_s) / float(motion.time_s[-1]), len(motion.time_s) / 4)
    with scene.recording(path, laid_out(rrb.Vertical(shown, below, row_shares=[3, 2]), fps)) as stream:
        stream.send_recording_name(encodable(f"{motion.robot.name} {path.stem}"))
        log = scene.Log(stream, np.arange(len(motion.time_s)), motion.time_s)
        log.fix("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
        _write_robot(motion, log)
        log.follow("world/followed", middle, half)
        if companion is not None:
            points, animal = companion
            colours = [scene.SIDE_COLOURS[animal.limb_sides[limb]] for limb in animal.limbs]
            columns = scene.limb_strips(points, animal.limbs, np.ones(points.shape[:2], bool))
            log.draw("world/animal", rr.LineStrips3D, columns, colors=colours, radii=0.02 * size)
            log.follow("world/animal/followed", animal_middle, half)
        for s in [*plots, *series]:
            log.plot(s)
        _write_ground(log, low, high, size)
        if step is not None:
            _write_step(log, *step, low, high, size)


def _write_ground(log: scene.Log, low: Array, high: Array, size: float) -> None:
    """Write the grid of the ground between two corners (2,), for a robot of height `size`, m."""
    spacing = 0.1
    while np.max(high - low) / spacing > GRID_LINES:
        spacing *= 2
    flat = scene.grid_lines(np.floor(low / spacing) * spacing, np.ceil(high / spacing) * spacing, spacing)
    lines = [np.column_stack([line, np.zeros(2)]) for line in flat]
    log.fix("world/ground", rr.LineStrips3D(lines, colors=scene.GRID, radii=0.004 * size))


def _write_step(log: scene.Log, edge_m: float, height_m: float, low: Array, high: Array, size: float) -> None:
    """Write the step as a solid block that covers the width of the ground and ends where the robot stops."""
    low, high = np.append(low, 0.0), np.append(high, height_m)
    low[0] = edge_m
    log.fix("world/step", rr.Boxes3D(mins=[low], sizes=[high - low], colors=STEP, fill_mode="solid"))
    edges = [[[edge_m, y, z] for y in (low[1], high[1])] for z in (0.0, height_m)]
    log.fix("world/step/edge", rr.LineStrips3D(edges, colors=scene.PATH, radii=0.006 * size))


def _write_robot(motion: RobotMotion, log: scene.Log) -> None:
    size, legs = motion.robot.stand_m, np.stack([motion.points(label) for label in LEGS], axis=1)
    body = legs[:, [LEGS.index(label) for label in ("LF", "RF", "RH", "LH", "LF")], 0]
    colours = [scene.LEFT if label[0] == "L" else scene.RIGHT for label in LEGS]
    lines = scene.strips([[*of_legs, of_body] for of_legs, of_body in zip(legs, body, strict=True)])
    log.draw("world/robot", rr.LineStrips3D, lines, colors=[*colours, ROBOT], radii=0.025 * size)
    log.points("world/robot/feet", motion.feet_m, motion.standing, colors=scene.TRAIL, radii=0.06 * size)
    polygons = scene.strips([_polygon(feet, stand) for feet, stand in zip(motion.feet_m, motion.standing, strict=True)])
    log.draw("world/support", rr.LineStrips3D, polygons, colors=scene.TRAIL, radii=0.008 * size)
    log.fix("world/path", rr.LineStrips3D([motion.pose.translation], colors=scene.PATH, radii=0.008 * size))
    if motion.robot.source.lower().endswith(".urdf"):  # rerun reads the shapes from the robot's own file
        urdf = rr.urdf.UrdfTree.from_file_path(motion.robot.source, "shapes")
        urdf.log_urdf_to_recording(log.stream)
        for name, angles in zip(motion.robot.joints, motion.angles_rad.T, strict=True):
            joint = urdf.get_joint_by_name(name)
            assert joint is not None
            log.send(f"world/robot/joints/{name}", joint.compute_transform_columns(angles.tolist(), clamp=False))
        placed = rr.Transform3D.columns(
            translation=motion.pose.translation,
            quaternion=motion.pose.rotation.as_quat(),
            parent_frame=["tf#/world"] * len(motion.time_s),
            child_frame=[urdf.root_link().name] * len(motion.time_s),
        )
        log.send("world/robot/base", placed)
    for k, label in enumerate(LEGS):
        log.state(label, "stance", colours[k], motion.standing[:, k])


def _polygon(feet_m: Array, standing: Bools) -> list[Array]:
    around = [LEGS.index(label) for label in ("LF", "LH", "RH", "RF")]
    feet = [feet_m[k] for k in around if standing[k]]
    return [np.array([*feet, feet[0]])] if len(feet) > 2 else []


def _angles(motion: RobotMotion, label: str) -> scene.TimePlot:
    names, values = motion.robot.legs[label].joints, np.degrees(motion.leg_angles(label))
    colours = [scene.LIMB_COLOURS[k % len(scene.LIMB_COLOURS)] for k in range(len(names))]
    return scene.TimePlot(f"angles/{label}", f"{label}, degrees", names, colours, values)


def _scene(name: str, followed: str, middle_m: Array, half_m: float, hidden: Sequence[str]) -> rrb.Spatial3DView:
    """Return a 3D view that follows an entity, from the right and ahead."""
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital,
        position=middle_m + half_m * np.array([0.5, -2.0, 0.9]),
        look_target=middle_m,
        eye_up=(0.0, 0.0, 1.0),
        tracking_entity=followed,
    )
    contents = ["$origin/**", "+ shapes/**", *(f"- {entity}/**" for entity in hidden)]
    return rrb.Spatial3DView(
        origin="world", contents=contents, name=name, background=scene.BACKGROUND, line_grid=False, eye_controls=eye
    )
