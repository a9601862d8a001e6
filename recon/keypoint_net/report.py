"""What a training run tells about itself: errors, reliability, and labels that are probably wrong, found in two ways.

- The network, once trained, puts the keypoint somewhere else and is not tempted by the label.
- The label is farther from every other label of its picture than this keypoint is anywhere else from them.

The distances are in body lengths; a label's rank is the sum of those in which it stands out.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from recon import __version__
from recon.base.arrays import Array, median
from recon.keypoint_net.evaluate2d import evaluate_2d, reliability
from recon.keypoint_net.labels import Labels, extents_px, frames_by_part
from recon.keypoint_net.network import TrainedNetwork, calibrated, require_torch
from recon.keypoint_net.train import State, TrainingRun, calibrated_spec, judge
from recon.show.plain import to_json

FAR, APART = 0.2, 0.15
"""Body lengths from which on a label stands out: from the network's point, from the others."""
REASONS = {
    "network": "body lengths from where the network sees it",
    "others": "body lengths farther from every other label than usual",
}
LEARNED = 5.0
"""Times a keypoint's median distance that the network's point must be away, too: it has to know the keypoint."""
USUAL = 0.95
"""A distance between two keypoints is usual up to this quantile of it."""
MOST = 30


def write_training_report(run: TrainingRun, state: State, folder: Path) -> dict[str, Any]:
    """Into an existing folder; returns what stands in training.json."""
    spec, split, history = calibrated_spec(run, state), run.split, state.history
    _, raw, xy_px = judge(TrainedNetwork(spec, state.average, run.device), run, np.arange(len(run.labels.images)))
    likelihood, judged = calibrated(raw, spec.calibration), {}
    for name, which in split.items():
        if len(which):
            truth, length_px = run.labels.xy_px[which], median(extents_px(run.labels.xy_px[which]))
            length_px = length_px if np.isfinite(length_px) else spec.body_length_px
            given = spec.names, xy_px[which], likelihood[which], truth, length_px
            judged[name] = evaluate_2d(*given, tolerance_px=spec.tolerance_px)
    # Of the network as it was calibrated: before it learned from the validation pictures.
    before = reliability(np.array(state.judged[0]), np.array(state.judged[1], bool))
    # Elsewhere, that the network disagrees says more about the network.
    learned = np.concatenate([split["train"], split["validation"]])
    seen = np.full_like(xy_px, np.nan)
    seen[learned] = xy_px[learned]
    suspects = suspicious_labels(run.labels, seen, spec.body_length_px)
    held_out = [row for row in history if "validation_px" in row and "finishing" not in row]
    best = min(held_out, key=lambda row: row["validation_px"], default=None)
    first = [int(row["step"]) for row in history if "finishing" not in row]
    report = {
        "recon": __version__,
        "torch": str(require_torch().__version__),
        "device": str(run.device),
        "threads": state.threads,
        "source": run.labels.source,
        "keypoints": list(spec.names),
        "parameters": sum(p.numel() for p in state.network.parameters()),
        "scale": spec.scale,
        "first_stage_scale": spec.first,
        "body_length_px": spec.body_length_px,
        "tolerance_px": spec.tolerance_px,
        "settings": run.settings.of_training(),
        "split": frames_by_part(run.labels, split),
        "labelled_points": {name: int(run.labels.labelled[which].sum()) for name, which in split.items()},
        "steps": state.step,
        "seconds": round(state.seconds, 1),
        "best_validation": best and {"median_px": best["validation_px"], "step": best["step"]},
        "validation_in_training_from": max(first, default=None),
        "calibration": spec.calibration and dict(zip(("slope", "offset"), spec.calibration, strict=True)),
        "reliability_validation": before,
        "errors": judged,
        "suspicious_labels": suspects,
        "history": history,
        "notes": list(run.labels.notes),
    }
    (folder / "training.json").write_text(to_json(report), encoding="utf-8")
    digits = {"x_px": 2, "y_px": 2, "rank": 3, "network": 3, "others": 3}
    table = pd.DataFrame(suspects, columns=["image", "keypoint", *digits, "reasons"])
    for name, count in digits.items():
        table[name] = ["" if np.isnan(value) else f"{value:.{count}f}" for value in table[name]]
    table.assign(reasons=table["reasons"].map("; ".join)).to_csv(folder / "suspicious.csv", index=False)
    return report


# -- labels that are probably wrong ------------------------------------------------------------------------------------


def suspicious_labels(labels: Labels, xy_px: Array, length_px: float) -> list[dict[str, Any]]:
    """The most suspicious first: image and keypoint, x_px and y_px; what speaks against the label, by the network and
    the others, in body lengths (NaN where it says nothing); its rank and the reasons in words.

    xy_px (N, K, 2): what the network says, in pixels of the clip, NaN in pictures that it has not learned from."""
    clues = {
        "network": np.linalg.norm(xy_px - labels.xy_px, axis=2) / length_px,
        "others": _excess_distance_px(labels.xy_px) / length_px,
    }
    known = np.array([median(of_one) for of_one in clues["network"].T])
    limits = {"network": np.fmax(FAR, LEARNED * known), "others": np.full(len(known), APART)}
    found = []
    for i, k in np.argwhere(labels.labelled):
        (x, y), against = labels.xy_px[i, k].tolist(), {name: float(of_all[i, k]) for name, of_all in clues.items()}
        beyond = [name for name, value in against.items() if value > limits[name][k]]
        reasons = tuple(f"{against[name]:.2f} {REASONS[name]}" for name in beyond)
        row = {"image": labels.images[i], "keypoint": labels.names[k], "x_px": x, "y_px": y, **against}
        found += [row | {"rank": sum(against[name] for name in beyond), "reasons": reasons}] if beyond else []
    return sorted(found, key=lambda row: -row["rank"])[:MOST]


def _excess_distance_px(xy_px: Array) -> Array:
    """(N, K): by how much a label is farther than usual from that of the others to which this is least so; px."""
    n, k = xy_px.shape[:2]
    least = np.full((n, k), np.inf)
    for j in range(k):
        distance = np.linalg.norm(xy_px - xy_px[:, j : j + 1], axis=2)
        distance[:, j] = np.nan
        known = np.isfinite(distance).sum(axis=0) >= 5
        usual = np.full(k, np.nan)
        usual[known] = np.nanquantile(distance[:, known], USUAL, axis=0)
        least = np.fmin(least, distance - usual)
    return np.where(np.isfinite(least), least, np.nan)
