"""The process that fits clips, one after the other, and the handle that its parent has on it.

The worker is a Python of its own that imports recon once, reads tasks as lines of JSON and answers in the same way. It
outlives faulty clips, but a crash, be it of Python or of a library, takes only the clip at hand with it: the handle
starts another worker. It ends by itself when its parent does.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

from threadpoolctl import threadpool_limits

from recon.base.errors import InputError
from recon.base.files import sole_writer
from recon.base.package import version
from recon.base.progress import Progress
from recon.show.report import is_unsolved
from recon.workflows.batch.record import CRASH_LOG, Planned, drop_record, finish_record, read_record, start_record
from recon.workflows.batch.summary import results_of
from recon.workflows.clip import fit_clip, write_clip
from recon.workflows.settings import FitSettings

CLIPS_PER_WORKER = 50
"""Then a new one takes over: rerun keeps two to four threads and 1.5 to 3 MB of each recording for good."""
ONE_THREAD = ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMEXPR", "RAYON")
KILLED = 128 + signal.SIGTERM
STOP_S = 3.0
"""A worker that is told to stop has this long to clean up."""
DYING_S = 5.0
"""So long a worker may hold a clip's folder after the batch that it belonged to was killed."""
LOG_BYTES = 20_000


def task_of(planned: Planned, run: str) -> dict[str, Any]:
    """What a worker is told, as plain JSON types. run: which run of the batch it is."""
    settings = planned.clip.settings.plain()
    return {
        "work": "fit",
        "settings": settings,
        "out": str(planned.out.absolute()),
        "run": run,
        "identity": dict(planned.identity),
    }


# -- in the worker ------------------------------------------------------------------------------------------------


