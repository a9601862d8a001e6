"""Compare the feet's vertical forces with force plates, and the motion of the centre of mass with gravity.

    python benchmarks/parts/dynamics.py

The plate-trials of $RECON_SHARED_DATA, or of ../shared/data, are fitted from single views and from both cameras. To
find the sources of the error, one quantity after the other is taken from the plates. The dog-mocap, seen by one camera
from the side, is compared with the markers in speed, net acceleration and flights (against gravity). The mean force of
all feet over complete strides must be one body weight. The simulated gallop of the samples has stances and a stride, so
its mean force is also known.

A gallop and a trot are simulated from given forces (`recon.testing.steady_gait`) and have exact poses. There are three
variants: the paws leave the ground and land as fast as the paws over the plates; they leave and land at rest; or the
force of a stance is half a sine. The same two gaits, seen by one camera from the side and fitted from noisy detections,
test the intervals for feet whose parts of the impulse vary as the model states. These gaits provide far more stances
than the plates.
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from arguments import runs_of
from dog import Clip, read_clips, write_view
from markdown_table import percent, print_table
from recordings import fit_settings, meta_of, recordings

import recon.gait.dynamics as method
from recon import FitSettings, Motion, fit_clip, load_skeleton, samples_folder
from recon.fit.regions import radius
from recon.gait.clip import ClipAnalysis, analyse
from recon.gait.dynamics import G_M_S2, MEAN_OF_PEAK, OFF_GRAVITY, off_gravity, shape
from recon.gait.kinematics import net_acceleration, point_kinematics
from recon.gait.series import OVERSAMPLING
from recon.gait.stances import FEET, INTERVAL
from recon.testing.steady_gait import GALLOP, TROT, SteadyGait, compare_forces, with_exact_states


def trials() -> list[Path]:
    return sorted(path.parent for path in recordings("plate-trials").glob("*/forces.csv"))


def measured(run: Path) -> tuple[pd.DataFrame, dict[str, np.ndarray]]:
    """Read the measured forces of each frame, and the frames of touch-down and lift-off of each foot."""
    stances = pd.read_csv(run / "stances.csv")
    ends = stances[["touch_down_frame", "lift_off_frame"]].to_numpy(float)
    return pd.read_csv(run / "forces.csv", index_col=0), dict(zip(stances["joint"], ends, strict=True))


def against_plates(run: Path, found: ClipAnalysis, fps: float) -> list[dict[str, float]]:
    """Compare the force of each stance with the force plate, and return a row of errors for each stance."""
    force, stance = measured(run)
    d, rows, impulses = found.dynamics, [], force.sum() / fps
    if d is None or found.gait is None:
        return []
    start_s, (starts, ends, drawn) = found.motion.frames[0] / fps, method._draw(found.gait)
    for foot, joint in FEET.items():
        down, up = stance[joint]
        at_s = np.arange(down, up + 1) / fps
        plate = force[joint].reindex(range(int(down), int(up) + 1), fill_value=0.0).to_numpy()
        time_s = found.gait.tracks.time_s
        force_bw = np.stack([np.interp(at_s, time_s, d.force[foot][:, k], left=np.nan, right=np.nan) for k in range(3)])
        near = d.forces[(d.forces["foot"] == foot) & ((d.forces["start_s"] - down / fps).abs() < 0.1)]
        if near.empty or not np.isfinite(force_bw).all() or at_s[0] < start_s:
            continue
        one, impulse = near.iloc[0], plate.sum() / fps

        def off(start_s, end_s, impulse, at_s: np.ndarray = at_s, plate=plate) -> float:
            """Return the RMS error of the mean force, body weights, for stances with given times and impulses."""
            begins_s, lasts = start_s[1:, None], (end_s - start_s)[1:, None]
            force = impulse[1:, None] / (MEAN_OF_PEAK * lasts) * shape((at_s - begins_s) / lasts)
            return float(np.sqrt(np.mean((force.mean(axis=0) - plate) ** 2)))

        i = next(i for i, s in enumerate(found.gait.stances) if (s.foot, s.start_s) == (foot, one["start_s"]))
        said, known = (starts[:, i], ends[:, i]), np.ones((len(starts), 1)) * [(down - 0.5) / fps, (up - 0.5) / fps]
        level = drawn[:, i] * impulses.sum() / found.gait.stride_s
        right = np.full(len(starts), impulse)
        rows.append(
            {
                "rms": float(np.sqrt(np.mean((force_bw[0] - plate) ** 2))),
                "inside": float(np.mean((force_bw[1] - 1e-9 <= plate) & (plate <= force_bw[2] + 1e-9))),
                "peak": one["peak_bw"] / plate.max() - 1,
                "peak inside": float(one["peak_low_bw"] <= plate.max() <= one["peak_high_bw"]),
                "impulse inside": float(one["impulse_low_bw_s"] <= impulse <= one["impulse_high_bw_s"]),
                "times": off(known[:, 0], known[:, 1], drawn[:, i]),
                "sum of the feet": off(*said, level),
                "each foot's impulse": off(*said, right),
                "times and impulses": off(known[:, 0], known[:, 1], right),
            }
        )
    return rows


HELD = ("force", "peak", "impulse")
CARRIED = "strides, intervals of the mean force that contain 1, mean force"


def stride_forces(found: ClipAnalysis) -> list[tuple[float, float, float]]:
    """Return the mean vertical force of all feet over each complete stride, and the ends of its 90 % interval.

    Only strides of the foot with the most strides count, if all their stances are complete in the clip.
    """
    gait, rows = found.gait, []
    if gait is None or found.dynamics is None or not gait.strides or len(gait.tracks.feet) < 4:
        return []
    starts, ends, impulses = method._draw(gait)
    feet = [stride.foot for stride in gait.strides]
    for stride in gait.strides:
        time_s = np.linspace(stride.start_s, stride.end_s, 200)
        over = [s for s in gait.stances if s.end_s > stride.start_s and s.start_s < stride.end_s]
        cut = any(not (s.begins and s.ends) for s in over)
        if stride.foot != max(feet, key=feet.count) or cut or {s.foot for s in over} != {*gait.tracks.feet}:
            continue
        total = np.zeros(len(starts))
        for i, stance in enumerate(gait.stances):
            if stance in over:
                lasts = (ends - starts)[:, i, None]
                force = (impulses[:, i, None] / (MEAN_OF_PEAK * lasts)) * shape((time_s - starts[:, i, None]) / lasts)
                total += force.mean(axis=1)
        rows.append((float(total[0]), *map(float, np.quantile(total[1:], [(1 - INTERVAL) / 2, (1 + INTERVAL) / 2]))))
    return rows


def force_summary(*found: ClipAnalysis) -> str:
    """Return the number of strides, of intervals that contain one body weight, and the mean force, as a string."""
    rows = np.array([row for one in found for row in stride_forces(one)]).reshape(-1, 3)
    if not len(rows):
        return "none"
    held = int(((rows[:, 1] <= 1) & (rows[:, 2] >= 1)).sum())
    return f"{len(rows)}, {held}, {rows[:, 0].mean():.2f}"


def cheetahs() -> tuple[list[ClipAnalysis], list[float]]:
    """Analyse every run of cheetah-runs from each camera alone, and compare the energies with a fit of all cameras.

    Returns
    -------
    tuple
        The analyses from single cameras, and the fractions of frames in which the 90 % interval from a single camera
        contains the value from all cameras, for the internal energy and each component of the angular momentum.
    """
    found, held = [], []
    for run in runs_of(recordings("cheetah-runs")):
        every = meta_of(run)["cameras"]
        of_run = [analyse(fit_clip(fit_settings(run, cameras))) for cameras in (every, *([one] for one in every))]
        (true, true_sigma), *views = map(turning, of_run)
        off = (((said - true) ** 2 / (sigma**2 + true_sigma**2)).dropna() for said, sigma in views)
        held.append(np.mean([(of < radius(INTERVAL) ** 2).mean() for of in off], axis=0))
        found += of_run[1:]
    return found, np.mean(held, axis=0).tolist()


def turning(found: ClipAnalysis) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return internal energy and angular momentum, a row for each frame, and a table of their standard deviations."""
    d, frames = found.dynamics, found.motion.frames
    assert d is not None
    both = (d.internal_j_kg, d.angular_momentum), (d.internal_sigma_j_kg, d.angular_momentum_sigma)
    said, sigma = (pd.DataFrame(np.column_stack(of)[::OVERSAMPLING], index=frames) for of in both)
    return said, sigma


