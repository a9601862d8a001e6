"""State the result of a clip in a few sentences."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping

from recon.base.arrays import median
from recon.base.numbers import counted, decimals, interval, length_text, percent, percent_range, quantity
from recon.fit.motion import Motion
from recon.gait.clip import ClipAnalysis
from recon.gait.dynamics import G_M_S2
from recon.gait.gait import Gait
from recon.gait.kinematics import JointKinematics
from recon.gait.quantities import GaitQuantity
from recon.gait.stances import interval_text

NO_QUANTITIES: Mapping[str, GaitQuantity] = {}


def analysis_sentences(analysis: ClipAnalysis) -> Iterator[str]:
    """Yield sentences that state speed, path and gait of an analysed clip with 90 % intervals."""
    yield from result_sentences(
        analysis.motion, analysis.reference_motion, analysis.gait, analysis.why_no_speed, analysis.quantities
    )


def result_sentences(
    motion: Motion,
    reference: JointKinematics,
    gait: Gait | None,
    why_no_speed: str | None,
    quantities: Mapping[str, GaitQuantity] = NO_QUANTITIES,
) -> Iterator[str]:
    """Yield sentences that state the movement of the reference joint and the gait of a motion.

    `why_no_speed` is the reason why no speed is known, or None. `quantities` are the gait's quantities with 90 %
    intervals.
    """
    yield _speed_sentence(motion, reference, why_no_speed, quantities)
    if gait is None:
        yield "The skeleton has no feet, so no gait was found."
        return
    yield f"Gait: {gait.name.name} ({gait.name.criterion})."
    if gait.strides:
        yield from _stride_sentences(gait, quantities)
    elif (length := quantities.get("stride_length_m")) is not None and math.isfinite(length.value):
        frequency, period = quantities["stride_frequency_hz"], quantities["stride_s"]
        if period.value > gait.tracks.time_s[-1] - gait.tracks.time_s[0]:
            yield f"The clip is shorter than a stride: the motion would repeat after {quantity_text(period, 's')}."
            return
        yield (
            "From the period of the motion, strides are "
            f"{quantity_text(length, 'm')} long, {quantity_text(frequency, 'Hz')}."
        )


def quantity_text(measure: GaitQuantity, unit: str) -> str:
    """Format a quantity with its 90 % interval and its unit."""
    low, high = measure.interval
    return interval(measure.value, low, high, unit, level="90 %", least=measure.bounds[0])


def _speed_sentence(
    motion: Motion, reference: JointKinematics, why_no_speed: str | None, quantities: Mapping[str, GaitQuantity]
) -> str:
    if why_no_speed is not None:
        run_m_s = motion.solution.constant_velocity_m_s
        speed = "" if run_m_s is None else quantity(median(run_m_s[run_m_s > 0]), 1, "m/s")
        run = speed and f" A straight run through all frames has {speed}."
        return f"The speed is not known, because the distance from the camera is too uncertain: {why_no_speed}.{run}"
    peak_m_s, sigma_m_s, path_m = reference.peak_speed_m_s, reference.peak_speed_sigma_m_s, reference.distance_m
    form = decimals(peak_m_s)
    # a peak speed below its own standard deviation is not known
    peak = "" if sigma_m_s > peak_m_s else f" and at most {interval_text(peak_m_s, sigma_m_s, 'm/s', least=0.0)}"
    mean_text = f"{reference.mean_speed_m_s:{form}} m/s on average"
    if (speed := quantities.get("speed_m_s")) is not None and speed.sigma < speed.value:
        mean_text = f"{quantity_text(speed, 'm/s')} on average"
    return f"The animal moved {path_m:{decimals(path_m)}} m, at {mean_text}{peak}."


def _strides_text(gait: Gait) -> str:
    """Return the number of strides, such as "9 strides (2 to 3 of each foot)"."""
    counts = Counter(stride.foot for stride in gait.strides)
    numbers = sorted({counts[foot] for foot in gait.order})
    text = counted(len(gait.strides), "stride")
    if len(gait.order) < 2:
        return text
    return f"{text} ({' to '.join(map(str, dict.fromkeys((numbers[0], numbers[-1]))))} of each foot)"


def _stride_sentences(gait: Gait, quantities: Mapping[str, GaitQuantity]) -> Iterator[str]:
    length_m, frequency = length_text(gait.stride_length_m), f"{gait.stride_frequency_hz:.2f} a second"
    low, high = gait.name.duty_interval
    if quantities:
        length_m = quantity_text(quantities["stride_length_m"], "m")
        frequency = quantity_text(quantities["stride_frequency_hz"], "Hz")
        low, high = quantities["duty_factor"].interval
    yield (
        f"Strides are {length_m} long, {frequency}, averaged over {_strides_text(gait)}; a foot is in stance "
        f"{percent(gait.name.duty_factor)} of the time (90 %: {percent_range(low, high)})."
    )
    duration_s, swing_s = 1 / gait.stride_frequency_hz, 2 * math.pi * math.sqrt(gait.tracks.leg_m / 1.5 / G_M_S2)
    if duration_s > swing_s:
        yield (
            f"Strides last {quantity(duration_s, 1, 's')}, longer than one period of a leg that swings freely "
            f"({quantity(swing_s, 1, 's')}). The video may be in slow motion: check --fps."
        )
