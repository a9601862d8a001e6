"""Draft a skeleton file from the keypoints of a detector.

The names of the keypoints place markers on the quadruped's segments. With several cameras, the positions of the
keypoints define the segments instead, regardless of the keypoints' names. Keypoints whose mutual distances stay
constant form a rigid body, and bodies are joined at the points whose distances vary least. The expected pose is a pose
that the animal had, and the expected range of each angle is the range that the animal showed.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import squareform

from recon.animal.body import FOOT_LABELS, MIN_JOINTS, other_side, side_of
from recon.animal.naming import fitting_maps, fitting_skeleton, load_names, suggestions
from recon.animal.skeleton_file import load_skeleton
from recon.api.clip_cameras import read_clip_cameras
from recon.api.clip_inputs import arrange, read_clips, require_size_of_animal
from recon.api.model_settings import SkeletonDraftSettings
from recon.api.rigs import FIRST_CAMERA
from recon.api.settings import FitSettings
from recon.base.arrays import Array, mean_along
from recon.base.documents import builtin_file
from recon.base.errors import InputError, Problem, collect_problems
from recon.base.numbers import counted, percent, quantity, rough_length
from recon.base.outputs import output_file
from recon.base.settings import input_paths
from recon.check.sights import triangulated_m
from recon.clip import Source, align_cameras, clean, views_of
from recon.io.deeplabcut_project import bodyparts, find_project
from recon.io.formats import read_keypoints
from recon.show.plain import by_name, picked

BASE = "quadruped"
REAR = ("tail_base", "l_hip", "spine")
"""Markers of the quadruped at which a skeleton's `forward` may begin, the preferred one first."""
FRONT = ("neck_base", "withers", "l_shoulder", "nose")
"""Markers of the quadruped at which a skeleton's `forward` may end, the preferred one first."""
MIN_FRAMES = 20
"""Minimum number of frames in which every keypoint, and every pair of keypoints, has to be seen."""
RIGID_SIGMA = 0.01
"""Maximum standard deviation of the distance of two keypoints, in lengths of the animal, for a constant distance."""
NOISE_FACTOR = 2.0
"""Limit for constant distances as a multiple of the keypoints' noise, used instead of `RIGID_SIGMA` if it is larger."""
TOO_MUCH = 0.02
"""Limit for constant distances above which the keypoints are too noisy for a draft, in lengths of the animal."""
TAIL_FRACTION = 0.05
"""Fraction of frames at either end of a distance's range that may be errors.

A median deviation would call every distance constant in an animal that stands for half of the clip.
"""
TAIL_SIGMAS = 3.29
"""Width of a normal distribution without `TAIL_FRACTION` at each end, in standard deviations."""
KEYPOINT_SIGMA_FRACTION = 0.03
"""`keypoint_sigma_m` of a draft, as a fraction of the animal's length."""
MARKER_SIGMA_FRACTION = 0.025
"""`marker_sigma_m` of a draft, as a fraction of the animal's length.

A draft has its markers where the detector sees them, which is a little off the joints. Its segments are rigid, so the
observed changes of their lengths are added.
"""
SIZE_SIGMA = 0.05
"""`size_sigma` of a draft whose animal was measured."""
HEAD = ("keypoint_sigma_m", "marker_sigma_m", "size_sigma")
SWING_RAD = (0.3, 1.2)
"""Smallest and largest standard deviation of a segment's angles in a draft, rad."""
SWING_HZ = (0.5, 8.0)
"""Smallest and largest frequency of a segment's swing in a draft, Hz."""
RANGE_FACTOR = 1.5
"""Factor on the observed swing, to allow for other clips."""
MIN_TRUNK_HEIGHT = 0.3
"""Fraction of the animal's height below which a rigid body cannot be the trunk."""
MAX_FOOT_HEIGHT = 0.12
"""Height above the lowest keypoint up to which a keypoint without a foot's name can be a foot, in animal lengths."""


