"""Test in a browser that pages are not cut, that controls work, and that all views show the same frame.

The tests need Chromium and the package playwright (`apt-get install chromium`), and skip without them.
"""

from __future__ import annotations

import csv
import shutil
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from motions import with_first

from recon import FitSettings, write_clip
from recon.api.batch import COLUMNS, write_summary_page
from recon.api.corrections import CorrectionSession
from recon.api.label_frames import LabelSession
from recon.base.files import relative_path
from recon.base.progress import silent
from recon.check.codes import finding
from recon.cli.fix import _server as editor_server
from recon.cli.label import label_server
from recon.cli.look import _page_of_clip
from recon.cli.look_options import PageSettings
from recon.fit.motion import Motion
from recon.fit.result import Verdict
from recon.io.corrections import read_corrections
from recon.io.video import video_writer
from recon.show.page.compare_page import compare_page

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), "")
EVIL = '<img src=x onerror="alert(1)">&\'.csv'
PATIENCE_MS = 180_000.0
"""Longest time in milliseconds that a page may take on a busy machine."""
VIEWS = {"desk": (1280, "light"), "phone": (390, "light"), "night": (1280, "dark")}
PLAYER = "document.querySelector('.player').reconPlayer"
CUT = """() => {
  const texts = "h1, h2, p, li, td, th, button, label, select, figcaption, output, canvas, img";
  const out = ({ left, right }) => right > document.documentElement.clientWidth + 1 || left < -1;
  return [...document.querySelectorAll(texts)]
    .filter((e) => e.getClientRects().length && !e.closest(".scroll, .wide, .stills") && out(e.getBoundingClientRect()))
    .map((e) => `${e.tagName} ${e.textContent.slice(0, 40)}`);
}"""
"""Script that returns elements that reach beyond the page, except in boxes that scroll."""
UNNAMED = """() => [...document.querySelectorAll("button, input, select, canvas, img, [role=img]")]
  .filter((e) => !(e.getAttribute("aria-label") || e.alt || e.textContent.trim() || (e.labels && e.labels.length)))
  .map((e) => e.outerHTML.slice(0, 80))"""
"""Script that returns controls and pictures without a name for screen readers."""
CONTRAST = """() => {
  const style = getComputedStyle(document.body);
  const linear = (x) => (x <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4);
  const light = (name) => {
    const whole = style.getPropertyValue(`--${name}`).trim().replace(/^#(.)(.)(.)$/, "#$1$1$2$2$3$3").slice(1);
    const [r, g, b] = whole.match(/../g).map((x) => linear(parseInt(x, 16) / 255));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const paper = light("paper"), names = "left right middle grid strong ink soft link warn bad good".split(" ");
  const ratio = (at) => (Math.max(at, paper) + 0.05) / (Math.min(at, paper) + 0.05);
  return Object.fromEntries(names.map((name) => [name, ratio(light(name))]));
}"""
"""Script that returns the contrast of each colour of lines and texts with the background."""
DRAWN = """() => [...document.querySelectorAll(".player .views canvas")].map((canvas) =>
  new Set(canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data).size)"""
"""Script that returns the number of shades in the picture and in the scene."""
DRAWN_AGAIN = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))"
"""Script that returns after a frame of the browser, in which the page draws changes."""
SHOWN = """(row) => {
  const { picture, draw } = PLAYER, image = picture.image(picture.pictureOf(row));
  if (!image.complete || !image.naturalWidth) return false;
  draw();
  return true;
}"""
"""Script that returns whether the picture of a row is on the canvas."""
LEVEL = """() => {
  const { picture } = PLAYER, [x, y] = picture.clip.pictures.corners_px[0];
  return picture.canvas.getContext("2d").getImageData(...picture.place([x + 8, y + 8]), 1, 1).data[0];
}"""
"""Script that returns the brightness of the picture near its corner."""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api", reason="pages in a browser: without the package playwright")
    if not CHROMIUM:
        pytest.skip("pages in a browser: without Chromium (apt-get install chromium)")
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"], timeout=PATIENCE_MS
        )
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def tab(chromium) -> Any:
    """Return one browser page for all tests, because a browser process for each would take a second."""
    page = chromium.new_context().new_page()
    page.set_default_timeout(PATIENCE_MS)
    return page


