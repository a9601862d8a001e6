"""Centre of mass, energy and vertical forces of the feet, with intervals, from a skeleton's masses.

Everything is per kilogram of the animal, forces in body weights. The centre of mass is that of the segments, each in
the middle of its capsules, about which it turns as a rod with the capsules' radius of gyration; what is not known of it
is the place's and the pose's error (`recon.gait.clip`) and the masses'. Derivatives are those of splines
(`recon.gait.kinematics`). Differentiated twice, the centre of mass says nothing of the forces of one stance: 0.6 to 1.3
body weights off even from several cameras. Least squares of its heights against the forces integrated twice, errors as
they are stated, make forces of simulated runs 5 % better and those over plates no better; for the balance of pitch the
net acceleration is not known well enough. Instead each stance has a shape,

    F(s) = peak * sin(pi s^SKEW),  s from 0 at touch-down to 1 at lift-off,

and all stances of a stride together the impulse of the body's weight over it, as over a level stride the height comes
back. The stride's time is that of the strides at a stance's time. Fore and hind feet share it as `GALLOP_FORE` says,
feet of a pair alike but for `FOOT`. Intervals come from draws of all of these and of the stances' times, and so does
the force at an instant, their mean: its maximum is lower than the peak, whose time is not known exactly. The shape and
the spread within a pair are those of force plates under two galloping cheetahs (`benchmarks/dynamics.py`); another
animal's, or gait's, may differ by more. There are no joint torques: their intervals would be wider than the values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.animal.capsules import capsules, inertias_m2, middles_m
from recon.base.arrays import Array, Brief, Integers
from recon.check import finding
from recon.clip import frame_ranges
from recon.fit import Finding, Motion
from recon.gait import kinematics
from recon.gait.gait import INTERVAL, Gait, interval_of
from recon.gait.kinematics import OVERSAMPLING, Errors, JointKinematics
from recon.geometry.kinematics import Marker, Tree

if TYPE_CHECKING:
    import pandas as pd

G_M_S2 = 9.81
KINETIC = ("kinetic_forwards", "kinetic_sideways", "kinetic_up")
"""The kinetic energies of the centre of mass."""
SKEW = 0.8
"""The exponent of time in the force over a stance: it rises faster than it falls, its centre is at 0.41 of the stance
(0.36 to 0.48)."""
GALLOP_FORE, OTHER_FORE = (0.44, 0.11), (0.5, 0.16)
"""The fore feet's share of the impulse and one sigma of it. At a gallop: the mean and the spread of 0.30 of cheetahs at
18 m/s, 0.38 of greyhounds at their fastest (J. Exp. Biol. 215:2425), 0.43 of dogs that accelerate, 0.60 of dogs that
do not (212:1930) and 0.50 of racehorses (222:jeb204107). In other gaits: a guess."""
FOOT = 0.4
"""One sigma of the logarithm by which a foot's impulse differs from its pair's mean."""
STANCES_ALIKE = 0.2
"""One sigma by which a stance is shorter or longer than those of the strides at its time, relative to them: 0.07 to
0.21 by the markers of a dog that walks, trots and gallops; the fore and hind feet of galloping racehorses are 9 to 20 %
apart (J. Exp. Biol. 209:4389)."""
DRAWS, SEED = 400, 0
NODES = 41
"""Instants of a stance and what is about it at which the force is drawn; in between it is interpolated."""
FLIGHT_FRAMES, OFF_GRAVITY = 5, 3.0
"""Fewer frames of a flight tell no acceleration; and how many standard deviations from gravity's are a finding."""
NET_FRAMES = 500
"""At most so many frames of a clip say what its net acceleration is: errors last for several."""
MASS_LASTS_S = 10.0
"""Errors of masses are the same all the time."""


