"""Table of all file formats, and functions that read points in any of them.

A new format needs a module with `recognises(path)`, `read(path, individual)` and `write(data, path)` (only those that
apply), a function below that imports them, and one line in `FORMATS`. `recon fit`, `batch`, `evaluate` and `convert`
then use the format. All readers raise InputError for an invalid file.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np

from recon.base.documents import damage_as_input_error, read_head
from recon.base.errors import InputError, Problem
from recon.base.numbers import percent
from recon.clip import Keypoints
from recon.io.common import NoChoiceError, StoredPoints, frames_seen, joined_tracks
from recon.io.times import with_rate

Kind = Literal["2D", "3D", "bones", "cameras", "robot"]
"""Content of a file: 2D or 3D points, bones (`recon.io.bones`), cameras, or a robot's motion by another package."""


@dataclass(frozen=True)
class Functions:
    """Functions that recognise, read and write one file format; None for an operation that recon does not support."""

    recognises: Callable[[Path], bool] | None = None
    read: Callable[..., Any] | None = None
    """Reader, which takes a path and the name of an individual."""
    write: Callable[[Any, Path], None] | None = None


_Loaded = TypeVar("_Loaded")


def _present(function: _Loaded | None) -> _Loaded:
    assert function is not None, "the table of formats asks a module for a function that it lacks"
    return function


@dataclass(frozen=True)
class Format:
    """File format with the functions that recognise, read and write its files."""

    name: str
    """Name of the format for `--to`."""
    title: str
    suffixes: tuple[str, ...]
    """File name suffixes, the usual one first."""
    functions: Callable[[], Functions] | None = None
    """Function that imports the reader and writer on use; None for a format that another package writes."""
    reads: tuple[Kind, ...] = ()
    writes: tuple[Kind, ...] = ()
    fps: str = ""
    """How the file stores the frame rate, or "needed" if it requires one."""
    frames: str = ""
    """How the file stores the frame numbers."""
    axes: str = ""
    """Unit and axes of 3D positions as written."""
    unit: str | None = None
    """Unit of 3D positions if the file does not state one; None if the user has to state it."""
    up: str = "z"
    """Upward axis of 3D positions if the file does not state one."""
    companions: tuple[str, ...] = ()
    """Suffixes of additional files that are written under the same name."""

    def recognises(self, path: Path) -> bool:
        """Return whether a readable, non-empty file has content in this format.

        Raises
        ------
        InputError
            If the file is too damaged to tell.
        """
        recognise = self._loaded().recognises
        return recognise is not None and recognise(path)

    def read(self, path: Path, individual: str | None = None) -> Any:
        """Return the `StoredPoints` of one animal, or a list of `CameraRecord`, from a recognised file.

        Raises
        ------
        InputError
            If the file is damaged. Exceptions of Python and of libraries during reading are converted to InputError.
        """
        with damage_as_input_error(path, f"a complete file of the format {self.title}"):
            return _present(self._loaded().read)(path, individual)

    def write(self, data: object, path: Path) -> None:
        """Write data of a kind in `writes` (`Keypoints`, `Pose3D`, `Armature` or cameras) to a new file.

        Raises
        ------
        InputError
            If the format cannot hold the data.
        """
        _present(self._loaded().write)(data, path)

    def _loaded(self) -> Functions:
        return _present(self.functions)()


def _deeplabcut_csv() -> Functions:
    from recon.io.deeplabcut import read_csv, recognises_csv, write_csv

    return Functions(recognises=recognises_csv, read=read_csv, write=write_csv)


def _hdf5_poses_deeplabcut() -> Functions:
    from recon.io.hdf5_poses import read_deeplabcut, recognises_deeplabcut, write_deeplabcut

    return Functions(recognises=recognises_deeplabcut, read=read_deeplabcut, write=write_deeplabcut)


def _hdf5_poses_points3d() -> Functions:
    from recon.io.hdf5_poses import read_points3d, recognises_points3d

    return Functions(recognises=recognises_points3d, read=read_points3d)


def _hdf5_poses_sleap() -> Functions:
    from recon.io.hdf5_poses import read_sleap, recognises_sleap

    return Functions(recognises=recognises_sleap, read=read_sleap)


def _hdf5_poses_movement() -> Functions:
    from recon.io.hdf5_poses import read_movement, recognises_movement, write_movement

    return Functions(recognises=recognises_movement, read=read_movement, write=write_movement)


