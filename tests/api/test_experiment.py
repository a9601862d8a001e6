"""Test experiments: the design, the cameras of a run, the mixed model of each quantity, and plans."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import refusal, refused, run, says
from made_up_herd import CLIPS, DESIGN, clip_row, make_herd, stride_rows, use_made_up_numbers
from numpy.typing import ArrayLike
from shortcuts import leave_out_drawing

from recon.api.batch_inputs import _drafts_of_manifest
from recon.api.compare import WITH_SIZE
from recon.api.experiment import (
    Experiment,
    design_of_names,
    design_of_table,
    joint_posterior,
    model_experiment,
)
from recon.api.experiment_plan import plan_experiment, read_plan
from recon.gait.mixed_model import LevelSigmas, animals_needed, power, smallest_effect


@pytest.fixture(scope="module")
def design_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("design") / "design.csv"
    path.write_text(DESIGN)
    return path


@pytest.fixture(scope="module")
def tables(design_file: Path) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the tables of clips and strides of the made-up herd."""
    design = design_of_table(design_file, CLIPS, "group", ())
    clips, strides = [], []
    for clip in CLIPS:
        labels = {"group": "", "clip": clip, "verdict": "use"} | design.loc[clip].to_dict()
        rows = [labels | row for row in stride_rows(clip)]
        clips.append(labels | clip_row(clip, rows))
        strides += rows
    return pd.DataFrame(clips), pd.DataFrame(strides)


@pytest.fixture(scope="module")
def experiment(tables: tuple[pd.DataFrame, pd.DataFrame]) -> Experiment:
    return model_experiment(*tables, WITH_SIZE, ["speed_m_s"])


# The design


def test_a_design_is_a_table_a_manifest_or_names(tmp_path: Path, design_file: Path):
    design = design_of_table(design_file, CLIPS[:3], "group", ())
    assert design.to_dict("index")["anna-2-left"] == {
        "camera": "left",
        "run": "2",
        "animal": "anna",
        "group": "control",
    }
    by_name = design_of_names("{animal}-{run}-{camera}", CLIPS[:3])
    assert by_name["group"].unique() == ["all"]
    pd.testing.assert_frame_equal(by_name.drop(columns="group"), design.drop(columns="group"))
    manifest = tmp_path / "manifest.csv"
    manifest.write_text("keypoints,camera,out,animal,group\nfilm/a.csv,,first,x,g\nfilm/b.csv,,,y,h\n")
    of_manifest = design_of_table(manifest, ["first", "b"], "group", ())
    assert of_manifest["animal"].tolist() == ["x", "y"]
    assert of_manifest["run"].tolist() == ["first", "b"]  # without a column of runs, each clip is a run
    (tmp_path / "film").mkdir()
    for name in ("a", "b"):
        (tmp_path / "film" / f"{name}.csv").touch()
    assert [{*draft.row} for draft in _drafts_of_manifest(manifest)] == [
        set(),
        set(),
    ]  # no fit reads these columns


def test_a_wrong_design_is_refused(tmp_path: Path):
    def refuses(text: str, covariates: list[str], *expected: tuple[object, ...]) -> None:
        path = tmp_path / "design.csv"
        path.write_text(text)
        with refusal(*((path, *rest) for rest in expected)):
            design_of_table(path, ["a", "b"], "group", covariates)

    refuses("clip,run\na,1\nb,1\n", ["age"], ("column", "'animal'"), ("column", "'age'"))
    refuses("name,animal\na,1\n", [], ("column", "'clip'"))
    refuses("clip,animal\na,x\n", [], ("clip", "no row for b"))
    refuses("clip,animal,camera\na,x,left\nb,,\n", [], ("run of a", "nothing"), ("animal of b", "nothing"))
    refuses("clip,animal,age\na,x,old\nb,y,3\n", ["age"], ("age of a", "'old'", "a number"))
    refuses("clip,animal,run,group\na,x,1,g\nb,x,1,h\n", [], ("group of run 1 of x", "g, h"))
    with refusal(("--names", "pattern", "{animal}-{leg}")):
        design_of_names("{animal}-{leg}", ["a-b"])
    with refusal(("--names", "clip", "ab")):
        design_of_names("{animal}-{run}", ["a-b", "ab"])


# The cameras of a run


def joined(
    values: ArrayLike,
    sigmas: ArrayLike,
    size: ArrayLike = 0.0,
    prior: ArrayLike = 0.0,
    focal: ArrayLike = 0.0,
    in_run: ArrayLike = 0.0,
) -> tuple[float, float, float]:
    """Return the joint posterior of two cameras."""
    arrays = (
        np.broadcast_to(np.asarray(value, dtype=float), 2) for value in (values, sigmas, in_run, size, prior, focal)
    )
    return joint_posterior(*arrays)


