"""Test positions, colours and frames of overlays, and results and videos that do not match."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import count, pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import refusal, says
from motions import with_first
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from recon import FitSettings, InputError, write_clip
from recon.base.outputs import RECORD
from recon.cli.app import app
from recon.cli.look import (
    bars_note,
    camera_number,
    first_frame_note,
    overlay_of,
    page_pictures,
    rate_note,
    result_and_video,
)
from recon.cli.look_options import OverlaySettings, PageSettings
from recon.cli.show import overlay as draw
from recon.fit.motion import Motion
from recon.fit.result import Finding
from recon.io.video import _is_complete, missing_note, probe, read_frames, timed_frames, video_writer
from recon.show.overlay import (
    CLOSE_UP,
    DETECTION,
    FLAGGED,
    INK,
    OUTLIER,
    PAPER,
    SIDE_COLOURS,
    TILE_PX,
    Overlay,
    canvas_size,
    draw_frame,
    draw_tiles,
    shade,
    smoothed_headings,
)

SIZE = (1920, 1080)
GREY = np.full((1080, 1920, 3), 128, np.uint8)


def folder_of(motion: Motion, path: Path) -> Path:
    write_clip(motion, FitSettings(keypoints=Path("run.csv"), camera=Path("camera.toml"), fps=30), path)
    return path


@pytest.fixture(scope="module")
def folder(small_trajectory, tmp_path_factory) -> Path:
    return folder_of(small_trajectory, tmp_path_factory.mktemp("level") / "run")


@pytest.fixture(scope="module")
def overlay(folder) -> Overlay:
    return overlay_of(Motion.load(folder))


@pytest.fixture(scope="module")
def video(tmp_path_factory) -> Path:
    """Write a video of twelve frames of 1920x1080 whose grey level is ten times the frame number."""
    path = tmp_path_factory.mktemp("video") / "clip.avi"
    with video_writer(path, SIZE, 30.0) as write:
        for number in range(12):
            write(np.full((1080, 1920, 3), 10 * number, np.uint8))
    return path


def test_folder_holds_what_is_drawn(overlay, small_trajectory):
    motion = small_trajectory
    np.testing.assert_array_equal(overlay.frames, motion.frames)
    np.testing.assert_allclose(overlay.reprojected_px, motion.pictures[0].reprojected_px, atol=1e-6)
    # Both are NaN without a detection.
    np.testing.assert_allclose(overlay.detected_px, motion.pictures[0].detected_px, atol=1e-5)
    np.testing.assert_array_equal(overlay.outliers, motion.pictures[0].outliers)
    assert [tuple(flags) for flags in overlay.flags] == list(motion.solution.flags)
    names = [motion.names[limb[-1]] for limb in overlay.limbs]
    colours = dict(zip(names, overlay.colours, strict=True))
    assert {name: colours[name] for name in ("l_front_paw", "r_back_paw")} == {
        "l_front_paw": SIDE_COLOURS["left"],
        "r_back_paw": SIDE_COLOURS["right"],
    }


def test_small_videos_are_enlarged(folder):
    """Small videos are drawn at twice their size, where the centre of pixel 10 is between pixels 20 and 21."""
    small, large = (overlay_of(Motion.load(folder), zoom=zoom) for zoom in (1, 2))
    np.testing.assert_allclose(large.reprojected_px, 2 * small.reprojected_px + 0.5)
    np.testing.assert_allclose(large.detected_px, 2 * small.detected_px + 0.5)


@pytest.mark.parametrize("fixture", ["small_trajectory", "world_trajectory"])
def test_near_and_far_are_along_the_camera_axis(fixture, request, tmp_path):
    motion = request.getfixturevalue(fixture)
    overlay = overlay_of(Motion.load(folder_of(motion, tmp_path / "run")))
    depth = motion.joints_camera_m[..., 2]
    relative = depth - depth.mean(axis=1, keepdims=True)
    scale = np.percentile(np.abs(relative), 95)
    np.testing.assert_allclose(overlay.nearness, np.clip(-relative / scale, -1, 1), atol=1e-6)


def test_limbs_and_marks_have_their_positions_and_colours(overlay):
    t = 4  # a frame with an outlier
    overlay = replace(overlay, detected_px=np.where(overlay.outliers[..., None], overlay.detected_px, np.nan))
    image = draw_frame(overlay, t, 14, GREY)
    on_top = max(  # the nearest part of a leg, over which nothing is drawn
        (overlay.nearness[t, [a, b]].mean(), a, b, colour)
        for limb, colour in zip(overlay.limbs, overlay.colours, strict=True)
        for a, b in pairwise(limb)
    )
    nearness, a, b, colour = on_top
    x, y = np.rint(overlay.reprojected_px[t, [a, b]].mean(axis=0)).astype(int)
    assert np.abs(image[y, x].astype(int) - shade(colour, nearness)).max() <= 3
    (nose,) = np.flatnonzero(overlay.outliers[t])
    x, y = np.rint(overlay.detected_px[t, nose]).astype(int)
    assert np.abs(image[y, x].astype(int) - OUTLIER).max() <= 3


def test_detections_are_rings(overlay):
    alone = np.full_like(overlay.detected_px, np.nan)
    alone[0, 0] = [300.0, 900.0]
    drawn = draw_frame(replace(overlay, detected_px=alone), 0, 10, GREY)
    patch = np.abs(drawn[890:911, 290:311].astype(int) - DETECTION).max(axis=2) < 40
    radius = np.hypot(*(np.argwhere(patch) - 10).T)
    assert len(radius) > 8
    assert np.ptp(radius) < 3
    assert (drawn[900, 300] == 128).all()


def test_flagged_frames_have_a_border(overlay):
    borders = [tuple(draw_frame(overlay, t, 10 + t, GREY)[540, 1]) == FLAGGED for t in range(8)]
    assert borders == [bool(flags) for flags in overlay.flags]
    assert tuple(draw_frame(overlay, None, 3, GREY)[540, 1]) == FLAGGED


def test_captions_are_read_on_a_bright_picture(overlay):
    corner = draw_frame(overlay, 0, 10, np.full_like(GREY, 255))[20:60, 20:200]
    assert np.percentile(corner, 20) < 120
    assert corner.max() > 220


def test_near_is_lighter_than_far():
    brightness = [sum(shade(SIDE_COLOURS["left"], n)) for n in (-1.0, -0.5, 0.0, 0.5, 1.0)]
    assert brightness == sorted(brightness)
    assert shade(SIDE_COLOURS["left"], 0.0) == SIDE_COLOURS["left"]


def test_views_turn_with_the_animal(overlay):
    """A rotation of the animal about the vertical does not change the views."""
    turned = replace(overlay, upright_m=overlay.upright_m @ Rotation.from_rotvec([0, 0, 2.1]).as_matrix().T + [5, 6, 7])
    for name, points in overlay.views.items():
        np.testing.assert_allclose(turned.views[name], points, atol=1e-9)


def test_views_are_the_side_the_top_and_the_front(overlay, small_trajectory):
    """The three views are rotations of the pose, in which an animal that runs to the right faces the right way."""
    at = small_trajectory.names.index
    nose, left, right, tail = (at(n) for n in ("nose", "l_front_paw", "r_front_paw", "tail_base"))
    side, above, ahead = (overlay.views[name][0] for name in ("side", "from above", "from ahead"))
    assert side[nose, 0] > side[tail, 0]
    assert side[nose, 1] > side[left, 1]
    assert side[right, 2] > side[left, 2]
    assert above[left, 1] > above[right, 1]
    assert above[nose, 0] > above[tail, 0]
    assert ahead[left, 0] > ahead[right, 0]
    assert ahead[nose, 2] > ahead[tail, 2]
    upright = overlay.upright_m[0]
    for points in (side, above, ahead):
        distances = np.linalg.norm(points[:, None] - points, axis=2)
        np.testing.assert_allclose(distances, np.linalg.norm(upright[:, None] - upright, axis=2), atol=1e-9)


def test_a_mirrored_run_is_seen_from_its_other_side(overlay):
    mirrored = replace(overlay, reprojected_px=[1919, 0] + overlay.reprojected_px * [-1, 1])
    np.testing.assert_allclose(mirrored.views["side"], overlay.views["side"] * [-1, 1, -1])
    np.testing.assert_allclose(mirrored.views["from above"], overlay.views["from above"] * [-1, -1, 1])
    np.testing.assert_allclose(mirrored.views["from ahead"], overlay.views["from ahead"])


def test_headings_are_averaged_and_reach_into_gaps():
    angle = np.array([0.0, 0.1, 0.2, np.nan, np.nan, np.nan, np.nan, np.nan])
    forward = np.stack((np.cos(angle), np.sin(angle), np.full(8, 9.0)), axis=1)
    found = smoothed_headings(forward, fps=8.0)  # three frames
    expected = [0.05, 0.1, 0.15, 0.2, 0.2, 0.2, 0.2, 0.2]
    np.testing.assert_allclose(np.arctan2(found[:, 1], found[:, 0]), expected, atol=1e-9)
    np.testing.assert_array_equal(smoothed_headings(np.full((2, 3), np.nan), 8.0), [[1, 0], [1, 0]])


def test_every_frame_of_the_clip_is_drawn_on_its_own_picture(folder, video, tmp_path):
    """Frames 10 to 17 are drawn on pictures 3 to 10 of a video that begins at frame 7."""
    out = tmp_path / "o.avi"
    data = draw(OverlaySettings(folder=folder, video=video, out=out, first_frame=7, speed=0.5)).data
    assert data == {"out": out, "frames": 8, "fps": 15.0, "speed": 0.5, "notes": []}
    info = probe(out)
    assert (info.size_px, info.fps) == (canvas_size(SIZE), 15.0)
    levels = [float(image[1000, 1800].mean()) for _, image in read_frames(out)]
    np.testing.assert_allclose(levels, 10.0 * np.arange(3, 11), atol=4)
    assert {path.name for path in tmp_path.iterdir()} == {"o.avi", RECORD}


def test_a_video_of_a_varying_rate_is_reported(folder, tmp_path):
    """A video in which every other frame is 15 ms late is reported."""
    video, late = tmp_path / "film.mkv", count()
    writer = cv2.VideoWriter(str(video), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 30.0, SIZE)
    for _ in range(8):
        writer.write(GREY)
    writer.release()

    def moved(found: re.Match[bytes]) -> bytes:
        """Return a Matroska block with another time, which is in whole milliseconds before its flags and picture."""
        return found[1] + (int.from_bytes(found[2], "big") + 15 * (next(late) % 2)).to_bytes(2, "big") + found[3]

    content, blocks = re.subn(rb"(?s)(\xa3.{1,8}?\x81)(..)(\x80\xff\xd8)", moved, video.read_bytes())
    video.write_bytes(content)
    assert blocks == 8
    settings = OverlaySettings(folder=folder, video=video, out=tmp_path / "o.avi", first_frame=10)
    (note,) = draw(settings).data["notes"]
    assert says(note, "film.mkv", "uneven", "(18 to 49 ms apart)")


def test_a_video_that_is_too_short_is_refused(folder, video, tmp_path):
    with refusal((video, "video", "12 frames", ["18 frames or more", "frames 10 to 17", "--first-frame 10"])):
        draw(OverlaySettings(folder=folder, video=video, out=tmp_path / "o.mp4"))
    assert list(tmp_path.iterdir()) == []


def test_all_mismatches_with_the_video_are_reported(folder, tmp_path):
    small = tmp_path / "small.avi"
    with video_writer(small, (64, 48), 30.0) as write:
        write(np.zeros((48, 64, 3), np.uint8))
    with refusal((small, "size", "64x48", "1920x1080"), ("--first-frame", "number", 11, "10 or less")):
        draw(OverlaySettings(folder=folder, video=small, out=tmp_path / "o.mp4", first_frame=11))
    with refusal(("settings", "speed", "-1", "greater than 0")):
        OverlaySettings(folder=folder, video=small, out=tmp_path / "o.mp4", speed=-1)
    there = (small, "file", "did not write", "moved away")
    with refusal((tmp_path, "folder", "no motion.npz"), (tmp_path / "none.mp4", "video", "no such file"), there):
        draw(OverlaySettings(folder=tmp_path, video=tmp_path / "none.mp4", out=small))


def test_command(folder, video, tmp_path):
    out = tmp_path / "o.mp4"
    args = ["overlay", str(folder), "--video", str(video), "--out", str(out), "--first-frame", "10"]
    done = CliRunner().invoke(app, args)
    assert done.exit_code == 0, done.output
    assert "8 frames at 1 times real speed (30 frames a second)" in done.stdout
    assert isinstance(CliRunner().invoke(app, args).exception, InputError)
    assert CliRunner().invoke(app, [*args, "--overwrite", "-q"]).stdout == ""


def test_every_still_has_its_animal(folder):
    drawn, rows, *_ = page_pictures(Motion.load(folder), 0, PageSettings(folder=folder), 20)
    tiles = draw_tiles(drawn, rows)
    assert len(tiles) == 8
    for tile in tiles:
        points = np.argwhere((tile[60:-2, 2:-2].astype(int).max(axis=2) - np.max(PAPER)) > 60)
        assert np.ptp(points[:, 1]) > 0.7 * TILE_PX[0]  # the animal fills most of the tile
        assert abs(points[:, 1].mean() - TILE_PX[0] / 2) < 0.15 * TILE_PX[0]


def test_rings_are_drawn_at_the_detections(overlay):
    """A ring of the detections' colour is drawn at a detection."""
    (picture,) = draw_tiles(overlay, [0])
    xy = overlay.reprojected_px[0]
    low, high = np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)
    scale = 0.8 * min(np.array(TILE_PX) / (high - low))
    x, y = np.rint(np.array(TILE_PX) / 2 + scale * (overlay.detected_px[0, 10] - (low + high) / 2)).astype(int)
    around = picture[y - 8 : y + 9, x - 8 : x + 9].reshape(-1, 3)
    assert (np.abs(around.astype(int) - DETECTION).max(axis=1) < 60).any()


