"""How far a reconstruction lies from the truth: MPJPE and its relatives.

Positions are arrays (T, J, 3) in metres with NaN for missing. A joint counts in the frames where both sides have it;
centring, scaling and rotating use these common joints only.

Every mean is taken over frames of the mean within the frame, so that a frame counts the same however many of its joints
are known.

A fit's errors differ from frame to frame. One motion of the whole clip that takes most of the error away says that the
two stand in different axes, units or names instead (`mismatches`).
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from recon.animal import fitting_maps, load_names, new_names, opposites
from recon.base import Array, Brief, InputError, Problem, collect_problems, mean_along, raise_problems
from recon.base.arrays import to_plain
from recon.base.files import MANIFEST
from recon.check import finding, sentence, usable
from recon.clip import frame_ranges
from recon.fit import Finding, Motion, Verdict, radius
from recon.io import Pose3D, read_pose3d

PCK_THRESHOLDS_M, PCK_LARGEST = (0.05, 0.1, 0.15), 1 / 3
"""They are divided by ten until the largest is at most this part of the animal: a mouse is all within 0.15 m."""
LEVELS = (0.5, 0.9)
"""The levels of the intervals that are compared with the truth."""


@dataclass(frozen=True, eq=False, repr=False)
class _Score(Brief):
    """One metric. NaN where nothing could be scored."""

    mean: float
    """Over the frames of per_frame."""
    per_frame: np.ndarray
    """The error of each of the T frames, shape (T,)."""
    per_joint: np.ndarray
    """(J,), mean over its frames."""


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation(Brief):
    """A reconstruction against the truth, over T common frames and J common joints. Frame ranges are half-open."""

    pose: str
    """What was scored, by its file, and below against what."""
    truth: str
    names: tuple[str, ...]
    frames: np.ndarray
    mpjpe_m: _Score
    """Centred on the mean of the frame's common joints."""
    mpe_m: _Score
    """The error of positions as they are, not centred."""
    scale_mpjpe_m: _Score
    """Centred, with one scale per frame."""
    pa_mpjpe_m: _Score
    """After a similarity (Procrustes) per frame."""
    position_m: float
    """How far the mean of a frame's common joints is off, mean over the frames."""
    pck: tuple[tuple[float, _Score], ...]
    """For each threshold (m), the fraction of centred errors up to it."""
    inside: dict[str, tuple[float, ...]]
    """By each of `LEVELS` the share of the coordinates within the intervals that the reconstruction states for it, as
    "place" and "pose", which is centred; empty where it states none."""
    frames_not_scored: int
    frames_without_pa: int
    joints_only_in_pose: tuple[str, ...]
    joints_only_in_truth: tuple[str, ...]
    frames_only_in_pose: tuple[tuple[int, int], ...]
    frames_only_in_truth: tuple[tuple[int, int], ...]
    notes: tuple[str, ...]
    """What is probably wrong, where one motion of the whole clip, or an exchange of names, takes most of the error
    away."""
    verdict: Verdict | None = None
    """On the clip that is scored, where it is a folder of results."""

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON types: keys that end in `_mm` are millimetres, pck are fractions, NaN is None."""
        result = {
            name: value for name, value in vars(self).items() if not isinstance(value, _Score) and name != "names"
        }
        result |= {"joints": self.names, "verdict": None if self.verdict is None else asdict(self.verdict)}

        def by_joint(values: np.ndarray) -> dict[str, float]:
            return dict(zip(self.names, values.tolist(), strict=True))

        for name in ("mpjpe", "mpe", "scale_mpjpe", "pa_mpjpe"):
            score: _Score = getattr(self, f"{name}_m")
            result |= {f"{name}_mm": 1e3 * score.mean, f"{name}_per_frame_mm": 1e3 * score.per_frame}
            result[f"{name}_per_joint_mm"] = by_joint(1e3 * score.per_joint)
        result["pck"] = [
            {"threshold_mm": 1e3 * t, "mean": s.mean, "per_joint": by_joint(s.per_joint), "per_frame": s.per_frame}
            for t, s in self.pck
        ]
        result["inside"] = {
            what: [{"level": level, "share": share} for level, share in zip(LEVELS, shares, strict=True)]
            for what, shares in self.inside.items()
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
    """Evaluates a file of 3D positions (see `read_pose3d`) against another; either may be the folder of results that
    `recon fit` wrote, whose standard deviations are then compared with the errors. anyway: also results that are not to
    be used; unit, up: of the reference, where its file does not say them (see `read_pose3d`); rename: a map of the
    joints' names, of the file that is scored, or of the reference where a folder of results is. Raises InputError."""
    pose_path, truth_path = Path(pose_path), Path(truth_path)
    (pose, sigmas_m, verdict), (truth, *_) = collect_problems(
        lambda: _positions(pose_path, anyway), lambda: _positions(truth_path, anyway, unit, up)
    )
    if rename is not None:
        pose, truth = (pose, _renamed(truth, rename)) if pose_path.is_dir() else (_renamed(pose, rename), truth)
    found = replace(evaluate(pose, truth, sigmas_m), verdict=verdict)
    notes = *pose.notes, *truth.notes, *found.notes, *_counted_from_one(pose, truth, found)
    both, fewer = len(found.frames), min(len(pose.frames), len(truth.frames))
    if both <= fewer / 2:  # otherwise one side is a part of the other, as where few frames were labelled
        notes += (f"only {both} of {fewer} frame numbers are in both: the reference may be that of another run",)
    notes += () if rename else tuple(_other_names(pose, truth, found))
    if _is_result(truth_path) and not _is_result(pose_path):
        notes += (
            f"the reference, {truth_path}, is a result of recon fit, and what is scored is not: perhaps exchanged",
        )
    return replace(found, notes=tuple(dict.fromkeys(notes)))


