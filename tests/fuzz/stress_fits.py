"""Fit extremely bad clips, and check that each fit ends in a sound result or in an `InputError`.

    python tests/fuzz/stress_fits.py [--fits 400] [--seed 0] [--only WORD ...]

Both methods, every built-in skeleton and four cameras are fitted to clips that are damaged in one way each (`SPOILT`).
Each result is written like `recon fit` does, without the playback, and must pass the checks of `faults`. The script
prints what failed, and ends with 1 if anything did. Warnings are errors.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from recon import FitSettings, InputError, fit_clip
from recon.animal.chain import builtin_chains
from recon.animal.skeleton_file import builtin_names, load_skeleton
from recon.clip import Keypoints
from recon.fit.motion import Motion
from recon.geometry.camera import Camera
from recon.io.camera_files import write_camera
from recon.io.deeplabcut import write_csv
from recon.show.plain import write_report
from recon.show.report import build_report
from recon.show.tables import write_tables
from recon.thesis.solution import FrameSolution

Array = NDArray[np.float64]
Rng = np.random.Generator

FURTHEST_M = 1000.0
"""Largest possible distance of a joint from the camera, metres, or ten times this if the animal's size is free."""
SECONDS, SECONDS_A_FRAME = 5.0, 0.5
"""Largest processor time of a fit, seconds, as a constant and a time per frame."""
FPS = 60.0
SIZE_PX = (1920, 1080)
CAMERAS = ("pinhole", "world", "fisheye", "radtan")


@dataclass(frozen=True)
class Spoiling:
    """A clip to damage: points (T, K, 2) in pixels, NaN if missing, and likelihoods (T, K)."""

    rng: Rng
    xy_px: Array
    likelihood: Array
    names: tuple[str, ...]

    @property
    def shape(self) -> tuple[int, int]:
        return self.likelihood.shape

    def some_frames(self, most: float) -> NDArray[np.bool_]:
        """Return a mask (T,) of random frames: at least one, and at most about the fraction `most`."""
        which = self.rng.uniform(size=len(self.xy_px)) < self.rng.uniform(0.0, most)
        which[self.rng.integers(len(which))] = True
        return which


def nothing(s: Spoiling) -> None:
    """Leave the points correct, with a little noise."""


def dropouts(s: Spoiling) -> None:
    s.xy_px[s.rng.uniform(size=s.shape) < s.rng.choice([0.2, 0.5, 0.8, 0.95])] = np.nan


def missing_frames(s: Spoiling) -> None:
    s.xy_px[s.some_frames(0.9)] = np.nan


def long_gap(s: Spoiling) -> None:
    s.xy_px[2:-2] = np.nan


def first_frame_only(s: Spoiling) -> None:
    s.xy_px[1:] = np.nan


def few_keypoints(s: Spoiling) -> None:
    """Keep the same one to five keypoints in every frame."""
    keep = s.rng.permutation(s.shape[1])[: s.rng.integers(1, 6)]
    s.xy_px[:, np.setdiff1d(np.arange(s.shape[1]), keep)] = np.nan


def swapped(s: Spoiling) -> None:
    """Exchange keypoints in some frames or in all."""
    order = s.rng.permutation(s.shape[1])
    which = s.some_frames(1.0)
    s.xy_px[which] = s.xy_px[which][:, order]


def mirrored(s: Spoiling) -> None:
    which = s.some_frames(1.0)
    s.xy_px[which, :, 0] = SIZE_PX[0] - s.xy_px[which, :, 0]


def outliers(s: Spoiling) -> None:
    """Move points thousands of pixels away, some of them outside the picture."""
    off = s.rng.normal(size=(*s.shape, 2)) * s.rng.choice([500.0, 3000.0, 30000.0])
    which = s.rng.uniform(size=s.shape) < s.rng.choice([0.02, 0.09, 0.3])
    s.xy_px[which] += off[which]


