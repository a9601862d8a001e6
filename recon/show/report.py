"""All that is said of a motion: one list of sections, from which report.json, the summary and the page are made.

To add a section: a function of a motion that gives its numbers, perhaps one that gives its lines of the summary, and an
entry in `SECTIONS`; `FRONT` has the labels of the lines that the terminal shows. Another method has its own list
(`Solution.described_by`). The fields of report.json: docs/report.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from rich.text import Text

from recon import check
from recon.animal.naming import suggestions
from recon.animal.prior import NONE as NO_PRIOR
from recon.animal.skeleton_file import NONE, OWN, of_scorer
from recon.base import Array, decimals, finite, length_text, mean, median, version
from recon.clip import COUNTS
from recon.fit import MEASURED_SHARE, Motion, MotionSegment, Picture, TrajectorySolution
from recon.gait import G_M_S2, ClipAnalysis, Gait
from recon.gait.gait import interval_text
from recon.gait.kinematics import MIN_POINTS, JointKinematics, frame_jitter_m, jitter_errors, point_kinematics
from recon.show.plain import by_name, file_name, frame_count, number, picked, to_plain
from recon.show.plain import to_json as to_json

Line = tuple[str, str]
"""(label, value), of a summary."""
BEST_SHARE = 0.9
SCORER_SHOWN = 60
"""Characters."""
OF_JOINT = ("outliers", "mean_error_px", "noise_px", "mean_weight")
CONVERGENCE = ("status", "iterations", "cost_by_term")
HARDLY_KNOWN = 0.1
"""Standard deviation of the distance, relative to it, from which the summary begins with it."""
SAID_BY = {"views": "where the cameras are", "ground": "the camera's height above the ground"}
"""What else than the expectation says the size."""


@dataclass(frozen=True)
class Section:
    """One part of what is said of a motion, wherever it is said."""

    name: str
    """The name of its field of report.json."""
    data: Callable[[Motion], Any]
    """What stands there: numbers, texts, arrays, and lists and mappings of them."""
    lines: Callable[[Motion, Any], Iterable[Line]] = lambda motion, data: ()
    """The lines of the summary, from the motion and from the data as JSON has them: null where a number is not
    known."""


# -- the verdict ------------------------------------------------------------------------------------------------------


def verdict_lines(motion: Motion, data: Any) -> Iterator[Line]:
    yield from zip(("verdict", "expected"), check.verdict_lines(motion.verdict), strict=False)
    if len(motion.sources) == 1 and motion.verdict is not None and motion.verdict.position_m is not None:
        share = motion.settings.get("focal_sigma")
        known = f" (its focal length to {share:.0%}, as given)" if share else ""
        yield (
            "assumed",
            f"The camera is as said{known}: one camera cannot tell its focal length, where it stands, nor whether the "
            "video was cropped or is another camera's.",
        )
    yield from (("assumed", check.sentence(one)) for one in motion.findings if one.code == "up_from_feet")


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
    name, scorers = file_name(motion.body.detector) or NONE, {source.keypoints.scorer for source in motion.sources}
    named = " and ".join(sorted(repr(one[:SCORER_SHOWN]) for one in scorers if one))
    reason = "as the skeleton's file says"
    if motion.settings.get("detector") is not None:
        reason = "as given"
    elif name == OWN:
        reason = "as the subject's or the skeleton's file says"
    elif name == NONE:
        reason = f"the scorer {named} is of no detector known here" if named else "the keypoint file names no scorer"
    elif name in {of_scorer(one, motion.body.name) for one in scorers}:
        reason = f"by the file's scorer {named}"
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
        yield "The camera is taken to be level, because nothing says which way is up."
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
        counts = {count: sum(of_one[count] for of_one in known) if known else None for count in COUNTS}
        rows.append({"name": name, "joint": None, "in_file": bool(known), **counts} | dict.fromkeys(OF_JOINT))
    for j, row in enumerate(rows[: len(motion.names)]):
        means = (mean(of[..., j]) for of in (distance_px, motion.solution.noise_px, motion.solution.weight))
        row |= {"joint": motion.joints[j]} | by_name(OF_JOINT, (int(outliers[..., j].sum()), *means))
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
    counted = [f"{used} used", *([f"{missing} missing"] if missing else [])]
    unknown = sum(row["likelihood_unknown"] for row in fitted if row["in_file"])
    counted += [f"{unknown} without a likelihood (never left out as unlikely)"] if unknown else []
    counted += [f"{rejected}{share} left out before the fit, as unlikely or far outside{more}"] if rejected else []
    yield "detections", ", ".join(counted)
    errors = found["reprojection_px"]
    px = "{mean:.1f} px mean, {median:.1f} px median; worst joint {worst_joint}, {worst_joint_mean:.1f} px"
    yield "reprojection", "none: no pose" if errors["worst_joint"] is None else px.format(**errors)
    off = sorted(((row["outliers"], row["name"]) for row in fitted if row["outliers"]), reverse=True)
    most = ", ".join(f"{name} {count}" for count, name in off[:3]) + (", ..." if len(off) > 3 else "")
    where = f": {most}" if off else ""
    yield "outliers", f"{found['outliers']} of the {used} detections used disagree with the pose{where}"


def cleaning(motion: Motion) -> dict[str, Any]:
    done = motion.cleaning
    plain = {name: getattr(done, name) for name in ("likelihood_min", "frames", "frames_dropped", "inserted")}
    return plain | {"total": {count: done.total(count) for count in COUNTS[1:]}, "notes": done.notes}


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
        rejected = f", {points['rejected']} left out before the fit" if points["rejected"] else ""
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
        shift = length_text(*(float(np.linalg.norm(correction[name])) for name in ("shift_m", "shift_sigma_m")))
        text += f"; turned by {turn:.1f} ± {turn_sigma:.1f}° and moved by {shift}"
    if (focal := camera["focal"]) is not None:
        text += f"; focal length times {focal['factor']:.3f} ± {focal['sigma']:.3f}"
    return text


# -- the path and the angles ------------------------------------------------------------------------------------------


def root_path(motion: Motion) -> dict[str, Any]:
    """The path of the reference point, exactly as reconstructed, and without the jitter from frame to frame, where each
    frame was solved by itself and that can be told."""
    jitter, root, time_s = frame_jitter_m(motion.root_m), motion.root_name, motion.time_s
    names = "distance_m", "peak_speed_m_s", "mean_speed_m_s", "peak_acceleration_m_s2"
    exact = point_kinematics(time_s, motion.root_m, propagate=False)
    smoothed = None
    if motion.solution.jitters and np.isfinite(jitter).all():
        path = point_kinematics(time_s, motion.root_m, jitter_errors(motion.root_m), smooth=True, propagate=False)
        smoothed = {"smoothing_m": jitter, **picked(path, *names)}
    return {
        "joint": root,
        "keypoint": motion.names[motion.joints.index(root)] if root in motion.joints else None,
        "jitter_m": jitter,
        "exact": {"smoothing_m": None, **picked(exact, *names)},
        "smoothed": smoothed,
    }


def heading_text(angle_rad: float | None) -> str:
    if angle_rad is None:
        return "unknown"
    if (degrees := round(math.degrees(angle_rad))) == 0:
        return "in the picture's plane"
    return f"{abs(degrees)}° out of the picture's plane, {'away from' if degrees > 0 else 'towards'} the camera"


# -- what the trajectory method found ---------------------------------------------------------------------------------


def _solution(motion: Motion) -> TrajectorySolution:
    assert isinstance(motion.solution, TrajectorySolution)
    return motion.solution


# -- what was assumed and asked for -----------------------------------------------------------------------------------


def assumptions(motion: Motion) -> dict[str, Any]:
    """What the data does not say, in numbers and in sentences."""
    return {**upright(motion), "sentences": [*_sentences(motion)]}


def _sentences(motion: Motion) -> Iterator[str]:
    solution, body = _solution(motion), motion.body
    of_animal = "not measured on this one" if body.subject is None else "measured on this animal"
    given, size_text = _size_given(motion), "this clip hardly says it"
    if telling := _telling(solution):
        size_text = f"by {' and '.join(telling)} it is {solution.size:.3f} ± {solution.size_sigma:.3f}"
    yield (
        f"The proportions are those of {body.title!r}, {of_animal}. How large the animal is, a factor on all its "
        f"lengths, distances and speeds, is expected to be 1{given and f' ({given})'} with a standard deviation of "
        f"{solution.size_prior_sigma:.2g}; {size_text}."
    )
    detector = file_name(body.detector)
    lie = f"beside the markers as those of the detector {detector}"
    if detector in (None, NONE):
        lie = "on the markers"
    elif detector == OWN:
        lie = "beside the markers as the skeleton's or the subject's file says"
    yield f"Keypoints are taken to lie {lie}."
    known = f"as in the motions that the prior {file_name(solution.prior)} was made from"
    if solution.prior == NO_PRIOR:
        known = "as the skeleton's file says, each angle on its own"
    yield f"Poses and their changes are expected to be {known}."
    yield from sentences(motion)
    if any(segment.ground is not None for segment in solution.segments):
        yield "The ground is a plane, and feet that stand stand still on it."
    if len(solution.segments) > 1:
        yield (
            f"The clip has {len(solution.segments)} segments, between which nothing was seen for long: each was solved "
            "by itself, with a ground of its own."
        )
    if motion.settings.get("fast"):
        yield "The fast search was asked for: fewer headings to start from, and looser tolerances."


# -- the frames -------------------------------------------------------------------------------------------------------


def summary(motion: Motion) -> dict[str, Any]:
    flags = dict.fromkeys((*check.FLAGS, *(flag for flags in motion.flags for flag in flags)))
    return {
        "frames": motion.clip_frames,
        "frames_left_out": motion.clip_frames - len(motion.frames),
        "frames_with_pose": int(motion.solved.sum()),
        "frames_flagged": sum(bool(flags) for flags in motion.flags),
        "flags": {flag: sum(flag in of_frame for of_frame in motion.flags) for flag in flags},
        **counts(motion),
        "mean_weight": mean(motion.solution.weight),
        "place_sigma_m": median(motion.place_sigma_m),
        "relative_rms_m": median(motion.relative_rms_m),
    }


def summary_lines(motion: Motion, data: Any) -> Iterator[Line]:
    why = [f"{count} {flag}" for flag, count in data["flags"].items() if count]
    several = "some for several reasons: " if sum(data["flags"].values()) > data["frames_flagged"] else ""
    flagged = f"{data['frames_flagged']} doubtful ({several}{', '.join(why)})" if why else "none doubtful"
    left_out = data["frames_left_out"]
    far = f"; {left_out} far from all detections, and in no table" if left_out else ""
    yield "frames", f"{data['frames_with_pose']} of {data['frames']} with a pose, {flagged}{far}"
    sigma_m, distances = data["place_sigma_m"], [mean(picture.distance_m) for picture in motion.pictures]
    known = [(away, _called(motion, v)) for v, away in enumerate(distances) if math.isfinite(away)]
    away, camera = min(known, default=(math.inf, ""))
    if sigma_m is not None and sigma_m > HARDLY_KNOWN * away:
        size_known = _solution(motion).size_sigma <= HARDLY_KNOWN / 2
        why = "these pictures hardly tell it" if size_known else "the size is not known better"
        yield "distance", f"{away:{decimals(away)}} ± {sigma_m:{decimals(away)}} m from {camera}: {why}"


def _called(motion: Motion, number: int = 0) -> str:
    """What a sentence of the summary calls a camera."""
    return motion.pictures[number].name if len(motion.pictures) > 1 else "the camera"


# -- path, heading, size ----------------------------------------------------------------------------------------------


def speed_lines(motion: Motion, data: Any) -> Iterator[Line]:
    path = data["exact"]
    if path["mean_speed_m_s"] is None:
        yield "speed", f"none from fewer than {MIN_POINTS} frames"
        return
    mean_m_s, over_m = path["mean_speed_m_s"], path["distance_m"]
    yield "speed", f"{mean_m_s:{decimals(mean_m_s)}} m/s on average, over {over_m:{decimals(over_m)}} m"


def heading(motion: Motion) -> dict[str, Any]:
    """The way the animal faces, level, as the first camera sees it."""
    (rear, front), solution = motion.forward, _solution(motion)
    joints, R = solution.joints_m, solution.views[0].T_camera_world[..., :3, :3]
    level = joints[:, front] - joints[:, rear]
    level[:, 2] = 0.0
    level /= np.linalg.norm(level, axis=1, keepdims=True)
    right = R[..., 0, :] * [1.0, 1.0, 0.0]
    right /= np.linalg.norm(right, axis=-1, keepdims=True)
    away = np.cross([0.0, 0.0, 1.0], right)
    return {
        "heading_to_picture_rad": median(np.arcsin(np.clip(np.sum(level * away, axis=-1), -1.0, 1.0))),
        "sideslip_rad": solution.sideslip_rad if solution.sideslip_sigma_rad else None,
        "sideslip_sigma_rad": solution.sideslip_sigma_rad or None,
    }


def heading_lines(motion: Motion, data: Any) -> Iterator[Line]:
    seen_by = f", as {_called(motion)} sees it" if len(motion.pictures) > 1 else ""
    yield "heading", heading_text(data["heading_to_picture_rad"]) + seen_by


def size(motion: Motion) -> dict[str, Any]:
    """The factor on the skeleton's lengths: what was expected, and what came out."""
    solution, subject = _solution(motion), motion.body.subject
    return {
        "factor": solution.size,
        "sigma": solution.size_sigma,
        "prior_sigma": solution.size_prior_sigma,
        "data_share": _size_share(solution),
        "from": solution.size_from,
        "subject": file_name(subject),
        "lengths": motion.title,
        "measured": bool(_size_given(motion) or _telling(solution)),
    }


