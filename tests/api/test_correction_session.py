"""Test corrections by hand: what the editor saves, its fits, and what it refuses."""

from __future__ import annotations

import io
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import refusal
from rich.console import Console
from shared_fixtures import SAMPLES

from recon import InputError, Motion
from recon.api.clip import refit_clip
from recon.api.corrections import CorrectionSession
from recon.base.locks import sole_editor
from recon.cli.fix import _decode, _require_length, _server
from recon.io.corrections import Correction, read_corrections, write_corrections
from recon.show.sections.keypoints import counts


@pytest.fixture
def session(whole_results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> CorrectionSession:
    monkeypatch.setattr("recon.api.corrections.IDLE_S", 3600.0)  # no whole fit
    return CorrectionSession.open(whole_results, tmp_path / "corrections.csv")


def a_row(motion: Motion, frame: int = 20, **changes: object) -> dict[str, object]:
    camera = motion.camera.name
    return {"frame": frame, "camera": camera, "keypoint": "nose", "was_px": [1.0, 2.0], "now_px": [3.0, 4.0]} | changes


def test_a_change_is_saved_and_fitted(session: CorrectionSession, whole_results: Path):
    x, y = session.motion.pictures[0].reprojected_px[20, session.motion.names.index("nose")].tolist()
    kept = (whole_results / "motion.npz").read_bytes()
    assert session.save([a_row(session.motion, now_px=[x + 40.0, y])]) == 1
    (saved,) = read_corrections(session.out)
    assert (saved.frame, saved.keypoint, saved.was_px) == (20, "nose", (1.0, 2.0))
    assert saved.date
    assert session.wait_for_fit(0, wait_s=60.0)
    assert session.problem == ""
    assert session.motion.keypoints.xy_px[20, session.motion.names.index("nose")] == pytest.approx([x + 40.0, y])
    assert session.state()["version"] == 1
    assert (whole_results / "motion.npz").read_bytes() == kept


def test_after_a_pause_the_clip_is_fitted_as_recon_fit_does(
    session: CorrectionSession, monkeypatch: pytest.MonkeyPatch
):
    """A quick fit from the present motion follows a correction, and a whole fit follows after a pause."""
    monkeypatch.setattr("recon.api.corrections.IDLE_S", 0.0)
    fits, original = [], session.motion
    quick, whole = replace(original), replace(original)
    monkeypatch.setattr("recon.api.corrections.refit_clip", lambda *args: fits.append("quick") or quick)
    monkeypatch.setattr("recon.api.corrections.fit_clip", lambda *args: fits.append("whole") or whole)
    session.save([a_row(session.motion)])
    assert session.wait_for_fit(1, wait_s=60.0)
    assert fits == ["quick", "whole"]
    assert session.motion is whole
    assert session.is_whole


def test_a_correction_at_the_fitted_position_changes_little(session: CorrectionSession, tmp_path: Path):
    """A keypoint that is corrected to its reprojection changes the pose of the quick fit by less than 3 mm."""
    motion, keypoint = session.motion, "r_front_knee"
    j = motion.names.index(keypoint)
    x, y = motion.pictures[0].reprojected_px[18, j].tolist()
    write_corrections([Correction(18, "", keypoint, None, (x, y))], session.out)
    again = refit_clip(replace(session.settings, corrections=session.out), motion)
    assert counts(again)["corrected"] == 1
    difference_m = np.linalg.norm(again.joints_m - motion.joints_m, axis=-1)
    assert np.nanmean(difference_m) < 0.003
    assert again.pictures[0].distance_px[18, j] < 3.0
    assert again.verdict is not None
    assert motion.verdict is not None
    assert again.verdict.pose_m.expected == pytest.approx(motion.verdict.pose_m.expected, rel=0.02)


def test_an_unchanged_correction_keeps_its_date(session: CorrectionSession, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(session, "_fit", lambda: None)
    session.save([a_row(session.motion)])
    first = session.corrections[0]
    session.corrections = [type(first)(**{**first.__dict__, "date": "2020-01-01T00:00:00+00:00"})]
    session.save([a_row(session.motion), a_row(session.motion, frame=21)])
    assert session.corrections[0].date == "2020-01-01T00:00:00+00:00"
    assert session.corrections[1].date > "2026"


@pytest.mark.parametrize(
    "changes",
    [
        {"frame": 10_000},
        {"frame": "1"},
        {"keypoint": "horn"},
        {"camera": "cam9"},
        {"now_px": [1.0]},
        {"now_px": [float("nan"), 1.0]},
        {"now_px": ["1", "2"]},
        {"now_px": [10**400, 1]},
        {"frame": 10**30},
        {"keypoint": []},
        {"camera": {}},
        {"reason": "\ud800"},
        {"reason": "x" * 1000},
    ],
)
def test_invalid_corrections_are_not_saved(session: CorrectionSession, changes: dict[str, object]):
    with pytest.raises(InputError, match="row 1"):
        session.save([a_row(session.motion, **changes)])
    assert not session.out.exists()


@pytest.mark.parametrize("rest", ["9" * 5000, "-1", "1.jpg", "../corrections.csv", "%2e%2e/corrections.csv", "", "²"])
def test_hostile_addresses_return_no_file(session: CorrectionSession, tmp_path: Path, rest: str):
    (tmp_path / "pictures").mkdir()
    (tmp_path / "pictures" / "2.jpg").write_bytes(b"jpeg")
    server = _server(session, tmp_path / "pictures", has_video=True)
    server.server_close()
    assert server.pages["picture"]("2", None).content == b"jpeg"
    assert server.pages["picture"](rest, None).status == 404
    assert json.loads(server.pages["lines"](f"0/{rest}/1", None).content) == {}
    session.version = 1
    assert json.loads(server.pages["state"](rest, None).content)["version"] == 1


def test_file_names_are_plain_text_on_the_page(session: CorrectionSession, tmp_path: Path):
    session.folder = tmp_path / "<img src=x onerror=alert(1)>"
    session.problem = "</script><script>alert(2)</script>"
    server = _server(session, tmp_path, has_video=False)
    server.server_close()
    page = server.pages[""]("", None).content.decode()
    assert "<img src=x" not in page
    assert "<script>alert" not in page
    assert "Correct &lt;img" in page


def test_a_file_changed_by_another_program_is_not_replaced(session: CorrectionSession, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(session, "_fit", lambda: None)
    session.save([a_row(session.motion)])
    session.out.write_text("mine")
    with pytest.raises(InputError, match="another program"):
        session.save([])
    assert session.out.read_text() == "mine"


def test_existing_corrections_are_kept(
    session: CorrectionSession, whole_results: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(session, "_fit", lambda: None)
    session.save([a_row(session.motion, now_px=None, reason="=hidden")])
    again = CorrectionSession.open(whole_results, session.out)
    assert again.corrections == session.corrections
    assert np.isfinite(again.motion.joints_m).any()


def test_two_editors_of_one_file_are_refused(tmp_path: Path):
    with (
        sole_editor(tmp_path / "corrections.csv"),
        pytest.raises(InputError, match="another editor"),
        sole_editor(tmp_path / "corrections.csv"),
    ):
        pass
    assert not [*tmp_path.iterdir()]


def test_corrections_from_a_spreadsheet_are_read(session: CorrectionSession, whole_results: Path):
    """Corrections with semicolons, decimal commas and no camera name, as from a spreadsheet, are read."""
    session.out.write_text("frame;keypoint;now_x_px;now_y_px\n20;nose;3,5;4\n", encoding="utf-8")
    again = CorrectionSession.open(whole_results, session.out)
    (row,) = again.corrections
    assert (row.camera, row.now_px) == (session.motion.camera.name, (3.5, 4.0))


@pytest.mark.parametrize("row", ["5000,nose,1,2", "20,beak,1,2"])
def test_corrections_of_another_clip_are_refused(session: CorrectionSession, whole_results: Path, row: str):
    session.out.write_text(f"frame,keypoint,now_x_px,now_y_px\n{row}\n", encoding="utf-8")
    content = session.out.read_text()
    with refusal((session.out, "corrections", row.split(",")[0], "another --out")):
        CorrectionSession.open(whole_results, session.out)
    assert session.out.read_text() == content


def test_a_video_that_ends_before_the_clip_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A video that ends before the clip is reported before the page opens, or when decoding ends."""
    video, frames = SAMPLES / "rendered.mp4", np.arange(500)
    with refusal((video, "video", "90 frames", "500 frames or more")):
        _require_length(frames, video, 0)
    _require_length(np.arange(90), video, 0)
    monkeypatch.setattr("recon.cli.fix._write_picture", lambda *_: None)
    console = Console(file=io.StringIO(), width=300)
    _decode(frames, video, 0, tmp_path, console)
    assert "90 frames that can be decoded" in console.file.getvalue()
