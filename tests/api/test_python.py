"""Test the Python interface: conversion to and from other packages' tables, and the display in a notebook."""

from __future__ import annotations

import inspect
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import refusal

import recon
from recon.fit.motion import Motion
from recon.io.hdf5_poses import dataset_of

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "samples"


def test_a_motion_converts_to_a_table(world_trajectory: Motion):
    motion = world_trajectory
    long, wide = motion.to_dataframe(), motion.to_dataframe(wide=True)
    assert list(long.columns[:6]) == ["frame", "time_s", "joint", "x_m", "y_m", "z_m"]
    one = long[(long["joint"] == "nose") & (long["frame"] == motion.frames[3])]
    nose = motion.names.index("nose")
    np.testing.assert_array_equal(one[["x_m", "y_m", "z_m"]].to_numpy()[0], motion.upright.xyz_m[3, nose])
    np.testing.assert_array_equal(one["y_sigma_m"], motion.upright_sigma_m[3, nose, 1])
    assert one["flags"].item() == ", ".join(motion.flags[3])
    assert wide.loc[motion.frames[3], ("nose", "z_m")] == one["z_m"].item()
    assert wide.shape == (len(motion.frames), 6 * len(motion.names))


def test_a_motion_converts_to_a_movement_dataset(world_trajectory: Motion):
    pytest.importorskip("xarray")
    motion = world_trajectory
    data = motion.to_xarray()
    assert data["position"].dims == ("time", "space", "keypoint", "individual")
    at = {"keypoint": "nose", "space": "z", "individual": "individual_0"}
    nose = motion.names.index("nose")
    np.testing.assert_array_equal(data["position"].sel(at), motion.upright.xyz_m[:, nose, 2])
    np.testing.assert_array_equal(data["position_sigma"].sel(at), motion.upright_sigma_m[:, nose, 2])
    np.testing.assert_allclose(data["time"], motion.time_s)
    assert (data.attrs["fps"], data.attrs["source_file"]) == (motion.fps, motion.file)


def test_a_notebook_shows_verdict_picture_and_summary(sample_fit: Motion):
    shown = sample_fit._repr_html_()
    assert sample_fit.verdict is not None
    assert f">{sample_fit.verdict.level}:" in shown
    assert shown.count("<polyline") == 8 * len(sample_fit.limbs)
    assert re.search(r"<th[^>]*>clip</th><td[^>]*>whole.csv, frames 0 to 59 at 60 fps<", shown)
    assert "http" not in shown


def test_results_are_shown_in_one_line(sample_fit: Motion, tmp_path: Path):
    motion, analysis = sample_fit, recon.analyse(sample_fit)
    solution, truth = motion.solution, recon.read_pose3d(SAMPLES / "whole_truth.csv")
    evaluation = recon.evaluate(motion.upright, truth)
    clips, _ = recon.find_clips([SAMPLES / "whole.csv"], {"camera": SAMPLES / "camera.toml", "fps": 60})
    results = [motion, motion.verdict, *motion.sources, motion.body, solution, *solution.segments, *solution.views]
    results += [motion.camera, motion.keypoints, motion.cleaning, truth, evaluation, evaluation.mpjpe_m, *clips]
    results += [analysis, analysis.reference_motion, analysis.gait, analysis.dynamics, *analysis.portraits.values()]
    results += [clips[0].settings, *recon.plan_batch(clips, tmp_path)]
    assert {type(one).__name__: len(repr(one)) for one in results if len(repr(one)) > 300 or "\n" in repr(one)} == {}
    assert "joints_m=array (60, 24, 3)" in repr(solution)
    assert repr(motion.verdict).startswith(
        "Verdict(level='use', reason='No check found a fault that spoils the poses. Positions may be off by u..."
    )
    assert repr(clips[0].settings).endswith("fps=60.0)")


def test_speed_has_times_and_an_interval(sample_fit: Motion):
    speed = recon.analyse(sample_fit).speed
    assert speed.index.name == "time_s"
    known = speed.dropna()
    assert len(known) > 100
    assert ((known["low_m_s"] < known["speed_m_s"]) & (known["speed_m_s"] < known["high_m_s"])).all()


