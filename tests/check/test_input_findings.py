"""Test that each fault that is put into a simulated run is found, and that correct runs have no finding."""

from __future__ import annotations

import sys
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from command_line import says
from example_run import BODY, CAMERA, FPS, POSES, PRIOR, plain, run, seen, truth_m, view_of

from recon import FitSettings, fit_clip, samples_folder
from recon.animal.body import opposites, other_side
from recon.animal.prior import prior_from_body
from recon.animal.skeleton_file import load_skeleton
from recon.api.clip_inputs import prepare
from recon.check import likelihood
from recon.check.codes import finding
from recon.check.inputs import input_findings, outlier_ratios, with_flags, without_gross_outliers
from recon.check.likelihood import (
    EXAMINED_GAIN,
    REPORTED_GAIN,
    Refit,
    baseline_of,
    frame_rate_finding,
    negative_log_density,
    other_picture_finding,
    smaller,
    unit_square_finding,
)
from recon.check.swap_repair import downgrade_swap, swap_improves, without_swaps
from recon.check.swaps import (
    Stretch,
    _SwapTrial,
    contradicts,
    is_refuted,
    jumps,
    pairs_of,
    propose_stretches,
    swap_finding,
    swaps,
    try_undone,
    with_exchanged,
    with_undone,
)
from recon.clip import CleaningReport, Keypoints, Source, View, clean, still_view
from recon.fit.clip_problem import ClipProblem, TrajectoryOptions
from recon.fit.motion import Motion
from recon.fit.result import Finding, TrajectorySolution
from recon.fit.trajectory import solve_trajectory
from recon.fit.triangulation import predicted_by_others
from recon.geometry.frames import euler_rotation, inverse, rigid
from recon.io.deeplabcut import write_csv
from recon.io.formats import read_keypoints
from recon.testing.rigs import random_clip

T = 40
NAMED = (None,)


def number(found: Finding, name: str) -> Any:
    return found.numbers[name]


@cache
def view() -> View:
    xy_px = seen(run())
    return still_view(CAMERA, xy_px, np.ones(xy_px.shape[:2]))


def given(changed: View, rows: slice = slice(None)):
    setting = ClipProblem.from_views([changed.part(rows)], BODY, PRIOR, FPS, TrajectoryOptions(fast=True))
    return baseline_of(setting, 0, plain().states[rows], plain().size)


@cache
def solved(changed: View) -> TrajectorySolution:
    return solve_trajectory([changed], BODY, PRIOR, FPS, TrajectoryOptions(fast=True))


def fitted(changed: View):
    """Return the baseline of a fit to the keypoints of a view."""
    setting = ClipProblem.from_views([changed], BODY, PRIOR, FPS, TrajectoryOptions(fast=True))
    return baseline_of(setting, 0, solved(changed).states, solved(changed).size)


def moved(xy_px: np.ndarray) -> View:
    return replace(view(), xy_px=xy_px)


def stretch(kind: str, first: int, stop: int) -> Stretch:
    return Stretch(slice(first, stop), pairs_of(BODY)[kind])


@cache
def exchanged(kind: str, first: int, stop: int) -> View:
    """Return the view with the sides exchanged in some frames, cached so that all tests use the same fit."""
    return with_exchanged(view(), stretch(kind, first, stop))


# Sides


def test_pairs_consist_of_left_and_right_markers():
    names = {kind: {BODY.markers[j] for j in np.flatnonzero(p != np.arange(24))} for kind, p in pairs_of(BODY).items()}
    assert names["fore"] == {f"{s}_front_{part}" for s in "lr" for part in ("knee", "ankle", "paw")}
    assert names["hind"] == {f"{s}_back_{part}" for s in "lr" for part in ("knee", "ankle", "paw")}
    assert names["all"] == {name for name in BODY.markers if name[:2] in ("l_", "r_")}
    np.testing.assert_array_equal(opposites(BODY.markers)[opposites(BODY.markers)], np.arange(24))


