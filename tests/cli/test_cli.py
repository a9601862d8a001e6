"""Test the command line from end to end: files, messages and exit codes."""

from __future__ import annotations

import csv
import io
import json
import os
import re
import shutil
import signal
from collections.abc import Callable
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from command_line import Ended, Refusal, refused, run, run_process, says
from rerun.chunk import RrdReader

import recon.cli.app
import recon.show.tables
import recon.show.view
from recon import FitSettings, Motion, evaluate_files, read_settings
from recon.animal.body import MIN_JOINTS
from recon.api.clip_results import OUTPUT_FILES, output_files, read_config, write_clip
from recon.base.arrays import to_plain
from recon.base.numbers import percent
from recon.base.outputs import RECORD, Output
from recon.check.verdict import verdict_lines
from recon.cli.answers import answer_of_fit, error_text, say, table_of, terminal
from recon.cli.commands import help_of
from recon.fit.motion_forms import CONFIG
from recon.io.formats import read_keypoints

SAMPLES = Path(__file__).parents[2] / "data" / "samples"
CLIP, CAMERA, TRUTH = SAMPLES / "noisy.csv", SAMPLES / "camera.toml", SAMPLES / "noisy_truth.csv"
FITTED = {f"r_{leg}_{joint}" for leg in ("front", "back") for joint in ("knee", "ankle", "paw")} | {
    "neck_base",
    "spine",
    "tail_base",
}
needs_sigkill = pytest.mark.skipif(os.name != "posix", reason="SIGKILL is of POSIX")


def whole_args(
    out: Path, *more: object, keypoints: Path = CLIP, camera: Path | None = CAMERA, fps: object = 30
) -> list:
    """Return the arguments of a fit with the default method."""
    return ["fit", keypoints, *(["--camera", camera] if camera else []), "--fps", fps, "--out", out, *more]


def fit_args(out: Path, *more: object, **options) -> list:
    """Return the arguments of a fit with the frame method."""
    return whole_args(out, "--set", "method=frame", *more, **options)


def report_of(folder: Path) -> dict:
    return json.loads((folder / "report.json").read_text(encoding="utf-8"))


def assert_same_reports(one: Path, other: Path) -> None:
    """Check that two reports are the same, except for times and for the paths of the same files."""
    first, second = (without_timing(report_of(folder)) | {"settings": None} for folder in (one, other))
    assert first == second
    assert read_settings(one / "config.toml", {}) == read_settings(other / "config.toml", {})


def without_timing(report: dict) -> dict:
    lines = [line for line in report["lines"] if line[0] != "effort"]
    return {key: value for key, value in report.items() if key != "timing_s"} | {"lines": lines}


