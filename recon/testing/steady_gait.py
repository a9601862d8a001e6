"""Simulate a gallop and a trot in which poses, masses and vertical forces are consistent and known exactly.

Each foot stands for a fraction of the stride, with a force of a given shape. These forces and gravity move the centre
of mass up and down, while its forward speed is constant. The paws stand still on level ground, and swing in between.
The trunk is placed so that the centre of mass of the skeleton's segments is where the forces put it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from recon.animal.body import Body
from recon.animal.capsules import capsules, middles_m
from recon.base.arrays import Array
from recon.fit.motion import Motion
from recon.gait.clip import ClipAnalysis
from recon.gait.dynamics import G_M_S2, MEAN_OF_PEAK, shape
from recon.gait.kinematics import at_frames
from recon.geometry.kinematics import PITCH, ROOT

FINE = 4096
"""Number of instants per stride at which the forces are integrated."""
LEGS = {"H": ("hind_thigh", "hind_shin", "hind_foot"), "F": ("fore_upper", "fore_lower", "fore_foot")}
CENTRE_M = 0.46
"""Mean height in metres of the centre of mass above the ground."""
PAW_M = 0.02
"""Height in metres of a standing paw's marker above the ground."""
LIFT_M = 0.1
"""Height in metres by which a paw is lifted in the swing."""


