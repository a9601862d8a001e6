"""Test that every command and Python block in README.md and docs/ runs, and prints what the pages show.

Each page is run from top to bottom, in this process. Each command continues in a copy of the folder that the previous
command left. A file that a page names is made when it is first named (`docs_files`). `NOT_RUN` lists the commands that
cannot be run, with the reason.
"""

from __future__ import annotations

import html
import io
import json
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator
from contextlib import redirect_stdout
from functools import cache
from pathlib import Path
from typing import NamedTuple
from urllib.parse import unquote, urlsplit

import pytest
import typer
from command_line import copy_results, run, run_tasks_here
from docs_files import DOCS, FENCE, FILES, OF_PAGE, Block, blocks, commands
from made_up_herd import make_herd, use_made_up_numbers
from shortcuts import (
    draw_two_methods,
    fit_demo_from,
    leave_out_drawing,
    leave_out_playback,
    remember_analyses,
    shorten_cost_study,
)

from recon import find_clips
from recon.cli.app import app
from recon.cli.app import commands as commands_of_recon
from recon.thesis import figures

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]

NOT_RUN = {
    r"python docs/simulated_cat\.py ": "test_new_species.py runs it",
    r"make (demo|test)": "sets up an environment; .ci/run does it",
    r"(\.venv/bin/)?recon view ": "opens a window: needs a display",
    r"python3 -m venv |\. \.venv/bin/activate": "an environment of its own",
    r"pip install ": "needs the package index",
    r"dask (scheduler|worker) |recon batch manifest\.csv .*--scheduler": "needs a cluster, as in test_batch.py",
    r"recon batch PROJECT ": "needs a project of Anipose; test_batch_inputs.py",
    r"recon prior fit training_positions\.csv ": "needs recordings; test_prior.py runs it",
    r"recon (fit run\d_cam|subject fit results/run1|prior fit tom/|evaluate one/)": "test_new_species.py runs it",
    r"recon retarget .* --robot robot\.urdf ": "takes half a minute; test_robot_retarget.py",
    r"recon (train|predict|evaluate-2d) |recon fit run\.csv ": "trains for minutes; test_net_train.py",
    r"recon climb published-50 ": "takes two seconds; test_robot_climb.py runs one of its own",
    r"recon run ": "takes half a minute; test_run.py",
    r"recon report ": "test_page.py",
    r"recon (fit|calibrate extrinsics) run\d?_cam": "of several cameras; test_offsets.py, test_cameras.py",
    r"recon triangulate cam1\.csv ": "of three cameras; test_triangulate.py",
    r"recon camera-motion ": "needs a video of a camera that turns; test_camera_motion.py",
    r"recon overlay ": "test_overlay.py",
    r"recon label ": "serves a page until it is stopped; test_label_frames.py, test_browser.py",
    r"recon fix ": "serves a page until it is stopped; test_correction_session.py",
    r"recon doctor": "looks at this machine; test_doctor.py",
}
"""Reasons for not running a command, by a pattern of the command's beginning."""

SNIPPET = re.compile(r'--8<-- "(.*)"\n')
"""Pattern of a block that the site fills with a file of the repository, which has its own test."""
LANGUAGES = {"sh", "python", "r", "toml", "csv", "text"}


def name_of(page: Path) -> str:
    return str(page.relative_to(DOCS if DOCS in page.parents else ROOT))


def reason_not_to_run(command: str) -> str | None:
    text = shlex.join(shlex.split(command)) + " "
    return next((why for pattern, why in NOT_RUN.items() if re.match(pattern, text)), None)


