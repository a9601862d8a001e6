"""The video's frames that go with a playback, read back with rerun's own reader, alone and together with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from rerun.chunk import RrdReader

from recon.base.errors import InputError
from recon.fit.motion import Motion
from recon.io.video import video_writer
from recon.show.view import write
from recon.show.view.added import AddedSeries, write_plots
from recon.show.view.together import put_together
from recon.show.view.video import write_video

FRAMES = list(range(10, 18))


@pytest.fixture
def playback(small_trajectory: Motion, tmp_path: Path) -> Path:
    """Frames 10 to 17 at 30 fps."""
    write(small_trajectory, tmp_path / "motion.rrd")
    return tmp_path / "motion.rrd"


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eleven frames of 1920x1080, ten times the number as their grey level."""
    path = tmp_path_factory.mktemp("video") / "clip.avi"
    with video_writer(path, (1920, 1080), 30.0) as write_frame:
        for number in range(11):
            write_frame(np.full((1080, 1920, 3), 10 * number, np.uint8))
    return path


def rows(path: Path, kind: str) -> dict[str, list[dict[str, Any]]]:
    """By entity, what is stored about it; row ids are left out."""
    reader = RrdReader(path)
    (store,) = getattr(reader, kind)()
    found: dict[str, list[dict[str, Any]]] = {}
    for chunk in reader.stream(store=store).to_chunks():
        for row in chunk.to_record_batch().to_pylist():
            known = {name: value for name, value in row.items() if name != "rerun.controls.RowId" and value is not None}
            found.setdefault(chunk.entity_path, []).append(known)
    return found


def test_every_frame_has_its_picture(playback, small_trajectory, video, tmp_path):
    """The video begins with frame 8, so that the playback has its pictures 2 to 9."""
    before = rows(playback, "recordings")
    assert write_video(tmp_path / "video.rrd", playback, small_trajectory, video, first_frame=8) == 90
    assert rows(playback, "recordings") == before
    assert rows(tmp_path / "video.rrd", "recordings").keys() == {"/picture/video", "/closeup/video"}
    assert put_together(tmp_path / "together.rrd", playback, None, tmp_path / "video.rrd") == []
    after = rows(tmp_path / "together.rrd", "recordings")
    pictures = after.pop("/picture/video")
    assert after.pop("/closeup/video")
    assert after == before
    assert [row["frame"] for row in pictures] == FRAMES
    np.testing.assert_allclose([row["time"].total_seconds() for row in pictures], np.array(FRAMES) / 30, atol=1e-6)
    for number, row in enumerate(pictures, 2):
        image = cv2.imdecode(np.array(row["EncodedImage:blob"][0], np.uint8), cv2.IMREAD_COLOR)
        assert image is not None
        assert image.shape == (1080, 1920, 3)
        assert float(image.mean()) == pytest.approx(10 * number, abs=3)


