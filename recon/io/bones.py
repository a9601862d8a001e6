"""Describe an animal as bones that turn relative to each other, and write BVH, OpenSim and glTF 2.0.

These formats are for programs that work with bones, not points. Lengths are in metres, with x forwards, y up and z
right. With all angles 0, every bone's axes are parallel to the world's. Angles keep their names and signs: yaw turns
about y, pitch about -z and roll about x. `recon.show.rig` makes an armature from a fit. Joints are written as bones
without rotation, at the ends of limbs.

BVH files of other programs are read as positions of the joints, with y up by convention and no unit. Position channels
replace a joint's OFFSET, as in most programs. End sites are joints with the parent's name and `_end`, unless they have
no length.
"""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
from scipy.spatial.transform import Rotation

from recon.animal.body import Side
from recon.animal.capsules import Capsule
from recon.base.arrays import Array
from recon.base.documents import read_text
from recon.base.errors import Problem, raise_problems
from recon.base.package import version
from recon.io import common, writing
from recon.io.common import Pose3D, StoredPoints
from recon.io.markers import write_trc

AXIS: dict[str, tuple[int, int, int]] = {"yaw": (0, 1, 0), "pitch": (0, 0, -1), "roll": (1, 0, 0)}
"""Axis of rotation (x forwards, y up, z right) of each kind of angle."""


@dataclass(frozen=True, eq=False)
class BoneAngle:
    """One rotation of a bone relative to its parent, about an axis turned by the bone's earlier rotations."""

    name: str
    kind: str
    """Kind of angle: yaw, pitch or roll."""
    angle_rad: Array
    """Angle in each frame, shape (T,)."""
    mean_rad: float
    range_rad: tuple[float, float]
    """Lowest and highest expected angle, three standard deviations below and above the mean; -π and π if unknown."""


@dataclass(frozen=True, eq=False)
class Bone:
    """Rigid segment that turns relative to its parent, or the root, which has no parent and also moves."""

    name: str
    parent: int | None
    offset_m: Array
    """Origin of the bone in its parent's frame, shape (3,)."""
    turns: tuple[BoneAngle, ...]
    mass_kg: float
    """Mass of the bone in kg; 0 if the skeleton has no masses."""
    centre_m: Array
    """Centre of mass in the bone's frame, shape (3,)."""
    inertia_kg_m2: Array
    """Inertia tensor about `centre_m` in the bone's frame, shape (3, 3)."""


@dataclass(frozen=True, eq=False)
class Armature:
    """Skeleton of bones, parents first, with J joints fixed to them, in T consecutive frames."""

    name: str
    title: str
    bones: tuple[Bone, ...]
    joints: tuple[str, ...]
    """Names of the J joints, the same as the keypoints' names."""
    joint_bones: tuple[int, ...]
    joint_offsets_m: Array
    """Positions of the joints in the frames of the bones that they are fixed to, shape (J, 3)."""
    capsules: tuple[Capsule, ...]
    """Capsules of the bones, in the segments' frames, where z is up."""
    root_m: Array
    """Positions of the first bone's origin, shape (T, 3)."""
    pose: Pose3D
    """Positions of the joints in the T frames, z up."""
    fps: float
    notes: tuple[str, ...]


def turned(turns: tuple[BoneAngle, ...], count: int) -> Array:
    """Return the rotation matrices (count, 3, 3) from a bone's axes to its parent's, one for each of `count` frames."""
    R = Rotation.identity(count)
    for turn in turns:
        R = R * Rotation.from_rotvec(np.outer(turn.angle_rad, AXIS[turn.kind]))
    return R.as_matrix()


AXES = "XYZ"
_CHANNEL = {"yaw": "Yrotation", "pitch": "Zrotation", "roll": "Xrotation"}


@dataclass
class _Joint:
    """A joint of a BVH file."""

    name: str
    parent: int
    """Index of the parent, -1 for the root."""
    offset: list[float] = field(default_factory=list)
    channels: list[str] = field(default_factory=list)
    """Names of the channels, such as Xposition."""
    column: int = 0
    """Column of the joint's first channel in the motion section."""
    end: bool = False


def recognises_bvh(path: Path) -> bool:
    """Return whether a file is a BVH file."""
    return common.starts_with_text(path, b"HIERARCHY")


