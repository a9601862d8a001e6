"""Define the command line: the list of commands, how a command is called, and how errors are reported."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Callable
from dataclasses import MISSING
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text
from typer.core import TyperCommand, TyperGroup

from recon.base.errors import InputError, Problem
from recon.base.file_names import encodable
from recon.base.interrupts import Interrupts, installed
from recon.base.settings import Option, Settings
from recon.cli.answers import EXIT_BAD_INPUT, EXIT_UNSOLVED, Answer, error_text, stop, table_of, terminal
from recon.cli.commands import HELP, SettingsCommand, make_command

if TYPE_CHECKING:
    from typer._click.core import Command, Context

CommandFunction = Callable[..., Answer]


def _fit() -> CommandFunction:
    from recon.cli.fit import fit

    return fit


def _batch() -> CommandFunction:
    from recon.cli.batch import batch

    return batch


def _run() -> CommandFunction:
    from recon.cli.video import run

    return run


def _triangulate() -> CommandFunction:
    from recon.cli.triangulate import triangulate

    return triangulate


def _demo() -> CommandFunction:
    from recon.cli.demo import demo

    return demo


def _settings() -> CommandFunction:
    return list_settings


def _view() -> CommandFunction:
    from recon.cli.show import view

    return view


def _report() -> CommandFunction:
    from recon.cli.show import report

    return report


def _analyse() -> CommandFunction:
    from recon.cli.analyse import analyse_command

    return analyse_command


def _compare() -> CommandFunction:
    from recon.cli.analyse import compare

    return compare


def _figure() -> CommandFunction:
    from recon.cli.figure import figure_command

    return figure_command


def _audit() -> CommandFunction:
    from recon.cli.audit import audit

    return audit


def _evaluate() -> CommandFunction:
    from recon.cli.evaluate import evaluate

    return evaluate


def _convert() -> CommandFunction:
    from recon.cli.convert import convert

    return convert


def _fix() -> CommandFunction:
    from recon.cli.video import fix

    return fix


def _overlay() -> CommandFunction:
    from recon.cli.show import overlay

    return overlay


def _calibrate() -> CommandFunction:
    from recon.cli.cameras import calibrate

    return calibrate


def _calibrate_extrinsics() -> CommandFunction:
    from recon.cli.cameras import extrinsics

    return extrinsics


def _camera_motion() -> CommandFunction:
    from recon.cli.cameras import camera_motion

    return camera_motion


def _camera_advice() -> CommandFunction:
    from recon.cli.cameras import camera_advice

    return camera_advice


def _label() -> CommandFunction:
    from recon.cli.video import label

    return label


def _train() -> CommandFunction:
    from recon.cli.network import train_command

    return train_command


def _predict() -> CommandFunction:
    from recon.cli.network import predict_command

    return predict_command


def _evaluate_2d() -> CommandFunction:
    from recon.cli.evaluate_2d import evaluate_2d_command

    return evaluate_2d_command


def _skeleton_list() -> CommandFunction:
    from recon.cli.models import skeleton_list

    return skeleton_list


def _skeleton_check() -> CommandFunction:
    from recon.cli.models import skeleton_check

    return skeleton_check


def _skeleton_from_keypoints() -> CommandFunction:
    from recon.cli.models import skeleton_from_keypoints

    return skeleton_from_keypoints


def _subject_fit() -> CommandFunction:
    from recon.cli.models import subject_fit

    return subject_fit


def _prior_fit() -> CommandFunction:
    from recon.cli.models import prior_fit

    return prior_fit


def _ik() -> CommandFunction:
    from recon.cli.ik import ik

    return ik


def _retarget() -> CommandFunction:
    from recon.cli.robotics import retarget_command

    return retarget_command


def _robot_pose() -> CommandFunction:
    from recon.cli.robot import pose

    return pose


def _robot_dh() -> CommandFunction:
    from recon.cli.robot import dh

    return dh


def _climb() -> CommandFunction:
    from recon.cli.robotics import climb

    return climb


def _frame() -> CommandFunction:
    from recon.cli.thesis import frame

    return frame


def _solver() -> CommandFunction:
    from recon.cli.thesis import solver

    return solver


def _doctor() -> CommandFunction:
    from recon.cli.doctor import doctor

    return doctor


COMMANDS = {
    "From a clip to its motion": {
        "fit": (_fit, "Fit one clip: keypoints and a camera in, a folder of results out."),
        "batch": (_batch, "Fit many clips in parallel. The same command continues a stopped batch."),
        "run": (_run, "Go from a video to a page: keypoints, fit, analysis, overlay, report.html."),
        "triangulate": (_triangulate, "Triangulate the keypoints of several cameras, without a skeleton."),
        "demo": (_demo, "Fit the bundled sample, and compare the result with the true motion."),
        "settings": (_settings, "List all settings of a command, including those without an option."),
    },
    "View and use results": {
        "view": (_view, "Show the playback in the rerun viewer, with the plots of its analysis."),
        "report": (_report, "Make a page of a result or a batch, to view and to share."),
        "fix": (_fix, "Correct wrong keypoints in a browser, while the animal is fitted again."),
        "analyse": (_analyse, "Compute speeds, angles, gait, vector fields and phase portraits."),
        "figure": (_figure, "Draw figures of a result for a paper: PDF, SVG or PNG, with a caption."),
        "compare": (_compare, "Compare strides and speeds of several clips, by group."),
        "audit": (_audit, "Check 2D keypoints or 3D poses from any program for faults."),
        "evaluate": (_evaluate, "Compare a result with a reference."),
        "convert": (_convert, "Write keypoints, 3D positions or results in another file format."),
        "overlay": (_overlay, "Draw a result on its video."),
    },
    "Cameras": {
        "calibrate": (_calibrate, "Calibrate a camera from pictures of a board."),
        "calibrate extrinsics": (_calibrate_extrinsics, "Find the poses of several cameras from clips of the animal."),
        "camera-motion": (_camera_motion, "Find the motion of a camera from its video."),
        "camera-advice": (_camera_advice, "Find the best position of a camera to measure an angle or a joint."),
    },
    "Keypoints from video": {
        "label": (_label, "Label frames of a video in a browser, starting without keypoints."),
        "train": (_train, "Train a small keypoint network on a few labels."),
        "predict": (_predict, "Find the keypoints in every frame of a video."),
        "evaluate-2d": (_evaluate_2d, "Compare keypoints with labels."),
    },
    "Models and priors": {
        "skeleton list": (_skeleton_list, "List the skeletons that come with the package."),
        "skeleton check": (_skeleton_check, "Check a skeleton file, list it, and draw it."),
        "skeleton from-keypoints": (_skeleton_from_keypoints, "Draft a skeleton for the points of a file."),
        "subject fit": (_subject_fit, "Measure one animal in clips of several cameras."),
        "prior fit": (_prior_fit, "Fit a motion prior to results or 3D poses."),
    },
    "Robots and the thesis": {
        "ik": (_ik, "Solve the inverse kinematics from the trunk to a foot."),
        "retarget": (_retarget, "Transfer the motion to a four-legged robot."),
        "robot pose": (_robot_pose, "Print a robot's leg angles while its body moves over planted feet."),
        "robot dh": (_robot_dh, "Solve a leg or chain by its Denavit-Hartenberg table, forward and inverse."),
        "climb": (_climb, "Plan how a four-legged robot climbs a step by potential fields."),
        "frame": (_frame, "Fit one side of the animal, one frame after the other."),
        "solver": (_solver, "Show costs, Jacobian and limits in the optimisation of recon frame."),
    },
    "This installation": {
        "doctor": (_doctor, "Check versions, optional parts, the viewer, and a fit of the sample."),
    },
}
"""Function that imports each command, and its line in `recon --help`, by heading and name of the command.

