"""Test that linear algebra runs in one thread where it should."""

from __future__ import annotations

import numpy.linalg  # noqa: F401  loaded, so that the test finds its library
import scipy.linalg  # noqa: F401
from threadpoolctl import ThreadpoolController, threadpool_limits

from recon.base.threads import one_thread


def threads() -> list[int]:
    return [library["num_threads"] for library in ThreadpoolController().select(user_api="blas").info()]


def test_libraries_use_one_thread_only_within_the_context():
    for _ in range(2):
        with threadpool_limits(2, user_api="blas"):
            before = threads()
            with one_thread():
                assert threads() == [1] * len(before)
            assert threads() == before
    assert before
