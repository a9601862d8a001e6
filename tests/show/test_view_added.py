"""Test that a playback shows the plots of an analysis and the frames of a video."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_line import refusal
from rerun.chunk import RrdReader

from recon import ClipAnalysis
from recon.fit.motion import Motion
from recon.fit.regions import radius
from recon.gait.stances import INTERVAL
from recon.io.video import video_writer
from recon.show.view import write

FRAMES = list(range(10, 18))


def rows(path: Path, kind: str = "recordings") -> dict[str, list[dict[str, Any]]]:
    """Return the rows of a recording by entity, without row ids."""
    reader = RrdReader(path)
    (store,) = getattr(reader, kind)()
    found: dict[str, list[dict[str, Any]]] = {}
    for chunk in reader.stream(store=store).to_chunks():
        for row in chunk.to_record_batch().to_pylist():
            known = {name: value for name, value in row.items() if name != "rerun.controls.RowId" and value is not None}
            found.setdefault(chunk.entity_path, []).append(known)
    return found


def by_frame(of: list[dict[str, Any]], component: str) -> dict[int, Any]:
    return {row["frame"]: row[component] for row in of if "frame" in row and component in row}


@pytest.fixture(scope="module")
def found(whole_analysis: ClipAnalysis) -> ClipAnalysis:
    return whole_analysis


@pytest.fixture(scope="module")
def analysed(found: ClipAnalysis, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("view") / "motion.rrd"
    write(found.motion, path, found)
    return path


def test_plots_of_an_analysis_have_the_values_at_the_frames(found: ClipAnalysis, analysed: Path) -> None:
    data, moved = rows(analysed), found.joints[found.reference]
    speed = by_frame(data["/analysis/speed"], "Scalars:scalars")
    assert list(speed) == found.motion.frames.tolist()
    at = moved.series.oversampling * 7
    value, sigma = moved.speed_m_s[at], moved.speed_sigma_m_s[at]
    half = radius(INTERVAL) * sigma
    np.testing.assert_allclose(speed[found.motion.frames[7]], [value, value - half, value + half])
    (names,) = [row["SeriesLines:names"] for row in data["/analysis/speed"] if "SeriesLines:names" in row]
    assert names == ["speed", "90 %: from", "90 %: to"]
    trunk = by_frame(data["/analysis/links/trunk"], "Scalars:scalars")
    np.testing.assert_allclose(trunk[found.motion.frames[7]], [field.speed_m_s[7] for field in found.fields["trunk"]])


def test_forces_are_drawn_under_the_feet(found: ClipAnalysis, analysed: Path) -> None:
    """Arrows point up, and a force of one body weight is as long as the centre of mass is high.

    A gap interrupts only the line of its own foot.
    """
    d, gait, data = found.dynamics, found.gait, rows(analysed)
    assert d is not None
    assert gait is not None
    (colours,) = [row["SeriesLines:colors"] for row in data["/analysis/forces"] if "SeriesLines:colors" in row]
    at = np.searchsorted(gait.tracks.time_s, found.motion.time_s - 1e-6)
    force = np.stack([d.force[foot][at, 0] for foot in gait.tracks.feet], axis=1)
    lines = by_frame(data["/analysis/forces"], "Scalars:scalars")
    for t, frame in enumerate(found.motion.frames):
        np.testing.assert_allclose(lines[frame], force[t])
    t = int(np.argmax(np.nanmax(force, axis=1)))
    arrows = np.array(by_frame(data["/world/forces"], "Arrows3D:vectors")[found.motion.frames[t]])
    high_m = np.nanmedian(d.centre.series.value[:, 2] - d.ground_m)
    up = found.motion.in_reference(np.array([0.0, 0.0, high_m])) - found.motion.in_reference(np.zeros(3))
    np.testing.assert_allclose(arrows, force[t][force[t] > 0][:, None] * up, atol=1e-5)
    origins = by_frame(data["/world/forces"], "Arrows3D:origins")[found.motion.frames[t]]
    feet_m = found.motion.in_reference(gait.tracks.foot_m[at[t]])
    np.testing.assert_allclose(origins, feet_m[force[t] > 0], atol=1e-5)
    # arrows have the colour of their foot's side, in which the line of the hind foot is also drawn
    of_foot = zip(gait.tracks.feet, colours, strict=True)
    of_side = {foot[0]: colour for foot, colour in of_foot if foot.endswith("H")}
    own = by_frame(data["/world/forces"], "Arrows3D:colors")[found.motion.frames[t]]
    assert own == [of_side[foot[0]] for foot, force_bw in zip(gait.tracks.feet, force[t], strict=True) if force_bw > 0]
    assert len({*colours}) == len(gait.tracks.feet)


def test_each_kind_has_a_tab_behind_the_fits_own_plots(found: ClipAnalysis, analysed: Path, tmp_path: Path) -> None:
    layout = rows(analysed, "blueprints")
    named = [row["ContainerBlueprint:display_name"][0] for of in layout.values() for row in of
             if "ContainerBlueprint:display_name" in row]  # fmt: skip
    tabs = {"Reconstruction", "Kinematics", "Forces", "Legs, tips about parents", "Trunk, tips about parents"}
    assert {*named} >= tabs
    views = [row["ViewBlueprint:display_name"][0] for of in layout.values() for row in of
             if "ViewBlueprint:display_name" in row]  # fmt: skip
    assert {f"Speed of {found.reference} (m/s)", "Vertical force (body weights)", "Reprojection (px)"} <= {*views}
    write(found.motion, tmp_path / "plain.rrd")
    plain = rows(tmp_path / "plain.rrd")
    assert not any(entity.startswith(("/analysis", "/world/forces")) for entity in plain)
    assert plain.keys() < rows(analysed).keys()


def test_without_masses_there_are_no_forces(found: ClipAnalysis, tmp_path: Path) -> None:
    solution = found.motion.solution
    plain = replace(solution, body=replace(solution.body, mass={}, mass_source=None))
    found = replace(found, motion=replace(found.motion, solution=plain))
    write(found.motion, tmp_path / "motion.rrd", found)
    data = rows(tmp_path / "motion.rrd")
    assert "/analysis/speed" in data
    assert not {"/analysis/forces", "/world/forces"} & {*data}


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a video of eleven frames of 1920x1080 whose grey level is ten times the frame number."""
    path = tmp_path_factory.mktemp("video") / "clip.avi"
    with video_writer(path, (1920, 1080), 30.0) as write_frame:
        for number in range(11):
            write_frame(np.full((1080, 1920, 3), 10 * number, np.uint8))
    return path


