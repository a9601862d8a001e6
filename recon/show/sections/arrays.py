"""Sections of arrays over all frames, for those who read them from report.json; `motion.npz` has them all."""

from __future__ import annotations

from typing import Any

import numpy as np

from recon.base.arrays import mean
from recon.fit.motion import Motion
from recon.show.sections.given import stacked
from recon.show.sections.section import Section


def frames(motion: Motion) -> list[dict[str, Any]]:
    distance_px = stacked(motion, "distance_px")
    return [
        {
            "frame": motion.frames[t],
            "flags": flags,
            "detections": motion.detections[t],
            "mean_reprojection_px": mean(distance_px[:, t]),
            "mean_weight": motion.mean_weight[t],
            "alternative_m": motion.alternative_m[t],
            "place_sigma_m": motion.place_sigma_m[t],
            "relative_rms_m": motion.relative_rms_m[t],
            "contact": motion.solution.contact[t],
        }
        for t, flags in enumerate(motion.flags)
    ]


def outliers(motion: Motion) -> list[dict[str, Any]]:
    return [
        {
            "frame": motion.frames[t],
            "keypoint": motion.names[j],
            "error_px": picture.distance_px[t, j],
            "camera": picture.name,
        }
        for picture in motion.pictures
        for t, j in np.argwhere(picture.outliers)
    ]


def image_errors(motion: Motion) -> dict[str, Any]:
    first_px, *others_px = (picture.image_error_px.transpose(1, 2, 0) for picture in motion.pictures)
    return {"joints": motion.names, "values": first_px, "others": others_px}


ARRAYS = (
    Section("frames", frames),
    Section("outliers", outliers),
    Section("image_error_px", image_errors),
)