def independent(off: np.ndarray) -> float:
    """Return the effective number of independent errors among correlated consecutive errors (T,)."""
    off = off - off.mean()
    along = np.correlate(off, off, "full")[len(off) - 1 :] / (off @ off)
    until = int(np.argmax(along < 0)) or len(along)
    return len(off) / (1 + 2 * float(along[1:until].sum()))


def dog_rows(as_stated: bool) -> list[list[str]]:
    """Compare speeds, net accelerations, flights and mean forces of each of the dog's clips with the markers.

    If `as_stated` is true, the animal's size and keypoints deviate as the skeleton states.
    """
    folder, body, rows, reach = recordings("dog-mocap"), load_skeleton("dog-27"), [], radius(INTERVAL)
    with tempfile.TemporaryDirectory() as written:
        for seed, clip in enumerate(read_clips(folder) if folder.is_dir() else ()):
            if as_stated:
                size = 1 + body.size_sigma * np.random.default_rng(100 + seed).standard_normal()
                clip = replace(clip, points_m=size * clip.points_m)
            motion = fit_clip(write_view(clip, Path(written), seed, as_stated=as_stated)[0])
            found = ClipAnalysis(motion)
            true_m = clip.markers(body)[motion.frames][:, body.markers.index(motion.reference)]
            moved, d = found.reference_motion, found.dynamics
            assert d is not None
            signed = moved.speed_m_s - point_kinematics(motion.time_s, true_m).speed_m_s
            off = np.abs(signed)
            (net, sigma), (true_net, _) = found.net_acceleration_m_s2, net_acceleration(motion.time_s, true_m)
            of_flights = np.abs(off_gravity(d.flight_parts))
            rows.append(
                [
                    *(clip.name, f"{np.nanmean(off < reach * moved.speed_sigma_m_s):.0%}, {independent(signed):.0f}"),
                    f"{np.sqrt(np.nanmean(off**2)):.2f}, {np.sqrt(np.nanmean(moved.speed_sigma_m_s**2)):.2f}",
                    f"{net:.2f} ± {reach * sigma:.2f}, {true_net:.2f}",
                    f"{len(of_flights)}, {int((of_flights > OFF_GRAVITY).sum())}",
                    force_summary(found),
                ]
            )
    return rows