def _is_result(path: Path) -> bool:
    return path.is_dir() or (path.parent / MANIFEST).is_file()


def _renamed(pose: Pose3D, rename: str) -> Pose3D:
    keep, names, note = new_names(pose.names, load_names(rename), str(pose.source))
    return Pose3D(names, pose.xyz_m[:, keep], pose.frames, pose.source, pose.fps, notes=(*pose.notes, note))


def _other_names(pose: Pose3D, truth: Pose3D, found: Evaluation) -> Iterator[str]:
    """Where a map that comes with the package gives the two more joints in common."""
    for name in fitting_maps(pose.names, truth.names)[:1]:
        count = len({*_renamed(pose, name).names} & {*truth.names})
        yield f"--rename {name}: {count} joints are in common, not {len(found.names)}."


def _counted_from_one(pose: Pose3D, truth: Pose3D, found: Evaluation) -> Iterator[str]:
    """Where one side counts its frames from 1 and the other from 0, as TRC files of other programs do, and all fits
    better once they are counted alike."""
    first = int(pose.frames[0]), int(truth.frames[0])
    if sorted(first) != [0, 1]:
        return
    moved = evaluate(pose, replace(truth, frames=truth.frames + first[0] - first[1]))
    if moved.mpe_m.mean < found.mpe_m.mean:
        which, other = ("the reconstruction", "the reference")[:: 1 if first[0] else -1]
        yield (
            f"{which} counts frames from 1, {other} from 0: counted alike they are {1000 * moved.mpe_m.mean:.1f} mm "
            f"apart in place of {1000 * found.mpe_m.mean:.1f} mm (MPE); give both the same numbers"
        )


