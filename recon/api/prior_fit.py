"""Fit a motion prior to results of fits or to 3D poses of one class of motions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from recon.animal.body import Body
from recon.animal.measured import save_prior
from recon.animal.prior import MotionPrior, mean_speed_m_s
from recon.animal.prior_fit import FRAMES_PER_COMPONENT, as_one_gaussian, fit_prior, log_likelihood
from recon.animal.skeleton_file import load_skeleton
from recon.api.batch_inputs import file_names
from recon.api.model_settings import PriorFitSettings
from recon.base.arrays import Array
from recon.base.documents import read_json
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.numbers import counted
from recon.base.outputs import output_file, require_suffix
from recon.base.settings import input_paths
from recon.check.verdict import usable
from recon.fit.motion import Motion
from recon.fit.points import MIN_MARKERS, solve_points
from recon.io.common import Pose3D
from recon.io.positions import read_pose_segments
from recon.show.plain import picked

Segment = tuple[str, Array, float]
"""Name, states (T, D) and frame rate (Hz) of a segment of motion."""
_Files = Mapping[Path, Mapping[str, Pose3D]]
"""Poses, keyed by file and by the name of a segment in the file."""


def run_prior_fit(settings: PriorFitSettings) -> dict[str, Any]:
    """Fit a motion prior to results of `recon fit`, given as folders, and to pose files, and write it.

    Frames without a pose and flagged frames of results are left out.

    Returns
    -------
    dict
        Plain types: `segments`, a row for each segment with the body's misfit to it (None for results, and if no frame
        had enough markers); `components`, the number of components of the mixture, and `components_asked`, the
        requested number; `sizes`, the factor on the body's lengths for each pose file; `lacking`, the markers that no
        pose file has; `frames`, the number of frames used; `left_out`, the number of frames of results left out; and
        `held_out`, the mean log-likelihood per frame of the segments, each under a prior fitted to the others, for the
        `mixture` and for `one_gaussian`, or None if it was not requested or cannot be computed.

    Raises
    ------
    InputError
        If files or options cannot be used. The message lists all problems.
    """
    output = output_file(settings.out, "prior fit", settings.overwrite, input_paths(settings))
    paths = list(dict.fromkeys(settings.poses))
    folders, tables = [path for path in paths if path.is_dir()], [path for path in paths if not path.is_dir()]
    body_option, results, files, rates, *_ = collect_problems(
        lambda: _body(settings.skeleton, settings.subject, folders),
        lambda: collect_problems(*(partial(_motion, path, settings.anyway) for path in folders)),
        lambda: collect_problems(*(partial(read_pose_segments, path) for path in tables)),
        lambda: _rates(settings.fps, tables),
        lambda: require_suffix(settings.out, (".npz",)),
        lambda: output.require((settings.out.name,)),
    )
    results, files = dict(zip(folders, results, strict=True)), dict(zip(tables, files, strict=True))
    body = _common_body(body_option, results)
    raise_problems(_problems_of_files(body, files, rates, settings.fps or "--fps"))

    names = file_names([*dict.fromkeys(path.absolute() for path in paths)])
    result_segments = [(names[path.absolute()], _sound_states(motion), motion.fps) for path, motion in results.items()]
    file_segments, misfits_mm, sizes = _solved_segments(body, files, names, rates, settings.estimate_size)
    segments = [*result_segments, *file_segments]
    frames = sum(
        _pose_count(states) for _, states, fps in segments if mean_speed_m_s(states, fps) >= settings.min_speed_m_s
    )
    components = min(settings.components, max(frames // FRAMES_PER_COMPONENT, 1))
    name_and_source = (settings.name or settings.out.stem, settings.source)
    options = picked(settings, "min_speed_m_s", "apart")
    prior = fit_prior(body, segments, *name_and_source, components, **options)
    held_out = _held_out(body, segments, prior) if settings.check else None
    with output.staged_file() as staged:
        save_prior(prior, staged)
    rows = zip(prior.segments, (*(None for _ in result_segments), *misfits_mm), strict=True)
    known_joints = {joint for pieces in files.values() for pose in pieces.values() for joint in pose.names}
    return {
        "segments": [asdict(row) | {"misfit_mm": misfit_mm} for row, misfit_mm in rows],
        "components": len(prior.weights),
        "components_asked": settings.components,
        "sizes": {str(path): size for path, size in sizes.items()},
        "lacking": [marker for marker in body.markers if files and marker not in known_joints],
        "frames": frames,
        "left_out": sum(int(np.isnan(states[:, 0]).sum()) for _, states, _ in result_segments),
        "held_out": held_out,
    }


def _pose_count(states: Array) -> int:
    return int(np.isfinite(states).all(axis=1).sum())


def _sound_states(motion: Motion) -> Array:
    """Return the states (T, D) of a motion, NaN in flagged frames and in frames without a pose."""
    flagged = np.array([bool(flags) for flags in motion.flags])
    return np.where(flagged[:, None], np.nan, motion.states)


def _solved_segments(
    body: Body, files: _Files, names: Mapping[Path, str], rates: Sequence[float], estimate_size: bool
) -> tuple[list[Segment], list[float | None], dict[Path, float]]:
    """Fit the body to the segments of pose files, which are also divided where the frame numbers jump.

    Returns
    -------
    segments : list of Segment
        Segments, named after the segment in the file, the file's name in `names`, or both.
    misfits_mm : list of float or None
        Root mean square distance of the body's markers from each segment's, mm; None without frames to compare.
    sizes : dict
        Factor on the body's lengths, by file.
    """
    segments: list[Segment] = []
    misfits_mm: list[float | None] = []
    sizes: dict[Path, float] = {}
    rate = iter(rates if len(rates) > 1 else list(rates) * sum(map(len, files.values())))
    for path, pieces in files.items():
        points_m = np.concatenate([pose.of_joints(body.markers) for pose in pieces.values()])
        if not (np.isfinite(points_m).all(axis=2).sum(axis=1) >= MIN_MARKERS).any():
            raise InputError(
                Problem(path, "frames", "too few markers in each frame", f"frames with at least {MIN_MARKERS} markers")
            )
        states, rms_m, sizes[path] = solve_points(body, points_m, None if estimate_size else 1.0)
        first = 0
        for piece, pose in pieces.items():
            fps, jumps = next(rate), (np.nonzero(np.diff(pose.frames) != 1)[0] + 1).tolist()
            full_name = names[path.absolute()] if piece == path.stem else f"{names[path.absolute()]} {piece}"
            for start, stop in zip([0, *jumps], [*jumps, len(pose.frames)], strict=True):
                rows_of_segment = slice(first + start, first + stop)
                known = rms_m[rows_of_segment][np.isfinite(rms_m[rows_of_segment])]
                misfits_mm.append(1e3 * float(np.sqrt(np.mean(known**2))) if len(known) else None)
                name = (piece if len(names) == 1 else full_name) + (f" from {pose.frames[start]}" if jumps else "")
                segments.append((name, states[rows_of_segment], fps))
            first += len(pose.frames)
    return segments, misfits_mm, sizes


def _held_out(body: Body, segments: Sequence[Segment], prior: MotionPrior) -> dict[str, float] | None:
    """Return the mean log-likelihood per frame of segments, each under a prior fitted to the others.

    The result has the values of the mixture and of a single Gaussian, and the smallest number of components of the
    priors. The result is None if no segment can be left out.
    """
    used = [segment for segment, row in zip(segments, prior.segments, strict=True) if row.used]
    frames = [_pose_count(states) for _, states, _ in used]
    scores, weights, fewest = [], [], len(prior.weights)
    for i, (_, states, _) in enumerate(used):
        components = min(len(prior.weights), (sum(frames) - frames[i]) // FRAMES_PER_COMPONENT)
        if components and frames[i]:
            rest = fit_prior(body, used[:i] + used[i + 1 :], components=components)
            scores.append((log_likelihood(rest, states), log_likelihood(as_one_gaussian(rest), states)))
            weights.append(frames[i])
            fewest = min(fewest, components)
    if not scores:
        return None
    mixture, one_gaussian = np.average(scores, axis=0, weights=weights).tolist()
    return {"mixture": mixture, "one_gaussian": one_gaussian, "components": fewest}


def _body(skeleton: str | None, subject: str | None, folders: Sequence[Path]) -> Body | None:
    """Return the requested body, or None if the results' body is to be used."""
    if skeleton is None:
        if folders and subject is None:
            return None
        expected = f"the skeleton of a whole animal{'' if folders else ', or results of `recon fit`'}"
        raise InputError(Problem("--skeleton", "name or file", "nothing", expected))
    body = load_skeleton(skeleton, subject)
    if body.one_sided:
        raise InputError(Problem("--skeleton", "name or file", repr(skeleton), "a whole animal, with [[segments]]"))
    return body


