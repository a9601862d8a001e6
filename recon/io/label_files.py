"""Write labelled frames of a video as DeepLabCut label files and COCO keypoints.

A project of DeepLabCut has a folder for each video, `labeled-data/run`, with its labelled frames as `img012.png` and
two tables of the same points, `CollectedData_me.csv` and `.h5`. The three parts of a frame's path name a row of these
tables; scorer, bodypart and coordinate name a column. A point without coordinates is not visible, or not labelled.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

import cv2
import numpy as np

from recon.base.arrays import Array, Bools, Integers
from recon.base.errors import InputError, Problem
from recon.base.file_names import encodable
from recon.base.files import write_bytes
from recon.io.hdf5_poses import PANDAS_KEY
from recon.io.video import Image
from recon.io.writing import formats_extra, write_rows

LABELED_DATA = "labeled-data"
COCO, ORIGINS = "coco.json", "origins.csv"
_LABELLED = 2
"""COCO's visibility of a point that is labelled and visible."""
_FORBIDDEN = r"/\:*?\"<>|"


@dataclass(frozen=True, eq=False)
class LabelledFrames:
    """N labelled frames of a video with K keypoints."""

    video: str
    """Name of the video without suffix, which is also the name of the folder."""
    scorer: str
    """Name of the labeller, as in the project's config.yaml."""
    names: tuple[str, ...]
    frames: Integers
    """Increasing frame numbers, shape (N,)."""
    xy_px: Array
    """Labels in pixels, shape (N, K, 2); NaN for a keypoint that is not labelled."""
    origins: tuple[tuple[str, ...], ...] = ()
    """Origin of each label, such as "by hand", for each frame and keypoint; empty if all are by hand."""
    edges: tuple[tuple[int, int], ...] = ()
    """Pairs of keypoints joined by a bone, as indices."""
    size_px: tuple[int, int] = (0, 0)
    """Width and height of the pictures in pixels."""
    digits: int = 4
    """Number of digits in the pictures' names."""

    @property
    def known(self) -> Bools:
        """Return a mask of the labelled points, (N, K)."""
        return np.asarray(np.isfinite(self.xy_px).all(axis=2), dtype=np.bool_)

    @property
    def table(self) -> str:
        """Return the file name of the two tables of labels, without suffix."""
        return f"CollectedData_{self.scorer}"

    def picture(self, frame: int) -> str:
        """Return the file name of a labelled frame's picture."""
        return f"img{frame:0{self.digits}d}.png"

    @property
    def file_names(self) -> list[str]:
        """Return the names of all files to write except the pictures."""
        return [f"{self.table}.csv", f"{self.table}.h5", COCO, ORIGINS]


def require_label_names(video: str, scorer: str) -> None:
    """Raise InputError if the name of the scorer or the video cannot be part of a file name."""
    for field, name in (("scorer", scorer), ("video", video)):
        if not name or name.startswith(".") or not name.isprintable() or any(sign in name for sign in _FORBIDDEN):
            expected = f"a file name without any of {' '.join(_FORBIDDEN)}, and not beginning with a dot"
            raise InputError(Problem("labels", field, repr(name)[:100], expected))


def require_label_writer() -> None:
    """Raise InputError if the package that writes DeepLabCut's H5 files is not installed."""
    with formats_extra("DeepLabCut H5"):
        import tables  # noqa: F401  pandas writes with it


def write_label_files(labels: LabelledFrames, folder: Path) -> None:
    """Write the tables, COCO's file and the origins of labelled frames into an existing folder."""
    rows = [(LABELED_DATA, labels.video, labels.picture(frame)) for frame in labels.frames.tolist()]
    columns = [(labels.scorer, name, coordinate) for name in labels.names for coordinate in "xy"]
    xy_px = np.where(labels.known[..., None], labels.xy_px, np.nan)
    values = xy_px.reshape(len(rows), -1)
    levels = ("scorer", "bodyparts", "coords")
    header = [[level, "", "", *cells] for level, cells in zip(levels, zip(*columns, strict=True), strict=True)]
    lines = [[*row, *cells] for row, cells in zip(rows, values.tolist(), strict=True)]
    write_rows(folder / f"{labels.table}.csv", header, lines, guard=False)
    write_bytes(folder / f"{labels.table}.h5", _h5(rows, columns, levels, values))
    coco = json.dumps(_coco(labels), indent=1)
    (folder / COCO).write_text(encodable(coco) + "\n", encoding="utf-8")
    write_rows(folder / ORIGINS, [("image", "keypoint", "x_px", "y_px", "origin")], _origin_rows(labels))