def _hdf5_poses_nwb() -> Functions:
    from recon.io.hdf5_poses import read_nwb, recognises_nwb, write_nwb

    return Functions(recognises=recognises_nwb, read=read_nwb, write=write_nwb)


def _json_poses_coco() -> Functions:
    from recon.io.json_poses import read_coco, recognises_coco

    return Functions(recognises=recognises_coco, read=read_coco)


def _json_poses_mmpose() -> Functions:
    from recon.io.json_poses import read_mmpose, recognises_mmpose

    return Functions(recognises=recognises_mmpose, read=read_mmpose)


def _json_poses_openpose() -> Functions:
    from recon.io.json_poses import read_openpose, recognises_openpose

    return Functions(recognises=recognises_openpose, read=read_openpose)


def _json_poses_fmpose3d() -> Functions:
    from recon.io.json_poses import read_fmpose3d, recognises_fmpose3d

    return Functions(recognises=recognises_fmpose3d, read=read_fmpose3d)


def _markers_trc() -> Functions:
    from recon.io.markers import read_trc, recognises_trc, write_trc

    return Functions(recognises=recognises_trc, read=read_trc, write=write_trc)


def _markers_c3d() -> Functions:
    from recon.io.markers import read_c3d, recognises_c3d, write_c3d

    return Functions(recognises=recognises_c3d, read=read_c3d, write=write_c3d)


def _npz() -> Functions:
    from recon.io.npz import read, recognises, write

    return Functions(recognises=recognises, read=read, write=write)


def _npz_fmpose3d() -> Functions:
    from recon.io.npz import read_fmpose3d, recognises_fmpose3d

    return Functions(recognises=recognises_fmpose3d, read=read_fmpose3d)


def _columns_parquet() -> Functions:
    from recon.io.columns import read_parquet, recognises_parquet, write_parquet

    return Functions(recognises=recognises_parquet, read=read_parquet, write=write_parquet)


def _dannce() -> Functions:
    from recon.io.dannce import read, recognises

    return Functions(recognises=recognises, read=read)


def _bones_bvh() -> Functions:
    from recon.io.bones import read_bvh, recognises_bvh, write_bvh

    return Functions(recognises=recognises_bvh, read=read_bvh, write=write_bvh)


def _bones_opensim() -> Functions:
    from recon.io.bones import write_opensim

    return Functions(write=write_opensim)


def _bones_gltf() -> Functions:
    from recon.io.bones import write_gltf

    return Functions(write=write_gltf)


def _columns_long() -> Functions:
    from recon.io.columns import read_long, recognises_long, write_long

    return Functions(recognises=recognises_long, read=read_long, write=write_long)


def _calibration_own() -> Functions:
    from recon.io.calibration import read_own, recognises_own

    return Functions(recognises=recognises_own, read=read_own)


def _camera_files_anipose() -> Functions:
    from recon.io.camera_files import read_anipose, recognises_anipose

    return Functions(recognises=recognises_anipose, read=read_anipose)


def _camera_files_opensfm() -> Functions:
    from recon.io.camera_files import read_opensfm, recognises_opensfm

    return Functions(recognises=recognises_opensfm, read=read_opensfm)


def _camera_files_acinoset() -> Functions:
    from recon.io.camera_files import read_acinoset, recognises_acinoset

    return Functions(recognises=recognises_acinoset, read=read_acinoset)


def _dannce_cameras() -> Functions:
    from recon.io.dannce import read_cameras, recognises_cameras

    return Functions(recognises=recognises_cameras, read=read_cameras)


def _camera_files_opencv() -> Functions:
    from recon.io.camera_files import read_opencv, recognises_opencv

    return Functions(recognises=recognises_opencv, read=read_opencv)


def _json_poses_alphapose() -> Functions:
    from recon.io.json_poses import read_alphapose, recognises_alphapose

    return Functions(recognises=recognises_alphapose, read=read_alphapose)


def _lab_cameras_easymocap() -> Functions:
    from recon.io.lab_cameras import read_easymocap, recognises_easymocap

    return Functions(recognises=recognises_easymocap, read=read_easymocap)


def _lab_cameras_stereo() -> Functions:
    from recon.io.lab_cameras import read_stereo, recognises_stereo

    return Functions(recognises=recognises_stereo, read=read_stereo)


