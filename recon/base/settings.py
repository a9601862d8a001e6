"""Describe the settings of each command by one class, from which options, help and the Python interface follow.

A setting is one field. The type of the field limits the values, and the text below the field is the help. An `Option`
in `Annotated` adds what else the command line needs.

    class ViewSettings(Settings):
        folder: Annotated[Path, Option(argument="DIR")]
        '''Folder of results, such as results/clip.'''
        speed: Positive = 1.0
        '''Speed of the playback, 1 is real time.'''
"""

from __future__ import annotations

import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from difflib import get_close_matches
from functools import cache
from inspect import Parameter, Signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, dataclass_transform

import pydantic
from pydantic import AfterValidator, BeforeValidator, Field, ValidationError
from pydantic.fields import FieldInfo

from recon.base.errors import Problem, raise_problems

FILE_SUFFIXES = (".toml", ".npz", ".csv")
"""Suffixes that mark a string as a file instead of the name of a built-in item."""


def _no_bool(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError("a boolean")
    return value


def _as_tuple(value: object) -> tuple[object, ...]:
    return tuple(value) if isinstance(value, list | tuple) else (value,)


def _name_or_file(value: object) -> object:
    text = str(value) if isinstance(value, Path) else value
    return str(Path(text).absolute()) if isinstance(text, str) and text.endswith(FILE_SUFFIXES) else text


_UNITS = {
    "fps": "Hz",
    "_m_s": "m/s",
    "_deg": "degrees",
    "_px": "pixels",
    "_kg": "kg",
    "_rad": "rad",
    "_m": "m",
    "_s": "s",
}
"""Units by the suffix of a setting's name, longer suffixes first."""
_MAY_BE_FILE = object()
"""Marker of a string type whose value is a file if it ends like a file name."""
_Value = TypeVar("_Value")
Number = Annotated[float, BeforeValidator(_no_bool), Field(allow_inf_nan=False)]
"""Type of a finite number."""
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Integer = Annotated[int, BeforeValidator(_no_bool)]
Count = Annotated[Integer, Field(gt=0)]
File = Annotated[Path, AfterValidator(Path.absolute)]
"""Type of a path, which is made absolute, so that a config.toml can be run again from any folder."""
NameOrFile = Annotated[str, BeforeValidator(_name_or_file), _MAY_BE_FILE]
"""Type of the name of a built-in item, or of the absolute path of a file."""
OneOrMore = Annotated[tuple[_Value, ...], BeforeValidator(_as_tuple), Field(min_length=1)]
"""Type of one or more values, as a tuple, whose option on the command line may be repeated."""


@dataclass(frozen=True)
class Option:
    """Properties of a setting beyond its type and its default."""

    help: str = ""
    """Help on the command line; if empty, the text below the field.

    If the default is None, text in brackets says what happens without the setting.
    """
    expected: str = ""
    """Description of the expected value for messages; if empty, it is made from the type."""
    common: bool = True
    """Whether the setting has its own option, and not only `--set name=value` and config.toml."""
    argument: str = ""
    """Name of the argument in the help, if the setting is an argument; empty for an option."""
    metavar: str = ""
    """Name of the value in the help; if empty, it is made from the type."""
    name: str = ""
    """Name on the command line, such as --from, if it differs from the field's name; otherwise empty."""
    panel: str | None = None
    """Heading of the help under which the option stands."""
    method: str | None = None
    """Fitting method that reads the setting; None if all methods read it."""


@dataclass(frozen=True)
class SettingInfo:
    """Description of one setting of a class, for the command line and for messages."""

    field: str
    option: Option
    default: Any
    """Default value; MISSING for a required setting, None for an optional setting without a value."""
    parts: tuple[object, ...]
    """All parts of the setting's type, at any depth."""

    @property
    def is_flag(self) -> bool:
        """Return whether the option takes no value."""
        return bool in self.parts

    @property
    def is_number(self) -> bool:
        """Return whether the setting is a number."""
        return float in self.parts or (int in self.parts and tuple not in self.parts)

    @property
    def is_many(self) -> bool:
        """Return whether the value is a tuple of one or more values, whose option may be repeated."""
        return Ellipsis in self.parts

    @property
    def choices(self) -> tuple[str, ...]:
        """Return the words of a `Literal`; empty for other types."""
        return tuple(part for part in self.parts if isinstance(part, str))

    def is_file(self, value: object) -> bool:
        """Return whether a value of the setting is the path of a file or folder."""
        return Path in self.parts or (_MAY_BE_FILE in self.parts and str(value).endswith(FILE_SUFFIXES))

    @property
    def on_command_line(self) -> str:
        """Return the name on the command line: --fps, KEYPOINTS for an argument, --set sigma-px for a rare setting."""
        if self.option.argument:
            return self.option.argument
        name = self.option.name or "--" + self.field.replace("_", "-")
        return name if self.option.common else f"--set {name[2:]}"

    @property
    def kind(self) -> str:
        """Return the kind of value in words, with its unit: "float, m/s", "path or list of paths"."""
        words = {bool: "bool", Path: "path", float: "float", int: "int", str: "str"}
        also_flag = ["bool"] if self.is_flag and self.choices else []
        word = " | ".join([*also_flag, *map(repr, self.choices)]) or next(
            (w for part, w in words.items() if part in self.parts), "str"
        )
        if self.is_many:
            word = f"{word} or list of {word}s"
        units = (unit for ending, unit in _UNITS.items() if self.field.endswith(ending))
        return ", ".join([word, *list(units)[:1]])

    def expected(self, message: str = "") -> str:
        """Return what is expected of a value, in the user's words.

        `message` is pydantic's message about a wrong value.
        """
        if self.option.expected:
            return self.option.expected
        if self.choices:
            *first, last = self.choices
            return f"{', '.join(first)} or {last}" if first else last
        if message == "Field required" and self.option.help:
            words = self.option.help.split(". ")[0].rstrip(".")
            return words if words.startswith("DeepLabCut") else words[0].lower() + words[1:]
        kinds = {bool: "true or false", float: "a number", int: "a whole number", Path: "a file or a folder"}
        kind = next((words for part, words in kinds.items() if part in self.parts), "text")
        limit = message.removeprefix("Input should be ")
        return f"{kind} {limit}" if limit.startswith(("greater", "less")) else kind

    def plain(self, value: object) -> object:
        """Return the value as TOML and JSON types, with the only value of a tuple instead of the tuple."""
        if isinstance(value, tuple | list):
            values = [self.plain(item) for item in value]
            return values[0] if self.is_many and len(values) == 1 else values
        return str(value) if isinstance(value, Path) else value


_CONFIG = pydantic.ConfigDict(extra="forbid", use_attribute_docstrings=True)


class _ReadableSignature:
    """Signature of a settings class with the kind and the unit of each value, which is made on request."""

    def __get__(self, instance: object, cls: type[Settings]) -> Signature:
        by_name = Parameter.KEYWORD_ONLY
        return Signature(
            [
                Parameter(
                    name,
                    by_name,
                    default=Parameter.empty if info.default is MISSING else info.default,
                    annotation=info.kind,
                )
                for name, info in cls.infos().items()
            ]
        )


@dataclass_transform(frozen_default=True, kw_only_default=True)
class Settings:
    """Base class of a command's settings.

    A subclass is a frozen dataclass, with the help of each field below the field. Strings are accepted for numbers,
    sizes and files. None means that a setting is not given.

    Raises
    ------
    InputError
        If values cannot be used. The message lists all problems.
    """

    if not TYPE_CHECKING:  # type checkers know the fields

        def __init_subclass__(cls) -> None:
            pydantic.dataclasses.dataclass(frozen=True, kw_only=True, repr=False, config=_CONFIG)(cls)
            check = cls.__init__

            def __init__(self: Settings, **values: Any) -> None:  # noqa: N807  the class gets it
                values = {name: value for name, value in values.items() if value is not None}
                problems = []
                try:
                    check(self, **values)
                except ValidationError as error:
                    problems = _problems(type(self), values, error)
                problems += self.problems_of_given(values)
                if not problems:
                    problems += self.problems()
                raise_problems(problems)

            cls.__init__ = __init__
            cls.__signature__ = _ReadableSignature()

    def __repr__(self) -> str:
        """Return the settings that differ from their defaults."""
        values = {name: (getattr(self, name), info.default) for name, info in self.infos().items()}
        changed = (f"{name}={value!r}" for name, (value, usual) in values.items() if value != usual)
        return f"{type(self).__name__}({', '.join(changed)})"

    @classmethod
    def problems_of_given(cls, values: Mapping[str, Any]) -> Iterable[Problem]:
        """Return contradictions between the given settings, some of which may be invalid on their own."""
        return ()

    def problems(self) -> Iterable[Problem]:
        """Return contradictions between the settings, given that every value is valid on its own."""
        return ()

    @classmethod
    @cache
    def infos(cls) -> dict[str, SettingInfo]:
        """Return the description of each setting, keyed by the setting's name, in the order of the class's fields."""
        types = typing.get_type_hints(cls, include_extras=True)
        field_items = (vars(info).get("__pydantic_fields__", {}).items() for info in reversed(cls.__mro__))
        texts = {
            name: " ".join(info.description.split())
            for items in field_items
            for name, info in items
            if info.description
        }
        infos = {}
        for field in fields(cls):  # pyright: ignore[reportArgumentType]
            metadata = getattr(types[field.name], "__metadata__", ())
            option = next((info for info in metadata if isinstance(info, Option)), Option())
            option = replace(option, help=option.help or texts.get(field.name, ""))
            default = MISSING if isinstance(field.default, FieldInfo) else field.default  # a required setting
            infos[field.name] = SettingInfo(field.name, option, default, tuple(_parts(types[field.name])))
        return infos


OUTPUTS = ("out", "overlay")
"""Names of settings for paths to which a command writes, unlike all other paths, which it reads."""


def input_paths(settings: Settings) -> tuple[Path, ...]:
    """Return the files and folders among the values of settings that a command reads."""
    paths: list[Path] = []
    for name in settings.infos():
        value = getattr(settings, name)
        values = value if isinstance(value, tuple) else (value,)
        paths += [Path(text) for text in values if name not in OUTPUTS and isinstance(text, str | Path)]
    return tuple(path for path in paths if _exists(path))


def _exists(path: Path) -> bool:
    try:
        return path.exists()
    except (OSError, ValueError):  # the string cannot be a file name
        return False


def _problems(cls: type[Settings], values: Mapping[str, Any], error: ValidationError) -> list[Problem]:
    """Return one problem in the user's words for each setting that pydantic refuses."""
    infos, problems = cls.infos(), {}
    for detail in error.errors(include_url=False):
        name = str(detail["loc"][0])
        if name in infos and name not in problems:
            value = repr(values[name]) if name in values else "nothing"
            problems[name] = Problem("settings", name, value, infos[name].expected(detail["msg"]))
        elif name not in problems:
            problems[name] = unknown_setting("settings", name, infos)
    return [*problems.values()]


def unknown_setting(file: str, name: str, infos: Mapping[str, SettingInfo]) -> Problem:
    """Return the problem with a setting that does not exist, and suggest the name that was probably meant."""
    meant = get_close_matches(name, infos, 1)
    return Problem(
        file,
        name,
        "an unknown setting",
        f"a known setting, perhaps {meant[0]}" if meant else f"one of {', '.join(infos)}",
    )


def _parts(kind: object) -> Iterator[object]:
    """Yield the type and, at any depth, the types in its arguments, such as list and int for list[int]."""
    yield typing.get_origin(kind) or kind
    inner = typing.get_args(kind)
    for part in inner:
        yield from _parts(part)


def on_command_line(problem: Problem, infos: Mapping[str, SettingInfo]) -> Problem:
    """Return a problem in which the command-line name, such as --fps, replaces the name of the setting.

    A problem that does not concern a setting in `infos` is returned unchanged.
    """
    known = problem.file == "settings" and problem.field in infos
    return replace(problem, file=infos[problem.field].on_command_line) if known else problem