def read_bvh(path: Path, individual: str | None = None) -> StoredPoints:
    """Return the positions of the joints in a BVH file, computed by forward kinematics.

    Raises
    ------
    InputError
        If the file is cut off or is not BVH.
    """
    lines = enumerate(read_text(path, "a BVH file").splitlines(), start=1)
    rows = ((number, line.split()) for number, line in lines if line.strip())
    joints = _hierarchy(words for _, words in rows)
    count = common.frame_number(_value(next(rows)[1], r"Frames:\s*(\S+)")) or 0
    frame_time_s = common.number(_value(next(rows)[1], r"Frame Time:\s*(\S+)"))
    channels = [f"{joint.name} {channel}" for joint in joints for channel in joint.channels]
    common.require_span(count, len(joints), path)
    _, motion, problems = common.number_rows(path, rows, channels)
    if len(motion) != count and not problems:
        problems.append(
            Problem(path, "MOTION", f"{len(motion)} rows, but Frames: {count}", "as many rows as Frames states")
        )
    if not 0 < frame_time_s < float("inf"):
        problems.append(Problem(path, "Frame Time", f"{frame_time_s:g} s", "a time above 0 s"))
    raise_problems(common.first_problems(problems, path))
    parent_of = {j: joint.parent for j, joint in enumerate(joints) if not joint.end or any(joint.offset)}
    xyz = _positions(joints, motion)[:, [*parent_of]]
    names, fps = tuple(joints[j].name for j in parent_of), float(f"{1 / frame_time_s:.9g}")
    edges = tuple((joints[p].name, joints[j].name) for j, p in parent_of.items() if p in parent_of)
    return common.one_animal(path, individual, StoredPoints(names, xyz, np.arange(count), fps=fps, edges=edges))


def _hierarchy(lines: Iterable[list[str]]) -> list[_Joint]:
    """Return the joints in the hierarchy of a BVH file, parents first.

    `lines` are the file's lines, split into words. If the file is damaged, errors of various types are raised.
    """
    joints: list[_Joint] = []
    open_: list[int] = []
    for word, *rest in lines:
        if word == "MOTION":
            return joints
        if word in ("ROOT", "JOINT", "End"):
            parent = open_[-1] if open_ else -1
            name = f"{joints[parent].name}_end" if word == "End" else " ".join(rest)
            joints.append(_Joint(name, parent, end=word == "End"))
        elif word == "{":
            open_.append(len(joints) - 1)
        elif word == "}":
            open_.pop()
        elif word == "OFFSET" and len(rest) == 3:
            joints[-1].offset = [common.number(cell) for cell in rest]
        elif word == "CHANNELS" and all(re.fullmatch(r"[XYZ](position|rotation)", name) for name in rest[1:]):
            joints[-1].column = sum(len(joint.channels) for joint in joints[:-1])
            joints[-1].channels = rest[1:]
        elif word != "HIERARCHY":
            raise ValueError(f"'{' '.join((word, *rest))[:60]}' in the hierarchy")
    raise ValueError("no section MOTION")


def _value(words: Sequence[str], pattern: str) -> str:
    match = re.fullmatch(pattern, " ".join(words))
    if match is None:
        raise ValueError(f"'{' '.join(words)[:60]}' where '{pattern.split(':')[0]}:' should be")
    return match[1]


def _positions(joints: list[_Joint], motion: np.ndarray) -> np.ndarray:
    """Return the joints' positions (T, J, 3) from the values of their channels, `motion` (T, channels).

    p = p_parent + R_parent t, where t is the joint's offset or its position channels, and R = R_parent R_1 R_2 R_3 in
    the order of the rotation channels.
    """
    xyz = np.zeros((len(motion), len(joints), 3))
    rotations: list[Rotation] = []
    for j, joint in enumerate(joints):
        xyz[:, j] = joint.offset
        turn = Rotation.identity(len(motion))
        for c, channel in enumerate(joint.channels, start=joint.column):
            if channel.endswith("position"):
                xyz[:, j, AXES.index(channel[0])] = motion[:, c]
            else:
                turn = turn * Rotation.from_euler(channel[0].lower(), motion[:, [c]], degrees=True)
        if joint.parent >= 0:
            xyz[:, j] = xyz[:, joint.parent] + rotations[joint.parent].apply(xyz[:, j])
            turn = rotations[joint.parent] * turn
        rotations.append(turn)
    return xyz


