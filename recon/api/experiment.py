"""Group the clips of an experiment by camera, run, animal and group, and model the variation between them.

The results of all cameras of a run become one clip, by the joint posterior of its quantities. The errors of the
pictures are independent. The errors of the lens and of the expected size are shared, and the expectation of the size,
which is part of every result, counts once. The cameras also share the error of a period that is estimated from less
than a stride. If the cameras disagree by more than their stated errors, the independent errors are scaled up (Birge
1932). Several cameras see the same strides, which count once: the strides of the camera that measures the quantity best
are used, shifted to the mean.

Each quantity then has a mixed model (`recon.gait.mixed_model`) with groups and covariates as fixed effects. The
standard deviation of a run's measurement is the one that the fits state, without the scatter of the strides.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from itertools import count as counting
from pathlib import Path

import numpy as np
import pandas as pd

from recon.base.arrays import Array
from recon.base.errors import InputError, Problem, raise_problems
from recon.base.numbers import counted
from recon.check.codes import names_text
from recon.gait.mixed_model import MixedModel, fit_mixed_model
from recon.io.common import text_rows

FIELDS = "camera", "run", "animal", "group"
ALL = "all"
"""Name of the only group if none is given."""
SPEED = "speed_m_s"
MODEL, VARIANCES, RUNS = "mixed_model.csv", "variances.csv", "runs.csv"
_SLOPE_NAMES = {SPEED: "per m/s of speed"}
"""Names, in the table, of slopes that do not have the name of their covariate."""
_MIN_SIGMA_FRACTION = 0.01
"""Minimum standard deviation of a camera's independent error, as a fraction of its total standard deviation."""
_MIN_SIGMA = 1e-9
"""Minimum standard deviation, and minimum magnitude of a value, by which another number is divided."""
_FIELD = re.compile(r"\{(\w*)\}")


def design_of_table(path: Path, names: Sequence[str], by: str, covariates: Sequence[str]) -> pd.DataFrame:
    """Return the camera, run, animal, group and covariates of each clip, from a CSV table.

    The clips are named in a column `clip`, or, in a manifest of `recon batch`, in `out` or by the keypoint file. A clip
    without a run is a run of its own.

    Parameters
    ----------
    path : Path
        CSV table of the design, one row for each clip.
    names : sequence of str
        Names of the clips, each of which needs a row.
    by : str
        Name of the column with the group.
    covariates : sequence of str
        Names of columns with numbers, to be used as covariates.

    Raises
    ------
    InputError
        If columns, rows or numbers are missing, or fields contradict each other.
    """
    lines = [cells for _, cells in text_rows(path)]
    header = [cell.strip() for cell in (lines[0] if lines else [])]
    rows = [dict(zip(header, (cell.strip() for cell in cells), strict=False)) for cells in lines[1:]]
    required = ["animal", *([by] if by != "group" else []), *covariates]
    problems = [
        Problem(
            path,
            "column",
            f"no column {name!r} among {', '.join(header)}",
            "a column of this name, separated by commas",
        )
        for name in required
        if name not in header
    ]
    if not {"clip", "keypoints"} & {*header}:
        problems.append(
            Problem(path, "column", f"no column 'clip' among {', '.join(header)}", "a column with the folders' names")
        )
    raise_problems(problems)
    by_clip = {_clip_name(row): row for row in rows}
    raise_problems(
        Problem(path, "clip", f"no row for {name}", "one row for every clip") for name in names if name not in by_clip
    )
    return _design({name: by_clip[name] for name in names}, path, by, covariates)


def _clip_name(row: Mapping[str, str]) -> str:
    return row.get("clip") or row.get("out") or Path(row.get("keypoints", "")).stem


