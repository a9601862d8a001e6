"""Embed scripts and style sheets in pages.

The scripts are plain JavaScript modules in folders next to this file. A page is a single file that is opened from a
disk, from which browsers do not load modules. Therefore `script` joins the modules into one script, in the order of
their imports.
"""

from __future__ import annotations

import re
from functools import cache
from pathlib import Path

FOLDER = Path(__file__).parent
_IMPORT = re.compile(r'^import \{[^}]*\} from "\./(\w+)\.js";\n', re.MULTILINE)
_EXPORT = re.compile(r"^export (?=class |function |const )", re.MULTILINE)


@cache
def script(name: str, folder: str = "player") -> str:
    """Return the script of a JavaScript module, preceded by the scripts of all modules that it imports."""
    parts: dict[str, str] = {}
    _add(name, FOLDER / folder, parts)
    content = "\n".join(parts.values())
    return '"use strict";\n(() => {\n' + content + "})();\n"


@cache
def style(name: str, folder: str = "player") -> str:
    """Return the content of a style sheet."""
    return (FOLDER / folder / f"{name}.css").read_text(encoding="utf-8")


def _add(name: str, folder: Path, parts: dict[str, str]) -> None:
    if name in parts:
        return
    content = (folder / f"{name}.js").read_text(encoding="utf-8")
    for imported in _IMPORT.findall(content):
        _add(imported, folder, parts)
    parts[name] = _EXPORT.sub("", _IMPORT.sub("", content))
