"""Draw a video of a simulated cheetah, for tests that need a video with known ground truth.

The video shows shaded limbs with a spotted coat, and textured ground with the animal's shadow. Motion blur and sensor
noise are added.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from recon.base.arrays import Array, Integers
from recon.geometry.camera import Camera
from recon.io.camera_files import write_camera
from recon.io.video import Image, video_writer
from recon.testing.files import write_keypoints, write_labels, write_truth
from recon.testing.gallop import SyntheticClip, project_clip, whole_gallop

Colour = tuple[float, float, float]

# Markers at both ends of each body part of `cheetah-24`, radii at both ends, and offset below the markers, in metres.
_LEG = (("knee", 0.075, 0.05), ("ankle", 0.045, 0.028), ("paw", 0.028, 0.03))
PARTS: tuple[tuple[str, str, float, float, float], ...] = (
    ("tail_base", "tail1", 0.035, 0.03, 0.0),
    ("tail1", "tail2", 0.03, 0.025, 0.0),
    ("spine", "tail_base", 0.15, 0.13, 0.1),
    ("neck_base", "spine", 0.16, 0.16, 0.11),
    ("neck_base", "head", 0.1, 0.075, 0.03),
    ("head", "nose", 0.075, 0.035, 0.0),
)
COAT, SPOT, BELLY = (70.0, 130.0, 185.0), (30.0, 50.0, 75.0), (140.0, 180.0, 210.0)
SKY, HAZE, SAND, SHRUB = (205.0, 165.0, 120.0), (215.0, 205.0, 195.0), (105.0, 150.0, 180.0), (50.0, 90.0, 85.0)
"""Colours (blue, green, red) of sky, haze, sand and shrubs."""
EXPOSURE = 0.4
"""Exposure time of the video as a fraction of the time between two frames."""
EXPOSURES = 5
"""Number of moments drawn during the exposure, whose mean is the picture."""
NOISE = 2.5
"""Standard deviation of the sensor noise in grey levels from 0 to 255."""
LIGHT = np.array([-0.35, 0.25, 0.9])
"""Direction towards the sun in the world."""
_SHIFT = 4

FPS = 120
"""Frame rate of the video in Hz."""
FRAMES = 90
"""Number of frames of the video."""
LABELLED = 40
"""Number of labelled frames of the video."""
SIZE_PX = (640, 360)
FOCAL_PX = 640.0
"""Focal length of the video's camera in pixels."""
DISTANCE_M = 11.5
"""Distance of the video's camera from the animal's path in metres."""
HEIGHT_M = 1.7
"""Height of the video's camera above the ground in metres."""


def render_frames(
    points_m: Array, names: tuple[str, ...], camera_at: Callable[[float], Camera], ground_m: float, seed: int = 0
) -> Iterator[Image]:
    """Draw a picture of each frame of a video of the cheetah.

    Parameters
    ----------
    points_m
        Positions (T, J, 3) of the markers in the world, in metres.
    names
        Names of the J markers of `cheetah-24`.
    camera_at
        Function from a time, in frames, to the camera. For a static camera, it always returns the same object.
    ground_m
        Height of the ground in metres.
    seed
        Seed of the ground and the coat, which are the same for any camera.

    Yields
    ------
    Image
        One picture (height, width, 3) in blue, green, red per frame, exposed symmetrically about the frame's time.
    """
    rng = np.random.default_rng(seed)
    drawn_camera = camera_at(0)
    scene = draw_scene(drawn_camera, ground_m, rng)
    spots = {part[:2]: _spots(rng) for part in _parts()}
    for t in range(len(points_m)):
        total = np.zeros_like(scene)
        for fraction in (np.arange(EXPOSURES) - (EXPOSURES - 1) / 2) * EXPOSURE / EXPOSURES:
            camera = camera_at(t + fraction)
            if camera is not drawn_camera:
                drawn_camera, scene = camera, draw_scene(camera, ground_m, np.random.default_rng(seed))
            total += _draw_animal(scene, _between(points_m, t + fraction), names, camera, ground_m, spots)
        noisy = total / EXPOSURES + rng.normal(0, NOISE, scene.shape)
        yield np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def _parts() -> list[tuple[str, str, float, float, float]]:
    """Return all parts of the body in the form of `PARTS`, including the parts of the legs."""
    parts = list(PARTS)
    for side in "lr":
        for leg, root in (("front", "shoulder"), ("back", "hip")):
            above = f"{side}_{root}"
            for joint, upper, lower in _LEG:
                below = f"{side}_{leg}_{joint}"
                parts.append((above, below, upper * (1.25 if leg == "back" else 1.0), lower, 0.0))
                above = below
    return parts


