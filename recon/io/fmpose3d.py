"""FMPose3D's poses as DeepLabCut writes them: `run_DLC_fmpose3d_animals_3d.json` with `model`, `bodyparts`, `poses_3d`.

Beside it lies the same as a table, `..._3d.h5`, and the 2D points that it was lifted from. A pose is of one picture:
relative to a point of the body, in the camera's axes and in the network's own unit. Frames are numbered from 0, and
those without an animal are empty.

The network's points are Animal3D's, in Animal3D's order. DeepLabCut (3.0, 2026) calls them by another list, so that the
left front paw is "neck": `true_names` gives them back their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from recon.base.documents import read_json
from recon.base.errors import InputError, Problem
from recon.io.common import choose, starts_with_text
from recon.io.pose import StoredPoints

MODEL = "fmpose3d_"
ANIMALS = f"{MODEL}animals"
_ANIMAL3D = {
    "left_eye": "left_eye",
    "right_eye": "right_eye",
    "nose": "mouth_mid",
    "neck": "left_front_paw",
    "root_of_tail": "right_front_paw",
    "left_shoulder": "left_back_paw",
    "left_elbow": "right_back_paw",
    "left_front_paw": "tail_base",
    "right_shoulder": "left_front_thigh",
    "right_elbow": "right_front_thigh",
    "right_front_paw": "left_back_thigh",
    "left_hip": "right_back_thigh",
    "left_knee": "left_shoulder",
    "left_back_paw": "right_shoulder",
    "right_hip": "left_front_knee",
    "right_knee": "right_front_knee",
    "right_back_paw": "left_back_knee",
    "withers": "right_back_knee",
    "throat": "neck",
    "left_ear": "tail_end",
    "right_ear": "left_ear",
    "mouth": "right_ear",
    "chin": "left_mouth",
    "left_hock": "right_mouth",
    "right_hock": "nose",
    "tail_tip": "tail_mid",
}
"""Points in the network's order, by DeepLabCut's names: that of FMPose3D's conversion from SuperAnimal's points."""
LENGTHS = (
    "FMPose3D's lengths have no unit, and its axes are the camera's: compare them after scaling and turning (PA) only."
)


def true_names(names: Sequence[str], model: str) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of a table's points, in any order, and a note where they were not those of the points. model: what found
    them, or the table's scorer, which has it."""
    if ANIMALS not in model or {*names} != {*_ANIMAL3D}:
        return tuple(names), ()
    note = (
        "DeepLabCut gives FMPose3D's points the names of other points (the left front paw is 'neck'): they are read by "
        "their order, which is Animal3D's."
    )
    return tuple(_ANIMAL3D[name] for name in names), (note,)


def recognises(path: Path) -> bool:
    return starts_with_text(path, b"{") and b'"poses_3d"' in path.read_bytes()[: 1 << 16]


def read(path: Path, individual: str | None = None) -> StoredPoints:
    """The poses of the one animal. Raises InputError."""
    choose(path, [""], individual)
    content = read_json(path, "a whole file of JSON")
    try:
        written, poses = tuple(map(str, content["bodyparts"])), list(content["poses_3d"])
        values = np.full((len(poses), len(written), 3), np.nan)
        for frame, pose in enumerate(poses):
            if pose:
                values[frame] = np.array(pose, dtype=float)
    except (KeyError, TypeError, ValueError) as error:
        found = f"nothing called {error}" if isinstance(error, KeyError) else f"an entry of another form ({error})"
        expected = "bodyparts, and poses_3d with x, y, z of each in every frame"
        raise InputError(Problem(path, "content", found, expected)) from None
    if not len(values) or len({*written}) != len(written):
        found = "no frames" if not len(values) else "a name twice"
        raise InputError(Problem(path, "poses_3d", found, "at least one frame, and every name once"))
    names, notes = true_names(written, str(content.get("model")))
    return StoredPoints(names, values, np.arange(len(values)), notes=(*notes, LENGTHS))
