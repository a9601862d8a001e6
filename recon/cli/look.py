"""Show a result: draw it on its video, make its page, and open its playback."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import cv2
import numpy as np
from rich.console import Console

from recon.api.analyse import SUMMARY as ANALYSIS
from recon.api.analysis_settings import ANALYSIS_FOLDER
from recon.base.arrays import Array, Index
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.files import MANIFEST, read_manifest, staged_file
from recon.base.locks import sole_writer
from recon.base.outputs import Output, ReadResults, is_current, output_file
from recon.base.parallel import Event, run_tasks
from recon.base.progress import Progress, silent
from recon.base.settings import input_paths
from recon.check.codes import FLAG_OF
from recon.check.verdict import usable
from recon.cli.answers import Answer, say, verdict_texts, wait_for_ctrl_c
from recon.cli.look_options import OverlaySettings, PageSettings, ResultSettings, ViewSettings
from recon.fit.motion import Motion
from recon.fit.motion_forms import MOTION, REPORT
from recon.gait.clip import analyse
from recon.io.video import Image, missing_note, probe, require_codec, size_problems, video_writer
from recon.show.overlay import SIDE_COLOURS, Overlay, canvas_size, clip_frames, draw_frame, draw_tiles
from recon.show.page.own_page import PAGE, PLAYBACK, SUMMARY, SUMMARY_PAGE, VIDEO_PLAYBACK
from recon.show.page.pages import Neighbours, clip_page, jpeg
from recon.show.page.pictures import PictureStrip, cut_of, encode_strip

SLOW_FPS = 30.0
"""Maximum frame rate of an overlay video. Faster clips are slowed down to this rate unless a speed is given."""
RATE_SAME = 0.01
"""Relative difference below which frame rates count as equal, such as 29.97 and 30."""
MIN_WIDTH_PX = 640
"""Width below which videos are enlarged by a whole factor, so that their text is readable."""
MAX_STILLS = 9
"""Maximum number of stills on a page."""
OVERLAY = "overlay.mp4"
"""Video that `recon run` writes into the results folder."""
LINKED_FILES = (OVERLAY, f"{ANALYSIS_FOLDER}/{ANALYSIS}", VIDEO_PLAYBACK)
"""Files that a page links to, in addition to the files of the fit, if they exist when the page is made."""


def result_and_video(settings: ResultSettings, *checks: Callable[[], object]) -> tuple[Motion, int]:
    """Return a result, and the index of the chosen camera.

    The video, if there is one, has to come from that camera. `checks` are further checks, whose problems are reported
    together with those of the result and the video.

    Raises
    ------
    InputError
        If the result or the video cannot be used.
    """
    video = settings.video

    def opened() -> tuple[Motion, int]:
        motion, info = collect_problems(
            lambda: Motion.load(settings.folder), lambda: None if video is None else probe(video)
        )
        number, first = camera_number(motion, settings.camera_name, video), int(motion.frames.min())
        if video is not None and info is not None:
            last = max(first, first + settings.first_frame - first_in_clip(motion, number, settings), 0)
            expected = f"{last} or less: the result begins with frame {last}"
            late = Problem("--first-frame", "number", str(settings.first_frame), expected)
            wrong = size_problems(video, info, motion.cameras[number])
            raise_problems([*wrong, *([late] if settings.first_frame > last else ())])
        return motion, number

    return collect_problems(opened, *checks)[0]


def first_in_clip(motion: Motion, number: int, settings: ResultSettings) -> int:
    """Return the frame number, in the clip, of the first frame of the chosen camera's video.

    A camera that began later or earlier than the first has different frame numbers in its keypoint file.
    """
    return settings.first_frame + math.floor(motion.sources[number].offset_s * (motion.fps or 0.0) + 1e-6)


def camera_number(motion: Motion, camera: str | None, video: Path | None) -> int:
    """Return the index of the camera with the given name, or of the camera whose name is part of the video's file name.

    If neither a name nor a video is given, the index is 0.

    Raises
    ------
    InputError
        If no camera has the given name, or the file name does not show which of several cameras made the video.
    """
    names = [camera_of_clip.name for camera_of_clip in motion.cameras]
    if camera is None and video is not None and len(names) > 1:
        from recon.api.clip_cameras import cameras_in  # slow to import

        named = [*cameras_in(video.stem, names)]
        camera = named[0] if len(named) == 1 else None
    if camera in names:
        return names.index(camera)
    if camera is None and (len(names) == 1 or video is None):
        return 0
    actual = "nothing" if camera is None else camera
    raise InputError(Problem("--camera-name", "camera", actual, f"the camera of the video, one of {', '.join(names)}"))


def draw_overlay(settings: OverlaySettings, progress: Progress = silent) -> Answer:
    """Draw a result on its video, and write the new video."""
    video, out = settings.video, settings.out
    made_from = ReadResults.read(settings.folder)
    output = output_file(out, "overlay", settings.overwrite, input_paths(settings), made_from)
    checks = lambda: require_codec(out), lambda: output.require((out.name,))
    motion, number = result_and_video(settings, *checks)
    wide, high = usable(motion, settings.folder, settings.anyway).cameras[number].image_size_px
    speed = min(1.0, SLOW_FPS / motion.fps) if settings.speed is None else settings.speed
    zoom = -(-MIN_WIDTH_PX // wide)
    drawn = overlay_of(motion, speed, zoom, number)
    start = first_in_clip(motion, number, settings)
    first = max(int(motion.frames.min()), start)
    fps, count, stamps_s = motion.fps * speed, int(motion.frames.max()) + 1 - first, []
    size_px = canvas_size((zoom * wide, zoom * high))
    with output.staged_file() as staged, video_writer(staged, size_px, fps) as write:
        for frame, row, stamp_s, picture in clip_frames(motion.frames, video, start):
            stamps_s.append(stamp_s)
            if len(stamps_s) > count:
                break
            enlarged = np.asarray(cv2.resize(picture, None, fx=zoom, fy=zoom), dtype=np.uint8)
            write(draw_frame(drawn, row, frame, enlarged))
            progress("drawing", len(stamps_s) / count)
    frames_before = first - start if len(stamps_s) == count else None
    missing_frames_note = missing_note(video, np.array(stamps_s), first, frames_before)
    possible_notes = [
        first_frame_note(motion, settings),
        rate_note(video, motion.fps),
        bars_note(video),
        missing_frames_note,
    ]
    notes = [*filter(None, possible_notes)]
    sentence = f"{count} frames at {speed:.3g} times real speed ({fps:.4g} frames a second) are in {out}."
    data = {"out": out, "frames": count, "fps": fps, "speed": speed, "notes": notes}
    return Answer(data, [*verdict_texts(motion.verdict), sentence], files=[out], notes=notes)


def still_rows(motion: Motion, drawn: Overlay, count: int, start: int | None) -> Index:
    """Return the indices of up to `count` evenly spaced frames with a pose, which the page shows as stills.

    `start` is the frame number of the video's first picture.
    """
    filmed = True if start is None else motion.frames >= start
    posed = np.flatnonzero(np.isfinite(drawn.reprojected_px).any(axis=(1, 2)) & filmed)
    return posed[np.unique(np.round(np.linspace(0, len(posed) - 1, count)).astype(int))] if len(posed) else posed


def overlay_of(motion: Motion, speed: float = 1.0, zoom: int = 1, number: int = 0) -> Overlay:
    """Return the data for drawing a result on the video of the camera `number`, enlarged by `zoom`."""
    picture, camera_view = motion.pictures[number], motion.solution.views[number]
    ahead = np.broadcast_to(camera_view.T_camera_world[..., 2, :3], (len(motion.frames), 3))
    return Overlay(
        frames=motion.frames,
        fps=motion.fps,
        limbs=list(motion.limbs.values()),
        colours=[SIDE_COLOURS[motion.limb_sides[limb]] for limb in motion.limbs],
        detected_px=_enlarged(picture.reprojected_px - picture.image_error_px, zoom),
        reprojected_px=_enlarged(picture.reprojected_px, zoom),
        outliers=picture.outliers,
        depth_m=np.einsum("tjk,tk->tj", motion.upright.xyz_m, ahead),
        upright_m=motion.upright.xyz_m,
        trunk=motion.forward,
        flags=[*_flags(motion, number)],
        speed=speed,
    )


def _flags(motion: Motion, number: int) -> Iterator[list[str]]:
    """Yield the flags of each frame for a camera's picture, without flags about detections of other cameras."""
    flag_ranges = [
        (FLAG_OF[finding.code], *(finding.frames or (motion.frames[0], motion.frames[-1] + 1)))
        for finding in motion.findings
        if finding.code in FLAG_OF and finding.camera in (None, motion.cameras[number].name)
    ]
    for frame, flags in zip(motion.frames.tolist(), motion.flags, strict=True):
        frame_flags = {flag for flag, first, stop in flag_ranges if first <= frame < stop}
        yield [flag for flag in flags if flag in frame_flags or flag not in FLAG_OF.values()]


