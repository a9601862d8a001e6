"""Test the data, the pictures and the scripts of a page's player."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from itertools import combinations
from typing import Any

import cv2
import numpy as np
import pytest
from motions import with_first

from recon.check.codes import finding
from recon.fit.motion import MEASURED_FRACTION
from recon.gait.stances import FOOT_ROWS
from recon.show.page import pictures, player_data
from recon.show.page.pictures import Cut, cut_of, encode_strip
from recon.show.page.quality import quality_tables, worst_keypoint
from recon.show.page.scripts import FOLDER, script
from recon.show.sections.keypoints import keypoint_lines, keypoints_data

MODULES = sorted(path.stem for path in (FOLDER / "player").glob("*.js"))


def unpacked(packed: dict[str, Any]) -> np.ndarray:
    """Return the numbers in packed data, as `data.js` unpacks them."""
    kinds = {"i2": ("<i2", -32768), "u1": ("u1", 255), "i4": ("<i4", None)}
    kind, nothing = kinds[packed["type"]]
    units = np.frombuffer(base64.b64decode(packed["data"]), kind)
    if packed["unit"] == 1 and packed["offset"] == 0:
        return units
    return np.where(units == nothing, np.nan, packed["offset"] + packed["unit"] * units)


def test_a_page_has_the_poses_of_the_motion(small_trajectory):
    data = player_data.player_data(small_trajectory, None)
    joints_m = unpacked(data["scene"]["joints_m"]).reshape(8, 24, 3)
    np.testing.assert_allclose(joints_m, small_trajectory.upright.xyz_m, atol=1e-4)
    assert unpacked(data["frames"]).tolist() == small_trajectory.frames.tolist()
    assert data["fps"] == 30
    assert [limb["joints"] for limb in data["limbs"]] == [[*limb] for limb in small_trajectory.limbs.values()]
    factors = unpacked(data["scene"]["spread_m"]).reshape(8, 24, 6)
    np.testing.assert_allclose(factors[0, 0], [0.02, 0, 0.08, 0, 0, 0.02], atol=1e-4)
    assert data["scene"]["ground"] == [
        {"rows": [0, 8], "height_m": small_trajectory.segments[0].ground.height_m, "slope": [0, 0.02], "known": True}
    ]
    assert data["flags"] == [[3, 4, "no data"], [5, 6, "data poor, ambiguous depth"]]


def test_a_page_has_detections_errors_and_positions_of_the_cameras(two_cameras):
    data = player_data.player_data(two_cameras, None, 1)
    assert data["chosen"] == 1
    for camera, scene_camera, picture in zip(
        data["cameras"], data["scene"]["cameras"], two_cameras.pictures, strict=True
    ):
        detected = unpacked(camera["detected_px"]).reshape(8, 24, 2)
        np.testing.assert_allclose(detected, picture.detected_px, atol=0.1)
        reprojected = unpacked(camera["reprojected_px"]).reshape(8, 24, 2)
        np.testing.assert_allclose(reprojected, picture.reprojected_px, atol=0.1)
        states = unpacked(camera["state"]).reshape(8, 24)
        np.testing.assert_array_equal(states == player_data.OUTLIER, picture.outliers)
        np.testing.assert_array_equal(states == player_data.MISSING, ~picture.present)
        np.testing.assert_allclose(unpacked(camera["weight"]).reshape(8, 24), picture.weight, atol=0.003)
        assert not scene_camera["moves"]
    np.testing.assert_allclose(data["scene"]["cameras"][0]["poses"][9:], [1, 2, 3], atol=1e-6)
    np.testing.assert_allclose(data["scene"]["cameras"][1]["poses"][9:], [10, -8, 2.5], atol=1e-6)


def test_a_keypoints_note_states_its_errors_and_their_treatment(small_trajectory):
    picture = small_trajectory.pictures[0]
    stuck_px, nose = np.array(picture.source.keypoints.xy_px), small_trajectory.names.index("nose")
    stuck_px[[0, 1, 2, 5, 6, 7], nose] = (4.0, 1000.0)
    weight = np.array(small_trajectory.solution.weight)
    weight[0, :, nose] = 0.01
    view = replace(small_trajectory.solution.views[0], xy_px=stuck_px)
    solution = replace(small_trajectory.solution, views=(view,), weight=weight)
    motion = with_first(
        replace(small_trajectory, solution=solution),
        keypoints=replace(picture.source.keypoints, xy_px=stuck_px),
    )
    notes = player_data.player_data(motion, None)["cameras"][0]["notes"]
    assert notes[nose] == "stuck at (4, 1000) in 6 frames: left out"
    assert notes[motion.names.index("tail_base")] == ""


def test_cameras_that_would_make_a_page_too_large_are_left_out(two_cameras, monkeypatch):
    monkeypatch.setattr(player_data, "CAMERA_BYTES", 3000)
    first, second = player_data.player_data(two_cameras, None, 1)["cameras"]
    assert first["detected_px"] is None
    assert second["detected_px"] is not None


def test_a_page_has_the_curves_and_stances_of_the_analysis(whole_analysis):
    analysis = whole_analysis
    data = player_data.player_data(analysis.motion, analysis)
    speed = next(panel for panel in data["curves"] if panel["group"] == "speed")
    values = unpacked(speed["curves"][0]["values"])
    np.testing.assert_allclose(values, analysis.reference_motion.speed_m_s[::10][: len(values)], rtol=1e-3)
    elbow = next(flexion for flexion in analysis.flexions if flexion.name == "left_elbow")
    panel = next(panel for panel in data["curves"] if panel["title"] == "elbow flexion")
    shown = next(curve for curve in panel["curves"] if curve["side"] == "left")
    np.testing.assert_allclose(unpacked(shown["values"]), np.degrees(elbow.angle_rad), atol=0.01)
    assert analysis.gait is not None
    assert [stance["foot"] for stance in data["stances"]] == [stance.foot for stance in analysis.gait.stances]
    assert data["feet"] == [*FOOT_ROWS]


def test_no_two_panels_show_the_same_angle(whole_analysis):
    data = player_data.player_data(whole_analysis.motion, whole_analysis)
    curves = [
        (panel["title"], curve["side"], unpacked(curve["values"]), curve["measured"])
        for panel in data["curves"]
        for curve in panel["curves"]
    ]
    for (title, side, first, _), (other, other_side, second, _) in combinations(curves, 2):
        if side == other_side:
            differences = min(np.ptp(first - second), np.ptp(first + second))
            assert differences > player_data.HINGE_DEG, (title, other)
    # A joint of the model that the prior determines is grey, also as a flexion.
    shares = whole_analysis.motion.data_shares
    carpus = next(measured for title, side, _, measured in curves if (title, side) == ("carpus flexion", "left"))
    assert carpus == (shares["l_fore_foot_pitch"] >= MEASURED_FRACTION)


def test_angles_of_both_sides_share_a_panel(small_trajectory):
    panels = player_data.posture_panels(small_trajectory)
    assert len(panels) == 18
    assert [*panels["l/r hind shin pitch"]] == ["left", "right"]
    assert [*panels["head yaw"]] == [None]
    index = small_trajectory.posture_names.index("r_hind_shin_pitch")
    degrees, sigma, measured = panels["l/r hind shin pitch"]["right"]
    np.testing.assert_allclose(degrees, np.degrees(small_trajectory.posture_rad[:, index]))
    np.testing.assert_allclose(sigma, np.degrees(small_trajectory.posture_sigma_rad[:, index]))
    assert measured


def test_numbers_that_are_not_known_stay_unknown():
    values = np.array([np.nan, -1.0, 3.0, np.inf])
    np.testing.assert_allclose(unpacked(player_data.packed(values)), [np.nan, -1, 3, np.nan], atol=1e-4)
    np.testing.assert_array_equal(unpacked(player_data.packed(np.full(3, np.nan))), np.full(3, np.nan))
    np.testing.assert_allclose(unpacked(player_data.packed_shares(np.array([0, 0.5, 1, np.nan]))), [0, 0.5, 1, np.nan])


def test_a_finding_names_its_keypoints_and_camera(small_trajectory):
    told = finding("left_right_swap", (12, 15), "cam1", part="the fore legs", keypoints=("l_front_paw", "other"))
    (item,) = player_data.player_data(replace(small_trajectory, findings=(told,)), None)["findings"]
    assert (item["frames"], item["camera"], item["keypoints"]) == ([12, 15], "cam1", ["l_front_paw"])


def test_the_page_and_the_numbers_name_the_same_worst_keypoint(two_cameras):
    """The worst keypoint has the largest median distance in any camera, whatever its few largest distances are."""
    joint, few = (two_cameras.names.index(name) for name in ("l_shoulder", "nose"))
    sources = [replace(source, keypoints=replace(source.keypoints)) for source in two_cameras.sources]
    for v, rows, column, off_px in ((0, slice(0, 2), few, 900.0), (1, slice(None), joint, 40.0)):
        xy_px = sources[v].keypoints.xy_px.copy()
        xy_px[rows, column] += [off_px, 0.0]
        sources[v] = replace(sources[v], keypoints=replace(sources[v].keypoints, xy_px=xy_px))
    motion = replace(two_cameras, sources=tuple(sources))
    tables = quality_tables(motion)
    for table in tables:
        medians_px = [-1 if row["median_px"] is None else row["median_px"] for row in table["rows"]]
        assert medians_px == sorted(medians_px, reverse=True)
    worst = worst_keypoint(tables)
    assert (worst["name"], worst["camera"], worst["where"]) == ("l_shoulder", 1, " in cam2")
    assert worst["text"].startswith("40.0 px from the pose (median)")
    line = dict(keypoint_lines(motion, keypoints_data(motion)))["reprojection"]
    assert line.endswith("; worst keypoint l_shoulder in cam2, 40.0 px median")


def test_the_worst_keypoint_comes_first_with_its_stuck_position(small_trajectory):
    source = small_trajectory.sources[0]
    xy_px, joint = source.keypoints.xy_px.copy(), small_trajectory.names.index("l_shoulder")
    xy_px[[0, 1, 2, 4, 5, 6], joint] = [4.0, 1052.0]
    motion = with_first(small_trajectory, keypoints=replace(source.keypoints, xy_px=xy_px))
    told = finding("left_right_swap", (12, 15), source.camera.name, part="x", keypoints=("l_front_paw",))
    (table,) = quality_tables(replace(motion, findings=(told,)))
    rows = {row["name"]: row for row in table["rows"]}
    assert table["rows"][0]["name"] == "l_shoulder"
    assert rows["l_shoulder"]["stuck"] == {"x": 4, "y": 1052, "frames": 6}
    assert (rows["l_shoulder"]["outliers"], rows["l_shoulder"]["used"], rows["l_shoulder"]["look"]) == (6, 7, True)
    assert (rows["l_front_paw"]["swapped"], rows["l_front_paw"]["stuck"]) == (3, None)
    assert (rows["r_eye"]["used"], rows["r_eye"]["missing"], rows["r_eye"]["median_px"]) == (0, 8, None)
    assert rows["nose"]["median_px"] == pytest.approx(0, abs=0.1)


def noise(count: int, size_px: tuple[int, int]) -> list[np.ndarray]:
    """Return pictures that are hard to compress."""
    rng = np.random.default_rng(0)
    return [rng.integers(0, 255, (size_px[1], size_px[0], 3), dtype=np.uint8) for _ in range(count)]


def test_a_long_video_becomes_stills_within_the_size(monkeypatch):
    monkeypatch.setattr(pictures, "STRIP_BYTES", 60_000)
    cut = Cut(np.zeros((12, 2), int), (320, 200), 320)
    strip = encode_strip(enumerate(noise(12, (320, 200))), 12, cut)
    assert strip.every > 1
    assert strip.rows == [*range(0, 12, strip.every)]
    assert 10_000 < sum(map(len, strip.encoded)) < 66_000
    short = encode_strip(enumerate(noise(1, (320, 200))), 1, cut)
    assert (short.every, short.rows) == (1, [0])


def test_the_kept_part_has_the_animal_and_its_path():
    path_px = np.array([[300.0, 500.0]]) + np.arange(30)[:, None] * [40.0, 0.0]
    points_px = path_px[:, None] + np.array([[0.0, 0.0], [300.0, 0.0], [150.0, 120.0]])
    cut = cut_of(points_px, 30.0, (1920, 1080))
    assert (cut.corners_px == cut.corners_px[0]).all()
    (x, y), (width, height) = cut.corners_px[0], cut.size_px
    assert x <= 300
    assert x + width >= 1760
    assert y <= 500
    assert y + height >= 620
    assert height < 400  # sky and sand above and below are left out


def test_a_small_animal_is_followed():
    path_px = np.array([[100.0, 500.0]]) + np.arange(60)[:, None] * [50.0, 0.0]
    points_px = path_px[:, None] + np.array([[0.0, 0.0], [60.0, 0.0], [30.0, 40.0]])
    points_px[20] = np.nan
    cut = cut_of(points_px, 60.0, (3840, 2160))
    assert cut.size_px[0] < 300
    for row in (0, 19, 20, 21, 59):
        middle = path_px[row] + [30.0, 20.0]
        inside = middle - cut.corners_px[row]
        assert (inside > 0).all()
        assert (inside < cut.size_px).all()
    part = np.zeros((2160, 3840, 3), np.uint8)
    part[500:540, 100:160] = 255
    strip = encode_strip([(0, part)], 1, cut)
    shown = cv2.imdecode(np.frombuffer(strip.encoded[0], np.uint8), cv2.IMREAD_COLOR)
    assert shown.shape[:2] == (cut.size_px[1], cut.size_px[0])
    assert shown.max() > 240


def test_a_script_has_each_module_once_after_those_that_it_imports():
    content = script("main")
    assert "import " not in re.sub(r"//.*", "", content)
    assert not re.search(r"^export", content, re.MULTILINE)
    starts = [
        (FOLDER / "player" / f"{name}.js").read_text(encoding="utf-8").split("\n")[0]
        for name in MODULES
        if name not in ("fix", "label")
    ]
    assert [content.count(start) for start in starts] == [1] * len(starts)
    classes = re.findall(r"^class (\w+)", content, re.MULTILINE)
    assert classes.index("Strip") < classes.index("CurveStrip") < classes.index("KeypointMap")
    assert content.rindex("if (player) start();") > content.index("class KeypointMap")
    assert "</script" not in content
    assert not re.search(
        r"\b(eval|innerHTML|outerHTML|insertAdjacentHTML|fetch|XMLHttpRequest|document\.write)\b", content
    )


def test_no_two_modules_have_one_name():
    names = re.findall(r"^(?:class|function|const|let) (\w+)", script("main"), re.MULTILINE)
    names += [
        name for more in re.findall(r"^const \w+ = [^;{(]*?, (\w+) =", script("main"), re.MULTILINE) for name in [more]
    ]
    assert len(names) == len(set(names))
