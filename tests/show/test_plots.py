"""Test that figures show the given values in the right units, and that all texts can be read."""

from __future__ import annotations

import sys
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import to_rgb, to_rgba
from matplotlib.patches import PathPatch
from matplotlib.quiver import Quiver
from PIL import Image
from shortcuts import leave_out_layout

from recon.animal.body import Side
from recon.animal.skeleton_file import load_skeleton
from recon.fit.regions import radius
from recon.gait.gait import Stride, gait
from recon.gait.kinematics import angle_kinematics, point_kinematics
from recon.gait.phase import Closure, Portrait, phase_portrait, vector_field
from recon.gait.series import Errors
from recon.gait.stances import BODY, FEET, INTERVAL, Plane, Stance, pose_tracks
from recon.ik import figures as ik_plots
from recon.ik.chain import planar_chain, summed_chain
from recon.ik.drive import drive_to, follow
from recon.ik.methods import JacobianTranspose, LeastNorm, damped_least_squares
from recon.io.common import Pose3D
from recon.show import plots
from recon.show.plots import configurations, over_time, style
from recon.show.plots.configurations import share_colours

FPS = 50.0
LIMBS = {"trunk": (0, 1), "near leg": (0, 2), "off leg": (0, 3)}
SIDES: dict[str, Side | None] = {"trunk": None, "near leg": "left", "off leg": "right"}
LEVEL = [(slice(None), Plane((0.0, 0.0), 0.0, (0.0, 0.0), 0.0, 10))]


@pytest.fixture(autouse=True)
def _without_pyplot(monkeypatch):
    """Forbid pyplot, because it keeps figures in memory and needs a display."""
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)


@pytest.fixture
def laid_out() -> None:
    """Mark a test that needs the positions of texts, for which figures have to be laid out."""


@pytest.fixture(autouse=True)
def _laid_out_where_looked_at(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip the layout of figures unless a test needs it, because it takes half of a figure's time."""
    if "laid_out" not in request.fixturenames:
        leave_out_layout(monkeypatch)


def times(T):
    return 1.0 + np.arange(T) / FPS


def running(T=31, heading=2.0, speed_m_s=8.0):
    """Return four joints (T, 4, 3) in metres of an animal that glides along a heading in rad."""
    animal = np.array([[0.0, 0.0, 0.7], [0.6, 0.0, 0.7], [-0.1, 0.1, 0.1], [0.1, -0.1, 0.1]])
    along = animal + speed_m_s * (times(T) - 1.0)[:, None, None] * [1.0, 0.0, 0.0]
    c, s = np.cos(heading), np.sin(heading)
    return along @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [3.0, -2.0, 0.0]


def path(T=21):
    """Return a path along an axis with a speed of t m/s at time t."""
    t = times(T)
    return np.stack([t**2 / 2, np.zeros(T), np.zeros(T)], axis=1)


def swinging(T=31):
    """Return the joints (T, 4, 3) in metres of three links in the x-z plane, of which only the second swings."""
    angle = 0.5 * np.sin(2 * np.pi * 2 * times(T))
    joints = np.zeros((T, 4, 3))
    joints[:, 1, 0] = 1.0
    joints[:, 2] = joints[:, 1] + 0.5 * np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=1)
    joints[:, 3] = joints[:, 2] + 0.3 * np.stack([np.sin(angle), 0 * angle, -np.cos(angle)], axis=1)
    return joints


def still_tracks(T=41):
    points = np.concatenate([np.zeros((T, 4, 3)), np.full((T, 2, 3), 0.5)], axis=1)
    return pose_tracks(Pose3D((*FEET.values(), *BODY), points, round(FPS) + np.arange(T)), FPS)


def gaits():
    """Return two gaits: `ground` has a complete stride and a stance cut by the clip's end, `body` has one stance."""
    found = gait(still_tracks())
    first = (
        Stance("LH", 1.1, 1.2, 5.0, 10.0),
        Stance("LH", 1.4, 1.5, 20.0, 25.0),
        Stance("RF", 1.7, 1.8, 35.0, 40.0, ends=False),
    )
    stride = Stride("LH", 1.1, 1.4, 2.0, 1 / 3, 0.02, "touchdown")
    second = (Stance("RF", 1.65, 1.75, 32.5, 37.5),)
    return {
        "ground": replace(found, stances=first, strides=(stride,), stride_length_m=2.0, stride_frequency_hz=1 / 0.3),
        "body": replace(found, stances=second, strides=()),
    }