def write_label_pictures(
    labels: LabelledFrames, pictures: Iterable[tuple[int, Image]], folder: Path
) -> Iterator[tuple[int, Path]]:
    """Write pictures with their frame numbers, and yield the number and the file of each."""
    for frame, picture in pictures:
        path = folder / labels.picture(frame)
        write_bytes(path, cv2.imencode(".png", picture)[1].tobytes())
        yield frame, path


def _h5(
    rows: Sequence[tuple[str, ...]], columns: Sequence[tuple[str, ...]], levels: tuple[str, ...], values: Array
) -> bytes:
    """Return DeepLabCut's table as the content of an H5 file, which pandas 2 and 3 read."""
    import pandas as pd

    require_label_writer()

    def index(labels: Sequence[tuple[str, ...]], names: Sequence[str | None]) -> pd.MultiIndex:
        parts = [pd.Index(part, dtype=object) for part in zip(*labels, strict=True)]  # as pandas 2 stores strings
        return pd.MultiIndex.from_arrays(parts, names=[*names])

    table = pd.DataFrame(values, index(rows, [None] * len(rows[0])), index(columns, levels))
    in_memory: dict[str, Any] = {"driver": "H5FD_CORE", "driver_core_backing_store": 0}
    with cast(Any, pd.HDFStore("labels.h5", mode="w", **in_memory)) as store:
        for name in ("create_array", "create_vlarray"):  # pandas does not pass track_times on to every array
            setattr(store._handle, name, partial(getattr(store._handle, name), track_times=False))
        store.put(PANDAS_KEY, table, format="fixed", track_times=False)
        return store._handle.get_file_image()


def _origin_rows(labels: LabelledFrames) -> Iterator[tuple[object, ...]]:
    for i, k in np.argwhere(labels.known):
        x, y = labels.xy_px[i, k].tolist()
        yield labels.picture(int(labels.frames[i])), labels.names[k], x, y, _origin(labels, int(i), int(k))


def _origin(labels: LabelledFrames, i: int, k: int) -> str:
    return labels.origins[i][k] if labels.origins else "by hand"


def _coco(labels: LabelledFrames) -> dict[str, Any]:
    """Return COCO's document, with an annotation and the picture's file name for each frame."""
    width, height = labels.size_px
    images, label_rows = [], []
    for i, frame in enumerate(labels.frames.tolist()):
        known, xy = labels.known[i], np.nan_to_num(labels.xy_px[i])
        images.append({"id": frame, "file_name": labels.picture(frame), "width": width, "height": height})
        visible = np.where(known, _LABELLED, 0)
        low, high = (xy[known].min(axis=0), xy[known].max(axis=0)) if known.any() else (np.zeros(2), np.zeros(2))
        label_rows.append(
            {
                "id": i + 1,
                "image_id": frame,
                "category_id": 1,
                "keypoints": [float(x) for row in np.column_stack([xy, visible]) for x in row],
                "num_keypoints": int(known.sum()),
                "bbox": [*low.tolist(), *(high - low).tolist()],
                "area": float(np.prod(high - low)),
                "iscrowd": 0,
                "origins": [_origin(labels, i, k) if known[k] else "" for k in range(len(labels.names))],
            }
        )
    skeleton = [[a + 1, b + 1] for a, b in labels.edges]
    category = {"id": 1, "name": "animal", "keypoints": [*labels.names], "skeleton": skeleton}
    return {"images": images, "annotations": label_rows, "categories": [category]}
