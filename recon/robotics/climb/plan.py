"""Plan a climb frame by frame.

Feet follow given paths, and potential fields move the torso. Before each footfall, all four feet are planted, and the
torso shifts over the three feet that will stay down, as fast as the caps on its speed allow. Then the foot rises,
crosses and sinks at the speeds of these phases, while the torso stays in the equilibrium of its fields. Whenever the
caps delay the torso, the foot waits.

r is a leg's vector from hip to foot in body axes. X and Y are the lateral and the forward axis. Every leg has three
fields of the same form. Each is the slope of a potential well of a coordinate q:

    radial  q = |r|                        the hip is pushed along r
    swing   q = atan2(forwards, down)      along X x r, in the plane whose normal is lateral
    flap    q = atan2(outwards, down)      along r x Y, in the plane whose normal is forward

The balance field pulls the centre of mass towards the horizontal centroid of the planted feet, at distance d, with
gain tanh(sharpness d).

The publication does not say how an angle's force depends on the length of the leg, nor how it turns the torso. Here,
each field is the gradient of an energy in all degrees of freedom of the torso, so an equilibrium exists. The force of
an angle is slope (X x r) / |X x r|^2, and its moment is the moment of the same force at the foot.

Recipe files number the legs as the published footfalls do: left front, left rear, right front, right rear. Positions in
these files are (right, forward). In Python, legs are in the order of `LEGS`, and x is forward, y left and z up.

References
----------
D. Cohen, SUNFEST, University of Pennsylvania, 2005.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from pydantic import AfterValidator, BeforeValidator, Field, model_validator
from scipy.spatial.transform import RigidTransform, Rotation

from recon.base.arrays import Array, Bools, Integers
from recon.base.documents import FileTable, read_toml, validated
from recon.base.errors import InputError, Problem, collect_problems
from recon.base.files import MANIFEST, relative_name
from recon.base.locks import sole_writer
from recon.base.outputs import Output
from recon.base.settings import input_paths
from recon.geometry.frames import rigid
from recon.io.writing import write_rows
from recon.robotics.leg import Length, PositiveLength
from recon.robotics.physics import Rule, margins_figure
from recon.robotics.playback import write_robot
from recon.robotics.quadruped import LEGS, Quadruped, leg_targets, load_robot
from recon.robotics.retarget import RobotMotion, posed
from recon.robotics.retarget_clip import write_tables
from recon.robotics.settings import ClimbSettings
from recon.show.plain import to_json
from recon.show.plots.style import COLOURS, GREY, PALE, SMALL, add_legend, drawing, save
from recon.show.view.scene import LIMB_COLOURS, TimePlot

NONE = -1
"""Index that stands for "no leg" while all four feet are planted."""
COUNTERCLOCKWISE = (0, 2, 3, 1)
"""Indices into `LEGS`, counterclockwise as seen from above."""
LEFT = np.array([1.0 if label[0] == "L" else -1.0 for label in LEGS])
"""Sign of the outward y direction, 1 or -1, for each of `LEGS`."""
MAX_WAIT = 400
"""Maximum number of frames for which a foot waits for the torso."""
MAX_EVALUATIONS = 100
"""Maximum number of evaluations of the fields in one frame."""
DERIVATIVE_STEP = 1e-6
"""Change of the torso for numerical derivatives, in metres and radians."""
MIN_STEP = 1e-8
"""Minimum length of a Newton step, in metres and radians, with which the search for the equilibrium continues."""
NEWTON_REACH_M = 0.03
"""Longest shift of the torso in one Newton step, metres."""
TRUST_RAD = 0.5
"""Largest turn of the torso in one Newton step, rad."""
SHIN_POINTS = (0.25, 0.5, 0.75)
"""Points of a shin that must not touch the ground or the step, as fractions of the distance from foot to knee."""
ROUNDING_M = 1e-9
"""Depth below the surface at which a foot still counts as standing on it, because of rounding errors, metres."""
RECIPES = Path(__file__).parent / "recipes"
IN_FILES = (0, 2, 1, 3)
"""Index into `LEGS` of each leg, in the leg order of recipe files. The permutation is its own inverse."""
PLANAR = (0, 1, 2, 4)
"""Degrees of freedom of the torso in the plane: x, y, z and pitch."""
SPATIAL = (0, 1, 2, 3, 4, 5)
"""Degrees of freedom of the torso in space: x, y, z, roll, pitch and yaw."""


Gain = Annotated[float, Field(strict=True, gt=0, lt=1e9, allow_inf_nan=False)]
"""Positive weight in a recipe. The upper limit only rejects damaged files."""


def _all_legs(value: object) -> tuple[object, object, object, object]:
    """Expand one number for all legs, or two for the front and the rear legs, to one number per leg."""
    front, rear = value if isinstance(value, list) and len(value) == 2 else (value, value)
    return (front, front, rear, rear)


_Legs = Annotated[tuple[Length, Length, Length, Length], BeforeValidator(_all_legs)]
_PositiveLegs = Annotated[tuple[Gain, Gain, Gain, Gain], BeforeValidator(_all_legs)]


class _Well(FileTable):
    """A potential well of a coordinate q, with numbers for each leg and a wall at either end."""

    gain: _PositiveLegs
    """Slope of the well per unit of q, for each leg."""
    natural: _Legs
    """Coordinate q at the lowest energy, for each leg."""
    least: _Legs
    """Coordinate q of the lower wall, for each leg."""
    most: _Legs
    """Coordinate q of the upper wall, for each leg."""
    low: _PositiveLegs
    """Sharpness of the lower wall, per unit of q."""
    high: _PositiveLegs
    """Sharpness of the upper wall, per unit of q."""

    @model_validator(mode="after")
    def _in_order(self) -> _Well:
        if any(not a <= b <= c for a, b, c in zip(self.least, self.natural, self.most, strict=True)):
            raise ValueError("least <= natural <= most")
        return self

    def slope(self, q: Array) -> Array:
        """Return the slope at q (legs,), which is small between the walls (least and most) and steep outside."""
        deviation, above, below = (q - np.array(bounds) for bounds in (self.natural, self.most, self.least))
        return np.array(self.gain) * deviation * (np.exp(self.high * above) + np.exp(-np.array(self.low) * below))


class _Balance(FileTable):
    """Field that pulls the torso over its feet."""

    gain: Gain
    """Force at a large distance from the centroid."""
    sharpness: Gain
    """Steepness of the force near the centroid, per metre."""


class Fields(FileTable):
    """Potential wells of the legs and the field that balances the torso."""

    radial: _Well
    swing: _Well
    flap: _Well
    balance: _Balance


class Step(FileTable):
    """A step across the path, with the ground at height 0 up to x = edge_m, and at height_m beyond."""

    edge_m: Length
    height_m: Length

    def distance_m(self, points_m: Array) -> Array:
        """Return the distances (...) of points (..., 3) from the surface of ground and step, negative inside."""
        x, z = points_m[..., 0] - self.edge_m, points_m[..., 2] - self.height_m
        outside = np.hypot(np.maximum(-x, 0), np.maximum(z, 0))
        return np.minimum(points_m[..., 2], np.where((x > 0) & (z < 0), -np.minimum(x, -z), outside))

    def corner_m(self, points_m: Array) -> Array:
        """Return the distances (...) of points (..., 3) from the step's edge, negative inside the step."""
        x, z = points_m[..., 0] - self.edge_m, points_m[..., 2] - self.height_m
        return np.where((x > 0) & (z < 0), -1.0, 1.0) * np.hypot(x, z)


