"""Calibrate a camera from pictures or a video of a board, and write a camera file for `recon fit`.

Run it with `python calibration.py`. Its inputs and outputs are set in calibration.toml.
"""

import math
import sys
import tomllib
from pathlib import Path

import recon

FILE = Path(__file__).with_suffix(".toml")
config = tomllib.loads(FILE.read_text(encoding="utf-8"))
pictures = [FILE.parent / path for path in config["pictures"]]

# Calibrate. If a check refuses the calibration, no camera file is written.
found = recon.run_calibration(
    recon.CalibrationSettings(
        inputs=tuple(pictures),
        board=config["board"],
        model=config["lens"],
        out=FILE.parent / config["camera"],
        overwrite=True,
    )
)
used = [picture for picture in found["pictures"] if picture["used"]]
print(f"{found['found']} of {found['examined']} pictures show the board, {len(used)} were used")

# Print each check with its measured value and its limit.
for check in found["checks"]:
    print(f"{check['verdict']}: {check['text']}")
for picture in used:
    if picture["rms_px"] > 2 * found["rms_px"]:
        print(f"look at {picture['name']}: its corners are {picture['rms_px']:.2f} px off")
if found["written"] is None:
    sys.exit(f"The calibration was refused. Where boards are missing: {found['picture']}")

# Read the camera as all other scripts and commands do.
camera = recon.read_camera(found["written"])
width, height = camera.image_size_px
field_deg = math.degrees(2 * math.atan(width / 2 / camera.matrix[0, 0]))
print(f"{width}x{height} px, about {field_deg:.0f} degrees wide, corners {found['rms_px']:.2f} px off")
print(f"The camera is in {found['written']}, a picture of the evidence in {found['picture']}")
