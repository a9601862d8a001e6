"""Fit the constants of the verdict, and test its expected errors and levels on runs that are left out.

    python benchmarks/parts/verdict.py [--jobs 2] [--csv TABLE.csv]

The fits use the cheetah-runs and plate-trials of $RECON_SHARED_DATA, or of ../shared/data, as `recon fit` does: every
view alone, with the measured lengths of the animal if known; two cameras; all cameras; and every view with `WORSE`
detections, which have a smaller weight (`WORSE_WEIGHT`). The constants of `recon.check.verdict` are fitted to all runs
but one by least squares in logarithms, and tested on that run. The last row is for all runs, and has the values that
the code uses. The effect of missing pixel information and the spread are fitted to the residuals, because pixel
information is hardly missing in unchanged clips. The code has a larger spread for full pixel information, because of
clips of 15 frames.

Wrong inputs that double an error, and the verdicts on them, are in `wrong_inputs.py` and `left_right_swaps.py`.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from arguments import parser_of, runs_of
from markdown_table import print_table
from recordings import recordings
from scipy.stats import spearmanr
from wrong_inputs import Case, Clip, Given, cameras_of, fitted, hidden, lower_leg, measured, without

from recon import InputError
from recon.animal.body import side_of
from recon.animal.skeleton_file import builtin_subjects
from recon.base.documents import builtin_file
from recon.check import verdict
from recon.check.verdict import Evidence, evidence_of

WORSE_WEIGHT = 0.05
"""Weight of a view with `WORSE` detections in the fit of the constants, relative to an unchanged view."""
RIDGE = 1.0
"""Strength of the ridge penalty on the powers of the factors, for factors in standard scores."""
USE_BELOW_MM = 130
"""Pose error above which the verdict on a view should not be "use", mm."""
NOT_ABOVE_MM = 90
"""Pose error below which the verdict on a view should not be "do not use", mm."""
COLUMNS = (
    *("clips", "number", "rank correlation", "error / expected, 90 % of use", "pose inside", "position inside"),
    *("use / check / do not use", "do not use, below 90 mm", "use, above 130 mm", "warnings with use"),
)
AS_IT_IS = ("one", "one, lengths known", "two", "all")


def lengths_known(clip: Clip, given: Given) -> Given:
    subject = builtin_file("animal/subjects", f"{clip.meta['subject']}.toml")
    return replace(given, settings={"subject": subject.read_text(encoding="utf-8")})


def first_half(clip: Clip, given: Given) -> Given:
    T = len(given.xy_px) // 2
    return given.seen(given.xy_px[:T], given.keypoints.frames[:T])


def noisier(share: float) -> Callable[[Clip, Given], Given]:
    """Return a change that adds noise, whose size is a fraction of the animal's extent in the picture."""

    def change(clip: Clip, given: Given) -> Given:
        low, high = np.nanmin(given.xy_px, axis=1), np.nanmax(given.xy_px, axis=1)
        sigma_px = share * np.nanmedian(np.linalg.norm(high - low, axis=1))
        return given.seen(given.xy_px + clip.rng.normal(0.0, sigma_px, given.xy_px.shape))

    return change


def half_the_frames(clip: Clip, given: Given) -> Given:
    frames = given.keypoints.frames[::2]
    settings = {"fps": clip.meta["fps"] / 2}
    return given.seen(given.xy_px[::2], np.arange(len(frames)), frame=lambda t: frames[t], settings=settings)


WORSE = {
    "first half": Case(first_half),
    "half the frames": Case(half_the_frames),
    "30 % missing": Case(without(0.3)),
    "60 % missing": Case(without(0.6)),
    "noise of 2 %": Case(noisier(0.02)),
    "noise of 6 %": Case(noisier(0.06)),
    "one side hidden": Case(hidden(lambda name: side_of(name) == "right")),
    "lower legs hidden": Case(hidden(lower_leg)),
}
"""Changes after which detections are still correct, but fewer or less precise."""


def tasks() -> Iterator[tuple[Clip, str]]:
    for kind in ("cheetah-runs", "plate-trials"):
        for run in runs_of(recordings(kind)):
            names = cameras_of(run)
            views = [Clip(run, (name,)) for name in names]
            yield from ((view, "one") for view in views)
            if views[0].meta.get("subject") in builtin_subjects():
                yield from ((view, "one, lengths known") for view in views)
            yield from ((Clip(run, (names[0], name)), "two") for name in names[1:3])
            if len(names) > 2:
                yield Clip(run, tuple(names)), "all"
            yield from ((view, label) for view in views for label in WORSE)


def row(task: tuple[Clip, str]) -> dict[str, Any]:
    clip, label = task
    change = lengths_known if label.endswith("known") else lambda clip, given: given
    case = WORSE.get(label) or Case(change, two=label in ("two", "all"))
    about = {"run": clip.run.name, "cameras": "+".join(clip.cameras), "label": label}
    with tempfile.TemporaryDirectory() as folder:
        try:
            motion, given = fitted(clip, case, Path(folder))
        except InputError:
            return about
    if not motion.solved.any():
        return about
    serious = [one.code for one in motion.findings if one.severity != "note"]
    errors = any(one.severity == "error" for one in motion.findings)
    known = {"warnings": len(serious), "codes": " ".join(serious), "errors": errors}
    return about | known | measured(clip, given, motion) | asdict(evidence_of(motion))


