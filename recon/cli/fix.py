"""The page of `recon fix`, on which wrong keypoints are corrected, and the export of the corrections."""

from __future__ import annotations

import shlex
import threading
from http import HTTPStatus
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
from rich.console import Console

from recon.api.clip_results import read_config
from recon.api.corrections import CorrectionSession
from recon.api.label_export import CorrectedClip, labels_output, write_labels
from recon.base.arrays import Integers
from recon.base.errors import InputError, Problem
from recon.base.local_server import LocalServer, Reply, json_reply, number_in
from recon.base.locks import sole_editor
from recon.base.numbers import counted
from recon.base.outputs import Output, ReadResults, output_file, require_suffix
from recon.cli.answers import Answer
from recon.cli.look import first_in_clip, result_and_video
from recon.cli.serving import saving, serve_until_ctrl_c
from recon.cli.video_options import FixSettings
from recon.fit.motion import Motion
from recon.fit.motion_forms import CONFIG
from recon.io.corrections import CORRECTIONS
from recon.io.deeplabcut import write_csv
from recon.io.hdf5_poses import write_deeplabcut
from recon.io.video import Image, probe
from recon.show.overlay import clip_frames
from recon.show.page.pages import rendered
from recon.show.page.scripts import script, style

JPEG_QUALITY = 90


def fix_or_export(settings: FixSettings, console: Console) -> Answer:
    """Serve the page until Ctrl-C, or export the corrections, and return the answer."""
    motion, number = result_and_video(settings)
    out = settings.out or read_config(settings.folder / CONFIG, {}).corrections or settings.folder / CORRECTIONS
    require_suffix(out, (".csv",))
    if settings.export_labels is not None or settings.export_table is not None:
        return _export(settings, motion, number, out)
    if not out.parent.is_dir():
        raise InputError(Problem("--out", "folder", f"no folder {out.parent}", "an existing folder"))
    if out.is_symlink():
        raise InputError(Problem("--out", "file", f"the link {out}", "a file, not a link"))
    with sole_editor(out), TemporaryDirectory() as folder:
        session = CorrectionSession.open(settings.folder, out, number)
        pictures = Path(folder)
        if settings.video is not None:
            start = first_in_clip(motion, number, settings)
            frames = motion.frames, settings.video, start
            _require_length(*frames)
            threading.Thread(target=_decode, args=(*frames, pictures, console), daemon=True).start()
        server = _server(session, pictures, settings.video is not None)
        serve_until_ctrl_c(
            console, server, f"Corrections are saved in {out}. Ctrl-C ends the editor.", settings.browser
        )
    lines = [f"{counted(len(session.corrections), 'correction')} in {out}."]
    if session.corrections:
        config, corrections = (shlex.quote(str(file)) for file in (settings.folder / CONFIG, out))
        lines.append(f"Fit with them: recon fit --config {config} --corrections {corrections} --out again")
    return Answer({"out": out, "corrections": len(session.corrections)}, lines)


def _export(settings: FixSettings, motion: Motion, number: int, path: Path) -> Answer:
    folder, video, table = settings.export_labels, settings.video, settings.export_table
    labels_out, table_out = _outputs(settings, path)
    if not path.exists():
        actual = "no such file" if settings.out else "no such file: no keypoint has been corrected"
        expected = f"corrections made with recon fix {shlex.quote(str(settings.folder))}, or their file given to --out"
        raise InputError(Problem(path, "file", actual, expected))
    clip = CorrectedClip.read(settings.folder, path, number)
    lines, data, files = [], dict[str, object](), list[Path]()
    if labels_out is not None and video is not None:
        labels = clip.labels(video.stem, settings.scorer, settings.with_accepted)
        first = first_in_clip(motion, number, settings) - motion.sources[number].later_frames
        write_labels(labels, video, first, labels_out)
        points = int(labels.known.sum())
        count = f"{counted(len(labels.frames), 'frame')} with {counted(points, 'label')}"
        train = f"recon train {shlex.quote(str(folder))} --out models/again"
        lines.append(f"{count} are in {labels_out.folder}. Train on them: {train}")
        data |= {"labels": labels_out.folder, "frames": len(labels.frames), "points": points}
        files += [labels_out.folder / name for name in labels.file_names]
    if table_out is not None and table is not None:
        with table_out.staged_file() as staged:
            write = write_csv if table.suffix.lower() == ".csv" else write_deeplabcut
            write(clip.keypoints(), staged)
        lines.append(f"The keypoints with {counted(len(clip.corrections), 'correction')} are in {table}.")
        data |= {"table": table, "corrections": len(clip.corrections)}
        files.append(table)
    return Answer(data, lines, files=files)


