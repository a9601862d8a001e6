import json

import cv2
import numpy as np
import pandas as pd
import pytest
import tomli_w
from command_line import refusal
from scipy.spatial.transform import Rotation

from recon.base.errors import InputError
from recon.geometry.camera import Camera
from recon.io.calibration import read_camera, read_cameras
from recon.io.camera_files import write_camera

K = [[960.5, 0.0, 945.8], [0.0, 968.4, 584.5], [0.0, 0.0, 1.0]]
FISHEYE = [0.129, -0.0481, -0.0122, 0.0133]
RADTAN = [-0.28, 0.09, 1.1e-3, -7e-4, 0.02]
R = Rotation.from_euler("xyz", (-1.8, 0.2, 0.1)).as_matrix()
T = [0.3, 1.2, -0.4]
SIZE = (1920, 1080)


def opencv_text(suffix: str, **values) -> str:
    """Return the text of OpenCV's file with these arrays and numbers."""
    storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    for key, value in values.items():
        storage.write(key, np.asarray(value, dtype=float) if isinstance(value, list | np.ndarray) else value)
    return storage.releaseAndGetString()


def opencv_values(**more):
    defaults = {"camera_matrix": K, "distortion_coefficients": [RADTAN], "image_width": 1920, "image_height": 1080}
    return {key: value for key, value in (defaults | more).items() if value is not None}


def scene(**changes) -> dict:
    camera = {"k": K, "d": [[x] for x in FISHEYE], "r": R.tolist(), "t": [[x] for x in T]} | changes
    return {"camera_resolution": list(SIZE), "cameras": [camera, {**camera}]}


def anipose(*sections: str, **changes) -> dict:
    rotvec = Rotation.from_matrix(R).as_rotvec().tolist()
    table = {"size": list(SIZE), "matrix": K, "distortions": RADTAN, "rotation": rotvec, "translation": T} | changes
    cameras = {section: {"name": section, **table} for section in sections}
    return cameras | {"metadata": {"adjusted": False, "error": 0.0}}


def own_table(**changes) -> dict:
    camera = Camera("left", K, FISHEYE, "fisheye", SIZE, R, T)
    return {"camera": {"format": "recon-camera", "version": 1, **camera.to_dict(), **changes}}


@pytest.fixture
def write(tmp_path):
    def write_file(name: str, content):
        path = tmp_path / name
        if isinstance(content, dict):
            content = json.dumps(content) if path.suffix == ".json" else tomli_w.dumps(content)
        path.write_text(content, encoding="utf-8")
        return path

    return write_file


def refuses(path, *expected, name=None, **options) -> None:
    """Check that reading a file raises these problems, given as for `refusal` but without the file."""
    with refusal(*((path, *one) for one in expected)):
        read_camera(path, name, **options)


def both(field: str, *values):
    """Return one problem for each of the two cameras of `scene`."""
    return [(f"cameras[{i}].{field}", *values) for i in (0, 1)]


def assert_camera(camera, distortion, model, posed=False, world_z_up=True):
    np.testing.assert_array_equal(camera.matrix, K)
    np.testing.assert_array_equal(camera.distortion, distortion)
    assert (camera.model, camera.image_size_px, camera.world_z_up) == (model, SIZE, world_z_up)
    assert camera.has_extrinsics == posed
    if posed:
        np.testing.assert_allclose(camera.rotation, R, atol=1e-12)
        np.testing.assert_array_equal(camera.translation_m, T)


