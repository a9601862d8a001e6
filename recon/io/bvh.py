"""BVH files of moving skeletons: the joints' positions, by forward kinematics. y up by custom; the unit is not stated.

Channels of position take the place of a joint's OFFSET, as most programs have it. End sites are joints, called as
their parents with `_end`, unless they have no length.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.documents import read_text
from recon.base.errors import Problem, refuse
from recon.io.bones import AXIS, Armature
from recon.io.common import frame_number, number, points_of_arrays, require_names, require_span, starts_with_text
from recon.io.pose import StoredPoints

AXES = "XYZ"
TITLE = "BVH"
_CHANNEL = {(0, 1, 0): "Yrotation", (0, 0, -1): "Zrotation", (1, 0, 0): "Xrotation"}


@dataclass
class _Joint:
    """A joint as the file lists it."""

    name: str
    parent: int
    """Its place in the list, -1 for the root."""
    offset: list[float] = field(default_factory=list)
    channels: list[str] = field(default_factory=list)
    """The names of the channels, such as Xposition."""
    column: int = 0
    """The column of the first channel."""
    end: bool = False


def recognises(path: Path) -> bool:
    return starts_with_text(path, b"HIERARCHY")


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """Raises InputError for a file that is cut off or no BVH."""
    text = read_text(path, "a BVH file")
    lines = iter([line.strip() for line in text.splitlines() if line.strip()])
    joints = _hierarchy(lines)
    count = frame_number(_value(lines, r"Frames:\s*(\S+)")) or 0
    frame_time_s = number(_value(lines, r"Frame Time:\s*(\S+)"))
    rows = [[number(cell) for cell in line.split()] for line in lines]
    width = sum(len(joint.channels) for joint in joints)
    problems = [
        Problem(path, f"frame {i + 1} of MOTION", f"{len(row)} numbers", f"{width}, one for each channel")
        for i, row in enumerate(rows)
        if len(row) != width
    ][:3]
    if len(rows) != count:
        problems.append(Problem(path, "MOTION", f"{len(rows)} rows, and Frames: {count}", "as many"))
    if not 0 < frame_time_s < float("inf"):
        problems.append(Problem(path, "Frame Time", f"{frame_time_s:g}", "seconds above 0"))
    refuse(problems)
    require_span(count, len(joints), path)
    kept = {j: joint.parent for j, joint in enumerate(joints) if not joint.end or any(joint.offset)}
    xyz = _positions(joints, np.array(rows).reshape(-1, width))[:, [*kept]]
    return points_of_arrays(
        path,
        individual,
        xyz,
        np.arange(count),
        [joints[j].name for j in kept],
        fps=float(f"{1 / frame_time_s:.9g}"),
        edges=tuple((joints[p].name, joints[j].name) for j, p in kept.items() if p in kept),
    )


def _hierarchy(lines: Iterator[str]) -> list[_Joint]:
    """The joints in the order of their channels, each after its parent. Raises what `DAMAGE` lists."""
    if next(lines) != "HIERARCHY":
        raise ValueError("no HIERARCHY")
    joints: list[_Joint] = []
    open_: list[int] = []
    for line in lines:
        word, *rest = line.split()
        if word == "MOTION":
            return joints
        if word in ("ROOT", "JOINT", "End"):
            parent = open_[-1] if open_ else -1
            name = f"{joints[parent].name}_end" if word == "End" else line[len(word) :].strip()
            joints.append(_Joint(name, parent, end=word == "End"))
        elif word == "{":
            open_.append(len(joints) - 1)
        elif word == "}":
            open_.pop()
        elif word == "OFFSET" and len(rest) == 3:
            joints[-1].offset = [number(cell) for cell in rest]
        elif word == "CHANNELS" and all(re.fullmatch(r"[XYZ](position|rotation)", name) for name in rest[1:]):
            joints[-1].column = sum(len(joint.channels) for joint in joints[:-1])
            joints[-1].channels = rest[1:]
        else:
            raise ValueError(f"'{line[:60]}' in the hierarchy")
    raise ValueError("no MOTION")


def _value(lines: Iterator[str], pattern: str) -> str:
    line = next(lines)
    match = re.fullmatch(pattern, line)
    if match is None:
        raise ValueError(f"'{line[:60]}' where '{pattern.split(':')[0]}:' should be")
    return match[1]


def _positions(joints: list[_Joint], motion: np.ndarray) -> np.ndarray:
    """(T, J, 3): p = p_parent + R_parent t, with R = R_parent R_1 R_2 R_3 in the order of the channels."""
    xyz = np.zeros((len(motion), len(joints), 3))
    turned: list[Rotation] = []
    for j, joint in enumerate(joints):
        xyz[:, j] = joint.offset
        turn = Rotation.identity(len(motion))
        for c, channel in enumerate(joint.channels, start=joint.column):
            if channel.endswith("position"):
                xyz[:, j, AXES.index(channel[0])] = motion[:, c]
            else:
                turn = turn * Rotation.from_euler(channel[0].lower(), motion[:, [c]], degrees=True)
        if joint.parent >= 0:
            xyz[:, j] = xyz[:, joint.parent] + turned[joint.parent].apply(xyz[:, j])
            turn = turned[joint.parent] * turn
        turned.append(turn)
    return xyz


# -- writing ---------------------------------------------------------------------------------------------------------


def write(rig: Armature, path: Path) -> None:
    """Bones that turn, in metres, y up. A bone's OFFSET is its origin in its parent's frame, its channels are its
    angles in degrees; the root has its path, too. Joints are bones without a turn, that end where they begin.

    Raises InputError for names with blanks or braces.
    """
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
