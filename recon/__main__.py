"""Entry point of `recon` and `python -m recon`."""

import io
import os
import sys

from recon.base.interrupts import Interrupts
from recon.base.memory import collect_rarely

MIN_MB = 640
"""Memory limit, in MB, below which OpenBLAS hangs and rerun cannot be loaded."""


def main() -> None:
    """Run the command line, which Ctrl-C ends at any moment, even during imports."""
    _open_streams()
    _require_memory()
    collect_rarely()
    # otherwise pydantic reads the metadata of every installed distribution, to look for plugins
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    interrupts = Interrupts()
    interrupts.install()
    try:
        from recon.cli.app import main as run_command_line

        run_command_line()
    finally:
        if interrupts.received and not interrupts.announced:
            interrupts.leave()
        _flush()


def _open_streams() -> None:
    """Open missing standard streams, and let all three accept every character.

    A closed stream becomes the null device. Otherwise the next file that is opened would get its descriptor, and
    libraries would print into that file. An ASCII terminal shows escape codes for other characters.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)
    if sys.stdout is None:
        sys.stdout = os.fdopen(1, "w", encoding="utf-8", closefd=False)
    if sys.stderr is None:
        sys.stderr = os.fdopen(2, "w", encoding="utf-8", closefd=False)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _require_memory() -> None:
    try:
        from resource import RLIM_INFINITY, RLIMIT_AS, getrlimit
    except ImportError:  # Windows has no such module
        return
    limit = getrlimit(RLIMIT_AS)[0]
    if limit != RLIM_INFINITY and limit < MIN_MB << 20:
        print(
            f"error: not enough memory: the limit is {limit >> 20} MB (ulimit -v), but {MIN_MB} MB are needed",
            file=sys.stderr,
        )
        sys.exit(1)


def _flush() -> None:
    """Flush standard output, so that recon and not Python reports a failure, and reports it once."""
    ending = sys.exc_info()[1]
    try:
        sys.stdout.flush()
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            sys.exit(1)  # the reader has closed the pipe
        if isinstance(ending, SystemExit) and ending.code:
            return  # the command has reported its failure; some versions of Python keep what could not be written
        print(f"error: standard output: {error.strerror}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()
