"""A clip's folder: what its motion becomes there, all of it or nothing."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from recon.base import Progress, silent
from recon.base.files import require_free_folder, sole_writer, staged_results
from recon.base.manifest import MANIFEST
from recon.fit.motion import MOTION, Motion
from recon.io import write_cameras
from recon.show.export.clip_csv import CAMERA_OUTPUTS, CLIP_OUTPUTS, of_any_camera, write_tables
from recon.show.page import PAGE
from recon.show.plain import write_report
from recon.show.report import build_report
from recon.workflows.clip import fit_clip
from recon.workflows.made_from import digest, input_files
from recon.workflows.settings import FitSettings

REFINED_CAMERAS = "cameras.toml"
"""Where cameras' poses were refined."""
OUTPUT_FILES = (*CLIP_OUTPUTS, *CAMERA_OUTPUTS, MOTION, "report.json", "motion.rrd", "config.toml", MANIFEST)
"""Every file that a clip of one camera gets. With several cameras there are `CAMERA_OUTPUTS` for each."""


def output_files(out: Path) -> tuple[str, ...]:
    """Every file in a folder that is a clip's, or that a clip of one camera could get there. Its page goes with
    them: it shows the results that it was made of."""
    return (*OUTPUT_FILES, PAGE, REFINED_CAMERAS, *of_any_camera(out))


def write_clip(
    motion: Motion,
    settings: FitSettings,
    out: Path,
    solve_s: float | None = None,
    sha256: Mapping[str, str | None] | None = None,
) -> dict[str, Any]:
    """Write every output of a clip into the folder `out`, all or none, and give back the report. sha256: of the
    input files by their role, if they are known."""
    from recon.show import view  # rerun is slow to import

    if sha256 is None:
        sha256 = {role: digest(path) for role, path in input_files(settings).items()}
    known = {role: found for role, found in sha256.items() if found is not None}
    timing_s = {} if solve_s is None else {"solve_s": solve_s}
    motion = replace(motion, settings=settings.plain(out), timing_s=timing_s)
    report = build_report(motion)
    with staged_results(out, output_files(out)) as folder:
        motion.save(folder)
        write_tables(motion, folder)
        write_report(report, folder / "report.json")
        (folder / "config.toml").write_text(settings.to_toml(out, known), encoding="utf-8")
        view.write(motion, folder / "motion.rrd")
        if settings.seeks_cameras:
            write_cameras([source.camera for source in motion.sources], folder / REFINED_CAMERAS)
    return report


def run_clip(settings: FitSettings, out: Path, overwrite: bool = False, progress: Progress = silent) -> dict[str, Any]:
    """`recon fit`: reconstruct a clip and write its folder; the report. Raises InputError before any work is done if
    `out` holds results already and may not be overwritten, or if another process is writing to it."""
    with sole_writer(out):
        require_free_folder(out, output_files(out), overwrite)
        start = time.perf_counter()
        motion = fit_clip(settings, progress)
        return write_clip(motion, settings, out, time.perf_counter() - start)
