"""Test `recon doctor`, and what all commands share: JSON for every table, colours, shell completion."""

from __future__ import annotations

import io
import json
import re
import shutil
import subprocess
import sys
import tempfile
from contextlib import redirect_stdout
from importlib import metadata
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import run, run_process, says

import recon.cli.doctor as module
from recon.base.package import install_command, pip_command
from recon.cli.app import COMMANDS, GROUPS, app
from recon.cli.doctor import _Check, packages, run_doctor, self_test, versions, viewer

pytestmark = pytest.mark.usefixtures("no_playback")

SAMPLES = Path(__file__).parents[2] / "data" / "samples"


def statuses(checks) -> dict[str, str]:
    return {check.name: check.status for check in checks}


@pytest.fixture(scope="module")
def doctor() -> tuple[_Check, ...]:
    """Return the checks of this machine, in which the demo makes no page."""
    without = "import recon.cli.demo as it; it.report = lambda *_: it.Answer({'page': None}); "
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_MODULE", without + module._MODULE)
        return run_doctor()


# recon doctor


@pytest.mark.slow
def test_no_check_of_this_machine_is_broken(doctor, monkeypatch):
    assert [check for check in doctor if check.status == "broken"] == []
    found = {check.name: check.state for check in doctor}
    assert f"numpy {metadata.version('numpy')}, opencv" in found["packages"]
    assert found["recon"].startswith(metadata.version("recon-motion"))
    assert found["python"].startswith(".".join(map(str, sys.version_info[:3])))
    assert found["viewer"] == f"rerun-cli {metadata.version('rerun-sdk')}"
    frames, mm = re.fullmatch(
        r"(.*) frames in [\d.]+ s, (\d+) mm from the truth \(MPJPE\)", found["fit of the sample"]
    ).groups()
    assert frames == "60 of 60"
    assert int(mm) < 60


def test_prints_a_table_of_80_columns_or_json_and_ends_with_0_or_1(monkeypatch):
    """The command prints a table of 80 columns or JSON, and ends with 0 or 1. Slow checks are replaced."""
    doctor = (*versions(), *packages(), _Check("viewer", "ok", "rerun-cli 0.1"))
    monkeypatch.setattr("recon.cli.doctor.run_doctor", lambda progress: doctor)
    ended = run("doctor")
    assert ended.code == 0
    assert ended.out.endswith("recon works here.\n")
    assert max(map(len, ended.out.splitlines())) <= 80
    for check in doctor:
        assert re.search(rf"^ *{re.escape(check.name)} +{check.status} ", ended.out, re.MULTILINE)
    shown = json.loads(run("doctor", "--json").out)
    assert shown == {"ok": True, "checks": [check.to_dict() for check in doctor]}
    bad = (*doctor, _Check("moon", "broken", "it is new", "wait [two] weeks"))
    monkeypatch.setattr("recon.cli.doctor.run_doctor", lambda progress: bad)
    ended = run("doctor")
    assert ended.code == 1
    assert "wait [two] weeks" in ended.out
    assert ended.out.endswith("Broken: moon\n")
    ended = run("doctor", "--json")
    assert (ended.code, json.loads(ended.out)["ok"]) == (1, False)


def test_versions_that_are_too_old_or_missing_are_broken():
    (found,) = packages(["numpy>=1.2", "scipy>=999", "no-such-thing>=2.5", "rich; extra == 'dev'"])
    assert found.status == "broken"
    assert found.state == f"scipy {metadata.version('scipy')}, not >=999, no-such-thing not installed"
    assert found.hint == f"{pip_command()} install 'scipy>=999' 'no-such-thing>=2.5'"
    (found,) = packages(["numpy>=1.2", "no-such-thing; python_version < '3'"])
    assert (found.status, found.state) == ("ok", f"numpy {metadata.version('numpy')}")


def test_a_module_from_another_distribution_is_accepted(monkeypatch):
    """opencv-python is accepted instead of opencv-python-headless, because it has the same module."""
    real = metadata.version

    def version(name: str) -> str:
        if name == "opencv-python-headless":
            raise metadata.PackageNotFoundError(name)
        return "4.12.0" if name == "opencv-python" else real(name)

    monkeypatch.setattr(metadata, "version", version)
    monkeypatch.setattr(metadata, "packages_distributions", lambda: {"cv2": ["opencv-python"]})
    assert statuses(packages(["opencv-python-headless>=4.9"])) == {"packages": "ok"}


def test_another_package_named_recon_is_reported(monkeypatch):
    """Another project's package `recon`, which has files of the same names, is reported as broken."""
    assert "another recon" not in {check.name for check in versions()}
    real = metadata.version
    monkeypatch.setattr(metadata, "version", lambda name: "3.1" if name == "recon" else real(name))
    found = {check.name: check for check in versions()}["another recon"]
    assert found.status == "broken"
    assert says(found.state, "recon 3.1")
    assert says(found.hint, "pip uninstall recon recon-motion")


