"""A camera's calibration: pictures or a video of a board in, a camera file and a picture of the evidence out."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2

from recon.base.errors import InputError, Problem, all_of
from recon.base.files import require_free_file, staged_folder, write_bytes
from recon.base.progress import Progress, silent
from recon.base.settings import OneOrMore, Option, Settings
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
                    "corners": len(view.ids),
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


class CalibrationSettings(Settings):
    """What `recon calibrate` is told."""

    inputs: Annotated[
        OneOrMore[Path],
        Option("Pictures or folders of pictures of a board, or one video.", argument="IMAGES|FOLDER|VIDEO"),
    ]
    board: Annotated[
        str,
        Option(
            "chessboard:9x6:25mm (inner corners, side of a square) or charuco:5x7:40mm:30mm:DICT_4X4_50 (squares, side "
            "of a square, of a marker, dictionary; :legacy for the layout of OpenCV before 4.6)."
        ),
    ]
    model: Annotated[
        str,
        Option(
            "radtan for most lenses, fisheye for action cameras and other lenses wider than 100 degrees, pinhole for "
            "pictures that have been undistorted."
        ),
    ]
    out: Annotated[Path, Option("The camera file, as in camera.toml.")]
    force: Annotated[bool, Option("Write a calibration that is refused.")] = False
    overwrite: Annotated[bool, Option("Replace the camera file.")] = False


def run_calibration(settings: CalibrationSettings, progress: Progress = silent) -> CalibrationRun:
    """`recon calibrate`: write `out` (`recon.io.write_camera`) and, beside it, `<stem>_coverage.png`.

    A calibration that a check refuses is not written unless `force`; the picture is, since it shows what is missing.
    Raises InputError, with every problem, for inputs that cannot be used.
    """
    picture = settings.out.with_name(f"{settings.out.stem}_coverage.png")
    files, the_board, lens, _ = all_of(
        lambda: collect(settings.inputs),
        lambda: parse_board(settings.board),
        lambda: _model(settings.model),
        lambda: require_free_file(settings.out, settings.overwrite, suffixes=(".toml",)),
    )
    views = find_views(files, the_board, progress)
    progress("solving", 1.0)
    calibration = calibrate(views, lens, settings.out.stem)
    checks = check(calibration)
    refused = any(c.verdict == "refused" for c in checks)
    with staged_folder(settings.out.absolute().parent) as folder:
        write_bytes(folder / picture.name, cv2.imencode(".png", draw(calibration))[1].tobytes())
        if settings.force or not refused:
            write_camera(calibration.camera, folder / settings.out.name)
    return CalibrationRun(views, calibration, checks, picture, settings.out if settings.force or not refused else None)


def _model(model: str) -> str:
    known = [name for name, lens in LENS_MODELS.items() if lens.opencv]
    if model in known:
        return model
    raise InputError(Problem("--model", "lens model", repr(model), "one of " + ", ".join(known)))
