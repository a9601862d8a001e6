"""Test stride quantities and their intervals on force plates, and with an asymmetry planted in a dog's motion capture.

    python benchmarks/parts/strides.py [FOLDER] [--quick] [--only plates|asymmetry] [--fits FOLDER]

The plates test single views of the two plate trials. No foot completes a stride there, so the period of the motion is
used. The plates give the duration of stances; the multi-camera reconstruction gives speed and period.

For the asymmetry, the deviations of the left limbs' angles from their means are increased by 0, 2, 5 and 10 % in the
dog's walks and runs. One camera from the side sees the changed animal, and the same animal with left and right
exchanged. The true asymmetry is computed from the changed markers. It includes the dog's own asymmetry, so an asymmetry
that is found at 0 % may be real. A result is false if its 90 % interval excludes 0 although the asymmetry of the
markers has the other sign, or does not differ from 0 given the scatter of their strides. FOLDER is a folder like the
dog-mocap. --fits keeps the fits in a folder, and reuses fits that the folder already has.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from arguments import parser_of
from dog import Clip, body_of, marker_gait, read_clips, write_view
from gait import fitted, plate_runs, plate_stances
from markdown_table import print_table
from recordings import meta_of

from recon import fit_clip, read_pose3d
from recon.fit.motion import Motion
from recon.fit.points import solve_points
from recon.gait.clip import ClipAnalysis
from recon.gait.gait import gait
from recon.gait.quantities import PAIRS, asymmetry_values
from recon.gait.stances import pose_tracks

LEVELS = 0.0, 0.02, 0.05, 0.10
MOVING = "run02", "walk00", "walk01", "walk03", "walk04"
"""Clips in which the dog moves straight at a constant speed."""
CHECKED = {
    "stride_length_m": "stride length, m",
    "stride_frequency_hz": "stride frequency, Hz",
    "duty_factor": "duty factor",
}
"""Heading of each quantity that is compared with the plates."""


def plate_rows() -> list[dict]:
    """Compare stride length, frequency and duty factor of each view with the plates and with all cameras."""
    rows = []
    for run in plate_runs():
        about = meta_of(run)
        exact = gait(pose_tracks(read_pose3d(run / "truth.csv"), about["fps"]))
        stance_s = np.mean([stance.duration_s for stance in plate_stances(run, about["fps"])])
        truth = exact.speed_m_s * exact.stride_s, 1 / exact.stride_s, stance_s / exact.stride_s
        for camera in about["cameras"]:
            quantities = ClipAnalysis(fitted(run, camera)).quantities
            for name, true in zip(CHECKED, truth, strict=True):
                quantity = quantities[name]
                low, high = quantity.interval
                row = {"run": run.name, "camera": camera, "quantity": CHECKED[name]}
                row |= {"true value": round(float(true), 3), "estimated": round(quantity.value, 3)}
                row |= {"90 % interval": f"{low:.3g} to {high:.3g}", "estimated from": quantity.source}
                rows.append(row | {"true value in interval": "yes" if low <= true <= high else "no"})
    return rows


def changed(clip: Clip, level: float, mirrored: bool) -> Clip:
    """Replace the markers by those of a fitted skeleton whose left limbs swing more, by the fraction `level`.

    If `mirrored` is true, the right limbs swing more instead.
    """
    body = body_of()
    states = solve_points(body, clip.markers(body))[0]
    prefix = "r_" if mirrored else "l_"
    columns = [i for i, name in enumerate(body.state_names) if name.startswith(prefix)]
    mean = np.nanmean(states[:, columns], axis=0)
    states[:, columns] = mean + (1 + level) * (states[:, columns] - mean)
    points_m = clip.points_m.copy()
    points_m[:, [clip.names.index(marker) for marker in body.markers]] = body.tree.pose(states).points_m
    return replace(clip, points_m=points_m)


def fit_changed(seen: Clip, seed: int, kept: Path) -> Motion:
    """Fit one camera's view, or load the fit from the folder `kept` if it is there."""
    if (kept / "motion.npz").is_file():
        return Motion.load(kept)
    with tempfile.TemporaryDirectory() as folder:
        settings, _ = write_view(seen, Path(folder), seed=seed)
        motion = fit_clip(settings)
    motion.save(kept)
    return motion


