"""Test wrong inputs that look correct, and measure their effect on the result and the findings.

    python benchmarks/parts/wrong_inputs.py [--jobs 2] [--cases mirrored,follows] [--views 4] [--csv TABLE.csv]

Every view of the cheetah-runs and plate-trials of $RECON_SHARED_DATA, or of ../shared/data, is fitted like `recon fit`
with each of `CASES` put into its files or settings. Cases of two cameras use each pair of a run's cameras. --views n
uses every n-th view only. Errors are in the world of the camera file, and pose errors are centred. A case whose name
begins with "right" is a correct input. The columns are:

- doubled: clips whose error in pose or position is at least twice the error of the same clip with the correct input
- named: clips in which a finding states the cause, or something equally true of the wrong input
- wrong cause named: clips with a finding of `CAUSES` that is wrong, and that the clip with the correct input lacks
- beyond the bound: an error is above the upper end of the stated interval
- in the camera's frame: errors relative to the clip and the camera from which the keypoints really come, which is all
  that one camera can show

--findings prints the findings of each case, and the findings on a horse that is fitted as a cheetah (the horse-side of
the same folder).
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import tempfile
import tomllib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from arguments import parser_of, runs_of
from markdown_table import print_table
from recordings import camera_of, meta_of, recordings, truth_at

from recon import Camera, FitSettings, InputError, Motion, fit_clip, read_keypoints
from recon.animal.body import other_side
from recon.base.documents import builtin_file
from recon.clip import Keypoints
from recon.io.camera_files import write_cameras
from recon.io.deeplabcut import write_csv
from recon.testing.coverage import coverage

EITHER = ("upside_down", "turned_either_way")
"""Codes of findings on a contradiction that several causes can explain."""
CAUSES = {
    *(
        "frames_dropped",
        "detections_frozen",
        "detections_repeated",
        "detections_interpolated",
        "detections_curved",
        "far_side_copied",
        "same_keypoints",
    ),
    *("missing_as_constant", "keypoints_normalised", "keypoints_y_up", "picture_upside_down", "picture_turned"),
    *("world_not_z_up", "smaller_video", "other_camera_named", "another_camera_fits", "left_right_swap"),
    *(
        "frame_rate_stated",
        "frame_rate",
        "animal_still",
        "time_reversed",
        "treadmill",
        "camera_moves",
        "camera_unit",
        "subject_unlike_species",
    ),
    *("cameras_apart_in_time", "cameras_exchanged", "cameras_disagree", "camera_turned", "camera_late", "camera_off"),
    *(
        "picture_zooms",
        "keypoints_undistorted",
        "halves_apart",
        "picture_stretched",
        "focal_length",
        *EITHER,
        "pose_inverted",
    ),
}
"""Codes of findings that state the cause of a wrong input."""
BOUNDS = {"pose_mm": "pose bound_mm", "position_m": "position bound_m"}
"""Column of the upper end of the stated interval for each error."""
SWAPS = ("left_right_swap", "left_right_swap_possible")
OFF = ("cameras_disagree", "cameras_exchanged", "cameras_out_of_step", "size_unexpected", "pair_disagrees")
MISPLACED = (*OFF, "pair_refined")


@dataclass(frozen=True, eq=False)
class Seen:
    """Run and camera that really recorded some keypoints, and the delay of their frame numbers."""

    run: Path
    camera: Camera
    later: int = 0


@dataclass(frozen=True, eq=False)
class Given:
    """Content of a camera's input files, and its relation to the truth."""

    keypoints: Keypoints
    camera: Camera
    frame: Callable[[np.ndarray], np.ndarray] = lambda frames: frames
    """Function that converts frames of the clip to frames of the truth."""
    R: np.ndarray = field(default_factory=lambda: np.eye(3))
    t: np.ndarray = field(default_factory=lambda: np.zeros(3))
    """Translation to the world of the camera file, metres: x' = R x + t for a point x of the truth."""
    settings: dict[str, Any] = field(default_factory=dict)
    """Settings of the fit that the change replaces."""
    origin: Seen | None = None
    """Real origin of the keypoints, or None if they come from this camera."""

    @property
    def xy_px(self) -> np.ndarray:
        return self.keypoints.xy_px

    @property
    def size_px(self) -> np.ndarray:
        return np.array(self.camera.image_size_px)

    def seen(self, xy_px: np.ndarray, frames: np.ndarray | None = None, **more: Any) -> Given:
        """Replace the keypoints by other points, px, with a confidence of 1."""
        frames = self.keypoints.frames if frames is None else frames
        confidence = np.where(np.isfinite(xy_px[..., 0]), 1.0, 0.0)
        keypoints = replace(self.keypoints, xy_px=xy_px, confidence=confidence, frames=frames)
        return replace(self, keypoints=keypoints, **more)

    def moved(self, R: np.ndarray | None = None, t: Sequence[float] | np.ndarray = (0, 0, 0)) -> Given:
        """Express the camera in another world, in which a point x is at R x + t (metres)."""
        R, t_m = np.eye(3) if R is None else R, np.asarray(t, dtype=float)
        assert self.camera.rotation is not None
        assert self.camera.translation_m is not None
        turned = self.camera.rotation @ R.T
        camera = replace(self.camera, rotation=turned, translation_m=self.camera.translation_m - turned @ t_m)
        return replace(self, camera=camera, R=R, t=t_m)

    def turned(self, by: np.ndarray, shift_m: Sequence[float] = (0, 0, 0)) -> Given:
        """Displace the camera by a rotation and a shift in its own frame."""
        assert self.camera.rotation is not None
        assert self.camera.translation_m is not None
        camera = replace(
            self.camera, rotation=by @ self.camera.rotation, translation_m=by @ self.camera.translation_m + shift_m
        )
        return replace(self, camera=camera)


