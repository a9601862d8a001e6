"""Measure inverse kinematics: time of a step, success rates, iterations and closures, and strides of real runs.

    python benchmarks/parts/ik.py [FOLDER] [--only steps targets alphas circle costs strides fits held-out online]

The chains are the joints of `cheetah-8u`'s spine and front leg in their level base frame, and of `cheetah-24`'s left
front leg. The script runs on one core, after a first run that is not timed. Tables are in Markdown, as in docs/ik.md.
The last four parts need real runs: each is a folder with truth.csv and meta.json (fps), by default the runs in
cheetah-runs of $RECON_SHARED_DATA, or of ../shared/data.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time

import numpy as np
from arguments import parser_of
from markdown_table import print_header, print_row, print_table
from scipy.interpolate import CubicSpline

from recon import Pose3D, read_pose3d
from recon.animal.chain import load_chain
from recon.animal.skeleton_file import load_skeleton
from recon.fit.points import solve_points
from recon.gait.gait import pose_gait
from recon.ik.animal_chain import body_chain, body_chain_angles, chain_angles, projected_chain, spine_front_leg
from recon.ik.chain import SerialChain
from recon.ik.cost_study import CHAOTIC_GROWTH, CLOSED_RAD, NEAR_RAD
from recon.ik.costs import Cost, harmonic_map, joint_differences, pose_distance, rotational_energy
from recon.ik.drive import degree_of_closure, drive_to, follow
from recon.ik.limb import REFIT_FRAMES, Limb, fit_parameter_series, follow_stride, stride_duration_range_s
from recon.ik.methods import (
    ExtendedJacobian,
    GradientProjection,
    JacobianTranspose,
    LeastNorm,
    Method,
    SelectivelyDamped,
    best_scale,
    damped_least_squares,
    weighted_least_norm,
)
from recon.ik.null_space import to_null_space_optimum
from recon.ik.parameters import Fit, Frames, explained_by, fits, rates_of
from recon.ik.stride import StridePath, find_stride

Array = np.ndarray

ALPHAS = (0.1, 0.3, 0.5, 0.8, 1.0, 1.3, 1.6, 1.9, 2.1, 2.3)
ALPHA_TASKS = 10
TASKS, SEED = 50, 0
STEPS, WARM = 1500, 200
TURNS, POINTS, RADIUS_M = 10, 400, 0.1
SLOWER = 10
"""Factor by which strides are slowed down, so that rate limits do not delay the methods."""
SIDES = ("left", "right")
PUBLISHED = {
    "gradient projection (differences)": "264, ended 11 mm away",
    "weighted (lengths)": "6,100",
    "damped (0.05 m)": "765",
    "extended Jacobian (energy)": "587, ended 32.7 mm away",
}
"""Published number of iterations to a target; the publication states neither the target nor the cost."""


HARMONIC = "harmonic map"
COSTS: dict[str, Callable[[SerialChain], Cost]] = {
    "joint differences": joint_differences,
    "rotational energy": rotational_energy,
    "distance from the middle pose": lambda chain: pose_distance(np.zeros(chain.n)),
    HARMONIC: lambda chain: harmonic_map(),
}


def joined(parts: list[Frames]) -> Frames:
    """Join the frames of several chains of one kind."""
    arrays = (np.concatenate([getattr(part, of) for part in parts]) for of in ("q", "jacobian", "dx", "dq"))
    return Frames(*arrays, names=parts[0].names)


def chains(limited: bool) -> dict[str, SerialChain]:
    skeleton, body = load_chain("cheetah-8u"), load_skeleton("cheetah-24")
    return {
        "2D, 5 joints": spine_front_leg(skeleton, dim=2, limited=limited),
        "3D, 10 joints": spine_front_leg(skeleton, limited=limited),
        "whole animal, 9 joints": body_chain(body, "l_front_paw", limited=limited),
    }


def methods(chain: SerialChain) -> dict[str, Method]:
    differences, energy = joint_differences(chain), rotational_energy(chain)
    every: dict[str, Method] = {
        "least norm": LeastNorm(),
        "Jacobian transpose": JacobianTranspose(),
        "gradient projection (differences)": GradientProjection(differences),
        "weighted (lengths)": weighted_least_norm(chain.joint_lengths_m),
        "damped (0.05 m)": damped_least_squares(),
        "selectively damped": SelectivelyDamped(),
        "extended Jacobian (differences)": ExtendedJacobian(differences),
        "extended Jacobian (energy)": ExtendedJacobian(energy),
        "extended Jacobian (energy), N constant": ExtendedJacobian(energy, full=False),
    }
    if chain.base.shape == (2, 3) or len(chain.groups) == 2:  # the 8U chain, which has the joints of the map
        every["extended Jacobian (harmonic map)"] = ExtendedJacobian(harmonic_map())
    return every


def step_times_s(chain: SerialChain) -> dict[str, float]:
    """Measure the processor time of a step of each method at random configurations within the limits, seconds.

    The methods take turns, and the time is the tenth percentile, because other programs on the machine can only
    make steps slower.
    """
    rng, every = np.random.default_rng(SEED), methods(chain)
    q = rng.uniform(chain.lower_rad, chain.upper_rad, (STEPS, chain.n))
    dx = rng.normal(size=(STEPS, chain.dim))
    times = np.empty((STEPS, len(every)))
    for k in range(STEPS):
        for i, method in enumerate(every.values()):
            at = (k + 100 * i) % STEPS  # vary q, because the chain caches its last configuration
            start = time.thread_time()
            method.rates(chain, q[at], dx[at])
            times[k, i] = time.thread_time() - start
    return dict(zip(every, np.quantile(times[WARM:], 0.1, axis=0).tolist(), strict=True))


def print_steps() -> None:
    """Print the processor time of each method relative to least norm, which hardly depends on the machine."""
    print("Processor time of a step, relative to least norm:\n")
    every, columns = chains(True), []
    for chain in every.values():
        times = step_times_s(chain)
        columns.append({name: f"{step / times['least norm']:.1f}" for name, step in times.items()})
    rows = [[name, *(column.get(name, "") for column in columns)] for name in columns[0]]
    print_table(["method", *every], rows)


def tasks(chain: SerialChain) -> list[tuple[Array, Array]]:
    """Draw start angles (n,), rad, and targets (dim,), m, from random poses within the limits."""
    starts, ends = np.random.default_rng(SEED).uniform(chain.lower_rad, chain.upper_rad, (2, TASKS, chain.n))
    return [(q, chain.end(end)) for q, end in zip(starts, ends, strict=True)]


def print_targets() -> None:
    for (title, free), limited in zip(chains(False).items(), chains(True).values(), strict=True):
        print(f"\n{title}, {TASKS} targets, seed {SEED}:\n")
        rows = []
        for name, method in methods(free).items():
            drives = [drive_to(free, q, x, method) for q, x in tasks(limited)]
            within = [drive_to(limited, q, x, method).reached for q, x in tasks(limited)]
            done = [d for d in drives if d.reached]
            steps = [d.iterations for d in done]
            rows.append(
                [
                    *(name, f"{100 * len(done) / TASKS:.0f} %", f"{np.median(steps):.0f} ({max(steps)})"),
                    *([PUBLISHED.get(name, "")] if free.dim == 2 else []),
                    *(f"{np.mean([d.length_m for d in done]):.3f}",),
                    *(f"{np.median([d.roughness_rad2 for d in done]):.1e}", f"{100 * np.mean(within):.0f} %"),
                ]
            )
        context = ["published, another target"] if free.dim == 2 else []
        measures = ["path, m", "roughness, rad2", "reached within limits"]
        print_table(["method", "reached", "iterations, median (max)", *context, *measures], rows)


def print_alphas() -> None:
    """Print the iterations of every method for factors on its rates, from too short steps to overshooting steps."""
    chain = next(iter(chains(False).values()))
    some = tasks(next(iter(chains(True).values())))[:ALPHA_TASKS]
    print(f"\nIterations to {ALPHA_TASKS} targets in the plane by alpha, median; in brackets how many were reached:\n")
    print_header(["method", *(f"{alpha:g}" for alpha in ALPHAS)])
    for name, method in methods(chain).items():
        cells = []
        for alpha in ALPHAS:
            drives = [drive_to(chain, q, x, replace(method, alpha=alpha)) for q, x in some]
            steps = [drive.iterations for drive in drives if drive.reached]
            all_of_them = len(steps) == len(drives)
            cells.append((f"{np.median(steps):.0f}" if steps else "") + ("" if all_of_them else f" ({len(steps)})"))
        print_row([name, *cells])
    print(flush=True)


def start_of(chain: SerialChain, q: Array, method: Method) -> Array:
    """Move along the null space to the optimum of the method's cost, or of the energy without a cost."""
    cost = method.cost if isinstance(method, ExtendedJacobian) else rotational_energy(chain)
    return to_null_space_optimum(chain, q, cost)[0]