class TestOpenCV:
    @pytest.mark.parametrize("suffix", [".yml", ".yaml", ".json", ".xml"])
    def test_as_opencv_writes_it(self, write, suffix):
        path = write(f"camera{suffix}", opencv_text(suffix, **opencv_values()))
        assert_camera(read_camera(path), RADTAN, "radtan", world_z_up=False)

    @pytest.mark.parametrize(
        "header", ["%YAML:1.0\n---\n", "%YAML 1.2\n---\n", "%YAML:1.0\n", "---\n", "", "# by hand\n\n"]
    )
    def test_every_header(self, write, header):
        body = opencv_text(".yml", **opencv_values()).partition("---\n")[2]
        assert_camera(read_camera(write("camera.yml", header + body)), RADTAN, "radtan", world_z_up=False)

    def test_json_with_opencv_4_numbers(self, write):
        text = opencv_text(".json", **opencv_values(distortion_coefficients=[[0, 0, 0, 0, 1.0]])).replace("1.0", "1.")
        assert read_camera(write("camera.json", text)).distortion.tolist() == [0, 0, 0, 0, 1]

    def test_plain_json(self, write):
        values = {"K": K, "dist_coeffs": RADTAN, "width": 1920, "height": 1080, "camera_name": "left"}
        camera = read_camera(write("camera.json", values))
        assert camera.name == "left"
        assert_camera(camera, RADTAN, "radtan", world_z_up=False)

    @pytest.mark.parametrize("key", ["distortion_coefficients", "dist_coeffs", "distCoeffs", "D"])
    def test_fisheye_flag_and_spellings(self, write, key):
        values = opencv_values(distortion_coefficients=None, fisheye=1) | {key: [FISHEYE]}
        assert_camera(
            read_camera(write("camera.yml", opencv_text(".yml", **values))), FISHEYE, "fisheye", world_z_up=False
        )

    @pytest.mark.parametrize(("rotation", "translation"), [("R", "T"), ("rotation", "translation"), ("rvec", "tvec")])
    def test_pose(self, write, rotation, translation):
        turn = R if rotation == "R" else Rotation.from_matrix(R).as_rotvec()[:, None]
        values = opencv_values(world_z_up=1) | {rotation: turn, translation: [[x] for x in T]}
        path = write("camera.yml", opencv_text(".yml", **values))
        assert_camera(read_camera(path), RADTAN, "radtan", posed=True)

    @pytest.mark.parametrize(
        ("distortion_model", "coefficients", "model"),
        [
            ("plumb_bob", RADTAN, "radtan"),
            ("rational_polynomial", [*RADTAN, 0.1, 0.2, 0.3], "radtan"),
            ("equidistant", FISHEYE, "fisheye"),
        ],
    )
    def test_ros(self, write, distortion_model, coefficients, model):
        text = f"""\
image_width: 1920
image_height: 1080
camera_name: narrow_stereo
camera_matrix:
  rows: 3
  cols: 3
  data: {np.ravel(K).tolist()}
distortion_model: {distortion_model}
distortion_coefficients:
  rows: 1
  cols: {len(coefficients)}
  data: {coefficients}
rectification_matrix:
  rows: 3
  cols: 3
  data: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
"""
        camera = read_camera(write("ost.yaml", text))
        assert camera.name == "narrow_stereo"
        assert_camera(camera, coefficients, model, world_z_up=False)

    def test_ros_message_has_a_rectification_not_a_pose(self, write):
        lists = {"D": RADTAN, "K": np.ravel(K).tolist(), "R": np.eye(3).ravel().tolist()}
        values = {"width": 1920, "height": 1080, "distortion_model": "plumb_bob", **lists}
        text = "".join(f"{key}: {value}\n" for key, value in values.items())
        assert_camera(read_camera(write("info.yaml", text)), RADTAN, "radtan", world_z_up=False)

    def test_unestimated_coefficients_are_dropped(self, write):
        values = opencv_values(distortion_coefficients=[[*RADTAN, 0.1, 0.2, 0.3, 0, 0, 0, 0, 0, 0]])
        camera = read_camera(write("camera.yml", opencv_text(".yml", **values)))
        assert camera.distortion.tolist() == [*RADTAN, 0.1, 0.2, 0.3]

    def test_unknown_lens_model(self, write):
        path = write("camera.yml", opencv_text(".yml", **opencv_values(distortion_model="omni")))
        refuses(path, ("distortion_model", "'omni'"))


class TestAcinoSet:
    def test_scene(self, write):
        cameras = read_cameras(write("scene.json", scene()))
        assert [camera.name for camera in cameras] == ["cam1", "cam2"]
        for camera in cameras:
            assert_camera(camera, FISHEYE, "fisheye", posed=True)

    def test_one_camera(self, write):
        path = write("camera.json", {"camera_resolution": list(SIZE), "k": K, "d": [[x] for x in FISHEYE]})
        assert_camera(read_camera(path), FISHEYE, "fisheye")

    @pytest.mark.parametrize("off", [1e-4, 2e-3])
    def test_rotation_is_made_orthonormal_when_it_nearly_is(self, write, off):
        path = write("scene.json", scene(r=(R + off * np.eye(3)[::-1]).tolist()))
        if off > 1e-3:
            refuses(path, *both("r", "not a rotation"), name=1)
        else:
            rotation = read_camera(path, 1).rotation
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-14)
            np.testing.assert_allclose(rotation, R, atol=2 * off)

    def test_reflection_is_refused(self, write):
        refuses(write("scene.json", scene(r=(-R).tolist())), *both("r", "not a rotation"), name=1)

    @pytest.mark.parametrize("cameras", [[], {}, None, [1, 2]])
    def test_no_cameras(self, write, cameras):
        refuses(write("scene.json", {"cameras": cameras}), ("cameras", "no list"))


class TestOpenDroneMap:
    def test_by_hand(self, write):
        """Intrinsics are converted from fractions of the picture's longer side, also those in a reconstruction."""
        lens = {"width": 1600, "height": 1000, "focal_x": 0.75, "focal_y": 0.5, "c_x": 0.01, "c_y": -0.02}
        brown = lens | {"projection_type": "brown", "k1": -0.2, "k2": 0.1, "p1": 0.001, "p2": 0.002, "k3": -0.03}
        old = {"width": 1600, "height": 1000, "projection_type": "perspective", "focal": 0.75, "k1": -0.2, "k2": 0.1}
        bent = lens | {"projection_type": "fisheye", "k1": -0.2, "k2": 0.1}
        document = {"v2 dji": brown, "old": old, "wide": bent}
        for content in (document, [{"cameras": document, "shots": {}, "points": {}}]):
            dji, plain, wide = read_cameras(write("cameras.json", json.dumps(content)))
            assert [dji.name, plain.name, wide.name] == [*document]
            np.testing.assert_allclose(dji.matrix, [[1200, 0, 815.5], [0, 800, 467.5], [0, 0, 1]])
            assert dji.distortion.tolist() == [-0.2, 0.1, 0.001, 0.002, -0.03]
            assert (dji.model, dji.image_size_px, dji.rotation) == ("radtan", (1600, 1000), None)
            np.testing.assert_allclose(plain.matrix, [[1200, 0, 799.5], [0, 1200, 499.5], [0, 0, 1]])
            assert (wide.model, wide.distortion.tolist()) == ("fisheye", [-0.2, 0.1, 0.0, 0.0])

    def test_unusable_files_are_refused(self, write):
        path = write("cameras.json", {"a": {"projection_type": "spherical", "width": 10, "height": 5}})
        refuses(path, ("a: projection_type", "'spherical'"))
        refuses(write("other.json", {"projection_type": "brown"}), ("cameras", "no table"))