def drives(dim=2):
    chain = planar_chain([0.5, 0.4, 0.3]) if dim == 2 else summed_chain([0.5, 0.4, 0.3])
    q = np.full(chain.n, 0.4)
    target = chain.end(q) + [-0.1, 0.1, 0.05][:dim]
    found = {name: drive_to(chain, q, target, m) for name, m in (("a", LeastNorm()), ("b", JacobianTranspose()))}
    found["far"] = drive_to(chain, q, 5 * target, damped_least_squares())
    return chain, target, found


def texts(figure):
    """Return all text in a figure."""
    return "\n".join(t.get_text() for t in figure.findobj(mpl.text.Text) if t.get_visible())


def thick_lines(axes, least=0.85):
    """Return the lines that are at least `least` points wide."""
    return [line for line in axes.get_lines() if line.get_linewidth() >= least and line.get_linestyle() != "None"]


def every_figure():
    t, ahead = times(31), np.tile([1.0, 0.0, 0.0], (31, 1))
    curves = {"fit": point_kinematics(times(21), path()), "noisy": point_kinematics(times(21), path() * 1.1)}
    portraits = {f"l_fore_upper_pitch_{k}_rad": phase_portrait(angle_kinematics(t, np.sin(9 * t))) for k in range(26)}
    (chain, target, found), (chain3, target3, found3) = drives(2), drives(3)
    circle = found["a"].end_m[0] + 0.05 * np.stack([np.cos(t) - 1, np.sin(t)], axis=1)
    turns = {"a": follow(chain, found["a"].q[0], circle, LeastNorm())}
    closed = {name: Closure(50.0, 40.0) for name in portraits}
    names = {f"extended Jacobian (energy), variant {i}": d for i, d in enumerate([*found.values()] * 4)}
    return {
        "composites": plots.composites(running(), LIMBS, t, LEVEL, "a title"),
        "composites of a long run": plots.composites(running(speed_m_s=40.0), LIMBS, t, LEVEL, "a title"),
        "composites of an animal that stands": plots.composites(running(speed_m_s=0.0), LIMBS, t, LEVEL, "a title"),
        "composites of a mouse": plots.composites(running(speed_m_s=20.0) / 20, LIMBS, t, LEVEL, "a title"),
        "speeds": plots.speeds(curves, "a title"),
        "speeds in a column": plots.speeds(curves, "a title", plots.COLUMN_MM),
        "fields": plots.vector_fields(vector_field(t, swinging(), ("a", "b", "c", "d"), ahead), t, "x"),
        "ten fields": plots.vector_fields(
            vector_field(t, swinging(), ("a", "l_back_knee", "l_back_ankle", "d"), ahead) * 5, t, "x"
        ),
        "portraits": plots.phase_portraits(portraits, closed, "a title"),
        "one portrait": plots.phase_portraits(dict([*portraits.items()][:1]), closed, "a title"),
        "four portraits": plots.phase_portraits(dict([*portraits.items()][:4])),
        "footfall": plots.footfall(gaits(), FPS, "a title"),
        "task space": ik_plots.task_space(found, chain, target),
        "task space in 3D": ik_plots.task_space(found3, chain3, target3),
        "task space of a stride": ik_plots.task_space(turns, chain, circle),
        "joint space": ik_plots.joint_space(found3, chain3.names),
        "joint space, many": ik_plots.joint_space(names, chain.names),
    }


@pytest.fixture(scope="module")
def figures():
    return every_figure()


@pytest.mark.slow
@pytest.mark.usefixtures("laid_out")
def test_nothing_is_off_the_page_and_no_texts_overlap(figures, monkeypatch):
    draw, drawn = mpl.text.Text.draw, []
    monkeypatch.setattr(mpl.text.Text, "draw", lambda text, *options: (drawn.append(text), draw(text, *options)))
    problems = []
    for name, figure in figures.items():
        width, height = figure.get_size_inches() / style.MM
        assert min(abs(width - plots.WIDTH_MM), abs(width - plots.COLUMN_MM)) < 1e-9, name
        assert height < 275, name
        renderer = figure.canvas.get_renderer()
        drawn.clear()
        figure.draw_without_rendering()
        shown = [t for t in drawn if t.get_visible() and t.get_text().strip()]
        low, high = np.moveaxis([t.get_window_extent(renderer).get_points() for t in shown], 1, 0)
        for k in np.flatnonzero((low < -1).any(axis=1) | (high > figure.bbox.max + 1).any(axis=1)):
            problems.append(f"{name}: '{shown[k].get_text()}' is off the page")
        overlap = (low[:, None] < high - 2).all(axis=2) & (low < high[:, None] - 2).all(axis=2)
        for a, b in np.argwhere(np.triu(overlap, 1)):
            problems.append(f"{name}: '{shown[a].get_text()}' covers '{shown[b].get_text()}'")
    assert "\n".join(problems) == ""


