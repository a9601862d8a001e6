"""What a climb is made of: footfalls in primitives with their fields, the step, the stance and speeds; and its file."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, Field

from recon.base.arrays import Array
from recon.base.documents import read_toml, validated
from recon.robotics.climb.fields import FORBID, PLANAR, SPATIAL, Fields, Number, Positive, Well

RECIPES = Path(__file__).parent / "recipes"


@dataclass(frozen=True)
class Step:
    """A step up across the way: the ground is level at 0 as far as edge_m forward (y), and at height_m beyond."""

    __pydantic_config__ = FORBID
    edge_m: Number
    height_m: Number

    def distance_m(self, points_m: Array) -> Array:
        """(...): from points (..., 3) to the ground or the step, whichever is nearer, negative inside."""
        y, z = points_m[..., 1] - self.edge_m, points_m[..., 2] - self.height_m
        away = np.hypot(np.maximum(-y, 0), np.maximum(z, 0))
        return np.minimum(points_m[..., 2], np.where((y > 0) & (z < 0), -np.minimum(y, -z), away))

    def corner_m(self, points_m: Array) -> Array:
        """(...): from points (..., 3) to the step's edge, negative inside the step."""
        y, z = points_m[..., 1] - self.edge_m, points_m[..., 2] - self.height_m
        return np.where((y > 0) & (z < 0), -1.0, 1.0) * np.hypot(y, z)


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


@dataclass(frozen=True)
class Primitive:
    """Some footfalls in the same fields."""

    __pydantic_config__ = FORBID
    name: str
    rise_rad: Positive
    """Angle of the feet's paths."""
    lower_rad: Positive
    """Angle of the feet's paths."""
    footfalls: Annotated[tuple[Footfall, ...], Field(min_length=1)]
    fields: Fields


@dataclass(frozen=True)
class _Swing:
    """How a foot moves: its path's clearance above the higher end, and its speeds by phase."""

    __pydantic_config__ = FORBID
    clearance_m: Positive
    rise_m_s: Positive
    traverse_m_s: Positive
    lower_m_s: Positive


@dataclass(frozen=True)
class _Pace:
    """How far the torso goes in a frame, at most."""

    __pydantic_config__ = FORBID
    max_step_m: Positive
    max_turn_rad: Positive
    arm_m: Positive = 0.065
    """A turn by one radian counts as this way."""


@dataclass(frozen=True)
class Recipe:
    """What a climb is planned from."""

    __pydantic_config__ = FORBID
    robot: str
    """Name of its description."""
    dofs: Literal[4, 6]
    """How many the torso has."""
    fps: Positive
    stance_m: Annotated[tuple[tuple[Number, Number], ...], Field(min_length=4, max_length=4)]
    """Where the feet stand at first, right and forward."""
    step: Step
    swing: _Swing
    motion: _Pace
    primitives: Annotated[tuple[Primitive, ...], Field(min_length=1)]
    about: str = ""
    """What it is for, and where its numbers are from."""

    @property
    def footfalls(self) -> list[Footfall]:
        return [f for p in self.primitives for f in p.footfalls]

    @property
    def free(self) -> tuple[int, ...]:
        """The torso's degrees of freedom."""
        return PLANAR if self.dofs == 4 else SPATIAL


def bundled() -> list[str]:
    return sorted(p.stem for p in RECIPES.glob("*.toml"))


def load_recipe(recipe: str | Path) -> Recipe:
    """A bundled recipe by name, or a file. Raises InputError."""
    path = RECIPES / f"{recipe}.toml" if str(recipe) in bundled() else Path(recipe)
    table = read_toml(path, f"a recipe of a climb: a TOML file, or one of {', '.join(bundled())}")
    return validated(Recipe, table, path)


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

    def times(of: Any, power: int, *names: str) -> Any:
        """With these numbers, or tuples of them, times a power of the factor."""
        return replace(of, **{n: (np.array(getattr(of, n)) * factor**power).tolist() for n in names})

    def primitive(p: Primitive) -> Primitive:
        radial: Well = times(times(p.fields.radial, 1, "natural", "least", "most"), -1, "low", "high")
        balance = times(p.fields.balance, -1, "gain", "sharpness")
        fields = replace(p.fields, radial=times(radial, -2, "gain"), balance=balance)
        falls = tuple(times(fall, 1, "forward_m", "up_m", "sideways_m") for fall in p.footfalls)
        return replace(p, footfalls=falls, fields=fields)

    return replace(
        times(recipe, 1, "stance_m"),
        step=times(recipe.step, 1, "edge_m", "height_m"),
        primitives=tuple(primitive(p) for p in recipe.primitives),
        swing=times(recipe.swing, 1, "clearance_m", "rise_m_s", "traverse_m_s", "lower_m_s"),
        motion=times(recipe.motion, 1, "max_step_m", "arm_m"),
    )
