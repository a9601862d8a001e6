"""Fit a clip frame by frame with the published system, and write tables and figures of the optimisation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from recon.animal.body import Body
from recon.api.clip_inputs import prepare
from recon.api.settings import FitSettings
from recon.base.locks import sole_writer
from recon.base.outputs import Output, ReadResults
from recon.base.progress import Progress, silent
from recon.base.settings import input_paths
from recon.base.tables import write_frame
from recon.base.threads import one_thread
from recon.check.verdict import add_verdict
from recon.clip import views_of
from recon.fit.motion import Motion
from recon.show.plain import to_json
from recon.thesis.chain import load_chain
from recon.thesis.inspect import TABLES, read_solver
from recon.thesis.objectives import FrameOptions
from recon.thesis.settings import SolverSettings
from recon.thesis.solver import solve_frames
from recon.thesis.start import parse_start_angles


def fit_clip(settings: FitSettings, progress: Progress = silent) -> Motion:
    """Reconstruct one side of the animal as a chain, frame by frame.

    Frames that cannot be solved stay in the result, with the status not_converged or no_data.

    Raises
    ------
    InputError
        If files or settings cannot be used. The message lists all problems.
    """
    clip, chain, plain = prepare(settings), load_chain(settings.skeleton_name), settings.plain()
    (view,), T = views_of(clip.sources), len(clip.sources[0].keypoints.frames)
    options = FrameOptions.from_settings(plain)
    if options.start_angles is not None:
        parse_start_angles(options.start_angles, chain)
    solution = solve_frames(view, chain, clip.fps, options, lambda count: progress("frames", count / T))
    return add_verdict(Motion(clip.sources, clip.side, clip.side_reason, solution, chain=chain, settings=plain))


def load_body(settings: FitSettings) -> Body:
    """Return the body of the chain that the settings name.

    Raises
    ------
    InputError
        If the skeleton is not a chain.
    """
    return load_chain(settings.skeleton_name).body


SUMMARY, JACOBIAN = "solver.json", "jacobian.npz"
"""Two of the files that `recon solver` writes."""
FIGURES_BEGIN = 0.5
"""Fraction of the progress of `recon solver` at which drawing of figures begins."""


def run_solver(settings: SolverSettings, progress: Progress = silent) -> tuple[dict[str, Any], list[Path]]:
    """Write the tables, the Jacobian and the figures of `recon solver`.

    Returns
    -------
    tuple
        The content of solver.json, and the files that were written.
    """
    from recon.show.plots import style
    from recon.thesis.figures import FIGURES

    out = settings.out_folder
    made_from = ReadResults.read(settings.folder)
    motion = Motion.load(settings.folder)
    inputs = input_paths(settings)
    output = Output(out, "solver", settings.overwrite, inputs, made_from, content="optimiser tables")
    with sole_writer(out):
        output.require((SUMMARY, *TABLES, JACOBIAN))
        progress("problem", 0.1)
        with one_thread():
            record = read_solver(motion, settings.folder, settings.frame)
            summary = record.summary()
        progress("tables", FIGURES_BEGIN - 0.1)
        with output.staged() as staging:
            for name, table in record.tables().items():
                write_frame(table, staging / name)
            record.write_jacobian(staging / JACOBIAN)
            (staging / SUMMARY).write_text(to_json(summary), encoding="utf-8")
            files = [out / path.name for path in staging.iterdir()]
        if settings.figures:
            with output.staged(adds=True) as staging:
                for i, draw in enumerate(FIGURES):
                    progress(f"figures: {draw.__name__}", FIGURES_BEGIN + (1.0 - FIGURES_BEGIN) * i / len(FIGURES))
                    style.save(draw(record), staging, draw.__name__)
                files += [out / path.name for path in staging.iterdir()]
    return summary, sorted(files)
