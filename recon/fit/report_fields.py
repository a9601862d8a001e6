"""What is read back from a fit's report.json, as it has to be: see `recon.fit.results`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from recon.base.documents import validated
from recon.base.errors import InputError, Problem
from recon.geometry.camera import Camera
from recon.io.pose3d import Pose3D

AS_WRITTEN = "as `recon fit` wrote it"
PROBLEMS_SHOWN = 5

Number = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Triple = Annotated[list[Number | None], Field(min_length=3, max_length=3)]
Pair = Annotated[list[Number], Field(min_length=2, max_length=2)]


class _Part(BaseModel):
    """There may be more than is read."""

    model_config = ConfigDict(extra="ignore", strict=True, frozen=True)


class _Settings(_Part):
    skeleton: str | None = None
    subject: str | None = None


class _Input(_Part):
    fps: Positive
    camera: dict[str, Any]


class _Track(_Part):
    rotation: list[Annotated[list[Triple], Field(min_length=3, max_length=3)]]


class _Camera(_Part):
    camera: dict[str, Any]
    track: _Track | None = None


class _Side(_Part):
    fitted: Literal["left", "right"] | None


class _Skeleton(_Part):
    name: str
    title: str
    joints: list[str]
    keypoints: list[str]
    state_names: list[str]
    feet: dict[str, str] | None = None


class _Size(_Part):
    factor: Positive


class _Ground(_Part):
    height_m: Number
    middle_m: Pair
    slope: Pair
    sigma_m: Number


class _Spell(_Part):
    frames: Annotated[list[int], Field(min_length=2, max_length=2)]
    ground: _Ground | None
    prior_weight: Annotated[float, Field(gt=0, le=1)] = 1.0


class _RootPath(_Part):
    keypoint: str


class _Frame(_Part):
    flags: list[str]


class _Finding(_Part):
    code: str
    severity: Literal["error", "warning", "note"]
    camera: str | None
    frames: Annotated[list[int], Field(min_length=2, max_length=2)] | None
    text: str


class _Outlier(_Part):
    frame: int
    keypoint: str
    camera: str | None = None


_Errors = list[list[list[Number | None]]]


class _ImageError(_Part):
    values: _Errors
    others: list[_Errors] = []


class _Report(_Part):
    method: Literal["trajectory", "frame"]
    settings: _Settings
    input: _Input
    cameras: list[_Camera] = []
    side: _Side
    skeleton: _Skeleton
    root_path: _RootPath
    frames: list[_Frame]
    findings: list[_Finding]
    outliers: list[_Outlier]
    image_error_px: _ImageError
    size: _Size | None = None
    segments: list[_Spell] = []


def require_fields(report: dict[str, Any], path: Path) -> tuple[Camera, ...]:
    """The cameras of a report whose fields are there and of the right kinds. Raises InputError."""
    try:
        parsed = validated(_Report, report, path)
    except InputError as error:
        raise InputError(
            replace(problem, expected=f"{problem.expected}, {AS_WRITTEN}")
            for problem in error.problems[:PROBLEMS_SHOWN]
        ) from None
    if parsed.method == "trajectory" and parsed.size is None:
        raise InputError(Problem(path, "size", "nothing", AS_WRITTEN))
    described = {"input.camera": parsed.input.camera}
    described |= {f"cameras[{v}].camera": part.camera for v, part in enumerate(parsed.cameras[1:], start=1)}
    cameras, problems = [], []
    for field, camera in described.items():
        try:
            if not isinstance(camera["name"], str):
                raise TypeError(f"the name {camera['name']}")
            cameras.append(Camera.from_dict(camera))
        except (ValueError, KeyError, TypeError, OverflowError, AttributeError) as error:
            problems.append(Problem(path, field, str(error)[:200], AS_WRITTEN))
    if problems:
        raise InputError(problems)
    return tuple(cameras)


def require_fitting(report: dict[str, Any], pose: Pose3D, path: Path) -> None:
    """Raises InputError where the fields of a report do not fit the positions beside it."""
    parsed = _Report.model_validate(report)
    skeleton, (T, J) = parsed.skeleton, pose.xyz_m.shape[:2]
    frames = set(pose.frames.tolist())
    errors = (parsed.image_error_px.values, *parsed.image_error_px.others)
    names = [camera.camera.get("name") for camera in parsed.cameras]
    checks = {
        "skeleton.keypoints": sorted(skeleton.keypoints) == sorted(pose.names),
        "skeleton.joints": len(skeleton.joints) == len(set(skeleton.joints)) == J,
        "skeleton.state_names": len(skeleton.state_names) == len(set(skeleton.state_names)),
        "skeleton.feet": set((skeleton.feet or {}).values()) <= set(pose.names),
        "root_path.keypoint": parsed.root_path.keypoint in pose.names,
        "frames": len(parsed.frames) == T,
        "cameras": all(camera.track is None or len(camera.track.rotation) == T for camera in parsed.cameras),
        "outliers": all(
            o.frame in frames and o.keypoint in pose.names and (o.camera is None or o.camera in names)
            for o in parsed.outliers
        ),
        "image_error_px.values": all(
            np.array([[len(row) for row in joint] for joint in of_one], object).shape == (J, 2)
            and all(len(row) == T for joint in of_one for row in joint)
            for of_one in errors
        ),
        "image_error_px.others": len(errors) == max(len(parsed.cameras), 1),
    }
    problems = [
        Problem(path, field, "something else than pose3d.csv has", AS_WRITTEN) for field, ok in checks.items() if not ok
    ]
    if problems:
        raise InputError(problems)