@dataclass(frozen=True, eq=False, repr=False)
class Dynamics(Brief):
    """The centre of mass, energies and forces of a clip of T frames, with N times on the grid of ten times the frame
    rate."""

    centre: JointKinematics
    """The centre of mass, in the upright frame."""
    net_acceleration_m_s2: tuple[float, float]
    """The centre's own over the clip, along its way, and one standard deviation."""
    internal_j_kg: Array
    """(N,): kinetic energy of the segments about the centre of mass."""
    internal_sigma_j_kg: Array
    """One standard deviation of it, shape (N,)."""
    angular_momentum: Array
    """(N, 3): about the centre of mass, m^2/s per kilogram."""
    angular_momentum_sigma: Array
    """One standard deviation of it, shape (N, 3)."""
    ground_m: Array
    """(N,): height of the ground under the centre of mass."""
    forces: pd.DataFrame
    """A table with a row for each stance that lies in the clip from beginning to end: foot, start_s and end_s; peak_bw
    of the vertical force and impulse_bw_s, each with the ends of its interval (peak_low_bw, ...)."""
    force: Mapping[str, Array]
    """By foot (N, 3): the expected vertical force, and the ends of the interval that holds it with 90 %."""
    flights: pd.DataFrame
    """Rows of the clip in which no foot stands, whatever the errors of touch-down and lift-off: first, stop, start_s
    and end_s; up_m_s2, the acceleration of the centre of mass by the parabola through its heights (-`G_M_S2` in free
    fall), and sigma_m_s2, one standard deviation by the errors of place, pose and masses as they last."""

    @cached_property
    def ways(self) -> Array:
        """(3, 3): in columns forwards, along the centre's way over the clip, sideways, and up."""
        level_m = self.centre.series.value[:, :2]
        known_m = level_m[np.isfinite(level_m[:, 0])]
        way = known_m[-1] - known_m[0] if len(known_m) > 1 else np.array([1.0, 0.0])
        x, y = way / max(float(np.linalg.norm(way)), 1e-9)
        return np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])

    @cached_property
    def energy_j_kg(self) -> dict[str, Array]:
        """Potential, kinetic forwards, sideways and up, internal, and total, each (N,)."""
        series = self.centre.series
        found = {"potential": G_M_S2 * (series.value[:, 2] - self.ground_m)}
        found |= dict(zip(KINETIC, 0.5 * (series.rate @ self.ways).T ** 2, strict=True))
        found["internal"] = self.internal_j_kg
        return found | {"total": np.sum([*found.values()], axis=0)}

    @cached_property
    def energy_sigma_j_kg(self) -> dict[str, Array]:
        """One standard deviation of these, each (N,)."""
        series = self.centre.series
        moved = np.abs(series.rate @ self.ways) * np.sqrt(series.rate_sigma**2 @ self.ways**2)
        found = {"potential": G_M_S2 * series.value_sigma[:, 2]} | dict(zip(KINETIC, moved.T, strict=True))
        found["internal"] = self.internal_sigma_j_kg
        return found | {"total": np.linalg.norm([*found.values()], axis=0)}


