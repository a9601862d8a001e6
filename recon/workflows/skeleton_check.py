"""`recon skeleton list` and `check`: a description of skeletons, remarks on what looks odd, and pictures."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from rich.table import Table

from recon.animal import Body, builtin_names, load_prior, load_skeleton, other_side
from recon.base.errors import length_text
from recon.base.files import require_free_folder
from recon.base.settings import Option, Settings
from recon.geometry.kinematics import ANGLE_OF_AXIS, AXES
from recon.show.plain import picked
from recon.workflows.cli.common import Answer, table_of

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
    found = [
        {name: c[name] for name in shown} | {"markers": len(c["markers"])} for c in map(check_skeleton, builtin_names())
    ]
    return Answer(found, [table_of(*shown, rows=(map(str, row.values()) for row in found))])


def skeleton_check(settings: _SkeletonCheckSettings) -> Answer:
    """Check a skeleton file, list what is in it, and draw it.

    Example: recon skeleton check my-dog.toml --out my-dog

    Exit code 0: it can be used. 2: it cannot; every problem is named.
    """
    check, out = check_skeleton(settings.skeleton, settings.subject), settings.out
    if out is not None:
        from recon.show.plots.skeleton import angle_ranges, views
        from recon.show.plots.style import save

        pictures = [f"{stem}{end}" for stem in STEMS for end in (".png", ".svg")]
        require_free_folder(out, pictures, settings.overwrite, "these pictures")
        body, title = load_skeleton(settings.skeleton, settings.subject), f"{check['name']}: {check['title']}"
        for stem, figure in zip(STEMS, (views(body, title), angle_ranges(body, REACH_SIGMAS, title)), strict=True):
            save(figure, out, stem)
    return Answer(check, [*_lines(check), *([] if out is None else [f"Pictures are in {out}."])])


def _lines(check: dict[str, Any]) -> Iterator[str | Table]:
    yield f"{check['name']}: {check['title']}"
    yield (
        f"A {check['kind']} with {len(check['markers'])} markers and {check['unknowns']} unknowns a frame, "
        f"{length_text(check['length_m'])} long and {length_text(check['height_m'])} high in its expected pose "
        f"(size ± {100 * check['size_sigma']:.0f} %, keypoints within {100 * check['keypoint_sigma_m']:.0f} cm)."
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
    yield f"Feet: {', '.join(f'{foot} ({label})' for label, foot in check['feet'].items()) or 'none'}"
    yield from (f"Limb {limb}: {', '.join(markers)}" for limb, markers in check["limbs"].items())
    yield f"Prior of a fit, unless --prior says otherwise: {check['prior']}"
    yield from [f"Look at this: {remark}" for remark in check["remarks"]] or ["Nothing looks odd."]


def check_skeleton(name_or_path: str | Path, subject: str | Path | None = None) -> dict[str, Any]:
    """What a skeleton's file describes: `length_m` and `height_m` are those of the expected pose, `unknowns` those of a
    frame, `prior` is the one that a fit takes by default, and `remarks` say what is allowed, but looks like a mistake.
    Raises InputError, naming every problem, for a file that describes no skeleton."""
    body = load_skeleton(name_or_path, subject)
    points = body.expected_points_m()
    length, _, height = np.ptp(points, axis=0).tolist()
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
        "markers": [{"name": m.name, "segment": m.segment, "at_m": m.offset_m} for m in body.tree.markers],
    }


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
    points = body.expected_points_m()
    at = dict(zip(body.markers, points, strict=True))
    rear, front = (at[marker] for marker in body.forward)
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
