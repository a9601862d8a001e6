"""The command `recon evaluate-2d`: compare keypoints with labels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.table import Table
from rich.text import Text

from recon.base.numbers import percent, quantity
from recon.cli.answers import Answer, table_of
from recon.keypoint_net.settings import Evaluate2DSettings
from recon.show.plain import picked


def evaluate_2d_command(settings: Evaluate2DSettings) -> Answer:
    """Compare 2D keypoints with labels: errors in pixels, percentage of good points, reliability of the likelihoods.

    Example: recon evaluate-2d run.csv CollectedData_me.csv
    """
    from recon.keypoint_net.labels import evaluate_2d_files

    result = evaluate_2d_files(**picked(settings, *settings.infos()))
    return Answer(result, [_error_table(result), *_evaluation_lines(result)])


def _error_table(result: dict[str, Any]) -> Table:
    from recon.keypoint_net.labels import PCK_PX, PCK_RELATIVE

    pck = (*(f"{t:g}px" for t in PCK_PX), *map(percent, PCK_RELATIVE))
    table = table_of("errors in px", numbers=("n", "found", "RMSE", "median", *pck), padding=(0, 1, 0, 0))

    def add_row(name: str, score: dict[str, Any], last: bool = False) -> None:
        cells = [str(score["points"]), percent(score["found"]), f"{score['rmse_px']:.2f}", f"{score['median_px']:.2f}"]
        cells += [percent(fraction) for fraction in (*score["pck_px"].values(), *score["pck_relative"].values())]
        row = (cell.replace("nan %", "-").replace("nan", "-") for cell in cells)
        table.add_row(Text(name), *row, end_section=last)

    add_row("all", result["all"])
    add_row("likely", result["likely"], last=result["swaps_forgiven"] is None)
    if result["swaps_forgiven"] is not None:
        add_row("swaps forgiven", result["swaps_forgiven"], last=True)
    for name, score in result["per_keypoint"].items():
        add_row(name, score)
        add_row("  likely", result["likely_per_keypoint"][name])
    return table


def _evaluation_lines(result: dict[str, Any]) -> Iterator[str]:
    yield "found   fraction of the labelled points that were predicted; likely: with a likelihood of at least"
    yield f"        {result['likelihood_min']:g}; swaps forgiven: left and right of a pair may be exchanged"
    yield "RMSE    and median over the points found"
    yield "px, %   fraction of all labelled points within this distance, or this fraction of the body length,"
    yield (
        f"        {quantity(result['body_length_px'], 1, 'px')} (median diagonal of the box around an animal's labels)"
    )
    yield f"Compared: {result['frames']} frames."
    table = result["reliability"]
    if table is not None:
        yield f"Likelihood and fraction of points within {result['tolerance_px']:g} px, {table['points']} points:"
        for b in table["bins"]:
            shares = f"likelihood {b['likelihood']:.2f}  right {b['right']:.2f}"
            yield f"  {b['low']:.1f} to {b['high']:.1f}  {b['points']:6d} points  {shares}"
        yield f"Expected calibration error: {table['expected_calibration_error']:.3f}"
