"""Test numbers with units and intervals in sentences."""

from __future__ import annotations

import pytest

from recon.base.numbers import decimals, interval, length_text, percent, plus_minus


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


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (12.34, "12.3"),
        (1.0, "1.0"),
        (0.076, "0.08"),
        (-0.4, "-0.40"),
        (0.0, "0.00"),
        (-0.0047, "-0.005"),
    ],
)
def test_a_small_speed_has_a_digit_that_is_not_zero(value, text):
    assert f"{value:{decimals(value)}}" == text


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (6.42, 0.68, "6.4 ± 0.7 m/s"),
        (6.42, 0.14, "6.42 ± 0.14 m/s"),
        (15.04, 2.04, "15 ± 2 m/s"),
        (1234.0, 290.0, "1200 ± 300 m/s"),
        (0.5, 0.0, "0.50 m/s"),
        (0.5, float("nan"), "0.50 m/s"),
        (-0.0004, 0.1, "0.00 ± 0.10 m/s"),
    ],
)
def test_a_number_has_the_digits_that_its_uncertainty_supports(value, sigma, text):
    assert plus_minus(value, sigma, "m/s") == text


def test_intervals_have_their_unit_once():
    assert interval(72.4, 48.2, 105.9, "mm") == "72 mm (48 to 106)"
    assert interval(16.21, 14.2, 18.1, "m/s", level="90 %") == "16.2 m/s (90 %: 14.2 to 18.1)"
    assert interval(3.0, -1.0, 7.0, "m/s", least=0.0) == "3 m/s (at most 7)"
    assert interval(3.0, float("nan"), float("nan"), "m/s") == "3.0 m/s"


@pytest.mark.parametrize(("share", "text"), [(0.846, "85 %"), (0.0, "0 %"), (0.0031, "0.3 %"), (1.0, "100 %")])
def test_a_space_stands_before_the_sign_of_percent(share, text):
    assert percent(share) == text
