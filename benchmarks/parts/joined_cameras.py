"""Join the mean speeds of single views of real runs, and compare them with the speed from all cameras.

    python benchmarks/parts/joined_cameras.py [FOLDER]

The runs are in FOLDER, by default the cheetah-runs of $RECON_SHARED_DATA. Each view is fitted separately, and the views
of a run become one clip as in `recon compare --design`. The true speed is the speed of the reference joint in the
reconstruction from all cameras. Intervals are 90 % intervals. The fits assume that the animals have the mean size of
their species.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
from arguments import parser_of, runs_or_exit
from markdown_table import print_table
from recordings import fit_settings, meta_of

from recon import fit_clip, read_pose3d
from recon.api.compare import measurement_sigma
from recon.api.experiment import SPEED, runs_of_clips
from recon.fit.regions import radius
from recon.gait.clip import analyse
from recon.gait.kinematics import frame_times
from recon.gait.quantities import shared_sigma_columns
from recon.gait.series import series_kinematics
from recon.gait.stances import INTERVAL


def view_row(run: Path, camera: int) -> dict[str, object]:
    """Fit one view, and return its row as in `clips.csv` of `recon compare`."""
    motion = fit_clip(fit_settings(run, [camera]))
    speed = analyse(motion).quantities[SPEED]
    labels = {
        "clip": f"{run.name} {camera}",
        "camera": str(camera),
        "run": run.name,
        "animal": run.name,
        "group": "all",
    }
    row = labels | {"verdict": "", "strides": 0, "reference": motion.reference} | shared_sigma_columns(motion)
    row |= {SPEED: speed.value, f"{SPEED}_sigma": speed.sigma, f"{SPEED}_own_sigma": speed.own_sigma}
    return row | {f"{SPEED}_measurement_sigma": measurement_sigma(speed), f"{SPEED}_source": speed.source}


def main() -> None:
    parser = parser_of(__doc__, kind="cheetah-runs")
    rows, errors, joint_errors = [], [], []
    for run in runs_or_exit(parser, parser.parse_args().folder):
        meta, truth = meta_of(run), read_pose3d(run / "truth.csv")
        clips = pd.DataFrame([view_row(run, camera) for camera in meta["cameras"]])
        xyz_m = truth.xyz_m[:, truth.names.index(clips["reference"][0])]
        velocity = series_kinematics(frame_times(truth.frames, meta["fps"]), xyz_m, oversampling=1).rate
        true = float(np.nanmean(np.linalg.norm(velocity, axis=1)))
        (joint,) = runs_of_clips(clips, {SPEED: True}).to_dict("records")
        z = ((clips[SPEED] - true) / clips[f"{SPEED}_sigma"]).to_numpy(float)
        z_joint = (joint[SPEED] - true) / joint[f"{SPEED}_sigma"]
        errors += [*z]
        joint_errors.append(z_joint)
        rms = np.sqrt(np.mean((clips[SPEED] - true) ** 2))
        rows.append(
            [
                *(run.name, str(len(clips)), f"{true:.2f}", f"{rms:.2f}", f"{clips[f'{SPEED}_sigma'].mean():.2f}"),
                *(f"{joint[SPEED]:.2f}", f"{joint[f'{SPEED}_sigma']:.2f}", f"{joint[f'{SPEED}_own_sigma']:.2f}"),
                str(bool(abs(z_joint) < radius(INTERVAL))),
            ]
        )
    columns = "run, views, true m/s, error of views, ± of views, joined m/s, ±, ± without the size, in 90 %"
    print_table(columns.split(", "), rows)
    fraction = np.mean(np.abs(errors) < radius(INTERVAL))
    ratio = np.sqrt(np.mean(np.square(joint_errors)))
    print(f"\nThe intervals of {fraction:.0%} of the {len(errors)} views contain the true speed.")
    print(f"The root mean square of error / stated of the joined speeds is {ratio:.2f}.")


if __name__ == "__main__":
    main()