def _common_body(body_option: Body | None, results: Mapping[Path, Motion]) -> Body:
    bodies = ({} if body_option is None else {Path("--skeleton"): body_option}) | {
        path: motion.body for path, motion in results.items()
    }
    if len({(body.name, body.state_names) for body in bodies.values()}) > 1:
        actual = ", ".join(f"{path}: {body.name}" for path, body in bodies.items())
        raise InputError(Problem("POSES", "skeleton", actual, "one skeleton for all, with the same angles"))
    return next(iter(bodies.values()))


def _motion(folder: Path, anyway: bool) -> Motion:
    motion = usable(Motion.load(folder), folder, anyway)
    if motion.body.one_sided:
        raise InputError(Problem(folder, "skeleton", motion.body.name, "a whole animal, with [[segments]]"))
    return motion


def _rates(fps: str | None, tables: Sequence[Path]) -> list[float]:
    """Return the frame rates in Hz, given as one number or a JSON file, or none if there are no pose files."""
    expected = 'frames per second above 0, such as 120, or a JSON file with {"fps": [120, 90]}'
    if (fps is None) != (not tables):
        no_rates = expected if tables else "nothing: results have their own frame rate"
        raise InputError(Problem("--fps", "frame rate", fps or "nothing", no_rates))
    if fps is None:
        return []
    source = Path(fps) if Path(fps).is_file() else None
    try:
        rates = [float(rate) for rate in np.ravel(fps if source is None else read_json(source, expected)["fps"])]
    except (ValueError, KeyError, TypeError, OverflowError):
        rates = []
    if not rates or not all(0 < rate < math.inf for rate in rates):
        raise InputError(Problem(source or "--fps", "frame rate", repr(fps), expected))
    return rates


def _problems_of_files(body: Body, files: _Files, rates: Sequence[float], fps: str) -> Iterator[Problem]:
    """Yield problems with files that have too few markers, and with a wrong number of frame rates."""
    for path, pieces in files.items():
        names = next(iter(pieces.values())).names
        count_known = sum(marker in names for marker in body.markers)
        if count_known < MIN_MARKERS:
            expected = f"at least {MIN_MARKERS} markers of {body.name}: {', '.join(body.markers)}"
            yield Problem(path, "joints", f"{count_known} of {len(body.markers)}: {', '.join(names)}", expected)
    count = sum(map(len, files.values()))
    if files and len(rates) not in (1, count):
        yield Problem(
            fps,
            "fps",
            f"{len(rates)} frame rates",
            f"one frame rate, or one for each of {counted(count, 'segment')}",
        )
