"""Write the tables of an analysis for Excel and R, as a workbook or as a long table with a data dictionary.

In the long table every number has its own row, with variable and unit, and with the joint or foot, side, frame, time
and percent of the stride to which the number belongs. The data dictionary explains each variable of each table.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pandas as pd

from recon.animal.body import Body
from recon.base.documents import builtin_file
from recon.base.file_names import encodable
from recon.base.package import version
from recon.base.tables import guarded
from recon.fit.regions import radius
from recon.gait.clip import ClipAnalysis
from recon.gait.stances import INTERVAL
from recon.io.writing import formats_extra
from recon.show.tables import DICTIONARY, LONG, TABLES, UNITS, table_content, unit_of

KEYS = ("time_s", "frame", "percent", "start_s")
"""Columns of numbers that identify a row, in addition to all columns of text."""
_PARTS = (
    (r"_?sigma$", "one standard deviation of {}"),
    (r"_?low$", "lower end of the 90 % interval of {}"),
    (r"_?high$", "upper end of the 90 % interval of {}"),
)
_OF_TABLE = {
    "velocities": (
        *((f"(.+)_v{axis}", f"velocity of {{}} along {axis}") for axis in "xyz"),
        *((f"(.+)_a{axis}", f"acceleration of {{}} along {axis}") for axis in "xyz"),
    ),
    "angle_rates": (
        ("(.+)_rate", "angular rate of {}"),
        ("(.+)_acceleration", "angular acceleration of {}"),
        ("(.+)_angle", "angle at {}"),
    ),
    "joint_flexion": (("(.+)", "flexion of the {}; 0: straight, positive: flexed"),),
    "force_over_time": (("(.+)", "vertical force of {}"),),
    "gait": (
        ("duty_factor_(.+)", "fraction of a stride for which {} stands"),
        ("phase_(.+)", "touch-down of {} after that of LH, in strides"),
    ),
}
"""Patterns of columns that exist for each joint, angle or foot, with the columns' meanings, by table."""
_REMARKS = "known", "begins", "ends", "criterion", "source", "why_unknown", "footfalls"
"""Columns of text that do not identify a row."""
_OF_QUANTITY = "estimate", "sigma", "low", "high", "between_strides"
"""Columns of numbers whose unit is at the end of the quantity's name in the same row."""
MAX_ROWS = 1_000_000
"""Largest number of rows that are written into a sheet, slightly below the limit of Excel."""
MAX_COLUMNS = 30
"""Largest number of columns of a table that has its own sheet."""


def analysis_tables(analysis: ClipAnalysis) -> dict[str, pd.DataFrame]:
    """Return every table of an analysis, keyed by its name, with the same content as the CSV file of this name."""
    frames = {}
    for file_name in TABLES:
        content = table_content(analysis, file_name)
        if isinstance(content, dict):
            frame = pd.DataFrame(content)
        else:
            columns, rows = content
            frame = pd.DataFrame([*rows], columns=[*columns])
        frames[file_name.removesuffix(".csv")] = frame
    return frames


def meaning_of(column: str, table: str) -> str:
    """Return the meaning of a table's column without its unit, from `meanings.toml` or the parts of its name."""
    end = next((end for end in UNITS if column.endswith(f"_{end}")), "")
    return _meaning(column[: -len(end) - 1] if end else column, table)


def _meaning(name: str, table: str) -> str:
    meanings = _meanings()
    for known in (meanings.get(table, {}), meanings["any"]):
        if name in known:
            return known[name]
    for pattern, words in _PARTS:
        if (whole := re.sub(pattern, "", name)) not in ("", name):
            return words.format(_meaning(whole, table))
    for pattern, words in _OF_TABLE.get(table, ()):
        if match := re.fullmatch(pattern, name):
            return words.format(match[1].replace("_", " "))
    return name.replace("_", " ")


@cache
def _meanings() -> dict[str, dict[str, str]]:
    return tomllib.loads(builtin_file("show", "meanings.toml").read_text(encoding="utf-8"))


def dictionary(tables: dict[str, pd.DataFrame], body: Body) -> pd.DataFrame:
    """Return the data dictionary, with a row for each column of each table that gives its unit and meaning.

    The meanings of joint angles name the markers of `body` that define them.
    """
    rows = [
        (
            name,
            column,
            _unit_in_words(table, column),
            _with_markers(meaning_of(column, name), body),
            f"{name}.csv",
        )
        for name, table in tables.items()
        for column in table.columns
    ]
    return pd.DataFrame(rows, columns=["table", "variable", "unit", "meaning", "file"])


