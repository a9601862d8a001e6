import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from recon.geometry.frames import euler_rotation, euler_rotation_with_jacobian, quaternions
from recon.thesis.chain import euler_angles


def elementary(axis: str, angle: float) -> np.ndarray:
    return Rotation.from_euler(axis.lower(), angle).as_matrix()


@pytest.fixture
def angles(rng):
    return rng.uniform((-np.pi, -np.pi / 2, -np.pi), (np.pi, np.pi / 2, np.pi), (50, 3))


@pytest.fixture
def rng():
    return np.random.default_rng(7)


def test_order_is_x_then_y_then_z(angles):
    for xi, psi, zeta in angles:
        expected = elementary("X", xi) @ elementary("Y", psi) @ elementary("Z", zeta)
        np.testing.assert_allclose(euler_rotation((xi, psi, zeta)), expected, atol=1e-14)


def test_is_intrinsic_not_extrinsic(angles):
    np.testing.assert_allclose(euler_rotation(angles), Rotation.from_euler("XYZ", angles).as_matrix(), atol=1e-14)
    assert np.abs(euler_rotation(angles) - Rotation.from_euler("xyz", angles).as_matrix()).max() > 0.1


@pytest.mark.parametrize("shape", [(3,), (1, 3), (5, 3), (2, 4, 3), (0, 3)])
def test_batches_agree_with_single_rotations(rng, shape):
    batch = rng.normal(size=shape)
    rotation, jacobian = euler_rotation_with_jacobian(batch)
    assert rotation.shape == (*shape[:-1], 3, 3)
    assert jacobian.shape == (*shape[:-1], 3, 3, 3)
    np.testing.assert_array_equal(rotation, euler_rotation(batch))
    for index in np.ndindex(shape[:-1]):
        single, d_single = euler_rotation_with_jacobian(batch[index])
        np.testing.assert_allclose(rotation[index], single, atol=1e-15)
        np.testing.assert_allclose(jacobian[index], d_single, atol=1e-15)


@pytest.mark.parametrize("start", [None, (0.0, 0.0, 0.0), (1e-9, -1e-9, 1e-9), (0.3, np.pi / 2, -0.4)])
def test_jacobian_matches_central_differences(rng, start):
    h = 1e-6
    for _ in range(10):
        at = rng.normal(size=3) if start is None else np.array(start)
        _, jacobian = euler_rotation_with_jacobian(at)
        for k, step in enumerate(h * np.eye(3)):
            numeric = (euler_rotation(at + step) - euler_rotation(at - step)) / (2 * h)
            np.testing.assert_allclose(jacobian[k], numeric, atol=1e-9)


def test_angles_are_the_inverse(angles):
    np.testing.assert_allclose(euler_angles(euler_rotation(angles)), angles, atol=1e-9)
    assert euler_angles(euler_rotation(angles.reshape(5, 10, 3))).shape == (5, 10, 3)
    assert euler_angles(euler_rotation(angles[0])).shape == (3,)


def test_angles_near_identity():
    small = np.array((1e-10, -2e-10, 3e-10))
    np.testing.assert_allclose(euler_angles(euler_rotation(small)), small, atol=1e-15)


@pytest.mark.parametrize("psi", [np.pi / 2, -np.pi / 2])
def test_angles_at_gimbal_lock_give_the_same_rotation(psi):
    rotation = euler_rotation((0.4, psi, -0.7))
    found = euler_angles(rotation)
    assert found[1] == pytest.approx(psi)
    np.testing.assert_allclose(euler_rotation(found), rotation, atol=1e-7)


def test_angles_of_a_reflection_are_refused():
    with pytest.raises(ValueError, match="determinant"):
        euler_angles(np.diag((1.0, 1.0, -1.0)))


def test_quaternions_are_scipys(rng):
    half_turns = Rotation.from_rotvec(np.pi * np.eye(3))
    expected = Rotation.concatenate([Rotation.random(200, rng), Rotation.identity(1), half_turns]).as_quat()
    found = quaternions(Rotation.from_quat(expected).as_matrix())
    same_sign = np.sign(np.sum(found * expected, axis=1, keepdims=True))  # q and -q are the same rotation
    np.testing.assert_allclose(found * same_sign, expected, atol=1e-15)
    assert (found[np.arange(len(found)), np.argmax(np.abs(found), axis=1)] > 0).all()
    assert quaternions(np.empty((0, 3, 3))).shape == (0, 4)
