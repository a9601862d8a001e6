"""The command line: what commands share, how they are made of their settings, which there are, how mistakes end.

A command is a function beside what it runs, whose parameters say what it takes, all by name; its options, help and
completion follow from them:

    def view(settings: ViewSettings, progress: Progress) -> Answer:

settings: of the class that is annotated. given: what was given of another class, for example those of every fit of a
batch, as a dictionary by name (annotated with `OptionsOf`). console, progress: where it prints, and the progress bar's
function. Its docstring is the help, and its answer is printed as --json and --quiet say.
"""

from __future__ import annotations

import inspect
import json
import os
import re
import shlex
import sys
import typing
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import MISSING, dataclass, replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer
from pydantic import BeforeValidator
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.segment import Segment
from rich.table import Column, Table
from rich.text import Text
from typer.core import TyperCommand, TyperGroup

from recon.base.errors import InputError, Problem, printable, raise_problems
from recon.base.file_names import encodable
from recon.base.interrupts import EXIT_INTERRUPTED, MESSAGE, Interrupts, installed
from recon.base.progress import silent
from recon.base.settings import Number, Option, SettingInfo, Settings, on_command_line, unknown_setting

if TYPE_CHECKING:
    from recon.fit.result import Verdict  # numpy is slow to import

# -- options that several commands have -------------------------------------------------------------------------------


StrideTimes = Annotated[
    tuple[Number, Number], BeforeValidator(lambda given: given.split(":") if isinstance(given, str) else given)
]
"""(start, end) in seconds since frame 0, or the text "0.31:0.62"."""
FIRST_FRAME = Option("Number that the video's first frame has in the keypoint file, if it was cut.")
ANYWAY = Option('Also of a clip whose verdict is "do not use".')
STRIDE = Option(
    "A stride, in seconds since frame 0, as in 0.31:0.62. (default: one that is found)",
    "START:END in seconds, as in 0.31:0.62",
    metavar="START:END",
)

# -- what a command prints --------------------------------------------------------------------------------------------

EXIT_UNSOLVED = 1
EXIT_BAD_INPUT = 2


@dataclass(frozen=True)
class Answer:
    """What a command has found, for people and for other programs."""

    data: Any
    """What --json prints; a text as it is."""
    lines: Iterable[str | Text | Table] = ()
    """What is printed without --json."""
    errors: Sequence[str] = ()
    """What has failed: printed in any case, as errors are, and the exit code is 1."""
    code: int = 0
    """The exit code, where there are no errors."""
    files: Sequence[Path] = ()
    """What was written, where a stage of `recon run` has to know it."""
    notes: Sequence[str] = ()
    """What a reader should know before using it: printed behind the lines, and by `recon run` once for all stages."""

    def show(self, console: Console, as_json: bool) -> None:
        """Print it, and end with its exit code."""
        if as_json:
            typer.echo(_shown_json(self.data if isinstance(self.data, str) else _json(self.data)), nl=False)
        for line in () if as_json else self.lines:
            console.print(line) if isinstance(line, Table) else say(console, line)
        for note in () if as_json else self.notes:
            say(console, f"note: {note}")
        for error in self.errors:
            terminal(stderr=True, soft_wrap=True).print(error_text(error))
        if self.errors or self.code:
            raise typer.Exit(EXIT_UNSOLVED if self.errors else self.code)


def _json(data: Any) -> str:
    from recon.show.plain import to_json  # numpy is slow to import, and recon doctor says where it cannot be

    return to_json(data)


def _shown_json(text: str) -> str:
    """Return JSON as standard output can have it: where that is ASCII, with JSON's own codes."""
    try:
        text.encode(sys.stdout.encoding or "utf-8")
    except UnicodeEncodeError:
        return "".join(c if c.isascii() else json.dumps(c)[1:-1] for c in text)
    return text


def terminal(**given: Any) -> Console:
    """Where a command prints. Brackets and colons in names are no markup, and a terminal's commands are shown."""
    return _Terminal(markup=False, emoji=False, **given)


class _Terminal(Console):
    def render(self, renderable: Any, options: Any = None) -> Iterator[Segment]:
        for segment in super().render(renderable, options):
            if segment.control or segment.text.isprintable():
                yield segment
            else:
                text = "\n".join(map(printable, segment.text.split("\n")))
                yield Segment(text, segment.style)


def say(console: Console, text: str | Text, style: str = "") -> None:
    """One line, however long: no markup, and no breaks that a terminal would not make."""
    console.print(Text(printable(text), style) if isinstance(text, str) else text, soft_wrap=True)


