"""Climbing by potential fields: fields against their formula and differences, equilibria, paths, margins, climbs."""

from __future__ import annotations

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from command_line import run
from rerun.chunk import RrdReader
from scipy.integrate import quad
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from recon.base.errors import InputError
from recon.robotics.climb import ClimbCheck, Recipe, Walker, bundled, load_recipe, plan, raised, scaled
from recon.robotics.climb.check import support_m
from recon.robotics.climb.fields import (
    PLANAR,
    SPATIAL,
    Fields,
    Stand,
    Torso,
    Well,
    _Balance,
    equilibrium,
    evaluate,
    leg_forces,
)
from recon.robotics.climb.plan import LABELS, NONE, capped, path_corners, swing_path
from recon.robotics.climb.plots import climb_field, climb_margins
from recon.robotics.climb.recipe import RECIPES, Step
from recon.robotics.climb.run import before, robot_motion
from recon.robotics.robot.quadruped import LEGS, Quadruped, closed_leg
from recon.robotics.robot.retarget import posed
from recon.robotics.robot.rigid import body_pose
from recon.robotics.robot.robot_file import load_robot

HIPS = np.array([[-0.0625, 0.065, 0], [-0.0625, -0.065, 0], [0.0625, 0.065, 0], [0.0625, -0.065, 0]])
SIDE = np.sign(HIPS[:, 0])


def well(*numbers: float) -> Well:
    """The same for all legs."""
    return Well(*((number,) * 4 for number in numbers))


FIELDS = Fields(
    well(1.0, 0.12, 0.1, 0.135, 120.0, 150.0),
    well(0.02, 0.1, -0.6, 0.7, 8.0, 9.0),
    well(0.02, 0.05, -0.1, 0.5, 7.0, 8.0),
    _Balance(0.3, 60.0),
)
ARM_M = 0.065
HERE = Torso(np.zeros(3), np.eye(3))


def stand(seed: int) -> Stand:
    rng = np.random.default_rng(seed)
    feet = HIPS * [1.2, 1, 1] + [0, 0, -0.12] + rng.normal(size=(4, 3)) * 0.01
    return Stand(FIELDS, HIPS, SIDE, feet, rng.normal(size=2) * 0.01)


def torso(seed: int) -> Torso:
    rng = np.random.default_rng(100 + seed)
    return Torso(rng.normal(size=3) * 0.01, Rotation.from_rotvec(rng.normal(size=3) * 0.15).as_matrix())


@pytest.fixture(scope="module")
def walker() -> Walker:
    return Walker(load_robot("aibo"))


# -- fields ----------------------------------------------------------------------------------------------------------


def test_slope_of_a_well_is_the_published_form_and_its_energy_the_integral():
    one = well(2.0, 0.12, 0.1, 0.135, 120.0, 150.0)
    for x in (0.08, 0.1, 0.12, 0.135, 0.15):
        slope = 2.0 * (x - 0.12) * (np.exp(150 * (x - 0.135)) + np.exp(120 * (0.1 - x)))
        assert float(one.of(np.array(x))[1][0]) == pytest.approx(slope, rel=1e-12, abs=1e-15)
    work, _ = quad(lambda x: float(one.of(np.array(x))[1][0]), 0.09, 0.15)
    energy = one.of(np.array([[0.09], [0.15]]))[0]
    np.testing.assert_allclose(energy[1] - energy[0], work, rtol=1e-9)


def test_a_leg_in_the_dead_zone_pulls_little_and_hard_beyond():
    of = FIELDS.radial.of
    inside, beyond = abs(of(np.array([[0.11], [0.125]]))[1]), abs(of(np.array([[0.08], [0.155]]))[1])
    assert inside.max() < 0.01
    assert beyond.min() > 20 * inside.max()
    assert (of(np.array(0.12))[1] == 0).all()