@pytest.mark.usefixtures("laid_out")
def test_files_are_reproducible_whatever_the_users_settings(tmp_path):
    def written(folder):
        figure = plots.speeds({"fit": point_kinematics(times(21), path())}, "peak at the end")
        return [p.read_bytes() for p in plots.save(figure, tmp_path / folder, "speed")]

    first = written("a")
    with mpl.rc_context({"font.size": 20.0, "axes.facecolor": "red", "svg.fonttype": "path", "lines.linewidth": 9.0}):
        mine = mpl.rcParams.copy()
        assert written("b") == first
        assert {key for key in mine if mine._get(key) != mpl.rcParams._get(key)} == set()
    figure = plots.speeds({"fit": point_kinematics(times(21), path())}, "peak at the end")
    plots.save(figure, tmp_path / "c", "speed")
    again = plots.save(figure, tmp_path / "c", "speed")
    assert [p.read_bytes() for p in again] == first
    assert again == (tmp_path / "c" / "speed.png", tmp_path / "c" / "speed.svg")
    assert sorted(p.name for p in (tmp_path / "c").iterdir()) == ["speed.png", "speed.svg"]


@pytest.mark.usefixtures("laid_out")
def test_resolution_and_text(tmp_path):
    png, svg = plots.save(ik_plots.joint_space({"way & aim": drives()[2]["a"]}, ("a", "b", "c")), tmp_path, "d")
    with Image.open(png) as image:
        assert image.width == int(180 / 25.4 * 200)
        assert image.info["dpi"] == pytest.approx((200, 200), abs=0.1)
    text = svg.read_text(encoding="utf-8")
    assert ">way &amp; aim<" in text
    assert ">angle (deg)</text>" in text
    assert "date" not in text.lower()


def test_lines_differ_in_more_than_colour():
    looks = [tuple(style.look(i).values()) for i in range(28)]
    assert len(set(map(str, looks))) == 28
    assert all(style.look(i)["linestyle"] != style.look(i + 1)["linestyle"] for i in range(27))


def test_figures_without_data_say_so():
    t, nan = times(31), np.full((31, 4, 3), np.nan)
    nothing = point_kinematics(t, nan[:, 0])
    unknown = Portrait(t, nan[:, 0, 0], nan[:, 0, 0])
    empty = [
        plots.composites(nan, LIMBS, t),
        plots.speeds({"fit": nothing}),
        plots.vector_fields(vector_field(t, nan, ("a", "b", "c", "d"), nan[:, 0]), t),
        plots.phase_portraits({"a": unknown}),
        plots.speeds({}),
        plots.vector_fields((), t),
        plots.phase_portraits({}),
        plots.footfall({}, FPS),
    ]
    for i, figure in enumerate(empty):
        assert "no data" in texts(figure), i
    still = gait(still_tracks())
    assert "no stances" in texts(plots.footfall({"ground": replace(still, stances=(), strides=())}, FPS))


@pytest.mark.parametrize("heading", [2.0, *(pytest.param(h, marks=pytest.mark.slow) for h in (0.0, -2.5))])
def test_composites_turn_the_run_to_the_right(heading):
    t = times(31)
    figure = plots.composites(running(heading=heading), LIMBS, t, ground=LEVEL, sides=SIDES)
    side, top, front, *_ = figure.axes
    at = [0, 3, 7, 10, 13, 17, 20, 23, 27, 30]
    for axes in (side, top, front):
        assert len(thick_lines(axes)) == 10 * 3
    # positions are relative to the mean of the first configuration, which is 0.15 m ahead of joint 0
    rear = 8.0 * (t[at] - 1.0) - 0.15
    trunk, left, right = (thick_lines(side)[k::3] for k in range(3))
    np.testing.assert_allclose([line.get_xdata() for line in trunk], rear[:, None] + [0.0, 0.6], atol=1e-9)
    np.testing.assert_allclose([line.get_ydata() for line in left], np.tile([0.7, 0.1], (10, 1)), atol=1e-9)
    np.testing.assert_allclose([line.get_xdata() for line in right], rear[:, None] + [0.0, 0.1], atol=1e-9)
    for lines, y in ((thick_lines(top)[1::3], 0.1), (thick_lines(top)[2::3], -0.1)):
        np.testing.assert_allclose([line.get_ydata() for line in lines], np.tile([0, y], (10, 1)), atol=1e-9)
    for lines, y in ((thick_lines(front)[1::3], 0.1), (thick_lines(front)[2::3], -0.1)):
        np.testing.assert_allclose([line.get_xdata() for line in lines], np.tile([0, y], (10, 1)), atol=1e-9)
    assert {line.get_linestyle() for line in left} == {"--"}
    assert {line.get_linestyle() for line in (*right, *trunk)} == {"-"}
    assert {line.get_linewidth() for line in trunk} == {1.6}
    (legend,) = figure.findobj(mpl.legend.Legend)
    shown = [text.get_text() for text in legend.get_texts()]
    assert shown == ["left side", "right side", "the rest", "ground"]


