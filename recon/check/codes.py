"""Define every code of a finding: its severity and its text.

docs/findings.md explains each code: its meaning, its effect on the result, and the remedy.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from recon.base.documents import builtin_file
from recon.base.numbers import counted, length_text, quantity, rough_length
from recon.check.constants import EFFECT_OF_NOTE, LIMIT_OF_TRUNK
from recon.fit.motion import Motion
from recon.fit.result import Finding, Severity

NAMED = 5
"""Largest number of names in a text."""
LENGTHS = ("height", "apart", "shift", "in_cm", "in_mm")
"""Names of numbers that a text shows as lengths.

For example, {height_length} shows height_m, with sigma_m if the finding has this number.
"""
SWAPPED, OUTLIERS = "left-right swap", "gross outliers"
"""Flags of frames in which one camera's detections are wrong."""
FLAG_OF: Mapping[str, str] = {"left_right_swap": SWAPPED, "gross_outliers": OUTLIERS}
"""Flags of frames, by the code of their finding."""
FLAGS: Mapping[str, str] = {
    "no data": "nothing was detected: the pose, if there is one, comes from the neighbouring frames",
    "diverged": "the best pose was outside the camera's view, and the frame has no pose",
    "data poor": "few joints were seen and trusted: the pose is mostly the expected one",
    "ambiguous depth": (
        "seen from the front or the back, or nearly as well explained by another pose: depths in the pose may be wrong"
    ),
    SWAPPED: "left and right look swapped in the detections, and the pose has them swapped too",
    OUTLIERS: (
        "the detections are not those of an animal: they were left out, and the pose comes from the neighbouring frames"
    ),
}
"""Meaning of each flag of a frame, in the order of a summary."""
_ROWS = tomllib.loads(builtin_file("check", "codes.toml").read_text(encoding="utf-8"))
CODES: Mapping[str, tuple[Severity, str]] = {code: (row["severity"], row["text"]) for code, row in _ROWS.items()}
"""Severity and text by code, from `codes.toml`; causes come before their consequences."""
FOLLOWS = frozenset(code for code, row in _ROWS.items() if row.get("follows"))
"""Codes of findings that may be consequences of others."""
EFFECTS: tuple[str, str] = ("pose_effect_m", "position_effect_m")
"""Names of numbers: the change of poses (joints about their middle) and of positions, m, if a finding is right."""
SPEEDS: tuple[str, str] = ("given_speed_m_s", "other_speed_m_s")
"""Names of the numbers that state the animal's mean speed at the given and at another frame rate, m/s."""
WITHOUT_FAULT = frozenset({"camera_agreement"})
"""Codes of notes that report agreement, not a fault."""
_SERIOUS: tuple[Severity, ...] = ("error", "warning", "note")


def finding(code: str, frames: tuple[int, int] | None = None, camera: str | None = None, **numbers: Any) -> Finding:
    """Return a finding with a code of `CODES` and that code's severity.

    Parameters
    ----------
    code
        Code of the finding, a key of `CODES`.
    frames
        First frame number, and the one after the last; None means the whole clip.
    camera
        Name of the camera that the finding is about; None means all cameras, or the clip.
    numbers
        The numbers and names that the code's text states. Several names are a sequence, which the text lists.
    """
    numbers = {name: tuple(value) if isinstance(value, list) else value for name, value in numbers.items()}
    return Finding(code, CODES[code][0], frames, camera, numbers)


def by_effect(item: Finding, trunk_m: float, is_gross: bool = False, position_sigma_m: float = 0.0) -> Finding:
    """Return a finding whose severity follows from its effect, if it has the numbers of `EFFECTS`.

    The severity does not change if an effect is unknown (NaN), or as large as an error that spoils most uses. With a
    smaller effect, the finding is at most a warning. The finding is a note if the effect is no larger than the fit's
    own error, unless `is_gross` is true because the inputs contradict each other grossly. An effect on positions below
    the standard deviation `position_sigma_m`, which the fit states for them, is no larger than the fit's own error
    either.
    """
    effects_m = [item.numbers.get(name) for name in EFFECTS]
    known_m = [value for value in effects_m if isinstance(value, float) and math.isfinite(value)]
    if len(known_m) < len(EFFECTS) or item.severity == "note":
        return item
    pose_m, position_m = known_m
    largest_m = pose_m if position_m < position_sigma_m else max(pose_m, position_m)
    limit_m = LIMIT_OF_TRUNK * trunk_m
    if largest_m >= limit_m:
        return item
    is_small = largest_m < EFFECT_OF_NOTE * limit_m and not is_gross
    return replace(item, severity="note" if is_small else "warning")


