"""Audit real files unchanged and with one planted fault each, for 2D keypoints and 3D poses.

    python benchmarks/parts/audit.py [--details] [--seed 0]

The files are the cheetahs' views and 3D poses, the plate trials, windows of a dog's motion capture and of a rat's 3D
poses, a horse's hand labels and DeepLabCut's examples, all of $RECON_SHARED_DATA. A fault is planted if the file allows
it: a swap needs both sides, and gravity needs a flight. For each fault, the script prints the fraction of files in
which the audit names it, with the limits of `recon.check.audit` and with limits chosen on the other recordings. It also
prints the unchanged files that have findings. Real detectors also make the faults `points_jump` and `sides_swap`, so
the 3D truth of the views decides whether such a finding on an unchanged file is right.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from markdown_table import percent, print_table
from recordings import camera_of, meta_of, recordings

from recon import read_pose3d
from recon.animal.body import opposites
from recon.api.audit import audit_file
from recon.check.audit import CONSEQUENCES, LIMITS, measures_of
from recon.check.audited import AuditedPoints, roles_of
from recon.check.inputs import step_ratios
from recon.check.track_checks import jumps_of

LEAP_S = 0.4
WINDOW = 100
"""Number of frames of each file that is cut from a long recording."""
Fault = Callable[[AuditedPoints, np.random.Generator], AuditedPoints | None]


@dataclass(frozen=True)
class File:
    """A file of 2D keypoints or 3D poses, with its name, its recording, and the points as the audit reads them."""

    name: str
    source: str
    points: AuditedPoints
    expected_px: np.ndarray | None = None
    """True positions (T, K, 2) in the picture, pixels; NaN if unknown."""


def view_file(folder: Path, camera: str, fps: float) -> File:
    """Read the keypoints of one camera of a run, with the projections of the 3D truth as the expected positions."""
    points = audit_file(folder / f"{camera}.csv", fps=fps).points
    lens, pose = camera_of(folder, camera), read_pose3d(folder / "truth.csv")
    xy_px, is_in_front = lens.project(lens.world_to_camera(pose.xyz_m))
    xy_px[~is_in_front] = np.nan
    expected_px = np.full(points.positions.shape, np.nan)
    _, here, there = np.intersect1d(points.frames, pose.frames, return_indices=True)
    for k, name in enumerate(points.names):
        if name in pose.names:
            expected_px[here, k] = xy_px[there, pose.names.index(name)]
    return File(f"{folder.name}/{camera}", folder.name, points, expected_px)


def files() -> Iterator[File]:
    """Yield all files to audit: views and 3D poses of the recordings, hand labels and examples."""
    for folder in sorted(recordings("cheetah-runs").glob("*/")):
        fps = meta_of(folder)["fps"]
        for path in sorted(folder.glob("cam*.csv")):
            yield view_file(folder, path.stem, fps)
        yield File(f"{folder.name}/3D", folder.name, audit_file(folder / "truth.csv", fps=fps, unit="m").points)
    for folder in sorted(recordings("plate-trials").glob("*/")):
        for path in sorted(folder.glob("cam*.csv")):
            yield view_file(folder, path.stem, 200)
        yield File(f"{folder.name}/3D", folder.name, audit_file(folder / "truth.csv", fps=200, unit="m").points)
    names = tuple(json.loads((recordings("dog-mocap") / "joints.json").read_text())["joints"])
    roles = roles_of(names)
    for path in sorted(recordings("dog-mocap").glob("*_joint_pos.txt")):
        xyz = np.loadtxt(path, delimiter="," if "," in path.read_text()[:200] else None)
        xyz = xyz.reshape(len(xyz), -1, 3)
        xyz = np.stack([xyz[..., 0], -xyz[..., 2], xyz[..., 1]], axis=-1)
        for first in range(0, min(len(xyz) - WINDOW + 1, 4 * WINDOW), 2 * WINDOW):
            points = AuditedPoints(names, xyz[first : first + WINDOW], np.arange(WINDOW), 60.0, roles=roles)
            yield File(f"{path.stem[4:10]}+{first}", f"dog {path.stem[4:10]}", points)
    table = pd.read_csv(recordings("rat-poses") / "rat23.csv")
    names = tuple(dict.fromkeys(column[:-2] for column in table.columns if column.endswith("_x")))
    roles = roles_of(names)
    xyz = table[[f"{name}_{axis}" for name in names for axis in "xyz"]].to_numpy().reshape(len(table), len(names), 3)
    for first in range(0, len(xyz) - WINDOW + 1, 2 * WINDOW):
        points = AuditedPoints(names, xyz[first : first + WINDOW] / 1000, np.arange(WINDOW), 50.0, roles=roles)
        yield File(f"rat+{first}", f"rat {first}", points)
    horse = audit_file(recordings("horse-side") / "CollectedData_Byron.csv", fps=24)
    yield File("horse labels", "horse", horse.points)
    for path in sorted((recordings("importer-files") / "deeplabcut").glob("*single*.csv")):
        yield File(path.stem, path.stem, audit_file(path, fps=25).points)
    trc = recordings("importer-files") / "c3d-trc" / "markers.trc"
    points = audit_file(trc).points
    cut = changed(points, points.positions[:WINDOW], frames=points.frames[:WINDOW])
    yield File("markers.trc", "trc", cut)


def changed(points: AuditedPoints, values: np.ndarray, **more) -> AuditedPoints:
    """Return a copy of the points with new values, and with new frames or frame rate if given."""
    frames, fps = more.get("frames", points.frames), more.get("fps", points.fps)
    return AuditedPoints(points.names, values, frames, fps, points.resolution, points.roles)


def stretch(points: AuditedPoints, rng: np.random.Generator, share: float, least: int, inside: int = 2) -> slice:
    """Choose random consecutive frames for a fault, at least `inside` frames away from both ends of the file.

    Their number is the fraction `share` of all frames, but at least `least`.
    """
    T = len(points.frames)
    length = min(max(least, round(share * T)), T - 2 * inside)
    first = int(rng.integers(inside, T - length - inside + 1))
    return slice(first, first + length)


def seen_point(points: AuditedPoints, rows: slice, rng: np.random.Generator, moving: float = 0.0) -> int | None:
    """Choose a random point that is known in `rows` and moves there by more than `moving` times the animal's size."""
    known = points.known[rows].all(axis=0)
    path = np.linalg.norm(points.positions[rows.stop - 1] - points.positions[rows.start], axis=1)
    choice = np.flatnonzero(known & (np.nan_to_num(path) > moving * points.extent) & ~(points.stands & (moving > 0)))
    return int(rng.choice(choice)) if len(choice) else None


