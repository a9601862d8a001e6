"""Measure camera poses from the animal alone: `recon calibrate extrinsics`.

    python benchmarks/parts/extrinsics.py [FOLDER]

Each run is a folder as in `cheetah_runs.py`, used with all its cameras and their lenses but without their poses. Runs
with the same camera file are clips of one rig. The tables compare the relative rotations of all pairs of cameras, the
upward direction, and the distances from the first camera with the camera file. The tables also have the MPJPE over all
24 joints of a fit with the estimated cameras, after removing each pose's middle and one rotation of the world. The
keypoint bias is measured in the other runs. The rigs are also estimated from other detections, which are the truth's
projections plus parts of the detector's deviations. At the end, several clips are simulated, in which a run's motion
crosses the field of its cameras at other positions, in the same direction or in any direction. FOLDER is by default the
cheetah-runs of $RECON_SHARED_DATA, or of ../shared/data. The script runs in one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from cameras import PRIOR, Run, as_seen, cameras_of, errors, runs_given, solved
from markdown_table import print_table
from scipy.spatial.transform import Rotation
from trajectory import body_of, prior_of

from recon import Body
from recon.clip import View, still_view
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.extrinsics import Rig, search_offsets, solve_extrinsics
from recon.fit.trajectory import solve_trajectory

PARTS = {
    "projections of the truth": (0, 0, 0),
    "and white noise": (0, 0, 1),
    "and deviations, in another order": (0, 1, 1),
    "and deviations": (0, 1, 0),
    "and lasting deviations": (1, 0, 0),
}
"""Arguments `lasting`, `passing` and `random` of `with_parts` for each kind of simulated detections."""
CLIPS, SEEDS = (1, 2, 4, 8), (0, 1, 2)
SECTORS = 8
"""Number of sectors around the animal. A keypoint's bias depends on the sector from which the keypoint is seen."""
LASTING_M = 0.03
"""Standard deviation of a keypoint's bias along each axis, metres."""
PASSING_M = 0.03
"""Standard deviation of a keypoint's temporary deviations along each axis, metres."""
PASSING_S = 0.16
"""Correlation time of a temporary deviation, seconds, equal to `recon.fit.constants.ERROR_TIME_S`."""
WHITE_PX = 5.0
"""Standard deviation of the independent noise of detections, px."""
LEVEL_RAD = float(np.radians(1.0))
"""Standard deviation of the tilt and roll of cameras that were levelled or measured, rad."""
TOUCHED_DEG = (2.0, 5.0)
PUT_FRAMES = 6
"""Largest time offset, in frames, of cameras that are shifted in time."""
FIELD_M = 1.5
"""Largest displacement of a simulated path from the path of the run, along each axis, metres."""


def without_poses(views: Sequence[View], body: Body, fps: float, find_offsets: bool = False) -> ClipProblem:
    lenses = [replace(view.camera, rotation=None, translation_m=None) for view in views]
    bare = [still_view(lens, view.xy_px, view.confidence) for lens, view in zip(lenses, views, strict=True)]
    return ClipProblem.from_views(
        bare, body, prior_of(PRIOR), fps, TrajectoryOptions(find_offsets=find_offsets), ground_near_zero=False
    )


def estimated_rig(views: Sequence[Sequence[View]], bodies: Sequence[Body], fps: Sequence[float]) -> Rig:
    """Estimate the rig of cameras from their views without the poses in the camera file."""
    return solve_extrinsics([without_poses(*of) for of in zip(views, bodies, fps, strict=True)])


def with_poses(rig: Rig, views: Sequence[View]) -> list[View]:
    return [replace(view, T_camera_world=T) for view, T in zip(views, rig.T_camera_world, strict=True)]


