"""Compare kinematics and gait of the samples with their formulas, and of real runs with other measurements.

    python benchmarks/parts/gait.py [FOLDER] [--held-out]

--held-out shows how `SPEED_ERROR` is chosen, the fraction of a foot's stated speed error by which a standing foot seems
to move. The choice is made on the stances of two of three kinds of recordings, and tested on the third kind.

In the samples, speeds and stance events of the true joints and of reconstructions are compared with the formula at 3600
fps. Each real run is a folder with truth.csv and meta.json (fps). The script prints the runs' gaits, and the mean
magnitudes of the links' motion relative to their parents. FOLDER is by default the cheetah-runs of $RECON_SHARED_DATA,
or of ../shared/data; without runs, only the samples are measured. Three more recordings come from the same folder: the
plate-trials, in which stances of single views and of the multi-camera reconstruction are compared with the force
plates; the dog-mocap with walks, runs and a turn, of which the markers and one side camera are analysed; and the
horse-side, which is labelled by hand.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd
from arguments import parser_of
from dog import Clip, marker_gait, read_clips, write_view
from markdown_table import print_table
from recordings import fit_settings, meta_of, recordings

import recon.gait.stances as method
from recon import FitSettings, Pose3D, fit_clip, read_pose3d
from recon.api.clip_results import run_clip
from recon.api.samples import samples_folder
from recon.fit.motion import Motion
from recon.fit.regions import radius
from recon.gait.clip import ClipAnalysis, analyse
from recon.gait.gait import Gait, gait, match_stances
from recon.gait.kinematics import joint_kinematics, spine_flexion
from recon.gait.phase import means_of_field, pose_vector_field
from recon.gait.stances import FEET, INTERVAL, Stance, pose_tracks, stances
from recon.testing.gallop import gallop

REFERENCE = "spine"
CHAINS = {
    "hind": ("spine", "tail_base", "{}_back_knee", "{}_back_ankle", "{}_back_paw"),
    "spine": ("tail_base", "spine", "neck_base"),
    "front": ("spine", "neck_base", "{}_front_knee", "{}_front_ankle", "{}_front_paw"),
}
"""Markers of the hind limb, the spine and the front limb, whose links are 6 to 8, 1, and 2 to 4 of cheetah-8u."""
LINKS = {"hind": "678", "spine": "1", "front": "234"}


def run_row(pose: Pose3D, fps: float) -> dict:
    """Describe the stances, strides and gait of one run in a table row."""
    tracks = pose_tracks(pose, fps)
    found = gait(tracks)
    ((_, plane),) = tracks.grounds
    whole = [s for s in found.stances if s.begins and s.ends]
    flexion = spine_flexion(pose, fps)
    return {
        "frames": len(pose.frames),
        "fps": f"{fps:g}",
        "speed_m_s": f"{found.speed_m_s:.1f}",
        "leg_m": f"{tracks.leg_m:.2f}",
        "stances": len(found.stances),
        "stance_ms": f"{1000 * np.mean([s.duration_s for s in whole]):.0f}" if whole else "-",
        "landed": " ".join(found.order),
        "strides": len(found.strides),
        "gait": found.name.name,
        "criterion": found.name.criterion,
        "slope_percent": f"{100 * np.hypot(*plane.slope):.1f}",
        "spread_mm": f"{1000 * plane.spread_m:.0f}",
        "flexion_deg": "{:+.0f} to {:+.0f}".format(*np.degrees(flexion.range_rad)),
    }


def link_speeds(pose: Pose3D, fps: float) -> dict[str, float]:
    """Return the mean speed of each link's tip relative to its parent, m/s, as the mean of both sides."""
    found = {}
    for limb, chain in CHAINS.items():
        fields = (pose_vector_field(pose, tuple(j.format(side) for j in chain), fps) for side in "lr")
        sides = [[means_of_field(field).speed_m_s for field in fields_of_side] for fields_of_side in fields]
        found |= dict(zip(LINKS[limb], np.mean(sides, axis=0).tolist(), strict=True))
    return found


FORMULA_FPS = 3600