def carried_rows(motion: Motion) -> list[list[str]]:
    """Compare the forces of runs with exact poses with the given forces; the runs are as long as `motion`."""
    rows = []
    at_rest = {"lift_off_speed": 0.0, "touch_down_speed": 0.0}
    for name, run, fps in (
        ("gallop", GALLOP, 120.0),
        ("gallop, half a sine", replace(GALLOP, skew=1.0), 120.0),
        ("trot", TROT, 60.0),
        ("trot, half a sine", replace(TROT, skew=1.0), 60.0),
        ("trot, paws that leave and land at rest", replace(TROT, **at_rest), 60.0),
    ):
        found = analyse(with_exact_states(motion, run.states(motion.body, motion.frames / fps), fps))
        off = compare_forces(run, found)
        rows.append(
            [
                *(name, f"{off.centre_m:.0e}", f"{off.kinetic_j_kg:.3f}", f"{off.rms_bw:.2f}"),
                *(f"{off.timed_rms_bw:.2f}", f"{off.inside:.0%}", force_summary(found)),
            ]
        )
    return rows


VIEWS = 5
"""Number of clips of each simulated run."""
SHARES = 200
"""Number of random divisions of the impulse among the feet, drawn for each clip."""


def simulated_row(name: str, run: SteadyGait, fps: float, frames: int, fore: tuple[float, float]) -> list[str]:
    """Fit a simulated gait seen by one camera, and return a table row with the errors of its forces.

    The feet divide the impulse among them as the model states.
    """
    body, rng, rows = load_skeleton("cheetah-24"), np.random.default_rng(0), []
    with tempfile.TemporaryDirectory() as written:
        for seed in range(VIEWS):
            time_s = np.arange(frames) / fps + rng.uniform(0, run.stride_s)
            points_m = body.tree.pose(run.states(body, time_s)).points_m
            clip = Clip(name, body.markers, (), fps, points_m)
            found = analyse(fit_clip(write_view(clip, Path(written), seed, "cheetah-24", "tail_base")[0]))
            d, gait = found.dynamics, found.gait
            assert d is not None
            assert gait is not None
            in_front = np.clip(fore[0] + fore[1] * rng.standard_normal(SHARES), 0.1, 0.9)
            factor = {foot: np.exp(method.FOOT_IMPULSE_SIGMA * rng.standard_normal(SHARES)) for foot in FEET}
            for one in d.forces.to_dict("records"):
                foot, of_pair = one["foot"], [factor[side + one["foot"][1]] for side in "LR"]
                fraction = factor[foot] / sum(of_pair) * (in_front if foot.endswith("F") else 1 - in_front)
                times = one["start_s"], gait.tracks.time_s
                landed, since = ((t + time_s[0]) / run.stride_s - run.landings[foot] for t in times)
                into = (since - round(landed)) / run.duty_factor
                stands = (into > 0) & (into < 1)
                peak, impulse = fraction / (MEAN_OF_PEAK * run.duty_factor), fraction * run.stride_s
                true = peak[:, None] * shape(into[stands])
                said, low, high = d.force[foot][stands].T
                rows.append(
                    (
                        *(np.mean((said - true) ** 2), np.mean((low - 1e-9 <= true) & (true <= high + 1e-9))),
                        np.mean((one["peak_low_bw"] <= peak) & (peak <= one["peak_high_bw"])),
                        np.mean((one["impulse_low_bw_s"] <= impulse) & (impulse <= one["impulse_high_bw_s"])),
                    )
                )
    square, *inside = np.mean(rows, axis=0)
    return [name, str(len(rows)), f"{np.sqrt(square):.2f}", *(f"{fraction:.0%}" for fraction in inside)]