def _enlarged(xy_px: Array, zoom: int) -> Array:
    """Return pixel coordinates enlarged by a factor.

    Pixel centres are whole numbers before and after.
    """
    return zoom * xy_px + 0.5 * (zoom - 1)


def first_frame_note(motion: Motion, settings: ResultSettings) -> str | None:
    """Return a note if a video continues after the clip's last frame and its first frame number is not given."""
    is_given = settings.first_frame or motion.settings.get("frames") is not None
    if settings.video is None or is_given or any(source.offset_s for source in motion.sources):
        return None
    count, first, last = probe(settings.video).stated_frames or 0, int(motion.frames[0]), int(motion.frames[-1])
    if count <= last + 1:
        return None
    return (
        f"{settings.video.name} has {count} frames, but the clip ends with frame {last}. If the video was cut and "
        "begins after frame 0 of the keypoint file, the pose is drawn on the wrong pictures: give the number of the "
        f"video's first frame in that file, as in --first-frame {first or last + 1 - count}"
    )


def rate_note(video: Path, fps: float | None) -> str | None:
    """Return a note if the frame rate in the video file differs from the clip's.

    Such a video may be slowed down or sped up.
    """
    stated = probe(video).fps
    if fps is None or stated is None or abs(stated / fps - 1) < RATE_SAME:
        return None
    return (
        f"{video.name} states {stated:.4g} frames a second, but the clip was fitted with {fps:.4g}. Times and speeds "
        "are wrong by the ratio of the two, unless the video is slowed down or sped up. Check --fps"
    )