def test_swaps_are_undone_only_if_the_whole_clip_becomes_more_likely():
    swapped = solved(exchanged("all", 15, 25))
    assert swap_improves(plain(), swapped)
    assert not swap_improves(swapped, plain())
    assert not swap_improves(plain(), plain())
    one = finding("left_right_swap", (15, 25), "cam1", part="all keypoints", keypoints=(), log_likelihood_ratio=31.0)
    assert downgrade_swap(one).code == "left_right_swap_possible"
    assert downgrade_swap(finding("animal_still", speed_m_s=0.1)).code == "animal_still"


def test_tracks_jump_at_the_ends_of_an_exchange():
    gain = jumps(exchanged("all", 15, 25), pairs_of(BODY)["all"])
    assert sorted(np.argsort(-gain)[:2].tolist()) == [15, 25]
    assert gain[[15, 25]].min() > 20
    assert np.delete(gain, [15, 25]).max() < -3
    assert np.flatnonzero(np.isinf(gain)).tolist() == [0, 1, 2, T - 2, T - 1]


def test_missing_points_are_no_evidence_of_jumps():
    xy_px = view().xy_px.copy()
    xy_px[:, 3] = np.nan
    xy_px[10:14] = np.nan
    gain = jumps(moved(xy_px), pairs_of(BODY)["all"])
    assert np.flatnonzero(np.isinf(gain)).tolist() == [0, 1, 2, *range(8, 17), T - 2, T - 1]
    legs = view().xy_px.copy()
    legs[10:14, pairs_of(BODY)["hind"] != np.arange(24)] = np.nan
    assert not jumps(moved(legs), pairs_of(BODY)["hind"])[8:17].any()
    assert np.isinf(jumps(moved(np.full_like(xy_px, np.nan)), pairs_of(BODY)["all"])).all()
    rng = np.random.default_rng(0)
    outlier = rng.uniform(size=xy_px.shape[:2]) < 0.3
    wild = np.where(outlier[..., None], rng.uniform((0, 0), (1920, 1080), xy_px.shape), view().xy_px)
    assert np.isinf(jumps(moved(wild), pairs_of(BODY)["hind"])).all()
    assert np.isinf(jumps(view().part(slice(0, 5)), pairs_of(BODY)["all"])).all()


@pytest.mark.parametrize(
    ("kind", "first", "stop"),
    [
        ("all", 0, T),
        pytest.param("fore", 20, T, marks=pytest.mark.slow),
        pytest.param("all", 15, 25, marks=pytest.mark.slow),
        pytest.param("hind", 20, T, marks=pytest.mark.slow),
    ],
)
def test_swapped_sides_are_found(kind, first, stop):
    (found,) = swaps(fitted(exchanged(kind, first, stop)))
    assert found.stretch.rows == slice(first, stop)
    assert found.stretch.markers == stretch(kind, first, stop).markers
    assert found.ratio > REPORTED_GAIN
    assert found.clear


@pytest.mark.slow
def test_an_unclear_swap_is_only_a_possible_swap():
    assert swaps(fitted(exchanged("hind", 17, 20))) == []
    trial = _SwapTrial(stretch("hind", 14, 24), REPORTED_GAIN + 10.0, refit=Refit(plain().states, 0.0, 0.0))
    (source,) = motion_of(plain()).sources
    unclear = swap_finding(replace(trial, clear=False), source, BODY)
    assert (unclear.code, unclear.frames) == ("left_right_swap_possible", (114, 124))
    assert unclear.numbers["part"] == "the hind legs"
    assert swap_finding(trial, source, BODY).code == "left_right_swap"
    assert not any("left-right swap" in flags for flags in with_flags(motion_of(plain()), [unclear]).flags)


def test_a_clip_that_only_looks_swapped_is_a_possible_swap(monkeypatch):
    refit = Refit(plain().states, 0.0, 0.0)
    monkeypatch.setattr("recon.check.swaps.try_undone", lambda given, one: _SwapTrial(one, -20.0, refit=refit))
    (found,) = swaps(fitted(exchanged("all", 0, T)))
    assert (found.clear, found.stretch.rows) == (False, slice(0, T))
    assert swaps(fitted(view())) == []


