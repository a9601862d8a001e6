"""Plant faults in detections, correct the first entries of to_correct.csv with the truth, and fit again.

    python benchmarks/parts/planted_faults.py [--seeds 5]

A simulated gallop of 90 frames has 2 px of noise and 40 faults: 20 single detections with errors of 20 to 150 px, and 4
keypoints that stay at one pixel for 5 frames. The first 40 entries of the list are replaced by the true positions of
their keypoints. The error is the mean distance of the joints from the truth, both poses centred.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from markdown_table import print_table

from recon.api.clip import fit_clip
from recon.api.settings import FitSettings
from recon.base.arrays import Array
from recon.check.to_correct import to_correct
from recon.clip import Keypoints
from recon.fit.motion import Motion
from recon.io.camera_files import write_camera
from recon.io.corrections import Correction, write_corrections
from recon.io.deeplabcut import write_csv
from recon.testing.film import film_clip
from recon.testing.gallop import SyntheticClip

NOISE_PX, SINGLE, RUNS, RUN_FRAMES = 2.0, 20, 4, 5
FAULTS = SINGLE + RUNS * RUN_FRAMES


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    seeds = range(parser.parse_args().seeds)
    clip, _ = film_clip()
    rows = [row(clip, seed) for seed in seeds]
    header = ["faults", "of these among the first 40", "error without faults, mm", "with faults", "corrected"]
    print_table(header, rows)


def row(clip: SyntheticClip, seed: int) -> list[str]:
    """Plant faults, correct the listed ones, and return their numbers and the errors of the three fits, mm."""
    exact = clip.keypoints
    noisy, with_faults, faults = detections(clip, np.random.default_rng(seed))
    with tempfile.TemporaryDirectory() as folder:
        fits = Fits(Path(folder), clip)
        clean, faulty = fits.fit(noisy), fits.fit(with_faults)
        listed = to_correct(faulty)[:FAULTS]
        cells = [(int(np.searchsorted(exact.frames, item.frame)), exact.names.index(item.keypoint)) for item in listed]
        corrections = [
            Correction(item.frame, item.camera, item.keypoint, item.found_px, tuple(exact.xy_px[cell].tolist()))
            for item, cell in zip(listed, cells, strict=True)
            if np.isfinite(exact.xy_px[cell]).all()
        ]
        corrected = fits.fit(with_faults, corrections)
        hits = len({*cells} & faults)
        return [str(len(faults)), str(hits), *(f"{fits.error_mm(motion):.1f}" for motion in (clean, faulty, corrected))]


def detections(clip: SyntheticClip, rng: np.random.Generator) -> tuple[Keypoints, Keypoints, set[tuple[int, int]]]:
    """Add noise and faults to a clip's detections.

    Returns
    -------
    tuple
        The detections with noise, the detections with noise and faults, and the faults as (frame, keypoint).
    """
    exact = clip.keypoints
    noisy = replace(exact, xy_px=exact.xy_px + rng.normal(0, NOISE_PX, exact.xy_px.shape))
    xy_px, faults = noisy.xy_px.copy(), dict(planted(noisy, rng))
    for (t, k), point_px in faults.items():
        xy_px[t, k] = point_px
    return noisy, replace(noisy, xy_px=xy_px), {*faults}


def planted(keypoints: Keypoints, rng: np.random.Generator) -> Iterator[tuple[tuple[int, int], Array]]:
    """Yield the cell (frame, keypoint) of each fault, and the wrong position there, pixels."""
    taken: set[tuple[int, int]] = set()
    free = {(int(t), int(k)) for t, k in np.argwhere(keypoints.present)}
    T, K = keypoints.present.shape
    runs = 0
    while runs < RUNS:
        first, k = int(rng.integers(T - RUN_FRAMES)), int(rng.integers(K))
        cells = {(first + i, k) for i in range(RUN_FRAMES)}
        if cells <= free - taken:
            taken |= cells
            runs += 1
            stuck_px = keypoints.xy_px[first, k] + displacement_px(rng, 40.0)
            yield from ((cell, stuck_px) for cell in sorted(cells))
    while len(taken) < FAULTS:
        cell = int(rng.integers(T)), int(rng.integers(K))
        if cell in free - taken:
            taken.add(cell)
            yield cell, keypoints.xy_px[cell] + displacement_px(rng, 20.0)


def displacement_px(rng: np.random.Generator, least_px: float) -> Array:
    length, angle = rng.uniform(least_px, 150.0), rng.uniform(0, 2 * np.pi)
    return length * np.array([np.cos(angle), np.sin(angle)])


class Fits:
    """Fits of a clip's detections, with their errors relative to the truth."""

    def __init__(self, folder: Path, clip: SyntheticClip) -> None:
        self.folder, self.clip, self.camera = folder, clip, folder / "camera.toml"
        write_camera(clip.camera, self.camera)

    def fit(self, keypoints: Keypoints, corrections: list[Correction] | None = None) -> Motion:
        files = self.folder / "points.csv", self.folder / "corrections.csv"
        write_csv(keypoints, files[0])
        write_corrections(corrections or [], files[1])
        settings = FitSettings(keypoints=(files[0],), camera=(self.camera,), fps=keypoints.fps)
        return fit_clip(replace(settings, corrections=files[1] if corrections else None))

    def error_mm(self, motion: Motion) -> float:
        order = [self.clip.names.index(name) for name in motion.names]
        pairs = motion.joints_m, self.clip.truth_m[:, order]
        centred = [points - points.mean(axis=1, keepdims=True) for points in pairs]
        return 1e3 * float(np.nanmean(np.linalg.norm(centred[0] - centred[1], axis=-1)))


if __name__ == "__main__":
    main()
