"""An OpenSim model (.osim), with its motion (.mot) and its markers' paths (.trc) beside it.

Metres, rad, kg, y up (see `recon.io.bones`). Without masses in the skeleton bodies have none: the model is for
kinematics then. Times are as in the keypoint file.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from recon.base.arrays import Array
from recon.io import trc
from recon.io.bones import AXIS, Armature, Bone
from recon.io.common import require_names
from recon.io.pose import y_up_from_z_up

TITLE = "OpenSim model"
VERSION = "40000"
PLACE = {"x_m": (1, 0, 0), "y_m": (0, 0, -1), "z_m": (0, 1, 0)}
"""Coordinates of the root's origin, and along which axes they lie."""


def write(rig: Armature, path: Path) -> None:
    """The model, and its motion and markers under the same name. Raises InputError for names with blanks or slashes."""
    require_names([bone.name for bone in rig.bones] + list(rig.joints), r"[\s/\\*+]", TITLE)
    document = Element("OpenSimDocument", Version=VERSION)
    model = SubElement(document, "Model", name=rig.name)
    _texts(model, credits=f"recon, from {rig.title}", length_units="meters", force_units="N")
    bodies, joints, markers = (
        SubElement(SubElement(model, kind, name=kind.lower()), "objects")
        for kind in ("BodySet", "JointSet", "MarkerSet")
    )
    for bone in rig.bones:
        body = SubElement(bodies, "Body", name=bone.name)
        _draw(body, rig, bone)
        moments = _numbers(bone.inertia_kg_m2[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
        _texts(body, mass=repr(bone.mass_kg), mass_center=_numbers(bone.centre_m), inertia=moments)
        _join(joints, rig, bone)
    for name, at, offset_m in zip(rig.joints, rig.joint_bones, rig.joint_offsets_m, strict=True):
        marker = SubElement(markers, "Marker", name=name)
        _texts(marker, socket_parent_frame=f"/bodyset/{rig.bones[at].name}", location=_numbers(offset_m))
    indent(document)
    text = '<?xml version="1.0" encoding="UTF-8"?>\n' + tostring(document, encoding="unicode") + "\n"
    path.write_text(text, encoding="utf-8", newline="")
    _write_motion(rig, path.with_suffix(".mot"))
    trc.write(rig.pose, path.with_suffix(".trc"))


def _join(joints: Element, rig: Armature, bone: Bone) -> None:
    """To its parent, or the ground."""
    is_root = bone.parent is None
    joint = SubElement(joints, "CustomJoint" if bone.turns else "WeldJoint", name=bone.name)
    above = "/ground" if bone.parent is None else f"/bodyset/{rig.bones[bone.parent].name}"
    _texts(joint, socket_parent_frame="origin", socket_child_frame=f"/bodyset/{bone.name}")
    if bone.turns:
        coordinates = SubElement(joint, "coordinates")
        for name in PLACE if is_root else ():
            _texts(SubElement(coordinates, "Coordinate", name=name), clamped="false")
        for turn in bone.turns:
            coordinate = SubElement(coordinates, "Coordinate", name=turn.name)
            _texts(coordinate, default_value=repr(turn.mean_rad), range=_numbers(turn.range_rad), clamped="false")
    origin = SubElement(SubElement(joint, "frames"), "PhysicalOffsetFrame", name="origin")
    _texts(origin, socket_parent=above, translation=_numbers(bone.offset_m), orientation="0 0 0")
    if not bone.turns:
        return
    transform = SubElement(joint, "SpatialTransform")
    # Three axes are needed, also where there are fewer angles.
    of_kind = {turn.kind: turn.name for turn in bone.turns}
    kinds = dict.fromkeys((*of_kind, *AXIS))
    turns = [(of_kind.get(kind, ""), AXIS[kind]) for kind in kinds]
    moves = [(name if is_root else "", axis) for name, axis in PLACE.items()]
    for what, axes in (("rotation", turns), ("translation", moves)):
        for i, (name, axis) in enumerate(axes, start=1):
            element = SubElement(transform, "TransformAxis", name=f"{what}{i}")
            _texts(element, coordinates=name, axis=_numbers(axis))
            if name:
                _texts(SubElement(element, "LinearFunction", name="function"), coefficients="1 0")


def _draw(body: Element, rig: Armature, bone: Bone) -> None:
    """Cylinders where its capsules are."""
    of_it = [c for c in rig.capsules if rig.bones[c.segment] is bone]
    components = SubElement(body, "components") if of_it else body
    for i, capsule in enumerate(of_it):
        end = y_up_from_z_up(np.array(capsule.end_m))
        frame = SubElement(components, "PhysicalOffsetFrame", name=f"shape_{i}")
        cylinder = SubElement(SubElement(frame, "attached_geometry"), "Cylinder", name="cylinder")
        _texts(cylinder, radius=repr(capsule.radius_m), half_height=repr(float(np.linalg.norm(end)) / 2))
        # It lies along y, and the capsule in the x-y plane.
        _texts(frame, socket_parent="..", translation=_numbers(end / 2))
        _texts(frame, orientation=_numbers([0.0, 0.0, float(np.arctan2(-end[0], end[1]))]))


def _write_motion(rig: Armature, path: Path) -> None:
    turns = [turn for bone in rig.bones for turn in bone.turns]
    place = rig.root_m @ np.array([*PLACE.values()], dtype=float).T
    values = np.column_stack([rig.pose.frames / rig.fps, place, *(turn.angle_rad for turn in turns)])
    columns = ["time", *PLACE, *(turn.name for turn in turns)]
    sizes = [f"nRows={len(values)}", f"nColumns={len(columns)}"]
    header = ["Coordinates", "version=1", *sizes, "inDegrees=no", "endheader"]
    lines = [*header, "\t".join(columns), *("\t".join(map(repr, row)) for row in values.tolist())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8", newline="")


def _texts(parent: Element, **elements: str) -> None:
    for name, text in elements.items():
        SubElement(parent, name).text = text


def _numbers(values: Array | tuple[float, ...] | list[float]) -> str:
    return " ".join(map(repr, np.asarray(values).tolist()))
