"""Numbers in sentences."""

from __future__ import annotations

import pytest

from recon.base import decimals, length_text


@pytest.mark.parametrize(
    ("length_m", "sigma_m", "text"),
    [
        (1.234, None, "1.23 m"),
        (0.0312, 0.004, "31 ± 4 mm"),
        (12.0, 0.05, "12.00 ± 0.05 m"),
        (-0.82, 0.004, "-0.820 ± 0.004 m"),
        (-0.05, None, "-50 mm"),
    ],
)
def test_lengths_of_small_animals_are_in_millimetres(length_m, sigma_m, text):
    assert length_text(length_m, sigma_m) == text


@pytest.mark.parametrize(("value", "text"), [(12.34, "12.3"), (1.0, "1.0"), (0.076, "0.08"), (-0.4, "-0.40")])
def test_speeds_of_small_animals_have_two_decimals(value, text):
    assert f"{value:{decimals(value)}}" == text
