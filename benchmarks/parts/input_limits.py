"""Compare correct and wrong clips with the limits of `recon.check.inputs` and of `recon.check.likelihood`.

    python benchmarks/parts/input_limits.py [--views 2]

Each row has one statistic that a check compares with a constant, over the clips of one case. A constant is justified if
the statistic of correct clips does not reach it. Correct clips are all views of the cheetah-runs and plate-trials of
$RECON_SHARED_DATA, or of ../shared/data, each alone; parts of its dog-mocap as in `standing.py`; and the rendered video
of data/samples. Wrong clips are every n-th view with a case of `wrong_inputs.py`. The statistics are:

- long steps: the fraction of the steps between frames that exceed `LONG_STEP_RATIO` times the steps around them
- long steps by themselves: the fraction of the long steps that exceed `ISOLATED_STEP_RATIO` times both their
  neighbours, for clips with more long steps than `LONG_STEP_FRACTION`
- feet below trunk: `feet_below_trunk`, which does not depend on a fit
- zoom: the size of the fitted zoom per second, as a logarithm, up to `MAX_ZOOM_FACTOR` times `ZOOM_PER_S`; 0 if a
  single zoom shows that it is less than `ZOOM_PER_S`
- feet backwards: the backward speed of standing feet, relative to the speed of the body over the feet, for clips in
  which the body moves faster over its feet than `SLIDE_LEGS_S`
- feet, m/s: the speed of standing feet along the trunk
- body over feet: the speed of the body over the feet, leg lengths per second, for clips whose feet move backwards by
  more than `SLIDE_RATIO`
- feet on the ground: the speed of the lowest feet, relative to the speed of standing feet, for clips whose feet
  seem to slide
- jolts: the terms of the fit's cost, named in `MAX_PATH_COSTS`, that a jolt of the body's path raises
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from unittest.mock import patch

import numpy as np
from arguments import parser_of
from dog import read_clips, write_view
from markdown_table import print_table
from recordings import recordings
from standing import CLIPS, parts_of
from wrong_inputs import CASES, Case, Clip, Given, fitted, follows, hidden, lower_leg, views

from recon import FitSettings, InputError, Motion, fit_clip
from recon.animal.prior import MotionPrior
from recon.api import clip as clip_api
from recon.api.clip_inputs import prepare
from recon.api.samples import samples_folder
from recon.check import inputs, likelihood
from recon.clip import views_of
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.motion import trajectory_solution


def legs_alone(clip: Clip, given: Given) -> Given:
    """Keep only the keypoints of the lower legs, seen by a camera that follows the animal."""
    return hidden(lambda name: not lower_leg(name))(clip, follows(clip, given))


UNTOUCHED, DOGS, VIDEO = "untouched", "dogs", "rendered video"
STEPS = {
    **{name: CASES[name] for name in ("right: half missing", "right: a side hidden", "right: comes into the picture")},
    "right: lower legs alone, followed": Case(legs_alone),
    "a quarter of frames dropped": CASES["a quarter of frames dropped"],
}
"""Cases without a fit, in which the steps between frames are measured."""
TURNED = {name: CASES[name] for name in ("portrait", "y-up world", "upside down", "y up in the picture")}
"""Cases without a fit, in which the animal does not stand upright in the picture."""
MOVING = {name: CASES[name] for name in ("follows", "on a belt that slows down", "pans by 400 px")}
"""Cases in which standing feet slide over the ground."""
FITTED = {**MOVING, **{name: CASES[name] for name in ("zooms x 1.5", "stabiliser's crop", "interpolated, every 8th")}}
"""Cases of wrong inputs that are fitted."""
_RIGHT = (UNTOUCHED, DOGS, VIDEO)
_SLIDING = (*_RIGHT, *MOVING)
STATISTICS = {
    "long steps": (f"{inputs.LONG_STEP_FRACTION}", (UNTOUCHED, DOGS, *STEPS)),
    "long steps by themselves": (f"{inputs.ISOLATED_STEP_FRACTION}", (UNTOUCHED, DOGS, *STEPS)),
    "feet below trunk": (f"{likelihood.UPRIGHT_RATIO}", (UNTOUCHED, DOGS, *TURNED)),
    "zoom": (f"{likelihood.ZOOM_PER_S}", (*_RIGHT, "zooms x 1.5")),
    "feet backwards": (f"{inputs.SLIDE_RATIO}", _SLIDING),
    "feet, m/s": (f"{inputs.SLIDE_M_S} to {inputs.GLIDE_M_S}", _SLIDING),
    "body over feet": (f"{inputs.SLIDE_LEGS_S}", _SLIDING),
    "feet on the ground": ("0.5", _SLIDING),
    **{f"jolts, {name}": (f"{limit}", (*_RIGHT, *FITTED)) for name, limit in inputs.MAX_PATH_COSTS.items()},
}
"""Limit of each statistic as a string, and the cases for which the statistic is shown."""

Statistics = dict[str, float]
"""Value of each of `STATISTICS` that applies to a clip."""


@dataclass(frozen=True)
class Group:
    """Statistics of all clips of one case."""

    name: str
    statistics: Sequence[Statistics]


def statistics_of_keypoints(settings: FitSettings) -> Statistics:
    """Return the statistics of a clip's keypoints, which need no fit."""
    given = prepare(settings)
    keypoints, (view, *_) = given.sources[0].keypoints, views_of(given.sources)
    clip = ClipProblem.from_views((view,), given.body, given.prior, given.fps, TrajectoryOptions())
    found = {"feet below trunk": likelihood.feet_below_trunk(clip, view)}
    ratios = inputs.step_ratios(keypoints.xy_px)
    if ratios is not None:
        is_long, _, is_alone = inputs.long_steps(ratios)
        found["long steps"] = float(is_long.mean())
        if found["long steps"] > inputs.LONG_STEP_FRACTION:
            found["long steps by themselves"] = float(is_alone.sum() / is_long.sum())
    return found


