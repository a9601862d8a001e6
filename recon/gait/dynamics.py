"""Compute the centre of mass, energy and vertical forces of the feet, with intervals, from a skeleton's masses.

Forces are in body weights, and all other values are per kilogram of the animal. The centre of mass is computed from the
segments, each with its mass in the middle of its capsules. A segment rotates about this point like a rod with the
radius of gyration of the capsules. The uncertainty results from the errors of the position and the pose
(`recon.gait.clip`) and of the masses. Derivatives are computed from splines (`recon.gait.kinematics`).

The second derivative of the centre of mass is too uncertain, even from several cameras, to give the forces of single
stances. Instead, the force of each stance is assumed to have the shape

    F(s) = peak * sin(pi s^FORCE_SKEW),  s from 0 at touch-down to 1 at lift-off,

and all stances of a stride together have the impulse of the body's weight over the stride, because over a stride on
level ground the height returns to its initial value. The duration of the stride is the mean of the strides around a
stance. `GALLOP_FORE` is the fraction of the impulse on the fore feet. The left and the right foot share this fraction
equally, within `FOOT_IMPULSE_SIGMA`. Intervals come from random draws of all these quantities and of the stances'
times. The force at an instant is the mean of the draws. The maximum of this force is lower than the peak, because the
time of the peak is not known exactly. The shape and the spread within a pair were measured by force plates under two
galloping cheetahs (`benchmarks/gait.py`). Other animals or gaits may differ by more. Joint torques are left out,
because their intervals would be wider than the values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from recon.animal.capsules import capsules, inertias_m2, middles_m
from recon.base.arrays import Array, Brief, Integers, mean
from recon.base.numbers import percent
from recon.check.codes import finding
from recon.clip import frame_ranges
from recon.fit.motion import Motion
from recon.fit.result import Finding
from recon.gait import kinematics
from recon.gait.gait import Gait
from recon.gait.kinematics import JointKinematics
from recon.gait.series import OVERSAMPLING, Errors, parabola_acceleration, series_kinematics
from recon.gait.stances import INTERVAL, interval_of
from recon.geometry.kinematics import Marker, Tree

if TYPE_CHECKING:
    import pandas as pd

G_M_S2 = 9.81
KINETIC = ("kinetic_forwards", "kinetic_sideways", "kinetic_up")
"""Names of the components of the kinetic energy of the centre of mass."""
FORCE_SKEW = 0.8
"""Exponent of time in the force over a stance, below 1 because the force rises faster than it falls."""
GALLOP_FORE = (0.44, 0.11)
"""Fraction of a gallop's impulse on the fore feet, and its standard deviation.

The two values summarise these measurements: 0.30 (cheetahs at 18 m/s), 0.38 (greyhounds at their fastest, J. Exp. Biol.
215:2425), 0.43 (accelerating dogs) and 0.60 (dogs at constant speed, 212:1930), 0.50 (racehorses, 222:jeb204107).
"""
OTHER_FORE = (0.5, 0.16)
"""Fraction of the impulse on the fore feet in other gaits and in unknown ones, and its standard deviation, both
guessed.
"""
FOOT_IMPULSE_SIGMA = 0.4
"""Standard deviation of the logarithm of a foot's impulse divided by the mean of the left and the right foot."""
STANCE_SPREAD = 0.2
"""Standard deviation of a stance's duration, as a fraction of the median of the stances around it.

The stances of the fore and hind feet of galloping racehorses differ by 9 to 20 % (J. Exp. Biol. 209:4389).
"""
SHORTEST_STANCE = 1.0 - 3.0 * STANCE_SPREAD
"""Shortest duration of a stance that does not count as a false detection, as a fraction of the clip's median.

So short a stance with the impulse of a whole one would have a force that no foot can bear.
"""
DRAWS = 400
"""Number of random draws from which the intervals of the forces are computed."""
SEED = 0
"""Seed of the random draws of forces, so that the same motion gives the same intervals."""
NODES = 41
"""Number of times in and around a stance at which the force is computed. Values in between are interpolated."""
FLIGHT_FRAMES = 5
"""Minimum number of frames in a flight whose acceleration is computed."""
OFF_GRAVITY = 3.0
"""Maximum deviation of a flight's acceleration from free fall, in standard deviations, without a finding."""
NET_FRAMES = 500
"""Maximum number of frames used for the net acceleration of a clip. More add little, because errors last for several
frames.
"""
MASS_LASTS_S = 10.0
"""Correlation time of the errors of masses, s. The time is longer than a clip, because masses are constant."""