def _lab_cameras_tables() -> Functions:
    from recon.io.lab_cameras import read_tables, recognises_tables

    return Functions(recognises=recognises_tables, read=read_tables)


_2D: tuple[Kind, ...] = ("2D",)
_3D: tuple[Kind, ...] = ("3D",)
_BOTH: tuple[Kind, ...] = ("2D", "3D")
_BONES: tuple[Kind, ...] = ("bones",)
_CAMERAS: tuple[Kind, ...] = ("cameras",)

# fmt: off
FORMATS: tuple[Format, ...] = (
    Format("deeplabcut", "DeepLabCut CSV", (".csv",), _deeplabcut_csv, _BOTH, _BOTH,
           "in the scorer", "kept", "m, z up"),
    Format("deeplabcut", "DeepLabCut H5", (".h5", ".hdf5"), _hdf5_poses_deeplabcut, _BOTH, _BOTH,
           "in the scorer", "kept", "m, z up"),
    Format("sleap-anipose", "sleap-anipose's points3d.h5", (".h5",), _hdf5_poses_points3d, _3D),
    Format("sleap", "SLEAP analysis H5", (".h5",), _hdf5_poses_sleap, _2D),
    Format("movement", "movement netCDF", (".nc",), _hdf5_poses_movement, _BOTH, _BOTH, "kept", "as times", "m, z up"),
    Format("nwb", "ndx-pose NWB", (".nwb",), _hdf5_poses_nwb, _BOTH, _BOTH, "needed", "as times", "m, z up"),
    Format("coco", "COCO JSON", (".json",), _json_poses_coco, _2D),
    Format("alphapose", "AlphaPose JSON", (".json",), _json_poses_alphapose, _2D),
    Format("mmpose", "MMPose JSON", (".json",), _json_poses_mmpose, _2D),
    Format("openpose", "OpenPose JSON (one file per frame)", (".json",), _json_poses_openpose, _2D),
    Format("fmpose3d", "FMPose3D JSON of DeepLabCut", (".json",), _json_poses_fmpose3d, _3D, unit="m"),
    Format("trc", "TRC", (".trc",), _markers_trc, _3D, _3D, "needed", "kept", "m, y up", up="y"),
    Format("c3d", "C3D", (".c3d",), _markers_c3d, _3D, _3D, "needed", "RECON:FRAMES", "mm, z up"),
    Format("npz", "NPZ", (".npz",), _npz, _3D, _3D, "kept", "kept", "m, z up"),
    Format("fmpose3d", "FMPose3D NPZ of its demo", (".npz",), _npz_fmpose3d, _3D, unit="m"),
    Format("parquet", "Parquet", (".parquet",), _columns_parquet, _3D, _3D, "in metadata", "kept", "m, z up"),
    Format("dannce", "DANNCE MAT", (".mat",), _dannce, _3D),
    Format("bvh", "BVH", (".bvh",), _bones_bvh, _3D, _BONES, "kept", "from 0", "m, y up", up="y"),
    Format("opensim", "OpenSim model", (".osim",), _bones_opensim, (), _BONES, "as times", "as times", "m, y up",
           companions=(".mot", ".trc")),
    Format("gltf", "glTF", (".glb",), _bones_gltf, (), _BONES, "as times", "from 0", "m, y up"),
    Format("long", "plain CSV", (".csv",), _columns_long, _BOTH, _2D, "as a column", "kept"),
    Format("camera", "camera file of recon", (".toml",), _calibration_own, _CAMERAS),
    Format("anipose", "Anipose or Pose2Sim TOML", (".toml",), _camera_files_anipose, _CAMERAS),
    Format("opendronemap", "OpenDroneMap cameras.json", (".json",), _camera_files_opensfm, _CAMERAS),
    Format("acinoset", "AcinoSet JSON", (".json",), _camera_files_acinoset, _CAMERAS),
    Format("dannce", "DANNCE MAT", (".mat",), _dannce_cameras, _CAMERAS),
    Format("easymocap", "EasyMocap intri.yml", (".yml", ".yaml"), _lab_cameras_easymocap, _CAMERAS),
    Format("stereo", "OpenCV stereo YAML, XML or JSON", (".yml", ".yaml", ".xml", ".json"), _lab_cameras_stereo,
           _CAMERAS),
    Format("tables", "JSON or YAML with a table for each camera", (".json", ".yaml", ".yml"), _lab_cameras_tables,
           _CAMERAS),
    Format("opencv", "OpenCV YAML, XML or JSON, ROS camera_info", (".yaml", ".yml", ".xml", ".json"),
           _camera_files_opencv, _CAMERAS),
)
# fmt: on
"""All formats. A file has the first format that recognises it. If several formats share a suffix, the first one that
writes it is used unless `--to` names another.
"""
CONVERTED = tuple(f for f in FORMATS if f.writes)
"""Formats that `recon convert` can write."""
PLAIN = next(f for f in FORMATS if f.name == "long")

