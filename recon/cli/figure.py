"""The command `recon figure`: figures of a result for a paper."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

from pydantic import Field

from recon.api.options import ANYWAY, STRIDE, StrideTimes
from recon.base.errors import InputError, Problem
from recon.base.files import write_bytes, write_text
from recon.base.numbers import counted
from recon.base.outputs import Output, ReadResults, require_suffix
from recon.base.progress import Progress, silent
from recon.base.settings import Number, Option, Settings, input_paths
from recon.cli.answers import Answer, table_of, verdict_texts
from recon.fit.motion import Motion

KINDS = {".pdf": "pdf", ".svg": "svg", ".png": "png"}


class FigureSettings(Settings):
    """Settings of `recon figure`."""

    folder: Annotated[Path, Option(argument="DIR")]
    """Results folder, such as results/clip."""
    names: Annotated[tuple[str, ...], Option(argument="FIGURE")] = ()
    """Figures, such as joint_flexion, which are stacked and lettered if there are several. (default: list them)"""
    out: Path | None = None
    """File to write, such as fig1.pdf: PDF, SVG or PNG (600 dpi). The caption is written next to it, such as
    fig1.txt.
    """
    width: Annotated[Number, Field(ge=40, le=300)] = 183.0
    """Width on paper in mm, such as 89 for a column or 183 for a page."""
    stride: Annotated[StrideTimes | None, STRIDE] = None
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: bool = False
    """Replace the files."""


def figure_command(settings: FigureSettings, progress: Progress = silent) -> Answer:
    """Draw figures of a result for a paper: PDF, SVG or PNG, 7 pt sans serif, without titles, with a caption file.

    Example: recon figure results/clip side_view joint_flexion --out fig1.pdf --width 183
    """
    from recon.api.analyse import DEFAULT_FIGURES, figures_of
    from recon.api.figure import caption_of, draw_for_print
    from recon.check.verdict import usable
    from recon.gait.clip import analyse

    out = settings.out
    if out is not None:
        require_suffix(out, KINDS)
        if not settings.names:
            expected = f"a figure, such as {DEFAULT_FIGURES[1]}; recon figure without --out lists them"
            raise InputError(Problem("FIGURE", "name", "nothing", expected))
    elif settings.names:
        raise InputError(Problem("--out", "file", "nothing", "a file for the figures, such as fig1.pdf"))
    made_from = ReadResults.read(settings.folder)
    motion = usable(Motion.load(settings.folder), settings.folder, settings.anyway)
    progress("analysis", 0.1)
    analysis = analyse(motion, settings.stride)
    if out is None:
        drawn = figures_of(analysis)
        rows = [(name, caption_of(analysis, (name,)).partition("\n")[0]) for name in drawn]
        example = next(name for name in (DEFAULT_FIGURES[1], *DEFAULT_FIGURES) if name in drawn)
        advice = f"Draw one with: recon figure {shlex.quote(str(settings.folder))} {example} --out fig1.pdf"
        return Answer([row[0] for row in rows], [table_of("figure", "what it shows", rows=rows), advice])
    caption_path = out.with_suffix(".txt")
    output = Output(out.parent, "figure", settings.overwrite, input_paths(settings), made_from, exact=out.name)
    output.require((out.name, caption_path.name))
    progress("drawing", 0.4)
    printed = draw_for_print(analysis, settings.names, settings.width, str(settings.folder.absolute()))
    from recon.show.plots.style import printed_content, printing

    with printing(settings.width):
        content = printed_content(printed.figure, KINDS[out.suffix.lower()])
    with output.staged(adds=True) as staging:
        write_bytes(staging / out.name, content)
        write_text(staging / caption_path.name, printed.caption)
    files = [out, caption_path]
    summary = f"{counted(len(settings.names), 'figure')}, {settings.width:g} mm wide: {out}. Caption: {caption_path}."
    data = {"out": out, "caption": printed.caption, "figures": settings.names, "width_mm": settings.width}
    return Answer(data, [*verdict_texts(motion.verdict), summary], files=files)