class _Footfall(FileTable):
    """The leg of one footfall, and the displacement of its foot."""

    leg: Annotated[int, Field(strict=True, ge=1, le=4), AfterValidator(lambda number: IN_FILES[number - 1])]
    """Leg that moves, as an index into `LEGS`."""
    forward_m: Length
    up_m: Length
    sideways_m: Length = 0.0
    """Displacement to the right, metres."""

    @property
    def vector_m(self) -> Array:
        return np.array([self.forward_m, -self.sideways_m, self.up_m])


class _Primitive(FileTable):
    """A group of footfalls that share their fields."""

    name: str
    rise_rad: PositiveLength
    """Angle at which the feet rise, measured from the forward direction."""
    lower_rad: PositiveLength
    """Angle at which the feet sink, measured from the backward direction."""
    footfalls: Annotated[tuple[_Footfall, ...], Field(min_length=1)]
    fields: Fields


class _Swing(FileTable):
    """Clearance of a swinging foot's path above its higher end, and the foot's speed in each phase."""

    clearance_m: PositiveLength
    rise_m_s: PositiveLength
    traverse_m_s: PositiveLength
    lower_m_s: PositiveLength


class _Pace(FileTable):
    """Largest displacement and largest rotation of the torso per frame."""

    max_step_m: PositiveLength
    max_turn_rad: PositiveLength