class TestAnipose:
    def test_anipose(self, write):
        content = anipose("cam_0", "cam_1")
        content["cam_0"]["name"], content["cam_1"]["name"] = "A", "B"
        cameras = read_cameras(write("calibration.toml", content))
        assert [camera.name for camera in cameras] == ["A", "B"]
        for camera in cameras:
            assert_camera(camera, RADTAN, "radtan", posed=True, world_z_up=False)

    def test_fisheye(self, write):
        path = write("calibration.toml", anipose("A", fisheye=True, distortions=FISHEYE))
        assert_camera(read_camera(path), FISHEYE, "fisheye", posed=True, world_z_up=False)

    def test_one_coefficient(self, write):
        path = write("calibration.toml", anipose("A", distortions=[-0.2]))
        assert_camera(read_camera(path), [-0.2, 0, 0, 0], "radtan", posed=True, world_z_up=False)

    def test_pose2sim(self, write):
        content = anipose("cam_01", "cam_02", distortions=RADTAN[:4], size=[1920.0, 1080.0], fisheye=False)
        del content["cam_01"]["name"]
        path = write("Calib.toml", content)
        assert read_cameras(path)[0].name == "cam_01"
        assert_camera(read_camera(path, 2), RADTAN[:4], "radtan", posed=True, world_z_up=False)

    def test_no_tables(self, write):
        refuses(write("calibration.toml", "x = 1\n"), ("cameras", "no table", "recon-camera"))


class TestOwnFormat:
    @pytest.mark.parametrize(
        "camera",
        [
            Camera("left", K, FISHEYE, "fisheye", SIZE, R, T),
            Camera("left", K, RADTAN, "radtan", SIZE, R, T, world_z_up=False),
            Camera.from_hfov(65.3, SIZE, name="Kamera Süd"),
            Camera("low", K, [], "pinhole", SIZE, tilt_rad=-0.1),
        ],
    )
    def test_round_trip_is_exact(self, tmp_path, camera):
        path = tmp_path / "camera.toml"
        write_camera(camera, path)
        assert read_camera(path).to_dict() == camera.to_dict()
        assert [file.name for file in tmp_path.iterdir()] == ["camera.toml"]

    def test_other_version(self, write):
        refuses(write("camera.toml", own_table(version=2)), ("camera.format", "version 2", "version 1"))

    def test_bad_values(self, write):
        path = write("camera.toml", own_table(model="omni", world_z_up="yes"))
        refuses(path, ("camera.model", "'omni'"), ("camera.world_z_up", "'yes'", "true or false"))

    def test_failed_write_leaves_the_old_file(self, tmp_path, monkeypatch):
        path = tmp_path / "camera.toml"
        path.write_text("old")

        def fail(*_):
            raise OSError("disk full")

        monkeypatch.setattr("os.replace", fail)
        with pytest.raises(OSError, match="disk full"):
            write_camera(Camera.from_hfov(60, SIZE), path)
        assert path.read_text() == "old"
        assert [file.name for file in tmp_path.iterdir()] == ["camera.toml"]


class TestChoiceOfCamera:
    @pytest.mark.parametrize(
        ("names", "wanted", "found"),
        [
            (["cam1", "cam2", "cam6"], "cam6", "cam6"),
            (["cam1", "cam2", "cam6"], 6, "cam6"),
            (["cam1", "cam2", "cam6"], "2", "cam2"),
            (["cam_01", "Cam_12"], "12", "Cam_12"),
            (["0", "1"], "1", "1"),
            (["cam1", "1"], 1, "1"),
        ],
    )
    def test_by_name_or_number(self, write, names, wanted, found):
        assert read_camera(write("calibration.toml", anipose(*names)), wanted).name == found

    def test_camera_by_index_in_a_file_without_names(self, write):
        content = scene()
        content["cameras"][1]["t"] = [[9.0], [9.0], [9.0]]
        path = write("scene.json", content)
        assert read_camera(path, 2).translation_m.tolist() == [9, 9, 9]
        assert read_camera(path, "1").translation_m.tolist() == T

    @pytest.mark.parametrize("wanted", [4, "3", "left", "cam", "-1", 0, "²", ""])
    def test_no_such_camera(self, write, wanted):
        path = write("calibration.toml", anipose("cam1", "cam2", "cam6"))
        refuses(path, ("camera", f"'{wanted}'", "cam1, cam2, cam6"), name=wanted)

    def test_several_cameras_without_a_chosen_name_are_refused(self, write):
        refuses(write("calibration.toml", anipose("cam1", "cam2")), ("camera", "2 cameras", "cam1, cam2"))

    def test_a_wrong_size_is_reported_for_each_camera(self, write):
        path = write("calibration.toml", anipose("cam1", "cam2", "cam3"))
        width, height = read_camera(path, "cam1").image_size_px
        other = (width, height + 10)
        each = [(f"cam{i}.size", f"{width}x{height}", f"{width}x{height + 10}") for i in (1, 2, 3)]
        refuses(path, *each, name="cam2", image_size_px=other)

    def test_a_number_that_matches_two_names_is_refused(self, write):
        refuses(write("calibration.toml", anipose("cam1", "cam_1")), ("camera", [2, "'1'"], "cam1, cam_1"), name=1)

    def test_names_must_differ(self, write):
        content = scene(name="left")
        refuses(write("scene.json", content), ("camera names", "'left' 2 times"), name="left")


