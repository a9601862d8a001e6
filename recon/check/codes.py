"""Define the severity and the message of the findings with each code.

docs/findings.md explains the meaning of each code, the effect on the result, and the remedy.
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

MAX_NAMES = 5
"""Maximum number of names that the message of a finding lists."""
LENGTHS = ("height", "apart", "shift", "in_cm", "in_mm")
"""Names of the numbers of findings that are shown as lengths.

For example, {height_length} in a message shows the number height_m, with sigma_m if the finding has this number.
"""
SWAPPED, OUTLIERS = "left-right swap", "gross outliers"
"""Flags of frames in which the detections of a camera are wrong."""
FLAG_OF: Mapping[str, str] = {"left_right_swap": SWAPPED, "gross_outliers": OUTLIERS}
"""Flag of the frames that a finding is about, with the finding's code as the key."""
FLAGS: Mapping[str, str] = {
    "no data": "nothing was detected: the pose, if there is one, comes from the neighbouring frames",
    "diverged": "the best pose was outside the camera's view, and the frame has no pose",
    "data poor": "few joints were detected reliably: the pose is mostly the expected one",
    "ambiguous depth": (
        "seen from the front or the back, or nearly as well explained by another pose: depths in the pose may be wrong"
    ),
    SWAPPED: "left and right look swapped in the detections, and they are swapped in the pose too",
    OUTLIERS: (
        "the detections do not show an animal: they were left out, and the pose comes from the neighbouring frames"
    ),
}
"""Meaning of each flag of a frame, in the order in which summaries list them."""
_ROWS = tomllib.loads(builtin_file("check", "codes.toml").read_text(encoding="utf-8"))
CODES: Mapping[str, tuple[Severity, str]] = {code: (row["severity"], row["text"]) for code, row in _ROWS.items()}
"""Severity and message of each code, from `codes.toml`, with causes before their consequences."""
FAULTS: Mapping[str, str] = {code: row["fault"] for code, row in _ROWS.items() if "fault" in row}
"""Clause that completes "if", such as "the focal length is wrong", for each code whose findings state an effect."""
FOLLOWS = frozenset(code for code, row in _ROWS.items() if row.get("follows"))
"""Codes of findings that may be consequences of other findings."""
EFFECTS: tuple[str, str] = ("pose_effect_m", "position_effect_m")
"""Names of the numbers that state by how much the fault of a finding changes poses and positions, m.

The change of a pose is the change of the joints relative to their mean.
"""
SPEEDS: tuple[str, str] = ("given_speed_m_s", "other_speed_m_s")
"""Names of the numbers that state the animal's mean speed at the given and at the other frame rate, m/s."""
WITHOUT_FAULT = frozenset({"camera_agreement"})
"""Codes of notes that report agreement, not a fault."""
NOTE_IN_REASON = "keypoints_do_not_fit"
"""Code of the note whose message is part of the reason for the verdict "use"."""
_SERIOUS: tuple[Severity, ...] = ("error", "warning", "note")


def finding(code: str, frames: tuple[int, int] | None = None, camera: str | None = None, **numbers: Any) -> Finding:
    """Return a finding with the severity that belongs to its code.

    Parameters
    ----------
    code
        Code of the finding, a key of `CODES`.
    frames
        Number of the first frame, and of the frame after the last; None means the whole clip.
    camera
        Name of the camera that the finding is about; None means all cameras, or the clip.
    numbers
        Numbers and names that the finding's message states. A sequence of names is shown as a list.
    """
    numbers = {name: tuple(value) if isinstance(value, list) else value for name, value in numbers.items()}
    return Finding(code, CODES[code][0], frames, camera, numbers)


