"""Test that the true positions of the rendered video agree with its pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recon.io.formats import read_keypoints
from recon.io.video import probe, read_frames
from recon.keypoint_net.labels import read_labels
from recon.testing.cameras import panning_camera
from recon.testing.film import draw_scene, film_clip, panning_film, render_frames

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "samples"


def test_the_film_agrees_with_its_files():
    info = probe(SAMPLES / "rendered.mp4")
    assert (info.size_px, info.fps) == ((640, 360), 120)
    truth = read_keypoints(SAMPLES / "rendered_points.csv")
    labels = read_labels(SAMPLES / "rendered.mp4", SAMPLES / "rendered_labels.csv")
    assert len(labels.images) == 40
    rows = np.searchsorted(truth.frames, labels.numbers)
    np.testing.assert_allclose(labels.xy_px, truth.xy_px[rows][:, [truth.names.index(n) for n in labels.names]])


def test_the_animal_is_drawn_at_its_points():
    """Pixels that differ from the film's median have the same centre as the animal's points."""
    truth = read_keypoints(SAMPLES / "rendered_points.csv")
    pictures = [picture.astype(float) for _, picture in read_frames(SAMPLES / "rendered.mp4", 5, None, 10)]
    still = np.median(pictures, axis=0)
    for picture, points in zip(pictures, truth.xy_px[5::10], strict=True):
        y, x = np.nonzero(np.abs(picture - still).max(axis=2) > 50)
        low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
        near = (x > low[0] - 15) & (x < high[0] + 15) & (y > low[1] - 15) & (y < high[1] + 15)
        assert near.mean() > 0.8
        assert abs(np.median(x[near]) - np.nanmedian(points[:, 0])) < 12
        assert abs(np.median(y[near]) - np.nanmedian(points[:, 1])) < 10


def test_the_script_draws_the_film_again():
    """The script draws the film's first frames again, up to differences between encoders."""
    clip, ground_m = film_clip()
    drawn = next(iter(render_frames(clip.truth_m, clip.names, lambda t: clip.camera, ground_m)))
    _, stored = next(iter(read_frames(SAMPLES / "rendered.mp4")))
    assert np.abs(drawn.astype(float) - stored).mean() < 4


@pytest.mark.slow
def test_the_panning_film_shows_the_same_animal():
    """The points of the panning film are the true positions projected into the cameras of the track."""
    still, ground_m = film_clip()
    camera_at = panning_camera(still)
    pan = panning_film(still, camera_at)
    xy_px, (width, height) = pan.clip.keypoints.xy_px, pan.clip.camera.image_size_px
    assert pan.tilt_deg == pytest.approx(np.degrees(np.arcsin(0.95 / np.hypot(11.5, 0.95))), abs=0.1)
    seen, _ = pan.clip.camera.project(np.einsum("tij,tkj->tki", pan.rotations, pan.clip.truth_m))
    np.testing.assert_allclose(xy_px, seen)
    assert np.abs(xy_px.mean(axis=1) - [width / 2, height / 2]).max() < 60
    turned = np.degrees(np.arccos(np.einsum("j,j->", pan.rotations[0, 2], pan.rotations[-1, 2])))
    assert 40 < turned < 60
    drawn = next(render_frames(still.truth_m[40:42], still.names, lambda t: camera_at(40 + t), ground_m)).astype(float)
    without = draw_scene(camera_at(40), ground_m, np.random.default_rng(0))
    # below the shrubs, which the camera's rotation blurs
    y, x = np.nonzero(np.abs(drawn - without).max(axis=2)[150:] > 60)
    y += 150
    near = (np.abs(np.stack([x, y], axis=1) - xy_px[40].mean(axis=0)) < [70, 50]).all(axis=1)
    assert near.mean() > 0.8
    np.testing.assert_allclose([np.median(x[near]), np.median(y[near])], np.median(xy_px[40], axis=0), atol=12)