def size_lines(motion: Motion, data: Any) -> Iterator[Line]:
    by, given, animal = _telling(_solution(motion)), _size_given(motion), data["lengths"].split(",")[0]
    if by:
        percent, of = 100 * data["sigma"] / data["factor"], given or animal
        known = f"±{percent:.0f}%" if percent >= 1 else f"±{percent:.1g}%"
        yield "size", f"{data['factor']:.2f} times the skeleton ({of}), {known}, by {' and '.join(by)}"
    elif given:
        yield "size", f"as given ({given}), ±{data['sigma']:.0%}"
    else:
        yield "size", f"not measured: all metres and m/s assume average size ({animal}, ±{data['sigma']:.0%})"


def _size_given(motion: Motion) -> str:
    """What told the animal's size before the clip was seen, empty where it is that of an average one."""
    for name, option in (("height_m", "--height-m "), ("size", "--set size=")):
        if (value := motion.settings.get(name)) is not None:
            return f"{option}{value:g}"
    return file_name(motion.body.subject) or ""


def _size_share(solution: TrajectorySolution) -> float:
    return max(0.0, 1.0 - (solution.size_sigma / solution.size_prior_sigma) ** 2)


def _telling(solution: TrajectorySolution) -> list[str]:
    """By what the size was measured, where that says more than the expectation; the ground often says a little only."""
    return [SAID_BY[what] for what in solution.size_from if what in SAID_BY and _size_share(solution) >= MEASURED_SHARE]


