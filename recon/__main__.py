"""Where `recon`, and `python -m recon`, begin and end."""

import atexit
import gc
import os
import sys

from recon.base.interrupts import Interrupts

GC_THRESHOLD = 50_000
"""New objects between two looks for garbage. Imports make many and leave no garbage: Python's 700 costs 0.1 s there."""


def main() -> None:
    """Run the command line, as all that this process does: it ends with it, without taking Python down piece by piece,
    which takes 0.1 to 0.2 s. Threads are waited for, and what others have registered to be done at the exit is done."""
    interrupts = Interrupts()
    interrupts.install()
    gc.set_threshold(GC_THRESHOLD, 10, 10)
    code = 1  # of an exception that nobody has caught

    def end() -> None:
        os._exit(_flushed(code))

    atexit.register(end)  # the first to be registered is the last to be called
    try:
        from recon.workflows.cli import main as run

        run()
        code = 0
    except SystemExit as ended:
        code = ended.code if isinstance(ended.code, int) else 1 if ended.code else 0
        raise
    finally:
        if interrupts.received and not interrupts.said:
            interrupts.leave()


def _flushed(code: int) -> int:
    """The exit code, once what was printed is out: another one if that fails."""
    try:
        sys.stdout.flush()
        sys.stderr.flush()
    except BrokenPipeError:
        return code or 1  # whoever read it had enough
    except OSError as error:
        os.write(2, f"error: standard output: {error.strerror}\n".encode())
        return code or 2
    return code


if __name__ == "__main__":
    main()