def test_the_video_is_behind_each_still(folder, video):
    motion = Motion.load(folder)
    drawn, rows, _, pictures = page_pictures(motion, 0, PageSettings(folder=folder, video=video, first_frame=7), 3)
    levels = [float(np.median(tile[-40:-4])) for tile in draw_tiles(drawn, rows, pictures)]
    np.testing.assert_allclose(levels, [30, 70, 100], atol=8)  # frames 10, 14 and 17
    with refusal((video, "video", "12 frames", "13 frames or more")):
        page_pictures(motion, 0, PageSettings(folder=folder, video=video, first_frame=5), 2)


@pytest.mark.parametrize(
    ("offset_s", "given", "levels"),
    [(-0.1, 10, [30, 100]), (-0.1, 13, [0, 70]), (0.2, 6, [0, 50]), (0.0, 7, [30, 100])],
)
def test_a_camera_that_began_at_another_time_has_its_own_frame_numbers(
    folder, video, offset_s, given, levels, tmp_path
):
    """The camera began 3 frames earlier than the first camera, or 6 frames later, after the clip's first two frames."""
    with_first(Motion.load(folder), offset_s=offset_s).save(tmp_path / "result")
    told = PageSettings(folder=tmp_path / "result", video=video, first_frame=given)
    drawn, rows, _, pictures = page_pictures(*result_and_video(told), told, 2)
    assert pictures is not None
    np.testing.assert_allclose([picture.mean() for picture in pictures], levels, atol=8)
    assert drawn.frames[rows].tolist() == [12 if offset_s > 0 else 10, 17]


