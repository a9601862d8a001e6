"""Test start angles that are set by hand, and Levenberg-Marquardt with a given damping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from command_line import refusal

from recon.clip import still_view
from recon.geometry.camera import Camera
from recon.thesis.chain import load_chain, mean_pose
from recon.thesis.levenberg import minimise
from recon.thesis.objectives import FrameOptions
from recon.thesis.solver import FrameSolver, solve_frames
from recon.thesis.start import geometric_start, parse_start_angles

CHAIN = load_chain("cheetah-8u")
CAMERA = Camera.from_hfov(60.0, (1920, 1080))


def states(T: int = 4) -> np.ndarray:
    x = np.tile(mean_pose(CHAIN), (T, 1))
    x[:, CHAIN.position_slice] = [0.0, 0.0, 8.0]
    x[:, CHAIN.position_slice.start] = 0.1 * np.arange(T)
    x[:, 0] += 0.3
    return x


def view():
    xy_px, _ = CAMERA.project(CHAIN.pose(states()).joints_m)
    return still_view(CAMERA, xy_px, np.ones(xy_px.shape[:2]))


def rosenbrock(x):
    return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def rosenbrock_jacobian(x):
    return np.array([[-20 * x[0], 10.0], [-1.0, 0.0]])


@pytest.mark.parametrize(("damping", "factor"), [(1e-2, 10.0), (1e2, 2.0)])
def test_damped_search_finds_the_minimum(damping, factor):
    found = minimise(rosenbrock, rosenbrock_jacobian, np.array([-1.2, 1.0]), 1e-10, 400, damping, factor)
    np.testing.assert_allclose(found.x, 1.0, atol=1e-6)
    assert found.status in (1, 2, 3)
    assert found.cost < 1e-12
    assert found.njev < found.nfev


def test_a_search_that_uses_up_its_evaluations_says_so():
    found = minimise(rosenbrock, rosenbrock_jacobian, np.array([-1.2, 1.0]), 1e-10, 5, 1e-2, 10.0)
    assert (found.status, found.nfev) == (0, 5)


def test_both_solvers_end_at_the_same_pose():
    options = FrameOptions(path="free", tolerance=1e-9)
    minpack, damped = (solve_frames(view(), CHAIN, 90.0, o) for o in (options, replace(options, initial_damping=1e-2)))
    assert damped.status == ("converged",) * 4
    np.testing.assert_allclose(damped.joints_m, minpack.joints_m, atol=1e-3)


def test_the_given_initial_damping_is_used():
    options = FrameOptions(path="free", initial_damping=0.5)
    search, _ = FrameSolver(view(), CHAIN, 90.0, options).search(0)
    assert search.damping[-1] < 0.5
    assert search.damping[0] == pytest.approx(0.5, rel=1e-3) or len(set(search.sigma_px)) > 1


def test_start_angles_are_read_from_a_text():
    angles = parse_start_angles("th6=60, ph1=-5,xi=3,theta_4=10", CHAIN)
    names = CHAIN.state_names
    assert angles == {
        names.index("theta_6"): pytest.approx(np.radians(60)),
        names.index("phi_1"): pytest.approx(np.radians(-5)),
        names.index("xi"): pytest.approx(np.radians(3)),
        names.index("theta_4"): pytest.approx(np.radians(10)),
    }
    rays, _ = CAMERA.rays(view().xy_px)
    state = geometric_start(CAMERA, CHAIN, rays[0], np.array([1.0, 0, 0]), angles)
    np.testing.assert_allclose(state[[*angles]], [*angles.values()])


def test_first_frame_starts_from_the_angles_by_hand():
    solver = FrameSolver(view(), CHAIN, 90.0, FrameOptions(start_angles="th6=80"))
    (start,) = solver._first_starts(solver.rays[0], solver.travel.heading[0])
    assert start[0] == pytest.approx(np.radians(80))


@pytest.mark.parametrize("text", ["foo=3", "th6", "th6=x", "x0=3", ""])
def test_invalid_start_angles_are_refused(text):
    with refusal(("--start-angles", "angle", repr(text), "th6")):
        parse_start_angles(text, CHAIN)
