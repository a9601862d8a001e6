"""`recon skeleton`."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.table import Table
from rich.text import Text

from recon.base.words import length_text
from recon.workflows.cli.common import say, table_of, terminal
from recon.workflows.skeleton_check import Row, SkeletonCheckSettings, list_skeletons, run_skeleton_check
from recon.workflows.skeleton_draft import SkeletonDraftSettings, run_skeleton_draft


def skeleton_list(as_json: bool) -> Any:
    """List the skeletons that come with the package.

    Example: recon skeleton list
    """
    found = list_skeletons()
    if as_json:
        return found
    table = table_of("name", "kind", numbers=("markers", "unknowns"))
    table.add_column("title")
    for row in found:
        name, title, kind, *numbers = row.values()
        table.add_row(Text(name), kind, *map(str, numbers), Text(title))
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
    for line in _summary(check):
        say(console, line)
    for table in [_chain_table(check)] if check["kind"] == "chain" else _body_tables(check):
        console.print(table)
    for line in _notes(check, settings.out):
        say(console, line)


def skeleton_from_keypoints(settings: SkeletonDraftSettings) -> None:
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


def _summary(check: Row) -> Iterator[str]:
    yield f"{check['name']}: {check['title']}"
    yield (
        f"A {check['kind']} with {len(check['markers'])} markers and {check['unknowns']} unknowns a frame, "
        f"{length_text(check['length_m'])} long and {length_text(check['height_m'])} high in its expected pose "
        f"(size ± {100 * check['size_sigma']:.0f} %, keypoints within {100 * check['keypoint_sigma_m']:.0f} cm)."
    )


def _body_tables(check: Row) -> Iterator[Table]:
    """Segments, then markers: left and right in one row where they are mirror images."""
    table = table_of("segment", "turns on", numbers=("m", "yaw °", "pitch °", "roll °"))
    for part, star in _pairs_as_one(check["parts"], _alike):
        length = f"{part['length_m']:.3f}" if part["parent"] else ""
        ranges = _ranges(part, ("yaw", "pitch", "roll"), "")
        table.add_row(Text(part["name"] + star), Text(part["parent"]), length, *ranges)
    yield table
    table = table_of("marker", "on segment", numbers=("x m", "y m", "z m"))
    for marker, star in _pairs_as_one(check["markers"], _opposite):
        numbers = (f"{x:.3f}" for x in marker["at_m"])
        table.add_row(Text(marker["name"] + star), Text(marker["segment"]), *numbers)
    yield table


def _pairs_as_one(rows: Sequence[Row], alike: Callable[[Row, Row], bool]) -> Iterator[tuple[Row, str]]:
    """Rows without the right ones that are alike their left counterparts, and the star of these."""
    from recon.animal.body import other_side, side_of

    named = {row["name"]: row for row in rows}
    for row in rows:
        twin = named.get(other_side(row["name"])) if side_of(row["name"]) else None
        paired = twin is not None and alike(row, twin)
        if not (paired and side_of(row["name"]) == "right"):
            yield row, " *" if paired else ""


def _alike(part: Row, twin: Row) -> bool:
    """Mirror images: yaw and roll with the opposite sign."""
    return (
        part["joint"] == twin["joint"]
        and abs(part["length_m"] - twin["length_m"]) < 1e-9
        and all(
            abs(a["mean_deg"] - (b["mean_deg"] if a["name"] == "pitch" else -b["mean_deg"])) < 1e-9
            and abs((a["high_deg"] - a["low_deg"]) - (b["high_deg"] - b["low_deg"])) < 1e-9
            for a, b in zip(part["angles"], twin["angles"], strict=True)
        )
    )


def _opposite(marker: Row, twin: Row) -> bool:
    from recon.animal.body import other_side

    (x, y, z), on = marker["at_m"], other_side(marker["segment"])
    return on == twin["segment"] and max(abs(a - b) for a, b in zip((x, -y, z), twin["at_m"], strict=True)) < 1e-9


def _chain_table(check: Row) -> Table:
    table = table_of("link", "from", "to", numbers=("length m", "theta °", "phi °"))
    table.add_column("keypoints of its end")
    for part in check["parts"]:
        numbers = f"{part['length_m']:.3f}", *_ranges(part, ("theta", "phi"), "-")
        names = (Text(part[name]) for name in ("name", "parent", "end"))
        table.add_row(*names, *numbers, Text(", ".join(part["points"])))
    return table


def _ranges(part: Row, names: Sequence[str], none: str) -> Iterator[str]:
    angles = {angle["name"]: f"{angle['low_deg']:.0f} to {angle['high_deg']:.0f}" for angle in part["angles"]}
    return (angles.get(name, none) for name in names)


def _notes(check: Row, out: Path | None) -> Iterator[str]:
    if check["kind"] == "chain":
        yield "Angles: the expected range, relative to the link before; - for none."
    else:
        yield "Angles: mean ± 2 standard deviations. *: the same on the right, mirrored."
    yield f"Feet: {', '.join(f'{foot} ({label})' for label, foot in check['feet'].items()) or 'none'}"
    for limb, markers in check["limbs"].items():
        yield f"Limb {limb}: {', '.join(markers)}"
    if check["kind"] == "whole animal":
        alone = "none, each angle on its own" if check["prior"] == "none" else check["prior"]
        yield f"Prior of a fit, unless --prior says otherwise: {alone}"
    yield from (f"Look at this: {remark}" for remark in check["remarks"])
    if not check["remarks"]:
        yield "Nothing looks odd."
    if out is not None:
        yield f"Pictures are in {out}."
