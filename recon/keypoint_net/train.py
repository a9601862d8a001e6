"""Train a keypoint network on labelled pictures (`recon train`).

The optimiser is AdamW. In the first part of a run, the network learns from the training pictures. The validation
pictures serve to evaluate the network and to calibrate its likelihoods. In the last part, from `FINISH_FRACTION` on, it
learns from both, so that no label is wasted. In each part the learning rate falls along a cosine to almost 0. At the
start of the run, the rate warms up first. The final weights are a moving average of the optimiser's weights.

The result of a run depends only on its settings, its labels and its device, because augmentation depends on the seed
and the step, and a checkpoint contains everything else. If the number of steps is given, a run that was stopped and
resumed ends with exactly the same weights. If the number of minutes is given, the number of steps depends on the speed
of the machine.
"""

from __future__ import annotations

import copy
import dataclasses
import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from recon.base.arrays import Array, Bools, Integers, mean, median, to_plain
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.files import write_bytes
from recon.base.locks import sole_writer
from recon.base.outputs import Output
from recon.base.progress import Progress, silent
from recon.base.settings import input_paths
from recon.base.tables import write_frame
from recon.base.version import __version__
from recon.io.video import Image
from recon.keypoint_net import labels as data
from recon.keypoint_net import network as net
from recon.keypoint_net import pictures
from recon.keypoint_net.settings import LabelSource, TrainRunSettings, TrainSettings
from recon.show.overlay import draw_circle, draw_line, draw_text
from recon.show.plain import picked, to_json
from recon.show.plots import style

if TYPE_CHECKING:
    import torch  # pyright: ignore[reportMissingImports]

CHECKPOINT_FILE = "checkpoint.pt"
REPORT_FILES = ("training.json", "suspicious.csv", "worst.png", "training.png", "training.svg")
TOLERANCE = 0.04
"""Largest distance of a correct point from its label, as a fraction of the body length."""
LEARNING_RATE = 2e-3
"""Highest learning rate of AdamW."""
WEIGHT_DECAY = 0.05
"""Weight decay of AdamW."""
FINISH_FRACTION = 0.6
"""Fraction of a run after which the network also learns from the validation pictures."""
FINISH_RATE = 0.5
"""Initial learning rate of the part after `FINISH_FRACTION`, relative to `LEARNING_RATE`."""
WARM_UP = 0.04
"""Fraction of a run over which the learning rate rises."""
EVALUATIONS = 30
"""Number of evaluations in a run."""
MAX_AVERAGED_STEPS = 300.0
"""Maximum number of steps over which the weights are averaged. The average is shorter at the beginning."""


@dataclass(frozen=True, eq=False)
class TrainingRun:
    """Fixed inputs of a training run, with pictures at the network's scale."""

    settings: TrainSettings
    spec: net.Spec
    labels: data.Labels
    scaled: data.Labels
    split: dict[str, Integers]
    backgrounds: tuple[Image | None, ...]
    device: torch.device


@dataclass
class State:
    """State of a training run, which changes from step to step."""

    network: torch.nn.Module
    average: torch.nn.Module
    optimizer: torch.optim.Optimizer
    step: int = 0
    share: float = 0.0
    """Fraction of the run that is done, which determines the learning rate."""
    seconds: float = 0.0
    """Total duration of the run, including the time before it was resumed, seconds."""
    calibration: net.Calibration | None = None
    judged: tuple[list[float], list[bool]] = ([], [])
    """Calibrated likelihoods of the labelled validation points, and whether each of these points is correct."""
    history: list[dict[str, float]] = field(default_factory=list)
    """Loss, error and time at each evaluation."""
    losses: list[float] = field(default_factory=list)
    """Losses of the steps since the last evaluation."""
    threads: int = 0
    """Number of CPU threads, or 0 if not yet chosen."""

    @property
    def finishing(self) -> bool:
        """Return whether the run also learns from the validation pictures."""
        return self.share >= FINISH_FRACTION


