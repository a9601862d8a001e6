"""Command line: arguments in, one call of `recon.workflows`, nothing else. One module for each command."""

from __future__ import annotations

import sys
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from recon.base.errors import InputError
from recon.base.interrupts import Interrupts, installed
from recon.workflows.cli.analyse import analyse
from recon.workflows.cli.batch import batch
from recon.workflows.cli.calibrate import calibrate
from recon.workflows.cli.camera_advice import camera_advice
from recon.workflows.cli.camera_motion import camera_motion
from recon.workflows.cli.common import EXIT_BAD_INPUT, error_text, stop, terminal
from recon.workflows.cli.convert import convert
from recon.workflows.cli.demo import demo
from recon.workflows.cli.doctor import doctor
from recon.workflows.cli.evaluate import evaluate
from recon.workflows.cli.extrinsics import extrinsics
from recon.workflows.cli.fit import fit
from recon.workflows.cli.overlay import overlay
from recon.workflows.cli.prior import prior_fit
from recon.workflows.cli.report import report
from recon.workflows.cli.run import run
from recon.workflows.cli.skeleton import skeleton_app
from recon.workflows.cli.subject import subject_fit
from recon.workflows.cli.view import view


def _of_wing(wing: str, name: str) -> Any:
    """A command of a wing by the name of its module: rooms import no wing, and only this table knows their commands."""
    return getattr(import_module(f"recon.{wing}.cli.{name}"), name)


class _Commands(TyperGroup):
    """Any command ends at Ctrl-C with one line and exit code 130. A command's name may be of two words."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        both = " ".join(args[:2])
        return super().resolve_command(ctx, [both, *args[2:]] if both in self.commands else args)

    def invoke(self, ctx: Any) -> Any:
        interrupts = installed() or Interrupts()
        try:
            interrupts.in_command = True
            return super().invoke(ctx)
        except KeyboardInterrupt:
            stop()
        finally:
            interrupts.in_command = False
            if interrupts.received and not interrupts.said:  # a library has made another exception of it, or none
                stop()


app = typer.Typer(
    cls=_Commands,
    help="Metric 3D motion of a running animal from the keypoints of one camera or several, still or panning.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for command in (
    run,
    fit,
    batch,
    analyse,
    _of_wing("robotics", "ik"),
    evaluate,
    view,
    demo,
    calibrate,
    convert,
    overlay,
    report,
):
    app.command()(command)
for command in (
    _of_wing("robotics", "retarget"),
    _of_wing("robotics", "climb"),
    _of_wing("thesis", "frame"),
    _of_wing("thesis", "solver"),
    doctor,
):
    app.command()(command)
for command in ("train", "predict", "evaluate_2d"):
    app.command(command.replace("_", "-"))(_of_wing("keypoint_net", command))
app.command("camera-motion")(camera_motion)
app.command("calibrate extrinsics")(extrinsics)
app.command("camera-advice")(camera_advice)

prior_app = typer.Typer(help="Motion priors: which poses occur, and how they change.", no_args_is_help=True)
prior_app.command("fit")(prior_fit)
app.add_typer(prior_app, name="prior")
app.add_typer(_of_wing("robotics", "robot"), name="robot")
app.add_typer(skeleton_app, name="skeleton")
subject_app = typer.Typer(
    help="Measured animals: lengths of one animal, and how a detector sees it.", no_args_is_help=True
)
subject_app.command("fit")(subject_fit)
app.add_typer(subject_app, name="subject")


def main() -> None:
    """Run the command line; a user's mistake ends with one message and exit code 2."""
    console = terminal(stderr=True, soft_wrap=True)
    try:
        app()
    except InputError as error:
        for problem in error.problems:
            first, *more = problem.lines
            console.print(error_text(first), *more, sep="\n")
        sys.exit(EXIT_BAD_INPUT)
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        console.print(error_text(f"{where}{error.strerror or error}"))
        sys.exit(EXIT_BAD_INPUT)


def _version(wanted: bool) -> None:
    if wanted:
        from recon import __version__

        typer.echo(f"recon {__version__}")
        raise typer.Exit()


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass
