"""The distribution that this package is installed from, how to add to it, and the files that come with it.

Its name is not the package's: `recon` on the public index is somebody else's.
"""

from __future__ import annotations

import json
import sys
from importlib import metadata
from pathlib import Path
from urllib.parse import urlsplit
from urllib.request import url2pathname

DISTRIBUTION = "recon-motion"


def version() -> str:
    return metadata.version(DISTRIBUTION)


def install_command(extra: str) -> str:
    """What adds an extra to this very environment, from where the package came: a checkout, a file or the index."""
    return f"{pip_command()} install {_source(extra)}"


def pip_command() -> str:
    """The pip of the Python that runs; the `pip` of a shell may be another's."""
    return f"{_short(sys.executable)} -m pip"


def _source(extra: str) -> str:
    """As pip notes it: https://packaging.python.org/en/latest/specifications/direct-url/"""
    noted = json.loads(metadata.distribution(DISTRIBUTION).read_text("direct_url.json") or "{}")
    url = urlsplit(noted.get("url", ""))
    path = Path(url2pathname(url.path))
    if url.scheme != "file" or not path.exists():
        return f"'{DISTRIBUTION}[{extra}]'"
    return f"{'-e ' if noted.get('dir_info', {}).get('editable') else ''}'{_short(path)}[{extra}]'"


def _short(path: str | Path) -> str:
    """Relative to the current folder, if it is there or below."""
    path, here = Path(path), Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)