def sample_rows() -> list[dict]:
    """Compare the samples' true joints with the formula, and the samples' reconstructions with the truth."""
    formula = gallop(fps=float(FORMULA_FPS), n_frames=29 * FORMULA_FPS // 30 + 1)
    fine = Pose3D(formula.names, formula.truth_m, np.arange(len(formula.truth_m)))
    clean, whole = (read_pose3d(samples_folder() / f"{name}_truth.csv") for name in ("clean", "whole"))
    rows = [sample_row("clean, true joints", clean, 30, fine, FORMULA_FPS, FEET)]
    fits = (
        ("noisy, frame method", {"method": "frame"}),
        ("noisy, trajectory method, same chain", {"skeleton": "cheetah-8u"}),
    )
    for name, options in fits:
        rows.append(fitted_row(name, "noisy", 30, options, fine, FORMULA_FPS))
    rows.append(fitted_row("whole, trajectory method", "whole", 60, {}, whole, 60))
    return rows


def fitted_row(name: str, sample: str, fps: int, options: dict, truth: Pose3D, truth_fps: int) -> dict:
    with tempfile.TemporaryDirectory() as folder:
        settings = FitSettings(
            keypoints=(samples_folder() / f"{sample}.csv",),
            camera=(samples_folder() / "camera.toml",),
            fps=fps,
            **options,
        )
        run_clip(settings, Path(folder) / "fit")
        found = analyse(Motion.load(Path(folder) / "fit"))
    row = sample_row(name, found.pose, fps, truth, truth_fps, found.motion.foot_names)
    sigma = found.joints[REFERENCE].speed_sigma_m_s
    return row | {"stated sigma m/s": "-" if np.isnan(sigma).all() else f"{np.nanmedian(sigma):.1f}"}


def sample_row(name: str, pose: Pose3D, fps: int, truth: Pose3D, truth_fps: int, feet: Mapping[str, str]) -> dict:
    moved, true = (joint_kinematics(p, REFERENCE, f) for p, f in ((pose, fps), (truth, truth_fps)))
    every = truth_fps // fps
    at_frames = moved.speed_m_s[::10], true.speed_m_s[:: 10 * every][: len(pose.frames)]
    of_joints = [
        joint_kinematics(pose, j, fps).peak_speed_m_s / joint_kinematics(truth, j, truth_fps).peak_speed_m_s - 1
        for j in pose.names
        if j in truth.names
    ]
    tracks = [pose_tracks(p, f, feet=feet) for p, f in ((pose, fps), (truth, truth_fps))]
    row = {
        "joints": name,
        "fps": fps,
        f"peak speed of {REFERENCE} m/s (error)": f"{moved.peak_speed_m_s:.2f} "
        f"({moved.peak_speed_m_s / true.peak_speed_m_s - 1:+.1%})",
        "mean (error)": f"{moved.mean_speed_m_s:.2f} ({moved.mean_speed_m_s / true.mean_speed_m_s - 1:+.1%})",
        "speed, rms error m/s": f"{np.sqrt(np.nanmean((at_frames[0] - at_frames[1]) ** 2)):.2f}",
        "stated sigma m/s": "-",
        "largest error of any joint's peak": f"{max(of_joints, key=abs):+.1%}",
        "peak acceleration m/s2 (true)": f"{moved.peak_acceleration_m_s2:.0f} ({true.peak_acceleration_m_s2:.0f})",
    }
    found, exact = (stances(t) for t in tracks)
    pairs = match_stances(exact, found)
    off = [fps * (b.start_s - a.start_s) for a, b in pairs if a.begins and b.begins]
    off += [fps * (b.end_s - a.end_s) for a, b in pairs if a.ends and b.ends]
    missed, extra = len(exact) - len(pairs), len(found) - len(pairs)
    row["stances: paired, missed, extra"] = f"{len(pairs)}, {missed}, {extra}"
    row["events: median, worst error, frames"] = (
        f"{np.median(np.abs(off)):.1f}, {np.max(np.abs(off)):.1f}" if off else "-"
    )
    return row


Events = list[tuple[float, float, bool]]
"""Delay of each event, s, standard deviation of its time, s, and whether it is a touch-down."""


def fitted(run: Path, camera: int) -> Motion:
    """Fit the view of one camera of a run."""
    return fit_clip(fit_settings(run, [camera]))


def found_gait(motion: Motion) -> Gait:
    found = ClipAnalysis(motion).gait
    assert found is not None
    return found


def events(found: Sequence[Stance], exact: Sequence[Stance]) -> Events:
    """Return the delays of touch-downs and lift-offs in the stances that both `found` and `exact` contain."""
    both = match_stances(exact, found)
    late = [(b.start_s - a.start_s, b.start_sigma_s, True) for a, b in both if a.begins and b.begins]
    return late + [(b.end_s - a.end_s, b.end_sigma_s, False) for a, b in both if a.ends and b.ends]


def plate_runs() -> list[Path]:
    """Return the runs whose stances were measured by force plates."""
    return sorted(path.parent for path in recordings("plate-trials").glob("*/stances.csv"))


def plate_stances(run: Path, fps: float) -> list[Stance]:
    measured = pd.read_csv(run / "stances.csv")
    rows = dict(zip(measured["joint"], measured.drop(columns="joint").to_numpy(float), strict=True))
    ends = [(foot, *map(float, rows[joint])) for foot, joint in FEET.items()]
    return [Stance(foot, down / fps, up / fps, down, up) for foot, down, up in ends]


def plate_rows() -> list[dict]:
    """Compare the stances of views with the force plates, and test the intervals of their ends."""
    kinds: dict[str, list[tuple[tuple[Stance, ...], list[Stance]]]] = {"single views": [], "reconstructions": []}
    for run in plate_runs():
        about = meta_of(run)
        exact = plate_stances(run, about["fps"])
        for camera in about["cameras"]:
            kinds["single views"].append((found_gait(fitted(run, camera)).stances, exact))
        found = stances(pose_tracks(read_pose3d(run / "truth.csv"), about["fps"]))
        kinds["reconstructions"].append((found, exact))
    return [event_row(kind, some) for kind, some in kinds.items() if some]


CANDIDATES = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8)


