"""Test training, resuming, predicting and error messages on a small clip of three coloured blobs."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from command_line import refusal, refused, run, says
from later import needs_torch, torch
from networks import EVALUATIONS, narrow_networks
from users_files import require_untouched

from recon.base.package import install_command
from recon.io.formats import read_keypoints
from recon.io.video import VideoInfo, probe, video_writer
from recon.keypoint_net import network as predict_module
from recon.keypoint_net import train as train_module
from recon.keypoint_net.network import load_torch, run_prediction
from recon.keypoint_net.settings import LabelSource
from recon.keypoint_net.train import (
    MEASURED_ERRORS,
    TrainSettings,
    measured_errors,
    run_training,
    schedule,
    training_figure,
)
from recon.testing.files import write_damaged_video

pytestmark = needs_torch

SIZE, FRAMES = (96, 64), 20
NAMES = ("nose", "l_paw", "r_paw")
COLOURS = ((250, 60, 60), (60, 250, 60), (60, 60, 250))


def places(frame: int) -> np.ndarray:
    """Return the true points (3, 2) in a frame of the clip, px."""
    x = 20.0 + 2.5 * frame
    swing = 4 * np.sin(0.7 * frame)
    return np.array([[x, 20.0], [x - 8 + swing, 40.0], [x + 8 - swing, 42.0]])


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write clip.avi, and labels.csv with labels of every second frame.

    The labels number the first frame 50. In frame 54, l_paw has no label.
    """
    folder = tmp_path_factory.mktemp("clip")
    rng = np.random.default_rng(0)
    scene = rng.integers(90, 130, (SIZE[1], SIZE[0], 3)).astype(float)
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    with video_writer(folder / "clip.avi", SIZE, 25.0) as write:
        for frame in range(FRAMES):
            picture = scene.copy()
            for (px, py), colour in zip(places(frame), COLOURS, strict=True):
                spot = np.exp(-0.5 * ((x - px) ** 2 + (y - py) ** 2) / 2.5**2)[..., None]
                picture = picture * (1 - spot) + np.array(colour) * spot
            write(picture.astype(np.uint8))
    lines = ["scorer" + ",me" * 6, "bodyparts," + ",".join(n for n in NAMES for _ in "xy"), "coords" + ",x,y" * 3]
    for frame in range(0, FRAMES, 2):
        cells = [f"{v:.2f}" for v in places(frame).ravel()]
        if frame == 4:
            cells[2:4] = ["", ""]
        lines.append(",".join([f"labeled-data/clip/{50 + frame:04d}.png", *cells]))
    (folder / "labels.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return folder


def source(clip: Path, **changes: str) -> LabelSource:
    return LabelSource(data=clip / "clip.avi", labels=clip / "labels.csv", first_frame=50, **changes)


SHORT = TrainSettings(steps=9, batch=2, seed=3)


def train_in(out: Path, clip: Path, settings: TrainSettings = SHORT, resume: bool = False, **more: Any) -> dict:
    return run_training(source(clip), settings, out, device="cpu", threads=1, resume=resume, **more)


@pytest.fixture(scope="module")
def model(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a network of the usual size, trained on the blobs."""
    out = tmp_path_factory.mktemp("model")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(train_module, "EVALUATIONS", EVALUATIONS)
        train_in(out, clip, TrainSettings(steps=50, batch=2, seed=1, mirror=True))
    return out


@pytest.fixture(autouse=True)
def few_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(train_module, "EVALUATIONS", EVALUATIONS)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    quick_training(monkeypatch)


def quick_training(patch: pytest.MonkeyPatch) -> None:
    """Make networks narrow, and skip the training report."""
    narrow_networks(patch)
    patch.setattr("recon.keypoint_net.train.write_training_report", lambda run, state, folder: {})


class Killed(Exception):
    pass


@pytest.fixture(scope="module")
def whole(clip: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a short, uninterrupted run of a narrow network."""
    out = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        quick_training(patch)
        train_in(out, clip)
    return out


@pytest.mark.parametrize("at", [pytest.param(0.5, marks=pytest.mark.slow), 0.85])
def test_a_run_that_is_killed_and_resumed_ends_in_the_same_weights(clip, whole, quick, tmp_path, at):
    # The run is killed between two checkpoints, before or after it begins to learn from the validation pictures.
    def stop(stage: str, share: float) -> None:
        if share >= at:
            raise Killed

    with pytest.raises(Killed):
        run_training(source(clip), SHORT, tmp_path / "broken", device="cpu", threads=1, progress=stop)
    assert not (tmp_path / "broken" / "model.pt").exists()
    train_in(tmp_path / "broken", clip, resume=True)
    one, other = (load_torch(folder / "model.pt") for folder in (whole, tmp_path / "broken"))
    assert one["spec"] == other["spec"]
    assert all(torch.equal(w, other["weights"][name]) for name, w in one["weights"].items())
    assert len(one["weights"]) > 50


def test_input_is_checked_before_the_folder_is_made(clip, tmp_path):
    with refusal((tmp_path / "none" / "checkpoint.pt", "checkpoint", "no such file", "--resume")):
        train_in(tmp_path / "none", clip, resume=True)
    assert not (tmp_path / "none").exists()


def test_the_video_is_never_written_over(clip, whole, quick, tmp_path):
    video = tmp_path / "clip.avi"
    video.write_bytes((clip / "clip.avi").read_bytes())
    with refusal((video, "file", "an input of this run", "another --overlay")):
        run_prediction(video, whole, tmp_path / "p.csv", overlay=tmp_path / "." / "clip.avi", overwrite=True)
    assert video.read_bytes() == (clip / "clip.avi").read_bytes()
    assert not (tmp_path / "p.csv").exists()


def test_no_file_of_the_user_is_replaced(clip, whole, quick, tmp_path):
    # The user's files have the names that the commands write. Each command refuses before any work.
    train_it = ("train", clip / "clip.avi", "--labels", clip / "labels.csv", "--first-frame", 50, "--steps", 3)
    names = (predict_module.MODEL_FILE, train_module.CHECKPOINT_FILE, *train_module.REPORT_FILES)
    require_untouched((*train_it, "--out", tmp_path / "net"), tmp_path / "net", names)
    files = ("points.csv", "points.avi")
    written = ("--out", tmp_path / "p" / files[0], "--overlay", tmp_path / "p" / files[1])
    require_untouched(("predict", clip / "clip.avi", "--model", whole, *written), tmp_path / "p", files)


@pytest.mark.slow
def test_the_message_after_ctrl_c_says_how_to_continue(clip, tmp_path, monkeypatch):
    # Training can then continue from the checkpoint, or start again and replace it.
    def interrupted(*args: object, **options: object) -> None:
        raise KeyboardInterrupt

    def interrupted_after_the_first(*args: Any) -> None:
        save(*args)
        raise KeyboardInterrupt

    save = train_module._save_checkpoint
    narrow_networks(monkeypatch)
    out = tmp_path / "out"
    arguments = ["train", clip / "clip.avi", "--labels", clip / "labels.csv", "--first-frame", "50", "--steps", "3"]
    arguments += ["--threads", 1, "--out", out]
    with monkeypatch.context() as patch:
        patch.setattr(train_module, "train", interrupted)
        ended = run(*arguments)
    assert ended.code == 130
    assert says(ended.err, "Stopped", "no checkpoint")
    assert list(tmp_path.iterdir()) == []
    for more in ([], ["--overwrite"], ["--resume"]):
        with monkeypatch.context() as patch:
            patch.setattr(train_module, "_save_checkpoint", interrupted_after_the_first)
            ended = run(*arguments, *more)
        assert "with --resume continues" in ended.err
        assert {path.name for path in out.iterdir()} == {"checkpoint.pt", ".recon.json"}
    refused(arguments, ("--out", "folder", "checkpoint.pt", "--resume"))
    ended = run(*arguments, "--resume")
    assert (ended.code, ended.err) == (0, "")
    ended = run(*arguments, "--overwrite")
    assert (ended.code, ended.err) == (0, "")


def test_training_and_prediction_on_cuda(clip, tmp_path):
    # A stopped run has the same weights after it is resumed, and a CPU can read the network.
    if not torch.cuda.is_available():
        pytest.skip("no CUDA device")
    settings = TrainSettings(steps=110, batch=4, seed=1)

    def stop(stage: str, share: float) -> None:
        if share >= 0.5:
            raise Killed

    run_training(source(clip), settings, tmp_path / "whole", device="cuda")
    with pytest.raises(Killed):
        run_training(source(clip), settings, tmp_path / "broken", device="cuda", progress=stop)
    run_training(source(clip), settings, tmp_path / "broken", device="cuda", resume=True)
    one, other = (load_torch(tmp_path / name / "model.pt")["weights"] for name in ("whole", "broken"))
    assert all(torch.equal(w, other[name]) for name, w in one.items())
    points = [
        run_prediction(clip / "clip.avi", tmp_path / "whole", tmp_path / f"{device}.csv", device=device)
        for device in ("cuda", "cpu")
    ]
    truth = np.stack([places(frame) for frame in range(FRAMES)])
    assert np.median(np.linalg.norm(points[0].xy_px - truth, axis=2)) < 2.5
    assert np.median(np.linalg.norm(points[0].xy_px - points[1].xy_px, axis=2)) < 0.2  # bfloat16 on one or both


def test_another_seed_gives_other_weights(clip, quick, tmp_path):
    for seed in (3, 4):
        train_in(tmp_path / str(seed), clip, TrainSettings(steps=2, batch=1, seed=seed))
    a, b = (load_torch(tmp_path / name / "model.pt")["weights"]["scores.weight"] for name in "34")
    assert not torch.equal(a, b)


@pytest.mark.slow
def test_the_network_learns_the_blobs_and_the_report_says_so(clip, model):
    report = json.loads((model / "training.json").read_text(encoding="utf-8"))
    assert report["errors"]["validation"]["all"]["median_px"] < 2.5
    assert report["split"]["validation"] != {}
    assert report["steps"] == 50
    assert report["parameters"] <= 3_000_000
    assert report["labelled_points"]["train"] + report["labelled_points"]["validation"] == 29
    assert report["calibration"]["slope"] > 0
    assert report["reliability_validation"]["points"] > 0
    assert 0 < report["best_validation"]["step"] <= report["validation_in_training_from"]
    files = {"worst.png", "suspicious.csv", "model.pt", "training.png", "training.svg"}
    assert files <= {file.name for file in model.iterdir()}
    assert report["labels_judged"]
    figure = training_figure(report["history"])
    assert [axes.get_ylabel().split("\n")[0] for axes in figure.axes] == ["loss", "learning rate", "validation"]
    assert len(figure.axes[0].lines[0].get_xdata()) == len(report["history"])


def test_an_untrained_network_flags_no_labels_and_a_warning_says_so(clip, tmp_path):
    said: list[str] = []
    settings = TrainSettings(steps=2, batch=1)
    report = train_in(tmp_path / "few", clip, settings, announce=said.append)
    assert not report["labels_judged"]
    assert report["suspicious_labels"] == []
    assert report["learned_median_px"] > 2 * report["tolerance_px"]
    assert "15 minutes on two cores" in said[0]
    assert any("2 steps may be too few" in sentence for sentence in said)
    assert measured_errors(int(said[0].split()[0])) in said


@pytest.mark.parametrize(
    ("count", "sentence"),
    [
        (3, "5 labelled pictures gave a median error of 1.8 px on a rendered video of an animal 101 px long."),
        (3, "Expect larger errors with fewer pictures."),
        (12, "10 labelled pictures gave a median error of 1.2 px"),
        (
            120,
            "40 labelled pictures gave a median error of 1.1 px on a rendered video of an animal 101 px long, and 0.8",
        ),
        (200, "150 labelled pictures gave a median error of 3.1 px on a video of a horse"),
    ],
)
def test_training_states_the_accuracy_for_the_number_of_labels(count: int, sentence: str) -> None:
    assert sentence in measured_errors(count)
    assert ("Expect larger errors" in measured_errors(count)) == (count < 5)


def test_the_stated_accuracy_equals_the_benchmark() -> None:
    # benchmarks/results/net.json has the measured accuracy as single values or ranges.
    path = Path(__file__).parents[2] / "benchmarks" / "results" / "net.json"
    tables = json.loads(path.read_text(encoding="utf-8"))["tables"]
    measured = [
        [float(value) for value in row[2].removesuffix(" px").split(" to ")] for row in tables["accuracy"]["rows"]
    ]
    (horse, film, large) = measured
    fewer = {int(row[0]): float(row[1].removesuffix(" px")) for row in tables["labels"]["rows"]}
    expected = [(5, fewer[5]), (10, fewer[10]), (20, fewer[20]), (40, film[0]), (40, large[0]), (150, np.mean(horse))]
    stated = [(count, float(error.removesuffix(" px"))) for count, _, error in MEASURED_ERRORS]
    assert stated == [(count, pytest.approx(error, abs=0.051)) for count, error in expected]


@pytest.mark.slow
def test_predictions_are_at_the_blobs(clip, model, tmp_path):
    keypoints = run_prediction(clip / "clip.avi", model, tmp_path / "points.csv", device="cpu", threads=1)
    errors = np.linalg.norm(keypoints.xy_px - np.stack([places(f) for f in range(FRAMES)]), axis=2)
    assert np.median(errors) < 2.5


def test_predictions_have_the_layout_of_deeplabcut(clip, whole, quick, tmp_path):
    out = tmp_path / "points.csv"
    run_prediction(clip / "clip.avi", whole, out, overlay=tmp_path / "points.avi", device="cpu", threads=1)
    lines = out.read_text(encoding="utf-8").splitlines()
    assert lines[0] == "scorer" + ",recon_25fps" * 9
    assert lines[1] == "bodyparts," + ",".join(n for n in NAMES for _ in range(3))
    assert lines[2] == "coords" + ",x,y,likelihood" * 3
    table = pd.read_csv(out, header=[0, 1, 2], index_col=0)
    assert table.shape == (FRAMES, 9)
    assert table.index.tolist() == list(range(FRAMES))
    assert list(table.columns.names) == ["scorer", "bodyparts", "coords"]
    keypoints = read_keypoints(out)
    assert ((keypoints.confidence >= 0) & (keypoints.confidence <= 1)).all()
    assert probe(tmp_path / "points.avi").size_px == SIZE
    assert probe(tmp_path / "points.avi").stated_frames == FRAMES


def test_h5_and_csv_hold_the_same_values(clip, whole, quick, tmp_path):
    for name in ("points.csv", "points.h5"):
        run_prediction(clip / "clip.avi", whole, tmp_path / name, device="cpu", threads=1)
    one, other = read_keypoints(tmp_path / "points.csv"), read_keypoints(tmp_path / "points.h5")
    np.testing.assert_allclose(one.xy_px, other.xy_px, atol=1e-9)
    assert pd.DataFrame(pd.read_hdf(tmp_path / "points.h5")).columns.names == ["scorer", "bodyparts", "coords"]


def test_a_video_shorter_than_stated_is_refused(clip, whole, quick, tmp_path, monkeypatch):
    def lying(path: Path) -> VideoInfo:
        return VideoInfo(SIZE, 25.0, 4 * FRAMES)

    monkeypatch.setattr(predict_module, "probe", lying)
    out = tmp_path / "points.csv"
    with refusal((clip / "clip.avi", "frames", FRAMES, [4 * FRAMES, "--partial"])):
        run_prediction(clip / "clip.avi", whole, out, overlay=tmp_path / "o.avi", device="cpu", threads=1)
    assert list(tmp_path.iterdir()) == []
    found = run_prediction(clip / "clip.avi", whole, out, device="cpu", threads=1, partial=True)
    assert len(found.frames) == FRAMES


def test_frames_that_are_missing_inside_a_video_are_named(whole, quick, tmp_path):
    video = write_damaged_video(tmp_path / "a.mkv")
    ended = run("predict", video, "--model", whole, "--out", tmp_path / "p.csv", "--partial", "--device", "cpu")
    text = " ".join(ended.out.split())
    said = re.search(r"note: the time stamps of a\.mkv show missing frames \((\d+) before frame", text)
    assert ended.code == 0, ended.err
    assert said is not None, ended.out
    assert len(read_keypoints(tmp_path / "p.csv").frames) == 40 - int(said[1])


def test_a_checkpoint_of_other_keypoints_is_refused(clip, quick, tmp_path):
    train_in(tmp_path / "out", clip, TrainSettings(steps=1, batch=1))
    text = (clip / "labels.csv").read_text(encoding="utf-8").replace("nose", "tail")
    (tmp_path / "other.csv").write_text(text, encoding="utf-8")
    before = {f.name: f.read_bytes() for f in (tmp_path / "out").iterdir()}
    other = LabelSource(data=clip / "clip.avi", labels=tmp_path / "other.csv", first_frame=50)
    checkpoint = tmp_path / "out" / "checkpoint.pt"
    with refusal((checkpoint, "keypoints", "nose, l_paw, r_paw", "tail, l_paw, r_paw")):
        run_training(other, TrainSettings(steps=1, batch=1), tmp_path / "out", device="cpu", threads=1, resume=True)
    with refusal((checkpoint, "setting batch", 1, 2)):
        train_in(tmp_path / "out", clip, TrainSettings(steps=1, batch=2), resume=True)
    with refusal(("--out", "folder", ["model.pt", tmp_path / "out"], "--resume")):
        train_in(tmp_path / "out", clip)
    assert {f.name: f.read_bytes() for f in (tmp_path / "out").iterdir()} == before


PREDICT, TRAIN = ["predict", "{clip}/clip.avi", "--out", "p.csv"], ["train", "{clip}/clip.avi", "--out", "o"]
NETWORK, LABELS = ["--model", "{model}"], ["--labels", "{clip}/labels.csv"]


@pytest.mark.parametrize(
    ("args", "expected"),
    [
        (["predict", "{clip}/labels.csv", "--out", "p.csv", *NETWORK], ("labels.csv", "video", "cannot be decoded")),
        ([*PREDICT, "--model", "{clip}"], ("--model", "file", "no file ", "recon train")),
        ([*PREDICT, "--model", "{clip}/labels.csv"], ("labels.csv", "model", "torch cannot read", "recon train")),
        ([*PREDICT[:2], *NETWORK, "--out", "p.txt"], ("--out", "file", "'p.txt'", "ends in .csv or .h5")),
        ([*PREDICT, *NETWORK, "--device", "tpu"], ("--device", "device", "'tpu'", "one of: auto")),
        ([*TRAIN, *LABELS, "--steps", "0"], ("--steps", "steps", "'0'", "1 or more")),
        ([*TRAIN, *LABELS, "--first-frame", "9"], ("clip.avi", "frames", f"{FRAMES} decodable", "--first-frame")),
        ([*TRAIN, "--labels", "{clip}/no.csv"], ("no.csv", "file", "no such file")),
    ],
)
def test_bad_input_gives_one_message_and_no_files(args, expected, clip, whole, quick, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused([a.format(clip=clip, model=whole) for a in args], expected)
    assert list(tmp_path.iterdir()) == []


def test_every_missing_input_is_reported(clip, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    missing = ("o/checkpoint.pt", "checkpoint", "no such file")
    refused(["train", clip, "--out", "o", "--resume"], (clip, "label files", "none", "labeled-data"), missing)
    assert list(tmp_path.iterdir()) == []


def test_the_learning_rate_warms_up_and_falls_to_almost_zero_twice():
    shares = np.linspace(0, 1, 501)
    rates = np.array([schedule(s) for s in shares])
    assert rates[0] < 0.05
    assert rates.max() == pytest.approx(1, abs=0.02)
    assert shares[rates.argmax()] <= 0.05
    assert rates[-1] < 0.002
    rises = shares[1:][(np.diff(rates) > 0) & (shares[1:] > 0.06)]
    assert len(rises) == 1  # the rate rises once, to half the first rate, when the last part begins
    assert rates[shares < train_module.FINISH_FRACTION][-1] < 0.01
    assert rates[shares >= train_module.FINISH_FRACTION][0] == pytest.approx(0.5, abs=0.01)


def test_a_missing_torch_is_reported_with_the_command_to_install_it(clip, monkeypatch, tmp_path):
    import sys

    monkeypatch.setitem(sys.modules, "torch", None)
    ended = run("predict", clip / "clip.avi", "--model", clip, "--out", tmp_path / "p.csv")
    assert ended.code == 2
    assert f"torch: {install_command('net')}" in ended.err
