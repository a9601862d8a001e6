"""Test calibration from views of a board that is rendered through a known camera, and refused inputs."""

from __future__ import annotations

import json
import math
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import refusal, says
from matplotlib.collections import PathCollection
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from recon import Camera, InputError, read_camera
from recon.base.outputs import RECORD
from recon.calibrate.board_calibration import calibrate, check, coverage
from recon.calibrate.boards import (
    Board,
    BoardView,
    BoardViews,
    choose,
    collect,
    corner_sharpness,
    find_views,
    parse_board,
)
from recon.cli.app import app
from recon.io.video import video_writer
from recon.show import plots
from recon.testing.boards import BOARD_CAMERAS, SIZE_PX, board_poses, draw_board

CHESS, CHARUCO = "chessboard:9x6:25mm", "charuco:9x6:30mm:22mm:DICT_4X4_50"


def pictures(camera: Camera, board_text: str, count: int, seed: int = 1, fill: float = 0.65) -> list[np.ndarray]:
    board, rng = parse_board(board_text), np.random.default_rng(seed)
    return [
        draw_board(board, camera, rotation, translation, oversample=4, blur_px=0.6, noise=2.0, rng=rng)
        for rotation, translation in board_poses(board, camera, count, rng, fill=fill)
    ]


def exact_views(camera: Camera, board: Board, where: list, noise_px: float = 0.1, seed: int = 0) -> BoardViews:
    """Return views with white noise on the projected corners, without any picture."""
    rng = np.random.default_rng(seed)
    views = []
    for number, (rotation, translation) in enumerate(where):
        xy, valid = camera.project(board.points_m @ rotation.T + translation)
        assert valid.all()
        views.append(BoardView(f"{number}.png", np.arange(len(xy)), xy + rng.normal(0, noise_px, xy.shape)))
    return BoardViews(board, camera.image_size_px, tuple(views), (), len(views))


@pytest.fixture(scope="module")
def radtan_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("board")
    for number, picture in enumerate(pictures(BOARD_CAMERAS["radtan"], CHARUCO, 16)):
        cv2.imwrite(str(folder / f"{number:02d}.png"), picture)
    cv2.imwrite(str(folder / "99_wall.png"), np.full((600, 800), 128, np.uint8))
    return folder


@pytest.fixture(scope="module")
def chess_views() -> BoardViews:
    board = parse_board(CHESS)
    where = board_poses(board, BOARD_CAMERAS["radtan"], 14, np.random.default_rng(3), fill=0.65)
    return exact_views(BOARD_CAMERAS["radtan"], board, where)


# Boards


def test_board_descriptions_are_parsed():
    assert parse_board(CHESS) == Board(9, 6, 0.025)
    assert parse_board("charuco:5x7:4cm:0.03m:dict_4x4_50") == Board(5, 7, 0.04, 0.03, "DICT_4X4_50")
    assert parse_board("charuco:5x8:40mm:30mm:DICT_4X4_50:legacy") == replace(
        Board(5, 8, 0.04, 0.03, "DICT_4X4_50"), legacy=True
    )


@pytest.mark.parametrize(
    ("text", "fields"),
    [
        ("chessboard", ["board"]),
        ("circles:9x6:25mm", ["board"]),
        ("chessboard:9x2:25", ["board"]),
        ("chessboard:9x2:25mm", ["size"]),
        ("charuco:5x7:30mm:40mm:DICT_9X9", ["side of a marker", "dictionary"]),
        ("charuco:20x20:30mm:20mm:DICT_4X4_50", ["dictionary"]),
        ("charuco:20x20:30mm:20mm:DICT_4X4_50:old", ["board"]),
    ],
)
def test_every_fault_of_a_board_is_named(text, fields):
    with pytest.raises(InputError) as caught:
        parse_board(text)
    assert [problem.field for problem in caught.value.problems] == fields


@pytest.mark.parametrize("text", ["charuco:5x8:40mm:30mm:DICT_4X4_50", "charuco:5x8:40mm:30mm:DICT_4X4_50:legacy"])
def test_a_rendered_charuco_board_equals_the_picture_by_opencv(text):
    """A ChArUco board rendered head-on equals the picture by OpenCV's `CharucoBoard.generateImage`."""
    board = parse_board(text)
    printed = board.charuco.generateImage((5 * 60, 8 * 60), marginSize=0)
    camera = Camera("c", np.array([[1500.0, 0, -0.5], [0, 1500, -0.5], [0, 0, 1]]), np.zeros(0), "pinhole", (300, 480))
    seen = draw_board(board, camera, np.eye(3), np.array([0.0, 0.0, 1.0]), oversample=4)
    inside = cv2.erode((printed > 128).astype(np.uint8), np.ones((5, 5))) != cv2.dilate(
        (printed > 128).astype(np.uint8), np.ones((5, 5))
    )
    assert ((seen > 128) == (printed > 128))[~inside].all()


