"""Write into folders with a user's files, links and damaged records, and check that no file of the user changes.

Each reader of this module makes such a folder, writes into it as commands do, and raises AssertionError if a file of
the user has changed.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from recon.base.errors import InputError, Problem
from recon.base.files import MANIFEST
from recon.base.locks import COMMITTING, WRITING, sole_writer
from recon.base.outputs import RECORD, Output, ReadResults, is_current, output_file, read_record

OWN = "1,2,3\n"
"""Content of a file that recon wrote, and of the user's copy of it elsewhere."""
Snapshot = dict[str, tuple[str, str | bytes]]
"""Kind of each file, folder and link by its path, with the content of a file or the target of a link."""
FILES = ("a.csv", "b.csv", "motion.npz", "report.html", "=1+1.csv", "-x.csv", "caf\udce9.csv", "a\nb.csv", "\u0430.csv")
RECORDS = (RECORD, MANIFEST, WRITING, COMMITTING, ".recon-partial-mine")
FOLDERS = (
    "out",
    "new",
    "new/deep",
    "user/folder",
    "user/../out",
    "link",
    "dangling",
    "loop",
    "file",
    "out/link",
    "x" * 300,
)
"""Paths of output folders, as a user could name them."""


LOCKS = (COMMITTING, WRITING)


def snapshot(folder: Path) -> Snapshot:
    """Record all files, folders and links below a folder, without following links."""
    found: Snapshot = {}
    for at, folders, files in os.walk(folder):
        for name in (*folders, *files):
            path = Path(at) / name
            key = str(path.relative_to(folder))
            if path.is_symlink():
                found[key] = ("link", os.readlink(path))
            elif path.is_dir():
                found[key] = ("folder", "")
            elif path.is_file():
                found[key] = ("file", path.read_bytes())
            else:
                found[key] = ("other", "")
    return found


def require_same(before: Snapshot, folder: Path) -> None:
    """Raise AssertionError unless every earlier file is unchanged.

    Empty lock files may be deleted, because killed runs leave them.
    """
    after = snapshot(folder)
    changed = [name for name, state in before.items() if after.get(name) != state]
    changed = [name for name in changed if Path(name).name not in LOCKS or before[name] != ("file", b"")]
    assert not changed, f"changed: {changed!a}"


def _emptied(path: Path) -> Path:
    """Return a new, empty folder next to a case's file."""
    folder = path.with_name("tree")
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    return folder


def _refused(path: Path, write: Callable[[], object]) -> InputError | None:
    """Call `write`, and return the error with which it refuses, or None.

    A system error that names a file counts as a refusal.
    """
    try:
        write()
    except InputError as error:
        return error
    except OSError as error:
        if error.filename is None:
            raise
        return InputError(Problem(path, "file", str(error.strerror), "a folder that can be written to"))
    return None


