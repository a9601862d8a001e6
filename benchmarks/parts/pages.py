"""Measure how smoothly pages play in a browser, and the processor time of the commands that write them.

    python benchmarks/parts/pages.py browser [--frames 4000] [--clips 100]
    python benchmarks/parts/pages.py costs [--runs 3]
    python benchmarks/parts/pages.py pages
    python benchmarks/parts/pages.py summary [--clips 500]
    python benchmarks/parts/pages.py run --model DIR

- `browser` opens three pages in Chromium: one with the rendered video (90 frames), one of a simulated clip of 4,000
  frames, and one of a batch of 100 clips. The slider then moves to another frame at each refresh of the screen for
  three seconds, and the refreshes are counted. The processor time of all processes of the browser is also measured. The
  browser draws without a graphics card; if a frame takes 33 ms of one processor, 30 frames per second are drawn
- `costs` measures the processor time of `recon report` and `recon analyse` with their default options on 40 frames,
  relative to the fit in the same run, as medians of RUNS runs
- `pages` writes the pages of the rendered video with its pictures, of a sample of 60 frames, and of twenty such samples
  in a row, forwards and backwards
- `summary` writes the page of a batch of copies of one result
- `run` times `recon run` from the rendered video to the page, with a network that `recon train` made on this video, and
  compares this time with one command per stage, and with a second run

If Chromium is on the path, the pages are opened in it, and the number of console messages is printed.
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
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np
from arguments import parser_of
from long_clips import write_inputs
from markdown_table import print_header, print_row
from startup import SAMPLES, seconds

from recon.api.batch import COLUMNS, results_of, write_summary_page
from recon.api.clip_results import run_clip
from recon.api.settings import FitSettings
from recon.base.documents import read_json

if TYPE_CHECKING:
    from playwright.sync_api import Browser

FILM = SAMPLES / "rendered.mp4"
FILM_FIT = ("--camera", str(SAMPLES / "rendered_camera.toml"), "--set", "detector=none")
CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), ""
)


SCRUBBED_S = 3.0
"""Time for which the slider is moved, seconds."""
SETTLED_MS = 3000.0
"""Time before the slider moves, milliseconds, in which the page draws the part below the screen."""
SCRUB = """(seconds) => new Promise((done) => {
  const slider = document.querySelector(".player input[type=range]"), most = Number(slider.max);
  const began = performance.now();
  let count = 0;
  const move = (now) => {
    if (now - began > 1000 * seconds) return done(1000 * count / (now - began));
    count += 1;
    slider.value = String(Math.round(((now - began) / (1000 * seconds)) * most * 3) % (most + 1));
    slider.dispatchEvent(new Event("input"));
    requestAnimationFrame(move);
  };
  requestAnimationFrame(move);
})"""
"""JavaScript that moves the slider through the clip, and returns the screen refreshes per second."""
SHOWN = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(performance.now()))))"
"""JavaScript that returns the time from the request for the page until the page is drawn, ms."""


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("what", choices=("browser", "costs", "pages", "summary", "run"))
    parser.add_argument("--clips", type=int, default=100)
    parser.add_argument("--frames", type=int, default=4000)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--model", type=Path)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        parts = {"browser": browser, "costs": costs, "pages": pages, "summary": summary, "run": run}
        parts[args.what](args, Path(folder))


def recon(folder: Path, *arguments: object) -> tuple[float, float]:
    """Run a command, and return its wall-clock time and processor time, seconds."""
    return seconds([sys.executable, "-m", "recon", *map(str, arguments)], str(folder))


def browser(args: argparse.Namespace, folder: Path) -> None:
    """Measure the size of pages, the time until they are drawn, and the screen refreshes while the slider moves."""
    from playwright.sync_api import sync_playwright

    if not CHROMIUM:
        raise SystemExit("no Chromium on the path")
    made = {f"{args.frames} frames": long_page(args.frames, folder), "90 frames with video": film_page(folder)}
    made[f"batch of {args.clips} clips"] = batch_of_copies(args.clips, folder)
    print_header(("page", "MB", "opens, s", "frames/s while the slider moves", "processor ms per frame"))
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"], timeout=300_000.0)
        for name, path in made.items():
            page = chromium.new_page(viewport={"width": 1280, "height": 900})
            page.set_default_timeout(300_000.0)
            page.goto(path.absolute().as_uri())
            opens_s = page.evaluate(SHOWN) / 1000
            scrubbed = ("", "")
            if page.query_selector(".player"):
                page.wait_for_timeout(SETTLED_MS)
                began_s = browser_seconds(chromium)
                rate = page.evaluate(SCRUB, SCRUBBED_S)
                used_ms = 1000 * (browser_seconds(chromium) - began_s) / (rate * SCRUBBED_S)
                scrubbed = (f"{rate:.0f}", f"{used_ms:.0f}")
            print_row((name, f"{path.stat().st_size / 1e6:.2f}", f"{opens_s:.2f}", *scrubbed))
            page.close()
        chromium.close()


def browser_seconds(chromium: Browser) -> float:
    """Return the processor time of all processes of the browser."""
    session = chromium.new_browser_cdp_session()
    used_s = sum(process["cpuTime"] for process in session.send("SystemInfo.getProcessInfo")["processInfo"])
    session.detach()
    return used_s


def film_page(folder: Path) -> Path:
    """Write the page of the rendered video, with its pictures, and return the path of the page."""
    points = SAMPLES / "rendered_points.csv"
    recon(folder, "fit", points, *FILM_FIT, "--fps", 120, "--out", "film", "--quiet")
    recon(folder, "report", "film", "--video", FILM, "--quiet")
    return folder / "film" / "report.html"


def long_page(frames: int, folder: Path) -> Path:
    """Write the page of a simulated run around a camera, and return its path."""
    arguments, _ = write_inputs(folder, f"{frames}x1")
    recon(folder, "fit", *arguments, "--out", "long", "--quiet")
    recon(folder, "report", "long", "--quiet")
    return folder / "long" / "report.html"


def costs(args: argparse.Namespace, folder: Path) -> None:
    """Measure the processor time of a page and an analysis of 40 frames, relative to the fit of the same run."""
    points = ("fit", SAMPLES / "rendered_points.csv", *FILM_FIT, "--fps", 120, "--frames", "0:40")
    commands = {
        "fit": (*points, "--out", "out", "--overwrite", "--quiet"),
        "report": ("report", "out", "--quiet"),
        "report --video": ("report", "out", "--video", FILM, "--quiet"),
        "analyse": ("analyse", "out", "--overwrite", "--quiet"),
    }
    allowed = {"report": 2.0, "report --video": 4.0, "analyse": 2.0}
    recon(folder, *commands["fit"])  # compiled modules and matplotlib's fonts are cached from now on
    recon(folder, *commands["analyse"])
    used = [{name: recon(folder, *command)[1] for name, command in commands.items()} for _ in range(args.runs)]
    print_header(("40 frames", "processor s", "times the fit", "goal"))
    for name in commands:
        times = median(seconds_used[name] / seconds_used["fit"] for seconds_used in used)
        middle_s = median(seconds_used[name] for seconds_used in used)
        print_row((name, f"{middle_s:.1f}", f"{times:.1f}", allowed.get(name, "")))


def pages(args: argparse.Namespace, folder: Path) -> None:
    """Measure the size and the processor time of pages of the rendered video, a sample, and twenty samples in a row."""
    points = (SAMPLES / "whole.csv").read_text(encoding="utf-8").splitlines()
    rows = [line.partition(",")[2] for line in points[3:]]
    long = [f"{i},{row}" for i, row in enumerate((rows + rows[::-1]) * 10)]
    (folder / "long.csv").write_text("\n".join(points[:3] + long) + "\n", encoding="utf-8")
    of_sample = ("--camera", SAMPLES / "camera.toml", "--fps", 60)
    clips = {
        "rendered video": ((SAMPLES / "rendered_points.csv", *FILM_FIT, "--fps", 120), ("--video", FILM)),
        "sample": ((SAMPLES / "whole.csv", *of_sample), ()),
        "20 samples": ((folder / "long.csv", *of_sample), ()),
    }
    print_header(("clip", "frames", "report.html, kB", "processor s", "fit, s", "errors in Chromium"))
    for name, (fit, page) in clips.items():
        out = folder / name.replace(" ", "_")
        _, fit_s = recon(folder, "fit", *fit, "--out", out, "--quiet")
        _, page_s = recon(folder, "report", out, *page, "--quiet")
        frames = read_json(out / "report.json", "a report")["summary"]["frames"]
        file = out / "report.html"
        print_row((name, frames, f"{file.stat().st_size / 1000:.0f}", f"{page_s:.1f}", f"{fit_s:.1f}", errors(file)))


def summary(args: argparse.Namespace, folder: Path) -> None:
    """Measure the size and the processor time of the page of a batch in which one clip in fifty failed."""
    out = batch_of_copies(args.clips, folder).parent
    began = time.process_time()
    file = write_summary_page(out)
    took = time.process_time() - began
    print_header(("clips", "summary.html, kB", "processor s", "errors in Chromium"))
    print_row((args.clips, f"{file.stat().st_size / 1000:.0f}", f"{took:.1f}", errors(file)))


def batch_of_copies(clips: int, folder: Path) -> Path:
    """Write the page of a batch of copies of one result, and return its path."""
    one, out, rng = folder / "one", folder / "all", np.random.default_rng(0)
    settings = FitSettings(keypoints=(SAMPLES / "whole.csv",), camera=(SAMPLES / "camera.toml",), fps=60)
    report = run_clip(settings, one)
    row: dict[str, Any] = dict.fromkeys(COLUMNS, "") | results_of(report)
    out.mkdir()
    with (out / "summary.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(COLUMNS)
        for number in range(clips):
            name, failed = f"clip{number:03}", number % 50 == 0
            status = {"status": "failed", "error": "clip.csv: a fault"} if failed else {"status": "done"}
            own = row | {"clip": name, "mean_reprojection_px": rng.uniform(2, 20)} | status
            writer.writerow([own[column] for column in COLUMNS])
            if not failed:
                (out / name).mkdir()
                for needed in ("report.json", "reprojection.csv"):
                    shutil.copy(one / needed, out / name / needed)
                (out / name / "report.html").touch()
    return write_summary_page(out)


def run(args: argparse.Namespace, folder: Path) -> None:
    """Compare the times of `recon run`, of one command for each stage, and of a second `recon run`."""
    if args.model is None:
        raise SystemExit("--model: a network that `recon train` made on the rendered video")
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
    print_header(("stage", "s", "processor s", "fraction of the sum"))
    for name, (clock_s, processor_s) in taken.items():
        print_row((name, f"{clock_s:.1f}", f"{processor_s:.1f}", f"{processor_s / total[1]:.2f}"))


def errors(page: Path) -> str:
    """Open a page on a desktop and a phone, in light and dark mode, and count the browser's console messages."""
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