def print_against_plates() -> bool:
    """Print the errors of forces relative to force plates; return whether there are recordings."""
    runs, rows, tables, carried = trials(), [], [], []
    for kind in ("single views", "both cameras"):
        stances: list[dict[str, float]] = []
        for run in runs:
            about = meta_of(run)
            for cameras in [about["cameras"]] if kind == "both cameras" else [[c] for c in about["cameras"]]:
                analysed = analyse(fit_clip(fit_settings(run, cameras)))
                of_clip = against_plates(run, analysed, about["fps"])
                stances += of_clip
                if analysed.gait is not None:
                    carried.append(carried_row(run, cameras, about["fps"], analysed.gait.stride_s, of_clip))
        if stances:
            table = pd.DataFrame(stances)
            tables.append((kind, table))
            rows.append(
                [
                    *(kind, len(table), f"{np.sqrt((table['rms'] ** 2).mean()):.2f}"),
                    f"{table['peak'].median():+.0%}",
                    *(f"{of(table['peak'].abs()):.0%}" for of in (np.median, np.max)),
                    *(f"{table[name].mean():.0%}" for name in ("inside", "peak inside", "impulse inside")),
                ]
            )
    if rows:
        head = ["of", "stances", "RMS, body weights", "peak: median", "absolute", "largest"]
        print_table([*head, *(f"{of} in 90 %" for of in HELD)], rows)
        print("\nRMS if the plates give the following:\n")
        parts = ["times", "sum of the feet", "each foot's impulse", "times and impulses"]
        print_table(
            ["of", *parts], [[kind, *(f"{np.sqrt((t[x] ** 2).mean()):.2f}" for x in parts)] for kind, t in tables]
        )
        print("\nBy clip, with the mean of the plates' forces over its stride, in body weights:\n")
        print_table(["trial", "cameras", "body weights", "RMS"], carried)
    return bool(rows)


