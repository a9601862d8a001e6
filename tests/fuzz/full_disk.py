"""Run every command that writes on disks that are too small, of several sizes.

    python tests/fuzz/full_disk.py [--sizes 20] [--only WORD ...] [--by-file]

Each case runs in a child, in its own file system in memory (needs root) that is too small for the output; with
--by-file, no file may grow beyond a size. A case passes if it prints one line, ends with exit code 2 and leaves no
partial file, or if everything fits and can be read back. The script prints the cases that failed, and ends with 1 if
there are any.
"""

from __future__ import annotations

import argparse
import faulthandler
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "samples"
CAMERA = ("--camera", SAMPLES / "camera.toml")
FIT = ("fit", SAMPLES / "whole.csv", *CAMERA, "--fps", 60, "--frames", "0:8", "--set", "fast=true")
PATIENCE_S = 90.0
LEAST = 4096
"""Size of the smallest disk, bytes."""


class Case(NamedTuple):
    """A command that writes files, and how its output is checked."""

    name: str
    arguments: Sequence[object]
    """Arguments of `recon`, with {out} for the path of the output."""
    out: str
    """Name of the output file or folder."""
    whole: bool = True
    """Whether a failed run must leave nothing; if not, finished parts may stay."""
    read: Callable[[Path], object] = lambda path: None
    """Function that raises an error if the output is broken."""
    beside: Path | None = None
    """Folder whose files are linked into the output folder before the run."""


def read_results(out: Path) -> object:
    from recon.fit.motion import Motion

    read_manifest(out)
    return Motion.load(out)


def read_data(out: Path) -> object:
    from recon.base.errors import InputError
    from recon.cli.convert import ConvertSettings, read_any

    if out.suffix in (".osim", ".glb"):  # recon does not read these formats
        sizes = [path.stat().st_size for path in out.parent.glob(f"{out.stem}.*")]
        assert len(sizes) == (3 if out.suffix == ".osim" else 1)
        return sizes
    try:
        return read_any(out, ConvertSettings(fps=60))[0]
    except InputError:  # 3D positions need a unit, which is refused for 2D keypoints
        return read_any(out, ConvertSettings(fps=60, unit="m", up="z"))[0]


def read_manifest(out: Path) -> object:
    from recon.base.files import read_manifest

    changed = read_manifest(out).changed()
    assert not changed, changed
    return changed


def read_video(out: Path) -> object:
    from recon.io.video import probe, read_frames

    frames = sum(1 for _ in read_frames(out))
    assert frames == probe(out).stated_frames
    return frames


def read_page(out: Path) -> object:
    assert (out / "report.html").read_text(encoding="utf-8").rstrip().endswith("</html>")
    return out


def read_summary(out: Path) -> object:
    assert (out / "summary.csv").read_text(encoding="utf-8").count("\n") == 2
    return read_results(out / "whole")


