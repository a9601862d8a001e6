"""Repeat the published study (C. van der Leek, 2022) on one clip, from the fit to the playback.

Run it with `python published_study.py`. What it reads and writes stands in published_study.toml.
"""

import tomllib
from pathlib import Path

import recon
from recon.ik.clip import IkSettings, run_ik
from recon.thesis.inspect import read_solver

FILE = Path(__file__).with_suffix(".toml")
paths = tomllib.loads(FILE.read_text(encoding="utf-8"))
results = FILE.parent / paths["results"]

# The frame method: objectives f1 to f5 on the 21 unknowns, one frame after the other. motion.rrd is the playback.
settings = recon.read_settings(FILE)
motion = recon.fit_clip(settings)
recon.write_clip(motion, settings, results)

# The optimiser: unknowns and objectives by frame, the gradient over the clip, the search within one frame.
solver = read_solver(motion, results)
for name, table in solver.tables().items():
    table.to_csv(results / name, index=False)
cost = solver.cost.sum()
share = cost["reprojection"] / cost.sum()
print(f"{solver.summary()['frames_converged']} frames converged; f1 has {share:.0%} of the cost")

# How the animal moves: speed of the reference joint, phase portraits and their closures.
analysis = recon.analyse(motion)
path = analysis.reference_motion
if analysis.why_no_speed is None:
    print(f"at most {path.peak_speed_m_s:.1f} ± {path.peak_speed_sigma_m_s:.1f} m/s")
else:
    print(f"one camera does not tell the speed: {analysis.why_no_speed}")
for name, closure in analysis.closures.items():
    print(f"{name}: closes to {closure.angle:.0f} %")

# Inverse kinematics of spine and front leg: all methods, with parameters fitted to the configurations of a stride.
ik = run_ik(IkSettings(folder=results, compare=True, fitted=True, figures=False, anyway=True, overwrite=True))
for method, row in ik.summary["along_stride"].items():
    print(f"{method}: joints close to {row['least_closure_angle_percent']:.0f} % or more")
