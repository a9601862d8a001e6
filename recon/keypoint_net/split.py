"""Which labelled pictures a network is trained on, and which it is judged by."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from recon.base.arrays import Integers
from recon.base.errors import InputError, Problem
from recon.io.common import frames_text
from recon.keypoint_net.labels import Labels

BLOCKS = 10
"""A share of the pictures is held out in this many runs of neighbours in time, or in fewer, longer ones: neighbours
look alike, and what was seen in training would judge itself."""


@dataclass(frozen=True, eq=False)
class Split:
    """Indices into the labelled pictures, increasing, without one in common."""

    train: Integers
    """Learned from."""
    validation: Integers
    """Judged during training and calibrated by."""
    test: Integers
    """Looked at once, at the end."""

    def to_dict(self, labels: Labels) -> dict[str, Any]:
        """Frame numbers by part and clip."""
        return {
            part: {
                labels.clips[c]: frames_text(labels.numbers[which][labels.clip[which] == c])
                for c in np.unique(labels.clip[which])
            }
            for part, which in (("train", self.train), ("validation", self.validation), ("test", self.test))
        }


Choice = float | tuple[int | None, int | None]
"""A share of the pictures, or a half-open range of their numbers."""


def split_labels(labels: Labels, validation: Choice, test: Choice, seed: int) -> Split:
    """The test set first, then the validation set from what remains. Raises InputError where nothing would be left."""
    rest = np.arange(len(labels.images))
    chosen_test = _choose(labels, rest, test, seed, "--test")
    rest = np.setdiff1d(rest, chosen_test)
    chosen = _choose(labels, rest, validation, seed + 1, "--validation")
    train = np.setdiff1d(rest, chosen)
    if not labels.labelled[train].any():
        found = f"no labelled picture of {len(labels.images)} left to train on"
        raise InputError(Problem("--validation, --test", "split", found, "smaller parts"))
    return Split(train, chosen, chosen_test)


def parse_choice(text: str, option: str) -> Choice:
    """ "0.2", or "110:150" with either side empty. Raises InputError."""
    from recon.clip.keypoints import parse_frame_range

    if ":" in text:
        try:
            return parse_frame_range(text)
        except InputError as error:
            raise InputError(Problem(option, p.field, p.found, p.expected) for p in error.problems) from None
    try:
        share = float(text)
    except ValueError:
        share = -1.0
    if not 0 <= share < 1:
        raise InputError(Problem(option, "part", f"'{text}'", "a share from 0 to 1, or frame numbers A:B (B excluded)"))
    return share


def _choose(labels: Labels, rest: Integers, choice: Choice, seed: int, option: str) -> Integers:
    if isinstance(choice, tuple):
        low, high = choice
        numbers = labels.numbers[rest]
        chosen = rest[(numbers >= (low or 0)) & (numbers < (np.inf if high is None else high))]
        if not len(chosen):
            shown = f"{'' if low is None else low}:{'' if high is None else high}"
            has = f"{numbers.min()} to {numbers.max()}" if len(numbers) else "none"
            raise InputError(Problem(option, "frames", f"none in the range {shown}", f"numbers of the labels ({has})"))
        return chosen
    if choice == 0 or len(rest) < 2:
        return rest[:0]
    blocks = np.array_split(rest, min(len(rest), max(BLOCKS, round(2 / choice))))
    count = min(len(blocks) - 1, max(1, round(choice * len(blocks))))
    picked = np.random.default_rng(seed).permutation(len(blocks))[:count]
    return np.sort(np.concatenate([blocks[i] for i in picked]))
