"""Test fits of moving cameras, which pan or are driven along the path of the animal.

    python benchmarks/parts/moving.py [FOLDER]

Each run is a folder as in `cheetah_runs.py`. There are three tests:

- pan: the detections of every view are converted to detections of a camera that turns about an upright axis through its
  centre, so that the animal stays in the middle of the picture. The rays are turned back and projected through the same
  lens. Points outside the lens model's range are left out of both views
- with errors: as `pan`, but with white and drifting errors of the camera poses, whose size is stated
- driven: the truth is projected into the named camera without noise, once static and once driven at 10 m/s along the
  animal's path

Errors are over all 24 joints. FOLDER is by default the cheetah-runs of $RECON_SHARED_DATA, or of ../shared/data. The
script runs in one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from arguments import parser_of, runs_or_exit
from cameras import PRIOR, Run, errors, run_of
from changed_constants import options_with
from markdown_table import percent, print_header, print_row
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from trajectory import body_of, prior_of

from recon.clip import View, fill_from_nearest
from recon.fit import constants
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.result import TrajectorySolution
from recon.fit.terms import StanceVelocity
from recon.fit.trajectory import solve_trajectory
from recon.geometry.frames import rigid

SMOOTH_S = 0.1
"""Standard deviation (s) of the Gaussian that smooths the pan, because people do not follow an animal faster."""
WHITE_DEG, DRIFT_DEG_S = 0.05, 0.05
SPEED_M_S = 10.0
FAR_M = 10.0
"""Distance of the points on the rays, m, which has no effect if a camera turns about its centre."""


def panned(view: View, fps: float) -> tuple[View, View, int]:
    """Convert a view to a panning camera, and return view, panning view and the number of points left out of both."""
    rays, R, centre = view.rays(), view.T_camera_world[:3, :3], view.centre_m[0]
    middle = fill_from_nearest(_median(rays))
    azimuth = np.unwrap(np.arctan2(middle[:, 0], middle[:, 1])) - np.arctan2(R[2, 0], R[2, 1])
    azimuth = gaussian_filter1d(azimuth, SMOOTH_S * fps, mode="nearest")
    turn = np.tile(np.eye(3), (len(rays), 1, 1))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(azimuth)
    turn[:, 0, 1], turn[:, 1, 0] = -np.sin(azimuth), np.sin(azimuth)
    turned = R @ turn
    pan = replace(view, T_camera_world=rigid(turned, -(turned @ centre)))
    pan = replace(pan, xy_px=pan.project(centre + FAR_M * rays)[0])
    kept = view.seen & pan.seen
    lost = int((view.present & ~kept).sum())
    still, pan = (replace(one, xy_px=np.where(kept[..., None], one.xy_px, np.nan)) for one in (view, pan))
    return still, pan, lost


def _median(rays: np.ndarray) -> np.ndarray:
    """Return the median ray (T, 3) of each frame, NaN if nothing is seen."""
    middle = np.full((len(rays), 3), np.nan)
    seen = np.isfinite(rays[..., 0]).any(axis=1)
    middle[seen] = np.nanmedian(rays[seen], axis=1)
    return middle


def sigmas_m(solution: TrajectorySolution) -> np.ndarray:
    """Return the stated standard deviations of pose and of position, metres, RMS over all joints and frames."""
    return np.array(
        [
            np.sqrt(np.nanmean(np.trace(covariance, axis1=2, axis2=3)))
            for covariance in (solution.relative_covariance_m2, solution.covariance_m2)
        ]
    )


def with_pose_errors(pan: View, fps: float, seed: int) -> View:
    """Add errors to the camera poses of a pan, and state their standard deviation in the view."""
    T, rng = len(pan.xy_px), np.random.default_rng(seed)
    seconds = (np.arange(T) - T / 2)[:, None] / fps
    axis = rng.normal(size=3)
    off_deg = WHITE_DEG * rng.normal(size=(T, 3)) + DRIFT_DEG_S * seconds * axis / np.linalg.norm(axis)
    turned = Rotation.from_rotvec(np.radians(off_deg)).as_matrix() @ pan.T_camera_world[:, :3, :3]
    sigma_deg = np.hypot(WHITE_DEG, DRIFT_DEG_S * seconds[:, 0] / np.sqrt(3))
    poses = rigid(turned, -(turned @ pan.centre_m[..., None])[..., 0])
    return replace(pan, T_camera_world=poses, rotation_sigma_rad=np.radians(sigma_deg))


def pan_rows(run: Run, with_errors: bool = False) -> Iterator[dict]:
    body, prior = body_of(run.subject), prior_of(PRIOR)
    for camera, view in run.views.items():
        still, pan, lost = panned(view, run.fps)
        pan = with_pose_errors(pan, run.fps, camera) if with_errors else pan
        solutions = [solve_trajectory([one], body, prior, run.fps) for one in (still, pan)]
        a, b = (errors(run, solution) for solution in solutions)
        apart = np.linalg.norm(solutions[1].joints_m - solutions[0].joints_m, axis=-1)
        pose, position = sigmas_m(solutions[1]) / sigmas_m(solutions[0]) - 1
        axis = pan.T_camera_world[:, 2, :2]
        turned = np.degrees(np.ptp(np.unwrap(np.arctan2(axis[:, 0], axis[:, 1]))))
        yield {
            "run": run.folder.name[:28],
            "camera": camera,
            "turned by": f"{turned:.0f}°",
            "points": int(still.present.sum()),
            "left out": lost,
            "still MPJPE mm": f"{a['mpjpe_mm']:.1f}",
            "pan minus still": b["mpjpe_mm"] - a["mpjpe_mm"],
            "MPE, pan minus still": b["mpe_mm"] - a["mpe_mm"],
            "joints apart mm": 1000 * np.nanmean(apart),
            "pose sigma": pose,
            "position sigma": position,
            "pose inside 90 %": b["pose inside 90 %"] - a["pose inside 90 %"],
            "position inside 90 %": b["position inside 90 %"] - a["position inside 90 %"],
        }


PAN = {
    "pan minus still": "{:+.2f}",
    "MPE, pan minus still": "{:+.1f}",
    "joints apart mm": "{:.1f}",
    "pose sigma": "{:+.1%}",
    "position sigma": "{:+.1%}",
    "pose inside 90 %": "{:+.3f}",
    "position inside 90 %": "{:+.3f}",
}


def driven(run: Run, speed_m_s: float = SPEED_M_S) -> dict[str, View]:
    """Project the truth into the named camera, once static and once driven along the animal's path."""
    view, T = run.views[run.named], len(run.truth_m)
    known = np.flatnonzero(np.isfinite(run.truth_m).all(axis=(1, 2)))
    path = run.truth_m.mean(axis=1)
    way = (path[known[-1]] - path[known[0]]) * [1.0, 1.0, 0.0]
    seconds = (np.arange(T) - T / 2) / run.fps
    R = view.T_camera_world[:3, :3]
    centres = view.centre_m[0] + speed_m_s * seconds[:, None] * way / np.linalg.norm(way)
    moving = rigid(np.broadcast_to(R, (T, 3, 3)), -(centres @ R.T))
    views = {"still": view, "driven": replace(view, T_camera_world=moving)}
    seen = {name: one.project(run.truth_m)[0] for name, one in views.items()}
    return {
        name: replace(one, xy_px=seen[name], confidence=np.isfinite(seen[name][..., 0]).astype(float))
        for name, one in views.items()
    }


