"""How far joints are off in what `recon convert` writes of bones, as programs and libraries of others have them.

python benchmarks/bones.py

Of the samples' fits, a whole animal and a chain: a row for each format and reader that is installed. The readers here
share nothing with recon: OpenSim's Python package and Blender's (`pip install opensim bpy`), bvhio, trimesh, and, for
where the first two cannot be installed, what their formats' descriptions say, with ElementTree, json and scipy.
"""

from __future__ import annotations

import json
import struct
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from markdown_table import print_header, print_row
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Joints = dict[str, Array]
"""(T, 3) by name, metres, y up."""


# -- OpenSim ---------------------------------------------------------------------------------------------------------


def table_of(path: Path) -> dict[str, list[float]]:
    """Columns of a .mot file."""
    header, _, rows = path.read_text(encoding="utf-8").partition("endheader\n")
    assert "inDegrees=no" in header
    names, *lines = (line.split("\t") for line in rows.splitlines())
    assert f"nRows={len(lines)}\nnColumns={len(names)}\n" in header
    return {name: [float(line[i]) for line in lines] for i, name in enumerate(names)}


def osim_by_its_xml(path: Path) -> Joints:
    """Markers of a model in the motion beside it."""
    model = ElementTree.parse(path).getroot().find("Model")
    assert model is not None
    motion = table_of(path.with_suffix(".mot"))
    count = len(motion["time"])
    poses: dict[str, tuple[Rotation, Array]] = {"/ground": (Rotation.identity(count), np.zeros((count, 3)))}
    for joint in model.findall("JointSet/objects/*"):
        (frame,) = joint.findall("frames/PhysicalOffsetFrame")
        assert joint.findtext("socket_parent_frame") == frame.get("name")
        assert _numbers(frame, "orientation").tolist() == [0, 0, 0]
        turn, place = poses[frame.findtext("socket_parent") or ""]
        place = place + turn.apply(_numbers(frame, "translation"))
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
                else:  # along the axes of the joint's frame, which for the only one that moves are the ground's
                    place = place + values
        poses[joint.findtext("socket_child_frame") or ""] = turn, place
    found = {}
    for marker in model.findall("MarkerSet/objects/Marker"):
        turn, place = poses[marker.findtext("socket_parent_frame") or ""]
        found[marker.get("name") or ""] = place + turn.apply(_numbers(marker, "location"))
    return found


def _numbers(element: ElementTree.Element, name: str) -> Array:
    return np.array((element.findtext(name) or "").split(), dtype=float)


def osim_by_opensim(path: Path) -> Joints:
    import opensim  # pyright: ignore[reportMissingImports]

    opensim.Logger.setLevelString("error")
    model = opensim.Model(str(path))
    state = model.initSystem()
    coordinates, markers = model.getCoordinateSet(), model.getMarkerSet()
    names = [markers.get(i).getName() for i in range(markers.getSize())]
    motion = opensim.TimeSeriesTable(str(path.with_suffix(".mot")))
    found: dict[str, list[Array]] = {name: [] for name in names}
    for row in range(motion.getNumRows()):
        for name, value in zip(motion.getColumnLabels(), motion.getRowAtIndex(row).to_numpy(), strict=True):
            coordinates.get(name).setValue(state, float(value), False)
        model.realizePosition(state)
        for name in names:
            found[name].append(markers.get(name).getLocationInGround(state).to_numpy())
    return {name: np.array(places) for name, places in found.items()}


def trc_by_opensim(path: Path) -> Joints:
    import opensim  # pyright: ignore[reportMissingImports]

    table = opensim.TimeSeriesTableVec3(str(path.with_suffix(".trc")))
    rows = [table.getRowAtIndex(i) for i in range(table.getNumRows())]
    return {
        name: np.array([[row.getElt(0, j).get(k) for k in range(3)] for row in rows])
        for j, name in enumerate(table.getColumnLabels())
    }


# -- glTF ------------------------------------------------------------------------------------------------------------


def gltf_by_its_json(path: Path) -> Joints:
    """The nodes of a skin, moved by the animation, linearly between its times."""
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
    found: Joints = {}

    def add(index: int, turn: Rotation, place: Array) -> None:
        node = document["nodes"][index]
        place = place + turn.apply(moved.get((index, "translation"), node.get("translation", [0, 0, 0])))
        rotation = moved.get((index, "rotation"), np.tile(node.get("rotation", [0, 0, 0, 1]), (count, 1)))
        turn = turn * Rotation.from_quat(rotation)
        found[node["name"]] = place
        for child in node.get("children", ()):
            add(child, turn, place)

    for index in document["scenes"][document["scene"]]["nodes"]:
        add(index, Rotation.identity(count), np.zeros((count, 3)))
    return found


