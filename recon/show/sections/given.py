"""Sections of what a motion was fitted to, and of how it fits: the clip, its keypoints and its cameras."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from recon import check
from recon.animal.naming import suggestions
from recon.animal.skeleton_file import NONE, OWN, of_scorer
from recon.base.arrays import Array, finite, mean, median
from recon.clip.keypoints import COUNTS
from recon.fit import TrajectorySolution
from recon.fit.motion import Motion, Picture
from recon.gait.kinematics import frame_jitter_m, jitter_errors, point_kinematics
from recon.show.plain import by_name, file_name, number, picked
from recon.show.sections.section import Line

BEST_SHARE = 0.9
SCORER_SHOWN = 60
"""Characters."""

# -- the verdict ------------------------------------------------------------------------------------------------------


def verdict_lines(motion: Motion, data: Any) -> Iterator[Line]:
    yield from zip(("verdict", "expected"), check.verdict_lines(motion.verdict), strict=False)
    if len(motion.sources) == 1 and motion.verdict is not None and motion.verdict.position_m is not None:
        share = motion.settings.get("focal_sigma")
        known = f" (its focal length to {share:.0%}, as given)" if share else ""
        yield "assumed", f"The camera is as said{known}: one camera cannot tell its focal length, nor where it stands."


# -- the clip ---------------------------------------------------------------------------------------------------------


def clip(motion: Motion) -> dict[str, Any]:
    files = {"keypoints": file_name(motion.keypoints.source), "individual": motion.keypoints.individual}
    frames = motion.frames[0], motion.frames[-1] + 1
    return files | {"fps": motion.fps, "frames": frames, "camera": motion.camera.to_dict()}


def clip_lines(motion: Motion, data: Any) -> Iterator[Line]:
    sources = [source.keypoints.source for source in motion.sources]
    files = ", ".join(Path(path).name if path else "keypoints" for path in sources)
    first, stop = data["frames"]
    yield "clip", f"{files}, frames {first} to {stop - 1} at {motion.fps:g} fps"


def side(motion: Motion) -> dict[str, Any]:
    return {"fitted": motion.side, "reason": motion.side_reason}


def side_lines(motion: Motion, data: Any) -> Iterator[Line]:
    if motion.side:
        yield "side", f"{motion.side}: {motion.side_reason}"


def skeleton(motion: Motion) -> dict[str, Any]:
    feet = {label: motion.names[foot] for label, foot in zip(motion.foot_labels, motion.feet, strict=True)}
    own = picked(motion, "title", "joints", "state_names", "states_frame")
    return {"name": motion.body.name, "keypoints": motion.names, "feet": feet, **own}


def detector(motion: Motion) -> dict[str, str]:
    """Whose keypoints they were taken for, and why."""
    name, body = file_name(motion.body.detector) or NONE, motion.body
    scorers = {source.keypoints.scorer for source in motion.sources}
    named = " and ".join(sorted(repr(one[:SCORER_SHOWN]) for one in scorers if one))
    if motion.settings.get("detector") is not None:
        reason = "as given"
    elif name == OWN:
        reason = "as the subject's or the skeleton's file says"
    elif name != NONE:
        by_scorer = name in {of_scorer(one, body.name) for one in scorers}
        reason = f"by the file's scorer {named}" if by_scorer else "as the skeleton's file says"
    elif named:
        reason = f"the scorer {named} is of no detector known here"
    else:
        reason = "the keypoint file names no scorer"
    return {"name": name, "reason": reason}


def detector_lines(motion: Motion, data: Any) -> Iterator[Line]:
    if motion.body.one_sided:
        return
    offer = ""
    if "is of no detector" in data["reason"]:
        offer = "; two runs with four cameras can measure it: recon subject fit --no-lengths --offsets"
    yield "detector", f"{data['name']}: {data['reason']}{offer}"


def upright(motion: Motion) -> dict[str, Any]:
    """Which way is up, and how that is known; for the assumptions."""
    camera = motion.camera
    return {
        "camera_level": not motion.knows_up and camera.tilt_rad == 0,
        "camera_tilt_rad": None if motion.knows_up else camera.tilt_rad,
        "camera_up": None if motion.camera_moves else camera.up,
        "camera_moves": motion.camera_moves,
    }


def sentences(motion: Motion) -> Iterator[str]:
    """Assumptions of any method in words."""
    camera, hfov_deg = motion.camera, motion.settings.get("hfov_deg")
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
    if hfov_deg is not None:
        yield (
            f"The camera has no calibration: its focal length follows from a horizontal field of view of "
            f"{hfov_deg:g} degrees, and its lens is taken to be free of distortion."
        )


# -- the keypoints ----------------------------------------------------------------------------------------------------


def stacked(motion: Motion, field: str) -> Array:
    """(V, T, J): a field of all cameras' pictures."""
    return np.stack([getattr(picture, field) for picture in motion.pictures])