def cases(folder: Path) -> list[Case]:
    """Return the cases, which read the results in the subfolder `clip` of `folder`."""
    clip = folder / "clip"
    two = ("deeplabcut.csv", "deeplabcut.h5", "long.csv", "movement.nc", "nwb.nwb")
    three = ("deeplabcut.csv", "deeplabcut.h5", "movement.nc", "nwb.nwb", "parquet.parquet", "trc.trc", "c3d.c3d",
             "npz.npz", "opensim.osim", "gltf.glb", "bvh.bvh")  # fmt: skip
    found = [
        Case("fit", (*FIT, "--out", "{out}"), "clip", read=read_results),
        Case("fit frame", ("frame", *FIT[1:-2], "--out", "{out}"), "clip", read=read_results),
        Case(
            "batch",
            ("batch", *FIT[1:-2], "--set", "fast=true", "--jobs", 1, "--strict", "--out", "{out}"),
            "all",
            False,
            read_summary,
        ),
        Case("analyse tables", ("analyse", clip, "--no-figures", "--out", "{out}"), "analysis"),
        Case("solver", ("solver", folder / "frame_clip", "--no-figures", "--out", "{out}"), "solver"),
        Case("analyse", ("analyse", clip, "--out", "{out}"), "analysis", False),
        Case("ik", ("ik", clip, "--target", "stride-max", "--no-figures", "--out", "{out}"), "ik"),
        Case("climb", ("climb", "--no-figures", "--out", "{out}"), "climb", read=read_manifest),
        Case("retarget", ("retarget", clip, "--robot", "a1", "--out", "{out}"), "robot", read=read_manifest),
        Case(
            "prior fit",
            (
                "prior",
                "fit",
                SAMPLES / "whole_truth.csv",
                "--skeleton",
                "cheetah-24",
                "--fps",
                60,
                "--components",
                1,
                "--out",
                "{out}",
            ),
            "prior.npz",
        ),
        *(
            Case(
                f"overlay {kind}",
                ("overlay", clip, "--video", folder / "black.avi", "--out", "{out}"),
                f"o.{kind}",
                read=read_video,
            )
            for kind in ("mp4", "avi")
        ),
        Case(
            "run",
            (
                *("run", folder / "black.avi", "--keypoints", SAMPLES / "whole.csv", *CAMERA, "--frames", "0:8"),
                *("--set", "fast=true", "--out", "{out}"),
            ),
            "all",
            False,
            lambda out: (read_results(out), read_video(out / "overlay.mp4"), read_page(out)),
        ),
        Case("report", ("report", "{out}"), "clip", False, read_page, clip),
        Case("skeleton draft", ("skeleton", "from-keypoints", SAMPLES / "whole.csv", "--out", "{out}"), "mine.toml"),
        Case("skeleton check", ("skeleton", "check", "cheetah-24", "--out", "{out}"), "pictures", False),
    ]
    for source, kind, names in ((SAMPLES / "whole.csv", "2D", two), (clip, "3D", three)):
        for name in names:
            to = name.partition(".")[0]
            arguments = ("convert", source, "{out}", "--to", to, "--fps", 60)
            found.append(Case(f"convert {kind} {name}", arguments, name, read=read_data))
    return found


def prepare(folder: Path) -> None:
    """Make the results that the cases read."""
    import cv2
    import numpy as np

    from recon.io.video import video_writer

    for name, fit in (("clip", FIT), ("frame_clip", ("frame", *FIT[1:-2]))):
        ended = Child(Case("fit", (*fit, "--out", "{out}"), name), folder).wait()
        assert ended == (0, ""), ended
    with video_writer(folder / "black.avi", (1920, 1080), 60.0) as write:
        rng = np.random.default_rng(0)
        for _ in range(8):
            small = rng.integers(0, 255, (54, 96, 3), dtype=np.uint8)
            write(np.asarray(cv2.resize(small, (1920, 1080)), dtype=np.uint8))


class Child:
    """Child process that runs `recon ARGUMENTS`, forked from this process after all imports."""

    def __init__(self, case: Case, folder: Path, limit: int | None = None, then_read: bool = False) -> None:
        self.err = tempfile.TemporaryFile()  # noqa: SIM115  # for as long as the child
        self.pid = os.fork()
        if self.pid == 0:
            code = 3
            try:
                code = self._run(case, folder / case.out, limit, then_read)
            except BaseException:
                os.write(self.err.fileno(), traceback.format_exc().encode())
            finally:
                os._exit(code)

    def _run(self, case: Case, out: Path, limit: int | None, then_read: bool) -> int:
        from recon.cli.app import main

        nothing = os.open(os.devnull, os.O_RDWR)
        for stream, target in ((0, nothing), (1, nothing), (2, self.err.fileno())):
            os.dup2(target, stream)
        faulthandler.enable()
        if then_read:
            case.read(out)
            return 0
        if case.beside is not None:
            out.mkdir()
            for path in (path for path in case.beside.iterdir() if path.name != ".recon.json"):
                (out / path.name).symlink_to(path)
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        sys.argv = ["recon", *(str(out) if a == "{out}" else str(a) for a in case.arguments)]
        try:
            main()
        except SystemExit as ended:
            code = ended.code or 0
            return code if isinstance(code, int) else 3
        return 0

    def wait(self) -> tuple[int | None, str]:
        """Wait for the child, and return its exit code, or None if it hangs, and the text on standard error."""
        code, until = None, time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                code = os.waitstatus_to_exitcode(status)
                break
            time.sleep(0.005)
        else:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
        self.err.seek(0)
        return code, self.err.read().decode("utf-8", "replace")


