"""What a climb is made of: footfalls in primitives with their fields, the step, the stance and speeds; and its file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, BeforeValidator, Field, model_validator

from recon.base.arrays import Array
from recon.base.documents import read_toml, validated
from recon.robotics.climb.equilibrium import TorsoDynamics
from recon.robotics.climb.fields import PLANAR, SPATIAL, Fields, Well
from recon.robotics.climb.numbers import FORBID, Number, Positive
from recon.robotics.climb.paths import Step

RECIPES = Path(__file__).parent / "recipes"


@dataclass(frozen=True)
class Footfall:
    """A step that one leg takes."""

    __pydantic_config__ = FORBID
    leg: Annotated[int, Field(strict=True, ge=1, le=4), AfterValidator(lambda number: number - 1)]
    """Index into `LEGS`; in a file counted from 1."""
    forward_m: Number
    up_m: Number
    sideways_m: Number = 0.0

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

    __pydantic_config__ = FORBID
    clearance_m: Positive
    rise_m_s: Positive
    traverse_m_s: Positive
    lower_m_s: Positive


@dataclass(frozen=True, eq=False)
class Recipe:
    """What a climb is planned from."""

    robot: str
    """Name of its description."""
    about: str
    """What it is for, and where its numbers are from."""
    step: Step
    stance_m: Array
    """(4, 2): where the feet stand at first, right and forward."""
    primitives: tuple[Primitive, ...]
    swing: Swing
    motion: TorsoDynamics
    fps: float

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
        robot=file.robot,
        about=file.about,
        step=file.step,
        stance_m=np.array(file.stance_m),
        primitives=tuple(_primitive(primitive) for primitive in file.primitives),
        swing=file.swing,
        motion=replace(file.motion, dofs=PLANAR if file.dofs == 4 else SPATIAL),
        fps=file.fps,
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


# -- the file --------------------------------------------------------------------------------------------------------

_Twice = BeforeValidator(lambda given: given if isinstance(given, list) else [given, given])
"""One number for all legs, or two: of the front and of the rear legs."""
_Pair = Annotated[tuple[Number, Number], _Twice]
_PositivePair = Annotated[tuple[Positive, Positive], _Twice]


class _WellFile(BaseModel):
    model_config = FORBID
    gain: _PositivePair
    natural: _Pair
    least: _Pair
    most: _Pair
    low: _PositivePair
    high: _PositivePair

    @model_validator(mode="after")
    def _is_ordered(self) -> Self:
        if any(not a <= b <= c for a, b, c in zip(self.least, self.natural, self.most, strict=True)):
            raise ValueError("least <= natural <= most")
        return self

    def well(self) -> Well:
        pairs: dict[str, tuple[float, float]] = self.model_dump()
        return Well(**{name: a if a == b else np.array([a, b, a, b]) for name, (a, b) in pairs.items()})


class _BalanceFile(BaseModel):
    model_config = FORBID
    gain: Positive
    sharpness: Positive


class _FieldsFile(BaseModel):
    model_config = FORBID
    radial: _WellFile
    swing: _WellFile
    flap: _WellFile
    balance: _BalanceFile


class _PrimitiveFile(BaseModel):
    model_config = FORBID
    name: str
    rise_rad: Positive
    lower_rad: Positive
    footfalls: Annotated[tuple[Footfall, ...], Field(min_length=1)]
    fields: _FieldsFile


class _RecipeFile(BaseModel):
    model_config = FORBID
    robot: str
    about: str = ""
    dofs: Literal[4, 6]
    fps: Positive
    stance_m: Annotated[list[tuple[Number, Number]], Field(min_length=4, max_length=4)]
    step: Step
    swing: Swing
    motion: TorsoDynamics
    primitives: Annotated[list[_PrimitiveFile], Field(min_length=1)]


def _primitive(file: _PrimitiveFile) -> Primitive:
    of = file.fields
    fields = Fields(of.radial.well(), of.swing.well(), of.flap.well(), of.balance.gain, of.balance.sharpness)
    return Primitive(file.name, file.footfalls, fields, file.rise_rad, file.lower_rad)