def verdict_texts(verdict: Verdict | None) -> Iterator[Text]:
    """The first lines of what is made of a clip; nothing of a motion that was not judged."""
    from recon.show.console import STYLES

    for line in verdict.lines if verdict else ():
        level = next((level for level in STYLES if line.startswith(f"{level}:")), "")
        yield Text.assemble((level, STYLES.get(level, "")), line[len(level) :])


def counted(count: int, what: str) -> str:
    """As in 1 clip, 2 clips."""
    return f"{count} {what}{'s' * (count != 1)}"


def table_of(*texts: str, numbers: Iterable[str] = (), rows: Iterable[Iterable[str | Text]] = (), **more: Any) -> Table:
    """A table: columns of texts, the first of which names the row, then of numbers. No word of a header is cut."""
    first, *others = texts
    columns = Column(first, no_wrap=True), *map(Column, others), *(Column(name, justify="right") for name in numbers)
    for column in columns:
        column.min_width = max(map(len, str(column.header).split()), default=None)
    table = Table(*columns, box=SIMPLE_HEAD, title_justify="left", **more)
    for row in rows:
        table.add_row(*(Text(cell) if isinstance(cell, str) else cell for cell in row))
    return table


def error_text(message: str) -> Text:
    return Text.assemble(("error:", "bold red"), " ", printable(message))


def stop(message: str = MESSAGE) -> NoReturn:
    """End a command at Ctrl-C: one line, and exit code 130."""
    interrupts = installed()
    if interrupts is not None:
        interrupts.said = True
    terminal(stderr=True, soft_wrap=True).print(Text(message, "bold"))
    raise typer.Exit(EXIT_INTERRUPTED)


def numbers(option: str, given: str, count: int | None = None) -> list[float]:
    """The numbers of a text such as "1,2.5,-3"; count: how many, None: any. Raises InputError."""
    try:
        found = [float(part) for part in given.split(",")]
    except ValueError:
        found = []
    if not found or not all(map(isfinite, found)) or count not in (None, len(found)):
        expected = f"{'' if count is None else f'{count} '}numbers with commas, as in 0.1,-20,3"
        raise InputError(Problem(option, "numbers", repr(given), expected))
    return found


@contextmanager
def progress_bar(console: Console) -> Iterator[Any]:
    """Give a function of a stage and of the part of the work that is done (0 to 1), which draws a bar on a terminal."""
    if console.quiet or not console.is_terminal:  # some versions of rich end a bar that is disabled with an empty line
        yield silent
        return
    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda stage, share: bar.update(task, description=stage, completed=share)


def answer_of_fit(report: dict[str, Any], out: Path, page: Path | None = None, **more: Any) -> Answer:
    """What there is to say of a fit. page: if there is one; more: fields for --json."""
    from recon.show.console import console_summary
    from recon.show.report import is_unsolved

    own = {name: report[name] for name in ("method", "summary", "findings")}
    data = {"out": out, **own, "seconds": report["timing_s"]["solve_s"], **more}
    if is_unsolved(report):
        return Answer(data, [console_summary(report)], [f"no frame could be solved: see {out / 'report.json'}"])
    folder, what = shlex.quote(str(out)), "pictures, figures and all numbers"
    playback = f"Results are in {out}. Watch them with: recon view {folder}"
    more_to_see = f"Open {page} in a browser: {what}." if page else f"A page with {what}: recon report {folder}"
    return Answer(data, [console_summary(report), playback, more_to_see])


# -- a command of its settings ----------------------------------------------------------------------------------------

_JSON = typer.Option("--json", help="Print what there is to say as JSON.")
_QUIET = typer.Option("--quiet", "-q", help="Print errors only.")
HELP = {"help_option_names": ["-h", "--help"]}
_RATES = ("framerate", "frame-rate")
"""What others call --fps."""
_SET = "set_"
"""Name of the parameter of --set."""


@dataclass(frozen=True)
class OptionsOf:
    """Settings of another class that a command takes too. names: which of them, all if empty; panel: the heading in
    the help under which they stand."""

    settings: type[Settings]
    names: tuple[str, ...] = ()
    panel: str | None = None

    @property
    def infos(self) -> dict[str, SettingInfo]:
        infos = self.settings.infos()
        return {
            name: replace(infos[name], option=replace(infos[name].option, panel=infos[name].option.panel or self.panel))
            for name in self.names or infos
        }