def sort_findings(findings: Sequence[Finding]) -> tuple[Finding, ...]:
    """Return findings sorted by severity, then in the order of `CODES`; findings of one code keep their order.

    If there is an error that is not itself a possible consequence, findings that may be consequences are left out.
    """
    caused = any(item.severity == "error" and item.code not in FOLLOWS for item in findings)
    kept, order = (item for item in findings if not (caused and item.code in FOLLOWS)), [*CODES]
    return tuple(sorted(kept, key=lambda item: (_SERIOUS.index(item.severity), order.index(item.code))))


def sentence(item: Finding, named: bool = True) -> str:
    """Return the text of a finding.

    If `named` is true, as for clips of several cameras, the text calls a camera by its name.
    """
    words = CODES[item.code][1]
    numbers: dict[str, Any] = item.numbers
    values = {name: names_text(value) if isinstance(value, tuple) else value for name, value in numbers.items()}
    degrees = {f"{name[:-4]}_deg": math.degrees(value) for name, value in numbers.items() if name.endswith("_rad")}
    sigma_m, lengths_given = numbers.get("sigma_m"), [name for name in LENGTHS if f"{name}_m" in numbers]
    lengths = {f"{name}_length": length_text(numbers[f"{name}_m"], sigma_m) for name in lengths_given}
    frames = numbers.get("late_frames", 0.0)
    delay = f"{abs(frames):.1f} frames {'late' if frames > 0 else 'early'}"
    camera, frames_text = item.camera if named else "the camera", _where(item.frames)
    effect = effect_text(numbers)
    if "count" in numbers:
        values["count_of_frames"] = counted(numbers["count"], "frame")
    text = words.format(**values, **degrees, **lengths, camera=camera, where=frames_text, late=delay, effect=effect)
    text = re.sub(r"(?<=\d)%", " %", text)
    return f"{item.camera}: {text}" if named and item.camera and "{camera}" not in words else text


def effect_text(numbers: Mapping[str, Any]) -> str:
    """Return the effect of a finding on the result, as a sentence after a space, or "" if it is unknown.

    For another frame rate, which changes poses and positions little, the sentence states the effect on the speed.
    """
    if {*SPEEDS} <= numbers.keys():
        speed_text, other_text = (_speed_text(numbers[name]) for name in SPEEDS)
        return f" The animal's speed would be {other_text}, not {speed_text}."
    pose_m, position_m = (numbers.get(name, math.nan) for name in EFFECTS)
    if not math.isfinite(pose_m + position_m):
        return ""
    pose, position = rough_length(pose_m), rough_length(position_m)
    return f" Without this fault, poses would change by {pose} and positions by {position}."


def _speed_text(speed_m_s: float) -> str:
    # two digits, because another frame rate is known only roughly
    digits = 0 if speed_m_s >= 9.5 else 1 if speed_m_s >= 0.95 else 2
    return quantity(speed_m_s, digits, "m/s")


def sentences(motion: Motion) -> Iterator[tuple[Finding, str]]:
    """Yield each finding of a motion with its text."""
    for item in motion.findings:
        yield item, sentence(item, named=len(motion.sources) > 1)


def names_text(names: Sequence[str]) -> str:
    """Return the first `NAMED` names as text, and the number of the others."""
    rest = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return ", ".join(names[:NAMED]) + rest


def _where(frames: tuple[int, int] | None) -> str:
    if frames is None:
        return "in the whole clip"
    first, stop = frames
    return f"in frame {first}" if stop - first == 1 else f"in frames {first} to {stop - 1}"