@pytest.mark.parametrize("text", [CHESS, CHARUCO])
@pytest.mark.parametrize("lens", list(BOARD_CAMERAS))
def test_corners_are_found_to_a_fraction_of_a_pixel(lens, text):
    camera, board = BOARD_CAMERAS[lens], parse_board(text)
    rng = np.random.default_rng(5)
    (rotation, translation), *_ = board_poses(board, camera, 1, rng, fill=0.8)
    corners = board.detect(draw_board(board, camera, rotation, translation, blur_px=0.6, noise=2.0, rng=rng))
    assert corners is not None
    truth, _ = camera.project(board.points_m @ rotation.T + translation)
    ids, xy_px = corners
    off = xy_px - truth[ids]
    assert len(ids) >= 0.8 * len(board.points_m)
    assert np.sqrt((off**2).sum(axis=1).mean()) < 0.15
    assert np.abs(off.mean(axis=0)).max() < 0.03  # no half pixel between the conventions


# Calibration from pictures


@pytest.mark.parametrize(
    ("lens", "text"),
    [
        ("fisheye", CHARUCO),
        pytest.param("pinhole", CHESS, marks=pytest.mark.slow),
        pytest.param("radtan", CHARUCO, marks=pytest.mark.slow),
    ],
)
def test_intrinsics_are_recovered(lens, text):
    """Intrinsics are found within 0.5 % of the truth, and the lens within a pixel where boards were seen."""
    camera, board = BOARD_CAMERAS[lens], parse_board(text)
    count = 14 if text == CHESS else 24  # ChArUco boards have half as many corners, with twice the error
    found = [board.detect(picture) for picture in pictures(camera, text, count)]
    views = tuple(BoardView(str(n), *corners) for n, corners in enumerate(found) if corners is not None)
    assert len(views) >= count - 1
    calibration = calibrate(BoardViews(board, SIZE_PX, views, (), len(views)), camera.model)
    for name, index in {"fx": (0, 0), "fy": (1, 1), "cx": (0, 2), "cy": (1, 2)}.items():
        assert calibration.parameters[name] == pytest.approx(camera.matrix[index], rel=0.005), name
    assert calibration.rms_px < 0.2
    y, x = np.mgrid[60:540:10j, 80:720:10j]
    pixels = np.stack((x, y), axis=-1)
    seen, _ = calibration.camera.project(camera.rays(pixels)[0])
    # A common shift is ignored, since the principal point and a small rotation of the camera are equivalent.
    off = seen - pixels
    assert np.linalg.norm(off - off.mean(axis=(0, 1)), axis=-1).max() < 1.0
    assert [c for c in check(calibration) if c.verdict == "refused"] == []


@pytest.mark.parametrize("model", ["pinhole", "radtan"])
def test_standard_deviations_agree_with_opencv(chess_views, model):
    views = chess_views
    calibration = calibrate(views, model)
    flags = 0
    if model == "pinhole":
        flags = cv2.CALIB_ZERO_TANGENT_DIST | cv2.CALIB_FIX_K1 | cv2.CALIB_FIX_K2 | cv2.CALIB_FIX_K3
    points = views.board.points_m.astype(np.float32)
    used = {view.name for view in calibration.used}
    rms, matrix, _, _, _, sigma, _, errors = cv2.calibrateCameraExtended(
        [points for _ in used],
        [v.xy_px.astype(np.float32)[:, None] for v in views.views if v.name in used],
        SIZE_PX, np.eye(3), np.zeros(5), flags=flags, criteria=(3, 200, 1e-10),
    )  # fmt: skip
    n = len(calibration.sigma)
    np.testing.assert_allclose(calibration.sigma, np.ravel(sigma)[:n], rtol=1e-2)
    assert calibration.rms_px == pytest.approx(rms, rel=1e-4)
    np.testing.assert_allclose([v.rms_px for v in calibration.used], np.ravel(errors), rtol=1e-3)
    np.testing.assert_allclose(calibration.camera.matrix, matrix, rtol=1e-5)


