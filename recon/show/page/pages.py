"""Make the pages of a result and of a batch.

The page of a batch is a table of its clips, with the clips to check first at the top. All pictures are embedded in the
page's file.
"""

from __future__ import annotations

import base64
import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from recon.base.arrays import Array, finite
from recon.base.errors import InputError, printable
from recon.base.numbers import quantity
from recon.base.package import version
from recon.check.codes import FLAGS
from recon.check.verdict import reason_in_list, verdict_lines
from recon.fit.motion import Motion
from recon.fit.result import LEVELS, NEGLIGIBLE
from recon.gait.clip import ClipAnalysis
from recon.gait.dynamics import validity_text
from recon.gait.kinematics import JointKinematics
from recon.gait.spline import MIN_POINTS
from recon.io.video import Image
from recon.show.console import TO_DO, reason_finding
from recon.show.page.own_page import GENERATED, PAGE
from recon.show.page.pictures import PictureStrip
from recon.show.page.player_data import flag_runs, player_data
from recon.show.page.quality import COUNTS, quality_tables, worst_keypoint
from recon.show.page.scripts import script, style
from recon.show.report import build_report
from recon.show.sentences import analysis_sentences

if TYPE_CHECKING:
    from matplotlib.figure import Figure

JPEG_QUALITY = 80
PNG_DPI = 190.0
UNSEEN = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""Pattern of control characters and marks of text direction, which may occur in file names."""


def rendered(template: str, **content: Any) -> str:
    """Return an HTML page made from a template, in which all content except figures is escaped."""
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        finalize=_without_unseen,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    common = {"generated": GENERATED, "version": version(), "today": date.today().isoformat()}
    return environment.get_template(template).render(common | content)


def _without_unseen(value: object) -> object:
    """Return a string with control characters and marks of text direction replaced by escape sequences."""
    if not isinstance(value, str) or not UNSEEN.search(value):
        return value
    return type(value)(UNSEEN.sub(lambda mark: printable(mark[0]), value))


def inline(figure: Figure, largest: int) -> str:
    """Return a figure for a page as <svg>, or as PNG if the <svg> would have more than `largest` characters."""
    from recon.show.plots.style import png_of, svg_of  # matplotlib is slow to import

    svg = svg_of(figure, largest)
    if svg is not None:
        return svg  # no escaping, because matplotlib has escaped the figure's labels
    return f'<img alt="" src="{_data("image/png", png_of(figure, PNG_DPI, transparent=True))}">'


def jpeg(picture: Image) -> str:
    """Return a picture as the source of an <img>."""
    return _data("image/jpeg", cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes())


def _data(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"


SECTION_CHARACTERS = 600_000
"""Largest number of characters of a section's vector graphics, which keeps the page small."""
MAX_ROWS = 100
"""Largest number of rows in the table of flagged frames."""
SPEED_MM = 100.0
FIGURE_LENGTHS = 2.5
"""Distance that the animal runs in one figure of poses, in body lengths."""
POSES = 5
"""Number of poses in one figure."""
MAX_FIGURES = 3
"""Largest number of figures of poses on a page."""


@dataclass(frozen=True)
class Neighbours:
    """Links from a clip's page to the pages of its batch, relative to the clip's folder."""

    clip: str
    """Name of the clip."""
    summary: str
    previous: str | None
    following: str | None


