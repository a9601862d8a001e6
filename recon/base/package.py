"""Find the distribution from which this package is installed, its version, and the command that adds an extra.

The distribution and the package have different names, because the name `recon` is taken on the public index.
"""

from __future__ import annotations

import json
import shlex
import sys
from functools import cache
from importlib import metadata
from pathlib import Path
from urllib.parse import urlsplit

DISTRIBUTION = "recon-motion"


@cache
def version() -> str:
    """Return the version of the installed distribution."""
    return metadata.version(DISTRIBUTION)


def install_command(extra: str) -> str:
    """Return the command that adds an extra to this environment, from the source of the package.

    The command works in any folder, because its paths are absolute. pip then does not mistake a folder, or a package of
    the index, for this distribution.
    """
    editable, source = _source()
    return f"{pip_command()} install {'-e ' if editable else ''}{quoted(f'{source}[{extra}]')}"


def pip_command() -> str:
    """Return the pip command of this Python, because `pip` in a shell may belong to another Python."""
    return f"{quoted(sys.executable)} -m pip"


def quoted(word: str) -> str:
    """Return a word quoted for a shell if necessary."""
    if sys.platform == "win32":
        return f'"{word}"' if set(word) - set(_PLAIN) else word
    return shlex.quote(word)


_PLAIN = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-.\\/:"


def _source() -> tuple[bool, str]:
    """Return whether the installation is editable, and its source for pip: an absolute path, or the name on the index.

    References
    ----------
    https://packaging.python.org/en/latest/specifications/direct-url/
    """
    from urllib.request import url2pathname  # slow to import

    direct_url = json.loads(metadata.distribution(DISTRIBUTION).read_text("direct_url.json") or "{}")
    url = urlsplit(direct_url.get("url", ""))
    path = Path(url2pathname(url.path))
    if url.scheme != "file" or not path.exists():
        return False, DISTRIBUTION
    return bool(direct_url.get("dir_info", {}).get("editable")), str(path.absolute())