@pytest.mark.slow
def test_standard_deviations_of_a_fisheye_are_the_scatter_over_noise():
    camera, board = BOARD_CAMERAS["fisheye"], parse_board(CHESS)
    where = board_poses(board, camera, 8, np.random.default_rng(2), fill=0.7)
    runs = [calibrate(exact_views(camera, board, where, seed=seed), "fisheye") for seed in range(9)]
    scatter = np.std([list(run.parameters.values())[:4] for run in runs], axis=0, ddof=1)
    stated = np.mean([run.sigma[:4] for run in runs], axis=0)
    assert (np.abs(np.log(scatter / stated)) < math.log(1.9)).all()  # the scatter of nine draws is known to 25 %


def test_a_picture_with_wrong_corners_is_left_out(chess_views):
    wrong = chess_views.views[4]
    shifted = wrong.xy_px.copy()
    shifted[:9] += [6.0, -4.0]
    spoiled = replace(wrong, xy_px=shifted)
    views = tuple(spoiled if view is wrong else view for view in chess_views.views)
    calibration = calibrate(replace(chess_views, views=views), "radtan")
    assert [view.name for view in calibration.views if not view.used] == ["4.png"]
    without = calibrate(replace(chess_views, views=tuple(v for v in views if v is not spoiled)), "radtan")
    np.testing.assert_allclose(calibration.camera.matrix, without.camera.matrix, rtol=1e-9)
    expected = math.sqrt((6**2 + 4**2) * 9 / 54)
    (left_out,) = (view for view in calibration.views if not view.used)
    assert left_out.rms_px == pytest.approx(expected, rel=0.5)
    dropped = {c.name: c for c in check(calibration)}["dropped"]
    assert (dropped.verdict, dropped.value) == ("ok", pytest.approx(100 / 14))


# Refused calibrations


def refused(views: BoardViews, model="radtan") -> dict[str, str]:
    return {c.name: str(c) for c in check(calibrate(views, model)) if c.verdict == "refused"}


def test_a_good_calibration_is_not_refused(chess_views):
    assert refused(chess_views) == {}


def test_parallel_boards_are_refused():
    """Parallel boards, which confound focal length and distance, are refused with a message that gives the limit."""
    board, camera = Board(9, 6, 0.025), BOARD_CAMERAS["radtan"]
    centre = board.points_m.mean(axis=0)
    rng = np.random.default_rng(0)
    where = [
        (
            Rotation.from_rotvec([0.02 * math.cos(n), 0.02 * math.sin(n), 0.3 * n]).as_matrix(),
            np.array([x, y, z]),
        )
        for n, (x, y, z) in enumerate(rng.uniform([-0.08, -0.05, 0.35], [0.08, 0.05, 0.5], (12, 3)))
    ]
    where = [(r, t - r @ centre) for r, t in where]
    said = refused(exact_views(camera, board, where))
    assert {"tilt", "tilt axes"} <= set(said)
    match = re.search(r"two boards ([\d.]+) degrees, at least 20 degrees needed \(([\d.]+) short\)", said["tilt"])
    assert match is not None
    assert float(match[1]) + float(match[2]) == pytest.approx(20, abs=0.6)


def test_each_limit_is_measured(chess_views):
    calibration = calibrate(chess_views, "radtan")
    few = {c.name: c for c in check(replace(calibration, views=calibration.views[:5]))}
    assert (few["images"].verdict, few["images"].value) == ("refused", 5)
    values = {c.name: c.value for c in check(calibration)}
    normals = np.array([v.rotation[:, 2] for v in calibration.used])
    normals *= np.sign(normals[:, 2:])
    assert values["tilt"] == pytest.approx(
        max(math.degrees(math.acos(min(1, a @ b))) for a in normals for b in normals)
    )
    camera = calibration.camera
    moved = camera.matrix + np.array([[64.0, 0, 160], [0, 0, 0], [0, 0, 0]])
    off = {c.name: c for c in check(replace(calibration, camera=replace(camera, matrix=moved)))}
    assert off["aspect"].value == pytest.approx(100 * (moved[0, 0] / moved[1, 1] - 1))
    assert off["aspect"].verdict == "refused"
    assert off["centre"].value == pytest.approx(100 * math.hypot(moved[0, 2] - 399.5, moved[1, 2] - 299.5) / 800)
    assert off["centre"].verdict == "refused"
    folded = replace(camera, distortion=[-0.8, 0.0, 0.0, 0.0, 0.0])
    assert {c.name: c for c in check(replace(calibration, camera=folded))}["folded"].verdict == "refused"
    uncertain = replace(calibration, sigma=(7.0, 1.0, 9.0, 1.0, *calibration.sigma[4:]))
    said = {c.name: c for c in check(uncertain)}
    assert said["focal length"].value == pytest.approx(100 * 7 / calibration.parameters["fx"])
    assert [said[name].verdict for name in ("focal length", "principal point")] == ["refused", "refused"]


