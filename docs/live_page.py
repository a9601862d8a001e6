"""Make the report of the simulated video that the site's home page shows (`python docs/live_page.py FOLDER`).

The video is `data/samples/rendered.mp4`. FOLDER gets `report.html` and nothing else.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path

from recon import FitSettings, samples_folder
from recon.api.clip_results import run_clip
from recon.cli.look_options import PageSettings
from recon.cli.show import report


def main(folder: Path) -> None:
    samples = samples_folder()
    with tempfile.TemporaryDirectory() as temporary:
        clip = Path(temporary) / "rendered"
        run_clip(
            FitSettings(keypoints=samples / "rendered_points.csv", camera=samples / "rendered_camera.toml", fps=120),
            clip,
        )
        report(PageSettings(folder=clip, video=samples / "rendered.mp4"))
        folder.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(clip / "report.html", folder / "report.html")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
