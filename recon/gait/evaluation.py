"""Compare a reconstruction with ground truth by MPJPE and related errors.

Positions are arrays (T, J, 3) in metres, NaN where missing. A joint counts in the frames in which both the
reconstruction and the truth have it. Centring, scaling and rotating use only these common joints.

Every mean is first taken within a frame and then over frames, so that all frames have equal weight for any number of
known joints.

The errors of a fit differ from frame to frame. If a single transform of the whole clip removes most of the error, the
axes, the units or the names of the two files probably differ (`mismatches`).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from recon.animal.body import opposites
from recon.animal.naming import fitting_maps, load_names, new_names
from recon.base.arrays import Array, Brief, mean_along, to_plain
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.files import MANIFEST
from recon.check.codes import finding, sentence
from recon.check.verdict import usable
from recon.clip import frame_ranges
from recon.fit.motion import Motion
from recon.fit.motion_forms import MOTION
from recon.fit.regions import radius
from recon.fit.result import Finding, Verdict
from recon.io.common import Pose3D
from recon.io.positions import read_pose3d

PCK_THRESHOLDS_M = (0.05, 0.1, 0.15)
"""Thresholds of the percentage of correct keypoints (PCK) for large animals, metres."""
PCK_LARGEST = 1 / 3
"""Upper limit of the PCK thresholds, as a fraction of the animal's extent.

`PCK_THRESHOLDS_M` are divided by ten until all are below this limit, because a whole mouse is smaller than 0.15 m.
"""
SAME_RATE = 2e-3
"""Maximum relative difference of two frame rates that count as equal, such as 29.97 and 30."""
WHOLE_FRAME = 1e-4
"""Maximum difference, in frames, between a time and a frame's time that count as equal."""
POSE3D, TRIANGULATED = "pose3d.csv", "triangulation.json"
"""Names of the files with positions and with a summary that `recon triangulate` writes."""
_TURNED = (
    "The fit turned the world of the camera file until the ground under the feet was level. If the reference has the "
    "axes of the camera file, all positions differ by this rotation: compare PA, or fit again with --set up."
)
LEVELS = (0.5, 0.9)
"""Probabilities of the stated intervals whose coverage is evaluated."""


@dataclass(frozen=True, eq=False, repr=False)
class _Score(Brief):
    """Values of one metric; NaN if nothing could be scored."""

    mean: float
    """Mean of `per_frame` over the frames."""
    per_frame: np.ndarray
    """Mean of the metric over the joints, for each frame, shape (T,)."""
    per_joint: np.ndarray
    """Mean of the metric over the frames, for each joint, shape (J,)."""


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation(Brief):
    """Comparison of a reconstruction with the ground truth, over T common frames and J common joints.

    Frame ranges are half-open.
    """

    pose: str
    """Path of the reconstruction's file."""
    truth: str
    """Path of the ground truth's file."""
    names: tuple[str, ...]
    frames: np.ndarray
    mpjpe_m: _Score
    """Mean per-joint position error after both poses of a frame are centred on the mean of their common joints."""
    mpe_m: _Score
    """Mean position error without centring."""
    scale_mpjpe_m: _Score
    """Mean per-joint position error after centring and scaling the pose of each frame."""
    pa_mpjpe_m: _Score
    """Mean per-joint position error after the best similarity transform of each frame (Procrustes analysis)."""
    position_m: float
    """Distance between the mean of the joints in the pose and in the ground truth, averaged over the frames."""
    pck: tuple[tuple[float, _Score], ...]
    """PCK thresholds (m), each with the fraction of centred errors that do not exceed it."""
    inside: dict[str, tuple[float, ...]]
    """Fraction of the true coordinates within the stated intervals of each probability in `LEVELS`.

    The keys are "place" for positions, and "pose" for positions after centring. The dictionary is empty if no intervals
    are stated.
    """
    frames_not_scored: int
    frames_without_pa: int
    joints_only_in_pose: tuple[str, ...]
    joints_only_in_truth: tuple[str, ...]
    frames_only_in_pose: tuple[tuple[int, int], ...]
    frames_only_in_truth: tuple[tuple[int, int], ...]
    notes: tuple[str, ...]
    """Probable causes of the error, if a transform of the whole clip or an exchange of names removes most of it."""
    verdict: Verdict | None = None
    """Verdict on the clip; None if a single file is evaluated, not a results folder."""

    def to_dict(self) -> dict[str, Any]:
        """Return the evaluation as a dictionary of plain JSON types.

        Values whose keys end in `_mm` are in millimetres, PCK values are fractions, and NaN becomes None.
        """
        result = {
            name: value for name, value in vars(self).items() if not isinstance(value, _Score) and name != "names"
        }
        result |= {"joints": self.names, "verdict": None if self.verdict is None else asdict(self.verdict)}

        def by_joint(values: np.ndarray) -> dict[str, float]:
            return dict(zip(self.names, values.tolist(), strict=True))

        scores = {
            "mpjpe": self.mpjpe_m,
            "mpe": self.mpe_m,
            "scale_mpjpe": self.scale_mpjpe_m,
            "pa_mpjpe": self.pa_mpjpe_m,
        }
        for name, mean_error in scores.items():
            result |= {f"{name}_mm": 1e3 * mean_error.mean, f"{name}_per_frame_mm": 1e3 * mean_error.per_frame}
            result[f"{name}_per_joint_mm"] = by_joint(1e3 * mean_error.per_joint)
        result["pck"] = [
            {"threshold_mm": 1e3 * t, "mean": s.mean, "per_joint": by_joint(s.per_joint), "per_frame": s.per_frame}
            for t, s in self.pck
        ]
        result["inside"] = {
            interval: [{"level": level, "share": fraction} for level, fraction in zip(LEVELS, shares, strict=True)]
            for interval, shares in self.inside.items()
        }
        return to_plain(result, digits=17)


