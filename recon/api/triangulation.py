"""Triangulate keypoints of several cameras without a skeleton, from files or from Python objects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np

from recon.api.clip_cameras import read_clip_cameras
from recon.api.clip_inputs import arrange, cleaned_source, read_clips, require_size_of_animal
from recon.api.clip_results import input_files
from recon.api.settings import FitSettings
from recon.base.arrays import Array, Brief
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.outputs import Output
from recon.check.inputs import same_keypoints
from recon.clip import Keypoints, Source, align_cameras, clean, views_of
from recon.fit.triangulation import Triangulation, smoothed, triangulate_views
from recon.gait.evaluation import POSE3D, TRIANGULATED
from recon.geometry.camera import Camera
from recon.io.common import Pose3D

COVARIANCES = "pose3d_covariance.csv"
"""File of covariances that `recon triangulate` writes, in addition to `POSE3D` and `TRIANGULATED`."""
_COVARIANCE_COLUMNS = {"xx": (0, 0), "xy": (0, 1), "xz": (0, 2), "yy": (1, 1), "yz": (1, 2), "zz": (2, 2)}


@dataclass(frozen=True, eq=False, repr=False)
class TriangulatedClip(Brief):
    """Triangulated points of a clip: T frames of J keypoints seen by V cameras."""

    names: tuple[str, ...]
    """Names of the J keypoints."""
    frames: Array
    """Frame numbers of the first camera, (T,)."""
    fps: float
    cameras: tuple[str, ...]
    """Names of the V cameras."""
    knows_up: bool
    """Whether the cameras' poses define the upward direction. If not, z is up only if the first camera is level."""
    result: Triangulation
    is_smoothed: bool = False

    @property
    def points_m(self) -> Array:
        """Return the points (T, J, 3) in metres, with z up, and NaN in gaps."""
        return self.result.points_m

    @property
    def covariance_m2(self) -> Array:
        """Return the covariances of the points, (T, J, 3, 3), m²."""
        return self.result.covariance_m2

    @cached_property
    def pose3d(self) -> Pose3D:
        """Return the points as a `Pose3D`, which all writers accept."""
        return Pose3D(self.names, self.points_m, self.frames, fps=self.fps, sigma_m=self.result.sigma_m)

    def summary(self) -> dict[str, Any]:
        """Return the content of `TRIANGULATED` in plain types, which states how well points and detections agree."""
        result = self.result
        is_known = np.isfinite(result.points_m[..., 0])
        is_compared = np.isfinite(result.error_px)
        seen_by_several = is_compared.sum(axis=0) >= 2
        cameras = {}
        for name, error_px, is_used, compared in zip(
            self.cameras, result.error_px, result.is_used, is_compared, strict=True
        ):
            count = int(compared.sum())
            cameras[name] = {
                "median_error_px": float(np.median(error_px[compared])) if count else None,
                "compared": count,
                "left_out": int((compared & ~is_used).sum()),
            }
        sigma_m = np.linalg.norm(result.sigma_m[is_known], axis=-1)
        return {
            "frames": len(self.frames),
            "keypoints": len(self.names),
            "points": int(is_known.sum()),
            "share_known": float(is_known.mean()),
            "points_of_three_or_more_cameras": int((result.is_used.sum(axis=0) >= 3).sum()),
            "compared": int(seen_by_several.sum()),
            "median_sigma_m": float(np.median(sigma_m)) if len(sigma_m) else None,
            "sigma_px": dict(zip(self.names, result.sigma_px.tolist(), strict=True)),
            "cameras": cameras,
            "smoothed": self.is_smoothed,
            "knows_up": self.knows_up,
        }


def triangulate(
    keypoints: Sequence[Keypoints],
    cameras: Sequence[Camera],
    sigma_px: float = 3.0,
    smooth: bool = False,
    likelihood_min: float = 0.5,
) -> TriangulatedClip:
    """Triangulate keypoints that several cameras saw at the same time, without a skeleton.

    Parameters
    ----------
    keypoints
        Keypoints of V >= 2 synchronised cameras, as read. All cameras are assumed to have the first one's frame rate.
    cameras
        The cameras in the same order, each with its pose.
    sigma_px
        Expected noise of the detections in pixels, one standard deviation. The estimate of each keypoint's noise starts
        from this value.
    smooth
        Whether to smooth the points over time with splines, which also fill gaps of up to 0.2 s.
    likelihood_min
        Detections with a likelihood below this, 0 to 1, are left out.

    Returns
    -------
    TriangulatedClip
        Points (T, J, 3) of all keypoints in the files, metres, with covariances; NaN if fewer than two cameras agree.

    Raises
    ------
    InputError
        If there are fewer than two cameras, a camera has no pose, or keypoints have no frame rate or no detection that
        is likely enough.
    """
    if len(keypoints) < 2 or len(keypoints) != len(cameras):
        actual = f"{len(keypoints)} keypoint files and {len(cameras)} cameras"
        raise InputError(Problem("triangulate", "cameras", actual, "two or more files, and a camera for each"))
    fps = keypoints[0].fps
    if fps is None:
        raise InputError(Problem("triangulate", "fps", "keypoints without a frame rate", "frames per second"))
    cleaned = collect_problems(*(partial(clean, file, likelihood_min) for file in keypoints))
    sources = [
        Source(camera, points, report, file.names)
        for camera, file, (points, report) in zip(cameras, keypoints, cleaned, strict=True)
    ]
    return _triangulated(sources, (0.0,) * len(sources), fps, sigma_px, smooth)


