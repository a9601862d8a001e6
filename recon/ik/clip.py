"""Run `recon ik`: move the chain from trunk to foot of a fitted clip to a target or along a stride."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.base.locks import sole_writer
from recon.base.outputs import Output, ReadResults
from recon.base.settings import input_paths
from recon.base.tables import write_frame
from recon.base.threads import one_thread
from recon.check.verdict import usable, verdict_fields
from recon.fit.motion import Motion
from recon.gait.phase import Closure, Portrait, closure
from recon.ik.cost_study import CostOutcome, cost_outcome
from recon.ik.drive import Run, control_columns, drive_to
from recon.ik.figures import joint_space, parameter_series, task_space
from recon.ik.limb import (
    COSTS,
    REFIT_FRAMES,
    SLOWDOWN,
    Limb,
    animal_portraits,
    cost_of,
    fit_parameter_series,
    fit_parameters,
    follow_stride,
    limb_of,
    methods_of,
    stride_of,
)
from recon.ik.parameters import ParameterFit
from recon.ik.settings import IkSettings
from recon.ik.stride import OVERSAMPLING, StridePath, farthest_reach
from recon.show.plain import by_name, picked, to_json
from recon.show.plots import style
from recon.show.plots.over_time import phase_portraits

STRIDE_MAX = "stride-max"


SUMMARY = "ik.json"


@dataclass(frozen=True, eq=False)
class IkRun:
    """Result of `recon ik`: the chain, the fitted parameters and the runs of all methods."""

    settings: IkSettings
    motion: Motion
    limb: Limb
    stride: StridePath
    target_m: Array | None
    """Target of the end effector in the chain's base frame, shape (dim,), metres."""
    runs: Mapping[str, Mapping[str, Run]]
    """Runs of each method to the "target" and along the stride ("follow"); empty for a task that was not requested."""
    parameters: Mapping[str, ParameterFit]
    """Parameters of each method, fitted to the clip."""
    series: pd.DataFrame | None
    """Parameters fitted to each frame of the stride (`fit_parameter_series`); None if they were not requested."""

    portraits: Mapping[str, Portrait]
    """Phase portrait of each of the animal's own joints over the stride."""
    costs: Mapping[str, CostOutcome]
    """Behaviour of the extended Jacobian with each cost on the stride; empty if the study was not requested."""

    @property
    def begins_s(self) -> float:
        """Return the time at which the stride begins in the clip, seconds."""
        return self.limb.first_s + self.stride.start_s

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Return the content of ik.json."""
        limb, stride, settings = self.limb, self.stride, self.settings
        stride_s = {"start_s": self.begins_s, "end_s": limb.first_s + stride.end_s}
        fitted = {
            name: {"value": f.parameter, **picked(f, "rms_rad_s", "explained"), "best_alpha": f.alpha, "note": f.note}
            for name, f in self.parameters.items()
        }
        return {
            "schema": {"name": "recon.ik", "version": 1},
            "verdict": verdict_fields(self.motion),
            "foot": limb.foot,
            "dimensions": limb.chain.dim,
            "joints": list(limb.chain.names),
            "base_frame": "U forwards, V down, W left" if limb.base == "UVW" else "x forwards, y left, z up",
            "base_at": limb.base_at,
            "misfit_m": limb.misfit_m,
            "stride": stride_s | {"how": stride.origin} | picked(stride, "notes", "gap_m", "gap_percent"),
            "parameters": {"used": settings.parameters, "fitted": fitted, "alpha": settings.alpha},
            "target_m": self.target_m,
            "to_target": {name: run.measures() for name, run in self.runs["target"].items()},
            "turns": settings.turns if self.runs["follow"] else None,
            "along_stride": {name: self._along_stride(run) for name, run in self.runs["follow"].items()},
            "animal": {
                f"closure_{kind}_percent": by_name(limb.chain.names, values.tolist())
                for kind, values in self.animal_closures.items()
            },
            "costs": {name: picked(outcome, *CostOutcome.__dataclass_fields__) for name, outcome in self.costs.items()},
        }

    @cached_property
    def animal_closures(self) -> dict[str, Array]:
        """Return the degrees of closure of the animal's joints over the stride in percent, as `Run.closures` does."""
        kinds = "angle", "plane", "unscaled"
        closures = {kind: np.full(self.limb.chain.n, np.nan) for kind in kinds}
        for joint, portrait in enumerate(self.portraits.values()):
            if len(portrait.time_s) > 1 and np.isfinite(portrait.rate_rad_s).all():
                degrees = closure(portrait)
                for kind in kinds:
                    closures[kind][joint] = getattr(degrees, kind)
        return closures

    def _along_stride(self, run: Run) -> dict[str, Any]:
        closures, animal_q = run.closures(), self.stride.q
        names = self.limb.chain.names
        off_rad = run.q[::OVERSAMPLING][: len(animal_q)] - animal_q
        return {
            **run.measures(),
            **{f"least_closure_{kind}_percent": float(np.fmin.reduce(values)) for kind, values in closures.items()},
            "joints_off_rad": float(np.sqrt(np.nanmean(off_rad**2))),
            **{f"closure_{kind}_percent": by_name(names, values.tolist()) for kind, values in closures.items()},
        }


