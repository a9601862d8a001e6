"""Measure joint errors in the bone files of `recon convert`, as read by other programs and libraries.

python benchmarks/parts/bones.py

The table has a row for each format and each installed reader (`recon.testing.bones`), for the fits of two samples: a
whole animal and a chain.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from markdown_table import print_header, print_row

from recon.testing.bones import FPS, READERS, largest_error_m


def main() -> None:
    from recon import FitSettings
    from recon.api.clip_results import run_clip
    from recon.cli.convert import ConvertSettings, convert
    from recon.fit.motion import Motion

    samples = Path(__file__).resolve().parents[2] / "data" / "samples"
    print_header(["file", "read by", "whole animal, mm", "chain, mm"])
    with tempfile.TemporaryDirectory() as folder:
        clips = {}
        for clip, skeleton in (("whole", None), ("noisy", "cheetah-8u")):
            camera, out = samples / "camera.toml", Path(folder) / clip
            run_clip(
                FitSettings(keypoints=(samples / f"{clip}.csv",), camera=(camera,), fps=FPS, skeleton=skeleton), out
            )
            clips[clip] = Motion.load(out).upright
        for extension, readers in READERS.items():
            for clip in clips:
                convert(ConvertSettings(source=Path(folder) / clip, out=Path(folder) / f"{clip}{extension}"))
            for name, read in readers:
                try:
                    off = [
                        largest_error_m(read(Path(folder) / f"{clip}{extension}"), pose.names, pose.xyz_m)
                        for clip, pose in clips.items()
                    ]
                except ImportError as error:
                    print_row([f"`{extension}`", name, f"not installed: {error.name}", ""])
                else:
                    print_row([f"`{extension}`", name, *(f"{1000 * one:.1g}" for one in off)])


if __name__ == "__main__":
    main()
