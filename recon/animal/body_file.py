"""Files that describe animals (TOML): what their tables have in common, and whole animals, which are trees of
`[[segments]]`, with the lengths of single animals.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from recon.animal.body import MIN_JOINTS, PLACES, Body, other_side, side_of
from recon.base import documents
from recon.base.documents import parse_toml, read_toml, validated
from recon.base.errors import InputError, Problem, all_of, refuse
from recon.geometry.kinematics import ANGLE_OF_AXIS, AXES, Marker, Segment, Tree

Number = Annotated[float, Field(gt=-1e6, lt=1e6, allow_inf_nan=False)]
_Share = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Sigma = Annotated[float, Field(gt=1e-9, lt=1e6, allow_inf_nan=False)]
"""More, or less, can only be damage."""


class FileTable(BaseModel):
    """A table of a file: other fields than its own are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True)


def foot_table(places: Iterable[str], example: str) -> BeforeValidator:
    """One message for whatever else stands there, and for nothing."""

    def checked(value: Any) -> Any:
        if isinstance(value, dict) and {*value} <= {*places} and all(isinstance(foot, str) for foot in value.values()):
            return value
        raise ValueError(f"a table that says where each foot is, as {example}")

    return BeforeValidator(checked)


def read_named(
    name_or_path: str | Path,
    kind: Literal["skeleton", "subject", "detector"] = "skeleton",
    suggested: Callable[[], Iterable[str]] | None = None,
) -> tuple[dict[str, Any], str]:
    """A file's tables, and what to call it in messages. suggested: names to choose from, if not all."""
    folder = f"animal/{kind}s"
    if str(name_or_path) in documents.builtin_names(folder, ".toml"):
        file = documents.builtin_file(folder, f"{name_or_path}.toml")
        return parse_toml(file.read_text(encoding="utf-8"), name_or_path), f"{kind} {name_or_path}"
    path = Path(name_or_path)
    if not os.path.isfile(path):
        names = documents.builtin_names(folder, ".toml") if suggested is None else suggested()
        expected = f"one of {', '.join(names)}, or a {kind} file (.toml)"
        option = "--set detector" if kind == "detector" else f"--{kind}"
        raise InputError(Problem(option, "name or file", repr(str(name_or_path)), expected))
    return read_toml(path), str(path)


def unknown(source: str, names: Iterable[tuple[str, str]], known: Iterable[str], what: str = "") -> Iterator[Problem]:
    """The problems of names that are not among the known ones, each with the field that it stands in."""
    known = [*known]
    for field, name in names:
        if name not in known:
            yield Problem(
                source, field, repr(name), f"{what}{', '.join(known)}" if what else f"one of {', '.join(known)}"
            )


def foot_problems(feet: dict[str, str], source: str) -> Iterator[Problem]:
    for place, foot in feet.items():
        side = side_of(foot)
        if side is not None and place in PLACES and not place.startswith(side):
            yield Problem(source, f"feet.{place}", repr(foot), f"a {place.split('_')[0]} one: by its name it is {side}")
    if len({*feet.values()}) < len(feet):
        yield Problem(source, "feet", ", ".join(feet.values()), "every foot once")


# -- whole animals ----------------------------------------------------------------------------------------------------


