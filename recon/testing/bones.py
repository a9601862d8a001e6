"""Read bone files as other programs do, to test the output of `recon convert`.

The readers share no code with recon's writers: they use OpenSim's and Blender's Python packages (`pip install opensim
bpy`), bvhio and trimesh, or follow the formats' descriptions with ElementTree, json and scipy.
"""

from __future__ import annotations

import json
import struct
import warnings
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array

Joints = dict[str, Array]
"""Positions (T, 3) of each joint, in metres with y up, keyed by the joint's name."""


def read_mot(path: Path) -> dict[str, list[float]]:
    """Return the columns of a .mot file (OpenSim's motion), keyed by their names."""
    header, _, rows = path.read_text(encoding="utf-8").partition("endheader\n")
    assert "inDegrees=no" in header
    names, *lines = (line.split("\t") for line in rows.splitlines())
    assert f"nRows={len(lines)}\nnColumns={len(names)}\n" in header
    return {name: [float(line[i]) for line in lines] for i, name in enumerate(names)}


def read_osim_as_xml(path: Path) -> Joints:
    """Compute the positions of an OpenSim model's markers in the motion of its .mot file, from the XML alone."""
    model = ElementTree.parse(path).getroot().find("Model")
    assert model is not None
    motion = read_mot(path.with_suffix(".mot"))
    count = len(motion["time"])
    poses: dict[str, tuple[Rotation, Array]] = {"/ground": (Rotation.identity(count), np.zeros((count, 3)))}
    for joint in model.findall("JointSet/objects/*"):
        (frame,) = joint.findall("frames/PhysicalOffsetFrame")
        assert joint.findtext("socket_parent_frame") == frame.get("name")
        assert _numbers(frame, "orientation").tolist() == [0, 0, 0]
        turn, position = poses[frame.findtext("socket_parent") or ""]
        position = position + turn.apply(_numbers(frame, "translation"))
        for kind in ("rotation", "translation"):
            for i in (1, 2, 3):
                axis = joint.find(f"SpatialTransform/TransformAxis[@name='{kind}{i}']")
                name = axis.findtext("coordinates") if axis is not None else None
                if axis is None or not name:
                    continue
                assert joint.find(f"coordinates/Coordinate[@name='{name}']") is not None
                assert axis.findtext("LinearFunction/coefficients") == "1 0"
                values = np.array(motion[name])[:, None] * _numbers(axis, "axis")
                if kind == "rotation":
                    turn = turn * Rotation.from_rotvec(values)
                else:  # The only translating joint has the axes of the ground.
                    position = position + values
        poses[joint.findtext("socket_child_frame") or ""] = turn, position
    joints = {}
    for marker in model.findall("MarkerSet/objects/Marker"):
        turn, position = poses[marker.findtext("socket_parent_frame") or ""]
        joints[marker.get("name") or ""] = position + turn.apply(_numbers(marker, "location"))
    return joints


def _numbers(element: ElementTree.Element, name: str) -> Array:
    return np.array((element.findtext(name) or "").split(), dtype=float)


def read_osim_with_opensim(path: Path) -> Joints:
    """Return the positions of an OpenSim model's markers in the motion of its .mot file, computed by OpenSim."""
    import opensim  # pyright: ignore[reportMissingImports]

    opensim.Logger.setLevelString("error")
    model = opensim.Model(str(path))
    state = model.initSystem()
    coordinates, markers = model.getCoordinateSet(), model.getMarkerSet()
    names = [markers.get(i).getName() for i in range(markers.getSize())]
    motion = opensim.TimeSeriesTable(str(path.with_suffix(".mot")))
    joints: dict[str, list[Array]] = {name: [] for name in names}
    for row in range(motion.getNumRows()):
        for name, value in zip(motion.getColumnLabels(), motion.getRowAtIndex(row).to_numpy(), strict=True):
            coordinates.get(name).setValue(state, float(value), False)
        model.realizePosition(state)
        for name in names:
            joints[name].append(markers.get(name).getLocationInGround(state).to_numpy())
    return {name: np.array(positions) for name, positions in joints.items()}


def read_trc_with_opensim(path: Path) -> Joints:
    """Return the positions of the markers in an OpenSim model's .trc file, read by OpenSim."""
    import opensim  # pyright: ignore[reportMissingImports]

    table = opensim.TimeSeriesTableVec3(str(path.with_suffix(".trc")))
    rows = [table.getRowAtIndex(i) for i in range(table.getNumRows())]
    return {
        name: np.array([[row.getElt(0, j).get(k) for k in range(3)] for row in rows])
        for j, name in enumerate(table.getColumnLabels())
    }