def design_of_names(pattern: str, names: Sequence[str]) -> pd.DataFrame:
    """Return the camera, run, animal and group of each clip from its name.

    Parameters
    ----------
    pattern : str
        Form of the names with the fields in braces, as in {animal}-{run}-{camera}. {} stands for any text.
    names : sequence of str
        Names of the clips.

    Raises
    ------
    InputError
        If the pattern has no animal or unknown fields, or a name does not fit it.
    """
    fields = [field for field in _FIELD.findall(pattern) if field]
    wrong = [field for field in dict.fromkeys(fields) if field not in FIELDS or fields.count(field) > 1]
    if wrong or "animal" not in fields:
        expected = "the fields {animal} and perhaps {group}, {run} and {camera}, once each, as in {animal}-{run}"
        raise InputError(Problem("--names", "pattern", repr(pattern), expected))
    plain = _FIELD.split(pattern)
    regex = "".join(
        (f"(?P<{text}>.+?)" if text else ".*?") if index % 2 else re.escape(text) for index, text in enumerate(plain)
    )
    matches = {name: re.fullmatch(regex, name) for name in names}
    raise_problems(
        Problem("--names", "clip", repr(name), f"a name of the form {pattern}")
        for name in names
        if matches[name] is None
    )
    rows = {name: match.groupdict() for name, match in matches.items() if match is not None}
    return _design(rows, "--names", "group", ())


def _design(
    rows: Mapping[str, Mapping[str, str]], source: str | Path, by: str, covariates: Sequence[str]
) -> pd.DataFrame:
    records, problems = [], []
    for name, row in rows.items():
        record: dict[str, str | float] = {field: row.get(field, "") for field in FIELDS}
        record["group"] = row.get(by, "") or (ALL if by == "group" else "")
        problems += [
            Problem(source, f"{field} of {name}", "nothing", "a name")
            for field, column in (("animal", "animal"), (by, "group"))
            if not record[column]
        ]
        if record["camera"] and not record["run"]:
            problems.append(Problem(source, f"run of {name}", "nothing", "the run that this camera filmed"))
        record["run"] = record["run"] or name
        for covariate in covariates:
            try:
                record[covariate] = float(row.get(covariate, ""))
            except ValueError:
                problems.append(Problem(source, f"{covariate} of {name}", repr(row.get(covariate, "")), "a number"))
        records.append(record)
    raise_problems(problems)
    design = pd.DataFrame(records, index=[*rows])
    for (animal, run), clips in design.groupby(["animal", "run"], sort=False):
        problems += [
            Problem(
                source,
                f"{column} of run {run} of {animal}",
                names_text([*map(str, values)]),
                "the same value in all rows of the run",
            )
            for column in ("group", *covariates)
            if len(values := clips[column].unique()) > 1
        ]
    raise_problems(problems)
    return design


def runs_of_clips(clips: pd.DataFrame, quantities: Mapping[str, bool]) -> pd.DataFrame:
    """Return one row for each run, which joins the results of its cameras.

    Parameters
    ----------
    clips : DataFrame
        Table with one row for each clip and the columns clip, camera, run, animal, group, verdict, strides, size_sigma,
        and if known size_prior_sigma and focal_sigma (`recon.gait.quantities.shared_sigma_columns`). Each quantity has
        the columns NAME, `NAME_sigma`, `NAME_own_sigma`, `NAME_measurement_sigma`, `NAME_source`, and if known
        `NAME_run_sigma`, the part of `NAME_measurement_sigma` that the cameras of a run share. Other columns are taken
        from the first camera.
    quantities : mapping
        For each quantity, keyed by column, whether the quantity is proportional to the size of the animal.

    Returns
    -------
    DataFrame
        Table with one row for each run and the same columns. `clip` is the name of the run, `clips` the number of its
        results, and `first_clip` the result that measures the speed best. `NAME_strides_of` names the clip whose
        strides represent the run, and `NAME_shared_sigma` is the relative standard deviation of the errors that other
        clips share.
    """
    used, rows = {*clips["clip"]}, []
    for (animal, run), run_clips in clips.groupby(["animal", "run"], sort=False):
        if len(run_clips) == 1:
            row = run_clips.iloc[0].to_dict() | {"clips": 1, "first_clip": run_clips["clip"].iloc[0]}
            row |= {f"{name}_strides_of": row["clip"] for name in quantities}
            shared = {f"{name}_shared_sigma": row["size_sigma"] * scales for name, scales in quantities.items()}
            rows.append(row | shared)
            continue
        names = chain((f"{animal} {run}",), (f"{animal} {run} ({number})" for number in counting(2)))
        name = next(name for name in names if name not in used)
        used.add(name)
        best = run_clips.iloc[int(np.argmin(run_clips[f"{SPEED}_sigma"].fillna(np.inf).to_numpy(float)))]
        row = run_clips.iloc[0].to_dict() | {"clip": name, "clips": len(run_clips), "verdict": best["verdict"]}
        row["first_clip"] = best["clip"]
        row["camera"] = names_text([text for text in run_clips["camera"] if text])
        row["strides"] = int(run_clips["strides"].max())
        row["size_sigma"] = float(run_clips["size_sigma"].min())
        for quantity, with_size in quantities.items():
            row |= _joined(quantity, run_clips, with_size)
        rows.append(row)
    return pd.DataFrame(rows)