def test_composites_colours_are_the_times_of_the_bar():
    figure = plots.composites(running(), LIMBS, times(31))
    side, *_, bar = figure.axes
    assert bar.get_xlabel() == "time (s)"
    np.testing.assert_allclose(bar.get_xlim(), [1.0, 1.6])
    colours = np.array([to_rgb(line.get_color()) for line in thick_lines(side)[::3]])
    lightness = colours @ [0.2126, 0.7152, 0.0722]
    assert np.all(np.diff(lightness) > 0)
    assert lightness[-1] < 0.8


@pytest.mark.usefixtures("laid_out")
def test_composites_have_equal_axes():
    figure = plots.composites(running(), LIMBS, times(31))
    figure.draw_without_rendering()
    size = figure.get_size_inches()
    for axes in figure.axes[:3]:
        box = axes.get_position(original=True)
        across, upwards = box.size * size / [np.ptp(axes.get_xlim()), np.ptp(axes.get_ylim())]
        assert across == pytest.approx(upwards)
    assert figure.axes[0].get_xlim() == figure.axes[1].get_xlim()


def test_composites_ground():
    joints, t = running(heading=np.pi / 2), times(31)
    plane = Plane((0.0, 0.0), 0.2, (0.0, 0.1), 0.0, 10)
    side, _, front, *_ = plots.composites(joints, LIMBS, t, [(slice(None), plane)]).axes
    origin_y = joints[0, :, 1].mean()
    for axes, slope in ((side, 0.1), (front, 0.0)):
        (line,) = (line for line in axes.get_lines() if line.get_gid() == "ground")
        x, z = line.get_xdata(), line.get_ydata()
        assert (z[1] - z[0]) / (x[1] - x[0]) == pytest.approx(slope, abs=1e-12)
        if slope:
            np.testing.assert_allclose(z, 0.2 + 0.1 * (x + origin_y))
    lower = replace(plane, height_m=-0.2)
    two = plots.composites(joints, LIMBS, t, [(slice(0, 10), plane), (slice(20, 31), lower)]).axes[0]
    one, other = (line for line in two.get_lines() if line.get_gid() == "ground")
    np.testing.assert_allclose(np.array(other.get_ydata()) - 0.1 * (np.array(other.get_xdata()) + origin_y), -0.2)
    assert max(one.get_xdata()) < min(other.get_xdata())


def test_composites_choose_among_the_known_poses():
    joints = running()
    joints[5:] = np.nan
    joints[2, 1:] = np.nan
    np.testing.assert_array_equal(configurations.chosen(joints, LIMBS), [0, 1, 3, 4])
    side = plots.composites(joints, LIMBS, times(31)).axes[0]
    assert len(thick_lines(side)) == 4 * 3


def test_speed_and_acceleration():
    known = point_kinematics(times(8), path(8), (Errors(np.full((8, 3), 0.001)),))
    points = 2 * path()
    points[8:12] = np.nan
    gap = point_kinematics(times(21), points, max_gap_s=0.05)
    figure = plots.speeds({"first": known, "second": gap})
    above, below = figure.axes
    first, second = thick_lines(above, 1.05)[::1][:2]
    np.testing.assert_array_equal(first.get_xdata(), known.series.time_s)
    np.testing.assert_array_equal(first.get_ydata(), known.speed_m_s)
    np.testing.assert_allclose(first.get_ydata(), first.get_xdata(), rtol=1e-9)
    np.testing.assert_array_equal(second.get_ydata(), gap.speed_m_s)
    assert np.isnan(second.get_ydata()[75:115]).all()
    assert first.get_markevery() == 10
    assert first.get_linestyle() != second.get_linestyle()
    np.testing.assert_array_equal(thick_lines(below, 1.05)[0].get_ydata(), known.acceleration_m_s2)

    (band,) = (c for c in above.collections if isinstance(c, PolyCollection))
    edge = band.get_paths()[0].vertices
    k = 33
    at = edge[np.isclose(edge[:, 0], known.series.time_s[k])][:, 1]
    expected = known.speed_m_s[k] + radius(INTERVAL) * np.array([-1, 1]) * known.speed_sigma_m_s[k]
    np.testing.assert_allclose([at.min(), at.max()], expected)
    rings = [line.get_xydata()[0] for line in above.get_lines() if line.get_markerfacecolor() == "none"]
    np.testing.assert_allclose(rings[1], [gap.peak_speed_time_s, gap.peak_speed_m_s])
    assert "second: peak 2.80 m/s at 1.400 s, 2 m/s²" in texts(figure)
    assert above.get_ylabel() == "speed (m/s)"


