"""Training: from labelled pictures to weights.

AdamW with a warm-up and a cosine down to nothing, twice; the weights that count are a moving average of those that it
moves. The first part of a run learns from the training pictures and is judged by the validation pictures, which also
calibrate the likelihoods; the last part, from `FINISH` on, learns from both, so that no label is lost.

A run is a function of its settings, its labels and its device: augmentation depends on the seed and the step only, and
a checkpoint holds everything else. With a number of steps, a run that was stopped and goes on ends in the same weights
bit for bit; with a number of minutes, the speed of the machine decides how many steps there are.
"""

from __future__ import annotations

import copy
import dataclasses
import math
import time
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from recon.base.arrays import Array, Integers
from recon.base.progress import Progress, silent
from recon.keypoint_net.augment import Augmentation
from recon.keypoint_net.batches import (
    NETWORK_LENGTH_PX,
    OFF,
    PART_PX,
    Batch,
    BatchSource,
    batches,
    crop_size,
    examples_of,
)
from recon.keypoint_net.calibrate import fit_calibration
from recon.keypoint_net.decode import SIGMA, Window, loss
from recon.keypoint_net.labels import resize
from recon.keypoint_net.model import STRIDE, stages
from recon.keypoint_net.run import LEARNING_RATE, State, TrainingRun, TrainSettings, begin, resumed, save_checkpoint
from recon.keypoint_net.torch_extra import fast_half, fastest_threads, require_torch, use_threads
from recon.keypoint_net.trained import MODEL_FILE, VIEWS, Trained, as_input, places, prepared, save_model

FINISH = 0.6
"""Share of a run after which the validation pictures are learned from, too."""
FINISH_RATE = 0.5
"""The learning rate with which that begins, relative to the highest before."""
WARM_UP = 0.04
EVALUATIONS = 30
MOST_AVERAGED = 300.0
"""Steps over which the weights are averaged, at most; fewer at the beginning."""


def train(
    run: TrainingRun, out: Path, resume: bool = False, threads: int | None = None, progress: Progress = silent
) -> State:
    """Trains, or goes on, to the end; `out` gets a checkpoint at each evaluation, and the model at the end.

    threads: for the CPU; None: those that a run had before, or those with which a step is fastest now.
    """
    torch = require_torch()
    torch.backends.cudnn.deterministic, torch.backends.cudnn.benchmark = True, False
    state = resumed(run, out) if resume else begin(run)
    settings, split = run.settings, run.split
    half = fast_half(run.device) if settings.half else None
    shown = np.flatnonzero(run.labels.labelled.any(axis=1))
    first = np.intersect1d(split.train, shown)
    both = np.intersect1d(np.concatenate([split.train, split.validation]), shown)
    sources = _sources(run)
    if threads or state.threads or run.device.type != "cpu":
        use_threads(threads or state.threads)
    else:
        progress("timing threads", 0.0)
        trial = begin(run)
        with closing(batches(sources, 0, first)) as drawn:
            state.threads_s = fastest_threads(lambda: _learn(trial, next(drawn), 0.0, run, half))
    state.threads = torch.get_num_threads()
    began_s = time.monotonic() - state.seconds
    while state.share < 1.0:
        held_out = not state.finishing
        with closing(batches(sources, state.step, first if held_out else both)) as drawn:
            while state.share < 1.0 and held_out != state.finishing:
                rate = LEARNING_RATE * schedule(state.share, settings.finish)
                value = _learn(state, next(drawn), rate, run, half)
                state.seconds = time.monotonic() - began_s
                _advance(state, settings)
                row = {"step": state.step, "loss": value, "rate": rate, "share": state.share}
                state.history.append(row | ({} if held_out else {"finishing": 1.0}))
                if _is_evaluation_due(state) or (held_out and state.finishing):
                    _evaluate(state, run, held_out)
                    _stop_early(state, settings)
                    if held_out and (state.finishing or state.share >= 1):
                        _end_first_part(state, run)
                    save_checkpoint(state, run, out)
                progress(f"{'finishing' if state.finishing else 'learning'}: {_figures_text(state)}", state.share)
    spec = dataclasses.replace(run.spec, calibrations=state.calibrations)
    save_model(spec, state.average.state_dict(), out / MODEL_FILE)
    return state


def _sources(run: TrainingRun) -> tuple[BatchSource, ...]:
    """One for each stage."""
    settings, spec = run.settings, run.spec
    options = Augmentation(partner=spec.partner if settings.mirror else None)
    labels, still = run.scaled, run.still
    if spec.two_stages:
        labels = labels.scaled(spec.first)
        still = tuple(None if b is None else resize(b, spec.first) for b in still)
    examples = examples_of(labels, still)
    first = BatchSource(examples, crop_size(run.scaled, spec.first), options, settings.batch, settings.seed)
    if not spec.two_stages:
        return (first,)
    # What is drawn or blurred on a part is as large in it as on the whole animal in its smaller picture.
    parts = [dataclasses.replace(e, part=True, length_px=NETWORK_LENGTH_PX) for e in examples_of(run.scaled, run.still)]
    off_px = OFF * spec.reach_places * STRIDE
    return first, BatchSource(parts, PART_PX, options, settings.batch, settings.seed, off_px)


