"""Animals of 0.1 m, 1 m and 2 m before simulated cameras, with proportions that the skeleton does not know.

    python benchmarks/rigs.py [--animals mouse-top dog-27 human-25] [--seeds 4] [--cameras 4 1] [--refine]

Each clip draws lengths that are 0, 10, 20, 30 % (one standard deviation, each by itself, left as right) beside the
skeleton's, keypoints that lie beside their markers all the time, by half the skeleton's keypoint_sigma_m along each
axis, and a motion: every angle swings about its expected value, and the animal goes along a bent path, two thirds of
its length a second. Cameras: five lengths off, around it. Detections: 2 px of noise, one in twenty missing. Fitted with
each angle on its own. 90 %: the share of coordinates within the stated 90 % intervals, of positions and of poses; MPJPE
and MPE. --refine: what becomes of four cameras that are to be refined, with lengths as the skeleton's: as they are, all
but the first turned by 2 degrees, one turned by 15, and one with the pose of another; MPE as given and refined, and
whether the refined ones are taken, or the code of the finding. One thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from markdown_table import print_header, print_row
from scipy.spatial.transform import Rotation

from recon import Body, Camera, load_skeleton
from recon.animal.prior import ANGLES, prior_from_body
from recon.check import why_not_refined
from recon.clip import View, still_view
from recon.fit import TrajectoryOptions, TrajectorySolution, solve_trajectory
from recon.fit.posterior import radius
from recon.fit.shape import Shape
from recon.gait.evaluation import aligned
from recon.geometry.frames import rigid

FPS, T = 60.0, 72
WRONG = (0.0, 0.1, 0.2, 0.3)
BIAS = 0.5
"""The keypoints' bias, relative to keypoint_sigma_m."""
SIGMA_PX, MISSING = 2.0, 0.05


def length_m(body: Body) -> float:
    return float(np.ptp(posed(body, body.mean_rad[None], np.zeros((1, 4))), axis=1).max())


def posed(body: Body, angles: np.ndarray, root: np.ndarray) -> np.ndarray:
    """(T, J, 3)"""
    return body.tree.pose(np.concatenate([root, angles], axis=1)).points_m


def motion(body: Body, random: np.random.Generator) -> np.ndarray:
    """(T, D): states of the animal on its path, its lowest point about the ground."""
    time_s, n, long_m = np.arange(T) / FPS, body.n_state - 4, length_m(body)
    swing = np.sin(2 * np.pi * random.uniform(0.5, 2.0, n) * time_s[:, None] + random.uniform(0, 2 * np.pi, n))
    states = np.zeros((T, body.n_state))
    states[:, ANGLES] = body.mean_rad + 0.8 * body.sigma_rad * swing
    states[:, 3] = random.uniform(-np.pi, np.pi) + 0.6 * np.sin(2 * np.pi * 0.4 * time_s)
    ahead = np.stack([np.cos(states[:, 3]), np.sin(states[:, 3])], axis=1)
    states[:, :2] = np.cumsum(ahead, axis=0) * long_m / FPS / 1.5
    states[:, :2] -= states[:, :2].mean(axis=0)
    still = posed(body, body.mean_rad[None], np.zeros((1, 4)))
    states[:, 2] = -still[..., 2].min()
    return states


def rig(body: Body, count: int, random: np.random.Generator) -> list[Camera]:
    """Around the animal, which they look at, level, z up."""
    long_m, cameras = length_m(body), []
    for i in range(count):
        around = 2 * np.pi * (i + random.uniform(-0.2, 0.2)) / count
        centre_m = 5 * long_m * np.array([np.cos(around), np.sin(around), random.uniform(0.15, 0.5)])
        ahead = [0.0, 0.0, 0.3 * long_m] - centre_m
        ahead /= np.linalg.norm(ahead)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(ahead, right), ahead])
        lens = Camera.from_hfov(40.0, (1920, 1080), name=f"cam{i + 1}")
        cameras.append(replace(lens, rotation=rotation, translation_m=-rotation @ centre_m, world_z_up=True))
    return cameras