def _put(random: Random, path: Path) -> None:
    """Put a user's file at a path, if the path is free."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        what = random.randrange(9)
        if what == 0:
            path.mkdir()
            (path / "thesis.tex").write_text("mine")
        elif what == 1:
            os.mkfifo(path)
        elif what == 2:
            path.symlink_to(path.name)
        elif what == 3:
            path.symlink_to("nowhere")
        elif what == 4:
            path.symlink_to(random.choice(("../user/folder", "../user", "..", ".", "/dev")))
        elif what == 5:
            path.symlink_to(random.choice(("../user/precious.csv", "/dev/null", "/dev/zero", "../file")))
        elif what == 6:
            path.hardlink_to(path.parents[1] / "user" / "precious.csv")
        elif not os.path.lexists(path):
            path.write_bytes(random.choice((b"mine", b"", b"123\nmine", b"{}", b"[" * 9000, b"\xff\xfe\0")))


def write_among_others(path: Path) -> object:
    """Write into a folder with a user's files; the bytes of the file at `path` seed all random choices."""
    random, root = Random(path.read_bytes()), _emptied(path)
    (root / "user" / "folder").mkdir(parents=True)
    (root / "user" / "precious.csv").write_text(OWN)
    (root / "file").write_text("mine")
    (root / "out").mkdir()
    for name, target in (("link", "out"), ("dangling", "nowhere"), ("loop", "loop"), ("out/link", "../user/folder")):
        (root / name).symlink_to(target)
    for name in random.choices((*FILES, *FILES, *RECORDS), k=random.randrange(5)):
        _put(random, root / random.choice(("out", "out", "user/folder")) / name)
    before = snapshot(root)
    folder, names = root / random.choice((*["out"] * 9, *FOLDERS)), [*dict.fromkeys(random.choices(FILES, k=3))]
    inputs = [root / "user" / "precious.csv"] * random.randrange(2)
    overwrite, is_locked = random.random() < 0.5, random.random() < 0.3

    def write() -> None:
        if random.random() < 0.4:
            with output_file(folder / names[0], "convert", overwrite, inputs).staged_file() as staged:
                staged.write_text(OWN)
            return
        output = Output(folder, "fit", overwrite, inputs, has_manifest=random.random() < 0.5)
        output.require(names)
        with output.staged(adds=random.random() < 0.5) as staging:
            for name in names:
                (staging / name).write_text(OWN)

    def write_alone() -> None:
        with sole_writer(folder):
            write()

    refusal = _refused(path, write_alone if is_locked else write)
    require_same(before, root)
    if refusal is not None:
        assert snapshot(root) == before, "something was left"
        raise refusal
    return overwrite


_PLACES = {"record": f"out/{RECORD}", "manifest": f"out/{MANIFEST}", "analysis": f"out/analysis/{RECORD}"}


def _written_folder(root: Path) -> None:
    """Make results and an analysis of them, and put a user's files around and among them."""
    out = root / "out"
    with Output(out, "fit", has_manifest=True).staged() as staging:
        for name in ("a.csv", "b.csv", "c.csv"):
            (staging / name).write_text(OWN)
    with Output(out / "analysis", "analyse", made_from=ReadResults.read(out)).staged() as staging:
        (staging / "e.csv").write_text(OWN)
    (root / "precious.csv").write_text(OWN)
    (out / "b.csv").write_text("changed")
    (out / "mine.csv").write_text("mine")
    (out / "d.csv").mkdir()
    (out / "d.csv" / "a.csv").write_text(OWN)
    (out / "link.csv").symlink_to("../precious.csv")
    (out / "analysis" / "mine.csv").write_text("mine")
    (out / "linked").symlink_to("..")


_USERS = (
    "precious.csv",
    "out/b.csv",
    "out/mine.csv",
    "out/d.csv/a.csv",
    "out/link.csv",
    "out/analysis/mine.csv",
    "out/linked",
)


def write_after(path: Path) -> object:
    """Replace a record by the file at `path`, then write a fit, an analysis and a page."""
    root = _emptied(path)
    _written_folder(root)
    path_in_results = root / next(
        path_in_results for name, path_in_results in _PLACES.items() if f"{name}-folder" in path.name
    )
    path_in_results.write_bytes(path.read_bytes())
    out = root / "out"
    before = snapshot(root)
    users = {name: before[name] for name in _USERS}

    def write() -> None:
        with Output(out, "fit", overwrite=True, has_manifest=True).staged() as staging:
            for name in ("a.csv", "f.csv"):
                (staging / name).write_text("new")

    def analyse() -> None:
        with Output(out / "analysis", "analyse", True, made_from=ReadResults.read(out)).staged(adds=True) as staging:
            (staging / "e.csv").write_text("new")

    refusals = []
    for step in (write, analyse, lambda: Output(out, "report", True).write("report.html", "page")):
        state = snapshot(root)
        refusals.append(_refused(path, step))
        require_same(users, root)
        if refusals[-1] is not None:
            require_same(state, root)
    is_current(out / "analysis" / "e.csv", out)
    for refusal in filter(None, refusals):
        raise refusal
    return read_record(out)


def records() -> Iterator[tuple[str, bytes]]:
    """Yield the name and the content of each kind of valid record."""
    with TemporaryDirectory() as name:
        _written_folder(Path(name))
        for key, path_in_results in _PLACES.items():
            yield f"{key}-folder.json", (Path(name) / path_in_results).read_bytes()
