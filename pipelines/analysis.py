"""Analyse the movement in a fitted clip: print speed, gait and joint angles, and draw figures.

Run it with `python analysis.py`, after one_clip.py. Its inputs and outputs are set in analysis.toml.
"""

import math
import tomllib
from pathlib import Path

import recon
from recon.show import plots

FILE = Path(__file__).with_suffix(".toml")
config = tomllib.loads(FILE.read_text(encoding="utf-8"))
out = FILE.parent / config["out"]

# Read a results folder, and analyse it.
motion = recon.Motion.load(FILE.parent / config["results"])
analysis = recon.analyse(motion)
root = analysis.joints[analysis.reference]
print(f"{analysis.reference}: {root.mean_speed_m_s:.1f} m/s, at most {root.peak_speed_m_s:.1f} m/s")

# Print the name of the gait and the touch-downs, and draw the footfalls.
gait = analysis.gait
assert gait is not None  # this skeleton has feet
print(f"{gait.name.name}, since {gait.name.criterion}; strides of {gait.stride_length_m:.2f} m")
print("touchdowns: " + ", ".join(f"{stance.foot} {stance.start_s:.2f} s" for stance in gait.stances if stance.begins))
plots.save(plots.footfall({"gait": gait}, motion.fps), out, "footfalls")

# Print the ranges and rates of angles, and draw the stride in phase space.
angles = {name: analysis.skeleton_angles[name] for name in config["angles"]}
for name, angle in angles.items():
    least, greatest = (math.degrees(value) for value in angle.range_rad)
    print(f"{name}: {least:.0f} to {greatest:.0f} degrees, {angle.peak_rate_rad_s:.1f} rad/s at most")
portraits = {name: analysis.portraits[name] for name in angles}
plots.save(plots.phase_portraits(portraits, analysis.closures), out, "phase_portraits")

# Draw the poses over each other, the speed with its uncertainty, and the swing of a limb's links.
poses = plots.composites(analysis.pose.xyz_m, motion.limbs, motion.time_s, sides=motion.limb_sides)
plots.save(poses, out, "poses")
plots.save(plots.speeds({analysis.reference: root}), out, "speed")
field = plots.vector_fields(analysis.fields[config["limb"]], motion.time_s, title=config["limb"])
plots.save(field, out, "vector_field")

print(f"The figures are in {out}")
