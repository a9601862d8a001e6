"""Convert a motion to other forms: its file, tables for pandas and movement, and a notebook's view.

`recon.fit.motion.Motion` calls these functions, so this module cannot import that class.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem
from recon.base.files import MANIFEST, read_manifest
from recon.base.records import load_record
from recon.fit.result import SHAPES, TRAJECTORY_SHAPES, TrajectorySolution
from recon.geometry.kinematics import YAW

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr
    from matplotlib.figure import Figure

MOTION, REPORT, CONFIG = "motion.npz", "report.json", "config.toml"
"""Names of the motion in a results folder of `recon fit`, of its report and of its settings."""
SCHEMA, OLDER_VERSIONS = {"name": "recon.motion", "version": 4}, (2, 3)
"""Name and version of the format, and the older versions that can be read.

Version 2 named classes by their modules (`_CLASSES_BY_PATH`). Versions 2 and 3 stored arrays unchanged.
"""
EXPECTED = "the motion that `recon fit` or `Motion.save` wrote"
_FIT_FILES = (REPORT, CONFIG, "angles.csv", "pose3d.csv", "quality.csv")
"""Files of a fit, each of which shows an interrupted run if the manifest is missing."""


def _chain() -> type:
    from recon.animal.chain import Chain

    return Chain


def _trajectory_solution() -> type:
    return TrajectorySolution


def _frame_solution() -> type:
    # Results of the frame method can be read only if this optional package is installed.
    from recon.thesis.solution import FrameSolution

    return FrameSolution


CLASSES = {"chain": _chain, "trajectory": _trajectory_solution, "frame": _frame_solution}
"""Functions that import the subclasses which a motion file may contain, by the subclass's `record_tag`."""
_CLASSES_BY_PATH = {
    "recon.animal.chain:Chain": _chain,
    "recon.thesis.chain:UnknownsChain": _chain,
    "recon.fit.result:TrajectorySolution": _trajectory_solution,
    "recon.thesis.frame:FrameSolution": _frame_solution,
    "recon.thesis.solution:FrameSolution": _frame_solution,
    "recon.wings.thesis.frame:FrameSolution": _frame_solution,
}


Motion: TypeAlias = Any
"""Stand-in for the class `recon.fit.motion.Motion`, whose module imports this one."""


def load(motion_class: type[Motion], folder: Path) -> Motion:
    """Return the motion in a folder as an instance of `motion_class`, or raise the errors of `Motion.load`."""
    path = folder / MOTION
    if not path.is_file():
        raise InputError(_no_motion(folder))
    # These files are written by a fit, not by `Motion.save`.
    if any((folder / name).exists() for name in (MANIFEST, *_FIT_FILES)):
        read_manifest(folder).require(MOTION)
    hint = f"; if it is of an earlier version, run {_refit_command(folder)}" if (folder / CONFIG).is_file() else ""
    motion = load_record(motion_class, path, SCHEMA, EXPECTED + hint, CLASSES | _CLASSES_BY_PATH, OLDER_VERSIONS)
    try:
        faults = _misfits(motion)
        _ = motion.limbs, motion.foot_names, motion.forward_names  # a missing joint raises KeyError
    except (KeyError, ValueError, IndexError) as error:
        raise InputError(Problem(path, "solution.body", f"a missing joint ({error})", EXPECTED)) from None
    if faults:
        raise InputError(Problem(path, name, value, expected) for name, value, expected in faults)
    return motion


def _misfits(motion: Motion) -> list[tuple[str, str, str]]:
    """Return the name, shape and expected shape of every array of a motion that has the wrong shape."""
    sizes = {"T": len(motion.frames), "J": len(motion.joints), "V": len(motion.sources), "D": motion.body.n_state}
    sizes |= {"F": len(motion.body.feet), "A": motion.body.n_state - YAW, "K": len(motion.body.anatomy)}
    sizes |= {"2": 2, "3": 3, "4": 4}
    solution = motion.solution
    shapes = SHAPES if solution.flexion_sigma_rad is None else TRAJECTORY_SHAPES
    arrays = {f"solution.{name}": (getattr(solution, name), letters) for name, letters in shapes.items()}
    arrays["solution.flags"] = (np.zeros(len(solution.flags)), "T")
    arrays["solution.views"] = (np.zeros(len(solution.views)), "V")
    for i, source in enumerate(motion.sources):
        for name, letters in (("frames", "T"), ("xy_px", "TJ2"), ("confidence", "TJ")):
            arrays[f"sources.{i}.keypoints.{name}"] = (getattr(source.keypoints, name), letters)
        if source.poses is not None:
            arrays[f"sources.{i}.poses.T_camera_world"] = (source.poses.T_camera_world, "T44")
    arrays |= {f"solution.views.{i}.xy_px": (view.xy_px, "TJ2") for i, view in enumerate(solution.views)}
    expected = {name: tuple(sizes[letter] for letter in letters) for name, (_, letters) in arrays.items()}
    return [
        (name, str(array.shape), str(expected[name]))
        for name, (array, _) in arrays.items()
        if array.shape != expected[name]
    ]


