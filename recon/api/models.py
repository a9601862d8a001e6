"""What is learned of animals: priors and measured animals.

`recon prior fit`: results of fits or 3D poses of a class of motions in, a motion prior out. `recon subject fit`: clips
that several cameras filmed in, one animal's lengths and its detector's offsets out.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from rich.table import Table

from recon.animal.body import Body
from recon.animal.measured import detector_toml, save_prior, subject_toml
from recon.animal.prior import MotionPrior, mean_speed_m_s
from recon.animal.prior_fit import FRAMES_PER_COMPONENT, as_one_gaussian, fit_prior, log_likelihood
from recon.animal.skeleton_file import NONE, load_skeleton
from recon.api.batch.inputs import file_names
from recon.api.clip_inputs import prepare
from recon.api.clip_results import CONFIG, read_config
from recon.api.settings import ANYWAY, FitSettings
from recon.base.arrays import Array, Integers
from recon.base.documents import read_json
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.numbers import counted
from recon.base.outputs import output_file, require_suffix
from recon.base.settings import Count, NotNegative, OneOrMore, Option, Settings, input_paths
from recon.check.verdict import usable
from recon.cli.answers import Answer, table_of
from recon.clip import views_of
from recon.fit.clip_problem import ClipProblem
from recon.fit.motion import Motion
from recon.fit.points import MIN_MARKERS, solve_points
from recon.fit.shape import POSED_OFFSET_SIGMA_M, Shape, ShapeFit, fit_shape
from recon.io.common import Pose3D
from recon.io.positions import read_pose3d, read_pose_segments
from recon.show.plain import picked

Segment = tuple[str, Array, float]
"""Name, states (T, D), frames per second."""
_Files = Mapping[Path, Mapping[str, Pose3D]]
"""Poses by file and piece of motion."""


class PriorFitSettings(Settings):
    """The settings of `recon prior fit`."""

    poses: Annotated[OneOrMore[Path], Option(argument="POSES")]
    """Results of recon fit, or 3D poses as in pose3d.csv: metres, world z up."""
    out: Path
    """File for the prior, as in my-dog.npz."""
    skeleton: str | None = None
    """Skeleton of 3D poses, as in cheetah-24. (default: that of the results)"""
    fps: str | None = None
    """Frame rate of 3D poses in Hz, or a JSON file with {"fps": [...]}, one per piece."""
    subject: str | None = None
    """Measured animal, by name or TOML file, as in phantom."""
    estimate_size: bool = False
    """Scale the skeleton to the animal of each file."""
    components: Count = 16
    """Gaussians in the mixture of poses; each takes 20 frames."""
    min_speed_m_s: NotNegative = 0.0
    """Leave out slower segments, as in 8.5."""
    apart: tuple[str, ...] = ()
    """Segment whose movement says nothing of the others', as in tail_1."""
    name: str | None = None
    """Name of the prior. (default: the file's)"""
    source: str = ""
    """Where the poses come from, for the record."""
    check: bool = False
    """Score each segment under a prior from the others."""
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: bool = False
    """Replace the file."""


def prior_fit(settings: PriorFitSettings) -> Answer:
    """Fit a motion prior to results or 3D poses, and list what it was fitted to.

    Example: recon prior fit results/run1 results/run2 --out my-cat.npz
    """
    done = run_prior_fit(settings)
    short = settings.check and done["held_out"] is None
    note = [f"Nothing could be held out: --check needs two segments of {FRAMES_PER_COMPONENT} frames."] if short else []
    return Answer({"out": settings.out, **done}, [*_lines(done), *note, f"The prior is in {settings.out}."])


