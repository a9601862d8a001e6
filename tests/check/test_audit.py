"""Test that the audit finds each planted fault in a file of any origin, and finds nothing in correct files."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from command_line import refused, run

from recon import read_pose3d
from recon.animal.body import opposites
from recon.api.audit import Audit, audit_file
from recon.check.audit import LIMITS, audit, measures_of
from recon.check.audited import AuditedPoints, resolution_of, roles_of
from recon.check.codes import sentence
from recon.check.track_checks import jumps_of, missing_gain
from recon.io.calibration import read_camera

SAMPLES = Path(__file__).resolve().parents[2] / "data" / "samples"
ROWS = slice(20, 30)


@pytest.fixture(scope="module")
def poses() -> AuditedPoints:
    """Return the 3D poses of the bundled gallop, at 60 frames per second."""
    return audit_file(SAMPLES / "whole_truth.csv", fps=60).points


@pytest.fixture(scope="module")
def sample() -> AuditedPoints:
    """Return the detected keypoints of the bundled gallop, some of which are outliers."""
    return audit_file(SAMPLES / "whole.csv", fps=60).points


@pytest.fixture(scope="module")
def keypoints(sample: AuditedPoints) -> AuditedPoints:
    """Return the bundled gallop with each detected keypoint replaced by the projection of the true 3D pose."""
    lens, truth = read_camera(SAMPLES / "camera.toml"), read_pose3d(SAMPLES / "whole_truth.csv")
    expected_px, _ = lens.project(lens.world_to_camera(truth.xyz_m[:, [truth.names.index(n) for n in sample.names]]))
    return replace(sample, positions=np.where(sample.known[..., None], expected_px, np.nan))


def codes(points: AuditedPoints, **changes) -> dict[str, tuple[int, int] | None]:
    """Return the codes of the findings on points with some fields replaced, each with the finding's frames."""
    return {item.code: item.frames for item in audit(replace(points, **changes))}


def swap(values: np.ndarray, points: AuditedPoints) -> np.ndarray:
    return values[:, opposites(points.names)]


def test_correct_points_have_no_finding(poses: AuditedPoints, keypoints: AuditedPoints):
    assert poses.roles.skeleton == keypoints.roles.skeleton == "cheetah-24"
    assert codes(poses) == codes(keypoints) == {}
    assert {measure.code for measure in measures_of(poses)} >= {"lengths_change", "unit_unlikely", "up_unlikely"}


def test_outliers_in_single_frames_are_reported(sample: AuditedPoints):
    (finding,) = audit(sample)
    assert finding.code == "points_jump"
    assert finding.numbers["count"] == (np.nan_to_num(jumps_of(sample)) > 1).sum() >= 2


def test_a_moving_animal_is_not_reported_as_a_jump(poses: AuditedPoints):
    fast = poses.positions + np.arange(len(poses.frames))[:, None, None] * [0.5, 0, 0]
    assert np.nanmax(jumps_of(replace(poses, positions=fast))) < 0.5


def in_rows(change: Callable[[np.ndarray, AuditedPoints], np.ndarray]):
    """Return a function that applies a change of the points only in the frames `ROWS`."""

    def changed(points: AuditedPoints) -> np.ndarray:
        values = points.positions.copy()
        values[ROWS] = change(values, points)[ROWS]
        return values

    return changed


def copied(values: np.ndarray, points: AuditedPoints) -> np.ndarray:
    values = values.copy()
    values[:, points.names.index("l_front_paw")] = values[:, points.names.index("r_front_paw")]
    return values


def frozen(points: AuditedPoints) -> np.ndarray:
    values = points.positions.copy()
    values[20:30] = values[19]
    return values


def stuck(points: AuditedPoints) -> np.ndarray:
    values = points.positions.copy()
    values[20:30, points.names.index("spine")] = values[19, points.names.index("spine")]
    return values


def straight(points: AuditedPoints) -> np.ndarray:
    values, k = points.positions.copy(), points.names.index("l_back_knee")
    values[20:30, k] = values[20, k] + np.linspace(0, 1, 10)[:, None] * (values[29, k] - values[20, k])
    return values


def jumping(points: AuditedPoints) -> np.ndarray:
    values = points.positions.copy()
    values[24:26, points.names.index("spine")] += 0.3 * points.extent
    return values


BOTH = {
    "points_identical": (in_rows(copied), (20, 30)),
    "detections_frozen": (frozen, (19, 30)),
    "point_frozen": (stuck, (19, 30)),
    "points_interpolated": (straight, (21, 29)),
    "points_jump": (jumping, (24, 26)),
    "sides_swap": (in_rows(swap), (20, 30)),
}


