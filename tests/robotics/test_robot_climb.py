"""Test the planning of climbs by potential fields, from the fields to the command."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest
import tomli_w
from command_line import refusal, refused, run, says
from matplotlib.text import Text
from rerun.chunk import RrdReader
from scipy.integrate import quad
from scipy.optimize import root
from scipy.spatial.transform import Rotation

from recon import InputError
from recon.geometry.frames import rigid
from recon.robotics.climb.plan import (
    LEFT,
    NONE,
    PLANAR,
    RECIPES,
    RULES,
    SPATIAL,
    Fields,
    Recipe,
    Step,
    _Balance,
    _moved,
    _Well,
    bundled,
    capped,
    equilibrium,
    load_recipe,
    path_corners,
    plan,
    raised,
    support_m,
    swing_path,
    wrench,
)
from recon.robotics.physics import margins_figure
from recon.robotics.quadruped import LEGS, Quadruped, load_robot

HIPS = np.array([[0.065, 0.0625, 0], [0.065, -0.0625, 0], [-0.065, 0.0625, 0], [-0.065, -0.0625, 0]])


def well(*numbers: float) -> _Well:
    """Build the potential wells of a climb, the same for all legs."""
    of_legs = ((number, number, number, number) for number in numbers)
    return _Well.model_construct(**dict(zip(_Well.model_fields, of_legs, strict=True)))


def balance(gain: float) -> _Balance:
    return _Balance.model_construct(gain=gain, sharpness=60.0)


def changed(of, **numbers):
    return of.model_copy(update=numbers)


FIELDS = Fields(
    radial=well(1.0, 0.12, 0.1, 0.135, 120.0, 150.0),
    swing=well(0.02, 0.1, -0.6, 0.7, 8.0, 9.0),
    flap=well(0.02, 0.05, -0.1, 0.5, 7.0, 8.0),
    balance=balance(0.3),
)
NOWHERE = well(1e-12, 0.12, 0.1, 0.135, 1.0, 1.0)
HERE = np.eye(4)


def feet(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return HIPS * [1, 1.2, 1] + [0, 0, -0.12] + rng.normal(size=(4, 3)) * 0.01


def torso(seed: int) -> np.ndarray:
    rng = np.random.default_rng(100 + seed)
    turned = Rotation.from_rotvec(rng.normal(size=3) * 0.15)
    return rigid(turned.as_matrix(), rng.normal(size=3) * 0.01)


def wrench_at(fields: Fields, feet_m: np.ndarray, at: np.ndarray, without: int = NONE) -> np.ndarray:
    return wrench(fields, HIPS, feet_m, without, _moved(at, np.zeros((1, 6))))[0]


@pytest.fixture(scope="module")
def aibo() -> Quadruped:
    return load_robot("aibo")


def test_slope_of_a_well_equals_the_published_formula():
    one = well(2.0, 0.12, 0.1, 0.135, 120.0, 150.0)
    for x in (0.08, 0.1, 0.12, 0.135, 0.15):
        slope = 2.0 * (x - 0.12) * (np.exp(150 * (x - 0.135)) + np.exp(120 * (0.1 - x)))
        assert one.slope(np.array(x)) == pytest.approx([slope] * 4, rel=1e-12, abs=1e-15)


def test_a_leg_pulls_weakly_in_the_dead_zone_and_strongly_beyond():
    of = FIELDS.radial.slope
    inside, beyond = abs(of(np.array([[0.11], [0.125]]))), abs(of(np.array([[0.08], [0.155]])))
    assert inside.max() < 0.01
    assert beyond.min() > 20 * inside.max()
    assert (of(np.array(0.12)) == 0).all()


def test_fields_act_along_the_published_directions():
    # On the right side, X points to the right and Y forwards, as published.
    r, x, y = np.array([0.05, -0.03, -0.1]), np.array([0, -1.0, 0]), np.array([1.0, 0, 0])
    a, b = np.cross(x, r), np.cross(r, y)
    ways = {
        "radial": (np.linalg.norm(r), r / np.linalg.norm(r)),
        "swing": (np.arctan(0.05 / 0.1), a / (a @ a)),  # from straight down, in the plane whose normal is lateral
        "flap": (np.arctan(0.03 / 0.1), b / (b @ b)),
    }
    none = changed(NOWHERE, gain=(0.0,) * 4)
    for kind, (q, way) in ways.items():
        of = getattr(FIELDS, kind)
        one_leg = changed(of, gain=(0.0, of.gain[1], 0.0, 0.0))
        only = changed(Fields(radial=none, swing=none, flap=none, balance=balance(1e-14)), **{kind: one_leg})
        found = wrench_at(only, HIPS + r[None], HERE)
        np.testing.assert_allclose(found[:3], of.slope(np.array(q))[1] * way, rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(found[3:], np.cross(HIPS[1] + r, found[:3]), atol=1e-11)


def energy(feet_m: np.ndarray, at: np.ndarray) -> float:
    """Compute the energy of a torso by integrating the slopes of the wells and the balance force numerically."""
    r = (feet_m - at[:3, 3]) @ at[:3, :3] - HIPS
    ways = zip(
        (np.linalg.norm(r, axis=1), np.arctan2(r[:, 0], -r[:, 2]), np.arctan2(LEFT * r[:, 1], -r[:, 2])),
        (FIELDS.radial, FIELDS.swing, FIELDS.flap),
        strict=True,
    )
    of_legs = (
        quad(lambda x, kind=kind, k=k: kind.slope(np.full(4, x))[k], kind.natural[k], q[k], epsabs=1e-14)[0]
        for q, kind in ways
        for k in range(4)
    )
    d = float(np.linalg.norm(feet_m[:, :2].mean(axis=0) - at[:2, 3]))
    return sum(of_legs) + 0.3 * quad(lambda x: np.tanh(60 * x), 0, d, epsabs=1e-14)[0]


@pytest.mark.parametrize("seed", range(3))
def test_wrench_is_the_gradient_of_one_energy(seed):
    f, t, h = feet(seed), torso(seed), 2e-6
    found = [-(energy(f, _moved(t, h * e)) - energy(f, _moved(t, -h * e))) / (2 * h) for e in np.eye(6)]
    np.testing.assert_allclose(wrench_at(FIELDS, f, t), found, atol=1e-7)
    # The result for many torsos equals the results for each torso.
    many = wrench(FIELDS, HIPS, f, NONE, _moved(t, np.array([np.zeros(6), np.full(6, 0.01)])))
    np.testing.assert_allclose(many[1], wrench_at(FIELDS, f, _moved(t, np.full(6, 0.01))), atol=1e-15)


def test_balance_force_points_to_the_centroid_and_saturates():
    only, level = Fields(radial=NOWHERE, swing=NOWHERE, flap=NOWHERE, balance=balance(0.3)), HIPS - [0, 0, 0.12]
    for away, gain in (([3.0, 4.0], 0.3), ([0.003, 0.004], 0.3 * np.tanh(60 * 0.005))):
        found = wrench_at(only, level + np.array([*away, 0]), HERE)[:2]
        np.testing.assert_allclose(found, gain * np.array([0.6, 0.8]), atol=1e-9)
    planted = level[1:, :2].mean(axis=0)
    found = wrench_at(only, level, HERE, without=0)[:2]
    np.testing.assert_allclose(found / np.linalg.norm(found), planted / np.linalg.norm(planted), atol=1e-9)


@pytest.mark.parametrize("dofs", [PLANAR, SPATIAL])
def test_the_equilibrium_agrees_with_scipy(dofs):
    f = feet(1)
    found, evaluations, settled = equilibrium(FIELDS, HIPS, f, NONE, HERE, dofs)
    assert settled
    assert evaluations < 12

    def balance(v: np.ndarray) -> np.ndarray:
        step = np.zeros(6)
        step[list(dofs)] = v
        return wrench_at(FIELDS, f, _moved(HERE, step))[list(dofs)]

    # Both methods give the same rotation vector, for a rotation about one fixed axis or none.
    oracle = np.zeros(6)
    oracle[list(dofs)] = root(balance, np.zeros(len(dofs)), tol=1e-13).x
    np.testing.assert_allclose(found[:3, 3], oracle[:3], atol=1e-8)
    np.testing.assert_allclose(Rotation.from_matrix(found[:3, :3]).as_rotvec(), oracle[3:], atol=1e-7)
    if dofs == PLANAR:  # the planar torso neither rolls nor yaws
        np.testing.assert_allclose(found[1, :3], [0, 1, 0], atol=1e-14)


def test_limits_scale_a_step_as_a_whole():
    step = np.array([0.03, 0.04, 0, 0.02, 0, 0])
    np.testing.assert_allclose(capped(step, 0.01, 1.0), step / 5)
    np.testing.assert_allclose(capped(step, 1.0, 0.01), step / 2)
    np.testing.assert_array_equal(capped(step, 1.0, 1.0), step)


def test_a_path_rises_and_descends_at_its_angles():
    start, end = np.array([0.0, 0.07, 0.0]), np.array([0.08, 0.09, 0.05])
    a, b, c, d = path_corners(start, end, 0.01, np.radians(75), np.radians(60))
    assert np.degrees(np.arctan2(b[2] - a[2], b[0] - a[0])) == pytest.approx(75)
    assert np.degrees(np.arctan2(c[2] - d[2], d[0] - c[0])) == pytest.approx(60)
    assert b[2] == c[2] == pytest.approx(0.06)
    np.testing.assert_array_equal([a[1], b[1], c[1], d[1]], [0.07, 0.07, 0.09, 0.09])


def test_a_foot_moves_at_the_speed_of_each_phase():
    recipe = load_recipe("published-50")
    primitive = recipe.primitives[0]
    start = np.array([0.08, 0.1, 0.0])
    end = start + primitive.footfalls[1].vector_m
    path = swing_path(recipe, primitive, start, end)
    np.testing.assert_allclose(path[-1], end)
    assert path[:, 2].max() == pytest.approx(0.05 + recipe.swing.clearance_m)
    speeds = np.linalg.norm(np.diff(path, axis=0, prepend=start[None]), axis=1) * recipe.fps
    assert speeds.max() <= recipe.swing.traverse_m_s * (1 + 1e-9)
    assert speeds[0] == pytest.approx(recipe.swing.rise_m_s, rel=0.05)


def test_long_slopes_meet_above_the_clearance():
    path = path_corners(np.zeros(3), np.array([0.01, 0, 0.0]), 0.02, np.radians(45), np.radians(45))
    np.testing.assert_allclose(path[:, 0], [0, 0.005, 0.005, 0.01])
    np.testing.assert_allclose(path[:, 2], [0, 0.02, 0.02, 0])


def test_distance_from_ground_and_step():
    step = Step(edge_m=0.1, height_m=0.05)
    points = np.array(
        [[0, 0, 0.02], [0.09, 0, 0.02], [0.12, 0, 0.06], [0.12, 0, 0.02], [0.07, 0, 0.09], [0.05, 0, -0.01]]
    )
    np.testing.assert_allclose(step.distance_m(points), [0.02, 0.01, 0.01, -0.02, 0.05, -0.01], atol=1e-12)
    np.testing.assert_allclose(step.corner_m(points[3:5]), [-np.hypot(0.02, 0.03), 0.05])


def test_support_is_the_distance_to_the_nearest_side_of_the_polygon():
    square = np.array([[1.0, 1], [1, -1], [-1, 1], [-1, -1]])
    assert support_m(np.zeros(2), square, np.array(NONE)).min() == pytest.approx(1)
    assert support_m(np.array([0.0, -0.5]), square, np.array(NONE)).min() == pytest.approx(0.5)
    for lifted in range(4):
        assert support_m(np.zeros(2), square, np.array(lifted)).min() == pytest.approx(0)
        away = -0.3 * square[lifted]
        assert support_m(away, square, np.array(lifted)).min() == pytest.approx(0.3 * np.sqrt(2))
        assert support_m(-away, square, np.array(lifted)).min() == pytest.approx(-0.3 * np.sqrt(2))


def test_slack_is_the_distance_from_the_edge_of_the_reach(aibo):
    for leg in aibo.legs.values():
        least, most = leg.closed.distances_m
        way = leg.neutral_m - leg.hip_m
        feet_m = leg.hip_m + way / np.linalg.norm(way) * np.array([[least + 0.02], [most - 0.001], [most + 0.001]])
        slack = leg.slack_m(feet_m)
        np.testing.assert_allclose(slack[1:], [0.001, -0.001], atol=1e-9)
        np.testing.assert_array_equal(slack > 0, np.isfinite(leg.closed_angles(feet_m)).all(axis=1))
        # A bent leg does not reach the axis of its swing joint.
        assert leg.slack_m(leg.hip_m + np.array([[0, 0.8 * most, 0]])) < 0


PUBLISHED = {
    "front-up": ((2, 65, 0), (1, 70, 50), (3, 70, 50), (4, 60, 0)),
    "move-forward": ((1, 70, 0), (3, 70, 0), (2, 70, 0), (4, 60, 0)),
    "rear-up": ((1, 85, 0), (2, 75, 50), (3, 85, 0), (4, 60, 50)),
}
"""Published footfalls of each primitive (D. Cohen, SUNFEST, University of Pennsylvania, 2005).

