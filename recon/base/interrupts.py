"""End a command at Ctrl-C or SIGTERM, at any moment, with one line on stderr and exit code 130.

This module is imported before anything else, so it imports almost nothing.
"""

from __future__ import annotations

import atexit
import os
import signal
import sys
import time
from types import FrameType
from typing import TYPE_CHECKING, NoReturn

if TYPE_CHECKING:
    from sys import UnraisableHookArgs

EXIT_INTERRUPTED = 130
MESSAGE = "Stopped."
STUCK_S = 3.0
"""Time in seconds that a library has to return after Ctrl-C, before the process ends."""
CLEAN_UP_S = 10.0
"""Time in seconds that a command has after Ctrl-C to remove half-written files and stop its workers."""
TICK_S = 0.05
STOPPING = (signal.SIGINT, signal.SIGTERM)
"""Signals that end a command: Ctrl-C, and the signal that systems send before they kill a process."""


class Interrupts:
    """Handler of the signals of `STOPPING` in a process that runs one command.

    While the command runs, the first Ctrl-C raises KeyboardInterrupt, so that the command can clean up. During an
    import the KeyboardInterrupt is raised after the import, because libraries print exceptions during imports or turn
    them into others. The process ends at once at any other time, at a second Ctrl-C, and if the command does not end in
    time.

    Attributes
    ----------
    in_command
        Whether a command that can clean up is running.
    received
        Whether the command has to stop.
    announced
        Whether the line that reports the interruption has been printed.
    """

    def __init__(self) -> None:
        self.in_command = False
        self.announced = False
        self.received = False
        self._raised = False
        self._leaving = False
        self._watched = False

    def install(self) -> None:
        """Install the handler, in the main thread.

        If SIGINT is ignored, as in the background jobs of a shell script, it stays ignored.
        """
        taken = [
            number for number in STOPPING if signal.getsignal(number) in (signal.default_int_handler, signal.SIG_DFL)
        ]
        for number in taken:
            signal.signal(number, self)
            atexit.register(signal.signal, number, signal.SIG_IGN)  # Python's own exit takes 0.3 s
        if taken and os.name == "posix":
            self._start_watch()

    def leave(self) -> NoReturn:
        """End the process at once, from any thread."""
        while self._leaving:  # another thread is about to end the process
            time.sleep(1.0)
        self._leaving = True
        if os.isatty(2):
            os.write(2, b"\r\x1b[K\x1b[?25h")  # a progress bar may be on this line and may have hidden the cursor
        if not self.announced:
            os.write(2, f"{MESSAGE}\n".encode())
        os._exit(EXIT_INTERRUPTED)

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal of `STOPPING`, when Python calls the handler."""
        if self._leaving:
            return
        if not self.in_command or self.received or (_is_importing(frame) and not self._watched):
            self.leave()
        self.received = True
        self._raise_interrupt(number, frame)

    def _raise_interrupt(self, number: int, frame: FrameType | None) -> None:
        """Raise KeyboardInterrupt in the command if it can clean up, or else let `_watch` try again."""
        if not self.received or self._raised or not self.in_command or _is_importing(frame):
            return
        self._raised = True
        # A library's message about the exception would not help the user.
        sys.excepthook = lambda *_: None
        sys.unraisablehook = self._on_swallowed
        raise KeyboardInterrupt

    def _on_swallowed(self, unraisable: UnraisableHookArgs) -> None:
        """Record that Python dropped a KeyboardInterrupt, for example in a destructor, so that it is raised again."""
        if issubclass(unraisable.exc_type, KeyboardInterrupt):
            self._raised = False

    def _start_watch(self) -> None:
        import threading

        reader, writer = os.pipe()
        os.set_blocking(writer, False)
        signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
        os.register_at_fork(after_in_child=lambda: signal.set_wakeup_fd(-1))
        signal.signal(signal.SIGURG, self._raise_interrupt)
        main, self._watched = threading.get_ident(), True
        threading.Thread(target=self._watch, args=(reader, main), name="interrupts", daemon=True).start()

    def _watch(self, reader: int, main: int) -> None:
        """Make the main thread handle a signal soon, and end the process if it does not.

        Python runs signal handlers between two bytecode instructions of the main thread. The main thread may be in a
        library for a long time, or begin to wait just after the signal. SIGURG, which has no other effect, wakes it.
        """
        while not {*STOPPING} & {*os.read(reader, 64)}:
            pass
        began = time.monotonic()
        while time.monotonic() - began < (CLEAN_UP_S if self.received else STUCK_S):
            time.sleep(TICK_S)
            if not self._raised:
                signal.pthread_kill(main, signal.SIGURG)
        self.leave()


def installed() -> Interrupts | None:
    """Return the handler of this process, if the process runs the command line."""
    return next((h for h in map(signal.getsignal, STOPPING) if isinstance(h, Interrupts)), None)


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
