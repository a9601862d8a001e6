"""All that is said of a motion: one list of sections, from which report.json, the summary and the page are made.

To add a section: a function of a motion that gives its numbers, perhaps one that gives its lines of the summary, and an
entry in `SECTIONS`; `FRONT` of `recon.show.report` has the labels of the lines that the terminal shows. Another method
has its own list (`Solution.described_by`).
"""

from __future__ import annotations

from importlib import import_module

from recon.check import verdict_fields
from recon.fit.motion import Motion
from recon.show.sections import fitted, given
from recon.show.sections.section import Line, Section

SECTIONS: tuple[Section, ...] = (
    Section("verdict", verdict_fields, given.verdict_lines),
    Section("input", given.clip, given.clip_lines),
    Section("side", given.side, given.side_lines),
    Section("frame_of_reference", lambda motion: motion.frame_of_reference),
    Section("skeleton", given.skeleton),
    Section("assumptions", fitted.assumptions),
    Section("summary", fitted.summary, fitted.summary_lines),
    Section("unused_keypoints", lambda motion: motion.unused_keypoints),
    Section("missing_keypoints", lambda motion: motion.missing_keypoints),
    Section("keypoints", given.keypoints, given.keypoint_lines),
    Section("detector", given.detector, given.detector_lines),
    Section("cameras", given.cameras, given.camera_lines),
    Section("cleaning", given.cleaning, given.note_lines),
    Section("root_path", given.root_path, fitted.speed_lines),
    Section("heading", fitted.heading, fitted.heading_lines),
    Section("size", fitted.size, fitted.size_lines),
    Section("prior", fitted.prior, fitted.prior_lines),
    Section("segments", fitted.segments),
    Section("stances", fitted.stances, fitted.ground_lines),
    Section("alternative", fitted.alternative, fitted.alternative_lines),
    Section("convergence", fitted.convergence, fitted.effort_lines),
)
"""The sections of the trajectory method, in the order of the summary."""


def sections_of(motion: Motion) -> tuple[Section, ...]:
    return import_module(motion.solution.described_by).SECTIONS
