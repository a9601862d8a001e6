"""Leave out slow parts of commands in tests, if another test covers these parts."""

from __future__ import annotations

import json
import pickle
from base64 import b64decode
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import TYPE_CHECKING, Any

import pytest
from command_line import copy_results

from recon import FitSettings
from recon.api import analyse, clip_results
from recon.api.samples import samples_folder
from recon.cli.answers import Answer
from recon.gait import clip as gait_clip
from recon.ik import clip as ik_clip
from recon.show.plots import style
from recon.thesis import clip as frame_clip
from recon.thesis import inspect as frame_record

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from recon.fit.motion import Motion

SMALL_DPI = 50
PIXEL = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNkYPhfDwAChwGA60e6kgAAAABJRU5ErkJggg=="
EMPTY_FILES = {"png": b64decode(PIXEL), "svg": b'<svg xmlns="http://www.w3.org/2000/svg"></svg>', "pdf": b"%PDF-1.4"}
"""Contents of an empty picture, by file type."""


def fit_demo_from(whole_results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let `recon demo` take its fit from `whole_results` and make no page; its own test does both."""

    run_clip, samples = clip_results.run_clip, samples_folder()
    settings_of_demo = FitSettings(keypoints=(samples / "whole.csv",), camera=(samples / "camera.toml",), fps=60)

    def copied(settings: FitSettings, out: Path, *more: Any) -> dict[str, Any]:
        if settings != settings_of_demo:  # other commands use the same function
            return run_clip(settings, out, *more)
        return json.loads((copy_results(whole_results, out) / "report.json").read_text(encoding="utf-8"))

    monkeypatch.setattr("recon.api.clip_results.run_clip", copied)
    monkeypatch.setattr(
        "recon.cli.demo.report", lambda settings, *more: Answer({"page": settings.folder / "report.html"})
    )


def leave_out_drawing(patch: pytest.MonkeyPatch) -> None:
    """Write an empty file for every figure, and make no figures of an analysis at all.

    Each figure is drawn in full in `tests/show`, `test_clip_analysis.py`, `test_solver_analysis.py` or the test of its
    command.
    """
    leave_out_layout(patch)
    patch.setattr(style, "_content", lambda figure, kind, **_: EMPTY_FILES[kind])
    figures_of = analyse.figures_of
    patch.setattr(analyse, "figures_of", lambda result: dict.fromkeys(figures_of(result), empty_figure))


def draw_small(patch: pytest.MonkeyPatch) -> None:
    """Draw figures at a lower resolution, without layout and without hinting of fonts."""
    leave_out_layout(patch)
    patch.setattr(style, "PNG_DPI", SMALL_DPI)
    with NamedTemporaryFile("w", suffix=".mplstyle", encoding="utf-8", delete=False) as sheet:
        sheet.write(style._SHEET.read_text(encoding="utf-8") + "text.hinting: none\n")
    patch.setattr(style, "_SHEET", Path(sheet.name))


def leave_out_layout(patch: pytest.MonkeyPatch) -> None:
    """Leave out the layout of figures, which takes longer than drawing; `test_plots.py` tests it."""
    patch.setattr("matplotlib.figure.Figure.get_layout_engine", lambda _: None)


def draw_two_methods(patch: pytest.MonkeyPatch) -> None:
    """Let `recon ik --compare` draw only the first two of its methods."""
    write_ik_figures = ik_clip.write_figures

    def of_two(solved: ik_clip.IkRun, folder: Path) -> None:
        two = {job: dict(islice(runs.items(), 2)) for job, runs in solved.runs.items()}
        write_ik_figures(replace(solved, runs=two), folder)

    patch.setattr(ik_clip, "write_figures", of_two)


def shorten_cost_study(patch: pytest.MonkeyPatch) -> None:
    """Let `recon ik --costs` follow its path for two periods instead of ten."""
    patch.setattr(ik_clip, "cost_outcome", partial(ik_clip.cost_outcome, turns=2))


def remember_analyses(patch: pytest.MonkeyPatch) -> None:
    """Let `recon analyse`, `compare` and `figure` analyse each motion only once in a process, in any folder."""
    for module in ("recon.api.analyse", "recon.api.compare", "recon.gait.clip"):
        patch.setattr(f"{module}.analyse", _remembered_analysis)


def _remembered_analysis(motion: Motion, stride_s: tuple[float, float] | None = None) -> gait_clip.ClipAnalysis:
    key = motion.solution.joints_m.tobytes(), motion.frames.tobytes(), motion.fps, motion.file, stride_s
    if key not in _ANALYSES:
        _ANALYSES[key] = _analyse(motion, stride_s)
    return _ANALYSES[key]


_analyse = gait_clip.analyse
_ANALYSES: dict[tuple[object, ...], gait_clip.ClipAnalysis] = {}


def solve_frames_once(patch: pytest.MonkeyPatch) -> None:
    """Let the frame method solve equal problems only once in a process, and give each fit a copy of the solution."""
    solve = frame_clip.solve_frames

    def remembered(*problem: Any) -> Any:
        data, progress = problem[:4], problem[4:]
        key = pickle.dumps(data)
        if key not in _FRAME_SOLUTIONS:
            _FRAME_SOLUTIONS[key] = pickle.dumps(solve(*problem))
        solution = pickle.loads(_FRAME_SOLUTIONS[key])
        for tell in progress:
            tell(len(solution.reports))
        return solution

    for module in (frame_clip, frame_record):
        patch.setattr(module, "solve_frames", remembered)


_FRAME_SOLUTIONS: dict[bytes, bytes] = {}


def leave_out_playback(patch: pytest.MonkeyPatch) -> None:
    """Let fits in this process write an empty playback, because the real one takes a third of their time."""
    patch.setattr("recon.show.view.write", lambda motion, path, *_: path.touch())


def empty_figure() -> Figure:
    with style.drawing(20.0) as figure:
        return figure
