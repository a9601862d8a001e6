"""Where cameras stand, from a clip of the animal alone: lenses and keypoints in, a file of all cameras out."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from recon.app.clip import Prepared, prepare
from recon.arrays import Array
from recon.calibration import write_cameras
from recon.camera import Camera
from recon.clip import Source, still_view, together
from recon.errors import InputError, Problem, all_of
from recon.files import require_free_file
from recon.progress import Progress, silent
from recon.settings import FitSettings
from recon.solve.extrinsics import TooLittleInCommonError, above_ground, solve_extrinsics


@dataclass(frozen=True, eq=False)
class ExtrinsicsRun:
    """cameras: with poses in a world with z up, the ground at z = 0. sigma (V, 6): of each one's place beside the first
    (`Camera.placed`)."""

    cameras: tuple[Camera, ...]
    sigma: Array
    out: Path

    def to_dict(self) -> dict[str, Any]:
        """Plain strings, numbers and lists."""
        both = zip(self.cameras, self.sigma, strict=True)
        return {
            "cameras": [
                camera.to_dict() | {"turn_sigma_rad": sigma[:3].tolist(), "shift_sigma_m": sigma[3:].tolist()}
                for camera, sigma in both
            ],
            "written": str(self.out),
        }

    def lines(self) -> Iterator[str]:
        """For the terminal."""
        first = self.cameras[0].camera_to_world(np.zeros(3))
        for camera, sigma in zip(self.cameras, self.sigma, strict=True):
            place = camera.camera_to_world(np.zeros(3))
            turn, shift = math.degrees(np.linalg.norm(sigma[:3])), float(np.linalg.norm(sigma[3:]))
            known = f", ± {turn:.1f}° and {shift:.2f} m beside the first" if sigma.any() else ""
            yield f"{camera.name}: {place[2]:.2f} m high, {np.linalg.norm(place - first):.2f} m from the first{known}"


def run_extrinsics(
    settings: FitSettings, out: Path, overwrite: bool = False, progress: Progress = silent
) -> ExtrinsicsRun:
    """`recon calibrate extrinsics`: write `out`, which `recon.calibration.read_cameras` reads.

    Poses in the camera file are not read. Raises InputError, with every problem, for inputs that cannot be used.
    """
    given, _ = all_of(lambda: _each_alone(settings), lambda: _check_out(out, overwrite))
    fps, model = given[0].fps, given[0].model
    assert model.prior is not None
    later = settings.offset_s or (0.0,) * len(given)
    apart = [_without_pose(one.sources[0]) for one in given]
    sources = together(apart, [(s - later[0]) * fps for s in later])
    points = [(source.camera, source.keypoints.xy_px, source.keypoints.confidence) for source in sources]
    views = [replace(still_view(*of), lead_frames=s.lead_frames) for of, s in zip(points, sources, strict=True)]
    try:
        found = solve_extrinsics(views, model.body, model.prior, fps, settings.trajectory_options(), progress)
    except TooLittleInCommonError as error:
        name, first = sources[error.view].camera.name, sources[0].camera.name
        expected = f"some in which it and {first} see enough of the animal for a pose"
        raise InputError(Problem("KEYPOINTS", f"camera {name}", "too few frames", expected)) from None
    cameras = tuple(
        replace(view.camera, rotation=view.T_camera_world[:3, :3], translation_m=view.T_camera_world[:3, 3])
        for view in above_ground(found)
    )
    write_cameras(cameras, out)
    return ExtrinsicsRun(cameras, found.placing_sigma, out)


def _each_alone(settings: FitSettings) -> list[Prepared]:
    """Each camera's keypoints, prepared as a clip of one camera."""
    names = settings.camera_name or (None,) * len(settings.keypoints)
    given = all_of(
        *(
            lambda path=path, name=name: prepare(
                replace(settings, keypoints=(path,), camera_name=None if name is None else (name,), offset_s=None)
            )
            for path, name in zip(settings.keypoints, names, strict=True)
        )
    )
    rates = {one.fps for one in given}
    if len(rates) > 1:
        expected = "one frame rate for all cameras, or --fps"
        raise InputError(Problem("KEYPOINTS", "fps", ", ".join(f"{rate:g}" for rate in sorted(rates)), expected))
    found = [one.sources[0].camera.name for one in given]
    if len(found) < 2 or len(set(found)) < len(found):
        raise InputError(Problem("KEYPOINTS", "cameras", ", ".join(found), "two or more, each once"))
    return list(given)


def _without_pose(source: Source) -> Source:
    return replace(source, camera=replace(source.camera, rotation=None, translation_m=None, world_z_up=True))


def _check_out(out: Path, overwrite: bool) -> None:
    if out.suffix.lower() != ".toml":
        raise InputError(Problem("--out", "file", str(out), "a name that ends in .toml"))
    require_free_file(out, overwrite)
