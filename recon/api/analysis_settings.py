"""Settings of the commands `recon analyse` and `recon compare`.

They are separate from the work, whose libraries the command line needs only when a command runs.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from recon.api.options import ANYWAY, STRIDE, StrideTimes
from recon.base.errors import Problem
from recon.base.settings import OneOrMore, Option, Positive, Settings

ANALYSIS_FOLDER = "analysis"
"""Name of the analysis folder inside the results folder, by default."""
SPEED_NAMES = "speed", "speed_m_s"
"""Names under which the speed of the run can be given as a covariate."""
NO_COMPARE_OUT = Problem("--out", "folder", "nothing", "a folder for the tables, the figure and the page")
_EXPERIMENT = "An experiment"


class AnalyseSettings(Settings):
    """Settings of `recon analyse`."""

    folder: Annotated[Path, Option(argument="DIR")]
    """Folder of results, such as results/clip."""
    out: Path | None = None
    """Folder for tables and figures. (default: analysis in DIR)"""
    stride: Annotated[StrideTimes | None, STRIDE] = None
    body_mass_kg: Positive | None = None
    """Body mass of the animal in kg, from which forces are also given in newtons."""
    belt_speed_m_s: Annotated[Positive | None, Option(name="--belt-speed")] = None
    """Speed of the treadmill's belt in m/s, such as 1.4, if the fit did not use it."""
    figures: bool = True
    """Write figures (PNG and SVG) next to the tables: side view, joint angles, footfalls, speed."""
    all_figures: bool = False
    """Write all figures: also poses, vector fields, phase portraits, information, forces, and the body-fixed frame."""
    tables_format: Annotated[Literal["csv", "xlsx", "long"], Option(name="--format")] = "csv"
    """Additional tables: xlsx for a workbook, analysis.xlsx, or long for analysis_long.csv, one tidy table with all
    numbers, and its data dictionary.
    """
    decimal_comma: bool = False
    """Use decimal commas, and semicolons between columns, in the table of --format long."""
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: bool = False
    """Replace an earlier analysis."""

    def problems(self) -> Iterator[Problem]:
        """Yield a problem if decimal commas are requested without --format long."""
        if self.decimal_comma and self.tables_format != "long":
            yield Problem("--decimal-comma", "table", f"--format {self.tables_format}", "--format long as well")

    @property
    def out_folder(self) -> Path:
        """Return the folder for the tables and figures."""
        return self.folder / ANALYSIS_FOLDER if self.out is None else self.out


class CompareSettings(Settings):
    """Settings of `recon compare`."""

    folders: Annotated[OneOrMore[Path], Option(argument="DIR")] = ()
    """Results folders, or folders of batches. With --plan, also the folder of an earlier comparison, or none."""
    out: Path | None = None
    """Folder for the tables, the figure and the page. Required, except with --plan."""
    table: Path | None = None
    """CSV table with a column clip (the folders' names) and the column of --by."""
    by: str | None = None
    """Column of the table or the design to group the clips by, such as sex (with --design: group)."""
    design: Annotated[Path | None, Option(panel=_EXPERIMENT)] = None
    """CSV table with the columns clip, animal, and as needed run, camera, group and covariates; or a batch's manifest
    with the columns animal, run and group. The results of a run's cameras are joined, and a mixed model separates the
    variation between animals, runs, strides and measurements.
    """
    names: Annotated[str | None, Option(panel=_EXPERIMENT, metavar="PATTERN")] = None
    """Form of the folders' names, instead of a design, as in {group}-{animal}-{run}-{camera}."""
    covariate: Annotated[OneOrMore[str], Option(panel=_EXPERIMENT, metavar="NAME")] = ()
    """Covariates of the mixed model, such as speed (the speed of the run), or the name of a column of the design."""
    plan: Annotated[OneOrMore[str], Option(panel=_EXPERIMENT, metavar="TEXT")] = ()
    """Report how many animals, runs, strides and cameras an effect needs: with the variances of the folders, as in
    "effect=0.3 power=0.8", or with given variances, as in "effect=10% mean=4 animal=0.4 run=0.2 stride=0.2
    measurement=0.15"."""
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: bool = False
    """Replace an earlier comparison."""

    def problems(self) -> Iterator[Problem]:
        """Yield problems with options that are missing, or that exclude each other."""
        is_experiment = self.design is not None or self.names is not None
        if self.table is not None and is_experiment:
            yield Problem(
                "--table", "table", "--design or --names as well", "only one of --table, --design and --names"
            )
        elif self.design is not None and self.names is not None:
            yield Problem("--names", "pattern", "--design as well", "only one of --design and --names")
        elif (self.table is None) != (self.by is None) and self.design is None:
            yield Problem("--by", "table", "only one of --table and --by", "both: a table, and a column of this table")
        if self.covariate and not is_experiment:
            yield Problem(
                "--covariate", "design", "no design of the clips", "--design or --names, which identify the animals"
            )
        if self.names is not None:
            for covariate in self.covariate:
                if covariate not in SPEED_NAMES:
                    yield Problem(
                        "--covariate", "name", repr(covariate), "speed, or a column of a table given by --design"
                    )
        if not self.folders and not self.plan:
            yield Problem("DIR", "folders", "nothing", "folders of results, or of batches")
        if self.out is None and not self.plan:
            yield NO_COMPARE_OUT
