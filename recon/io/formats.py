"""The table of file formats, and reading points by it.

A new format is one module with `recognises(path)`, `read(path, individual)` and `write(data, path)`, whichever it has,
and one line in `FORMATS`: `recon fit`, `batch`, `evaluate` and `convert` take it from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np

from recon.base.documents import require_file
from recon.base.errors import InputError, Problem
from recon.clip.keypoints import Keypoints
from recon.io import camera_files, deeplabcut
from recon.io.common import MAX_FRAME, NoChoiceError, with_likelihoods
from recon.io.deeplabcut_project import find_project
from recon.io.pose import StoredPoints

Kind = Literal["2D", "3D", "bones", "cameras"]
"""2D keypoints, 3D positions, bones (`recon.io.bones`), or cameras."""


@dataclass(frozen=True)
class Format:
    """One kind of file."""

    name: str
    """For `--to`."""
    title: str
    suffixes: tuple[str, ...]
    """The first is the usual one."""
    recognises: Callable[[Path], bool] | None = None
    """Whether a readable file, not empty, is of this format. It looks at the content, not at the name, and raises
    InputError for a file so damaged that this cannot be told. None for one that is not read."""
    read: Callable[[Path, str | None], Any] | None = None
    """From a file that is recognised, the `StoredPoints` of one animal, by its name, or a list of `CameraRecord`;
    raises InputError."""
    reads: tuple[Kind, ...] = ()
    write: Callable[[Any, Path], None] | None = None
    """`Keypoints`, `Pose3D`, `Armature` or cameras, whichever of them it `writes`, as a new file; raises InputError."""
    writes: tuple[Kind, ...] = ()
    fps: str = ""
    """Where it has the frame rate, or needed if it cannot be without."""
    frames: str = ""
    """Where it has the frame numbers."""
    axes: str = ""
    """Unit and axes of 3D positions as they are written."""
    unit: str | None = None
    """Of 3D positions that are read, where the file does not say it; None for one that the user has to give."""
    up: str = "z"
    """Likewise, the axis that points up."""
    beside: tuple[str, ...] = ()
    """Suffixes of further files that are written under the same name."""


def _of(name: str) -> Callable[..., Any]:
    """A function of a module of this room, "module.function", which is imported when it is called: a fit reads one
    format, or two."""
    module, function = name.split(".")
    return lambda *args: getattr(import_module(f"recon.io.{module}"), function)(*args)


_2D: tuple[Kind, ...] = ("2D",)
_3D: tuple[Kind, ...] = ("3D",)
_BOTH: tuple[Kind, ...] = ("2D", "3D")
_BONES: tuple[Kind, ...] = ("bones",)
_CAMERAS: tuple[Kind, ...] = ("cameras",)

# fmt: off
FORMATS: tuple[Format, ...] = (
    Format("deeplabcut", "DeepLabCut CSV", (".csv",), deeplabcut.recognises, deeplabcut.read, _BOTH,
           deeplabcut.write_csv, _BOTH, "in the scorer", "kept", "m, z up", unit="m"),
    Format("deeplabcut", "DeepLabCut H5", (".h5", ".hdf5"), _of("deeplabcut_h5.recognises"),
           _of("deeplabcut_h5.read"), _BOTH, _of("deeplabcut_h5.write"), _BOTH,
           "in the scorer", "kept", "m, z up", unit="m"),
    Format("sleap-anipose", "sleap-anipose's points3d.h5", (".h5",), _of("points3d.recognises"),
           _of("points3d.read"), _3D),
    Format("sleap", "SLEAP analysis H5", (".analysis.h5", ".h5"), _of("sleap.recognises"), _of("sleap.read"), _2D,
           _of("sleap.write"), _2D, "in provenance", "from frame 0"),
    Format("movement", "movement netCDF", (".nc",), _of("movement.recognises"), _of("movement.read"), _BOTH,
           _of("movement.write"), _BOTH, "kept", "as times", "m, z up"),
    Format("nwb", "ndx-pose NWB", (".nwb",), _of("nwb.recognises"), _of("nwb.read"), _BOTH,
           _of("nwb.write"), _BOTH, "needed", "as times", "m, z up"),
    Format("coco", "COCO JSON", (".json",), _of("coco.recognises"), _of("coco.read"), _2D,
           _of("coco.write"), _2D, "in info", "kept"),
    Format("mmpose", "MMPose JSON", (".json",), _of("mmpose.recognises"), _of("mmpose.read"), _2D),
    Format("openpose", "OpenPose JSON, a file a frame", (".json",), _of("openpose.recognises"),
           _of("openpose.read"), _2D),
    Format("fmpose3d", "FMPose3D JSON of DeepLabCut", (".json",), _of("fmpose3d.recognises"),
           _of("fmpose3d.read"), _3D, unit="m"),
    Format("trc", "TRC", (".trc",), _of("trc.recognises"), _of("trc.read"), _3D,
           _of("trc.write"), _3D, "needed", "kept", "m, y up", up="y"),
    Format("c3d", "C3D", (".c3d",), _of("c3d.recognises"), _of("c3d.read"), _3D,
           _of("c3d.write"), _3D, "needed", "RECON:FRAMES", "mm, z up"),
    Format("npz", "NPZ", (".npz",), _of("npz.recognises"), _of("npz.read"), _3D,
           _of("npz.write"), _3D, "kept", "kept", "m, z up"),
    Format("parquet", "Parquet", (".parquet",), _of("parquet.recognises"), _of("parquet.read"), _3D,
           _of("parquet.write"), _3D, "in metadata", "kept", "m, z up"),
    Format("dannce", "DANNCE MAT", (".mat",), _of("dannce.recognises"), _of("dannce.read"), _3D),
    Format("bvh", "BVH", (".bvh",), _of("bvh.recognises"), _of("bvh.read"), _3D,
           _of("bvh.write"), _BONES, "kept", "from 0", "m, y up", up="y"),
    Format("opensim", "OpenSim model", (".osim",), None, None, (),
           _of("opensim.write"), _BONES, "as times", "as times", "m, y up", beside=(".mot", ".trc")),
    Format("gltf", "glTF", (".glb",), None, None, (),
           _of("gltf.write"), _BONES, "as times", "from 0", "m, y up"),
    Format("long", "long CSV", (".csv",), _of("columns.recognises"), _of("columns.read"), _BOTH,
           _of("columns.write_long"), _2D, "as a column", "kept"),
    Format("wide", "wide CSV", (".csv",), _of("columns.recognises"), _of("columns.read"), _BOTH,
           _of("columns.write_wide"), _2D, "as a column", "kept"),
    Format("camera", "camera file of recon", (".toml",), camera_files.recognises_own, camera_files.read_own, _CAMERAS,
           camera_files.write_cameras, _CAMERAS),
    Format("anipose", "Anipose or Pose2Sim TOML", (".toml",),
           camera_files.recognises_anipose, camera_files.read_anipose, _CAMERAS),
    Format("opendronemap", "OpenDroneMap cameras.json", (".json",),
           camera_files.recognises_opensfm, camera_files.read_opensfm, _CAMERAS),
    Format("acinoset", "AcinoSet JSON", (".json",),
           camera_files.recognises_acinoset, camera_files.read_acinoset, _CAMERAS),
    Format("dannce", "DANNCE MAT", (".mat",), _of("dannce.recognises"), _of("dannce.read_cameras"), _CAMERAS),
    Format("opencv", "OpenCV YAML, XML or JSON, ROS camera_info", (".yaml", ".yml", ".xml", ".json"),
           camera_files.recognises_opencv, camera_files.read_opencv, _CAMERAS),
)
# fmt: on
"""A file is of the first that recognises it. Where an extension has several, the first that writes it is meant unless
`--to` names another."""
CONVERTED = tuple(f for f in FORMATS if f.writes and "cameras" not in f.writes)
"""What `recon convert` can write."""
PLAIN = next(f for f in FORMATS if f.name == "long")


def choose_format(out: Path, name: str | None) -> Format:
    """What to write, by the name of a format, if given, and the file's extension; the longest that fits counts.

    Raises InputError for names and extensions that are not there.
    """
    names = tuple(dict.fromkeys(f.name for f in CONVERTED))
    if name is not None and name not in names:
        raise InputError(Problem("--to", "format", f"'{name}'", f"one of: {', '.join(names)}"))
    named = [f for f in CONVERTED if name in (None, f.name)]
    fitting = [(len(s), -i, f) for i, f in enumerate(named) for s in f.suffixes if out.name.lower().endswith(s)]
    if not fitting:
        expected = ", ".join(dict.fromkeys(s for f in named for s in f.suffixes))
        raise InputError(Problem(out, "extension", f"'{out.suffix}'", f"one of: {expected}"))
    return max(fitting, key=lambda fit: fit[:2])[2]


def recognised(path: Path, kind: Kind | None = None) -> Format | None:
    """The format of a readable file that can hold such data, by default points; None where there is none.

    Raises InputError for a file so damaged that this cannot be told.
    """
    return next((f for f in _reading(kind) if f.recognises and f.recognises(path)), None)


def titles(kind: Kind | None = None) -> str:
    """The formats that such data, by default points, are read from, for a message."""
    return ", ".join(f.title for f in _reading(kind))


def _reading(kind: Kind | None) -> list[Format]:
    kinds = {"2D", "3D"} if kind is None else {kind}
    return [f for f in FORMATS if kinds & {*f.reads}]


# -- reading ---------------------------------------------------------------------------------------------------------


def read_keypoints(path: str | Path, individual: str | None = None) -> Keypoints:
    """The keypoints of one animal, as the file states them (see `recon.clip.keypoints.clean`), in any known format.

    individual: the animal's name, needed where the file holds several. Raises InputError for a file that is missing,
    empty, of no known format, or faulty.
    """
    return as_keypoints(Path(path), read_points(path, individual, "2D")[1])


def read_points(
    path: str | Path, individual: str | None = None, kind: Kind | None = None, by: Mapping[str, str] | None = None
) -> tuple[Format, StoredPoints]:
    """The points of one animal, and the format of the file. Raises InputError likewise.

    kind: what they have to be; by: the columns of a plain table (`recon.io.column_map.parse_map`).
    """
    path = Path(path)
    if path.is_dir() and (files := sorted(path.glob("*.json"))):
        raise InputError(Problem(path, "file", "a folder", f"one of its files, which stands for all: {files[0].name}"))
    if find_project(path):
        expected = (
            "one of its tables, as videos/run1DLC_*.h5; the project as a whole is for recon batch, recon train and "
            "recon skeleton from-keypoints"
        )
        raise InputError(Problem(path, "file", "a project of DeepLabCut", expected))
    head = file_head(path)
    if by is not None:
        from recon.io import columns

        return PLAIN, columns.read(path, individual, by)
    found = recognised(path)
    if found is None or found.read is None:
        raise InputError(Problem(path, "format", describe(head), f"one of: {titles(kind)}"))
    try:
        stored = found.read(path, individual) if kind is None or kind in found.reads else None
    except NoChoiceError as error:
        _require_kind(path, kind, found, found.read(path, error.animals[0]))  # or else a choice would not help
        raise
    stored = _require_kind(path, kind, found, stored)
    if np.abs(stored.frames).max(initial=0) > MAX_FRAME:
        said = f"{stored.frames[0]} to {stored.frames[-1]}"
        raise InputError(Problem(path, "frames", said, f"frame numbers up to {MAX_FRAME}, not time stamps"))
    if np.isinf(stored.values).any():
        raise InputError(Problem(path, "points", "infinite coordinates", "numbers, or nothing where one is missing"))
    return found, stored


def _require_kind(path: Path, kind: Kind | None, found: Format, stored: StoredPoints | None) -> StoredPoints:
    if kind == "2D" and (stored is None or stored.in_space):
        raise InputError(Problem(path, "coords", "x, y, z: 3D positions", "2D keypoints in pixels (x, y)"))
    if stored is None or (kind == "3D" and not stored.in_space):
        raise InputError(Problem(path, "coords", f"no z ({found.title})", "x, y, z: 3D positions"))
    return stored


def as_keypoints(path: Path, stored: StoredPoints) -> Keypoints:
    """The 2D points of a file. Raises InputError for likelihoods that are none."""
    scorer = (stored.scorer or "").strip()
    keypoints = Keypoints(
        stored.names,
        stored.values,
        np.full(stored.values.shape[:2], np.nan) if stored.likelihood is None else stored.likelihood,
        stored.frames,
        fps=stored.fps,
        image_size_px=stored.image_size_px,
        individual=stored.individual,
        source=str(path),
        scorer=scorer if scorer.isprintable() and scorer else None,
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
    if b"individuals" in head or not deeplabcut.recognises(path):
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
