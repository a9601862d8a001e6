"""What a fit wrote into a folder, read back for what comes after: analysis, inverse kinematics, pictures.

Everything stands in the upright frame, metres, z up: the world frame where that is known to have z up, otherwise the
level frame (docs/report.md). The files read are report.json, pose3d.csv, angles.csv, pose3d_sigma.csv and
angles_sigma.csv, all as one run of `recon fit` wrote them: manifest.json says which that are.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from recon.animal.body import Body, Side
from recon.animal.skeleton_file import load_skeleton
from recon.base.arrays import Array, median
from recon.base.documents import read_json
from recon.base.errors import InputError, Problem, all_of
from recon.base.manifest import Manifest, read_manifest
from recon.clip import world_from_reference
from recon.fit.report_fields import require_fields, require_fitting
from recon.fit.result import Ground, MotionSegment
from recon.geometry.camera import Camera
from recon.geometry.frames import moved
from recon.io.pose3d import Pose3D, read_pose3d

SCHEMA_NAME, SCHEMA_VERSION = "recon.fit.report", 4
"""Of report.json."""
MADE_BY = {
    "recon.retarget": "recon retarget",
    "recon.climb": "recon climb",
    "recon.analysis": "recon analyse",
    "recon.ik": "recon ik",
}
"""The commands whose folders may be taken for a fit's, by the schema of their reports."""
REPORT, TABLES, SIGMAS = "report.json", ("pose3d.csv", "angles.csv"), "pose3d_sigma.csv"
ANGLE_SIGMAS = "angles_sigma.csv"
"""What is read."""
MEASURED_SHARE = 0.5
"""A quantity with less of its precision from the pixels is not called measured."""

LARGEST = 1e12
"""Of a number in a table: more can only be damage."""


@dataclass(frozen=True, eq=False)
class Results:
    """T frames of J joints, which are called as their keypoints."""

    folder: Path
    manifest: Manifest
    """Of the run, for those who read more of its files."""
    report: dict[str, Any]
    fps: float
    cameras: tuple[Camera, ...]
    """As they were for the fit."""
    body: Body
    pose: Pose3D
    """In the upright frame."""
    states: Array
    """(T, D): the rows of angles.csv, in the units and the frame that it has."""
    sigma_m: Array
    """(T, J, 3): one standard deviation of the joints' positions, along the upright frame's axes."""
    relative_sigma_m: Array
    """(T, J, 3): the same of the joints relative to the mean of all joints."""
    angle_sigma_rad: Array
    """(T, A): one standard deviation of the angles."""
    angle_data_share: Array
    """(T, A): the part of the angles' precision that comes from the pixels."""

    @property
    def camera(self) -> Camera:
        """The first, or only one."""
        return self.cameras[0]

    @property
    def camera_moves(self) -> bool:
        """The first: its track says where it was, and the world has z up."""
        return self.track(0) is not None

    @property
    def knows_up(self) -> bool:
        """Whether the upright frame is the world."""
        return self.camera.knows_up or self.camera_moves

    def track(self, number: int) -> dict[str, Any] | None:
        """Where a camera was that moves, see `cameras` in docs/report.md; None of one that stands still."""
        return _track(self.report, number)

    @property
    def R_upright_reference(self) -> Array:
        """(3, 3): rotation from the frame of reference that the fit's files have."""
        return np.eye(3) if self.camera_moves else world_from_reference(self.camera)[:3, :3]

    @property
    def method(self) -> str:
        """trajectory or frame."""
        return self.report["method"]

    @property
    def skeleton_name(self) -> str:
        """As it was given for the fit, which may be a file, or the name."""
        return skeleton_names(self.report, self.folder)[0]

    @cached_property
    def flags(self) -> tuple[tuple[str, ...], ...]:
        """(T,): what is doubtful about a frame; a frame without a pose has one that says why."""
        return tuple(tuple(frame["flags"]) for frame in self.report["frames"])

    @property
    def jitters(self) -> bool:
        """Each frame was solved by itself: paths jitter from frame to frame, and sigmas are given the frame before."""
        return self.method == "frame"

    @cached_property
    def time_s(self) -> Array:
        """(T,): since frame 0 of the keypoint file."""
        return self.pose.frames / self.fps

    @cached_property
    def keypoint_of(self) -> dict[str, str]:
        """The keypoint that a joint of the skeleton is called by."""
        return dict(zip(self.report["skeleton"]["joints"], self.report["skeleton"]["keypoints"], strict=True))

    @property
    def limbs(self) -> dict[str, tuple[int, ...]]:
        """Joints along each limb, as indices, for drawing."""
        return self.body.limb_rows

    @cached_property
    def forward(self) -> tuple[str, str]:
        """Two joints, from rear to front."""
        rear, front = self.body.forward
        return self.keypoint_of[rear], self.keypoint_of[front]

    @cached_property
    def feet(self) -> dict[str, str]:
        """Joints of the feet by LH, RH, LF, RF (left or right, hind or fore), those that there are."""
        return self.report["skeleton"]["feet"]

    @cached_property
    def limb_sides(self) -> dict[str, Side | None]:
        """The side of each of the limbs; None: the middle."""
        return self.body.limb_sides(self.report["side"]["fitted"])

    @cached_property
    def segments(self) -> tuple[MotionSegment, ...]:
        """The stretches of the clip that were solved, each by itself, and the ground that was found under them, in the
        upright frame. One with all frames where the fit wrote none down."""
        segments = []
        for segment in self.report.get("segments", ()):
            first, stop = np.searchsorted(self.pose.frames, segment["frames"])
            ground = segment["ground"]
            if ground is not None:
                slope = np.array(ground["slope"], dtype=float)
                origin = float(ground["height_m"] - slope @ np.array(ground["middle_m"], dtype=float))
                ground = Ground(origin, slope, float(ground["sigma_m"]))
            segments.append(
                MotionSegment(slice(int(first), int(stop)), ground, prior_weight=segment.get("prior_weight", 1.0))
            )
        return tuple(segments) or (MotionSegment(slice(0, len(self.pose.frames)), None),)

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """(D,)"""
        return tuple(self.report["skeleton"]["state_names"])

    @property
    def angle_names(self) -> tuple[str, ...]:
        """(A,): of the root's pitch and roll, and of the joints."""
        return self.state_names[4:]

    @cached_property
    def angles_rad(self) -> Array:
        """(T, A)"""
        return self.states[:, 4:]

    @cached_property
    def data_shares(self) -> dict[str, float]:
        """Of every angle the part of its precision that comes from the pixels, the median over the frames; NaN where it
        is not known."""
        return dict(zip(self.angle_names, map(median, self.angle_data_share.T), strict=True))

    @cached_property
    def size(self) -> float:
        """The factor on the body's lengths; of the frame method, which has one for each frame, their median."""
        return float(self.report["size"]["factor"])

    @cached_property
    def title(self) -> str:
        return self.report["skeleton"]["title"]


