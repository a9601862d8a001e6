"""Fit every run of a folder with one, two and all of its cameras, and with lengths measured in other runs.

    python benchmarks/parts/cameras.py [FOLDER]

Each run is a folder as in `cheetah_runs.py`. "Two" means the named camera and the camera that sees the animal from the
most different direction. The keypoint bias is measured in the other runs, with all their cameras and the poses of the
reference, like `recon subject fit --no-lengths --offsets --poses`. One table also shows the result without the poses.
The shipped detector file, which was measured on all runs, is printed at the end. Errors are over all 24 joints. FOLDER
is by default the cheetah-runs of $RECON_SHARED_DATA, or of ../shared/data. The script runs in one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from arguments import parser_of, runs_or_exit
from changed_constants import options_with
from markdown_table import print_table
from recordings import fit_settings, meta_of, truth_at
from trajectory import SKELETON, body_of, prior_of

from recon import Body
from recon.animal.measured import detector_toml
from recon.api.clip_inputs import prepare
from recon.clip import Source, View, views_of
from recon.fit.body_shape import Shape
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.points import solve_points
from recon.fit.result import TrajectorySolution
from recon.fit.shape import POSED_OFFSET_SIGMA_M, fit_shape
from recon.fit.trajectory import solve_trajectory
from recon.geometry.kinematics import ROOT
from recon.testing.coverage import coverage

PRIOR = "running-cheetah"
FIXED = 1e-6
"""Standard deviation of a time offset (frames) or of an angle (rad), so small that it fixes the value at 0."""


@dataclass(frozen=True, eq=False)
class Run:
    """A run with the source and the view of each camera, and the true joints (T, J, 3) in the world, metres."""

    folder: Path
    sources: dict[int, Source]
    views: dict[int, View]
    truth_m: np.ndarray

    @property
    def named(self) -> int:
        return meta_of(self.folder)["monocular_camera"]

    @property
    def fps(self) -> float:
        return meta_of(self.folder)["fps"]

    @property
    def subject(self) -> str:
        return meta_of(self.folder)["subject"]


@cache
def run_of(folder: Path) -> Run:
    cameras = meta_of(folder)["cameras"]
    given = prepare(fit_settings(folder, cameras))
    truth_m = truth_at(folder, given.sources[0].keypoints.frames, body_of().markers)
    sources, views = given.sources, views_of(given.sources)
    return Run(folder, dict(zip(cameras, sources, strict=True)), dict(zip(cameras, views, strict=True)), truth_m)


def runs_given(about: str | None) -> list[Run]:
    """Load the runs of the folder that the command line names; `about` is the script's help."""
    parser = parser_of(about, kind="cheetah-runs")
    return [run_of(run) for run in runs_or_exit(parser, parser.parse_args().folder.resolve())]


def most_different(run: Run) -> int:
    """Return the camera whose direction from the animal differs most from the named camera's."""
    middle = np.nanmean(run.truth_m, axis=(0, 1))
    directions = {c: view.centre_m.mean(axis=0) - middle for c, view in run.views.items()}
    unit = {c: d / np.linalg.norm(d) for c, d in directions.items()}
    return min((c for c in unit if c != run.named), key=lambda c: float(unit[c] @ unit[run.named]))


def solved(run: Run, cameras: Iterable[int], body: Body, **options: object) -> TrajectorySolution:
    views = [run.views[c] for c in cameras]
    with options_with(options) as chosen:
        return solve_trajectory(views, body, prior_of(PRIOR), run.fps, chosen)


def errors(run: Run, solution: TrajectorySolution) -> dict[str, float]:
    off = solution.joints_m - run.truth_m
    centred = off - off.mean(axis=1, keepdims=True)
    regions = {"pose": (centred, solution.relative_covariance_m2), "position": (off, solution.covariance_m2)}
    return {
        "mpjpe_mm": 1000 * float(np.nanmean(np.linalg.norm(centred, axis=-1))),
        "mpe_mm": 1000 * float(np.nanmean(np.linalg.norm(off, axis=-1))),
        **{f"{what} inside 90 %": coverage(off_m, cov_m2, 0.9) for what, (off_m, cov_m2) in regions.items()},
        **{f"{what} inside 50 %": coverage(off_m, cov_m2, 0.5) for what, (off_m, cov_m2) in regions.items()},
        "size": solution.size,
        "size sigma": solution.size_sigma,
        "solve_s": solution.stage_s["all"],
    }