def predicted(views: list[View]) -> tuple[np.ndarray, np.ndarray]:
    """Return what the other views predict of the first view's keypoints."""
    noise_px = [np.full(view.confidence.shape, 2.0) for view in views]
    return next(predicted_by_others(views, truth_m(), noise_px))


def test_other_cameras_refute_swapped_sides_without_a_fit(monkeypatch):
    """The first of three cameras has the sides of ten frames exchanged. A single other camera refutes nothing."""
    views = [view_of(truth_m(), pose, seed=i) for i, pose in enumerate(POSES[:3])]
    views[0] = with_exchanged(views[0], stretch("all", 15, 25))
    states = plain().states
    for count, expected in ((3, [False, True, True]), (2, [False, False, False])):
        clip = ClipProblem.from_views(views[:count], BODY, PRIOR, FPS, TrajectoryOptions())
        baseline = baseline_of(clip, 0, states, plain().size, predicted(views[:count]))
        tried = [stretch("all", 15, 25), stretch("all", 0, 15), stretch("fore", 25, T)]
        assert [is_refuted(baseline, one) for one in tried] == expected
        if count == 3:  # the other cameras predict all legs, so that no fit is needed to find the swap
            monkeypatch.setattr("recon.check.likelihood.project_either_side", lambda *_: pytest.fail("a fit"))
            assert propose_stretches(baseline, pairs_of(BODY), is_unlike=True)[0].rows == slice(15, 25)


def test_frames_that_other_cameras_do_not_see_are_fitted_to_find_a_swap():
    """The second and third camera miss the last 14 frames, in which the first has the hind legs exchanged."""
    views = [view_of(truth_m(), pose, seed=i) for i, pose in enumerate(POSES[:3])]
    views[0] = with_exchanged(views[0], stretch("hind", 26, T))
    views[1:] = [replace(v, xy_px=np.where(np.arange(T)[:, None, None] < 26, v.xy_px, np.nan)) for v in views[1:]]
    clip = ClipProblem.from_views(views, BODY, PRIOR, FPS, TrajectoryOptions())
    baseline = baseline_of(clip, 0, plain().states, plain().size, predicted(views))
    proposed = propose_stretches(baseline, pairs_of(BODY), is_unlike=True)
    assert slice(26, T) in [one.rows for one in proposed if one.markers == stretch("hind", 0, T).markers]


def test_two_frames_of_a_camera_with_a_time_offset_have_no_swaps():
    setting = ClipProblem.from_views(
        [replace(view(), offset_frames=0.3).part(slice(2))], BODY, PRIOR, FPS, TrajectoryOptions()
    )
    assert swaps(baseline_of(setting, 0, plain().states[:2], plain().size)) == []


@pytest.mark.slow
def test_of_two_contradicting_swaps_one_must_be_clearly_more_likely():
    one, other = stretch("hind", 0, 20), stretch("hind", 20, T)
    swapped = fitted(exchanged("hind", 20, T))
    right, wrong = (try_undone(swapped, by) for by in (other, one))
    assert right.ratio > max(REPORTED_GAIN, wrong.ratio + EXAMINED_GAIN)
    then = with_undone(swapped, right)
    assert contradicts(then, right, replace(wrong, ratio=1.0))
    assert contradicts(then, right, replace(wrong, stretch=stretch("fore", 0, 10), ratio=1.0))
    for stretch_of, ratio in ((one, -1.0), (stretch("hind", 21, T), 1.0), (stretch("hind", 30, T), 1.0)):
        assert not contradicts(then, right, replace(wrong, stretch=stretch_of, ratio=ratio))


@pytest.mark.parametrize(
    ("kind", "rows", "ratio", "code"),
    [
        ("all", (0, T), 12.0, "left_right_swap_possible"),
        ("all", (0, T), -1.0, None),
        ("all", (0, T), 31.0, "left_right_swap"),
        ("fore", (15, 25), 12.0, None),
    ],
)
def test_weak_evidence_for_a_whole_clip_is_a_possible_swap(monkeypatch, kind, rows, ratio, code):
    proposed, refit = iter([[stretch(kind, *rows)]]), Refit(plain().states, 0.0, 0.0)
    module = sys.modules[swaps.__module__]
    monkeypatch.setattr(module, "propose_stretches", lambda *args: next(proposed, []))
    monkeypatch.setattr(module, "try_undone", lambda given, stretch: _SwapTrial(stretch, ratio, refit=refit))
    monkeypatch.setattr(module, "with_undone", lambda given, trial: given)
    (source,) = motion_of(plain()).sources
    found = [swap_finding(trial, source, BODY) for trial in swaps(given(view()))]
    assert [one.code for one in found] == ([code] if code else [])
    assert all(one.severity == "warning" for one in found)


