"""The report of the trajectory method."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from recon.animal.detector import NONE as NO_DETECTOR
from recon.animal.detector import OWN
from recon.animal.prior import NONE
from recon.base.arrays import Array, finite, mean, median
from recon.check import FLAGS
from recon.clip.keypoints import frame_ranges
from recon.fit import TrajectoryOptions
from recon.fit.motion import Motion
from recon.fit.result import Spell, TrajectorySolution
from recon.fit.results import MEASURED_SHARE
from recon.fit.surprise import LEVEL
from recon.fit.trajectory import ALTERNATIVE_M
from recon.gait.path import MIN_POINTS
from recon.show.report import cameras, common
from recon.show.report.plain import by_name, file_name, frame_count, number

STANCE = 0.5
"""A foot with more contact than this stands."""
HARDLY_TOLD = 0.1
"""Standard deviation of the distance, relative to it, from which the summary begins with it."""
UNLIKE = "motion_unlike_prior"
"""The code of a motion that the prior does not know."""
SAID_BY = {"views": "where the cameras are", "ground": "the camera's height above the ground"}
"""What else than the expectation says the size."""


def sections(motion: Motion, settings: Mapping[str, Any]) -> dict[str, Any]:
    solution = _solution(motion)
    size, spells = _size(solution), _spells(motion)
    return {
        **common.head(motion),
        "skeleton": common.skeleton(motion),
        "assumptions": _assumptions(motion, settings, size),
        "summary": _summary(motion),
        "convergence": _convergence(solution),
        "solver": common.solver(
            common.given_options(TrajectoryOptions, settings),
            keypoint_sigma_m=motion.body.keypoint_sigma_m,
            size_sigma=motion.body.size_sigma,
        ),
        "size": size,
        "ground": next((spell["ground"] for spell in spells if spell["ground"] is not None), None),
        "spells": spells,
        "prior": _prior(motion),
        "detector": file_name(motion.body.detector) or NO_DETECTOR,
        "alternative": _alternative(solution),
        "stances": by_name([motion.names[foot] for foot in motion.feet], _stances(motion)),
        "heading": _heading(motion),
        "uncertainty": _uncertainty(motion),
        "angles": common.angles(motion),
        "frames": _frames(motion),
        **_tail(motion),
    }


def is_unsolved(report: Mapping[str, Any]) -> bool:
    return report["summary"]["frames_with_pose"] == 0


def _solution(motion: Motion) -> TrajectorySolution:
    assert isinstance(motion.solution, TrajectorySolution)
    return motion.solution


# -- sections -----------------------------------------------------------------------------------------------------


def _size(solution: TrajectorySolution) -> dict[str, Any]:
    """The factor on the skeleton's lengths: what was expected, and what came out."""
    prior_sigma, subject = solution.size_prior_sigma, solution.body.subject
    return {
        "factor": solution.size,
        "sigma": solution.size_sigma,
        "prior_sigma": prior_sigma,
        "data_share": max(0.0, 1.0 - (solution.size_sigma / prior_sigma) ** 2),
        "from": solution.size_from,
        "subject": file_name(subject),
        "lengths": solution.body.title,
        "measured": subject is not None,
    }


def _assumptions(motion: Motion, settings: Mapping[str, Any], size: Mapping[str, Any]) -> dict[str, Any]:
    """What the data does not say, in numbers and in sentences."""
    solution = _solution(motion)
    of_animal = "measured on this animal" if size["measured"] else "not measured on this one"
    sentences = [
        f"The proportions are those of {size['lengths']!r}, {of_animal}. How large the animal is, a factor on all its "
        f"lengths, distances and speeds, is expected to be 1 with a standard deviation of {size['prior_sigma']:.2g}; "
        f"{_size_told(size)}.",
        f"Keypoints are taken to lie {_keypoints_lie(file_name(motion.body.detector))}.",
        "Poses and their changes are expected to be "
        + (
            "as the skeleton's file says, each angle on its own."
            if solution.prior == NONE
            else f"as in the motions that the prior {file_name(solution.prior)} was made from."
        ),
        *common.sentences(motion, settings),
    ]
    if any(spell.ground is not None for spell in solution.spells):
        sentences.append("The ground is a plane, and feet that stand stand still on it.")
    if len(solution.spells) > 1:
        sentences.append(
            f"The clip has {len(solution.spells)} spells, between which nothing was seen for long: each was solved by "
            "itself, with a ground of its own."
        )
    if settings.get("fast"):
        sentences.append("The fast search was asked for: fewer headings to start from, and looser tolerances.")
    return {**common.upright(motion), "sentences": sentences}


