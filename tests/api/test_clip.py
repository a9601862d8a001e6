"""Test the clip pipeline on every skeleton: fitted, written and played back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import compare, refusal, says

from recon import FitSettings, InputError, fit_clip, read_pose3d, samples_folder, write_clip
from recon.api.clip_inputs import prepare
from recon.api.clip_results import OUTPUT_FILES, run_clip
from recon.base.files import read_manifest
from recon.base.outputs import RECORD
from recon.clip import still_view
from recon.io.calibration import read_camera
from recon.io.deeplabcut import write_csv
from recon.io.formats import read_keypoints
from recon.thesis.chain import load_chain
from recon.thesis.objectives import FrameOptions
from recon.thesis.solver import solve_frames

pytestmark = pytest.mark.usefixtures("no_playback")

EXAMPLE = (Path(__file__).parents[1] / "files" / "trunk-and-leg.toml").read_text()
# The same chain with its root at the front end.
FRONT_ROOT = EXAMPLE
for old, new in (
    ('root = "hip"\nroot_keypoint = "tail_base"', 'root = "shoulder"\nroot_keypoint = "neck_base"'),
    ('from = "hip"\nto = "mid-spine"', 'from = "shoulder"\nto = "mid-spine"'),
    ('from = "mid-spine"\nto = "shoulder"', 'from = "mid-spine"\nto = "hip"'),
    ('keypoint = "neck_base"\ntheta', 'keypoint = "tail_base"\ntheta'),
):
    assert old in FRONT_ROOT
    FRONT_ROOT = FRONT_ROOT.replace(old, new)


def sample(**options) -> FitSettings:
    folder = samples_folder()
    files = {"keypoints": folder / "noisy.csv", "camera": folder / "camera.toml", "fps": 30, "frames": "0:6"}
    return FitSettings(**(files | options))


@pytest.mark.parametrize("fps", [0.5, 0.999, 10_001.0, 1e5])
def test_an_impossible_frame_rate_is_refused(fps: float, tmp_path):
    with refusal(("--fps", "fps", f"{fps:g}", "1 to 10000")):
        prepare(sample(fps=fps))
    write_csv(replace(read_keypoints(samples_folder() / "noisy.csv"), fps=fps), tmp_path / "stated.csv")
    with refusal((tmp_path / "stated.csv", "fps", f"{fps:g}", "1 to 10000")):
        prepare(sample(keypoints=tmp_path / "stated.csv", fps=None))


def test_a_frame_far_outside_the_picture_is_left_out_and_reported(tmp_path):
    file = read_keypoints(samples_folder() / "noisy.csv")
    xy_px = file.xy_px.copy()
    xy_px[2] += 1e300
    write_csv(replace(file, xy_px=xy_px), tmp_path / "off.csv")
    (source,) = prepare(sample(keypoints=tmp_path / "off.csv", frames="0:20")).sources
    assert not source.keypoints.present[2].any()
    assert source.keypoints.present[[1, 3]].any(axis=1).all()
    (note,) = source.cleaning.notes
    assert says(note, "outside the picture", "left out", "in frame 2, ...")
    assert source.cleaning.total("rejected") == np.isfinite(file.xy_px[2, :, 0]).sum()


def test_keypoints_slightly_outside_the_picture_are_accepted(tmp_path):
    file = read_keypoints(samples_folder() / "noisy.csv")
    xy_px = file.xy_px.copy()
    _, height = read_camera(samples_folder() / "camera.toml").image_size_px
    xy_px[..., 1] += height + 4 - np.nanquantile(xy_px[..., 1], 0.75)  # a quarter lies 4 px or more below the edge
    xy_px[..., 1] = np.minimum(xy_px[..., 1], height + 4)
    write_csv(replace(file, xy_px=xy_px), tmp_path / "low.csv")
    (source,) = prepare(sample(keypoints=tmp_path / "low.csv", frames=None)).sources
    below = source.keypoints.xy_px[..., 1] > height
    assert below.sum() > 0.2 * source.keypoints.present.sum()
    assert source.cleaning.notes == ()


@pytest.mark.parametrize(
    ("change", "perhaps"),
    [
        (lambda xy: xy[..., ::-1] * (0.55, 1.0), "perhaps x and y"),
        (lambda xy: xy * 2.0, "2 times as large"),
        (lambda xy: xy - 3000.0, "camera"),
    ],
)
def test_points_outside_the_picture_are_refused_with_causes(tmp_path, change, perhaps):
    file = read_keypoints(samples_folder() / "noisy.csv")
    xy_px = 0.5 * file.xy_px / np.nanmax(file.xy_px, axis=(0, 1)) * (1920, 1080) + (960, 540)
    write_csv(replace(file, xy_px=change(xy_px)), tmp_path / "other.csv")
    with pytest.raises(InputError) as caught:
        prepare(sample(keypoints=tmp_path / "other.csv", frames=None))
    compare(caught.value.problems, [("camera.toml", "image size", "1920x1080", perhaps)])
    assert says(caught.value.problems[0].expected, "perhaps") == (perhaps != "camera")


def test_another_camera_that_fits_the_points_is_suggested(tmp_path):
    lens = "matrix = [[900, 0, 150], [0, 900, 100], [0, 0, 1]]\ndistortions = [0, 0, 0, 0, 0]"
    pose = "rotation = [0, 0, 0]\ntranslation = [0, 0, 0]"
    sizes = {"small": (300, 200), "large": (1920, 1080)}
    cameras = (f'[{n}]\nname = "{n}"\nsize = [{w}, {h}]\n{lens}\n{pose}\n' for n, (w, h) in sizes.items())
    (tmp_path / "both.toml").write_text("\n".join(cameras))
    with refusal(("both.toml", "image size", "300x200", "large")):
        prepare(sample(camera=tmp_path / "both.toml", camera_name="small"))


@pytest.mark.parametrize(
    ("skeleton", "method"),
    [
        ("cheetah-8u", "frame"),
        ("cheetah-8u", "trajectory"),
        pytest.param("example", "frame", marks=pytest.mark.slow),
        ("example", "trajectory"),
        ("front root", "frame"),
        pytest.param("front root", "trajectory", marks=pytest.mark.slow),
    ],
)
def test_a_chain_is_fitted_and_written(tmp_path, skeleton: str, method: str):
    texts = {"example": EXAMPLE, "front root": FRONT_ROOT}
    if skeleton in texts:
        (tmp_path / "chain.toml").write_text(texts[skeleton])
        skeleton = str(tmp_path / "chain.toml")
    settings = sample(skeleton=skeleton, method=method)
    motion = fit_clip(settings)
    report = write_clip(motion, settings, tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == sorted([*OUTPUT_FILES, RECORD])
    assert report["summary"]["frames"] == 6
    assert report["method"] == method
    assert motion.solved.sum() >= 3
    assert (motion.solution.method, motion.side) == (method, "right")
    assert motion.body.one_sided
    assert motion.angle_names[0].endswith("_yaw")
    assert "neck_base" in motion.names


@pytest.mark.parametrize("subject", [None, pytest.param("jules", marks=pytest.mark.slow)])
def test_a_whole_animal_is_fitted_and_written(tmp_path, subject):
    settings = sample(skeleton="cheetah-24", subject=subject)
    motion = fit_clip(settings)
    report = write_clip(motion, settings, tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == sorted([*OUTPUT_FILES, RECORD])
    assert (motion.side, motion.body.one_sided) == (None, False)
    said = "not measured: all metres and m/s assume average size" if subject is None else "as given (jules)"
    assert says(dict(report["lines"])["size"], said)
    assert report["size"]["measured"] == (subject is not None)
    assert ("Jules" in report["size"]["lengths"]) == (subject is not None)
    assert motion.solved.all()


def test_default_prior_is_the_one_for_the_skeleton():
    assert fit_clip(sample(frames="0:3")).solution.prior == "running-cheetah"
    assert prepare(sample(prior="none")).prior.name == "none"
    assert prepare(sample(skeleton="cheetah-8u")).prior.name == "none"
    with refusal(("prior running-cheetah", "angles", ["24 angles", "16 missing"], "cheetah-8u")):
        fit_clip(sample(skeleton="cheetah-8u", prior="running-cheetah"))


def test_results_of_the_other_method_are_replaced_completely(tmp_path):
    for method in ("trajectory", "frame"):
        settings = sample(method=method, frames="0:3", skeleton="cheetah-8u")
        write_clip(fit_clip(settings), settings, tmp_path)
        assert sorted(p.name for p in tmp_path.iterdir()) == sorted([*OUTPUT_FILES, RECORD])


def test_frame_method_and_side_are_refused_for_a_whole_animal():
    with refusal(("--skeleton", "name or file", "'cheetah-24'", "cheetah-8u")):
        fit_clip(sample(method="frame", skeleton="cheetah-24"))
    with refusal(("--set side", "side", "'left'", "cheetah-24")):
        fit_clip(sample(side="left"))
    with pytest.raises(InputError) as caught:
        fit_clip(sample(side="left", prior="no.npz", camera="no.toml", keypoints="no.csv"))
    assert [problem.file for problem in caught.value.problems][1:3] == ["--prior", "--set side"]
    assert len(caught.value.problems) == 4


def test_tilt_of_a_camera_without_a_pose():
    rough = {"camera": None, "hfov_deg": 60.0, "image_size_px": (1920, 1080)}
    motion = fit_clip(sample(method="frame", tilt_deg=4.0, frames="0:2", **rough))
    np.testing.assert_allclose(motion.camera.up, [0, -np.cos(np.deg2rad(4)), -np.sin(np.deg2rad(4))])
    with refusal(("--tilt-deg", "tilt_deg", [4, "camera.toml"], "only one of the two")):
        fit_clip(sample(tilt_deg=4.0))


def test_a_wide_lens_that_is_not_stated_is_reported():
    """A pinhole camera and the fisheye lens of the sample differ by metres, and the verdict states this effect."""
    clip = {"keypoints": samples_folder() / "whole_cam2.csv", "fps": 60, "frames": "0:12", "fast": True}
    camera = {"hfov_deg": 100.0, "image_size_px": (1920, 1080), "tilt_deg": 4.5}
    not_stated, pinhole, fisheye = (
        fit_clip(FitSettings(**clip, **camera, lens=x)) for x in (None, "pinhole", "fisheye")
    )
    narrow = fit_clip(FitSettings(**clip, **camera | {"hfov_deg": 90.0}))
    assert [("lens_assumed" in {item.code for item in m.findings}) for m in (not_stated, pinhole, fisheye, narrow)] == [
        *(True, False, False, False)
    ]
    item = next(item for item in not_stated.findings if item.code == "lens_assumed")
    centres_m = [m.joints_m.mean(axis=1) for m in (pinhole, fisheye)]
    apart_m = np.linalg.norm(centres_m[0] - centres_m[1], axis=1).mean()
    assert item.severity == "warning"
    assert item.numbers["position_effect_m"] == pytest.approx(apart_m, rel=0.2)
    assert not_stated.verdict.level == "check"
    assert not_stated.verdict.reason_code == "lens_assumed"
    assert not_stated.verdict.position_m.high > apart_m
    np.testing.assert_array_equal(not_stated.joints_m, pinhole.joints_m)
    # The keypoint file is of cam2, but a camera without a file has no name that could contradict this.
    assert "other_camera_named" not in {item.code for item in not_stated.findings}
    truth = read_pose3d(samples_folder() / "whole_truth.csv").xyz_m[:12]
    camera = read_camera(samples_folder() / "whole_scene.json", "cam2")
    true_m = np.linalg.norm(camera.world_to_camera(truth).mean(axis=1), axis=1).mean()
    far = [
        np.linalg.norm(m.joints_m.mean(axis=1) - m.solution.views[0].centre_m, axis=1).mean()
        for m in (pinhole, fisheye)
    ]
    assert abs(far[1] - true_m) < abs(far[0] - true_m)


def test_progress_grows_from_0_to_1():
    for method in ("trajectory", "frame"):
        seen = []
        fit_clip(
            sample(method=method, frames="0:4", skeleton="cheetah-8u"),
            lambda stage, share, seen=seen: seen.append((stage, share)),
        )
        shares = [share for _, share in seen]
        assert all(stage for stage, _ in seen)
        assert shares == sorted(shares)
        assert 0 <= shares[0] < shares[-1] == pytest.approx(1.0)


@pytest.mark.parametrize("method", ["trajectory", "frame"])
def test_points_outside_the_picture_are_refused(method):
    camera = {"camera": None, "hfov_deg": 64.0, "image_size_px": (320, 240)}
    with refusal(("--image-size", "image size", "320x240", "3 times as large")):
        fit_clip(sample(method=method, **camera))


@pytest.mark.parametrize("method", ["trajectory", "frame"])
def test_the_side_with_points_is_fitted_if_the_facing_side_has_none(tmp_path, method):
    """If the side that faces the camera has no points, the other side is fitted."""
    lines = (samples_folder() / "noisy.csv").read_text().splitlines()
    keep = [i for i, name in enumerate(lines[1].split(",")) if not name.startswith("r_")]
    left = "\n".join(",".join(line.split(",")[i] for i in keep) for line in lines)
    (tmp_path / "left.csv").write_text(left + "\n")
    motion = fit_clip(sample(keypoints=tmp_path / "left.csv", skeleton="cheetah-8u", method=method))
    assert motion.side == "left"
    assert says(motion.side_reason, "that side has")
    assert motion.solved.all()


def test_a_pose_outside_the_view_is_not_converged():
    """If all detections are in one pixel, the pose is outside the camera's view and not converged."""
    camera = read_camera(samples_folder() / "camera.toml")
    point = np.full((2, 9, 2), 700.0) + np.linspace(0, 0.5, 9)[:, None]
    solution = solve_frames(still_view(camera, point, np.ones((2, 9))), load_chain("cheetah-8u"), 30.0, FrameOptions())
    assert all(r is not None and r.status == "not_converged" and not r.in_view for r in solution.reports)