def _lines(done: dict[str, Any]) -> Iterator[str | Table]:
    columns = ("frames", "fps", "speed m/s", "misfit mm", "used")
    rows = (
        (
            *(row["name"], f"{row['frames']}", f"{row['fps']:g}", f"{row['speed_m_s']:.1f}"),
            "-" if row["misfit_mm"] is None else f"{row['misfit_mm']:.1f}",
            "yes" if row["used"] else "no",
        )
        for row in done["segments"]
    )
    yield table_of("segment", numbers=columns, rows=rows)
    used, components, held_out = [row["used"] for row in done["segments"]], done["components"], done["held_out"]
    yield f"Used: {sum(used)} of {len(used)} segments, {done['frames']} frames and their mirror images."
    if components < done["components_asked"]:
        place = f"{components} components in place of {done['components_asked']}"
        yield f"{place}: each takes {FRAMES_PER_COMPONENT} frames."
    if done["left_out"]:
        yield f"{done['left_out']} frames of results have a flag or no pose: left out."
    if done["lacking"]:
        yield f"Markers that no file has: {', '.join(done['lacking'])}"
    for path, size in done["sizes"].items():
        if size != 1.0:
            yield f"{path}: {size:.3f} times the skeleton's lengths"
    if held_out is not None:
        yield (
            "Held-out log-likelihood per frame: {mixture:.2f} with {components} components, {one_gaussian:.2f} with "
            "one Gaussian"
        ).format(**held_out)