def picture(row: dict[str, Any], flag: int) -> np.ndarray:
    image = cv2.imdecode(np.array(row["EncodedImage:blob"][0], np.uint8), flag)
    assert image is not None
    return image


def test_every_frame_has_its_picture(small_trajectory: Motion, video: Path, tmp_path: Path) -> None:
    """A video that begins at frame 8 shows its pictures 2 to 9."""
    write(small_trajectory, tmp_path / "plain.rrd")
    write(small_trajectory, tmp_path / "motion.rrd", video=video, first_frame=8)
    data = rows(tmp_path / "motion.rrd")
    pictures = data.pop("/picture/video")
    assert data.keys() == rows(tmp_path / "plain.rrd").keys()
    assert [row["frame"] for row in pictures] == FRAMES
    np.testing.assert_allclose([row["time"].total_seconds() for row in pictures], np.array(FRAMES) / 30, atol=1e-6)
    for number, row in enumerate(pictures, 2):
        image = picture(row, cv2.IMREAD_COLOR)
        assert image.shape == (1080, 1920, 3)
        assert float(image.mean()) == pytest.approx(10 * number, abs=3)


def test_the_close_view_is_in_front_and_shows_the_video(small_trajectory: Motion, video: Path, tmp_path: Path) -> None:
    """The first tab is the close view, which shows the video around the animal without the picture's edge."""
    write(small_trajectory, tmp_path / "motion.rrd", video=video, first_frame=8)
    layout = rows(tmp_path / "motion.rrd", "blueprints")
    (close,) = [path for path, of in layout.items() for row in of
                if row.get("ViewBlueprint:display_name", [""])[0].startswith("Picture, close up")]  # fmt: skip
    fronts = [row["ContainerBlueprint:active_tab"][0] for of in layout.values() for row in of
              if row.get("ContainerBlueprint:active_tab")]  # fmt: skip
    assert close.removeprefix("/") in fronts
    (origin,) = [row["ViewBlueprint:space_origin"][0] for row in layout[close] if row.get("ViewBlueprint:space_origin")]
    assert origin == "picture/animal"
    contents = [row["ViewContents:query"] for path, of in layout.items() for row in of
                if path.startswith(f"{close}/") and row.get("ViewContents:query")]  # fmt: skip
    assert contents == [["+ /picture/**", "- /picture/frame"]]


def test_a_video_that_is_too_short_leaves_no_file(small_trajectory: Motion, video: Path, tmp_path: Path) -> None:
    with refusal((video, "video", "11 frames", "18 frames or more")):
        write(small_trajectory, tmp_path / "motion.rrd", video=video)
    assert [*tmp_path.iterdir()] == []


def test_a_video_goes_into_the_picture_of_its_camera(two_cameras: Motion, video: Path, tmp_path: Path) -> None:
    write(two_cameras, tmp_path / "motion.rrd", video=video, first_frame=8, camera=1)
    videos = {entity for entity in rows(tmp_path / "motion.rrd") if entity.endswith("/video")}
    assert videos == {"/picture/cam2/video"}