def log_distance_ratio(run: Run, solution: TrajectorySolution) -> float:
    """Return the mean logarithm of the ratio of the animal's estimated to its true distance from the first camera."""
    found, true = (
        np.linalg.norm(points_m.mean(axis=1) - solution.views[0].centre_m, axis=-1)
        for points_m in (solution.joints_m, run.truth_m)
    )
    return float(np.nanmean(np.log(found / true)))


def with_poses(run: Run, cameras: Iterable[int], body: Body) -> ClipProblem:
    """Build the fitting problem of some cameras of a run, with the poses and headings of the reference."""
    plain = ClipProblem.from_views([run.views[c] for c in cameras], body, prior_of(PRIOR), run.fps, TrajectoryOptions())
    return replace(plain, known_states=states_of(run, plain.origin_m))


def states_of(run: Run, origin_m: np.ndarray) -> np.ndarray:
    """Return the states (T, D) of the skeleton in the reference reconstruction, relative to an origin (3,), metres."""
    states = solve_points(body_of(run.subject), run.truth_m)[0]
    states[:, ROOT] -= origin_m
    return states


@cache
def _detector(runs: tuple[Run, ...], posed: bool) -> Body:
    """Return a body with the keypoint bias measured in some runs, in the reference's poses if `posed`."""
    settings = [with_poses(o, o.views, body_of(o.subject)) for o in runs]
    shape = Shape.of_body(body_of(), lengths=False, offsets=True)
    if posed:
        shape = replace(shape, offset_sigma_m=POSED_OFFSET_SIGMA_M)
    else:
        settings = [replace(one, known_states=None) for one in settings]
    return fit_shape(shape, settings).seen(body_of())


def as_seen(body: Body, run: Run, runs: Sequence[Run], posed: bool = False) -> Body:
    """Return a body with the keypoint bias measured in all runs except `run`, in the reference's poses if `posed`."""
    return with_detector(body, _detector(tuple(other for other in runs if other is not run), posed))


def with_detector(body: Body, of: Body) -> Body:
    """Return a body with the keypoint bias of another body."""
    return replace(
        body,
        keypoint_sigma_m=of.keypoint_sigma_m,
        keypoint_offset_m=of.keypoint_offset_m,
        keypoint_spread_m=of.keypoint_spread_m,
        keypoint_noise_m=of.keypoint_noise_m,
    )


def body_with_bias(what: str, run: Run, runs: Sequence[Run]) -> Body:
    """Return the subject's body with the keypoint bias of "other runs" or "this run", or without bias ("none")."""
    body = body_of(run.subject)
    if what == "none":
        return body
    others = tuple(other for other in runs if (other is run) == (what == "this run"))
    return with_detector(body, _detector(others, True))


def means(label: str, rows: Sequence[dict[str, float]]) -> dict:
    return {"cameras": label} | {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}


def cameras_of(run: Run) -> dict[str, list[int]]:
    others = [c for c in run.views if c != run.named]
    return {"one": [run.named], "two": [run.named, most_different(run)], "all": [run.named, *others]}


def true_size(run: Run) -> float:
    """Return the subject's size relative to the skeleton, as the mean ratio of its lengths to the skeleton's."""
    own, generic = (
        [np.linalg.norm(i.offset_m) for i in (*b.tree.segments, *b.tree.markers)]
        for b in (body_of(run.subject), body_of())
    )
    return float(np.sum(own) / np.sum(generic))


