"""Build report.json of one clip from its sections.

A section is a field of report.json with lines of the summary (`recon.show.sections`). To add a section, write a
function that returns the section's numbers for a motion, and optionally a function that yields its lines, and add both
to `SECTIONS`. Other methods have their own lists (`Solution.report_sections`). docs/report.md describes the fields of
report.json.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, cast

from recon.base.arrays import to_plain
from recon.base.package import version
from recon.check.codes import sentences as finding_sentences
from recon.check.verdict import verdict_fields
from recon.fit.motion import Motion
from recon.show.plain import picked
from recon.show.sections import cameras, ground, inputs, keypoints, search
from recon.show.sections import motion as motion_sections
from recon.show.sections.section import Section

SCHEMA_NAME, SCHEMA_VERSION = "recon.fit.report", 4

SECTIONS: tuple[Section, ...] = (
    Section("verdict", verdict_fields, inputs.verdict_lines),
    Section("input", inputs.clip_data, inputs.clip_lines),
    Section("side", inputs.side_data, inputs.side_lines),
    Section("frame_of_reference", lambda motion: motion.frame_of_reference),
    Section("skeleton", inputs.skeleton_data),
    Section("assumptions", inputs.assumptions_data),
    Section("summary", search.summary_data, search.summary_lines),
    Section("unused_keypoints", lambda motion: motion.unused_keypoints),
    Section("missing_keypoints", lambda motion: motion.missing_keypoints),
    Section("keypoints", keypoints.keypoints_data, keypoints.keypoint_lines),
    Section("detector", inputs.detector_data, inputs.detector_lines),
    Section("cameras", cameras.cameras_data, cameras.camera_lines),
    Section("cleaning", inputs.cleaning_data, inputs.note_lines),
    Section("root_path", motion_sections.root_path_data, motion_sections.speed_lines),
    Section("heading", motion_sections.heading_data, motion_sections.heading_lines),
    Section("size", motion_sections.size_data, motion_sections.size_lines),
    Section("prior", motion_sections.prior_data, motion_sections.prior_lines),
    Section("segments", ground.segments_data),
    Section("stances", ground.stances_data, ground.ground_lines),
    Section("alternative", search.alternative_data, search.alternative_lines),
    Section("convergence", lambda motion: picked(motion.solution, *search.CONVERGENCE), search.convergence_lines),
)
"""Sections of the trajectory method, in the order of the summary."""


def sections_of(motion: Motion) -> tuple[Section, ...]:
    """Return the report's sections for the method with which a motion was fitted."""
    sections = motion.solution.report_sections()
    return SECTIONS if sections is None else cast("tuple[Section, ...]", sections)


def build_report(motion: Motion) -> dict[str, Any]:
    """Return the report of one clip in plain JSON types.

    NaN becomes None, and floats have nine significant digits. `lines` holds the labels and values of the summary's
    lines, without the findings.
    """
    report = {
        "schema": {"name": SCHEMA_NAME, "version": SCHEMA_VERSION},
        "recon_version": version(),
        "method": motion.solution.method,
        "settings": to_plain(motion.settings),
        "timing_s": to_plain({**motion.timing_s, **motion.solution.stage_s} or None),
        "findings": [to_plain(asdict(finding) | {"text": text}) for finding, text in finding_sentences(motion)],
        "lines": [],
    }
    for section in sections_of(motion):
        data = report[section.name] = to_plain(section.data(motion))
        report["lines"] += [[label, text] for label, text in section.lines(motion, data)]
    return report


def warnings(report: Mapping[str, Any]) -> list[str]:
    """Return the messages of a report's errors and warnings, without its notes."""
    return [finding["text"] for finding in report["findings"] if finding["severity"] != "note"]


def is_unsolved(report: Mapping[str, Any]) -> bool:
    """Return whether no frame has a pose according to a report."""
    summary = report["summary"]
    return summary.get("frames_converged", summary["frames_with_pose"]) == 0
