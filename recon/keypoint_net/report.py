"""What a training run tells about itself: figures, curves, the worst pictures, doubtful labels, reliability."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from recon import __version__
from recon.base.arrays import Array, Integers, mean, median
from recon.base.files import write_bytes
from recon.io import write_rows
from recon.keypoint_net.batches import crop_size
from recon.keypoint_net.calibrate import reliability
from recon.keypoint_net.draw import draw_comparison
from recon.keypoint_net.evaluate2d import Evaluation2D, evaluate_2d
from recon.keypoint_net.labels import Labels, extents_px
from recon.keypoint_net.model import count_parameters
from recon.keypoint_net.run import State, TrainingRun
from recon.keypoint_net.suspicious import suspicious_labels
from recon.keypoint_net.torch_extra import require_torch
from recon.keypoint_net.train import judge
from recon.keypoint_net.trained import Trained, prepared
from recon.show.plain import to_json
from recon.show.plots.style import COLOURS, GREY, drawing, plain_logarithm, save

WORST = 6
CURVE_POINTS = 400


def write_training_report(run: TrainingRun, state: State, folder: Path) -> dict[str, Any]:
    """Into an existing folder; returns what stands in training.json."""
    spec = dataclasses.replace(run.spec, calibrations=state.calibrations)
    trained = Trained(spec, prepared(state.average, run.device), run.device)
    everything = np.arange(len(run.labels.images))
    errors, raw, xy_px = judge(trained, run, everything)
    likelihood = spec.likelihood(raw, "fast")
    parts = {name: getattr(run.split, name) for name in ("train", "validation", "test")}
    judged = {name: _evaluation(run, which, xy_px, likelihood) for name, which in parts.items() if len(which)}
    # Of the network as it was calibrated: before it learned from the validation pictures.
    before = {quality: reliability(*judged) for quality, judged in state.judged.items()}
    # Elsewhere, that the network disagrees says more about the network.
    learned = np.concatenate([run.split.train, *([run.split.validation] if run.settings.finish else [])])
    seen = np.full_like(xy_px, np.nan)
    seen[learned] = xy_px[learned]
    suspects = suspicious_labels(run.labels, seen, spec.body_length_px)
    report = {
        "recon": __version__,
        "torch": str(require_torch().__version__),
        "device": str(run.device),
        "threads": state.threads,
        "step_s_by_threads": state.threads_s,
        "source": run.labels.source,
        "keypoints": list(spec.names),
        "mirror_partners": {
            n: spec.names[p] for n, p in zip(spec.names, spec.partner, strict=True) if spec.names[p] != n
        },
        "parameters": count_parameters(state.network),
        "scale": spec.scale,
        "first_stage_scale": spec.first,
        "training_picture_px": list(crop_size(run.scaled, spec.first)),
        "body_length_px": spec.body_length_px,
        "tolerance_px": spec.tolerance_px,
        "still_background": [b is not None for b in run.still],
        "settings": run.settings.of_training(),
        "split": run.split.to_dict(run.labels),
        "labelled_points": {name: int(run.labels.labelled[which].sum()) for name, which in parts.items()},
        "steps": state.step,
        "seconds": round(state.seconds, 1),
        "stopped_early": state.stopped_early,
        "best_validation": None if state.best is None else {"median_px": state.best_error_px, "step": state.best_step},
        "validation_in_training_from": _finish_step(state),
        "calibrations": {quality: dataclasses.asdict(c) for quality, c in spec.calibrations.items()},
        "reliability_validation": before,
        "errors": {name: dataclasses.asdict(e) for name, e in judged.items()},
        "suspicious_labels": suspects,
        "history": _thinned(state.history),
        "notes": list(run.labels.notes),
    }
    (folder / "training.json").write_text(to_json(report), encoding="utf-8")
    _write_suspects(suspects, folder / "suspicious.csv")
    held_out = np.concatenate([run.split.validation, run.split.test])
    _write_worst(run.labels, errors, xy_px, held_out if len(held_out) else run.split.train, folder / "worst.png")
    _draw_curves(state, folder)
    _draw_keypoints(judged, folder)
    tables = {"validation": before.get("fast"), "test": judged["test"].reliability if "test" in judged else None}
    _draw_reliability({name: table for name, table in tables.items() if table is not None}, folder)
    return report


def _evaluation(run: TrainingRun, which: Integers, xy_px: Array, likelihood: Array) -> Evaluation2D:
    length_px = median(extents_px(run.labels.xy_px[which]))
    length_px = length_px if np.isfinite(length_px) else run.spec.body_length_px
    names, truth = run.spec.names, run.labels.xy_px[which]
    return evaluate_2d(names, xy_px[which], likelihood[which], truth, length_px, tolerance_px=run.spec.tolerance_px)


def _finish_step(state: State) -> int | None:
    return next((int(h["step"]) for h in state.history if h.get("finishing")), None)


def _thinned(history: list[dict[str, float]]) -> list[dict[str, float]]:
    """Every evaluation, and as many other steps as a curve needs, with the mean loss since the last."""
    every = max(1, len(history) // CURVE_POINTS)
    found, since = [], []
    for i, row in enumerate(history):
        since.append(row["loss"])
        if i % every == every - 1 or "validation_px" in row or i == len(history) - 1:
            found.append({**row, "loss": float(np.mean(since))})
            since = []
    return found


def _write_suspects(suspects: list[dict[str, Any]], path: Path) -> None:
    rows = []
    for s in suspects:
        values = ["" if np.isnan(s[name]) else f"{s[name]:.3f}" for name in ("rank", "network", "others", "time")]
        rows.append(
            [s["image"], s["keypoint"], f"{s['x_px']:.2f}", f"{s['y_px']:.2f}", *values, "; ".join(s["reasons"])]
        )
    header = ["image", "keypoint", "x_px", "y_px", "rank", "network", "others", "time", "reasons"]
    write_rows(path, [header], rows)


def _write_worst(labels: Labels, errors: Array, xy_px: Array, which: Integers, path: Path) -> None:
    """The pictures with the largest mean error, no two of them neighbours in time."""
    by_picture = np.nan_to_num([mean(errors[i]) for i in which], nan=-np.inf)
    chosen: list[int] = []
    for i in which[np.argsort(-by_picture)]:
        apart = all(labels.clip[i] != labels.clip[j] or abs(labels.numbers[i] - labels.numbers[j]) > 2 for j in chosen)
        if apart and np.isfinite(errors[i]).any() and len(chosen) < WORST:
            chosen.append(int(i))
    tiles = [
        draw_comparison(
            labels.pictures[i], labels.xy_px[i], xy_px[i], f"{labels.images[i]}: mean {mean(errors[i]):.1f} px"
        )
        for i in chosen
    ]
    size = np.max([t.shape[:2] for t in tiles], axis=0)
    padded = [np.pad(t, ((0, size[0] - t.shape[0]), (0, size[1] - t.shape[1]), (0, 0))) for t in tiles]
    padded += [np.zeros_like(padded[0])] * (len(padded) % 2)
    rows = [np.hstack(padded[i : i + 2]) for i in range(0, len(padded), 2)]
    write_bytes(path, cv2.imencode(path.suffix, np.vstack(rows))[1].tobytes())


def _draw_curves(state: State, folder: Path) -> None:
    rows = _thinned(state.history)
    judged = [row for row in rows if "validation_px" in row]
    with drawing(60) as figure:
        left, right = figure.subplots(1, 2)
        left.plot([r["step"] for r in rows], [r["loss"] for r in rows], color=COLOURS[0])
        left.set(xlabel="step", ylabel="loss")
        if judged:
            right.plot([r["step"] for r in judged], [r["validation_px"] for r in judged], color=COLOURS[1], marker=".")
            right.set(yscale="log")
            plain_logarithm(right.yaxis)
        else:
            right.text(0.5, 0.5, "no validation pictures", transform=right.transAxes, ha="center", color=GREY)
        right.set(xlabel="step", ylabel="median validation error (px)")
        begin = _finish_step(state)
        if begin is not None and judged:
            right.axvspan(begin, rows[-1]["step"], color=GREY, alpha=0.15, lw=0)
            right.set_title("grey: learned from, too", color=GREY)
    save(figure, folder, "curves")


def _draw_keypoints(judged: dict[str, Evaluation2D], folder: Path) -> None:
    """Median error of each keypoint on each part of the labels."""
    names = list(next(iter(judged.values())).per_keypoint)
    with drawing(20 + 4.5 * len(names)) as figure:
        axes = figure.subplots()
        for i, (part, evaluation) in enumerate(judged.items()):
            medians = [evaluation.per_keypoint[name].median_px for name in names]
            axes.plot(medians, np.arange(len(names)), ls="", marker="os^"[i], ms=4, color=COLOURS[i], label=part)
        axes.set_yticks(np.arange(len(names)), names)
        axes.invert_yaxis()
        axes.grid(axis="x", lw=0.4, color="#DDDDDD")
        axes.set(xlabel="median error (px)", xscale="log")
        plain_logarithm(axes.xaxis)
        axes.legend()
    save(figure, folder, "keypoints")


def _draw_reliability(tables: dict[str, dict[str, Any]], folder: Path) -> None:
    with drawing(80, 100) as figure:
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color=GREY, lw=0.6)
        for i, (part, table) in enumerate(tables.items()):
            label = f"{part}: {table['points']} points, error {table['expected_calibration_error']:.3f}"
            likelihood, right = ([b[name] for b in table["bins"]] for name in ("likelihood", "right"))
            axes.plot(likelihood, right, marker="os"[i], color=COLOURS[i], label=label)
        axes.set(xlabel="likelihood", ylabel="share of right points", xlim=(0, 1), ylim=(0, 1), aspect="equal")
        if tables:
            axes.legend(loc="upper left")
    save(figure, folder, "reliability")
