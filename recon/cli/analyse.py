"""The commands `recon analyse`, with its answer, and `recon compare`, whose answer is made in `compare.py`."""

from __future__ import annotations

import math
import shlex
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from recon.api.analysis_settings import ANALYSIS_FOLDER, AnalyseSettings, CompareSettings
from recon.base.numbers import quantity
from recon.base.progress import Progress, silent
from recon.cli.answers import Answer, table_of, verdict_texts

if TYPE_CHECKING:
    from recon.gait.clip import ClipAnalysis

MAX_STANCES = 100
"""Maximum number of stances, of all feet together, that are printed."""


def analyse_command(settings: AnalyseSettings, progress: Progress = silent) -> Answer:
    """Analyse a reconstruction: kinematics, gait, vector fields and phase portraits.

    The results are tables (CSV) and figures (PNG, SVG). Afterwards, recon view shows the plots next to the playback.

    Example: recon analyse results/clip
    """
    from recon.api.analyse import run_analysis

    written, out = run_analysis(settings, progress), settings.out_folder
    lines = [*_lines(written.analysis, written.summary), f"{len(written.files)} files are in {out}."]
    if out == settings.folder / ANALYSIS_FOLDER:
        lines.append(f"See them with the playback: recon view {shlex.quote(str(settings.folder))}")
    return Answer(written.summary, lines, files=written.files)


ACCELERATION_KNOWN_M_S2 = 10.0
"""Standard deviation, m/s², above which an acceleration is not reported, as animals rarely accelerate more."""


def _lines(analysis: ClipAnalysis, summary: Mapping[str, Any]) -> Iterator[str | Text | Table]:
    from recon.gait.gait import STRIDE_WORDS
    from recon.gait.stances import interval_text
    from recon.show.sentences import analysis_sentences

    motion = analysis.motion
    yield from verdict_texts(motion.verdict)
    yield from analysis_sentences(analysis)
    net, sigma = analysis.net_acceleration_m_s2
    if math.isfinite(net) and sigma > ACCELERATION_KNOWN_M_S2:
        yield "Acceleration along the path: not known from this camera."
    elif math.isfinite(net):
        yield f"Acceleration along the path, over the whole clip: {interval_text(net, sigma, 'm/s²', '+')}."
    if "spine_flexion" in analysis.angles:
        low, high = (math.degrees(angle) for angle in analysis.angles["spine_flexion"].range_rad)
        yield f"Flexion of the spine: {low:+.0f}° to {high:+.0f}° (positive: arched up)."
    if (dynamics := analysis.dynamics) is not None and dynamics.mean_peak_bw is not None:
        peak, low, high = dynamics.mean_peak_bw
        peak_text = f"{peak:.1f} body weights (90 %: {low:.1f} to {high:.1f}), mean over the stances in forces.csv"
        yield f"Peak vertical force of a foot: {peak_text}."
    if (stride := analysis.stride) is not None:
        foot = f"{stride.foot}, " if stride.foot else ""
        times = f"{stride.start_s:.3f} to {quantity(stride.end_s, 3, 's')}"
        yield f"Phase portraits: {foot}{times}, {STRIDE_WORDS[stride.at].ends}."
    if analysis.gait is not None and len(analysis.gait.stances) <= MAX_STANCES:
        spans: dict[str, list[str]] = {foot: [] for foot in motion.foot_names}
        for s in analysis.gait.stances:
            spans[s.foot].append(f"{'' if s.begins else '≤'}{s.start_s:.3f}-{s.end_s:.3f}{'' if s.ends else '+'}")
        rows = (
            (f"{foot} {motion.foot_names[foot]}", ", ".join(foot_spans) or "none") for foot, foot_spans in spans.items()
        )
        yield table_of("foot", f"stances, s (frame number / {motion.fps:g})", rows=rows)
        if not all(s.begins and s.ends for s in analysis.gait.stances):
            yield "≤, +: the stance begins or ends outside the clip, or in a gap."
    yield from (f"note: {note}" for note in summary["notes"])


def compare(settings: CompareSettings, progress: Progress) -> Answer:
    """Compare strides and speeds of several clips by group, with uncertainties, group means and spreads.

    With --design or --names, a mixed model separates the variation between animals, runs, strides and measurements.

    --plan reports how many animals an effect needs.

    Example: recon compare results/a results/b results/c --table animals.csv --by sex --out comparison
    """
    from recon.cli.compare import compare_or_plan

    return compare_or_plan(settings, progress)
