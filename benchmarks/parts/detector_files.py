"""Fit the sample of a whole cheetah from the files of other programs' detectors.

python benchmarks/parts/detector_files.py
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from markdown_table import print_header, print_row

from recon import FitSettings, Pose3D, evaluate, fit_clip, read_pose3d, samples_folder
from recon.io.formats import read_keypoints
from recon.testing.detectors import FILES

SAMPLES = samples_folder()


def mpjpe_m(keypoints: Path, rename: str | None = None, skeleton: str = "cheetah-24") -> tuple[float, int]:
    """Fit a keypoint file, and return the MPJPE, metres, and the number of true joints that the file has."""
    camera = SAMPLES / "camera.toml"
    detector = "acinoset" if skeleton == "cheetah-24" else None  # the keypoints are the sample's, under different names
    given = {"camera": camera, "fps": 60.0, "rename": rename, "skeleton": skeleton, "detector": detector}
    motion = fit_clip(FitSettings(keypoints=(keypoints,), **given))
    pose = Pose3D(motion.names, motion.joints_m, motion.frames)
    error = evaluate(pose, read_pose3d(SAMPLES / "whole_truth.csv")).mpjpe_m.mean
    return error, len(motion.names) - len(motion.missing_keypoints)


def main() -> None:
    print_header(
        ["file", "`--rename`", "keypoints of the skeleton's 24", "MPJPE, mm", "MPJPE / with the skeleton's own names"]
    )
    native, used = mpjpe_m(SAMPLES / "whole.csv")
    print_row(["whole.csv", "", used, f"{1000 * native:.0f}", 1])
    with tempfile.TemporaryDirectory() as folder:
        for name, (bundled, write) in FILES.items():
            write(Path(folder) / name, read_keypoints(SAMPLES / "whole.csv"))
            error, used = mpjpe_m(Path(folder) / name, bundled)
            print_row([name, bundled or "", used, f"{1000 * error:.0f}", f"{error / native:.2f}"])
        error, _ = mpjpe_m(Path(folder) / "superanimal.csv", "superanimal-quadruped", "quadruped")
        print(f"\n`superanimal.csv` with `--skeleton quadruped`: {1000 * error:.0f} mm.")


if __name__ == "__main__":
    main()