# -- how sure ---------------------------------------------------------------------------------------------------------


def prior(motion: Motion) -> dict[str, Any]:
    """The misfit and the weight are those of the segment that the prior fits least."""
    solution = _solution(motion)
    misfits = [segment.prior_misfit for segment in solution.segments if segment.prior_misfit is not None]
    return {
        "name": file_name(solution.prior),
        "mean_data_share": mean(solution.data_share),
        "prior_misfit": max(misfits, default=None),
        "weight": min((segment.prior_weight for segment in solution.segments), default=1.0),
    }


def prior_lines(motion: Motion, data: Any) -> Iterator[Line]:
    name, share = data["name"], data["mean_data_share"]
    if name == NO_PRIOR:
        name = "the skeleton's own expectations"
        yield "note", "Left-right swaps, lens, zoom and frame rate were not checked: that needs a learned prior."
    if share is not None:
        yield "prior", f"{share:.0%} of the pose rests on the video, {1 - share:.0%} on {name}"


# -- the ground and the stances ---------------------------------------------------------------------------------------


def segments(motion: Motion) -> list[dict[str, Any]]:
    """The stretches that were solved, each by itself, and the ground under them."""
    found = []
    for one in motion.solution.segments:
        ends = motion.frames[one.rows.start], motion.frames[one.rows.stop - 1] + 1
        found.append({"frames": ends, "ground": _ground(motion, one), "prior_weight": one.prior_weight})
    return found