class SettingsCommand(TyperCommand):
    """A command whose settings say themselves what is missing or wrong, all at once."""

    infos: dict[str, SettingInfo]
    """All settings by name, those of another class first."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        rare = {info.on_command_line: info.field for info in self.infos.values() if not info.option.common}
        meant = {written[6:]: (field, f"{written}=VALUE") for written, field in rare.items()}
        meant |= dict.fromkeys(_RATES, ("fps", "--fps")) if "fps" in self.infos else {}
        options = (word.partition("=")[0] for word in args if word.startswith("--"))
        wrong = {option: meant.get(option[2:].removeprefix("no-")) for option in options}
        raise_problems(Problem(option, of[0], "no option of this name", of[1]) for option, of in wrong.items() if of)
        return super().parse_args(ctx, args)

    def format_help(self, ctx: Any, formatter: Any) -> None:
        for parameter in self.params:  # the parser never asks for what must be given, the help says it
            info = self.infos.get(str(parameter.name))
            parameter.required = info is not None and info.default is MISSING
        super().format_help(ctx, formatter)


def make_command(name: str, function: Callable[..., Answer]) -> SettingsCommand:
    """The command of a function, see the text of the module."""
    takes = typing.get_type_hints(function, include_extras=True)
    own: dict[str, SettingInfo] = takes["settings"].infos() if "settings" in takes else {}
    of_others = takes["given"].__metadata__[0].infos if "given" in takes else {}
    infos = of_others | own
    parameters = [_parameter(info, name in of_others) for name, info in infos.items() if info.option.common]
    if len(parameters) < len(infos):
        help = "Another setting, as in sigma-px=2, also several times. Listed by: recon settings"
        parameters.append(_keyword(_SET, list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help=help)))
    parameters += [_keyword("as_json", bool, _JSON, False), _keyword("quiet", bool, _QUIET, False)]

    def call(as_json: bool, quiet: bool, **arguments: Any) -> None:
        """Raises InputError with everything that is wrong with the command's own settings."""
        console = terminal(quiet=quiet, stderr=as_json)
        more: dict[str, Any] = {"console": console} if "console" in takes else {}
        values = _values_of_set(arguments.pop(_SET, None) or [], infos)
        values |= {name: value for name, value in arguments.items() if value not in (None, [])}
        if "given" in takes:
            more["given"] = {name: value for name, value in values.items() if name not in own}
        if "settings" in takes:
            try:
                more["settings"] = takes["settings"](**{name: values[name] for name in own if name in values})
            except InputError as error:
                raise InputError(on_command_line(problem, own) for problem in error.problems) from None
        with progress_bar(terminal(quiet=quiet, stderr=True)) if "progress" in takes else nullcontext() as progress:
            answer = function(**more, **({"progress": progress} if progress else {}))
        answer.show(console, as_json)

    call.__dict__["__signature__"] = inspect.Signature(parameters)
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command(name, help=inspect.getdoc(function), cls=SettingsCommand, context_settings=HELP)(call)
    command = typer.main.get_command(app)
    assert isinstance(command, SettingsCommand)
    command.infos = infos
    return command


def _values_of_set(texts: list[str], infos: dict[str, SettingInfo]) -> dict[str, Any]:
    """The values of --set. Raises InputError for those that are none."""
    found: dict[str, Any] = {}
    problems = []
    for text in texts:
        name, equals, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if not equals:
            problems.append(Problem("--set", "setting", repr(text), "name=value, as in sigma-px=2"))
        elif name not in infos:
            problems.append(unknown_setting("--set", name, infos))
        elif infos[name].is_many:
            found.setdefault(name, []).append(value)
        else:
            found[name] = value
    raise_problems(problems)
    return found


def _keyword(name: str, kind: Any, info: Any, default: Any = None) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, info])


def _parameter(info: SettingInfo, overrules: bool) -> inspect.Parameter:
    """An option or argument of typer's. Its value is text, or a path, which the settings check. overrules: whether it
    may take back what a file says."""
    option, default = info.option, None if info.default is MISSING else info.default
    kind: Any = bool if info.is_flag else Path if Path in info.parts else str
    help = option.help
    if default not in (None, "", ()) and not info.is_flag:
        help += f" (default: {default:g})" if info.is_number else f" (default: {default})"
    metavar = option.metavar or ("<number>" if info.is_number else "|".join(info.choices)) or None
    more: dict[str, Any] = {"help": help, "show_default": False}
    if info.choices:
        more["autocompletion"] = lambda incomplete: [one for one in info.choices if one.startswith(incomplete)]
    if option.argument:
        typer_info = typer.Argument(metavar=option.argument, **more)
    else:
        flag = info.on_command_line
        if info.is_flag and (default is not False or overrules):
            flag = f"{flag}/--no-{flag[2:]}"
        typer_info = typer.Option(flag, metavar=metavar, rich_help_panel=option.panel, **more)
    return _keyword(info.field, list[kind] | None if info.is_many else kind | None, typer_info)