def circle_closure(chain: SerialChain, q: Array, name: str) -> str:
    """Follow a circle, and return the smallest degree of closure of any joint as a string.

    The string has the closure of the angle and the closure in the plane of angle and rate.

    `q` are the joint angles at the start, and `name` is the method's name.
    """
    method = methods(chain).get(name)
    if method is None:
        return ""
    q = start_of(chain, q, method)
    run = follow(chain, q, circle(chain, q), method, turns=TURNS)
    closures = run.closures()
    singular = ", singular on the way" if run.singular.any() else ""
    return f"{np.nanmin(closures['angle']):.2f} / {np.nanmin(closures['plane']):.2f}{singular}"


def circle(chain: SerialChain, q: Array) -> Array:
    """Return a closed circle (POINTS + 1, dim), metres, that begins at the end effector's position at q."""
    angle, start = np.linspace(0, 2 * np.pi, POINTS + 1), chain.end(q)
    u, v = np.array([1.0, 0.0, 0.0])[: chain.dim], np.array([0.0, 0.8, 0.6])[: chain.dim]
    path = start + RADIUS_M * ((np.cos(angle) - 1)[:, None] * u + np.sin(angle)[:, None] * v)
    path[-1] = path[0]
    return path


def cost_verdict(chain: SerialChain, q: Array, cost: Cost) -> str:
    """Classify the motion of the extended Jacobian with a cost on the circle, starting at the cost's optimum.

    The motion is "convergent" if the angles after every turn equal the angles before it; "singular" if the extended
    Jacobian became singular on the way; "chaotic" if a start that differs by `NEAR_RAD` ends `CHAOTIC_GROWTH` times as
    far away; otherwise "drifting". The returned string also states how many joints reached a limit.
    """
    method = ExtendedJacobian(cost)
    q = to_null_space_optimum(chain, q, cost)[0]
    path = circle(chain, q)
    run = follow(chain, q, path, method, turns=TURNS)
    held = f", {len(run.limits)} joints at limits" if run.limits else ""
    if np.nanmax(np.abs(run.q[:: len(path) - 1] - run.q[0])) < CLOSED_RAD:
        return f"convergent{held}"
    if run.singular.any():
        return f"singular{held}"
    near = follow(chain, q + NEAR_RAD, path, method, turns=TURNS)
    apart = np.nanmax(np.abs(near.q[-1] - run.q[-1]))
    return f"{'chaotic' if apart > CHAOTIC_GROWTH * NEAR_RAD else 'drifting'}{held}"


