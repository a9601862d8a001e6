"""`recon analyse`."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from rich.table import Table

from recon.base.words import length_text
from recon.gait.clip import ClipAnalysis
from recon.gait.gait import Gait
from recon.workflows.analyse import FOLDER, PLAYBACK, AnalyseSettings, run_analyse
from recon.workflows.cli.common import (
    counted,
    progress_bar,
    say,
    say_verdict,
    say_what_is_gone,
    table_of,
    terminal,
)

MOST_STANCES = 100
"""That are printed, of all feet."""


def analyse(settings: AnalyseSettings, as_json: bool, quiet: bool) -> Any:
    """Kinematics, gait, vector fields and phase portraits of a reconstruction.

    Writes tables (CSV) and figures (PNG, SVG); recon view shows the plots beside the playback from then on.

    Example: recon analyse results/clip
    """

    console = terminal(quiet=quiet, stderr=as_json)
    with progress_bar(console) as progress:
        found, summary, files = run_analyse(settings, progress)
    if as_json:
        return summary
    say_verdict(console, found.motion.verdict)
    for line in _lines(found, summary["speed"]):
        say(console, line)
    out, count = files[0].parent, 0 if found.gait is None else len(found.gait.stances)
    if count > MOST_STANCES:
        say(console, f"{count} stances are in {out / 'stances.csv'}.")
    elif found.gait is not None:
        console.print(_stances(found.motion.foot_names, found.gait))
    for note in summary["notes"]:
        say(console, f"note: {note}")
    say_what_is_gone(console, settings.folder)
    say(console, f"{len(files)} files are in {out}.")
    if out == settings.folder / FOLDER and (settings.folder / PLAYBACK).is_file():
        say(console, f"See them beside the playback with: recon view {settings.folder}")


def _lines(found: ClipAnalysis, speed: dict[str, Any]) -> Iterator[str]:
    sigma = speed["peak_sigma_m_s"]
    spread = "" if sigma is None else f" ± {sigma:.1f}"
    if speed["doubt"] is None:
        yield (
            f"path of {found.reference}: {speed['distance_m']:.2f} m, mean {speed['mean_m_s']:.1f} m/s, "
            f"peak {speed['peak_m_s']:.1f}{spread} m/s at {speed['peak_time_s']:.2f} s"
        )
    else:
        run = speed["straight_run_m_s"]
        other = "" if run is None else f"{run:.1f} m/s, of a straight run through all frames; "
        yield f"speed of {found.reference}: {other}its path is too uncertain in depth for it: {speed['doubt']}"
    if speed["net_acceleration_m_s2"] is not None and math.isfinite(speed["net_acceleration_m_s2"]):
        low, high = speed["net_acceleration_interval_m_s2"]
        yield (
            f"acceleration along the way, over the whole clip: {speed['net_acceleration_m_s2']:+.1f} m/s² "
            f"(95 %: {low:+.1f} to {high:+.1f})"
        )
    if "spine_flexion" in found.angles:
        low, high = (math.degrees(angle) for angle in found.angles["spine_flexion"].range_rad)
        yield f"flexion of the spine: {low:+.0f}° to {high:+.0f}° (positive: arched up)"
    if (gait := found.gait) is not None:
        yield f"gait: {gait.name.name} ({gait.name.criterion})"
        if gait.strides:
            yield (
                f"  average of {counted(len(gait.strides), 'stride')}: "
                f"{length_text(gait.stride_length_m)}, {gait.stride_frequency_hz:.2f} Hz, "
                "duty factor {:.2f} (90 %: {:.2f} to {:.2f})".format(gait.name.duty_factor, *gait.name.duty_interval)
            )
    if (stride := found.stride) is not None:
        which = "as given" if found.given is not None else f"of {stride.foot}"
        yield f"phase portraits: the stride from {stride.start_s:.3f} to {stride.end_s:.3f} s, {which}"


def _stances(foot_names: Mapping[str, str], gait: Gait) -> Table:
    """By foot."""
    table = table_of("foot", "stances, s", title="times: seconds since frame 0")
    for foot, joint in foot_names.items():
        spans = [
            f"{'' if s.begins else '≤'}{s.start_s:.3f}-{s.end_s:.3f}{'' if s.ends else '+'}"
            for s in gait.stances
            if s.foot == foot
        ]
        table.add_row(f"{foot} {joint}", ", ".join(spans) or "none")
    return table