@pytest.fixture
def messages(tab) -> Iterator[list[str]]:
    """Yield a list of the errors and warnings that the browser reports during a test."""
    texts: list[str] = []

    def hear(message: Any) -> None:
        texts.append(message.text)

    def hear_error(error: Exception) -> None:
        texts.append(str(error))

    tab.on("console", hear)
    tab.on("pageerror", hear_error)
    yield texts
    tab.goto("about:blank")
    tab.remove_listener("console", hear)
    tab.remove_listener("pageerror", hear_error)


def show_as(page: Any, view: str) -> None:
    width, scheme = VIEWS[view]
    page.set_viewport_size({"width": width, "height": 900})
    page.emulate_media(media="screen", color_scheme=scheme, reduced_motion="reduce")


@pytest.fixture
def opened(tab, messages) -> Iterator[Callable[..., Any]]:
    """Yield a function that opens a page; the browser must report nothing, and fetch only the page."""
    fetched: list[str] = []

    def hear(request: Any) -> None:
        fetched.append(request.url)

    def open_page(path: Path, view: str = "desk", address: str = "") -> Any:
        show_as(tab, view)
        tab.goto(path.as_uri() + address)
        tab.wait_for_function("!document.querySelector('.player') || document.querySelector('.player').reconPlayer")
        return tab

    tab.on("request", hear)
    yield open_page
    tab.remove_listener("request", hear)
    # Chromium warns that pixels are read from a canvas, which only the tests do.
    assert [text for text in messages if not text.startswith("Canvas2D: Multiple readback")] == []
    assert [url for url in fetched if not url.startswith(("file:", "data:", "blob:"))] == []


def level_at(page: Any, row: int) -> float:
    """Show a row of the motion, wait for its picture, and return the picture's brightness."""
    page.evaluate(f"{PLAYER}.cursor.go({row})")
    page.wait_for_function(SHOWN.replace("PLAYER", PLAYER), arg=row)
    return page.evaluate(LEVEL.replace("PLAYER", PLAYER))


@pytest.fixture(scope="module")
def pages(small_trajectory, two_cameras, whole_results, tmp_path_factory) -> dict[str, Path]:
    """Return pages of a clip with names that are HTML, of two cameras, of a whole run, and of a rejected result."""
    folder = tmp_path_factory.mktemp("browser")
    settings = {"camera": Path("camera.toml"), "fps": 30}
    source = small_trajectory.sources[0]
    evil = with_first(small_trajectory, keypoints=replace(source.keypoints, source=f"/tmp/{EVIL}"))
    findings = (
        finding("keypoints_do_not_fit", keypoints=("nose",), share=0.5, used=7),
        finding("left_right_swap", (12, 15), source.camera.name, part="the fore legs", keypoints=("l_front_paw",)),
    )
    write_clip(replace(evil, findings=findings), FitSettings(keypoints=Path(EVIL), **settings), folder / "film")
    video = folder / "run.avi"
    with video_writer(video, (1920, 1080), 30.0) as write:
        for number in range(18):
            write(np.full((1080, 1920, 3), 10 * number, np.uint8))
    files = (Path("run_cam1.csv"), Path("run_cam2.csv"))
    write_clip(two_cameras, FitSettings(keypoints=files, **settings), folder / "several")
    verdict = Verdict("do not use", "The animal runs upside down.")
    refused = replace(small_trajectory, verdict=verdict)
    write_clip(refused, FitSettings(keypoints=Path("run.csv"), **settings), folder / "refused")
    shutil.copytree(whole_results, folder / "whole", ignore=shutil.ignore_patterns("motion.rrd"))
    verdicts = {"film": "check", "several": "use", "refused": "do not use", "whole": "use"}
    with (folder / "summary.csv").open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS, restval="")
        writer.writeheader()
        for number, (name, level) in enumerate(verdicts.items()):
            row = {"clip": name, "status": "done", "verdict": level, "pose_mm": 40 + 10 * number, "mean_speed_m_s": 9.0}
            writer.writerow(row | {"frames": 8, "reason": "why not"})
    return Pages(folder, [*verdicts], video)


