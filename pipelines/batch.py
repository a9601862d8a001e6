"""Fit many clips separately, in parallel, and print a table of the animals' speeds and gaits.

Run it with `python batch.py`. Its inputs and outputs are set in batch.toml, and the clips are listed in
batch_clips.csv. The same command continues after an interruption, and fits only clips that have changed.
"""

import tomllib
from pathlib import Path

import recon

FILE = Path(__file__).with_suffix(".toml")
config = tomllib.loads(FILE.read_text(encoding="utf-8"))
results = FILE.parent / config["results"]

# List the clips, and print which of them still have to be fitted.
clips, notes = recon.find_clips([FILE.parent / pattern for pattern in config["clips"]], {}, FILE)
plan = recon.plan_batch(clips, results)
for note in notes:
    print(note)
for planned in plan:
    print(f"{planned.clip.name}: {planned.action}")

# Fit the clips. A clip that cannot be fitted does not stop the others.
summary = recon.run_batch(plan, results, jobs=config["jobs"])
print(", ".join(f"{count} {status}" for status, count in summary.counts().items()))

# Print the results of all clips.
for name, row in summary.rows.items():
    if row["status"] not in ("done", "done earlier"):
        print(f"{name}: {row['status']}, {row['error']}")
        continue
    analysis = recon.analyse(recon.Motion.load(results / name))
    speed = analysis.joints[analysis.reference].mean_speed_m_s
    gait = "no feet" if analysis.gait is None else analysis.gait.name.name
    print(f"{name}: {speed:.1f} m/s, {row['outliers']} outliers, {gait}")

print(f"Results are in {results}, and their table is {summary.path}")