def clip_page(
    motion: Motion,
    stills: Sequence[tuple[str, str]],
    video: str | None,
    files: Sequence[str],
    number: int = 0,
    pictures: PictureStrip | None = None,
    batch: Neighbours | None = None,
) -> str:
    """Return the HTML page of a motion.

    Parameters
    ----------
    motion : Motion
        The result.
    stills
        Pictures of frames, each with an alternative text, for paper and for browsers without scripts.
    video
        Name of the video from which the stills are; None if their background is plain.
    files
        Names of the files in the page's folder, with forward slashes, for links.
    number
        Index of the camera whose view the stills show.
    pictures
        Pictures of the same camera's video, for the player.
    batch
        Links to the pages of the clip's batch.
    """
    report = build_report(motion)
    files_read = ", ".join(dict.fromkeys(_base(camera["keypoints"]) for camera in report["cameras"]))
    has_pose = np.isfinite(motion.upright.xyz_m).all(axis=(1, 2))
    analysis = motion.derived(ClipAnalysis) if has_pose.sum() >= MIN_POINTS else None
    player = player_data(motion, analysis, number, pictures) if has_pose.any() else None
    quality = quality_tables(motion)
    quality_rows = [row for table in quality for row in table["rows"]]
    flagged = list(flagged_frames(motion))
    verdict_finding = reason_finding(report)
    further = [(number, item) for number, item in enumerate(report["findings"]) if number != verdict_finding]
    return rendered(
        "report.html",
        title=files_read if batch is None else batch.clip,
        subtitle=_subtitle(motion) if batch is None else f"{files_read} · {_subtitle(motion)}",
        batch=batch,
        words=list(_words(analysis)),
        frames=dict(report["lines"])["frames"],
        ends=[f"frame {motion.frames[row]}, {quantity(motion.time_s[row], 3, 's')}" for row in (0, -1)],
        verdict=motion.verdict,
        expected=verdict_lines(motion.verdict)[1:],
        to_do="" if motion.verdict is None else TO_DO.get(motion.verdict.level, ""),
        verdict_finding=verdict_finding,
        warnings=[(number, item["text"]) for number, item in further if item["severity"] != "note"],
        notes=[(number, item["text"]) for number, item in further if item["severity"] == "note"],
        stills=stills,
        behind=video,
        camera=motion.cameras[number].name if len(motion.cameras) > 1 else "the camera",
        cameras=len(motion.cameras),
        player=player,
        has_angles=player is not None and any(panel["group"] != "speed" for panel in player["curves"]),
        player_style=style("player"),
        player_script=script("main"),
        quality=quality,
        columns={name: heading for name, heading in COUNTS.items() if any(row[name] for row in quality_rows)},
        has_stuck=any(row["stuck"] for row in quality_rows),
        has_look=any(row["look"] for row in quality_rows),
        worst=None if player is None else worst_keypoint(quality),
        sections=[] if analysis is None else list(_sections(analysis)),
        flagged=flagged[:MAX_ROWS],
        more_flagged=max(0, len(flagged) - MAX_ROWS),
        meaning={flag: text for flag, text in FLAGS.items() if any(flag in flags for flags in motion.flags)},
        summary=[(label, text) for label, text in report["lines"] if label not in ("verdict", "expected")],
        assumptions=report["assumptions"]["sentences"],
        settings=[(name, _plain(value)) for name, value in report["settings"].items() if value is not None],
        files=files,
    )


def _base(path: str | None) -> str:
    """Return the file name at the end of a path of any operating system."""
    return (path or "clip").replace("\\", "/").rsplit("/", 1)[-1]


