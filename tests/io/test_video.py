"""Test the frame numbers of videos that are read, and that no incomplete video is written."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import refusal

from recon.io.video import (
    black_bars,
    missing_frames,
    missing_note,
    probe,
    read_frames,
    read_picture,
    timed_frames,
    video_writer,
)
from recon.testing.files import write_damaged_video


def grey(level: int) -> np.ndarray:
    return np.full((48, 64, 3), level, np.uint8)


@pytest.fixture(scope="module", params=[".avi", ".mp4"])
def counted(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a video of twenty frames whose grey level is ten times the frame number."""
    path = tmp_path_factory.mktemp("video") / f"counted{request.param}"
    with video_writer(path, (64, 48), 25.0) as write:
        for number in range(20):
            write(grey(10 * number))
    return path


def levels(path: Path, *args: int, **kwargs: int) -> list[tuple[int, int]]:
    return [(number, round(float(image.mean()) / 10)) for number, image in read_frames(path, *args, **kwargs)]


def test_frames_are_counted_from_zero(counted):
    assert levels(counted) == [(n, n) for n in range(20)]


def test_a_range_of_frames_keeps_its_frame_numbers(counted):
    assert levels(counted, 3, 15, 4) == [(3, 3), (7, 7), (11, 11)]
    assert levels(counted, 18, 30) == [(18, 18), (19, 19)]


def test_probe_returns_what_the_file_states(counted):
    info = probe(counted)
    assert (info.size_px, info.fps, info.stated_frames) == ((64, 48), 25.0, 20)


def test_an_interrupted_video_leaves_nothing_and_the_old_one_stays(tmp_path):
    path = tmp_path / "new" / "v.mp4"
    path.parent.mkdir()
    path.write_bytes(b"old")

    def interrupted() -> None:
        with video_writer(path, (64, 48), 25.0) as write:
            write(grey(0))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert {file.name: file.read_bytes() for file in path.parent.iterdir()} == {"v.mp4": b"old"}


def test_pictures_of_another_size_are_refused(tmp_path):
    with (
        pytest.raises(ValueError, match="a picture of shape"),
        video_writer(tmp_path / "v.mp4", (64, 64), 25.0) as write,
    ):
        write(grey(0))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("name", "found"), [("none.mp4", "no such file"), ("text.mp4", "cannot be decoded")])
def test_a_file_that_is_no_video_is_refused(tmp_path, name, found, capfd):
    (tmp_path / "text.mp4").write_text("no video")
    with refusal((tmp_path / name, "video", found, "a video")):
        probe(tmp_path / name)
    with refusal((tmp_path / name, "video", found, "a video")):
        next(read_frames(tmp_path / name))


def test_a_suffix_without_a_codec_is_an_input_error(tmp_path):
    with (
        refusal((tmp_path / "v.gif", "suffix", "'.gif'", ".mp4, .avi")),
        video_writer(tmp_path / "v.gif", (64, 48), 25),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


def test_names_that_look_like_addresses(tmp_path, monkeypatch, counted):
    """A video whose path has a colon is read and written, although FFmpeg reads a protocol before a colon."""
    monkeypatch.chdir(tmp_path)
    Path("http:").mkdir()
    for name in (f"run10:30{counted.suffix}", f"http:/run{counted.suffix}"):
        Path(name).write_bytes(counted.read_bytes())
        assert levels(Path(name)) == [(n, n) for n in range(20)]
        with video_writer(f"new{name}" if "/" not in name else f"http:/new{counted.suffix}", (64, 48), 25.0) as write:
            write(grey(10))
        assert probe(f"new{name}" if "/" not in name else f"http:/new{counted.suffix}").size_px == (64, 48)


def test_a_picture_that_states_too_many_pixels_cannot_be_read(tmp_path):
    content = bytearray(cv2.imencode(".jpg", grey(90))[1].tobytes())
    (tmp_path / "good.jpg").write_bytes(content)
    at = content.find(b"\xff\xc0") + 5
    content[at : at + 4] = b"\xff\xdc\xff\xdc"
    (tmp_path / "giant.jpg").write_bytes(content)
    read = [read_picture(tmp_path / name, cv2.IMREAD_GRAYSCALE) for name in ("good.jpg", "giant.jpg", "none.jpg")]
    assert [None if picture is None else picture.shape for picture in read] == [(48, 64), None, None]


def test_a_hole_in_a_video_is_found_by_its_time_stamps(tmp_path):
    video = write_damaged_video(tmp_path / "a.mkv")
    times = np.array([stamp_s for _, stamp_s, _ in timed_frames(video)])
    ((at, count),) = (missing_frames(times) or {}).items()
    assert len(times) == 40 - count < 40
    assert [number for number, _ in read_frames(video)] == [*range(len(times))]
    np.testing.assert_allclose(np.delete(np.arange(40), np.s_[at : at + count]) / 25, times - times[0], atol=1e-9)
    said = missing_note(video, times, 100) or ""
    assert f"({count} before frame {at + 100})" in said
    assert said.endswith(f"--frames :{at + 100}")


def test_frames_missing_without_gaps_in_time_stamps_are_reported(tmp_path):
    video = write_damaged_video(tmp_path / "a.avi")
    times = np.array([stamp_s for _, stamp_s, _ in timed_frames(video)])
    assert missing_frames(times) == {}
    assert len(times) < 40
    assert f"states 40 frames, but {len(times)} can be decoded" in (missing_note(video, times) or "")


@pytest.mark.parametrize(
    ("times_s", "missing"),
    [
        (np.delete(np.arange(99), [7, 50, 51]) / 240, {7: 1, 49: 2}),
        (np.round(np.delete(np.arange(99), [7, 50, 51]) / 240, 3), {7: 1, 49: 2}),
        (np.zeros(9), {}),
        (np.zeros(1), {}),
        (np.cumsum(np.tile([0.02, 0.033, 0.047], 9)), None),
        (np.r_[np.arange(9), np.arange(9)] / 30, None),
        (np.cumsum(np.r_[np.ones(20), np.full(20, 1.25)]) / 30, None),
        (np.cumsum(np.linspace(1, 2, 40)) / 60, None),
        (np.cumsum(np.tile([1, 1.5], 20)) / 60, {}),
        (np.round(np.arange(9) / 120, 3), {}),
    ],
    ids=[
        "regular",
        "whole milliseconds",
        "no stamps",
        "one frame",
        "a varying rate",
        "back in time",
        "slower at once",
        "slower by and by",
        "pulled down",
        "few",
    ],
)
def test_time_stamps(counted, times_s, missing):
    assert missing_frames(times_s) == missing
    assert ("uneven in time" in (missing_note(counted, times_s) or "")) == (missing is None)


@pytest.mark.parametrize(
    ("rows", "columns", "level", "bars"),
    [
        (slice(6, -6), slice(None), 150, (0, 6)),
        (slice(None), slice(8, -8), 150, (8, 0)),
        (slice(None), slice(None), 150, (0, 0)),
        (slice(6, -6), slice(None), 30, (0, 0)),
        (slice(0, -12), slice(None), 150, (0, 0)),
    ],
)
def test_black_bars_are_equal_and_surround_a_bright_picture(rows, columns, level, bars):
    picture = np.full((48, 64, 3), 10, dtype=np.uint8)
    picture[rows, columns] = level
    assert (black_bars(picture, 1), black_bars(picture, 0)) == bars