def bars_note(video: Path | None) -> str | None:
    """Return a note if a video has black bars, because a calibration on videos without bars does not apply to it."""
    if video is None:
        return None
    sides = zip(probe(video).bars_px, ("on the left and right", "at the top and bottom"), strict=True)
    bars = [f"{width_px} px {ends}" for width_px, ends in sides if width_px]
    if not bars:
        return None
    return (
        f"{video.name} has black bars of {' and '.join(bars)}: if its camera was calibrated on videos without bars, "
        "the focal length is wrong, and so are distances. Calibrate the camera on a video with the same bars"
    )


def make_page(settings: PageSettings, progress: Progress = silent) -> Answer:
    """Make the page of a result, or the pages of a batch and its summary page."""
    folder, video = settings.folder, settings.video
    if (folder / SUMMARY).is_file() and not (folder / REPORT).is_file():
        return _pages_of_batch(folder, video, progress)
    return _page_of_clip(settings, progress)


def _page_of_clip(settings: PageSettings, progress: Progress, whole_batch: bool = False) -> Answer:
    """Make the page of one result.

    `whole_batch` states that the pages of all clips of its batch are being made, too.
    """
    folder, page, video = settings.folder, settings.folder / PAGE, settings.video
    output = Output(folder, "report", True, made_from=ReadResults.read(folder), option="")
    motion, number = result_and_video(settings, lambda: output.require((PAGE,)) if folder.is_dir() else None)
    progress("pictures", 0.1)
    drawn, rows, strip, pictures = page_pictures(motion, number, settings, MAX_STILLS)
    tiles = draw_tiles(drawn, rows, pictures) if len(rows) else []
    shown = [(jpeg(tile), f"frame {drawn.frames[t]}") for tile, t in zip(tiles, rows, strict=True)]
    progress("figures", 0.4)
    written = read_manifest(folder) if (folder / MANIFEST).is_file() else None
    changed = [Path(problem.file).name for problem in written.changed()] if written else []
    companions = [name for name in LINKED_FILES if (folder / name).is_file()]
    stale = [name for name in companions if not is_current(folder / name, folder)]
    names = [*companions, *sorted(written.files if written else ())]
    files = [name for name in names if name not in [*changed, *stale] and (folder / name).is_file()]
    batch = neighbours(folder, whole_batch)
    html = clip_page(motion, shown, None if video is None else video.name, files, number, strip, batch)
    output.write(PAGE, html)
    changed_note = f"not linked on the page, because they are missing or changed since the fit: {', '.join(changed)}"
    stale_note = f"not linked on the page, because they may come from other results: {', '.join(stale)}"
    video_notes = [first_frame_note(motion, settings), bars_note(video)]
    possible_notes = [*video_notes, changed_note if changed else None, stale_note if stale else None]
    notes = [*filter(None, possible_notes)]
    data = {"page": page, "failed": {}, "notes": notes}
    return Answer(data, [f"Open {page} in a browser."], files=[page], notes=notes)


