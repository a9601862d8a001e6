"""Test whether the findings name a camera that contradicts the others of its clip, and no other camera.

    python benchmarks/parts/agreement.py [FOLDER] [--only named effects]

FOLDER has one folder for each run, as in `cheetah_runs.py`; by default it is the cheetah-runs of $RECON_SHARED_DATA, or
of ../shared/data. Each unchanged run is checked first, so that every camera is compared with the others. Then one of
its cameras is turned by 5 degrees about each of its axes, or shifted in time by 10 frames, or the files of two cameras
are exchanged, for every camera and every pair. A case counts as correct if the findings name the change and the right
camera, and contain nothing else except findings on the unchanged run.

The part `effects` fits all cameras of each run, and some sets of four and three of them, untouched and with the last
camera late or turned (`FAULTS`). The table compares the stated effect of the camera with the change of the fit relative
to the untouched cameras, as medians of the ratio, and the verdict with the true error.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from arguments import parser_of, runs_or_exit
from markdown_table import print_table
from recordings import fit_settings, meta_of
from scipy.spatial.transform import Rotation
from wrong_inputs import Case, Change, Clip, Given, cameras_of, errors, fitted, measured

from recon import load_skeleton
from recon.api.clip_inputs import prepare
from recon.check.agreement import agreement_findings
from recon.check.codes import EFFECTS
from recon.check.verdict import evidence_of, expected_pose_of_trunk, expected_position
from recon.clip import View, views_of
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.motion import Motion
from recon.fit.result import Finding
from recon.geometry.frames import euler_rotation, rigid

SKELETON = "cheetah-24"
TURN_DEG, LAG = 5.0, 10
TRUNK_M = 0.7
"""Length of the trunk of a cheetah, m."""
NamedCase = tuple[str, list[View], str, tuple[int, ...]]
"""Name of the change, the changed views, the expected finding and the cameras that it should name."""


def views_of_run(run: Path) -> tuple[list[View], float]:
    """Return the views of all cameras of a run, and the frame rate."""
    given = prepare(fit_settings(run, meta_of(run)["cameras"], skeleton=SKELETON))
    return [view.mask_outside_image() for view in views_of(given.sources)], given.fps


def check_agreement(views: Sequence[View], fps: float) -> tuple[Finding, ...]:
    """Run the check of agreement on a stand-in for a fit, which has only the fields that the check reads."""
    sources = [SimpleNamespace(offset_frames=view.offset_frames, offset_s=0.0) for view in views]
    frames, solution = np.arange(len(views[0].xy_px)), SimpleNamespace(views=views)
    motion = SimpleNamespace(solution=solution, sources=sources, fps=fps, frames=frames, trunk_m=TRUNK_M)
    noise_m = load_skeleton(SKELETON).keypoint_sigma_m
    return agreement_findings(motion, TrajectoryOptions().sigma_px, noise_m)  # type: ignore[arg-type]


def cases(views: list[View]) -> Iterator[NamedCase]:
    def with_one(v: int, view: View) -> list[View]:
        return [*views[:v], view.mask_outside_image(), *views[v + 1 :]]

    for v, view in enumerate(views):
        for axis, name in enumerate(("tilted", "panned", "rolled")):
            yield f"{name} by {TURN_DEG:g} degrees", with_one(v, turned(view, axis)), "camera_turned", (v,)
        for frames in (LAG, -LAG):
            done = f"{LAG} frames {'late' if frames > 0 else 'early'}"
            yield done, with_one(v, late(view, frames)), "camera_late", (v,)
    for a, b in combinations(range(len(views)), 2):
        swapped = [*views]
        swapped[a], swapped[b] = (
            replace(views[here], xy_px=views[there].xy_px, confidence=views[there].confidence).mask_outside_image()
            for here, there in ((a, b), (b, a))
        )
        yield "two files exchanged", swapped, "cameras_exchanged", (a, b)


def turned(view: View, axis: int) -> View:
    rotation = euler_rotation(np.radians(TURN_DEG) * np.eye(3)[axis])
    return replace(view, T_camera_world=rigid(rotation, np.zeros(3)) @ view.T_camera_world)


def late(view: View, frames: int) -> View:
    """Return a view in which each frame has the detections of `frames` frames later."""
    xy_px, confidence = np.full_like(view.xy_px, np.nan), np.zeros_like(view.confidence)
    to, of = (slice(None, -frames), slice(frames, None)) if frames > 0 else (slice(-frames, None), slice(None, frames))
    xy_px[to], confidence[to] = view.xy_px[of], view.confidence[of]
    return replace(view, xy_px=xy_px, confidence=confidence)


def named(findings: Sequence[Finding], views: Sequence[View]) -> set[tuple[str, tuple[int, ...]]]:
    """Return the codes of all findings except notes, each with the indices of the cameras that it names."""
    names = [view.camera.name for view in views]
    return {
        (one.code, tuple(names.index(name) for name in one.names("cameras") or (str(one.camera),)))
        for one in findings
        if one.severity != "note"
    }


def last_late(frames: int) -> Change:
    """Return a change in which the last camera of a clip is late by a number of frames."""

    def change(clip: Clip, given: Given) -> Given:
        if given.camera.name != clip.cameras[-1] or not frames:
            return given
        return given.seen(given.xy_px[frames:], given.keypoints.frames[:-frames])

    return change


def last_turned(degrees: float) -> Change:
    """Return a change in which the pose of the last camera of a clip is turned about a random axis."""

    def change(clip: Clip, given: Given) -> Given:
        if given.camera.name != clip.cameras[-1]:
            return given
        axis = clip.rng.normal(size=3)
        return given.turned(Rotation.from_rotvec(np.radians(degrees) * axis / np.linalg.norm(axis)).as_matrix())

    return change


CODES = ("camera_turned", "camera_late", "camera_off")
"""Codes of findings that state the effect of a single camera."""
FAULTS: dict[str, Change] = {
    "untouched": last_late(0),
    "2 frames late": last_late(2),
    "4 frames late": last_late(4),
    "turned by 2 degrees": last_turned(2.0),
    "turned by 8 degrees": last_turned(8.0),
}


def camera_sets(run: Path) -> Iterator[tuple[str, ...]]:
    """Yield all cameras of a run, and two sets of four and three sets of three of them."""
    names = cameras_of(run)
    yield tuple(names)
    for count, number in ((4, 2), (3, 3)):
        sets = [*combinations(names, count)] if len(names) > count else []
        yield from (sets[i] for i in np.linspace(0, len(sets) - 1, min(number, len(sets))).astype(int))


@dataclass(frozen=True, eq=False)
class EffectRow:
    """Effect of the last camera of a clip on poses and positions, and the verdict on the clip."""

    stated_m: np.ndarray | None
    """Effects that a finding states, shape (2,), m; None without such a finding."""
    true_m: np.ndarray
    """Changes relative to the fit of the untouched cameras, shape (2,), m."""
    level: str
    in_usual_interval: bool
    """Whether the errors are at most the upper ends of the intervals that a clip without findings would have."""
    errors_m: np.ndarray
    """Errors of poses and positions, shape (2,), m."""
    bounds_m: np.ndarray
    """Upper ends of the verdict's intervals of these errors, shape (2,), m; infinite without an interval."""

    @property
    def is_use_beyond(self) -> bool:
        """Whether the verdict is "use" although an error is beyond its interval."""
        return self.level == "use" and bool((self.errors_m > self.bounds_m).any())