def evaluate_files(
    pose_path: str | Path,
    truth_path: str | Path,
    anyway: bool = True,
    unit: str | None = None,
    up: str | None = None,
    rename: str | None = None,
) -> Evaluation:
    """Compare a file of 3D positions with a reference.

    Parameters
    ----------
    pose_path, truth_path : path
        The evaluated positions and the reference, in a format that `read_pose3d` reads. Either can be a results folder
        of `recon fit`, whose intervals are then compared with the errors.
    anyway : bool
        Accept results whose verdict is "do not use".
    unit, up : str, optional
        Unit and upward axis of the reference, if its file does not state them.
    rename : str, optional
        Name map for the joints of the evaluated file, or of the reference if a results folder is evaluated.

    Raises
    ------
    InputError
        If a file cannot be read, or if the two files have no joint, no time or no known position in common.
    """
    pose_path, truth_path = Path(pose_path), Path(truth_path)
    (pose, sigmas_m, verdict), (truth, *_) = collect_problems(
        lambda: _positions(pose_path, anyway), lambda: _positions(truth_path, anyway, unit, up)
    )
    if rename is not None:
        pose, truth = (pose, _renamed(truth, rename)) if pose_path.is_dir() else (_renamed(pose, rename), truth)
    truth = at_frames_of(truth, pose)
    result = replace(evaluate(pose, truth, sigmas_m), verdict=verdict)
    notes = *pose.notes, *truth.notes, *result.notes, *_counted_from_one(pose, truth, result)
    common_count, smaller_count = len(result.frames), min(len(pose.frames), len(truth.frames))
    # If only a few frames were labelled, their numbers are a subset of the other file's, which needs no note.
    if common_count <= smaller_count / 2:
        shared = f"only {common_count} of {smaller_count} frame numbers are in both files"
        notes += (f"{shared}: the reference may belong to another run",)
    notes += () if rename else tuple(_other_names(pose, truth, result))
    if _is_result(truth_path) and not _is_result(pose_path):
        notes += (
            f"the reference ({truth_path}) is a result of recon fit, but the other file is not: are they exchanged?",
        )
    return replace(result, notes=tuple(dict.fromkeys(notes)))


