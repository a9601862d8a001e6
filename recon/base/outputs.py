"""Decide what a command may write: no file of the user is ever replaced or deleted.

A command replaces or deletes only files that an earlier run of the same kind wrote and that nobody has changed since.
Size and SHA-256 identify these files. `RECORD`, a hidden file in every folder that recon writes to, lists them, and so
does the folder's manifest, if there is one. Everything else stays: inputs of the run that is starting, links, folders,
files of a user or of another command. A command that would have to replace such a file stops with a message before it
changes anything. This holds for a folder and for a single file that the user names, as in --out camera.toml.

`RECORD` gets the new digests before the first file moves, and loses the old ones after the last. Files that a killed
run leaves are therefore recognised again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from recon.base.errors import InputError, Problem, raise_problems
from recon.base.file_names import encodable
from recon.base.files import (
    MANIFEST,
    NEW,
    FileState,
    digest,
    exchange,
    is_plain_name,
    names_in,
    read_manifest,
    relative_path,
    require_no_folders,
    sha256_of,
    staging_in,
    write_manifest,
    write_text,
)
from recon.base.locks import committing, require_usable

RECORD = ".recon.json"
SCHEMA = {"name": "recon.files", "version": 1}
MAX_NAMED_FILES = 3
"""Maximum number of files that a message names."""


@dataclass(frozen=True)
class WrittenFile:
    """Origin, size and checksum of an output file, recorded when the file was written."""

    kind: str
    """Command that wrote the file, such as analyse."""
    size: int
    """Size in bytes."""
    sha256: str
    """SHA-256 of the content, in hexadecimal digits."""
    results: str | None = None
    """Results folder from which the file was made, relative to the file's folder; None if it was not made from results.
    """
    manifest: str | None = None
    """SHA-256 of the results' manifest when the file was made; None without results."""
    is_named: bool = False
    """Whether the user named the file itself, not its folder, so that the file stays when its results are removed."""


_Written = dict[str, tuple[WrittenFile, ...]]
"""Versions of files that recon may have left in a folder, by file name."""


def read_record(folder: Path) -> _Written:
    """Return the files that recon wrote into a folder, from its `RECORD`; empty without a record.

    Raises
    ------
    InputError
        If `RECORD` is another kind of file.
    """
    path = folder / RECORD
    try:
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise ValueError
        content = json.loads(path.read_text(encoding="utf-8"))
        if content["schema"] != SCHEMA or not all(map(is_plain_name, content["files"])):
            raise ValueError
        return {name: tuple(_entry(**entry) for entry in entries) for name, entries in content["files"].items()}
    except (FileNotFoundError, NotADirectoryError):
        return {}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        expected = "recon's record of its output files: move this file away"
        raise InputError(Problem(path, "content", "another kind of file", expected)) from None


def _entry(**stored: Any) -> WrittenFile:
    """Return an entry of a record, or raise TypeError for impossible values."""
    entry = WrittenFile(**stored)
    types = {"kind": str, "size": int, "sha256": str, "results": str | None, "manifest": str | None, "is_named": bool}
    if not all(isinstance(getattr(entry, name), kind) for name, kind in types.items()):
        raise TypeError
    return entry


def _write_record(folder: Path, written: Mapping[str, Sequence[WrittenFile]]) -> None:
    """Write the `RECORD` of a folder, or remove it if it would be empty."""
    files = {
        name: [{key: value for key, value in vars(entry).items() if value or key == "size"} for entry in entries]
        for name, entries in sorted(written.items())
        if entries
    }
    if files:
        write_text(folder / RECORD, json.dumps({"schema": SCHEMA, "files": files}, indent=1) + "\n")
    else:
        (folder / RECORD).unlink(missing_ok=True)


def _is_as_written(path: Path, entries: Iterable[WrittenFile]) -> bool:
    """Return whether a file, not a link, has content that recon wrote."""
    try:
        if path.is_symlink() or not path.is_file():
            return False
        size = path.stat().st_size
        known = {entry.sha256 for entry in entries if entry.size == size}
        return bool(known) and sha256_of(path) in known
    except OSError:
        return False