def test_cameras_of_a_run_are_weighted_and_share_the_size_error():
    assert joined([4.0, 4.1], [0.1, 0.2]) == pytest.approx((4.02, 1 / np.sqrt(125), 0.0))
    # Errors of the expected size and of the focal length do not average out; errors of a measured size do.
    assert joined([4.0, 4.0], [0.1, 0.1], size=0.1, prior=0.1)[1:] == pytest.approx((0.1 / np.sqrt(2), 0.1))
    assert joined([4.0, 4.0], [0.1, 0.1], focal=0.02)[1:] == pytest.approx((0.1 / np.sqrt(2), 0.02))
    _, sigma, shared = joined([4.0, 4.0], [0.1, 0.1], size=0.05, prior=0.1)
    assert shared == pytest.approx(0.025)
    assert sigma == pytest.approx(np.sqrt((0.1**2 + (4 * 0.05) ** 2 * 0.75) / 2))
    # A camera without an error of its focal length has a larger weight.
    assert joined([4.0, 4.4], [0.1, 0.1], focal=[0.0, 0.1])[0] < 4.1
    # An error that all cameras of a run share does not average out.
    assert joined([4.0, 4.0], [0.1, 0.1], in_run=0.08)[1] == pytest.approx(np.sqrt(0.06**2 / 2 + 0.08**2))
    assert joined([4.0, 4.2], [0.1, 0.105], in_run=[0.1, 0.105])[0] == pytest.approx(4.1, abs=0.01)
    assert joined([4.0, 4.2], [0.1, 0.1], focal=[0.0, 0.5])[0] == pytest.approx(4.0, abs=0.01)
    # If cameras disagree, their difference determines the standard deviation.
    assert joined([3.5, 4.5], [0.1, 0.1])[1] == pytest.approx(0.5)


def test_joint_posteriors_of_simulated_cameras_cover_the_truth():
    rng, prior, pictures = np.random.default_rng(0), 0.1, np.array([0.08, 0.15])
    size = (prior**-2 + pictures**-2) ** -0.5
    errors = []
    for _ in range(400):
        animal = prior * rng.normal()  # relative to the expected size
        measured = animal + pictures * rng.normal(size=2)
        estimated = measured * (size / pictures) ** 2
        values = 4 * (1 + estimated - animal) + rng.normal(0, [0.1, 0.3])
        mean, sigma, shared = joined(values, [0.1, 0.3], size, prior)
        errors.append((mean - 4) / np.hypot(sigma, shared * mean))
    assert 0.86 < np.mean(np.abs(errors) < 1.645) < 0.96


def test_the_cameras_of_a_run_count_once(experiment: Experiment, tables: tuple[pd.DataFrame, pd.DataFrame]):
    clips, _ = tables
    runs = experiment.runs.to_dict("records")
    assert [run["clip"] for run in runs] == ["anna 1", *CLIPS[2:]]
    joined = runs[0]
    assert (joined["clips"], joined["camera"], joined["animal"]) == (2, "left, right", "anna")
    assert clips["speed_m_s"][0] < joined["speed_m_s"] < clips["speed_m_s"][1]
    assert joined["size_sigma"] == 0.05
    assert says(experiment.notes[0], "cameras of 1 run were joined", ": anna 1.", "recon fit")
    assert experiment.variances["runs"].tolist() == [7] * 4
    assert experiment.variances["strides"].tolist() == [28] * 4


# The mixed model


def test_group_effect_with_speed_as_covariate(experiment: Experiment):
    rows = {quantity: {} for quantity in WITH_SIZE}
    for row in experiment.effects.to_dict("records"):
        rows[row["quantity"]][row["effect"]] = row
    length = rows["stride_length_m"]
    assert [*length] == ["mean of control", "mean of treated", "treated - control", "per m/s of speed"]
    difference, slope = length["treated - control"], length["per m/s of speed"]
    assert difference["low"] < 0.2 < difference["high"]
    assert difference["value"] == pytest.approx(0.2, abs=0.08)
    assert slope["value"] == pytest.approx(0.3, abs=0.12)
    assert [difference[name] for name in ("animals", "runs", "clips", "strides")] == [6, 7, 8, 28]
    # The error of the size is 5 % of every value for any number of animals.
    assert length["mean of control"]["sigma"] > length["mean of control"]["shared_sigma"]
    for row in length.values():
        assert row["shared_sigma"] == pytest.approx(0.05 * abs(row["value"]))
    assert [row["shared_sigma"] for row in rows["duty_factor"].values()] == [0] * 4
    assert [*rows["speed_m_s"]] == ["mean of control", "mean of treated", "treated - control"]


def test_inseparable_components_of_variance_are_noted(tables: tuple[pd.DataFrame, pd.DataFrame]):
    clips, strides = tables
    single = clips[clips["clip"].isin(CLIPS[2:])]
    experiment = model_experiment(single, strides.iloc[:0], {"duty_factor": False})
    assert [note.partition(":")[0] for note in experiment.notes] == [
        "Each animal has one run",
        "One value per run of duty factor",
    ]
    (row,) = experiment.variances.to_dict("records")
    assert (row["run_sd"], row["stride_sd"]) == (0, 0)
    few = model_experiment(single.iloc[[0, 3]], strides, {"duty_factor": False})
    assert (few.models, few.notes) == (
        [],
        ["No mixed model of duty factor: 2 animals for 2 groups and covariates; at least 3 are needed."],
    )
    constant = model_experiment(single.assign(age=3.0), strides, {"duty_factor": False}, ["age"])
    assert says(constant.notes[0], "age cannot be separated from the groups")


