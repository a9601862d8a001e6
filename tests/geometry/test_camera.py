import pickle
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import refusal
from scipy.spatial.transform import Rotation

from recon.geometry.camera import Camera
from recon.geometry.frames import euler_rotation
from recon.geometry.lens import LENS_MODELS

SIZE = (2704, 1520)
K = np.array([[1240.0, 0, 1346.0], [0, 1210.0, 773.0], [0, 0, 1]])
SKEWED = K + np.array([[0, 37.0, 0], [0, 0, 0], [0, 0, 0]])
LENSES = {
    "pinhole": ("pinhole", K, []),
    "pinhole with skew": ("pinhole", SKEWED, []),
    "radtan 4": ("radtan", K, [-0.28, 0.09, 1.1e-3, -7e-4]),
    "radtan 4 with skew": ("radtan", SKEWED, [-0.28, 0.09, 1.1e-3, -7e-4]),
    "radtan 5": ("radtan", K, [-0.31, 0.12, 1.3e-3, -9e-4, -0.025]),
    "radtan 8": ("radtan", K, [0.42, 0.11, 1.2e-3, -8e-4, 0.01, 0.75, 0.2, 0.02]),
    "fisheye mild": ("fisheye", K, [0.0366, 0.048, -0.0347, 0.0074]),
    "fisheye strong": ("fisheye", K, [0.19, -0.23, 0.07, -0.021]),
    "fisheye strong with skew": ("fisheye", SKEWED, [0.19, -0.23, 0.07, -0.021]),
}


def make_camera(lens: str, **pose) -> Camera:
    model, matrix, distortion = LENSES[lens]
    return Camera(lens, matrix, distortion, model, SIZE, **pose)