def test_a_clip_without_states_has_no_swaps():
    nothing = given(exchanged("all", 15, 25))
    assert propose_stretches(replace(nothing, states=np.full_like(nothing.states, np.nan)), pairs_of(BODY), False) == []


def test_an_end_of_a_clip_is_tried_together_with_the_rest():
    ends = {(one.rows.start, one.rows.stop) for one in propose_stretches(given_half(), pairs_of(BODY), False)}
    assert {(0, 20), (20, T)} <= ends


@pytest.mark.parametrize(("seen_s", "legs", "told"), [(0.4, True, True), (0.2, True, False), (0.4, False, False)])
def test_a_swap_of_a_whole_clip_needs_enough_frames_and_legs(seen_s, legs, told):
    of_leg = pairs_of(BODY)["fore"] != pairs_of(BODY)["hind"]
    shown = moved(np.where(of_leg[:, None] & ~np.bool(legs), np.nan, view().xy_px))
    n = round(seen_s * FPS)
    stretches = propose_stretches(
        given(with_exchanged(shown, stretch("all", 0, T)), slice(0, n)), pairs_of(BODY), False
    )
    assert (slice(0, n) in [one.rows for one in stretches]) == told


def given_half():
    return fitted(exchanged("hind", 20, T))


def test_a_motion_unlike_the_prior_has_swapped_stretches_but_no_swapped_clip():
    (found,) = swaps(given_half(), is_unlike=True)
    assert found.stretch.rows == slice(20, T)
    assert swaps(fitted(exchanged("all", 0, T)), is_unlike=True) == []


def test_a_lasting_error_is_more_likely_than_a_jumping_one():
    xy_px = view().xy_px
    off, sigma_px = np.zeros_like(xy_px), np.full(xy_px.shape[:2], 3.0)
    none = negative_log_density(view(), xy_px, sigma_px, 10.0)
    off[10:30] = [3.0, 0.0]
    lasts = negative_log_density(view(), xy_px + off, sigma_px, 10.0) - none
    jumps_about = (
        negative_log_density(view(), xy_px + off[np.random.default_rng(0).permutation(T)], sigma_px, 10.0) - none
    )
    assert 0 < 3 * lasts < jumps_about
    # If the error is constant, equal frames count once, except for the first ones.
    each, alike = (
        negative_log_density(view(), xy_px + np.array([0.3, 0.0]), sigma_px, n)
        - negative_log_density(view(), xy_px, sigma_px, n)
        for n in (1.0, 10.0)
    )
    assert alike == pytest.approx(each / T * (1 + (T - 1) / 10), rel=0.01)
    hidden = view().xy_px.copy()
    hidden[:, 3] = np.nan
    assert np.isfinite(negative_log_density(moved(hidden), xy_px, sigma_px, 10.0))


@pytest.mark.slow
def test_ten_swapped_frames_of_the_sample_are_found(tmp_path):
    clip = read_keypoints(samples_folder() / "whole.csv")
    other = [clip.names.index(other_side(name)) for name in clip.names]
    xy_px, confidence, rows = clip.xy_px.copy(), clip.confidence.copy(), slice(20, 30)
    xy_px[rows], confidence[rows] = xy_px[rows][:, other], confidence[rows][:, other]
    write_csv(replace(clip, xy_px=xy_px, confidence=confidence), tmp_path / "exchanged.csv")
    camera = samples_folder() / "camera.toml"
    motion = fit_clip(FitSettings(keypoints=(tmp_path / "exchanged.csv",), camera=camera, fps=60))
    found = motion.findings[0]
    assert (found.code, found.frames) == ("left_right_swap", (20, 30))
    assert len(number(found, "keypoints")) == 18
    assert found.numbers["part"] == "all keypoints"
    assert [t for t, flags in enumerate(motion.flags) if "left-right swap" in flags] == [*range(20, 30)]


