"""The commands of `recon robot`: pose, leg, dh and arm."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees, isinf
from typing import Any

import typer
from rich.console import Console

from recon.robotics.settings import PoseSettings, TableSettings
from recon.workflows.cli.common import numbers, say, table_of, terminal


def pose(settings: PoseSettings, as_json: bool) -> None:
    """The legs' angles of a body that is moved and turned, the feet planted.

    Example: recon robot pose aibo --pitch 10 --move 0,0,-0.01
    """
    from recon.robotics.robot.answers import pose_of

    answer = pose_of(settings)
    if as_json:
        _json(answer)
        return
    console = terminal()
    table = table_of("leg", "joint", numbers=("angle °", "foot x m", "y m", "z m"), title=answer["robot"])
    for label, leg in answer["legs"].items():
        foot = [f"{x:.4f}" for x in leg["foot_m"]]
        degrees = ["-"] * len(leg["joints"]) if leg["angles_rad"] is None else _deg(leg["angles_rad"])
        for k, (name, angle) in enumerate(zip(leg["joints"], degrees, strict=True)):
            table.add_row(*((label, name, angle, *foot) if k == 0 else ("", name, angle, "", "", "")))
    console.print(table)
    for label, leg in answer["legs"].items():
        if leg["why"]:
            say(console, f"{label}: {leg['why']}")


def dh(settings: TableSettings, as_json: bool) -> None:
    """The Denavit-Hartenberg table of a chain or a robot's leg, its end at given angles, and all angles of a given end.

    Example: recon robot dh aibo --tip LF --place 0.09,0.07,-0.1
    """
    from recon.robotics.robot.answers import chain_of

    answer = chain_of(settings, _angles(settings.angles))
    if as_json:
        _json(answer)
        return
    _print_chain(terminal(), answer, f"{settings.source} {settings.tip or ''}".strip())


def _print_chain(console: Console, answer: dict[str, Any], title: str) -> None:
    slides = answer["slides"]
    table = table_of(
        "joint",
        numbers=("a m", "alpha °", "d m", "theta °", "least", "most"),
        title=f"{title}: {answer['dh']['convention']}",
    )
    limits = zip(answer["lower"], answer["upper"], strict=True)
    for name, row, limit, slide in zip(answer["joints"], answer["dh"]["rows"], limits, slides, strict=True):
        alpha, theta = _deg((row["alpha_rad"], row["theta_rad"]))
        table.add_row(name, f"{row['a_m']:z.4f}", alpha, f"{row['d_m']:z.4f}", theta, *_typed(limit, [slide] * 2))
    console.print(table)
    for name in (name for name in ("base", "tool") if name in answer["dh"]):
        say(console, f"{name}: {_pose_text(answer['dh'][name])}")
    if "forward" in answer:
        beyond = "" if answer["forward"]["within_limits"] else "; beyond a joint's limits"
        say(console, f"end: {_pose_text(answer['forward'])}{beyond}")
    if "inverse" in answer:
        every = answer["inverse"]["solutions"]
        table = table_of("solution", numbers=(*answer["joints"], "within limits"))
        for k, solution in enumerate(every):
            table.add_row(str(k + 1), *_typed(solution["q"], slides), "yes" if solution["within_limits"] else "no")
        if every:
            console.print(table)
        if answer["inverse"]["note"]:
            say(console, answer["inverse"]["note"])


def _pose_text(answer: dict[str, Any]) -> str:
    place = ", ".join(f"{x:z.4f}" for x in answer["place_m"])
    return f"at ({place}) m, roll, pitch and yaw ({', '.join(_deg(answer['roll_pitch_yaw_rad']))})°"


def _typed(values: Sequence[float], slides: Sequence[bool]) -> list[str]:
    """As a user types them: degrees, or metres."""
    return [f"{x:z.4f}" if slide else _deg([x])[0] for x, slide in zip(values, slides, strict=True)]


def _deg(angles_rad: Sequence[float]) -> list[str]:
    return ["any" if isinf(x) else f"{degrees(x):z.2f}" for x in angles_rad]


def _json(answer: dict[str, Any]) -> None:
    from recon.show.report import to_json

    typer.echo(to_json(answer), nl=False)


def _angles(typed: str | None) -> list[float] | None:
    return None if typed is None else numbers("--angles", typed)
