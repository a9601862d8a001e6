"""3D poses of a class of motions in, a motion prior out."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from recon.app.batch.inputs import file_names
from recon.body import Body
from recon.documents import read_json
from recon.errors import InputError, Problem, all_of
from recon.io.pose3d import Pose3D, read_pose_segments
from recon.prior import (
    FRAMES_PER_COMPONENT,
    MotionPrior,
    as_one_gaussian,
    fit_prior,
    log_likelihood,
    mean_speed_m_s,
    save_prior,
)
from recon.skeleton_file import load_skeleton
from recon.solve.points import MIN_MARKERS, solve_points_and_size

Array = NDArray[np.float64]
Segment = tuple[str, Array, float]
"""Name, states (T, D), frames per second."""


@dataclass(frozen=True)
class HeldOut:
    """Mean log-likelihood per frame of segments that a prior was not fitted to, each left out once: of the mixture, and
    of one Gaussian. components: the fewest of all these fits."""

    mixture: float
    one_gaussian: float
    components: int


@dataclass(frozen=True, eq=False)
class PriorFit:
    """prior; rms_mm: the body's misfit in each segment of prior.segments, NaN where no frame had enough markers; sizes:
    the factor on the body's lengths by file; lacking: markers of the body that no file has; held_out: None if it was
    not asked for, or if no segment can be left out; components_asked: the prior has as many, or what its frames
    allow."""

    prior: MotionPrior
    rms_mm: tuple[float, ...]
    sizes: dict[Path, float]
    lacking: tuple[str, ...]
    held_out: HeldOut | None
    components_asked: int

    def to_dict(self) -> dict[str, Any]:
        """The table of segments and what is said beside it, as plain types; unknown is None."""
        rows = zip(self.prior.segments, self.rms_mm, strict=True)
        return {
            "segments": [asdict(row) | {"misfit_mm": rms if math.isfinite(rms) else None} for row, rms in rows],
            "components": len(self.prior.weights),
            "components_asked": self.components_asked,
            "sizes": {str(path): size for path, size in self.sizes.items()},
            "lacking": list(self.lacking),
            "held_out": None if self.held_out is None else asdict(self.held_out),
        }

    def notes(self) -> Iterator[str]:
        """What there is to say beside the table of segments."""
        rows = self.prior.segments
        used = [row for row in rows if row.used]
        frames = sum(row.frames for row in used)
        yield f"Used: {len(used)} of {len(rows)} segments, {frames} frames and their mirror images."
        if len(self.prior.weights) < self.components_asked:
            yield (
                f"{len(self.prior.weights)} components in place of {self.components_asked}: each takes "
                f"{FRAMES_PER_COMPONENT} frames."
            )
        if self.lacking:
            yield f"Markers that no file has: {', '.join(self.lacking)}"
        for path, size in self.sizes.items():
            if size != 1.0:
                yield f"{path}: {size:.3f} times the skeleton's lengths"
        if self.held_out is not None:
            yield (
                f"Held-out log-likelihood per frame: {self.held_out.mixture:.2f} with {self.held_out.components} "
                f"components, {self.held_out.one_gaussian:.2f} with one Gaussian"
            )


def run_prior_fit(
    poses: Sequence[Path],
    skeleton: str,
    fps: str,
    out: Path,
    subject: str | None = None,
    name: str | None = None,
    source: str = "",
    components: int = 16,
    min_speed_m_s: float = 0.0,
    estimate_size: bool = False,
    apart: Sequence[str] = (),
    check: bool = False,
    overwrite: bool = False,
) -> PriorFit:
    """`recon prior fit`: fit a prior to pose files and write it.

    fps: a number, or a JSON file with one for every piece of motion, in the order of the files. Raises InputError for
    files and options that cannot be used, with the problems of all of them.
    """
    body, files, rates, _ = all_of(
        lambda: _body(skeleton, subject),
        lambda: dict(zip(poses, all_of(*(_reader(path) for path in poses)), strict=True)),
        lambda: _rates(fps),
        lambda: _check_options(out, overwrite, components, min_speed_m_s),
    )
    all_of(lambda: _require_markers(body, files), lambda: _require_rates(rates, files, fps))
    if len(rates) == 1:
        rates = rates * sum(len(pieces) for pieces in files.values())

    labels = _labels(files)
    segments: list[Segment] = []
    rms_mm: list[float] = []
    sizes: dict[Path, float] = {}
    rate = iter(rates)
    for path, pieces in files.items():
        points_m = np.concatenate([_arranged(pose, body) for pose in pieces.values()])
        states, rms_m, sizes[path] = _solved(body, points_m, None if estimate_size else 1.0, path)
        first = 0
        for piece, pose in pieces.items():
            label, piece_fps = labels[path, piece], next(rate)
            for part, suffix in _without_gaps(pose.frames):
                own = slice(first + part.start, first + part.stop)
                segments.append((label + suffix, states[own], piece_fps))
                known = rms_m[own][np.isfinite(rms_m[own])]
                rms_mm.append(1e3 * float(np.sqrt(np.mean(known**2))) if len(known) else math.nan)
            first += len(pose.frames)
    fits = min(components, max(_used_frames(segments, min_speed_m_s) // FRAMES_PER_COMPONENT, 1))
    prior = fit_prior(body, segments, name or out.stem, source, fits, min_speed_m_s=min_speed_m_s, apart=apart)
    held_out = _held_out(body, segments, prior) if check else None
    save_prior(prior, out)
    there = {joint for pieces in files.values() for pose in pieces.values() for joint in pose.names}
    lacking = tuple(marker for marker in body.markers if marker not in there)
    return PriorFit(prior, tuple(rms_mm), sizes, lacking, held_out, components)


def _labels(files: Mapping[Path, Mapping[str, Pose3D]]) -> dict[tuple[Path, str], str]:
    """A name of its own for every piece of motion: that in the file, or the file's with as many folders as it takes."""
    names = file_names([*dict.fromkeys(path.absolute() for path in files)])
    count = Counter(piece for pieces in files.values() for piece in pieces)
    labels = {}
    for path, pieces in files.items():
        for piece in pieces:
            if piece == path.stem and len(files) > 1:
                labels[path, piece] = names[path.absolute()]
            else:
                plain = len(files) == 1 or (len(pieces) == 1 and count[piece] == 1)
                labels[path, piece] = piece if plain else f"{names[path.absolute()]} {piece}"
    return labels


