"""Test networks with two stages, which find large animals in small pictures and refine points at full size."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import refusal
from later import needs_torch, torch
from networks import narrow_networks

from recon.io.video import video_writer
from recon.keypoint_net import network, pictures
from recon.keypoint_net.network import (
    FORMAT,
    MODEL_FILE,
    Spec,
    TrainedNetwork,
    load_model,
    load_torch,
    part_of,
    run_prediction,
)
from recon.keypoint_net.pictures import network_scales
from recon.keypoint_net.settings import LabelSource, TrainSettings
from recon.keypoint_net.train import CHECKPOINT_FILE, run_training

pytestmark = needs_torch

SIZE, FRAMES = (160, 96), 12
NAMES = ("nose", "l_paw", "r_paw")
SETTINGS = TrainSettings(steps=8, batch=2, seed=3, mirror=True)
BRIEF = replace(SETTINGS, steps=2)


@pytest.fixture
def no_report(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip the training report, except the sentences about threads."""
    monkeypatch.setattr(
        "recon.keypoint_net.train.write_training_report",
        lambda run, state, folder: {"threads": state.threads},
    )


class Killed(Exception):
    pass


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Make networks narrow, and treat an animal of 24 px as large."""
    narrow_networks(monkeypatch)
    monkeypatch.setattr(pictures, "NETWORK_LENGTH_PX", 15.0)


@pytest.fixture(scope="module")
def clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a clip of three discs with different colours, and labels for every frame."""
    folder = tmp_path_factory.mktemp("clip")
    y, x = np.mgrid[: SIZE[1], : SIZE[0]]
    rows = ["scorer" + ",me" * 6, "bodyparts," + ",".join(n for n in NAMES for _ in "xy"), "coords" + ",x,y" * 3]
    with video_writer(folder / "clip.avi", SIZE, 25.0) as write:
        for frame in range(FRAMES):
            picture = np.full((SIZE[1], SIZE[0], 3), 110, np.uint8)
            points = np.array([[30.0, 30], [22, 48], [40, 52]]) + np.array([8 * frame, 0])
            for k, (px, py) in enumerate(points):
                picture[(x - px) ** 2 + (y - py) ** 2 < 16] = 255 * np.eye(3)[k]
            write(picture)
            rows.append(f"labeled-data/clip/{frame:03d}.png," + ",".join(f"{v:.1f}" for v in points.ravel()))
    (folder / "labels.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder


def train_in(
    out: Path, clip: Path, threads: int | None = 1, settings: TrainSettings = SETTINGS, **options: object
) -> dict:
    source = LabelSource(data=clip / "clip.avi", labels=clip / "labels.csv")
    return run_training(source, settings, out, device="cpu", threads=threads, **options)  # pyright: ignore


def test_small_animals_have_one_stage_and_large_animals_two():
    box = np.array([[[0.0, 0.0], [3, 4]]])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pictures, "NETWORK_LENGTH_PX", 120.0)
        assert network_scales(box * 24) == (1.0, 1.0)
        assert network_scales(box * 34) == (pytest.approx(120 / 170, abs=1e-3), 1.0)
        assert network_scales(box * 90) == (1.0, pytest.approx(120 / 450, abs=1e-3))
        full, first = network_scales(box * 400)
        assert full == pytest.approx(480 / 2000)
        assert full * first * 2000 == pytest.approx(120, rel=0.01)
        assert network_scales(np.full((1, 2, 2), np.nan)) == (1.0, 1.0)


@pytest.mark.slow
def test_two_stages_from_labels_to_points(clip, tmp_path):
    # Points are predicted in pixels of the clip, and a run that is killed and resumed has the same weights.
    def stop(stage: str, share: float) -> None:
        if share >= 0.8:
            raise Killed

    report = train_in(tmp_path / "whole", clip)
    assert report["scale"] == 1
    assert report["first_stage_scale"] < 0.7
    with pytest.raises(Killed):
        train_in(tmp_path / "broken", clip, progress=stop)
    train_in(tmp_path / "broken", clip, threads=None, resume=True)
    one, other = (load_torch(tmp_path / name / MODEL_FILE) for name in ("whole", "broken"))
    assert one["spec"] == other["spec"]
    assert len(one["spec"]["calibration"]) == 2
    assert all(torch.equal(w, other["weights"][name]) for name, w in one["weights"].items())
    assert {name.partition(".")[0] for name in one["weights"]} == {"first", "second"}
    found = run_prediction(clip / "clip.avi", tmp_path / "whole", tmp_path / "p.csv", device="cpu", threads=1)
    assert np.isfinite(found.xy_px).all()
    assert (found.xy_px > -10).all()
    assert (found.xy_px < 170).all()