def _keypoints_lie(detector: str | None) -> str:
    if detector in (None, NO_DETECTOR):
        return "on the markers"
    if detector == OWN:
        return "beside the markers as the skeleton's or the subject's file says"
    return f"beside the markers as those of the detector {detector}"


def _summary(motion: Motion) -> dict[str, Any]:
    solution = motion.solution
    return {
        "frames": len(motion.frames),
        "frames_with_pose": int(motion.solved.sum()),
        "frames_flagged": sum(bool(flags) for flags in solution.flags),
        "flags": {flag: sum(flag in flags for flags in solution.flags) for flag in _flag_names(motion)},
        **common.counts(motion),
        "mean_weight": mean(solution.weight),
        "place_sigma_m": median(motion.place_sigma_m),
        "relative_rms_m": median(motion.relative_rms_m),
    }


def _flag_names(motion: Motion) -> tuple[str, ...]:
    return tuple(dict.fromkeys((*FLAGS, *(flag for flags in motion.solution.flags for flag in flags))))


def _convergence(solution: TrajectorySolution) -> dict[str, Any]:
    return {
        "status": solution.status,
        "iterations": solution.iterations,
        "cost_by_term": solution.cost_by_term,
        "starts": [
            {
                "heading_rad": float(np.angle(np.exp(1j * start.heading_rad))),
                "heading_to_picture_rad": math.asin(math.sin(start.heading_rad)),
                "cost": start.cost,
                "kept": start.kept,
            }
            for start in solution.starts
        ],
    }


def _spells(motion: Motion) -> list[dict[str, Any]]:
    return [
        {
            "frames": (motion.frames[spell.rows.start], motion.frames[spell.rows.stop - 1] + 1),
            "ground": _ground(motion, spell),
            "prior_weight": spell.prior_weight,
        }
        for spell in motion.solution.spells
    ]


def _ground(motion: Motion, spell: Spell) -> dict[str, Any] | None:
    """Below the middle of the root's path in the spell."""
    ground, below = spell.ground, motion.below_m(spell)
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


def _prior(motion: Motion) -> dict[str, Any]:
    """The surprise and the weight are those of the spell that the prior fits least."""
    solution = _solution(motion)
    surprises = [spell.surprise for spell in solution.spells if spell.surprise is not None]
    weight = min((spell.prior_weight for spell in solution.spells), default=1.0)
    return {
        "name": file_name(solution.prior),
        "mean_data_share": mean(solution.data_share),
        "data_share": by_name(motion.names, list(solution.data_share)),
        "surprise": max(surprises, default=None),
        "weight": weight,
        "code": UNLIKE if any(spell.unlike_prior for spell in solution.spells) else None,
    }


def _alternative(solution: TrajectorySolution) -> dict[str, Any] | None:
    apart = finite(solution.alternative_m)
    if not len(apart):
        return None
    return {
        "cost_difference": solution.alternative_cost,
        "frames": len(apart),
        "mean_m": apart.mean(),
        "max_m": apart.max(),
    }


def _stances(motion: Motion) -> list[list[tuple[int, int]]]:
    """By foot: the ranges of frame numbers in which it stands."""
    return [[*frame_ranges(motion.frames[contact > STANCE])] for contact in motion.solution.contact.T]


def _heading(motion: Motion) -> dict[str, Any]:
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
        "heading_camera": (R @ level[..., None])[..., 0],
        "crab_rad": solution.crab_rad if solution.crab_sigma_rad else None,
        "crab_sigma_rad": solution.crab_sigma_rad or None,
    }


