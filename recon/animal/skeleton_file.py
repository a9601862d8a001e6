"""Load skeletons by name or from a TOML file, with the lengths of a measured animal and the offsets of a detector.

Built-in skeletons, subjects and detectors are in folders of `recon/animal`. A subject file has the lengths of one
animal. A detector file has the offsets from a skeleton's markers to the points on the skin that a network detects. The
scorer in a keypoint file identifies its detector.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import Field

from recon.animal.anatomy import anatomy_problems, joints_of_both_sides
from recon.animal.body import FOOT_LABELS, MIN_JOINTS, Body, foot_problems, foot_table, other_side, side_of
from recon.base import documents
from recon.base.documents import FileTable, Number, Sigma, unknown, validated
from recon.base.errors import InputError, Problem, collect_problems, raise_problems
from recon.base.numbers import counted
from recon.geometry.kinematics import ANGLE_OF_AXIS, AXES, Marker, Segment, Tree


def builtin_names() -> tuple[str, ...]:
    """Return the names of the built-in skeletons."""
    return documents.builtin_names("animal/skeletons", ".toml")


def builtin_subjects() -> tuple[str, ...]:
    """Return the names of the built-in subjects."""
    return documents.builtin_names("animal/subjects", ".toml")


def load_skeleton(name_or_path: str | Path, subject: str | Path | None = None) -> Body:
    """Load a skeleton by its built-in name or from a TOML file.

    Parameters
    ----------
    name_or_path : str or path
        Name of a built-in skeleton, or path of a skeleton file.
    subject : str or path, optional
        Name of a built-in subject, or path of a subject file. Only skeletons of whole animals can have a subject.

    Raises
    ------
    InputError
        If a file cannot be used. The error lists every problem.
    """
    if subject is None and str(name_or_path) in builtin_names():
        return _builtin_skeleton(str(name_or_path))
    return _read_skeleton(name_or_path, subject)


@cache
def _builtin_skeleton(name: str) -> Body:
    """Return a built-in skeleton, which is read only once because each clip of a batch needs it."""
    return _read_skeleton(name, None)


def _read_skeleton(name_or_path: str | Path, subject: str | Path | None) -> Body:
    raw, source = read_named(name_or_path)
    if "segments" in raw or not raw.keys() & {"links", "extends"}:
        return _load_body(raw, source, subject)
    if subject is not None:
        expected = f"nothing: {source} is a chain, and a measured chain needs a skeleton file of its own"
        raise InputError(Problem("--subject", "name or file", repr(str(subject)), expected))
    from recon.animal.chain import chain_of  # imported here because few clips use a chain

    return chain_of(raw, source).body


def read_named(
    name_or_path: str | Path,
    kind: Literal["skeleton", "subject", "detector"] = "skeleton",
) -> tuple[dict[str, Any], str]:
    """Return the tables of a built-in file or of the user's file, and the file's name for messages."""
    option = "--set detector" if kind == "detector" else f"--{kind}"
    return documents.named_table(name_or_path, f"animal/{kind}s", option, kind)


_Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]

_BodyFeet = Annotated[
    dict[str, str],
    foot_table(
        FOOT_LABELS,
        '{ left_fore = "l_front_paw", right_fore = "r_front_paw", left_hind = "l_back_paw", right_hind = '
        '"r_back_paw" }, with its markers',
    ),
]


Offset = tuple[Number, Number, Number]


class _Expectation(FileTable):
    mean_rad: Number
    sigma_rad: Sigma
    acceleration_rad_s2: Sigma

    def mirrored(self) -> _Expectation:
        return self.model_copy(update={"mean_rad": -self.mean_rad})


class _Segment(FileTable):
    name: str
    joint: Literal["free", "ball", "universal", "hinge", "fixed"]
    parent: str | None = None
    at_m: Offset = (0.0, 0.0, 0.0)
    mirrored: bool = False
    yaw: _Expectation | None = None
    pitch: _Expectation | None = None
    roll: _Expectation | None = None


class _Marker(FileTable):
    name: str
    segment: str
    at_m: Offset = (0.0, 0.0, 0.0)
    keypoint_offset_m: Offset = (0.0, 0.0, 0.0)
    mirrored: bool = False


class _Mass(FileTable):
    source: str
    share: dict[str, tuple[_Share, _Share]]
    """Fraction of the body's mass in each segment, and its standard deviation.

    Both are 0 for segments that only carry markers.
    """


class _BodyFile(FileTable):
    name: str
    title: str
    forward: tuple[str, str]
    feet: _BodyFeet = Field(default=None, validate_default=True)
    keypoint_sigma_m: Sigma
    marker_sigma_m: Annotated[float, Field(ge=0.0)] = 0.0
    size_sigma: Sigma
    detector: str | None = None
    segments: tuple[_Segment, ...] = Field(min_length=1)
    markers: tuple[_Marker, ...]
    limbs: dict[str, tuple[str, ...]]
    anatomy: dict[str, tuple[str, str, str]] = Field(default_factory=dict)
    """Markers above, at and below each anatomical joint. A left joint also defines the right one."""
    mass: _Mass | None = None


def _load_body(raw: dict[str, Any], source: str, subject: str | Path | None) -> Body:
    if subject is None:
        file, problems = validated(_BodyFile, raw, source), list[Problem]()
    else:
        from recon.animal.measured import read_subject, subject_problems, with_subject

        table, subject_source = read_named(subject, "subject")
        file, animal = collect_problems(
            lambda: validated(_BodyFile, raw, source), lambda: read_subject(table, subject_source)
        )
        problems = [*subject_problems(animal, file, subject_source)]
        file = with_subject(animal, file)
    problems += _body_problems(file, source)
    raise_problems(dict.fromkeys(problems))  # both sides of a mirrored segment can have the same problem
    return replace(_body(file), subject=None if subject is None else str(subject))


_Item = TypeVar("_Item", _Segment, _Marker)


def _both_sides(items: Iterable[_Item]) -> Iterator[tuple[int, _Item]]:
    """Yield every segment or marker with its index in the file.

    A mirrored item on the left is followed by its mirror image on the right, with the same index.
    """
    for i, item in enumerate(items):
        yield i, item
        if item.mirrored and side_of(item.name) == "left":
            x, y, z = item.at_m
            changed: dict[str, Any] = {"name": other_side(item.name), "at_m": (x, -y, z), "mirrored": False}
            if isinstance(item, _Marker):
                dx, dy, dz = item.keypoint_offset_m
                changed |= {"segment": other_side(item.segment), "keypoint_offset_m": (dx, -dy, dz)}
            else:
                changed["parent"] = None if item.parent is None else other_side(item.parent)
                changed |= {a: e.mirrored() for a in ("yaw", "roll") if (e := getattr(item, a)) is not None}
            yield i, item.model_copy(update=changed)


def _expected_angles(segment: _Segment) -> list[str]:
    """Return the names of the angles for which a segment needs expected values, in the order of the state."""
    return [ANGLE_OF_AXIS[axis] for axis in AXES[segment.joint] if (segment.joint, axis) != ("free", "z")]


def _body_problems(file: _BodyFile, source: str) -> Iterator[Problem]:
    used = set[str]()
    yield from _segment_problems(file, used, source)
    yield from _marker_problems(file, used, source)
    named = {"forward": file.forward, "feet": file.feet.values()} | {f"limbs.{k}": v for k, v in file.limbs.items()}
    named |= {f"anatomy.{joint}": joint_markers for joint, joint_markers in file.anatomy.items()}
    markers = sorted(marker.name for _, marker in _both_sides(file.markers))
    yield from anatomy_problems(file.anatomy, source)
    yield from unknown(source, [(field, name) for field, names in named.items() for name in names], markers)
    if file.mass is not None:
        yield from _mass_problems(file.mass.share, [segment.name for _, segment in _both_sides(file.segments)], source)
    if file.forward[0] == file.forward[1]:
        yield Problem(source, "forward", f"{file.forward[0]!r} twice", "two markers, from rear to front")
    yield from foot_problems(file.feet, source)


def _segment_problems(file: _BodyFile, used: set[str], source: str) -> Iterator[Problem]:
    """Yield problems with the names, joints, parents and angles of the segments, and add the names to `used`."""
    segments = list[str]()
    for i, segment in _both_sides(file.segments):
        row = f"segments[{i}]"
        yield from _name_problems(segment, row, used, source)
        if i == 0:
            root = {"joint": "free", "parent": None, "at_m": (0.0, 0.0, 0.0), "mirrored": False}
            wanted = "joint = free, and no parent, at_m or mirrored: the first segment is the root"
            for field in (field for field, value in root.items() if getattr(segment, field) != value):
                yield Problem(source, f"{row}.{field}", repr(getattr(segment, field)), wanted)
        elif segment.joint == "free":
            yield Problem(source, f"{row}.joint", "'free'", "ball, universal, hinge or fixed: only the root is free")
        if i > 0 and segment.parent not in segments:
            yield Problem(source, f"{row}.parent", repr(segment.parent), "the name of an earlier segment")
        expected = _expected_angles(segment)
        for angle in ANGLE_OF_AXIS.values():
            is_given = getattr(segment, angle) is not None
            if is_given != (angle in expected):
                state = "an expected angle" if is_given else "no expected angle"
                wanted = f"{' and '.join(expected) or 'no angle'}, since the segment's joint is {segment.joint}"
                yield Problem(source, f"{row}.{angle}", state, wanted)
        segments.append(segment.name)


def _marker_problems(file: _BodyFile, used: set[str], source: str) -> Iterator[Problem]:
    """Yield problems with the names, segments and number of the markers, and add the names to `used`."""
    segments = {segment.name for _, segment in _both_sides(file.segments)}
    markers = [*_both_sides(file.markers)]
    for i, marker in markers:
        yield from _name_problems(marker, f"markers[{i}]", used, source)
        if marker.segment not in segments:
            yield Problem(source, f"markers[{i}].segment", repr(marker.segment), "the name of a segment")
    if len(markers) < MIN_JOINTS:
        yield Problem(
            source,
            "markers",
            counted(len(markers), "marker"),
            f"at least {MIN_JOINTS} markers: fewer do not determine a pose",
        )


def _mass_problems(shares: Mapping[str, Any], segments: Sequence[str], source: str) -> Iterator[Problem]:
    """Yield a problem for each mass fraction without a segment, and for each segment without a mass fraction."""
    yield from unknown(source, [(f"mass.share.{name}", name) for name in shares], sorted(segments))
    for name in sorted(segments):
        if name not in shares and other_side(name) not in shares:
            yield Problem(
                source,
                f"mass.share.{name}",
                "nothing",
                "a fraction of the mass and its standard deviation, such as [0.05, 0.01]",
            )


def _name_problems(item: _Segment | _Marker, field: str, used: set[str], source: str) -> Iterator[Problem]:
    """Yield problems with the name of a segment or marker, and add it to `used`, the names of the preceding items."""
    if item.name in used:
        yield Problem(source, f"{field}.name", repr(item.name), "a name that no earlier segment or marker has")
    if item.mirrored and side_of(item.name) != "left":
        expected = "a name that contains the left side, such as l_paw, front_left_paw or LeftPaw"
        yield Problem(source, f"{field}.mirrored", repr(item.name), expected)
    used.add(item.name)


def _body(f: _BodyFile) -> Body:
    segments = [segment for _, segment in _both_sides(f.segments)]
    markers = [marker for _, marker in _both_sides(f.markers)]
    expected = [getattr(s, angle) for s in segments for angle in _expected_angles(s)]
    shares = {} if f.mass is None else f.mass.share
    return Body(
        name=f.name,
        title=f.title,
        tree=Tree(
            segments=tuple(Segment(s.name, s.parent, s.joint, s.at_m) for s in segments),
            markers=tuple(Marker(m.name, m.segment, m.at_m) for m in markers),
        ),
        keypoints=tuple((m.name, m.name) for m in markers),
        limbs=f.limbs,
        anatomy=joints_of_both_sides(f.anatomy),
        forward=f.forward,
        feet=tuple(f.feet.values()),
        foot_labels=tuple(FOOT_LABELS[position] for position in f.feet),
        keypoint_sigma_m=f.keypoint_sigma_m,
        marker_sigma_m=f.marker_sigma_m,
        size_sigma=f.size_sigma,
        mean_rad=np.array([e.mean_rad for e in expected]),
        sigma_rad=np.array([e.sigma_rad for e in expected]),
        acceleration_rad_s2=np.array([e.acceleration_rad_s2 for e in expected]),
        keypoint_offset_m={m.name: m.keypoint_offset_m for m in markers if any(m.keypoint_offset_m)},
        detector=f.detector,
        mass={s.name: shares[s.name if s.name in shares else other_side(s.name)] for s in segments if shares},
        mass_source=None if f.mass is None else f.mass.source,
    )


NONE = "none"
"""Name of a detector whose keypoints coincide with the skeleton's markers."""
OWN = "own"
"""Name of a detector whose offsets are in the skeleton file or the subject file."""


