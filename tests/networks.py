"""Keypoint networks that are quick to train."""

from __future__ import annotations

from functools import partial

import pytest

EVALUATIONS = 3


def narrow_networks(patch: pytest.MonkeyPatch) -> None:
    """Networks as deep as those of users, but narrow, judged three times in a run, and the same on every machine."""
    from recon.keypoint_net import model, predict, train, trained

    narrow = partial(model.build_network, widths=(4, 8, 12, 16, 16), head=8)
    patch.setattr(model, "SECOND_WIDTHS", (4, 8, 12, 16))
    for module in (model, trained):
        patch.setattr(module, "build_network", narrow)
    patch.setattr(train, "EVALUATIONS", EVALUATIONS)
    for module in (train, predict):
        patch.setattr(module, "fast_half", lambda device: None)