def triangulate_files(settings: FitSettings, smooth: bool = False) -> TriangulatedClip:
    """Triangulate the keypoint files of a clip.

    Parameters
    ----------
    settings
        Settings of a fit, of which only `TRIANGULATION_SETTINGS` are read.
    smooth
        As in `triangulate`.

    Raises
    ------
    InputError
        If files or settings cannot be used. The message lists all problems.
    """
    if len(settings.keypoints) < 2:
        expected = "a keypoint file for each of two or more cameras; a single camera needs a skeleton (recon fit)"
        raise InputError(Problem("KEYPOINTS", "files", "one keypoint file", expected))
    files, cameras = collect_problems(lambda: read_clips(settings), lambda: read_clip_cameras(settings))
    fps = files[0].fps
    assert fps is not None
    offsets_s = settings.offset_s or (0.0,) * len(files)
    later_frames = tuple((offset_s - offsets_s[0]) * fps for offset_s in offsets_s)
    sources = collect_problems(
        *(
            partial(cleaned_source, settings, fps, file, camera, later)
            for file, camera, later in zip(files, cameras, later_frames, strict=True)
        )
    )
    clip = _triangulated(sources, later_frames, fps, settings.sigma_px, smooth)
    require_size_of_animal(clip.points_m, settings.camera_unit)
    return clip


def _triangulated(
    sources: Sequence[Source], later_frames: Sequence[float], fps: float, sigma_px: float, smooth: bool
) -> TriangulatedClip:
    without = [source.camera.name for source in sources if not source.moves and not source.camera.has_extrinsics]
    if without:
        raise InputError(
            Problem("--camera", "poses", f"no poses of {', '.join(without)}", "a camera file with all poses")
        )
    names = tuple(dict.fromkeys(name for source in sources for name in source.keypoints.names))
    arranged = [replace(source, keypoints=arrange(source.keypoints, names)) for source in sources]
    copies = [f"the same points from {' and '.join(cameras)}" for cameras, _ in same_keypoints(arranged)]
    raise_problems(Problem("KEYPOINTS", "keypoints", copy, "a different file for each camera") for copy in copies)
    aligned = align_cameras(arranged, later_frames)
    result = triangulate_views(views_of(aligned), sigma_px)
    cameras = tuple(source.camera.name for source in aligned)
    knows_up = all(source.moves or source.camera.knows_up for source in aligned)
    result = smoothed(result, fps) if smooth else result
    return TriangulatedClip(names, aligned[0].keypoints.frames, fps, cameras, knows_up, result, smooth)


def run_triangulation(
    settings: FitSettings, out: str | Path, smooth: bool = False, overwrite: bool = False
) -> TriangulatedClip:
    """Triangulate the keypoint files of a clip, and write `POSE3D`, `COVARIANCES` and `TRIANGULATED` into a folder.

    Raises
    ------
    InputError
        If files or settings cannot be used, no point can be triangulated, or a file to be written exists that this
        command did not write or that was changed afterwards.
    """
    from recon.io.deeplabcut import write_csv
    from recon.io.writing import write_table
    from recon.show.plain import to_json

    inputs = [*input_files(settings).values()]
    output = Output(Path(out), "triangulate", overwrite, inputs, content="triangulated points")
    output.require((POSE3D, COVARIANCES, TRIANGULATED))
    clip = triangulate_files(settings, smooth)
    if not np.isfinite(clip.points_m[..., 0]).any():
        actual = "no keypoint that two cameras saw in the same frame and at the same position"
        expected = "synchronised cameras with the poses of these clips (recon fit reports which camera is off)"
        raise InputError(Problem("KEYPOINTS", "points", actual, expected))
    header = [
        ["bodyparts", *(name for name in clip.names for _ in _COVARIANCE_COLUMNS)],
        ["coords", *(column for _ in clip.names for column in _COVARIANCE_COLUMNS)],
    ]
    rows, columns = np.array([*_COVARIANCE_COLUMNS.values()]).T
    covariances = clip.covariance_m2[:, :, rows, columns].reshape(len(clip.frames), -1)
    with output.staged() as folder:
        write_csv(clip.pose3d, folder / POSE3D)
        write_table(folder / COVARIANCES, header, clip.frames, covariances, guard=False)
        (folder / TRIANGULATED).write_text(to_json(clip.summary()), encoding="utf-8")
    return clip
