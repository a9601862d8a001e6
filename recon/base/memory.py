"""Save time by keeping freed memory in the process and by running the garbage collector rarely."""

from __future__ import annotations

import atexit
import gc
import sys

_TRIM_THRESHOLD = -1
"""Number of glibc's setting M_TRIM_THRESHOLD, from malloc.h."""
_MMAP_THRESHOLD = -3
"""Number of glibc's setting M_MMAP_THRESHOLD, from malloc.h."""
KEPT_BYTES = 1 << 28
"""Maximum amount of freed memory, in bytes, that the process keeps at the end of the heap."""
MAX_BYTES = 1 << 25
"""Minimum size, in bytes, of arrays that are returned to the system when freed. glibc accepts no larger setting."""
NEW_OBJECTS = 400_000
"""Number of new containers after which the garbage collector searches them for unused reference cycles.

The libraries of a fit and of a page make fewer containers than this.
"""


def collect_rarely() -> None:
    """Run the garbage collector rarely, for the whole life of this process, and not when it ends.

    Most objects are made while libraries are loaded, and stay until the end. By default the collector searches new
    objects repeatedly during the imports, and all objects several times when the process ends, although the system then
    frees all memory at once. A command leaves few unused cycles.
    """
    gc.set_threshold(NEW_OBJECTS, *gc.get_threshold()[1:])
    atexit.register(gc.freeze)


def keep_freed_memory() -> None:
    """Let this process keep freed memory until it ends, if the C library is glibc.

    A fit allocates arrays of some megabytes repeatedly, and the system has to clear every page of newly allocated
    memory.
    """
    if sys.platform != "linux":
        return
    import ctypes

    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)  # musl has no mallopt
    if mallopt is not None:
        mallopt(_TRIM_THRESHOLD, KEPT_BYTES)
        mallopt(_MMAP_THRESHOLD, MAX_BYTES)