def _between(points_m: Array, t: float) -> Array:
    """Interpolate points (T, ...) linearly at a fractional frame number `t`, or extrapolate beyond the ends."""
    a = min(max(math.floor(t), 0), len(points_m) - 2)
    return points_m[a] + (t - a) * (points_m[a + 1] - points_m[a])


def draw_scene(camera: Camera, ground_m: float, rng: np.random.Generator) -> Array:
    """Draw a picture (height, width, 3) of the sky, shrubs on the horizon, and sand that gets finer with distance."""
    width, height = camera.image_size_px
    x, y = np.meshgrid(np.arange(width, dtype=float), np.arange(height, dtype=float))
    rays, _ = camera.rays(np.stack([x, y], axis=-1).reshape(-1, 2))
    assert camera.rotation is not None
    world = (rays @ camera.rotation).reshape(height, width, 3)
    world = world / np.linalg.norm(world, axis=2, keepdims=True)
    eye = camera.centre_world
    down = np.minimum(world[..., 2], -1e-4)
    distance = (ground_m - eye[2]) / down
    below = world[..., 2] < -2e-3
    at = (eye[:2] + world[..., :2] * np.minimum(distance, 500.0)[..., None]).astype(np.float32)
    grain = np.zeros(below.shape)
    for cell_m, weight in ((0.05, 0.3), (0.17, 0.5), (0.6, 0.8), (2.5, 1.0), (9.0, 0.8)):
        grain += weight * _noise(rng, at, cell_m)
    haze = np.clip(distance / 150, 0, 0.8)[..., None]
    ground = np.array(SAND) * (1 + 0.11 * grain)[..., None]
    ground = ground * (1 - haze) + np.array(HAZE) * haze
    up = np.clip(world[..., 2], 0, 1)[..., None]
    sky = np.array(HAZE) + (np.array(SKY) - np.array(HAZE)) * np.sqrt(np.clip(up * 2.5, 0, 1))
    scene = np.where(below[..., None], ground, sky)
    bearing = np.arctan2(world[..., 1], world[..., 0]).astype(np.float32)
    crown = np.stack([bearing * 300, world[..., 2].astype(np.float32) * 300], axis=-1)
    shrubs = _noise(rng, crown, 2.0) + 0.7 * _noise(rng, crown, 6.0) > 25 * np.abs(world[..., 2] - 0.01) * 6 - 0.3
    shade = 0.8 + 0.25 * _noise(rng, crown, 0.8)
    return np.where(
        (shrubs & (np.abs(world[..., 2] - 0.01) < 0.04))[..., None], np.array(SHRUB) * shade[..., None], scene
    )


def _noise(rng: np.random.Generator, points: NDArray[np.float32], cell: float) -> Array:
    """Return smooth noise with mean 0, standard deviation about 1 and grain size `cell` at points (h, w, 2)."""
    table = np.pad(rng.standard_normal((256, 256)).astype(np.float32), (0, 1), mode="wrap")
    index = np.mod(points / cell, 256).astype(np.float32)
    return np.asarray(cv2.remap(table, index[..., 0], index[..., 1], cv2.INTER_LINEAR), float) * 1.5


def _spots(rng: np.random.Generator) -> Array:
    """Draw random spots (n, 3), each with a position along a part (0 to 1) and across it (-1 to 1), and a size."""
    return np.column_stack([rng.uniform(0.03, 0.97, 22), rng.uniform(-0.8, 0.6, 22), rng.uniform(0.012, 0.022, 22)])


def _draw_animal(
    scene: Array,
    points_m: Array,
    names: tuple[str, ...],
    camera: Camera,
    ground_m: float,
    spots: dict[tuple[str, ...], Array],
) -> Array:
    marker = dict(zip(names, points_m, strict=True))
    marker["head"] = 0.5 * (marker["l_eye"] + marker["r_eye"])
    parts = []
    for part in _parts():
        ends = np.stack([marker[part[0]], marker[part[1]]])
        ends[:, 2] -= part[4]
        parts.append((float(np.mean(camera.world_to_camera(ends)[:, 2])), ends, part))
    picture = _draw_shadow(scene, [(ends, part) for _, ends, part in parts], camera, ground_m)
    canvas = np.clip(picture, 0, 255).astype(np.uint8)
    nearest = min(depth for depth, _, _ in parts)
    for depth, ends, part in sorted(parts, key=lambda p: -p[0]):
        shade = 1.0 - 0.45 * min(1.0, (depth - nearest) / 0.35)  # so that the far legs are darker
        _draw_part(canvas, ends, part, camera, shade, spots[part[:2]])
    return canvas.astype(float)


