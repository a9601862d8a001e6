"""Test the verdict on correct clips of a dog that stands, steps or turns on the spot.

    python benchmarks/parts/standing.py [FOLDER]

Three clips in the folder dog-mocap of $RECON_SHARED_DATA, or of ../shared/data, are divided into parts of 100 frames.
Each part is seen from the side as in `dog.py`, with the keypoint bias that the skeleton states, and is fitted like
`recon fit`. The speed is the mean speed of the centre of all joints.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
from arguments import parser_of
from dog import Clip, read_clips, write_view
from markdown_table import print_table

from recon import fit_clip

FRAMES, EVERY = 100, 150
CLIPS = ("turn00", "walk00", "run00")
LEVELS = ("use", "check", "do not use")
SLOW_M_S = 0.5


def parts_of(clip: Clip) -> list[Clip]:
    starts = range(0, len(clip.points_m) - FRAMES, EVERY)
    return [replace(clip, points_m=clip.points_m[first : first + FRAMES]) for first in starts]


def speed_m_s(part: Clip) -> float:
    steps_m = np.diff(part.points_m.mean(axis=1), axis=0)
    return float(np.linalg.norm(steps_m, axis=-1).mean() * part.fps)


def verdict_and_errors(part: Clip) -> tuple[str, list[str]]:
    """Fit a part of a clip, and return the level of the verdict and the codes of the errors among the findings."""
    with tempfile.TemporaryDirectory() as folder:
        settings, _ = write_view(part, Path(folder), seed=1, as_stated=True)
        motion = fit_clip(settings)
    assert motion.verdict is not None
    return motion.verdict.level, [item.code for item in motion.findings if item.severity == "error"]


def main() -> None:
    parser = parser_of(__doc__, kind="dog-mocap")
    arguments = parser.parse_args()
    if not arguments.folder.is_dir():
        parser.exit(message=f"no clips in {arguments.folder}: nothing measured\n")
    found = [
        (speed_m_s(part), *verdict_and_errors(part))
        for clip in read_clips(arguments.folder)
        if clip.name in CLIPS
        for part in parts_of(clip)
    ]
    rows = []
    for name, is_slow in ((f"below {SLOW_M_S} m/s", True), ("faster", False)):
        of = [(level, errors) for speed, level, errors in found if (speed < SLOW_M_S) == is_slow]
        counts = " / ".join(str(sum(level == wanted for level, _ in of)) for wanted in LEVELS)
        rows.append([name, len(of), counts, ", ".join(sorted({code for _, errors in of for code in errors})) or "none"])
    print_table(["speed", "clips", " / ".join(LEVELS), "findings that are errors"], rows)


if __name__ == "__main__":
    main()
