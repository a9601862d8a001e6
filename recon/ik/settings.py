"""Settings of `recon ik`, which the command line reads without the libraries of the work."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal, get_args

from pydantic import Field

from recon.api.options import ANYWAY, STRIDE, StrideTimes
from recon.base.errors import Problem
from recon.base.settings import Integer, Number, Option, Settings

EXTENDED = "extended"
"""Name of the extended Jacobian with the requested cost."""
Extended = Literal["extended-differences", "extended-energy", "extended-harmonic"]
MethodName = Literal[
    "least-norm", "transpose", "gradient-projection", "weighted", "damped", "selectively-damped", Extended, "extended"
]
METHODS: tuple[str, ...] = tuple(name for name in get_args(MethodName) if name != EXTENDED)


class IkSettings(Settings):
    """Settings of `recon ik`."""

    folder: Annotated[Path, Option(argument="DIR")]
    """Results folder, such as results/clip."""
    method: Annotated[
        MethodName,
        Option(
            f"{', '.join(METHODS)}, or {EXTENDED} with --cost.",
            f"{', '.join(METHODS)}, or {EXTENDED} with --cost",
            metavar="METHOD",
        ),
    ] = "damped"
    target: str | None = None
    """Target of the foot: stride-max, its foremost position in the stride, starting from its rearmost position; or
    x,y,z in metres from the chain's base, such as 0.8,0.1,-0.5.
    """
    follow: Literal["stride"] | None = None
    """Path that the foot follows: stride, which is a closed stride of the foot in the clip."""
    compare: bool = False
    """Compare all methods in one table, for both tasks unless one is chosen."""
    foot: Annotated[str | None, Option(metavar="FOOT")] = None
    """LF, RF, LH, RH, or the joint's name. (default: the first fore foot)"""
    stride: Annotated[StrideTimes | None, STRIDE] = None
    dim: Annotated[Integer, Field(ge=2, le=3)] = 3
    """Dimensions: 2 for the vertical plane of the direction of travel, 3 for space."""
    turns: Annotated[Integer, Field(ge=1)] = 1
    """Number of times to follow the stride."""
    limits: bool = True
    """Respect the limits of the joints."""
    fitted: bool = False
    """Use the methods' parameters fitted to this clip, and also fit them to each frame of the stride."""
    online: bool = False
    """Refit the parameters at every frame of the stride to the animal's recent joint rates."""
    cost: str | None = None
    """Cost of the methods extended and gradient-projection: differences, energy, harmonic, pose (distance from the
    clip's mean pose), or a sum with weights, such as energy,differences=0.1."""
    costs: bool = False
    """Follow the stride ten times by the extended Jacobian with each cost, and classify the motion as convergent,
    drifting, singular or chaotic.
    """
    alpha: Annotated[Literal["step"] | Number | None, Option(expected="step, or a number other than 0")] = None
    """Factor on the joints' rates of every method: a number, or step, for the factor with which the foot's motion is
    closest to the requested one at every step. (default: none)
    """
    out: Path | None = None
    """Folder for tables and figures. (default: ik in DIR)"""
    figures: bool = True
    """Write figures (PNG and SVG) next to the tables."""
    anyway: Annotated[bool, ANYWAY] = False
    overwrite: bool = False
    """Replace earlier tables and figures."""

    @property
    def methods(self) -> tuple[str, ...]:
        """Return the names of the inverse-kinematics methods to run."""
        extended = () if self.cost is None else (EXTENDED,)
        return (*METHODS, *extended) if self.compare else (self.method,)

    @property
    def parameters(self) -> str:
        """Return the origin of the methods' parameters in words, such as "fitted to the clip"."""
        return "refitted at every frame" if self.online else "fitted to the clip" if self.fitted else "standard"

    @property
    def has_no_task(self) -> bool:
        """Return whether neither a target nor a path is given."""
        return self.target is None and self.follow is None

    @property
    def out_folder(self) -> Path:
        """Return the folder for tables and figures."""
        return self.folder / "ik" if self.out is None else self.out

    def problems(self) -> Iterator[Problem]:
        """Yield a problem for a missing task, for the method `EXTENDED` without a cost, and for an alpha of 0."""
        if self.has_no_task and not (self.compare or self.costs):
            yield Problem("options", "task", "none", "--target, --follow stride, --compare or --costs")
        if self.method == EXTENDED and self.cost is None:
            yield Problem("settings", "method", repr(EXTENDED), self.infos()["method"].expected())
        if self.alpha == 0:
            yield Problem("settings", "alpha", "0", self.infos()["alpha"].expected())
