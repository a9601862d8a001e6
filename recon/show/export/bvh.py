"""BVH file: bones that turn, metres, y up (see `recon.show.export.rig`).

A bone's OFFSET is its origin in its parent's frame, its channels are its angles in degrees; the root has its path, too.
Joints are there as bones without a turn, that end where they begin. The first frame is 0.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from recon.io.common import require_names
from recon.show.export.rig import AXIS, Rig

TITLE = "BVH"
_CHANNEL = {(0, 1, 0): "Yrotation", (0, 0, -1): "Zrotation", (1, 0, 0): "Xrotation"}


def write(rig: Rig, path: Path) -> None:
    """Raises InputError for names with blanks or braces."""
    require_names([bone.name for bone in rig.bones] + list(rig.joints), r"\s|[{}]", TITLE)
    lines, columns = ["HIERARCHY"], [rig.root_m]

    def add(kind: str, name: str, offset_m: np.ndarray, bone: int | None, depth: int) -> None:
        """A bone, or, of no bone, a joint."""
        indent = "  " * depth
        turns = () if bone is None else rig.bones[bone].turns
        angles = {turn.kind: sum(AXIS[turn.kind]) * np.degrees(turn.angle_rad) for turn in turns}
        # All three, as programs expect them.
        order = [*dict.fromkeys((*angles, *AXIS))]
        columns.extend(angles.get(k, np.zeros(len(rig.root_m)))[:, None] for k in order)
        channels = ["Xposition", "Yposition", "Zposition"] if depth == 0 else []
        channels += [_CHANNEL[AXIS[k]] for k in order]
        lines.extend([f"{indent}{kind} {name}", f"{indent}{{", f"{indent}  OFFSET {_numbers(offset_m)}"])
        lines.append(f"{indent}  CHANNELS {len(channels)} {' '.join(channels)}")
        children = [i for i, of_it in enumerate(rig.bones) if bone is not None and of_it.parent == bone]
        joints = [j for j, at in enumerate(rig.joint_bones) if at == bone]
        for child in children:
            add("JOINT", rig.bones[child].name, rig.bones[child].offset_m, child, depth + 1)
        for joint in joints:
            add("JOINT", rig.joints[joint], rig.joint_offsets_m[joint], None, depth + 1)
        if not children and not joints:
            lines.extend(f"{indent}  {line}" for line in ("End Site", "{", "  OFFSET 0 0 0", "}"))
        lines.append(indent + "}")

    add("ROOT", rig.bones[0].name, np.zeros(3), 0, 0)
    lines += ["MOTION", f"Frames: {len(rig.root_m)}", f"Frame Time: {1 / rig.fps!r}"]
    lines += [_numbers(row) for row in np.column_stack(columns)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="")


def _numbers(values: np.ndarray) -> str:
    return " ".join(map(repr, (values + 0.0).tolist()))
