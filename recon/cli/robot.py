"""The commands `recon robot pose` and `recon robot dh` for a robot's kinematics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import degrees, isinf
from typing import Any

from rich.table import Table

from recon.cli.answers import Answer, table_of
from recon.robotics.settings import PoseSettings, TableSettings


def pose(settings: PoseSettings) -> Answer:
    """Print the leg angles of a robot whose body is moved and turned while the feet stay planted.

    Example: recon robot pose aibo --pitch 10 --move 0,0,-0.01
    """
    from recon.robotics.dh import pose_answer

    answer = pose_answer(settings)
    table = table_of("leg", "joint", numbers=("angle °", "foot x m", "y m", "z m"), title=answer["robot"])
    for label, leg in answer["legs"].items():
        joints, angles_rad = leg["joints"], leg["angles_rad"]
        angles = ["-"] * len(joints) if angles_rad is None else _deg(angles_rad)
        for k, row in enumerate(zip(joints, angles, strict=True)):
            table.add_row("" if k else label, *row, *(f"{x:.4f}" for x in leg["foot_m"] if not k))
    reasons = [f"{label}: {leg['why']}" for label, leg in answer["legs"].items() if leg["why"]]
    return Answer(answer, [table, *reasons])


def dh(settings: TableSettings) -> Answer:
    """Print a leg's Denavit-Hartenberg table, its end position for given angles, and angles for a given end position.

    Example: recon robot dh aibo --tip LF --place 0.09,0.07,-0.1
    """
    from recon.robotics.dh import table_answer

    answer = table_answer(settings)
    return Answer(answer, _chain_lines(answer, f"{settings.source} {settings.tip or ''}".strip()))


def _chain_lines(answer: dict[str, Any], title: str) -> Iterator[str | Table]:
    slides, columns = answer["slides"], ("a m", "alpha °", "d m", "theta °", "least", "most")
    table = table_of("joint", numbers=columns, title=f"{title}: {answer['dh']['convention']}")
    limits = zip(answer["lower"], answer["upper"], strict=True)
    for name, row, limit, slide in zip(answer["joints"], answer["dh"]["rows"], limits, slides, strict=True):
        values = (row[column] for column in ("a_m", "alpha_rad", "d_m", "theta_rad"))
        table.add_row(name, *_typed([*values, *limit], [True, False, True, False, slide, slide]))
    yield table
    yield from (f"{name}: {_pose_text(answer['dh'][name])}" for name in ("base", "tool") if name in answer["dh"])
    if "forward" in answer:
        beyond = "" if answer["forward"]["within_limits"] else "; beyond a joint's limits"
        yield f"end: {_pose_text(answer['forward'])}{beyond}"
    if "inverse" in answer:
        rows = [
            [str(k), *_typed(solution["q"], slides), "yes" if solution["within_limits"] else "no"]
            for k, solution in enumerate(answer["inverse"]["solutions"], start=1)
        ]
        if rows:
            yield table_of("solution", numbers=(*answer["joints"], "within limits"), rows=rows)
        if answer["inverse"]["note"]:
            yield answer["inverse"]["note"]


def _pose_text(answer: dict[str, Any]) -> str:
    position = ", ".join(f"{x:z.4f}" for x in answer["place_m"])
    return f"at ({position}) m, roll, pitch and yaw ({', '.join(_deg(answer['roll_pitch_yaw_rad']))})°"


def _typed(values: Sequence[float], slides: Sequence[bool]) -> list[str]:
    """Return angles (rad) as strings in degrees, and, where `slides` is true, lengths (m) as strings in metres."""
    return [f"{x:z.4f}" if slide else _deg([x])[0] for x, slide in zip(values, slides, strict=True)]


def _deg(angles_rad: Sequence[float]) -> list[str]:
    return ["any" if isinf(x) else f"{degrees(x):z.2f}" for x in angles_rad]