def statistics_of_motion(motion: Motion, prior: MotionPrior, options: TrajectoryOptions) -> Statistics:
    """Return the statistics of a fit, as `input_findings` computes them."""
    solution = trajectory_solution(motion)
    found = {f"jolts, {name}": cost for name, cost in inputs.jolt_costs(motion).items()}
    clip = ClipProblem.from_views(solution.views, motion.body, prior, motion.fps, options)
    zooms: list[float] = []

    def zoom_of(gain: float, opposite_gain: float, unpatched: Callable[..., float] = likelihood.zoom_of) -> float:
        zooms.append(unpatched(gain, opposite_gain))
        return zooms[-1]

    with patch.object(likelihood, "zoom_of", zoom_of):
        baseline = likelihood.baseline_of(clip, 0, solution.states, solution.size)
        list(likelihood.lens_findings(baseline, solution.noise_px[0]))
    found["zoom"] = zooms[0] if zooms else 0.0
    speeds = inputs.feet_speeds(motion)
    if speeds is None:
        return found
    found["feet, m/s"] = speeds.slowest_m_s
    legs_s, fraction = speeds.over_feet_m_s / speeds.leg_m, -speeds.slowest_m_s / speeds.over_feet_m_s
    if legs_s > inputs.SLIDE_LEGS_S:
        found["feet backwards"] = fraction
    if fraction > inputs.SLIDE_RATIO:
        found["body over feet"] = legs_s
    if inputs.seem_to_slide(speeds):
        found["feet on the ground"] = inputs.on_ground_m_s(motion) / speeds.slowest_m_s
    return found


def statistics_of(run: Callable[[], object], stage: str) -> Statistics:
    """Run a fit up to a stage, "prepare" or "input_findings", and return the statistics there.

    The statistics are empty if the input is refused.
    """
    found: Statistics = {}

    class FinishedError(Exception):
        """Raised to end a fit as soon as its statistics are known."""

    def before_fit(settings: FitSettings) -> None:
        found.update(statistics_of_keypoints(settings))
        raise FinishedError

    def after_fit(motion: Motion, prior: MotionPrior, options: TrajectoryOptions, *_: object) -> None:
        found.update(statistics_of_motion(motion, prior, options))
        raise FinishedError

    replacement = before_fit if stage == "prepare" else after_fit
    with patch.object(clip_api, stage, replacement), suppress(InputError, FinishedError):
        run()
    return found


def fit_of_view(clip: Clip, case: Case) -> None:
    with tempfile.TemporaryDirectory() as folder:
        fitted(clip, case, Path(folder))


def fits_of_dogs() -> Iterator[Callable[[], object]]:
    """Yield functions that fit parts of the dog's clips."""
    folder = recordings("dog-mocap")
    for clip in read_clips(folder) if folder.is_dir() else ():
        for part in parts_of(clip) if clip.name in CLIPS else ():

            def fit(part=part) -> None:
                with tempfile.TemporaryDirectory() as files:
                    fit_clip(write_view(part, Path(files), seed=1, as_stated=True)[0])

            yield fit


def fit_of_video() -> None:
    points, camera = (samples_folder() / f"rendered_{name}" for name in ("points.csv", "camera.toml"))
    fit_clip(FitSettings(keypoints=(points,), camera=(camera,), fps=120.0))


def groups(every: int) -> Iterator[Group]:
    """Yield the statistics of the clips of each case; wrong cases use only one in `every` views."""
    untouched = {UNTOUCHED: CASES[UNTOUCHED]}

    def fits(case: Case, step: int) -> list[Callable[[], object]]:
        return [partial(fit_of_view, view, case) for view in views()[::step]]

    for name, case in (untouched | STEPS | TURNED).items():
        yield Group(name, [statistics_of(fit, "prepare") for fit in fits(case, 1)])
    yield Group(DOGS, [statistics_of(fit, "prepare") for fit in fits_of_dogs()])
    for name, case in (untouched | FITTED).items():
        step = 1 if name == UNTOUCHED else every
        yield Group(name, [statistics_of(fit, "input_findings") for fit in fits(case, step)])
    yield Group(DOGS, [statistics_of(fit, "input_findings") for fit in fits_of_dogs()])
    yield Group(VIDEO, [statistics_of(fit_of_video, "input_findings")])


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--views", type=int, default=2, help="every n-th view in wrong cases (default: %(default)s)")
    arguments = parser.parse_args()
    measured = [*groups(arguments.views)]
    if not any(measured[0].statistics):
        parser.exit(message="no recordings: nothing measured\n")
    rows = []
    for statistic, (limit, cases) in STATISTICS.items():
        for group in (group for group in measured if group.name in cases):
            values = [found[statistic] for found in group.statistics if statistic in found]
            if values:
                ends = [f"{value:.2f}" for value in np.quantile(values, [0.0, 0.5, 1.0])]
                rows.append([statistic, group.name, len(values), *ends, limit])
    print_table(["statistic", "case", "clips", "smallest", "median", "largest", "limit"], rows)


if __name__ == "__main__":
    main()
