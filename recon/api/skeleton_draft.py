"""Draft a skeleton file from the keypoints of a detector.

By their names it has the quadruped's segments, with markers of these names. With several cameras it has segments from
where the keypoints are, whatever they are called: keypoints that keep all their distances are a body, and bodies are
joined where their points keep theirs best. Expected is a pose that the animal had, out of which its segments swing as
far as they did.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import squareform

from recon.animal.body import MIN_JOINTS, PLACES, other_side, side_of
from recon.animal.naming import fitting_maps, fitting_skeleton, load_names, suggestions
from recon.animal.skeleton_file import load_skeleton
from recon.api.clip_cameras import read_clip_cameras
from recon.api.clip_inputs import arrange, read_clips
from recon.api.rigs import FIRST_CAMERA
from recon.api.settings import INDIVIDUAL, UNITS_M, FitSettings, Unit
from recon.api.skeleton_check import LARGEST_ANIMAL_M
from recon.base.arrays import Array
from recon.base.documents import builtin_file
from recon.base.errors import InputError, Problem, collect_problems
from recon.base.numbers import length_text, percent
from recon.base.outputs import output_file
from recon.base.settings import File, OneOrMore, Option, Positive, Settings, input_paths
from recon.check.agreement import points_m
from recon.clip import Source, align_cameras, clean, views_of
from recon.io.deeplabcut_project import bodyparts, find_project
from recon.io.formats import read_keypoints
from recon.show.plain import by_name, picked

BASE = "quadruped"
REAR, FRONT = ("tail_base", "l_hip", "spine"), ("neck_base", "withers", "l_shoulder", "nose")
"""Markers of it that `forward` may begin and end with, the best first."""
FEWEST_FRAMES = 20
RIGID, TOO_MUCH, NOISE = 0.01, 0.02, 2.0
"""Shares of the animal's length: a distance that changes by less (one standard deviation) stays the same; and of noisy
keypoints, by so many times what those between steady neighbours do, but not by more than the second."""
KEYPOINT_SHARE, SIZE_SIGMA = 0.02, 0.05
"""For the skeleton: keypoint_sigma_m as a share of its length, and size_sigma of an animal that was measured."""
HEAD = ("keypoint_sigma_m", "size_sigma")
SWING_RAD, SWING_HZ = (0.2, 1.2), (0.5, 8.0)


_ROUGHLY = {"croup": "tail_base", "rump": "tail_base"}
"""Markers that are near enough for a draft, but not for a fit."""

SkeletonDraft = tuple[dict[str, str], tuple[str, ...], str]
"""A file's keypoints that have a place, and the quadruped's markers that they are taken for; those that have none yet;
and the text of a skeleton file, to be completed."""


class SkeletonDraftSettings(Settings):
    """What `recon skeleton from-keypoints` is told."""

    keypoints: Annotated[OneOrMore[Path], Option(argument="KEYPOINTS")]
    """Keypoint file, or DeepLabCut's project; with --camera one file for each."""
    out: Path
    """Skeleton file to write, as in my-animal.toml."""
    individual: Annotated[str | None, Option(INDIVIDUAL)] = None
    camera: OneOrMore[File] | None = None
    """Calibration of several cameras: distances that stay the same make the draft. (default: names do)"""
    fps: Positive | None = None
    """With --camera: the frame rate in Hz. (default: what the file says)"""
    up: str | None = None
    """With --camera: which axis of its world points up, as in z or -y; first-camera: that counts as level. (default:
    what the file says)"""
    camera_name: OneOrMore[str] | None = None
    """With --camera: which camera of the file, as in cam2 or 2; once for each keypoint file. (default: whose name the
    keypoint file's name contains)"""
    camera_unit: Unit = "m"
    """With --camera: unit of the cameras' positions in the file; Anipose's is often mm."""
    overwrite: bool = False
    """Replace the file."""