class Recipe(FileTable):
    """Description of a climb: robot, initial stance, step, footfalls and fields."""

    robot: str
    """Name of the robot."""
    dofs: Literal[4, 6]
    """Number of the torso's degrees of freedom."""
    fps: Gain
    stance_m: Annotated[tuple[tuple[Length, Length], ...], Field(min_length=4, max_length=4)]
    """Initial positions (right, forward) of the feet in metres, in the leg order of recipe files."""
    step: Step
    swing: _Swing
    motion: _Pace
    primitives: Annotated[tuple[_Primitive, ...], Field(min_length=1)]
    about: str = ""
    """Purpose of the recipe and source of its numbers."""

    @property
    def free(self) -> tuple[int, ...]:
        """Return the indices of the torso's free coordinates among x, y, z, roll, pitch and yaw."""
        return PLANAR if self.dofs == 4 else SPATIAL

    @property
    def feet_m(self) -> Array:
        """Return the initial positions (4, 3) of the feet in the world, metres."""
        right, forward = np.array(self.stance_m)[list(IN_FILES)].T
        return np.column_stack([forward, -right, np.zeros(4)])


def bundled() -> list[str]:
    """Return the names of the built-in recipes."""
    return sorted(p.stem for p in RECIPES.glob("*.toml"))


def load_recipe(recipe: str | Path) -> Recipe:
    """Load the built-in recipe of a given name, or a recipe from a file.

    Raises
    ------
    InputError
        If the recipe cannot be used.
    """
    path = RECIPES / f"{recipe}.toml" if str(recipe) in bundled() else Path(recipe)
    table = read_toml(path, f"a recipe of a climb: a TOML file, or one of {', '.join(bundled())}")
    return validated(Recipe, table, path)


def raised(recipe: Recipe, height_m: float) -> Recipe:
    """Return the recipe for a step of another height, with the heights of its footfalls scaled in proportion."""
    ratio = height_m / recipe.step.height_m

    def higher(primitive: _Primitive) -> _Primitive:
        falls = tuple(fall.model_copy(update={"up_m": fall.up_m * ratio}) for fall in primitive.footfalls)
        return primitive.model_copy(update={"footfalls": falls})

    step = recipe.step.model_copy(update={"height_m": height_m})
    return recipe.model_copy(update={"step": step, "primitives": tuple(map(higher, recipe.primitives))})


RULES = {
    "reach": Rule("foot within the leg's reach", "mm", per_unit=1e3),
    "limits": Rule("joints within their limits", "deg", per_unit=180 / np.pi),
    "support": Rule("centre of mass inside the polygon of the planted feet", "mm", per_unit=1e3),
    "knees": Rule("knees above ground and step", "mm", per_unit=1e3),
    "shins": Rule("shins above ground and step", "mm", per_unit=1e3),
    "hips": Rule("hips above ground and step", "mm", per_unit=1e3),
    "corner": Rule("lifted foot from the step's edge", "mm", per_unit=1e3),
    "footing": Rule("planted feet from the step's edge", "mm", per_unit=1e3),
}


