"""Test numbers with units in texts and figures."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import recon
from recon.base.numbers import quantity, rough_length

BY_HAND = re.compile(r"\{[^{}]*:\.\df\} ?(?:m/s|mm|px|m|s|Hz|°)(?![\w/²])")
"""Pattern of an f-string in which a formatted number is followed by a unit."""


@pytest.mark.parametrize(
    ("value", "digits", "unit", "text"),
    [(1.06, 1, "px", "1.1 px"), (-0.04, 1, "m", "0.0 m"), (12.6, 0, "°", "13°"), (float("nan"), 1, "s", "nan s")],
)
def test_a_quantity_has_its_digits_and_its_unit(value, digits, unit, text):
    assert quantity(value, digits, unit) == text


@pytest.mark.parametrize(
    ("length_m", "text"),
    [
        (0.0, "0 mm"),
        (0.0084, "8 mm"),
        (0.047, "47 mm"),
        (0.468, "0.47 m"),
        (4.66, "4.7 m"),
        (12.3, "12 m"),
        (123, "120 m"),
    ],
)
def test_a_rough_length_has_at_most_two_digits(length_m, text):
    assert rough_length(length_m) == text


def test_no_text_formats_a_number_with_a_unit_by_hand():
    folder = Path(recon.__file__).parent
    lines = [
        f"{path.name}: {line.strip()}"
        for room in ("show", "api", "cli")
        for path in (folder / room).rglob("*.py")
        for line in path.read_text(encoding="utf-8").splitlines()
        if BY_HAND.search(line)
    ]
    assert lines == []
