"""Test whether another camera in the camera file, rather than the given one, filmed a clip.

The user chooses the camera by name. A wrong choice need not make the fit worse, because the animal looks similar from
every camera, but the animal's position and direction in the world are then wrong by metres and tens of degrees. The
cameras in a file differ a little in height, tilt, roll and lens, so gravity, the ground and the gait show which of them
filmed the clip. One second is solved again with each of the other cameras. Each fit starts from the solution, moved in
front of the other camera.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from recon.base.arrays import Array
from recon.check.codes import finding
from recon.check.focal import refit_scene
from recon.check.likelihood import Baseline, best_seen
from recon.clip import camera_poses
from recon.fit.result import Finding
from recon.geometry.camera import Camera
from recon.geometry.kinematics import ROOT, YAW

MIN_GAIN = 3.0
"""Log-likelihood gain above which another camera is reported.

Errors within the correlation time count only once. The gain is at most 0.5 in 32 correct views, 2.0 if the views show
less of the animal or the ground rises by 3 %, and 2.2 in a simulated run on such ground. The gain exceeds this limit in
70 of 136 fits with another camera in the file (`python benchmarks/wrong_inputs.py --only which-camera`).
"""


def other_camera_finding(baseline: Baseline, noise_px: Array, cameras: Sequence[Camera]) -> Iterator[Finding]:
    """Yield a finding if other cameras in the camera file explain a view better than the given camera.

    The finding names the cameras that explain the view about as well as the best one. `noise_px` is the fit's standard
    deviation of each detection, pixels, shape (T, J).
    """
    gains = gains_of(baseline, noise_px, cameras)
    best = max(gains.values(), default=-math.inf)
    if best > MIN_GAIN:
        likely = [name for name in sorted(gains, key=gains.__getitem__, reverse=True) if gains[name] > best - MIN_GAIN]
        name = baseline.view.camera.name
        yield finding("another_camera_fits", None, name, given=name, others=likely, log_likelihood_ratio=best)


def gains_of(baseline: Baseline, noise_px: Array, cameras: Sequence[Camera]) -> dict[str, float]:
    """Return a dictionary of the log-likelihood gain of each other camera over the view's own camera.

    The keys are the cameras' names. The dictionary is empty if the camera moves, or if the second of the clip with the
    most detections has fewer than three frames or a frame without a pose. `noise_px` is the fit's standard deviation of
    each detection, pixels, shape (T, J).
    """
    rows = best_seen(baseline.view, baseline.clip.fps)
    states = baseline.states[rows]
    if not baseline.view.is_still or len(states) < 3 or not np.isfinite(states).all():
        return {}
    noise_px = noise_px[None, rows]
    own_cost, gains = refit_scene(baseline.clip.part(rows), states, noise_px).cost, {}
    for camera in cameras:
        pose = camera_poses([camera])[0]
        candidate = baseline.with_view(replace(baseline.view, camera=camera, T_camera_world=pose))
        start = _turned(states, pose[:3, :3].T @ baseline.view.rotation)
        gains[camera.name] = own_cost - refit_scene(candidate.part(rows), start, noise_px).cost
    return gains


def _turned(states: Array, turn: Array) -> Array:
    """Return states (T, D) rotated about the camera's centre, which is the origin, with the animal still upright."""
    turned = states.copy()
    turned[:, ROOT] = states[:, ROOT] @ turn.T
    turned[:, YAW] += math.atan2(turn[1, 0], turn[0, 0])
    return turned
