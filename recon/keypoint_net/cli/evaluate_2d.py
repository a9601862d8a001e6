"""`recon evaluate-2d`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from recon.base.settings import Integer, Number, Option, Positive, Settings
from recon.clip.keypoints import parse_frame_range
from recon.keypoint_net.evaluate2d import PCK_PX, PCK_RELATIVE, Evaluation2D, Score2D, evaluate_2d_files
from recon.show.report import to_json
from recon.workflows.cli.common import table_of, terminal
from recon.workflows.settings import RENAME, FrameRange


class Evaluate2DSettings(Settings):
    """What `recon evaluate-2d` compares."""

    predicted: Annotated[Path, Option("Keypoints of any known format, as in run.csv.", argument="PREDICTED")]
    labels: Annotated[Path, Option("Labels in DeepLabCut's layout, as in CollectedData_me.csv.", argument="LABELS")]
    first_frame: Annotated[Integer, Option("Number that the labels give to frame 0 of the predictions.")] = 0
    frames: Annotated[FrameRange | None, Option("Frame numbers of the labels to compare, A:B (B excluded).")] = None
    individual: Annotated[str | None, Option("The animal, where the files name several.")] = None
    rename: Annotated[str | None, RENAME] = None
    likelihood_min: Annotated[Number, Option("Cut-off for the rows of likely points.", "a number from 0 to 1")] = 0.5
    tolerance_px: Annotated[
        Positive, Option("Within this a point is right, for the likelihoods' reliability.", "pixels above 0")
    ] = 5.0


def evaluate_2d(settings: Evaluate2DSettings, as_json: bool) -> None:
    """Compare 2D keypoints with labels: errors in pixels, shares of good points, reliability of the likelihoods.

    Example: recon evaluate-2d run.csv CollectedData_me.csv
    """
    result = evaluate_2d_files(
        settings.predicted,
        settings.labels,
        first_frame=settings.first_frame,
        frames=parse_frame_range(settings.frames) if settings.frames else None,
        individual=settings.individual,
        rename=settings.rename,
        likelihood_min=settings.likelihood_min,
        tolerance_px=settings.tolerance_px,
    )
    if as_json:
        typer.echo(to_json(asdict(result)), nl=False)
        return
    terminal().print(_table(result))
    for line in _notes(result):
        typer.echo(line)


def _table(result: Evaluation2D) -> Table:
    pck = (*(f"{t:g}px" for t in PCK_PX), *(f"{t:.0%}" for t in PCK_RELATIVE))
    table = table_of("errors in px", numbers=("n", "found", "RMSE", "median", *pck), padding=(0, 1, 0, 0))

    def add_row(name: str, score: Score2D, last: bool = False) -> None:
        cells = [str(score.points), f"{score.found:.0%}", f"{score.rmse_px:.2f}", f"{score.median_px:.2f}"]
        cells += [f"{share:.0%}" for share in (*score.pck_px.values(), *score.pck_relative.values())]
        row = (cell.replace("nan%", "-").replace("nan", "-") for cell in cells)
        table.add_row(Text(name), *row, end_section=last)

    add_row("all", result.all)
    add_row("likely", result.likely, last=result.swaps_forgiven is None)
    if result.swaps_forgiven is not None:
        add_row("swaps forgiven", result.swaps_forgiven, last=True)
    for name, score in result.per_keypoint.items():
        add_row(name, score)
        add_row("  likely", result.likely_per_keypoint[name])
    return table


def _notes(result: Evaluation2D) -> Iterator[str]:
    yield "found   share of the labelled points that was predicted; likely: with a likelihood of at least"
    yield f"        {result.likelihood_min:g}; swaps forgiven: a pair of left and right may be the wrong way round"
    yield "RMSE    and median over the points found"
    yield "px, %   share of all labelled points within this distance, or this share of the body length,"
    yield f"        {result.body_length_px:.1f} px (median diagonal of the box around an animal's labels)"
    yield f"Compared: {result.frames} frames."
    table = result.reliability
    if table is not None:
        yield f"Likelihood against the share of points within {result.tolerance_px:g} px, {table.points} points:"
        for b in table.bins:
            shares = f"likelihood {b['likelihood']:.2f}  right {b['right']:.2f}"
            yield f"  {b['low']:.1f} to {b['high']:.1f}  {b['points']:6d} points  {shares}"
        yield f"Expected calibration error: {table.expected_calibration_error:.3f}"
