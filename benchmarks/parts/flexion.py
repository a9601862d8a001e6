"""Measure errors of anatomical joint angles on simulated gallops and a dog's motion capture, with one or two cameras.

    python benchmarks/parts/flexion.py [FOLDER] [--cameras 1] [--seeds 4] [--only gallops|dogs]

FOLDER is by default the dog-mocap of $RECON_SHARED_DATA, or of ../shared/data; without it, only the gallops are used.
The second camera is 40 degrees to the side of the first. The gallops have the noise that the skeleton states: each
keypoint has a bias over the whole clip, and jitters. The dog's clips have a detector's noise and the dog's own
proportions. For each joint and for all joints, the script prints the RMS error, the stated standard deviation (root
mean square) and the fraction of frames inside the 90 % band. It also prints how often the intervals of the greatest and
the least angle over the stride, and of their phases, contain the true values.
"""

from __future__ import annotations

import argparse
import tempfile
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from dog import SKELETON, read_clips, side_view, write_view
from markdown_table import print_table
from recordings import recordings

from recon.animal.anatomy import FLEXES_CAUDALLY, GIRDLE, joint_and_side
from recon.animal.body import Body
from recon.api.clip import fit_clip
from recon.api.settings import FitSettings
from recon.fit.motion import Motion
from recon.fit.regions import radius
from recon.gait.clip import ClipAnalysis
from recon.gait.flexion import JointFlexion, extreme, joint_flexions, stride_curves
from recon.gait.stances import INTERVAL
from recon.geometry.camera import Camera
from recon.io.camera_files import write_camera
from recon.testing.files import write_keypoints
from recon.testing.gallop import project_clip, whole_gallop

JITTER_PX = 3.0
DEG = np.pi / 180
DOG_CLIPS = (("walk00", 250), ("walk01", 800), ("walk02", 660), ("walk03", 300), ("walk04", 300), ("run00", 340))
"""Name of each clip, and the first of the `DOG_FRAMES` frames that are used, in which the dog moves."""
DOG_FRAMES = 200
TURN = np.array([[np.cos(40 * DEG), -np.sin(40 * DEG), 0], [np.sin(40 * DEG), np.cos(40 * DEG), 0], [0, 0, 1]])
"""Rotation of the world about the vertical between the first camera and the second."""
PAIRS = {"cheetah-24": ("l_hip", "l_shoulder"), "dog-27": ("LeftUpLeg", "LeftArm")}
"""Left markers of the hind and the fore girdle. Together with the right markers, they define the sagittal plane."""


def true_flexion(body: Body, points_m: np.ndarray) -> np.ndarray:
    """Return the flexion (A, T) of the joints from the true markers (T, J, 3) alone, rad."""
    at = {marker: points_m[:, i] for i, marker in enumerate(body.markers)}
    rear, front = body.forward
    forward = at[front] - at[rear]
    angles = []
    for name, (above, middle, below) in body.anatomy.items():
        joint = joint_and_side(name)[0]
        left_marker = PAIRS[body.name][GIRDLE[joint] != "H"]
        right_marker = left_marker.replace("l_", "r_").replace("Left", "Right")
        left = at[left_marker] - at[right_marker]
        left = left - np.sum(left * forward, axis=1, keepdims=True) / np.sum(forward**2, axis=1)[:, None] * forward
        left /= np.linalg.norm(left, axis=1, keepdims=True)
        proximal, distal = at[middle] - at[above], at[below] - at[middle]
        flat = [link - np.sum(link * left, axis=1, keepdims=True) * left for link in (proximal, distal)]
        angle = np.arctan2(np.sum(np.cross(*flat) * left, axis=1), np.sum(flat[0] * flat[1], axis=1))
        angles.append(FLEXES_CAUDALLY[joint] * angle)
    return np.array(angles)


def displaced_camera(camera: Camera, middle_m: np.ndarray, turn: np.ndarray = TURN) -> Camera:
    """Return the camera displaced as if the world turned by `turn` (3, 3) about a point (3,), metres."""
    assert camera.rotation is not None
    assert camera.translation_m is not None
    offset_m = camera.rotation @ (middle_m - turn @ middle_m)
    return replace(camera, rotation=camera.rotation @ turn, translation_m=camera.translation_m + offset_m)


def gallops(seeds: int, folder: Path, cameras: int) -> Iterator[tuple[Motion, np.ndarray]]:
    """Fit the simulated gallop with different noise, and yield each fit with the true markers (T, J, 3), metres."""
    clip, _ = whole_gallop()
    middle_m = clip.truth_m.mean(axis=(0, 1))
    views = [clip.camera, displaced_camera(clip.camera, middle_m)][:cameras]
    keypoints, files = (tuple(folder / f"{view}.{ending}" for view in range(cameras)) for ending in ("csv", "toml"))
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        for camera, csv, toml in zip(views, keypoints, files, strict=True):
            exact = project_clip(camera, clip)
            per_m = camera.matrix[0, 0] / float(np.linalg.norm(camera.centre_world - middle_m))
            offsets = rng.normal(0, 0.04 * per_m, exact.xy_px.shape[1:])
            xy_px = exact.xy_px + offsets + rng.normal(0, JITTER_PX, exact.xy_px.shape)
            write_keypoints(replace(exact, xy_px=xy_px), csv, decimals=2)
            write_camera(camera, toml)
        yield fit_clip(FitSettings(keypoints=keypoints, camera=files, fps=60)), clip.truth_m


