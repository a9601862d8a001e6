"""`recon evaluate-2d`: predicted keypoints against labels, in the picture."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
from rich.table import Table
from rich.text import Text

from recon.animal import load_names, map_to_write, renamed
from recon.base.arrays import Array, Bools
from recon.base.errors import Problem, all_of, refuse
from recon.base.settings import Integer, Number, Option, Positive, Settings
from recon.clip import Keypoints, mark_missing, parse_frame_range
from recon.io import read_keypoints
from recon.wings.keypoint_net.labels import body_length_px, known_points, read_label_file, sides
from recon.workflows.cli import Answer, table_of
from recon.workflows.settings import RENAME, FrameRange

BINS = 10
PCK_PX = (2.5, 5.0, 10.0)
PCK_RELATIVE = (0.05, 0.1, 0.2)
"""Distances as shares of the body length, the median diagonal of the box around an animal's labels."""


class Evaluate2DSettings(Settings):
    """What `recon evaluate-2d` compares, and how."""

    predicted: Annotated[Path, Option(argument="PREDICTED")]
    """Keypoints of any known format, as in run.csv."""
    labels: Annotated[Path, Option(argument="LABELS")]
    """Labels in DeepLabCut's layout, as in CollectedData_me.csv."""
    first_frame: Integer = 0
    """Number that the labels give to frame 0 of the predictions."""
    frames: FrameRange | None = None
    """Frame numbers of the labels to compare, A:B (B excluded)."""
    individual: str | None = None
    """The animal, where the files name several."""
    rename: Annotated[str | None, RENAME] = None
    likelihood_min: Annotated[Number, Option(expected="a number from 0 to 1")] = 0.5
    """Cut-off for the rows of likely points."""
    tolerance_px: Annotated[Positive, Option(expected="pixels above 0")] = 5.0
    """Within this a point is right, for the likelihoods' reliability."""


def evaluate_2d_command(settings: Evaluate2DSettings) -> Answer:
    """Compare 2D keypoints with labels: errors in pixels, shares of good points, reliability of the likelihoods.

    Example: recon evaluate-2d run.csv CollectedData_me.csv
    """
    result = evaluate_2d_files(**{name: getattr(settings, name) for name in settings.infos()})
    return Answer(result, [_table(result), *_notes(result)])


def evaluate_2d_files(predicted: Path, labels: Path, **options: Any) -> dict[str, Any]:
    """options: further fields of `Evaluate2DSettings`. Raises InputError for files that cannot be read or have nothing
    in common."""
    o = Evaluate2DSettings(predicted=predicted, labels=labels, **options)

    def read_predicted() -> Keypoints:
        keypoints = mark_missing(read_keypoints(predicted, o.individual))[0]
        return keypoints if o.rename is None else renamed(keypoints, load_names(o.rename))

    guess, (truth, _) = all_of(read_predicted, lambda: read_label_file(labels, o.individual))
    common = [name for name in truth.names if name in guess.names]
    problems = []
    if not common:
        expected = f"some of: {', '.join(truth.names)}; --rename with a file of these lines, completed"
        lines = tuple(map_to_write(guess.names, truth.names))
        problems.append(Problem(predicted, "keypoints", ", ".join(guess.names), expected, lines))
    low, high = parse_frame_range(o.frames) if o.frames else (None, None)
    numbers = guess.frames + o.first_frame  # as the labels count
    asked = (truth.frames >= (-np.inf if low is None else low)) & (truth.frames < (np.inf if high is None else high))
    rows_t = np.flatnonzero(asked & np.isin(truth.frames, numbers))
    if not len(rows_t):
        first, last = truth.frames[[0, -1]]
        expected = f"some of the labels' frames {first} to {last} that are asked for; --first-frame"
        found = f"frames {numbers[0]} to {numbers[-1]}, in the labels' numbers"
        problems.append(Problem(predicted, "frames", found, expected))
    refuse(problems)
    rows_g = pd.Index(numbers).get_indexer(truth.frames[rows_t])
    g, t = [guess.names.index(n) for n in common], [truth.names.index(n) for n in common]
    return evaluate_2d(
        tuple(common),
        guess.xy_px[rows_g][:, g],
        guess.confidence[rows_g][:, g],
        truth.xy_px[rows_t][:, t],
        body_length_px(truth.xy_px[rows_t]),
        o.likelihood_min,
        o.tolerance_px,
    )


def evaluate_2d(
    names: tuple[str, ...],
    xy_px: Array,
    likelihood: Array,
    label_px: Array,
    length_px: float,
    likelihood_min: float = 0.5,
    tolerance_px: float = 5.0,
) -> dict[str, Any]:
    """Scores of points (N, K, 2) with likelihoods (N, K), against labels (N, K, 2), each NaN where there is none: how
    many `frames`; scores (`_score`) of `all`, of those with a likelihood cut-off (`likely`), and with the two sides of
    the animal allowed to be the wrong way round (`swaps_forgiven`, None where no names differ in their side), by
    keypoint (`per_keypoint`, `likely_per_keypoint`); and the `reliability` of the likelihoods, None without any."""
    labelled = known_points(label_px)
    errors = np.linalg.norm(xy_px - label_px, axis=2)
    likely = np.where(likelihood >= likelihood_min, errors, np.nan)
    partner = sides(names)
    paired = any(p != k for k, p in enumerate(partner))
    known = np.isfinite(errors) & np.isfinite(likelihood)

    def by_keypoint(values: Array) -> dict[str, dict[str, Any]]:
        return {n: _score(values[:, k], labelled[:, k], length_px) for k, n in enumerate(names)}

    return {
        "frames": len(label_px),
        "body_length_px": length_px,
        "likelihood_min": likelihood_min,
        "tolerance_px": tolerance_px,
        "all": _score(errors, labelled, length_px),
        "likely": _score(likely, labelled, length_px),
        "swaps_forgiven": _score(_forgiving_errors_px(xy_px, label_px, partner), labelled, length_px)
        if paired
        else None,
        "per_keypoint": by_keypoint(errors),
        "likely_per_keypoint": by_keypoint(likely),
        "reliability": reliability(np.clip(likelihood[known], 0, 1), errors[known] <= tolerance_px)
        if known.any()
        else None,
    }


