"""A glTF 2.0 file (.glb): capsules around an animal's bones, which a skin moves as the animal did.

Metres, y up (see `recon.io.bones`); the animation begins at 0 s. Joints are bones as well, that end limbs.
"""

from __future__ import annotations

import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from recon.animal.body import Side
from recon.animal.capsules import Capsule
from recon.base.arrays import Array
from recon.base.package import version
from recon.io.bones import Armature, turned
from recon.io.pose import y_up_from_z_up

COLOURS: dict[Side | None, tuple[float, float, float]] = {
    "left": (0.09, 0.46, 0.81),
    "right": (0.79, 0.35, 0.0),
    None: (0.0, 0.34, 0.17),
}
"""Linear, of the playback's."""
_RINGS, _SECTORS = 5, 16
"""The numbers of rings of either end of a capsule, and of sectors around it."""
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4", 16: "MAT4"}
_COMPONENTS = {"float32": 5126, "uint32": 5125, "uint16": 5123}


class _Buffer:
    """The numbers of a file: accessors into one block of bytes."""

    def __init__(self) -> None:
        self.content = bytearray()
        self.views: list[dict[str, Any]] = []
        self.accessors: list[dict[str, Any]] = []

    def add(self, values: Array, kind: str = "float32") -> int:
        """An accessor of values (N,) or (N, width), with their bounds."""
        rows = np.asarray(values, dtype=kind).reshape(len(values), -1)
        self.views.append({"buffer": 0, "byteOffset": len(self.content), "byteLength": rows.nbytes})
        self.content += rows.astype(rows.dtype.newbyteorder("<")).tobytes()
        self.accessors.append(
            {
                "bufferView": len(self.views) - 1,
                "componentType": _COMPONENTS[kind],
                "count": len(rows),
                "type": _TYPES[rows.shape[1]],
                "min": rows.min(axis=0).tolist(),
                "max": rows.max(axis=0).tolist(),
            }
        )
        return len(self.accessors) - 1


def write(rig: Armature, path: Path) -> None:
    buffer = _Buffer()
    offsets_m = np.concatenate([[bone.offset_m for bone in rig.bones], rig.joint_offsets_m])
    parents = [bone.parent for bone in rig.bones] + list(rig.joint_bones)
    at_rest = np.zeros_like(offsets_m)  # with all angles 0, where the mesh is bound
    for i, parent in enumerate(parents):
        at_rest[i] = offsets_m[i] + (0.0 if parent is None else at_rest[parent])
    unbind = np.tile(np.eye(4), (len(parents), 1, 1))
    unbind[:, 3, :3] = -at_rest  # by columns
    turns = [_unbroken(Rotation.from_matrix(turned(bone.turns, len(rig.root_m))).as_quat()) for bone in rig.bones]
    names = [*(bone.name for bone in rig.bones), *rig.joints]
    nodes: list[dict[str, Any]] = [
        {"name": name, "translation": offset_m.tolist()} for name, offset_m in zip(names, offsets_m, strict=True)
    ]
    nodes[0]["translation"] = rig.root_m[0].tolist()
    for node, turn in zip(nodes, turns, strict=False):
        node["rotation"] = turn[0].tolist()
    for i, parent in enumerate(parents):
        if parent is not None:
            nodes[parent].setdefault("children", []).append(i)
    skin = {"joints": list(range(len(nodes))), "inverseBindMatrices": buffer.add(unbind.reshape(-1, 16)), "skeleton": 0}
    sides: list[Side | None] = [side for side in COLOURS if any(capsule.side == side for capsule in rig.capsules)]
    primitives = [_primitive(buffer, rig, side, at_rest, i) for i, side in enumerate(sides)]
    time_s = buffer.add(np.arange(len(rig.root_m)) / rig.fps)
    moved = [(0, "translation", rig.root_m)]
    moved += [(i, "rotation", turns[i]) for i, bone in enumerate(rig.bones) if bone.turns]
    animation = {
        "name": rig.name,
        "channels": [{"sampler": k, "target": {"node": i, "path": what}} for k, (i, what, _) in enumerate(moved)],
        "samplers": [{"input": time_s, "output": buffer.add(values)} for _, _, values in moved],
    }
    surface = {"metallicFactor": 0.0, "roughnessFactor": 0.7}
    materials = [
        {"name": side or "middle", "pbrMetallicRoughness": {"baseColorFactor": [*COLOURS[side], 1.0], **surface}}
        for side in sides
    ]
    about = {"version": "2.0", "generator": f"recon {version()}", "extras": {"first_frame": int(rig.pose.frames[0])}}
    document: dict[str, Any] = {
        "asset": about,
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


def _primitive(buffer: _Buffer, rig: Armature, side: Side | None, at_rest: Array, material: int) -> dict[str, Any]:
    """The capsules of one side, each moved by its own bone."""
    points, normals, triangles, bones = [], [], [], []
    for capsule in rig.capsules:
        if capsule.side == side:
            of_it, normal = _surface(capsule)
            triangles.append(_TRIANGLES + sum(map(len, points)))
            points.append(at_rest[capsule.segment] + of_it)
            normals.append(normal)
            bones.append(np.full(len(of_it), capsule.segment))
    joints = np.concatenate(bones)[:, None] * [1, 0, 0, 0]
    return {
        "attributes": {
            "POSITION": buffer.add(np.concatenate(points)),
            "NORMAL": buffer.add(np.concatenate(normals)),
            "JOINTS_0": buffer.add(joints, "uint16"),
            "WEIGHTS_0": buffer.add(np.tile([1.0, 0.0, 0.0, 0.0], (len(joints), 1))),
        },
        "indices": buffer.add(np.concatenate(triangles).ravel(), "uint32"),
        "material": material,
    }


def _triangles() -> Array:
    """(N, 3): between the points of neighbouring rings, from pole to pole."""
    ring, sector = np.divmod(np.arange((2 * _RINGS - 1) * _SECTORS), _SECTORS)
    a, b = ring * _SECTORS + sector, ring * _SECTORS + (sector + 1) % _SECTORS
    lower, upper = np.column_stack([a, b, b + _SECTORS]), np.column_stack([a, b + _SECTORS, a + _SECTORS])
    return np.concatenate([lower[ring > 0], upper[ring < 2 * _RINGS - 2]])


_TRIANGLES = _triangles()


def _surface(capsule: Capsule) -> tuple[Array, Array]:
    """Points and normals (N, 3) of rings around the capsule from its first pole to the other, in its bone's frame."""
    end = y_up_from_z_up(np.array(capsule.end_m))
    along = end / np.linalg.norm(end)
    beside = np.array([0.0, 0.0, 1.0])  # capsules lie in the x-y plane
    quarter = np.linspace(0.0, np.pi / 2, _RINGS)
    latitude = np.concatenate([-quarter[::-1], quarter])[:, None, None]
    longitude = np.linspace(0.0, 2 * np.pi, _SECTORS, endpoint=False)[:, None]
    around = np.cos(longitude) * beside + np.sin(longitude) * np.cross(along, beside)
    normals = np.cos(latitude) * around + np.sin(latitude) * along
    points = capsule.radius_m * normals
    points[_RINGS:] += end
    return points.reshape(-1, 3), normals.reshape(-1, 3)


def _unbroken(turns: Array) -> Array:
    """Quaternions (T, 4) with the sign that is nearer to the one before."""
    signs = np.where(np.einsum("tq,tq->t", turns[1:], turns[:-1]) < 0, -1.0, 1.0)
    return turns * np.cumprod([1.0, *signs])[:, None]