TRACKS_COMPARED = 8
"""Largest number of animals in a file among which tracks that never overlap in time are searched for."""
LIKELIHOOD_MARGIN = 0.5
"""Amount by which scores that are not probabilities, such as SLEAP's, may lie outside 0 to 1."""


def recognised(path: Path, kind: Kind | None = None) -> Format | None:
    """Return the format of a readable file that can hold the given kind of data (default: points), or None if unknown.

    Raises
    ------
    InputError
        If the file is too damaged to tell.
    """
    return next((f for f in _reading(kind) if f.recognises(path)), None)


def titles(kind: Kind | None = None) -> str:
    """Return the names of the formats from which a kind of data (default: points) can be read, for a message."""
    return ", ".join(f.title for f in _reading(kind))


def _reading(kind: Kind | None) -> list[Format]:
    kinds = {"2D", "3D"} if kind is None else {kind}
    return [f for f in FORMATS if kinds & {*f.reads}]


def read_keypoints(path: str | Path, individual: str | None = None, fps: float | None = None) -> Keypoints:
    """Return the keypoints of one animal as stored in a file of any known format.

    `individual` is the animal's name, needed if there are several. `fps` is the frame rate in Hz at which times in a
    file are converted to frame numbers.

    Raises
    ------
    InputError
        If the file cannot be read, or if its likelihoods are far outside 0 to 1.
    """
    return as_keypoints(Path(path), read_points(path, individual, "2D", fps=fps)[1])


def read_points(
    path: str | Path,
    individual: str | None = None,
    kind: Kind | None = None,
    by: Mapping[str, str] | None = None,
    fps: float | None = None,
) -> tuple[Format, StoredPoints]:
    """Return the format of a file, and the points of one animal.

    Parameters
    ----------
    path : path
        File in any known format.
    individual : str, optional
        Name of the animal, needed if there are several.
    kind : Kind, optional
        Required kind of points.
    by : mapping, optional
        Columns of a plain table (`recon.io.columns.parse_map`).
    fps : float, optional
        Frame rate in Hz. If the file has times, each time is assigned to the nearest frame.

    Raises
    ------
    InputError
        If the file is missing, of no known format, damaged, or of another kind, or if no animal can be chosen.
    """
    path = Path(path)
    if os.path.isdir(path) or path.suffix.lower() in (".yaml", ".yml"):
        from recon.io.deeplabcut_project import refuse_several

        refuse_several(path)
    head = read_head(path)
    if by is not None:
        from recon.io.columns import read_long

        return PLAIN, with_rate(path, read_long(path, individual, by), fps)
    reader = recognised(path)
    if reader is None:
        raise InputError(Problem(path, "format", *describe(path, head, titles(kind))))
    try:
        stored = _read_animal(reader, path, individual) if kind is None or kind in reader.reads else None
    except NoChoiceError as error:
        # a file of the wrong kind is refused first, since choosing an animal would not help
        _require_kind(path, kind, reader, reader.read(path, error.animals[0]))
        raise NoChoiceError(path, error.animals, _hint_to_join(reader, path, error.animals)) from None
    stored = _require_kind(path, kind, reader, stored)
    if np.isinf(stored.values).any():
        raise InputError(Problem(path, "points", "infinite coordinates", "numbers, or nothing where one is missing"))
    return reader, with_rate(path, stored, fps)


def _read_animal(reader: Format, path: Path, individual: str | None) -> StoredPoints:
    """Return the points of one animal, or of several tracks of it, whose names are joined by commas."""
    try:
        return reader.read(path, individual)
    except InputError:
        tracks = [name.strip() for name in (individual or "").split(",")]
        if len(tracks) < 2:
            raise
    return joined_tracks(path, [reader.read(path, track) for track in dict.fromkeys(tracks)], individual or "")


