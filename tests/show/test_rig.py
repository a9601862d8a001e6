"""Test that independent readers of OpenSim models, glTF and BVH find bones at the joints."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from command_line import refusal, refused, run, says

from recon.animal.skeleton_file import builtin_names, load_skeleton
from recon.cli.convert import ConvertSettings, convert
from recon.fit.motion import Motion
from recon.io.bones import Armature, write_bvh, write_gltf, write_opensim
from recon.io.positions import read_pose3d
from recon.io.writing import y_up_from_z_up
from recon.show.rig import make_rig, rig_of
from recon.testing import bones

SAMPLES = Path(__file__).parents[2] / "data" / "samples"
FRAMES = np.array([10, 11, 13, 14])
MOST_M = 1e-5


def a_rig(skeleton: str, seed: int = 0) -> Armature:
    """Return a rig in random poses, with a missing frame."""
    body = load_skeleton(skeleton)
    rng = np.random.default_rng(seed)
    states = rng.normal(size=(4, body.n_state))
    states[:, 4:] = body.mean_rad + 1.5 * body.sigma_rad * states[:, 4:]
    return make_rig(body, 1.1, body.keypoint_names("left"), FRAMES, states, 50.0)


@pytest.fixture(params=builtin_names())
def rig(request) -> Armature:
    return a_rig(request.param)


def off_m(rig: Armature, joints: bones.Joints) -> float:
    return bones.largest_error_m(joints, rig.joints, rig.pose.xyz_m)


def test_rig_joints_are_the_joints_of_the_skeleton():
    """Joints are at the skeleton's positions, and are interpolated in a missing frame."""
    body = load_skeleton("cheetah-24")
    states = np.zeros((4, body.n_state))
    states[:, 0], states[:, 3] = FRAMES, [3.0, 3.1, 3.1 - 2 * np.pi, 3.1]  # the last three yaws are nearly equal
    rig = make_rig(body, 2.0, body.markers, FRAMES, states, 50.0)
    assert rig.pose.frames.tolist() == [10, 11, 12, 13, 14]
    for t, row in ((0, 0), (1, 1), (3, 2), (4, 3)):
        np.testing.assert_allclose(rig.pose.xyz_m[t], body.tree.pose(states[[row]], 2.0).points_m[0], atol=1e-12)
    np.testing.assert_allclose(rig.pose.xyz_m[2], rig.pose.xyz_m[1] + [1, 0, 0], atol=1e-12)
    assert [turn.name for bone in rig.bones for turn in bone.turns] == list(body.state_names[3:])


def test_an_opensim_model(rig, tmp_path):
    path = tmp_path / "run.osim"
    write_opensim(rig, path)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.mot", "run.osim", "run.trc"]
    assert off_m(rig, bones.read_osim_as_xml(path)) < 1e-9
    markers = read_pose3d(tmp_path / "run.trc")
    assert (markers.names, markers.fps) == (rig.joints, 50.0)
    assert markers.frames.tolist() == [10, 11, 12, 13, 14]
    np.testing.assert_allclose(markers.xyz_m, rig.pose.xyz_m, atol=1e-12)
    motion = bones.read_mot(tmp_path / "run.mot")
    np.testing.assert_allclose(motion.pop("time"), np.arange(10, 15) / 50)
    model = ElementTree.parse(path).getroot()
    coordinates = {c.get("name"): c for c in model.iter("Coordinate")}
    assert [*motion] == [*coordinates]
    masses = [float(body.findtext("mass") or "nan") for body in model.iter("Body")]
    assert sum(masses) == pytest.approx(1.0 if load_skeleton(rig.name).mass else 0.0)
    assert sum(1 for _ in model.iter("Cylinder")) == len(rig.capsules)


def test_an_opensim_model_has_masses_and_inertias(tmp_path):
    """Masses and inertias agree with solid cylinders, and are equal for left and right.

    The moment of inertia of a slender bone about an axis across it is m L^2 / 12.
    """
    body = load_skeleton("cheetah-24")
    rig = make_rig(body, 1.0, body.markers, np.arange(2), np.zeros((2, body.n_state)), 50.0, body_mass_kg=40.0)
    write_opensim(rig, tmp_path / "run.osim")
    found = {b.get("name"): b for b in ElementTree.parse(tmp_path / "run.osim").getroot().iter("Body")}
    assert sum(float(b.findtext("mass") or "nan") for b in found.values()) == pytest.approx(40.0)
    left, right = (found[f"{side}_hind_shin"] for side in "lr")
    assert [left.findtext(t) for t in ("mass", "inertia")] == [right.findtext(t) for t in ("mass", "inertia")]
    i = next(i for i, bone in enumerate(rig.bones) if bone.name == "l_hind_shin")
    (shin,) = (c for c in rig.capsules if c.segment == i)
    mass, length = rig.bones[i].mass_kg, float(np.linalg.norm(shin.end_m))
    along = y_up_from_z_up(np.array(shin.end_m)) / length
    inertia = rig.bones[i].inertia_kg_m2
    assert along @ inertia @ along == pytest.approx(mass * shin.radius_m**2 / 2)
    assert inertia[2, 2] == pytest.approx(mass * (length**2 / 12 + shin.radius_m**2 / 4))
    np.testing.assert_allclose(rig.bones[i].centre_m, along * length / 2)
    for bone in rig.bones:  # physical inertia: no moment exceeds the sum of the other two
        moments = np.linalg.eigvalsh(bone.inertia_kg_m2)
        assert 0 <= moments[2] <= moments[:2].sum() * (1 + 1e-9)