Only the called command is imported.
"""
GROUPS = {
    "skeleton": "List, check and draft skeletons.",
    "subject": "Measure the lengths of one animal, and a detector's offsets from its markers.",
    "prior": "Fit motion priors: which poses occur, and how they change.",
    "robot": "Solve a robot's kinematics: leg angles for a pose of the body, or for a position of the foot.",
}


class _Group(TyperGroup):
    """Group of commands, each of which is imported only when it is called.

    `functions` has the function that imports each command, keyed by the command's name.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        self.functions: dict[str, Callable[[], CommandFunction]] = {}

    def load(self, name: str) -> SettingsCommand:
        """Return a command by its name, which has one or two words."""
        return make_command(name, self.functions[name]())

    def resolve_command(self, ctx: Context, args: list[str]) -> tuple[str | None, Command | None, list[str]]:
        """Return the name of the called command, which has one or two words, the command, and the other arguments."""
        two_words = " ".join(args[:2])
        name, command, rest = super().resolve_command(
            ctx, [two_words, *args[2:]] if two_words in self.commands else args
        )
        is_leaf = command is not None and not isinstance(command, _Group)
        return name, self.load(str(name)) if is_leaf else command, rest


class _Commands(_Group):
    """Group of all commands in `COMMANDS`.

    If the user presses Ctrl-C, the running command ends with a one-line message and exit code 130.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        entries = ((*entry, panel) for panel, functions in COMMANDS.items() for entry in functions.items())
        for name, (function, help_text), panel in entries:
            self.functions[name] = function
            first, _, rest = name.partition(" ")
            if first not in GROUPS:
                self.add_command(TyperCommand(name, help=help_text, rich_help_panel=panel))
                continue
            options = {"help": GROUPS[first], "rich_help_panel": panel, "no_args_is_help": True}
            group = self.commands.setdefault(first, _Group(name=first, **options))
            assert isinstance(group, _Group)
            group.functions[rest] = function
            group.add_command(TyperCommand(rest, help=help_text))

    def invoke(self, ctx: Context) -> object:
        """Run the called command, and end it at Ctrl-C."""
        interrupts = installed() or Interrupts()
        try:
            interrupts.in_command = True
            return super().invoke(ctx)
        except KeyboardInterrupt:
            stop()
        finally:
            interrupts.in_command = False
            # A library may have swallowed Ctrl-C, or turned it into another exception.
            if interrupts.received and not interrupts.announced:
                stop()


app = typer.Typer(
    cls=_Commands,
    help="Measure the 3D motion of a running animal, in metres, from one camera or several, static or moving.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings=HELP,
)


def commands() -> dict[str, SettingsCommand]:
    """Return all commands, keyed by name."""
    group = _Commands()
    return {name: group.load(name) for name in group.functions}


class _ListedSettings(Settings):
    """Settings of `recon settings`."""

    command: Annotated[str, Option(argument="COMMAND")] = "fit"
    """The command, such as fit."""
    schema: bool = False
    """Print the JSON schema of config.toml instead of the list. Editors use it for completion and checks."""


def list_settings(settings: _ListedSettings) -> Answer:
    """List all settings of a command: its options, and the settings available only through --set and config.toml.

    Example: recon settings fit
    """
    if settings.schema:
        from recon.api.clip_results import config_schema

        schema = config_schema()
        return Answer(schema, [Text(json.dumps(schema, indent=1, ensure_ascii=False))])
    command = commands().get(settings.command)
    if command is None:
        raise InputError(Problem("COMMAND", "command", repr(settings.command), f"one of {', '.join(commands())}"))
    rows = [
        {
            "name": info.field,
            "written": info.on_command_line,
            "default": None if info.default is MISSING else info.plain(info.default),
            "meaning": info.option.help,
        }
        for info in command.infos.values()
    ]
    cells = (
        (row["written"], json.dumps(row["default"] if row["default"] is not None else "").strip('"'), row["meaning"])
        for row in rows
    )
    return Answer(rows, [table_of("setting", "default", "meaning", rows=cells)])


_NO_MEMORY = re.compile(
    r"(?i)(cannot|can't|could not) allocate|insufficient memory|out of memory|bad_alloc|failed to map segment"
    r"|can't start new thread|failed to spawn|error return without exception"
)
"""Messages of libraries that ran out of memory, whose exceptions have many types. Some occur during an import."""


def main() -> None:
    """Run the command line.

    Invalid input from the user ends the command with error messages and exit code 2.
    """
    console = terminal(stderr=True, soft_wrap=True)
    try:
        app()
    except InputError as error:
        for problem in error.merged:
            first, *lines = problem.lines
            console.print(error_text(first), *lines, sep="\n")
        sys.exit(EXIT_BAD_INPUT)
    except Exception as error:
        message = " ".join(str(error).split())
        if isinstance(error, MemoryError) or _NO_MEMORY.search(message):
            message = f" ({message[:200]})" if message else ""
            console.print(error_text(f"not enough memory{message}: try fewer frames at once (--frames)"))
            sys.stdout.flush()
            os._exit(EXIT_UNSOLVED)  # half-initialised libraries crash during a normal exit
        if isinstance(error, UnicodeEncodeError) and encodable(error.object) != error.object:
            problem = Problem(
                error.object[:200], "name", "bytes that are not UTF-8", "a name in UTF-8: rename the file"
            )
            console.print(error_text(str(problem)))
            sys.exit(EXIT_BAD_INPUT)
        if not isinstance(error, OSError):
            raise
        origin = f"{error.filename}: " if error.filename else ""
        console.print(error_text(f"{origin}{error.strerror or error}"))
        sys.exit(EXIT_BAD_INPUT)


def _version(wanted: bool) -> None:
    if wanted:
        from recon.base.version import __version__

        typer.echo(f"recon {__version__}")
        raise typer.Exit()


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass
