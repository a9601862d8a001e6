"""Test that a treadmill is detected at any speed, and that results relative to the belt equal results over ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon.animal.prior import prior_from_body
from recon.api.clip import _solve, fit_clip
from recon.api.clip_inputs import ClipInputs
from recon.api.settings import FitSettings
from recon.base.errors import InputError
from recon.check.inputs import movement
from recon.fit.belt import belt_path_m, relative_to_belt
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.motion import Motion
from recon.gait.clip import BELT_GIVEN, ClipAnalysis, analyse, over_belt
from recon.io.camera_files import write_camera
from recon.testing.files import write_keypoints
from recon.testing.gallop import project_clip, whole_gallop
from recon.testing.steady_gait import GALLOP, TROT, SteadyGait, with_exact_states

pytestmark = pytest.mark.usefixtures("no_playback")

SLOW = replace(TROT, speed_m_s=0.5, stride_s=1.2)


@pytest.fixture(scope="module")
def fitted(whole_results) -> Motion:
    return Motion.load(whole_results)


def on_treadmill(fitted: Motion, gait: SteadyGait) -> tuple[Motion, Motion]:
    """Return the motion of an animal over ground, and its motion on a treadmill that runs at the animal's speed."""
    fps = len(fitted.frames) / (3.5 * gait.stride_s)
    over_ground = with_exact_states(fitted, gait.states(fitted.body, fitted.frames / fps), fps)
    path_m = belt_path_m(over_ground.solution, over_ground.time_s, -gait.speed_m_s)
    return over_ground, replace(over_ground, solution=relative_to_belt(over_ground.solution, path_m))


@pytest.mark.parametrize("gait", [GALLOP, TROT, SLOW])
def test_sliding_feet_on_a_treadmill_are_reported_at_any_speed(fitted, gait):
    over_ground, treadmill = on_treadmill(fitted, gait)
    assert "treadmill" not in [found.code for found in movement(over_ground)]
    (found,) = movement(treadmill)
    assert found.code == "treadmill"
    assert found.numbers["slide_m_s"] == pytest.approx(gait.speed_m_s, rel=0.1)
    assert "treadmill" not in [found.code for found in movement(over_belt(treadmill, gait.speed_m_s))]


@pytest.mark.parametrize("gait", [GALLOP, TROT, SLOW])
def test_results_relative_to_the_belt_equal_those_over_ground(fitted, gait):
    over_ground, treadmill = on_treadmill(fitted, gait)
    truth, found = ClipAnalysis(over_ground), analyse(treadmill, belt_speed_m_s=gait.speed_m_s)
    assert found.gait.speed_m_s == pytest.approx(gait.speed_m_s, rel=0.03)
    assert found.gait.stride_length_m == pytest.approx(gait.speed_m_s * gait.stride_s, rel=0.03)
    assert len(found.gait.stances) == len(truth.gait.stances)
    assert found.dynamics.forces["peak_bw"].to_numpy() == pytest.approx(truth.dynamics.forces["peak_bw"], rel=0.03)
    assert found.motion.pictures[0].reprojected_px == pytest.approx(treadmill.pictures[0].reprojected_px, abs=1e-6)


def test_the_belt_speed_is_given_once_and_named_in_the_verdict(fitted):
    _, treadmill = on_treadmill(fitted, TROT)
    findings = (*movement(treadmill),)
    verdict = replace(fitted.verdict, level="do not use", reason="Standing feet slide.")
    found = over_belt(replace(treadmill, findings=findings, verdict=verdict), 3.0)
    assert found.findings == ()
    assert (found.verdict.level, found.verdict.reason) == ("check", BELT_GIVEN)
    with pytest.raises(InputError, match="the fit already used 2 m/s"):
        over_belt(replace(treadmill, settings={"belt_speed_m_s": 2.0}), 3.0)


def test_the_solve_on_the_belt_starts_from_the_first_poses(fitted, monkeypatch):
    """The fit relative to the belt starts from the poses of the first fit.

    From a new start, a dog's runs and a slow walk would end at poses that do not explain the detections.
    """
    begun = []

    def solve(views, *_, start=None):
        begun.append((views, start))
        return fitted.solution

    monkeypatch.setattr("recon.api.clip.solve_trajectory", solve)
    inputs = ClipInputs(fitted.body, prior_from_body(fitted.body), fitted.sources, (0.0,), fitted.fps, None, "")
    _solve(inputs, 2.0, fitted.sources, TrajectoryOptions())
    (_, first), (views, second) = begun
    assert first is None
    path_m = belt_path_m(fitted.solution, fitted.time_s, 2.0)
    assert second.joints_m == pytest.approx(fitted.solution.joints_m + path_m[:, None], nan_ok=True)
    camera_m = np.linalg.inv(views[0].T_camera_world)[:, :3, 3]
    assert camera_m - camera_m[0] == pytest.approx(path_m, abs=1e-9)


@pytest.mark.slow
def test_a_fit_with_the_belt_speed_gives_the_speed_relative_to_the_belt(tmp_path):
    clip, _ = whole_gallop(fps=60, n_frames=40)
    middle_m = clip.truth_m.mean(axis=1)
    time_s = np.arange(len(middle_m)) / 60
    velocity_m_s = np.polyfit(time_s, middle_m, 1)[0] * [1.0, 1.0, 0.0]
    stays_m = clip.truth_m - (time_s - time_s.mean())[:, None, None] * velocity_m_s
    keypoints = project_clip(clip.camera, replace(clip, truth_m=stays_m))
    write_keypoints(keypoints, tmp_path / "run.csv", decimals=2)
    write_camera(clip.camera, tmp_path / "camera.toml")
    speed_m_s = float(np.linalg.norm(velocity_m_s))
    settings = FitSettings(keypoints=tmp_path / "run.csv", camera=tmp_path / "camera.toml", fps=60, fast=True)
    treadmill = fit_clip(settings)
    assert [found.code for found in treadmill.findings if found.severity == "error"] == ["treadmill"]
    motion = fit_clip(replace(settings, belt_speed_m_s=speed_m_s))
    assert "treadmill" not in [found.code for found in motion.findings]
    assert motion.verdict.level == "use"
    assert ClipAnalysis(motion).gait.speed_m_s == pytest.approx(speed_m_s, rel=0.1)