def test_arrows_are_velocities_to_one_scale():
    t = times(31)
    fields = vector_field(t, swinging(), ("a", "b", "c", "d"), np.tile([1.0, 0.0, 0.0], (31, 1)))
    figure = plots.vector_fields(fields, t)
    panels = np.reshape(figure.axes, (2, 2))
    scales = set()
    for (left, right), field in zip(panels, fields, strict=True):
        (arrows,) = (c for c in left.collections if isinstance(c, Quiver))
        np.testing.assert_array_equal(arrows.U, field.velocity_m_s[:, 0])
        np.testing.assert_array_equal(arrows.V, field.velocity_m_s[:, 1])
        np.testing.assert_array_equal(arrows.X, t)
        scales.add((arrows.scale, arrows.scale_units, arrows.angles))
        (line,) = right.get_lines()
        np.testing.assert_array_equal(line.get_xydata(), np.column_stack([t, field.speed_m_s]))
    assert len(scales) == 1
    # the second link keeps its angle to the first, so it has no arrows, but a mean speed
    assert f"mean {fields[0].speed_m_s.mean():.2f} m/s" in texts(figure)
    assert "mean 0.00 m/s" in texts(figure)
    (key,) = figure.findobj(mpl.quiver.QuiverKey)
    assert f"{key.U:g} m/s" == key.label == "1 m/s"
    assert "b → c  in the frame of  a → b" in texts(figure)


def test_long_clips_leave_out_arrows_evenly():
    t = times(200)
    fields = vector_field(t, swinging(200), ("a", "b", "c", "d"), np.tile([1.0, 0.0, 0.0], (200, 1)))
    figure = plots.vector_fields(fields, t)
    (arrows,) = (c for c in figure.axes[0].collections if isinstance(c, Quiver))
    np.testing.assert_array_equal(arrows.X, t[::5])
    (key,) = figure.findobj(mpl.quiver.QuiverKey)
    assert key.label == "1 m/s (one frame of 5)"
    assert len(figure.axes[1].get_lines()[0].get_xdata()) == 200


def test_lines_through_many_frames_have_no_dots():
    assert style.dots(500, 2.0) == {"marker": "o", "ms": 2.0}
    assert style.dots(501, 2.0) == {}


def test_portraits_in_degrees():
    t = times(31)
    found = angle_kinematics(t, 0.5 * np.sin(9 * t))
    portrait = phase_portrait(found)
    broken = Portrait(portrait.time_s, portrait.angle_rad.copy(), portrait.rate_rad_s)
    broken.angle_rad[100:120] = np.nan
    figure = plots.phase_portraits({"knee_rad": portrait, "hip_rad": broken}, {"knee_rad": Closure(91.4, np.nan)})
    first, second = figure.axes[:2]
    (lines,) = (c for c in first.collections if isinstance(c, LineCollection))
    drawn = np.concatenate([piece[:-1] for piece in lines.get_segments()])
    expected = np.degrees(np.column_stack([portrait.angle_rad, portrait.rate_rad_s]))
    np.testing.assert_allclose(drawn, expected[:-1])
    assert np.all(np.diff(lines.get_array()) > 0)
    assert first.get_title() == "knee\n91 / – %"
    assert second.get_title() == "hip"
    start, end = (line.get_xydata()[0] for line in first.get_lines())
    np.testing.assert_allclose([start, end], expected[[0, -1]])
    (lines,) = (c for c in second.collections if isinstance(c, LineCollection))
    points = np.concatenate([path.vertices for path in lines.get_paths()])
    assert np.isnan(points).any(axis=1).sum() >= 20
    assert figure.axes[-1].get_ylabel() == "time (s)"


