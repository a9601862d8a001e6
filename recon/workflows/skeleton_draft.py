"""`recon skeleton from-keypoints`: a skeleton file from the names of a detector's keypoints.

It has the quadruped's segments, with markers of these names; with cameras, segments from where the keypoints are
(`recon.workflows.skeleton_geometry`), whatever they are called.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from recon.animal import (
    MIN_JOINTS,
    fitting_maps,
    fitting_skeleton,
    load_names,
    load_skeleton,
    other_side,
    side_of,
    suggestions,
)
from recon.animal.body import PLACES
from recon.base.documents import builtin_file
from recon.base.errors import InputError, Problem, all_of
from recon.base.files import require_free_file, staged_file
from recon.base.settings import File, OneOrMore, Option, Positive, Settings
from recon.check.agreement import points_m
from recon.clip import Source, together, views_of
from recon.clip.keypoints import clean
from recon.io import read_keypoints
from recon.io.deeplabcut_project import bodyparts, find_project
from recon.show.plain import picked
from recon.workflows.cameras import read_clip_cameras
from recon.workflows.cli.common import say, terminal
from recon.workflows.clip import arrange, read_clips
from recon.workflows.settings import INDIVIDUAL, FitSettings
from recon.workflows.skeleton_geometry import drafted, head_text, table_text, toml_text

BASE = "quadruped"
REAR, FRONT = ("tail_base", "l_hip", "spine"), ("neck_base", "withers", "l_shoulder", "nose")
"""Markers of it that `forward` may begin and end with, the best first."""


SkeletonDraft = tuple[dict[str, str], tuple[str, ...], str]
"""A file's keypoints that have a place, and the quadruped's markers that they are taken for; those that have none yet;
and the text of a skeleton file, to be completed."""


class _SkeletonDraftSettings(Settings):
    """What `recon skeleton from-keypoints` is told."""

    keypoints: Annotated[
        OneOrMore[Path],
        Option("Keypoint file, or DeepLabCut's project; with --camera one file for each.", argument="KEYPOINTS"),
    ]
    out: Annotated[Path, Option("Skeleton file to write, as in my-animal.toml.")]
    individual: Annotated[str | None, Option(INDIVIDUAL)] = None
    camera: Annotated[
        OneOrMore[File] | None,
        Option("Calibration of several cameras: distances that stay the same make the draft. (default: names do)"),
    ] = None
    fps: Annotated[Positive | None, Option("With --camera: the frame rate in Hz. (default: what the file says)")] = None
    up: Annotated[str | None, Option("With --camera: as of recon fit. (default: what the file says)")] = None
    overwrite: Annotated[bool, Option("Replace the file.")] = False


def skeleton_from_keypoints(settings: _SkeletonDraftSettings) -> None:
    """Draft a skeleton for the keypoints of a file: the proportions of the quadruped, with markers called so; or, with
    several calibrated cameras, whatever they are called, the bodies and joints that their distances show.

    Example: recon skeleton from-keypoints clip.csv --out my-animal.toml
    """
    (markers, others, _), out = run_skeleton_draft(settings), settings.out
    console = terminal()
    say(console, f"{out}: {len(markers)} of {len(markers) + len(others)} keypoints have a place.")
    other = [f"{name} as {marker}" for name, marker in markers.items() if name != marker]
    if other:
        say(console, f"Taken for the quadruped's: {', '.join(other)}.")
    if others:
        say(console, f"Without a place: {', '.join(others)}.")
    say(console, f"Look at it with: recon skeleton check {shlex.quote(str(out))} --out pictures")


def run_skeleton_draft(settings: _SkeletonDraftSettings) -> SkeletonDraft:
    """`recon skeleton from-keypoints`: write a draft of a skeleton for a keypoint file. Raises InputError."""
    for path in settings.keypoints:
        require_free_file(settings.out, settings.overwrite, source=path)
    source = settings.keypoints[0]
    if settings.camera is not None:
        draft = _of_geometry(settings)
    elif len(settings.keypoints) > 1:
        found = f"{len(settings.keypoints)} files without --camera"
        raise InputError(Problem("KEYPOINTS", "files", found, "one, for its names; or --camera beside several"))
    else:
        project = find_project(source)
        names = bodyparts(project) if project else read_keypoints(source, settings.individual).names
        draft = draft_skeleton(names, settings.out.stem, project.folder if project else source)
    with staged_file(settings.out) as staged:
        staged.write_text(draft[-1], encoding="utf-8")
    return draft


def _of_geometry(settings: _SkeletonDraftSettings) -> SkeletonDraft:
    """Raises InputError also where the cameras' poses are not known, or which way is up."""
    given = FitSettings(**picked(settings, "keypoints", "camera", "fps", "up", "individual"))
    files, cameras = all_of(lambda: read_clips(given), lambda: read_clip_cameras(given))
    first, source = files[0], settings.keypoints[0]
    assert first.fps is not None
    if len(files) < 2 or not all(camera.knows_up for camera, _ in cameras):
        found = f"{len(files)} camera(s): {', '.join(camera.name for camera, _ in cameras)}"
        raise InputError(Problem("--camera", "poses", found, "two or more with poses, and --up unless these say it"))
    sources = [
        Source(camera, *clean(arrange(file, first.names), given.likelihood_min), file.names)
        for file, (camera, _) in zip(files, cameras, strict=True)
    ]
    views = views_of(together(sources, (0.0,) * len(sources)))
    places_m = points_m(views, given.trajectory_options().sigma_px, 0.0)
    known, text = drafted(first.names, places_m, first.fps, settings.out.stem, source)
    return {name: name for name in known}, tuple(n for n in first.names if n not in known), text


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
            f"at least {MIN_JOINTS}, one of them at the rear of the trunk ({', '.join(REAR)}) and one at its front "
            f"({', '.join(FRONT)}); or a skeleton written by hand"
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
    parts = [head_text(comments, title, "the names", (rear, front), body.keypoint_sigma_m, body.size_sigma)]
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
    by = load_names(maps[0]).names if maps else {}
    known: dict[str, str] = {}
    for name in names:
        marker = by.get(name, name)
        if marker in markers and marker not in known.values():
            known[name] = marker
    lacking = [marker for marker in markers if marker not in known.values()]
    return known | suggestions([name for name in names if name not in known], lacking)
