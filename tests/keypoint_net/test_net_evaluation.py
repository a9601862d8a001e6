"""Compare scores, calibrations and suspicious labels with values computed by hand."""

from __future__ import annotations

import numpy as np
import pytest
from command_line import refusal, run
from scipy.special import expit, logit

from recon.keypoint_net.labels import Labels, evaluate_2d, evaluate_2d_files, reliability
from recon.keypoint_net.network import calibrated, fit_calibration
from recon.keypoint_net.train import suspicious_labels

NAN = float("nan")


def test_expected_calibration_error_equals_the_value_by_hand():
    # The bins have 2 points at 0.05 (0 correct), 4 at 0.55 (3 correct) and 4 at 1.0 (3 correct). By hand, the error is
    # (2 * 0.05 + 4 * 0.2 + 4 * 0.25) / 10.
    likelihood = np.array([0.05, 0.05, *[0.55] * 4, *[1.0] * 4])
    right = np.array([0, 0, 1, 1, 1, 0, 1, 1, 1, 0], bool)
    table = reliability(likelihood, right)
    assert table["expected_calibration_error"] == pytest.approx(0.19)
    assert [(b["low"], b["points"]) for b in table["bins"]] == [(0.0, 2), (0.5, 4), (0.9, 4)]
    assert table["bins"][1]["likelihood"] == pytest.approx(0.55)
    assert table["bins"][2]["right"] == pytest.approx(0.75)


def test_calibration_recovers_the_true_likelihoods():
    rng = np.random.default_rng(0)
    raw = rng.uniform(0.02, 0.98, 20_000)
    right = rng.random(20_000) < expit(0.6 * logit(raw) - 0.8)
    found = fit_calibration(raw, right)
    assert found == (pytest.approx(0.6, abs=0.03), pytest.approx(-0.8, abs=0.05))
    assert reliability(calibrated(raw, found), right)["expected_calibration_error"] < 0.01
    assert reliability(raw, right)["expected_calibration_error"] > 0.1


def test_calibration_stays_finite_if_all_points_are_correct():
    found = fit_calibration(np.full(50, 0.9), np.ones(50, bool))
    assert 0.9 < float(calibrated(np.array([0.9]), found)[0]) < 1
    np.testing.assert_array_equal(calibrated(np.array([0.3]), fit_calibration(np.zeros(0), np.zeros(0, bool))), [0.3])


def test_scores_equal_the_values_by_hand():
    # The errors are 3, 4 and 12 px, with one missed point and one unlabelled point.
    label = np.array([[[0, 0], [10, 0], [0, 10]], [[0, 0], [10, 0], [NAN, NAN]]], float)
    xy = np.array([[[3, 0], [10, 4], [NAN, NAN]], [[0, 12], [10, 0.5], [5, 5]]], float)
    xy[1, 1] = [10, 0.5]
    label[1, 1] = [NAN, NAN]
    likelihood = np.array([[0.9, 0.4, 0.0], [0.8, 0.9, 0.9]])
    result = evaluate_2d(("nose", "l_paw", "r_paw"), xy, likelihood, label, 50.0, 0.5, 5.0)
    score = result["all"]
    assert score["points"] == 4
    assert score["found"] == pytest.approx(0.75)
    assert score["rmse_px"] == pytest.approx(np.sqrt((9 + 16 + 144) / 3))
    assert score["median_px"] == pytest.approx(4)
    assert score["pck_px"] == pytest.approx({"2.5": 0, "5.0": 0.5, "10.0": 0.5})
    assert score["pck_relative"] == pytest.approx({"0.05": 0, "0.1": 0.5, "0.2": 0.5})  # 2.5, 5 and 10 px
    assert result["likely"]["found"] == pytest.approx(0.5)
    assert result["likely"]["median_px"] == pytest.approx(7.5)
    assert result["per_keypoint"]["nose"]["median_px"] == pytest.approx(7.5)
    assert result["reliability"] is not None
    assert result["reliability"]["points"] == 3


def test_left_right_swaps_are_forgiven_pair_by_pair():
    label = np.array([[[0, 0], [20, 0], [0, 30], [20, 30]]], float)
    xy = label[:, [1, 0, 2, 3]] + [[[1, 0], [1, 0], [2, 0], [19, 0]]]
    names = ("l_knee", "r_knee", "l_paw", "r_paw")
    result = evaluate_2d(names, xy, np.ones((1, 4)), label, 40.0)
    assert result["swaps_forgiven"] is not None
    # The knees are swapped, with errors of 1 px. The right paw is 19 px off but not swapped, so its pair is unchanged.
    assert result["swaps_forgiven"]["pck_px"] == pytest.approx(dict.fromkeys(("2.5", "5.0", "10.0"), 0.75))
    assert result["all"]["pck_px"] == pytest.approx(dict.fromkeys(("2.5", "5.0", "10.0"), 0.25))
    assert evaluate_2d(("nose", "hip"), xy[:, :2], np.ones((1, 2)), label[:, :2], 40.0)["swaps_forgiven"] is None


