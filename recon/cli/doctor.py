"""`recon doctor`: what a machine offers to recon: versions, optional parts, the viewer, and a fit of the sample."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rich.table import Table
from rich.text import Text

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
"""Extras that a user may want, with what they are for."""
MODULES = {"opencv-python-headless": "cv2", "rerun-sdk": "rerun", "pytables": "tables"}
"""Modules of distributions that others may stand in for: opencv-python, or a build of one's own."""
STYLES = {"ok": "green", "absent": "", "note": "yellow", "broken": "bold red"}
SELF_TEST_MPJPE_MM = 100
"""The sample is fitted to about half of this: more is a solver that does not work here."""
SELF_TEST_S = 300.0
_MODULE = "import sys; from recon.cli.app import main; sys.exit(main())"


@dataclass(frozen=True)
class _Check:
    """Something that was looked at."""

    name: str
    status: Literal["ok", "absent", "note", "broken"]
    """ok; absent: optional, and not there; note: works, with a limit; broken: recon cannot work here."""
    found: str
    """What was found, in words."""
    hint: str = ""
    """What to do unless the status is ok."""


def doctor(progress: Progress) -> Answer:
    """Check the installation: versions, optional parts, the viewer, and a fit of the sample.

    Example: recon doctor

    Exit code 0: recon works here. 1: something that it cannot do without is broken.
    """
    checks, table = run_doctor(progress), Table.grid(padding=(0, 2))
    broken = [check.name for check in checks if check.status == "broken"]
    for check in checks:
        found = check.found + (f"\n{check.hint}" if check.status != "ok" else "")
        table.add_row(check.name, Text(check.status, STYLES[check.status]), Text(found, overflow="fold"))
    data = {"ok": not broken, "checks": [asdict(check) for check in checks]}
    said = f"Broken: {', '.join(broken)}" if broken else "recon works here."
    return Answer(json.dumps(data, indent=1) + "\n", [table, said], code=int(bool(broken)))


def run_doctor(progress: Progress = silent) -> tuple[_Check, ...]:
    """Every check; none of them raises for what it finds."""
    checks: list[_Check] = []
    for i, look in enumerate((versions, packages, viewer, self_test)):
        progress(look.__name__, i / 4)
        checks += look()
    return tuple(checks)


# -- what is installed --------------------------------------------------------------------------------------------


def versions() -> Iterator[_Check]:
    """The versions of recon and of Python."""
    yield _Check("recon", "ok", f"{version()}, in {Path(__file__).parents[1]}")
    with suppress(metadata.PackageNotFoundError):  # the last that was installed has its files over the other's
        found = f"the package recon {metadata.version('recon')} is here too, whose files have the same names"
        hint = f"{pip_command()} uninstall recon {DISTRIBUTION}, and install {DISTRIBUTION} again"
        yield _Check("another recon", "broken", found, hint)
    yield _Check("python", "ok", f"{platform.python_version()}, {platform.system()} {platform.machine()}")


def packages(requires: Sequence[str] | None = None) -> Iterator[_Check]:
    """What recon cannot do without, and each extra that the distribution has and a user may want. requires: as in the
    distribution's metadata."""
    from packaging.requirements import Requirement  # matplotlib has it

    lines = (metadata.requires(DISTRIBUTION) or ()) if requires is None else requires
    for extra, what in {"": "", **EXTRAS}.items():
        of_extra = [one for one in map(Requirement, lines) if ("extra" in str(one.marker or "")) == bool(extra)]
        wanted = [one for one in of_extra if one.marker is None or one.marker.evaluate({"extra": extra})]
        states = {one: _installed(one.name, one.specifier) for one in wanted}
        lacking = {one: lack for one, (lack, _) in states.items() if lack}
        shown = lacking or {one: there for one, (_, there) in states.items()}
        found = what + ", ".join(f"{one.name} {state}" for one, state in shown.items())
        if not extra:
            hint = f"{pip_command()} install " + " ".join(quoted(f"{one.name}{one.specifier}") for one in lacking)
            yield _Check("packages", "broken" if lacking else "ok", found, hint)
        elif wanted:
            yield _Check(extra, "absent" if lacking else "ok", found, install_command(extra))


def _installed(name: str, specifier: SpecifierSet) -> tuple[str, str]:
    """What is wrong with a requirement, or nothing; and its version, or another distribution's with its module."""
    try:
        found = metadata.version(name)
    except metadata.PackageNotFoundError:
        others = metadata.packages_distributions().get(MODULES.get(name, name.replace("-", "_")))
        if not others:
            return "not installed", ""
        found = metadata.version(others[0])
    return ("" if specifier.contains(found, prereleases=True) else f"{found}, not {specifier}"), found


# -- the machine --------------------------------------------------------------------------------------------------


def viewer(command: Sequence[str] = (sys.executable, "-m", "rerun")) -> Iterator[_Check]:
    """The program that `recon view` starts, and whether it has a display."""
    code, said = _run([*command, "--version"], 60.0)
    found = said if code else " ".join(said.split()[:2])
    yield _Check("viewer", "broken" if code else "ok", found, f"{pip_command()} install --force-reinstall rerun-sdk")
    if sys.platform in ("win32", "darwin") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        yield _Check("display", "ok", "there is one")
    else:
        hint = "a page shows a result in any browser: recon report DIR"
        yield _Check("display", "note", "none: recon view cannot show anything here", hint)


def self_test() -> Iterator[_Check]:
    """`recon demo` in a process of its own, so that a library that crashes is found and survived."""
    name = "fit of the sample"
    try:
        with tempfile.TemporaryDirectory() as folder:
            arguments = ["demo", "--out", str(Path(folder) / "demo"), "--json", "--quiet"]
            code, said = _run([sys.executable, "-c", _MODULE, *arguments], SELF_TEST_S)
    except OSError as error:
        hint = "free some space, or set TMPDIR to a folder that can be written to"
        yield _Check("temporary files", "broken", f"{error.filename}: {error.strerror}", hint)
        return
    if code:
        yield _Check(name, "broken", said, "recon demo shows all of it")
        return
    shown = json.loads(said)
    frames, posed, error_mm = shown["summary"]["frames"], shown["summary"]["frames_with_pose"], shown["mpjpe_mm"]
    found = f"{posed} of {frames} frames in {shown['seconds']:.1f} s, {error_mm:.0f} mm from the truth (MPJPE)"
    well = error_mm <= SELF_TEST_MPJPE_MM and posed == frames
    hint = "" if well else f"{SELF_TEST_MPJPE_MM} mm is the most: reinstall numpy and scipy, or report it"
    yield _Check(name, "ok" if well else "broken", found, hint)


def _run(command: Sequence[str], timeout_s: float) -> tuple[int, str]:
    """A program's exit code, and what it printed, or of one that failed the last line; also for a program that is not
    there, or does not end."""
    try:
        done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout_s)
    except subprocess.TimeoutExpired:
        return 1, f"did not end within {timeout_s:.0f} s"
    except OSError as error:
        return 1, f"{command[0]}: {error.strerror or error}"
    if done.returncode <= 0:
        return done.returncode, done.stdout if done.returncode == 0 else f"ended by signal {-done.returncode}"
    said = (done.stderr.strip() or done.stdout.strip()).splitlines()
    return done.returncode, said[-1] if said else f"exit code {done.returncode}"
