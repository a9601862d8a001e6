"""Make a command from the function that runs it and from its settings.

The function's keyword parameters define the command's options, help and completion:

    def view(settings: ViewSettings, progress: Progress) -> Answer:

`settings` is an instance of the annotated class. `options` holds the given settings of another class, such as those of
every fit in a batch, as a dictionary keyed by name (annotated with `OptionsOf`). `console` is the console to print to,
and `progress` updates the progress bar. The function's docstring is the help text. The answer that the function returns
is printed according to --json and --quiet.
"""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import MISSING, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from recon.base.errors import InputError, Problem, raise_problems
from recon.base.memory import keep_freed_memory
from recon.base.settings import Option, SettingInfo, Settings, on_command_line, unknown_setting
from recon.cli.answers import Answer, progress_bar, terminal

if TYPE_CHECKING:
    from typer._click.core import Context
    from typer._click.formatting import HelpFormatter

_JSON = typer.Option("--json", help="Print the summary as JSON.")
_QUIET = typer.Option("--quiet", "-q", help="Print errors only.")
HELP = {"help_option_names": ["-h", "--help"]}
_RATES = ("framerate", "frame-rate")
"""Names of --fps in other programs."""
_METHOD = "recon frame, which is the published method, or --set method=VALUE"
"""Replacement for --method that an error message suggests."""
_SET = "set_"
"""Name of the Python parameter that holds the values of --set."""


@dataclass(frozen=True)
class OptionsOf:
    """Options that a command takes from a class of settings."""

    settings: type[Settings]
    names: tuple[str, ...] = ()
    """Names of the settings, or () for all settings of the class."""
    panel: str | None = None
    """Heading under which the help lists the settings."""
    promoted: tuple[str, ...] = ()
    """Settings that are options of this command, although other commands take them through --set."""

    @property
    def infos(self) -> dict[str, SettingInfo]:
        """Return the settings, keyed by their names, each with its heading in the help."""
        infos = self.settings.infos()
        return {
            name: replace(infos[name], option=self._option(name, infos[name].option)) for name in self.names or infos
        }

    def _option(self, name: str, option: Option) -> Option:
        return replace(option, panel=option.panel or self.panel, common=option.common or name in self.promoted)


class SettingsCommand(TyperCommand):
    """Command that reports all its missing and wrong settings at once."""

    infos: dict[str, SettingInfo]
    """All settings, keyed by their names. Settings of another class come first."""

    def parse_args(self, ctx: Context, args: list[str]) -> list[str]:
        """Parse arguments, or raise InputError that says how to give settings that are not options."""
        rare = {info.on_command_line: info.field for info in self.infos.values() if not info.option.common}
        prefix = len("--set ")
        field_by_option = {written[prefix:]: (field, f"{written}=VALUE") for written, field in rare.items()}
        if "method" in field_by_option:
            field_by_option["method"] = field_by_option["method"][0], _METHOD
        field_by_option |= dict.fromkeys(_RATES, ("fps", "--fps")) if "fps" in self.infos else {}
        options = (word.partition("=")[0] for word in args if word.startswith("--"))
        misplaced = {option: field_by_option.get(option[2:].removeprefix("no-")) for option in options}
        raise_problems(
            Problem(option, field_and_text[0], "no option of this name", field_and_text[1])
            for option, field_and_text in misplaced.items()
            if field_and_text
        )
        return super().parse_args(ctx, args)

    def format_help(self, ctx: Context, formatter: HelpFormatter) -> None:
        """Write the help, which marks required settings."""
        as_parsed = [parameter.required for parameter in self.params]
        for parameter in self.params:  # the parser does not know which settings are required, so the help states it
            info = self.infos.get(str(parameter.name))
            parameter.required = info is not None and info.default is MISSING
        super().format_help(ctx, formatter)
        for parameter, is_required in zip(self.params, as_parsed, strict=True):
            parameter.required = is_required