def write_bvh(rig: Armature, path: Path) -> None:
    """Write rotating bones as BVH, in metres, y up.

    The OFFSET of a bone is its origin in its parent's frame, and its channels are its angles in degrees. The root also
    has channels for its position. Joints are written as bones of length 0 without rotation.

    Raises
    ------
    InputError
        If a bone's or joint's name has blanks or braces.
    """
    writing.require_names([bone.name for bone in rig.bones] + list(rig.joints), r"\s|[{}]", "BVH")
    lines, columns = ["HIERARCHY"], [rig.root_m]

    def add(kind: str, name: str, offset_m: np.ndarray, bone: int | None, depth: int) -> None:
        """Append the lines of a bone, or of a joint if `bone` is None, indented by `depth` levels."""
        margin = "  " * depth
        turns = () if bone is None else rig.bones[bone].turns
        angles = {turn.kind: sum(AXIS[turn.kind]) * np.degrees(turn.angle_rad) for turn in turns}
        # programs expect three rotation channels
        angles |= {kind: np.zeros(len(rig.root_m)) for kind in AXIS if kind not in angles}
        columns.extend(angle[:, None] for angle in angles.values())
        channels = ["Xposition", "Yposition", "Zposition"] if depth == 0 else []
        channels += [_CHANNEL[kind] for kind in angles]
        lines.extend([f"{margin}{kind} {name}", f"{margin}{{", f"{margin}  OFFSET {_numbers(offset_m)}"])
        lines.append(f"{margin}  CHANNELS {len(channels)} {' '.join(channels)}")
        children = [i for i, other_bone in enumerate(rig.bones) if bone is not None and other_bone.parent == bone]
        joints = [j for j, carrier in enumerate(rig.joint_bones) if carrier == bone]
        for child in children:
            add("JOINT", rig.bones[child].name, rig.bones[child].offset_m, child, depth + 1)
        for joint in joints:
            add("JOINT", rig.joints[joint], rig.joint_offsets_m[joint], None, depth + 1)
        if not children and not joints:
            lines.extend(f"{margin}  {line}" for line in ("End Site", "{", "  OFFSET 0 0 0", "}"))
        lines.append(margin + "}")

    add("ROOT", rig.bones[0].name, np.zeros(3), 0, 0)
    lines += ["MOTION", f"Frames: {len(rig.root_m)}", f"Frame Time: {1 / rig.fps!r}"]
    lines += [_numbers(row) for row in np.column_stack(columns)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="")


def _numbers(values: Array | Sequence[float]) -> str:
    return " ".join(map(repr, (np.asarray(values) + 0).tolist()))  # adding 0 turns -0 into 0


OPENSIM, OPENSIM_VERSION = "OpenSim model", "40000"
ROOT_AXES = {"x_m": (1, 0, 0), "y_m": (0, 0, -1), "z_m": (0, 1, 0)}
"""Axis in the OpenSim model, where y is up, of each coordinate of the root's origin, where z is up."""


