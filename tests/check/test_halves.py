"""Test that a hind half that belongs to another animal is found by its time offset."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from recon.check.halves import foreign_half, halves_finding, hind_markers, hind_offset
from recon.check.one_step import one_steps
from recon.fit.clip_problem import ClipProblem


def later(clip: ClipProblem, half: np.ndarray, frames: int) -> ClipProblem:
    """Return the clip with the markers of one half, a mask (J,), from an animal that runs `frames` frames behind."""
    (view,) = clip.views
    xy_px = view.xy_px.copy()
    xy_px[frames:, half] = view.xy_px[: len(xy_px) - frames, half]
    return replace(clip, views=(replace(view, xy_px=xy_px),))


@pytest.mark.parametrize(("late", "is_named"), [(0, False), (2, True)])
def test_the_hind_half_of_a_later_animal_is_reported(sample_fit, late, is_named):
    clip, solution = sample_fit
    is_hind, names = hind_markers(clip), np.array(clip.body.markers)
    assert {"tail_base", "l_hip", "l_back_paw"} < {*names[is_hind]}
    assert not {"nose", "l_shoulder", "l_front_paw"} & {*names[is_hind]}
    with threadpool_limits(1, user_api="blas"):
        late_clip = later(clip, is_hind, late)
        offset = one_steps(late_clip, solution, {"halves": hind_offset(late_clip)}).get("halves")
        item = halves_finding(late_clip, solution, offset)
    assert (item is not None) == is_named
    if item is not None:
        assert (item.code, item.severity) == ("halves_apart", "warning")
        assert item.numbers["late_frames"] == pytest.approx(2.0, abs=1.5)
        assert item.numbers["foreign"] == "hind half"


def test_the_foreign_half_is_the_one_that_disagrees_with_the_pose(sample_fit):
    clip, solution = sample_fit
    is_hind = hind_markers(clip)
    everywhere = np.ones_like(is_hind)
    halves = [foreign_half(later(clip, half, 6), solution) for half in (is_hind, ~is_hind, everywhere)]
    assert halves == ["hind half", "fore half", "fore or hind half"]
