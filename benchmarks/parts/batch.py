"""Measure throughput, memory and recovery of `recon batch` on perturbed copies of a sample, some of them broken.

python benchmarks/parts/batch.py [--clips 500] [--broken 10]

The main process, and a worker of a Dask cluster, are killed halfway. The script needs Linux, because memory is read
from /proc. The part on Dask needs the extra `cluster`, and is skipped without it.
"""

from __future__ import annotations

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from arguments import parser_of
from markdown_table import print_table

from recon.api.batch import RECORD
from recon.api.clip_results import Record
from recon.api.samples import samples_folder
from recon.base.package import install_command
from recon.clip import Keypoints
from recon.io.formats import read_keypoints
from recon.testing.gallop import add_noise

SAMPLE = samples_folder() / "whole.csv"
CAMERA = samples_folder() / "camera.toml"


def make_clips(folder: Path, count: int, broken: int) -> None:
    """Write clip_000.csv and so on into two folders, with broken clips spread evenly among them."""
    sample = read_keypoints(SAMPLE)
    at = {int(i): kind for kind, i in enumerate(np.linspace(0, count - 1, broken).round())}
    for i in range(count):
        path = folder / ("first" if i < count // 2 else "second") / f"clip_{i:03}.csv"
        path.parent.mkdir(parents=True, exist_ok=True)
        noisy, _ = add_noise(sample, sigma_px=1.5, dropout=0.02, outlier=0.01, seed=i)
        write_keypoints(noisy, path)
        if i in at:
            BREAK[at[i] % len(BREAK)](path)


def write_keypoints(keypoints: Keypoints, path: Path) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["scorer"] + ["noise"] * 3 * len(keypoints.names))
        writer.writerow(["bodyparts"] + [name for name in keypoints.names for _ in range(3)])
        writer.writerow(["coords"] + ["x", "y", "likelihood"] * len(keypoints.names))
        for frame, points, confidence in zip(keypoints.frames, keypoints.xy_px, keypoints.confidence, strict=True):
            cells = np.column_stack([points, confidence]).round(2).ravel()
            writer.writerow([frame, *("" if np.isnan(cell) else cell for cell in cells)])


def _rewrite(change: Callable[[list[list[str]]], object]) -> Callable[[Path], object]:
    def of_file(path: Path) -> None:
        with path.open(newline="") as file:
            rows = list(csv.reader(file))
        change(rows)
        with path.open("w", newline="") as file:
            csv.writer(file).writerows(rows)

    return of_file


def _cell(rows: list[list[str]]) -> None:
    rows[9][4] = "abc"


def _bird(rows: list[list[str]]) -> None:
    rows[1][1:] = [f"wing_{name}" for name in rows[1][1:]]


def _far(rows: list[list[str]]) -> None:
    for row in rows[3:]:
        row[1:] = ["" if not x else str(1e5 + float(x)) if j % 3 < 2 else x for j, x in enumerate(row[1:])]


def _twice(rows: list[list[str]]) -> None:
    rows[1][4:7] = rows[1][1:4]


def _three_dimensional(path: Path) -> None:
    shutil.copy(SAMPLE.with_name("whole_truth.csv"), path)


def _dangling(path: Path) -> None:
    path.unlink()
    path.symlink_to("gone.csv")


BREAK: tuple[Callable[[Path], object], ...] = (
    lambda path: path.write_text(""),
    lambda path: path.write_bytes(bytes(range(256)) * 40),
    lambda path: path.write_text(path.read_text()[:20_000]),
    lambda path: path.write_text("frame,x,y\n0,1,2\n"),
    _rewrite(_cell),
    _rewrite(_bird),
    _rewrite(_far),
    _rewrite(_twice),
    _three_dimensional,
    _dangling,
)


def command(patterns: list[Path], out: Path, *more: object) -> list[str]:
    code = "from recon.cli.app import main; main()"
    given = [*patterns, "--camera", CAMERA, "--fps", 60, "--out", out, "--json", "--quiet", *more]
    return [sys.executable, "-c", code, "batch", *map(str, given)]


def run(patterns: list[Path], out: Path, *more: object) -> tuple[float, dict[str, dict]]:
    """Run `recon batch`, and return its duration, seconds, and the row of each clip in its summary."""
    began = time.perf_counter()
    done = subprocess.run(command(patterns, out, *more), stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, check=True)
    seconds = time.perf_counter() - began
    rows = json.loads(done.stdout)["clips"]
    by_clip = {row["clip"]: row for row in rows}
    assert len(by_clip) == len(rows), "a clip is in the summary twice"
    return seconds, by_clip


def ended(out: Path) -> int:
    """Return the number of clips that the summary lists as ended."""
    try:
        with (out / "summary.csv").open(newline="") as file:
            return sum(row["status"] != "pending" for row in csv.DictReader(file))
    except FileNotFoundError:
        return 0


def finished(out: Path) -> dict[str, int]:
    """Return the time at which the report of each finished clip was written."""
    found = {}
    for name, row in Record(out / RECORD).rows.items():
        if "files" in row:
            found[name] = (out / name / "report.json").stat().st_mtime_ns
    return found


def count(rows: dict[str, dict], status: str) -> int:
    return sum(row["status"] == status for row in rows.values())