def clip(body: Body, wrong: float, count: int, seed: int) -> tuple[list[View], np.ndarray]:
    """Views of an animal, and where its markers are."""
    random = np.random.default_rng(seed)
    shape = Shape.of_body(body)
    factors = random.normal(size=len(shape)) * np.log1p(wrong)
    offsets = {marker: tuple(random.normal(0, BIAS * body.keypoint_sigma_m, 3)) for marker in body.markers}
    true = replace(shape.applied(body, factors), keypoint_offset_m=offsets)
    states = motion(true, random)
    seen_m, views = true.detected.pose(states).points_m, []
    for camera in rig(body, count, random):
        xy_px, valid = camera.project(camera.world_to_camera(seen_m))
        xy_px = xy_px + random.normal(0, SIGMA_PX, xy_px.shape)
        seen = valid & (random.uniform(size=valid.shape) > MISSING)
        views.append(still_view(camera, np.where(seen[..., None], xy_px, np.nan), seen.astype(float)))
    return views, true.tree.pose(states).points_m


def inside(error_m: np.ndarray, covariance_m2: np.ndarray) -> float:
    sigma_m = np.sqrt(np.diagonal(covariance_m2, axis1=2, axis2=3))
    return float(np.mean(np.abs(error_m) < radius(0.9) * sigma_m))


def scored(found: TrajectorySolution, true_m: np.ndarray) -> tuple[float, ...]:
    """Shares of positions and poses within the intervals, MPJPE and MPE in metres."""
    off, centred = found.joints_m - true_m, aligned(found.joints_m, true_m) - true_m
    errors = (float(np.linalg.norm(e, axis=2).mean()) for e in (centred, off))
    return inside(off, found.covariance_m2), inside(centred, found.relative_covariance_m2), *errors


def turned(view: View, degrees: float, random: np.random.Generator) -> View:
    axis = random.normal(size=3)
    turn = Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix()
    return replace(view, T_camera_world=rigid(turn, np.zeros(3)) @ view.T_camera_world)


def print_refined(animals: Sequence[str], seeds: Sequence[int]) -> None:
    print_header(("animal", "cameras", "MPE as given, mm", "refined", "taken"))
    for name in animals:
        body, options = load_skeleton(name), TrajectoryOptions(fast=True)
        for seed in seeds:
            (*views, last), true_m = clip(body, 0.0, 4, seed)
            random = np.random.default_rng(100 + seed)
            cases = {
                "as they are": [*views, last],
                "three turned by 2°": [views[0], *(turned(view, 2.0, random) for view in (*views[1:], last))],
                "one turned by 15°": [*views, turned(last, 15.0, random)],
                "one with another's pose": [*views, replace(last, T_camera_world=views[2].T_camera_world)],
            }
            for case, given in cases.items():
                held, found = (
                    solve_trajectory(given, body, prior_from_body(body), FPS, replace(options, refine_cameras=refine))
                    for refine in (False, True)
                )
                errors_mm = (f"{1000 * scored(of, true_m)[3]:.1f}" for of in (held, found))
                refused = why_not_refined(found, held)
                print_row((name, case, *errors_mm, refused[0].code if refused else "yes"))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--animals", nargs="+", default=["mouse-top", "dog-27", "human-25"])
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--cameras", nargs="+", type=int, default=[4, 1])
    parser.add_argument("--refine", action="store_true")
    given = parser.parse_args(arguments)
    if given.refine:
        print_refined(given.animals, range(given.first_seed, given.first_seed + given.seeds))
        return
    print_header(("animal", "cameras", "lengths beside, %", "position 90 %", "pose 90 %", "MPJPE, mm", "MPE, mm"))
    for count in given.cameras:
        for wrong in WRONG:
            every = []
            for name in given.animals:
                body, options = load_skeleton(name), TrajectoryOptions(fast=True)
                of_seeds = []
                for seed in range(given.first_seed, given.first_seed + given.seeds):
                    views, true_m = clip(body, wrong, count, seed)
                    of_seeds.append(scored(solve_trajectory(views, body, prior_from_body(body), FPS, options), true_m))
                place, pose, *errors_m = np.mean(of_seeds, axis=0)
                every.append((place, pose))
                print_row(
                    (
                        name,
                        count,
                        *(f"{100 * of:.0f}" for of in (wrong, place, pose)),
                        *(f"{1000 * e:.1f}" for e in errors_m),
                    )
                )
            print_row(("all", count, *(f"{100 * of:.0f}" for of in (wrong, *np.mean(every, axis=0))), "", ""))


if __name__ == "__main__":
    main()
