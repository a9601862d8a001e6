"""Write files whole or not at all, with a manifest of the files that one run wrote together.

`recon.base.outputs` decides which files a command may replace.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from recon.base.errors import InputError, Problem, raise_problems
from recon.base.file_names import encodable
from recon.base.locks import is_locked_here, removed_if_empty

MANIFEST = "manifest.json"
SCHEMA = {"name": "recon.manifest", "version": 1}
RUN_AGAIN = "the unchanged results of one run: run the command again, with --overwrite"
_PREFIX = ".recon-partial-"
_LOCK, NEW, _OLD = "lock", "new", "old"
"""Names in a staging folder: the file that its process keeps locked, the new files, and the files that they replace."""
_NO_LINKS = getattr(os, "O_NOFOLLOW", 0)


@contextmanager
def staged_folder(folder: str | Path) -> Iterator[Path]:
    """Yield a staging folder, whose files move into `folder` when the block ends without an exception.

    Each file replaces the file of the same name in one step, and other files in `folder` stay. After an exception
    nothing is left, not even a folder that was created for the files. If the process is killed, only a hidden
    staging folder is left, which the next run removes. Any number of processes may write into one folder at the same
    time. An OSError names the file that was to be written, or the folder. Commands write through
    `recon.base.outputs.Output`, which never replaces a user's files.
    """
    with staging_in(Path(folder)) as staging:
        yield staging / NEW
        require_no_folders(Path(folder), names_in(staging / NEW))
        for name in names_in(staging / NEW):
            os.replace(staging / NEW / name, Path(folder) / name)


@contextmanager
def staged_file(path: str | Path) -> Iterator[Path]:
    """Yield a path to write a single file to, which moves to `path` as in `staged_folder`."""
    path = Path(path)
    try:
        with staged_folder(path.parent) as folder:
            yield folder / path.name
    except OSError as error:
        if error.filename == str(path.parent):
            error.filename = str(path)
        raise


def write_text(path: str | Path, text: str) -> None:
    """Write a string to a file in UTF-8, so that the file is either complete or unchanged."""
    with staged_file(path) as staged:
        staged.write_text(encodable(text), encoding="utf-8")


def write_bytes(path: Path, content: bytes) -> None:
    """Write bytes to a file, or raise an OSError that names the path.

    Callers make the bytes in memory, because many libraries hang, crash or report nothing if the disk is full.
    """
    try:
        path.write_bytes(content)
    except OSError as error:
        error.filename = str(path)
        raise


def names_in(folder: Path) -> list[str]:
    """Return the sorted names of all files, folders and links in a folder."""
    return sorted(path.name for path in folder.iterdir())


@contextmanager
def staging_in(folder: Path) -> Iterator[Path]:
    """Yield a staging folder in `folder`, which is created if necessary, and remove it at the end of the block.

    New files are written to its subfolder `NEW`. Errors name the files by their final paths in `folder`.
    """
    staging = None
    with removed_if_empty(folder):
        try:
            _remove_stale(folder)
            staging, lock = _new_staging(folder)
            try:
                yield staging
            finally:
                shutil.rmtree(staging, ignore_errors=True)
                os.close(lock)
                shutil.rmtree(staging, ignore_errors=True)  # Windows does not delete open files
        except OSError as error:
            if error.filename is None and error.errno is not None:
                error.filename = str(folder)
            elif staging is not None and isinstance(error.filename, str):
                error.filename = str(_as_moved(Path(error.filename), staging, folder))
            raise
        except InputError as error:
            if staging is None:
                raise
            raise InputError(
                replace(problem, file=_as_moved(problem.file, staging, folder)) if isinstance(problem.file, Path)
                else problem
                for problem in error.problems
            ) from None  # fmt: skip


def _as_moved(path: Path, staging: Path, folder: Path) -> Path:
    """Return the final path of a file in the staging folder."""
    return folder / path.relative_to(staging / NEW) if path.is_relative_to(staging / NEW) else path


def _new_staging(folder: Path) -> tuple[Path, int]:
    """Return a staging folder, and the lock that shows that its process is running."""
    while True:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            staging = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=folder))
            lock = os.open(staging / _LOCK, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        except (FileNotFoundError, FileExistsError):
            continue  # another process has just removed `staging` as abandoned, or has removed `folder`
        try:
            if is_locked_here(lock) is not False:
                (staging / NEW).mkdir()
                return staging, lock
        except FileNotFoundError:
            pass  # another process has just removed `staging`
        except BaseException:
            os.close(lock)
            shutil.rmtree(staging, ignore_errors=True)
            raise
        os.close(lock)


def _remove_stale(folder: Path) -> None:
    """Remove the staging folders of processes that have ended, but nothing else with a similar name."""
    for stale in folder.glob(f"{_PREFIX}*"):
        with suppress(OSError):
            if stale.is_symlink() or not {*names_in(stale)} <= {_LOCK, NEW, _OLD}:
                continue
            lock = os.open(stale / _LOCK, os.O_RDWR | os.O_CREAT | _NO_LINKS, 0o600)
            try:
                if dead := is_locked_here(lock):
                    shutil.rmtree(stale, ignore_errors=True)
            finally:
                os.close(lock)
            if dead:
                shutil.rmtree(stale, ignore_errors=True)  # Windows does not delete open files


def require_no_folders(folder: Path, names: Iterable[str]) -> None:
    """Raise InputError if a folder has the name of a file that is to be written."""
    taken = [name for name in names if (folder / name).is_dir()]
    expected = "no folder called {}: move it away"
    raise_problems(Problem(folder / name, "file", "a folder of that name", expected.format(name)) for name in taken)


class FileState(NamedTuple):
    """Size, time and inode of a file, which show whether the file changes later."""

    size: int
    modified_ns: int
    inode: int

    @classmethod
    def read(cls, path: Path) -> FileState:
        """Return the state of a file, or of a link instead of its target."""
        state = os.lstat(path)
        return cls(state.st_size, state.st_mtime_ns, state.st_ino)


def exchange(staging: Path, folder: Path, leaving: Mapping[str, FileState]) -> None:
    """Move old files out of a folder, and new files into it.

    The manifest is the first file to leave and the last to arrive. After an exception the folder is unchanged.

    Parameters
    ----------
    staging
        Staging folder of `staging_in`, with the new files.
    folder
        The destination.
    leaving
        States of the files that are replaced or removed, when they were examined, keyed by the files' names.

    Raises
    ------
    InputError
        If a file with one of the new names has appeared in the meantime, or a file to be removed has changed.
    """
    new, old = staging / NEW, staging / _OLD
    names = sorted(names_in(new), key=lambda name: (name == MANIFEST, name))
    old.mkdir()
    inodes = {name: os.lstat(new / name).st_ino for name in names}
    try:
        for name in sorted(leaving, key=lambda name: (name != MANIFEST, name)):
            os.replace(folder / name, old / name)
            if FileState.read(old / name) != leaving[name]:
                expected = "a file that does not change during the run: run the command again"
                raise InputError(Problem(folder / name, "file", "a file that has just been changed", expected))
        for name in names:
            _move_in(new / name, folder / name)
    except BaseException:
        for name in names:
            with suppress(OSError):  # the file had not been moved yet
                if os.lstat(folder / name).st_ino == inodes[name]:
                    (folder / name).unlink()
        for name in names_in(old):
            with suppress(OSError):
                os.replace(old / name, folder / name)
        raise


def _move_in(source: Path, target: Path) -> None:
    """Move a file to a free name, without replacing a file created at the same moment."""
    try:
        os.link(source, target)
    except FileExistsError:
        expected = "no other run that writes this file: run the command again"
        raise InputError(Problem(target, "file", "a file that has just appeared", expected)) from None
    except OSError:  # the file system has no hard links
        os.replace(source, target)
    else:
        source.unlink()


def relative_path(folder: Path, path: str | Path) -> str:
    """Return a path relative to a folder, to be written into a file in that folder.

    The folder and the file at the path can then be moved together, and the text does not reveal where they were. A path
    on another drive stays absolute.
    """
    try:
        return encodable(Path(os.path.relpath(path, folder.absolute())).as_posix())
    except ValueError:
        return encodable(str(path))


def relative_name(folder: Path, name: str) -> str:
    """Return the path of a file relative to a folder, or the name of a built-in item unchanged."""
    return relative_path(folder, name) if Path(name).suffix else name


def is_plain_name(name: str) -> bool:
    """Return whether a name belongs to a file in the folder itself and does not lead out of it."""
    return name not in ("", ".", "..") and "\0" not in name and name == os.path.basename(name)


# The manifest is removed before the first file of a run is replaced, and added after the last (`exchange`). A killed
# run therefore leaves no manifest, so that files of two runs are never taken for the files of one run.


@dataclass(frozen=True)
class Manifest:
    """List of the files that one run wrote into a folder."""

    folder: Path
    files: Mapping[str, tuple[int, str]]
    """Size in bytes and SHA-256 (hexadecimal) of each file, keyed by the file's name."""
    kind: str | None = None
    """Command that wrote the files, such as fit; None in manifests of version 0.2."""

    @property
    def paths(self) -> list[Path]:
        """Return the paths of all files and of the manifest."""
        return [self.folder / name for name in (*self.files, MANIFEST)]

    @property
    def text(self) -> str:
        """Return the text of the manifest file."""
        files = {name: {"size": size, "sha256": sha256} for name, (size, sha256) in self.files.items()}
        kind = {} if self.kind is None else {"kind": self.kind}
        return json.dumps({"schema": SCHEMA, **kind, "files": files}, indent=1) + "\n"

    def changed(self, names: Iterable[str] | None = None) -> list[Problem]:
        """Return a problem for each named file, by default for each file, that is missing or was changed."""
        faults = ((name, self._fault(name)) for name in (self.files if names is None else names))
        return [Problem(self.folder / name, *fault, RUN_AGAIN) for name, fault in faults if fault]

    def require(self, *names: str) -> None:
        """Raise InputError unless the named files exist and have not changed since the run wrote them."""
        raise_problems(self.changed(names))

    def _fault(self, name: str) -> tuple[str, str] | None:
        entry, path = self.files.get(name), self.folder / name
        if entry is None:
            return "file", f"a file that {MANIFEST} does not list"
        try:
            if path.stat().st_size == entry[0] and sha256_of(path) == entry[1]:
                return None
        except OSError as error:
            is_missing = isinstance(error, FileNotFoundError)
            return "file", f"no such file, although {MANIFEST} lists it" if is_missing else f"{error.strerror}"
        return "content", f"not the file that {MANIFEST} lists: it was changed, or belongs to another run"