def _refit_command(folder: Path) -> str:
    config, out = (shlex.quote(str(path)) for path in (folder / CONFIG, folder))
    return f"recon fit --config {config} --out {out} --overwrite"


def _no_motion(folder: Path) -> Problem:
    expected = "the folder of results that `recon fit` wrote"
    if (folder / REPORT).is_file() and (folder / CONFIG).is_file():
        content = f"no {MOTION}: results of an earlier version"
        expected = f"results of this version: write them again with {_refit_command(folder)}"
        return Problem(folder, "folder", content, expected)
    clips = sorted(path.parent for path in folder.glob(f"*/{MOTION}")) if folder.is_dir() else []
    content = f"no {MOTION}" if folder.is_dir() else "a file" if folder.is_file() else "no such folder"
    return Problem(folder, "folder", content, f"the folder of one clip, as in {clips[0]}" if clips else expected)


def table_of(motion: Motion, wide: bool) -> pd.DataFrame:
    """Return the joints of a motion as the table that `Motion.to_dataframe` describes."""
    import pandas as pd

    T, J = len(motion.frames), len(motion.names)
    values = np.concatenate([motion.upright.xyz_m, motion.upright_sigma_m], axis=2)
    columns = [f"{axis}{kind}_m" for kind in ("", "_sigma") for axis in "xyz"]
    if wide:
        index = pd.MultiIndex.from_product([motion.names, columns], names=["joint", "value"])
        return pd.DataFrame(values.reshape(T, -1), index=pd.Index(motion.frames, name="frame"), columns=index)
    head = {"frame": np.repeat(motion.frames, J), "time_s": np.repeat(motion.time_s, J), "joint": [*motion.names] * T}
    table = pd.DataFrame(head | dict(zip(columns, values.reshape(-1, 6).T, strict=True)))
    return table.assign(flags=np.repeat([", ".join(names) for names in motion.flags], J))


def dataset_of(motion: Motion) -> xr.Dataset:
    """Return the joints of a motion as the dataset that `Motion.to_xarray` describes."""
    from recon.io import hdf5_poses

    dataset = hdf5_poses.dataset_of(motion.upright)
    dataset["position_sigma"] = (dataset["position"].dims, motion.upright_sigma_m.transpose(0, 2, 1)[..., None])
    verdict = motion.verdict
    verdict_attributes = {} if verdict is None else {"verdict": verdict.level, "verdict_reason": verdict.reason}
    return dataset.assign_attrs(verdict_attributes | {"source_file": motion.file})


def html_of(motion: Motion) -> str:
    """Return HTML for a notebook: the verdict, the expected errors, and poses from the side."""
    verdict_texts = () if motion.verdict is None else motion.verdict.lines
    rows: dict[str, str] = dict(zip(("verdict", "expected"), verdict_texts, strict=False))
    rows["clip"] = f"{Path(motion.file).name}, frames {motion.frames[0]} to {motion.frames[-1]} at {motion.fps:g} fps"
    rows["camera"] = ", ".join(camera.name for camera in motion.cameras)
    rows["animal"] = motion.title
    flagged = sum(map(bool, motion.flags))
    rows["frames"] = f"{motion.solved.sum()} of {motion.clip_frames} with a pose, {flagged} flagged"
    left = "style='text-align:left'"
    cells = (f"<tr><th {left}>{name}</th><td {left}>{escape(text)}</td></tr>" for name, text in rows.items())
    return f"<div><table>{''.join(cells)}</table>{_from_the_side(motion.upright.xyz_m, motion.limbs.values())}</div>"


def _from_the_side(joints_m: Array, limbs: Iterable[Sequence[int]]) -> str:
    """Return eight poses from the side, evenly spaced in time, as SVG; empty if there are fewer than two poses.

    The joints (T, J, 3) are in a world with z up.
    """
    posed = joints_m[np.isfinite(joints_m).all(axis=(1, 2))]
    if len(posed) < 2:
        return ""
    travel = (posed[-1] - posed[0]).mean(axis=0)[:2]
    direction = travel / np.linalg.norm(travel) if travel.any() else np.array([1.0, 0.0])
    shown = posed[np.linspace(0, len(posed) - 1, min(8, len(posed)), dtype=int)]
    points = np.stack([shown[..., :2] @ direction, -shown[..., 2]], axis=-1)
    (x, y), (width, height) = points.min(axis=(0, 1)), np.ptp(points, axis=(0, 1))
    polylines = (" ".join(f"{a:.3f},{b:.3f}" for a, b in pose[[*limb]]) for pose in points for limb in limbs)
    lines = "".join(f"<polyline vector-effect='non-scaling-stroke' points='{line}'/>" for line in polylines)
    box = f"viewBox='{x:.3f} {y:.3f} {width:.3f} {height:.3f}' width='640' height='240'"
    return f"<svg {box} role='img' fill='none' stroke='#0072b2' stroke-width='1.6' overflow='visible'>{lines}</svg>"


def figure_of(motion: Motion) -> Figure:
    """Return a figure of the animal's poses from the side, evenly spaced over the clip."""
    from recon.show.plots.side_view import side_view

    sides = motion.limb_sides
    return side_view(motion.upright.xyz_m, motion.limbs, sides, motion.solved, motion.time_s, of_stride=False)