def driven_rows(run: Run) -> Iterator[dict]:
    body, prior = body_of(run.subject), prior_of(PRIOR)
    for size_sigma in (None, 10.0):
        for name, view in driven(run).items():
            options = TrajectoryOptions(size_sigma=size_sigma)
            solution = solve_trajectory([view], body, prior, run.fps, options)
            found = errors(run, solution)
            yield {
                "run": run.folder.name[:28],
                "camera": name,
                "sigma of the size beforehand": body.size_sigma if size_sigma is None else size_sigma,
                "MPJPE mm": f"{found['mpjpe_mm']:.1f}",
                "MPE mm": f"{found['mpe_mm']:.0f}",
                "size": f"{found['size']:.3f}",
                "its sigma": f"{found['size sigma']:.3f}",
                "from": " and ".join(solution.size_from),
            }


def size_rows(run: Run) -> Iterator[dict]:
    """Compare the size fitted in a driven camera's view for feet that may slip more or less, and for several priors."""
    body, prior = body_of(run.subject), prior_of(PRIOR)

    def size(sigma: float, slip_m_s: float, speed_m_s: float = SPEED_M_S) -> str:
        with options_with({"size_sigma": sigma, "SLIP_M_S": slip_m_s}) as options:
            found = solve_trajectory([driven(run, speed_m_s)["driven"]], body, prior, run.fps, options)
        return f"{found.size:.3f} ± {found.size_sigma:.2f}"

    feet_m = run.truth_m[:, [body.markers.index(foot) for foot in body.feet]]
    yield {
        "run": run.folder.name[:28],
        "slowest foot of the truth m/s": f"{np.nanmin(np.linalg.norm(np.diff(feet_m, axis=0), axis=-1)) * run.fps:.2f}",
        "by its feet, slip 2.5": f"{size_of_feet(run, feet_m, 2.5):.2f}",
        "slip 1": f"{size_of_feet(run, feet_m, 1.0):.2f}",
        "fitted, 30 % expected, slip 2.5": size(0.3, 2.5),
        "30 %, slip 1": size(0.3, 1.0),
        "nothing, slip 1": size(10.0, 1.0),
        "at 5 m/s, 30 %, slip 2.5": size(0.3, 2.5, 5.0),
        "at 2 m/s, 10 %, slip 2.5": size(0.1, 2.5, 2.0),
    }