@dataclass(frozen=True, eq=False)
class Clip:
    """A clip of one or two cameras of a run."""

    run: Path
    cameras: tuple[str, ...]

    @property
    def meta(self) -> dict[str, Any]:
        return meta_of(self.run)

    @property
    def others(self) -> list[str]:
        return [name for name in cameras_of(self.run) if name not in self.cameras]

    @property
    def rng(self) -> np.random.Generator:
        return np.random.default_rng(sum(map(ord, self.run.name + self.cameras[0])))

    def camera(self, name: str) -> Camera:
        return replace(camera_of(self.run, name), name=name)

    def given(self, name: str) -> Given:
        keypoints = replace(read_keypoints(self.run / f"{name}.csv"), fps=self.meta["fps"])
        return Given(keypoints, self.camera(name))


def cameras_of(run: Path) -> list[str]:
    return [f"cam{number}" for number in meta_of(run)["cameras"]]


Change = Callable[[Clip, Given], Given]
"""Function that changes the input of the only camera, or of the second of two cameras."""


@dataclass(frozen=True)
class Case:
    """A wrong input, or a correct one if its name begins with "right"."""

    change: Change
    codes: tuple[str, ...] = ()
    """Codes of the findings that state this input."""
    two: bool = False
    """Whether the case needs clips of two cameras."""
    both: bool = False
    """Whether to change the first of two cameras as well."""
    whole_file: bool = False
    """Whether the camera file has all cameras of the run, and the given camera is chosen by its name."""


def about(axis: str, degrees: float) -> np.ndarray:
    angle, (i, j) = np.radians(degrees), {"x": (1, 2), "y": (2, 0), "z": (0, 1)}[axis]
    turn = np.eye(3)
    turn[[i, i, j, j], [i, j, i, j]] = np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)
    return turn


def sides(names: Sequence[str], part: str = "") -> list[int]:
    return [names.index(other_side(n)) if part in n and other_side(n) in names else i for i, n in enumerate(names)]


def other_only_camera(clip: Clip, given: Given) -> Given:
    return replace(given, camera=clip.given(clip.others[0]).camera)


def other_renamed(clip: Clip, given: Given) -> Given:
    camera = replace(clip.given(clip.others[0]).camera, name=given.camera.name)
    return replace(given, camera=camera, origin=Seen(clip.run, given.camera))


def cropped(clip: Clip, given: Given) -> Given:
    low = np.nanpercentile(given.xy_px.reshape(-1, 2), 2, axis=0)
    return given.seen(given.xy_px - np.clip(low - 60, 0, None))


def focal(factor: float) -> Change:
    return lambda clip, given: replace(
        given, camera=replace(given.camera, matrix=given.camera.matrix * ([factor, factor, 1.0] * np.ones((3, 1))))
    )


def transposed(clip: Clip, given: Given) -> Given:
    return replace(given, camera=replace(given.camera, rotation=np.asarray(given.camera.rotation).T))


def scaled(x: float, y: float) -> Change:
    """Return a change that scales the picture by the factors `x` and `y` about its middle."""

    def change(clip: Clip, given: Given) -> Given:
        middle = (given.size_px - 1) / 2
        return given.seen(middle + (given.xy_px - middle) * [x, y])

    return change


def stabilised(clip: Clip, given: Given) -> Given:
    """Cut out a window of 1 / 1.15 of the picture that drifts by 2 % of its width, enlarged to the picture's size."""
    turns = np.linspace(0, 2 * np.pi, len(given.xy_px))[:, None]
    drift_px = 0.02 * given.size_px[0] * np.stack([np.sin(turns), np.cos(turns)], axis=-1)
    return scaled(1.15, 1.15)(clip, given.seen(given.xy_px + drift_px))


def labels_larger(clip: Clip, given: Given) -> Given:
    middle = np.nanmean(given.xy_px, axis=1, keepdims=True)
    return given.seen(middle + 1.15 * (given.xy_px - middle))


def half_of_second(*parts: str) -> Change:
    """Return a change that takes half of the keypoints from an animal that runs a tenth of a second behind."""

    def change(clip: Clip, given: Given) -> Given:
        late = max(round(0.1 * clip.meta["fps"]), 1)
        half = [i for i, name in enumerate(given.keypoints.names) if any(part in name for part in parts)]
        xy_px = given.xy_px.copy()
        xy_px[late:, half] = given.xy_px[:-late, half]
        return given.seen(xy_px)

    return change


hind_of_second = half_of_second("back", "hip", "tail")
fore_of_second = half_of_second("front", "shoulder", "nose", "eye", "neck")