def run_skeleton_draft(settings: SkeletonDraftSettings) -> SkeletonDraft:
    """Draft a skeleton for the keypoints of a file, or of several cameras, and write it. Raises InputError."""
    out, source = settings.out, settings.keypoints[0]
    output = output_file(out, "skeleton from-keypoints", settings.overwrite, input_paths(settings))
    output.require((out.name,))
    if settings.camera is not None:
        draft = _of_geometry(settings)
    elif len(settings.keypoints) > 1:
        found = f"{len(settings.keypoints)} files without --camera"
        raise InputError(Problem("KEYPOINTS", "files", found, "one, for its names; or --camera beside several"))
    else:
        project = find_project(source)
        names = bodyparts(project) if project else read_keypoints(source, settings.individual).names
        draft = draft_skeleton(names, out.stem, project.folder if project else source)
    output.write(out.name, draft[-1])
    return draft


def _of_geometry(settings: SkeletonDraftSettings) -> SkeletonDraft:
    """Draft a skeleton from several cameras; raise InputError also for cameras without poses or direction up."""
    options = ("keypoints", "camera", "fps", "up", "individual", "camera_name", "camera_unit")
    given = FitSettings(**picked(settings, *options))
    files, cameras = collect_problems(lambda: read_clips(given), lambda: read_clip_cameras(given))
    first, source = files[0], settings.keypoints[0]
    assert first.fps is not None
    if len(files) < 2 or not all(camera.has_extrinsics for camera, _ in cameras):
        poses = [f"{camera.name} {'with' if camera.has_extrinsics else 'without'} a pose" for camera, _ in cameras]
        raise InputError(Problem("--camera", "poses", ", ".join(poses), "two or more cameras with poses"))
    if settings.up != FIRST_CAMERA and not all(camera.knows_up for camera, _ in cameras):
        found = "poses that do not say which way is up"
        raise InputError(Problem("--up", "up", found, f"an axis of their world, as in z or -y, or {FIRST_CAMERA}"))
    sources = [
        Source(camera, *clean(arrange(file, first.names), given.likelihood_min), file.names)
        for file, (camera, _) in zip(files, cameras, strict=True)
    ]
    views = views_of(align_cameras(sources, (0.0,) * len(sources)))
    places_m = points_m(views, given.trajectory_options().sigma_px, 0.0)
    _require_size(places_m, settings)
    known, text = drafted(first.names, places_m, first.fps, settings.out.stem, source)
    return {name: name for name in known}, tuple(n for n in first.names if n not in known), text


def _require_size(positions_m: Array, settings: SkeletonDraftSettings) -> None:
    """Raise InputError for an animal so large that the calibration is in another unit."""
    known = np.asarray(np.isfinite(positions_m).all(axis=2))
    enough = known.sum(axis=1) >= MIN_JOINTS
    if not enough.any():
        return
    extents_m = [float(np.ptp(row[seen], axis=0).max()) for row, seen in zip(positions_m, known, strict=True)]
    size_m = float(np.median(np.array(extents_m)[enough]))
    smaller = {unit: size_m * UNITS_M[unit] / UNITS_M[settings.camera_unit] for unit in ("cm", "mm")}
    if size_m > LARGEST_ANIMAL_M:
        units = " or ".join(f"{unit} ({length_text(length)})" for unit, length in smaller.items() if length < size_m)
        found = f"an animal of {length_text(size_m)}, with lengths of the calibration in {settings.camera_unit}"
        raise InputError(Problem("--camera-unit", "camera_unit", found, f"the unit of the calibration: {units}"))


