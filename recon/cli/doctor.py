"""Check the installation: versions, optional packages, the viewer, and a fit of the sample."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rich.table import Table
from rich.text import Text

from recon.base.numbers import quantity
from recon.base.package import DISTRIBUTION, install_command, pip_command, quoted, version
from recon.base.progress import Progress, silent
from recon.cli.answers import Answer

if TYPE_CHECKING:
    from packaging.specifiers import SpecifierSet

EXTRAS = {
    "formats": "writing movement, NWB, C3D and DeepLabCut's H5 files: ",
    "cluster": "batches on a Dask cluster: ",
    "net": "the keypoint network: ",
    "robots": "robots from URDF and MJCF files: ",
    "docs": "building this documentation: ",
}
"""Purpose of each optional extra."""
MODULES = {"opencv-python-headless": "cv2", "rerun-sdk": "rerun", "pytables": "tables"}
"""Module of each distribution that another distribution can replace, such as opencv-python or a custom build."""
STYLES = {"ok": "green", "absent": "", "note": "yellow", "broken": "bold red"}
SELF_TEST_MPJPE_MM = 100
"""Error of the sample, mm, above which the solver is broken, about twice the error that `recon demo` prints."""
SELF_TEST_S = 300.0
_MODULE = "import sys; from recon.cli.app import main; sys.exit(main())"


@dataclass(frozen=True)
class _Check:
    """One checked part of the installation."""

    name: str
    status: Literal["ok", "absent", "note", "broken"]
    """Whether the part works ("ok"), is optional and not installed ("absent"), works with a limit ("note"), or keeps
    recon from working ("broken").
    """
    state: str
    """Description of the part, such as its version."""
    hint: str = ""
    """Advice, unless the status is ok."""

    def to_dict(self) -> dict[str, str]:
        return {"name": self.name, "status": self.status, "found": self.state, "hint": self.hint}


def doctor(progress: Progress) -> Answer:
    """Check the installation: versions, optional packages, the viewer, and a fit of the sample.

    Example: recon doctor

    Exit code 0: recon works on this machine. 1: a required part is broken.
    """
    checks, table = run_doctor(progress), Table.grid(padding=(0, 2))
    broken = [check.name for check in checks if check.status == "broken"]
    for check in checks:
        state = check.state + (f"\n{check.hint}" if check.status != "ok" else "")
        table.add_row(check.name, Text(check.status, STYLES[check.status]), Text(state, overflow="fold"))
    data = {"ok": not broken, "checks": [check.to_dict() for check in checks]}
    conclusion = f"Broken: {', '.join(broken)}" if broken else "recon works here."
    return Answer(json.dumps(data, indent=1) + "\n", [table, conclusion], code=int(bool(broken)))


def run_doctor(progress: Progress = silent) -> tuple[_Check, ...]:
    """Return the results of all checks.

    A check that fails is a result, and raises no exception.
    """
    checks: list[_Check] = []
    for i, check_part in enumerate((versions, packages, viewer, self_test)):
        progress(check_part.__name__, i / 4)
        checks += check_part()
    return tuple(checks)


def versions() -> Iterator[_Check]:
    """Check the versions of recon and of Python."""
    yield _Check("recon", "ok", f"{version()}, in {Path(__file__).parents[1]}")
    # If two distributions with a package named recon are installed, the later one has replaced files of the earlier.
    with suppress(metadata.PackageNotFoundError):
        state = f"the package recon {metadata.version('recon')} is installed too, and its files have the same names"
        hint = f"{pip_command()} uninstall recon {DISTRIBUTION}, and install {DISTRIBUTION} again"
        yield _Check("another recon", "broken", state, hint)
    yield _Check("python", "ok", f"{platform.python_version()}, {platform.system()} {platform.machine()}")


def packages(requires: Sequence[str] | None = None) -> Iterator[_Check]:
    """Check the packages that recon requires, and each optional extra that the distribution has.

    `requires` lists the requirements in the distribution's metadata.
    """
    from packaging.requirements import Requirement  # installed with matplotlib

    lines = (metadata.requires(DISTRIBUTION) or ()) if requires is None else requires
    for extra, purpose in {"": "", **EXTRAS}.items():
        extra_requirements = [
            requirement
            for requirement in map(Requirement, lines)
            if ("extra" in str(requirement.marker or "")) == bool(extra)
        ]
        wanted = [
            requirement
            for requirement in extra_requirements
            if requirement.marker is None or requirement.marker.evaluate({"extra": extra})
        ]
        states = {requirement: _installed(requirement.name, requirement.specifier) for requirement in wanted}
        missing = {requirement: problem for requirement, (problem, _) in states.items() if problem}
        shown = missing or {requirement: installed for requirement, (_, installed) in states.items()}
        state = purpose + ", ".join(f"{requirement.name} {state}" for requirement, state in shown.items())
        if not extra:
            hint = f"{pip_command()} install " + " ".join(
                quoted(f"{requirement.name}{requirement.specifier}") for requirement in missing
            )
            yield _Check("packages", "broken" if missing else "ok", state, hint)
        elif wanted:
            yield _Check(extra, "absent" if missing else "ok", state, install_command(extra))


def _installed(name: str, specifier: SpecifierSet) -> tuple[str, str]:
    """Return the problem with a requirement ("" if there is none), and the installed version.

    The version may belong to another distribution that provides the same module.
    """
    try:
        installed_version = metadata.version(name)
    except metadata.PackageNotFoundError:
        module = MODULES.get(name, name.replace("-", "_"))
        # A module is found quickly, but finding its distribution means reading the files of all distributions.
        distributions = metadata.packages_distributions().get(module) if find_spec(module) else None
        if not distributions:
            return "not installed", ""
        installed_version = metadata.version(distributions[0])
    return (
        "" if specifier.contains(installed_version, prereleases=True) else f"{installed_version}, not {specifier}"
    ), installed_version


def viewer(command: Sequence[str] = (sys.executable, "-m", "rerun")) -> Iterator[_Check]:
    """Check the program that `recon view` starts, and whether it has a display."""
    code, output = _output_of([*command, "--version"], 60.0)
    state = output if code else " ".join(output.split()[:2])
    yield _Check("viewer", "broken" if code else "ok", state, f"{pip_command()} install --force-reinstall rerun-sdk")
    if sys.platform in ("win32", "darwin") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        yield _Check("display", "ok", "available")
    else:
        hint = "watch in a browser: recon view DIR --web, or make a page: recon report DIR"
        yield _Check("display", "note", "none: recon view cannot open its window", hint)


def self_test() -> Iterator[_Check]:
    """Run `recon demo` in its own process, so that a crashing library is detected and does not end this one."""
    name = "fit of the sample"
    try:
        with tempfile.TemporaryDirectory() as folder:
            arguments = ["demo", "--out", str(Path(folder) / "demo"), "--json", "--quiet"]
            code, output = _output_of([sys.executable, "-c", _MODULE, *arguments], SELF_TEST_S)
    except OSError as error:
        hint = "free some space, or set TMPDIR to a folder that can be written to"
        yield _Check("temporary files", "broken", f"{error.filename}: {error.strerror}", hint)
        return
    if code:
        yield _Check(name, "broken", output, "recon demo shows the whole message")
        return
    shown = json.loads(output)
    frames, posed, error_mm = shown["summary"]["frames"], shown["summary"]["frames_with_pose"], shown["mpjpe_mm"]
    state = (
        f"{posed} of {frames} frames in {quantity(shown['seconds'], 1, 's')}, {quantity(error_mm, 0, 'mm')} "
        "from the truth (MPJPE)"
    )
    is_sound = error_mm <= SELF_TEST_MPJPE_MM and posed == frames
    hint = "" if is_sound else f"at most {SELF_TEST_MPJPE_MM} mm is expected: reinstall numpy and scipy, or report it"
    yield _Check(name, "ok" if is_sound else "broken", state, hint)


def _output_of(command: Sequence[str], timeout_s: float) -> tuple[int, str]:
    """Return the exit code of a program, and its output, or only its last line if it failed.

    A program that does not exist or does not end counts as failed.
    """
    try:
        ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout_s)
    except subprocess.TimeoutExpired:
        return 1, f"did not end within {quantity(timeout_s, 0, 's')}"
    except OSError as error:
        return 1, f"{command[0]}: {error.strerror or error}"
    if ended.returncode <= 0:
        return ended.returncode, ended.stdout if ended.returncode == 0 else f"ended by signal {-ended.returncode}"
    output_lines = (ended.stderr.strip() or ended.stdout.strip()).splitlines()
    return ended.returncode, output_lines[-1] if output_lines else f"exit code {ended.returncode}"