def neighbours(folder: Path, whole_batch: bool = False) -> Neighbours | None:
    """Return the links to the pages of a result's batch, or None if the result is not part of a batch.

    If `whole_batch` is true, all pages of the batch are linked, because they will exist. Otherwise only existing pages
    are linked.
    """
    folder = folder.absolute()
    out = folder.parent
    if not (out / SUMMARY).is_file() or not (whole_batch or (out / SUMMARY_PAGE).is_file()):
        return None
    names = [path.parent.name for path in sorted(out.glob(f"*/{REPORT}"))]
    own_index = names.index(folder.name) if folder.name in names else len(names)

    def link(index: int) -> str | None:
        exists = 0 <= index < len(names) and (whole_batch or (out / names[index] / PAGE).is_file())
        return f"../{names[index]}/{PAGE}" if exists else None

    return Neighbours(folder.name, f"../{SUMMARY_PAGE}", link(own_index - 1), link(own_index + 1))


class PagePictures(NamedTuple):
    """Pictures of the video for a result's page, and the reprojected motion to draw over them."""

    drawn: Overlay
    rows: Index
    """Indices of the motion's frames that the page shows as still pictures, shape (n,)."""
    strip: PictureStrip | None
    """Pictures of the video for the player, None without a video."""
    stills: list[Image] | None
    """Background of each still picture, taken from the video; None without a video."""


def page_pictures(motion: Motion, number: int, settings: ResultSettings, count: int) -> PagePictures:
    """Return the pictures for a result's page: up to `count` stills, and the pictures of the page's player.

    `number` is the index of the camera that recorded the video.

    Raises
    ------
    InputError
        If the video lacks a frame.
    """
    drawn, start = overlay_of(motion, number=number), first_in_clip(motion, number, settings)
    rows = still_rows(motion, drawn, count, start if settings.video else None)
    if settings.video is None or not len(rows):
        return PagePictures(drawn, rows, None, None)
    frames = motion.frames[: rows[-1] + 1]
    kept = dict[int, Image]()

    def pictures() -> Iterator[tuple[int, Image]]:
        for _, row, _, picture in clip_frames(frames, Path(settings.video or ""), start):
            if row is not None:
                if row in rows:
                    kept[row] = picture
                yield row, picture

    cut = cut_of(drawn.reprojected_px, motion.fps, motion.cameras[number].image_size_px)
    strip = encode_strip(pictures(), int((frames >= start).sum()), cut)
    strip.video, strip.first_frame = settings.video.name, start
    return PagePictures(drawn, rows, strip, [kept[row] for row in rows.tolist()])


