"""A gallop and a trot that the feet's vertical forces really carry: masses, poses and forces are known exactly.

Each foot stands for a share of the stride with a force of a given shape; the centre of mass moves up and down as these
forces and gravity say, and on at a constant speed. The paws stand still on level ground, and swing in between. The
trunk is placed so that the centre of mass of the skeleton's segments is where it has to be.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline

from recon import Body, Motion
from recon.animal.capsules import capsules, middles_m
from recon.gait.clip import ClipAnalysis
from recon.gait.dynamics import G_M_S2, MEAN_OF_PEAK, shape
from recon.gait.kinematics import at_frames
from recon.geometry.kinematics import PITCH, ROOT

FINE = 4096
"""Instants of a stride at which the forces are integrated."""
LEGS = {"H": ("hind_thigh", "hind_shin", "hind_foot"), "F": ("fore_upper", "fore_lower", "fore_foot")}
CENTRE_M, PAW_M, LIFT_M = 0.46, 0.02, 0.1
"""Mean height of the centre of mass, height of a standing paw's marker, and how much higher it swings."""


@dataclass(frozen=True)
class Run:
    """A steady gait on level ground."""

    speed_m_s: float
    stride_s: float
    duty_factor: float
    landings: Mapping[str, float]
    """By foot (LH, RH, LF, RF) when in the stride it lands, as a share of it."""
    fore: float
    """The fore feet's share of the impulse."""
    skew: float
    """The exponent of time in the force of a stance: 1 is half a sine, lower values rise faster than they fall."""
    leaves: float = 0.22
    """The speed of a paw as it leaves the ground, of that in the middle of its swing."""
    lands: float = 0.12
    """The same as it lands."""

    def force_bw(self, foot: str, time_s: np.ndarray) -> np.ndarray:
        """The vertical force of a foot, in body weights."""
        grid = (np.arange(FINE) + 0.5) / FINE
        share = (self.fore if foot.endswith("F") else 1 - self.fore) / 2
        peak = share / self.duty_factor / np.mean(np.sin(np.pi * grid**self.skew))
        into = ((time_s / self.stride_s - self.landings[foot]) % 1.0) / self.duty_factor
        return np.where(into < 1, peak * np.sin(np.pi * np.minimum(into, 1.0) ** self.skew), 0.0)

    def height_m(self, time_s: np.ndarray, rate: int = 0) -> np.ndarray:
        """The centre of mass above its mean height, which the forces integrated twice give; rate 1: its velocity."""
        at_s = np.arange(FINE) / FINE * self.stride_s
        up = G_M_S2 * (np.sum([self.force_bw(foot, at_s) for foot in self.landings], axis=0) - 1)
        waves = 2 * np.pi * np.fft.rfftfreq(FINE, self.stride_s / FINE)
        parts = np.fft.rfft(up)[1:] / -(waves[1:] ** 2)
        path = np.fft.irfft(np.concatenate([[0.0], parts]), FINE)
        around = np.append(path, path[0])
        return CubicSpline(np.append(at_s, self.stride_s), around, bc_type="periodic")(time_s % self.stride_s, rate)

    def paw_m(self, foot: str, time_s: np.ndarray) -> np.ndarray:
        """(T, 2): how far ahead, but for a constant, and how high a paw's marker is."""
        strides = time_s / self.stride_s - self.landings[foot]
        swing = np.maximum(strides % 1.0 - self.duty_factor, 0.0) / (1 - self.duty_factor)
        middle = (self.leaves + self.lands) / 2
        # The integral of a speed that is `leaves` at first, `lands` at last, and 1 in the middle.
        gone = self.leaves * swing + (self.lands - self.leaves) * swing**2 / 2
        gone = (gone + (1 - middle) / np.pi * (1 - np.cos(np.pi * swing))) / (middle + 2 * (1 - middle) / np.pi)
        ahead_m = self.speed_m_s * self.stride_s * (np.floor(strides) + gone + self.landings[foot])
        ahead_m += self.speed_m_s * self.stride_s * self.duty_factor / 2
        return np.stack([ahead_m, PAW_M + LIFT_M * np.sin(np.pi * swing) ** 2], axis=1)

    def states(self, body: Body, time_s: np.ndarray) -> np.ndarray:
        """(T, D): of `cheetah-24` that runs along x with a straight back, its centre of mass exactly where it has to
        be."""
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
                ankle = [*(column[f"{name}_pitch"] for name in names)]
                means = body.mean_rad[np.array(ankle) - PITCH]
                flat = means.sum()  # the foot keeps its inclination
                root_m = segments[names[0]].offset_m[0]
                ankle_m = np.add(self.paw_m(foot, time_s), (root_m - rest_m, -paw.offset_m[2] * np.cos(flat)))
                x, z = (ankle_m - states[:, [0, 2]] - [root_m, 0]).T
                bend = np.sign(means[1]) * np.arccos((x**2 + z**2 - upper**2 - lower**2) / (2 * upper * lower))
                first = np.arctan2(-x, -z) - np.arctan2(lower * np.sin(bend), upper + lower * np.cos(bend))
                states[:, ankle] = np.stack([first, bend, flat - first - bend], axis=1)
            states[:, ROOT] += target - centre_m(body, states)
        return states


GALLOP = Run(7.0, 0.3, 0.2, {"LH": 0.0, "RH": 0.1, "LF": 0.45, "RF": 0.58}, fore=0.45, skew=0.8)
TROT = Run(3.0, 0.45, 0.42, {"LH": 0.0, "RF": 0.0, "RH": 0.5, "LF": 0.5}, fore=0.55, skew=0.8)


def centre_m(body: Body, states: np.ndarray) -> np.ndarray:
    """(T, 3): of the segments' masses, in the middles of their capsules."""
    share = np.array([body.mass[segment.name][0] for segment in body.tree.segments])
    middles = middles_m(body.tree, capsules(body.tree, body.markers))
    at = body.tree.origins(states) + np.einsum("tsij,sj->tsi", body.tree.orientations(states), middles)
    return np.einsum("tsk,s->tk", at, share / share.sum())


def exactly(motion: Motion, states: np.ndarray, fps: float) -> Motion:
    """A motion of as many frames, with these states (T, D) in place of its own, known to a tenth of a millimetre."""
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
    )
    first, *others = motion.sources
    first = replace(first, keypoints=replace(first.keypoints, fps=fps))
    return replace(motion, sources=(first, *others), solution=exact, findings=(), verdict=None)


@dataclass(frozen=True)
class Difference:
    """How far an analysis is from the run that it is of."""

    centre_m: float
    """The largest error of the centre of mass at a frame."""
    kinetic_j_kg: float
    """The largest error of its kinetic energy, forwards or up, without two frames at either end."""
    rms_bw: float
    """The error of the forces of single feet while they stand, in stances that the clip holds whole."""
    timed_rms_bw: float
    """The same with the true times of touch-down and lift-off."""
    inside: float
    """The share of these forces in their intervals of 90 %."""


def difference(run: Run, found: ClipAnalysis) -> Difference:
    d, gait = found.dynamics, found.gait
    assert d is not None
    assert gait is not None
    time_s, off, timed, inside = gait.tracks.time_s, [], [], []
    for foot, force in d.force.items():
        true = run.force_bw(foot, time_s)
        for stance in d.forces[d.forces["foot"] == foot].to_dict("records"):
            stride = round(stance["start_s"] / run.stride_s - run.landings[foot]) + run.landings[foot]
            into = (time_s / run.stride_s - stride) / run.duty_factor
            stands = (into > 0) & (into < 1)
            peak = stance["impulse_bw_s"] / (MEAN_OF_PEAK * run.duty_factor * run.stride_s)
            off.append((force[:, 0] - true)[stands])
            timed.append((peak * shape(into) - true)[stands])
            inside.append(((force[:, 1] <= true) & (true <= force[:, 2]))[stands])
    series = at_frames(d.centre.series)
    inner, energy = slice(2, -2), d.energy_j_kg
    moves = {
        "kinetic_forwards": np.full(len(series.time_s), run.speed_m_s),
        "kinetic_up": run.height_m(series.time_s, 1),
    }
    step = d.centre.series.oversampling
    kinetic = [np.abs(energy[name][::step] - rate**2 / 2)[inner].max() for name, rate in moves.items()]
    return Difference(
        centre_m=float(np.abs(series.value - centre_m(found.motion.body, found.motion.states)).max()),
        kinetic_j_kg=float(max(kinetic)),
        rms_bw=float(np.sqrt(np.mean(np.concatenate(off) ** 2))),
        timed_rms_bw=float(np.sqrt(np.mean(np.concatenate(timed) ** 2))),
        inside=float(np.mean(np.concatenate(inside))),
    )