@pytest.mark.parametrize("code", BOTH)
@pytest.mark.parametrize("kind", ["poses", "keypoints"])
def test_a_fault_in_some_frames_is_reported_with_these_frames(kind: str, code: str, request: pytest.FixtureRequest):
    points = request.getfixturevalue(kind)
    fault, expected = BOTH[code]
    findings = codes(points, positions=fault(points))
    assert list(findings) == [code]
    first, stop = findings[code] or (0, 0)
    first, stop = first - points.frames[0], stop - points.frames[0]
    assert abs(first - expected[0]) <= 1
    assert abs(stop - expected[1]) <= 1


def longer(values: np.ndarray, points: AuditedPoints) -> np.ndarray:
    values = values.copy()
    values[:, points.names.index("nose"), 0] += 0.4
    return values


def bent(values: np.ndarray, points: AuditedPoints) -> np.ndarray:
    values = values.copy()
    above, middle, below = points.roles.joints["left_hock"]
    bone, shank = values[:, middle] - values[:, above], values[:, below] - values[:, middle]
    bone /= np.linalg.norm(bone, axis=1, keepdims=True)
    values[:, below] = values[:, middle] + 2 * np.sum(shank * bone, axis=1, keepdims=True) * bone - shank
    return values


WHOLE = {
    "unit_unlikely": lambda points: 1000 * points.positions,
    "up_unlikely": lambda points: points.positions[..., [0, 2, 1]] * [1, -1, 1],
    "sides_exchanged": lambda points: swap(points.positions, points),
    "lengths_drift": lambda points: points.positions * np.linspace(1, 1.3, len(points.frames))[:, None, None],
    "lengths_change": in_rows(longer),
    "joint_beyond_range": in_rows(bent),
    "feet_slide": lambda points: points.positions - points.positions[:, [points.names.index("tail_base")]] * [1, 1, 0],
}


@pytest.mark.parametrize("code", WHOLE)
def test_a_fault_of_3d_poses_is_reported(code: str, poses: AuditedPoints):
    assert list(codes(poses, positions=WHOLE[code](poses))) == [code]


def test_repeated_and_missing_frames_are_reported(keypoints: AuditedPoints):
    twice = np.repeat(keypoints.positions, 2, axis=0)
    assert list(codes(keypoints, positions=twice, frames=np.arange(len(twice)))) == ["detections_repeated"]
    rows = np.flatnonzero(np.random.default_rng(0).random(len(keypoints.frames)) > 0.3)
    kept = replace(keypoints, positions=keypoints.positions[rows], frames=np.arange(len(rows)))
    (finding,) = audit(kept)
    assert finding.code == "frames_dropped"
    assert finding.numbers["share"] == pytest.approx(0.25, abs=0.15)
    assert codes(replace(kept, frames=rows)) == {}  # the file says which frames are missing


def test_missing_frames_are_distinguished_from_a_change_of_speed():
    rng = np.random.default_rng(1)
    intervals = rng.choice([1, 2, 3], 60, p=[0.7, 0.22, 0.08])
    errors = rng.normal(0, 0.05, 59)
    gain, fraction = missing_gain(np.diff(np.log(intervals)) + errors)
    assert gain > 40
    assert fraction == pytest.approx((intervals > 1).mean(), abs=0.1)
    assert missing_gain(errors)[0] < 0
    gait = 0.5 * np.sin(np.arange(60))  # the logarithm of a smooth speed, which changes by 2.7 times in three frames
    assert missing_gain(np.diff(gait) + errors)[0] < 0


def test_a_standing_foot_stays_still_only_in_coarse_coordinates(poses: AuditedPoints):
    foot = poses.names.index("l_back_paw")
    values = poses.positions.copy()
    values[20:27, foot] = values[20, foot]
    assert codes(poses, positions=values) == {"point_frozen": (20, 27)}
    cells = poses.extent / 500
    coarse = np.round(values / cells) * cells
    assert "point_frozen" not in codes(poses, positions=coarse, resolution=cells)


def test_a_leap_has_no_finding_unless_the_frame_rate_is_wrong(poses: AuditedPoints):
    time_s = np.arange(25) / 60
    values = poses.positions.copy()
    values[15:40, :, 2] += (0.5 * 9.81 * time_s * (time_s[-1] - time_s))[:, None]
    assert codes(poses, positions=values) == {}
    findings = audit(replace(poses, positions=values, fps=120.0))
    assert [item.code for item in findings] == ["gravity_unlikely"]
    assert findings[0].numbers["other_hz"] == pytest.approx(60, rel=0.2)
    assert "frames per second, not 120, would give 9.8 m/s²." in sentence(findings[0])