ONCE = {
    "recon analyse results/clip",
    "recon ik results/clip --compare",
    "recon retarget results/clip --robot a1 --out results/a1",
}
"""Slow commands that several pages show, and that are run once for all pages."""
SLOW = {
    r"recon (fit|frame) ": "test_cli.py, test_naming.py, test_camera_track.py, test_subject.py, test_corrections.py",
    r"recon ik .*(--fitted|--cost )": "test_ik_clip.py",
    r"recon camera-advice ": "test_camera_advice.py",
    r"recon batch .* --out results/all$": "test_batch.py",
    r"recon robot dh arm\.toml ": "test_robot_command.py",
}
"""Tests that cover a step of many seconds, by a pattern of the step's beginning."""
LONG = {
    r"recon solver ": "test_solver_analysis.py",
    r"recon batch ": "test_batch.py",
    r"recon calibrate board": "test_calibrate.py",
    r"recon climb ": "test_robot_climb.py",
    r"recon (retarget|robot dh) ": "test_robot_retarget.py, test_robot_command.py, test_robot_trainers.py",
    r"recon ik ": "test_ik_clip.py",
    r"recon compare herd": "test_experiment.py",
}
"""Tests that cover a slow step after which all later steps of the page are slow, by a pattern of its beginning."""
FIT = "recon fit clip.csv --camera camera.toml --fps 60 --out results/clip"
"""Command with which pages begin; `whole_results` has its results, and `test_cli.py` tests the command."""


class Workshop:
    """Folder in which the files of `docs_files` are made when a page names them."""

    def __init__(self, folder: Path, page: str, results: Path, of_results: Callable[[str], tuple[str, Path]]) -> None:
        self.folder, self.results, self.of_results = folder, results, of_results
        self.files = FILES | OF_PAGE.get(page, {})

    def provide(self, text: str) -> None:
        """Make every file that a text names and that does not exist yet."""
        for name, make in self.files.items():
            path = self.folder / name
            if re.search(rf"(?<![\w./-])(?<!--out ){re.escape(name)}(?![\w-]|\.\w)", text) and not path.exists():
                path.parent.mkdir(parents=True, exist_ok=True)
                make(path)
        if re.search(r"(?<!--out )\bresults/clip\b", text) and not (self.folder / "results" / "clip").exists():
            copy_results(self.results, self.folder / "results" / "clip")
        if re.search(r"\bcompare herd\b", text) and not (self.folder / "herd").exists():
            make_herd(self.folder / "herd", self.results)

    def shell(self, command: str) -> str:
        """Run a shell command, and return what it prints."""
        words = shlex.split(command)
        if words[0] != "recon":
            pytest.fail(f"{command}: neither a command of recon nor named in NOT_RUN")
        self.provide(command)
        if command in ONCE and same_pose(self.folder / "results" / "clip", self.results):
            return self.of_results(command)[0]
        if command == FIT and self.files["clip.csv"] is FILES["clip.csv"]:
            copy_results(self.results, self.folder / "results" / "clip")
            return ""
        ended = run(*words[1:])
        assert ended.code == 0, f"{command}\n{ended.out}{ended.err}"
        return ended.out

    def python(self, text: str, names: dict) -> str:
        self.provide(text)
        out = io.StringIO()
        with redirect_stdout(out):
            exec(compile(text, "a block of the page", "exec"), names)
        return out.getvalue()


def same_pose(*results: Path) -> bool:
    return len({(folder / "pose3d.csv").read_bytes() for folder in results}) == 1


@pytest.mark.parametrize(
    "command",
    [
        pytest.param(command, marks=[pytest.mark.slow] * any(re.match(pattern, command) for pattern in LONG))
        for command in sorted(ONCE)
    ],
)
def test_command_of_several_pages(command, of_results):
    """Commands that several pages show are run separately, so that no page takes long."""
    printed, _ = of_results(command)
    assert printed


class Step(NamedTuple):
    """Step of a page: a command, or None, and the text up to the next command."""

    command: str | None
    blocks: list[Block]


@cache
def steps(page: Path) -> list[Step]:
    found = [Step(None, [])]
    for block in blocks(page):
        if block.language == "sh":
            found += [Step(command, []) for command in commands(block) if reason_not_to_run(command) is None]
        elif block.language != "toml" and not SNIPPET.fullmatch(block.text):
            found[-1].blocks.append(block)
    return [step for step in found if step != Step(None, [])]