def test_opensim_supports_a_still_animal_with_its_weight(tmp_path):
    opensim = pytest.importorskip("opensim")
    body = load_skeleton("cheetah-24")
    still = np.tile(np.concatenate([np.zeros(4), body.mean_rad]), (20, 1))
    write_opensim(make_rig(body, 1.0, body.markers, np.arange(20), still, 50.0, body_mass_kg=40.0), tmp_path / "a.osim")
    model, tool = opensim.Model(str(tmp_path / "a.osim")), opensim.InverseDynamicsTool()
    assert model.getTotalMass(model.initSystem()) == pytest.approx(40.0)
    tool.setModel(model)
    tool.setCoordinatesFileName(str(tmp_path / "a.mot"))
    tool.setResultsDir(str(tmp_path))
    tool.setOutputGenForceFileName("forces.sto")
    assert tool.run()
    up = opensim.TimeSeriesTable(str(tmp_path / "forces.sto")).getDependentColumn("z_m_force").to_numpy()
    np.testing.assert_allclose(up, 40.0 * 9.80665, rtol=1e-3)


def test_coordinates_of_an_opensim_model_are_the_skeletons(tmp_path):
    """Coordinates have the names, values and ranges of the skeleton's angles."""
    rig, body = a_rig("cheetah-24"), load_skeleton("cheetah-24")
    write_opensim(rig, tmp_path / "run.osim")
    motion = bones.read_mot(tmp_path / "run.mot")
    assert tuple(motion)[1:] == body.state_names
    np.testing.assert_allclose(
        [motion["x_m"], motion["y_m"], motion["z_m"]], rig.root_m[:, [0, 2, 1]].T * [[1], [-1], [1]]
    )
    model = ElementTree.parse(tmp_path / "run.osim").getroot()
    (pitch,) = (c for c in model.iter("Coordinate") if c.get("name") == "l_fore_lower_pitch")
    k = body.state_names.index("l_fore_lower_pitch") - 4
    low, high = map(float, (pitch.findtext("range") or "").split())
    assert (low + high) / 2 == pytest.approx(body.mean_rad[k]) == pytest.approx(float(pitch.findtext("default_value")))
    assert (high - low) / 6 == pytest.approx(body.sigma_rad[k])
    assert pitch.findtext("clamped") == "false"


def test_bvh(rig, tmp_path):
    path = tmp_path / "run.bvh"
    write_bvh(rig, path)
    assert off_m(rig, bones.read_bvh_with_bvhio(path)) < MOST_M
    found = read_pose3d(path, unit="m")
    at = [found.names.index(name) for name in rig.joints]
    np.testing.assert_allclose(found.xyz_m[:, at], rig.pose.xyz_m, atol=1e-12)
    assert found.fps == 50
    text = path.read_text()
    assert text.count("position") == 3  # the root's three coordinates
    for bone, parent in ((b, rig.bones[b.parent]) for b in rig.bones if b.parent is not None):
        position, above = (found.xyz_m[:, found.names.index(b.name)] for b in (bone, parent))
        np.testing.assert_allclose(np.linalg.norm(position - above, axis=1), np.linalg.norm(bone.offset_m), atol=1e-12)


def test_gltf(rig, tmp_path):
    path = tmp_path / "run.glb"
    write_gltf(rig, path)
    assert off_m(rig, bones.read_gltf_as_json(path)) < MOST_M
    assert off_m(rig, bones.read_gltf_with_trimesh(path)) < MOST_M


