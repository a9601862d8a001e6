"""Compare the likelihood of clips with a wrong and with the correct camera file.

    python benchmarks/parts/true_camera.py [--jobs 2] [--views 6]

The clips of wrong_inputs.py (every view and pair of the cheetah-runs and plate-trials of $RECON_SHARED_DATA, or of
../shared/data; --views n: every n-th) are fitted with the wrong inputs that change nothing but the camera file. If
the verdict is "use" although the error of pose or position is above the upper end of its stated interval, the same
keypoints are fitted with the correct file. No test can gain more than the correct file does, because a test has to
search for the correct camera.

The log-likelihood covers the detections, the motion, the ground's height and slope, and the animal's size. Errors
within the correlation time count once. Pairs are compared with their poses as given. Gains above 3 (twenty times as
likely) could be called clear.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from arguments import parser_of
from markdown_table import print_table
from wrong_inputs import BOUNDS, CASES, PLAIN, Case, Clip, Given, clips, fitted, measured

from recon import InputError, Motion
from recon.fit import constants
from recon.fit.motion import trajectory_solution
from recon.fit.terms import SIZE

KINDS = {
    "one camera, another focal length": [name for name in CASES if name.startswith("focal length")],
    "one camera, file of another camera": ["the same, with this camera's name"],
    "one camera, turned by 10 degrees": ["turned 10 degrees sideways"],
    "one camera, origin 0.3 m off": [name for name in CASES if name.startswith("origin 0.3 m")],
    "two cameras, one turned by 2 to 6 degrees": [name for name in CASES if name.startswith("two, one turned")],
    "two cameras, one moved by 0.25 or 0.5 m": [name for name in CASES if name.startswith("two, one moved")],
}
"""Cases of wrong_inputs.py with the keypoints of the correct input and a wrong camera file."""
CLEAR = 3.0
"""Log-likelihood gain above which the correct file counts as clearly more likely."""


def log_likelihood(motion: Motion) -> float:
    """Return the log-likelihood of a motion, up to a constant that depends only on its keypoints."""
    solution = trajectory_solution(motion)
    cost = sum(value for name, value in solution.cost_by_term.items() if name != SIZE)
    for view, noise_px in zip(solution.views, solution.noise_px, strict=True):
        cost += 2.0 * float(np.log(noise_px)[view.present & np.isfinite(solution.markers_m[..., 0])].sum())
    cost /= max(constants.ERROR_TIME_S * motion.fps, 1.0)
    cost += 0.5 * ((solution.size - 1.0) / motion.body.size_sigma) ** 2
    middle_m = np.nanmean(solution.joints_m, axis=(0, 1))
    for segment in solution.segments:
        if segment.ground is not None:
            height_m = segment.ground.height_m + float(segment.ground.slope @ middle_m[:2])
            sigma_m = np.hypot(constants.GROUND_HEIGHT_M, segment.ground.sigma_m)
            slopes = float(np.sum((segment.ground.slope / constants.GROUND_SLOPE) ** 2))
            cost += 0.5 * (float(height_m / sigma_m) ** 2 + slopes)
    return -cost


def fit(clip: Clip, name: str, as_given: bool = False) -> tuple[Motion, Given] | None:
    """Fit a clip with the change of a case, or return None if the fit is refused.

    If `as_given` is true, the poses of the cameras are not refined.

    `name` is the name of the case in `wrong_inputs.py`.
    """
    case = CASES[name]

    def change(clip: Clip, given: Given) -> Given:
        changed = case.change(clip, given)
        return replace(changed, settings=changed.settings | {"cameras_known": True}) if as_given else changed

    with tempfile.TemporaryDirectory() as folder:
        try:
            return fitted(clip, Case(change, two=case.two, both=case.both), Path(folder))
        except InputError:
            return None


def row(clip: Clip, kind: str, name: str) -> dict[str, Any] | None:
    """Fit a clip with a wrong camera file, and measure the gain of the correct file if the verdict is wrongly "use"."""
    wrong = fit(clip, name)
    if wrong is None or wrong[0].verdict is None:
        return None
    motion, given = wrong
    assert motion.verdict is not None
    figures = measured(clip, given, motion)
    use = motion.verdict.level == "use"
    beyond = use and any(figures[of] > figures[bound] for of, bound in BOUNDS.items())
    gain = np.nan
    if beyond:
        two = len(clip.cameras) == 2
        fits = [fit(clip, of, as_given=two) for of in (next(n for n in PLAIN if PLAIN[n] == two), name)]
        right, given_wrong = (log_likelihood(one[0]) if one else np.nan for one in fits)
        gain = right - given_wrong
    return {"kind": kind, "case": name, "run": clip.run.name, "use": use, "beyond": beyond, "gain": gain}


def rows_of(clip: Clip) -> list[dict[str, Any]]:
    """Fit a clip with all cases for its number of cameras, and return their rows."""
    names = [(kind, name) for kind, of_kind in KINDS.items() for name in of_kind]
    rows = [row(clip, kind, name) for kind, name in names if CASES[name].two == (len(clip.cameras) == 2)]
    return [one for one in rows if one is not None]


def cells(name: str, part: pd.DataFrame) -> Sequence[Any]:
    """Summarise the fits of one kind of wrong camera file as a table row."""
    gains = part["gain"].dropna()
    spread = f"{gains.median():.1f} ({gains.min():.1f} to {gains.max():.1f})" if len(gains) else ""
    return [name, len(part), part["use"].sum(), part["beyond"].sum(), spread, (gains > CLEAR).sum()]


def main() -> None:
    parser = parser_of(__doc__, "--jobs", "--csv")
    parser.add_argument("--views", type=int, default=1, help="every n-th clip only (default: all)")
    arguments = parser.parse_args()
    with ProcessPoolExecutor(arguments.jobs) as pool:
        rows = [one for of_clip in pool.map(rows_of, clips(arguments.views)) for one in of_clip]
    if not rows:
        parser.exit(message="no recordings: nothing measured\n")
    table = pd.DataFrame(rows)
    if arguments.csv:
        table.to_csv(arguments.csv, index=False)
    kinds = [(kind, table[table["kind"] == kind]) for kind in KINDS]
    print_table(
        [
            *("wrong camera file", "fits", '"use"', '"use", error beyond its interval'),
            "gain of the correct file in these: median (least to largest)",
            f"gain above {CLEAR:g}",
        ],
        [*(cells(kind, part) for kind, part in kinds if len(part)), cells("all", table)],
    )


if __name__ == "__main__":
    main()