def files(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def rewrite(path: Path, change: Callable[[list[list[str]]], object]) -> Path:
    """Write the noisy sample with some cells changed as another file."""
    with CLIP.open(newline="") as file:
        rows = list(csv.reader(file))
    change(rows)
    with path.open("w", newline="") as file:
        csv.writer(file).writerows(rows)
    return path


def keep_only(*names: str) -> Callable[[list[list[str]]], None]:
    def change(rows: list[list[str]]) -> None:
        for row in rows[3:]:
            for column, name in enumerate(rows[1]):
                if column and name not in names:
                    row[column] = "0" if rows[2][column] == "likelihood" else ""

    return change


@pytest.fixture(scope="module")
def fitted(tmp_path_factory) -> tuple[Path, Ended]:
    """Return the folder and the outcome of `recon frame` on the noisy sample."""
    out = tmp_path_factory.mktemp("fit") / "results" / "clip"
    return out, run(*fit_args(out))


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> tuple[Path, Ended]:
    """Return the folder and the outcome of `recon fit` with the default method, which fits the whole animal."""
    out = tmp_path_factory.mktemp("fit") / "whole"
    return out, run(*whole_args(out))


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> Path:
    """Return a folder of inputs, most of which cannot be used."""
    folder = tmp_path_factory.mktemp("inputs")
    (folder / "empty.csv").touch()
    (folder / "header.csv").write_text("frame,x,y\n0,1,2\n")
    (folder / "binary.csv").write_bytes(bytes(range(256)))
    (folder / "camera.txt").write_text("f = 3")
    (folder / "empty.toml").touch()
    (folder / "skeleton.toml").write_text('name = "mine"\n')
    (folder / "config.toml").write_text("[recon.fit\n")
    size = {"camera_matrix": [[1600, 0, 960], [0, 1600, 540], [0, 0, 1]], "dist_coeffs": [0, 0, 0, 0]}
    (folder / "no_size.json").write_text(json.dumps(size))
    two = "".join(f'[{name}]\nname = "{name}"\n' + ANIPOSE for name in ("cam_a", "cam_b"))
    (folder / "two.toml").write_text(two)

    def set_cell(rows: list[list[str]]) -> None:
        rows[8][4] = "abc"

    def rename(rows: list[list[str]]) -> None:
        rows[1] = [rows[1][0], *(f"wing_{name}" for name in rows[1][1:])]

    def two_animals(rows: list[list[str]]) -> None:
        for i, row in enumerate(rows):
            rows[i] = [*row, *row[1:]]
        half = (len(rows[0]) - 1) // 2
        rows.insert(1, ["individuals", *["animal1"] * half, *["animal2"] * half])

    rewrite(folder / "cell.csv", set_cell)
    rewrite(folder / "missing.csv", keep_only())
    rewrite(folder / "wings.csv", rename)
    rewrite(folder / "animals.csv", two_animals)
    return folder


ANIPOSE = """size = [1920, 1080]
matrix = [[1600, 0, 960], [0, 1600, 540], [0, 0, 1]]
distortions = [0, 0, 0, 0, 0]
rotation = [0, 0, 0]
translation = [0, 0, 0]

"""

# Fits with the frame method


def test_fit_writes_every_output(fitted):
    out, ended = fitted
    assert ended.code == 0
    assert ended.err == ""
    assert sorted(path.name for path in out.iterdir()) == sorted([*OUTPUT_FILES, RECORD])
    assert all(path.stat().st_size for path in out.iterdir())
    assert "30 of 30 converged" in ended.out
    assert f"recon view {out}" in ended.out
    assert ended.out == ended.out.strip("\n") + "\n"


def test_pose3d_has_two_header_rows_and_the_frames_of_the_clip(fitted):
    out, _ = fitted
    lines = (out / "pose3d.csv").read_text().splitlines()
    assert lines[0].startswith("bodyparts,")
    assert lines[1].startswith("coords,x,y,z,x,y,z")
    assert lines[2].startswith("0,")
    table = pd.read_csv(out / "pose3d.csv", header=[0, 1], index_col=0)
    assert table.index.tolist() == list(range(30))
    assert set(table.columns.get_level_values(0)) == FITTED
    assert table.shape == (30, 27)
    assert evaluate_files(out / "pose3d.csv", TRUTH).mpjpe_m.mean < 0.06


def test_angles_and_reprojection_agree_with_the_report(fitted):
    out, _ = fitted
    angles = pd.read_csv(out / "angles.csv", index_col="frame")
    assert angles.index.tolist() == list(range(30))
    assert np.isfinite(angles.to_numpy()).all()
    assert {str(name).rsplit("_", 1)[1] for name in angles} == {"rad", "m"}
    assert [f"{name}_rad" for name in report_of(out)["skeleton"]["state_names"][3:]] == list(angles.columns[3:])
    base_m = report_of(out)["base_length_m"]
    assert 0.15 < base_m["min"] <= base_m["max"] < 0.25
    pixels = read_keypoints(out / "reprojection.csv")
    detected = read_keypoints(CLIP)
    shared = [pixels.names.index(name) for name in sorted(FITTED)]
    of_file = [detected.names.index(name) for name in sorted(FITTED)]
    distance = np.linalg.norm(pixels.xy_px[:, shared] - detected.xy_px[:, of_file], axis=-1)
    assert np.nanmedian(distance) == pytest.approx(report_of(out)["summary"]["reprojection_px"]["median"], abs=5e-3)
    assert (out / "motion.rrd").read_bytes()[:3] == b"RRF"


def test_report_and_config_of_a_chain_record_inputs_and_settings(fitted):
    out, _ = fitted
    report = report_of(out)
    assert report["schema"]["name"] == "recon.fit.report"
    assert report["recon_version"] == metadata.version("recon-motion")
    assert report["summary"]["frames"] == report["summary"]["frames_converged"] == 30
    assert report["side"]["fitted"] == "right"
    assert report["frame_of_reference"] == "world"
    assert report["timing_s"]["solve_s"] > 0
    assert set(report["unused_keypoints"]) == {name.replace("r_", "l_", 1) for name in FITTED if name[:2] == "r_"}
    settings = read_settings(out / "config.toml", {})
    assert settings == FitSettings(keypoints=CLIP, camera=CAMERA, fps=30, method="frame")
    assert report["settings"] == settings.plain(out)


@pytest.mark.usefixtures("no_playback")
def test_options_overrule_the_config(fitted, tmp_path):
    out, _ = fitted
    other = tmp_path / "other"
    more = ("--frames", "5:9", "--set", "side=left", "--set", "likelihood-min=0.95", "--fps", "60")
    assert run("fit", "--config", out / "config.toml", "--out", other, *more).code == 0
    report = report_of(other)
    mine, theirs = (read_settings(folder / "config.toml", {}) for folder in (other, out))
    assert replace(mine, frames=None, side="auto", likelihood_min=0.5, fps=30.0) == theirs
    assert report["input"]["frames"] == [5, 9]
    assert report["side"]["fitted"] == "left"
    table = pd.read_csv(other / "pose3d.csv", header=[0, 1], index_col=0)
    assert table.index.tolist() == [5, 6, 7, 8]
    assert "l_front_paw" in table.columns.get_level_values(0)


@pytest.mark.usefixtures("no_playback", "undrawn")
def test_results_can_be_moved_together_with_their_inputs(tmp_path, monkeypatch):
    """Results can be moved together with their inputs, and no file in them contains the old path."""
    house, skeleton = (
        tmp_path / "home" / "me",
        Path(__file__).parents[2] / "recon" / "animal" / "skeletons" / "cheetah-24.toml",
    )
    house.mkdir(parents=True)
    for path in (CLIP, CAMERA, skeleton):
        shutil.copy(path, house / path.name)
    monkeypatch.chdir(house)
    args = whole_args(Path("out"), "--frames", ":5", keypoints=Path("noisy.csv"), camera=Path("camera.toml"))
    assert run(*args, "--skeleton", "cheetah-24.toml").code == 0
    assert run("report", "out").code == 0
    for name in ("report.json", "config.toml", "report.html"):
        assert str(tmp_path) not in (house / "out" / name).read_text(encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    moved = (tmp_path / "home").rename(tmp_path / "elsewhere") / "me"
    settings = read_settings(moved / "out" / "config.toml", {})
    assert (settings.keypoints, settings.camera) == ((moved / "noisy.csv",), (moved / "camera.toml",))


@pytest.mark.usefixtures("no_playback", "frames_solved_once")
def test_a_config_with_missing_or_changed_files_is_reported(tmp_path):
    for path in (CLIP, CAMERA):
        shutil.copy(path, tmp_path / path.name)
    out, config = tmp_path / "moved" / "out", tmp_path / "moved" / "out" / "config.toml"
    clip, args = tmp_path / "noisy.csv", ("--frames", ":2")
    assert run(*fit_args(out, *args, keypoints=clip, camera=tmp_path / "camera.toml")).code == 0
    again = run("fit", "--config", config, "--out", tmp_path / "again")
    assert "note" not in again.out
    rewrite(clip, lambda rows: rows[3].__setitem__(1, "700"))
    said = f"note: {clip} is not the file for which {config} was written: its content differs"
    assert run("fit", "--config", config, "--out", tmp_path / "other").out.splitlines()[0] == said
    assert "note" not in run("fit", clip, "--config", config, "--out", tmp_path / "given").out
    clip.unlink()
    missing = (config, "keypoints", f"{clip}, no such file", "config.toml")
    refused(["fit", "--config", config, "--out", tmp_path / "gone"], missing)


@pytest.mark.usefixtures("no_playback")
def test_fit_with_a_field_of_view_instead_of_a_camera_file(tmp_path):
    args = fit_args(tmp_path, "--hfov-deg", 60, "--image-size", "1920x1080", "--frames", ":10", camera=None)
    assert run(*args).code == 0
    report = report_of(tmp_path)
    assert report["frame_of_reference"] == "camera"
    assert report["summary"]["frames_converged"] == 10
    assert report["assumptions"]["camera_level"] is True
    # The animal is in front of the camera, at about the distance of the sample's animal.
    depth = pd.read_csv(tmp_path / "pose3d.csv", header=[0, 1], index_col=0).xs("z", axis=1, level=1)
    assert 8 < depth.to_numpy().mean() < 22


@pytest.mark.usefixtures("no_playback")
def test_image_size_is_read_from_the_command_line(inputs, tmp_path):
    args = fit_args(tmp_path, "--image-size", "1920x1080", "--frames", ":3", camera=inputs / "no_size.json")
    assert run(*args).code == 0
    assert report_of(tmp_path)["summary"]["frames_converged"] == 3


@pytest.mark.usefixtures("no_playback")
def test_options_choose_the_camera_and_the_animal(inputs, tmp_path):
    more = ("--camera-name", "cam_b", "--individual", "animal2", "--frames", ":3")
    assert run(*fit_args(tmp_path, *more, keypoints=inputs / "animals.csv", camera=inputs / "two.toml")).code == 0
    assert report_of(tmp_path)["settings"]["camera_name"] == "cam_b"


@pytest.mark.usefixtures("fitted_demo", "no_playback", "frames_solved_once")
@pytest.mark.parametrize("command", ["fit", "demo"])
def test_quiet_prints_nothing(command, tmp_path):
    args = fit_args(tmp_path / "a", "--frames", ":3") if command == "fit" else ["demo", "--out", tmp_path / "a"]
    assert run(*args, "--quiet") == Ended(0, "", "")


@pytest.mark.usefixtures("no_playback", "frames_solved_once")
def test_brackets_in_names_are_printed_unchanged(tmp_path):
    out = tmp_path / "[red]run [1]"
    ended = run(*fit_args(out, "--frames", ":3"))
    assert f"Results are in {out}." in ended.out
    assert f"recon view '{out}'" in ended.out
    nowhere = tmp_path / "[bold]:smile:.csv"
    refused(fit_args(tmp_path / "b", keypoints=nowhere), (nowhere, "file", "no such file"))


# Fits with the default method


def test_trajectory_writes_every_output(whole):
    out, ended = whole
    assert (ended.code, ended.err) == (0, "")
    assert sorted(path.name for path in out.iterdir()) == sorted([*OUTPUT_FILES, RECORD])
    assert all(path.stat().st_size for path in out.iterdir())
    assert "30 of 30 with a pose" in ended.out
    assert ended.out.startswith("verdict     check: The frame rate is low")  # 30 frames per second of a fast gallop
    assert f"recon view {out}" in ended.out


def test_tables_of_a_trajectory_can_be_read(whole):
    out, _ = whole
    pose = pd.read_csv(out / "pose3d.csv", header=[0, 1], index_col=0)
    sigma = pd.read_csv(out / "pose3d_sigma.csv", header=[0, 1], index_col=0)
    quality = pd.read_csv(out / "quality.csv", index_col="frame")
    angles = pd.read_csv(out / "angles.csv", index_col="frame")
    assert pose.shape == (30, 24 * 3)
    assert set(pose.columns.get_level_values(0)) >= FITTED | {"nose", "tail2", "l_front_paw"}
    assert sigma.shape == (30, 24 * 6)
    assert (sigma.to_numpy() > 0).all()
    for table in (pose, sigma, quality, angles):
        assert table.index.tolist() == list(range(30))
    assert np.isfinite(angles.to_numpy()).all()
    assert {str(name).rsplit("_", 1)[1] for name in angles} == {"rad", "m"}
    pixels, detected = read_keypoints(out / "reprojection.csv"), read_keypoints(CLIP)
    shared = [name for name in pixels.names if name in detected.names]
    assert len(shared) == len(detected.names) == 15
    of_pose, of_file = ([k.names.index(name) for name in shared] for k in (pixels, detected))
    distance = np.linalg.norm(pixels.xy_px[:, of_pose] - detected.xy_px[:, of_file], axis=-1)
    assert np.nanmedian(distance) == pytest.approx(report_of(out)["summary"]["reprojection_px"]["median"], abs=5e-3)


def test_report_and_config_of_a_trajectory_record_inputs_and_settings(whole):
    out, _ = whole
    report = report_of(out)
    assert report["method"] == "trajectory"
    assert report["skeleton"]["name"] == "cheetah-24"
    assert (report["skeleton"]["states_frame"], report["frame_of_reference"]) == ("world", "world")
    assert report["side"]["fitted"] is None
    assert report["prior"]["name"] == "running-cheetah"
    assert report["summary"]["frames"] == report["summary"]["frames_with_pose"] == 30
    assert set(report["missing_keypoints"]) == {"nose", "l_eye", "r_eye", "tail1", "tail2"} | {
        f"{side}_{name}" for side in "lr" for name in ("shoulder", "hip")
    }
    assert report["timing_s"]["solve_s"] > 0
    settings = read_settings(out / "config.toml", {})
    assert settings == FitSettings(keypoints=CLIP, camera=CAMERA, fps=30)
    assert report["settings"] == settings.plain(out)


@pytest.mark.usefixtures("no_playback")
def test_config_repeats_a_trajectory_bit_for_bit(whole, tmp_path, monkeypatch):
    out, _ = whole
    monkeypatch.chdir(tmp_path)
    assert run("fit", "--config", out / "config.toml", "--out", "other").code == 0
    other = tmp_path / "other"
    for name in OUTPUT_FILES:
        # These files contain times of the run.
        if name not in ("report.json", "motion.npz", "motion.rrd", "manifest.json", "config.toml"):
            assert (other / name).read_bytes() == (out / name).read_bytes(), name
    assert_same_reports(out, other)


@pytest.mark.usefixtures("no_playback")
def test_options_of_the_trajectory_method_reach_the_fit(tmp_path):
    more = (
        "--skeleton",
        "cheetah-24",
        "--subject",
        "jules",
        "--prior",
        "none",
        "--set",
        "ground=none",
        "--set",
        "fast=true",
    )
    assert run(*whole_args(tmp_path, *more, "--set", "size-sigma=0.01", "--frames", ":10")).code == 0
    report = report_of(tmp_path)
    assert "Jules" in report["size"]["lengths"]
    assert (report["size"]["measured"], report["size"]["prior_sigma"]) == (True, 0.01)
    assert report["size"]["factor"] == pytest.approx(1, abs=0.1)
    assert (report["prior"]["name"], report["segments"][0]["ground"]) == ("none", None)
    assert any("fast" in sentence for sentence in report["assumptions"]["sentences"])
    again = tmp_path / "again"
    assert run("fit", "--config", tmp_path / "config.toml", "--set", "fast=false", "--out", again).code == 0
    mine, theirs = (read_settings(folder / "config.toml", {}) for folder in (again, tmp_path))
    assert replace(mine, fast=True) == theirs


@pytest.mark.usefixtures("no_playback")
def test_a_chain_is_fitted_by_the_trajectory_method(tmp_path):
    assert run(*whole_args(tmp_path, "--skeleton", "cheetah-8u")).code == 0
    table = pd.read_csv(tmp_path / "pose3d.csv", header=[0, 1], index_col=0)
    assert set(table.columns.get_level_values(0)) == FITTED
    angles = pd.read_csv(tmp_path / "angles.csv", index_col="frame")
    assert list(angles.columns[5:8]) == ["J0_roll_rad", "phi_6_rad", "theta_6_rad"]
    report = report_of(tmp_path)
    assert (report["side"]["fitted"], report["skeleton"]["states_frame"]) == ("right", "world")
    assert set(report["stances"]) == {"r_front_paw", "r_back_paw"}


@pytest.mark.slow
def test_tilt_of_the_camera_is_in_the_report(tmp_path):
    args = ("--hfov-deg", 60, "--image-size", "1920x1080", "--tilt-deg", 3, "--frames", ":6")
    assert run(*whole_args(tmp_path, *args, camera=None)).code == 0
    assumptions = report_of(tmp_path)["assumptions"]
    assert assumptions["camera_level"] is False
    assert assumptions["camera_tilt_rad"] == pytest.approx(np.deg2rad(3))


# Bad input

NO_OUT = ("--out", "folder", "nothing", "results/clip1")
FRAME = ["--set", "method=frame"]
OF_A_SKELETON = ["title", "forward", "feet", "keypoint_sigma_m", "size_sigma", "segments", "markers", "limbs"]
"""Required fields in the file of a whole animal. A file without links is read as one."""
BAD_INPUT: dict[str, tuple[list[str], list[Refusal]]] = {
    "missing file": (["{in}/no.csv"], [("{in}/no.csv", "file", "no such file")]),
    "folder for a file": (["{in}"], [("{in}", "file", "a folder")]),
    "empty file": (["{in}/empty.csv"], [("{in}/empty.csv", "file", "empty")]),
    "wrong header": (["{in}/header.csv"], [("{in}/header.csv", "format", "frame,x,y")]),
    "binary file": (["{in}/binary.csv"], [("{in}/binary.csv", "format", "binary")]),
    "missing camera file": (["{clip}", "--camera", "{in}/no.toml"], [("{in}/no.toml", "file", "no such file")]),
    "empty camera file": (["{clip}", "--camera", "{in}/empty.toml"], [("{in}/empty.toml", "file", "empty")]),
    "camera of no known format": (["{clip}", "--camera", "{in}/camera.txt"], [("{in}/camera.txt", "format", ".txt")]),
    "no such camera": (
        ["{clip}", "--camera", "{in}/two.toml", "--camera-name", "cam9"],
        [("{in}/two.toml", "camera", "cam9", "cam_a, cam_b")],
    ),
    "no camera chosen": (
        ["{clip}", "--camera", "{in}/two.toml"],
        [("{in}/two.toml", "camera", "2 cameras", "cam_a, cam_b")],
    ),
    "no such individual": (
        ["{in}/animals.csv", "--individual", "animal3"],
        [("{in}/animals.csv", "individual", "animal3", "animal1, animal2")],
    ),
    "no individual chosen": (
        ["{in}/animals.csv"],
        [("{in}/animals.csv", "individual", ["2 animals", "--individual"], "animal1, animal2")],
    ),
    "individual in a file of one": (["{clip}", "--individual", "a"], [("{clip}", "individual", "without named")]),
    "non-numeric cell": (["{in}/cell.csv"], [("{in}/cell.csv", "line 9, spine/x", "'abc'", "number")]),
    "all points missing": (["{in}/missing.csv"], [("{in}/missing.csv", "points", "every point")]),
    "none of the skeleton's keypoints": (
        ["{in}/wings.csv"],
        [("{in}/wings.csv", "bodyparts", "wing_neck_base, wing_spine")],
    ),
    "fps 0": (["{clip}", "--fps", "0"], [("--fps", "fps", "'0'", "greater than 0")]),
    "fps that is no number": (["{clip}", "--fps", "90fps"], [("--fps", "fps", "'90fps'", "number")]),
    "no image size in the camera file": (
        ["{clip}", "--camera", "{in}/no_size.json"],
        [("{in}/no_size.json", "size", "nothing", "--image-size")],
    ),
    "image size against the camera file's": (
        ["{clip}", "--image-size", "640x480"],
        [("{camera}", "camera.image_size_px", "1920x1080", "640x480")],
    ),
    "image size that is none": (["{clip}", "--image-size", "big"], [("--image-size", "image_size_px", "'big'")]),
    "frames outside the clip": (
        ["{clip}", "--frames", "100:200"],
        [("{clip}", "frames", "100:200", "0 to 29")],
    ),
    "an empty range, and keypoints of another animal": (
        ["{in}/wings.csv", "--frames", "10:5"],
        [("{in}/wings.csv", "bodyparts", "wing_neck_base, wing_spine"), ("--frames", "frames", "'10:5'", "A < B")],
    ),
    "frames outside the clip, and keypoints of another animal": (
        ["{in}/wings.csv", "--frames", "100:200"],
        [("{in}/wings.csv", "bodyparts", "wing_neck_base, wing_spine"), ("{in}/wings.csv", "frames", "100:200")],
    ),
    "frames that are no range": (["{clip}", "--frames", "9"], [("--frames", "frames", "'9'", "A:B")]),
    "unknown skeleton": (
        ["{clip}", "--skeleton", "zebra"],
        [("--skeleton", "name or file", "'zebra'", "cheetah-24, cheetah-8u")],
    ),
    "unknown chain": (
        ["{clip}", "--skeleton", "zebra", *FRAME],
        [("--skeleton", "name or file", "'zebra'", "one of cheetah-8u")],
    ),
    "whole animal for the frame method": (
        ["{clip}", "--skeleton", "cheetah-24", *FRAME],
        [("--skeleton", "name or file", "'cheetah-24'", ["frame method", "cheetah-8u"])],
    ),
    "unknown subject": (
        ["{clip}", "--subject", "tom"],
        [("--subject", "name or file", "'tom'", "jules, phantom")],
    ),
    "subject of a chain": (
        ["{clip}", "--subject", "jules", "--skeleton", "cheetah-8u"],
        [("--subject", "name or file", "'jules'", "nothing")],
    ),
    "unknown prior": (["{clip}", "--prior", "zebras"], [("--prior", "name or file", "'zebras'")]),
    "prior of another skeleton": (
        ["{clip}", "--prior", "running-cheetah", "--skeleton", "cheetah-8u"],
        [("prior running-cheetah", "angles", "24 angles", "16 angles of cheetah-8u")],
    ),
    "side of a whole animal": (
        ["{clip}", "--set", "side=left"],
        [("--set side", "side", "'left'", ["nothing", "cheetah-24"])],
    ),
    "tilt beside extrinsics": (
        ["{clip}", "--tilt-deg", "5"],
        [("--tilt-deg", "tilt_deg", ["5", "{camera}"], "only one of the two")],
    ),
    "options of the frame method": (
        ["{clip}", "--set", "form=printed", "--set", "base-length-m=0.2"],
        [
            ("--set form", "form", ["'printed'", "trajectory method"], "--set method=frame"),
            ("--set base-length-m", "base_length_m", ["'0.2'", "trajectory method"], "--set method=frame"),
        ],
    ),
    "options of the trajectory method": (
        ["{clip}", *FRAME, "--set", "fast=true", "--set", "ground=none"],
        [
            ("--set fast", "fast", ["'true'", "frame method"], "--set method=trajectory"),
            ("--set ground", "ground", ["'none'", "frame method"], "--set method=trajectory"),
        ],
    ),
    "incomplete skeleton file": (
        ["{clip}", "--skeleton", "{in}/skeleton.toml"],
        [("{in}/skeleton.toml", key, "nothing") for key in OF_A_SKELETON],
    ),
    "unknown form": (
        ["{clip}", "--set", "form=soft", *FRAME],
        [("--set form", "form", "'soft'", "deadband or printed")],
    ),
    "unknown side": (["{clip}", "--set", "side=up"], [("--set side", "side", "'up'", "auto, left or right")]),
    "unknown method": (["{clip}", "--set", "method=x"], [("--set method", "method", "'x'", "trajectory or frame")]),
    "broken config": (["{clip}", "--config", "{in}/config.toml"], [("{in}/config.toml", "content")]),
    "missing config": (["--config", "{in}/no.toml"], [("{in}/no.toml", "file", "no such file")]),
    "camera and keypoints": (
        ["{in}/no.csv", "--camera", "{in}/no.toml", "--skeleton", "zebra"],
        [("{in}/no.csv", "file"), ("--skeleton", "name or file", "'zebra'"), ("{in}/no.toml", "file")],
    ),
    "several settings": (
        ["{clip}", "--fps", "0", "--set", "side=up", "--frames", "5:2"],
        [("--fps", "fps", "'0'"), ("--frames", "frames", "'5:2'"), ("--set side", "side", "'up'")],
    ),
}


@pytest.mark.parametrize("case", BAD_INPUT)
def test_bad_input_ends_with_a_message_and_no_folder(case, inputs, tmp_path):
    def here(value: Any) -> Any:
        if isinstance(value, str):
            return value.replace("{in}", str(inputs)).replace("{clip}", str(CLIP)).replace("{camera}", str(CAMERA))
        return [here(one) for one in value]

    args, expected = map(here, BAD_INPUT[case])
    if "--fps" not in args:
        args += ["--fps", "30"]
    if "--camera" not in args:
        args += ["--camera", str(CAMERA)]
    problems = refused(["fit", *args, "--out", tmp_path / "a" / "b"], *expected)
    assert all(problem.found and problem.expected for problem in problems)
    head, *rows = problems[0].details or ("",)
    if case == "none of the skeleton's keypoints":  # the message includes a map to complete
        assert head == "file,skeleton"
        assert [row.split(",")[0] for row in rows] == [f"wing_{name}" for name in read_keypoints(CLIP).names]
        assert "wing_neck_base,neck_base" in rows
    assert list(tmp_path.iterdir()) == []


def test_all_missing_required_options_are_named():
    refused(["fit"], ("KEYPOINTS", "keypoints", "nothing"), ("--camera", "camera", "nothing"), NO_OUT)
    no_rate = ("--fps", "fps", ["nothing", "whole_cam1.csv"])
    two = [SAMPLES / "whole_cam1.csv", SAMPLES / "whole_cam2.csv"]
    refused(["fit", *two], no_rate, ("--camera", "camera", "nothing"), NO_OUT)
    zebra = ("--skeleton", "name or file", "'zebra'")
    refused(["fit", two[0], "--skeleton", "zebra"], no_rate, zebra, ("--camera", "camera", "nothing"), NO_OUT)


def test_each_keypoint_file_needs_a_camera_name(tmp_path):
    for number, name in enumerate(("left.csv", "right.csv"), start=1):
        (tmp_path / name).write_bytes((SAMPLES / f"whole_cam{number}.csv").read_bytes())
    two, scene = (tmp_path / "left.csv", tmp_path / "right.csv"), SAMPLES / "whole_scene.json"
    args = ("fit", *two, "--camera", scene, "--fps", 60, "--out", tmp_path / "out")
    none = (
        scene,
        "camera",
        "none of them chosen for left.csv, right.csv",
        "--camera-name once for each, in their order",
    )
    refused(args, none)
    for given in ("cam1", "cam1,cam2"):  # reported alone, and not as a camera that was not chosen
        count = ("--camera-name", "camera_name", f"1: {given}", ["2 values", "each after the option's name"])
        refused([*args, "--camera-name", given], count)


@pytest.mark.usefixtures("no_playback", "frames_solved_once")
def test_frame_rate_is_read_from_the_file_or_required(tmp_path):
    args = ["fit", CLIP, "--camera", tmp_path / "none.toml", "--out", tmp_path / "a"]
    refused(args, ("--fps", "fps", ["nothing", "noisy.csv"]), (tmp_path / "none.toml", "file", "no such file"))
    two = [SAMPLES / "whole_cam1.csv", SAMPLES / "whole_cam2.csv"]
    once = ("--fps", "fps", ["nothing", "whole_cam1.csv, whole_cam2.csv"])
    refused(["fit", *two, "--camera", CAMERA, "--out", tmp_path / "a"], once, (CAMERA, "camera", [1, 2]))
    stated = tmp_path / "stated.nc"
    assert run("convert", CLIP, stated, "--fps", 30).code == 0
    args = ("--camera", CAMERA, "--set", "method=frame", "--frames", ":3", "-q")
    assert run("fit", stated, *args, "--out", tmp_path / "b") == Ended(0, "", "")
    assert report_of(tmp_path / "b")["input"]["fps"] == 30.0
    assert run("fit", stated, *args, "--fps", 60, "--out", tmp_path / "c") == Ended(0, "", "")
    assert report_of(tmp_path / "c")["input"]["fps"] == 60.0


def test_a_missing_out_is_refused():
    refused(["fit", CLIP, "--camera", CAMERA, "--fps", 30], NO_OUT)


def test_a_missing_camera_is_refused(tmp_path):
    nothing = ("--camera", "camera", "nothing", "--hfov-deg")
    out = tmp_path / "a"
    refused(fit_args(out, camera=None), nothing)
    # Problems with the file come first.
    first, _ = refused(fit_args(out, camera=None, keypoints=CAMERA), (CAMERA, "format", "calibration"), nothing)
    assert first.file == CAMERA
    no_size = ("--image-size", "image_size_px", "nothing", "--hfov-deg")
    refused(fit_args(out, "--hfov-deg", 60, camera=None), no_size)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("below", [False, True])
def test_a_file_as_out_is_refused(tmp_path, below):
    file = tmp_path / "file"
    file.write_text("mine")
    refused(fit_args(file / "clip" if below else file), ("--out", "folder", f"file {file}", "folder"))
    assert file.read_text() == "mine"


def test_results_are_not_replaced_without_overwrite(tmp_path):
    (tmp_path / "angles.csv").write_text("mine")
    # This problem is reported before any other file is read.
    there = (tmp_path / "angles.csv", "file", "did not write, or that was changed since", "another --out")
    for more in ((), ("--overwrite",)):
        refused(fit_args(tmp_path, *more, keypoints=tmp_path / "no.csv"), there)
        assert files(tmp_path) == {"angles.csv": b"mine"}
    write_old(tmp_path / "earlier")
    named = f"pose3d.csv and 11 more in {tmp_path / 'earlier'}"
    refused(fit_args(tmp_path / "earlier", keypoints=tmp_path / "no.csv"), ("--out", "folder", named, "--overwrite"))


@pytest.mark.parametrize(
    "args",
    [["fit", "--fps", "fast"], ["fit", "--frames"], ["fit", "--fpps", "3"], ["fits"], ["evaluate", "one.csv"]],
)
def test_options_that_cannot_be_parsed_are_refused(args):
    ended = run(*args)
    assert ended.code == 2
    assert ended.out == ""
    assert "Traceback" not in ended.err


@pytest.mark.parametrize(
    ("args", "expected"),
    [
        (fit_args(Path("a/b"), fps=0), ("--fps", "fps", "'0'")),
        (["evaluate", "no.csv", TRUTH], ("no.csv", "file", "no such file")),
        (["view", "no"], ("no/motion.rrd", "file", "no such file")),
    ],
)
def test_bad_input_creates_no_folder(args, expected, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused(args, expected)
    assert list(tmp_path.iterdir()) == []


def test_bad_input_ends_a_process_with_one_line(tmp_path, monkeypatch):
    """Bad input ends a process with one line, which states the problem."""
    monkeypatch.chdir(tmp_path)
    ended = run_process("evaluate", "no.csv", TRUTH)
    assert ended == Ended(2, "", "error: no.csv: no such file\n")
    assert list(tmp_path.iterdir()) == []


# Clips that cannot be solved


@pytest.mark.usefixtures("no_playback")
def test_exit_code_1_when_no_pose_can_be_found(tmp_path):
    few = ("spine", "neck_base", "tail_base", "r_front_knee")
    clip = rewrite(tmp_path / "few.csv", keep_only(*few))
    out = tmp_path / "out"
    ended = run(*whole_args(out, keypoints=clip))
    assert ended.code == 1
    assert says(ended.err, "error: no frame", out / "report.json")
    assert sorted(path.name for path in out.iterdir()) == sorted([*OUTPUT_FILES, RECORD])
    assert "0 of 30 with a pose" in ended.out
    assert "4 of the skeleton's 24 used; missing: nose, " in ended.out
    used = sum(row["used"] or 0 for row in report_of(out)["keypoints"])
    (detections,) = (line.strip() for line in ended.out.splitlines() if line.startswith("detections"))
    assert detections.endswith(f" {used} used, {30 * 24 - used} missing")
    assert report_of(out)["summary"]["keypoints"] == {"used": 4, "missing": 20, "unused": 0}
    assert [one["code"] for one in report_of(out)["findings"]] == ["no_pose"]


def test_exit_code_1_when_no_frame_can_be_solved(tmp_path):
    few = ("spine", "neck_base", "tail_base", "r_front_knee")
    assert len(few) < MIN_JOINTS
    clip = rewrite(tmp_path / "few.csv", keep_only(*few))
    out = tmp_path / "out"
    ended = run(*fit_args(out, keypoints=clip))
    assert ended.code == 1
    assert says(ended.err, "error: no frame", out / "report.json")
    assert sorted(path.name for path in out.iterdir()) == sorted([*OUTPUT_FILES, RECORD])
    report = report_of(out)
    assert report["summary"]["frames_no_data"] == 30
    assert "0 of 30 converged" in ended.out
    quiet = run(*fit_args(out, "--overwrite", "-q", keypoints=clip))
    assert quiet == Ended(1, "", ended.err)


# Overwriting and interrupted runs


def write_old(out: Path) -> None:
    """Write files into a folder as an earlier fit would have."""
    with Output(out, "fit", has_manifest=True).staged() as folder:
        for name in OUTPUT_FILES:
            if name != "manifest.json":
                (folder / name).write_text("old")


@pytest.mark.usefixtures("no_playback")
def test_a_config_repeats_the_run_bit_for_bit_and_overwrite_keeps_other_files(tmp_path_factory, tmp_path, monkeypatch):
    out = tmp_path_factory.mktemp("first") / "out"
    assert run(*fit_args(out, "--frames", ":8")).code == 0
    monkeypatch.chdir(tmp_path)
    write_old(tmp_path)
    (tmp_path / "notes.txt").write_text("mine")
    stale = tmp_path / ".recon-partial-abc" / "new"
    stale.mkdir(parents=True)
    (stale / "pose3d.csv").write_text("half")
    assert run("fit", "--config", out / "config.toml", "--out", ".", "--overwrite").code == 0
    # No file of the other method's results is left.
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*OUTPUT_FILES, RECORD, "notes.txt"])
    assert (tmp_path / "notes.txt").read_text() == "mine"
    for name in ("pose3d.csv", "angles.csv", "reprojection.csv"):
        assert (tmp_path / name).read_bytes() == (out / name).read_bytes(), name
    assert_same_reports(out, tmp_path)


KILLED_APPROACHING = """
import os, signal
import recon.api.clip as clip
solve = clip.solve_trajectory
clip.solve_trajectory = lambda *args: solve(*args[:-1], lambda stage, share: os.kill(os.getpid(), signal.SIGKILL))
"""
KILLED_WRITING = """
import os, signal
import recon.show.view
def half(motion, path):
    path.write_bytes(b"half")
    os.kill(os.getpid(), signal.SIGKILL)
recon.show.view.write = half
"""


@pytest.mark.slow
@needs_sigkill
def test_a_killed_run_leaves_no_output_and_can_be_repeated(tmp_path):
    out = tmp_path / "out"
    args = whole_args(out, "--frames", ":6")
    assert run_process(*args, before=KILLED_APPROACHING).code == -signal.SIGKILL
    assert [path.name for path in out.iterdir()] == [".recon-writing"]
    assert run(*args).code == 0
    assert sorted(path.name for path in out.iterdir()) == sorted([*OUTPUT_FILES, RECORD])


@pytest.mark.slow
@needs_sigkill
def test_a_killed_overwrite_leaves_the_earlier_results(tmp_path):
    write_old(tmp_path)
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    args = whole_args(tmp_path, "--frames", ":6", "--overwrite")
    assert run_process(*args, before=KILLED_WRITING).code == -signal.SIGKILL
    assert {name: (tmp_path / name).read_bytes() for name in before} == before
    *_, partial, writing = sorted({path.name for path in tmp_path.iterdir()} - {*before}, key=len, reverse=True)
    assert (partial[:15], writing) == (".recon-partial-", ".recon-writing")


@pytest.mark.usefixtures("frames_solved_once")
@pytest.mark.parametrize("full", ["motion.rrd", "quality.csv"])
def test_a_failing_writer_leaves_no_output(full, tmp_path, monkeypatch):
    def write(motion, path):
        path.write_bytes(b"half")
        raise OSError(28, "No space left on device", str(path))

    if full == "motion.rrd":
        monkeypatch.setattr(recon.show.view, "write", write)
    else:
        monkeypatch.setitem(recon.show.tables.CLIP_OUTPUTS, full, write)
    ended = run(*fit_args(tmp_path / "a" / "b", "--frames", ":3"))
    assert ended.code == 2
    assert ended.out == ""
    assert ended.err.startswith("error: ")
    assert ended.err.endswith(f"{full}: No space left on device\n")
    assert list(tmp_path.iterdir()) == []


# The other commands


def test_evaluate_prints_the_numbers_of_the_function(fitted):
    pose = fitted[0] / "pose3d.csv"
    result = evaluate_files(pose, TRUTH)
    ended = run("evaluate", pose, TRUTH)
    assert ended.code == 0
    lines = [line.rstrip() for line in ended.out.splitlines()]
    assert lines[0] == f"{pose} against the reference {TRUTH}"
    assert max(map(len, lines[1:16])) <= 80
    rows = {cells[0]: cells[1:] for cells in (re.split(r" {2,}", line.strip()) for line in lines)}
    scores = (result.mpjpe_m, result.mpe_m, result.scale_mpjpe_m, result.pa_mpjpe_m)
    shares = [score for _, score in result.pck]
    assert rows["all"] == [*(f"{1000 * s.mean:.1f}" for s in scores), *(percent(s.mean) for s in shares)]
    for j, name in enumerate(result.names):
        expected = [*(f"{1000 * s.per_joint[j]:.1f}" for s in scores), *(percent(s.per_joint[j]) for s in shares)]
        assert rows[name] == expected
    assert "Compared: 30 frames, 9 joints." in lines
    assert any(says(line, "reference: l_front_knee, ") for line in lines)
    assert "note:" not in ended.out
    verdict, expected, *of_folder = run("evaluate", fitted[0], TRUTH).out.splitlines()
    assert (verdict, expected.removeprefix("expected: ")) == verdict_lines(Motion.load(fitted[0]).verdict)
    assert [line for line in of_folder if not line.startswith("Uncertainty of the ")] == [
        line.replace(str(pose), str(fitted[0])) for line in ended.out.splitlines()
    ]
    assert len(of_folder) == len(ended.out.splitlines()) + 2
    assert says(run("evaluate", TRUTH, fitted[0]).out, "note:", f"reference ({fitted[0]}) is a result")


def test_evaluate_as_json(fitted):
    pose = fitted[0] / "pose3d.csv"
    ended = run("evaluate", pose, TRUTH, "--json")
    assert (ended.code, ended.err) == (0, "")
    assert json.loads(ended.out) == to_plain(evaluate_files(pose, TRUTH).to_dict())


def test_evaluate_names_joints_and_frames_that_cannot_be_compared(tmp_path):
    header = "bodyparts,a,a,a,[b],[b],[b],c,c,c\ncoords,x,y,z,x,y,z,x,y,z\n"
    (tmp_path / "pose.csv").write_text(header + "0,0,0,0,1,2,1,,,\n1,,,,,,,,,\n2,0,0,0,1,2,1,,,\n")
    (tmp_path / "truth.csv").write_text(header + "0,0,0,0,1,2,1,2,3,2\n1,0,0,0,1,2,1,2,3,2\n4,0,0,0,1,2,1,2,3,2\n")
    ended = run("evaluate", tmp_path / "pose.csv", tmp_path / "truth.csv")
    assert ended.code == 0
    rows = {cells[0]: cells[1:] for cells in (re.split(r" {2,}", line.strip()) for line in ended.out.splitlines())}
    assert rows["[b]"] == ["0.0", "0.0", "0.0", "-", "100 %", "100 %", "100 %"]
    assert rows["c"] == ["-"] * 7
    assert "Compared: 1 frames, 3 joints." in ended.out
    assert says(
        ended.out, "only in the reconstruction: 2\n", "only in the reference: 4\n", "without a common joint: 1\n"
    )


@pytest.mark.slow
def test_demo_writes_results_and_prints_the_error(tmp_path):
    ended = run("demo", "--out", tmp_path / "demo")
    assert (ended.code, ended.err) == (0, "")
    names = sorted(path.name for path in (tmp_path / "demo").iterdir())
    assert names == sorted([*OUTPUT_FILES, RECORD, "report.html"])
    assert says(" ".join(ended.out.split()), f"Open {tmp_path / 'demo' / 'report.html'}")
    assert "Gait: transverse gallop" in ended.out
    error_mm = 1000 * evaluate_files(tmp_path / "demo" / "pose3d.csv", SAMPLES / "whole_truth.csv").mpjpe_m.mean
    assert error_mm < 60
    assert says(ended.out, f"pose error is {error_mm:.0f} mm (MPJPE)", "camera file is exact")
    assert "focal_length" not in ended.out
    refused(["demo", "--out", tmp_path / "demo"], ("--out", "folder", ["pose3d.csv", tmp_path / "demo"], "--overwrite"))


def test_view_refuses_a_folder_without_a_recording(tmp_path):
    refused(["view", tmp_path], (tmp_path / "motion.rrd", "file", "no such file", "recon fit"))


def test_view_opens_the_recording(fitted, monkeypatch):
    opened = []
    monkeypatch.setattr("recon.show.view.open_viewer", opened.append)
    assert run("view", fitted[0]).code == 0
    assert opened == [fitted[0] / "motion.rrd"]


def test_view_makes_a_playback_that_the_fit_left_out(tmp_path, fitted, monkeypatch):
    """`recon view` makes a playback that `playback=false` left out, even if results with a playback were replaced."""
    out, opened = tmp_path / "clip", []
    monkeypatch.setattr("recon.show.view.open_viewer", lambda path: opened.append((path.name, path.read_bytes()[:4])))
    settings, motion = read_config(fitted[0] / CONFIG, {}), Motion.load(fitted[0])
    for playback in (True, False):
        write_clip(motion, replace(settings, playback=playback), out)
    names = {*output_files(replace(settings, playback=False), out)}
    assert {path.name for path in out.iterdir()} == {*names, RECORD}
    assert {*OUTPUT_FILES} - names == {"motion.rrd"}
    assert not read_config(out / CONFIG, {}).playback
    assert run("view", out).code == 0
    assert opened == [("motion.rrd", b"RRF2")]
    assert not (out / "motion.rrd").exists()


def test_only_short_clips_have_a_playback_by_default(tmp_path, fitted, monkeypatch):
    """By default, a short clip gets a playback, and a longer clip loses the playback of an earlier fit."""
    out, opened = tmp_path / "clip", []
    monkeypatch.setattr("recon.show.view.open_viewer", lambda path: opened.append((path.parent, path.name)))
    settings, motion = replace(read_config(fitted[0] / CONFIG, {}), playback="auto"), Motion.load(fitted[0])
    n = len(motion.frames)
    for longest, setting, is_written in ((n, "auto", True), (n - 1, "auto", False), (n - 1, True, True)):
        monkeypatch.setattr("recon.api.clip_results.MAX_PLAYED_FRAMES", longest)
        report = write_clip(motion, replace(settings, playback=setting), out, solve_s=1.0)
        assert (out / "motion.rrd").exists() == is_written
        lines = [str(line) for line in answer_of_fit(report, out).lines]
        assert [line for line in lines if "playback.rrd" in line] == ([] if is_written else lines[2:3])

    write_clip(motion, replace(settings, playback="auto"), out)
    assert read_config(out / CONFIG, {}).playback == "auto"
    assert json.loads(run("view", out, "--json").out) == {"recording": None}
    assert run("view", out, "--out", out / "playback.rrd").code == 0  # the command that the fit's output suggests
    assert json.loads(run("view", out, "--json").out) == {"recording": str(out / "playback.rrd")}
    write_clip(motion, settings, out, solve_s=2.0)  # other results: the playback is stale
    assert json.loads(run("view", out, "--json").out) == {"recording": None}
    assert [name for parent, name in opened if parent == out] == ["playback.rrd"]
    assert [name for parent, name in opened if parent != out] == ["motion.rrd", "motion.rrd"]


def test_view_opens_the_recording_with_the_video_that_a_run_wrote(tmp_path, fitted, monkeypatch):
    out, opened = tmp_path / "clip", []
    shutil.copytree(fitted[0], out)
    monkeypatch.setattr("recon.show.view.open_viewer", opened.append)
    assert run("view", out, "--out", out / "playback.rrd").code == 0
    assert run("view", out).code == 0
    (out / ".recon.json").unlink()  # the playback's results are unknown without the record
    assert run("view", out).code == 0
    assert opened == [out / "playback.rrd", out / "motion.rrd"]
    refused(["view", out, "--web", "--out", tmp_path / "a.rrd"], ("--web", "viewer", "--out"))


@pytest.mark.slow
def test_view_shows_the_plots_of_the_analysis(fitted, tmp_path, monkeypatch):
    """`recon view` shows the plots of an analysis, and changes nothing in the folder of results."""
    out, seen = tmp_path / "clip", []
    shutil.copytree(fitted[0], out)
    (out / "analysis").mkdir()
    (out / "analysis" / "analysis.json").write_text("{}")

    def look(path):
        seen.append({"/analysis/speed", "/speed"} & {chunk.entity_path for chunk in RrdReader(path).stream()})

    monkeypatch.setattr("recon.show.view.open_viewer", look)
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert run("view", out) == Ended(0, "", "")
    said = f"The recording is in {tmp_path / 'all.rrd'}. Watch it with: rerun {tmp_path / 'all.rrd'}\n"
    assert run("view", out, "--out", tmp_path / "all.rrd") == Ended(0, said, "")
    there = ("--out", "file", tmp_path / "all.rrd", "--overwrite")
    refused(["view", out, "--out", tmp_path / "all.rrd"], there)
    assert run("view", out, "--out", tmp_path / "all.rrd", "--overwrite") == Ended(0, said, "")
    look(tmp_path / "all.rrd")
    assert seen == [{"/analysis/speed", "/speed"}] * 2
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_only_the_terminal_breaks_the_lines_of_a_help_text():
    def made_up():
        """Do one thing.

        A paragraph of
        two lines.
        """

    assert help_of(made_up) == "Do one thing.\n\nA paragraph of two lines."


@pytest.mark.parametrize("command", ["fit", "evaluate", "view", "demo"])
def test_help_has_an_example_and_units(command):
    ended = run(command, "--help")
    assert ended.code == 0
    assert f"Example: recon {command} " in ended.out
    if command == "fit":
        text = " ".join(ended.out.replace("│", " ").split())
        for phrase in ("Hz", "in degrees", "in pixels", "(default: m)", "recon settings"):
            assert phrase in text


def test_brackets_in_names_are_not_read_as_markup():
    """Square brackets in names are not read as markup by any console of the commands."""
    stream = io.StringIO()
    terminal(file=stream).print("x[/b] [red]y :smile:")
    assert stream.getvalue() == "x[/b] [red]y :smile:\n"
    others = [
        path.name for path in Path(recon.cli.app.__file__).parent.glob("*.py") if " Console(" in path.read_text("utf-8")
    ]
    assert others == []


def test_control_characters_in_names_are_shown_as_codes(capsys):
    console = terminal()
    say(console, "file \x1b[31mred\n.csv")
    console.print(table_of("a\x1b]0;x", title="one\ntwo"))
    console.print(error_text("a\nb"))
    said = capsys.readouterr().out
    assert "\x1b" not in said
    assert said.startswith(r"file \x1b[31mred\n.csv" + "\n")
    assert "one" in said.splitlines()[1]
    assert r"error: a\nb" in said
