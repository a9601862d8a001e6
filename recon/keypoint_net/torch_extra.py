"""The optional package torch: whether it is there, and what it can compute with."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from recon.base.errors import InputError, Problem
from recon.base.package import install_command
from recon.base.parallel import available_cores
from recon.base.settings import Option

if TYPE_CHECKING:
    import torch  # pyright: ignore[reportMissingImports]

TIMED = 3
"""Times that work is done with each number of threads, to time it."""
SLOWER = 1.2
"""From which on more threads are not tried, either."""
DEVICES = ("auto", "cpu", "cuda", "mps")
DEVICE = Option("auto, cpu, cuda or mps.")
THREADS = Option("Threads on the CPU. (default: the fastest)", "1 or more")


def require_torch() -> Any:
    """The package. Raises InputError, which says what to install, where there is none."""
    try:
        import torch  # pyright: ignore[reportMissingImports]
    except ImportError:
        found, expected = "none", f"torch: {install_command('net')}"
        raise InputError(Problem("recon train, recon predict", "package for networks", found, expected)) from None
    return torch


def choose_device(name: str) -> torch.device:
    """ "auto" is CUDA or MPS where there is one, else the CPU. Raises InputError for a device that is not there."""
    torch = require_torch()
    there = {"cpu": True, "cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available()}
    if name == "auto":
        name = next(device for device in ("cuda", "mps", "cpu") if there[device])
    if not there.get(name):
        found = f"'{name}'" if name not in DEVICES else f"{name}, which torch {torch.__version__} does not find here"
        raise InputError(
            Problem("--device", "device", found, "one of: auto, " + ", ".join(d for d in there if there[d]))
        )
    return torch.device(name)


def use_threads(count: int | None) -> None:
    """Threads for the CPU: as given, or as many as this process may use. The number is part of what a run repeats."""
    require_torch().set_num_threads(count or available_cores())


def fastest_threads(work: Callable[[], object]) -> dict[int, float]:
    """Sets the number of threads with which the work is fastest now: 1, 2, 4 and so on, up to all cores. Seconds by
    number, the fastest first. Beside other work, all cores can be many times slower than one: each waits for the last.

    The work is done four times with each number, the first of them to warm up; where it gets slower, no more are tried.
    """
    torch = require_torch()
    cores, took = available_cores(), {}
    for count in [*(n for n in (2**i for i in range(16)) if n < cores), cores]:
        torch.set_num_threads(count)
        best = min(took.values(), default=math.inf)
        times = []
        for _ in range(1 + TIMED):
            start = time.perf_counter()
            work()
            times.append(time.perf_counter() - start)
            if times[-1] > 2 * best and len(times) > 1:
                break
        took[count] = float(np.median(times[1:]))
        if took[count] > SLOWER * best:
            break
    took = dict(sorted(took.items(), key=lambda item: item[1]))
    torch.set_num_threads(next(iter(took)))
    return took


def fast_half(device: torch.device) -> Any:
    """bfloat16 where a device computes faster with it than with float32, or None. Not float16, whose range is too small
    for gradients unless they are scaled."""
    torch = require_torch()
    if device.type == "cuda":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else None
    if device.type == "cpu":
        has = (getattr(torch.cpu, f"_is_{unit}_supported", lambda: False)() for unit in ("amx_tile", "avx512_bf16"))
        return torch.bfloat16 if any(has) else None
    return None


def placed(network: Any, device: torch.device) -> Any:
    """On a device, in the layout that convolutions are fastest in."""
    torch = require_torch()
    return network.to(device).to(memory_format=torch.channels_last)
