"""Test the comparison of clips: means with their uncertainty, groups, and refused inputs."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import Refusal, refused, run, says
from matplotlib.collections import LineCollection

from recon.api.compare import QUANTITIES, _by_period, _figure, _group_rows, _mean_of
from recon.base.files import write_manifest
from recon.base.numbers import interval
from recon.cli.compare import _lines
from recon.fit.motion import Motion
from recon.gait.clip import ClipAnalysis
from recon.gait.stances import interval_of

pytestmark = pytest.mark.usefixtures("remembered_analyses")


@pytest.fixture(scope="module")
def whole_motion(whole_results: Path) -> Motion:
    return Motion.load(whole_results)


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory, whole_motion: Motion) -> Path:
    folder = tmp_path_factory.mktemp("batch")
    for name in ("a", "b", "c"):
        whole_motion.save(folder / name)
    (folder / "animals.csv").write_text("clip,sex\na,f\nb,m\nc,f\n")
    return folder


def test_each_group_and_each_stride_has_a_row(clips: Path, tmp_path: Path, whole_analysis: ClipAnalysis):
    out = tmp_path / "out"
    # The arguments that a shell passes for all/*.
    ended = run("compare", *clips.iterdir(), "--table", clips / "animals.csv", "--by", "sex", "--out", out)
    assert (ended.code, ended.err) == (0, "")
    assert says(
        ended.out, "90 % interval", "include the error of the animal's size", "Spread: one standard deviation between"
    )
    groups, by_clip, strides = (pd.read_csv(out / f"{name}.csv") for name in ("groups", "clips", "strides"))
    assert (out / "clips.parquet").is_file()
    pd.testing.assert_frame_equal(pd.read_parquet(out / "strides.parquet"), strides)
    assert list(groups["group"]) == ["f", "m"]
    assert list(groups["clips"]) == [2, 1]
    assert groups["strides"].sum() == len(strides) == by_clip["strides"].sum() > 6
    assert (out / "comparison.png").stat().st_size > 5000
    page = (out / "compare.html").read_text(encoding="utf-8")
    assert re.findall(r'<tr data-state="(.)" data-clip="(.)"', page) == [("f", "a"), ("f", "c"), ("m", "b")]
    assert page.count('<g class="dot') == 3 * len(QUANTITIES)
    assert page.count("n = 2</text>") == page.count("n = 1</text>") == len(QUANTITIES)
    assert f"{by_clip['speed_m_s'].iloc[0]:.1f} <span" in page
    # All parts show the interval of the clip's own analysis. Group m has one clip.
    for name in QUANTITIES:
        quantity = whole_analysis.quantities[name]
        number, _, ends = interval(quantity.value, *quantity.interval).partition(" (")
        assert page.count(f'{number} <span class="soft">({ends}</span>') == 4
        assert f" {ends.removesuffix(')')} " in ended.out
    for name in QUANTITIES:
        # The three clips are copies: means are equal, the spread is 0, and errors that clips share do not average out.
        np.testing.assert_allclose(groups[name], by_clip[name].iloc[0], rtol=1e-5)
        assert groups[f"{name}_spread"].fillna(-groups["clips"]).tolist() == [0, -1]  # unknown for a single clip
        f, m = groups[f"{name}_sigma"]
        if QUANTITIES[name][1]:
            shared = by_clip["size_sigma"].iloc[0] * by_clip[name].iloc[0]
            assert f**2 - shared**2 == pytest.approx((m**2 - shared**2) / 2, rel=1e-4)
        else:
            assert f == pytest.approx(m / 2**0.5, rel=1e-4)


def test_results_of_the_same_run_are_noted(tmp_path: Path, whole_motion: Motion):
    (source,) = whole_motion.sources
    later = replace(source, keypoints=replace(source.keypoints, frames=source.keypoints.frames + 1000))
    other = {**whole_motion.settings, "keypoints": "other.csv"}  # filmed by the same camera
    second = replace(source, camera=replace(source.camera, name="second"))
    motions = {
        "a": whole_motion,
        "b": replace(whole_motion, sources=(second,), settings=other),
        "later": replace(whole_motion, sources=(later,)),
        "other": replace(whole_motion, settings=other),
    }
    folders = [motion.save(tmp_path / name).parent for name, motion in motions.items()]
    ended = run("compare", *folders, "--out", tmp_path / "out")
    assert says(ended.out, "probably show the same run", ": a and b, b and other. Give one")


def test_results_of_the_same_keypoints_and_cameras_count_once(tmp_path: Path, whole_motion: Motion):
    """Results from the same keypoint and camera files, by content, count once unless they have other frames."""
    (source,) = whole_motion.sources
    later = replace(source, keypoints=replace(source.keypoints, frames=source.keypoints.frames + 1000))
    motions = dict.fromkeys("abc", whole_motion) | {"=later": replace(whole_motion, sources=(later,))}
    folders = [motion.save(tmp_path / name).parent for name, motion in motions.items()]
    for folder, keypoints in zip(folders, "1121", strict=True):
        (folder / "config.toml").write_text(f'[recon.sha256]\nkeypoints = "{keypoints}"\ncamera = "3"\n')
        write_manifest(folder)
    ended = run("compare", *folders, "--out", tmp_path / "out", "--json")
    assert ended.code == 0, ended
    data = json.loads(ended.out)
    assert data["left_out"] == ["b"]
    assert [row["clips"] for row in data["groups"]] == [3]
    assert says(data["notes"][0], "same keypoints and cameras", "b (of a)")
    table = pd.read_csv(tmp_path / "out" / "clips.csv")
    assert [*table["clip"]] == ["a", "c", "'=later"]  # the quote keeps a spreadsheet from running it as a formula


def test_quantities_that_no_clip_has_are_not_drawn():
    row = {"clip": "a", "group": "all", "verdict": "use", "strides": 0, "size_sigma": 0.1}
    clips = pd.DataFrame([row | {name: np.nan for q in QUANTITIES for name in (q, f"{q}_sigma", f"{q}_own_sigma")}])
    assert [axes.get_title() for axes in _figure(clips, _group_rows(clips)).axes] == [""]
    clips[["speed_m_s", "speed_m_s_sigma", "speed_m_s_own_sigma"]] = 5.0, 0.5, 0.5
    groups = _group_rows(clips)
    (axes,) = _figure(clips, groups).axes
    assert axes.get_title() == "speed (m/s)"
    (bar,) = axes.findobj(LineCollection)
    np.testing.assert_allclose(bar.get_segments()[0][:, 1], interval_of(5.0, 0.5)[1:])  # type: ignore[attr-defined]
    said = [line for line in _lines(clips, groups, Path("out")) if isinstance(line, str)]
    assert said[-3] == "No clip has a complete stride: no stride length (m), stride frequency (Hz), duty factor."


def test_clips_without_a_complete_stride_are_named():
    clips = pd.DataFrame({"clip": ["a", "b", "c"]})
    clips["stride_frequency_hz_source"] = ["footfalls", "period of the motion", ""]
    (note,) = _by_period(clips)
    assert "in b: stride length" in note
    assert [*_by_period(clips[clips["clip"] != "b"])] == []


def test_sigma_of_the_mean_includes_the_spread_of_clips():
    rng = np.random.default_rng(0)
    inside, spreads = [], []
    for _ in range(300):
        sigma = rng.uniform(0.1, 0.4, 8)
        values = 5 + rng.normal(0, 0.5, 8) + rng.normal(0, sigma)
        mean, its_sigma, spread = _mean_of(values, sigma, 0.0)
        inside.append(abs(mean - 5) < 1.64 * its_sigma)
        spreads.append(spread)
    assert 0.8 < np.mean(inside) < 0.97
    assert np.median(spreads) == pytest.approx(0.5, rel=0.15)


def test_unusable_comparisons_are_refused(clips: Path, tmp_path: Path, whole_motion: Motion):
    out = tmp_path / "out"
    lacking = tmp_path / "lacking.csv"
    lacking.write_text("clip,sex\na,f\n")

    def refuses(args: list[object], *expected: Refusal) -> None:
        refused(["compare", *args, "--out", out], *expected)

    refuses([clips, "--table", lacking, "--by", "sex"], *((lacking, "clip", f"for {name}") for name in "bc"))
    refuses([clips, "--table", lacking, "--by", "age"], (lacking, "column", ["'age'", "clip, sex"]))
    absent = tmp_path / "absent.csv"
    refuses([clips, "--table", absent, "--by", "sex"], (absent, "file", "no such file", "a CSV table"))
    refuses([clips, "--by", "age"], ("--by", "table", "--table"))
    for folder in (tmp_path, clips / "animals.csv"):
        refuses([folder], (folder, "folder", "no results"))
    assert whole_motion.verdict is not None
    wreck = replace(whole_motion, verdict=replace(whole_motion.verdict, level="do not use"))
    wreck.save(tmp_path / "wreck")
    refuses([tmp_path / "wreck"], (tmp_path / "wreck", "verdict", "do not use", "--anyway"))
    assert not out.exists()
    ended = run("compare", tmp_path / "wreck", clips / "a", "--out", out)
    assert (ended.code, list(pd.read_csv(out / "clips.csv")["clip"])) == (0, ["a"])
    assert says(ended.out, "Left out", "wreck", "--anyway")
    again = "compare", tmp_path / "wreck", clips / "a", "--out", out, "--overwrite", "--json"
    said = json.loads(run(*again).out)
    assert (said["left_out"], [group["clips"] for group in said["groups"]]) == (["wreck"], [1])
    assert says(said["notes"][0], "Left out", "wreck")
    assert json.loads(run(*again, "--anyway").out)["left_out"] == []
    assert list(pd.read_csv(out / "clips.csv")["clip"]) == ["wreck", "a"]
    refuses([clips], ("--out", "folder", ["groups.csv", out], "--overwrite"))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "clips.parquet").write_text("of somebody else")
    foreign = (tmp_path / "mine" / "clips.parquet", "file", "`recon compare` did not write", "moved away")
    refused(["compare", clips, "--out", tmp_path / "mine"], foreign)
