"""Work that a thread does while the network computes."""

from __future__ import annotations

from collections import deque
from collections.abc import Generator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")


def ahead(made: Generator[T], count: int) -> Generator[T]:
    """The items of a generator, none of which is None, made by a thread up to `count` of them ahead."""
    with ThreadPoolExecutor(max_workers=1, thread_name_prefix="ahead") as executor:
        waiting = deque(executor.submit(next, made, None) for _ in range(count))
        try:
            while (item := waiting.popleft().result()) is not None:
                waiting.append(executor.submit(next, made, None))
                yield item
        finally:
            executor.shutdown(wait=True, cancel_futures=True)
            made.close()