@dataclass(frozen=True)
class ReadResults:
    """Version of the results in a folder at the time when a command began to read them."""

    folder: Path
    manifest: str | None
    """SHA-256 of the results' manifest; None without a manifest."""

    @classmethod
    def read(cls, folder: Path) -> ReadResults:
        """Return the present version of the results in a folder."""
        return cls(folder, digest(folder / MANIFEST))

    @contextmanager
    def unchanged(self) -> Iterator[None]:
        """Keep the results from being replaced during the block.

        Raises
        ------
        InputError
            If the results were replaced since they were read.
        """
        with ExitStack() as stack:
            if os.access(self.folder, os.W_OK | os.X_OK):
                stack.enter_context(committing(self.folder))
            self.require_unchanged()
            yield

    def require_unchanged(self) -> None:
        """Raise InputError if the folder no longer has the results that were read."""
        if digest(self.folder / MANIFEST) != self.manifest:
            change = "results that another run has replaced since they were read"
            raise InputError(
                Problem(
                    self.folder, "results", change, "results that do not change during the run: run the command again"
                )
            )


def is_current(path: Path, results: Path) -> bool:
    """Return whether a file, such as an analysis, was made from the present results of a folder."""
    try:
        entries = read_record(path.parent).get(path.name, ())
    except InputError:
        return False
    current_sha256 = digest(results / MANIFEST)
    return any(_is_made_from(entry, path.parent, results) and entry.manifest == current_sha256 for entry in entries)


def _is_made_from(entry: WrittenFile, folder: Path, results: Path) -> bool:
    """Return whether a file in a folder was made from present or earlier results in another folder."""
    if entry.results is None:
        return False
    return os.path.realpath(folder / entry.results) == os.path.realpath(results)


def _is_removed_with(entry: WrittenFile, folder: Path, results: Path) -> bool:
    """Return whether a file is removed together with the results from which it was made."""
    return _is_made_from(entry, folder, results) and not entry.is_named


@dataclass(frozen=True)
class Output:
    """Folder to which a command writes."""

    folder: Path
    kind: str
    """Command to which the files belong, such as analyse."""
    overwrite: bool = False
    """Whether unchanged files of an earlier run of the same command may be replaced."""
    inputs: Sequence[Path] = ()
    """Files and folders that the run reads."""
    made_from: ReadResults | None = None
    """Results from which the files are made; None if the run reads no results."""
    exact: str | None = None
    """Name of the file, if the user named a single file instead of a folder."""
    has_manifest: bool = False
    """Whether the files are results with a manifest.

    If results are replaced, the files that were made from them are removed.
    """
    mark: str = ""
    """Name of a file that identifies a manifest of version 0.2, which does not state its command."""
    content: str = "results"
    """Noun for the files in messages."""
    option: str = "--out"
    """Option that names the folder or file, for messages; "" if there is no such option."""

    def require(self, names: Iterable[str] = ()) -> None:
        """Raise InputError if the folder cannot be written to, or if one of the named files may not be replaced.

        Callers use this method before any work is done, and `staged` checks again.
        """
        require_usable(self.folder)
        self._require_replaceable(names, self._written(), adds=self.exact is not None)

    @contextmanager
    def staged(self, adds: bool = False) -> Iterator[Path]:
        """Yield a staging folder, whose files move into the output folder at the end of the block, all or none.

        Earlier files of the same kind that are not replaced stay if `adds` is true, and are removed if it is false.

        Raises
        ------
        InputError
            In the cases of `require`, or if the results from which the files were made have been replaced.
        """
        with staging_in(self.folder) as staging:
            try:
                yield staging / NEW
            except OSError as error:
                if self.exact is not None and error.filename is None and error.errno is not None:
                    error.filename = str(self.folder / self.exact)
                raise
            if self.has_manifest:
                write_manifest(staging / NEW, self.kind)
            with ExitStack() as stack:
                source = self.made_from
                if source is not None and not _is_same(source.folder, self.folder):
                    stack.enter_context(source.unchanged())
                stack.enter_context(committing(self.folder))
                if source is not None:
                    source.require_unchanged()
                self._commit(staging, adds)

    @contextmanager
    def staged_file(self) -> Iterator[Path]:
        """Yield a path for the single file that the user named, which moves into the output folder as in `staged`."""
        assert self.exact is not None
        with self.staged(adds=True) as folder:
            yield folder / self.exact

    def write(self, name: str, text: str) -> None:
        """Write a text file without touching the other files."""
        with self.staged(adds=True) as folder:
            (folder / name).write_text(encodable(text), encoding="utf-8")

    def remove(self, name: str) -> None:
        """Delete a file if an earlier run of the same command wrote it."""
        path = self.folder / name
        if not os.path.lexists(path):
            return
        with committing(self.folder):
            written = read_record(self.folder)
            if self._is_own(name, self._written()):
                path.unlink()
                _write_record(self.folder, written | {name: ()})

    def _written(self) -> _Written:
        """Return the files of earlier runs, from the folder's record and manifest."""
        written = read_record(self.folder)
        with suppress(InputError, OSError):
            manifest = read_manifest(self.folder)
            if manifest.kind is None and self.mark not in manifest.files:
                return written
            kind = manifest.kind or self.kind
            known = {name: WrittenFile(kind, *entry) for name, entry in manifest.files.items()}
            text = manifest.text.encode()
            if (self.folder / MANIFEST).read_bytes() == text:  # unchanged since it was written
                known[MANIFEST] = WrittenFile(kind, len(text), sha256_of(self.folder / MANIFEST))
            for name, entry in known.items():
                written[name] = (*written.get(name, ()), entry)
        return written

    def _is_own(self, name: str, written: _Written) -> bool:
        """Return whether a file was written by an earlier run of the same command, and has not been changed."""
        return _is_as_written(self.folder / name, (e for e in written.get(name, ()) if e.kind == self.kind))

    def _is_input(self, name: str) -> bool:
        path = self.folder / name
        with suppress(OSError):
            return any(path.samefile(input_path) for input_path in self.inputs if input_path.is_file())
        return False

    def _require_replaceable(self, names: Iterable[str], written: _Written, adds: bool) -> None:
        """Raise InputError unless each name is free, or its file may be replaced.

        Without --overwrite, earlier results of the same command are refused too, unless this run adds to them.
        """
        names = [name for name in names if os.path.lexists(self.folder / name)]
        links = [name for name in names if (self.folder / name).is_symlink()]
        raise_problems(self._refused(links, "a link, which is not followed"))
        require_no_folders(self.folder, names)
        raise_problems(self._refused([name for name in names if self._is_input(name)], "an input of this run"))
        foreign = [name for name in names if not self._is_own(name, written)]
        description = f"a file that this version of `recon {self.kind}` did not write, or that was changed since"
        raise_problems(self._refused(foreign, description))
        if self.exact is not None and not self.overwrite:
            raise_problems(self._already_exists(name) for name in names)
        if not adds and not self.overwrite:
            names += [name for name in written if name not in names and self._is_own(name, written)]
        if self.exact is None and names and not self.overwrite:
            rest = f" and {len(names) - 1} more" if len(names) > 1 else ""
            contents = f"{names[0]}{rest} in {self.folder}"
            expected = f"a folder without {self.content}, or --overwrite"
            raise InputError(Problem(self.option, "folder", contents, expected))

    def _already_exists(self, name: str) -> Problem:
        existing = f"{self.folder / name}, which exists already"
        return Problem(self.option, "file", existing, "a new name, or --overwrite")

    def _refused(self, names: Sequence[str], description: str) -> Iterator[Problem]:
        """Yield one problem for all files that may not be replaced."""
        if names:
            listed, count = names[1 : 1 + MAX_NAMED_FILES], len(names) - 1
            remaining = f" and {count - MAX_NAMED_FILES} more" * (count > MAX_NAMED_FILES)
            rest = f"; the same holds for {', '.join(listed)}{remaining}" if listed else ""
            way_out = f"another {self.option}, or " if self.option else ""
            expected = f"{way_out}the file moved away: recon would have to replace it"
            yield Problem(self.folder / names[0], "file", description + rest, expected)

    def _commit(self, staging: Path, adds: bool) -> None:
        """Move the new files into the folder, and the replaced files out of it."""
        folder, names = self.folder, names_in(staging / NEW)
        record, written = read_record(folder), self._written()
        self._require_replaceable(names, written, adds)
        leaving = [name for name in names if os.path.lexists(folder / name)]
        if not adds:
            leaving += [name for name in written if name not in names and self._is_removable(name, written)]
        states = {name: FileState.read(folder / name) for name in leaving}
        new = {name: self._entry(staging / NEW / name) for name in names}
        known = {name: (*record.get(name, ()), *written.get(name, ()), entry) for name, entry in new.items()}
        _write_record(folder, record | known)
        try:
            exchange(staging, folder, states)
        except BaseException:
            with suppress(OSError):
                _write_record(folder, record)
            raise
        kept = {name: entries for name, entries in record.items() if os.path.lexists(folder / name)}
        with suppress(OSError):  # if this fails, the record only lists too many files
            _write_record(folder, kept | {name: (entry,) for name, entry in new.items()})
        if self.has_manifest:
            _remove_made_from(folder)

    def _is_removable(self, name: str, written: _Written) -> bool:
        """Return whether a file of an earlier run is stale and has to be removed.

        Files of the same kind that this run does not write are stale, and so are files that were made from them.
        """
        entries = written[name]
        if self._is_input(name) or not os.path.lexists(self.folder / name):
            return False
        own_entries = [
            entry
            for entry in entries
            if entry.kind == self.kind or (self.has_manifest and _is_removed_with(entry, self.folder, self.folder))
        ]
        return _is_as_written(self.folder / name, own_entries)

    def _entry(self, path: Path) -> WrittenFile:
        source = self.made_from
        results = None if source is None else relative_path(self.folder, source.folder.absolute())
        manifest = None if source is None else source.manifest
        is_named = path.name == self.exact
        return WrittenFile(self.kind, path.stat().st_size, sha256_of(path), results, manifest, is_named)


def output_file(
    path: Path,
    kind: str,
    overwrite: bool,
    inputs: Sequence[Path] = (),
    made_from: ReadResults | None = None,
    option: str = "--out",
) -> Output:
    """Return the output of a command that writes the single file that the user names."""
    return Output(path.parent, kind, overwrite, inputs, made_from, exact=path.name, option=option)


def require_suffix(path: Path, suffixes: Iterable[str], option: str = "--out") -> None:
    """Raise InputError unless the file's name ends in one of the suffixes."""
    if path.suffix.lower() not in suffixes:
        expected = f"a file name that ends in {' or '.join(suffixes)}"
        raise InputError(Problem(option, "file", repr(str(path)), expected))


def adopt(folder: Path, kind: str, digests: Mapping[str, str]) -> None:
    """Record files in a folder as written by the command `kind`.

    `digests` holds the SHA-256 of each file from another record, keyed by the file's name.
    """
    with committing(folder):
        written = read_record(folder)
        for name, sha256 in digests.items():
            path = folder / name
            if is_plain_name(name) and name not in written and path.is_file() and not path.is_symlink():
                written[name] = (WrittenFile(kind, path.stat().st_size, sha256),)
        _write_record(folder, written)


def _remove_made_from(results: Path) -> None:
    """Delete unchanged files that were made from a folder's earlier results, in the folders below it."""
    for folder in sorted(path.parent for path in results.glob(f"*/{RECORD}")):
        if folder.is_symlink():
            continue
        with suppress(InputError, OSError), committing(folder):
            written = read_record(folder)
            for name, entries in [*written.items()]:
                made = [entry for entry in entries if _is_removed_with(entry, folder, results)]
                if made and _is_as_written(folder / name, made):
                    (folder / name).unlink()
                    del written[name]
            _write_record(folder, written)
        with suppress(OSError):  # the folder contains files of the user
            folder.rmdir()


def _is_same(a: Path, b: Path) -> bool:
    return os.path.realpath(a) == os.path.realpath(b)
