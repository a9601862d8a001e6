"""Stances, gaits and links' motion of a folder of real runs, from their multi-camera reconstructions.

    python benchmarks/gait.py [FOLDER]

Each run is a folder with truth.csv and meta.json (fps). Prints how well the two methods of `recon.analysis.gait` agree
on the stances, what the clips show of the gait, and the mean magnitudes of the links' motion relative to their parents.
Stances that end in the last ten frames by both methods are not counted. Without FOLDER: the cheetah-runs of
$RECON_SHARED_DATA, or of ../shared/data.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

import numpy as np

from recon import Pose3D, read_pose3d
from recon.analysis.gait import gait, match_stances, pose_tracks
from recon.analysis.kinematics import spine_flexion
from recon.analysis.phase import field_means, pose_vector_field

LAST_FRAMES = 10
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
    ground, body = gait(tracks, "ground"), gait(tracks, "body")
    match = match_stances(body.stances, ground.stances)
    last = tracks.frame[-1] - LAST_FRAMES
    matched = sum(min(a.end_frame, b.end_frame) <= last for a, b in match.pairs)
    alone = sum(s.end_frame <= last for s in (*match.only_first, *match.only_second))
    whole = [s for s in ground.stances if s.begins and s.ends]
    flexion = spine_flexion(pose, fps)
    return {
        "frames": len(pose.frames),
        "fps": f"{fps:g}",
        "speed_m_s": f"{ground.speed_m_s:.1f}",
        "leg_m": f"{tracks.leg_m:.2f}",
        "body": len(body.stances),
        "ground": len(ground.stances),
        "pairs": len(match.pairs),
        "counted": matched + alone,
        "matched": matched,
        "start_lag": f"{match.start_lag_frames:+.1f}",
        "end_lag": f"{match.end_lag_frames:+.1f}",
        "stance_ms": f"{1000 * np.mean([s.duration_s for s in whole]):.0f}" if whole else "-",
        "landed": " ".join(ground.order),
        "strides": len(ground.strides),
        "gait": ground.name.name,
        "slope_percent": f"{100 * np.hypot(*tracks.ground.slope):.1f}",
        "spread_mm": f"{1000 * tracks.ground.spread_m:.0f}",
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


def print_table(rows: list[dict]) -> None:
    print("| " + " | ".join(rows[0]) + " |")
    print("|" + " --- |" * len(rows[0]))
    for row in rows:
        print("| " + " | ".join(str(cell) for cell in row.values()) + " |")


def main() -> None:
    here = Path(__file__).resolve().parents[1]
    default = Path(os.environ.get("RECON_SHARED_DATA", here.parent / "shared" / "data")) / "cheetah-runs"
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=default)
    arguments = parser.parse_args()
    runs = sorted(p.parent for p in arguments.folder.glob("*/meta.json") if (p.parent / "truth.csv").is_file())
    if not runs:
        parser.exit(message=f"no runs in {arguments.folder}: nothing measured\n")
    rows, links = [], []
    for run in runs:
        fps = json.loads((run / "meta.json").read_text(encoding="utf-8"))["fps"]
        pose = read_pose3d(run / "truth.csv")
        rows.append({"run": run.name, **run_row(pose, fps)})
        links.append(link_speeds(pose, fps))
    columns = list(rows[0])
    at = columns.index("landed")
    print("### Stances\n")
    print_table([{name: row[name] for name in columns[:at]} for row in rows])
    matched, counted = (sum(row[name] for row in rows) for name in ("matched", "counted"))
    share = f"{matched / counted:.0%}" if counted else "none"
    print(f"\nMatched one to one: {matched} of {counted} that end {LAST_FRAMES} frames before the clip does ({share}).")
    print("\n### Gait\n")
    print_table([{name: row[name] for name in ("run", *columns[at:])} for row in rows])
    print("\n### Mean speed of links relative to their parents, m/s\n")
    named = [
        {"run": row["run"], **{k: f"{v:.2f}" for k, v in link.items()}} for row, link in zip(rows, links, strict=True)
    ]
    mean = {k: f"{np.mean([link[k] for link in links]):.2f}" for k in links[0]}
    print_table([*named, {"run": "mean", **mean}])


if __name__ == "__main__":
    main()
