"""A skeleton file in, a description of it, remarks on what looks odd, and pictures out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from recon.animal import Body, Chain, builtin_names, load_chain, load_prior, load_skeleton, other_side
from recon.animal.chain import AngleRanges
from recon.base.files import require_free_folder
from recon.base.settings import Option, Settings
from recon.geometry.kinematics import ANGLE_OF_AXIS, AXES

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


def list_skeletons() -> list[Row]:
    """Those that come with the package: name, title, kind, and how many markers and unknowns they have."""
    return [
        {name: c[name] for name in ("name", "title", "kind")}
        | {"markers": len(c["markers"]), "unknowns": c["unknowns"]}
        for c in map(check_skeleton, builtin_names())
    ]


class SkeletonCheckSettings(Settings):
    """What `recon skeleton check` is told."""

    skeleton: Annotated[
        str, Option("A TOML file, or the name of a built-in skeleton, as in my-dog.toml.", argument="SKELETON")
    ]
    subject: Annotated[str | None, Option("Lengths measured on one animal: built-in name or TOML file.")] = None
    out: Annotated[Path | None, Option("Folder for pictures (skeleton, angles: PNG and SVG).")] = None
    overwrite: Annotated[bool, Option("Replace pictures in the folder.")] = False


def run_skeleton_check(settings: SkeletonCheckSettings) -> Row:
    """`recon skeleton check`: read and describe a skeleton, and draw it into the folder `out`. Raises InputError."""
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


def _part(*values: Any) -> Row:
    """A segment or a link. parent: the segment that it turns on, empty for the root, or the joint where the link
    begins; end: the joint where that ends; length_m: from the parent's origin to its own, or along the link; points:
    markers on it, or the keypoints of the link's end."""
    return dict(zip(("name", "parent", "end", "joint", "length_m", "angles", "points"), values, strict=True))


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
        yield _part(segment.name, segment.parent or "", "", segment.joint, length_m, rows, markers)


def _links(chain: Chain) -> Iterator[Row]:
    a = 0
    for link, names in zip(chain.links, chain.keypoints[1:], strict=True):
        rows = []
        if link.free:
            rows = [_range(name, ranges, a) for name, ranges in (("theta", chain.theta), ("phi", chain.phi))]
            a += 1
        length_m = link.length_ratio * chain.nominal_base_length_m
        joint, points = "free" if link.free else "fixed", [*dict.fromkeys(names)]
        yield _part(link.name, link.start, link.end, joint, length_m, rows, points)


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
        yield f"feet: in the expected pose {_names_text(high)} not below {' and '.join(body.forward)}."
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
        yield f"limbs: no line leads to {_names_text(lacking)}."
    yield from _side_remarks(body, at)
    if loose := _loose_angles(body):
        yield f"segments: no marker is moved by {_names_text(loose)}: they stay at their means."


def _side_remarks(body: Body, at: dict[str, np.ndarray]) -> Iterator[str]:
    side_of = body.side_of
    single = [m for m in body.markers if side_of(m) is not None and other_side(m) not in at]
    if single:
        yield f"markers: only one side has {_names_text(single)}."
    wrong = [m for m, p in at.items() if (side_of(m) == "left" and p[1] < 0) or (side_of(m) == "right" and p[1] > 0)]
    if wrong:
        yield f"markers: on the other side of the middle (y is to the left) {_names_text(wrong)}."
    uneven = [
        m
        for m, p in at.items()
        if side_of(m) == "left" and other_side(m) in at and np.abs(p - at[other_side(m)] * (1, -1, 1)).max() > _SAME_M
    ]
    if uneven and not wrong:
        yield f"markers: not the mirror image of the other side {_names_text(uneven)}."


def _loose_angles(body: Body) -> list[str]:
    """Angles that move no marker: of segments without one, or about a line through all markers that follow."""
    rng = np.random.default_rng(0)
    states = np.zeros((4, body.n_state))
    states[:, 4:] = rng.normal(body.mean_rad, 0.3 * body.sigma_rad, (4, body.n_state - 4))
    moved = body.tree.pose_with_jacobian(states).jacobian
    assert moved is not None
    still = np.abs(moved[..., 4:]).max(axis=(0, 1, 2)) < _SAME_M
    return [name for name, is_still in zip(body.state_names[4:], still, strict=True) if is_still]


def _names_text(names: Sequence[str]) -> str:
    return ", ".join(names)


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