def asymmetry_rows(clips: list[Clip], levels: tuple[float, ...], fits: Path) -> list[dict]:
    rows = []
    for number, clip in enumerate(clips):
        for level in levels:
            for mirrored in (False, True):
                seen = changed(clip, level, mirrored)
                exact = marker_gait(seen)
                seed = 8 * number + int(100 * level) + mirrored
                motion = fit_changed(seen, seed, fits / f"{level}-{clip.name}-{int(mirrored)}")
                quantities = ClipAnalysis(motion).quantities
                for girdle, feet in PAIRS.items():
                    for kind in ("stance", "excursion"):
                        left, right = asymmetry_values(exact, kind, feet)
                        quantity = quantities[f"asymmetry_{kind}_{girdle}"]
                        half = (left.mean() + right.mean()) / 2
                        scatter = np.hypot(*(np.std(side, ddof=1) / len(side) ** 0.5 for side in (left, right)))
                        row = {"clip": clip.name, "side": "right" if mirrored else "left", "level": level}
                        row |= {"kind": kind, "girdle": girdle, "true": float((left.mean() - right.mean()) / half)}
                        row |= {"true_sigma": float(scatter / half), "value": quantity.value}
                        rows.append(row | {"sigma": quantity.sigma, "why": quantity.why_unknown})
    return rows


def asymmetry_table(rows: list[dict]) -> list[dict]:
    """Count refused and found asymmetries and wrong intervals, for each kind and size of the planted asymmetry."""
    table = []
    for kind in ("stance", "excursion"):
        for level in sorted({row["level"] for row in rows}):
            group = [row for row in rows if (row["kind"], row["level"]) == (kind, level)]
            known = [row for row in group if np.isfinite(row["value"])]
            error = np.array([row["value"] - row["true"] for row in known])
            reach = 1.645 * np.array([row["sigma"] for row in known])
            is_found = np.abs([row["value"] for row in known]) > reach
            is_right = np.sign([row["value"] for row in known]) == np.sign([row["true"] for row in known])
            is_real = np.abs([row["true"] for row in known]) > 1.645 * np.array([row["true_sigma"] for row in known])
            row = {"kind": kind, "asymmetry added": f"{level:.0%}", "asymmetries": len(group)}
            row |= {"refused": f"{1 - len(known) / len(group):.0%}"}
            if known:
                row |= {
                    "RMS error": f"{np.sqrt(np.mean(error**2)):.1%}",
                    "stated, ±": f"{np.median(reach) / 1.645:.1%}",
                }
                row |= {
                    "in 90 % interval": f"{np.mean(np.abs(error) < reach):.0%}",
                    "reported": f"{is_found.mean():.0%}",
                }
                row |= {"reported by the markers": f"{is_real.mean():.0%}"}
                row |= {"reported falsely": f"{np.mean(is_found & ~(is_right & is_real)):.0%}"}
            table.append(row)
    return table


def print_rows(rows: list[dict]) -> None:
    columns = list(dict.fromkeys(name for row in rows for name in row))
    print_table(columns, [[row.get(name, "") for name in columns] for row in rows])


def main() -> None:
    parser = parser_of(__doc__, "--quick", kind="dog-mocap")
    parser.add_argument("--rows", type=Path, help="write each asymmetry into this JSON file")
    parser.add_argument("--only", choices=("plates", "asymmetry"))
    parser.add_argument("--fits", type=Path, help="folder that keeps the fits of the changed clips")
    parser.add_argument("--levels", nargs="+", type=float, default=LEVELS, help="asymmetries (default: %(default)s)")
    arguments = parser.parse_args()
    if arguments.only != "asymmetry" and (plates := plate_rows()):
        print("### Force plates\n")
        print_rows(plates)
    if arguments.only == "plates":
        return
    clips = [clip for clip in read_clips(arguments.folder) if clip.name in MOVING]
    quick = arguments.quick
    levels = (0.0, 0.1) if quick else tuple(arguments.levels)
    with tempfile.TemporaryDirectory() as folder:
        rows = asymmetry_rows(clips[:2] if quick else clips, levels, arguments.fits or Path(folder))
    if arguments.rows:
        arguments.rows.write_text(json.dumps(rows))
    print("\n### Asymmetry put into a dog's mocap\n")
    print_rows(asymmetry_table(rows))


if __name__ == "__main__":
    main()