def _joined(name: str, clips: pd.DataFrame, with_size: bool) -> dict[str, object]:
    known = clips[np.isfinite(clips[name]) & np.isfinite(clips[f"{name}_measurement_sigma"])]
    if known.empty:
        unknown: dict[str, object] = {f"{name}_source": "", f"{name}_strides_of": ""}
        fields = ("", "_sigma", "_own_sigma", "_measurement_sigma", "_shared_sigma")
        return unknown | {f"{name}{field}": np.nan for field in fields}
    values, sigmas = known[name].to_numpy(float), known[f"{name}_measurement_sigma"].to_numpy(float)
    in_run = known[f"{name}_run_sigma"].to_numpy(float) if f"{name}_run_sigma" in known else np.zeros(len(known))
    mean, sigma, shared = joint_posterior(values, sigmas, in_run, *_shared_errors(known, with_size))
    best = known.iloc[int(np.argmin(sigmas))]
    scatter = np.sqrt(max(float(best[f"{name}_own_sigma"]) ** 2 - float(best[f"{name}_measurement_sigma"]) ** 2, 0.0))
    own_sigma = float(np.hypot(sigma, scatter))
    row: dict[str, object] = {name: mean, f"{name}_sigma": float(np.hypot(own_sigma, shared * mean))}
    row |= {f"{name}_own_sigma": own_sigma, f"{name}_measurement_sigma": sigma, f"{name}_shared_sigma": shared}
    return row | {f"{name}_source": best[f"{name}_source"], f"{name}_strides_of": best["clip"]}


def _shared_errors(clips: pd.DataFrame, with_size: bool) -> tuple[Array, Array, Array]:
    """Return relative standard deviations (C,) of each clip's size, of its expected size, and from its lens."""
    total = clips["size_sigma"].to_numpy(float) * with_size
    zeros = np.zeros(len(clips))
    focal = clips["focal_sigma"].to_numpy(float) * with_size if "focal_sigma" in clips else zeros
    size = np.sqrt(np.maximum(total**2 - focal**2, 0.0))
    prior = clips["size_prior_sigma"].to_numpy(float) if "size_prior_sigma" in clips else size
    return size, np.fmax(prior, size), focal