class TestImageSize:
    def test_missing(self, write):
        path = write("camera.yml", opencv_text(".yml", **opencv_values(image_width=None, image_height=None)))
        refuses(path, ("size", "nothing", "--image-size"))
        assert read_camera(path, image_size_px=(640, 480)).image_size_px == (640, 480)

    def test_contradicted(self, write):
        path = write("scene.json", scene())
        assert read_camera(path, 1, image_size_px=SIZE).image_size_px == SIZE
        refuses(path, *both("camera_resolution", "1920x1080", "640x480"), name=1, image_size_px=(640, 480))

    @pytest.mark.parametrize(
        "size",
        [
            [1920],
            [0, 1080],
            [-1, 5],
            ["a", "b"],
            "big",
            [1920.5, 1080],
            [[1, 2]],
            [float("inf"), 1],
            [2**70, 1],
            [1e9, 1],
        ],
    )
    def test_malformed(self, write, size):
        content = scene() | {"camera_resolution": size}
        refuses(write("scene.json", content), *both("camera_resolution", str(size), "pixels"), name=1)


class TestLayoutsOfLabs:
    def test_jarvis(self, write):
        """The transposed matrices of JARVIS, which are MATLAB's, are read."""
        values = {"intrinsicMatrix": np.transpose(K), "distortionCoefficients": [RADTAN], "R": R.T}
        path = write("left.yaml", opencv_text(".yml", **values, T=[[x] for x in T]))
        camera = read_camera(path, image_size_px=SIZE)
        assert_camera(camera, RADTAN, "radtan", posed=True, world_z_up=False)

    def test_easymocap(self, write):
        lenses = {"K_01": K, "dist_01": [RADTAN], "K_02": K, "dist_02": [RADTAN]}
        turn = Rotation.from_matrix(R).as_rotvec()[:, None]
        poses = {"R_01": turn, "Rot_01": R, "T_01": [[x] for x in T], "R_02": turn, "T_02": [[x] for x in T]}
        names = "%YAML:1.0\n---\nnames:\n  - '01'\n  - '02'\n"
        older = {key.replace("dist_", "D_"): value for key, value in lenses.items()}
        path = write("intri.yml", names + opencv_text(".yml", **older).partition("---\n")[2])
        assert [c.distortion.tolist() for c in read_cameras(path, SIZE)] == [RADTAN, RADTAN]
        path = write("intri.yml", names + opencv_text(".yml", **lenses).partition("---\n")[2])
        assert [c.has_extrinsics for c in read_cameras(path, SIZE)] == [False, False]
        write("extri.yml", names + opencv_text(".yml", **poses).partition("---\n")[2])
        cameras = read_cameras(path, SIZE)
        assert [camera.name for camera in cameras] == ["01", "02"]
        for camera in cameras:
            assert_camera(camera, RADTAN, "radtan", posed=True, world_z_up=False)
        refuses(path.with_name("extri.yml"), ("camera", "poses", "intri.yml"), image_size_px=SIZE)

    def test_caliscope(self, write):
        """Caliscope's cameras without a calibration are left out."""
        posed = anipose("0")["0"] | {"fisheye": False}
        del posed["name"]
        cameras = {"0": posed, "3": {"size": list(SIZE), "port": 3}}
        for tables in ({"cameras": cameras}, {f"cam_{key}": table for key, table in cameras.items()}):
            (camera,) = read_cameras(write("camera_array.toml", tables))
            assert camera.name == "cam_0"
            assert_camera(camera, RADTAN, "radtan", posed=True, world_z_up=False)

    @pytest.mark.parametrize(("matrix", "lens"), [("K", "D"), ("M", "D"), ("cameraMatrix", "distCoeffs")])
    def test_opencvs_stereo_files(self, write, matrix, lens):
        values = {f"{matrix}{i}": K for i in (1, 2)} | {f"{lens}{i}": [RADTAN] for i in (1, 2)}
        path = write("stereo.yml", opencv_text(".yml", **values, R=R, T=[[x] for x in T]))
        first, second = read_cameras(path, SIZE)
        np.testing.assert_array_equal(first.centre_world, [0, 0, 0])
        assert_camera(second, RADTAN, "radtan", posed=True, world_z_up=False)

    @pytest.mark.parametrize(
        "ends", [("_left", "_right"), ("0", "1"), ("L", "R")], ids=["left and right", "from 0", "letters"]
    )
    def test_ends_of_keys_of_stereo_files(self, write, ends):
        """Keys of stereo files have various ends, the size may be a list, and `tvec` is a translation."""
        values = {f"K{end}": K for end in ends} | {f"D{end}": RADTAN for end in ends}
        first, second = read_cameras(write("a.json", {**values, "R": R.tolist(), "tvec": T, "image_size": SIZE}))
        np.testing.assert_array_equal(first.centre_world, [0, 0, 0])
        assert_camera(second, RADTAN, "radtan", posed=True, world_z_up=False)

    @pytest.mark.parametrize(
        "values",
        [
            {"mtx": K, "dist": [RADTAN], "width": 1920, "height": 1080},
            {"Camera Matrix": K, "DistCoeffs": RADTAN, "image_Width": 1920, "image_Height": 1080},
            {"fx": K[0][0], "fy": K[1][1], "cx": K[0][2], "cy": K[1][2], "size": SIZE}
            | dict(zip(("k1", "k2", "p1", "p2", "k3"), RADTAN, strict=True)),
            {"intrinsics": {"K": K, "dist_coeff": [RADTAN], "img_size": SIZE}},
        ],
        ids=["numpy", "capitals", "single numbers", "inner table"],
    )
    def test_other_spellings_of_keys(self, write, values):
        assert_camera(read_camera(write("a.json", values)), RADTAN, "radtan", world_z_up=False)

    def test_yaml_of_python(self, write):
        """Python's YAML, whose lists are not indented, is read."""

        def block(rows, indent):
            return "".join(
                f"{indent}{'- - ' if i == 0 else '  - '}{float(value)}\n" for row in rows for i, value in enumerate(row)
            )

        def camera(indent=""):
            lens = f"{indent}camera_matrix:\n{block(K, indent)}{indent}dist_coeff:\n{block([RADTAN], indent)}"
            size = "".join(f"{indent}- {side}\n" for side in SIZE)
            return f"{lens}{indent}image_size:\n{size}{indent}note: x\n"

        assert_camera(read_camera(write("a.yaml", camera())), RADTAN, "radtan", world_z_up=False)
        cameras = read_cameras(write("b.yaml", f"cam0:\n{camera('  ')}cam1:\n{camera('  ')}date: '2026'\n"))
        assert [camera.name for camera in cameras] == ["cam0", "cam1"]
        for camera in cameras:
            assert_camera(camera, RADTAN, "radtan", world_z_up=False)

    @pytest.mark.parametrize("by_table", [False, True])
    def test_tables_inside_a_camera(self, write, by_table):
        """JSON with tables inside a camera is not read as an AcinoSet scene, although it has `cameras`."""
        inner = {"intrinsics": {"K": K, "dist": RADTAN, "size": SIZE}, "extrinsics": {"R": R.tolist(), "t": T}}
        path = write("a.json", {"cameras": {"A": inner}} if by_table else inner)
        assert_camera(read_camera(path), RADTAN, "radtan", posed=True, world_z_up=False)
        foreign = {"A": {"k": [1], "c": [2], "f": 3, "size": SIZE}}
        refuses(write("b.json", foreign), ("A.k", "shape"), ("A.distortions", "the file has k, c, f"))

    def test_rotation_without_translation_is_a_rectification(self, write):
        """A rotation without a translation, as in camera_info of ROS 2, is a rectification and not a pose."""
        values = {
            "k": np.ravel(K).tolist(),
            "d": RADTAN,
            "r": np.eye(3).ravel().tolist(),
            "width": 1920,
            "height": 1080,
        }
        assert not read_camera(write("a.json", values | {"distortion_model": "plumb_bob"})).has_extrinsics
        posed = read_camera(write("b.json", {"K": K, "D": RADTAN, "size": SIZE, "R": R.tolist(), "t": T}))
        assert_camera(posed, RADTAN, "radtan", posed=True, world_z_up=False)

    @pytest.mark.parametrize("key", ["extrinsics", "camera_to_world"])
    @pytest.mark.parametrize("name", ["a.json", "cameras.json", "a.toml"])
    def test_a_pose_in_one_matrix_is_not_left_out(self, write, key, name):
        """A pose in one matrix is refused, because its direction differs between programs."""
        pose = np.vstack([np.column_stack([R, T]), [0, 0, 0, 1]]).tolist()
        table = {"matrix": K, "distortions": RADTAN, "size": SIZE, key: pose}
        alone = name == "a.json"
        field = key if alone else f"A.{key}"
        refuses(write(name, table if alone else {"A": table}), (field, "one matrix", "world to camera"))

    @pytest.mark.parametrize("key", ["T_cam_world", "T_WC"])
    def test_a_pose_in_one_matrix_is_found_by_its_numbers(self, write, key):
        """A matrix of a rotation and a translation is a pose under any key, and a projection matrix is not."""
        values = {"K": K, "D": RADTAN, "size": SIZE, "P": np.column_stack([K, [0, 0, 0]]).tolist()}
        assert not read_camera(write("a.json", values)).has_extrinsics
        refuses(write("b.json", values | {key: np.column_stack([R, T]).tolist()}), (key, "one matrix"))

    @pytest.mark.parametrize("key", ["position", "C", "camera_center"])
    @pytest.mark.parametrize("turn", [{"R": R.tolist()}, {"quaternion": [0.1, 0.2, 0.3, 0.9]}, {}])
    def test_a_position_of_the_camera_is_not_left_out(self, write, key, turn):
        table = {"K": K, "D": RADTAN, "size": SIZE, **turn, key: [1.0, 2.0, 3.0]}
        field = "quaternion" if "quaternion" in turn else key
        refuses(write("a.json", table), (field, "without R or without t", "-R times"))
        refuses(write("b.json", {"left": table}), (f"left.{field}", "without R or without t"))
        refuses(write("c.json", table | {"distortion_model": "plumb_bob"}), (field, "without R or without t"))

    def test_a_rotation_alone_is_refused_without_signs_of_ros(self, write):
        values = {"K": K, "D": RADTAN, "size": SIZE, "R": R.tolist()}
        refuses(write("a.json", values), ("translation", "nothing"))

    def test_poses_outside_the_tables_of_cameras_are_not_left_out(self, write):
        """Poses that multical writes beside the cameras are refused."""
        cameras = {"a": {"model": "standard", "image_size": SIZE, "K": K, "dist": [RADTAN]}}
        assert not read_camera(write("a.json", {"cameras": cameras})).has_extrinsics
        poses = {"a": {"R": np.eye(3).tolist(), "T": [0, 0, 0]}, "b_to_a": {"R": R.tolist(), "T": T}}
        refuses(write("b.json", {"cameras": cameras, "camera_poses": poses}), ("camera_poses", "outside"))

    def test_a_list_of_tables(self, write):
        """A list of cameras with Anipose's keys, as of AIST++, is read like tables by name."""
        table = anipose("a")["a"]
        cameras = read_cameras(write("setting1.json", json.dumps([table, table | {"name": "b"}])))
        assert [camera.name for camera in cameras] == ["a", "b"]
        for camera in cameras:
            assert_camera(camera, RADTAN, "radtan", posed=True, world_z_up=False)

    def test_degrees_are_no_rotation_vector(self, write):
        """A rotation vector is at most one turn long; longer ones are probably in degrees."""
        values = {"K": K, "D": RADTAN, "size": SIZE, "rotation": [-95.2, 3.0, 1.2], "translation": T}
        refuses(write("a.json", values), ("rotation", "in degrees", "radians"))

    @pytest.mark.parametrize("size", ["1920x1080", "1920 x 1080", "1920, 1080"])
    def test_size_as_text(self, write, size):
        path = write("a.json", {"K": K, "D": RADTAN, "resolution": size})
        assert_camera(read_camera(path), RADTAN, "radtan", world_z_up=False)
        refuses(write("b.json", {"K": K, "D": RADTAN, "resolution": "full HD"}), ("resolution", "full HD"))

    @pytest.mark.parametrize("by_name", [False, True])
    def test_tables_in_json(self, write, by_name):
        """Tables in JSON such as CMU Panoptic's have the stated lens, and not z up like AcinoSet's files."""
        table = {"resolution": SIZE, "K": K, "distCoef": RADTAN, "R": R.tolist(), "t": [[x] for x in T]}
        tables = {"a": table} if by_name else [{"name": "a", "type": "hd"} | table]
        path = write("panoptic.json", {"cameras": tables})
        assert_camera(read_camera(path, "a"), RADTAN, "radtan", posed=True, world_z_up=False)
        write("panoptic.json", {"cameras": [table | {"distCoef": FISHEYE, "distortion_model": "equidistant"}]})
        assert_camera(read_camera(path), FISHEYE, "fisheye", posed=True, world_z_up=False)

    @pytest.mark.parametrize(
        ("key", "value", "model"),
        [
            ("camera_model", "fisheye", "fisheye"),
            ("projection_model", "kannala_brandt", "fisheye"),
            ("lens", "Fisheye", "fisheye"),
            ("distortion_type", "equidistant", "fisheye"),
            ("model", "radtan", "radtan"),
            ("lens_type", "fisheye", "fisheye"),
            ("cameraModel", "FISHEYE", "fisheye"),
            ("isFisheye", True, "fisheye"),
        ],
    )
    def test_a_lens_under_any_of_its_keys(self, write, key, value, model):
        values = {"K": K, "D": FISHEYE, "width": 1920, "height": 1080, key: value}
        assert_camera(read_camera(write("a.json", values)), FISHEYE, model, world_z_up=False)

    @pytest.mark.parametrize(
        ("more", "expected"),
        [
            ({}, ("D", "4 coefficients", ["plumb_bob", "equidistant"])),
            ({"camera_model": "omni"}, ("camera_model", "'omni'", "radtan")),
            ({"camera_model": "ds"}, ("camera_model", "'ds'", "radtan")),
            ({"xi": 1.2}, ("xi", "omnidirectional", "radtan")),
            ({"xi": [[1.2]], "D": RADTAN}, ("xi", "omnidirectional", "radtan")),
            ({"camera_model": "GoPro HERO9"}, ("D", "4 coefficients", ["plumb_bob", "equidistant"])),
            ({"lens": "fisheye", "distortion_model": "plumb_bob"}, ("distortion_model, lens", ["radtan and fisheye"])),
        ],
    )
    def test_an_ambiguous_lens_is_refused(self, write, more, expected):
        values = {"K": K, "D": FISHEYE, "width": 1920, "height": 1080, **more}
        refuses(write("a.json", values), expected)

    @pytest.mark.parametrize(
        "more",
        [
            {"camera_model": "GoPro HERO9 Black"},
            {"model": "Basler acA1920"},
            {"distortion_model": "plumb bob"},
            {"fisheye": "no"},
            {"is_fisheye": "False"},
            {"xi": 0},
        ],
    )
    def test_words_that_state_no_other_lens(self, write, more):
        """Names of products and negations are no lens models."""
        values = {"K": K, "D": RADTAN, "width": 1920, "height": 1080, **more}
        assert_camera(read_camera(write("a.json", values)), RADTAN, "radtan", world_z_up=False)

    def test_message_that_ros_2_printed(self, write):
        """The line --- at the end of a message is no further document."""
        text = f"width: 1920\nheight: 1080\ndistortion_model: plumb_bob\nk: {np.ravel(K).tolist()}\nd: {RADTAN}\n---\n"
        assert_camera(read_camera(write("a.yaml", text)), RADTAN, "radtan", world_z_up=False)

    def test_region_and_binning_of_ros(self, write):
        """The region's corner shifts the principal point, and binning divides it, as in ROS' image_geometry."""
        text = f"width: 1920\nheight: 1080\nK: {np.ravel(K).tolist()}\nD: {RADTAN}\nbinning_x: 2\nbinning_y: 0\n"
        text += "roi:\n  x_offset: 320\n  y_offset: 180\n  width: 1280\n  height: 720\n"
        camera = read_camera(write("roi.yaml", text))
        assert camera.image_size_px == (640, 720)
        expected = [[960.5 / 2, 0, (945.8 - 320) / 2], [0, 968.4, 584.5 - 180], [0, 0, 1]]
        np.testing.assert_allclose(camera.matrix, expected)
        in_table = "".join(f"  {line}\n" for line in text.splitlines())
        for camera in read_cameras(write("two.yaml", f"left:\n{in_table}right:\n{in_table}")):
            assert camera.image_size_px == (640, 720)
            np.testing.assert_allclose(camera.matrix, expected)

    @pytest.mark.parametrize(
        ("name", "text", "found"),
        [
            ("a.json", '{"fl_x": 1, "frames": []}', "nerfstudio"),
            ("a.xml", "<calibration created='2026'/>", "Qualisys"),
            ("a.yaml", "cam0:\n  camera_model: pinhole\n", "Kalibr"),
            ("a.csv", "1,2\n" * 11, "DLT coefficients"),
            ("a.txt", "1 1600 1920 1080 960 540 1 0 0 0 0 0\n" * 2, "Argus"),
            ("cameras.txt", "# Camera list\n#   CAMERA_ID, MODEL, WIDTH\n1 OPENCV 1920 1080 9 9 9 9\n", "COLMAP"),
            ("a.xml", "<?xml version='1.0'?>\n<calibration>\n <projection>frame</projection>", "Metashape"),
            ("a.json", '{"ImageSize": [1080, 1920], "RadialDistortion": [0, 0]}', "MATLAB"),
            *(
                (f"a{suffix}", "x", found)
                for suffix, found in ((".npz", "NumPy"), (".pkl", "pickle"), (".XCP", "Vicon"))
            ),
        ],
    )
    def test_other_programs_are_named(self, write, name, text, found):
        """Files that recon cannot read are named, with what to give instead of a list of all formats."""
        refuses(write(name, text), ("format", found))
        with pytest.raises(InputError) as error:
            read_cameras(write(name, text))
        assert "Anipose" not in str(error.value)

    def test_a_table_called_cam0_is_not_always_kalibrs(self, write):
        text = f"cam0:\n  camera_matrix: {K}\n  distortion_coeffs: {RADTAN}\n  image_size: {list(SIZE)}\n"
        assert_camera(read_camera(write("a.yaml", text)), RADTAN, "radtan", world_z_up=False)

    def test_keys_that_a_file_has_are_named(self, write):
        values = opencv_values(camera_matrix=None, distortion_coefficients=None) | {"Kmat": K}
        found = "the file has image_width, image_height, Kmat"
        fields = ("matrix", "distortions")
        refuses(write("a.yml", opencv_text(".yml", **values)), *((field, found) for field in fields))
        refuses(
            write("a.json", {"cameras": [{"f": 1, "lens": 2}]}),
            ("format", ["no known camera file", "cameras (f, lens)"]),
        )
        refuses(write("a.toml", {"rig": {"f": 1}}), ("cameras", "the file has rig: f"))


