"""Test the distribution's name, and the command that adds an extra."""

from __future__ import annotations

import ast
import json
import re
import sys
import tomllib
from collections.abc import Iterator
from importlib import metadata
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest

import recon
from recon.base import package
from recon.base.package import DISTRIBUTION, install_command

ROOT = Path(__file__).parents[2]


@pytest.fixture
def installed(monkeypatch, tmp_path):
    """Return a function that writes the origin of the package as pip records it; None stands for the index."""
    monkeypatch.setattr(sys, "executable", "/opt/python")

    def note(direct_url: dict | None) -> None:
        text = None if direct_url is None else json.dumps(direct_url)
        monkeypatch.setattr(metadata, "distribution", lambda name: SimpleNamespace(read_text=lambda file: text))

    return note


def test_the_distribution_has_the_name_in_pyproject():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert project["name"] == DISTRIBUTION != "recon"
    assert recon.__version__ == package.version() == project["version"]
    own = [line for lines in project["optional-dependencies"].values() for line in lines if line.startswith("recon")]
    assert all(line.startswith(f"{DISTRIBUTION}[") for line in own)


def test_one_version_everywhere():
    """Package, citation, recipe and changelog have the same version, and the recipe has the same requirements."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    recipe = (ROOT / "packaging" / "meta.yaml").read_text(encoding="utf-8")
    cited = re.search(r"^version: (\S+)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    latest = re.search(r"^## \[([0-9].*?)\]", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert cited is not None
    assert latest is not None
    assert {cited[1], latest[1], project["version"]} == {project["version"]}
    assert f'{{% set version = "{project["version"]}" %}}' in recipe
    conda = {"opencv-python-headless": "py-opencv", "matplotlib": "matplotlib-base"}
    for requirement in project["dependencies"]:
        name, least = requirement.split(">=")
        assert f"- {conda.get(name, name)} >={least}\n" in recipe, requirement


def test_extras_come_from_where_the_package_came(installed, monkeypatch, tmp_path):
    """Extras are installed from the package's origin, even if a folder has the package's name."""
    checkout = tmp_path / "my checkout"
    (checkout / "recon" / "base").mkdir(parents=True)
    wheel = tmp_path / "recon_motion-0.1.0-py3-none-any.whl"
    wheel.touch()
    elsewhere = tmp_path / "elsewhere"
    (elsewhere / "recon").mkdir(parents=True)
    local_url = checkout.as_uri()
    expected = [
        (None, "/opt/python -m pip install 'recon-motion[net]'"),
        ({"url": "https://example.org/recon.git", "vcs_info": {}}, "/opt/python -m pip install 'recon-motion[net]'"),
        ({"url": local_url, "dir_info": {"editable": True}}, f"/opt/python -m pip install -e '{checkout}[net]'"),
        ({"url": local_url, "dir_info": {}}, f"/opt/python -m pip install '{checkout}[net]'"),
        ({"url": wheel.as_uri(), "archive_info": {}}, f"/opt/python -m pip install '{wheel}[net]'"),
        ({"url": (tmp_path / "gone").as_uri(), "dir_info": {}}, "/opt/python -m pip install 'recon-motion[net]'"),
    ]
    for direct_url, command in expected:
        installed(direct_url)
        for folder in (checkout, tmp_path, checkout / "recon", Path("/tmp"), elsewhere):
            monkeypatch.chdir(folder)
            assert install_command("net") == command, (direct_url, folder)


def test_a_python_in_a_folder_with_a_space_can_be_copied_into_a_shell(installed, monkeypatch):
    installed(None)
    monkeypatch.setattr(sys, "executable", "/opt/my env/bin/python")
    assert install_command("net") == "'/opt/my env/bin/python' -m pip install 'recon-motion[net]'"
    monkeypatch.setattr(sys, "platform", "win32")
    assert install_command("net") == '"/opt/my env/bin/python" -m pip install "recon-motion[net]"'


def test_no_text_names_another_projects_package():
    """`pip install recon`, with or without an extra, would install another project."""
    texts = [
        ROOT / "README.md",
        *(
            p
            for folder in ("recon", "docs", "notebooks", "benchmarks", "pipelines")
            for p in (ROOT / folder).rglob("*")
        ),
    ]
    for path in texts:
        if path.suffix in (".py", ".md", ".ipynb", ".toml"):
            text = path.read_text(encoding="utf-8")
            assert "recon[" not in text, path
            assert "pip install recon " not in text, path


def docstrings(path: Path) -> Iterator[tuple[int, str, str]]:
    """Yield line, name and text of every docstring of a file, also below constants and fields."""
    nodes: list[ast.AST] = [ast.parse(path.read_text(encoding="utf-8"))]
    while nodes:
        body = getattr(node := nodes.pop(), "body", [])
        nodes += [*body, *getattr(node, "orelse", []), *getattr(node, "handlers", [])]
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            if text := ast.get_docstring(node):
                yield getattr(node, "lineno", 1), getattr(node, "name", path.stem), text
            for named, said in pairwise(body):
                value = said.value if isinstance(said, ast.Expr) else None
                if isinstance(named, ast.Assign | ast.AnnAssign) and isinstance(value, ast.Constant):
                    yield value.lineno, "", str(value.value)


MAY_BE_POOR = re.compile(r"""^\s*r?["']+\s*((Of|That of|Those)\b|[^\s"']\S*(\s+\S+)?\s*["']+$)""", re.MULTILINE)
"""Pattern of a line that may be a poor docstring; files without such a line are not parsed."""


def test_docstrings_stand_alone():
    """Every docstring has a noun, and the docstring of a public name has several words."""
    poor = [
        f"{path.relative_to(ROOT)}:{line}: {text}"
        for folder in ("recon", "tests", "benchmarks", "pipelines", "docs", "data")
        for path in sorted((ROOT / folder).rglob("*.py"))
        if MAY_BE_POOR.search(path.read_text(encoding="utf-8"))
        for line, name, text in docstrings(path)
        if re.match(r"(Of|That of|Those)\b", text)
        or (folder == "recon" and name[:1] not in ("", "_") and len(text.split()) <= 2)
    ]
    assert poor == []
