"""Test the errors of a reconstruction against the truth."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import refusal, run, says
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from recon import evaluate, evaluate_files
from recon.check.codes import finding, sentence
from recon.fit.motion import Motion
from recon.gait.evaluation import aligned, at_frames_of, joint_errors, mismatches
from recon.io.common import Pose3D
from recon.io.deeplabcut import write_csv
from recon.io.markers import write_trc
from recon.io.positions import read_pose3d

NAN = float("nan")
SAMPLES = Path(__file__).parents[2] / "data" / "samples"
RNG = np.random.default_rng(5)


def pose(xyz, names="abcdefgh", frames=None) -> Pose3D:
    xyz = np.array(xyz, float)
    return Pose3D(tuple(names[: xyz.shape[1]]), xyz, np.arange(len(xyz)) if frames is None else np.array(frames))


TRUTH = RNG.normal(0, 0.5, (4, 6, 3))


def test_the_truth_has_no_error():
    result = evaluate(pose(TRUTH), pose(TRUTH))
    for score in (result.mpjpe_m, result.mpe_m, result.scale_mpjpe_m, result.pa_mpjpe_m):
        assert score.mean == pytest.approx(0, abs=1e-12)
    assert [s.mean for _, s in result.pck] == [1, 1, 1]


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("fps", [25.0, 60.0, 200.0])
def test_a_reference_with_another_frame_rate_is_interpolated(fps, first):
    """A reference with another frame rate is interpolated at the times of the reconstruction's frames.

    A point between a known and an unknown one is unknown. TRC counts frames from 1.
    """
    start, speed = RNG.normal(0, 0.5, (6, 3)), RNG.normal(0, 1, (6, 3))

    def run_at(fps: float) -> Pose3D:
        times_s = np.arange(40) / fps
        return replace(pose(start + speed * times_s[:, None, None]), fps=fps)

    reconstruction, truth = run_at(100.0), run_at(fps)
    truth.xyz_m[10, 0] = NAN
    truth = replace(truth, frames=truth.frames + first)
    there = at_frames_of(truth, reconstruction)
    assert there.fps == 100
    result = evaluate(reconstruction, there)
    assert result.mpe_m.mean == pytest.approx(0, abs=1e-9)
    assert result.frames.tolist() == list(range(int(39 / fps * 100 + 1e-6) + 1))[:40]
    lost = there.frames[np.isnan(there.xyz_m[:, 0, 0])] / 100 * fps
    assert len(lost)
    assert (np.abs(lost - 10) < 1).all()
    assert "60 frames per second, and 100" in there.notes[-1] or fps != 60
    assert ("frame 1 of the reference" in there.notes[-1]) == bool(first)


def test_a_reference_with_the_same_frame_rate_is_unchanged():
    truth = replace(pose(TRUTH), fps=29.97)
    assert at_frames_of(truth, replace(pose(TRUTH), fps=30.0)) is truth
    assert at_frames_of(truth, pose(TRUTH)) is truth


def test_metrics_by_hand():
    # Two joints, 2 m apart along x. The pose is 0.3 m too high, and its second joint is 0.16 m too far out.
    truth = pose([[[-1, 0, 0], [1, 0, 0]]])
    result = evaluate(pose([[[-1, 0, 0.3], [1.16, 0, 0.3]]]), truth)
    assert result.mpe_m.mean == pytest.approx((0.3 + 0.34) / 2)
    assert result.mpe_m.per_joint == pytest.approx([0.3, 0.34])
    # Centred, the joints lie at -1.08 and 1.08.
    assert result.mpjpe_m.mean == pytest.approx(0.08)
    assert result.scale_mpjpe_m.mean == pytest.approx(0)
    assert np.isnan(result.pa_mpjpe_m.mean)
    assert result.frames_without_pa == 1
    assert [(t, s.mean) for t, s in result.pck] == [(0.05, 0), (0.1, 1), (0.15, 1)]
    small = evaluate(pose([[[-0.1, 0, 0.03], [0.116, 0, 0.03]]]), pose([[[-0.1, 0, 0], [0.1, 0, 0]]]))
    assert [(t, s.mean) for t, s in small.pck] == [(0.005, 0), (0.01, 1), (0.015, 1)]
    one = evaluate(pose([[[0, 0, 0]]] * 2), pose([[[0, 0, 0]], [[0, 0, np.nan]]]))
    assert [t for t, _ in one.pck] == [0.05, 0.1, 0.15]  # a single joint has no extent


def test_each_alignment_undoes_its_own_change():
    shift, scale = RNG.normal(0, 2, (4, 1, 3)), RNG.uniform(0.5, 2, (4, 1, 1))
    turn = Rotation.random(4, RNG).as_matrix()
    moved, scaled = pose(TRUTH + shift), pose(TRUTH * scale + shift)
    turned = pose(np.einsum("tij,tkj->tki", turn, TRUTH) * scale + shift)

    assert evaluate(moved, pose(TRUTH)).mpjpe_m.mean == pytest.approx(0, abs=1e-12)
    assert evaluate(moved, pose(TRUTH)).mpe_m.per_frame == pytest.approx(np.linalg.norm(shift[:, 0], axis=1))
    assert evaluate(moved, pose(TRUTH)).position_m == pytest.approx(np.linalg.norm(shift[:, 0], axis=1).mean())
    assert evaluate(scaled, pose(TRUTH)).mpjpe_m.mean > 0.05
    assert evaluate(scaled, pose(TRUTH)).scale_mpjpe_m.mean == pytest.approx(0, abs=1e-12)
    assert evaluate(turned, pose(TRUTH)).scale_mpjpe_m.mean > 0.05
    assert evaluate(turned, pose(TRUTH)).pa_mpjpe_m.mean == pytest.approx(0, abs=1e-12)


def test_a_mirrored_pose_is_not_mirrored_back():
    mirrored = TRUTH * [1, -1, 1]
    assert evaluate(pose(mirrored), pose(TRUTH)).pa_mpjpe_m.mean > 0.05
    # A factor of -1 would make this pose perfect.
    opposite = pose(TRUTH.mean(axis=1, keepdims=True) * 2 - TRUTH)
    spread = np.linalg.norm(TRUTH - TRUTH.mean(axis=1, keepdims=True), axis=2)
    assert evaluate(opposite, pose(TRUTH)).scale_mpjpe_m.per_frame == pytest.approx(spread.mean(axis=1))


def test_similarity_agrees_with_scipy():
    noisy = TRUTH + RNG.normal(0, 0.2, TRUTH.shape)
    mirrored = noisy * [1, 1, -1]
    for candidate in (noisy, mirrored):
        similar = aligned(candidate, TRUTH, scale=True, turn=True)
        for got, p, t in zip(similar, candidate, TRUTH, strict=True):
            p_0, t_0 = p - p.mean(axis=0), t - t.mean(axis=0)
            rotated = Rotation.align_vectors(t_0, p_0)[0].apply(p_0)
            expected = rotated * np.sum(rotated * t_0) / np.sum(p_0**2) + t.mean(axis=0)
            np.testing.assert_allclose(got, expected, atol=1e-12)


def test_similarity_and_scale_are_least_squares():
    noisy = TRUTH[:1] + RNG.normal(0, 0.2, (1, 6, 3))

    def similarity(x):
        return np.sum((np.exp(x[6]) * Rotation.from_rotvec(x[:3]).apply(noisy[0]) + x[3:6] - TRUTH[0]) ** 2)

    best = minimize(similarity, np.zeros(7), method="BFGS", tol=1e-10)
    left = aligned(noisy, TRUTH[:1], scale=True, turn=True) - TRUTH[:1]
    assert np.sum(left**2) == pytest.approx(best.fun, rel=1e-6)

    centred, mean = noisy[0] - noisy[0].mean(axis=0), TRUTH[0].mean(axis=0)
    best = minimize(lambda s: np.sum((s[0] * centred + mean - TRUTH[0]) ** 2), [1.0], tol=1e-12)
    assert np.sum((aligned(noisy, TRUTH[:1], scale=True) - TRUTH[:1]) ** 2) == pytest.approx(best.fun, rel=1e-9)


@pytest.mark.parametrize("how", [{}, {"scale": True}, {"scale": True, "turn": True}])
def test_only_common_joints_count(how):
    noisy = TRUTH + RNG.normal(0, 0.1, TRUTH.shape)
    gone_pose, gone_truth = noisy.copy(), TRUTH.copy()
    gone_pose[:, 1] = NAN
    gone_truth[:, 4, 2] = NAN
    keep = [0, 2, 3, 5]
    errors = joint_errors(aligned(gone_pose, gone_truth, **how), gone_truth)
    assert np.isnan(errors[:, [1, 4]]).all()
    expected = joint_errors(aligned(noisy[:, keep], TRUTH[:, keep], **how), TRUTH[:, keep])
    np.testing.assert_allclose(errors[:, keep], expected, atol=1e-12)


def test_all_frames_have_equal_weight():
    truth = np.zeros((3, 4, 3))
    wrong = truth.copy()
    wrong[0, :, 0] = [0.1, 0.1, 0.1, 0.1]
    wrong[1, :, 0] = [0.4, NAN, NAN, NAN]
    wrong[2] = NAN
    result = evaluate(pose(wrong), pose(truth))
    np.testing.assert_allclose(result.mpe_m.per_frame, [0.1, 0.4, NAN])
    np.testing.assert_allclose(result.mpe_m.per_joint, [0.25, 0.1, 0.1, 0.1])
    assert result.mpe_m.mean == pytest.approx(0.25)
    assert (result.frames_not_scored, result.frames_without_pa) == (1, 2)


def test_joints_that_coincide_have_no_scale():
    flat = np.zeros((1, 4, 3))
    result = evaluate(pose(flat), pose(TRUTH[:1, :4]))
    spread = np.linalg.norm(TRUTH[0, :4] - TRUTH[0, :4].mean(axis=0), axis=1).mean()
    for score in (result.mpjpe_m, result.scale_mpjpe_m, result.pa_mpjpe_m):
        assert score.mean == pytest.approx(spread)


def test_joints_match_by_name_and_frames_by_number():
    truth = pose(TRUTH, frames=[10, 11, 12, 13])
    order = [5, 0, 3]
    extra = np.concatenate([TRUTH[1:, order], np.ones((3, 1, 3))], axis=1)
    shuffled = pose(np.concatenate([extra, extra[:1]]), names="fadx", frames=[11, 12, 13, 20])
    result = evaluate(shuffled, truth)
    assert result.names == ("f", "a", "d")
    assert result.frames.tolist() == [11, 12, 13]
    assert result.mpe_m.mean == pytest.approx(0, abs=1e-12)
    assert result.joints_only_in_pose == ("x",)
    assert result.joints_only_in_truth == ("b", "c", "e")
    assert result.frames_only_in_pose == ((20, 21),)
    assert result.frames_only_in_truth == ((10, 11),)


def test_nothing_in_common():
    joints = ("pose", "joints", "(u, v, w, x, y and a, b, c, d, e)")
    with refusal(joints, ("pose", "frames", "(5 to 8 and 0 to 3)")):
        evaluate(pose(TRUTH, names="uvwxyz", frames=[5, 6, 7, 8]), pose(TRUTH))
    with refusal(("pose", "positions", "no joint")):
        evaluate(pose(TRUTH * NAN), pose(TRUTH))


def test_to_dict_is_json_in_millimetres():
    wrong = TRUTH + np.array([0.05, 0, 0])
    wrong[0] = NAN
    result = evaluate(pose(wrong), pose(TRUTH))
    written = json.loads(json.dumps(result.to_dict(), allow_nan=False))
    assert written["mpe_mm"] == pytest.approx(50)
    assert written["mpjpe_mm"] == pytest.approx(0, abs=1e-9)
    assert written["mpe_per_frame_mm"] == [None, *[pytest.approx(50)] * 3]
    assert written["mpe_per_joint_mm"] == {name: pytest.approx(50) for name in "abcdef"}
    assert [(p["threshold_mm"], p["mean"]) for p in written["pck"]] == [(50, 1), (100, 1), (150, 1)]
    assert written["frames"] == [0, 1, 2, 3]
    assert written["frames_not_scored"] == 1


def test_stated_uncertainty_is_compared_with_the_errors():
    """Intervals of 50 and 90 % are 0.60 and 1.60 standard deviations.

    An error that all joints share counts as an error of the position.
    """
    off = np.zeros(TRUTH.shape)
    off[:, :, 0], off[:, :, 1], off[:, :, 2] = 0.05, 0.11, 0.17
    sigma = np.full(TRUTH.shape, 0.1)
    order = [2, 0, 1, 3, 4, 5]
    reconstructed = pose((TRUTH + off)[:, order], "cabdef")
    result = evaluate(reconstructed, pose(TRUTH), (sigma, sigma))
    assert result.inside == {"place": (pytest.approx(1 / 3), pytest.approx(2 / 3)), "pose": (1.0, 1.0)}
    assert result.to_dict()["inside"]["place"][1] == {"level": 0.9, "share": pytest.approx(2 / 3)}
    assert evaluate(reconstructed, pose(TRUTH)).inside == {}


NAMES = ("l_paw", "r_paw", "l_ear", "r_ear", "nose", "tail")
RUN = TRUTH + np.arange(4)[:, None, None] * [1.0, 0.0, 0.0]
TURN = Rotation.from_rotvec([1.2, -0.7, 0.4]).as_matrix()


@pytest.mark.parametrize(
    ("change", "code", "number"),
    [
        (lambda xyz: xyz @ TURN.T + [3.0, 1.0, 2.0], "reference_rotated", ("turn_rad", 1.45)),
        (lambda xyz: xyz[:, [1, 0, 3, 2, 4, 5]], "reference_swapped", None),
        (lambda xyz: xyz[:, [1, 0, 3, 2, 4, 5]] @ TURN, "reference_swapped", ("turn_rad", 1.45)),
        (lambda xyz: xyz * [1.0, 1.0, -1.0], "reference_mirrored", None),
        (lambda xyz: 1000 * xyz, "reference_scaled", ("factor", 0.001)),
        (lambda xyz: 1000 * xyz @ TURN, "reference_scaled", ("factor", 0.001)),
        (lambda xyz: xyz + np.array([0.0, 9.0, 0.0]), "reference_elsewhere", ("y_m", 9.0)),
    ],
)
def test_a_fault_of_the_reference_is_reported(change, code, number):
    """A change of the whole reference is reported, also with additional errors and missing joints."""
    fit = RUN + RNG.normal(0, 0.03, RUN.shape)
    fit[1, 4] = NAN
    assert evaluate(pose(fit, NAMES), pose(RUN, NAMES)).notes == ()
    (found,) = mismatches(change(fit), RUN, NAMES)
    assert found.code == code
    assert number is None or found.numbers[number[0]] == pytest.approx(number[1], rel=0.05)
    assert evaluate(pose(change(fit), NAMES), pose(RUN, NAMES)).notes == (sentence(found),)
    assert evaluate(pose(change(fit), NAMES), pose(RUN, NAMES)).to_dict()["notes"] == [sentence(found)]


def test_poor_fits_and_depths_are_not_faults_of_the_reference():
    """Poor fits and wrong depths are not taken for faults of the reference.

    The errors differ between frames, the position is 1 m off, or the animal is 20 % too large.
    """
    turns = Rotation.from_rotvec(RNG.normal(0, 0.1, (4, 3))).as_matrix()
    turned = np.einsum("tij,tkj->tki", turns, RUN - RUN.mean(axis=1, keepdims=True))
    for fit in (RUN + RNG.normal(0, 0.1, RUN.shape), RUN + np.array([0.0, 1.0, 0.0]), turned, 1.2 * RUN):
        assert evaluate(pose(fit, NAMES), pose(RUN, NAMES)).notes == ()


def test_another_clip_is_reported():
    (found,) = mismatches(RUN[::-1] @ TURN + RNG.normal(0, 0.5, RUN.shape), RUN, NAMES)
    assert found.code == "reference_unlike"


def test_a_result_folder_is_compared_in_the_reference_frame(whole_results, level_results, tmp_path):
    """A folder of results is compared in the world frame or, without a calibration, in the camera frame."""
    truth = SAMPLES / "whole_truth.csv"
    found = evaluate_files(whole_results, truth)
    of_table = evaluate_files(whole_results / "pose3d.csv", truth)  # the table has no uncertainty
    assert found.mpjpe_m.mean == pytest.approx(of_table.mpjpe_m.mean, abs=1e-6)
    assert of_table.inside == {}
    assert found.notes == ()
    assert all(0.3 < half < often and 0.8 < often <= 1.0 for half, often in found.inside.values())
    exchanged = evaluate_files(truth, whole_results)  # a results folder may be the reference
    assert exchanged.mpjpe_m.mean == pytest.approx(found.mpjpe_m.mean)
    with refusal((whole_results, "unit, up", "recon fit", "no --unit")):
        evaluate_files(truth, whole_results, unit="mm")
    (note,) = evaluate_files(level_results, truth).notes
    assert says(note, "frames of reference")
    with refusal((tmp_path, "folder", "no motion.npz", "recon fit")):
        evaluate_files(tmp_path, truth)


def test_a_world_that_was_turned_by_the_feet_is_named(whole_results, tmp_path):
    """If the axes of the camera file were replaced, positions in a reference with these axes differ throughout."""
    motion = Motion.load(whole_results)
    turned = finding("up_from_feet", up="-0.03,-0.07,0.997", height_m=2.4, sigma_rad=0.14)
    replace(motion, findings=(*motion.findings, turned)).save(tmp_path)
    (note,) = evaluate_files(tmp_path, SAMPLES / "whole_truth.csv").notes
    assert says(note, "--set up")


def test_a_reference_that_counts_from_1_without_unit_and_axis_is_read(tmp_path):
    """A reference that counts frames from 1, as TRC files do, and states neither unit nor upward axis is read."""
    pose = read_pose3d(SAMPLES / "whole_truth.csv")
    pose = replace(pose, frames=pose.frames - pose.frames[0], fps=60.0)
    write_trc(pose, tmp_path / "pose.trc")
    write_trc(replace(pose, frames=pose.frames + 1), tmp_path / "truth.trc")
    (note,) = [n for n in evaluate_files(tmp_path / "pose.trc", tmp_path / "truth.trc").notes if "counts" in n]
    assert says(note, "reference counts", "from 1", "from 0", "0.0 mm")
    alike = evaluate_files(tmp_path / "pose.trc", tmp_path / "pose.trc").notes
    assert not [note for note in alike if "counts" in note or "run" in note]
    write_trc(replace(pose, frames=pose.frames + 30), tmp_path / "late.trc")
    (note,) = [n for n in evaluate_files(tmp_path / "pose.trc", tmp_path / "late.trc").notes if "run" in n]
    assert says(note, "30 of 60 frame numbers", "another run")
    rows = ["frame,joint,x,y,z"]
    for frame, points in zip(pose.frames, 1000 * pose.xyz_m, strict=True):
        rows += [f"{frame},{n},{x!r},{z!r},{-y!r}" for n, (x, y, z) in zip(pose.names, points.tolist(), strict=True)]
    (tmp_path / "mm.csv").write_text("\n".join(rows).replace("nan", "") + "\n")
    with refusal((tmp_path / "mm.csv", "unit", "no unit", "--unit")):
        evaluate_files(tmp_path / "pose.trc", tmp_path / "mm.csv")
    write_csv(pose, tmp_path / "ours.csv")
    with refusal((tmp_path / "ours.csv", "unit", ["mm as given", "m in"])):
        evaluate_files(tmp_path / "pose.trc", tmp_path / "ours.csv", unit="mm")
    ended = run("evaluate", tmp_path / "pose.trc", tmp_path / "mm.csv", "--unit", "mm", "--up", "y", "--json")
    assert json.loads(ended.out)["mpe_mm"] == pytest.approx(0, abs=1e-6)


def test_a_result_folder_of_two_fits_is_refused(whole_results, level_results, tmp_path):
    mixed = tmp_path / "mixed"
    shutil.copytree(whole_results, mixed)
    shutil.copy(level_results / "motion.npz", mixed)
    with refusal((mixed / "motion.npz", "content", "manifest.json")):
        evaluate_files(mixed, SAMPLES / "whole_truth.csv")


def test_real_truth_moved(shared_data, tmp_path):
    paths = sorted((shared_data / "cheetah-runs").glob("*/truth.csv"))
    assert len(paths) == 5
    for path in paths:
        result = evaluate_files(path, path)
        assert len(result.names) == 24
        assert result.mpe_m.mean == 0
        assert result.mpjpe_m.mean == pytest.approx(0, abs=1e-12)
        assert result.frames_not_scored == 0

    # The same file with every x 0.1 m larger, written by hand.
    lines = paths[0].read_text().splitlines()
    rows = [line.split(",") for line in lines[2:]]
    moved = [[c if j % 3 != 1 else repr(float(c) + 0.1) for j, c in enumerate(row)] for row in rows]
    copy = tmp_path / "moved.csv"
    copy.write_text("\n".join([*lines[:2], *(",".join(row) for row in moved)]))
    result = evaluate_files(copy, paths[0])
    assert result.mpe_m.mean == pytest.approx(0.1)
    assert result.mpjpe_m.mean == pytest.approx(0, abs=1e-12)