def motion_of(solution) -> Motion:
    """Return the motion that a solution and its view describe."""
    (one,) = solution.views
    keypoints = Keypoints(BODY.markers, one.xy_px, one.confidence, np.arange(100, 100 + T), FPS)
    source = Source(CAMERA, *clean(keypoints, 0.0), BODY.markers)
    return Motion((source,), None, "both sides are fitted", solution)


def test_an_untouched_clip_has_no_findings():
    assert input_findings(motion_of(plain()), PRIOR, TrajectoryOptions(), NAMED) == ()


@pytest.mark.slow
def test_without_a_learned_prior_neither_sides_nor_rates_are_tested():
    wrong = motion_of(solved(exchanged("all", 15, 25)))
    (found,) = input_findings(wrong, PRIOR, TrajectoryOptions(), NAMED)
    assert (found.code, found.frames, found.camera) == ("left_right_swap", (115, 125), CAMERA.name)
    assert input_findings(wrong, prior_from_body(BODY), TrajectoryOptions(), NAMED) == ()
    setting = ClipProblem.from_views([view()], BODY, prior_from_body(BODY), 2 * FPS, TrajectoryOptions())
    assert frame_rate_finding(setting, given(view()).states, None) is None


@pytest.mark.parametrize(("stop", "code"), [(14, "left_right_swap_mended"), (19, "clip_swapped_back")])
def test_swaps_are_undone_in_the_clip(small_trajectory: Motion, stop, code):
    """Correcting a swap exchanges the sides again. If most of the clip was swapped, the video may be mirrored."""
    (source,) = small_trajectory.sources
    permutation = opposites(small_trajectory.body.markers)
    legs = tuple(small_trajectory.names[j] for j in np.flatnonzero(permutation != np.arange(24)))
    found = (
        finding("left_right_swap", (12, stop), source.camera.name, part="all keypoints", keypoints=legs),
        finding("frame_rate", given_hz=30.0, other_hz=60.0),
    )
    (mended,), marked = without_swaps((source,), found, small_trajectory.body)
    expected = source.keypoints.xy_px.copy()
    expected[2 : stop - 10] = expected[2 : stop - 10][:, permutation]
    np.testing.assert_array_equal(mended.keypoints.xy_px, expected)
    assert [one.code for one in marked] == [code, "frame_rate"]
    assert marked[0].numbers == found[0].numbers
    (again,), _ = without_swaps((mended,), found, small_trajectory.body)
    np.testing.assert_array_equal(again.keypoints.xy_px, source.keypoints.xy_px)
    np.testing.assert_array_equal(again.keypoints.confidence, source.keypoints.confidence)


# Gross outliers


def test_frames_of_gross_outliers_are_left_out_and_flagged(small_trajectory: Motion):
    solution, (source,) = small_trajectory.solution, small_trajectory.sources
    assert isinstance(solution, TrajectorySolution)
    xy_px = source.keypoints.xy_px.copy()
    rng = np.random.default_rng(0)
    xy_px[5:7] = np.where(np.isfinite(xy_px[5:7]), rng.uniform((0, 0), (1920, 1080), xy_px[5:7].shape), np.nan)
    source = replace(source, keypoints=replace(source.keypoints, xy_px=xy_px))
    spoilt = replace(solution, views=(replace(solution.views[0], xy_px=xy_px),))
    ratios = outlier_ratios(spoilt.views[0], spoilt.markers_m, spoilt.noise_px[0])
    assert np.isnan(ratios[3])  # the keypoint has no detections
    assert ratios[5:7].min() > 40
    assert np.nanmax(np.delete(ratios, [5, 6])) < -40
    (kept,), (found,) = without_gross_outliers((source,), spoilt)
    assert (found.code, found.camera, found.frames) == ("gross_outliers", source.camera.name, (15, 17))
    assert not kept.keypoints.present[5:7].any()
    np.testing.assert_array_equal(kept.keypoints.present[:5], source.keypoints.present[:5])
    (note,) = kept.cleaning.notes
    assert says(note, "gross outliers", "left out")
    flags = with_flags(small_trajectory, [found, replace(found, code="left_right_swap_mended", frames=(10, 11))]).flags
    assert [t for t, of_frame in enumerate(flags) if "gross outliers" in of_frame] == [5, 6]
    assert not any("left-right swap" in of_frame for of_frame in flags)