# -- all commands -----------------------------------------------------------------------------------------------------

CommandFunction = Callable[..., Any]


def _fit() -> CommandFunction:
    from recon.workflows.fit import fit

    return fit


def _batch() -> CommandFunction:
    from recon.workflows.batch import batch

    return batch


def _run() -> CommandFunction:
    from recon.workflows.run import run

    return run


def _demo() -> CommandFunction:
    from recon.workflows.demo import demo

    return demo


def _settings() -> CommandFunction:
    return settings


def _view() -> CommandFunction:
    from recon.workflows.look import view

    return view


def _report() -> CommandFunction:
    from recon.workflows.look import report

    return report


def _analyse() -> CommandFunction:
    from recon.workflows.analyse import analyse_command

    return analyse_command


def _compare() -> CommandFunction:
    from recon.workflows.compare import compare

    return compare


def _evaluate() -> CommandFunction:
    from recon.workflows.evaluate import evaluate

    return evaluate


def _convert() -> CommandFunction:
    from recon.workflows.convert import convert

    return convert


def _overlay() -> CommandFunction:
    from recon.workflows.look import overlay

    return overlay


def _calibrate() -> CommandFunction:
    from recon.workflows.calibrate import calibrate

    return calibrate


def _calibrate_extrinsics() -> CommandFunction:
    from recon.workflows.extrinsics import extrinsics

    return extrinsics


def _camera_motion() -> CommandFunction:
    from recon.workflows.camera_motion import camera_motion

    return camera_motion


def _camera_advice() -> CommandFunction:
    from recon.workflows.camera_advice import camera_advice

    return camera_advice


def _train() -> CommandFunction:
    from recon.keypoint_net.train import train_command

    return train_command


def _predict() -> CommandFunction:
    from recon.keypoint_net.network import predict_command

    return predict_command


def _evaluate_2d() -> CommandFunction:
    from recon.keypoint_net.labels import evaluate_2d_command

    return evaluate_2d_command


def _skeleton_list() -> CommandFunction:
    from recon.workflows.skeleton import skeleton_list

    return skeleton_list


def _skeleton_check() -> CommandFunction:
    from recon.workflows.skeleton import skeleton_check

    return skeleton_check


def _skeleton_from_keypoints() -> CommandFunction:
    from recon.workflows.skeleton import skeleton_from_keypoints

    return skeleton_from_keypoints


def _subject_fit() -> CommandFunction:
    from recon.workflows.models import subject_fit

    return subject_fit


def _prior_fit() -> CommandFunction:
    from recon.workflows.models import prior_fit

    return prior_fit


def _ik() -> CommandFunction:
    from recon.ik.clip import ik

    return ik


def _retarget() -> CommandFunction:
    from recon.robotics.retarget_clip import retarget_command

    return retarget_command


def _robot_pose() -> CommandFunction:
    from recon.robotics.dh import pose

    return pose


def _robot_dh() -> CommandFunction:
    from recon.robotics.dh import dh

    return dh


def _climb() -> CommandFunction:
    from recon.robotics.climb.plan import climb

    return climb


def _frame() -> CommandFunction:
    from recon.thesis.clip import frame

    return frame


def _solver() -> CommandFunction:
    from recon.thesis.clip import solver

    return solver


def _doctor() -> CommandFunction:
    from recon.workflows.doctor import doctor

    return doctor


