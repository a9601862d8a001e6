"""What the optimiser did for a result: its problem again, from the files that it was fitted to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from recon.animal.skeleton_file import load_chain
from recon.base.errors import InputError, Problem
from recon.clip import Source, together, views_of
from recon.fit.results import Results
from recon.fit.setting import Setting
from recon.io.calibration import read_cameras
from recon.thesis.solver import SolverRecord, linearised_clip, linearised_frames
from recon.workflows.clip import REFINED_CAMERAS, prepare
from recon.workflows.made_from import read_config
from recon.workflows.overlay import overlay_of

CONFIG = "config.toml"
EXPECTED = "the keypoints and cameras of the fit, as they were: fit the clip again"
_ALIKE, _ALIKE_PX = 2.0, 0.1
"""Costs that differ by a larger factor are of another camera, and points that differ by more are other keypoints."""


def read_solver(results: Results) -> SolverRecord:
    """Raises InputError where the keypoints or the camera of the fit are no longer there, or are others."""
    results.manifest.require(CONFIG)
    config = results.folder / CONFIG
    settings = read_config(config, {})
    given = prepare(settings)
    model, sources = given.model, given.sources
    if settings.find_offsets:
        later = [round(camera["offset_s"] * given.fps, 9) for camera in results.report["cameras"]]
        sources = together(given.apart, later)
    if settings.seeks_cameras:
        results.manifest.require(REFINED_CAMERAS)
        cameras = read_cameras(results.folder / REFINED_CAMERAS)
        sources = tuple(replace(source, camera=camera) for source, camera in zip(sources, cameras, strict=True))
    views = views_of(sources)
    _require_the_same(sources, results)
    if model.chain is not None:
        problem = linearised_frames(views[0], model.chain, given.fps, settings.frame_options(), results)
        told = 0.5 * sum(frame["squared_norm"] for frame in results.report["frames"] if frame["unknowns"])
    else:
        assert model.prior is not None
        setting = Setting.of(views, model.body, model.prior, given.fps, settings.trajectory_options())
        problem = linearised_clip(setting, results)
        told = sum(results.report["convergence"]["cost_by_term"].values())
    if not problem.solved.any():
        expected = "one between two gaps, at least, with a pose in every frame"
        raise InputError(Problem(results.folder, "spells", "none with a pose throughout", expected))
    cost = sum(float(np.nansum(of_term)) for of_term in problem.cost.values())
    if problem.solved.all() and max(cost, told) > _ALIKE * max(min(cost, told), 1.0):
        raise InputError(Problem(config, "camera", f"a cost of {cost:.4g}, where the fit had {told:.4g}", EXPECTED))
    chain = load_chain(results.skeleton_name) if results.body.one_sided else None
    return SolverRecord(results, problem, chain)


def _require_the_same(sources: Sequence[Source], results: Results) -> None:
    """Raises InputError unless these are the detections of the fit."""
    for number, source in enumerate(sources):
        keypoints, detected_px = source.keypoints, overlay_of(results, number=number).detected_px
        known = np.isfinite(detected_px)
        solved = np.isfinite(results.states[:, 0])
        if (
            not np.array_equal(keypoints.frames, results.pose.frames)
            or not np.array_equal(known[solved], np.isfinite(keypoints.xy_px[solved]))
            or np.abs(detected_px - keypoints.xy_px)[known].max(initial=0.0) > _ALIKE_PX
        ):
            path = keypoints.source or results.folder / CONFIG
            raise InputError(Problem(path, "keypoints", "others than those of the fit", EXPECTED))
