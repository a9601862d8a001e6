"""Format numbers with their uncertainty and unit, in the same way in every text and figure.

A number has as many decimals as its uncertainty. An uncertainty has one significant digit, or two if the first is 1.
The ends of an interval are rounded like its half width, which has two significant digits if they are 35 or less.
"""

from __future__ import annotations

import math

SHORT_M = 0.1
"""Length, in metres, below which lengths are given in millimetres, because a mouse's bones would be 0.00 m long."""
NORMAL_90 = 1.645
"""Number of standard deviations on either side that contain 90 % of a normal distribution."""
_ONE_DIGIT = 1.95
"""Leading digits of an uncertainty, 1 to 10, above which one significant digit is enough.

One digit then stands for a range such as 1.95 to 2.5, which is narrow enough.
"""
_ONE_DIGIT_OF_INTERVAL = 3.55
"""Leading digits of an interval's half width, 1 to 10, above which one significant digit is enough."""


def decimals(value: float) -> str:
    """Return the format specification of a number whose uncertainty is unknown.

    Numbers have one decimal, two decimals below 1, and one significant digit below 0.01.
    """
    if 0 < abs(value) < 0.01:
        return f".{-math.floor(math.log10(abs(value)))}f"
    return ".1f" if abs(value) >= 1 else ".2f"


def places(sigma: float, one_digit: float = _ONE_DIGIT) -> int | None:
    """Return the number of decimals that an uncertainty supports, negative for tens; None if it is unknown or 0.

    `one_digit` is the value of the leading digits, from 1 to 10, above which one digit is enough.
    """
    if not (math.isfinite(sigma) and sigma > 0):
        return None
    power = math.floor(math.log10(sigma))
    return (1 if sigma / 10.0**power < one_digit else 0) - power


def rounded(value: float, digits: int, sign: str = "") -> str:
    """Return a value as text with `digits` decimals, or rounded to tens, hundreds and so on for negative `digits`."""
    text = f"{round(value, digits):{sign}.{max(digits, 0)}f}"
    is_minus_zero = text.startswith("-") and not any(digit in "123456789" for digit in text)
    return text[1:] if is_minus_zero else text


def plus_minus(value: float, sigma: float | None, unit: str = "", sign: str = "", default: str = "") -> str:
    """Return a value with its uncertainty and unit, such as "6.4 ± 0.7 m/s".

    If the uncertainty is unknown or 0, only the value is returned, in the format `default`. If `sign` is "+", positive
    values have a sign.
    """
    digits = None if sigma is None else places(sigma)
    if digits is None or sigma is None:
        return f"{value:{sign}{default or decimals(value)}}{_unit(unit)}"
    return f"{rounded(value, digits, sign)} ± {rounded(sigma, digits)}{_unit(unit)}"


def quantity(value: float, digits: int, unit: str) -> str:
    """Return a value without its uncertainty, with `digits` decimals and its unit, such as "1.1 px"."""
    return f"{rounded(value, digits)}{_unit(unit)}"


def interval(
    value: float,
    low: float,
    high: float,
    unit: str = "",
    *,
    level: str = "",
    sign: str = "",
    least: float = -math.inf,
    remark: str = "",
) -> str:
    """Return a value with the ends of its interval, such as "72 mm (48 to 106)".

    `level` is the interval's confidence level, as in "16.2 m/s (90 %: 14.2 to 18.1)". `least` is the smallest possible
    value. An interval that begins there is written as "at most" its upper end. `remark` follows the ends within the
    brackets. Without an interval only the value is returned.
    """
    digits = places((high - low) / 2, _ONE_DIGIT_OF_INTERVAL)
    if digits is None:
        return f"{value:{sign}{decimals(value)}}{_unit(unit)}"
    low_text, high_text = rounded(low, digits, sign), rounded(high, digits, sign)
    ends = f"{low_text} to {high_text}" if low > least else f"at most {high_text}"
    return f"{rounded(value, digits, sign)}{_unit(unit)} ({level and level + ': '}{ends}{remark})"


def percent(share: float) -> str:
    """Return a fraction in percent, such as "85 %", or "0.3 %" with one significant digit below one percent."""
    value = 100.0 * share
    return f"{value:.0f} %" if abs(value) >= 1 or value == 0 else f"{value:.1g} %"


def percent_range(low: float, high: float) -> str:
    """Return the ends of an interval in percent, such as "28 to 35 %"."""
    return f"{100 * low:.0f} to {100 * high:.0f} %"


def length_text(length_m: float, sigma_m: float | None = None) -> str:
    """Return a length with its uncertainty in a suitable unit: 1.23 m, 1.23 ± 0.04 m, 1.230 ± 0.004 m, 56 mm."""
    scale, unit, default = (1e3, "mm", ".0f") if abs(length_m) < SHORT_M else (1.0, "m", ".2f")
    sigma = None if sigma_m is None else scale * sigma_m
    return plus_minus(scale * length_m, sigma, unit, default=default)


def rough_length(length_m: float) -> str:
    """Return a length that is known only roughly, with at most two digits: 8 mm, 0.47 m, 4.7 m, 12 m."""
    scale, unit = (1e3, "mm") if abs(length_m) < SHORT_M else (1.0, "m")
    scaled = scale * length_m
    digits = 0 if unit == "mm" else 1 - math.floor(math.log10(abs(length_m)))
    return quantity(scaled, digits, unit)


def counted(count: int, noun: str) -> str:
    """Return a count with its noun, such as "1 clip" or "2 clips"."""
    return f"{count} {noun}{'s' * (count != 1)}"


def _unit(unit: str) -> str:
    return unit if unit in ("", "°") else f" {unit}"
