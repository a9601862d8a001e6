"""Test whether the findings name a camera that contradicts the others of its clip, and no other camera.

    python benchmarks/parts/agreement.py [FOLDER]

FOLDER has one folder for each run, as in `cheetah_runs.py`; by default it is the cheetah-runs of $RECON_SHARED_DATA, or
of ../shared/data. Each unchanged run is checked first, so that every camera is compared with the others. Then one of
its cameras is turned by 5 degrees about each of its axes, or shifted in time by 10 frames, or the files of two cameras
are exchanged, for every camera and every pair. A case counts as correct if the findings name the change and the right
camera, and contain nothing else except findings on the unchanged run.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from arguments import parser_of, runs_or_exit
from markdown_table import print_table
from recordings import fit_settings, meta_of

from recon import load_skeleton
from recon.api.clip_inputs import prepare
from recon.check.agreement import agreement_findings
from recon.clip import View, views_of
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.result import Finding
from recon.geometry.frames import euler_rotation, rigid

SKELETON = "cheetah-24"
TURN_DEG, LAG = 5.0, 10
TRUNK_M = 0.7
"""Length of the trunk of a cheetah, m."""
Case = tuple[str, list[View], str, tuple[int, ...]]
"""Name of the change, the changed views, the expected finding and the cameras that it should name."""


def views_of_run(run: Path) -> tuple[list[View], float]:
    """Return the views of all cameras of a run, and the frame rate."""
    given = prepare(fit_settings(run, meta_of(run)["cameras"], skeleton=SKELETON))
    return [view.mask_outside_image() for view in views_of(given.sources)], given.fps


def check_agreement(views: Sequence[View], fps: float) -> tuple[Finding, ...]:
    """Run the check of agreement on a stand-in for a fit, which has only the fields that the check reads."""
    sources = [SimpleNamespace(offset_frames=view.offset_frames, offset_s=0.0) for view in views]
    frames, solution = np.arange(len(views[0].xy_px)), SimpleNamespace(views=views)
    motion = SimpleNamespace(solution=solution, sources=sources, fps=fps, frames=frames, trunk_m=TRUNK_M)
    noise_m = load_skeleton(SKELETON).keypoint_sigma_m
    return agreement_findings(motion, TrajectoryOptions().sigma_px, noise_m)  # type: ignore[arg-type]


def cases(views: list[View]) -> Iterator[Case]:
    def with_one(v: int, view: View) -> list[View]:
        return [*views[:v], view.mask_outside_image(), *views[v + 1 :]]

    for v, view in enumerate(views):
        for axis, name in enumerate(("tilted", "panned", "rolled")):
            yield f"{name} by {TURN_DEG:g} degrees", with_one(v, turned(view, axis)), "camera_turned", (v,)
        for frames in (LAG, -LAG):
            done = f"{LAG} frames {'late' if frames > 0 else 'early'}"
            yield done, with_one(v, late(view, frames)), "camera_late", (v,)
    for a, b in combinations(range(len(views)), 2):
        swapped = [*views]
        swapped[a], swapped[b] = (
            replace(views[here], xy_px=views[there].xy_px, confidence=views[there].confidence).mask_outside_image()
            for here, there in ((a, b), (b, a))
        )
        yield "two files exchanged", swapped, "cameras_exchanged", (a, b)


def turned(view: View, axis: int) -> View:
    rotation = euler_rotation(np.radians(TURN_DEG) * np.eye(3)[axis])
    return replace(view, T_camera_world=rigid(rotation, np.zeros(3)) @ view.T_camera_world)


def late(view: View, frames: int) -> View:
    """Return a view in which each frame has the detections of `frames` frames later."""
    xy_px, confidence = np.full_like(view.xy_px, np.nan), np.zeros_like(view.confidence)
    to, of = (slice(None, -frames), slice(frames, None)) if frames > 0 else (slice(-frames, None), slice(None, frames))
    xy_px[to], confidence[to] = view.xy_px[of], view.confidence[of]
    return replace(view, xy_px=xy_px, confidence=confidence)


def named(findings: Sequence[Finding], views: Sequence[View]) -> set[tuple[str, tuple[int, ...]]]:
    """Return the codes of all findings except notes, each with the indices of the cameras that it names."""
    names = [view.camera.name for view in views]
    return {
        (one.code, tuple(names.index(name) for name in one.names("cameras") or (str(one.camera),)))
        for one in findings
        if one.severity != "note"
    }


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs")
    runs = runs_or_exit(parser, parser.parse_args().folder)
    unchanged, right, total, seconds = [], {}, {}, {"as it is": [], "changed": []}
    for run in runs:
        views, fps = views_of_run(run)
        began = time.process_time()
        as_it_is = check_agreement(views, fps)
        seconds["as it is"].append(time.process_time() - began)
        notes = [SimpleNamespace(**one.numbers) for one in as_it_is if one.code == "camera_agreement"]
        for v, (view, found) in enumerate(zip(views, notes, strict=True)):
            says = [code for code, cameras in named(as_it_is, views) if v in cameras]
            unchanged.append(
                [
                    run.name,
                    view.camera.name,
                    *(f"{x:.2f}" for x in (found.level, np.degrees(found.turn_rad), found.level_turned)),
                    *(f"{x:.2f}" for x in (found.late_frames, found.level_late)),
                    ", ".join(says),
                ]
            )
        for done, changed, kind, cameras in cases(views):
            began = time.process_time()
            findings = named(check_agreement(changed, fps), changed)
            seconds["changed"].append(time.process_time() - began)
            ok = (kind, cameras) in findings and findings - {(kind, cameras)} <= named(as_it_is, views)
            for table, by in ((right, ok), (total, 1)):
                row = table.setdefault(done, {})
                row[run.name] = row.get(run.name, 0) + by
    print_table(["run", "camera", "level", "turn_deg", "level_turned", "late_frames", "level_late", "named"], unchanged)
    header = ["change of a camera or pair", *(run.name for run in runs)]
    print_table(header, [[done, *(f"{right[done][r]} of {n}" for r, n in row.items())] for done, row in total.items()])
    print("; ".join(f"{name}: {np.median(s):.2f} s (median)" for name, s in seconds.items()))


if __name__ == "__main__":
    main()