_ROUGHLY = {"croup": "tail_base", "rump": "tail_base", "sacrum": "tail_base"}
"""Marker used in a draft for a keypoint nearby, whose position differs too much for a fit."""

_FRONT_WORDS = re.compile("nose|snout|muzzle|beak|head|(?<!r)ear|eye|neck|withers|shoulder", re.IGNORECASE)
_REAR_WORDS = re.compile("tail|rump|croup|sacrum|hip|pelvis", re.IGNORECASE)
"""Names of keypoints at the rear. With `_FRONT_WORDS`, they show the direction of an animal that stays in place."""
_FEET_WORDS = re.compile("paw|foot|feet|hand|hoof|toe", re.IGNORECASE)
_NO_FEET = re.compile("tail|nose|snout|muzzle|beak|head", re.IGNORECASE)
"""Names of keypoints that may be near the ground although they are not feet."""
_FORE_WORDS = re.compile("front|fore|thoracic", re.IGNORECASE)
_HIND_WORDS = re.compile("back|hind|rear|pelvic", re.IGNORECASE)
_LEG_WORDS = re.compile("knee|ankle|elbow|wrist|stifle|hock|carp|tars|paw|foot|hand|hoof|toe", re.IGNORECASE)

SkeletonDraft = tuple[dict[str, str], tuple[str, ...], str]
"""Marker of the quadruped for each keypoint that has one, keypoints without a marker, and text of the skeleton file."""


def run_skeleton_draft(settings: SkeletonDraftSettings) -> SkeletonDraft:
    """Draft a skeleton for the keypoints of one file or of several cameras, and write it.

    Raises
    ------
    InputError
        If no skeleton can be drafted.
    """
    out, source = settings.out, settings.keypoints[0]
    output = output_file(out, "skeleton from-keypoints", settings.overwrite, input_paths(settings))
    output.require((out.name,))
    if settings.camera is not None:
        draft = _draft_from_geometry(settings)
    elif len(settings.keypoints) > 1:
        actual = f"{len(settings.keypoints)} files without --camera"
        raise InputError(Problem("KEYPOINTS", "files", actual, "one file, for its names, or several with --camera"))
    else:
        project = find_project(source)
        names = bodyparts(project) if project else read_keypoints(source, settings.individual).names
        draft = draft_skeleton(names, out.stem, project.folder if project else source)
    output.write(out.name, draft[-1])
    return draft


def _draft_from_geometry(settings: SkeletonDraftSettings) -> SkeletonDraft:
    """Draft a skeleton from several cameras, whose poses and upward direction have to be known."""
    options = ("keypoints", "camera", "fps", "up", "individual", "camera_name", "camera_unit")
    fit_settings = FitSettings(**picked(settings, *options))
    files, cameras = collect_problems(
        lambda: read_clips(fit_settings), lambda: read_clip_cameras(fit_settings, up_option="--up")
    )
    first, source = files[0], settings.keypoints[0]
    assert first.fps is not None
    if len(files) < 2 or not all(camera.has_extrinsics for camera, _ in cameras):
        poses = [f"{camera.name} {'with' if camera.has_extrinsics else 'without'} a pose" for camera, _ in cameras]
        raise InputError(Problem("--camera", "poses", ", ".join(poses), "two or more cameras with poses"))
    if settings.up != FIRST_CAMERA and not all(camera.knows_up for camera, _ in cameras):
        actual = "poses that do not say which way is up"
        raise InputError(Problem("--up", "up", actual, f"an axis of their world, such as z or -y, or {FIRST_CAMERA}"))
    sources = [
        Source(camera, *clean(arrange(file, first.names), fit_settings.likelihood_min), file.names)
        for file, (camera, _) in zip(files, cameras, strict=True)
    ]
    views = views_of(align_cameras(sources, (0.0,) * len(sources)))
    positions_m = triangulated_m(views, fit_settings.trajectory_options().sigma_px, 0.0)
    require_size_of_animal(positions_m, settings.camera_unit)
    labels, text = draft_from_points(first.names, positions_m, first.fps, settings.out.stem, source)
    return {name: name for name in labels}, tuple(n for n in first.names if n not in labels), text


