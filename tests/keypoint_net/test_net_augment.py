"""Test that the labels of augmented pictures stay at their pixels, and that the augmentation is repeatable."""

from __future__ import annotations

import numpy as np
import pytest

from recon.io.video import Image
from recon.keypoint_net.pictures import (
    Augmentation,
    Example,
    augment,
    background_of,
    make_batch,
    motion_blur,
    moving_mask,
)

SIZE = (96, 80)
GEOMETRY_ONLY = {"contrast": 0.0, "brightness": 0.0, "gamma": 0.0, "colour": 0.0, "light_patch": 0.0, "cutout": 0.0,
                 "blur": 0.0, "noise": 0.0}  # fmt: skip


def blobs(xy: np.ndarray, size: tuple[int, int] = SIZE) -> Image:
    """Draw a picture in which the k-th point is a blob of the k-th colour."""
    y, x = np.mgrid[: size[1], : size[0]]
    spots = [255 * np.exp(-0.5 * ((x - px) ** 2 + (y - py) ** 2) / 2.0**2) for px, py in xy]
    return np.stack([np.zeros_like(s) if np.isnan(s).any() else s for s in spots], axis=2).astype(np.uint8)


def example() -> Example:
    xy = np.array([[40.0, 30.0], [55.5, 42.0], [47.0, 50.25]])
    return Example(blobs(xy), None, None, xy, 30.0)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("partner", [None, (0, 2, 1)])
def test_labels_move_with_the_pixels(seed, partner):
    options = Augmentation(partner=partner, **GEOMETRY_ONLY)
    picture, _, xy = augment(example(), SIZE, options, np.random.default_rng(seed))
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    seen = 0
    # Blob 1 is green and blob 2 is red. In a mirrored picture, point 1 is the red blob.
    colour_of = [[0, 1, 2], [0, 2, 1]]
    errors = []
    for order in colour_of:
        found = []
        for k in range(3):
            weight = picture[..., order[k]].astype(float) ** 2
            inside = np.isfinite(xy[k]).all() and (xy[k] > 8).all() and (xy[k] < np.array(SIZE) - 9).all()
            if inside:
                near = weight * ((x - xy[k, 0]) ** 2 + (y - xy[k, 1]) ** 2 < 8**2)
                total = max(near.sum(), 1e-9)
                found.append(np.hypot((near * x).sum() / total - xy[k, 0], (near * y).sum() / total - xy[k, 1]))
                seen += 1
        errors.append(max(found, default=0.0))
    assert min(errors) < 0.35
    assert seen


def test_mirroring_exchanges_left_and_right_names():
    options = Augmentation(partner=(0, 2, 1), rotation_deg=1e-9, scale=(1.0, 1.0), stretch=0.0, **GEOMETRY_ONLY)
    for seed in range(8):
        _, _, xy = augment(example(), (400, 300), options, np.random.default_rng(seed))
        a, b = example().xy_px[1] - example().xy_px[0], example().xy_px[2] - example().xy_px[0]
        expected = (a, b) if xy[1, 0] - xy[0, 0] > 0 else (b * [-1, 1], a * [-1, 1])
        np.testing.assert_allclose(np.stack([xy[1] - xy[0], xy[2] - xy[0]]), expected, atol=1e-6)


def test_points_outside_the_picture_are_missing():
    options = Augmentation(scale=(3.0, 3.0), **GEOMETRY_ONLY)
    outside = 0
    for seed in range(20):
        _, _, xy = augment(example(), (48, 40), options, np.random.default_rng(seed))
        known = np.isfinite(xy).all(axis=1)
        outside += int((~known).sum())
        assert ((xy[known] >= 0) & (xy[known] <= [47, 39])).all()
    assert outside > 5


def test_missing_labels_stay_missing():
    gone = example()
    gone.xy_px[1] = np.nan
    for seed in range(5):
        _, _, xy = augment(gone, (300, 300), Augmentation(partner=(0, 2, 1)), np.random.default_rng(seed))
        assert int(np.isnan(xy).all(axis=1).sum()) == 1