def _draw_part(
    canvas: Image, ends: Array, part: tuple[str, str, float, float, float], camera: Camera, light: float, spots: Array
) -> None:
    """Draw a body part, in layers from its dark outline to a bright line near the top, with spots."""
    at_camera = camera.world_to_camera(ends)
    xy, _ = camera.project(at_camera)
    focal = camera.matrix[0, 0]
    radius = np.array(part[2:4]) * focal / at_camera[:, 2]
    along = xy[1] - xy[0]
    length = max(float(np.linalg.norm(along)), 1e-6)
    across = np.array([-along[1], along[0]]) / length
    if across[1] > 0:
        across = -across  # `across` points towards the top of the picture
    layers = 6
    for i in range(layers):
        fraction = i / (layers - 1)
        colour = np.array(COAT) * (0.5 + 0.75 * fraction)
        if "tail" not in part[0]:
            colour = colour + (np.array(BELLY) - colour) * 0.25 * (1 - fraction)
        shift = 0.35 * fraction * radius[:, None] * across
        _capsule(canvas, xy + shift, radius * (1 - 0.75 * fraction), colour * light)
    for u, v, size in spots:
        r = radius[0] + (radius[1] - radius[0]) * u
        if size * focal / at_camera[0, 2] < 0.6 * r:
            centre = xy[0] + u * along + v * r * across
            _disc(canvas, centre, max(0.6, size * focal / at_camera[0, 2]), np.array(SPOT) * light)


def _draw_shadow(
    scene: Array, parts: list[tuple[Array, tuple[str, str, float, float, float]]], camera: Camera, ground_m: float
) -> Array:
    # A shadow seen at a grazing angle is flat, so the shadow is drawn upright on a taller canvas, which is then
    # compressed.
    steep = abs(camera.centre_world[2] - ground_m) / float(np.mean([camera.world_to_camera(e)[:, 2] for e, _ in parts]))
    tall = np.zeros((round(scene.shape[0] / steep) + 1, scene.shape[1]), np.uint8)
    for ends, part in parts:
        at_camera = camera.world_to_camera(ends - ((ends[:, 2:] - ground_m) / LIGHT[2]) * LIGHT)
        xy, _ = camera.project(at_camera)
        radius = np.array(part[2:4]) * camera.matrix[0, 0] / at_camera[:, 2]
        _capsule(tall, xy * [1, 1 / steep], radius, np.array([255.0]))
    mask = cv2.resize(tall, scene.shape[1::-1], interpolation=cv2.INTER_AREA)
    soft = cv2.GaussianBlur(mask, (0, 0), 1.2).astype(float)[..., None] / 255
    return scene * (1 - 0.55 * soft)


def _capsule(canvas: Image, xy: Array, radius: Array, colour: Array) -> None:
    """Draw a limb as two filled discs and the filled quadrilateral between them."""
    along = xy[1] - xy[0]
    across = np.array([-along[1], along[0]]) / max(float(np.linalg.norm(along)), 1e-6)
    corners = np.stack(
        [xy[0] + across * radius[0], xy[1] + across * radius[1], xy[1] - across * radius[1], xy[0] - across * radius[0]]
    )
    cv2.fillConvexPoly(
        canvas, np.rint(corners * 2**_SHIFT).astype(np.int32), tuple(colour.tolist()), cv2.LINE_AA, _SHIFT
    )
    for centre, r in zip(xy, radius, strict=True):
        _disc(canvas, centre, float(r), colour)


def _disc(canvas: Image, centre: Array, radius: float, colour: Array) -> None:
    x, y = np.rint(centre * 2**_SHIFT).astype(int).tolist()
    cv2.circle(canvas, (x, y), max(1, round(radius * 2**_SHIFT)), tuple(colour.tolist()), -1, cv2.LINE_AA, _SHIFT)