def test_keypoints_from_another_picture_are_reported(keypoints: AuditedPoints):
    up = [0.0, 1080.0] + keypoints.positions * [1.0, -1.0]
    assert list(codes(keypoints, positions=up)) == ["keypoints_y_up"]
    parts = keypoints.positions / [1920, 1080]
    assert list(codes(keypoints, positions=parts, resolution=0.0)) == ["keypoints_normalised"]


def test_a_unit_or_frame_rate_that_is_not_stated_is_a_note(tmp_path: Path):
    table = pd.read_csv(SAMPLES / "whole_truth.csv", header=None)
    path = tmp_path / "poses.csv"
    names = ["frame"] + [f"{name}_{axis}" for name, axis in table.iloc[:2, 1:].T.itertuples(index=False)]
    rows = table.iloc[3 if str(table.iloc[2, 0]) == "frame" else 2 :].astype(float)
    rows.iloc[:, 1:] *= 1000
    rows.iloc[:, 0] = np.arange(len(rows))
    rows.set_axis(names, axis=1).to_csv(path, index=False)
    result = audit_file(path)
    assert {item.code: item.severity for item in result.findings} == {
        "unit_not_stated": "note",
        "frame_rate_not_stated": "note",
    }
    assert result.findings[0].numbers["unit"] == "mm"


def test_names_from_other_programs_are_understood():
    roles = roles_of(["LeftPaw", "RightPaw", "SpineMid"])
    assert (roles.skeleton, roles.feet, roles.upper) == (None, (0, 1), (2,))
    assert resolution_of(np.array([0.5, 1.25])) == 0.01
    assert resolution_of(np.array([np.pi])) == 0.0


def test_a_file_that_is_too_short_is_not_called_faultless(tmp_path: Path):
    source = tmp_path / "short.csv"
    source.write_text("frame,nose_x,nose_y,tail_x,tail_y\n0,1,2,3,4\n1,2,2,4,4\n2,3,2,5,4\n", encoding="utf-8")
    ended = run("audit", source, "--fps", 60, "--out", tmp_path / "audit")
    assert ended.code == 0
    assert "too few for an audit" in ended.out
    for text in (ended.out, (tmp_path / "audit" / "audit.html").read_text(encoding="utf-8")):
        assert "No fault" not in text


def test_the_command_writes_a_table_and_a_page(tmp_path: Path):
    source, out = SAMPLES / "whole_truth.csv", tmp_path / "audit"
    ended = run("audit", source, "--fps", 60, "--unit", "m", "--out", out)
    assert ended.code == 0
    assert "No fault was found." in ended.out
    table = pd.read_csv(out / "audit.csv")
    assert list(table) == ["code", "severity", "points", "first_frame", "last_frame", "measure", "limit", "text"]
    page = (out / "audit.html").read_text(encoding="utf-8")
    assert "lengths_change" in page
    assert "frames_dropped" in page
    refused(["audit", source, "--out", out], ("--out", "folder", "audit.csv and 1 more"))


def test_a_page_has_a_row_for_each_finding(poses: AuditedPoints):
    from recon.show.page.audit_page import audit_page

    points = replace(poses, positions=1000 * poses.positions)
    result = Audit(Path("a.csv"), "3D poses", points, audit(points))
    page = audit_page(result.source, result.content, points, result.findings, ())
    assert "The animal would be" in page
    assert "gravity_unlikely" in page
    assert next(iter(LIMITS)) == "detections_repeated"


def test_a_folder_is_refused_with_the_name_of_a_file_to_audit(tmp_path: Path):
    def refuses(content: str, expected: object) -> None:
        refused(["audit", tmp_path], (tmp_path, "file", content, expected))

    refuses("a folder without files of points", "a file of 2D keypoints or 3D poses")
    (tmp_path / "broken.h5").write_bytes(b"no HDF5")
    shutil.copy(SAMPLES / "clean.csv", tmp_path / "clip.csv")
    refuses("a folder with 1 file of points", f"recon audit {tmp_path / 'clip.csv'}")
    (tmp_path / "first").mkdir()
    (tmp_path / "first" / "motion.npz").touch()
    refuses("a folder of 1 result", f"recon audit {tmp_path / 'first'}")
