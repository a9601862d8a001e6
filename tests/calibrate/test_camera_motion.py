"""Test `recon camera-motion` on films of a random texture, seen by a camera with known rotations."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from command_line import refusal, refused, run, says
from scipy.spatial.transform import Rotation

from recon.calibrate.camera_motion.level import as_level, read_marks, up_at_tilt, up_by_marks
from recon.calibrate.camera_motion.rotation import Orientation, rays_of
from recon.calibrate.camera_motion.track import CLEAR_SIGMAS, Tracker
from recon.geometry.camera import Camera
from recon.io.camera_files import write_camera
from recon.io.camera_track import read_camera_track
from recon.io.video import timed_frames, video_writer

SIZE = (320, 180)
PINHOLE = Camera("cam", np.array([[300.0, 0, 160], [0, 300.0, 90], [0, 0, 1]]), np.zeros(0), "pinhole", SIZE)
FISHEYE = Camera(
    "cam", np.array([[150.0, 0, 158], [0, 150.0, 91], [0, 0, 1]]), np.array([-0.03, 0.01, 0, 0]), "fisheye", SIZE
)


@cache
def texture(seed: int = 0) -> np.ndarray:
    """Return a texture that repeats, 1024x1024 grey levels, smooth over about 2 pixels."""
    noise = np.random.default_rng(seed).normal(size=(1024, 1024))
    smooth = sum(cv2.GaussianBlur(np.tile(noise, (1, 1)), (0, 0), s) * s for s in (1.5, 4.0, 12.0))
    return np.clip(128 + 45 * smooth / np.std(smooth), 0, 255).astype(np.float32)


def sampled(u: np.ndarray, v: np.ndarray, seed: int = 0) -> np.ndarray:
    picture = cv2.remap(
        texture(seed), (u % 1024).astype(np.float32), (v % 1024).astype(np.float32), cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_WRAP,
    )  # fmt: skip
    return cv2.cvtColor(picture.round().astype(np.uint8), cv2.COLOR_GRAY2BGR)


@cache
def directions(camera: Camera, zoom: float = 1.0) -> np.ndarray:
    x, y = np.meshgrid(np.arange(SIZE[0]), np.arange(SIZE[1]))
    rays, _ = rays_of(camera, np.column_stack([x.ravel(), y.ravel()]).astype(float), zoom)
    return np.nan_to_num(rays, nan=1.0)


def seen(rotation: np.ndarray, camera: Camera = PINHOLE, zoom: float = 1.0, px_rad: float = 300.0) -> np.ndarray:
    """Return the picture of a camera inside a sphere with the texture."""
    x, y, z = (directions(camera, zoom) @ rotation).T
    u, v = px_rad * np.arctan2(x, z), px_rad * np.arcsin(np.clip(y, -1, 1))
    return sampled(u.reshape(SIZE[::-1]), v.reshape(SIZE[::-1]))


def pan(count: int, sweep_deg: float, shake_deg: float = 0.2) -> np.ndarray:
    """Return rotations (T, 3, 3) of a pan there and back."""
    rng = np.random.default_rng(1)
    way = sweep_deg * (1 - np.abs(np.linspace(-1, 1, count)))
    angles = np.column_stack([0.2 * way, way, -0.1 * way]) + shake_deg * rng.normal(size=(count, 3))
    angles[-1] = angles[0]
    return Rotation.from_rotvec(np.radians(angles)).inv().as_matrix()


def tracked(pictures, camera: Camera = PINHOLE, **options):
    tracker = Tracker(camera, **options)
    for number, picture in enumerate(pictures):
        tracker.add(number, picture)
    return tracker.finish()


def errors_deg(motion, rotations: np.ndarray) -> np.ndarray:
    found, truth = np.stack([one.rotation for one in motion.orientations]), rotations[motion.frames]
    off = (found @ found[0].T) @ (truth @ truth[0].T).swapaxes(1, 2)
    return np.degrees(Rotation.from_matrix(off).magnitude())


def with_patch(pictures, share: float):
    """Yield pictures in which a finely structured subject strides to and fro in the middle, as if it were followed."""
    width, height = (int(n * np.sqrt(share)) for n in SIZE)
    x, y = np.meshgrid(np.arange(width), np.arange(height))
    for t, picture in enumerate(pictures):
        left = int((SIZE[0] - width) / 2 + 8 * np.sin(0.4 * t))
        top = int((SIZE[1] - height) / 2 + 2 * np.sin(t))
        picture = picture.copy()
        picture[top : top + height, left : left + width] = sampled(1.4 * x, 1.4 * y, seed=1)
        yield picture


@pytest.mark.parametrize(("camera", "by"), [(PINHOLE, 1.0), pytest.param(FISHEYE, 0.9, marks=pytest.mark.slow)])
def test_a_pan_and_the_focal_length_are_estimated(camera, by):
    """A pan is found together with the focal length, without drift or with an error within its standard deviation."""
    rotations = pan(12, 14.0)
    told = replace(camera, matrix=camera.matrix * [[by, 1, 1], [1, by, 1], [1, 1, 1]])
    motion = tracked((seen(R, camera, px_rad=camera.matrix[0, 0]) for R in rotations), told)
    found, sigma = motion.focal
    error = errors_deg(motion, rotations)
    assert len(error) == 12
    assert sigma < 0.05
    assert abs(found + np.log(by)) < 3 * sigma
    assert (abs(found) > CLEAR_SIGMAS * sigma) == (by != 1)
    assert (error <= 0.02 + 2 * np.degrees(motion.sigma_rad)).all()
    if by == 1:
        assert np.median(error) < 0.01
        assert error.max() < 0.03
        assert error[-1] < 0.02


@pytest.mark.slow
def test_a_followed_subject_over_40_percent_is_not_background():
    rotations = pan(14, 12.0)
    pictures = ((128 + 0.25 * (seen(R) - 128.0)).astype(np.uint8) for R in rotations)
    motion = tracked(with_patch(pictures, 0.4))
    error = errors_deg(motion, rotations)
    assert len(error) >= 12
    assert np.median(error) < 0.015
    assert error.max() < 0.05


@pytest.mark.slow
def test_keypoints_mask_an_animal_larger_than_the_background():
    """The animal is masked by its points, although it covers more than half of the picture."""
    rotations = pan(7, 8.0)
    hull = np.array([[60.0, 40], [260, 40], [260, 140], [60, 140]])
    pictures = list(with_patch((seen(R) for R in rotations), 0.6))
    assert np.median(errors_deg(tracked(pictures), rotations)) > 1
    assert errors_deg(tracked(pictures, masked=lambda number: hull), rotations).max() < 0.06


def test_zoom_and_rotation_are_estimated_together():
    rotations, zooms = pan(10, 8.0), np.linspace(1, 1.3, 10)
    motion = tracked((seen(R, zoom=z) for R, z in zip(rotations, zooms, strict=True)), solve_zoom=True)
    found = np.array([one.zoom for one in motion.orientations])
    assert np.abs(found / zooms - 1).max() < 1e-3
    assert errors_deg(motion, rotations).max() < 0.05


@pytest.mark.slow
def test_orientation_is_found_again_after_frames_without_background():
    rotations = pan(12, 8.0)
    pictures = [seen(R) for R in rotations]
    pictures[5:7] = [np.full_like(pictures[0], 120)] * 2
    motion = tracked(pictures)
    assert motion.lost.tolist() == [5, 6]
    assert motion.turned_only
    assert motion.cut is None
    assert errors_deg(motion, rotations).max() < 0.03


def test_a_cut_is_detected():
    x, y = np.meshgrid(np.arange(320.0), np.arange(180.0))
    pictures = [seen(R) for R in pan(6, 3.0)] + [sampled(x, y, seed=3)]
    assert tracked(pictures).cut == 6


def driven(way_m: float, turned_rad: float) -> np.ndarray:
    """Return pictures of a wall 8 m away, taken by a camera that is carried along it 1.5 m above the ground."""
    dx, dy, dz = (directions(PINHOLE) @ Rotation.from_rotvec([0, turned_rad, 0]).as_matrix().T).T
    to_ground, to_wall = np.where(dy > 1e-3, 1.5 / np.maximum(dy, 1e-3), 1e9), 8 / dz
    far = np.minimum(to_ground, to_wall)
    x, y, z = (part.reshape(SIZE[::-1]) for part in (way_m + far * dx, far * dy, far * dz))
    ground = (to_ground < to_wall).reshape(*SIZE[::-1], 1)
    return np.where(ground, sampled(80 * x, 80 * z, seed=2), sampled(40 * x, 40 * y))


@pytest.mark.slow
@pytest.mark.parametrize("follows", [False, True])
def test_a_camera_that_is_carried_is_recognised(follows):
    way = 0.08 * np.arange(10)
    motion = tracked(driven(x, -np.arctan(x / 8) if follows else 0.0) for x in way)
    assert not motion.turned_only


def test_the_world_is_level_by_the_given_tilt_or_on_average():
    orientations = [Orientation(R) for R in pan(9, 10.0)]
    told = as_level(orientations, up_at_tilt(np.radians(12)))[0].rotation
    np.testing.assert_allclose(told[2, 2], -np.sin(np.radians(12)))
    np.testing.assert_allclose(told[0], [1, 0, 0], atol=1e-12)
    mean = np.mean([one.rotation for one in as_level(orientations, None)], axis=0)
    np.testing.assert_allclose(mean[2] / np.linalg.norm(mean[2]), [0, 1, 0], atol=1e-3)


def marked(folder, lines: list[tuple[str, int, np.ndarray]]):
    """Write marks as a table, each with two world points (2, 3) as seen by a panning camera, and return its path."""
    rows = []
    for kind, frame, points in lines:
        pixels, _ = FISHEYE.project(points @ pan(9, 10.0)[frame].T)
        rows.append(f"{kind},{frame + 3}," + ",".join(f"{x:.3f}" for x in pixels.ravel()))
    (folder / "level.csv").write_text("kind,frame,x1,y1,x2,y2\n" + "\n".join(rows) + "\n")
    return folder / "level.csv"


UP = np.array([0.1, -0.98, -0.15]) / np.linalg.norm([0.1, -0.98, -0.15])
ACROSS = np.cross(UP, [0.0, 0.0, 1.0])
AWAY = np.cross(ACROSS, UP)
HORIZON = ("horizon", 2, np.stack([5 * AWAY - 2 * ACROSS, 5 * AWAY + 2 * ACROSS]))
POSTS = [("vertical", t, 5 * AWAY + x * ACROSS + np.outer([-2.2, 2.2], UP)) for t, x in ((1, -2.0), (7, 2.5))]


@pytest.mark.parametrize("lines", [[HORIZON], POSTS, [HORIZON, *POSTS]], ids=["horizon", "posts", "both"])
def test_up_is_found_from_level_marks(tmp_path, lines):
    path, orientations = marked(tmp_path, lines), [Orientation(R) for R in pan(9, 10.0)]
    up, sigma = up_by_marks(
        path, read_marks(path), FISHEYE, {t + 3: orientation for t, orientation in enumerate(orientations)}
    )
    np.testing.assert_allclose(up, orientations[0].rotation @ UP, atol=1e-4)
    assert 0.001 < sigma < 0.05
    np.testing.assert_allclose(as_level(orientations, up)[4].rotation[:, 2], orientations[4].rotation @ UP, atol=1e-4)


def test_marks_that_do_not_determine_up_are_refused(tmp_path):
    orientations = {t + 3: Orientation(R) for t, R in enumerate(pan(9, 10.0))}
    path = marked(tmp_path, POSTS[:1])
    with refusal((path, "marks", ["determine", "upward direction"])):
        up_by_marks(path, read_marks(path), FISHEYE, orientations)
    with refusal((path, "frame", 4)):
        up_by_marks(path, read_marks(path), FISHEYE, {3: Orientation(np.eye(3))})
    path.write_text(
        "kind,frame,x1,y1,x2,y2\nhorizon,1,2,3,4,5\nskyline,1,2,3,4,5\nvertical,1,2,3,2,3\nhorizon,1,2,3,inf,5\n"
    )
    wrong = enumerate(path.read_text().splitlines()[2:], 3)
    with refusal(*((path, f"line {number}", f"'{line}'", "horizon or vertical") for number, line in wrong)):
        read_marks(path)


# Command line


def film(path, pictures) -> None:
    with video_writer(path, SIZE, 30.0) as write:
        for picture in pictures:
            write(picture)


@pytest.fixture(scope="module")
def pan_film(tmp_path_factory):
    folder = tmp_path_factory.mktemp("pan")
    film(folder / "pan.avi", (seen(R) for R in pan(8, 6.0)))
    write_camera(PINHOLE, folder / "camera.toml")
    return folder


def test_command_writes_a_track_that_the_fit_reads(pan_film, tmp_path):
    points = "frame,keypoint,x,y,likelihood\n" + "".join(f"{t + 5},nose,160,90,0.9\n" for t in range(8))
    (tmp_path / "points.csv").write_text(points)
    ended = run(
        "camera-motion", pan_film / "pan.avi", "--camera", pan_film / "camera.toml", "--out", tmp_path / "track.csv",
        "--keypoints", tmp_path / "points.csv", "--first-frame", 5, "--tilt-deg", 10, "--zoom",
    )  # fmt: skip
    assert ended.code == 0, ended.err
    assert "8 of 8 frames have a pose" in ended.out
    track = read_camera_track(tmp_path / "track.csv")
    assert track.frames.tolist() == list(range(5, 13))
    found = track.T_camera_world[:, :3, :3]
    truth = pan(8, 6.0)
    off = (found @ found[0].T) @ (truth @ truth[0].T).swapaxes(1, 2)
    assert np.degrees(Rotation.from_matrix(off).magnitude()).max() < 0.03
    assert track.intrinsics_px is not None
    np.testing.assert_allclose(track.intrinsics_px[:, :2], 300, rtol=2e-3)
    report = json.loads((tmp_path / "track_report.json").read_text())
    assert (report["video"], report["camera"]["file"]) == ("pan.avi", "camera.toml")  # the report contains no folders
    assert report["by_frame"]["tilt_deg"][0] == pytest.approx(10)
    assert report["by_frame"]["frame"] == list(range(5, 13))
    assert "rolling shutter" in " ".join(report["notes"])
    panorama = cv2.imread(str(tmp_path / "track_panorama.png"))
    assert panorama is not None
    assert panorama.shape[1] > 1000


@pytest.mark.slow
def test_frames_of_a_damaged_video_are_numbered_as_by_a_detector(tmp_path):
    """Frames of a damaged video are numbered as a detector numbers decodable frames, and gaps are reported."""
    frames = 14
    rotations, video = pan(frames, 6.0), tmp_path / "pan.mkv"
    writer = cv2.VideoWriter(str(video), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 30.0, SIZE)
    for rotation in rotations:
        writer.write(seen(rotation))
    writer.release()
    content = bytearray(video.read_bytes())
    first, stop = len(content) * 5 // 10, len(content) * 6 // 10
    content[first:stop] = bytes(stop - first)
    video.write_bytes(content)
    write_camera(PINHOLE, tmp_path / "camera.toml")
    decoded = sum(1 for _ in timed_frames(video))
    args = ("camera-motion", video, "--camera", tmp_path / "camera.toml", "--out", tmp_path / "track.csv")
    for rows, code in ((frames, 2), (decoded, 0)):  # frame counts of the whole video and of the readable part
        lines = "".join(f"{t},nose,160,90,0.9\n" for t in range(rows))
        (tmp_path / "points.csv").write_text(f"frame,keypoint,x,y,likelihood\n{lines}")
        ended = run(*args, "--keypoints", tmp_path / "points.csv")
        said = re.search(r"missing frames \((\d+) before frame (\d+)\)", " ".join((ended.out + ended.err).split()))
        assert said is not None, ended.err
        assert ended.code == code
    missing, at = map(int, said.groups())
    report = json.loads((tmp_path / "track_report.json").read_text())
    assert (report["frames"], report["frames_missing"], missing) == (decoded, frames - decoded, frames - decoded)
    track = read_camera_track(tmp_path / "track.csv")
    whole = track.frames != at - 1  # the frame whose picture is damaged
    found = track.T_camera_world[whole, :3, :3]
    truth = np.delete(rotations, np.s_[at : at + missing], axis=0)[track.frames[whole]]
    off = (found @ found[0].T) @ (truth @ truth[0].T).swapaxes(1, 2)
    assert len(found) == decoded - 1
    assert np.degrees(Rotation.from_matrix(off).magnitude()).max() < 0.05


@pytest.mark.slow
def test_without_a_tilt_the_output_names_the_mean_frame_as_level(pan_film, tmp_path):
    ended = run(
        "camera-motion", pan_film / "pan.avi", "--camera", pan_film / "camera.toml", "--out", tmp_path / "track.csv"
    )
    assert ended.code == 0, ended.err
    assert says(ended.out, "mean of all frames")


def test_level_marks_are_reported_and_exclude_a_tilt(pan_film, tmp_path):
    (tmp_path / "level.csv").write_text("kind,frame,x1,y1,x2,y2\nhorizon,0,10,95,300,85\n")
    given = ("camera-motion", pan_film / "pan.avi", "--camera", pan_film / "camera.toml", "--out", tmp_path / "a.csv")
    ended = run(*given, "--level-marks", tmp_path / "level.csv")
    assert ended.code == 0, ended.err
    assert "from 1 mark in" in ended.out
    report = json.loads((tmp_path / "a_report.json").read_text())["by_frame"]
    assert report["roll_deg"][0] == pytest.approx(-np.degrees(np.arctan2(10, 290)), abs=0.05)
    assert report["tilt_deg"][0] == pytest.approx(0.0, abs=0.2)
    marks = tmp_path / "level.csv"
    beside = ("--tilt-deg", "level", [3, marks], "only one of the two")
    refused([*given, "--overwrite", "--level-marks", marks, "--tilt-deg", 3], beside)


def film_refused(
    folder, pictures, expected: tuple[object, ...], camera: Camera = PINHOLE, more: Sequence[object] = ()
) -> None:
    film(folder / "film.avi", pictures)
    write_camera(camera, folder / "camera.toml")
    out = folder / "track.csv"
    args = ("camera-motion", folder / "film.avi", "--camera", folder / "camera.toml", "--out", out, *more)
    refused(args, expected)
    assert not out.exists()


def test_bad_videos_and_keypoints_are_refused(tmp_path):
    still = [seen(np.eye(3))] * 3
    other = Camera.from_hfov(60, (640, 360))
    film_refused(tmp_path, still, ("film.avi", "size", "320x180", "640x360"), other)
    blurred = [cv2.GaussianBlur(picture, (0, 0), 15) for picture in still]
    film_refused(tmp_path, blurred, ("film.avi", "background", ["too little", "3 of 3 frames"], "50 %"))
    x, y = np.meshgrid(np.arange(320.0), np.arange(180.0))
    film_refused(tmp_path, [*still, sampled(x, y, seed=3)], ("film.avi", "video", ["a cut", "frame 3"]))
    points = tmp_path / "points.csv"
    points.write_text("frame,keypoint,x,y,likelihood\n7,nose,160,90,0.9\n")
    of_others = (points, "frames", ["1 of 1 frames", "film.avi", "3 frames"], "--first-frame")
    film_refused(tmp_path, still, of_others, more=("--keypoints", points))


@pytest.mark.slow
def test_a_focal_length_that_the_rotations_contradict_is_reported(tmp_path):
    """A focal length that the rotations contradict by a tenth or more is refused, and a smaller difference is noted."""
    film(tmp_path / "pan.avi", (seen(R) for R in pan(10, 12.0)))
    (tmp_path / "off").mkdir()
    for by, code in ((0.8, 2), (1.05, 0)):
        other = replace(PINHOLE, matrix=PINHOLE.matrix * [[by, 1, 1], [1, by, 1], [1, 1, 1]])
        write_camera(other, tmp_path / "other.toml")
        out = tmp_path / "off" / "track.csv"
        ended = run("camera-motion", tmp_path / "pan.avi", "--camera", tmp_path / "other.toml", "--out", out)
        said = " ".join((ended.err if code else ended.out).split())
        assert ended.code == code, said
        length = re.search(r"moves as if the focal length were (\d+) px", said)
        assert length is not None, said
        assert abs(int(length[1]) - 300) < 6
        assert says(said, f"camera file has {300 * by:.0f} px")
        assert out.exists() == (code == 0)
    with out.with_name("track_report.json").open() as file:
        assert json.load(file)["focal_px"]["file"] == pytest.approx(315)


def test_a_zoom_without_the_option_and_a_carried_camera_are_refused(tmp_path):
    zooming = [seen(np.eye(3), zoom=z) for z in np.linspace(1, 1.4, 10)]
    film_refused(tmp_path, zooming, ("film.avi", "motion", ["no turn", "grows"], "--zoom"))
    carried = [driven(x, 0.0) for x in 0.1 * np.arange(10)]
    film_refused(tmp_path, carried, ("film.avi", "motion", "no turn", "COLMAP"), more=["--zoom"])