def at_frames_of(truth: Pose3D, pose: Pose3D) -> Pose3D:
    """Return a reference, interpolated at the times of a pose's frames if the frame rates differ.

    Frame 0 of both is at 0 s. In a reference that counts frames from 1, as TRC files do, frame 1 is at 0 s. An
    interpolated position is unknown if one of its neighbours is unknown.

    Raises
    ------
    InputError
        If the two files have no time in common.
    """
    if pose.fps is None or truth.fps is None or abs(pose.fps / truth.fps - 1) <= SAME_RATE:
        return truth
    start = 1 if len(truth.frames) and truth.frames[0] == 1 and not (len(pose.frames) and pose.frames[0] == 1) else 0
    position = pose.frames / pose.fps * truth.fps + start
    whole = np.where(np.abs(position - np.rint(position)) < WHOLE_FRAME, np.rint(position), np.floor(position))
    fraction = np.where(whole == np.rint(position), np.maximum(position - whole, 0), position - whole)
    fraction = np.where(fraction < WHOLE_FRAME, 0.0, fraction)
    row_of = {int(frame): row for row, frame in enumerate(truth.frames)}
    first = np.array([row_of.get(int(frame), -1) for frame in whole])
    second = np.array([row_of.get(int(frame), -1) for frame in whole + (fraction > 0)])
    inside = (first >= 0) & (second >= 0)
    rates = f"{truth.fps:g} frames per second, and {pose.fps:g} in {pose.source}"
    if not inside.any():
        raise InputError(Problem(str(truth.source), "fps", f"{rates}, but no common time", "common times"))
    weight = fraction[inside, None, None]
    start_m, end_m = truth.xyz_m[first[inside]], truth.xyz_m[second[inside]]
    xyz_m = np.where(weight > 0, start_m + weight * (end_m - start_m), start_m)
    note = f"The reference has {rates}. Positions are compared at equal times, with "
    note += "frame 0 of both at 0 s." if not start else "frame 1 of the reference at the time of frame 0."
    return replace(
        truth,
        xyz_m=xyz_m,
        frames=pose.frames[inside],
        fps=pose.fps,
        sigma_m=None,
        flags=None,
        notes=(*truth.notes, note),
    )


def _is_result(path: Path) -> bool:
    return path.is_dir() or (path.parent / MANIFEST).is_file()


def _renamed(pose: Pose3D, rename: str) -> Pose3D:
    keep, names, note = new_names(pose.names, load_names(rename), str(pose.source))
    return Pose3D(names, pose.xyz_m[:, keep], pose.frames, pose.source, pose.fps, notes=(*pose.notes, note))


def _other_names(pose: Pose3D, truth: Pose3D, result: Evaluation) -> Iterator[str]:
    """Yield a note if the two files have more joints in common after applying one of the built-in name maps."""
    for name in fitting_maps(pose.names, truth.names)[:1]:
        count = len({*_renamed(pose, name).names} & {*truth.names})
        yield f"--rename {name} would give {count} joints in common instead of {len(result.names)}."


def _counted_from_one(pose: Pose3D, truth: Pose3D, result: Evaluation) -> Iterator[str]:
    """Yield a note if one file counts frames from 1, as TRC files do, and the other from 0.

    The note is given only if the positions agree better after shifting the frame numbers by one.
    """
    first_frames = int(pose.frames[0]), int(truth.frames[0])
    if sorted(first_frames) != [0, 1]:
        return
    renumbered = evaluate(pose, replace(truth, frames=truth.frames + first_frames[0] - first_frames[1]))
    if renumbered.mpe_m.mean < result.mpe_m.mean:
        shifted, unshifted = ("the reconstruction", "the reference")[:: 1 if first_frames[0] else -1]
        yield (
            f"{shifted} counts frames from 1, {unshifted} from 0: with equal frame numbers the MPE is "
            f"{1000 * renumbered.mpe_m.mean:.1f} mm instead of {1000 * result.mpe_m.mean:.1f} mm; "
            "give both the same frame numbers"
        )


def _positions(
    path: Path, anyway: bool, unit: str | None = None, up: str | None = None
) -> tuple[Pose3D, tuple[np.ndarray, np.ndarray] | None, Verdict | None]:
    """Return the positions in a file or a results folder, their standard deviations and the verdict.

    There are two arrays of standard deviations (T, J, 3), metres: for the positions, and for the positions relative to
    the mean of all joints. A file has neither standard deviations nor a verdict, which are then None.
    """
    if not path.is_dir():
        return read_pose3d(path, unit=unit, up=up), None, None
    if unit is not None or up is not None:
        raise InputError(Problem(path, "unit, up", "results of recon fit, which state both", "no --unit and no --up"))
    if (path / TRIANGULATED).is_file() and not (path / MOTION).exists():
        return read_pose3d(path / POSE3D), None, None
    motion = usable(Motion.load(path), path, anyway)
    notes = (_TURNED,) if "up_from_feet" in {entry.code for entry in motion.findings} else ()
    pose = Pose3D(motion.names, motion.joints_m, motion.frames, str(path), motion.fps, notes=notes)
    return pose, (motion.joint_sigma_m, motion.relative_sigma_m), motion.verdict


