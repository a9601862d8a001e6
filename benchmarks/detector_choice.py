"""Which detector a fit takes keypoints for when nobody says it, and what that costs.

    python benchmarks/detector_choice.py

Every view of cheetah-runs and plate-trials (in $RECON_SHARED_DATA, or ../shared/data) by itself: with nothing said,
with `none`, with the shipped detector file, and with that file made without the run, as in `cameras.py`. Measured
lengths where the animal has some. Means of the views' MPJPE, over the joints that the truth has. One thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from cameras import as_seen, run_of
from markdown_table import print_table
from recordings import recordings
from trajectory import body_of, meta_of

from recon import FitSettings, Pose3D, read_pose3d
from recon.animal.detector import detector_toml
from recon.gait.evaluation import evaluate
from recon.workflows.clip import fit_clip

WITH_LENGTHS = ("jules", "phantom")
SHIPPED = "acinoset"
HEADER = ("recordings", "views", "taken by itself", "nothing said", "none", SHIPPED, f"{SHIPPED} of the other runs")


def mpjpe_mm(folder: Path, number: int, detector: str | None) -> tuple[float, str]:
    """Of one view, and the detector that was taken."""
    scene, meta = folder / "scene.json", meta_of(folder)
    motion = fit_clip(
        FitSettings(
            keypoints=(folder / f"cam{number}.csv",),
            camera=scene if scene.is_file() else folder / f"cam{number}.toml",
            fps=meta["fps"],
            subject=meta["subject"] if meta["subject"] in WITH_LENGTHS else None,
            detector=detector,
        )
    )
    pose = Pose3D(motion.names, motion.joints_m, motion.frames)
    return 1000 * evaluate(pose, read_pose3d(folder / "truth.csv")).mpjpe_m.mean, str(motion.body.detector)


def cells(kind: str, folders: Sequence[Path], without: dict[Path, Path]) -> list[object]:
    """One kind of recordings, as in `HEADER`. without: by run, the detector's file that the others make."""
    taken: set[str] = set()
    errors_mm: list[list[float]] = []
    for folder in folders:
        ways = [None, "none", SHIPPED, *([str(without[folder])] if folder in without else [])]
        for number in meta_of(folder)["cameras"]:
            found = [mpjpe_mm(folder, number, detector) for detector in ways]
            errors_mm.append([error for error, _ in found])
            taken.add(found[0][1])
    means = [f"{mean:.1f}" for mean in np.mean(errors_mm, axis=0)]
    return [kind, len(errors_mm), " and ".join(sorted(taken)), *means, *[""] * (4 - len(means))]


def runs_in(kind: str) -> list[Path]:
    return [path.parent for path in sorted(recordings(kind).resolve().glob("*/meta.json"))]


def main() -> None:
    known, plates = runs_in("cheetah-runs"), runs_in("plate-trials")
    if not known or not plates:
        raise SystemExit("no recordings")
    with tempfile.TemporaryDirectory() as made:
        without, runs = {}, [run_of(folder) for folder in known]
        for run in runs:
            without[run.folder] = Path(made) / f"{run.folder.name}.toml"
            body = as_seen(body_of(), run, runs, posed=True)
            without[run.folder].write_text(detector_toml(body, "without a run"), encoding="utf-8")
        print_table(HEADER, [cells("cheetah-runs", known, without), cells("plate-trials", plates, {})])


if __name__ == "__main__":
    main()
