"""Repeat the published study (C. van der Leek, 2022) on one clip, from the fit to the playback.

Run it with `python published_study.py`. Its inputs and outputs are set in published_study.toml.
"""

import tomllib
from pathlib import Path

import recon
from recon.thesis.inspect import read_solver

FILE = Path(__file__).with_suffix(".toml")
paths = tomllib.loads(FILE.read_text(encoding="utf-8"))
results = FILE.parent / paths["results"]

# Fit the 21 unknowns frame by frame with the objectives f1 to f5. motion.rrd is the playback.
settings = recon.read_settings(FILE)
motion = recon.fit_clip(settings)
recon.write_clip(motion, settings, results)

# Write the optimiser's unknowns and objectives by frame, the gradient over the clip, and the search within one frame.
solver = read_solver(motion, results)
for name, table in solver.tables().items():
    table.to_csv(results / name, index=False)
cost = solver.cost.sum()
share = cost["reprojection"] / cost.sum()
print(f"{solver.summary()['frames_converged']} frames converged; f1 has {share:.0%} of the cost")

# Print the speed of the reference joint, and draw phase portraits with their closures.
analysis = recon.analyse(motion)
path = analysis.reference_motion
if analysis.why_no_speed is None:
    print(f"at most {path.peak_speed_m_s:.1f} ± {path.peak_speed_sigma_m_s:.1f} m/s")
else:
    print(f"speed unknown from one camera: {analysis.why_no_speed}")
for name, closure in analysis.closures.items():
    print(f"{name}: closes to {closure.angle:.0f} %")

# Solve inverse kinematics of spine and front leg by all methods, with parameters fitted to a stride.
ik = recon.run_ik(
    recon.IkSettings(folder=results, compare=True, fitted=True, figures=False, anyway=True, overwrite=True)
)
for method, row in ik.summary["along_stride"].items():
    print(f"{method}: joints close to {row['least_closure_angle_percent']:.0f} % or more")