def _hint_to_join(reader: Format, path: Path, animals: Sequence[str]) -> str:
    """Return a hint to join tracks that never overlap in time, as they may be one animal, or "" without such tracks."""
    if len(animals) > TRACKS_COMPARED:
        return ""
    frames = {name: frames_seen(reader.read(path, name)) for name in animals}
    chain: list[str] = []
    for name in sorted((name for name in animals if len(frames[name])), key=lambda name: frames[name].min()):
        if not any(len(np.intersect1d(frames[name], frames[earlier])) for earlier in chain):
            chain.append(name)
    if len(chain) < 2:
        return ""
    return f"; {', '.join(chain)} never overlap in time: if they are one animal, --individual {','.join(chain)}"


def _require_kind(path: Path, kind: Kind | None, reader: Format, stored: StoredPoints | None) -> StoredPoints:
    if kind == "2D" and (stored is None or stored.in_space):
        raise InputError(Problem(path, "coords", "3D positions (x, y, z)", "2D keypoints in pixels (x, y)"))
    if stored is None or (kind == "3D" and not stored.in_space):
        raise InputError(Problem(path, "coords", f"no z ({reader.title})", "3D positions (x, y, z)"))
    if not stored.in_space and stored.unit is not None:
        expected = "pixels of the picture (x, y), or a column z of 3D positions"
        raise InputError(Problem(path, "columns", f"2D positions in {stored.unit}", expected))
    return stored


def as_keypoints(path: Path, stored: StoredPoints) -> Keypoints:
    """Return the 2D points of a file, with a note if likelihoods lie slightly outside 0 to 1.

    Raises
    ------
    InputError
        If likelihoods are infinite or so far outside that they have another meaning, such as per cent, because every
        point would then count as certain.
    """
    scorer, notes = (stored.scorer or "").strip(), stored.notes
    likelihood = np.full(stored.values.shape[:2], np.nan) if stored.likelihood is None else stored.likelihood
    stated = likelihood[~np.isnan(likelihood)]
    low, high = (float(stated.min()), float(stated.max())) if stated.size else (0.0, 1.0)
    if low < -LIKELIHOOD_MARGIN or high > 1 + LIKELIHOOD_MARGIN:
        above = float(np.mean(stated > 1))
        # a spreadsheet that dropped decimal points leaves a part of the likelihoods above 1
        is_percent = low >= 0 and high <= 100 and above > 0.5
        cause = (
            ", apparently in percent" if is_percent else f", above 1 in {percent(above)} of the points" * (above > 0)
        )
        raise InputError(Problem(path, "likelihood", f"values from {low:g} to {high:g}{cause}", "values from 0 to 1"))
    if low < 0 or high > 1:
        notes = (*notes, f"Likelihoods range from {low:g} to {high:g}, but should lie between 0 and 1.")
    return Keypoints(
        stored.names,
        stored.values,
        likelihood,
        stored.frames,
        fps=stored.fps,
        image_size_px=stored.image_size_px,
        individual=stored.individual,
        source=str(path),
        scorer=scorer if scorer.isprintable() and scorer else None,
        notes=notes,
    )


def individuals(path: str | Path) -> tuple[str, ...]:
    """Return the animals that have points in a multi-animal file; empty for one animal or an unreadable file."""
    try:
        read_keypoints(path)
    except NoChoiceError as error:
        return error.animals
    except InputError:  # this error is reported when the file is read
        pass
    return ()


