"""Skeleton files (TOML) -> Body: a tree of `[[segments]]`, or a chain of `[[links]]`.

Built-in skeletons are the files of `recon/animal/skeletons`, built-in subjects (one animal's lengths) those of
`recon/animal/subjects`.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from recon.animal.body import CHAIN_PLACES, PLACES, Body, other_side, side_of
from recon.animal.chain import MIN_JOINTS, AngleRanges, Chain, Link, PriorScales
from recon.base import package
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


def _both(given: Any) -> Any:
    """A keypoint's name on either side, or a table of both, as (left, right)."""
    if isinstance(given, dict) and {*given} == {"left", "right"}:
        return given["left"], given["right"]
    return (given, given) if isinstance(given, str) else given


_Sides = Annotated[tuple[str, str], BeforeValidator(_both)]


class _Range(FileTable):
    mean_rad: Number
    tolerance_rad: Sigma
    max_rate_rad_s: Sigma


class _Link(FileTable):
    name: str
    start: str = Field(alias="from")
    end: str = Field(alias="to")
    limb: str
    length_ratio: Sigma
    keypoint: _Sides
    theta: _Range | None = None
    phi: _Range | None = None


class _BaseLength(FileTable):
    nominal_m: Sigma
    sigma_m: Sigma


class _Prior(FileTable):
    theta_sigma_rad: Sigma
    phi_sigma_rad: Sigma
    roll_sigma_rad: Sigma
    heading_sigma_rad_per_sqrt_s: Sigma
    travel_sigma_rad: Sigma


def _foot_table(places: Iterable[str], example: str) -> BeforeValidator:
    """One message for whatever else stands there, and for nothing."""

    def checked(value: Any) -> Any:
        if isinstance(value, dict) and {*value} <= {*places} and all(isinstance(foot, str) for foot in value.values()):
            return value
        raise ValueError(f"a table that says where each foot is, as {example}")

    return BeforeValidator(checked)


_ChainFeet = Annotated[dict[str, str], _foot_table(CHAIN_PLACES, '{ fore = "J4", hind = "J8" }, with its joints')]
_BodyFeet = Annotated[
    dict[str, str],
    _foot_table(
        PLACES,
        '{ left_fore = "l_front_paw", right_fore = "r_front_paw", left_hind = "l_back_paw", right_hind = '
        '"r_back_paw" }, with its markers',
    ),
]


class _ChainFile(FileTable):
    name: str
    title: str
    root: str
    root_keypoint: _Sides
    forward: tuple[str, str]
    feet: _ChainFeet = Field(default=None, validate_default=True)
    keypoint_sigma_m: Sigma
    base_length: _BaseLength
    softness_rad: Sigma
    prior: _Prior
    links: tuple[_Link, ...] = Field(min_length=1)
    length_m: dict[str, Sigma] = {}
    """Measured lengths of links, in place of their ratios."""


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


def builtin_names() -> tuple[str, ...]:
    """Names of the skeletons that come with the package."""
    return package.builtin_names("animal/skeletons", ".toml")


def skeleton_of(keypoints: Iterable[str]) -> str | None:
    """The built-in skeleton of a whole animal whose markers, all of them, are called as some of these keypoints; of
    several the one with most."""
    names, chains = {*keypoints}, builtin_chains()
    markers = {name: {*load_skeleton(name).markers} for name in builtin_names() if name not in chains}
    fitting = [name for name, own in markers.items() if own <= names]
    return max(fitting, key=lambda name: len(markers[name]), default=None)


def builtin_chains() -> tuple[str, ...]:
    """The names of the built-in skeletons that are chains, for the frame method."""
    return tuple(name for name in builtin_names() if "segments" not in read_named(name)[0])


def builtin_subjects() -> tuple[str, ...]:
    """Names of the subjects that come with the package."""
    return package.builtin_names("animal/subjects", ".toml")


def load_skeleton(name_or_path: str | Path, subject: str | Path | None = None) -> Body:
    """The built-in skeleton of that name, or the one in a TOML file.

    subject: name or file of a measured animal, for a whole one only. Raises InputError: no such name or file, a file
    that does not describe a skeleton, or a subject of another one; every problem is named.
    """
    raw, source = read_named(name_or_path)
    if "segments" in raw:
        return _load_body(raw, source, subject)
    if subject is not None:
        expected = f"none: {source} is a chain, and a measured chain is a skeleton of its own"
        raise InputError(Problem("--subject", "name or file", repr(str(subject)), expected))
    return _load_chain(raw, source).body


def load_chain(name_or_path: str | Path) -> Chain:
    """The chain that a skeleton is, for the frame method. Raises InputError for a whole animal, too."""
    raw, source = read_named(name_or_path, suggested=builtin_chains)
    if "segments" in raw:
        expected = f"a chain for the frame method: one of {', '.join(builtin_chains())}, or a file with [[links]]"
        raise InputError(Problem("--skeleton", "name or file", repr(str(name_or_path)), expected))
    return _load_chain(raw, source)


def read_named(
    name_or_path: str | Path,
    kind: Literal["skeleton", "subject", "detector"] = "skeleton",
    suggested: Callable[[], Iterable[str]] | None = None,
) -> tuple[dict[str, Any], str]:
    """A file's tables, and what to call it in messages. suggested: names to choose from, if not all."""
    folder = f"animal/{kind}s"
    if str(name_or_path) in package.builtin_names(folder, ".toml"):
        file = package.builtin_file(folder, f"{name_or_path}.toml")
        return parse_toml(file.read_text(encoding="utf-8"), name_or_path), f"{kind} {name_or_path}"
    path = Path(name_or_path)
    if not os.path.isfile(path):
        names = package.builtin_names(folder, ".toml") if suggested is None else suggested()
        expected = f"one of {', '.join(names)}, or a {kind} file (.toml)"
        option = "--set detector" if kind == "detector" else f"--{kind}"
        raise InputError(Problem(option, "name or file", repr(str(name_or_path)), expected))
    return read_toml(path), str(path)


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