def test_clearest_portraits_move_more_than_their_uncertainty():
    t, errors = times(31), [Errors(np.full(31, np.radians(2.0)), 0.05)]
    ranges = {"still": 0.01, "knee": 0.5, "hidden": 0.9, "hip": 0.4, "tail": 0.2}
    portraits = {name: phase_portrait(angle_kinematics(t, x * np.sin(9 * t), errors)) for name, x in ranges.items()}
    shares = dict.fromkeys(ranges, 0.8) | {"hidden": 0.2}
    assert [*plots.clearest_portraits(portraits, shares, 3)] == ["knee", "hip", "tail"]
    assert [*plots.clearest_portraits(portraits, dict.fromkeys(ranges, 0.1), 2)] == ["knee", "hidden"]


def test_portraits_have_bands_and_are_grey_if_the_pixels_say_little():
    t = times(31)
    errors = [Errors(np.full(31, np.radians(2.0)), 0.05)]
    portrait = phase_portrait(angle_kinematics(t, 0.5 * np.sin(9 * t), errors))
    shares = {"knee": 0.8, "hip": 0.2}
    figure = plots.phase_portraits(
        {"knee": portrait, "hip": portrait}, {"knee": Closure(91.4, 88, 12.3, 9)}, "", shares
    )
    first, second = figure.axes[:2]
    assert first.get_title() == "knee\n80 % from pixels\n91±20 / 88±14 %"  # bands of 90 %
    assert second.get_title() == "hip\n20 % from pixels"
    (lines,) = (c for c in second.collections if isinstance(c, LineCollection))
    assert len({*map(tuple, lines.get_edgecolors())}) == 1
    (band,) = (p for p in first.findobj(PathPatch) if p.get_facecolor() == to_rgba(over_time._BAND))
    ellipses = band.get_path().vertices.reshape(-1, len(mpl.path.Path.unit_circle().vertices), 2)
    assert np.median(np.ptp(ellipses[..., 0], axis=1)) == pytest.approx(4.0 * radius(INTERVAL), rel=0.02)
    middles = np.mean([ellipses.min(axis=1), ellipses.max(axis=1)], axis=0)
    path = np.degrees(np.column_stack([portrait.angle_rad, portrait.rate_rad_s]))
    near = np.abs(middles[:, None] - path) / (np.ptp(ellipses, axis=1)[:, None] / 2)
    assert near.max(axis=2).min(axis=1) == pytest.approx(0, abs=1e-9)  # every ellipse is on the path
    assert near.max(axis=2).min(axis=0).max() < 0.3  # the ellipses cover the whole path
    assert "less than 50 %" in figure.get_supxlabel()


def test_speeds_of_links_have_standard_deviations():
    t = times(20)
    (first, *_) = vector_field(t, swinging(20), ("a", "b", "c", "d"), np.tile([1.0, 0.0, 0.0], (20, 1)))
    field = replace(first, speed_sigma_m_s=np.full(20, 0.25))
    axes = plots.vector_fields((field,), t).axes[1]
    (band,) = (c for c in axes.collections if isinstance(c, PolyCollection) and not isinstance(c, Quiver))
    assert band.get_paths()[0].vertices[:, 1].max() == pytest.approx(first.speed_m_s.max() + radius(INTERVAL) * 0.25)


def test_a_link_slower_than_its_uncertainty_is_grey():
    t = times(20)
    (first, *_) = vector_field(t, swinging(20), ("a", "b", "c", "d"), np.tile([1.0, 0.0, 0.0], (20, 1)))
    slow = replace(first, velocity_m_s=first.velocity_m_s / 40, speed_m_s=first.speed_m_s / 40)
    unseen = replace(slow, speed_sigma_m_s=np.full(20, 0.25))
    figure = plots.vector_fields((first, unseen), t)
    colours = [line.get_color() for axes in figure.axes[1::2] for line in axes.get_lines()]
    assert colours == [style.COLOURS[0], style.GREY]
    assert f"mean {slow.speed_m_s.mean():.1f} ± 0.4 m/s" in texts(figure)


