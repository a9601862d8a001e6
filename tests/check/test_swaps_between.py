"""Test that what other cameras see shows in which camera, frames and keypoints left and right are swapped."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from types import SimpleNamespace

import numpy as np
from example_run import BODY, FPS, POSES, PRIOR, plain, truth_m, view_of

from recon.check.likelihood import CERTAIN_GAIN
from recon.check.swaps import Stretch, pairs_of, with_exchanged
from recon.check.swaps_between import gaining_stretches, swaps_between
from recon.clip import View
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions

T = len(plain().states)


def right_views() -> list[View]:
    return [view_of(truth_m(), pose, seed=i) for i, pose in enumerate(POSES[:3])]


def stretch(kind: str, first: int, stop: int) -> Stretch:
    return Stretch(slice(first, stop), pairs_of(BODY)[kind])


def found_in(views: list[View]):
    """Return the swaps of each view as tuples of the first frame, the frame after the last and the keypoints."""
    clip = ClipProblem.from_views(views, BODY, PRIOR, FPS, TrajectoryOptions())
    noise_px = np.full((len(views), *views[0].confidence.shape), 2.0)
    fit = SimpleNamespace(states=plain().states, size=plain().size, markers_m=truth_m(), noise_px=noise_px)
    found, mended = swaps_between(clip, fit)
    assert all(swap.ratio > CERTAIN_GAIN and swap.clear for swaps in found for swap in swaps)
    of_views = [[(s.stretch.rows.start, s.stretch.rows.stop, s.stretch.markers) for s in swaps] for swaps in found]
    return of_views, mended


def test_right_sides_are_confirmed():
    found, mended = found_in(right_views())
    assert found == [[], [], []]
    for view, before in zip(mended, right_views(), strict=True):
        np.testing.assert_array_equal(view.xy_px, before.xy_px)


def test_swaps_are_found_in_the_camera_the_frames_and_the_keypoints_that_have_them():
    views, wrong = right_views(), {0: stretch("all", 12, 20), 1: stretch("hind", 24, T)}
    for number, swap in wrong.items():
        views[number] = with_exchanged(views[number], swap)
    found, mended = found_in(views)
    assert found == [[(12, 20, wrong[0].markers)], [(24, T, wrong[1].markers)], []]
    for view, before in zip(mended, right_views(), strict=True):
        np.testing.assert_array_equal(view.xy_px, before.xy_px)


def test_two_swaps_in_the_same_frames_are_both_found():
    """The predictions for one of the cameras with a swap use the other one, until its swap is undone."""
    views, swap = [*right_views(), view_of(truth_m(), POSES[0], seed=7)], stretch("all", 10, 30)
    views[0], views[1] = with_exchanged(views[0], swap), with_exchanged(views[1], swap)
    found, _ = found_in(views)
    assert found == [[(10, 30, swap.markers)], [(10, 30, swap.markers)], [], []]


def test_frames_that_only_one_other_camera_sees_decide_nothing():
    views = right_views()
    views[0] = with_exchanged(views[0], stretch("all", 12, 20))
    views[1] = replace(views[1], xy_px=np.full_like(views[1].xy_px, np.nan))
    assert found_in(views)[0] == [[], [], []]


def test_gaining_stretches_have_the_largest_sum():
    """All sets of stretches of short clips are compared."""
    rng = np.random.default_rng(0)
    # No stretch begins where another one ends.
    sets = [[*zip(ends[::2], ends[1::2], strict=True)] for n in (0, 2, 4, 6) for ends in combinations(range(7), n)]
    for gain, at_ends in zip(rng.normal(0, 3, (30, 6)), rng.normal(0, 1, (30, 7)), strict=True):

        def total(stretches: list[tuple[int, int]], gain=gain, at_ends=at_ends) -> float:
            return sum(gain[first:stop].sum() + at_ends[first] + at_ends[stop] - 3.0 for first, stop in stretches)

        found = gaining_stretches(gain, at_ends, 3.0)
        np.testing.assert_allclose(total(found), max(total(stretches) for stretches in sets))
    nothing = np.zeros(7)
    assert gaining_stretches(np.array([9.0, 9.0, -1.0, 9.0, -20.0, 9.0]), nothing, 3.0) == [(0, 4), (5, 6)]
    assert gaining_stretches(np.array([]), np.zeros(1), 3.0) == []


def test_a_swap_ends_where_the_tracks_jump():
    gain, at_ends = np.array([1.0, 20.0, 20.0, 1.0, 1.0]), np.array([0.0, 9.0, -9.0, -9.0, 9.0, 0.0])
    assert gaining_stretches(gain, at_ends, 30.0) == [(1, 4)]
    assert gaining_stretches(gain, 0 * at_ends, 30.0) == [(0, 5)]