class Pages(dict[str, Path]):
    """Dictionary of pages by name, which writes a page when a test needs it."""

    def __init__(self, folder: Path, clips: Sequence[str], video: Path) -> None:
        super().__init__()
        self.folder, self.clips, self.video = folder, clips, video

    def __missing__(self, name: str) -> Path:
        if name == "batch":
            for clip in self.clips:
                assert self[clip].is_file()
            self[name] = write_summary_page(self.folder)
        elif name == "compare":
            assert self["film"].is_file()
            self[name] = comparison(self.folder, {clip: self.folder / clip / "report.html" for clip in self.clips})
        else:
            with pytest.MonkeyPatch.context() as patch:
                if name != "whole":  # only this page's figures are tested
                    patch.setattr("recon.show.plots.style.svg_of", lambda figure, largest: "<svg></svg>")
                chosen = PageSettings(folder=self.folder / name, video=self.video if name == "film" else None)
                _page_of_clip(chosen, silent, whole_batch=True)
            self[name] = self.folder / name / "report.html"
        return self[name]


def comparison(folder: Path, pages: dict[str, Path]) -> Path:
    """Write the page of a comparison of two groups, and return its path."""
    clips = pd.DataFrame(
        {
            "group": ["walk", "walk", "a gallop with a long name"],
            "clip": ["film", "none", "whole"],
            "animal": ["Ada", "Bo", "Ada"],
            "verdict": ["check", "use", "use"],
            "strides": [1, 2, 3],
            "speed_m_s": [1.0, 2.0, 9.0],
            "speed_m_s_sigma": [0.5, 0.1, 0.3],
        }
    )
    means = {"group": [*clips["group"].unique()], "clips": [2, 1], "strides": [3, 3], "speed_m_s": [1.5, 9.0]}
    groups = pd.DataFrame(means | {"speed_m_s_sigma": [0.4, 0.3]})
    links = {name: relative_path(folder, pages[name]) for name in ("film", "whole")}
    path = folder / "compare.html"
    content = compare_page("gaits", clips, groups, {"speed_m_s": "speed (m/s)"}, links, {"film": 7.0}, ["No."], "gait")
    path.write_text(content, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "name",
    [
        "film",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("several", "refused", "whole", "batch", "compare")),
    ],
)
def test_nothing_is_off_the_screen_or_too_pale_or_without_a_name(pages, opened, name):
    page = opened(pages[name])
    assert page.evaluate(UNNAMED) == []
    for view, (width, scheme) in VIEWS.items():
        page.set_viewport_size({"width": width, "height": 900})
        page.emulate_media(color_scheme=scheme)
        page.evaluate("() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))")
        assert page.evaluate("document.documentElement.scrollWidth") <= width, view
        assert page.evaluate(CUT) == [], view
        assert {colour: ratio for colour, ratio in page.evaluate(CONTRAST).items() if ratio < 3} == {}, view
        assert name in ("batch", "compare") or min(page.evaluate(DRAWN)) > 20, view
    page.emulate_media(media="print", color_scheme="dark")
    # A4 within its margins; the table of a batch is printed across it.
    page.set_viewport_size({"width": 1015, "height": 690} if name == "batch" else {"width": 690, "height": 1000})
    page.evaluate(DRAWN_AGAIN)
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert page.evaluate(CUT.replace(".scroll, .wide, ", "")) == []  # nothing scrolls on paper