def accuracy(runs: Sequence[Run], known: bool, **options: float) -> list[dict]:
    """Measure the errors of fits from one, two and all cameras, with the subject's lengths if `known`."""
    rows: dict[str, list[dict[str, float]]] = {}
    for run in runs:
        body = as_seen(body_of(run.subject if known else None), run, runs, posed=True)
        for label, cameras in cameras_of(run).items():
            row = errors(run, solved(run, cameras, body, **options))
            rows.setdefault(label, []).append(row | {"size off": abs(row["size"] - (1.0 if known else true_size(run)))})
    return [means(label, found) for label, found in rows.items()]


def left_out(runs: Sequence[Run], known: str = "other runs", **options: float) -> list[dict]:
    """Leave out each camera once, and compare the pose from the other cameras with the camera's detections.

    The truth is projected into the camera and compared with the same detections. `known` states the source of the
    keypoint bias, as in `body_with_bias`.
    """
    rows = []
    for run in runs:
        found, true = [], []
        for camera, view in run.views.items():
            others = [c for c in run.views if c != camera]
            solution = solved(run, others, body_with_bias(known, run, runs), fast=True, **options)
            for points_m, out in ((solution.markers_m, found), (run.truth_m, true)):
                pixels, _ = view.project(view.shift_to_exposure(points_m))
                seen = view.present & np.isfinite(run.truth_m[..., 0]) & np.isfinite(solution.joints_m[..., 0])
                out.append(np.linalg.norm(pixels - view.xy_px, axis=-1)[seen])
        medians = [float(np.nanmedian(np.concatenate(values))) for values in (found, true)]
        rows.append(
            {"run": run.folder.name, "px": medians[0], "reference px": medians[1], "ratio": medians[0] / medians[1]}
        )
    return rows


def keypoints(runs: Sequence[Run]) -> list[dict]:
    """Measure the errors of fits from all cameras for each source of the keypoint bias."""
    found = []
    for known in ("none", "other runs", "this run"):
        rows = [errors(run, solved(run, cameras_of(run)["all"], body_with_bias(known, run, runs))) for run in runs]
        ratio = float(np.mean([row["ratio"] for row in left_out(runs, known)]))
        row = {"detector": known} | {name: value for name, value in means("all", rows).items() if name != "cameras"}
        found.append(row | {"left out": ratio})
    return found


def sideslips(runs: Sequence[Run]) -> list[dict]:
    """Compare the sideslip (from heading to direction of travel) of fits from all cameras with the reference."""
    rows = []
    for run in runs:
        body, known = body_of(run.subject), np.isfinite(run.truth_m).all(axis=(1, 2))
        rear, front = (run.truth_m[known][:, body.markers.index(marker)] for marker in body.forward)
        looks, goes = front - rear, np.gradient(run.truth_m[known].mean(axis=1), axis=0)
        apart = np.angle([complex(*g[:2]) / complex(*u[:2]) for g, u in zip(goes, looks, strict=True)])
        found = solved(run, list(run.views), as_seen(body, run, runs, posed=True))
        rows.append(
            {
                "run": run.folder.name,
                "reference, rad": f"{apart.mean():+.3f} ± {apart.std():.3f}",
                "all cameras": f"{found.sideslip_rad:+.3f} ± {found.sideslip_sigma_rad:.3f}",
            }
        )
    return rows


def time_offsets(runs: Sequence[Run]) -> list[dict]:
    """Estimate the time offset of each camera, in frames, in fits from all cameras."""
    rows = []
    for run in runs:
        found = solved(run, list(run.views), as_seen(body_of(run.subject), run, runs, posed=True)).time_offset_frames
        by_camera = dict(zip(run.views, found, strict=True))
        cameras = range(1, 1 + max(max(other.views) for other in runs))
        rows.append(
            {"run": run.folder.name} | {f"cam{c}": f"{by_camera[c]:+.2f}" if c in by_camera else "" for c in cameras}
        )
    return rows


def single_view_errors(run: Run, body: Body) -> list[dict[str, float]]:
    """Fit every view of a run alone, and return the errors of each fit."""
    found = []
    for camera in run.views:
        solution = solved(run, [camera], body)
        far = {"too far": log_distance_ratio(run, solution), "named": float(camera == run.named)}
        found.append(errors(run, solution) | far)
    return found


