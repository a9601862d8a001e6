"""Measure the lengths and the motion prior of a new species with several cameras, then fit clips of one camera.

Run it with `python new_species.py`. Its inputs and outputs are set in new_species.toml. Each clip has a settings
file, which new_species.toml names.
"""

import tomllib
from pathlib import Path

import recon

FILE = Path(__file__).with_suffix(".toml")
config = tomllib.loads(FILE.read_text(encoding="utf-8"))
results, skeleton = FILE.parent / config["results"], FILE.parent / config["skeleton"]
subject, prior = results / "subject.toml", results / "prior.npz"


def fit(name: str, step: str, **known: object) -> Path:
    """Fit the clip of a settings file with the current knowledge of the animal, and return the results folder."""
    settings = recon.read_settings(FILE.parent / name, {"skeleton": skeleton, **known})
    folder = results / step / Path(name).stem
    report = recon.write_clip(recon.fit_clip(settings), settings, folder)
    sigma_mm = 1e3 * report["summary"]["relative_rms_m"]
    print(f"{step} {Path(name).stem}: joints within the pose are known to ±{sigma_mm:.0f} mm")
    return folder


# Fit the runs with the skeleton's file alone.
first = [fit(name, "1-first", prior="none") for name in config["runs"]]

# Measure the animal's lengths with several cameras.
measured = recon.run_subject_fit(
    recon.SubjectFitSettings(clips=tuple(first), out=subject, offsets=config["offsets"], overwrite=True)
)
print(f"size {measured['size']:.3f} ± {measured['size_sigma']:.3f} times the skeleton's")

# Fit the runs with these lengths, and learn a prior from their motion.
runs = [fit(name, "2-measured", prior="none", subject=subject) for name in config["runs"]]
learned = recon.run_prior_fit(recon.PriorFitSettings(poses=tuple(runs), out=prior, overwrite=True))
used = [segment["used"] for segment in learned["segments"]]
print(f"Used: {sum(used)} of {len(used)} segments, {learned['frames']} frames")

# From now on, one camera is enough.
for name in config["clips"]:
    fit(name, "3-one-camera", prior=prior, subject=subject)

print(f"The animal's files are {subject} and {prior}. Pass them to `recon fit` with --subject and --prior.")
