"""Vertical forces of the feet against force plates, and the centre of mass against gravity.

    python benchmarks/dynamics.py

The plate-trials of $RECON_SHARED_DATA, or of ../shared/data: single views and both cameras. What forces rest on (the
fore feet's share) is taken from the plates of the other trials. A dog's motion capture has
no masses; the simulated gallop of the samples has stances and a stride, so that its mean force is known.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pandas as pd
from markdown_table import print_table
from recordings import recordings

import recon.gait.dynamics as method
from recon import FitSettings, fit_clip, samples_folder
from recon.gait.clip import ClipAnalysis, analyse
from recon.gait.dynamics import G_M_S2
from recon.gait.gait import FEET


def trials() -> list[Path]:
    return sorted(path.parent for path in recordings("plate-trials").glob("*/forces.csv"))


def measured(run: Path) -> tuple[pd.DataFrame, dict[str, np.ndarray]]:
    """Forces by frame, and the frames of touch-down and lift-off by foot's joint."""
    stances = pd.read_csv(run / "stances.csv")
    ends = stances[["touch_down_frame", "lift_off_frame"]].to_numpy(float)
    return pd.read_csv(run / "forces.csv", index_col=0), dict(zip(stances["joint"], ends, strict=True))


@contextmanager
def of_others(runs: Sequence[Path], fps: float):
    """What plates of these runs say in place of the constants."""
    shares = []
    for run in runs:
        force, _ = measured(run)
        impulse = force.sum() / fps
        shares.append(impulse[[j for f, j in FEET.items() if f.endswith("F")]].sum() / impulse.sum())
    before = method.FORE
    method.FORE = float(np.mean(shares))
    try:
        yield
    finally:
        method.FORE = before


def against_plates(run: Path, found: ClipAnalysis, fps: float) -> list[dict[str, float]]:
    """A row for each measured stance that the clip has."""
    force, stance = measured(run)
    d, rows = found.dynamics, []
    if d is None or found.gait is None:
        return []
    start_s = found.motion.frames[0] / fps
    for foot, joint in FEET.items():
        down, up = stance[joint]
        at_s = np.arange(down, up + 1) / fps
        plate = force[joint].reindex(range(int(down), int(up) + 1), fill_value=0.0).to_numpy()
        time_s = found.gait.tracks.time_s
        said = np.stack([np.interp(at_s, time_s, d.force[foot][:, k], left=np.nan, right=np.nan) for k in range(3)])
        near = d.forces[(d.forces["foot"] == foot) & ((d.forces["start_s"] - down / fps).abs() < 0.1)]
        if near.empty or not np.isfinite(said).all() or at_s[0] < start_s:
            continue
        one, impulse = near.iloc[0], plate.sum() / fps
        rows.append(
            {
                "rms": float(np.sqrt(np.mean((said[0] - plate) ** 2))),
                "inside": float(np.mean((said[1] - 1e-9 <= plate) & (plate <= said[2] + 1e-9))),
                "peak": one["peak_bw"] / plate.max() - 1,
                "peak inside": float(one["peak_low_bw"] <= plate.max() <= one["peak_high_bw"]),
                "impulse inside": float(one["impulse_low_bw_s"] <= impulse <= one["impulse_high_bw_s"]),
            }
        )
    return rows


def main() -> None:
    runs, rows = trials(), []
    for kind in ("single views", "both cameras"):
        found: list[dict[str, float]] = []
        for run in runs:
            about = json.loads((run / "meta.json").read_text(encoding="utf-8"))
            with of_others([other for other in runs if other != run] or runs, about["fps"]):
                for cameras in [about["cameras"]] if kind == "both cameras" else [[c] for c in about["cameras"]]:
                    motion = fit_clip(
                        FitSettings(
                            keypoints=tuple(run / f"cam{c}.csv" for c in cameras),
                            camera=tuple(run / f"cam{c}.toml" for c in cameras),
                            fps=about["fps"],
                        )
                    )
                    found += against_plates(run, analyse(motion, lean=True), about["fps"])
        if found:
            table = pd.DataFrame(found)
            rows.append(
                [
                    *(kind, len(table), f"{np.sqrt((table['rms'] ** 2).mean()):.2f}"),
                    *(f"{table['peak'].median():+.0%}", f"{table['peak'].abs().median():.0%}"),
                    *(f"{table[name].mean():.0%}" for name in ("inside", "peak inside", "impulse inside")),
                ]
            )
    if rows:
        head = ["of", "stances", "RMS, body weights", "peak: median", "absolute", "force in 90 %", "peak in 90 %"]
        print_table([*head, "impulse in 90 %"], rows)
    else:
        print("no recordings: forces not measured")
    samples = samples_folder()
    motion = fit_clip(FitSettings(keypoints=(samples / "whole.csv",), camera=(samples / "camera.toml",), fps=60))
    found_sample = analyse(motion)
    d, gait = found_sample.dynamics, found_sample.gait
    assert d is not None
    assert gait is not None
    impulse = d.forces["impulse_bw_s"].mean() * len(d.force) / gait.stride_s
    print(
        f"\nThe sample: mean vertical force over a stride {impulse:.2f} body weights; flights against gravity: ", end=""
    )
    print(
        ", ".join(
            f"{up + G_M_S2:+.0f} ± {sigma:.0f} m/s²" for up, sigma in d.flights[["up_m_s2", "sigma_m_s2"]].to_numpy()
        )
        or "none"
    )


if __name__ == "__main__":
    main()
