"""A clip's folder: what its motion becomes there, all of it or nothing."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from recon.base.errors import Problem, refuse
from recon.base.files import require_free_folder, sole_writer, staged_results, write_bytes
from recon.base.manifest import MANIFEST
from recon.base.progress import Progress, silent
from recon.fit.motion import MOTION, Motion
from recon.io import write_cameras
from recon.show.export.clip_csv import CAMERA_OUTPUTS, CLIP_OUTPUTS, of_any_camera, write_tables
from recon.show.page import PAGE
from recon.show.plain import write_report
from recon.show.report import build_report
from recon.workflows.clip import fit_clip
from recon.workflows.made_from import digests
from recon.workflows.settings import FitSettings

REFINED_CAMERAS = "cameras.toml"
"""Where cameras' poses were refined."""
TRACK_FILES = ("track.csv", "track_report.json", "track_panorama.png")
"""Of a camera whose motion was found with the fit."""
OUTPUT_FILES = (
    *CLIP_OUTPUTS,
    *CAMERA_OUTPUTS,
    MOTION,
    "report.json",
    "motion.rrd",
    "config.toml",
    MANIFEST,
)
"""Every file that a clip of one camera gets. With several cameras there are `CAMERA_OUTPUTS` for each."""


def output_files(out: Path) -> tuple[str, ...]:
    """Every file in a folder that is a clip's, or that a clip of one camera could get there. Its page goes with
    them: it shows the results that it was made of."""
    return (*OUTPUT_FILES, *TRACK_FILES, PAGE, REFINED_CAMERAS, *of_any_camera(out))


def write_clip(
    motion: Motion,
    settings: FitSettings,
    out: Path,
    solve_s: float | None = None,
    beside: Sequence[Path] = (),
    sha256: Mapping[str, str | None] | None = None,
) -> dict[str, Any]:
    """Write every output of a clip into the folder `out`, all or none, and give back the report. beside: files that go
    with them. sha256: of the input files (`recon.workflows.made_from.digests`), if they are known."""
    from recon.show import view  # rerun is slow to import

    timing_s = {} if solve_s is None else {"solve_s": solve_s}
    motion = replace(motion, settings=settings.plain(out), timing_s=timing_s)
    report = build_report(motion)
    with staged_results(out, output_files(out)) as folder:
        motion.save(folder)
        write_tables(motion, folder)
        write_report(report, folder / "report.json")
        (folder / "config.toml").write_text(settings.to_toml(out, digests(settings, sha256)), encoding="utf-8")
        view.write(motion, folder / "motion.rrd")
        if settings.seeks_cameras:
            write_cameras([source.camera for source in motion.sources], folder / REFINED_CAMERAS)
        for path in beside:
            write_bytes(folder / path.name, path.read_bytes())
    return report


def run_clip(
    settings: FitSettings, out: Path, overwrite: bool = False, progress: Progress = silent, video: Path | None = None
) -> dict[str, Any]:
    """`recon fit`: reconstruct a clip and write its folder; the report. Raises InputError before any work is done if
    `out` holds results already and may not be overwritten, or if another process is writing to it.

    video: of a camera that turns; the track that is found in it (`recon.workflows.camera_motion`) goes with the
    results.
    """
    with sole_writer(out), nullcontext(out) if video is None else TemporaryDirectory() as made:
        require_free_folder(out, output_files(out), overwrite)
        track, folder = (out / TRACK_FILES[0]).absolute(), Path(made)
        if video is not None:
            settings = _followed(settings, video, folder, progress)
        start = time.perf_counter()
        motion = fit_clip(settings, progress)
        own = settings.camera_track == (folder.absolute() / TRACK_FILES[0],)
        beside = [folder / name for name in TRACK_FILES if (folder / name).is_file()] if own else []
        recorded = replace(settings, camera_track=(track,)) if own else settings
        return write_clip(motion, recorded, out, time.perf_counter() - start, beside)


def _followed(settings: FitSettings, video: Path, folder: Path, progress: Progress) -> FitSettings:
    """With the track of a camera that turns, which its video shows, in that folder."""
    problems = []
    if settings.camera_track is not None:
        problems.append(Problem("--camera-motion", "camera", "a video beside --camera-track", "one of the two"))
    if len(settings.keypoints) > 1:
        expected = "one camera; for several, make each one's track by recon camera-motion"
        problems.append(Problem("--camera-motion", "cameras", f"{len(settings.keypoints)}", expected))
    if settings.camera is None:
        problems.append(Problem("--camera-motion", "camera", "no --camera", "the camera's calibration, for its lens"))
    refuse(problems)
    from recon.workflows.camera_motion import of_clip, run_camera_motion

    track = folder.absolute() / TRACK_FILES[0]
    run_camera_motion(of_clip(settings, video, track), progress)
    return replace(settings, camera_track=(track,), tilt_deg=None)
