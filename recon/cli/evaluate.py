"""The command `recon evaluate`: compare a reconstruction with a reference."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.table import Table
from rich.text import Text

from recon.api.options import ANYWAY
from recon.base.numbers import percent, quantity
from recon.base.settings import Option, Settings
from recon.cli.answers import Answer, table_of, verdict_texts

if TYPE_CHECKING:
    from recon.gait.evaluation import Evaluation


class _EvaluateSettings(Settings):
    """Settings of `recon evaluate`."""

    pose3d: Annotated[Path, Option(argument="POSE3D")]
    """Results of recon fit, or a file of 3D positions in metres, such as pose3d.csv."""
    truth: Annotated[Path, Option(argument="TRUTH")]
    """The reference, in the same form and with the same frame numbers, such as truth.csv."""
    unit: str | None = None
    """Unit of the reference, if its file does not state it: m, cm or mm."""
    up: str | None = None
    """Upward axis of the reference, if its file does not state it: y, z, or -y if y points down."""
    rename: str | None = None
    """New names for POSE3D's joints, or TRUTH's if POSE3D is a folder: a CSV file, or a built-in map."""
    anyway: Annotated[bool, ANYWAY] = False


def evaluate(settings: _EvaluateSettings) -> Answer:
    """Compare a reconstruction with a reference, over the joints and frames that both have.

    Example: recon evaluate results/clip truth.csv
    """
    from recon.gait.evaluation import evaluate_files

    options = settings.anyway, settings.unit, settings.up, settings.rename
    result = evaluate_files(settings.pose3d, settings.truth, *options)
    against = f"{result.pose} against the reference {result.truth}"
    notes = [*_table_notes(result), *(f"note: {note}" for note in result.notes)]
    return Answer(result.to_dict(), [*verdict_texts(result.verdict), against, _table(result), *notes])


def _table(result: Evaluation) -> Table:
    """Return a table of the errors in millimetres and percentages of good points, in total and by joint."""
    scores, shares = (result.mpjpe_m, result.mpe_m, result.scale_mpjpe_m, result.pa_mpjpe_m), dict(result.pck)

    def row(name: str, value_of: Callable[[Any], float]) -> list[str]:
        cells = [f"{1000 * value_of(error):.1f}" for error in scores] + [
            f"{percent(value_of(error))}" for error in shares.values()
        ]
        return [name, *(cell.replace("nan %", "-").replace("nan", "-") for cell in cells)]

    numbers = ("MPJPE", "MPE", "scaled", "PA", *(f"PCK {1000 * t:g}" for t in shares))
    table = table_of("errors in mm", numbers=numbers, rows=[row("all", lambda error: error.mean)])
    table.add_section()
    for j, name in enumerate(result.names):
        table.add_row(*map(Text, row(name, lambda error, j=j: error.per_joint[j])))
    return table


def _table_notes(result: Evaluation) -> Iterator[str]:
    from recon.gait.evaluation import LEVELS

    thresholds = ", ".join(f"{1000 * t:g}" for t, _ in result.pck)
    yield "MPJPE   mean distance of the joints from the reference, each frame centred"
    yield "MPE     the same distance without centring"
    yield "scaled  centred, and scaled to the size of the reference"
    yield "PA      centred, scaled and rotated onto the reference"
    yield f"PCK     fraction of the joints within {thresholds} mm, centred"
    offset_text = f"the mean of the joints is off by {quantity(1000 * result.position_m, 1, 'mm')}"
    yield f"Position: {offset_text}. The verdict's position error estimates this number, its pose error the MPJPE."
    for kind, shares in result.inside.items():
        stated, contained = (
            " and ".join(f"{100 * p:.0f}".replace("nan", "-") for p in name) for name in (LEVELS, shares)
        )
        name = {"place": "position"}.get(kind, kind)
        yield f"Uncertainty of the {name}: intervals of {stated} % contain {contained} % of the reference's coordinates"
    yield f"Compared: {len(result.frames) - result.frames_not_scored} frames, {len(result.names)} joints."
    for kind, reconstruction, reference in (
        ("Joints", result.joints_only_in_pose, result.joints_only_in_truth),
        ("Frames", _ranges(result.frames_only_in_pose), _ranges(result.frames_only_in_truth)),
    ):
        for source, names in (("reconstruction", reconstruction), ("reference", reference)):
            if names:
                yield f"{kind} only in the {source}: {', '.join(names)}"
    if result.frames_not_scored:
        yield f"Common frames without a common joint: {result.frames_not_scored}"


def _ranges(ranges: Iterable[tuple[int, int]]) -> list[str]:
    return [f"{first}" if stop == first + 1 else f"{first} to {stop - 1}" for first, stop in ranges]