def joint_posterior(
    values: Array, sigmas: Array, run_sigmas: Array, size_sigmas: Array, prior_sigmas: Array, focal_sigmas: Array
) -> tuple[float, float, float]:
    """Combine the results of C cameras for one quantity of a run, considering independent and shared errors.

    Parameters
    ----------
    values, sigmas : ndarray
        Value of each camera, and its standard deviation without the errors of size and lens, shape (C,).
    run_sigmas : ndarray
        The part of `sigmas` that all cameras of the run share, shape (C,).
    size_sigmas, prior_sigmas : ndarray
        Relative standard deviation of the animal's size in each result and before it, shape (C,); 0 if the size does
        not matter.
    focal_sigmas : ndarray
        Relative standard deviation from the focal length, shape (C,). The cameras may have the same lens, so that this
        error counts as shared.

    Returns
    -------
    tuple of float
        The most likely value, its standard deviation without shared errors, and the relative standard deviation of
        the errors that other clips share.

    Notes
    -----
    A size has the standard deviation s, or p before the pictures were seen. Its error has two parts: -(s^2 / p^2) d,
    where d is the deviation of the animal from the expected size, which all cameras share; and an independent error of
    variance s^2 (1 - s^2 / p^2) from the pictures. Given the covariance of all errors, the generalised mean is the mode
    of the joint posterior in which the expectation of the size counts once. Negative weights, which would extrapolate
    from errors that are shared only in part, are 0.

    References
    ----------
    R. T. Birge, The calculation of errors by the method of least squares, Phys. Rev. 40, 1932: the standard deviation
    grows by the square root of chi^2 / (C - 1) if this is above 1.
    """
    from_prior = np.divide(size_sigmas**2, prior_sigmas, out=np.zeros(len(values)), where=prior_sigmas > 0)
    from_pictures = np.maximum(size_sigmas**2 - from_prior**2, 0.0)
    least = np.maximum(_MIN_SIGMA_FRACTION * sigmas, _MIN_SIGMA)
    independent = np.maximum(sigmas**2 - run_sigmas**2, least**2)
    usual = float(np.average(values, weights=1 / independent))
    independent = independent + from_pictures * usual**2
    shared = np.stack([from_prior, focal_sigmas]) * abs(usual)
    # A shared error in proportion to each camera's own value would favour the smaller values.
    in_run = run_sigmas * abs(usual) / np.maximum(np.abs(values), _MIN_SIGMA)
    precision = np.linalg.inv(np.diag(independent) + shared.T @ shared + np.multiply.outer(in_run, in_run))
    weights = np.maximum(precision.sum(axis=0), 0.0)
    weights = weights / weights.sum()
    mean = float(weights @ values)
    chi_squared = float((values - mean) @ precision @ (values - mean))
    scale = max(1.0, chi_squared / max(len(values) - 1, 1))
    sigma = float(np.sqrt(scale * np.sum(weights**2 * independent) + (weights @ in_run) ** 2))
    return mean, sigma, float(np.linalg.norm(shared @ weights)) / max(abs(usual), _MIN_SIGMA)


@dataclass(frozen=True, eq=False)
class QuantityModel:
    """Mixed model of one quantity."""

    name: str
    model: MixedModel
    groups: tuple[str, ...]
    """Names of the groups, the reference first."""
    covariates: tuple[str, ...]
    shared: float
    """Relative standard deviation of the error that all clips share."""
    run_table: pd.DataFrame
    """Group, animal, and numbers of clips and strides of each run."""

    @property
    def strides_of_run(self) -> float:
        """Return the mean number of strides of a run."""
        return self.model.strides / self.model.runs

    def effects(self) -> Iterator[dict[str, object]]:
        """Yield each group's mean, its difference from the first group, and the slope of each covariate."""
        size, total = len(self.model.names), len(self.groups)
        for column, group in enumerate(self.groups):
            yield self._row(f"mean of {group}", np.eye(size)[column], (group,))
        for column, group in enumerate(self.groups[1:], start=1):
            weights = np.eye(size)[column] - np.eye(size)[0]
            yield self._row(f"{group} - {self.groups[0]}", weights, (self.groups[0], group))
        for column, covariate in enumerate(self.covariates, start=total):
            yield self._row(_SLOPE_NAMES.get(covariate, f"per unit of {covariate}"), np.eye(size)[column], self.groups)

    def _row(self, effect: str, weights: Array, groups: Sequence[str]) -> dict[str, object]:
        value, sigma, low, high = self.model.contrast(weights, self.shared)
        row: dict[str, object] = {"quantity": self.name, "effect": effect, "value": value, "sigma": sigma}
        row |= {"low": low, "high": high, "shared_sigma": abs(self.shared * value)}
        return row | self._counts(groups)

    def _counts(self, groups: Sequence[str]) -> dict[str, int]:
        """Return the numbers of animals, runs, clips and strides in the given groups together."""
        table = self.run_table[self.run_table["group"].isin(groups)]
        counts = {"animals": table["animal"].nunique(), "runs": len(table)}
        return counts | {name: int(table[name].sum()) for name in ("clips", "strides")}

    def sigmas_row(self) -> dict[str, object]:
        """Return the quantity's row of variances.csv.

        The row has the standard deviations between animals, runs and strides and of the measurement, the intraclass
        correlation, and the smallest detectable change.
        """
        sigmas = self.model.sigmas
        row: dict[str, object] = {"quantity": self.name, "mean": float(np.mean(self.model.effects[: len(self.groups)]))}
        row |= {f"{level}_sd": getattr(sigmas, level) for level in ("animal", "run", "stride", "measurement")}
        row |= {"icc": sigmas.icc, "smallest_detectable_change": sigmas.detectable_change(self.strides_of_run)}
        row |= {"shared_sigma_relative": self.shared, "strides_of_run": self.strides_of_run}
        return row | self._counts(self.groups)