def opencv_pixels(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Return the pixels of points in the camera frame, computed by OpenCV, with the skew that OpenCV ignores."""
    if camera.model not in ("pinhole", "radtan", "fisheye"):
        pytest.skip("OpenCV has no such lens")
    skew = camera.matrix[0, 1]
    unskewed = camera.matrix.copy()
    unskewed[0, 1] = 0
    zero = np.zeros(3)
    if camera.model == "fisheye":
        alpha = skew / camera.matrix[0, 0]
        return cv2.fisheye.projectPoints(points[:, None], zero, zero, unskewed, camera.distortion, alpha=alpha)[0][:, 0]
    ideal = np.eye(3)
    distortion = camera.distortion if camera.distortion.size else None
    distorted = cv2.projectPoints(points[:, None], zero, zero, ideal, distortion)[0][:, 0]
    return (np.column_stack((distorted, np.ones(len(points)))) @ camera.matrix.T)[:, :2]


@pytest.fixture
def rng():
    return np.random.default_rng(11)


@pytest.mark.parametrize("lens", LENSES)
class TestEveryLens:
    @pytest.fixture
    def camera(self, lens):
        return make_camera(lens)

    @pytest.fixture
    def points(self, camera, rng):
        """Return 200 points over the range of the lens, up to 65 degrees from the optical axis and not at its edge."""
        widest = min(0.9 * np.arctan(camera.lens.max_radius), np.deg2rad(65))
        angle, around = rng.uniform(0, widest, 200), rng.uniform(-np.pi, np.pi, 200)
        direction = np.stack((np.sin(angle) * np.cos(around), np.sin(angle) * np.sin(around), np.cos(angle)), axis=-1)
        return direction * rng.uniform(1, 20, (200, 1))

    def test_agrees_with_opencv(self, camera, points):
        pixels, valid = camera.project(points)
        assert valid.all()
        np.testing.assert_allclose(pixels, opencv_pixels(camera, points), atol=1e-6)

    def test_jacobian_by_central_differences(self, camera, points):
        h = 1e-6
        for point in points[:10]:
            pixels, jacobian, _ = camera.project_with_jacobian(point)
            np.testing.assert_array_equal(pixels, camera.project(point)[0])
            steps = h * np.linalg.norm(point) * np.eye(3)
            numeric = np.stack(
                [(camera.project(point + s)[0] - camera.project(point - s)[0]) / (2 * s.max()) for s in steps], axis=-1
            )
            assert np.linalg.norm(jacobian - numeric) <= 1e-6 * np.linalg.norm(numeric)

    def test_jacobian_on_the_optical_axis(self, camera):
        pixels, jacobian, valid = camera.project_with_jacobian((0, 0, 2.0))
        assert valid
        np.testing.assert_allclose(pixels, camera.matrix[:2, 2])
        bend = camera.lens.distort(np.array([1e-8]), np.zeros(1), np.array([1e-16]))[0] / 1e-8
        np.testing.assert_allclose(jacobian, np.column_stack((bend * camera.matrix[:2, :2] / 2, (0, 0))), atol=1e-9)

    def test_rays_round_trip(self, camera, points):
        pixels, _ = camera.project(points)
        rays, valid = camera.rays(pixels)
        assert valid.all()
        np.testing.assert_allclose(rays, points / np.linalg.norm(points, axis=-1, keepdims=True), atol=1e-9)
        np.testing.assert_allclose(camera.project(5 * rays)[0], pixels, atol=1e-9)

    def test_rays_of_the_whole_image_round_trip_or_are_invalid(self, camera):
        u, v = np.meshgrid(np.linspace(-0.5, SIZE[0] - 0.5, 41), np.linspace(-0.5, SIZE[1] - 0.5, 31))
        pixels = np.stack((u, v), axis=-1)
        rays, valid = camera.rays(pixels)
        assert rays.shape == (31, 41, 3)
        assert valid.mean() > 0.6
        projected, inside = camera.project(rays)
        assert inside[valid].all()
        np.testing.assert_allclose(projected[valid], pixels[valid], atol=1e-9)
        assert np.isnan(rays[~valid]).all()

    def test_behind_and_missing_points_are_invalid(self, camera):
        points = np.array(
            [(0.1, 0.2, 3.0), (0.1, 0.2, -3.0), (0.1, 0.2, 0.0), (0, 0, 0), (np.nan, 0, 3), (np.inf, 0, 3)]
        )
        pixels, jacobian, valid = camera.project_with_jacobian(points)
        np.testing.assert_array_equal(valid, [True] + [False] * 5)
        assert np.isfinite(pixels[0]).all()
        assert np.isnan(pixels[1:]).all()
        assert (jacobian[1:] == 0).all()

    def test_missing_and_absurd_pixels_have_no_ray(self, camera):
        rays, valid = camera.rays([(np.nan, 3.0), (np.inf, 3.0), (np.nan, np.nan)])
        assert not valid.any()
        assert np.isnan(rays).all()
        rays, valid = camera.rays((1e30, -1e200))
        assert valid == np.isfinite(rays).all()

    @pytest.mark.parametrize("shape", [(3,), (0, 3), (2, 3), (2, 5, 3)])
    def test_shapes(self, camera, shape):
        points = np.broadcast_to((0.1, 0.1, 2.1), shape)
        pixels, jacobian, valid = camera.project_with_jacobian(points)
        batch = shape[:-1]
        assert (pixels.shape, jacobian.shape, valid.shape) == ((*batch, 2), (*batch, 2, 3), batch)
        rays, valid = camera.rays(pixels)
        assert (rays.shape, valid.shape) == (shape, batch)
        assert camera.in_image(pixels).shape == batch

    def test_distorted_radius_increases_up_to_the_limit_and_no_further(self, camera):
        if not np.isfinite(camera.lens.max_radius):
            angle = np.linspace(0, np.pi / 2 - 1e-3, 2000)
        else:
            angle = np.linspace(0, np.arctan(camera.lens.max_radius), 2000)[:-1]
        points = np.stack((np.tan(angle), 0 * angle, np.ones_like(angle)), axis=-1)
        bare = Camera("radial", np.eye(3), without_tangential(camera), camera.model, (1, 1))
        pixels, valid = bare.project(points)
        assert valid.all()
        assert (np.diff(pixels[:, 0]) > 0).all()
        if np.isfinite(camera.lens.max_radius):
            beyond = (camera.lens.max_radius * 1.001, 0, 1)
            assert not camera.project(beyond)[1]
            edge, near = opencv_pixels(bare, np.array([beyond, (camera.lens.max_radius * 1.002, 0, 1)]))
            assert near[0] < edge[0]


def without_tangential(camera: Camera) -> np.ndarray:
    distortion = camera.distortion.copy()
    if camera.model == "radtan":
        distortion[2:4] = 0
    return distortion


def test_every_lens_model_is_tested_and_on_the_page_of_formats():
    assert {model for model, _, _ in LENSES.values()} == {*LENS_MODELS}
    page = (Path(__file__).parents[2] / "docs" / "formats.md").read_text(encoding="utf-8")
    assert all(model in page for model in LENS_MODELS)


def test_some_lenses_have_a_limit():
    assert make_camera("radtan 5").lens.max_radius < 2
    assert np.arctan(make_camera("fisheye strong").lens.max_radius) < np.pi / 2
    assert np.isinf(make_camera("fisheye mild").lens.max_radius)
    assert np.isinf(make_camera("pinhole").lens.max_radius)


def test_rational_lens_ends_at_its_pole():
    camera = Camera("c", K, [0, 0, 0, 0, 0, -1.0, 0, 0], "radtan", SIZE)
    assert camera.lens.max_radius == pytest.approx(1.0)


def test_tangential_distortion_folds_before_the_radial_limit():
    """A point at which the true map folds is invalid, and so is its ray, although the radius is below the limit."""
    camera = make_camera("radtan 5")
    around = np.linspace(-np.pi, np.pi, 400)
    radius = 0.999 * camera.lens.max_radius
    points = np.stack((radius * np.cos(around), radius * np.sin(around), np.ones_like(around)), axis=-1)
    pixels, valid = camera.project(points)
    assert 0 < valid.sum() < valid.size
    rays, found = camera.rays(pixels)
    np.testing.assert_array_equal(found, valid)
    np.testing.assert_allclose(camera.project(rays[valid])[0], pixels[valid], atol=1e-9)


def test_pixel_outside_the_lens_range_has_no_ray():
    camera = make_camera("radtan 5")
    edge = camera.project((-0.999 * camera.lens.max_radius, 0, 1))[0]
    assert camera.rays(edge)[1]
    assert not camera.rays(edge - np.array((100, 0)))[1]


def test_skew_by_the_formula():
    camera = make_camera("pinhole with skew")
    x, y, z = 0.4, -0.3, 2.5
    np.testing.assert_allclose(
        camera.project((x, y, z))[0], (1240 * x / z + 37 * y / z + 1346, 1210 * y / z + 773), rtol=1e-14
    )


def test_in_image():
    camera = make_camera("pinhole")
    pixels = [(0, 0), (-0.5, 1519.5), (-0.6, 0), (2703, 1519), (2703.6, 10), (10, 1520), (np.nan, 3)]
    np.testing.assert_array_equal(camera.in_image(pixels), [True, True, False, True, False, False, False])


def test_from_hfov():
    camera = Camera.from_hfov(90, (640, 480))
    np.testing.assert_allclose(camera.matrix, [[320, 0, 319.5], [0, 320, 239.5], [0, 0, 1]])
    left, _ = camera.rays((-0.5, 239.5))
    right, _ = camera.rays((639.5, 239.5))
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(90)


def test_from_hfov_of_a_fisheye_lens():
    """The edges of the picture are half the field of view from the axis, and pixels are proportional to the angle."""
    camera = Camera.from_hfov(118, (1920, 1080), model="fisheye")
    axis, left, half = (camera.rays((x, 539.5))[0] for x in (959.5, -0.5, 479.5))
    assert np.degrees(np.arccos([axis @ left, axis @ half])) == pytest.approx([59, 29.5])
    with pytest.raises(ValueError, match="lens model"):
        Camera.from_hfov(118, (1920, 1080), model="wide")


@pytest.mark.parametrize("hfov", [0, -10, 180, 400, np.nan])
def test_from_hfov_refuses_impossible_angles(hfov):
    with pytest.raises(ValueError, match="field of view"):
        Camera.from_hfov(hfov, (640, 480))


def test_world_and_camera_frames():
    # At (0, -5, 1), looking along world +y: camera x = world x, camera y = -world z, camera z = world y.
    rotation = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    camera = make_camera("fisheye mild", rotation=rotation, translation_m=-rotation @ (0, -5, 1))
    assert camera.has_extrinsics
    np.testing.assert_allclose(camera.centre_world, (0, -5, 1))
    np.testing.assert_allclose(camera.world_to_camera((0.5, 0, 1)), (0.5, 0, 5))
    np.testing.assert_allclose(camera.up, (0, -1, 0))
    points = np.arange(24.0).reshape(2, 4, 3)
    np.testing.assert_allclose(camera.camera_to_world(camera.world_to_camera(points)), points, atol=1e-12)


def test_up_follows_the_world_only_if_its_z_points_up():
    rotation = Rotation.from_euler("xyz", (-1.9, 0.3, 0.2)).as_matrix()
    known = make_camera("pinhole", rotation=rotation, translation_m=(0, 0, 0))
    np.testing.assert_allclose(known.up, rotation @ (0, 0, 1))
    board = make_camera("pinhole", rotation=rotation, translation_m=(0, 0, 0), world_z_up=False)
    np.testing.assert_allclose(board.up, (0, -1, 0))
    np.testing.assert_allclose(make_camera("pinhole").up, (0, -1, 0))


@pytest.mark.parametrize("tilt", [0.2, np.pi / 2])
def test_a_camera_without_a_pose_may_look_down_by_a_known_angle(tilt):
    """A camera without a pose may look down by a known angle, including straight down, as from a drone."""
    camera = make_camera("pinhole", tilt_rad=tilt)
    # The same camera in a world, level and then tilted downwards about its x axis.
    level = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    rotation = Rotation.from_euler("x", tilt).as_matrix() @ level
    posed = make_camera("pinhole", rotation=rotation, translation_m=(0, 0, 0))
    assert (posed.camera_to_world((0, 0, 1)))[2] == pytest.approx(-np.sin(tilt))  # the optical axis points down
    np.testing.assert_allclose(camera.up, posed.up, atol=1e-15)
    board = make_camera("pinhole", rotation=rotation, translation_m=(0, 0, 0), world_z_up=False, tilt_rad=tilt)
    np.testing.assert_allclose(board.up, posed.up, atol=1e-15)


def test_no_pose():
    camera = make_camera("pinhole")
    assert not camera.has_extrinsics
    for call in (camera.world_to_camera, camera.camera_to_world):
        with pytest.raises(ValueError, match="no rotation and translation"):
            call(np.zeros(3))
    with pytest.raises(ValueError, match="no rotation and translation"):
        _ = camera.centre_world


@pytest.mark.parametrize(
    ("change", "field", "found"),
    [
        ({"matrix": np.eye(2)}, "matrix", "(2, 2)"),
        ({"matrix": K * np.nan}, "matrix", "nan"),
        ({"matrix": -K}, "matrix", str((-K).tolist())),
        ({"matrix": K.T}, "matrix", str(K.T.tolist())),
        ({"distortion": [0.1, 0.2]}, "distortion", "2 coefficients"),
        ({"distortion": [0.1, np.inf, 0, 0]}, "distortion", "inf"),
        ({"model": "omni"}, "model", "'omni'"),
        ({"image_size_px": (0, 10)}, "image_size_px", "(0, 10)"),
        ({"rotation": np.eye(3)}, "translation_m", "nothing"),
        ({"rotation": 1.1 * np.eye(3), "translation_m": np.zeros(3)}, "rotation", "not a rotation"),
        ({"rotation": -np.eye(3), "translation_m": np.zeros(3)}, "rotation", "not a rotation"),
        ({"rotation": np.eye(3) * np.nan, "translation_m": np.zeros(3)}, "rotation", "nan"),
        ({"rotation": np.eye(3), "translation_m": np.zeros(2)}, "translation_m", "(2,)"),
        ({"tilt_rad": 1.6}, "tilt_rad", 1.6),
        ({"tilt_rad": np.nan}, "tilt_rad", "nan"),
        ({"tilt_rad": 0.1, "rotation": np.eye(3), "translation_m": np.zeros(3)}, "tilt_rad", 0.1),
    ],
)
def test_impossible_cameras_are_refused(change, field, found):
    good = {"name": "c", "matrix": K, "distortion": np.zeros(4), "model": "fisheye", "image_size_px": SIZE}
    Camera(**good)
    with refusal(("camera 'c'", field, found)):
        Camera(**good | change)


def test_every_fault_is_named_at_once():
    with pytest.raises(ValueError, match=r"(?s)matrix.*coefficients.*image_size_px"):
        Camera("c", -K, np.zeros(3), "radtan", (0, 0))


def test_a_camera_copies_its_inputs_and_is_read_only():
    matrix = K.copy()
    camera = Camera("c", matrix, [], "pinhole", SIZE)
    matrix[0, 0] = 1
    assert camera.matrix[0, 0] == 1240
    with pytest.raises(ValueError, match="read-only"):
        camera.matrix[0, 0] = 1


@pytest.mark.parametrize("posed", [False, True])
def test_a_pickled_camera_is_the_same(posed):
    pose = {"rotation": euler_rotation((0.1, 0.2, 0.3)), "translation_m": (1, 2, 3)} if posed else {}
    camera = make_camera("fisheye mild", world_z_up=False, **pose)
    camera.project((0, 0, 1))
    copy = pickle.loads(pickle.dumps(camera))
    assert copy.to_dict() == camera.to_dict()
    np.testing.assert_array_equal(copy.project((0.1, 0.2, 1))[0], camera.project((0.1, 0.2, 1))[0])


def test_impossible_detections_are_not_seen():
    """Impossible detections do not count as seen.

    They are more than the picture's size outside the picture, or outside the range of the lens. Huge numbers cause no
    error.
    """
    wide = Camera.from_hfov(60.0, (1920, 1080))
    points = np.array(
        [[0, 0], [-1900, 500], [-1930, 500], [3830, 500], [500, 2170], [np.nan, 1], [1e300, 1], [1, -np.inf]],
        dtype=float,
    )
    assert wide.sees(points).tolist() == [True, True, False, True, False, False, False, False]
    fisheye = replace(wide, model="fisheye", distortion=np.array([-0.3, 0.0, 0.0, 0.0]))
    assert fisheye.sees([[960.0, 900.0], [960.0, 1900.0]]).tolist() == [True, False]
