"""Whether the cameras of a clip agree with each other, in numbers and in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from typing import Any

from recon.check.agreement import Agreement, CameraAgreement, Finding, camera_agreement
from recon.fit import TrajectoryOptions
from recon.fit.motion import Motion
from recon.show.report import common


def section(motion: Motion, settings: Mapping[str, Any]) -> dict[str, Any] | None:
    """None with one camera."""
    both = zip(motion.solution.views, motion.sources, strict=True)
    views = [replace(view, lead_frames=source.lead_frames) for view, source in both]  # without the lags that were found
    if len(views) < 2:
        return None
    options = common.given_options(TrajectoryOptions, settings)
    agreement = camera_agreement(views, motion.fps, options.sigma_px, options.keypoint_noise_m(motion.body))
    names = [view.camera.name for view in views]
    offsets_s = [source.offset_s for source in motion.sources]
    frames = motion.frames[agreement.frames]
    return {
        "frames": (frames[0], frames[-1] + 1),
        "max_level": agreement.max_level,
        "cameras": [{"name": name, **asdict(camera)} for name, camera in zip(names, agreement.cameras, strict=True)],
        "findings": [
            {
                "cameras": [names[v] for v in finding.cameras],
                "kind": finding.kind,
                "text": _finding_text(finding, agreement, names, offsets_s, motion.fps),
            }
            for finding in agreement.findings
        ],
    }


def warnings(report: Mapping[str, Any]) -> Iterator[str]:
    found = report["agreement"]
    if found is not None and not any(camera["points"] for camera in found["cameras"]):
        yield "no two cameras see a point at the same time: check --offset-s, and whether all files are of one clip"
    yield from (finding["text"] for finding in (found or {}).get("findings", ()))


def _finding_text(finding: Finding, agreement: Agreement, names: list[str], offsets_s: list[float], fps: float) -> str:
    who = " and ".join(names[v] for v in finding.cameras)
    camera = finding.found or agreement.cameras[finding.cameras[0]]
    if finding.kind == "exchanged":
        other = ", or one of them of another clip" if len(names) == 2 else ""
        return f"{who}: as if their files were exchanged{other} ({_error_text(camera)} as they are)"
    if finding.kind == "apart":
        of_whom = who if len(names) == 2 else "the cameras"
        cause = "which of them is off, or of another clip, cannot be told"
        return f"{of_whom} do not agree with each other: {_error_text(camera)}, and {cause}"
    if finding.kind == "turned":
        degrees = math.degrees(camera.turn_rad)
        return f"{who}: turned by about {degrees:.1f} degrees against the others ({_error_text(camera)})"
    if finding.kind == "late":
        offset_s = offsets_s[finding.cameras[0]] + camera.late_frames / fps
        return (
            f"{who}: about {abs(camera.late_frames):.1f} frames {'late' if camera.late_frames > 0 else 'early'} "
            f"against the others ({_error_text(camera)}); its --offset-s would be {offset_s:.3f}"
        )
    return f"{who}: off by {_error_text(camera)} against the others for a reason unknown"


def _error_text(camera: CameraAgreement) -> str:
    return f"{camera.error_px:.0f} px, {camera.level:.1f} sigma"
