"""Run the notebooks from top to bottom and save them with their outputs.

    python notebooks/run.py [--out DIR] [NAME ...]

NAME is a notebook or its number; by default, all are run. --out is the folder to write them to, by default their own.
The kernel is the Python of this process, on one thread and without the user's IPython settings, so that a second run of
the same code gives the same file. A notebook whose cells fail or print a warning is not written. The notebooks find
recordings ($RECON_SHARED_DATA) only with --out, so that nothing from recordings is saved in the project.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Sequence
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

# The variables must be set before a child process loads numpy.
os.environ.update(dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1"))

import nbformat
from jupyter_client.kernelspec import KernelSpecManager
from jupyter_client.manager import AsyncKernelManager
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError

HERE = Path(__file__).resolve().parent
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}
TIMEOUT_S = 300
"""Time limit of one cell, and of the start of a kernel, on a busy machine."""

FORKS = multiprocessing.get_context("forkserver")
FORKS.set_forkserver_preload(  # without rerun, which starts threads on import
    [
        *("ipykernel.kernelapp", "matplotlib.pyplot", "matplotlib_inline.backend_inline", "pandas", "scipy.optimize"),
        *("recon.show.plots", "recon.api.clip_results", "recon.ik.clip"),
    ]
)


class Forked(AsyncKernelManager):
    """A kernel in its own process, forked from a process that has imported what most notebooks need."""

    async def _async_launch_kernel(self, kernel_cmd: list[str], **how: Any) -> None:
        process = FORKS.Process(target=kernel, args=(self.connection_file, how["cwd"], how["env"]))
        process.start()
        provisioner: Any = self.provisioner
        provisioner.process = Running(process)
        self._reconcile_connection_info(provisioner.connection_info)


class Running:
    """A process with the methods of `subprocess.Popen` that the kernel manager calls."""

    stdin = stdout = stderr = None

    def __init__(self, process: BaseProcess) -> None:
        self.process, self.wait = process, process.join

    def poll(self) -> int | None:
        return self.process.exitcode

    def send_signal(self, number: int) -> None:
        os.kill(self.process.pid or 0, number)


def kernel(connection_file: str, folder: str, environment: dict[str, str]) -> None:
    import pandas as pd
    from ipykernel.kernelapp import IPKernelApp

    pd.set_option("display.max_columns", 20)  # the value that pandas has when a notebook imports it
    os.chdir(folder)
    os.environ.update(environment)
    IPKernelApp.launch_instance(["-f", connection_file, "--quiet"])


def run(notebook: Path, recordings: str) -> nbformat.NotebookNode:
    """Run a notebook and return it with its outputs.

    `recordings` is the folder of the recordings, or "" for none. Raises CellExecutionError if a cell fails, and
    ValueError if a cell prints a warning.
    """
    node = nbformat.read(notebook, as_version=4)
    with tempfile.TemporaryDirectory() as settings:
        # Without kernel folders, the kernel named python3 is this interpreter. The transport needs no network ports.
        manager = Forked(
            kernel_spec_manager=KernelSpecManager(kernel_dirs=[]),
            transport="ipc",
            connection_file=str(Path(settings) / "kernel.json"),
        )
        # The kernel holds nothing that has to be saved, and an orderly shutdown would take a second.
        client = NotebookClient(
            node,
            km=manager,
            timeout=TIMEOUT_S,
            startup_timeout=TIMEOUT_S,
            record_timing=False,
            coalesce_streams=True,
            shutdown_kernel="immediate",
        )
        own = {"IPYTHONDIR": settings, "RECON_SHARED_DATA": recordings}
        client.execute(cleanup_kc=True, cwd=str(notebook.parent), env={**os.environ, **own})
    node.metadata = nbformat.from_dict(METADATA)
    for number, cell in enumerate(node.cells):
        cell.id = f"cell-{number}"
        if warned := [o.text for o in cell.get("outputs", ()) if o.get("name") == "stderr"]:
            raise ValueError(f"{notebook.name}, cell {number}:\n{''.join(warned)}")
    return node


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--out", type=Path, metavar="DIR")
    given = parser.parse_args(arguments)
    everything = sorted(HERE.glob("[0-9]_*.ipynb"))
    names = [Path(name).stem for name in given.names]
    chosen = [path for path in everything if not names or path.stem in names or path.stem.split("_")[0] in names]
    if len(chosen) < len(names) or not chosen:
        parser.error(f"the notebooks are {', '.join(path.stem for path in everything)}")
    out = given.out or HERE
    recordings = "" if out.resolve() == HERE else os.environ.get("RECON_SHARED_DATA", "")
    out.mkdir(parents=True, exist_ok=True)
    for path in chosen:
        try:
            node = run(path, recordings)
        except (CellExecutionError, ValueError) as error:
            print(f"{path.name}: {error}", file=sys.stderr)
            return 1
        nbformat.validate(node)
        (out / path.name).write_text(nbformat.writes(node) + "\n", encoding="utf-8")
        print(f"{path.name}: {(out / path.name).stat().st_size / 1e3:.0f} kB", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
