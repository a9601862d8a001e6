"""`recon skeleton list` and `check`: a description of skeletons, remarks on what looks odd, and pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from rich.text import Text

from recon.animal import Body, Chain, builtin_names, load_chain, load_prior, load_skeleton, other_side
from recon.animal.chain import AngleRanges
from recon.base.files import require_free_folder
from recon.base.settings import Option, Settings
from recon.base.words import length_text
from recon.geometry.kinematics import ANGLE_OF_AXIS, AXES
from recon.workflows.cli.common import say, table_of, terminal

STEMS = ("skeleton", "angles")
"""Pictures, each as .png and .svg: the expected pose with names; every angle at both ends of its range."""
REACH_SIGMAS = 2.0
"""Ends of the expected range of an angle that has a Gaussian expectation."""
_SAME_M = 1e-6
_EVEN = 0.2
"""Feet at heights that differ by more than this part of the body's height are worth a remark. The expected pose is a
mean over strides, not a stance."""


Row = dict[str, Any]
"""Plain JSON types by name."""


class SkeletonCheckSettings(Settings):
    """What `recon skeleton check` is told."""

    skeleton: Annotated[
        str, Option("A TOML file, or the name of a built-in skeleton, as in my-dog.toml.", argument="SKELETON")
    ]
    subject: Annotated[str | None, Option("Lengths measured on one animal: built-in name or TOML file.")] = None
    out: Annotated[Path | None, Option("Folder for pictures (skeleton, angles: PNG and SVG).")] = None
    overwrite: Annotated[bool, Option("Replace pictures in the folder.")] = False


def skeleton_list(as_json: bool) -> Any:
    """List the skeletons that come with the package.

    Example: recon skeleton list
    """
    shown = ("name", "kind", "markers", "unknowns", "title")
    found = [
        {name: c[name] for name in shown} | {"markers": len(c["markers"])} for c in map(check_skeleton, builtin_names())
    ]
    if as_json:
        return found
    table = table_of(*shown)
    for row in found:
        table.add_row(*(Text(str(cell)) for cell in row.values()))
    terminal().print(table)


def skeleton_check(settings: SkeletonCheckSettings, as_json: bool) -> Any:
    """Check a skeleton file, list what is in it, and draw it.

    Example: recon skeleton check my-dog.toml --out my-dog

    Exit code 0: it can be used. 2: it cannot; every problem is named.
    """
    check = run_skeleton_check(settings)
    if as_json:
        return check
    console = terminal()
    say(console, f"{check['name']}: {check['title']}")
    say(
        console,
        f"A {check['kind']} with {len(check['markers'])} markers and {check['unknowns']} unknowns a frame, "
        f"{length_text(check['length_m'])} long and {length_text(check['height_m'])} high in its expected pose "
        f"(size ± {100 * check['size_sigma']:.0f} %, keypoints within {100 * check['keypoint_sigma_m']:.0f} cm).",
    )
    chain = check["kind"] == "chain"
    names, ends = (("theta", "phi"), ("end",)) if chain else (("yaw", "pitch", "roll"), ())
    table = table_of("segment", "turns on", *ends, numbers=("length m", *(f"{name} °" for name in names)))
    for part in check["parts"]:
        ranges = {angle["name"]: f"{angle['low_deg']:.0f} to {angle['high_deg']:.0f}" for angle in part["angles"]}
        texts = (Text(part[name]) for name in ("name", "parent", *ends))
        table.add_row(*texts, f"{part['length_m']:.3f}", *(ranges.get(name, "-") for name in names))
    console.print(table)
    table = table_of("marker", "on segment", numbers=("x m", "y m", "z m"))
    for marker in check["markers"]:
        table.add_row(Text(marker["name"]), Text(marker["segment"]), *(f"{x:.3f}" for x in marker["at_m"]))
    console.print(table)
    relative = "the expected range, relative to the link before" if chain else "mean ± 2 standard deviations"
    say(console, f"Angles: {relative}; - for none.")
    say(console, f"Feet: {', '.join(f'{foot} ({label})' for label, foot in check['feet'].items()) or 'none'}")
    for limb, markers in check["limbs"].items():
        say(console, f"Limb {limb}: {', '.join(markers)}")
    if not chain:
        say(console, f"Prior of a fit, unless --prior says otherwise: {check['prior']}")
    for remark in check["remarks"]:
        say(console, f"Look at this: {remark}")
    if not check["remarks"]:
        say(console, "Nothing looks odd.")
    if settings.out is not None:
        say(console, f"Pictures are in {settings.out}.")


def run_skeleton_check(settings: SkeletonCheckSettings) -> Row:
    """Read and describe a skeleton, and draw it into the folder `out`. Raises InputError."""
    check = check_skeleton(settings.skeleton, settings.subject)
    if settings.out is not None:
        _draw(check, load_skeleton(settings.skeleton, settings.subject), settings.out, settings.overwrite)
    return check


def check_skeleton(name_or_path: str | Path, subject: str | Path | None = None) -> Row:
    """What a skeleton's file describes: `length_m` and `height_m` are those of the expected pose, `unknowns` those of a
    frame, `prior` is the one that a fit takes by default, and `remarks` say what is allowed, but looks like a mistake.
    Raises InputError, naming every problem, for a file that describes no skeleton."""
    body = load_skeleton(name_or_path, subject)
    chain = load_chain(name_or_path) if body.one_sided else None
    points = body.tree.pose(_mean_state(body)[None]).points_m[0]
    length, _, height = np.ptp(points, axis=0).tolist()
    return {
        "name": body.name,
        "title": body.title,
        "kind": "chain" if chain else "whole animal",
        "unknowns": chain.n_state if chain else body.n_state,
        "length_m": length,
        "height_m": height,
        "size_sigma": body.size_sigma,
        "keypoint_sigma_m": body.keypoint_sigma_m,
        "prior": load_prior(None, body).name,
        "feet": body.feet_by_label(),
        "limbs": body.limbs,
        "remarks": [*_remarks(body)],
        "parts": [*(_links(chain) if chain else _segments(body))],
        "markers": [{"name": m.name, "segment": m.segment, "at_m": m.offset_m} for m in body.tree.markers],
    }


def _mean_state(body: Body) -> np.ndarray:
    return np.concatenate([np.zeros(4), body.mean_rad])


# -- what it consists of -------------------------------------------------------------------------------------------


def _angle(name: str, mean_deg: float, reach_deg: float, rate: str) -> Row:
    """An expected angle: the middle of its range, its ends, a chain's tolerance or `REACH_SIGMAS` standard deviations
    away, and what is expected of its changes, with its unit."""
    low_deg, high_deg = mean_deg - reach_deg, mean_deg + reach_deg
    return {"name": name, "mean_deg": mean_deg, "low_deg": low_deg, "high_deg": high_deg, "rate": rate}


def _segments(body: Body) -> Iterator[Row]:
    expected = dict(
        zip(
            body.state_names[4:], zip(body.mean_rad, body.sigma_rad, body.acceleration_rad_s2, strict=True), strict=True
        )
    )
    for segment in body.tree.segments:
        rows = []
        for axis in AXES[segment.joint]:
            name = f"{segment.name}_{ANGLE_OF_AXIS[axis]}"
            if name in expected:  # all but the root's heading
                mean, sigma, acceleration = np.rad2deg(expected[name]).tolist()
                rows.append(_angle(ANGLE_OF_AXIS[axis], mean, REACH_SIGMAS * sigma, f"{acceleration:.0f} °/s²"))
        markers = [m.name for m in body.tree.markers if m.segment == segment.name]
        length_m = float(np.linalg.norm(segment.offset_m))
        yield {
            "name": segment.name,
            "parent": segment.parent or "",
            "joint": segment.joint,
            "length_m": length_m,
            "angles": rows,
            "points": markers,
        }


def _links(chain: Chain) -> Iterator[Row]:
    a = 0
    for link, names in zip(chain.links, chain.keypoints[1:], strict=True):
        rows = []
        if link.free:
            rows = [_range(name, ranges, a) for name, ranges in (("theta", chain.theta), ("phi", chain.phi))]
            a += 1
        length_m = link.length_ratio * chain.nominal_base_length_m
        yield {
            "name": link.name,
            "parent": link.start,
            "end": link.end,
            "joint": "free" if link.free else "fixed",
            "length_m": length_m,
            "angles": rows,
            "points": [*dict.fromkeys(names)],
        }


def _range(name: str, ranges: AngleRanges, a: int) -> Row:
    mean, reach, rate = np.rad2deg([ranges.mean_rad[a], ranges.tolerance_rad[a], ranges.max_rate_rad_s[a]]).tolist()
    return _angle(name, mean, reach, f"{rate:.0f} °/s")


# -- what looks odd ------------------------------------------------------------------------------------------------


def _remarks(body: Body) -> Iterator[str]:
    points = body.tree.pose(_mean_state(body)[None]).points_m[0]
    at = dict(zip(body.markers, points, strict=True))
    rear, front = (at[marker] for marker in body.forward)
    if front[0] <= rear[0]:
        yield f"forward: in the expected pose {body.forward[1]} is not ahead (x) of {body.forward[0]}."
    if not body.feet:
        yield "feet: none. Contacts with the ground and gait need them."
    high = [foot for foot in body.feet if at[foot][2] >= min(rear[2], front[2])]
    if high:
        yield f"feet: in the expected pose {', '.join(high)} not below {' and '.join(body.forward)}."
    elif body.feet:
        heights = np.array([at[foot][2] for foot in body.feet])
        if np.ptp(heights) > _EVEN * np.ptp(points[:, 2]):
            lowest, highest = body.feet[int(heights.argmin())], body.feet[int(heights.argmax())]
            yield f"feet: in the expected pose {highest} is {100 * np.ptp(heights):.0f} cm higher than {lowest}."
    trunk = front - rear
    middle = (rear + front) / 2
    for label, foot in body.feet_by_label().items():
        fore = (at[foot] - middle) @ trunk > 0
        if fore != (label[-1] == "F"):
            there, said = ("before", "hind") if fore else ("behind", "fore")
            yield f"feet: in the expected pose {foot} lies {there} the middle of the trunk, but is a {said} foot."
    drawn = {marker for limb in body.limbs.values() for marker in limb}
    if lacking := [marker for marker in body.markers if marker not in drawn]:
        yield f"limbs: no line leads to {', '.join(lacking)}."
    yield from _side_remarks(body, at)
    if loose := _loose_angles(body):
        yield f"segments: no marker is moved by {', '.join(loose)}: they stay at their means."


def _side_remarks(body: Body, at: dict[str, np.ndarray]) -> Iterator[str]:
    side_of = body.side_of
    single = [m for m in body.markers if side_of(m) is not None and other_side(m) not in at]
    if single:
        yield f"markers: only one side has {', '.join(single)}."
    wrong = [m for m, p in at.items() if (side_of(m) == "left" and p[1] < 0) or (side_of(m) == "right" and p[1] > 0)]
    if wrong:
        yield f"markers: on the other side of the middle (y is to the left) {', '.join(wrong)}."
    uneven = [
        m
        for m, p in at.items()
        if side_of(m) == "left" and other_side(m) in at and np.abs(p - at[other_side(m)] * (1, -1, 1)).max() > _SAME_M
    ]
    if uneven and not wrong:
        yield f"markers: not the mirror image of the other side {', '.join(uneven)}."


def _loose_angles(body: Body) -> list[str]:
    """Angles that move no marker: of segments without one, or about a line through all markers that follow."""
    rng = np.random.default_rng(0)
    states = np.zeros((4, body.n_state))
    states[:, 4:] = rng.normal(body.mean_rad, 0.3 * body.sigma_rad, (4, body.n_state - 4))
    moved = body.tree.pose_with_jacobian(states).jacobian
    assert moved is not None
    still = np.abs(moved[..., 4:]).max(axis=(0, 1, 2)) < _SAME_M
    return [name for name, is_still in zip(body.state_names[4:], still, strict=True) if is_still]


# -- pictures ------------------------------------------------------------------------------------------------------


def _draw(check: Row, body: Body, out: Path, overwrite: bool) -> None:
    from recon.show.plots.skeleton import angle_ranges, views
    from recon.show.plots.style import save

    pictures = [f"{stem}{end}" for stem in STEMS for end in (".png", ".svg")]
    require_free_folder(out, pictures, overwrite, "these pictures")
    rows = _by_angle(check, body)
    reach_rad = np.deg2rad([(row["high_deg"] - row["low_deg"]) / 2 for row in rows])
    low, high = ([f"{row[end]:.0f}°" for row in rows] for end in ("low_deg", "high_deg"))
    title = f"{body.name}: {body.title}"
    figures = views(body, title), angle_ranges(body, low, high, reach_rad, title)
    for stem, figure in zip(STEMS, figures, strict=True):
        save(figure, out, stem)


def _by_angle(check: Row, body: Body) -> list[Row]:
    """What the body expects of each angle of state[4:]."""
    if check["kind"] == "whole animal":
        return [row for part in check["parts"] for row in part["angles"]]
    of_links = {f"{row['name']}_{part['end'].lstrip('J')}": row for part in check["parts"] for row in part["angles"]}
    rows = []
    for name, mean, sigma in zip(body.state_names[4:], body.mean_rad, body.sigma_rad, strict=True):
        mean_deg, reach_deg = np.rad2deg([mean, REACH_SIGMAS * sigma]).tolist()
        rows.append(of_links.get(name, _angle(name.rsplit("_", 1)[1], mean_deg, reach_deg, "")))
    return rows