@dataclass(frozen=True)
class SteadyGait:
    """Steady gait on level ground with known vertical forces of the feet."""

    speed_m_s: float
    stride_s: float
    duty_factor: float
    landings: Mapping[str, float]
    """Time of touch-down of each foot (LH, RH, LF, RF) as a fraction of the stride."""
    fore: float
    """Fraction of the vertical impulse of a stride that comes from the fore feet."""
    skew: float
    """Exponent of time in the force of a stance.

    The force is a half-sine if the exponent is 1, and rises faster than it falls if the exponent is less.
    """
    lift_off_speed: float = 0.22
    """Speed of a paw at lift-off as a fraction of its speed in the middle of the swing."""
    touch_down_speed: float = 0.12
    """Speed of a paw at touch-down as a fraction of its speed in the middle of the swing."""

    def force_bw(self, foot: str, time_s: Array) -> Array:
        """Return the vertical force of a foot in body weights at times (T,) in seconds."""
        grid = (np.arange(FINE) + 0.5) / FINE
        fraction = (self.fore if foot.endswith("F") else 1 - self.fore) / 2
        peak = fraction / self.duty_factor / np.mean(np.sin(np.pi * grid**self.skew))
        progress = ((time_s / self.stride_s - self.landings[foot]) % 1.0) / self.duty_factor
        return np.where(progress < 1, peak * np.sin(np.pi * np.minimum(progress, 1.0) ** self.skew), 0.0)

    def height_m(self, time_s: Array, rate: int = 0) -> Array:
        """Return the height of the centre of mass above its mean in m, or its vertical velocity in m/s if `rate` is 1.

        The height is the force integrated twice over a stride.
        """
        grid_s = np.arange(FINE) / FINE * self.stride_s
        upward_m_s2 = G_M_S2 * (np.sum([self.force_bw(foot, grid_s) for foot in self.landings], axis=0) - 1)
        angular_rad_s = 2 * np.pi * np.fft.rfftfreq(FINE, self.stride_s / FINE)
        parts = np.fft.rfft(upward_m_s2)[1:] / -(angular_rad_s[1:] ** 2)
        path = np.fft.irfft(np.concatenate([[0.0], parts]), FINE)
        closed = np.append(path, path[0])
        return CubicSpline(np.append(grid_s, self.stride_s), closed, bc_type="periodic")(time_s % self.stride_s, rate)

    def paw_m(self, foot: str, time_s: Array) -> Array:
        """Return a paw marker's position along the path, up to a constant, and height in metres, shape (T, 2)."""
        strides = time_s / self.stride_s - self.landings[foot]
        swing = np.maximum(strides % 1.0 - self.duty_factor, 0.0) / (1 - self.duty_factor)
        middle = (self.lift_off_speed + self.touch_down_speed) / 2
        # The integral of a relative speed that begins at lift_off_speed, is 1 in the middle, and ends at
        # touch_down_speed.
        progress = self.lift_off_speed * swing + (self.touch_down_speed - self.lift_off_speed) * swing**2 / 2
        progress = progress + (1 - middle) / np.pi * (1 - np.cos(np.pi * swing))
        progress = progress / (middle + 2 * (1 - middle) / np.pi)
        ahead_m = self.speed_m_s * self.stride_s * (np.floor(strides) + progress + self.landings[foot])
        ahead_m += self.speed_m_s * self.stride_s * self.duty_factor / 2
        return np.stack([ahead_m, PAW_M + LIFT_M * np.sin(np.pi * swing) ** 2], axis=1)

    def states(self, body: Body, time_s: Array) -> Array:
        """Return states (T, D) of a `cheetah-24` that runs along x with a straight back.

        The trunk is moved together with the legs until the centre of mass is exactly where the forces put it.
        """
        segments = {segment.name: segment for segment in body.tree.segments}
        column = {name: i for i, name in enumerate(body.state_names)}
        states = np.tile(np.concatenate([np.zeros(4), body.mean_rad]), (len(time_s), 1))
        for name in ("rear_trunk_pitch", "front_trunk_pitch", "front_trunk_yaw", "rear_trunk_roll", "front_trunk_roll"):
            states[:, column[name]] = 0.0
        target = np.stack([self.speed_m_s * time_s, 0 * time_s, CENTRE_M + self.height_m(time_s)], axis=1)
        rest_m = centre_m(body, states[:1])[0, 0]
        states[:, ROOT] = target
        for _ in range(12):
            for foot in self.landings:
                side, links = foot[0].lower(), LEGS[foot[1]]
                names = [f"{side}_{link}" for link in links]
                upper, lower = (-segments[name].offset_m[2] for name in names[1:])
                paw = next(m for m in body.tree.markers if m.segment == names[2] and m.offset_m != (0.0, 0.0, 0.0))
                pitches = [column[f"{name}_pitch"] for name in names]
                means = body.mean_rad[np.array(pitches) - PITCH]
                flat = means.sum()  # the foot keeps its inclination
                root_m = segments[names[0]].offset_m[0]
                ankle_m = np.add(self.paw_m(foot, time_s), (root_m - rest_m, -paw.offset_m[2] * np.cos(flat)))
                x, z = (ankle_m - states[:, [0, 2]] - [root_m, 0]).T
                bend = np.sign(means[1]) * np.arccos((x**2 + z**2 - upper**2 - lower**2) / (2 * upper * lower))
                first = np.arctan2(-x, -z) - np.arctan2(lower * np.sin(bend), upper + lower * np.cos(bend))
                states[:, pitches] = np.stack([first, bend, flat - first - bend], axis=1)
            states[:, ROOT] += target - centre_m(body, states)
        return states


GALLOP = SteadyGait(7.0, 0.3, 0.2, {"LH": 0.0, "RH": 0.1, "LF": 0.45, "RF": 0.58}, fore=0.45, skew=0.8)
TROT = SteadyGait(3.0, 0.45, 0.42, {"LH": 0.0, "RF": 0.0, "RH": 0.5, "LF": 0.5}, fore=0.55, skew=0.8)


def centre_m(body: Body, states: Array) -> Array:
    """Return the centre of mass (T, 3) in metres of the segments' masses, each in the middle of its capsules."""
    fraction = np.array([body.mass[segment.name][0] for segment in body.tree.segments])
    middles = middles_m(body.tree, capsules(body.tree, body.markers))
    positions_m = body.tree.origins(states) + np.einsum("tsij,sj->tsi", body.tree.orientations(states), middles)
    return np.einsum("tsk,s->tk", positions_m, fraction / fraction.sum())