def rig_errors(rig: Rig, own: Sequence[View]) -> dict[str, float]:
    """Compare a rig with the views' own poses: errors of rotations, degrees, and relative errors of distances."""
    views, apart = with_poses(rig, own), []
    for (a, own_a), (b, own_b) in combinations(zip(views, own, strict=True), 2):
        turns = [(v.T_camera_world @ np.linalg.inv(w.T_camera_world))[:3, :3] for v, w in ((a, b), (own_a, own_b))]
        apart.append(np.degrees(Rotation.from_matrix(turns[0] @ turns[1].T).magnitude()))
    far, own_far = (
        np.array([np.linalg.norm(view.centre_m[0] - of[0].centre_m[0]) for view in of[1:]]) for of in (views, own)
    )
    up, own_up = (of[0].T_camera_world[:3, 2] for of in (views, own))
    return {
        "rotation of pairs, median": float(np.median(apart)),
        "worst": float(np.max(apart)),
        "stated": float(np.degrees(np.median(rig.sigma[1:, :3]))),
        "error / stated": off_in_sigmas(views, own, rig.sigma),
        "up": float(np.degrees(np.arccos(np.clip(up @ own_up, -1, 1)))),
        "distances": float(np.mean(far / own_far - 1)),
    }


def off_in_sigmas(views: Sequence[View], own: Sequence[View], sigma: np.ndarray) -> float:
    """Return the RMS error of the poses of all cameras but the first, relative to the standard deviations (V, 6)."""
    off = []
    for view, of_file in zip(views[1:], own[1:], strict=True):
        T, own_T = (
            v.T_camera_world @ np.linalg.inv(first.T_camera_world) for v, first in ((view, views[0]), (of_file, own[0]))
        )
        by = T @ np.linalg.inv(own_T)
        off.append(np.concatenate([Rotation.from_matrix(by[:3, :3]).as_rotvec(), by[:3, 3]]))
    return float(np.sqrt(np.mean(np.square(off / sigma[1:]))))


def shown(row: dict[str, float]) -> dict[str, str]:
    units = {"distances": "{:+.1%}", "error / stated": "{:.1f}"}
    return {name: units.get(name, "{:.1f}°").format(value) for name, value in row.items()}


def rows_of(clips: Sequence[Run], runs: Sequence[Run]) -> list[dict]:
    """Estimate one rig from all clips, and return a row for each clip with the errors of rig and pose."""
    cameras = cameras_of(clips[0])["all"]
    views = [[run.views[camera] for camera in cameras] for run in clips]
    bodies = [as_seen(body_of(run.subject), run, runs) for run in clips]
    rig = estimated_rig(views, bodies, [run.fps for run in clips])
    rows = []
    for run, own, body in zip(clips, views, bodies, strict=True):
        with_found = with_poses(rig, own)
        solution = solve_trajectory(with_found, body, prior_of(PRIOR), run.fps, ground_near_zero=False)
        turned = replace(solution, joints_m=solution.joints_m @ _world_turn(with_found, own).T)
        row = {"clips": len(clips), "run": run.folder.name[:28], **shown(rig_errors(rig, own))}
        rows.append(row | {"MPJPE mm": f"{errors(run, turned)['mpjpe_mm']:.1f}"})
    return rows


def _world_turn(found: Sequence[View], views: Sequence[View]) -> np.ndarray:
    """Return the rotation of the estimated world that best aligns the cameras with the camera file."""
    turns = [own.T_camera_world[:3, :3].T @ view.T_camera_world[:3, :3] for view, own in zip(found, views, strict=True)]
    return Rotation.from_matrix(turns).mean().as_matrix()


def rigs(runs: Sequence[Run]) -> list[list[Run]]:
    """Group the runs by their camera file."""
    by_file: dict[bytes, list[Run]] = {}
    for run in runs:
        by_file.setdefault((run.folder / "scene.json").read_bytes(), []).append(run)
    return list(by_file.values())


def sizes(runs: Sequence[Run]) -> list[dict]:
    """Measure the animal's size relative to its measured lengths, with the file's cameras and almost no prior on it."""
    rows = []
    for run in runs:
        body = as_seen(body_of(run.subject), run, runs)
        free, held = solved(run, run.views, body, size_sigma=0.3), solved(run, run.views, body)
        mpjpe = f"{errors(run, held)['mpjpe_mm']:.1f}"
        size = f"{free.size:.2f} ± {free.size_sigma:.2f}"
        rows.append({"run": run.folder.name[:28], "size": size, "MPJPE mm, as measured": mpjpe})
    return rows