class Disk:
    """A file system in memory of `size` bytes, or an ordinary folder if `size` is None."""

    def __init__(self, size: int | None) -> None:
        self.path, self.mounted = Path(tempfile.mkdtemp(prefix="full-disk-")), False
        if size is not None:
            command = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(self.path)]
            self.mounted = subprocess.run(command, check=False, capture_output=True).returncode == 0
            assert self.mounted, "a file system can only be made by root: use --by-file"

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *_: Any) -> None:
        if self.mounted:
            subprocess.run(["umount", "-l", str(self.path)], check=True)
        shutil.rmtree(self.path, ignore_errors=True)


def verdict(case: Case, size: int, by_file: bool) -> tuple[str, str]:
    """Run a case on a disk, and return "full", "fits" or the fault, and the output of the command."""
    with Disk(None if by_file else size) as folder:
        code, err = Child(case, folder, size if by_file else None).wait()
        left = [path.relative_to(folder) for path in folder.rglob("*")]
        if code is None:
            return "hangs", err
        if code < 0:
            return f"dies of {signal.Signals(-code).name}", err
        if "Traceback" in err or code not in (0, 1, 2):
            return "traceback", err
        if any(path.name.startswith(".recon-") for path in left):
            return f"leaves {left}", err
        if code == 0:
            read, said = Child(case, folder, then_read=True).wait()
            return ("fits", err) if read == 0 and left else ("broken", said)
        if code == 1 and case.whole:
            return "exit code 1", err
        if code == 2 and (err.count("\n") != 1 or not err.startswith("error: ")):
            return "not one line", err
        if case.whole and left:
            return f"leaves {left}", err
        return "full", err


def size_of(case: Case) -> tuple[int, int]:
    """Run a case on a large disk, and return the size of all its files and the size of the largest file, bytes."""
    with Disk(None) as folder:
        ended = Child(case, folder).wait()
        assert ended[0] == 0, (case.name, ended)
        sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file() and not path.is_symlink()]
        return sum(-(-size // 4096) * 4096 for size in sizes), max(sizes)


def check(wanted: Iterable[Case], sizes: int, by_file: bool) -> int:
    """Run each case on disks of several sizes, and return the number of failed runs."""
    wrong = 0
    for case in wanted:
        total = size_of(case)[by_file]
        # The largest disk has a little more space than is needed.
        steps = [max(LEAST, round(1.1 * total * (k + 1) / sizes)) for k in range(sizes)]
        found = [verdict(case, size, by_file) for size in steps]
        counts = {kind: sum(1 for one, _ in found if one == kind) for kind in dict.fromkeys(one for one, _ in found)}
        print(f"{case.name}: " + ", ".join(f"{kind} {count}" for kind, count in counts.items()), flush=True)
        for size, (kind, said) in zip(steps, found, strict=True):
            if kind not in ("full", "fits"):
                wrong += 1
                print(f"  {size} bytes: {kind}\n    " + said.strip().replace("\n", "\n    ")[-1500:], flush=True)
    return wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--sizes", type=int, default=20)
    parser.add_argument("--only", nargs="*", default=[])
    parser.add_argument("--by-file", action="store_true", help="limit the size of files: no root needed")
    given = parser.parse_args()
    os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "RAYON_NUM_THREADS"), "1"))

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        chosen = [c for c in cases(folder) if not given.only or any(word in c.name for word in given.only)]
        wrong = check(chosen, given.sizes, given.by_file)
    print(f"{wrong} of {given.sizes * len(chosen)} wrong")
    with suppress(OSError):
        sys.stdout.flush()
    sys.exit(wrong > 0)


if __name__ == "__main__":
    main()