def held_out_rows(runs: Sequence[Path]) -> list[dict]:
    """Choose `SPEED_ERROR` on all kinds of recordings but one, and test the choice on the remaining kind.

    The criteria are the number of missed stances and the error of the median duration.
    """
    kinds: dict[str, list[tuple[Motion, Sequence[Stance]]]] = {"cheetahs over plates": [], "cheetahs": [], "a dog": []}
    for run in plate_runs():
        about = meta_of(run)
        exact = plate_stances(run, about["fps"])
        kinds["cheetahs over plates"] += [(fitted(run, camera), exact) for camera in about["cameras"]]
    for run in runs:
        about = meta_of(run)
        exact = stances(pose_tracks(read_pose3d(run / "truth.csv"), about["fps"]))
        kinds["cheetahs"] += [(fitted(run, camera), exact) for camera in about["cameras"]]
    kinds["a dog"] = [
        (motion, marked.stances) for clip, marked, motion in dog_gaits() if not clip.name.startswith("turn")
    ]
    rows, found, before = [], {}, method.SPEED_ERROR
    for fraction in CANDIDATES:
        method.SPEED_ERROR = fraction
        found[fraction] = {
            kind: event_row(kind, [(found_gait(motion).stances, exact) for motion, exact in some])
            for kind, some in kinds.items()
            if some
        }
    method.SPEED_ERROR = before

    def off(row: dict) -> float:
        return row["missed"] / row["stances"] + abs(float(row["duration / measured"]) - 1)

    for kind in (*found[before], "none"):
        others = {s: sum(off(row) for other, row in of.items() if other != kind) for s, of in found.items()}
        best = min(others, key=others.__getitem__)
        if kind in found[best]:
            rows.append({"left out": kind, "best for the others": best} | found[best][kind])
        else:
            print(f"By all of them: {best}\n")
    return rows


def event_row(kind: str, some: Sequence[tuple[Sequence[Stance], Sequence[Stance]]]) -> dict:
    late = [event for found, exact in some for event in events(found, exact)]
    pairs = [pair for found, exact in some for pair in match_stances(exact, found)]
    down, up = (1000 * np.array([off for off, _, lands in late if lands == which]) for which in (True, False))
    whole = [(a, b) for a, b in pairs if b.begins and b.ends and a.begins and a.ends]
    known = np.array([abs(off) < radius(INTERVAL) * sigma for off, sigma, _ in late])
    return {
        "of": kind,
        "stances": sum(len(exact) for _, exact in some),
        "missed": sum(len(exact) for _, exact in some) - len(pairs),
        "touch-down late ms: median, absolute": f"{np.median(down):+.1f}, {np.median(np.abs(down)):.1f}",
        "lift-off late ms: median, absolute": f"{np.median(up):+.1f}, {np.median(np.abs(up)):.1f}",
        "duration / measured": f"{np.median([b.duration_s / a.duration_s for a, b in whole]):.2f}",
        "sigma ms, median": f"{1000 * np.median([sigma for _, sigma, _ in late]):.0f}",
        "in intervals of 90 %": f"{known.mean():.0%}",
    }


@cache
def run_gaits(runs: tuple[Path, ...]) -> tuple[tuple[Gait, Gait], ...]:
    """Fit each single view of the runs, and return its gait and the gait of the run from all cameras."""
    found = []
    for run in runs:
        about = meta_of(run)
        exact = gait(pose_tracks(read_pose3d(run / "truth.csv"), about["fps"]))
        found += [(found_gait(fitted(run, camera)), exact) for camera in about["cameras"]]
    return tuple(found)


def named_views(runs: Sequence[Path]) -> str:
    """Return a sentence on how many views get a gait name, and how often all cameras give the same name."""
    pairs = [(seen.name.name, exact.name.name) for seen, exact in run_gaits(tuple(runs))]
    named = [(seen, exact) for seen, exact in pairs if seen != "unknown"]
    same = sum(seen == exact for seen, exact in named)
    return f"{len(pairs)} views: {len(named)} get the name of a gait, {same} of them the same as from all cameras"


