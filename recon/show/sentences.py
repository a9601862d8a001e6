"""State the result of a clip in a few sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator

from recon.base.arrays import median
from recon.base.numbers import decimals, length_text, percent, percent_range
from recon.fit.motion import Motion
from recon.gait.dynamics import G_M_S2
from recon.gait.gait import Gait, interval_text
from recon.gait.kinematics import JointKinematics


def result_sentences(
    motion: Motion, reference: JointKinematics, gait: Gait | None, why_no_speed: str | None
) -> Iterator[str]:
    """Yield the movement of the reference joint and the gait.

    why_no_speed: reason why no speed is known, or None.
    """
    yield _speed_sentence(motion, reference, why_no_speed)
    if gait is None:
        yield "The skeleton has no feet: no gait."
        return
    yield f"Gait: {gait.name.name} ({gait.name.criterion})."
    if gait.strides:
        yield from _stride_sentences(gait)


def _speed_sentence(motion: Motion, reference: JointKinematics, why_no_speed: str | None) -> str:
    if why_no_speed is not None:
        run_m_s = motion.solution.constant_velocity_m_s
        speed = "" if run_m_s is None else f"{median(run_m_s[run_m_s > 0]):.1f} m/s"
        run = speed and f" A straight run through all frames has {speed}."
        return f"The animal's path is too uncertain in depth for a speed: {why_no_speed}.{run}"
    peak_m_s, sigma_m_s, path_m = reference.peak_speed_m_s, reference.peak_speed_sigma_m_s, reference.distance_m
    form = decimals(peak_m_s)
    # A peak below its own standard deviation is unknown.
    peak = "" if sigma_m_s > peak_m_s else f" and at most {interval_text(peak_m_s, sigma_m_s, 'm/s')}"
    mean_text = f"{reference.mean_speed_m_s:{form}} m/s on average"
    return f"The animal moved {path_m:{decimals(path_m)}} m, at {mean_text}{peak}."


def _stride_sentences(gait: Gait) -> Iterator[str]:
    low, high = gait.name.duty_interval
    yield (
        f"Strides are {length_text(gait.stride_length_m)} long, {gait.stride_frequency_hz:.2f} a second (average "
        f"of the feet's {len(gait.strides)} strides); a foot stands {percent(gait.name.duty_factor)} of the time "
        f"(90 %: {percent_range(low, high)})."
    )
    lasts_s, swing_s = 1 / gait.stride_frequency_hz, 2 * math.pi * math.sqrt(gait.tracks.leg_m / 1.5 / G_M_S2)
    if lasts_s > swing_s:
        yield (
            f"Strides last {lasts_s:.1f} s, longer than a leg of this length swings to and fro by itself "
            f"({swing_s:.1f} s): the video may be in slow motion. Check --fps."
        )
