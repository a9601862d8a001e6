"""Test which libraries a command imports, so that none waits for a library that it does not need."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from pathlib import Path
from shutil import copytree

import pytest

import recon

ROOT = Path(__file__).resolve().parents[2]
SLOW = {"numpy", "pandas", "scipy", "cv2", "rerun", "pyarrow", "torch", "matplotlib", "h5py", "tables"}


EVERY_COMMAND = """
import json, sys
from recon.cli.app import COMMANDS
first_command = {}
for commands in COMMANDS.values():
    for name, (function, _) in commands.items():
        function()
        for module in list(sys.modules):
            first_command.setdefault(module, name)
print(json.dumps(first_command))
"""
"""Program that imports the function of every command, and prints which command first imports each module."""


def imported_by(*args: object, what: tuple[str, ...] = ("-m", "recon")) -> set[str]:
    """Return the modules that `recon ARGS`, or `python WHAT ARGS`, imports."""
    command = [sys.executable, "-X", "importtime", *what, *map(str, args)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    return set(re.findall(r"^import time:.*\| +(\S+)$", done.stderr, re.MULTILINE))


@pytest.mark.parametrize("option", ["--help", pytest.param("--version", marks=pytest.mark.slow)])
def test_help_and_version_import_no_slow_library(option):
    modules = imported_by(option)
    assert "typer" in modules
    assert modules & SLOW == set()


def test_no_command_imports_a_slow_library_for_its_help():
    done = subprocess.run([sys.executable, "-c", EVERY_COMMAND], capture_output=True, text=True, check=True)
    first_command = json.loads(done.stdout)
    assert {"recon.cli.fit", "recon.cli.doctor"} <= {*first_command}
    assert {module: name for module, name in first_command.items() if module in SLOW - {"numpy"}} == {}


@pytest.mark.slow
def test_help_of_report_imports_as_little_as_help_of_fit():
    fit, report = (imported_by(command, "--help") for command in ("fit", "report"))
    assert report - fit == {"recon.cli.look_options", "recon.cli.show"}


@pytest.mark.slow
def test_a_fit_imports_only_the_libraries_that_it_uses(tmp_path):
    samples = ROOT / "data" / "samples"
    fit = (
        "fit",
        samples / "whole.csv",
        "--camera",
        samples / "camera.toml",
        "--fps",
        60,
        "--frames",
        "0:8",
        "--set",
        "fast=true",
    )
    modules = imported_by(*fit, "--out", tmp_path)
    assert (tmp_path / "motion.rrd").is_file()
    assert {"numpy", "rerun"} <= modules
    of_other_clips = {"recon.io.hdf5_poses", "recon.io.camera_track", "recon.check.agreement", "recon.check.sights"}
    unused = {
        *of_other_clips,
        "recon.animal.chain",
        "recon.gait.evaluation",
        "scipy.interpolate",
        "scipy.optimize",
        "scipy.spatial",
        "recon.api.batch",
        "scipy.ndimage",
        "urllib.request",
        "h5py",
        "cv2",
        "torch",
        "matplotlib",
        "tables",
    }
    assert modules & unused == set()


@pytest.mark.slow
@pytest.mark.parametrize(("command", "made"), [("report", "report.html"), ("analyse", "analysis/analysis.json")])
def test_a_page_and_an_analysis_import_no_pandas(tmp_path, whole_results, command, made):
    modules = imported_by(command, copytree(whole_results, tmp_path / "results"))
    assert (tmp_path / "results" / made).is_file()
    assert "matplotlib" in modules
    assert "pandas" not in modules


@pytest.mark.slow
def test_a_batch_worker_imports_only_the_libraries_that_it_uses():
    modules = imported_by(what=("-c", "import recon.api.batch"))
    assert "recon.api.clip" in modules
    unused = {"recon.show.plots", "recon.keypoint_net", "cv2", "torch", "matplotlib"}
    assert modules & unused == set()


def test_public_names_come_from_the_modules_in_the_stub():
    """Public names come from the modules in which editors look for them.

    The imports that type checkers see run on first use, and define `from recon import *`.
    """
    tree = ast.parse((ROOT / "recon" / "__init__.pyi").read_text(encoding="utf-8"))
    seen = {alias.name: node.module for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert sorted(seen) == recon.__all__
    for name, module in seen.items():
        assert getattr(recon, name) is getattr(sys.modules[f"recon.{module}"], name)
    assert {*recon.__all__} <= {*dir(recon)}
    star: dict[str, object] = {}
    exec("from recon import *", star)
    assert {*seen} <= {*star}
    with pytest.raises(AttributeError, match="No recon attribute nothing"):
        _ = recon.nothing  # pyright: ignore[reportAttributeAccessIssue]
