"""Describe the problems with a file's table field by field, from pydantic's errors."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from recon.base.errors import Problem

_WORDS = {"string": "text", "number": "a number", "integer": "a whole number", "boolean": "true or false"}
_WORDS |= {"array": "a list", "object": "a table"}
"""Words for JSON schema types in messages."""
_EXPECTED = {
    **dict.fromkeys(("string_type", "string_unicode", "path_type"), "text"),
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    "finite_number": "a finite number",
    **dict.fromkeys(("int_type", "int_parsing", "int_from_float", "int_parsing_size"), "a whole number"),
    **dict.fromkeys(("bool_type", "bool_parsing"), "true or false"),
    **dict.fromkeys(("tuple_type", "list_type"), "a list"),
    **dict.fromkeys(("dict_type", "mapping_type", "model_type", "model_attributes_type", "dataclass_type"), "a table"),
    "too_short": "a list of at least {min_length}",
    "too_long": "a list of at most {max_length}",
    **dict.fromkeys(("greater_than", "greater_than_equal", "less_than", "less_than_equal"), "a number {message}"),
    "literal_error": "{expected}",
}
"""Text for the expected value, by the type of pydantic's error, with braces for values from the error's context."""
_Table = Mapping[str, Any] | None
_UNKNOWN = ("extra_forbidden", "unexpected_keyword_argument")


def problems_of(
    error: ValidationError, source: str | Path, schema: _Table = None, skipped: int = 0, table: _Table = None
) -> Iterator[Problem]:
    """Yield the problems with a table, each with its field, such as legs[0].hip_m.

    `schema` is the JSON schema of the table, which gives the known fields and the types of missing fields. `skipped` is
    the number of leading parts of a field's name that the message leaves out. A table without any field of the schema
    yields a single problem.
    """
    fields = (schema or {}).get("properties", {})
    if isinstance(table, Mapping) and fields and not fields.keys() & table.keys():
        value = f"only {', '.join(map(str, table))[:60]}" if table else "nothing"
        yield Problem(source, "content", value, f"a file with {', '.join(fields)}")
        return
    for detail in error.errors():
        location, kind = detail["loc"][skipped:], detail["type"]
        field = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location).removeprefix(".")
        field = field or "content"
        if kind in _UNKNOWN:
            known = _table_at(schema or {}, location[:-1]).get("properties", {})
            yield Problem(
                source, field, "an unknown field", f"one of {', '.join(known)}" if known else "no fields here"
            )
        elif kind == "missing":
            wanted = _table_at(schema or {}, location[:-1]).get("properties", {}).get(location[-1], {})
            title = "object" if "$ref" in wanted else wanted.get("type")
            yield Problem(source, field, "nothing", _WORDS.get(title, "a value"))
        else:
            expected = _EXPECTED.get(kind, "{message}")
            message = detail["msg"].removeprefix("Value error, ").removeprefix("Input should be ")
            wanted = expected.format(message=message, **detail.get("ctx", {}))
            value = "nothing" if detail["input"] is None else repr(detail["input"])[:60]
            yield Problem(source, field, value, wanted)


def _table_at(schema: Mapping[str, Any], location: Iterable[str | int]) -> Mapping[str, Any]:
    """Return the JSON schema of the table at a path of field names.

    Positions in lists are skipped, and so are keys of tables without fixed names.
    """
    table = _table_in(schema, schema)
    for part in location:
        if part in table.get("properties", {}):
            table = _table_in(table["properties"][part], schema)
    return table


def _table_in(part: object, schema: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the first table with fields in part of a JSON schema, or an empty table."""
    if isinstance(part, Mapping):
        table: Mapping[str, Any] = schema["$defs"][part["$ref"].rpartition("/")[2]] if "$ref" in part else part
        if "properties" in table:
            return table
        part = [value for name, value in table.items() if name != "$defs"]
    inner = (_table_in(option, schema) for option in part) if isinstance(part, list) else ()
    return next((table for table in inner if table), {})