@pytest.fixture(scope="module")
def filmed_twice(two_cameras, tmp_path_factory) -> Path:
    return folder_of(two_cameras, tmp_path_factory.mktemp("several") / "run")


@pytest.mark.parametrize("number", [0, 1])
def test_each_camera_has_its_picture(filmed_twice, two_cameras, number):
    result, picture = Motion.load(filmed_twice), two_cameras.pictures[number]
    assert [camera.name for camera in result.cameras] == ["cam1", "cam2"]
    overlay = overlay_of(result, number=number)
    np.testing.assert_allclose(overlay.reprojected_px, picture.reprojected_px, atol=1e-6)
    np.testing.assert_allclose(overlay.detected_px, picture.detected_px, atol=1e-5)
    np.testing.assert_array_equal(overlay.outliers, picture.outliers)
    relative = picture.joints_camera_m[..., 2] - picture.joints_camera_m[..., 2].mean(axis=1, keepdims=True)
    scale = np.percentile(np.abs(relative), 95)
    np.testing.assert_allclose(overlay.nearness, np.clip(-relative / scale, -1, 1), atol=1e-6)


def test_a_finding_on_one_camera_flags_no_frames_of_another(filmed_twice):
    result = Motion.load(filmed_twice)
    flags = [["gross outliers"] * (t < 3) + ["data poor"] * (t == 2) for t in range(8)]
    wrong = Finding("gross_outliers", "warning", (10, 13), "cam2")
    solution = replace(result.solution, flags=tuple(tuple(own) for own in flags))
    result = replace(result, solution=solution, findings=(wrong,))
    assert overlay_of(result, number=1).flags == flags
    assert overlay_of(result, number=0).flags == [["data poor"] if t == 2 else [] for t in range(8)]