def draft_skeleton(names: Sequence[str], title: str, source: Path) -> SkeletonDraft:
    """Raises InputError where too few names are understood to place an animal, or none of either end of its trunk, and
    for names of another built-in skeleton's points."""
    body = load_skeleton(BASE)
    known = _understood(names, body.markers)
    options, count = fitting_skeleton(names)
    if count > len(known):
        expected = f"a four-legged animal's: a draft is one; recon fit {options} takes {count} of these {len(names)}"
        raise InputError(Problem(source, "bodyparts", f"another animal's: {', '.join(names)}", expected))
    called = {marker: name for name, marker in known.items()}
    rear, front = (next((called[m] for m in ends if m in called), None) for ends in (REAR, FRONT))
    if rear is None or front is None or len(known) < MIN_JOINTS:
        found = f"{', '.join(names)}: of these, {', '.join(known) or 'none'} can be placed"
        expected = (
            f"at least {MIN_JOINTS}, one of them at the rear of the trunk ({', '.join(REAR)}) and one at its "
            f"front ({', '.join(FRONT)}); or clips of several cameras with --camera, or a skeleton by hand"
        )
        raise InputError(Problem(source, "bodyparts", found, expected))
    others = tuple(name for name in names if name not in known)
    comments = [
        f"A draft for the keypoints of {toml_text(source.name)}: proportions and expectations are of the skeleton",
        f"{BASE}, which are no animal's, and its markers are called as the keypoints. Look at it with recon skeleton",
        "check, and replace the lengths by those of your animal. The fields are explained in docs/skeletons.md.",
        *([f"Keypoints without a place yet: {', '.join(others)}"] if others else []),
    ]
    labels = {label: place for place, label in PLACES.items()}
    feet = {labels[label]: called[foot] for label, foot in body.feet_by_label().items() if foot in called}
    limbs = {limb: [called[m] for m in along if m in called] for limb, along in body.limbs.items()}
    text = builtin_file("animal/skeletons", f"{BASE}.toml").read_text(encoding="utf-8")
    segments = text[text.index("[[segments]]") : text.index("[[markers]]")]
    renamed = {s.name: f"{s.name}_part" if s.name in names else s.name for s in body.tree.segments}
    for name, other in renamed.items():
        segments = segments.replace(f'"{name}"', f'"{other}"')
    parts = [head_text(comments, title, "the names", forward=[rear, front], **picked(body, *HEAD))]
    parts += [table_text("[feet]", feet), segments]
    for marker in body.tree.markers:
        name, twin = called.get(marker.name), called.get(other_side(marker.name))
        paired = name is not None and twin == other_side(name) != name
        if name is not None and not (paired and side_of(name) == "right"):  # pairs are written once
            of = {"name": name, "segment": renamed[marker.segment]} | ({"mirrored": True} if paired else {})
            parts.append(table_text("[[markers]]", of | {"at_m": list(marker.offset_m)}))
    parts.append(table_text("[limbs]", {limb: along for limb, along in limbs.items() if len(along) > 1}))
    return known, others, "".join(parts)


def _understood(names: Sequence[str], markers: Sequence[str]) -> dict[str, str]:
    """Markers by keypoint: of the same name, of the built-in map that knows most of them, or a near miss."""
    maps = fitting_maps(names, markers)
    by = load_names(maps[0]) if maps else {}
    known: dict[str, str] = {}
    for name in names:
        marker = by.get(name, name)
        if marker in markers and marker not in known.values():
            known[name] = marker
    for name in names:
        marker = _ROUGHLY.get(name.lower())
        if marker is not None and marker not in known.values():
            known[name] = marker
    lacking = [marker for marker in markers if marker not in known.values()]
    return known | suggestions([name for name in names if name not in known], lacking)


# -- from where the keypoints are -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Part:
    """A segment: its number, the point where it begins, its parent, its points, and the line to these from others."""

    number: int
    origin: int
    parent: _Part | None
    points: tuple[int, ...] = ()
    line: tuple[int, ...] = ()

    def name(self, labels: Sequence[str]) -> str:
        return f"part_{self.number}_at_{labels[self.origin]}"


