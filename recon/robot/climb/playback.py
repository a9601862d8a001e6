"""A climb as a rerun recording: the robot in lines, the step, the polygon of the planted feet and two curves."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from recon.arrays import Array
from recon.files import staged_file
from recon.recording import recording
from recon.robot.climb.margins import margins
from recon.robot.climb.plan import Climb
from recon.robot.climb.walker import AROUND

LEFT, RIGHT, MIDDLE = (86, 180, 233), (230, 159, 0), (0, 158, 115)
SUPPORT, GROUND, OVER = (240, 228, 66), (130, 130, 140), (255, 255, 255)
WIDE_M, BEFORE_M, BEHIND_M = 0.15, 0.2, 0.4
"""How far the ground is drawn."""


def write_playback(climb: Climb, path: str | Path) -> None:
    """The recording (.rrd), written whole or not at all."""
    path = Path(path)
    world = rrb.Spatial3DView(origin="world", name="climb", background=rrb.Background((18, 21, 27)))
    curves = rrb.Vertical(
        rrb.TimeSeriesView(origin="pitch", name="pitch, degrees, nose up"),
        rrb.TimeSeriesView(origin="support", name="centre of mass inside the planted feet, mm"),
    )
    blueprint = rrb.Blueprint(rrb.Horizontal(world, curves, column_shares=[2, 1]), collapse_panels=True)
    with staged_file(path) as staged, recording(staged, blueprint) as stream:
        stream.send_recording_name(f"{climb.walker.name}, step of {1000 * climb.recipe.step.height_m:.0f} mm")
        _write(climb, stream)


def lines(climb: Climb) -> tuple[Array, Array]:
    """The torso's outline (T, 5, 3), and hip, knee and foot of every leg (T, 4, 3, 3)."""
    posture = climb.walker.posture(climb.torso, climb.feet_m)
    outline = posture.hips_m[:, (*AROUND, AROUND[0])]
    return outline, np.stack([posture.hips_m, posture.knees_m, climb.feet_m], axis=-2)


def step_lines(climb: Climb) -> Array:
    """(3, 4, 3): the profile of the ground and the step on the left, in the middle and on the right."""
    step, ends = climb.recipe.step, climb.feet_m[..., 1]
    y = [float(ends.min()) - BEFORE_M, step.edge_m, step.edge_m, float(ends.max()) + BEHIND_M]
    z = [0.0, 0.0, step.height_m, step.height_m]
    return np.array([np.column_stack([np.full(4, x), y, z]) for x in (-WIDE_M, 0.0, WIDE_M)])


def _write(climb: Climb, stream: rr.RecordingStream) -> None:
    stream.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    profile = step_lines(climb)
    across = np.swapaxes(profile[[0, 2]], 0, 1)
    stream.log("world/step", rr.LineStrips3D([*profile, *across], colors=GROUND, radii=0.0008), static=True)
    outline, legs = lines(climb)
    inside = margins(climb.walker, climb.recipe.step, climb.torso, climb.feet_m, climb.lifted)["support"].min(axis=-1)
    colours = [LEFT if side < 0 else RIGHT for side in climb.walker.side]
    for k, t in enumerate(climb.time_s):
        stream.set_time("frame", sequence=k)
        stream.set_time("time", duration=float(t))
        planted = [leg for leg in AROUND if leg != climb.lifted[k]]
        polygon = climb.feet_m[k][[*planted, planted[0]]]
        centre = climb.position_m[k]
        below = np.array([*centre[:2], float(climb.recipe.step.surface_m(centre[1]))])
        stream.log("world/torso", rr.LineStrips3D([outline[k]], colors=MIDDLE, radii=0.003))
        stream.log("world/legs", rr.LineStrips3D(legs[k], colors=colours, radii=0.002))
        stream.log("world/support", rr.LineStrips3D([polygon], colors=SUPPORT, radii=0.0008))
        stream.log("world/centre", rr.LineStrips3D([[centre, below]], colors=OVER, radii=0.0006))
        stream.log("pitch", rr.Scalars(float(np.degrees(climb.pitch_rad[k]))))
        stream.log("support", rr.Scalars(1000 * float(inside[k])))
