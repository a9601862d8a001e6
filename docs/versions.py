"""Put the site that `make docs` built beside those of earlier versions (`python docs/versions.py FOLDER`).

FOLDER/VERSION gets the site; FOLDER/versions.json is what the menu of versions on every page reads, and
FOLDER/index.html leads to the newest. The folder is what a web server shows.
"""

from __future__ import annotations

import json
import shutil
import sys
import tomllib
from pathlib import Path

from packaging.version import Version

ROOT = Path(__file__).resolve().parents[1]


def add_version(folder: Path, site: Path, version: str) -> list[str]:
    """All versions that the folder then has, the newest first. A version that is there already is replaced."""
    shutil.rmtree(folder / version, ignore_errors=True)
    shutil.copytree(site, folder / version)
    there = [path.parent.name for path in folder.glob("*/index.html")]
    versions = sorted(there, key=Version, reverse=True)
    listed = [{"version": one, "title": one, "aliases": ["latest"] * (one == versions[0])} for one in versions]
    (folder / "versions.json").write_text(json.dumps(listed, indent=1), encoding="utf-8")
    to_newest = f'<meta http-equiv="refresh" content="0; url={versions[0]}/index.html">'
    (folder / "index.html").write_text(f"<!doctype html><title>recon</title>{to_newest}\n", encoding="utf-8")
    return versions


if __name__ == "__main__":
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    print(", ".join(add_version(Path(sys.argv[1]), ROOT / "site", project["version"])))