def _ground(motion: Motion, segment: MotionSegment) -> dict[str, Any] | None:
    """Below the middle of the root's path in the segment."""
    ground, below = segment.ground, motion.below_m(segment)
    if ground is None or below is None:
        return None
    return {
        "height_m": below[2],
        "middle_m": below[:2],
        "slope": ground.slope,
        "sigma_m": ground.sigma_m,
        "camera_height_m": motion.solution.views[0].centre_m[:, 2].mean() - below[2],
        "frame": "world" if motion.knows_up else "level",
    }


def stances(motion: Motion) -> dict[str, Any]:
    """By foot: the ranges of frame numbers in which it stands, as `recon.gait` has them."""
    found = ClipAnalysis(motion).gait if motion.solved.sum() >= MIN_POINTS else None
    ranges, last = {name: [] for name in motion.foot_names.values()}, len(motion.frames) - 1
    for stance in found.stances if found else ():
        first, stop = (min(round(row), last) for row in (stance.start_frame, stance.end_frame))
        ranges[motion.foot_names[stance.foot]].append((motion.frames[first], motion.frames[stop] + 1))
    return ranges


def ground_lines(motion: Motion, data: Any) -> Iterator[Line]:
    found = []
    for segment in segments(motion):
        ground, (first, stop) = segment["ground"], segment["frames"]
        text = "not found"
        if ground is not None:
            height, side = ground["camera_height_m"], "below" if ground["camera_height_m"] > 0 else "above"
            text = f"{length_text(abs(height), ground['sigma_m'])} {side} {_called(motion)}"
        found.append((text, f" (frames {first} to {stop - 1})"))
    if all(text == "not found" for text, _ in found):
        yield "ground", "not looked for" if motion.settings.get("ground") == "none" else "not found"
        return
    where = ", ".join(text + (frames if len(found) > 1 else "") for text, frames in found)
    yield "ground", f"{where}; stances: {', '.join(f'{foot} {len(ranges)}' for foot, ranges in data.items())}"


