"""Test the stated uncertainty for animals whose skeleton was drafted from a clip.

    python benchmarks/parts/drafted_coverage.py [--only rat dog] [--cameras 1 2 6] [--clips 4] [--skeleton rat]

A recorded rat (rat-poses) and dog (dog-mocap of $RECON_SHARED_DATA, or of ../shared/data) are seen by simulated
cameras. The skeleton is drafted from an earlier part of a recording, triangulated from four cameras, or is a built-in
skeleton (for the rat: --skeleton). A later part is fitted from one, two and six cameras. The table has the fractions of
joints whose pose and position are inside the stated 90 % regions, and their errors in mm. Keypoints have 2 px of noise
and a constant bias, whose standard deviation along each axis is 2.5 % of the body's length.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import dog
import numpy as np
import pandas as pd
from arguments import parser_of
from left_out_camera import in_trunk, seen_by
from markdown_table import print_table
from recordings import rat_poses, recordings

from recon import Body, InputError, load_skeleton
from recon.animal.prior import prior_from_body
from recon.api.skeleton_draft import draft_from_points
from recon.clip import View
from recon.fit.clip_problem import TrajectoryOptions
from recon.fit.trajectory import solve_trajectory
from recon.fit.triangulation import triangulate_views
from recon.testing.cameras import camera_ring
from recon.testing.coverage import coverage

BIAS_SHARE = 0.025
"""Standard deviation of the simulated keypoint bias along each axis, as a fraction of the body's length."""
FRAMES = 60
"""Number of frames of each fitted clip."""
RAT_DRAFT = 500
"""Number of frames of the rat's recording from which its skeleton is drafted."""
RAT_NAMES = {"Snout": "nose", "EarL": "l_ear", "EarR": "r_ear", "SpineF": "neck_base", "SpineM": "spine"}
RAT_NAMES |= {"SpineL": "lower_back", "TailBase": "tail_base"}
for _side in "LR":
    _prefix = _side.lower()
    RAT_NAMES |= {f"Shoulder{_side}": f"{_prefix}_shoulder", f"Elbow{_side}": f"{_prefix}_front_knee"}
    RAT_NAMES |= {f"Wrist{_side}": f"{_prefix}_front_ankle", f"Hand{_side}": f"{_prefix}_front_paw"}
    RAT_NAMES |= {f"Hip{_side}": f"{_prefix}_hip", f"Knee{_side}": f"{_prefix}_back_knee"}
    RAT_NAMES |= {f"Ankle{_side}": f"{_prefix}_back_ankle", f"Foot{_side}": f"{_prefix}_back_paw"}


@dataclass(frozen=True, eq=False)
class Recording:
    """Points (T, K, 3), metres, of a clip and of earlier frames from which a skeleton is drafted; z is up."""

    animal: str
    name: str
    names: Sequence[str]
    points_m: np.ndarray
    past_m: np.ndarray
    fps: float
    length_m: float
    trunk: tuple[str, str]


def rats() -> Iterator[Recording]:
    names, points_m = rat_poses()
    past_m = points_m[:RAT_DRAFT]
    for first in range(RAT_DRAFT + 20, len(points_m) - FRAMES, 2 * FRAMES):
        part_m = points_m[first : first + FRAMES]
        yield Recording("rat", f"rat+{first}", names, part_m, past_m, 50.0, 0.2, ("SpineL", "SpineF"))


def dogs() -> Iterator[Recording]:
    for clip in dog.read_clips(recordings("dog-mocap")):
        first = len(clip.points_m) - FRAMES
        if first >= 2 * FRAMES:
            points_m = clip.points_m[first:], clip.points_m[: first - 20]
            yield Recording("dog", clip.name, clip.names, *points_m, clip.fps, 0.8, ("Hips", "Neck"))


def biased(recording: Recording, points_m: np.ndarray, offsets_m: np.ndarray) -> np.ndarray:
    """Shift the recorded points by offsets (K, 3) in the frame of the trunk's heading, metres."""
    rear, front = (recording.names.index(name) for name in recording.trunk)
    return points_m + in_trunk(points_m, (rear, front), offsets_m)