_BodyFeet = Annotated[
    dict[str, str],
    foot_table(
        PLACES,
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
    """By segment, and one standard deviation; 0 of what only carries markers."""


class _BodyFile(FileTable):
    name: str
    title: str
    forward: tuple[str, str]
    feet: _BodyFeet = Field(default=None, validate_default=True)
    keypoint_sigma_m: Sigma
    size_sigma: Sigma
    detector: str | None = None
    segments: tuple[_Segment, ...] = Field(min_length=1)
    markers: tuple[_Marker, ...]
    limbs: dict[str, tuple[str, ...]]
    mass: _Mass | None = None


class _SubjectFile(FileTable):
    skeleton: str
    title: str
    size_sigma: Sigma
    at_m: dict[str, Offset]
    keypoint_offset_m: dict[str, Offset] = {}


def load_body(raw: dict[str, Any], source: str, subject: str | Path | None) -> Body:
    if subject is None:
        file = validated(_BodyFile, raw, source)
        problems = [*_body_problems(file, source)]
    else:
        measured, measured_source = read_named(subject, "subject")
        file, animal = all_of(
            lambda: validated(_BodyFile, raw, source), lambda: validated(_SubjectFile, measured, measured_source)
        )
        problems = [*_subject_problems(animal, file, measured_source)]
        file = _measured(file, animal)
        problems += _body_problems(file, source)
    refuse(dict.fromkeys(problems))  # both sides of a mirrored segment can have the same
    return replace(_body(file), subject=None if subject is None else str(subject))


def _subject_problems(animal: _SubjectFile, file: _BodyFile, source: str) -> Iterator[Problem]:
    if animal.skeleton != file.name:
        yield Problem(source, "skeleton", repr(animal.skeleton), f"{file.name!r}, the skeleton that it is used with")
        return
    markers = [marker.name for marker in file.markers]
    names = [*(segment.name for segment in file.segments[1:]), *markers]
    placed = [(f"at_m.{name}", name) for name in animal.at_m]
    yield from unknown(source, placed, names, f"a segment but the root, or a marker, of {file.name}: ")
    offset = [(f"keypoint_offset_m.{name}", name) for name in animal.keypoint_offset_m]
    yield from unknown(source, offset, markers, f"a marker of {file.name}: ")


def _measured(file: _BodyFile, animal: _SubjectFile) -> _BodyFile:
    """The skeleton with an animal's lengths and keypoint offsets; the root stays."""
    at, offset = animal.at_m, animal.keypoint_offset_m
    segments = tuple(s.model_copy(update={"at_m": at.get(s.name, s.at_m)}) for s in file.segments)
    markers = tuple(
        m.model_copy(
            update={"at_m": at.get(m.name, m.at_m), "keypoint_offset_m": offset.get(m.name, m.keypoint_offset_m)}
        )
        for m in file.markers
    )
    changed = {"segments": (file.segments[0], *segments[1:]), "markers": markers}
    return file.model_copy(update={"title": animal.title, "size_sigma": animal.size_sigma, **changed})


_Item = TypeVar("_Item", _Segment, _Marker)


def _both_sides(items: Iterable[_Item]) -> Iterator[tuple[int, _Item]]:
    """Every segment or marker with its row in the file; the mirrored ones are followed by their right counterpart."""
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
    """The angles that have an expectation, in the order of the state: all but the heading of the root."""
    return [ANGLE_OF_AXIS[axis] for axis in AXES[segment.joint] if (segment.joint, axis) != ("free", "z")]


def _body_problems(file: _BodyFile, source: str) -> Iterator[Problem]:
    segments, used = list[str](), set[str]()
    for i, segment in _both_sides(file.segments):
        at = f"segments[{i}]"
        yield from _name_problems(segment, at, used, source)
        if i == 0:
            root = [("joint", segment.joint != "free", repr(segment.joint), "free: the first segment is the root")]
            root.append(
                ("parent", segment.parent is not None, repr(segment.parent), "none: the first segment is the root")
            )
            root.append(("at_m", any(segment.at_m), str([*segment.at_m]), "none: the root's origin is an unknown"))
            root.append(("mirrored", segment.mirrored, "true", "one root"))
            yield from (Problem(source, f"{at}.{field}", found, wanted) for field, bad, found, wanted in root if bad)
        elif segment.joint == "free":
            yield Problem(source, f"{at}.joint", "'free'", "ball, universal, hinge or fixed: only the root is free")
        if i > 0 and segment.parent not in segments:
            yield Problem(source, f"{at}.parent", repr(segment.parent), "the name of an earlier segment")
        expected = _expected_angles(segment)
        for angle in ANGLE_OF_AXIS.values():
            given = getattr(segment, angle) is not None
            if given != (angle in expected):
                found = "an expectation" if given else "none"
                wanted = f"{' and '.join(expected) or 'no angle'}, since its joint is {segment.joint}"
                yield Problem(source, f"{at}.{angle}", found, wanted)
        segments.append(segment.name)
    markers = []
    for i, marker in _both_sides(file.markers):
        yield from _name_problems(marker, f"markers[{i}]", used, source)
        if marker.segment not in segments:
            yield Problem(source, f"markers[{i}].segment", repr(marker.segment), "the name of a segment")
        markers.append(marker.name)
    if len(markers) < MIN_JOINTS:
        yield Problem(source, "markers", f"{len(markers)}", f"at least {MIN_JOINTS}: fewer do not place it")
    named = {"forward": file.forward, "feet": file.feet.values()} | {f"limbs.{k}": v for k, v in file.limbs.items()}
    yield from unknown(source, [(field, name) for field, names in named.items() for name in names], sorted(markers))
    if file.mass is not None:
        shares = file.mass.share
        yield from unknown(source, [(f"mass.share.{name}", name) for name in shares], sorted(segments))
        for name in sorted(segments):
            if name not in shares and other_side(name) not in shares:
                yield Problem(source, f"mass.share.{name}", "none", "a share and its sigma, as [0.05, 0.01]")
    if file.forward[0] == file.forward[1]:
        yield Problem(source, "forward", f"{file.forward[0]!r} twice", "two markers, from rear to front")
    yield from foot_problems(file.feet, source)


def _name_problems(item: _Segment | _Marker, field: str, used: set[str], source: str) -> Iterator[Problem]:
    """used: names of earlier segments and markers, which this one's joins."""
    if item.name in used:
        yield Problem(source, f"{field}.name", repr(item.name), "a name that no earlier segment or marker has")
    if item.mirrored and side_of(item.name) != "left":
        expected = "a name with a word of the left side in it, as l_paw, front_left_paw or LeftPaw"
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
        forward=f.forward,
        feet=tuple(f.feet.values()),
        foot_labels=tuple(PLACES[place] for place in f.feet),
        keypoint_sigma_m=f.keypoint_sigma_m,
        size_sigma=f.size_sigma,
        mean_rad=np.array([e.mean_rad for e in expected]),
        sigma_rad=np.array([e.sigma_rad for e in expected]),
        acceleration_rad_s2=np.array([e.acceleration_rad_s2 for e in expected]),
        keypoint_offset_m={m.name: m.keypoint_offset_m for m in markers if any(m.keypoint_offset_m)},
        detector=f.detector,
        mass={s.name: shares[s.name if s.name in shares else other_side(s.name)] for s in segments if shares},
        mass_source=None if f.mass is None else f.mass.source,
    )


def subject_toml(skeleton: str | Path, body: Body, title: str, notes: Sequence[str] = ()) -> str:
    """The text of a subject file: the lengths and keypoint offsets of a body, of that skeleton. notes: comments."""
    import tomli_w

    raw, source = read_named(skeleton)
    file = validated(_BodyFile, raw, source)
    placed = {item.name: item.offset_m for item in (*body.tree.segments, *body.tree.markers)}
    given = [item.name for item in (*file.segments[1:], *file.markers)]
    offsets = {marker.name: body.keypoint_offset_m.get(marker.name) for marker in file.markers}
    plain = {
        "skeleton": file.name,
        "title": title,
        "size_sigma": round(body.size_sigma, 4),
        "at_m": {name: [round(x, 4) for x in placed[name]] for name in given if any(placed[name])},
        "keypoint_offset_m": {name: [round(x, 4) for x in at] for name, at in offsets.items() if at is not None},
    }
    return "".join(f"# {note}\n" for note in notes) + tomli_w.dumps(plain)