def view_rows(runs: Sequence[Path]) -> list[dict]:
    """Compare the stances of single views with the stances found from all cameras or from the markers."""
    rows, dogs = [], []
    cheetahs = [(seen.stances, exact.stances) for seen, exact in run_gaits(tuple(runs))]
    if cheetahs:
        rows.append(event_row("cheetahs, all cameras", cheetahs))
    for clip, marked, seen in dog_gaits():
        if not clip.name.startswith("turn"):
            dogs.append((found_gait(seen).stances, marked.stances))
    return [*rows, event_row("a dog, markers", dogs)] if dogs else rows


@cache
def dog_gaits() -> tuple[tuple[Clip, Gait, Motion], ...]:
    """Fit each clip of the dog from one side camera, and return it with the gait of its markers and the fit."""
    folder, found = recordings("dog-mocap"), []
    with tempfile.TemporaryDirectory() as written:
        for seed, clip in enumerate(read_clips(folder) if folder.is_dir() else ()):
            settings, _ = write_view(clip, Path(written), seed)
            found.append((clip, marker_gait(clip), fit_clip(settings)))
    return tuple(found)


def animal_rows() -> list[dict]:
    """Compare the gait names of a dog's clips, from markers and from one view, and name the gait of a horse."""
    rows = []
    for clip, marked, motion in dog_gaits():
        seen = found_gait(motion)
        low, high = seen.name.duty_interval
        rows.append(
            {
                "clip": clip.name,
                "speed m/s": f"{marked.speed_m_s:.1f}",
                "markers: gait, strides, duty factor": shown(marked),
                "one view": shown(seen),
                "90 %": f"{low:.2f} to {high:.2f}",
                "feet below 0.6 m/s": f"{np.nanmean(marked.tracks.foot_speed_m_s < 0.6):.2f}",
            }
        )
    labels = recordings("horse-side") / "CollectedData_Byron.csv"
    if labels.is_file():
        settings = FitSettings(
            keypoints=(labels,), skeleton="horse-22", fps=24.0, hfov_deg=50.0, image_size_px=(288, 162)
        )
        seen = found_gait(fit_clip(settings))
        row = {"clip": "horse, labels by hand", "speed m/s": f"{seen.speed_m_s:.1f}", "one view": shown(seen)}
        rows.append({key: row.get(key, "") for key in (rows[0] if rows else row)})
        rows[-1] |= {"90 %": "{:.2f} to {:.2f}".format(*seen.name.duty_interval)}
    return rows


def shown(found: Gait) -> str:
    return f"{found.name.name}, {len(found.strides)}, {found.name.duty_factor:.2f}"


def print_rows(rows: list[dict]) -> None:
    print_table(list(rows[0]), [row.values() for row in rows])


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs")
    parser.add_argument("--held-out", action="store_true", help="only choose SPEED_ERROR on other recordings")
    arguments = parser.parse_args()
    runs = sorted(p.parent for p in arguments.folder.glob("*/meta.json") if (p.parent / "truth.csv").is_file())
    if arguments.held_out:
        print_rows(held_out_rows(runs))
        return
    print("### Samples\n")
    print_rows(sample_rows())
    tables = (("Force plates", plate_rows()), ("Single views", view_rows(runs)), ("A dog and a horse", animal_rows()))
    for title, measured in tables:
        if measured:
            print(f"\n\n### {title}\n")
            print_rows(measured)
    if not runs:
        parser.exit(message=f"no runs in {arguments.folder}\n")
    print(f"\n{named_views(runs)}\n")
    rows, links = [], []
    for run in runs:
        fps = meta_of(run)["fps"]
        pose = read_pose3d(run / "truth.csv")
        rows.append({"run": run.name, **run_row(pose, fps)})
        links.append(link_speeds(pose, fps))
    columns = list(rows[0])
    at = columns.index("landed")
    print("\n### Stances\n")
    print_rows([{name: row[name] for name in columns[:at]} for row in rows])
    print("\n### Gait\n")
    print_rows([{name: row[name] for name in ("run", *columns[at:])} for row in rows])
    print("\n### Mean speed of links relative to their parents, m/s\n")
    named = [
        {"run": row["run"], **{k: f"{v:.2f}" for k, v in link.items()}} for row, link in zip(rows, links, strict=True)
    ]
    mean = {k: f"{np.mean([link[k] for link in links]):.2f}" for k in links[0]}
    print_rows([*named, {"run": "mean", **mean}])


if __name__ == "__main__":
    main()
