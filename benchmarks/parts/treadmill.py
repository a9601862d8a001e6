"""Compare dogs on a simulated treadmill with the same motion over ground.

    python benchmarks/parts/treadmill.py [FOLDER]

Each clip of a dog's motion capture with a mean speed of at least `SLOWEST_M_S` is moved back by its mean velocity, seen
by one camera from the side as in `dog.py`, and fitted with the belt's speed. Its speed, stride length and stances are
compared with the values of the markers over ground. FOLDER is by default the dog-mocap of $RECON_SHARED_DATA, or of
../shared/data.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from arguments import parser_of
from dog import Clip, marker_gait, read_clips, write_view
from markdown_table import print_table

from recon import fit_clip
from recon.gait.clip import ClipAnalysis
from recon.gait.gait import match_stances

SLOWEST_M_S = 0.9


def on_belt(clip: Clip) -> tuple[Clip, float]:
    """Subtract a clip's mean horizontal velocity, as on a treadmill, and return clip and belt speed, m/s."""
    time_s = np.arange(len(clip.points_m)) / clip.fps
    velocity_m_s = np.polyfit(time_s, clip.points_m.mean(axis=1), 1)[0] * [1.0, 1.0, 0.0]
    moved_m = (time_s - time_s.mean())[:, None, None] * velocity_m_s
    return replace(clip, points_m=clip.points_m - moved_m), float(np.linalg.norm(velocity_m_s))


def rows(folder: Path) -> Iterator[dict]:
    for seed, clip in enumerate(read_clips(folder)):
        stays, speed_m_s = on_belt(clip)
        if speed_m_s < SLOWEST_M_S:
            continue
        marked = marker_gait(clip)
        with tempfile.TemporaryDirectory() as written:
            settings, _ = write_view(stays, Path(written), seed)
            found = ClipAnalysis(fit_clip(replace(settings, belt_speed_m_s=speed_m_s))).gait
        assert found is not None
        pairs = match_stances(marked.stances, found.stances)
        yield {
            "clip": clip.name,
            "belt m/s": f"{speed_m_s:.2f}",
            "speed": f"{found.speed_m_s / marked.speed_m_s - 1:+.1%}",
            "stride length": f"{found.stride_length_m / marked.stride_length_m - 1:+.1%}",
            "stances": len(marked.stances),
            "missed": len(marked.stances) - len(pairs),
            "extra": len(found.stances) - len(pairs),
            "gait (markers)": f"{found.name.name} ({marked.name.name})",
        }


def main() -> None:
    found = list(rows(parser_of(__doc__, kind="dog-mocap").parse_args().folder))
    print_table(list(found[0]), [row.values() for row in found])


if __name__ == "__main__":
    main()
