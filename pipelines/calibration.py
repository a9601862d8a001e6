"""A camera's calibration: pictures or a video of a board in, a camera file for `recon fit` out.

Run it with `python calibration.py`. What it reads and writes stands in calibration.toml.
"""

import math
import sys
import tomllib
from pathlib import Path

import recon

FILE = Path(__file__).with_suffix(".toml")
config = tomllib.loads(FILE.read_text(encoding="utf-8"))
pictures = [FILE.parent / path for path in config["pictures"]]

# Nothing is written where a check refuses the calibration.
run = recon.run_calibration(
    recon.CalibrationSettings(
        inputs=tuple(pictures),
        board=config["board"],
        model=config["lens"],
        out=FILE.parent / config["camera"],
        overwrite=True,
    )
)
views = run.calibration.views
print(f"{run.views.found} of {run.views.examined} pictures show the board, {len(views)} were used")

# Each check says what it is about, and how the calibration stands to its limit.
for check in run.checks:
    print(f"{check.verdict}: {check.what}: {check.value:.3g} {check.unit}")
for view in views:
    if view.rms_px > 2 * run.calibration.rms_px:
        print(f"look at {view.name}: its corners are {view.rms_px:.2f} px off")
if run.written is None:
    sys.exit(f"The calibration was refused. Where boards are missing: {run.picture}")

# The camera as every other script and command reads it.
camera = recon.read_camera(run.written)
width, height = camera.image_size_px
field_deg = math.degrees(2 * math.atan(width / 2 / camera.matrix[0, 0]))
print(f"{width}x{height} px, about {field_deg:.0f} degrees wide, corners {run.calibration.rms_px:.2f} px off")
print(f"The camera is in {run.written}, a picture of the evidence in {run.picture}")
