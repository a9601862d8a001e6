"""Show the summary of a report on a terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from rich.table import Table
from rich.text import Text

from recon.base.numbers import rough_length
from recon.check.codes import EFFECTS, NOTE_IN_REASON, WITHOUT_FAULT

STYLES = {"use": "bold green", "check": "bold yellow", "do not use": "bold red"}
"""Style of each level of a verdict on the terminal, for rich."""
TO_DO = {
    "check": (
        "Look at the poses on the video (recon overlay) before use. The reason and the warnings state what may be "
        "wrong."
    ),
    "do not use": "Do not use these numbers. Correct the problem that the reason names, and fit again.",
}
"""Advice for each level of a verdict except "use", which needs none."""
_COLOURS = {"error": "red", "warning": "yellow"}
"""Colour of each severity of findings on the terminal; notes have none."""
FRONT = ("assumed", "clip", "frames", "distance", "side", "keypoints", "detections", "note", "speed", "path", "size")
"""Labels of the lines that the summary on the terminal shows after the verdict. The HTML page shows all lines."""
NOTES = 2
"""Largest number of notes in a summary. The page has all notes."""


def finding_text(severity: str, text: str) -> Text:
    """Return a finding in the colour of its severity (error, warning or note)."""
    colour = _COLOURS.get(severity, "")
    return Text.assemble((f"{severity}: ", f"bold {colour}".strip()), (text, colour))


def console_summary(report: Mapping[str, Any]) -> Table:
    """Return the summary for rich to print, with verdict, expected error, advice, findings and the lines of `FRONT`."""
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column()
    verdict = report["verdict"] or {"level": "", "reason": ""}
    verdict_count = sum(label in ("verdict", "expected") for label, _ in report["lines"])
    for label, text in report["lines"][:verdict_count]:
        level = verdict["level"] if label == "verdict" else ""
        table.add_row(Text(label, style="bold"), Text.assemble((level, STYLES.get(level, "")), text[len(level) :]))
    if verdict["level"] in TO_DO:
        table.add_row(Text("to do", style="bold"), TO_DO[verdict["level"]])
    stated = reason_finding(report)
    further = [finding for number, finding in enumerate(report["findings"]) if number != stated]
    for finding in further:
        if finding["severity"] != "note":
            style = f"bold {_COLOURS[finding['severity']]}"
            table.add_row(Text(finding["severity"], style), finding["text"])
    if verdict["level"] == "use":
        for text in _largest_notes(further, verdict.get("reason_code")):
            table.add_row(Text("note", style="bold"), text)
    for label, text in report["lines"][verdict_count:]:
        are_all_used = label == "keypoints" and text.endswith(" used")  # the usual case needs no line
        if label in FRONT and not are_all_used:
            table.add_row(Text(label, style="bold"), text)
    return table


def reason_finding(report: Mapping[str, Any]) -> int | None:
    """Return the index of the finding whose message is the reason of a report's verdict, None if there is none.

    A note that only widens an expected error has the reason's code, but its message is not the reason.
    """
    code = (report["verdict"] or {}).get("reason_code")
    for index, item in enumerate(report["findings"]):
        if item["code"] == code and (item["severity"] != "note" or code == NOTE_IN_REASON):
            return index
    return None


def _largest_notes(findings: Sequence[Mapping[str, Any]], reason_code: str | None) -> list[str]:
    """Return the first sentences of up to `NOTES` of the notes among the findings.

    The notes with the largest effects are chosen. Notes with an unknown effect come last. The effect of the note with
    the code of the verdict's reason is part of this reason, and not repeated.
    """
    notes = []
    for item in findings:
        if item["severity"] == "note" and item["code"] not in WITHOUT_FAULT:
            pose_m, position_m = (item["numbers"].get(name) or 0.0 for name in EFFECTS)
            effect_m = max(pose_m, position_m)
            affected = "pose" if pose_m > position_m else "position"
            is_stated = item["code"] == reason_code or not effect_m
            effect = "" if is_stated else f" ({affected} by up to {rough_length(effect_m)})"
            notes.append((effect_m, item["text"].partition(". ")[0].rstrip(".") + effect + "."))
    return [text for _, text in sorted(notes, key=lambda note: -note[0])[:NOTES]]
