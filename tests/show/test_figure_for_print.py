"""Test the sizes, letters, fonts and captions of the figures for papers that `recon figure` draws."""

from __future__ import annotations

import re
import zlib
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import refused, run
from figure_texts import cut_off
from matplotlib.text import Text

from recon.api.analyse import DEFAULT_FIGURES, figures_of
from recon.api.figure import caption_of, draw_for_print
from recon.base.errors import InputError
from recon.gait.clip import ClipAnalysis
from recon.show.plots import style


@pytest.fixture(scope="module")
def whole(whole_analysis: ClipAnalysis) -> ClipAnalysis:
    return whole_analysis


@pytest.mark.parametrize(
    ("names", "width_mm"),
    [pytest.param(("side_view", "joint_flexion"), 89.0, marks=pytest.mark.slow), (("footfalls", "speed"), 183.0)],
)
def test_a_figure_for_a_paper_has_its_width_and_letters_of_seven_points(
    whole: ClipAnalysis, names: tuple[str, ...], width_mm: float
):
    printed = draw_for_print(whole, names, width_mm)
    assert printed.figure.get_figwidth() / style.MM == pytest.approx(width_mm)
    texts = [text for text in printed.figure.findobj(Text) if text.get_text().strip() and text.get_visible()]
    assert {text.get_fontsize() for text in texts} == {7.0}
    letters = [part.get_suptitle() for part in printed.figure.subfigs]
    assert letters == ["a", "b"]


@pytest.mark.parametrize("name", DEFAULT_FIGURES)
def test_no_text_of_the_default_figures_is_cut_off_in_a_column(whole: ClipAnalysis, name: str):
    figure = draw_for_print(whole, (name,), 89.0).figure
    with style.printing(89.0):
        assert cut_off(figure) == []


def test_the_files_have_embedded_fonts_and_600_dpi(whole: ClipAnalysis, tmp_path: Path):
    figure = draw_for_print(whole, ("footfalls",), 89.0).figure
    pdf = style.printed_content(figure, "pdf")
    # A stream may itself end in a carriage return.
    streams = [zlib.decompress(part) for part in re.findall(rb"stream\r?\n(x.*?)\nendstream", pdf, re.DOTALL)]
    assert b"/FontFile2" in pdf + b"".join(streams)
    width, _ = map(float, re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", pdf).groups())  # type: ignore[union-attr]
    assert width == pytest.approx(89 * 72 / 25.4, abs=0.1)
    picture = cv2.imdecode(np.frombuffer(style.printed_content(figure, "png"), np.uint8), cv2.IMREAD_COLOR)
    assert picture.shape[1] == pytest.approx(89 / 25.4 * 600, abs=1)
    assert b"<text" not in style.printed_content(figure, "svg")
    assert style.printed_content(figure, "pdf") == pdf


def test_the_caption_says_n_bands_method_and_citation(whole: ClipAnalysis):
    caption = caption_of(whole, ("joint_flexion", "speed"), "clip")
    assert "(a) Joint angles over the stride" in caption
    assert "(b) Speed" in caption
    assert "Gait: transverse gallop (" in caption_of(whole, ("footfalls",))
    assert "90 % of further strides" in caption
    assert f"n = 1 animal, 1 clip, {len(whole.gait.strides)} complete strides" in caption  # type: ignore[union-attr]
    assert "60 frames at 60 Hz, 1 camera, skeleton cheetah-24" in caption
    assert "Cite: The recon developers" in caption


def test_a_clip_without_a_stride_has_figures_of_the_clip(whole: ClipAnalysis):
    assert whole.gait is not None
    assert "the first complete stride of the foot" in caption_of(whole, ("side_view",))
    assert "lines with ticks" in caption_of(whole, ("footfalls",))
    vars(analysis := ClipAnalysis(whole.motion))["gait"] = replace(whole.gait, strides=())
    side_view, footfalls = (caption_of(analysis, (name,)).partition("\n")[0] for name in ("side_view", "footfalls"))
    assert "the clip, which has no complete stride" in side_view
    assert "%" not in side_view
    assert "over the clip, which has no complete stride, in the animal's own frame." in caption_of(
        analysis, ("body_fixed",)
    )
    assert "over one stride in the animal's own frame." in caption_of(whole, ("body_fixed",))
    assert "ticks" not in footfalls
    figure = draw_for_print(analysis, ("side_view",), 183.0).figure
    below = [text.get_text() for text in figure.findobj(Text) if re.fullmatch(r"[\d.]+ (s|%)", text.get_text())]
    assert len(below) == 6
    assert below[0] == f"{analysis.motion.time_s[analysis.motion.solved][0]:.2f} s"
    with pytest.raises(InputError) as error:
        draw_for_print(analysis, ("joint_flexion",), 183.0)
    assert "no complete stride" in str(error.value)
    assert "side_view, footfalls, speed" in str(error.value)


def test_the_caption_of_the_speed_names_what_is_drawn(whole: ClipAnalysis):
    is_known = not whole.reference_motion.why_no_acceleration
    assert ("acceleration" in caption_of(whole, ("speed",))) == is_known
    assert "of spine over time" in caption_of(whole, ("speed",))
    axes = draw_for_print(whole, ("speed",), 183.0).figure.axes
    assert any(panel.get_ylabel().startswith("acceleration") for panel in axes) == is_known


def test_every_figure_has_a_caption(whole: ClipAnalysis):
    for name in figures_of(whole):
        assert caption_of(whole, (name,)).startswith(name.replace("_", " ")) is False


@pytest.mark.usefixtures("undrawn", "remembered_analyses")
def test_the_command_writes_figure_and_caption(whole_results: Path, tmp_path: Path):
    listed = run("figure", whole_results)
    assert listed.code == 0
    assert "joint_flexion" in listed.out
    out = tmp_path / "fig1.svg"
    assert run("figure", whole_results, "speed", "--out", out, "--width", 89).code == 0
    assert sorted(path.name for path in tmp_path.iterdir() if path.suffix != ".json") == ["fig1.svg", "fig1.txt"]
    refused(["figure", whole_results, "speeed", "--out", tmp_path / "b.svg"], (whole_results, "figure", "speeed"))
    refused(["figure", whole_results, "speed", "--out", tmp_path / "b.jpg"], ("--out", "file"))
    refused(["figure", whole_results, "--out", tmp_path / "b.svg"], ("FIGURE", "name", "nothing"))
