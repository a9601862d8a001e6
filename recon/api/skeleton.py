"""`recon skeleton list` and `check`: a description of skeletons, remarks on what looks odd, and pictures.

`recon skeleton from-keypoints`: a skeleton file from the names of a detector's keypoints.

It has the quadruped's segments, with markers of these names. With several cameras it has segments from where the
keypoints are, whatever they are called: keypoints that keep all their distances are a body, and bodies are joined where
their points keep theirs best. Expected is a pose that the animal had, out of which its segments swing as far as they
did.
"""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from rich.table import Table
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.distance import squareform

from recon.animal.body import MIN_JOINTS, PLACES, Body, other_side, side_of
from recon.animal.chain import load_chain
from recon.animal.naming import fitting_maps, fitting_skeleton, load_names, suggestions
from recon.animal.prior import load_prior
from recon.animal.skeleton_file import builtin_names, load_skeleton
from recon.api.clip_cameras import read_clip_cameras
from recon.api.clip_inputs import arrange, read_clips
from recon.api.rigs import FIRST_CAMERA
from recon.api.settings import INDIVIDUAL, UNITS_M, FitSettings, Unit
from recon.base.arrays import Array
from recon.base.documents import builtin_file
from recon.base.errors import InputError, Problem, collect_problems
from recon.base.numbers import length_text
from recon.base.outputs import Output, output_file
from recon.base.settings import File, OneOrMore, Option, Positive, Settings, input_paths
from recon.check.agreement import points_m
from recon.cli.answers import Answer, table_of
from recon.clip import Source, align_cameras, clean, views_of
from recon.geometry.kinematics import ANGLE_OF_AXIS, AXES
from recon.io.deeplabcut_project import bodyparts, find_project
from recon.io.formats import read_keypoints
from recon.show.plain import by_name, picked

STEMS = ("skeleton", "angles")
"""Pictures, each as .png and .svg: the expected pose with names; every angle at both ends of its range."""
REACH_SIGMAS = 2.0
"""Ends of the expected range of an angle."""


class _SkeletonCheckSettings(Settings):
    """The settings of `recon skeleton check`."""

    skeleton: Annotated[str, Option(argument="SKELETON")]
    """A TOML file, or the name of a built-in skeleton, as in my-dog.toml."""
    subject: str | None = None
    """Lengths measured on one animal: built-in name or TOML file."""
    out: Path | None = None
    """Folder for pictures (skeleton, angles: PNG and SVG)."""
    overwrite: bool = False
    """Replace pictures in the folder."""


def skeleton_list() -> Answer:
    """List the skeletons that come with the package.

    Example: recon skeleton list
    """
    shown = ("name", "kind", "markers", "unknowns", "title")
    checks = map(check_skeleton, builtin_names())
    found = [{name: c[name] for name in shown} | {"markers": len(c["markers"])} for c in checks]
    return Answer(found, [table_of(*shown, rows=(map(str, row.values()) for row in found))])


def skeleton_check(settings: _SkeletonCheckSettings) -> Answer:
    """Check a skeleton file, list what is in it, and draw it.

    Example: recon skeleton check my-dog.toml --out my-dog

    Exit code 0: it can be used. 2: it cannot; every problem is named.
    """
    check, out = check_skeleton(settings.skeleton, settings.subject), settings.out
    if out is not None:
        from recon.show.plots.configurations import angle_ranges, views
        from recon.show.plots.style import save

        pictures = [f"{stem}{end}" for stem in STEMS for end in (".png", ".svg")]
        given = input_paths(settings)
        output = Output(out, "skeleton check", settings.overwrite, given, content="these pictures")
        output.require(pictures)
        body, title = load_skeleton(settings.skeleton, settings.subject), f"{check['name']}: {check['title']}"
        figures = views(body, title), angle_ranges(body, REACH_SIGMAS, title)
        with output.staged() as staging:
            for stem, figure in zip(STEMS, figures, strict=True):
                save(figure, staging, stem)
    return Answer(check, [*_lines(check), *([] if out is None else [f"Pictures are in {out}."])])