# -- chains -------------------------------------------------------------------------------------------------------


def _load_chain(raw: dict[str, Any], source: str) -> Chain:
    file = validated(_ChainFile, _extended(raw, source), source)
    refuse(_chain_problems(file, source))
    return _chain(file)


def _extended(raw: dict[str, Any], source: str) -> dict[str, Any]:
    """With the tables of the skeleton that it `extends`, where it has none of its own."""
    if "extends" not in raw:
        return raw
    if not isinstance(name := raw["extends"], str):
        raise InputError(Problem(source, "extends", repr(name), "the name or the file of a skeleton"))
    parent, parent_source = read_named(_beside(name, source))
    if "segments" in parent or "extends" in parent:
        expected = "a chain that extends none; a body's lengths stand in a subject file"
        raise InputError(Problem(source, "extends", parent_source, expected))
    return {**parent, **{key: value for key, value in raw.items() if key != "extends"}}


def _beside(name: str, source: str) -> str:
    """A skeleton that a file names: built in, or a file that lies beside it, or is found from where the user is."""
    file = os.path.join(Path(source).parent, name)
    return file if os.path.isfile(file) and name not in builtin_names() else name


def unknown(source: str, names: Iterable[tuple[str, str]], known: Iterable[str], what: str = "") -> Iterator[Problem]:
    """The problems of names that are not among the known ones, each with the field that it stands in."""
    known = [*known]
    for field, name in names:
        if name not in known:
            yield Problem(
                source, field, repr(name), f"{what}{', '.join(known)}" if what else f"one of {', '.join(known)}"
            )


def _chain_problems(file: _ChainFile, source: str) -> Iterator[Problem]:
    known = [file.root]
    for i, link in enumerate(file.links):
        if link.start not in known:
            yield Problem(source, f"links[{i}].from", repr(link.start), "the root or the `to` of an earlier link")
        if link.end in known:
            yield Problem(source, f"links[{i}].to", repr(link.end), "a joint that no earlier link ends in")
        if (link.theta is None) != (link.phi is None):
            yield Problem(source, f"links[{i}]", "only one of theta and phi", "both or neither")
        known.append(link.end)
    names = [link.name for link in file.links]
    yield from unknown(source, [(f"length_m.{name}", name) for name in file.length_m], sorted(names))
    if len(names) + 1 < MIN_JOINTS:
        yield Problem(source, "links", f"{len(names)}", f"at least {MIN_JOINTS - 1}: fewer joints do not place it")
    if not any(link.theta is None and link.start == file.root for link in file.links):
        expected = f"one from {file.root} without theta and phi: the body's forward axis lies along it"
        yield Problem(source, "links", "none without angles from the root", expected)
    ends = [*(("forward", joint) for joint in file.forward), *(("feet", joint) for joint in file.feet.values())]
    yield from unknown(source, ends, sorted(known))
    yield from _foot_problems(file.feet, source)


def _ranges(ranges: Iterable[_Range | None]) -> AngleRanges:
    rows = [(r.mean_rad, r.tolerance_rad, r.max_rate_rad_s) for r in ranges if r is not None]
    return AngleRanges(*np.array(rows, dtype=float).reshape(-1, 3).T)


def _chain(f: _ChainFile) -> Chain:
    ratios = {x.name: x.length_ratio for x in f.links}
    ratios |= {name: length_m / f.base_length.nominal_m for name, length_m in f.length_m.items()}
    return Chain(
        name=f.name,
        title=f.title,
        links=tuple(Link(x.name, x.start, x.end, x.limb, ratios[x.name], free=x.theta is not None) for x in f.links),
        joints=(f.root, *(x.end for x in f.links)),
        keypoints=(f.root_keypoint, *(x.keypoint for x in f.links)),
        forward=f.forward,
        feet=tuple(f.feet.values()),
        foot_labels=tuple(CHAIN_PLACES[place] for place in f.feet),
        theta=_ranges(x.theta for x in f.links),
        phi=_ranges(x.phi for x in f.links),
        scales=PriorScales(
            softness_rad=f.softness_rad,
            theta_rad=f.prior.theta_sigma_rad,
            phi_rad=f.prior.phi_sigma_rad,
            roll_rad=f.prior.roll_sigma_rad,
            heading_rad_per_sqrt_s=f.prior.heading_sigma_rad_per_sqrt_s,
            travel_rad=f.prior.travel_sigma_rad,
            base_length_m=f.base_length.sigma_m,
            keypoint_m=f.keypoint_sigma_m,
        ),
        nominal_base_length_m=f.base_length.nominal_m,
    )


# -- bodies -------------------------------------------------------------------------------------------------------


def _load_body(raw: dict[str, Any], source: str, subject: str | Path | None) -> Body:
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
    yield from _foot_problems(file.feet, source)


def _foot_problems(feet: dict[str, str], source: str) -> Iterator[Problem]:
    for place, foot in feet.items():
        side = side_of(foot)
        if side is not None and place in PLACES and not place.startswith(side):
            yield Problem(source, f"feet.{place}", repr(foot), f"a {place.split('_')[0]} one: by its name it is {side}")
    if len({*feet.values()}) < len(feet):
        yield Problem(source, "feet", ", ".join(feet.values()), "every foot once")


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