def read_manifest(folder: Path) -> Manifest:
    """Read the manifest of a folder.

    Raises
    ------
    InputError
        If there is no manifest, for example after a run was interrupted while writing, or if the manifest names files
        outside the folder.
    """
    path = folder / MANIFEST
    try:
        if path.exists() and not path.is_file():
            raise ValueError
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != SCHEMA:
            raise ValueError
        files = {str(name): (int(entry["size"]), str(entry["sha256"])) for name, entry in content["files"].items()}
        kind = content.get("kind")
        if not isinstance(kind, str | None):
            raise ValueError
    except FileNotFoundError:
        actual = f"no {MANIFEST}: the run was interrupted, or made by an earlier version"
        raise InputError(Problem(folder, "folder", actual, RUN_AGAIN)) from None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError, OverflowError):
        raise InputError(Problem(path, "content", "another kind of file", RUN_AGAIN)) from None
    if outside := [name for name in files if not is_plain_name(name)]:
        raise InputError(Problem(path, "files", repr(outside[0]), "names of files in its own folder"))
    return Manifest(folder, files, kind)


def write_manifest(folder: Path, kind: str | None = None) -> None:
    """Write the manifest of the files in a folder, which the command `kind` wrote."""
    paths = [path for path in sorted(folder.iterdir()) if path.name != MANIFEST and path.is_file()]
    manifest = Manifest(folder, {path.name: (path.stat().st_size, sha256_of(path)) for path in paths}, kind)
    (folder / MANIFEST).write_text(manifest.text, encoding="utf-8", newline="\n")


def _open_at_once(path: str, flags: int) -> int:
    """Open a file without blocking if it is a pipe."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def sha256_of(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a file's content in hexadecimal digits.

    Raises
    ------
    OSError
        If the path is a pipe or a device, which may have no end.
    """
    with open(path, "rb", opener=_open_at_once) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "not a regular file", os.fspath(path))
        return hashlib.file_digest(file, "sha256").hexdigest()


def digest(path: Path) -> str | None:
    """Return the digest of a file's present content, or None if it cannot be read."""
    try:
        return sha256_of(path)
    except OSError:
        return None