def test_no_frame_is_left_out_if_most_frames_are_outliers(small_trajectory: Motion):
    solution, (source,) = small_trajectory.solution, small_trajectory.sources
    assert isinstance(solution, TrajectorySolution)
    far = replace(solution.views[0], xy_px=solution.views[0].xy_px + 700.0)
    (kept,), found = without_gross_outliers((source,), replace(solution, views=(far,)))
    assert found == ()
    assert isinstance(kept.cleaning, CleaningReport)
    np.testing.assert_array_equal(kept.keypoints.present, source.keypoints.present)


# Bounds of the picture


def test_keypoints_from_0_to_1_are_reported():
    found = unit_square_finding(given(moved(view().xy_px / (1920, 1080))))
    assert found is not None
    assert (found.code, found.severity, found.camera) == ("keypoints_normalised", "error", CAMERA.name)
    assert number(found, "log_likelihood_ratio") == pytest.approx(np.log(1920 * 1080 / 4) * T / (0.16 * FPS))
    assert unit_square_finding(given(view())) is None


@pytest.mark.parametrize(
    ("code", "turn"),
    [
        ("picture_upside_down", lambda xy: [1919, 1079] - xy),
        pytest.param("keypoints_y_up", lambda xy: [0, 1079] + [1, -1] * xy, marks=pytest.mark.slow),
        pytest.param(
            "picture_turned", lambda xy: np.stack([1079 - xy[..., 1], xy[..., 0]], axis=-1), marks=pytest.mark.slow
        ),
    ],
)
def test_a_turned_picture_is_reported(code, turn):
    found = other_picture_finding(given(moved(turn(view().xy_px)), slice(10, 16)))
    assert found is not None
    assert found.code == code
    assert number(found, "log_likelihood_ratio") > 10 * EXAMINED_GAIN


LEVEL = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) @ euler_rotation([0.0, 0.0, 0.7])
"""The rotation of a level camera in a world with z up."""
POSE = rigid(LEVEL, -LEVEL @ [2.0, -3.0, 1.0])
UPSIDE_DOWN = np.diag([1.0, -1.0, -1.0, 1.0])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("code", "axis", "changed"),
    [
        pytest.param(
            "world_not_z_up",
            "-z",
            lambda v: replace(v, T_camera_world=v.T_camera_world @ UPSIDE_DOWN),
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "pose_inverted",
            None,
            lambda v: replace(v, T_camera_world=inverse(v.T_camera_world)),
            marks=pytest.mark.slow,
        ),
        ("upside_down", None, lambda v: replace(v, xy_px=[1919, 1079] - v.xy_px)),
    ],
)
def test_an_animal_that_runs_upside_down_is_reported(code, axis, changed):
    """The cause of an upside-down animal is named only if it is clearly more likely than other causes.

    A turned picture of a level camera is as likely as keypoints with y counted from the bottom.
    """
    posed = replace(CAMERA, rotation=POSE[:3, :3], translation_m=POSE[:3, 3])
    wrong = changed(replace(view(), camera=posed, T_camera_world=POSE))
    found = other_picture_finding(fitted(wrong.part(slice(10, 16))))
    assert found is not None
    assert (found.code, found.numbers.get("axis")) == (code, axis)


