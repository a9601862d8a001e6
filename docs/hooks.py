"""What the site needs beside its pages.

Formulas as MathML, which browsers show without scripts, and pages made from files of the repository outside docs/.
"""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
COPIED = {"changelog.md": "CHANGELOG.md", "contributing.md": "CONTRIBUTING.md"}
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Changelog and contributing, with their links to docs/ as links beside them."""
    for name, source in COPIED.items():
        text = (ROOT / source).read_text(encoding="utf-8").replace("](docs/", "](")
        files.append(File.generated(config, name, content=text))
    return files


def on_page_content(content: str, **_: Any) -> str:
    """arithmatex marks formulas and leaves them in LaTeX."""
    return FORMULA.sub(_mathml, content)


def _mathml(match: re.Match[str]) -> str:
    kind, bracket, latex = match.groups()
    formula = convert(html.unescape(latex).strip(), display="block" if bracket == "[" else "inline")
    return f'<{kind} class="formula">{formula}</{kind}>'
