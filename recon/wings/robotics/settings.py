"""What the commands of the wing are told: one class for each, from which options, help and what Python takes follow."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BeforeValidator, Field

from recon.base.errors import Problem
from recon.base.settings import Integer, Number, Option, Positive, Settings
from recon.workflows.cli import ANYWAY, STRIDE, StrideTimes

Extended = Literal["extended-differences", "extended-energy", "extended-harmonic"]
MethodName = Literal[
    "least-norm", "transpose", "gradient-projection", "weighted", "damped", "selectively-damped", Extended, "extended"
]
EXTENDED = "extended"
"""The extended Jacobian with the cost that is asked for."""
METHODS: tuple[str, ...] = tuple(name for name in get_args(MethodName) if name != EXTENDED)
STRIDE_MAX = "stride-max"

_RESULTS = Option("Folder of results, as in results/clip.", argument="DIR")
_FIGURES = Option("PNG and SVG beside the tables.")
_OVERWRITE = Option("Replace earlier ones.")


class IkSettings(Settings):
    """What `recon ik` is told."""

    folder: Annotated[Path, _RESULTS]
    method: Annotated[
        MethodName,
        Option(
            f"{', '.join(METHODS)}, or {EXTENDED} with --cost.",
            f"{', '.join(METHODS)}, or {EXTENDED} with --cost",
            metavar="METHOD",
        ),
    ] = "damped"
    target: str | None = None
    """Drive the foot there: stride-max, its foremost place in the stride, from its rearmost; or x,y,z in metres from
    the chain's base, as in 0.8,0.1,-0.5."""
    follow: Literal["stride"] | None = None
    """Follow a path with the foot: stride, one of its own, closed."""
    compare: bool = False
    """All methods in one table; both jobs unless one is asked for."""
    foot: Annotated[str | None, Option(metavar="FOOT")] = None
    """LF, RF, LH, RH, or the joint's name. (default: the first fore foot)"""
    stride: Annotated[StrideTimes | None, STRIDE] = None
    dim: Annotated[Integer, Field(ge=2, le=3)] = 3
    """2: in the vertical plane of travel; 3: in space."""
    turns: Annotated[Integer, Field(ge=1)] = 1
    """How often to follow the stride."""
    limits: bool = True
    """Limits of the joints."""
    fitted: bool = False
    """With the methods' parameters fitted to this clip; also fits them to each frame of the stride."""
    online: bool = False
    """Along the stride, parameters refitted at every frame to the animal's joint rates just before."""
    cost: str | None = None
    """Cost of the methods extended and gradient-projection: differences, energy, harmonic, pose (distance from the
    clip's mean pose), or a sum with weights, as in energy,differences=0.1."""
    alpha: Annotated[Literal["step"] | Number | None, Option(expected="step, or a number other than 0")] = None
    """Factor on the joints' rates of every method: a number, or step, at every step the one with which the foot moves
    nearest to what is asked for. (default: none)"""
    out: Path | None = None
    """Folder for tables and figures. (default: ik in DIR)"""
    figures: Annotated[bool, _FIGURES] = True
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: Annotated[bool, _OVERWRITE] = False

    @property
    def methods(self) -> tuple[str, ...]:
        """The names of the methods that are run."""
        own = () if self.cost is None else (EXTENDED,)
        return (*METHODS, *own) if self.compare else (self.method,)

    @property
    def parameters(self) -> str:
        """Which parameters the methods have, in words."""
        return "refitted at every frame" if self.online else "fitted to the clip" if self.fitted else "standard"

    @property
    def both(self) -> bool:
        """Whether no single job is asked for."""
        return self.target is None and self.follow is None

    @property
    def out_folder(self) -> Path:
        return self.folder / "ik" if self.out is None else self.out

    def problems(self) -> Iterator[Problem]:
        if self.both and not self.compare:
            yield Problem("options", "job", "none", "--target, --follow stride or --compare")
        if self.method == EXTENDED and self.cost is None:
            yield Problem("settings", "method", repr(EXTENDED), self.infos()["method"].expected())
        if self.alpha == 0:
            yield Problem("settings", "alpha", "0", self.infos()["alpha"].expected())


MOST_SAMPLES, RATE_HZ = 10_000, 50.0


