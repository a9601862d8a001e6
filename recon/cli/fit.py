"""The command `recon fit`: its options, and its output."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from collections.abc import Set as AbstractSet
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from rich.console import Console

from recon.api.settings import FitSettings
from recon.base.errors import InputError, Problem, collect_problems, problems_of
from recon.base.progress import Progress
from recon.base.settings import Settings
from recon.cli.answers import Answer, answer_of_fit, say
from recon.cli.commands import OptionsOf


class FitRunSettings(Settings):
    """Settings of `recon fit` and `recon frame` in addition to the settings of the fit itself."""

    out: Path | None = None
    """Folder for the results, such as results/clip1."""
    config: Path | None = None
    """config.toml of an earlier run. Options given here override it."""
    overwrite: bool = False
    """Replace results in the folder. An earlier page and analysis made from them are deleted."""


_FitOptions = Annotated[dict[str, Any], OptionsOf(FitSettings)]


def fit(settings: FitRunSettings, options: _FitOptions, console: Console, progress: Progress) -> Answer:
    """Reconstruct one clip: turn keypoints and a camera into 3D poses, angles, report.json and a playback.

    Example: recon fit clip.csv --camera scene.json --camera-name cam2 --fps 90 --out results/clip

    Exit code 0: finished, whatever the verdict. 1: no frame could be solved. 2: the input cannot be used.
    """
    from recon.api.clip_inputs import prepare
    from recon.api.clip_results import replaced_files, run_clip

    out, config = settings.out, settings.config
    no_out = [Problem("--out", "folder", "nothing", "a folder for the results, such as results/clip1")]
    try:
        fitted = _read(config, options)
    except InputError as error:
        of_files = _problems_of_files(config, options, {problem.field for problem in error.problems})
        raise InputError((*of_files, *error.problems, *([] if out else no_out))) from None
    if out is None:
        raise InputError((*problems_of(lambda: prepare(fitted)), *no_out))
    for path in [] if config is None else replaced_files(config, options, fitted):
        say(console, f"note: {path} is not the file for which {config} was written: its content differs")
    return answer_of_fit(run_clip(fitted, out, settings.overwrite, progress), out)


def _read(config: Path | None, options: Mapping[str, Any]) -> FitSettings:
    from recon.api.clip_results import read_config, read_settings

    return read_settings(None, options) if config is None else read_config(config, options)


_WITHOUT_CAMERA = ("individual", "rename", "fps", "skeleton", "subject", "detector", "size", "height_m", "prior")
"""Settings by which keypoint files and the skeleton can be checked before the camera is known."""
_ANY_CAMERA: dict[str, Any] = {"hfov_deg": 60.0, "image_size_px": (1, 1)}
"""A camera with which `FitSettings` are complete. The readers of keypoint files and of skeletons do not look at it."""


def _problems_of_files(config: Path | None, options: Mapping[str, Any], wrong: AbstractSet[str]) -> Iterable[Problem]:
    """Return the problems with a fit's files, ignoring the settings named in `wrong`, whose values are invalid.

    If the other settings are complete, all inputs are checked. Otherwise, usually because the camera is missing, each
    keypoint file is checked on its own, with the skeleton.
    """
    from recon.api.clip_inputs import prepare, read_clips, read_model
    from recon.io.formats import read_keypoints

    usable = {name: value for name, value in options.items() if name not in wrong}
    follows = ("camera",) if "camera_name" in wrong else ()  # without names, cameras would be reported as not chosen
    if "method" not in wrong:  # the method determines the skeletons
        with suppress(InputError):
            rest = _read(config, usable)
            problems_of_rest = problems_of(lambda: prepare(rest))
            return [problem for problem in problems_of_rest if problem.field not in wrong | {*follows}]
    known = {name: value for name, value in usable.items() if name in _WITHOUT_CAMERA}
    checks: list[Callable[[], object]] = []
    for path in options.get("keypoints") or ():
        try:
            clip = FitSettings(keypoints=(path,), **_ANY_CAMERA, **known)
            checks += [partial(read_clips, clip), *([] if "method" in options else [partial(read_model, clip)])]
        except InputError:
            checks.append(partial(read_keypoints, path, options.get("individual")))
    problems: dict[tuple[str | Path, str], Problem] = {}
    for problem in problems_of(lambda: collect_problems(*checks)):
        problems.setdefault((problem.file, problem.field), problem)  # a missing --fps is stated once for all files
    return [problem for problem in problems.values() if problem.field not in wrong]