def _lines(check: dict[str, Any]) -> Iterator[str | Table]:
    yield f"{check['name']}: {check['title']}"
    yield (
        f"A {check['kind']} with {len(check['markers'])} markers and {check['unknowns']} unknowns a frame, "
        f"{length_text(check['length_m'])} long and {length_text(check['height_m'])} high in its expected pose "
        f"(size ± {100 * check['size_sigma']:.0f} %, keypoints within {length_text(check['keypoint_sigma_m'])})."
    )
    names = ("yaw", "pitch", "roll")
    rows = []
    for part in check["parts"]:
        ranges = {angle["name"]: f"{angle['low_deg']:.0f} to {angle['high_deg']:.0f}" for angle in part["angles"]}
        lengths = f"{part['length_m']:.3f}", *(ranges.get(name, "-") for name in names)
        rows.append((part["name"], part["parent"], *lengths))
    yield table_of("segment", "turns on", numbers=("length m", *(f"{name} °" for name in names)), rows=rows)
    rows = [(m["name"], m["segment"], *(f"{x:.3f}" for x in m["at_m"])) for m in check["markers"]]
    yield table_of("marker", "on segment", numbers=("x m", "y m", "z m"), rows=rows)
    yield "Angles: mean ± 2 standard deviations; - for none."
    if links := check.get("links"):
        rows = [(link["name"], link["from"], link["to"], f"{link['length_ratio']:.3f}") for link in links]
        yield table_of("link", "from", "to", numbers=("length / base length",), rows=rows)
        yield f"Base length: {check['base_length_m']:.3f} m"
        names = check["unknown_names"]
        yield f"The {len(names)} unknowns of a frame (recon frame): {', '.join(names)}"
    yield f"Feet: {', '.join(f'{foot} ({label})' for label, foot in check['feet'].items()) or 'none'}"
    yield from (f"Limb {limb}: {', '.join(markers)}" for limb, markers in check["limbs"].items())
    yield f"Prior of a fit, unless --prior says otherwise: {check['prior']}"
    yield from [f"Look at this: {remark}" for remark in check["remarks"]] or ["Nothing looks odd."]


def check_skeleton(name_or_path: str | Path, subject: str | Path | None = None) -> dict[str, Any]:
    """What a skeleton's file describes: `length_m` and `height_m` are those of the expected pose, `unknowns` those of a
    frame, `prior` is the one that a fit takes by default, and `remarks` say what is allowed, but looks like a mistake.
    Raises InputError, naming every problem, for a file that describes no skeleton."""
    body = load_skeleton(name_or_path, subject)
    length, _, height = np.ptp(body.expected_points_m(), axis=0).tolist()
    return {
        **picked(body, "name", "title", "size_sigma", "keypoint_sigma_m", "limbs"),
        "kind": "chain" if body.one_sided else "whole animal",
        "unknowns": body.n_state,
        "length_m": length,
        "height_m": height,
        "prior": load_prior(None, body).name,
        "feet": body.feet_by_label(),
        "remarks": [*_remarks(body)],
        "parts": [*_segments(body)],
        **_published(name_or_path, body),
        "markers": [{"name": m.name, "segment": m.segment, "at_m": m.offset_m} for m in body.tree.markers],
    }


def _published(name_or_path: str | Path, body: Body) -> dict[str, Any]:
    """Return a chain's links with their ratios to the base length, and the unknowns of the frame method."""
    if not body.one_sided:
        return {}
    chain = load_chain(name_or_path)
    links = [
        {"name": link.name, "from": link.start, "to": link.end, "length_ratio": link.length_ratio}
        for link in chain.links
    ]
    return {"base_length_m": chain.nominal_base_length_m, "links": links, "unknown_names": chain.unknown_names}


def _segments(body: Body) -> Iterator[dict[str, Any]]:
    """Each segment with what is expected of its angles: mean, ends of the range, and how quickly they change."""
    expected = zip(*np.rad2deg([body.mean_rad, body.sigma_rad, body.acceleration_rad_s2]), strict=True)
    for segment in body.tree.segments:
        angles = []
        for axis in AXES[segment.joint][segment.parent is None :]:  # all but the root's heading
            mean, sigma, acceleration = map(float, next(expected))
            reach = REACH_SIGMAS * sigma
            of = {"name": ANGLE_OF_AXIS[axis], "mean_deg": mean, "low_deg": mean - reach, "high_deg": mean + reach}
            angles.append(of | {"rate": f"{acceleration:.0f} °/s²"})
        yield {
            "name": segment.name,
            "parent": segment.parent or "",
            "joint": segment.joint,
            "length_m": float(np.linalg.norm(segment.offset_m)),
            "angles": angles,
            "points": [m.name for m in body.tree.markers if m.segment == segment.name],
        }


# -- what looks odd ------------------------------------------------------------------------------------------------