def drafted(names: Sequence[str], points_m: Array, fps: float, title: str, source: Path) -> tuple[list[str], str]:
    """The keypoints that were seen often enough, and the text of a skeleton of them. points_m (T, K, 3): in a world
    with z up, metres, NaN where missing. Raises InputError where too few are seen, or the animal hardly moves."""
    seen = np.isfinite(points_m[..., 0])
    kept = np.flatnonzero(seen.sum(axis=0) >= FEWEST_FRAMES)
    if len(kept) < MIN_JOINTS or (seen[:, kept].T.astype(int) @ seen[:, kept]).min() < FEWEST_FRAMES:
        found = f"{len(kept)} that two cameras see in {FEWEST_FRAMES} frames, not all of them together"
        expected = f"{MIN_JOINTS} or more, each together with each other"
        raise InputError(Problem(source, "keypoints", found, expected))
    points, labels = points_m[:, kept], [names[k] for k in kept.tolist()]
    apart = np.stack([np.linalg.norm(points - point[:, None], axis=2) for point in points.swapaxes(0, 1)], axis=1)
    usual_m = np.nanmedian(apart, axis=0)
    changes_m, long_m = 1.4826 * np.nanmedian(np.abs(apart - usual_m), axis=0), float(usual_m.max())
    nearest_m = np.where(np.eye(len(kept), dtype=bool), np.inf, changes_m).min(axis=1)
    same_m = max(NOISE * float(np.median(nearest_m)), RIGID * long_m)  # nearly every point is on a body with another
    if same_m > TOO_MUCH * long_m:
        found = f"distances between neighbours change by {1000 * same_m / NOISE:.1f} mm in an animal of {long_m:.3g} m"
        expected = (
            f"by {percent(TOO_MUCH / NOISE)} or less of its length; more or nearer cameras tell what bends from noise"
        )
        raise InputError(Problem(source, "keypoints", found, expected))
    of = fcluster(linkage(squareform(changes_m, checks=False), "complete"), same_m, "distance")
    bodies = [np.flatnonzero(of == i).tolist() for i in np.unique(of)]
    root = min(range(len(bodies)), key=lambda i: (len(bodies[i]) < 3, usual_m[bodies[i]].min(axis=0).mean()))
    middle = points[:, bodies[root]].mean(axis=1)
    gone = np.gradient(middle[:, :2], axis=0)
    path_m = float(np.nansum(np.linalg.norm(gone, axis=1)))
    if len(bodies) == 1 or not path_m > long_m / 2:
        found = f"an animal of {long_m:.3g} m that goes {path_m:.3g} m, with {len(bodies)} bodies that turn"
        raise InputError(Problem(source, "motion", found, "half its length, to know its front, and two bodies or more"))
    parts = _tree(bodies, root, np.maximum(changes_m, same_m / 2) + same_m * usual_m / long_m, same_m)
    reach = np.nansum(np.sum((points - middle[:, None])[..., :2] * gone[:, None], axis=2), axis=0)
    trunk = bodies[root] if len(bodies[root]) > 1 else range(len(kept))
    rear, front = min(trunk, key=reach.__getitem__), max(trunk, key=reach.__getitem__)

    x, y, z = np.moveaxis(points - points[:, [parts[0].origin]], 2, 0)
    heading = np.arctan2(y[:, front] - y[:, rear], x[:, front] - x[:, rear])[:, None]
    c, s = np.cos(heading), np.sin(heading)
    turned = np.stack([c * x + s * y, c * y - s * x, z], axis=2)
    typical = np.nanmedian(turned, axis=0)
    off = np.linalg.norm(np.where(np.isfinite(turned), turned - typical, long_m), axis=2).mean(axis=1)
    pose = np.where(np.isfinite(turned[off.argmin()]), turned[off.argmin()], typical)
    along = pose - pose[:, None]  # from a point to another, of the length that it usually has
    along *= (usual_m / np.linalg.norm(along, axis=2).clip(1e-9))[..., None]
    comments = [
        f"A draft from the geometry of the keypoints of {toml_text(source.name)}: distances that change by less than",
        f"{1000 * same_m:.1f} mm stay the same. Look at it with recon skeleton check, and give its segments names.",
    ]
    head = [labels[rear], labels[front]], round(KEYPOINT_SHARE * long_m, 5), SIZE_SIGMA
    text = head_text(comments, title, "the geometry", **by_name(("forward", *HEAD), head))
    text += table_text("[feet]", {})
    for part in parts:
        text += table_text("[[segments]]", _segment(part, parts, labels, turned, along, fps))
    for part in parts:
        for point in part.points:
            of = {"name": labels[point], "segment": part.name(labels)}
            text += table_text("[[markers]]", of | {"at_m": _at(along[part.origin, point])})
    limbs = {f"part_{part.number}": [labels[i] for i in part.line] for part in parts if len(part.line) > 1}
    return labels, text + table_text("[limbs]", limbs)