def make_command(name: str, function: Callable[..., Answer]) -> SettingsCommand:
    """Return a command that runs a function, with the function's settings as options and its docstring as help."""
    takes = typing.get_type_hints(function, include_extras=True)
    own_infos: dict[str, SettingInfo] = takes["settings"].infos() if "settings" in takes else {}
    other_infos = takes["options"].__metadata__[0].infos if "options" in takes else {}
    infos = other_infos | own_infos
    parameters = [_parameter(info, name in other_infos) for name, info in infos.items() if info.option.common]
    if len(parameters) < len(infos):
        help_text = "Another setting, such as sigma-px=2 (may be repeated). List all settings with: recon settings"
        parameters.append(_keyword(_SET, list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help=help_text)))
    parameters += [_keyword("as_json", bool, _JSON, False), _keyword("quiet", bool, _QUIET, False)]

    def call(as_json: bool, quiet: bool, **arguments: Any) -> None:
        """Run the function with its settings, or raise InputError with all problems of these settings."""
        keep_freed_memory()
        console = terminal(quiet=quiet, stderr=as_json)
        keywords: dict[str, Any] = {"console": console} if "console" in takes else {}
        values = _values_of_set(arguments.pop(_SET, None) or [], infos)
        values |= {name: value for name, value in arguments.items() if value not in (None, [])}
        if "options" in takes:
            keywords["options"] = {name: value for name, value in values.items() if name not in own_infos}
        if "settings" in takes:
            try:
                keywords["settings"] = takes["settings"](**{name: values[name] for name in own_infos if name in values})
            except InputError as error:
                raise InputError(on_command_line(problem, own_infos) for problem in error.problems) from None
        with progress_bar(terminal(quiet=quiet, stderr=True)) if "progress" in takes else nullcontext() as progress:
            answer = function(**keywords, **({"progress": progress} if progress else {}))
        answer.show(console, as_json)

    call.__dict__["__signature__"] = inspect.Signature(parameters)
    call.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    app.command(name, help=help_of(function), cls=SettingsCommand, context_settings=HELP)(call)
    command = typer.main.get_command(app)
    assert isinstance(command, SettingsCommand)
    command.infos = infos
    return command


def help_of(function: Callable[..., Any]) -> str:
    """Return a function's docstring with one line per paragraph, to be wrapped at the terminal's width."""
    return "\n\n".join(" ".join(paragraph.split()) for paragraph in (inspect.getdoc(function) or "").split("\n\n"))


def _values_of_set(texts: list[str], infos: dict[str, SettingInfo]) -> dict[str, Any]:
    """Return the values given with --set, keyed by the name of the setting.

    Raises
    ------
    InputError
        If values are malformed.
    """
    values: dict[str, Any] = {}
    problems = []
    for text in texts:
        name, equals, value = text.partition("=")
        name = name.strip().replace("-", "_")
        if not equals:
            problems.append(Problem("--set", "setting", repr(text), "name=value, such as sigma-px=2"))
        elif name not in infos:
            problems.append(unknown_setting("--set", name, infos))
        elif infos[name].is_many:
            values.setdefault(name, []).append(value)
        else:
            values[name] = value
    raise_problems(problems)
    return values


def _keyword(name: str, kind: object, info: object, default: object = None) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=Annotated[kind, info])


def _parameter(info: SettingInfo, overrules: bool) -> inspect.Parameter:
    """Return an option or argument for typer, whose value is a string or path that the settings check later.

    `overrules` states whether the option may unset a value from a file.
    """
    option, default = info.option, None if info.default is MISSING else info.default
    kind = bool if info.is_flag else Path if Path in info.parts else str
    help_text = option.help
    if default not in (None, "", ()) and not info.is_flag:
        help_text += f" (default: {default:g})" if info.is_number else f" (default: {default})"
    metavar = option.metavar or ("<number>" if info.is_number else "|".join(info.choices)) or None
    keywords: dict[str, Any] = {"help": help_text, "show_default": False}
    if info.choices:
        keywords["autocompletion"] = lambda incomplete: [
            choice for choice in info.choices if choice.startswith(incomplete)
        ]
    if option.argument:
        typer_info = typer.Argument(metavar=option.argument, **keywords)
    else:
        flag = info.on_command_line
        if info.is_flag and (default is not False or overrules):
            flag = f"{flag}/--no-{flag[2:]}"
        typer_info = typer.Option(flag, metavar=metavar, rich_help_panel=option.panel, **keywords)
    return _keyword(info.field, list[kind] | None if info.is_many else kind | None, typer_info)
