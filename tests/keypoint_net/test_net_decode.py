"""Test the points, likelihoods and losses that are computed from a network's scores."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from later import needs_torch, torch

from recon.keypoint_net.network import SIGMA, decode, loss, new_network, probabilities, variance

pytestmark = needs_torch


def gaussian_scores(xy: np.ndarray, size: tuple[int, int], sigma: float) -> Any:
    """Return scores (1, K, h, w) that are logarithms of Gaussians around points."""
    y, x = np.mgrid[: size[0], : size[1]]
    d2 = (x - xy[:, 0, None, None]) ** 2 + (y - xy[:, 1, None, None]) ** 2
    return torch.from_numpy(-0.5 * d2 / sigma**2).float()[None]


@pytest.mark.parametrize("sigma", [0.9, 1.5, 2.5])
def test_points_between_cells_are_found_exactly(sigma):
    xy = np.random.default_rng(0).uniform(5, 18, (40, 2))
    found, _ = decode(probabilities(gaussian_scores(xy, (24, 26), sigma)), 1.0)
    np.testing.assert_allclose(found[0].numpy(), xy, atol=2e-3)


def test_a_broad_peak_beats_a_sharp_peak_of_less_probability():
    broad = torch.exp(gaussian_scores(np.array([[6.0, 6.0]]), (16, 30), 1.5))
    probability = 0.9 * broad / broad.sum()
    probability[0, 0, 6, 24] += 0.1  # higher than any cell of the broad peak
    assert probability.flatten().argmax() == 6 * 30 + 24
    xy, within = decode(probability, 6.0)
    np.testing.assert_allclose(xy[0, 0].numpy(), [6, 6], atol=0.01)
    assert float(within) == pytest.approx(0.9, abs=0.01)


def test_the_raw_likelihood_is_the_probability_within_the_tolerance():
    # For a 2D Gaussian, the probability within the tolerance r is 1 - exp(-r^2 / 2 sigma^2).
    sigma, radius = 2.0, 3.0
    _, within = decode(probabilities(gaussian_scores(np.array([[20.3, 19.6]]), (40, 40), sigma)), radius)
    assert float(within) == pytest.approx(1 - math.exp(-0.5 * (radius / sigma) ** 2), abs=0.01)


def test_a_peak_in_a_corner_stays_in_the_picture():
    xy, within = decode(probabilities(gaussian_scores(np.array([[0.0, 0.0], [9.0, 7.0]]), (8, 10), 0.9)), 1.0)
    np.testing.assert_allclose(xy[0].numpy(), [[0, 0], [9, 7]], atol=0.01)
    assert (within > 0.2).all()


def test_the_loss_is_the_mean_cross_entropy_of_the_labelled_points():
    scores = torch.randn(2, 3, 6, 7, generator=torch.Generator().manual_seed(1))
    xy = torch.full((2, 3, 2), math.nan)
    xy[0, 0], xy[1, 2] = torch.tensor([2.0, 3.0]), torch.tensor([4.5, 1.25])
    by_hand = []
    for b, k in ((0, 0), (1, 2)):
        p = np.exp(scores[b, k].double().numpy())
        y, x = np.mgrid[:6, :7]
        aim = np.exp(-0.5 * ((x - float(xy[b, k, 0])) ** 2 + (y - float(xy[b, k, 1])) ** 2) / SIGMA**2)
        by_hand.append(-(aim / aim.sum() * np.log(p / p.sum())).sum())
    assert float(loss(scores, xy)) == pytest.approx(np.mean(by_hand), rel=1e-5)


def test_missing_labels_have_no_gradient():
    scores = torch.randn(2, 3, 6, 7, requires_grad=True)
    xy = torch.full((2, 3, 2), math.nan)
    xy[0, 1] = torch.tensor([2.0, 3.0])
    loss(scores, xy).backward()
    assert scores.grad is not None
    pulled = scores.grad.abs().sum(dim=(2, 3)) > 0
    assert pulled.tolist() == [[False, True, False], [False, False, False]]
    assert float(loss(scores.detach(), torch.full((2, 3, 2), math.nan))) == 0


@pytest.mark.parametrize(("keypoints", "height", "width"), [(1, 40, 64), (22, 53, 71)])
def test_any_number_of_keypoints_and_any_size_is_accepted(keypoints, height, width):
    network = new_network(keypoints, two_stages=False).eval()
    with torch.inference_mode():
        scores = network(torch.zeros(2, 6, height, width))
    assert scores.shape == (2, keypoints, -(-height // 4), -(-width // 4))


@pytest.mark.parametrize("keypoints", [1, 22, 200])
def test_the_network_is_small(keypoints):
    assert sum(p.numel() for p in new_network(keypoints, two_stages=False).parameters()) <= 3_000_000


def test_a_broad_probability_has_a_larger_variance():
    xy = np.array([[12.0, 12.0]])
    found = []
    for sigma in (0.9, 1.2, 1.5):
        probability = probabilities(gaussian_scores(xy, (24, 26), sigma))
        found.append(float(variance(probability, decode(probability, 1.0)[0])))
    np.testing.assert_allclose(found, [0.15**2 + sigma**2 - 0.9**2 for sigma in (0.9, 1.2, 1.5)], rtol=0.1)
    probability[0, 0] *= 0.5
    probability[0, 0, 0, 25] += 0.5  # a second, distant peak
    assert float(variance(probability, torch.tensor([[[12.0, 12.0]]]))) == pytest.approx(
        0.5 * (found[2] - 0.8) + 4, rel=0.05
    )


def test_points_outside_a_window_are_ignored():
    scores = gaussian_scores(np.array([[6.0, 6.0], [6.0, 6.0]]), (16, 30), 1.0)
    scores[0, :, 12, 24] = 50.0  # far more likely, but outside
    window = (torch.tensor([[[8.0, 5.0], [math.nan, math.nan]]]), 4.0)
    probability = probabilities(scores, window)
    xy, _ = decode(probability, 1.0)
    np.testing.assert_allclose(xy[0, 0].numpy(), [6, 6], atol=0.05)
    assert float(probability[0, 0, 12, 24]) == 0
    label = torch.tensor([[[6.2, 6.0], [math.nan, math.nan]]])
    assert float(loss(scores, label, window)) < 3 < float(loss(scores, label))
    inside = scores.clone().requires_grad_()
    loss(inside, label, window).backward()
    assert inside.grad is not None
    assert torch.isfinite(inside.grad).all()
    assert inside.grad[0, 0, 12, 24] == 0
    assert (inside.grad[0, 1] == 0).all()
