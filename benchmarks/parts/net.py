"""Test the keypoint network on the rendered sample, on a large animal and on a real video, and time the prediction.

    python benchmarks/parts/net.py circle [--minutes 15 | --steps N]
    python benchmarks/parts/net.py large [--minutes 15 | --steps N] [--seeds 0 1 2]
    python benchmarks/parts/net.py labels [--steps N] [--counts 5 10 20 40]
    python benchmarks/parts/net.py speed [--model DIR]
    python benchmarks/parts/net.py horse [--minutes 15 | --steps N] [--seeds 0 1 2] [--random-half]

`labels` trains on 5, 10, 20 and 40 labelled pictures of the rendered sample, with the same number of steps. `circle`
goes from labels of the rendered sample to its 3D motion. Tables are in Markdown, as in docs/net.md. `horse` needs
horse-side in $RECON_SHARED_DATA, or in ../shared/data. It trains on the labelled frames 0 to 149 of the video, of which
110 to 149 are used for validation at first, and tests on the frames 150 to 199. With --random-half, it trains on a
random half of all labels, and compares with interpolation of the labels in time.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from arguments import parser_of
from markdown_table import print_header, print_row
from net_circle import run_circle
from net_large import run_large, write_large_film

from recon.api.samples import samples_folder
from recon.io.formats import read_keypoints
from recon.io.video import video_writer
from recon.keypoint_net.labels import body_length_px, evaluate_2d, evaluate_2d_files, read_label_file
from recon.keypoint_net.network import (
    PredictSettings,
    Spec,
    TrainedNetwork,
    choose_device,
    load_model,
    new_network,
    on_device,
    predict_video,
    require_torch,
    run_prediction,
)
from recon.keypoint_net.settings import LabelSource, TrainSettings
from recon.keypoint_net.train import run_training

FIRST = 50
"""Frame number that the horse's labels use for the video's first frame."""


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("what", choices=("circle", "labels", "large", "speed", "horse"))
    parser.add_argument("--minutes", type=float, default=15.0)
    parser.add_argument("--steps", type=int)
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--counts", type=int, nargs="+", default=[5, 10, 20, 40])
    parser.add_argument("--random-half", action="store_true")
    parser.add_argument("--model", type=Path)
    parser.add_argument("--device", default="auto")
    parser.add_argument("--threads", type=int, help="on the CPU (default: all)")
    parser.add_argument("--out", type=Path, help="folder for the networks (default: a temporary folder)")
    args = parser.parse_args()
    require_torch()
    with tempfile.TemporaryDirectory() as temporary:
        out = args.out or Path(temporary)
        {"circle": circle, "labels": labels, "large": large, "speed": speed, "horse": horse}[args.what](args, out)


def settings(args: argparse.Namespace, seed: int) -> TrainSettings:
    return TrainSettings(steps=args.steps, minutes=args.minutes, seed=seed)


def circle(args: argparse.Namespace, out: Path) -> None:
    print_header(("seed", "steps", "s", "median, px", "PCK@5px", "MPJPE, mm", "with true points + 2 px, mm", "ratio"))
    for seed in args.seeds:
        found = run_circle(out / f"circle{seed}", settings(args, seed), device=args.device, threads=args.threads)
        score = found.points["all"]
        print_row((
            seed, found.training["steps"], round(found.training["seconds"]), f"{score['median_px']:.2f}",
            f"{score['pck_px']['5.0']:.2f}", f"{1000 * found.predicted_m:.1f}", f"{1000 * found.noisy_m:.1f}",
            f"{found.ratio:.2f}",
        ))  # fmt: skip


def labels(args: argparse.Namespace, out: Path) -> None:
    """Train on evenly spaced labelled pictures of the rendered sample, and test in the frames without labels."""
    film, label_file = samples_folder() / "rendered.mp4", samples_folder() / "rendered_labels.csv"
    truth, labelled = read_keypoints(samples_folder() / "rendered_points.csv"), read_label_file(label_file)[0]
    others, length_px = ~np.isin(truth.frames, labelled.frames), body_length_px(truth.xy_px)
    rows = label_file.read_text(encoding="utf-8").splitlines()
    out.mkdir(parents=True, exist_ok=True)
    print_header(("labelled pictures", "steps", "s", "median, px", "median, % of body", "PCK@2.5/5/10px"))
    for count in args.counts:
        chosen = np.linspace(0, len(rows) - 4, count).round().astype(int)
        file, network = out / f"labels{count}.csv", out / f"labels{count}"
        file.write_text("\n".join(rows[:3] + [rows[3 + i] for i in chosen]) + "\n", encoding="utf-8")
        source = LabelSource(data=film, labels=file)
        report = run_training(
            source, settings(args, args.seeds[0]), network, device=args.device, threads=args.threads, overwrite=True
        )
        points = run_prediction(
            film, network, network / "points.csv", device=args.device, threads=args.threads, overwrite=True
        )
        score = evaluate_2d(
            truth.names, points.xy_px[others], points.confidence[others], truth.xy_px[others], length_px
        )["all"]
        print_row((
            count, report["steps"], round(report["seconds"]), f"{score['median_px']:.2f}",
            f"{100 * score['median_px'] / length_px:.1f}",
            "/".join(f"{fraction:.2f}" for fraction in score["pck_px"].values()),
        ))  # fmt: skip


def large(args: argparse.Namespace, out: Path) -> None:
    """Train on the large animal, and measure errors and the processor time of training and report."""
    write_large_film(out)
    print_header(("seed", "steps", "s", "processor, s", "median, px", "PCK@2.5/5/10px", "ECE"))
    for seed in args.seeds:
        before = time.process_time()
        report, found = run_large(out, out / f"large{seed}", settings(args, seed), args.device, args.threads)
        used = time.process_time() - before
        print_row((
            seed, report["steps"], round(report["seconds"]), round(used), f"{found['all']['median_px']:.2f}",
            "/".join(f"{fraction:.2f}" for fraction in found["all"]["pck_px"].values()),
            f"{found['reliability']['expected_calibration_error']:.3f}",
        ))  # fmt: skip


def speed(args: argparse.Namespace, out: Path) -> None:
    """Measure frames per second of a prediction, including decoding, and its peak memory for videos of two lengths.

    The network has trained or random weights, which take the same time. Pictures are not scaled.
    """
    trained = _network(args.model, args.device)
    print_header(("video", "frames/s"))
    for size, frames in (((288, 162), 900), ((640, 360), 300)):
        video = out / f"noise{size[0]}.mp4"
        _noise_video(video, size, frames)
        start = time.perf_counter()
        predict_video(trained, _settings(video, args.threads))
        print_row((f"{size[0]}x{size[1]}", f"{frames / (time.perf_counter() - start):.0f}"))
    print()
    print_header(("frames of 640x360", "peak memory, MB"))
    for frames in (300, 3000):
        video = out / f"long{frames}.mp4"
        _noise_video(video, (640, 360), frames)
        with ProcessPoolExecutor(1, get_context("spawn")) as pool:
            megabytes = pool.submit(_most_memory, args.model, args.device, args.threads, video).result()
        print_row((frames, f"{megabytes:.0f}"))


def _settings(video: Path, threads: int | None) -> PredictSettings:
    return PredictSettings(video=video, model=Path(), out=Path(), threads=threads)


def _network(model: Path | None, device: str) -> TrainedNetwork:
    if model:
        return load_model(model, choose_device(device))
    spec = Spec(tuple(f"point{k}" for k in range(22)), 1.0, 120.0, 5.0)
    on = choose_device(device)
    return TrainedNetwork(spec, on_device(new_network(22, two_stages=False), on).eval(), on)


def _noise_video(path: Path, size_px: tuple[int, int], frames: int) -> None:
    grain = np.random.default_rng(0).integers(0, 256, (size_px[1], size_px[0], 3)).astype(np.uint8)
    scene = np.asarray(cv2.GaussianBlur(grain, (0, 0), 2), np.uint8)
    with video_writer(path, size_px, 30.0) as write:
        for n in range(frames):
            write(np.roll(scene, n % 7, axis=1))


def _most_memory(model: Path | None, device: str, threads: int | None, video: Path) -> float:
    import resource

    predict_video(_network(model, device), _settings(video, threads))
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / (2**20 if sys.platform == "darwin" else 2**10)


def horse(args: argparse.Namespace, out: Path) -> None:
    shared = Path(os.environ.get("RECON_SHARED_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
    video = shared / "horse-side" / "BrownHorseinShadow.mp4"
    labels = shared / "horse-side" / "CollectedData_Byron.csv"
    print_header(("seed", "steps", "s", "median, px", "PCK@2.5/5/10px", "swaps forgiven", "ECE"))
    for seed in args.seeds:
        folder = out / f"horse{seed}{'random' if args.random_half else ''}"
        validation, test = f"{FIRST + 110}:{FIRST + 150}", f"{FIRST + 150}:"
        file = held_out = labels
        if args.random_half:
            out.mkdir(parents=True, exist_ok=True)
            file, held_out = _random_half(labels, out, seed)
            validation, test = "0.1", "0"
        source = LabelSource(data=video, labels=file, first_frame=FIRST, validation=validation, test=test)
        report = run_training(
            source, settings(args, seed), folder,
            device=args.device, threads=args.threads, overwrite=True,
        )  # fmt: skip
        points = folder / "points.csv"
        run_prediction(video, folder, points, device=args.device, threads=args.threads, overwrite=True)
        frames = {} if args.random_half else {"frames": f"{FIRST + 150}:{FIRST + 200}"}
        print_row(_row(seed, report, evaluate_2d_files(points, held_out, first_frame=FIRST, **frames)))
        if args.random_half:
            print(f"Interpolation of the labels in time: {_interpolated(file, held_out):.2f} px (median)", flush=True)


def _row(seed: int, report: dict[str, Any], result: dict[str, Any]) -> tuple[object, ...]:
    score, forgiven, table = result["all"], result["swaps_forgiven"], result["reliability"]
    return (
        seed, report["steps"], round(report["seconds"]), f"{score['median_px']:.2f}",
        "/".join(f"{fraction:.2f}" for fraction in score["pck_px"].values()),
        f"{forgiven['median_px']:.2f} px, {forgiven['pck_px']['5.0']:.2f}",
        f"{table['expected_calibration_error']:.3f}",
    )  # fmt: skip


def _random_half(labels: Path, out: Path, seed: int) -> tuple[Path, Path]:
    """Write two label files, each with half of the rows, and return their paths."""
    rows = labels.read_text(encoding="utf-8").splitlines()
    order = np.random.default_rng(seed).permutation(len(rows) - 3)
    paths = []
    for name, which in (("learned", order[: len(order) // 2]), ("held_out", order[len(order) // 2 :])):
        paths.append(out / f"{name}{seed}.csv")
        paths[-1].write_text("\n".join(rows[:3] + [rows[3 + i] for i in sorted(which)]) + "\n", encoding="utf-8")
    return paths[0], paths[1]


def _interpolated(learned: Path, held_out: Path) -> float:
    """Return the median error of linear interpolation between the learned labels at the held-out labels, px."""
    known, other = read_label_file(learned)[0], read_label_file(held_out)[0]
    errors = []
    for k in range(len(known.names)):
        there = np.isfinite(known.xy_px[:, k]).all(axis=1)
        at = [np.interp(other.frames, known.frames[there], known.xy_px[there, k, i], np.nan, np.nan) for i in (0, 1)]
        errors.append(np.linalg.norm(np.stack(at, axis=1) - other.xy_px[:, k], axis=1))
    return float(np.nanmedian(np.concatenate(errors)))


if __name__ == "__main__":
    main()
