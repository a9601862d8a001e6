"""Test that later commands read everything that a fit writes, for many skeletons and kinds of cameras."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from shortcuts import leave_out_playback

from recon import Camera, FitSettings, Keypoints, Motion, analyse, evaluate_files, read_keypoints
from recon.animal.body import Body
from recon.animal.skeleton_file import builtin_names, load_skeleton
from recon.api import analyse as analysis
from recon.api.clip_results import run_clip
from recon.api.skeleton_draft import draft_skeleton
from recon.cli.convert import ConvertSettings, convert
from recon.cli.look_options import PageSettings
from recon.cli.show import report
from recon.clip import camera_poses
from recon.io.camera_files import write_camera, write_cameras
from recon.io.deeplabcut import write_csv
from recon.io.formats import CONVERTED, read_points
from recon.testing.cameras import level_pose
from recon.testing.files import write_track

FPS, FRAMES = 60.0, 12
LENS = Camera.from_hfov(60.0, (1920, 1080), name="cam1")


def placed(name: str, centre_m: list[float], yaw: float) -> Camera:
    T = level_pose(centre_m, yaw)
    return replace(LENS, name=name, rotation=T[:3, :3], translation_m=T[:3, 3], world_z_up=True)


CAMERAS = [placed("cam1", [0.0, -7.0, 1.0], np.pi / 2), placed("cam2", [4.0, -6.0, 1.3], np.pi / 2 + 0.5)]


SIX = [
    *CAMERAS,
    placed("cam3", [-4.0, -6.0, 1.3], np.pi / 2 - 0.5),
    placed("cam4", [0.0, 7.0, 1.0], -np.pi / 2),
    placed("cam5", [4.0, 6.0, 1.2], -np.pi / 2 - 0.5),
    placed("cam6", [-4.0, 6.0, 1.1], -np.pi / 2 + 0.5),
]


def keypoints_of(body: Body, camera: Camera, first: int = 0) -> Keypoints:
    """Return keypoints of the animal trotting past, without its first marker and with one bad frame."""
    t = np.arange(FRAMES) + first
    states = np.zeros((FRAMES, body.n_state))
    states[:, 4:] = body.mean_rad + 0.05 * np.sin(t[:, None] / 5 + np.arange(body.n_state - 4))
    states[:, 0], states[:, 2] = 3.0 * t / FPS - 0.3, 0.7
    xy_px, _ = camera.project(body.tree.pose(states).points_m @ _pose(camera)[:3, :3].T + _pose(camera)[:3, 3])
    random = np.random.default_rng(0)
    xy_px = xy_px + random.normal(0, 1, xy_px.shape)
    xy_px[4] = random.uniform(0, 1000, xy_px[4].shape)
    names = body.keypoint_names("right")
    return Keypoints(names[1:], xy_px[:, 1:], np.full(xy_px.shape[:2], 0.9)[:, 1:], np.arange(FRAMES), fps=FPS)


def _pose(camera: Camera) -> np.ndarray:
    return camera_poses([camera])[0]


def settings_of(folder: Path, skeleton: str | Path, cameras: list[Camera], later: tuple[int, ...]) -> FitSettings:
    """Write files of a clip, and return its settings; camera i begins `later[i]` frames after the first."""
    body, files = load_skeleton(skeleton), []
    for camera, first in zip(cameras, later, strict=True):
        files.append(folder / f"run_{camera.name}.csv")
        write_csv(keypoints_of(body, camera, first), files[-1])
    write_cameras(cameras, folder / "cameras.toml")
    offsets = {"offset_s": tuple(n / FPS for n in later)} if any(later) else {}
    given = {"camera": folder / "cameras.toml", "skeleton": str(skeleton), "prior": "none"} | offsets
    return FitSettings(keypoints=tuple(files), fps=FPS, fast=True, **given)  # pyright: ignore[reportArgumentType]


def one_camera(name: str) -> Callable[[Path], FitSettings]:
    return lambda folder: settings_of(folder, name, CAMERAS[:1], (0,))


def one_began_earlier(folder: Path) -> FitSettings:
    return settings_of(folder, "quadruped", CAMERAS, (0, -3))


def six_that_began_apart(folder: Path) -> FitSettings:
    """Return the settings of six cameras that began at different times, with a skeleton drafted from keypoint names."""
    names = load_skeleton("quadruped").markers
    (folder / "drafted.toml").write_text(draft_skeleton(names, "drafted", folder)[2])
    return settings_of(folder, folder / "drafted.toml", SIX, (0, -3, 2, 0, 1, 0))


def bare_root(folder: Path) -> FitSettings:
    """Return the settings of a clip whose skeleton has no marker at the root's origin."""
    text = (Path(__file__).parents[2] / "recon" / "animal" / "skeletons" / "quadruped.toml").read_text()
    moved = text.replace(
        'name = "spine"\nsegment = "rear_trunk"\n', 'name = "spine"\nsegment = "rear_trunk"\nat_m = [0.05, 0.0, 0.0]\n'
    )
    assert moved != text
    (folder / "bare.toml").write_text(moved)
    return settings_of(folder, folder / "bare.toml", CAMERAS[:1], (0,))