def done_with(task: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    """Do a task: columns of the summary. Input that cannot be used is an outcome; a fault is not."""
    began = time.perf_counter()
    try:
        row = WORK[task["work"]](task, progress)
    except (InputError, OSError) as error:
        row = _failed(error)
    return {"seconds": round(time.perf_counter() - began, 3), "attempts": 1, **row}


def _fit(task: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    """Fit and write one clip."""
    out = Path(task["out"])
    try:
        with sole_writer(out, DYING_S):
            return _fit_alone(task, progress)
    finally:
        with contextlib.suppress(OSError):  # there is something in it
            out.rmdir()


def _page(task: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    """The page of one result."""
    from recon.workflows.page import run_page

    run_page(Path(task["out"]), progress=progress)
    return {"status": "done"}


def _run(task: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    """All of `recon run` on one video."""
    from recon.workflows.run import Job, run_video

    done = run_video(Job.from_plain(task["job"]), progress)
    status = "unsolved" if is_unsolved(done.report) else "done earlier" if done.unchanged else "done"
    return {"status": status, **results_of(done.report)}


WORK = {"fit": _fit, "page": _page, "run": _run}
"""What tasks are for."""


def _fit_alone(task: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
    began = time.perf_counter()
    settings, out = FitSettings(**task["settings"]), Path(task["out"])
    attempt, finished, row = 1, False, {}
    try:
        here, there = version(), task["identity"]["version"]
        if here != there:
            return {"status": "failed", "error": f"recon {here} on the worker, {there} where the batch runs"}
        before = read_record(out)
        if before is not None and (before["run"], before["state"]) == (task["run"], "finished"):
            finished = True  # by a worker of the cluster that died before its answer was heard
            return before["row"] | {"attempts": before["attempt"]}
        attempt = start_record(out, task["run"], settings, task["identity"])
        with threadpool_limits(1):
            motion = fit_clip(settings, progress)
            solve_s = time.perf_counter() - began
            progress("writing", 1.0)
            report = write_clip(motion, settings, out, solve_s, sha256=task["identity"]["inputs"])
        row = {"status": "unsolved" if is_unsolved(report) else "done", **results_of(report)}
        row["seconds"] = round(time.perf_counter() - began, 3)
        finish_record(out, task["run"], attempt, settings, task["identity"], row)
        finished = True
    except (InputError, OSError) as error:
        row = _failed(error)
    finally:
        if not finished:
            drop_record(out)
    return {**row, "attempts": attempt}


def _failed(error: InputError | OSError) -> dict[str, Any]:
    text = str(error)
    if isinstance(error, OSError) and error.filename:
        text = f"{error.filename}: {error.strerror}"
    return {"status": "failed", "error": text}


def main() -> None:
    """Work off what comes on standard input, until it is closed."""
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # nothing that a library prints gets between the answers
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(KILLED))  # fits clean up behind them
    tasks: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    threading.Thread(target=_listen, args=(tasks,), daemon=True).start()
    _warm_up()
    last_s = 0.0

    def answer(message: Mapping[str, Any]) -> None:
        answers.write(json.dumps(message) + "\n")
        answers.flush()

    def progress(stage: str, share: float) -> None:
        nonlocal last_s
        if time.monotonic() - last_s > 0.2:
            last_s = time.monotonic()
            answer({"stage": stage, "share": share})

    while True:
        task = json.loads(tasks.get())
        answer({"outcome": done_with(task, progress)})


def _listen(tasks: queue.SimpleQueue[bytes]) -> None:
    """Standard input ends with the parent, however that ended: nobody waits for the clip at hand then."""
    # Not sys.stdin: Python would wait for its lock when it shuts down.
    for line in os.fdopen(os.dup(0), "rb", buffering=0):
        tasks.put(line)
    os._exit(0)


def _warm_up() -> None:
    import cv2

    import recon.show.view  # noqa: F401  # slow to import, and part of no clip

    cv2.setNumThreads(1)


# -- in the parent ------------------------------------------------------------------------------------------------


class WorkerDied(Exception):
    """The message says of what, as far as that is known."""


class Worker:
    """Handle on a process that fits: started when it is needed, again when it died, anew after so many clips."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[str] | None = None
        self._log: IO[bytes] | None = None
        self._clips = 0
        self._stopped = False
        self._lock = threading.Lock()

    @property
    def pid(self) -> int | None:
        return None if self._process is None else self._process.pid

    def fit(self, task: Mapping[str, Any], retries: int, progress: Progress) -> dict[str, Any]:
        """Columns of the summary. A clip at which worker after worker dies has failed; the last words of the last one
        are in its folder. Raises WorkerDied once the worker is stopped."""
        for attempt in range(1, retries + 2):
            try:
                outcome = self._fit(task, progress)
                return outcome | {"attempts": max(outcome["attempts"], attempt)}
            except WorkerDied as died:
                if self._stopped:
                    raise
                message, log = str(died), self._last_words()
            if attempt > retries:
                out = Path(task["out"])
                with contextlib.suppress(OSError):
                    out.mkdir(parents=True, exist_ok=True)
                    (out / CRASH_LOG).write_text(f"{message}\n\n{log}", encoding="utf-8")
                return {"status": "failed", "error": message, "attempts": attempt}
        raise ValueError(f"retries: {retries}, below 0")

    def start(self) -> None:
        """Have a process that is ready for a clip. Raises WorkerDied after `stop`."""
        if self._process is not None and (self._process.poll() is not None or self._clips >= CLIPS_PER_WORKER):
            self.end()
        with self._lock:
            if self._stopped:
                raise WorkerDied("stopped")
            if self._process is None:
                self._log, self._clips = tempfile.TemporaryFile(), 0  # noqa: SIM115  # `end` closes it
                self._process = subprocess.Popen(
                    [sys.executable, "-P", "-c", "from recon.workflows.batch.worker import main; main()"],
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    stderr=self._log,
                    text=True,
                    encoding="utf-8",
                    env={
                        **os.environ,
                        **{f"{name}_NUM_THREADS": "1" for name in ONE_THREAD},
                        "PYTHONFAULTHANDLER": "1",
                    },
                    # The terminal's Ctrl-C is for the parent, which tells its workers.
                    start_new_session=True,
                    creationflags=getattr(subprocess, "CREATE_NEW_PROCESS_GROUP", 0),
                )

    def end(self) -> None:
        """Let the process go, which has nothing to do or is dead; `fit` would start another one."""
        process, log = self._process, self._log
        if process is not None and log is not None:
            process.communicate()
            log.close()
        self._process = self._log = None

    def stop(self) -> None:
        """For good, and now, from any thread: a fit that is under way cleans up, and `fit` raises WorkerDied."""
        with self._lock:
            self._stopped = True
            process = self._process
        if process is None:
            return
        process.terminate()
        try:
            process.wait(STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()

    def _fit(self, task: Mapping[str, Any], progress: Progress) -> dict[str, Any]:
        self.start()
        process = self._process
        assert process is not None
        assert process.stdin is not None
        assert process.stdout is not None
        progress("starting", 0.0)
        with contextlib.suppress(OSError):  # it is dead already, and that is said below
            process.stdin.write(json.dumps(task) + "\n")
            process.stdin.flush()
        for line in process.stdout:
            message = json.loads(line)
            if "outcome" in message:
                self._clips += 1
                return message["outcome"]
            progress(message["stage"], message["share"])
        raise WorkerDied(self._death(process.wait()))

    def _death(self, code: int) -> str:
        if code < 0:
            name = signal.Signals(-code).name
            memory = ", as the system does when memory runs out" if -code == getattr(signal, "SIGKILL", 9) else ""
            return f"the worker was killed ({name}{memory})"
        lines = self._last_words().strip().splitlines() or ["no word"]
        return f"the worker crashed: {lines[-1]}"

    def _last_words(self) -> str:
        if self._log is None:
            return ""
        size = self._log.seek(0, os.SEEK_END)
        self._log.seek(max(size - LOG_BYTES, 0))
        return self._log.read().decode("utf-8", errors="replace")