def carried_row(
    run: Path, cameras: Sequence[int], fps: float, stride_s: float, stances: Sequence[dict[str, float]]
) -> list[str]:
    """Return a clip's table row with the plates' mean force over a stride and the RMS error of its stances."""
    impulse_bw_s = measured(run)[0].to_numpy().sum() / fps
    rms = np.sqrt(np.mean([row["rms"] ** 2 for row in stances]))
    return [run.name, "+".join(map(str, cameras)), f"{impulse_bw_s / stride_s:.2f}", f"{rms:.2f}"]


def print_dogs_and_cheetahs() -> None:
    """Print how well the forces of dogs and cheetahs support the body's weight."""
    for how, as_stated in (
        ("with its own size and keypoints", False),
        ("with errors of both as the skeleton states", True),
    ):
        if dogs := dog_rows(as_stated):
            head = [
                "clip",
                "speed in 90 %, independent errors",
                "error, stated, m/s",
                "net acceleration ± 90 %, true, m/s²",
            ]
            print(f"\nA dog by one camera, {how}:\n")
            print_table([*head, "flights, against gravity", CARRIED], dogs)
    views, shares = cheetahs()
    if views:
        print(f"\nCheetahs, views of the cheetah-runs: {CARRIED}: {force_summary(*views)}")
        energy, *momentum = map(percent, shares)
        print(f"in 90 % of a view, by all cameras: internal energy {energy}, angular momentum {' '.join(momentum)}")


def print_simulated() -> None:
    """Print the errors of forces in simulated runs and in the sample."""
    samples = samples_folder()
    motion = fit_clip(FitSettings(keypoints=(samples / "whole.csv",), camera=(samples / "camera.toml",), fps=60))
    print("\nExact poses of runs that are simulated from given forces:\n")
    head = ["run", "error of centre of mass, m", "error of kinetic energy, J/kg", "forces, RMS, body weights"]
    print_table([*head, "with the true times", "force in 90 %", CARRIED], carried_rows(motion))
    print("\nThe same seen by one camera, with feet that divide the impulse as stated:\n")
    simulated = [
        simulated_row("gallop", GALLOP, 120.0, 72, method.GALLOP_FORE),
        simulated_row("trot", TROT, 60.0, 60, method.OTHER_FORE),
    ]
    print_table(["run", "stances", "RMS, body weights", *(f"{of} in 90 %" for of in HELD)], simulated)
    sample = analyse(motion)
    assert sample.dynamics is not None
    assert sample.gait is not None
    forces, flights = sample.dynamics.forces, sample.dynamics.flights[["up_m_s2", "sigma_m_s2"]].to_numpy()
    impulse = forces["impulse_bw_s"].mean() * len(sample.dynamics.force) / sample.gait.stride_s
    against_gravity = ", ".join(f"{up + G_M_S2:+.0f} ± {sigma:.0f} m/s²" for up, sigma in flights) or "none"
    print(
        f"\nThe sample: mean vertical force over a stride {impulse:.2f} body weights; "
        f"flights against gravity: {against_gravity}"
    )


def main() -> None:
    has_recordings = print_against_plates()
    print_dogs_and_cheetahs()
    if not has_recordings:
        print("no recordings: forces not measured")
    print_simulated()


if __name__ == "__main__":
    main()