def prepare(labels: data.Labels, s: TrainRunSettings, device: torch.device) -> TrainingRun:
    """Prepare the inputs of a run: split the labels, choose the network's scales, and make pictures and backgrounds."""
    split = data.split_labels(labels, s.validation, s.test, s.seed)
    learned = np.concatenate([split["train"], split["validation"]])
    scale, first = pictures.network_scales(labels.xy_px[learned])
    length = data.body_length_px(labels.xy_px[learned])
    length = length if np.isfinite(length) else 100.0
    spec = net.Spec(labels.names, scale, float(length), float(TOLERANCE * length), first)
    scaled = labels.scaled(scale)
    return TrainingRun(s, spec, labels, scaled, split, pictures.backgrounds(scaled, split["test"]), device)


def train(
    run: TrainingRun, output: Output, resume: bool = False, threads: int | None = None, progress: Progress = silent
) -> State:
    """Train a network, or continue to train it, to the end of the run.

    Parameters
    ----------
    run : TrainingRun
        Inputs of the run.
    output : Output
        Folder that gets a checkpoint at each evaluation, and the model at the end.
    resume : bool
        Continue from the folder's checkpoint.
    threads : int, optional
        Number of CPU threads; by default as many as the run had before, or all.
    progress : callable
        Called with a description of the current step and the fraction of the work that is done.
    """
    torch = net.require_torch()
    torch.backends.cudnn.deterministic, torch.backends.cudnn.benchmark = True, False
    state = _resumed(run, output.folder) if resume else _begin(run)
    settings, half = run.settings, net.fast_half(run.device)
    labelled = np.flatnonzero(run.labels.labelled.any(axis=1))
    first = np.intersect1d(run.split["train"], labelled)
    all_labelled = np.union1d(first, np.intersect1d(run.split["validation"], labelled))
    sources = _sources(run)
    net.use_threads(threads or state.threads)
    state.threads = torch.get_num_threads()
    began_s = time.monotonic() - state.seconds
    while state.share < 1.0:
        held_out = not state.finishing
        pool, steps = first if held_out else all_labelled, count(state.step)
        batches = (tuple(source(step, pool) for source in sources) for step in steps)
        with closing(pictures.prefetched(batches, pictures.BATCHES_AHEAD)) as drawn:
            while state.share < 1.0 and held_out != state.finishing:
                rate, share_before = LEARNING_RATE * schedule(state.share), state.share
                value = _learn(state, next(drawn), rate, run, half)
                state.seconds = time.monotonic() - began_s
                timed = max(share_before, state.seconds / (60 * settings.minutes))
                fraction = share_before + 1 / settings.steps if settings.steps else timed
                state.share = 1.0 if fraction > 1 - 1e-9 else fraction
                state.losses.append(value)
                due = math.floor(state.share * EVALUATIONS) > math.floor(share_before * EVALUATIONS) or state.share >= 1
                if due or (held_out and state.finishing):
                    row = {"step": state.step, "loss": float(np.mean(state.losses)), "rate": rate, "share": state.share}
                    state.history.append(row | ({} if held_out else {"finishing": 1.0}))
                    state.losses.clear()
                    _evaluate(state, run, calibrates=held_out and state.finishing)
                    _save_checkpoint(state, run, output)
                last = state.history[-1] if state.history else {}
                text = f"step {state.step}, loss {np.mean(state.losses) if state.losses else last['loss']:.3f}"
                if "validation_px" in last:
                    text += f", validation error {last['validation_px']:.2f} px"
                progress(f"{'finishing' if state.finishing else 'learning'}: {text}", state.share)
    spec = dataclasses.asdict(run.spec) | {"calibration": state.calibration}
    content = {"format": net.FORMAT, "spec": spec, "weights": state.average.state_dict()}
    with output.staged(adds=True) as folder:
        net.save_torch(content, folder / net.MODEL_FILE)
    return state