class RetargetSettings(Settings):
    """What `recon retarget` is told."""

    folder: Annotated[Path, _RESULTS]
    robot: str
    """a1, go2, aibo, or a file .toml, .urdf or .xml (MJCF)."""
    out: Path
    """Folder for tables, report and playback."""
    scale: Annotated[Positive | None, Option(expected="a number above 0")] = None
    """Factor on the animal's lengths. (default: the largest within reach and limits)"""
    slower: Annotated[Positive | None, Option(expected="a number above 0")] = None
    """Factor on the animal's times. (default: what the joints' rates ask for, at least 1)"""
    stride: Annotated[StrideTimes | None, STRIDE] = None
    format: Literal["amp", "isaaclab", "mjlab", "mjlab-csv"] | None = None
    """For programs that train policies, also: amp, isaaclab, mjlab or mjlab-csv, with velocities."""
    rate: Annotated[Positive, Option(expected="a number above 0")] = RATE_HZ
    """Frames a second of --format."""
    samples: Annotated[
        Annotated[Integer, Field(ge=2, le=MOST_SAMPLES)] | None, Option(expected=f"a number from 2 to {MOST_SAMPLES}")
    ] = None
    """Beside it, so many motions as the animal's may have been, drawn from the fit's posterior, as in 32."""
    check: bool = False
    """By MuJoCo, frame by frame: limits, torques, forces on the ground, legs that meet: table, figure, and what to
    change."""
    fit_limits: bool = False
    """The least change of stride, time and the base's path, also of the draws', with which the robot can do it, by
    MuJoCo; the check of before and after."""
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: Annotated[bool, _OVERWRITE] = False


class ClimbSettings(Settings):
    """What `recon climb` is told."""

    recipe: Annotated[str, Option(argument="RECIPE")] = "found-50"
    """found-50, published-50, highest-spatial, or a file .toml."""
    out: Path
    """Folder for tables, figures and playback."""
    height: Annotated[Positive | None, Option(expected="metres, as in 0.045")] = None
    """Height of the step, metres; the footfalls' heights are in proportion. (default: the recipe's)"""
    figures: Annotated[bool, _FIGURES] = True
    overwrite: Annotated[bool, _OVERWRITE] = False


# -- recon robot -----------------------------------------------------------------------------------------------------


def _split(given: Any) -> Any:
    return tuple(given.split(",")) if isinstance(given, str) else given


Three = Annotated[tuple[Number, Number, Number], BeforeValidator(_split)]
"""Several numbers; as text with commas between them."""
_THREE = Option(expected="3 numbers with commas, as in 0.1,-20,3", metavar="X,Y,Z")


class PoseSettings(Settings):
    """What `recon robot pose` is told."""

    robot: Annotated[str, Option(argument="ROBOT")]
    """a1, go2, aibo, or a file .toml, .urdf or .xml (MJCF)."""
    move: Annotated[Three | None, _THREE] = None
    """The body forwards, left and up from where it stands, metres, as in 0,0,-0.02. (default: 0,0,0)"""
    roll: Annotated[Number, Option(expected="degrees, as in 10")] = 0.0
    """Degrees, right side down."""
    pitch: Annotated[Number, Option(expected="degrees, as in 10")] = 0.0
    """Degrees, nose down."""
    yaw: Annotated[Number, Option(expected="degrees, as in 10")] = 0.0
    """Degrees, to the left."""


class TableSettings(Settings):
    """What `recon robot dh` is told."""

    source: Annotated[str, Option(argument="SOURCE")]
    """A table of parameters (.toml), a robot (a1, go2, aibo, or a file), or a .urdf or .xml."""
    tip: str | None = None
    """Leg, LF, RF, LH or RH; of a .urdf or .xml, too, the link at the end. (default: the only leaf)"""
    angles: Annotated[str | None, Option(metavar="NUMBERS")] = None
    """Where is the end at these, degrees (metres of joints that slide)? As in 0,45,-90."""
    place: Annotated[Three | None, _THREE] = None
    """All angles that put the end there: base or body axes, metres, as in 0.4,0.1,0.2."""
    turned: Annotated[Three | None, _THREE] = None
    """With --place: the end's roll, pitch and yaw, degrees, as in 0,90,0. (default: any)"""