def test_missing_optional_packages_have_an_install_hint():
    requires = [
        "rich>=1; extra == 'robots'",
        "no-such-thing>=1; extra == 'formats'",
        "rich>=999; extra == 'formats'",
        "x; extra == 'dev'",
    ]
    found = {check.name: check for check in packages(requires)}
    assert statuses(found.values()) == {"packages": "ok", "robots": "ok", "formats": "absent"}
    assert found["formats"].hint == install_command("formats")
    assert says(found["formats"].state, "no-such-thing", f"rich {metadata.version('rich')}, not >=999")


def test_every_extra_is_explained_or_for_developers():
    import tomllib

    pyproject = Path(__file__).parents[2] / "pyproject.toml"
    project = tomllib.loads(pyproject.read_text(encoding="utf-8"))["project"]
    assert set(project["optional-dependencies"]) - {"dev"} <= set(module.EXTRAS)


def test_a_missing_or_failing_viewer_is_broken(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    assert statuses(viewer()) == {"viewer": "ok", "display": "ok"}
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    if sys.platform == "linux":
        (display,) = (check for check in viewer([sys.executable, "-c", ""]) if check.name == "display")
        assert display.status == "note"
        assert "--web" in display.hint
    found, _ = viewer(["/no/such/program"])
    assert (found.status, found.state) == ("broken", "/no/such/program: No such file or directory")
    found, _ = viewer([sys.executable, "-c", "import sys; print('no GL', file=sys.stderr); sys.exit(3)"])
    assert (found.status, found.state) == ("broken", "no GL")


def test_a_temporary_folder_that_cannot_be_written_to_is_broken(monkeypatch, tmp_path):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "gone"))
    (check,) = self_test()
    assert (check.name, check.status) == ("temporary files", "broken")
    assert check.state.endswith("No such file or directory")
    assert "TMPDIR" in check.hint


@pytest.mark.parametrize(
    ("program", "found"),
    [
        ("import sys; print('boom', file=sys.stderr); sys.exit(1)", "boom"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)", "ended by signal 11"),
        (
            """print('{"summary": {"frames": 60, "frames_with_pose": 60}, "mpjpe_mm": 300.2, "seconds": 1.0}')""",
            "60 of 60 frames in 1.0 s, 300 mm from the truth (MPJPE)",
        ),
    ],
)
def test_a_crashing_self_test_is_broken(monkeypatch, program, found):
    monkeypatch.setattr(module, "_MODULE", program)
    (check,) = self_test()
    assert (check.status, check.state) == ("broken", found)


def test_a_self_test_that_does_not_end_is_broken(monkeypatch):
    monkeypatch.setattr(module, "_MODULE", "import time; time.sleep(60)")
    monkeypatch.setattr(module, "SELF_TEST_S", 0.5)
    (check,) = self_test()
    assert (check.status, check.state) == ("broken", "did not end within 0 s")


# JSON output of every table


@pytest.mark.usefixtures("fitted_demo")
def test_fit_and_demo_print_their_summary_as_json(tmp_path):
    clip = [
        "fit",
        SAMPLES / "whole.csv",
        "--camera",
        SAMPLES / "camera.toml",
        "--fps",
        60,
        "--set",
        "fast=true",
        "--frames",
        "0:8",
    ]
    ended = run(*clip, "--out", tmp_path / "fit", "--json")
    assert (ended.code, ended.err) == (0, "")
    shown, report = json.loads(ended.out), json.loads((tmp_path / "fit" / "report.json").read_text())
    assert {name: shown[name] for name in ("method", "summary", "findings")} == {
        name: report[name] for name in ("method", "summary", "findings")
    }
    assert shown["out"] == str(tmp_path / "fit")
    assert shown["seconds"] == report["timing_s"]["solve_s"]
    ended = run("demo", "--out", tmp_path / "demo", "--json")
    truth = run("evaluate", tmp_path / "demo" / "pose3d.csv", SAMPLES / "whole_truth.csv", "--json")
    assert json.loads(ended.out)["mpjpe_mm"] == json.loads(truth.out)["mpjpe_mm"]
    assert ended.err == ""


def test_a_fit_without_a_pose_prints_json_too(tmp_path):
    """A fit of four joints, which are too few for a pose, also prints JSON."""
    kept = ("l_hip", "r_hip", "nose", "spine")
    few = tmp_path / "few.csv"
    table = pd.read_csv(SAMPLES / "whole.csv", header=[0, 1, 2], index_col=0)
    table.loc[:, ~table.columns.get_level_values(1).isin(kept)] = np.nan
    table.to_csv(few)
    ended = run("fit", few, "--camera", SAMPLES / "camera.toml", "--fps", 60, "--out", tmp_path / "out", "--json")
    assert ended.code == 1
    assert json.loads(ended.out)["summary"]["frames_with_pose"] == 0
    assert says(ended.err, "no frame", tmp_path / "out" / "report.json")


