"""Measure the bones of two cheetahs in single runs, and compare them with their known lengths.

    python benchmarks/parts/bone_lengths.py

Each run of $RECON_SHARED_DATA/cheetah-runs is fitted alone, with all its cameras; subjects.json has the lengths. The
script prints each bone's error and standard deviation, and the fraction of 90 % intervals that contain the length. The
fraction is also printed with the model's standard deviation (`recon.fit.shape.MODEL_SIGMA`) estimated from the other
runs by maximum likelihood.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence

import numpy as np
from markdown_table import print_table
from recordings import meta_of, recordings

from recon import FitSettings
from recon.animal.bones import bones_of
from recon.api.subject_fit import clip_problem
from recon.fit.body_shape import Shape
from recon.fit.regions import radius
from recon.fit.shape import MODEL_SIGMA, fit_shape
from recon.gait.stances import INTERVAL

Rows = list[tuple[str, float, float]]
"""Name of a bone, relative error of its fitted length, and relative standard deviation stated by the fit."""


def true_lengths_m(subject: str) -> dict[str, float]:
    """Read the measured length of each bone of an animal, metres."""
    table = json.loads((recordings("cheetah-runs").parent / "subjects.json").read_text())
    own, trunk = table[subject], table["trunk"]
    rear, front = (float(trunk[name][0]) for name in ("tail_base->spine", "spine->neck_base"))
    nose = own["head (neck frame, from neck_base)"]["nose"]
    lengths = {"rear trunk": rear, "front trunk": front, "trunk": rear + front}
    lengths["head and neck"] = float(np.linalg.norm(nose))
    links = ("root->knee", "knee->ankle", "ankle->paw")
    lengths |= zip(("upper arm", "forearm", "forefoot"), (own["front leg"][link] for link in links), strict=True)
    lengths |= zip(("thigh", "shank", "hind foot"), (own["hind leg"][link] for link in links), strict=True)
    return lengths


def measured() -> dict[str, Rows]:
    """Fit each run alone, and return the errors of the run's bone lengths."""
    runs: dict[str, Rows] = {}
    for folder in sorted(recordings("cheetah-runs").glob("*/")):
        meta = meta_of(folder)
        files = tuple(sorted(folder.glob("cam*.csv")))
        settings = FitSettings(keypoints=files, camera=(folder / "scene.json",), fps=meta["fps"])
        problem = clip_problem(settings, folder, None)
        fit = fit_shape(Shape.of_body(problem.body), [problem])
        known_m = true_lengths_m(meta["subject"])
        for bone in bones_of(problem.body):
            length_m, sigma_m, _ = fit.length_of(bone.offsets, problem.size_sigma)
            sigma = float(np.sqrt((sigma_m / length_m) ** 2 - MODEL_SIGMA**2))
            runs.setdefault(folder.name, []).append((bone.name, length_m / known_m[bone.name] - 1, sigma))
    return runs


def holds(rows: Rows, model: float) -> list[bool]:
    """Return for each bone whether the 90 % interval contains the true length.

    `model` is the model's own standard deviation, relative to the length.
    """
    return [abs(error) < radius(INTERVAL) * float(np.hypot(sigma, model)) for _, error, sigma in rows]


def likeliest(runs: Sequence[Rows]) -> float:
    """Estimate the model's own standard deviation, relative to the length, by maximum likelihood over some runs."""
    error, sigma = np.array([row[1:] for rows in runs for row in rows]).T
    models = np.linspace(0, 0.2, 401)
    variance = sigma**2 + models[:, None] ** 2
    return float(models[np.argmax(-0.5 * (error**2 / variance + np.log(variance)).sum(axis=1))])


def main() -> None:
    runs: Mapping[str, Rows] = measured()
    rows = [
        [run, bone, f"{error:+.1%}", f"{sigma:.1%}", f"{np.hypot(sigma, MODEL_SIGMA):.1%}"]
        for run, bones in runs.items()
        for bone, error, sigma in bones
    ]
    print_table(["run", "bone", "error", "± of the fit", "± printed"], rows)
    held = [is_held for bones in runs.values() for is_held in holds(bones, MODEL_SIGMA)]
    left_out = [
        is_held
        for run, bones in runs.items()
        for is_held in holds(bones, likeliest([others for name, others in runs.items() if name != run]))
    ]
    print(
        f"\nThe 90 % intervals contain {sum(held)} of {len(held)} true lengths, and {sum(left_out)} with the model's "
        "standard deviation from the other runs."
    )


if __name__ == "__main__":
    main()