def write_opensim(rig: Armature, path: Path) -> None:
    """Write an OpenSim model, with its motion (.mot) and its markers' trajectories (.trc) under the same name.

    Times are taken from the keypoint file. If the skeleton has no masses, the bodies have no mass, and the model can be
    used for kinematics only.

    Raises
    ------
    InputError
        If a bone's or joint's name has blanks or slashes.
    """
    writing.require_names([bone.name for bone in rig.bones] + list(rig.joints), r"[\s/\\*+]", OPENSIM)
    document = Element("OpenSimDocument", Version=OPENSIM_VERSION)
    units = {"length_units": "meters", "force_units": "N"}
    model = _add(document, "Model", rig.name, credits=f"recon, from {rig.title}", **units)
    bodies, joints, markers = (
        _add(_add(model, kind, kind.lower()), "objects") for kind in ("BodySet", "JointSet", "MarkerSet")
    )
    for bone in rig.bones:
        moments = _numbers(bone.inertia_kg_m2[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        mass = {"mass": repr(bone.mass_kg), "mass_center": _numbers(bone.centre_m), "inertia": moments}
        _draw(_add(bodies, "Body", bone.name, **mass), rig, bone)
        _join(joints, rig, bone)
    for name, carrier, offset_m in zip(rig.joints, rig.joint_bones, rig.joint_offsets_m, strict=True):
        frame = f"/bodyset/{rig.bones[carrier].name}"
        _add(markers, "Marker", name, socket_parent_frame=frame, location=_numbers(offset_m))
    indent(document)
    text = '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(document, encoding="unicode") + "\n"
    path.write_text(text, encoding="utf-8", newline="")
    _write_motion(rig, path.with_suffix(".mot"))
    write_trc(rig.pose, path.with_suffix(".trc"))


def _join(joints: Element, rig: Armature, bone: Bone) -> None:
    """Add the OpenSim joint that links a bone to its parent, or the root to the ground."""
    frames = {"socket_parent_frame": "origin", "socket_child_frame": f"/bodyset/{bone.name}"}
    joint = _add(joints, "CustomJoint" if bone.turns else "WeldJoint", bone.name, **frames)
    above = "/ground" if bone.parent is None else f"/bodyset/{rig.bones[bone.parent].name}"
    frame_of_joint = {"socket_parent": above, "translation": _numbers(bone.offset_m), "orientation": "0 0 0"}
    _add(_add(joint, "frames"), "PhysicalOffsetFrame", "origin", **frame_of_joint)
    if not bone.turns:
        return
    coordinates = _add(joint, "coordinates")
    for name in ROOT_AXES if bone.parent is None else ():
        _add(coordinates, "Coordinate", name, clamped="false")
    for turn in bone.turns:
        limits = {"default_value": repr(turn.mean_rad), "range": _numbers(turn.range_rad)}
        _add(coordinates, "Coordinate", turn.name, **limits, clamped="false")
    transform = _add(joint, "SpatialTransform")
    # OpenSim needs three axes, even for fewer angles.
    of_kind = {turn.kind: turn.name for turn in bone.turns}
    turns = [(of_kind.get(kind, ""), AXIS[kind]) for kind in dict.fromkeys((*of_kind, *AXIS))]
    moves = [(name if bone.parent is None else "", axis) for name, axis in ROOT_AXES.items()]
    for kind_of_axis, axes in (("rotation", turns), ("translation", moves)):
        for i, (name, axis) in enumerate(axes, start=1):
            element = _add(transform, "TransformAxis", f"{kind_of_axis}{i}", coordinates=name, axis=_numbers(axis))
            if name:
                _add(element, "LinearFunction", "function", coefficients="1 0")


def _draw(body: Element, rig: Armature, bone: Bone) -> None:
    """Add a cylinder for each capsule of a bone."""
    capsules = [c for c in rig.capsules if rig.bones[c.segment] is bone]
    components = _add(body, "components") if capsules else body
    for i, capsule in enumerate(capsules):
        end = writing.y_up_from_z_up(np.array(capsule.end_m))
        # The cylinder lies along y, and the capsule in the x-y plane.
        turn = _numbers([0.0, 0.0, float(np.arctan2(-end[0], end[1]))])
        pose = {"socket_parent": "..", "translation": _numbers(end / 2), "orientation": turn}
        frame = _add(components, "PhysicalOffsetFrame", f"shape_{i}", **pose)
        size = {"radius": repr(capsule.radius_m), "half_height": repr(float(np.linalg.norm(end)) / 2)}
        _add(_add(frame, "attached_geometry"), "Cylinder", "cylinder", **size)


def _write_motion(rig: Armature, path: Path) -> None:
    turns = [turn for bone in rig.bones for turn in bone.turns]
    root = rig.root_m @ np.array([*ROOT_AXES.values()], dtype=float).T
    values = np.column_stack([rig.pose.frames / rig.fps, root, *(turn.angle_rad for turn in turns)])
    columns = ["time", *ROOT_AXES, *(turn.name for turn in turns)]
    sizes = [f"nRows={len(values)}", f"nColumns={len(columns)}"]
    header = ["Coordinates", "version=1", *sizes, "inDegrees=no", "endheader"]
    lines = [*header, "\t".join(columns), *("\t".join(map(repr, row)) for row in values.tolist())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="")


def _add(parent: Element, kind: str, called: str | None = None, **elements: str) -> Element:
    """Add a child with the subelements `elements` to an XML element, and return it; `called` is its name."""
    element = SubElement(parent, kind, {} if called is None else {"name": called})
    for name, text in elements.items():
        SubElement(element, name).text = text
    return element


COLOURS: dict[Side | None, tuple[float, float, float]] = {
    "left": (0.09, 0.46, 0.81),
    "right": (0.79, 0.35, 0.0),
    None: (0.0, 0.34, 0.17),
}
"""Colour of the capsules on each side, as in the playback, linear RGB from 0 to 1."""
_RINGS = 5
"""Number of rings at each end of a capsule."""
_SECTORS = 16
"""Number of sectors around a capsule."""
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_COMPONENTS = {"float32": 5126, "uint32": 5125, "uint16": 5123}


class _Buffer:
    """Binary buffer of a glTF file, with its views and accessors."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: Array, kind: str = "float32") -> int:
        """Add an accessor of values (N,) or (N, width) with their bounds, and return its index."""
        rows = np.asarray(values, dtype=kind).reshape(len(values), -1)
        self.views.append({"buffer": 0, "byteOffset": len(self.content), "byteLength": rows.nbytes})
        self.content += rows.astype(rows.dtype.newbyteorder("<")).tobytes()
        of_rows = {"type": _TYPES[rows.shape[1]], "componentType": _COMPONENTS[kind], "count": len(rows)}
        bounds = {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self.accessors.append({"bufferView": len(self.views) - 1, **of_rows, **bounds})
        return len(self.accessors) - 1


def write_gltf(rig: Armature, path: Path) -> None:
    """Write a binary glTF file of capsules skinned to the bones, with an animation that begins at 0 s."""
    buffer = _Buffer()
    offsets_m = np.concatenate([[bone.offset_m for bone in rig.bones], rig.joint_offsets_m])
    parents = [bone.parent for bone in rig.bones] + list(rig.joint_bones)
    at_rest = _positions_at_rest(offsets_m, parents)
    unbind = np.tile(np.eye(4), (len(parents), 1, 1))
    unbind[:, 3, :3] = -at_rest  # glTF stores matrices by columns
    turns = [_unbroken(Rotation.from_matrix(turned(bone.turns, len(rig.root_m))).as_quat()) for bone in rig.bones]
    names = [*(bone.name for bone in rig.bones), *rig.joints]
    translations = np.concatenate([rig.root_m[:1], offsets_m[1:]]).tolist()
    nodes: list[dict[str, Any]] = [{"name": a, "translation": b} for a, b in zip(names, translations, strict=True)]
    for node, turn in zip(nodes, turns, strict=False):
        node["rotation"] = turn[0].tolist()
    for i, parent in enumerate(parents):
        if parent is not None:
            nodes[parent].setdefault("children", []).append(i)
    skin = {"joints": list(range(len(nodes))), "inverseBindMatrices": buffer.add(unbind.reshape(-1, 16)), "skeleton": 0}
    sides: list[Side | None] = [side for side in COLOURS if any(capsule.side == side for capsule in rig.capsules)]
    primitives = [_primitive(buffer, rig, side, at_rest, i) for i, side in enumerate(sides)]
    animation = _animation(buffer, rig, turns)
    surface = {"metallicFactor": 0.0, "roughnessFactor": 0.7}
    colours = {side or "middle": {"baseColorFactor": [*COLOURS[side], 1.0], **surface} for side in sides}
    materials = [{"name": name, "pbrMetallicRoughness": colour} for name, colour in colours.items()]
    asset = {"version": "2.0", "generator": f"recon {version()}", "extras": {"first_frame": int(rig.pose.frames[0])}}
    document: dict[str, Any] = {
        "asset": asset,
        "scene": 0,
        "scenes": [{"name": rig.title, "nodes": [0, len(nodes)]}],
        "nodes": [*nodes, {"name": rig.name, "mesh": 0, "skin": 0}],
        "skins": [skin],
        "meshes": [{"name": rig.name, "primitives": primitives}],
        "materials": materials,
        "animations": [animation],
        "bufferViews": buffer.views,
        "accessors": buffer.accessors,
        "buffers": [{"byteLength": len(buffer.content)}],
    }
    text = json.dumps(document, ensure_ascii=False).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(buffer.content), b"BIN\0") + buffer.content
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def _positions_at_rest(offsets_m: Array, parents: Sequence[int | None]) -> Array:
    """Return the positions (N, 3) of bones and joints in the pose to which the mesh is bound, with all angles 0."""
    at_rest = np.zeros_like(offsets_m)
    for i, parent in enumerate(parents):
        at_rest[i] = offsets_m[i] + (0.0 if parent is None else at_rest[parent])
    return at_rest


def _animation(buffer: _Buffer, rig: Armature, turns: Sequence[Array]) -> dict[str, Any]:
    """Return the glTF animation of the root's position and of the bones' rotations, which are quaternions (T, 4)."""
    time_s = buffer.add(np.arange(len(rig.root_m)) / rig.fps)
    moved = [(0, "translation", rig.root_m)]
    moved += [(i, "rotation", turns[i]) for i, bone in enumerate(rig.bones) if bone.turns]
    return {
        "name": rig.name,
        "channels": [
            {"sampler": k, "target": {"node": i, "path": path_kind}} for k, (i, path_kind, _) in enumerate(moved)
        ],
        "samplers": [{"input": time_s, "output": buffer.add(values)} for _, _, values in moved],
    }


def _primitive(buffer: _Buffer, rig: Armature, side: Side | None, at_rest: Array, material: int) -> dict[str, Any]:
    """Return the glTF mesh of the capsules on one side, each of which moves with its bone."""
    capsules = [capsule for capsule in rig.capsules if capsule.side == side]
    points, normals = np.swapaxes([_surface(capsule) for capsule in capsules], 0, 1)  # (capsules, N, 3)
    bones = np.array([capsule.segment for capsule in capsules])
    joints = np.repeat(bones, points.shape[1])[:, None] * [1, 0, 0, 0]
    attributes = {
        "POSITION": buffer.add((points + at_rest[bones, None]).reshape(-1, 3)),
        "NORMAL": buffer.add(normals.reshape(-1, 3)),
        "JOINTS_0": buffer.add(joints, "uint16"),
        "WEIGHTS_0": buffer.add(np.tile([1.0, 0.0, 0.0, 0.0], (len(joints), 1))),
    }
    triangles = _TRIANGLES + points.shape[1] * np.arange(len(capsules))[:, None, None]
    return {"attributes": attributes, "indices": buffer.add(triangles.ravel(), "uint32"), "material": material}


def _triangles() -> Array:
    """Return the indices (N, 3) of the points of a capsule's triangles, from pole to pole."""
    ring, sector = np.divmod(np.arange((2 * _RINGS - 1) * _SECTORS), _SECTORS)
    a, b = ring * _SECTORS + sector, ring * _SECTORS + (sector + 1) % _SECTORS
    lower, upper = np.column_stack([a, b, b + _SECTORS]), np.column_stack([a, b + _SECTORS, a + _SECTORS])
    return np.concatenate([lower[ring > 0], upper[ring < 2 * _RINGS - 2]])


_TRIANGLES = _triangles()


def _surface(capsule: Capsule) -> tuple[Array, Array]:
    """Return points and normals (N, 3) of rings around a capsule, from pole to pole, in its bone's frame."""
    end = writing.y_up_from_z_up(np.array(capsule.end_m))
    axis = end / np.linalg.norm(end)
    perpendicular = np.array([0.0, 0.0, 1.0])  # capsules lie in the x-y plane
    quarter = np.linspace(0.0, np.pi / 2, _RINGS)
    latitude = np.concatenate([-quarter[::-1], quarter])[:, None, None]
    longitude = np.linspace(0.0, 2 * np.pi, _SECTORS, endpoint=False)[:, None]
    radial = np.cos(longitude) * perpendicular + np.sin(longitude) * np.cross(axis, perpendicular)
    normals = np.cos(latitude) * radial + np.sin(latitude) * axis
    points = capsule.radius_m * normals
    points[_RINGS:] += end
    return points.reshape(-1, 3), normals.reshape(-1, 3)


def _unbroken(turns: Array) -> Array:
    """Return quaternions (T, 4), each with the sign that brings it nearer to the previous one."""
    signs = np.where(np.einsum("tq,tq->t", turns[1:], turns[:-1]) < 0, -1.0, 1.0)
    return turns * np.cumprod([1.0, *signs])[:, None]