def _plain(value: object) -> str:
    """Return a value of the settings as a string, with at most six digits, and paths reduced to file names."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return f"{value:g}"
    return ", ".join(map(_plain, value)) if isinstance(value, list) else _base(str(value))


def _subtitle(motion: Motion) -> str:
    frames = motion.frames
    cameras_text = f" · {len(motion.cameras)} cameras" if len(motion.cameras) > 1 else ""
    first_s, last_s = motion.time_s[[0, -1]]
    times = f"{first_s:.3f} to {quantity(last_s, 3, 's')} at {motion.fps:g} frames per second"
    return f"frames {frames[0]} to {frames[-1]}, {times}{cameras_text} · {motion.title}"


def _words(analysis: ClipAnalysis | None) -> Iterator[str]:
    """Yield sentences that state speed, path and gait of a clip."""
    if analysis is None:
        yield "Too few frames have a pose for a speed or a gait."
    else:
        yield from analysis_sentences(analysis)


def flagged_frames(motion: Motion) -> Iterator[tuple[int, str, str]]:
    """Yield the first index, the frame numbers and the flags of each range of frames with the same flags.

    The frame numbers and the flags are strings, such as "12 to 15" and "left-right swap, gross outliers".
    """
    for row, stop, flags in flag_runs(motion):
        first, last = motion.frames[[row, stop - 1]]
        yield row, (f"{first}" if first == last else f"{first} to {last}"), ", ".join(flags)


def _group(heading: str, text: str, figures: Sequence[Figure], width: str = "wide") -> dict[str, Any]:
    """Return a section of a page with a heading, a paragraph and figures.

    `width` is "wide" for figures that scroll on a phone, and "narrow" for figures that do not.
    """
    drawn = [inline(figure, SECTION_CHARACTERS // len(figures)) for figure in figures]
    return {"heading": heading, "text": text, "figures": drawn, "width": width}


def _sections(analysis: ClipAnalysis) -> Iterator[dict[str, Any]]:
    from recon.show.plots.configurations import composites
    from recon.show.plots.flexion import joint_flexion
    from recon.show.plots.over_time import footfall, forces, speeds

    motion, reference_motion, gait = analysis.motion, analysis.reference_motion, analysis.gait
    ground = None if gait is None else gait.tracks.grounds
    options = {"ground": ground, "sides": motion.limb_sides}
    slope = "  The grey line is the ground under the feet. Its slope is real or an error of the camera's tilt."
    yield _group(
        "From the side, from above and from ahead",
        f"Poses evenly spaced in time; the animal runs to the right.{slope if ground else ''}",
        [
            composites(stretch, motion.limbs, motion.time_s, **options)
            for stretch in _stretches(motion, reference_motion)
        ],
    )
    name, reason = motion.reference, reference_motion.why_no_acceleration
    banded = " Bands: 90 %." * bool(np.isfinite(reference_motion.speed_sigma_m_s).any())
    text = f"Speed of {name} along its path.{banded} {reason}"
    speed_options = {"width_mm": SPEED_MM, "unknown": analysis.why_no_speed is not None, "acceleration": not reason}
    yield _group("Speed", text, [speeds({name: reference_motion}, **speed_options)], "narrow")
    if gait is not None:
        text = "Times at which each foot is in stance, determined from its speed over the ground and its height."
        yield _group("Footfalls", text, [footfall({"gait": gait}, motion.fps, has_caption=False)])
        if analysis.flexion_curves:
            text = (
                "Mean flexion over the strides, from touch-down (0 %) to touch-down; 0° is straight. Left: blue and "
                "dashed; right: orange; middle: black. Bars: stance (for "
                "spine and neck: of the foot with the most strides)."
            )
            yield _group("Joint angles over the stride", text, [joint_flexion(analysis.flexion_curves)])
        dynamics = None if motion.jitters else analysis.dynamics
        if dynamics is not None and dynamics.stance_forces:
            text = (
                "Force of each foot in body weights, estimated from its stances and the impulse of a stride on level "
                f"ground. Source of the segments' masses: {motion.body.mass_source}. {validity_text(gait.name.name)}"
            )
            yield _group("Vertical forces", text, [forces(dynamics, gait)])


def _stretches(motion: Motion, path: JointKinematics) -> Iterator[Array]:
    """Yield the poses (T, J, 3) for each figure, in which all but evenly spaced poses are NaN."""
    joints_m = motion.upright.xyz_m
    pose_rows = np.flatnonzero(np.isfinite(joints_m).all(axis=(1, 2)))
    length_m = float(np.median(np.ptp(joints_m[pose_rows], axis=1), axis=0).max())
    count = int(np.clip(np.round(np.nan_to_num(path.distance_m) / (FIGURE_LENGTHS * length_m)), 1, MAX_FIGURES))
    shown_rows = pose_rows[np.round(np.linspace(0, len(pose_rows) - 1, count * POSES)).astype(int)]
    for rows in np.split(shown_rows, count):
        part = np.full_like(joints_m, np.nan)
        part[rows] = joints_m[rows]
        yield part


FIRST_STATUSES = ("failed", "unsolved", "pending")
"""Statuses of the clips at the top of a batch's table."""
NUMBERS = {
    "pose_mm": ("pose error, mm (90 %)", ".0f"),
    "position_m": ("position error, m (90 %)", ".2f"),
    "frames": ("frames", ".0f"),
    "outliers": ("outliers", ".0f"),
    "corrected": ("corrected by hand", ".0f"),
    "median_px": ("median keypoint error, px", ".1f"),
    "mean_speed_m_s": ("mean m/s", ".1f"),
    "peak_speed_m_s": ("peak m/s", ".1f"),
    "size": ("size, × skeleton", ".2f"),
}
"""Columns of summary.csv that the table shows, with headings and formats.

`median_px` is computed from the results, since a single distant keypoint makes the mean in summary.csv large.
"""
DOT_TITLES = {
    "pose_mm": "pose error (mm)",
    "median_px": "median keypoint error (px)",
    "mean_speed_m_s": "mean speed (m/s)",
}
"""Titles of the columns of summary.csv whose distributions over the clips are drawn."""
DOTS_PX = (300.0, 44.0)
"""Width and height of a distribution plot in pixels."""
FAR_MEAN = 5.0
"""Ratio of the mean to the median keypoint error above which the page explains the difference."""
THUMBNAIL_PX = (96, 60)
FOLDERS = re.compile(r"(?<![\w.])(?:[A-Za-z]:)?[/\\](?:[^/\\:]+[/\\])+")
"""Pattern of the folders before a file name in an error message, which the page leaves out."""