def test_prior_fit_prints_its_table_as_json(tmp_path):
    args = ["prior", "fit", SAMPLES / "whole_truth.csv", "--skeleton", "cheetah-24", "--fps", 60, "--components", 2]
    ended = run(*args, "--out", tmp_path / "a.npz", "--json")
    shown = json.loads(ended.out)
    assert shown["out"] == str(tmp_path / "a.npz")
    assert shown["components"] == 2
    assert shown["held_out"] is None
    (row,) = shown["segments"]
    table = run(*args, "--out", tmp_path / "b.npz", "--check").out
    assert "two segments" in table
    line = next(line for line in table.splitlines() if row["name"] in line).split()
    assert line == [row["name"], str(row["frames"]), "60", f"{row['speed_m_s']:.1f}", f"{row['misfit_mm']:.1f}", "yes"]


# Colours

COLOUR = re.compile(r"\x1b\[[\d;]*(?<![\d])(?:3[0-8]|9[0-7]|4[0-8])[\d;]*m")


@pytest.mark.parametrize(
    "args",
    [
        ["convert", "--list"],
        ["skeleton", "list"],
        ["skeleton", "check", "cheetah-8u"],
        ["evaluate", SAMPLES / "whole_truth.csv", SAMPLES / "whole_truth.csv"],
        ["analyse", "no-such-folder"],
        ["fit", "no-such-file.csv", "--out", "no-such-folder"],
    ],
    ids=lambda args: " ".join(map(str, args[:2])),
)
def test_no_color_is_respected_on_a_terminal(args, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("NO_COLOR", "1")
    ended = run(*args)
    assert ended.out + ended.err
    assert not COLOUR.search(ended.out + ended.err)


def test_output_is_coloured_without_no_color(monkeypatch):
    """Without NO_COLOR the output has colours, which shows that the test above can fail."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert COLOUR.search(run("fit", "no-such-file.csv", "--out", "no-such-folder").err)


@pytest.mark.slow
@pytest.mark.parametrize("no_color", [True, False])
def test_no_color_is_respected_by_the_help(no_color, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("NO_COLOR", "1") if no_color else monkeypatch.delenv("NO_COLOR", raising=False)
    assert bool(COLOUR.search(run_process("fit", "--help").out)) is not no_color


# Shell completion

NAMES = {name for panel in COMMANDS.values() for name in panel if name.split()[0] not in GROUPS}


def called(monkeypatch: pytest.MonkeyPatch, *args: str, **environment: str) -> str:
    """Return what `recon ARGS` prints with the given environment variables."""
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    out = io.StringIO()
    with redirect_stdout(out), pytest.raises(SystemExit) as ended:
        app(list(args), prog_name="recon")
    assert not ended.value.code
    return out.getvalue()


@pytest.mark.parametrize(
    ("words", "offered"),
    [
        ("recon ", NAMES | {*GROUPS}),
        ("recon ana", {"analyse"}),
        (
            "recon fit --camera",
            {
                "--camera",
                "--camera-name",
                "--camera-track",
                "--camera-unit",
            },
        ),
        ("recon skeleton c", {"check"}),
    ],
)
def test_completion_offers_commands_and_options(monkeypatch, words, offered):
    """Completion offers commands and options, given the words and the index of the word being typed, as bash does."""
    count = str(len(words.split(" ")) - 1)
    shown = called(monkeypatch, _RECON_COMPLETE="complete_bash", COMP_WORDS=words, COMP_CWORD=count)
    assert set(shown.splitlines()) == offered


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_script_is_printed_for_each_shell(shell, monkeypatch):
    script = called(monkeypatch, "--show-completion", shell, _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION="1")
    assert f"_RECON_COMPLETE=complete_{shell}" in script


@pytest.mark.slow
def test_completion_works_in_bash(tmp_path):
    """Completion works in bash, with the script in a shell and the command on its path."""
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("no bash")
    program = tmp_path / "recon"
    program.write_text(
        f"#!{sys.executable}\nimport sys\nfrom recon.cli.app import main\nsys.argv[0] = 'recon'\nmain()\n"
    )
    program.chmod(0o755)
    lines = [
        f'export PATH="{tmp_path}:$PATH" _TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION=1',
        'eval "$(recon --show-completion bash)"',
        "COMP_WORDS=(recon skel) COMP_CWORD=1",
        "_recon_completion recon",
        'echo "${COMPREPLY[@]}"',
    ]
    done = subprocess.run([bash, "-c", "\n".join(lines)], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout == "skeleton\n"