def print_costs() -> None:
    print(f"\nThe extended Jacobian by cost, {TURNS} turns on a circle of {RADIUS_M} m:\n")
    rows = []
    for name, cost_of in COSTS.items():
        cells = [name]
        for (title, free), limited in zip(chains(False).items(), chains(True).values(), strict=True):
            q = (limited.lower_rad + limited.upper_rad) / 2
            if title.startswith("3D"):
                q[5:] = [0.1, 0.15, -0.1, 0.2, 0.15]
            cells += [
                cost_verdict(chain, q, cost_of(chain)) if name != HARMONIC or title[0] in "23" else ""
                for chain in (free, limited)
            ]
        rows.append(cells)
    heads = [f"{title}, {limits}" for title in chains(False) for limits in ("free", "limits")]
    print_table(["cost", *heads], rows)


def print_circle() -> None:
    print(f"\nLeast closure of any joint after {TURNS} turns on a circle of {RADIUS_M} m, percent, angle / plane:\n")
    every, bounds = chains(False), chains(True).values()
    middles = [(chain.lower_rad + chain.upper_rad) / 2 for chain in bounds]
    middles[1][5:] = [0.1, 0.15, -0.1, 0.2, 0.15]
    rows = []
    for name in methods(next(iter(every.values()))):
        starts = zip(every.values(), middles, strict=True)
        rows.append([name, *(circle_closure(chain, q, name) for chain, q in starts)])
    print_table(["method", *every], rows)


