"""Files of keypoints and of 3D positions: one module per format, and the table of them all.

A new format is one module with `recognises(path)` and `read(path, individual)`, and one line in `FORMATS`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from recon.base.documents import require_file
from recon.base.errors import InputError, Problem
from recon.clip.keypoints import Keypoints
from recon.io import bvh, c3d, coco, columns, deeplabcut, mmpose, movement, npz, nwb, parquet, sleap, trc
from recon.io.common import NoChoiceError, with_likelihoods
from recon.io.hdf5 import is_hdf5
from recon.io.pose import StoredPoints

Kind = Literal["2D", "3D"]


@dataclass(frozen=True)
class Reader:
    """One format that can be read."""

    name: str
    recognises: Callable[[Path], bool]
    """Whether a readable file, not empty, is of this format. It looks at the content, not at the name, and raises
    InputError for a file so damaged that this cannot be told."""
    read: Callable[[Path, str | None], StoredPoints]
    """The points of one animal, from a file that is recognised; raises InputError."""
    holds: Literal["2D", "3D", "2D or 3D"]
    unit: str | None = None
    """Of 3D positions, where the file does not say it; None for one that the user has to give."""
    up: str = "z"
    """Likewise, the axis that points up."""


FORMATS: tuple[Reader, ...] = (
    Reader("DeepLabCut CSV or H5", deeplabcut.recognises, deeplabcut.read, "2D or 3D", unit="m"),
    Reader("SLEAP analysis H5", sleap.recognises, sleap.read, "2D"),
    Reader("movement netCDF", movement.recognises, movement.read, "2D or 3D"),
    Reader("ndx-pose NWB", nwb.recognises, nwb.read, "2D or 3D"),
    Reader("COCO JSON", coco.recognises, coco.read, "2D"),
    Reader("MMPose JSON", mmpose.recognises, mmpose.read, "2D"),
    Reader("TRC", trc.recognises, trc.read, "3D", up="y"),
    Reader("C3D", c3d.recognises, c3d.read, "3D"),
    Reader("BVH", bvh.recognises, bvh.read, "3D", up="y"),
    Reader("NPZ", npz.recognises, npz.read, "3D"),
    Reader("Parquet", parquet.recognises, parquet.read, "3D"),
    Reader("plain CSV, long or wide", columns.recognises, columns.read, "2D or 3D"),
)
READERS = tuple(reader for reader in FORMATS if "2D" in reader.holds)
"""Those of keypoints."""


def read_keypoints(path: str | Path, individual: str | None = None) -> Keypoints:
    """The keypoints of one animal, as the file states them (see `recon.clip.keypoints.clean`), in any known format.

    individual: the animal's name, needed where the file holds several. Raises InputError for a file that is missing,
    empty, of no known format, or faulty.
    """
    return as_keypoints(Path(path), read_points(path, individual, "2D")[1])


def read_points(
    path: str | Path, individual: str | None = None, kind: Kind | None = None
) -> tuple[Reader, StoredPoints]:
    """The points of one animal, and the format of the file; kind: what they have to be. Raises InputError likewise."""
    path = Path(path)
    head = file_head(path)
    reader = next((reader for reader in FORMATS if reader.recognises(path)), None)
    if reader is None:
        known = ", ".join(reader.name for reader in FORMATS if kind is None or kind in reader.holds)
        raise InputError(Problem(path, "format", describe(head), f"one of: {known}"))
    try:
        stored = reader.read(path, individual) if kind is None or kind in reader.holds else None
    except NoChoiceError as error:
        _require_kind(path, kind, reader, reader.read(path, error.animals[0]))  # or else a choice would not help
        raise
    return reader, _require_kind(path, kind, reader, stored)


def _require_kind(path: Path, kind: Kind | None, reader: Reader, stored: StoredPoints | None) -> StoredPoints:
    if kind == "2D" and (stored is None or stored.in_space):
        raise InputError(Problem(path, "coords", "x, y, z: 3D positions", "2D keypoints in pixels (x, y)"))
    if stored is None or (kind == "3D" and not stored.in_space):
        raise InputError(Problem(path, "coords", f"no z ({reader.name})", "x, y, z: 3D positions"))
    return stored


def as_keypoints(path: Path, stored: StoredPoints) -> Keypoints:
    """The 2D points of a file. Raises InputError for likelihoods that are none."""
    keypoints = Keypoints(
        stored.names,
        stored.values,
        np.full(stored.values.shape[:2], np.nan) if stored.likelihood is None else stored.likelihood,
        stored.frames,
        fps=stored.fps,
        image_size_px=stored.image_size_px,
        individual=stored.individual,
        source=str(path),
        notes=stored.notes,
    )
    return with_likelihoods(keypoints, path)


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
    head = file_head(path, 1 << 18)  # a row with the network's name in every column is before those that count
    if b"individuals" in head or is_hdf5(path) or not deeplabcut.recognises(path):
        return False
    row = next((line for line in head.splitlines() if line.startswith(b"bodyparts")), b"")
    return not deeplabcut.prefixes(row.decode(errors="replace").split(",")[1:] or [""])


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
    if head[4:8] == b"ftyp" or head[8:12] == b"AVI " or head.startswith(b"\x1aE\xdf\xa3"):
        return "a video (recon run and recon predict find the keypoints in one)"
    text = head.decode("utf-8", errors="ignore").lstrip("\ufeff").strip()
    # The head may end in the middle of a character of up to 4 bytes; more than that is lost only from binary files.
    if len(text.encode()) < len(head.strip()) - 6 or not all(c.isprintable() or c.isspace() for c in text):
        return "a binary file"
    return f"a file that begins with '{text.splitlines()[0][:40]}'" if text else "a file of blanks"
