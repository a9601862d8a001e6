"""Compare fits of two rendered videos, one of a panning and one of a static camera, from the video to the pose.

    python benchmarks/parts/panning_film.py [--steps 1000] [--seeds 0 1 2] [--out DIR]

Both videos show the same animal in the same world, from the same position through the same lens at the same times; one
camera turns to follow the animal, and shakes. For each video, a separate network is trained on labels of the same
frames, and predicts the points of all frames. The panning camera's rotation is estimated from the video, like `recon
run --camera-motion turns`, with the tilt of the first picture given. The static camera's pose is its calibrated pose.
Errors are over all frames, in the world of each fit. Tables are in Markdown, as in docs/benchmarks.md. With --film, the
script only draws the video of the panning camera.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
from arguments import parser_of
from markdown_table import print_header, print_row
from net_circle import Circle, run_circle
from scipy.spatial.transform import Rotation

from recon.io.camera_track import read_camera_track
from recon.keypoint_net.settings import TrainSettings
from recon.testing.cameras import panning_camera
from recon.testing.film import film_clip, panning_film, render_frames, write_film


def turn_errors_deg(track: Path, truth: np.ndarray) -> np.ndarray:
    """Return the errors (N,), degrees, of an estimated camera track relative to the first frame."""
    found = read_camera_track(track)
    rotations, truth = found.T_camera_world[:, :3, :3], truth[found.frames]
    off = (rotations @ rotations[0].T) @ (truth @ truth[0].T).swapaxes(1, 2)
    return np.degrees(Rotation.from_matrix(off).magnitude())


def row(name: str, seed: int, circle: Circle, truth: np.ndarray | None, out: Path) -> tuple[object, ...]:
    turned = ("", "")
    if truth is not None:
        error = turn_errors_deg(out / "predicted" / "track.csv", truth)
        turned = (f"{np.median(error):.3f}", f"{error.max():.3f}")
    score, predicted, noisy = circle.points["all"], circle.predicted, circle.noisy
    return (
        name, seed, f"{score['median_px']:.2f}", f"{score['pck_px']['5.0']:.2f}", *turned,
        *(f"{1000 * error.mean:.1f}" for error in (predicted.mpjpe_m, noisy.mpjpe_m)),
        *(f"{1000 * error.mean:.0f}" for error in (predicted.mpe_m, noisy.mpe_m)),
    )  # fmt: skip


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--steps", type=int, default=1000)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--device", default="auto")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--out", type=Path, help="folder for the videos and the networks (default: a temporary folder)")
    parser.add_argument("--film", action="store_true", help="only draw the video of the panning camera")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        out = args.out or Path(temporary)
        still, ground_m = film_clip()
        camera_at = panning_camera(still)
        pan = panning_film(still, camera_at)
        (out / "film").mkdir(parents=True, exist_ok=True)
        write_film(out / "film", pan.clip, render_frames(still.truth_m, still.names, camera_at, ground_m))
        if args.film:
            return
        print_header((
            "film", "seed", "points: median, px", "within 5 px", "turn: median °", "worst °", "MPJPE mm",
            "with true points + 2 px", "MPE mm", "with true points + 2 px",
        ))  # fmt: skip
        ratios = []
        for seed in args.seeds:
            settings, how = TrainSettings(steps=args.steps, seed=seed), {"device": args.device, "threads": args.threads}
            before = run_circle(out / f"still{seed}", settings, **how)
            print_row(row("still", seed, before, None, out / f"still{seed}"))
            folder = out / f"panning{seed}"
            found = run_circle(folder, settings, samples=out / "film", turns=True, tilt_deg=pan.tilt_deg, **how)
            print_row(row("panning", seed, found, pan.rotations, folder))
            ratios.append(found.predicted_m / before.predicted_m)
        print(f"\nMPJPE {', '.join(f'{ratio:.2f}' for ratio in ratios)} times the video of a static camera's")


if __name__ == "__main__":
    main()
