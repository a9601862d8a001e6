"""Skeleton files (TOML) -> Skeleton. Built-in skeletons are the files of `recon/skeletons`."""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, PositiveFloat, ValidationError

from recon.errors import InputError, Problem
from recon.skeleton import MIN_JOINTS, AngleRanges, Link, PriorScales, Skeleton


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _Sides(_Table):
    left: str
    right: str


class _Range(_Table):
    mean_rad: float
    tolerance_rad: PositiveFloat
    max_rate_rad_s: PositiveFloat


class _Link(_Table):
    name: str
    start: str = Field(alias="from")
    end: str = Field(alias="to")
    limb: str
    length_ratio: PositiveFloat
    keypoint: str | _Sides
    theta: _Range | None = None
    phi: _Range | None = None


class _BaseLength(_Table):
    nominal_m: PositiveFloat
    sigma_m: PositiveFloat


class _Prior(_Table):
    theta_sigma_rad: PositiveFloat
    phi_sigma_rad: PositiveFloat
    roll_sigma_rad: PositiveFloat
    heading_sigma_rad_per_sqrt_s: PositiveFloat
    travel_sigma_rad: PositiveFloat


class _SkeletonFile(_Table):
    name: str
    title: str
    root: str
    root_keypoint: str | _Sides
    forward: tuple[str, str]
    keypoint_sigma_m: PositiveFloat
    base_length: _BaseLength
    softness_rad: PositiveFloat
    prior: _Prior
    links: tuple[_Link, ...] = Field(min_length=1)


def builtin_names() -> tuple[str, ...]:
    """Names of the skeletons that come with the package."""
    files = resources.files("recon") / "skeletons"
    return tuple(sorted(f.name.removesuffix(".toml") for f in files.iterdir() if f.name.endswith(".toml")))


def load_skeleton(name_or_path: str | Path) -> Skeleton:
    """The built-in skeleton of that name, or the one in a TOML file.

    Raises InputError: no such name or file, or a file that does not describe a chain; every problem is named.
    """
    raw, source = _read(name_or_path)
    if "extends" in raw:
        raw = _extended(raw, source)
    try:
        parsed = _SkeletonFile.model_validate(raw)
    except ValidationError as error:
        raise InputError(
            Problem(source, ".".join(str(p) for p in e["loc"]), repr(e["input"])[:60], e["msg"]) for e in error.errors()
        ) from None
    problems = list(_chain_problems(parsed, source))
    if problems:
        raise InputError(problems)
    return _skeleton(parsed)


def _read(name_or_path: str | Path) -> tuple[dict[str, Any], str]:
    if str(name_or_path) in builtin_names():
        file = resources.files("recon") / "skeletons" / f"{name_or_path}.toml"
        return tomllib.loads(file.read_text(encoding="utf-8")), f"skeleton {name_or_path}"
    path = Path(name_or_path)
    if not path.is_file():
        expected = f"one of {', '.join(builtin_names())}, or a skeleton file (.toml)"
        raise InputError(Problem("--skeleton", "name or file", repr(str(name_or_path)), expected))
    try:
        return tomllib.loads(path.read_text(encoding="utf-8")), str(path)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(Problem(path, "content", str(error), "a TOML file")) from None


def _extended(raw: dict[str, Any], source: str) -> dict[str, Any]:
    """`extends` takes another skeleton's tables; `length_m` gives its links measured lengths."""
    name, lengths = raw["extends"], raw.get("length_m", {})
    if not isinstance(name, str):
        raise InputError(Problem(source, "extends", repr(name), f"one of {', '.join(builtin_names())}, or a file"))
    if not isinstance(lengths, dict):
        raise InputError(Problem(source, "length_m", repr(lengths), "a table of lengths in metres by link"))
    parent, parent_source = _read(name)
    if "extends" in parent:
        raise InputError(Problem(source, "extends", parent_source, "a skeleton that does not extend another"))
    if lengths and "links" in raw:
        raise InputError(Problem(source, "length_m", "links beside it", "one of the two"))
    links = [dict(link) for link in parent.get("links", [])]
    base = raw.get("base_length", parent.get("base_length", {})).get("nominal_m")
    names = {str(link.get("name")) for link in links}
    problems = [
        Problem(source, f"length_m.{name}", repr(length), f"a length in metres of one of {', '.join(sorted(names))}")
        for name, length in lengths.items()
        if name not in names or not isinstance(length, int | float)
    ]
    if lengths and not isinstance(base, int | float):
        problems.append(Problem(source, "base_length.nominal_m", repr(base), "a length in metres"))
    if problems:
        raise InputError(problems)
    for link in links:
        if link["name"] in lengths:
            link["length_ratio"] = lengths[link["name"]] / base
    own = {key: value for key, value in raw.items() if key not in ("extends", "length_m")}
    return {**parent, "links": links, **own}


def _chain_problems(parsed: _SkeletonFile, source: str):
    known = {parsed.root}
    for i, link in enumerate(parsed.links):
        if link.start not in known:
            yield Problem(source, f"links.{i}.from", repr(link.start), "the root or the `to` of an earlier link")
        if link.end in known:
            yield Problem(source, f"links.{i}.to", repr(link.end), "a joint that no earlier link ends in")
        if (link.theta is None) != (link.phi is None):
            yield Problem(source, f"links.{i}", "only one of theta and phi", "both or neither")
        known.add(link.end)
    if len(parsed.links) + 1 < MIN_JOINTS:
        yield Problem(
            source, "links", f"{len(parsed.links)}", f"at least {MIN_JOINTS - 1}: fewer joints do not place it"
        )
    if not any(link.theta is None and link.start == parsed.root for link in parsed.links):
        expected = f"one from {parsed.root} without theta and phi: the body's forward axis lies along it"
        yield Problem(source, "links", "none without angles from the root", expected)
    for joint in parsed.forward:
        if joint not in known:
            yield Problem(source, "forward", repr(joint), f"one of {', '.join(sorted(known))}")


def _sides(keypoint: str | _Sides) -> tuple[str, str]:
    return (keypoint, keypoint) if isinstance(keypoint, str) else (keypoint.left, keypoint.right)


def _ranges(links: tuple[_Link, ...], kind: Literal["theta", "phi"]) -> AngleRanges:
    ranges = [r for link in links if (r := getattr(link, kind)) is not None]
    columns = ([r.mean_rad for r in ranges], [r.tolerance_rad for r in ranges], [r.max_rate_rad_s for r in ranges])
    return AngleRanges(*(np.array(c, dtype=float) for c in columns))


def _skeleton(f: _SkeletonFile) -> Skeleton:
    return Skeleton(
        name=f.name,
        title=f.title,
        links=tuple(Link(x.name, x.start, x.end, x.limb, x.length_ratio, free=x.theta is not None) for x in f.links),
        joints=(f.root, *(x.end for x in f.links)),
        keypoints=(_sides(f.root_keypoint), *(_sides(x.keypoint) for x in f.links)),
        forward=f.forward,
        theta=_ranges(f.links, "theta"),
        phi=_ranges(f.links, "phi"),
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
