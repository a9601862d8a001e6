"""Test that each script of pipelines/ runs on the samples with its own settings, and check its output."""

from __future__ import annotations

import re
import runpy
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from networks import narrow_networks

import recon
from recon.calibrate.boards import parse_board
from recon.io.video import read_frames, video_writer
from recon.testing.boards import BOARD_CAMERAS, board_poses, draw_board

pytestmark = pytest.mark.usefixtures("no_playback")
ROOT = Path(__file__).resolve().parents[2]
PIPELINES = ROOT / "pipelines"
SCRIPTS = sorted(path.stem for path in PIPELINES.glob("*.py"))
SAMPLES = ROOT / "data" / "samples"
WINGS = {
    "published_study": {"recon.thesis.inspect import read_solver"},
}
"""Imports from optional rooms that a script may have, by script."""
MOST_LINES = 50
"""Maximum number of lines of a script, without its docstring, blank lines and comments."""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a copy of pipelines/ next to the samples and the skeletons, as in the repository."""
    shutil.copytree(PIPELINES, tmp_path / "pipelines", ignore=shutil.ignore_patterns("results", "__pycache__"))
    for name in ("data", "recon"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path / "pipelines"


@pytest.fixture
def said(folder: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Return a function that runs a script after replacing texts of its settings, and returns its output.

    The function is called as `said(name, {old: new, ...})`.
    """

    def run(name: str, changes: dict[str, str] | None = None) -> str:
        file = folder / f"{name}.toml"
        text = file.read_text(encoding="utf-8")
        for old, new in (changes or {}).items():
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        file.write_text(text, encoding="utf-8")
        runpy.run_path(str(folder / f"{name}.py"), run_name="__main__")
        return capsys.readouterr().out

    return run


def test_one_clip(said, folder):
    text = said("one_clip")
    assert "frame 57: data poor\n60 of 60 frames have a pose\nmean speed 13.6 m/s over 0.98 s\n" in text
    (error_mm,) = re.findall(r"joints (\d+) mm from the truth", text)
    assert int(error_mm) < 60
    assert recon.Motion.load(folder / "results" / "one_clip").fps == 60


@pytest.mark.slow
def test_published_study(said, folder):
    text = said("published_study")
    assert text.startswith("30 frames converged; f1 has ")
    (peak, sigma), *_ = re.findall(r"at most ([\d.]+) ± ([\d.]+) m/s", text)
    assert abs(float(peak) - 16.6) < 1.645 * float(sigma)
    assert len(re.findall(r"^theta_\d: closes to", text, re.MULTILINE)) == 7
    assert "extended-energy: joints close to" in text
    results = folder / "results" / "published_study"
    assert (results / "variables.csv").read_text().startswith("frame,time_s,th6,th7,th8,th1,")
    assert (results / "ik" / "parameters.csv").is_file()


@pytest.mark.slow
def test_several_cameras(said, folder):
    text = said("several_cameras")
    assert text.startswith("cam1: 60 frames, 1368 points\ncam2: 60 frames, 1368 points\nThe cameras agree.\n")
    size, sigma = (float(number) for number in re.findall(r"size (.*) ± (.*) times the skeleton's", text)[0])
    assert abs(size - 1.0) < sigma < 0.03
    assert re.search(r"whole_cam1.csv alone places the animal 0.\d\d m away", text)
    assert [camera.name for camera in recon.Motion.load(folder / "results" / "several_cameras").cameras] == [
        "cam1",
        "cam2",
    ]


@pytest.mark.slow
def test_batch(said, folder, in_process):
    text = said("batch")
    assert text.startswith("across: new\ngoing-away: new\n2 done\n")
    assert re.search(r"across: 13.\d m/s, \d+ outliers, transverse gallop\n", text)
    assert (folder / "results" / "batch" / "summary.csv").is_file()


@pytest.mark.slow
def test_calibration(said, folder):
    """Boards in all corners of the picture calibrate a camera. Four boards are refused, naming missing regions."""
    camera, board = BOARD_CAMERAS["radtan"], parse_board("charuco:9x6:30mm:22mm:DICT_4X4_50")
    (folder / "board").mkdir()
    rng = np.random.default_rng(1)
    for number, (rotation, t) in enumerate(board_poses(board, camera, 16, rng, fill=0.65)):
        picture = draw_board(board, camera, rotation, t, oversample=4, blur_px=0.6, noise=2.0, rng=rng)
        cv2.imwrite(str(folder / "board" / f"{number:02d}.png"), picture)
    text = said("calibration")
    assert "16 of 16 pictures show the board, 16 were used" in text
    written = recon.read_camera(folder / "results" / "calibration" / "camera.toml")
    assert written.matrix[0, 0] == pytest.approx(camera.matrix[0, 0], rel=0.01)
    for path in sorted((folder / "board").iterdir())[4:]:
        path.unlink()
    with pytest.raises(SystemExit, match="The calibration was refused"):
        said("calibration", {"camera.toml": "other.toml"})
    assert not (folder / "results" / "calibration" / "other.toml").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_analysis(said, folder, whole_results):
    shutil.copytree(whole_results, folder / "results" / "one_clip")
    text = said("analysis")
    assert text.startswith("spine: 13.7 m/s, at most 16.2 m/s\ntransverse gallop, since")
    assert "l_hind_thigh_pitch: -68 to 7 degrees" in text
    names = ("footfalls", "phase_portraits", "poses", "speed", "vector_field")
    made = {path.name for path in (folder / "results" / "analysis").iterdir()}
    assert made == {f"{name}.{suffix}" for name in names for suffix in ("png", "svg")}


