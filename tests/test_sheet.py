"""`recon overlay --sheet`: stills of a result side by side."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import run

from recon.base.errors import InputError
from recon.fit.motion import Motion
from recon.io.video import video_writer
from recon.show.overlay import DETECTION, LEFT, PAPER, TILE_PX, draw_sheet
from recon.workflows.clip_results import write_clip
from recon.workflows.overlay import OverlaySettings, overlay_of, run_sheet
from recon.workflows.settings import FitSettings

WIDTH, HEIGHT = TILE_PX


@pytest.fixture(scope="module")
def folder(small_trajectory, tmp_path_factory) -> Path:
    """Frames 10 to 17."""
    path = tmp_path_factory.mktemp("sheet") / "run"
    write_clip(small_trajectory, FitSettings(keypoints=Path("run.csv"), camera=Path("camera.toml"), fps=30), path)
    return path


@pytest.fixture(scope="module")
def video(tmp_path_factory) -> Path:
    """Twenty frames of 1920x1080, ten times the number as their grey level."""
    path = tmp_path_factory.mktemp("video") / "clip.avi"
    with video_writer(path, (1920, 1080), 30.0) as write:
        for number in range(20):
            write(np.full((1080, 1920, 3), 10 * number, np.uint8))
    return path


def tiles(path: Path) -> np.ndarray:
    """(rows, columns, height, width, 3)"""
    picture = cv2.imread(str(path))
    assert picture is not None
    rows, columns = len(picture) // HEIGHT, picture.shape[1] // WIDTH
    return picture[: rows * HEIGHT].reshape(rows, HEIGHT, columns, WIDTH, 3).swapaxes(1, 2)


def test_every_frame_has_a_tile_with_its_animal(folder, tmp_path):
    assert run_sheet(OverlaySettings(folder=folder, sheet=tmp_path / "sheet.png", count=20)) == 8
    found = tiles(tmp_path / "sheet.png")
    assert found.shape[:2] == (2, 4)
    for tile in found.reshape(8, HEIGHT, WIDTH, 3):
        drawn = np.argwhere((tile[60:-2, 2:-2].astype(int).max(axis=2) - np.max(PAPER)) > 60)
        assert np.ptp(drawn[:, 1]) > 0.7 * WIDTH  # large
        assert abs(drawn[:, 1].mean() - WIDTH / 2) < 0.15 * WIDTH


def test_rings_are_where_the_joints_were_seen(folder):
    """Of a pose whose joints are exactly where they were detected, rings lie on the skeleton."""
    overlay = overlay_of(Motion.load(folder))
    picture = draw_sheet(overlay, [0])
    xy = overlay.reprojected_px[0]
    low, high = np.nanmin(xy, axis=0), np.nanmax(xy, axis=0)
    scale = 0.8 * min(np.array(TILE_PX) / (high - low))
    paw = np.array(TILE_PX) / 2 + scale * (overlay.detected_px[0, 10] - (low + high) / 2)
    x, y = np.rint(paw).astype(int)
    around = picture[y - 8 : y + 9, x - 8 : x + 9].reshape(-1, 3)
    assert (np.abs(around.astype(int) - DETECTION).max(axis=1) < 60).any()
    assert (np.abs(picture.astype(int) - LEFT).max(axis=2) < 30).any()


def test_video_is_behind_each_of_them(folder, video, tmp_path):
    run_sheet(OverlaySettings(folder=folder, sheet=tmp_path / "sheet.png", video=video, count=3))
    found = tiles(tmp_path / "sheet.png")[0]
    levels = [float(np.median(tile[-40:-4])) for tile in found]
    np.testing.assert_allclose(levels, [100, 140, 170], atol=8)  # frames 10, 14 and 17


def test_video_that_is_too_short(folder, video, tmp_path):
    with pytest.raises(InputError, match=r"no frame 17"):
        run_sheet(OverlaySettings(folder=folder, sheet=tmp_path / "sheet.png", video=video, first_frame=-5, count=2))
    assert not (tmp_path / "sheet.png").exists()


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "--out: file: found nothing, expected the new video, or --sheet with a picture"),
        (("--out", "a.mp4"), "--video: file: found nothing, expected the video that the keypoints came from"),
        (("--sheet", "a.jpg"), "--sheet: file: found 'a.jpg', expected a file name that ends in .png"),
        (("--sheet", "a.png", "--count", "0"), "--count: found '0', expected a whole number from 1 to 60"),
    ],
)
def test_what_cannot_be_drawn(folder, arguments, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ended = run("overlay", folder, *arguments)
    assert ended.code == 2
    assert said in ended.err
    assert not any(tmp_path.iterdir())


def test_command(folder, tmp_path):
    sheet = tmp_path / "sheet.png"
    ended = run("overlay", folder, "--sheet", sheet, "--count", "5")
    assert (ended.code, ended.out) == (0, f"5 frames are in {sheet}.\n")
    assert run("overlay", folder, "--sheet", sheet).code == 2  # it is there
    assert run("overlay", folder, "--sheet", sheet, "--overwrite").code == 0