COMMANDS = {
    "From a clip to its motion": {
        "fit": (_fit, "One clip: keypoints and a camera in, a folder of results out."),
        "batch": (_batch, "Many clips in parallel, from where it was stopped."),
        "run": (_run, "From a video to a page: keypoints, fit, analysis, overlay, report.html."),
        "demo": (_demo, "Fit the bundled sample and compare it with its truth."),
        "settings": (_settings, "All settings of a command, also those that are no options."),
    },
    "Look at it and use it": {
        "view": (_view, "The playback in the rerun viewer, with the plots of its analysis."),
        "report": (_report, "A page of a result, or of a batch, to look at and to pass on."),
        "analyse": (_analyse, "Speeds, angles, gait, vector fields and phase portraits."),
        "compare": (_compare, "Strides and speeds of several clips, by group."),
        "evaluate": (_evaluate, "Compare a result with a reference."),
        "convert": (_convert, "Keypoints, 3D positions or results in another file format."),
        "overlay": (_overlay, "Draw a result on its video."),
    },
    "Cameras": {
        "calibrate": (_calibrate, "A camera, from pictures of a board."),
        "calibrate extrinsics": (_calibrate_extrinsics, "Where cameras stand, from clips of the animal."),
        "camera-motion": (_camera_motion, "How a camera turned, from its video."),
        "camera-advice": (_camera_advice, "Where to put a camera, to see an angle or a joint."),
    },
    "Keypoints from video": {
        "train": (_train, "Train a small keypoint network on a few labels."),
        "predict": (_predict, "Find the keypoints in every frame of a video."),
        "evaluate-2d": (_evaluate_2d, "Compare keypoints with labels."),
    },
    "Models and priors": {
        "skeleton list": (_skeleton_list, "List the skeletons that come with the package."),
        "skeleton check": (_skeleton_check, "Check a skeleton file, list it, and draw it."),
        "skeleton from-keypoints": (_skeleton_from_keypoints, "Draft one for a file's points."),
        "subject fit": (_subject_fit, "Measure one animal in clips of several cameras."),
        "prior fit": (_prior_fit, "Fit a motion prior to results or 3D poses."),
    },
    "Robots and the thesis": {
        "ik": (_ik, "Inverse kinematics from the trunk to a foot."),
        "retarget": (_retarget, "The motion on a four-legged robot."),
        "robot pose": (_robot_pose, "The legs' angles of a body that moves over planted feet."),
        "robot dh": (_robot_dh, "A leg or chain by its Denavit-Hartenberg table, forward and inverse."),
        "climb": (_climb, "A four-legged robot climbs a step by potential fields."),
        "frame": (_frame, "Fit one side of the animal, one frame after the other."),
        "solver": (_solver, "What the optimiser of recon frame did: costs, Jacobian, limits."),
    },
    "This installation": {
        "doctor": (_doctor, "Check versions, optional parts, the viewer, and a fit of the sample."),
    },
}
"""By heading and name: what imports the command's function, and what `recon --help` says of it. Only the command that
is called is imported."""
GROUPS = {
    "skeleton": "Skeletons: those that come with the package, and your own.",
    "subject": "Measured animals: lengths of one animal, and how a detector sees it.",
    "prior": "Motion priors: which poses occur, and how they change.",
    "robot": "A robot's kinematics: its body's pose, legs, tables of parameters; all solutions.",
}


class _Group(TyperGroup):
    """Commands by name, of which only the one that is called is imported. functions: what imports each function."""

    def __init__(self, **more: Any) -> None:
        super().__init__(**more)
        self.functions: dict[str, Callable[[], CommandFunction]] = {}

    def load(self, name: str) -> SettingsCommand:
        """A command by its name, of one word or two."""
        return make_command(name, self.functions[name]())

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        both = " ".join(args[:2])
        name, command, rest = super().resolve_command(ctx, [both, *args[2:]] if both in self.commands else args)
        is_leaf = command is not None and not isinstance(command, _Group)
        return name, self.load(str(name)) if is_leaf else command, rest


class _Commands(_Group):
    """All commands of `COMMANDS`. Any of them ends at Ctrl-C with one line and exit code 130."""

    def __init__(self, **more: Any) -> None:
        super().__init__(**more)
        entries = ((*entry, panel) for panel, of in COMMANDS.items() for entry in of.items())
        for name, (function, help), panel in entries:
            self.functions[name] = function
            first, _, rest = name.partition(" ")
            if first not in GROUPS:
                self.add_command(TyperCommand(name, help=help, rich_help_panel=panel))
                continue
            more = {"help": GROUPS[first], "rich_help_panel": panel, "no_args_is_help": True}
            group = self.commands.setdefault(first, _Group(name=first, **more))
            assert isinstance(group, _Group)
            group.functions[rest] = function
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
        from recon.workflows.clip_results import config_schema

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
        (r["written"], json.dumps(r["default"] if r["default"] is not None else "").strip('"'), r["meaning"])
        for r in rows
    )
    return Answer(rows, [table_of("setting", "default", "meaning", rows=cells)])


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
        if isinstance(error, UnicodeEncodeError) and encodable(error.object) != error.object:
            found = Problem(error.object[:200], "name", "bytes that are not UTF-8", "a name in UTF-8: rename the file")
            console.print(error_text(str(found)))
            sys.exit(EXIT_BAD_INPUT)
        if not isinstance(error, OSError):
            raise
        where = f"{error.filename}: " if error.filename else ""
        console.print(error_text(f"{where}{error.strerror or error}"))
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