@pytest.mark.slow
def test_new_species(said, folder):
    """A pipeline for a new species finds the sample animal's size and poses, since the skeleton has its lengths."""
    for name in ("several_cameras", "one_clip"):
        with (folder / f"{name}.toml").open("a", encoding="utf-8") as file:
            file.write("fast = true\n")
    text = said("new_species")
    (size,) = re.findall(r"size (\S+) ±", text)
    assert float(size) == pytest.approx(1.0, abs=0.02)
    assert "Used: 1 of 1 segments, " in text
    results = folder / "results" / "new_species"
    error = recon.evaluate_files(results / "3-one-camera" / "one_clip" / "pose3d.csv", SAMPLES / "whole_truth.csv")
    assert error.mpjpe_m.mean < 0.04  # with the prior of the package: 0.049


def small_film(folder: Path) -> None:
    """Write film.mp4 with the first frames of the rendered video at a quarter of its size, and labels.csv."""
    labels = (SAMPLES / "rendered_labels.csv").read_text(encoding="utf-8").splitlines()
    rows = [line.split(",") for line in labels[3:9]]
    small = [",".join([name, *(f"{float(cell) / 4:.2f}" if cell else "" for cell in cells)]) for name, *cells in rows]
    (folder / "labels.csv").write_text("\n".join([*labels[:3], *small, ""]), encoding="utf-8")
    with video_writer(folder / "film.mp4", (160, 90), 120.0) as write:
        for _, picture in read_frames(SAMPLES / "rendered.mp4", 0, 12):
            write(np.asarray(cv2.resize(picture, (160, 90), interpolation=cv2.INTER_AREA), np.uint8))


@pytest.mark.slow
@pytest.mark.usefixtures("optimiser", "undrawn")
def test_video_to_3d(said, folder, monkeypatch):
    """The network learns next to nothing, and all steps from the video to 3D still run."""
    narrow_networks(monkeypatch)
    monkeypatch.setattr("recon.keypoint_net.train.EVALUATIONS", 1)
    small_film(folder)
    changes = {
        "../data/samples/rendered.mp4": "film.mp4",
        "../data/samples/rendered_labels.csv": "labels.csv",
        "minutes = 15": "steps = 1\nbatch = 1",
        "fps = 120": "fps = 120\nlikelihood_min = 0\nfast = true",
    }
    text = said("video_to_3d", changes)
    assert "labels that are probably wrong" in text
    assert "\n12 frames, " in text
    assert " of 12 frames have a pose" in text
    assert (folder / "results" / "video_to_3d" / "motion" / "pose3d.csv").is_file()


def test_page_contains_every_script():
    """The page of the pipelines includes the scripts by reference, so that it is never out of date."""
    page = (ROOT / "docs" / "pipelines.md").read_text(encoding="utf-8")
    shown = re.findall(r'--8<-- "(pipelines/.*)"', page)
    assert sorted(shown) == sorted(str(path.relative_to(ROOT)) for path in PIPELINES.iterdir() if path.is_file())
    assert sorted(re.findall(r"]\(\.\./(pipelines/[^)]+)\)", page)) == sorted(shown)  # for readers on GitHub


@pytest.mark.parametrize("name", SCRIPTS)
def test_script_is_short_and_uses_only_the_public_api(name):
    text = (PIPELINES / f"{name}.py").read_text(encoding="utf-8")
    assert (PIPELINES / f"{name}.toml").is_file()
    code = text.split('"""', 2)[2].splitlines()
    assert sum(bool(line.strip()) and not line.startswith("#") for line in code) <= MOST_LINES
    imported = re.findall(r"^(?:import|from) (recon.*)$", text, re.MULTILINE)
    public = {"recon", "recon.show import plots"}
    assert {*imported} - public == WINGS.get(name, set())
    wings = {"ik", "thesis"} if name in WINGS else set()
    assert {*re.findall(r"\brecon\.(\w+)", text)} <= {*recon.__all__, "show"} | wings
