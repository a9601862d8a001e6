"""Test skeletons that are drafted from the 3D keypoints of an animal with legs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from recon.animal.body import Body
from recon.animal.skeleton_file import load_skeleton
from recon.api.skeleton_draft import draft_from_points

FPS = 50.0


@pytest.fixture(scope="module")
def rat() -> tuple[tuple[str, ...], np.ndarray]:
    """Return names and points (T, K, 3), metres, of a rat that walks 0.4 m."""
    body, t = load_skeleton("rat"), np.arange(80) / FPS
    assert isinstance(body, Body)
    random = np.random.default_rng(0)
    phases, rates = random.uniform(0, 2 * np.pi, len(body.mean_rad)), random.uniform(1.0, 4.0, len(body.mean_rad))
    states = np.zeros((len(t), body.n_state))
    states[:, 4:] = body.mean_rad + 0.4 * body.sigma_rad * np.sin(2 * np.pi * t[:, None] * rates + phases)
    states[:, 4:6] = body.mean_rad[:2]
    states[:, 0] = 0.25 * t
    return body.markers, body.tree.pose(states).points_m


def body_of(names, points_m: np.ndarray, folder: Path) -> Body:
    path = folder / "mine.toml"
    path.write_text(draft_from_points(names, points_m, FPS, "mine", Path("clip.csv"))[1], encoding="utf-8")
    body = load_skeleton(path)
    assert isinstance(body, Body)
    return body


def test_a_draft_has_a_trunk_that_goes_forward_and_legs(rat, tmp_path):
    names, points_m = rat
    body = body_of(names, points_m, tmp_path)
    assert body.forward[0] == "tail_base"
    assert body.forward[1] in ("neck_base", "nose")
    assert set(body.feet_by_label()) == {"LF", "RF", "LH", "RH"}
    assert all(foot.startswith(f"{label[0].lower()}_") for label, foot in body.feet_by_label().items())
    root = body.tree.segments[0].name
    assert not any(part in root for part in ("knee", "ankle", "paw"))
    length_m = np.linalg.norm(points_m[:, :, None] - points_m[:, None], axis=-1).max(axis=(1, 2)).mean()
    assert 0.025 * length_m < body.marker_sigma_m < 0.035 * length_m


def test_the_path_shows_the_front_if_names_do_not(rat, tmp_path):
    _, points_m = rat
    names = [f"point{k}" for k in range(points_m.shape[1])]
    body = body_of(names, points_m, tmp_path)
    rear, front = (points_m[:, names.index(name)].mean(axis=0) for name in body.forward)
    assert front[0] > rear[0] + 0.02


def test_a_draft_has_the_joints_that_bent_while_the_animal_moved(rat, tmp_path):
    names, points_m = rat
    standing_m = np.repeat(points_m[:1], 2 * len(points_m), axis=0)
    body = body_of(names, np.concatenate([standing_m, points_m]), tmp_path)
    of_segment: dict[str, list[int]] = {}
    for marker in body.tree.markers:
        of_segment.setdefault(marker.segment, []).append(names.index(marker.name))
    bodies_m = [points_m[:, points] for points in of_segment.values()]
    changes_m = [np.linalg.norm(part[:, :, None] - part[:, None], axis=-1).std(axis=0).max() for part in bodies_m]
    assert len(body.tree.segments) > 8
    assert max(changes_m) < 0.01