def test_every_view_shows_the_frame_of_the_cursor(pages, opened):
    page = opened(pages["film"])
    levels = [level_at(page, row) for row in (0, 4, 7)]
    np.testing.assert_allclose(levels, [100, 140, 170], atol=8)  # frames 10, 14 and 17: each within half a frame
    assert page.locator(".status").text_content() == "frame 17, 0.567 s"
    x = page.evaluate(f"{PLAYER}.strips.map((strip) => Math.abs(strip.x(7) - (strip.canvas.clientWidth - 10)))")
    assert max(x) < 1.5
    assert page.evaluate(f"{PLAYER}.picture.shownRow") == 7
    assert page.locator("header p").text_content().startswith(f"{EVIL} · frames 10 to 17")


def test_cursors_stay_on_their_curves_and_words_stay_whole_on_a_phone(pages, opened):
    page = opened(pages["film"], "phone")
    page.evaluate(f"{PLAYER}.strips.forEach((strip) => strip.draw(true))")
    # A longer value wraps to a second line and moves the curve below it.
    off_px = page.evaluate("""() => [...document.querySelectorAll(".strip")].map((strip) => {
      strip.querySelector("output").textContent = "left \u221225 \u00b1 23\u00b0, right ".repeat(4);
      const [canvas, line] = [strip.querySelector("canvas"), strip.querySelector(".cursor-line")];
      return canvas.clientWidth ? Math.abs(canvas.getBoundingClientRect().top - line.getBoundingClientRect().top) : 0;
    })""")
    assert len(off_px) > 3
    assert max(off_px) < 1
    heights_px = page.evaluate("""() => [...document.querySelectorAll(".quality tbody td:first-child")]
      .map((cell) => cell.getBoundingClientRect().height)""")
    assert len(heights_px) == 24
    assert max(heights_px) < 50


@pytest.mark.parametrize("view", ["desk", "phone"])
def test_panels_contain_their_bands_and_two_ticks_or_more(pages, opened, view):
    page = opened(pages["whole"], view)
    page.evaluate(f"{PLAYER}.strips.forEach((strip) => strip.draw(true))")
    panels = page.evaluate(f"""{PLAYER}.strips.filter((strip) => strip.panel).map((strip) => {{
      const ends = strip.panel.curves.flatMap(({{ values, band }}) => band && !strip.filled
        ? [...values].flatMap((value, row) => [value - band[row], value + band[row]]) : [...values]);
      const known = ends.filter((end) => !Number.isNaN(end));
      return [strip.panel.title, strip.panel.least === 0, strip.filled, strip.range, strip.ticks,
        [Math.min(...known), Math.max(...known)]];
    }})""")
    assert sum(title.startswith("speed") for title, *_ in panels) == 1
    assert len(panels) > 10
    for title, begins_at_0, filled, (low, top), ticks, (least, most) in panels:
        assert 2 <= len(ticks) <= 5, title
        assert low <= min(ticks) < max(ticks) <= top, title
        if not filled and most - least < top - low + 1e-9:  # bands of single frames may be far wider than the curve
            assert most <= top + 1e-9, title
            assert begins_at_0 or least >= low - 1e-9, title
    speed = next(panel for panel in panels if panel[0].startswith("speed"))
    assert speed[3][1] >= speed[5][1] - 1e-6