def with_exact_states(motion: Motion, states: Array, fps: float) -> Motion:
    """Replace the states of a motion by exactly known ones.

    Parameters
    ----------
    motion
        Motion of T frames, whose body and cameras are kept.
    states
        New states (T, D), whose stated uncertainty becomes a tenth of a millimetre.
    fps
        New frame rate in Hz.

    Returns
    -------
    Motion
        The motion with the new states, without findings and verdict.
    """
    solution = motion.solution
    joints_m = solution.body.tree.pose(states).points_m
    covariance = np.broadcast_to(1e-8 * np.eye(3), (*joints_m.shape, 3))
    exact = replace(
        solution,
        states=states,
        size=1.0,
        joints_m=joints_m,
        covariance_m2=covariance,
        relative_covariance_m2=covariance,
        angle_sigma_rad=np.full_like(solution.angle_sigma_rad, 1e-4),
        segments=(),
        flexion_sigma_rad=np.full((len(states), len(solution.body.anatomy)), 1e-4),
    )
    first, *rest = motion.sources
    first = replace(first, keypoints=replace(first.keypoints, fps=fps))
    return replace(motion, sources=(first, *rest), solution=exact, findings=(), verdict=None)


@dataclass(frozen=True)
class ForceErrors:
    """Errors of an analysis of a simulated steady gait, compared with its exact forces."""

    centre_m: float
    """Largest error of the centre of mass over the frames, in metres."""
    kinetic_j_kg: float
    """Largest error in J/kg of the centre of mass's forward or vertical kinetic energy.

    Two frames at either end of the clip are left out.
    """
    rms_bw: float
    """RMS error in body weights of single feet's forces in stances that are complete in the clip."""
    timed_rms_bw: float
    """The error `rms_bw` in body weights if the true times of touch-down and lift-off are given."""
    inside: float
    """Fraction of the true forces within the analysis' 90 % intervals."""


def compare_forces(run: SteadyGait, analysis: ClipAnalysis) -> ForceErrors:
    """Compare the centre of mass, energies and forces of an analysis with the simulated gait.

    Parameters
    ----------
    run
        The simulated gait.
    analysis
        Analysis of a motion with the gait's states, which has forces and a gait.

    Returns
    -------
    ForceErrors
        Errors of the centre of mass, of energies and of the feet's forces.
    """
    dynamics, gait = analysis.dynamics, analysis.gait
    assert dynamics is not None
    assert gait is not None
    time_s, errors, timed_errors, inside = gait.tracks.time_s, [], [], []
    for foot, force in dynamics.force.items():
        true = run.force_bw(foot, time_s)
        for stance in dynamics.forces[dynamics.forces["foot"] == foot].to_dict("records"):
            stride = round(stance["start_s"] / run.stride_s - run.landings[foot]) + run.landings[foot]
            progress = (time_s / run.stride_s - stride) / run.duty_factor
            stands = (progress > 0) & (progress < 1)
            peak = stance["impulse_bw_s"] / (MEAN_OF_PEAK * run.duty_factor * run.stride_s)
            errors.append((force[:, 0] - true)[stands])
            timed_errors.append((peak * shape(progress) - true)[stands])
            inside.append(((force[:, 1] <= true) & (true <= force[:, 2]))[stands])
    series = at_frames(dynamics.centre.series)
    inner, energy = slice(2, -2), dynamics.energy_j_kg
    moves = {
        "kinetic_forwards": np.full(len(series.time_s), run.speed_m_s),
        "kinetic_up": run.height_m(series.time_s, 1),
    }
    step = dynamics.centre.series.oversampling
    kinetic = [np.abs(energy[name][::step] - rate**2 / 2)[inner].max() for name, rate in moves.items()]
    return ForceErrors(
        centre_m=float(np.abs(series.value - centre_m(analysis.motion.body, analysis.motion.states)).max()),
        kinetic_j_kg=float(max(kinetic)),
        rms_bw=float(np.sqrt(np.mean(np.concatenate(errors) ** 2))),
        timed_rms_bw=float(np.sqrt(np.mean(np.concatenate(timed_errors) ** 2))),
        inside=float(np.mean(np.concatenate(inside))),
    )
