"""What the site needs beside its pages: an extension of Markdown, named in mkdocs.yml.

Formulas become MathML, which browsers show without scripts. A file of the repository that a page holds as a snippet has
links to docs/: on the page they lead to the pages beside it. Pages have links to the scripts that they hold as
snippets, for who reads them where snippets stay empty: here the scripts follow by themselves.
"""

from __future__ import annotations

import html
import re

from latex2mathml.converter import convert
from markdown import Extension, Markdown
from markdown.postprocessors import Postprocessor
from markdown.preprocessors import Preprocessor

FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)
SCRIPT = re.compile(r"\[([^]]+)]\(\.\./pipelines/[^)]+\)")
AFTER_SNIPPETS = 31
"""pymdownx.snippets has 32; the higher comes first."""


class SiteExtension(Extension):
    def extendMarkdown(self, md: Markdown) -> None:
        md.preprocessors.register(LinksBeside(md), "links-beside", AFTER_SNIPPETS)
        md.postprocessors.register(Formulas(md), "formulas", 0)


class LinksBeside(Preprocessor):
    def run(self, lines: list[str]) -> list[str]:
        return [SCRIPT.sub(r"\1", line).replace("](docs/", "](") for line in lines]


class Formulas(Postprocessor):
    """arithmatex marks formulas and leaves them in LaTeX."""

    def run(self, text: str) -> str:
        return FORMULA.sub(_mathml, text)


def _mathml(match: re.Match[str]) -> str:
    kind, bracket, latex = match.groups()
    formula = convert(html.unescape(latex).strip(), display="block" if bracket == "[" else "inline")
    return f'<{kind} class="formula">{formula}</{kind}>'


def makeExtension() -> SiteExtension:
    """The name that Markdown calls."""
    return SiteExtension()