def copied_point(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    other = opposites(points.names)
    rows = stretch(points, rng, 0.25, 8)
    pairs = [k for k in range(len(other)) if other[k] != k and points.known[rows, k].sum() >= 6]
    if not pairs:
        return None
    k = int(rng.choice(pairs))
    values = points.positions.copy()
    values[rows, other[k]] = values[rows, k]
    return changed(points, values)


def frozen_frames(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    rows = stretch(points, rng, 0.1, 4)
    values = points.positions.copy()
    if points.known[rows.start - 1].sum() < 4:
        return None
    values[rows] = values[rows.start - 1]
    return changed(points, values)


def doubled_frames(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    values = np.repeat(points.positions, 2, axis=0)
    return changed(points, values, frames=np.arange(len(values)))


def frozen_point(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    for _ in range(20):
        rows = stretch(points, rng, 0.15, 6)
        k = seen_point(points, rows, rng, 0.05)
        if k is not None:
            values = points.positions.copy()
            values[rows, k] = values[rows.start, k]
            return changed(points, values)
    return None


def interpolated_point(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    for _ in range(20):
        rows = stretch(points, rng, 0.1, 7)
        k = seen_point(points, rows, rng, 0.02)
        if k is not None:
            values, n = points.positions.copy(), rows.stop - rows.start
            start, end = values[rows.start, k], values[rows.stop - 1, k]
            line = start + np.linspace(0, 1, n)[:, None] * (end - start)
            values[rows, k] = line if not points.resolution else np.round(line / points.resolution) * points.resolution
            return changed(points, values)
    return None


def without_jumps(points: AuditedPoints) -> AuditedPoints:
    """Remove the jumps that a real detector made, so that a planted jump is the only one."""
    for _ in range(10):
        is_jump = np.nan_to_num(jumps_of(points)) > 1
        if not is_jump.any():
            break
        points = changed(points, np.where(is_jump[..., None], np.nan, points.positions))
    return points


def jumping_point(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    points = without_jumps(points)
    often = np.flatnonzero(points.known.mean(axis=0) > 0.5)
    k = int(rng.choice(often))
    rows = rng.choice(np.flatnonzero(points.known[:, k])[2:-2], 3, replace=False)
    away = rng.normal(size=(3, points.positions.shape[2]))
    away *= (rng.uniform(0.3, 1.0, 3) * points.extent / np.linalg.norm(away, axis=1))[:, None]
    values = points.positions.copy()
    values[rows, k] += away
    return changed(points, values)


def dropped_frames(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    keep = np.flatnonzero(rng.random(len(points.frames)) > 0.3)
    scale = 1000 / points.extent if points.in_space else 1.0
    ratios = step_ratios(points.positions * scale)
    if ratios is None or len(ratios) < 40:
        return None  # too short, or the animal does not move
    return changed(points, points.positions[keep], frames=np.arange(len(keep)))


def swapped(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    other = opposites(points.names)
    left = np.flatnonzero(np.arange(len(other)) != other)
    rows = stretch(points, rng, 0.2, 5, inside=3)
    edges = points.known[[rows.start - 1, rows.start, rows.stop - 1, rows.stop]][:, left].all(axis=0)
    if edges.sum() < 6:
        return None
    values = points.positions.copy()
    values[rows] = values[rows][:, other]
    return changed(points, values)


def exchanged(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    other = opposites(points.names)
    has_sides = points.in_space and points.roles.trunk is not None and (other != np.arange(len(other))).sum() >= 6
    return changed(points, points.positions[:, other]) if has_sides else None


def longer_bone(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    if not points.in_space:
        return None
    rows = stretch(points, rng, 0.15, 5)
    k = seen_point(points, rows, rng)
    if k is None:
        return None
    values = points.positions.copy()
    away = values[rows, k] - np.nanmean(values[rows], axis=1)
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    values[rows, k] += 0.15 * points.extent * away
    return changed(points, values)


def drifting_size(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    if not points.in_space:
        return None
    grow = np.linspace(1.0, 1.25, len(points.frames))[:, None, None]
    return changed(points, points.positions * grow)


def wrong_unit(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    if points.in_space:
        return changed(points, points.positions * rng.choice([100.0, 1000.0, 0.001]))
    return None


def normalised(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    if points.in_space:
        return None
    return replace(changed(points, points.positions / np.array([1920.0, 1080.0])), resolution=0.0)


def y_up(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    if points.in_space or not any(measure.code == "keypoints_y_up" for measure in measures_of(points)):
        return None
    return changed(points, np.array([0.0, 1080.0]) + np.array([1.0, -1.0]) * points.positions)


def other_axis_up(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    if not points.in_space or len(points.roles.feet) < 2 or not points.roles.upper:
        return None
    x, y, z = np.moveaxis(points.positions, 2, 0)
    turned = [(x, z, -y), (x, -z, y), (x, -y, -z)][int(rng.integers(3))]
    return changed(points, np.stack(turned, axis=-1))


def with_leap(points: AuditedPoints) -> AuditedPoints | None:
    """Return the points with a leap of `LEAP_S` in their middle, because no recording has a flight of this length."""
    feet = points.roles.feet
    if not points.in_space or len(feet) < 4 or not points.roles.upper or not points.fps:
        return None
    n = round(LEAP_S * points.fps)
    if n > len(points.frames) - 4:
        return None
    first = (len(points.frames) - n) // 2
    time_s = np.arange(n + 1) / points.fps
    values = points.positions.copy()
    values[first : first + n + 1, :, 2] += (0.5 * 9.81 * time_s * (time_s[-1] - time_s))[:, None]
    return changed(points, values)


def other_rate(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    leaping = with_leap(points)
    if leaping is None or not any(measure.code == "gravity_unlikely" for measure in measures_of(leaping)):
        return None
    points = leaping
    return changed(points, points.positions, fps=(points.fps or 0) * rng.choice([0.5, 2.0, 4.0]))


def root_at_origin(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    slide = next((m for m in measures_of(points) if m.code == "feet_slide"), None)
    if not points.in_space or slide is None or points.roles.trunk is None:
        return None
    values = points.positions.copy()
    values[..., :2] -= values[:, points.roles.trunk[0], None, :2]
    return changed(points, values)


def bent_back(points: AuditedPoints, rng: np.random.Generator) -> AuditedPoints | None:
    joints = [joint for joint in points.roles.joints if joint.split("_")[-1] in ("elbow", "stifle", "hock")]
    if not points.in_space or points.roles.trunk is None or not joints:
        return None
    rows = stretch(points, rng, 0.15, 5)
    above, middle, below = points.roles.joints[str(rng.choice(joints))]
    values = points.positions.copy()
    bone = values[rows, middle] - values[rows, above]
    bone /= np.linalg.norm(bone, axis=1, keepdims=True)
    shin = values[rows, below] - values[rows, middle]
    sideways = shin - np.sum(shin * bone, axis=1, keepdims=True) * bone
    angle = np.arctan2(np.linalg.norm(sideways, axis=1), np.sum(shin * bone, axis=1))
    if not (np.degrees(angle) > 50).sum() >= 3:
        return None
    values[rows, below] = values[rows, middle] + shin - 2 * sideways
    return changed(points, values)


FAULTS: Mapping[str, tuple[Fault, tuple[str, ...]]] = {
    "point copied from the other side": (copied_point, ("points_identical",)),
    "frames frozen": (frozen_frames, ("detections_frozen",)),
    "every frame twice": (doubled_frames, ("detections_repeated",)),
    "point frozen": (frozen_point, ("point_frozen",)),
    "point interpolated": (interpolated_point, ("points_interpolated",)),
    "30 % of the frames dropped": (dropped_frames, ("frames_dropped",)),
    "left and right swapped in a stretch": (swapped, ("sides_swap",)),
    "left and right exchanged throughout": (exchanged, ("sides_exchanged",)),
    "one bone longer in a stretch": (longer_bone, ("lengths_change",)),
    "size that drifts by 25 %": (drifting_size, ("lengths_drift",)),
    "unit wrong by 100 or 1000": (wrong_unit, ("unit_unlikely",)),
    "keypoints from 0 to 1": (normalised, ("keypoints_normalised",)),
    "keypoints with y up": (y_up, ("keypoints_y_up",)),
    "another axis up": (other_axis_up, ("up_unlikely",)),
    "frame rate wrong by 2 or 4, with a leap": (other_rate, ("gravity_unlikely",)),
    "trunk held at the origin": (root_at_origin, ("feet_slide",)),
    "joint bent the other way": (bent_back, ("joint_beyond_range",)),
    "point jumps in three frames": (jumping_point, ("points_jump",)),
}


def values_of(points: AuditedPoints) -> dict[str, float]:
    """Audit points without limits, and return the largest measured value for each code of a finding."""
    values: dict[str, float] = {}
    for measure in measures_of(points):
        values[measure.code] = max(values.get(measure.code, -np.inf), measure.value)
    return values


def is_right(file: File, code: str) -> bool:
    """Return whether the truth confirms a finding on an unchanged file.

    A jump is right if the truth does not jump there. Swapped sides are right if, in some frames, the exchanged
    detections are nearer to the truth, summed over all points with a side.

    `code` is the code of the finding.
    """
    if file.expected_px is None:
        return False
    points, expected_px = file.points, file.expected_px
    if code == "points_jump":
        is_jump = np.nan_to_num(jumps_of(points)) > 1
        truth = changed(points, expected_px)
        return bool((is_jump & truth.known & ~(np.nan_to_num(jumps_of(truth)) > 1)).any())
    if code == "sides_swap":
        other = opposites(points.names)
        has_side = other != np.arange(len(other))
        by_name = np.linalg.norm(points.positions - expected_px, axis=2)
        exchanged_px = np.linalg.norm(points.positions[:, other] - expected_px, axis=2)
        gain = np.where(np.isfinite(by_name + exchanged_px), by_name - exchanged_px, 0.0)[:, has_side]
        return bool((gain.sum(axis=1) > 0).any())
    return False


def named_by(values: Mapping[str, float], limits: Mapping[str, float]) -> set[str]:
    """Return the codes of the findings whose measured values exceed their limits."""
    codes = {code for code, value in values.items() if value > limits[code]}
    return codes - {later for code in codes for later in CONSEQUENCES.get(code, ())}


def chosen_limits(untouched: Sequence[Mapping[str, float]], faulty: Mapping[str, Sequence[float]]) -> dict[str, float]:
    """Choose for each code the limit that best separates correct files from files with the fault."""
    limits = {}
    for code, fixed in LIMITS.items():
        right = np.array([values[code] for values in untouched if code in values])
        wrong = np.array(faulty.get(code, ()))
        if not len(right) or not len(wrong) or code in ("detections_repeated", "keypoints_normalised"):
            limits[code] = fixed
            continue
        candidates = np.unique(np.concatenate([right, wrong, [fixed]]))
        middles = 0.5 * (candidates[1:] + candidates[:-1])
        cost = [5 * np.mean(right > limit) + np.mean(wrong <= limit) for limit in middles]
        best = np.flatnonzero(np.isclose(cost, np.min(cost)))
        limits[code] = float(middles[best[len(best) // 2]])
    return limits


Values = dict[str, float]
"""Largest measured value of a file for each code of a finding."""


def untouched_values(all_files: Sequence[File]) -> dict[str, Values]:
    """Return the measured values of each file without a fault.

    Gravity is measured in a correct leap (`with_leap`), and jumps that the truth confirms are left out.
    """
    untouched = {file.name: values_of(file.points) for file in all_files}
    for file in all_files:
        leaping = with_leap(file.points)
        if leaping is not None and "gravity_unlikely" in (values := values_of(leaping)):
            untouched[file.name]["gravity_unlikely"] = values["gravity_unlikely"]
        if is_right(file, "points_jump"):
            untouched[file.name]["points_jump"] = values_of(without_jumps(file.points)).get("points_jump", 0.0)
    return untouched


def planted_values(all_files: Sequence[File], seed: int) -> dict[str, list[tuple[File, Values]]]:
    """Plant each fault in all files that allow it, and return for each fault the files with their measured values."""
    planted: dict[str, list[tuple[File, Values]]] = {name: [] for name in FAULTS}
    for f, (name, (fault, _)) in enumerate(FAULTS.items()):
        for i, file in enumerate(all_files):
            faulty = fault(file.points, np.random.default_rng([seed, f, i]))
            if faulty is not None:
                planted[name].append((file, values_of(faulty)))
    return planted


def limits_without(
    source: str,
    all_files: Sequence[File],
    untouched: Mapping[str, Values],
    planted: Mapping[str, Sequence[tuple[File, Values]]],
) -> Values:
    """Choose the limits of the audit on the files of all recordings except one."""
    right = [untouched[file.name] for file in all_files if file.source != source]
    wrong: dict[str, list[float]] = defaultdict(list)
    for name, (_, codes) in FAULTS.items():
        wrong_values = [values.get(codes[0], 0.0) for file, values in planted[name] if file.source != source]
        if wrong_values:
            wrong[codes[0]] += wrong_values
    return chosen_limits(right, wrong)


def print_faults(
    planted: Mapping[str, Sequence[tuple[File, Values]]], by_source: Mapping[str, Values], details: bool
) -> None:
    """Print how many planted faults are named, and with `details` also the faults that are missed."""
    rows, total, total_out, count = [], 0, 0, 0
    for name, (_, codes) in FAULTS.items():
        entries = planted[name]
        named = [bool(named_by(values, LIMITS) & {*codes}) for _, values in entries]
        named_out = [bool(named_by(values, by_source[file.source]) & {*codes}) for file, values in entries]
        total, total_out, count = total + sum(named), total_out + sum(named_out), count + len(named)
        if entries:
            rows.append([name, len(named), f"{np.mean(named):.0%}", f"{np.mean(named_out):.0%}"])
        if details:
            missed = [
                f"{file.name}: {values.get(codes[0], float('nan')):.3g} {sorted(named_by(values, LIMITS))}"
                for (file, values), is_named in zip(entries, named, strict=True)
                if not is_named
            ]
            print(f"missed {name} (limit {LIMITS[codes[0]]:g}):", *missed, sep="\n  ")
    rows.append(["all", count, f"{total / count:.0%}", f"{total_out / count:.0%}"])
    print_table(["fault", "files", "named", "named, by limits chosen without the recording"], rows)


def print_untouched(
    all_files: Sequence[File], untouched: Mapping[str, Values], by_source: Mapping[str, Values]
) -> None:
    """Print how many files without a planted fault have findings, and which of these the truth confirms."""
    false = {file.name: named_by(untouched[file.name], LIMITS) for file in all_files}
    false_out = {file.name: named_by(untouched[file.name], by_source[file.source]) for file in all_files}
    kinds = [sum(file.points.in_space for file in all_files), sum(not file.points.in_space for file in all_files)]
    print(f"\n{len(all_files)} untouched files: {kinds[1]} of 2D keypoints, {kinds[0]} of 3D poses.")
    by_name = {file.name: file for file in all_files}
    right_jumps = [file.name for file in all_files if is_right(file, "points_jump")]
    print(f"In {len(right_jumps)} views the detections jump, as the truth confirms.")
    tests = sum(map(len, untouched.values()))
    for title, named in (("limits of the package", false), ("limits chosen without the recording", false_out)):
        with_findings = {name: codes for name, codes in named.items() if codes}
        is_wrong = {n for n, codes in with_findings.items() if not all(is_right(by_name[n], code) for code in codes)}
        n = sum(map(len, with_findings.values()))
        fraction, of_checks = len(with_findings) / len(all_files), f"{n} of {tests} checks ({percent(n / tests, 1)})"
        print(f"Files with a finding, {title}: {len(with_findings)} ({percent(fraction)}), {of_checks};")
        print(
            f"{len(is_wrong)} of these are not confirmed by the truth ({percent(len(is_wrong) / len(all_files), 1)})."
        )
        for name, codes in with_findings.items():
            print(f"  {name}: {', '.join(sorted(codes))}{'' if name in is_wrong else ' (confirmed)'}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--details", action="store_true", help="measures of all files, and the faults that are missed")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    warnings.simplefilter("ignore", RuntimeWarning)
    all_files = [*files()]
    untouched = untouched_values(all_files)
    planted = planted_values(all_files, options.seed)
    sources = {file.source for file in all_files}
    by_source = {source: limits_without(source, all_files, untouched, planted) for source in sources}
    print_faults(planted, by_source, options.details)
    print_untouched(all_files, untouched, by_source)
    if options.details:
        table = pd.DataFrame(untouched).T.reindex(columns=[*LIMITS])
        print(table.to_string(float_format="%.2f"))
        print(pd.DataFrame(by_source).T.describe().T.to_string(float_format="%.2f"))


if __name__ == "__main__":
    main()