def with_parts(run: Run, view: View, lasting: int, passing: int, random: int, rng: np.random.Generator) -> View:
    """Replace the detections of a view by the truth's projections plus parts of the detector's deviations.

    Each of the arguments is 0 or 1. `lasting` adds the lasting deviation, the median over the clip for each keypoint.
    `passing` adds the rest of the deviations, in random order over the frames if `random` is 1 as well. `random` alone
    adds white noise as large as the rest.
    """
    projected, valid = view.project(run.truth_m)
    seen = view.present & valid & np.isfinite(run.truth_m[..., 0])
    off = np.where(seen[..., None], view.xy_px - projected, np.nan)
    always = np.zeros(off.shape[1:])
    for j in np.flatnonzero(seen.any(axis=0)):
        always[j] = np.median(off[seen[:, j], j], axis=0)
    rest = off - always
    if passing and random:
        for j, is_seen in enumerate(seen.T):
            rest[is_seen, j] = rng.permutation(rest[is_seen, j])
    elif random:
        rest = 1.4826 * np.nanmedian(np.abs(rest)) * rng.normal(size=rest.shape)
    xy_px = projected + lasting * always + max(passing, random) * rest
    return replace(view, xy_px=np.where(seen[..., None], xy_px, np.nan))


def causes(runs: Sequence[Run]) -> list[dict]:
    """Compare the errors of rigs estimated from one clip for each kind of detections, as means over the runs."""
    table = []
    for label, (lasting, passing, random) in PARTS.items():
        rows = []
        for i, run in enumerate(runs):
            own = [run.views[camera] for camera in cameras_of(run)["all"]]
            rng = np.random.default_rng(i)
            views = [with_parts(run, view, lasting, passing, random, rng) for view in own]
            body = as_seen(body_of(run.subject), run, runs) if lasting else body_of(run.subject)
            rows.append(rig_errors(estimated_rig([views], [body], [run.fps]), own))
        means = {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
        table.append({"detections": label, **shown(means)})
    return table


def levelled(run: Run, runs: Sequence[Run]) -> dict:
    """Estimate the rig of one clip if each camera's upward direction is known to a degree, and return its errors."""
    rng, own = np.random.default_rng(0), [run.views[camera] for camera in cameras_of(run)["all"]]
    setting, views = without_poses(own, as_seen(body_of(run.subject), run, runs), run.fps), []
    for bare, view in zip(setting.views, own, strict=True):
        turn = Rotation.from_rotvec(LEVEL_RAD * rng.normal(size=3)).as_matrix()
        rotation = turn @ view.T_camera_world[:3, :3]
        views.append(replace(bare, camera=replace(bare.camera, rotation=rotation, translation_m=np.zeros(3))))
    rig = solve_extrinsics([replace(setting, views=tuple(views))], level_rad=LEVEL_RAD)
    return {"run": run.folder.name[:28], **shown(rig_errors(rig, own))}


def out_of_step(clips: Sequence[Run], runs: Sequence[Run]) -> dict:
    """Shift cameras by whole frames, and compare the estimated offsets with the offsets of the unshifted clips."""
    cameras, rng = cameras_of(clips[0])["all"], np.random.default_rng(0)
    own = [[run.views[camera] for camera in cameras] for run in clips]
    given = [(as_seen(body_of(run.subject), run, runs), run.fps) for run in clips]

    def solved_at(views: Sequence[Sequence[View]]) -> Rig:
        settings = [without_poses(of, *its, find_offsets=True) for of, its in zip(views, given, strict=True)]
        return solve_extrinsics(settings)

    put = [np.append(0, rng.integers(-PUT_FRAMES, PUT_FRAMES + 1, len(cameras) - 1)) for _ in clips]
    late = [
        [began_later(view, k) for view, k in zip(of, frames, strict=True)] for of, frames in zip(own, put, strict=True)
    ]
    whole = [search_offsets(without_poses(of, *its)) for of, its in zip(late, given, strict=True)]
    label = ", ".join(run.folder.name[:28] for run in clips)
    refused = [f"cam{c}" for c, frames in zip(cameras, np.transpose(whole), strict=True) if np.isnan(frames).any()]
    if refused:
        return {"clips": label, "frames off, worst": f"refused: {', '.join(refused)}"}
    mended = [
        [began_later(view, -k) for view, k in zip(of, frames, strict=True)]
        for of, frames in zip(late, whole, strict=True)
    ]
    as_they_are, rig = solved_at(own), solved_at(mended)
    off = [
        frames + lags - k - unshifted
        for frames, lags, k, unshifted in zip(
            whole, rig.time_offset_frames, put, as_they_are.time_offset_frames, strict=True
        )
    ]
    degrees = {
        f"rotation of pairs, {name}": f"{rig_errors(of, own[0])['rotation of pairs, median']:.1f}°"
        for name, of in (("in step", as_they_are), ("found", rig))
    }
    return {"clips": label, "frames off, worst": f"{np.abs(np.concatenate(off)).max():.2f}", **degrees}


def began_later(view: View, frames: float) -> View:
    """Return the view of a camera that began `frames` frames later, so that its first picture shows a later moment."""
    at = np.arange(len(view.xy_px)) + int(frames)
    inside = (at >= 0) & (at < len(at))
    at = np.clip(at, 0, len(at) - 1)
    xy_px = np.where(inside[:, None, None], view.xy_px[at], np.nan)
    return replace(view, xy_px=xy_px, confidence=np.where(inside[:, None], view.confidence[at], 0.0))


def touched(clips: Sequence[Run], runs: Sequence[Run]) -> dict:
    """Turn one camera in the last clip, and return how far the clips disagree on the cameras' poses.

    Every second camera is turned in a separate trial. The row has the smallest and the largest disagreement for each
    angle.
    """
    cameras = cameras_of(clips[0])["all"]
    own = [[run.views[camera] for camera in cameras] for run in clips]
    bodies, fps = [as_seen(body_of(run.subject), run, runs) for run in clips], [run.fps for run in clips]
    row = {"clips": ", ".join(run.folder.name[:28] for run in clips)}
    row["as filmed"] = f"{estimated_rig(own, bodies, fps).disagreement.max():.0f}"
    for degrees in TOUCHED_DEG:
        apart = []
        for i in range(1, len(cameras), 2):
            last = [turned(view, degrees) if j == i else view for j, view in enumerate(own[-1])]
            apart.append(estimated_rig([*own[:-1], last], bodies, fps).disagreement.max())
        row[f"turned by {degrees:.0f}°"] = f"{min(apart):.0f} to {max(apart):.0f}"
    return row


def turned(view: View, degrees: float) -> View:
    """Return the view of a camera that is turned by `degrees` about the vertical axis of its picture."""
    rays, _ = view.camera.rays(view.xy_px)
    xy_px, valid = view.camera.project(
        np.nan_to_num(rays, nan=1.0) @ Rotation.from_euler("y", degrees, True).as_matrix().T
    )
    return replace(view, xy_px=np.where((valid & view.present)[..., None], xy_px, np.nan))


def crossing(run: Run, views: Sequence[View], offsets_m: np.ndarray, any_way: bool, rng: np.random.Generator):
    """Simulate views of the run's motion on another path through the field of the cameras.

    The path is shifted at random, and also turned at random if `any_way` is true. The bias of a keypoint depends on
    the sector from which the animal is seen: `offsets_m` (SECTORS, J, 2) along the axes of the picture.
    """
    known = np.isfinite(run.truth_m[:, 0, 0])
    motion = run.truth_m[known]
    middle, shift = motion.mean(axis=(0, 1)), np.append(rng.uniform(-FIELD_M, FIELD_M, size=2), 0.0)
    turn = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi) if any_way else 0.0).as_matrix()
    points = (motion - middle * [1, 1, 0]) @ turn.T + middle * [1, 1, 0] + shift
    way = points[-1].mean(axis=0) - points[0].mean(axis=0)
    return [_detected(view.part(known), points, way, offsets_m, run.fps, rng) for view in views]


