"""A command, made of the function that runs it and of its settings.

A command is a function whose parameters say what it takes, all by name; its options, help and completion follow from
them:

    def view(settings: ViewSettings, progress: Progress) -> Answer:

settings: of the class that is annotated. given: what was given of another class, for example those of every fit of a
batch, as a dictionary by name (annotated with `OptionsOf`). console, progress: where it prints, and the progress bar's
function. Its docstring is the help, and its answer is printed as --json and --quiet say.
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import MISSING, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from recon.base.errors import InputError, Problem, raise_problems
from recon.base.settings import Option, SettingInfo, Settings, on_command_line, unknown_setting
from recon.cli.answers import Answer, progress_bar, terminal

_JSON = typer.Option("--json", help="Print what there is to say as JSON.")
_QUIET = typer.Option("--quiet", "-q", help="Print errors only.")
HELP = {"help_option_names": ["-h", "--help"]}
_RATES = ("framerate", "frame-rate")
"""What others call --fps."""
_METHOD = "recon frame, which is the published method, or --set method=VALUE"
"""In place of --method."""
_SET = "set_"
"""Name of the parameter of --set."""


@dataclass(frozen=True)
class OptionsOf:
    """Settings of another class that a command takes too. names: which of them, all if empty; panel: the heading in
    the help under which they stand."""

    settings: type[Settings]
    names: tuple[str, ...] = ()
    panel: str | None = None
    promoted: tuple[str, ...] = ()
    """Settings that are options of this command, though others set them with --set."""

    @property
    def infos(self) -> dict[str, SettingInfo]:
        infos = self.settings.infos()
        return {
            name: replace(infos[name], option=self._option(name, infos[name].option)) for name in self.names or infos
        }

    def _option(self, name: str, option: Option) -> Option:
        return replace(option, panel=option.panel or self.panel, common=option.common or name in self.promoted)


class SettingsCommand(TyperCommand):
    """A command whose settings say themselves what is missing or wrong, all at once."""

    infos: dict[str, SettingInfo]
    """All settings by name, those of another class first."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        rare = {info.on_command_line: info.field for info in self.infos.values() if not info.option.common}
        meant = {written[6:]: (field, f"{written}=VALUE") for written, field in rare.items()}
        if "method" in meant:
            meant["method"] = meant["method"][0], _METHOD
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