def outliers_inside(s: Spoiling) -> None:
    """Put points anywhere in the picture."""
    which = s.rng.uniform(size=s.shape) < s.rng.choice([0.1, 0.5, 1.0])
    s.xy_px[which] = s.rng.uniform((0, 0), SIZE_PX, (*s.shape, 2))[which]


def frame_outside(s: Spoiling) -> None:
    """Move all points of one or two frames far outside the picture."""
    for t in s.rng.integers(s.shape[0], size=s.rng.integers(1, 3)):
        s.xy_px[t] += s.rng.choice([-1.0, 1.0], 2) * s.rng.choice([2000.0, 2500.0, 4000.0, 1e6])


def frame_huge(s: Spoiling) -> None:
    """Give a frame coordinates that no picture has."""
    t = s.rng.integers(s.shape[0])
    s.xy_px[t] *= 10.0 ** s.rng.uniform(4, 300)


def all_huge(s: Spoiling) -> None:
    s.xy_px[...] *= 10.0 ** s.rng.uniform(1, 300)


def at_the_edge(s: Spoiling) -> None:
    """Move points to the edges of the picture."""
    s.xy_px[...] = np.clip(s.xy_px + s.rng.uniform(-2000, 2000, 2), (0, 0), np.array(SIZE_PX) - 1.0)


def leaves(s: Spoiling) -> None:
    """Let the animal run out of the picture, where a tenth of the points is still detected."""
    s.xy_px[..., 0] += np.linspace(0, 1500, s.shape[0])[:, None]
    outside = s.xy_px[..., 0] > SIZE_PX[0]
    s.xy_px[outside & (s.rng.uniform(size=s.shape) > 0.1)] = np.nan


def constant(s: Spoiling) -> None:
    """Repeat the same points in every frame, like a detector that hangs."""
    s.xy_px[...] = s.xy_px[0]


def all_equal(s: Spoiling) -> None:
    """Put every keypoint at the same point, in all frames or in some."""
    which = s.some_frames(1.0) if s.rng.uniform() < 0.5 else np.ones(s.shape[0], dtype=bool)
    s.xy_px[which] = s.rng.uniform((0, 0), SIZE_PX)


