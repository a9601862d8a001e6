"""Test the workbook and the long table of an analysis, each with its data dictionary."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import refused

from recon.gait.clip import ClipAnalysis
from recon.show.tables import DICTIONARY, LONG, TABLES, Columns, Table, unit_of
from recon.show.workbook import analysis_tables, dictionary, long_table, meaning_of, write_long, write_workbook

FEW = ("joints", "stances", "strides", "gait", "gait_quantities", "joint_flexion_stride", "closures", "centre_of_mass")
ROWS = 12


@pytest.fixture(autouse=True)
def few_tables(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reduce an analysis to the beginnings of a few tables, because all tables have a hundred thousand cells."""

    def begun(make: Callable[[ClipAnalysis], Table | Columns], analysis: ClipAnalysis) -> Table | Columns:
        content = make(analysis)
        if isinstance(content, dict):
            return {name: values[:ROWS] for name, values in content.items()}
        return content[0], [*islice(content[1], ROWS)]

    few = {f"{name}.csv": partial(begun, TABLES[f"{name}.csv"]) for name in FEW}
    monkeypatch.setattr("recon.show.workbook.TABLES", few)
    monkeypatch.setattr("recon.show.tables.TABLES", few)


@pytest.fixture(scope="module")
def whole(whole_analysis: ClipAnalysis) -> ClipAnalysis:
    return whole_analysis


@pytest.mark.parametrize(
    ("table", "column", "unit", "meaning"),
    [
        ("joints", "peak_speed_sigma_m_s", "m/s", "one standard deviation of greatest speed"),
        ("strides", "frequency_hz", "Hz", "strides per second"),
        ("reference", "ax_m_s2", "m/s²", "acceleration along x"),
        ("velocities", "l_eye_vx_sigma_m_s", "m/s", "one standard deviation of velocity of l eye along x"),
        ("angle_rates", "spine_angle_rate_rad_s", "rad/s", "angular rate of spine angle"),
        ("joint_flexion", "left_elbow_deg", "°", "flexion of the left elbow; 0: straight, positive: flexed"),
        ("force_over_time", "LF_low_bw", "body weight", "lower end of the 90 % interval of vertical force of LF"),
        ("gait", "phase_RF", "", "touch-down of RF after that of LH, in strides"),
        ("vector_field_means", "speed_sigma_m_s", "m/s", "one standard deviation of the speed in a single frame"),
        ("", "a_new_column_m", "m", "a new column"),
    ],
)
def test_units_and_meanings_follow_from_names(table: str, column: str, unit: str, meaning: str):
    assert (unit_of(column), meaning_of(column, table)) == (unit, meaning)


def test_a_meaning_says_more_than_the_name(whole: ClipAnalysis):
    tables = analysis_tables(whole)
    # in angle_rates, the column of an angle has the angle's name
    names = [(name, column) for name, table in tables.items() if name != "angle_rates" for column in table.columns]
    assert not [
        (name, column) for name, column in names if meaning_of(column, name) in (column, column.replace("_", " "))
    ]


def test_the_long_table_has_every_number_with_its_unit(whole: ClipAnalysis):
    tables = analysis_tables(whole)
    long = long_table(tables)
    strides = tables["strides"]
    lengths = long[(long["table"] == "strides") & (long["variable"] == "length_m")]
    assert lengths["value"].tolist() == strides["length_m"].tolist()
    assert set(lengths["unit"]) == {"m"}
    assert lengths["start_s"].tolist() == strides["start_s"].tolist()
    assert lengths["of"].tolist() == [f"{foot} {at}" for foot, at in zip(strides["foot"], strides["at"], strict=True)]
    assert not long["value"].isna().any()
    speed = long[(long["table"] == "gait_quantities") & (long["of"] == "speed_m_s")].set_index("variable")
    assert (
        speed.loc["estimate", "value"] == tables["gait_quantities"].set_index("quantity").loc["speed_m_s", "estimate"]
    )
    assert (speed.loc["sigma", "unit"], speed.loc["n", "unit"]) == ("m/s", "")
    assert "spine" in {*long.loc[long["table"] == "joints", "of"]}


def test_the_dictionary_states_units_of_every_kind(whole: ClipAnalysis):
    listed = dictionary(analysis_tables(whole), whole.motion.body).set_index(["table", "variable"])["unit"]
    assert listed["centre_of_mass", "angular_momentum_x_m2_s"] == "m²/s"
    assert listed["gait_quantities", "estimate"] == "unit of the quantity"
    assert listed["gait_quantities", "n"] == ""
    assert listed["closures", "closure_angle_percent"] == "%"


def test_the_dictionary_states_the_markers_of_joint_angles(whole: ClipAnalysis):
    tables = {"joint_flexion": pd.DataFrame(columns=["left_hip_deg", "right_hip_sigma_deg", "neck_deg"])}
    hip, right_hip, neck = dictionary(tables, whole.motion.body)["meaning"]
    assert "from spine over l_hip to l_back_knee" in hip
    assert "from spine over r_hip to r_back_knee" in right_hip
    assert "from spine over neck_base to nose" in neck


def test_decimal_commas_are_read_again(whole: ClipAnalysis, tmp_path: Path):
    write_long(whole, tmp_path, decimal_comma=True)
    read = pd.read_csv(tmp_path / LONG, sep=";", decimal=",")
    np.testing.assert_allclose(read["value"], long_table(analysis_tables(whole))["value"])
    assert "," in (tmp_path / LONG).read_text(encoding="utf-8").splitlines()[1]
    listed = pd.read_csv(tmp_path / DICTIONARY, sep=";")
    assert set(read["variable"]) <= set(listed["variable"])


def test_a_workbook_has_a_readme_with_the_dictionary_and_the_tables(whole: ClipAnalysis, tmp_path: Path):
    openpyxl = pytest.importorskip("openpyxl")
    write_workbook(whole, "=clip", tmp_path / "a.xlsx")
    book = openpyxl.load_workbook(tmp_path / "a.xlsx", read_only=True)
    assert book.sheetnames[:2] == ["README", "long"]
    assert {"strides", "stances", "joint_flexion_stride"} <= {*book.sheetnames}
    readme = [*book["README"].iter_rows(values_only=True)]
    assert ("strides", "length_m", "m", "length of the body's path during the stride", "strides.csv") in [
        row[:5] for row in readme
    ]
    assert readme[0][0].startswith("Analysis of =clip by recon")
    header, first = [*book["strides"].iter_rows(values_only=True)][:2]
    row = dict(zip(header, first, strict=True))
    assert row["length_m"] == pytest.approx(analysis_tables(whole)["strides"]["length_m"][0])


def test_decimal_commas_belong_to_the_long_table(whole_results: Path):
    refused(["analyse", whole_results, "--decimal-comma"], ("--decimal-comma", "table", "--format csv"))
