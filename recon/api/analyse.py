"""Analyse a fitted clip: write tables and figures of the animal's movement."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.api.analysis_settings import AnalyseSettings
from recon.base.arrays import mean, median
from recon.base.locks import sole_writer
from recon.base.numbers import counted, percent
from recon.base.outputs import Output, ReadResults
from recon.base.progress import Progress, silent
from recon.base.settings import input_paths
from recon.base.threads import one_thread
from recon.check.codes import sentence
from recon.check.verdict import usable, verdict_fields
from recon.fit.motion import MEASURED_FRACTION, Motion
from recon.gait.clip import ClipAnalysis, analyse, over_belt
from recon.gait.dynamics import OVER_STRIDE, findings_of_dynamics, validity_text
from recon.gait.gait import STRIDE_WORDS, WHOLE_CLIP, Gait, Stride, rejection_text
from recon.gait.quantities import GaitQuantity
from recon.gait.stances import interval_of
from recon.show.plain import picked, to_json
from recon.show.tables import DICTIONARY, LONG, TABLES, WORKBOOK, write_analysis

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SUMMARY = "analysis.json"
FIGURES_BEGIN = 0.5
"""Progress of an analysis, 0 to 1, when the first figure begins."""
MAX_REASONS = 3
"""Maximum number of excluded strides for which the notes list each reason."""


MORE_TABLES = {"csv": (), "xlsx": (WORKBOOK,), "long": (LONG, DICTIONARY)}
"""Files that each value of --format adds to the CSV tables."""


@dataclass(frozen=True)
class WrittenAnalysis:
    """An analysis and the files written for it."""

    analysis: ClipAnalysis
    summary: dict[str, Any]
    """Content of analysis.json."""
    files: Sequence[Path]


def run_analysis(settings: AnalyseSettings, progress: Progress = silent) -> WrittenAnalysis:
    """Analyse the motion in a results folder, and write tables and figures.

    Raises
    ------
    InputError
        If the results cannot be used, or a file may not be replaced.
    """
    out = settings.out_folder
    progress("reading", 0.0)
    made_from = ReadResults.read(settings.folder)
    motion = Motion.load(settings.folder)
    if settings.belt_speed_m_s is not None:
        motion = over_belt(motion, settings.belt_speed_m_s)
    motion = usable(motion, settings.folder, settings.anyway)
    output = Output(out, "analyse", settings.overwrite, input_paths(settings), made_from, content="an analysis")
    with sole_writer(out):
        output.require((SUMMARY, *TABLES, *MORE_TABLES[settings.tables_format]))
        progress("analysis", 0.1)
        with one_thread():
            analysis = analyse(motion, settings.stride)
        if settings.body_mass_kg is not None:
            analysis = replace(analysis, body_mass_kg=settings.body_mass_kg)
        summary = summarise(analysis, settings.folder.absolute().name)
        progress("tables", FIGURES_BEGIN - 0.1)
        with output.staged() as staging:
            write_analysis(analysis, staging)
            if settings.tables_format == "xlsx":
                from recon.show.workbook import write_workbook  # slow to import

                write_workbook(analysis, settings.folder.absolute().name, staging / WORKBOOK)
            elif settings.tables_format == "long":
                from recon.show.workbook import write_long

                write_long(analysis, staging, settings.decimal_comma)
            (staging / SUMMARY).write_text(to_json(summary), encoding="utf-8")
            names = [path.name for path in staging.iterdir()]
        if settings.figures:  # written after the tables, so that the tables exist even if a figure fails
            with output.staged(adds=True) as staging:
                write_figures(analysis, staging, progress, settings.all_figures)
                names += [path.name for path in staging.iterdir()]
    return WrittenAnalysis(analysis, summary, [out / name for name in sorted(names)])


def summarise(analysis: ClipAnalysis, results: str) -> dict[str, Any]:
    """Return the content of analysis.json, described in docs/gait.md.

    `results` is the name of the results folder.
    """
    reference = analysis.reference_motion
    net, net_sigma = analysis.net_acceleration_m_s2
    run = analysis.motion.solution.constant_velocity_m_s
    by = "gait" if analysis.stride is None else analysis.stride.origin
    return {
        "schema": {"name": "recon.analysis", "version": 1},
        "results": results,
        "verdict": verdict_fields(analysis.motion),
        "fps": analysis.motion.fps,
        "frames": len(analysis.pose.frames),
        "smoothed": analysis.motion.jitters,
        "reference_joint": analysis.reference,
        "speed": {
            "distance_m": reference.distance_m,
            "mean_m_s": reference.mean_speed_m_s,
            "peak_m_s": reference.peak_speed_m_s,
            "peak_sigma_m_s": None if np.isnan(reference.peak_speed_sigma_m_s) else reference.peak_speed_sigma_m_s,
            "peak_time_s": reference.peak_speed_time_s,
            "peak_acceleration_m_s2": reference.peak_acceleration_m_s2,
            "doubt": analysis.why_no_speed,
            **_with_interval("net_acceleration", "_m_s2", interval_of(net, net_sigma)),
            "straight_run_m_s": None if run is None else median(run[run > 0]),
        },
        "spine_flexion_rad": analysis.angles["spine_flexion"].range_rad if "spine_flexion" in analysis.angles else None,
        "angles": {"data_share": analysis.motion.data_shares, "not_measured": list(analysis.not_measured)},
        "gait": None if analysis.gait is None else _gait_summary(analysis, analysis.gait),
        "dynamics": _dynamics_summary(analysis),
        "stride": None if analysis.stride is None else picked(analysis.stride, "foot", "start_s", "end_s") | {"by": by},
        "notes": [*notes(analysis)],
    }


def notes(analysis: ClipAnalysis) -> Iterator[str]:
    """Yield notes on an analysis that its user needs before relying on its numbers."""
    motion, gait = analysis.motion, analysis.gait
    if motion.jitters:
        yield "Paths and angles are smoothed according to their frame-to-frame jitter."
    if count := len(analysis.not_measured):
        total = len(analysis.skeleton_angles)
        angles = f"All {total} angles have" if count == total else f"{count} of {total} angles have"
        verb = "are"
        if count == 1:
            angles, verb = f"1 of {total} angles has", "is"
        names = "" if count == total else f": {', '.join(analysis.not_measured)}"
        fraction = percent(MEASURED_FRACTION)
        yield f"{angles} less than {fraction} of the precision from the pixels, and {verb} grey in figures{names}."
    if gait is not None and len(motion.foot_names) < 4:
        yield f"Only the feet {', '.join(motion.foot_names)} were fitted, so the gait cannot be named."
    rejections = [] if gait is None else [rejection_text(stride) for stride in gait.rejected_strides]
    yield from rejections[:MAX_REASONS]
    if (count_more := len(rejections) - MAX_REASONS) > 0:
        yield f"Not counted for similar reasons: {counted(count_more, 'more stride')}."
    if analysis.dynamics is not None:
        yield f"Source of the masses in forces and energies: {motion.body.mass_source}."
        if analysis.dynamics.stance_forces:
            yield validity_text("unknown" if gait is None else gait.name.name)
        elif gait is not None:
            lacks = "no stance is complete" if gait.stride_s > 0 else "the duration of a stride is not known"
            yield f"Forces of the feet are not computed, because {lacks}."
        yield from (sentence(finding, named=False) for finding in findings_of_dynamics(motion, analysis.dynamics))
    elif motion.side is None and gait is not None:
        yield "The skeleton has no masses ([mass]), so centre of mass, energies and forces are not computed."
    if gait is not None and analysis.stride is None:
        yield "The clip has no complete stride, so joint_flexion is not drawn."
        yield "The side view and the phase portraits show the whole clip."
    elif gait is not None and not gait.strides and analysis.stride is not None and analysis.stride.at == "return":
        yield "The clip has no complete stride, so joint_flexion is not drawn."
        yield "The phase portraits show the nearest return of a foot to its position."


def _dynamics_summary(analysis: ClipAnalysis) -> dict[str, Any] | None:
    dynamics = analysis.dynamics
    if dynamics is None or analysis.gait is None:
        return None
    # Errors of the energy are correlated over time, so the mean may be as uncertain as the value at one instant.
    sigma = {name: mean(values) for name, values in dynamics.energy_sigma_j_kg.items()}
    means = {name: interval_of(mean(values), sigma[name]) for name, values in dynamics.energy_j_kg.items()}
    return {
        "masses": analysis.motion.body.mass_source,
        "body_mass_kg": analysis.body_mass_kg,
        "stride_s": analysis.gait.stride_s,
        "stride_sigma_s": analysis.gait.stride_sigma_s,
        "mean_peak_bw": None if dynamics.mean_peak_bw is None else dynamics.mean_peak_bw[0],
        "mean_peak_interval_bw": None if dynamics.mean_peak_bw is None else dynamics.mean_peak_bw[1:],
        "flights": [picked(flight, "start_s", "end_s", "up_m_s2", "sigma_m_s2") for flight in dynamics.flight_parts],
        **_with_interval("net_acceleration", "_m_s2", interval_of(*dynamics.net_acceleration_m_s2)),
        "strides": [
            _stride_energy(stride, changes)
            for stride, changes in zip(analysis.gait.strides, analysis.over_strides, strict=True)
        ],
        "findings": [finding.code for finding in findings_of_dynamics(analysis.motion, dynamics)],
        "energy_mean_j_kg": {name: value for name, (value, *_) in means.items()},
        "energy_mean_interval_j_kg": {name: interval for name, (_, *interval) in means.items()},
    }


def _stride_energy(stride: Stride, changes: Mapping[str, tuple[float, float, float]]) -> dict[str, Any]:
    """Return the quantities of `OVER_STRIDE` for one stride, with their intervals and the stride's foot and times."""
    row = picked(stride, "foot", "start_s", "end_s")
    for name, value_and_interval in changes.items():
        row |= _with_interval(name, OVER_STRIDE[name], value_and_interval)
    return row


