"""What a climb is made of: footfalls in primitives with their fields, the step, the stance and speeds; and its file."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
import tomli_w
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from recon.base.arrays import Array
from recon.base.documents import read_toml, validated
from recon.base.files import staged_file
from recon.robotics.climb.equilibrium import TorsoDynamics
from recon.robotics.climb.fields import PLANAR, SPATIAL, Fields, Well
from recon.robotics.climb.paths import Step

RECIPES = Path(__file__).parent / "recipes"
WELLS = ("radial", "swing", "flap")


@dataclass(frozen=True)
class Footfall:
    """leg: index into `LEGS`; the step it takes."""

    leg: int
    forward_m: float
    up_m: float
    sideways_m: float = 0.0

    @property
    def vector_m(self) -> Array:
        return np.array([self.sideways_m, self.forward_m, self.up_m])


@dataclass(frozen=True, eq=False)
class Primitive:
    """Some footfalls in the same fields."""

    name: str
    footfalls: tuple[Footfall, ...]
    fields: Fields
    rise_rad: float
    """Angle of the feet's paths."""
    lower_rad: float
    """Angle of the feet's paths."""


@dataclass(frozen=True)
class Swing:
    """How a foot moves: its path's clearance above the higher end, and its speeds by phase."""

    clearance_m: float = 0.010
    rise_m_s: float = 0.2
    traverse_m_s: float = 0.3
    lower_m_s: float = 0.2


@dataclass(frozen=True, eq=False)
class Recipe:
    """What a climb is planned from."""

    robot: str
    """Name of its description."""
    step: Step
    stance_m: Array
    """(4, 2): where the feet stand at first, right and forward."""
    primitives: tuple[Primitive, ...]
    swing: Swing
    motion: TorsoDynamics
    fps: float
    made_by: str
    """The command that found the numbers."""

    @property
    def footfalls(self) -> list[Footfall]:
        return [f for p in self.primitives for f in p.footfalls]


def bundled() -> list[str]:
    return sorted(p.stem for p in RECIPES.glob("*.toml"))


def load_recipe(recipe: str | Path) -> Recipe:
    """A bundled recipe by name, or a file. Raises InputError."""
    path = RECIPES / f"{recipe}.toml" if str(recipe) in bundled() else Path(recipe)
    table = read_toml(path, f"a recipe of a climb: a TOML file, or one of {', '.join(bundled())}")
    file = validated(_RecipeFile, table, path)
    return Recipe(
        file.robot,
        Step(file.step.edge_m, file.step.height_m),
        np.array(file.stance_m),
        tuple(_primitive(primitive) for primitive in file.primitives),
        Swing(**file.swing.model_dump()),
        TorsoDynamics(**file.motion.model_dump(), dofs=PLANAR if file.dofs == 4 else SPATIAL),
        file.fps,
        file.made_by,
    )


def raised(recipe: Recipe, height_m: float) -> Recipe:
    """For a step of another height: all heights in proportion."""
    ratio = height_m / recipe.step.height_m
    primitives = tuple(
        replace(p, footfalls=tuple(replace(f, up_m=f.up_m * ratio) for f in p.footfalls)) for p in recipe.primitives
    )
    return replace(recipe, step=replace(recipe.step, height_m=height_m), primitives=primitives)


def scaled(recipe: Recipe, factor: float) -> Recipe:
    """For a robot of another size: all lengths in proportion, and fields that hold a robot of the same shape in the
    same postures."""

    def lengths(of: Any, *names: str) -> Any:
        return replace(of, **{name: factor * getattr(of, name) for name in names})

    def primitive(p: Primitive) -> Primitive:
        f, r = p.fields, p.fields.radial
        places = lengths(r, "natural", "least", "most")
        radial = replace(places, gain=r.gain / factor**2, low=r.low / factor, high=r.high / factor)
        fields = Fields(radial, f.swing, f.flap, f.balance_gain / factor, f.balance_sharpness / factor)
        falls = tuple(lengths(fall, "forward_m", "up_m", "sideways_m") for fall in p.footfalls)
        return replace(p, footfalls=falls, fields=fields)

    motion = lengths(recipe.motion, "max_step_m", "arm_m")
    return replace(
        recipe,
        step=lengths(recipe.step, "edge_m", "height_m"),
        stance_m=factor * recipe.stance_m,
        primitives=tuple(primitive(p) for p in recipe.primitives),
        swing=lengths(recipe.swing, "clearance_m", "rise_m_s", "traverse_m_s", "lower_m_s"),
        motion=replace(motion, mass=motion.mass / factor**2),
    )


