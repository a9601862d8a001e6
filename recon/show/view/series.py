"""Quantities over time: what the playback's plots show."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import rerun as rr

from recon.animal import side_of, without_side
from recon.base.arrays import Array, Bools
from recon.fit.motion import Motion
from recon.gait.clip import ClipAnalysis
from recon.gait.kinematics import frame_jitter_m, speed_at_frames
from recon.show.view import scene

MAX_LINES = 4
"""How many angles one plot has at most, as far as they can be told apart by what they belong to: their names stand
above them."""


def states(motion: Motion, stands: Bools) -> dict[str, tuple[str, scene.Colour, Bools]]:
    """By entity: which frames have a flag, a row for each, and when the feet stand, (T, F). An entity has no parent,
    whose name the viewer would write beside it, and no blanks, which it writes with backslashes."""
    named = dict.fromkeys(flag for some in motion.flags for flag in some)
    flags = {flag: np.array([flag in some for some in motion.flags]) for flag in named}
    rows = {flag.replace(" ", "_"): (flag, scene.OUTLIER, holds) for flag, holds in flags.items()}
    for foot, label, stood in zip(motion.feet, motion.foot_labels, stands.T, strict=True):
        rows[motion.names[foot]] = "stance", scene.LEFT if label[0] == "L" else scene.RIGHT, stood
    return {rr.escape_entity_path_part(name): row for name, row in rows.items()}


# -- of every motion ----------------------------------------------------------------------------------------------


def angle_plots(motion: Motion) -> Iterator[scene.TimePlot]:
    """In degrees, by side; those that are too many for one plot by end of the animal, or by kind."""
    keys: dict[str, dict[str, str]] = {kind: {} for kind in ("left", "right", "middle")}
    for name in motion.angle_names:
        words, side = without_side(name).split("_"), side_of(name)
        keys[side or "middle"][name] = words[-1] if side is None and words[0] not in ("theta", "phi") else words[0]
    for kind, own in keys.items():
        for key, names in _parts(own):
            entity = f"angles/{kind}" + f"/{key.replace(', ', '_')}" * bool(key)
            degrees = np.degrees(motion.angles_rad[:, [motion.angle_names.index(name) for name in names]])
            labels = [without_side(name).replace("_", " ") for name in names]
            colours = [scene.LINE_COLOURS[i % len(scene.LINE_COLOURS)] for i in range(len(names))]
            yield scene.TimePlot(entity, f"{kind} {key}".strip().capitalize() + " (°)", labels, colours, degrees)


def _parts(keys: Mapping[str, str]) -> Iterator[tuple[str, list[str]]]:
    """Names of one plot, by what they have in common: all of them, where a plot has room for them, or else those with
    the same key, and the next as well, as far as there is room."""
    if len(keys) <= MAX_LINES:
        yield from [("", [*keys])] if keys else []
        return
    parts: list[tuple[str, list[str]]] = []
    for key in dict.fromkeys(keys.values()):
        names = [name for name, own in keys.items() if own == key]
        if parts and len(parts[-1][1]) + len(names) <= MAX_LINES:
            parts[-1] = (f"{parts[-1][0]}, {key}", [*parts[-1][1], *names])
        else:
            parts.append((key, names))
    yield from parts


def other_plots(motion: Motion) -> list[scene.TimePlot]:
    """Speed, errors in the pictures (the largest without outliers, which would hide the rest), and uncertainty."""
    distance = np.concatenate([picture.distance_px for picture in motion.pictures], axis=1)
    outliers = np.concatenate([picture.outliers for picture in motion.pictures], axis=1)
    known = np.isfinite(distance).any(axis=1)
    residuals = np.full((len(distance), 2), np.nan)
    residuals[known, 0] = np.nanmedian(distance[known], axis=1)
    residuals[:, 1] = np.fmax.reduce(np.where(outliers, np.nan, distance), axis=1)
    names = ["median of the joints", "worst but for outliers"]
    errors = scene.TimePlot("residuals", "Reprojection (px)", names, [scene.LIMB_COLOURS[1], scene.EDGE], residuals)
    names = ["joint within the pose", "position in depth"]
    sigmas = np.stack((motion.relative_rms_m, motion.place_sigma_m), axis=1)
    return [
        _speed(motion),
        errors,
        scene.TimePlot("uncertainty", "One sigma (m)", names, [scene.LIMB_COLOURS[1], scene.LINK], sigmas),
    ]


def _speed(motion: Motion) -> scene.TimePlot:
    speed = speed_at_frames(motion.time_s, motion.root_m)
    run_m_s, lines = motion.solution.constant_velocity_m_s, {"speed": speed}
    if run_m_s is not None:
        path_known = np.isfinite(frame_jitter_m(motion.root_m)).all()
        smooth = speed_at_frames(motion.time_s, motion.root_m, smooth=True) if path_known else speed
        lines = {"smoothed by its jitter": smooth, "straight run": run_m_s, "cubic spline": speed}
    values = np.where(motion.solved[:, None], np.stack([*lines.values()], axis=1), np.nan)
    ends = f", {np.nanmin(values):.1f} to {np.nanmax(values):.1f} m/s" if np.isfinite(values).any() else " (m/s)"
    title = "Speed (m/s)" if len(lines) > 1 else f"Speed{ends}"
    return scene.TimePlot(
        "speed", title, [*lines], [scene.TRAIL, scene.LIMB_COLOURS[0], scene.EDGE][: len(lines)], values
    )


# -- of an analysis -----------------------------------------------------------------------------------------------


def analysis_plots(found: ClipAnalysis) -> Iterator[scene.TimePlot]:
    """Speed, acceleration and flexion with one sigma, the links' speeds, and the feet's vertical forces."""
    moved, times_s = found.joints[found.reference], found.motion.time_s
    every, name = moved.series.oversampling, found.reference
    shown: list[tuple[str, str, Array, Array]] = [
        ("speed", f"Speed of {name} (m/s)", moved.speed_m_s, moved.speed_sigma_m_s),
        ("acceleration", f"Acceleration of {name} (m/s²)", moved.acceleration_m_s2, moved.acceleration_sigma_m_s2),
    ]
    if "spine_flexion" in found.angles:
        flexion = found.angles["spine_flexion"].series
        bent, sigma = (np.degrees(of[:, 0]) for of in (flexion.value, flexion.value_sigma))
        shown.append(("spine", "Flexion of the spine (°)", bent, sigma))
    for entity, title, values, sigma in shown:
        lines = {entity: values}
        if np.isfinite(sigma).any() and entity != "acceleration":  # whose deviations are many times as large as it is
            lines |= {"minus one sigma": values - sigma, "plus one sigma": values + sigma}
        at_frames, colours = (
            np.stack([*lines.values()], axis=1)[::every],
            [scene.TRAIL, scene.LINK, scene.LINK][: len(lines)],
        )
        yield scene.TimePlot(f"analysis/{entity}", title, [*lines], colours, at_frames, "Kinematics")
    if found.dynamics is not None and found.gait is not None:
        rows = np.searchsorted(found.gait.tracks.time_s, times_s - 1e-6)
        forces = {foot: force[rows, 0] for foot, force in found.dynamics.force.items()}
        yield _lines("analysis/forces", "Vertical force (body weights)", forces, "Forces")
    paws = {*found.motion.foot_names.values()}
    for limb, fields in found.fields.items():
        speeds = {field.link[1].replace("_", " "): field.speed_m_s for field in fields}
        tab = "Legs, tips about parents" if fields[-1].link[1] in paws else "Trunk, tips about parents"
        yield _lines(f"analysis/links/{limb.replace(' ', '_')}", f"{limb} (m/s)", speeds, tab)


def _lines(entity: str, title: str, lines: Mapping[str, Array], tab: str) -> scene.TimePlot:
    colours: Sequence[scene.Colour] = [scene.LINE_COLOURS[i % len(scene.LINE_COLOURS)] for i in range(len(lines))]
    return scene.TimePlot(entity, title, [*lines], colours, np.stack([*lines.values()], axis=1), tab=tab)


def write_forces(found: ClipAnalysis, log: scene.Log) -> None:
    """Arrows under the feet, of which a body weight is as long as the centre of mass is high, and its path."""
    if (d := found.dynamics) is None or found.gait is None:
        return
    tracks, motion, centre_m = found.gait.tracks, found.motion, d.centre.series.value
    rows = np.searchsorted(tracks.time_s, motion.time_s - 1e-6)
    force = np.stack([d.force[foot][rows, 0] for foot in tracks.feet], axis=1)
    high_m = float(np.nanmedian(centre_m[:, 2] - d.ground_m))
    up = motion.in_reference(np.array([0.0, 0.0, high_m])) - motion.in_reference(np.zeros(3))
    there, origins_m = force > 0, motion.in_reference(tracks.foot_m[rows])
    columns = rr.Arrows3D.columns(vectors=force[there][:, None] * up, origins=origins_m[there])
    log.send("world/forces", columns.partition(there.sum(axis=1)))
    log.fix("world/forces", rr.Arrows3D.from_fields(colors=scene.TRAIL, radii=0.01))
    path = motion.in_reference(centre_m[np.isfinite(centre_m).all(axis=1)])
    log.fix("world/forces/centre_of_mass", rr.LineStrips3D([path], colors=scene.TRAIL, radii=0.006))
