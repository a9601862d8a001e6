"""Keep memory that a process frees for its next arrays, instead of returning it to the system each time."""

from __future__ import annotations

import sys

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Numbers of glibc's settings, from malloc.h."""
KEPT_BYTES, LARGEST_BYTES = 1 << 28, 1 << 25
"""Largest amount of freed memory that the process keeps, and size from which an array is returned when it is freed;
glibc takes no larger one.
"""


def keep_freed_memory() -> None:
    """Let this process keep freed memory, for its whole life; only where the C library is glibc.

    A fit allocates arrays of some megabytes again and again. The system has to clear each page of them, which takes a
    twelfth of the time of the fit of a long clip.
    """
    if sys.platform != "linux":
        return
    import ctypes

    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has none
    if mallopt is not None:
        mallopt(_TRIM_THRESHOLD, KEPT_BYTES)
        mallopt(_MMAP_THRESHOLD, LARGEST_BYTES)
