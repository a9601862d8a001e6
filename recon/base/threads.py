"""Run linear algebra in one thread."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache

from threadpoolctl import ThreadpoolController


def one_thread() -> AbstractContextManager[object]:
    """Return a context in which NumPy's and SciPy's linear algebra uses one thread.

    Several threads are slower than one for small matrices.
    """
    return _libraries().limit(limits=1, user_api="blas")


@cache
def _libraries() -> ThreadpoolController:
    """Return the libraries that use threads, cached because finding them takes several milliseconds."""
    import scipy.linalg  # noqa: F401  both have to be loaded before they can be found

    return ThreadpoolController()
