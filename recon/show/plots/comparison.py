"""Clips beside each other, by group."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from recon.show.plots.style import COLOURS, drawing

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

TITLES = {
    "speed_m_s": "speed (m/s)",
    "stride_length_m": "stride length (m)",
    "stride_frequency_hz": "stride frequency (Hz)",
    "duty_factor": "duty factor",
}


def comparison(clips: pd.DataFrame, groups: pd.DataFrame, quantities: Sequence[str]) -> Figure:
    """Each clip with one standard deviation, and each group's mean with that of the mean, by quantity."""
    with drawing(62.0) as figure:
        panels = figure.subplots(1, len(quantities), squeeze=False)[0]
        for axes, name in zip(panels, quantities, strict=True):
            for at, group in enumerate(groups["group"]):
                own, colour = clips[clips["group"] == group], COLOURS[at % len(COLOURS)]
                beside = at + np.linspace(-0.18, 0.18, len(own)) if len(own) > 1 else np.array([float(at)])
                axes.errorbar(beside, own[name], own[f"{name}_sigma"], fmt="o", ms=3, lw=0.8, color=colour, alpha=0.7)
                mean, sigma = groups.loc[groups["group"] == group, [name, f"{name}_sigma"]].to_numpy(float)[0]
                if np.isfinite(mean):
                    axes.fill_between(
                        [at - 0.32, at + 0.32], mean - sigma, mean + sigma, color=colour, alpha=0.25, lw=0
                    )
                    axes.plot([at - 0.32, at + 0.32], [mean, mean], color=colour, lw=1.4)
            axes.set_xticks(range(len(groups)), groups["group"], rotation=30 if len(groups) > 3 else 0)
            axes.set_title(TITLES.get(name, name))
    return figure