def test_a_batch_depends_on_seed_and_step_only():
    pool = np.arange(1)
    one, again, other = (make_batch([example()], SIZE, Augmentation(), 3, 4, step, pool) for step in (7, 7, 8))
    np.testing.assert_array_equal(one[0], again[0])
    np.testing.assert_array_equal(one[2], again[2])
    assert not np.array_equal(one[0], other[0])


def test_motion_blur_keeps_brightness_and_position():
    picture = blobs(np.array([[48.0, 40.0]] * 3))
    blurred = motion_blur(picture, 9.0, 0.3)
    assert float(blurred.sum()) == pytest.approx(float(picture.sum()), rel=0.03)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    weight = blurred[..., 0].astype(float)
    assert (weight * x).sum() / weight.sum() == pytest.approx(48, abs=0.1)
    spread = ((weight * (x - 48) ** 2).sum() / weight.sum(), (weight * (y - 40) ** 2).sum() / weight.sum())
    # A line of length L adds L^2 / 12 along it.
    assert spread[0] == pytest.approx(4 + 81 / 12 * np.cos(0.3) ** 2, rel=0.15)
    assert spread[1] == pytest.approx(4 + 81 / 12 * np.sin(0.3) ** 2, rel=0.15)


def walk(moving_camera: bool = False) -> tuple[list[Image], Image, np.ndarray]:
    """Draw a dark square that crosses a textured scene.

    Returns
    -------
    tuple
        The frames, the scene without the square, and the left edge of the square in each frame, pixels.
    """
    rng = np.random.default_rng(2)
    scene = np.repeat(rng.integers(120, 220, (60, 200, 1)), 3, axis=2).astype(np.uint8)
    left = np.arange(0, 60, 3)
    pictures = []
    for i, x in enumerate(left):
        picture = scene[:, (5 * i if moving_camera else 0) :][:, :90].copy()
        picture[20:40, x : x + 15] = 10
        pictures.append(picture)
    return pictures, scene[:, :90], left


def test_the_background_of_a_still_camera_is_the_scene():
    pictures, scene, _ = walk()
    found = background_of(pictures)
    assert found is not None
    np.testing.assert_array_equal(found, scene)
    assert background_of(walk(moving_camera=True)[0]) is None
    assert background_of(pictures[:3]) is None


def test_the_mask_covers_moving_pixels_near_the_labels():
    pictures, scene, left = walk()
    x = left[9]
    other = pictures[9].copy()
    other[5:15, 70:85] = 10  # something else that moves
    corners = np.array([[x, 20], [x + 14, 20], [x, 39], [x + 14, 39]], float)
    mask = moving_mask(other, scene, corners, 4.0) > 127
    expected = np.zeros_like(mask)
    expected[20:40, x : x + 15] = True
    assert not mask[5:15, 70:85].any()
    assert (mask & expected).sum() == expected.sum()
    assert mask.sum() < 1.35 * expected.sum()


def test_pasting_puts_the_animal_on_its_own_background():
    pictures, scene, left = walk()
    corners = np.array([[left[9], 20], [left[9] + 14, 20], [left[9], 39], [left[9] + 14, 39]], float)
    mask = moving_mask(pictures[9], scene, corners, 4.0)
    options = Augmentation(paste=1.0, scale=(1.0, 1.0), rotation_deg=1e-9, stretch=0.0, **GEOMETRY_ONLY)
    picture, background, xy = augment(
        Example(pictures[9], scene, mask, corners, 24.0), (90, 60), options, np.random.default_rng(1)
    )
    assert background is not None
    x, y = xy[np.isfinite(xy).all(axis=1)].mean(axis=0).round().astype(int)
    assert picture[y, x].max() < 40  # the animal
    away = np.abs(picture.astype(int) - background).max(axis=2) > 3
    assert 0.5 * 300 < away.sum() < 2 * 300  # the new background around the animal is unchanged