# -- the search -------------------------------------------------------------------------------------------------------


def alternative(motion: Motion) -> dict[str, Any] | None:
    apart = finite(motion.alternative_m)
    if not len(apart):
        return None
    return {
        "cost_difference": _solution(motion).alternative_cost,
        "frames": len(apart),
        "mean_m": apart.mean(),
        "max_m": apart.max(),
    }


def alternative_lines(motion: Motion, data: Any) -> Iterator[Line]:
    if data is None:
        text = "no other pose fits nearly as well"
    elif not any(one.code == "second_solution" for one in motion.findings):
        text = f"a second solution differs by {length_text(data['mean_m'])}: harmless"
    else:
        text = f"another pose, {length_text(data['mean_m'])} away on average in {frame_count(data['frames'])}, fits "
        text += "equally well: the data cannot tell which is right" if data["cost_difference"] < 1 else "nearly as well"
    yield "alternative", text


def effort_lines(motion: Motion, data: Any) -> Iterator[Line]:
    if data["status"] != "converged":
        yield "search", f"not converged after {data['iterations']} iterations: the pose may be far off"


SECTIONS: tuple[Section, ...] = (
    Section("verdict", check.verdict_fields, verdict_lines),
    Section("input", clip, clip_lines),
    Section("side", side, side_lines),
    Section("frame_of_reference", lambda motion: motion.frame_of_reference),
    Section("skeleton", skeleton),
    Section("assumptions", assumptions),
    Section("summary", summary, summary_lines),
    Section("unused_keypoints", lambda motion: motion.unused_keypoints),
    Section("missing_keypoints", lambda motion: motion.missing_keypoints),
    Section("keypoints", keypoints, keypoint_lines),
    Section("detector", detector, detector_lines),
    Section("cameras", cameras, camera_lines),
    Section("cleaning", cleaning, note_lines),
    Section("root_path", root_path, speed_lines),
    Section("heading", heading, heading_lines),
    Section("size", size, size_lines),
    Section("prior", prior, prior_lines),
    Section("segments", segments),
    Section("stances", stances, ground_lines),
    Section("alternative", alternative, alternative_lines),
    Section("convergence", lambda motion: picked(motion.solution, *CONVERGENCE), effort_lines),
)
"""The sections of the trajectory method, in the order of the summary."""


def sections_of(motion: Motion) -> tuple[Section, ...]:
    return import_module(motion.solution.described_by).SECTIONS


# -- report.json, and the summary of a fit -----------------------------------------------------------------------------

SCHEMA_NAME, SCHEMA_VERSION = "recon.fit.report", 4
REPORT = "report.json"
STYLES = {"use": "bold green", "check": "bold yellow", "do not use": "bold red"}
"""Styles of the levels of a verdict, on a terminal."""
TO_DO = {  # what is to be used needs no word more
    "check": "Look at the poses on the video (recon overlay) before use: reason and warnings say what may be wrong.",
    "do not use": "Do not use these numbers: mend what the reason names, and fit again.",
}
FRONT = ("assumed", "clip", "frames", "distance", "side", "keypoints", "detections", "note", "speed", "path", "size")
"""Lines of the summary that a terminal shows below the verdict; the page has all."""