# Plans


def test_a_plan_gives_the_number_of_animals(experiment: Experiment):
    known = LevelSigmas(0.4, 0.2, 0.2, 0.15)
    text = "effect=10% mean=3 animal=0.4 run=0.2 stride=0.2 measurement=0.15"
    table = plan_experiment(read_plan([text, "runs=1,2 strides=5 cameras=2"]))
    assert table.effect == pytest.approx(0.3)
    assert table.rows["animals"].tolist() == [animals_needed(0.3, known, runs, 5, 2) for runs in (1, 2)]
    assert table.rows["clips"].tolist() == [4 * n * runs for n, runs in zip(table.rows["animals"], (1, 2), strict=True)]
    assert (table.rows["power"] >= 0.8).all()
    given = plan_experiment(read_plan([text, "animals=9 paired=yes runs=2 strides=5 cameras=1"])).rows.iloc[0]
    assert given["power"] == pytest.approx(power(0.3, known, 9, 2, 5, 1, paired=True))
    assert power(given["smallest_effect"], known, 9, 2, 5, 1, paired=True) == pytest.approx(0.8)
    assert smallest_effect(known, 9, 2, 5) > smallest_effect(known, 9, 2, 5, paired=True)
    of_herd = plan_experiment(read_plan(["effect=0.3", "quantity=stride_length_m"]), experiment.variances)
    row = experiment.variances.set_index("quantity").loc["stride_length_m"]
    assert of_herd.sigmas.animal == row["animal_sd"]
    assert of_herd.sigmas.measurement == row["measurement_sd"] > 0


def test_a_wrong_plan_is_refused(experiment: Experiment):
    with refusal(("--plan", "plan", "'effekt=1'", "effect"), ("--plan", "plan", "'x'")):
        read_plan(["effekt=1", "x"])
    with refusal(("--plan", "effect", "nothing")):
        read_plan(["power=0.8"])
    with refusal(("--plan", "power", "'2'"), ("--plan", "runs", "'0'"), ("--plan", "paired", "'perhaps'")):
        read_plan(["effect=1 power=2 runs=0,1 paired=perhaps"])
    with refusal(*(("--plan", level, "nothing") for level in ("animal", "run", "stride", "mean"))):
        plan_experiment(read_plan(["effect=10%"]))
    with refusal(("--plan", "quantity", "weight", "speed_m_s")):
        plan_experiment(read_plan(["effect=1 quantity=weight"]), experiment.variances)


# Command line


def test_the_command_compares_a_herd_and_plans(
    tmp_path: Path, whole_results: Path, design_file: Path, monkeypatch: pytest.MonkeyPatch
):
    use_made_up_numbers(monkeypatch)
    leave_out_drawing(monkeypatch)
    make_herd(tmp_path / "herd", whole_results)
    out = tmp_path / "out"
    ended = run("compare", tmp_path / "herd", "--design", design_file, "--covariate", "speed", "--out", out)
    assert (ended.code, ended.err) == (0, "")
    assert says(ended.out, "7 runs", "treated - control", "intraclass correlation", "which more clips do not reduce")
    effects = pd.read_csv(out / "mixed_model.csv")
    assert (len(effects), len(pd.read_csv(out / "variances.csv"))) == (15, 4)
    assert (out / "runs.parquet").is_file()
    page = (out / "compare.html").read_text(encoding="utf-8")
    assert page.count('<polyline class="pair"') == 4  # the two runs of anna, in four plots
    assert says(page, "thin lines: the same animal", "by the mixed model", "treated - control", "between animals")
    compared = effects[~effects["effect"].str.startswith("mean of ")]
    clear = int(((compared["low"] > 0) | (compared["high"] < 0)).sum())
    assert 0 < page.count("<strong>") == clear < len(effects)
    plan = run("compare", out, "--plan", "effect=10% quantity=stride_length_m", "--json")
    assert [row["animals"] >= 2 for row in json.loads(plan.out)["plan"]["plan"]] == [True] * 8
    assert says(
        run("compare", "--plan", "effect=1 animal=1 run=0 stride=0 animals=9").out, "Smallest effect", "two groups"
    )
    (out / "variances.csv").unlink()  # a comparison without a design has none
    refused(["compare", out, "--plan", "effect=10%"], (out, "variances.csv", "nothing", ["--design", "--names"]))
    refused(["compare"], ("DIR", "folders", "nothing"), ("--out", "folder", "nothing"))
    both = ["compare", out, "--design", design_file, "--names", "{animal}", "--out", tmp_path / "b"]
    refused(both, ("--names", "pattern", "--design as well"))
    refused(["compare", out, "--covariate", "age", "--out", tmp_path / "b"], ("--covariate", "design", "no design"))