def test_observability_over_time():
    body = load_skeleton("cheetah-8u")
    names = body.state_names[4:]
    fraction = np.tile([0.9 if name.startswith("theta") else 0.1 for name in names], (12, 1))
    fraction[:, names.index("J0_pitch")] = np.nan
    over_the_time = plots.observability(body, fraction, times(12)).axes[0]
    seen, unseen = share_colours()(0.9), share_colours()(0.1)
    assert seen[2] > seen[0] + 0.3
    assert np.ptp(unseen[:3]) < 0.01
    (image,) = over_the_time.get_images()
    np.testing.assert_array_equal(image.get_array().filled(np.nan), fraction.T)
    assert [label.get_text() for label in over_the_time.get_yticklabels()][2:4] == ["phi 6", "theta 6"]
    beside = [text.get_text() for text in over_the_time.texts]
    assert beside == ["–" if n == "J0_pitch" else "90 %" if n.startswith("theta") else "10 %" for n in names]
    of_clip = plots.observability(body, fraction, times(12), "a stride", np.tile(0.3 * fraction, (2, 1))).axes[0]
    assert {text.get_text() for text in of_clip.texts} == {"–", "27 %", "3 %"}
    assert "the whole clip" in of_clip.get_xlabel()
    nothing = plots.observability(body, np.full_like(fraction, np.nan), times(12))
    assert [text.get_text() for text in nothing.texts][-1] == "no data"


def test_a_constant_angle_is_drawn_as_constant():
    t = times(31)
    held = phase_portrait(angle_kinematics(t, 0.5 + 1e-7 * np.sin(9 * t)))
    axes = plots.phase_portraits({"held": held}).axes[0]
    assert np.ptp(axes.get_xlim()) >= 0.1
    assert np.ptp(axes.get_ylim()) >= 1.0
    assert np.mean(axes.get_xlim()) == pytest.approx(np.degrees(0.5), abs=1e-3)
    assert axes.xaxis.get_offset_text().get_text() == ""


def test_stances_of_a_long_clip_stay_visible():
    gait = gaits()["ground"]
    tracks = replace(gait.tracks, time_s=100 * gait.tracks.time_s)  # bars are narrower than the lines on them
    assert "complete stride" in texts(plots.footfall({"ground": gait}, FPS))
    assert "complete stride" not in texts(plots.footfall({"ground": replace(gait, tracks=tracks)}, FPS))


@pytest.mark.slow
@pytest.mark.usefixtures("laid_out")
def test_portraits_fit_on_a_page(figures):
    (figure, single, four) = (figures[name] for name in ("portraits", "one portrait", "four portraits"))
    assert [f.axes[0].get_gridspec().get_geometry() for f in (figure, single, four)] == [(6, 5), (1, 1), (2, 2)]
    assert sum(axes.axison for axes in figure.axes[:-1]) == 26
    assert all(min(axes.bbox.width, axes.bbox.height) / 100 / style.MM > 18 for axes in figure.axes[:26])


@pytest.mark.usefixtures("laid_out")
def test_bars_show_when_feet_stand():
    figure = plots.footfall(gaits(), FPS)
    (axes,) = figure.axes
    assert [label.get_text() for label in axes.get_yticklabels()] == ["LH", "RH", "RF", "LF"]
    boxes = [
        (p.get_extents(), c.get_hatch())
        for c in axes.collections
        if isinstance(c, PolyCollection)
        for p in c.get_paths()
    ]
    bars = [(box.x0, box.x1, (box.y0 + box.y1) / 2, hatch) for box, hatch in boxes]
    expected = [(1.1, 1.2, -0.19, ""), (1.4, 1.5, -0.19, ""), (1.7, 1.8, 1.81, ""), (1.65, 1.75, 2.19, "////")]
    for bar, (start, end, y, hatch) in zip(bars, expected, strict=True):
        assert bar[:3] == pytest.approx((start, end, y))
        assert (bar[3] or "") == hatch
    lines = [c for c in axes.collections if isinstance(c, LineCollection)]
    ends = [end[:, 0] for c in lines for end in c.get_segments()]
    # At 1.8 s an arrow replaces the edge, because the clip cuts the stance there.
    assert sorted(a for a, b in ends if a == b) == pytest.approx([1.1, 1.2, 1.4, 1.5, 1.65, 1.7, 1.75])
    (arrow,) = (line for line in axes.get_lines() if line.get_marker() in "<>")
    assert (arrow.get_marker(), arrow.get_xdata()[0]) == (">", 1.8)
    (ticks, _) = (line for line in axes.get_lines() if line.get_marker() == "|")
    assert list(ticks.get_xdata()) == [1.1, 1.4]
    np.testing.assert_allclose(lines[0].get_segments(), [[(1.1, -0.19), (1.4, -0.19)]])
    (frames,) = axes.child_axes
    np.testing.assert_allclose(frames.get_xlim(), FPS * np.array(axes.get_xlim()))
    for said in ("ground: unknown (", "stride 2.0 m, 3.3 Hz", "cut by the clip", "complete stride"):
        assert said in texts(figure)