def test_the_close_look_has_what_lies_around_the_animal(playback, small_trajectory, tmp_path):
    """Its middle is at (0, 0), as that of the points is; what lies beyond the picture is dark. The layout stays."""
    (wide, high), ramp = (1920, 1080), tmp_path / "ramp.avi"
    with video_writer(ramp, (wide, high), 30.0) as write_frame:
        for _ in FRAMES:
            write_frame(np.broadcast_to((np.arange(wide) // 8).astype(np.uint8)[None, :, None], (high, wide, 3)).copy())
    write_video(tmp_path / "video.rrd", playback, small_trajectory, ramp, first_frame=10)
    of_playback, found = rows(playback, "recordings"), rows(tmp_path / "video.rrd", "recordings")
    fixed = [row["Transform3D:translation"] for row in found["/closeup/video"] if "Transform3D:translation" in row]
    assert len(fixed) == 1
    left = fixed[0][0][0]
    shown = [row for row in found["/closeup/video"] if "frame" in row]
    assert [row["frame"] for row in shown] == FRAMES
    joints = {row["frame"]: row["Points2D:positions"] for row in of_playback["/picture/reprojections/joints"]
              if "Points2D:positions" in row}  # fmt: skip
    for row in shown:
        image = cv2.imdecode(np.array(row["EncodedImage:blob"][0], np.uint8), cv2.IMREAD_GRAYSCALE)
        assert image is not None
        assert image.shape[1] == -2 * left
        middle = float(np.mean([x for x, _ in joints[row["frame"]]]))
        column = image.shape[1] // 2
        if 20 < middle < wide - 20:
            assert float(image[image.shape[0] // 2, column]) == pytest.approx(middle / 8, abs=4)
    assert rows(tmp_path / "video.rrd", "blueprints").keys() >= rows(playback, "blueprints").keys()


def test_plots_and_video_together(playback, small_trajectory, video, tmp_path):
    """Whichever was written first: the layout has the tabs of the one, and the pictures of the other."""
    time_s = np.arange(10, 18) / 30
    series = AddedSeries("x", "Speed", ["x"], [(0, 0, 0)], np.ones((8, 1)), time_s=time_s, tab="Kinematics")
    write_video(tmp_path / "video.rrd", playback, small_trajectory, video, first_frame=8)
    write_plots(tmp_path / "plots.rrd", playback, small_trajectory, [series], [])
    path = tmp_path / "together.rrd"
    assert put_together(path, playback, tmp_path / "plots.rrd", tmp_path / "video.rrd") == []
    data = rows(path, "recordings")
    assert (len(data["/picture/video"]), len(data["/analysis/x"])) == (8, 17)
    layout = rows(path, "blueprints")
    named = {row["ContainerBlueprint:display_name"][0] for of in layout.values() for row in of
             if "ContainerBlueprint:display_name" in row}  # fmt: skip
    assert {"Reconstruction", "Kinematics"} <= named


def test_large_pictures_are_stored_at_a_lower_quality(playback, small_trajectory, tmp_path):
    rng = np.random.default_rng(0)
    noisy = tmp_path / "noisy.avi"
    with video_writer(noisy, (1920, 1080), 30.0) as write_frame:
        for _ in FRAMES:
            write_frame(rng.integers(0, 255, (1080, 1920, 3)).astype(np.uint8))
    quality = write_video(
        tmp_path / "video.rrd", playback, small_trajectory, noisy, first_frame=10, max_bytes=8_000_000
    )
    assert quality < 90
    assert (tmp_path / "video.rrd").stat().st_size < 8_800_000
    with pytest.raises(InputError, match=r"8 frames that take [\d.]+ MB as JPEG, expected at most 1 MB"):
        write_video(tmp_path / "more.rrd", playback, small_trajectory, noisy, first_frame=10, max_bytes=1_000_000)


def test_what_does_not_fit_leaves_the_playback_as_it_is(playback, small_trajectory, video, tmp_path):
    content = playback.read_bytes()
    small = tmp_path / "small.avi"
    with video_writer(small, (64, 48), 30.0) as write_frame:
        write_frame(np.zeros((48, 64, 3), np.uint8))
    with pytest.raises(InputError) as caught:
        write_video(tmp_path / "video.rrd", playback, small_trajectory, small, first_frame=11)
    assert [problem.field for problem in caught.value.problems] == ["size", "number"]
    with pytest.raises(InputError, match="found 11 frames that can be decoded, expected 18 or more"):
        write_video(tmp_path / "video.rrd", playback, small_trajectory, video)
    assert playback.read_bytes() == content
    assert {path.name for path in tmp_path.iterdir()} == {"motion.rrd", "small.avi"}


def test_a_video_goes_into_the_picture_of_its_camera(two_cameras, video, tmp_path):
    """And into its close look, of several that stand side by side."""
    playback, path = tmp_path / "motion.rrd", tmp_path / "video.rrd"
    write(two_cameras, playback)
    for camera in (None, "cam3"):
        with pytest.raises(InputError, match="expected one of cam1, cam2, whose video it is"):
            write_video(path, playback, two_cameras, video, first_frame=8, camera=camera)
    write_video(path, playback, two_cameras, video, first_frame=8, camera="cam2")
    assert rows(path, "recordings").keys() == {"/picture/cam2/video", "/closeup/cam2/video"}


def test_the_only_camera_needs_no_name(playback, small_trajectory, video, tmp_path):
    with pytest.raises(InputError, match="expected nothing: the playback has one camera"):
        write_video(tmp_path / "video.rrd", playback, small_trajectory, video, first_frame=8, camera="cam2")
