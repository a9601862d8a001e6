"""Measure the processor time of pages and of `recon run` as whole commands.

    python benchmarks/parts/pages.py pages
    python benchmarks/parts/pages.py summary [--clips 500]
    python benchmarks/parts/pages.py run --model DIR

`pages`: the rendered film with the film behind the pictures, a sample of 60 frames, and twenty of these in a row,
forwards and backwards. `summary`: the table of a batch of copies of one result. `run`: from the rendered film to the
page with a network that `recon train` made on this film, compared with a command for each stage, and a second run. If a
Chromium is on the path, it opens the pages, and the number of its console messages is printed.
"""

from __future__ import annotations

import argparse
import csv
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from arguments import parser_of
from markdown_table import print_header, print_row
from startup import SAMPLES, seconds

from recon.api.batch import COLUMNS, results_of, write_summary_page
from recon.api.clip_results import run_clip
from recon.api.settings import FitSettings
from recon.base.documents import read_json

FILM = SAMPLES / "rendered.mp4"
FILM_FIT = ("--camera", str(SAMPLES / "rendered_camera.toml"), "--set", "detector=none")
CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), ""
)


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("what", choices=("pages", "summary", "run"))
    parser.add_argument("--clips", type=int, default=500)
    parser.add_argument("--model", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        {"pages": pages, "summary": summary, "run": run}[args.what](args, Path(folder))


def recon(folder: Path, *arguments: object) -> tuple[float, float]:
    """Return the seconds of a command by the clock and by the processor."""
    return seconds([sys.executable, "-m", "recon", *map(str, arguments)], str(folder))


def pages(args: argparse.Namespace, folder: Path) -> None:
    points = (SAMPLES / "whole.csv").read_text(encoding="utf-8").splitlines()
    rows = [line.partition(",")[2] for line in points[3:]]
    long = [f"{i},{row}" for i, row in enumerate((rows + rows[::-1]) * 10)]
    (folder / "long.csv").write_text("\n".join(points[:3] + long) + "\n", encoding="utf-8")
    of_sample = ("--camera", SAMPLES / "camera.toml", "--fps", 60)
    clips = {
        "rendered film": ((SAMPLES / "rendered_points.csv", *FILM_FIT, "--fps", 120), ("--video", FILM)),
        "sample": ((SAMPLES / "whole.csv", *of_sample), ()),
        "20 samples": ((folder / "long.csv", *of_sample), ()),
    }
    print_header(("clip", "frames", "report.html, kB", "s of the processor", "fit, s", "errors in Chromium"))
    for name, (fit, page) in clips.items():
        out = folder / name.replace(" ", "_")
        _, fit_s = recon(folder, "fit", *fit, "--out", out, "--quiet")
        _, page_s = recon(folder, "report", out, *page, "--quiet")
        frames = read_json(out / "report.json", "a report")["summary"]["frames"]
        file = out / "report.html"
        print_row((name, frames, f"{file.stat().st_size / 1000:.0f}", f"{page_s:.1f}", f"{fit_s:.1f}", errors(file)))


def summary(args: argparse.Namespace, folder: Path) -> None:
    """Measure the page of a batch in which one clip in fifty failed and the numbers of doubtful frames are random."""
    one, out, rng = folder / "one", folder / "all", np.random.default_rng(0)
    settings = FitSettings(keypoints=(SAMPLES / "whole.csv",), camera=(SAMPLES / "camera.toml",), fps=60)
    report = run_clip(settings, one)
    row: dict[str, Any] = dict.fromkeys(COLUMNS, "") | results_of(report)
    out.mkdir()
    with (out / "summary.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for number in range(args.clips):
            name, failed = f"clip{number:03}", number % 50 == 0
            status = {"status": "failed", "error": "clip.csv: a fault"} if failed else {"status": "done"}
            own = row | {"clip": name, "mean_reprojection_px": rng.uniform(2, 20)} | status
            writer.writerow([own[column] for column in COLUMNS])
            if not failed:
                (out / name).mkdir()
                for needed in ("report.json", "reprojection.csv"):
                    shutil.copy(one / needed, out / name / needed)
                (out / name / "report.html").touch()
    began = time.process_time()
    file = write_summary_page(out)
    took = time.process_time() - began
    print_header(("clips", "summary.html, kB", "s of the processor", "errors in Chromium"))
    print_row((args.clips, f"{file.stat().st_size / 1000:.0f}", f"{took:.1f}", errors(file)))


def run(args: argparse.Namespace, folder: Path) -> None:
    if args.model is None:
        raise SystemExit("--model: a network that `recon train` made on the rendered film")
    settings = (*FILM_FIT, "--set", "likelihood-min=0")  # accept all points, however good the network is
    stages = {
        "detect": ("predict", FILM, "--model", args.model.absolute(), "--out", "points.csv"),
        "fit": ("fit", "points.csv", *settings, "--fps", 120, "--out", "alone"),
        "analyse": ("analyse", "alone"),
        "overlay": ("overlay", "alone", "--video", FILM, "--out", "overlay.mp4"),
        "page": ("report", "alone", "--video", FILM),
    }
    taken = {name: recon(folder, *command) for name, command in stages.items()}
    whole = ("run", FILM, *settings, "--model", args.model.absolute(), "--out", "together")
    total = tuple(sum(column) for column in zip(*taken.values(), strict=True))
    taken |= {"sum": total, "`recon run`": recon(folder, *whole), "again": recon(folder, *whole)}
    print_header(("what", "s", "s of the processor", "of the sum"))
    for name, (clock_s, processor_s) in taken.items():
        print_row((name, f"{clock_s:.1f}", f"{processor_s:.1f}", f"{processor_s / total[1]:.2f}"))


def errors(page: Path) -> str:
    """Return the number of a browser's console messages on a desktop and a phone, in light and dark mode."""
    if not CHROMIUM:
        return "no Chromium"
    count = 0
    for width in (1200, 400):
        for scheme in (0, 1):
            command = [
                CHROMIUM, "--headless", "--no-sandbox", "--enable-logging=stderr", f"--window-size={width},900",
                f"--blink-settings=preferredColorScheme={scheme}", f"--screenshot={page.parent / 'shot.png'}",
                page.absolute().as_uri(),
            ]  # fmt: skip
            said = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300).stderr
            count += sum("CONSOLE" in line for line in said.splitlines())
    return str(count)


if __name__ == "__main__":
    main()