@pytest.mark.parametrize(
    ("changed", "numbers", "code"),
    [
        (lambda v: replace(v, T_camera_world=v.T_camera_world @ UPSIDE_DOWN), {"axis": "-z"}, "world_not_z_up"),
        (lambda v: replace(v, xy_px=[0, v.camera.image_size_px[1] - 1] + [1, -1] * v.xy_px), {}, "keypoints_y_up"),
    ],
)
def test_a_cause_that_all_cameras_have_in_common(changed, numbers, code):
    """The cause is one under which the rays meet, although each camera alone prefers another cause."""
    views, _ = random_clip(load_skeleton("dog-27"), 0.0, 3, 0)
    baselines = [SimpleNamespace(view=changed(one), clip=SimpleNamespace(fps=FPS)) for one in views]
    gains = {("world_not_z_up", "-z"): 450.0, ("keypoints_y_up", None): 500.0, ("picture_upside_down", None): 400.0}
    trials = []
    for baseline in baselines:
        alternatives = [*likelihood._turned(baseline.view)]
        trials.append((alternatives, [gains.get((c, n.get("axis")), -100.0) for c, n, _ in alternatives]))
    found = likelihood.common_picture_finding(baselines, trials)
    assert found is not None
    assert (found.code, found.camera) == (code, None)
    assert found.numbers.items() >= numbers.items()


@pytest.mark.parametrize(
    ("gains", "code", "causes"),
    [
        ({"x": 500.0}, "world_not_z_up", None),
        ({"x": 500.0, "picture_turned": 480.0}, "turned_either_way", ["x points up", "turned by 90 degrees"]),
        ({"-z": 500.0, "keypoints_y_up": 480.0}, "upside_down", None),
        ({"rotation_transposed": 500.0}, "rotation_transposed", None),
        ({"rotation_transposed": 500.0, "keypoints_y_up": 480.0}, "upside_down", None),
        (
            {"pose_inverted": 500.0, "rotation_transposed": 480.0},
            "turned_either_way",
            ["pose is from camera to world", "only the camera file's rotation"],
        ),
        ({"-z": 500.0, "picture_turned": 480.0}, "turned_either_way", ["-z points up", "turned by 90 degrees"]),
        ({"-z": 500.0, "picture_turned": 460.0}, "world_not_z_up", None),
        ({"x": 5.0}, None, None),
        ({"picture_turned": 500.0, "270": 400.0}, None, None),
        ({"-y": 500.0, "y": 300.0, "270": 490.0}, None, None),
        ({"y": 500.0, "-y": 100.0}, "world_not_z_up", None),
    ],
)
def test_a_contradiction_names_its_likely_causes(gains, code, causes):
    """A contradiction names its cause if one is clearly more likely than the others, otherwise all likely causes.

    If turns to opposite sides fit, no cause is named.
    """
    posed = replace(CAMERA, rotation=POSE[:3, :3], translation_m=POSE[:3, 3])
    alternatives = [*likelihood._turned(replace(view(), camera=posed, T_camera_world=POSE))]
    ratios = [gains.get(n.get("axis", "270" if n.get("degrees") == 270 else c), -100.0) for c, n, _ in alternatives]
    found = likelihood.finding_of_pictures(posed, alternatives, ratios)
    assert (found and found.code) == code
    if causes:
        assert found is not None
        texts = zip(found.numbers["causes"], causes, strict=True)
        assert all(cause in text for text, cause in texts)


@pytest.mark.parametrize(("axis", "up"), [("x", [1, 0, 0]), ("-x", [-1, 0, 0]), ("y", [0, 1, 0]), ("-y", [0, -1, 0])])
def test_each_axis_is_tried_as_the_upward_axis(axis, up):
    """Each alternative turns an axis of the camera file's world upwards."""
    posed = replace(CAMERA, rotation=POSE[:3, :3], translation_m=POSE[:3, 3])
    alternatives = likelihood._turned(replace(view(), camera=posed, T_camera_world=POSE))
    (turned,) = (other for _, numbers, other in alternatives if numbers.get("axis") == axis)
    np.testing.assert_allclose(POSE[:3, :3] @ up, turned.T_camera_world[:3, 2], atol=1e-12)
    assert np.linalg.det(turned.T_camera_world) == pytest.approx(1)


def test_a_correct_picture_has_no_finding():
    assert other_picture_finding(given(view())) is None