def followed(folder: Path) -> FitSettings:
    """Return the settings of a clip of one camera with a track."""
    found = settings_of(folder, "quadruped", CAMERAS[:1], (0,))
    write_camera(LENS, folder / "lens.toml")
    track = write_track(folder / "track.csv", np.arange(FRAMES), np.tile(_pose(CAMERAS[0]), (FRAMES, 1, 1)))
    return replace(found, camera=folder / "lens.toml", camera_track=(track,))


def away_for_a_minute(folder: Path) -> FitSettings:
    """Return the settings of a clip in which the animal leaves and returns; one camera sees it longer."""
    found = settings_of(folder, "quadruped", CAMERAS, (0, 0))
    for path in found.keypoints:
        clip = read_keypoints(path)
        frames = np.concatenate([clip.frames, clip.frames + round(60 * FPS)])
        twice = np.tile(clip.xy_px, (2, 1, 1)), np.tile(clip.confidence, (2, 1))
        write_csv(replace(clip, xy_px=twice[0], confidence=twice[1], frames=frames), path)
    return found


CLIPS = {name: one_camera(name) for name in builtin_names()}
ODD = ("offset", "bare root", "away")
"""Clips whose points are also written in every format."""
QUICK = ("cheetah-24", "mouse-top", "track")
"""Clips that are always tested, because they run different code. Other skeletons differ only in numbers."""
CLIPS |= {"away": away_for_a_minute, "offset": one_began_earlier, "bare root": bare_root, "track": followed}
CLIPS |= {"six, drafted": six_that_began_apart}


@pytest.mark.parametrize("clip", [pytest.param(name, marks=[pytest.mark.slow] * (name not in QUICK)) for name in CLIPS])
def test_later_commands_read_the_results_of_a_fit(clip, tmp_path, undrawn, monkeypatch):
    settings, out = CLIPS[clip](tmp_path), tmp_path / "out"
    if clip not in ODD:
        leave_out_playback(monkeypatch)  # nothing reads it
    run_clip(settings, out)
    motion = Motion.load(out)
    assert motion.solved.sum() > FRAMES / 2
    assert (motion.frames[0] < 0) == (clip in ("offset", "six, drafted"))
    compared = evaluate_files(out / "pose3d.csv", out)
    assert len(compared.frames) - compared.frames_not_scored == motion.solved.sum()
    if clip == "away":
        assert (motion.solved.sum(), len(motion.frames), motion.clip_frames) == (54, 146, FRAMES + 60 * FPS)
    for path in out.glob("reprojection*.csv"):
        np.testing.assert_array_equal(read_keypoints(path).frames, motion.frames)
    found = analyse(motion)
    assert found.reference in motion.names
    assert analysis.figures_of(found)
    analysis.summarise(found, "out")
    for target in CONVERTED:
        if target.writes == ("2D",) or (clip not in ODD and "3D" in target.writes):
            continue
        made = tmp_path / f"pose.{target.name}{target.suffixes[0]}"
        # Convert despite the finding on the mouse, which is 7 m away.
        convert(ConvertSettings(source=out, out=made, to=target.name, anyway=True))
        if "3D" in target.reads and "3D" in target.writes:
            np.testing.assert_array_equal(read_points(made, None, "3D")[1].frames, motion.frames)
    if clip == "bare root":  # a page takes long to write
        report(PageSettings(folder=out))
