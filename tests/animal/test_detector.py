"""Test detector files, which state the offsets of keypoints from markers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import refusal
from example_run import settings

from recon import Body, Camera, FitSettings, load_skeleton, read_keypoints
from recon.animal.measured import detector_toml
from recon.animal.prior import prior_from_body
from recon.animal.skeleton_file import with_detector_offsets
from recon.api.clip_inputs import prepare
from recon.clip import still_view
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.io import deeplabcut
from recon.io.hdf5_poses import write_deeplabcut, write_movement, write_nwb
from recon.show.report import build_report


def body(subject: str | None = "phantom") -> Body:
    return load_skeleton("cheetah-24", subject)


OF_ACINOSET = "DLC_resnet152_CheetahOct14shuffle4_650000"


def with_scorers(run: Path, out: Path, *scorers: str | None, suffix: str = ".csv") -> FitSettings:
    """Return the settings for a run, after writing its keypoints to files with the given scorers.

    None stands for a file format without a scorer.
    """
    files = []
    for number, scorer in enumerate(scorers, start=1):
        csv, path = run / f"run_cam{number}.csv", out / f"run_cam{number}{suffix}"
        if scorer is None:
            path = path.with_suffix(".nc")
            write_movement(read_keypoints(csv), path)
        else:
            table = pd.read_csv(csv, header=[0, 1, 2], index_col=0)
            named = [(scorer, *rest) for _, *rest in table.columns]
            table.columns = pd.MultiIndex.from_tuples(named, names=table.columns.names)
            table.to_csv(path) if suffix == ".csv" else table.to_hdf(path, key="df_with_missing", mode="w")
        files.append(path)
    return replace(settings(run, *range(1, len(files) + 1)), keypoints=tuple(files))


@pytest.mark.parametrize("suffix", [".csv", ".h5"])
def test_the_scorer_of_a_file_identifies_the_detector(runs, tmp_path, suffix):
    given = with_scorers(runs, tmp_path, OF_ACINOSET, OF_ACINOSET, suffix=suffix)
    body = prepare(given).body
    assert body.detector == "acinoset"
    assert set(body.keypoint_offset_m) == set(body.markers)
    plain = prepare(replace(given, detector="none")).body
    assert (plain.detector, plain.keypoint_offset_m) == ("none", {})


@pytest.mark.parametrize("scorers", [("DLC",), ("DLC", "another"), (None, "DLC"), ("x" + OF_ACINOSET,)])
def test_an_unknown_scorer_selects_no_detector(runs, tmp_path, scorers):
    given = with_scorers(runs, tmp_path, *scorers)
    body = prepare(given).body
    assert (body.detector, body.keypoint_offset_m) == ("none", {})
    assert prepare(replace(given, detector="acinoset")).body.detector == "acinoset"


@pytest.mark.parametrize("other", ["DLC", None])
def test_cameras_of_two_detectors_are_not_mixed(runs, tmp_path, other):
    given = with_scorers(runs, tmp_path, OF_ACINOSET, other)
    found = [f"run_cam1.csv of acinoset (scorer '{OF_ACINOSET}')", "of none"]
    with refusal(("KEYPOINTS", "detector", found, "--set detector=none")):
        prepare(given)
    assert prepare(replace(given, detector="none")).body.detector == "none"


@pytest.mark.parametrize(
    ("scorer", "stated", "line"),
    [
        (OF_ACINOSET, None, f"acinoset: by the file's scorer '{OF_ACINOSET}'"),
        (OF_ACINOSET, "none", "none: as given"),
        ("DLC", "acinoset", "acinoset: as given"),
        (
            "DLC",
            None,
            "none: the scorer 'DLC' belongs to no known detector; "
            "two runs with four cameras measure its keypoint bias: recon subject fit --no-lengths --offsets",
        ),
        (None, None, "none: the keypoint file names no scorer"),
    ],
)
def test_the_summary_states_the_detector_and_the_reason(small_trajectory, scorer, stated, line):
    sources = [replace(s, keypoints=replace(s.keypoints, scorer=scorer)) for s in small_trajectory.sources]
    seen = with_detector_offsets(small_trajectory.body, stated, {"clip.csv": scorer})
    motion = replace(
        small_trajectory,
        sources=tuple(sources),
        solution=replace(small_trajectory.solution, body=seen),
        settings={} if stated is None else {"detector": stated},
    )
    report = build_report(motion)
    assert dict(map(tuple, report["lines"]))["detector"] == line
    assert f"{report['detector']['name']}: {report['detector']['reason']}" == line.partition("; ")[0]


def test_the_offsets_of_a_measured_animal_have_precedence():
    measured = replace(body(), keypoint_offset_m={"nose": (0.01, 0.0, 0.0)})
    assert with_detector_offsets(measured, None).keypoint_offset_m == {"nose": (0.01, 0.0, 0.0)}
    assert with_detector_offsets(measured, None).detector == "own"
    assert with_detector_offsets(measured, "acinoset").keypoint_offset_m["nose"] != (0.01, 0.0, 0.0)


def test_a_file_is_read_as_it_was_written(tmp_path):
    """A detector file is read as it was written, and the right side mirrors the left."""
    path, offsets = tmp_path / "mine.toml", {"l_hip": (0.01, 0.02, -0.03), "spine": (0.0, 0.0, 0.04)}
    spread, noise = {"l_hip": 0.02, "spine": 0.03}, {"l_hip": 0.06}
    as_seen = replace(
        body(), keypoint_sigma_m=0.07, keypoint_offset_m=offsets, keypoint_spread_m=spread, keypoint_noise_m=noise
    )
    text = detector_toml(as_seen, "mine", ["a note"])
    path.write_text(text)
    found = with_detector_offsets(body(), path)
    assert text.startswith("# a note\n")
    assert found.keypoint_offset_m == offsets | {"r_hip": (0.01, -0.02, -0.03)}
    assert found.keypoint_sigma_m == 0.07
    assert found.keypoint_spread_m == {"l_hip": 0.02, "r_hip": 0.02, "spine": 0.03}
    assert found.keypoint_noise_m == {"l_hip": 0.06, "r_hip": 0.06, "spine": 0.07}
    shift = (
        found.detected.pose(np.zeros((1, found.n_state))).points_m
        - found.tree.pose(np.zeros((1, found.n_state))).points_m
    )
    np.testing.assert_allclose(shift[0, found.markers.index("spine")], [0.0, 0.0, 0.04], atol=1e-12)


def test_each_marker_has_its_own_noise():
    """Each marker has its own noise, unless one value for all is given."""
    seen = replace(body(), keypoint_sigma_m=0.03, keypoint_noise_m={"l_hip": 0.06})
    view = still_view(Camera.from_hfov(60.0, (1920, 1080)), np.zeros((1, 24, 2)), np.ones((1, 24)))
    points_m = np.tile([0.0, 5.0, 0.0], (1, 24, 1))

    def noise_px(sigma_m: float | None) -> np.ndarray:
        options = TrajectoryOptions(sigma_px=0.0, keypoint_sigma_m=sigma_m)
        setting = ClipProblem.from_views([view], seen, prior_from_body(seen), 90.0, options)
        return setting.noise_px(points_m, np.ones((1, 24)))[0, 0]

    own, alike = noise_px(None), noise_px(0.03)
    np.testing.assert_allclose(own / alike, np.where(np.array(seen.markers) == "l_hip", 2.0, 1.0))
    assert np.ptp(alike) == 0


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ('skeleton = "cheetah-24"', 'skeleton = "dog"', ("skeleton", "'dog'", "cheetah-24")),
        ("[keypoints.spine]", "[keypoints.fin]", ("keypoints.fin", "'fin'", "nose, l_eye")),
        ("spread_m = 0.03", "spread_m = -1", ("keypoints.spine.spread_m", "-1", "greater than")),
        ("sigma_m = 0.06\n", "sigma_m = 0.0\n", ("keypoints.spine.sigma_m", "0.0", "greater than")),
    ],
)
def test_problems_of_a_detector_file_are_listed(tmp_path, old, new, expected):
    path = tmp_path / "mine.toml"
    spine = {"keypoint_spread_m": {"spine": 0.03}, "keypoint_noise_m": {"spine": 0.06}}
    as_seen = replace(body(), keypoint_offset_m={"spine": (0.0, 0.0, 0.04)}, **spine)
    path.write_text(detector_toml(as_seen, "mine").replace(old, new))
    with refusal((path, *expected)):
        with_detector_offsets(body(), path)


def test_an_unknown_detector_name_is_refused():
    with refusal(("--set detector", "name or file", "'zebra'", "acinoset")):
        with_detector_offsets(body(), "zebra")


@pytest.mark.parametrize(("name", "write"), [("copy.h5", write_deeplabcut), ("copy.nwb", write_nwb)])
def test_other_file_formats_keep_the_scorer(runs, tmp_path, name, write):
    (path,) = with_scorers(runs, tmp_path, OF_ACINOSET).keypoints
    write(replace(read_keypoints(path), fps=90.0), tmp_path / name)
    again = read_keypoints(tmp_path / name)
    assert (again.scorer, again.fps) == (OF_ACINOSET, 90.0)


@pytest.mark.parametrize(("fps", "written"), [(None, OF_ACINOSET), (90.0, f"{OF_ACINOSET}_recon_90fps")])
def test_a_converted_file_keeps_its_scorer(runs, tmp_path, fps, written):
    (path,) = with_scorers(runs, tmp_path, OF_ACINOSET).keypoints
    keypoints = replace(read_keypoints(path), fps=fps)
    deeplabcut.write_csv(keypoints, tmp_path / "copy.csv")
    assert (tmp_path / "copy.csv").read_text().split(",")[1] == written
    again = read_keypoints(tmp_path / "copy.csv")
    assert (again.scorer, again.fps) == (OF_ACINOSET, fps)
