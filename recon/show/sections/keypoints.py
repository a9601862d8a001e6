"""Report which keypoints were used, and how far they are from the pose."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from recon.animal.naming import suggestions
from recon.base.arrays import Array, finite, mean, median
from recon.base.numbers import percent, quantity
from recon.check.codes import names_text
from recon.clip import COUNTS
from recon.fit.motion import Motion, Picture
from recon.show.plain import by_name
from recon.show.sections.section import Line

BEST_FRACTION = 0.9
"""Fraction of the detections that `mean_best_90_percent` averages, beginning with the smallest error."""
OF_JOINT = ("outliers", "mean_error_px", "noise_px", "mean_weight")
"""Fields of a keypoint's entry in report.json that are null unless the keypoint was fitted."""


def counts(motion: Motion) -> dict[str, Any]:
    """Return a motion's numbers of keypoints and detections, and its reprojection errors."""
    distance_px, present = (_stacked(motion, field) for field in ("distance_px", "present"))
    errors = finite(distance_px)
    best = np.sort(errors)[: math.ceil(BEST_FRACTION * len(errors))]
    by_joint = np.array([mean(errors_of_joint) for errors_of_joint in np.moveaxis(distance_px, -1, 0)])
    worst = int(np.nanargmax(by_joint)) if len(errors) else None
    used = int(present.any(axis=(0, 1)).sum())
    return {
        "keypoints": {"used": used, "missing": len(motion.names) - used, "unused": len(motion.unused_keypoints)},
        "detections": int(present.sum()),
        "corrected": sum(source.keypoints.corrected for source in motion.sources),
        "outliers": sum(int(picture.outliers.sum()) for picture in motion.pictures),
        "reprojection_px": {
            "mean": mean(errors),
            "median": median(errors),
            "mad": median(np.abs(errors - median(errors))),
            "mean_best_90_percent": mean(best),
            "worst_joint": None if worst is None else motion.names[worst],
            "worst_joint_mean": np.nan if worst is None else by_joint[worst],
        },
    }


def _stacked(motion: Motion, field: str) -> Array:
    """Return one attribute of all cameras' pictures as an array (V, T, J)."""
    return np.stack([getattr(picture, field) for picture in motion.pictures])


def keypoints_data(motion: Motion) -> list[dict[str, Any]]:
    """Return the fitted keypoints in the order of the joints, then the unused keypoints of the file."""
    cleaned = [source.cleaning.keypoints for source in motion.sources]
    outliers, distance_px = (_stacked(motion, field) for field in ("outliers", "distance_px"))
    rows = []
    for name in (*motion.names, *motion.unused_keypoints):
        columns = [keypoints[name] for keypoints in cleaned if name in keypoints]
        numbers = {count: sum(keypoint[count] for keypoint in columns) if columns else None for count in COUNTS}
        rows.append({"name": name, "joint": None, "in_file": bool(columns), **numbers} | dict.fromkeys(OF_JOINT))
    for j, row in enumerate(rows[: len(motion.names)]):
        means = (mean(values[..., j]) for values in (distance_px, motion.solution.noise_px, motion.solution.weight))
        row |= {"joint": motion.joints[j]} | by_name(OF_JOINT, (int(outliers[..., j].sum()), *means))
    return rows


def keypoint_lines(motion: Motion, data: list[dict[str, Any]]) -> Iterator[Line]:
    """Yield lines with the keypoints used, the detections, the reprojection error and the outliers."""
    fitted, totals = [row for row in data if row["joint"] is not None], counts(motion)
    missing_names = [row["name"] for row in fitted if not row["used"]]
    similar = suggestions(motion.unused_keypoints, motion.missing_keypoints)
    parts = {
        "missing": missing_names,
        "not used": motion.unused_keypoints,
    }
    listed = "".join(f"; {part}: {names_text(names)}" for part, names in parts.items() if names)
    if similar:
        rows = " ".join(f'"{name},{marker}"' for name, marker in similar.items())
        listed += f"; perhaps only named differently: fit again with --rename and a file of these lines: {rows}"
    used_count = f"{totals['keypoints']['used']}" if missing_names else "all"
    is_assumed = missing_names and motion.settings and motion.settings.get("skeleton") is None
    assumed = f"; the skeleton {motion.body.name} is assumed (--skeleton)" if is_assumed else ""
    yield "keypoints", f"{used_count} of the skeleton's {len(fitted)} used{listed}{assumed}"

    points = [point_counts(picture) for picture in motion.pictures]
    used, missing, rejected = (sum(numbers[count] for numbers in points) for count in ("used", "missing", "rejected"))
    yield "detections", _detections_text(motion, fitted, used, missing, rejected)
    errors = totals["reprojection_px"]
    yield "reprojection", "none: no pose" if errors["worst_joint"] is None else _errors_text(motion, errors)
    with_outliers = sorted(((row["outliers"], row["name"]) for row in fitted if row["outliers"]), reverse=True)
    names = ", ".join(f"{name} {count}" for count, name in with_outliers[:3])
    listed_names = names + (", ..." if len(with_outliers) > 3 else "")
    joints = f": {listed_names}" if with_outliers else ""
    yield "outliers", f"{totals['outliers']} of the {used} used detections disagree with the pose{joints}"


def medians_px(motion: Motion) -> Array:
    """Return the median distance between detections and pose for V cameras and J keypoints, px, shape (V, J)."""
    distance_px = _stacked(motion, "distance_px")
    return np.array([[median(of_keypoint) for of_keypoint in of_camera.T] for of_camera in distance_px])


def _errors_text(motion: Motion, errors: Mapping[str, Any]) -> str:
    average, middle = (quantity(errors[name], 1, "px") for name in ("mean", "median"))
    of_keypoints = medians_px(motion)
    v, j = np.unravel_index(np.nanargmax(of_keypoints), of_keypoints.shape)
    camera = f" in {motion.pictures[v].name}" if len(motion.pictures) > 1 else ""
    worst = f"{motion.names[j]}{camera}, {quantity(of_keypoints[v, j], 1, 'px')} median"
    return f"{average} mean, {middle} median; worst keypoint {worst}"


def _detections_text(motion: Motion, fitted: list[dict[str, Any]], used: int, missing: int, rejected: int) -> str:
    """Return a sentence on how many detections were used, are missing, have no likelihood, or were left out."""
    texts = [f"{used} used", *([f"{missing} missing"] if missing else [])]
    unknown = sum(row["likelihood_unknown"] for row in fitted if row["in_file"])
    texts += [f"{unknown} without a likelihood (never left out as unlikely)"] if unknown else []
    if rejected:
        fraction = f"{percent(rejected / (used + rejected))} of all detections"
        is_low = any(finding.code == "likelihoods_low" for finding in motion.findings)
        advice = "; if they are good, lower --set likelihood-min" if is_low else ""
        texts.append(f"{rejected} ({fraction}) left out before the fit, as unlikely or far outside{advice}")
    return ", ".join(texts)


def point_counts(picture: Picture) -> dict[str, int]:
    """Return the numbers of a camera's points that were used, are missing, or were rejected."""
    source, used = picture.source, int(picture.present.sum())
    names = set(source.keypoints.names)
    rejected = sum(row["rejected"] for name, row in source.cleaning.keypoints.items() if name in names)
    return {"used": used, "missing": max(picture.present.size - used - rejected, 0), "rejected": rejected}
