"""Kinematics and gait of the samples against their formula, and of real runs from their multi-camera reconstructions.

    python benchmarks/gait.py [FOLDER]

The samples: speeds and stance events of the true joints, and of reconstructions, against the formula at 3600 fps. Each
run is a folder with truth.csv and meta.json (fps). Prints what the clips show of the gait, and the mean magnitudes of
the links' motion relative to their parents. Without FOLDER: the cheetah-runs of $RECON_SHARED_DATA, or of
../shared/data; without any runs, the samples only. Of the same place the plate-trials, single views and the
multi-camera reconstruction against the force plates' stances, and the dog-mocap, motion capture of walks, runs and a
turn.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from dog import read_clips
from gallop import gallop
from markdown_table import print_table
from recordings import recordings

from recon import FitSettings, Pose3D, fit_clip, load_skeleton, read_pose3d
from recon.fit.motion import Motion
from recon.gait.clip import analyse
from recon.gait.gait import FEET, gait, match_stances, pose_tracks, stances
from recon.gait.kinematics import joint_kinematics, spine_flexion
from recon.gait.phase import field_means, pose_vector_field
from recon.workflows.clip_results import run_clip

SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"
REFERENCE = "spine"
CHAINS = {
    "hind": ("spine", "tail_base", "{}_back_knee", "{}_back_ankle", "{}_back_paw"),
    "spine": ("tail_base", "spine", "neck_base"),
    "front": ("spine", "neck_base", "{}_front_knee", "{}_front_ankle", "{}_front_paw"),
}
"""The links 6, 7, 8; 1; 2, 3, 4 of the skeleton cheetah-8u."""
LINKS = {"hind": "678", "spine": "1", "front": "234"}


def run_row(pose: Pose3D, fps: float) -> dict:
    """One run as one row of the tables of stances and gaits."""
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
    """Mean speed of each link's tip relative to its parent, m/s, mean of both sides."""
    found = {}
    for limb, chain in CHAINS.items():
        sides = [
            [m.speed_m_s for m in field_means(pose_vector_field(pose, tuple(j.format(side) for j in chain), fps))]
            for side in "lr"
        ]
        found |= dict(zip(LINKS[limb], np.mean(sides, axis=0).tolist(), strict=True))
    return found


# -- the samples -----------------------------------------------------------------------------------------------------

FORMULA_FPS = 3600


def sample_rows() -> list[dict]:
    """True joints and reconstructions of the samples; errors against the formula, or the true joints for `whole`."""
    formula = gallop(fps=float(FORMULA_FPS), n_frames=29 * FORMULA_FPS // 30 + 1)
    fine = Pose3D(formula.names, formula.truth_m, np.arange(len(formula.truth_m)))
    clean, whole = (read_pose3d(SAMPLES / f"{name}_truth.csv") for name in ("clean", "whole"))
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
            keypoints=(SAMPLES / f"{sample}.csv",), camera=SAMPLES / "camera.toml", fps=fps, **options
        )
        run_clip(settings, Path(folder) / "fit")
        found = analyse(Motion.load(Path(folder) / "fit"))
    row = sample_row(name, found.pose, fps, truth, truth_fps, found.motion.foot_names)
    sigma = found.joints[REFERENCE].speed_sigma_m_s
    return row | {"stated sigma m/s": "-" if sigma is None else f"{np.nanmedian(sigma):.1f}"}


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
    match = match_stances(exact, found)
    off = [fps * (b.start_s - a.start_s) for a, b in match.pairs if a.begins and b.begins]
    off += [fps * (b.end_s - a.end_s) for a, b in match.pairs if a.ends and b.ends]
    row["stances: paired, missed, extra"] = f"{len(match.pairs)}, {len(match.only_first)}, {len(match.only_second)}"
    row["events: median, worst error, frames"] = (
        f"{np.median(np.abs(off)):.1f}, {np.max(np.abs(off)):.1f}" if off else "-"
    )
    return row


# -- force plates and motion capture ---------------------------------------------------------------------------------


def plate_rows() -> list[dict]:
    """Times off those of the force plates, of the stance of each foot that is nearest to the measured one."""
    kinds: dict[str, list[tuple[float, float, float]]] = {"single views": [], "multi-camera reconstruction": []}
    missed = dict.fromkeys(kinds, 0)
    for run in sorted(path.parent for path in recordings("plate-trials").glob("*/stances.csv")):
        about = json.loads((run / "meta.json").read_text(encoding="utf-8"))
        fps, measured = about["fps"], pd.read_csv(run / "stances.csv").set_index("joint")
        views = [
            fit_clip(FitSettings(keypoints=(run / f"cam{c}.csv",), camera=run / f"cam{c}.toml", fps=fps)).upright
            for c in about["cameras"]
        ]
        for kind, poses in zip(kinds, (views, [read_pose3d(run / "truth.csv")]), strict=True):
            for pose in poses:
                found = stances(pose_tracks(pose, fps))
                for foot, joint in FEET.items():
                    down, up = measured.loc[joint] - pose.frames[0]
                    own = [s for s in found if s.foot == foot]
                    missed[kind] += not own
                    if own:
                        near = min(own, key=lambda s: abs(s.start_frame + s.end_frame - down - up))
                        late = 1000 * (near.start_frame - down) / fps, 1000 * (near.end_frame - up) / fps
                        kinds[kind].append((*late, (near.end_frame - near.start_frame) / (up - down)))
    rows = []
    for kind, values in kinds.items():
        if values:
            down, up, duration = np.array(values).T
            rows.append(
                {
                    "of": kind,
                    "stances": len(values),
                    "missed": missed[kind],
                    "touch-down late ms: median, absolute": f"{np.median(down):+.1f}, {np.median(np.abs(down)):.1f}",
                    "lift-off late ms: median, absolute": f"{np.median(up):+.1f}, {np.median(np.abs(up)):.1f}",
                    "duration / measured": f"{np.median(duration):.2f}",
                }
            )
    return rows


def dog_rows() -> list[dict]:
    """What a dog's clips are called, and how much of the time the marker of a foot is slow."""
    folder, body = recordings("dog-mocap"), load_skeleton("dog-27")
    rows = []
    for clip in read_clips(folder) if folder.is_dir() else ():
        pose = Pose3D(body.markers, clip.markers(body), np.arange(len(clip.points_m)))
        tracks = pose_tracks(pose, clip.fps, feet=body.feet_by_label(), body=body.forward)
        found = gait(tracks)
        rows.append(
            {
                "clip": clip.name,
                "speed m/s": f"{found.speed_m_s:.1f}",
                "gait": found.name.name,
                "strides": len(found.strides),
                "duty factor": f"{found.name.duty_factor:.2f}",
                "feet below 0.6 m/s": f"{np.nanmean(tracks.foot_speed_m_s < 0.6):.2f}",
            }
        )
    return rows


def print_rows(rows: list[dict]) -> None:
    print_table(list(rows[0]), [row.values() for row in rows])


def main() -> None:
    default = recordings("cheetah-runs")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=default)
    arguments = parser.parse_args()
    runs = sorted(p.parent for p in arguments.folder.glob("*/meta.json") if (p.parent / "truth.csv").is_file())
    print("### Samples\n")
    print_rows(sample_rows())
    for title, measured in (("Force plates", plate_rows()), ("A dog", dog_rows())):
        if measured:
            print(f"\n\n### {title}\n")
            print_rows(measured)
    if not runs:
        parser.exit(message=f"no runs in {arguments.folder}\n")
    rows, links = [], []
    for run in runs:
        fps = json.loads((run / "meta.json").read_text(encoding="utf-8"))["fps"]
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