def _positions(
    path: Path, anyway: bool, unit: str | None = None, up: str | None = None
) -> tuple[Pose3D, tuple[np.ndarray, np.ndarray] | None, Verdict | None]:
    """The positions of a file, or of a folder of results in their frame of reference, with standard deviations of the
    positions and of those relative to the mean of all joints, and the verdict on them."""
    if not path.is_dir():
        return read_pose3d(path, unit=unit, up=up), None, None
    if unit is not None or up is not None:
        raise InputError(Problem(path, "unit, up", "results of recon fit, which say both", "no --unit and no --up"))
    motion = usable(Motion.load(path), path, anyway)
    pose = Pose3D(motion.names, motion.joints_m, motion.frames, str(path), motion.fps)
    return pose, (motion.joint_sigma_m, motion.relative_sigma_m), motion.verdict


def evaluate(pose: Pose3D, truth: Pose3D, sigmas_m: tuple[np.ndarray, np.ndarray] | None = None) -> Evaluation:
    """Scores a reconstruction. Joints are matched by name, frames by number; what only one side has is reported.

    sigmas_m: standard deviations of the pose's positions, and of those relative to the mean of all joints.
    Raises InputError if they have no joint, no frame, or no point in common.
    """
    names = tuple(name for name in pose.names if name in truth.names)
    frames, in_pose, in_truth = np.intersect1d(pose.frames, truth.frames, assume_unique=True, return_indices=True)
    where = [pose.names.index(name) for name in names]
    pose_m = pose.xyz_m[in_pose][:, where]
    truth_m = truth.xyz_m[in_truth][:, [truth.names.index(name) for name in names]]
    common = common_joints(pose_m, truth_m)

    here, there = str(pose.source or "pose"), str(truth.source or "truth")
    problems = []
    if not names:
        shown = " and ".join(", ".join(p.names[:5]) for p in (pose, truth))
        problems.append(Problem(here, "joints", f"none in common ({shown})", f"joints that are in {there}"))
    if not len(frames):
        shown = " and ".join(f"{p.frames[0]} to {p.frames[-1]}" if len(p.frames) else "none" for p in (pose, truth))
        problems.append(Problem(here, "frames", f"none in common ({shown})", f"frames that are in {there}"))
    if not problems and not common.any():
        problems.append(Problem(here, "positions", "no joint known on both sides in any frame", "at least one"))
    raise_problems(problems)
    centred, inside = aligned(pose_m, truth_m), {}
    thresholds_m = _thresholds_m(np.where(common[..., None], truth_m, np.nan)[common.any(axis=1)])
    if sigmas_m is not None:
        place_m, relative_m = (sigma_m[in_pose][:, where] for sigma_m in sigmas_m)
        inside = {"place": _inside(pose_m - truth_m, place_m), "pose": _inside(centred - truth_m, relative_m)}
    centred_m = joint_errors(centred, truth_m)
    similar_m = joint_errors(aligned(pose_m, truth_m, scale=True, turn=True), truth_m)
    return Evaluation(
        pose=here,
        truth=there,
        names=names,
        frames=frames,
        mpjpe_m=score(centred_m),
        mpe_m=score(joint_errors(pose_m, truth_m)),
        scale_mpjpe_m=score(joint_errors(aligned(pose_m, truth_m, scale=True), truth_m)),
        pa_mpjpe_m=score(similar_m),
        position_m=float(mean_along(mean_along(np.linalg.norm(pose_m - centred, axis=2), 1), 0)),
        pck=tuple((t, score(np.where(np.isnan(centred_m), np.nan, centred_m <= t))) for t in thresholds_m),
        inside=inside,
        frames_not_scored=int((~common.any(axis=1)).sum()),
        frames_without_pa=int(np.isnan(similar_m).all(axis=1).sum()),
        joints_only_in_pose=tuple(name for name in pose.names if name not in names),
        joints_only_in_truth=tuple(name for name in truth.names if name not in names),
        frames_only_in_pose=frame_ranges(np.setdiff1d(pose.frames, frames)),
        frames_only_in_truth=frame_ranges(np.setdiff1d(truth.frames, frames)),
        notes=tuple(map(sentence, mismatches(pose_m, truth_m, names))),
    )