def draft_skeleton(names: Sequence[str], title: str, source: Path) -> SkeletonDraft:
    """Draft a skeleton with the quadruped's segments from the names of keypoints.

    Raises
    ------
    InputError
        If too few names are understood, no keypoint is at an end of the trunk, or the names belong to another built-in
        skeleton.
    """
    body = load_skeleton(BASE)
    known = _understood(names, body.markers)
    options, count = fitting_skeleton(names)
    if count > len(known):
        expected = (
            f"names of a four-legged animal, or recon fit {options}, which has {count} of these {len(names)} names"
        )
        raise InputError(
            Problem(source, "bodyparts", f"names of another animal's skeleton: {', '.join(names)}", expected)
        )
    name_of_marker = {marker: name for name, marker in known.items()}
    rear, front = (next((name_of_marker[m] for m in ends if m in name_of_marker), None) for ends in (REAR, FRONT))
    if rear is None or front is None or len(known) < MIN_JOINTS:
        actual = f"{', '.join(names)}, of which {', '.join(known) or 'none'} can be put on the skeleton"
        expected = (
            f"at least {MIN_JOINTS} such keypoints, one of them at the rear of the trunk ({', '.join(REAR)}) and one "
            f"at its front ({', '.join(FRONT)}); or clips of several cameras with --camera, or a skeleton by hand"
        )
        raise InputError(Problem(source, "bodyparts", actual, expected))
    unplaced = tuple(name for name in names if name not in known)
    comments = [
        f"A draft for the keypoints of {toml_text(source.name)}: proportions and expected angles are those of",
        f"the skeleton {BASE}, of no particular animal; markers have the keypoints' names. Look at it with recon",
        "skeleton check, and replace the lengths by those of your animal. docs/skeletons.md explains the fields.",
        *([f"Keypoints not yet on the skeleton: {', '.join(unplaced)}"] if unplaced else []),
    ]
    labels = {label: position for position, label in FOOT_LABELS.items()}
    feet = {
        labels[label]: name_of_marker[foot] for label, foot in body.feet_by_label().items() if foot in name_of_marker
    }
    limbs = {limb: [name_of_marker[m] for m in markers if m in name_of_marker] for limb, markers in body.limbs.items()}
    text = builtin_file("animal/skeletons", f"{BASE}.toml").read_text(encoding="utf-8")
    segments = text[text.index("[[segments]]") : text.index("[[markers]]")]
    renamed = {s.name: f"{s.name}_part" if s.name in names else s.name for s in body.tree.segments}
    for name, new_name in renamed.items():
        segments = segments.replace(f'"{name}"', f'"{new_name}"')
    parts = [head_text(comments, title, "the names", forward=[rear, front], **picked(body, *HEAD))]
    parts += [table_text("[feet]", feet), segments]
    for marker in body.tree.markers:
        name, twin = name_of_marker.get(marker.name), name_of_marker.get(other_side(marker.name))
        paired = name is not None and twin == other_side(name) != name
        if name is not None and not (paired and side_of(name) == "right"):  # left-right pairs are written once
            marker_table = {"name": name, "segment": renamed[marker.segment]} | ({"mirrored": True} if paired else {})
            parts.append(table_text("[[markers]]", marker_table | {"at_m": list(marker.offset_m)}))
    parts.append(table_text("[limbs]", {limb: markers for limb, markers in limbs.items() if len(markers) > 1}))
    return known, unplaced, "".join(parts)