def test_fields_act_along_the_published_directions():
    r, x, y = np.array([0.03, 0.05, -0.1]), np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    radial, swing, flap = leg_forces(replace(stand(0), side=np.ones(4)), np.tile(r, (4, 1)))[:, 0]
    a, b = np.cross(x, r), np.cross(r, y)
    slopes = (
        float(kind.of(np.array(q))[1][0])
        for kind, q in (
            (FIELDS.radial, np.linalg.norm(r)),
            (FIELDS.swing, np.arctan(0.05 / 0.1)),  # from straight down, in the plane whose normal is lateral
            (FIELDS.flap, np.arctan(0.03 / 0.1)),
        )
    )
    np.testing.assert_allclose(radial, next(slopes) * r / np.linalg.norm(r), rtol=1e-12)
    np.testing.assert_allclose(swing, next(slopes) * a / (a @ a), rtol=1e-12)
    np.testing.assert_allclose(flap, next(slopes) * b / (b @ b), rtol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_wrench_is_the_gradient_and_the_jacobian_its_derivative(seed):
    s, t, h = stand(seed), torso(seed), 1e-6
    _, wrench, jacobian = evaluate(s, t)
    ways = [(evaluate(s, t.moved(h * e)), evaluate(s, t.moved(-h * e))) for e in np.eye(6)]
    np.testing.assert_allclose(wrench, [-(a[0] - b[0]) / (2 * h) for a, b in ways], atol=1e-8)
    np.testing.assert_allclose(jacobian, np.transpose([(a[1] - b[1]) / (2 * h) for a, b in ways]), atol=2e-6)
    # Many torsos at once are those one by one.
    for one, many in zip(evaluate(s, t), evaluate(s, Torso(*(np.stack([x, x]) for x in t))), strict=True):
        np.testing.assert_allclose(many, np.stack([one, one]), atol=1e-15)


def test_balance_pulls_to_the_centroid_with_a_gain_that_saturates():
    nowhere = well(1e-12, 0.12, 0.1, 0.135, 1.0, 1.0)
    only = replace(stand(0), fields=Fields(nowhere, nowhere, nowhere, _Balance(0.3, 60.0)))
    far, near = (replace(only, target_m=np.array(at)) for at in ([3.0, 4.0], [0.003, 0.004]))
    np.testing.assert_allclose(evaluate(far, HERE)[1][:2], 0.3 * np.array([0.6, 0.8]), atol=1e-9)
    expected = 0.3 * np.tanh(60 * 0.005) * np.array([0.6, 0.8])
    np.testing.assert_allclose(evaluate(near, HERE)[1][:2], expected, atol=1e-9)
    level = evaluate(replace(only, target_m=np.zeros(2)), HERE)
    np.testing.assert_allclose(level[2][:2, :2], -0.3 * 60 * np.eye(2), atol=1e-9)


# -- equilibria ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dofs", [PLANAR, SPATIAL])
def test_the_equilibrium_is_that_of_scipy(dofs):
    s = stand(1)
    found, evaluations, settled = equilibrium(s, HERE, dofs, ARM_M)
    assert settled
    assert evaluations < 12

    def balance(v: np.ndarray) -> np.ndarray:
        step = np.zeros(6)
        step[list(dofs)] = v
        return evaluate(s, HERE.moved(step))[1][list(dofs)]

    # A turn about one fixed axis, or none at all: the same rotation vector from both.
    oracle = np.zeros(6)
    oracle[list(dofs)] = root(balance, np.zeros(len(dofs)), tol=1e-13).x
    np.testing.assert_allclose(HERE.step_to(found), oracle, atol=1e-8)
    if dofs == PLANAR:  # it neither rolls nor yaws
        np.testing.assert_allclose(found.rotation[0], [1, 0, 0], atol=1e-14)


def test_caps_shorten_a_step_as_a_whole():
    step = np.array([0.03, 0.04, 0, 0.02, 0, 0])
    np.testing.assert_allclose(capped(step, 0.01, 1.0), step / 5)
    np.testing.assert_allclose(capped(step, 1.0, 0.01), step / 2)
    np.testing.assert_array_equal(capped(step, 1.0, 1.0), step)


# -- paths, the step and margins -------------------------------------------------------------------------------------


def test_a_path_rises_and_sinks_at_its_angles_and_goes_sideways_only_across():
    start, end = np.array([0.07, 0.0, 0.0]), np.array([0.09, 0.08, 0.05])
    a, b, c, d = path_corners(start, end, 0.01, np.radians(75), np.radians(60))
    assert np.degrees(np.arctan2(b[2] - a[2], b[1] - a[1])) == pytest.approx(75)
    assert np.degrees(np.arctan2(c[2] - d[2], d[1] - c[1])) == pytest.approx(60)
    assert b[2] == c[2] == pytest.approx(0.06)
    np.testing.assert_array_equal([a[0], b[0], c[0], d[0]], [0.07, 0.07, 0.09, 0.09])


def test_a_foot_goes_its_path_at_the_speeds_of_the_phases():
    recipe = load_recipe("published-50")
    primitive = recipe.primitives[0]
    falls, start = primitive.footfalls[1], np.array([-0.1, 0.08, 0.0])
    path = swing_path(recipe, primitive, falls, start)
    np.testing.assert_allclose(path[-1], start + falls.vector_m)
    assert path[:, 2].max() == pytest.approx(0.05 + recipe.swing.clearance_m)
    speeds = np.linalg.norm(np.diff(path, axis=0, prepend=start[None]), axis=1) * recipe.fps
    assert speeds.max() <= recipe.swing.traverse_m_s * (1 + 1e-9)
    assert speeds[0] == pytest.approx(recipe.swing.rise_m_s, rel=0.05)


def test_slopes_that_are_too_long_meet_above_the_clearance():
    path = path_corners(np.zeros(3), np.array([0, 0.01, 0.0]), 0.02, np.radians(45), np.radians(45))
    np.testing.assert_allclose(path[:, 1], [0, 0.005, 0.005, 0.01])
    np.testing.assert_allclose(path[:, 2], [0, 0.02, 0.02, 0])


def test_distance_from_ground_and_step():
    step = Step(edge_m=0.1, height_m=0.05)
    points = np.array(
        [[0, 0, 0.02], [0, 0.09, 0.02], [0, 0.12, 0.06], [0, 0.12, 0.02], [0, 0.07, 0.09], [0, 0.05, -0.01]]
    )
    np.testing.assert_allclose(step.distance_m(points), [0.02, 0.01, 0.01, -0.02, 0.05, -0.01], atol=1e-12)
    np.testing.assert_allclose(step.corner_m(points[3:5]), [-np.hypot(0.02, 0.03), 0.05])


def test_support_is_the_distance_to_the_nearest_side_of_the_triangle_or_the_quadrangle():
    square = np.array([[-1.0, 1], [-1, -1], [1, 1], [1, -1]])
    assert support_m(np.zeros(2), square, np.array(NONE)).min() == pytest.approx(1)
    assert support_m(np.array([0.0, -0.5]), square, np.array(NONE)).min() == pytest.approx(0.5)
    for lifted in range(4):
        assert support_m(np.zeros(2), square, np.array(lifted)).min() == pytest.approx(0)
        away = -0.3 * square[lifted]
        assert support_m(away, square, np.array(lifted)).min() == pytest.approx(0.3 * np.sqrt(2))
        assert support_m(-away, square, np.array(lifted)).min() == pytest.approx(-0.3 * np.sqrt(2))


def test_postures_agree_with_the_legs(walker):
    feet, at = HIPS * [1.2, 1, 0] + [0, 0.01, 0], Torso(np.array([[0, 0, 0.11]]), np.eye(3)[None])
    angles, slack, hips, knees = walker.posture(at, feet[None])
    assert (slack > 0).all()
    for k, leg in enumerate(walker.legs):
        np.testing.assert_allclose(hips[0, k] + leg.forward(angles[0, k]), feet[k], atol=1e-12)
        l1, uo, (a, b, _) = leg.thigh_m, leg.knee_offset_m, angles[0, k]
        below = l1 * np.cos(b)
        knee = [l1 * np.sin(b), below * np.sin(a) + uo * np.cos(a), uo * np.sin(a) - below * np.cos(a)]
        np.testing.assert_allclose(knees[0, k] - hips[0, k], np.array(knee) * leg.mirror, atol=1e-12)
    angles, slack, _, _ = walker.posture(Torso(np.array([[0, 0, 0.2]]), np.eye(3)[None]), feet[None])
    assert (slack < 0).all()
    assert np.isfinite(angles).all()


# -- recipes and climbs ----------------------------------------------------------------------------------------------


PUBLISHED = {
    "front-up": ((2, 65, 0), (1, 70, 50), (3, 70, 50), (4, 60, 0)),
    "move-forward": ((1, 70, 0), (3, 70, 0), (2, 70, 0), (4, 60, 0)),
    "rear-up": ((1, 85, 0), (2, 75, 50), (3, 85, 0), (4, 60, 50)),
}
"""Leg, from 1 as in `LEGS`; forward and up, mm (D. Cohen, SUNFEST, University of Pennsylvania, 2005). The heights in
rear-up are printed as 0, 30, -10, 30 mm, with the plastic casings of the feet; here feet are points: 0, 50, 0, 50."""


@pytest.mark.parametrize("height", [0.05, 0.035])
def test_published_footfalls(height):
    recipe = raised(load_recipe("published-50"), height)
    ratio = recipe.step.height_m / 0.05
    for primitive in recipe.primitives:
        for found, (leg, forward, up) in zip(primitive.footfalls, PUBLISHED[primitive.name], strict=True):
            assert (found.leg, found.forward_m) == (leg - 1, pytest.approx(forward / 1000))
            assert found.up_m == pytest.approx(up / 1000 * ratio)
    assert [primitive.name for primitive in recipe.primitives] == list(PUBLISHED)


@pytest.mark.parametrize("name", bundled())
def test_every_bundled_climb_is_valid_in_every_frame(walker, name):
    recipe = load_recipe(name)
    climb = plan(walker, recipe)
    found = ClimbCheck(climb)
    assert found.problems() == []
    assert climb.settled.all()
    assert found.rate_share <= 1
    assert np.isfinite(climb.angles_rad).all()
    # By other means: the feet of the angles, the triangle by barycentric coordinates, limits of the description.
    for k, leg in enumerate(walker.legs):
        body = np.einsum("tij,tj->ti", climb.rotation.transpose(0, 2, 1), climb.feet_m[:, k] - climb.position_m)
        np.testing.assert_allclose(leg.forward(climb.angles_rad[:, k]), body - walker.hips_m[k], atol=1e-9)
    for k in np.flatnonzero(climb.lifted >= 0):
        planted = climb.feet_m[k][np.arange(4) != climb.lifted[k], :2]
        shares = np.linalg.solve(np.vstack([planted.T, np.ones(3)]), [*climb.position_m[k, :2], 1])
        assert shares.min() > 0
    still = climb.lifted[1:, None] != np.arange(4)
    assert np.abs(np.diff(climb.feet_m, axis=0)[still]).max() == 0
    np.testing.assert_allclose(climb.feet_m[-1, :, 2], recipe.step.height_m, atol=1e-9)
    steps = Torso(*(x[:-1] for x in climb.torso)).step_to(Torso(*(x[1:] for x in climb.torso)))
    assert np.linalg.norm(steps[:, :3], axis=1).max() <= recipe.motion.max_step_m * (1 + 1e-9)
    assert np.linalg.norm(steps[:, 3:], axis=1).max() <= recipe.motion.max_turn_rad * (1 + 1e-9)
    if recipe.dofs == 4:
        np.testing.assert_allclose(climb.rotation[:, 0], np.broadcast_to([1.0, 0, 0], (len(climb), 3)), atol=1e-12)


def test_a_climb_that_is_not_valid_says_why(walker):
    recipe = load_recipe("published-50")
    climb = plan(walker, replace(recipe, step=replace(recipe.step, edge_m=recipe.step.edge_m - 0.03)))
    problems = ClimbCheck(climb).problems()
    assert any("planted feet from the step's edge" in p for p in problems)
    front = plan(walker, replace(recipe, primitives=recipe.primitives[:1]))
    assert ClimbCheck(front).problems() == ["not all feet end on top of the step"]


def test_every_problem_of_a_recipe_is_named(tmp_path):
    text = (tmp_path / "bad.toml").write_text
    good = (RECIPES / "published-50.toml").read_text()
    text(good.replace("fps =", "fsp =").replace("leg = 1", "leg = 7").replace("edge_m =", "egde_m ="))
    with pytest.raises(InputError) as caught:
        load_recipe(tmp_path / "bad.toml")
    fields = {p.field for p in caught.value.problems}
    assert {"fps", "step.edge_m", "primitives[0].footfalls[1].leg"} <= fields
    with pytest.raises(InputError, match="published-50"):
        load_recipe(tmp_path / "none.toml")


def test_robots_with_other_legs_are_refused():
    with pytest.raises(InputError, match="swing joint first"):
        Walker(load_robot("a1"))


# -- other heights, other robots, and the command ---------------------------------------------------------------------


def one_footfall() -> Recipe:
    recipe = raised(load_recipe("published-50"), 0.035)
    return replace(recipe, primitives=(replace(recipe.primitives[0], footfalls=recipe.footfalls[:1]),))


def test_a_robot_of_another_size_climbs_in_the_same_postures(walker):
    legs = {}
    for label, leg in walker.robot.legs.items():
        own = leg.closed
        names = ("thigh_m", "shin_m", "knee_offset_m", "foot_offset_m")
        large = replace(own, **{name: 2 * getattr(own, name) for name in names})
        limits = (np.full(3, -np.pi), np.full(3, np.pi))
        legs[label] = closed_leg(large, 2 * leg.hip_m, leg.joints, leg.signs, limits, np.full(3, 5.0), 0.2)
    twice = Walker(Quadruped("twice", "twice", legs, 0.2))
    small, large = plan(walker, one_footfall()), plan(twice, scaled(one_footfall(), 2.0))
    assert large.recipe.step.height_m == pytest.approx(0.07)
    np.testing.assert_allclose(large.position_m, 2 * small.position_m, atol=1e-6)
    np.testing.assert_allclose(large.angles_rad, small.angles_rad, atol=1e-4)


def test_a_climb_as_a_motion_of_the_robot(walker):
    climb = plan(walker, one_footfall())
    motion = robot_motion(climb)
    assert not motion.short.any()
    assert motion.standing.sum() == 4 * len(climb) - (climb.lifted >= 0).sum()
    # The same angles, by the robot's own names and signs, and the same places, turned.
    np.testing.assert_allclose(motion.leg_angles("RF"), climb.angles_rad[:, LABELS.index("RF")], atol=1e-9)
    np.testing.assert_allclose(motion.leg_angles("LH")[:, 0], -climb.angles_rad[:, LABELS.index("LH"), 0], atol=1e-9)
    for label in LEGS:
        x, y, z = motion.points(label)[:, -1].T
        np.testing.assert_allclose(np.column_stack([-y, x, z]), climb.feet_m[:, LABELS.index(label)], atol=1e-9)


def test_what_comes_before_a_climb_ends_in_its_stance_before_the_step(walker):
    robot = load_robot("aibo")
    recipe = one_footfall()
    climb = robot_motion(plan(walker, recipe))
    # A robot that glides half a metre, one foot up.
    time, up = np.linspace(0, 1, 400), np.array([0.0, 0.0, robot.stand_m])
    way = np.outer(time, [0.5, 0.0, 0.0])
    feet = way[:, None] + up + [robot.legs[label].neutral_m for label in LEGS]
    feet[:, 0, 2] += 0.02
    standing = np.tile([False, True, True, True], (400, 1))
    run = posed(robot, time, body_pose(way + up, 0.0, 0.0, 0.0), feet, standing)
    whole, start_s = before(run, climb, recipe.step, recipe.fps)
    n = len(climb.time_s)
    assert (np.diff(whole.time_s) > 0).all()
    assert whole.time_s[-n] == pytest.approx(start_s)
    np.testing.assert_array_equal(whole.angles_rad[-n:], climb.angles_rad)
    first = whole.feet_m[:-n]
    assert first[..., 0].max() < recipe.step.edge_m
    assert first[..., 2].min() >= 0
    assert not whole.short.any()
    assert whole.standing[:-n].sum(axis=1).min() >= 3
    # No jumps: from frame to frame the joints keep to their rates.
    assert (whole.rate_share < 1).all()
    assert np.abs(np.diff(whole.feet_m, axis=0)).max() < 0.03


def test_the_command_writes_what_the_plan_is(tmp_path, walker):
    table = tomllib.loads((RECIPES / "published-50.toml").read_text())
    table["primitives"] = table["primitives"][:1]
    table["primitives"][0]["footfalls"] = table["primitives"][0]["footfalls"][:1]
    (tmp_path / "short.toml").write_text(tomli_w.dumps(table))
    out = tmp_path / "climb"
    ended = run("climb", tmp_path / "short.toml", "--height", 0.03, "--at", 0.4, "--out", out, "--no-figures")
    assert ended.code == 1, ended.err  # all is written, and it is not valid
    assert "aibo climbs 30 mm" in ended.out
    assert "drawn" not in ended.out
    assert "not valid: not all feet end on top of the step" in ended.out
    report = json.loads((out / "report.json").read_text())
    climb = plan(walker, raised(load_recipe(tmp_path / "short.toml"), 0.03))
    found = ClimbCheck(climb)
    assert report["recipe"]["name"] == "../short.toml"  # as seen from the report
    assert report["problems"] == found.problems()
    for name, row in report["least_margins"].items():
        assert row["value"] == pytest.approx(found.least[name][0])
    table = np.genfromtxt(out / "margins.csv", delimiter=",", names=True)
    assert np.nanmin(table["support_m"]) * 1000 == pytest.approx(found.least["support"][0])
    assert np.degrees(np.nanmin(table["limits_rad"])) == pytest.approx(found.least["limits"][0])
    feet = np.genfromtxt(out / "feet.csv", delimiter=",", names=True)
    np.testing.assert_allclose(feet["LH_x_m"], climb.feet_m[:, 1, 1], atol=1e-9)
    entities = {str(chunk.entity_path) for chunk in RrdReader(out / "climb.rrd").stream()}
    assert entities >= {"/world/step", "/world/support", "/margin", "/pitch"}


def test_figures_of_a_climb(walker):
    climb = plan(walker, one_footfall())
    found = ClimbCheck(climb)
    shown = climb_margins(found)
    assert f"least {found.least['support'][0]:.1f} mm" in shown.axes[2].get_title(loc="left")
    up = int(np.flatnonzero(climb.lifted >= 0)[0])
    *views, by_pitch = climb_field(climb, up).axes
    assert all(axes.collections[0].get_rasterized() for axes in views)
    # The torso is in the middle, and at the least of the energy by its pitch.
    angle, energy = by_pitch.lines[0].get_data()
    assert angle[np.argmin(energy)] == pytest.approx(np.degrees(climb.pitch_rad[up]), abs=1.1)
    # Before the foot rises the fields are already those without it.
    assert climb.stand(up - 1).target_m == pytest.approx(climb.stand(up).target_m, abs=1e-3)


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (("--height", "-1"), "--height: found "),
        (("--robot", "a1"), "swing joint first"),
        (("--after", "nowhere"), "nowhere"),
        (("none.toml",), "published-50"),
    ],
)
def test_mistakes_are_said(args, message, tmp_path):
    ended = run("climb", *args, "--out", tmp_path / "out")
    assert ended.code == 2
    assert message in ended.err
    assert not (tmp_path / "out").exists()