def _thresholds_m(truth_m: np.ndarray) -> tuple[float, ...]:
    """The thresholds of PCK for an animal as large as joints (T, J, 3) are apart, by the median over the frames."""
    size_m = float(np.median(np.linalg.norm(np.nanmax(truth_m, axis=1) - np.nanmin(truth_m, axis=1), axis=1)))
    tens = np.ceil(np.log10(PCK_THRESHOLDS_M[-1] / (PCK_LARGEST * size_m))) if size_m else 0.0  # of one joint
    return tuple(float(t / 10.0 ** max(tens, 0.0)) for t in PCK_THRESHOLDS_M)


def _inside(error_m: np.ndarray, sigma_m: np.ndarray) -> tuple[float, ...]:
    """By each of `LEVELS` the share of coordinates (T, J, 3) within its interval; NaN without any."""
    off = (np.abs(error_m) / sigma_m)[np.isfinite(error_m) & (sigma_m > 0)]
    return tuple(float(np.mean(off < radius(level))) if len(off) else np.nan for level in LEVELS)


def common_joints(pose_m: np.ndarray, truth_m: np.ndarray) -> np.ndarray:
    """(T, J) bool: all three coordinates are known on both sides."""
    return np.all(~np.isnan(pose_m + truth_m), axis=2)


def joint_errors(pose_m: np.ndarray, truth_m: np.ndarray) -> np.ndarray:
    """Distances (T, J) in metres between (T, J, 3) positions, NaN where either is missing."""
    return np.linalg.norm(pose_m - truth_m, axis=2)


def score(values: np.ndarray) -> _Score:
    """The means of (T, J) values that may be NaN."""
    per_frame = mean_along(values, axis=1)
    return _Score(mean=float(mean_along(per_frame, axis=0)), per_frame=per_frame, per_joint=mean_along(values, axis=0))


def aligned(pose_m: np.ndarray, truth_m: np.ndarray, scale: bool = False, turn: bool = False) -> np.ndarray:
    """The pose (T, J, 3), moved in each frame so that the means of the common joints coincide, and, about that mean,
    brought nearest to the truth by least squares: by one factor, which is not negative, as that would mirror the
    animal, and by a rotation, no reflection. (Umeyama 1991.) All NaN in frames of fewer than 3 common joints, where a
    rotation has no meaning."""
    centred, (pose_mean, truth_mean) = _together(pose_m, truth_m)
    moved, (about, goal) = pose_m - pose_mean, np.nan_to_num(centred)
    if turn:
        enough = np.isfinite(centred[0]).all(axis=2).sum(axis=1)[:, None, None] >= 3
        u, _, vt = np.linalg.svd(np.swapaxes(about, 1, 2) @ goal)
        vt[:, 2] *= np.sign(np.linalg.det(u @ vt))[:, None]  # the direction that matters least
        moved, about = (of @ (u @ vt) for of in (np.where(enough, moved, np.nan), about))
    if scale:
        product, square = (np.sum(about * of, axis=(1, 2)) for of in (goal, about))
        # where all joints coincide every factor is as good
        factor = np.divide(np.maximum(product, 0), square, out=np.ones_like(square), where=square > 0)
        moved = factor[:, None, None] * moved
    return moved + truth_mean


def _together(pose_m: Array, truth_m: Array) -> tuple[Array, Array]:
    """(2, T, J, 3): both about the mean of the joints that both have in a frame, NaN for all others; and the means,
    (2, T, 1, 3)."""
    both = np.where(common_joints(pose_m, truth_m)[..., None], np.stack([pose_m, truth_m]), np.nan)
    means = mean_along(both, axis=2)[:, :, None]
    return both - means, means


# -- what does not belong together -----------------------------------------------------------------------------------