def test_keys_and_buttons_move_the_cursor(pages, opened):
    page = opened(pages["film"])
    row = lambda: page.evaluate(f"{PLAYER}.cursor.row")  # noqa: E731
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowLeft")
    assert row() == 1
    page.click("[data-do=next]")
    assert row() == 2
    page.keyboard.press("d")
    assert (row(), page.locator(".status").text_content()) == (3, "frame 13, 0.433 s, no data")
    page.click("[data-do=flagged]")
    assert row() == 5
    page.locator(".player input[type=range]").focus()
    page.keyboard.press("ArrowLeft")
    assert row() == 4
    assert page.get_attribute(".player input[type=range]", "aria-valuetext") == "frame 14, 0.467 s"
    page.locator("h1").click()
    page.keyboard.press("<")
    page.keyboard.press("<")
    assert page.input_value("[data-choose=speed]") == "0.125"
    page.select_option("[data-choose=speed]", "1")
    page.locator("h1").click()
    page.evaluate(f"{PLAYER}.cursor.go(0)")
    page.keyboard.press(" ")
    assert page.locator("[data-do=play]").text_content() == "Pause"
    page.wait_for_function(f"{PLAYER}.cursor.row >= 2")
    page.keyboard.press(" ")
    assert page.locator("[data-do=play]").text_content() == "Play"


def test_the_scene_is_turned_zoomed_and_seen_from_all_sides(pages, opened):
    page = opened(pages["film"])
    looks = set()
    state = f"(({{angle, tilt, zoomed, panned}}) => JSON.stringify([angle, tilt, zoomed, panned]))({PLAYER}.scene)"
    for do in ("side", "front", "top", "camera", "closer"):
        page.click(f"[data-do={do}]")
        looks.add(page.evaluate(state))
    page.locator("canvas.scene").focus()
    page.keyboard.press("ArrowLeft")
    looks.add(page.evaluate(state))
    page.locator("canvas.scene").scroll_into_view_if_needed()
    box = page.locator("canvas.scene").bounding_box()
    page.mouse.move(box["x"] + 100, box["y"] + 100)
    page.mouse.down()
    page.mouse.move(box["x"] + 160, box["y"] + 120, steps=3)
    page.mouse.up()
    looks.add(page.evaluate(state))
    assert len(looks) == 7
    assert page.evaluate(f"{PLAYER}.cursor.row") == 0  # arrows in the scene turn it
    before = page.locator("canvas.scene").screenshot()
    for name in ("trail", "uncertainty", "ground", "cameras"):
        page.click(f"[data-show={name}]")
        page.evaluate(DRAWN_AGAIN)
        after = page.locator("canvas.scene").screenshot()
        assert after != before or name == "cameras"  # the camera may be behind the reader
        before = after


def test_text_curves_and_the_address_lead_to_their_frames(pages, opened):
    page = opened(pages["film"], address="#t=0.4667")
    state = lambda: page.evaluate(f"[{PLAYER}.cursor.row, {PLAYER}.cursor.named]")  # noqa: E731
    nose, paw = (page.evaluate(f"{PLAYER}.clip.keypoints.indexOf({name!r})") for name in ("nose", "l_front_paw"))
    assert state()[0] == 4
    page.click("[data-finding='0'] button")
    assert state() == [4, [nose]]  # the frame and keypoint with the largest error
    page.click("[data-finding='1'] button")
    assert page.locator("[data-finding='1'] button").text_content() == "Show frame 12, l_front_paw"
    assert state() == [2, [paw]]
    page.click("[data-row='5'] button")
    assert state()[0] == 5
    page.click(f"[data-keypoint='{nose}'] button")
    assert state() == [4, [nose]]
    page.evaluate(f"{PLAYER}.cursor.go(0)")
    strip = page.locator(".strips canvas").first
    strip.click(position={"x": strip.bounding_box()["width"] - 12, "y": 20})
    assert state()[0] == 7
    page.click("[data-do=link]")
    assert page.url.endswith("#t=0.5667")
    page.click("input[value=likelihood]")
    page.wait_for_function("document.querySelector('.scale').textContent.startsWith('likelihood 1')")


