"""Test the running median of arrays."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import median_filter

from recon.base.arrays import running_median


@pytest.mark.parametrize("shape", [(0, 2), (1, 2), (3, 2), (40,), (40, 2)])
@pytest.mark.parametrize("count", [5, 7])
def test_running_median_equals_scipy_also_at_the_ends(shape, count):
    values = np.random.default_rng(0).normal(size=shape).round(1)
    expected = median_filter(values, size=(count, *[1] * (len(shape) - 1)), mode="nearest")
    assert running_median(values, count).tolist() == expected.tolist()