@dataclass(frozen=True, eq=False)
class Leg:
    """Front leg of a run, with a chain of the animal's size, joint angles (T, n) in rad, and the frame rate."""

    name: str
    chain: SerialChain
    q: Array
    fps: float
    duration_range_s: tuple[float, float]

    def online(self, stride: StridePath) -> dict[str, list[Method]]:
        """Refit the parameters of each method at every frame of a stride."""
        limb = Limb("", self.chain, self.q, self.fps, first_s=0.0, base="UVW", base_at="", misfit_m=0.0)
        return fit_parameter_series(limb, stride, None, REFIT_FRAMES)[1]


@cache
def real_legs(folder: Path) -> dict[str, list[Leg]]:
    """Load the legs of all runs for the chains "2D" (in the plane of travel), "3D" and "whole animal"."""
    skeleton, body = load_chain("cheetah-8u"), load_skeleton("cheetah-24")
    legs: dict[str, list[Leg]] = {"2D": [], "3D": [], "whole animal": []}
    for meta in sorted(folder.glob("*/meta.json")):
        fps = json.loads(meta.read_text(encoding="utf-8"))["fps"]
        pose = read_pose3d(meta.parent / "truth.csv")

        def points(names: Sequence[str], pose: Pose3D = pose) -> Array:
            return pose.xyz_m[:, [pose.names.index(name) for name in names]]

        root, duration_range_s = points(["tail_base"])[:, 0], stride_duration_range_s(pose_gait(pose, fps))
        body_states, _, size = solve_points(body, points(body.markers), None)
        for side in SIDES:
            name = f"{meta.parent.name}, {side}"
            leg = ("tail_base", "spine", "neck_base", *(f"{side[0]}_front_{part}" for part in ("knee", "ankle", "paw")))
            known = np.isfinite(root[:, 0])
            flat, q, _ = projected_chain(points(leg), root[known][-1] - root[known][0])
            legs["2D"].append(Leg(name, flat, q, fps, duration_range_s))
            states, _, factor = solve_points(skeleton.body, points(skeleton.body.keypoint_names(side)), None)
            summed = spine_front_leg(skeleton, factor * skeleton.nominal_base_length_m, 3, limited=False)
            legs["3D"].append(Leg(name, summed, chain_angles(skeleton, states), fps, duration_range_s))
            whole = body_chain(body, leg[-1], size, limited=False)
            q = body_chain_angles(body, leg[-1], body_states)
            legs["whole animal"].append(Leg(name, whole, q, fps, duration_range_s))
    return legs


def stride_cell(stride: StridePath) -> str:
    whole = " (whole clip)" if stride.origin == "whole clip" else ""
    return f"{1000 * (stride.end_s - stride.start_s):.0f} ms, {stride.gap_percent:.0f} %{whole}"


def animal_closures(stride: StridePath, fps: float) -> dict[str, np.ndarray]:
    """Return the degrees of closure of the animal's own joints over a stride, in percent."""
    q = stride.q[np.isfinite(stride.q).all(axis=1)]
    paths = np.stack([q, np.gradient(q, 1 / fps, axis=0)], axis=2).transpose(1, 0, 2)
    return {
        "angle": np.array([degree_of_closure(path[:, 0]) for path in paths]),
        "plane": np.array([degree_of_closure(path) for path in paths]),
    }