def test_each_camera_has_its_detections_and_table(pages, opened):
    page = opened(pages["several"])
    tables = "[...document.querySelectorAll('tbody[data-camera]')].map((body) => body.hidden)"
    assert page.evaluate(tables) == [False, True]
    page.select_option("[data-choose=camera]", "1")
    assert page.evaluate(tables) == [True, False]
    camera, joint = f"{PLAYER}.clip.cameras[1]", page.evaluate(f"{PLAYER}.clip.keypoints.indexOf('tail_base')")
    assert page.evaluate(f"{camera}.error(5, {joint})") == pytest.approx(200, abs=1)
    assert page.evaluate(f"[5, 0].map((row) => {camera}.stateOf(row, {joint}))") == [2, 0]  # an outlier, and missing


@pytest.mark.slow
def test_a_batch_is_sorted_and_filtered_and_leads_to_its_clips_and_back(pages, opened):
    page = opened(pages["batch"])
    clips = (
        "[...document.querySelectorAll('tbody tr')].filter((row) => !row.hidden).map((row) => row.cells[1].dataset.v)"
    )
    # Clips are sorted by verdict, the worst first.
    assert page.evaluate(clips) == ["refused", "film", "whole", "several"]
    page.click("th:nth-child(2) button")
    assert page.evaluate(clips) == ["film", "refused", "several", "whole"]
    page.select_option(".filter select", "use")
    assert page.evaluate(clips) == ["several", "whole"]
    page.fill(".filter input", "WHO")
    assert page.evaluate(clips) == ["whole"]
    assert page.locator(".filter output").text_content() == "1 of 4 clips"
    assert page.locator(".dots circle:not(.faint)").count() == 3  # one in each distribution
    page.click("tr:not([hidden]) td a")
    assert page.title().startswith("whole")
    page.click("a[rel=prev]")
    assert page.title().startswith("several")
    page.click("nav a >> nth=0")
    assert page.locator("h1").text_content() == pages["batch"].parent.name


def test_a_comparison_marks_a_clip_everywhere_and_leads_to_its_page(pages, opened):
    path = pages["compare"]
    page = opened(path, "phone")
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert page.evaluate(CUT) == []
    assert page.locator(".pair").count() == 1  # the clips of Ada in both gaits
    heights = page.evaluate("[...document.querySelectorAll('.dot circle')].map((dot) => +dot.getAttribute('cy'))")
    assert heights[0] > heights[1] > heights[2]  # heights of film, none and whole
    page.hover("tr[data-clip=film] td")
    assert page.locator(".near").count() == 2  # the clip's dot and row
    page.select_option(".filter select", "walk")
    assert page.locator(".filter output").text_content() == "2 of 3 clips"
    assert page.locator(".dot.faint").count() == 1
    page.click("svg a[aria-label^='film: 1.0 (0.2 to 1.8)'] circle")
    assert page.title().startswith("film")


def test_a_page_prints_with_pictures_and_without_buttons(pages, opened):
    page = opened(pages["film"], "night")
    page.emulate_media(media="print", color_scheme="dark")
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
    assert page.locator(".stills img").first.is_visible()
    assert not page.locator(".player .controls").is_visible()
    assert not page.locator("[data-finding] button").first.is_visible()
    worst, in_table = page.locator("[data-keypoint]").first, page.locator("td[data-keypoint]").first
    assert worst.inner_text() == in_table.inner_text() != ""  # the names are buttons on the screen
    page.set_viewport_size({"width": 690, "height": 1000})  # A4 within its margins
    assert page.evaluate(CUT) == []


@pytest.mark.slow
def test_a_page_without_scripts_has_its_pictures(pages, chromium):
    context = chromium.new_context(java_script_enabled=False)
    page = context.new_page()
    page.goto(pages["refused"].as_uri())
    assert page.locator(".stills img").first.is_visible()
    assert not page.locator(".player").is_visible()
    assert page.locator(".verdict").text_content().startswith("do not use")
    context.close()


