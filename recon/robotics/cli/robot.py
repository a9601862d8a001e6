"""`recon robot`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console

from recon.workflows.cli.common import number_option, numbers, say, table_of, terminal

robot = typer.Typer(
    help="A robot's kinematics: its body's pose, a leg, an arm, a table of parameters; all solutions.",
    no_args_is_help=True,
)
Robot = Annotated[str, typer.Argument(help="a1, aibo, or a file .urdf or .toml.", show_default=False)]
AsJson = Annotated[bool, typer.Option("--json", help="Print everything as JSON, metres and radians.")]
Angles = Annotated[
    str | None,
    typer.Option(help="Where is the end at these, degrees (metres of joints that slide)? As in 0,45,-90."),
]


def _degrees(help: str) -> Any:
    return number_option(help, "degrees, as in 10")


@robot.command("pose")
def pose(
    robot: Robot,
    move: Annotated[
        str, typer.Option(help="The body forwards, left and up from where it stands, metres, as in 0,0,-0.02.")
    ] = "0,0,0",
    roll: Annotated[float, _degrees("Degrees, right side down.")] = 0.0,
    pitch: Annotated[float, _degrees("Degrees, nose down.")] = 0.0,
    yaw: Annotated[float, _degrees("Degrees, to the left.")] = 0.0,
    as_json: AsJson = False,
) -> None:
    """The legs' angles of a body that is moved and turned, the feet planted.

    Example: recon robot pose aibo --pitch 10 --move 0,0,-0.01
    """
    from math import radians

    from recon.robotics.robot.answers import pose_of

    answer = pose_of(robot, numbers("--move", move, 3), *(radians(x) for x in (roll, pitch, yaw)))
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


@robot.command("leg")
def leg(
    robot: Robot,
    label: Annotated[str, typer.Argument(metavar="LEG", help="LF, RF, LH or RH.", show_default=False)],
    angles: Angles = None,
    foot: Annotated[
        str | None, typer.Option(help="All angles that put the foot there: body axes, metres, as in 0.1,0.1,-0.2.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """A leg's Denavit-Hartenberg table and limits, its foot at given angles, and all angles of a given foot.

    Example: recon robot leg aibo LF --foot 0.09,0.07,-0.1
    """
    from recon.robotics.robot.answers import leg_of

    typed = None if angles is None else numbers("--angles", angles)
    answer = leg_of(robot, label, typed, None if foot is None else numbers("--foot", foot, 3))
    if as_json:
        _json(answer)
        return
    _print_chain(terminal(), answer, f"{answer['robot']}, leg {label}")


@robot.command("dh")
def dh(
    file: Annotated[Path, typer.Argument(help="A table of parameters (.toml), or a .urdf.", show_default=False)],
    tip: Annotated[str | None, typer.Option(help="Of a URDF: the link at the end. (default: the only leaf)")] = None,
    angles: Angles = None,
    place: Annotated[
        str | None, typer.Option(help="All angles that put the end there: base axes, metres, as in 0.4,0.1,0.2.")
    ] = None,
    turned: Annotated[
        str | None,
        typer.Option(help="With --place: the end's roll, pitch and yaw, degrees, as in 0,90,0. (default: any)"),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """The Denavit-Hartenberg table of a chain, its end at given angles, and all angles of a given end.

    Example: recon robot dh arm.toml --angles 10,20,30,40,50,60
    """
    from math import radians

    from recon.robotics.robot.answers import table_of

    typed = None if angles is None else numbers("--angles", angles)
    end = None if place is None else numbers("--place", place, 3)
    turn = None if turned is None else [radians(x) for x in numbers("--turned", turned, 3)]
    answer = table_of(file, tip, typed, end, turn)
    if as_json:
        _json(answer)
        return
    _print_chain(terminal(), answer, str(file))


@robot.command("arm")
def arm(
    lengths: Annotated[str, typer.Argument(help="The two links, as in 4.5,4, in any unit.", show_default=False)],
    hand: Annotated[
        str | None, typer.Option(help="Both branches of a hand at x, y and angle (degrees), as in 3.165,-7.811,-45.")
    ] = None,
    height: Annotated[float, number_option("Of the hand.", "a number")] = 0.0,
    angles: Annotated[
        str | None, typer.Option(help="Where is the hand at this height and these degrees? As in 0.5,-75,15,15.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """The arm of a lift, two planar joints and a wrist, in closed form; without the wrist it is the arm of two links.

    Example: recon robot arm 4.5,4 --hand 3.165,-7.811,-45 --height 0.5
    """
    from math import degrees, radians

    from recon.robotics.robot.answers import arm_of

    l1, l2 = numbers("LENGTHS", lengths, 2)
    at = None if hand is None else numbers("--hand", hand, 3)
    q = None if angles is None else numbers("--angles", angles, 4)
    answer = arm_of(
        (l1, l2),
        None if at is None else [*at[:2], radians(at[2])],
        height,
        None if q is None else [q[0], *(radians(x) for x in q[1:])],
    )
    if as_json:
        _json(answer)
        return
    console = terminal()
    if "forward" in answer:
        x, y, angle = answer["forward"]["hand"]
        say(console, f"hand at {x:.4f}, {y:.4f}, turned by {degrees(angle):.2f}°, height {q[0] if q else 0:g}")
    if "inverse" in answer:
        table = table_of("branch", numbers=("height", "first °", "second °", "wrist °"))
        for k, branch in enumerate(answer["inverse"]["solutions"]):
            table.add_row(str(k + 1), f"{branch[0]:g}", *_deg(branch[1:]))
        if answer["inverse"]["solutions"]:
            console.print(table)
        if answer["inverse"]["note"]:
            say(console, answer["inverse"]["note"])


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
    from math import degrees, isinf

    return ["any" if isinf(x) else f"{degrees(x):z.2f}" for x in angles_rad]


def _json(answer: dict[str, Any]) -> None:
    from recon.show.report import to_json

    typer.echo(to_json(answer), nl=False)
