"""Make keypoint networks that train quickly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

EVALUATIONS = 3


def narrow_networks(patch: pytest.MonkeyPatch) -> None:
    """Make new networks narrow, but as deep as usual, evaluated three times per run, and repeatable.

    The points of such networks are noise, so the check for a video of another size, or a mirrored one, is switched off.
    """
    from recon.keypoint_net import network, train

    for name, value in (("WIDTHS", (4, 8, 12, 16, 16)), ("SECOND_WIDTHS", (4, 8, 12, 16)), ("HEAD", 8)):
        patch.setattr(network, name, value)
    patch.setattr(train, "EVALUATIONS", EVALUATIONS)
    patch.setattr(network, "fast_half", lambda device: None)
    patch.setattr("recon.check.inputs._other_pictures", lambda motion, clip, named: {})


NAMES = ("nose", "left_paw", "right_paw")


def write_labels(path: Path, images: list[str], xy: np.ndarray, names: tuple[str, ...] = NAMES) -> Path:
    """Write labels as DeepLabCut's label file, with one index column and empty cells for NaN."""
    lines = [
        "scorer," + ",".join(["me"] * 2 * len(names)),
        "bodyparts," + ",".join(n for n in names for _ in range(2)),
        "coords," + ",".join(["x", "y"] * len(names)),
    ]
    for image, points in zip(images, xy.reshape(len(images), -1), strict=True):
        lines.append(",".join([image, *("" if np.isnan(v) else f"{v:g}" for v in points)]))
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def grey(level: int, size: tuple[int, int] = (64, 48)) -> np.ndarray:
    return np.full((size[1], size[0], 3), level, np.uint8)