def read_results(folder: str | Path) -> Results:
    """Raises InputError for a folder without a fit's results, with those of an incompatible version, or of two runs."""
    folder = Path(folder)
    manifest = _manifest(folder)
    report = _report(folder / REPORT)
    cameras = require_fields(report, folder / REPORT)
    camera = cameras[0]
    body, pose, states = all_of(
        lambda: load_skeleton(*skeleton_names(report, folder)),
        lambda: read_pose3d(folder / "pose3d.csv"),
        lambda: _states(folder / "angles.csv", report["skeleton"]["state_names"]),
    )
    if len(states) != len(pose.frames):
        found = f"{len(states)} rows, but {len(pose.frames)} in pose3d.csv"
        raise InputError(Problem(folder / "angles.csv", "rows", found, "both files of the same fit"))
    require_fitting(report, pose, folder / REPORT)
    _require_skeleton(report, body, folder / REPORT)
    T_upright_reference = np.eye(4) if _track(report, 0) is not None else world_from_reference(camera)
    sigma, relative = read_sigmas(folder, pose, T_upright_reference[:3, :3])
    angle_sigma, angle_share = _angle_sigmas(folder / ANGLE_SIGMAS, states, report["skeleton"]["state_names"])
    manifest.require_same()
    return Results(
        folder=folder,
        manifest=manifest,
        report=report,
        fps=float(report["input"]["fps"]),
        cameras=cameras,
        body=body,
        pose=replace(pose, xyz_m=moved(T_upright_reference, pose.xyz_m)),
        states=states,
        sigma_m=sigma,
        relative_sigma_m=relative,
        angle_sigma_rad=angle_sigma,
        angle_data_share=angle_share,
    )


def _manifest(folder: Path) -> Manifest:
    """Of results whose files are all there and as they were written."""
    own = "the folder of results that `recon fit` wrote"
    if not (folder / REPORT).is_file():
        found = f"no {REPORT}" if folder.is_dir() else "a file" if folder.is_file() else "no such folder"
        clips = sorted(path.parent for path in folder.glob(f"*/{REPORT}")) if folder.is_dir() else []
        expected = f"that of one clip, as in {clips[0]}" if clips else own
        raise InputError(Problem(folder, "folder", _made_by(folder) or found, expected))
    manifest = read_manifest(folder)
    if TABLES[0] not in manifest and (found := _made_by(folder)) is not None:
        raise InputError(Problem(folder, "folder", found, own))
    manifest.require(REPORT, *TABLES, SIGMAS, ANGLE_SIGMAS)
    return manifest


