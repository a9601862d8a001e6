"""Test each step of docs/how-to/new-species.md with a simulated animal, and the gain for one camera."""

from __future__ import annotations

import json
import re
import runpy
import shlex
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from command_line import run
from docs_files import DOCS, blocks, cat_file, commands
from shortcuts import leave_out_playback

from recon import Evaluation, evaluate_files, load_skeleton

pytestmark = pytest.mark.slow
"""All tests are slow, because they need several fits; `test_subject.py` and `test_prior.py` test the commands."""

PAGE = DOCS / "how-to" / "new-species.md"
STEPS = [block for block in blocks(PAGE) if block.language == "sh"][1:]  # the first block is the simulation
LINKS = {
    "neck": 1.1 * 0.14,
    "l_fore_lower": 0.85 * 0.1,
    "l_fore_foot": 0.85 * 0.1,
    "l_hind_shin": 0.9 * 0.11,
    "l_hind_foot": 0.9 * 0.11,
}
"""True lengths of the simulated cat's neck and leg segments, m."""


@pytest.fixture(scope="session")
def after(tmp_path_factory: pytest.TempPathFactory) -> Callable[[int], Path]:
    """Return a function `after(n)`, which returns a folder after at least the first n steps of the page."""
    folder = tmp_path_factory.mktemp("new-species")
    cat_file(folder / "my-cat.toml")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        runpy.run_path(str(DOCS / "simulated_cat.py"))
    left = list(STEPS)

    def done(n: int) -> Path:
        with pytest.MonkeyPatch.context() as patch:
            patch.chdir(folder)
            leave_out_playback(patch)
            while len(STEPS) - len(left) < n:
                for command in commands(left.pop(0)):
                    ended = run(*shlex.split(command)[1:])
                    assert (ended.code, ended.err) == (0, ""), f"{command}\n{ended.out}{ended.err}"
        return folder

    return done


def errors(folder: Path, results: str, number: int) -> Evaluation:
    return evaluate_files(folder / results, folder / f"run{number}_truth.csv")


def test_two_cameras_find_lengths_of_each_run(after):
    for n in (1, 2, 3):
        assert 0.006 < errors(after(1), f"results/run{n}", n).mpjpe_m.mean < 0.012


def test_the_lengths_are_found(after):
    cat, file = (load_skeleton(after(2) / "my-cat.toml", of) for of in (after(2) / "tom.toml", None))
    for name, length_m in LINKS.items():
        found, guess = (
            next(np.linalg.norm(x.offset_m) for x in (*b.tree.segments, *b.tree.markers) if x.name == name)
            for b in (cat, file)
        )
        assert found == pytest.approx(length_m, rel=0.035), name
        assert abs(found - length_m) < 0.5 * abs(guess - length_m), name
    assert cat.size_sigma == pytest.approx(0.01, abs=0.005)


def test_lengths_improve_the_poses(after):
    for n in (1, 2, 3):
        assert errors(after(3), f"tom/run{n}", n).mpjpe_m.mean < 0.009


def test_prior_describes_other_runs(after):
    """Under a prior from the other runs, a mixture fits each run better than a Gaussian."""
    runs = [f"tom/run{n}" for n in (1, 2, 3)]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(after(4))
        said = json.loads(run("prior", "fit", *runs, "--out", "again.npz", "--check", "--json", "--overwrite").out)
    assert [row["name"] for row in said["segments"]] == ["run1", "run2", "run3"]
    assert said["components"] == 6
    assert said["held_out"]["mixture"] > said["held_out"]["one_gaussian"] + 0.5


def test_one_camera_is_enough_afterwards(after):
    """One camera has the errors that the page states, and the subject and the prior reduce them."""
    rows = re.findall(r"^\| (?:the .*) \| ([\d.]+) \| ([\d.]+) \|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    scores = [errors(after(5), f"one/{name}", 4) for name in ("file", "lengths", "both")]
    found = [(1e3 * score.mpjpe_m.mean, 1e3 * score.mpe_m.mean) for score in scores]
    np.testing.assert_allclose(found, np.array(rows, dtype=float), rtol=0.05)
    (file, file_place), (lengths, lengths_place), (both, both_place) = found
    assert both < lengths < file / 2
    assert both_place < 0.7 * lengths_place < 0.5 * file_place
    assert both < 9