def fit_experiment(
    runs: pd.DataFrame, strides: pd.DataFrame, quantities: Mapping[str, bool], covariates: Sequence[str] = ()
) -> tuple[list[QuantityModel], list[str]]:
    """Fit the mixed model of each quantity.

    Parameters
    ----------
    runs : DataFrame
        Table of runs, as `runs_of_clips` returns it.
    strides : DataFrame
        Table of strides, with the column clip and a column for each quantity.
    quantities : mapping
        For each quantity, keyed by column, whether the quantity is proportional to the size of the animal.
    covariates : sequence of str
        Columns of `runs`, from which the means are subtracted.

    Returns
    -------
    tuple
        The models, and notes on quantities without one.
    """
    models, without = [], dict[str, list[str]]()
    for name in quantities:
        used = [covariate for covariate in covariates if covariate != name]
        is_known = np.isfinite(runs[[name, f"{name}_measurement_sigma", *used]].to_numpy(float)).all(axis=1)
        known = runs.iloc[np.flatnonzero(is_known)]
        groups = tuple(dict.fromkeys(known["group"].astype(str)))
        animals, columns = known["animal"].nunique(), len(groups) + len(used)
        if known.empty:
            continue
        if animals <= columns:
            needed = f"{counted(columns, 'group or covariate') if columns == 1 else f'{columns} groups and covariates'}"
            enough = f"{counted(animals, 'animal')} for {needed}; at least {columns + 1} are needed"
            without.setdefault(enough, []).append(_title(name))
            continue
        model = _fit(name, known, strides, groups, used)
        if model is None:
            without.setdefault(f"{names_text(used)} cannot be separated from the groups", []).append(_title(name))
        else:
            models.append(model)
    notes = [f"No mixed model of {names_text(names)}: {reason}." for reason, names in without.items()]
    if models:
        notes += _joined_levels(models)
    return models, notes


def _title(name: str) -> str:
    return re.sub("_(m|m_s|hz)$", "", name).replace("_", " ")


def _joined_levels(models: Sequence[QuantityModel]) -> Iterator[str]:
    """Yield notes on the components of variance that the data cannot separate."""
    if any(model.model.runs == model.model.animals for model in models):
        yield "Each animal has one run: the variance between runs is part of the variance between animals."
    single = [_title(model.name) for model in models if model.model.strides == model.model.runs]
    if single:
        part = "the variance between strides is part of the variance between runs"
        yield f"One value per run of {names_text(single)}: {part}."


