"""Write files of points in tests, and check what readers refuse."""

from __future__ import annotations

from pathlib import Path

from command_line import refusal

from recon.io.formats import read_keypoints

NAN = float("nan")


def refuses(path: Path, *expected: tuple[object, ...], individual: str | None = None, read=read_keypoints) -> None:
    """Check that a reader refuses a file for the expected problems, given as in `refusal`, but without the file."""
    with refusal(*((path, *one) for one in expected)):
        read(path, individual)


def save(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8", newline="")
    return path