def _understood(names: Sequence[str], markers: Sequence[str]) -> dict[str, str]:
    """Return the marker of each keypoint, found by the best built-in map of names, the same name, or a similar name."""
    maps = fitting_maps(names, markers)
    marker_by_name = load_names(maps[0]) if maps else {}
    known: dict[str, str] = {}
    for name in names:
        marker = marker_by_name.get(name, name)
        if marker in markers and marker not in known.values():
            known[name] = marker
    for name in names:
        marker = _ROUGHLY.get(name.lower())
        if marker is not None and marker not in known.values():
            known[name] = marker
    lacking = [marker for marker in markers if marker not in known.values()]
    return known | suggestions([name for name in names if name not in known], lacking)


@dataclass(frozen=True)
class _Part:
    """Segment of a drafted skeleton, with the indices of its points and of the points on the line along it."""

    number: int
    origin: int
    parent: _Part | None
    points: tuple[int, ...] = ()
    line: tuple[int, ...] = ()

    def name(self, labels: Sequence[str]) -> str:
        """Return a name made from the number of the segment and the label of its first point."""
        return f"part_{self.number}_at_{labels[self.origin]}"


@dataclass(frozen=True)
class _Distances:
    """Distances between K keypoints over a clip, metres."""

    usual_m: Array
    """Median of each distance over the frames, shape (K, K), m."""
    changes_m: Array
    """Standard deviation of each distance, from its range without `TAIL_FRACTION` at each end, shape (K, K), m."""
    same_m: float
    """Standard deviation below which a distance counts as constant."""
    length_m: float
    """Length of the animal, which is the largest median distance between two keypoints.

    The largest distance in any frame would be the distance to an outlier.
    """


def draft_from_points(
    names: Sequence[str], points_m: Array, fps: float, title: str, source: Path
) -> tuple[list[str], str]:
    """Draft a skeleton from the positions of keypoints, regardless of their names.

    Parameters
    ----------
    names
        Names of the K keypoints.
    points_m
        Positions (T, K, 3) in a world with z up, metres, NaN if missing.
    fps
        Frames per second.
    title
        Name of the skeleton.
    source
        Name of the keypoint file, for messages.

    Returns
    -------
    tuple
        The keypoints that were seen often enough, and the text of a skeleton file for them.

    Raises
    ------
    InputError
        If too few keypoints are seen together, the distances are too noisy, or the animal hardly moves.
    """
    points_m, labels = _often_seen(names, points_m, source)
    distances = _distances(points_m, source)
    bodies = _rigid_bodies(distances)
    root = _root_body(bodies, points_m, labels, distances)
    centre_m = points_m[:, bodies[root]].mean(axis=1)
    ahead_m = _directions_ahead(labels, points_m, centre_m, distances.length_m, len(bodies), source)
    parts = _tree(bodies, root, labels, distances)
    named_ends = _named_ends(labels, bodies[root], distances)
    rear, front = named_ends or _ends_of_trunk(points_m, centre_m, ahead_m, bodies[root])
    turned_m = _in_body_frame(points_m, parts[0].origin, rear, front)
    offsets_m = _expected_offsets_m(turned_m, distances)
    comments = [
        f"A draft from the geometry of the keypoints of {toml_text(source.name)}: distances that change by less than",
        f"{quantity(1000 * distances.same_m, 1, 'mm')} are kept constant. "
        "Look at it with recon skeleton check, and give its segments names.",
    ]
    keypoint_sigma_m, bias_m = (
        fraction * distances.length_m for fraction in (KEYPOINT_SIGMA_FRACTION, MARKER_SIGMA_FRACTION)
    )
    marker_sigma_m = math.hypot(bias_m, _bending_m(parts, distances))
    head = [labels[rear], labels[front]], round(keypoint_sigma_m, 5), round(marker_sigma_m, 5), SIZE_SIGMA
    text = head_text(comments, title, "the geometry", **by_name(("forward", *HEAD), head))
    text += table_text("[feet]", _feet(points_m, turned_m, labels, (rear, front), distances.length_m))
    for part in parts:
        text += table_text("[[segments]]", _segment(part, parts, labels, turned_m, offsets_m, fps))
    for part in parts:
        for point in part.points:
            marker = {"name": labels[point], "segment": part.name(labels)}
            text += table_text("[[markers]]", marker | {"at_m": _rounded(offsets_m[part.origin, point])})
    limbs = {f"part_{part.number}": [labels[i] for i in part.line] for part in parts if len(part.line) > 1}
    return labels, text + table_text("[limbs]", limbs)


