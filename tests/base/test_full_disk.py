"""Test that a full disk ends in one line that names the file, and leaves no partial files, with any library.

`tests/fuzz/full_disk.py` tests every command on a full disk. Here the size of files is limited, which the system
reports with another error.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from command_line import run

from recon import FitSettings, write_clip
from recon.animal.skeleton_file import load_skeleton
from recon.base.files import staged_file
from recon.clip import Keypoints
from recon.fit.motion import Motion
from recon.io.common import Pose3D
from recon.io.formats import CONVERTED, FORMATS, Format
from recon.io.video import video_writer
from recon.show.rig import make_rig

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="limits are of POSIX")

NAMES, FRAMES = ("nose", "tail base", "paw"), np.arange(40)
RNG = np.random.default_rng(0)
KEYPOINTS = Keypoints(NAMES, 1e3 * RNG.random((40, 3, 2)), RNG.random((40, 3)), FRAMES, fps=50.0)
POSE = Pose3D(("nose", "tail_base", "paw"), RNG.random((40, 3, 3)), FRAMES, fps=50.0)
CHAIN = load_skeleton("cheetah-8u")
RIG = make_rig(CHAIN, 1.0, CHAIN.keypoint_names("left"), np.arange(3), np.zeros((3, CHAIN.n_state)), 50.0)
DATA = {"2D": KEYPOINTS, "3D": POSE, "bones": RIG}
WRITERS = [(f, kind) for f in CONVERTED for kind in f.writes]


@contextmanager
def files_up_to(size: int) -> Iterator[None]:
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))  # Python ignores the signal
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def put(file_format: Format, kind: str, path: Path) -> None:
    with staged_file(path) as staged:
        file_format.write(DATA[kind], staged)


def film(path: Path) -> None:
    picture = np.random.default_rng(1).integers(0, 255, (240, 320, 3), dtype=np.uint8)
    with video_writer(path, (320, 240), 30) as write:
        for _ in range(10):
            write(picture)


@pytest.mark.parametrize(("file_format", "kind"), WRITERS, ids=[f"{f.title} {kind}" for f, kind in WRITERS])
def test_every_format(file_format: Format, kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"data{file_format.suffixes[0]}"
    put(file_format, kind, path)
    size = path.stat().st_size
    for written in tmp_path.iterdir():
        written.unlink()
    for limit in (0, size // 3, size - 1):
        with files_up_to(limit), pytest.raises(OSError, match=r"File too large|is the disk full") as caught:
            put(file_format, kind, path)
        assert caught.value.filename == str(path)
        assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "limit", [0, 30_000, *(pytest.param(limit, marks=pytest.mark.slow) for limit in (2_000, 100_000))]
)
def test_results(limit: int, small_trajectory: Motion, tmp_path: Path) -> None:
    settings = FitSettings(keypoints=Path("run.csv"), hfov_deg=64, image_size_px=(1920, 1080), fps=30)
    with files_up_to(limit), pytest.raises(OSError, match="File too large") as caught:
        write_clip(small_trajectory, settings, tmp_path / "out")
    assert Path(str(caught.value.filename)).parent in (tmp_path, tmp_path / "out")
    assert list(tmp_path.iterdir()) == []
    write_clip(small_trajectory, settings, tmp_path / "out")
    before = {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()}
    with files_up_to(limit), pytest.raises(OSError, match="File too large"):
        write_clip(small_trajectory, settings, tmp_path / "out")
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == before


@pytest.mark.parametrize("lacking", [50_000, 300, 1])
@pytest.mark.parametrize("suffix", ["mp4", "avi"])
def test_a_video(suffix: str, lacking: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """A full disk is reported, although OpenCV continues to write and prints its own message.

    All frames of an AVI without its end can be decoded.
    """
    film(tmp_path / f"a.{suffix}")
    size = (tmp_path / f"a.{suffix}").stat().st_size
    (tmp_path / f"a.{suffix}").unlink()
    with files_up_to(size - lacking), pytest.raises(OSError, match="could not be written: is the disk full") as caught:
        film(tmp_path / f"a.{suffix}")
    assert caught.value.filename == str(tmp_path / f"a.{suffix}")
    assert list(tmp_path.iterdir()) == []
    assert capfd.readouterr().err == ""


def test_command_prints_one_line(tmp_path: Path) -> None:
    source, out = tmp_path / "source.npz", tmp_path / "clip.trc"
    put(next(f for f in FORMATS if f.name == "npz"), "3D", source)
    with files_up_to(1000):
        ended = run("convert", source, out)
    assert ended == (2, "", f"error: {out}: File too large\n")
    assert [path.name for path in tmp_path.iterdir()] == ["source.npz"]