def _uncertainty(motion: Motion) -> dict[str, Any]:
    """Medians over the frames."""

    def medians(values: Array) -> dict[str, Any]:
        return by_name(motion.names, [[median(column) for column in joint.T] for joint in values.swapaxes(0, 1)])

    return {"joint_sigma_m": medians(motion.joint_sigma_m), "relative_sigma_m": medians(motion.relative_sigma_m)}


def _frames(motion: Motion) -> list[dict[str, Any]]:
    solution, distance_px = motion.solution, cameras.stacked(motion, "distance_px")
    return [
        {
            "frame": motion.frames[t],
            "flags": flags,
            "detections": motion.detections[t],
            "mean_reprojection_px": mean(distance_px[:, t]),
            "mean_weight": motion.mean_weight[t],
            "alternative_m": solution.alternative_m[t],
            "place_sigma_m": motion.place_sigma_m[t],
            "relative_rms_m": motion.relative_rms_m[t],
            "contact": solution.contact[t],
        }
        for t, flags in enumerate(solution.flags)
    ]


def _tail(motion: Motion) -> dict[str, Any]:
    tail = common.tail(motion)
    for row in tail["keypoints"]:
        column = motion.names.index(row["name"]) if row["joint"] is not None else None
        for field, values in (("noise_px", motion.solution.noise_px), ("mean_weight", motion.solution.weight)):
            row[field] = None if column is None else mean(values[..., column])
    return tail


# -- summing up ---------------------------------------------------------------------------------------------------


def _ambiguous_frames(report: Mapping[str, Any]) -> list[dict[str, Any]]:
    """The frames that another solution explains nearly as well."""
    return [
        frame
        for frame in report["frames"]
        if {"ambiguous depth", "second solution"} & {*frame["flags"]}
        and (frame["alternative_m"] or 0.0) > ALTERNATIVE_M
    ]


def lines(report: Mapping[str, Any]) -> common.Lines:
    """For the summary."""
    summary, size = report["summary"], report["size"]
    path = report["root_path"]["exact"]
    return [
        common.clip_line(report),
        *([("side", f"{report['side']['fitted']}: {report['side']['reason']}")] if report["side"]["fitted"] else []),
        ("frames", _frames_text(report)),
        *([("distance", _distance_text(report))] if _hardly_told(report) else []),
        *([("motion", _unlike_text(report))] if report["prior"]["code"] == UNLIKE else []),
        *common.point_lines(report),
        (
            "speed",
            f"{path['mean_speed_m_s']:.1f} m/s mean, {path['peak_speed_m_s']:.1f} m/s peak, over "
            f"{path['distance_m']:.1f} m"
            if path["mean_speed_m_s"] is not None
            else f"none from fewer than {MIN_POINTS} frames",
        ),
        ("heading", _heading_text(report)),
        (
            "size",
            f"{size['factor']:.3f} ± {size['sigma']:.3f} of the lengths of {size['lengths']!r} "
            f"({_size_sources(size)}1 ± {size['prior_sigma']:.2g} expected)",
        ),
        (
            "uncertainty",
            f"{number(summary['relative_rms_m'], '.2f')} m of a joint within the pose, "
            f"{number(summary['place_sigma_m'], '.2f')} m of the animal's place in depth (one sigma, median)",
        ),
        (
            "prior",
            f"{_prior_text(report['prior']['name'])}; {number(report['prior']['mean_data_share'], '.0%')} of the "
            "joints' precision from pixels",
        ),
        ("ground", _ground_text(report)),
        ("alternative", _alternative_text(report)),
        ("effort", _effort_text(report)),
    ]


def _frames_text(report: Mapping[str, Any]) -> str:
    summary = report["summary"]
    why = [f"{count} {flag}" for flag, count in summary["flags"].items() if count]
    flagged = f"{summary['frames_flagged']} doubtful ({', '.join(why)})" if why else "none doubtful"
    return f"{summary['frames_with_pose']} of {summary['frames']} with a pose, {flagged}"


def _heading_text(report: Mapping[str, Any]) -> str:
    text = common.heading_text(report["heading"]["heading_to_picture_rad"])
    return text if len(report["cameras"]) == 1 else f"{text}, as {_first(report)} sees it"