def schedule(share: float, finish: bool) -> float:
    """Factor of the learning rate at a share of the run: a warm-up and a cosine, and another one for the last part.

    The network is at rest when it is calibrated, as it is at the end.
    """
    warm = min(1.0, (share + 1e-3) / WARM_UP)
    if not finish:
        return warm * _cosine(share)
    if share < FINISH:
        return warm * _cosine(share / FINISH)
    return FINISH_RATE * _cosine((share - FINISH) / (1 - FINISH))


def _cosine(share: float) -> float:
    """From 1 down to nearly 0."""
    return 1e-3 + (0.5 + 0.5 * math.cos(math.pi * share))


def _learn(state: State, batch: tuple[Batch, ...], rate: float, run: TrainingRun, half: Any) -> float:
    import torch  # pyright: ignore[reportMissingImports]

    state.network.train()
    for group in state.optimizer.param_groups:
        group["lr"] = rate
    state.optimizer.zero_grad(set_to_none=True)
    value = 0.0
    for stage, part in zip(stages(state.network), batch, strict=True):
        pictures, backgrounds, xy_px, near_px = part
        x = as_input(pictures, backgrounds, run.device)
        xy = places(xy_px, run.device)
        window = None if near_px is None else Window(places(near_px, run.device), run.spec.reach_places)
        with torch.autocast(run.device.type, half, enabled=half is not None):
            scores = stage(x)
        error = loss(scores, xy, SIGMA, window)
        error.backward()
        value += float(error.detach())
    torch.nn.utils.clip_grad_norm_(state.network.parameters(), 5.0)
    state.optimizer.step()
    state.step += 1
    keep = 1 - 1 / min(MOST_AVERAGED, 1 + 0.2 * state.step)
    with torch.no_grad():
        for a, b in zip(state.average.state_dict().values(), state.network.state_dict().values(), strict=True):
            if a.dtype.is_floating_point:
                a.lerp_(b, 1 - keep)
            else:
                a.copy_(b)
    return value


def _advance(state: State, settings: TrainSettings) -> None:
    """The share of the run that is done: of its steps, or of its time."""
    if settings.steps is not None:
        share = state.share + 1 / settings.steps
    else:
        share = max(state.share, state.seconds / (60 * settings.minutes) + state.skipped)
    state.share = 1.0 if share > 1 - 1e-9 else share
    state.finishing = settings.finish and state.share >= FINISH


def _stop_early(state: State, settings: TrainSettings) -> None:
    """Where the validation error has not fallen for long, the first part of the run ends."""
    if state.finishing or state.since_best < settings.patience:
        return
    to = FINISH if settings.finish else 1.0
    state.skipped += to - state.share
    state.share, state.stopped_early, state.finishing = to, True, settings.finish


def _is_evaluation_due(state: State) -> bool:
    """At each `EVALUATIONS`th of the run."""
    before = state.history[-2]["share"] if len(state.history) > 1 else 0.0
    return math.floor(state.share * EVALUATIONS) > math.floor(before * EVALUATIONS) or state.share >= 1


def _evaluate(state: State, run: TrainingRun, held_out: bool) -> None:
    """held_out: whether the validation pictures have not been learned from yet."""
    which = run.split.validation
    if not len(which) or not run.labels.labelled[which].any():
        return
    errors, _, _ = judge(Trained(run.spec, prepared(state.average, run.device), run.device), run, which)
    known = errors[np.isfinite(errors)]
    median = float(np.median(known))
    state.history[-1].update({"validation_px": median, "validation_mean_px": float(known.mean())})
    if not held_out:
        return
    if median < state.best_error_px:
        state.best, state.best_error_px = copy.deepcopy(state.average.state_dict()), median
        state.best_step, state.since_best = state.step, 0
    else:
        state.since_best += 1


def _end_first_part(state: State, run: TrainingRun) -> None:
    """Calibrates by the validation pictures, which have not been learned from so far. Where they never are, the best
    weights are the result."""
    if not run.settings.finish and state.best is not None:
        state.average.load_state_dict(state.best)
    which = run.split.validation
    if not len(which) or not run.labels.labelled[which].any():
        return
    trained = Trained(run.spec, prepared(state.average, run.device), run.device)
    for quality in VIEWS:
        errors, raw, _ = judge(trained, run, which, quality)
        labelled = np.isfinite(errors)
        right = errors[labelled] <= run.spec.tolerance_px
        calibration = fit_calibration(raw[labelled], right)
        state.calibrations[quality] = calibration
        state.judged[quality] = (calibration.apply(raw[labelled]), right)


def judge(trained: Trained, run: TrainingRun, which: Integers, quality: str = "fast") -> tuple[Array, Array, Array]:
    """Errors (n, K) in px of the clip, NaN where there is no label; raw likelihoods (n, K); points (n, K, 2)."""
    xy, raw = np.zeros((len(which), len(run.spec.names), 2)), np.zeros((len(which), len(run.spec.names)))
    for c in np.unique(run.scaled.clip[which]):
        here = np.flatnonzero(run.scaled.clip[which] == c)
        for part in np.array_split(here, -(-len(here) // 8)):
            xy[part], raw[part] = trained.points([run.scaled.pictures[which[i]] for i in part], run.still[c], quality)
    return np.linalg.norm(xy - run.labels.xy_px[which], axis=2), raw, xy


def _figures_text(state: State) -> str:
    recent = [h["loss"] for h in state.history[-50:]]
    judged = next((h["validation_px"] for h in reversed(state.history) if "validation_px" in h), None)
    error = "" if judged is None else f", validation error {judged:.2f} px"
    return f"step {state.step}, loss {np.mean(recent):.3f}{error}"
