"""Keypoint networks that are quick to train."""

from __future__ import annotations

import pytest

EVALUATIONS = 3


def narrow_networks(patch: pytest.MonkeyPatch) -> None:
    """Networks as deep as those of users, but narrow, judged three times in a run, and the same on every machine.
    Of their points, which are noise, no fit asks whether another picture explains them better."""
    from recon.keypoint_net import network, train

    for name, value in (("WIDTHS", (4, 8, 12, 16, 16)), ("SECOND_WIDTHS", (4, 8, 12, 16)), ("HEAD", 8)):
        patch.setattr(network, name, value)
    patch.setattr(train, "EVALUATIONS", EVALUATIONS)
    patch.setattr(network, "fast_half", lambda device: None)
    patch.setattr("recon.check.inputs.other_picture_finding", lambda given: None)