def _tree(bodies: Sequence[list[int]], root: int, costs: Array, same_m: float) -> list[_Part]:
    """Parents first. costs (K, K): of a joint between two points. A point that keeps its distances to all of another
    body is the joint; where there is none, a link between two points."""

    def joint(a: list[int], b: list[int]) -> tuple[float, int, int]:
        of = costs[np.ix_(a, b)]
        u, v = int(of.max(axis=1).argmin()), int(of.max(axis=0).argmin())
        i, j = divmod(int(of.argmin()), len(b))
        held = float(of[u].max()), float(of[:, v].max()), float(of[i, j]) + 0.5 * same_m
        return min(zip(held, (a[u], b[v], a[i]), (a[u], b[v], b[j]), strict=True))

    n = len(bodies)
    held = [[joint(a, b)[0] * (i != k) for k, b in enumerate(bodies)] for i, a in enumerate(bodies)]
    joined = minimum_spanning_tree(np.array(held)).toarray()
    origin = bodies[root][int(costs[np.ix_(bodies[root], bodies[root])].sum(axis=1).argmin())]
    parts = [_Part(1, origin, None, tuple(bodies[root]), tuple(bodies[root]))]
    of_body, queue = {root: parts[0]}, [root]
    for i in queue:
        for k in (k for k in range(n) if joined[i, k] + joined[k, i] and k not in of_body):
            _, here, there = joint(bodies[i], bodies[k])
            if here != there:
                parts.append(_Part(len(parts) + 1, here, of_body[i]))
            parent = of_body[i] if here == there else parts[-1]
            line = (here, *(p for p in bodies[k] if p != here))
            of_body[k] = _Part(len(parts) + 1, there, parent, tuple(bodies[k]), line)
            parts.append(of_body[k])
            queue.append(k)
    return parts


def _segment(
    part: _Part, parts: Sequence[_Part], labels: Sequence[str], turned: Array, along: Array, fps: float
) -> dict[str, Any]:
    """The table of a segment, which swings as far and as often as the line to its farthest point did."""
    found: dict[str, Any] = {"name": part.name(labels), "joint": "ball" if part.parent else "free"}
    if part.parent:
        found |= {"parent": part.parent.name(labels), "at_m": _at(along[part.parent.origin, part.origin])}
    ends = [*part.points, *(child.origin for child in parts if child.parent is part)]
    far = max(ends, key=lambda p: np.linalg.norm(along[part.origin, p]))
    to_m, usual_m = turned[:, far] - turned[:, part.origin], along[part.origin, far]
    swings = (to_m[np.isfinite(to_m[:, 0])] - usual_m) / np.linalg.norm(usual_m).clip(1e-9)
    main = (swings - swings.mean(axis=0)) @ np.linalg.svd(swings - swings.mean(axis=0), full_matrices=False)[2][0]
    sigma = np.clip(np.sqrt(np.mean(np.sum(swings**2, axis=1))), *SWING_RAD)
    hz = np.clip(np.sum(np.diff(np.sign(main)) != 0) * fps / 2 / len(main), *SWING_HZ)
    quick = round(float(1.5 * sigma * (2 * np.pi * hz) ** 2))
    expected = {"mean_rad": 0.0, "sigma_rad": round(float(sigma), 2), "acceleration_rad_s2": quick}
    return found | dict.fromkeys(("yaw", "pitch", "roll")[0 if part.parent else 1 :], expected)


def _at(place_m: Array) -> list[float]:
    return [round(float(x), 5) for x in place_m]


# -- a skeleton file ----------------------------------------------------------------------------------------------


def head_text(comments: Iterable[str], title: str, of: str, **values: Any) -> str:
    """What a skeleton file begins with. values: its other fields."""
    values = {"name": title, "title": f"{title}, drafted from {of} of its keypoints", **values}
    return table_text("\n".join(f"# {line}" for line in comments), values)


def table_text(header: str, values: Mapping[str, Any]) -> str:
    """A table of a TOML file, each value on a line, as people write it."""
    names = {name: name if re.fullmatch(r"[\w-]+", name, re.ASCII) else toml_text(name) for name in values}
    return "\n".join([header, *(f"{names[name]} = {toml_text(value)}" for name, value in values.items())]) + "\n\n"


def toml_text(value: Any) -> str:
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {toml_text(one)}" for name, one in value.items()) + " }"
    return json.dumps(value, ensure_ascii=False)
