"""Write keypoint, label, truth and camera files of simulated clips in the formats of other programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Bools, Integers
from recon.clip import Keypoints
from recon.geometry.camera import Camera
from recon.testing.gallop import SyntheticClip

SCORER = "recon_synthetic"


def write_keypoints(keypoints: Keypoints, path: Path, decimals: int, scorer: str = SCORER) -> None:
    """Write keypoints in DeepLabCut's CSV layout, with empty coordinates and likelihood 0 for missing points."""
    rows = [
        ["scorer"] + [scorer] * 3 * len(keypoints.names),
        ["bodyparts"] + [name for name in keypoints.names for _ in range(3)],
        ["coords"] + ["x", "y", "likelihood"] * len(keypoints.names),
    ]
    for frame, points, likelihoods in zip(keypoints.frames, keypoints.xy_px, keypoints.confidence, strict=True):
        row = [str(frame)]
        for point, likelihood in zip(points, likelihoods, strict=True):
            row += ["" if np.isnan(v) else f"{v:.{decimals}f}" for v in point] + [f"{likelihood:.{decimals}f}"]
        rows.append(row)
    _write(path, rows)


def write_labels(keypoints: Keypoints, frames: Integers, path: Path, scorer: str = SCORER) -> None:
    """Write a DeepLabCut label file of some frames, in which missing points are empty cells."""
    rows = [
        ["scorer"] + [scorer] * 2 * len(keypoints.names),
        ["bodyparts"] + [name for name in keypoints.names for _ in range(2)],
        ["coords"] + ["x", "y"] * len(keypoints.names),
    ]
    for frame in frames:
        cells = ["" if np.isnan(v) else f"{v:.2f}" for v in keypoints.xy_px[frame].ravel()]
        rows.append([f"labeled-data/rendered/img{frame:03d}.png", *cells])
    _write(path, rows)


def write_truth(clip: SyntheticClip, path: Path, decimals: int = 6) -> None:
    """Write the true joint positions of a clip to a CSV file, in world coordinates, m."""
    rows = [
        ["bodyparts"] + [name for name in clip.names for _ in range(3)],
        ["coords"] + ["x", "y", "z"] * len(clip.names),
    ]
    for frame, joints in zip(clip.keypoints.frames, clip.truth_m, strict=True):
        rows.append([str(frame)] + [f"{v:.{decimals}f}" for v in joints.ravel()])
    _write(path, rows)


def write_outliers(keypoints: Keypoints, outliers: Bools, path: Path) -> None:
    """Write the frame and the keypoint of each gross outlier in a mask (T, K)."""
    rows = [[str(keypoints.frames[t]), keypoints.names[k]] for t, k in np.argwhere(outliers)]
    _write(path, [["frame", "keypoint"], *rows])


def write_scene(cameras: Sequence[Camera], path: Path) -> None:
    """Write cameras in AcinoSet's layout."""
    entries = [
        {
            "name": camera.name,
            "k": camera.matrix.tolist(),
            "d": camera.distortion[:, None].tolist(),
            "r": np.array(camera.rotation).tolist(),
            "t": np.array(camera.translation_m)[:, None].tolist(),
        }
        for camera in cameras
    ]
    document = {"camera_resolution": [*cameras[0].image_size_px], "cameras": entries}
    path.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8", newline="\n")


def _write(path: Path, rows: list[list[str]]) -> None:
    path.write_text("".join(",".join(row) + "\n" for row in rows), encoding="utf-8", newline="\n")


TRACK_HEADER = "frame,qw,qx,qy,qz,tx,ty,tz"


def track_rows(frames: Integers, poses: Array) -> list[list[float]]:
    """Return rows (N, 8) of a camera track with frame, quaternion and translation of each pose (N, 4, 4)."""
    q = Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    return np.column_stack([frames, q, poses[:, :3, 3]]).tolist()


def write_track(path: Path, frames: Integers, poses: Array, intrinsics_px: Array | None = None) -> Path:
    """Write a camera track as CSV with poses T_camera_world (N, 4, 4) and, if given, fx, fy, cx, cy (N, 4)."""
    rows, header = track_rows(frames, poses), TRACK_HEADER
    if intrinsics_px is not None:
        header = f"{header},fx,fy,cx,cy"
        rows = [[*row, *intrinsics] for row, intrinsics in zip(rows, intrinsics_px.tolist(), strict=True)]
    lines = [header, *(",".join(map(repr, [int(row[0]), *row[1:]])) for row in rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_damaged_video(path: Path) -> Path:
    """Write a video of 40 frames in which a tenth of the bytes are 0."""
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
    noise = np.random.default_rng(0)
    for _ in range(40):
        writer.write(noise.integers(0, 255, (48, 64, 3), np.uint8))
    writer.release()
    content = bytearray(path.read_bytes())
    first, stop = (len(content) * fraction // 10 for fraction in (3, 4))
    content[first:stop] = bytes(stop - first)
    path.write_bytes(content)
    return path