def counts(motion: Motion) -> dict[str, Any]:
    """For the summary: how many keypoints and detections, and how well the pose explains them."""
    distance_px, present = (stacked(motion, field) for field in ("distance_px", "present"))
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


def keypoints(motion: Motion) -> list[dict[str, Any]]:
    """The fitted keypoints in the order of the joints, then those of the file that are not used."""
    counted = [source.cleaning.keypoints for source in motion.sources]
    outliers, distance_px = (stacked(motion, field) for field in ("outliers", "distance_px"))
    rows = []
    for name in (*motion.names, *motion.unused_keypoints):
        known = [of_file[name] for of_file in counted if name in of_file]
        j = motion.names.index(name) if name in motion.names else None
        rows.append(
            {
                "name": name,
                "joint": None if j is None else motion.joints[j],
                "in_file": bool(known),
                **{count: sum(of_one[count] for of_one in known) if known else None for count in COUNTS},
                "outliers": None if j is None else int(outliers[..., j].sum()),
                "mean_error_px": None if j is None else mean(distance_px[..., j]),
                "noise_px": None if j is None else mean(motion.solution.noise_px[..., j]),
                "mean_weight": None if j is None else mean(motion.solution.weight[..., j]),
            }
        )
    return rows


def keypoint_lines(motion: Motion, data: Any) -> Iterator[Line]:
    fitted, found = [row for row in data if row["joint"] is not None], counts(motion)
    lacking = [row["name"] for row in fitted if not row["used"]]
    near = suggestions(motion.unused_keypoints, motion.missing_keypoints)
    parts = {
        "missing": lacking,
        "not used": motion.unused_keypoints,
        "perhaps the same (--rename)": [f"{a} for {b}" for a, b in near.items()],
    }
    listed = "".join(f"; {what}: {check.names_text(names)}" for what, names in parts.items() if names)
    share = f"{found['keypoints']['used']}" if lacking else "all"
    points = [_points(picture) for picture in motion.pictures]
    used, missing, rejected = (sum(one[count] for one in points) for count in ("used", "missing", "rejected"))
    yield "keypoints", f"{share} of the skeleton's {len(fitted)} used{listed}"
    share = f" ({rejected / (used + rejected):.0%} of what was found)" if rejected else ""
    low = any(one.code == "likelihoods_low" for one in motion.findings)
    more = "; if they are good, lower --set likelihood-min" if low else ""
    yield "detections", f"{used} used, {missing} missing, {rejected}{share} rejected as unlikely or far outside{more}"
    errors = found["reprojection_px"]
    yield (
        "reprojection",
        "none: no pose"
        if errors["worst_joint"] is None
        else f"{errors['mean']:.1f} px mean, {errors['median']:.1f} px median; worst joint {errors['worst_joint']}, "
        f"{errors['worst_joint_mean']:.1f} px",
    )
    off = sorted(((row["outliers"], row["name"]) for row in fitted if row["outliers"]), reverse=True)
    most = ", ".join(f"{name} {count}" for count, name in off[:3]) + (", ..." if len(off) > 3 else "")
    where = f": {most}" if off else ""
    yield "outliers", f"{found['outliers']} of {used} detections disagree with the pose{where}"


def cleaning(motion: Motion) -> dict[str, Any]:
    return {name: value for name, value in motion.cleaning.to_dict().items() if name != "keypoints"}


def note_lines(motion: Motion, data: Any) -> Iterator[Line]:
    """What had to be decided about the files when they were read; of several cameras, what is alike is said once."""
    for note in dict.fromkeys(note for source in motion.sources for note in source.cleaning.notes):
        yield "note", note


# -- the cameras ------------------------------------------------------------------------------------------------------


def cameras(motion: Motion) -> list[dict[str, Any]]:
    """An entry a camera, in the order of the keypoint files: what each has to do with the result."""
    return [_camera(motion, number) for number in range(len(motion.pictures))]


def _camera(motion: Motion, number: int) -> dict[str, Any]:
    picture, solution, found = motion.pictures[number], motion.solution, {"time_offset_sigma_frames": 0.0}
    source, errors, poses = picture.source, finite(picture.distance_px), picture.source.poses
    found |= {"extrinsic_correction": None, "focal": None}
    if isinstance(solution, TrajectorySolution):
        by, sigma = solution.extrinsic_correction[number], solution.extrinsic_correction_sigma[number]
        focal = solution.focal_sigma[number]
        correction = {"turn_rad": by[:3], "turn_sigma_rad": sigma[:3], "shift_m": by[3:], "shift_sigma_m": sigma[3:]}
        found = {
            "time_offset_sigma_frames": solution.time_offset_sigma_frames[number],
            "extrinsic_correction": correction if sigma.any() else None,
            "focal": {"factor": math.exp(solution.focal[number]), "sigma": focal} if focal else None,
        }
    return {
        "name": picture.name,
        "keypoints": file_name(source.keypoints.source),
        "camera": picture.camera.to_dict(),
        "offset_s": source.offset_s,
        "time_offset_frames": solution.views[number].offset_frames - source.offset_frames,
        **found,
        "track": None if poses is None else {"frames_without_pose": int((~poses.known).sum())},
        "frames_seen": int(picture.present.any(axis=1).sum()),
        "points": _points(picture),
        "reprojection_px": {"mean": mean(errors), "median": median(errors)},
        "outliers": int(picture.outliers.sum()),
        "mean_weight": mean(picture.weight),
        "distance_m": mean(picture.distance_m),
        "notes": source.cleaning.notes,
    }