def _sources(run: TrainingRun) -> tuple[Any, ...]:
    """Return, for each stage, a function that makes the batch of a step from a pool of pictures."""
    settings, spec = run.settings, run.spec
    options = pictures.Augmentation(partner=data.sides(spec.names) if settings.mirror else None)
    labels, backgrounds = run.scaled, run.backgrounds
    if spec.two_stages:
        labels = labels.scaled(spec.first)
        backgrounds = tuple(None if b is None else data.resize(b, spec.first) for b in backgrounds)
    size_px, last = pictures.crop_size(run.scaled, spec.first), (options, settings.batch, settings.seed)
    first = partial(pictures.make_batch, pictures.examples_of(labels, backgrounds), size_px, *last)
    if not spec.two_stages:
        return (first,)
    # The length scales blur and patches, which are then as large relative to the animal as in the first stage.
    part_settings = {"part": True, "length_px": pictures.NETWORK_LENGTH_PX}
    parts = [
        dataclasses.replace(example, **part_settings) for example in pictures.examples_of(run.scaled, run.backgrounds)
    ]
    off_px = pictures.MAX_WINDOW_ERROR * spec.reach_cells * net.STRIDE
    return first, partial(pictures.make_batch, parts, pictures.PART_PX, *last, off_px=off_px)


def schedule(share: float) -> float:
    """Return the learning rate, relative to the highest rate, after a fraction `share` of the run.

    After a warm-up the rate follows a cosine, then another cosine in the last part. The rate is almost 0 at the
    calibration and at the end.
    """
    if share < FINISH_FRACTION:
        return min(1.0, (share + 1e-3) / WARM_UP) * _cosine(share / FINISH_FRACTION)
    return FINISH_RATE * _cosine((share - FINISH_FRACTION) / (1 - FINISH_FRACTION))


def _cosine(share: float) -> float:
    """Return the factor on the learning rate, a cosine that falls from 1 to almost 0 as `share` rises from 0 to 1."""
    return 1e-3 + (0.5 + 0.5 * math.cos(math.pi * share))


def _learn(
    state: State, batch: tuple[pictures.Batch, ...], rate: float, run: TrainingRun, half: torch.dtype | None
) -> float:
    """Take an optimiser step with one batch per stage, update the averaged weights, and return the loss."""
    import torch  # pyright: ignore[reportMissingImports]

    state.network.train()
    for group in state.optimizer.param_groups:
        group["lr"] = rate
    state.optimizer.zero_grad(set_to_none=True)
    value = 0.0
    for stage, part in zip(net.stages(state.network), batch, strict=True):
        batch_pictures, backgrounds, xy_px, near_px = part
        x = net.as_input(batch_pictures, backgrounds, run.device)
        window = None if near_px is None else (net.to_cells(near_px, run.device), run.spec.reach_cells)
        with torch.autocast(run.device.type, half, enabled=half is not None):
            scores = stage(x)
        error = net.loss(scores, net.to_cells(xy_px, run.device), window)
        error.backward()
        value += float(error.detach())
    torch.nn.utils.clip_grad_norm_(state.network.parameters(), 5.0)
    state.optimizer.step()
    state.step += 1
    keep = 1 - 1 / min(MAX_AVERAGED_STEPS, 1 + 0.2 * state.step)
    with torch.no_grad():
        for a, b in zip(state.average.state_dict().values(), state.network.state_dict().values(), strict=True):
            if a.dtype.is_floating_point:
                a.lerp_(b, 1 - keep)
            else:
                a.copy_(b)
    return value


def _evaluate(state: State, run: TrainingRun, calibrates: bool) -> None:
    """Evaluate the network on the validation pictures.

    If `calibrates` is true, the calibration is fitted as well, at the end of the first part and before the network
    learns from these pictures.
    """
    indices = run.split["validation"]
    if not run.labels.labelled[indices].any():
        return
    errors, raw, _ = judge(net.TrainedNetwork(run.spec, state.average, run.device), run, indices)
    labelled = np.isfinite(errors)
    error_px = errors[labelled]
    state.history[-1] |= {"validation_px": float(np.median(error_px)), "validation_mean_px": float(error_px.mean())}
    if calibrates:
        right: Bools = error_px <= run.spec.tolerance_px
        state.calibration = net.fit_calibration(raw[labelled], right)
        state.judged = net.calibrated(raw[labelled], state.calibration).tolist(), right.tolist()


