"""Describe settings: one class for each command, from which its options, its help and what Python takes follow.

A setting is one field: its type says which values it may have, the text below it is its help, and an `Option` in its
`Annotated` says what else the command line has to know.

    class ViewSettings(Settings):
        folder: Annotated[Path, Option(argument="DIR")]
        '''Folder of results, as in results/clip.'''
        speed: Positive = 1.0
        '''Speed of the playback, 1 is real time.'''
"""

from __future__ import annotations

import typing
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, dataclass_transform

import pydantic
from pydantic import AfterValidator, BeforeValidator, Field, ValidationError
from pydantic.fields import FieldInfo

from recon.base.errors import Problem, raise_problems

FILE_SUFFIXES = (".toml", ".npz", ".csv")
"""What ends so is no name of something built in."""

# -- types of values, beside bool, str, Path and Literal ---------------------------------------------------------


def _no_bool(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("a truth value")
    return value


def _as_tuple(value: Any) -> Any:
    return tuple(value) if isinstance(value, list | tuple) else (value,)


def _name_or_file(value: Any) -> Any:
    text = str(value) if isinstance(value, Path) else value
    return str(Path(text).absolute()) if isinstance(text, str) and text.endswith(FILE_SUFFIXES) else text


_MAY_BE_FILE = object()
"""Among the parts of a type: text that names a file where it ends as one."""
_Value = TypeVar("_Value")
Number = Annotated[float, BeforeValidator(_no_bool), Field(allow_inf_nan=False)]
"""A number that is finite."""
Positive = Annotated[Number, Field(gt=0)]
NotNegative = Annotated[Number, Field(ge=0)]
Integer = Annotated[int, BeforeValidator(_no_bool)]
Count = Annotated[Integer, Field(gt=0)]
File = Annotated[Path, AfterValidator(Path.absolute)]
"""A path, made absolute, so that a config.toml with it can be run again from anywhere."""
NameOrFile = Annotated[str, BeforeValidator(_name_or_file), _MAY_BE_FILE]
"""The name of something built in, or a file as its absolute path."""
OneOrMore = Annotated[tuple[_Value, ...], BeforeValidator(_as_tuple), Field(min_length=1)]
"""One value, or a list of them, as a tuple. Its option may be given several times."""


# -- what people are told of a setting ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Option:
    """What is known of a setting besides its type and its default."""

    help: str = ""
    """For the command line; empty: the text below the field. Where the default is None, it says in brackets what
    happens instead."""
    expected: str = ""
    """Ends the sentence "found ..., expected ..." where a value is wrong; empty: made of the type."""
    common: bool = True
    """Whether it is an option of its own. Others are set with `--set name=value` and in config.toml."""
    argument: str = ""
    """What the help calls it if it is an argument, not an option."""
    metavar: str = ""
    """What the help calls the value; empty: made of the type."""
    name: str = ""
    """On the command line, if not made of the field's name, as in --from."""
    panel: str | None = None
    """The heading in the help that the option stands under."""
    method: str | None = None
    """The only method of fitting that reads the setting."""


@dataclass(frozen=True)
class SettingInfo:
    """One setting of a class, for the command line and for messages."""

    field: str
    option: Option
    default: Any
    """MISSING where it must be given, None where it has none."""
    parts: tuple[Any, ...]
    """All that its type consists of."""

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
        """Whether it is a tuple of one value or several, and its option may be given several times."""
        return Ellipsis in self.parts

    @property
    def choices(self) -> tuple[str, ...]:
        """The words of a `Literal`, none for other types."""
        return tuple(part for part in self.parts if isinstance(part, str))

    def is_file(self, value: Any) -> bool:
        """Whether the value is a path."""
        return Path in self.parts or (_MAY_BE_FILE in self.parts and str(value).endswith(FILE_SUFFIXES))

    @property
    def on_command_line(self) -> str:
        """As in --fps, or KEYPOINTS for an argument, or --set sigma-px for what is no option of its own."""
        if self.option.argument:
            return self.option.argument
        name = self.option.name or "--" + self.field.replace("_", "-")
        return name if self.option.common else f"--set {name[2:]}"

    def expected(self, message: str = "") -> str:
        """Return what is expected of a value, in the user's words; message: what pydantic says of a wrong one."""
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

    def plain(self, value: Any) -> Any:
        """Return the value as TOML and JSON have it; a single one of many by itself."""
        if isinstance(value, tuple | list):
            values = [self.plain(item) for item in value]
            return values[0] if self.is_many and len(values) == 1 else values
        return str(value) if isinstance(value, Path) else value


_CONFIG = pydantic.ConfigDict(extra="forbid", use_attribute_docstrings=True)


@dataclass_transform(frozen_default=True, kw_only_default=True)
class Settings:
    """Hold the settings of a command: a subclass is a frozen dataclass, with the help of each field below it.

    Text is taken for numbers, sizes and files; None is not given. Raises InputError with everything that is wrong.
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

    def __repr__(self) -> str:
        """Return the settings that are not as by default."""
        values = {name: (getattr(self, name), info.default) for name, info in self.infos().items()}
        changed = (f"{name}={value!r}" for name, (value, usual) in values.items() if value != usual)
        return f"{type(self).__name__}({', '.join(changed)})"

    @classmethod
    def problems_of_given(cls, values: Mapping[str, Any]) -> Iterable[Problem]:
        """Return what does not go together in what was given, whether or not single values can be used."""
        return ()

    def problems(self) -> Iterable[Problem]:
        """Return what does not go together, once all values can be used."""
        return ()

    @classmethod
    @cache
    def infos(cls) -> dict[str, SettingInfo]:
        """All settings by name, in their order."""
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
            default = MISSING if isinstance(field.default, FieldInfo) else field.default  # required
            infos[field.name] = SettingInfo(field.name, option, default, tuple(_parts(types[field.name])))
        return infos


OUTPUTS = ("out", "overlay")
"""The settings that name what a command writes; all other paths are what it reads."""


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
    except (OSError, ValueError):  # a text that no file can be called
        return False


def _problems(cls: type[Settings], values: Mapping[str, Any], error: ValidationError) -> list[Problem]:
    """In the user's words, one for each setting."""
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
    """Return the problem of a setting that does not exist, with the one that was perhaps meant."""
    meant = get_close_matches(name, infos, 1)
    return Problem(file, name, "an unknown setting", f"perhaps {meant[0]}" if meant else f"one of {', '.join(infos)}")


def _parts(kind: Any) -> Iterator[Any]:
    """Everything that a type consists of, at any depth."""
    yield typing.get_origin(kind) or kind
    inner = typing.get_args(kind)
    for part in inner:
        yield from _parts(part)


def on_command_line(problem: Problem, infos: Mapping[str, SettingInfo]) -> Problem:
    """Return the problem of a setting, with its option in place of the class."""
    known = problem.file == "settings" and problem.field in infos
    return replace(problem, file=infos[problem.field].on_command_line) if known else problem
