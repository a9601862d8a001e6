"""Define the fixtures that all tests share."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from command_line import copy_results, run, run_tasks_here
from motions import with_first
from shortcuts import (
    draw_small,
    draw_two_methods,
    fit_demo_from,
    leave_out_drawing,
    leave_out_playback,
    remember_analyses,
    solve_frames_once,
)

from recon import FitSettings
from recon.animal.skeleton_file import load_skeleton
from recon.api.clip_results import run_clip
from recon.cli.commands import make_command
from recon.clip import Keypoints, Source, View, camera_poses, clean, still_view, views_of
from recon.fit.motion import Motion
from recon.fit.result import Ground, MotionSegment, TrajectorySolution
from recon.gait.clip import ClipAnalysis, analyse
from recon.geometry.camera import Camera
from recon.geometry.frames import inverse, moved
from recon.io.deeplabcut import write_csv
from recon.thesis.chain import load_chain, mean_pose
from recon.thesis.objectives import FrameOptions
from recon.thesis.solver import solve_frames

if TYPE_CHECKING:
    from recon.robotics.retarget import Retargeting


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Return the folder of real recordings, RECON_SHARED_DATA or ../shared/data; skip the test without it."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    path = Path(os.environ.get("RECON_SHARED_DATA", default))
    if not path.is_dir():
        pytest.skip(f"no real recordings at {path} (set RECON_SHARED_DATA)")
    return path


SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"


@pytest.fixture(scope="session")
def made_once(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, Callable[[Path], object]], Path]:
    """Return a function that makes a folder once for all processes of the tests.

    `made_once(name, make)` returns the path, and `make(path)` writes the folder, which tests must not change. If two
    processes need the folder at the same time, both make it, and one copy is deleted.
    """
    own = tmp_path_factory.getbasetemp()
    shared = own.parent if "PYTEST_XDIST_WORKER" in os.environ else own

    def once(name: str, make: Callable[[Path], object]) -> Path:
        path = shared / f"shared-{name}"
        if not path.exists():
            # This folder has the depth of the final one, so that relative paths stay valid.
            making = shared / f"{os.environ.get('PYTEST_XDIST_WORKER', 'made')}-{name}"
            make(making)
            with suppress(OSError):  # another process was faster
                making.rename(path)
        return path

    return once


@pytest.fixture(scope="session")
def whole_results(made_once) -> Path:
    """Return the folder of `recon fit` on the whole-animal sample with default options. Tests must not write to it."""
    settings = FitSettings(keypoints=SAMPLES / "whole.csv", camera=SAMPLES / "camera.toml", fps=60)
    return made_once("whole", lambda out: run_clip(settings, out))


@pytest.fixture(scope="session", autouse=True)
def commands_made_once() -> Iterator[None]:
    """Make typer's command of each function only once, because it takes 20 ms and tests call commands often."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("recon.cli.app.make_command", cache(make_command))
        yield