def print_strides(folder: Path) -> None:
    legs_of = real_legs(folder)
    found = {
        kind: [find_stride(leg.chain, leg.q, leg.fps, duration_range_s=leg.duration_range_s) for leg in legs]
        for kind, legs in legs_of.items()
    }
    print("\nStrides of the end effector, and the gap that was closed, in percent of the path's diameter:\n")
    cells = [[stride_cell(s) for s in strides] for strides in found.values()]
    print_table(["run, side", *found], [[leg.name, *row] for leg, *row in zip(legs_of["2D"], *cells, strict=True)])
    for kind, legs in legs_of.items():
        strides = found[kind]
        n = legs[0].chain.n
        animal = [animal_closures(s, leg.fps) for leg, s in zip(legs, strides, strict=True)]
        rows = [closure_row("the animal", animal, 0.0, 0)]
        for name in methods(legs[0].chain):
            runs = []
            for leg, stride in zip(legs, strides, strict=True):
                method, q = methods(leg.chain)[name], stride.q[0]
                # The extended Jacobian keeps G = 0, but the animal's own pose does not.
                q = start_of(leg.chain, q, method) if isinstance(method, ExtendedJacobian) else q
                runs.append(follow(leg.chain, q, stride.path_m, method, interval_s=SLOWER * stride.interval_s))
            off = float(np.median([run.distance_m.max() for run in runs]))
            rows.append(closure_row(name, [r.closures() for r in runs], off, sum(r.singular.any() for r in runs)))
        print(f"\n{kind}, median closure in the (angle, rate) plane over {len(legs)} strides, percent:\n")
        joints = [f"{angle} {k}" for angle in ("theta", "phi") for k in (9, 1, 2, 3, 4)][:n]
        if kind == "whole animal":
            joints = [f"{angle} {part}" for part in ("rear", "front") for angle in ("yaw", "pitch", "roll")]
            joints += [f"pitch {part}" for part in ("upper", "lower", "foot")]
        print_table(["method", *joints, "least", "angle alone", "off the path, mm", "singular strides"], rows)


def closure_row(name: str, closures: list[dict[str, np.ndarray]], off_m: float, singular: int) -> list[str]:
    plane, angle = np.array([c["plane"] for c in closures]), np.array([c["angle"] for c in closures])
    cells = [*np.nanmedian(plane, axis=0), np.nanmin(plane), np.nanmedian(angle)]
    return [name, *(f"{v:.0f}" for v in cells), f"{1000 * off_m:.1f}", str(singular)]


def frames_of(leg: Leg, span_s: tuple[float, float] = (-np.inf, np.inf)) -> Frames:
    """Return the known frames in a time span, with rates from a spline through all known frames."""
    known = np.isfinite(leg.q).all(axis=1)
    q, time_s = leg.q[known], np.flatnonzero(known) / leg.fps
    dq = CubicSpline(time_s, q).derivative()(time_s)
    within = (time_s >= span_s[0] - 1e-6) & (time_s <= span_s[1] + 1e-6)
    q, dq = q[within], dq[within]
    return Frames.without_gaps(
        leg.chain, q, np.array([leg.chain.jacobian(x) @ v for x, v in zip(q, dq, strict=True)]), dq
    )


def print_fits(folder: Path) -> None:
    """Print the parameters fitted to the joint rates of real legs.

    The 8U chain in 3D is left out, because its phi and rates jump at upright links.
    """
    for kind in ("2D", "whole animal"):
        legs = real_legs(folder)[kind]
        data = [frames_of(leg) for leg in legs]
        print(f"\n{kind}, parameters of {len(data)} legs' joint rates, medians:\n")
        rows = []
        for name, fit_of, unit in FITS:
            found = [fit_of(leg.chain)(frames) for leg, frames in zip(legs, data, strict=True)]
            values = np.median([f.parameter for f in found], axis=0)
            explained = [100 * f.explained for f in found]
            rows.append(
                [
                    *(name, ", ".join(f"{v:.2g}" for v in values) + unit),
                    f"{np.median(explained):.0f} ({min(explained):.0f} to {max(explained):.0f})",
                    str(sum(bool(f.note) for f in found)),
                ]
            )
        print_table(["method", "parameter", "explained, percent (range)", "legs at an edge"], rows)