# Several cameras


def test_a_run_with_fewer_cameras_removes_tables_of_others(two_cameras, world_trajectory, tmp_path):
    """A run with fewer cameras leaves no tables of other cameras, even if no manifest names them after a killed run."""
    settings, out = sample(), tmp_path / "out"
    write_clip(two_cameras, settings, out)
    of_cameras = {"reprojection_cam1.csv", "reprojection_cam2.csv"}
    assert {p.name for p in out.iterdir()} == {*OUTPUT_FILES, RECORD} - {"reprojection.csv"} | of_cameras
    assert of_cameras < read_manifest(out).files.keys()
    (out / "manifest.json").unlink()
    write_clip(world_trajectory, settings, out)
    assert {p.name for p in out.iterdir()} == {*OUTPUT_FILES, RECORD}
    write_clip(two_cameras, settings, out)
    assert not (out / "reprojection.csv").exists()


def test_tables_of_cameras_count_as_results(two_cameras, tmp_path):
    write_clip(two_cameras, sample(), tmp_path)
    for path in tmp_path.iterdir():
        if not path.name.startswith(("reprojection_", RECORD)):
            path.unlink()
    with refusal(("--out", "folder", ["reprojection_cam1.csv", "1 more", tmp_path], "--overwrite")):
        run_clip(sample(), tmp_path)
