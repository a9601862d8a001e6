"""Test that `recon report` makes single files that fetch nothing and in which names are text."""

from __future__ import annotations

import csv
import html
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from importlib.resources import files
from pathlib import Path
from urllib.parse import quote, unquote

import cv2
import numpy as np
import pytest
from command_line import refusal, refused, run, says
from markupsafe import Markup
from motions import with_first

from recon import FitSettings, write_clip
from recon.api.batch import COLUMNS, write_summary_page
from recon.base.files import read_manifest, write_manifest
from recon.check.codes import finding, sentence
from recon.check.rules import findings_of
from recon.cli.look import neighbours
from recon.cli.look_options import PageSettings
from recon.cli.show import report
from recon.fit.motion import Motion
from recon.io.video import video_writer
from recon.show.console import TO_DO
from recon.show.page.pages import Neighbours, _sections, _without_unseen, clip_page, flagged_frames, inline
from recon.show.plots.style import drawing
from recon.show.report import build_report

EVIL = '<img src=x onerror="alert(1)">&\'.csv'
MOST_BYTES = 3_000_000
GENERATED = '<meta name="generator" content="recon">'


class Page(HTMLParser):
    """Page parsed as a browser would parse it."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.html = path.read_text(encoding="utf-8")
        self.feed(self.html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    handle_startendtag = handle_starttag

    def handle_data(self, data: str) -> None:
        self.text += data

    def attributes(self, tag: str, name: str) -> list[str]:
        return [str(attrs[name]) for found, attrs in self.tags if found == tag and name in attrs]


def require_self_contained(page: Page, folder: Path, scripts: int = 0) -> None:
    """Check that a page fetches nothing, runs only its own scripts, and links only to existing files."""
    assert [tag for tag, _ in page.tags].count("script") == scripts
    assert len(page.html.encode()) < MOST_BYTES
    for _, attrs in page.tags:
        assert not any(name.startswith("on") for name in attrs)
    for source in page.attributes("img", "src"):
        assert source.startswith("data:image/")
    for target in page.attributes("a", "href"):
        assert (folder / unquote(target)).is_file(), target
    assert page.attributes("link", "href") == ["data:,"]
    assert not {"iframe", "object", "embed", "base"} & {tag for tag, _ in page.tags}
    assert set(re.findall(r"url\((.)", page.html)) <= {"#"}
    assert "@import" not in page.html


@pytest.fixture(scope="module")
def folder(small_trajectory, tmp_path_factory) -> Path:
    """Return a folder of results whose keypoint file has a name that is HTML."""
    path = tmp_path_factory.mktemp("page") / "a & <b>"
    source = small_trajectory.sources[0]
    motion = with_first(small_trajectory, keypoints=replace(source.keypoints, source=f"/tmp/{EVIL}"))
    motion = replace(motion, findings=findings_of(motion))
    write_clip(motion, FitSettings(keypoints=Path(EVIL), camera=Path("<script>.toml"), fps=30), path)
    return path


@pytest.fixture(scope="module")
def page(folder) -> Page:
    return Page(report(PageSettings(folder=folder)).data["page"])


def test_a_page_is_one_file_in_which_names_are_text(page, folder):
    require_self_contained(page, folder, scripts=2)
    assert EVIL in page.text
    assert "<script>.toml" in page.text
    assert page.text.count("\n") > 20


@pytest.mark.usefixtures("undrawn")
def test_a_page_has_no_link_to_a_file_that_was_changed(folder, tmp_path):
    copy = shutil.copytree(folder, tmp_path / "copy")
    (copy / "angles.csv").write_text("x")
    answer = report(PageSettings(folder=copy))
    assert len(answer.notes) == 1
    assert says(answer.notes[0], "angles.csv", "not linked")
    links = Page(answer.data["page"]).attributes("a", "href")
    assert set(links) == set(read_manifest(folder).files) - {"angles.csv"}


def test_no_field_of_a_template_has_the_name_of_a_method():
    """Jinja finds the method of a dictionary before its item, and a method is always true."""
    methods = "|".join(name for name in dir(dict) if not name.startswith("_"))
    for template in (files("recon.show.page") / "templates").iterdir():
        text = template.read_text(encoding="utf-8")
        for expression in re.findall(r"{[{%](.*?)[%}]}", text, re.DOTALL):
            assert not re.search(rf"\w\.({methods})\b(?!\()", expression), (template.name, expression)


def test_marks_of_direction_are_shown_as_codes():
    assert _without_unseen("a\u202egnp.exe") == r"a\u202egnp.exe"
    assert _without_unseen("a\x1b[2Jb\n\u00e9") == "a\\x1b[2Jb\n\u00e9"
    assert isinstance(_without_unseen(Markup("<b>\u2067</b>")), Markup)
    assert _without_unseen("Jürgen: 3\u00a0m") == "Jürgen: 3\u00a0m"


def test_a_page_states_the_numbers_of_the_report(page, folder):
    results = Motion.load(folder)
    report = build_report(results)
    for text in (
        "Frames: 8 of 8 with a pose, 2 flagged (some for several reasons: 1 no data, 1 data poor, 1 ambiguous depth).",
        "The animal moved 2.1 m, at 9.0 m/s (90 %: 8.1 to 9.9) on average and at most 9",
        *(one["text"] for one in report["findings"] if one["severity"] != "note"),
        *report["assumptions"]["sentences"],
        "few joints were detected reliably",
        "The grey line is the ground under the feet",
        "rings: detections within the expected error",
        "The instantaneous acceleration is not shown, because it is mostly smaller than its standard deviation.",
    ):
        assert text in page.text
    assert "frames 10 to 17, 0.333 to 0.567 s at 30 frames per second" in page.text
    assert "left and right" not in page.text  # no frame has that flag
    assert list(flagged_frames(results)) == [(3, "13", "no data"), (5, "15", "data poor, ambiguous depth")]
    headings = re.findall(r"<h2>(.*?)</h2>", page.html)
    assert headings[:6] == [
        "From the side, from above and from ahead",
        "Speed",
        "Footfalls",
        "Angles over time",
        "Flagged frames",
        "Keypoints",
    ]
    # a picture comes before the text
    assert page.html.index("<img") < page.html.index("Frames: 8 of 8")
    assert len(page.attributes("img", "src")) == 8
    assert set(page.attributes("img", "alt")) == {f"frame {frame}, with the fitted pose" for frame in range(10, 18)}
    assert page.html.count("<svg") == 3
    figures = re.findall(r'<div class="figure \w+" role="img" aria-label="([^"]+)"', page.html)
    assert figures == headings[:3]  # a reader of the screen hears what each figure shows
    assert set(page.attributes("a", "href")) == set(read_manifest(folder).files)


@pytest.mark.usefixtures("undrawn")
@pytest.mark.parametrize("level", ["use", *(pytest.param(x, marks=pytest.mark.slow) for x in ("check", "do not use"))])
def test_a_page_begins_with_the_verdict_the_error_and_what_to_do(whole_results, level):
    motion = Motion.load(whole_results)
    assert motion.verdict is not None
    motion = replace(motion, verdict=replace(motion.verdict, level=level))
    assert motion.verdict is not None
    html = clip_page(motion, [("still.jpg", "frame 0")], None, [])
    told = [
        motion.verdict.reason,
        "Expected: pose error",
        *([TO_DO[level]] if level in TO_DO else []),
        # Speeds that are not to be used do not come first.
        *(["still.jpg", "The animal moved"] if level == "do not use" else ["The animal moved", "still.jpg"]),
        "Frames: 60 of 60",
        "<th>fast</th><td>false</td>",
    ]
    assert sorted(told, key=html.index) == told
    assert html.count(motion.verdict.reason) == 1
    assert "<th>keypoint</th>" in html
    assert "swapped</th>" not in html  # no keypoint was, and a column of zeros tells nothing


def test_a_page_has_the_video_behind_its_pictures(folder, tmp_path, monkeypatch):
    video = tmp_path / "run & away.avi"
    with video_writer(video, (1920, 1080), 30.0) as write:
        for number in range(18):
            write(np.full((1080, 1920, 3), 10 * number, np.uint8))
    shown, strips = {}, {}

    def clip_page(results, stills, behind, files, number, pictures, batch) -> str:
        shown[behind] = [source for source, _ in stills]
        strips[behind] = pictures
        return GENERATED

    monkeypatch.setattr("recon.cli.look.clip_page", clip_page)
    copy = tmp_path / "copy"
    shutil.copytree(folder, copy)
    report(PageSettings(folder=copy))
    report(PageSettings(folder=copy, video=video))
    assert [*shown] == [None, "run & away.avi"]
    assert len(shown[None]) == len(shown["run & away.avi"]) == 8
    assert not {*shown[None]} & {*shown["run & away.avi"]}
    strip = strips["run & away.avi"]
    assert strips[None] is None
    assert (strip.rows, strip.every, strip.video, strip.first_frame) == ([*range(8)], 1, "run & away.avi", 0)
    levels = [cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR).mean() for picture in strip.encoded]
    np.testing.assert_allclose(levels, [10 * frame for frame in range(10, 18)], atol=8)
    with refusal(("--first-frame", "number", 11, "10 or less")):
        report(PageSettings(folder=folder, video=video, first_frame=11))


@pytest.mark.usefixtures("undrawn")
def test_a_page_names_the_camera_of_its_pictures(two_cameras, tmp_path):
    files = (Path("run_cam1.csv"), Path("run_cam2.csv"))
    write_clip(two_cameras, FitSettings(keypoints=files, camera=Path("scene.json"), fps=30), tmp_path)
    for camera, name in ((None, "cam1"), ("cam2", "cam2")):
        page = report(PageSettings(folder=tmp_path, camera_name=camera)).data["page"]
        assert f"The fitted pose seen from {name}" in page.read_text(encoding="utf-8")


@pytest.mark.usefixtures("undrawn")
def test_a_page_does_not_replace_other_files(small_trajectory, tmp_path):
    settings = FitSettings(keypoints=Path("run.csv"), camera=Path("camera.toml"), fps=30)
    write_clip(small_trajectory, settings, tmp_path)
    (tmp_path / "report.html").write_text("my own")
    with refusal((tmp_path / "report.html", "file", "`recon report` did not write", "the file moved away")):
        report(PageSettings(folder=tmp_path))
    assert (tmp_path / "report.html").read_text() == "my own"
    (tmp_path / "report.html").unlink()
    (tmp_path / "quality.csv").unlink()  # the page does not need this file
    assert 'href="angles.csv"' in (
        page := report(PageSettings(folder=tmp_path)).data["page"].read_text(encoding="utf-8")
    )
    assert "quality.csv" not in page
    write_clip(small_trajectory, settings, tmp_path)
    assert not (tmp_path / "report.html").exists()
    (tmp_path / "report.html").write_text(GENERATED)
    write_clip(small_trajectory, settings, tmp_path)
    assert (tmp_path / "report.html").read_text() == GENERATED


@pytest.mark.usefixtures("undrawn")
def test_a_page_of_too_few_frames_for_a_speed(small_motion, tmp_path):
    joints_m = small_motion.solution.joints_m.copy()
    joints_m[0] = np.nan
    motion = replace(small_motion, solution=replace(small_motion.solution, joints_m=joints_m))
    given = {"camera": Path("camera.toml"), "fps": 30, "method": "frame"}
    write_clip(motion, FitSettings(keypoints=Path("run.csv"), **given), tmp_path)
    html = report(PageSettings(folder=tmp_path)).data["page"].read_text(encoding="utf-8")
    assert "The instantaneous acceleration is not shown" in html


def test_a_page_without_any_pose(small_trajectory, tmp_path):
    names = ("states", "joints_m", "covariance_m2", "relative_covariance_m2", "alternative_m", "contact", "noise_px")
    nothing = {name: np.full_like(getattr(small_trajectory.solution, name), np.nan) for name in names}
    solution = replace(small_trajectory.solution, **nothing, segments=(), flags=(("no data",),) * 8)
    motion = replace(small_trajectory, solution=solution)
    write_clip(
        replace(motion, findings=findings_of(motion)),
        FitSettings(keypoints=Path("run.csv"), camera=Path("camera.toml"), fps=30),
        tmp_path,
    )
    ended = run("report", tmp_path)
    assert (ended.code, ended.err) == (0, "")
    assert ended.out.split() == f"Open {tmp_path / 'report.html'} in a browser.".split()
    page = Page(tmp_path / "report.html")
    assert says(page.text, sentence(finding("no_pose")), "Too few frames")
    assert "10 to 17" in page.text
    assert not page.attributes("img", "src")


def test_figures_are_embedded_as_vectors_unless_these_are_large():
    with drawing(30, 60) as figure:
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1])
        axes.set_title("<script>alert(1)</script>")
    svg = inline(figure, 100_000)
    assert svg.startswith("<svg ")
    assert "&lt;script&gt;" in svg
    assert "<script" not in svg
    assert "<style" not in svg  # a style in the picture would apply to the whole page
    assert inline(figure, len(svg)) == svg
    for largest in (len(svg) - 1, 1000):
        assert inline(figure, largest).startswith('<img alt="" src="data:image/png;base64,')


@pytest.fixture(scope="module")
def batch(folder, tmp_path_factory) -> Path:
    """Return the folder of a batch of five clips, of which three have verdicts, one failed, and one is unsolved."""
    out = tmp_path_factory.mktemp("batch")
    names = {"good": "done", EVIL: "done", "gone": "done earlier", "bad": "failed", "dark": "unsolved"}
    verdicts = {"good": "use", EVIL: "check", "gone": "do not use"}
    with (out / "summary.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="")
        writer.writeheader()
        for name, status in names.items():
            row = {"clip": name, "status": status, "frames": 8, "mean_reprojection_px": 7.77, "size": 1}
            row |= {"verdict": verdicts.get(name, ""), "reason": "why not"}
            if name == "good":
                row |= {"reason": "Good except for this", "pose_mm": 51.2, "pose_mm_low": 33.6, "pose_mm_high": 77}
                row |= {"position_m": 0.59, "position_m_low": 0.04, "position_m_high": 3.98, "corrected": 23}
            writer.writerow(
                row
                if status != "failed"
                else row | {"frames": "", "size": "", "error": "/home/me/my clips/a.csv: <b>no</b>"}
            )
    for name in ("good", EVIL):
        shutil.copytree(folder, out / name, ignore=shutil.ignore_patterns("motion.rrd", "report.html"))
    motion = Motion.load(folder)
    no_flags = tuple(() for _ in motion.flags)
    replace(motion, solution=replace(motion.solution, flags=no_flags)).save(out / "good")
    write_manifest(out / "good")
    (out / EVIL / "report.html").write_text("a page")
    return out


def test_the_table_of_a_batch_begins_with_clips_to_check(batch):
    page = Page(write_summary_page(batch))
    require_self_contained(page, batch, scripts=1)
    rows = [
        re.sub(r"\s+", " ", row)
        for row in re.findall(r'<tr data-state="[\w ]+" data-clip="[^"]*">(<td>.*?)</tr>', page.html, re.DOTALL)
    ]
    shown = [[html.unescape(v) for v in re.findall(r'data-v="([^"]*)"', row)][:2] for row in rows]
    assert shown == [["bad", "0"], ["dark", "1"], ["gone", "3"], [EVIL, "4"], ["good", "5"]]
    states = [re.search(r'<td data-v="\d" class="([\w-]+)">\s*([\w ]+)', row).groups() for row in rows]
    assert states == [(s.replace(" ", "-"), s) for s in ("failed", "unsolved", "do not use", "check", "use")]
    assert {*page.attributes("a", "href")} == {f"{quote(EVIL)}/report.html"}
    assert "4 of 5 clips need a look." in page.text
    assert "5 clips: 1 failed, 1 unsolved, 1 do not use, 1 check, 1 use" in page.text
    assert page.text.count("why not") == 2
    assert "useGood except for this" in page.text
    assert "51(34 to 77)" in page.text
    assert "0.6(at most 4.0)" in page.text
    assert "corrected by hand" in page.text
    assert rows[-1].count("<div>23</div>") == 1
    assert "a.csv: <b>no</b>" in page.text
    assert "/home" not in page.html
    assert "7.8" not in page.text  # 7.8 is the mean, which one distant keypoint makes large
    assert [row.count("<div>0.0</div>") for row in rows] == [0, 0, 0, 1, 1]
    assert [row.count("<polyline") for row in rows] == [0, 0, 0, 8, 8]


def test_a_thumbnail_shows_the_middle_pose_from_the_camera(batch, folder):
    (row,) = (row for row in Page(write_summary_page(batch)).html.split("<tr data-") if ">good<" in row)
    positions = [float(v) for points in re.findall(r'points="(.*?)"', row) for v in re.split("[ ,]", points)]
    x, y = np.array(positions[::2]), np.array(positions[1::2])
    with (folder / "reprojection.csv").open() as file:
        middle = np.array(list(csv.reader(file))[3 + 4][1:], dtype=float).reshape(-1, 3)
    width, height = np.ptp(middle[:, 0]), np.ptp(middle[:, 1])
    np.testing.assert_allclose(np.ptp(y) / np.ptp(x), height / width, atol=0.02)
    assert 0 <= x.min() < x.max() <= 96
    assert 0 <= y.min() < y.max() <= 60
    assert np.ptp(x) == pytest.approx(0.9 * 96, abs=1)


def test_pages_of_a_batch_are_made_independently(batch, monkeypatch, in_process):
    """A result that is damaged is reported, and the pages of all others are made."""
    pages = []

    monkeypatch.setattr("recon.cli.look.clip_page", lambda motion, *_: pages.append(motion) or GENERATED)
    with (batch / "good" / "motion.npz").open("ab") as file:
        file.write(b"more")
    ended = run("report", batch)
    assert ended.code == 1
    assert pages == []
    assert "good: " in ended.err
    assert "motion.npz" in ended.err  # the file differs from the manifest
    assert says(ended.err, "report.html: file", "did not write")
    assert "summary.html in a browser" in ended.out
    (batch / EVIL / "report.html").unlink()
    run("report", batch)
    assert len(pages) == 1
    refused(["report", batch / "summary.csv"], (batch / "summary.csv", "folder", "a file", "recon fit"))
    refused(["report", batch, "--video", "clip.mp4"], ("--video", "file", "clip.mp4", "one clip"))


@pytest.mark.usefixtures("undrawn")
def test_a_page_leads_to_the_pages_before_and_after_it_and_back(batch, folder):
    for name in ("good", EVIL):
        (batch / name / "report.html").write_text("a page")
    write_summary_page(batch)
    first, second = sorted((EVIL, "good"))
    assert neighbours(folder) is None
    assert neighbours(batch / first) == Neighbours(first, "../summary.html", None, f"../{second}/report.html")
    assert neighbours(batch / second) == Neighbours(second, "../summary.html", f"../{first}/report.html", None)
    (batch / first / "report.html").unlink()
    assert neighbours(batch / second) == Neighbours(second, "../summary.html", None, None)
    assert neighbours(batch / second, whole_batch=True).previous == f"../{first}/report.html"


@pytest.mark.usefixtures("undrawn")
def test_a_clip_with_strides_has_its_joint_angles_over_the_stride(whole_analysis):
    headings = [section["heading"] for section in _sections(whole_analysis)]
    assert headings[headings.index("Footfalls") + 1] == "Joint angles over the stride"