def evaluate(pose: Pose3D, truth: Pose3D, sigmas_m: tuple[np.ndarray, np.ndarray] | None = None) -> Evaluation:
    """Return the errors of a reconstruction, compared with the ground truth.

    Joints are matched by their names, and frames by their numbers. The result lists the joints and
    frames that only one of the two has.

    Parameters
    ----------
    pose, truth : Pose3D
        The reconstruction and the ground truth, in metres.
    sigmas_m : tuple of ndarray, optional
        Standard deviations of the pose's positions and of the positions relative to the mean of all joints, metres,
        shape (T, J, 3) each.

    Raises
    ------
    InputError
        If the two have no joint, no frame, or no known position in common.
    """
    names = tuple(name for name in pose.names if name in truth.names)
    frames, in_pose, in_truth = np.intersect1d(pose.frames, truth.frames, assume_unique=True, return_indices=True)
    joint_rows = [pose.names.index(name) for name in names]
    pose_m = pose.xyz_m[in_pose][:, joint_rows]
    truth_m = truth.xyz_m[in_truth][:, [truth.names.index(name) for name in names]]
    common = common_joints(pose_m, truth_m)
    pose_name, truth_name = str(pose.source or "pose"), str(truth.source or "truth")
    raise_problems(_nothing_in_common(pose, truth, names, frames, common))
    centred, share_inside = aligned(pose_m, truth_m), {}
    thresholds_m = _thresholds_m(np.where(common[..., None], truth_m, np.nan)[common.any(axis=1)])
    if sigmas_m is not None:
        position_sigma_m, relative_m = (sigma_m[in_pose][:, joint_rows] for sigma_m in sigmas_m)
        share_inside = {
            "place": _inside(pose_m - truth_m, position_sigma_m),
            "pose": _inside(centred - truth_m, relative_m),
        }
    centred_m = joint_errors(centred, truth_m)
    similar_m = joint_errors(aligned(pose_m, truth_m, scale=True, turn=True), truth_m)
    return Evaluation(
        pose=pose_name,
        truth=truth_name,
        names=names,
        frames=frames,
        mpjpe_m=score(centred_m),
        mpe_m=score(joint_errors(pose_m, truth_m)),
        scale_mpjpe_m=score(joint_errors(aligned(pose_m, truth_m, scale=True), truth_m)),
        pa_mpjpe_m=score(similar_m),
        position_m=float(mean_along(mean_along(np.linalg.norm(pose_m - centred, axis=2), 1), 0)),
        pck=tuple(
            (threshold_m, score(np.where(np.isnan(centred_m), np.nan, centred_m <= threshold_m)))
            for threshold_m in thresholds_m
        ),
        inside=share_inside,
        frames_not_scored=int((~common.any(axis=1)).sum()),
        frames_without_pa=int(np.isnan(similar_m).all(axis=1).sum()),
        joints_only_in_pose=tuple(name for name in pose.names if name not in names),
        joints_only_in_truth=tuple(name for name in truth.names if name not in names),
        frames_only_in_pose=frame_ranges(np.setdiff1d(pose.frames, frames)),
        frames_only_in_truth=frame_ranges(np.setdiff1d(truth.frames, frames)),
        notes=tuple(map(sentence, mismatches(pose_m, truth_m, names))),
    )


def _nothing_in_common(
    pose: Pose3D, truth: Pose3D, names: Sequence[str], frames: np.ndarray, common: np.ndarray
) -> list[Problem]:
    """Return the problems with two poses that have no joint, no frame or no known position in common.

    `names` and `frames` are those that both poses have. `common` (T, J) is a mask of the positions known in both.
    """
    pose_name, truth_name = str(pose.source or "pose"), str(truth.source or "truth")
    problems = []
    if not names:
        examples = " and ".join(", ".join(p.names[:5]) for p in (pose, truth))
        problems.append(Problem(pose_name, "joints", f"no common joint ({examples})", f"joints of {truth_name}"))
    if not len(frames):
        examples = " and ".join(f"{p.frames[0]} to {p.frames[-1]}" if len(p.frames) else "none" for p in (pose, truth))
        problems.append(Problem(pose_name, "frames", f"no common frame ({examples})", f"frames of {truth_name}"))
    if not problems and not common.any():
        expected = "a joint that both files know in the same frame"
        problems.append(Problem(pose_name, "positions", "no joint known in both files in any frame", expected))
    return problems