def dynamics(motion: Motion, gait: Gait | None, errors: Sequence[Errors]) -> Dynamics | None:
    """errors: of the joints, as `recon.gait.clip` has them. None of a skeleton without masses or
    feet, and of a chain."""
    shares = motion.body.mass
    if not shares or gait is None or motion.side is not None:
        return None
    share, sigma = np.array([shares[s.name] for s in motion.body.tree.segments]).T
    share, sigma = share / share.sum(), sigma / share.sum()
    rods_m = _rods(motion)
    middles_m = rods_m.mean(axis=2)
    centre_m = np.einsum("tsk,s->tk", middles_m, share)
    apart_m = middles_m - centre_m[:, None]
    ends = [motion.upright.names.index(name) for name in motion.forward_names]
    by_pose = [Errors(np.mean(e.sigma[:, ends], axis=1), e.correlation_s) for e in errors]
    by_mass = Errors(np.maximum(np.sqrt(np.einsum("tsk,s->tk", apart_m**2, sigma**2)), 1e-6), MASS_LASTS_S)
    of_centre = [*by_pose, by_mass]
    centre = kinematics.point_kinematics(motion.time_s, centre_m, of_centre)
    some = slice(None, None, -(-len(centre_m) // NET_FRAMES))
    net = kinematics.net_acceleration(motion.time_s[some], centre_m[some], [error[some] for error in of_centre])
    # What turns about the centre is worked out at frames: the rods' paths on the fine grid would take far longer.
    of_rods_m = (rods_m - centre_m[:, None, None]).reshape(len(rods_m), -1)
    about = kinematics.series_kinematics(motion.time_s, of_rods_m, oversampling=1)
    value, rate = (of.reshape(len(of), -1, 3) for of in (about.value, about.rate))
    of_ends = np.repeat(share / 2, 2)
    internal = 0.5 * np.sum(rate**2, axis=2) @ of_ends
    momentum = np.einsum("nsk,s->nk", np.cross(value, rate), of_ends)
    of_joint = _nearest(motion, rods_m)
    near = Errors(errors[-1].sigma[:, of_joint], errors[-1].correlation_s)
    spread = _turning_sigma(value, rate, of_ends, sigma, of_joint, near)
    turning = kinematics.series_kinematics(motion.time_s, np.column_stack([internal, momentum, spread])).value
    forces, force = _forces(gait)
    return Dynamics(
        centre=centre,
        net_acceleration_m_s2=net,
        internal_j_kg=turning[:, 0],
        internal_sigma_j_kg=np.maximum(turning[:, 4], 0.0),
        angular_momentum=turning[:, 1:4],
        angular_momentum_sigma=np.maximum(turning[:, 5:], 0.0),
        ground_m=centre.series.value[:, 2] - gait.tracks.above_ground(centre.series.value),
        forces=forces,
        force=force,
        flights=_flights(motion, gait, centre_m, apart_m * sigma[:, None], by_pose),
    )


def _rods(motion: Motion) -> Array:
    """(T, S, 2, 3): two points, upright, in which half of each segment's mass turns as its capsules do about an axis
    across the longest one of theirs."""
    tree = motion.body.tree
    shape = capsules(tree, motion.body.markers)
    inertia = inertias_m2(tree, shape)
    second_moment = np.trace(inertia, axis1=1, axis2=2)[:, None, None] / 2 * np.eye(3) - inertia
    square, axis = np.linalg.eigh(second_moment)
    gyration = axis[:, :, -1] * np.sqrt(np.maximum(square[:, -1:], 0.0))
    middles = middles_m(tree, shape)
    ends = np.stack([middles - gyration, middles + gyration], axis=1).tolist()
    markers = tuple(
        Marker(f"{segment.name}_{i}", segment.name, (x, y, z))
        for segment, of_it in zip(tree.segments, ends, strict=True)
        for i, (x, y, z) in enumerate(of_it)
    )
    points_m = Tree(tree.segments, markers).pose(motion.states, motion.size).points_m
    return points_m.reshape(len(points_m), len(ends), 2, 3)


def _nearest(motion: Motion, rods_m: Array) -> Integers:
    """(E,): the joint that each end of the rods (T, S, 2, 3) is nearest to, in the first frame with a pose."""
    first = int(np.flatnonzero(motion.solved)[0])
    apart_m = rods_m[first].reshape(-1, 1, 3) - motion.upright.xyz_m[first]
    return np.linalg.norm(apart_m, axis=2).argmin(axis=1)


def _turning_sigma(
    at_m: Array, rate_m_s: Array, share: Array, share_sigma: Array, of_joint: Integers, errors: Errors
) -> Array:
    """(T, 4): one standard deviation of the internal energy and the angular momentum of ends of rods (T, E, 3), two for
    each segment, with shares (E,) of the mass, those of segments with standard deviations (S,). The ends' errors are
    those of their joints: alike for all ends of a joint, independent of other joints'. Errors that last for
    `correlation_s` move at sigma / correlation_s."""
    axes = np.eye(3)
    by_rate = np.concatenate([rate_m_s[:, :, :, None], np.cross(at_m[:, :, None], axes)], axis=3)
    by_place = np.concatenate([np.zeros_like(rate_m_s)[:, :, :, None], np.cross(axes, rate_m_s[:, :, None])], axis=3)
    own = np.concatenate([0.5 * np.sum(rate_m_s**2, axis=2, keepdims=True), np.cross(at_m, rate_m_s)], axis=2)
    total = np.einsum("teq,e->tq", own, share)
    of_segment = (own - total[:, None]).reshape(len(own), -1, 2, 4).mean(axis=2) * share_sigma[:, None]
    variance = np.sum(of_segment**2, axis=1)
    for joint in np.unique(of_joint):
        ends = np.flatnonzero(of_joint == joint)
        sigma = errors.sigma[:, ends[0], :, None]
        for by, of in ((by_rate, sigma / errors.correlation_s), (by_place, sigma)):
            variance += np.sum((np.einsum("tekq,e->tkq", by[:, ends], share[ends]) * of) ** 2, axis=1)
    return np.sqrt(variance)


def shape(into: Array) -> Array:
    """Force relative to its peak at shares of a stance, 0 outside."""
    inside = (into > 0) & (into < 1)
    return np.where(inside, np.sin(np.pi * np.clip(into, 0, 1) ** SKEW), 0.0)


_GRID = (np.arange(1000) + 0.5) / 1000
MEAN_OF_PEAK = float(shape(_GRID).mean())
"""Mean force over a stance, of the peak."""


def _drawn(gait: Gait) -> tuple[Array, Array, Array]:
    """Times of touch-down and lift-off and impulses (D, S) of S stances; the first draw is the middle of everything."""
    rng, stances = np.random.default_rng(SEED), gait.stances
    S, feet = len(stances), gait.tracks.feet

    def normal(*shape: int) -> Array:
        return np.concatenate([np.zeros((1, *shape)), rng.standard_normal((DRAWS, *shape))])

    events = np.array([[s.start_s, s.end_s, s.start_sigma_s, s.end_sigma_s] for s in stances]).reshape(S, 4)
    start, end, start_sigma, end_sigma = np.nan_to_num(events).T
    starts = start + normal(S) * start_sigma
    ends = end + normal(S) * end_sigma
    known = "gallop" in gait.name.name or gait.name.name == "unknown"
    mean, sigma = GALLOP_FORE if known else OTHER_FORE
    fore = np.clip(mean + sigma * normal(1)[:, 0], 0.1, 0.9)
    factor = np.exp(FOOT * normal(len(feet)))
    is_fore = np.array([foot.endswith("F") for foot in feet])
    together = np.stack([factor[:, is_fore == fore_too].sum(axis=1) for fore_too in is_fore], axis=1)
    share = np.where(is_fore, fore[:, None], 1 - fore[:, None]) * factor / together  # a pair has what it has
    lasts, lasts_sigma = np.array([gait.stride_time(s.start_s, s.end_s) for s in stances]).reshape(S, 2).T
    period = np.maximum(lasts + lasts_sigma * normal(1), 0.2 * lasts)
    of_foot = np.array([feet.index(s.foot) for s in stances], dtype=int)
    # How long a stance lasts is known by its ends, and by the others of its strides.
    whole, drawn, noise = np.array([s.begins and s.ends for s in stances], dtype=bool), ends - starts, normal(S)
    variance = start_sigma**2 + end_sigma**2
    for i in np.flatnonzero(whole & np.isfinite(lasts)):
        near = whole & (start < end[i] + lasts[i]) & (end > start[i] - lasts[i])
        of_all = np.median(drawn[:, near], axis=1)
        spread = STANCES_ALIKE * of_all[0]
        # A part of a stance is further off than its ends seem to be.
        off = max(1.0, (of_all[0] - drawn[0, i]) ** 2 / (variance[i] + spread**2))
        longer = off * (of_all + spread * noise[:, i] - drawn[:, i]) / (off * variance[i] + spread**2)
        starts[:, i] -= start_sigma[i] ** 2 * longer
        ends[:, i] += end_sigma[i] ** 2 * longer
    return starts, np.maximum(ends, starts + 0.3 * (end - start)), share[:, of_foot] * period


FORCE_COLUMNS = (
    *("foot", "start_s", "end_s", "peak_bw", "peak_low_bw", "peak_high_bw"),
    *("impulse_bw_s", "impulse_low_bw_s", "impulse_high_bw_s"),
)
_ENDS = [(1 - INTERVAL) / 2, (1 + INTERVAL) / 2]


def _forces(gait: Gait) -> tuple[pd.DataFrame, dict[str, Array]]:
    """The table of whole stances, and each foot's force over time, NaN within stances that the clip cuts."""
    import pandas as pd

    starts, ends, impulses = _drawn(gait)
    time_s, rows = gait.tracks.time_s, []
    some_last = np.where([stance.begins and stance.ends for stance in gait.stances], ends - starts, np.nan)
    some_peak = impulses / (MEAN_OF_PEAK * some_last)
    peak, impulse = (np.stack([of[0], *np.quantile(of[1:], _ENDS, axis=0)]) for of in (some_peak, impulses))
    force = {foot: np.zeros((len(time_s), 3)) for foot in gait.tracks.feet}
    for i, stance in enumerate(gait.stances):
        whole = stance.begins and stance.ends
        reach = 4 * max(stance.start_sigma_s, stance.end_sigma_s) if whole else 0.0
        first, last = stance.start_s - reach, stance.end_s + reach
        near = slice(*np.searchsorted(time_s, [first, np.nextafter(last, np.inf)]))
        if not whole:
            force[stance.foot][near] = np.nan
            continue
        some_s = np.linspace(first, last, NODES)
        drawn = some_peak[1:, i, None] * shape((some_s - starts[1:, i, None]) / some_last[1:, i, None])
        for k, of_draws in enumerate((drawn.mean(axis=0), *np.quantile(drawn, _ENDS, axis=0))):
            force[stance.foot][near, k] += np.interp(time_s[near], some_s, of_draws)
        if np.isfinite(impulses[0, i]):
            rows.append((stance.foot, stance.start_s, stance.end_s, *peak[:, i].tolist(), *impulse[:, i].tolist()))
    return pd.DataFrame(rows, columns=[*FORCE_COLUMNS]), force


def _flights(motion: Motion, gait: Gait, centre_m: Array, by_mass_m: Array, errors: Sequence[Errors]) -> pd.DataFrame:
    """The flights of an animal whose four feet are known, between its first stance and its last. by_mass_m (T, S, 3):
    what one standard deviation of each segment's share does to the centre; errors (T, 3) of the centre, without
    those."""
    import pandas as pd

    time_s, found = motion.time_s, []
    if len(gait.tracks.feet) >= 4 and gait.stances:
        free = np.isfinite(gait.tracks.foot_m[::OVERSAMPLING]).all(axis=(1, 2)) & motion.solved
        free &= (time_s > min(s.end_s for s in gait.stances)) & (time_s < max(s.start_s for s in gait.stances))
        for stance in gait.stances:
            early, late = stance.start_interval_s[0], stance.end_interval_s[1]
            free &= (time_s < (early if stance.begins else -np.inf)) | (time_s > (late if stance.ends else np.inf))
        for first, stop in frame_ranges(np.flatnonzero(free)):
            rows = slice(first, stop)
            if stop - first >= FLIGHT_FRAMES:
                of_rows = [Errors(e.sigma[rows, 2], e.correlation_s) for e in errors]
                of_rows += [Errors(one, np.inf) for one in by_mass_m[rows, :, 2].T]
                up = kinematics.parabola_acceleration(time_s[rows], centre_m[rows, 2], of_rows)
                found.append((int(first), int(stop), time_s[first], time_s[stop - 1], *up))
    return pd.DataFrame(found, columns=["first", "stop", "start_s", "end_s", "up_m_s2", "sigma_m_s2"])


def off_gravity(flights: pd.DataFrame) -> pd.Series:
    """How far each flight is from free fall, in standard deviations."""
    return (flights["up_m_s2"] + G_M_S2) / flights["sigma_m_s2"].clip(lower=1e-9)


def findings_of_dynamics(motion: Motion, found: Dynamics) -> tuple[Finding, ...]:
    """Whether the flight that is furthest off free fall, in standard deviations, is so beyond its uncertainty."""
    off = off_gravity(found.flights).abs()
    if not (off > OFF_GRAVITY).any():
        return ()
    worst = found.flights.iloc[int(off.to_numpy().argmax())]
    frames = int(motion.frames[int(worst["first"])]), int(motion.frames[int(worst["stop"]) - 1]) + 1
    numbers: dict[str, Any] = {name: float(worst[name]) for name in ("up_m_s2", "sigma_m_s2")}
    return (finding("flight_against_gravity", frames, **numbers),)


OVER_STRIDE = {"net_work": "_j_kg", "net_power": "_w_kg", "net_acceleration": "_m_s2", "exchange": ""}
"""What is known of a stride, and its unit."""


def over_stride(found: Dynamics, start_s: float, end_s: float) -> dict[str, tuple[float, float, float]]:
    """What a stride changes, each with the ends of its interval: the total energy without the internal one, also in the
    mean per second, the speed of the centre of mass along its way; and exchange, Cavagna's recovery: the share of the
    rises of two energies, that of height and of moving up, and that of moving level, which one takes from the other,
    near 1 for a pendulum and near 0 for a spring."""
    series, energy, sigma = found.centre.series, found.energy_j_kg, found.energy_sigma_j_kg
    at = np.minimum(np.searchsorted(series.time_s, [start_s, end_s - 1e-9]), len(series.time_s) - 1)
    rows = slice(at[0], at[1] + 1)

    def rises(of: Sequence[str]) -> tuple[float, float]:
        """Their sum, and its standard deviation by those of the ends of each."""
        steps = np.diff(np.sum([energy[name][rows] for name in of], axis=0))
        turns = np.diff((steps > 0).astype(int), prepend=0, append=0) != 0
        variance = np.sum([sigma[name][rows][turns] ** 2 for name in of])
        return float(np.maximum(steps, 0).sum()), float(np.sqrt(variance))

    height, level = ("potential", "kinetic_up"), ("kinetic_forwards", "kinetic_sideways")
    (high, high_sigma), (fast, fast_sigma), (both, both_sigma) = map(rises, (height, level, height + level))
    rise = max(high + fast, 1e-9)
    way = np.diff(series.value[at], axis=0)[0] * [1, 1, 0]
    ahead = way / max(float(np.linalg.norm(way)), 1e-9)
    lasts_s, work = end_s - start_s, np.diff(energy["total"][at] - energy["internal"][at])[0]
    work_sigma = np.sqrt(np.sum(sigma["total"][at] ** 2 - sigma["internal"][at] ** 2))
    faster, faster_sigma = np.diff(series.rate[at] @ ahead)[0], np.linalg.norm(series.rate_sigma[at] * ahead)
    exchange_sigma = np.hypot(both_sigma, both / rise * np.hypot(high_sigma, fast_sigma)) / rise
    changes = {
        "net_work": (work, work_sigma),
        "net_power": (work / lasts_s, work_sigma / lasts_s),
        "net_acceleration": (faster / lasts_s, faster_sigma / lasts_s),
        "exchange": (1 - both / rise, exchange_sigma),
    }
    found_as = {name: interval_of(*map(float, of)) for name, of in changes.items()}
    shared, low, high = found_as["exchange"]
    return found_as | {"exchange": (shared, max(low, 0.0), min(high, 1.0))}