def _used_frames(segments: Sequence[Segment], min_speed_m_s: float) -> int:
    return sum(
        int(np.isfinite(states).all(axis=1).sum())
        for _, states, fps in segments
        if mean_speed_m_s(states, fps) >= min_speed_m_s
    )


def _held_out(body: Body, segments: Sequence[Segment], prior: MotionPrior) -> HeldOut | None:
    used = [segment for segment, row in zip(segments, prior.segments, strict=True) if row.used]
    frames = [int(np.isfinite(states).all(axis=1).sum()) for _, states, _ in used]
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
    return HeldOut(mixture, one_gaussian, fewest)


# -- input --------------------------------------------------------------------------------------------------------


def _body(skeleton: str, subject: str | None) -> Body:
    body = load_skeleton(skeleton, subject)
    if not isinstance(body, Body):
        raise InputError(Problem("--skeleton", "name or file", repr(skeleton), "a whole animal, with [[segments]]"))
    return body


def _reader(path: Path) -> Callable[[], dict[str, Pose3D]]:
    return lambda: read_pose_segments(path)


def _rates(fps: str) -> list[float]:
    """The number, or those of a JSON file."""
    expected = 'frames per second above 0, as in 120, or a JSON file with {"fps": [120, 90]}'
    try:
        rates = [float(fps)]
    except ValueError:
        path = Path(fps)
        if not path.is_file():
            raise InputError(Problem("--fps", "frame rate", repr(fps), expected)) from None
        try:
            rates = read_json(path, expected)["fps"]
            rates = [float(rate) for rate in (rates if isinstance(rates, list) else [rates])]
        except InputError:
            raise
        except (ValueError, KeyError, TypeError, OverflowError):
            raise InputError(Problem(path, "fps", "no such list of numbers", expected)) from None
    if not rates or not all(math.isfinite(rate) and rate > 0 for rate in rates):
        raise InputError(Problem("--fps", "frame rate", ", ".join(f"{rate:g}" for rate in rates) or "none", expected))
    return rates


def _check_options(out: Path, overwrite: bool, components: int, min_speed_m_s: float) -> None:
    problems = []
    if out.suffix != ".npz" or out.is_dir():
        problems.append(Problem("--out", "file", repr(str(out)), "a file name that ends in .npz"))
    elif out.exists() and not overwrite:
        problems.append(Problem("--out", "file", f"{out}, which exists", "a new file, or --overwrite"))
    if components < 1:
        problems.append(Problem("--components", "number", f"{components}", "1 or more"))
    if not (math.isfinite(min_speed_m_s) and min_speed_m_s >= 0):
        problems.append(Problem("--min-speed-m-s", "speed", f"{min_speed_m_s:g}", "0 m/s or more"))
    if problems:
        raise InputError(problems)


def _require_markers(body: Body, files: dict[Path, dict[str, Pose3D]]) -> None:
    problems = []
    for path, pieces in files.items():
        names = next(iter(pieces.values())).names
        there = sum(marker in names for marker in body.markers)
        if there < MIN_MARKERS:
            expected = f"at least {MIN_MARKERS} markers of {body.name}: {', '.join(body.markers)}"
            problems.append(Problem(path, "joints", f"{there} of {len(body.markers)}: {', '.join(names)}", expected))
    if problems:
        raise InputError(problems)


def _require_rates(rates: list[float], files: dict[Path, dict[str, Pose3D]], fps: str) -> None:
    pieces = sum(len(pieces) for pieces in files.values())
    if len(rates) not in (1, pieces):
        raise InputError(Problem(fps, "fps", f"{len(rates)} numbers", f"one, or {pieces}: one for every piece"))


def _arranged(pose: Pose3D, body: Body) -> Array:
    """(T, J, 3): the markers of the body, NaN where the file lacks them."""
    points_m = np.full((len(pose.frames), len(body.markers), 3), np.nan)
    for j, marker in enumerate(body.markers):
        if marker in pose.names:
            points_m[:, j] = pose.xyz_m[:, pose.names.index(marker)]
    return points_m


def _solved(body: Body, points_m: Array, size: float | None, path: Path) -> tuple[Array, Array, float]:
    if not (np.isfinite(points_m).all(axis=2).sum(axis=1) >= MIN_MARKERS).any():
        raise InputError(Problem(path, "frames", "too few points in each", f"{MIN_MARKERS} markers in some frame"))
    return solve_points_and_size(body, points_m, size)


def _without_gaps(frames: NDArray[np.int64]) -> Iterator[tuple[slice, str]]:
    """The rows between two jumps of the frame numbers, and what sets their name apart."""
    jumps = (np.nonzero(np.diff(frames) != 1)[0] + 1).tolist()
    for start, stop in zip([0, *jumps], [*jumps, len(frames)], strict=True):
        yield slice(start, stop), f" from {frames[start]}" if jumps else ""