FITS: tuple[tuple[str, Callable[[SerialChain], Fit], str], ...] = (
    ("least norm", lambda _: fits()["least-norm"], ""),
    ("Jacobian transpose, alpha", lambda _: fits()["transpose"], " 1/m2"),
    ("gradient projection, constant g", lambda _: fits()["gradient-projection"], ""),
    (
        "gradient projection, differences and energy",
        lambda chain: fits((joint_differences(chain), rotational_energy(chain)))["gradient-projection"],
        "",
    ),
    ("weighted, diag W", lambda _: fits()["weighted"], ""),
    ("damped, lambda", lambda _: fits()["damped"], " m"),
    ("selectively damped, gamma_max", lambda _: fits()["selectively-damped"], " rad"),
)


@dataclass(frozen=True, eq=False)
class StrideData:
    """Leg of a run with one stride, and the frames of the stride with known angles."""

    leg: Leg
    stride: StridePath
    frames: Frames

    @classmethod
    def from_leg(cls, leg: Leg) -> StrideData:
        stride = find_stride(leg.chain, leg.q, leg.fps, duration_range_s=leg.duration_range_s)
        return cls(leg, stride, frames_of(leg, (stride.start_s, stride.end_s)))

    @property
    def run(self) -> str:
        return self.leg.name.split(",")[0]

    def off_deg(self, method: Method, each: Sequence[Method] = ()) -> float:
        """Follow the stride by a method, and return the RMS deviation of the joints from the animal's, degrees.

        `each` gives a method for each frame instead. The start is the animal's own pose; the extended Jacobian starts
        at an optimum of its cost.
        """
        run = follow_stride(self.leg.chain, self.stride, method, by_frame=each)
        every = round(1 / (self.leg.fps * self.stride.interval_s))
        off = run.q[::every][: len(self.stride.q)] - self.stride.q
        return float(np.degrees(np.sqrt(np.nanmean(off**2))))


def rates_by(method: Method, stride_data: StrideData) -> Array:
    """Return the joint rates (T, n) in rad/s that a method without limits computes for a stride."""
    chain = copy(stride_data.leg.chain)
    object.__setattr__(chain, "max_rate_rad_s", np.full(chain.n, 1e9))
    return np.array(
        [method.rates(chain, q, dx).dq for q, dx in zip(stride_data.frames.q, stride_data.frames.dx, strict=True)]
    )


def unfitted(stride_data: StrideData, others: Sequence[StrideData]) -> dict[str, Method]:
    """Return the methods without a fitted parameter; their reference pose is the mean pose of the other runs."""
    chain = stride_data.leg.chain
    pose = np.mean([one.frames.q.mean(axis=0) for one in others], axis=0)
    every = {name: method for name, method in methods(chain).items() if name.startswith(("extended", "weighted"))}
    return {**every, "extended Jacobian (pose)": ExtendedJacobian(pose_distance(pose))}