def build_report(motion: Motion) -> dict[str, Any]:
    """The report of one clip, plain JSON types: NaN becomes None, floats have nine significant digits. `lines` are the
    summary's, label and text, without the findings."""
    report = {
        "schema": {"name": SCHEMA_NAME, "version": SCHEMA_VERSION},
        "recon_version": version(),
        "method": motion.solution.method,
        "settings": to_plain(motion.settings),
        "timing_s": to_plain({**motion.timing_s, **motion.solution.stage_s} or None),
        "findings": [to_plain(asdict(one) | {"text": text}) for one, text in check.sentences(motion)],
        "lines": [],
    }
    for section in sections_of(motion):
        data = report[section.name] = to_plain(section.data(motion))
        report["lines"] += [[label, text] for label, text in section.lines(motion, data)]
    return report


def in_sentences(motion: Motion, moved: JointKinematics, gait: Gait | None, doubt: str | None) -> Iterator[str]:
    """The movement of the reference joint and the gait; doubt: why no speed is known."""
    most, sigma = moved.peak_speed_m_s, moved.peak_speed_sigma_m_s
    run_m_s = motion.solution.constant_velocity_m_s
    if doubt is None:
        form, of_path = decimals(most), decimals(moved.distance_m)
        # a peak below its own deviation is not known
        peak = "" if sigma > most else f" and at most {interval_text(most, sigma, 'm/s')}"
        yield (
            f"The animal moved {moved.distance_m:{of_path}} m, at {moved.mean_speed_m_s:{form}} m/s on average{peak}."
        )
    else:
        straight = "" if run_m_s is None else f"{median(run_m_s[run_m_s > 0]):.1f} m/s"
        run = straight and f" A straight run through all frames has {straight}."
        yield f"The animal's path is too uncertain in depth for a speed: {doubt}.{run}"
    if gait is None:
        yield "The skeleton has no feet: no gait."
        return
    yield f"Gait: {gait.name.name} ({gait.name.criterion})."
    if gait.strides:
        yield (
            f"Strides are {length_text(gait.stride_length_m)} long, {gait.stride_frequency_hz:.2f} a second (average "
            f"of the feet's {len(gait.strides)} strides); a foot stands {gait.name.duty_factor:.0%} of the time "
            "(90 %: {:.0%} to {:.0%}).".format(*gait.name.duty_interval)
        )
        lasts_s, swing_s = 1 / gait.stride_frequency_hz, 2 * math.pi * math.sqrt(gait.tracks.leg_m / 1.5 / G_M_S2)
        if lasts_s > swing_s:
            yield (
                f"Strides last {lasts_s:.1f} s, longer than a leg of this length swings to and fro by itself "
                f"({swing_s:.1f} s): the video may be in slow motion. Check --fps."
            )


def warnings(report: Mapping[str, Any]) -> list[str]:
    """What is wrong or to be used with care, in words: the findings but for notes."""
    return [one["text"] for one in report["findings"] if one["severity"] != "note"]


def is_unsolved(report: Mapping[str, Any]) -> bool:
    """Whether there is no pose to look at."""
    summary = report["summary"]
    return summary.get("frames_converged", summary["frames_with_pose"]) == 0


def console_summary(report: Mapping[str, Any]) -> Table:
    """What there is to conclude, for a terminal, to be printed with rich: verdict, expected error, what to do and what
    may be wrong, then `FRONT`."""
    table = Table.grid(padding=(0, 2))
    table.add_column(no_wrap=True)
    table.add_column()
    verdict = report["verdict"] or {"level": "", "reason": ""}
    found = [one for one in report["findings"] if one["severity"] != "note" and one["text"] != verdict["reason"]]
    begins = sum(label in ("verdict", "expected") for label, _ in report["lines"])  # below, what may be wrong
    for label, text in report["lines"][:begins]:
        level = verdict["level"] if label == "verdict" else ""
        table.add_row(Text(label, style="bold"), Text.assemble((level, STYLES.get(level, "")), text[len(level) :]))
    if verdict["level"] in TO_DO:
        table.add_row(Text("to do", style="bold"), TO_DO[verdict["level"]])
    for one in found:
        colour = {"error": "red", "warning": "yellow"}[one["severity"]]
        table.add_row(Text(one["severity"], style=f"bold {colour}"), Text(one["text"], colour))
    for label, text in report["lines"][begins:]:
        if label in FRONT and not (label == "keypoints" and text.endswith(" used")):  # all of them, as they should be
            table.add_row(Text(label, style="bold"), text)
    return table
