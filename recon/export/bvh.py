"""BVH file of joint positions: metres, y up (x forwards, y up, z right), every joint with channels of position.

Joints hang on one another as they are linked, and otherwise on a root at the origin, whose name says the unit, the
axes and the frame numbers: `recon_m_yup_frames_10-69`. All OFFSETs are zero and nothing turns, so that a joint's place
is the sum of the positions down to it, however a program takes channels of position. BVH has no missing points: such
a joint stays where it was last (at first: where it will be), and Zrotation 360, which turns nothing, marks it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recon.export.checks import require_names, required_fps, without_gaps
from recon.io.bvh import MISSING_DEG, OWN_ROOT
from recon.io.common import frames_text
from recon.io.pose import Pose3D, y_up_from_z_up

TITLE = "BVH"
CHANNELS = "CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation"


def write(pose: Pose3D, path: Path) -> None:
    """Raises InputError without a frame rate, or for names with blanks."""
    fps = required_fps(pose.fps, TITLE)
    require_names(pose.names, r"\s|[{}]", TITLE)
    xyz = without_gaps(pose.frames, y_up_from_z_up(pose.xyz_m), TITLE)
    missing = np.any(np.isnan(xyz), axis=2)
    held = _held(xyz, missing)
    children = _tree(pose)
    lines = ["HIERARCHY", f"ROOT {OWN_ROOT}{'_'.join(frames_text(pose.frames))}", "{", "OFFSET 0 0 0", CHANNELS]
    motion = [np.zeros((len(xyz), 6))]

    def add(j: int, parent: int | None, depth: int) -> None:
        lines.extend(["  " * depth + line for line in (f"JOINT {pose.names[j]}", "{")])
        lines.extend(["  " * (depth + 1) + line for line in ("OFFSET 0 0 0", CHANNELS)])
        local = held[:, j] - (0.0 if parent is None else held[:, parent])
        turn = np.where(missing[:, j], MISSING_DEG, 0.0)[:, None] * [1.0, 0.0, 0.0]
        motion.append(np.concatenate([local, turn], axis=1))
        for child in children[j]:
            add(child, j, depth + 1)
        if not children[j]:
            lines.extend("  " * (depth + 1) + line for line in ("End Site", "{", "  OFFSET 0 0 0", "}"))
        lines.append("  " * depth + "}")

    for j in children[-1]:
        add(j, None, 1)
    lines += ["}", "MOTION", f"Frames: {len(xyz)}", f"Frame Time: {1 / fps!r}"]
    lines += [" ".join(_number(v) for v in row) for row in np.concatenate(motion, axis=1).tolist()]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="")


def _number(value: float) -> str:
    return str(int(value)) if value == int(value) else repr(value)


def _held(xyz: np.ndarray, missing: np.ndarray) -> np.ndarray:
    """Positions (T, J, 3) with missing ones as they were last, or will be first, or the origin."""
    held = np.zeros_like(xyz)
    rows = np.arange(len(xyz))
    for j in range(xyz.shape[1]):
        known = np.flatnonzero(~missing[:, j])
        if len(known):
            held[:, j] = xyz[known[np.maximum(np.searchsorted(known, rows, side="right") - 1, 0)], j]
    return held


def _tree(pose: Pose3D) -> dict[int, list[int]]:
    """The children of each joint, and of the root (-1): every joint once, links that would close a loop left out."""
    linked: dict[str, list[str]] = {name: [] for name in pose.names}
    for a, b in pose.edges:
        linked[a].append(b)
        linked[b].append(a)
    children: dict[int, list[int]] = {j: [] for j in range(-1, len(pose.names))}
    seen: set[str] = set()
    for first in pose.names:
        queue = [(first, -1)]
        for name, parent in queue:
            if name not in seen:
                seen.add(name)
                j = pose.names.index(name)
                children[parent].append(j)
                queue += [(other, j) for other in linked[name]]
    return children