def _detected(
    view: View, points: np.ndarray, way: np.ndarray, offsets_m: np.ndarray, fps: float, rng: np.random.Generator
) -> View:
    """Simulate a camera's detections of points (T, J, 3), metres, of an animal that moves in the direction `way`."""
    projected, valid = view.project(points)
    in_camera = view.to_camera(points)
    px_per_m = view.focal_px / np.maximum(in_camera[..., 2], 0.3)
    to_camera = (view.centre_m - points.mean(axis=1))[:, :2]
    side_rad = np.arctan2(to_camera[:, 1], to_camera[:, 0]) - np.arctan2(way[1], way[0])
    sector = np.floor(side_rad / (2 * np.pi) * SECTORS).astype(int) % SECTORS
    keep = np.exp(-1 / (PASSING_S * fps))
    passing, noise = np.empty(projected.shape), rng.normal(size=projected.shape)
    passing[0] = noise[0]
    for t in range(1, len(passing)):
        passing[t] = keep * passing[t - 1] + np.sqrt(1 - keep**2) * noise[t]
    off_m = LASTING_M * offsets_m[sector] + PASSING_M * passing
    xy_px = projected + px_per_m[..., None] * off_m + WHITE_PX * rng.normal(size=projected.shape)
    width, height = view.camera.image_size_px
    inside = valid & (in_camera[..., 2] > 0.5) & np.all((xy_px > 0) & (xy_px < (width, height)), axis=-1)
    return replace(view, xy_px=np.where(inside[..., None], xy_px, np.nan), confidence=inside.astype(float))


