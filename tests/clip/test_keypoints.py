"""Test keypoints, ranges of frames, and the cleaning of keypoints."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from command_line import refusal, says

from recon.clip import Keypoints, clean, fill_gaps, frame_ranges, leave_out, parse_frame_range

NAN = float("nan")


def keypoints(xy, confidence, frames=None, **more) -> Keypoints:
    xy, confidence = np.array(xy, float), np.array(confidence, float)
    frames = np.arange(len(xy)) if frames is None else np.array(frames)
    return Keypoints(tuple("abcdefgh"[: xy.shape[1]]), xy, confidence, frames, **more)


def one_point(*rows, frames=None, **more) -> Keypoints:
    """Return a clip of one keypoint from rows of (x, y, likelihood), one for each frame."""
    return keypoints([[row[:2]] for row in rows], [[row[2]] for row in rows], frames, **more)


@pytest.mark.parametrize(
    "change",
    [
        {"names": ("a", "a")},
        {"names": ("a", "")},
        {"names": ("a",)},
        {"xy_px": np.zeros((3, 2))},
        {"xy_px": np.zeros((3, 2, 2), int)},
        {"confidence": np.zeros((2, 2))},
        {"frames": np.array([0, 1])},
        {"frames": np.array([0, 1, 1])},
        {"frames": np.array([0.0, 1.0, 2.0])},
        {"fps": 0.0},
        {"fps": NAN},
    ],
)
def test_fields_must_fit_together(change):
    fields = {"names": ("a", "b"), "xy_px": np.zeros((3, 2, 2)), "confidence": np.zeros((3, 2)), "frames": np.arange(3)}
    Keypoints(**fields)
    with pytest.raises(ValueError, match=r"\w"):
        Keypoints(**(fields | change))


@pytest.mark.parametrize(
    ("text", "expected"),
    [("3:8", (3, 8)), (" 3 : 8 ", (3, 8)), (":8", (None, 8)), ("3:", (3, None)), (":", (None, None)), ("0:1", (0, 1))],
)
def test_frame_range(text, expected):
    assert parse_frame_range(text) == expected


@pytest.mark.parametrize("text", ["", "3", "3-8", "a:b", "8:3", "3:3", "-3:8", "1:2:3", "1.5:3", "٣:8"])
def test_invalid_frame_range_is_refused(text):
    with refusal(("--frames", "range", f"'{text}'", "A < B")):
        parse_frame_range(text)


def test_frame_range_is_half_open_and_in_original_numbers():
    clip = one_point(*[(i, i, 1) for i in range(10)], frames=range(100, 110))
    cleaned, report = clean(clip, 0.5, (103, 106))
    assert cleaned.frames.tolist() == [103, 104, 105]
    assert cleaned.xy_px[:, 0, 0].tolist() == [3, 4, 5]
    assert report.frames == (103, 106)
    assert report.frames_dropped == 7
    assert clean(clip, 0.5, (None, 102))[0].frames.tolist() == [100, 101]
    assert clean(clip, 0.5, (108, None))[0].frames.tolist() == [108, 109]
    assert clean(clip, 0.5, (0, 101))[0].frames.tolist() == [100]


def test_empty_frame_range_names_the_existing_frames():
    clip = one_point((1, 1, 1), (1, 1, 1), frames=[152, 193], source="clip.csv")
    with refusal(("clip.csv", "frames", "0:42", "152 to 193")):
        clean(clip, 0.5, (0, 42))


def test_zero_zero_is_missing_only_without_likelihood():
    clip = one_point((0, 0, 0), (0, 0, NAN), (0, 0, 0.9), (0, 5, 0.9), (5, 0, NAN))
    cleaned, report = clean(clip, 0.5)
    np.testing.assert_array_equal(cleaned.xy_px[:, 0], [[NAN, NAN], [NAN, NAN], [0, 0], [0, 5], [5, 0]])
    assert cleaned.confidence[:, 0].tolist() == [0, 0, 0.9, 0.9, 1]
    (counts,) = report.keypoints.values()
    assert (counts["used"], counts["missing"], counts["missing_zero_zero"], counts["rejected"]) == (3, 2, 2, 0)
    assert counts["likelihood_unknown"] == 1


@pytest.mark.parametrize("at", [(-1.0, -1.0), (0.0, 0.0)])
def test_a_corner_that_several_keypoints_have_stands_for_missing_points(at):
    rng = np.random.default_rng(0)
    xy_px, missing = rng.uniform(10, 100, (40, 4, 2)), rng.random((40, 4)) < 0.2
    raw = Keypoints(tuple("abcd"), np.where(missing[..., None], at, xy_px), np.ones((40, 4)), np.arange(40))
    cleaned, report = clean(raw, 0.5)
    np.testing.assert_array_equal(cleaned.present, ~missing)
    assert report.constant_px == at
    assert report.total("missing_constant") == missing.sum()
    xy_px[:, 0] = at  # a single constant keypoint is not a missing value
    assert clean(Keypoints(tuple("abcd"), xy_px, np.ones((40, 4)), np.arange(40)), 0.5)[1].constant_px is None


def test_nan_with_any_likelihood_is_missing():
    clip = one_point((NAN, NAN, 1), (NAN, 3, 0.2), (3, NAN, NAN), (NAN, NAN, NAN), (NAN, NAN, 0), (1, 2, 0.6))
    cleaned, report = clean(clip, 0.5)
    assert np.isnan(cleaned.xy_px[:5]).all()
    assert cleaned.confidence[:, 0].tolist() == [0, 0, 0, 0, 0, 0.6]
    (counts,) = report.keypoints.values()
    assert (counts["missing"], counts["missing_nan_with_likelihood"], counts["missing_empty"]) == (5, 2, 3)
    assert (counts["used"], counts["rejected"]) == (1, 0)


def test_unlikely_points_are_rejected_not_missing():
    clip = one_point((1, 1, 0.59), (2, 2, 0.6), (3, 3, 0.61), (4, 4, 0))
    cleaned, report = clean(clip, 0.6)
    assert np.isnan(cleaned.xy_px[:, 0, 0]).tolist() == [True, False, False, True]
    assert cleaned.confidence[:, 0].tolist() == [0, 0.6, 0.61, 0]
    assert (report.total("rejected"), report.total("missing")) == (2, 0)
    assert clean(clip, 0)[1].total("used") == 4
    with refusal(("keypoints", "points", ["every point", "4 with a likelihood below"], "--set likelihood-min")):
        clean(clip, 0.7)


@pytest.mark.parametrize("likelihood_min", [-0.1, 1.1, NAN])
def test_threshold_must_be_a_likelihood(likelihood_min):
    with refusal(("--set likelihood-min", "likelihood_min", likelihood_min, "0 to 1")):
        clean(one_point((1, 1, 1)), likelihood_min)


def test_gaps_become_missing_rows():
    clip = one_point((1, 1, 1), (2, 2, 1), (5, 5, 1), (9, 9, 1), frames=[1, 2, 5, 9], fps=90.0, individual="m")
    cleaned, report = clean(clip, 0.5)
    assert cleaned.frames.tolist() == list(range(1, 10))
    np.testing.assert_array_equal(cleaned.xy_px[:, 0, 0], [1, 2, NAN, NAN, 5, NAN, NAN, NAN, 9])
    assert cleaned.confidence[:, 0].tolist() == [1, 1, 0, 0, 1, 0, 0, 0, 1]
    assert report.inserted == ((3, 5), (6, 9))
    (counts,) = report.keypoints.values()
    assert (counts["frames"], counts["used"], counts["missing"], counts["missing_absent_frame"]) == (9, 4, 5, 5)
    assert (cleaned.fps, cleaned.individual) == (90.0, "m")
    # Frames outside the clip are not inserted, because nothing is known there.
    assert clean(clip, 0.5, (0, 4))[0].frames.tolist() == [1, 2]


def test_very_long_gap_asks_for_a_frame_range():
    clip = one_point((1, 1, 1), (2, 2, 1), frames=[0, 10**12])
    with refusal(("keypoints", "frames", 10**12, "--frames A:B")):
        clean(clip, 0.5)
    assert clean(clip, 0.5, (0, 5))[0].frames.tolist() == [0]
    # The largest gap that is filled has 10 x 2 + 10,000 frames.
    assert len(fill_gaps(one_point((1, 1, 1), (2, 2, 1), frames=[0, 10_021]))[0].frames) == 10_022
    with refusal(("keypoints", "frames", 10021, "--frames A:B")):
        fill_gaps(one_point((1, 1, 1), (2, 2, 1), frames=[0, 10_022]))


def test_all_missing_is_an_error_that_counts_the_rejected():
    clip = one_point((1, 1, 0.1), (2, 2, 0.2), (0, 0, 0), source="clip.csv")
    with refusal(("clip.csv", "points", ["every point", "2 with a likelihood below", 0.6])):
        clean(clip, 0.6)


def test_counts_add_up_and_nothing_else_changes():
    rng = np.random.default_rng(3)
    t, k = 400, 5
    xy = rng.uniform(1, 100, (t, k, 2))
    confidence = rng.uniform(0, 1, (t, k))
    xy[rng.random((t, k)) < 0.1] = 0
    confidence[rng.random((t, k)) < 0.1] = 0
    confidence[rng.random((t, k)) < 0.1] = NAN
    xy[rng.random((t, k, 2)) < 0.1] = NAN
    frames = np.sort(rng.choice(1000, t, replace=False))
    raw = Keypoints(tuple("abcde"), xy.copy(), confidence.copy(), frames, notes=("a note",))
    cleaned, report = clean(raw, 0.4)

    np.testing.assert_array_equal(raw.xy_px, xy)
    np.testing.assert_array_equal(raw.confidence, confidence)
    used = ~np.isnan(cleaned.xy_px).any(axis=2)
    np.testing.assert_array_equal(np.isnan(cleaned.xy_px[..., 0]), ~used)
    assert (cleaned.confidence[~used] == 0).all()
    assert (cleaned.confidence[used] >= 0.4).all()
    rows = frames - frames[0]
    np.testing.assert_array_equal(cleaned.xy_px[rows][used[rows]], xy[used[rows]])
    for i, counts in enumerate(report.keypoints.values()):
        assert counts["used"] + counts["missing"] + counts["rejected"] == counts["frames"] == len(cleaned.frames)
        assert counts["used"] == used[:, i].sum()
        assert counts["missing"] == (
            counts["missing_zero_zero"]
            + counts["missing_nan_with_likelihood"]
            + counts["missing_empty"]
            + counts["missing_absent_frame"]
            + counts["missing_constant"]
        )
    assert report.constant_px == (0.0, 0.0)
    again, second = clean(cleaned, 0.4)
    np.testing.assert_array_equal(again.xy_px, cleaned.xy_px)
    np.testing.assert_array_equal(again.confidence, cleaned.confidence)
    assert second.total("rejected") == 0

    assert report.total("rejected") == sum(counts["rejected"] for counts in report.keypoints.values())
    assert report.total("used") == used.sum()
    assert report.notes == ("a note",)
    assert sum(b - a for a, b in report.inserted) == len(cleaned.frames) - t


def test_frame_ranges():
    assert frame_ranges(np.array([], int)) == ()
    assert frame_ranges(np.array([4])) == ((4, 5),)
    assert frame_ranges(np.array([1, 2, 3, 7, 9, 10])) == ((1, 4), (7, 8), (9, 11))


def test_points_left_out_count_as_rejected_and_are_named():
    keypoints = Keypoints(("a", "b"), np.ones((3, 2, 2)), np.full((3, 2), np.nan), np.arange(7, 10))
    cleaned, report = clean(keypoints, 0.5)
    points = np.array([[False, False], [False, True], [False, True]])
    left, told = leave_out(cleaned, report, points, "of no use")
    assert left.present.tolist() == (~points).tolist()
    assert left.confidence[1].tolist() == [1, 0]
    counted = [(of["used"], of["rejected"], of["likelihood_unknown"]) for of in told.keypoints.values()]
    assert counted == [(3, 0, 3), (1, 2, 1)]
    (note,) = told.notes
    assert says(note, "2 points", "of no use", "b in frame 8, ...")
    assert leave_out(cleaned, report, points & False, "of no use") == (cleaned, report)


def test_points_left_out_of_a_clip_that_has_more_keypoints_than_its_file():
    cleaned, report = clean(Keypoints(("b",), np.ones((3, 1, 2)), np.full((3, 1), np.nan), np.arange(3)), 0.5)
    xy_px = np.concatenate([np.full((3, 1, 2), np.nan), cleaned.xy_px], axis=1)
    wider = dataclasses.replace(cleaned, names=("a", "b"), xy_px=xy_px, confidence=np.ones((3, 2)))
    _, told = leave_out(wider, report, np.array([[False, True], [False, False], [False, False]]), "of no use")
    assert [(name, of["used"], of["rejected"]) for name, of in told.keypoints.items()] == [("b", 2, 1)]