def all_equal_to_another(s: Spoiling) -> None:
    """Put pairs of keypoints at the same point, and leave out the rest."""
    s.xy_px[:, 1::2] = s.xy_px[:, :-1:2][:, : s.shape[1] // 2]


def on_a_line(s: Spoiling) -> None:
    """Flatten the animal to a line, upright or level."""
    axis = s.rng.integers(2)
    s.xy_px[..., axis] = SIZE_PX[axis] / 2


def tiny(s: Spoiling) -> None:
    """Shrink the animal to a few pixels, or to less than one."""
    middle = s.xy_px.mean(axis=(0, 1))
    s.xy_px[...] = middle + (s.xy_px - middle) * s.rng.choice([1e-12, 1e-6, 1e-3, 0.02])


def large(s: Spoiling) -> None:
    """Enlarge the animal beyond the picture; points outside are missing."""
    middle = s.xy_px.mean(axis=(0, 1))
    s.xy_px[...] = middle + (s.xy_px - middle) * s.rng.uniform(2, 20)
    s.xy_px[~((s.xy_px >= 0) & (s.xy_px < SIZE_PX)).all(axis=-1)] = np.nan


def upside_down(s: Spoiling) -> None:
    s.xy_px[..., 1] = SIZE_PX[1] - s.xy_px[..., 1]


def noise(s: Spoiling) -> None:
    s.xy_px[...] += s.rng.normal(size=s.xy_px.shape) * s.rng.choice([20.0, 100.0, 400.0])


def flicker(s: Spoiling) -> None:
    """Put the animal in two positions alternately."""
    s.xy_px[::2, :, 0] = np.clip(s.xy_px[::2, :, 0] + 900.0, 0, SIZE_PX[0] - 1)


def backwards(s: Spoiling) -> None:
    s.xy_px[...] = s.xy_px[::-1].copy()


def unlikely(s: Spoiling) -> None:
    """Set likelihoods to 0, to values between 0 and 1, and to NaN."""
    s.likelihood[...] = s.rng.choice([0.0, 0.5, 1.0, np.nan], s.shape)


def nothing_at_all(s: Spoiling) -> None:
    s.xy_px[...] = np.nan


SPOILT: tuple[Callable[[Spoiling], None], ...] = (
    *(nothing, dropouts, missing_frames, long_gap, first_frame_only, few_keypoints, swapped, mirrored, outliers),
    *(outliers_inside, frame_outside, frame_huge, all_huge, at_the_edge, leaves, constant, all_equal),
    *(all_equal_to_another, on_a_line, tiny, large, upside_down, noise, flicker, backwards, unlikely, nothing_at_all),
)
LENGTHS = (1, 2, 3, 4, 6, 12, 24, 40)
LONGEST = 200
"""Number of frames of the longest clips, one in forty, which have several segments and windows."""
RATES_HZ = (60.0, 60.0, 25.0, 400.0, 1.0, 1e4)
"""Stated frame rates, frames per second; the points always move as at `FPS`."""
ABSURD_RATES_HZ = (1e-300, 1e-3, 0.2, 0.5, 0.999, 10001.0, 1e5, 1e7, 1e300)
"""Stated frame rates of one in sixteen clips."""
NOISE_PX = (0.0, 2.0)
OPTIONS: dict[str, tuple[dict[str, Any], ...]] = {
    "frame": (
        {},
        {},
        {"form": "printed"},
        {"angle_prior": "none"},
        {"angle_prior": "none", "form": "printed", "camera_rotation": "fixed"},
        {"camera_rotation": "fixed"},
        {"base_sigma_m": 1e6},
        {"base_length_m": 1e-9},
        {"base_length_m": 2.0, "base_sigma_m": 1e-6},
        {"sigma_px": 1e-6, "keypoint_sigma_m": 0.0},
        {"sigma_px": 1e6},
    ),
    "trajectory": (
        {},
        {"fast": True},
        {"fast": True},
        {"fast": True, "prior": "none"},
        {"fast": True, "ground": "none"},
        {"fast": True, "size_sigma": 1e6},
        {"fast": True, "size_sigma": 1e-9},
        {"fast": True, "sigma_px": 1e-6, "keypoint_sigma_m": 0.0},
        {"fast": True, "sigma_px": 1e6},
    ),
}
"""Settings of the fit to try with each method; half of the clips have none."""


@dataclass(frozen=True)
class Case:
    """A fit of a damaged clip."""

    method: str
    """Method of the fit, "frame" or "trajectory"."""
    skeleton: str
    camera: str
    """One of `CAMERAS`."""
    spoilt: Callable[[Spoiling], None]
    """Function that damages the clip."""
    frames: int
    fps: float
    options: tuple[tuple[str, Any], ...]
    seed: int
    """Seed of all other random choices."""

    @property
    def name(self) -> str:
        clip = f"{self.frames} frames at {self.fps:g} fps"
        options = "".join(f", {name} {value}" for name, value in self.options)
        return (
            f"{self.method}, {self.skeleton}, {self.camera}, {self.spoilt.__name__}, {clip}{options}, seed {self.seed}"
        )


def camera_of(kind: str) -> Camera:
    """Return a level camera 1.5 m above the ground; only the kind "world" has this height in its file."""
    plain = Camera.from_hfov(60.0, SIZE_PX)
    if kind == "pinhole":
        return plain
    if kind == "world":
        rotation = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
        return Camera(
            kind, plain.matrix, plain.distortion, "pinhole", SIZE_PX, rotation, -rotation @ np.array([0.0, 0.0, 1.5])
        )
    matrix = np.array([[860.0, 0.0, 953.0], [0.0, 862.0, 546.0], [0.0, 0.0, 1.0]])
    if kind == "fisheye":
        return Camera(kind, matrix, np.array([0.12, -0.05, 0.015, -0.001]), "fisheye", SIZE_PX)
    return Camera(kind, matrix, np.array([-0.28, 0.07, 1e-3, -2e-3]), "radtan", SIZE_PX)


def clip_of(case: Case) -> tuple[Keypoints, Camera]:
    """Return the damaged clip of a case, in which an animal with swinging limbs crosses the picture, and its camera."""
    rng = np.random.default_rng(case.seed)
    body, camera = load_skeleton(case.skeleton), camera_of(case.camera)
    names = body.keypoint_names("right")
    time_s = np.arange(case.frames) / FPS
    states = np.zeros((case.frames, body.n_state))
    swing = np.sin(2 * np.pi * 3.0 * time_s[:, None] + rng.uniform(0, 6, body.n_state - 4))
    states[:, 4:] = body.mean_rad + 0.5 * swing * np.minimum(body.sigma_rad, 0.4)
    states[:, :3] = [0.0, rng.uniform(6, 14), -0.5]
    states[:, 0] += (time_s - time_s.mean()) * 9.0
    states[:, 3] = rng.uniform(-0.6, 0.6)
    level = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    xy_px, _ = camera.project(body.detected.pose(states).points_m @ level.T)
    xy_px += rng.normal(size=xy_px.shape) * rng.choice(NOISE_PX)
    likelihood = rng.uniform(0.8, 1.0, xy_px.shape[:2])
    with np.errstate(all="ignore"):
        case.spoilt(Spoiling(rng, xy_px, likelihood, names))
    likelihood[np.isnan(xy_px[..., 0])] = 0.0
    return Keypoints(tuple(names), xy_px, likelihood, np.arange(case.frames)), camera


def cases(count: int, seed: int) -> list[Case]:
    """Return `count` cases that cycle through the ways to damage a clip, with random skeletons and settings."""
    rng = np.random.default_rng(seed)
    fits = [("frame", name) for name in builtin_chains()] + [("trajectory", name) for name in builtin_names()]
    chosen = []
    for i in range(count):
        method, skeleton = fits[int(rng.integers(len(fits)))]
        frames, fps = int(rng.choice(LENGTHS)), float(rng.choice(RATES_HZ))
        options = OPTIONS[method][int(rng.integers(len(OPTIONS[method])))] if rng.uniform() < 0.5 else {}
        if i % 16 == 7:
            fps = float(rng.choice(ABSURD_RATES_HZ))
        if i % 40 == 9:
            frames, fps = LONGEST, FPS
        camera = str(rng.choice(CAMERAS))
        spoilt = SPOILT[i % len(SPOILT)]
        chosen.append(Case(method, skeleton, camera, spoilt, frames, fps, tuple(options.items()), seed + i))
    return chosen


@dataclass(frozen=True)
class Ended:
    """Outcome of a case (result, refused by an InputError, or broken), and the reasons if there is no result."""

    case: Case
    how: str
    why: tuple[str, ...]
    seconds: float


def run(case: Case) -> Ended:
    began = time.process_time()
    with warnings.catch_warnings(), tempfile.TemporaryDirectory() as folder:
        warnings.simplefilter("error")
        try:
            how, why = "result", faults_of(case, Path(folder))
        except InputError as error:
            how, why = "refused", tuple(str(problem) for problem in error.problems)
        except Exception:
            how, why = "broken", (traceback.format_exc(limit=-6),)
    seconds = time.process_time() - began
    if how == "result" and why:
        how = "broken"
    if seconds > SECONDS + SECONDS_A_FRAME * case.frames:
        how, why = "broken", (*why, f"it took {seconds:.0f} s")
    return Ended(case, how, why, seconds)


def faults_of(case: Case, folder: Path) -> tuple[str, ...]:
    """Fit a case, write its results, and return their faults; errors of the fit are raised."""
    keypoints, camera = clip_of(case)
    write_csv(keypoints, folder / "clip.csv")
    write_camera(camera, folder / "camera.toml")
    files = {"keypoints": folder / "clip.csv", "camera": folder / "camera.toml", "fps": case.fps}
    settings = FitSettings(method=case.method, skeleton=case.skeleton, **files, **dict(case.options))
    motion = fit_clip(settings)
    report = build_report(replace(motion, timing_s={"solve_s": 1.0}))
    write_report(report, folder / "report.json")
    write_tables(motion, folder)
    return tuple(faults(motion, report, folder))


def faults(motion: Motion, report: dict, folder: Path) -> list[str]:
    """List what is wrong with the result of a fit.

    A fault is an incomplete pose, a missing pose without a flag, a position that no camera can see, or NaN.
    """
    found = []
    joints, solved = motion.joints_camera_m, motion.solved
    if not (np.isfinite(joints[solved]).all() and np.isnan(joints[~solved]).all()):
        found.append("poses that are finite in part")
    if not (np.isfinite(motion.states[solved]).all() and np.isnan(motion.states[~solved]).all()):
        found.append("states that are not there where the pose is")
    furthest = float(np.max(np.abs(joints[solved]), initial=0.0))
    limit_m = FURTHEST_M * (10.0 if report["settings"].get("base_sigma_m") else 1.0)
    if furthest > limit_m:
        found.append(f"a joint {furthest:.3g} m away")
    if (report["root_path"]["exact"]["distance_m"] or 0.0) > 2 * limit_m * len(motion.frames):
        found.append(f"a path of {report['root_path']['exact']['distance_m']:.3g} m")
    flags = motion.flags
    bare = [t for t in np.flatnonzero(~solved) if not {"no data", "diverged"} & {*flags[t]}]
    if bare:
        found.append(f"no pose and no flag that says why in frames {bare[:5]}")
    quality = pd.read_csv(folder / "quality.csv", dtype=str, keep_default_na=False)
    if quality["flags"].tolist() != [";".join(names) for names in flags]:
        found.append("quality.csv and report.json have different flags")
    found += _numbers(motion, report)
    json.loads((folder / "report.json").read_text(encoding="utf-8"))
    return found


def _numbers(motion: Motion, report: dict) -> list[str]:
    found = []
    solution = motion.solution
    spreads = {"sigma": motion.joint_sigma_m, "weight": solution.weight, "noise": solution.noise_px}
    spreads["relative sigma"] = motion.relative_sigma_m
    expected, held = 1.0, report["settings"].get("size_sigma")
    if isinstance(solution, FrameSolution):
        chain = solution.chain
        expected = (report["settings"]["base_length_m"] or chain.nominal_base_length_m) / chain.nominal_base_length_m
    elif not np.isfinite(motion.joint_sigma_m[motion.solved]).all():
        found.append("poses without a sigma")
    if not (0.1 < solution.size / expected < 10 or held):
        found.append(f"a size of {solution.size:.3g}")
    found += [f"an infinite {name}" for name, values in spreads.items() if np.isinf(values).any()]
    angles = np.abs(motion.angles_rad[motion.solved])
    if np.max(angles, initial=0.0) > 100 * math.pi:
        found.append(f"an angle of {angles.max():.3g} rad")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fits", type=int, default=400)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", nargs="*", default=[], help="words that a case's name must have")
    arguments = parser.parse_args()
    chosen = [c for c in cases(arguments.fits, arguments.seed) if all(word in c.name for word in arguments.only)]
    ended = []
    for case in chosen:
        one = run(case)
        ended.append(one)
        if one.how == "broken":
            print(f"BROKEN: {case.name} ({one.seconds:.1f} s)", *one.why, sep="\n    ", flush=True)
    count = Counter(one.how for one in ended)
    slowest = max(ended, key=lambda one: one.seconds)
    print(f"{len(ended)} fits: {count['result']} results, {count['refused']} refused, {count['broken']} broken")
    print(f"slowest: {slowest.case.name}, {slowest.seconds:.1f} s")
    return 1 if count["broken"] else 0


if __name__ == "__main__":
    sys.exit(main())