def _pages_of_batch(out: Path, video: Path | None, progress: Progress) -> Answer:
    """Make the page of every result in a batch's folder, in parallel, and the summary page."""
    from recon.api.batch import read_rows, write_summary_page  # slow to import

    if video is not None:
        raise InputError(Problem("--video", "file", f"{video} for many clips", "the folder of one clip's results"))
    failed: dict[str, str] = {}
    with sole_writer(out):
        read_rows(out / SUMMARY)  # raise InputError before any work
        clips = [path.parent for path in sorted(out.glob(f"*/{REPORT}"))]
        done = 0

        def note_end(event: Event) -> None:
            nonlocal done
            if event.kind == "ended":
                done += 1
                if event.outcome["status"] == "failed":
                    failed[event.name] = event.outcome["error"]
                progress(f"{done} of {len(clips)} pages", done / len(clips))

        run_tasks(_page_of, [(clip.name, clip.absolute()) for clip in clips], note_end)
        page = write_summary_page(out)
    errors = [f"{clip}: {error}" for clip, error in failed.items()]
    return Answer({"page": page, "failed": failed}, [f"Open {page} in a browser."], errors)


def _page_of(folder: Path, progress: Progress) -> dict[str, str]:
    _page_of_clip(PageSettings(folder=folder), progress, whole_batch=True)
    return {"status": "done"}


def show_playback(settings: ViewSettings, console: Console) -> Answer:
    """Open the playback of a result in the viewer, serve it to a browser, or write it to a recording."""
    folder, out = settings.folder, settings.out
    playback = folder / PLAYBACK
    if playback.is_file():
        read_manifest(folder).require(PLAYBACK)
    elif not (folder / MOTION).is_file():
        raise InputError(Problem(playback, "file", "no such file", "a recording (.rrd) that `recon fit` has written"))
    if out is not None:
        answer = write_recording(settings)
        for note in answer.notes:
            say(console, f"note: {note}")
        return replace(answer, notes=())
    with_video = folder / VIDEO_PLAYBACK
    if settings.video is None and with_video.is_file() and is_current(with_video, folder):
        playback = with_video
    elif settings.video is not None or (folder / ANALYSIS_FOLDER / ANALYSIS).is_file() or not playback.is_file():
        with TemporaryDirectory() as temporary:
            path = Path(temporary) / PLAYBACK
            if note := _write(settings, path):
                say(console, f"note: {note}")
            _show(path, settings, console)
        return Answer({"recording": None})
    _show(playback, settings, console)
    return Answer({"recording": playback})


def write_recording(settings: ViewSettings, progress: Progress = silent) -> Answer:
    """Write a recording with the video and the plots of the analysis, for `recon view` and for rerun."""
    folder, out = settings.folder, settings.out
    assert out is not None
    output = output_file(out, "view", settings.overwrite, input_paths(settings), ReadResults.read(folder))
    output.require((out.name,))
    progress("writing", 0.1)
    with output.staged_file() as staged:
        note = _write(settings, staged)
    line = f"The recording is in {out}. Watch it with: rerun {shlex.quote(str(out))}"
    return Answer({"recording": out}, [line], files=[out], notes=[note] if note else [])


def _write(settings: ViewSettings, path: Path) -> str | None:
    """Write a recording, and return a note on the video, or None."""
    from recon.show import view as viewer  # slow to import

    motion, number = result_and_video(settings)
    analysis = analyse(motion) if (settings.folder / ANALYSIS_FOLDER / ANALYSIS).is_file() else None
    with staged_file(path) as staged:
        viewer.write(motion, staged, analysis, settings.video, first_in_clip(motion, number, settings), number)
    return first_frame_note(motion, settings)


def _show(playback: Path, settings: ViewSettings, console: Console) -> None:
    """Open a recording in the viewer, or serve it to browsers until Ctrl-C."""
    if not settings.web:
        from recon.show.view import open_viewer

        open_viewer(playback)
        return
    from recon.show.view.web import served

    with served(playback) as address:
        say(console, f"Open {address} in a browser on this machine. Ctrl-C ends the viewer.")
        wait_for_ctrl_c()
