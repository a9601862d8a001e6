"""Report the verdict, the clip, the skeleton and the assumptions."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from recon.animal.prior import NONE as NO_PRIOR
from recon.animal.skeleton_file import NONE, OWN, detector_of_scorer
from recon.base.numbers import percent, plus_minus, quantity
from recon.check.codes import sentence
from recon.check.verdict import verdict_lines as lines_of_verdict
from recon.clip import COUNTS
from recon.fit.constants import focal_sigma_of
from recon.fit.motion import Motion, trajectory_solution
from recon.fit.result import TrajectorySolution
from recon.show.plain import file_name, picked
from recon.show.sections.motion import given_size, size_sources
from recon.show.sections.section import Line

MAX_SCORER_CHARACTERS = 60
"""Maximum number of characters of a scorer's name in the summary that a fit prints."""


def verdict_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield lines with the verdict, the expected errors, and the assumptions on which both depend."""
    yield from zip(("verdict", "expected"), lines_of_verdict(motion.verdict), strict=False)
    if len(motion.sources) == 1 and motion.verdict is not None and motion.verdict.position_m is not None:
        yield "assumed", _assumed_by_one_camera(motion)
    up_from_feet = [finding for finding in motion.findings if finding.code == "up_from_feet"]
    yield from (("assumed", sentence(finding)) for finding in up_from_feet)


def _assumed_by_one_camera(motion: Motion) -> str:
    """Return a sentence on the assumptions that one camera cannot verify (lens, camera motion, frame rate, size)."""
    camera, focal_sigma = motion.camera, focal_sigma_of(motion.settings, 1)
    known_to = f" ± {percent(focal_sigma)}" if focal_sigma else ""
    lens = f"a {camera.model} lens with a focal length of {quantity(camera.matrix[0, 0], 0, 'px')}{known_to}"
    moving_or_static = "a camera that moves as in its track" if motion.camera_moves else "a static camera"
    animal = f"the lengths of {motion.body.name}"
    if isinstance(motion.solution, TrajectorySolution):
        solution = motion.solution
        if size_sources(solution):
            animal = "the camera's height above the ground in its file"
        else:
            animal = f"an animal of the expected size ± {percent(solution.size_prior_sigma)}"
    return (
        f"{lens[0].upper()}{lens[1:]}, {moving_or_static}, {motion.fps:g} frames per second, and {animal}. One "
        "camera cannot check these, nor whether the video was cropped or comes from another camera."
    )


def clip_data(motion: Motion) -> dict[str, Any]:
    """Return the files, the frames and the camera of a clip."""
    files = {"keypoints": file_name(motion.keypoints.source), "individual": motion.keypoints.individual}
    frames = motion.frames[0], motion.frames[-1] + 1
    return files | {"fps": motion.fps, "frames": frames, "camera": motion.camera.to_dict()}


def clip_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield a line with the clip's files, frames and frame rate, and the camera of a single keypoint file."""
    sources = [source.keypoints.source for source in motion.sources]
    files = ", ".join(Path(path).name if path else "keypoints" for path in sources)
    has_file = len(sources) == 1 and motion.settings and motion.settings.get("camera") is not None
    camera = f" (camera {motion.camera.name})" if has_file else ""
    first, stop = data["frames"]
    yield "clip", f"{files}{camera}, frames {first} to {stop - 1} at {motion.fps:g} fps"


def side_data(motion: Motion) -> dict[str, Any]:
    """Return the side of the animal to which the fit was restricted, if any, and the reason."""
    return {"fitted": motion.side, "reason": motion.side_reason}


def side_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield a line with the side of the animal to which the fit was restricted, if any."""
    if motion.side:
        yield "side", f"{motion.side}: {motion.side_reason}"


def cleaning_data(motion: Motion) -> dict[str, Any]:
    """Return how points were cleaned before the fit, with the numbers of points left out by reason."""
    cleaning = motion.cleaning
    plain = {name: getattr(cleaning, name) for name in ("likelihood_min", "frames", "frames_dropped", "inserted")}
    return plain | {"total": {count: cleaning.total(count) for count in COUNTS[1:]}, "notes": cleaning.notes}


def note_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield a line for each decision made when the files were read, without repetitions."""
    for note in dict.fromkeys(note for source in motion.sources for note in source.cleaning.notes):
        yield "note", note


def skeleton_data(motion: Motion) -> dict[str, Any]:
    """Return the skeleton's name, keypoints, feet, joints and components of the state."""
    feet = {label: motion.names[foot] for label, foot in zip(motion.foot_labels, motion.feet, strict=True)}
    layout = picked(motion, "title", "joints", "state_names", "states_frame")
    return {"name": motion.body.name, "keypoints": motion.names, "feet": feet, **layout}


