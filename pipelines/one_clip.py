"""One clip of one camera: keypoints in; its 3D motion, and how far to trust it, out.

Run it with `python one_clip.py`. What it reads and writes stands in one_clip.toml.
"""

import tomllib
from pathlib import Path

import numpy as np

import recon

FILE = Path(__file__).with_suffix(".toml")
paths = tomllib.loads(FILE.read_text(encoding="utf-8"))
results = FILE.parent / paths["results"]

# The fit, and every file that `recon fit` writes.
settings = recon.read_settings(FILE)
motion = recon.fit_clip(settings)
report = recon.write_clip(motion, settings, results)

# How far to trust it: a flagged frame has a reason for doubt.
for frame, flags in zip(motion.frames, motion.flags, strict=True):
    if flags:
        print(f"frame {frame}: {', '.join(flags)}")
for finding in report["findings"]:
    if finding["severity"] != "note":
        print(finding["text"])

# The motion itself is arrays, NaN in frames without a pose: joints_m is (frames, joints, 3).
centre_m = motion.joints_m.mean(axis=1)[motion.solved]
seconds = np.ptp(motion.time_s[motion.solved])
print(f"{len(centre_m)} of {len(motion.frames)} frames have a pose")
print(f"mean speed {np.linalg.norm(centre_m[-1] - centre_m[0]) / seconds:.1f} m/s over {seconds:.2f} s")

# How good it is, where the truth is known.
if "truth" in paths:
    error = recon.evaluate_files(results / "pose3d.csv", FILE.parent / paths["truth"])
    print(f"joints {1e3 * error.mpjpe_m.mean:.0f} mm off the truth with each frame centred")

print(f"Results are in {results}. Watch them with: recon view {results}")
