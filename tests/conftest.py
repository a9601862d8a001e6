"""Set up pytest before and after the tests. The fixtures are in `shared_fixtures.py`."""

from __future__ import annotations

import gc
import os
from collections.abc import Generator

import pytest

from recon.base.file_names import encodable

# Set before numpy is loaded, because matrices are small here and several processes share the cores.
os.environ.update(dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

# Collect garbage less often than by default, since modules and most objects of tests are not garbage.
gc.set_threshold(20_000)


def pytest_configure(config: pytest.Config) -> None:
    """Load the fixtures, except in the process that only distributes tests."""
    if "PYTEST_XDIST_WORKER" in os.environ or not config.getoption("numprocesses", None):
        config.pluginmanager.import_plugin("shared_fixtures")


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport() -> Generator:
    """Replace bytes that are not UTF-8 in reports, because they would end a process of pytest-xdist."""
    report = (yield).get_result()
    report.sections = [(name, encodable(text)) for name, text in report.sections]
    if report.failed and encodable(report.longreprtext) != report.longreprtext:
        report.longrepr = encodable(report.longreprtext)


def pytest_collection_finish() -> None:
    """Exclude objects that all tests share from garbage collection."""
    gc.collect()
    gc.freeze()