def simulated(run: Run) -> list[dict]:
    """Measure the errors of rigs estimated from 1, 2, 4 and 8 simulated clips, as means over the seeds."""
    views, body, table = [run.views[camera] for camera in cameras_of(run)["all"]], body_of(run.subject), []
    for any_way in (False, True):
        rows: dict[int, list[dict[str, float]]] = {}
        for seed in SEEDS:
            rng = np.random.default_rng(seed)
            offsets_m = rng.normal(size=(SECTORS, len(body.markers), 2))
            clips = [crossing(run, views, offsets_m, any_way, rng) for _ in range(max(CLIPS))]
            for count in CLIPS:
                rig = estimated_rig(clips[:count], [body] * count, [run.fps] * count)
                rows.setdefault(count, []).append(rig_errors(rig, views))
        for count, of in rows.items():
            means = {name: float(np.mean([row[name] for row in of])) for name in of[0]}
            table.append({"directions": "any" if any_way else "the same", "clips": count, **shown(means)})
    return table


def main() -> None:
    runs = runs_given(__doc__)
    groups = rigs(runs)
    real = [[run] for run in runs] + [group for group in groups if len(group) > 1]
    for title, rows in (
        ("Real clips", lambda: [row for clips in real for row in rows_of(clips, runs)]),
        ("One clip, cameras level to a degree", lambda: [levelled(run, runs) for run in runs]),
        ("The animal's size with the file's cameras", lambda: sizes(runs)),
        ("One clip, other detections", lambda: causes(runs)),
        ("Cameras shifted in time", lambda: [out_of_step(clips, runs) for clips in real]),
        ("Cameras turned in the last clip", lambda: [touched(clips, runs) for clips in real if len(clips) > 1]),
        ("Simulated clips", lambda: simulated(max(runs, key=lambda run: len(run.views) * len(run.truth_m)))),
    ):
        print(f"{title}\n")
        table = rows()
        names = max(map(list, table), key=len)
        print_table(names, [[row.get(name, "") for name in names] for row in table])


if __name__ == "__main__":
    main()