def _points(picture: Picture) -> dict[str, int]:
    source, used = picture.source, int(picture.present.sum())
    names = set(source.keypoints.names)
    rejected = sum(of["rejected"] for name, of in source.cleaning.keypoints.items() if name in names)
    return {"used": used, "missing": max(picture.present.size - used - rejected, 0), "rejected": rejected}


def camera_lines(motion: Motion, data: Any) -> Iterator[Line]:
    """Lines on each camera, where there are several."""
    for camera in data if len(data) > 1 else ():
        errors, points = camera["reprojection_px"], camera["points"]
        outliers = "1 outlier" if camera["outliers"] == 1 else f"{camera['outliers']} outliers"
        rejected = f", {points['rejected']} rejected" if points["rejected"] else ""
        yield (
            "camera",
            f"{camera['name']}: {camera['frames_seen']} of {motion.clip_frames} frames, {points['used']} points used"
            f"{rejected}; {number(errors['mean'], '.1f')} px mean, {number(errors['median'], '.1f')} px median, "
            f"{outliers}; {number(camera['distance_m'], '.1f')} m away{_found_text(motion, camera)}",
        )


def _found_text(motion: Motion, camera: dict[str, Any]) -> str:
    """What was sought of a camera besides the animal."""
    text, sigma_frames = "", camera["time_offset_sigma_frames"]
    if motion.settings.get("find_offsets") and sigma_frames:
        later_s = camera["offset_s"] + camera["time_offset_frames"] / motion.fps
        text += f"; began {later_s:.4f} ± {sigma_frames / motion.fps:.4f} s later"
    if (correction := camera["extrinsic_correction"]) is not None:
        turn, turn_sigma = (math.degrees(np.linalg.norm(correction[name])) for name in ("turn_rad", "turn_sigma_rad"))
        shift, shift_sigma = (100 * float(np.linalg.norm(correction[name])) for name in ("shift_m", "shift_sigma_m"))
        text += f"; turned by {turn:.1f} ± {turn_sigma:.1f}° and moved by {shift:.0f} ± {shift_sigma:.0f} cm"
    if (focal := camera["focal"]) is not None:
        text += f"; focal length times {focal['factor']:.3f} ± {focal['sigma']:.3f}"
    return text


# -- the path and the angles ------------------------------------------------------------------------------------------


def root_path(motion: Motion) -> dict[str, Any]:
    """The path of the reference point, exactly as reconstructed, and without the jitter from frame to frame, where each
    frame was solved by itself and that can be told."""
    jitter, root = frame_jitter_m(motion.root_m), motion.root_name
    smooth = motion.solution.jitters and np.isfinite(jitter).all()
    return {
        "joint": root,
        "keypoint": motion.names[motion.joints.index(root)] if root in motion.joints else None,
        "jitter_m": jitter,
        "exact": _kinematics(motion, None),
        "smoothed": _kinematics(motion, jitter) if smooth else None,
    }


def _kinematics(motion: Motion, smoothing_m: Array | None) -> dict[str, Any]:
    smooth = smoothing_m is not None
    errors = jitter_errors(motion.root_m) if smooth else ()
    path = point_kinematics(motion.time_s, motion.root_m, errors, smooth=smooth, propagate=False)
    names = "distance_m", "peak_speed_m_s", "mean_speed_m_s", "peak_acceleration_m_s2"
    return {"smoothing_m": smoothing_m, **picked(path, *names)}


def heading_text(angle_rad: float | None) -> str:
    if angle_rad is None:
        return "unknown"
    degrees = round(math.degrees(angle_rad))
    if degrees == 0:
        return "in the picture's plane"
    return f"{abs(degrees)}° out of the picture's plane, {'away from' if degrees > 0 else 'towards'} the camera"


def angles(motion: Motion) -> dict[str, Any]:
    """How much the pixels say of every angle, and how well it is known: medians over the frames."""
    solution = motion.solution
    known = zip(solution.angle_data_share.T, solution.angle_sigma_rad.T, strict=True)
    rows = [{"data_share": median(share), "sigma_rad": median(sigma)} for share, sigma in known]
    return by_name(motion.angle_names, rows)