def test_coverage_is_the_area_that_the_boards_cover():
    """One board that fills the middle ninth of the picture has a coverage of a ninth."""
    board = Board(9, 6, 0.025)
    camera = Camera("c", BOARD_CAMERAS["pinhole"].matrix, np.zeros(0), "pinhole", SIZE_PX)
    xy = board.points_m[:, :2] / [0.2, 0.125] * [266.6, 200] + [266.7, 200]
    views = exact_views(camera, board, board_poses(board, camera, 6, np.random.default_rng(0)))
    calibration = calibrate(views, "pinhole")
    one = replace(calibration.views[0], ids=np.arange(54), xy_px=xy)
    assert coverage(replace(calibration, views=(one,))).mean() == pytest.approx(1 / 9, rel=0.03)
    values = {c.name: c for c in check(replace(calibration, views=(one,)))}
    assert values["coverage"].verdict == "refused"
    assert values["border"].value == pytest.approx(100 / 3, abs=0.2)


def test_too_few_views_are_refused(chess_views):
    with refusal(("pictures", "views", "2 of 14 pictures", "3 pictures or more")):
        calibrate(replace(chess_views, views=chess_views.views[:2]), "radtan")


# Videos


def test_sharp_and_different_frames_are_chosen():
    """Blurred frames, and frames that show the board at the same position as another frame, are left out."""
    positions = np.array([0.1] * 5 + [0.5, 0.9, 0.7, 0.3])
    outlines = np.zeros((9, 4, 2))
    outlines[..., 0] = positions[:, None]
    sharpness = np.array([0.20, 0.21, 0.2, 0.21, 0.2, 0.2, 0.2, 0.1, 0.05])
    assert choose(sharpness, outlines) == [1, 5, 6]
    assert choose(sharpness, outlines, count=2) == [1, 6]


