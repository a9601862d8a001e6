"""Sections of what the trajectory method found."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from recon.animal.prior import NONE
from recon.animal.skeleton_file import NONE as NO_DETECTOR
from recon.animal.skeleton_file import OWN
from recon.base.arrays import finite, mean, median
from recon.base.words import decimals, length_text
from recon.check import FLAGS
from recon.fit.motion import MEASURED_SHARE, Motion
from recon.fit.result import MotionSegment, TrajectorySolution
from recon.gait.clip import ClipAnalysis
from recon.gait.kinematics import MIN_POINTS
from recon.show.plain import file_name, frame_count, picked
from recon.show.sections.given import counts, heading_text, sentences, upright
from recon.show.sections.section import Line

HARDLY_KNOWN = 0.1
"""Standard deviation of the distance, relative to it, from which the summary begins with it."""
SAID_BY = {"views": "where the cameras are", "ground": "the camera's height above the ground"}
"""What else than the expectation says the size."""


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
    size_text = "this clip hardly says it"
    if telling := _telling(solution):
        size_text = f"by {' and '.join(telling)} it is {solution.size:.3f} ± {solution.size_sigma:.3f}"
    yield (
        f"The proportions are those of {body.title!r}, {of_animal}. How large the animal is, a factor on all its "
        f"lengths, distances and speeds, is expected to be 1 with a standard deviation of "
        f"{solution.size_prior_sigma:.2g}; {size_text}."
    )
    detector = file_name(body.detector)
    lie = f"beside the markers as those of the detector {detector}"
    if detector in (None, NO_DETECTOR):
        lie = "on the markers"
    elif detector == OWN:
        lie = "beside the markers as the skeleton's or the subject's file says"
    yield f"Keypoints are taken to lie {lie}."
    yield "Poses and their changes are expected to be " + (
        "as the skeleton's file says, each angle on its own."
        if solution.prior == NONE
        else f"as in the motions that the prior {file_name(solution.prior)} was made from."
    )
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
    flags = dict.fromkeys((*FLAGS, *(flag for flags in motion.flags for flag in flags)))
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
    flagged = f"{data['frames_flagged']} doubtful ({', '.join(why)})" if why else "none doubtful"
    left_out = data["frames_left_out"]
    far = f"; {left_out} far from all detections, and in no table" if left_out else ""
    yield "frames", f"{data['frames_with_pose']} of {data['frames']} with a pose, {flagged}{far}"
    sigma_m, distances = data["place_sigma_m"], [mean(picture.distance_m) for picture in motion.pictures]
    known = [(away, _called(motion, v)) for v, away in enumerate(distances) if math.isfinite(away)]
    if sigma_m is not None and known and sigma_m > HARDLY_KNOWN * min(known)[0]:
        size_text = _solution(motion).size_sigma <= HARDLY_KNOWN / 2
        why = "these pictures hardly tell it" if size_text else "the size is not known better"
        away, camera = min(known)
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
    mean_m_s, peak_m_s, over_m = path["mean_speed_m_s"], path["peak_speed_m_s"], path["distance_m"]
    form = decimals(peak_m_s)
    yield "speed", f"{mean_m_s:{form}} m/s mean, {peak_m_s:{form}} m/s peak, over {over_m:{decimals(over_m)}} m"


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
        "measured": subject is not None,
    }


def size_lines(motion: Motion, data: Any) -> Iterator[Line]:
    by, animal = _telling(_solution(motion)), data["lengths"].split(",")[0]
    if by:
        relative = data["sigma"] / data["factor"]
        yield "size", f"{data['factor']:.2f} times the {animal} of the skeleton, ±{relative:.0%}, by {' and '.join(by)}"
    elif data["measured"]:
        yield "size", f"as measured ({data['subject']}), ±{data['sigma']:.0%}"
    else:
        yield "size", f"not measured: all metres and m/s assume a {animal} of average size (±{data['sigma']:.0%})"


def _size_share(solution: TrajectorySolution) -> float:
    return max(0.0, 1.0 - (solution.size_sigma / solution.size_prior_sigma) ** 2)


def _telling(solution: TrajectorySolution) -> list[str]:
    """By what the size was measured, where that says more than the expectation; the ground often says a little only."""
    return [SAID_BY[what] for what in solution.size_from if what in SAID_BY and _size_share(solution) >= MEASURED_SHARE]


# -- how sure ---------------------------------------------------------------------------------------------------------


def prior(motion: Motion) -> dict[str, Any]:
    """The misfit and the weight are those of the segment that the prior fits least."""
    solution = _solution(motion)
    return {
        "name": file_name(solution.prior),
        "mean_data_share": mean(solution.data_share),
        "prior_misfit": max(
            (segment.prior_misfit for segment in solution.segments if segment.prior_misfit is not None), default=None
        ),
        "weight": min((segment.prior_weight for segment in solution.segments), default=1.0),
    }


def prior_lines(motion: Motion, data: Any) -> Iterator[Line]:
    name = "the skeleton's own expectations" if data["name"] == NONE else data["name"]
    share = data["mean_data_share"]
    if share is not None:
        yield "prior", f"{share:.0%} of the pose rests on the video, {1 - share:.0%} on {name}"


# -- the ground and the stances ---------------------------------------------------------------------------------------


def segments(motion: Motion) -> list[dict[str, Any]]:
    """The stretches that were solved, each by itself, and the ground under them."""
    found = []
    for segment in motion.solution.segments:
        frames = motion.frames[segment.rows.start], motion.frames[segment.rows.stop - 1] + 1
        found.append({"frames": frames, "ground": _ground(motion, segment)} | picked(segment, "prior_weight"))
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


def convergence(motion: Motion) -> dict[str, Any]:
    solution = _solution(motion)
    return picked(solution, "status", "iterations", "cost_by_term")


def effort_lines(motion: Motion, data: Any) -> Iterator[Line]:
    if data["status"] != "converged":
        yield "search", f"not converged after {data['iterations']} iterations: the pose may be far off"