def judge(trained: net.TrainedNetwork, run: TrainingRun, indices: Integers) -> tuple[Array, Array, Array]:
    """Find the keypoints in n pictures, and compare them with the labels.

    Returns
    -------
    errors_px : (n, K)
        Distances of the points from the labels in pixels of the clip, NaN without a label.
    raw : (n, K)
        Raw likelihoods of the points.
    xy_px : (n, K, 2)
        Points in pixels of the clip.
    """
    xy, raw = np.zeros((len(indices), len(run.spec.names), 2)), np.zeros((len(indices), len(run.spec.names)))
    for c in np.unique(run.scaled.clip[indices]):
        of_clip = np.flatnonzero(run.scaled.clip[indices] == c)
        for part in np.array_split(of_clip, -(-len(of_clip) // 8)):
            xy[part], raw[part] = trained.points([run.scaled.pictures[indices[i]] for i in part], run.backgrounds[c])
    return np.linalg.norm(xy - run.labels.xy_px[indices], axis=2), raw, xy


_PLAIN = ("step", "share", "seconds", "calibration", "judged", "history", "threads")
_TORCH = ("network", "average", "optimizer")


def _begin(run: TrainingRun) -> State:
    """Return the state before the first step, with random weights."""
    torch = net.require_torch()
    with torch.random.fork_rng():
        torch.manual_seed(run.settings.seed)
        network = net.new_network(len(run.spec.names), run.spec.two_stages)
    network = net.on_device(network, run.device)
    decayed = [p for p in network.parameters() if p.ndim > 1]
    undecayed = [p for p in network.parameters() if p.ndim <= 1]
    groups = [{"params": decayed, "weight_decay": WEIGHT_DECAY}, {"params": undecayed, "weight_decay": 0.0}]
    optimizer = torch.optim.AdamW(groups, lr=LEARNING_RATE)
    return State(network, copy.deepcopy(network).requires_grad_(False).eval(), optimizer)


def _save_checkpoint(state: State, run: TrainingRun, output: Output) -> None:
    """Write a checkpoint from which the run can continue as if it had not been interrupted."""
    content = {
        "settings": run.settings.of_training(),
        "names": list(run.spec.names),
        "split": data.frames_by_part(run.labels, run.split),
        **{name: getattr(state, name).state_dict() for name in _TORCH},
        **{name: getattr(state, name) for name in _PLAIN},
    }
    with output.staged(adds=True) as folder:
        net.save_torch(content, folder / CHECKPOINT_FILE)


def _resumed(run: TrainingRun, out: Path) -> State:
    """Load the state of a training run from a folder's checkpoint.

    If the keypoints, settings or pictures of the checkpoint differ from the run's, InputError is raised.
    """
    path = out / CHECKPOINT_FILE
    content = net.load_torch(path)
    if not isinstance(content, dict) or "optimizer" not in content:
        raise InputError(Problem(path, "checkpoint", "a file of another kind", "a file written by `recon train`"))
    problems = []
    if content["names"] != list(run.spec.names):
        expected = f"the keypoints of the labels: {', '.join(run.spec.names)}"
        problems.append(Problem(path, "keypoints", ", ".join(content["names"]), expected))
    for name, value in run.settings.of_training().items():
        was = content["settings"].get(name)
        if to_plain(value) != to_plain(was):
            problems.append(Problem(path, f"setting {name}", str(was), f"{value}, as given now"))
    if not problems and content["split"] != data.frames_by_part(run.labels, run.split):
        problems.append(
            Problem(
                path,
                "pictures",
                "labels or a split that have changed",
                "the labels and the split with which the run began",
            )
        )
    state = _begin(run)
    same = content["network"].keys() == state.network.state_dict().keys() and {*_PLAIN} <= content.keys()
    if not problems and not same:
        expected = "a network of this version of recon; --overwrite starts again"
        problems.append(Problem(path, "network", "a network that another version of recon started", expected))
    raise_problems(problems)
    for name in _TORCH:
        getattr(state, name).load_state_dict(content[name])
    return dataclasses.replace(state, **{name: content[name] for name in _PLAIN})


MAX_WORST_PICTURES = 6
"""Maximum number of pictures in worst.png."""
MIN_WIDTH_PX = 560
"""Width below which a picture in worst.png is enlarged, pixels."""
LABEL = (255, 255, 255)
"""Colour (blue, green, red) of labels in worst.png."""
LINE = (60, 60, 230)
"""Colour (blue, green, red) of the lines from labels to predictions in worst.png."""
SUSPICIOUS_DISTANCE = 0.2
"""Distance of a label from the network's point, in body lengths, above which the label is suspicious."""
SUSPICIOUS_EXCESS = 0.15
"""Distance from the other labels, in body lengths beyond the usual distance, above which a label is suspicious."""
REASONS = {
    "network": "body lengths from the network's point",
    "others": "body lengths farther from every other label than usual",
}
SUSPICIOUS_RATIO = 5.0
"""Distance of a label from the network's point above which a label is suspicious, relative to the keypoint's median.

The distance must also exceed `SUSPICIOUS_DISTANCE`. A large median means that the network has not learned the keypoint.
"""
MAX_LEARNED_ERROR = 2.0
"""Largest median error in the training pictures with which a network can find suspicious labels.

The error is relative to the tolerance of a correct point.
"""
USUAL_MINUTES = 15.0
"""Time in which two cores train a useful network, minutes."""
USUAL_STEPS = 1000
"""Number of training steps of a useful network.

With `USUAL_PICTURES`, the network has an error of 1.1 px in `python benchmarks/net.py --only circle`.
"""
USUAL_PICTURES = 40
"""Number of labelled pictures needed to train a useful network, as in the benchmark of `USUAL_STEPS`."""
MEASURED_ERRORS = (
    (5, "on a rendered video of an animal 101 px long", "1.8 px"),
    (10, "on a rendered video of an animal 101 px long", "1.2 px"),
    (20, "on a rendered video of an animal 101 px long", "1.1 px"),
    (40, "on a rendered video of an animal 101 px long", "1.1 px"),
    (40, "on a rendered video of an animal 440 px long", "0.8 px"),
    (150, "on a video of a horse, in a different light from that of the labels", "3.1 px"),
)
"""Number of labelled pictures, video and animal, and median error in pictures without labels, in ascending order.

The values come from the tables of docs/net.md (`python benchmarks/net.py --only circle labels large horse`).
"""
USUAL_QUANTILE = 0.95
"""Quantile of the distances between two keypoints that counts as their largest usual distance."""
MAX_SUSPICIOUS = 30
"""Maximum number of suspicious labels in the report."""


def write_training_report(run: TrainingRun, state: State, folder: Path) -> dict[str, Any]:
    """Write the report of a run into an existing folder, and return the content of training.json."""
    spec, split, history = dataclasses.replace(run.spec, calibration=state.calibration), run.split, state.history
    trained = net.TrainedNetwork(spec, state.average, run.device)
    errors, raw, xy_px = judge(trained, run, np.arange(len(run.labels.images)))
    likelihood = net.calibrated(raw, spec.calibration)
    judged = {
        name: _errors_of_part(run, spec, indices, xy_px[indices], likelihood[indices])
        for name, indices in split.items()
        if len(indices)
    }
    # These likelihoods come from the calibrated network, before it learned from the validation pictures.
    reliability_before = data.reliability(np.array(state.judged[0]), np.array(state.judged[1], bool))
    learned = np.concatenate([split["train"], split["validation"]])
    learned_px = median(errors[learned])
    is_fit = bool(learned_px <= MAX_LEARNED_ERROR * spec.tolerance_px)
    suspects = _suspects_among(learned, run, xy_px) if is_fit else []
    report = {
        "recon": __version__,
        "torch": str(net.require_torch().__version__),
        "device": str(run.device),
        "threads": state.threads,
        "source": run.labels.source,
        "keypoints": list(spec.names),
        "parameters": sum(p.numel() for p in state.network.parameters()),
        "first_stage_scale": spec.first,
        **picked(spec, "scale", "body_length_px", "tolerance_px"),
        "settings": run.settings.of_training(),
        "split": data.frames_by_part(run.labels, split),
        "labelled_points": {name: int(run.labels.labelled[indices].sum()) for name, indices in split.items()},
        "steps": state.step,
        "seconds": round(state.seconds, 1),
        **_validation_fields(history),
        "calibration": spec.calibration and dict(zip(("slope", "offset"), spec.calibration, strict=True)),
        "reliability_validation": reliability_before,
        "errors": judged,
        "learned_median_px": learned_px,
        "labels_judged": is_fit,
        "suspicious_labels": suspects,
        "history": history,
        "notes": list(run.labels.notes),
    }
    (folder / "training.json").write_text(to_json(report), encoding="utf-8")
    _write_suspicious(suspects, folder / "suspicious.csv")
    unlearned = np.concatenate([split["validation"], split["test"]])
    style.save(training_figure(history), folder, "training")
    _write_worst(run.labels, errors, xy_px, unlearned if len(unlearned) else split["train"], folder / "worst.png")
    return report


def _suspects_among(learned: Integers, run: TrainingRun, xy_px: Array) -> list[dict[str, Any]]:
    """Return the suspicious labels in the pictures with indices `learned`, from which the network was trained.

    In other pictures, a disagreement may be an error of the network.
    """
    learned_points = np.full_like(xy_px, np.nan)
    learned_points[learned] = xy_px[learned]
    return suspicious_labels(run.labels, learned_points, run.spec.body_length_px)


def _validation_fields(history: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the best error in the validation pictures, and the step from which the network also learned from them."""
    before_finish = [row for row in history if "finishing" not in row]
    held_out = [row for row in before_finish if "validation_px" in row]
    best = min(held_out, key=lambda row: row["validation_px"], default=None)
    return {
        "best_validation": best and {"median_px": best["validation_px"], "step": best["step"]},
        "validation_in_training_from": max((int(row["step"]) for row in before_finish), default=None),
    }


def _errors_of_part(
    run: TrainingRun, spec: net.Spec, indices: Integers, xy_px: Array, likelihood: Array
) -> dict[str, Any]:
    """Return the scores of predictions in some pictures, relative to the animal's length in these pictures."""
    truth = run.labels.xy_px[indices]
    length_px = median(data.extents_px(truth))
    length_px = length_px if np.isfinite(length_px) else spec.body_length_px
    return data.evaluate_2d(spec.names, xy_px, likelihood, truth, length_px, tolerance_px=spec.tolerance_px)


def _write_suspicious(suspects: Sequence[Mapping[str, Any]], path: Path) -> None:
    digits = {"x_px": 2, "y_px": 2, "rank": 3, "network": 3, "others": 3}
    table = pd.DataFrame(suspects, columns=["image", "keypoint", *digits, "reasons"])
    for name, decimals in digits.items():
        table[name] = ["" if np.isnan(value) else f"{value:.{decimals}f}" for value in table[name]]
    write_frame(table.assign(reasons=table["reasons"].map("; ".join)), path)


def training_figure(history: Sequence[Mapping[str, float]]) -> Figure:
    """Draw loss, learning rate and validation error over the steps of a training run."""
    curves = (
        ("loss", "loss", True),
        ("rate", "learning rate", True),
        ("validation_px", "validation\nerror (px)", False),
    )
    shown = [curve for curve in curves if any(curve[0] in row for row in history)]
    with style.drawing(32 * max(len(shown), 1) + 8) as figure:
        panels = figure.subplots(max(len(shown), 1), 1, sharex=True, squeeze=False)[:, 0]
        for i, (axes, (name, label, is_log)) in enumerate(zip(panels, shown, strict=False)):
            rows = [row for row in history if name in row]
            steps, values = ([row[key] for row in rows] for key in ("step", name))
            axes.plot(steps, values, **style.dots(len(rows), 2.5), **style.look(i))
            if is_log:
                axes.set_yscale("log")
                style.plain_logarithm(axes.yaxis)
            axes.set_ylabel(label)
        panels[-1].set_xlabel("step")
        figure.align_ylabels()
    return figure


def expectations(run: TrainingRun) -> list[str]:
    """Return sentences that compare a training run with what a useful network needs."""
    settings, labels = run.settings, run.labels
    labelled_count = int(labels.labelled.any(axis=1).sum())
    planned = f"{settings.steps} steps" if settings.steps else f"{settings.minutes:g} minutes"
    sentences = [
        f"{labelled_count} labelled pictures of {len(labels.names)} keypoints; {planned} on {run.device}. "
        f"A useful network takes about {USUAL_MINUTES:g} minutes on two cores (about {USUAL_STEPS} steps; less on a "
        f"graphics card) and {USUAL_PICTURES} labelled pictures or more.",
        measured_errors(labelled_count),
    ]
    is_short = settings.steps < USUAL_STEPS if settings.steps else settings.minutes < USUAL_MINUTES
    if is_short and run.device.type == "cpu":
        sentences.append(f"{planned} may be too few: raise --{'steps' if settings.steps else 'minutes'} for real use.")
    if labelled_count < USUAL_PICTURES:
        sentences.append(f"{labelled_count} pictures may be too few: label more for real use.")
    return sentences


def measured_errors(labelled_count: int) -> str:
    """Return a sentence on the accuracy measured for a number of labelled pictures, or for the next lower number.

    Below the smallest number that was measured, the sentence gives its accuracy and warns of larger errors.
    """
    measured_counts = sorted(number for number, _, _ in MEASURED_ERRORS)
    nearest = max((number for number in measured_counts if number <= labelled_count), default=measured_counts[0])
    errors = ", and ".join(f"{error} {video}" for number, video, error in MEASURED_ERRORS if number == nearest)
    expected = "" if labelled_count >= nearest else " Expect larger errors with fewer pictures."
    return f"{nearest} labelled pictures gave a median error of {errors}.{expected}"


def _write_worst(labels: data.Labels, errors: Array, xy_px: Array, indices: Integers, path: Path) -> None:
    """Draw the pictures with the largest mean errors, without successive pictures.

    A ring marks each label, a dot marks the prediction, and a line joins the two.
    """
    mean_px, chosen = np.array([mean(of_one) for of_one in errors]), []
    for i in indices[np.argsort(-np.nan_to_num(mean_px[indices], nan=-np.inf))]:
        is_new = all(labels.clip[i] != labels.clip[j] or abs(labels.numbers[i] - labels.numbers[j]) > 2 for j in chosen)
        if is_new and np.isfinite(mean_px[i]) and len(chosen) < MAX_WORST_PICTURES:
            chosen.append(i)
    tiles: list[Image] = []
    for i in chosen:
        factor = max(1, -(-MIN_WIDTH_PX // labels.pictures[i].shape[1]))
        drawn = np.asarray(cv2.resize(labels.pictures[i], None, fx=factor, fy=factor, interpolation=cv2.INTER_CUBIC))
        radius = max(3.0, drawn.shape[1] / 160)
        for k, colour in enumerate(net.point_colours(len(labels.names))):
            if labels.labelled[i, k]:
                label, predicted = (data.scale_points(points[i, k], factor) for points in (labels.xy_px, xy_px))
                draw_line(drawn, label, predicted, LINE, 1)
                draw_circle(drawn, label, radius + 1, LABEL, 1)
                draw_circle(drawn, predicted, 0.6 * radius, colour, -1)
        draw_text(drawn, f"{labels.images[i]}: mean {mean_px[i]:.1f} px", (8, 20), 0.5, LABEL)
        tiles.append(drawn)
    height, width, _ = np.max([tile.shape for tile in tiles], axis=0)
    padded = [np.pad(tile, ((0, height - len(tile)), (0, width - len(tile[0])), (0, 0))) for tile in tiles]
    padded += [np.zeros_like(padded[0])] * (len(tiles) % 2)
    sheet = np.vstack([np.hstack(pair) for pair in zip(padded[::2], padded[1::2], strict=True)])
    write_bytes(path, cv2.imencode(path.suffix, sheet)[1].tobytes())


def suspicious_labels(labels: data.Labels, xy_px: Array, length_px: float) -> list[dict[str, Any]]:
    """Return labels that are probably wrong, the most suspicious first.

    A label is suspicious if the trained network finds the keypoint elsewhere although it learned from this label, or if
    the label is farther than usual from every other label in the picture.

    Parameters
    ----------
    labels : Labels
        N pictures of K keypoints.
    xy_px : ndarray
        The network's points in pixels of the clip, shape (N, K, 2), NaN in pictures outside the training.
    length_px : float
        Length of the animal, px.

    Returns
    -------
    list of dict
        `image`, `keypoint`, `x_px` and `y_px` describe the label. `network` is the distance from the network's point,
        and `others` is the excess over the usual distance from the other labels, both in body lengths (NaN if unknown).
        `rank` is the sum of the values that exceed their limits. `reasons` states the reasons in words.
    """
    clues = {
        "network": np.linalg.norm(xy_px - labels.xy_px, axis=2) / length_px,
        "others": _excess_distance_px(labels.xy_px) / length_px,
    }
    median_distances = np.array([median(of_one) for of_one in clues["network"].T])
    limits = {
        "network": np.fmax(SUSPICIOUS_DISTANCE, SUSPICIOUS_RATIO * median_distances),
        "others": np.full(len(median_distances), SUSPICIOUS_EXCESS),
    }
    rows = []
    for i, k in np.argwhere(labels.labelled):
        (x, y), against = labels.xy_px[i, k].tolist(), {name: float(of_all[i, k]) for name, of_all in clues.items()}
        beyond = {name: value for name, value in against.items() if value > limits[name][k]}
        reasons = tuple(f"{value:.2f} {REASONS[name]}" for name, value in beyond.items())
        row = {"image": labels.images[i], "keypoint": labels.names[k], "x_px": x, "y_px": y, **against}
        rows += [row | {"rank": sum(beyond.values()), "reasons": reasons}] if beyond else []
    return sorted(rows, key=lambda row: -row["rank"])[:MAX_SUSPICIOUS]


def _excess_distance_px(xy_px: Array) -> Array:
    """Return how far each label is beyond its usual distances from all other labels, px, shape (N, K)."""
    n, k = xy_px.shape[:2]
    distance = np.linalg.norm(xy_px[:, :, None] - xy_px[:, None], axis=3)
    distance[:, range(k), range(k)] = np.nan
    pairs = pd.DataFrame(distance.reshape(n, k * k))
    usual = pairs.quantile(USUAL_QUANTILE).where(pairs.count() >= 5)
    return np.fmin.reduce((pairs - usual).to_numpy().reshape(n, k, k), axis=2)


def run_training(
    source: LabelSource,
    settings: TrainSettings,
    out: Path,
    *,
    progress: Progress = silent,
    announce: Callable[[str], object] = lambda sentence: None,
    **options: Any,
) -> dict[str, Any]:
    """Run `recon train`, and return the training report.

    Parameters
    ----------
    source : LabelSource
        The labelled pictures.
    settings : TrainSettings
        Training settings.
    out : Path
        Folder that gets the network, a checkpoint and the report.
    progress : callable
        Called with a description of the current step and the fraction of the work that is done.
    announce : callable
        Called with each sentence of `expectations` before the first step.
    **options
        device, threads, resume and overwrite, as in the command.

    Raises
    ------
    InputError
        If settings, labels or files are invalid, before anything is written. The error lists every problem.
    """
    training_settings = picked(source, *LabelSource.infos()) | picked(settings, *TrainSettings.infos())
    s = TrainRunSettings(out=out, **training_settings, **options)
    net.require_torch()
    chosen, labels, _ = collect_problems(
        lambda: net.choose_device(s.device),
        lambda: data.read_labels(**picked(s, "data", "labels", "first_frame", "individual", "rename")),
        lambda: _check_folder(s),
    )
    run = prepare(labels, s, chosen)
    for sentence in expectations(run):
        announce(sentence)
    with sole_writer(out):
        _check_folder(s)
        output = dataclasses.replace(_output(s), overwrite=True)
        state = train(run, output, s.resume, s.threads, progress)
        progress("report", 1.0)
        with output.staged(adds=True) as staging:
            return write_training_report(run, state, staging)


def _check_folder(s: TrainRunSettings) -> None:
    checkpoint, expected = s.out / CHECKPOINT_FILE, "the checkpoint of a stopped run; leave out --resume for a new run"
    if s.resume and not checkpoint.is_file():
        raise InputError(Problem(checkpoint, "checkpoint", "no such file", expected))
    _output(s).require((net.MODEL_FILE, CHECKPOINT_FILE, *REPORT_FILES))


def _output(s: TrainRunSettings) -> Output:
    content = "a network; --resume continues its training"
    return Output(s.out, "train", s.overwrite or s.resume, input_paths(s), content=content)