def cubic(clip: Clip, given: Given) -> Given:
    from scipy.interpolate import CubicSpline

    xy_px, t = given.xy_px.copy(), np.arange(len(given.xy_px))
    for k in range(xy_px.shape[1]):
        knots = t[::8][np.isfinite(xy_px[::8, k, 0])]
        if len(knots) > 3:
            inside = (t >= knots[0]) & (t <= knots[-1])
            xy_px[inside, k] = CubicSpline(knots, given.xy_px[knots, k])(t[inside])
    return given.seen(xy_px)


def paws_on_shadow(clip: Clip, given: Given) -> Given:
    xy_px, paws = given.xy_px.copy(), [i for i, name in enumerate(given.keypoints.names) if name.endswith("paw")]
    extent = np.nanmedian(np.nanmax(xy_px[..., 1], axis=1) - np.nanmin(xy_px[..., 1], axis=1))
    xy_px[:, paws, 1] += 0.15 * extent
    return given.seen(xy_px)


def rolling(shutter_s: float) -> Change:
    """Return a change that takes the last row of the picture `shutter_s` seconds later than the first."""

    def change(clip: Clip, given: Given) -> Given:
        late = shutter_s * clip.meta["fps"] * given.xy_px[..., 1:] / given.size_px[1]
        return given.seen(given.xy_px + late * np.gradient(given.xy_px, axis=0))

    return change


def undistorted(clip: Clip, given: Given) -> Given:
    import cv2

    camera, xy_px = given.camera, given.xy_px.copy()
    known = np.isfinite(xy_px[..., 0])
    undistort = cv2.fisheye.undistortPoints if camera.model == "fisheye" else cv2.undistortPoints
    xy_px[known] = undistort(xy_px[known][:, None], camera.matrix, camera.distortion, P=camera.matrix)[:, 0]
    return given.seen(xy_px)


def pans(clip: Clip, given: Given) -> Given:
    along = np.linspace(-200, 200, len(given.xy_px))[:, None]
    return given.seen(given.xy_px - np.stack([along, 0 * along], axis=-1))


def path_of(given: Given) -> np.ndarray:
    """Return the smooth path (T, 2) of the animal in the picture, pixels."""
    middle, t = np.nanmedian(given.xy_px, axis=1), np.arange(len(given.xy_px))
    known = np.isfinite(middle[:, 0])
    return np.stack([np.polyval(np.polyfit(t[known], middle[known, i], 3), t) for i in (0, 1)], axis=1)


def follows(clip: Clip, given: Given) -> Given:
    return given.seen(given.xy_px - path_of(given)[:, None] + given.size_px / 2)


def belt_drifts(clip: Clip, given: Given) -> Given:
    """Simulate an animal on a belt that is as fast as the animal at first, and a fifth slower at the end."""
    path_px = path_of(given)
    slower = np.linspace(0, 0.2, len(path_px))[:, None]
    drift_px = np.cumsum(slower * np.gradient(path_px, axis=0), axis=0)
    return given.seen(given.xy_px + (drift_px - path_px + given.size_px / 2)[:, None])


def zooms(clip: Clip, given: Given) -> Given:
    centre = given.camera.matrix[:2, 2]
    return given.seen((given.xy_px - centre) * np.linspace(1, 1.5, len(given.xy_px))[:, None, None] + centre)


