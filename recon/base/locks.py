"""Let only one process at a time write to a folder."""

from __future__ import annotations

import errno
import os
import re
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from recon.base.errors import InputError, Problem

if sys.platform == "win32":
    import msvcrt

    def _lock(file: int) -> None:
        msvcrt.locking(file, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(file: int) -> None:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)


WRITING = ".recon-writing"
"""Lock file of the process that writes to a folder."""
COMMITTING = ".recon-commit"
"""Lock file of the process that moves new files into a folder."""
COMMIT_WAIT_S = 30.0
_POLL_S = 0.05
_OWN_CONTENT = re.compile(rb"\d{0,19}\n?")
"""Content of recon's lock files: the number of a process."""
_NO_LINKS = getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)


def is_locked_here(file: int) -> bool | None:
    """Try to lock an open file, and return whether this process has the lock; None without locks in the file system."""
    try:
        _lock(file)
    except OSError as error:
        return False if error.errno in (errno.EAGAIN, errno.EACCES, errno.EDEADLK) else None
    return True


@contextmanager
def sole_writer(folder: str | Path, wait_s: float = 0.0) -> Iterator[None]:
    """Let only this process write to a folder, which is created if necessary, during the block.

    The lock stops other processes that use `sole_writer`. A process that dies releases the lock.

    Raises
    ------
    InputError
        If another process still has the lock after `wait_s` seconds, or the lock file is not recon's own.
    """
    require_usable(Path(folder))
    with removed_if_empty(Path(folder)), _exclusive(Path(folder) / WRITING, wait_s):
        yield


@contextmanager
def sole_editor(file: Path) -> Iterator[None]:
    """Let only this process edit a file during the block.

    The lock stops other processes that use `sole_editor`.

    Raises
    ------
    InputError
        If another process has the lock, or the lock file is not recon's own.
    """
    require_usable(file.parent)
    with ExitStack() as stack:
        stack.enter_context(removed_if_empty(file.parent))
        try:
            stack.enter_context(_exclusive(file.with_name(f".{file.name}{WRITING}"), 0.0))
        except InputError as error:
            if error.problems[0].field != "folder":
                raise
            expected = "one editor at a time: close the other one, or give another --out"
            raise InputError(Problem(file, "file", "a file that is open in another editor", expected)) from None
        yield


@contextmanager
def committing(folder: Path) -> Iterator[None]:
    """Keep other processes from moving files into or out of the folder during the block."""
    with _exclusive(folder / COMMITTING, COMMIT_WAIT_S):
        yield


@contextmanager
def removed_if_empty(folder: Path) -> Iterator[None]:
    """Remove a folder that the block creates, and its parents, if they are empty at the end."""
    made = [p for p in (folder, *folder.parents) if not p.exists()]
    try:
        yield
    finally:
        for path in made:
            with suppress(OSError):  # the folder was not created, or is not empty
                path.rmdir()


@contextmanager
def _exclusive(path: Path, wait_s: float) -> Iterator[None]:
    lock = _locked_file(path, time.monotonic() + wait_s)
    try:
        yield
    finally:
        if sys.platform == "win32":
            os.close(lock)
        with suppress(OSError):  # another user's lock file, in a folder that protects it
            path.unlink(missing_ok=True)
        if sys.platform != "win32":
            os.close(lock)


def _locked_file(path: Path, until_s: float) -> int:
    """Lock a file and return its descriptor, or raise InputError if another process holds the lock until `until_s`."""
    while True:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            lock, is_writable = _open(path)
        except FileNotFoundError:
            continue  # the process that created the folder or the file has just removed it
        owner = ""
        try:
            is_free = is_locked_here(lock)
            if is_free is None and not is_writable:
                raise _not_usable(path)
            with suppress(FileNotFoundError):  # the previous holder of the lock removes the file
                if is_free is not False and os.path.samestat(os.fstat(lock), os.lstat(path)):
                    if is_writable:
                        with suppress(OSError):  # the disk is full
                            os.truncate(lock, 0)
                            os.write(lock, f"{os.getpid()}\n".encode())
                    return lock
            with suppress(OSError):  # locked files may be unreadable
                owner = os.read(lock, 20).decode("ascii", "replace").strip()
        except BaseException:
            os.close(lock)
            raise
        os.close(lock)
        if is_free is False and time.monotonic() >= until_s:
            owner_text = f"another process{f' ({owner})' if owner else ''}, which is writing to it"
            expected = "one process at a time: wait until it has ended, or choose another folder"
            raise InputError(Problem(path.parent, "folder", owner_text, expected))
        time.sleep(_POLL_S if is_free is False else 0.0)


def _open(path: Path) -> tuple[int, bool]:
    """Open a new lock file, or one that another run left, and return whether its content may be written.

    Links are not followed, and nothing is written to a file that may be a user's.
    """
    try:
        return os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL | _NO_LINKS, 0o666), True
    except FileExistsError:
        pass
    except OSError as error:
        error.filename = str(path.parent)  # users do not know the name of the lock file
        raise
    if path.is_symlink():
        raise _not_usable(path)
    is_writable = True
    try:
        lock = os.open(path, os.O_RDWR | _NO_LINKS)
    except PermissionError:
        is_writable = False
        try:
            lock = os.open(path, os.O_RDONLY | _NO_LINKS)
        except PermissionError:
            raise _not_usable(path) from None
    except FileNotFoundError:
        raise
    except OSError:
        raise _not_usable(path) from None
    try:
        state = os.fstat(lock)
        content = b""
        with suppress(OSError):  # locked files may be unreadable
            content = os.pread(lock, 21, 0) if hasattr(os, "pread") else os.read(lock, 21)
            os.lseek(lock, 0, os.SEEK_SET)
        if not stat.S_ISREG(state.st_mode) or state.st_nlink > 1 or not _OWN_CONTENT.fullmatch(content):
            raise _not_usable(path)
    except BaseException:
        os.close(lock)
        raise
    return lock, is_writable


def _not_usable(path: Path) -> InputError:
    """Return the error about a lock file that cannot be locked, or about another file with its name."""
    try:
        state = os.lstat(path)
    except OSError:
        fault = "a lock file that cannot be opened"
    else:
        if stat.S_ISREG(state.st_mode) and state.st_nlink == 1 and state.st_uid != _user():
            fault = f"a lock file of another user ({_name_of(state.st_uid)}), whose run may have been killed"
        else:
            fault = "a file or link that is not a lock file of recon"
    expected = "no lock file: remove it if no run is still writing to the folder, or choose another folder"
    return InputError(Problem(path, "lock", fault, expected))


def _user() -> int:
    return os.geteuid() if hasattr(os, "geteuid") else 0


def _name_of(user: int) -> str:
    try:
        import pwd

        return pwd.getpwuid(user).pw_name
    except (ImportError, KeyError):
        return str(user)


def require_usable(out: Path) -> None:
    """Raise InputError unless `out` is a folder that can be written to, or can be created."""
    existing = next(path for path in (out, *out.absolute().parents) if os.path.lexists(path))
    if not existing.exists():
        target = f"{existing}, a link that points to nothing"
        raise InputError(Problem("--out", "folder", target, "a folder (it is created if needed): remove the link"))
    if not existing.is_dir():
        raise InputError(Problem("--out", "folder", f"the file {existing}", "a folder (it is created if needed)"))
    if not os.access(existing, os.W_OK | os.X_OK):
        raise InputError(Problem("--out", "folder", f"{existing}, which may not be written to", "a folder of your own"))