SHARE = 1 / 3
"""An error that falls to this part of itself has been explained."""
SMALL = 0.05
"""An error below this part of the animal's size needs no explanation. Size: root mean square of the joints' distances
from their mean."""
SCALED = 2.0
"""Nor does a size that is less than this many times too large or too small: one camera hardly sees it."""
UNLIKE = 0.3
"""An error above this part of the size is that of another clip: those of running cheetahs are 0.27 to 0.67 of it apart,
and the poorest of the fits in docs/benchmarks.md is 0.22 of it off."""
FAR = 4.0
"""The same of the distance between the two, in sizes."""


def mismatches(pose_m: Array, truth_m: Array, names: Sequence[str]) -> tuple[Finding, ...]:
    """Findings on two sets of positions (T, J, 3) in metres, NaN for missing, that do not belong together."""
    rows = np.isfinite(pose_m + truth_m).all(axis=2).sum(axis=1) >= 3
    pose_m, truth_m = pose_m[rows], truth_m[rows]
    if not rows.any():
        return ()
    pose, truth = _together(pose_m, truth_m)[0]
    size = float(np.sqrt(np.nanmean(np.sum(truth**2, axis=2))))
    error = _error(pose, truth)
    found, left = None, error
    for code, other, numbers in _explanations(pose_m, truth_m, names):
        if left > SMALL * size and other <= SHARE * left:
            found, left = finding(code, error_mm=1000 * error, left_mm=1000 * other, **numbers), other
    if left > UNLIKE * size:  # whatever else takes some of it away
        left = min(left, _error(_turned(pose, truth)[0], truth))
    if left > UNLIKE * size:
        return (finding("reference_unlike", left_mm=1000 * left, share=left / size),)
    if found is not None:
        return (found,)
    away = np.nanmean(pose_m - truth_m, axis=1)
    middle = np.median(away, axis=0)
    distance, rest = (float(np.linalg.norm(x, axis=1).mean()) for x in (away, away - middle))
    if distance > FAR * size and rest <= SHARE * distance:
        x, y, z = middle.tolist()
        return (finding("reference_elsewhere", x_m=x, y_m=y, z_m=z),)
    return ()


def _explanations(pose_m: Array, truth_m: Array, names: Sequence[str]) -> Iterator[tuple[str, float, dict[str, Any]]]:
    """What the matter could be, the simplest first, each with the rotation of the whole clip that fits best: its code,
    the error that would then be left, and its numbers."""
    (pose, truth), sides = _together(pose_m, truth_m)[0], opposites(names)
    tries = [("reference_rotated", pose, truth)]
    if (sides != np.arange(len(names))).any():
        tries.append(("reference_swapped", *_together(pose_m[:, sides], truth_m)[0]))
    tries.append(("reference_mirrored", pose * (1.0, -1.0, 1.0), truth))
    for code, of_pose, of_truth in tries:
        turned, turn_rad = _turned(of_pose, of_truth)
        yield code, _error(turned, of_truth), {"turn_rad": turn_rad}
    turned, turn_rad = _turned(pose, truth)
    factor = float(np.nansum(turned * truth) / max(np.nansum(turned**2), 1e-300))
    if not 1 / SCALED < factor < SCALED:
        yield "reference_scaled", _error(factor * turned, truth), {"factor": factor, "turn_rad": turn_rad}


def _error(pose: Array, truth: Array) -> float:
    return score(joint_errors(pose, truth)).mean


def _turned(pose: Array, truth: Array) -> tuple[Array, float]:
    """The pose brought nearest to the truth by one rotation for all frames, and the rotation's angle in rad."""
    known = np.isfinite(pose[..., 0])
    if not known.any():
        return pose, 0.0
    with warnings.catch_warnings(action="ignore"):  # of points on a line, which several rotations fit
        turn, _ = Rotation.align_vectors(truth[known], pose[known])
    return pose @ turn.as_matrix().T, float(turn.magnitude())
