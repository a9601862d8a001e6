"""One training run: its settings, what it learns from, what it carries from step to step, and its checkpoints."""

from __future__ import annotations

import copy
import dataclasses
import math
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field

from recon.base.arrays import Array, Bools
from recon.base.errors import InputError, Problem, refuse
from recon.base.files import staged_file, write_bytes
from recon.base.settings import Count, Integer, Number, Option, Settings
from recon.io.video import Image
from recon.keypoint_net.background import backgrounds
from recon.keypoint_net.batches import network_scales
from recon.keypoint_net.calibrate import LikelihoodCalibration
from recon.keypoint_net.labels import Labels, body_length_px, sides
from recon.keypoint_net.split import Split
from recon.keypoint_net.torch_extra import placed, require_torch
from recon.keypoint_net.trained import Spec, load_file, new_network
from recon.show.plain import to_plain

if TYPE_CHECKING:
    import torch  # pyright: ignore[reportMissingImports]

CHECKPOINT_FILE = "checkpoint.pt"
TOLERANCE = 0.04
"""Within this, relative to the body length, a point counts as right for its likelihood."""


LEARNING_RATE, WEIGHT_DECAY = 2e-3, 0.05
TRAINING, SPLIT = "Training", "Which pictures"


class TrainSettings(Settings):
    """How a network is trained."""

    finish: Annotated[bool, Option("Learn from the validation pictures, too, at the end.", panel=SPLIT)] = True
    minutes: Annotated[Number, Field(ge=0.05), Option("Time to train.", "0.05 minutes or more", panel=TRAINING)] = 15.0
    steps: Annotated[
        Count | None, Option("Steps to train, instead of a time: the same in every run.", "1 or more", panel=TRAINING)
    ] = None
    batch: Annotated[Count, Option("Pictures in a step.", "1 or more", panel=TRAINING)] = 8
    seed: Annotated[
        Integer, Field(ge=0), Option("Of weights, split and augmentation.", "0 or more", panel=TRAINING)
    ] = 0
    mirror: Annotated[
        bool,
        Option(
            "Train on mirror pictures, too, in which left and right, or near and off, change their names: for animals "
            "that are labelled going one way and filmed going both. Takes longer to learn.",
            panel=TRAINING,
        ),
    ] = False
    patience: Annotated[
        Count, Option("Evaluations without improvement before stopping early.", "1 or more", panel=TRAINING)
    ] = 12
    half: Annotated[bool, Option("Compute in 16 bits where the device is faster with them.", panel=TRAINING)] = True

    def of_training(self) -> dict[str, Any]:
        """Those of training alone, where there are others beside them."""
        return {name: getattr(self, name) for name in TrainSettings.infos()}


@dataclass
class State:
    """All that a run carries from step to step."""

    network: torch.nn.Module
    average: torch.nn.Module
    optimizer: torch.optim.Optimizer
    step: int = 0
    share: float = 0.0
    """Of the run that is done; it decides the learning rate."""
    seconds: float = 0.0
    """Of all its parts."""
    finishing: bool = False
    best: dict[str, Any] | None = None
    """Averaged weights with the lowest validation error, None without one."""
    best_error_px: float = math.inf
    best_step: int = 0
    since_best: int = 0
    stopped_early: bool = False
    skipped: float = 0.0
    """Share of the run that stopping early left out."""
    calibrations: dict[str, LikelihoodCalibration] = field(default_factory=dict)
    """By quality."""
    judged: dict[str, tuple[Array, Bools]] = field(default_factory=dict)
    """By quality: of the labelled validation points, calibrated likelihoods, and which of them are right."""
    history: list[dict[str, float]] = field(default_factory=list)
    threads: int = 0
    """With which it computes on the CPU; 0 where none were chosen yet."""
    threads_s: dict[int, float] = field(default_factory=dict)
    """Seconds of a step by number of threads, where they were chosen by that."""


@dataclass(frozen=True, eq=False)
class TrainingRun:
    """What stays the same from step to step; pictures are at the network's scale."""

    settings: TrainSettings
    spec: Spec
    labels: Labels
    scaled: Labels
    split: Split
    still: tuple[Image | None, ...]
    device: torch.device