def _with_interval(name: str, unit: str, value_and_interval: tuple[float, float, float]) -> dict[str, Any]:
    """Return a value and the ends of its interval under names such as net_work_j_kg and net_work_interval_j_kg."""
    value, *interval = value_and_interval
    return {f"{name}{unit}": value, f"{name}_interval{unit}": interval}


def _gait_summary(analysis: ClipAnalysis, gait: Gait) -> dict[str, Any]:
    counts = {"footfalls": list(gait.order), "stances": len(gait.stances), "strides": len(gait.strides)}
    quantities = analysis.quantities
    duty = {
        "duty_factor_interval": quantities["duty_factor"].interval,
        "duty_factor_by_foot": {foot: quantities[f"duty_factor_{foot}"].value for foot in gait.tracks.feet},
    }
    names = "stride_length_m", "stride_frequency_hz", "duty_factor"
    named = picked(gait.name, "name", "criterion") | {name: quantities[name].value for name in names}
    return named | counts | duty | {"quantities": {name: quantity_fields(q) for name, q in quantities.items()}}


def quantity_fields(quantity: GaitQuantity) -> dict[str, Any]:
    """Return a quantity in JSON types: value, standard deviation, 90 % interval, number of strides, and source."""
    fields = picked(quantity, "value", "sigma") | {"interval": quantity.interval}
    fields |= {"between_strides": quantity.between_sigma, "n": quantity.count, "source": quantity.source}
    return fields | ({"why_unknown": quantity.why_unknown} if quantity.why_unknown else {})