def frozen(clip: Clip, given: Given) -> Given:
    xy_px = given.xy_px.copy()
    xy_px[len(xy_px) // 2 :] = xy_px[len(xy_px) // 2]
    return given.seen(xy_px)


def interpolated(clip: Clip, given: Given) -> Given:
    t = np.arange(len(given.xy_px))
    columns = given.xy_px.reshape(len(t), -1).T
    return given.seen(np.stack([np.interp(t, t[::8], c[::8]) for c in columns], axis=1).reshape(given.xy_px.shape))


def doubled(clip: Clip, given: Given) -> Given:
    frames = np.arange(2 * len(given.xy_px)) + 2 * given.keypoints.frames[0]
    return given.seen(np.repeat(given.xy_px, 2, axis=0), frames, frame=lambda frames: frames // 2)


def far_from_near(clip: Clip, given: Given) -> Given:
    names = given.keypoints.names
    near = [names.index(other_side(n)) if n.startswith("r_") else i for i, n in enumerate(names)]
    return given.seen(given.xy_px[:, near])


def dropped(clip: Clip, given: Given) -> Given:
    numbers = given.keypoints.frames
    kept = np.sort(clip.rng.choice(len(numbers), int(0.75 * len(numbers)), replace=False))
    frames = numbers[0] + np.arange(len(kept))
    return given.seen(given.xy_px[kept], frames, frame=lambda frames: numbers[kept][frames - numbers[0]])


def missing_as(value: float) -> Change:
    def change(clip: Clip, given: Given) -> Given:
        missing = clip.rng.uniform(size=given.xy_px.shape[:2]) < 0.2
        return given.seen(np.where(missing[..., None], value, given.xy_px))

    return change


def still(clip: Clip, given: Given) -> Given:
    xy_px = np.repeat(given.xy_px[len(given.xy_px) // 2][None], len(given.xy_px), axis=0)
    return given.seen(xy_px + clip.rng.normal(0, 1, xy_px.shape))


def backwards(clip: Clip, given: Given) -> Given:
    both = int(given.keypoints.frames[0] + given.keypoints.frames[-1])
    return given.seen(given.xy_px[::-1], frame=lambda frames: both - frames)


def in_unit(per_m: float) -> Change:
    def change(clip: Clip, given: Given) -> Given:
        assert given.camera.translation_m is not None
        return replace(given, camera=replace(given.camera, translation_m=per_m * given.camera.translation_m))

    return change


def from_other_clip(clip: Clip, given: Given) -> Given:
    """Take the keypoints of the next run of the same kind, from a camera with the same picture size, if any."""
    runs = runs_of(clip.run.parent)
    for run in runs[runs.index(clip.run) + 1 :] + runs[: runs.index(clip.run)]:
        for name in cameras_of(run):
            other = Clip(run, (name,)).given(name)
            if other.camera.image_size_px == given.camera.image_size_px:
                T = min(len(other.xy_px), len(given.xy_px))
                origin = Seen(run, other.camera, int(other.keypoints.frames[0] - given.keypoints.frames[0]))
                return given.seen(other.xy_px[:T], given.keypoints.frames[:T], origin=origin)
    return given


def from_other_camera(clip: Clip, given: Given) -> Given:
    other = clip.given(clip.others[0])
    xy_px, later = other.xy_px[: len(given.xy_px)], int(other.keypoints.frames[0] - given.keypoints.frames[0])
    origin = Seen(clip.run, other.camera, later)
    return given.seen(xy_px, given.keypoints.frames[: len(xy_px)], origin=origin)


def shuffled(clip: Clip, given: Given) -> Given:
    return given.seen(given.xy_px[clip.rng.permutation(len(given.xy_px))])


def gross_outliers(share: float) -> Change:
    def change(clip: Clip, given: Given) -> Given:
        rng, xy_px = clip.rng, given.xy_px.copy()
        wrong = rng.uniform(size=xy_px.shape[:2]) < share
        xy_px[wrong] = rng.uniform((0, 0), given.size_px, (int(wrong.sum()), 2))
        return given.seen(xy_px)

    return change


def swapped(part: str, rows: Callable[[int], slice]) -> Change:
    def change(clip: Clip, given: Given) -> Given:
        xy_px, where = given.xy_px.copy(), rows(len(given.xy_px))
        xy_px[where] = xy_px[where][:, sides(given.keypoints.names, part)]
        return given.seen(xy_px)

    return change


def at_rate(factor: float) -> Change:
    return lambda clip, given: replace(given, settings={"fps": factor * clip.meta["fps"]})


def half_rate_of_one(clip: Clip, given: Given) -> Given:
    frames = given.keypoints.frames[::2]
    return given.seen(given.xy_px[::2], np.arange(len(frames)) + frames[0] // 2)


def same_twice(clip: Clip, given: Given) -> Given:
    return replace(given, keypoints=replace(clip.given(clip.cameras[0]).keypoints, source=given.keypoints.source))


def without(share: float) -> Change:
    """Return a change that removes a fraction of the detections."""

    def change(clip: Clip, given: Given) -> Given:
        gone = clip.rng.uniform(size=given.xy_px.shape[:2]) < share
        return given.seen(np.where(gone[..., None], np.nan, given.xy_px))

    return change


def hidden(which: Callable[[str], bool]) -> Change:
    """Return a change that removes the keypoints whose names `which` selects, in all frames."""

    def change(clip: Clip, given: Given) -> Given:
        never = np.array([which(name) for name in given.keypoints.names])
        return given.seen(np.where(never[:, None], np.nan, given.xy_px))

    return change


def some_keypoints(count: int) -> Change:
    """Return a change that keeps `count` keypoints, chosen at random, and removes the others in all frames."""

    def change(clip: Clip, given: Given) -> Given:
        seen = clip.rng.choice(len(given.keypoints.names), count, replace=False)
        never = ~np.isin(np.arange(len(given.keypoints.names)), seen)
        return given.seen(np.where(never[:, None], np.nan, given.xy_px))

    return change


def lower_leg(name: str) -> bool:
    return name.endswith(("knee", "ankle", "paw"))


def middle(n: int) -> Change:
    """Return a change that keeps n frames from the middle."""

    def change(clip: Clip, given: Given) -> Given:
        part = slice((len(given.xy_px) - n) // 2, (len(given.xy_px) - n) // 2 + n)
        return given.seen(given.xy_px[part], given.keypoints.frames[part])

    return change


def beyond_edge(comes: bool) -> Change:
    """Return a change that removes the points beyond an edge, as if the animal came into the picture or left it.

    The edge is at the animal's middle after a quarter of the clip if `comes`, otherwise after three quarters.
    """

    def change(clip: Clip, given: Given) -> Given:
        x, t = np.nanmedian(given.xy_px[..., 0], axis=1), np.arange(len(given.xy_px))
        line = np.polyfit(t[np.isfinite(x)], x[np.isfinite(x)], 1)
        edge = np.polyval(line, len(t) // 4 if comes else 3 * len(t) // 4)
        gone = given.xy_px[..., 0] < edge if (line[0] > 0) == comes else given.xy_px[..., 0] > edge
        return given.seen(np.where(gone[..., None], np.nan, given.xy_px))

    return change


def lengths_15(clip: Clip, given: Given) -> Given:
    """Give the fit the animal's lengths multiplied by 1.5."""
    skeleton = tomllib.loads(builtin_file("animal/skeletons", "cheetah-24.toml").read_text())
    placed = {one["name"]: one["at_m"] for kind in ("segments", "markers") for one in skeleton[kind] if "at_m" in one}
    lines = "".join(
        f"{name} = {[1.5 * x for x in at]}\n" for name, at in placed.items() if name != skeleton["segments"][0]["name"]
    )
    head = 'skeleton = "cheetah-24"\ntitle = "an animal 1.5 times as long"\nsize_sigma = 0.02\n\n[at_m]\n'
    return replace(given, settings={"subject": head + lines})


UP = about("x", -90)
CASES = {
    "untouched": Case(lambda clip, given: given),
    "origin half a metre above the ground": Case(lambda c, g: g.moved(t=(0, 0, -0.5)), ("ground_elsewhere",)),
    "origin half a metre below the ground": Case(lambda c, g: g.moved(t=(0, 0, 0.5)), ("ground_elsewhere",)),
    "heights above the sea": Case(lambda c, g: g.moved(t=(0, 0, 100)), ("ground_elsewhere",)),
    "origin at the camera": Case(
        lambda c, g: g.moved(t=np.asarray(g.camera.rotation).T @ g.camera.translation_m), ("ground_elsewhere",)
    ),
    "only camera is another": Case(other_only_camera, ("other_camera_named",)),
    "the same, with this camera's name": Case(other_renamed, ("ground_elsewhere",)),
    "cropped video": Case(cropped, ("smaller_video", "ground_elsewhere")),
    **{f"focal length x {by:g}": Case(focal(by), ("focal_length",)) for by in (1.5, 0.7, 0.85, 1.1)},
    "anamorphic, x scaled by 0.75": Case(scaled(0.75, 1.0), ("picture_stretched",)),
    "anamorphic, x scaled by 1.33": Case(scaled(4 / 3, 1.0), ("picture_stretched",)),
    "letterboxed": Case(scaled(0.75, 0.75), ("smaller_video", "focal_length")),
    "stabiliser's crop": Case(stabilised),
    "turned 10 degrees sideways": Case(lambda c, g: g.turned(about("y", 10))),
    "labels 15 % too large": Case(labels_larger, ("size_unexpected", "ground_elsewhere")),
    "origin 0.3 m above the ground": Case(lambda c, g: g.moved(t=(0, 0, -0.3)), ("ground_elsewhere",)),
    "origin 0.3 m below the ground": Case(lambda c, g: g.moved(t=(0, 0, 0.3)), ("ground_elsewhere",)),
    "hind half of a second animal": Case(hind_of_second, ("halves_apart",)),
    "fore half of a second animal": Case(fore_of_second, ("halves_apart",)),
    "cubic through every 8th": Case(cubic, ("detections_curved",)),
    "paws on their shadow": Case(paws_on_shadow),
    "rolling shutter of 30 ms": Case(rolling(0.03)),
    "tilt 15 degrees": Case(lambda c, g: g.turned(about("x", 15)), ("ground_elsewhere",)),
    "undistorted, lens kept": Case(undistorted, ("keypoints_undistorted", "picture_zooms")),
    "pans by 400 px": Case(pans, ("camera_moves", "treadmill", "picture_zooms", "path_jolts")),
    "follows": Case(follows, ("treadmill", "camera_moves", "picture_zooms", "path_jolts")),
    "on a belt that slows down": Case(belt_drifts, ("treadmill", "camera_moves", "picture_zooms", "path_jolts")),
    "zooms x 1.5": Case(zooms, ("camera_moves", "picture_zooms", "path_jolts")),
    "frozen for half": Case(frozen, ("detections_frozen",)),
    "interpolated, every 8th": Case(interpolated, ("detections_interpolated",)),
    "every frame doubled": Case(doubled, ("detections_repeated",)),
    "far side copied": Case(far_from_near, ("far_side_copied",)),
    "a quarter of frames dropped": Case(dropped, ("frames_dropped", "picture_zooms", "path_jolts", "frame_rate")),
    "missing as (-1, -1)": Case(missing_as(-1.0), ("missing_as_constant",)),
    "missing as (0, 0)": Case(missing_as(0.0), ("missing_as_constant",)),
    "mirrored": Case(lambda c, g: g.seen([g.size_px[0] - 1, 0] + g.xy_px * [-1, 1]), SWAPS),
    "portrait": Case(
        lambda c, g: g.seen(np.stack([g.xy_px[..., 1], g.size_px[0] - 1 - g.xy_px[..., 0]], axis=-1)),
        ("picture_turned", "turned_either_way", "refused"),
    ),
    "y-up world": Case(lambda c, g: g.moved(R=UP), ("world_not_z_up", "turned_either_way")),
    "R transposed, T kept": Case(
        transposed, ("rotation_transposed", "pose_inverted", "turned_either_way", "upside_down", "refused")
    ),
    "still animal": Case(still, ("animal_still",)),
    "time reversed": Case(backwards, ("time_reversed",)),
    "unit mm": Case(in_unit(1000.0), ("camera_unit",)),
    "unit cm": Case(in_unit(100.0), ("camera_unit",)),
    "unit feet": Case(in_unit(3.28084), ("camera_unit", "ground_elsewhere")),
    "lengths x 1.5": Case(lengths_15, ("subject_unlike_species",)),
    "of another clip": Case(from_other_clip),
    "of another camera": Case(from_other_camera, ("other_camera_named", "ground_elsewhere")),
    "shifted by half the clip": Case(lambda c, g: g.seen(np.roll(g.xy_px, len(g.xy_px) // 2, axis=0))),
    "shuffled": Case(shuffled, ("gross_outliers",)),
    "30 % gross outliers": Case(gross_outliers(0.3), ("gross_outliers",)),
    "50 % gross outliers": Case(gross_outliers(0.5), ("gross_outliers",)),
    "70 % gross outliers": Case(gross_outliers(0.7), ("gross_outliers",)),
    "ten frames swapped": Case(swapped("", lambda T: slice(T // 2 - 5, T // 2 + 5)), SWAPS),
    "whole clip swapped": Case(swapped("", lambda T: slice(0, T)), SWAPS),
    "fore legs swapped": Case(swapped("front", lambda T: slice(T // 2, T)), SWAPS),
    "hind legs swapped": Case(swapped("back", lambda T: slice(T // 2, T)), SWAPS),
    **{f"frame rate x {by:.2g}": Case(at_rate(by), ("frame_rate",)) for by in (0.5, 0.6, 0.75, 4 / 3, 5 / 3, 2.0)},
    "y up in the picture": Case(
        lambda c, g: g.seen([0, g.size_px[1] - 1] + g.xy_px * [1, -1]), ("keypoints_y_up", *EITHER)
    ),
    "upside down": Case(lambda c, g: g.seen(g.size_px - 1 - g.xy_px), ("picture_upside_down", *EITHER)),
    "video of half the size": Case(lambda c, g: g.seen(g.xy_px / 2), ("smaller_video",)),
    "right: half missing": Case(without(0.5)),
    "right: a side hidden": Case(hidden(lambda name: name.startswith("r_"))),
    "right: a fore leg hidden": Case(hidden(lambda name: name.startswith("r_front") and lower_leg(name))),
    "right: lower legs hidden": Case(hidden(lower_leg)),
    "right: 16 of 24 keypoints": Case(some_keypoints(16)),
    "right: 12 of 24 keypoints": Case(some_keypoints(12)),
    "right: 15 frames": Case(middle(15)),
    "right: comes into the picture": Case(beyond_edge(True)),
    "right: leaves the picture": Case(beyond_edge(False)),
    "two cameras": Case(lambda clip, given: given, two=True),
    **{
        f"two, one turned by {degrees} degrees": Case(
            lambda c, g, by=degrees: g.turned(about("y", by)), MISPLACED, two=True
        )
        for degrees in (6, -6, 4, -4, 2, -2)
    },
    **{
        f"two, one moved by {x_m} m": Case(
            lambda c, g, by_m=x_m: g.turned(np.eye(3), (by_m, 0, 0)), MISPLACED, two=True
        )
        for x_m in (0.5, -0.5, 0.25, -0.25)
    },
    **{
        f"two, one late by {by} frames": Case(
            lambda c, g, by=by: replace(g, keypoints=replace(g.keypoints, frames=g.keypoints.frames + by)),
            ("camera_late", *OFF),
            two=True,
        )
        for by in (2, -2)
    },
    "two, both zoomed": Case(focal(1.15), OFF, two=True, both=True),
    "two, one of half the rate": Case(half_rate_of_one, (*OFF, "cameras_apart_in_time", "frame_rate"), two=True),
    "two, the same keypoints": Case(same_twice, (*OFF, "same_keypoints"), two=True),
}


PLAIN = {"untouched": False, "two cameras": True}
"""Cases without a change, and whether each has two cameras."""


def fitted(clip: Clip, case: Case, folder: Path) -> tuple[Motion, Given]:
    """Fit a clip with the change of a case, and return the motion and the changed input of the first camera.

    If the fit is refused, InputError is raised.
    """
    first, *rest = [clip.given(name) for name in clip.cameras]
    if case.both or not case.two:
        first = case.change(clip, first)
    given = [first, *(case.change(clip, one) for one in rest)]
    paths = [folder / f"{'clip' if case.whole_file else name}.csv" for name in clip.cameras]
    for one, path in zip(given, paths, strict=True):
        write_csv(replace(one.keypoints, fps=None), path)
    cameras = [one.camera for one in given]
    own_settings = dict(given[-1].settings)
    if case.whole_file:
        own_settings["camera_name"] = (given[0].camera.name,)
        cameras += [other for other in map(clip.camera, cameras_of(clip.run)) if other.name != given[0].camera.name]
    write_cameras(cameras, folder / "cameras.toml")
    if "subject" in own_settings:
        (folder / "subject.toml").write_text(own_settings["subject"])
        own_settings["subject"] = folder / "subject.toml"
    settings = {"keypoints": tuple(paths), "camera": folder / "cameras.toml", "fps": clip.meta["fps"]}
    return fit_clip(FitSettings(**settings | own_settings)), given[0]


def truth_on(clip: Clip, given: Given, motion: Motion) -> np.ndarray:
    return truth_at(clip.run, given.frame(motion.frames), motion.names) @ given.R.T + given.t


def errors(off_m: np.ndarray) -> tuple[float, float]:
    """Return the mean error of the pose (mm) and of the position (m) for joints with errors (T, J, 3), m."""
    centred = off_m - off_m.mean(axis=1, keepdims=True)
    return 1000 * float(np.linalg.norm(centred, axis=-1).mean()), float(
        np.linalg.norm(off_m.mean(axis=1), axis=-1).mean()
    )


def errors_in_camera(seen: Seen, motion: Motion) -> dict[str, float]:
    """Return the errors in the frame of the camera that really saw the keypoints, which is all one camera can show."""
    assert seen.camera.rotation is not None
    assert seen.camera.translation_m is not None
    truth_m = truth_at(seen.run, motion.frames + seen.later, motion.names)
    off_m = motion.joints_camera_m - truth_m @ seen.camera.rotation.T - seen.camera.translation_m
    off_m = off_m[np.isfinite(off_m).all(axis=(1, 2))]
    return dict(zip(("seen pose_mm", "seen position_m"), errors(off_m), strict=True)) if len(off_m) else {}


def measured(clip: Clip, given: Given, motion: Motion) -> dict[str, Any]:
    off_m = motion.joints_m - truth_on(clip, given, motion)
    off_m = off_m[np.isfinite(off_m).all(axis=(1, 2))]
    if not len(off_m):
        return {}
    known = motion.solved & np.isfinite(truth_on(clip, given, motion)).all(axis=(1, 2))
    centred, R = off_m - off_m.mean(axis=1, keepdims=True), motion.T_reference_world[:3, :3]
    solution = motion.solution
    pose_mm, position_m = errors(off_m)
    verdict = motion.verdict
    bounds = {}
    if verdict is not None and verdict.pose_m is not None and verdict.position_m is not None:
        bounds = {"pose bound_mm": 1000 * verdict.pose_m.high, "position bound_m": verdict.position_m.high}
    return bounds | {
        "pose_mm": pose_mm,
        "position_m": position_m,
        "pose in 90 %": coverage(centred, (R @ solution.relative_covariance_m2 @ R.T)[known], 0.9),
        "position in 90 %": coverage(off_m, (R @ solution.covariance_m2 @ R.T)[known], 0.9),
    }


def row(clip: Clip, name: str) -> dict[str, Any]:
    case, found = CASES[name], {"case": name, "run": clip.run.name, "camera": "+".join(clip.cameras)}
    with tempfile.TemporaryDirectory() as folder:
        try:
            motion, given = fitted(clip, case, Path(folder))
        except InputError:
            return found | {"codes": "refused", "level": "refused"}
    codes = [one.code for one in motion.findings if one.severity != "note" or one.code == "missing_as_constant"]
    assert motion.verdict is not None
    said = {"codes": " ".join(sorted({*codes})), "level": motion.verdict.level}
    seen = {} if given.origin is None else errors_in_camera(given.origin, motion)
    return found | measured(clip, given, motion) | seen | said


def rows_of(clip: Clip, names: Sequence[str]) -> list[dict[str, Any]]:
    return [row(clip, name) for name in names if CASES[name].two == (len(clip.cameras) == 2)]


def all_runs() -> list[Path]:
    """Return the folders of the runs of cheetahs with and without force plates."""
    return sorted(run for kind in ("cheetah-runs", "plate-trials") for run in runs_of(recordings(kind)))


def views() -> list[Clip]:
    """Return each camera of each run as a clip of its own."""
    return [Clip(run, (name,)) for run in all_runs() for name in cameras_of(run)]


def clips(every: int) -> Iterator[Clip]:
    """Yield one in `every` views, and one in `every` pairs of a run's cameras."""
    pairs = [Clip(run, pair) for run in all_runs() for pair in combinations(cameras_of(run), 2)]
    yield from [*views()[::every], *pairs[::every]]


def with_outcomes(table: pd.DataFrame) -> pd.DataFrame:
    """Add columns that state whether the error of each clip is doubled, and whether its findings are true."""
    plain = table[table["case"].isin([*PLAIN])].set_index(["run", "camera"])
    keys = pd.MultiIndex.from_frame(table[["run", "camera"]])
    times = [table[of].to_numpy() / plain[of].reindex(keys).to_numpy() for of in ("pose_mm", "position_m")]
    codes = [{*text.split()} for text in table["codes"]]
    before = [{*str(text).split()} for text in plain["codes"].reindex(keys)]
    own = [{*CASES[name].codes} for name in table["case"]]
    beyond = np.any([table[error] > table[bound] for error, bound in BOUNDS.items()], axis=0)
    return table.assign(
        use_beyond=beyond & (table["level"] == "use"),
        doubled=np.nanmax([*times, np.zeros(len(table))], axis=0) >= 2.0,
        named=[bool(said & right) or said == {"refused"} for said, right in zip(codes, own, strict=True)],
        else_named=[bool(said & CAUSES - right - was) for said, right, was in zip(codes, own, before, strict=True)],
    )


def cells(of: pd.DataFrame) -> list[str]:
    def part(which: str, rows: pd.DataFrame) -> str:
        return f"{rows[which].sum():.0f}" if len(rows) else ""

    hurt = of[of["doubled"]]
    figures = [f"{of['pose_mm'].median():.0f}", f"{of['position_m'].median():.2f}"]
    figures += [part("named", of), part("named", hurt), part("else_named", of)]
    figures += [f"{(rows['level'] == 'use').sum()}" for rows in (of, hurt)]
    figures.append(f"{of['use_beyond'].sum()}")
    figures += [f"{of[name].mean():.0%}" for name in ("pose in 90 %", "position in 90 %")]
    seen = [of[f"seen {name}"].median() for name in ("pose_mm", "position_m")]
    return [*figures, f"{seen[0]:.0f}; {seen[1]:.2f}" if np.isfinite(seen[0]) else ""]


def summary(table: pd.DataFrame) -> Iterator[str]:
    """Yield sentences on all fits with a wrong input, and on all fits with a correct input."""
    is_right = table["case"].isin([*PLAIN]) | table["case"].str.startswith("right")
    wrong, right = table[~is_right], table[is_right]
    if len(wrong):
        causes = wrong["named"] | wrong["else_named"]
        yield f'"use" while beyond the bound: {wrong["use_beyond"].sum()} of {len(wrong)} fits'
        yield f"Right cause named: {wrong['named'].sum()} of {causes.sum()} fits with a named cause"
    levels = [(right["level"] == level).sum() for level in ("use", "do not use")]
    yield f'Correct inputs: "use" {levels[0]}, "do not use" {levels[1]} of {len(right)} fits'


def horse_as_cheetah() -> str:
    """Fit a horse as a cheetah, and return the verdict's level and the codes of the findings."""
    names = {"Nose": "nose", "Eye": "l_eye", "Wither": "neck_base", "Ischium": "tail_base", "Shoulder": "l_shoulder"}
    names |= {"Elbow": "l_front_knee", "Hip": "l_hip", "Stifle": "l_back_knee"}
    for side, of in (("l", "Near"), ("r", "Off")):
        names |= {f"{of}knee": f"{side}_front_ankle", f"{of}frontfoot": f"{side}_front_paw"}
        names |= {f"{of}hindhock": f"{side}_back_ankle", f"{of}hindfoot": f"{side}_back_paw"}
    labels = recordings("horse-side") / "CollectedData_Byron.csv"
    if not labels.is_file():
        return "no recording"
    with tempfile.TemporaryDirectory() as folder:
        rename = Path(folder) / "names.csv"
        rename.write_text("old,new\n" + "".join(f"{old},{new}\n" for old, new in names.items()))
        camera = {"hfov_deg": 50.0, "image_size_px": (288, 162)}
        motion = fit_clip(FitSettings(keypoints=(labels,), rename=str(rename), fps=24.0, **camera))
    assert motion.verdict is not None
    return f"{motion.verdict.level}, " + ", ".join(one.code for one in motion.findings if one.severity != "note")


def main() -> None:
    parser = parser_of(__doc__, "--jobs", "--csv")
    parser.add_argument("--cases", help="only cases whose names contain one of these texts, separated by commas")
    parser.add_argument("--views", type=int, default=1, help="every n-th clip only (default: all)")
    parser.add_argument("--findings", action="store_true", help="list the findings of each case")
    arguments = parser.parse_args()
    wanted = [n for n in CASES if arguments.cases is None or any(part in n for part in arguments.cases.split(","))]
    as_they_are = [name for name, two in PLAIN.items() if any(CASES[other].two == two for other in wanted)]
    wanted = [*dict.fromkeys([*as_they_are, *wanted])]
    rows: list[dict[str, Any]] = []
    with ProcessPoolExecutor(arguments.jobs) as pool:
        for of_clip in pool.map(partial(rows_of, names=wanted), clips(arguments.views)):
            rows += of_clip
            if arguments.csv:
                pd.DataFrame(rows).to_csv(arguments.csv, index=False)
    if not rows:
        parser.exit(message="no recordings: nothing measured\n")
    table = pd.DataFrame(rows)
    table = with_outcomes(table.reindex(columns=[*dict.fromkeys([*table.columns, "seen pose_mm", "seen position_m"])]))
    use = ["use", "use of doubled", "use beyond the bound"]
    header = ["case", "clips", "doubled", "pose mm", "position m", "named", "named of doubled", "wrong cause named"]
    grouped = [(name, table[table["case"] == name]) for name in wanted if (table["case"] == name).any()]
    print_table(
        [*header, *use, "pose in 90 %", "position in 90 %", "in the camera's frame: mm; m"],
        [[name, len(of), of["doubled"].sum(), *cells(of)] for name, of in grouped],
    )
    for sentence in summary(table):
        print(sentence)
    if arguments.findings:
        for name, of in grouped:
            counts = pd.Series(" ".join(of["codes"]).split(), dtype=str).value_counts()
            print(f"{name}: " + ", ".join(f"{code} {count}" for code, count in counts.items()))
        print("a horse as a cheetah: " + horse_as_cheetah())


if __name__ == "__main__":
    main()
