"""Measure the time of a fit after one correction, started from the earlier motion.

    python benchmarks/parts/refit.py [FRAMES ...]

A simulated run around one camera (`long_clips.py`) is fitted, one detection is moved by 40 px, and `refit_clip` fits
again as `recon fix` does after each click. The table has wall-clock times and, in brackets, processor times, which do
not depend on other programs on the machine. "difference" is the mean distance between the joints of this fit and of a
fit from scratch with the same correction.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
from long_clips import write_inputs
from markdown_table import print_table
from threadpoolctl import threadpool_limits
from trajectory import FPS

from recon.api.clip import fit_clip, refit_clip
from recon.api.settings import FitSettings
from recon.fit.motion import Motion
from recon.io.corrections import Correction, write_corrections

MOVED_PX = 40.0


def settings_of(folder: Path, frames: int) -> FitSettings:
    """Write the keypoints and the camera of a simulated run as files, and return the settings of the fit."""
    write_inputs(folder, f"{frames}x1")
    return FitSettings(keypoints=(folder / "run_cam0.csv",), camera=(folder / "cameras.toml",), fps=FPS)


def corrected(settings: FitSettings, motion: Motion, folder: Path) -> FitSettings:
    """Move one detection in the middle of the clip, and return the settings with this correction."""
    picture, row = motion.pictures[0], len(motion.frames) // 2
    joint = int(np.flatnonzero(picture.present[row])[0])
    x, y = picture.reprojected_px[row, joint].tolist()
    correction = Correction(int(motion.frames[row]), "", motion.names[joint], None, (x + MOVED_PX, y))
    write_corrections([correction], folder / "corrections.csv")
    return replace(settings, corrections=folder / "corrections.csv")


def row(frames: int) -> list[str]:
    """Measure the times of a refit and a fit from scratch, and their difference, for one length of clip."""
    with tempfile.TemporaryDirectory() as name, threadpool_limits(1):
        folder = Path(name)
        settings = settings_of(folder, frames)
        motion = fit_clip(settings)
        changed = corrected(settings, motion, folder)
        seconds, spent, fits = [], [], []
        for fit in (lambda: refit_clip(changed, motion), lambda: fit_clip(changed)):
            began, began_here = time.perf_counter(), time.process_time()
            fits.append(fit().joints_m)
            seconds.append(time.perf_counter() - began)
            spent.append(time.process_time() - began_here)
    apart_m = float(np.nanmean(np.linalg.norm(fits[0] - fits[1], axis=-1)))
    times = (f"{wall:.2f} ({own:.2f})" for wall, own in zip(seconds, spent, strict=True))
    return [str(frames), *times, f"{1000 * apart_m:.2f}"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=int, nargs="*", default=[60, 600])
    header = ["frames", "refit, s (processor)", "fit from scratch, s (processor)", "difference, mm"]
    print_table(header, [row(frames) for frames in parser.parse_args().frames])


if __name__ == "__main__":
    main()
