"""Plain CSV tables of keypoints (see `recon.io.columns`), with a column `fps` where the frame rate is known."""

from __future__ import annotations

from pathlib import Path

from recon.export.table import write_rows
from recon.keypoints import Keypoints


def write_long(keypoints: Keypoints, path: Path) -> None:
    """One row for each frame and keypoint: frame, individual (if named), bodypart, x, y, likelihood, fps."""
    start, end = _more(keypoints)
    header = ["frame", *start, "bodypart", "x", "y", "likelihood", *end]
    rows = (
        [frame, *start.values(), name, *keypoints.xy_px[t, k], keypoints.confidence[t, k], *end.values()]
        for t, frame in enumerate(keypoints.frames)
        for k, name in enumerate(keypoints.names)
    )
    write_rows(path, [header], rows)


def write_wide(keypoints: Keypoints, path: Path) -> None:
    """One row for each frame: frame, individual (if named), NAME_x, NAME_y, NAME_likelihood, ..., fps."""
    start, end = _more(keypoints)
    of_points = [f"{name}_{coord}" for name in keypoints.names for coord in ("x", "y", "likelihood")]
    rows = []
    for t, frame in enumerate(keypoints.frames):
        cells = [v for xy, c in zip(keypoints.xy_px[t], keypoints.confidence[t], strict=True) for v in (*xy, c)]
        rows.append([frame, *start.values(), *cells, *end.values()])
    write_rows(path, [["frame", *start, *of_points, *end]], rows)


def _more(keypoints: Keypoints) -> tuple[dict[str, str], dict[str, float]]:
    """Columns that are the same in all rows, before and after the others."""
    start = {} if keypoints.individual is None else {"individual": keypoints.individual}
    return start, {} if keypoints.fps is None else {"fps": keypoints.fps}
