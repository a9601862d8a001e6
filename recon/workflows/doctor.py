"""What a machine offers to recon: versions, optional parts, the viewer, and a fit of the bundled sample."""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib import import_module, metadata, util
from pathlib import Path
from typing import Literal

from threadpoolctl import threadpool_info

from recon.base.package import DISTRIBUTION, install_command, version
from recon.base.parallel import available_cores
from recon.base.progress import Progress, silent

Status = Literal["ok", "absent", "note", "broken"]

EXTRAS = {
    "formats": "writing movement, NWB, C3D and DeepLabCut's H5 files",
    "cluster": "batches on a Dask cluster",
    "net": "the keypoint network",
    "robots": "robots from URDF and MJCF files",
    "docs": "building this documentation",
}
"""Extras that a user may want, with what they are for."""
MODULES = {"opencv-python-headless": "cv2", "rerun-sdk": "rerun", "pytables": "tables"}
"""Of distributions that others may stand in for: opencv-python, or a build of one's own."""

SELF_TEST_MPJPE_MM = 100
"""The sample is fitted to about half of this: more is a solver that does not work here."""
SELF_TEST_S = 300.0
FREE_BYTES = 500_000_000
_MODULE = "import sys; from recon.workflows.cli import main; sys.exit(main())"


@dataclass(frozen=True)
class Check:
    """Something that was looked at."""

    group: str
    name: str
    status: Status
    """ok; absent: optional, and not there; note: works, with a limit; broken: recon cannot work here."""
    found: str
    """In words."""
    hint: str = ""
    """What to do, or empty."""


def run_doctor(progress: Progress = silent) -> tuple[Check, ...]:
    """Every check; none of them raises for what it finds."""
    checks: list[Check] = []
    looks: Sequence[tuple[str, Callable[[], Iterator[Check]]]] = (
        ("versions", versions),
        ("optional parts", extras),
        ("processor", processor),
        ("viewer", viewer),
        ("temporary folder", temporary_folder),
        ("self-test", self_test),
    )
    for i, (name, look) in enumerate(looks):
        progress(name, i / len(looks))
        checks += look()
    return tuple(checks)


# -- what is installed --------------------------------------------------------------------------------------------


def versions(requires: Sequence[str] | None = None) -> Iterator[Check]:
    """recon, Python, and what recon cannot do without. requires: as in the distribution's metadata."""
    yield Check("versions", "recon", "ok", f"{version()}, in {Path(__file__).parents[1]}")
    yield from _stranger()
    yield Check("versions", "python", "ok", f"{platform.python_version()}, {platform.system()} {platform.machine()}")
    for name, least, extra in _requirements(requires):
        if not extra:
            found = _version(name)
            if found is None:
                yield Check("versions", name, "broken", "not installed", f"pip install '{name}>={least}'")
            elif _is_older(found, least):
                yield Check("versions", name, "broken", f"{found}, older than {least}", f"pip install -U {name}")
            else:
                yield Check("versions", name, "ok", found)


def _stranger() -> Iterator[Check]:
    """The distribution that is named as this package is: the last that was installed has its files over the other's."""
    with suppress(metadata.PackageNotFoundError):
        found = f"the package recon {metadata.version('recon')} is here too, whose files have the same names"
        hint = f"pip uninstall recon {DISTRIBUTION}, and install {DISTRIBUTION} again"
        yield Check("versions", "another recon", "broken", found, hint)


def extras(requires: Sequence[str] | None = None) -> Iterator[Check]:
    """One row for each extra that the distribution has and a user may want."""
    wanted: dict[str, list[tuple[str, str]]] = {}
    for name, least, extra in _requirements(requires):
        if extra in EXTRAS:
            wanted.setdefault(extra, []).append((name, least))
    for extra, what in EXTRAS.items():
        if extra in wanted:
            versions = [(name, least, _version(name)) for name, least in wanted[extra]]
            lacking = [
                name if found is None else f"{name} {found} < {least}"
                for name, least, found in versions
                if found is None or _is_older(found, least)
            ]
            if lacking:
                found = f"{what}: no {', '.join(lacking)}"
                yield Check("optional parts", extra, "absent", found, install_command(extra))
            else:
                there = ", ".join(f"{name} {found}" for name, _, found in versions)
                yield Check("optional parts", extra, "ok", f"{what}: {there}")
    yield _gpu()


def _gpu() -> Check:
    if util.find_spec("torch") is None:
        return Check("optional parts", "GPU", "ok", "not needed: fits run on one core")
    torch = import_module("torch")
    if torch.cuda.is_available():
        return Check("optional parts", "GPU", "ok", f"{torch.cuda.get_device_name(0)}, torch {torch.__version__}")
    return Check(
        "optional parts", "GPU", "ok", f"not needed: fits run on one core (torch {torch.__version__} finds none)"
    )


