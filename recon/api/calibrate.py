"""Calibrate a camera from pictures or a video of a board, and write a camera file and a picture of the coverage."""

from __future__ import annotations

import math
from typing import Any, TypeVar

from recon.api.camera_settings import CalibrationSettings
from recon.base.errors import Problem, collect_problems, raise_problems
from recon.base.files import write_bytes
from recon.base.outputs import output_file, require_suffix
from recon.base.progress import Progress, silent
from recon.base.settings import input_paths
from recon.calibrate.board_calibration import calibrate as solved
from recon.calibrate.board_calibration import check as checked
from recon.calibrate.boards import collect, find_views, parse_board
from recon.geometry.lens import LENS_MODELS
from recon.io.camera_files import write_camera
from recon.show.plain import picked

T = TypeVar("T")


def _finite(value: T) -> T | None:
    """Return a value, or None for NaN and infinity, which JSON cannot represent."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def run_calibration(settings: CalibrationSettings, progress: Progress = silent) -> dict[str, Any]:
    """Calibrate a camera from pictures of a board, and write `out` and `<stem>_coverage.png`.

    A calibration that a check refuses is not written unless `force` is set. The picture is always written, because it
    shows what is missing.

    Returns
    -------
    dict
        Plain types: the board; the `camera` and its `parameters` with standard deviations; `rms_px`; the `pictures`
        with their errors, and which of them were used; the `checks` with their verdicts; and the files, of which
        `written` is None if the calibration was refused.

    Raises
    ------
    InputError
        If inputs cannot be used. The message lists every problem.
    """
    picture = settings.out.with_name(f"{settings.out.stem}_coverage.png")
    inputs = input_paths(settings)
    # A picture without a camera file comes from a refused calibration, and may be replaced without --overwrite.
    overwrite = settings.overwrite or not settings.out.exists()
    output = output_file(settings.out, "calibrate", overwrite, inputs)
    known = [name for name, lens in LENS_MODELS.items() if lens.opencv]
    unknown = Problem("--model", "lens model", repr(settings.model), f"one of {', '.join(known)}")
    files, board, *_ = collect_problems(
        lambda: collect(settings.inputs),
        lambda: parse_board(settings.board),
        lambda: raise_problems([unknown] if settings.model not in known else []),
        lambda: require_suffix(settings.out, (".toml",)),
        lambda: output.require((settings.out.name, picture.name)),
    )
    views = find_views(files, board, progress)
    progress("solving", 1.0)
    calibration = solved(views, settings.model, settings.out.stem)
    checks = checked(calibration)
    refused = any(c.verdict == "refused" for c in checks)
    from recon.show.plots.cameras import calibration as drawn  # imports matplotlib
    from recon.show.plots.style import png_of

    with output.staged(adds=True) as folder:
        write_bytes(folder / picture.name, png_of(drawn(calibration)))
        if settings.force or not refused:
            write_camera(calibration.camera, folder / settings.out.name)
    parameters = zip(calibration.parameters.items(), calibration.sigma, strict=True)
    return {
        "board": str(views.board),
        "camera": calibration.camera.to_dict(),
        "rms_px": calibration.rms_px,
        "parameters": [{"name": name, "value": value, "sigma": _finite(sigma)} for (name, value), sigma in parameters],
        "pictures": [
            picked(view, "name", "used", "rms_px", "max_px", "tilt_rad")
            | {"corners": len(view.ids), "distance_m": math.hypot(*view.translation_m)}
            for view in calibration.views
        ],
        "examined": views.examined,
        "found": views.with_board,
        "without_board": list(views.without_board),
        "checks": [
            {name: _finite(value) for name, value in vars(c).items() if name != "advice"}
            | {"verdict": c.verdict, "text": str(c)}
            for c in checks
        ],
        "picture": str(picture),
        "written": str(settings.out) if settings.force or not refused else None,
    }