def do(step: Step, workshop: Workshop) -> None:
    """Run a step in the workshop's folder, which is the current one."""
    printed, names = workshop.shell(step.command) if step.command is not None else "", {"__name__": "page"}
    for block in step.blocks:
        where = f"{block.page.name}, line {block.line}"
        if block.language == "python":
            printed = workshop.python(block.text, names)
            expected = re.findall(r"^print\(.*\)  # (.*)$", block.text, re.MULTILINE)
            assert not expected or alike(printed) == alike("\n".join(expected)), where
        elif block.language == "text":
            assert alike(printed) == alike(block.text), f"{where}:\n{printed}"
        elif block.language == "csv" and block.text.startswith("file,"):
            Path("names.csv").write_text(block.text, encoding="utf-8")
        elif block.language == "csv" and block.text.startswith("clip,"):
            Path("design.csv").write_text(block.text, encoding="utf-8")
        elif block.language == "csv" and block.text.startswith("frame,keypoint,was"):
            Path("corrections.csv").write_text(block.text, encoding="utf-8")
        elif block.language == "csv":
            workshop.provide(block.text)
            Path("manifest.csv").write_text(block.text, encoding="utf-8")
            assert find_clips(["manifest.csv"], {}, None)[0], where


@pytest.fixture(scope="session")
def folder_after(made_once, whole_results, of_results) -> Callable[[Path, int], Path]:
    """Return a function `folder_after(page, n)`, which returns the folder after the first n steps of a page."""

    def after(page: Path, count: int) -> Path:
        def make(folder: Path) -> None:
            if count > 1:
                shutil.copytree(after(page, count - 1), folder)
            else:
                folder.mkdir()
            with pytest.MonkeyPatch.context() as patch:
                patch.chdir(folder)
                leave_out_drawing(patch)
                draw_two_methods(patch)
                remember_analyses(patch)
                patch.setattr("recon.api.batch.run_tasks", run_tasks_here)
                leave_out_playback(patch)
                fit_demo_from(whole_results, patch)
                shorten_cost_study(patch)
                if name_of(page) == "how-to/experiment.md":
                    use_made_up_numbers(patch)
                patch.setattr(figures, "FIGURES", figures.FIGURES[:1])  # test_solver_analysis.py draws all
                do(steps(page)[count - 1], Workshop(folder, name_of(page), whole_results, of_results))

        return made_once(re.sub(r"\W+", "-", f"{name_of(page)}-{count}"), make)

    return after


def takes_long(page: Path, number: int) -> bool:
    before = [step.command or "" for step in steps(page)[: number + 1]]
    return any(re.match(pattern, before[-1]) for pattern in SLOW) or any(
        re.match(pattern, command) for pattern in LONG for command in before
    )


@pytest.mark.parametrize(
    ("page", "count"),
    [
        pytest.param(
            page,
            number + 1,
            id=f"{name_of(page)}-{step.command or 'start'}",
            marks=[pytest.mark.slow] * takes_long(page, number),
        )
        for page in PAGES
        for number, step in enumerate(steps(page))
    ],
)
def test_page(page: Path, count: int, folder_after) -> None:
    """Each step of a page is a separate test, so that no test takes long."""
    folder_after(page, count)


def alike(text: str) -> str:
    """Return a text without its numbers, blanks and line ends, which differ between machines."""
    return re.sub(r"\s+", " ", re.sub(r"\d+(\.\d+)?", "0", text)).strip()


