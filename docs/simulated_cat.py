"""A simulated cat: two cameras see four runs, with a detector's noise, gaps and gross errors. Needs my-cat.toml."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

import recon
from recon.io.deeplabcut import write_csv
from recon.testing.gallop import add_noise

FPS, FRAMES = 100.0, np.arange(40)
file = recon.load_skeleton("my-cat.toml")
rng = np.random.default_rng(1)

# The cat: factors on the file's lengths, and angles (rad) on top of the file's expected pose.
LENGTHS = {"fore": 0.85, "hind": 0.9, "neck": 1.15, "tail": 0.85}
TRUNK = 1.1
CROUCH = {
    "fore_upper": 0.25,
    "fore_lower": -0.4,
    "hind_thigh": -0.25,
    "hind_shin": 0.45,
    "hind_foot": -0.2,
    "neck": -0.3,
}
# In step with the stride: legs swing to and fro, and fold while they swing forwards; the rest sways.
SWINGS = {"fore_upper": 0.4, "hind_thigh": 0.4}
FOLDS = {"fore_lower": -0.7, "fore_foot": 1.0, "hind_shin": 0.6, "hind_foot": -0.6}
PHASES = {"l_fore": 0.0, "r_hind": 0.3, "r_fore": np.pi, "l_hind": np.pi + 0.3}
SWAY = rng.normal(0, 0.1, (file.n_state, 2))


def of_cat(item, part):
    factor = next((f for name, f in LENGTHS.items() if name in part), TRUNK)
    return replace(item, offset_m=tuple(factor * x for x in item.offset_m))


segments = tuple(of_cat(s, s.parent or "") for s in file.tree.segments)
markers = tuple(of_cat(m, m.segment) for m in file.tree.markers)
cat = replace(file, tree=replace(file.tree, segments=segments, markers=markers))


def trot():
    """Positions (frames, markers, 3) in metres: z up, the ground at 0."""
    time_s = (FRAMES - FRAMES.mean()) / FPS
    stride = 2 * np.pi * (rng.uniform(2.3, 2.8) * time_s + rng.uniform())
    states = np.zeros((len(FRAMES), cat.n_state))
    states[:, 0] = 1.3 * time_s
    states[:, 3] = rng.normal(0, 0.15)  # its heading
    for i, name in list(enumerate(cat.state_names))[4:]:
        part = name.rsplit("_", 1)[0].removeprefix("l_").removeprefix("r_")
        leg = stride + PHASES.get(name[:6], 0.0)
        wave = SWINGS.get(part, 0.0) * np.sin(leg) + FOLDS.get(part, 0.0) * np.maximum(-np.cos(leg), 0)
        if name[:6] not in PHASES:
            beat = 2 * stride if name.endswith("pitch") else stride
            wave = SWAY[i, 0] * np.sin(beat) + SWAY[i, 1] * np.cos(beat)
        states[:, i] = cat.mean_rad[i - 4] + CROUCH.get(part, 0.0) + rng.normal(1, 0.15) * wave
    points_m = cat.tree.pose(states).points_m
    feet = [cat.markers.index(foot) for foot in cat.feet]
    return points_m - [0, 0, np.median(points_m[:, feet, 2].min(axis=1))]


def camera(name, place_m):
    ahead = np.array([0, 0, 0.2]) - place_m
    ahead /= np.linalg.norm(ahead)
    right = np.cross(ahead, [0, 0, 1]) / np.linalg.norm(np.cross(ahead, [0, 0, 1]))
    R = np.stack([right, np.cross(ahead, right), ahead])
    matrix = np.array([[1700.0, 0, 639.5], [0, 1700, 359.5], [0, 0, 1]])
    return recon.Camera(name, matrix, np.zeros(4), "fisheye", (1280, 720), R, -R @ place_m)


cameras = [camera("cam1", [0.3, -4.0, 1.0]), camera("cam2", [3.4, -2.4, 1.2])]
entries = [
    {"name": c.name, "k": c.matrix.tolist(), "d": [0, 0, 0, 0], "r": c.rotation.tolist(), "t": c.translation_m.tolist()}
    for c in cameras
]
Path("scene.json").write_text(json.dumps({"camera_resolution": [1280, 720], "cameras": entries}))

for run in range(1, 5):
    points_m = trot()
    write_csv(recon.Pose3D(cat.markers, points_m, FRAMES), Path(f"run{run}_truth.csv"))
    for seed, c in enumerate(cameras):
        xy_px, seen = c.project(c.world_to_camera(points_m))
        exact = recon.Keypoints(cat.markers, xy_px, seen.astype(float), FRAMES, image_size_px=c.image_size_px)
        noisy, _ = add_noise(exact, sigma_px=3, dropout=0.15, outlier=0.03, seed=10 * run + seed)
        write_csv(noisy, Path(f"run{run}_{c.name}.csv"))
