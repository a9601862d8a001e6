"""Calibrate from boards that were rendered through a known camera, and measure the errors of the result.

python benchmarks/parts/calibration.py
"""

from __future__ import annotations

import time

import numpy as np

from recon.calibrate.board_calibration import Calibration, calibrate, check
from recon.calibrate.boards import BoardView, BoardViews, parse_board
from recon.geometry.camera import Camera
from recon.testing.boards import board_poses, draw_board

SIZE = (1280, 720)
VIEWS = 24
BOARDS = ("chessboard:9x6:25mm", "charuco:9x6:30mm:22mm:DICT_4X4_50")
SEEDS = (1, 2, 3)


def cameras() -> list[Camera]:
    """Return cameras with three lenses: ideal, with barrel distortion, and of an action camera, 118 degrees wide."""
    matrix = np.array([[1024.0, 0, 655.3], [0, 1026.5, 351.8], [0, 0, 1]])
    wide = np.array([[620.0, 0, 655.3], [0, 621.5, 351.8], [0, 0, 1]])
    return [
        Camera("pinhole", matrix, np.zeros(0), "pinhole", SIZE),
        Camera("radtan", matrix, np.array([-0.25, 0.08, 0.001, -0.0007, -0.01]), "radtan", SIZE),
        Camera("fisheye", wide, np.array([0.03, -0.01, 0.004, -0.001]), "fisheye", SIZE),
    ]


def views_of(board_text: str, camera: Camera, count: int, rng: np.random.Generator) -> BoardViews:
    """Render pictures of a board through the camera, with blur and noise, and detect the board in them."""
    board = parse_board(board_text)
    views, without = [], []
    for number, (rotation, translation) in enumerate(board_poses(board, camera, count, rng, fill=0.6)):
        image = draw_board(board, camera, rotation, translation, oversample=6, blur_px=0.6, noise=2.0, rng=rng)
        corners = board.detect(image)
        if corners is None:
            without.append(str(number))
        else:
            views.append(BoardView(str(number), *corners))
    return BoardViews(board, camera.image_size_px, tuple(views), tuple(without), len(views))


def worst_px(calibration: Calibration, truth: Camera) -> float:
    """Return the largest distance (px) between the projections of a ray by the calibrated and the true camera."""
    width, height = truth.image_size_px
    y, x = np.mgrid[0 : height - 1 : 31j, 0 : width - 1 : 31j]
    pixels = np.stack((x, y), axis=-1)
    rays, valid = truth.rays(pixels)
    found, seen = calibration.camera.project(rays)
    return float(np.linalg.norm(found - pixels, axis=-1)[valid & seen].max())


def main() -> None:
    print("| lens | board | seed | found in | rms px | fx true | fx found | error % | fy error % | cx error % "
          "| cy error % | worst px in the picture | refused | time s |")  # fmt: skip
    print("| --- | --- |" + " ---: |" * 12)
    for camera in cameras():
        for text in BOARDS:
            for seed in SEEDS:
                views = views_of(text, camera, VIEWS, np.random.default_rng(seed))
                start = time.perf_counter()
                found = calibrate(views, camera.model)
                seconds = time.perf_counter() - start
                k, truth = found.camera.matrix, camera.matrix
                off = [100 * (k[i] / truth[i] - 1) for i in ((0, 0), (1, 1), (0, 2), (1, 2))]
                refused = ", ".join(c.name for c in check(found) if c.verdict == "refused") or "-"
                print(
                    f"| {camera.model} | {text.split(':')[0]} | {seed} | {views.with_board} of {views.examined} "
                    f"| {found.rms_px:.3f} | {truth[0, 0]:.1f} | {k[0, 0]:.2f} | "
                    + " | ".join(f"{value:+.3f}" for value in off)
                    + f" | {worst_px(found, camera):.2f} | {refused} | {seconds:.2f} |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