def test_a_short_stances_touch_down_and_lift_off_do_not_merge():
    ground = gaits()["ground"]
    (stance, *_) = ground.stances
    short = replace(stance, start_sigma_s=0.06, end_sigma_s=0.06)
    figure = plots.footfall({"ground": replace(ground, stances=(short,))}, FPS)
    collections = [c for c in figure.axes[0].collections if isinstance(c, LineCollection)]
    down, up = (end for c in collections if to_rgb(c.get_color()[0]) == to_rgb("0.35") for end in c.get_segments())
    np.testing.assert_allclose([down[:, 0], up[:, 0]], [short.start_interval_s, short.end_interval_s])
    assert down[1, 0] > up[0, 0]  # they overlap
    assert down[0, 1] < up[0, 1] - 0.2  # the axis points down


def test_feet_of_one_gait_have_the_colours_of_their_sides():
    figure = plots.footfall({"ground": gaits()["ground"]}, FPS)
    edges = [c for c in figure.axes[0].collections if isinstance(c, LineCollection)]
    by_row = {round(end[0][1] + 0.2): to_rgb(c.get_color()[0]) for c in edges for end in c.get_segments()}
    assert by_row[0] == to_rgb(style.COLOURS[0])
    assert all(f"{side} foot" in texts(figure) for side in ("left", "right"))


def test_a_band_that_is_wider_than_the_curve_leaves_it_a_third_of_its_panel():
    t = times(21)
    wide = point_kinematics(t, path(21), [Errors(np.full((21, 3), 0.2))])
    axes = plots.speeds({"fit": wide}).axes[1]
    top, highest = axes.get_ylim()[1], wide.acceleration_m_s2.max()
    assert (wide.acceleration_m_s2 + radius(INTERVAL) * wide.acceleration_sigma_m_s2).max() > 10 * highest
    assert highest / top > 0.3


def test_paths_in_the_plane():
    chain, target, found = drives()
    figure = ik_plots.task_space(found, chain, target)
    (axes,) = figure.axes
    ways = {line.get_label(): line for line in axes.get_lines() if not line.get_label().startswith("_")}
    assert list(ways) == ["a", "b", "far (not reached, unreachable)"]
    np.testing.assert_array_equal(ways["b"].get_xydata(), found["b"].end_m)
    (cross,) = (line for line in axes.get_lines() if line.get_gid() == "target")
    np.testing.assert_array_equal(cross.get_xydata()[0], target)
    shapes = [line.get_xydata() for line in axes.get_lines() if len(line.get_xdata()) == 4]
    np.testing.assert_allclose(shapes[0], chain.positions(found["a"].q[0]))
    np.testing.assert_allclose(shapes[1], chain.positions(found["a"].q[-1]))
    assert axes.get_ylabel() == "down (m)"
    assert axes.yaxis_inverted()
    assert axes.get_aspect() == 1.0


@pytest.mark.parametrize(("base", "columns"), [("UVW", ((0, 1), (0, 2))), ("xyz", ((0, 2), (0, 1)))])
def test_paths_in_space_from_the_side_and_from_above(base, columns):
    chain, target, found = drives(3)
    figure = ik_plots.task_space(found, chain, target, base=base)
    for axes, view, name in zip(figure.axes, columns, ("side", "top"), strict=True):
        assert axes.get_title(loc="left") == name
        (way,) = (line for line in axes.get_lines() if line.get_label() == "a")
        np.testing.assert_array_equal(way.get_xydata(), found["a"].end_m[:, view])
    assert figure.axes[0].yaxis_inverted() == (base == "UVW")
    assert not figure.axes[1].yaxis_inverted()


def test_joint_angles_in_degrees():
    _, _, found = drives()
    figure = ik_plots.joint_space(found, names=("shoulder", "elbow", "wrist"))
    for joint, axes in enumerate(figure.axes):
        assert axes.get_title() == ("shoulder", "elbow", "wrist")[joint]
        for line, drive in zip(axes.get_lines(), found.values(), strict=True):
            np.testing.assert_allclose(line.get_ydata(), np.degrees(drive.q[:, joint]))
            np.testing.assert_array_equal(line.get_xdata(), np.arange(len(drive.q)))
        assert axes.get_xlabel() == "iteration"


def test_names_are_not_drawn_as_formulas(tmp_path):
    with style.drawing(40) as figure:
        figure.subplots().set_title("$t_{$")
    _, svg = style.save(figure, tmp_path, "name")
    assert "$t_{$" in svg.read_text(encoding="utf-8")
