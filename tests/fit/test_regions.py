import numpy as np
import pytest

from recon.fit.regions import DEGREES_OF_FREEDOM, radius, sigmas
from recon.testing.coverage import coverage, cumulative


def test_intervals_follow_students_t_with_the_stated_variance():
    from scipy.stats import chi2, t  # slow to import

    for level in (0.5, 0.9, 0.99):
        scaled = float(t.ppf((1 + level) / 2, DEGREES_OF_FREEDOM) / t.std(DEGREES_OF_FREEDOM))
        assert radius(level) == pytest.approx(scaled)
        assert cumulative(scaled) - cumulative(-scaled) == pytest.approx(level)
    # The tails are heavier than a Gaussian's, so the 90 % radius is a little larger and the 50 % radius smaller.
    assert 1.0 < radius(0.9, 3) / np.sqrt(chi2.ppf(0.9, 3)) < 1.05
    assert 0.85 < radius(0.5, 3) / np.sqrt(chi2.ppf(0.5, 3)) < 0.95


def test_regions_contain_the_stated_fraction_of_errors():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(3, 3))
    scale = np.sqrt((DEGREES_OF_FREEDOM - 2) / rng.chisquare(DEGREES_OF_FREEDOM, 40_000))
    errors = scale[:, None] * (rng.normal(size=(40_000, 3)) @ root.T)
    covariance = np.broadcast_to(root @ root.T, (40_000, 3, 3))
    assert np.cov(errors.T) == pytest.approx(root @ root.T, rel=0.1, abs=0.05)
    for level in (0.5, 0.9):
        assert coverage(errors, covariance, level) == pytest.approx(level, abs=0.01)
    x = sigmas(errors[:, :1], covariance[:, :1, :1])
    assert np.mean(x < radius(0.9)) == pytest.approx(0.9, abs=0.01)


def test_unknown_errors_do_not_count():
    errors, covariance = np.zeros((3, 2)), np.stack([np.eye(2)] * 3)
    errors[0], errors[1, 0], covariance[2] = 0.1, np.nan, np.nan
    assert np.isfinite(sigmas(errors, covariance)).tolist() == [True, False, False]
    assert coverage(errors, covariance, 0.5) == 1.0
    assert np.isnan(coverage(errors[1:], covariance[1:], 0.5))
