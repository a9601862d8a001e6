"""Writing files whole or not at all, and not over others; one process at a time where two would write the same."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from recon.base.errors import InputError, Problem, raise_problems
from recon.base.file_names import encodable

if sys.platform == "win32":
    import msvcrt

    def _lock(file: int) -> None:
        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(file: int) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


MANIFEST = "manifest.json"
SCHEMA = {"name": "recon.manifest", "version": 1}
AGAIN = "the results of one run as they were written: run the command again, with --overwrite"
_PREFIX = ".recon-partial-"
_LOCK, _NEW, _OLD = "lock", "new", "old"
"""In a staging folder: the file that its process holds locked, the files to come, and those that they replace."""
WRITING = ".recon-writing"
"""The file that the only writer of a folder holds locked."""
_POLL_S = 0.05


# -- whole or not at all ---------------------------------------------------------------------------------------------


@contextmanager
def staged_folder(folder: str | Path) -> Iterator[Path]:
    """A place to write a folder's files: they move into `folder` when the block ends without an exception.

    Each file replaces its namesake in one step; other files in `folder` stay. After an exception nothing is left, not
    even a folder that was made for the purpose; after a kill, only a hidden staging folder, which the next run removes.
    Any number of processes may do so in one folder at a time. An OSError names the file that was to be written, or
    the folder.
    """
    with _staging(Path(folder)) as staging:
        yield staging / _NEW
        _require_places(Path(folder), _names(staging / _NEW))
        for name in _names(staging / _NEW):
            os.replace(staging / _NEW / name, Path(folder) / name)


@contextmanager
def staged_results(folder: str | Path, names: Iterable[str] = ()) -> Iterator[Path]:
    """The same for files that belong together: all of them move, or none, with a manifest that names them.

    names: of all files that results of this kind may have. Those of an earlier run that this one does not write go.
    """
    folder = Path(folder)
    with _staging(folder) as staging:
        yield staging / _NEW
        write_manifest(staging / _NEW)
        with suppress(InputError):  # there is no earlier run
            names = {*names, *read_manifest(folder).files}
        _exchange(staging, folder, {*names} - {*_names(staging / _NEW)})


@contextmanager
def staged_file(path: str | Path) -> Iterator[Path]:
    """The same for a single file: where to write it, for now."""
    path = Path(path)
    try:
        with staged_folder(path.parent) as folder:
            yield folder / path.name
    except OSError as error:
        if error.filename == str(path.parent):
            error.filename = str(path)
        raise


def write_text(path: str | Path, text: str) -> None:
    """A file of text, whole or not at all."""
    with staged_file(path) as staged:
        staged.write_text(encodable(text), encoding="utf-8")


def write_bytes(path: Path, content: bytes) -> None:
    """What a library has made in memory: libraries that write themselves hang, crash or say nothing on a full disk.

    Raises OSError that names the path.
    """
    try:
        path.write_bytes(content)
    except OSError as error:
        error.filename = str(path)
        raise


def _names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


@contextmanager
def _gone_if_empty(folder: Path) -> Iterator[None]:
    """After the block, a folder that was made in it goes again if nothing is in it, and so do its parents."""
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    try:
        yield
    finally:
        for one in made:
            with suppress(OSError):  # it was not made after all, or there is something in it
                one.rmdir()


@contextmanager
def _staging(folder: Path) -> Iterator[Path]:
    """A new staging folder in `folder`, which is made if need be."""
    staging = None
    with _gone_if_empty(folder):
        try:
            _remove_stale(folder)
            staging, lock = _new_staging(folder)
            try:
                yield staging
            finally:
                shutil.rmtree(staging, ignore_errors=True)
                os.close(lock)
                shutil.rmtree(staging, ignore_errors=True)  # Windows keeps a file that is open
        except OSError as error:
            name = error.filename
            if name is None and error.errno is not None:
                error.filename = str(folder)
            elif staging is not None and isinstance(name, str) and Path(name).is_relative_to(staging / _NEW):
                error.filename = str(folder / Path(name).relative_to(staging / _NEW))
            raise


def _new_staging(folder: Path) -> tuple[Path, int]:
    """A staging folder and the lock that says its process is alive."""
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            staging = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=folder))
            lock = os.open(staging / _LOCK, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        except (FileNotFoundError, FileExistsError):
            continue  # another process has just taken it for a dead one's, or removed the folder that it had made
        try:
            if _locked(lock) is not False:
                (staging / _NEW).mkdir()
                return staging, lock
        except FileNotFoundError:
            pass  # likewise
        except BaseException:
            os.close(lock)
            shutil.rmtree(staging, ignore_errors=True)
            raise
        os.close(lock)


def _remove_stale(folder: Path) -> None:
    """The staging folders of processes that are no more."""
    for stale in folder.glob(f"{_PREFIX}*"):
        with suppress(OSError):
            lock = os.open(stale / _LOCK, os.O_RDWR | os.O_CREAT, 0o600)
            try:
                if dead := _locked(lock):
                    shutil.rmtree(stale, ignore_errors=True)
            finally:
                os.close(lock)
            if dead:
                shutil.rmtree(stale, ignore_errors=True)  # Windows keeps a file that is open


def _locked(file: int) -> bool | None:
    """Whether the lock is ours now; False: another process has it; None: the file system has no locks."""
    try:
        _lock(file)
    except OSError as error:
        return False if error.errno in (errno.EAGAIN, errno.EACCES, errno.EDEADLK) else None
    return True


def _require_places(folder: Path, names: Iterable[str]) -> None:
    """Raises InputError where a folder is in the place of a file."""
    taken = [name for name in names if (folder / name).is_dir()]
    expected = "a place for {}: move the folder away"
    raise_problems(Problem(folder / name, "file", "a folder of that name", expected.format(name)) for name in taken)


def _exchange(staging: Path, folder: Path, obsolete: Iterable[str]) -> None:
    """Move new files into the folder, the manifest last, and old ones out, the manifest first. An exception on the way
    leaves everything as it was."""
    new, old = staging / _NEW, staging / _OLD
    names = [name for name in _names(new) if name != MANIFEST]
    _require_places(folder, [*names, MANIFEST])
    old.mkdir()
    moved: list[tuple[Path, Path]] = []

    def move(source: Path, target: Path) -> None:
        moved.append((source, target))
        os.replace(source, target)

    try:
        for name in (MANIFEST, *names, *sorted(obsolete)):
            if (folder / name).is_file():
                move(folder / name, old / name)
        for name in (*names, MANIFEST):
            move(new / name, folder / name)
    except BaseException:
        for source, target in reversed(moved):
            with suppress(OSError):  # the move that failed
                os.replace(target, source)
        raise


def seen_from(folder: Path, path: str | Path) -> str:
    """A path as it has to stand in a file of that folder, so that both can be moved together, and nobody reads in it
    where they lay. One on another drive stays absolute."""
    try:
        return encodable(Path(os.path.relpath(path, folder.absolute())).as_posix())
    except ValueError:
        return encodable(str(path))


def name_seen_from(folder: Path, name: str) -> str:
    """The same of what may be the name of something built in."""
    return seen_from(folder, name) if Path(name).suffix else name


# -- which files belong together --------------------------------------------------------------------------------------

# A manifest goes before the first file of a run is replaced, and comes after the last (`staged_results`): a run that is
# killed in between leaves none, and a mixture of two runs is not taken for one.


@dataclass(frozen=True)
class _Manifest:
    """What one run wrote into a folder."""

    folder: Path
    files: Mapping[str, tuple[int, str]]
    """By name: size in bytes, and the SHA-256 of the content in hexadecimal digits."""

    @property
    def paths(self) -> list[Path]:
        """All of them, and the manifest itself."""
        return [self.folder / name for name in (*self.files, MANIFEST)]

    def changed(self, names: Iterable[str] | None = None) -> list[Problem]:
        """What is missing or is not as it was written, of the named files, or of all."""
        faults = ((name, self._fault(name)) for name in (self.files if names is None else names))
        return [Problem(self.folder / name, *fault, AGAIN) for name, fault in faults if fault]

    def require(self, *names: str) -> None:
        """Raises InputError unless these files are there and as the run wrote them."""
        raise_problems(self.changed(names))

    def _fault(self, name: str) -> tuple[str, str] | None:
        entry, path = self.files.get(name), self.folder / name
        if entry is None:
            return "file", f"no word of it in {MANIFEST}"
        try:
            if path.stat().st_size == entry[0] and sha256_of(path) == entry[1]:
                return None
        except OSError as error:
            there = not isinstance(error, FileNotFoundError)
            return "file", f"{error.strerror}" if there else f"no such file, which {MANIFEST} names"
        return "content", f"other than {MANIFEST} says: it was changed, or is of another run"


def read_manifest(folder: Path) -> _Manifest:
    """Raises InputError where there is none, as after a run that was interrupted while it wrote."""
    path = folder / MANIFEST
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != SCHEMA:
            raise ValueError
        files = {str(name): (int(entry["size"]), str(entry["sha256"])) for name, entry in content["files"].items()}
    except FileNotFoundError:
        found = f"no {MANIFEST}: of an interrupted run, or of an earlier version"
        raise InputError(Problem(folder, "folder", found, AGAIN)) from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        raise InputError(Problem(path, "content", "something else", AGAIN)) from None
    return _Manifest(folder, files)


def write_manifest(folder: Path) -> None:
    """Write the manifest of the files that are in the folder now."""
    files = {
        path.name: {"size": path.stat().st_size, "sha256": sha256_of(path)}
        for path in sorted(folder.iterdir())
        if path.name != MANIFEST and path.is_file()
    }
    text = json.dumps({"schema": SCHEMA, "files": files}, indent=1) + "\n"
    (folder / MANIFEST).write_text(text, encoding="utf-8", newline="\n")


def sha256_of(path: str | os.PathLike[str]) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


# -- not over others -------------------------------------------------------------------------------------------------


@contextmanager
def sole_writer(folder: str | Path, wait_s: float = 0.0) -> Iterator[None]:
    """While the block runs, no other process gets into a block like this for the same folder, which is made if need be.

    Raises InputError where another one is in it, after wait_s. A process that dies lets go of the folder.
    """
    _require_usable(Path(folder))
    path = Path(folder) / WRITING
    with _gone_if_empty(Path(folder)):
        lock = _only_lock(path, time.monotonic() + wait_s)
        try:
            yield
        finally:
            if sys.platform == "win32":
                os.close(lock)
                path.unlink(missing_ok=True)
            else:
                path.unlink(missing_ok=True)
                os.close(lock)


def _only_lock(path: Path, until_s: float) -> int:
    """The descriptor of the locked file."""
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except FileNotFoundError:
            continue  # the process that had made the folder has just removed it
        try:
            free, owner = _locked(lock), ""
            with suppress(FileNotFoundError):  # the process that had it before removes it
                if free is not False and os.path.samestat(os.fstat(lock), os.stat(path)):
                    with suppress(OSError):  # a full disk holds no number
                        os.truncate(lock, 0)
                        os.write(lock, f"{os.getpid()}\n".encode())
                    return lock
            with suppress(OSError):  # where a lock keeps it from being read
                owner = os.read(lock, 20).decode("ascii", "replace").strip()
        except BaseException:
            os.close(lock)
            raise
        os.close(lock)
        if free is False and time.monotonic() >= until_s:
            found = f"another process{f' ({owner})' if owner else ''}, which is writing to it"
            expected = "one at a time: wait until it has ended, or choose another folder"
            raise InputError(Problem(path.parent, "folder", found, expected))
        time.sleep(_POLL_S if free is False else 0.0)


def require_free_folder(out: Path, names: Iterable[str], overwrite: bool, expected: str = "results") -> None:
    """Raises InputError where `out` cannot become a folder to write to, or has files of these names (what is expected
    not to be there) that may not be replaced."""
    _require_usable(out)
    names = tuple(names)
    present = [name for name in names if (out / name).exists()]
    if present and not overwrite:
        more = f" and {len(present) - 1} more" if len(present) > 1 else ""
        found = f"{present[0]}{more} in {out}"
        raise InputError(Problem("--out", "folder", found, f"a folder without {expected}, or --overwrite"))
    _require_places(out, names)


def _require_usable(out: Path) -> None:
    there = next(path for path in (out, *out.absolute().parents) if path.exists())
    if not there.is_dir():
        raise InputError(Problem("--out", "folder", f"the file {there}", "a folder, which is made if need be"))
    if not os.access(there, os.W_OK | os.X_OK):
        raise InputError(Problem("--out", "folder", f"{there}, which may not be written to", "a folder of your own"))


def require_free_file(
    out: Path, overwrite: bool, option: str = "--out", source: Path | None = None, suffixes: Iterable[str] = ()
) -> None:
    """Raises InputError where a file is there already that may not be replaced, as the source never may, or where none
    can be. suffixes: one of which the name has to end in; any, if none are given."""
    if suffixes and out.suffix.lower() not in suffixes:
        expected = f"a file name that ends in {' or '.join(suffixes)}"
        raise InputError(Problem(option, "file", repr(str(out)), expected))
    if source is not None and out.resolve() == source.resolve():
        raise InputError(Problem(option, "file", f"{out}, which is the input", "a new name"))
    if out.exists() and not overwrite:
        raise InputError(Problem(option, "file", f"{out}, which is there already", "a new name, or --overwrite"))
    _require_usable(out.parent)
    _require_places(out.parent, [out.name])
