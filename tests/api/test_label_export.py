"""Test the export of corrections to label files and to a corrected table by `recon fix`."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import refused, run

from recon import FitSettings, Motion, fit_clip
from recon.api.label_export import CorrectedClip
from recon.io.corrections import Correction, write_corrections
from recon.io.formats import read_keypoints
from recon.io.video import video_writer
from recon.keypoint_net.labels import read_labels

SAMPLE = Path(__file__).resolve().parents[2] / "data" / "samples" / "whole.csv"
ROWS = [
    Correction(18, "", "r_front_knee", (666.06, 333.65), (636.0, 588.0), "moved by hand"),
    Correction(18, "", "tail1", None, (700.0, 500.0), "accepted"),
    Correction(19, "", "nose", None, (700.0, 500.0), "accepted"),
    Correction(20, "", "nose", None, None, "not to be used"),
]


@pytest.fixture(scope="module", autouse=True)
def _fitted_once() -> Iterator[None]:
    """Let all tests export the same fit."""
    fitted: dict[str, Motion] = {}

    def fit_once(settings: FitSettings) -> Motion:
        assert isinstance(settings.corrections, Path)
        text = settings.corrections.read_text(encoding="utf-8")
        if text not in fitted:
            fitted[text] = fit_clip(settings)
        return fitted[text]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("recon.api.label_export.fit_clip", fit_once)
        yield


@pytest.fixture
def corrections(tmp_path: Path) -> Path:
    write_corrections(ROWS, tmp_path / "corrections.csv")
    return tmp_path / "corrections.csv"


@pytest.fixture(scope="module")
def film(tmp_path_factory) -> Path:
    """Write a video of 22 frames, whose grey level is ten times the frame number."""
    path = tmp_path_factory.mktemp("film") / "run.avi"
    with video_writer(path, (1920, 1080), 60.0) as write:
        for number in range(22):
            write(np.full((1080, 1920, 3), 10 * number, np.uint8))
    return path


def test_corrected_frames_become_labels(whole_results: Path, corrections: Path, film: Path, tmp_path: Path):
    pytest.importorskip("tables")
    out = tmp_path / "project"
    command = ("fix", whole_results, "--video", film, "--out", corrections, "--export-labels", out, "--scorer", "me")
    done = run(*command)
    assert (done.code, done.err) == (0, "")
    folder = out / "labeled-data" / "run"
    names = {path.name for path in folder.iterdir() if not path.name.startswith(".")}
    tables = {"CollectedData_me.csv", "CollectedData_me.h5", "coco.json", "origins.csv"}
    assert names == tables | {"img0018.png", "img0020.png"}
    table = pd.read_hdf(folder / "CollectedData_me.h5")
    row = table.loc[("labeled-data", "run", "img0018.png"), "me"]
    assert row["r_front_knee"].tolist() == [636.0, 588.0]
    assert np.isnan(row["tail1"]).all()  # this label was predicted by the model, and only accepted
    assert np.isnan(table.loc[("labeled-data", "run", "img0020.png"), "me"]["nose"]).all()
    detected = read_keypoints(SAMPLE)
    assert row["nose"].tolist() == detected.xy_px[18, detected.names.index("nose")].tolist()
    read = read_labels(out)
    assert read.numbers.tolist() == [18, 20]
    assert [round(float(picture.mean()) / 10) for picture in read.pictures] == [18, 20]
    assert "img0018.png,r_front_knee,636.0,588.0,by hand" in (folder / "origins.csv").read_text()
    again = run(*command)
    assert again.code == 2
    assert "--overwrite" in again.err
    (folder / "img0018.png").write_bytes(b"mine")
    assert run(*command, "--overwrite").code == 2
    assert (folder / "img0018.png").read_bytes() == b"mine"


def test_accepted_points_are_labels_on_request(whole_results: Path, corrections: Path):
    clip = CorrectedClip.read(whole_results, corrections)
    labels = clip.labels("run", "me", with_accepted=True)
    assert labels.frames.tolist() == [18, 19, 20]
    k = labels.names.index("tail1")
    assert labels.xy_px[0, k].tolist() == [700.0, 500.0]
    assert labels.origins[0][k] == "accepted from the model"
    assert clip.labels("run", "me").origins[0][k] == ""


def test_the_corrected_table_has_the_corrections(whole_results: Path, corrections: Path, tmp_path: Path):
    out = tmp_path / "corrected.csv"
    done = run("fix", whole_results, "--out", corrections, "--export-table", out)
    assert (done.code, done.err) == (0, "")
    before, after = read_keypoints(SAMPLE), read_keypoints(out)
    assert after.names == before.names
    changed = np.argwhere(~np.isclose(after.xy_px, before.xy_px, equal_nan=True).all(axis=2))
    cells = {(row.frame, row.keypoint) for row in ROWS}
    assert {(int(after.frames[t]), after.names[k]) for t, k in changed} == cells
    assert after.confidence[18, after.names.index("r_front_knee")] == 1.0


def test_a_result_without_corrections_has_none_to_export(whole_results: Path, tmp_path: Path):
    file, out = whole_results / "corrections.csv", tmp_path / "corrected.csv"
    how = f"recon fix {whole_results}"
    none = (file, "file", "no keypoint has been corrected", [how, "--out"])
    refused(("fix", whole_results, "--export-table", out), none)
    elsewhere = tmp_path / "none.csv"
    absent = (elsewhere, "file", "no such file", [how, "--out"])
    refused(("fix", whole_results, "--out", elsewhere, "--export-table", out), absent)
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (("--export-labels", "project"), ("--video", "video", "nothing", "the video")),
        (("--with-accepted",), ("--with-accepted", "with_accepted", "no --export-labels", "both options or neither")),
        (("--export-table", "corrected.txt"), ("--export-table", "file", "corrected.txt", ".csv or .h5")),
    ],
)
def test_conflicting_options_are_refused(whole_results: Path, options: tuple[str, ...], expected):
    refused(("fix", whole_results, *options), expected)