@pytest.mark.slow
def test_the_camera_of_the_video_is_chosen_by_name(filmed_twice, folder, video, tmp_path):
    out = tmp_path / "o.avi"
    drawn = draw(OverlaySettings(folder=filmed_twice, video=video, out=out, first_frame=7, camera_name="cam2"))
    assert drawn.data["frames"] == 8
    for camera in (None, "cam3"):
        with refusal(("--camera-name", "camera", camera or "nothing", "cam1, cam2")):
            draw(
                OverlaySettings(
                    folder=filmed_twice, video=video, out=tmp_path / "p.avi", first_frame=7, camera_name=camera
                )
            )
    named = tmp_path / "clip_cam2.avi"
    named.symlink_to(video)
    result = Motion.load(filmed_twice)
    assert [camera_number(result, None, of) for of in (named, None)] == [1, 0]  # without a video, the first camera
    with refusal(("--camera-name", "camera", "cam2", "one of cam1")):
        draw(OverlaySettings(folder=folder, video=video, out=tmp_path / "p.avi", first_frame=7, camera_name="cam2"))


def test_a_small_animal_is_shown_enlarged_in_an_empty_corner(overlay):
    """The close-up is in a corner through which the animal does not run."""
    t = int(np.flatnonzero(np.isfinite(overlay.reprojected_px[:, 0, 0]))[0])
    middle, extent = np.mean(overlay.reprojected_px[t], axis=0), np.ptp(overlay.reprojected_px[t], axis=0)
    wide, high = round(CLOSE_UP * 1920), round(CLOSE_UP * 1080)

    def close_ups(scale: float, to: tuple[float, float]) -> list[bool]:
        """Return whether the lower right, lower left and upper right corners have the upper edge of a close-up."""
        points = {
            name: np.array(to) + scale * (getattr(overlay, name) - middle) for name in ("reprojected_px", "detected_px")
        }
        image = draw_frame(replace(overlay, **points), t, 10, GREY)
        upper = image[1080 - high, -wide:], image[1080 - high, :wide], image[0, -wide:]
        return [bool((line == INK).all(axis=1).mean() > 0.9) for line in upper]

    small, large = 200 / extent[0], float(np.min([1500, 800] / extent))
    assert close_ups(small, (960, 540)) == [True, False, False]
    assert close_ups(small, (1700, 950)) == [False, True, False]
    assert close_ups(large, (960, 540)) == [False, False, False]