def drafted_body(recording: Recording, points_m: np.ndarray) -> Body:
    """Return the skeleton drafted from points (T, K, 3); raise InputError if no skeleton follows from them."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drafted.toml"
        _, text = draft_from_points(recording.names, points_m, recording.fps, recording.animal, Path("clip.csv"))
        path.write_text(text, encoding="utf-8")
        body = load_skeleton(path)
    assert isinstance(body, Body)
    return body


def row(recording: Recording, cameras: int, skeleton: str | None, seed: int) -> dict[str, float | str] | None:
    random = np.random.default_rng(seed)
    offsets_m = random.normal(0, BIAS_SHARE * recording.length_m, (len(recording.names), 3))
    names, middle_m = list(recording.names), recording.points_m.mean(axis=(0, 1)) * (1, 1, 0)
    ring = camera_ring(max(cameras, 4), recording.length_m, random)
    if skeleton is None:
        past_m = biased(recording, recording.past_m, offsets_m) - recording.past_m.mean(axis=(0, 1)) * (1, 1, 0)
        past = [seen_by(camera, past_m, random) for camera in ring[:4]]
        body = drafted_body(recording, triangulate_views(past).points_m)
    else:
        body, names = load_skeleton(skeleton), [RAT_NAMES.get(name, name) for name in names]
        assert isinstance(body, Body)
    step = len(ring) // cameras if cameras > 2 else 1
    detected_m = biased(recording, recording.points_m, offsets_m) - middle_m
    seen = [seen_by(camera, detected_m, random) for camera in ring[::step][:cameras]]
    order = [names.index(marker) if marker in names else -1 for marker in body.markers]
    views = [view_of_markers(view, order) for view in seen]
    solution = solve_trajectory(
        views, body, prior_from_body(body), recording.fps, TrajectoryOptions(fast=True), ground_near_zero=True
    )
    known = np.array(order) >= 0
    off_m = (solution.joints_m - (recording.points_m - middle_m)[:, order])[:, known]
    if not np.isfinite(off_m).all():
        return None
    centred_m = off_m - off_m.mean(axis=1, keepdims=True)
    return {
        "animal": recording.animal,
        "cameras": cameras,
        "pose mm": 1000 * float(np.linalg.norm(centred_m, axis=-1).mean()),
        "position mm": 1000 * float(np.linalg.norm(off_m.mean(axis=1), axis=-1).mean()),
        "pose inside": coverage(centred_m, solution.relative_covariance_m2[:, known], 0.9),
        "position inside": coverage(off_m, solution.covariance_m2[:, known], 0.9),
        "stated mm": 1000 * float(np.sqrt(np.trace(solution.relative_covariance_m2, axis1=2, axis2=3)).mean()),
        "trunk forward": float(is_forward(recording, body, solution.joints_m)),
        "legs": len(body.feet),
    }


def view_of_markers(view: View, order: Sequence[int]) -> View:
    """Return a view whose keypoints are the body's markers; `order` has each marker's keypoint, -1 for none."""
    known = np.array(order) >= 0
    xy_px = np.where(known[:, None], view.xy_px[:, order], np.nan)
    return replace(view, xy_px=xy_px, confidence=np.where(known, view.confidence[:, order], 0.0))


def is_forward(recording: Recording, body: Body, joints_m: np.ndarray) -> bool:
    """Return whether the body's forward direction agrees with the recorded trunk to within 45 degrees."""
    rear, front = (body.markers.index(marker) for marker in body.forward)
    ahead_m = (joints_m[:, front] - joints_m[:, rear])[:, :2]
    first, last = (recording.names.index(name) for name in recording.trunk)
    trunk_m = (recording.points_m[:, last] - recording.points_m[:, first])[:, :2]
    cosine = np.sum(ahead_m * trunk_m, axis=1) / np.linalg.norm(ahead_m, axis=1) / np.linalg.norm(trunk_m, axis=1)
    return bool(np.median(cosine) > np.cos(np.pi / 4))


def main() -> None:
    parser = parser_of(__doc__, only=("rat", "dog"))
    parser.add_argument("--cameras", type=int, nargs="+", default=[1, 2, 6])
    parser.add_argument("--clips", type=int, default=4)
    parser.add_argument("--skeleton")
    given = parser.parse_args()
    rows = []
    for animal, recorded in (("rat", rats), ("dog", dogs)):
        if animal not in given.only or not recordings(f"{animal}-{'poses' if animal == 'rat' else 'mocap'}").is_dir():
            continue
        for seed, recording in enumerate([*recorded()][: given.clips]):
            for cameras in given.cameras:
                try:
                    values = row(recording, cameras, given.skeleton, seed)
                except InputError as error:
                    print(recording.name, cameras, str(error).splitlines()[-1])
                    continue
                if values is not None:
                    rows.append(values)
                    print(
                        recording.name, {k: round(v, 2) for k, v in values.items() if isinstance(v, float)}, flush=True
                    )
    if not rows:
        parser.exit(message="no recordings: nothing measured\n")
    table, cells = pd.DataFrame(rows), []
    for animal in table["animal"].unique():
        for cameras in given.cameras:
            part = table[(table["animal"] == animal) & (table["cameras"] == cameras)]
            lengths = [f"{part[name].mean():.0f}" for name in ("pose mm", "stated mm", "position mm")]
            shares = [f"{part[name].mean():.0%}" for name in ("pose inside", "position inside", "trunk forward")]
            cells.append([animal, cameras, len(part), *lengths, *shares, f"{part['legs'].mean():.0f}"])
    head = ["animal", "cameras", "clips", "pose mm", "stated mm", "position mm", "pose inside", "position inside"]
    print_table([*head, "trunk forward", "legs"], cells)


if __name__ == "__main__":
    main()