def _requirements(requires: Sequence[str] | None) -> Iterator[tuple[str, str, str]]:
    """(distribution, least version or "0", extra or "") of the distribution's requirements."""
    for line in metadata.requires(DISTRIBUTION) or () if requires is None else requires:
        name = re.match(r"[\w.-]+", line)
        least = re.search(r">=\s*([\w.]+)", line)
        extra = re.search(r"extra\s*==\s*['\"]([\w-]+)['\"]", line)
        if name:
            yield name[0], least[1] if least else "0", extra[1] if extra else ""


def _version(name: str) -> str | None:
    """Of a distribution, or of another one that has its module."""
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        pass
    module = MODULES.get(name, name.replace("-", "_"))
    if util.find_spec(module) is None:
        return None
    others = metadata.packages_distributions().get(module, ())
    return f"{metadata.version(others[0])} ({others[0]})" if others else "unknown version"


def _is_older(found: str, least: str) -> bool:
    """By the numbers in front; a version without any is not older."""
    return bool(re.match(r"\d", found)) and _numbers(found) < _numbers(least)


def _numbers(version: str) -> list[int]:
    release = re.match(r"\d+(\.\d+)*", version)
    return [int(part) for part in release[0].split(".")] if release else []


# -- the machine --------------------------------------------------------------------------------------------------


def processor() -> Iterator[Check]:
    cores = available_cores()
    yield Check("machine", "cores", "ok", f"{cores}: as many clips at a time in recon batch")
    pools = [pool for pool in threadpool_info() if pool["user_api"] == "blas"]
    names = ", ".join(dict.fromkeys(str(pool["internal_api"]) for pool in pools)) or "unknown"
    threads = max((pool["num_threads"] for pool in pools), default=1)
    yield Check("machine", "BLAS", "ok", f"{names}, up to {threads} threads, of which a fit uses one")


def viewer(command: Sequence[str] = (sys.executable, "-m", "rerun")) -> Iterator[Check]:
    """The program that `recon view` starts, and whether it has a display."""
    found = _run([*command, "--version"], 60.0)
    if found.returncode:
        yield Check("machine", "viewer", "broken", _last_line(found), "pip install --force-reinstall rerun-sdk")
    else:
        yield Check("machine", "viewer", "ok", " ".join(found.stdout.split()[:2]))
    if sys.platform in ("win32", "darwin") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        yield Check("machine", "display", "ok", "there is one")
    else:
        hint = "copy motion.rrd to a machine with one, and open it there with: rerun motion.rrd"
        yield Check("machine", "display", "note", "none: recon view cannot show anything here", hint)


def temporary_folder() -> Iterator[Check]:
    """Whether files can be written there, and how much space there is."""
    folder = "unknown"
    try:
        folder = tempfile.gettempdir()
        with tempfile.TemporaryDirectory() as inside:
            (Path(inside) / "file").write_bytes(b"recon")
        free = shutil.disk_usage(folder).free
    except OSError as error:
        hint = "free some space, or set TMPDIR to a folder that can be written to"
        yield Check("machine", "temporary files", "broken", f"{folder}: {error.strerror or error}", hint)
        return
    found = f"{folder}, {free / 1e9:.1f} GB free"
    if free < FREE_BYTES:
        yield Check("machine", "temporary files", "note", found, "free some space: a playback takes megabytes")
    else:
        yield Check("machine", "temporary files", "ok", found)


# -- self-test ----------------------------------------------------------------------------------------------------


def self_test() -> Iterator[Check]:
    """`recon demo` in a process of its own, so that a library that crashes is found and survived."""
    with tempfile.TemporaryDirectory() as folder:
        out = str(Path(folder) / "demo")
        done = _run([sys.executable, "-c", _MODULE, "demo", "--out", out, "--json", "--quiet"], SELF_TEST_S)
    if done.returncode:
        yield Check("self-test", "fit of the sample", "broken", _last_line(done), "recon demo shows all of it")
        return
    shown = json.loads(done.stdout)
    summary, error_mm, seconds = shown["summary"], shown["mpjpe_mm"], shown["seconds"]
    found = (
        f"{summary['frames_with_pose']} of {summary['frames']} frames in {seconds:.1f} s, "
        f"{error_mm:.0f} mm from the truth (MPJPE)"
    )
    if error_mm > SELF_TEST_MPJPE_MM or summary["frames_with_pose"] < summary["frames"]:
        hint = f"{SELF_TEST_MPJPE_MM} mm is the most: reinstall numpy and scipy, or report it"
        yield Check("self-test", "fit of the sample", "broken", found, hint)
    else:
        yield Check("self-test", "fit of the sample", "ok", found)


def _run(command: Sequence[str], timeout_s: float) -> subprocess.CompletedProcess[str]:
    """Also for a program that is not there, or does not end."""
    try:
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout_s)
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, 1, "", f"did not end within {timeout_s:.0f} s")
    except OSError as error:
        return subprocess.CompletedProcess(command, 1, "", f"{command[0]}: {error.strerror or error}")


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    said = (done.stderr.strip() or done.stdout.strip()).splitlines()
    if done.returncode < 0:
        return f"ended by signal {-done.returncode}"
    return said[-1] if said else f"exit code {done.returncode}"
