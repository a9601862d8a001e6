"""Fit one clip of one camera, from the keypoints to the 3D motion and its reliability.

Run it with `python one_clip.py`. Its inputs and outputs are set in one_clip.toml.
"""

import tomllib
from pathlib import Path

import numpy as np

import recon

FILE = Path(__file__).with_suffix(".toml")
paths = tomllib.loads(FILE.read_text(encoding="utf-8"))
results = FILE.parent / paths["results"]

# Fit the clip, and write all files of `recon fit`.
settings = recon.read_settings(FILE)
motion = recon.fit_clip(settings)
report = recon.write_clip(motion, settings, results)

# Print how reliable the result is, and the reason for each flagged frame.
for frame, flags in zip(motion.frames, motion.flags, strict=True):
    if flags:
        print(f"frame {frame}: {', '.join(flags)}")
for finding in report["findings"]:
    if finding["severity"] != "note":
        print(finding["text"])

# The motion is stored in arrays, such as joints_m (frames, joints, 3), which are NaN in frames without a pose.
centre_m = motion.joints_m.mean(axis=1)[motion.solved]
seconds = np.ptp(motion.time_s[motion.solved])
print(f"{len(centre_m)} of {len(motion.frames)} frames have a pose")
print(f"mean speed {np.linalg.norm(centre_m[-1] - centre_m[0]) / seconds:.1f} m/s over {seconds:.2f} s")

# Compare with the truth, if it is known.
if "truth" in paths:
    error = recon.evaluate_files(results / "pose3d.csv", FILE.parent / paths["truth"])
    print(f"joints {1e3 * error.mpjpe_m.mean:.0f} mm from the truth, with each frame centred")

print(f"Results are in {results}. Watch them with: recon view {results}")