@dataclass(frozen=True, eq=False)
class Climb:
    """A planned climb of T frames, in a world with x forward, y left and z up."""

    recipe: Recipe
    motion: RobotMotion
    lifted: Integers
    """Index of the lifted leg in each frame, or `NONE`, shape (T,)."""
    footfall: Integers
    """Index of each frame's footfall in the recipe, shape (T,). The final shift has the index of the last footfall."""
    evaluations: Integers
    """Number of evaluations of the fields in each frame, shape (T,)."""
    settled: Bools
    """Whether the search for the torso's equilibrium converged in each frame, shape (T,)."""

    @property
    def pitch_rad(self) -> Array:
        """Return the pitch in rad, shape (T,), positive with the nose up."""
        return np.arcsin(np.clip(self.motion.pose.rotation.as_matrix()[:, 2, 0], -1, 1))

    @cached_property
    def margins(self) -> dict[str, Array]:
        """Return the smallest margin (T,) of each rule in every frame.

        A margin is negative if the rule is broken, and infinite if the rule does not apply.
        """
        step, feet, robot = self.recipe.step, self.motion.feet_m, self.motion.robot
        targets, positions = leg_targets(self.motion.pose, np.zeros(3), feet), [self.motion.points(x) for x in LEGS]
        hips, knees = (np.stack([of_leg[:, k] for of_leg in positions], axis=1) for k in (0, 2))
        shins = np.concatenate([feet + f * (knees - feet) for f in SHIN_POINTS], axis=1)
        edge = np.where(feet[..., 2] > step.height_m / 2, 1, -1) * (feet[..., 0] - step.edge_m)
        legs = list(enumerate(robot.legs.values()))
        # A leg whose foot is out of reach has no angles. "reach" reports it, so "limits" leaves it out.
        limits = [np.nan_to_num(leg.margins(leg.closed_angles(targets[:, k])), nan=np.inf) for k, leg in legs]
        is_lifted = self.lifted[:, None] == np.arange(4)
        margins = {
            "reach": np.column_stack([leg.slack_m(targets[:, k]) for k, leg in legs]),
            "limits": np.concatenate(limits, axis=1),
            "support": support_m(self.motion.position_m[:, :2], feet[..., :2], self.lifted),
            "knees": step.distance_m(knees),
            "shins": step.distance_m(shins),
            "hips": step.distance_m(hips),
            "corner": np.where(is_lifted, step.corner_m(feet), np.inf),
            "footing": np.where(is_lifted, np.inf, edge),
        }
        return {name: values.min(axis=1) for name, values in margins.items()}

    @property
    def least(self) -> dict[str, tuple[float, int]]:
        """Return the smallest margin of each rule, in the rule's unit, and the frame in which it occurs."""
        frames = {name: int(values.argmin()) for name, values in self.margins.items()}
        return {name: (float(self.margins[name][k]) * RULES[name].per_unit, k) for name, k in frames.items()}

    def problems(self) -> list[str]:
        """Return one line of text for each broken rule; empty for a valid climb."""
        step, feet = self.recipe.step, self.motion.feet_m
        least = ((RULES[name], *margin_and_frame) for name, margin_and_frame in self.least.items())
        problems = [f"{rule.title}: {value:.2f} {rule.unit} in frame {k}" for rule, value, k in least if not value >= 0]
        deepest = -float(step.distance_m(feet).min())
        if deepest > ROUNDING_M:
            problems.append(f"a foot is {1000 * deepest:.2f} mm below the surface")
        if not np.all((feet[-1, :, 0] > step.edge_m) & (np.abs(feet[-1, :, 2] - step.height_m) < ROUNDING_M)):
            problems.append("not all feet end on top of the step")
        return problems