def size_of_feet(run: Run, feet_m: np.ndarray, slip_m_s: float) -> float:
    """Return the relative size at which the feet (T, F, 3), m, move least in a driven camera's view."""
    centres = driven(run)["driven"].centre_m[:, None]
    stance = StanceVelocity(np.arange(feet_m.shape[1]), run.fps, slip_m_s, constants.SLIP_C)
    sizes = np.geomspace(0.5, 2.0, 201)
    losses = [np.nansum(stance.contact(centres + size * (feet_m - centres), 1.0)[1]) for size in sizes]
    return float(sizes[np.argmin(losses)])


def print_rows(rows: Iterator[dict]) -> list[dict]:
    """Print each row as soon as it is computed, and return all rows."""
    found = []
    for row in rows:
        if not found:
            print_header(list(row))
        found.append(row)
        print_row(PAN[name].format(value) if name in PAN else value for name, value in row.items())
    print(flush=True)
    return found


def print_summary(rows: Sequence[dict]) -> None:
    def worst(name: str) -> float:
        return max(abs(row[name]) for row in rows)

    def within(name: str, limit: float) -> int:
        return sum(abs(row[name]) <= limit for row in rows)

    lost, points = (sum(row[name] for row in rows) for name in ("left out", "points"))
    inside = ", ".join(f"{name} {np.mean([row[name] for row in rows]):+.3f}" for name in list(PAN)[-2:])
    print(
        f"{len(rows)} views: {lost} of {lost + points} points left out; MPJPE within 1 mm in "
        f"{within('pan minus still', 1.0)}, worst {worst('pan minus still'):.2f} mm; sigma of the pose within 3 % in "
        f"{within('pose sigma', 0.03)}, worst {percent(worst('pose sigma'), 1)}; of the position in "
        f"{within('position sigma', 0.03)}, worst {percent(worst('position sigma'), 1)}; "
        f"mean change of the fraction inside: {inside}\n",
        flush=True,
    )


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs")
    runs = [run_of(folder) for folder in runs_or_exit(parser, parser.parse_args().folder)]
    print("### A camera that pans\n")
    print_summary(print_rows(row for run in runs for row in pan_rows(run)))
    print("### A camera that pans, its poses known with errors\n")
    print_summary(print_rows(row for run in runs for row in pan_rows(run, with_errors=True)))
    print("### A camera driven along\n")
    print_rows(row for run in runs for row in driven_rows(run))
    print("### What determines the size\n")
    print_rows(row for run in runs for row in size_rows(run))


if __name__ == "__main__":
    main()