def effect_row(clip: Clip, motion: Motion, given: Given, untouched: Motion) -> EffectRow:
    """Compare a fit with the fit of the untouched cameras and with the truth."""
    _, rows, untouched_rows = np.intersect1d(motion.frames, untouched.frames, return_indices=True)
    changes_m = motion.joints_m[rows] - untouched.joints_m[untouched_rows]
    pose_mm, position_m = errors(changes_m[np.isfinite(changes_m).all(axis=(1, 2))])
    items = [item for item in motion.findings if item.code in CODES and {*EFFECTS} <= item.numbers.keys()]
    evidence, error, verdict = evidence_of(motion), measured(clip, given, motion), motion.verdict
    assert verdict is not None
    usual_m = expected_pose_of_trunk(evidence).high * evidence.trunk_m, expected_position(evidence).high
    stated_m = [np.inf if interval is None else interval.high for interval in (verdict.pose_m, verdict.position_m)]
    errors_m = np.array([error["pose_mm"] / 1000, error["position_m"]])
    return EffectRow(
        np.array([items[0].numbers[name] for name in EFFECTS]) if items else None,
        np.array([pose_mm / 1000, position_m]),
        verdict.level,
        bool((errors_m <= usual_m).all()),
        errors_m,
        np.array(stated_m),
    )