def support_m(centre_m: Array, feet_m: Array, lifted: Integers) -> Array:
    """Return the distances of the centre of mass from the sides of the support polygon, shape (..., 8), metres.

    `centre_m` has the shape (..., 2), and `feet_m` (..., 4, 2). A line between two feet that is not a side of the
    polygon has an infinite distance.
    """
    feet = feet_m[..., COUNTERCLOCKWISE, :]
    up = np.asarray(lifted)[..., None] == np.array(COUNTERCLOCKWISE)
    distances = []
    for separations in (1, 2):
        a, b = feet, np.roll(feet, -separations, axis=-2)
        side, to_centre = b - a, centre_m[..., None, :] - a
        # Legs are in counterclockwise order, so the inside is on the left of every side.
        left = (side[..., 0] * to_centre[..., 1] - side[..., 1] * to_centre[..., 0]) / np.linalg.norm(side, axis=-1)
        applies = ~(up | np.roll(up, -1, axis=-1)) if separations == 1 else np.roll(up, -1, axis=-1)
        distances.append(np.where(applies, left, np.inf))
    return np.concatenate(distances, axis=-1)


def plan(robot: Quadruped, recipe: Recipe) -> Climb:
    """Plan the climb of a recipe, which may be invalid (`Climb.problems`).

    Raises
    ------
    InputError
        If a leg is not given by its dimensions, or if its swing joint does not come first.
    """
    if any(leg.closed is None or leg.closed.first != "swing" for leg in robot.legs.values()):
        expected = "a robot such as aibo, with legs given by dimensions and the swing joint first"
        raise InputError(Problem(robot.name, "legs", "legs that cannot climb", expected))
    hips, feet, pace = np.array([leg.hip_m for leg in robot.legs.values()]), recipe.feet_m, recipe.motion
    fields = recipe.primitives[0].fields
    height = float(np.mean(fields.radial.natural)) - hips[:, 2].mean()
    torso = rigid(np.eye(3), np.array([*feet[:, :2].mean(axis=0), height]))
    torso = goal = equilibrium(fields, hips, feet, NONE, torso, recipe.free)[0]
    rows: list[tuple] = []

    def settle(fields: Fields, without: int, *label: int) -> None:
        """Add a frame in which the torso settles in the fields, and further frames while the caps delay the torso.

        The feet wait in the further frames.
        """
        nonlocal torso, goal
        for _ in range(MAX_WAIT):
            goal, count, settled = equilibrium(fields, hips, feet, without, goal, recipe.free)
            turn = Rotation.from_matrix(torso[:3, :3].T @ goal[:3, :3]).as_rotvec()
            step = np.concatenate([goal[:3, 3] - torso[:3, 3], turn])
            short = capped(step, pace.max_step_m, pace.max_turn_rad)
            torso = _moved(torso, short)
            rows.append((torso, feet, *label, count, settled))
            if np.array_equal(short, step):
                return

    number = 0
    for primitive in recipe.primitives:
        fields = primitive.fields
        for fall in primitive.footfalls:
            settle(fields, fall.leg, NONE, number)
            for point in swing_path(recipe, primitive, feet[fall.leg], feet[fall.leg] + fall.vector_m):
                feet = feet.copy()
                feet[fall.leg] = point
                settle(fields, fall.leg, fall.leg, number)
            number += 1
    settle(fields, NONE, NONE, number - 1)
    poses, positions, lifted, *other_legs = (np.array(column) for column in zip(*rows, strict=True))
    time_s, standing = np.arange(len(rows)) / recipe.fps, lifted[:, None] != np.arange(4)
    return Climb(
        recipe, posed(robot, time_s, RigidTransform.from_matrix(poses), positions, standing), lifted, *other_legs
    )