@pytest.mark.slow
def test_numbers_of_the_page_equal_the_result(pages, opened):
    """The data of the player, unpacked in the browser, equal the numbers of the motion."""
    page = opened(pages["whole"])
    motion = Motion.load(pages["whole"].parent)
    got = page.evaluate(f"(({{clip}}) => [clip.joint(30, 5), clip.cameras[0].error(30, 5), clip.count])({PLAYER})")
    np.testing.assert_allclose(got[0], motion.upright.xyz_m[30, 5], atol=1e-3)
    assert got[1] == pytest.approx(motion.pictures[0].distance_px[30, 5], abs=0.3)
    assert got[2] == len(motion.frames)


EDITOR = "document.querySelector('main.fix').editor"
PLACED = """([position, x, y]) => {
  EDITOR.go(position);
  const { picture } = EDITOR, box = picture.canvas.getBoundingClientRect();
  picture.showAll();
  picture.zoom(8, ...picture.place([x, y]));
  const [left, top] = picture.place([x, y]);
  return [box.left + left, box.top + top];
}"""
"""Script that selects an entry, zooms in on a pixel of the picture, and returns its position on the screen."""


class EditorPage:
    """Page of `recon fix` in a browser, which saves the corrections after each action."""

    def __init__(self, page: Any, session: CorrectionSession) -> None:
        self.page, self.session = page, session

    def evaluate(self, script: str, argument: object = None) -> Any:
        return self.page.evaluate(script.replace("EDITOR", EDITOR), argument)

    def click(self, position: int, point_px: tuple[float, float]) -> None:
        """Choose an entry of the list, and click on a pixel of the picture."""
        x, y = self.evaluate(PLACED, [position, *point_px])
        self.page.keyboard.down("Shift")
        self.page.mouse.click(x, y)
        self.page.keyboard.up("Shift")

    def drag(self, position: int, from_px: tuple[float, float], to_px: tuple[float, float]) -> None:
        x, y = self.evaluate(PLACED, [position, *from_px])
        scale = self.evaluate("() => EDITOR.picture.scale")
        self.page.mouse.move(x, y)
        self.page.mouse.down()
        self.page.mouse.move(x + scale * (to_px[0] - from_px[0]), y + scale * (to_px[1] - from_px[1]), steps=3)
        self.page.mouse.up()

    def press(self, *keys: str) -> None:
        for key in keys:
            self.page.keyboard.press(key)

    def saved(self) -> dict[tuple[int, str], tuple[float, float] | None]:
        """Wait until everything is saved, and return the corrections in the file."""
        self.evaluate("() => EDITOR.saving")
        return {(row.frame, row.keypoint): row.now_px for row in read_corrections(self.session.out)}