def over_views(rows: Sequence[dict[str, float]]) -> dict[str, object]:
    table = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    named = table["named"] > 0
    shares = [name for name in table if "inside" in name]
    return {
        "named mpjpe_mm": table["mpjpe_mm"][named].mean(),
        "named mpe_mm": table["mpe_mm"][named].mean(),
        "mpjpe_mm mean": table["mpjpe_mm"].mean(),
        "median": np.median(table["mpjpe_mm"]),
        "worst": table["mpjpe_mm"].max(),
        "mpe_mm mean": table["mpe_mm"].mean(),
        "mpe median": np.median(table["mpe_mm"]),
        "too far": f"{table['too far'].mean():+.1%}",
        "rms": f"{np.sqrt(np.mean(table['too far'] ** 2)):.1%}",
        "views too far": int((table["too far"] > 0).sum()),
        **{name: table[name].mean() for name in shares},
        "worst view, pose and position": f"{table[shares[0]].min():.2f} {table[shares[1]].min():.2f}",
        "solve_s": np.median(table["solve_s"]),
    }


def measured(runs: Sequence[Run]) -> list[dict]:
    """Compare fits of single views without keypoint bias and with the bias measured in the other runs."""
    found = []
    for label in ("none", "from the other runs, `subject fit`", "from the other runs, poses known"):
        rows = []
        for run in runs:
            body = body_of(run.subject)
            rows += single_view_errors(
                run, body if label == "none" else as_seen(body, run, runs, posed="known" in label)
            )
        found.append({"detector": label} | over_views(rows))
    return found


def by_run(runs: Sequence[Run]) -> list[dict]:
    """Return the errors of single views for each run, and for all runs except that run.

    The keypoint bias of a view is measured in the other runs.
    """
    of_run = {run: single_view_errors(run, as_seen(body_of(run.subject), run, runs, posed=True)) for run in runs}
    without = {run: [row for other in runs if other is not run for row in of_run[other]] for run in runs}
    return [{"views": f"of {run.folder.name}"} | over_views(of_run[run]) for run in runs] + [
        {"views": f"without {run.folder.name}"} | over_views(without[run]) for run in runs
    ]


def main() -> None:
    runs = runs_given(__doc__)
    for title, rows in (
        (f"Measured lengths of {SKELETON}", lambda: accuracy(runs, known=True)),
        ("Measured lengths, sideslip fixed at 0", lambda: accuracy(runs, known=True, SIDESLIP_RAD=FIXED)),
        (
            "Measured lengths, keypoint bias independent between cameras",
            lambda: accuracy(runs, known=True, COMMON_BIAS_SHARE=0.0),
        ),
        ("Size not known", lambda: accuracy(runs, known=False)),
        ("A camera left out: median reprojection error in it", lambda: left_out(runs)),
        ("All cameras, by the source of the keypoint bias", lambda: keypoints(runs)),
        ("Sideslip: direction of travel relative to the heading", lambda: sideslips(runs)),
        ("Measured lengths, time offsets fixed at 0", lambda: accuracy(runs, known=True, TIME_OFFSET_FRAMES=FIXED)),
        ("A camera left out, time offsets fixed at 0", lambda: left_out(runs, TIME_OFFSET_FRAMES=FIXED)),
        ("Time offsets with all cameras, frames", lambda: time_offsets(runs)),
        ("One camera, all views", lambda: measured(runs)),
        ("One camera, by run", lambda: by_run(runs)),
    ):
        show(title, rows())
    print(detector_toml(_detector(tuple(runs), posed=True), "the network and the labellers of AcinoSet"))


def show(title: str, rows: Sequence[dict]) -> None:
    print(f"{title}\n")
    print_table(list(rows[0]), [[f"{v:.3g}" if isinstance(v, float) else v for v in row.values()] for row in rows])


if __name__ == "__main__":
    main()
