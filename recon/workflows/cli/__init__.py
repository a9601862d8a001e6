"""The command line: which commands there are, and how a user's mistakes end. Each is a function beside what it runs."""

from __future__ import annotations

import json
import os
import re
import sys
from dataclasses import MISSING
from importlib import import_module
from typing import Annotated, Any

import typer
from rich.text import Text
from typer.core import TyperCommand, TyperGroup

from recon.base.errors import InputError, Problem
from recon.base.interrupts import Interrupts, installed
from recon.base.settings import Option, SettingInfo, Settings
from recon.workflows.cli.command import HELP, SettingsCommand, make_command
from recon.workflows.cli.common import EXIT_BAD_INPUT, EXIT_UNSOLVED, Answer, error_text, stop, table_of, terminal

_CORE, _ROBOTICS, _NET = "recon.workflows.", "recon.wings.robotics.cli:", "recon.wings.keypoint_net."
_THESIS = "recon.wings.thesis."
COMMANDS = {
    "From a clip to its motion": {
        "fit": (_CORE + "cli.fit:fit", "One clip: keypoints and a camera in, a folder of results out."),
        "batch": (_CORE + "batch:batch", "Many clips in parallel, from where it was stopped."),
        "run": (_CORE + "run:run", "From a video to a page: keypoints, fit, analysis, overlay, report.html."),
        "demo": (_CORE + "demo:demo", "Fit the bundled sample and compare it with its truth."),
        "settings": (_CORE + "cli:settings", "All settings of a command, also those that are no options."),
    },
    "Look at it and use it": {
        "view": (_CORE + "look:view", "The playback in the rerun viewer, with the plots of its analysis."),
        "report": (_CORE + "look:report", "A page of a result, or of a batch, to look at and to pass on."),
        "analyse": (_CORE + "analyse:analyse_command", "Speeds, angles, gait, vector fields and phase portraits."),
        "compare": (_CORE + "compare:compare", "Strides and speeds of several clips, by group."),
        "evaluate": (_CORE + "evaluate:evaluate", "Compare a result with a reference."),
        "convert": (_CORE + "convert:convert_command", "Keypoints, 3D positions or results in another file format."),
        "overlay": (_CORE + "look:overlay", "Draw a result on its video."),
    },
    "Cameras": {
        "calibrate": (_CORE + "calibrate:calibrate", "A camera, from pictures of a board."),
        "calibrate extrinsics": (_CORE + "extrinsics:extrinsics", "Where cameras stand, from clips of the animal."),
        "camera-motion": (_CORE + "camera_motion:camera_motion", "How a camera turned, from its video."),
        "camera-advice": (_CORE + "camera_advice:camera_advice", "Where to put a camera, to see an angle or a joint."),
    },
    "Keypoints from video": {
        "train": (_NET + "workflows:train_command", "Train a small keypoint network on a few labels."),
        "predict": (_NET + "workflows:predict_command", "Find the keypoints in every frame of a video."),
        "evaluate-2d": (_NET + "evaluate2d:evaluate_2d_command", "Compare keypoints with labels."),
    },
    "Models and priors": {
        "skeleton list": (_CORE + "skeleton:skeleton_list", "List the skeletons that come with the package."),
        "skeleton check": (_CORE + "skeleton:skeleton_check", "Check a skeleton file, list it, and draw it."),
        "skeleton from-keypoints": (_CORE + "skeleton:skeleton_from_keypoints", "Draft one for a file's points."),
        "subject fit": (_CORE + "subject:subject_fit", "Measure one animal in clips of several cameras."),
        "prior fit": (_CORE + "prior:prior_fit", "Fit a motion prior to results or 3D poses."),
    },
    "Robots and the thesis": {
        "ik": (_ROBOTICS + "ik", "Inverse kinematics from the trunk to a foot."),
        "retarget": (_ROBOTICS + "retarget", "The motion on a four-legged robot."),
        "robot pose": (_ROBOTICS + "pose", "The legs' angles of a body that moves over planted feet."),
        "robot dh": (_ROBOTICS + "dh", "A leg or chain by its Denavit-Hartenberg table, forward and inverse."),
        "climb": (_ROBOTICS + "climb", "A four-legged robot climbs a step by potential fields."),
        "frame": (_THESIS + "clip:frame", "Fit one side of the animal, one frame after the other."),
        "solver": (_THESIS + "solver:solver", "What the optimiser of recon frame did: costs, Jacobian, limits."),
    },
    "This installation": {
        "doctor": (_CORE + "doctor:doctor", "Check versions, optional parts, the viewer, and a fit of the sample."),
    },
}
"""By heading and name: where the command's function is, and what `recon --help` says of it. Modules are named, not
imported: a wing's command is known here by its name only."""
GROUPS = {
    "skeleton": "Skeletons: those that come with the package, and your own.",
    "subject": "Measured animals: lengths of one animal, and how a detector sees it.",
    "prior": "Motion priors: which poses occur, and how they change.",
    "robot": "A robot's kinematics: its body's pose, legs, tables of parameters; all solutions.",
}


