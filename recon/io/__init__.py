"""Keypoint files: one module per format, and the table of them all.

A new format is one module with `recognises(path)` and `read(path, individual)`, and one line in `READERS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from recon.documents import require_file
from recon.errors import InputError, Problem
from recon.io import coco, columns, deeplabcut, mmpose, movement, nwb, sleap
from recon.io.common import NoChoiceError, with_likelihoods
from recon.io.hdf5 import is_hdf5
from recon.keypoints import Keypoints


@dataclass(frozen=True)
class Reader:
    """One format that can be read."""

    name: str
    recognises: Callable[[Path], bool]
    """Whether a readable file, not empty, is of this format. It looks at the content, not at the name, and raises
    InputError for a file so damaged that this cannot be told."""
    read: Callable[[Path, str | None], Keypoints]
    """The keypoints of one animal, from a file that is recognised; raises InputError."""


READERS: tuple[Reader, ...] = (
    Reader("DeepLabCut CSV or H5", deeplabcut.recognises, deeplabcut.read),
    Reader("SLEAP analysis H5", sleap.recognises, sleap.read),
    Reader("movement netCDF", movement.recognises, movement.read),
    Reader("ndx-pose NWB", nwb.recognises, nwb.read),
    Reader("COCO JSON", coco.recognises, coco.read),
    Reader("MMPose JSON", mmpose.recognises, mmpose.read),
    Reader("plain CSV, long or wide", columns.recognises, columns.read),
)


def read_keypoints(path: str | Path, individual: str | None = None) -> Keypoints:
    """The keypoints of one animal, as the file states them (see `recon.keypoints.clean`), in any known format.

    individual: the animal's name, needed where the file holds several. Raises InputError for a file that is missing,
    empty, of no known format, or faulty.
    """
    path = Path(path)
    head = file_head(path)
    for reader in READERS:
        if reader.recognises(path):
            return with_likelihoods(reader.read(path, individual), path)
    raise InputError(Problem(path, "format", describe(head), "one of: " + ", ".join(r.name for r in READERS)))


def individuals(path: str | Path) -> tuple[str, ...]:
    """The animals with points in a file of several; none for a file of one, or one that cannot be read."""
    try:
        if not _is_of_one(Path(path)):
            read_keypoints(path)
    except NoChoiceError as error:
        return error.animals
    except InputError:  # said when it is read
        pass
    return ()


def _is_of_one(path: Path) -> bool:
    """Whether it can be told without reading all of it: DeepLabCut's CSV names animals in its first rows."""
    named = b"individuals" in file_head(path, 1 << 18)  # a row with the network's name in every column is before it
    return not named and not is_hdf5(path) and deeplabcut.recognises(path)


def file_head(path: Path, length: int = 64) -> bytes:
    """The first bytes of a file. Raises InputError where there is no file to read, or nothing in it."""
    require_file(path)
    try:
        with path.open("rb") as file:
            head = file.read(length)
    except OSError as error:
        found = f"a file that cannot be opened ({error.strerror})"
    else:
        if head:
            return head
        found = "an empty file"
    raise InputError(Problem(path, "file", found, "a file that can be read"))


def describe(head: bytes) -> str:
    """What the first bytes of a file of no known format look like, in the user's words."""
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        return "an HDF5 file of another kind"
    text = head.decode("utf-8", errors="ignore").lstrip("\ufeff").strip()
    # The head may end in the middle of a character of up to 4 bytes; more than that is lost only from binary files.
    if len(text.encode()) < len(head.strip()) - 6 or not all(c.isprintable() or c.isspace() for c in text):
        return "a binary file"
    return f"a file that begins with '{text.splitlines()[0][:40]}'" if text else "a file of blanks"