def print_held_out(folder: Path) -> None:
    """Print the errors of the methods on each stride, with parameters fitted to the strides of all other runs."""
    for kind in ("2D", "whole animal"):
        data = [StrideData.from_leg(leg) for leg in real_legs(folder)[kind]]
        others = [[one for one in data if one.run != stride_data.run] for stride_data in data]
        print(f"\n{kind}, {len(data)} strides, parameters from the other runs:\n")
        rows = []
        for name, fit_of, unit in FITS:
            fits = [fit_of(s.leg.chain)(joined([o.frames for o in of])) for s, of in zip(data, others, strict=True)]
            own = [fit_of(s.leg.chain)(s.frames).explained for s in data]
            rates = [rates_of(fit.method, s.frames) for fit, s in zip(fits, data, strict=True)]
            value = ", ".join(f"{v:.2g}" for v in np.median([fit.parameter for fit in fits], axis=0)) + unit
            scales = [fit.alpha for fit in fits]
            rows.append(held_out_row(name, value, own, rates, scales, data, [fit.method for fit in fits]))
        every = [unfitted(stride_data, of) for stride_data, of in zip(data, others, strict=True)]
        for name in every[0]:
            chosen = [of[name] for of in every]
            rates = [rates_by(method, s) for method, s in zip(chosen, data, strict=True)]
            scales = [
                best_scale(
                    np.concatenate([r for r, o in zip(rates, data, strict=True) if o.run != s.run]),
                    np.concatenate([o.frames.dq for o in data if o.run != s.run]),
                )
                for s in data
            ]
            rows.append(held_out_row(name, "", [], rates, scales, data, chosen))
        columns = ["method", "parameter, median", "own stride, %", "held out, % (range)", "alpha", "with alpha, %"]
        print_table([*columns, "joint error, deg"], rows)


def print_online(folder: Path) -> None:
    """Compare parameters from the strides of all other runs with parameters refitted at every frame.

    The refit uses the animal's joint rates just before the frame, as `recon ik --online` does. The table shows the
    explained fraction of a frame's squared rates, and the deviation of the joints after following the stride.
    """
    data = [StrideData.from_leg(leg) for leg in real_legs(folder)["2D"]]
    print(f"\n2D, {len(data)} strides, median: explained of the joint rates, percent, and joint error, deg:\n")
    online = [s.leg.online(s.stride) for s in data]
    rows = []
    for name, fit in fits().items():
        cells = []
        for s, each in zip(data, online, strict=True):
            kept, own = fit(joined([o.frames for o in data if o.run != s.run])).method, each[name]
            rates = [rates_of(method, s.frames[t : t + 1])[0] for t, method in enumerate(own)]
            explained = explained_by(rates_of(kept, s.frames), s.frames.dq), explained_by(np.array(rates), s.frames.dq)
            cells.append([100 * fraction for fraction in explained] + [s.off_deg(kept), s.off_deg(kept, own)])
        rows.append([name, *(f"{v:.0f}" for v in np.median(cells, axis=0))])
    where = ("from the other runs", f"from the {REFIT_FRAMES} frames before")
    print_table(["method", *(f"{what}, {how}" for what in ("explained", "joint error") for how in where)], rows)


def held_out_row(
    name: str,
    value: str,
    own: list[float],
    rates: list[Array],
    scales: list[float],
    data: list[StrideData],
    chosen: list[Method],
) -> list[str]:
    explained = [100 * explained_by(r, s.frames.dq) for r, s in zip(rates, data, strict=True)]
    scaled = [100 * explained_by(a * r, s.frames.dq) for a, r, s in zip(scales, rates, data, strict=True)]
    off = [s.off_deg(method) for s, method in zip(data, chosen, strict=True)]
    return [
        *(name, value, f"{100 * np.median(own):.0f}" if own else ""),
        f"{np.median(explained):.0f} ({min(explained):.0f} to {max(explained):.0f})",
        *(f"{np.median(scales):.2f}", f"{np.median(scaled):.0f}", f"{np.median(off):.0f}"),
    ]


def main() -> None:
    tables = {"steps": print_steps, "targets": print_targets, "alphas": print_alphas, "circle": print_circle}
    tables |= {"costs": print_costs}
    real = {"strides": print_strides, "fits": print_fits, "held-out": print_held_out, "online": print_online}
    parser = parser_of(__doc__, kind="cheetah-runs", only=[*tables, *real])
    arguments = parser.parse_args()
    for name, table in tables.items():
        if name in arguments.only:
            table()
    if not any(arguments.folder.glob("*/meta.json")):
        parser.exit(message=f"no runs in {arguments.folder}: no real strides\n")
    for name, table in real.items():
        if name in arguments.only:
            table(arguments.folder)


if __name__ == "__main__":
    main()