def _thresholds_m(truth_m: np.ndarray) -> tuple[float, ...]:
    """Return the PCK thresholds in metres for an animal with the joints (T, J, 3), m, from its median extent."""
    size_m = float(np.median(np.linalg.norm(np.nanmax(truth_m, axis=1) - np.nanmin(truth_m, axis=1), axis=1)))
    # A single joint has no extent.
    tens = np.ceil(np.log10(PCK_THRESHOLDS_M[-1] / (PCK_LARGEST * size_m))) if size_m else 0.0
    return tuple(float(threshold_m / 10.0 ** max(tens, 0.0)) for threshold_m in PCK_THRESHOLDS_M)


def _inside(error_m: np.ndarray, sigma_m: np.ndarray) -> tuple[float, ...]:
    """Return the fraction of errors (T, J, 3) within the intervals of each probability in `LEVELS`.

    The fractions are NaN if no coordinate has an interval.
    """
    relative_error = (np.abs(error_m) / sigma_m)[np.isfinite(error_m) & (sigma_m > 0)]
    return tuple(float(np.mean(relative_error < radius(level))) if len(relative_error) else np.nan for level in LEVELS)


def common_joints(pose_m: np.ndarray, truth_m: np.ndarray) -> np.ndarray:
    """Return a mask (T, J) of the joints whose three coordinates are known in both poses (T, J, 3)."""
    return np.all(~np.isnan(pose_m + truth_m), axis=2)


def joint_errors(pose_m: np.ndarray, truth_m: np.ndarray) -> np.ndarray:
    """Return the distances (T, J) between the joints of two poses (T, J, 3), metres; NaN if either is missing."""
    return np.linalg.norm(pose_m - truth_m, axis=2)


def score(values: np.ndarray) -> _Score:
    """Return the means of the values (T, J) of a metric over joints and over frames, ignoring NaN."""
    per_frame = mean_along(values, axis=1)
    return _Score(mean=float(mean_along(per_frame, axis=0)), per_frame=per_frame, per_joint=mean_along(values, axis=0))


def aligned(pose_m: np.ndarray, truth_m: np.ndarray, scale: bool = False, turn: bool = False) -> np.ndarray:
    """Return the pose (T, J, 3) after aligning it with the ground truth in each frame by least squares (Umeyama 1991).

    The means of the common joints coincide. If `scale` is true, the pose is also scaled by a factor that is not
    negative, since a negative factor would mirror the animal. If `turn` is true, the pose is also rotated, without
    reflection. Frames with fewer than 3 common joints are then NaN, since so few joints do not determine a rotation.
    """
    centred, (pose_mean, truth_mean) = _together(pose_m, truth_m)
    aligned_m, (pose_part, truth_part) = pose_m - pose_mean, np.nan_to_num(centred)
    if turn:
        is_enough = np.isfinite(centred[0]).all(axis=2).sum(axis=1)[:, None, None] >= 3
        u, _, vt = np.linalg.svd(np.swapaxes(pose_part, 1, 2) @ truth_part)
        vt[:, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]  # flip the least certain axis to avoid a reflection
        aligned_m, pose_part = (part @ (u @ vt) for part in (np.where(is_enough, aligned_m, np.nan), pose_part))
    if scale:
        product, square = (np.sum(pose_part * part, axis=(1, 2)) for part in (truth_part, pose_part))
        # If all joints coincide, every factor is equally good.
        factor = np.divide(np.maximum(product, 0), square, out=np.ones_like(square), where=square > 0)
        aligned_m = factor[:, None, None] * aligned_m
    return aligned_m + truth_mean


def _together(pose_m: Array, truth_m: Array) -> tuple[Array, Array]:
    """Return the pose and the ground truth, centred on the mean of their common joints, and these means.

    The arrays have the shapes (2, T, J, 3) and (2, T, 1, 3). Joints that are missing in either are NaN.
    """
    common = np.where(common_joints(pose_m, truth_m)[..., None], np.stack([pose_m, truth_m]), np.nan)
    means = mean_along(common, axis=2)[:, :, None]
    return common - means, means