def batch_page(out: Path, rows: Sequence[Mapping[str, str]]) -> str:
    """Return the HTML page of the batch in a folder from the rows of summary.csv."""
    clips = sorted((_clip_row(out, row) for row in rows), key=lambda clip: clip["rank"])
    counter = Counter(row["verdict"] or row["status"] for row in rows)
    counts = {name: counter[name] for name in dict.fromkeys((*FIRST_STATUSES, *LEVELS, *counter)) if counter[name]}
    is_corrected = any(row["corrected"] not in ("", "0") for row in rows)
    return rendered(
        "summary.html",
        title=out.absolute().name or "batch",
        clips=clips,
        counts=", ".join(f"{count} {name}" for name, count in counts.items()),
        numbers={name: NUMBERS[name] for name in NUMBERS if name != "corrected" or is_corrected},
        look=sum(clip["state"] != "use" for clip in clips),
        states=list(dict.fromkeys(clip["state"] for clip in clips)),
        dots=[dots for name, title in DOT_TITLES.items() if (dots := _dots(clips, name, title)) is not None],
        dots_box=DOTS_PX,
        script=script("table", "batch"),
        pages=any(clip["page"] for clip in clips),
        has_far_mean=any(clip["has_far_mean"] for clip in clips),
        box=THUMBNAIL_PX,
    )


def _clip_row(out: Path, cells: Mapping[str, str]) -> dict[str, Any]:
    """Return the content of a clip's row in the table of a batch, from the clip's row of summary.csv.

    The content has these fields:

    - `cells`: the row of summary.csv
    - `reason`: the reason of the verdict, if there is one
    - `numbers`: strings with values and 90 % intervals, and with the mean keypoint error if it is far above the median
    - `page`: the address of the clip's page relative to the summary, with forward slashes
    - `flagged` and `share`: the number of flagged frames, None without a result, and their fraction
    - `state`: the verdict, or the reason why there is none
    - `rank`: a key for sorting, which puts clips that need a check first
    """
    folder, order = out / cells["clip"], (*FIRST_STATUSES, *LEVELS)
    try:
        motion = Motion.load(folder)
        flagged, thumbnail = sum(map(bool, motion.flags)), _thumbnail(motion)
        error_px = median_error_px(motion)
        cells = {**cells, "median_px": f"{error_px:.4g}" if math.isfinite(error_px) else ""}
    except (OSError, InputError):  # the fit failed, or its files are damaged
        flagged, thumbnail = None, []
        cells = {**cells, "median_px": ""}
    state = cells["status"] if cells["status"] in FIRST_STATUSES else cells["verdict"]
    numbers = dict[str, list[str]]()
    for name, (_, spec) in NUMBERS.items():
        value, low, high = (float(x) if (x := cells.get(name + end)) else math.nan for end in ("", "_low", "_high"))
        numbers[name] = _with_interval(value, low, high, spec) if math.isfinite(value) else []
    mean_px, middle_px = (float(cells.get(name) or 0) for name in ("mean_reprojection_px", "median_px"))
    if has_far_mean := bool(middle_px) and mean_px > FAR_MEAN * middle_px:
        numbers["median_px"] = [*numbers["median_px"], f"mean {mean_px:.0f}"]
    return {
        "cells": {**cells, "error": FOLDERS.sub("", cells["error"])},
        "reason": reason_in_list(cells["reason"], cells.get("reason_code")) if state == cells["verdict"] else "",
        "numbers": numbers,
        "page": f"{cells['clip']}/{PAGE}" if (folder / PAGE).is_file() else None,
        "flagged": flagged,
        "share": (flagged or 0) / max(1.0, float(cells["frames"] or 0)),
        "thumbnail": thumbnail,
        "state": state,
        "has_far_mean": has_far_mean,
        "rank": (order.index(state) if state in order else 0, -float(cells["pose_mm"] or 0)),
    }


