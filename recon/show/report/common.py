"""The parts of a report that all methods have."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import fields
from typing import Any, TypeVar, cast

import numpy as np

from recon.animal.naming import suggestions
from recon.base.arrays import Array, finite, mean, median
from recon.check import names_text
from recon.clip.keypoints import KeypointCounts
from recon.fit.motion import Motion
from recon.fit.result import OUTLIER_SIGMAS
from recon.gait.kinematics import jitter_errors, point_kinematics
from recon.gait.path import frame_jitter_m
from recon.show.report import cameras
from recon.show.report.plain import by_name, file_name

BEST_SHARE = 0.9

Options = TypeVar("Options")
Lines = list[tuple[str, str]]
"""(label, value)."""


# -- sections -----------------------------------------------------------------------------------------------------


def head(motion: Motion) -> dict[str, Any]:
    """What was fitted."""
    keypoints = motion.keypoints
    return {
        "input": {
            "keypoints": file_name(keypoints.source),
            "individual": keypoints.individual,
            "fps": motion.fps,
            "frames": (motion.frames[0], motion.frames[-1] + 1),
            "camera": motion.camera.to_dict(),
        },
        "cameras": cameras.section(motion),
        "side": {"fitted": motion.side, "reason": motion.side_reason},
        "frame_of_reference": motion.frame_of_reference,
    }


def tail(motion: Motion) -> dict[str, Any]:
    """The keypoints, and arrays over all frames."""
    first_px, *others_px = (picture.image_error_px.transpose(1, 2, 0) for picture in motion.pictures)
    return {
        "cleaning": {k: v for k, v in motion.cleaning.to_dict().items() if k != "keypoints"},
        "keypoints": _keypoints(motion),
        "unused_keypoints": motion.unused_keypoints,
        "missing_keypoints": motion.missing_keypoints,
        "outliers": [
            {
                "frame": motion.frames[t],
                "keypoint": motion.names[j],
                "error_px": picture.distance_px[t, j],
                "camera": picture.name,
            }
            for picture in motion.pictures
            for t, j in np.argwhere(picture.outliers)
        ],
        "root_path": _root_path(motion),
        "image_error_px": {"joints": motion.names, "values": first_px, "others": others_px},
    }


def solver(options: Any, **of_the_skeleton: Any) -> dict[str, Any]:
    """Every value that the solver ran with, those that are no settings included. of_the_skeleton: in place of None."""
    values = {field.name: getattr(options, field.name) for field in fields(options)}
    return {name: of_the_skeleton.get(name) if value is None else value for name, value in values.items()}


def given_options(kind: type[Options], settings: Mapping[str, Any]) -> Options:
    """What is not among the settings has its default."""
    names = [field.name for field in fields(cast(Any, kind)) if settings.get(field.name) is not None]
    return kind(**{name: settings[name] for name in names})


def skeleton(motion: Motion) -> dict[str, Any]:
    return {
        "name": motion.body.name,
        "title": motion.title,
        "joints": motion.joints,
        "keypoints": motion.names,
        "feet": {label: motion.names[foot] for label, foot in zip(motion.foot_labels, motion.feet, strict=True)},
        "state_names": motion.state_names,
        "states_frame": motion.states_frame,
    }


def angles(motion: Motion) -> dict[str, Any]:
    """How much the pixels say of every angle, and how well it is known: medians over the frames."""
    solution = motion.solution
    known = zip(solution.angle_data_share.T, solution.angle_sigma_rad.T, strict=True)
    rows = [{"data_share": median(share), "sigma_rad": median(sigma)} for share, sigma in known]
    return by_name(motion.angle_names, rows)


def counts(motion: Motion) -> dict[str, Any]:
    """For the summary."""
    distance_px, present = (cameras.stacked(motion, field) for field in ("distance_px", "present"))
    errors = finite(distance_px)
    best = np.sort(errors)[: math.ceil(BEST_SHARE * len(errors))]
    by_joint = np.array([mean(of_joint) for of_joint in np.moveaxis(distance_px, -1, 0)])
    worst = int(np.nanargmax(by_joint)) if len(errors) else None
    used = int(present.any(axis=(0, 1)).sum())
    return {
        "keypoints": {"used": used, "missing": len(motion.names) - used, "unused": len(motion.unused_keypoints)},
        "detections": int(present.sum()),
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


def upright(motion: Motion) -> dict[str, Any]:
    """Which way is up, and how that is known; for the assumptions."""
    camera = motion.camera
    return {
        "camera_level": not motion.knows_up and camera.tilt_rad == 0,
        "camera_tilt_rad": None if motion.knows_up else camera.tilt_rad,
        "camera_up": None if motion.camera_moves else camera.up,
        "camera_moves": motion.camera_moves,
    }


def sentences(motion: Motion, settings: Mapping[str, Any]) -> Iterator[str]:
    """Assumptions in words."""
    camera = motion.camera
    still = "The camera stands still" if len(motion.pictures) == 1 else "The cameras stand still"
    if all(picture.T_reference_camera.ndim == 2 for picture in motion.pictures):
        yield f"{still}: where it pans or moves, its movement is part of the path."
    if tracked := [picture.name for picture in motion.pictures if picture.source.moves]:
        yield (
            f"Camera {' and '.join(tracked)}: moves as its track says, whose world is taken to be in metres with z up; "
            "where the ground lies in it is not taken for known."
        )
    if motion.side is not None:
        yield f"Only the limbs of the animal's {motion.side} side are fitted."
    if not motion.knows_up and camera.tilt_rad == 0:
        yield "The camera is taken to be level, because its file does not say which way is up."
    elif not motion.knows_up:
        degrees = math.degrees(camera.tilt_rad)
        yield f"The camera is taken to look down by {degrees:.3g} degrees, as given, and not to be rolled."
    if settings.get("hfov_deg") is not None:
        yield (
            f"The camera has no calibration: its focal length follows from a horizontal field of view of "
            f"{settings['hfov_deg']:g} degrees, and its lens is taken to be free of distortion."
        )


def _keypoints(motion: Motion) -> list[dict[str, Any]]:
    """The fitted keypoints in the order of the joints, then those of the file that are not used."""
    counted = [{k.name: k for k in source.cleaning.keypoints} for source in motion.sources]
    outliers, distance_px = (cameras.stacked(motion, field) for field in ("outliers", "distance_px"))
    counts = [f.name for f in fields(KeypointCounts) if f.name != "name"]
    rows = []
    for name in (*motion.names, *motion.unused_keypoints):
        fitted, known = name in motion.names, [of_file[name] for of_file in counted if name in of_file]
        column = motion.names.index(name) if fitted else None
        rows.append(
            {
                "name": name,
                "joint": None if column is None else motion.joints[column],
                "in_file": bool(known),
                **{count: sum(getattr(of_one, count) for of_one in known) if known else None for count in counts},
                "outliers": None if column is None else int(outliers[..., column].sum()),
                "mean_error_px": None if column is None else mean(distance_px[..., column]),
            }
        )
    return rows


def _root_path(motion: Motion) -> dict[str, Any]:
    """Exactly as reconstructed, and without the jitter from frame to frame, if that can be told."""
    jitter = frame_jitter_m(motion.root_m)
    smooth = motion.solution.jitters and np.isfinite(jitter).all()
    root = motion.root_name
    return {
        "joint": root,
        "keypoint": motion.names[motion.joints.index(root)] if root in motion.joints else None,
        "time_s": motion.time_s,
        "position_m": motion.root_m,
        "jitter_m": jitter,
        "exact": _kinematics(motion, None),
        "smoothed": _kinematics(motion, jitter) if smooth else None,
    }


def _kinematics(motion: Motion, smoothing_m: Array | None) -> dict[str, Any]:
    smooth = smoothing_m is not None
    errors = jitter_errors(motion.root_m) if smooth else ()
    path = point_kinematics(motion.time_s, motion.root_m, errors, smooth=smooth, propagate=False)
    at_frames = slice(None, None, path.series.oversampling)
    return {
        "smoothing_m": smoothing_m,
        "oversampling": path.series.oversampling,
        "distance_m": path.distance_m,
        "peak_speed_m_s": path.peak_speed_m_s,
        "mean_speed_m_s": path.mean_speed_m_s,
        "peak_acceleration_m_s2": path.peak_acceleration_m_s2,
        "speed_m_s": path.speed_m_s[at_frames],
        "acceleration_m_s2": path.acceleration_m_s2[at_frames],
    }


# -- summing up ---------------------------------------------------------------------------------------------------


def clip_line(report: Mapping[str, Any]) -> tuple[str, str]:
    given = report["input"]
    first, stop = given["frames"]
    return "clip", f"{cameras.files(report)}, frames {first} to {stop - 1} at {given['fps']:g} fps"


def point_lines(report: Mapping[str, Any]) -> Lines:
    summary = report["summary"]
    fitted = [row for row in report["keypoints"] if row["joint"] is not None]
    points = cameras.points(report)
    off = sorted(((row["outliers"], row["name"]) for row in fitted if row["outliers"]), reverse=True)
    most = ", ".join(f"{name} {count}" for count, name in off[:3]) + (", ..." if len(off) > 3 else "")
    return [
        ("keypoints", _keypoints_text(report)),
        (
            "points",
            f"{points['used']} used, {points['missing']} missing, {points['rejected']} rejected as unlikely or far "
            "outside",
        ),
        ("reprojection", _reprojection(summary["reprojection_px"])),
        (
            "outliers",
            f"{summary['outliers']} points further off than {OUTLIER_SIGMAS:g} sigma of the detector"
            + (f": {most}" if off else ""),
        ),
        *cameras.lines(report),
        *(("note", note) for note in cameras.notes(report)),
    ]


def _keypoints_text(report: Mapping[str, Any]) -> str:
    """Of the skeleton's, and of the file's."""
    counts = report["summary"]["keypoints"]
    lacking = [row["name"] for row in report["keypoints"] if row["joint"] is not None and not row["used"]]
    total = counts["used"] + counts["missing"]
    share = f"{counts['used']}" if lacking else "all"
    missing = f"; missing: {names_text(lacking)}" if lacking else ""
    unused = f"; not used: {names_text(report['unused_keypoints'])}" if report["unused_keypoints"] else ""
    near = suggestions(report["unused_keypoints"], report["missing_keypoints"])
    perhaps = f"; perhaps the same (--rename): {names_text([f'{a} for {b}' for a, b in near.items()])}" if near else ""
    return f"{share} of the skeleton's {total} used{missing}{unused}{perhaps}"


def _reprojection(errors: Mapping[str, Any]) -> str:
    if errors["worst_joint"] is None:
        return "none: no pose"
    return (
        f"{errors['mean']:.1f} px mean, {errors['median']:.1f} px median; "
        f"worst joint {errors['worst_joint']}, {errors['worst_joint_mean']:.1f} px (outliers included)"
    )


def heading_text(angle_rad: float | None) -> str:
    if angle_rad is None:
        return "unknown"
    degrees = round(math.degrees(angle_rad))
    if degrees == 0:
        return "in the picture's plane"
    return f"{abs(degrees)}° out of the picture's plane, {'away from' if degrees > 0 else 'towards'} the camera"