DEFAULT_FIGURES = ("side_view", "joint_flexion", "footfalls", "speed")
"""Figures that are drawn by default, because papers usually print them."""


def write_figures(analysis: ClipAnalysis, folder: Path, progress: Progress, is_complete: bool = False) -> None:
    """Write `DEFAULT_FIGURES`, or all figures if `is_complete` is true, as PNG and SVG."""
    from recon.show.plots.style import save

    drawn = {name: draw for name, draw in figures_of(analysis).items() if is_complete or name in DEFAULT_FIGURES}
    for done, (name, draw) in enumerate(drawn.items()):
        progress(f"figures: {name}", FIGURES_BEGIN + (1.0 - FIGURES_BEGIN) * done / len(drawn))
        save(draw(), folder, name)


def _stride_title(stride: Stride | None) -> str:
    """Return the title of figures that show one stride, or the whole clip if `stride` is None."""
    if stride is None:
        return STRIDE_WORDS[WHOLE_CLIP].title
    return STRIDE_WORDS[stride.at].title.format(foot=stride.foot)


def figures_of(analysis: ClipAnalysis) -> dict[str, Callable[[], Figure]]:
    """Return the functions that draw the figures, keyed by file name without suffix."""
    from recon.show.plots.configurations import body_fixed, composites, in_body, observability
    from recon.show.plots.flexion import joint_flexion
    from recon.show.plots.over_time import clearest_portraits, footfall, forces, phase_portraits, speeds, vector_fields
    from recon.show.plots.side_view import side_view

    motion, time_s, during, gait = analysis.motion, analysis.motion.time_s, analysis.during_stride, analysis.gait
    joints_m = in_body(motion.body, motion.states[during], motion.size, motion.reference_joint)
    title = _stride_title(analysis.stride)
    limbs, sides = motion.limbs, motion.limb_sides
    style_by_limb = {"time_s": time_s[during], "sides": sides, "title": title}
    shares, ground = motion.posture_data_share, None if gait is None else gait.tracks.grounds
    speed_by_joint, unknown = {analysis.reference: analysis.reference_motion}, analysis.why_no_speed is not None
    why_not = analysis.reference_motion.why_no_acceleration
    drawn: dict[str, Callable[[], Figure]] = {
        "side_view": partial(
            side_view, analysis.pose.xyz_m, limbs, sides, during, time_s, ground, of_stride=analysis.stride is not None
        ),
        "composites": partial(composites, analysis.pose.xyz_m, limbs, time_s, ground, sides=sides),
        "speed": partial(speeds, speed_by_joint, why_not, unknown=unknown, acceleration=not why_not),
        "phase_portraits": lambda: phase_portraits(
            clearest_portraits(analysis.portraits, motion.data_shares), analysis.closures, title, motion.data_shares
        ),
        "phase_portraits_all": lambda: phase_portraits(
            analysis.portraits, analysis.closures, title, motion.data_shares
        ),
        "observability": partial(observability, motion.body, shares[during], time_s[during], title, shares),
        "body_fixed": partial(body_fixed, joints_m, limbs, **style_by_limb),
    }
    parts: dict[str, dict[str, Sequence[int]]] = {}
    for limb, joints in limbs.items():
        parts.setdefault("spine" if sides[limb] is None else limb, {})[limb] = joints
    for name, part_limbs in parts.items() if len(parts) > 1 else ():
        drawn[f"body_fixed_{name.replace(' ', '_')}"] = partial(body_fixed, joints_m, part_limbs, **style_by_limb)
    for limb, fields in analysis.fields.items():
        drawn[f"vector_field_{limb.replace(' ', '_')}"] = partial(vector_fields, fields, time_s, limb)
    if (effector := analysis.end_effector) is not None:
        from recon.show.plots.end_effector import stride_boundaries

        drawn["end_effector"] = partial(stride_boundaries, effector, analysis.stride)
    if gait is not None:
        drawn["footfalls"] = partial(footfall, {"gait": gait}, motion.fps)
        if analysis.flexion_curves:
            drawn["joint_flexion"] = partial(joint_flexion, analysis.flexion_curves)
        if analysis.dynamics is not None:
            drawn["forces"] = partial(forces, analysis.dynamics, gait)
    return drawn