def _often_seen(names: Sequence[str], points_m: Array, source: Path) -> tuple[Array, list[str]]:
    """Return the points that are seen in enough frames, and their names.

    Raises
    ------
    InputError
        If there are too few of these points.
    """
    seen = np.isfinite(points_m[..., 0])
    kept = np.flatnonzero(seen.sum(axis=0) >= MIN_FRAMES)
    frames_together = seen[:, kept].T.astype(int) @ seen[:, kept]
    if len(kept) < MIN_JOINTS or frames_together.min() < MIN_FRAMES:
        actual = (
            f"{counted(len(kept), 'keypoint')} that two cameras see in {MIN_FRAMES} frames, not all in the same frames"
        )
        expected = f"{MIN_JOINTS} keypoints or more, with every pair in {MIN_FRAMES} common frames"
        raise InputError(Problem(source, "keypoints", actual, expected))
    return points_m[:, kept], [names[k] for k in kept.tolist()]


def _distances(points_m: Array, source: Path) -> _Distances:
    """Return the distances between points (T, K, 3).

    Raises
    ------
    InputError
        If the keypoints are too noisy to show which distances are constant.
    """
    by_point = [np.linalg.norm(points_m - point[:, None], axis=2) for point in points_m.swapaxes(0, 1)]
    distances_m = np.stack(by_point, axis=1)
    usual_m = np.nanmedian(distances_m, axis=0)
    shortest_m, longest_m = np.nanquantile(distances_m, (TAIL_FRACTION, 1.0 - TAIL_FRACTION), axis=0)
    changes_m = (longest_m - shortest_m) / TAIL_SIGMAS
    length_m = float(usual_m.max())
    steadiest_m = np.where(np.eye(len(usual_m), dtype=bool), np.inf, changes_m).min(axis=1)
    # Nearly every point shares a rigid body with another one, so the median variation is the keypoints' noise.
    same_m = max(NOISE_FACTOR * float(np.median(steadiest_m)), RIGID_SIGMA * length_m)
    if same_m > TOO_MUCH * length_m:
        noise_mm = quantity(1000 * same_m / NOISE_FACTOR, 1, "mm")
        actual = f"distances between neighbours change by {noise_mm} in an animal of {rough_length(length_m)}"
        limit = percent(TOO_MUCH / NOISE_FACTOR)
        expected = f"changes by {limit} of its length or less; more or nearer cameras reduce the noise"
        raise InputError(Problem(source, "keypoints", actual, expected))
    return _Distances(usual_m, changes_m, same_m, length_m)


def _rigid_bodies(distances: _Distances) -> list[list[int]]:
    """Return the groups of points whose mutual distances are all constant."""
    tree = linkage(squareform(distances.changes_m, checks=False), "complete")
    body_of_point = fcluster(tree, distances.same_m, "distance")
    return [np.flatnonzero(body_of_point == i).tolist() for i in np.unique(body_of_point)]


def _root_body(bodies: Sequence[list[int]], points_m: Array, labels: Sequence[str], distances: _Distances) -> int:
    """Return the index of the rigid body nearest to all points, preferably with three points and not in a leg."""
    height_m = np.nanmedian(points_m[..., 2], axis=0)
    low_m = height_m.min() + MIN_TRUNK_HEIGHT * (height_m.max() - height_m.min())

    def rank(i: int) -> tuple[bool, bool, float]:
        is_leg = all(_LEG_WORDS.search(labels[k]) for k in bodies[i])
        is_low = bool(height_m[bodies[i]].mean() < low_m)
        return is_leg or is_low, len(bodies[i]) < 3, distances.usual_m[bodies[i]].min(axis=0).mean()

    return min(range(len(bodies)), key=rank)


