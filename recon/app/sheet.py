"""Frames of a result side by side, as one picture: what was detected, and where the pose puts it."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import cv2
import numpy as np

from recon.app.overlay import overlay_of, result_and_video
from recon.arrays import Index
from recon.errors import InputError, Problem
from recon.files import require_free_file, staged_file, write_bytes
from recon.overlay import Overlay, draw_sheet
from recon.results import Results
from recon.video import Image, read_frames

COUNT, MOST = 12, 60


def run_sheet(
    folder: Path,
    sheet: Path,
    *,
    video: Path | None = None,
    first_frame: int = 0,
    camera: str | None = None,
    count: int = COUNT,
    overwrite: bool = False,
) -> int:
    """`recon overlay --sheet`: `count` frames with a pose, evenly spaced, as one PNG; how many there are. video: what
    is behind them, plain without one, and then the first camera's unless another is named; the others: see
    `run_overlay`. Raises InputError, with every problem."""
    check = partial(_check, sheet, count, overwrite, video)
    result, number, _ = result_and_video(folder, video, camera, first_frame, check)
    overlay = overlay_of(result, number=number)
    rows = rows_to_show(overlay, count)
    if not len(rows):
        raise InputError(Problem(folder, "frames", "none with a pose", "one at least"))
    pictures = None if video is None else pictures_of(video, result, rows, first_frame)
    with staged_file(sheet) as staged:
        write_bytes(staged, cv2.imencode(".png", draw_sheet(overlay, rows, pictures))[1].tobytes())
    return len(rows)


def rows_to_show(overlay: Overlay, count: int) -> Index:
    """Rows of up to `count` frames with a pose, evenly spaced."""
    posed = np.flatnonzero(np.isfinite(overlay.reprojected_px).any(axis=(1, 2)))
    return posed[np.unique(np.round(np.linspace(0, len(posed) - 1, count)).astype(int))] if len(posed) else posed


def pictures_of(video: Path, result: Results, rows: Index, first_frame: int) -> list[Image]:
    """The video's frames for these rows of a result. Raises InputError for one that is not in it."""
    wanted = [int(result.pose.frames[t]) - first_frame for t in rows]
    found = {at: picture for at, picture in read_frames(video, wanted[0], wanted[-1] + 1) if at in wanted}
    if len(found) < len(wanted):
        number = next(at for at in wanted if at not in found) + first_frame
        raise InputError(Problem(video, "video", f"no frame {number}", "the video of this clip, or --first-frame"))
    return [found[at] for at in wanted]


def _check(sheet: Path, count: int, overwrite: bool, video: Path | None) -> None:
    problems = []
    if sheet.suffix.lower() != ".png":
        problems.append(Problem("--sheet", "file", repr(str(sheet)), "a file name that ends in .png"))
    if not 1 <= count <= MOST:
        problems.append(Problem("--count", "number", str(count), f"1 to {MOST} frames"))
    if problems:
        raise InputError(problems)
    require_free_file(sheet, overwrite, "--sheet", video)