def _primitive(file: _PrimitiveFile) -> Primitive:
    falls = tuple(Footfall(f.leg - 1, f.forward_m, f.up_m, f.sideways_m) for f in file.footfalls)
    wells = {name: _well(getattr(file.fields, name)) for name in WELLS}
    balance = file.fields.balance
    fields = Fields(**wells, balance_gain=balance.gain, balance_sharpness=balance.sharpness)
    return Primitive(file.name, falls, fields, file.rise_rad, file.lower_rad)


def _well(file: _WellFile) -> Well:
    pairs: dict[str, tuple[float, float]] = file.model_dump()
    return Well(**{name: a if a == b else np.array([a, b, a, b]) for name, (a, b) in pairs.items()})


# -- the file --------------------------------------------------------------------------------------------------------

LARGEST = 1e9
"""Of a number in a recipe: more can only be damage."""
Number = Annotated[float, Field(strict=True, gt=-LARGEST, lt=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, gt=0, lt=LARGEST, allow_inf_nan=False)]
Twice = BeforeValidator(lambda given: given if isinstance(given, list) else [given, given])
"""One number for all legs, or two: of the front and of the rear legs."""
Pair = Annotated[tuple[Number, Number], Twice]
PositivePair = Annotated[tuple[Positive, Positive], Twice]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class _WellFile(_Table):
    gain: PositivePair
    natural: Pair
    least: Pair
    most: Pair
    low: PositivePair
    high: PositivePair

    @model_validator(mode="after")
    def _is_ordered(self) -> Self:
        if any(not a <= b <= c for a, b, c in zip(self.least, self.natural, self.most, strict=True)):
            raise ValueError("least <= natural <= most")
        return self


class _BalanceFile(_Table):
    gain: Positive
    sharpness: Positive


class _FieldsFile(_Table):
    radial: _WellFile
    swing: _WellFile
    flap: _WellFile
    balance: _BalanceFile


class _FootfallFile(_Table):
    leg: Annotated[int, Field(strict=True, ge=1, le=4)]
    forward_m: Number
    up_m: Number
    sideways_m: Number


class _PrimitiveFile(_Table):
    name: str
    rise_rad: Positive
    lower_rad: Positive
    footfalls: Annotated[list[_FootfallFile], Field(min_length=1)]
    fields: _FieldsFile


class _StepFile(_Table):
    edge_m: Number
    height_m: Number


class _SwingFile(_Table):
    clearance_m: Positive
    rise_m_s: Positive
    traverse_m_s: Positive
    lower_m_s: Positive


class _MotionFile(_Table):
    mass: Positive
    inertia: Positive
    max_step_m: Positive
    max_turn_rad: Positive


class _RecipeFile(_Table):
    robot: str
    made_by: str
    dofs: Literal[4, 6]
    fps: Positive
    stance_m: Annotated[list[tuple[Number, Number]], Field(min_length=4, max_length=4)]
    step: _StepFile
    swing: _SwingFile
    motion: _MotionFile
    primitives: Annotated[list[_PrimitiveFile], Field(min_length=1)]


def save_recipe(recipe: Recipe, path: str | Path) -> None:
    """Written whole or not at all; numbers to seven digits."""
    path = Path(path)
    table = {
        "robot": recipe.robot,
        "made_by": recipe.made_by,
        "dofs": len(recipe.motion.dofs),
        "fps": recipe.fps,
        "stance_m": [[_short(x) for x in row] for row in recipe.stance_m],
        "step": _table(recipe.step),
        "swing": _table(recipe.swing),
        "motion": {n: _short(getattr(recipe.motion, n)) for n in ("mass", "inertia", "max_step_m", "max_turn_rad")},
        "primitives": [
            {
                "name": p.name,
                "rise_rad": _short(p.rise_rad),
                "lower_rad": _short(p.lower_rad),
                "footfalls": [{**_table(f), "leg": f.leg + 1} for f in p.footfalls],
                "fields": {
                    **{name: _table(getattr(p.fields, name)) for name in WELLS},
                    "balance": {
                        "gain": _short(p.fields.balance_gain),
                        "sharpness": _short(p.fields.balance_sharpness),
                    },
                },
            }
            for p in recipe.primitives
        ],
    }
    with staged_file(path) as staged:
        staged.write_text(tomli_w.dumps(table), encoding="utf-8")


def _table(of: Any) -> dict[str, Any]:
    return {f.name: _short(getattr(of, f.name)) for f in fields(of)}


def _short(x: Any) -> Any:
    """A number, or the pair of the front and the rear legs', to seven digits."""
    values = [float(f"{float(v):.7g}") for v in np.ravel(x)]
    return values[:2] if len(values) == 4 else values[0]
