"""Fit one 3D motion to the keypoints of several cameras, and check whether the cameras agree.

Run it with `python several_cameras.py`. Its inputs and outputs are set in several_cameras.toml.
"""

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np

import recon

FILE = Path(__file__).with_suffix(".toml")
results = FILE.parent / tomllib.loads(FILE.read_text(encoding="utf-8"))["results"]

# Fit one motion in the world to all cameras.
settings = recon.read_settings(FILE)
motion = recon.fit_clip(settings)
report = recon.write_clip(motion, settings, results)

# Print the contribution of each camera, and cameras that were turned, late or exchanged.
for camera in report["cameras"]:
    print(f"{camera['name']}: {camera['frames_seen']} frames, {camera['points']['used']} points")
errors = [finding["text"] for finding in report["findings"] if finding["severity"] == "error"]
print("\n".join(errors) or "The cameras agree.")

# Several cameras measure the animal's size, which one camera cannot.
size = report["size"]
print(f"size {size['factor']:.3f} ± {size['sigma']:.3f} times the skeleton's")

# Compare with a fit of the first camera alone, whose error is mostly along its line of sight.
alone = recon.fit_clip(replace(settings, keypoints=settings.keypoints[:1], fast=True))
apart_m = np.linalg.norm((alone.joints_m - motion.joints_m).mean(axis=1), axis=1)
print(f"{settings.keypoints[0].name} alone places the animal {np.nanmedian(apart_m):.2f} m away (median)")

print(f"Results are in {results}. Watch them with: recon view {results}")
