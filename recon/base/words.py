"""Numbers as sentences have them."""

from __future__ import annotations

SHORT_M = 0.1
"""Lengths below it are in millimetres: those of a mouse are 0.00 m otherwise."""


def decimals(value: float) -> str:
    """The format of a speed or a path: one decimal, and two where it is below 1, as of a mouse: 12.3, 0.07."""
    return ".1f" if abs(value) >= 1 else ".2f"


def length_text(length_m: float, sigma_m: float | None = None) -> str:
    """As in 1.23 m, 1.23 ± 0.04 m, 1.230 ± 0.004 m, 56 mm."""
    fine = sigma_m is not None and sigma_m < 0.005
    scale, unit, form = (1e3, "mm", ".0f") if abs(length_m) < SHORT_M else (1.0, "m", ".3f" if fine else ".2f")
    values = [format(scale * value, form) for value in (length_m, sigma_m) if value is not None]
    return f"{' ± '.join(values)} {unit}"
