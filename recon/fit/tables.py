"""A motion for other packages and notebooks: joints with their standard deviations as tables, poses as a picture."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.base.arrays import Array
from recon.io.pose import Pose3D

if TYPE_CHECKING:
    import pandas as pd
from collections.abc import Mapping
from html import escape


def dataframe(pose: Pose3D, sigma_m: Array, time_s: Array, flags: Sequence[Sequence[str]], wide: bool) -> pd.DataFrame:
    """See `recon.Motion.to_dataframe`; sigma_m (T, J, 3)."""
    import pandas as pd

    names, (T, J, _) = pose.names, pose.xyz_m.shape
    values = np.concatenate([pose.xyz_m, sigma_m], axis=2)
    columns = [f"{axis}{of}_m" for of in ("", "_sigma") for axis in "xyz"]
    if wide:
        index = pd.MultiIndex.from_product([names, columns], names=["joint", "value"])
        return pd.DataFrame(values.reshape(T, -1), index=pd.Index(pose.frames, name="frame"), columns=index)
    head = {"frame": np.repeat(pose.frames, J), "time_s": np.repeat(time_s, J), "joint": [*names] * T}
    table = pd.DataFrame(head | dict(zip(columns, values.reshape(-1, 6).T, strict=True)))
    return table.assign(flags=np.repeat([", ".join(some) for some in flags], J))


def dataset(pose: Pose3D, sigma_m: Array, attributes: dict[str, str]) -> Any:
    """See `recon.Motion.to_xarray`; sigma_m (T, J, 3)."""
    from recon.io.movement import dataset_of

    made = dataset_of(pose)
    made["position_sigma"] = (made["position"].dims, sigma_m.transpose(0, 2, 1)[..., None])
    return made.assign_attrs(attributes)


POSES, WIDTH_PX, HIGHEST_PX = 8, 640, 240
COLOUR = "#0072b2"


def table(rows: Mapping[str, str]) -> str:
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(name)}</th><td style='text-align:left'>{escape(text)}</td></tr>"
        for name, text in rows.items()
    )
    return f"<table>{cells}</table>"


def from_the_side(joints_m: Array, limbs: Sequence[Sequence[int]]) -> str:
    """Some of the poses (T, J, 3), z up, evenly spaced in time, the animal running to the right; none without two."""
    posed = joints_m[np.isfinite(joints_m).all(axis=(1, 2))]
    if len(posed) < 2:
        return ""
    middle = posed.mean(axis=1)
    way = middle[-1, :2] - middle[0, :2]
    length = np.linalg.norm(way)
    along = way / length if length > 0 else np.array([1.0, 0.0])
    shown = posed[np.linspace(0, len(posed) - 1, min(POSES, len(posed)), dtype=int)]
    points = np.stack([shown[..., :2] @ along, -shown[..., 2]], axis=-1)
    low, high = points.min(axis=(0, 1)), points.max(axis=(0, 1))
    scale = min(WIDTH_PX / max(high[0] - low[0], 1e-9), HIGHEST_PX / max(high[1] - low[1], 1e-9))
    points, (width, height) = scale * (points - low), scale * (high - low)
    lines = "".join(
        f"<polyline points='{' '.join(f'{x:.1f},{y:.1f}' for x, y in pose[[*limb]])}' "
        f"opacity='{0.35 + 0.65 * n / len(points):.2f}'/>"
        for n, pose in enumerate(points, 1)
        for limb in limbs
    )
    box = f"-3 -3 {width + 6:.0f} {height + 6:.0f}"
    style = f"fill='none' stroke='{COLOUR}' stroke-width='1.6'"
    return f"<svg viewBox='{box}' width='{width + 6:.0f}' role='img' {style}>{lines}</svg>"