def _forgiving_errors_px(xy_px: Array, label_px: Array, partner: tuple[int, ...]) -> Array:
    """Errors (N, K) with each pair of sides the right way round or the other, whichever is better for the pair."""
    own = np.linalg.norm(xy_px - label_px, axis=2)
    other = np.linalg.norm(xy_px[:, list(partner)] - label_px, axis=2)
    cost = np.stack([own, other])
    of_pair = np.nansum(np.stack([cost, cost[:, :, list(partner)]]), axis=0)
    return np.where(of_pair[1] < of_pair[0], other, own)


def _score(errors: Array, labelled: Bools, length_px: float) -> dict[str, Any]:
    """Scores of errors that are NaN where not labelled or not found: how many labelled `points`, the share of them
    `found` (and likely enough), RMSE and median over those, NaN without any, and by distance (`pck_px`) and by part of
    the body length (`pck_relative`) shares of all labelled points, those not found being wrong."""
    n = int(labelled.sum())
    found = errors[labelled & np.isfinite(errors)]

    def share(limit_px: float) -> float:
        return float((found <= limit_px).sum() / n) if n and np.isfinite(limit_px) else np.nan

    return {
        "points": n,
        "found": len(found) / n if n else np.nan,
        "rmse_px": float(np.sqrt(np.mean(found**2))) if len(found) else np.nan,
        "median_px": float(np.median(found)) if len(found) else np.nan,
        "pck_px": {str(limit): share(limit) for limit in PCK_PX},
        "pck_relative": {str(limit): share(limit * length_px) for limit in PCK_RELATIVE},
    }


def reliability(likelihood: Array, right: Bools, bins: int = BINS) -> dict[str, Any]:
    """How reliable likelihoods (N,) in 0 to 1 are, given whether their points are right (N,): how many `points` they
    are; their `expected_calibration_error`, the mean difference of likelihood and share of right points, NaN without
    any; and for the `bins` of equal width with points in them how many; low and high, between which their likelihoods
    lie; their mean; and the share of them that is right."""
    which = np.minimum((likelihood * bins).astype(int), bins - 1)
    rows = []
    for b in np.unique(which):
        here = which == b
        ends = {"low": float(b / bins), "high": float((b + 1) / bins), "points": int(here.sum())}
        rows.append(ends | {"likelihood": float(likelihood[here].mean()), "right": float(right[here].mean())})
    total = len(likelihood)
    error = sum(r["points"] * abs(r["likelihood"] - r["right"]) for r in rows) / total if total else float("nan")
    return {"points": total, "expected_calibration_error": float(error), "bins": rows}


def _table(result: dict[str, Any]) -> Table:
    pck = (*(f"{t:g}px" for t in PCK_PX), *(f"{t:.0%}" for t in PCK_RELATIVE))
    table = table_of("errors in px", numbers=("n", "found", "RMSE", "median", *pck), padding=(0, 1, 0, 0))

    def add_row(name: str, score: dict[str, Any], last: bool = False) -> None:
        cells = [str(score["points"]), f"{score['found']:.0%}", f"{score['rmse_px']:.2f}", f"{score['median_px']:.2f}"]
        cells += [f"{share:.0%}" for share in (*score["pck_px"].values(), *score["pck_relative"].values())]
        row = (cell.replace("nan%", "-").replace("nan", "-") for cell in cells)
        table.add_row(Text(name), *row, end_section=last)

    add_row("all", result["all"])
    add_row("likely", result["likely"], last=result["swaps_forgiven"] is None)
    if result["swaps_forgiven"] is not None:
        add_row("swaps forgiven", result["swaps_forgiven"], last=True)
    for name, score in result["per_keypoint"].items():
        add_row(name, score)
        add_row("  likely", result["likely_per_keypoint"][name])
    return table


def _notes(result: dict[str, Any]) -> Iterator[str]:
    yield "found   share of the labelled points that was predicted; likely: with a likelihood of at least"
    yield f"        {result['likelihood_min']:g}; swaps forgiven: a pair of left and right may be the wrong way round"
    yield "RMSE    and median over the points found"
    yield "px, %   share of all labelled points within this distance, or this share of the body length,"
    yield f"        {result['body_length_px']:.1f} px (median diagonal of the box around an animal's labels)"
    yield f"Compared: {result['frames']} frames."
    table = result["reliability"]
    if table is not None:
        yield f"Likelihood against the share of points within {result['tolerance_px']:g} px, {table['points']} points:"
        for b in table["bins"]:
            shares = f"likelihood {b['likelihood']:.2f}  right {b['right']:.2f}"
            yield f"  {b['low']:.1f} to {b['high']:.1f}  {b['points']:6d} points  {shares}"
        yield f"Expected calibration error: {table['expected_calibration_error']:.3f}"
