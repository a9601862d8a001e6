"""The clip pipeline on every skeleton: fitted, written and played back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recon.calibration import read_camera
from recon.errors import InputError
from recon.pipelines.clip import OUTPUT_FILES, fit_clip, write_clip
from recon.pipelines.demo import samples_folder
from recon.settings import FitSettings
from recon.skeleton_file import builtin_chains, load_skeleton
from recon.solve import FrameOptions, solve_frames

EXAMPLE = (Path(__file__).parents[1] / "docs" / "skeletons.md").read_text().split("```toml")[2].split("```")[0]
# The same chain, hung from its front end: the root is the joint that the animal's front is known by.
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
    return FitSettings.model_validate(files | options)


@pytest.mark.parametrize("skeleton", [*builtin_chains(), "example", "front root"])
def test_every_skeleton_is_fitted_and_written(tmp_path, skeleton: str):
    texts = {"example": EXAMPLE, "front root": FRONT_ROOT}
    if skeleton in texts:
        (tmp_path / "chain.toml").write_text(texts[skeleton])
        skeleton = str(tmp_path / "chain.toml")
    settings = sample(skeleton=skeleton)
    motion = fit_clip(settings)
    report = write_clip(motion, settings, tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == sorted(OUTPUT_FILES)
    assert report["summary"]["frames"] == 6
    assert motion.solved.sum() >= 3


def test_points_outside_the_picture_are_another_cameras():
    camera = {"camera": None, "hfov_deg": 64.0, "image_size_px": (320, 240)}
    with pytest.raises(InputError, match="320x240, but keypoints at x"):
        fit_clip(sample(**camera))


def test_the_side_with_points_is_fitted_when_the_facing_one_has_none(tmp_path):
    """The sample faces right; a file with its left legs only is fitted by those."""
    lines = (samples_folder() / "noisy.csv").read_text().splitlines()
    keep = [i for i, name in enumerate(lines[1].split(",")) if not name.startswith("r_")]
    left = "\n".join(",".join(line.split(",")[i] for i in keep) for line in lines)
    (tmp_path / "left.csv").write_text(left + "\n")
    motion = fit_clip(sample(keypoints=tmp_path / "left.csv"))
    assert motion.side == "left"
    assert "but that side has" in motion.side_reason
    assert motion.solved.all()


def test_a_pose_out_of_sight_is_not_converged():
    """Detections that no animal of that size can have made: all in one pixel."""
    camera = read_camera(samples_folder() / "camera.toml")
    point = np.full((2, 9, 2), 700.0) + np.linspace(0, 0.5, 9)[:, None]
    solution = solve_frames(camera, load_skeleton("cheetah-8u"), point, np.ones((2, 9)), 30.0, FrameOptions())
    assert all(r is not None and r.status == "not_converged" and not r.in_view for r in solution.reports)
