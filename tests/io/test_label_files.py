"""Test files of labelled frames in DeepLabCut's layout, as pandas reads it, and in COCO's."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from recon import InputError
from recon.io.formats import read_keypoints
from recon.io.label_files import LabelledFrames, require_label_names, write_label_files

NAN = [np.nan, np.nan]
LABELS = LabelledFrames(
    "run",
    "me",
    ("nose", "tail"),
    np.array([7, 12]),
    np.array([[[1.5, 2.0], NAN], [[3.0, 4.0], [5.25, 6.0]]]),
    (("by hand", ""), ("by hand", "detected")),
    ((0, 1),),
    (64, 48),
)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    pytest.importorskip("tables")
    path = tmp_path / "labeled-data" / "run"
    path.mkdir(parents=True)
    write_label_files(LABELS, path)
    return path


def test_pandas_reads_both_tables_in_the_layout_of_deeplabcut(folder: Path):
    csv = pd.read_csv(folder / "CollectedData_me.csv", header=[0, 1, 2], index_col=[0, 1, 2])
    h5 = pd.read_hdf(folder / "CollectedData_me.h5", "df_with_missing")
    for table in (csv, h5):
        assert [*table.index] == [("labeled-data", "run", f"img{n:04d}.png") for n in (7, 12)]
        assert table.columns.names == ["scorer", "bodyparts", "coords"]
        assert [*table.columns] == [("me", name, x) for name in ("nose", "tail") for x in "xy"]
        np.testing.assert_array_equal(table.to_numpy(), LABELS.xy_px.reshape(2, 4))


@pytest.mark.parametrize("name", ["CollectedData_me.csv", "CollectedData_me.h5", "coco.json"])
def test_every_file_reads_back(folder: Path, name: str):
    read = read_keypoints(folder / name)
    assert read.names == LABELS.names
    assert read.frames.tolist() == [7, 12]
    np.testing.assert_array_equal(read.xy_px, LABELS.xy_px)


def test_the_origin_of_each_label_is_in_a_table(folder: Path):
    lines = (folder / "origins.csv").read_text().splitlines()
    assert lines[1:] == [
        "img0007.png,nose,1.5,2.0,by hand",
        "img0012.png,nose,3.0,4.0,by hand",
        "img0012.png,tail,5.25,6.0,detected",
    ]


def test_the_same_labels_give_the_same_bytes(folder: Path, tmp_path: Path):
    write_label_files(LABELS, tmp_path)
    for name in LABELS.file_names:
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes(), name


@pytest.mark.parametrize("name", ["", "../me", "a/b", "a\\b", ".hidden", "a\nb", "a*"])
def test_a_name_that_cannot_be_a_file_name_is_refused(name: str):
    with pytest.raises(InputError, match="a file name"):
        require_label_names("run", name)