def test_the_mesh_of_a_gltf_file(tmp_path):
    """The mesh has a closed capsule around each bone with all angles 0, which moves with the bone."""
    import trimesh

    rig = a_rig("cheetah-24")
    write_gltf(rig, tmp_path / "run.glb")
    scene = trimesh.load_scene(tmp_path / "run.glb")
    assert {mesh.visual.material.name for mesh in scene.geometry.values()} == {"left", "right", "middle"}
    for mesh in scene.geometry.values():
        of_it = [c for c in rig.capsules if (c.side or "middle") == mesh.visual.material.name]
        for faces, capsule in zip(np.split(mesh.faces, len(of_it)), of_it, strict=True):
            part = trimesh.Trimesh(mesh.vertices, faces, process=True)
            r, length = capsule.radius_m, np.linalg.norm(capsule.end_m)
            exact = np.pi * r**2 * (length + 4 / 3 * r)
            assert part.is_watertight
            assert 0.9 * exact < part.volume < exact
    content = (tmp_path / "run.glb").read_bytes()
    document = json.loads(content[20 : 20 + struct.unpack_from("<I", content, 12)[0]])
    (skin,) = document["skins"]
    assert [document["nodes"][i]["name"] for i in skin["joints"]] == [b.name for b in rig.bones] + list(rig.joints)


def test_a_bone_has_another_name_than_a_joint():
    """Bones have other names than joints even if a marker has the name of a segment, such as neck."""
    body = load_skeleton("quadruped")
    names = tuple("neck" if name == "neck_base" else name for name in body.markers)
    rig = make_rig(body, 1.0, names, np.arange(2), np.zeros((2, body.n_state)), 50.0)
    assert "neck_bone" in [bone.name for bone in rig.bones]
    assert "neck_pitch" in [turn.name for bone in rig.bones for turn in bone.turns]


@pytest.mark.parametrize("write", [write_opensim, write_bvh])
def test_names_with_blanks_are_refused(write, tmp_path):
    rig = replace(a_rig("cheetah-24"), joints=("left ear", *load_skeleton("cheetah-24").markers[1:]))
    kind = "OpenSim model" if write is write_opensim else "BVH"
    with refusal((kind, "name", ["'left ear'", "' '"])):
        write(rig, tmp_path / "a")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("extension", bones.READERS)
def test_recon_convert(whole_results, tmp_path, extension):
    out = tmp_path / f"run{extension}"
    ended = run("convert", whole_results, out)
    assert (ended.code, ended.err) == (0, "")
    results = Motion.load(whole_results)
    name = {".osim": "its XML, `.osim` and `.mot`", ".glb": "its JSON", ".bvh": "bvhio"}[extension]
    joints = dict(bones.READERS[extension])[name](out)
    assert bones.largest_error_m(joints, results.names, results.upright.xyz_m) < 1e-3
    beside = [f"{tmp_path}/run.mot", f"{tmp_path}/run.trc"] if extension == ".osim" else []
    said = [line for line in ended.out.splitlines() if line.startswith("Also written")]
    assert said == ([f"Also written: {', '.join(beside)}."] if beside else [])
    for there in ([str(out)], beside, beside[1:]):  # neighbouring files are checked before anything is written
        if there:
            refused(["convert", whole_results, out], *(("OUT", "file", path, "--overwrite") for path in there))
            Path(there[0]).unlink()
    if beside:
        foreign, option = tmp_path / "run.mot", ["--overwrite"]
        foreign.write_text("a user's")
        for more in ([], option):
            refused(["convert", whole_results, out, *more], (foreign, "file", "did not write", "moved away"))
        assert {path.name for path in tmp_path.iterdir()} == {".recon.json", "run.mot"}
        assert foreign.read_text() == "a user's"


def with_solution(motion: Motion, **changes) -> Motion:
    return replace(motion, solution=replace(motion.solution, **changes))


def test_frames_without_a_pose(whole_results):
    results = Motion.load(whole_results)
    states, xyz_m = results.states.copy(), results.upright.xyz_m.copy()
    for rows in (slice(0, 2), slice(5, 7), slice(9, 10)):
        states[rows] = xyz_m[rows] = np.nan
    rig = rig_of(with_solution(results, states=states, joints_m=xyz_m))
    assert [says(note, "interpolated: frames 5-6, 9") for note in rig.notes] == [True]
    assert rig.pose.frames.tolist() == list(range(2, 60))
    np.testing.assert_allclose(rig.pose.xyz_m[[0, 2, 8, -1]], xyz_m[[2, 4, 10, 59]], atol=1e-8)
    assert np.isfinite(rig.pose.xyz_m).all()
    with refusal((SAMPLES / "whole.csv", "frames", "no frame with a pose")):
        rig_of(with_solution(results, states=np.nan * states))
    longer = results.upright.xyz_m * np.linspace(1, 1.1, 60)[:, None, None]
    with refusal((SAMPLES / "whole.csv", "size", "lengths that change", "constant length")):
        rig_of(with_solution(results, joints_m=longer))


def test_points_cannot_be_written_as_bones(tmp_path):
    for name, kind in (("whole.csv", "2D keypoints"), ("whole_truth.csv", "3D positions")):
        with refusal((SAMPLES / name, "content", kind, ["results", "BVH"])):
            convert(ConvertSettings(source=SAMPLES / name, out=tmp_path / "a.bvh"))
    assert list(tmp_path.iterdir()) == []