class StanceForce(NamedTuple):
    """Peak and impulse of a foot's vertical force in a complete stance, with the ends of their 90 % intervals."""

    foot: str
    start_s: float
    end_s: float
    peak_bw: float
    peak_low_bw: float
    peak_high_bw: float
    impulse_bw_s: float
    impulse_low_bw_s: float
    impulse_high_bw_s: float


class Flight(NamedTuple):
    """Part of the clip in which no foot is on the ground, after allowing for the errors of touch-down and lift-off."""

    first: int
    """Index of the flight's first frame in the clip."""
    stop: int
    """Index of the first frame after the flight."""
    start_s: float
    end_s: float
    up_m_s2: float
    """Upward acceleration of the centre of mass, from a parabola fitted to its heights; -`G_M_S2` in free fall."""
    sigma_m_s2: float
    """Standard deviation of `up_m_s2` from the errors of position, pose and masses."""


@dataclass(frozen=True, eq=False, repr=False)
class Dynamics(Brief):
    """Centre of mass, energies and forces of a clip of T frames.

    The fine grid has N times, ten per frame.
    """

    centre: JointKinematics
    """Motion of the centre of mass in the upright frame."""
    net_acceleration_m_s2: tuple[float, float]
    """Mean acceleration of the centre of mass along the direction of travel, and its standard deviation."""
    internal_j_kg: Array
    """Kinetic energy of the segments' motion about the centre of mass, shape (N,)."""
    internal_sigma_j_kg: Array
    """Standard deviation of `internal_j_kg`, shape (N,)."""
    angular_momentum: Array
    """Angular momentum about the centre of mass, m^2/s per kilogram, shape (N, 3)."""
    angular_momentum_sigma: Array
    """Standard deviation of `angular_momentum`, shape (N, 3)."""
    ground_m: Array
    """Height of the ground under the centre of mass, shape (N,)."""
    stance_forces: Sequence[StanceForce]
    """Forces of the stances whose touch-down and lift-off are in the clip."""
    force: Mapping[str, Array]
    """Expected vertical force of each foot and the ends of its 90 % interval, body weights, shape (N, 3)."""
    flight_parts: Sequence[Flight]
    """Parts of the clip in which no foot is on the ground."""

    @cached_property
    def forces(self) -> pd.DataFrame:
        """Return the forces of complete stances as a table with a row for each stance."""
        import pandas as pd  # slow to import

        return pd.DataFrame(self.stance_forces, columns=[*StanceForce._fields])

    @cached_property
    def flights(self) -> pd.DataFrame:
        """Return the flights as a table with a row for each flight."""
        import pandas as pd  # slow to import

        return pd.DataFrame(self.flight_parts, columns=[*Flight._fields])

    @property
    def mean_peak_bw(self) -> tuple[float, float, float] | None:
        """Return the mean peak force over the complete stances, and the means of the ends of the 90 % intervals.

        The values are in body weights. Return None without complete stances.
        """
        if not self.stance_forces:
            return None
        peak, low, high = zip(*((s.peak_bw, s.peak_low_bw, s.peak_high_bw) for s in self.stance_forces), strict=True)
        return mean(peak), mean(low), mean(high)

    @cached_property
    def directions(self) -> Array:
        """Return unit vectors forwards (the direction of travel over the clip), sideways and up, as columns (3, 3)."""
        level_m = self.centre.series.value[:, :2]
        known_m = level_m[np.isfinite(level_m[:, 0])]
        direction = known_m[-1] - known_m[0] if len(known_m) > 1 else np.array([1.0, 0.0])
        x, y = direction / max(float(np.linalg.norm(direction)), 1e-9)
        return np.array([[x, -y, 0.0], [y, x, 0.0], [0.0, 0.0, 1.0]])

    @cached_property
    def energy_j_kg(self) -> dict[str, Array]:
        """Return a dictionary of the potential, kinetic, internal and total energy, each of shape (N,), J/kg.

        The kinetic energy of the centre of mass has three components, forwards, sideways and up.
        """
        series = self.centre.series
        energy = {"potential": G_M_S2 * (series.value[:, 2] - self.ground_m)}
        energy |= dict(zip(KINETIC, 0.5 * (series.rate @ self.directions).T ** 2, strict=True))
        energy["internal"] = self.internal_j_kg
        return energy | {"total": np.sum([*energy.values()], axis=0)}

    @cached_property
    def energy_sigma_j_kg(self) -> dict[str, Array]:
        """Return a dictionary of the standard deviations of the energies, each of shape (N,), J/kg."""
        series = self.centre.series
        kinetic_sigma = np.abs(series.rate @ self.directions) * np.sqrt(series.rate_sigma**2 @ self.directions**2)
        sigma = {"potential": G_M_S2 * series.value_sigma[:, 2]} | dict(zip(KINETIC, kinetic_sigma.T, strict=True))
        sigma["internal"] = self.internal_sigma_j_kg
        return sigma | {"total": np.linalg.norm([*sigma.values()], axis=0)}


