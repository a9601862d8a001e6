"""Refine the poses of displaced cameras (`--set refine-cameras=true`), in fits and calibrations.

    python benchmarks/parts/refined_cameras.py [FOLDER]

Each run is a folder as in `cheetah_runs.py`, used with all cameras. All but the first camera, the named one, are turned
by 2 degrees about a random axis, and moved by 5 cm in a random direction. The refined poses are compared with poses
refined from the original poses, because the original poses are not exact either. Errors are over all 24 joints. The
first table compares all runs of one camera file together with each run alone; the keypoint bias is measured in the
other runs. The second table has means over the runs, each alone, with other detections: the truth's projections,
without noise and with white noise as large as the detector's deviations. FOLDER is by default the cheetah-runs of
$RECON_SHARED_DATA, or of ../shared/data. The script runs in one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from cameras import PRIOR, Run, as_seen, cameras_of, errors, runs_given
from changed_constants import holding
from extrinsics import off_in_sigmas, rigs, with_parts
from markdown_table import print_table
from scipy.spatial.transform import Rotation
from trajectory import body_of, prior_of

from recon import Body
from recon.clip import View
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.extrinsics import solve_extrinsics
from recon.fit.result import TrajectorySolution
from recon.fit.trajectory import solve_trajectory
from recon.geometry.frames import rigid

TURN_DEG, SHIFT_M, DRAWS = 2.0, 0.05, 3


def displaced(views: Sequence[View], rng: np.random.Generator) -> list[View]:
    """Turn and move all cameras except the first."""
    found = [views[0]]
    for view in views[1:]:
        axis, direction = (v / np.linalg.norm(v) for v in rng.normal(size=(2, 3)))
        turn = Rotation.from_rotvec(np.radians(TURN_DEG) * axis).as_matrix()
        found.append(replace(view, T_camera_world=rigid(turn, SHIFT_M * direction) @ view.T_camera_world))
    return found


def apart(views: Sequence[View], others: Sequence[View]) -> np.ndarray:
    """Return the pose differences (V - 1, 2), degrees and metres, between two rigs, without the first camera."""
    found = []
    for a, b in zip(views[1:], others[1:], strict=True):
        turn = Rotation.from_matrix(a.T_camera_world[:3, :3] @ b.T_camera_world[:3, :3].T).magnitude()
        found.append((np.degrees(turn), np.linalg.norm(a.centre_m[0] - b.centre_m[0])))
    return np.array(found)


def rows(run: Run) -> Iterator[dict]:
    """Refine the cameras of a run from the original and from displaced poses, and yield a row of errors for each."""
    body, prior, options = body_of(run.subject), prior_of(PRIOR), TrajectoryOptions()

    def solved(views: Sequence[View], refine: bool) -> TrajectorySolution:
        return solve_trajectory(views, body, prior, run.fps, replace(options, refine_cameras=refine))

    views = [run.views[camera] for camera in cameras_of(run)["all"]]
    as_they_are, refined = solved(views, False), solved(views, True)
    first = {
        "poses": "unchanged",
        "from the file's poses": _worst(apart(refined.views, views)),
        "from the refined file's poses": "",
        "MPJPE mm": errors(run, refined)["mpjpe_mm"],
        "not refined": errors(run, as_they_are)["mpjpe_mm"],
    }
    yield {"run": run.folder.name[:28], **first}
    for draw in range(DRAWS):
        wrong = displaced(views, np.random.default_rng(draw))
        found = solved(wrong, True)
        far, sigma = apart(found.views, refined.views), found.extrinsic_correction_sigma[1:]
        yield {
            "run": run.folder.name[:28],
            "poses": f"displaced, {draw + 1}",
            "from the file's poses": _worst(apart(found.views, views)),
            "from the refined file's poses": _worst(far),
            "MPJPE mm": errors(run, found)["mpjpe_mm"],
            "not refined": errors(run, solved(wrong, False))["mpjpe_mm"],
            "sigma": f"{np.degrees(sigma[:, :3].max()):.2f}°, {100 * sigma[:, 3:].max():.1f} cm",
            "error / stated": off_in_sigmas(found.views, views, found.extrinsic_correction_sigma),
        }


def together(clips: Sequence[Run], views: Sequence[Sequence[View]], bodies: Sequence[Body]) -> dict:
    """Refine a rig with all its clips from the original and from displaced poses, and return the differences.

    The row has the differences between poses, degrees and metres, as means over the draws, and the errors of the
    displaced cameras in stated standard deviations.
    """
    own = views[0]

    def refined(first: Sequence[View]) -> tuple[list[View], np.ndarray]:
        settings = []
        for run, of, body in zip(clips, views, bodies, strict=True):
            placed = [replace(view, T_camera_world=at.T_camera_world) for view, at in zip(of, first, strict=True)]
            settings.append(ClipProblem.from_views(placed, body, prior_of(PRIOR), run.fps, TrajectoryOptions()))
        rig = solve_extrinsics(settings, posed=True)
        return [replace(view, T_camera_world=T) for view, T in zip(first, rig.T_camera_world, strict=True)], rig.sigma

    in_place, sigma = refined(own)
    found = [refined(displaced(own, np.random.default_rng(draw))) for draw in range(DRAWS)]
    row: dict = {}
    for poses, other in (("the file's poses", own), ("the refined file's poses", in_place)):
        far = np.array([apart(one, other) for one, _ in found])
        row[f"from {poses}: median"] = np.median(far, axis=1).mean(axis=0)
        row[f"from {poses}: worst"] = far.max(axis=1).mean(axis=0)
    row["stated, median"] = np.median(sigma[1:].reshape(-1, 2, 3), axis=(0, 2)) * [180 / np.pi, 1]
    return row | {"error / stated": np.sqrt(np.mean([off_in_sigmas(at, own, stated) ** 2 for at, stated in found]))}


def detected_row(clips: Sequence[Run], runs: Sequence[Run]) -> dict:
    """Refine a rig with the detections of its clips, and return the errors of its cameras as a row."""
    cameras = cameras_of(clips[0])["all"]
    views = [[run.views[camera] for camera in cameras] for run in clips]
    row = together(clips, views, [as_seen(body_of(run.subject), run, runs) for run in clips])
    return {"clips": ", ".join(run.folder.name[:28] for run in clips)} | _shown(row)


def simulated_rows(runs: Sequence[Run]) -> Iterator[dict]:
    """Refine the cameras of each run alone with each kind of simulated detections, and yield the mean errors."""
    independent = {"ERROR_TIME_S": 0.0, "KEYPOINT_BIAS_SHARE": 0.0}
    for label, random, constants in (
        ("projections of the truth", 0, {}),
        ("and white noise", 1, {}),
        ("and white noise, which the fit assumes", 1, independent),
    ):
        rows = []
        for i, run in enumerate(runs):
            rng = np.random.default_rng(i)
            views = [with_parts(run, run.views[c], 0, 0, random, rng) for c in cameras_of(run)["all"]]
            with holding(**constants):
                rows.append(together([run], [views], [replace(body_of(run.subject), keypoint_spread_m={})]))
        yield {"detections": label} | _shown({name: np.mean([row[name] for row in rows], axis=0) for name in rows[0]})


def _shown(row: dict) -> dict[str, str]:
    return {n: _worst(value[None]) if np.ndim(value) else f"{value:.1f}" for n, value in row.items()}


def _worst(far: np.ndarray) -> str:
    return "{:.2f}°, {:.1f} cm".format(*(far * [1, 100]).max(axis=0))


def main() -> None:
    runs = runs_given(__doc__)
    groups = [[run] for run in runs] + [group for group in rigs(runs) if len(group) > 1]
    for table in ([detected_row(clips, runs) for clips in groups], list(simulated_rows(runs))):
        print_table(list(table[0]), [list(row.values()) for row in table])
    found = [row for run in runs for row in rows(run)]
    names = list(found[-1])
    print_table(
        names,
        [
            [f"{row.get(n, ''):.1f}" if isinstance(row.get(n), float) else row.get(n, "") for n in names]
            for row in found
        ],
    )


if __name__ == "__main__":
    main()
