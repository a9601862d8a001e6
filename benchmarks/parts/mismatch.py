"""Measure the cost of a prior that does not fit the motion, and whether the fit reports it.

    python benchmarks/parts/mismatch.py [--only dog|cheetah|segments]

Each clip is fitted with a prior from other motions and, for comparison, with independent angles as the skeleton's file
expects them (`--prior none`). "weight" is the weight that the prior kept, and "named" is whether the summary reports a
misfit.

- dog: the side views of `dog.py`, with the prior of the walking clips on clips with running and turning, and vice versa
- cheetah: the real views of `trajectory.py` with the subject's lengths and the detector acinoset, with a prior from the
  segments that `running-cheetah` leaves out as too slow, and with `running-cheetah` itself
- segments: the segments of `running-cheetah`, seen from the side with 2 px of noise, with the prior from the slow
  segments and with a prior from the other ten segments, for each segment left out. Findings with this second prior are
  false alarms

Without the recordings of $RECON_SHARED_DATA nothing is measured. The script runs in one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import dog
import numpy as np
import trajectory
from arguments import parser_of, runs_of
from recordings import recordings

from recon import Body, Camera
from recon.animal.prior import MotionPrior, load_prior, mean_speed_m_s, prior_from_body
from recon.animal.prior_fit import fit_prior
from recon.animal.skeleton_file import with_detector_offsets
from recon.clip import View, still_view
from recon.fit.points import solve_points
from recon.fit.result import TrajectorySolution
from recon.fit.trajectory import solve_trajectory
from recon.gait.evaluation import aligned, joint_errors, score
from recon.io.positions import read_pose_segments

FAST_M_S = 8.5
"""Smallest speed of the segments from which the prior `running-cheetah` was learned, m/s."""
APART = ("tail_1", "tail_2")
ASIDE_M, ABOVE_M = 8.0, 0.8
Rows = list[dict]


@dataclass(frozen=True, eq=False)
class Case:
    """A clip of one camera, and the true joints (T, J, 3) in the world, metres."""

    name: str
    body: Body
    view: View
    fps: float
    truth_m: np.ndarray


def fitted(case: Case, prior: MotionPrior) -> TrajectorySolution:
    return solve_trajectory([case.view], case.body, prior, case.fps)


def errors_mm(case: Case, solution: TrajectorySolution) -> tuple[float, float]:
    """Return the MPJPE and the MPE of a fit, mm."""
    found_m = solution.joints_m
    centred, off = (joint_errors(p, case.truth_m) for p in (aligned(found_m, case.truth_m), found_m))
    return 1000 * score(centred).mean, 1000 * score(off).mean


def row(case: Case, prior: MotionPrior, plain_mm: tuple[float, float]) -> dict:
    """Fit a clip with a prior, and compare the errors with `plain_mm`, MPJPE and MPE with independent angles."""
    solution = fitted(case, prior)
    mpjpe, mpe = errors_mm(case, solution)
    worst = max(solution.segments, key=lambda segment: segment.prior_misfit or 0.0)
    return {
        "clip": case.name,
        "frames": len(case.truth_m),
        "prior from": prior.name,
        "misfit": worst.prior_misfit,
        "weight": worst.prior_weight,
        "named": worst.unlike_prior,
        "mpjpe_mm": mpjpe,
        "alone mpjpe_mm": plain_mm[0],
        "times": mpjpe / plain_mm[0],
        "mpe_mm": mpe,
        "alone mpe_mm": plain_mm[1],
        "solve_s": solution.stage_s["all"],
    }


def table(title: str, rows: Rows) -> None:
    trajectory.print_table(title, rows)
    times, noticed = np.array([r["times"] for r in rows]), sum(r["named"] for r in rows)
    print(
        f"\nreported in {noticed} of {len(rows)}; mean MPJPE {np.mean([r['mpjpe_mm'] for r in rows]):.1f} mm, with "
        f"independent angles {np.mean([r['alone mpjpe_mm'] for r in rows]):.1f} mm; more than 1.1 times that in "
        f"{np.sum(times > 1.1)}, worst {times.max():.2f}"
    )


def compared(cases: Sequence[Case], priors: Sequence[MotionPrior], plain: MotionPrior) -> Iterator[dict]:
    """Fit each case with independent angles (`plain`) and with each prior, and yield a row for each prior."""
    for case in cases:
        alone_mm = errors_mm(case, fitted(case, plain))
        for prior in priors:
            yield row(case, prior, alone_mm)


def dogs(folder: Path) -> None:
    body, clips = dog.body_of(), dog.read_clips(folder)
    solved = dog.solve(clips)
    walking = [one for one in solved if "walk" in one.clip.name]
    moving = [one for one in solved if "walk" not in one.clip.name]
    for title, known, scored in (("running and turning", moving, walking), ("walking", walking, moving)):
        prior = learned(body, [(one.clip.name, one.states, one.clip.fps) for one in known], title)
        cases = [_dog(one.clip, clips.index(one.clip), body) for one in scored]
        table(f"dog, prior from {title}", list(compared(cases, [prior], prior_from_body(body))))


def _dog(clip: dog.Clip, seed: int, body: Body) -> Case:
    camera, _ = dog.side_view(clip)
    truth_m = clip.markers(body)
    return Case(clip.name, body, _seen(camera, truth_m, seed), clip.fps, truth_m)


def _seen(camera: Camera, points_m: np.ndarray, seed: int) -> View:
    px, _ = camera.project(camera.world_to_camera(points_m))
    px = px + np.random.default_rng(seed).normal(0, dog.NOISE_PX, px.shape)
    return still_view(camera, px, np.ones(px.shape[:2]))


def learned(body: Body, segments: Sequence[tuple[str, np.ndarray, float]], name: str) -> MotionPrior:
    return fit_prior(body, segments, name, apart=APART if body.name == trajectory.SKELETON else ())


def segments_of(folder: Path) -> list[tuple[str, np.ndarray, float]]:
    """Read the name, the states and the frame rate of each recorded segment of a running cheetah."""
    body = trajectory.body_of("phantom")
    poses = read_pose_segments(folder / "training_positions.csv")
    rates = json.loads((folder / "segments.json").read_text())["fps"]
    found = []
    for i, (pose, fps) in enumerate(zip(poses.values(), rates, strict=True)):
        at = [pose.names.index(marker) for marker in body.markers]
        found.append((str(i), solve_points(body, pose.xyz_m[:, at])[0], float(fps)))
    return found


def cheetahs(runs: Sequence[Path], segments: Sequence[tuple[str, np.ndarray, float]]) -> None:
    body = trajectory.body_of()
    slow = learned(body, [s for s in segments if mean_speed_m_s(s[1], s[2]) < FAST_M_S], "slow segments")
    cases = [_real(job) for job in trajectory.views(runs)]
    rows = list(compared(cases, [slow, load_prior(trajectory.PRIOR, body)], prior_from_body(body)))
    table("cheetah, prior from slow segments", [r for r in rows if r["prior from"] == slow.name])
    table("cheetah, running-cheetah", [r for r in rows if r["prior from"] != slow.name])


def _real(job: trajectory.Job) -> Case:
    camera, xy_px, confidence, truth_m = trajectory.view_of(job.run, job.camera)
    meta = trajectory.meta_of(job.run)
    body = with_detector_offsets(trajectory.body_of(meta["subject"]), "acinoset")
    view = still_view(camera, xy_px, np.where(np.isfinite(xy_px[..., 0]), confidence, 0.0))
    return Case(f"{job.run.name} {job.camera}", body, view, meta["fps"], camera.camera_to_world(truth_m))


def gallops(segments: Sequence[tuple[str, np.ndarray, float]]) -> None:
    body = trajectory.body_of("phantom")
    fast = [s for s in segments if mean_speed_m_s(s[1], s[2]) >= FAST_M_S]
    slow = learned(body, [s for s in segments if s not in fast], "slow segments")
    rows: Rows = []
    for one in fast:
        others = learned(body, [s for s in fast if s is not one], "other gallops")
        rows += compared([_from_the_side(one, body)], [slow, others], prior_from_body(body))
    table("segments, prior from slow segments", [r for r in rows if r["prior from"] == slow.name])
    table("segments, prior from the other gallops", [r for r in rows if r["prior from"] != slow.name])


def _from_the_side(segment: tuple[str, np.ndarray, float], body: Body) -> Case:
    """Simulate the detections of an animal that runs along x, seen from the side."""
    name, states, fps = segment
    points_m = body.tree.pose(states).points_m
    x, y, _ = points_m[-1].mean(axis=0) - points_m[0].mean(axis=0)
    along = np.array([[x, y, 0.0], [-y, x, 0.0], [0.0, 0.0, np.hypot(x, y)]]) / np.hypot(x, y)
    points_m = (points_m - points_m.mean(axis=(0, 1))) @ along.T
    points_m[..., 2] -= points_m[..., 2].min()
    camera, _ = dog.narrowest(points_m, np.array([0.0, -ASIDE_M, ABOVE_M]))
    return Case(f"segment {name}", body, _seen(camera, points_m, int(name)), fps, points_m)


def main() -> None:
    only = parser_of(__doc__, only=("dog", "cheetah", "segments")).parse_args().only
    clips, poses, real = (recordings(name) for name in ("dog-mocap", "cheetah-poses", "cheetah-runs"))
    runs = runs_of(real)
    if "dog" in only and clips.is_dir():
        dogs(clips)
    if poses.is_dir() and runs:
        segments = segments_of(poses)
        if "cheetah" in only:
            cheetahs(runs, segments)
        if "segments" in only:
            gallops(segments)


if __name__ == "__main__":
    main()
