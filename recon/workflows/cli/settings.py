"""The settings of a fit as options of a command, made of their table."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from typing import Annotated, Any

import typer

from recon.workflows.settings import NUMBER, SETTINGS, Setting, option

OPTIONS = tuple(name for name, setting in SETTINGS.items() if setting.is_option)
"""Those that the command line has."""
_PANELS = {"trajectory": "Trajectory method", "frame": "Frame method"}


def takes_settings(
    names: Iterable[str], panel: str | None = None
) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """In place of the command's parameter `given` come options for these settings, those that both methods read under
    the heading `panel`. The command gets their values by name, None where an option was not given; what is wrong with
    them is for `recon.workflows.settings` to say."""
    parameters = [_parameter(name, SETTINGS[name], panel) for name in names]

    def with_options(command: Callable[..., None]) -> Callable[..., None]:
        own = list(inspect.signature(command, eval_str=True).parameters.values())
        place = [parameter.name for parameter in own].index("given")
        signature = inspect.Signature([*own[:place], *parameters, *own[place + 1 :]])

        @functools.wraps(command)
        def with_given(**arguments: Any) -> None:
            given = {parameter.name: arguments.pop(parameter.name) for parameter in parameters}
            command(**arguments, given=given)

        with_given.__dict__["__signature__"] = signature
        with_given.__annotations__ = {name: one.annotation for name, one in signature.parameters.items()}
        return with_given

    return with_options


def _parameter(name: str, setting: Setting, panel: str | None) -> inspect.Parameter:
    help, metavar = setting.help, setting.kind.metavar
    if setting.default is not None and setting.kind.option_type is str:
        help += f" (default: {setting.default:g})" if metavar == NUMBER else f" (default: {setting.default})"
    info: Any
    if name == "keypoints":
        info = typer.Argument(metavar="KEYPOINTS...", help=help, show_default=False)
    else:
        flag = f"{option(name)}/--no-{option(name)[2:]}" if setting.kind.option_type is bool else option(name)
        heading = _PANELS[setting.method] if setting.method else panel
        info = typer.Option(flag, help=help, metavar=metavar, rich_help_panel=heading)
    kind = setting.kind.option_type
    annotation = Annotated[list[kind] | None if setting.kind.many else kind | None, info]  # type: ignore[valid-type]
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=annotation)