@pytest.mark.slow
@pytest.mark.usefixtures("no_report")
def test_a_run_with_one_stage_is_not_resumed_with_two(clip, tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "NETWORK_LENGTH_PX", 30.0)
    train_in(tmp_path, clip, settings=BRIEF)
    assert (tmp_path / CHECKPOINT_FILE).is_file()
    monkeypatch.setattr(pictures, "NETWORK_LENGTH_PX", 15.0)
    with refusal((tmp_path / CHECKPOINT_FILE, "network", "another version", "--overwrite")):
        train_in(tmp_path, clip, resume=True, settings=BRIEF)
    assert load_model(tmp_path, torch.device("cpu")).spec.first == 1


@pytest.mark.usefixtures("no_report")
def test_a_network_of_version_0_2_is_read(clip, tmp_path, monkeypatch):
    monkeypatch.setattr(pictures, "NETWORK_LENGTH_PX", 30.0)
    train_in(tmp_path, clip, settings=BRIEF)
    content = load_torch(tmp_path / MODEL_FILE)
    del content["spec"]["first"], content["spec"]["calibration"]
    of_old = {"slope": 0.5, "offset": 0.1, "points": 9}
    content["spec"] |= {"partner": (0, 2, 1), "mirrored": True, "calibrations": {"fast": of_old, "best": of_old}}
    torch.save(content, tmp_path / MODEL_FILE)
    spec = load_model(tmp_path, torch.device("cpu")).spec
    assert not spec.two_stages
    assert spec.calibration == (0.5, 0.1)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("names", "tensor"),
        ("names", ["a"] * 1001),
        ("scale", -1.0),
        ("scale", 1e9),
        ("first", 0.0),
    ],
)
def test_a_network_with_an_impossible_description_is_refused(field, value, tmp_path):
    value = torch.zeros(1).expand(10**10) if value == "tensor" else value
    spec = {"names": ["nose"], "scale": 0.5, "body_length_px": 300.0, "tolerance_px": 9.0, field: value}
    torch.save({"format": FORMAT, "spec": spec, "weights": {}}, tmp_path / MODEL_FILE)
    with refusal((tmp_path / MODEL_FILE, field)):
        load_model(tmp_path, torch.device("cpu"))


def bright_stage() -> Any:
    """Return a stage of a network whose scores are highest at bright pixels."""

    class Stage(torch.nn.Module):
        def forward(self, x: Any) -> Any:
            return 60.0 * x[:, :1, ::4, ::4]

    return Stage()


def test_the_second_stage_searches_near_the_points_of_the_first():
    # Both stages find the brightest spot. A smaller, brighter spot is too far away for the second stage.
    picture = np.full((200, 400, 3), 100, np.uint8)
    y, x = np.mgrid[:200, :400]
    for at, level, radius in (((305.5, 97.5), 210, 6), ((60, 50), 250, 3)):
        picture[(x - at[0]) ** 2 + (y - at[1]) ** 2 <= radius**2] = level
    spec = Spec(("point",), 1.0, 400.0, 16.0, 0.25)
    network = torch.nn.ModuleDict({"first": bright_stage(), "second": bright_stage()})
    xy, _ = TrainedNetwork(spec, network, torch.device("cpu")).points([picture, picture], None)
    np.testing.assert_allclose(xy[:, 0], [[305.5, 97.5]] * 2, atol=2.0)


def test_the_part_contains_the_likely_points():
    xy = np.array([[[100.0, 100], [140, 120], [900, 10]], [[400.0, 380], [500, 470], [0, 0]]])
    raw = np.array([[0.9, 0.8, 0.01], [0.9, 0.8, 0.01]])
    low, size = part_of(xy, raw, 10.0, (640, 480))
    assert size == (128, 128)
    assert low.tolist() == [[56, 46], [386, 352]]
    assert part_of(xy, np.ones((2, 3)), 10.0, (640, 480))[1] == (640, 480)
    low, size = part_of(xy[:1], 0.01 * raw[:1], 10.0, (640, 480))
    assert size == (32, 32)
    assert low.tolist() == [[84, 84]]


@pytest.mark.slow
@pytest.mark.usefixtures("no_report")
def test_the_number_of_threads_is_all_or_given_and_kept_on_resume(clip, tmp_path, monkeypatch):
    taken = []
    # Several threads slow down tests that run at the same time.
    monkeypatch.setattr("torch.set_num_threads", taken.append)
    monkeypatch.setattr("torch.get_num_threads", lambda: taken[-1])
    monkeypatch.setattr(network, "available_cores", lambda: 2)
    assert train_in(tmp_path, clip, threads=None, settings=BRIEF)["threads"] == 2
    monkeypatch.setattr(network, "available_cores", lambda: 1)
    assert train_in(tmp_path, clip, threads=None, settings=BRIEF, resume=True)["threads"] == 2
    assert train_in(tmp_path, clip, threads=1, settings=BRIEF, overwrite=True)["threads"] == 1