def _fit(
    name: str,
    runs: pd.DataFrame,
    strides: pd.DataFrame,
    groups: tuple[str, ...],
    covariates: list[str],
) -> QuantityModel | None:
    """Return the model of a quantity, or None if the design matrix does not have full rank."""
    size = runs[f"{name}_shared_sigma"].to_numpy(float)
    shared = float(size.min())
    unshared = (size**2 - shared**2) * runs[name].to_numpy(float) ** 2
    run_sigmas = np.sqrt(runs[f"{name}_measurement_sigma"].to_numpy(float) ** 2 + unshared)
    columns = [(runs["group"].astype(str) == group).to_numpy(float) for group in groups]
    columns += [runs[covariate].to_numpy(float) - runs[covariate].mean() for covariate in covariates]
    by_run = np.asarray(np.column_stack(columns), dtype=float)
    scale = np.where(np.ptp(by_run, axis=0) > 0, by_run.std(axis=0) + np.abs(by_run).max(axis=0), 1.0)
    if np.linalg.matrix_rank(by_run / scale) < len(columns):
        return None
    values, rows, counts = [], list[int](), []
    for row, run in enumerate(runs.to_dict("records")):
        run_strides = (
            strides.loc[strides["clip"] == run[f"{name}_strides_of"], name] if name in strides else pd.Series()
        )
        values_of_run = run_strides.to_numpy(float)
        values_of_run = values_of_run[np.isfinite(values_of_run)]
        shifted = values_of_run - values_of_run.mean() + run[name] if len(values_of_run) else np.array([run[name]])
        values += [*shifted]
        rows += [row] * len(shifted)
        counts.append((str(run["group"]), run["animal"], run["clips"], len(values_of_run)))
    run_table = pd.DataFrame(counts, columns=["group", "animal", "clips", "strides"])
    animals, names = ([str(runs[column].iloc[row]) for row in rows] for column in ("animal", "run"))
    effects = *groups, *covariates
    model = fit_mixed_model(
        np.array(values), np.asarray(by_run[rows], dtype=float), effects, animals, names, run_sigmas[rows]
    )
    return QuantityModel(name, model, groups, tuple(covariates), shared, run_table)


@dataclass(frozen=True, eq=False)
class Experiment:
    """Runs of an experiment, the mixed models of its quantities, and their tables."""

    runs: pd.DataFrame
    """Table with one row for each run, as `runs_of_clips` returns it."""
    models: Sequence[QuantityModel]
    notes: Sequence[str]

    @property
    def effects(self) -> pd.DataFrame:
        """Return the groups' means, their differences and the slopes of the covariates, with 90 % intervals."""
        rows = [row for model in self.models for row in model.effects()]
        return pd.DataFrame(rows, columns=None if rows else ["quantity", "effect"])

    @property
    def variances(self) -> pd.DataFrame:
        """Return a table with the standard deviations between animals, runs and strides and of the measurement."""
        rows = [model.sigmas_row() for model in self.models]
        return pd.DataFrame(rows, columns=None if rows else ["quantity"])

    def with_model_means(self, groups: pd.DataFrame) -> pd.DataFrame:
        """Return a table of groups with the models' means and their 90 % intervals, `_low` and `_high`."""
        groups = groups.copy()
        for model in self.models:
            for column, group in enumerate(model.groups):
                weights = np.eye(len(model.model.names))[column]
                row = groups["group"].astype(str) == group
                columns = [f"{model.name}{end}" for end in ("", "_sigma", "_low", "_high")]
                groups.loc[row, columns] = list(model.model.contrast(weights, model.shared))
        return groups


def model_experiment(
    clips: pd.DataFrame, strides: pd.DataFrame, quantities: Mapping[str, bool], covariates: Sequence[str] = ()
) -> Experiment:
    """Join the cameras of each run, and fit a mixed model of each quantity.

    Parameters
    ----------
    clips, strides : DataFrame
        Tables as for `runs_of_clips` and `fit_experiment`.
    quantities : mapping
        For each quantity, keyed by column, whether the quantity is proportional to the size of the animal.
    covariates : sequence of str
        Columns of `clips` to use as covariates.
    """
    runs = runs_of_clips(clips, quantities)
    models, notes = fit_experiment(runs, strides, quantities, covariates)
    joined = runs.loc[runs["clips"] > 1, "clip"].tolist()
    if joined:
        notes.insert(
            0,
            f"The cameras of {counted(len(joined), 'run')} were joined, weighted by their stated uncertainties: "
            f"{names_text(joined)}. A fit of all cameras together (recon fit with their files) is better.",
        )
    return Experiment(runs, models, notes)