class _Keypoint(FileTable):
    offset_m: tuple[Number, Number, Number]
    spread_m: Sigma
    sigma_m: Sigma | None = None


class _DetectorFile(FileTable):
    skeleton: str
    title: str
    scorers: tuple[str, ...] = ()
    keypoint_sigma_m: Sigma
    keypoints: Annotated[dict[str, _Keypoint], Field(min_length=1)]


def detector_of_scorer(scorer: str | None, skeleton: str) -> str:
    """Return the name of the built-in detector whose keypoint files have the scorer `scorer`, or "none"."""
    for name in documents.builtin_names("animal/detectors", ".toml") if scorer else ():
        raw, _ = read_named(name, "detector")
        if raw["skeleton"] == skeleton and any(
            fnmatchcase(scorer or "", pattern) for pattern in raw.get("scorers", ())
        ):
            return name
    return NONE


def with_detector_offsets(
    body: Body, detector: str | Path | None, scorers: Mapping[str, str | None] | None = None
) -> Body:
    """Return the body with a detector's keypoint offsets.

    Markers of the right side get the mirrored offsets of the left.

    Parameters
    ----------
    body : Body
        The animal.
    detector : str or path, optional
        Name or file of a detector, or "none". By default, the detector named in the subject or skeleton file or, if
        there is none, the detector that the scorers identify.
    scorers : mapping, optional
        Scorer of each keypoint file, with the files' names as keys.

    Raises
    ------
    InputError
        If a file does not fit the body, or the scorers belong to two detectors.
    """
    if detector is None and body.keypoint_offset_m:
        return replace(body, detector=OWN)
    detector = body.detector if detector is None else detector
    if detector is None and scorers:
        detector = _detector_of_scorers(scorers, body.name)
    if detector is None:
        return body
    if str(detector) == NONE:
        return replace(body, detector=NONE, keypoint_offset_m={}, keypoint_spread_m={}, keypoint_noise_m={})
    raw, source = read_named(detector, "detector")
    file = validated(_DetectorFile, raw, source)
    if file.skeleton != body.name:
        raise InputError(Problem(source, "skeleton", repr(file.skeleton), f"{body.name}, the skeleton of the fit"))
    raise_problems(unknown(source, [(f"keypoints.{marker}", marker) for marker in file.keypoints], body.markers))
    offset_m, spread_m, noise_m = {}, {}, {}
    for marker in body.markers:
        is_mirrored = marker not in file.keypoints and side_of(marker) == "right"
        keypoint = file.keypoints.get(other_side(marker) if is_mirrored else marker)
        if keypoint is not None:
            x, y, z = keypoint.offset_m
            offset_m[marker], spread_m[marker] = (x, -y if is_mirrored else y, z), keypoint.spread_m
            noise_m |= {marker: keypoint.sigma_m} if keypoint.sigma_m is not None else {}
    return replace(
        body,
        detector=str(detector),
        keypoint_sigma_m=file.keypoint_sigma_m,
        keypoint_offset_m=offset_m,
        keypoint_spread_m=spread_m,
        keypoint_noise_m=noise_m,
    )


def _detector_of_scorers(scorers: Mapping[str, str | None], skeleton: str) -> str:
    detectors = {file: detector_of_scorer(scorer, skeleton) for file, scorer in scorers.items()}
    if len({*detectors.values()}) > 1:
        files = (
            f"{Path(file).name} of {detector} (scorer {str(scorers[file])[:60]!r})"
            for file, detector in detectors.items()
        )
        expected = f"files of one detector, or a single detector for all cameras: --set detector={NONE}, or its name"
        raise InputError(Problem("KEYPOINTS", "detector", ", ".join(files), expected))
    return next(iter(detectors.values()))
