"""Points as a file has them, and 3D positions as the rest of the package takes them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from recon.clip.keypoints import Keypoints

PER_METRE = {"m": 1.0, "cm": 100.0, "mm": 1000.0}
UNIT_NAMES = {
    **dict.fromkeys(("m", "metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("cm", "centimetre", "centimetres", "centimeter", "centimeters"), "cm"),
    **dict.fromkeys(("mm", "millimetre", "millimetres", "millimeter", "millimeters"), "mm"),
}


@dataclass(frozen=True, eq=False)
class Pose3D:
    """3D positions of J joints in T frames. Raises ValueError where its parts do not fit together."""

    names: tuple[str, ...]
    """The names of the J joints."""
    xyz_m: np.ndarray
    """(T, J, 3) float, metres, NaN = missing."""
    frames: np.ndarray
    """The numbers of the T frames, whole and strictly increasing."""
    source: str | None = None
    fps: float | None = None
    """Frames per second, where they are known."""
    edges: tuple[tuple[str, str], ...] = ()
    """Pairs of joints that are linked, where they are known."""
    notes: tuple[str, ...] = ()
    """What a reader had to decide, or the verdict on a fit, in plain sentences."""
    sigma_m: np.ndarray | None = None
    """(T, J, 3): standard deviations of a fit."""
    flags: tuple[str, ...] | None = None
    """(T,): what is doubtful about a fit's frames."""

    def __post_init__(self) -> None:
        if self.xyz_m.shape != (len(self.frames), len(self.names), 3):
            raise ValueError(f"{len(self.frames)} frames of {len(self.names)} joints, but positions {self.xyz_m.shape}")
        if len(set(self.names)) != len(self.names) or np.any(np.diff(self.frames) <= 0):
            raise ValueError("names must be unique and frames strictly increasing")
        if np.isinf(self.xyz_m).any():
            raise ValueError("a position is infinite")
        if self.fps is not None and not 0 < self.fps < float("inf"):
            raise ValueError(f"fps must be positive: {self.fps}")
        if not {name for edge in self.edges for name in edge} <= set(self.names):
            raise ValueError("an edge links a joint that is not there")

    def of_joints(self, names: Sequence[str]) -> np.ndarray:
        """(T, N, 3): of N joints, NaN where they are not among these."""
        xyz_m = np.full((len(self.frames), len(names), 3), np.nan)
        for j, name in enumerate(names):
            if name in self.names:
                xyz_m[:, j] = self.xyz_m[:, self.names.index(name)]
        return xyz_m


@dataclass(frozen=True, eq=False)
class StoredPoints:
    """What a file says of one animal: K points in T frames, in the picture or in space, in its own unit and axes."""

    names: tuple[str, ...]
    values: np.ndarray
    """(T, K, 2) px, or (T, K, 3), NaN = missing."""
    frames: np.ndarray
    """The numbers of the T frames, whole and strictly increasing."""
    likelihood: np.ndarray | None = None
    """(T, K), NaN = unknown; None where the file has none."""
    fps: float | None = None
    individual: str | None = None
    scorer: str | None = None
    """For points in the picture: the network or the labeller that found them, where the file names it."""
    image_size_px: tuple[int, int] | None = None
    unit: str | None = None
    """For points in space: m, cm or mm; None where the file does not say."""
    up: str | None = None
    """For points in space: the axis that points up, y or z; None where the file does not say."""
    edges: tuple[tuple[str, str], ...] = ()
    """Pairs of points that are linked, where they are known."""
    images: tuple[str, ...] = ()
    """For labels: the names of the T pictures."""
    notes: tuple[str, ...] = ()
    """What a reader had to decide, in plain sentences."""

    @property
    def in_space(self) -> bool:
        return self.values.shape[-1] == 3


UNNAMED_POINTS = "The file names no points: they are called point1, point2, ... in its order."


def numbered_names(count: int) -> tuple[str, ...]:
    """For the points of a file that has no names, which has the note `UNNAMED_POINTS`."""
    return tuple(f"point{k}" for k in range(1, count + 1))


def points_of(data: Keypoints | Pose3D) -> StoredPoints:
    """As a file is to have them: px, or metres with z up."""
    if isinstance(data, Keypoints):
        return StoredPoints(
            data.names, data.xy_px, data.frames, data.confidence, data.fps, data.individual, scorer=data.scorer
        )
    return StoredPoints(data.names, data.xyz_m, data.frames, fps=data.fps, unit="m", up="z", edges=data.edges)


def z_up_from_y_up(xyz: np.ndarray) -> np.ndarray:
    """Positions (..., 3) with x forwards, y up, z right, as ours: x forwards, y left, z up."""
    return np.stack([xyz[..., 0], -xyz[..., 2], xyz[..., 1]], axis=-1)


def y_up_from_z_up(xyz: np.ndarray) -> np.ndarray:
    """Points (..., 3) with y up from points with z up: the inverse of `z_up_from_y_up`."""
    return np.stack([xyz[..., 0], xyz[..., 2], -xyz[..., 1]], axis=-1)


def index_edges(names: Sequence[str], edges: Sequence[tuple[str, str]]) -> np.ndarray:
    """(E, 2) int: the pairs of names as indices."""
    return np.array([[names.index(a), names.index(b)] for a, b in edges], dtype=np.int64).reshape(-1, 2)