def wrench(fields: Fields, hips_m: Array, feet_m: Array, without: int, torso: Array) -> Array:
    """Return the force (world axes) and the moment about the centre of mass (body axes) for N poses, shape (N, 6).

    Parameters
    ----------
    fields : Fields
        Fields of the legs and of the balance.
    hips_m : (4, 3)
        Hips in body axes, metres.
    feet_m : (4, 3)
        Feet in the world, metres.
    without : int
        Leg whose foot the balance field leaves out, or `NONE`.
    torso : (N, 4, 4)
        T_world_body.
    """
    rotation, place_m = torso[:, :3, :3], torso[:, :3, 3]
    arm = (feet_m - place_m[:, None]) @ rotation
    x, y, z = np.moveaxis(arm - hips_m, -1, 0)
    outwards, length = LEFT * y, np.sqrt(x * x + y * y + z * z)
    radial = fields.radial.slope(length) / length
    swing = fields.swing.slope(np.arctan2(x, -z)) / (x * x + z * z)
    flap = fields.flap.slope(np.arctan2(outwards, -z)) / (y * y + z * z)
    forces = np.stack(
        [radial * x - swing * z, radial * y - flap * LEFT * z, radial * z + swing * x + flap * outwards], axis=-1
    )
    force, moment = (rotation @ forces.sum(axis=1)[..., None])[..., 0], np.cross(arm, forces).sum(axis=1)
    to_feet = feet_m[np.arange(4) != without, :2].mean(axis=0) - place_m[:, :2]
    distance, balance = np.maximum(np.linalg.norm(to_feet, axis=1), 1e-12)[:, None], fields.balance
    force[:, :2] += balance.gain * np.tanh(balance.sharpness * distance) / distance * to_feet
    return np.concatenate([force, moment], axis=1)


def equilibrium(
    fields: Fields, hips_m: Array, feet_m: Array, without: int, start: Array, free: tuple[int, ...]
) -> tuple[Array, int, bool]:
    """Search for the torso's pose of lowest energy near the start.

    The search applies Newton's method to forces and moments, with the absolute values of the stiffness's eigenvalues.
    `start` is T_world_body (4, 4). `free` holds the indices of the free coordinates among x, y, z, roll, pitch and yaw.
    The other parameters are the same as in `wrench`.

    Returns
    -------
    tuple
        The pose T_world_body (4, 4), the number of evaluations, and whether the search converged.
    """
    columns, n, torso = list(free), len(free), start
    nudges = np.zeros((2 * n + 1, 6))
    nudges[1:, columns] = DERIVATIVE_STEP * np.concatenate([np.eye(n), -np.eye(n)])
    for count in range(1, MAX_EVALUATIONS):
        solution = wrench(fields, hips_m, feet_m, without, _moved(torso, nudges))[:, columns]
        stiffness = (solution[n + 1 :] - solution[1 : n + 1]) / (2 * DERIVATIVE_STEP)
        values, vectors = np.linalg.eigh((stiffness + stiffness.T) / 2)
        step = np.zeros(6)
        step[columns] = vectors @ (vectors.T @ solution[0] / np.abs(values))
        torso = _moved(torso, capped(step, NEWTON_REACH_M, TRUST_RAD))
        if np.linalg.norm(step) < MIN_STEP:
            return torso, count, True
    return torso, MAX_EVALUATIONS, False


def _moved(torso: Array, step: Array) -> Array:
    """Return a torso T_world_body (4, 4), shifted in world axes and turned in body axes by a step, (6,) or (N, 6)."""
    return rigid(torso[:3, :3] @ Rotation.from_rotvec(step[..., 3:]).as_matrix(), torso[:3, 3] + step[..., :3])


def swing_path(recipe: Recipe, primitive: _Primitive, start_m: Array, end_m: Array) -> Array:
    """Return the positions (n, 3) of a swinging foot in each frame, as it rises at one angle and sinks at another.

    `start_m` and `end_m` (3,) are the ends of the path in the world, m. The angles are those of `primitive`.
    """
    s = recipe.swing
    corners = path_corners(start_m, end_m, s.clearance_m, primitive.rise_rad, primitive.lower_rad)
    points = []
    for a, b, speed in zip(corners, corners[1:], (s.rise_m_s, s.traverse_m_s, s.lower_m_s), strict=False):
        n = int(np.ceil(float(np.linalg.norm(b - a)) / speed * recipe.fps - 1e-9))
        points.append(a + (np.arange(1, n + 1) / max(n, 1))[:, None] * (b - a))
    return np.concatenate(points)