def _with_markers(meaning: str, body: Body) -> str:
    """Return the meaning of a column, for a joint's flexion with the markers between which the angle is measured."""
    for joint, (first, middle, last) in body.anatomy.items():
        of_joint = f"flexion of the {joint.replace('_', ' ')};"
        meaning = meaning.replace(of_joint, f"{of_joint[:-1]}, from {first} over {middle} to {last};")
    return meaning


def _unit_in_words(table: pd.DataFrame, column: str) -> str:
    return "unit of the quantity" if "quantity" in table and column in _OF_QUANTITY else unit_of(column)


def long_table(tables: dict[str, pd.DataFrame]) -> pd.DataFrame:
    """Return all numbers as a long table.

    The columns are table, of (the strings of a row), `KEYS`, variable, unit and value.
    """
    parts = [part for name, table in tables.items() for part in _melted(name, table)]
    columns = ["table", "of", *KEYS, "variable", "unit", "value"]
    if not parts:
        return pd.DataFrame(columns=columns)
    return pd.concat(parts, ignore_index=True)[columns]


def _melted(name: str, table: pd.DataFrame) -> Iterator[pd.DataFrame]:
    if table.empty:
        return
    texts = [column for column in table.columns if not pd.api.types.is_numeric_dtype(table[column])]
    keys = [column for column in KEYS if column in table.columns]
    numbers = [column for column in table.columns if column not in (*texts, *keys)]
    if not numbers:
        return
    names = [column for column in texts if column not in _REMARKS]
    labels = table[names].astype(str).agg(" ".join, axis=1) if names else pd.Series("", index=table.index)
    selected = table[[*keys, *numbers]].assign(of=labels)
    part = selected.melt(id_vars=["of", *keys], value_vars=numbers, var_name="variable", value_name="value")
    units = part["variable"].map(unit_of)
    if "quantity" in texts:
        units = units.where(~part["variable"].isin(_OF_QUANTITY), part["of"].map(unit_of))
    part = part.assign(table=name, unit=units)
    for key in KEYS:
        if key not in part:
            part[key] = np.nan
    yield part.dropna(subset="value")


def write_long(analysis: ClipAnalysis, folder: Path, decimal_comma: bool = False) -> None:
    """Write the long table and the data dictionary as CSV, separated by semicolons if decimals have commas."""
    tables = analysis_tables(analysis)
    separator, decimal = (";", ",") if decimal_comma else (",", ".")
    for name, table in ((LONG, long_table(tables)), (DICTIONARY, dictionary(tables, analysis.motion.body))):
        texts = table.select_dtypes(exclude=["number"]).columns
        safe = table.assign(**{column: table[column].map(guarded) for column in texts})
        safe.to_csv(folder / name, index=False, sep=separator, decimal=decimal, lineterminator="\n")


def write_workbook(analysis: ClipAnalysis, results: str, path: Path) -> None:
    """Write a workbook with a README, the data dictionary, a sheet of all numbers, and a sheet for each table.

    Raises
    ------
    InputError
        If the package openpyxl is not installed.
    """
    with formats_extra(path):
        import openpyxl
    tables = analysis_tables(analysis)
    book = openpyxl.Workbook(write_only=True)
    motion = analysis.motion
    verdict = motion.verdict.lines if motion.verdict else ()
    front = [
        [f"Analysis of {results} by recon {version()}"],
        *([line] for line in verdict),
        [f"90 % intervals reach {radius(INTERVAL):.2f} standard deviations to either side. Empty cells are unknown."],
        ["The sheet long has a row for each number, including those of tables with many columns."],
        [],
    ]
    _fill(book.create_sheet("README"), front, dictionary(tables, motion.body))
    _fill(book.create_sheet("long"), [], long_table(tables).head(MAX_ROWS))
    for name, table in tables.items():
        if len(table.columns) <= MAX_COLUMNS:
            _fill(book.create_sheet(name[:31]), [], table.head(MAX_ROWS))
    book.save(path)


def _fill(sheet: object, front: list[list[str]], table: pd.DataFrame) -> None:
    append: Callable[[list[object]], None] = sheet.append  # type: ignore[attr-defined]
    for row in front:
        append([_cell(value) for value in row])
    append([_cell(column) for column in table.columns])
    for row in table.itertuples(index=False):
        append([_cell(value) for value in row])


def _cell(value: object) -> object:
    """Return a value for a cell as a plain number or string, without formulas or NaN."""
    if isinstance(value, str):
        return guarded(encodable(re.sub(r"[\x00-\x08\x0b\x0c\x0e-\x1f]", " ", value)))
    if isinstance(value, bool | np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value) if np.isfinite(value) else None
    return None if value is None or value is pd.NA else str(value)
