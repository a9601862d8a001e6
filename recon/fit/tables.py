"""Joints with their standard deviations as tables of other packages."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.base.arrays import Array
from recon.io.movement import dataset_of
from recon.io.pose import Pose3D

if TYPE_CHECKING:
    import pandas as pd


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
    made = dataset_of(pose)
    made["position_sigma"] = (made["position"].dims, sigma_m.transpose(0, 2, 1)[..., None])
    return made.assign_attrs(attributes)