def write(path, kind, rows, names):
    coords = ("x", "y", "likelihood") if kind == "points" else ("x", "y")
    lines = [
        "scorer," + ",".join(["me"] * len(coords) * len(names)),
        "bodyparts," + ",".join(n for n in names for _ in coords),
        "coords," + ",".join(list(coords) * len(names)),
        *(",".join([str(index), *map(str, values)]) for index, values in rows),
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_files_are_matched_by_frame_and_name(tmp_path):
    points = write(tmp_path / "p.csv", "points", [(n, (n, 0, 0.9, 5, 5, 0.9)) for n in range(4)], ("nose", "hip"))
    rows = [(f"labeled-data/a/{n + 50}.png", (5, 8, n + 1, 0)) for n in range(2, 6)]
    labels = write(tmp_path / "l.csv", "labels", rows, ("hip", "nose"))
    result = evaluate_2d_files(points, labels, first_frame=50)
    assert result["frames"] == 2
    assert result["per_keypoint"]["nose"]["median_px"] == pytest.approx(1)
    assert result["per_keypoint"]["hip"]["median_px"] == pytest.approx(3)
    assert evaluate_2d_files(points, labels, first_frame=50, frames="53:")["frames"] == 1
    with refusal((points, "frames", "0 to 3", ["52 to 55", "--first-frame"])):
        evaluate_2d_files(points, labels)


def test_the_command_prints_a_table(tmp_path):
    points = write(tmp_path / "p.csv", "points", [(n, (n, 0, 0.9)) for n in range(4)], ("nose",))
    labels = write(tmp_path / "l.csv", "labels", [(f"a/{n}.png", (n, 3)) for n in range(4)], ("nose",))
    ended = run("evaluate-2d", points, labels)
    assert ended.code == 0, ended.err
    assert "3.00" in ended.out
    assert "Expected calibration error: 0.100" in ended.out


def marching(n: int = 40) -> Labels:
    """Return labels of four keypoints of an animal, 30 px long, that moves 2 px per frame and swings a little."""
    t = np.arange(n, dtype=float)
    shape = np.array([[0, 0], [30, 0], [5, 15], [25, 15]], float)
    xy = np.repeat(shape[None], n, axis=0) + np.stack([2 * t, np.zeros(n)], axis=1)[:, None]
    xy[:, 2, 0] += 3 * np.sin(t)
    pictures = tuple(np.zeros((4, 4, 3), np.uint8) for _ in range(n))
    images = tuple(f"img{i}.png" for i in range(n))
    return Labels(("a", "b", "c", "d"), xy, np.arange(n), images, np.zeros(n, np.int64), ("x",), pictures, "x")


def test_a_wrong_label_is_found_by_the_network_and_the_shape():
    labels = marching()
    truth = labels.xy_px.copy()
    labels.xy_px[20, 3] += [0, 60]
    found = suspicious_labels(labels, truth, 34.0)
    assert (found[0]["image"], found[0]["keypoint"]) == ("img20.png", "d")
    assert len(found[0]["reasons"]) == 2
    assert found[0]["network"] == pytest.approx(60 / 34)


def test_a_wrong_label_is_found_without_neighbours_and_with_a_network_that_learned_it():
    labels = marching()
    labels.xy_px[0, 1:3] = NAN
    labels.xy_px[0, 3] = [200.0, 40.0]
    found = suspicious_labels(labels, labels.xy_px.copy(), 34.0)
    assert {(s["image"], s["keypoint"]) for s in found} == {("img0.png", "a"), ("img0.png", "d")}


def test_a_network_that_has_not_learned_a_keypoint_flags_none_of_its_labels():
    labels = marching()
    seen = labels.xy_px.copy()
    seen[:, 3] += np.where(np.arange(len(seen)) % 2, 15.0, 45.0)[:, None]
    assert suspicious_labels(labels, seen, 34.0) == []


def test_good_labels_are_not_suspicious():
    labels = marching()
    assert suspicious_labels(labels, labels.xy_px + 1.0, 34.0) == []