def dynamics(motion: Motion, gait: Gait | None, errors: Sequence[Errors]) -> Dynamics | None:
    """Return the dynamics of a motion; None for a chain or a skeleton without masses or feet.

    `errors` are the independent errors of the joints' positions, each (T, J, 3), metres (`ClipAnalysis.errors`).
    """
    shares = motion.body.mass
    if not shares or gait is None or motion.side is not None:
        return None
    fraction, sigma = np.array([shares[s.name] for s in motion.body.tree.segments]).T
    fraction, sigma = fraction / fraction.sum(), sigma / fraction.sum()
    rods_m = _rods(motion)
    rod_middles_m = rods_m.mean(axis=2)
    centre_m = np.einsum("tsk,s->tk", rod_middles_m, fraction)
    apart_m = rod_middles_m - centre_m[:, None]
    end_rows = [motion.upright.names.index(name) for name in motion.forward_names]
    by_pose = [Errors(np.mean(e.sigma[:, end_rows], axis=1), e.correlation_s) for e in errors]
    by_mass = Errors(np.maximum(np.sqrt(np.einsum("tsk,s->tk", apart_m**2, sigma**2)), 1e-6), MASS_LASTS_S)
    centre_errors = [*by_pose, by_mass]
    centre = kinematics.point_kinematics(motion.time_s, centre_m, centre_errors)
    every_few = slice(None, None, -(-len(centre_m) // NET_FRAMES))
    net = kinematics.net_acceleration(
        motion.time_s[every_few], centre_m[every_few], [error[every_few] for error in centre_errors]
    )
    # The rotation about the centre is computed at the frames only, because the fine grid would take far longer.
    flat_rods_m = (rods_m - centre_m[:, None, None]).reshape(len(rods_m), -1)
    rod_motion = series_kinematics(motion.time_s, flat_rods_m, oversampling=1)
    value, rate = (values.reshape(len(values), -1, 3) for values in (rod_motion.value, rod_motion.rate))
    end_shares = np.repeat(fraction / 2, 2)
    internal = 0.5 * np.sum(rate**2, axis=2) @ end_shares
    momentum = np.einsum("nsk,s->nk", np.cross(value, rate), end_shares)
    end_joints = _nearest(motion, rods_m)
    near = Errors(errors[-1].sigma[:, end_joints], errors[-1].correlation_s)
    spread = _turning_sigma(value, rate, end_shares, sigma, end_joints, near)
    turning = series_kinematics(motion.time_s, np.column_stack([internal, momentum, spread])).value
    stance_forces, force = _forces(gait)
    return Dynamics(
        centre=centre,
        net_acceleration_m_s2=net,
        internal_j_kg=turning[:, 0],
        internal_sigma_j_kg=np.maximum(turning[:, 4], 0.0),
        angular_momentum=turning[:, 1:4],
        angular_momentum_sigma=np.maximum(turning[:, 5:], 0.0),
        ground_m=centre.series.value[:, 2] - gait.tracks.above_ground(centre.series.value),
        stance_forces=stance_forces,
        force=force,
        flight_parts=_flights(motion, gait, centre_m, apart_m * sigma[:, None], by_pose),
    )


def _rods(motion: Motion) -> Array:
    """Return the ends of the rods that represent the segments in the upright frame, shape (T, S, 2, 3), m.

    A rod with half of the segment's mass at each point has the moment of inertia of the segment's capsules about an
    axis perpendicular to the longest principal axis.
    """
    tree = motion.body.tree
    capsule_shape = capsules(tree, motion.body.markers)
    inertia = inertias_m2(tree, capsule_shape)
    second_moment = np.trace(inertia, axis1=1, axis2=2)[:, None, None] / 2 * np.eye(3) - inertia
    square, axis = np.linalg.eigh(second_moment)
    gyration = axis[:, :, -1] * np.sqrt(np.maximum(square[:, -1:], 0.0))
    middles = middles_m(tree, capsule_shape)
    ends = np.stack([middles - gyration, middles + gyration], axis=1).tolist()
    markers = tuple(
        Marker(f"{segment.name}_{i}", segment.name, (x, y, z))
        for segment, segment_ends in zip(tree.segments, ends, strict=True)
        for i, (x, y, z) in enumerate(segment_ends)
    )
    points_m = Tree(tree.segments, markers).pose(motion.states, motion.size).points_m
    return points_m.reshape(len(points_m), len(ends), 2, 3)


def _nearest(motion: Motion, rods_m: Array) -> Integers:
    """Return the indices (E,) of the joints nearest to the ends of rods (T, S, 2, 3) in the first frame with a pose."""
    first = int(np.flatnonzero(motion.solved)[0])
    difference_m = rods_m[first].reshape(-1, 1, 3) - motion.upright.xyz_m[first]
    return np.linalg.norm(difference_m, axis=2).argmin(axis=1)


def _turning_sigma(
    at_m: Array, rate_m_s: Array, share: Array, share_sigma: Array, end_joints: Integers, errors: Errors
) -> Array:
    """Return the standard deviations (T, 4) of the internal energy and the angular momentum of the segments.

    Each end of a rod has the error of its nearest joint. The ends at one joint have the same error, and the errors of
    different joints are independent. An error with the correlation time `correlation_s` changes at the rate
    sigma / correlation_s.

    Parameters
    ----------
    at_m, rate_m_s : ndarray
        Positions, m, and velocities, m/s, of the rods' ends relative to the centre of mass, shape (T, E, 3). There are
        two ends for each segment.
    share : ndarray
        Fraction of the animal's mass at each end, shape (E,).
    share_sigma : ndarray
        Standard deviation of each segment's fraction of the mass, shape (S,).
    end_joints : ndarray
        Joint nearest to each end, shape (E,).
    errors : Errors
        Errors of the joints' positions, (T, J, 3), metres.
    """
    axes = np.eye(3)
    by_rate = np.concatenate([rate_m_s[:, :, :, None], np.cross(at_m[:, :, None], axes)], axis=3)
    by_position = np.concatenate([np.zeros_like(rate_m_s)[:, :, :, None], np.cross(axes, rate_m_s[:, :, None])], axis=3)
    quantities = np.concatenate([0.5 * np.sum(rate_m_s**2, axis=2, keepdims=True), np.cross(at_m, rate_m_s)], axis=2)
    total = np.einsum("teq,e->tq", quantities, share)
    by_segment = (quantities - total[:, None]).reshape(len(quantities), -1, 2, 4).mean(axis=2) * share_sigma[:, None]
    variance = np.sum(by_segment**2, axis=1)
    for joint in np.unique(end_joints):
        ends = np.flatnonzero(end_joints == joint)
        sigma = errors.sigma[:, ends[0], :, None]
        for derivative, error in ((by_rate, sigma / errors.correlation_s), (by_position, sigma)):
            variance += np.sum((np.einsum("tekq,e->tkq", derivative[:, ends], share[ends]) * error) ** 2, axis=1)
    return np.sqrt(variance)


def shape(share: Array) -> Array:
    """Return a foot's vertical force, as a fraction of its peak, at fractions `share` of a stance; 0 outside it."""
    is_inside, force = (share > 0) & (share < 1), np.zeros(share.shape)
    force[is_inside] = np.sin(np.pi * share[is_inside] ** FORCE_SKEW)
    return force


_GRID = (np.arange(1000) + 0.5) / 1000
MEAN_OF_PEAK = float(shape(_GRID).mean())
"""Mean force over a stance, as a fraction of the peak force."""


def _draw(gait: Gait) -> tuple[Array, Array, Array]:
    """Return D random draws of touch-down (s), lift-off (s) and impulse (body weight times seconds) of S stances.

    Each array has the shape (D, S). The first draw has the central value of every distribution.
    """
    rng, stances = np.random.default_rng(SEED), gait.stances
    count, feet = len(stances), gait.tracks.feet

    def normal(*size: int) -> Array:
        return np.concatenate([np.zeros((1, *size)), rng.standard_normal((DRAWS, *size))])

    stance_rows = np.array([[s.start_s, s.end_s, s.start_sigma_s, s.end_sigma_s] for s in stances]).reshape(count, 4)
    start, end, start_sigma, end_sigma = np.nan_to_num(stance_rows).T
    starts = start + normal(count) * start_sigma
    ends = end + normal(count) * end_sigma
    fore_mean, fore_sigma = GALLOP_FORE if "gallop" in gait.name.name else OTHER_FORE
    fore = np.clip(fore_mean + fore_sigma * normal(1)[:, 0], 0.1, 0.9)
    factor = np.exp(FOOT_IMPULSE_SIGMA * normal(len(feet)))
    is_fore = np.array([foot.endswith("F") for foot in feet])
    pair_sum = np.stack([factor[:, is_fore == pair].sum(axis=1) for pair in is_fore], axis=1)
    # The feet of a pair share the pair's impulse in proportion to random factors.
    fraction = np.where(is_fore, fore[:, None], 1 - fore[:, None]) * factor / pair_sum
    stride_s, stride_sigma_s = np.array([gait.stride_time(s.start_s, s.end_s) for s in stances]).reshape(count, 2).T
    period = np.maximum(stride_s + stride_sigma_s * normal(1), 0.2 * stride_s)
    foot_rows = np.array([feet.index(s.foot) for s in stances], dtype=int)
    # The duration of a stance is known from its touch-down and lift-off, and from the other stances around it.
    is_whole = np.array([s.begins and s.ends for s in stances], dtype=bool)
    drawn_s = ends - starts
    noise = normal(count)
    variance = start_sigma**2 + end_sigma**2
    for i in np.flatnonzero(is_whole & np.isfinite(stride_s)):
        is_near = is_whole & (start < end[i] + stride_s[i]) & (end > start[i] - stride_s[i])
        typical = np.median(drawn_s[:, is_near], axis=1)
        spread = STANCE_SPREAD * typical[0]
        # If the two estimates of the duration disagree, the combined uncertainty is larger than either suggests.
        inflation = max(1.0, (typical[0] - drawn_s[0, i]) ** 2 / (variance[i] + spread**2))
        change = inflation * (typical + spread * noise[:, i] - drawn_s[:, i]) / (inflation * variance[i] + spread**2)
        starts[:, i] -= start_sigma[i] ** 2 * change
        ends[:, i] += end_sigma[i] ** 2 * change
    return starts, np.maximum(ends, starts + 0.3 * (end - start)), fraction[:, foot_rows] * period


_ENDS = [(1 - INTERVAL) / 2, (1 + INTERVAL) / 2]


def _forces(gait: Gait) -> tuple[list[StanceForce], dict[str, Array]]:
    """Return the forces of complete stances, and a dictionary of each foot's force over time, shape (N, 3).

    The columns are the expected force and the ends of its 90 % interval, body weights. The force is NaN in stances that
    the clip cuts, and in stances that are too short to be real.
    """
    starts, ends, impulses = _draw(gait)
    time_s, rows = gait.tracks.time_s, []
    durations_s = np.where([stance.begins and stance.ends for stance in gait.stances], ends - starts, np.nan)
    peaks = impulses / (MEAN_OF_PEAK * durations_s)
    peak, impulse = (np.stack([draws[0], *np.quantile(draws[1:], _ENDS, axis=0)]) for draws in (peaks, impulses))
    force = {foot: np.zeros((len(time_s), 3)) for foot in gait.tracks.feet}
    whole_s = durations_s[0][np.isfinite(durations_s[0])]
    shortest_s = SHORTEST_STANCE * float(np.median(whole_s)) if len(whole_s) else 0.0
    for i, stance in enumerate(gait.stances):
        is_whole = stance.begins and stance.ends and durations_s[0, i] >= shortest_s
        reach = 4 * max(stance.start_sigma_s, stance.end_sigma_s) if is_whole else 0.0
        first, last = stance.start_s - reach, stance.end_s + reach
        nearby = slice(*np.searchsorted(time_s, [first, np.nextafter(last, np.inf)]))
        if not is_whole:
            force[stance.foot][nearby] = np.nan
            continue
        node_s = np.linspace(first, last, NODES)
        curves = peaks[1:, i, None] * shape((node_s - starts[1:, i, None]) / durations_s[1:, i, None])
        for k, curve in enumerate((curves.mean(axis=0), *np.quantile(curves, _ENDS, axis=0))):
            force[stance.foot][nearby, k] += np.interp(time_s[nearby], node_s, curve)
        if np.isfinite(impulses[0, i]):
            rows.append(
                StanceForce(stance.foot, stance.start_s, stance.end_s, *peak[:, i].tolist(), *impulse[:, i].tolist())
            )
    return rows, force


def _flights(motion: Motion, gait: Gait, centre_m: Array, by_mass_m: Array, errors: Sequence[Errors]) -> list[Flight]:
    """Return the flights between the first and the last stance of an animal with four feet.

    `by_mass_m` is the shift of the centre of mass for one standard deviation of each segment's mass fraction, shape
    (T, S, 3), metres. `errors` are the errors of the centre of mass from all other causes, each (T, 3), metres.
    """
    time_s, flights = motion.time_s, list[Flight]()
    if len(gait.tracks.feet) >= 4 and gait.stances:
        is_free = np.isfinite(gait.tracks.foot_m[::OVERSAMPLING]).all(axis=(1, 2)) & motion.solved
        is_free &= (time_s > min(s.end_s for s in gait.stances)) & (time_s < max(s.start_s for s in gait.stances))
        for stance in gait.stances:
            early, late = stance.start_interval_s[0], stance.end_interval_s[1]
            is_free &= (time_s < (early if stance.begins else -np.inf)) | (time_s > (late if stance.ends else np.inf))
        for first, stop in frame_ranges(np.flatnonzero(is_free)):
            rows = slice(first, stop)
            if stop - first >= FLIGHT_FRAMES:
                row_errors = [Errors(error.sigma[rows, 2], error.correlation_s) for error in errors]
                row_errors += [Errors(column, np.inf) for column in by_mass_m[rows, :, 2].T]
                vertical = parabola_acceleration(time_s[rows], centre_m[rows, 2], row_errors)
                flights.append(Flight(int(first), int(stop), float(time_s[first]), float(time_s[stop - 1]), *vertical))
    return flights


def off_gravity(flights: Sequence[Flight]) -> Array:
    """Return the deviation of each of F flights from free fall, in standard deviations, shape (F,)."""
    return np.array([(flight.up_m_s2 + G_M_S2) / np.maximum(flight.sigma_m_s2, 1e-9) for flight in flights])


def findings_of_dynamics(motion: Motion, result: Dynamics) -> tuple[Finding, ...]:
    """Return a finding if the acceleration in a flight differs from free fall by more than `OFF_GRAVITY` sigmas."""
    deviation = np.abs(off_gravity(result.flight_parts))
    if not (deviation > OFF_GRAVITY).any():
        return ()
    worst = result.flight_parts[int(np.argmax(deviation))]
    frames = int(motion.frames[worst.first]), int(motion.frames[worst.stop - 1]) + 1
    return (finding("flight_against_gravity", frames, up_m_s2=worst.up_m_s2, sigma_m_s2=worst.sigma_m_s2),)


def validity_text(gait_name: str) -> str:
    """Return sentences on the animals and gaits for which forces were validated, and on assumptions for one gait."""
    validated = "Forces were validated on galloping cheetahs on level ground."
    if "gallop" in gait_name:
        return validated
    words = "an unknown gait" if gait_name == "unknown" else f"a {gait_name}"
    fraction, sigma = OTHER_FORE
    return (
        f"{validated} For {words}, the fore feet are assumed to carry {100 * fraction:.0f} ± {percent(sigma)} of the "
        "weight, and forces may be further off than their intervals say."
    )


OVER_STRIDE = {"net_work": "_j_kg", "net_power": "_w_kg", "net_acceleration": "_m_s2", "exchange": ""}
"""Names of the quantities that `over_stride` returns, each with the suffix that states the unit in column names."""


def over_stride(result: Dynamics, start_s: float, end_s: float) -> dict[str, tuple[float, float, float]]:
    """Return net work, power, acceleration and energy exchange over a stride, each with the ends of its 90 % interval.

    Net work and power are computed from the total energy without the internal energy. The net acceleration is the
    acceleration of the centre of mass along its path. The exchange is Cavagna's energy recovery, the fraction of the
    increases of one energy that comes from decreases of the other. The two energies are the potential plus vertical
    kinetic energy, and the horizontal kinetic energy. The exchange is near 1 for a pendulum and near 0 for a spring.
    """
    series, energy, sigma = result.centre.series, result.energy_j_kg, result.energy_sigma_j_kg
    ends = np.minimum(np.searchsorted(series.time_s, [start_s, end_s - 1e-9]), len(series.time_s) - 1)
    rows = slice(ends[0], ends[1] + 1)

    def rises(names: Sequence[str]) -> tuple[float, float]:
        """Return the sum of all increases of the named energies' total over the stride, and its sigma, J/kg."""
        steps = np.diff(np.sum([energy[name][rows] for name in names], axis=0))
        turns = np.diff((steps > 0).astype(int), prepend=0, append=0) != 0
        variance = np.sum([sigma[name][rows][turns] ** 2 for name in names])
        return float(np.maximum(steps, 0).sum()), float(np.sqrt(variance))

    vertical, level = ("potential", "kinetic_up"), ("kinetic_forwards", "kinetic_sideways")
    (high_rise, high_sigma), (level_rise, level_sigma), (total_rise, total_sigma) = map(
        rises, (vertical, level, vertical + level)
    )
    sum_of_rises = max(high_rise + level_rise, 1e-9)
    path_m = np.diff(series.value[ends], axis=0)[0] * [1, 1, 0]
    direction = path_m / max(float(np.linalg.norm(path_m)), 1e-9)
    duration_s, work = end_s - start_s, np.diff(energy["total"][ends] - energy["internal"][ends])[0]
    work_sigma = np.sqrt(np.sum(sigma["total"][ends] ** 2 - sigma["internal"][ends] ** 2))
    speed_gain = np.diff(series.rate[ends] @ direction)[0]
    speed_gain_sigma = np.linalg.norm(series.rate_sigma[ends] * direction)
    exchange_sigma = np.hypot(total_sigma, total_rise / sum_of_rises * np.hypot(high_sigma, level_sigma)) / sum_of_rises
    changes = {
        "net_work": (work, work_sigma),
        "net_power": (work / duration_s, work_sigma / duration_s),
        "net_acceleration": (speed_gain / duration_s, speed_gain_sigma / duration_s),
        "exchange": (1 - total_rise / sum_of_rises, exchange_sigma),
    }
    intervals = {name: interval_of(*map(float, names)) for name, names in changes.items()}
    exchange, low, upper = intervals["exchange"]
    return intervals | {"exchange": (exchange, max(low, 0.0), min(upper, 1.0))}
