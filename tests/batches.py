"""Plan and run batches in tests, and read the tables that batches write."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

from command_line import Refusal, refusal

from recon import find_clips
from recon.api.batch import COLUMNS
from recon.api.batch_inputs import Clip

SAMPLES = Path(__file__).resolve().parents[1] / "data" / "samples"
CAMERA = SAMPLES / "camera.toml"
QUICK = {"camera": CAMERA, "fps": 30, "method": "frame", "frames": "0:4"}


def found(*inputs: object, **common: Any) -> list[Clip]:
    return find_clips([str(one) for one in inputs], QUICK | common)[0]


def names(*inputs: object) -> list[str]:
    return [clip.name for clip in found(*inputs)]


def manifest(folder: Path, text: str, name: str = "manifest.csv") -> Path:
    (folder / name).write_text(text)
    return folder / name


def refuses(inputs: list[object], *expected: Refusal, common: dict[str, Any] = QUICK, by: str = "auto") -> None:
    with refusal(*expected):
        find_clips([str(one) for one in inputs], common, cameras_by=by)


def table(out: Path) -> dict[str, dict[str, str]]:
    """Return the rows of a batch's summary.csv by clip, and check that every clip occurs once."""
    with (out / "summary.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    by_clip = {row["clip"]: row for row in rows}
    assert len(by_clip) == len(rows)
    assert tuple(rows[0]) == COLUMNS
    return by_clip


def staging_folders(out: Path) -> list[Path]:
    return list(out.rglob(".recon-partial-*"))