def run_ik(settings: IkSettings) -> IkRun:
    """Run inverse kinematics on a clip, and write the tables and figures of `recon ik`.

    Parameters that are fitted to the clip are also fitted to each frame of the stride.

    Raises
    ------
    InputError
        If the folder does not hold results of a fit, or if the clip shows too little of a stride.
    """
    made_from = ReadResults.read(settings.folder)
    motion = usable(Motion.load(settings.folder), settings.folder, settings.anyway)
    output = Output(settings.out_folder, "ik", settings.overwrite, input_paths(settings), made_from)
    with sole_writer(settings.out_folder):
        output.require((SUMMARY,))
        limb = limb_of(motion, settings.foot, 2 if settings.dim == 2 else 3, settings.limits)
        chain, cost = limb.chain, None if settings.cost is None else cost_of(limb, settings.cost)
        target = STRIDE_MAX if settings.has_no_task and settings.compare else settings.target
        goal = _coordinates(target, chain.dim) if target not in (None, STRIDE_MAX) else None
        with one_thread():
            stride, parameters = stride_of(motion, limb, settings.stride), fit_parameters(limb, cost)
            fitted = settings.fitted or settings.online
            series, refitted = None, {}
            if fitted:
                series, refitted = fit_parameter_series(limb, stride, cost, REFIT_FRAMES if settings.online else 0)
            methods = methods_of(limb, settings.methods, parameters, fitted, cost, settings.alpha)
            start, foremost = farthest_reach(chain, stride.q)
            goal = foremost if target == STRIDE_MAX else goal
            drives = {} if goal is None else {n: drive_to(chain, start, goal, m) for n, m in methods.items()}
            is_followed = settings.follow is not None or (settings.has_no_task and settings.compare)
            followed = methods if is_followed else {}
            by_frame = {n: refitted.get(n, ()) if settings.online else () for n in followed}
            follows = {n: follow_stride(chain, stride, m, settings.turns, by_frame[n]) for n, m in followed.items()}
            costs = _cost_outcomes(limb, stride) if settings.costs else {}
        runs, portraits = {"target": drives, "follow": follows}, animal_portraits(motion, limb, stride)
        solved = IkRun(settings, motion, limb, stride, goal, runs, parameters, series, portraits, costs)
        with output.staged() as staging:
            _write(solved, staging)
        if settings.figures:  # written after the tables, so that the tables exist even if a figure fails
            with output.staged(adds=True) as staging:
                write_figures(solved, staging)
    return solved


def _cost_outcomes(limb: Limb, stride: StridePath) -> dict[str, CostOutcome]:
    """Follow the stride by the extended Jacobian with each cost of `COSTS`."""
    interval_s = SLOWDOWN * stride.interval_s
    return {
        name: cost_outcome(limb.chain, stride.q[0], stride.path_m, cost(limb), interval_s)
        for name, cost in COSTS.items()
    }


def _coordinates(target: str, dim: int) -> Array:
    try:
        values = np.array(target.split(","), float)
    except ValueError:
        values = np.empty(0)
    if len(values) != dim or not np.isfinite(values).all():
        expected = f"{STRIDE_MAX}, or {dim} coordinates in metres, as in {'0.8,0.3,0.1'[: 4 * dim - 1]}"
        raise InputError(Problem("--target", "target", repr(target), expected))
    return values


def _write(solved: IkRun, folder: Path) -> None:
    summary, names = solved.summary, solved.limb.chain.names
    tables: dict[str, pd.DataFrame] = {}
    for file, rows in (("target.csv", summary["to_target"]), ("follow.csv", summary["along_stride"])):
        if rows:
            cells = [{k: _cell(v) for k, v in row.items() if not isinstance(v, dict)} for row in rows.values()]
            tables[file] = pd.DataFrame(cells, pd.Index(rows, name="method"))
    if follows := solved.runs["follow"]:
        by_source = {"animal": solved.animal_closures} | {name: run.closures() for name, run in follows.items()}
        closures = {f"{source}_{kind}": values for source, kinds in by_source.items() for kind, values in kinds.items()}
        tables["closures.csv"] = pd.DataFrame(closures, pd.Index(names, name="joint"))
    if costs := summary["costs"]:
        rows = [{name: _cell(value) for name, value in outcome.items()} for outcome in costs.values()]
        tables["costs.csv"] = pd.DataFrame(rows, pd.Index(costs, name="cost"))
    if solved.series is not None:
        tables["parameters.csv"] = solved.series.set_index("time_s")
    ends = [f"end_{axis}_m" for axis in solved.limb.base[: solved.limb.chain.dim]]
    columns = ["time_s", *(f"{joint}_rad" for joint in names), *control_columns(names), *ends, "distance_m"]
    for job, runs in solved.runs.items():
        for name, run in runs.items():
            time_s = run.time_s + (0.0 if run.driven else solved.begins_s)
            values = np.column_stack((time_s, run.q, *run.control, run.end_m, run.distance_m))
            steps = pd.RangeIndex(len(values), name="step")
            tables[f"{job}_{name}.csv"] = pd.DataFrame(values, steps, columns)
    for file, table in tables.items():
        write_frame(table, folder / file, index=True)
    (folder / SUMMARY).write_text(to_json(summary), encoding="utf-8")


def _cell(value: object) -> object:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return " ".join(map(str, value)) if isinstance(value, list | tuple) else value


def write_figures(solved: IkRun, folder: Path) -> None:
    """Write figures as PNG and SVG: paths in task and joint space, phase portraits by method, and parameters."""
    limb, aims = solved.limb, {"target": solved.target_m, "follow": solved.stride.path_m}
    for job, runs in solved.runs.items():
        if runs:
            style.save(task_space(runs, limb.chain, aims[job], limb.base), folder, f"{job}_task_space")
            style.save(joint_space(runs, limb.chain.names), folder, f"{job}_joint_space")
    for name, run in solved.runs["follow"].items():
        joints = zip(run.q.T, run.control[0].T, strict=True)
        portraits = [Portrait(solved.begins_s + run.time_s, angle, rate) for angle, rate in joints]
        _save_portraits(by_name(limb.chain.names, portraits), run.closures(), name, folder)
    if solved.runs["follow"]:
        _save_portraits(dict(solved.portraits), solved.animal_closures, "animal", folder)
    if solved.series is not None:
        style.save(parameter_series(solved.series, limb.chain.names), folder, "parameters")


def _save_portraits(portraits: dict[str, Portrait], closures: Mapping[str, Array], source: str, folder: Path) -> None:
    """Draw and write the phase portraits of a method or of the animal, labelled with the degrees of closure (n,)."""
    pairs = zip(closures["angle"].tolist(), closures["plane"].tolist(), strict=True)
    by_joint = by_name([*portraits], [Closure(*pair) for pair in pairs])
    style.save(phase_portraits(portraits, by_joint, source), folder, f"follow_phase_{source}")
