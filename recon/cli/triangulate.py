"""The command `recon triangulate`: triangulate keypoints without a skeleton."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

from rich.table import Table

from recon.api.settings import TRIANGULATION_SETTINGS, FitSettings
from recon.base.numbers import length_text, percent
from recon.base.settings import Option, Settings
from recon.cli.answers import Answer, table_of
from recon.cli.commands import OptionsOf

MANY_LEFT_OUT = 0.2
"""Fraction of a camera's detections in disagreement with the other cameras above which a note names the camera."""


class _TriangulateSettings(Settings):
    """Settings of `recon triangulate` in addition to the settings of the clip."""

    out: Path
    """Folder for the results, such as results/clip1."""
    smooth: Annotated[bool, Option()] = False
    """Smooth the points over time with splines, and fill gaps of up to 0.2 s. (default: neither)"""
    overwrite: bool = False
    """Replace results in the folder."""


_OfClip = Annotated[dict[str, Any], OptionsOf(FitSettings, TRIANGULATION_SETTINGS)]


def triangulate(settings: _TriangulateSettings, options: _OfClip) -> Answer:
    """Triangulate the keypoints of two or more cameras without a skeleton: points, covariances, and gaps.

    Example: recon triangulate cam1.csv cam2.csv cam3.csv --camera scene.json --fps 90 --out results/points

    Exit code 0: written. 2: the input cannot be used.
    """
    from recon.api.clip_results import read_settings
    from recon.api.triangulation import run_triangulation

    clip = run_triangulation(read_settings(None, options), settings.out, settings.smooth, settings.overwrite)
    summary = clip.summary()
    return Answer({"out": settings.out} | summary, [*_lines(settings.out, summary)])


def _lines(out: Path, summary: Mapping[str, Any]) -> Iterator[str | Table]:
    from recon.api.triangulation import COVARIANCES
    from recon.gait.evaluation import POSE3D, TRIANGULATED

    total = summary["frames"] * summary["keypoints"]
    sigma = (
        ""
        if summary["median_sigma_m"] is None
        else f", ± {length_text(summary['median_sigma_m'])} (median standard deviation of a point)"
    )
    yield f"{summary['points']} of {total} points are known{sigma}; the others are empty cells."
    rows = []
    for name, camera in summary["cameras"].items():
        error = "-" if camera["median_error_px"] is None else f"{camera['median_error_px']:.1f}"
        rows.append((name, error, str(camera["compared"]), str(camera["left_out"])))
    yield table_of("camera", numbers=("median error, px", "detections", "left out as outliers"), rows=rows)
    for name, camera in summary["cameras"].items():
        if camera["left_out"] > MANY_LEFT_OUT * max(camera["compared"], 1):
            fraction = camera["left_out"] / camera["compared"]
            yield (
                f"{percent(fraction)} of the detections of {name} disagree with the other cameras. "
                "recon fit tests which camera is turned, late or exchanged."
            )
    if not summary["knows_up"]:
        yield "The cameras' poses do not say which way is up: z is up if the first camera is level (or --set up)."
    yield f"Written: {out / POSE3D}, {COVARIANCES} and {TRIANGULATED}."
