"""report.json and the summary of a fit, made of the sections of `recon.show.sections`; its fields: docs/report.md."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from recon.base.arrays import median
from recon.base.errors import decimals, length_text
from recon.base.package import version
from recon.check import sentences
from recon.fit.motion import Motion
from recon.gait.gait import Gait
from recon.gait.kinematics import JointKinematics
from recon.show.plain import to_json as to_json
from recon.show.plain import to_plain
from recon.show.sections import sections_of

SCHEMA_NAME, SCHEMA_VERSION = "recon.fit.report", 4
REPORT = "report.json"
STYLES = {"use": "bold green", "check": "bold yellow", "do not use": "bold red"}
"""Styles of the levels of a verdict, on a terminal."""
TO_DO = {  # what is to be used needs no word more
    "check": "Do what the reason says, and look at the poses on the video before you use them.",
    "do not use": "Do not use these numbers: mend what the reason names, and fit again.",
}
FRONT = ("assumed", "clip", "frames", "distance", "side", "keypoints", "detections", "note", "speed", "path", "size")
"""Lines of the summary that a terminal shows below the verdict; the page has all."""


def build_report(motion: Motion) -> dict[str, Any]:
    """The report of one clip, plain JSON types: NaN becomes None, floats have nine significant digits. `lines` are the
    summary's, label and text, without the findings."""
    report = to_plain(
        {
            "schema": {"name": SCHEMA_NAME, "version": SCHEMA_VERSION},
            "recon_version": version(),
            "method": motion.solution.method,
            "settings": motion.settings,
            "timing_s": {**motion.timing_s, **motion.solution.stage_s} or None,
            "findings": [asdict(one) | {"text": text} for one, text in sentences(motion)],
            "lines": [],
        }
    )
    for section in sections_of(motion):
        data = report[section.name] = to_plain(section.data(motion))
        report["lines"] += [[label, text] for label, text in section.lines(motion, data)]
    return report


def in_sentences(motion: Motion, moved: JointKinematics, gait: Gait | None, doubt: str | None) -> Iterator[str]:
    """The movement of the reference joint and the gait; doubt: why no speed is known."""
    sigma, run_m_s = moved.peak_speed_sigma_m_s, motion.solution.constant_velocity_m_s
    if doubt is None:
        form, of_path = decimals(moved.peak_speed_m_s), decimals(moved.distance_m)
        spread = "" if np.isnan(sigma) else f" ± {sigma:{form}}"
        # a peak below its own deviation is not known
        peak = "" if sigma > moved.peak_speed_m_s else f" and {moved.peak_speed_m_s:{form}}{spread} m/s at most"
        yield (
            f"The animal moved {moved.distance_m:{of_path}} m, at {moved.mean_speed_m_s:{form}} m/s on average{peak}."
        )
    else:
        run = (
            "" if run_m_s is None else f" A straight run through all frames has {median(run_m_s[run_m_s > 0]):.1f} m/s."
        )
        yield f"The animal's path is too uncertain in depth for a speed: {doubt}.{run}"
    if gait is None:
        yield "The skeleton has no feet: no gait."
        return
    yield f"Gait: {gait.name.name} ({gait.name.criterion})."
    if gait.strides:
        yield (
            f"Strides are {length_text(gait.stride_length_m)} long, {gait.stride_frequency_hz:.2f} a second (average "
            f"of {len(gait.strides)} strides); a foot stands {gait.name.duty_factor:.0%} of the time "
            "(90 %: {:.0%} to {:.0%}).".format(*gait.name.duty_interval)
        )


def warnings(report: Mapping[str, Any]) -> list[str]:
    """What is wrong or to be used with care, in words: the findings but for notes."""
    return [one["text"] for one in report["findings"] if one["severity"] != "note"]


def is_unsolved(report: Mapping[str, Any]) -> bool:
    """Whether there is no pose to look at."""
    summary = report["summary"]
    return summary.get("frames_converged", summary["frames_with_pose"]) == 0


def console_summary(report: Mapping[str, Any]) -> Table:
    """What there is to conclude, for a terminal, to be printed with rich: verdict, expected error, what to do and what
    may be wrong, then `FRONT`."""
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column()
    verdict = report["verdict"] or {"level": "", "reason": ""}
    found = [one for one in report["findings"] if one["severity"] != "note" and one["text"] != verdict["reason"]]
    begins = sum(label in ("verdict", "expected") for label, _ in report["lines"])  # below, what may be wrong
    for label, text in report["lines"][:begins]:
        level = verdict["level"] if label == "verdict" else ""
        table.add_row(Text(label, style="bold"), Text.assemble((level, STYLES.get(level, "")), text[len(level) :]))
    if verdict["level"] in TO_DO:
        table.add_row(Text("to do", style="bold"), TO_DO[verdict["level"]])
    for one in found:
        colour = {"error": "red", "warning": "yellow"}[one["severity"]]
        table.add_row(Text(one["severity"], style=f"bold {colour}"), Text(one["text"], colour))
    for label, text in report["lines"][begins:]:
        if label in FRONT and not (label == "keypoints" and text.endswith(" used")):  # all of them, as they should be
            table.add_row(Text(label, style="bold"), text)
    return table
