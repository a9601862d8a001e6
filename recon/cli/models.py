"""The commands for skeletons, measured animals and motion priors."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

from rich.table import Table

from recon.animal.skeleton_file import builtin_names, load_skeleton
from recon.api.model_settings import PriorFitSettings, SkeletonDraftSettings, SubjectFitSettings
from recon.api.skeleton_check import REACH_SIGMAS, check_skeleton, feet_remarks
from recon.base.numbers import counted, length_text, quantity, rounded
from recon.base.outputs import Output
from recon.base.settings import Option, Settings, input_paths
from recon.cli.answers import Answer, table_of

STEMS = ("skeleton", "angles")
"""Names of the pictures (.png, .svg) of the expected pose with names, and of each angle at both ends of its range."""


class _SkeletonCheckSettings(Settings):
    """Settings of `recon skeleton check`."""

    skeleton: Annotated[str, Option(argument="SKELETON")]
    """A TOML file, such as my-dog.toml, or the name of a built-in skeleton."""
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
    columns = ("name", "kind", "markers", "unknowns", "title")
    checks = map(check_skeleton, builtin_names())
    rows = [{name: check[name] for name in columns} | {"markers": len(check["markers"])} for check in checks]
    return Answer(rows, [table_of(*columns, rows=(map(str, row.values()) for row in rows))])


def skeleton_check(settings: _SkeletonCheckSettings) -> Answer:
    """Check a skeleton file, list its content, and draw it.

    Example: recon skeleton check my-dog.toml --out my-dog

    Exit code 0: the file can be used. 2: the file cannot be used; every problem is named.
    """
    check, out = check_skeleton(settings.skeleton, settings.subject), settings.out
    if out is not None:
        from recon.show.plots.configurations import angle_ranges, views
        from recon.show.plots.style import save

        pictures = [f"{stem}{end}" for stem in STEMS for end in (".png", ".svg")]
        inputs = input_paths(settings)
        output = Output(out, "skeleton check", settings.overwrite, inputs, content="these pictures")
        output.require(pictures)
        body, title = load_skeleton(settings.skeleton, settings.subject), f"{check['name']}: {check['title']}"
        figures = views(body, title), angle_ranges(body, REACH_SIGMAS, title)
        with output.staged() as staging:
            for stem, figure in zip(STEMS, figures, strict=True):
                save(figure, staging, stem)
    return Answer(check, [*_skeleton_lines(check), *([] if out is None else [f"Pictures are in {out}."])])


def _skeleton_lines(check: dict[str, Any]) -> Iterator[str | Table]:
    yield f"{check['name']}: {check['title']}"
    yield (
        f"A {check['kind']} with {len(check['markers'])} markers and {check['unknowns']} unknowns a frame, "
        f"{length_text(check['length_m'])} long and {length_text(check['height_m'])} high in its expected pose "
        f"(size ± {100 * check['size_sigma']:.0f} %, keypoints within {length_text(check['keypoint_sigma_m'])})."
    )
    if bones := check["bones"]:
        rows = [
            (bone["bone"], " to ".join(bone["connects"]), f"{bone['length_m']:.3f} ± {bone['sigma_m']:.3f}")
            for bone in bones
        ]
        yield table_of("bone", "connects", numbers=("length m",), rows=rows)
    if joints := check["joint_angles"]:
        yield table_of("joint angle", "from", "over", "to", rows=[(j["joint"], *j["markers"]) for j in joints])
    names = ("yaw", "pitch", "roll")
    rows = []
    for part in check["parts"]:
        ranges = {angle["name"]: f"{angle['low_deg']:.0f} to {angle['high_deg']:.0f}" for angle in part["angles"]}
        lengths = rounded(part["length_m"], 3), *(ranges.get(name, "-") for name in names)
        rows.append((part["name"], part["parent"], *lengths))
    yield table_of("segment", "parent", numbers=("from parent, m", *(f"{name} °" for name in names)), rows=rows)
    rows = [(m["name"], m["segment"], *(rounded(x, 3) for x in m["at_m"])) for m in check["markers"]]
    yield table_of("marker", "on segment", numbers=("x m", "y m", "z m"), rows=rows)
    yield "Angles: mean ± 2 standard deviations; - for none."
    if links := check.get("links"):
        rows = [(link["name"], link["from"], link["to"], f"{link['length_ratio']:.3f}") for link in links]
        yield table_of("link", "from", "to", numbers=("length / base length",), rows=rows)
        yield f"Base length: {quantity(check['base_length_m'], 3, 'm')}"
        names = check["unknown_names"]
        yield f"The {len(names)} unknowns of a frame (recon frame): {', '.join(names)}"
    yield f"Feet: {', '.join(f'{foot} ({label})' for label, foot in check['feet'].items()) or 'none'}"
    yield from (f"Limb {limb}: {', '.join(markers)}" for limb, markers in check["limbs"].items())
    yield f"Default prior of a fit: {check['prior']}"
    yield from [f"note: {remark}" for remark in check["remarks"]] or ["No value is unusual."]


def skeleton_from_keypoints(settings: SkeletonDraftSettings) -> Answer:
    """Draft a skeleton for the keypoints of a file, from their names or their distances.

    A draft from names has the proportions of the quadruped, with the keypoints as markers. A draft from several
    calibrated cameras has the bodies and joints that the distances show, regardless of the keypoints' names.

    Example: recon skeleton from-keypoints clip.csv --out my-animal.toml
    """
    from recon.api.skeleton_draft import run_skeleton_draft

    out, (markers, unplaced, _) = settings.out, run_skeleton_draft(settings)
    renamed_texts = [f"{name} as {marker}" for name, marker in markers.items() if name != marker]
    lines = [f"{out}: {len(markers)} of {len(markers) + len(unplaced)} keypoints are on the skeleton."]
    lines += [f"Renamed to the quadruped's names: {', '.join(renamed_texts)}."] if renamed_texts else []
    lines += [f"Not on the skeleton: {', '.join(unplaced)}."] if unplaced else []
    look = f"Look at it with: recon skeleton check {shlex.quote(str(out))} --out pictures"
    remarks = [*feet_remarks(load_skeleton(out))] if settings.camera else []
    content = {"out": out, "keypoints": markers, "without_place": unplaced}
    return Answer(content, [*lines, look], notes=remarks)


def prior_fit(settings: PriorFitSettings) -> Answer:
    """Fit a motion prior to results or 3D poses, and list the motions used.

    Example: recon prior fit results/run1 results/run2 --out my-cat.npz
    """
    from recon.animal.prior_fit import FRAMES_PER_COMPONENT
    from recon.api.prior_fit import run_prior_fit

    report = run_prior_fit(settings)
    cannot_hold_out = settings.check and report["held_out"] is None
    notes = (
        [f"No segment could be held out: --check needs two segments of {FRAMES_PER_COMPONENT} frames."]
        if cannot_hold_out
        else []
    )
    return Answer({"out": settings.out, **report}, [*_prior_lines(report), *notes, f"The prior is in {settings.out}."])


def _prior_lines(report: dict[str, Any]) -> Iterator[str | Table]:
    from recon.animal.prior_fit import FRAMES_PER_COMPONENT

    columns = ("frames", "fps", "speed m/s", "misfit mm", "used")
    rows = (
        (
            *(row["name"], f"{row['frames']}", f"{row['fps']:g}", f"{row['speed_m_s']:.1f}"),
            "-" if row["misfit_mm"] is None else f"{row['misfit_mm']:.1f}",
            "yes" if row["used"] else "no",
        )
        for row in report["segments"]
    )
    yield table_of("segment", numbers=columns, rows=rows)
    used, components, held_out = [row["used"] for row in report["segments"]], report["components"], report["held_out"]
    yield f"Used: {sum(used)} of {len(used)} segments, {report['frames']} frames and their mirror images."
    if components < report["components_asked"]:
        limit = f"{components} components instead of {report['components_asked']}"
        yield f"{limit}: each needs {FRAMES_PER_COMPONENT} frames."
    if report["left_out"]:
        yield f"{report['left_out']} frames of results were left out, because they have a flag or no pose."
    if report["lacking"]:
        yield f"Markers that no file has: {', '.join(report['lacking'])}"
    for path, size in report["sizes"].items():
        if size != 1.0:
            yield f"{path}: {size:.3f} times the skeleton's lengths"
    if held_out is not None:
        yield (
            "Held-out log-likelihood per frame: {mixture:.2f} with {components} components, {one_gaussian:.2f} with "
            "one Gaussian"
        ).format(**held_out)


def subject_fit(settings: SubjectFitSettings) -> Answer:
    """Measure one animal in clips filmed by several cameras, for `recon fit --subject`.

    With --no-lengths, only the detector is measured, for `recon fit --set detector`, and the clips may show several
    measured animals.

    Example: recon subject fit results/run1 results/run2 --offsets --out my-cat.toml
    """
    from recon.api.subject_fit import run_subject_fit

    report = run_subject_fit(settings)
    return Answer({"out": settings.out, **report}, _subject_lines(report, settings.out))


def _subject_lines(report: dict[str, Any], out: Path) -> Iterator[str | Table]:
    lengths, offsets = ([row for row in report["values"] if row["unit"] == unit] for unit in ("m", "mm"))
    if bones := report["bones"]:
        rows = [
            (
                bone["bone"],
                " to ".join(bone["connects"]),
                f"{bone['length_m']:.3f} ± {bone['sigma_m']:.3f}",
                "{:.3f} to {:.3f}".format(*bone["interval_m"]),
                f"{100 * bone['data_share']:.0f} %",
            )
            for bone in bones
        ]
        yield table_of("bone", "connects", numbers=("length m", "90 %", "from pixels"), rows=rows)
    named = {offset for bone in report["bones"] for offset in bone["offsets"]}
    if unnamed := [row for row in lengths if row["name"] not in named]:
        rows = ((row["name"], f"{row['value']:.3f}", f"{row['sigma']:.3f}") for row in unnamed)
        yield table_of("offset of" if named else "length of", numbers=("m", "±"), rows=rows)
    if offsets:
        rows = []
        for axes in zip(offsets[::3], offsets[1::3], offsets[2::3], strict=True):
            sigma = max(row["sigma"] for row in axes)
            values = (f"{row['value']:.0f}" for row in axes)
            rows.append((axes[0]["name"].removesuffix("_x"), *values, f"{sigma:.0f}"))
        yield table_of("offset from the marker, mm", numbers=("forwards", "left", "up", "±"), rows=rows)
    if lengths:
        yield f"Size: {report['size']:.3f} ± {report['size_sigma']:.3f} of the skeleton's lengths."
    if not report["converged"]:
        yield "The search was stopped before it had converged: more frames would help."
    kind, use = ("subject", "--subject ") if lengths else ("detector", "--set detector=")
    yield f"From {counted(report['clips'], 'clip')}, {report['frames']} frames. The {kind} is in {out}."
    yield f"Use it with: recon fit {use}{shlex.quote(str(out))}"