def _named_ends(labels: Sequence[str], root: Sequence[int], distances: _Distances) -> tuple[int, int] | None:
    """Return the indices of the points labelled as the trunk's rear and front, or None if the labels do not show them.

    Points nearest to the root are chosen, preferably points that are on neither side.
    """
    ends = []
    for words in (_REAR_WORDS, _FRONT_WORDS):
        points = [k for k, label in enumerate(labels) if words.search(label)]
        middle = [k for k in points if side_of(labels[k]) is None] or points
        if not middle:
            return None
        ends.append(min(middle, key=lambda k: distances.usual_m[k, root].mean()))
    return (ends[0], ends[1]) if ends[0] != ends[1] else None


def _feet(
    points_m: Array, turned_m: Array, labels: Sequence[str], ends: tuple[int, int], length_m: float
) -> dict[str, str]:
    """Return the labels of the lowest points at the four corners of the trunk, or {} if a corner has none.

    Words for feet, for a side, and for fore or hind in the names take precedence over the position.
    """
    low_m = np.nanquantile(points_m[..., 2], 0.05, axis=0)
    x, y, _ = np.nanmedian(turned_m, axis=0).T
    middle_x = x[[*ends]].mean()
    named = [k for k, label in enumerate(labels) if _FEET_WORDS.search(label)]
    candidates = named or [k for k, label in enumerate(labels) if not _NO_FEET.search(label)]
    floor_m = min((low_m[k] for k in candidates), default=0.0)
    has_hands = any("hand" in labels[k].lower() for k in named)
    feet: dict[str, str] = {}
    for k in sorted(candidates, key=low_m.__getitem__):
        if not named and low_m[k] > floor_m + MAX_FOOT_HEIGHT * length_m:
            continue
        side = side_of(labels[k]) or ("left" if y[k] > 0 else "right")
        is_fore, is_hind = _FORE_WORDS.search(labels[k]), _HIND_WORDS.search(labels[k])
        if has_hands:
            is_fore, is_hind = "hand" in labels[k].lower(), "hand" not in labels[k].lower()
        is_fore = bool(is_fore) if is_fore or is_hind else x[k] > middle_x
        feet.setdefault(f"{side}_{'fore' if is_fore else 'hind'}", labels[k])
    return feet if len(feet) == len(FOOT_LABELS) else {}


def _directions_ahead(
    labels: Sequence[str], points_m: Array, centre_m: Array, length_m: float, body_count: int, source: Path
) -> Array:
    """Return horizontal vectors (T, 2) along the path, or from tail to head if the animal stays in place.

    Raises
    ------
    InputError
        If neither the path nor the names show the front, or if the animal has only one body.
    """
    steps_m = np.gradient(centre_m[:, :2], axis=0)
    path_m = float(np.nansum(np.linalg.norm(steps_m, axis=1)))
    if path_m > length_m / 2 and body_count > 1:
        return steps_m
    ends = [[k for k, label in enumerate(labels) if word.search(label)] for word in (_REAR_WORDS, _FRONT_WORDS)]
    if body_count == 1 or not any(ends):
        bodies = "1 rigid body" if body_count == 1 else f"{body_count} rigid bodies"
        actual = f"an animal of {rough_length(length_m)} that moves by {rough_length(path_m)}, with {bodies}"
        expected = (
            "two rigid bodies or more, and, to find the front, a path of half its length, or points named after head "
            "or tail"
        )
        raise InputError(Problem(source, "motion", actual, expected))
    rear_m, front_m = (mean_along(points_m[:, end], 1) if end else mean_along(points_m, 1) for end in ends)
    return (front_m - rear_m)[:, :2]


