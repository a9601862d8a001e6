"""Correct a clip with 40 planted faults in the page of `recon fix`, as a new user would, and measure the error.

    python benchmarks/parts/editor_trial.py [--seeds 1]

The faults are planted as in `planted_faults.py`, in the video of data/samples. The clip is fitted by `recon fit`, and a
script corrects the first 40 entries of the list in Chromium, with the actions that the page's help names: N goes to the
next entry, and Shift-click sets the keypoint. The script clicks within about 1 px (one standard deviation) of the true
position, which a user would see in the picture. Then `recon fit --corrections` fits the clip again. The error is
defined as in `planted_faults.py`.

No person is timed. The times come from the keystroke-level model (S. Card, T. Moran, A. Newell, Communications of the
ACM 23, 1980): 0.28 s for a key, 1.1 s to point, 0.2 s for a click, 1.35 s to prepare mentally. Each correction includes
two preparations, one to find the keypoint and one to decide. The script needs Chromium and the package playwright.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from markdown_table import print_table
from pages import CHROMIUM, FILM
from planted_faults import FAULTS, Fits, detections

from recon import Motion
from recon.io.corrections import read_corrections
from recon.io.deeplabcut import write_csv
from recon.testing.film import FPS, film_clip
from recon.testing.gallop import SyntheticClip

ROOT = Path(__file__).resolve().parents[2]
KEY_S, POINT_S, CLICK_S, PREPARE_S = 0.28, 1.1, 0.2, 1.35
HAND_PX = 1.0
EDITOR = "document.querySelector('main.fix').editor"
CHOSEN = f"() => {{ const e = {EDITOR}, item = e.queue[e.position]; return [item.frame, item.keypoint]; }}"
ON_SCREEN = f"""([x, y]) => {{
  const {{ picture }} = {EDITOR}, box = picture.canvas.getBoundingClientRect(), [left, top] = picture.place([x, y]);
  const is_inside = left > 0 && top > 0 && left < box.width && top < box.height;
  return [box.left + left, box.top + top, is_inside];
}}"""
"""JavaScript that converts a position in the picture to the screen, and returns whether the position is visible."""


def recon(*arguments: object) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-m", "recon", *map(str, arguments), "--quiet"], check=True, env=environment)


@contextmanager
def served(*arguments: object) -> Iterator[str]:
    """Run `recon fix`, yield the address of its page, and stop the command by Ctrl-C at the end."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1", "COLUMNS": "300"}
    command = [sys.executable, "-m", "recon", "fix", *map(str, arguments), "--no-browser"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment
    ) as process:
        assert process.stdout is not None
        line = next(line for line in process.stdout if "http://" in line)
        yield line.split()[-1]
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=60)
        assert process.returncode in (0, 130), process.returncode


class User:
    """Simulated user who acts on the page with keyboard and mouse, and whose actions are counted."""

    def __init__(self, page: Any, rng: np.random.Generator) -> None:
        self.page, self.rng = page, rng
        self.keys = self.clicks = 0

    def press(self, key: str) -> None:
        self.page.keyboard.press(key)
        self.keys += 1

    def correct(self, true_px: tuple[float, float]) -> None:
        """Click at the chosen keypoint's true position, with a small error."""
        at_px = [*(np.array(true_px) + self.rng.normal(0, HAND_PX, 2))]
        x, y, is_inside = self.page.evaluate(ON_SCREEN, at_px)
        if not is_inside:
            self.press("0")
            x, y, _ = self.page.evaluate(ON_SCREEN, at_px)
        self.page.keyboard.down("Shift")
        self.page.mouse.click(round(x), round(y))
        self.page.keyboard.up("Shift")
        self.keys += 1
        self.clicks += 1

    @property
    def seconds(self) -> float:
        return KEY_S * self.keys + (POINT_S + CLICK_S + 2 * PREPARE_S) * self.clicks


def corrected_by(user: User, clip: SyntheticClip) -> int:
    """Correct the first entries of the editor's list of keypoints, and return the number of clicks."""
    exact = clip.keypoints
    for entry in range(FAULTS):
        if entry:
            user.press("n")
        frame, keypoint = user.page.evaluate(CHOSEN)
        x, y = exact.xy_px[int(np.searchsorted(exact.frames, frame)), exact.names.index(keypoint)].tolist()
        if np.isfinite([x, y]).all():
            user.correct((x, y))
    user.page.evaluate(f"() => {EDITOR}.saving")
    return user.clicks


def row(chromium: Any, clip: SyntheticClip, seed: int) -> list[str]:
    """Plant faults, correct them on the page, and return the table row with counts and errors."""
    rng, exact = np.random.default_rng(seed), clip.keypoints
    noisy, with_faults, faults = detections(clip, rng)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        fits = Fits(folder, clip)
        clean_mm = fits.error_mm(fits.fit(noisy))
        write_csv(with_faults, folder / "clip.csv")
        result, out, again = folder / "clip", folder / "clip" / "corrections.csv", folder / "again"
        recon("fit", folder / "clip.csv", "--camera", fits.camera, "--fps", FPS, "--out", result)
        messages = list[str]()
        with served(result, "--video", FILM) as address:
            page = chromium.new_page(viewport={"width": 1280, "height": 900})
            page.on("console", lambda message: messages.append(message.text))
            page.on("pageerror", lambda error: messages.append(str(error)))
            page.goto(address)
            page.wait_for_function(EDITOR)
            user = User(page, rng)
            clicks = corrected_by(user, clip)
            page.close()
        saved = read_corrections(out)
        cells = {(int(np.searchsorted(exact.frames, item.frame)), exact.names.index(item.keypoint)) for item in saved}
        recon("fit", "--config", result / "config.toml", "--corrections", out, "--out", again)
        errors_mm = clean_mm, *(fits.error_mm(Motion.load(path)) for path in (result, again))
    fraction = errors_mm[2] / errors_mm[0] - 1
    counts = f"{user.keys} keys, {clicks} clicks", f"{user.seconds / 60:.1f}", str(len(cells & faults))
    return [*counts, *(f"{error:.1f}" for error in errors_mm), f"{fraction:+.1%}", str(len(messages))]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    seeds = range(parser.parse_args().seeds)
    if not CHROMIUM or find_spec("playwright") is None:
        parser.exit(message="no Chromium or no package playwright: nothing measured\n")
    from playwright.sync_api import sync_playwright  # pyright: ignore[reportMissingImports]

    clip, _ = film_clip()
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        rows = [row(chromium, clip, seed) for seed in seeds]
        chromium.close()
    actions = "actions", "minutes by the keystroke-level model", f"of {FAULTS} faults corrected"
    errors = "error without faults, mm", "with faults", "corrected", "relative difference"
    print_table([*actions, *errors, "messages in the console"], rows)


if __name__ == "__main__":
    main()