@pytest.fixture
def editor(
    tab, messages: list[str], whole_results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[EditorPage]:
    """Yield an editor whose refits return the present motion; the browser must report nothing about its page."""
    monkeypatch.setattr("recon.api.corrections.refit_clip", lambda settings, motion: motion)
    monkeypatch.setattr("recon.api.corrections.IDLE_S", 3600.0)
    session = CorrectionSession.open(whole_results, tmp_path / "corrections.csv")
    server = editor_server(session, tmp_path, has_video=False)
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    show_as(tab, "desk")
    tab.goto(server.address)
    tab.wait_for_function(EDITOR)
    yield EditorPage(tab, session)
    tab.goto("about:blank")
    server.shutdown()
    server.server_close()
    assert messages == []


@pytest.mark.parametrize("count", [8, pytest.param(30, marks=pytest.mark.slow)])
def test_points_arrive_where_they_are_put(editor: EditorPage, count: int):
    """A click or a drag puts a point within half a pixel of its target."""
    targets = {}
    for position, item in enumerate(editor.session.state()["queue"][:count]):
        x, y = item["expected_px"]
        targets[item["frame"], item["keypoint"]] = (x + 3.0, y - 2.0)
        editor.click(position, (x + 3.0, y - 2.0))
    saved = editor.saved()
    assert len(targets) == count
    assert saved.keys() == targets.keys()
    assert max(np.hypot(*np.subtract(saved[key], targets[key])) for key in targets) < 0.5
    first = next(iter(targets))
    editor.drag(0, saved[first], (saved[first][0] + 20.0, saved[first][1] + 10.0))
    assert np.hypot(*np.subtract(editor.saved()[first], saved[first]) - [20.0, 10.0]) < 0.5


def test_keys_accept_hide_clear_swap_and_undo(editor: EditorPage):
    first, second = editor.session.state()["queue"][:2]
    keys = [(item["frame"], item["keypoint"]) for item in (first, second)]
    editor.press("a")
    assert editor.saved()[keys[0]] == pytest.approx(first["expected_px"], abs=0.02)
    editor.press("n", "h")
    assert editor.saved()[keys[1]] is None
    editor.press("u")
    assert [*editor.saved()] == [keys[0]]
    editor.press("p", "c")
    assert editor.saved() == {}
    motion = editor.session.motion
    left, right = motion.names.index("l_front_paw"), motion.names.index("r_front_paw")
    before = motion.keypoints.xy_px[5:8]
    editor.evaluate("() => EDITOR.cursor.go(5)")
    editor.press("b", "ArrowRight", "ArrowRight", "s")
    swapped = editor.saved()
    for row in range(3):
        for joint, name in ((right, "l_front_paw"), (left, "r_front_paw")):
            if np.isfinite(before[row, joint]).all():
                assert swapped[5 + row, name] == pytest.approx(before[row, joint].tolist(), abs=0.01)
    assert {frame for frame, _ in swapped} == {5, 6, 7}
    editor.press("u")
    assert editor.saved() == {}


def test_clicks_label_a_video_without_detections(tab, messages: list[str], tmp_path: Path):
    """Clicks label one keypoint after the other, and dragging, skipping, undo and the next frame work."""
    pytest.importorskip("tables")
    video = tmp_path / "run.avi"
    with video_writer(video, (320, 240), 25.0) as write:
        for number in range(3):
            write(np.full((240, 320, 3), 80 * number, np.uint8))
    session = LabelSession.open(video, tmp_path / "project", ("nose", EVIL, "tail"), "me", 3)
    server = label_server(session)
    threading.Thread(target=server.serve_forever, args=(0.01,), daemon=True).start()
    page = tab
    show_as(page, "desk")
    page.goto(server.address)
    page.wait_for_function(EDITOR)

    def at(point: tuple[float, float]) -> tuple[float, float]:
        script = "(point) => { const box = EDITOR.canvas.getBoundingClientRect(), [x, y] = EDITOR.place(point);"
        x, y = page.evaluate(f"{script} return [box.left + x, box.top + y]; }}".replace("EDITOR", EDITOR), point)
        return x, y

    def saved() -> dict[tuple[int, int], tuple[float, float]]:
        page.evaluate(f"() => {EDITOR}.saving")
        return session.points_px

    page.mouse.click(*at((100.0, 50.0)))  # nose
    page.keyboard.press("h")
    page.mouse.click(*at((200.0, 150.0)))  # tail
    labels = saved()
    assert {*labels} == {(0, 0), (0, 2)}
    assert np.hypot(*np.subtract([labels[0, 0], labels[0, 2]], [(100.0, 50.0), (200.0, 150.0)]).T).max() < 0.5
    page.mouse.move(*at((100.0, 50.0)))
    page.mouse.down()
    page.mouse.move(*at((120.0, 70.0)), steps=3)
    page.mouse.up()
    assert np.hypot(*np.subtract(saved()[0, 0], (120.0, 70.0))) < 1.0
    page.keyboard.press("u")
    assert np.hypot(*np.subtract(saved()[0, 0], (100.0, 50.0))) < 0.5
    page.keyboard.press("n")
    page.mouse.click(*at((10.0, 20.0)))
    assert {*saved()} == {(0, 0), (0, 2), (1, 0)}
    assert page.evaluate(CUT) == []
    page.goto("about:blank")
    server.shutdown()
    server.server_close()
    assert messages == []