def test_black_bars_are_named_where_a_video_has_them(tmp_path):
    path, picture = tmp_path / "bars.mp4", np.full((48, 64, 3), 150, dtype=np.uint8)
    with video_writer(path, (64, 48), 25.0) as write:
        write(picture)
    assert bars_note(path) is bars_note(None) is None
    picture[:8] = picture[-8:] = 0
    with video_writer(path, (64, 48), 25.0) as write:
        write(picture)
    assert says(bars_note(path), "bars.mp4 has black bars of 8 px at the top and bottom")


def test_a_video_of_another_rate_or_that_goes_on_is_named(small_trajectory):
    film = Path(__file__).parents[2] / "data" / "samples" / "rendered.mp4"
    stated = probe(film).fps
    assert rate_note(film, stated) is None
    assert rate_note(film, None) is None
    assert says(rate_note(film, stated * 2), "unless the video is slowed down")
    settings = PageSettings(folder=Path("run"), video=film)
    said = first_frame_note(small_trajectory, settings)  # the frames of the clip are 10 to 17
    assert says(said, f"has {probe(film).stated_frames} frames", "ends with frame 17", "--first-frame 10")
    chosen = replace(small_trajectory, settings={"frames": "10:18"})
    cut = replace(settings, first_frame=10)
    assert first_frame_note(small_trajectory, cut) is first_frame_note(chosen, settings) is None


def test_frames_that_cannot_be_decoded_are_counted(tmp_path):
    film = tmp_path / "film.avi"
    rng = np.random.default_rng(0)
    with video_writer(film, (64, 48), 25) as write:
        for _ in range(30):
            write(rng.integers(0, 255, (48, 64, 3), dtype=np.uint8))
    assert missing_note(film, np.array([stamp_s for _, stamp_s, _ in timed_frames(film)])) is None
    content = film.read_bytes()
    film.write_bytes(content[: len(content) // 2])
    decoded = sum(1 for _ in read_frames(film))
    note = missing_note(film, np.array([stamp_s for _, stamp_s, _ in timed_frames(film)]))
    assert note is not None
    assert f"states 30 frames, but {decoded} can be decoded" in note


def test_a_video_for_browsers_is_whole_or_an_error(tmp_path, capfd):
    path = tmp_path / "run.webm"
    with video_writer(path, (64, 48), 25.0) as write:
        for level in range(0, 200, 20):
            write(np.full((48, 64, 3), level, np.uint8))
    assert path.read_bytes()[:4] == b"\x1a\x45\xdf\xa3"
    assert (probe(path).stated_frames, probe(path).size_px) == (10, (64, 48))
    np.testing.assert_allclose([picture.mean() for _, picture in read_frames(path)], range(0, 200, 20), atol=4)
    assert _is_complete(path)
    path.write_bytes(path.read_bytes()[:-20])
    assert not _is_complete(path)
    assert capfd.readouterr().err == ""