def detector_data(motion: Motion) -> dict[str, str]:
    """Return the detector that is assumed to have made the keypoints, and the reason."""
    name, scorers = file_name(motion.body.detector) or NONE, {source.keypoints.scorer for source in motion.sources}
    scorer_names = " and ".join(sorted(repr(scorer[:MAX_SCORER_CHARACTERS]) for scorer in scorers if scorer))
    reason = "as stated in the skeleton file"
    if motion.settings.get("detector") is not None:
        reason = "as given"
    elif name == OWN:
        reason = "as stated in the subject's or the skeleton's file"
    elif name == NONE and scorer_names:
        reason = f"the scorer {scorer_names} belongs to no known detector"
    elif name == NONE:
        reason = "the keypoint file names no scorer"
    elif name in {detector_of_scorer(scorer, motion.body.name) for scorer in scorers}:
        reason = f"by the file's scorer {scorer_names}"
    return {"name": name, "reason": reason}


def detector_lines(motion: Motion, data: dict[str, Any]) -> Iterator[Line]:
    """Yield a line with the detector and, if it is unknown, how to measure its keypoint bias."""
    if motion.body.one_sided:
        return
    offer = ""
    if "belongs to no known detector" in data["reason"]:
        offer = "; two runs with four cameras measure its keypoint bias: recon subject fit --no-lengths --offsets"
    yield "detector", f"{data['name']}: {data['reason']}{offer}"


def assumptions_data(motion: Motion) -> dict[str, Any]:
    """Return the assumptions of the trajectory method as numbers and as sentences."""
    return {**upright_data(motion), "sentences": [*_trajectory_sentences(motion)]}


def upright_data(motion: Motion) -> dict[str, Any]:
    """Return the upward direction in the camera's axes, and how it is known."""
    camera = motion.camera
    return {
        "camera_level": not motion.knows_up and camera.tilt_rad == 0,
        "camera_tilt_rad": None if motion.knows_up else camera.tilt_rad,
        "camera_up": None if motion.camera_moves else camera.up,
        "camera_moves": motion.camera_moves,
    }


def assumption_sentences(motion: Motion) -> Iterator[str]:
    """Yield sentences that state the assumptions of all methods."""
    camera, hfov_deg = motion.camera, motion.settings.get("hfov_deg")
    is_single = len(motion.pictures) == 1
    subject, condition = ("The camera is", "it pans") if is_single else ("The cameras are", "one of them pans")
    if all(picture.T_reference_camera.ndim == 2 for picture in motion.pictures):
        yield f"{subject} static: if {condition} or moves, its movement is part of the path."
    for picture in motion.pictures:
        if picture.source.moves:
            yield (
                f"Camera {picture.name} moves as in its track. The track's world is assumed to be in metres with z "
                "up; the height of the ground in it is not assumed."
            )
    if motion.side is not None:
        yield f"Only the limbs of the animal's {motion.side} side are fitted."
    if not motion.knows_up and camera.tilt_rad == 0:
        yield "The camera is assumed to be level, because nothing states which way is up."
    elif not motion.knows_up:
        degrees = math.degrees(camera.tilt_rad)
        yield f"The camera is assumed to look down by {degrees:.3g} degrees, as given, without roll."
    if hfov_deg is not None:
        lens = "be an equidistant fisheye" if camera.model == "fisheye" else "have no distortion"
        yield (
            f"The camera has no calibration: its focal length follows from a horizontal field of view of "
            f"{hfov_deg:g} degrees, and its lens is assumed to {lens}."
        )


def _trajectory_sentences(motion: Motion) -> Iterator[str]:
    solution, body = trajectory_solution(motion), motion.body
    measured = "not measured on this animal" if body.subject is None else "measured on this animal"
    size_source, size_text = given_size(motion), "this clip hardly determines it"
    if sources := size_sources(solution):
        size_text = f"measured by {' and '.join(sources)}: {plus_minus(solution.size, solution.size_sigma)}"
    proportions = f"The proportions are those of {body.title!r}, {measured}."
    if solution.shape is not None:
        proportions = (
            f"The proportions are estimated; they are expected to be close to those of {body.title!r}, {measured}."
        )
    yield (
        f"{proportions} The animal's size, a factor that multiplies "
        f"all lengths, distances and speeds, is expected to be 1{size_source and f' ({size_source})'} with a standard "
        f"deviation of {solution.size_prior_sigma:.2g}; {size_text}."
    )
    detector = file_name(body.detector)
    offsets = f"next to the markers, with the keypoint bias of the detector {detector}"
    if detector in (None, NONE):
        offsets = "on the markers"
    elif detector == OWN:
        offsets = "next to the markers, as stated in the skeleton's or the subject's file"
    if solution.shape is None:
        yield f"Keypoints are assumed to lie {offsets}."
    else:
        yield f"The offsets of keypoints from the markers are estimated; keypoints are expected to lie {offsets}."
    source = f"as in the motions to which the prior {file_name(solution.prior)} was fitted"
    if solution.prior == NO_PRIOR:
        source = "as stated in the skeleton file, with independent angles"
    yield f"Poses and their changes are expected to be {source}."
    yield from assumption_sentences(motion)
    if any(segment.ground is not None for segment in solution.segments):
        yield "The ground is a plane, and a standing foot does not move on it."
    if len(solution.segments) > 1:
        yield (
            f"The clip has {len(solution.segments)} segments, separated by long gaps. Each segment was solved "
            "separately and has its own ground."
        )
    if motion.settings.get("fast"):
        yield "The fast search was used, with fewer initial headings and looser tolerances."