_UNREAD = (
    (b"Format Version", "an export of Motive (OptiTrack)", "TRC or C3D: in Motive, export the take as one of them"),
    (b"Trajectories", "an export of Vicon Nexus", "C3D, or TRC: in Nexus, export the trial as one of them"),
    (b"NO_OF_FRAMES", "an export of Qualisys", "C3D: in Qualisys Track Manager, export to C3D"),
    *(
        (b"\x80" + version, "a pickle, as DeepLabCut writes raw detections", "its table: .h5 or .csv")
        for version in (b"\x03", b"\x04", b"\x05")
    ),
    (b"<?xml", "an XML file", None),
    (b"%PDF", "a PDF", None),
    (b"\x93NUMPY", "an array of NumPy, without names of points", "a table, or an NPZ with names, xyz_m and frames"),
    (b"PK\x03\x04", "a ZIP archive, or a document of Office", "CSV: save the table as CSV"),
)
"""First bytes of files that recon cannot read, with a description and, if known, what to export instead."""
_UNREAD_TEXTS = (
    (rb'\s*\[\s*\{\s*"bodyparts"', "DeepLabCut's JSON of predictions", "its table of the same video: .h5 or .csv"),
    (
        rb'\s*\[\s*\{\s*"(frame_id|instances|keypoints)"',
        "MMPose's predictions without names of the keypoints",
        "MMPose's file with meta_info, which its demo scripts write (--save-predictions)",
    ),
    (
        rb'\s*\[\s*\{\s*"id"\s*:\s*\d+\s*,\s*"(annotations|data|img|image|video|file_upload)"',
        "an export of Label Studio, whose positions are in percent",
        "a CSV with the columns frame, bodypart, x, y, in pixels",
    ),
    (
        rb"(?P<point>[^,\n]+)(,(?P=point)){2,3},",
        "a table whose header begins with points, as JARVIS writes",
        "a first column with bodyparts, coords and frame numbers",
    ),
    (
        rb"\s*<\?xml[^>]*>\s*<annotations>",
        "CVAT's XML",
        "COCO: in CVAT, export the task as COCO Keypoints",
    ),
)
"""Beginnings of texts that recon cannot read, each with a description, and what to give instead."""
_SLEAP_PROJECT = {"metadata", "frames"}
_SLEAP_EXPORT = "SLEAP's analysis HDF5: in SLEAP, File > Export Analysis HDF5, or sleap-convert --format analysis"


_CALIBRATION = re.compile(
    rb"camera_?matrix|camera_resolution|recon-camera|^\[cam_[0-9a-z]+\]|intrinsic_?matrix", re.IGNORECASE
)
"""Pattern of keys by which a file is recognised as a calibration from its first bytes."""


def describe(path: Path, head: bytes, known: str) -> tuple[str, str]:
    """Return a plain description of a file of no known format, and of what is expected instead.

    `head` holds the first bytes, `known` the formats that can be read.
    """
    expected = f"one of: {known}"
    if head.startswith(b"\x89HDF\r\n\x1a\n"):
        from recon.io.hdf5 import outline

        if outline(path) >= _SLEAP_PROJECT:
            return "a SLEAP project", _SLEAP_EXPORT
        return "an HDF5 file in an unknown layout", expected
    for pattern, name, instead in _UNREAD_TEXTS:
        if re.match(pattern, head.removeprefix(b"\xef\xbb\xbf")):
            return name, instead
    if path.suffix.lower() == ".npz":
        return "an archive of NumPy with other arrays", "a table, or an NPZ with names, xyz_m and frames"
    for start, name, instead in _UNREAD:
        if head.removeprefix(b"\xef\xbb\xbf").startswith(start):
            return name, instead or expected
    if _CALIBRATION.search(head):
        return "a calibration, which belongs to --camera", expected
    if re.search(rb'"version"\s*:\s*"AlphaPose', head):
        return (
            "AlphaPose's results in the layout of another program",
            "AlphaPose's own layout: run AlphaPose without --format",
        )
    return _describe_head(head), expected


def _describe_head(head: bytes) -> str:
    if head[4:8] == b"ftyp" or head[8:12] == b"AVI " or head.startswith(b"\x1aE\xdf\xa3"):
        return "a video (recon run and recon predict find the keypoints in one)"
    if head.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "text in UTF-16 (save it in UTF-8)"
    text = head.decode("utf-8", errors="ignore").lstrip("\ufeff").strip()
    # The head may end within a character of up to 4 bytes. Only binary files lose more than that.
    if len(text.encode()) < len(head.strip()) - 6 or not all(c.isprintable() or c.isspace() for c in text):
        return "a binary file"
    if not text:
        return "a file of only spaces and empty lines"
    first = text.splitlines()[0]
    hint = ""
    if first.startswith(","):
        hint = " (the first cells of DeepLabCut's header are scorer, bodyparts, coords)"
    elif re.match(r"(?!scorer)\w[^,;\t]*([,;\t][^,;\t]*){2}", first, re.IGNORECASE):
        hint = " (if it is a table, recon convert --columns names its columns)"
    return f"a file that begins with '{first[:40]}'{hint}"