def test_sharpness_falls_with_blur_and_with_motion_in_one_direction():
    camera, board = BOARD_CAMERAS["pinhole"], parse_board(CHESS)
    picture = draw_board(board, camera, np.eye(3), np.array([-0.1, -0.06, 0.3]))
    corners = board.detect(picture)
    assert corners is not None

    def sharpness(image: np.ndarray) -> float:
        return corner_sharpness(np.asarray(image, np.uint8), corners[1])

    blurred = [sharpness(cv2.GaussianBlur(picture, (0, 0), s)) for s in (0.7, 1.5, 3.0)]
    assert blurred == sorted(blurred, reverse=True)
    assert sharpness(cv2.blur(picture, (9, 1))) < 0.6 * sharpness(picture)
    assert sharpness(np.asarray(picture // 2 + 60)) == pytest.approx(sharpness(picture), rel=0.1)


@pytest.mark.slow
def test_a_video_gives_some_of_its_frames(tmp_path):
    """All frames of a video in which the board rests count as one view."""
    camera, board = BOARD_CAMERAS["pinhole"], parse_board(CHARUCO)
    glide = [np.array([-0.25 + 0.02 * n, -0.16 + 0.01 * n, 0.6 - 0.01 * n]) for n in range(12)]
    with video_writer(tmp_path / "board.avi", SIZE_PX, 5.0) as write:
        for n, position in enumerate(glide + [glide[-1]] * 6):
            tilt = Rotation.from_rotvec([0.5 * math.sin(min(n, 11)), 0.5 * math.cos(min(n, 11)), 0]).as_matrix()
            picture = draw_board(board, camera, tilt, position, oversample=4)
            write(cv2.cvtColor(picture, cv2.COLOR_GRAY2BGR))
    views = find_views([tmp_path / "board.avi"], board)
    assert views.examined == 18
    chosen = [int(view.name.removeprefix("frame ")) for view in views.views]
    assert len([n for n in chosen if n >= 11]) == 1
    assert len(chosen) >= 9
    assert views.with_board + len(views.without_board) == views.examined


# Input files, the coverage picture and the command


def test_all_bad_inputs_are_named_at_once(tmp_path):
    (tmp_path / "empty").mkdir()
    with refusal((tmp_path / "empty", "folder", "no pictures"), (tmp_path / "nowhere.png", "file", "no such file")):
        collect([tmp_path / "empty", tmp_path / "nowhere.png"])
    (tmp_path / "text.png").write_text("no picture")
    for number, shape in enumerate([(60, 80), (60, 80), (80, 60)]):
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.zeros(shape, np.uint8))
    sizes = ("pictures", "size", "80x60 (0.png, 1.png); 60x80 (2.png)", "one size")
    with refusal((tmp_path / "text.png", "file", "cannot read"), sizes):
        find_views(collect([tmp_path]), parse_board(CHESS))
    with refusal((tmp_path / "0.png", "board", "1 pictures", ["9x6", "25 mm"])):
        find_views([tmp_path / "0.png"], parse_board(CHESS))


def test_coverage_picture_shows_detected_corners(chess_views):
    found = calibrate(chess_views, "radtan")
    kept = replace(found, views=(replace(found.views[0], used=False), *found.views[1:]))
    axes, bar = plots.calibration(kept).axes
    (dots,) = (one for one in axes.collections if isinstance(one, PathCollection))
    np.testing.assert_array_equal(dots.get_offsets(), np.concatenate([view.xy_px for view in kept.used]))
    errors = np.repeat([view.rms_px for view in kept.used], [len(view.ids) for view in kept.used])
    np.testing.assert_array_equal(dots.get_array(), errors)
    (crosses,) = axes.lines
    np.testing.assert_array_equal(crosses.get_xydata(), found.views[0].xy_px)
    (shaded,) = axes.images
    np.testing.assert_array_equal(shaded.get_array(), coverage(kept))
    assert axes.get_ylim() == (599.5, -0.5)
    assert f"all pictures: {kept.rms_px:.2f}" in bar.get_xlabel()


def test_command_writes_a_camera_that_can_be_read(radtan_folder, tmp_path):
    out = tmp_path / "new" / "camera.toml"
    args = ["calibrate", str(radtan_folder), "--board", CHARUCO, "--model", "radtan", "--out", str(out)]
    done = CliRunner().invoke(app, [*args, "--json"])
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    camera = read_camera(out)
    assert camera.name == "camera"
    assert camera.to_dict() == said["camera"]
    assert camera.matrix[0, 0] == pytest.approx(640.0, rel=0.005)
    assert said["without_board"] == ["99_wall.png"]
    assert {picture["name"] for picture in said["pictures"]} == {f"{n:02d}.png" for n in range(16)}
    assert cv2.imread(str(tmp_path / "new" / "camera_coverage.png")) is not None
    assert {path.name for path in out.parent.iterdir()} == {"camera.toml", "camera_coverage.png", RECORD}
    again = CliRunner().invoke(app, args)
    assert isinstance(again.exception, InputError)
    assert "--overwrite" in str(again.exception)
    table = CliRunner().invoke(app, [*args, "--overwrite"])
    assert table.exit_code == 0
    assert "found in 16 of 17 pictures" in table.stdout
    assert re.search(r"07\.png +\d\d +0\.\d\d", table.stdout)


@pytest.mark.usefixtures("undrawn")
def test_command_refuses_and_can_be_forced(radtan_folder, tmp_path):
    """The command refuses pictures that a pinhole does not explain, unless `--force` is given."""
    pictures = sorted(map(str, radtan_folder.iterdir()))[:12]
    out = tmp_path / "camera.toml"
    args = ["calibrate", *pictures, "--board", CHARUCO, "--model", "pinhole", "--out", str(out)]
    done = CliRunner().invoke(app, args)
    assert done.exit_code == 1
    assert says(done.stderr, "refused: rms", "scaled to at most 1920 px", "at most 1 px needed")
    assert not out.exists()
    assert (tmp_path / "camera_coverage.png").exists()
    assert CliRunner().invoke(app, [*args, "--force"]).exit_code == 0
    assert read_camera(out).model == "pinhole"


def test_command_reports_all_problems_with_its_options(tmp_path):
    args = [
        "calibrate",
        str(tmp_path),
        "--board",
        "chessboard:9x6",
        "--model",
        "wide",
        "--out",
        str(tmp_path / "c.yaml"),
    ]
    done = CliRunner().invoke(app, args)
    assert isinstance(done.exception, InputError)
    assert [str(problem.file) for problem in done.exception.problems] == [str(tmp_path), "--board", "--model", "--out"]