def _ends_of_trunk(points_m: Array, centre_m: Array, ahead_m: Array, root: Sequence[int]) -> tuple[int, int]:
    """Return the indices of the rearmost and foremost points of the root body along vectors (T, 2) that point ahead."""
    ahead = np.nansum(np.sum((points_m - centre_m[:, None])[..., :2] * ahead_m[:, None], axis=2), axis=0)
    trunk = root if len(root) > 1 else range(points_m.shape[1])
    return min(trunk, key=ahead.__getitem__), max(trunk, key=ahead.__getitem__)


def _in_body_frame(points_m: Array, origin: int, rear: int, front: int) -> Array:
    """Return points (T, K, 3) relative to an origin, turned about z so that the trunk points along x."""
    x, y, z = np.moveaxis(points_m - points_m[:, [origin]], 2, 0)
    heading = np.arctan2(y[:, front] - y[:, rear], x[:, front] - x[:, rear])[:, None]
    c, s = np.cos(heading), np.sin(heading)
    return np.stack([c * x + s * y, c * y - s * x, z], axis=2)


def _expected_offsets_m(turned_m: Array, distances: _Distances) -> Array:
    """Return the vectors (K, K, 3) from each point to every other in the expected pose, scaled to their usual lengths.

    The expected pose is taken from the frame nearest to the median of all frames.
    """
    typical_m = np.nanmedian(turned_m, axis=0)
    deviations_m = np.where(np.isfinite(turned_m), turned_m - typical_m, distances.length_m)
    frame = np.linalg.norm(deviations_m, axis=2).mean(axis=1).argmin()
    pose_m = np.where(np.isfinite(turned_m[frame]), turned_m[frame], typical_m)
    offsets_m = pose_m - pose_m[:, None]
    offsets_m *= (distances.usual_m / np.linalg.norm(offsets_m, axis=2).clip(1e-9))[..., None]
    return offsets_m


def _tree(bodies: Sequence[list[int]], root: int, labels: Sequence[str], distances: _Distances) -> list[_Part]:
    """Join bodies into a tree of segments, parents first.

    Two bodies are joined at a point whose distances to all points of the other body are constant. If there is no such
    point, a link between two points joins them.
    """
    same_m = distances.same_m
    # Cost (K, K) of a joint between two points: the variation of their distance plus the distance itself.
    costs = np.maximum(distances.changes_m, same_m / 2) + same_m * distances.usual_m / distances.length_m

    def joint(a: list[int], b: list[int]) -> tuple[float, int, int]:
        """Return the cost of the best joint between two bodies, and its point on each."""
        pairs = costs[np.ix_(a, b)]
        # Candidates are the point of each body whose distances to all points of the other body vary least, and the
        # closest pair of points, which needs a link.
        u, v = int(pairs.max(axis=1).argmin()), int(pairs.max(axis=0).argmin())
        i, j = divmod(int(pairs.argmin()), len(b))
        joint_costs = float(pairs[u].max()), float(pairs[:, v].max()), float(pairs[i, j]) + 0.5 * same_m
        return min(zip(joint_costs, (a[u], b[v], a[i]), (a[u], b[v], b[j]), strict=True))

    n = len(bodies)
    body_costs = [[joint(a, b)[0] * (i != k) for k, b in enumerate(bodies)] for i, a in enumerate(bodies)]
    joined = minimum_spanning_tree(np.array(body_costs)).toarray()
    trunk = [k for k in bodies[root] if not _LEG_WORDS.search(labels[k])] or bodies[root]
    origin = trunk[int(costs[np.ix_(trunk, bodies[root])].sum(axis=1).argmin())]
    parts = [_Part(1, origin, None, tuple(bodies[root]), tuple(bodies[root]))]
    part_of_body, queue = {root: parts[0]}, [root]
    for i in queue:
        for k in (k for k in range(n) if joined[i, k] + joined[k, i] and k not in part_of_body):
            _, parent_point, child_point = joint(bodies[i], bodies[k])
            if parent_point != child_point:
                parts.append(_Part(len(parts) + 1, parent_point, part_of_body[i]))
            parent = part_of_body[i] if parent_point == child_point else parts[-1]
            line = (parent_point, *(p for p in bodies[k] if p != parent_point))
            part_of_body[k] = _Part(len(parts) + 1, child_point, parent, tuple(bodies[k]), line)
            parts.append(part_of_body[k])
            queue.append(k)
    return parts