@pytest.fixture(scope="module")
def sample_fit(whole_results: Path) -> Motion:
    return Motion.load(whole_results)


def same(a: recon.Keypoints, b: recon.Keypoints) -> None:
    order = [a.names.index(name) for name in b.names]
    np.testing.assert_array_equal(a.xy_px[:, order], b.xy_px)
    np.testing.assert_array_equal(a.confidence[:, order], b.confidence)
    np.testing.assert_array_equal(a.frames, b.frames)
    assert a.fps == b.fps == 60


def test_keypoints_are_read_from_tables_in_memory():
    file = SAMPLES / "whole.csv"
    expected = recon.clean(recon.read_keypoints(file), 0.0)[0]
    expected = recon.Keypoints(expected.names, expected.xy_px, expected.confidence, expected.frames, 60)
    columns = pd.MultiIndex.from_product([["net"], expected.names, ["x", "y", "likelihood"]])
    columns.names = ["scorer", "bodyparts", "coords"]
    values = np.concatenate([expected.xy_px, expected.confidence[..., None]], axis=2)
    same(
        recon.Keypoints.from_dataframe(
            pd.DataFrame(values.reshape(len(values), -1), index=expected.frames, columns=columns), fps=60
        ),
        expected,
    )
    count = len(expected.names)
    long = pd.DataFrame(
        {
            "frame": np.repeat(expected.frames, count),
            "keypoint": [*expected.names] * len(expected.frames),
            "x": expected.xy_px[..., 0].ravel(),
            "y": expected.xy_px[..., 1].ravel(),
            "confidence": expected.confidence.ravel(),
        }
    )
    same(recon.Keypoints.from_dataframe(long, fps=60), expected)
    pytest.importorskip("xarray")
    same(recon.Keypoints.from_xarray(dataset_of(expected)), expected)
    several = pd.concat([long.assign(individual=animal) for animal in ("a", "b")])
    same(recon.Keypoints.from_dataframe(several, fps=60, individual="b"), expected)
    with refusal(("DataFrame", "individual", "2 animals", "a, b")):
        recon.Keypoints.from_dataframe(several, fps=60)


@pytest.mark.parametrize(
    ("table", "field", "found", "expected"),
    [
        ({"x": [1.0]}, "columns", "x", ["frame, bodypart, x, y", "NAME_x"]),
        ({"frame": [0, 0], "keypoint": ["a", "a"], "x": [1, 2], "y": [1, 2]}, "line 3", "second row", "one"),
        ({"frame": [0], "keypoint": ["a"], "x": ["left"], "y": [2]}, "line 2, x", "'left'", "number"),
    ],
)
def test_other_tables_are_refused(table, field, found, expected):
    with refusal(("DataFrame", field, found, expected)):
        recon.Keypoints.from_dataframe(pd.DataFrame(table))


def test_public_names_have_docstrings_and_completion_lists_only_them():
    assert dir(recon) == sorted(recon.__all__)
    assert isinstance(recon.__version__, str)
    for name in {*recon.__all__} - {"__version__"}:
        one = getattr(recon, name)
        assert one.__doc__, name
        for attribute in dir(one) if isinstance(one, type) else ():
            found = inspect.getattr_static(one, attribute)
            function = getattr(found, "fget", None) or getattr(found, "func", None) or found
            if not attribute.startswith("_") and callable(function):
                assert function.__doc__, f"{name}.{attribute}"


def test_messages_go_to_the_logger(caplog, capfd):
    """Functions print nothing, and send messages to the logger "recon"."""
    settings = recon.FitSettings(
        keypoints=SAMPLES / "whole.csv", camera=SAMPLES / "camera.toml", fps=60, frames="0:8", fast=True
    )
    with caplog.at_level("INFO", logger="recon"):
        motion = recon.fit_clip(settings)
    assert motion.verdict is not None
    assert f"whole.csv: {motion.verdict.level}: {motion.verdict.reason}" in caplog.messages
    loud = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
    assert len(loud) == sum(one.severity != "note" for one in motion.findings)
    caplog.clear()
    assert capfd.readouterr() == ("", "")