def _outputs(settings: FixSettings, path: Path) -> tuple[Output | None, Output | None]:
    """Return the outputs for the exported labels and for the exported table, None for what is not exported.

    Raises
    ------
    InputError
        If the outputs cannot be written. The error is raised before any work is done.
    """
    folder, video, table = settings.export_labels, settings.video, settings.export_table
    inputs = [path, settings.folder, *([video] if video else [])]
    labels_out = table_out = None
    if folder is not None and video is not None:
        labels_out = labels_output(folder, video.stem, "fix", "--export-labels", settings.overwrite, inputs)
        labels_out.require()
    if table is not None:
        require_suffix(table, (".csv", ".h5"), "--export-table")
        made_from = ReadResults.read(settings.folder)
        table_out = output_file(table, "fix", settings.overwrite, inputs, made_from, "--export-table")
        table_out.require((table.name,))
    return labels_out, table_out


def _require_length(frames: Integers, video: Path, start: int) -> None:
    """Raise InputError if the video states fewer frames than the clip needs.

    `frames` are the clip's frame numbers, and `start` is the number of the video's first frame.
    """
    stated, needed = probe(video).stated_frames, int(frames.max()) + 1 - start
    if stated is not None and stated < needed:
        expected = f"{needed} frames or more: the video of this clip, or --first-frame for a video that was cut"
        raise InputError(Problem(video, "video", f"{stated} frames", expected))


def _decode(frames: Integers, video: Path, start: int, folder: Path, console: Console) -> None:
    """Write every frame of the clip as a picture that is named after the index of the frame in the clip.

    A message reports a video that ends before the clip.

    `frames` are the clip's frame numbers, and `start` is the number of the video's first frame.
    """
    try:
        for _, row, _, picture in clip_frames(frames, video, start):
            if row is not None:
                _write_picture(folder / f"{row}.jpg", picture)
    except InputError as error:  # the other frames can still be corrected
        console.print(str(error), markup=False, highlight=False)


def _write_picture(path: Path, picture: Image) -> None:
    content = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
    part = path.with_suffix(".part")
    part.write_bytes(content)
    part.replace(path)


def _server(session: CorrectionSession, pictures: Path, has_video: bool) -> LocalServer:
    def page(_rest: str, _data: object) -> Reply:
        html = rendered(
            "fix.html",
            title=f"Correct {session.folder.name}",
            state=session.state() | {"video": has_video},
            player_style=style("player"),
            editor_script=script("fix"),
        )
        return Reply(html.encode(), "text/html")

    def state(rest: str, _data: object) -> Reply:
        version = number_in(rest)
        is_new = session.wait_for_fit(-1 if version is None else version)
        return json_reply(session.state() if is_new else None)

    def picture(rest: str, _data: object) -> Reply:
        number = number_in(rest)
        path = None if number is None else pictures / f"{number}.jpg"
        if path is None or not path.is_file():
            return json_reply(None, HTTPStatus.NOT_FOUND)
        return Reply(path.read_bytes(), "image/jpeg")

    def lines(rest: str, _data: object) -> Reply:
        parts = rest.split("/")
        numbers = [number for part in parts if (number := number_in(part)) is not None]
        return json_reply(session.lines_px(*numbers) if len(numbers) == len(parts) == 3 else {})

    return LocalServer(
        {"": page, "state": state, "picture": picture, "lines": lines},
        {"corrections": saving(session.save, session.out)},
    )
