"""Test motion priors: fits to synthetic motion, files of priors, and the command that fits priors."""

from __future__ import annotations

import csv
import json
import shutil
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Refusal, refusal, run, says
from typer.testing import CliRunner

from recon import FitSettings, InputError, PriorFitSettings, run_prior_fit, write_clip
from recon.animal.body import Body
from recon.animal.chain import load_chain
from recon.animal.measured import save_prior
from recon.animal.prior import MotionPrior, builtin_priors, load_prior, mean_speed_m_s, prior_from_body
from recon.animal.prior_fit import (
    ACCELERATION_FLOOR_RAD_S2,
    POSE_FLOOR_RAD,
    RIDGE_PER_ROW,
    as_one_gaussian,
    fit_prior,
    log_likelihood,
)
from recon.animal.skeleton_file import load_skeleton
from recon.api.prior_fit import _sound_states
from recon.cli.app import app
from recon.cli.models import _prior_lines
from recon.fit.motion import Motion
from recon.io.positions import read_pose_segments

pytestmark = pytest.mark.usefixtures("no_playback")

OMEGA_RAD_S = 12.0
SPREAD_RAD = 0.3


def cheetah(subject: str | None = None) -> Body:
    return load_skeleton("cheetah-24", subject)


def swinging(body: Body, n: int, frames: int, fps: float, seed: int = 0) -> list[tuple[str, np.ndarray, float]]:
    """Return n segments of motion in which all angles except the trunk's roll swing about their expected values.

    Amplitudes and phases are random. The animal runs straight, at 1 m/s in the first segment, 2 m/s in the next, etc.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(frames)[:, None] / fps
    still = body.state_names[4:].index("front_trunk_roll")
    segments = []
    for i in range(n):
        amplitude = np.sqrt(2) * SPREAD_RAD * rng.rayleigh(np.sqrt(0.5), len(body.mean_rad))
        amplitude[still] = 0
        angles = body.mean_rad + amplitude * np.sin(OMEGA_RAD_S * t + rng.uniform(0, 2 * np.pi, len(amplitude)))
        position = np.concatenate([(i + 1) * t, 0 * t, 0 * t + 0.7, 0 * t], axis=1)
        segments.append((f"run {i + 1}", np.concatenate([position, angles], axis=1), fps))
    return segments


@pytest.fixture(scope="module")
def body() -> Body:
    return cheetah()


@pytest.fixture(scope="module")
def segments(body: Body) -> list[tuple[str, np.ndarray, float]]:
    return swinging(body, 60, 60, 90.0) + swinging(body, 60, 60, 120.0, seed=1)


@pytest.fixture(scope="module")
def prior(body: Body, segments: list[tuple[str, np.ndarray, float]]) -> MotionPrior:
    return fit_prior(body, segments, name="swing", source="made up", components=3)


def mirrored(body: Body, z: np.ndarray) -> np.ndarray:
    permutation, sign = body.mirror
    return z[..., permutation[4:] - 4] * sign[4:]


def in_both(body: Body, matrix: np.ndarray) -> np.ndarray:
    return mirrored(body, mirrored(body, matrix).T).T


def test_recovers_poses(body, prior):
    np.testing.assert_allclose(prior.mean, body.mean_rad, rtol=0, atol=0.03)
    still = prior.angles.index("front_trunk_roll")
    expected = np.eye(len(prior.mean)) * (SPREAD_RAD**2 + POSE_FLOOR_RAD**2)
    expected[still, still] = 0.15**2 + POSE_FLOOR_RAD**2
    np.testing.assert_allclose(prior.covariance, expected, rtol=0, atol=0.025)
    assert prior.covariance[still, still] == pytest.approx(expected[still, still], abs=1e-12)
    np.testing.assert_allclose(prior.covariances[:, still, still], expected[still, still], rtol=0, atol=1e-12)
    np.testing.assert_allclose(prior.weights @ prior.means, prior.mean, rtol=0, atol=1e-12)
    assert prior.weights.sum() == pytest.approx(1)


def test_recovers_dynamics(prior):
    """The fitted dynamics agree with the dynamics of the swing at two frame rates.

    The acceleration of a swing is minus the square of its frequency times the angle. The ridge, which adds to the unit
    variance of the regressors, reduces it.
    """
    n = len(prior.mean)
    expected = -(OMEGA_RAD_S**2) / (1 + RIDGE_PER_ROW) * np.eye(n)
    still = prior.angles.index("front_trunk_roll")
    expected[still] = 0
    np.testing.assert_allclose(prior.drift[:, :n], expected, rtol=0, atol=0.04 * OMEGA_RAD_S**2)
    np.testing.assert_allclose(prior.drift[:, n:], 0, atol=0.04 * OMEGA_RAD_S)
    assert not prior.drift[still].any()
    assert not prior.drift[:, [still, still + n]].any()
    sigma = np.sqrt(np.diagonal(prior.acceleration_covariance))
    assert sigma[still] == pytest.approx(ACCELERATION_FLOOR_RAD_S2)
    assert sigma.max() < ACCELERATION_FLOOR_RAD_S2 + 0.1 * OMEGA_RAD_S**2 * SPREAD_RAD


def test_segments_set_apart_do_not_affect_the_dynamics(body):
    """Segments that are set apart have no drift, cause none, and have their own noise."""
    rng = np.random.default_rng(0)
    states = np.cumsum(rng.normal(size=(400, body.n_state)) * 0.02, axis=0)
    made = fit_prior(body, [("walk", states, 90.0)], components=1, apart=["tail_1", "tail_2"])
    tail = np.array([name.startswith("tail") for name in made.angles])
    assert not made.drift[tail].any()
    assert not made.drift[:, np.tile(tail, 2)].any()
    assert not made.acceleration_covariance[np.ix_(tail, ~tail)].any()
    assert made.drift[np.ix_(~tail, np.tile(~tail, 2))].any()


def test_refuses_unknown_segments_to_set_apart(body):
    with refusal(("prior", "apart", "'wing'")):
        fit_prior(body, [("walk", np.zeros((400, body.n_state)), 90.0)], components=1, apart=["wing"])


def test_is_its_own_mirror_image(body, prior):
    n = len(prior.mean)
    np.testing.assert_allclose(mirrored(body, prior.mean), prior.mean, rtol=0, atol=1e-12)
    for matrix in (
        prior.covariance,
        prior.acceleration_covariance,
        prior.drift[:, :n],
        prior.drift[:, n:],
    ):
        np.testing.assert_allclose(in_both(body, matrix), matrix, rtol=0, atol=1e-9 * np.abs(matrix).max())


def test_two_kinds_of_pose_are_two_components(body):
    from scipy.stats import multivariate_normal  # slow to import

    rng = np.random.default_rng(3)
    at = np.where(np.arange(600) < 200, -0.8, 0.8)[:, None]
    symmetric = body.mirror[1][4:] > 0  # a shift of all of these is its own mirror image
    states = np.zeros((600, body.n_state))
    states[:, 4:] = at * symmetric + rng.normal(0, 0.1, (600, body.n_state - 4))
    prior = fit_prior(body, [("a", states, 100.0)], components=2, shrink=0.0)
    few, many = np.argsort(prior.weights)
    np.testing.assert_allclose(prior.weights[[few, many]], [1 / 3, 2 / 3], rtol=0, atol=1e-6)
    np.testing.assert_allclose(prior.means[few], -0.8 * symmetric, rtol=0, atol=0.03)
    np.testing.assert_allclose(prior.means[many], 0.8 * symmetric, rtol=0, atol=0.03)
    np.testing.assert_allclose(prior.covariances[many], np.eye(24) * (0.1**2 + POSE_FLOOR_RAD**2), rtol=0, atol=3e-3)
    parts = zip(prior.weights, prior.means, prior.covariances, strict=True)
    density = sum(w * multivariate_normal(m, c).pdf(states[:, 4:]) for w, m, c in parts)
    assert log_likelihood(prior, states) == pytest.approx(np.log(density).mean())
    assert log_likelihood(prior, states) > log_likelihood(as_one_gaussian(prior), states) + 2


def test_repeated_poses_leave_components_empty(body):
    """If there are fewer different poses than components, some components stay empty."""
    states = np.zeros((100, body.n_state))
    states[50:, 4:] = 0.3
    prior = fit_prior(body, [("a", states, 100.0)], components=5)
    assert log_likelihood(prior, states) == pytest.approx(log_likelihood(prior, states[:50]), abs=1)
    still = fit_prior(body, [("a", np.zeros((100, body.n_state)), 100.0)], components=2)
    np.testing.assert_array_equal(still.means, 0)


def test_same_input_same_prior(body, segments, prior):
    again = fit_prior(body, segments, components=3)
    for field in ("weights", "means", "covariances", "drift"):
        np.testing.assert_array_equal(getattr(again, field), getattr(prior, field))


def test_slow_segments_and_missing_frames(body):
    segments = swinging(body, 4, 40, 100.0)
    for _, states, _ in segments:
        states[10] = np.nan
    prior = fit_prior(body, segments, components=1, min_speed_m_s=2.5)
    assert [(row.name, row.frames, row.fps, row.used) for row in prior.segments] == [
        *((f"run {i}", 40, 100.0, False) for i in (1, 2)),
        *((f"run {i}", 40, 100.0, True) for i in (3, 4)),
    ]
    assert [row.speed_m_s for row in prior.segments] == pytest.approx([1, 2, 3, 4])
    poses = np.concatenate([states[np.isfinite(states[:, 4]), 4:] for _, states, _ in segments[2:]])
    np.testing.assert_allclose(prior.mean, (poses.mean(axis=0) + mirrored(body, poses).mean(axis=0)) / 2, atol=1e-12)
    assert mean_speed_m_s(np.full((5, body.n_state), np.nan), 100.0) == 0


def test_too_few_frames_are_refused(body):
    with refusal(("prior", "components", "6 components for 100 frames", ["20 frames", "at most 5"])):
        fit_prior(body, swinging(body, 1, 100, 100.0), components=6)
    ((name, states, fps),) = swinging(body, 1, 100, 100.0)
    states[::2] = np.nan
    no_three = ("prior", "frames", "three consecutive")
    with refusal(("prior", "components", 6, "20 frames"), no_three):
        fit_prior(body, [(name, states, fps)], components=6)
    with refusal(("prior", "components", "1 component for 0 frames"), no_three):
        fit_prior(body, [], components=1)


def test_prior_from_body(body):
    from scipy.stats import multivariate_normal  # slow to import

    prior = prior_from_body(body)
    states = swinging(body, 1, 30, 100.0)[0][1]
    expected = multivariate_normal(body.mean_rad, np.diag(body.sigma_rad**2)).logpdf(states[:, 4:]).mean()
    assert log_likelihood(prior, states) == pytest.approx(expected)
    assert load_prior("none", body).name == prior.name == "none"
    np.testing.assert_allclose(np.diagonal(prior.acceleration_covariance), body.acceleration_rad_s2**2)
    assert not prior.drift.any()


# Files


def test_round_trip(body, prior, tmp_path):
    save_prior(prior, tmp_path / "made" / "swing.npz")
    assert [p.name for p in (tmp_path / "made").iterdir()] == ["swing.npz"]
    again = load_prior(tmp_path / "made" / "swing.npz", cheetah("phantom"))
    assert (again.name, again.source, again.angles, again.segments) == (
        "swing",
        "made up",
        body.state_names[4:],
        prior.segments,
    )
    for field in ("weights", "means", "covariances", "mean", "covariance", "drift", "acceleration_covariance"):
        np.testing.assert_allclose(getattr(again, field), getattr(prior, field), rtol=1e-6, atol=1e-5)


BODIES = {"running-cheetah": "cheetah-24"}


@pytest.mark.parametrize("name", builtin_priors())
def test_builtin(name):
    body = load_skeleton(BODIES[name])
    prior = load_prior(name, body)
    assert prior.name == name
    assert prior.source
    np.testing.assert_allclose(mirrored(body, prior.mean), prior.mean, rtol=0, atol=1e-6)
    np.testing.assert_allclose(prior.weights @ prior.means, prior.mean, rtol=0, atol=1e-5)
    assert np.linalg.eigvalsh(prior.covariances).min() > 0.9 * POSE_FLOOR_RAD**2
    assert np.linalg.eigvalsh(prior.acceleration_covariance).min() > 0.9 * ACCELERATION_FLOOR_RAD_S2**2
    assert (Path(__file__).parents[2] / "recon" / "animal" / "priors" / f"{name}.npz").stat().st_size < 300_000
    chain = load_chain("cheetah-8u").body
    with pytest.raises(InputError) as error:
        load_prior(name, chain)
    (problem,) = error.value.problems
    assert (problem.file, problem.field) == (f"prior {name}", "angles")
    assert "missing" in problem.found
    assert problem.expected == f"the {len(chain.mean_rad)} angles of cheetah-8u, in its order"


def test_running_cheetah_agrees_with_its_page(body):
    page = (Path(__file__).parents[2] / "docs" / "priors.md").read_text(encoding="utf-8")
    prior = load_prior("running-cheetah", body)
    used = [row for row in prior.segments if row.used]
    speeds = sorted(row.speed_m_s for row in used)
    assert (len(used), len(prior.segments)) == (11, 15)
    assert {row.fps for row in used} == {90, 120}
    assert f"Eleven of fifteen segments were used, {sum(row.frames for row in used):,} frames at 90 and 120 fps" in page
    assert f"with speeds from {speeds[0]:.1f} to {speeds[-1]:.1f} m/s" in page


@pytest.mark.slow
def test_running_cheetah_can_be_reproduced(shared_data, body, tmp_path):
    folder = shared_data / "cheetah-poses"
    if not folder.is_dir():
        pytest.skip(f"no {folder}")
    made = run_prior_fit(
        PriorFitSettings(
            poses=[folder / "training_positions.csv"],
            out=tmp_path / "running-cheetah.npz",
            skeleton="cheetah-24",
            fps=str(folder / "segments.json"),
            subject="phantom",
            min_speed_m_s=8.5,
            apart=["tail_1", "tail_2"],
        )
    )
    assert max(row["misfit_mm"] for row in made["segments"]) < 1
    prior = load_prior(tmp_path / "running-cheetah.npz", body)
    shipped = load_prior("running-cheetah", body)
    for field in ("mean", "covariance", "acceleration_covariance"):
        np.testing.assert_allclose(getattr(prior, field), getattr(shipped, field), rtol=1e-3, atol=1e-3)
    assert len(shipped.weights) == len(prior.weights)


def altered(prior: MotionPrior, path: Path, changes: dict) -> Path:
    """Write the file of a prior with some arrays, or some texts in `about`, replaced or, for None, left out."""
    save_prior(prior, path)
    with np.load(path) as file:
        stored = {key: file[key] for key in file.files}
    about = json.loads(str(stored["about"]))
    for key, value in changes.items():
        if key in about:
            about[key] = value
        else:
            stored[key] = value
    if "about" not in changes:
        stored["about"] = np.array(json.dumps(about))
    np.savez(path, **{key: value for key, value in stored.items() if value is not None})
    return path


NOT_DEFINITE = np.eye(24) - 2 * np.eye(24, k=0) * (np.arange(24) == 5)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"mean": None, "drift": None}, [("mean", "nothing"), ("drift", "nothing")]),
        ({"covariance": NOT_DEFINITE}, [("covariance", "not positive definite")]),
        ({"covariance": np.eye(24) + 0.1 * np.eye(24, k=1)}, [("covariance", "not positive")]),
        ({"mean": np.full(24, np.nan)}, [("mean", "not finite")]),
        ({"mean": np.full(24, 1e300)}, [("mean", "impossibly large")]),
        ({"weights": np.ones(3)}, [("weights", ["from 1", "add up to 3"])]),
        (
            {"means": np.zeros((2, 24)), "drift": np.zeros((24, 24))},
            [("means", "(2, 24)", "(3, 24)"), ("drift", "(24, 24)", "(24, 48)")],
        ),
        ({"mean": np.array(["a"] * 24)}, [("mean", "<U1")]),
        ({"about": np.array("{")}, [("content", "property name")]),
        ({"format": 7}, [("format", 7, 1)]),
        ({"angles": "head_yaw", "source": 3}, [("source", 3), ("angles", "'head_yaw'")]),
        ({"segments": [{"name": "a"}]}, [(f"segments[0].{name}",) for name in ("frames", "fps", "speed_m_s", "used")]),
        ({"angles": ["wing"]}, [("angles", ["1 angles", "24 missing (rear_trunk_pitch", "1 of another body (wing)"])]),
        ({"angles": [*cheetah().state_names[:3:-1]]}, [("angles", ["24 angles", "another order"])]),
    ],
)
def test_wrong_files(body, prior, tmp_path, changes, expected):
    path = altered(prior, tmp_path / "swing.npz", changes)
    with refusal(*((path, *one) for one in expected)):
        load_prior(path, body)


@pytest.mark.parametrize("content", [b"nothing", b"PK\x03\x04 cut off"])
def test_a_file_without_a_prior_is_refused(body, tmp_path, content):
    path = tmp_path / "x.npz"
    path.write_bytes(content)
    with refusal((path, "file", "data that cannot be read", "motion prior")):
        load_prior(path, body)


def test_an_unknown_prior_name_is_refused(body):
    with refusal(("--prior", "name or file", "'galop'", "running-cheetah")):
        load_prior("galop", body)


def test_pickles_are_refused(body, prior, tmp_path):
    with refusal((tmp_path / "x.npz", "file", "array of object")):
        load_prior(altered(prior, tmp_path / "x.npz", {"mean": np.array([{}] * 24)}), body)


def test_arrays_written_by_python_2_are_read(body, prior, tmp_path):
    """Arrays that Python 2 wrote, with shapes of long integers, are read."""
    save_prior(prior, tmp_path / "x.npz")
    with zipfile.ZipFile(tmp_path / "x.npz") as now, zipfile.ZipFile(tmp_path / "then.npz", "w") as then:
        for name in now.namelist():
            then.writestr(name, now.read(name).replace(b"'shape': (24,), } ", b"'shape': (24L,), }"))
    assert b"(24L,)" in (tmp_path / "then.npz").read_bytes()
    means = (load_prior(tmp_path / name, body).mean for name in ("x.npz", "then.npz"))
    np.testing.assert_array_equal(*means)


def test_arrays_of_a_prior_must_fit_together(prior):
    with pytest.raises(ValueError, match=r"weights: .*; mean: shape \(3,\), expected \(24,\)"):
        replace(prior, weights=2 * prior.weights, mean=np.zeros(3))


# The command


def pose_csv(path: Path, body: Body, states: np.ndarray, frames: np.ndarray, without: tuple[str, ...] = ()) -> Path:
    keep = [j for j, name in enumerate(body.markers) if name not in without]
    names = [body.markers[j] for j in keep]
    points = body.tree.pose(states, 1.2).points_m[:, keep]
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["bodyparts", *(name for name in names for _ in "xyz"), *["extra"] * 3])
        writer.writerow(["coords", *("xyz" * len(names)), *"xyz"])
        for frame, row in zip(frames, points, strict=True):
            writer.writerow([frame, *row.ravel(), 0, 0, 0])
    return path


def test_command(body, tmp_path):
    (_, a, _), (_, b, _) = swinging(body, 2, 60, 100.0)
    frames = np.arange(60)
    first = pose_csv(tmp_path / "a.csv", body, a, frames)
    second = pose_csv(tmp_path / "b.csv", body, b, np.where(frames < 30, frames, frames + 10), without=("nose",))
    (tmp_path / "fps.json").write_text('{"fps": [100, 100.0]}')
    out = tmp_path / "swing.npz"
    options = ["--fps", tmp_path / "fps.json", "--components", 2, "--min-speed-m-s", 1.5, "--source", "made up"]
    arguments = [first, second, "--skeleton", "cheetah-24", "--out", out, "--estimate-size", "--check", *options]
    done = CliRunner().invoke(app, ["prior", "fit", *map(str, arguments)])
    assert done.exit_code == 0, done.output
    rows = [line.split() for line in done.output.splitlines()]
    (row,) = (row for row in rows if row[:1] == ["a"])
    assert row[1:4] + row[5:] == ["60", "100", "1.0", "no"]
    assert float(row[4]) < 1
    for start in ("0", "40"):
        assert any(row[:6] == ["b", "from", start, "30", "100", "2.0"] and row[-1] == "yes" for row in rows)
    assert says(done.output, "2 of 3 segments, 60 frames", "mirror images", "1.200 times")
    assert "with 1 components" in done.output
    prior = load_prior(out, body)
    assert (prior.name, prior.source) == ("swing", "made up")
    expected = (b[:, 4:] + mirrored(body, b[:, 4:])).mean(axis=0) / 2
    np.testing.assert_allclose(prior.mean, expected, rtol=0, atol=0.01)


@pytest.mark.slow
def test_files_of_equal_names_and_too_few_frames_are_refused(body, tmp_path):
    files = []
    for k, (_, states, _) in enumerate(swinging(body, 2, 40, 100.0)):
        (tmp_path / f"run{k}").mkdir()
        files.append(pose_csv(tmp_path / f"run{k}" / "truth.csv", body, states, np.arange(40)))
    done = run_prior_fit(PriorFitSettings(poses=files, out=tmp_path / "a.npz", skeleton="cheetah-24", fps="100"))
    assert [row["name"] for row in done["segments"]] == ["run0-truth", "run1-truth"]
    assert (done["components"], done["components_asked"]) == (4, 16)
    assert any(says(note, "4 components", 16, "20 frames") for note in _prior_lines(done) if isinstance(note, str))
    few = run_prior_fit(
        PriorFitSettings(poses=files, out=tmp_path / "b.npz", skeleton="cheetah-24", fps="100", components=4)
    )
    assert not [note for note in _prior_lines(few) if isinstance(note, str) and "instead of" in note]


def test_every_problem_of_the_command_is_listed(body, tmp_path):
    states = swinging(body, 1, 5, 100.0)[0][1]
    few = pose_csv(tmp_path / "few.csv", body, states, np.arange(5), without=body.markers[5:])
    (tmp_path / "there.npz").touch()

    def refuses(*expected: Refusal, **more: Any) -> None:
        given = {"poses": [few], "out": tmp_path / "x.npz", "skeleton": "cheetah-24"} | more
        with refusal(*expected):
            run_prior_fit(PriorFitSettings(**given))

    refuses(
        ("--skeleton", "name or file", "cheetah-8u"),
        (tmp_path / "no.csv", "file", "no such file"),
        ("--fps", "frame rate", "'fast'"),
        (tmp_path / "there.npz", "file", "did not write", "moved away"),
        poses=[tmp_path / "no.csv", few],
        out=tmp_path / "there.npz",
        skeleton="cheetah-8u",
        fps="fast",
    )
    refuses(("settings", "components", 0, "greater than 0"), components=0)
    rates = tmp_path / "fps.json"
    joints = (few, "joints", ["5 of 24", "nose, l_eye, r_eye, neck_base, spine, extra"])
    rates.write_text("[90, 120]")
    refuses((rates, "frame rate", f"'{rates}'", "JSON"), fps=str(rates))
    rates.write_text('{"fps": [90, 120]}')
    refuses(joints, (rates, "fps", "2 frame rates"), fps=str(rates))
    for fps in ("0", "-3", "nan", "inf"):
        refuses(("--fps", "frame rate", f"'{fps}'"), fps=fps)
    refuses(("--out", "file", tmp_path / "x.txt", "ends in .npz"), out=tmp_path / "x.txt", fps="90")
    assert not (tmp_path / "x.npz").exists()


def test_results(whole_results, body, tmp_path):
    """Two folders of results provide the skeleton, the frame rate and the names, and flagged frames are left out."""
    for name in ("run1", "run2"):
        shutil.copytree(whole_results, tmp_path / name)
    ended = run("prior", "fit", tmp_path / "run1", tmp_path / "run2", "--out", tmp_path / "x.npz", "--json")
    assert ended.code == 0, ended.err
    said = json.loads(ended.out)
    assert [(row["name"], row["fps"], row["misfit_mm"]) for row in said["segments"]] == [
        ("run1", 60.0, None),
        ("run2", 60.0, None),
    ]
    found = Motion.load(whole_results)
    with (whole_results / "quality.csv").open(newline="") as file:
        flags = [row["flags"] for row in csv.DictReader(file)]
    assert [";".join(one) for one in found.flags] == flags
    sound = np.array([not one for one in flags])
    assert (said["frames"], said["left_out"]) == (2 * sound.sum(), 2 * (~sound).sum())
    z = found.states[sound, 4:]
    expected = (z.mean(axis=0) + mirrored(body, z).mean(axis=0)) / 2
    np.testing.assert_allclose(load_prior(tmp_path / "x.npz", body).mean, expected, rtol=0, atol=1e-5)


def test_flagged_frames_and_those_without_a_pose_are_left_out(small_trajectory, tmp_path):
    states = small_trajectory.solution.states.copy()
    states[0] = np.nan
    motion = replace(small_trajectory, solution=replace(small_trajectory.solution, states=states))
    settings = FitSettings(keypoints=(Path("run.csv"),), hfov_deg=64, image_size_px=(1920, 1080), fps=30)
    write_clip(motion, settings, tmp_path)
    sound = _sound_states(Motion.load(tmp_path))
    left_out = np.isnan(sound).all(axis=1)
    np.testing.assert_array_equal(left_out, [True, False, False, True, False, True, False, False])
    np.testing.assert_allclose(sound[~left_out], states[~left_out])


@pytest.mark.slow
def test_results_and_pose_files_together(whole_results, body, tmp_path):
    states = swinging(body, 1, 30, 100.0)[0][1]
    file = pose_csv(tmp_path / "a.csv", body, states, np.arange(30))
    done = run_prior_fit(
        PriorFitSettings(poses=[file, whole_results], out=tmp_path / "x.npz", skeleton=None, fps="100")
    )
    assert [(row["name"], row["fps"]) for row in done["segments"]] == [(whole_results.name, 60.0), ("a", 100.0)]
    assert done["segments"][1]["misfit_mm"] > 20  # an animal that is larger than the skeleton
    sized = run_prior_fit(
        PriorFitSettings(
            poses=[file, whole_results], out=tmp_path / "y.npz", skeleton="cheetah-24", fps="100", estimate_size=True
        )
    )
    assert sized["segments"][1]["misfit_mm"] < 1
    assert sized["segments"][0]["misfit_mm"] is None


def test_options_that_contradict_results_are_refused(whole_results, frame_results, body, tmp_path):
    file = pose_csv(tmp_path / "a.csv", body, swinging(body, 1, 30, 100.0)[0][1], np.arange(30))
    no_skeleton, other = ("--skeleton", "name or file", "nothing"), f"--skeleton: dog-27, {whole_results}: cheetah-24"
    for poses, more, *expected in (
        ([whole_results], {"skeleton": "dog-27"}, ("POSES", "skeleton", other)),
        ([whole_results, frame_results], {}, (frame_results, "skeleton", "cheetah-8u")),
        ([whole_results], {"fps": "60"}, ("--fps", "frame rate", 60, "nothing")),
        ([whole_results], {"subject": "phantom"}, no_skeleton),
        ([file], {}, no_skeleton, ("--fps", "frame rate", "nothing")),
        ([tmp_path], {}, (tmp_path, "folder", "no motion.npz")),
    ):
        with refusal(*expected):
            run_prior_fit(PriorFitSettings(poses=poses, out=tmp_path / "x.npz", **more))
    assert not (tmp_path / "x.npz").exists()


SEGMENTS = "segment,frame,nose,nose,nose\n,,x,y,z\n0,5,1,2,3\n0,6,4,5,\nb,5,7,8,9\n"


def test_pose_segments(tmp_path):
    path = tmp_path / "two.csv"
    path.write_text(SEGMENTS)
    found = read_pose_segments(path)
    assert list(found) == ["0", "b"]
    assert found["0"].names == ("nose",)
    np.testing.assert_array_equal(found["0"].frames, [5, 6])
    np.testing.assert_array_equal(found["0"].xyz_m, [[[1, 2, 3]], [[4, 5, np.nan]]])
    np.testing.assert_array_equal(found["b"].xyz_m, [[[7, 8, 9]]])


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("0,6,4", "0,5,4", [("frames", "5 after 5")]),
        ("0,6,4,5,", "0,6,4", [("line 4", "2 cells", 4)]),
        ("7,8,9", "seven,8,inf", [("line 5, nose/x", "'seven'"), ("line 5, nose/z", "'inf'")]),
        ("0,5,1", "0,5.5,1", [("row 1 below the header", "'5.5'")]),
        (",,x,y,z", ",,x,y,likelihood", [("line 2", "no z")]),
        (",,x,y,z\n0,5,1,2,3", ",,x\n0,5,1,two,3", [("line 2", "3 cells", 5)]),
        (",,x,y,z", ",,x,y,y", [("bodypart nose", "several columns y with different numbers")]),
        (SEGMENTS, "segment,frame,nose,nose,nose\n,,x,y,z\n", [("rows", "no frames")]),
        (SEGMENTS, "segment,frame,nose\n", [("line 2", "0 cells")]),
    ],
)
def test_pose_segments_problems(tmp_path, old, new, expected):
    path = tmp_path / "two.csv"
    path.write_text(SEGMENTS.replace(old, new))
    with refusal(*((path, *one) for one in expected)):
        read_pose_segments(path)