class TestMalformed:
    @pytest.mark.parametrize(
        ("name", "text", "expected"),
        [
            ("a.json", '{"cameras": [', ("content", "line 1 column 14", "JSON")),
            ("a.json", "[" * 100_000, ("content", "nested", "JSON")),
            ("a.json", "[1, 2]", ("format", "JSON")),
            ("a.json", '{"x": "opencv-matrix"', ("file", "cannot parse", "JSON")),
            ("a.toml", "[cam_0\n", ("content", "line 1, column 7", "TOML")),
            ("a.yml", "%YAML:1.0\n---\na: [1, 2\nfoo", ("file", "cannot parse", "YAML")),
            ("a.yaml", "just text", ("file", "cannot parse", "YAML")),
            ("a.xml", "<?xml version='1.0'?><opencv_storage><a>", ("file", "cannot parse", "XML")),
            ("a.xml", "text", ("file", "cannot parse", "XML")),
            ("a.yml", "%YAML:1.0\n---\n", ("content", "no keys", "camera_matrix")),
            *(
                ("a.yml", "%YAML:1.0\n---\n" + text, ("content", "nested"))
                for text in ("a: " + "[" * 100_000, "a: " + "{a:" * 50_000, "a:\n  " + "- " * 50_000, "a: " * 50_000)
            ),
            ("a.xml", "<?xml version='1.0'?><opencv_storage>" + "<a>" * 50_000, ("content", "nested")),
            ("a.json", '{"x": "opencv-matrix", "a": ' + "[" * 100_000, ("content", "nested")),
            ("a.txt", "x", ("format", "'.txt'", ".json")),
            *((f"a{suffix}", "", ("file", "empty")) for suffix in (".json", ".toml", ".yml", ".xml")),
        ],
    )
    def test_text(self, write, capfd, name, text, expected):
        refuses(write(name, text), expected)
        assert capfd.readouterr() == ("", "")

    def test_numbers_too_large_for_a_camera_are_refused(self, write):
        for values, found in (([1e300] * 4, "1e+300"), ([1.0, 1, 1, 2e9], "2e+09")):
            refuses(write("a.json", {"camera_resolution": list(SIZE), "k": K, "d": values}), ("d", found))
        tiny = write("b.json", {"camera_resolution": list(SIZE), "k": K, "d": [0.1, 0, 0, 1e-320]})
        assert np.isfinite(read_camera(tiny).project(np.array([[0.1, 0.2, 3.0]]))[0]).all()

    def test_files(self, tmp_path):
        refuses(tmp_path / "none.json", ("file", "no such file"))
        (tmp_path / "folder.toml").mkdir()
        refuses(tmp_path / "folder.toml", ("file", "a folder"))
        (tmp_path / "binary.yml").write_bytes(b"\x80\x81")
        refuses(tmp_path / "binary.yml", ("text", "byte 1", "UTF-8"))

    @pytest.mark.parametrize(
        ("field", "value", "found"),
        [
            ("k", None, "nothing"),
            ("k", K[:2], "shape (2, 3)"),
            ("k", [[1, 2], [3]], "not an array of numbers"),
            ("k", "wide", "not an array of numbers"),
            ("k", [["1", "0", "0"]] * 3, "not an array of numbers"),
            ("k", [[float("nan"), 0, 0], *K[1:]], "nan"),
            ("k", [[-1.0, 0, 0], *K[1:]], "-1.0"),
            ("k", np.transpose(K).tolist(), str(np.transpose(K).tolist()[2])),
            ("d", None, "nothing"),
            ("d", [0.1, 0.2], "2 coefficients"),
            ("d", [*FISHEYE, 0.5], "5 coefficients"),
            ("d", [float("inf"), 0, 0, 0], "inf"),
            ("r", None, "nothing"),
            ("t", None, "nothing"),
            ("t", [1, 2], "shape (2,)"),
            ("r", (2 * R).tolist(), "not a rotation"),
            ("r", [[float("nan")] * 3] * 3, "nan"),
        ],
    )
    def test_values(self, write, field, value, found):
        refuses(write("scene.json", scene(**{field: value})), *both(field, found), name=1)

    def test_every_problem_at_once(self, write):
        content = scene(k=None, d=[1, 2, 3], t=[1])
        del content["camera_resolution"]
        found = {"k": "nothing", "d": "3 coefficients", "camera_resolution": "nothing", "t": "shape (1,)"}
        path = write("scene.json", content)
        with refusal(*((path, f"cameras[{i}].{key}", value) for i in (0, 1) for key, value in found.items())):
            read_cameras(path)