def path_corners(start_m: Array, end_m: Array, clearance_m: float, rise_rad: float, lower_rad: float) -> Array:
    """Return the four corners (4, 3) of a foot's trapezoidal path from `start_m` (3,) to `end_m` (3,).

    The foot rises at `rise_rad` above the forward direction (an angle above 90 degrees leans back) and sinks at
    `lower_rad` above the backward direction, both in the vertical plane along x. In between, the foot moves forwards
    and sideways at `clearance_m` above the higher end. If the two slopes do not fit into the length of the path, both
    become steeper until they meet.
    """
    top = max(start_m[2], end_m[2]) + clearance_m
    ahead, back = (top - start_m[2]) / np.tan(rise_rad), (top - end_m[2]) / np.tan(lower_rad)
    way = max(end_m[0] - start_m[0], 0.0)
    over = way / max(ahead + back, 1e-12) if ahead + back > way else 1.0
    first = [start_m[0] + over * ahead, start_m[1], top]
    second = [end_m[0] - over * back, end_m[1], top]
    return np.array([start_m, first, second, end_m])


def capped(step: Array, max_step_m: float, max_turn_rad: float) -> Array:
    """Return a step (6,), scaled down as a whole until its displacement and its rotation are within the limits."""
    shift, turn = float(np.linalg.norm(step[:3])), float(np.linalg.norm(step[3:]))
    return step / max(1.0, shift / max_step_m, turn / max_turn_rad)


REPORT, PLAYBACK = "report.json", "climb.rrd"
FILES = ("joints.csv", "base.csv", "feet.csv", "margins.csv", REPORT, PLAYBACK, MANIFEST)
"""Files that every climb writes, besides its figures."""
_COLUMNS = 4


def run_climb(settings: ClimbSettings) -> dict[str, Any]:
    """Plan a climb, write its tables, figures and playback, and return the content of report.json.

    Raises
    ------
    InputError
        If the recipe or its robot cannot be used, or if the folder has files that may not be replaced.
    """
    out = settings.out
    output = Output(out, "climb", settings.overwrite, input_paths(settings), has_manifest=True, mark=PLAYBACK)
    recipe, _ = collect_problems(lambda: load_recipe(settings.recipe), lambda: output.require(FILES))
    done = plan(load_robot(recipe.robot), recipe if settings.height is None else raised(recipe, settings.height))
    report = _report(done, settings)
    with sole_writer(out):
        output.require(FILES)
        with output.staged() as staging:
            _write(done, report, staging)
            if settings.figures:
                save(climb_footfalls(done), staging, "footfalls")
                save(margins_figure(done.motion.time_s, done.margins, RULES, _title(done)), staging, "margins")
    return report


def _report(climb: Climb, settings: ClimbSettings) -> dict[str, Any]:
    recipe, time_s = climb.recipe, climb.motion.time_s
    name = relative_name(settings.out, settings.recipe)
    least = {
        rule: {"what": RULES[rule].title, "unit": RULES[rule].unit}
        | {"value": value, "at_s": float(time_s[k]), "lifted": _lifted(climb, k) or "none"}
        for rule, (value, k) in climb.least.items()
    }
    return {
        "schema": {"name": "recon.climb", "version": 1},
        "robot": climb.motion.robot.name,
        "recipe": {"name": name, "about": recipe.about, "degrees_of_freedom": recipe.dofs},
        "step_m": recipe.step.height_m,
        "edge_m": recipe.step.edge_m,
        "valid": not climb.problems(),
        "problems": climb.problems(),
        "least_margins": least,
        "frames": len(time_s),
        "duration_s": float(time_s[-1]),
        "evaluations_per_frame": float(climb.evaluations.mean()),
        "settled_share": float(climb.settled.mean()),
        "largest_pitch_rad": float(climb.pitch_rad.max()),
        "rate_share": float(climb.motion.rate_share.max()),
    }