def children(pid: int) -> list[int]:
    found = []
    for path in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            found += [int(child) for child in path.read_text().split()]
        except OSError:  # the process has just ended
            continue
    return found


def rss_mb(pid: int) -> float:
    try:
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
    except OSError:
        return 0.0


def watch(process: subprocess.Popen[bytes], out: Path) -> Iterator[tuple[int, float, list[float]]]:
    """Yield the number of ended clips and the RSS of the main process and each worker, MB, while a process runs."""
    while process.poll() is None:
        yield ended(out), rss_mb(process.pid), [rss_mb(child) for child in children(process.pid)]
        time.sleep(1.0)


def throughput_and_memory(clips: Path, work: Path, total: int) -> None:
    """Print the throughput of a batch with one job and with two jobs, and the memory of the processes."""
    halves = [clips / "first" / "*.csv", clips / "second" / "*.csv"]
    one_s, _ = run(halves[:1], work / "one", "--jobs", 1)
    began = time.perf_counter()
    process = subprocess.Popen(
        command(halves, work / "two", "--jobs", 2), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    samples = list(watch(process, work / "two"))
    two_s = time.perf_counter() - began
    one_s += run(halves[1:], work / "one", "--jobs", 1)[0]
    print_table(
        ["clips", "jobs", "seconds", "clips per second", "ratio"],
        [
            [total, 1, f"{one_s:.1f}", f"{total / one_s:.2f}", ""],
            [total, 2, f"{two_s:.1f}", f"{total / two_s:.2f}", f"{one_s / two_s:.2f}"],
        ],
    )
    rows = []
    for tenth in (1, 5, 10):
        chosen = [s for s in samples if total * (tenth - 1) / 10 <= s[0] <= total * tenth / 10 and s[2]]
        workers = [mb for _, _, by_worker in chosen for mb in by_worker if mb > 0]
        largest = max((mb for _, mb, _ in chosen), default=0.0)
        if workers:
            rows.append([f"{10 * tenth} %", f"{np.median(workers):.0f}", f"{max(workers):.0f}", f"{largest:.0f}"])
    print_table(["clips ended up to", "worker, median RSS (MB)", "worker, largest", "main process, largest"], rows)


def killed(clips: Path, work: Path, total: int, broken: int) -> None:
    """Kill the main process (SIGKILL) halfway, then run the same command again."""
    out, patterns = work / "killed", [clips / "*" / "*.csv"]
    process = subprocess.Popen(command(patterns, out), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while ended(out) < total // 2:
        time.sleep(0.05)
    workers = children(process.pid)
    process.kill()
    process.wait()
    time.sleep(1.0)
    orphans = [pid for pid in workers if rss_mb(pid) > 0]
    before = finished(out)
    _, rows = run(patterns, out)
    after = finished(out)
    again = [name for name, moment in before.items() if after[name] != moment]
    print_table(
        ["finished before the kill", "fitted again", "done in total", "failed", "workers left over"],
        [[len(before), len(again), len(after), count(rows, "failed"), len(orphans)]],
    )
    errors = [[name, row["error"].replace(str(clips), "")[:110]] for name, row in rows.items() if row["error"]]
    print_table(["broken clip", "error"], errors)
    unsolved = [name for name, row in rows.items() if row["status"] == "unsolved"]
    assert not again
    assert len(after) == total - broken + len(unsolved)
    assert len(errors) + len(unsolved) == broken, unsolved


def on_dask(clips: Path, work: Path, total: int, broken: int) -> None:
    """Run two Dask workers, and kill one of them after a third of the clips."""
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        print(f"Dask is not installed: {install_command('cluster')}")
        return
    out = work / "dask"
    cluster: Any = LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0")
    with cluster, Client(cluster) as client:
        given = command([clips / "*" / "*.csv"], out, "--scheduler", cluster.scheduler_address)
        began = time.perf_counter()
        process = subprocess.Popen(given, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        while ended(out) < total // 3:
            time.sleep(0.05)
        pids: Any = client.run(os.getpid)
        victim = next(iter(pids.values()))
        os.kill(victim, signal.SIGKILL)
        answer, _ = process.communicate()
        seconds = time.perf_counter() - began
        rows = json.loads(answer)["clips"]
    names = [row["clip"] for row in rows]
    statuses = [row["status"] for row in rows]
    print_table(
        ["clips", "seconds", "done", "failed", "twice in the summary"],
        [
            [
                total,
                f"{seconds:.1f}",
                statuses.count("done"),
                statuses.count("failed"),
                len(names) - len(set(names)),
            ]
        ],
    )
    assert len(set(names)) == len(names) == total
    assert len(finished(out)) == total - broken + statuses.count("unsolved")


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--clips", type=int, default=500)
    parser.add_argument("--broken", type=int, default=10)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        clips, work = Path(folder) / "clips", Path(folder) / "out"
        make_clips(clips, options.clips, options.broken)
        print("## One process and two\n")
        throughput_and_memory(clips, work, options.clips)
        print("## Killed in the middle\n")
        killed(clips, work, options.clips, options.broken)
        print("## Dask: two workers, one killed in the middle\n")
        on_dask(clips, work, options.clips, options.broken)


if __name__ == "__main__":
    main()