def _bending_m(parts: Sequence[_Part], distances: _Distances) -> float:
    """Return the standard deviation of the distances that the skeleton keeps constant, averaged over its links."""
    links = [(part.origin, point) for part in parts for point in part.points if point != part.origin]
    links += [(part.parent.origin, part.origin) for part in parts if part.parent and part.parent.origin != part.origin]
    return float(np.sqrt(np.mean(distances.changes_m[tuple(np.transpose(links))] ** 2)))


def _segment(
    part: _Part, parts: Sequence[_Part], labels: Sequence[str], turned_m: Array, offsets_m: Array, fps: float
) -> dict[str, Any]:
    """Return a segment's table for the skeleton file.

    The angles of the segment vary as the direction of its farthest point did in the clip.
    """
    table: dict[str, Any] = {"name": part.name(labels), "joint": "ball" if part.parent else "free"}
    if part.parent:
        table |= {"parent": part.parent.name(labels), "at_m": _rounded(offsets_m[part.parent.origin, part.origin])}
    ends = [*part.points, *(child.origin for child in parts if child.parent is part)]
    farthest = max(ends, key=lambda p: np.linalg.norm(offsets_m[part.origin, p]))
    line_m, usual_m = turned_m[:, farthest] - turned_m[:, part.origin], offsets_m[part.origin, farthest]
    swings = (line_m[np.isfinite(line_m[:, 0])] - usual_m) / np.linalg.norm(usual_m).clip(1e-9)
    centred = swings - swings.mean(axis=0)
    main_swing = centred @ np.linalg.svd(centred, full_matrices=False)[2][0]
    sigma = np.clip(RANGE_FACTOR * np.sqrt(np.mean(np.sum(swings**2, axis=1))), *SWING_RAD)
    hz = np.clip(np.sum(np.diff(np.sign(main_swing)) != 0) * fps / 2 / len(main_swing), *SWING_HZ)
    acceleration = round(float(1.5 * sigma * (2 * np.pi * hz) ** 2))
    expected = {"mean_rad": 0.0, "sigma_rad": round(float(sigma), 2), "acceleration_rad_s2": acceleration}
    return table | dict.fromkeys(("yaw", "pitch", "roll")[0 if part.parent else 1 :], expected)


def _rounded(position_m: Array) -> list[float]:
    """Return a position rounded to 10 micrometres, for a skeleton file."""
    return [round(float(x), 5) for x in position_m]


def head_text(comments: Iterable[str], title: str, origin: str, **values: Any) -> str:
    """Return the beginning of a skeleton file.

    `origin` names the source of the draft, `values` are further fields at the top of the file.
    """
    values = {"name": title, "title": f"{title}, drafted from {origin} of its keypoints", **values}
    return table_text("\n".join(f"# {line}" for line in comments), values)


def table_text(header: str, values: Mapping[str, Any]) -> str:
    """Return a TOML table with one value per line."""
    names = {name: name if re.fullmatch(r"[\w-]+", name, re.ASCII) else toml_text(name) for name in values}
    return "\n".join([header, *(f"{names[name]} = {toml_text(value)}" for name, value in values.items())]) + "\n\n"


def toml_text(value: object) -> str:
    """Return a value written in TOML."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {toml_text(element)}" for name, element in value.items()) + " }"
    return json.dumps(value, ensure_ascii=False)
