"""A camera's calibration: pictures or a video of a board in, a camera file and a picture of the evidence out."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

from recon.base.errors import InputError, Problem, all_of
from recon.base.files import require_free_file, staged_folder, write_bytes
from recon.base.progress import Progress, silent
from recon.base.settings import OneOrMore, Option, Settings
from recon.calibrate.intrinsics import (
    calibrate,
    check,
    collect,
    draw,
    find_views,
    parse_board,
)
from recon.geometry.lens import LENS_MODELS
from recon.io import write_camera


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


def run_calibration(settings: CalibrationSettings, progress: Progress = silent) -> dict[str, Any]:
    """`recon calibrate`: write `out` (`recon.io.write_camera`) and, beside it, `<stem>_coverage.png`;
    what was found and checked, as plain types.

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
        write_bytes(folder / picture.name, draw(calibration))
        if settings.force or not refused:
            write_camera(calibration.camera, folder / settings.out.name)
    parameters = zip(calibration.parameters.items(), calibration.sigma, strict=True)
    return {
        "board": str(views.board),
        "camera": calibration.camera.to_dict(),
        "rms_px": calibration.rms_px,
        "parameters": [{"name": name, "value": value, "sigma": _finite(sigma)} for (name, value), sigma in parameters],
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
        "examined": views.examined,
        "found": views.found,
        "without_board": list(views.without_board),
        "checks": [
            {name: _finite(value) for name, value in vars(c).items() if name != "advice"}
            | {"verdict": c.verdict, "text": str(c)}
            for c in checks
        ],
        "picture": str(picture),
        "written": str(settings.out) if settings.force or not refused else None,
    }


def _model(model: str) -> str:
    known = [name for name, lens in LENS_MODELS.items() if lens.opencv]
    if model in known:
        return model
    raise InputError(Problem("--model", "lens model", repr(model), "one of " + ", ".join(known)))