class TestRealFiles:
    @pytest.mark.parametrize(
        ("name", "count", "size", "fx", "posed"),
        [
            ("2_cam_scene_sba", 2, (1920, 1080), 960.4869959766988, True),
            ("4_cam_scene_static_sba", 2, (1920, 1080), 957.0183847467357, True),
            ("camera_1", 1, (1920, 1080), 960.4869959766988, False),
            ("dummy_scene", 6, (2704, 1520), 1239.734301643185, True),
        ],
    )
    def test_acinoset(self, shared_data, name, count, size, fx, posed):
        path = shared_data / "importer-files" / "acinoset" / f"{name}.json"
        document = json.loads(path.read_text())
        entries = document.get("cameras", [document])
        cameras = read_cameras(path)
        assert [camera.name for camera in cameras] == [f"cam{n}" for n in range(1, count + 1)]
        assert cameras[0].matrix[0, 0] == fx
        for camera, entry in zip(cameras, entries, strict=True):
            assert (camera.model, camera.image_size_px, camera.has_extrinsics) == ("fisheye", size, posed)
            np.testing.assert_array_equal(camera.distortion, np.ravel(entry["d"]))
            if posed:
                np.testing.assert_allclose(camera.rotation, entry["r"], atol=1e-8)
                np.testing.assert_array_equal(camera.translation_m, np.ravel(entry["t"]))
                assert camera.up[1] < -0.9  # filmed upright

    @pytest.mark.slow
    def test_cheetah_runs_project_their_truth_onto_their_detections(self, shared_data):
        """Published 3D poses of cheetahs project to within 10 to 25 px of the detections, as published."""
        runs = sorted((shared_data / "cheetah-runs").glob("*/scene.json"))
        assert len(runs) == 5
        for scene_file in runs:
            numbers = json.loads((scene_file.parent / "meta.json").read_text())["cameras"]
            cameras = read_cameras(scene_file)
            assert [camera.name for camera in cameras] == [f"cam{n}" for n in numbers]
            truth = pd.read_csv(scene_file.parent / "truth.csv", header=[0, 1], index_col=0)
            distances = []
            for number, camera in zip(numbers, cameras, strict=True):
                assert read_camera(scene_file, number).to_dict() == camera.to_dict()
                detected = pd.read_csv(scene_file.parent / f"{camera.name}.csv", header=[1, 2], index_col=0)
                frames = truth.index.intersection(detected.index)
                for joint in truth.columns.unique(level=0).intersection(detected.columns.unique(level=0)):
                    points = truth.loc[frames, joint].to_numpy(dtype=float)
                    pixels, _ = camera.project(camera.world_to_camera(points))
                    xy = detected.loc[frames, joint][["x", "y"]].to_numpy(dtype=float)
                    distances.append(np.linalg.norm(pixels - xy, axis=-1))
            assert 5 < np.nanmedian(np.concatenate(distances)) < 25


def test_opensfm_lens_is_recognised_without_its_other_values(tmp_path):
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"a": {"projection_type": "brown", "height": 480, "focal_x": 0.8, "focal_y": 0.8}}))
    refuses(path, *((f"a: {field}", "nothing") for field in ("matrix", "distortion", "width, height")))


@pytest.mark.parametrize("suffix", [".mat", ".toml", ".json"])
def test_a_missing_file_and_a_link_to_nothing_are_named(tmp_path, suffix):
    path = tmp_path / f"camera{suffix}"
    with refusal((path, "file", "no such file")):
        read_cameras(path)
    path.symlink_to("nowhere")
    with refusal((path, "file", "a link that points to nothing")):
        read_cameras(path)