@dataclass(frozen=True)
class PanningFilm:
    """Clip filmed by a camera that turns to follow the animal."""

    clip: SyntheticClip
    """Clip with the turning camera's keypoints, and the ground truth in the world frame of the camera's track.

    In this frame z is up. The camera, which has no pose in the clip, is at the origin. In the first frame it looks
    along y and `tilt_deg` downwards.
    """
    rotations: Array
    """Rotation R_camera_world in each frame, shape (T, 3, 3)."""
    tilt_deg: float
    """Angle in degrees by which the camera looks down in the first frame."""


def film_clip() -> tuple[SyntheticClip, float]:
    """Return a clip filmed by a static camera, and the height of the ground in metres."""
    clip, _ = whole_gallop(FPS, FRAMES)
    paws = [i for i, name in enumerate(clip.names) if name.endswith("paw")]
    ground_m = float(np.quantile(clip.truth_m[:, paws, 2], 0.02)) - 0.03
    middle = 0.5 * (clip.truth_m[0].mean(axis=0) + clip.truth_m[-1].mean(axis=0))
    centre = np.array([middle[0], middle[1] - DISTANCE_M, ground_m + HEIGHT_M])
    ahead = np.array([middle[0], middle[1], ground_m + 0.75]) - centre
    ahead = ahead / np.linalg.norm(ahead)
    right = np.array([1.0, 0.0, 0.0])
    rotation = np.stack([right, np.cross(ahead, right), ahead])
    matrix = np.array([[FOCAL_PX, 0, (SIZE_PX[0] - 1) / 2], [0, FOCAL_PX, (SIZE_PX[1] - 1) / 2], [0, 0, 1]])
    camera = Camera("film", matrix, np.zeros(0), "pinhole", SIZE_PX, rotation, -rotation @ centre)
    return replace(clip, keypoints=project_clip(camera, clip), camera=camera), ground_m


def labelled_frames() -> Integers:
    """Return the frame numbers of the video's labelled frames, which are evenly spaced."""
    return np.linspace(0, FRAMES - 1, LABELLED).round().astype(int)


def write_film(folder: Path, clip: SyntheticClip, pictures: Iterable[Image]) -> None:
    """Write a video (rendered.mp4) with its camera, labels, keypoints and ground truth into an existing folder."""
    with video_writer(folder / "rendered.mp4", SIZE_PX, FPS) as write:
        for picture in pictures:
            write(picture)
    write_camera(clip.camera, folder / "rendered_camera.toml")
    write_labels(clip.keypoints, labelled_frames(), folder / "rendered_labels.csv")
    write_keypoints(clip.keypoints, folder / "rendered_points.csv", decimals=2)
    write_truth(clip, folder / "rendered_truth.csv", decimals=4)


def panning_film(clip: SyntheticClip, camera_at: Callable[[float], Camera]) -> PanningFilm:
    """Return a clip as filmed by a camera that turns.

    Parameters
    ----------
    clip
        Clip of a static camera.
    camera_at
        Function from a time in frames to the camera, as returned by `recon.testing.cameras.panning_camera`.

    Returns
    -------
    PanningFilm
        Detections and truth in the world of the camera's track.
    """
    moving = _project_moving(clip, camera_at)
    rotations = np.stack([np.asarray(camera_at(t).rotation) for t in range(len(moving.truth_m))])
    forward = rotations[0, 2]
    to_track = Rotation.from_euler("z", np.arctan2(forward[0], forward[1])).as_matrix()
    moving = replace(
        moving,
        camera=replace(clip.camera, rotation=None, translation_m=None),
        truth_m=(clip.truth_m - clip.camera.centre_world) @ to_track.T,
    )
    return PanningFilm(moving, rotations @ to_track.T, float(np.degrees(np.arcsin(-forward[2]))))


def _project_moving(clip: SyntheticClip, camera_at: Callable[[float], Camera]) -> SyntheticClip:
    """Return the clip with the detections of the turning camera in each frame."""
    keypoints = clip.keypoints
    xy_px = np.empty(keypoints.xy_px.shape)
    for t, points_m in enumerate(clip.truth_m):
        camera = camera_at(t)
        xy, valid = camera.project(camera.world_to_camera(points_m))
        xy_px[t] = np.where((valid & camera.in_image(xy))[:, None], xy, np.nan)
    return replace(clip, keypoints=replace(keypoints, xy_px=xy_px, confidence=np.isfinite(xy_px[..., 0]).astype(float)))