A footfall is the leg (1 left front, 2 left rear, 3 right front, 4 right rear), and its way forward and up, mm. The
heights in rear-up are printed as 0, 30, -10, 30 mm, which include the plastic casings of the feet. Here feet are
points, with the heights 0, 50, 0, 50."""


@pytest.mark.parametrize("height", [0.05, 0.035])
def test_planned_footfalls_equal_the_published_ones(height):
    recipe = raised(load_recipe("published-50"), height)
    ratio = recipe.step.height_m / 0.05
    for primitive in recipe.primitives:
        for found, (leg, forward, up) in zip(primitive.footfalls, PUBLISHED[primitive.name], strict=True):
            assert (found.leg, found.forward_m) == ((0, 2, 1, 3)[leg - 1], pytest.approx(forward / 1000))
            assert found.up_m == pytest.approx(up / 1000 * ratio)
    assert [primitive.name for primitive in recipe.primitives] == list(PUBLISHED)


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] * (name in ("found-50", "published-50"))) for name in bundled()],
)
def test_every_bundled_climb_is_valid_in_every_frame(aibo, name):
    recipe = load_recipe(name)
    climb = plan(aibo, recipe)
    motion = climb.motion
    assert climb.problems() == []
    assert climb.settled.all()
    assert motion.rate_share.max() <= 1
    assert not motion.short.any()
    # Check independently, by the feet at the written angles and by the barycentric coordinates of the triangle.
    for k, label in enumerate(LEGS):
        np.testing.assert_allclose(motion.points(label)[:, -1], motion.feet_m[:, k], atol=1e-9)
    for k in np.flatnonzero(climb.lifted != NONE):
        planted = motion.feet_m[k][np.arange(4) != climb.lifted[k], :2]
        shares = np.linalg.solve(np.vstack([planted.T, np.ones(3)]), [*climb.motion.position_m[k, :2], 1])
        assert shares.min() > 0
    still = climb.lifted[1:, None] != np.arange(4)
    assert np.abs(np.diff(motion.feet_m, axis=0)[still]).max() == 0
    np.testing.assert_array_equal(motion.standing.sum(axis=1), 4 - (climb.lifted != NONE))
    np.testing.assert_allclose(motion.feet_m[-1, :, 2], recipe.step.height_m, atol=1e-9)
    turns = (motion.pose.rotation[:-1].inv() * motion.pose.rotation[1:]).magnitude()
    assert np.linalg.norm(np.diff(motion.position_m, axis=0), axis=1).max() <= recipe.motion.max_step_m * (1 + 1e-9)
    assert turns.max() <= recipe.motion.max_turn_rad * (1 + 1e-9)
    if recipe.dofs == 4:
        across = motion.pose.rotation.as_matrix()[:, 1]
        np.testing.assert_allclose(across, np.broadcast_to([0, 1.0, 0], across.shape), atol=1e-12)


def test_an_invalid_climb_reports_its_problems(aibo):
    recipe = load_recipe("published-50")
    climb = plan(aibo, changed(recipe, step=changed(recipe.step, edge_m=recipe.step.edge_m - 0.03)))
    assert any(says(p, "planted feet", "edge") for p in climb.problems())
    front = plan(aibo, changed(recipe, primitives=recipe.primitives[:1]))
    (problem,) = front.problems()
    assert says(problem, "not all feet")


def test_every_problem_with_a_recipe_is_reported(tmp_path):
    text = (tmp_path / "bad.toml").write_text
    good = (RECIPES / "published-50.toml").read_text()
    text(good.replace("fps =", "fsp =").replace("leg = 1", "leg = 7").replace("edge_m =", "egde_m ="))
    with pytest.raises(InputError) as caught:
        load_recipe(tmp_path / "bad.toml")
    fields = {p.field for p in caught.value.problems}
    assert {"fps", "step.edge_m", "primitives[0].footfalls[1].leg"} <= fields
    with refusal((tmp_path / "none.toml", "file", "no such file", "published-50")):
        load_recipe(tmp_path / "none.toml")


def test_robots_without_swing_legs_are_refused():
    with refusal(("a1", "legs", "legs that cannot climb", "swing joint")):
        plan(load_robot("a1"), one_footfall())


def one_footfall() -> Recipe:
    recipe = raised(load_recipe("published-50"), 0.035)
    return changed(recipe, primitives=(changed(recipe.primitives[0], footfalls=recipe.primitives[0].footfalls[:1]),))


def test_the_command_writes_the_plan(tmp_path, aibo):
    table = tomllib.loads((RECIPES / "published-50.toml").read_text())
    table["primitives"] = table["primitives"][:1]
    table["primitives"][0]["footfalls"] = table["primitives"][0]["footfalls"][:1]
    (tmp_path / "short.toml").write_text(tomli_w.dumps(table))
    out = tmp_path / "climb"
    ended = run("climb", tmp_path / "short.toml", "--height", 0.03, "--out", out, "--no-figures")
    assert ended.code == 1, ended.err  # all files are written, although the climb is not valid
    assert "aibo climbs 30 mm" in ended.out
    assert says(ended.out, "not valid: not all feet")
    report = json.loads((out / "report.json").read_text())
    found = plan(aibo, raised(load_recipe(tmp_path / "short.toml"), 0.03))
    assert report["recipe"]["name"] == "../short.toml"  # relative to the folder of the report
    assert report["problems"] == found.problems()
    for name, row in report["least_margins"].items():
        assert row["value"] == pytest.approx(found.least[name][0])
    table = np.genfromtxt(out / "margins.csv", delimiter=",", names=True)
    assert np.nanmin(table["support_m"]) * 1000 == pytest.approx(found.least["support"][0])
    assert np.degrees(np.nanmin(table["limits_rad"])) == pytest.approx(found.least["limits"][0])
    feet = np.genfromtxt(out / "feet.csv", delimiter=",", names=True)
    np.testing.assert_allclose(feet["LH_x_m"], found.motion.feet_m[:, 2, 0], atol=1e-9)
    entities = {str(chunk.entity_path) for chunk in RrdReader(out / "climb.rrd").stream()}
    assert entities >= {"/world/step", "/world/support", "/margin", "/pitch"}


def test_the_figure_shows_the_margins(aibo):
    found = plan(aibo, one_footfall())
    support = 1000 * found.margins["support"]
    shown = {name: found.margins[name] for name in ("support", "corner")}
    figure = margins_figure(found.motion.time_s, shown, RULES, "a title")
    title = f"{RULES['support'].title}: minimum {found.least['support'][0]:.1f} mm"
    assert figure.axes[0].get_title(loc="left").replace("\n", " ") == title
    figure.draw_without_rendering()
    first, second = (
        next(text for text in axes.findobj(Text) if "minimum" in text.get_text()).get_window_extent()
        for axes in figure.axes
    )
    assert first.x1 < second.x0  # titles of neighbours do not run into each other
    assert figure.axes[0].lines[2].get_ydata()[0] == support.min()


@pytest.mark.parametrize(
    ("args", "expected"),
    [
        (("--height", "1e300"), ("--height", "height", "'1e300'", "metres")),
        (("none.toml",), ("none.toml", "file", "no such file", "published-50")),
    ],
)
def test_wrong_input_is_reported(args, expected, tmp_path):
    refused(["climb", *args, "--out", tmp_path / "out"], expected)
    assert not (tmp_path / "out").exists()