def print_effects(runs: Sequence[Path]) -> None:
    """Print the table of the part `effects`."""
    table: dict[str, list[EffectRow]] = {name: [] for name in FAULTS}
    for run in runs:
        for names in camera_sets(run):
            clip, motions = Clip(run, names), {}
            for name, change in FAULTS.items():
                with tempfile.TemporaryDirectory() as folder:
                    motions[name], given = fitted(clip, Case(change, two=True), Path(folder))
                table[name].append(effect_row(clip, motions[name], given, motions["untouched"]))
    cells = []
    for name, rows in table.items():
        ratios = [row.stated_m / row.true_m for row in rows if row.stated_m is not None and row.true_m.all()]
        levels = [row.level for row in rows]
        cells.append(
            [
                name,
                len(rows),
                ", ".join(f"{value:.2f}" for value in np.median(ratios, axis=0)) if ratios else "",
                " / ".join(str(levels.count(level)) for level in ("use", "check", "do not use")),
                sum(row.is_use_beyond for row in rows),
                sum(row.level == "do not use" and row.in_usual_interval for row in rows),
            ]
        )
    header = ["last camera", "clips", "stated / true change, poses, positions", "use / check / do not use"]
    print_table([*header, '"use", error beyond its interval', '"do not use", error within the usual'], cells)
    for name, rows in table.items():
        if beyond := [row for row in rows if row.is_use_beyond]:
            error_m, bound_m = (
                " to ".join(dict.fromkeys(f"{end(positions_m):.2f}" for end in (min, max)))
                for positions_m in zip(*((row.errors_m[1], row.bounds_m[1]) for row in beyond), strict=True)
            )
            print(f'{name}, "use" beyond: position errors of {error_m} m, upper ends of their intervals {bound_m} m')


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs", only=("named", "effects"))
    arguments = parser.parse_args()
    runs = runs_or_exit(parser, arguments.folder)
    if "named" in arguments.only:
        print_named(runs)
    if "effects" in arguments.only:
        print_effects(runs)


def print_named(runs: Sequence[Path]) -> None:
    """Print the tables of cameras that the findings name."""
    unchanged, right, total, seconds = [], {}, {}, {"as it is": [], "changed": []}
    for run in runs:
        views, fps = views_of_run(run)
        began = time.process_time()
        as_it_is = check_agreement(views, fps)
        seconds["as it is"].append(time.process_time() - began)
        notes = [SimpleNamespace(**one.numbers) for one in as_it_is if one.code == "camera_agreement"]
        for v, (view, found) in enumerate(zip(views, notes, strict=True)):
            says = [code for code, cameras in named(as_it_is, views) if v in cameras]
            unchanged.append(
                [
                    run.name,
                    view.camera.name,
                    *(f"{x:.2f}" for x in (found.level, np.degrees(found.turn_rad), found.level_turned)),
                    *(f"{x:.2f}" for x in (found.late_frames, found.level_late)),
                    ", ".join(says),
                ]
            )
        for done, changed, kind, cameras in cases(views):
            began = time.process_time()
            findings = named(check_agreement(changed, fps), changed)
            seconds["changed"].append(time.process_time() - began)
            ok = (kind, cameras) in findings and findings - {(kind, cameras)} <= named(as_it_is, views)
            for table, by in ((right, ok), (total, 1)):
                row = table.setdefault(done, {})
                row[run.name] = row.get(run.name, 0) + by
    print_table(["run", "camera", "level", "turn_deg", "level_turned", "late_frames", "level_late", "named"], unchanged)
    header = ["change of a camera or pair", *(run.name for run in runs)]
    print_table(header, [[done, *(f"{right[done][r]} of {n}" for r, n in row.items())] for done, row in total.items()])
    print("; ".join(f"{name}: {np.median(s):.2f} s (median)" for name, s in seconds.items()))


if __name__ == "__main__":
    main()