def by_effect(item: Finding, trunk_m: float, is_gross: bool = False, position_sigma_m: float = 0.0) -> Finding:
    """Return a finding with its severity reduced if its effect on the result is small.

    The severity is not changed if an effect (`EFFECTS`) is unknown, or as large as an error that spoils most uses
    (`LIMIT_OF_TRUNK`). With a smaller effect, the finding is at most a warning. If the effect is no larger than the
    fit's own error (`EFFECT_OF_NOTE`), it is a note.

    Parameters
    ----------
    item
        The finding.
    trunk_m
        Length of the animal's trunk, m.
    is_gross
        Whether the inputs contradict each other grossly. If so, the finding does not become a note.
    position_sigma_m
        Stated standard deviation of positions, m. A smaller effect on positions counts as no larger than the fit's own
        error.
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
    """Return findings sorted by severity, then in the order of `CODES`.

    Findings of the same code keep their order. Findings that may be consequences (`FOLLOWS`) are left out if there is
    an error that is not itself one of these.
    """
    caused = any(item.severity == "error" and item.code not in FOLLOWS for item in findings)
    kept, order = (item for item in findings if not (caused and item.code in FOLLOWS)), [*CODES]
    return tuple(sorted(kept, key=lambda item: (_SERIOUS.index(item.severity), order.index(item.code))))


def sentence(item: Finding, named: bool = True) -> str:
    """Return the message of a finding with its numbers filled in.

    If `named` is true, as for clips of several cameras, the message states the camera's name.
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
    values["effect"] = effect_text(numbers, "Without this fault")
    values["focal_effect"] = effect_text(numbers, "With a focal length at the end of its 90 % interval")
    # The pose follows a swap of the only camera, but several cameras may have kept it right.
    without_effect = "" if named else " They are swapped in the pose too."
    values["swap_effect"] = effect_text(numbers, "Without this fault") or without_effect
    values["lens_effect"] = effect_text(numbers, "With a fisheye lens")
    values.setdefault("part", "--frames")  # in motions of earlier versions the finding has no part
    if "count" in numbers:
        values["count_of_frames"] = counted(numbers["count"], "frame")
    text = words.format(**values, **degrees, **lengths, camera=camera, where=frames_text, late=delay)
    text = re.sub(r"(?<=\d)%", " %", text)
    return f"{item.camera}: {text}" if named and item.camera and "{camera}" not in words else text


def effect_text(numbers: Mapping[str, Any], condition: str) -> str:
    """Return a sentence, after a space, that states the effect of a fault on the result, or "" if it is unknown.

    `condition` begins a sentence on poses and positions, such as "Without this fault". For a wrong frame rate, which
    changes poses and positions little, the sentence states the effect on the speed.
    """
    if {*SPEEDS} <= numbers.keys():
        speed_text, other_text = (_speed_text(numbers[name]) for name in SPEEDS)
        return f" The animal's speed would be {other_text}, not {speed_text}."
    pose_m, position_m = (numbers.get(name, math.nan) for name in EFFECTS)
    if not math.isfinite(pose_m + position_m):
        return ""
    pose, position = rough_length(pose_m), rough_length(position_m)
    return f" {condition}, poses would change by {pose} and positions by {position}."


def _speed_text(speed_m_s: float) -> str:
    # Two digits are enough, because the other frame rate is known only roughly.
    digits = 0 if speed_m_s >= 9.5 else 1 if speed_m_s >= 0.95 else 2
    return quantity(speed_m_s, digits, "m/s")


def sentences(motion: Motion) -> Iterator[tuple[Finding, str]]:
    """Yield each finding of a motion with its message."""
    for item in motion.findings:
        yield item, sentence(item, named=len(motion.sources) > 1)


def names_text(names: Sequence[str]) -> str:
    """Return a string with the first `MAX_NAMES` names and the number of the remaining names."""
    rest = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
    return ", ".join(names[:MAX_NAMES]) + rest


def _where(frames: tuple[int, int] | None) -> str:
    if frames is None:
        return "in the whole clip"
    first, stop = frames
    return f"in frame {first}" if stop - first == 1 else f"in frames {first} to {stop - 1}"