@pytest.fixture
def fitted_demo(whole_results: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fit_demo_from(whole_results, monkeypatch)


@pytest.fixture(scope="session")
def optimiser() -> None:
    """Import torch's optimiser for tests that train, because torch imports much more for the first optimiser."""
    torch = pytest.importorskip("torch")
    torch.optim.AdamW([torch.zeros(1, requires_grad=True)])


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out drawing in tests that do not check figures."""
    leave_out_drawing(monkeypatch)


@pytest.fixture
def no_playback(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the playback in tests that do not check it."""
    leave_out_playback(monkeypatch)


@pytest.fixture
def remembered_analyses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Cache analyses in tests of commands that analyse the same results."""
    remember_analyses(monkeypatch)


@pytest.fixture
def frames_solved_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Solve equal problems of the frame method once, in tests that only use the solutions."""
    solve_frames_once(monkeypatch)


@pytest.fixture
def in_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Run batches in this process, in tests that do not check other processes."""
    for module in ("recon.api.batch", "recon.cli.look"):
        monkeypatch.setattr(f"{module}.run_tasks", run_tasks_here)


@pytest.fixture
def small_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    draw_small(monkeypatch)


@pytest.fixture(scope="session")
def of_results(made_once, whole_results) -> Callable[[str], tuple[str, Path]]:
    """Return a function that runs a command about `results/clip` on `whole_results`, once for all tests.

    `of_results(command)` returns what the command printed and the folder in which it ran, with empty figures. Tests
    must not write to the folder.
    """

    def once(command: str) -> tuple[str, Path]:
        def make(folder: Path) -> None:
            copy_results(whole_results, folder / "results" / "clip")
            with pytest.MonkeyPatch.context() as patch:
                leave_out_drawing(patch)
                draw_two_methods(patch)
                remember_analyses(patch)
                patch.chdir(folder)
                ended = run(*shlex.split(command)[1:])
            assert (ended.code, ended.err) == (0, ""), f"{command}\n{ended.out}{ended.err}"
            (folder / "printed.txt").write_text(ended.out, encoding="utf-8")

        folder = made_once(re.sub(r"\W+", "-", command), make)
        return (folder / "printed.txt").read_text(encoding="utf-8"), folder

    return once


@pytest.fixture(scope="session")
def level_results(made_once) -> Path:
    """Return the folder of the sample fitted with a tilt but without a calibration. Tests must not write to it."""
    settings = FitSettings(
        keypoints=SAMPLES / "whole.csv", hfov_deg=60, image_size_px=(1920, 1080), tilt_deg=3, fps=60, fast=True
    )
    return made_once("level", lambda out: run_clip(settings, out))


@pytest.fixture(scope="session")
def frame_results(made_once) -> Path:
    """Return the folder of `recon frame` on the noisy sample. Tests must not write to it."""
    settings = FitSettings(keypoints=SAMPLES / "noisy.csv", camera=SAMPLES / "camera.toml", fps=30, method="frame")
    return made_once("frame", lambda out: run_clip(settings, out))


@pytest.fixture(scope="session")
def chain_results(made_once) -> Path:
    """Return the folder of the trajectory method with the chain of `frame_results`. Tests must not write to it."""
    settings = FitSettings(
        keypoints=SAMPLES / "noisy.csv", camera=SAMPLES / "camera.toml", fps=30, skeleton="cheetah-8u"
    )
    return made_once("chain", lambda out: run_clip(settings, out))


@pytest.fixture(scope="session")
def whole_analysis(whole_results: Path) -> ClipAnalysis:
    """Return the analysis of `whole_results`."""
    return analyse(Motion.load(whole_results))


@pytest.fixture(scope="session")
def retargeted(whole_results: Path) -> Callable[[str], Retargeting]:
    """Return a function that retargets the motion of `whole_results` to a named robot, once in each process."""
    from recon.robotics.quadruped import load_robot
    from recon.robotics.retarget import reference_of, retarget

    return cache(lambda robot: retarget(reference_of(Motion.load(whole_results)), load_robot(robot)))


@pytest.fixture(scope="session")
def small_motion() -> Motion:
    """Return a motion of six frames (10 to 15), in which a mean pose glides past a pinhole camera.

    The animal moves to the right at 9 m/s and 30 fps, 9 m away. Pixels are exact, except the `neck_base` of frame 14,
    which is 300 px off. Frame 13 has no data, and frame 15 only six points. `nose` is in the file but not in the
    skeleton. `spine` is rejected as unlikely in frame 11.
    """
    chain = load_chain("cheetah-8u")
    camera = Camera.from_hfov(64.0, (1920, 1080))
    states = np.tile(mean_pose(chain), (6, 1))
    states[:, chain.position_slice] = [-1.5, 0.0, 9.0] + 0.3 * np.arange(6)[:, None] * [1.0, 0.0, 0.0]
    xy_px, _ = camera.project(chain.pose(states).joints_m)
    names = chain.body.keypoint_names("right")
    xy_px[4, names.index("neck_base"), 1] -= 300.0
    xy_px[3] = np.nan
    xy_px[5, [1, 4, 6]] = np.nan
    confidence = np.where(np.isnan(xy_px[..., 0]), 0.0, 1.0)
    confidence[1, names.index("spine")] = 0.1
    nose = np.full((6, 1, 2), 100.0)
    file = Keypoints(
        (*names, "nose"),
        np.concatenate([xy_px, nose], axis=1),
        np.concatenate([confidence, np.ones((6, 1))], axis=1),
        np.arange(10, 16),
        fps=30.0,
        source="glide.csv",
    )
    cleaned, cleaning = clean(file, 0.5)
    fitted = replace(
        cleaned, names=names, xy_px=cleaned.xy_px[:, : len(names)], confidence=cleaned.confidence[:, : len(names)]
    )
    source = Source(camera, fitted, cleaning, file.names)
    return Motion((source,), "right", "as given", solve_frames(*views_of([source]), chain, 30.0, FrameOptions()))


@pytest.fixture(scope="session")
def small_trajectory() -> Motion:
    """Return a made-up result of the trajectory method, with eight frames (10 to 17) of a whole cheetah.

    The mean pose glides to the right at 9 m/s and 30 fps, 9 m from a pinhole camera. Keypoints are exactly where the
    detector would see them, except the `nose` of frame 14, which is 300 px off with a low weight. Frame 13 has no
    detections. Frame 15 has a second solution. `ear` is in the file but not in the skeleton, and `r_eye` is in the
    skeleton but not in the file. The left front paw stands in frames 11 and 12.
    """
    body = load_skeleton("cheetah-24")
    camera = Camera.from_hfov(64.0, (1920, 1080))
    camera_from_level = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    states = np.zeros((8, body.n_state))
    states[:, :3] = [-1.5, 9.0, 0.2] + 0.3 * np.arange(8)[:, None] * [1.0, 0.0, 0.0]
    states[:, 4:] = body.mean_rad
    joints = body.tree.pose(states).points_m
    xy_px, _ = camera.project(body.detected.pose(states).points_m @ camera_from_level.T)
    nose, eye, paw = (body.markers.index(name) for name in ("nose", "r_eye", "l_front_paw"))
    xy_px[4, nose, 1] -= 300.0
    xy_px[3], xy_px[:, eye] = np.nan, np.nan
    known = [j for j in range(24) if j != eye]
    file = Keypoints(
        (*(body.markers[j] for j in known), "ear"),
        np.concatenate([xy_px[:, known], np.full((8, 1, 2), 100.0)], axis=1),
        np.ones((8, 24)),
        np.arange(10, 18),
        fps=30.0,
        source="run.csv",
    )
    cleaned, cleaning = clean(file, 0.5)
    weight = np.where(np.isnan(xy_px[..., 0]), np.nan, 1.0)
    weight[4, nose] = 0.05
    contact = np.zeros((8, 4))
    contact[1:3, body.feet.index("l_front_paw")] = 0.9
    # The uncertainty is larger along y, which points away from the camera.
    relative = np.tile(np.diag([0.02, 0.08, 0.02]) ** 2, (8, 24, 1, 1))
    solution = TrajectorySolution(
        body=body,
        views=(still_view(camera, xy_px, np.where(np.isnan(xy_px[..., 0]), 0.0, 1.0)),),
        states=states,
        size=1.0,
        size_sigma=0.06,
        size_prior_sigma=0.1,
        size_from=("prior",),
        joints_m=joints,
        covariance_m2=relative + np.diag([0.05, 0.3, 0.05]) ** 2,
        relative_covariance_m2=relative,
        angle_sigma_rad=np.full((8, body.n_state - 3), 0.1),
        angle_data_share=np.full((8, body.n_state - 3), 0.6),
        data_share=np.linspace(0.5, 0.9, 24),
        noise_px=np.full((1, 8, 24), 10.0),
        weight=weight[None],
        flags=((), (), (), ("no data",), (), ("data poor", "ambiguous depth"), (), ()),
        alternative_m=np.array([0.05] * 5 + [0.3] + [0.05] * 2),
        alternative_cost=3.5,
        contact=contact,
        segments=(MotionSegment(slice(0, 8), Ground(float(joints[0, paw, 2]), np.array([0.0, 0.02]), 0.03)),),
        prior="running-cheetah",
        status="converged",
        cost_by_term={"reprojection": 120.0, "pose prior": 30.0},
        iterations=25,
        time_offset_frames=np.zeros(1),
        time_offset_sigma_frames=np.zeros(1),
        extrinsic_correction=np.zeros((1, 6)),
        extrinsic_correction_sigma=np.zeros((1, 6)),
        focal=np.zeros(1),
        focal_sigma=np.zeros(1),
        sideslip_rad=0.0,
        sideslip_sigma_rad=0.0,
        starts=2,
        stage_s={"starts": 0.2, "all": 0.5},
    )
    fitted = replace(cleaned, names=body.markers, xy_px=xy_px, confidence=np.where(np.isnan(xy_px[..., 0]), 0.0, 1.0))
    return Motion((Source(camera, fitted, cleaning, file.names),), None, "both sides are fitted", solution)


@pytest.fixture(scope="session")
def world_trajectory(small_trajectory: Motion) -> Motion:
    """Return `small_trajectory` seen by a camera at (1, 2, 3) m that looks along x, with its right along -y, z up."""
    rotation = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    camera = replace(small_trajectory.camera, rotation=rotation, translation_m=-rotation @ [1.0, 2.0, 3.0])
    level = small_trajectory.solution
    (view,) = level.views
    T_world_level = inverse(camera_poses([camera])[0]) @ view.T_camera_world
    R, origin_m = T_world_level[:3, :3], T_world_level[:3, 3]
    states = level.states.copy()
    states[:, :3] = moved(T_world_level, states[:, :3])
    states[:, 3] += np.arctan2(R[1, 0], R[0, 0])
    segments = tuple(
        MotionSegment(
            segment.rows,
            segment.ground and replace(segment.ground, slope=R[:2, :2] @ segment.ground.slope).about(origin_m, 1),
        )
        for segment in level.segments
    )
    solution = replace(
        level,
        views=(still_view(camera, view.xy_px, view.confidence),),
        states=states,
        joints_m=moved(T_world_level, level.joints_m),
        covariance_m2=R @ level.covariance_m2 @ R.T,
        relative_covariance_m2=R @ level.relative_covariance_m2 @ R.T,
        segments=segments,
    )
    return replace(with_first(small_trajectory, camera=camera), solution=solution)


@pytest.fixture(scope="session")
def two_cameras(world_trajectory: Motion) -> Motion:
    """Return `world_trajectory`, also seen by a second camera.

    `cam2` is at (10, -8, 2.5) m and looks along y, with its right along x. It did not see frames 10 and 11. Its
    `tail_base` of frame 15 is 200 px off.
    """
    motion = world_trajectory
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    camera = replace(motion.camera, name="cam2", rotation=rotation, translation_m=-rotation @ [10.0, -8.0, 2.5])
    xy_px, _ = camera.project(camera.world_to_camera(motion.solution.markers_m))
    xy_px[:2] = np.nan
    xy_px[5, motion.names.index("tail_base"), 0] += 200.0
    file = Keypoints(
        motion.names, xy_px[2:], np.ones(xy_px.shape[:2])[2:], np.arange(12, 18), fps=30.0, source="cam2.csv"
    )
    _, cleaning = clean(file, 0.5)
    seen = np.isfinite(xy_px[..., 0])
    keypoints = replace(file, xy_px=xy_px, confidence=seen.astype(float), frames=motion.frames)
    solution = replace(
        motion.solution,
        views=(*motion.solution.views, still_view(camera, xy_px, seen.astype(float))),
        noise_px=np.concatenate([motion.solution.noise_px, np.full((1, *seen.shape), 20.0)]),
        weight=np.concatenate([motion.solution.weight, np.where(seen, 0.5, np.nan)[None]]),
        time_offset_frames=np.zeros(2),
        time_offset_sigma_frames=np.full(2, 0.1),
        extrinsic_correction=np.zeros((2, 6)),
        extrinsic_correction_sigma=np.zeros((2, 6)),
        focal=np.zeros(2),
        focal_sigma=np.zeros(2),
        size_from=("prior", "views"),
    )
    second = Source(camera, keypoints, cleaning, file.names)
    return replace(motion, solution=solution, sources=(*motion.sources, second))


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with the run of `example_run` as run_cam1.csv, run_cam2.csv and scene.json.

    run_cam2.csv lacks the first ten frames.
    """
    from example_run import AHEAD, ASIDE, FISHEYE, keypoints_of, truth_m

    out, cameras = tmp_path_factory.mktemp("two"), []
    for number, (pose, first) in enumerate(((AHEAD, 0), (ASIDE, 10)), start=1):
        points = truth_m()
        blank = View(FISHEYE, pose, np.zeros((*points.shape[:2], 2)), np.ones(points.shape[:2]))
        noise = 2.0 * np.random.default_rng(number).normal(size=blank.xy_px.shape)
        write_csv(keypoints_of((blank.project(points)[0] + noise)[first:], first), out / f"run_cam{number}.csv")
        rotation, t = pose[:3, :3].tolist(), pose[:3, 3, None].tolist()
        cameras.append({"k": FISHEYE.matrix.tolist(), "d": [[0.0]] * 4, "r": rotation, "t": t, "name": f"cam{number}"})
    (out / "scene.json").write_text(json.dumps({"camera_resolution": [1920, 1080], "cameras": cameras}))
    return out


@pytest.fixture
def clips(tmp_path) -> Path:
    """Return a folder with three clips for the frame method."""
    folder = tmp_path / "clips"
    folder.mkdir()
    for name in ("a", "b", "c"):
        shutil.copy(SAMPLES / "noisy.csv", folder / f"{name}.csv")
    return folder