def _remarks(body: Body) -> Iterator[str]:
    at = dict(zip(body.markers, body.expected_points_m(), strict=True))
    rear, front = (at[marker] for marker in body.forward)
    if (length_m := float(np.ptp([*at.values()], axis=0).max())) > LARGEST_ANIMAL_M:
        yield f"lengths: the animal is {length_text(length_m)} long. Lengths are metres, not mm or cm."
    if front[0] <= rear[0]:
        yield f"forward: in the expected pose {body.forward[1]} is not ahead (x) of {body.forward[0]}."
    if not body.feet:
        yield "feet: none. Contacts with the ground and gait need them."
    heights_m = {foot: at[foot][2] for foot in body.feet}
    if high := [foot for foot, height_m in heights_m.items() if height_m >= min(rear[2], front[2])]:
        yield f"feet: in the expected pose {', '.join(high)} not below {' and '.join(body.forward)}."
    for label, foot in body.feet_by_label().items():
        fore = (at[foot] - (rear + front) / 2) @ (front - rear) > 0
        if fore != (label[-1] == "F"):
            there, said = ("before", "hind") if fore else ("behind", "fore")
            yield f"feet: in the expected pose {foot} lies {there} the middle of the trunk, but is a {said} foot."
    sides = {marker: side for marker in body.markers if (side := body.side_of(marker)) is not None}
    if wrong := [m for m, side in sides.items() if (at[m][1] < 0 if side == "left" else at[m][1] > 0)]:
        yield f"markers: on the other side of the middle (y is to the left) {', '.join(wrong)}."
    pairs = [(m, other_side(m)) for m, side in sides.items() if side == "left" and other_side(m) in at]
    if uneven := [m for m, other in pairs if not np.allclose(at[m], at[other] * (1, -1, 1), atol=1e-6)]:
        yield f"markers: not the mirror image of the other side {', '.join(uneven)}."


# -- a draft of a skeleton ------------------------------------------------------------------------------------------

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
LARGEST_ANIMAL_M = 15.0
"""No animal on legs is longer."""
SWING_RAD, SWING_HZ = (0.2, 1.2), (0.5, 8.0)


_ROUGHLY = {"croup": "tail_base", "rump": "tail_base"}
"""Markers that are near enough for a draft, but not for a fit."""

SkeletonDraft = tuple[dict[str, str], tuple[str, ...], str]
"""A file's keypoints that have a place, and the quadruped's markers that they are taken for; those that have none yet;
and the text of a skeleton file, to be completed."""


class _SkeletonDraftSettings(Settings):
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


def skeleton_from_keypoints(settings: _SkeletonDraftSettings) -> Answer:
    """Draft a skeleton for the keypoints of a file: the proportions of the quadruped, with markers called so; or, with
    several calibrated cameras, whatever they are called, the bodies and joints that their distances show.

    Example: recon skeleton from-keypoints clip.csv --out my-animal.toml
    """
    out, source = settings.out, settings.keypoints[0]
    output = output_file(out, "skeleton from-keypoints", settings.overwrite, input_paths(settings))
    output.require((out.name,))
    if settings.camera is not None:
        markers, others, text = _of_geometry(settings)
    elif len(settings.keypoints) > 1:
        found = f"{len(settings.keypoints)} files without --camera"
        raise InputError(Problem("KEYPOINTS", "files", found, "one, for its names; or --camera beside several"))
    else:
        project = find_project(source)
        names = bodyparts(project) if project else read_keypoints(source, settings.individual).names
        markers, others, text = draft_skeleton(names, out.stem, project.folder if project else source)
    output.write(out.name, text)
    other = [f"{name} as {marker}" for name, marker in markers.items() if name != marker]
    lines = [f"{out}: {len(markers)} of {len(markers) + len(others)} keypoints have a place."]
    lines += [f"Taken for the quadruped's: {', '.join(other)}."] if other else []
    lines += [f"Without a place: {', '.join(others)}."] if others else []
    look = f"Look at it with: recon skeleton check {shlex.quote(str(out))} --out pictures"
    return Answer({"out": out, "keypoints": markers, "without_place": others}, [*lines, look])


def _of_geometry(settings: _SkeletonDraftSettings) -> SkeletonDraft:
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


def _require_size(positions_m: Array, settings: _SkeletonDraftSettings) -> None:
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
        expected = f"by {TOO_MUCH / NOISE:.0%} or less of its length; more or nearer cameras tell what bends from noise"
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
