"""The table of formats that keypoints, 3D positions and results can be written in, for `recon convert`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from recon.base.errors import InputError, Problem
from recon.clip.keypoints import Keypoints
from recon.io import c3d, coco, columns, deeplabcut, movement, npz, nwb, parquet, sleap, trc
from recon.io.pose import Pose3D
from recon.show.export import bvh, gltf, opensim
from recon.show.export.rig import Rig


@dataclass(frozen=True)
class Format:
    """A format of data to write."""

    name: str
    """For `--to`."""
    title: str
    extensions: tuple[str, ...]
    """The first is the usual one."""
    keypoints: Callable[[Keypoints, Path], None] | None
    pose: Callable[[Pose3D, Path], None] | None
    fps: str
    """Where it has the frame rate, or needed if it cannot be without."""
    frames: str
    """Where it has the frame numbers."""
    axes: str = ""
    """Unit and axes of 3D positions."""
    rig: Callable[[Rig, Path], None] | None = None
    """Bones, of a folder of results."""
    beside: tuple[str, ...] = ()
    """Extensions of further files that are written under the same name."""

    @property
    def kinds(self) -> str:
        writers = (("2D", self.keypoints), ("3D", self.pose), ("bones", self.rig))
        return ", ".join(kind for kind, writer in writers if writer)


FORMATS: tuple[Format, ...] = (
    Format(
        "deeplabcut",
        "DeepLabCut CSV",
        (".csv",),
        deeplabcut.write_csv,
        deeplabcut.write_csv,
        "in the scorer",
        "kept",
        "m, z up",
    ),
    Format(
        "deeplabcut",
        "DeepLabCut H5",
        (".h5", ".hdf5"),
        deeplabcut.write_h5,
        deeplabcut.write_h5,
        "in the scorer",
        "kept",
        "m, z up",
    ),
    Format("long", "long CSV", (".csv",), columns.write_long, None, "as a column", "kept"),
    Format("wide", "wide CSV", (".csv",), columns.write_wide, None, "as a column", "kept"),
    Format("sleap", "SLEAP analysis H5", (".analysis.h5", ".h5"), sleap.write, None, "in provenance", "from frame 0"),
    Format(
        "movement",
        "movement netCDF",
        (".nc",),
        movement.write,
        movement.write,
        "kept",
        "as times",
        "m, z up",
    ),
    Format("nwb", "ndx-pose NWB", (".nwb",), nwb.write, nwb.write, "needed", "as times", "m, z up"),
    Format("coco", "COCO JSON", (".json",), coco.write, None, "in info", "kept"),
    Format("parquet", "Parquet", (".parquet",), None, parquet.write, "in metadata", "kept", "m, z up"),
    Format("trc", "TRC", (".trc",), None, trc.write, "needed", "kept", "m, y up"),
    Format("c3d", "C3D", (".c3d",), None, c3d.write, "needed", "RECON:FRAMES", "mm, z up"),
    Format("npz", "NPZ", (".npz",), None, npz.write, "kept", "kept", "m, z up"),
    Format(
        "opensim",
        "OpenSim model",
        (".osim",),
        None,
        None,
        "as times",
        "as times",
        "m, y up",
        opensim.write,
        opensim.BESIDE,
    ),
    Format("gltf", "glTF", (".glb",), None, None, "as times", "from 0", "m, y up", gltf.write),
    Format("bvh", "BVH", (".bvh",), None, None, "kept", "from 0", "m, y up", bvh.write),
)
"""Where an extension has several, the first is meant unless `--to` names another."""


def choose_format(out: Path, name: str | None) -> Format:
    """By the name of a format, if given, and the file's extension; the longest extension that fits counts.

    Raises InputError for names and extensions that are not there.
    """
    names = tuple(dict.fromkeys(f.name for f in FORMATS))
    if name is not None and name not in names:
        raise InputError(Problem("--to", "format", f"'{name}'", f"one of: {', '.join(names)}"))
    named = [f for f in FORMATS if name in (None, f.name)]
    fitting = [(len(e), -i, f) for i, f in enumerate(named) for e in f.extensions if out.name.lower().endswith(e)]
    if not fitting:
        expected = ", ".join(dict.fromkeys(e for f in named for e in f.extensions))
        raise InputError(Problem(out, "extension", f"'{out.suffix}'", f"one of: {expected}"))
    return max(fitting, key=lambda fit: fit[:2])[2]