def gltf_by_trimesh(path: Path) -> Joints:
    """In the first frame, which is all that trimesh reads."""
    import trimesh

    graph = trimesh.load_scene(path).graph
    return {name: graph.get(name)[0][None, :3, 3] for name in graph.nodes}


def gltf_by_blender(path: Path) -> Joints:
    return _by_blender(path, lambda bpy: bpy.ops.import_scene.gltf(filepath=str(path)), first_frame=0)


# -- BVH -------------------------------------------------------------------------------------------------------------


def bvh_by_bvhio(path: Path) -> Joints:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its dependencies
        import bvhio

        root, count = bvhio.readAsHierarchy(str(path)), bvhio.readAsBvh(str(path)).FrameCount
    found: dict[str, list[list[float]]] = {}
    for t in range(count):
        root.loadPose(t)
        for joint, _, _ in root.layout():
            found.setdefault(joint.Name, []).append(list(joint.PositionWorld))
    return {name: np.array(places) for name, places in found.items()}


def bvh_by_blender(path: Path) -> Joints:
    return _by_blender(path, lambda bpy: bpy.ops.import_anim.bvh(filepath=str(path), frame_start=1), first_frame=1)


def _by_blender(path: Path, read: Callable[..., object], first_frame: int) -> Joints:
    """Bones' heads. Blender has z up, and frames of its own: a file's times have to be of the scene's rate."""
    import bpy  # pyright: ignore[reportMissingImports]

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.fps = FPS
    read(bpy)
    (armature,) = (thing for thing in bpy.data.objects if thing.type == "ARMATURE")
    last = int(max(action.frame_range[1] for action in bpy.data.actions))
    found: dict[str, list[list[float]]] = {}
    for frame in range(first_frame, last + 1):
        bpy.context.scene.frame_set(frame)
        posed = armature.evaluated_get(bpy.context.evaluated_depsgraph_get())
        for bone in posed.pose.bones:
            x, y, z = posed.matrix_world @ bone.head
            found.setdefault(bone.name, []).append([x, z, -y])
    return {name: np.array(places) for name, places in found.items()}


# -- all -------------------------------------------------------------------------------------------------------------

FPS = 60
READERS: dict[str, tuple[tuple[str, Callable[[Path], Joints]], ...]] = {
    ".osim": (
        ("OpenSim, `.osim` and `.mot`", osim_by_opensim),
        ("its XML, `.osim` and `.mot`", osim_by_its_xml),
        ("OpenSim, `.trc`", trc_by_opensim),
    ),
    ".glb": (("Blender", gltf_by_blender), ("its JSON", gltf_by_its_json), ("trimesh, frame 0", gltf_by_trimesh)),
    ".bvh": (("Blender", bvh_by_blender), ("bvhio", bvh_by_bvhio)),
}


def worst_m(found: Joints, names: tuple[str, ...], xyz_m: Array) -> float:
    """The largest distance along an axis from joints (T, J, 3), z up, in the frames that were read from the start."""
    expected = np.stack([xyz_m[..., 0], xyz_m[..., 2], -xyz_m[..., 1]], axis=2)
    places = np.stack([found[name] for name in names], axis=1)
    return float(np.abs(places - expected[: len(places)]).max())


def main() -> None:
    from recon import FitSettings
    from recon.fit.motion import Motion
    from recon.workflows.clip_results import run_clip
    from recon.workflows.convert import ConvertSettings, convert

    samples = Path(__file__).resolve().parents[1] / "data" / "samples"
    print_header(["file", "read by", "whole animal, mm", "chain, mm"])
    with tempfile.TemporaryDirectory() as folder:
        clips = {}
        for clip, skeleton in (("whole", None), ("noisy", "cheetah-8u")):
            camera, out = samples / "camera.toml", Path(folder) / clip
            run_clip(
                FitSettings(keypoints=(samples / f"{clip}.csv",), camera=(camera,), fps=FPS, skeleton=skeleton), out
            )
            clips[clip] = Motion.load(out).upright
        for extension, readers in READERS.items():
            for clip in clips:
                convert(ConvertSettings(source=Path(folder) / clip, out=Path(folder) / f"{clip}{extension}"))
            for name, read in readers:
                try:
                    off = [
                        worst_m(read(Path(folder) / f"{clip}{extension}"), pose.names, pose.xyz_m)
                        for clip, pose in clips.items()
                    ]
                except ImportError as error:
                    print_row([f"`{extension}`", name, f"not installed: {error.name}", ""])
                else:
                    print_row([f"`{extension}`", name, *(f"{1000 * one:.1g}" for one in off)])


if __name__ == "__main__":
    main()
