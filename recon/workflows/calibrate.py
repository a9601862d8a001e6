"""A camera's calibration: pictures or a video of a board in, a camera file and a picture of the evidence out."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2

from recon.base.errors import InputError, Problem, all_of
from recon.base.files import require_free_file, staged_folder, write_bytes
from recon.base.progress import Progress, silent
from recon.calibrate.intrinsics import (
    BoardViews,
    Calibration,
    CalibrationCheck,
    calibrate,
    check,
    collect,
    draw,
    find_views,
    parse_board,
)
from recon.geometry.lens import LENS_MODELS
from recon.io import write_camera


@dataclass(frozen=True)
class CalibrationRun:
    """A calibration with the views it came from and what was checked."""

    views: BoardViews
    calibration: Calibration
    checks: tuple[CalibrationCheck, ...]
    picture: Path
    written: Path | None
    """The camera file, or None."""

    @property
    def refused(self) -> tuple[CalibrationCheck, ...]:
        return tuple(c for c in self.checks if c.verdict == "refused")

    def to_dict(self) -> dict[str, Any]:
        """Plain strings, numbers and lists."""
        calibration = self.calibration
        return {
            "board": str(self.views.board),
            "camera": calibration.camera.to_dict(),
            "rms_px": calibration.rms_px,
            "parameters": [
                {"name": name, "value": value, "sigma": _finite(sigma)}
                for (name, value), sigma in zip(calibration.parameters.items(), calibration.sigma, strict=True)
            ],
            "pictures": [
                {
                    "name": view.name,
                    "used": view.used,
                    "corners": len(view.corners.ids),
                    "rms_px": view.rms_px,
                    "max_px": view.max_px,
                    "tilt_rad": view.tilt_rad,
                    "distance_m": math.hypot(*view.translation_m),
                }
                for view in calibration.views
            ],
            "examined": self.views.examined,
            "found": self.views.found,
            "without_board": list(self.views.without_board),
            "checks": [
                {name: _finite(value) for name, value in vars(c).items() if name != "advice"} | {"verdict": c.verdict}
                for c in self.checks
            ],
            "picture": str(self.picture),
            "written": None if self.written is None else str(self.written),
        }


def _finite(value: Any) -> Any:
    """JSON has no NaN, and no infinity."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def run_calibration(
    inputs: Sequence[Path],
    board: str,
    model: str,
    out: Path,
    *,
    force: bool = False,
    overwrite: bool = False,
    progress: Progress = silent,
) -> CalibrationRun:
    """`recon calibrate`: write `out` (`recon.io.write_camera`) and, beside it, `<stem>_coverage.png`.

    A calibration that a check refuses is not written unless `force`; the picture is, since it shows what is missing.
    Raises InputError, with every problem, for inputs that cannot be used.
    """
    picture = out.with_name(f"{out.stem}_coverage.png")
    files, the_board, lens, _ = all_of(
        lambda: collect(inputs),
        lambda: parse_board(board),
        lambda: _model(model),
        lambda: require_free_file(out, overwrite, suffixes=(".toml",)),
    )
    views = find_views(files, the_board, progress)
    progress("solving", 1.0)
    calibration = calibrate(views, lens, out.stem)
    checks = check(calibration)
    refused = any(c.verdict == "refused" for c in checks)
    with staged_folder(out.absolute().parent) as folder:
        write_bytes(folder / picture.name, cv2.imencode(".png", draw(calibration))[1].tobytes())
        if force or not refused:
            write_camera(calibration.camera, folder / out.name)
    return CalibrationRun(views, calibration, checks, picture, out if force or not refused else None)


def _model(model: str) -> str:
    known = [name for name, lens in LENS_MODELS.items() if lens.opencv]
    if model in known:
        return model
    raise InputError(Problem("--model", "lens model", repr(model), "one of " + ", ".join(known)))