MAX_REMAINING_FRACTION = 1 / 3
"""Largest fraction of the error that may remain if a transform is reported as the cause of the error."""
SMALL_ERROR = 0.05
"""Minimum error, as a fraction of the animal's size, for which an explanation is reported.

The animal's size is the root mean square distance of the joints from their mean.
"""
MAX_SIZE_RATIO = 2.0
"""Minimum ratio of the animal's sizes in the two files for which different units are reported as the cause.

A single camera hardly determines the size, so smaller ratios can have other causes.
"""
OTHER_CLIP_ERROR = 0.3
"""Maximum error, as a fraction of the animal's size, if the motion and the ground truth show the same clip.

Different clips of animals with the same gait may differ by little more than a poor fit differs from the ground truth.
"""
OTHER_ORIGIN_DISTANCE = 4.0
"""Maximum distance between motion and ground truth with the same origin, as a multiple of the animal's size."""


def mismatches(pose_m: Array, truth_m: Array, names: Sequence[str]) -> tuple[Finding, ...]:
    """Return a finding if the axes, units, names or clips of a motion and its ground truth probably differ.

    `pose_m` and `truth_m` are positions (T, J, 3), metres, NaN where missing.
    """
    rows = np.isfinite(pose_m + truth_m).all(axis=2).sum(axis=1) >= 3
    pose_m, truth_m = pose_m[rows], truth_m[rows]
    if not rows.any():
        return ()
    pose, truth = _together(pose_m, truth_m)[0]
    size = float(np.sqrt(np.nanmean(np.sum(truth**2, axis=2))))
    error = _error(pose, truth)
    explanation, error_left = None, error
    for code, remaining, numbers in _explanations(pose_m, truth_m, names):
        if error_left > SMALL_ERROR * size and remaining <= MAX_REMAINING_FRACTION * error_left:
            explanation = finding(code, error_mm=1000 * error, left_mm=1000 * remaining, **numbers)
            error_left = remaining
    if error_left > OTHER_CLIP_ERROR * size:  # the clips differ, even if a transform removes part of the error
        error_left = min(error_left, _error(_turned(pose, truth)[0], truth))
    if error_left > OTHER_CLIP_ERROR * size:
        return (finding("reference_unlike", left_mm=1000 * error_left, share=error_left / size),)
    if explanation is not None:
        return (explanation,)
    offset_m = np.nanmean(pose_m - truth_m, axis=1)
    median_offset_m = np.median(offset_m, axis=0)
    distance, spread_m = (float(np.linalg.norm(x, axis=1).mean()) for x in (offset_m, offset_m - median_offset_m))
    if distance > OTHER_ORIGIN_DISTANCE * size and spread_m <= MAX_REMAINING_FRACTION * distance:
        x, y, z = median_offset_m.tolist()
        return (finding("reference_elsewhere", x_m=x, y_m=y, z_m=z),)
    return ()


def _explanations(pose_m: Array, truth_m: Array, names: Sequence[str]) -> Iterator[tuple[str, float, dict[str, Any]]]:
    """Yield possible causes of the error, the simplest first.

    A cause is the code of a finding, the error, m, that remains after correcting the cause and after the best rotation
    of the whole clip, and the numbers of the finding.
    """
    (pose, truth), sides = _together(pose_m, truth_m)[0], opposites(names)
    candidates = [("reference_rotated", pose, truth)]
    if (sides != np.arange(len(names))).any():
        candidates.append(("reference_swapped", *_together(pose_m[:, sides], truth_m)[0]))
    candidates.append(("reference_mirrored", pose * (1.0, -1.0, 1.0), truth))
    for code, candidate, reference in candidates:
        turned, turn_rad = _turned(candidate, reference)
        yield code, _error(turned, reference), {"turn_rad": turn_rad}
    turned, turn_rad = _turned(pose, truth)
    factor = float(np.nansum(turned * truth) / max(np.nansum(turned**2), 1e-300))
    if not 1 / MAX_SIZE_RATIO < factor < MAX_SIZE_RATIO:
        yield "reference_scaled", _error(factor * turned, truth), {"factor": factor, "turn_rad": turn_rad}


def _error(pose: Array, truth: Array) -> float:
    return score(joint_errors(pose, truth)).mean


def _turned(pose: Array, truth: Array) -> tuple[Array, float]:
    """Return the pose rotated to fit the ground truth best, and the angle of this rotation, rad.

    Both poses have the shape (..., 3). One rotation is used for all frames.
    """
    is_known = np.isfinite(pose[..., 0])
    if not is_known.any():
        return pose, 0.0
    with warnings.catch_warnings(action="ignore"):  # points on a line fit several rotations equally well
        turn, _ = Rotation.align_vectors(truth[is_known], pose[is_known])
    return pose @ turn.as_matrix().T, float(turn.magnitude())
