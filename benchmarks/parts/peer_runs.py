"""Run other programs that triangulate (`peer_programs.py`) in an environment of their own, build/peers.

Missing programs are installed in the versions of `PINNED`. There are no results without a network.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from recon import Body
from recon.clip import View
from recon.fit.triangulation import triangulate_views

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = ROOT / "build" / "peers"
PINNED = (
    "aniposelib==0.7.2",
    "anytree==2.13.0",
    "c3d==0.6.0",
    "filterpy==2.0.0",
    "matplotlib==3.11.2",
    "numba==0.68.1",
    "numpy==2.4.6",
    "opencv-contrib-python==5.1.0.95",
    "pandas==3.1.1",
    "rtoml==0.14.0",
    "scipy==1.17.1",
    "statsmodels==0.15.0",
)
PINNED_ALONE = ("pose2sim==0.10.49",)
"""Program to install without dependencies, because those not in `PINNED` are for videos, detection and OpenSim."""
PROGRAMS = "aniposelib", "pose2sim"

Result = tuple[np.ndarray, float, str]
"""Positions (T, J, 3) in metres, processor time in seconds, and recon's verdict (empty for the other programs)."""


@dataclass(frozen=True, eq=False)
class PeerClip:
    """Views of one clip, and the body whose bones have constant lengths."""

    views: Sequence[View]
    fps: float
    body: Body


def peer_python() -> Path | None:
    """Install the other programs if they are missing, and return their Python interpreter, or None if that fails."""
    python = ENVIRONMENT / "bin" / "python"
    if works(python):
        return python
    environment = outside()
    if not python.is_file():
        subprocess.run([sys.executable, "-m", "venv", str(ENVIRONMENT)], check=True, env=environment)
    for arguments in (PINNED, ("--no-deps", *PINNED_ALONE)):
        command = [str(python), "-m", "pip", "install", "--quiet", "--no-input", "--timeout", "10", *arguments]
        if subprocess.run(command, check=False, env=environment, stdout=sys.stderr).returncode:
            return None
    return python if works(python) else None


def works(python: Path) -> bool:
    """Return whether a Python interpreter has the other programs in the pinned versions."""
    if not python.is_file():
        return False
    pairs = [requirement.split("==") for requirement in (*PINNED, *PINNED_ALONE)]
    code = f"from importlib.metadata import version; assert all(version(n) == v for n, v in {pairs})"
    return not subprocess.run([str(python), "-c", code], capture_output=True, check=False, env=outside()).returncode


def outside() -> dict[str, str]:
    """Return the environment variables except those by which Python finds the project."""
    return {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}


def write_clip(path: Path, clip: PeerClip) -> None:
    """Write the file from which the other programs read a clip."""
    views = clip.views
    points, focal_px = [], [float(np.mean(view.focal_px)) for view in views]
    for view, f in zip(views, focal_px, strict=True):
        rays, _ = view.camera.rays(view.xy_px)
        with np.errstate(invalid="ignore", divide="ignore"):
            points.append(f * rays[..., :2] / rays[..., 2:])
    rvecs = [Rotation.from_matrix(view.T_camera_world[:3, :3]).as_rotvec() for view in views]
    tvecs = [view.T_camera_world[:3, 3] for view in views]
    cameras = {"focal_px": focal_px, "rvecs": rvecs, "tvecs": tvecs, "fps": clip.fps}
    start = triangulate_views(views)
    np.savez(path, points=points, bones=bones(clip.body), start_m=start.points_m, is_used=start.is_used, **cameras)


def by_peers(python: Path, clips: Sequence[PeerClip], programs: Sequence[str] = PROGRAMS) -> list[dict[str, Result]]:
    """Run the other programs on clips, and return for each clip the results of each program.

    If the script of the other programs fails, this script ends.
    """
    script = Path(__file__).with_name("peer_programs.py")
    with tempfile.TemporaryDirectory() as folder:
        for number, clip in enumerate(clips):
            write_clip(Path(folder) / f"in_{number:03}.npz", clip)
        command = [str(python), "-W", "ignore", str(script), folder, *programs]
        done = subprocess.run(command, check=False, capture_output=True, text=True, env=outside(), cwd=folder)
        if done.returncode:
            raise SystemExit(f"{script.name}: {done.stderr}")
        by_clip = []
        for number in range(len(clips)):
            with np.load(Path(folder) / f"out_{number:03}.npz") as results:
                by_clip.append({name: (results[name], float(results[f"{name}_s"]), "") for name in programs})
    return by_clip


def bones(body: Body) -> np.ndarray:
    """Return the index pairs (N, 2) of keypoints with a constant distance."""
    index = body.markers.index
    return np.array([(index(a), index(b)) for limb in body.limbs.values() for a, b in pairwise(limb)])
