"""Test the estimated rotation of cameras on virtual pans, which are cut out of the videos of static cameras.

    python benchmarks/parts/camera_motion.py [FOLDER] [--case NAME]

Each video of a static camera is treated as if a pinhole camera had recorded it. A virtual camera with the same centre
and a narrower view turns inside its picture, with shake. Its pictures are resampled (bilinear, blurred by the rotation
during half of each frame's time). A subject is pasted over 20 or 40 % of the picture: a mirrored part of the same
picture that stays in the middle of the view, as if followed, and moves to and fro. Errors are angles between the
estimated and the true rotation since the first frame. FOLDER is by default the still-videos of $RECON_SHARED_DATA, or
of ../shared/data; without videos, nothing is measured.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from arguments import parser_of
from markdown_table import print_table
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation

from recon.calibrate.camera_motion.track import Tracker, TurningMotion
from recon.geometry.camera import Camera
from recon.io.video import read_frames

STILL_F_PX = 1400.0
SUBFRAMES = 7
SHUTTER = 0.5
SHAKE_DEG = 0.3


@dataclass(frozen=True)
class Pan:
    """Motion, zoom and picture of a virtual camera that pans."""

    sweep_deg: float
    """Angle of the pan, degrees, and of the way back if the pan returns."""
    speed_deg_s: float
    covered: float = 0.2
    """Fraction of the picture that the subject covers."""
    zoom: float = 1.0
    returns: bool = False
    size_px: tuple[int, int] = (960, 540)
    f_px: float = STILL_F_PX


@dataclass(frozen=True)
class Film:
    """N pictures of a virtual camera, with the true rotations (N, 3, 3) and zooms (N,)."""

    pictures: list[np.ndarray]
    camera: Camera
    rotations: np.ndarray
    zooms: np.ndarray


def film(video: Path, pan: Pan, seed: int = 0) -> Film:
    """Cut a pan along the longer side of the picture out of the video of a static camera.

    If the video has too few frames, it is played forwards and backwards alternately.
    """
    stills = [picture for _, picture in read_frames(video)]
    if stills[0].shape[0] > stills[0].shape[1]:
        stills = [np.ascontiguousarray(np.rot90(picture)) for picture in stills]
    height, width = stills[0].shape[:2]
    fps = 60.0
    one_way = round(fps * pan.sweep_deg / pan.speed_deg_s) + 1
    way = np.linspace(-0.5, 0.5, one_way) * pan.sweep_deg
    way = np.concatenate([way, way[::-1]]) if pan.returns else np.concatenate([way, np.full(10, way[-1])])
    rng = np.random.default_rng(seed)
    shake = gaussian_filter1d(rng.normal(size=(len(way), 3)), 2, axis=0)
    shake *= SHAKE_DEG / shake.std(axis=0)
    angles = np.column_stack([shake[:, 0], way + shake[:, 1], shake[:, 2]])
    rotations = Rotation.from_rotvec(np.radians(angles)).inv().as_matrix()  # y is down, so this turns to the right
    zooms = np.linspace(1, pan.zoom, len(way))
    K1 = np.array([[STILL_F_PX, 0, (width - 1) / 2], [0, STILL_F_PX, (height - 1) / 2], [0, 0, 1]])
    camera = Camera(
        "pan",
        np.array([[pan.f_px, 0, (pan.size_px[0] - 1) / 2], [0, pan.f_px, (pan.size_px[1] - 1) / 2], [0, 0, 1]]),
        np.zeros(0),
        "pinhole",
        pan.size_px,
    )
    pictures = []
    for t in range(len(way)):
        bounce = t % (2 * len(stills) - 2)
        still = stills[bounce if bounce < len(stills) else 2 * len(stills) - 2 - bounce]
        picture = np.zeros((pan.size_px[1], pan.size_px[0], 3), np.float32)
        before, after = max(t - 1, 0), min(t + 1, len(way) - 1)
        rate = np.radians(angles[after] - angles[before]) / max(after - before, 1)
        for fraction in (np.arange(SUBFRAMES) + 0.5) / SUBFRAMES - 0.5:
            R = Rotation.from_rotvec(fraction * SHUTTER * rate).inv().as_matrix() @ rotations[t]
            K2 = camera.matrix.copy()
            K2[[0, 1], [0, 1]] *= zooms[t]
            H = K1 @ R.T @ np.linalg.inv(K2)
            picture += cv2.warpPerspective(
                still, H, pan.size_px, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_REPLICATE
            )
        picture = (picture / SUBFRAMES).round().astype(np.uint8)
        pictures.append(_with_subject(picture, still, pan.covered, t / fps))
    return Film(pictures, camera, rotations, zooms)


def _with_subject(picture: np.ndarray, still: np.ndarray, covered: float, seconds: float) -> np.ndarray:
    if not covered:
        return picture
    height, width = picture.shape[:2]
    axes = np.sqrt(covered * 4 / np.pi) / 2 * np.array([width, height])
    mirrored = cv2.flip(still, 1)[150 : 150 + height, 400 : 400 + width]
    patch = np.zeros_like(picture)
    patch[: mirrored.shape[0], : mirrored.shape[1]] = mirrored
    centre = np.array([width / 2 + 0.06 * width * np.sin(4 * seconds), height / 2 + 6 * np.sin(25 * seconds)])
    move = np.array([[1, 0, centre[0] - width / 2], [0, 1, centre[1] - height / 2]])
    patch = cv2.warpAffine(patch, move, (width, height))
    mask = np.zeros((height, width), np.float32)
    (x, y), (a, b) = centre.tolist(), (2 * axes).tolist()
    cv2.ellipse(mask, ((x, y), (a, b), 0.0), 1.0, -1)
    mask = cv2.GaussianBlur(mask, (0, 0), 1.5)[..., None]
    return (mask * patch + (1 - mask) * picture).round().astype(np.uint8)


def lens_rows(video: Path, cases: Sequence[str]) -> Iterator[tuple[object, ...]]:
    """Estimate the focal length from pans whose camera file has a wrong one, and yield a table row for each."""
    for name in cases:
        if CASES[name].zoom != 1:
            continue
        one = film(video, CASES[name])
        for by in LENSES:
            camera = replace(one.camera, matrix=one.camera.matrix * [[by, 1, 1], [1, by, 1], [1, 1, 1]])
            error, _, motion, _ = measured(replace(one, camera=camera), False)
            found, sigma = motion.focal or (np.nan, np.nan)
            yield (
                *(video.stem, name, f"{by - 1:+.0%}", f"{len(error)} of {len(one.pictures)}"),
                *(f"{np.exp(found) * by - 1:+.1%}", f"{sigma:.1%}"),
                *(f"{error.max():.2f}", f"{np.degrees(motion.sigma_rad[int(error.argmax())]):.2f}"),
            )


def measured(one: Film, zoom: bool) -> tuple[np.ndarray, np.ndarray, TurningMotion, float]:
    """Estimate the motion of the virtual camera, and compare it with the truth.

    Returns
    -------
    tuple
        Errors of the rotation (N,), degrees; relative errors of the zoom (N,); the estimated motion; and processor time
        per frame, seconds.
    """
    tracker = Tracker(one.camera, solve_zoom=zoom)
    begun = time.process_time()
    for number, picture in enumerate(one.pictures):
        tracker.add(number, picture)
    motion = tracker.finish()
    seconds = (time.process_time() - begun) / len(one.pictures)
    found = np.stack([one.rotation for one in motion.orientations])
    truth = one.rotations[motion.frames]
    off = (found @ found[0].T) @ (truth @ truth[0].T).swapaxes(1, 2)
    error = np.degrees(Rotation.from_matrix(off).magnitude())
    zooms = np.array([one.zoom for one in motion.orientations])
    return error, np.abs(zooms / one.zooms[motion.frames] - 1), motion, seconds


CASES: dict[str, Pan] = {
    "15° at 30°/s": Pan(15, 30),
    "20° at 45°/s": Pan(20, 45),
    "25° at 60°/s": Pan(25, 60),
    "15° at 30°/s, 40 % covered": Pan(15, 30, covered=0.4),
    "20° at 45°/s, 40 % covered": Pan(20, 45, covered=0.4),
    "25° at 60°/s, 40 % covered": Pan(25, 60, covered=0.4),
    "20° at 30°/s, zoom 1 to 1.5": Pan(20, 30, zoom=1.5),
    "25° there and back": Pan(25, 45, returns=True),
}


def rows(video: Path, cases: Sequence[str]):
    for name in cases:
        pan = CASES[name]
        one = film(video, pan)
        error, zoom, motion, seconds = measured(one, pan.zoom != 1)
        sigma = np.degrees(motion.sigma_rad)
        yield (
            video.stem,
            name,
            f"{len(error)} of {len(one.pictures)}",
            f"{np.median(error):.4f}",
            f"{error.max():.4f}",
            f"{error[-1]:.4f}",
            f"{np.median(sigma):.4f}",
            f"{zoom.max():.2%}" if pan.zoom != 1 else "",
            f"{np.median(motion.residual_px):.2f}",
            len(motion.keys),
            f"{1000 * seconds:.0f}",
        )


LENSES = (1.0, 1.05, 0.9, 1.3, 0.58)
"""Focal lengths in the camera files, relative to the true one; the last is for 90 instead of 60 degrees."""
LENS_HEADER = ("video", "pan", "file", "frames", "error of found length", "sigma", "worst °", "sigma of the worst °")
HEADER = (
    "video", "pan", "frames", "median °", "worst °", "last °", "sigma °", "zoom, worst", "residual px", "keyframes",
    "CPU ms per frame",
)  # fmt: skip


def main() -> None:
    parser = parser_of(__doc__, kind="still-videos")
    parser.add_argument("--case", action="append", choices=CASES, help="only these cases")
    arguments = parser.parse_args()
    videos = sorted(arguments.folder.glob("*.mp4"))
    if not videos:
        parser.exit(message=f"no videos in {arguments.folder}: nothing measured\n")
    cases = arguments.case or list(CASES)
    print_table(HEADER, (row for video in videos for row in rows(video, cases)))
    print("\nCamera files with another focal length:\n")
    print_table(LENS_HEADER, (row for video in videos for row in lens_rows(video, cases)))


if __name__ == "__main__":
    main()
