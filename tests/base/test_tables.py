"""Test that texts in tables cannot act as formulas, and that slow regular expressions are refused."""

from __future__ import annotations

import re

import numpy as np
import pandas as pd
import pytest

from recon.base.patterns import slow_part
from recon.base.tables import guarded, unguarded, write_frame
from recon.io.writing import write_columns, write_rows, write_table

LINK = '=HYPERLINK("http://example.org")'


@pytest.mark.parametrize("text", [LINK, "+a", "-a", "@a", "\ta", "'=a", "'a", "plain", "", "-1.5"])
def test_a_text_is_guarded_and_read_again(text):
    written = guarded(text)
    assert not written.startswith(("=", "+", "-a", "@", "\t"))
    assert unguarded(written) == text
    assert guarded(-1.5) == -1.5


def test_every_writer_of_tables_guards_texts(tmp_path):
    write_frame(pd.DataFrame({LINK: [LINK, "a"], "x": [-1.5, np.nan]}), tmp_path / "frame.csv")
    write_rows(tmp_path / "rows.csv", [[LINK, "x"]], [[LINK, -1.5], ["a", np.nan]])
    texts = [guarded(LINK).replace('"', '""')] * 2
    expected = '"{}",x\n"{}",-1.5\na,\n'.format(*texts)
    for name in ("frame", "rows"):
        assert (tmp_path / f"{name}.csv").read_text() == expected
    write_columns(tmp_path / "columns.csv", {"joint": np.array(["=a", "b", "=a"]), "x": np.array([-1.5, 1, np.nan])})
    lines = (tmp_path / "columns.csv").read_text().splitlines()
    assert [line.strip('"') for line in lines[1:]] == ["'=a,-1.5", "b,1", "'=a,"]


def test_numbers_are_written_as_python_prints_them(tmp_path):
    sizes = np.array([0.0, 1e-07, 9.9e-05, 1e-04, 0.1, 1 / 3, 100.0, 123456.7, 9.9e15, 1e16, 1e300, np.inf])
    values = np.concatenate([np.outer([1, -1], sizes).ravel(), [np.nan]])
    for table in (values[None], values[:, None]):  # one row of all numbers, and one number in each row
        frames = np.arange(len(table))
        write_table(tmp_path / "table.csv", [["frame"]], frames, table)
        expected = [",".join([str(t), *("" if x != x else repr(x) for x in table[t].tolist())]) for t in frames]
        assert (tmp_path / "table.csv").read_text().splitlines()[1:] == expected


@pytest.mark.parametrize("count", [0, 1, 9])
def test_pandas_reads_the_columns_of_a_long_table(tmp_path, count):
    columns = {
        "joint": np.array(["é", "", "wrist"] * 3)[:count],
        "frame": np.arange(9)[:count],
        "x_m": np.array([1 / 3, np.nan, np.inf] * 3)[:count],
        "y_m": np.array([1 / 3, np.nan, 2] * 3, np.float32)[:count],
    }
    write_columns(tmp_path / "columns.csv", columns)
    read = pd.read_csv(tmp_path / "columns.csv", keep_default_na=False, na_values={"x_m": "", "y_m": ""})
    assert [*read] == [*columns]
    for name, values in columns.items():
        assert read[name].to_numpy().astype(values.dtype).tolist() == pytest.approx(values.tolist(), nan_ok=True)


@pytest.mark.parametrize(
    ("pattern", "slow"),
    [
        ("-cam([A-Z])", None),
        ("(?<=cam)[0-9]+$", None),
        (".*_(cam[0-9]+)?.*", None),
        ("([A-Z]{2})+", None),
        ("(a+)+$", "within a repeat"),
        ("(ab|a)*$", "within a repeat"),
        ("(?=(a*)*b)", "within a repeat"),
        (".*.*.*.*x", "4 repeats"),
        ("a?" * 7 + "b", "7 optional parts"),
        ("a" * 201, "201 characters"),
    ],
)
def test_only_fast_patterns_are_accepted(pattern, slow):
    found = slow_part(pattern)
    assert found is None if slow is None else slow in str(found)


def test_invalid_pattern_raises_an_error():
    with pytest.raises(re.error):
        slow_part("(")
