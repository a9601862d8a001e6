"""Draw figures of a result for a paper: chosen by name, stacked vertically, with a caption."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from recon.animal.prior import NONE
from recon.api.analyse import DEFAULT_FIGURES, figures_of
from recon.base.errors import InputError, Problem
from recon.base.numbers import counted
from recon.base.package import version
from recon.fit.result import TrajectorySolution
from recon.gait.clip import ClipAnalysis
from recon.gait.gait import STRIDE_WORDS, WHOLE_CLIP

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CITATION = "The recon developers. recon: metric 3D motion of a running animal from one camera and DeepLabCut keypoints."
CAPTIONS: Mapping[str, str] = {
    "side_view": "Side view of the animal, which runs to the right, at even steps of {steps}; grey: the ground.",
    "joint_flexion": (
        "Joint angles over the stride: flexion from a straight joint, 0 % at the touch-down of the limb's foot. Lines: "
        "means over strides; shaded, for three strides or more: 90 % of further strides; thin lines: 90 % by the "
        "uncertainty of the fit; bars: stance of the foot (for spine and neck: of the foot with the most strides)."
    ),
    "footfalls": "Stances of the feet over time.",
    "speed": "Speed of {joint} over time; bands: 90 %.",
    "composites": (
        "Configurations over the clip from the side, from above and from ahead, coloured by time. Dashed: left; thin: "
        "right; thick: the rest."
    ),
    "phase_portraits": (
        "Phase portraits of the six angles with the largest range relative to their uncertainty: angle against angular "
        "rate, coloured by time; bands: 90 %."
    ),
    "phase_portraits_all": (
        "Phase portraits of all angles: angle against angular rate, coloured by time; grey: mostly from the prior."
    ),
    "observability": "Fraction of each angle's precision that comes from the pixels (blue) and from the prior (grey).",
    "end_effector": "Motion of the chain's end effector, with the ends of strides.",
    "forces": (
        "Stances, vertical force of each foot in body weights, and height of the centre of mass; bands: 90 %; gaps: "
        "stances that the clip cuts."
    ),
}
"""Captions of all figures except figures whose names begin with body_fixed or vector_field."""
_STRIDE_FIGURE = "joint_flexion"
BY_SIDE = ("side_view", "joint_flexion", "footfalls", "forces")
"""Figures that use the colours of the left and right sides."""
_BY_START: Mapping[str, str] = {
    "body_fixed": "Configurations over {steps} in the animal's own frame.",
    "vector_field": "Velocities of the limb's links in the animal's own frame.",
}

_BODY_FIXED_STEPS = {
    WHOLE_CLIP: "the clip, which has no complete stride,",
    "return": "the time after which the end effector returns,",
}
"""Words in captions for the time that a body-fixed figure shows, if that is not a stride."""


@dataclass(frozen=True)
class PrintedFigure:
    """A figure for a paper, and its caption."""

    figure: Figure
    caption: str
    width_mm: float


def draw_for_print(analysis: ClipAnalysis, names: Sequence[str], width_mm: float, results: str = "") -> PrintedFigure:
    """Draw figures of an analysis for a paper, stacked and lettered if there are several.

    Parameters
    ----------
    analysis : ClipAnalysis
        The result of `recon.analyse`.
    names : sequence of str
        Names of the figures, as `recon figure` lists them.
    width_mm : float
        Width on paper in mm, such as 89 for a column and 183 for a page.
    results : str
        Path of the results folder, whose name is in the caption.

    Raises
    ------
    InputError
        If the analysis has no figure of a given name.
    """
    drawn = figures_of(analysis)
    wrong = [name for name in names if name not in drawn]
    if wrong:
        raise InputError(_no_figure(name, analysis, [*drawn], results) for name in wrong)
    draws = [drawn[name] for name in names]
    if not draws:
        raise InputError(Problem(results or "result", "figure", "no figure", f"one or more of {', '.join(drawn)}"))
    figure = _single(draws[0], width_mm) if len(draws) == 1 else _stacked(draws, width_mm)
    return PrintedFigure(figure, caption_of(analysis, names, Path(results).name), width_mm)


def _no_figure(name: str, analysis: ClipAnalysis, drawn: Sequence[str], results: str) -> Problem:
    """Return the problem with a figure that the analysis does not have.

    `drawn` are the names of the figures that the analysis has.
    """
    if name == _STRIDE_FIGURE and analysis.gait is not None and not analysis.gait.strides:
        names = ", ".join(figure for figure in DEFAULT_FIGURES if figure in drawn)
        actual, expected = f"{name}, but no complete stride in the clip", f"another figure, such as {names}"
    else:
        actual, expected = name, f"one of {', '.join(drawn)}"
    return Problem(results or "result", "figure", actual, expected)


def _single(draw: Callable[[], Figure], width_mm: float) -> Figure:
    from recon.show.plots.style import printing

    with printing(width_mm):
        return without_titles(draw())


def _stacked(draws: Sequence[Callable[[], Figure]], width_mm: float) -> Figure:
    """Return one figure with the given figures stacked and lettered, each at its own height."""
    from recon.show.plots.style import MM, drawing, printing

    heights_mm = [_single(draw, width_mm).get_figheight() / MM for draw in draws]
    with printing(width_mm), drawing(sum(heights_mm)) as figure:
        parts = figure.subfigures(len(draws), 1, height_ratios=heights_mm, squeeze=False)[:, 0]
        for letter, part, draw in zip("abcdefghijklmnopqrstuvwxyz", parts, draws, strict=False):
            with printing(width_mm, part):
                draw()
            part.suptitle(letter, x=0.005, ha="left", fontweight="bold")
    return figure


def without_titles(figure: Figure) -> Figure:
    """Return a figure without its title, but with the titles of its panels."""
    if figure.get_suptitle():
        figure.suptitle("")
    return figure


def caption_of(analysis: ClipAnalysis, names: Sequence[str], results: str = "") -> str:
    """Return the caption of figures: content, n, meaning of the bands, method, and citation."""
    motion, gait = analysis.motion, analysis.gait
    several = len(names) > 1
    texts = [
        f"({letter}) {_caption(name, analysis)}" if several else _caption(name, analysis)
        for letter, name in zip("abcdefghijklmnopqrstuvwxyz", names, strict=False)
    ]
    strides = 0 if gait is None else len(gait.strides)
    by_foot = {} if gait is None else {foot: sum(s.foot == foot for s in gait.strides) for foot in gait.tracks.feet}
    feet = ", ".join(f"{foot} {count}" for foot, count in by_foot.items() if count)
    n = f"n = 1 animal, 1 clip, {counted(strides, 'complete stride')}" + (f" ({feet})" if feet else "")
    frames = f"{counted(len(motion.frames), 'frame')} at {motion.fps:g} Hz"
    cameras = counted(len(motion.sources), "camera")
    made = f"Made with recon {version()} from {results or 'a result'}: {frames}, {cameras}, skeleton {motion.body.name}"
    prior = motion.solution.prior if isinstance(motion.solution, TrajectorySolution) else None
    method = f", prior {prior}." if prior and prior != NONE else ", no motion prior."
    sides = ["Blue: left; orange: right; black: the middle."] if any(name in BY_SIDE for name in names) else []
    return "\n".join([*texts, *sides, f"{n}.", made + method, f"Cite: {CITATION} Version {version()}.", ""])


def _caption(name: str, analysis: ClipAnalysis) -> str:
    start = next((text for begin, text in _BY_START.items() if name.startswith(begin)), name.replace("_", " "))
    text = CAPTIONS.get(name, start)
    limb = next((name.removeprefix(begin).strip("_") for begin in _BY_START if name.startswith(begin)), "")
    if limb:
        text = f"{text.removesuffix('.')}: {limb.replace('_', ' ')}."
    origin = WHOLE_CLIP if analysis.stride is None else analysis.stride.at
    if name == "side_view":
        text = text.format(steps=STRIDE_WORDS[origin].caption)
    elif name == "speed":
        text = text.format(joint=analysis.reference)
    elif name.startswith("body_fixed"):
        text = text.format(steps=_BODY_FIXED_STEPS.get(origin, "one stride"))
    if name == "speed" and not analysis.reference_motion.why_no_acceleration:
        text = text.replace("Speed", "Speed and acceleration")
    if name == "footfalls" and analysis.gait is not None:
        from recon.show.plots.over_time import shows_intervals  # matplotlib is slow to import

        if shows_intervals(analysis.gait):
            strides = "; lines with ticks: complete strides" if analysis.gait.strides else ""
            text = f"{text.removesuffix('.')}; thin lines: 90 % interval of each end{strides}."
        text += f" Gait: {analysis.gait.name.name} ({analysis.gait.name.criterion})."
    return text
