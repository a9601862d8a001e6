"""Make the pictures of these pages again (`python docs/figures.py`).

They are what `recon analyse`, `recon overlay` and `recon skeleton check` draw of the bundled sample and of the skeleton
in writing-a-skeleton.md, made smaller, and the errors that `benchmarks/uncertainty.py` measured. With --viewer, also
the screenshots of playbacks: of the sample, of two robots and of a climb. The viewer needs a graphics card, or Vulkan
in software (Debian: mesa-vulkan-drivers, libxkbcommon-x11-0). `bones.png` is a screenshot of a browser and is not made
here.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from PIL import Image

from recon import FitSettings, Motion, samples_folder
from recon.api.analysis_settings import AnalyseSettings
from recon.api.clip_results import run_clip
from recon.cli.analyse import analyse_command
from recon.cli.app import app
from recon.cli.look_options import OverlaySettings
from recon.cli.show import overlay
from recon.io.video import read_frames, video_writer

HERE = Path(__file__).resolve().parent
COLOURS = 255
FRAME = 30
"""The sample's frame that the overlay shows."""

ADVICE = ("--skeleton", "cheetah-24", "--angle", "front_trunk_yaw", "--cameras", "2")


def save(picture: Path, name: str, width: int) -> None:
    """As a PNG with a palette, not wider than that."""
    with Image.open(picture) as image:
        plain = image.convert("RGB")
        height = round(plain.height * width / plain.width)
        plain.resize((width, height), Image.Resampling.LANCZOS).quantize(COLOURS).save(
            HERE / "images" / name, optimize=True
        )
    print(f"{name}: {(HERE / 'images' / name).stat().st_size / 1000:.0f} kB")


def plain_video(path: Path, size_px: tuple[int, int], fps: float, frames: int) -> None:
    """The sample was simulated: there is nothing to film but a floor."""
    width, height = size_px
    picture = np.full((height, width, 3), (196, 190, 180), np.uint8)
    picture[height // 2 :] = (150, 160, 165)
    with video_writer(path, size_px, fps) as write:
        for _ in range(frames):
            write(picture)


def stated_errors() -> None:
    """Draw the true error of every view in the interval that its fit stated."""
    results = json.loads((HERE.parent / "benchmarks" / "results" / "uncertainty.json").read_text(encoding="utf-8"))
    table = results["runs"]["stated"]["tables"][0]
    views = pd.DataFrame(table["rows"], columns=table["header"])
    columns = [number for number, name in enumerate(table["header"]) if "error, " in name]
    colours = {"use": "#0072B2", "check": "#D55E00", "do not use": "#000000"}
    figure = Figure(figsize=(9, 4), layout="constrained")
    panels = figure.subplots(1, 2)
    for axes, column in zip(panels, columns, strict=True):
        error, expected, low, high = (views.iloc[:, column + k].astype(float) for k in range(4))
        order = np.argsort(expected.to_numpy(), kind="stable")
        rank = np.argsort(order)
        for level, colour in colours.items():
            rows = (views["verdict"] == level).to_numpy()
            if rows.any():
                axes.vlines(rank[rows], low[rows], high[rows], color=colour, alpha=0.35, linewidth=4)
                axes.plot(rank[rows], error[rows], "o", color=colour, markersize=4, label=f"verdict: {level}")
        axes.set(ylabel=table["header"][column].replace(", ", " (") + ")", xlabel="view, by stated error", xticks=[])
        axes.set_ylim(bottom=0)
        axes.set_title("dots: errors; bars: stated 90 % intervals", fontsize="small")
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].legend(frameon=False, loc="upper left")
    figure.savefig(HERE / "images" / "stated_errors.png", dpi=120)


def viewer_pictures(clip: Path, out: Path) -> None:
    """Make the screenshots of the playbacks of a clip, of its motion on two robots, and of a climb."""
    for robot in ("a1", "aibo"):
        app(["retarget", str(clip), "--robot", robot, "--out", str(out / robot)], standalone_mode=False)
    screenshot(clip / "motion.rrd", 22, HERE / "playback.png", 1600)
    screenshot(out / "a1" / "motion.rrd", 100, HERE / "images" / "robot_a1.png", 1200)
    screenshot(out / "aibo" / "motion.rrd", 100, HERE / "images" / "robot_aibo.png", 1200)
    screenshot(out / "climb" / "climb.rrd", 105, HERE / "images" / "climb_playback.png", 1200)


SCREEN_ROWS = slice(36, 1050)
"""Rows of the viewer's window of 1920x1080 pixels between its menu and its bar of times."""


def screenshot(recording: Path, frame: int, picture: Path, width: int) -> None:
    """Save what the viewer shows of a recording at a frame, without its menu, at a width in pixels."""
    from rerun.experimental import ViewerClient

    program = str(Path(sys.executable).with_name("rerun"))
    viewer = ViewerClient.spawn(executable_path=program, headless=True, hide_welcome_screen=True)
    whole = picture.with_suffix(".whole.png")
    try:
        viewer.open(str(recording.resolve()))
        time.sleep(LOADING_S)
        viewer.set_time("frame", sequence=frame, play_state="paused")
        time.sleep(LOADING_S)
        viewer.save_screenshot(str(whole))
        time.sleep(1.0)
        with Image.open(whole) as image:
            shown = image.convert("RGB").crop((0, SCREEN_ROWS.start, image.width, SCREEN_ROWS.stop))
    finally:
        viewer.quit()
        whole.unlink(missing_ok=True)
    height = round(shown.height * width / shown.width)
    small = shown.resize((width, height), Image.Resampling.LANCZOS)
    small.quantize(COLOURS).save(picture, optimize=True)
    print(f"{picture.name}: {picture.stat().st_size / 1000:.0f} kB")


LOADING_S = 6.0
"""Time in seconds that the viewer gets to read a recording, and to draw a frame of it."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--viewer", action="store_true", help="also make the screenshots of playbacks")
    with_viewer = parser.parse_args().viewer
    stated_errors()
    samples = samples_folder()
    (HERE / "images").mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder)
        clip = out / "clip"
        run_clip(FitSettings(keypoints=samples / "whole.csv", camera=samples / "camera.toml", fps=60), clip)
        result = Motion.load(clip)
        analyse_command(AnalyseSettings(folder=clip, all_figures=True))
        for name in (
            "speed",
            "footfalls",
            "side_view",
            "joint_flexion",
            "phase_portraits",
            "observability",
            "body_fixed",
        ):
            save(clip / "analysis" / f"{name}.png", f"{name}.png", 900)
        plain_video(out / "clip.avi", result.camera.image_size_px, result.fps, len(result.frames))
        overlay(OverlaySettings(folder=clip, video=out / "clip.avi", out=out / "overlay.avi"))
        ((_, image),) = read_frames(out / "overlay.avi", FRAME, FRAME + 1)
        cv2.imwrite(str(out / "overlay.png"), image)
        save(out / "overlay.png", "overlay.png", 960)
        app(["camera-advice", *ADVICE, "--out", str(out / "advice")], standalone_mode=False)
        save(out / "advice" / "camera_advice.png", "camera_advice.png", 900)
        app(["skeleton", "check", str(HERE / "my-cat.toml"), "--out", str(out / "my-cat")], standalone_mode=False)
        save(out / "my-cat" / "skeleton.png", "skeleton.png", 900)
        app(["climb", "published-50", "--out", str(out / "climb")], standalone_mode=False)
        save(out / "climb" / "footfalls.png", "../climb.png", 900)
        if with_viewer:
            viewer_pictures(clip, out)


if __name__ == "__main__":
    main()