def read_gltf_as_json(path: Path) -> Joints:
    """Compute the positions of a glTF file's nodes during its animation from the JSON and the binary data."""
    content = path.read_bytes()
    magic, version, size, length, kind = struct.unpack_from("<4sIII4s", content)
    assert (magic, version, size, kind) == (b"glTF", 2, len(content), b"JSON")
    document = json.loads(content[20 : 20 + length])
    block = content[28 + length :]

    def values(index: int) -> Array:
        accessor = document["accessors"][index]
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}[accessor["type"]]
        assert accessor["componentType"] == 5126
        count = accessor["count"] * width
        return np.frombuffer(block, "<f4", count, view["byteOffset"]).reshape(-1, width).astype(float)

    (animation,) = document["animations"]
    moved = {}
    for channel in animation["channels"]:
        sampler = animation["samplers"][channel["sampler"]]
        assert sampler.get("interpolation", "LINEAR") == "LINEAR"
        moved[channel["target"]["node"], channel["target"]["path"]] = values(sampler["output"])
    count = len(next(iter(moved.values())))
    joints: Joints = {}

    def add(index: int, turn: Rotation, position: Array) -> None:
        node = document["nodes"][index]
        position = position + turn.apply(moved.get((index, "translation"), node.get("translation", [0, 0, 0])))
        rotation = moved.get((index, "rotation"), np.tile(node.get("rotation", [0, 0, 0, 1]), (count, 1)))
        turn = turn * Rotation.from_quat(rotation)
        joints[node["name"]] = position
        for child in node.get("children", ()):
            add(child, turn, position)

    for index in document["scenes"][document["scene"]]["nodes"]:
        add(index, Rotation.identity(count), np.zeros((count, 3)))
    return joints


def read_gltf_with_trimesh(path: Path) -> Joints:
    """Return the positions of the nodes of a glTF file in frame 0, the only frame that trimesh reads."""
    import trimesh

    graph = trimesh.load_scene(path).graph
    return {name: graph.get(name)[0][None, :3, 3] for name in graph.nodes}


def read_gltf_with_blender(path: Path) -> Joints:
    """Return the positions of the bones' heads in a glTF file, read by Blender."""
    return _read_with_blender(path, lambda blender: blender.ops.import_scene.gltf(filepath=str(path)), first_frame=0)


def read_bvh_with_bvhio(path: Path) -> Joints:
    """Return the positions of the joints in a BVH file, read by bvhio."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # warnings of bvhio's dependencies
        import bvhio

        root, count = bvhio.readAsHierarchy(str(path)), bvhio.readAsBvh(str(path)).FrameCount
    joints: dict[str, list[list[float]]] = {}
    for t in range(count):
        root.loadPose(t)
        for joint, _, _ in root.layout():
            joints.setdefault(joint.Name, []).append(list(joint.PositionWorld))
    return {name: np.array(positions) for name, positions in joints.items()}


def read_bvh_with_blender(path: Path) -> Joints:
    """Return the positions of the bones' heads in a BVH file, read by Blender."""
    return _read_with_blender(
        path, lambda blender: blender.ops.import_anim.bvh(filepath=str(path), frame_start=1), first_frame=1
    )


def _read_with_blender(path: Path, read: Callable[..., object], first_frame: int) -> Joints:
    """Return the positions of the bones' heads with y up in all frames of a file that `read` imports into Blender.

    Blender has z up, and samples a file at the scene's frame rate.
    """
    import bpy  # pyright: ignore[reportMissingImports]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = FPS
    read(bpy)
    (armature,) = (thing for thing in bpy.data.objects if thing.type == "ARMATURE")
    last = int(max(action.frame_range[1] for action in bpy.data.actions))
    joints: dict[str, list[list[float]]] = {}
    for frame in range(first_frame, last + 1):
        bpy.context.scene.frame_set(frame)
        posed = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
        for bone in posed.pose.bones:
            x, y, z = posed.matrix_world @ bone.head
            joints.setdefault(bone.name, []).append([x, z, -y])
    return {name: np.array(positions) for name, positions in joints.items()}


FPS = 60
READERS: dict[str, tuple[tuple[str, Callable[[Path], Joints]], ...]] = {
    ".osim": (
        ("OpenSim, `.osim` and `.mot`", read_osim_with_opensim),
        ("its XML, `.osim` and `.mot`", read_osim_as_xml),
        ("OpenSim, `.trc`", read_trc_with_opensim),
    ),
    ".glb": (
        ("Blender", read_gltf_with_blender),
        ("its JSON", read_gltf_as_json),
        ("trimesh, frame 0", read_gltf_with_trimesh),
    ),
    ".bvh": (("Blender", read_bvh_with_blender), ("bvhio", read_bvh_with_bvhio)),
}


def largest_error_m(joints: Joints, names: tuple[str, ...], xyz_m: Array) -> float:
    """Return the largest coordinate difference in metres between a file's first frames and `xyz_m` (T, J, 3), z up."""
    expected = np.stack([xyz_m[..., 0], xyz_m[..., 2], -xyz_m[..., 1]], axis=2)
    positions = np.stack([joints[name] for name in names], axis=1)
    return float(np.abs(positions - expected[: len(positions)]).max())
