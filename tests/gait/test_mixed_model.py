"""Test the mixed model of animals, runs and strides, and the plan of an experiment."""

from __future__ import annotations

import numpy as np
import pytest

from recon.gait.mixed_model import LevelSigmas, animals_needed, fit_mixed_model, power

TRUE = LevelSigmas(animal=0.30, run=0.20, stride=0.25, measurement=0.15)


def test_components_and_effect_of_a_simulated_herd():
    rng = np.random.default_rng(3)
    animals, runs, values, groups = [], [], [], []
    for k in range(60):
        animal = 4.0 + 0.5 * (k % 2) + rng.normal(0, TRUE.animal)
        for j in range(3):
            run = animal + rng.normal(0, np.hypot(TRUE.run, TRUE.measurement))
            values += [*(run + rng.normal(0, TRUE.stride, 4))]
            animals += [f"animal {k}"] * 4
            runs += [f"run {j}"] * 4
            groups += [k % 2] * 4
    design = np.column_stack([np.ones(len(values)), groups])
    known = np.full(len(values), TRUE.measurement)
    model = fit_mixed_model(np.array(values), design, ("all", "group"), animals, runs, known)
    assert (model.animals, model.runs, model.strides) == (60, 180, 720)
    for level in ("animal", "run", "stride"):
        assert getattr(model.sigmas, level) == pytest.approx(getattr(TRUE, level), rel=0.25)
    assert model.sigmas.measurement == pytest.approx(0.15)
    value, sigma, low, high = model.contrast(np.array([0.0, 1.0]))
    assert low < 0.5 < high
    assert sigma == pytest.approx(np.sqrt(2 * TRUE.variance_of_mean(3, 4) / 30), rel=0.25)
    # An error that all clips share does not average out over the animals.
    assert model.contrast(np.array([0.0, 1.0]), 0.5)[1] == pytest.approx(np.hypot(sigma, 0.5 * value))


@pytest.mark.parametrize("animals", [10, 60])
def test_the_interval_of_a_balanced_herd_follows_from_the_animals_means(animals: int):
    from scipy.stats import ttest_ind  # slow to import

    rng = np.random.default_rng(animals)
    of_animals = rng.normal(4, 0.3, animals)[:, None, None] + rng.normal(0, 0.2, (animals, 2, 1))
    values = of_animals + rng.normal(0, 0.25, (animals, 2, 6))
    names = [str(animal) for animal in range(animals) for _ in range(12)]
    runs = [run for _ in range(animals) for run in ("1", "2") for _ in range(6)]
    groups = np.repeat(np.arange(animals) % 2, 12)
    design = np.stack([np.ones(12 * animals), groups.astype(float)], axis=1)
    model = fit_mixed_model(values.ravel(), design, ("all", "group"), names, runs, np.full(12 * animals, 0.1))
    means = values.mean(axis=(1, 2))
    expected = ttest_ind(means[1::2], means[::2]).confidence_interval(0.9)
    assert model.contrast([0, 1])[2:] == pytest.approx((expected.low, expected.high), abs=1e-4)


def test_power_increases_with_animals_and_cameras():
    assert TRUE.icc == pytest.approx(0.09 / (0.09 + 0.04 + 0.0625 + 0.0225))
    assert TRUE.detectable_change(4) == pytest.approx(1.96 * np.sqrt(2 * (0.04 + 0.0225 + 0.0625 / 4)))
    needed = animals_needed(0.5, TRUE, runs=2, strides=6)
    assert needed is not None
    assert power(0.5, TRUE, needed, 2, 6) >= 0.8 > power(0.5, TRUE, needed - 1, 2, 6)
    assert power(0.5, TRUE, 8, 2, 6, cameras=4) > power(0.5, TRUE, 8, 2, 6)
    assert power(0.0, TRUE, 8, 2, 6) == pytest.approx(0.05)
    assert animals_needed(1e-4, TRUE, 1, 1) is None
