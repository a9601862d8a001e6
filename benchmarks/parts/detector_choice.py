"""Measure which detector a fit assumes if none is given, and the resulting errors.

    python benchmarks/parts/detector_choice.py

Every view of cheetah-runs and plate-trials (in $RECON_SHARED_DATA, or ../shared/data) is fitted alone: without
`--detector`, with `none`, with the shipped detector file, and with a file made in the same way without the run, as in
`cameras.py`. Measured lengths are used if known. The table has the mean MPJPE of the views, over the joints of the
truth. Then the views are treated as if their detector were unknown: with `none`, and with the result of `recon subject
fit --no-lengths --offsets` on a number of other runs, with all their cameras. The script runs in one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from arguments import runs_of
from cameras import PRIOR, Run, as_seen, run_of, single_view_errors, with_detector
from markdown_table import print_header, print_row, print_table
from recordings import fit_settings, meta_of, recordings
from trajectory import body_of, prior_of

from recon import Body, Pose3D, read_pose3d
from recon.animal.measured import detector_toml
from recon.api.clip import fit_clip
from recon.fit.body_shape import Shape
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.shape import fit_shape
from recon.gait.evaluation import evaluate

WITH_LENGTHS = ("jules", "phantom")
SHIPPED = "acinoset"
HEADER = ("recordings", "views", "default detector", "no option", "none", SHIPPED, f"{SHIPPED} from the other runs")


def mpjpe_mm(folder: Path, number: int, detector: str | None) -> tuple[float, str]:
    """Fit one view, and return the MPJPE, mm, and the detector that the fit assumed."""
    subject = meta_of(folder)["subject"]
    known = subject if subject in WITH_LENGTHS else None
    motion = fit_clip(fit_settings(folder, [number], subject=known, detector=detector))
    pose = Pose3D(motion.names, motion.joints_m, motion.frames)
    return 1000 * evaluate(pose, read_pose3d(folder / "truth.csv")).mpjpe_m.mean, str(motion.body.detector)


def cells(kind: str, folders: Sequence[Path], without: dict[Path, Path]) -> list[object]:
    """Return the table row of one kind of recordings, with the columns of `HEADER`.

    `without` maps each run to the detector file that is made from the other runs.
    """
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


def measured(label: str, runs: Sequence[Run], bodies: dict[Run, Body]) -> None:
    """Print the errors of single views if the keypoint bias is measured in 0, 1, 2 ... other runs.

    `bodies` has the body of each run, with the animal's lengths.
    """
    plain = {run: np.array([row["mpjpe_mm"] for row in single_view_errors(run, bodies[run])]) for run in runs}
    print_row([label, 0, f"{np.mean(np.concatenate([*plain.values()])):.1f}", "", ""])
    for n in range(1, len(runs)):
        found = {}
        for i, run in enumerate(runs):
            others = tuple((*runs[i + 1 :], *runs[:i])[:n])
            body = with_detector(bodies[run], detector_of(others, {other: bodies[other] for other in others}))
            found[run] = np.array([row["mpjpe_mm"] for row in single_view_errors(run, body)])
        worse = np.concatenate([found[run] - plain[run] for run in runs])
        mean = np.mean(np.concatenate([*found.values()]))
        print_row([label, n, f"{mean:.1f}", f"{(worse > 0).sum()} of {len(worse)}", f"{worse.max():+.1f}"])


def detector_of(runs: Sequence[Run], bodies: dict[Run, Body]) -> Body:
    views = [(run, list(run.views.values())) for run in runs]
    clips = [
        ClipProblem.from_views(seen, bodies[run], prior_of(PRIOR), run.fps, TrajectoryOptions()) for run, seen in views
    ]
    return fit_shape(Shape.of_body(body_of(), lengths=False, offsets=True), clips).seen(body_of())


def main() -> None:
    known, plates = (runs_of(recordings(kind).resolve()) for kind in ("cheetah-runs", "plate-trials"))
    if not known or not plates:
        raise SystemExit("no recordings")
    with tempfile.TemporaryDirectory() as made:
        without, runs = {}, [run_of(folder) for folder in known]
        for run in runs:
            without[run.folder] = Path(made) / f"{run.folder.name}.toml"
            body = as_seen(body_of(), run, runs, posed=True)
            without[run.folder].write_text(detector_toml(body, "without a run"), encoding="utf-8")
        print_header(["recordings", "other runs", "MPJPE mean, mm", "views that are worse", "largest increase, mm"])
        measured("cheetah-runs", runs, {run: body_of(run.subject) for run in runs})
        trials = [run_of(folder) for folder in plates]
        measured("plate-trials", trials, {run: body_of() for run in trials})
        print_table(HEADER, [cells("cheetah-runs", known, without), cells("plate-trials", plates, {})])


if __name__ == "__main__":
    main()