@pytest.mark.parametrize(
    "command",
    [
        "recon fits clip.csv",
        "recon skeleton check cheetah-25",
        "recon fit clip.csv --camera camera.toml --fps 60 --size-sigmas 0.1 --out x",
        "recon fit klip.csv --camera camera.toml --fps 60 --out x",
    ],
)
def test_a_wrong_name_in_a_command_is_noticed(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(AssertionError, match=re.escape(command)):
        Workshop(tmp_path, "a page", tmp_path, pytest.fail).shell(command)


def test_a_wrong_name_in_python_is_noticed(tmp_path):
    with pytest.raises(AttributeError):
        Workshop(tmp_path, "a page", tmp_path, pytest.fail).python("import recon; recon.fit_klip", {})


def test_blocks_have_a_language_that_is_checked():
    assert [(b.page.name, b.line, b.language) for p in PAGES for b in blocks(p) if b.language not in LANGUAGES] == []
    for page in PAGES:
        assert page.read_text(encoding="utf-8").count("```") == 2 * len(list(blocks(page))), page


def test_toml_blocks_can_be_read():
    """TOML blocks are syntactically correct; the tests of skeletons check their fields."""
    for page in PAGES:
        for block in blocks(page):
            if block.language == "toml" and not SNIPPET.fullmatch(block.text):
                tomllib.loads(block.text)


def test_reasons_are_used():
    everything = [c for p in PAGES for b in blocks(p) if b.language == "sh" for c in commands(b)]
    for pattern in NOT_RUN:
        assert any(re.match(pattern, command + " ") for command in everything), pattern


def not_run(page: Path) -> Iterator[str]:
    """Yield the commands of recon in the blocks of a page that are not run."""
    everything = (command for block in blocks(page) if block.language == "sh" for command in commands(block))
    return (one for one in everything if one.startswith("recon ") and reason_not_to_run(one))


def all_options() -> Iterator[str]:
    for command in (typer.main.get_command(app), *commands_of_recon().values()):
        for parameter in command.params:
            yield from (*parameter.opts, *parameter.secondary_opts)


OTHERS_OPTIONS = {
    "--clips",
    "--levels",
    "--tie",
    "--first",
    "--folds",
    "--others",
    "--only",
    "--write-prior",
    "--nthreads",
    "--help",
    "--index-url",
    "--random-half",
    "--refine",
    "--seeds",
}
"""Options of the benchmarks and of other programs."""


def test_options_in_the_text_exist():
    known = {*all_options(), *OTHERS_OPTIONS}
    for page in PAGES:
        text = FENCE.sub("", page.read_text(encoding="utf-8"))
        codes = [*re.findall(r"`([^`\n]+)`", text), *not_run(page)]
        unknown = {o for code in codes for o in re.findall(r"(?<![\w-])--[a-z][\w-]*", code)} - known
        assert not unknown, f"{page.name}: {', '.join(sorted(unknown))}"


def test_commands_and_scripts_in_the_text_exist():
    group = typer.main.get_command(app)
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for word in re.findall(r"(?:`|\n {4})recon ([a-z][a-z\d-]*)", FENCE.sub("", text)):
            assert word in group.commands, f"{page.name}: recon {word}"  # pyright: ignore[reportAttributeAccessIssue]
        for script in re.findall(r"python (\S+\.py)", text):
            assert (ROOT / script).is_file(), f"{page.name}: {script}"
        for module in re.findall(r"`(recon/[\w/.-]+)`", text):
            assert (ROOT / module).exists(), f"{page.name}: {module}"


def test_links_of_the_readme_lead_somewhere():
    """Links of the README are checked here, and links of docs/ when the site is built."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for link in re.findall(r"\]\((?!https?://)([^)#]+)", text):
        assert (ROOT / link).exists(), link


OFFLINE = """
import socket, sys
def refuse(*args, **kwargs): raise OSError("the net was asked")
socket.socket.connect = socket.create_connection = socket.getaddrinfo = refuse
from zensical.main import cli
cli(prog_name="zensical")
"""


def built_site(folder: Path) -> Path:
    """Build the site as `make docs` does, in a folder that also holds Zensical's cache, and return its folder."""
    shutil.copytree(DOCS, folder / "docs", ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("mkdocs.yml", "CHANGELOG.md", "CONTRIBUTING.md"):
        shutil.copy(ROOT / name, folder)
    for name in ("recon", "pipelines"):
        (folder / name).symlink_to(ROOT / name)
    command = [sys.executable, "-c", OFFLINE, "build", "--clean", "--strict"]
    environment = {**os.environ, "PYTHONPATH": str(DOCS)}
    done = subprocess.run(
        command, cwd=folder, env=environment, capture_output=True, text=True, check=False, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return (folder / "site").resolve()


def lost_links(pages: dict[Path, str]) -> Iterator[str]:
    """Yield broken links, including links to pictures, to other files and in snippets, which Zensical skips."""
    names = {page: {"", *re.findall(r'\s(?:id|name)="([^"]*)"', text)} for page, text in pages.items()}
    for page, text in pages.items():
        for link in re.findall(r'\s(?:href|src)="([^"]*)"', text):
            url = urlsplit(html.unescape(link))
            target = (page.parent / unquote(url.path)).resolve() if url.path else page
            if not url.scheme and not (target.exists() and unquote(url.fragment) in names.get(target, {""})):
                yield f"{page.name}: {link}"


@pytest.mark.slow
def test_the_site_is_built_and_read_without_the_net(tmp_path):
    pytest.importorskip("zensical")
    site = built_site(tmp_path)
    (site / "live").mkdir()
    (site / "live" / "report.html").touch()  # `make docs` writes it afterwards, by docs/live_page.py
    pages = {page: page.read_text(encoding="utf-8") for page in site.rglob("*.html") if page.name != "404.html"}
    assert {str(page.relative_to(site)) for page in pages} >= {
        name_of(page).removesuffix(".md") + ".html" for page in PAGES[1:]
    }
    for page, text in pages.items():
        assert not re.search(r"""<(?:script|img|iframe)[^>]+src=["']?(?:https?:)?//""", text), page
        assert not re.search(r"""<link[^>]+rel=["']?stylesheet[^>]+href=["']?(?:https?:)?//""", text), page
        assert 'class="arithmatex"' not in text, f"{page}: a formula that was not converted"
    assert pages[site / "method" / "trajectory.html"].count("<math") > 15
    assert "joint_sigma_m" in pages[site / "api.html"]
    # This is the text below a field of a class.
    assert "Name of the camera in its calibration file." in pages[site / "api.html"]
    assert "../data/samples/whole_scene.json" in pages[site / "pipelines.html"]
    assert "Keep a Changelog" in pages[site / "changelog.html"]
    assert len(json.loads((site / "search.json").read_text(encoding="utf-8"))["items"]) > 100
    assert list(lost_links(pages)) == []
    changed = pages[site / "index.html"] + ' <img src="no.png"> <a href="gait.html#nowhere"> <a href="gait.html">'
    assert list(lost_links({**pages, site / "index.html": changed})) == [
        "index.html: no.png",
        "index.html: gait.html#nowhere",
    ]


def test_sites_of_several_versions_link_to_each_other(tmp_path):
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "index.html").write_text("first")
    sites, add_version = tmp_path / "sites", runpy.run_path(str(DOCS / "versions.py"))["add_version"]
    for version in ("0.9.0", "0.10.0", "0.2.0"):
        add_version(sites, tmp_path / "site", version)
    (tmp_path / "site" / "index.html").write_text("again")
    assert add_version(sites, tmp_path / "site", "0.9.0") == ["0.10.0", "0.9.0", "0.2.0"]
    listed = json.loads((sites / "versions.json").read_text(encoding="utf-8"))
    assert [(one["version"], one["aliases"]) for one in listed][:2] == [("0.10.0", ["latest"]), ("0.9.0", [])]
    assert (sites / "0.9.0" / "index.html").read_text() == "again"
    assert "url=0.10.0/index.html" in (sites / "index.html").read_text(encoding="utf-8")