def _made_by(folder: Path) -> str | None:
    """Of a folder that another command wrote: which."""
    for path in sorted(folder.glob("*.json")):
        try:
            command = MADE_BY[read_json(path, "a report")["schema"]["name"]]
        except (InputError, KeyError, TypeError):
            continue
        return f"what `{command}` wrote"
    return None


def _report(path: Path) -> dict[str, Any]:
    try:
        report = read_json(path, "the report of `recon fit`")
        schema = (report["schema"]["name"], report["schema"]["version"])
    except (ValueError, KeyError, TypeError):
        raise InputError(Problem(path, "content", "something else", "the report of `recon fit`")) from None
    if schema != (SCHEMA_NAME, SCHEMA_VERSION):
        found = f"{schema[0]}, version {schema[1]}"
        raise InputError(Problem(path, "schema", found, f"{SCHEMA_NAME}, version {SCHEMA_VERSION}: fit the clip again"))
    return report


def _require_skeleton(report: dict[str, Any], body: Body, path: Path) -> None:
    """Raises InputError where the skeleton is another one than the report's, as its file may have changed since."""
    problems = [
        Problem(path, f"skeleton.{field}", "other ones", f"those of {body.name}, as for the fit")
        for field, wanted in (("joints", body.markers), ("state_names", body.state_names))
        if tuple(report["skeleton"][field]) != wanted
    ]
    if problems:
        raise InputError(problems)


def skeleton_names(report: Mapping[str, Any], folder: Path) -> tuple[str, str | None]:
    """Of a report in a folder: its skeleton and its measured animal, each the name or the file that was given."""

    def found(name: str) -> str:
        return str(folder / name) if name.endswith(".toml") else name

    skeleton, subject = report["settings"].get("skeleton"), report["settings"].get("subject")
    return found(skeleton or report["skeleton"]["name"]), None if subject is None else found(subject)


def _states(path: Path, names: list[str]) -> Array:
    """(T, D)"""
    expected = [name if name.endswith("_m") else f"{name}_rad" for name in names]
    return _table(path, 1, expected)


def read_sigmas(folder: Path, pose: Pose3D, R: Array) -> tuple[Array, Array]:
    """Standard deviations (T, J, 3) of a result's positions and of the relative ones, along axes that R (3, 3) turns
    the file's to. Off the axes, a correlation of two coordinates is not in the file, and not taken into account."""
    path = folder / SIGMAS
    coords = ("x_sigma", "y_sigma", "z_sigma", "x_rel", "y_rel", "z_rel")
    values = _table(path, 2, [(name, coord) for name in pose.names for coord in coords])
    if len(values) != len(pose.frames):
        raise InputError(Problem(path, "rows", str(len(values)), f"{len(pose.frames)}, as in pose3d.csv"))
    turned = np.sqrt(values.reshape(*pose.xyz_m.shape[:2], 2, 3) ** 2 @ (R**2).T)
    return turned[:, :, 0], turned[:, :, 1]


def _angle_sigmas(path: Path, states: Array, state_names: list[str]) -> tuple[Array, Array]:
    """Standard deviations and shares (T, A) of the angles without the root's yaw, for states (T, D)."""
    names = state_names[3:]
    values = _table(path, 1, [f"{name}_{what}" for what in ("sigma_rad", "data_share") for name in names])
    if len(values) != len(states):
        raise InputError(Problem(path, "rows", str(len(values)), f"{len(states)}, as in angles.csv"))
    return values[:, 1 : len(names)], values[:, len(names) + 1 :]


def _table(path: Path, header_rows: int, columns: list[Any]) -> Array:
    """The numbers of a table of `recon fit` with these columns after the frame's."""
    expected = f"the {path.name} that `recon fit` wrote beside report.json"
    try:
        with path.open(encoding="utf-8", newline="") as file:
            header = [row for _, row in zip(range(header_rows), csv.reader(file), strict=False)]
        # Not with the header: pandas takes a first frame without a pose for a part of it.
        values = pd.read_csv(path, header=None, skiprows=header_rows, dtype=float, skip_blank_lines=False).to_numpy()
    except (OSError, ValueError):
        raise InputError(Problem(path, "content", "no such table" if path.exists() else "no file", expected)) from None
    found = [names[0] if header_rows == 1 else names for names in zip(*header, strict=False)][1:]
    if found != columns or values.shape[1:] != (len(columns) + 1,):
        raise InputError(Problem(path, "columns", ", ".join(map(str, found))[:80], expected))
    if (np.abs(values) > LARGEST).any():
        raise InputError(Problem(path, "numbers", f"{np.nanmax(np.abs(values)):g}", expected))
    return values[:, 1:]


def _track(report: dict[str, Any], number: int) -> dict[str, Any] | None:
    written = report.get("cameras")
    return written[number].get("track") if written else None
