"""Draw pictures of a calibration board as seen by a camera with known intrinsics.

The outlines of all dark areas are projected by `Camera.project`, filled on a finer grid, and averaged over each pixel.
No picture is warped, so the positions of the corners depend on the camera model alone.
"""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array
from recon.calibrate.boards import Board, Gray
from recon.geometry.camera import Camera

EDGE_PARTS = 8
FRACTION_BITS = 6
SIZE_PX = (800, 600)
_NORMAL = np.array([[640.0, 0, 408.0], [0, 641.5, 294.0], [0, 0, 1]])
_WIDE = np.array([[380.0, 0, 408.0], [0, 381.0, 294.0], [0, 0, 1]])
BOARD_CAMERAS = {
    "pinhole": Camera("cam", _NORMAL, np.zeros(0), "pinhole", SIZE_PX),
    "radtan": Camera("cam", _NORMAL, np.array([-0.3, 0.1, 0.001, -0.0007, -0.01]), "radtan", SIZE_PX),
    "fisheye": Camera("cam", _WIDE, np.array([0.03, -0.01, 0.004, -0.001]), "fisheye", SIZE_PX),
}
"""Cameras with known intrinsics, one for each lens model that can be calibrated from boards."""


def draw_board(
    board: Board,
    camera: Camera,
    rotation: Array,
    translation_m: Array,
    *,
    oversample: int = 8,
    blur_px: float = 0.0,
    noise: float = 0.0,
    rng: np.random.Generator | None = None,
) -> Gray:
    """Draw a board as seen by a camera, where X_camera = rotation X_board + translation_m.

    Parameters
    ----------
    board
        Board, as returned by `recon.calibrate.boards.parse_board`.
    camera
        Camera of any lens model, whose pose is ignored.
    rotation, translation_m
        Pose of the board in the camera's frame, (3, 3) and (3,).
    oversample
        Number of cells of the fine grid along each side of a pixel.
    blur_px
        Standard deviation of the Gaussian blur in pixels.
    noise
        Standard deviation of white noise, in grey levels from 0 to 255.
    rng
        Random generator of the noise.

    Returns
    -------
    Gray
        Grey levels (height, width), uint8.
    """
    width, height = camera.image_size_px
    image = np.full((height * oversample, width * oversample), 120, dtype=np.uint8)
    margin = board.square_m / np.linalg.norm(board.outline_m[0] - board.outline_m[1])
    centre = board.outline_m.mean(axis=0)
    sheet = centre + (1 + 2 * margin) * (board.outline_m - centre)
    for quads, grey in ((sheet[None], 225), (_dark_quads_m(board), 30)):
        fraction = np.linspace(0, 1, EDGE_PARTS, endpoint=False)[:, None]
        following = np.roll(quads, -1, axis=1)
        outlines = (quads[:, :, None] * (1 - fraction) + following[:, :, None] * fraction).reshape(len(quads), -1, 3)
        xy_px, valid = camera.project(outlines @ rotation.T + translation_m)
        # Pixel centres are at whole numbers in both grids.
        fine = ((xy_px + 0.5) * oversample - 0.5) * 2**FRACTION_BITS
        for outline in fine[np.asarray(valid.all(axis=1))]:
            if np.abs(outline).max() < 2**30:
                cv2.fillPoly(image, [np.rint(outline).astype(np.int32)], grey, shift=FRACTION_BITS)
    picture = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    if blur_px:
        picture = cv2.GaussianBlur(picture, (0, 0), blur_px)
    if noise:
        picture += (rng or np.random.default_rng(0)).normal(0.0, noise, picture.shape)
    return np.clip(np.rint(picture), 0, 255).astype(np.uint8)


def board_poses(
    board: Board, camera: Camera, count: int, rng: np.random.Generator, max_tilt_rad: float = 0.7, fill: float = 0.55
) -> list[tuple[Array, Array]]:
    """Draw poses of a hand-held board, tilted in all directions and spread over the whole picture.

    Parameters
    ----------
    board, camera
        Board, and camera that takes the pictures.
    count
        Number of poses.
    rng
        Random generator of the poses.
    max_tilt_rad
        Largest angle between the board and the image plane in rad.
    fill
        Fraction of the picture's height that a board in the middle of the picture fills.

    Returns
    -------
    list
        Rotations (3, 3) and translations (3,) in metres with which all corners are in the picture.
    """
    size = np.array(camera.image_size_px)
    poses = []
    while len(poses) < count:
        axis = rng.uniform(0, 2 * np.pi)
        tilt = rng.uniform(0.2, 1.0) * max_tilt_rad
        turn = Rotation.from_rotvec([0, 0, rng.normal(0, 0.2)])
        rotation = (Rotation.from_rotvec(tilt * np.array([np.cos(axis), np.sin(axis), 0])) * turn).as_matrix()
        ray, valid = camera.rays(rng.uniform(0.1, 0.9, 2) * (size - 1))
        extent = np.linalg.norm(board.outline_m[0] - board.outline_m[2])
        distance = extent * camera.matrix[1, 1] / (size[1] * fill) * rng.uniform(0.7, 1.4)
        if not valid:
            continue
        # Near the edge of a wide picture, the board has to be turned towards the camera.
        facing, _ = Rotation.align_vectors([ray], [[0.0, 0.0, 1.0]])
        rotation = facing.as_matrix() @ rotation
        translation = ray * distance - rotation @ board.outline_m.mean(axis=0)
        xy_px, seen = camera.project(board.points_m @ rotation.T + translation)
        if seen.all() and camera.in_image(xy_px - 4).all() and camera.in_image(xy_px + 4).all():
            poses.append((rotation, translation))
    return poses


@cache
def _dark_quads_m(board: Board) -> Array:
    """Return all dark areas of the board as quadrilaterals (Q, 4, 3) in metres."""
    return _dark_squares_m(board) if board.marker_m is None else _dark_of_charuco_m(board)


def _dark_squares_m(board: Board) -> Array:
    cells = [(x, y) for y in range(-1, board.rows) for x in range(-1, board.columns) if (x + y) % 2 == 0]
    return board.square_m * np.array([_unit_square(x, y) for x, y in cells])


def _dark_of_charuco_m(board: Board) -> Array:
    """Return the dark areas of a ChArUco board, which are squares without a marker and dark bits of markers."""
    assert board.marker_m is not None
    markers = np.asarray(board.charuco.getObjPoints(), dtype=float).reshape(-1, 4, 3)
    light = {tuple((m.mean(axis=0)[:2] / board.square_m).astype(int)) for m in markers}
    cells = [(x, y) for y in range(board.rows) for x in range(board.columns) if (x, y) not in light]
    quads = [board.square_m * _unit_square(x, y) for x, y in cells]
    dictionary = board.charuco.getDictionary()
    side = dictionary.markerSize + 2
    for marker, number in zip(markers, np.ravel(board.charuco.getIds()), strict=True):
        bits = dictionary.generateImageMarker(int(number), side)
        quads += [marker[0] + board.marker_m / side * _unit_square(x, y) for y, x in np.argwhere(bits == 0)]
    return np.array(quads)


def _unit_square(x: int, y: int) -> Array:
    return np.array([(x, y, 0.0), (x + 1, y, 0), (x + 1, y + 1, 0), (x, y + 1, 0)])
