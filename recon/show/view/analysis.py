"""The plots of an analysis, which go with the playback."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from recon.base.arrays import Array
from recon.fit.motion import MEASURED_SHARE
from recon.gait.clip import ClipAnalysis
from recon.show.view.added import AddedArrows, AddedSeries, AddedStates, write_plots
from recon.show.view.scene import GRID, LEFT, LIMB_COLOURS, LINK, MIDDLE, RIGHT, TRAIL


def write_analysis(found: ClipAnalysis, path: Path, playback: Path) -> None:
    """Speed, acceleration and flexion with one sigma, the links' speeds, the stances, and which
    angles the pixels show; of a skeleton with masses the feet's vertical forces, as arrows too, and the centre of mass.
    Raises InputError as `write_plots`."""
    series, states = [*_kinematics(found), *_forces(found), *_links(found)], [*_stances(found), *_observability(found)]
    write_plots(path, playback, found.motion, series, states, arrows=_arrows(found))


def _kinematics(found: ClipAnalysis) -> Iterator[AddedSeries]:
    moved = found.joints[found.reference]
    yield _with_sigma(found, "speed", f"Speed of {found.reference} (m/s)", moved.speed_m_s, moved.speed_sigma_m_s)
    title = f"Acceleration of {found.reference} (m/s²)"
    yield _with_sigma(found, "acceleration", title, moved.acceleration_m_s2, moved.acceleration_sigma_m_s2)
    if "spine_flexion" in found.angles:
        series = found.angles["spine_flexion"].series
        sigma = None if series.value_sigma is None else np.degrees(series.value_sigma[:, 0])
        yield _with_sigma(found, "spine", "Flexion of the spine (°)", np.degrees(series.value[:, 0]), sigma)


def _with_sigma(found: ClipAnalysis, entity: str, title: str, values: Array, sigma: Array | None) -> AddedSeries:
    names: Sequence[str] = [entity] if sigma is None else [entity, "minus one sigma", "plus one sigma"]
    lines = [values] if sigma is None else [values, values - sigma, values + sigma]
    return AddedSeries(
        entity=entity,
        title=title,
        names=names,
        colours=[TRAIL, LINK, LINK][: len(lines)],
        values=np.stack(lines, axis=1),
        shown=values[:, None] if entity == "acceleration" else None,  # its deviations are many times as large
        time_s=found.joints[found.reference].series.time_s,
        tab="Kinematics",
    )


def _forces(found: ClipAnalysis) -> Iterator[AddedSeries]:
    if (d := found.dynamics) is None or found.gait is None:
        return
    yield AddedSeries(
        entity="forces",
        title="Vertical force (body weights)",
        names=[*d.force],
        colours=[LIMB_COLOURS[i % len(LIMB_COLOURS)] for i in range(len(d.force))],
        values=np.stack([force[:, 0] for force in d.force.values()], axis=1),
        time_s=found.gait.tracks.time_s,
        tab="Forces",
    )


def _arrows(found: ClipAnalysis) -> AddedArrows | None:
    """A body weight is as long as the centre of mass is high."""
    if (d := found.dynamics) is None or found.gait is None:
        return None
    tracks, motion = found.gait.tracks, found.motion
    force = np.stack([d.force[foot][:, 0] for foot in tracks.feet], axis=1)
    centre_m = d.centre.series.value
    high_m = float(np.nanmedian(centre_m[:, 2] - d.ground_m))
    up = motion.in_reference(np.array([0.0, 0.0, high_m])) - motion.in_reference(np.zeros(3))
    return AddedArrows(
        entity="world/forces",
        origins_m=motion.in_reference(tracks.foot_m),
        vectors_m=force[..., None] * up,
        path_m=motion.in_reference(centre_m),
        time_s=tracks.time_s,
        colour=TRAIL,
    )


def _links(found: ClipAnalysis) -> Iterator[AddedSeries]:
    paws = {*found.motion.foot_names.values()}
    for limb, fields in found.fields.items():
        yield AddedSeries(
            entity=f"links/{limb.replace(' ', '_')}",
            title=f"{limb} (m/s)",
            names=[field.link[1].replace("_", " ") for field in fields],
            colours=[LIMB_COLOURS[i % len(LIMB_COLOURS)] for i in range(len(fields))],
            values=np.stack([field.speed_m_s for field in fields], axis=1),
            time_s=found.motion.time_s,
            tab="Legs, tips about parents" if paws & {fields[-1].link[1]} else "Trunk, tips about parents",
        )


def _observability(found: ClipAnalysis) -> Iterator[AddedStates]:
    """Of every angle, when the pixels show it."""
    motion, rows = found.motion, []
    for name, share in zip(motion.posture_names, motion.posture_data_share.T, strict=True):
        texts = ["" if np.isnan(s) else "seen" if s >= MEASURED_SHARE else "expected" for s in share]
        rows.append((name, texts, {"seen": LEFT, "expected": GRID}))
    title = f"Angles: seen, {MEASURED_SHARE:.0%} or more of their precision is the pixels', or mostly expected"
    yield AddedStates(title=title, rows=rows, time_s=motion.time_s, tab="What is seen")


def _stances(found: ClipAnalysis) -> Iterator[AddedStates]:
    if found.gait is None:
        return
    time_s, rows = found.joints[found.reference].series.time_s, []
    for foot, joint in found.motion.foot_names.items():
        stands = np.zeros(len(time_s), dtype=bool)
        for s in found.gait.stances:
            if s.foot == foot:
                stands[np.searchsorted(time_s, s.start_s) : np.searchsorted(time_s, s.end_s, "right")] = True
        texts = ["stance" if down else "" for down in stands]
        rows.append((joint, texts, {"stance": {"L": LEFT, "R": RIGHT}.get(foot[0], MIDDLE)}))
    yield AddedStates(title=f"Stances: {found.gait.name.name}", rows=rows, time_s=time_s, tab="Gait")
