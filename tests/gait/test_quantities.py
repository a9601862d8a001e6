"""Test that a gait's quantities are the same in all outputs, and follow from footfalls or the motion's period."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from recon.gait.clip import ClipAnalysis
from recon.gait.quantities import PAIRS, SIDE_SIGMA, asymmetry_values, shared_sigma
from recon.show.sentences import analysis_sentences
from recon.show.tables import gait, gait_quantities


@pytest.fixture(scope="module")
def whole(whole_analysis: ClipAnalysis) -> ClipAnalysis:
    return whole_analysis


def test_table_and_sentences_have_the_same_numbers(whole: ClipAnalysis):
    columns, rows = gait_quantities(whole)
    by_name = {row[0]: dict(zip(columns, row, strict=True)) for row in rows}
    head, (cells,) = gait(whole)
    means = dict(zip(head, cells, strict=True))
    sources = {"speed_m_s": "path", "stride_length_m": "footfalls", "duty_factor": "footfalls"}
    for name, source in sources.items():
        row = by_name[name]
        assert row["estimate"] == means[name] == whole.quantities[name].value
        assert row["low"] < row["estimate"] < row["high"]
        assert row["source"] == source
    low, high = whole.quantities["speed_m_s"].interval
    assert f"(90 %: {low:.1f} to {high:.1f}) on average" in next(analysis_sentences(whole))


def test_the_size_counts_in_lengths_and_speeds_only(whole: ClipAnalysis):
    shared = shared_sigma(whole.motion)
    assert shared == pytest.approx(whole.motion.solution.size_sigma / whole.motion.size)
    for name, has_size in (("speed_m_s", True), ("stride_length_m", True), ("duty_factor", False)):
        quantity = whole.quantities[name]
        size = quantity.value * shared * has_size
        assert quantity.sigma**2 == pytest.approx(quantity.own_sigma**2 + size**2)


def test_without_a_complete_stride_the_period_is_used(whole: ClipAnalysis):
    found = whole.gait
    assert found is not None
    cut = replace(found, strides=(), stride_s=0.3, stride_sigma_s=0.024)
    analysis = ClipAnalysis(whole.motion)
    vars(analysis)["gait"] = cut
    quantities, speed = analysis.quantities, whole.quantities["speed_m_s"]
    length = quantities["stride_length_m"]
    assert length.source == quantities["stride_frequency_hz"].source == "period of the motion"
    assert length.value == pytest.approx(0.3 * speed.value)
    assert length.sigma == pytest.approx(np.hypot(0.3 * speed.sigma, 0.024 * speed.value))
    assert quantities["stride_frequency_hz"].value == pytest.approx(1 / 0.3)
    stances = [stance.duration_s for stance in cut.stances if stance.begins and stance.ends]
    assert quantities["duty_factor"].value == pytest.approx(np.mean(stances) / 0.3)
    assert any("From the period of the motion, strides are" in sentence for sentence in analysis_sentences(analysis))
    vars(unknown := ClipAnalysis(whole.motion))["gait"] = replace(cut, stride_s=np.nan, stride_sigma_s=np.nan)
    assert np.isnan(unknown.quantities["stride_length_m"].value)
    assert "too little" in unknown.quantities["stride_length_m"].why_unknown


def test_a_period_longer_than_the_clip_is_not_a_stride(whole: ClipAnalysis):
    assert whole.gait is not None
    duration_s = float(np.ptp(whole.gait.tracks.time_s))

    def with_period(share: float, stances: int | None = None) -> ClipAnalysis:
        assert whole.gait is not None
        kept = [s for s in whole.gait.stances if s.begins and s.ends][:stances]
        found = replace(whole.gait, strides=(), stances=tuple(kept), stride_s=share * duration_s, stride_sigma_s=0.02)
        vars(analysis := ClipAnalysis(whole.motion))["gait"] = found
        return analysis

    texts = {share: " ".join(analysis_sentences(with_period(share))) for share in (0.9, 1.1, 1.5)}
    assert [share for share, text in texts.items() if "strides are" in text] == [0.9]
    assert [share for share, text in texts.items() if "would repeat after" in text] == [1.1]
    assert with_period(1.1).quantities["stride_s"].value == pytest.approx(1.1 * duration_s)
    too_long = with_period(1.5).quantities
    for name in ("stride_s", "stride_length_m", "stride_frequency_hz", "duty_factor"):
        assert np.isnan(too_long[name].value)
        assert too_long[name].why_unknown
    assert not any(name.startswith("phase_") for name in too_long)
    one_stance = with_period(0.9, stances=1)
    foot = one_stance.gait.stances[0].foot
    assert np.isnan(one_stance.quantities["duty_factor"].value)
    assert 0 < one_stance.quantities[f"duty_factor_{foot}"].value < 1


def test_asymmetry_is_refused_or_has_an_interval(whole: ClipAnalysis):
    found = whole.gait
    assert found is not None
    for girdle, feet in PAIRS.items():
        quantity = whole.quantities[f"asymmetry_stance_{girdle}"]
        counts = [len(side) for side in asymmetry_values(found, "stance", feet)]
        if min(counts) < 3:
            assert np.isnan(quantity.value)
            assert "complete strides" in quantity.why_unknown
    thrice = replace(found, strides=tuple(s for s in found.strides for _ in range(3)))
    vars(analysis := ClipAnalysis(whole.motion))["gait"] = thrice
    left, right = asymmetry_values(thrice, "excursion", PAIRS["hind"])
    quantity = analysis.quantities["asymmetry_excursion_hind"]
    assert quantity.value == pytest.approx(2 * (left.mean() - right.mean()) / (left.mean() + right.mean()))
    assert quantity.interval[0] < quantity.value < quantity.interval[1]
    # Errors of touch-down that both feet share cancel, which leaves the scatter of the strides and the view's error.
    left, right = asymmetry_values(thrice, "stance", PAIRS["hind"])
    scatter = np.hypot(*(np.std(side, ddof=1) / len(side) ** 0.5 for side in (left, right)))
    expected_sigma = np.hypot(2 * scatter / (left.mean() + right.mean()), SIDE_SIGMA["stance"])
    assert analysis.quantities["asymmetry_stance_hind"].sigma == pytest.approx(expected_sigma)
    expected = replace(whole.motion.solution, data_share=0 * whole.motion.solution.data_share)
    vars(unseen := ClipAnalysis(replace(whole.motion, solution=expected)))["gait"] = thrice
    assert "comes mostly from the prior" in unseen.quantities["asymmetry_excursion_hind"].why_unknown