def run_prior_fit(settings: PriorFitSettings) -> dict[str, Any]:
    """`recon prior fit`: fit a prior to results of `recon fit`, which are folders, and to pose files, and write it.

    Gives, as plain types, the table of segments with the body's misfit to each (None for results, and where no frame
    had enough markers), the `sizes` that the body's lengths were multiplied by for each pose file, the markers that no
    pose file has (`lacking`), on how many `frames` it was fitted, how many frames of results have a flag or no pose
    (`left_out`), and `held_out`: the mean log-likelihood per frame of segments that a prior was not fitted to, each
    left out once, None if it was not asked for or no segment can be left out.

    Of results, frames without a pose or with a flag are left out. skeleton: None for that of the results. fps: of the
    pose files, a number, or a JSON file with one for every piece of motion in their order; None without any. Raises
    InputError for files and options that cannot be used, with the problems of all of them.
    """
    output = output_file(settings.out, "prior fit", settings.overwrite, input_paths(settings))
    paths = list(dict.fromkeys(settings.poses))
    folders, tables = [path for path in paths if path.is_dir()], [path for path in paths if not path.is_dir()]
    given, results, files, rates, *_ = collect_problems(
        lambda: _body(settings.skeleton, settings.subject, folders),
        lambda: collect_problems(*(partial(_motion, path, settings.anyway) for path in folders)),
        lambda: collect_problems(*(partial(read_pose_segments, path) for path in tables)),
        lambda: _rates(settings.fps, tables),
        lambda: require_suffix(settings.out, (".npz",)),
        lambda: output.require((settings.out.name,)),
    )
    results, files = dict(zip(folders, results, strict=True)), dict(zip(tables, files, strict=True))
    body = _common_body(given, results)
    raise_problems(_problems_of_files(body, files, rates, settings.fps or "--fps"))

    names = file_names([*dict.fromkeys(path.absolute() for path in paths)])
    of_results = [(names[path.absolute()], _sound_states(one), one.fps) for path, one in results.items()]
    of_files, misfits_mm, sizes = _solved_segments(body, files, names, rates, settings.estimate_size)
    segments = [*of_results, *of_files]
    frames = sum(_count(states) for _, states, fps in segments if mean_speed_m_s(states, fps) >= settings.min_speed_m_s)
    components = min(settings.components, max(frames // FRAMES_PER_COMPONENT, 1))
    of, how = (settings.name or settings.out.stem, settings.source), picked(settings, "min_speed_m_s", "apart")
    prior = fit_prior(body, segments, *of, components, **how)
    held_out = _held_out(body, segments, prior) if settings.check else None
    with output.staged_file() as staged:
        save_prior(prior, staged)
    rows = zip(prior.segments, (*(None for _ in of_results), *misfits_mm), strict=True)
    there = {joint for pieces in files.values() for pose in pieces.values() for joint in pose.names}
    return {
        "segments": [asdict(row) | {"misfit_mm": misfit_mm} for row, misfit_mm in rows],
        "components": len(prior.weights),
        "components_asked": settings.components,
        "sizes": {str(path): size for path, size in sizes.items()},
        "lacking": [marker for marker in body.markers if files and marker not in there],
        "frames": frames,
        "left_out": sum(int(np.isnan(states[:, 0]).sum()) for _, states, _ in of_results),
        "held_out": held_out,
    }


def _count(states: Array) -> int:
    """Frames with a pose."""
    return int(np.isfinite(states).all(axis=1).sum())


def _sound_states(motion: Motion) -> Array:
    """(T, D), NaN in frames without a pose and in those that a flag calls doubtful."""
    flagged = np.array([bool(flags) for flags in motion.flags])
    return np.where(flagged[:, None], np.nan, motion.states)


def _solved_segments(
    body: Body, files: _Files, names: Mapping[Path, str], rates: Sequence[float], estimate_size: bool
) -> tuple[list[Segment], list[float | None], dict[Path, float]]:
    """The segments of pose files, between jumps of their frame numbers, called as their piece of motion, or as the file
    of `names`, or both; the body's misfit to each (mm); and the factor on its lengths by file."""
    segments: list[Segment] = []
    misfits_mm: list[float | None] = []
    sizes: dict[Path, float] = {}
    rate = iter(rates if len(rates) > 1 else list(rates) * sum(map(len, files.values())))
    for path, of_file in files.items():
        points_m = np.concatenate([pose.of_joints(body.markers) for pose in of_file.values()])
        if not (np.isfinite(points_m).all(axis=2).sum(axis=1) >= MIN_MARKERS).any():
            raise InputError(Problem(path, "frames", "too few points in each", f"{MIN_MARKERS} markers in some frame"))
        states, rms_m, sizes[path] = solve_points(body, points_m, None if estimate_size else 1.0)
        first = 0
        for piece, pose in of_file.items():
            fps, jumps = next(rate), (np.nonzero(np.diff(pose.frames) != 1)[0] + 1).tolist()
            whole = names[path.absolute()] if piece == path.stem else f"{names[path.absolute()]} {piece}"
            for start, stop in zip([0, *jumps], [*jumps, len(pose.frames)], strict=True):
                own = slice(first + start, first + stop)
                known = rms_m[own][np.isfinite(rms_m[own])]
                misfits_mm.append(1e3 * float(np.sqrt(np.mean(known**2))) if len(known) else None)
                name = (piece if len(names) == 1 else whole) + (f" from {pose.frames[start]}" if jumps else "")
                segments.append((name, states[own], fps))
            first += len(pose.frames)
    return segments, misfits_mm, sizes


def _held_out(body: Body, segments: Sequence[Segment], prior: MotionPrior) -> dict[str, float] | None:
    used = [segment for segment, row in zip(segments, prior.segments, strict=True) if row.used]
    frames = [_count(states) for _, states, _ in used]
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
    """As given; None where results have it."""
    if skeleton is None:
        if folders and subject is None:
            return None
        expected = f"a whole animal's{'' if folders else ', or results of `recon fit`'}"
        raise InputError(Problem("--skeleton", "name or file", "nothing", expected))
    body = load_skeleton(skeleton, subject)
    if body.one_sided:
        raise InputError(Problem("--skeleton", "name or file", repr(skeleton), "a whole animal, with [[segments]]"))
    return body


def _common_body(given: Body | None, results: Mapping[Path, Motion]) -> Body:
    bodies = ({} if given is None else {Path("--skeleton"): given}) | {path: one.body for path, one in results.items()}
    if len({(body.name, body.state_names) for body in bodies.values()}) > 1:
        found = ", ".join(f"{path}: {body.name}" for path, body in bodies.items())
        raise InputError(Problem("POSES", "skeleton", found, "the same for all, with the same angles"))
    return next(iter(bodies.values()))


def _motion(folder: Path, anyway: bool) -> Motion:
    motion = usable(Motion.load(folder), folder, anyway)
    if motion.body.one_sided:
        raise InputError(Problem(folder, "skeleton", motion.body.name, "a whole animal, with [[segments]]"))
    return motion


def _rates(fps: str | None, tables: Sequence[Path]) -> list[float]:
    """The number, or those of a JSON file; none where there are no pose files."""
    expected = 'frames per second above 0, as in 120, or a JSON file with {"fps": [120, 90]}'
    if (fps is None) != (not tables):
        wanted = expected if tables else "nothing: results have their own"
        raise InputError(Problem("--fps", "frame rate", fps or "nothing", wanted))
    if fps is None:
        return []
    where = Path(fps) if Path(fps).is_file() else None
    try:
        rates = [float(rate) for rate in np.ravel(fps if where is None else read_json(where, expected)["fps"])]
    except (ValueError, KeyError, TypeError, OverflowError):
        rates = []
    if not rates or not all(0 < rate < math.inf for rate in rates):
        raise InputError(Problem(where or "--fps", "frame rate", repr(fps), expected))
    return rates


def _problems_of_files(body: Body, files: _Files, rates: Sequence[float], fps: str) -> Iterator[Problem]:
    """Too few markers, and rates that are not one or one a piece."""
    for path, pieces in files.items():
        names = next(iter(pieces.values())).names
        there = sum(marker in names for marker in body.markers)
        if there < MIN_MARKERS:
            expected = f"at least {MIN_MARKERS} markers of {body.name}: {', '.join(body.markers)}"
            yield Problem(path, "joints", f"{there} of {len(body.markers)}: {', '.join(names)}", expected)
    count = sum(map(len, files.values()))
    if files and len(rates) not in (1, count):
        yield Problem(fps, "fps", f"{len(rates)} numbers", f"one, or {count}: one for every piece")


# -- a measured animal ------------------------------------------------------------------------------------------------

LEAST_SIZE_SIGMA = 0.01
"""The least size_sigma of a measured animal: its lengths are known no better than a keypoint's place on it is."""


def _rows(fit: ShapeFit) -> Iterator[dict[str, Any]]:
    """What was measured: lengths in metres, offsets in millimetres."""
    shape, values, sigma = fit.shape, fit.values, fit.sigma
    body = shape.applied(shape.body, values)
    items = {item.name: item for item in (*body.tree.segments, *body.tree.markers)}
    for name, s in zip(shape.lengths, sigma, strict=False):
        length = float(np.linalg.norm(items[name].offset_m))
        yield {"name": name, "value": length, "sigma": float(length * s), "unit": "m"}
    first = len(shape.lengths)
    for name, value, s in zip(shape.names[first:], values[first:], sigma[first:], strict=True):
        yield {"name": name, "value": 1e3 * float(value), "sigma": 1e3 * float(s), "unit": "mm"}


class SubjectFitSettings(Settings):
    """What `recon subject fit` is told."""

    clips: Annotated[OneOrMore[Path], Option(argument="CLIPS")]
    """Results of several cameras, or their config.toml."""
    out: Path
    """File for the subject, as in my-cat.toml."""
    lengths: bool = True
    """Measure the lengths of the segments, left equal to right."""
    offsets: bool = False
    """Measure where the detector's keypoints lie beside the markers."""
    poses: tuple[Path, ...] = ()
    """3D poses by another method, one file a clip: offsets are measured beside these."""
    title: str | None = None
    """Title of the animal, in words. (default: made up)"""
    overwrite: bool = False
    """Replace the file."""

    def problems(self) -> Iterator[Problem]:
        """What is to be measured has to be named, and poses have to be there for each clip."""
        if not self.lengths and not self.offsets:
            yield Problem("--no-lengths", "unknowns", "nothing to fit", "--offsets with it, or without it")
        if self.poses and (self.lengths or not self.offsets):
            yield Problem("--poses", "unknowns", "lengths, or no offsets", "--no-lengths --offsets beside it")
        if self.poses and len(self.poses) != len(self.clips):
            yield Problem("--poses", "files", f"{len(self.poses)} for {len(self.clips)} clips", "one for each clip")


def subject_fit(settings: SubjectFitSettings) -> Answer:
    """Measure one animal in clips that several cameras filmed, for `recon fit --subject`; without its lengths the
    detector only, for `recon fit --set detector`, also from several measured animals.

    Example: recon subject fit results/run1 results/run2 --offsets --out my-cat.toml
    """
    found = run_subject_fit(settings)
    return Answer({"out": settings.out, **found}, _subject_lines(found, settings.out))


def _subject_lines(found: dict[str, Any], out: Path) -> Iterator[str | Table]:
    lengths, offsets = ([row for row in found["values"] if row["unit"] == unit] for unit in ("m", "mm"))
    if lengths:
        rows = ((row["name"], f"{row['value']:.3f}", f"{row['sigma']:.3f}") for row in lengths)
        yield table_of("length of", numbers=("m", "±"), rows=rows)
    if offsets:
        rows = []
        for three in zip(offsets[::3], offsets[1::3], offsets[2::3], strict=True):
            sigma = max(row["sigma"] for row in three)
            values = (f"{row['value']:.0f}" for row in three)
            rows.append((three[0]["name"].removesuffix("_x"), *values, f"{sigma:.0f}"))
        yield table_of("keypoint off its marker, mm", numbers=("forwards", "left", "up", "±"), rows=rows)
    if lengths:
        yield f"Size: {found['size']:.3f} ± {found['size_sigma']:.3f} of the skeleton's lengths."
    if not found["converged"]:
        yield "The last step was not small yet: more frames would say more."
    kind, use = ("subject", "--subject ") if lengths else ("detector", "--set detector=")
    yield f"From {counted(found['clips'], 'clip')}, {found['frames']} frames. The {kind} is in {out}."
    yield f"Use it with: recon fit {use}{out}"


def run_subject_fit(settings: SubjectFitSettings) -> dict[str, Any]:
    """`recon subject fit`: measure an animal and its detector, and write the subject file; without lengths, the
    detector file. What was found is given as plain types; its size is the lengths' mean factor on the skeleton's.

    clips: result folders of `recon fit`, or their config.toml. lengths: of the segments; offsets: of the keypoints from
    the markers. poses: of each clip, its 3D poses in the cameras' world as another method knows them, and then the
    offsets are those beside these. Raises InputError for clips and options that cannot be used, with the problems of
    all of them.
    """
    output = output_file(settings.out, "subject fit", settings.overwrite, input_paths(settings))
    fits, _, _, known = collect_problems(
        lambda: collect_problems(*(partial(read_config, p / CONFIG if p.is_dir() else p, {}) for p in settings.clips)),
        lambda: require_suffix(settings.out, (".toml",)),
        lambda: output.require((settings.out.name,)),
        lambda: collect_problems(*(partial(read_pose3d, path) for path in settings.poses)),
    )
    _require_one_skeleton(fits, settings.clips)
    if settings.lengths:  # those of a measured animal would be measured again
        fits = [replace(one, subject=None) for one in fits]
    if settings.offsets:
        fits = [replace(one, detector=NONE) for one in fits]
    each = zip(fits, settings.clips, known or (None,) * len(settings.clips), strict=True)
    given = collect_problems(*(partial(_problem, *of) for of in each))
    shape = Shape.of_body(given[0].body, settings.lengths, settings.offsets)
    if known:
        shape = replace(shape, offset_sigma_m=POSED_OFFSET_SIGMA_M)
    try:
        fit = fit_shape(shape, given)
    except ValueError as error:
        raise InputError(Problem(settings.clips[0], "clips", str(error), "clips that `recon fit` can solve")) from None
    n = len(shape.lengths)
    size, sigma = 1.0, given[0].size_sigma
    if n:
        size = float(np.exp(fit.values[:n].mean()))
        sigma = max(float(np.sqrt(fit.covariance[:n, :n].mean())), LEAST_SIZE_SIGMA)
    frames = sum(int((one.present().sum(axis=1) > 0).sum()) for one in given)
    rows = list(_rows(fit))
    body = replace(shape.applied(shape.body, fit.values), size_sigma=sigma)
    notes = ["{name}: {value:.4g} ± {sigma:.2g} {unit}".format(**row) for row in rows]
    count = f"measured in {len(settings.clips)} clip{'s' * (len(settings.clips) > 1)}"
    if settings.lengths:
        if not settings.offsets:  # the detector's are not the animal's
            body = replace(body, keypoint_offset_m={})
        text = subject_toml(fits[0].skeleton_name, body, settings.title or f"{shape.body.title}, {count}", notes)
    else:
        text = detector_toml(fit.seen(shape.body), settings.title or f"a detector, {count}", notes)
    output.write(settings.out.name, text)
    counts = {"clips": len(settings.clips), "frames": frames, "converged": fit.converged}
    return {**counts, "size": size, "size_sigma": sigma, "values": rows}


def _require_one_skeleton(settings: Sequence[FitSettings], clips: Sequence[Path]) -> None:
    names = {one.skeleton_name for one in settings}
    if len(names) > 1:
        found = ", ".join(f"{path}: {one.skeleton_name}" for path, one in zip(clips, settings, strict=True))
        raise InputError(Problem("CLIPS", "skeleton", found, "clips of the same skeleton"))


def _problem(settings: FitSettings, path: Path, pose: Pose3D | None) -> ClipProblem:
    """A clip from which the animal can be measured. Raises InputError for others."""
    if settings.method != "trajectory":
        raise InputError(Problem(path, "method", settings.method, "the trajectory method"))
    given = prepare(settings)
    if given.body.one_sided:
        expected = "a whole animal: a chain's lengths stand in its own skeleton file"
        raise InputError(Problem(path, "skeleton", given.body.name, expected))
    views, options = views_of(given.sources), settings.trajectory_options()
    problem = ClipProblem.from_views(views, given.body, given.prior, given.fps, options)
    if not problem.shows_size:
        found = f"one camera that stands still, {given.sources[0].camera.name}"
        raise InputError(Problem(path, "cameras", found, "several cameras, or a moving one: one cannot tell lengths"))
    if pose is None:
        return problem
    return replace(problem, known_states=_states_known(problem, given.sources[0].keypoints.frames, pose))


def _states_known(setting: ClipProblem, frames: Integers, pose: Pose3D) -> Array:
    """(T, D): states of the setting's body, whose markers are nearest to a pose, NaN where it has none. Raises
    InputError where it has no frame or too few of the markers."""
    markers = setting.body.markers
    _, mine, theirs = np.intersect1d(frames, pose.frames, return_indices=True)
    points_m = np.full((len(frames), len(markers), 3), np.nan)
    points_m[mine] = pose.of_joints(markers)[theirs]
    states, *_ = solve_points(setting.body, points_m)
    if not np.isfinite(states).all(axis=1).any():
        found = f"{len(mine)} of the clip's frames, {len({*markers} & {*pose.names})} of the skeleton's markers"
        expected = f"{MIN_MARKERS} or more of {', '.join(markers)} in frames of the clip, numbered as its keypoints are"
        raise InputError(Problem(pose.source or "--poses", "poses", found, expected))
    return states
