"""Keypoint networks that are quick to train."""

from __future__ import annotations

from functools import partial

import pytest

EVALUATIONS = 3


def narrow_networks(patch: pytest.MonkeyPatch) -> None:
    """Networks as deep as those of users, but narrow, and judged three times in a run."""
    from recon.net import model, run, train, trained

    narrow = partial(model.build_network, widths=(4, 8, 12, 16, 16), head=8)
    for module in (run, trained):
        patch.setattr(module, "build_network", narrow)
    patch.setattr(train, "EVALUATIONS", EVALUATIONS)