def _with_interval(value: float, low: float, high: float, spec: str) -> list[str]:
    """Return a number and, if it has one, its interval, as text. An interval that begins near 0 has only its end."""
    spec = ".1f" if spec == ".2f" and high >= 1 else spec
    if not math.isfinite(high):
        return [f"{value:{spec}}"]
    ends = f"at most {high:{spec}}" if low <= NEGLIGIBLE * high else f"{low:{spec}} to {high:{spec}}"
    return [f"{value:{spec}}", f"({ends})"]


def median_error_px(motion: Motion) -> float:
    """Return the median distance in pixels between detections and pose over all cameras, NaN without detections."""
    errors_px = np.concatenate([finite(picture.distance_px) for picture in motion.pictures])
    return float(np.median(errors_px)) if len(errors_px) else math.nan


def _dots(clips: Sequence[Mapping[str, Any]], name: str, title: str) -> dict[str, Any] | None:
    """Return a plot of the quantity `name` with a dot for each clip, or None for fewer than two clips."""
    values = {clip["cells"]["clip"]: float(value) for clip in clips if (value := clip["cells"].get(name))}
    if len(values) < 2:
        return None
    low, high = min(values.values()), max(values.values())
    width, height = DOTS_PX
    spec = NUMBERS[name][1]
    columns = Counter[int]()
    dots = []
    for clip in sorted(clips, key=lambda clip: values.get(clip["cells"]["clip"], 0.0)):
        if (value := values.get(clip["cells"]["clip"])) is None:
            continue
        x = 8 + (width - 16) * ((value - low) / (high - low) if high > low else 0.5)
        columns[column := round(x / 8)] += 1  # stack the dots of nearly equal values
        y = max(6.0, height - 8 - 7 * (columns[column] - 1))
        label = f"{clip['cells']['clip']}: {value:{spec}}"
        dots.append({"x": f"{x:.0f}", "y": f"{y:.0f}", "label": label} | {k: clip[k] for k in ("page", "state")})
        dots[-1]["clip"] = clip["cells"]["clip"]
    middle = float(np.median([*values.values()]))
    ends = {"low": low, "high": high, "median": middle}
    return {"title": title, "dots": dots} | {name: f"{value:{spec}}" for name, value in ends.items()}


def _thumbnail(motion: Motion) -> list[tuple[str, str]]:
    """Return the lines of a pose as the first camera sees it, each with its side, in a box of `THUMBNAIL_PX`.

    The pose is the one nearest to the middle of the clip.
    """
    reprojected_px = motion.pictures[0].reprojected_px
    pose_rows = np.flatnonzero(np.isfinite(reprojected_px).any(axis=(1, 2)))
    if not len(pose_rows):
        return []
    points = reprojected_px[min(pose_rows, key=lambda t: abs(t - len(reprojected_px) / 2))]
    low, high = np.nanmin(points, axis=0), np.nanmax(points, axis=0)
    scale = float(np.min(0.9 * np.array(THUMBNAIL_PX) / np.maximum(high - low, 1.0)))
    points_px = (points - (low + high) / 2) * scale + np.array(THUMBNAIL_PX) / 2
    lines = [
        (
            str(motion.limb_sides[limb] or "middle"),
            " ".join(f"{x:.0f},{y:.0f}" for x, y in points_px[list(joints_along)]),
        )
        for limb, joints_along in motion.limbs.items()
    ]
    return [line for line in lines if "nan" not in line[1]]