class _Group(TyperGroup):
    """Commands by name, of which only the one that is called is imported. functions: where each one's function is."""

    functions: dict[str, str]

    def load(self, name: str) -> SettingsCommand:
        """A command by its name, of one word or two."""
        module, _, function = self.functions[name].partition(":")
        return make_command(name, getattr(import_module(module), function))

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        both = " ".join(args[:2])
        name, command, rest = super().resolve_command(ctx, [both, *args[2:]] if both in self.commands else args)
        is_leaf = command is not None and not isinstance(command, _Group)
        return name, self.load(str(name)) if is_leaf else command, rest


class _Commands(_Group):
    """All commands of `COMMANDS`. Any of them ends at Ctrl-C with one line and exit code 130."""

    def __init__(self, **more: Any) -> None:
        super().__init__(**more)
        entries = {name: (*entry, panel) for panel, of in COMMANDS.items() for name, entry in of.items()}
        self.functions = {name: function for name, (function, _, _) in entries.items()}
        for name, (function, help, panel) in entries.items():
            first, _, rest = name.partition(" ")
            if first not in GROUPS:
                self.add_command(TyperCommand(name, help=help, rich_help_panel=panel))
                continue
            more = {"help": GROUPS[first], "rich_help_panel": panel, "no_args_is_help": True}
            group = self.commands.setdefault(first, _Group(name=first, **more))
            assert isinstance(group, _Group)
            group.functions = {**getattr(group, "functions", {}), rest: function}
            group.add_command(TyperCommand(rest, help=help))

    def invoke(self, ctx: Any) -> Any:
        interrupts = installed() or Interrupts()
        try:
            interrupts.in_command = True
            return super().invoke(ctx)
        except KeyboardInterrupt:
            stop()
        finally:
            interrupts.in_command = False
            if interrupts.received and not interrupts.said:  # a library has made another exception of it, or none
                stop()


app = typer.Typer(
    cls=_Commands,
    help="Metric 3D motion of a running animal from the keypoints of one camera or several, still or panning.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings=HELP,
)


def commands() -> dict[str, SettingsCommand]:
    """All commands by name, each made."""
    group = _Commands()
    return {name: group.load(name) for name in group.functions}


class _ListedSettings(Settings):
    """The settings of `recon settings`."""

    command: Annotated[str, Option(argument="COMMAND")] = "fit"
    """The command, as in fit."""
    schema: bool = False
    """Print the JSON schema of config.toml in place of the list: editors complete and check by it."""


def settings(settings: _ListedSettings) -> Answer:
    """List all settings of a command: those that are options, and those that only --set and config.toml have.

    Example: recon settings fit
    """
    if settings.schema:
        schema = import_module("recon.workflows.config").config_schema()
        return Answer(schema, [Text(json.dumps(schema, indent=1, ensure_ascii=False))])
    command = commands().get(settings.command)
    if command is None:
        expected = f"one of {', '.join(commands())}"
        raise InputError(Problem("COMMAND", "command", repr(settings.command), expected))
    rows = [row_of(info) for info in command.infos.values()]
    cells = (
        (r["written"], json.dumps(r["default"] if r["default"] is not None else "").strip('"'), r["meaning"])
        for r in rows
    )
    return Answer(rows, [table_of("setting", "default", "meaning", rows=cells)])


def row_of(info: SettingInfo) -> dict[str, Any]:
    """A setting as JSON has it."""
    default = None if info.default is MISSING else info.plain(info.default)
    return {"name": info.field, "written": info.on_command_line, "default": default, "meaning": info.option.help}


_NO_MEMORY = re.compile(
    r"(?i)(cannot|can't|could not) allocate|insufficient memory|out of memory|bad_alloc|failed to map segment"
    r"|can't start new thread|failed to spawn|error return without exception"
)
"""What libraries say where memory is short, in exceptions of many types: as they are loaded, too, and of threads."""


def main() -> None:
    """Run the command line; a user's mistake ends with one message and exit code 2."""
    console = terminal(stderr=True, soft_wrap=True)
    try:
        app()
    except InputError as error:
        for problem in error.problems:
            first, *more = problem.lines
            console.print(error_text(first), *more, sep="\n")
        sys.exit(EXIT_BAD_INPUT)
    except Exception as error:
        said = " ".join(str(error).split())
        if isinstance(error, MemoryError) or _NO_MEMORY.search(said):
            said = f" ({said[:200]})" if said else ""
            console.print(error_text(f"not enough memory{said}: try fewer frames at once (--frames)"))
            sys.stdout.flush()
            os._exit(EXIT_UNSOLVED)  # what libraries have made by half crashes when it is taken down
        if not isinstance(error, OSError):
            raise
        where = f"{error.filename}: " if error.filename else ""
        console.print(error_text(f"{where}{error.strerror or error}"))
        sys.exit(EXIT_BAD_INPUT)


def _version(wanted: bool) -> None:
    if wanted:
        from recon import __version__

        typer.echo(f"recon {__version__}")
        raise typer.Exit()


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass
