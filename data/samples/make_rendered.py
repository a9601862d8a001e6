"""Write the rendered video of this folder with its truth: python data/samples/make_rendered.py [FOLDER]."""

from __future__ import annotations

import sys
from pathlib import Path

from recon.testing.film import film_clip, render_frames, write_film


def make(folder: Path) -> None:
    """Write the video, its camera, labels of some of its frames, and the truth in the picture and in space."""
    clip, ground_m = film_clip()
    write_film(folder, clip, render_frames(clip.truth_m, clip.names, lambda t: clip.camera, ground_m))


if __name__ == "__main__":
    make(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