def prepare(labels: Labels, split: Split, settings: TrainSettings, device: torch.device) -> TrainingRun:
    known = np.concatenate([split.train, split.validation])
    scale, first = network_scales(labels.xy_px[known])
    length = body_length_px(labels.xy_px[known])
    length = length if np.isfinite(length) else 100.0
    partner = sides(labels.names)
    spec = Spec(labels.names, scale, float(length), float(TOLERANCE * length), partner, settings.mirror, {}, first)
    scaled = labels.scaled(scale)
    return TrainingRun(settings, spec, labels, scaled, split, backgrounds(scaled, split.test), device)


def begin(run: TrainingRun) -> State:
    torch = require_torch()
    with torch.random.fork_rng():
        torch.manual_seed(run.settings.seed)
        network = new_network(run.spec)
    network = placed(network, run.device)
    return State(network, copy.deepcopy(network).requires_grad_(False), _optimizer(network))


def _optimizer(network: torch.nn.Module) -> torch.optim.Optimizer:
    torch = require_torch()
    decayed = [p for p in network.parameters() if p.ndim > 1]
    others = [p for p in network.parameters() if p.ndim <= 1]
    groups = [{"params": decayed, "weight_decay": WEIGHT_DECAY}, {"params": others, "weight_decay": 0.0}]
    return torch.optim.AdamW(groups, lr=LEARNING_RATE)


def save_checkpoint(state: State, run: TrainingRun, out: Path) -> None:
    """Everything that the rest of a run depends on, whole or not at all."""
    torch = require_torch()
    path = out / CHECKPOINT_FILE
    content = {
        "settings": run.settings.of_training(),
        "names": list(run.spec.names),
        "split": run.split.to_dict(run.labels),
        "network": state.network.state_dict(),
        "average": state.average.state_dict(),
        "optimizer": state.optimizer.state_dict(),
        "best": state.best,
        "calibrations": {quality: dataclasses.asdict(c) for quality, c in state.calibrations.items()},
        "judged": {quality: [part.tolist() for part in parts] for quality, parts in state.judged.items()},
        "history": state.history,
        **{name: getattr(state, name) for name in _PLAIN},
    }
    made = BytesIO()
    torch.save(content, made)
    with staged_file(path) as staged:
        write_bytes(staged, made.getvalue())


_PLAIN = ("step", "share", "seconds", "finishing", "best_error_px", "best_step", "since_best", "stopped_early",
          "skipped", "threads", "threads_s")  # fmt: skip


def resumed(run: TrainingRun, out: Path) -> State:
    """The state of a checkpoint. Raises InputError where it belongs to other keypoints, settings or pictures."""
    path = out / CHECKPOINT_FILE
    content = load_file(path)
    if not isinstance(content, dict) or "optimizer" not in content:
        raise InputError(Problem(path, "checkpoint", "a file of another kind", "one that `recon train` wrote"))
    problems = []
    if content["names"] != list(run.spec.names):
        expected = f"those of the labels: {', '.join(run.spec.names)}"
        problems.append(Problem(path, "keypoints", ", ".join(content["names"]), expected))
    given = run.settings.of_training()
    for name, value in content["settings"].items():
        if to_plain(value) != to_plain(given.get(name)):
            problems.append(Problem(path, f"setting {name}", str(value), f"{given.get(name)}, as now given"))
    if not problems and content["split"] != run.split.to_dict(run.labels):
        problems.append(Problem(path, "pictures", "another split of them", "the labels and split of the run so far"))
    refuse(problems)
    state = begin(run)
    if content["network"].keys() != state.network.state_dict().keys():
        expected = "one of this version of recon; --overwrite begins again"
        raise InputError(Problem(path, "network", "one that another version began", expected))
    state.network.load_state_dict(content["network"])
    state.average.load_state_dict(content["average"])
    state.optimizer.load_state_dict(content["optimizer"])
    state.best, state.history = content["best"], content["history"]
    state.calibrations = {
        quality: LikelihoodCalibration(**values) for quality, values in content["calibrations"].items()
    }
    state.judged = {
        quality: (np.array(likelihood, float), np.array(right, bool))
        for quality, (likelihood, right) in content["judged"].items()
    }
    for name in content.keys() & set(_PLAIN):
        setattr(state, name, content[name])
    return state
