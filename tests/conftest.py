"""Fixtures shared by all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real recordings, which are not part of the project: RECON_SHARED_DATA, or ../shared/data by default."""
    default = Path(__file__).resolve().parents[2] / "shared" / "data"
    path = Path(os.environ.get("RECON_SHARED_DATA", default))
    if not path.is_dir():
        pytest.skip(f"no real recordings at {path} (set RECON_SHARED_DATA)")
    return path