def _hardly_told(report: Mapping[str, Any]) -> bool:
    """Whether the distance from the nearest camera is."""
    sigma_m, nearest = report["summary"]["place_sigma_m"], _nearest(report)
    return sigma_m is not None and nearest is not None and sigma_m > HARDLY_TOLD * nearest[0]


def _nearest(report: Mapping[str, Any]) -> tuple[float, str] | None:
    """The nearest camera's distance, and how it is called."""
    known = [one for one in report["cameras"] if one["distance_m"] is not None]
    return min(((one["distance_m"], cameras.called(one["name"], report)) for one in known), default=None)


def _distance_text(report: Mapping[str, Any]) -> str:
    sigma_m, size = report["summary"]["place_sigma_m"], report["size"]
    why = "the size is not known better" if size["sigma"] > HARDLY_TOLD / 2 else "these pictures hardly tell it"
    away_m, camera = _nearest(report) or (math.nan, "")
    return f"{away_m:.1f} ± {sigma_m:.1f} m from {camera}: {why}"


def _size_sources(size: Mapping[str, Any]) -> str:
    measured = [f"the {what}" for what in _telling(size)]
    return f"from {' and '.join(measured)}; " if measured else ""


def _size_told(size: Mapping[str, Any]) -> str:
    """Whether this clip says it."""
    telling = [SAID_BY[what] for what in _telling(size)]
    if not telling:
        return "this clip hardly says it"
    return f"by {' and '.join(telling)} it is {size['factor']:.3f} ± {size['sigma']:.3f}"


def _telling(size: Mapping[str, Any]) -> list[str]:
    """Of `SAID_BY`, where they say more than the expectation; the ground often says a little only."""
    return [what for what in size["from"] if what in SAID_BY and size["data_share"] >= MEASURED_SHARE]


def _prior_text(name: str) -> str:
    return "none, the skeleton's own expectations" if name == NONE else name


def _unlike_text(report: Mapping[str, Any]) -> str:
    prior = report["prior"]
    return (
        f"unlike those that the prior {prior['name']} knows (surprise {prior['surprise']:.1f}, where 1 is "
        f"usual and {LEVEL:g} the limit)"
    )


def _ground_text(report: Mapping[str, Any]) -> str:
    spells = report["spells"]
    if all(spell["ground"] is None for spell in spells):
        return "not looked for" if report["settings"].get("ground") == "none" else "not found"
    stances = ", ".join(f"{foot} {len(ranges)}" for foot, ranges in report["stances"].items())
    found = []
    for (first, stop), ground in ((spell["frames"], spell["ground"]) for spell in spells):
        text = _height_text(ground, _first(report)) if ground else "not found"
        found.append(text if len(spells) == 1 else f"{text} (frames {first} to {stop - 1})")
    return f"{', '.join(found)}; stances: {stances}"


def _first(report: Mapping[str, Any]) -> str:
    """The camera that the heading and the ground are said of."""
    return cameras.called(report["cameras"][0]["name"], report)


def _height_text(ground: Mapping[str, Any], camera: str) -> str:
    height, side = ground["camera_height_m"], "below" if ground["camera_height_m"] > 0 else "above"
    return f"{abs(height):.2f} ± {ground['sigma_m']:.2f} m {side} {camera}"


def _alternative_text(report: Mapping[str, Any]) -> str:
    alternative = report["alternative"]
    if alternative is None:
        return "no other solution nearly as good"
    if not _ambiguous_frames(report):
        return f"another start ended nearby, with joints {alternative['mean_m']:.2f} m away on average"
    return (
        f"joints {alternative['mean_m']:.2f} m away on average in {frame_count(alternative['frames'])}, "
        f"at a cost higher by {number(alternative['cost_difference'], '.1f')}"
    )


def _effort_text(report: Mapping[str, Any]) -> str:
    timing, convergence = report["timing_s"], report["convergence"]
    seconds = timing.get("solve_s", timing.get("all"))
    text = f"{number(seconds, '.1f')} s, {convergence['iterations']} iterations"
    return text if convergence["status"] == "converged" else f"{text}, not converged"