def test_a_smaller_video_is_reported():
    found = other_picture_finding(given(moved(view().xy_px / 2), slice(10, 26)))
    assert found is not None
    assert (found.code, found.numbers["times"]) == ("smaller_video", 2)
    half = smaller(CAMERA, 2)
    assert half.image_size_px == (960, 540)
    points = np.array([[0.3, -0.2, 4.0], [0.0, 0.0, 3.0]])
    np.testing.assert_allclose(half.project(points)[0], (CAMERA.project(points)[0] + 0.5) / 2 - 0.5)


# The frame rate


def test_the_frame_rate_that_a_file_states_is_reported():
    setting = ClipProblem.from_views([view()], BODY, PRIOR, FPS, TrajectoryOptions())
    found = frame_rate_finding(setting, plain().states, 120.0)
    assert found == finding("frame_rate_stated", given_hz=FPS, other_hz=120.0)
    assert frame_rate_finding(setting, plain().states, 90.5) is None


@pytest.mark.parametrize("factor", [0.5, 0.6, 2.0])
def test_a_wrong_frame_rate_is_estimated(factor):
    setting = ClipProblem.from_views([view()], BODY, PRIOR, FPS * factor, TrajectoryOptions())
    found = frame_rate_finding(setting, given(view()).states, None)
    assert found is not None
    assert found.code == "frame_rate"
    assert number(found, "other_hz") == pytest.approx(FPS, rel=0.15)
    assert number(found, "log_likelihood_ratio") > EXAMINED_GAIN


def test_the_frame_rate_is_not_tested_with_few_detections(monkeypatch):
    judged: list[bool] = []
    monkeypatch.setattr("recon.check.inputs.frame_rate_finding", lambda *_, by_motion: judged.append(by_motion))
    for flags in ((), ("data poor",)):
        motion = motion_of(replace(plain(), flags=(flags,) * T))
        input_findings(motion, PRIOR, TrajectoryOptions(), NAMED, seek_swaps=False)
    assert judged == [True, False]


@pytest.mark.slow
def test_half_the_frame_rate_of_the_sample_is_reported():
    camera = samples_folder() / "camera.toml"
    motion = fit_clip(FitSettings(keypoints=(samples_folder() / "whole.csv",), camera=camera, fps=30))
    found = motion.findings[0]
    assert found.code == "frame_rate"
    assert number(found, "other_hz") == pytest.approx(60.0, rel=0.25)
    assert "motion_unlike_prior" not in [one.code for one in motion.findings]


@pytest.mark.slow
def test_a_swap_of_a_whole_clip_is_not_tried_for_a_too_fast_animal():
    camera = samples_folder() / "camera.toml"
    motion = fit_clip(FitSettings(keypoints=(samples_folder() / "whole.csv",), camera=camera, fps=240))
    codes = {one.code: one for one in motion.findings}
    assert "left_right_swap" not in codes
    assert number(codes["frame_rate"], "other_hz") == pytest.approx(60.0, rel=0.25)
    assert number(codes["too_fast"], "speed_m_s") > 40


# Contents of the files


def test_a_file_states_its_frame_rate(tmp_path):
    file = read_keypoints(samples_folder() / "whole_cam1.csv")
    write_csv(replace(file, fps=60.0), tmp_path / "stated.csv")
    told = {"keypoints": tmp_path / "stated.csv", "camera": samples_folder() / "camera.toml"}
    for fps, stated in ((30.0, 60.0), (60.0, None), (None, None)):
        (source,) = prepare(FitSettings(**told, fps=fps)).sources
        assert (source.keypoints.fps, source.keypoints.stated_fps) == (fps or 60.0, stated)


def test_a_file_named_after_another_camera_is_reported():
    settings = FitSettings(
        keypoints=(samples_folder() / "whole_cam1.csv",),
        camera=samples_folder() / "whole_scene.json",
        camera_name=("cam2",),
        fps=60,
        frames="0:12",
        fast=True,
    )
    motion = fit_clip(settings)
    found = motion.findings[0]
    assert (found.code, found.numbers) == ("other_camera_named", {"given": "cam2", "other": "cam1"})
    assert motion.solution.stage_s["input_findings"] > 0