def dogs(recorded: Path, folder: Path, cameras: int) -> Iterator[tuple[Motion, np.ndarray]]:
    """Fit the dog's clips from one or two cameras, and yield each fit with the true markers (T, J, 3), metres."""
    clips = {clip.name: clip for clip in read_clips(recorded)}
    for name, first in DOG_CLIPS:
        clip = replace(clips[name], points_m=clips[name].points_m[first : first + DOG_FRAMES])
        settings, _ = write_view(clip, folder, 0, SKELETON)
        if cameras == 2:
            middle_m = np.nanmean(clip.points_m, axis=(0, 1))
            turned = replace(clip, name=f"{name}-2", points_m=(clip.points_m - middle_m) @ TURN.T + middle_m)
            write_view(turned, folder, 1, SKELETON)
            write_camera(displaced_camera(side_view(turned)[0], middle_m), folder / f"{turned.name}.toml")
            names = clip.name, turned.name
            keypoints, files = (tuple(folder / f"{view}.{ending}" for view in names) for ending in ("csv", "toml"))
            settings = replace(settings, keypoints=keypoints, camera=files, camera_name=names)
        motion = fit_clip(settings)
        yield motion, clip.markers(motion.body)


def print_errors(fits: Iterator[tuple[Motion, np.ndarray]]) -> None:
    """Print the angle errors of each joint and of all joints, and how often intervals of extremes contain the truth."""
    errors, sigmas = defaultdict[str, list[np.ndarray]](list), defaultdict[str, list[np.ndarray]](list)
    values, phases = list[bool](), list[bool]()
    for motion, truth_m in fits:
        flexions, true_flexions = joint_flexions(motion), list[JointFlexion]()
        for flexion, truth in zip(flexions, true_flexion(motion.body, truth_m), strict=True):
            known = np.isfinite(flexion.angle_rad)
            off = np.mod(flexion.angle_rad - truth + np.pi, 2 * np.pi) - np.pi
            true_flexions.append(replace(flexion, angle_rad=flexion.angle_rad - off))
            for joint in (flexion.joint, "all"):
                errors[joint].append(np.degrees(off[known]))
                sigmas[joint].append(np.degrees(flexion.sigma_rad[known]))
        gait = ClipAnalysis(motion).gait
        pairs = (stride_curves(angles, gait, motion.time_s) for angles in (flexions, true_flexions))
        for curve, true_curve in zip(*pairs, strict=True):
            for sign in (1, -1):
                stated, true = extreme(curve, sign), extreme(true_curve, sign)
                values.append(abs(stated.value_rad - true.value_rad) < radius(INTERVAL) * stated.sigma_rad)
                if np.isfinite(stated.percent_high):
                    turns = true.percent + np.array([-100, 0, 100])
                    phases.append(bool(((stated.percent_low <= turns) & (turns <= stated.percent_high)).any()))
    rows = list[list[str]]()
    for joint in errors:
        error, sigma = np.concatenate(errors[joint]), np.concatenate(sigmas[joint])
        inside = np.mean(np.abs(error) < radius(INTERVAL) * sigma)
        rms = (f"{np.sqrt(np.mean(values_deg**2)):.1f}" for values_deg in (error, sigma))
        rows.append([joint, *rms, f"{100 * inside:.0f}"])
    head = ("joint", "RMS error °", "stated °", "inside 90 % band, %")
    rows.sort(key=lambda row: row[0] == "all")
    print_table(head, rows)
    if values:
        held = f"{np.mean(values):.0%} of {len(values)} greatest and least angles over the stride"
        print(
            f"\nThe 90 % intervals hold {held}, and {np.mean(phases):.0%} of the {len(phases)} phases that are known."
        )


def main() -> None:
    """Print the errors of joint angles in simulated gallops and in the dog's clips."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path, default=recordings("dog-mocap"))
    parser.add_argument("--cameras", type=int, choices=(1, 2), default=1)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--only", choices=("gallops", "dogs"))
    given = parser.parse_args()
    seen = "one camera" if given.cameras == 1 else "two cameras"
    with tempfile.TemporaryDirectory() as name:
        if given.only != "dogs":
            print(f"\n### {given.seeds} simulated gallops, {seen}\n")
            print_errors(gallops(given.seeds, Path(name), given.cameras))
        if given.only != "gallops" and given.folder is not None:
            print(f"\n### A dog, {len(DOG_CLIPS)} clips, {seen}\n")
            print_errors(dogs(given.folder, Path(name), given.cameras))


if __name__ == "__main__":
    main()
