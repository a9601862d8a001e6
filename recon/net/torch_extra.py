"""The optional package torch: whether it is there, and what it can compute with."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from recon.errors import InputError, Problem
from recon.package import install_command

if TYPE_CHECKING:
    import torch  # pyright: ignore[reportMissingImports]

DEVICES = ("auto", "cpu", "cuda", "mps")


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


def use_threads(count: int | None) -> int:
    """Threads for the CPU: as given, or as many as this process may use. The number is part of what a run repeats."""
    torch = require_torch()
    torch.set_num_threads(count or available_cores())
    return torch.get_num_threads()


def available_cores() -> int:
    affinity = getattr(os, "sched_getaffinity", None)
    return len(affinity(0)) if affinity else os.cpu_count() or 1


def fast_half(device: torch.device) -> Any:
    """bfloat16 where a device computes faster with it than with float32, or None. Not float16, whose range is too small
    for gradients unless they are scaled."""
    torch = require_torch()
    if device.type == "cuda":
        return torch.bfloat16 if torch.cuda.is_bf16_supported() else None
    if device.type == "cpu" and getattr(torch.cpu, "_is_amx_tile_supported", lambda: False)():
        return torch.bfloat16
    return None


def placed(network: Any, device: torch.device) -> Any:
    """On a device, in the layout that convolutions are fastest in."""
    torch = require_torch()
    return network.to(device).to(memory_format=torch.channels_last)