def evidence(of: pd.Series) -> Evidence:
    return Evidence(**{name: of[name] for name in Evidence.__dataclass_fields__})


def fit(table: pd.DataFrame) -> dict[str, float]:
    """Fit the verdict's constants to a table of views, by least squares in the logarithm of error / trunk length.

    The result has the "constant", and the power of each factor.
    """
    factors = pd.DataFrame([evidence(one).factors for _, one in table.iterrows()])
    unseen = factors.pop("unseen")
    error = np.log(table["pose_mm"].to_numpy() / 1000 / table["trunk_m"].to_numpy())
    weight = np.where(table["label"].isin(AS_IT_IS), 1.0, WORSE_WEIGHT)
    middle, spread = factors.mean(), factors.std()
    scores = ((factors - middle) / spread).to_numpy()
    centre = np.average(scores, axis=0, weights=weight)
    scores, mean = scores - centre, np.average(error, weights=weight)
    normal = (scores * weight[:, None]).T @ scores + RIDGE * np.eye(scores.shape[1])
    slopes = np.linalg.solve(normal, (scores * weight[:, None]).T @ (error - mean)) / spread.to_numpy()
    constant = mean - slopes @ (middle.to_numpy() + centre * spread.to_numpy())
    left = error - constant - factors @ slopes
    found = {"constant": float(constant), **dict(zip(factors.columns, slopes, strict=True))}
    return found | {"unseen": float(left @ unseen / (unseen @ unseen))}


def spreads(table: pd.DataFrame) -> list[float]:
    """Return `LOG_ERROR_SIGMA` and `SPREAD_UNSEEN` of the verdict, fitted to the squared residuals of the views."""
    squares = np.log((table["pose_mm"] / table["expected mm"]).to_numpy(float)) ** 2
    known = np.stack([np.ones(len(table)), table["unseen"].to_numpy() ** 2], axis=1)
    return [float(np.sqrt(max(of, 0.0))) for of in np.linalg.lstsq(known, squares, rcond=None)[0]]


def judge(table: pd.DataFrame, constants: dict[str, float]) -> pd.DataFrame:
    """Compute the expected errors and the verdict's level of each view from the verdict's constants."""
    verdict.SCALE, verdict.POWERS = constants["constant"], {n: c for n, c in constants.items() if n != "constant"}
    found = []
    for _, one in table.iterrows():
        pose, position = verdict.expected_pose_of_trunk(evidence(one)), verdict.expected_position(evidence(one))
        mm = {f"{end} mm": 1000 * one["trunk_m"] * getattr(pose, end) for end in ("expected", "low", "high")}
        m = {f"{end} m": getattr(position, end) for end in ("expected", "low", "high")}
        level = verdict.level_of(pose, error=one["errors"], warning=one["warnings"] > 0)
        found.append(mm | m | {"level": level})
    return table.reset_index(drop=True).join(pd.DataFrame(found))


def figures(label: str, of: pd.DataFrame) -> list[Any]:
    pose, expected = of["pose_mm"], of["expected mm"]
    use, off = of["level"] == "use", of["level"] == "do not use"
    inside = pose.between(of["low mm"], of["high mm"])
    placed = of["position_m"].between(of["low m"], of["high m"])
    return [
        label,
        len(of),
        f"{spearmanr(expected, pose).statistic:.2f}",
        f"{np.percentile(pose[use] / expected[use], 90):.2f}" if use.any() else "",
        f"{inside.mean():.0%}",
        f"{placed.mean():.0%}",
        " / ".join(str((of["level"] == level).sum()) for level in ("use", "check", "do not use")),
        f"{(off & (pose < NOT_ABOVE_MM)).sum()} of {(pose < NOT_ABOVE_MM).sum()}",
        f"{(use & (pose > USE_BELOW_MM)).sum()} of {(pose > USE_BELOW_MM).sum()}",
        f"{of['warnings'][use].mean():.2f}, {of['warnings'][use].max()}" if use.any() else "",
    ]


def main() -> None:
    parser = parser_of(__doc__, "--jobs", "--csv")
    arguments = parser.parse_args()
    with ProcessPoolExecutor(arguments.jobs) as pool:
        table = pd.DataFrame(pool.map(row, tasks(), chunksize=4))
    if not len(table):
        parser.exit(message="no recordings: nothing measured\n")
    table = table[np.isfinite(table["pose_mm"])].reset_index(drop=True)
    runs = sorted(set(table["run"]))
    constants = {run: fit(table[table["run"] != run]) for run in runs}
    left_out = pd.concat([judge(table[table["run"] == run], constants[run]) for run in runs])
    if arguments.csv:
        left_out.to_csv(arguments.csv, index=False)
    names = ["constant", *verdict.POWERS]
    rows = []
    for run, of in (constants | {"none": fit(table)}).items():
        left = spreads(left_out[left_out["run"] != run])
        rows.append([run, *(f"{value:.3f}" for value in (*(of[name] for name in names), *left))])
    print_table(["left out", *names, "spread", "spread of unseen"], rows)
    print()
    print_table(
        COLUMNS,
        [
            figures(label, left_out[left_out["label"].isin(labels)])
            for label, labels in [
                *((name, [name]) for name in AS_IT_IS),
                ("as they are", AS_IT_IS),
                *((name, [name]) for name in WORSE),
                ("all", [*AS_IT_IS, *WORSE]),
            ]
        ],
    )


if __name__ == "__main__":
    main()