def _lifted(climb: Climb, frame: int) -> str:
    leg = int(climb.lifted[frame])
    return "" if leg == NONE else LEGS[leg]


def _write(climb: Climb, report: dict[str, Any], folder: Path) -> None:
    write_tables(climb.motion, folder, "")
    names = [f"{rule}_{'rad' if RULES[rule].unit == 'deg' else 'm'}" for rule in RULES]
    columns = np.column_stack([climb.motion.time_s, *climb.margins.values()])
    rows = [["" if np.isinf(x) else x for x in row] for row in columns.tolist()]
    write_rows(folder / "margins.csv", [["time_s", *names]], rows)
    (folder / REPORT).write_text(to_json(report), encoding="utf-8")
    inside, nose = 1000 * climb.margins["support"], np.degrees(climb.pitch_rad)
    curves = [
        TimePlot("margin", "centre of mass inside the planted feet, mm", ["margin"], LIMB_COLOURS[:1], inside[:, None]),
        TimePlot("pitch", "pitch, degrees, nose up", ["pitch"], LIMB_COLOURS[:1], nose[:, None]),
    ]
    write_robot(
        climb.motion,
        folder / PLAYBACK,
        step=(climb.recipe.step.edge_m, climb.recipe.step.height_m),
        plots=curves,
        title=_title(climb),
    )


def _title(climb: Climb) -> str:
    return f"{climb.motion.robot.name} climbs a step of {1000 * climb.recipe.step.height_m:.0f} mm"


def climb_footfalls(climb: Climb) -> Figure:
    """Draw the robot from the right at the start, in the middle of every footfall, and at the end."""
    frames = [0]
    for k in np.unique(climb.footfall):
        up = np.flatnonzero((climb.footfall == k) & (climb.lifted != NONE))
        frames.append(int(up[len(up) // 2]))
    frames.append(len(climb.lifted) - 1)
    rows, dashed, step = -(-len(frames) // _COLUMNS), (0, (2, 1)), climb.recipe.step
    legs = {label: climb.motion.points(label)[..., [0, 2]] for label in LEGS}
    ends = climb.motion.feet_m[..., 0].min() - 0.05, climb.motion.feet_m[..., 0].max() + 0.05
    with drawing(24.0 * rows + 20, title=_title(climb)) as figure:
        panels = np.ravel(figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False))
        for axes, frame in zip(panels, frames, strict=False):
            ground = [ends[0], step.edge_m, step.edge_m, ends[1]]
            axes.plot(ground, [0, 0, step.height_m, step.height_m], color=GREY, lw=1)
            up = _lifted(climb, frame)
            for label, of_leg in legs.items():
                line = dashed if label == up else "-"
                axes.plot(*of_leg[frame].T, marker="o", ms=2, color=COLOURS[label[0] == "R"], ls=line)
            hips = np.array([legs[label][frame, 0] for label in ("LF", "LH", "RH", "RF", "LF")])
            axes.plot(*hips.T, color=COLOURS[2], lw=2)
            text = f"{climb.motion.time_s[frame]:.1f} s, {up or 'all planted'}"
            axes.set_title(text, fontsize=SMALL, pad=2)
            axes.set_aspect("equal")
        for axes in panels[len(frames) :]:
            axes.set_axis_off()
        for axes in panels[len(frames) - _COLUMNS : len(frames)]:
            axes.tick_params(labelbottom=True)
            axes.set_xlabel("forward (m)")
        figure.supylabel("up (m)", fontsize=8)
        lines = [Line2D([], [], color=colour) for colour in COLOURS[:2]]
        lines.append(Line2D([], [], color=PALE, ls=dashed))
        add_legend(figure, lines, ["left legs", "right legs", "lifted foot"])
    return figure
