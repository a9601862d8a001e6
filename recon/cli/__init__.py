"""Command line: arguments in, a pipeline called, nothing else."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Column, Table
from rich.text import Text

from recon import __version__
from recon.errors import InputError, Problem

if TYPE_CHECKING:
    from recon.analysis.evaluation import Evaluation

app = typer.Typer(
    help="Metric 3D motion of a running animal from one camera and DeepLabCut keypoints.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_TRAJECTORY, _FRAME = "Trajectory method", "Frame method"

EXIT_UNSOLVED = 1
EXIT_BAD_INPUT = 2


def main() -> None:
    """Run the command line; a user's mistake ends with one message and exit code 2."""
    console = Console(stderr=True, soft_wrap=True)
    try:
        app()
    except InputError as error:
        for problem in error.problems:
            console.print(_error(str(problem)))
        sys.exit(EXIT_BAD_INPUT)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        console.print(_error(f"{where}{error.strerror or error}"))
        sys.exit(EXIT_BAD_INPUT)


def _error(message: str) -> Text:
    return Text.assemble(("error:", "bold red"), " ", message)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"recon {__version__}")
        raise typer.Exit()


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command()
def fit(
    keypoints: Annotated[
        Path | None,
        typer.Argument(metavar="KEYPOINTS", help="DeepLabCut file, CSV or H5, as in clip.csv.", show_default=False),
    ] = None,
    camera: Annotated[
        Path | None,
        typer.Option(help="Calibration: OpenCV yaml/json/xml, AcinoSet scene.json, Anipose or recon toml."),
    ] = None,
    camera_name: Annotated[
        str | None, typer.Option(help="Which camera of the file, by name or number, as in cam2 or 2.")
    ] = None,
    fps: Annotated[float | None, typer.Option(help="Frame rate of the video in Hz, as in 120.")] = None,
    out: Annotated[Path | None, typer.Option(help="Folder for the results, as in results/clip1.")] = None,
    method: Annotated[
        str | None,
        typer.Option(
            help="trajectory: the whole animal over the whole clip; frame: one side, one frame after the other. "
            "(default: trajectory)"
        ),
    ] = None,
    skeleton: Annotated[
        str | None,
        typer.Option(
            help="Name of a built-in skeleton or a TOML file. (default: cheetah-24; cheetah-8u for the frame method)"
        ),
    ] = None,
    frames: Annotated[
        str | None, typer.Option(help="Only these frame numbers, from A up to but without B, as in 100:160.")
    ] = None,
    individual: Annotated[str | None, typer.Option(help="Which animal of a multi-animal file, as in animal1.")] = None,
    likelihood_min: Annotated[
        float | None, typer.Option(help="Leave out points less likely than this, 0 to 1. (default: 0.5)")
    ] = None,
    side: Annotated[
        str | None,
        typer.Option(help="With a skeleton of one side, which to fit: auto, left or right. (default: auto)"),
    ] = None,
    hfov_deg: Annotated[
        float | None,
        typer.Option(help="Without a calibration: horizontal field of view in degrees, as in 64."),
    ] = None,
    image_size: Annotated[
        str | None, typer.Option(help="Size of the video in pixels, if the camera file lacks it, as in 1920x1080.")
    ] = None,
    tilt_deg: Annotated[
        float | None,
        typer.Option(help="Without extrinsics: how far the camera looks down, in degrees, as in 5. (default: level)"),
    ] = None,
    sigma_px: Annotated[
        float | None, typer.Option(help="Noise of the detector in pixels, one standard deviation. (default: 3)")
    ] = None,
    keypoint_sigma_m: Annotated[
        float | None,
        typer.Option(help="How far keypoints lie from the joints, metres, as in 0.05. (default: the skeleton's)"),
    ] = None,
    subject: Annotated[
        str | None,
        typer.Option(
            help="Lengths measured on one animal: built-in name or TOML file, as in jules. (default: the skeleton's)",
            rich_help_panel=_TRAJECTORY,
        ),
    ] = None,
    prior: Annotated[
        str | None,
        typer.Option(
            help="What motions are like: a built-in name, a file of `recon prior fit`, or none. "
            "(default: the built-in one for this skeleton, if any)",
            rich_help_panel=_TRAJECTORY,
        ),
    ] = None,
    ground: Annotated[
        str | None,
        typer.Option(
            help="auto: feet that stand are still and on one plane; none: nothing is said about them. (default: auto)",
            rich_help_panel=_TRAJECTORY,
        ),
    ] = None,
    size_sigma: Annotated[
        float | None,
        typer.Option(
            help="Standard deviation of the animal's size, relative, as in 0.1. (default: the skeleton's)",
            rich_help_panel=_TRAJECTORY,
        ),
    ] = None,
    fast: Annotated[
        bool | None,
        typer.Option("--fast/--no-fast", help="Quicker: fewer directions to start from.", rich_help_panel=_TRAJECTORY),
    ] = None,
    form: Annotated[
        str | None,
        typer.Option(
            help="Ranges and rates: deadband (beyond the limit) or printed (two-sided). (default: deadband)",
            rich_help_panel=_FRAME,
        ),
    ] = None,
    angle_prior: Annotated[
        str | None,
        typer.Option(
            help="Gaussian priors on angles and heading: gaussian or none. (default: gaussian)",
            rich_help_panel=_FRAME,
        ),
    ] = None,
    camera_rotation: Annotated[
        str | None,
        typer.Option(
            help="The body's rotation: free, or fixed to the first frame's. (default: free)", rich_help_panel=_FRAME
        ),
    ] = None,
    base_length_m: Annotated[
        float | None,
        typer.Option(
            help="Base length of the chain in metres, as in 0.203. (default: the skeleton's)", rich_help_panel=_FRAME
        ),
    ] = None,
    base_sigma_m: Annotated[
        float | None,
        typer.Option(
            help="Standard deviation of the base length in metres, as in 0.001. (default: the skeleton's)",
            rich_help_panel=_FRAME,
        ),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(help="config.toml of an earlier run; options given here overrule it.")
    ] = None,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace results in the folder.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Reconstruct one clip: keypoints and a camera in, 3D poses, angles, report and playback out.

    Example: recon fit clip.csv --camera scene.json --camera-name cam2 --fps 90 --out results/clip

    Exit code 0: done. 1: no frame could be solved. 2: the input cannot be used.
    """
    from recon.pipelines.clip import run_clip
    from recon.settings import read_settings

    given = {
        "keypoints": keypoints,
        "camera": camera,
        "camera_name": camera_name,
        "fps": fps,
        "method": method,
        "skeleton": skeleton,
        "subject": subject,
        "prior": prior,
        "frames": frames,
        "individual": individual,
        "likelihood_min": likelihood_min,
        "side": side,
        "hfov_deg": hfov_deg,
        "image_size_px": image_size,
        "tilt_deg": tilt_deg,
        "ground": ground,
        "size_sigma": size_sigma,
        "fast": fast,
        "form": form,
        "angle_prior": angle_prior,
        "camera_rotation": camera_rotation,
        "base_length_m": base_length_m,
        "base_sigma_m": base_sigma_m,
        "sigma_px": sigma_px,
        "keypoint_sigma_m": keypoint_sigma_m,
    }
    no_out = Problem("--out", "folder", "nothing", "a folder for the results, as in results/clip1")
    try:
        settings = read_settings(config, given)
    except InputError as error:
        raise InputError(error.problems if out else (*error.problems, no_out)) from None
    if out is None:
        raise InputError(no_out)
    console = Console(quiet=quiet)
    with _progress(console) as progress:
        report = run_clip(settings, out, overwrite, progress)
    _finish(console, report, out)


@app.command()
def evaluate(
    pose3d: Annotated[Path, typer.Argument(help="Reconstruction, as in results/clip/pose3d.csv (m).")],
    truth: Annotated[Path, typer.Argument(help="Reference of the same layout and frame numbers, as in truth.csv (m).")],
    as_json: Annotated[bool, typer.Option("--json", help="Print everything as JSON, per joint and frame.")] = False,
) -> None:
    """Compare a reconstruction with a reference, over the joints and frames that both have.

    Example: recon evaluate results/clip/pose3d.csv truth.csv
    """
    from recon.analysis.evaluation import evaluate_files

    result = evaluate_files(pose3d, truth)
    if as_json:
        typer.echo(json.dumps(result.to_dict(), indent=1))
        return
    Console().print(_table(result))
    for line in _table_notes(result):
        typer.echo(line)


@app.command()
def view(folder: Annotated[Path, typer.Argument(help="Folder of results, as in results/clip.")]) -> None:
    """Open the playback of a reconstruction in the rerun viewer.

    Example: recon view results/clip
    """
    from recon.view import open_viewer

    open_viewer(folder / "motion.rrd")


@app.command()
def demo(
    out: Annotated[Path, typer.Option(help="Folder for the results.")] = Path("demo-output"),
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace results in the folder.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.")] = False,
) -> None:
    """Reconstruct the bundled sample, a noisy synthetic gallop, and compare it with its truth.

    Example: recon demo --out demo-output
    """
    from recon.pipelines.demo import run_demo

    console = Console(quiet=quiet)
    with _progress(console) as progress:
        report, evaluation = run_demo(out, overwrite, progress)
    _finish(console, report, out)
    console.print(f"Error against the sample's truth: {1000 * evaluation.mpjpe_m.mean:.0f} mm (MPJPE)")


prior_app = typer.Typer(help="Motion priors: which poses occur, and how they change.", no_args_is_help=True)
app.add_typer(prior_app, name="prior")


@prior_app.command("fit")
def prior_fit(
    poses: Annotated[
        list[Path], typer.Argument(metavar="POSES", help="3D poses as in pose3d.csv: metres, world z up.")
    ],
    skeleton: Annotated[
        str, typer.Option(help="Built-in skeleton of a whole animal or a TOML file, as in cheetah-24.")
    ],
    fps: Annotated[str, typer.Option(help='Frame rate in Hz, or a JSON file with {"fps": [...]}, one per piece.')],
    out: Annotated[Path, typer.Option(help="File for the prior, as in my-dog.npz.")],
    subject: Annotated[str | None, typer.Option(help="Measured animal, by name or TOML file, as in phantom.")] = None,
    estimate_size: Annotated[
        bool, typer.Option("--estimate-size", help="Scale the skeleton to the animal of each file.")
    ] = False,
    components: Annotated[int, typer.Option(help="Gaussians in the mixture of poses.")] = 16,
    min_speed_m_s: Annotated[float, typer.Option(help="Leave out slower segments, as in 8.5.")] = 0.0,
    apart: Annotated[
        list[str] | None, typer.Option(help="Segment whose movement says nothing of the others', as in tail_1.")
    ] = None,
    name: Annotated[str | None, typer.Option(help="Name of the prior. (default: the file's)")] = None,
    source: Annotated[str, typer.Option(help="Where the poses come from, for the record.")] = "",
    check: Annotated[bool, typer.Option("--check", help="Score each segment under a prior from the others.")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="Replace the file.")] = False,
) -> None:
    """Fit a motion prior to 3D poses, and list what it was fitted to.

    Example: recon prior fit run1.csv run2.csv --skeleton cheetah-24 --fps 120 --out running.npz
    """
    from recon.pipelines.prior import run_prior_fit

    done = run_prior_fit(
        poses=poses,
        skeleton=skeleton,
        fps=fps,
        out=out,
        subject=subject,
        name=name,
        source=source,
        components=components,
        min_speed_m_s=min_speed_m_s,
        estimate_size=estimate_size,
        apart=apart or (),
        check=check,
        overwrite=overwrite,
    )
    table = Table(Column("segment", no_wrap=True), box=SIMPLE_HEAD)
    for title in ("frames", "fps", "speed m/s", "misfit mm", "used"):
        table.add_column(title, justify="right")
    for row, rms_mm in zip(done.prior.segments, done.rms_mm, strict=True):
        numbers = f"{row.frames}", f"{row.fps:g}", f"{row.speed_m_s:.1f}", f"{rms_mm:.1f}".replace("nan", "-")
        table.add_row(Text(row.name), *numbers, "yes" if row.used else "no")
    Console().print(table)
    for line in done.notes():
        typer.echo(line)
    typer.echo(f"The prior is in {out}.")


@contextmanager
def _progress(console: Console) -> Iterator[Any]:
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=console.quiet or not console.is_terminal) as bar:
        task = bar.add_task("reading", total=1.0)
        yield lambda stage, share: bar.update(task, description=f"fitting: {stage}", completed=share)


def _finish(console: Console, report: dict[str, Any], out: Path) -> None:
    from recon.report import console_summary, is_unsolved

    console.print(console_summary(report))
    if is_unsolved(report):
        message = f"no frame could be solved: see {out / 'report.json'}"
        Console(stderr=True, soft_wrap=True).print(_error(message))
        raise typer.Exit(EXIT_UNSOLVED)
    console.print(Text(f"Results are in {out}. Watch them with: recon view {shlex.quote(str(out))}"), soft_wrap=True)


def _table(result: Evaluation) -> Table:
    """Errors in millimetres and shares of good points, over all and by joint."""
    scores = (result.mpjpe_m, result.mpe_m, result.scale_mpjpe_m, result.pa_mpjpe_m)
    shares = [score for _, score in result.pck]
    table = Table(Column("errors in mm", no_wrap=True), box=SIMPLE_HEAD)
    for name in ("MPJPE", "MPE", "scaled", "PA", *(f"PCK {1000 * t:.0f}" for t, _ in result.pck)):
        table.add_column(name, justify="right")

    def add_row(name: str, errors_m: Iterable[float], shares: Iterable[float], last: bool = False) -> None:
        cells = [f"{1000 * e:.1f}" for e in errors_m] + [f"{share:.0%}" for share in shares]
        table.add_row(Text(name), *(cell.replace("nan%", "-").replace("nan", "-") for cell in cells), end_section=last)

    add_row("all", (s.mean for s in scores), (s.mean for s in shares), last=True)
    for j, name in enumerate(result.names):
        add_row(name, (s.per_joint[j] for s in scores), (s.per_joint[j] for s in shares))
    return table


def _table_notes(result: Evaluation) -> Iterator[str]:
    thresholds = ", ".join(f"{1000 * t:.0f}" for t, _ in result.pck)
    yield "MPJPE   mean distance of the joints from the reference, each frame centred"
    yield "MPE     without centring"
    yield "scaled  centred, and scaled to the size of the reference"
    yield "PA      centred, scaled and turned onto the reference"
    yield f"PCK     share of the joints within {thresholds} mm, centred"
    yield f"Compared: {len(result.frames) - result.frames_not_scored} frames, {len(result.names)} joints."
    for what, reconstruction, reference in (
        ("Joints", result.joints_only_in_pose, result.joints_only_in_truth),
        ("Frames", _ranges(result.frames_only_in_pose), _ranges(result.frames_only_in_truth)),
    ):
        if reconstruction:
            yield f"{what} only in the reconstruction: {', '.join(reconstruction)}"
        if reference:
            yield f"{what} only in the reference: {', '.join(reference)}"
    if result.frames_not_scored:
        yield f"Frames of both without a joint known on both sides: {result.frames_not_scored}"


def _ranges(ranges: Iterable[tuple[int, int]]) -> list[str]:
    return [f"{first}" if stop == first + 1 else f"{first} to {stop - 1}" for first, stop in ranges]
